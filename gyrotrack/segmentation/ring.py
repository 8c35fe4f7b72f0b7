"""A ring about a centre, unrolled: rows are radii, columns are angles.

A marker that turns about the centre only shifts along such a strip, and its edges stand upright in it.
Angles are counter-clockwise as seen, atan2(-(y - cy), x - cx); pixel centres are at integers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack.video.planes import Plane

Maps = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]

CHROMA_SHIFT = (0.0, 0.5)
"""Where the first chroma sample lies in luma px (x, y): on the left column, between two rows."""


@dataclass(frozen=True)
class Ring:
    """A polar grid.

    Attributes
    ----------
    centre : tuple of float
        (x, y) in luma px.
    inner, outer : float
        Radii of the first and last row in luma px.
    rows, columns : int
        Size of the strip; columns cover the full turn, the first at angle 0.
    """

    centre: tuple[float, float]
    inner: float
    outer: float
    rows: int
    columns: int

    @property
    def radii(self) -> npt.NDArray[np.float64]:
        """Radii of the rows in luma px."""
        return np.linspace(self.inner, self.outer, self.rows)

    @property
    def step(self) -> float:
        """Angle from one column to the next in rad."""
        return 2.0 * np.pi / self.columns

    def moved(self, centre: tuple[float, float]) -> Ring:
        """Return the same grid about another centre."""
        return Ring(centre, self.inner, self.outer, self.rows, self.columns)

    @cached_property
    def chroma_maps(self) -> Maps:
        """Maps for `cv2.remap` of a half-resolution plane."""
        return self.maps(chroma=True)

    @cached_property
    def luma_maps(self) -> Maps:
        """Maps for `cv2.remap` of the full-resolution plane."""
        return self.maps(chroma=False)

    def maps(self, *, chroma: bool, beyond: int = 0) -> Maps:
        """Return the (x, y) in px of a plane of every point; `beyond` columns more than a full turn."""
        angle = np.arange(self.columns + beyond) * self.step
        radius = self.radii[:, None]
        x, y = self.centre[0] + radius * np.cos(angle), self.centre[1] - radius * np.sin(angle)
        if chroma:
            x, y = (x - CHROMA_SHIFT[0]) / 2.0, (y - CHROMA_SHIFT[1]) / 2.0
        return x.astype(np.float32), y.astype(np.float32)


def ring_for(centre: tuple[float, float], inner: float, outer: float, pixel: float) -> Ring:
    """Lay a grid with a little more than a sample per `pixel` (in luma px: 2 for chroma, 1 for luma)."""
    columns = int(np.clip(np.ceil(1.4 * np.pi * (inner + outer) / pixel), 128, 1024))
    rows = int(np.clip(np.ceil((outer - inner) / pixel) + 1, 6, 32))
    return Ring(centre, inner, outer, rows, columns)


def unroll(plane: Plane, maps: Maps, out: Plane | None = None) -> Plane:
    """Sample a plane along a ring (bilinear); beyond the picture its border is repeated."""
    strip = cv2.remap(plane, maps[0], maps[1], cv2.INTER_LINEAR, dst=out, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(strip, dtype=np.uint8)


def boxed(profile: npt.NDArray[np.floating[Any]], half: int) -> npt.NDArray[np.float64]:
    """Average profiles that close on themselves, (n, columns), over 2 half + 1 columns."""
    width = 2 * half + 1
    padded = np.concatenate([profile[:, -half:], profile, profile[:, :half]], axis=1).astype(np.float64)
    total = np.cumsum(np.pad(padded, ((0, 0), (1, 0))), axis=1)
    return np.asarray((total[:, width:] - total[:, :-width]) / width)
