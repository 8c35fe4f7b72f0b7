"""One marker cut out of unrolled rings and brought to the middle: how far it extends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.segmentation.ring import Ring

Floats = npt.NDArray[np.float64]
Strips = npt.NDArray[np.float32]

REACH = 1.2
"""Angle in rad to each side of a marker that is cut out."""


@dataclass(frozen=True)
class Extent:
    """Where a patch stands above half of its height.

    Attributes
    ----------
    rows : ndarray of bool
        Rows of the ring on the marker.
    inner, outer : float
        The radii between which it lies, in px.
    half_width : float
        Half its width in rad.
    lean : int
        Columns by which its middle lies beside the middle of the patch.
    foot : float
        Angle in rad from its middle to where it has fallen to a tenth of its height.
    """

    rows: npt.NDArray[np.bool_]
    inner: float
    outer: float
    half_width: float
    lean: int
    foot: float = 0.0

    def core(self, columns: int, step: float) -> npt.NDArray[np.bool_]:
        """Return the pixels of a patch that lie well on the marker, (rows, columns)."""
        x = (np.arange(columns) - columns // 2 - self.lean) * step
        return np.asarray(self.rows[:, None] & (np.abs(x) < 0.6 * self.half_width)[None, :])


def aligned(score: Strips, column: npt.NDArray[np.int64], use: npt.NDArray[np.bool_]) -> Floats:
    """Average the strips with the marker brought to the middle, `REACH` to each side: (rows, columns)."""
    columns = score.shape[2]
    reach = int(REACH / (2.0 * np.pi) * columns)
    index = (column[use][:, None] + np.arange(-reach, reach + 1)) % columns
    patch = np.take_along_axis(score[use], index[:, None, :], axis=2)
    return np.asarray(patch.mean(axis=0), dtype=np.float64)


def extent_of(patch: Floats, ring: Ring) -> Extent | None:
    """Measure where a patch stands above half of its height; None where nothing stands out."""
    middle = patch.shape[1] // 2
    near = max(int(0.05 / ring.step), 1)
    along = patch[:, middle - near : middle + near + 1].mean(axis=1)
    if along.max() <= 0.0:
        return None
    first, last = half_maximum(along, int(np.argmax(along)))
    rows = np.zeros(ring.rows, dtype=np.bool_)
    rows[int(np.ceil(first)) : int(np.floor(last)) + 1] = True
    if not rows.any():
        rows[int(np.argmax(along))] = True
    across = patch[rows].mean(axis=0)
    across = across - min(float(np.median(across)), 0.3 * float(across.max()))
    left, right = half_maximum(across, middle)
    low, high = half_maximum(across, middle, 0.1)
    spacing = (ring.outer - ring.inner) / (ring.rows - 1)
    half_width = max(0.5 * (right - left), 0.5) * ring.step
    lean = round(0.5 * (left + right)) - middle
    foot = 0.5 * (high - low) * ring.step
    return Extent(rows, ring.inner + first * spacing, ring.inner + last * spacing, half_width, lean, foot)


def half_maximum(curve: Floats, start: int, part: float = 0.5) -> tuple[float, float]:
    """Return where a curve falls to half (or another part) of its height near `start`, on both sides of it."""
    half = part * float(curve[max(start - 1, 0) : start + 2].max())
    return start - _fall(curve[start::-1], half), start + _fall(curve[start:], half)


def _fall(curve: Floats, level: float) -> float:
    """Return where a curve first falls to a level, at its end if it never does."""
    below = np.flatnonzero(curve[1:] <= level)
    if not len(below):
        return float(len(curve) - 1)
    k = int(below[0])
    return k + float(np.clip((curve[k] - level) / max(float(curve[k] - curve[k + 1]), 1e-9), 0.0, 1.0))
