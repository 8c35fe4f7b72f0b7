"""Aliases of bodies with a symmetry, and other rotations: polar pictures at known angles, and limits of decisions."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _aliasing as aliasing
from gyrotrack.tracking._aliasing import doubtful, slowing, symmetries, unaliased
from gyrotrack.tracking._registration import Ring, explained, learn

RING = Ring.about((100.0, 100.0), 30.0, 80.0, finest=0.02)
FRAMES = np.arange(80)
# slows down from 70 to 40 degrees per frame, clockwise
TRUE = -np.radians(70 * FRAMES - 30 * FRAMES**2 / (2 * FRAMES[-1]))


def polars(angle, mark=0.0, fold=3):
    """Return pictures of a body of `fold` equal arms, one of them brighter by `mark`, with noise of 2 grey levels."""
    rng = np.random.default_rng(0)
    found = []
    for a in angle:
        # rolled pictures turn clockwise
        seen = RING.angle + a
        arms = 60 * np.exp(4 * (np.cos(fold * seen) - 1)) + mark * np.exp(40 * (np.cos(seen) - 1))
        picture = np.broadcast_to(arms, (RING.rows, RING.columns))
        found.append((picture + rng.normal(0, 2, picture.shape)).astype(np.float32))
    return found


def taken(apparent, pictures):
    allowed = np.ones((RING.rows, RING.columns), dtype=bool)

    def template(angle):
        return learn(pictures, -angle, allowed, RING, separate=False, plain=True)

    return unaliased(
        apparent, FRAMES, template(apparent), lambda a: explained(pictures, -a, template(a))[0]
    ), template(apparent)


def test_of_two_equal_looking_rotations_the_one_that_slows_down_is_taken():
    apparent = TRUE + np.radians(120) * FRAMES
    assert np.all(np.diff(apparent) > 0)  # counter-clockwise, and faster and faster
    (angle, warning), template = taken(apparent, polars(TRUE))
    assert symmetries(template)[-1] == 3
    np.testing.assert_allclose(angle, TRUE, atol=1e-9)
    assert "looks the same when rotated by 120 degrees" in warning
    assert "-67 to -43 degrees per frame, and +53 to +77" in warning
    # the right one followed from the beginning is kept, with the same warning
    (angle, warning), _ = taken(TRUE, polars(TRUE))
    np.testing.assert_allclose(angle, TRUE, atol=1e-9)
    assert "looks the same when rotated by 120 degrees" in warning


def test_a_mark_on_one_arm_decides():
    (angle, warning), _ = taken(TRUE + np.radians(120) * FRAMES, polars(TRUE, mark=60.0))
    np.testing.assert_allclose(angle, TRUE, atol=1e-9)
    assert warning is None


@pytest.mark.parametrize(
    "angle", [TRUE / 10, 0.5 * np.sin(0.4 * FRAMES)], ids=["slow rotation", "oscillation"]
)
def test_a_motion_without_alternative_is_kept(angle):
    (found, warning), _ = taken(angle, polars(angle))
    assert found is angle
    assert warning is None


@pytest.mark.parametrize(("mark", "kept"), [(0.0, False), (60.0, True)])
def test_a_period_per_frame_too_much_is_removed_unless_the_pictures_show_it(mark, kept):
    apparent = TRUE / 10 - np.radians(120) * FRAMES
    (found, warning), _ = taken(apparent, polars(apparent if kept else TRUE / 10, mark))
    np.testing.assert_allclose(found, apparent if kept else TRUE / 10, atol=1e-9)
    assert (warning is None) == (not kept)


@pytest.mark.parametrize("speed", [20, 50, 100])
def test_of_two_steady_rotations_of_a_symmetric_body_the_slower_one_is_taken_with_a_warning(speed):
    """Up to a quarter period per frame the alternative is at least three times as fast: no warning."""
    angle = -np.radians(min(speed, 120 - speed) * FRAMES)
    (found, warning), _ = taken(angle, polars(angle))
    assert found is angle
    assert (warning is None) == (speed != 50)


def test_markers_that_seem_to_speed_up_may_slow_down_with_a_turn_per_frame_less():
    slows = 2 * np.pi * (0.8 * FRAMES - 0.2 * FRAMES**2 / (2 * FRAMES[-1]))  # 0.8 to 0.6 turns per frame
    seen = 2 * np.pi * FRAMES - slows
    np.testing.assert_allclose(slowing(seen, FRAMES), -slows, atol=1e-9)
    told = doubtful(seen, -slows, FRAMES)
    assert "fit the film: +" in told
    assert ", and -2" in told
    assert slowing(slows, FRAMES) is None
    assert slowing(0.3 * slows, FRAMES) is None
    # a casing that the rotor accelerates, slowly enough for the camera
    assert slowing(0.05 * FRAMES + 1e-3 * FRAMES**2, FRAMES) is None


TURN = 2 * np.pi
SIXTY_FRAMES = np.arange(60)


class TestAliasing:
    """Rotations of d per frame and of d less a period, with a body of `order` equal parts."""

    def choice(self, monkeypatch, angle, gain=0.0, order=3):
        monkeypatch.setattr(aliasing, "symmetries", lambda _: [order] if order > 1 else [])
        return unaliased(angle, SIXTY_FRAMES, None, lambda a: gain if a is not angle else 0.0)

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
        angle = step * period * SIXTY_FRAMES
        # a whole turn is tried as well: only periods of a third count here
        found = self.choice(monkeypatch, angle, gain=0.1)
        changed = (found.angle - angle)[1] if found.angle is not angle else 0.0
        expected = -math.copysign(period, step) if tried else 0.0
        assert changed == pytest.approx(expected) or (not tried and changed == pytest.approx(-TURN))

    def test_periods_are_subtracted_by_the_number_of_the_frame(self, monkeypatch):
        monkeypatch.setattr(aliasing, "symmetries", lambda _: [3])
        frame = np.delete(SIXTY_FRAMES, [5, 6, 30])
        found = unaliased(1.2 * TURN / 3 * frame, frame, None, lambda _: 0.0)
        assert found.angle == pytest.approx(0.2 * TURN / 3 * frame, abs=1e-9)

    @pytest.mark.parametrize(("gain", "other"), [(0.03, True), (0.01, False), (-0.03, False)])
    def test_pictures_decide_where_they_differ(self, monkeypatch, gain, other):
        """A steady rotation of 0.4 periods: without pictures the slower one, with a warning."""
        angle = 0.4 * TURN / 3 * SIXTY_FRAMES
        found = self.choice(monkeypatch, angle, gain=gain)
        assert (found.angle is not angle) is other
        assert (found.warning is not None) is (abs(gain) < 0.02)

    @pytest.mark.parametrize(("growth", "slows"), [(0.03, True), (0.01, False)])
    def test_the_one_that_slows_down_is_taken(self, growth, slows):
        """Of markers only whole turns are unknown: 0.6 turns per frame that fall by `growth`, seen as 0.4 turns."""
        x = SIXTY_FRAMES / SIXTY_FRAMES[-1]
        true = TURN * 0.6 * np.cumsum(1.0 - growth * 1.3 * x)
        found = slowing(true - TURN * SIXTY_FRAMES, SIXTY_FRAMES)
        assert (found is not None) is slows
        if slows:
            assert np.diff(found) == pytest.approx(np.diff(true))

    @pytest.mark.parametrize(("count", "known"), [(10, False), (30, True)])
    def test_few_frames_say_nothing(self, count, known):
        frame = np.arange(count)
        true = TURN * np.cumsum(0.6 - 0.2 * frame / count)
        assert (slowing(true - TURN * frame, frame) is not None) is known

    def test_speeds_at_the_ends_and_their_growth(self):
        angle = 0.5 * 0.01 * SIXTY_FRAMES**2 + 0.1 * SIXTY_FRAMES
        first, last = aliasing._ends(angle, SIXTY_FRAMES)
        assert first == pytest.approx(0.1 + 0.01 * 6.0)
        assert last == pytest.approx(0.1 + 0.01 * 53.0)
        assert aliasing._growth(angle, SIXTY_FRAMES) == pytest.approx(last / first - 1.0)
        assert aliasing._growth(-angle, SIXTY_FRAMES) == pytest.approx(last / first - 1.0)
        assert math.isnan(aliasing._growth((SIXTY_FRAMES - 30.0) ** 2, SIXTY_FRAMES))


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

        found = unaliased(angle, SIXTY_FRAMES, None, share)
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
        found = slowing(angle, SIXTY_FRAMES)
        assert (found is not None) == bool(periods)
        if periods:
            np.testing.assert_allclose(found, angle - sense * TURN * SIXTY_FRAMES)
