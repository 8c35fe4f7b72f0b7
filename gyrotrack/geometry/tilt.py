"""The tilt of the camera and the true centre of an orbit, from the orbit itself.

A circle seen from a slant is an ellipse, and a mark that lies higher than the disc at the centre circles a
point beside it. With v = (x - cx, -(y - cy)) the position of a marker relative to the disc,

    v = e + rho A (cos theta, sin theta),    A = [[1 + p, q], [q, 1 - p]],

with e the offset of the orbit's centre and (p, q) the flattening: for a tilt t, hypot(p, q) = t^2 / 4. Both
show in the radius and both bend the angle: uncorrected, e shifts it by |e| / rho once a turn, (p, q) by
hypot(p, q) twice a turn.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.centre import LEAST_SIGMA
from gyrotrack.geometry.local import median_of, spread
from gyrotrack.geometry.orbit import covered_angle

Floats = npt.NDArray[np.float64]

MOST_SIGHTINGS = 2000
LEAST_SIGHTINGS = 30
CELL = np.pi / 6.0
"""Turn in rad over which errors by place hang together: they are as large in the sixth harmonic as in the first."""
LEAST_COVER = 5.0
"""Angle in rad that must be covered by the sightings before an orbit is trusted."""


@dataclass(frozen=True)
class Flattening:
    """What a slanted view does to an orbit: offsets e per marker in px (y up), and (p, q).

    `doubt` holds the covariance of e in px^2, (2, 2), of those markers whose orbit shows it in part only.
    """

    offset: dict[str, tuple[float, float]]
    p: float
    q: float
    doubt: dict[str, Floats] = field(default_factory=dict, compare=False)

    @property
    def tilt(self) -> float:
        """The tilt in rad that gives this flattening."""
        return float(2.0 * np.sqrt(np.hypot(self.p, self.q)))

    def level(self, name: str, v: Floats) -> Floats:
        """Return A^-1 (v - e): the position as seen from straight above, (n, 2)."""
        e = np.array(self.offset.get(name, (0.0, 0.0)))
        matrix = np.array([[1.0 + self.p, self.q], [self.q, 1.0 - self.p]])
        return np.asarray((v - e) @ np.linalg.inv(matrix).T)

    def moved(self, by: Floats) -> Flattening:
        """Return it with all offsets moved, by (2,) px."""
        offset = {name: (x + float(by[0]), y + float(by[1])) for name, (x, y) in self.offset.items()}
        return replace(self, offset=offset)

    def shift(self, names: Iterable[str]) -> Floats:
        """Return the mean of the offsets of some markers, (2,) in px."""
        return np.asarray(np.mean([self.offset[name] for name in names if name in self.offset], axis=0))

    def pull(self, name: str, angle: Floats) -> Floats:
        """Return how far in px the doubt about e moves a marker along its orbit, less what all frames share, (n,)."""
        if name not in self.doubt:
            return np.zeros(len(angle))
        along = np.stack([-np.sin(angle), np.cos(angle)])
        along -= np.nanmean(along, axis=1, keepdims=True)
        return np.asarray(np.sqrt(np.einsum("in,ij,jn->n", along, self.doubt[name], along)))


NO_FLATTENING = Flattening({}, 0.0, 0.0)


def fit_flattening(positions: dict[str, Floats], rounds: int = 6) -> Flattening:
    """Fit offsets and flattening to the orbits of one or more markers.

    Parameters
    ----------
    positions : dict of ndarray, shape (n, 2)
        Positions v of each marker relative to the centre, y up, only trusted ones.

    Notes
    -----
    Gauss-Newton on the radii: |v| = rho + e . r + rho (p cos 2 theta + q sin 2 theta) to first
    order, with r the unit vector of theta; points beyond 4 median absolute deviations are left out in each
    round. Markers whose sightings cover less than 5 rad take no part.
    """
    use = {name: v for name, v in positions.items() if len(v) >= LEAST_SIGHTINGS and _cover(v) > LEAST_COVER}
    if not use:
        return NO_FLATTENING
    found = Flattening(dict.fromkeys(use, (0.0, 0.0)), 0.0, 0.0)
    # Some thousand sightings settle a handful of numbers.
    few = {name: v[:: max(len(v) // MOST_SIGHTINGS, 1)] for name, v in use.items()}
    for _ in range(rounds):
        found = _improved(found, few)
    return found


def lent_flattening(
    lender: Flattening, positions: dict[str, Floats], shift: Floats, size: float
) -> Flattening:
    """Take the slant of the view from another body; on the arcs that the markers pass fit offsets only.

    Parameters
    ----------
    lender : Flattening
        Of a body that went round, in the same picture.
    positions : dict of ndarray, shape (n, 2)
        As for `fit_flattening`.
    shift : ndarray, shape (2,)
        The offset that is expected [px], here for all markers.
    size : float
        Standard deviation of that expectation [px].

    Notes
    -----
    An arc tells e in part; `doubt` is what it leaves open. Errors by place, not noise, limit the fit: sightings count
    once for each `CELL`.
    """
    expected = (float(shift[0]), float(shift[1]))
    found = Flattening(dict.fromkeys(positions, expected), lender.p, lender.q)
    for name, v in positions.items():
        found.doubt[name] = size**2 * np.eye(2)
        if len(v) >= LEAST_SIGHTINGS:
            more, found.doubt[name] = _arc(found.level(name, v), size)
            found.offset[name] = (expected[0] + float(more[0]), expected[1] + float(more[1]))
    return found


def _arc(v: Floats, size: float) -> tuple[Floats, Floats]:
    """Fit the offset of an arc, expected to be 0 within `size`: (2,) and its covariance (2, 2)."""
    few = v[:: max(len(v) // MOST_SIGHTINGS, 1)]
    rho, theta = np.hypot(few[:, 0], few[:, 1]), np.arctan2(few[:, 1], few[:, 0])
    design = np.stack([np.ones_like(theta), np.cos(theta), np.sin(theta)], axis=1)
    expected = np.diag([0.0, size**-2, size**-2])
    alike = max(len(rho) * CELL / max(covered_angle(theta), CELL), 1.0)
    keep = np.ones(len(rho), dtype=np.bool_)
    for _ in range(3):
        free = np.linalg.lstsq(design[keep], rho[keep], rcond=None)[0]
        scatter = max(spread(rho[keep] - design[keep] @ free), LEAST_SIGMA)
        weight = 1.0 / (alike * scatter**2)
        covariance = np.linalg.inv(weight * design[keep].T @ design[keep] + expected)
        solution = weight * covariance @ design[keep].T @ rho[keep]
        keep = np.abs(rho - design @ solution) < 4.0 * scatter
    return solution[1:], np.asarray(covariance[1:, 1:])


def _cover(v: Floats) -> float:
    return covered_angle(np.arctan2(v[:, 1], v[:, 0]))


def _improved(found: Flattening, positions: dict[str, Floats]) -> Flattening:
    names = list(positions)
    solution = _robust([_model(found.level(name, positions[name])) for name in names])
    offset = {
        name: (
            found.offset[name][0] + float(solution[3 * k + 1]),
            found.offset[name][1] + float(solution[3 * k + 2]),
        )
        for k, name in enumerate(names)
    }
    return Flattening(offset, found.p + float(solution[-2]), found.q + float(solution[-1]))


def _model(v: Floats) -> tuple[Floats, Floats]:
    """Return the linear model of the radii of one marker, (5, n), and by how much they exceed the usual one, (n,)."""
    rho = np.hypot(v[:, 0], v[:, 1])
    typical = median_of(rho)
    c, s = v[:, 0] / rho, v[:, 1] / rho
    return np.stack([np.ones_like(c), c, s, typical * (c * c - s * s), 2.0 * typical * c * s]), rho - typical


def _robust(models: list[tuple[Floats, Floats]]) -> Floats:
    """Fit radius and offset of each marker, and what is common to all at the end, without what lies far off."""
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
