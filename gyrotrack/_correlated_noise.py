"""Least squares for samples whose errors are white and correlated, both of unknown size.

Neighbouring frames of a film share a part of their error. The residuals are described by white noise and a part that
is correlated over a time tau, K = s^2 (diag(sigma^2) + q exp(-|t - t'| / tau)); q and tau are averaged over their
posterior on a grid, s^2 is estimated by restricted maximum likelihood (D. A. Harville, J. Am. Stat. Assoc. 72, 1977).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

Floats = npt.NDArray[np.float64]

_BINS = 150  # means of neighbouring samples that a fit uses at most
_SHARES = (
    0.0,
    0.1,
    0.3,
    1.0,
    3.0,
    10.0,
    100.0,
)  # variance of the correlated part over that of a bin's white noise
_TIMES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # its correlation time in bins


@dataclass(frozen=True)
class Estimate:
    """Coefficients of a linear model, their covariance, and the criterion (BIC) of the model."""

    value: Floats
    covariance: Floats
    criterion: float

    def of(self, combination: Floats) -> tuple[float, float]:
        """Return a linear combination of the coefficients and its standard uncertainty."""
        variance = float(combination @ self.covariance @ combination)
        return float(combination @ self.value), math.sqrt(max(variance, 0.0))


def least_squares_of(
    t: Floats, design: Floats, y: Floats, sigma: Floats, models: Sequence[list[int]], prior: Floats
) -> list[Estimate]:
    """Fit y by columns of a design, with white and correlated noise of unknown size.

    Parameters
    ----------
    t, y, sigma : ndarray, shape (n,)
        Time [s], values, and their relative standard uncertainties.
    design : ndarray, shape (n, p)
        Columns.
    models : sequence of list of int
        The columns of each model.
    prior : ndarray, shape (p,)
        Standard deviations of Gaussian priors about zero, infinite for free coefficients.

    Returns
    -------
    list of Estimate
        One for each model.
    """
    x, z, white, when = _binned(t, design, y, sigma)
    n = len(z)
    scale = np.linalg.norm(x, axis=0) + 1e-300
    both = np.column_stack([x / scale, z])
    known = 1.0 / (prior * scale) ** 2
    plain = (both[:, :-1] / white[:, None]).T
    found: list[list[tuple[float, float, Floats, Floats]]] = [[] for _ in models]
    for _, _, root in _noises(white, when):
        noise = root @ root.T
        solved = solve_triangular(root, both, lower=True)
        log_noise = 2 * float(np.sum(np.log(np.diag(root))))
        gram = solved.T @ solved
        for model, kept in zip(models, found, strict=True):
            normal, right, rest = gram[np.ix_(model, model)], gram[model, -1], gram[-1, -1]
            size, ridge = 1.0, 1e-12 * np.trace(normal) * np.eye(len(model))
            for _ in range(
                3 if known[model].any() else 1
            ):  # the prior is in units of y, the noise in units of its unknown size
                precision = normal + np.diag(known[model] * size)
                inverse = np.linalg.inv(precision + ridge)
                c = inverse @ right
                free = max(n - float(np.sum(inverse * normal)), 1.0)
                size = max(float(rest - 2 * c @ right + c @ normal @ c), 1e-12 * float(rest)) / free
            likelihood = -0.5 * (n * math.log(size * free / n) + log_noise)
            log_normal = float(np.linalg.slogdet(precision)[1])
            restricted = -0.5 * (free * math.log(size) + log_noise + log_normal)
            # the coefficients are those of least squares, which do not depend on the form of the noise; their
            # covariance is that of this noise
            of_noise = plain[model] @ noise @ plain[model].T
            plain_normal = plain[model] @ both[:, model]
            weak = 1e-12 * np.trace(plain_normal) * np.eye(len(model))
            inflation = float(np.trace(np.linalg.solve(plain_normal + weak, of_noise))) / len(model)
            held = np.diag(known[model] * size * inflation)
            inverse = np.linalg.inv(plain_normal + held + weak)
            covariance = size * inverse @ (of_noise + held * inflation) @ inverse
            units = scale[model]
            kept.append(
                (
                    likelihood,
                    restricted,
                    inverse @ (plain[model] @ z) / units,
                    covariance / np.outer(units, units),
                )
            )
    estimates = []
    for model, kept in zip(models, found, strict=True):
        weights = _weights(np.array([k[1] for k in kept]))
        values = np.array([k[2] for k in kept])
        value = weights @ values
        spread = (weights[:, None] * (values - value)).T @ (values - value)
        covariance = np.tensordot(weights, np.array([k[3] for k in kept]), axes=1) + spread
        criterion = -2 * max(k[0] for k in kept) + len(model) * math.log(n)
        estimates.append(Estimate(value, covariance, criterion))
    return estimates


def slow_variance(t: Floats, design: Floats, residual: Floats, period: float) -> float:
    """Return the spectral density of residuals at a low frequency over that of independent ones of unit variance.

    Parameters
    ----------
    t, residual : ndarray, shape (n,)
        Time [s] and residuals in units of their uncertainty.
    design : ndarray, shape (n, p)
        The columns that were fitted, in the same units; what they take from the residuals is allowed for.
    period : float
        One over the frequency [s].

    Returns
    -------
    float
        At least 1: s^2 (1 + q sinh(1 / tau) / (cosh(1 / tau) - cos(2 pi / period))), times in bins; the geometric mean
        over the posterior of q and tau, whose tail is long.
    """
    x, z, white, when = _binned(t, design, residual, np.ones(len(t)))
    scale = np.linalg.norm(x, axis=0)
    x = x[:, scale > 1e-9 * scale.max()] / scale[scale > 1e-9 * scale.max()]
    n = len(z)
    turn = min(2 * math.pi * float(np.median(np.diff(when))) / period, math.pi)
    found = []
    for share, length, root in _noises(white, when):
        solved = solve_triangular(root, np.column_stack([x, z]), lower=True)
        gram = solved.T @ solved
        normal, right = gram[:-1, :-1], gram[:-1, -1]
        value, turned = np.linalg.eigh(normal)
        kept = value > 1e-9 * value[-1]
        free = max(n - int(kept.sum()), 1)
        along = turned[:, kept].T @ right
        size = max(float(gram[-1, -1] - np.sum(along**2 / value[kept])), 1e-300) / free
        logs = 2 * float(np.sum(np.log(np.diag(root)))) + float(np.sum(np.log(value[kept])))
        slow = math.sinh(1 / length) / (math.cosh(1 / length) - math.cos(turn))
        total = size * (1 + share * slow)
        found.append((-0.5 * (free * math.log(size) + logs), total))
    weights = _weights(np.array([f[0] for f in found]))
    return max(1.0, math.exp(float(weights @ np.log([f[1] for f in found]))))


def _binned(t: Floats, design: Floats, y: Floats, sigma: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return columns, values, variances and times of the weighted means of neighbouring samples."""
    edges = np.linspace(0, len(t), min(len(t), _BINS) + 1).astype(int)[:-1]
    weight = 1.0 / sigma**2
    total = np.add.reduceat(weight, edges)
    x = np.add.reduceat(design * weight[:, None], edges, axis=0) / total[:, None]
    z, when = (np.add.reduceat(v * weight, edges) / total for v in (y, t))
    return x, z, 1.0 / total, when


def _noises(white: Floats, when: Floats) -> Iterator[tuple[float, float, Floats]]:
    """Yield q, tau in bins, and the Cholesky factor of the noise, the white noise first."""
    apart = np.abs(when[:, None] - when[None, :]) / float(np.median(np.diff(when)))
    level = float(np.median(white))
    for share, length in [(0.0, 1.0), *((q, c) for q in _SHARES for c in _TIMES)]:
        noise = np.diag(white) + share * level * np.exp(-apart / length)
        yield share, length, np.asarray(np.linalg.cholesky(noise))


def _weights(logs: Floats) -> Floats:
    """Return the posterior of the noises; white noise is as likely beforehand as all the others together."""
    weights = np.exp(logs - logs.max())
    weights[1:] /= len(weights) - 1
    return np.asarray(weights / weights.sum())
