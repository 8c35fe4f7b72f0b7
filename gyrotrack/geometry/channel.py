"""A ring about the centre, in chroma or in luma, collected for a batch of frames; scores of papers in it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.coloured import LONGEST_STAY
from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Paper
from gyrotrack.segmentation.ring import ring_for, unroll
from gyrotrack.video.planes import Frame

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

LUMA_COLUMNS = 1024


class Channel:
    """A ring with a buffer for a batch, and the background on which papers lie.

    A score is linear in the planes: 0 on the background, 1 on the paper.

    Parameters
    ----------
    papers : tuple of Paper
        Markers that are seen in it: all coloured or all white.
    samples : Samples
        Frames from which the background is taken.
    centre : tuple of float
        Centre of the ring in px.
    keep_out : float
        Radius in px below which nothing is looked at (the disc at the centre).
    capacity : int
        Frames of a batch.
    """

    def __init__(
        self,
        papers: tuple[Paper, ...],
        samples: Samples,
        centre: tuple[float, float],
        keep_out: float,
        capacity: int,
    ) -> None:
        self.papers = papers
        self.white = papers[0].colour == "white"
        inner, outer = min(p.inner for p in papers), max(p.outer for p in papers)
        margin = max(6.0, 0.3 * (outer - inner))
        pixel = 1.5 if self.white else 2.0
        self.ring = ring_for(centre, max(inner - margin, keep_out, 2.0), outer + margin, pixel)
        planes = 1 if self.white else 2
        self._strips = np.zeros((capacity, planes, self.ring.rows, self.ring.columns), dtype=np.uint8)
        self._ground = self._background(samples)

    def _background(self, samples: Samples) -> npt.NDArray[np.float32]:
        """Return what lies under the papers: the median of the samples; of each row if they hardly moved."""
        strips = samples.luma_strips(self.ring)[None] if self.white else samples.strips(self.ring)
        ground = np.asarray(np.median(strips, axis=1), dtype=np.float32)
        if max(paper.stay for paper in self.papers) > LONGEST_STAY:
            ground[:] = np.median(ground, axis=2, keepdims=True)
        return ground

    def aim(self, centre: tuple[float, float]) -> None:
        """Put the ring about another centre."""
        self.ring = self.ring.moved(centre)

    def take(self, frame: Frame, place: int) -> None:
        """Unroll one frame into the buffer."""
        if self.white:
            unroll(frame.y, self.ring.luma_maps, self._strips[place, 0])
        else:
            maps = self.ring.chroma_maps
            unroll(frame.u, maps, self._strips[place, 0])
            unroll(frame.v, maps, self._strips[place, 1])

    def rows(self, paper: Paper) -> Integers:
        """Rows that lie well on a paper, away from its near and far edge."""
        edge = min(2.0, 0.15 * (paper.outer - paper.inner))
        inside = np.flatnonzero(
            (self.ring.radii >= paper.inner + edge) & (self.ring.radii <= paper.outer - edge)
        )
        return inside if len(inside) else np.array([int(np.argmin(np.abs(self.ring.radii - paper.radius)))])

    def weights(self, paper: Paper) -> tuple[np.float32, ...]:
        """Weights of the planes that make the score 1 on the paper and 0 beside it."""
        a, b = paper.contrast
        norm = a * a + b * b
        return (np.float32(1.0 / a),) if self.white else (np.float32(a / norm), np.float32(b / norm))

    def around(self, paper: Paper, count: int) -> Floats:
        """Return the mean score over the rows of a paper in all directions: (count, columns)."""
        rows = self.rows(paper)
        first, last = int(rows[0]), int(rows[-1]) + 1
        score = np.zeros((count, self.ring.columns))
        for plane, weight in enumerate(self.weights(paper)):
            level = self._strips[:count, plane, first:last].mean(axis=1, dtype=np.float32)
            score += weight * (level - self._ground[plane, first:last].mean(axis=0))
        return score

    def window(self, paper: Paper, start: Integers, half: int) -> Floats:
        """Return the score within `half` columns of `start` in each frame: (count, rows, 2 half + 1)."""
        out = np.zeros((len(start), self.ring.rows, 2 * half + 1), dtype=np.float32)
        pixels, ground = np.empty_like(out), np.empty_like(out)
        first = (start - half) % self.ring.columns
        for plane, weight in enumerate(self.weights(paper)):
            for k, column in enumerate(first.tolist()):
                _cut(self._strips[k, plane], column, pixels[k])
                _cut(self._ground[plane], column, ground[k])
            out += weight * (pixels - ground)
        return out.astype(np.float64)


def _cut(strip: npt.NDArray[Any], first: int, out: npt.NDArray[np.float32]) -> None:
    """Copy columns from `first` on out of a strip that closes on itself."""
    inside = min(strip.shape[1] - first, out.shape[1])
    out[:, :inside] = strip[:, first : first + inside]
    if inside < out.shape[1]:
        out[:, inside:] = strip[:, : out.shape[1] - inside]
