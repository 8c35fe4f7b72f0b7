"""The window in which a marker is expected, unrolled frame by frame."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from gyrotrack._native import _kernels as kernels
from gyrotrack.tracking._acquisition import LONGEST_DWELL
from gyrotrack.tracking._polar import Grid, Ring, Score, Windows, ring_for
from gyrotrack.tracking._scene import Marker, Samples
from gyrotrack.video._container import Frame

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]

CHROMA_PIXEL, LUMA_PIXEL = 2.0, 1.5
"""Spacing of the samples [luma px]."""


def common_columns(markers: tuple[Marker, ...], centre: tuple[float, float]) -> int:
    """Return the number of columns in a full turn for all markers of a body."""
    radius = max(marker.outer for marker in markers)
    return ring_for(centre, 0.7 * radius, radius, CHROMA_PIXEL).columns


class MarkerStrip:
    """Windows about one marker, collected for a batch of frames, as scores: 0 on the background, 1 on the marker.

    A score is linear in the planes of the film. It is computed and unrolled only for the pixels of the windows.

    Parameters
    ----------
    marker : Marker
        The marker.
    samples : Samples
        Frames of which the background is the median, at every pixel, or along each row if the marker hardly moves.
    centre : tuple of float
        Centre of the ring in px.
    keep_out : float
        Smallest radius [px] of the windows (the disc at the centre).
    columns : int
        Samples in a full turn.
    margin : float
        Largest distance of a marker from its expected angle [rad].
    capacity : int
        Frames of a batch.
    """

    def __init__(
        self,
        marker: Marker,
        samples: Samples,
        centre: tuple[float, float],
        keep_out: float,
        columns: int,
        margin: float,
        capacity: int,
    ) -> None:
        self.marker = marker
        self.white = marker.colour == "white"
        edge = max(6.0, 0.3 * (marker.outer - marker.inner))
        pixel = LUMA_PIXEL if self.white else CHROMA_PIXEL
        grid = ring_for(centre, max(marker.inner - edge, keep_out, 2.0), marker.outer + edge, pixel)
        ring = Ring(centre, grid.inner, grid.outer, grid.rows, columns)
        self.slack = int(np.ceil(margin / ring.step)) + 1
        # Motion blur of the width of the marker gives a triangle, whose base is twice its width at half maximum.
        foot = float(np.clip(marker.foot, 1.1 * marker.half_width, 2.0 * marker.half_width))
        self.half = int(np.ceil((foot + max(0.06, 4.0 * ring.step)) / ring.step)) + self.slack
        self.half = min(self.half, (columns - 1) // 2)
        self.width = 2 * self.half + 1
        self.windows = np.zeros((capacity, ring.rows, self.width), dtype=np.float32)
        self.starts = np.zeros(capacity, dtype=np.int64)
        a, b = marker.contrast
        weights = (1.0 / a, 0.0) if self.white else (a / (a * a + b * b), b / (a * a + b * b))
        shape = samples.frames[0].y.shape if self.white else samples.frames[0].u.shape
        self._score = Score(self.white, weights, shape)
        self._rows = self._rows_on(ring)
        self.ring = ring
        self._grid = Grid(ring, self.width, self._score)
        ground = self._under = self._background(samples)
        self._mixing = np.zeros(ring.rows, dtype=np.float32)
        self._mixing[self._every_second] = 1.0 / len(self._mixing[self._every_second])
        self._ground_mean = ground[self._every_second].mean(axis=0)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "windows": self.windows.shape}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.windows = np.zeros(state["windows"], dtype=np.float32)

    def centre_on(self, centre: tuple[float, float]) -> None:
        """Move the ring to another centre."""
        self.ring = self.ring.moved(centre)

    @property
    def ground(self) -> Floats:
        """Mean of the subtracted background over the rows of the marker, (columns,)."""
        return np.asarray(self._ground_mean[: self.ring.columns], dtype=np.float64)

    @property
    def grid(self) -> Grid:
        """Positions of the samples of the ring in the planes."""
        if self._grid.ring is not self.ring:
            self._grid = Grid(self.ring, self.width, self._score)
        return self._grid

    @property
    def rows(self) -> slice:
        """Rows well inside the marker, away from its near and far edge."""
        return slice(*self._rows)

    @property
    def _every_second(self) -> slice:
        """Every second row of the marker, for its detection."""
        return slice(*self._rows, 2)

    def _rows_on(self, ring: Ring) -> tuple[int, int]:
        edge = min(2.0, 0.15 * (self.marker.outer - self.marker.inner))
        radii = ring.radii
        inside = np.flatnonzero((radii >= self.marker.inner + edge) & (radii <= self.marker.outer - edge))
        if not len(inside):
            inside = np.array([int(np.argmin(np.abs(radii - self.marker.radius)))])
        return int(inside[0]), int(inside[-1]) + 1

    def take(self, frames: list[Frame], place: int, angles: Floats) -> None:
        """Unroll frames about their angles (n,) [rad, as seen] into the buffer, from `place` of the batch on."""
        grid = self.grid
        start = np.rint(angles / grid.ring.step).astype(np.int64)
        here = slice(place, place + len(frames))
        self.starts[here] = start
        first = (start - self.half) % grid.ring.columns
        grid.cut(frames, first, self._under, self.windows[here])

    def whole(self, frames: list[Frame]) -> Singles:
        """Return the mean score over the rows of the marker at all angles, (n, columns)."""
        seen = self.grid.turns(frames, self._every_second).mean(axis=1) - self._ground_mean
        return np.asarray(seen[:, : self.ring.columns])

    def locate(self, angle: Floats, place: slice) -> tuple[Floats, Floats]:
        """Return the displacement of the marker from given angles (n,) [rad] in frames of the batch, in columns.

        It is searched within the margin. The second array is the mean score at the maximum, 0 if that is at the limit.
        """
        half, reach = max(int(self.marker.half_width / self.ring.step), 1), self.slack
        column = angle / self.ring.step - self.starts[place] + (self.half - half - reach)
        found = kernels.locate(self.windows[place], column, (*self._rows, 2), half, reach)
        return found[:, 0], found[:, 1]

    def _background(self, samples: Samples) -> Singles:
        frames = samples.frames if self.white else [samples.frames[k] for k in samples.spread]
        seen = np.stack([self.grid.around(frame, slice(None)) for frame in frames], axis=-1)
        ranks = (len(frames) - 1) // 2, len(frames) // 2
        seen.partition(ranks, axis=-1)
        ground = 0.5 * (seen[..., ranks[0]] + seen[..., ranks[1]])
        if self.marker.dwell > LONGEST_DWELL:
            ground[:] = np.median(ground, axis=1, keepdims=True)
        return ground


LAYERS = 3
"""Parts of the radius for which the occlusion is measured separately."""


class MarkerWindow:
    """Scores and profiles in the windows of one marker.

    Attributes
    ----------
    known : ndarray of bool, shape (n,)
        Frames in which the body is tracked.
    start, fraction : ndarray, shape (n,)
        Column in the middle of the window, and the expected displacement of the marker from it in columns.
    first : ndarray of int, shape (n,)
        First column of the window, within the full turn.
    scores : ndarray, shape (n, rows, m)
        Scores.
    raw, profile : ndarray, shape (n, m)
        Mean over the rows of the marker, without and with correction of the illumination.
    layers : ndarray, shape (n, layers, m)
        The same for parts of the radius, without the correction.
    """

    def __init__(self, strip: MarkerStrip, coarse: Floats) -> None:
        count = len(coarse)
        self.known = np.isfinite(coarse)
        self.radius = strip.marker.radius
        self.start = strip.starts[:count].copy()
        self.fraction = np.where(self.known, coarse / strip.ring.step - self.start, 0.0)
        self.first = (self.start - strip.half) % strip.ring.columns
        self.scores = strip.windows[:count]
        rows = np.arange(strip.rows.start, strip.rows.stop)
        parts = np.array_split(rows, min(LAYERS, len(rows)))
        self._sizes = np.array([len(part) for part in parts]) / len(rows)
        mixing = np.zeros((len(parts), self.scores.shape[1]))
        for line, part in zip(mixing, parts, strict=True):
            line[part] = 1.0 / len(part)
        self.layers = Windows.plain(self.scores).rows(mixing)
        self.raw: Floats = np.einsum("l,nlm->nm", self._sizes, self.layers)
        self.profile = self.raw
        self._light: Floats | None = None

    def column(self, columns: int) -> Integers:
        """Return the columns of the ring in the windows, (n, m)."""
        return np.asarray(self.here(np.arange(columns)))

    def apply_light(self, light: Floats) -> None:
        """Divide the profiles by the relative brightness of every column of the ring."""
        here: Floats = self.here(1.0 / light).astype(np.float64)
        self._light, self.profile = here, self.raw * here

    def here(self, around: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        """Return values per column of the ring for the samples of the windows, (n, m)."""
        m = self.raw.shape[1]
        return sliding_window_view(np.concatenate([around, around[:m]]), m)[self.first]

    def along(self, weight: Floats) -> Floats:
        """Return the mean over the columns with weights (n, m) of sum 1, corrected for illumination: (n, rows)."""
        lit = weight if self._light is None else weight * self._light
        plain = Windows.plain(self.scores)
        return replace(plain, light=lit).columns(np.ones((1, weight.shape[1])))[:, 0]

    def shaped(self, use: npt.NDArray[np.bool_], gain: Floats, offset: Floats) -> Windows:
        """Return the windows of some frames, corrected for illumination, background at 0 and marker at 1."""
        light = np.ones((len(gain), self.scores.shape[2])) if self._light is None else self._light[use]
        return Windows(self.scores, np.flatnonzero(use), light, offset, 1.0 / gain)
