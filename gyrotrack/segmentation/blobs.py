"""Coloured blobs in one score image: where they are, how large, how strong."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt


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
