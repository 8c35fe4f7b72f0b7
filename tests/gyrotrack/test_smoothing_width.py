"""The width of the medians that give the angular velocity, against motions whose velocity is known."""

from math import erfc

import numpy as np
import pytest

from gyrotrack import _smoothing
from gyrotrack._smoothing import WIDTH, angular_velocity, running_quantile, smoothing_width


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


@pytest.mark.parametrize("values", ["steady", "noise", "with a gap"])
@pytest.mark.parametrize("width", [5, WIDTH])
def test_running_medians_of_long_and_short_records_are_the_same(monkeypatch, values, width):
    x = np.random.default_rng(0).normal(size=300)
    x = {"steady": np.ones(300), "noise": x, "with a gap": np.where(np.arange(300) == 40, np.nan, x)}[values]
    short = running_quantile(x, width, width // 2)
    monkeypatch.setattr(_smoothing, "_MANY", 299)
    np.testing.assert_array_equal(running_quantile(x, width, width // 2), short)
    around = np.concatenate([np.full(width // 2, x[0]), x, np.full(width // 2, x[-1])])
    np.testing.assert_array_equal(short, [np.sort(around[k : k + width])[width // 2] for k in range(len(x))])


@pytest.mark.parametrize("trend", [0.0, 1e-3, 0.03, 0.1, 1.0, 7.9, 8.1, 50.0, -0.1])
def test_sigma_of_a_median_of_differences_with_a_trend(trend):
    place = trend * np.arange(-25, 26)
    density = np.exp(-(place**2) / 2) / np.sqrt(2 * np.pi)
    p = np.array([0.5 * erfc(-u / np.sqrt(2)) for u in place])
    a, b = place[2:], place[:-2]
    shared = -1 / 2 + a * b / 8 - (a**2 - 1) * (b**2 - 1) / 48
    variance = np.sum(p * (1 - p)) + 2 * np.sum(shared * density[2:] * density[:-2])
    found = _smoothing._median_sigma(np.full(3, 2.0), np.full(3, 2 * trend), WIDTH)
    np.testing.assert_allclose(found, 2 * np.sqrt(variance) / density.sum(), rtol=1e-5)


def test_sigma_of_a_median_is_unknown_where_the_noise_is_zero():
    assert np.isnan(_smoothing._median_sigma(np.zeros(2), np.ones(2), WIDTH)).all()
