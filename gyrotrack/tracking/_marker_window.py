"""The window in which a marker is expected, and uneven illumination and occlusion as functions of the angle.

Illumination and occlusion are learnt from the marker itself. When a marker with the expected profile a T(x) and the
measured profile p passes an angle, the measured height divided by the expected height is h = sum(a T p) / sum((a T)^2),
summed over all passages. As a function of the angle in the picture, h is the illumination. As a function of the angle
relative to the other body, h shows an occlusion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from gyrotrack._arrays import Bools, Floats, Integers, Singles
from gyrotrack._column_store import WithBuffer
from gyrotrack._native import _kernels as kernels
from gyrotrack.tracking._acquisition import LONGEST_DWELL
from gyrotrack.tracking._polar import Grid, Ring, Score, Windows, cyclic_sum, ring_for
from gyrotrack.tracking._scene import Marker, Samples, in_turn
from gyrotrack.video._container import Frame

CHROMA_PIXEL = 2.0
"""Spacing of the samples of a coloured marker in the luma [px]. Derived: one sample of chroma in 4:2:0 is 2 px of
luma."""
LUMA_PIXEL = 1.5
"""Spacing of the samples of a white marker [px]. Chosen: a smaller value costs time, a larger one loses detail."""


def common_columns(markers: tuple[Marker, ...], centre: tuple[float, float]) -> int:
    """Return the number of columns in a full turn for all markers of a body."""
    radius = max(marker.outer for marker in markers)
    return ring_for(centre, 0.7 * radius, radius, CHROMA_PIXEL).columns


class MarkerStrip(WithBuffer):
    """Windows about one marker, collected for a batch of frames, as scores: 0 on the background, 1 on the marker.

    A score is linear in the planes of the film; it is computed and unrolled only for the pixels of the windows. The
    background is the median of the samples at every pixel, or the median along each row if the marker hardly moves.
    `keep_out` is the smallest radius, at the edge of the disc [px]. `margin` is the largest distance of a marker from
    its expected angle [rad].
    """

    _buffer = "windows"

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
        """Unroll frames about their angles (n,) [rad, as seen] into the buffer, starting at index `place`."""
        grid = self.grid
        start = np.rint(angles / grid.ring.step).astype(np.int64)
        here = slice(place, place + len(frames))
        self._used = True
        self.starts[here] = start
        first = (start - self.half) % grid.ring.columns
        grid.cut(frames, first, self._under, self.windows[here])

    def whole(self, frames: list[Frame]) -> Singles:
        """Return the mean score over the rows of the marker at all angles, (n, columns)."""
        seen = self.grid.turns(frames, self._every_second).mean(axis=1) - self._ground_mean
        return np.asarray(seen[:, : self.ring.columns])

    def locate(self, angle: Floats, place: slice) -> tuple[Floats, Floats]:
        """Return the displacement of the marker from given angles (n,) [rad] in frames of the batch, in columns.

        The marker is searched for within the margin. The second array is the mean score at the maximum, or 0 if the
        maximum is at the limit.
        """
        half, reach = max(int(self.marker.half_width / self.ring.step), 1), self.slack
        column = angle / self.ring.step - self.starts[place] + (self.half - half - reach)
        found = kernels.locate(self.windows[place], column, (*self._rows, 2), half, reach)
        return found[:, 0], found[:, 1]

    def _background(self, samples: Samples) -> Singles:
        frames = samples.frames if self.white else [samples.frames[k] for k in samples.spread]
        seen = np.stack([self.grid.around(frame, slice(None)) for frame in in_turn(frames)], axis=-1)
        seen.sort(axis=-1)  # sorting is faster than a partition about two ranks
        ground = 0.5 * (seen[..., (len(frames) - 1) // 2] + seen[..., len(frames) // 2])
        if self.marker.dwell > LONGEST_DWELL:
            ground[:] = np.median(ground, axis=1, keepdims=True)
        return ground


LAYERS = 3
"""Number of parts into which a marker is divided along the radius, to measure the occlusion of each part [1]. Chosen: a
smaller number takes a partly covered marker for a dim marker, a larger one gives noisy heights."""


class MarkerWindow:
    """Scores (n, rows, m) and profiles in the windows of one marker, in n frames.

    `known` is a mask of the frames in which the body is tracked. `start` is the middle column of the window, and
    `first` is the first column of the window within the full turn. `fraction` is the expected displacement of the
    marker from the middle, in columns. `raw` and `profile` (n, m) are means over the rows of the marker, without and
    with correction of the illumination. `layers` (n, layers, m) are means over parts of the radius, without this
    correction.
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
        self.layers = Windows.plain(self.scores).bands(mixing)
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
        """Return the values at the samples of the windows, (n, m), from values per column of the ring."""
        m = self.raw.shape[1]
        return sliding_window_view(np.concatenate([around, around[:m]]), m)[self.first]

    def along(self, weight: Floats) -> Floats:
        """Return the mean over the columns with weights (n, m) of sum 1, corrected for illumination: (n, rows)."""
        lit = weight if self._light is None else weight * self._light
        plain = Windows.plain(self.scores)
        return replace(plain, light=lit).bands(np.ones((1, weight.shape[1])), across=True)[:, 0]

    def shaped(self, use: Bools, gain: Floats, offset: Floats) -> Windows:
        """Return the windows of some frames, corrected for illumination, background at 0 and marker at 1."""
        light = np.ones((len(gain), self.scores.shape[2])) if self._light is None else self._light[use]
        return Windows(self.scores, np.flatnonzero(use), light, offset, 1.0 / gain)


class AngleMap:
    """Mean relative height of a marker at each angle, for its parts along the radius (`layers`), from its passages.

    `ground` is the subtracted background, in heights of the marker. A marker covers the reflections of lamps in the
    metal beneath it. The brightness of the marker therefore varies little and is averaged, whereas its height above the
    background varies.
    """

    def __init__(self, layers: int, columns: int, ground: Floats | None = None) -> None:
        self.columns = columns
        self._ground = np.zeros(columns) if ground is None else ground
        self._top = np.zeros((layers, columns))
        self._bottom = np.zeros((layers, columns))

    def learn(self, layer: int, column: Integers, expected: Floats, value: Floats) -> None:
        """Add passages: arrays of column, expected height (0: not used), and measured height above the background."""
        use = expected > 0.0
        column, expected, value = column[use], expected[use], value[use]
        weighted = expected * (value + expected * self._ground[column])
        self._top[layer] += np.bincount(column, weighted, self.columns)
        self._bottom[layer] += np.bincount(column, expected * expected, self.columns)

    def add(self, other: AngleMap) -> None:
        """Add the passages of another map of the same marker."""
        self._top += other._top
        self._bottom += other._bottom

    def replace(self, other: AngleMap) -> None:
        """Replace the passages by the passages of another map of the same marker."""
        self._top[:], self._bottom[:] = other._top, other._bottom

    def heights(self, blur: int, prior: float = 0.0) -> Floats:
        """Return the heights relative to their 60 % quantile (layers, columns); NaN without passages.

        `blur` is the half width of the moving average. `prior` is the weight, in full passages, of an assumed height of
        1.
        """
        top, bottom = (cyclic_sum(part, blur) for part in (self._top, self._bottom))
        known = bottom > 0.5
        height = np.where(known, top / np.where(known, bottom, 1.0) - self._ground, np.nan)
        for row, weight, seen in zip(height, bottom, known, strict=True):
            if seen.any():
                row /= max(_upper_middle(row[seen]), 1e-3)
                row[:] = (row * weight + prior) / (weight + prior)
        return height


HIDDEN = 0.55
"""Smallest height of an unoccluded marker relative to the expected height, and lower limit of the illumination [1].
Chosen: a smaller value keeps half-covered markers, a larger one discards shaded markers."""
CLEAR = 0.95
"""Smallest relative height of a marker without shadow [1]. Chosen: a smaller value keeps blurred edges, a larger one
discards markers in uneven light."""
WIDEST_EDGE = 8
"""Largest width of the blurred edge or the shadow of an occluding object [columns]. Chosen: a smaller value keeps
biased angles, a larger one discards unoccluded angles."""


_SMOOTH = 0.2
"""Smallest half width of the moving mean of the illumination [turns]. Measured: in rendered films, the error with 0.05
is 12 % smaller than with 0.2 in light with strong reflections and 4 to 18 % larger in other light. At nearly seven
frames per turn, the error is 1.3 mrad with 0.05 and 0.3 mrad with 0.2."""


def even_light(light: AngleMap, reach: int) -> Floats:
    """Return the relative illumination of each column, between 0.55 and 2; 1 where it is unknown.

    `reach` is half the width of a marker in columns. The mean over a wider part of the turn is used: if a marker is
    seen at nearly the same angles in every turn, an error of its displacement is indistinguishable from a gradient of
    the illumination.
    """
    columns = light.columns
    height = light.heights(max(reach, round(_SMOOTH * columns)), prior=4.0)[0]
    known = np.isfinite(height)
    if not known.any():
        return np.ones(columns)
    place = np.arange(columns)
    filled = np.interp(place, place[known], height[known], period=columns)
    return np.asarray(np.clip(filled, HIDDEN, 2.0))


def shaded_columns(light: AngleMap) -> Bools:
    """Return a mask of the angles at which an object at rest occludes the marker, or glare outshines it."""
    height = light.heights(max(light.columns // 128, 1), prior=4.0)[0]
    return np.asarray(np.nan_to_num(height, nan=1.0) < HIDDEN)


def open_columns(cover: AngleMap, *, shadows: bool) -> Bools:
    """Return a mask of the angles at which the marker is unoccluded in all layers, or unknown.

    Occluded ranges are extended by one column; with `shadows`, also over adjacent columns with a height below `CLEAR`.
    """
    height = np.nan_to_num(cover.heights(1), nan=1.0)
    hidden, dim = (np.asarray((height < limit).any(axis=0)) for limit in (HIDDEN, CLEAR))
    for _ in range(WIDEST_EDGE if shadows else 0):
        hidden |= _grown(hidden) & dim
    return np.asarray(~_grown(hidden))


def _grown(chosen: Bools) -> Bools:
    return np.asarray(chosen | np.roll(chosen, 1) | np.roll(chosen, -1))


def _upper_middle(values: Floats) -> float:
    """Return the 60 % quantile."""
    ordered = np.sort(values)
    place = 0.6 * (len(ordered) - 1)
    k = int(place)
    return float(ordered[k] + (place - k) * (ordered[min(k + 1, len(ordered) - 1)] - ordered[k]))


_COLUMNS = 360
"""Number of columns of the map of the occlusion [columns per turn]. Chosen: one degree; with fewer, the edge of the bar
of the casing is blurred; with more, each column is seen less often."""
_SCALE = _COLUMNS / (2.0 * np.pi)
"""Number of columns of the map per angle [columns per rad]. Derived: `_COLUMNS` divided by a turn."""


class Occlusion:
    """Map of the occlusion by the other body.

    `offset` is the position of the rings' centre relative to the axis of the other body [px]; `step` is the angle
    between two columns of the rings [rad].
    """

    def __init__(self, step: float, offset: tuple[float, float] = (0.0, 0.0)) -> None:
        self._step, self._offset = step, offset
        self.map = AngleMap(LAYERS, _COLUMNS)

    def learn(self, window: MarkerWindow, expected: Floats, casing: Floats) -> None:
        """Add the windows of a marker with its expected profile (n, m) and the angles of the other body (n,) [rad]."""
        known = (window.known & np.isfinite(casing))[:, None]
        core = np.where(known & (expected > 0.7), expected, 0.0)
        column = self._relative(window, casing)
        for layer in range(window.layers.shape[1]):
            self.map.learn(layer, column, core, np.clip(window.layers[:, layer], -0.2, 1.5))

    def open(self, window: MarkerWindow, casing: Floats | None, *, shadows: bool = False) -> Bools:
        """Return a mask of the unoccluded samples (n, m) without shadow; all samples if the other body is unknown."""
        everything = np.ones(window.raw.shape, dtype=np.bool_)
        if casing is None:
            return everything
        known = np.isfinite(casing)[:, None]
        open_ = open_columns(self.map, shadows=shadows)
        return np.where(known, open_[self._relative(window, casing)], everything)

    def _relative(self, window: MarkerWindow, casing: Floats) -> Integers:
        """Return the columns of the map for the samples of the windows."""
        angle = window.first[:, None] * self._step + np.arange(window.raw.shape[1]) * self._step
        x, y = self._offset
        if x or y:
            right, up = window.radius * np.cos(angle) + x, window.radius * np.sin(angle) - y
            angle = np.arctan2(up, right)
        column = (angle - np.nan_to_num(casing)[:, None]) * _SCALE
        return np.rint(column).astype(np.int64) % _COLUMNS
