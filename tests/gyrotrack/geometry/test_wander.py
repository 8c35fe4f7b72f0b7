import numpy as np
import pytest

from gyrotrack.geometry.wander import wandering_centre


@pytest.mark.parametrize("still", [False, True])
def test_a_centre_that_wanders_is_followed_if_it_may(still):
    rng = np.random.default_rng(6)
    k = np.arange(1200)
    centre = np.stack([250 + 6.0 * k / 1200, 160 + 4.0 * np.sin(k / 300)], axis=1)
    theta = 0.08 * k
    place = centre + 85 * np.stack([np.cos(theta), -np.sin(theta)], axis=1) + rng.normal(0, 0.3, (1200, 2))
    path = wandering_centre(place, np.ones(1200, dtype=bool), np.array([240.0, 150.0]), still=still)
    error = np.hypot(*(path.centre - centre).T)
    if still:
        assert np.ptp(path.centre, axis=0).max() == 0
        assert np.hypot(*(path.centre[0] - centre.mean(axis=0))) < 0.5
    else:
        assert error.mean() < 0.25
