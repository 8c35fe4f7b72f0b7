"""The width of the medians that give the angular velocity, against motions whose velocity is known."""

import numpy as np
import pytest

from gyrotrack._smoothing import WIDTH, angular_velocity, smoothing_width


@pytest.mark.parametrize("period", [25.0, 70.0, 400.0])
def test_velocity_of_an_oscillation_is_not_smoothed_away(period):
    rng = np.random.default_rng(0)
    t = np.arange(4000.0)
    omega = 2 * np.pi / period
    angle = 0.3 * np.sin(omega * t) + rng.normal(0, 1e-4, t.size)
    sigma = np.full(t.size, 1e-4)
    measured, _ = angular_velocity(t, angle, sigma, smoothing_width(angle, sigma))
    known = np.isfinite(measured)
    true = 0.3 * omega * np.cos(omega * t)
    assert np.std(measured[known] - true[known]) < 0.15 * np.std(true)


@pytest.mark.parametrize(
    "angle",
    [
        lambda t, rng: 30 * t - 0.1 * t**2,  # spin-down
        lambda t, rng: 3.5 * t + 0.02 * rng.normal(size=t.size),  # steady, with more noise than stated
        lambda t, rng: 1e-3 * rng.normal(size=t.size),  # at rest
    ],
    ids=["spin-down", "steady", "rest"],
)
def test_bodies_that_do_not_turn_back_keep_the_width_of_the_paper(angle):
    t = np.linspace(0, 60, 4000)
    assert smoothing_width(angle(t, np.random.default_rng(1)), np.full(t.size, 1e-3)) == WIDTH
