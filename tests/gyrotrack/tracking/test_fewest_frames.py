"""Ten pictures determine a motion; nine are refused."""

import cv2
import numpy as np
import pytest

from gyrotrack import DatasetError, TrackingError, VideoError
from gyrotrack.apps._motion import motion_of
from gyrotrack.tracking._any_body import track_body
from gyrotrack.tracking._film import FEWEST_FRAMES, Film
from gyrotrack.tracking._point_tracker import track_point
from gyrotrack.tracking._scene import FEWEST, take_samples

STEP = 0.12  # rotation from frame to frame [rad]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Pictures, named by their number alone, of a textured disc of 24 px that turns counter-clockwise."""
    path = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(4)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (64, 64)).astype(np.float32), (0, 0), 2.0)
    picture = cv2.normalize(picture, None, 20, 230, cv2.NORM_MINMAX)
    v, u = np.mgrid[0:64, 0:64]
    for k in range(FEWEST_FRAMES):
        turn = cv2.getRotationMatrix2D((32.0, 31.0), np.degrees(STEP * k), 1.0)
        frame = np.where(np.hypot(u - 32, v - 31) < 24, cv2.warpAffine(picture, turn, (64, 64)), 120.0)
        frame += rng.normal(0.0, 1.0, frame.shape)
        cv2.imwrite(str(path / f"{k:03d}.png"), frame.clip(0, 255).astype(np.uint8))
    return path


@pytest.mark.slow
def test_ten_pictures_are_tracked(folder):
    found = track_body(Film(folder))
    assert len(found.frame) == FEWEST_FRAMES
    assert np.diff(found.angle) == pytest.approx(STEP, abs=0.01)


@pytest.mark.parametrize("track", [track_body, lambda film: track_point(film, (20.0, 20.0), lambda *_: None)])
def test_nine_pictures_are_refused(folder, track):
    film = Film(folder)
    film.selected[-1] = False
    with pytest.raises(TrackingError, match=r"only 9 different frames.*10 are required"):
        track(film)


@pytest.mark.parametrize("count", [FEWEST_FRAMES, FEWEST_FRAMES - 1])
def test_a_motion_has_ten_samples(count):
    time = np.arange(count) / 30.0
    angle = 3.0 * time + np.random.default_rng(0).normal(0.0, 1e-3, count)
    if count < FEWEST_FRAMES:
        with pytest.raises(DatasetError, match="9 samples; 10 are needed"):
            motion_of(time, angle, np.full(count, 1e-3))
    else:
        found = motion_of(time, angle, np.full(count, 1e-3))
        assert found.omega_mean.value == pytest.approx(3.0, abs=3.0 * found.omega_mean.stderr)


@pytest.mark.parametrize(("frames", "taken"), [(FEWEST, True), (FEWEST - 1, False)])
def test_a_film_of_eight_frames_is_sampled(draw, frames, taken):
    path, _ = draw(width=64, height=48, radius=20.0, frames=frames)
    if taken:
        assert len(take_samples(path).frames) == FEWEST
    else:
        with pytest.raises(VideoError, match="only 7 frames; at least 8 are required"):
            take_samples(path)
