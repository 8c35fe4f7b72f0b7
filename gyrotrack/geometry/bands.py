"""Windows about a marker, averaged over bands of their rows or columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.compiled import loops

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Windows:
    """Some windows of a batch, which stand for (light * window - offset) * scale.

    The windows themselves are not changed, and none of them is formed as a whole.

    Attributes
    ----------
    scores : ndarray, shape (frames, rows, columns)
        All windows.
    which : ndarray of int, shape (n,)
        Those that are looked at.
    light : ndarray, shape (n, columns)
        Factor on each column.
    offset, scale : ndarray, shape (n,)
        What is taken off, and the factor on what is left.
    """

    scores: Singles
    which: Integers
    light: Floats
    offset: Floats
    scale: Floats

    @staticmethod
    def plain(scores: npt.NDArray[np.floating]) -> Windows:
        """Return all windows as they are."""
        count, _, columns = scores.shape
        nothing, one = np.zeros(count), np.ones(count)
        lit = np.ones((count, columns))
        return Windows(np.ascontiguousarray(scores, dtype=np.float32), np.arange(count), lit, nothing, one)

    def rows(self, mixing: Floats) -> Floats:
        """Return averages over rows, with weights (bands, rows) of sum 1: (n, bands, columns)."""
        return self._mixed(mixing, across=False)

    def columns(self, mixing: Floats) -> Floats:
        """Return averages over columns, with weights (bands, columns) of sum 1: (n, bands, rows)."""
        return self._mixed(mixing, across=True)

    def _mixed(self, mixing: Floats, *, across: bool) -> Floats:
        count, rows, columns = len(self.which), *self.scores.shape[1:]
        weights = mixing.astype(np.float32)
        if loops is not None:
            found = np.empty((count, len(weights), rows if across else columns))
            given = self.scores, self.which, self.light, self.offset, self.scale, weights
            loops.bands(*given, found, across)
            return found
        lit = self.scores[self.which] * self.light[:, None, :].astype(np.float32)
        mixed = np.matmul(lit, weights.T).transpose(0, 2, 1) if across else np.matmul(weights, lit)
        return np.asarray((mixed - self.offset[:, None, None]) * self.scale[:, None, None])
