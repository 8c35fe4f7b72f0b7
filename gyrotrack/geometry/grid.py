"""A ring laid over the planes of a film, and the windows that are cut out of it."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from gyrotrack.compiled import loops
from gyrotrack.segmentation.ring import Ring
from gyrotrack.video.planes import Frame

Singles = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]
Box = npt.NDArray[np.int32]
"""Left, right, top and bottom edge in px of a plane; right and bottom are one beyond."""


class Score:
    """The weighted sum of planes in which a paper stands out; one buffer of the size of a plane.

    Parameters
    ----------
    white : bool
        Of luma, otherwise of both chroma planes.
    weights : tuple of float
        Of the planes; of luma only the first counts.
    shape : tuple of int
        Rows and columns of a plane.
    """

    def __init__(self, white: bool, weights: tuple[float, float], shape: tuple[int, ...]) -> None:  # noqa: FBT001
        self.white = white
        self.weights = weights
        self.buffer = np.zeros(shape, dtype=np.float32)

    def planes(self, frames: list[Frame]) -> tuple[list[npt.NDArray[np.uint8]], ...]:
        """Return the planes that enter, one list for each weight."""
        if self.white:
            return ([frame.y for frame in frames],)
        return ([frame.u for frame in frames], [frame.v for frame in frames])

    def unrolled(self, frame: Frame, box: Box, x: Singles, y: Singles, out: Singles | None = None) -> Singles:
        """Sample the score of a frame at places in a box; elsewhere the buffer keeps what it held."""
        left, right, top, bottom = box.tolist()
        part = (slice(top, bottom), slice(left, right))
        a, b = self.weights
        if self.white:
            np.copyto(self.buffer[part], frame.y[part])  # what is sampled of it is scaled
        else:
            cv2.addWeighted(frame.u[part], a, frame.v[part], b, 0.0, dst=self.buffer[part], dtype=cv2.CV_32F)
        seen = cv2.remap(self.buffer, x, y, cv2.INTER_LINEAR, dst=out, borderMode=cv2.BORDER_REPLICATE)
        found: Singles = np.asarray(seen, dtype=np.float32)
        if self.white:
            found *= np.float32(a)
        return found


class Grid:
    """Where the samples of a ring lie in a plane, and which box of the plane each window touches.

    Parameters
    ----------
    ring : Ring
        The samples.
    width : int
        Columns of a window; the grid goes on beyond the full turn by so many.
    score : Score
        What is sampled.
    """

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
        """Sample windows from the columns `first` (n,) on, one a frame, less the background: (n, rows, width)."""
        if loops is not None:
            score = self.score
            planes = score.planes(frames)
            loops.cut(planes, score.weights, *self._places, self.boxes, ground, first, score.buffer, windows)
            return
        for frame, k, window in zip(frames, first.tolist(), windows, strict=True):
            part = (slice(None), slice(k, k + self.width))
            self.score.unrolled(frame, self.boxes[k], self.x[part], self.y[part], window)
            window -= ground[part]

    def around(self, frame: Frame, rows: slice) -> Singles:
        """Sample rows in all directions."""
        return self.score.unrolled(frame, self.whole, self.x[rows], self.y[rows])

    def turns(self, frames: list[Frame], rows: slice) -> Singles:
        """Sample rows in all directions in some frames, (n, rows, columns)."""
        if loops is None:
            return np.stack([self.around(frame, rows) for frame in frames])
        score, places = self.score, tuple(np.ascontiguousarray(place[rows]) for place in self._places)
        out = np.empty((len(frames), *places[0].shape), dtype=np.float32)
        nothing, begin = np.zeros_like(places[1]), np.zeros(len(frames), dtype=np.int64)
        planes = score.planes(frames)
        loops.cut(planes, score.weights, *places, self.whole[None], nothing, begin, score.buffer, out)
        return out

    @cached_property
    def _places(self) -> tuple[npt.NDArray[np.int32], Singles, Singles]:
        """Row (upper 16 bits) and column of the pixel left above each sample, and how far right and below it lies."""
        rows, columns = self.score.buffer.shape
        x, y = np.clip(self.x, 0, columns - 1), np.clip(self.y, 0, rows - 1)
        left = np.minimum(np.floor(x), columns - 2).astype(np.int32)
        above = np.minimum(np.floor(y), rows - 2).astype(np.int32)
        return above << 16 | left, x - left.astype(np.float32), y - above.astype(np.float32)


def _reach(place: Singles, width: int, size: int) -> npt.NDArray[np.int32]:
    """Return first and last-plus-one px that windows of `width` columns touch, for each first column, (n, 2)."""
    first = sliding_window_view(place.min(axis=0), width).min(axis=1)
    last = sliding_window_view(place.max(axis=0), width).max(axis=1)
    begin = np.clip(np.floor(first), 0, size - 2)
    end = np.clip(np.ceil(last) + 1, begin + 2, size)
    return np.column_stack([begin, end]).astype(np.int32)
