"""The part of a recording with free motion: without excluded intervals, drive, brake and rest.

Speeds are estimated in blocks of samples. The end of a drive (by motor or hand) is a changepoint of the deceleration:
before this point the speed is constant or increases, afterwards the body slows down. A brake is a deceleration of at
least three times the previous deceleration, until the end of the motion. Rest is a speed that is consistent with zero.
A disturbance is a speed that increases again. If the body never slows down, no part of its motion is excluded. If the
speed rises and falls repeatedly, as with a motor, no part is excluded either.

The start of an oscillation is excluded while a hand holds or moves the body. In this part, periods and amplitudes do
not follow the smooth curves of the later part.

Rest at the end of an oscillation is excluded. If the resolution of the file is coarser than the noise, the excluded
part begins after the last deflection of more than two steps of the resolution. Otherwise it begins where the body is at
rest within the noise. The error of a quantised value is white while the value passes through several steps. At rest,
this error is a constant of up to half a step, which averages do not reduce (B. Widrow, I. Kollar, Quantization Noise,
2008).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import median_filter

from gyrotrack._errors import UsageError
from gyrotrack.io._records import Floats
from gyrotrack.io.readers._clock import MIN_SAMPLES
from gyrotrack.io.readers._motion_table import MotionTable, scatter
from gyrotrack.io.readers._plausibility import rises

_BLOCKS = 400
_MIN_BLOCK = 4
_BRAKE_RATIO = 3.0  # smallest ratio of the decelerations during and before a brake
# smallest significant deviation [standard errors], for four comparisons: the slopes before and after the end of a
# drive, a block and a parabola, a period or amplitude and a smooth curve, the last speed after a drive and the first
_SIGNIFICANT = 6.0
_MIN_CROSSINGS = 12  # smallest number of zero crossings for the detection of irregular periods
_IRREGULAR = np.array([0.01, 0.05])  # smallest relative deviations of an irregular period and amplitude
# smallest number of zero crossings for the detection of a body that is held at the start
_FEWEST_CROSSINGS = 5
# The body is held at the start of a record if the start deviates from the next period by at least this multiple of the
# same deviation in later periods, and by at least this share of the peak-to-peak amplitude. A hold of a ninth of a
# period at a turning point causes this share.
_HELD_RATIO, _HELD_SHARE = 3.0, 0.03
# largest range of the means at rest: the larger of `_STILL_SIGMA` standard errors and `_STILL_SHARE` of the range of
# the record; 200 values of normal noise have a range of 5.5 standard errors
_STILL_SIGMA, _STILL_SHARE = 8.0, 2e-3
# A record counts as the motion of a motor, and is not cut, if two conditions hold. The speed rises at least
# `_FEWEST_RISES` times by `_VARIES` of the largest speed. The part that seems to be free is shorter than `_SHORT` of
# the record. A hand may also push a body several times, but then the speed hardly falls between the pushes. If a record
# contains several free runs, the part that seems to be free is one of these runs and is longer than `_SHORT` of the
# record.
_VARIES, _FEWEST_RISES, _SHORT = 0.25, 3, 0.2
# smallest deflection, or change of a speed, at which quantisation errors are independent [steps of the resolution]
_MIN_STEPS = 2


@dataclass(frozen=True)
class Limits:
    """Limits set by the user, on the clock of the recording [s]: first and last time, and intervals to exclude."""

    start: float | None = None
    stop: float | None = None
    cuts: tuple[tuple[float, float], ...] = ()
    keep_all: bool = False


def read_cuts(given: Sequence[str]) -> tuple[tuple[float, float], ...]:
    """Parse intervals ``A:B`` [s] with B greater than A."""
    cuts = []
    for text in given:
        first, _, last = text.partition(":")
        try:
            cut = (float(first), float(last))
        except ValueError:
            cut = (1.0, 0.0)
        if not cut[0] < cut[1]:
            raise UsageError(f"{text[:40]!r} is not an interval of time.", "Write --cut 12.5:14 in seconds.")
        cuts.append(cut)
    return tuple(cuts)


def within(time: Floats, limits: Limits) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return a mask of the times within the limits and outside of the excluded intervals."""
    keep = np.ones(len(time), dtype=bool)
    if limits.start is not None:
        keep &= time >= limits.start
    if limits.stop is not None:
        keep &= time <= limits.stop
    for first, last in limits.cuts:
        keep &= (time < first) | (time > last)
    return keep


def enough_within(
    time: Floats, limits: Limits, where: str = ""
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return the mask of `within`; too few times raise a UsageError, whose message begins with `where`."""
    keep = within(time, limits)
    if not keep.all() and keep.sum() < MIN_SAMPLES:
        span = f"{time[0]:.6g} to {time[-1]:.6g} s"
        what = f"{where}{keep.sum()} samples remain within the limits; the times are {span}."
        raise UsageError(what, "Choose --from, --to and --cut within these times.")
    return keep


def limited(table: MotionTable, limits: Limits) -> MotionTable:
    """Return the samples within the limits and outside of the excluded intervals."""
    keep = enough_within(table.time, limits, f"{table.path}: ")
    note = f"{table.path.name}: {int((~keep).sum())} samples were excluded by --from, --to or --cut"
    return table if keep.all() else table.only(keep, note)


def run_of(table: MotionTable, value: Floats, limits: Limits) -> tuple[MotionTable, Floats]:
    """Return the samples of the free motion, without drive, brake and rest; and the values, unwrapped, in SI units."""
    if limits.keep_all or len(table.time) < 8 * _MIN_BLOCK:
        return table, value
    time, speed, error = speeds(table, value)
    if len(time) < 12:
        return table, value
    if _oscillates(speed):
        return _without_rest(*_without_hand(table, value))
    scatter_of_speeds = _scatter_of_blocks(speed)
    speed = np.abs(median_filter(speed, 5, mode="nearest"))
    step = table.least_sigma * np.sqrt(12) if table.quantity == "omega" else 0.0
    begin, driven = _end_of_drive(time, speed, step)
    end, stopped = _end_of_motion(time, speed, error, begin)
    if not _coasts(speed[begin : end + 1]):
        return table, value
    if driven and speed[begin] - speed[end] < _SIGNIFICANT * scatter_of_speeds:
        return table, value  # the last blocks of a drive may also fall by chance
    first = time[begin] if driven else -np.inf
    last = time[end] if stopped else np.inf
    keep = (table.time >= first) & (table.time <= last)
    if keep.all() or keep.sum() < 60:
        return table, value
    short = np.ptp(table.time[keep]) < _SHORT * np.ptp(table.time)
    if short and rises(speed, _VARIES * float(speed.max())) >= _FEWEST_RISES:
        return table, value
    notes = []
    if driven:
        notes.append(
            f"{table.path.name}: the body is driven until {first:.2f} s (changepoint of its deceleration); "
            f"{int((table.time < first).sum())} samples were excluded (--keep-all keeps them)"
        )
    if stopped:
        notes.append(
            f"{table.path.name}: the body {stopped} after {last:.2f} s; {int((table.time > last).sum())} samples were "
            "excluded (--keep-all keeps them)"
        )
    return table.only(keep, *notes), value[keep]


def reverses(table: MotionTable, value: Floats) -> bool:
    """Return whether a body changes its sense of rotation more than once."""
    return _oscillates(speeds(table, value)[1])


def _oscillates(speed: Floats) -> bool:
    sense = np.sign(speed[np.abs(speed) > 0.1 * np.abs(speed).max()])
    return bool(np.count_nonzero(np.diff(sense)) > 1)


def _without_hand(table: MotionTable, value: Floats) -> tuple[MotionTable, Floats]:
    """Return the free part of an oscillation, without its start by hand."""
    first = start_of_oscillation(table.time, value)
    if not first:
        return table, value
    keep = np.arange(len(value)) >= first
    note = (
        f"{table.path.name}: before {table.time[first]:.2f} s the body is held or moved (periods or amplitudes "
        f"do not follow the smooth curves of the later part); {first} samples were excluded (--keep-all keeps them)"
    )
    return table.only(keep, note), value[keep]


def start_of_oscillation(time: Floats, value: Floats) -> int:
    """Return the first sample of the free part of an oscillation, 0 if it is free from the beginning.

    Period and logarithm of the amplitude of a free oscillation are smooth functions of time, and are fitted by
    polynomials. The free part begins after the last outlier in the first quarter. An outlier deviates by more than six
    times the scatter, and by more than 1 % of the period or 5 % of the amplitude. If no period is an outlier, but the
    body is held before the first upward zero crossing, the free part begins at the second crossing. `value` is the
    angle or the angular velocity.
    """
    value = value - 0.5 * (np.quantile(value, 0.05) + np.quantile(value, 0.95))
    crossings = upward_crossings(value)
    if len(crossings) < _FEWEST_CROSSINGS:
        return 0
    below, above = value[crossings - 1], value[crossings]
    at = time[crossings] - np.diff(time)[crossings - 1] * above / (above - below)
    size = np.array([np.ptp(value[a:b]) for a, b in pairwise(crossings)])
    if len(crossings) < _MIN_CROSSINGS:
        return int(crossings[1]) if _is_held(time, value, at, size) else 0
    curves = np.stack([np.log(np.diff(at)), np.log(size)], axis=1)
    x = 2 * (at[:-1] - at[0]) / (at[-2] - at[0]) - 1
    design = np.polynomial.chebyshev.chebvander(x, min(5, len(x) // 4))
    early = np.arange(len(x)) < len(x) // 4
    free = np.ones(len(x), dtype=bool)
    # small oscillations have less weight, because noise affects them more
    weight = (size / size.max())[:, None]
    for _ in range(len(x) // 4):
        fitted = np.linalg.lstsq((weight * design)[free], (weight * curves)[free], rcond=None)[0]
        rest = np.abs(curves - design @ fitted)
        noise = 1.483 * np.median((weight * rest)[free], axis=0) / weight
        off = (rest > np.maximum(_SIGNIFICANT * noise, _IRREGULAR)).any(axis=1) & early
        beginning = np.arange(len(x)) <= (int(np.flatnonzero(off)[-1]) if off.any() else -1)
        if (beginning == ~free).all():
            break
        free = ~beginning
    if free[0]:
        return int(crossings[1]) if _is_held(time, value, at, size) else 0
    return int(crossings[int(np.argmax(free))])


def _is_held(time: Floats, value: Floats, at: Floats, size: Floats) -> bool:
    """Return whether the start of an oscillation does not continue the following periods backwards.

    `at` are the times of the upward zero crossings [s], `size` the peak-to-peak amplitudes between them. The values
    before the first crossing are compared with the values one period later, which are multiplied by the ratio of
    neighbouring amplitudes. The same comparison for the later crossings shows the contribution of noise and of changes
    of the free motion.
    """
    period = np.diff(at)
    before = float(at[0] - time[0])
    if before > 1.5 * float(np.median(period)):
        return True
    before = min(before, float(period.min()))
    off = []
    for k in range(len(period) - 1):
        rows = (time >= at[k] - before) & (time < at[k])
        if not rows.any():
            return False
        later = np.interp(time[rows] + period[k], time, value) * size[k] / size[k + 1]
        off.append(float(np.sqrt(np.mean(np.square(value[rows] - later)))) / float(size[k]))
    return off[0] > max(_HELD_RATIO * float(np.median(off[1:])), _HELD_SHARE)


def upward_crossings(value: Floats, share: float = 0.02) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return the samples of the upward zero crossings of a curve, with a hysteresis of `share` of its range."""
    least = share * float(np.ptp(value))
    state = np.where(value > least, 1, np.where(value < -least, -1, 0))
    clear = np.flatnonzero(state)
    rising = clear[1:][(state[clear[1:]] > 0) & (state[clear[:-1]] < 0)]
    below = np.flatnonzero(value <= 0)
    return np.asarray(below[np.searchsorted(below, rising) - 1] + 1, dtype=np.intp)


def _without_rest(table: MotionTable, value: Floats) -> tuple[MotionTable, Floats]:
    """Return an oscillation up to the time at which the file does not resolve it any more, or the body is at rest."""
    last = _end_of_resolution(table, value)
    what = f"the deflection is at most {_MIN_STEPS} steps of the resolution"
    if last == len(value):
        last = end_of_oscillation(table.time, value, scatter(table.time, value))
        what = "the body is at rest within the noise"
    if last == len(value) or last < 60:
        return table, value
    keep = np.arange(len(value)) < last
    note = (
        f"{table.path.name}: after {table.time[last - 1]:.2f} s {what}; {int((~keep).sum())} samples were excluded "
        "(--keep-all keeps them)"
    )
    return table.only(keep, note), value[keep]


def _end_of_resolution(table: MotionTable, value: Floats) -> int:
    """Return the sample after the last deflection of more than `_MIN_STEPS` steps of the resolution.

    The result is the number of samples if the resolution is not coarser than the noise, or if no rest follows.
    """
    step = table.least_sigma * np.sqrt(12)
    deflection = value - np.median(value[-max(len(value) // 50, 1) :])
    beyond = np.flatnonzero(np.abs(deflection) > _MIN_STEPS * step)
    if not step > 0 or not len(beyond):
        return len(value)
    moving = slice(0, int(beyond[-1]) + 1)
    crossings = table.time[moving][1:][np.diff(np.sign(deflection[moving])) != 0]
    if len(crossings) < 3 or table.time[-1] - table.time[beyond[-1]] < 2 * np.max(np.diff(crossings[-3:])):
        return len(value)
    coarse = table.least_sigma >= np.median(scatter(table.time[moving], value[moving])) / 2
    return moving.stop if coarse else len(value)


def end_of_oscillation(time: Floats, value: Floats, sigma: Floats) -> int:
    """Return the first sample of the rest at the end of an oscillation.

    If the body does not come to rest, the result is the number of samples. At rest, the means over eighths of a period
    vary by less than 8 standard errors, or by less than 0.2 % of the range of the record. Dry friction then holds the
    body at a position that depends on the last reversal and contains no information about the laws. A rest of less than
    a period counts as motion. `value` is the angle or the angular velocity.
    """
    crossings = upward_crossings(value - 0.5 * (value.min() + value.max()))
    if len(crossings) < 2:
        return len(value)
    period = float(np.median(np.diff(time[crossings])))
    size = max(int(len(time) * period / (8 * (time[-1] - time[0]))), _MIN_BLOCK)
    count = len(value) // size
    first = len(value) - count * size
    means = value[first:].reshape(count, size).mean(axis=1)[::-1]
    extent = np.maximum.accumulate(means) - np.minimum.accumulate(means)
    error = float(np.median(sigma)) / np.sqrt(size)
    moving = np.flatnonzero(extent > max(_STILL_SIGMA * error, _STILL_SHARE * float(np.ptp(value))))
    last = len(value) - int(moving[0]) * size if len(moving) else 0
    return last if last and time[-1] - time[last - 1] >= period else len(value)


def speeds(table: MotionTable, value: Floats) -> tuple[Floats, Floats, Floats]:
    """Return times [s], angular velocities [rad/s] and their standard errors in blocks of samples."""
    size = max(_MIN_BLOCK, len(table.time) // (_BLOCKS * (4 if table.counted else 1)))
    edges = np.arange(0, len(table.time) - size + 1, size)
    time, speed, error = (np.empty(len(edges)) for _ in range(3))
    for k, start in enumerate(edges):
        t, v = table.time[start : start + size], value[start : start + size]
        time[k] = t.mean()
        if table.quantity == "omega":
            speed[k], error[k] = np.median(v), v.std() / np.sqrt(size)
            continue
        x = t - t.mean()
        spread = float(x @ x)
        speed[k] = float(x @ v) / spread
        residual = v - v.mean() - speed[k] * x
        error[k] = np.sqrt(max(float(residual @ residual) / max(size - 2, 1), 0.0) / spread)
    return time, speed, error


def _scatter_of_blocks(speed: Floats) -> float:
    """Return the scatter of the speeds of a fast body about its motion, from their second differences [rad/s].

    Speeds below half of the largest speed are omitted, because a body at rest has a smaller scatter.
    """
    size = np.abs(speed)
    fast = np.minimum(np.minimum(size[:-2], size[1:-1]), size[2:]) > 0.5 * float(size.max())
    bends = np.abs(np.diff(speed, 2))[fast]
    # sqrt(6): standard deviation of a second difference of independent speeds
    return 1.483 * float(np.median(bends)) / np.sqrt(6.0) if len(bends) else 0.0


def _coasts(speed: Floats) -> bool:
    """Return whether a body slows down continuously, except for noise."""
    lag = max(1, len(speed) // 20)
    return bool(len(speed) > 2 * lag and (speed[lag:] < speed[:-lag]).mean() > 0.9)


def _end_of_drive(time: Floats, speed: Floats, step: float = 0.0) -> tuple[int, bool]:
    """Return the first block of the free motion, and whether the body was driven before this block.

    If the speeds are multiples of a `step` [rad/s], a body that slows down has a constant recorded speed until the next
    step. A constant speed therefore shows a drive only if a free body would have slowed by several steps in this time.
    """
    top = float(speed.max())
    last_high = int(np.flatnonzero(speed >= 0.99 * top)[-1])
    falling = np.flatnonzero(speed[last_high:] < 0.85 * top)
    reach = last_high + (int(falling[0]) if len(falling) else len(speed) - last_high - 1)
    reach = max(reach, min(last_high + 6, len(speed) - 1))
    low = max(0, 2 * last_high - reach - 6)
    best: tuple[float, int, float, float, float] | None = None
    for k in range(max(low + 2, 2), reach - 2):
        before, after = slice(low, k + 1), slice(k, reach + 1)
        if k + 1 - low < 3:
            continue
        b, rb, ub = _slope(time[before], speed[before])
        a, ra, ua = _slope(time[after], speed[after])
        if best is None or rb + ra < best[0]:
            best = (rb + ra, k, b, a, float(np.hypot(ua, ub)))
    if best is None:
        return 0, False
    _, k, b, a, u = best
    slowed = -a * float(time[k] - time[low])
    if (
        b > 0.4 * a and a < 0 and b - a > _SIGNIFICANT * u and slowed > _MIN_STEPS * step
    ):  # the speed is constant before the changepoint
        return _first_free(time, speed, k + 1, reach), True
    if speed[0] < 0.9 * top and last_high > 2:  # the speed increases before this block
        return _first_free(time, speed, last_high + 1, reach), True
    return 0, False


def _first_free(time: Floats, speed: Floats, begin: int, reach: int) -> int:
    """Return the first block of the free motion, from `begin` on.

    A parabola is fitted to the blocks after a block, up to `reach`. In the free motion, a block and all later blocks
    agree with their parabolas.

    This correction is needed because the line before the changepoint describes only a constant drive. If the drive
    varies, its last blocks may agree better with the line of the free motion.
    """
    for first in range((begin + reach) // 2, begin - 1, -1):
        x, y = time[first + 1 : reach + 1] - time[first], speed[first + 1 : reach + 1]
        if len(x) < 6:
            break
        design = np.polynomial.polynomial.polyvander(x, 2)
        coefficients = np.linalg.lstsq(design, y, rcond=None)[0]
        residual = y - design @ coefficients
        variance = float(residual @ residual) / (len(x) - 3) * (1 + np.linalg.inv(design.T @ design)[0, 0])
        if abs(speed[first] - coefficients[0]) > _SIGNIFICANT * np.sqrt(variance):
            return first + 2  # the next block may still contain the end of the drive
    return min(begin + 1, len(time) - 1)


def _slope(time: Floats, speed: Floats) -> tuple[float, float, float]:
    """Return the slope of a fitted line, the residual sum of squares, and the standard error of the slope."""
    x = time - time.mean()
    spread = max(float(x @ x), 1e-300)
    slope = float(x @ speed) / spread
    residual = speed - speed.mean() - slope * x
    rest = float(residual @ residual)
    return slope, rest, float(np.sqrt(rest / max(len(time) - 2, 1) / spread))


def _end_of_motion(time: Floats, speed: Floats, error: Floats, begin: int) -> tuple[int, str]:
    """Return the last block of the free motion, and the cause of its end ("" without one)."""
    top = float(speed[begin:].max())
    noise = 3 * float(np.median(error[-max(len(error) // 10, 3) :])) + 1e-3 * top
    moving = np.flatnonzero(speed > noise)
    end = int(moving[-1]) if len(moving) else len(speed) - 1
    what = "is at rest" if end < len(speed) - 3 else ""
    lowest = np.minimum.accumulate(speed[begin : end + 1])
    rising = np.flatnonzero((speed[begin : end + 1] > 1.25 * lowest + 2e-3 * top) & (lowest < 0.2 * top))
    if len(rising) > 2 and np.diff(rising).max() < 5:
        end, what = (
            begin + int(np.argmin(speed[begin : begin + int(rising[0])])),
            "is disturbed (its speed increases again)",
        )
    slowing = -np.gradient(speed, time)
    span = max(5, (end - begin) // 10)
    brake = 0
    for k in range(end - 1, begin + span, -1):
        before = float(np.median(slowing[max(begin, k - span) : k]))
        if slowing[k : end + 1].min() <= 0 or before <= 0:
            break
        if (slowing[k : end + 1] > _BRAKE_RATIO * before).all() and speed[k - 1] > 0.05 * top:
            brake = k
    return (brake - 1, "is braked") if brake else (end, what)
