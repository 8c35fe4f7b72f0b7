"""Uneven illumination and occlusion of a marker as functions of the angle.

Both are learnt from the marker itself. When a marker with profile a T(x) passes an angle, its measured height relative
to the expected one, h = sum(a T p) / sum((a T)^2) over all passages, gives the illumination (angles fixed in the
picture) or shows an occlusion (angles fixed on the other body).
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
        Background that was subtracted, in heights of the marker. A marker does not show the lamps that are reflected
        in the metal beneath it: its own brightness varies little and is averaged, its height above the background
        varies.
    """

    def __init__(self, layers: int, columns: int, ground: Floats | None = None) -> None:
        self.columns = columns
        self._ground = np.zeros(columns) if ground is None else ground
        self._top = np.zeros((layers, columns))
        self._bottom = np.zeros((layers, columns))

    def learn(self, layer: int, column: Integers, expected: Floats, value: Floats) -> None:
        """Add passages: arrays of column, expected height (0: do not use), measured height above the background."""
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
        """Return the heights relative to their 60 % quantile (layers, columns); NaN without passages.

        Parameters
        ----------
        blur : int
            Half width of the moving average in columns.
        prior : float
            Weight of a prior height of 1, in full passages of a column.
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
"""Relative heights below which a marker counts as occluded, and above which as free of shadows."""
WIDEST_EDGE = 8
"""Largest width of the blurred edge or the shadow of an occluding object, in columns."""


def even_light(light: AngleMap, reach: int) -> Floats:
    """Return the relative illumination of each column, between 0.55 and 2; 1 where it is unknown.

    Parameters
    ----------
    reach : int
        Half the width of a marker in columns, or half the distance between the angles at which it is seen, if that is
        larger. This is the resolution: if a marker is seen at the same few angles in every turn, or moves slowly about
        them, an error of its displacement is indistinguishable from a gradient of the illumination.
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
"""Frames from which the gaps between random angles are not wider than a marker."""


def places_apart(column: Integers, columns: int) -> int:
    """Return the distance in columns between the angles of a marker that is seen at the same few angles.

    This is the second largest gap, as the largest may be the range that a slow body does not reach; 0 for few frames,
    whose gaps are random.
    """
    if len(column) < FEWEST_PLACES:
        return 0
    here = np.unique(column % columns)
    gaps = np.sort(np.diff(np.append(here, here[0] + columns)))
    return int(gaps[-2]) if len(gaps) > 1 else 0


def shaded_columns(light: AngleMap) -> npt.NDArray[np.bool_]:
    """Return at which angles an object at rest occludes the marker, or glare exceeds it."""
    height = light.heights(max(light.columns // 128, 1), prior=4.0)[0]
    return np.asarray(np.nan_to_num(height, nan=1.0) < HIDDEN)


def open_columns(cover: AngleMap, *, shadows: bool) -> npt.NDArray[np.bool_]:
    """Return at which angles the marker is unoccluded in all layers; unknown angles count as open.

    Occluded regions are dilated by one column because of their blurred edges. With `shadows` they are extended over
    adjacent columns with a height below `CLEAR`.
    """
    height = np.nan_to_num(cover.heights(1), nan=1.0)
    hidden, dim = (np.asarray((height < limit).any(axis=0)) for limit in (HIDDEN, CLEAR))
    for _ in range(WIDEST_EDGE if shadows else 0):
        hidden |= _grown(hidden) & dim
    return np.asarray(~_grown(hidden))


def _grown(chosen: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    return np.asarray(chosen | np.roll(chosen, 1) | np.roll(chosen, -1))


def _upper_middle(values: Floats) -> float:
    """Return the 60 % quantile."""
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
    """Map of the occlusion of a body by the other one, learnt from the passages of its markers.

    Parameters
    ----------
    step : float
        Angle in rad from one column of the rings to the next.
    offset : tuple of float
        Centre of the rings relative to the axis of the other body, (x, y) in px, y downwards.
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

    def open(self, window: MarkerWindow, casing: Floats | None, *, shadows: bool = False) -> Mask:
        """Return which samples of the windows are unoccluded, (n, m); all where the other body is unknown.

        With `shadows`, samples in the shadow of the occluding object are excluded, too.
        """
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
