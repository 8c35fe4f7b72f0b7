"""Uneven illumination and occlusion of a marker at each angle.

Both are learnt from the marker itself. When a marker with profile a T(x) passes an angle, the height that is
seen there, relative to the expected one, gives the brightness of the light (angles fixed in the picture) or
whether something stands before it (angles fixed on the other body): h = sum(a T p) / sum((a T)^2) over all
passages.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.tracking._marker_window import LAYERS, MarkerWindow

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


class AngleMap:
    """Mean relative height of a marker at each angle, learnt from its passages.

    Parameters
    ----------
    layers, columns : int
        Rows of the map (parts of the radius) and angles in a full turn.
    ground : ndarray, shape (columns,), optional
        What was taken off as background, in heights of the marker. A marker has light of its own, and does not show
        the lamps that mirror in the metal beneath it: what it has above nothing is even, and is averaged; its
        height, what it has above the background, is not.
    """

    def __init__(self, layers: int, columns: int, ground: Floats | None = None) -> None:
        self.columns = columns
        self._ground = np.zeros(columns) if ground is None else ground
        self._top = np.zeros((layers, columns))
        self._bottom = np.zeros((layers, columns))

    def learn(self, layer: int, column: Integers, expected: Floats, value: Floats) -> None:
        """Add passages: arrays of column, height expected (0: do not use), height seen above the background."""
        use = expected > 0.0
        column, expected, value = column[use], expected[use], value[use]
        weighted = expected * (value + expected * self._ground[column])
        self._top[layer] += np.bincount(column, weighted, self.columns)
        self._bottom[layer] += np.bincount(column, expected * expected, self.columns)

    def add(self, other: AngleMap) -> None:
        """Add the passages of another map of the same marker."""
        self._top += other._top
        self._bottom += other._bottom

    def heights(self, blur: int, prior: float = 0.0) -> Floats:
        """Return the heights relative to their upper middle (layers, columns); NaN where nothing has passed.

        Parameters
        ----------
        blur : int
            Half width in columns of the mean that is taken.
        prior : float
            Weight, in full passages of a column, with which a height of 1 is mixed in.
        """
        top, bottom = (_blurred(part, blur) for part in (self._top, self._bottom))
        known = bottom > 0.5
        height = np.where(known, top / np.where(known, bottom, 1.0) - self._ground, np.nan)
        for row, weight, seen in zip(height, bottom, known, strict=True):
            if seen.any():
                row /= max(_upper_middle(row[seen]), 1e-3)
                row[:] = (row * weight + prior) / (weight + prior)
        return height


HIDDEN, CLEAR = 0.55, 0.95
"""Relative heights below which a marker counts as hidden, and above which as clear of what hides it."""
WIDEST_EDGE = 8
"""Columns over which the edge of what hides a marker may be blurred by its motion, or cast a shadow."""


def even_light(light: AngleMap, reach: int) -> Floats:
    """Return the relative brightness at each column, 1 where nothing is known; between 0.55 and 2.

    Parameters
    ----------
    reach : int
        Half the width of a marker in columns, or half the way between places where it is seen, if that is more. Light
        is not resolved more finely: where a marker comes back to the same few places turn after turn, or creeps about
        them, an error of its displacement looks like a slope of the light under it, and would confirm itself.
    """
    columns = light.columns
    height = light.heights(max(reach, 1), prior=4.0)[0]
    known = np.isfinite(height)
    if not known.any():
        return np.ones(columns)
    place = np.arange(columns)
    filled = np.interp(place, place[known], height[known], period=columns)
    return np.asarray(np.clip(filled, HIDDEN, 2.0))


FEWEST_PLACES = 64
"""Frames from which on the gaps between places seen at random are no wider than a marker."""


def places_apart(column: Integers, columns: int) -> int:
    """Return how far apart, in columns, a marker was seen that comes back to the same few places.

    The widest gap but one, as the widest may be what a slow body does not reach; 0 for few frames, whose gaps are
    chance.
    """
    if len(column) < FEWEST_PLACES:
        return 0
    here = np.unique(column % columns)
    gaps = np.sort(np.diff(np.append(here, here[0] + columns)))
    return int(gaps[-2]) if len(gaps) > 1 else 0


def shaded_columns(light: AngleMap) -> npt.NDArray[np.bool_]:
    """Return at which angles something that stands still hides the marker, or outshines it."""
    height = light.heights(max(light.columns // 128, 1), prior=4.0)[0]
    return np.asarray(np.nan_to_num(height, nan=1.0) < HIDDEN)


def open_columns(cover: AngleMap, *, shadows: bool) -> npt.NDArray[np.bool_]:
    """Return at which angles nothing stands before the marker, in any layer; unknown angles count as open.

    What is hidden is grown by a column, because an edge is never sharp; for a marker that `shadows` pull, as far as
    the adjacent height still rises.
    """
    height = np.nan_to_num(cover.heights(1), nan=1.0)
    hidden, dim = (np.asarray((height < limit).any(axis=0)) for limit in (HIDDEN, CLEAR))
    for _ in range(WIDEST_EDGE if shadows else 0):
        hidden |= _grown(hidden) & dim
    return np.asarray(~_grown(hidden))


def _grown(chosen: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    return np.asarray(chosen | np.roll(chosen, 1) | np.roll(chosen, -1))


def _upper_middle(values: Floats) -> float:
    """Return the value that 60 % of the values do not exceed."""
    ordered = np.sort(values)
    place = 0.6 * (len(ordered) - 1)
    k = int(place)
    return float(ordered[k] + (place - k) * (ordered[min(k + 1, len(ordered) - 1)] - ordered[k]))


def _blurred(rows: Floats, half: int) -> Floats:
    if half < 1:
        return rows
    padded = np.concatenate([np.zeros((len(rows), 1)), rows[:, -half:], rows, rows[:, :half]], axis=1)
    total = np.cumsum(padded, axis=1)
    return np.asarray(total[:, 2 * half + 1 :] - total[:, : -(2 * half + 1)])


Mask = npt.NDArray[np.bool_]

_COLUMNS = 360
_SCALE = _COLUMNS / (2.0 * np.pi)


class Occlusion:
    """The map of what lies over a body, learnt from the passages of its markers.

    Parameters
    ----------
    step : float
        Angle in rad from one column of the rings to the next.
    offset : tuple of float
        Centre of the rings relative to the other body's axis, (x, y) in px, y downwards: what hides the markers turns
        about that axis.
    """

    def __init__(self, step: float, offset: tuple[float, float] = (0.0, 0.0)) -> None:
        self._step, self._offset = step, offset
        self.map = AngleMap(LAYERS, _COLUMNS)

    def learn(self, window: MarkerWindow, expected: Floats, casing: Floats) -> None:
        """Add what the windows of a marker show; `expected` is its profile in them (n, m), `casing` (n,) in rad."""
        known = (window.known & np.isfinite(casing))[:, None]
        core = np.where(known & (expected > 0.7), expected, 0.0)
        column = self._relative(window, casing)
        for layer in range(window.layers.shape[1]):
            self.map.learn(layer, column, core, np.clip(window.layers[:, layer], -0.2, 1.5))

    def open(self, window: MarkerWindow, casing: Floats | None, *, shadows: bool = False) -> Mask:
        """Return which samples of the windows nothing hides, (n, m); all, where the other body is unknown.

        With `shadows`, only those are open that also lie beyond the soft edge of what hides.
        """
        everything = np.ones(window.raw.shape, dtype=np.bool_)
        if casing is None:
            return everything
        known = np.isfinite(casing)[:, None]
        open_ = open_columns(self.map, shadows=shadows)
        return np.where(known, open_[self._relative(window, casing)], everything)

    def _relative(self, window: MarkerWindow, casing: Floats) -> Integers:
        """Columns of the map for the samples of the windows."""
        angle = window.first[:, None] * self._step + np.arange(window.raw.shape[1]) * self._step
        x, y = self._offset
        if x or y:
            right, up = window.radius * np.cos(angle) + x, window.radius * np.sin(angle) - y
            angle = np.arctan2(up, right)
        column = (angle - np.nan_to_num(casing)[:, None]) * _SCALE
        return np.rint(column).astype(np.int64) % _COLUMNS
