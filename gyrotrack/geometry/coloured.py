"""Finding a coloured paper in the unrolled rings of the sample frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.patch import Extent, aligned, extent_of
from gyrotrack.geometry.scene import Paper
from gyrotrack.profile import MarkerProfile
from gyrotrack.segmentation.colour import chroma_direction, hue_score
from gyrotrack.segmentation.ring import Ring, boxed

Floats = npt.NDArray[np.float64]
Strips = npt.NDArray[np.float32]

LEAST_CONTRAST = 6.0
"""Grey levels by which a paper must differ from its surroundings."""
LONGEST_STAY = 0.3
"""Share of the samples beyond which a paper over one direction spoils the median as a background."""


@dataclass(frozen=True)
class Sighting:
    """One marker in the samples: the paper, its angle in each sample (rad), and where it was seen clearly."""

    paper: Paper
    angle: Floats
    clear: npt.NDArray[np.bool_]


class Rings:
    """Unrolled chroma of the samples, and how it differs from what usually lies there.

    Parameters
    ----------
    strips : ndarray of uint8, shape (2, n, rows, columns)
        Chroma of each sample.
    ring : Ring
        Where they were unrolled.
    """

    def __init__(self, strips: npt.NDArray[np.uint8], ring: Ring) -> None:
        self.strips, self.ring = strips, ring

    @cached_property
    def usual(self) -> Strips:
        """Median of the samples at every place, (2, rows, columns)."""
        return np.asarray(np.median(self.strips, axis=1), dtype=np.float32)

    @cached_property
    def unusual(self) -> Strips:
        """Difference of each sample from it."""
        return np.asarray(self.strips - self.usual[:, None], dtype=np.float32)

    @cached_property
    def uneven(self) -> Strips:
        """Difference from the median round each ring, where something stands too long over one place."""
        ground = np.asarray(np.median(self.strips, axis=3, keepdims=True), dtype=np.float32)
        return np.asarray(self.strips - ground, dtype=np.float32)


def find_coloured(rings: Rings, marker: MarkerProfile) -> Sighting | None:
    """Find a coloured paper in rings about the centre.

    The background is the median of the samples at every place; where the paper stood too long over one place,
    the median round each ring instead.
    """
    seen = _sight(rings.unusual, rings.ring, marker)
    if seen is None or seen.paper.stay > LONGEST_STAY:
        standing = _sight(rings.uneven, rings.ring, marker)
        seen = standing if standing is not None else seen
    return seen


def _sight(difference: Strips, ring: Ring, marker: MarkerProfile) -> Sighting | None:
    direction = chroma_direction(marker.colour, marker.hue)
    score = np.stack([hue_score(u, v, direction) for u, v in zip(*difference, strict=True)])
    extent = Extent(np.ones(ring.rows, dtype=np.bool_), ring.inner, ring.outer, 0.15, 0)
    for _ in range(3):
        half = int(max(extent.half_width / ring.step, 1))
        column, clear = _brightest(score[:, extent.rows].mean(axis=1), half)
        patch = aligned(score, column, clear)
        found = extent_of(patch, ring)
        if found is None:
            return None
        extent = found
    core = extent.core(patch.shape[1], ring.step)
    u, v = (float(aligned(part, column, clear)[core].mean()) for part in difference)
    if np.hypot(u, v) < LEAST_CONTRAST or clear.mean() < 0.1:
        return None
    coarse = np.asarray((column + extent.lean) * ring.step, dtype=np.float64)
    angle = _refined(score[:, extent.rows].mean(axis=1), coarse, extent.half_width, ring)
    paper = Paper(
        name=marker.name,
        body=marker.body,
        colour=marker.colour,
        inner=extent.inner,
        outer=extent.outer,
        half_width=extent.half_width,
        contrast=(u, v),
        foot=extent.foot,
        stay=_stay(angle, 1.3 * extent.half_width),
    )
    return Sighting(paper, angle, clear)


def _brightest(profile: Strips, half: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Return the brightest direction of each sample, and where it is about as bright as in most others."""
    mean = boxed(profile, half)
    column = np.argmax(mean, axis=1)
    peak = mean[np.arange(len(mean)), column]
    return column, peak > 0.5 * float(np.median(np.sort(peak)[len(peak) // 2 :]))


def _stay(angle: Floats, reach: float) -> float:
    """Return the largest share of the samples that lie within `reach` of one direction."""
    apart = np.abs(np.angle(np.exp(1j * (angle[:, None] - angle[None, :]))))
    return float((apart < reach).mean(axis=0).max())


def _refined(profile: Strips, angle: Floats, half_width: float, ring: Ring) -> Floats:
    """Replace coarse angles by the centroid of the score around them."""
    reach = int(np.ceil(1.5 * half_width / ring.step)) + 1
    start = np.rint(angle / ring.step).astype(int)
    offset = np.arange(-reach, reach + 1)
    window = np.take_along_axis(profile, (start[:, None] + offset) % ring.columns, axis=1).astype(np.float64)
    window -= window.min(axis=1, keepdims=True)
    shift = (window @ offset) / np.maximum(window.sum(axis=1), 1e-9)
    return np.asarray((start + shift) * ring.step)
