"""Least squares for samples with white and correlated noise, both of unknown variance.

The errors of neighbouring frames of a film are correlated. The covariance of the residuals is

    K = s^2 [diag(sigma^2) + q exp(-|t - t'| / tau) + p cos(psi - psi') exp(-|t - t'| / T)].

The last term, a harmonic of the angle with a slowly varying amplitude, applies to a body of known angle psi whose hub
or camera moves slowly. The results are averaged over the posterior of q, tau, p and T on a grid. s^2 is estimated by
restricted maximum likelihood (D. A. Harville, J. Am. Stat. Assoc. 72, 1977).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtrtrs

Floats = npt.NDArray[np.float64]

_MAX_BINS = 150  # largest number of bins; neighbouring samples in a bin are replaced by their mean
_VARIANCE_RATIOS = (0.1, 0.3, 1.0, 3.0, 10.0, 100.0)  # q and p, divided by the white variance of a bin
_TIMES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # tau [bins]
_HARMONIC_TIMES = (0.1, 0.3, 1.0, 3.0)  # T [lengths of the record]
_MIN_BINS_PER_TURN = 8


@dataclass(frozen=True)
class Estimate:
    """Coefficients of a linear model, their covariance, and two information criteria of the model.

    With k coefficients and n bins, the penalties are k ln(n) in the Bayesian `criterion`, which selects the true
    model, and 2 k ln(ln(n)) in the criterion of Hannan and Quinn (J. R. Stat. Soc. B 41, 190 (1979)).
    """

    value: Floats
    covariance: Floats
    criterion: float
    hannan_quinn: float

    def of(self, combination: Floats) -> tuple[float, float]:
        """Return a linear combination of the coefficients and its standard uncertainty."""
        variance = float(combination @ self.covariance @ combination)
        return float(combination @ self.value), math.sqrt(max(variance, 0.0))


def correlated_least_squares(
    t: Floats,
    design: Floats,
    y: Floats,
    sigma: Floats,
    models: Sequence[list[int]],
    prior: Floats,
    psi: Floats | None = None,
) -> list[Estimate]:
    """Fit y (n,) by columns of a design matrix (n, p), with white and correlated noise of unknown variance.

    `t` are times [s], and `sigma` are relative standard uncertainties. `models` lists the indices of the columns of
    each model. `prior` (p,) contains the standard deviations of Gaussian priors about zero, infinite for free
    coefficients. With the smooth angle `psi` [rad], the noise model includes noise that is harmonic in the angle.
    """
    x, z, white, when = _binned(t, design, y, sigma)
    n = len(z)
    scale = np.linalg.norm(x, axis=0) + 1e-300
    both = np.column_stack([x / scale, z])
    known = 1.0 / (prior * scale) ** 2
    plain = (both[:, :-1] / white[:, None]).T
    psi_binned = None if psi is None else np.interp(when, t, psi)
    families, products, logs, scatter = [], [], [], []
    for family, _, _, noise in _noise_models(white, when, psi_binned):
        root = np.linalg.cholesky(noise)
        # `solve_triangular` calls the same function, but its checks take as long as the solution
        solved = dtrtrs(root.T, both, lower=0, trans=1)[0]
        families.append(family)
        products.append(solved.T @ solved)
        logs.append(2 * np.sum(np.log(root.diagonal())))
        scatter.append(plain @ noise @ plain.T)
    # for each noise model: products of columns and values, log-determinant, and covariance of the products `plain` @ y
    grams, log_noise, noise_of_plain = np.array(products), np.array(logs), np.array(scatter)
    plain_products = plain @ both
    estimates = []
    for model in models:
        square = np.ix_(model, model)
        normal, right, rest = grams[:, square[0], square[1]], grams[:, model, -1], grams[:, -1, -1]
        one = np.eye(len(model))
        size, ridge = np.ones(len(grams)), 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * one
        # the prior is in units of y, the noise in units of its unknown variance
        for _ in range(3 if known[model].any() else 1):
            precision = normal + size[:, None, None] * np.diag(known[model])
            inverse = np.linalg.inv(precision + ridge)
            c = np.linalg.vecdot(inverse, right[:, None])
            free = np.maximum(n - np.sum(inverse * normal, axis=(1, 2)), 1.0)
            square_sum = (
                rest
                - 2 * np.linalg.vecdot(c, right)
                + np.linalg.vecdot(c, np.linalg.vecdot(normal, c[:, None]))
            )
            size = np.maximum(square_sum, 1e-12 * rest) / free
        likelihood = -0.5 * (n * np.log(size * free / n) + log_noise)
        log_normal = np.linalg.slogdet(precision)[1]
        restricted = -0.5 * (free * np.log(size) + log_noise + log_normal)
        # the coefficients come from weighted least squares and do not depend on the noise model; their covariance is
        # computed for this noise model
        of_noise, plain_normal = noise_of_plain[:, square[0], square[1]], plain_products[square]
        weak = 1e-12 * np.trace(plain_normal) * one
        inflation = np.trace(np.linalg.solve(plain_normal + weak, of_noise), axis1=1, axis2=2) / len(model)
        held = (size * inflation)[:, None, None] * np.diag(known[model])
        inverse = np.linalg.inv(plain_normal + held + weak)
        covariances = size[:, None, None] * (inverse @ (of_noise + held * inflation[:, None, None]) @ inverse)
        values = inverse @ plain_products[model, -1] / scale[model]
        weights = _weights(restricted, families)
        value = weights @ values
        spread = (weights[:, None] * (values - value)).T @ (values - value)
        covariance = (
            np.tensordot(weights, covariances, axes=1) / np.outer(scale[model], scale[model]) + spread
        )
        deviance = -2 * float(likelihood.max())
        bayesian, hannan_quinn = (
            deviance + len(model) * each for each in (math.log(n), 2 * math.log(math.log(n)))
        )
        estimates.append(Estimate(value, covariance, bayesian, hannan_quinn))
    return estimates


def slow_variance(t: Floats, design: Floats, residual: Floats, period: float) -> float:
    """Return the spectral density of residuals at a low frequency, relative to white noise of unit variance.

    `residual` (n,) and the fitted columns of `design` (n, p) are in units of the uncertainty; `period` and `t` are in
    s. The degrees of freedom of the columns are accounted for. The density is at least 1. If tau and the period are
    given in bins, it is

        s^2 (1 + q sinh(1 / tau) / (cosh(1 / tau) - cos(2 pi / period))),

    averaged geometrically over the posterior of q and tau. An arithmetic mean would be dominated by the long tail of
    this posterior.
    """
    x, z, white, when = _binned(t, design, residual, np.ones(len(t)))
    scale = np.linalg.norm(x, axis=0)
    x = x[:, scale > 1e-9 * scale.max()] / scale[scale > 1e-9 * scale.max()]
    n = len(z)
    turn = min(2 * math.pi * float(np.median(np.diff(when))) / period, math.pi)
    found, families = [], []
    for family, share, length, noise in _noise_models(white, when):
        families.append(family)
        root = np.linalg.cholesky(noise)
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
    weights = _weights(np.array([f[0] for f in found]), families)
    return max(1.0, math.exp(float(weights @ np.log([f[1] for f in found]))))


def _binned(t: Floats, design: Floats, y: Floats, sigma: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return columns, values, variances and times of the weighted means of neighbouring samples."""
    edges = np.linspace(0, len(t), min(len(t), _MAX_BINS) + 1).astype(int)[:-1]
    weight = 1.0 / sigma**2
    total = np.add.reduceat(weight, edges)
    x = np.add.reduceat(design * weight[:, None], edges, axis=0) / total[:, None]
    z, when = (np.add.reduceat(v * weight, edges) / total for v in (y, t))
    return x, z, 1.0 / total, when


def _noise_models(
    white: Floats, when: Floats, psi: Floats | None = None
) -> Iterator[tuple[int, float, float, Floats]]:
    """Yield family, q, tau and covariance of each noise model.

    Family 0 is white noise, and family 1 is noise correlated in time. If the bins resolve a turn, there are two more:
    family 2 is noise that is harmonic in the angle, and family 3 contains both kinds.
    """
    lag = np.abs(when[:, None] - when[None, :]) / float(np.median(np.diff(when)))
    level = float(np.median(white))
    correlated = [(q, c) for q in _VARIANCE_RATIOS for c in _TIMES]
    choices: list[tuple[int, float, float, float, float]] = [(0, 0.0, 1.0, 0.0, 1.0)]
    choices += [(1, q, c, 0.0, 1.0) for q, c in correlated]
    cosine = np.zeros_like(lag)
    if psi is not None and np.abs(np.diff(psi)).max() < 2 * math.pi / _MIN_BINS_PER_TURN:
        cosine = np.cos(psi[:, None] - psi)
        harmonic = [(p, c * len(when)) for p in _VARIANCE_RATIOS for c in _HARMONIC_TIMES]
        choices += [(2, 0.0, 1.0, p, c) for p, c in harmonic]
        choices += [(3, *first, *second) for first in correlated[::2] for second in harmonic[::2]]
    decay = {tau: np.exp(-lag / tau) for tau in {c[2] for c in choices} | {c[4] for c in choices}}
    diagonal = np.diag(white)
    for family, q, tau, p, length in choices:
        noise = diagonal + level * (q * decay[tau] + (p * cosine * decay[length] if p else 0.0))
        yield family, q, tau, noise


def _weights(logs: Floats, families: Sequence[int]) -> Floats:
    """Return the posterior of the noise models; a priori, white noise is as probable as all other models together."""
    count = np.bincount(families)
    prior: Floats = 1.0 / count[np.asarray(families)]
    prior[1:] /= max(int(np.count_nonzero(count)) - 1, 1)
    weights = np.exp(logs - logs.max()) * prior
    return np.asarray(weights / weights.sum())
