"""The level of a random torque: on a grid of levels, and between them; and what a model leaves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitting.noise.whitener import Whitener

Array = NDArray[np.float64]

LEVELS = np.concatenate([[0.0], np.geomspace(0.03, 3e5, 57)])
# a casing at rest answers to no torque
_FELT = 1e-12
_ROUNDING = 1e-20


def unit_level(variances: Array) -> float:
    """Return the level of torque that is as large as the noise of the angles in half of the rows that feel it."""
    felt = variances[variances > _FELT * variances.max(initial=0.0)]
    return float(1 / np.sqrt(np.median(felt) + 1e-300)) if len(felt) else 1.0


def remaining_level(whitener: Whitener, residual: Array, free: Array, least: float) -> tuple[float, float]:
    """Return the level of random torque that a model leaves, and twice the log-likelihood it gains over `least`.

    The likelihood is restricted: what is free is integrated out.

    Parameters
    ----------
    whitener : Whitener
        Eigenvectors and eigenvalues of K.
    residual : ndarray, shape (rows,)
        Measured minus predicted.
    free : ndarray, shape (rows, columns)
        What is free: derivatives by the parameters, and nuisances.
    least : float
        The pure level, below which no model gets [N m].
    """
    m = len(whitener.values)
    size = np.linalg.norm(free, axis=0)
    columns = np.concatenate([free[:, size > 0] / size[size > 0], residual[:, None]], axis=1)
    rotated = np.concatenate([whitener.vectors.T @ columns[:m], columns[m:]])
    values = np.concatenate([whitener.values, np.zeros(len(residual) - m)])
    # rows of a casing that is held answer to no torque
    answering = whitener.values > _ROUNDING * whitener.values.max(initial=0.0)
    unit = 1 / np.sqrt(np.median(whitener.values[answering]) + 1e-300) if answering.any() else 0.0
    levels = np.concatenate([[least], (LEVELS * unit)[LEVELS * unit > least]])
    deviances = [_deviance(rotated, 1 + s**2 * values) for s in levels]
    best = int(np.argmin(deviances))
    return peak(levels, -np.array(deviances)), deviances[0] - deviances[best]


def peak(levels: Array, likelihood: Array) -> float:
    """Return the level of the highest likelihood, between the levels of the grid by a parabola in its logarithm."""
    i = int(np.argmax(likelihood))
    if not 1 <= i < len(levels) - 1 or levels[i - 1] <= 0:
        return float(levels[i])
    x = np.log(levels[i - 1 : i + 2])
    (a, b), y = x[[0, 2]] - x[1], likelihood[i - 1 : i + 2] - likelihood[i]
    # of the parabola through three points, the middle one highest
    bend = (y[0] / a - y[2] / b) / (a - b)
    if not bend < 0:
        return float(levels[i])
    return float(np.exp(x[1] + np.clip(-(y[0] / a - bend * a) / (2 * bend), a, b)))


def _deviance(rotated: Array, variance: Array) -> float:
    white = rotated / np.sqrt(variance)[:, None]
    r = np.abs(np.diag(np.linalg.qr(white, mode="r")))
    # the last entry is the residual's part beyond all free columns
    return float(np.log(variance).sum() + 2 * np.log(np.maximum(r[:-1], 1e-12)).sum() + r[-1] ** 2)
