"""The clock of a table: rows out of order, restarts of a counter, and steps of the clock.

Rows are sorted only if the result is certain: the file runs backwards, the sorted rows are at equal intervals, or a
small share of the rows is displaced. If the clock was set back during a record, sorting would interleave rows of
different times. Instead, the later times are moved so that the intervals continue. This requires equal intervals before
and after the step, and values on both sides that agree with the correction.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from gyrotrack._errors import DatasetError
from gyrotrack.io._records import Floats, Integers

MIN_SAMPLES = 8
_TICKS = 2**32  # ticks after which the clock of a microcontroller restarts (Arduino `micros`, `millis`)
# ticks after which a 16-bit number restarts, for example `millis` in an `unsigned int` of Arduino
_FEW_TICKS = 2**16
_DAY = 86400.0
# largest relative deviation with which intervals count as equal; smallest share of equal intervals of a sampler
_EQUAL, _SAMPLER = 0.02, 0.9
# smallest interval between sorted rows of a sampler [usual interval]; a smaller interval indicates interleaved records
_HALF = 0.5
_FAR = 20.0  # smallest step back of a restart [usual intervals]; a smaller step back is a clock that was set
# largest share of displaced rows that are sorted although intervals are not equal (one row is always sorted)
_FEW_DISPLACED = 0.01
_BESIDE = 15  # number of rows on each side of a step; their values are extrapolated across the step
# two estimates of a step contradict each other if they differ by more than this value [standard errors]
_CONTRADICTION = 4.0
_SLOWEST = 0.4  # smallest interval of samples for which times without a unit may be milliseconds [s]
_MOST_STEPS = 5  # largest number of gaps that are tested for a clock that was set ahead


class Ordered(NamedTuple):
    """Times without steps of the clock, in the order of the file, and the rows in the order of time."""

    time: Floats
    order: Integers


def ordered(path: Path, time: Floats, line: Integers, value: Floats | None, notes: list[str]) -> Ordered:
    """Return the times of a record and the order of its rows.

    `value` is an unwrapped angle or a speed, which is used to test steps of the clock. Corrections are added to
    `notes`. An uncertain order raises a DatasetError that names the line.
    """
    time = _continued_counter(path, time, line, notes)
    rows = np.arange(len(time))
    step = np.diff(time)
    back = np.flatnonzero(step < 0)
    if not len(back):
        return Ordered(_without_forward_steps(path, time, line, value, notes), rows)
    if (step <= 0).all():
        notes.append(f"{path.name}: the last row is the first in time; the order of the rows was reversed")
        return Ordered(time, rows[::-1])
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    equal = np.abs(step - usual) < _EQUAL * usual
    order = np.argsort(time, kind="stable")
    gaps = np.diff(time[order])
    even = float(np.median(gaps[gaps > 0]))
    sampler = (np.abs(gaps - even) < _EQUAL * even).mean() > _SAMPLER
    first = f"line {line[back[0] + 1]}"
    _refuse_restarts(path, time, line)
    if not (sampler and (gaps > _HALF * even).all()) and equal.mean() > _SAMPLER and _isolated(equal, back):
        return Ordered(_continued(path, time, line, back, usual, value, notes), rows)
    displaced = len(time) - _longest_increasing(time)
    if not sampler and displaced > max(1, _FEW_DISPLACED * len(time)):
        raise DatasetError(
            f"{path}: times are not increasing ({first}), and {displaced} of {len(time)} rows are out of order.",
            f"At most {_FEW_DISPLACED:.0%} of the rows are sorted; check the column of the time.",
        )
    notes.append(
        f"{path.name}: times are not increasing ({first}); {displaced} rows were out of order and were sorted by time"
    )
    return Ordered(time, order)


def _isolated(equal: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], back: Integers) -> bool:
    """Return whether the intervals before and after each step are typical, so that no row is displaced."""
    beside = [k + d for k in back.tolist() for d in (-2, -1, 1, 2) if 0 <= k + d < len(equal)]
    return bool(equal[beside].all())


def _longest_increasing(values: Floats) -> int:
    """Return the length of the longest sequence of rows whose times do not decrease."""
    tails: list[float] = []
    for value in values.tolist():
        place = (
            int(np.searchsorted(tails, value, side="right")) if tails and value < tails[-1] else len(tails)
        )
        tails[place : place + 1] = [value]
    return len(tails)


def _continued(
    path: Path,
    time: Floats,
    line: Integers,
    steps: Integers,
    usual: float,
    value: Floats | None,
    notes: list[str],
) -> Floats:
    """Return times without steps of the clock: each step is replaced by the usual interval."""
    made = time.copy()
    for k in steps.tolist():
        offset = made[k] + usual - made[k + 1]
        moved = made.copy()
        moved[k + 1 :] += offset
        jitter = float(np.std(np.diff(time)[max(k - _BESIDE, 0) : k])) if k > 1 else 0.0
        size = f"the clock steps by {made[k + 1] - made[k] - usual:+.4g} s"
        seen = _delay(moved, value, k)
        if seen is not None and abs(seen[0]) > _CONTRADICTION * seen[1]:
            raise DatasetError(
                f"{path}, line {line[k + 1]}: {size}, and the values on both sides are "
                f"{usual + seen[0]:.3g} +- {seen[1]:.1g} s apart: rows are missing between the two lines.",
                "Give the part before or after this line as a separate file.",
            )
        checked = "" if seen is None else f"; the values confirm it within {seen[1]:.1g} s"
        notes.append(
            f"{path.name}, line {line[k + 1]}: {size}; later times were moved by {offset:.6g} +- "
            f"{max(jitter, 1e-9):.1g} s, because the rows are at equal intervals{checked}"
        )
        made = moved
    return made


def _delay(time: Floats, value: Floats | None, k: int) -> tuple[float, float] | None:
    """Return the delay after row k that the values show beyond the stated interval, and its standard error.

    Two parabolas with a common slope and curvature are fitted to the rows on both sides. The jump between them is the
    delay times the slope. The result is None if the slope is too small to determine the delay.
    """
    near = slice(max(k + 1 - _BESIDE, 0), k + 1 + _BESIDE)
    if value is None or not np.isfinite(value[near]).all() or len(value[near]) < MIN_SAMPLES:
        return None
    x = time[near] - 0.5 * (time[k] + time[k + 1])
    after = (x > 0).astype(float)
    if not 3 <= after.sum() <= len(x) - 3:
        return None
    scale = float(np.abs(x).max())
    design = np.column_stack([np.ones_like(x), x / scale, (x / scale) ** 2, after])
    inverse = np.linalg.pinv(design)
    found = inverse @ value[near]
    rest = value[near] - design @ found
    error = np.sqrt(float(rest @ rest) / max(len(x) - 4, 1) * (inverse**2).sum(axis=1))
    slope, u_slope = found[1] / scale, error[1] / scale
    if abs(slope) < _CONTRADICTION * u_slope:
        return None
    return float(found[3] / slope), float(error[3] / abs(slope))


def _without_forward_steps(
    path: Path, time: Floats, line: Integers, value: Floats | None, notes: list[str]
) -> Floats:
    """Return times without forward steps of the clock. At such a step, the values change as in a single interval."""
    step = np.diff(time)
    usual = float(np.median(step)) if len(step) else 0.0
    equal = np.abs(step - usual) < _EQUAL * usual
    gaps = np.flatnonzero(step > 1.5 * usual)
    if (
        value is None
        or not 0 < len(gaps) <= _MOST_STEPS
        or equal.mean() < _SAMPLER
        or not _isolated(equal, gaps)
    ):
        return time
    made = time.copy()
    for k in gaps.tolist():
        moved = made.copy()
        moved[k + 1 :] += usual - step[k]
        gap, none = _delay(made, value, k), _delay(moved, value, k)
        if gap is None or none is None:
            continue
        if abs(gap[0]) > _CONTRADICTION * gap[1] and abs(none[0]) < 0.5 * _CONTRADICTION * none[1]:
            notes.append(
                f"{path.name}, line {line[k + 1]}: the clock steps by {step[k] - usual:+.4g} s but the "
                f"values continue; later times were moved back by {step[k] - usual:.4g} +- {none[1]:.1g} s"
            )
            made = moved
    return made


def refuse_slow_clock(where: str, column: str, time: Floats) -> None:
    """Raise an error that requests the unit of the time, if no unit is stated and the steps are too long for seconds.

    `where` is the file and line of the header, `column` the name or number of the column.
    """
    step = np.diff(time[np.isfinite(time)])
    usual = float(np.median(np.abs(step))) if len(step) else 0.0
    if usual >= _SLOWEST:
        raise DatasetError(
            f"{where}: the unit of the time in '{column}' is not stated, and its steps of {usual:.4g} would be long "
            "in seconds.",
            f"State the unit: --column 't={column} [s]' or --column 't={column} [ms]'.",
        )


def continued_clock(path: Path, time: Floats, line: Integers, notes: list[str]) -> Floats:
    """Return times without the restarts of a 16-bit or 32-bit counter; any other restart raises a DatasetError."""
    made = _continued_counter(path, time, line, notes)
    _refuse_restarts(path, made, line)
    return made


def _continued_counter(path: Path, time: Floats, line: Integers, notes: list[str]) -> Floats:
    step = np.diff(time)
    back = np.flatnonzero(step < 0)
    if not len(back) or len(time) < 2 * MIN_SAMPLES:
        return time
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    for tick in (1e-6, 1e-3):
        # a new recording would not continue at the usual interval
        if (np.abs(step[back] + _FEW_TICKS * tick - usual) < _EQUAL * usual + 1.5 * tick).all():
            notes.append(
                f"{path.name}: the 16-bit clock restarts at line {line[back[0] + 1]}; times were continued"
            )
            whole = np.where(step < 0, step + _FEW_TICKS * tick, step)
            return np.concatenate([[time[0]], time[0] + np.cumsum(whole)])
    for period in (_TICKS * 1e-6, _TICKS * 1e-3, float(_TICKS), _DAY):
        if (np.abs(step[back] + period) < 0.02 * period).all() and (period != _DAY or time.max() <= _DAY):
            which = "time of day" if period == _DAY else "32-bit clock"
            notes.append(
                f"{path.name}: the {which} restarts at line {line[back[0] + 1]}; times were continued"
            )
            return np.concatenate([[time[0]], time[0] + np.cumsum(np.where(step < 0, step + period, step))])
    return time


def _refuse_restarts(path: Path, time: Floats, line: Integers) -> None:
    """Raise a DatasetError for several recordings in one file."""
    step = np.diff(time)
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    far = np.flatnonzero(-step > _FAR * usual)
    if not len(far) or len(time) < 2 * MIN_SAMPLES:
        return
    lengths = np.diff([0, *(far + 1), len(time)])
    several = len(far) <= 5 and lengths.min() >= MIN_SAMPLES
    # every restart begins again at the first time of the file
    from_first = np.abs(time[far + 1] - time[0]) < 5 * usual
    if several or (from_first.all() and float(np.median(lengths)) >= MIN_SAMPLES):
        what = f"{path}: times are not strictly increasing (line {line[far[0] + 1]}): the clock restarts."
        raise DatasetError(what, f"Split the file at this line: it contains {len(far) + 1} recordings.")
