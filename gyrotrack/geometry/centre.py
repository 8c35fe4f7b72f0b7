"""The centre in every frame: the middle of the coloured disc, and its path smoothed as much as the data bear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.scene import Disc
from gyrotrack.segmentation.ring import CHROMA_SHIFT
from gyrotrack.video.planes import Frame

Floats = npt.NDArray[np.float64]

_WIDTHS = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 32.0)


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
        """Measure the disc's centre in the first `count` frames, (count, 2) in luma px; NaN where it is hidden."""
        u, v = self.disc.chroma
        norm = u * u + v * v
        pixels = self._pixels[:count].astype(np.float32)
        score = (pixels[:, 0] * np.float32(u / norm) + pixels[:, 1] * np.float32(v / norm)).astype(np.float64)
        x, y = _disc_centroid(score, self.disc.radius / 2.0)
        place = np.stack([x + self._corner[0], y + self._corner[1]], axis=1)
        return 2.0 * place + np.array(CHROMA_SHIFT)


def _disc_centroid(score: Floats, radius: float) -> tuple[Floats, Floats]:
    """Find the centroid of a bright disc in each image, (n, side, side), in px of the window.

    The disc's level and the background's are taken from each frame; the mask rises softly between 30 % and 70 %
    of the step, so that the edge counts with the share of each pixel that it covers.
    """
    count, side, _ = score.shape
    grid = np.arange(side, dtype=np.float64)
    level = np.percentile(score.reshape(count, -1), 97, axis=1)[:, None, None]
    ground = np.median(score.reshape(count, -1), axis=1)[:, None, None]
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


@dataclass(frozen=True)
class CentrePath:
    """The centre in each frame (n, 2) [px], its uncertainty per axis (n,) [px], and the smoothing width [frames]."""

    centre: Floats
    sigma: Floats
    width: float


def smooth_path(measured: Floats) -> CentrePath:
    """Smooth a measured path, by as much as makes it most predictable.

    Parameters
    ----------
    measured : ndarray, shape (n, 2)
        Positions in px, NaN where there is none.

    Notes
    -----
    The kernel is a Gaussian of standard deviation w frames, "twiced" (2 G - G G) so that curved paths keep their
    amplitude. For each w every point is predicted from the others; the mean squared error of that prediction
    is s^2 + e(w)^2 with s the noise of one measurement (from fourth differences) and e the error of the
    smooth path; the w with the least e is taken, or none when e(w) >= s for all.
    """
    known = np.isfinite(measured).all(axis=1)
    if not known.any():
        return CentrePath(measured, np.full(len(measured), np.nan), 0.0)
    index = np.arange(len(measured))
    filled = np.stack([np.interp(index, index[known], measured[known, k]) for k in (0, 1)], axis=1)
    noise = _noise(filled)
    best, least = 0.0, noise**2
    for width in _WIDTHS[1:]:
        if 6 * width > len(measured):
            break
        error = _left_out(filled, known, width) - noise**2
        if error < least:
            best, least = width, error
    path = filled if best == 0.0 else _smooth(filled, known, best)[0]
    gain = 1.0 if best == 0.0 else float(np.sqrt((_kernel(best) ** 2).sum()))
    sigma = np.sqrt(max(least, (gain * noise) ** 2))
    near = np.convolve(known, np.ones(2 * int(4 * best) + 1), mode="same") > 0
    return CentrePath(path, np.where(near, sigma, np.nan), best)


def _noise(path: Floats) -> float:
    """Return the noise of one coordinate from fourth differences, var = sum of squared binomials (70) s^2."""
    if len(path) < 6:
        return 0.1
    fourth = np.diff(path, n=4, axis=0)
    scatter = 1.4826 * np.median(np.abs(fourth - np.median(fourth, axis=0)), axis=0)
    return float(max(np.sqrt(np.mean(scatter**2) / 70.0), 1e-3))


def _kernel(width: float) -> Floats:
    reach = int(np.ceil(4.0 * width))
    x = np.arange(-2 * reach, 2 * reach + 1)
    once = np.exp(-0.5 * (x / width) ** 2)
    once /= once.sum()
    twice = np.exp(-0.25 * (x / width) ** 2)
    return np.asarray(2.0 * once - twice / twice.sum())


def _smooth(path: Floats, known: npt.NDArray[np.bool_], width: float) -> tuple[Floats, Floats]:
    """Return the smoothed path and the weight that each point had in its own smoothed value."""
    kernel = _kernel(width)
    weight = known.astype(np.float64)
    reach = len(kernel) // 2
    total = np.convolve(np.pad(weight, reach), kernel, mode="valid")
    total = np.where(np.abs(total) < 0.2, 0.2, total)
    columns = [np.convolve(np.pad(weight * path[:, k], reach), kernel, mode="valid") / total for k in (0, 1)]
    return np.stack(columns, axis=1), weight * kernel[reach] / total


def _left_out(path: Floats, known: npt.NDArray[np.bool_], width: float) -> float:
    """Return the mean squared error, per axis, of predicting each point from the others."""
    smooth, own = _smooth(path, known, width)
    error = (path - smooth) / (1.0 - own)[:, None]
    inner = known.copy()
    edge = min(int(3 * width), len(path) // 4)
    inner[:edge] = inner[len(path) - edge :] = False
    if not inner.any():
        return float("inf")
    scatter = np.sort((error[inner] ** 2).sum(axis=1))
    return float(scatter[: max(int(0.98 * len(scatter)), 1)].mean() / 2.0)
