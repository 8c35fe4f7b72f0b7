"""The middle of the coloured disc at the centre, in every frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.scene import Disc
from gyrotrack.segmentation.ring import CHROMA_SHIFT
from gyrotrack.video.planes import Frame

Floats = npt.NDArray[np.float64]


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

    def take(self, frame: Frame, place: int) -> None:
        """Store the window of one frame."""
        x, y = self._corner
        side = 2 * self.half + 1
        u, v = frame.u[y : y + side, x : x + side], frame.v[y : y + side, x : x + side]
        self._pixels[place, 0, : u.shape[0], : u.shape[1]] = u
        self._pixels[place, 1, : v.shape[0], : v.shape[1]] = v

    def centres(self, count: int) -> Floats:
        """Measure the disc's centre in the first `count` frames, (count, 2) in px; NaN where hidden."""
        u, v = self.disc.chroma
        norm = u * u + v * v
        pixels = self._pixels[:count].astype(np.float32)
        score = (pixels[:, 0] * np.float32(u / norm) + pixels[:, 1] * np.float32(v / norm)).astype(np.float64)
        x, y = _disc_centroid(score, self.disc.radius / 2.0)
        place = np.stack([x + self._corner[0], y + self._corner[1]], axis=1)
        return np.asarray(2.0 * place + np.array(CHROMA_SHIFT))


def _disc_centroid(score: Floats, radius: float) -> tuple[Floats, Floats]:
    """Find the centroid of a bright disc in each image, (n, side, side), in px of the window.

    The disc's level and the background's are taken from each frame; the mask rises softly between 30 % and
    70 % of the step, so that the edge counts with the share of each pixel that it covers.
    """
    count, side, _ = score.shape
    grid = np.arange(side, dtype=np.float64)
    few = np.sort(score[:, ::3, ::3].reshape(count, -1), axis=1)
    level, ground = (few[:, int(part * (few.shape[1] - 1)), None, None] for part in (0.97, 0.5))
    step = np.maximum(level - ground, 1e-6)
    soft = np.clip(((score - ground) / step - 0.3) / 0.4, 0.0, 1.0)
    middle = (side - 1) / 2.0
    x, y = np.full(count, middle), np.full(count, middle)
    for reach in (2.2 * radius + 3.0, 1.5 * radius + 1.5, 1.35 * radius + 1.0):
        inside = (grid[None, None, :] - x[:, None, None]) ** 2 + (
            grid[None, :, None] - y[:, None, None]
        ) ** 2 < reach**2
        weight = soft * inside
        total = np.maximum(weight.sum(axis=(1, 2)), 1e-9)
        x = (weight.sum(axis=1) @ grid) / total
        y = (weight.sum(axis=2) @ grid) / total
    expected = np.pi * radius**2
    hidden = (total < 0.6 * expected) | (total > 1.7 * expected) | (step[:, 0, 0] < 0.3)
    x[hidden] = np.nan
    y[hidden] = np.nan
    return x, y
