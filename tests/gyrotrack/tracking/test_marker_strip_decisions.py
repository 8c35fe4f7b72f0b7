"""Windows about a marker in drawn frames: its place, its score of one, the background, and a ring that moves."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking._film_tracker import BodyTracker
from gyrotrack.tracking._marker_window import MarkerStrip, common_columns
from gyrotrack.tracking._scene import Marker

TURN = 2 * np.pi
CENTRE = (100.0, 80.5)
MARKER = Marker("blue", "rotor", "blue", 40.0, 60.0, 0.12, (30.0, -20.0), 0.16)


def drawn(angle, shift=0.0, ground=0):
    """Return a frame with a marker at an angle, counter-clockwise; its centre is displaced to the right."""
    y, x = np.mgrid[0:80, 0:100]
    # pixels of the chroma are at (0, 0.5) px of the luma
    right, up = 2.0 * x - CENTRE[0] - shift, CENTRE[1] - (2.0 * y + 0.5)
    away, direction = np.hypot(right, up), np.angle(np.exp(1j * (np.arctan2(up, right) - angle)))
    share = np.clip((0.12 - np.abs(direction)) * away / 2.0 + 0.5, 0, 1) * np.clip(
        (10.0 - np.abs(away - 50.0)) / 2.0 + 0.5, 0, 1
    )
    u = 128 + ground * (x // 20) + 30.0 * share
    return SimpleNamespace(
        u=np.rint(u).astype(np.uint8),
        v=np.rint(128 - 20.0 * share).astype(np.uint8),
        y=np.zeros((160, 200), np.uint8),
    )


@pytest.fixture(scope="module")
def strip():
    """A strip with the background of eight frames; it has room for six frames."""
    frames = [drawn(0.8 * k, ground=3) for k in range(8)]
    samples = SimpleNamespace(frames=frames, spread=tuple(range(8)))
    columns = common_columns((MARKER,), CENTRE)
    return MarkerStrip(MARKER, samples, CENTRE, 5.0, columns, 0.1, 6)


def test_the_columns_of_a_body_are_those_of_its_largest_marker():
    larger = SimpleNamespace(outer=90.0)
    # 1.4 pi (0.7 r + r) / 2 px, rounded up
    assert common_columns((MARKER, larger, MARKER), CENTRE) == int(np.ceil(1.4 * np.pi * 1.7 * 90 / 2))
    assert common_columns((MARKER,), CENTRE) == int(np.ceil(1.4 * np.pi * 1.7 * 60 / 2))


@pytest.mark.parametrize("off", [0.0, 0.03, -0.06, 0.09])
def test_a_marker_is_located_relative_to_given_angles(strip, off):
    angle = np.array([0.3, 3.0, -2.5])
    strip.take([drawn(a + off, ground=3) for a in angle], 2, angle + 0.004)
    found, height = strip.locate(angle, slice(2, 5))
    np.testing.assert_allclose(found * strip.ring.step, off, atol=4e-3)
    # the mean over the width of the marker includes its blurred edges
    np.testing.assert_allclose(height, 0.9, atol=0.05)


def test_a_marker_beyond_the_margin_is_not_located(strip):
    strip.take([drawn(0.3 + 0.15)], 0, np.array([0.3]))
    assert strip.locate(np.array([0.3]), slice(0, 1))[1][0] < 0.6


def test_a_score_is_one_on_the_marker_and_zero_beside_it(strip):
    strip.take([drawn(1.0, ground=3)], 0, np.array([1.0]))
    window = strip.windows[0]
    column = (np.arange(strip.width) - strip.half + round(1.0 / strip.ring.step)) * strip.ring.step - 1.0
    inside = window[strip.rows][:, np.abs(column) < 0.06]
    assert inside.min() > 0.9
    assert inside.max() < 1.1
    assert np.abs(window[:, np.abs(column) > 0.2]).max() < 0.1
    beyond = np.abs(strip.ring.radii - 50.0) > 13.0
    assert beyond.any()
    assert np.abs(window[beyond]).max() < 0.1
    assert (np.abs(strip.ring.radii[strip.rows] - 50.0) <= 8.0).all()


def test_the_score_at_all_angles_has_its_maximum_at_the_marker(strip):
    around = strip.whole([drawn(2.0, ground=3), drawn(-1.0, ground=3)])
    assert around.shape == (2, strip.ring.columns)
    angle = np.arange(strip.ring.columns) * strip.ring.step
    for row, at in zip(around, (2.0, -1.0), strict=True):
        apart = np.abs(np.angle(np.exp(1j * (angle - at))))
        assert row[apart < 0.05].min() > 0.9
        assert np.abs(row[apart > 0.25]).max() < 0.1
    # the background in heights of the marker: 3 grey levels of U for each 40 px, of 36 for the marker
    assert strip.ground.shape == (strip.ring.columns,)
    right, left = strip.ground[0], strip.ground[strip.ring.columns // 2]
    assert right - left == pytest.approx(3 * 2 * 30 / (30**2 + 20**2), rel=0.4)


def test_a_ring_that_moves_sees_a_displaced_body(strip):
    try:
        strip.centre_on((CENTRE[0] + 6.0, CENTRE[1]))
        assert strip.grid.ring.centre == (106.0, 80.5)
        strip.take([drawn(1.4, shift=6.0, ground=3)], 0, np.array([1.4]))
        found, height = strip.locate(np.array([1.4]), slice(0, 1))
        assert abs(found[0] * strip.ring.step) < 5e-3
        assert height[0] == pytest.approx(0.9, abs=0.08)
    finally:
        strip.centre_on(CENTRE)


def test_a_copy_has_the_windows_if_there_are_frames(strip):
    frame = drawn(0.5)
    strip.take([frame], 3, np.array([0.5]))
    again = pickle.loads(pickle.dumps(strip))  # noqa: S301 - own data
    np.testing.assert_array_equal(again.windows, strip.windows)
    unused = MarkerStrip(
        MARKER,
        SimpleNamespace(frames=[frame] * 8, spread=(0, 1, 2)),
        CENTRE,
        5.0,
        strip.ring.columns,
        0.1,
        200,
    )
    text = pickle.dumps(unused)
    assert len(text) < unused.windows.nbytes / 4
    copy = pickle.loads(text)  # noqa: S301 - own data
    assert copy.windows.shape == unused.windows.shape
    assert not copy.windows.any()


ANGLE = 0.3 + 0.17 * np.arange(36) + 0.2 * np.sin(np.arange(36) / 9.0)


@pytest.fixture(scope="module")
def tracked():
    """A body with one marker: the tracker, its step after 20 of 36 frames, and what is observed."""
    frames = [drawn(a, ground=3) for a in ANGLE]
    samples = SimpleNamespace(frames=frames[::4], spread=tuple(range(9)))
    body = BodyTracker("rotor", (MARKER,), samples, CENTRE, 5.0, 40)
    body.take(frames[:20], 0, np.ones(20))
    first = body.step
    body.take(frames[20:], 20, np.ones(16))
    return body, first, body.measure_batch(36, None, again=False)


def test_a_body_is_followed_from_frame_to_frame(tracked):
    body, first, (coarse, _) = tracked
    turns = np.round((coarse[0] - ANGLE[0]) / TURN)
    np.testing.assert_allclose(coarse - turns * TURN, ANGLE, atol=0.02)
    assert first == pytest.approx(np.diff(ANGLE[:20]).mean(), rel=0.05)
    assert body.step == pytest.approx(np.diff(ANGLE[20:]).mean(), rel=0.05)
    np.testing.assert_array_equal(body.coarse(20, 16), coarse[20:])


def test_angle_radius_and_corners_of_a_marker_are_those_drawn(tracked):
    seen = tracked[2][1]["blue"]
    off = np.angle(np.exp(1j * (seen.angle - ANGLE)))
    assert np.abs(off).max() < 8e-3
    assert seen.open.all()
    np.testing.assert_allclose(seen.radius, 50.0, atol=1.0)
    np.testing.assert_allclose(seen.gain, 1.0, atol=0.15)
    assert np.median(seen.misfit) < 0.05
    np.testing.assert_array_equal(seen.centre, np.tile(CENTRE, (36, 1)))
    known = np.isfinite(seen.corner_angle).all(axis=1)
    assert known.mean() > 0.8
    # the corners of the near edge, at 0.12 rad on either side and 40 px
    corner = np.angle(np.exp(1j * (seen.corner_angle - ANGLE[:, None])))[known]
    np.testing.assert_allclose(np.median(corner, axis=0), [-0.12, 0.12], atol=0.02)
    assert np.median(seen.corner_radius[known]) == pytest.approx(40.0, abs=1.5)
    assert np.median(seen.weakness) == pytest.approx(1.0, abs=0.15)
