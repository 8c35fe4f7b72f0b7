"""Decisions about sense, aliasing and repeated frames: a table of small cases on either side of each threshold."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _aliasing as aliasing
from gyrotrack.tracking import _association as association
from gyrotrack.tracking import _frame_repeats as repeats
from gyrotrack.tracking._aliasing import slowing, unaliased
from gyrotrack.tracking._association import Motion, find_rotation_sense, net_turn, unfold
from gyrotrack.tracking._frame_repeats import Repetition, without_repeats
from gyrotrack.video import _decoder as decoder
from gyrotrack.video._time_base import CaptureRate, FrameTimes

TURN = 2 * np.pi
FRAMES = np.arange(60)


class TestSense:
    @pytest.mark.parametrize(
        ("turns", "given", "sense"),
        [
            ({"casing": 1.0, "rotor": -9.0}, None, 1),
            ({"casing": -1.0, "rotor": 9.0}, None, -1),
            ({"casing": 0.4, "rotor": 9.0}, None, 1),
            ({"casing": 0.4, "rotor": -9.0}, None, -1),
            ({"casing": 0.6, "rotor": -9.0}, None, 1),
            ({"casing": 0.4, "rotor": 0.4}, None, -1),
            ({}, None, -1),
            ({"casing": -9.0}, 1, 1),
        ],
    )
    def test_the_casing_decides_then_the_rotor_then_clockwise(self, turns, given, sense):
        assert find_rotation_sense(turns, given) == sense

    @pytest.mark.parametrize(
        ("step", "sense", "unfolded"),
        [
            (0.5, 1, 0.5),
            (-0.5, 1, TURN - 0.5),
            (0.5, -1, 0.5 - TURN),
            (-0.03, 1, TURN - 0.03),
            (-0.01, 1, -0.01),
        ],
    )
    def test_a_body_against_the_sense_turns_by_a_turn_less_a_step(self, step, sense, unfolded):
        angle, changed = unfold(0.3 + step * FRAMES, sense)
        assert np.diff(angle) == pytest.approx(np.full(59, unfolded))
        assert angle[0] == 0.3
        assert changed is (step != unfolded)

    def test_the_net_turn_ignores_gaps(self):
        assert net_turn(np.array([np.nan, 1.0, 5.0, 4.0, np.nan])) == 3.0
        assert net_turn(np.array([np.nan, 2.0])) == 0.0

    def test_the_vertex_of_a_parabola(self):
        value = lambda x: 3.0 - (x - 0.3) ** 2  # noqa: E731
        assert association._vertex(value(-1), value(0), value(1)) == pytest.approx(0.3)
        assert association._vertex(1.0, 1.0, 1.0) == 0.0
        assert association._vertex(0.0, 0.0, 1.0) == 0.0  # a minimum
        assert association._vertex(0.0, 1.0, 1.0 - 1e-9) == pytest.approx(0.5)

    def test_a_prediction_is_corrected_by_a_part_of_the_error(self):
        found = association._corrected(Motion(1.0, 0.2, 0), 1.1)
        assert (found.angle, found.step) == pytest.approx((1.06, 0.212))
        found = association._corrected(Motion(1.0, 0.2, 2), 1.1)
        assert (found.angle, found.step, found.missed) == pytest.approx((1.06, 0.204, 0))

    @pytest.mark.parametrize(("share", "locked"), [(0.65, False), (0.75, True)])
    def test_a_lock_agrees_with_seven_frames_in_ten(self, share, locked):
        column = np.arange(256) * TURN / 256
        rng = np.random.default_rng(0)
        angle = 0.7 + 0.3 * np.arange(60)
        wrong = rng.permutation(60) >= share * 60
        angle = np.where(wrong, angle + np.pi + rng.uniform(-1.0, 1.0, 60), angle)
        score = np.exp(-(np.angle(np.exp(1j * (column - angle[:, None]))) ** 2) / 0.02)
        assert (association.find_lock(score, 0.4) is not None) is locked


class TestAliasing:
    """Rotations of d per frame and of d less a period, with a body of `order` equal parts."""

    def choice(self, monkeypatch, angle, gain=0.0, order=3):
        monkeypatch.setattr(aliasing, "symmetries", lambda _: [order] if order > 1 else [])
        return unaliased(angle, FRAMES, None, lambda a: gain if a is not angle else 0.0)

    @pytest.mark.parametrize(("share", "tried"), [(0.94, False), (0.97, True)])
    @pytest.mark.parametrize("sense", [1, -1])
    def test_an_oscillation_has_no_alternative(self, monkeypatch, share, tried, sense):
        steps = np.where(np.arange(59) < share * 59, 1.0, -0.2)
        angle = sense * np.concatenate([[0.0], np.cumsum(steps)])
        found = self.choice(monkeypatch, angle, gain=0.1)
        assert (found.angle is not angle) is tried

    @pytest.mark.parametrize(
        ("step", "tried"),
        [
            (0.24, False),
            (0.26, True),
            (0.99, True),
            (1.01, True),
            (-1.01, True),
            (-0.26, True),
            (-0.24, False),
        ],
    )
    def test_alternatives_from_a_quarter_of_a_period_on(self, monkeypatch, step, tried):
        period = TURN / 3
        angle = step * period * FRAMES
        # a whole turn is tried as well: only periods of a third count here
        found = self.choice(monkeypatch, angle, gain=0.1)
        changed = (found.angle - angle)[1] if found.angle is not angle else 0.0
        expected = -math.copysign(period, step) if tried else 0.0
        assert changed == pytest.approx(expected) or (not tried and changed == pytest.approx(-TURN))

    def test_periods_are_subtracted_by_the_number_of_the_frame(self, monkeypatch):
        monkeypatch.setattr(aliasing, "symmetries", lambda _: [3])
        frame = np.delete(FRAMES, [5, 6, 30])
        found = unaliased(1.2 * TURN / 3 * frame, frame, None, lambda _: 0.0)
        assert found.angle == pytest.approx(0.2 * TURN / 3 * frame, abs=1e-9)

    @pytest.mark.parametrize(("gain", "other"), [(0.03, True), (0.01, False), (-0.03, False)])
    def test_pictures_decide_where_they_differ(self, monkeypatch, gain, other):
        """A steady rotation of 0.4 periods: without pictures the slower one, with a warning."""
        angle = 0.4 * TURN / 3 * FRAMES
        found = self.choice(monkeypatch, angle, gain=gain)
        assert (found.angle is not angle) is other
        assert (found.warning is not None) is (abs(gain) < 0.02)

    @pytest.mark.parametrize(("growth", "slows"), [(0.03, True), (0.01, False)])
    def test_the_one_that_slows_down_is_taken(self, growth, slows):
        """Of markers only whole turns are unknown: 0.6 turns per frame that fall by `growth`, seen as 0.4 turns."""
        x = FRAMES / FRAMES[-1]
        true = TURN * 0.6 * np.cumsum(1.0 - growth * 1.3 * x)
        found = slowing(true - TURN * FRAMES, FRAMES)
        assert (found is not None) is slows
        if slows:
            assert np.diff(found) == pytest.approx(np.diff(true))

    @pytest.mark.parametrize(("count", "known"), [(10, False), (30, True)])
    def test_few_frames_say_nothing(self, count, known):
        frame = np.arange(count)
        true = TURN * np.cumsum(0.6 - 0.2 * frame / count)
        assert (slowing(true - TURN * frame, frame) is not None) is known

    def test_speeds_at_the_ends_and_their_growth(self):
        angle = 0.5 * 0.01 * FRAMES**2 + 0.1 * FRAMES
        first, last = aliasing._ends(angle, FRAMES)
        assert first == pytest.approx(0.1 + 0.01 * 6.0)
        assert last == pytest.approx(0.1 + 0.01 * 53.0)
        assert aliasing._growth(angle, FRAMES) == pytest.approx(last / first - 1.0)
        assert aliasing._growth(-angle, FRAMES) == pytest.approx(last / first - 1.0)
        assert math.isnan(aliasing._growth((FRAMES - 30.0) ** 2, FRAMES))


class TestRepeats:
    def steps(self, rate=0.1, repeated=(20, 30, 31), inserted=False, noise=0.0):
        n = 60
        again = np.zeros(n, dtype=bool)
        again[list(repeated)] = True
        moved = np.full(n, rate)
        moved[again] = 0.0
        if not inserted:
            for k in repeated:
                after = k + 1
                while again[after]:
                    after += 1
                moved[after] += rate
        angle = np.cumsum(moved) + noise * np.random.default_rng(0).standard_normal(n)
        return repeats._Steps(angle, again), again

    def test_a_body_that_should_have_moved_and_has_not(self):
        body, _ = self.steps()
        usual, clear = body.around(20)
        assert usual == pytest.approx(0.1)
        assert clear
        assert body.still(20) is True
        assert body.still(40) is False

    @pytest.mark.parametrize(("moved", "still"), [(0.45, True), (0.55, False)])
    def test_half_a_step_is_the_limit(self, moved, still):
        body, _ = self.steps()
        body.angle[20] = body.angle[19] + 0.1 * moved
        assert body.still(20) is still
        body.angle[20] = np.nan
        assert body.still(20) is None

    @pytest.mark.parametrize(("noise", "clear"), [(0.006, True), (0.03, False)])
    def test_the_step_is_six_times_its_scatter(self, noise, clear):
        assert self.steps(noise=noise)[0].around(20)[1] is clear

    def test_three_steps_are_too_few(self):
        angle = np.full(60, np.nan)
        angle[18:22] = 0.1 * np.arange(4)
        assert repeats._Steps(angle, np.zeros(60, dtype=bool)).around(20)[1] is False
        angle[18:23] = 0.1 * np.arange(5)
        assert repeats._Steps(angle, np.zeros(60, dtype=bool)).around(20)[1] is True

    @pytest.mark.parametrize(("inserted", "share"), [(True, 0.0), (False, 1.0)])
    def test_the_motion_across_a_run_shows_its_origin(self, inserted, share):
        body, again = self.steps(inserted=inserted)
        runs = repeats._runs(again)
        assert runs == [(20, 21), (30, 32)]
        assert body.shares(runs) == pytest.approx([share, share])

    def test_the_body_that_turns_most(self):
        bodies = {
            n: SimpleNamespace(coarse=np.array([0.0, a])) for n, a in (("casing", 1.0), ("rotor", -9.0))
        }
        assert repeats.turning_most(SimpleNamespace(bodies=bodies)) == "rotor"

    def test_regular_runs_have_a_period(self):
        runs = lambda first: [(k, k + 1) for k in first]  # noqa: E731
        assert repeats._period(runs(range(5, 60, 5))) == pytest.approx(5.0)
        assert repeats._period(runs([5, 10, 16, 20, 25, 30, 35])) == pytest.approx(5.0, rel=0.05)
        assert np.isnan(repeats._period(runs([5, 10, 20, 22, 40, 41, 59])))
        assert np.isnan(repeats._period(runs([5, 10, 15])))
        assert np.isfinite(repeats._period(runs([5, 10, 15, 20])))

    def test_the_share_of_original_frames(self):
        again = np.zeros(60, dtype=bool)
        again[4::5] = True
        assert Repetition(again, inserted=True, period=5.0).original_share == pytest.approx(0.8)

    @pytest.mark.parametrize(
        ("fps", "stored", "rate", "number"),
        [(25.0, 25.0, 20.0, 47), (20.0, 25.0, 20.0, 47), (240.0, 25.0, 240.0, 47)],
    )
    def test_inserted_frames_do_not_count(self, fps, stored, rate, number):
        again = np.zeros(60, dtype=bool)
        again[4::5] = True
        info = SimpleNamespace(container_fps=stored)
        times, found = without_repeats(
            FrameTimes(np.arange(60)), Repetition(again, True, 5.0), CaptureRate(fps, "asked for"), info
        )
        assert found.fps == pytest.approx(rate)
        assert times.number[-1] == number
        assert times.number[:6].tolist() == [0, 1, 2, 3, 3, 4]
        replaced, same = without_repeats(
            FrameTimes(np.arange(60)), Repetition(again, False, 5.0), CaptureRate(fps, "asked for"), info
        )
        assert same.fps == fps
        assert replaced.number[-1] == 59


class TestRegularRepeats:
    """Repeats of a conversion are at equal distances, up to one frame of rounding."""

    @pytest.mark.parametrize(
        ("steps", "regular"),
        [
            ((10, 10, 10, 10), True),
            ((9, 11, 10, 9, 11, 10), True),
            ((8, 12, 10, 8, 12, 10), False),
            ((10, 10), False),
            ((10, 10, 10, 10, 10, 10, 10, 10, 30), True),
            ((10, 10, 10, 10, 30), False),
        ],
    )
    def test_distances(self, steps, regular):
        first = 5 + np.concatenate([[0], np.cumsum(steps)])
        found = repeats._period([(i, i + 1) for i in first])
        assert np.isfinite(found) == regular
        if regular:
            assert found == pytest.approx(np.polyfit(np.arange(len(first)), first, 1)[0])
        assert decoder._regular(first) is regular


class TestOtherRotations:
    """A body of `order` equal parts that turns from `first` to `last` periods per frame."""

    def choice(self, monkeypatch, first, last, *, order=1, gain=None, sense=1, explained=0.0):
        monkeypatch.setattr(aliasing, "symmetries", lambda _: [order] if order > 1 else [])
        period = TURN / order
        steps = np.linspace(first, last, 59)
        angle = sense * period * np.concatenate([[0.0], np.cumsum(steps)])
        asked = []

        def share(other):
            asked.append(other)
            return explained if np.array_equal(other, angle) else explained + (gain or 0.0)

        found = unaliased(angle, FRAMES, None, share)
        change = (found.angle - angle)[-1] / (59 * period * sense)
        return round(change), found.warning is not None

    @pytest.mark.parametrize("sense", [1, -1])
    @pytest.mark.parametrize("order", [1, 4])
    @pytest.mark.parametrize(
        ("first", "last", "periods", "warned"),
        [
            (0.40, 0.30, 0, False),  # slows down, the other one not
            (0.60, 0.55, 0, True),  # slows down, but is faster than half a period per frame
            (0.40, 0.45, -1, True),  # the other one slows down
            (0.40, 0.40, 0, True),  # both are steady
            (0.480, 0.475, 0, True),  # changes by 1 %: steady
            (0.48, 0.46, 0, False),  # by 4 %
            (0.60, 0.62, -1, True),
            (0.24, 0.24, 0, False),
            (0.45, 0.52, -1, True),
        ],
    )
    def test_the_rotation_that_slows_down_is_taken(
        self, monkeypatch, first, last, periods, warned, order, sense
    ):
        if order > 1 and (first, last) == (0.24, 0.24):
            return
        assert self.choice(monkeypatch, first, last, order=order, sense=sense) == (periods, warned)

    @pytest.mark.parametrize(
        ("first", "gain", "periods"),
        [(1.3, -0.019, -1), (1.3, -0.021, 0), (2.3, 0.0, -2), (3.6, 0.0, -3), (1.3, 0.5, -1)],
    )
    @pytest.mark.parametrize("sense", [1, -1])
    def test_whole_periods_are_subtracted_unless_the_pictures_contradict(
        self, monkeypatch, first, gain, periods, sense
    ):
        """The pictures contradict beyond 0.02; later decisions are replaced by slow rotations."""
        monkeypatch.setattr(aliasing, "_FAST", 0.99)
        assert self.choice(monkeypatch, first, first, order=5, gain=gain, sense=sense)[0] == periods

    @pytest.mark.parametrize(
        ("gain", "periods", "warned"),
        [(0.021, -1, False), (-0.021, 0, False), (0.019, 0, True), (-0.019, 0, True)],
    )
    def test_pictures_decide_from_a_fiftieth_on(self, monkeypatch, gain, periods, warned):
        assert self.choice(monkeypatch, 0.4, 0.4, gain=gain, explained=0.6) == (periods, warned)

    def template(self, *waves, columns=256, offset=0.0):
        """Return a template with waves (order, amplitude, phase) in two rows of different area."""
        theta = np.arange(columns) * TURN / columns
        row = sum((a * np.cos(n * theta + phase) for n, a, phase in waves), np.zeros(columns))
        area = np.array([[1.0], [4.0]]) * np.ones(columns)
        ring = SimpleNamespace(area=area.astype(np.float32), columns=columns)
        body = np.stack([row + offset, row - 2.0 * offset]).astype(np.float32)
        return SimpleNamespace(ring=ring, body=body)

    @pytest.mark.parametrize(
        ("waves", "columns"),
        [
            ([(3, 1.0, 0.4), (7, 0.1, 0.4)], 256),
            ([(3, 1.0, 0.4), (1, 0.69, 0.2)], 256),
            ([(3, 1.0, 0.4), (1, 0.73, 0.2)], 256),
            ([(12, 5.0, 0.1), (24, 2.0, 0.3)], 256),
            ([(48, 5.0, 0.1)], 480),
            ([(50, 5.0, 0.1), (100, 5.0, 0.7)], 800),
            ([(32, 5.0, 0.1)], 255),
        ],
    )
    def test_orders_of_symmetry_have_a_correlation_of_a_half_after_a_period(self, waves, columns):
        """That of waves of order k and amplitude a is the mean of cos(2 pi k / n) with the weights a^2."""
        power = np.array([a**2 for _, a, _ in waves])
        order = np.array([k for k, *_ in waves])
        largest = min(48, columns // 8)
        alike = {n: power @ np.cos(TURN * order / n) / power.sum() for n in range(2, largest + 1)}
        assert min(abs(value - 0.5) for value in alike.values()) > 2e-3
        expected = [n for n in range(largest, 1, -1) if alike[n] > 0.5]
        # the mean of a row does not matter
        assert aliasing.symmetries(self.template(*waves, columns=columns, offset=50.0)) == expected

    def test_a_blank_body_has_no_symmetry(self):
        assert aliasing.symmetries(self.template(offset=0.0)) == []

    def test_rows_weigh_by_their_area(self):
        """The inner row has the order 3, the outer one of four times the area the order 2."""
        given = self.template()
        theta = np.arange(256) * TURN / 256
        given.body[0], given.body[1] = np.cos(3 * theta), np.cos(2 * theta)
        found = aliasing.symmetries(given)
        assert 2 in found  # (4 - 1) / 5
        assert 3 not in found

    @pytest.mark.parametrize(
        ("first", "last", "periods"),
        [(0.23, 0.25, 0), (0.40, 0.44, -1), (0.40, 0.403, 0), (0.996, 0.9998, 0), (0.44, 0.40, 0)],
    )
    @pytest.mark.parametrize("sense", [1, -1])
    def test_markers_that_speed_up_may_slow_down_with_a_turn_less(self, first, last, periods, sense):
        angle = sense * TURN * np.concatenate([[0.0], np.cumsum(np.linspace(first, last, 59))])
        found = slowing(angle, FRAMES)
        assert (found is not None) == bool(periods)
        if periods:
            np.testing.assert_allclose(found, angle - sense * TURN * FRAMES)
