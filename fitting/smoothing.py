"""The paper's smoothing, for pictures and for the figures of merit that the paper prints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitting.record import Quantity, Samples

Array = NDArray[np.float64]

WIDTH = 51
DROPPED = 50
# windows sorted at a time: their copies stay in the cache
_CHUNK = 1024


def speeds(
    samples: Samples, quantity: Quantity, width: int = WIDTH, dropped: int = DROPPED
) -> tuple[Array, Array]:
    """Return times and angular velocities: median of the angle, gradient, median, ends dropped.

    Parameters
    ----------
    samples : Samples
        Angles [rad] or speeds [rad/s].
    quantity : {"angle", "omega"}
        Which of both.
    width : int
        Points of the running median; the paper has 51.
    dropped : int
        Points left out at each end; the paper has 50. Short runs drop a tenth at most.

    Returns
    -------
    time, omega : ndarray
        [s], [rad/s].
    """
    width = median_width(len(samples), width)
    value = samples.value
    if quantity == "angle":
        # the median of a monotonic angle is its middle point; it only acts on outliers
        value = np.gradient(running_median(value, width), samples.time)
    omega = running_median(value, width)
    cut = min(dropped, len(samples) // 10)
    keep = slice(cut, len(samples) - cut)
    return samples.time[keep], np.asarray(omega[keep])


def median_width(count: int, width: int = WIDTH) -> int:
    """Return how many points the running median of a run of so many samples takes: a tenth of them at most."""
    return min(width, max(3, count // 10 | 1))


def running_median(value: Array, width: int) -> Array:
    """Return the median of `width` points (odd) about each; beyond the ends the end values are repeated."""
    half = width // 2
    padded = np.concatenate([np.full(half, value[0]), value, np.full(half, value[-1])])
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    out = np.empty(len(value))
    for i in range(0, len(value), _CHUNK):
        out[i : i + _CHUNK] = np.partition(windows[i : i + _CHUNK], half, axis=1)[:, half]
    return out
