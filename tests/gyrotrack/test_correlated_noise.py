"""White and correlated noise of unknown size: what is found, and whether its uncertainties are true."""

import numpy as np
import pytest

from gyrotrack._correlated_noise import correlated_least_squares, slow_variance


def correlated(rng, n, sigma, samples):
    """Return noise with the covariance sigma^2 exp(-|k| / samples)."""
    share = np.exp(-1 / samples)
    steps = rng.normal(0, sigma * np.sqrt(1 - share**2), n)
    out = np.empty(n)
    last = rng.normal(0, sigma)
    for k in range(n):
        out[k] = last = share * last + steps[k]
    return out


def test_white_noise_is_white_at_low_frequencies():
    t = np.arange(1500) / 500
    design = np.stack([t**k for k in range(4)], axis=1)
    found = []
    for seed in range(8):
        y = np.random.default_rng(seed).normal(size=len(t))
        residual = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
        found.append(slow_variance(t, design, residual, 3.0))
    assert np.median(found) < 1.5


def test_correlated_noise_is_strong_at_low_frequencies():
    t = np.arange(1500) / 500
    design = np.stack([t**k for k in range(4)], axis=1)
    found = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        y = rng.normal(size=len(t)) + correlated(rng, len(t), 0.7, 50)
        residual = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
        found.append(slow_variance(t, design, residual, 3.0))
    angle = 2 * np.pi / 1500
    truth = 1 + 0.49 * np.sinh(1 / 50) / (np.cosh(1 / 50) - np.cos(angle))
    assert 0.5 * truth < np.exp(np.mean(np.log(found))) < 2 * truth


@pytest.mark.parametrize("samples", [0, 20])
def test_uncertainty_of_a_slope(samples):
    t = np.linspace(-1, 1, 600)
    design = np.stack([np.ones_like(t), t, t**2], axis=1)
    free = np.full(3, np.inf)
    z = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        y = 2 * t + rng.normal(0, 1e-3, len(t))
        y += correlated(rng, len(t), 1e-3, samples) if samples else 0
        (fit,) = correlated_least_squares(t, design, y, np.full(len(t), 0.5), [[0, 1, 2]], free)
        value, u = fit.of(np.array([0.0, 1.0, 0.0]))
        z.append((value - 2) / u)
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.4


def test_a_prior_holds_what_the_data_do_not_determine():
    t = np.linspace(0, 1, 200)
    design = np.stack([t, t + 1e-6 * t**2], axis=1)
    y = 3 * t + np.random.default_rng(0).normal(0, 1e-3, len(t))
    (fit,) = correlated_least_squares(t, design, y, np.full(len(t), 1e-3), [[0, 1]], np.array([np.inf, 0.1]))
    value, u = fit.of(np.array([0.0, 1.0]))
    assert abs(value) < 0.1
    assert u == pytest.approx(0.1, rel=0.1)
    assert fit.of(np.array([1.0, 1.0]))[0] == pytest.approx(3, abs=0.01)


@pytest.mark.parametrize("count", [60, 400])
def test_penalties_of_the_criteria(count):
    """A column that explains nothing costs ln n and 2 ln ln n; n is the number of bins, at most 150."""
    t = np.linspace(0, 1, count)
    y = np.random.default_rng(3).normal(0, 1, count)
    zero = np.zeros(count)
    zero[0] = 1e-9
    design = np.stack([np.ones(count), zero], axis=1)
    short, long = correlated_least_squares(
        t, design, y, np.ones(count), [[0], [0, 1]], np.array([np.inf, 1e-6])
    )
    n = min(count, 150)
    assert long.criterion - short.criterion == pytest.approx(np.log(n), abs=0.02)
    assert long.hannan_quinn - short.hannan_quinn == pytest.approx(2 * np.log(np.log(n)), abs=0.02)
