"""A centre that nothing marks, and that may wander: from the orbit of a marker itself.

The marker's position is c(t) + rho A (cos theta, sin theta) (see `tilt`). Each sighting tells where c(t)
lies along its own radius; over half a turn that fixes both coordinates. c(t) is a broken line with about one
knot a turn.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.centre import CentrePath

Floats = npt.NDArray[np.float64]

_TURNS_PER_KNOT = 1.0


def wandering_centre(
    place: Floats, weight: npt.NDArray[np.bool_], start: Floats, *, still: bool = False, rounds: int = 12
) -> CentrePath:
    """Find the path of the centre of an orbit.

    Parameters
    ----------
    place : ndarray, shape (n, 2)
        Positions of the marker in px, y downwards.
    weight : ndarray of bool, shape (n,)
        Trusted sightings.
    start : ndarray, shape (2,)
        First guess of the centre in px.
    still : bool
        The centre stays where it is.

    Notes
    -----
    Gauss-Newton on |place - c(t)| = rho (1 + p cos 2 theta + q sin 2 theta), linear in knots,
    rho, p, q for given theta; outliers beyond 4 median absolute deviations are left out. The flattening is
    free here so that it does not leak into the path, and is fitted again, with its tilt, by
    `tilt.fit_flattening`.
    """
    n = len(place)
    path = np.tile(np.asarray(start, dtype=np.float64), (n, 1))
    use = weight & np.isfinite(place).all(axis=1)
    if use.sum() < 12:
        return CentrePath(path, np.full(n, np.nan), 0)
    basis = np.ones((n, 1)) if still else _basis(place - path, use)
    error = float("nan")
    for _ in range(rounds):
        v = place[use] - path[use]
        theta, rho = np.arctan2(-v[:, 1], v[:, 0]), np.hypot(v[:, 0], v[:, 1])
        typical = float(np.median(rho))
        c, s = np.cos(theta), np.sin(theta)
        design = np.hstack([
            basis[use] * c[:, None], basis[use] * -s[:, None], np.ones((len(c), 1)),
            typical * np.stack([np.cos(2 * theta), np.sin(2 * theta)], axis=1),
        ])  # fmt: skip
        solution, error = _robust(design, rho - typical)
        knots = basis.shape[1]
        path = path + np.stack([basis @ solution[:knots], basis @ solution[knots : 2 * knots]], axis=1)
    # What is left of the radius tells how far the centre may still be off; sideways that turns the marker.
    return CentrePath(path, np.full(n, max(error, 1e-3)), n // max(basis.shape[1] - 1, 1))


def _basis(v: Floats, use: npt.NDArray[np.bool_]) -> Floats:
    """Return hat functions over the frames, (n, knots), with knots about one turn apart."""
    n = len(v)
    theta = np.unwrap(np.arctan2(-v[use, 1], v[use, 0]))
    turns = float(np.abs(np.diff(theta)).sum()) / (2.0 * np.pi)
    knots = int(np.clip(turns / _TURNS_PER_KNOT, 1, 400))
    if knots < 3:
        return np.ones((n, 1))
    place = np.linspace(0, n - 1, knots)
    index = np.arange(n, dtype=np.float64)
    return np.stack([np.interp(index, place, row) for row in np.eye(knots)], axis=1)


def _robust(design: Floats, value: Floats) -> tuple[Floats, float]:
    keep = np.ones(len(value), dtype=np.bool_)
    scatter = 1.0
    for _ in range(4):
        solution, *_ = np.linalg.lstsq(design[keep], value[keep], rcond=None)
        left = value - design @ solution
        scatter = float(1.4826 * np.median(np.abs(left[keep]))) + 1e-9
        keep = np.abs(left) < 4.0 * scatter
    return np.asarray(solution, dtype=np.float64), scatter
