"""The part of a paper's ring in which the paper is expected, unrolled frame by frame into one buffer."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from gyrotrack.geometry.coloured import LONGEST_STAY
from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Paper
from gyrotrack.segmentation.ring import Ring, ring_for
from gyrotrack.video.planes import Frame

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]
Box = tuple[int, int, int, int]
"""Left, right, top and bottom edge in px of a plane; right and bottom are one beyond."""

CHROMA_PIXEL, LUMA_PIXEL = 2.0, 1.5
"""Spacing of the samples in luma px."""


def common_columns(papers: tuple[Paper, ...], centre: tuple[float, float]) -> int:
    """Return the number of columns in a full turn that suits all papers of a body."""
    radius = max(paper.outer for paper in papers)
    return ring_for(centre, 0.7 * radius, radius, CHROMA_PIXEL).columns


class Strip:
    """Windows about one paper, collected for a batch of frames, as scores: 0 on the background, 1 on the paper.

    A score is linear in the planes of the film. It is formed on the few pixels that a window needs, and only
    these are unrolled.

    Parameters
    ----------
    paper : Paper
        What is looked at.
    samples : Samples
        Frames from which the background is taken: their median at every place, or round each ring where the paper
        hardly moved.
    centre : tuple of float
        Centre of the ring in px.
    keep_out : float
        Radius in px below which nothing is looked at (the disc at the centre).
    columns : int
        Samples in a full turn.
    margin : float
        By how much in rad a paper may lie beside where it is expected.
    capacity : int
        Frames of a batch.
    """

    def __init__(
        self,
        paper: Paper,
        samples: Samples,
        centre: tuple[float, float],
        keep_out: float,
        columns: int,
        margin: float,
        capacity: int,
    ) -> None:
        self.paper = paper
        self.white = paper.colour == "white"
        edge = max(6.0, 0.3 * (paper.outer - paper.inner))
        pixel = LUMA_PIXEL if self.white else CHROMA_PIXEL
        grid = ring_for(centre, max(paper.inner - edge, keep_out, 2.0), paper.outer + edge, pixel)
        ring = Ring(centre, grid.inner, grid.outer, grid.rows, columns)
        self.slack = int(np.ceil(margin / ring.step)) + 1
        # Paper and smear of equal width make a triangle twice as wide at its foot as at half its height.
        foot = float(np.clip(paper.foot, 1.1 * paper.half_width, 2.0 * paper.half_width))
        self.half = int(np.ceil((foot + max(0.06, 4.0 * ring.step)) / ring.step)) + self.slack
        self.half = min(self.half, (columns - 1) // 2)
        self.width = 2 * self.half + 1
        self.windows = np.zeros((capacity, ring.rows, self.width), dtype=np.float32)
        self.starts = np.zeros(capacity, dtype=np.int64)
        shape = samples.frames[0].y.shape if self.white else samples.frames[0].u.shape
        self._score = np.zeros(shape, dtype=np.float32)
        self._rows = self._rows_on(ring)
        self.ring = ring
        self._grid = _Grid(ring, self.width, self.white, self._score.shape)
        self._unit = np.float32(1.0 / paper.contrast[0] if self.white else 1.0)
        ground = self._background(samples)
        self._under = [ground[:, k : k + self.width] for k in range(columns)]
        self._mixing = np.zeros(ring.rows, dtype=np.float32)
        self._mixing[self._every_second] = 1.0 / len(self._mixing[self._every_second])
        self._ground_mean = ground[self._every_second].mean(axis=0)

    def aim(self, centre: tuple[float, float]) -> None:
        """Put the ring about another centre."""
        self.ring = self.ring.moved(centre)

    @property
    def ground(self) -> Floats:
        """Mean over the rows of the paper of what is taken off as background, (columns,)."""
        return np.asarray(self._ground_mean[: self.ring.columns], dtype=np.float64)

    @property
    def grid(self) -> _Grid:
        """Where the samples of the ring lie in the planes."""
        if self._grid.ring is not self.ring:
            self._grid = _Grid(self.ring, self.width, self.white, self._score.shape)
        return self._grid

    @property
    def rows(self) -> slice:
        """Rows that lie well on the paper, away from its near and far edge."""
        return slice(*self._rows)

    @property
    def _every_second(self) -> slice:
        """Every second row of them, enough to find the paper by."""
        return slice(*self._rows, 2)

    def _rows_on(self, ring: Ring) -> tuple[int, int]:
        edge = min(2.0, 0.15 * (self.paper.outer - self.paper.inner))
        radii = ring.radii
        inside = np.flatnonzero((radii >= self.paper.inner + edge) & (radii <= self.paper.outer - edge))
        if not len(inside):
            inside = np.array([int(np.argmin(np.abs(radii - self.paper.radius)))])
        return int(inside[0]), int(inside[-1]) + 1

    def take(self, frames: list[Frame], place: int, angles: Floats) -> None:
        """Unroll frames about their angles (n,) [rad, as seen] into the buffer, from `place` of the batch on."""
        grid = self.grid
        start = np.rint(angles / grid.ring.step).astype(np.int64)
        here = slice(place, place + len(frames))
        self.starts[here] = start
        first = ((start - self.half) % grid.ring.columns).tolist()
        scored, boxes, parts, under = self._scored, grid.boxes, grid.parts, self._under
        for frame, k, window in zip(frames, first, self.windows[here], strict=True):
            x, y = parts[k]
            score = scored(frame, boxes[k])
            cv2.remap(score, x, y, cv2.INTER_LINEAR, dst=window, borderMode=cv2.BORDER_REPLICATE)
            if self.white:
                window *= self._unit
            window -= under[k]

    def whole(self, frame: Frame) -> Singles:
        """Return the mean score over the rows of the paper in all directions, (columns,)."""
        seen = self._unrolled(frame, self._every_second)[:, : self.ring.columns].mean(axis=0)
        mean: Singles = seen - self._ground_mean[: self.ring.columns]
        return mean

    def _unrolled(self, frame: Frame, rows: slice) -> Singles:
        grid = self.grid
        score = self._scored(frame, grid.whole)
        strip = cv2.remap(
            score, grid.x[rows], grid.y[rows], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(strip * self._unit if self.white else strip, dtype=np.float32)

    def near(self, angle: Floats, place: slice, reach: int) -> Floats:
        """Return the mean score of the paper if it lay beside given angles (n,) [rad] in frames of the batch.

        The columns are displacements by -`reach` to `reach` columns: (n, 2 reach + 1).
        """
        profile = self._mixing @ self.windows[place]
        half = max(int(self.paper.half_width / self.ring.step), 1)
        total = np.zeros((len(profile), self.width + 1))
        np.cumsum(profile, axis=1, out=total[:, 1:])
        box = (total[:, 2 * half + 1 :] - total[:, : -2 * half - 1]) / (2 * half + 1)
        column = angle / self.ring.step - self.starts[place] + (self.half - half - reach)
        low = np.clip(np.floor(column).astype(np.int64), 0, box.shape[1] - 2 * reach - 2)
        part = np.clip(column - low, 0.0, 1.0)[:, None]
        cut = sliding_window_view(box, 2 * reach + 2, axis=1)[np.arange(len(angle)), low]
        found: Floats = (1.0 - part) * cut[:, :-1] + part * cut[:, 1:]
        return found

    def _scored(self, frame: Frame, edges: Box) -> Singles:
        """Form the score (of white: the luma) in a box of the picture; elsewhere the buffer keeps what it held."""
        left, right, top, bottom = edges
        box = (slice(top, bottom), slice(left, right))
        a, b = self.paper.contrast
        if self.white:
            np.copyto(self._score[box], frame.y[box])  # what is unrolled of it is scaled
        else:
            norm = a * a + b * b
            cv2.addWeighted(
                frame.u[box], a / norm, frame.v[box], b / norm, 0.0, dst=self._score[box], dtype=cv2.CV_32F
            )
        return self._score

    def _background(self, samples: Samples) -> Singles:
        frames = samples.frames[: samples.head] if self.white else samples.frames
        seen = [self._unrolled(frame, slice(None)) for frame in frames]
        ground = np.asarray(np.median(np.stack(seen), axis=0), dtype=np.float32)
        if self.paper.stay > LONGEST_STAY:
            ground[:] = np.median(ground, axis=1, keepdims=True)
        return ground


class _Grid:
    """Where the samples of a ring lie in a plane, and which box of the plane each window touches."""

    def __init__(self, ring: Ring, width: int, white: bool, shape: tuple[int, ...]) -> None:  # noqa: FBT001
        self.ring = ring
        self.x, self.y = ring.maps(chroma=not white, beyond=width)
        across, down = _reach(self.x, width, shape[1]), _reach(self.y, width, shape[0])
        self.boxes: list[Box] = [(*x, *y) for x, y in zip(across, down, strict=True)]
        self.parts = [(self.x[:, k : k + width], self.y[:, k : k + width]) for k in range(ring.columns)]
        everything = self.x.shape[1]
        self.whole: Box = (*_reach(self.x, everything, shape[1])[0], *_reach(self.y, everything, shape[0])[0])


def _reach(place: Singles, width: int, size: int) -> list[tuple[int, int]]:
    """Return first and last-plus-one px that windows of `width` columns touch, for each first column."""
    first = sliding_window_view(place.min(axis=0), width).min(axis=1)
    last = sliding_window_view(place.max(axis=0), width).max(axis=1)
    begin = np.clip(np.floor(first), 0, size - 1).astype(int)
    end = np.clip(np.ceil(last) + 1, begin + 1, size).astype(int)
    return list(zip(begin.tolist(), end.tolist(), strict=True))
