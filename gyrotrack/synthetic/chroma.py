"""Red, green, blue to the planes of a film: BT.709, limited range, 4:2:0 with the chroma sited left.

A chroma sample (i, j) is centred on the luma position x = 2 i, y = 2 j + 1/2, the place that H.264 takes for
granted. Scalers differ here by half a luma pixel, which is why the conversion is our own.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint8]

KR, KB = 0.2126, 0.0722
_Y = np.array([KR, 1.0 - KR - KB, KB])
_CB = (np.array([0.0, 0.0, 1.0]) - _Y) / (2.0 * (1.0 - KB))
_CR = (np.array([1.0, 0.0, 0.0]) - _Y) / (2.0 * (1.0 - KR))
TO_LUMA = np.append(_Y * 219.0 / 255.0, 16.0)[None]
TO_CHROMA = np.stack([np.append(_CB * 224.0 / 255.0, 128.0), np.append(_CR * 224.0 / 255.0, 128.0)])


def to_planes(picture: Frame) -> tuple[Frame, Frame, Frame]:
    """Convert (height, width, 3) red, green, blue into Y (height, width), Cb and Cr of half the size."""
    height, width = picture.shape[:2]
    luma = cv2.transform(picture, TO_LUMA)
    half = (width // 2, height // 2)
    right = cv2.resize(picture, half, interpolation=cv2.INTER_AREA)  # columns 2 i and 2 i + 1
    shifted = np.empty_like(picture)
    shifted[:, 1:], shifted[:, 0] = picture[:, :-1], picture[:, 0]
    left = cv2.resize(shifted, half, interpolation=cv2.INTER_AREA)  # columns 2 i - 1 and 2 i
    chroma = cv2.transform(cv2.addWeighted(left, 0.5, right, 0.5, 0.0), TO_CHROMA)
    blue, red = cv2.split(chroma)
    return luma, blue, red  # type: ignore[return-value]
