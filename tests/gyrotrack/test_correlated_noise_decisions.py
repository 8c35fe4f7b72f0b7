"""Least squares with correlated noise, against the formulas with explicit covariance matrices of all noise models."""

import numpy as np
import pytest

from gyrotrack._correlated_noise import Estimate, correlated_least_squares, slow_variance

RATIOS = (0.1, 0.3, 1.0, 3.0, 10.0, 100.0)
TIMES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
LENGTHS = (0.1, 0.3, 1.0, 3.0)


def noise_models(when, white, psi=None):
    """Return (a priori probability, q, tau, covariance) of each noise model."""
    lag = np.abs(when[:, None] - when) / np.median(np.diff(when))
    level = np.median(white)
    in_time = [(q, tau) for q in RATIOS for tau in TIMES]
    models = [[(0.0, 1.0, np.diag(white))]]
    models.append([(q, tau, np.diag(white) + level * q * np.exp(-lag / tau)) for q, tau in in_time])
    if psi is not None:
        cosine = np.cos(psi[:, None] - psi)
        waves = [p * cosine * np.exp(-lag / (c * len(when))) for p in RATIOS for c in LENGTHS]
        models.append([(0.0, 1.0, np.diag(white) + level * wave) for wave in waves])
        models.append([(q, tau, k + level * wave) for q, tau, k in models[1][::2] for wave in waves[::2]])
    rest = len(models) - 1
    return [
        ((1.0 if family == 0 else 1 / rest) / len(members), *member)
        for family, members in enumerate(models)
        for member in members
    ]


def estimate(x, y, white, when, prior, psi=None):
    """Return value, covariance and deviance of the fit."""
    n, held = len(y), np.diag(1 / prior**2)
    found = []
    w = np.diag(1 / white)
    plain = x.T @ w @ x
    for chance, _, _, k in noise_models(when, white, psi):
        inverse = np.linalg.inv(k)
        normal, size = x.T @ inverse @ x, 1.0
        for _ in range(3):
            precision = normal + size * held
            c = np.linalg.solve(precision, x.T @ inverse @ y)
            free = n - np.trace(np.linalg.solve(precision, normal))
            size = (y - x @ c) @ inverse @ (y - x @ c) / free
        log_noise = np.linalg.slogdet(k)[1]
        restricted = -0.5 * (free * np.log(size) + log_noise + np.linalg.slogdet(precision)[1])
        deviance = n * np.log(size * free / n) + log_noise
        of_noise = x.T @ w @ k @ w @ x
        inflation = np.trace(np.linalg.solve(plain, of_noise)) / x.shape[1]
        both = np.linalg.inv(plain + size * inflation * held)
        covariance = size * both @ (of_noise + size * inflation**2 * held) @ both
        found.append((chance, restricted, deviance, both @ x.T @ w @ y, covariance))
    chance, restricted, deviance, values, covariances = (np.array(part) for part in zip(*found, strict=True))
    weight = chance * np.exp(restricted - restricted.max())
    weight /= weight.sum()
    value = weight @ values
    scatter = (weight[:, None] * (values - value)).T @ (values - value)
    return value, np.tensordot(weight, covariances, axes=1) + scatter, deviance.min()


def series(count, seed=0):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 3, count))
    x = np.stack([np.ones(count), t, t**2], axis=1)
    sigma = rng.uniform(0.5, 1.5, count)
    walk = np.cumsum(rng.normal(0, 0.3, count))
    return t, x, x @ [1.0, -2.0, 0.5] + sigma * rng.normal(size=count) + walk, sigma


@pytest.mark.parametrize("prior", [(np.inf, np.inf, np.inf), (np.inf, 0.5, np.inf)])
@pytest.mark.parametrize("turns", [None, 2.0])
def test_fit_is_averaged_over_all_noise_models(prior, turns):
    t, x, y, sigma = series(25)
    psi = None if turns is None else 2 * np.pi * turns * np.linspace(0, 1, 25) ** 1.1
    prior = np.array(prior)
    fits = correlated_least_squares(t, x, y, sigma, [[0, 1, 2], [1, 2]], prior, psi)
    for fit, model in zip(fits, ([0, 1, 2], [1, 2]), strict=True):
        value, covariance, deviance = estimate(x[:, model], y, sigma**2, t, prior[model], psi)
        np.testing.assert_allclose(fit.value, value, rtol=1e-5)
        np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-4)
        assert fit.criterion == pytest.approx(deviance + len(model) * np.log(25), abs=1e-4)
        assert fit.hannan_quinn == pytest.approx(deviance + 2 * len(model) * np.log(np.log(25)), abs=1e-4)


def test_noise_is_harmonic_only_if_eight_samples_resolve_a_turn():
    t, x, y, sigma = series(30, 3)
    free = np.full(3, np.inf)
    (without,) = correlated_least_squares(t, x, y, sigma, [[0, 1, 2]], free)
    for per_turn, same in ((7.9, True), (8.1, False)):
        psi = 2 * np.pi / per_turn * np.arange(30)
        (fit,) = correlated_least_squares(t, x, y, sigma, [[0, 1, 2]], free, psi)
        assert bool(np.allclose(fit.covariance, without.covariance, rtol=1e-9)) == same
    uneven = 2 * np.pi / 20 * np.arange(30.0)
    uneven[15:] += 0.8  # one step above an eighth of a turn
    (fit,) = correlated_least_squares(t, x, y, sigma, [[0, 1, 2]], free, uneven)
    np.testing.assert_allclose(fit.covariance, without.covariance, rtol=1e-9)


def binned(t, x, y, sigma, edges):
    w = 1 / sigma**2
    parts = [slice(a, b) for a, b in zip(edges, [*edges[1:], len(t)], strict=True)]
    total = np.array([w[p].sum() for p in parts])
    mean = [np.array([np.sum(w[p] * v[p]) for p in parts]) / total for v in (*x.T, y, t)]
    return np.stack(mean[:-2], axis=1), mean[-2], 1 / total, mean[-1]


def test_more_than_150_samples_are_averaged_in_150_bins():
    t, x, y, sigma = series(300, 5)
    edges = list(range(0, 300, 2))
    columns, values, white, when = binned(t, x, y, sigma, edges)
    (fit,) = correlated_least_squares(t, x, y, sigma, [[0, 1, 2]], np.full(3, np.inf))
    value, covariance, deviance = estimate(columns, values, white, when, np.full(3, np.inf))
    np.testing.assert_allclose(fit.value, value, rtol=1e-5)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-4)
    assert fit.criterion == pytest.approx(deviance + 3 * np.log(150), abs=1e-4)


@pytest.mark.parametrize("period", [0.5, 3.0, 0.02])
def test_density_at_low_frequencies_is_a_geometric_mean_over_the_noise_models(period):
    t, x, y, _ = series(40, 7)
    columns = np.column_stack([x, np.zeros(40)])  # a column of zeros is ignored
    residual = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    found = []
    turn = min(2 * np.pi * np.median(np.diff(t)) / period, np.pi)
    for chance, q, tau, k in noise_models(t, np.ones(40)):
        inverse = np.linalg.inv(k)
        normal = x.T @ inverse @ x
        c = np.linalg.solve(normal, x.T @ inverse @ residual)
        size = (residual - x @ c) @ inverse @ (residual - x @ c) / 37
        logs = -0.5 * (37 * np.log(size) + np.linalg.slogdet(k)[1] + np.linalg.slogdet(normal)[1])
        slow = np.sinh(1 / tau) / (np.cosh(1 / tau) - np.cos(turn))
        found.append((chance, logs, np.log(size * (1 + q * slow))))
    chance, logs, density = np.array(found).T
    weight = chance * np.exp(logs - logs.max())
    expected = max(np.exp(weight @ density / weight.sum()), 1.0)
    assert slow_variance(t, columns, residual, period) == pytest.approx(expected, rel=1e-4)
    assert slow_variance(t, columns, 1e-3 * residual, period) == 1.0


def test_combination_of_coefficients():
    fit = Estimate(np.array([1.0, 2.0]), np.array([[4.0, 1.0], [1.0, 9.0]]), 0.0, 0.0)
    assert fit.of(np.array([2.0, 1.0])) == (4.0, pytest.approx(np.sqrt(29)))
    assert Estimate(np.ones(1), np.array([[-1e-20]]), 0.0, 0.0).of(np.ones(1)) == (1.0, 0.0)
