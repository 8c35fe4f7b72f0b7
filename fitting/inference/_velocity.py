"""Angular velocities from angles: the smoothing of the paper, and rough estimates for initial values.

Between its windows the rotor's speed is interpolated with the slopes measured in them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitting.inference._record import Quantity, Record, Samples

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


_POINTS = 160


def initial_speeds(record: Record, points: int = _POINTS, samples: int = 12) -> tuple[Array, Array]:
    """Return times and speeds of rotor and casing (points, 2) from local straight lines of so many samples at least."""
    casing = _local(record.casing, min(points, len(record.casing) // samples), record.quantity == "angle")
    windows = np.array([_local(w, 1, record.quantity == "angle")[0] for w in record.rotor])
    times = np.linspace(*record.span, points)
    omega_c = np.interp(times, casing[:, 0], casing[:, 1])
    omega_r = np.zeros(points) if record.single else _rotor_curve(windows, times)
    return times, np.stack([omega_r, omega_c], axis=1)


def _local(samples: Samples, count: int, is_angle: bool) -> Array:  # noqa: FBT001
    """Return (time, speed, slope) of a run cut in equal pieces, by the normal equations of all pieces at once."""
    pieces = np.array_split(np.arange(len(samples)), max(1, count))
    first = np.array([p[0] for p in pieces])
    size = np.array([len(p) for p in pieces])

    def sums(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, first))

    middle = sums(samples.time) / size
    half = np.maximum(0.5 * (samples.time[first + size - 1] - samples.time[first]), 1e-9)
    x = (samples.time - np.repeat(middle, size)) / np.repeat(half, size)
    y = samples.value - np.repeat(samples.value[first], size)
    rows = np.full((len(first), 3), np.nan)
    rows[:, 0] = middle
    # of one length, or of two that differ by a sample: the shortest says which degree all have
    degree = min(2 if is_angle else 1, int(size.min()) - 1)
    powers = [np.ones(len(x)), x, x * x][: degree + 1]
    gram = np.stack([np.stack([sums(p * q) for q in powers], axis=-1) for p in powers], axis=-1)
    right = np.stack([sums(p * y) for p in powers], axis=-1)
    c = np.linalg.solve(gram, right[..., None])[..., 0]
    c[:, 0] += samples.value[first]
    if is_angle:
        rows[:, 1 : degree + 1] = (c[:, 1:] / half[:, None] ** np.arange(1, degree + 1)) * np.array([1, 2])[
            :degree
        ]
    else:
        rows[:, 1 : degree + 2] = c / half[:, None] ** np.arange(degree + 1)
    return rows


def _rotor_curve(windows: Array, times: Array) -> Array:
    windows = windows[np.argsort(windows[:, 0])]
    t, speed, slope = windows.T
    between = np.gradient(speed, t) if len(t) > 1 else np.zeros(1)
    slope = np.where(np.isfinite(slope), slope, between)
    if len(t) == 1:
        curve = speed[0] + slope[0] * (times - t[0])
    else:
        clipped = np.clip(times, t[0], t[-1])
        edge = np.where(times < t[0], slope[0], slope[-1])
        curve = hermite(t, speed, slope, clipped) + edge * (times - clipped)
    # the rotor keeps its sense
    sense = 1.0 if speed.mean() >= 0 else -1.0
    return np.asarray(sense * np.maximum(sense * curve, 0.05 * np.abs(speed).min()))


def hermite(t: Array, value: Array, slope: Array, times: Array, *, slopes: bool = False) -> Array:
    """Return the cubics through values and slopes (n, ...), or their slopes, at times within."""
    i = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
    shape = (-1, *[1] * (value.ndim - 1))
    h = (t[i + 1] - t[i]).reshape(shape)
    u = (times - t[i]).reshape(shape) / h
    rise = value[i + 1] - value[i]
    first, last = slope[i] * h - rise, rise - slope[i + 1] * h
    if slopes:
        return np.asarray(
            (rise + (1 - 2 * u) * (first * (1 - u) + last * u) + u * (1 - u) * (last - first)) / h
        )
    return np.asarray(value[i] + u * rise + u * (1 - u) * (first * (1 - u) + last * u))
