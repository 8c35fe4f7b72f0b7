"""Circles and ellipses through the points that markers pass.

All points are (x, y) in px with y downwards; angles are counter-clockwise as seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Orbit:
    """Circles with one centre: (x, y), the radius of each group, and how many points agree."""

    centre: tuple[float, float]
    radii: dict[int, float]
    inliers: int
    spread: float


def common_centre(points: Floats, group: Integers, *, seed: int = 0, trials: int = 400) -> Orbit | None:
    """Find the point that the groups of points circle, though some points belong to no circle.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Positions in px.
    group : ndarray of int, shape (n,)
        Which circle a point may lie on (its colour).

    Returns
    -------
    Orbit or None
        None when the points do not go round: too few, not spread over at least 1.5 rad, or no circle.

    Notes
    -----
    Random triples of one group give circles. The centre is kept about which points that agree in
    radius (within 5 % of their group's typical one) lie in most directions - what stands still agrees with
    every centre, but in one direction only - and refined by least squares over these points.
    """
    if len(points) < 5:
        return None
    rng = np.random.default_rng(seed)
    best: tuple[int, npt.NDArray[np.bool_]] | None = None
    for _ in range(trials):
        first = rng.integers(len(points))
        same = np.flatnonzero(group == group[first])
        if len(same) < 3:
            continue
        trial = circumcentre(points[rng.choice(same, 3, replace=False)])
        if trial is None:
            continue
        inlier = _agreeing(points, group, trial)
        around = _directions(points, group, trial, inlier)
        if best is None or around > best[0]:
            best = (around, inlier)
    if best is None or best[0] < 5:
        return None
    inlier = best[1]
    for _ in range(3):
        centre, radii = fit_common_centre(points[inlier], group[inlier])
        inlier = _agreeing(points, group, centre)
        if inlier.sum() < 5:
            return None
    spread = covered_angle(_angles(points[inlier], centre))
    if spread < 1.5:
        return None
    return Orbit((float(centre[0]), float(centre[1])), radii, int(inlier.sum()), spread)


def circumcentre(triple: Floats) -> Floats | None:
    """Return the centre of the circle through three points, (3, 2); None when they are close to a line."""
    a, b = triple[1] - triple[0], triple[2] - triple[0]
    cross = a[0] * b[1] - a[1] * b[0]
    size = max(float(a @ a), float(b @ b), float((b - a) @ (b - a)))
    if size < 16.0 or abs(cross) < 0.05 * size:
        return None
    offset = np.array([b[1] * (a @ a) - a[1] * (b @ b), a[0] * (b @ b) - b[0] * (a @ a)]) / (2.0 * cross)
    return np.asarray(triple[0] + offset, dtype=np.float64)


def fit_common_centre(points: Floats, group: Integers) -> tuple[Floats, dict[int, float]]:
    """Fit concentric circles, one radius a group, by linear least squares.

    x^2 + y^2 = 2 cx x + 2 cy y + k_g with k_g = r_g^2 - cx^2 - cy^2, about the mean point for accuracy.
    """
    labels, index = np.unique(group, return_inverse=True)
    origin = points.mean(axis=0)
    local = points - origin
    design = np.zeros((len(points), 2 + len(labels)))
    design[:, :2] = 2.0 * local
    design[np.arange(len(points)), 2 + index] = 1.0
    solution, *_ = np.linalg.lstsq(design, (local**2).sum(axis=1), rcond=None)
    offset = solution[:2]
    radii = np.sqrt(np.maximum(solution[2:] + offset @ offset, 0.0))
    return origin + offset, {int(g): float(r) for g, r in zip(labels, radii, strict=True)}


def covered_angle(angle: Floats) -> float:
    """Return the angle in rad that a set of directions covers: a full turn less the largest empty gap."""
    order = np.sort(np.mod(angle, 2.0 * np.pi))
    gaps = np.diff(np.append(order, order[0] + 2.0 * np.pi))
    return float(2.0 * np.pi - gaps.max())


def _agreeing(points: Floats, group: Integers, centre: Floats) -> npt.NDArray[np.bool_]:
    radius = np.hypot(points[:, 0] - centre[0], points[:, 1] - centre[1])
    inlier = np.zeros(len(points), dtype=np.bool_)
    for label in range(int(group.max()) + 1):
        mine = group == label
        if not mine.any():
            continue
        typical = _mode(radius[mine])
        agree = mine & (np.abs(radius - typical) < max(1.5, 0.05 * typical)) & (typical > 6.0)
        if agree.any() and covered_angle(_angles(points[agree], centre)) > 0.5:
            inlier |= agree
    return inlier


def _directions(points: Floats, group: Integers, centre: Floats, inlier: npt.NDArray[np.bool_]) -> int:
    """Count the directions, in steps of 10 degrees for each group, in which agreeing points lie."""
    sector = np.floor(_angles(points[inlier], centre) * 36.0 / (2.0 * np.pi)).astype(np.int64)
    return len(np.unique(36 * group[inlier] + sector % 36))


def _angles(points: Floats, centre: Floats) -> Floats:
    return np.asarray(np.arctan2(-(points[:, 1] - centre[1]), points[:, 0] - centre[0]))


def _mode(values: Floats) -> float:
    """Return the middle of the densest half of a sample (the half-sample mode, one step)."""
    order = np.sort(values)
    half = (len(order) + 1) // 2
    widths = order[half - 1 :] - order[: len(order) - half + 1]
    start = int(np.argmin(widths))
    core = order[start : start + half]  # in order: its median needs no sorting
    return float(0.5 * (core[(half - 1) // 2] + core[half // 2]))
