"""Colours as directions of chroma, and coloured blobs.

In the chroma plane (U - U0, V - V0) a hue is a direction, whatever the brightness of the lamp. A name covers
a sector of +-45 degrees about its direction: "red" takes in dark red and orange-red, "blue" also cyan-blue,
"green" also yellow-green. The true shade is then measured in the clip.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt


@contextmanager
def single_threaded() -> Iterator[None]:
    """Let OpenCV work in the calling thread inside the block."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


Floats = npt.NDArray[np.float32]

Hue = Literal["red", "orange", "yellow", "green", "cyan", "blue", "magenta"]

_HUE_DEGREES: dict[str, float] = {
    "red": 108.0,
    "orange": 138.0,
    "yellow": 171.0,
    "green": 228.0,
    "cyan": 289.0,
    "blue": 333.0,
    "magenta": 52.0,
}


def chroma_direction(colour: str, hue: float | None = None) -> tuple[float, float]:
    """Return the unit vector (U, V) of a named colour, or of its exact `hue` in degrees if that is given.

    White has none and gives (0, 0).
    """
    if colour == "white":
        return (0.0, 0.0)
    angle = np.deg2rad(_HUE_DEGREES[colour] if hue is None else hue)
    return (float(np.cos(angle)), float(np.sin(angle)))


def nearest_colour(hue: float) -> Hue:
    """Return the name whose direction in the chroma plane is nearest to a hue in degrees."""

    def apart(name: str) -> float:
        return abs((hue - _HUE_DEGREES[name] + 180.0) % 360.0 - 180.0)

    names: tuple[Hue, ...] = get_args(Hue)
    return min(names, key=apart)


def hue_score(du: npt.ArrayLike, dv: npt.ArrayLike, direction: tuple[float, float]) -> Floats:
    """Return how far a chroma difference reaches into the sector of a hue.

    The score is p - |q|, with p the part of (du, dv) along the direction and q the part across it; it is
    positive within 45 degrees of the direction, and cut off at zero outside.
    """
    u, v = np.asarray(du, dtype=np.float32), np.asarray(dv, dtype=np.float32)
    along = direction[0] * u + direction[1] * v
    across = direction[0] * v - direction[1] * u
    score: Floats = np.maximum(along - np.abs(across), np.float32(0.0))
    return score


# below this length of the chroma vector (of 255) a colour has no hue to speak of
_LEAST_CHROMA = 14.0
_BRIGHT = 110.0


def colour_name(red: float, green: float, blue: float) -> str:
    """Return the name whose hue is nearest to a colour (0 to 255 each): white for bright grey, empty for dark.

    U and V are those of ITU-R BT.601.
    """
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    u, v = 0.564 * (blue - luma), 0.713 * (red - luma)
    if np.hypot(u, v) < _LEAST_CHROMA:
        return "white" if luma >= _BRIGHT else ""
    hue = np.degrees(np.arctan2(v, u))
    return min(_HUE_DEGREES, key=lambda name: abs((hue - _HUE_DEGREES[name] + 180.0) % 360.0 - 180.0))


@dataclass(frozen=True)
class Blob:
    """A connected patch of one colour.

    Attributes
    ----------
    x, y : float
        Centroid, weighted by score, in px of the score image.
    area : int
        Pixels above the threshold.
    weight : float
        Sum of their scores.
    fill : float
        Area over that of the smallest circle with the same extent: 1 for a disc, less for rectangles and
        arcs.
    """

    x: float
    y: float
    area: int
    weight: float
    fill: float


def find_blobs(
    score: npt.NDArray[np.float32], threshold: float, most: int = 4, least_area: int = 3
) -> list[Blob]:
    """Find the strongest connected patches above a threshold, strongest first."""
    mask = (score > threshold).astype(np.uint8)
    count, found_labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    labels = np.asarray(found_labels, dtype=np.int32)
    areas = stats[1:count, cv2.CC_STAT_AREA]
    found = []
    for label in (np.argsort(-areas)[: 4 * most] + 1).tolist():
        if areas[label - 1] < least_area:
            break
        found.append(_blob(score, labels, np.asarray(stats[label], dtype=np.int32), label))
    return sorted(found, key=lambda blob: -blob.weight)[:most]


def _blob(
    score: npt.NDArray[np.float32], labels: npt.NDArray[np.int32], box: npt.NDArray[np.int32], label: int
) -> Blob:
    left, top, width, height, area = (int(v) for v in box)
    window = (slice(top, top + height), slice(left, left + width))
    weights = np.where(labels[window] == label, score[window], np.float32(0.0)).astype(np.float64)
    total = float(weights.sum())
    x = left + float(weights.sum(axis=0) @ np.arange(width)) / total
    y = top + float(weights.sum(axis=1) @ np.arange(height)) / total
    fill = 4.0 * area / (np.pi * max(width, height) ** 2)
    return Blob(x, y, area, total, fill)
