"""The standard uncertainty that is estimated from the scatter of the samples."""

import numpy as np
import pytest

from gyrotrack.io.readers._motion_table import scatter


def noise(n, sigma, seed=0):
    return sigma * np.random.default_rng(seed).standard_normal(n)


@pytest.mark.parametrize("per_period", [1000, 44, 30, 12, 4])
def test_an_oscillation_with_few_samples_a_period_is_not_noise(per_period):
    """Cubics leave 4.5 mrad of it at 44 samples a period, and most of the amplitude at 12 and 4."""
    angle = 1.4 * np.cos(2 * np.pi * np.arange(900) / per_period)
    found = np.median(scatter(np.arange(900) / 40, angle + noise(900, 2e-3)))
    assert found == pytest.approx(2e-3, rel=0.12)


def test_white_noise_has_the_scatter_of_cubics():
    """chi2 / dof of 11 degrees of freedom has the median (1 - 2/99)^3; higher degrees are not used for white noise."""
    value = noise(615, 1.0)
    t = np.arange(615.0)
    blocks = [np.polynomial.Polynomial.fit(t[i : i + 15], value[i : i + 15], 3) for i in range(0, 615, 15)]
    rest = np.concatenate(
        [value[15 * k : 15 * k + 15] - b(t[15 * k : 15 * k + 15]) for k, b in enumerate(blocks)]
    )
    variance = np.median((rest.reshape(-1, 15) ** 2).sum(axis=1) / 11)
    expected = np.sqrt(variance / (1 - 2 / 99) ** 3)
    assert scatter(t, value)[307] == pytest.approx(expected, rel=1e-9)  # the middle has all 41 blocks


def test_correlated_noise_is_that_of_cubics():
    """Degree 5 takes a quarter more of a random walk, which is no motion."""
    white = noise(6150, 1.0)
    red = np.zeros_like(white)
    for k in range(1, len(red)):
        red[k] = 0.9 * red[k - 1] + white[k]
    t = np.arange(6150.0)
    rest = [
        np.polynomial.Polynomial.fit(t[i : i + 15], red[i : i + 15], 3)(t[i : i + 15]) - red[i : i + 15]
        for i in range(0, 6150, 15)
    ]
    cubic = np.sqrt(np.median([r @ r / 11 for r in rest]) / (1 - 2 / 99) ** 3)
    assert np.median(scatter(t, red)) == pytest.approx(cubic, rel=0.03)


def test_a_floor_is_a_lower_bound_and_a_body_at_rest_shows_no_noise():
    value = np.concatenate([noise(900, 1e-3), np.zeros(900)])
    t = np.arange(1800.0)
    assert scatter(t, value)[1600:] == pytest.approx(1e-3, rel=0.2)
    assert scatter(t, value, 5e-3).tolist() == [5e-3] * 1800
    assert scatter(t, np.zeros(1800), 1e-4).tolist() == [1e-4] * 1800


@pytest.mark.parametrize("n", [8, 12, 14, 15])
def test_short_records_have_a_scatter(n):
    found = np.array([np.median(scatter(np.arange(n) / 10, noise(n, 1.0, seed))) for seed in range(200)])
    assert 0.75 < np.median(found) < 1.25
