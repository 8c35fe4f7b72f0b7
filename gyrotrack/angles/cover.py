"""What hides a body's markers: where, fixed on the other body, they are seen less than they should be."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.look import LAYERS, Look
from gyrotrack.angles.surroundings import AngleMap, open_columns

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

_COLUMNS = 360
_SCALE = _COLUMNS / (2.0 * np.pi)


class Cover:
    """The map of what lies over a body, learnt from the passages of its markers.

    Parameters
    ----------
    step : float
        Angle in rad from one column of the rings to the next.
    """

    def __init__(self, step: float) -> None:
        self._step = step
        self._map = AngleMap(LAYERS, _COLUMNS)

    def learn(self, look: Look, expected: Floats, casing: Floats) -> None:
        """Add what the windows of a marker show; `expected` is its profile in them (n, m), `casing` (n,) in rad."""
        known = (look.known & np.isfinite(casing))[:, None]
        core = np.where(known & (expected > 0.7), expected, 0.0)
        column = self._relative(look, casing)
        for layer in range(look.layers.shape[1]):
            self._map.learn(layer, column, core, np.clip(look.layers[:, layer], -0.2, 1.5))

    def open(self, look: Look, casing: Floats | None, *, shadows: bool = False) -> Mask:
        """Return which samples of the windows nothing hides, (n, m); all, where the other body is unknown.

        With `shadows`, only those are open that also lie beyond the soft edge of what hides.
        """
        everything = np.ones(look.raw.shape, dtype=np.bool_)
        if casing is None:
            return everything
        known = np.isfinite(casing)[:, None]
        open_ = open_columns(self._map, shadows=shadows)
        return np.where(known, open_[self._relative(look, casing)], everything)

    def _relative(self, look: Look, casing: Floats) -> Integers:
        """Columns of the map for the samples of the windows."""
        first = look.first * self._step * _SCALE - np.nan_to_num(casing) * _SCALE
        column = first[:, None] + np.arange(look.raw.shape[1]) * (self._step * _SCALE)
        return np.rint(column).astype(np.int64) % _COLUMNS
