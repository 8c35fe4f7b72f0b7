"""The tilt of the camera and the true centre of an orbit, from the orbit itself.

A circle seen from a slant is an ellipse, and a mark that lies higher than the disc at the centre circles a
point beside it. With v = (x - cx, -(y - cy)) the position of a marker relative to the disc,

    v = e + rho A (cos theta, sin theta),    A = [[1 + p, q], [q, 1 - p]],

with e the offset of the orbit's centre and (p, q) the flattening: for a tilt t, hypot(p, q) = t^2 / 4. Both
show in the radius and both bend the angle: uncorrected, e shifts it by |e| / rho once a turn, (p, q) by
hypot(p, q) twice a turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.local import median_of
from gyrotrack.geometry.orbit import covered_angle

Floats = npt.NDArray[np.float64]

MOST_SIGHTINGS = 2000
LEAST_COVER = 5.0
"""Angle in rad that must be covered by the sightings before an orbit is trusted."""


@dataclass(frozen=True)
class Flattening:
    """What a slanted view does to an orbit: offsets e per marker in px (y up), and (p, q)."""

    offset: dict[str, tuple[float, float]]
    p: float
    q: float

    @property
    def tilt(self) -> float:
        """The tilt in rad that gives this flattening."""
        return float(2.0 * np.sqrt(np.hypot(self.p, self.q)))

    def level(self, name: str, v: Floats) -> Floats:
        """Return A^-1 (v - e): the position as seen from straight above, (n, 2)."""
        e = np.array(self.offset.get(name, (0.0, 0.0)))
        matrix = np.array([[1.0 + self.p, self.q], [self.q, 1.0 - self.p]])
        return np.asarray((v - e) @ np.linalg.inv(matrix).T)


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
    use = {name: v for name, v in positions.items() if len(v) >= 30 and _cover(v) > LEAST_COVER}
    if not use:
        return NO_FLATTENING
    found = Flattening(dict.fromkeys(use, (0.0, 0.0)), 0.0, 0.0)
    # Some thousand sightings settle a handful of numbers.
    few = {name: v[:: max(len(v) // MOST_SIGHTINGS, 1)] for name, v in use.items()}
    for _ in range(rounds):
        found = _improved(found, few)
    return found


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
