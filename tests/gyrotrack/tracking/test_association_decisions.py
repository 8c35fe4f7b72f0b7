"""Locks, senses, predictions and their corrections, and repeated frames: cases on either side of each limit."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _association as _association
from gyrotrack.tracking import _frame_repeats as repeats
from gyrotrack.tracking._association import (
    Motion,
    Prediction,
    find_lock,
    find_rotation_sense,
    follow,
    net_turn,
    unfold,
)
from gyrotrack.tracking._frame_repeats import Repetition, without_repeats
from gyrotrack.video import _decoder as decoder
from gyrotrack.video._time_base import CaptureRate, FrameTimes

TURN = 2 * np.pi
COLUMNS = 256
STEP = TURN / COLUMNS


def score_of(columns, seen=None):
    """One bright column in each frame, none where `seen` is false."""
    found = np.zeros((len(columns), COLUMNS))
    for k, column in enumerate(columns):
        if seen is None or seen[k]:
            found[k, int(column) % COLUMNS] = 1.0
    return found


class TestLock:
    @pytest.mark.parametrize(
        ("count", "seen", "found"),
        [
            (24, 6, True),
            (24, 5, False),
            (11, 5, True),
            (11, 4, False),
            (6, 3, True),
            (6, 2, False),
            (8, 4, True),
            (8, 3, False),
        ],
    )
    def test_a_lock_needs_six_frames_or_half_of_a_short_film(self, count, seen, found):
        lock = find_lock(score_of(10 + 3 * np.arange(count), np.arange(count) < seen), 0.5)
        assert (lock is not None) == found
        if found:
            assert lock[0] == 0
            assert lock[1].angle == pytest.approx(10 * STEP, abs=1e-3)
            assert lock[1].step == pytest.approx(3 * STEP, abs=1e-4)

    @pytest.mark.parametrize(("threshold", "found"), [(0.99, True), (1.0, False)])
    def test_a_score_exceeds_the_threshold(self, threshold, found):
        assert (find_lock(score_of(10 + 3 * np.arange(24)), threshold) is not None) == found

    @pytest.mark.parametrize(("wrong", "found"), [(6, True), (7, False)])
    def test_seven_frames_in_ten_are_in_phase(self, wrong, found):
        columns = 10 + 3 * np.arange(20)
        columns[[2, 17, 5, 14, 8, 11, 9][:wrong]] += np.array([64, 64, -64, -64, 128, 128, 64])[:wrong]
        assert (find_lock(score_of(columns), 0.5) is not None) == found

    @pytest.mark.parametrize(("off", "found"), [(10, True), (11, False)])
    def test_frames_in_phase_are_within_a_quarter_of_a_radian(self, off, found):
        """Ten columns are 0.245 rad; two frames on either side leave the advance as it is."""
        columns = 60 + 5 * np.arange(12)
        columns[[2, 9]] += off
        columns[[3, 8]] -= off
        lock = find_lock(score_of(columns), 0.5)
        assert (lock is not None) == found
        assert not found or lock[1].step == pytest.approx(5 * STEP, abs=1e-4)

    @pytest.mark.parametrize("hint", [0.0, 5.0, -5.0, 8.0])
    def test_the_step_nearest_to_the_hint_is_chosen_at_whole_frames(self, hint):
        _, motion = find_lock(score_of(10 + 20 * np.arange(24)), 0.5, hint=hint)
        turns = (motion.step - 20 * STEP) / TURN
        assert turns == pytest.approx(round(turns), abs=1e-3)
        assert abs(motion.step - hint) <= math.pi

    def test_uneven_times_determine_the_step_about_the_hint(self):
        """1.3 turns per period; whole frames do not show the turn."""
        when = np.cumsum(np.where(np.arange(24) % 2, 1.0, 1.37))
        step = 1.3 * TURN
        columns = np.rint((step * when) / STEP)
        _, motion = find_lock(score_of(columns), 0.5, hint=8.0, place=when)
        assert motion.step == pytest.approx(step, abs=5e-3)
        assert math.remainder(motion.angle - step * when[0], TURN) == pytest.approx(0.0, abs=0.03)

    def test_the_first_run_of_24_frames_that_begins_with_every_sixth_is_taken(self):
        """The first 8 frames are random, so that fewer than 70 % of the first 24 advance evenly."""
        columns = 10 + 7 * np.arange(60)
        columns[:8] = [3, 200, 77, 140, 9, 250, 130, 220]
        start, motion = find_lock(score_of(columns), 0.5)
        assert start == 6
        assert motion.angle == pytest.approx((10 + 7 * 6) * STEP, abs=0.1)
        assert motion.step == pytest.approx(7 * STEP, abs=5e-3)


class TestFollow:
    @pytest.mark.parametrize(
        ("off", "missed", "seen"),
        [
            (13, 0, True),
            (-13, 0, True),
            (14, 0, True),
            (15, 0, False),
            (-15, 0, False),
            (15, 5, True),
            (22, 20, True),
            (24, 20, False),
        ],
    )
    def test_a_body_is_searched_for_near_its_predicted_angle(self, off, missed, seen):
        """0.35 rad are 15 columns, of which the outermost does not count; each missed frame adds 0.01 rad."""
        motion = Motion(100 * STEP, 0.0, missed)
        angle, found, after = follow(score_of([100 + off]), motion, 0.5)
        assert found.tolist() == [seen]
        assert angle[0] == pytest.approx((100 + off * seen) * STEP)
        if seen:
            assert after.missed == 0
            step = 0.12 * off * STEP / (1 + missed)
            assert after.step == pytest.approx(step)
            assert after.angle == pytest.approx((100 + 0.6 * off) * STEP + step)
        else:
            assert after == Motion(100 * STEP, 0.0, missed + 1)

    @pytest.mark.parametrize(("threshold", "seen"), [(0.99, True), (1.0, False)])
    def test_a_body_is_brighter_than_the_threshold(self, threshold, seen):
        assert follow(score_of([100]), Motion(100 * STEP, 0.0), threshold)[1].tolist() == [seen]

    def test_the_angle_is_the_vertex_of_the_parabola_through_three_columns(self):
        score = np.zeros((1, COLUMNS))
        score[0, [49, 50, 51]] = 2.0 - 0.5 * (np.array([-1.0, 0.0, 1.0]) - 0.3) ** 2
        angle, _, _ = follow(score, Motion(TURN + 50 * STEP, 0.0), 0.5)
        assert angle[0] == pytest.approx(TURN + 50.3 * STEP)

    @pytest.mark.parametrize(
        ("values", "offset"),
        [((1.0, 2.0, 1.0), 0.0), ((1.0, 2.0, 1.5), 1 / 6), ((1.5, 2.0, 1.0), -1 / 6), ((0, 2, 2), 0.5),
         ((3, 2, 0), -0.5), ((2, 2, 2), 0.0), ((3, 2, 4), 0.0)],
    )  # fmt: skip
    def test_a_vertex_is_within_half_a_column(self, values, offset):
        assert _association._vertex(*values) == pytest.approx(offset)

    def test_the_motion_goes_on_by_the_periods_between_frames(self):
        """Missing frames advance it by more, repeated ones not at all; it is lost after 40 frames."""
        advance = np.array([1.0, 3.0, 0.0, 1.5] + [1.0] * 60)
        angle, seen, after = follow(np.zeros((64, COLUMNS)), Motion(1.0, 0.1), 0.5, advance)
        assert not seen.any()
        assert angle[:5] == pytest.approx([1.0, 1.1, 1.4, 1.4, 1.55])
        assert np.isfinite(angle).sum() == _association.LONGEST_COAST + 1 == 41
        assert np.isnan(angle[41:]).all()
        assert after.missed == 41
        plain, _, _ = follow(np.zeros((4, COLUMNS)), Motion(1.0, 0.1), 0.5)
        assert plain == pytest.approx([1.0, 1.1, 1.2, 1.3])


class TestPrediction:
    def made(self, count, angle_of, extra=()):
        found = Prediction()
        frame = np.arange(float(count))
        found.add(frame, angle_of(frame), np.ones(count, dtype=bool))
        for f, a, seen in extra:
            found.add(np.array([f]), np.array([a]), np.array([seen]))
        return found

    @pytest.mark.parametrize(("count", "known"), [(15, False), (16, True)])
    def test_sixteen_angles_are_needed(self, count, known):
        found = self.made(count, lambda f: 0.3 * f, [(40.0, 99.0, False)])
        assert (found.at(np.array([50.0])) is not None) == known
        found.reset()
        assert found.at(np.array([50.0])) is None
        assert found.at(np.array([50.0])) is None

    def test_a_parabola_is_continued(self):
        found = self.made(60, lambda f: 2.0 + 0.3 * f + 1e-3 * f**2)
        at = np.array([60.0, 75.0])
        value, _ = found.at(at)
        assert value == pytest.approx(2.0 + 0.3 * at + 1e-3 * at**2, abs=2e-3)

    def test_harmonics_of_an_oblique_view_are_continued(self):
        view = lambda p: p + 0.04 * np.cos(p) - 0.03 * np.sin(p) + 0.02 * np.cos(2 * p) + 0.01 * np.sin(2 * p)  # noqa: E731
        found = self.made(128, lambda f: view(1.0 + 0.31 * f))
        at = np.arange(128.0, 150.0)
        value, _ = found.at(at)
        assert value == pytest.approx(view(1.0 + 0.31 * at), abs=4e-3)

    def test_the_last_128_angles_are_fitted(self):
        """The speed of earlier angles was half as large; a few outliers are ignored."""
        angle_of = lambda f: np.where(f < 72, 0.1 * f, 0.2 * f - 7.2) + np.where(f % 23 == 0, 0.5, 0.0)  # noqa: E731
        value, _ = self.made(200, angle_of).at(np.array([210.0]))
        assert value == pytest.approx([34.8], abs=1e-3)

    def test_the_fit_is_repeated_after_130_frames(self):
        found = self.made(60, lambda f: 0.2 * f)
        assert found.at(np.array([61.0]))[0] == pytest.approx([12.2], abs=1e-3)
        late = np.arange(60.0, 188.0)
        found.add(late, 0.2 * late + 5.0, np.ones(128, dtype=bool))
        assert found.at(np.array([189.0]))[0] == pytest.approx([37.8], abs=1e-3)
        assert found.at(np.array([180.0, 190.0]))[0][1] == pytest.approx(43.0, abs=1e-3)

    def test_the_uncertainty_is_that_of_a_linear_model_with_a_prior_of_the_view(self):
        """The scatter of alternating errors is 1.4826 times their size; the largest of the frames is stated."""
        frame = np.arange(100.0)
        size = 0.01
        values = 1.0 + 0.31 * frame + np.where(frame % 2, size, -size)
        found = self.made(100, lambda f: values)
        at = np.array([101.0, 110.0, 120.0])
        value, sigma = found.at(at)

        def rows(f):
            x = (f - 99.0) / 99.0
            psi = 1.0 + 0.31 * f
            return np.stack(
                [x**0, x, x * x, np.cos(psi), np.sin(psi), np.cos(2 * psi), np.sin(2 * psi)], axis=1
            )

        scatter = 1.4826 * size
        prior = np.diag([0.0] * 3 + [scatter**2 / 0.05**2] * 4)
        inverse = np.linalg.inv(rows(frame).T @ rows(frame) + prior)
        expected = scatter * np.sqrt(np.einsum("ni,ij,nj->n", rows(at), inverse, rows(at)).max())
        assert sigma == pytest.approx(expected, rel=0.05)
        assert value == pytest.approx(1.0 + 0.31 * at, abs=3 * sigma)
        assert found.at(at[:1])[1] < 0.8 * sigma

    def test_the_scatter_of_quiet_angles_is_1_5_mrad(self):
        rows = np.stack([np.ones(40), np.linspace(-1, 1, 40)], axis=1)
        solution, inverse, scatter = _association._robust(rows, rows @ [2.0, 3.0], np.zeros(2))
        assert solution == pytest.approx([2.0, 3.0])
        assert inverse == pytest.approx(np.linalg.inv(rows.T @ rows))
        assert scatter == 1.5e-3

    @pytest.mark.parametrize(("off", "used"), [(2.9, True), (3.1, False)])
    def test_angles_beyond_three_standard_deviations_are_outliers(self, off, used):
        values = 0.1 * np.where(np.arange(401) % 2, 1.0, -1.0)
        values[200] = off * 0.14826
        solution, _, scatter = _association._robust(np.ones((401, 1)), values, np.zeros(1))
        assert scatter == pytest.approx(0.14826, rel=0.02)
        kept = values if used else np.delete(values, 200)
        assert solution == pytest.approx([kept.mean()], abs=1e-5)


@dataclass
class Body:
    coarse: np.ndarray
    markers: dict


class TestRepeatedFrames:
    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_the_typical_step_is_that_of_twenty_frames_on_either_side(self, sign):
        step = sign * np.concatenate([np.full(40, 0.5), np.full(20, 0.1), np.full(20, 0.3), np.full(40, 0.5)])
        again = np.zeros(121, dtype=bool)
        body = repeats._Steps(np.concatenate([[0.0], np.cumsum(step)]), again)
        usual, clear = body.around(60)
        assert usual == pytest.approx(sign * 0.2)  # half of the steps are 0.1, half 0.3
        assert not clear
        usual, clear = body.around(40)
        assert usual == pytest.approx(sign * 0.3, abs=1e-9)
        assert body.around(0)[0] == pytest.approx(sign * 0.5)
        assert body.around(10) == (pytest.approx(sign * 0.5), True)

    @pytest.mark.parametrize(("scatter", "clear"), [(0.110, True), (0.114, False)])
    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_a_step_is_clear_beyond_six_standard_deviations(self, scatter, clear, sign):
        """The median deviation is the alternating part; 1 / (6 x 1.4826) is 0.1124."""
        steps = sign * (1.0 + scatter * np.where(np.arange(30) % 2, 1.0, -1.0))
        steps = np.append(steps, sign)
        body = repeats._Steps(np.concatenate([[0.0], np.cumsum(steps)]), np.zeros(32, dtype=bool))
        assert body.around(15)[1] == clear

    def test_a_run_at_the_end_of_the_film_shows_no_origin(self):
        angle = 0.1 * np.arange(30.0)
        angle[10:] += 0.05
        again = np.zeros(30, dtype=bool)
        body = repeats._Steps(angle, again)
        # 0.25 across one repeated frame, 0.4 across two: (0.25 / 0.1 - 1) / 1 and (0.4 / 0.1 - 1) / 2
        assert body.shares([(10, 11), (27, 30)]) == pytest.approx([1.5])
        angle[20:] += 0.1
        assert body.shares([(20, 22)]) == pytest.approx([1.5])
        angle[15] = np.nan
        assert body.shares([(15, 17), (16, 17), (14, 15)]) == pytest.approx([1.0])

    def test_the_angle_of_a_body_is_the_mean_of_its_plausible_markers(self, monkeypatch):
        coarse = np.array([1.0, 2.0, 3.0, np.nan, 5.0])
        one = SimpleNamespace(
            angle=coarse + 0.5 + np.array([0.02, 0.02, TURN, 0.0, 9.0]),
            open=np.array([1, 1, 1, 1, 0], dtype=bool),
            good=np.ones(5, dtype=bool),
        )
        two = SimpleNamespace(
            angle=coarse - 1.5 + np.array([0.04, 0.04, 0.06, 0.0, 9.0]),
            open=np.ones(5, dtype=bool),
            good=np.array([1, 0, 1, 1, 0], dtype=bool),
        )
        monkeypatch.setattr(repeats, "plausible", lambda seen: seen.good)
        scene = SimpleNamespace(
            of=lambda name: [SimpleNamespace(name="one", mount=0.5), SimpleNamespace(name="two", mount=-1.5)]
        )
        seen = SimpleNamespace(bodies={"rotor": Body(coarse, {"one": one, "two": two})})
        found = repeats.seen_angle(seen, scene, "rotor")
        assert found == pytest.approx([1.03, 2.02, 3.03, np.nan, np.nan], nan_ok=True)

    @pytest.mark.parametrize(
        ("moved", "again", "inserted"),
        [
            ({"a": 0.0}, True, True),
            ({"a": 1.0}, False, False),
            ({"a": 0.0, "after": 2.0}, True, False),
            ({"a": 0.0, "after": 1.45}, True, True),
            ({"a": 0.0, "after": 1.55}, True, False),
            ({"a": None}, True, False),
            ({"a": None, "b": 1.0}, False, False),
            ({"a": 0.0, "b": 1.0}, True, False),
            ({"a": 0.0, "b": 0.0}, True, True),
        ],
    )
    def test_a_frame_repeats_if_one_body_has_not_moved(self, monkeypatch, moved, again, inserted):
        """Frame 15 of 40 looks like frame 14; a body that is not seen does not decide."""
        angles = {}
        for name in ("a", "b"):
            if name in moved:
                step = np.full(39, 0.1)
                step[14] *= moved[name] or 0.0
                step[15] *= moved.get("after", 1.0)
                angle = np.concatenate([[0.0], np.cumsum(step)])
                if moved[name] is None:
                    angle[15:17] = np.nan
                angles[name] = angle
        monkeypatch.setattr(repeats, "seen_angle", lambda seen, scene, name: angles[name])
        mask = np.arange(40) == 15
        seen = SimpleNamespace(again=mask, bodies=angles)
        found = repeats.judge_repeats(seen, None)
        assert np.flatnonzero(found.again).tolist() == ([15] if again else [])
        assert found.inserted == inserted
        assert math.isnan(found.period)
        assert mask[15]
        nothing = repeats.judge_repeats(SimpleNamespace(again=mask, bodies={}), None)
        assert not nothing.again.any()

    @pytest.mark.parametrize(
        ("fps", "stored", "rate"),
        [
            (25.0, 25.0, 20.0),
            (25.9, 25.0, 20.0),
            (26.5, 25.0, 26.5),
            (22.0, 25.0, 22.0),
            (20.5, 25.0, 20.5),
            (24.0, 25.0, 20.0),
        ],
    )
    def test_the_rate_of_a_converted_film_is_that_of_the_file_less_repeats(self, fps, stored, rate):
        """Within 5 % of the rate of the file, and nearer to it than to the true rate."""
        again = np.arange(60) % 5 == 4
        info = SimpleNamespace(container_fps=stored)
        found, _ = repeats._slower(CaptureRate(fps, "x"), repeats.Repetition(again, True, 5.0), info)
        assert found.fps == pytest.approx(rate)
        unknown, hint = repeats._slower(CaptureRate(fps, "x"), repeats.Repetition(again, True), info)
        assert unknown.fps == fps
        assert ("--capture-fps" in hint) == (rate == 20.0)

    def test_original_frames_are_counted_by_runs(self):
        again = np.zeros(60, dtype=bool)
        again[[4, 5, 14, 15, 24, 25]] = True
        assert repeats.Repetition(again, True, 10.0).original_share == pytest.approx(0.8)
        assert repeats._runs(again) == [(4, 6), (14, 16), (24, 26)]
        assert repeats._runs(np.array([True, False, True])) == [(0, 1), (2, 3)]

    def test_stamped_times_are_kept_and_doubted(self):
        again = np.arange(30) == 12
        times = FrameTimes(np.arange(30), place=np.arange(30.0))
        rate = CaptureRate(25.0, "x")
        info = SimpleNamespace(container_fps=25.0)
        found, same = repeats.without_repeats(times, repeats.Repetition(again, True, 5.0), rate, info)
        assert same is rate
        assert found.number[-1] == 29
        assert found.again is again
        assert "1 frames" in found.warnings[-1]
        assert "frame 12" in found.warnings[-1]
        nothing = repeats.without_repeats(times, repeats.Repetition(again & False), rate, info)
        assert nothing == (times, rate)


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
        assert _association._vertex(value(-1), value(0), value(1)) == pytest.approx(0.3)
        assert _association._vertex(1.0, 1.0, 1.0) == 0.0
        assert _association._vertex(0.0, 0.0, 1.0) == 0.0  # a minimum
        assert _association._vertex(0.0, 1.0, 1.0 - 1e-9) == pytest.approx(0.5)

    def test_a_prediction_is_corrected_by_a_part_of_the_error(self):
        found = _association._corrected(Motion(1.0, 0.2, 0), 1.1)
        assert (found.angle, found.step) == pytest.approx((1.06, 0.212))
        found = _association._corrected(Motion(1.0, 0.2, 2), 1.1)
        assert (found.angle, found.step, found.missed) == pytest.approx((1.06, 0.204, 0))

    @pytest.mark.parametrize(("share", "locked"), [(0.65, False), (0.75, True)])
    def test_a_lock_agrees_with_seven_frames_in_ten(self, share, locked):
        column = np.arange(256) * TURN / 256
        rng = np.random.default_rng(0)
        angle = 0.7 + 0.3 * np.arange(60)
        wrong = rng.permutation(60) >= share * 60
        angle = np.where(wrong, angle + np.pi + rng.uniform(-1.0, 1.0, 60), angle)
        score = np.exp(-(np.angle(np.exp(1j * (column - angle[:, None]))) ** 2) / 0.02)
        assert (_association.find_lock(score, 0.4) is not None) is locked


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
