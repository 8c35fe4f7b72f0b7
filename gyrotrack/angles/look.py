"""The windows about one marker in a batch of frames, raw and under even light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from gyrotrack.geometry.bands import Windows
from gyrotrack.geometry.strip import Strip

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

LAYERS = 3
"""Parts of the radius in which a marker can be hidden by itself."""


class Look:
    """What the windows of one marker show.

    Attributes
    ----------
    known : ndarray of bool, shape (n,)
        Frames in which the body was followed.
    start, fraction : ndarray, shape (n,)
        Column in the middle of the window, and by how many columns beside it the marker is expected.
    first : ndarray of int, shape (n,)
        First column of the window, within the full turn.
    window : ndarray, shape (n, rows, m)
        Scores.
    raw, profile : ndarray, shape (n, m)
        Mean over the rows of the paper, as seen and under even light.
    layers : ndarray, shape (n, layers, m)
        The same for parts of the radius, as seen.
    """

    def __init__(self, strip: Strip, coarse: Floats) -> None:
        count = len(coarse)
        self.known = np.isfinite(coarse)
        self.start = strip.starts[:count].copy()
        self.fraction = np.where(self.known, coarse / strip.ring.step - self.start, 0.0)
        self.first = (self.start - strip.half) % strip.ring.columns
        self.window = strip.windows[:count]
        rows = np.arange(strip.rows.start, strip.rows.stop)
        parts = np.array_split(rows, min(LAYERS, len(rows)))
        self._sizes = np.array([len(part) for part in parts]) / len(rows)
        mixing = np.zeros((len(parts), self.window.shape[1]))
        for line, part in zip(mixing, parts, strict=True):
            line[part] = 1.0 / len(part)
        self.layers = Windows.plain(self.window).rows(mixing)
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
        """Return what is known of every column of the ring for the samples of the windows, (n, m)."""
        m = self.raw.shape[1]
        return sliding_window_view(np.concatenate([around, around[:m]]), m)[self.first]

    def along(self, weight: Floats) -> Floats:
        """Return the mean over the columns with weights (n, m), of sum 1, under even light: (n, rows)."""
        lit = weight if self._light is None else weight * self._light
        plain = Windows.plain(self.window)
        return replace(plain, light=lit).columns(np.ones((1, weight.shape[1])))[:, 0]

    def shaped(self, use: npt.NDArray[np.bool_], gain: Floats, offset: Floats) -> Windows:
        """Return the windows of some frames under even light, background at 0 and marker at 1."""
        light = np.ones((len(gain), self.window.shape[2])) if self._light is None else self._light[use]
        return Windows(self.window, np.flatnonzero(use), light, offset, 1.0 / gain)
