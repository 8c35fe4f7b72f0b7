"""A motion seen at uneven times: smoothed on an even grid in time, not in frames.

A body's path is made from the coarse angles by parabolas in time about each frame. What a marker departs from it is
small, and is put into the even place nearest to its frame to be smoothed together with the path there.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.evenness import HALF_WINDOW
from gyrotrack.geometry.local import local_fit, median_of

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_FEWEST = 6
_SOME = 1024
_REAL = 0.5
_CLEAR = 5.0


class Pace:
    """When the frames of a film were taken, where that was not evenly.

    Parameters
    ----------
    place : ndarray, shape (n,)
        Times of the frames in periods of the capture rate, increasing.
    sigma : float
        Their standard deviation, independent from frame to frame.
    """

    def __init__(self, place: Floats, sigma: float = 0.0) -> None:
        self.place = place - place[0]
        self.sigma = sigma

    @cached_property
    def _slot(self) -> Integers:
        return np.asarray(np.rint(self.place), dtype=np.int64)

    def path(self, coarse: Floats) -> tuple[Floats, Floats]:
        """Smooth a coarse path: values at the frames (n,), NaN where it has none, and at the even places [rad]."""
        known = np.isfinite(coarse)
        if known.sum() < _FEWEST:
            return coarse, np.zeros(int(self._slot[-1]) + 1)
        from scipy.interpolate import CubicHermiteSpline

        place = self.place[known]
        value, slope = local_parabola(place, coarse[known])
        near = np.abs(value - coarse[known]) < 0.3
        path = np.full(len(coarse), np.nan)
        path[known] = np.where(near, value, coarse[known])
        even = np.clip(np.arange(int(self._slot[-1]) + 1, dtype=np.float64), place[0], place[-1])
        return path, np.asarray(CubicHermiteSpline(place, value, slope)(even))

    def speed(self, path: Floats) -> Floats:
        """Return the change of a path in a period, (n,); NaN where the path is not known."""
        known = np.isfinite(path)
        out = np.full(len(path), np.nan)
        if known.sum() > 1:
            out[known] = np.gradient(path[known], self.place[known])
        return out

    def smooth(
        self, off: Floats, weight: Floats, bend: Floats, half: int, degree: int
    ) -> tuple[Floats, Floats]:
        """Fit polynomials in time to departures from a path; return their values and leverages at the frames.

        Parameters
        ----------
        off, weight : ndarray, shape (n,)
            Departures [rad] and their weights, 0 where there is none.
        bend : ndarray
            The path at the even places, less a straight line [rad].
        half, degree : int
            See `local_fit`; in periods.
        """
        total = np.bincount(self._slot, weight, len(bend)).astype(np.float64)
        clean = np.where(weight > 0.0, off, 0.0) * weight
        mean = np.bincount(self._slot, clean, len(bend)) / np.where(total > 0.0, total, 1.0)
        fitted, leverage = local_fit(mean + bend, total, half, degree)
        fitted = np.interp(self.place, np.arange(len(bend)), fitted - bend)
        return fitted, leverage[self._slot]


def local_parabola(place: Floats, value: Floats, half: int = HALF_WINDOW) -> tuple[Floats, Floats]:
    """Fit a parabola about every point of an uneven series, over `half` points to both sides: value and slope, (n,)."""
    out = np.empty((2, len(place)))
    reach = np.arange(-half, half + 1)
    bell = 1.0 - (reach / (half + 1.0)) ** 2
    for start in range(0, len(place), _SOME):
        i = np.arange(start, min(start + _SOME, len(place)))
        j = i[:, None] + reach
        weight = np.where((j >= 0) & (j < len(place)), bell, 0.0)
        j = np.clip(j, 0, len(place) - 1)
        x, y = (place[j] - place[i, None]) / half, value[j] - value[i, None]
        powers = np.stack([np.ones_like(x), x, x * x], axis=1)
        matrix = (powers * weight[:, None]) @ powers.transpose(0, 2, 1) + 1e-9 * np.eye(3)
        right = (powers * (weight * y)[:, None]).sum(axis=2)
        found = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
        out[0, i], out[1, i] = value[i] + found[:, 0], found[:, 1] / half
    return out[0], out[1]


def jitter_is_real(place: Floats, smooth: Floats, angle: Floats) -> bool:
    """Tell whether a body has moved on in frames that are late by their stamps, or turns as if these were even.

    Parameters
    ----------
    place, smooth : ndarray, shape (n,)
        Times of the frames, and the same without what jitters.
    angle : ndarray, shape (n,)
        Unwrapped angle of a body, NaN where it is not known [rad].

    Notes
    -----
    What an angle departs from a parabola in the smooth times is b w (place - smooth), with w the speed. The least
    squares b is near 1 where the camera was late, and near 0 where only the stamp is. One that is not known to a
    fifth leaves the stamps as they are.
    """
    known = np.isfinite(angle)
    if known.sum() < 2 * HALF_WINDOW:
        return True
    value, slope = local_parabola(smooth[known], angle[known])
    late = place[known] - smooth[known]
    late = slope * (late - local_parabola(smooth[known], late)[0])
    off = angle[known] - value
    core = np.abs(off) < 6.0 * 1.4826 * median_of(np.abs(off)) + 1e-9
    power = float(np.sum(late[core] ** 2))
    share = float(np.sum(late[core] * off[core])) / max(power, 1e-30)
    scatter = float(np.std(off[core] - share * late[core]))
    return scatter / np.sqrt(max(power, 1e-30)) > 1.0 / _CLEAR or share > _REAL
