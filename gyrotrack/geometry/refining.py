"""The centre made better by the markers that circle it.

A centre that is wrong by n makes a marker's radius wrong by -n . r, with r the direction of the marker: a marker on
one side seems too near, one on the other too far. Encoders hold the disc at the centre in place while it creeps, and
then its own image tells nothing, but the radii of all markers over some dozen frames do.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.columns import new_columns, stretches
from gyrotrack.geometry.centre import LEAST_SIGMA, CentrePath
from gyrotrack.geometry.local import spread

Floats = npt.NDArray[np.float64]

HALF = 18
"""Frames to both sides over which the centre's error is taken to be one and the same."""
EXPECTED = 0.1
"""How far in px a measured centre may be off: the weight of finding no error."""


@dataclass(frozen=True)
class Radii:
    """One marker: its direction in each frame as seen (n,) [rad], and by how much its radius is too large [px].

    `excess` is NaN where the marker is not to be used.
    """

    direction: Floats
    excess: Floats


def refine_centre(path: CentrePath, markers: Iterable[Radii]) -> CentrePath:
    """Correct a centre by the radii of the markers about it.

    Notes
    -----
    In a window about each frame n minimises sum w (excess + n . r)^2 / s^2 + |n|^2 / `EXPECTED`^2, with s the
    scatter of a marker's radius and w falling off to both sides. The uncertainty is that of this fit.
    """
    count = len(path.centre)
    normal, right = np.zeros((3, count)), np.zeros((2, count))
    for marker in markers:
        known = np.isfinite(marker.excess) & np.isfinite(marker.direction)
        if known.sum() < 20:
            continue
        scatter, limits = max(spread(marker.excess[known]), 0.02), _limits(marker.excess[known])
        for part in stretches(count):
            weight = known[part] / scatter**2
            angle = np.where(known[part], marker.direction[part], 0.0)
            x, y = np.cos(angle), -np.sin(angle)
            excess = np.clip(np.where(known[part], marker.excess[part], 0.0), *limits)
            normal[:, part] += weight * np.stack([x * x, x * y, y * y])
            right[:, part] -= weight * excess * np.stack([x, y])
    for row in (*normal, *right):
        row[:] = _windowed(row)
    better = new_columns(count, {"centre": ((2,), "f8"), "sigma": ((), "f8")})
    for part in stretches(count):
        (a, b, c), (u, v) = normal[:, part], right[:, part]
        a, c = a + 1.0 / EXPECTED**2, c + 1.0 / EXPECTED**2
        determinant = a * c - b * b
        error = np.stack([(c * u - b * v) / determinant, (a * v - b * u) / determinant], axis=1)
        sigma, before = np.sqrt(0.5 * (a + c) / determinant), path.sigma[part]
        better["centre"][part] = path.centre[part] - error
        better["sigma"][part] = np.where(
            np.isfinite(before), np.minimum(np.hypot(sigma, 0.4 * LEAST_SIGMA), before), np.nan
        )
    return CentrePath(reach=path.reach, **better)


def _limits(excess: Floats) -> tuple[float, float]:
    reach = 4.0 * spread(excess)
    return -reach, reach


def _windowed(row: Floats) -> Floats:
    bell = 1.0 - (np.arange(-HALF, HALF + 1) / (HALF + 1)) ** 2
    return np.asarray(np.convolve(np.pad(row, HALF), bell, mode="valid"))
