"""Errors of fitted variables from the Jacobian, and which variables their bound holds for sure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fitting.estimation.layout import Layout

Array = NDArray[np.float64]

# a bound counts as the truth when the best value lies so many standard errors beyond it
_SURELY = 3.0
_MATTERS = 0.2


def surely_at_bound(layout: Layout, at_bound: NDArray[np.bool_], r: Array, j: Array) -> NDArray[np.bool_]:
    """Return which variables are known to be what their bound says.

    A friction whose best value is far below zero is nothing. One that is hardly below, or an exponent on the
    edge of what is tried, is not known to be there: the errors of all that goes with it must leave it free.
    """
    dead = np.linalg.norm(j, axis=0) == 0
    covariance = covariance_of(j, ~dead)
    with np.errstate(invalid="ignore", divide="ignore"):
        beyond = np.abs(covariance @ (j.T @ r)) / np.sqrt(np.diag(covariance))
    physical = np.array([layout.is_physical_bound(name) for name in layout.names])
    return np.asarray(dead | (at_bound & physical & (np.nan_to_num(beyond) > _SURELY)))


def loose_directions(names: Sequence[str], theta: Array, covariance: Array) -> list[dict[str, float]]:
    """Return combinations of parameters that the data does not hold although each alone may seem to matter.

    Parameters
    ----------
    names : sequence of str
        The variables that are looked at.
    theta, covariance : ndarray, shapes (n,) and (n, n)
        Their values and covariance.

    Returns
    -------
    list of dict
        By name the relative changes, the largest +1, that together cost less than one standard error;
        changes under a fifth of the largest are left out, and directions of one parameter too.
    """
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    kept = np.flatnonzero((theta != 0) & np.isfinite(error) & (error > 0))
    if not len(kept):
        return []
    relative = covariance[np.ix_(kept, kept)] / np.outer(theta[kept], theta[kept])
    values, vectors = np.linalg.eigh(relative)
    directions = []
    for i in np.flatnonzero(values > 1.0)[::-1]:
        weights = vectors[:, i] / vectors[np.argmax(np.abs(vectors[:, i])), i]
        chosen = {names[kept[k]]: float(w) for k, w in enumerate(weights) if abs(w) > _MATTERS}
        if len(chosen) > 1:
            directions.append(chosen)
    return directions


def covariance_of(j: Array, free: NDArray[np.bool_]) -> Array:
    """Return (J'J)^-1 over the free columns of a Jacobian, zero for the others, infinite for what moves nothing."""
    n = j.shape[1]
    covariance = np.zeros((n, n))
    size = np.linalg.norm(j, axis=0)
    size[size == 0] = np.inf
    scaled = (j / size)[:, free]
    _, s, vt = np.linalg.svd(scaled, full_matrices=False)
    # directions that the data does not determine keep a huge, honest variance
    inner = (vt.T / np.maximum(s, 1e-12 * s.max(initial=1.0)) ** 2) @ vt
    # a parameter that moves nothing has no error to speak of: it is not determined at all
    unknown = ~np.isfinite(size[free])
    scale = np.where(unknown, 1.0, size[free])
    inner = inner / np.outer(scale, scale)
    inner[unknown, unknown] = np.inf
    covariance[np.ix_(free, free)] = inner
    return covariance
