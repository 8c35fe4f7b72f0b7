"""Temporal aliasing of bodies with a symmetry: polar pictures computed at known angles."""

import numpy as np
import pytest

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
