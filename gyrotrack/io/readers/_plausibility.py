"""Checks of the meaning of a column, before its values are used.

A column that counts the rows is neither a counter of revolutions nor a clock. Intervals between pulses are not times
of pulses. The range of an angle that wraps determines its unit. An angle and its speed in one table determine the
units of each other.
"""

from __future__ import annotations

import math

import numpy as np

from gyrotrack.io._records import Floats
from gyrotrack.io.readers._raw_table import TURN, RawTable

_FEWEST = 8  # smallest number of values for a rule
_BACKWARD = 0.05  # a column is not a clock if at least this share of its steps is backward
_PARTS = 30  # number of parts of a record for which the growth of intervals is compared
# smallest change of the logarithm of intervals from which their law of growth can be determined
_LEAST_CHANGE = 0.3
# range of plausible exponents: intervals grow by steps proportional to a power of the interval (viscous friction 2,
# dry friction 3)
_POWERS = (1.5, 3.5)
_POWER_LAW_R2 = 0.98  # smallest share of the variance that the power law must explain
_EQUAL_STEPS = 0.99  # smallest share of equal steps of a sampled clock
_EQUAL = 0.01  # largest relative deviation of equal steps
_WHOLE = 0.05  # largest deviation of the number of pulses per turn from a whole number
_PERIODS = {"rad": TURN, "deg": 360.0, "turns": 1.0, "gon": 400.0, "mrad": 1e3 * TURN}
_NEAR = 0.03  # largest relative deviation of a period or a ratio of units from its nominal value
# ratios of the slope of an angle to the speed, if the angle, the speed or the time is in another unit
_RATIOS = (
    (math.pi / 180, "one of them is in degrees, the other in rad"),
    (180 / math.pi, "one of them is in degrees, the other in rad"),
    (TURN, "one of them is in turns, the other in rad"),
    (1 / TURN, "one of them is in turns, the other in rad"),
    (TURN / 60, "the speed is in turns per minute"),
    (60 / TURN, "the speed is in turns per minute"),
    (1 / 6, "the angle is in degrees and the speed in turns per minute"),
    (6.0, "the angle is in degrees and the speed in turns per minute"),
    (0.9, "one of them is in gon, the other in degrees"),
    (1 / 0.9, "one of them is in gon, the other in degrees"),
    (1e3, "the time is in ms"),
    (1e6, "the time is in us"),
)
# smallest number of passages of an oscillating body through the middle of its range, and hysteresis [share of the
# range]
_PASSAGES, _CLEAR = 4, 0.1
# limits for an angle that wraps at a value other than a whole turn: smallest jump [share of the range], smallest number
# of jumps, largest other step [share of the range]
_WHOLE_RANGE, _JUMPS, _SMALL_STEP = 0.8, 3, 0.25
_LEAST_RATIO_R2 = 0.9  # smallest share of the variance of a speed that the slopes of the angle must explain


def counts_rows(values: Floats) -> bool:
    """Return whether values are consecutive whole numbers: an index of the rows."""
    return len(values) >= _FEWEST and bool(
        (np.diff(values) == 1).all() and (values == np.round(values)).all()
    )


def row_numbers(raw: RawTable) -> list[int]:
    """Return the columns that number the rows."""
    columns = ((i, raw.numeric(i)) for i in range(len(raw.columns)))
    return [i for i, values in columns if values is not None and counts_rows(values)]


def are_intervals(values: Floats) -> bool:
    """Return whether a column of events contains the intervals between events instead of their times.

    Times always increase. Intervals decrease when the speed rises.
    """
    known = values[np.isfinite(values)]
    if len(known) < _FEWEST or not (known > 0).all():
        return False
    return float((np.diff(known) < 0).mean()) > _BACKWARD


def may_be_intervals(values: Floats) -> bool:
    """Return whether increasing values may also be intervals between the pulses of a body that slows down.

    If friction is proportional to a power of the speed, the intervals v grow by steps proportional to a power of v:
    the square for viscous friction, the cube for dry friction. Times of pulses follow such a law only by chance.
    """
    known = values[np.isfinite(values)]
    if len(known) < 2 * _FEWEST or not (known > 0).all():
        return False
    part = max(len(known) // _PARTS, 1)
    # parts of the record are compared, because the steps between neighbours may be smaller than the noise
    rough = known[::part]
    step = np.diff(rough)
    if not (step > 0).all() or len(step) < _FEWEST:
        return False
    x, y = np.log(0.5 * (rough[1:] + rough[:-1])), np.log(step)
    if np.ptp(x) < _LEAST_CHANGE:
        return False
    power, constant = np.polyfit(x, y, 1)
    rest = y - power * x - constant
    return bool(_POWERS[0] < power < _POWERS[1] and np.var(rest) < (1 - _POWER_LAW_R2) * np.var(y))


def are_exchanged(time: Floats, angle: Floats, turn: float) -> bool:
    """Return whether the angle increases in equal steps, like the times of a sampler, and the time does not.

    Angles of pulses also grow in equal steps, but in integer fractions of a `turn`.
    """
    if not _has_equal_steps(angle) or _has_equal_steps(time) or (np.diff(time) < 0).mean() > _BACKWARD:
        return False
    part = turn / float(np.median(np.diff(angle)))
    return abs(part - round(part)) > _WHOLE or part < 0.5


def _has_equal_steps(values: Floats) -> bool:
    step = np.diff(values)
    if len(step) < _FEWEST:
        return False
    usual = float(np.median(step))
    return usual > 0 and float((np.abs(step - usual) < _EQUAL * usual).mean()) > _EQUAL_STEPS


def wrapping_unit(angle: Floats) -> str:
    """Return the unit in which an angle wraps at a whole turn; "" if there is no such unit."""
    known = angle[np.isfinite(angle)]
    if len(known) < _FEWEST:
        return ""
    span, step = float(np.ptp(known)), np.diff(known)
    jumps = np.flatnonzero(np.abs(step) > 0.5 * span)
    if not len(jumps) or len(jumps) > len(step) / 3:
        return ""
    turns = step[jumps]
    sense = np.sign(np.median(turns))
    others = np.delete(step, jumps)
    # between the jumps, the angle changes in the sense opposite to the jumps
    if (np.sign(turns) != sense).any() or float(others.sum()) * sense >= 0:
        return ""
    beside = np.clip(np.concatenate([jumps - 1, jumps + 1]), 0, len(step) - 1)
    usual = float(np.median(step[np.setdiff1d(beside, jumps)]))
    period = float(np.median(np.abs(turns))) + abs(usual)
    if span > period * (1 + _NEAR):
        return ""
    return next((unit for unit, size in _PERIODS.items() if abs(period / size - 1) < _NEAR), "")


def doubt_of_rad(angle: Floats) -> str:
    """Return the reason why an angle without a unit would be implausible in rad; "" without a reason.

    Pendulums and spiral springs oscillate by less than half a turn to either side, and a sampled body turns by less
    than half a turn between two samples. Most angles in degrees exceed these limits.
    """
    known = angle[np.isfinite(angle)]
    if len(known) < _FEWEST:
        return ""
    step = float(np.median(np.abs(np.diff(known))))
    if step > TURN / 2:
        return f"it would turn by {step / TURN:.3g} turns between two samples"
    middle, span = 0.5 * float(known.max() + known.min()), float(np.ptp(known))
    clear = np.sign(known - middle)[np.abs(known - middle) > _CLEAR * span]
    swings = np.count_nonzero(np.diff(clear)) >= _PASSAGES
    return (
        f"it would oscillate by {0.5 * span / TURN:.3g} turns to either side"
        if swings and span > TURN
        else ""
    )


def wraps_at_no_turn(angle: Floats) -> bool:
    """Return whether an angle repeatedly jumps by its whole range, and otherwise changes in small steps."""
    known = angle[np.isfinite(angle)]
    if len(known) < _FEWEST or not float(np.ptp(known)):
        return False
    step = np.abs(np.diff(known)) / float(np.ptp(known))
    jumps = step > _WHOLE_RANGE
    return _JUMPS <= int(jumps.sum()) <= len(step) / 3 and float(step[~jumps].max()) < _SMALL_STEP


def ratio_of_units(time: Floats, angle: Floats, omega: Floats) -> tuple[float, str]:
    """Return the ratio of the slope of an angle to the speed, both in SI, and the units that would explain the ratio.

    The ratio is nan if the speed does not belong to the angle. The text is empty if both agree or no unit explains the
    ratio.
    """
    known = np.isfinite(time) & np.isfinite(angle) & np.isfinite(omega)
    time, angle, omega = time[known], angle[known], omega[known]
    if len(time) < 4 * _FEWEST or not (np.diff(time) > 0).all():
        return math.nan, ""
    part = max(len(time) // 50, 4)
    edges = np.arange(0, len(time) - part, part)
    slope = (angle[edges + part] - angle[edges]) / (time[edges + part] - time[edges])
    mean = np.array([float(np.mean(omega[k : k + part + 1])) for k in edges])
    size = float(mean @ mean)
    if not size:
        return math.nan, ""
    ratio = float(slope @ mean) / size
    rest = slope - ratio * mean
    if not ratio or float(rest @ rest) > (1 - _LEAST_RATIO_R2) * float(slope @ slope):
        return math.nan, ""
    if abs(abs(ratio) - 1) < _NEAR:
        return ratio, ""
    for factor, text in _RATIOS:
        if abs(abs(ratio) * factor - 1) < _NEAR:
            return ratio, text
    return ratio, ""


def rises(values: Floats, least: float | Floats) -> int:
    """Return the number of rises of a curve by more than `least` above its lowest value since the previous rise.

    A rise ends where the curve has fallen by more than `least` below the highest value.
    """
    limits = np.broadcast_to(least, values.shape)
    count, low, high, rising = 0, math.inf, -math.inf, False
    for value, limit in zip(values.tolist(), limits.tolist(), strict=True):
        if rising:
            high = max(high, value)
            if value < high - limit:
                rising, low = False, value
        else:
            low = min(low, value)
            if value > low + limit:
                count, rising, high = count + 1, True, value
    return count
