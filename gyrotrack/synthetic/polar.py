"""A body as a polar picture: rows are radii, columns are angles, so that turning it is a shift of columns.

Motion blur is then a box filter along the columns, and exact: a body that turns by the angle w during the
exposure shows at each angle the mean of its picture over w. No sub-exposure has to be drawn for it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Picture = NDArray[np.float32]
Paint = NDArray[np.uint16]

FULL = (
    40000.0  # stored value of the light 1: 16 bits are read three times as fast as floats, in steps of 3e-5
)
WIDTH_STEP = 0.25  # columns; the widths of blur are rounded to this, a tenth of a pixel


@dataclass(frozen=True)
class PolarPicture:
    """What a body shows, over its own polar coordinates, in linear light.

    Attributes
    ----------
    pixels : (rows, columns, channels) array of uint16
        Row i is the radius ``i / per_mm``, column j the angle ``2 pi j / columns``; the light 1 is stored as
        ``FULL``.
    per_mm : float
        Rows per mm.
    """

    pixels: Paint
    per_mm: float
    _blurred: dict[float, Paint] = field(default_factory=dict, init=False, repr=False, compare=False)

    @classmethod
    def of(cls, light: Array, per_mm: float) -> PolarPicture:
        """Store a picture in linear light, (rows, columns, channels)."""
        return cls(np.rint(np.clip(light * FULL, 0.0, 65535.0)).astype(np.uint16), per_mm)

    @property
    def columns(self) -> int:
        """Number of columns in a full turn."""
        return int(self.pixels.shape[1])

    @property
    def per_rad(self) -> float:
        """Columns per radian."""
        return self.columns / (2.0 * np.pi)

    def again(self) -> PolarPicture:
        """Return the same picture with a memory of its own for another width of blur."""
        return PolarPicture(self.pixels, self.per_mm)

    def channel(self, index: int) -> PolarPicture:
        """Return one channel as a picture of its own."""
        return PolarPicture(np.ascontiguousarray(self.pixels[:, :, index : index + 1]), self.per_mm)

    def blurred(self, angle: float) -> Paint:
        """Return the mean over a turn by ``angle`` rad, centred, over two turns: from -1/2 to 3/2 of a turn.

        Twice round spares every pixel the wrapping of its angle. The last result is kept: the smear of a
        slowing body changes little from frame to frame.
        """
        width = round(abs(angle) * self.per_rad / WIDTH_STEP) * WIDTH_STEP
        width = max(1.0, min(width, float(self.columns)))
        if width not in self._blurred:
            self._blurred.clear()
            once, half = _box(self.pixels, width), self.columns // 2
            self._blurred[width] = np.concatenate([once[:, half:], once, once[:, : half + 1]], axis=1)
        return self._blurred[width]

    def sample(self, columns: Picture, rows: Picture, smear: float, out: Paint | None = None) -> Paint:
        """Read the picture at fractional (column, row) positions, smeared by a turn of ``smear`` rad.

        Columns lie in [0, 2 columns], the angle 0 at ``columns / 2``. Bilinear: the picture is sampled finer
        than the camera's pixels.
        """
        paint = self.blurred(smear)
        return cv2.remap(  # type: ignore[return-value]
            paint, columns, rows, cv2.INTER_LINEAR, dst=out, borderMode=cv2.BORDER_REPLICATE
        )

    def seen_columns(self, angle: Picture, psi: Array) -> Picture:
        """Return the columns for `sample` at angles (columns, within half a turn) of a body turned by psi."""
        n = self.columns
        shift = np.mod(-np.asarray(psi) * self.per_rad, n) + 0.5 * n
        return angle + shift.astype(np.float32)


def _box(pixels: Paint, width: float) -> Paint:
    """Average over ``width`` columns, centred and cyclic.

    A box of the width n + 2 f, n odd, is the box of n whole columns with the share f of the next column at
    each end.
    """
    columns = pixels.shape[1]
    odd = int(width) if int(width) % 2 else int(width) - 1
    share = 0.5 * (width - odd)
    pad = odd // 2 + 2
    mean = np.pad(pixels, ((0, 0), (pad, pad), (0, 0)), mode="wrap")
    if share > 0.0:
        inner, outer = cv2.blur(mean, (odd, 1)), cv2.blur(mean, (odd + 2, 1))
        mean = cv2.addWeighted(inner, (1.0 - share) * odd / width, outer, share * (odd + 2) / width, 0.0)  # type: ignore[assignment]
    elif odd > 1:
        mean = cv2.blur(mean, (odd, 1))  # type: ignore[assignment]
    mean = mean.reshape(pixels.shape[0], -1, pixels.shape[2])
    return np.ascontiguousarray(mean[:, pad : pad + columns])


def soft_step(x: Array, sigma: float) -> Array:
    """Return the unit step at 0 seen through a Gaussian of standard deviation ``sigma``."""
    from scipy.special import ndtr

    return np.asarray(ndtr(x / sigma), dtype=np.float64)


def soft_box(x: Array, low: float, high: float, sigma: float) -> Array:
    """Return the box from ``low`` to ``high`` seen through a Gaussian; a rectangle is a product of two."""
    return soft_step(x - low, sigma) - soft_step(x - high, sigma)
