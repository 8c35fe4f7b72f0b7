"""Decisions about points and cameras on either side of their limits, and the error that a link shares."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack.tracking import _diagnosis, _point_motion
from gyrotrack.tracking._diagnosis import MOSTLY_TRANSLATES, RefusedFilmError, refuse_moving_camera
from gyrotrack.tracking._point_motion import TrackedPoint


@pytest.mark.parametrize(("steps", "retraces"), [(4, True), (6, False)])
def test_a_step_of_five_times_the_median_is_a_jump(steps, retraces):
    """A ball is thrown again and again: only a return in small steps retraces the path."""
    angle = np.tile(np.linspace(0.0, 1.0, steps + 1), 8)
    place = 100.0 * np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    path = SimpleNamespace(place=place, frame=np.arange(len(angle)), searched=len(angle))
    found = SimpleNamespace(path=path, angle=angle, arc=SimpleNamespace(noise=0.1, by_place=0.0))
    if retraces:
        _point_motion._check_unselected(found, "film")
    else:
        with pytest.raises(TrackingError, match="No point that moves about a pivot"):
            _point_motion._check_unselected(found, "film")


@pytest.mark.parametrize(("off", "refused"), [(0.69, False), (0.71, True)])
def test_a_picture_that_mostly_translates_is_not_a_suspended_body(off, refused, monkeypatch):
    """The limit is an rms residual of 70 % from the displacements about the best hub."""
    monkeypatch.setattr(_diagnosis, "camera_motion", lambda *_: (2.0, 0.9, off))
    film = SimpleNamespace(path=SimpleNamespace(name="film"), some=lambda index: [None] * len(index))
    if refused:
        with pytest.raises(RefusedFilmError, match="residual 71 %"):
            refuse_moving_camera(film, np.arange(9), [], (9, 9), MOSTLY_TRANSLATES)
    else:
        refuse_moving_camera(film, np.arange(9), [], (9, 9), MOSTLY_TRANSLATES)


def test_the_angles_of_a_link_share_the_errors_of_pivot_and_place():
    """At 50 px, sqrt(0.4^2 + (0.8^2 + 0.6^2) / 2) px = 0.812 px are 16.2 mrad, beside 10 mrad."""
    place = np.array([[60.0, 10.0], [10.0, 60.0]])
    found = SimpleNamespace(
        place=place,
        hub=np.array([10.0, 10.0]),
        hub_covariance=np.diag([0.64, 0.36]),
        arc=SimpleNamespace(by_place=0.4),
        sigma=np.array([0.01, 0.01]),
    )
    sigma = TrackedPoint.whole_sigma.fget(found)
    assert sigma == pytest.approx([np.hypot(0.01, np.sqrt(0.66) / 50.0)] * 2)
