"""The middle of the coloured disc at the centre, in every frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.compiled import loops
from gyrotrack.geometry.scene import Disc
from gyrotrack.segmentation.ring import CHROMA_SHIFT
from gyrotrack.video.planes import Frame

Floats = npt.NDArray[np.float64]

_TOGETHER = 64
"""Frames measured at a time: their windows fit into the processor's own memory."""


class DiscWindow:
    """A small chroma window about the disc, collected for a batch of frames.

    Parameters
    ----------
    disc : Disc
        Where it was found, how large it is, and its chroma.
    capacity : int
        Frames of a batch.
    """

    def __init__(self, disc: Disc, capacity: int) -> None:
        self.disc = disc
        self.half = int(np.ceil((1.5 * disc.radius + 6.0) / 2.0))
        side = 2 * self.half + 1
        self._pixels = np.zeros((capacity, 2, side, side), dtype=np.uint8)
        self._corner = (0, 0)

    def aim(self, centre: tuple[float, float], frame: Frame) -> None:
        """Put the window about a centre (luma px), inside the picture."""
        height, width = frame.u.shape
        side = 2 * self.half + 1
        x = int(np.clip(round((centre[0] - CHROMA_SHIFT[0]) / 2.0) - self.half, 0, max(width - side, 0)))
        y = int(np.clip(round((centre[1] - CHROMA_SHIFT[1]) / 2.0) - self.half, 0, max(height - side, 0)))
        self._corner = (x, y)

    def take(self, frames: list[Frame], place: int) -> None:
        """Store the windows of some frames, from `place` of the batch on."""
        x, y = self._corner
        side = 2 * self.half + 1
        box = (slice(y, y + side), slice(x, x + side))
        height, width = frames[0].u[box].shape
        for frame, (u, v) in zip(frames, self._pixels[place:, :, :height, :width], strict=False):
            u[:] = frame.u[box]
            v[:] = frame.v[box]

    def centres(self, count: int) -> Floats:
        """Measure the disc's centre in the first `count` frames, (count, 2) in px; NaN where hidden."""
        u, v = self.disc.chroma
        norm = u * u + v * v
        place = np.empty((count, 2))
        if loops is not None:
            loops.disc(self._pixels[:count], place, (u / norm, v / norm), self.disc.radius / 2.0)
        else:
            for first in range(0, count, _TOGETHER):
                part = slice(first, min(first + _TOGETHER, count))
                pixels = self._pixels[part].astype(np.float32)
                score = pixels[:, 0] * np.float32(u / norm) + pixels[:, 1] * np.float32(v / norm)
                place[part] = np.stack(_disc_centroid(score, self.disc.radius / 2.0), axis=1)
        return np.asarray(2.0 * (place + self._corner) + np.array(CHROMA_SHIFT))


def _disc_centroid(score: npt.NDArray[np.float32], radius: float) -> tuple[Floats, Floats]:
    """Find the centroid of a bright disc in each image, (n, side, side), in px of the window.

    The disc's level and the background's are taken from each frame; the mask rises softly between 30 % and
    70 % of the step, so that the edge counts with the share of each pixel that it covers.
    """
    count, side, _ = score.shape
    grid = np.arange(side, dtype=np.float64)
    few = score[:, ::3, ::3].reshape(count, -1)
    ranks = [int(part * (few.shape[1] - 1)) for part in (0.97, 0.5)]
    level, ground = np.partition(few, ranks, axis=1)[:, ranks, None, None].transpose(1, 0, 2, 3)
    step = np.maximum(level - ground, np.float32(1e-6))
    soft = score - (ground + np.float32(0.3) * step)
    soft /= np.float32(0.4) * step
    np.clip(soft, 0.0, 1.0, out=soft)
    middle = (side - 1) / 2.0
    x, y = np.full(count, middle), np.full(count, middle)
    for reach in (2.2 * radius + 3.0, 1.5 * radius + 1.5, 1.35 * radius + 1.0):
        half_chord = np.sqrt(np.maximum(reach**2 - (grid - y[:, None]) ** 2, 0.0))[:, :, None]
        weight = soft * (np.abs(grid - x[:, None])[:, None, :] < half_chord)
        across = weight.sum(axis=1, dtype=np.float64)
        total = np.maximum(across.sum(axis=1), 1e-9)
        x = (across @ grid) / total
        y = (weight.sum(axis=2, dtype=np.float64) @ grid) / total
    expected = np.pi * radius**2
    hidden = (total < 0.6 * expected) | (total > 1.7 * expected) | (step[:, 0, 0] < 0.3)
    x[hidden] = np.nan
    y[hidden] = np.nan
    return x, y
