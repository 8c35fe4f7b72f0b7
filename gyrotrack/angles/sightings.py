"""What was seen of one marker, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.columns import put_away, stretches

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Sightings:
    """One marker in consecutive frames, about the ring's centre; NaN where its body was not followed.

    Attributes
    ----------
    angle, radius : ndarray, shape (n,)
        Fine angle as seen [rad], radius of the middle of the paper [px].
    corner_angle, corner_radius : ndarray, shape (n, 2)
        The near corners about the ring's centre.
    gain, misfit : ndarray, shape (n,)
        Height relative to the typical one, and rms of what the template leaves over, relative to the gain.
    weakness : ndarray, shape (n,)
        Factor on the uncertainty for what is hidden or dim; see `matching.Match`.
    open : ndarray of bool, shape (n,)
        Nothing is known to stand before any part of the marker.
    centre : ndarray, shape (n, 2)
        Centre of the ring in px.
    """

    angle: Floats
    radius: Floats
    corner_angle: Floats
    corner_radius: Floats
    gain: Floats
    misfit: Floats
    weakness: Floats
    open: Mask
    centre: Floats

    @staticmethod
    def joined(parts: list[Sightings]) -> Sightings:
        """Put batches one after the other."""
        return Sightings(
            **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Sightings)}
        )

    def spread_out(self, index: npt.NDArray[np.int64], count: int) -> Sightings:
        """Put the frames at the places `index` of `count`; see `spread_out`."""
        return Sightings(
            **put_away({f.name: spread_out(getattr(self, f.name), index, count) for f in fields(Sightings)})
        )

    def picked(self, index: npt.NDArray[np.int64]) -> Sightings:
        """Return the frames `index` alone."""
        return Sightings(**put_away({f.name: getattr(self, f.name)[index] for f in fields(Sightings)}))

    def at(self, part: slice) -> Sightings:
        """Return some of the frames."""
        return Sightings(**{f.name: getattr(self, f.name)[part] for f in fields(Sightings)})

    def outside(self, inner: float, outer: float, half_width: float, size: tuple[int, int]) -> Mask:
        """Return where a part of the marker lies outside a picture of (width, height) px."""
        found = np.zeros(len(self.angle), dtype=np.bool_)
        for part in stretches(len(found)):
            for radius in (inner, outer):
                for side in (-half_width, half_width):
                    x = self.centre[part, 0] + radius * np.cos(self.angle[part] + side)
                    y = self.centre[part, 1] - radius * np.sin(self.angle[part] + side)
                    with np.errstate(invalid="ignore"):
                        found[part] |= (x < 0) | (y < 0) | (x > size[0] - 1) | (y > size[1] - 1)
        return found

    def position(self, good: Mask) -> Floats:
        """Return where the middle of the marker is, (n, 2) in px; at its usual radius where not good."""
        usual = float(np.nanmedian(self.radius[good])) if good.any() else np.nan
        r = np.where(good, self.radius, usual)
        place = np.empty(self.centre.shape)
        place[:, 0] = self.centre[:, 0] + r * np.cos(self.angle)
        place[:, 1] = self.centre[:, 1] - r * np.sin(self.angle)
        return place


def spread_out(values: npt.NDArray[Any], index: npt.NDArray[np.int64], count: int) -> npt.NDArray[Any]:
    """Put rows at the places `index` of `count` rows; the others are NaN, or False."""
    out = np.zeros((count, *values.shape[1:]), dtype=values.dtype)
    if values.dtype != np.bool_:
        out[:] = np.nan
    out[index] = values
    return out
