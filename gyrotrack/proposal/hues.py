"""Which colours move in a film: the peaks of the hues of what differs from the resting picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.samples import Samples
from gyrotrack.segmentation.colour import hue_score

Floats = npt.NDArray[np.float64]
Images = npt.NDArray[np.float32]

BINS = 120
APART = np.deg2rad(24.0)
"""Hues closer than this are one colour."""
SECTOR = np.deg2rad(45.0)
LEAST_CHANGE = 6.0
"""Grey levels of chroma by which a pixel must change to count as moving colour."""
LEAST_SHARE = 0.004
"""Share of all moving colour that a hue must have."""
MOST = 8


@dataclass(frozen=True)
class MovingColour:
    """Sample frames as differences of chroma from the resting picture.

    Attributes
    ----------
    change : ndarray, shape (2, n, height, width)
        Chroma of each sample less the median of all, only where the colour grew stronger.
    hues : tuple of float
        Directions in the chroma plane (U, V) of the colours that move [rad], the strongest first.
    """

    change: Images
    hues: tuple[float, ...]

    def scores(self, hue: float) -> Images:
        """Return how much of a hue each pixel of each sample shows, (n, height, width), nearer to it than to others."""
        score = hue_score(self.change[0], self.change[1], direction_of(hue))
        limit = min((0.5 * apart(hue, other) for other in self.hues if other != hue), default=SECTOR)
        if limit < SECTOR:
            along = np.cos(hue) * self.change[0] + np.sin(hue) * self.change[1]
            across = np.cos(hue) * self.change[1] - np.sin(hue) * self.change[0]
            score[np.abs(across) > np.tan(limit) * along] = 0.0
        return score


def moving_colour(samples: Samples) -> MovingColour:
    """Find what moves in sample frames, and the hues of it.

    A marker shows as a change towards its own hue. Where it lay in most of the samples, the others show the opposite:
    such changes make the colour weaker and are left out.
    """
    chroma = samples.chroma.astype(np.float32)
    still = np.median(chroma, axis=1, keepdims=True)
    change = chroma - still
    stronger = np.hypot(*(chroma - 128.0)) > np.hypot(*(still - 128.0))
    size = np.hypot(change[0], change[1])
    noise = float(np.percentile(size, 75))
    change[:, ~(stronger & (size > max(LEAST_CHANGE, 3.0 * noise)))] = 0.0
    return MovingColour(change, _peaks(change))


def _peaks(change: Images) -> tuple[float, ...]:
    size = np.hypot(change[0], change[1]).ravel()
    moving = size > 0
    hue = np.arctan2(change[1].ravel()[moving], change[0].ravel()[moving])
    bins = np.floor(np.mod(hue, 2.0 * np.pi) * BINS / (2.0 * np.pi)).astype(np.int64) % BINS
    weight = np.bincount(bins, size[moving], BINS).astype(np.float64)
    x = np.arange(-6, 7) / 2.5
    bell = np.exp(-0.5 * x**2)
    smooth = np.convolve(np.concatenate([weight[-6:], weight, weight[:6]]), bell / bell.sum(), mode="valid")
    top = (smooth >= np.roll(smooth, 1)) & (smooth > np.roll(smooth, -1))
    found: list[float] = []
    for k in sorted(np.flatnonzero(top).tolist(), key=lambda k: -smooth[k]):
        place = (k + 0.5) * 2.0 * np.pi / BINS
        share = float(weight[(np.arange(k - 4, k + 5)) % BINS].sum() / max(weight.sum(), 1e-9))
        if share > LEAST_SHARE and all(apart(place, other) > APART for other in found):
            found.append(place)
    return tuple(found[:MOST])


def direction_of(hue: float) -> tuple[float, float]:
    """Return the unit vector (U, V) of a hue in rad."""
    return float(np.cos(hue)), float(np.sin(hue))


def apart(a: float, b: float) -> float:
    """Return the angle between two hues in rad."""
    return float(abs(np.angle(np.exp(1j * (a - b)))))
