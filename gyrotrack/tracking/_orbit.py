"""Circles and ellipses through the positions of markers; tilt of the camera.

All points are (x, y) in px with y downwards; angles are counter-clockwise as seen.

In an oblique view, a circle is an ellipse, and a marker above the plane of the central disc moves around a point beside
the disc. With v = (x - cx, -(y - cy)) the position of a marker relative to the disc,

    v = e + rho A (cos theta, sin theta),    A = [[1 + p, q], [q, 1 - p]],

with e the offset of the orbit's centre and (p, q) the flattening: for a tilt t, hypot(p, q) = t^2 / 4. Both change
radius and angle. Without correction, the offset causes an error of the angle with the amplitude |e| / rho and one
period per turn. The flattening causes an error with the amplitude hypot(p, q) and two periods per turn.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from gyrotrack._arrays import Bools, Floats, Integers
from gyrotrack._smoothing import BORROWED_NU, median_of, spread


@dataclass(frozen=True)
class Orbit:
    """Concentric circles: centre (x, y) [px], radius of each group [px], number of inliers, covered angle [rad]."""

    centre: tuple[float, float]
    radii: dict[int, float]
    inliers: int
    spread: float


_FEWEST = 5
"""Smallest number of blobs, of directions with a blob, and of inliers of a common centre [1]. Chosen: with fewer, blobs
agree by chance; with more, films with occlusions are refused."""
_LEAST_SPREAD = 1.5
"""Smallest angle that the inliers of a common centre cover [rad]. Chosen: a quarter of a turn; a smaller value leaves
the centre undetermined, a larger one refuses short films."""


def common_centre(points: Floats, group: Integers, *, trials: int = 400) -> Orbit | None:
    """Find the common centre of the circles of groups (colours) of points, (n, 2) [px], robust against outliers.

    Random triples of points of one group define circles. The selected centre has inliers (see `_agreeing`) in the
    largest number of directions. The number of inliers is not used: an object at rest is an inlier of every centre, but
    in one direction only. The centre is refined by least squares over the inliers. The result is None if the inliers
    are too few or cover less than `_LEAST_SPREAD`.
    """
    if len(points) < _FEWEST:
        return None
    rng = np.random.default_rng(0)
    best: tuple[int, Bools] | None = None
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
    if best is None or best[0] < _FEWEST:
        return None
    inlier = best[1]
    for _ in range(3):
        centre, radii = fit_common_centre(points[inlier], group[inlier])
        inlier = _agreeing(points, group, centre)
        if inlier.sum() < _FEWEST:
            return None
    spread = covered_angle(_angles(points[inlier], centre))
    if spread < _LEAST_SPREAD:
        return None
    return Orbit((float(centre[0]), float(centre[1])), radii, int(inlier.sum()), spread)


def orbits_about(points: Floats, group: Integers, hub: tuple[float, float]) -> Orbit | None:
    """Return the circles of groups of points about a known hub (x, y) [px]; None with too few inliers."""
    if not len(points):
        return None
    centre = np.array(hub, dtype=np.float64)
    inlier = _agreeing(points, group, centre)
    spread = covered_angle(_angles(points[inlier], centre)) if inlier.any() else 0.0
    if inlier.sum() < 5 or spread < 0.5:
        return None
    away = np.hypot(*(points - centre).T)
    radii = {int(g): float(np.median(away[inlier & (group == g)])) for g in np.unique(group[inlier])}
    return Orbit(hub, radii, int(inlier.sum()), spread)


_SMALLEST = 16.0
"""Smallest square of the longest side of three points that determine a circle [px2]. Chosen: 4 px; a smaller value is
dominated by noise, a larger one refuses small orbits."""
_COLLINEAR = 0.05
"""Three points determine a circle if the cross product of two sides, divided by the square of the longest side, is at
least this value [1]. Chosen: a smaller value accepts circles that noise determines, a larger one refuses short arcs."""


def circumcentre(triple: Floats) -> Floats | None:
    """Return the centre of the circle through three points, (3, 2); None if they are nearly collinear."""
    a, b = triple[1] - triple[0], triple[2] - triple[0]
    cross = a[0] * b[1] - a[1] * b[0]
    size = max(float(a @ a), float(b @ b), float((b - a) @ (b - a)))
    if size < _SMALLEST or abs(cross) < _COLLINEAR * size:
        return None
    offset = np.array([b[1] * (a @ a) - a[1] * (b @ b), a[0] * (b @ b) - b[0] * (a @ a)]) / (2.0 * cross)
    return np.asarray(triple[0] + offset, dtype=np.float64)


def fit_common_centre(points: Floats, group: Integers) -> tuple[Floats, dict[int, float]]:
    """Fit concentric circles by least squares: x^2 + y^2 = 2 cx x + 2 cy y + k_g with k_g = r_g^2 - cx^2 - cy^2."""
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
    """Return the angle [rad] covered by a set of directions: a full turn less the largest empty gap."""
    order = np.sort(np.mod(angle, 2.0 * np.pi))
    gaps = np.diff(np.append(order, order[0] + 2.0 * np.pi))
    return float(2.0 * np.pi - gaps.max())


_WITHIN_SHARE = 0.05
"""Largest relative difference of the radius of an inlier from the mode of its group [1]. Chosen: a smaller value
refuses oblique views, a larger one accepts random points."""
_WITHIN = 1.5
"""Lower limit of the largest difference of the radius of an inlier from the mode of its group [px]. Chosen: a smaller
value rejects blurred blobs, a larger one accepts random points near the centre."""
_LEAST_RADIUS = 6.0
"""Smallest radius of an orbit [px]. Chosen: a smaller value finds the disc at the centre, a larger one refuses small
bodies."""
_LEAST_ANGLE = 0.5
"""Smallest angle that the inliers of a group cover [rad]. Chosen: an object at rest covers less; a larger value refuses
slow bodies."""


def _agreeing(points: Floats, group: Integers, centre: Floats) -> Bools:
    radius = np.hypot(points[:, 0] - centre[0], points[:, 1] - centre[1])
    inlier = np.zeros(len(points), dtype=np.bool_)
    for label in range(int(group.max()) + 1):
        mine = group == label
        if not mine.any():
            continue
        typical = _mode(radius[mine])
        agree = (
            mine
            & (np.abs(radius - typical) < max(_WITHIN, _WITHIN_SHARE * typical))
            & (typical > _LEAST_RADIUS)
        )
        if agree.any() and covered_angle(_angles(points[agree], centre)) > _LEAST_ANGLE:
            inlier |= agree
    return inlier


def _directions(points: Floats, group: Integers, centre: Floats, inlier: Bools) -> int:
    """Count the 10 degree sectors with inliers over all groups."""
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
    core = order[start : start + half]  # sorted
    return float(0.5 * (core[(half - 1) // 2] + core[half // 2]))


MOST_OBSERVATIONS = 2000
"""Largest number of observations of an orbit [1]. Chosen: a larger number costs time and does not reduce the
position-dependent error."""
LEAST_OBSERVATIONS = 30
"""Smallest number of observations of an orbit [1]. Chosen: a smaller number lets a few outliers decide, a larger one
leaves short films without a fit."""
CELL = np.pi / 6.0
"""Correlation length of position-dependent errors [rad]. Derived: harmonics of orders 1 to 6 of equal size have 12
independent values in a turn."""
LEAST_COVER = 5.0
"""Smallest part of the turn that an orbit covers [rad]. Chosen: a smaller value confuses offset and radius of an arc, a
larger one fits few orbits."""
_ROUNDS = 6
"""Number of iterations of a fit of offset and flattening [iterations]. Chosen: a smaller number stops before outliers
and shape agree, a larger one costs time."""


@dataclass(frozen=True)
class Flattening:
    """Effect of an oblique view on an orbit: offset e of each marker [px] (y up), and (p, q).

    `offset_covariance` contains the covariance of e [px^2], (2, 2), for markers that cover only an arc; `error` is the
    standard uncertainty of p and q.
    """

    offset: dict[str, tuple[float, float]]
    p: float
    q: float
    offset_covariance: dict[str, Floats] = field(default_factory=dict, compare=False)
    error: float = field(default=0.0, compare=False)

    @property
    def tilt(self) -> float:
        """The tilt [rad] that causes this flattening."""
        return float(2.0 * np.sqrt(np.hypot(self.p, self.q)))

    def level(self, name: str, v: Floats) -> Floats:
        """Return A^-1 (v - e): the position in the plane of the orbit, (n, 2)."""
        e = np.array(self.offset.get(name, (0.0, 0.0)))
        matrix = np.array([[1.0 + self.p, self.q], [self.q, 1.0 - self.p]])
        return np.asarray((v - e) @ np.linalg.inv(matrix).T)

    def moved(self, by: Floats) -> Flattening:
        """Return the same flattening with all offsets shifted by (2,) px."""
        offset = {name: (x + float(by[0]), y + float(by[1])) for name, (x, y) in self.offset.items()}
        return replace(self, offset=offset)

    def shift(self, names: Iterable[str]) -> Floats:
        """Return the mean of the offsets of some markers, (2,) [px]."""
        return np.asarray(np.mean([self.offset[name] for name in names if name in self.offset], axis=0))

    def tangential_sigma(self, name: str, angle: Floats) -> Floats:
        """Return the uncertainty along the orbit of a marker due to e, without its mean over the frames, (n,) [px]."""
        if name not in self.offset_covariance or not np.isfinite(angle).any():
            return np.zeros(len(angle))
        along = np.stack([-np.sin(angle), np.cos(angle)])
        along -= np.nanmean(along, axis=1, keepdims=True)
        return np.asarray(np.sqrt(np.einsum("in,ij,jn->n", along, self.offset_covariance[name], along)))

    def tilt_sigma(self, angle: Floats) -> Floats:
        """Return the uncertainty of an angle due to p and q, without its mean over the frames, (n,) [rad]."""
        if not np.isfinite(angle).any():
            return np.zeros(len(angle))
        along = np.stack([-np.sin(2.0 * angle), np.cos(2.0 * angle)])
        along -= np.nanmean(along, axis=1, keepdims=True)
        return np.asarray(self.error * np.hypot(*along))


NO_FLATTENING = Flattening({}, 0.0, 0.0)


def fit_flattening(positions: dict[str, Floats]) -> Flattening:
    """Fit offsets and flattening to the orbits of markers, from positions (n, 2) relative to the centre, y up.

    The radii |v| = rho + e . r + rho (p cos 2 theta + q sin 2 theta), to first order, are fitted by the Gauss-Newton
    method; r is the unit vector in the direction theta. Points beyond four robust standard deviations are rejected in
    each round. Markers whose observations cover less than 5 rad are not used.
    """
    use = {
        name: v for name, v in positions.items() if len(v) >= LEAST_OBSERVATIONS and _cover(v) > LEAST_COVER
    }
    return _fitted(use, common=False) if use else NO_FLATTENING


def fit_common_offset(positions: dict[str, Floats]) -> Flattening:
    """Fit one offset and the flattening to markers of one body that only together cover the orbit.

    The fit is the same as in `fit_flattening`, with a radius for each marker. The markers are in one plane, so that e
    is common to all.
    """
    use = {name: v for name, v in positions.items() if len(v)}
    together = np.concatenate(list(use.values())) if use else np.zeros((0, 2))
    if len(together) < LEAST_OBSERVATIONS or _cover(together) <= LEAST_COVER:
        return NO_FLATTENING
    return _fitted(use, common=True)


def _fitted(positions: dict[str, Floats], *, common: bool) -> Flattening:
    """Fit one offset for each marker, or a `common` offset, and the flattening."""
    found = Flattening(dict.fromkeys(positions, (0.0, 0.0)), 0.0, 0.0)
    few = {name: v[:: max(len(v) // MOST_OBSERVATIONS, 1)] for name, v in positions.items()}
    for _ in range(_ROUNDS):
        solution = _robust([_model(found.level(name, v)) for name, v in few.items()], common=common)
        own = np.tile(solution[-4:-2], (len(few), 1)) if common else solution[:-2].reshape(-1, 3)[:, 1:]
        offset = {
            name: (x + float(by[0]), y + float(by[1]))
            for (name, (x, y)), by in zip(found.offset.items(), own, strict=True)
        }
        found = Flattening(offset, found.p + float(solution[-2]), found.q + float(solution[-1]))
    return found


_HIGHER = range(3, 7)
"""Orders of the harmonics of the radii that neither an offset nor a tilt causes [periods per turn]. Derived: an offset
causes order 1 and a tilt order 2; position-dependent errors have orders up to 6."""


def higher_harmonics(theta: Floats, radius: Floats) -> Floats:
    """Return the cosine and sine amplitudes of orders 3 to 6 of radii over the angle, (8,), in the unit of radii."""
    few = slice(None, None, max(len(theta) // MOST_OBSERVATIONS, 1))
    theta, off = theta[few], radius[few] - median_of(radius[few])
    design = np.stack([f(k * theta) for k in (0, 1, 2, *_HIGHER) for f in (np.cos, np.sin)], axis=1)[
        :, [0, *range(2, 14)]
    ]
    keep = np.ones(len(off), dtype=np.bool_)
    for _ in range(3):
        kept = design[keep]
        # the prior (harmonics of about 1 px are large) is needed because a gap leaves some combinations undetermined
        solution = np.linalg.solve(kept.T @ kept + 0.04 * np.eye(kept.shape[1]), kept.T @ off[keep])
        left = np.abs(off - design @ solution)
        keep = left < 4.0 * 1.4826 * median_of(left[keep]) + 1e-9
    return np.asarray(solution[5:])


def flattening_of_arc(
    reference: Flattening, positions: dict[str, Floats], shift: Floats, size: float, usual: float
) -> Flattening:
    """Fit offsets to arcs of markers (positions as for `fit_flattening`), with the tilt measured on another body.

    `shift` (2,) or (h, 2) is the expected offset of all markers [px], or h equally probable offsets, with standard
    deviation `size` [px]; `usual` is a typical position-dependent error [px]. An arc determines e in part;
    `offset_covariance` is the covariance of e. Systematic errors, not noise, limit the fit: there is one independent
    observation per `CELL`. For several expected offsets, the result is mean and covariance of the mixture of the
    posterior distributions.
    """
    expected = np.atleast_2d(shift)
    mean, covariance = mixture(expected, [size**2 * np.eye(2)] * len(expected), [0.0] * len(expected))
    found = Flattening(dict.fromkeys(positions, mean), reference.p, reference.q, error=reference.error)
    for name, v in positions.items():
        found.offset_covariance[name] = covariance
        if len(v) >= LEAST_OBSERVATIONS:
            fits = []
            for one in expected:
                level = replace(reference, offset={name: (float(one[0]), float(one[1]))}).level(name, v)
                more, own, evidence = _arc(level, size, usual)
                fits.append((one + more, own, evidence))
            found.offset[name], found.offset_covariance[name] = mixture(*map(list, zip(*fits, strict=True)))
    return found


def mixture(
    means: Iterable[Floats], covariances: list[Floats], evidence: list[float]
) -> tuple[tuple[float, float], Floats]:
    """Return mean and covariance, (2,) and (2, 2), of a mixture of normal distributions with given log evidences."""
    weight = np.exp(np.array(evidence) - max(evidence))
    weight /= weight.sum()
    each = np.array(list(means))
    mean = weight @ each
    off = each - mean
    covariance = sum(w * (c + np.outer(d, d)) for w, c, d in zip(weight, covariances, off, strict=True))
    return (float(mean[0]), float(mean[1])), np.asarray(covariance)


def _arc(v: Floats, size: float, usual: float) -> tuple[Floats, Floats, float]:
    """Fit the offset of an arc, expected to be 0 within `size`: (2,), its covariance (2, 2), and the log evidence.

    The variance of the errors is the posterior mean, given the typical variance and the residuals of the few
    independent places. Radius and offset absorb three of these places.
    """
    few = v[:: max(len(v) // MOST_OBSERVATIONS, 1)]
    rho, theta = np.hypot(few[:, 0], few[:, 1]), np.arctan2(few[:, 1], few[:, 0])
    design = np.stack([np.ones_like(theta), np.cos(theta), np.sin(theta)], axis=1)
    expected = np.diag([0.0, size**-2, size**-2])
    places = min(max(covered_angle(theta) / CELL, 1.0), float(len(rho)))
    alike = len(rho) / places
    keep = np.ones(len(rho), dtype=np.bool_)
    for _ in range(3):
        free = np.linalg.lstsq(design[keep], rho[keep], rcond=None)[0]
        seen = places * spread(rho[keep] - design[keep] @ free) ** 2
        scatter = np.sqrt((BORROWED_NU * usual**2 + seen) / (BORROWED_NU + max(places - 3.0, 0.0)))
        weight = 1.0 / (alike * scatter**2)
        covariance = np.linalg.inv(weight * design[keep].T @ design[keep] + expected)
        solution = weight * covariance @ design[keep].T @ rho[keep]
        residual = np.abs(rho - design @ solution)
        keep = residual < 4.0 * scatter
    misfit = weight * float(np.sum(np.minimum(residual, 4.0 * scatter) ** 2))
    evidence = -0.5 * (misfit + float(solution[1:] @ solution[1:]) / size**2)
    return solution[1:], np.asarray(covariance[1:, 1:]), evidence


def _cover(v: Floats) -> float:
    return covered_angle(np.arctan2(v[:, 1], v[:, 0]))


def _model(v: Floats) -> tuple[Floats, Floats]:
    """Return the linear model of the radii of one marker, (5, n), and their deviation from the median, (n,)."""
    rho = np.hypot(v[:, 0], v[:, 1])
    typical = median_of(rho)
    c, s = v[:, 0] / rho, v[:, 1] / rho
    return np.stack([np.ones_like(c), c, s, typical * (c * c - s * s), 2.0 * typical * c * s]), rho - typical


def _robust(models: list[tuple[Floats, Floats]], *, common: bool = False) -> Floats:
    """Fit radius and offset of each marker and their common flattening (last two unknowns), without outliers.

    With a `common` offset the unknowns are the radii, the offset and the flattening.
    """
    if common:
        size = len(models) + 4
        places = [np.array([k, size - 4, size - 3, size - 2, size - 1]) for k in range(len(models))]
    else:
        size = 3 * len(models) + 2
        places = [np.array([3 * k, 3 * k + 1, 3 * k + 2, size - 2, size - 1]) for k in range(len(models))]
    keep = [np.ones(len(value), dtype=np.bool_) for _, value in models]
    for _ in range(3):
        normal, right = np.zeros((size, size)), np.zeros(size)
        for at, (rows, value), use in zip(places, models, keep, strict=True):
            kept = rows * use
            normal[np.ix_(at, at)] += kept @ rows.T
            right[at] += kept @ value
        solution = np.linalg.solve(normal, right)
        left = [np.abs(value - solution[at] @ rows) for at, (rows, value) in zip(places, models, strict=True)]
        usual = median_of(np.concatenate([off[use] for off, use in zip(left, keep, strict=True)]))
        keep = [off < 4.0 * 1.4826 * usual + 1e-9 for off in left]
    return np.asarray(solution, dtype=np.float64)
