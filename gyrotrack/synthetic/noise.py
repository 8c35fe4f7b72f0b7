"""Sensor noise at little cost: cut from a few large banks of random numbers, at random places."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint8]

BANKS = 4
MARGIN = 96  # px by which a bank is larger than a frame: 9216 places to cut it from


class Noise:
    """Gaussian noise in grey levels, rounded to integers, independent in every pixel and colour.

    Parameters
    ----------
    height, width : int
        Size of the frames in px.
    deviation : float
        Standard deviation in grey levels; rounding adds a variance of 1/12.
    rng : numpy.random.Generator
        Source of the banks and of the places.
    """

    def __init__(self, height: int, width: int, deviation: float, rng: np.random.Generator) -> None:
        self._rng, self._size = rng, (height, width)
        shape = (height + MARGIN, width + MARGIN, 3)
        self._banks = []
        for _ in range(BANKS if deviation > 0.0 else 0):
            grain = np.rint(rng.standard_normal(shape, dtype=np.float32) * np.float32(deviation))
            self._banks.append(np.clip(grain, -127, 127).astype(np.int8))

    def on(self, picture: Frame) -> Frame:
        """Return the picture with noise of its own."""
        if not self._banks:
            return picture
        bank = self._banks[int(self._rng.integers(BANKS))]
        top, left = (int(n) for n in self._rng.integers(MARGIN, size=2))
        grain = bank[top : top + self._size[0], left : left + self._size[1]]
        return cv2.add(picture, grain, dtype=cv2.CV_8U)  # type: ignore[return-value]
