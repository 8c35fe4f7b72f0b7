import tracemalloc

import numpy as np
import pytest

from gyrotrack.tracking._hub import wandering_centre


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


@pytest.mark.slow
def test_a_long_film_takes_little_memory():
    k = np.arange(12_000)
    place = 200 + 85 * np.stack([np.cos(0.25 * k), -np.sin(0.25 * k)], axis=1)  # 477 turns, 400 knots
    tracemalloc.start(1)
    try:
        path = wandering_centre(place, np.ones(len(k), dtype=bool), np.array([199.0, 201.0]), rounds=3)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert np.abs(path.centre - 200.0).max() < 1e-6
    assert most < 25e6  # a matrix of all frames and knots has 77 MB


@pytest.mark.slow
def test_a_gap_leaves_the_rest_of_the_path_in_place():
    k = np.arange(2000)
    place = 200 + 85 * np.stack([np.cos(1.1 * k), -np.sin(1.1 * k)], axis=1)
    seen = np.abs(k - 900) > 150
    path = wandering_centre(place, seen, np.array([199.0, 201.0]))
    assert np.abs(path.centre[np.abs(k - 900) > 170] - 200.0).max() < 1e-6
    assert np.abs(path.centre - 200.0).max() < 3.0
