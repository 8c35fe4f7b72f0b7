"""Local polynomials through a series with gaps: what is smooth in it, and how far each point lies off."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.compiled import loops
from gyrotrack.dataset.columns import stretches

Floats = npt.NDArray[np.float64]


def local_fit(
    value: Floats, weight: Floats, half: int, degree: int = 2, hole: int = -1
) -> tuple[Floats, Floats]:
    """Fit a polynomial about every point of an even series, over `half` points to both sides.

    Parameters
    ----------
    value : ndarray, shape (n,)
        The series; entries of weight 0 may be NaN.
    weight : ndarray, shape (n,)
        Weights, 0 where there is no value.
    half : int
        Reach of the window; its weights fall off as (1 - (x/(half + 1))^2).
    degree : int
        Of the polynomial.
    hole : int
        Points up to this distance are left out, to predict each point from others; -1: none.

    Returns
    -------
    smooth, leverage : ndarray, shape (n,)
        The fitted value, and the share with which a point of weight 1 enters its own fitted value. NaN where
        the window holds too few points.
    """
    n = len(value)
    smooth, leverage = np.empty(n), np.empty(n)
    for part in stretches(n):  # a fit needs some dozen numbers for each point
        around = slice(max(part.start - half, 0), min(part.stop + half, n))
        beyond = (half - (part.start - around.start), half - (around.stop - part.stop))
        padded = np.pad(value[around], beyond), np.pad(weight[around], beyond)
        if loops is None:
            smooth[part], leverage[part] = _fitted(*padded, half, degree, hole)
        else:
            loops.local(*padded, smooth[part], leverage[part], half, degree, hole)
    return smooth, leverage


def _fitted(value: Floats, weight: Floats, half: int, degree: int, hole: int) -> tuple[Floats, Floats]:
    """Fit about the points of a stretch, (n,); values and weights reach beyond it by `half` points, (n + 2 half,)."""
    n = len(value) - 2 * half
    x = np.arange(-half, half + 1, dtype=np.float64) / (half + 1)
    bell = np.where(np.abs(np.arange(-half, half + 1)) <= hole, 0.0, 1.0 - x**2)
    clean = np.where(weight > 0, value, 0.0) * weight

    def moment(series: Floats, power: int) -> Floats:
        return np.convolve(series, (bell * x**power)[::-1], mode="valid")

    s = [moment(weight, k) for k in range(2 * degree + 1)]
    t = np.stack([moment(clean, k) for k in range(degree + 1)], axis=1)
    matrix = np.empty((n, degree + 1, degree + 1))
    for i in range(degree + 1):
        for j in range(degree + 1):
            matrix[:, i, j] = s[i + j]
    held = np.convolve((weight > 0).astype(float), np.ones(2 * half + 1), mode="valid")
    enough = held > degree + 2.5
    matrix[~enough] = np.eye(degree + 1)
    matrix += 1e-9 * np.maximum(s[0], 1e-12)[:, None, None] * np.eye(degree + 1)
    row = _first_row_of_inverse(matrix)
    smooth = np.where(enough, (row * t).sum(axis=1), np.nan)
    return smooth, np.where(enough, row[:, 0] * bell[half], np.nan)


def _first_row_of_inverse(matrix: Floats) -> Floats:
    """Solve A x = (1, 0, ...) for many small symmetric positive definite matrices, (n, p, p), by elimination."""
    p = matrix.shape[1]
    a = np.ascontiguousarray(np.moveaxis(matrix, 0, 2))
    right = np.zeros((p, a.shape[2]))
    right[0] = 1.0
    for k in range(p):
        for i in range(k + 1, p):
            part = a[i, k] / a[k, k]
            a[i, k + 1 :] -= part * a[k, k + 1 :]
            right[i] -= part * right[k]
    for k in reversed(range(p)):
        for j in range(k + 1, p):
            right[k] -= a[k, j] * right[j]
        right[k] /= a[k, k]
    return right.T


def spread(residual: Floats) -> float:
    """Return the standard deviation of the core of a sample, 1.4826 times its median absolute value."""
    known = residual[np.isfinite(residual)]
    return 1.4826 * median_of(np.abs(known)) if len(known) else float("nan")


def median_of(values: Floats) -> float:
    """Return the median of some numbers, none of them NaN; `np.median` thinks for longer than it works."""
    ranks = (values.size - 1) // 2, values.size // 2
    ordered = np.partition(values, ranks, axis=None)
    return float(0.5 * (ordered[ranks[0]] + ordered[ranks[1]]))
