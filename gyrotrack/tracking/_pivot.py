"""The pivot of a point that moves on a circle, and the angles about the pivot, with uncertainties.

The circle is fitted to the geometric distances, with the parameters of N. Chernov (Circular and Linear Regression,
2010, section 3.2): A (x^2 + y^2) + B x + C y + D = 0 with B^2 + C^2 - 4 A D = 1. These parameters also describe a
straight line (A = 0) without a singularity. A short arc determines the curvature 2 A = 1 / R with a symmetric
uncertainty, but the hub and the radius with large, correlated uncertainties. It determines a radius only if the sagitta
L^2 / (8 R) of an arc of length L exceeds the noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gyrotrack._arrays import Floats, Integers


@dataclass(frozen=True)
class Orbit:
    """The ellipse in the picture of a point that moves on a circle about a tilted axis.

    With the centre h, the long semi-axis r, and the stretch (p, q) = s (cos 2 beta, sin 2 beta), where beta is the
    direction of the long axis in the picture (y down), the positions are h + r / (1 + s) M u, with M = [[1 + p, q], [q,
    1 - p]] and a unit vector u at the angle in the plane of the body. The ratio of the axes is (1 - s) / (1 + s) =
    cos(tilt).
    """

    value: Floats  # shape (5,); centre x, y [px], mean radius r / (1 + s) [px], p and q
    covariance: Floats  # shape (5, 5); covariance of `value`, including position-dependent errors

    @property
    def tilt(self) -> tuple[float, float]:
        """The tilt and the direction of the short axis, counter-clockwise [rad]."""
        p, q = self.value[3:]
        size = math.hypot(p, q)
        short = 0.5 * math.atan2(q, p) + 0.5 * math.pi
        return math.acos((1.0 - size) / (1.0 + size)), -short % math.pi

    @property
    def tilt_u(self) -> float:
        """Standard uncertainty of the tilt [rad]."""
        size = math.hypot(*self.value[3:])
        along = self.value[3:] / max(size, 1e-12)
        u = math.sqrt(float(along @ self.covariance[3:, 3:] @ along))
        ratio = (1.0 - size) / (1.0 + size)
        return 2.0 / (1.0 + size) ** 2 * u / math.sqrt(max(1.0 - ratio**2, 1e-12))

    @property
    def flattened(self) -> bool:
        """Whether the orbit differs significantly from a circle."""
        c = self.value[3:]
        return float(c @ np.linalg.solve(self.covariance[3:, 3:], c)) > STRAIGHT**2

    def plane(self, place: Floats) -> Floats:
        """Return positions (n, 2) in the plane of the body, about the hub [px]."""
        return _in_plane(self.value, place)


def _in_plane(value: Floats, place: Floats) -> Floats:
    x, y, _, p, q = value
    back = np.array([[1.0 - p, -q], [-q, 1.0 + p]]) / (1.0 - p * p - q * q)
    return np.asarray((place - [x, y]) @ back.T)


def fit_orbit(place: Floats, sigma: Floats, least: float = 0.0) -> Orbit:
    """Fit an ellipse to positions (n, 2) that cover most of it, with standard uncertainties (n,) [px].

    The residual is the deviation of the radius in the plane of the body, times the local scale of the picture, so that
    its standard uncertainty is the standard uncertainty of a position. The covariance is computed as in `fit_arc`. A
    ValueError is raised if the fit does not converge because the positions do not determine an ellipse.
    """
    middle, size = place.mean(axis=0), float(np.hypot(*(place - place.mean(axis=0)).T).mean())
    values, axes = np.linalg.eigh(np.cov(place.T))
    ratio = math.sqrt(max(float(values[0]), 1e-12) / float(values[1]))
    s, twice = (1.0 - ratio) / (1.0 + ratio), 2.0 * math.atan2(axes[1, 1], axes[0, 1])
    start = np.array([*middle, size, s * math.cos(twice), s * math.sin(twice)])

    def distance(value: Floats) -> Floats:
        away = _in_plane(value, place)
        radius = np.hypot(*away.T)
        p, q = value[3:]
        back = np.array([[1.0 - p, -q], [-q, 1.0 + p]]) / (1.0 - p * p - q * q)
        # gradient of the radius with respect to the position
        slope = np.hypot(*((away / np.maximum(radius, 1e-9)[:, None]) @ back).T)
        return np.asarray((radius - value[2]) / np.maximum(slope, 1e-9))

    def normalised(value: Floats) -> Floats:
        return distance(value) / sigma

    scale = np.array([size, size, size, 1.0, 1.0])
    rough = least_squares(
        normalised, start, loss="soft_l1", f_scale=3.0, x_scale=scale, max_nfev=_MOST_TRIALS
    )
    if not rough.success:
        raise ValueError("The positions do not determine an ellipse.")
    fit = least_squares(normalised, rough.x, x_scale=scale)
    away = _in_plane(fit.x, place)
    along = np.arctan2(away[:, 1], away[:, 0])
    cell = np.minimum((CELLS * (along + math.pi) / (2.0 * math.pi)).astype(np.int64), CELLS - 1)
    jacobian = np.asarray(fit.jac) * sigma[:, None]
    _, _, covariance = _covariance(jacobian, distance(fit.x), sigma, cell, least)
    return Orbit(np.asarray(fit.x), covariance)


_MOST_TRIALS = 100
"""Largest number of trial ellipses of the first fit of an orbit [1]. Derived: orbits of rendered films need 5 to 53
trials; the fit of a short arc, which determines no ellipse, does not converge even after 500 trials."""
CELLS = 12
"""Number of parts of an arc, each with one position-dependent error [1]. Derived: a full orbit has 12 independent
position-dependent errors, see `_orbit.CELL`."""
_FEWEST_IN_CELL = 3
"""Smallest number of positions in a part of an arc that determine its error [positions]. Chosen: a smaller number gives
a random error, a larger one leaves short arcs without an error."""
STRAIGHT = 4.0
"""Smallest curvature of a path that determines a hub, in standard uncertainties [1]. Chosen: a smaller value gives
hubs with an unbounded uncertainty, a larger one refuses short arcs."""


@dataclass(frozen=True)
class Arc:
    """The circle of a path."""

    hub: Floats  # shape (2,); centre of the circle (x, y) [px]
    covariance: Floats  # shape (2, 2); covariance of the centre [px2]
    radius: float  # radius of the circle [px]
    curvature: float  # 1 / radius and its standard uncertainty [1/px]
    curvature_u: float
    noise: float  # standard deviation of the radial residuals [px]
    by_place: float  # standard deviation of the position-dependent part of the radial residuals [px]

    @property
    def determined(self) -> bool:
        """Whether the curvature of the path is significant."""
        return self.curvature > STRAIGHT * self.curvature_u


_OUTLIER = 5.0
"""Largest distance of an inlier from the circle, in robust standard deviations [1]. Chosen: a smaller value rejects
good positions, a larger one keeps false matches."""


_NEAR_HUB = 0.05
"""Smallest distance of the mean position from the hub, divided by the radius, at which the parameters of the arc are
regular [1]. Derived: the derivatives of the hub grow as the inverse of this distance; at smaller distances, hub and
radius are the parameters of the fit; a smaller value leaves large rounding errors, a larger one changes nothing for
long arcs."""


def fit_arc(place: Floats, sigma: Floats, least: float = 0.0) -> Arc:
    """Fit a circle to positions (n, 2) with standard uncertainties (n,) [px]; at least 6 of them.

    The covariance contains the noise of the residuals, and position-dependent errors (lens, view, interpolation). These
    errors are independent in the `CELLS` parts of the arc. Their standard deviation is the scatter of the means of the
    parts in excess of noise, at least `least` [px].
    """
    origin = place.mean(axis=0)
    x, y = (place - origin).T
    scale = max(float(np.hypot(x, y).max()), 1e-9)
    x, y, s = x / scale, y / scale, sigma / scale

    def distance(c: Floats) -> Floats:
        a, phi, d = c
        root = math.sqrt(max(1.0 + 4.0 * a * d, 1e-12))
        p = a * (x * x + y * y) + root * (math.cos(phi) * x + math.sin(phi) * y) + d
        return np.asarray(2.0 * p / (1.0 + np.sqrt(np.maximum(1.0 + 4.0 * a * p, 1e-12))))

    starts = _starts(x, y)

    def normalised(c: Floats) -> Floats:
        return distance(c) / s

    fits = [least_squares(normalised, c, loss="soft_l1", f_scale=3.0) for c in starts]
    best = min(fits, key=lambda f: float(f.cost)).x
    rest = distance(best)
    # the robust fit gave little weight to outliers, for example frames in which another object was matched
    typical = max(1.4826 * float(np.median(np.abs(rest / s))), 1e-12)
    use = np.abs(rest / s) < _OUTLIER * typical

    def of_used(c: Floats) -> Floats:
        return np.asarray(normalised(c)[use])

    fit = least_squares(of_used, best)
    rest = distance(fit.x)
    jacobian = np.asarray(fit.jac) * s[use, None]  # derivatives of the distances
    a, phi, d = (float(v) for v in fit.x)
    root = math.sqrt(max(1.0 + 4.0 * a * d, 1e-12))
    hub = np.array([-root * math.cos(phi), -root * math.sin(phi)]) / (2.0 * a if a else 1e-12)
    # derivatives of the hub with respect to (a, phi, d)
    root_a, root_d = 2.0 * d / root, 2.0 * a / root
    unit, across = np.array([math.cos(phi), math.sin(phi)]), np.array([-math.sin(phi), math.cos(phi)])
    curve = 2.0 * a if a else 1e-12
    slope = np.stack(
        [
            -unit * root_a / curve + 2.0 * root * unit / curve**2,
            -root * across / curve,
            -unit * root_d / curve,
        ],
        axis=1,
    )
    bend = np.array([2.0, 0.0, 0.0])
    if root < _NEAR_HUB:
        away = np.stack([x[use], y[use]], axis=1) - hub
        jacobian = np.column_stack([away / np.hypot(*away.T)[:, None], np.ones(len(away))])
        slope, bend = np.eye(2, 3), np.array([0.0, 0.0, curve**2])
    noise, by_place, covariance = _covariance(
        jacobian, rest[use], s[use], _cell(x[use], y[use], hub, straight=abs(a) < 1e-6), least / scale
    )
    return Arc(
        hub=origin + scale * hub,
        covariance=scale**2 * slope @ covariance @ slope.T,
        radius=scale / abs(curve),
        curvature=abs(curve) / scale,
        curvature_u=math.sqrt(float(bend @ covariance @ bend)) / scale,
        noise=scale * noise,
        by_place=scale * by_place,
    )


def _starts(x: Floats, y: Floats) -> list[Floats]:
    """Return initial values (A, phi, D): the algebraic circle, and the line along the path."""
    rows = np.stack([x * x + y * y, x, y, np.ones_like(x)], axis=1)
    found = []
    # smallest singular vector, normalised to B^2 + C^2 - 4 A D = 1
    a, b, c, d = np.linalg.svd(rows, full_matrices=False)[2][-1]
    size = b * b + c * c - 4.0 * a * d
    if size > 1e-12:
        a, b, c, d = np.array([a, b, c, d]) / math.sqrt(size)
        found.append(np.array([a, math.atan2(c, b), d]))
    _, _, axes = np.linalg.svd(np.stack([x, y], axis=1), full_matrices=False)
    normal = math.atan2(axes[1, 1], axes[1, 0])
    found += [np.array([bend, normal, -bend * float(np.mean(x * x + y * y))]) for bend in (-0.05, 0.05)]
    return found


def _cell(x: Floats, y: Floats, hub: Floats, *, straight: bool) -> Integers:
    """Return the part of the arc of each position."""
    if straight:
        _, _, axes = np.linalg.svd(np.stack([x, y], axis=1), full_matrices=False)
        along = np.stack([x, y], axis=1) @ axes[0]
    else:
        away = np.exp(-1j * np.angle(complex(*(np.array([x.mean(), y.mean()]) - hub))))
        along = np.angle(((x - hub[0]) + 1j * (y - hub[1])) * away)
    share = (along - along.min()) / max(float(np.ptp(along)), 1e-12)
    return np.asarray(np.minimum((CELLS * share).astype(np.int64), CELLS - 1))


def _covariance(
    jacobian: Floats, rest: Floats, sigma: Floats, cell: Integers, floor: float
) -> tuple[float, float, Floats]:
    """Return the noise, the position-dependent error, and the covariance of the parameters due to both errors."""
    count = max(len(rest) - 3, 1)
    weight = 1.0 / sigma**2
    inverse = np.linalg.pinv((jacobian * weight[:, None]).T @ jacobian)
    members = [np.flatnonzero(cell == k) for k in range(CELLS)]
    members = [m for m in members if len(m) >= _FEWEST_IN_CELL]
    within = sum(float(np.sum((rest[m] - rest[m].mean()) ** 2)) for m in members)
    inner = math.sqrt(within / max(sum(len(m) - 1 for m in members), 1)) if members else 0.0
    noise = inner or float(np.sqrt(np.sum(rest**2) / count))
    chi2 = max(noise / float(np.sqrt(np.mean(sigma**2))), 1e-12) ** 2
    covariance = inverse * chi2
    by_place = floor
    if len(members) > 4:
        mean = np.array([rest[m].mean() for m in members])
        expected = float(np.mean([noise**2 / len(m) for m in members]))
        # the three parameters absorb a part of the position-dependent errors; a scatter within two standard deviations
        # is noise
        free = len(members) - 3
        scatter = float(np.sum(mean**2)) / free
        if scatter > expected * (1.0 + 2.0 * math.sqrt(2.0 / free)):
            by_place = max(math.sqrt(scatter - expected), floor)
        response = inverse @ (jacobian * weight[:, None]).T
        grouped = np.stack([response[:, m].sum(axis=1) for m in members])
        covariance = covariance + by_place**2 * grouped.T @ grouped
    return noise, by_place, np.asarray(covariance)


def angles_about(hub: Floats, place: Floats) -> Floats:
    """Return the unwrapped angles of positions (n, 2) about a hub, counter-clockwise as seen [rad]."""
    away = place - hub
    return np.asarray(-np.unwrap(np.arctan2(away[:, 1], away[:, 0])))
