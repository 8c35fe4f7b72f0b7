"""Polar sampling of a frame: rings about a centre, and windows of these rings.

In the unrolled strip, a rotation of a marker about the centre is a displacement along the columns.
Angles are counter-clockwise as seen, atan2(-(y - cy), x - cx); pixel centres are at integers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from gyrotrack._arrays import Floats, Integers, Plane, Singles
from gyrotrack._column_store import WithBuffer
from gyrotrack._native import _kernels as kernels
from gyrotrack.video._container import Frame

Maps = tuple[Singles, Singles]

CHROMA_SHIFT = (0.0, 0.5)
"""Position (x, y) of the first chroma sample in the luma: on the left column, between two rows [px]. Source:
chroma_sample_loc_type 0 of ITU-T H.264, the default of its decoders."""


@dataclass(frozen=True)
class Ring:
    """A polar grid."""

    centre: tuple[float, float]  # (x, y) in luma px
    # radii of the first and last row in luma px
    inner: float
    outer: float
    # size of the strip; columns cover the full turn, the first at angle 0
    rows: int
    columns: int

    @property
    def radii(self) -> Floats:
        """Radii of the rows in luma px."""
        return np.linspace(self.inner, self.outer, self.rows)

    @property
    def step(self) -> float:
        """Angle from one column to the next in rad."""
        return 2.0 * np.pi / self.columns

    def moved(self, centre: tuple[float, float]) -> Ring:
        """Return the same grid about another centre."""
        return Ring(centre, self.inner, self.outer, self.rows, self.columns)

    def maps(self, *, chroma: bool, beyond: int = 0) -> Maps:
        """Return x and y of every point [px of a plane], with `beyond` additional columns after the full turn."""
        angle = np.arange(self.columns + beyond) * self.step
        radius = self.radii[:, None]
        x, y = self.centre[0] + radius * np.cos(angle), self.centre[1] - radius * np.sin(angle)
        if chroma:
            x, y = (x - CHROMA_SHIFT[0]) / 2.0, (y - CHROMA_SHIFT[1]) / 2.0
        return x.astype(np.float32), y.astype(np.float32)


def ring_for(centre: tuple[float, float], inner: float, outer: float, pixel: float) -> Ring:
    """Return a grid with slightly more than one sample per `pixel` [luma px] (2 for chroma, 1 for luma)."""
    columns = int(np.clip(np.ceil(1.4 * np.pi * (inner + outer) / pixel), 128, 1024))
    rows = int(np.clip(np.ceil((outer - inner) / pixel) + 1, 6, 32))
    return Ring(centre, inner, outer, rows, columns)


def unroll(plane: Plane, maps: Maps) -> Plane:
    """Sample a plane along a ring (bilinear); the border of the picture is replicated."""
    strip = cv2.remap(plane, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(strip, dtype=np.uint8)


def boxed(profile: npt.NDArray[np.floating[Any]], half: int) -> Floats:
    """Return the moving average of cyclic profiles, (n, columns), over 2 half + 1 columns."""
    return cyclic_sum(profile, half) / (2 * half + 1)


def cyclic_sum(profile: npt.NDArray[np.floating[Any]], half: int) -> Floats:
    """Return the moving sum of cyclic profiles, (n, columns), over 2 half + 1 columns."""
    padded = np.pad(profile, ((0, 0), (half, half)), mode="wrap").astype(np.float64)
    total = np.cumsum(np.pad(padded, ((0, 0), (1, 0))), axis=1)
    return np.asarray(total[:, 2 * half + 1 :] - total[:, : -(2 * half + 1)])


# left, right, top and bottom edge in px of a plane; right and bottom are one px beyond the box
Box = npt.NDArray[np.int32]


class Score(WithBuffer):
    """Weighted sum of planes (luma if `white`, else chroma) that maximises the contrast of a marker.

    All frames use one buffer.
    """

    _buffer = "buffer"

    def __init__(self, white: bool, weights: tuple[float, float], shape: tuple[int, ...]) -> None:  # noqa: FBT001
        self.white = white
        self.weights = weights
        self.buffer = np.zeros(shape, dtype=np.float32)

    def planes(self, frames: list[Frame]) -> tuple[list[npt.NDArray[np.uint8]], ...]:
        """Return the planes that the score uses, one list for each weight."""
        if self.white:
            return ([frame.y for frame in frames],)
        return ([frame.u for frame in frames], [frame.v for frame in frames])

    def unrolled(self, frame: Frame, box: Box, x: Singles, y: Singles) -> Singles:
        """Sample the score of a frame at positions within a box; the buffer is not changed outside."""
        left, right, top, bottom = box.tolist()
        part = (slice(top, bottom), slice(left, right))
        a, b = self.weights
        if self.white:
            np.copyto(self.buffer[part], frame.y[part])  # the weight is applied after sampling
        else:
            cv2.addWeighted(frame.u[part], a, frame.v[part], b, 0.0, dst=self.buffer[part], dtype=cv2.CV_32F)
        seen = cv2.remap(self.buffer, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        found: Singles = np.asarray(seen, dtype=np.float32)
        if self.white:
            found *= np.float32(a)
        return found


class Grid:
    """Positions of the samples of a ring in a plane, and the bounding boxes of windows of `width` columns."""

    def __init__(self, ring: Ring, width: int, score: Score) -> None:
        self.ring, self.width, self.score = ring, width, score
        self.x, self.y = ring.maps(chroma=not score.white, beyond=width)
        rows, columns = score.buffer.shape
        self.boxes = np.column_stack([_reach(self.x, width, columns), _reach(self.y, width, rows)])
        everything = self.x.shape[1]
        self.whole = np.concatenate(
            [_reach(self.x, everything, columns), _reach(self.y, everything, rows)], axis=1
        )[0]

    def cut(self, frames: list[Frame], first: Integers, ground: Singles, windows: Singles) -> None:
        """Sample one window per frame from the columns `first` (n,), minus the background: (n, rows, width)."""
        score = self.score
        planes = score.planes(frames)
        kernels.sample(planes, score.weights, self._places, self.boxes, ground, first, score.buffer, windows)

    def around(self, frame: Frame, rows: slice) -> Singles:
        """Sample rows at all angles."""
        return self.score.unrolled(frame, self.whole, self.x[rows], self.y[rows])

    def turns(self, frames: list[Frame], rows: slice) -> Singles:
        """Sample rows at all angles in some frames, (n, rows, columns)."""
        score, (at, right, down) = self.score, (np.ascontiguousarray(place[rows]) for place in self._places)
        out = np.empty((len(frames), *at.shape), dtype=np.float32)
        nothing, begin = np.zeros_like(right), np.zeros(len(frames), dtype=np.int64)
        planes = score.planes(frames)
        places = at, right, down
        kernels.sample(planes, score.weights, places, self.whole[None], nothing, begin, score.buffer, out)
        return out

    @cached_property
    def _places(self) -> tuple[npt.NDArray[np.int32], Singles, Singles]:
        """Row (upper 16 bits) and column of the pixel above and left of each sample, and the offset from it."""
        rows, columns = self.score.buffer.shape
        x, y = np.clip(self.x, 0, columns - 1), np.clip(self.y, 0, rows - 1)
        left = np.minimum(np.floor(x), columns - 2).astype(np.int32)
        above = np.minimum(np.floor(y), rows - 2).astype(np.int32)
        return above << 16 | left, x - left.astype(np.float32), y - above.astype(np.float32)


def _reach(place: Singles, width: int, size: int) -> npt.NDArray[np.int32]:
    """Return the first px and the last px + 1 of windows of `width` columns for each first column, (n, 2)."""
    first = sliding_window_view(place.min(axis=0), width).min(axis=1)
    last = sliding_window_view(place.max(axis=0), width).max(axis=1)
    begin = np.clip(np.floor(first), 0, size - 2)
    end = np.clip(np.ceil(last) + 1, begin + 2, size)
    return np.column_stack([begin, end]).astype(np.int32)


@dataclass(frozen=True)
class Windows:
    """Some windows of a batch, transformed as (light * window - offset) * scale without a copy."""

    scores: Singles  # shape (frames, rows, columns); all windows
    which: Integers  # shape (n,); indices of the windows that are used
    light: Floats  # shape (n, columns); factor on each column
    # shape (n,); subtracted offset, and the factor on the difference
    offset: Floats
    scale: Floats

    @staticmethod
    def plain(scores: npt.NDArray[np.floating]) -> Windows:
        """Return all windows without a transformation."""
        count, _, columns = scores.shape
        nothing, one = np.zeros(count), np.ones(count)
        lit = np.ones((count, columns))
        return Windows(np.ascontiguousarray(scores, dtype=np.float32), np.arange(count), lit, nothing, one)

    def bands(self, mixing: Floats, *, across: bool = False) -> Floats:
        """Return averages over rows, with weights (bands, rows) of sum 1: (n, bands, columns).

        `across`: averages over columns, with weights (bands, columns): (n, bands, rows).
        """
        weights = mixing.astype(np.float32)
        given = self.scores, self.which, self.light, self.offset, self.scale, weights
        return kernels.bands(*given, across=across)
