"""Bases, projections and block matrices for all least-squares problems of this package."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def orthonormal(columns: Array, smallest: float) -> Array:
    """Return an orthonormal basis of scaled columns, without relative singular values below `smallest`."""
    size = np.linalg.norm(columns, axis=0)
    if not (size > 0).any():
        return np.zeros((len(columns), 0))
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return np.asarray(u[:, s > smallest * s[0]])


def orthogonal_to(basis: Array, columns: Array) -> Array:
    """Return the part of columns, or of a vector, that is orthogonal to an orthonormal basis."""
    return np.asarray(columns - basis @ (basis.T @ columns))


def block_diagonal(parts: Sequence[Array]) -> Array:
    """Return a block-diagonal matrix of these parts."""
    rows, columns = sum(len(p) for p in parts), sum(p.shape[1] for p in parts)
    out = np.zeros((rows, columns))
    i = j = 0
    for p in parts:
        out[i : i + len(p), j : j + p.shape[1]] = p
        i, j = i + len(p), j + p.shape[1]
    return out


def piecewise_linear(values: Array, knots: Array) -> Array:
    """Return piecewise linear functions that are 1 at one knot and 0 at all other knots, shape (values, knots)."""
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))], axis=1)


def cubic_spline(x: Array, y: Array, at: Array) -> Array:
    """Return the not-a-knot cubic spline through four or more points (the import of SciPy's spline is slow)."""
    h, n = np.diff(x), len(x)
    slope = np.diff(y) / h
    matrix, right = np.zeros((n, n)), np.zeros(n)
    # equations for the second derivatives: the slope is continuous at interior points, the third derivative next to the
    # ends
    inner = np.arange(1, n - 1)
    matrix[inner, inner - 1], matrix[inner, inner + 1] = h[:-1], h[1:]
    matrix[inner, inner] = 2 * (h[:-1] + h[1:])
    right[1:-1] = 6 * np.diff(slope)
    matrix[0, :3] = h[1], -h[0] - h[1], h[0]
    matrix[-1, -3:] = h[-1], -h[-1] - h[-2], h[-2]
    second = np.linalg.solve(matrix, right)
    k = np.clip(np.searchsorted(x, at) - 1, 0, n - 2)
    d, e = at - x[k], x[k + 1] - at
    cubic = (second[k + 1] * d**3 + second[k] * e**3) / (6 * h[k])
    line = (y[k + 1] / h[k] - second[k + 1] * h[k] / 6) * d + (y[k] / h[k] - second[k] * h[k] / 6) * e
    return np.asarray(cubic + line)


def r_factor(columns: Array) -> Array:
    """Return R of the QR decomposition, a square matrix; its columns have the scalar products of the given columns."""
    return np.asarray(np.linalg.qr(columns, mode="r") if np.isfinite(columns).all() else columns)


def covariance_of(j: Array, free: NDArray[np.bool_]) -> Array:
    """Return (J'J)^-1 over the free columns of a Jacobian; zero for other columns, infinite for columns of zeros."""
    n = j.shape[1]
    covariance = np.zeros((n, n))
    size = np.linalg.norm(j, axis=0)
    size[size == 0] = np.inf
    scaled = (j / size)[:, free]
    _, s, vt = np.linalg.svd(scaled, full_matrices=False)
    # a direction that the data do not determine has a large but finite variance
    inner = (vt.T / np.maximum(s, 1e-12 * s.max(initial=1.0)) ** 2) @ vt
    unknown = ~np.isfinite(size[free])
    scale = np.where(unknown, 1.0, size[free])
    inner = inner / np.outer(scale, scale)
    inner[unknown, unknown] = np.inf
    covariance[np.ix_(free, free)] = inner
    return covariance
