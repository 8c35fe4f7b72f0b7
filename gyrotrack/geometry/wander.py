"""A centre that nothing marks, and that may wander: from the orbit of a marker itself.

The marker's position is c(t) + rho A (cos theta, sin theta) (see `tilt`). Each sighting tells where c(t)
lies along its own radius; over half a turn that fixes both coordinates. c(t) is a broken line with about one
knot a turn.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.columns import stretches
from gyrotrack.geometry.centre import CentrePath

Floats = npt.NDArray[np.float64]

_TURNS_PER_KNOT, _MOST_KNOTS = 1.0, 400
_NOTHING = 1e-9


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
    knots = 1 if still else _knots(place - path, use)
    error = float("nan")
    for _ in range(rounds):
        solution, error = _robust(place, path, use, knots)
        for part, ends, share in _spans(n, knots):
            path[part] += _between(solution[: 2 * knots].reshape(knots, 2), ends, share)
    # What is left of the radius tells how far the centre may still be off; sideways that turns the marker.
    return CentrePath(path, np.full(n, max(error, 1e-3)), n // max(knots - 1, 1))


def _knots(v: Floats, use: npt.NDArray[np.bool_]) -> int:
    """Return how many knots lie about one turn apart; 1 for fewer than three."""
    theta = np.unwrap(np.arctan2(-v[use, 1], v[use, 0]))
    turns = float(np.abs(np.diff(theta)).sum()) / (2.0 * np.pi)
    knots = int(np.clip(turns / _TURNS_PER_KNOT, 1, _MOST_KNOTS))
    return knots if knots >= 3 else 1


def _spans(n: int, knots: int) -> Iterator[tuple[slice, tuple[int, int], Floats]]:
    """Yield the frames between each two knots: where they are, the two knots, and the share of the second one."""
    if knots == 1:
        for part in stretches(n):
            yield part, (0, 0), np.zeros(part.stop - part.start)
        return
    begins = np.ceil(np.linspace(0, n - 1, knots)).astype(np.int64)
    begins[-1] = n
    for k, (begin, end) in enumerate(itertools.pairwise(begins.tolist())):
        place = np.arange(begin, end) * ((knots - 1) / (n - 1))
        yield slice(begin, end), (k, k + 1), np.clip(place - k, 0.0, 1.0)


def _between(values: Floats, ends: tuple[int, int], share: Floats) -> Floats:
    """Return the broken line between two knots, (m, 2)."""
    low, high = (values[end] for end in ends)
    return np.asarray((1.0 - share)[:, None] * low + share[:, None] * high)


def _robust(place: Floats, path: Floats, use: npt.NDArray[np.bool_], knots: int) -> tuple[Floats, float]:
    """Fit knots (x and y in turn), rho, p and q without what lies far off; return them and the scatter."""
    away = np.full(len(place), np.nan)
    away[use] = np.hypot(*(place[use] - path[use]).T)
    typical = float(np.median(away[use]))
    keep, scatter = use, 1.0
    for _ in range(4):
        normal, right = np.zeros((2 * knots + 3,) * 2), np.zeros(2 * knots + 3)
        for part, at, rows in _rows(place, path, knots, typical):
            kept = rows[keep[part]]
            normal[np.ix_(at, at)] += kept.T @ kept
            right[at] += kept.T @ (away[part] - typical)[keep[part]]
        normal += _NOTHING * np.eye(
            len(right)
        )  # of all knots that fit as well, those nearest to where they were
        size = np.sqrt(normal.diagonal())
        solution = np.linalg.solve(normal / np.outer(size, size), right / size) / size
        left = away - typical
        for part, at, rows in _rows(place, path, knots, typical):
            left[part] -= rows @ solution[at]
        scatter = float(1.4826 * np.median(np.abs(left[keep]))) + 1e-9
        with np.errstate(invalid="ignore"):
            keep = use & (np.abs(left) < 4.0 * scatter)
    return np.asarray(solution, dtype=np.float64), scatter


def _rows(
    place: Floats, path: Floats, knots: int, typical: float
) -> Iterator[tuple[slice, npt.NDArray[np.int64], Floats]]:
    """Yield the linear model span by span: its frames, its unknowns, and the rows (m, unknowns)."""
    for part, ends, share in _spans(len(place), knots):
        v = place[part] - path[part]
        theta = np.arctan2(-v[:, 1], v[:, 0])
        shape = [np.ones(len(theta)), typical * np.cos(2 * theta), typical * np.sin(2 * theta)]
        c, s = np.cos(theta), -np.sin(theta)
        bent = [2 * knots, 2 * knots + 1, 2 * knots + 2]
        if knots == 1:
            yield part, np.array([0, 1, *bent]), np.stack([c, s, *shape], axis=1)
        else:
            two = [w * d for w in (1.0 - share, share) for d in (c, s)]
            at = np.array([2 * ends[0], 2 * ends[0] + 1, 2 * ends[1], 2 * ends[1] + 1, *bent])
            yield part, at, np.stack([*two, *shape], axis=1)
