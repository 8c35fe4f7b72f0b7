"""Angles from pulses: times of events, sampled signals, light gates and counters of revolutions.

A pulse comes from a mark on the body, for example a hole or a stripe. The angle of pulse k is 2 pi k / N for N marks,
corrected for the position errors of the marks. Its uncertainty is omega times the uncertainty of the time. The
uncertainty of the time is the larger of two values: the scatter of the times about local polynomials in k (cubics for
white noise), and q / sqrt(12), where q is the resolution of the clock. The correction for the marks is stored as an
error mode.

If counts were sampled so often that rows repeat the previous count, only the changes of the count are used
(`from_changes`), because equal counts share one error and have no independent noise.

A sampled signal is, for example, the voltage of a photodiode, a Hall sensor or a microphone, or the brightness of a
part of the image. A pulse is a rise of the signal from the lower third to the upper third of its local range. This is a
Schmitt trigger, so noise near the middle causes no pulses. The time of a pulse is the time at which the signal passes
the middle of the range, interpolated linearly.

A pendulum also passes a light gate repeatedly, but its passages are not pulses of a rotation. Either of two properties
shows a pendulum. It passes two gates in the order A, B, B, A. Or its passages become longer relative to the time
between them, because the duration of a passage is inversely proportional to the amplitude.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter, uniform_filter1d

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io._records import ErrorMode, Floats, Integers
from gyrotrack.io.readers._clock import MIN_SAMPLES, continued_clock
from gyrotrack.io.readers._motion_table import (
    Columns,
    MotionTable,
    ReadOptions,
    column_name,
    find_columns,
    interpret,
    scale_of,
    scatter,
    times_of,
)
from gyrotrack.io.readers._plausibility import are_intervals, counts_rows, may_be_intervals, rises
from gyrotrack.io.readers._raw_table import TURN, RawTable, header_of, role_of
from gyrotrack.io.readers._reading import Reading, Taken

# times are from a clocked sampler if 90 % of their intervals deviate from the median by less than this share
_CLOCKED = 0.01
# largest median of the relative change between neighbouring intervals of regular pulses; edges of noise give 0.7
_REGULAR_EDGES = 0.3
_LEVELS = 8  # smallest number of distinct values of a signal; states of a light gate have two
_MOSTLY = 0.8  # no drift is searched for if regular pulses fill at least this share of the record
_MORE = 1.25  # a drift is removed if its removal multiplies the number of pulses by at least this factor
# low and high level are determined in parts of the record; length of a part [long periods: 90th percentile of periods]
_PULSES_PER_PART = 6
_EXTREMES = (2.0, 98.0)  # percentiles of the low and the high level
# smallest amplitude of a signal from a rotating body [typical amplitude]; below it the body is at rest or absent
_PRESENT = 0.25
# smallest number of samples per pulse (in three of four neighbouring intervals); with fewer, pulses are lost
_LEAST_SAMPLES = 4.0
_NEIGHBOURS = 9
_LEAST_PART = 16
_MAX_MISSED = 20
_SMOOTHED = 5  # number of intervals of the running median
_SWING = 0.2  # smallest relative change of the speed between turning points of a driven motion
_MOST_RISES = 1  # a motor at the start of a record may cause one rise of the speed
# `_SHORT_PERIODS` is the quantile that gives the short period of a pendulum. A passage is missing where a period
# exceeds the short period by the factor `_LONGER`. `_MOST_LOST` is the largest permitted share of periods with a
# missing passage.
_SHORT_PERIODS, _LONGER, _MOST_LOST = 0.1, 1.25, 0.3
# speeds before and after a time without pulses count as equal up to this logarithm of their ratio
_SAME_SPEED = 0.3
# words in the name of a counter, beside those of `role_of`
_NAMES_OF_COUNTS = re.compile(r"encoder|ticks?\b|counts?\b|(?<![a-z])(?:enc|pos|position)(?![a-z])")
_MEASURED = {"angle", "omega", "interval", "revolutions"}  # quantities beside which no counter is looked for
# largest sum of the steps of counts, divided by their range; the sum of a signal is twice its range in each period
_LONGEST_PATH = 4.0
_LEAST_SINGLE = 0.5  # at least this share of the times of pulses must be different from each other
_END = 3  # number of intervals at each end of the record that have too few neighbours on one side
_LINE = 4  # number of intervals from which the speed is extrapolated to the ends of the record
_NORMAL = 0.6745  # median of the absolute value of a standard normal variable
# up to this relative scatter of the intervals, a single interval shows a missed or double pulse: such a pulse changes
# the interval by at least about five times the scatter
_REGULAR = 0.13
_SIGNIFICANT_STEP = 3.5  # smallest significant step of the count [standard errors]
_STRETCH = 60  # number of pulses between the knots of the spline through the counts
_PART = 3000  # number of intervals of a part in which steps of the count are found together
_OVERLAP = 300  # number of further intervals before and after such a part
_MAX_MARKS = 512
# marks are unequal if the cube root of chi2 exceeds its expected value by this number of standard deviations
_UNEQUAL_MARKS = 3.0
_MOST_HARMONICS = 32  # largest number of periods per turn in the error mode of the marks
# only the changes of the count are used if more than this share of the equally spaced rows, while the body turns,
# repeats the previous count
_IDLE = 0.05
# the body is at rest on one side of a change if the speed on the other side is at least this multiple of the mean speed
_ONE_SIDED = 1.6
# Where the body reverses, and at both ends of the record, the ends of an interval without counts become samples. The
# condition is that the interval is longer than the neighbouring interval by this factor.
_TURNING = 3.0
# number of rows from which the speed is extrapolated over the next interval; largest unambiguous rotation in this
# interval [turns]
_ROWS_BEFORE, _PART_OF_TURN = 20, 0.4
# the scatter of the angles determines their uncertainty if it exceeds the quantisation error by this factor
_BEYOND_QUANTISATION = 1.3
_MAX_RESTARTS = 3
# the body is a pendulum if it passes two gates in alternating order (A B, B A) in more than this share of passages
_ALTERNATING = 0.9
# the body is a pendulum if ln (duration / time between passages) rises by more than this value from the first to the
# last quarter of the passages
_DURATION_CHANGE = 0.1
_SIGNIFICANT_CHANGE = 5.0  # limit of the same rise in standard errors
_FLICKER = 0.1  # largest duration of a flicker of a light gate [median duration of a passage]
_LARGEST_TICKS = 5e6  # largest step of whole numbers that count as microseconds
# from the first to the second step, whole numbers may be ms of a slow body (samples 0.4 s or more apart) or us of a
# sampler of 1 to 2.5 kHz
_AMBIGUOUS_TICKS = (400.0, 1000.0)
_TICK_UNITS = {1e-6: "us", 1e-3: "ms"}


def is_sampled(time: Floats) -> bool:
    """Return whether times are from a clocked sampler and not from events."""
    step = np.diff(np.sort(time))
    usual = float(np.median(step)) if len(step) else 0.0
    return usual > 0 and float(np.mean(np.abs(step - usual) < _CLOCKED * usual)) > 0.9


def signal_columns(raw: RawTable, time_column: int) -> list[int]:
    """Return the columns that may be a signal: numbers with more than a few distinct values."""
    found = []
    for i in range(len(raw.columns)):
        values = raw.numeric(i) if i != time_column else None
        if values is not None and len(np.unique(values[np.isfinite(values)])) >= _LEVELS:
            found.append(i)
    return found


def is_regular(edges: Floats) -> bool:
    """Return whether pulses are as regular as the pulses of a rotation."""
    step = np.diff(edges)
    return len(step) > 2 and float(np.median(np.abs(np.diff(np.log(step))))) < _REGULAR_EDGES


def rising_edges(time: Floats, signal: Floats, name: str, notes: list[str]) -> tuple[Floats, Integers]:
    """Return the times at which a signal rises through its local middle, and the sample after each, both (pulses,).

    Only the longest stretch with enough samples per pulse is used; elsewhere pulses are lost between samples.

    Raises
    ------
    DatasetError
        No stretch has enough samples per pulse.
    """
    edges, after = _local_edges(time, _without_drift(time, signal))
    if len(edges) < _NEIGHBOURS:
        return edges, after
    step = np.percentile(sliding_window_view(np.diff(after), _NEIGHBOURS - 1), 25, axis=1)
    sampled = np.concatenate([[False], step >= _LEAST_SAMPLES, [False]])
    begin, end = np.flatnonzero(np.diff(sampled.astype(int))).reshape(-1, 2).T
    if not len(begin):
        raise DatasetError(
            f"{name}: the signal has {np.median(step):.2g} samples per pulse, which do not determine the rotation.",
            f"Sample it more than {_LEAST_SAMPLES:g} times per pulse.",
        )
    k = int(np.argmax(end - begin))
    used = slice(int(begin[k]), int(end[k]) + _NEIGHBOURS - 1)
    if used.start or used.stop < len(edges):
        a, b = edges[used][[0, -1]]
        notes.append(
            f"{name}: only {a:.4g} s to {b:.4g} s were used; elsewhere the signal has fewer than "
            f"{_LEAST_SAMPLES:g} samples per pulse"
        )
    return edges[used], after[used]


def _without_drift(time: Floats, signal: Floats) -> Floats:
    """Return a signal minus its running mean if this reveals pulses; otherwise the signal.

    If a drift is larger than the amplitude, local extremes do not show the pulses. The width of the mean is half of the
    record at first and is halved repeatedly. It must contain two typical periods, and the subtraction must yield a
    quarter more pulses.
    """
    edges, after = _local_edges(time, signal)
    best, (most, period) = signal, _regular_pulses(edges, after)
    if (
        most
        and after[-1] - after[0] > _MOSTLY * len(signal)
        and np.diff(after).max() < 2 * _PULSES_PER_PART * period
    ):
        return signal  # pulses throughout
    width = len(signal) // 2
    while width >= _LEAST_PART:
        padded = np.pad(signal, width, mode="reflect", reflect_type="odd")
        changed = signal - uniform_filter1d(padded, width)[width:-width]
        count, period = _regular_pulses(*_local_edges(time, changed))
        if count > _MORE * most and width >= 2 * period:
            best, most = changed, count
        width //= 2
    return best


def _regular_pulses(edges: Floats, after: Integers) -> tuple[int, float]:
    """Return the number of pulses and their typical period in samples; 0 unless they are regular."""
    if len(edges) < _NEIGHBOURS or not is_regular(edges):
        return 0, 0.0
    return len(edges), float(np.median(np.diff(after)))


def _local_edges(time: Floats, signal: Floats) -> tuple[Floats, Integers]:
    """Return the rising edges.

    The range of the signal is determined separately in parts of the record that last about six long periods each.
    """
    part = len(signal)
    while True:
        edges, after = _edges(time, signal, part)
        longest = float(np.percentile(np.diff(after), 90)) if len(after) > 1 else np.inf
        if not (smaller := max(_LEAST_PART, _PULSES_PER_PART * longest)) < 0.9 * part:
            return edges, after
        part = int(smaller)


def _edges(time: Floats, signal: Floats, part: int) -> tuple[Floats, Integers]:
    count = max(1, len(signal) // part)
    bounds = np.linspace(0, len(signal), count + 1).astype(int)
    levels = np.array([np.percentile(signal[a:b], _EXTREMES) for a, b in pairwise(bounds)])
    middle = 0.5 * (bounds[:-1] + bounds[1:])
    low, high = (np.interp(np.arange(len(signal)), middle, levels[:, k]) for k in (0, 1))
    height = high - low
    present = height > _PRESENT * np.median(height)
    relative = np.where(present, (signal - low) / np.where(present, height, 1.0), 0.0)
    state = np.zeros(len(signal), dtype=int)
    state[relative > 2 / 3] = 1
    state[relative < 1 / 3] = -1
    decided = np.flatnonzero(state)
    turn = np.flatnonzero((state[decided][1:] > 0) & (state[decided][:-1] < 0))
    times, after = [], []
    for begin, end in zip(decided[turn], decided[turn + 1], strict=True):
        k = begin + int(np.flatnonzero(relative[begin : end + 1] >= 0.5)[0])
        fraction = (0.5 - relative[k - 1]) / (relative[k] - relative[k - 1])
        times.append(time[k - 1] + fraction * (time[k] - time[k - 1]))
        after.append(k)
    return np.array(times), np.array(after, dtype=int)


def read_pulses(raw: RawTable, options: ReadOptions) -> MotionTable:
    """Return the angle of a body from a column of event times, the state of a light gate, or a sampled signal.

    Events are the changes from 0 to 1 in a column of states, or the rising edges of a signal at equally spaced times.
    In any other table each row is an event.
    """
    per_turn = options.pulses_per_turn or 0.0
    if not per_turn > 0:
        what = "The number of pulses per turn is not positive."
        raise UsageError(what, "Give a positive --pulses-per-turn.")
    notes = list(raw.notes)
    if raw.headed or options.names:
        columns = find_columns(raw, options)
        place = columns.place.get("interval", columns.place.get("t", 0))
        unit, why = (
            columns.unit.get("interval", columns.unit.get("t", "")),
            columns.why.get("t", "the first column"),
        )
        intervals = "interval" in columns.place
        time = times_of(raw, {"t": place}, {"t": unit}, replace(options, start=0.0))
    else:
        place, time, intervals = 0, raw.numbers(0, "t", times=True), False
        scale = clock_scale(raw, np.cumsum(time) if are_intervals(time) else time)
        unit, why = _TICK_UNITS.get(scale, "s"), "the first column"
        if scale != 1.0:
            notes.append(f"{raw.path.name}: times are integers and are assumed to be in {unit}")
        time = time * scale
    line = raw.line
    refuse_passages(raw, options)
    gate = _gate(raw, place, options)
    if not intervals and gate is None and are_intervals(time):
        backward = 100 * np.mean(np.diff(time) < 0)
        intervals, why = True, f"not times: {backward:.0f} % of the values are smaller than the value before"
    if not intervals and not (raw.headed or options.names) and len(raw.names) == 1 and may_be_intervals(time):
        raise DatasetError(
            f"{raw.path}: the column may contain times of pulses or intervals between them.",
            "State which: --column t=1 or --column interval=1.",
        )
    if intervals:
        time = _times_of_intervals(raw, time)
    time = time + options.start
    taken = [
        Taken(column_name(raw, place), "intervals between pulses" if intervals else "time", unit or "s", why)
    ]
    state = raw.numbers(gate, raw.names[gate]) if gate is not None else np.ones(len(time))
    known = np.isfinite(time) & np.isfinite(state)
    time, line, state = continued_clock(raw.path, time[known], line[known], notes), line[known], state[known]
    order = np.argsort(time, kind="stable")
    if (np.diff(order) < 0).any():
        first = int(np.flatnonzero(np.diff(time) < 0)[0]) + 1
        notes.append(
            f"{raw.path.name}: times are not increasing (line {line[first]}); events were sorted by time"
        )
    time, line, state = time[order], line[order], state[order]
    event = "each row"
    if gate is not None:
        rising = np.flatnonzero((state[1:] > 0.5) & (state[:-1] <= 0.5)) + 1
        event = column_name(raw, gate)
        notes.append(f"{raw.path.name}: events are the changes of {event} from 0 to 1")
        time, line = time[rising], line[rising]
    elif not intervals and not raw.headed and counts_rows(raw.numbers(place)):
        raise DatasetError(
            f"{raw.path}: {column_name(raw, place)} numbers the rows and contains no times of pulses.",
            "Give the column of the times: --column t=2.",
        )
    elif is_sampled(time) and (signals := _signals(raw, place, options)):
        rows = np.flatnonzero(known)[order]
        pulses = _pulses_of_signal(raw, signals, time, rows, notes)
        if pulses is not None:
            time, line, event = pulses
    if event == "each row":
        _refuse_unused(raw, options)
        if not intervals:
            _refuse_counter(raw, options)
    pulse = "states of a light gate" if gate is not None else "signal" if event != "each row" else "row"
    taken.append(Taken(event, "pulses", "", f"{per_turn:g} per turn; {pulse}"))
    made = from_events(raw, time, line, per_turn, notes)
    used = {t.column for t in taken}
    left_out = tuple(c for i in range(len(raw.names)) if (c := column_name(raw, i)) not in used)
    return replace(made, reading=Reading(raw.path.name, "", len(raw.line), tuple(taken), left_out))


def _times_of_intervals(raw: RawTable, interval: Floats) -> Floats:
    """Return the times of the pulses after each interval; an interval that is not positive raises a DatasetError."""
    wrong = ~(interval > 0)
    if wrong.any():
        what = f"{raw.path}, line {raw.line[np.argmax(wrong)]}: the interval is missing or not positive."
        raise DatasetError(
            what,
            "After this interval the times are unknown. Give only the rows before it or only the rows after it.",
        )
    return np.cumsum(interval)


def _gate(raw: RawTable, place: int, options: ReadOptions) -> int | None:
    """Return the column with the state of a light gate, if there is one; the option `marker` selects one of several."""
    found = _gates(raw, place)
    named = [
        i
        for i in found
        if options.marker is not None and options.marker.casefold() in raw.names[i].casefold()
    ]
    return next(iter(named or found), None)


def _signals(raw: RawTable, place: int, options: ReadOptions) -> list[int]:
    """Return the columns that may be a sampled signal; the option `marker` selects among them."""
    wanted = (options.marker or "").casefold()
    return [i for i in signal_columns(raw, place) if wanted in raw.names[i].casefold()]


def _pulses_of_signal(
    raw: RawTable, columns: list[int], time: Floats, rows: Integers, notes: list[str]
) -> tuple[Floats, Integers, str] | None:
    """Return times, lines and column of the rising edges of the only signal with regular edges; None without one.

    Raises
    ------
    UsageError, DatasetError
        Several signals have regular edges, or all signals with regular edges have too few samples per pulse.
    """
    found, fault = {}, None
    for column in columns:
        values = raw.numbers(column)[rows]
        there = np.isfinite(values)
        name = raw.names[column] or str(column + 1)
        said: list[str] = []
        try:
            edges, after = rising_edges(time[there], values[there], raw.path.name, said)
        except DatasetError as error:
            fault = error
            continue
        if is_regular(edges):
            said.append(f"{raw.path.name}: pulses are the rising edges of the sampled signal '{name}'")
            found[name] = edges, raw.line[rows][there][after], column_name(raw, column), said
    if len(found) > 1:
        raise UsageError(
            f"{raw.path}: {len(found)} columns contain regular pulses: {', '.join(map(repr, found))}.",
            f"Choose one, for example --marker '{next(iter(found))}'.",
        )
    for edges, line, title, said in found.values():
        notes.extend(said)
        return edges, line, title
    if fault is not None:
        raise fault
    notes.append(f"{raw.path.name}: the times are equally spaced; each row is taken for a pulse")
    return None


def _gates(raw: RawTable, place: int) -> list[int]:
    """Return the columns of states, which are 0 or 1 except for rare errors; `place` is the column of the time."""
    found = []
    for i, column in enumerate(raw.columns):
        words = {str(c).strip() for c in column if str(c).strip()} if i != place else set()
        whole = words - {"0", "1", "0.0", "1.0"}
        if {"0", "1"} <= {w[0] for w in words - whole} and sum(
            str(c).strip() in whole for c in column
        ) < 0.02 * len(raw.line):
            found.append(i)
    return found


@dataclass(frozen=True)
class Passages:
    """Passages of a pendulum through one or two light gates near its equilibrium."""

    path: Path
    time: Floats  # middle of each passage [s]
    duration: Floats  # time for which the gates are interrupted [s], inversely proportional to the speed
    notes: tuple[str, ...]  # repairs made while reading


def passages_of(raw: RawTable, options: ReadOptions) -> Passages | None:
    """Return the passages of a pendulum through light gates; None for another table, or a rotation."""
    if not raw.headed:
        return None
    columns = find_columns(raw, options)
    if "t" not in columns.place or {"angle", "omega"} & set(columns.place):
        return None
    gates = _gates(raw, columns.place["t"])[:2]
    if not gates:
        return None
    notes: list[str] = []
    time = times_of(raw, columns.place, columns.unit, options)
    blocked = [_blocked(time, raw.numbers(g, raw.names[g]), raw, notes) for g in gates]
    if min(len(b) for b in blocked) < MIN_SAMPLES:
        return None
    if len(blocked) == 1:
        begin, end = blocked[0].T
        if not _slows_down(*blocked):
            return None
        _refuse_lost_passages(raw, 0.5 * (begin + end))
        return Passages(raw.path, 0.5 * (begin + end), end - begin, (*raw.notes, *notes))
    both = np.concatenate([np.column_stack([b, np.full(len(b), k)]) for k, b in enumerate(blocked)])
    both = both[np.argsort(both[:, 0] + both[:, 1])]
    # the two gates are interrupted in one passage if the interruptions are closer to each other than to the next
    # passage
    step, order = np.diff(0.5 * (both[:, 0] + both[:, 1])), np.diff(both[:, 2])
    first = np.flatnonzero((order != 0) & (step < 0.5 * np.append(step[1:], np.inf)))
    if len(first) < MIN_SAMPLES:
        return None
    alternates = (order[first][1:] * order[first][:-1] < 0).mean() > _ALTERNATING
    if not alternates and not all(_slows_down(b) for b in blocked):
        return None
    begin, end = (both[first, k] + both[first + 1, k] for k in (0, 1))
    _refuse_lost_passages(raw, 0.25 * (begin + end))
    return Passages(raw.path, 0.25 * (begin + end), end - begin, (*raw.notes, *notes))


def _refuse_lost_passages(raw: RawTable, time: Floats) -> None:
    """Refuse passages if more than `_MOST_LOST` of the periods exceed the short period by a quarter.

    Passages are then missing.
    """
    pair = time[2:] - time[:-2]
    usual = float(np.quantile(pair, _SHORT_PERIODS))
    longer = float((pair > _LONGER * usual).mean())
    if longer > _MOST_LOST:
        raise DatasetError(
            f"{raw.path}: {100 * longer:.0f} % of the periods exceed the short period, {usual:.4g} s, by more than a "
            "quarter: passages are missing.",
            "Give a recording with all passages.",
        )


def refuse_passages(raw: RawTable, options: ReadOptions) -> None:
    """Raise a UsageError for a table of a pendulum that passes light gates, because passages contain no angles."""
    if passages_of(raw, options) is not None:
        raise UsageError(
            f"{raw.path}: a pendulum passes the light gates (back and forth); its passages contain no angles.",
            "Run `gyrotrack spindown` without --pulses-per-turn: it measures period and decay.",
        )


def _slows_down(blocked: Floats) -> bool:
    """Return whether the passages of a gate become longer relative to the time between them."""
    middle, duration = 0.5 * blocked.sum(axis=1), np.diff(blocked, axis=1)[:, 0]
    share = np.log(duration[1:-1] / (middle[2:] - middle[:-2]))
    part = len(share) // 4
    if part < 2:
        return False
    early, late = share[:part], share[-part:]
    error = 1.5 * np.median(np.abs(share - np.median(share))) / np.sqrt(part)
    return bool(np.median(late) - np.median(early) > max(_DURATION_CHANGE, _SIGNIFICANT_CHANGE * error))


def _blocked(time: Floats, state: Floats, raw: RawTable, notes: list[str]) -> Floats:
    """Return the intervals in which a gate is interrupted, (intervals, 2); flicker at their ends is removed."""
    known = np.isfinite(time) & np.isfinite(state)
    time = continued_clock(raw.path, time[known], raw.line[known], notes)
    order = np.argsort(time, kind="stable")
    time, inside = time[order], state[known][order] > 0.5
    change = np.flatnonzero(np.diff(inside.astype(int))) + 1
    if len(change) and not inside[change[0]]:
        change = change[1:]
    change = change[: len(change) // 2 * 2]
    found = time[change].reshape(-1, 2)
    if len(found) < MIN_SAMPLES:
        return found
    usual = float(np.median(found[:, 1] - found[:, 0]))
    apart = np.append(True, found[1:, 0] - found[:-1, 1] > _FLICKER * usual)
    group = np.flatnonzero(apart)
    merged = np.column_stack([found[group, 0], np.append(found[group[1:] - 1, 1], found[-1, 1])])
    kept = merged[:, 1] - merged[:, 0] > _FLICKER * usual
    if lost := len(found) - int(kept.sum()):
        notes.append(f"{raw.path.name}: {lost} flickers of a light gate were removed")
    return np.asarray(merged[kept])


def from_events(
    raw: RawTable, time: Floats, line: Integers, per_turn: float, notes: list[str]
) -> MotionTable:
    """Return the angle of a body at its pulses, with missed pulses added and double pulses excluded."""
    if len(time) < MIN_SAMPLES:
        what = f"{raw.path} has {len(time)} pulses; at least {MIN_SAMPLES} are needed."
        raise DatasetError(what, "Give a longer recording.")
    distinct = np.append(True, np.diff(time) > 0)
    if distinct.mean() < _LEAST_SINGLE:
        what = f"{raw.path}: {int((~distinct).sum())} of {len(time)} times of pulses are repeated."
        raise DatasetError(what, "Check the column and the decimal sign, or give the times with more digits.")
    driven = varies_both_ways(time[distinct])
    steps = None if driven else _steps_of_jittering_counts(time[distinct])
    if not driven:
        distinct[distinct] = _not_double(time[distinct]) if steps is None else steps >= 0
    doubles = int((~distinct).sum())
    if doubles:
        notes.append(
            f"{raw.path.name}: {doubles} double pulses were excluded (first: line {line[~distinct][0]})"
        )
    time, line = time[distinct], line[distinct]
    if len(time) < MIN_SAMPLES:
        what = f"{raw.path} has {len(time)} pulses at different times; at least {MIN_SAMPLES} are needed."
        raise DatasetError(what, "Check the column of the times.")
    count = np.arange(len(time), dtype=float)
    if driven:
        notes.append(
            f"{raw.path.name}: the speed rises and falls repeatedly; missed and double pulses are not looked for"
        )
    elif steps is None:
        count = _with_missed_pulses(raw, time, count, line, notes)
    elif (missed := np.maximum(steps[steps >= 0], 0)).any():
        count = count + np.cumsum(missed)
        notes.append(
            f"{raw.path.name}: {int(missed.sum())} missed pulses were added "
            f"(first: before line {line[np.argmax(missed > 0)]})"
        )
    return from_counts(raw, time, count, line, per_turn, notes)


def varies_both_ways(time: Floats) -> bool:
    """Return whether the speed of pulses rises and falls repeatedly, which shows a drive.

    A running median removes single intervals with missed or double pulses. Only a change of the result that exceeds
    both `_SWING` of the speed and the scatter of the median counts as a rise or fall.
    """
    interval = np.diff(time)
    if len(interval) < 3 * _SMOOTHED:
        return False
    logs = -np.log(interval)
    smooth = median_filter(logs, _SMOOTHED, mode="nearest")
    # the median of n normal values with standard deviation s has an error of 1.25 s / sqrt(n); the range of m medians
    # is 2 sqrt(2 ln m) times this error
    error = 1.25 * 1.483 * float(np.median(np.abs(logs - smooth))) / np.sqrt(_SMOOTHED)
    least = max(_SWING, error * (2 * np.sqrt(2 * np.log(len(logs))) + 1))
    return rises(smooth, least) >= _MOST_RISES + 1


def _with_missed_pulses(
    raw: RawTable, time: Floats, count: Floats, line: Integers, notes: list[str]
) -> Floats:
    """Add missed pulses to counts where an interval is a multiple of the neighbouring intervals."""
    step = np.diff(time) / np.diff(count)
    ratio = step / _typical_interval(step)
    ratio[-_END:] = _ratios_at_end(step)[-_END:]
    ratio[:_END] = _ratios_at_end(step[::-1])[::-1][:_END]
    whole = np.round(ratio)
    _refuse_gap(raw, step, ratio, np.diff(count), line)
    missed = (whole >= 2) & (whole <= _MAX_MISSED) & (np.abs(ratio - whole) < 0.12 * whole)
    if not missed.any():
        return count
    added = np.where(missed, (whole - 1) * np.diff(count), 0.0)
    notes.append(
        f"{raw.path.name}: {int(added.sum())} missed pulses were added "
        f"(first: before line {line[np.argmax(missed) + 1]})"
    )
    return np.asarray(count + np.concatenate([[0.0], np.cumsum(added)]))


def _refuse_gap(raw: RawTable, step: Floats, ratio: Floats, counted: Floats, line: Integers) -> None:
    """Refuse a long time without pulses if the speed is the same before and after: the body was not at rest."""
    inner = np.arange(_END, len(step) - _END)
    if not len(inner):
        return
    before, after = step[inner - 1], step[inner + 1]
    same = np.abs(np.log(before / after)) < _SAME_SPEED
    gaps = inner[same & (ratio[inner] > _MAX_MISSED) & (counted[inner] == 1)]
    if len(gaps):
        k = int(gaps[0])
        raise DatasetError(
            f"{raw.path}, line {line[k + 1]}: {step[k]:.4g} s pass without a pulse, and the speed is the same before "
            "and after: the clock was set, or pulses are lost.",
            "Give the part before or after this line as a separate file.",
        )


def _steps_of_jittering_counts(time: Floats) -> Integers | None:
    """Return the number of pulses missed before each pulse, -1 for a double pulse; None if single intervals suffice.

    If the times scatter by a large share of an interval, a single interval does not show whether a pulse is missed.
    However, after a missed pulse all later counts are too small by one. The counts are described by a cubic spline in
    time, plus steps of whole numbers at irregular intervals. Steps are added or removed one at a time, until no further
    step larger than a half remains.
    """
    interval = np.diff(time)
    if len(interval) < _STRETCH:
        return None
    ratio = interval / _typical_interval(interval)
    spread = float(np.median(np.abs(ratio - np.median(ratio)))) / _NORMAL
    if spread < _REGULAR:
        return None
    steps = np.zeros(len(time), dtype=np.int64)
    # time and memory for a part increase with the square of its length; steps at its ends are uncertain
    for first in range(0, len(interval), _PART):
        begin, end = max(first - _OVERLAP, 0), min(first + _PART + _OVERLAP, len(interval))
        found = _steps_of_part(time[begin : end + 1], ratio[begin:end], spread)[first - begin :][:_PART]
        steps[first + 1 :][: len(found)] = found
    return steps


def _steps_of_part(time: Floats, ratio: Floats, spread: float) -> Integers:
    """Return the steps at all pulses except the first, from the ratios of intervals to local typical values."""
    count, steps = np.arange(len(time), dtype=float), np.zeros(len(time), dtype=np.int64)
    x = np.linspace(0, 1, len(time))
    knots = np.arange(1, max(1, len(time) // _STRETCH)) * _STRETCH / len(time)
    t = 2 * (time - time[0]) / (time[-1] - time[0]) - 1
    smooth = np.polynomial.legendre.legvander(t, 3)
    bends = [np.maximum(t - np.interp(k, x, t), 0.0) ** 3 for k in knots]
    basis = np.linalg.qr(np.column_stack([smooth, *bends]))[0]
    places = 1 + np.flatnonzero((ratio > 1.4) | (ratio < 0.6))
    columns = (np.arange(len(time))[:, None] >= places).astype(float)
    columns -= basis @ (basis.T @ columns)
    size = np.sum(columns**2, axis=0)
    at = ratio[places - 1]
    # a short interval ends at a double pulse; a long interval contains at most as many missed pulses as its length
    # allows
    lowest = np.where(at < 1, -1, 0)
    highest = np.where(at < 1, 0, np.clip(np.round(at - 1 + 2 * spread), 0, _MAX_MISSED))
    for _ in range(4 * len(places)):
        step = -(columns.T @ (count - basis @ (basis.T @ count))) / size
        change = np.clip(np.sign(step), lowest - steps[places], highest - steps[places])
        gain = np.abs(step) * np.sqrt(size) / (spread / np.sqrt(2)) * ((change != 0) & (np.abs(step) > 0.5))
        best = int(np.argmax(gain))
        if gain[best] < _SIGNIFICANT_STEP:
            break
        steps[places[best]] += int(change[best])
        count[places[best] :] += change[best]
    return steps[1:]


def _typical_interval(step: Floats) -> Floats:
    """Return the local typical interval: geometric mean of two medians, of three earlier and three later intervals."""
    if len(step) < 3:
        return np.full(len(step), np.median(step) if len(step) else np.nan)
    logs = np.log(np.maximum(step, 1e-300))
    width = len(step)
    padded = np.concatenate([np.full(3, logs[min(2, width - 1)]), logs, np.full(3, logs[max(width - 3, 0)])])
    sides = [np.median([padded[i : i + width] for i in range(first, first + 3)], axis=0) for first in (0, 4)]
    return np.asarray(np.exp(np.mean(sides, axis=0)))


def _ratios_at_end(step: Floats) -> Floats:
    """Return the ratios of intervals to the intervals expected from the previous speed.

    The ratios are computed for the last `_END` intervals only; the others are 1.

    At the end of a motion the next intervals are unknown: an interval of twice the length shows a missed pulse, or a
    body that comes to rest. A straight line in time is fitted to the speeds of the previous intervals: at the time s
    after the middle of the last interval T0, the speed is v - a s. The middle of the next interval T is at s = (T0 + T)
    / 2. T is therefore the solution of T (v - a (T0 + T) / 2) = 1.
    """
    regular, ratio = step.copy(), np.ones(len(step))
    for k in range(max(len(step) - _END, _LINE), len(step)):
        before = regular[k - _LINE : k]
        middle = np.cumsum(before) - before / 2
        rate, speed = np.polyfit(middle - middle[-1], 1 / before, 1)
        b = speed + rate * before[-1] / 2
        discriminant = b * b + 2 * rate
        if b <= 0 or discriminant <= 0:
            break  # the body comes to rest within the interval
        expected = 2 / (b + np.sqrt(discriminant))
        ratio[k] = step[k] / expected
        regular[k] = step[k] / max(np.round(ratio[k]), 1.0)
    return ratio


def _not_double(time: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return a mask of the pulses to keep.

    Of two pulses closer than 0.35 typical intervals, the more regular pulse is kept.

    The other pulse is removed, and its two intervals are merged. The merged interval is one typical interval if the
    pulse was double. It is two typical intervals if the pulse was displaced by more than half an interval; the pulse
    then counts as missed.
    """
    keep = np.ones(len(time), dtype=bool)
    for _ in range(20):
        index = np.flatnonzero(keep)
        step = np.diff(time[index])
        usual = _typical_interval(step)
        last, dropped = -3, False
        for k in np.flatnonzero(step < 0.35 * usual).tolist():
            before = step[k - 1] if k else np.inf
            after = step[k + 1] if k + 1 < len(step) else np.inf
            if k <= last + 2 or min(before, after) + step[k] > 1.6 * usual[k]:
                # no pulse is excluded here: a neighbouring pulse was excluded already, or only the time of the pulse
                # jitters
                continue
            later = _irregularity((after + step[k]) / usual[k]) < _irregularity((before + step[k]) / usual[k])
            keep[index[k + 1 if later else k]] = False
            last, dropped = k, True
        if not dropped:
            break
    return keep


def _irregularity(ratio: float) -> float:
    """Return the deviation of an interval from a whole number n of typical intervals, |ln(ratio / n)|."""
    return abs(float(np.log(ratio / max(np.round(ratio), 1.0)))) if np.isfinite(ratio) else np.inf


def from_counts(
    raw: RawTable, time: Floats, count: Floats, line: Integers, per_turn: float, notes: list[str]
) -> MotionTable:
    """Return the angle at times with known counts; its uncertainty follows from the uncertainty of the times."""
    errors, modes = mark_errors(time, count, per_turn, raw, notes)
    angle = TURN * (count - errors) / per_turn
    clock = _clock_resolution(time)
    timing = np.maximum(scatter(angle * per_turn / TURN, time, 1e-9), clock / np.sqrt(12))
    slope = np.abs(np.gradient(angle, time)) if len(time) > 1 else np.zeros(len(time))
    sigma = np.maximum(slope * timing, 1e-6)
    notes.append(
        f"{raw.path.name}: {len(time)} pulses, {per_turn:g} per turn; uncertainty of their times "
        f"{1e6 * np.median(timing):.3g} us (median), resolution of the clock {1e6 * clock:.3g} us"
    )
    return MotionTable(
        raw.path, raw.sha256, "angle", time, angle, sigma, line, tuple(notes), counted=True, modes=modes
    )


def mark_errors(
    time: Floats, count: Floats, per_turn: float, raw: RawTable, notes: list[str]
) -> tuple[Floats, tuple[ErrorMode, ...]]:
    """Return the position error of the mark of each pulse, in pulses, and the errors that remain, as error modes.

    A cubic spline connects the times of mark 0. The error of a mark is the median of its deviation from this spline
    over all turns, after subtraction of the mean deviation of each turn. The errors are subtracted if the marks differ
    significantly. An unbalance or another torque that depends on the angle displaces the pulses in the same way. The
    size of the subtracted errors is therefore kept as an uncertainty.
    """
    marks = round(per_turn)
    none: tuple[Floats, tuple[ErrorMode, ...]] = np.zeros(len(time)), ()
    if marks != per_turn or not 2 <= marks <= _MAX_MARKS:
        return none
    kind = np.round(count).astype(int) % marks
    zero = np.flatnonzero(kind == 0)
    if len(zero) < 9 or (np.bincount(kind, minlength=marks) < 8).any():
        return none
    inside = np.arange(zero[0], zero[-1])
    off = count[inside] - CubicSpline(time[zero], count[zero])(time[inside])
    number = np.bincount(kind[inside], minlength=marks)
    of_mark = np.split(np.argsort(kind[inside], kind="stable"), np.cumsum(number)[:-1])
    # an error of the times of mark 0 displaces all marks of a turn by about the same amount, so the mean is subtracted
    apart = off.copy()
    for pulses in of_mark:
        apart[pulses] -= np.median(off[pulses])
    turn = np.unique(np.round(count[inside]) // marks, return_inverse=True)[1]
    off -= (np.bincount(turn, apart) / np.bincount(turn))[turn]
    errors = np.array([np.median(off[pulses]) for pulses in of_mark])
    errors -= errors.mean()
    # the variance of the median of n normal values is pi / 2n times the variance of a value; the mean of Student's t^2
    # is (n - 1) / (n - 3)
    u2 = np.pi / 2 / number * np.array([np.var(off[pulses], ddof=1) for pulses in of_mark])
    t2 = errors**2 / np.maximum(u2, 1e-24) * (number - 3) / (number - 1)
    # errors of marks with mean zero have (number of marks - 1) degrees of freedom, and the cube root of chi2 / dof is
    # nearly normal (E. B. Wilson and M. M. Hilferty, PNAS 17, 1931)
    variance = 2 / (9 * (marks - 1))
    if np.cbrt(t2.mean()) < 1 - variance + _UNEQUAL_MARKS * np.sqrt(variance):
        return none
    notes.append(
        f"{raw.path.name}: position errors of the {marks} marks were corrected "
        f"({1e3 * TURN / per_turn * float(np.sqrt(np.mean(errors**2))):.3g} mrad rms)"
    )
    return np.asarray(errors[kind]), (_mark_mode(errors * TURN / per_turn, kind),)


def _mark_mode(errors: Floats, kind: Integers) -> ErrorMode:
    """Return the error mode of marks with these errors [rad]: harmonics of the angle, repeated in each turn.

    The variance of a harmonic follows from the errors, and is at least the variance for independent errors of marks.
    """
    marks = len(errors)
    harmonics = np.arange(1, min(marks // 2, _MOST_HARMONICS) + 1)
    phase = TURN / marks * np.outer(np.arange(marks), harmonics)
    alternating = 2 * harmonics == marks
    variance = np.maximum(
        np.abs(np.fft.rfft(errors)[harmonics]) ** 2 * 2 / marks**2, 2 * np.mean(errors**2) / marks
    )
    variance[alternating] /= 2
    basis = np.concatenate([np.cos(phase), np.sin(phase)[:, ~alternating]], axis=1)
    return ErrorMode(
        "marks",
        basis[kind],
        np.diag(np.concatenate([variance, variance[~alternating]])),
        origin="repeatable with angle",
        long_name="position errors of the marks of a wheel, repeated in each turn",
    )


def _clock_resolution(time: Floats) -> float:
    """Return the resolution of a clock [s]: the greatest common divisor of the times in ms or us; 0 if it is finer."""
    for unit in (1e-3, 1e-6):
        ticks = np.round(time / unit)
        if (np.abs(time / unit - ticks) < 1e-3).all():
            return float(np.gcd.reduce(np.abs(np.diff(ticks)).astype(np.int64))) * unit
    return 0.0


def read_counter(
    raw: RawTable,
    column: int,
    options: ReadOptions,
    time_column: int = 0,
    unit: str = "",
    *,
    why: str = "whole numbers in steps of 1",
) -> MotionTable:
    """Return the angle of a body from a counter of its revolutions (or pulses), at the times of its steps.

    Some loggers write the count one row late. Of the two interpretations, the one with the more regular intervals is
    used.
    """
    notes = list(raw.notes)
    ticks = raw.numbers(time_column, "t", times=True)
    count = raw.numbers(column, "revolutions")
    known = np.isfinite(ticks) & np.isfinite(count)
    ticks, count, line = ticks[known], count[known], raw.line[known]
    scale = scale_of(raw, "t", unit)
    if not unit and not raw.headed:
        scale = clock_scale(raw, ticks)
        if scale != 1.0:
            notes.append(f"{raw.path.name}: times are integers and are assumed to be in {_TICK_UNITS[scale]}")
    time = continued_clock(raw.path, ticks * scale, line, notes) + options.start
    order = np.argsort(time, kind="stable")
    if (np.diff(order) < 0).any():
        back = int(np.flatnonzero(np.diff(time) < 0)[0]) + 1
        notes.append(
            f"{raw.path.name}: times are not increasing (line {line[back]}); rows were sorted by time"
        )
    time, count, line = time[order], count[order], line[order]
    unique = np.concatenate([[True], np.diff(time) > 0])
    if not unique.all():
        notes.append(f"{raw.path.name}: {int((~unique).sum())} repeated rows were excluded")
    time, count, line = time[unique], count[unique], line[unique]
    step = np.diff(count)
    resets = step < 0
    if resets.any():
        notes.append(
            f"{raw.path.name}: the counter restarts at line {line[np.argmax(resets) + 1]}; the count was continued"
        )
        step = np.where(resets, 1.0, step)
    at = np.flatnonzero(step > 0) + 1
    restarts, odd = int(resets.sum()), float(((step < 0) | (step > _MAX_MISSED)).mean())
    if restarts > _MAX_RESTARTS or odd > 0.02 or (~unique).mean() > 0.2:
        raise DatasetError(
            f"{raw.path}: column {column + 1} does not count up at the times in column {time_column + 1}.",
            "For an encoder that restarts at each turn give its counts per turn, --pulses-per-turn N; else choose the "
            "columns by --column revolutions=N and --column t=N.",
        )
    if len(at) < MIN_SAMPLES:
        what = f"{raw.path}: the counter has {len(at)} steps; at least {MIN_SAMPLES} are needed."
        raise DatasetError(what, "Check the column.")
    if counts_coarsely(time, np.cumsum(step)):
        total = np.concatenate([[0.0], np.cumsum(step)])
        made = from_changes(raw, time, total, line, options.pulses_per_turn or 1.0, notes)
        return replace(made, reading=_reading_of_counter(raw, time_column, column, unit, scale, why, options))
    total = np.cumsum(step)[at - 1]
    choices = [(0, at), (1, at - 1)]
    rough = [_roughness(time[rows], total) for _, rows in choices]
    late = rough[1] < 0.7 * rough[0]
    if late:
        notes.append(
            f"{raw.path.name}: the counter is written one row late: with the times of the previous rows its "
            f"intervals are {rough[0] / max(rough[1], 1e-12):.0f} times more regular"
        )
    rows = choices[int(late)][1]
    time, total, line = _without_false_pulses(time[rows], total, line[rows], notes, raw)
    total = _with_missed_pulses(raw, time, total, line, notes)
    made = from_counts(raw, time, total, line, options.pulses_per_turn or 1.0, notes)
    return replace(made, reading=_reading_of_counter(raw, time_column, column, unit, scale, why, options))


def _reading_of_counter(
    raw: RawTable, time_column: int, column: int, unit: str, scale: float, why: str, options: ReadOptions
) -> Reading:
    """Return the meaning of the columns of a counter; `scale` is the factor of its times to seconds."""
    by = "the first column" if not raw.headed else "by its name"
    taken = (
        Taken(column_name(raw, time_column), "time", unit or _TICK_UNITS.get(scale, "s"), by),
        Taken(column_name(raw, column), "count", "", f"{why}; {options.pulses_per_turn or 1:g} per turn"),
    )
    others = tuple(column_name(raw, i) for i in range(len(raw.names)) if i not in {time_column, column})
    return Reading(raw.path.name, "", len(raw.line), taken, others)


def counts_coarsely(time: Floats, count: Floats) -> bool:
    """Return whether a counter was sampled at equal intervals, some of which have no new count.

    Rows before the first change, after the last change, and in other long intervals without counts are ignored, because
    the body may be at rest there.
    """
    rows = np.diff(np.flatnonzero(np.diff(count)))
    if not len(rows) or not is_sampled(time):
        return False
    moving = rows[rows <= _MAX_MISSED * np.median(rows)]
    return 1 - len(moving) / float(moving.sum()) > _IDLE


def from_changes(
    raw: RawTable, time: Floats, count: Floats, line: Integers, per_turn: float, notes: list[str]
) -> MotionTable:
    """Return the angle of a body at the changes of its counts, which were sampled at equal intervals.

    Rows with the same count share one error of up to a step of the angle, so only the first of these rows contains
    information. Let r be the number of steps between two rows. If r < 1, the boundary between two counts is assumed to
    be passed midway between the rows, with an uncertainty of r / sqrt(12) steps. If r > 1, or if the body passes
    several boundaries (for example, where rows are missing), the angle in each row is the middle of its count, with an
    uncertainty of 1 / sqrt(12) steps. If the body reverses or rests, the angle at both ends of the interval without
    counts is the middle of the count.
    """
    at = np.flatnonzero(np.diff(count)) + 1
    if len(at) < MIN_SAMPLES:
        what = f"{raw.path}: the counter has {len(at)} steps; at least {MIN_SAMPLES} are needed."
        raise DatasetError(what, "Check the column.")
    rate = _turned_within(time, count, at)
    slow = (rate < 1) & (np.abs(count[at] - count[at - 1]) <= 1)
    when = np.where(slow, 0.5 * (time[at] + time[at - 1]), time[at])
    where = np.where(slow, 0.5 * (count[at] + count[at - 1] + 1), count[at] + 0.5)
    step = np.where(slow, rate, 1.0)
    idle = np.diff(np.concatenate([[0], at, [len(time)]]))
    sense = np.sign(count[at] - count[at - 1])
    turns = np.concatenate([[True], np.diff(sense) != 0, [True]])
    beside = np.maximum(np.append(idle[1], idle[:-1]), 1)
    rests = np.flatnonzero(turns & (idle > _TURNING * beside) | (idle > _MAX_MISSED * beside))
    # the ends of intervals without counts, half a row away from the changes
    begin, end = np.concatenate([[0], at])[rests], np.concatenate([at, [len(time)]])[rests] - 1
    ends = np.unique(np.concatenate([begin, end]))
    rows = np.concatenate([at, ends])
    when = np.concatenate([when, time[ends]])
    where, step = np.concatenate([where, count[ends] + 0.5]), np.concatenate([step, np.ones(len(ends))])
    order = np.argsort(when, kind="stable")
    unique = np.append(True, np.diff(when[order]) > 0)
    rows, when, where, step = (a[order][unique] for a in (rows, when, where, step))
    angle, quantised = TURN / per_turn * where, TURN / per_turn / np.sqrt(12) * step
    spread = scatter(when, angle, 1e-9)
    noisy = float(np.median(spread / quantised)) > _BEYOND_QUANTISATION
    sigma = np.maximum(spread, quantised) if noisy else quantised
    notes.append(
        f"{raw.path.name}: there are several rows for each count; only the {len(at)} changes of the count give an "
        f"angle. The uncertainty is {1e3 * float(np.median(sigma)):.3g} mrad (median). The error is at most half a "
        "step of the count or the motion in half a row interval"
    )
    return MotionTable(
        raw.path, raw.sha256, "angle", when, angle, sigma, line[rows], tuple(notes), counted=True
    )


def _turned_within(time: Floats, count: Floats, at: Integers) -> Floats:
    """Return the number of counts by which a body turns between the rows before and after each change, (changes,).

    The speed is the mean speed from two changes before to two changes after. Next to a rest, only the side in motion
    counts.
    """
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(count)))])[at]
    here = np.arange(len(at))
    first, last = np.maximum(here - 2, 0), np.minimum(here + 2, len(at) - 1)

    def speed(begin: Integers, end: Integers) -> Floats:
        return np.asarray((turned[end] - turned[begin]) / np.maximum(time[at[end]] - time[at[begin]], 1e-300))

    both, faster = speed(first, last), np.maximum(speed(first, here), speed(here, last))
    # at a constant speed, the ratio of the faster side to both sides is below `_ONE_SIDED`
    rate = np.where(faster > _ONE_SIDED * both, faster, both)
    return np.asarray(rate * (time[at] - time[at - 1]))


def _without_false_pulses(
    time: Floats, total: Floats, line: Integers, notes: list[str], raw: RawTable
) -> tuple[Floats, Floats, Integers]:
    """Exclude false pulses, which are too early for the local speed."""
    keep = _not_double(time)
    false = int((~keep).sum())
    if not false:
        return time, total, line
    notes.append(f"{raw.path.name}: {false} false pulses were excluded (first: line {line[~keep][0]})")
    extra = np.concatenate([[0.0], np.diff(total)])
    shift = np.cumsum(np.where(keep, 0.0, extra))
    return time[keep], (total - shift)[keep], line[keep]


def _roughness(time: Floats, count: Floats) -> float:
    step = np.diff(time)
    change = np.abs(np.diff(np.log(np.maximum(step, 1e-12) / np.diff(count))))
    return float(np.mean(np.minimum(change, 1.0)))


def clock_scale(raw: RawTable, ticks: Floats) -> float:
    """Return the factor from integer times to seconds: us for steps of at least 1000, ms for steps of 11 to 399.

    Steps between these ranges, and steps of more than five seconds in us, are ambiguous: a DatasetError requests the
    unit.
    """
    known = ticks[np.isfinite(ticks)]
    if not len(known) or (known != np.round(known)).any():
        return 1.0
    typical = float(np.median(np.abs(np.diff(known)))) if len(known) > 1 else 0.0
    if typical > _LARGEST_TICKS or _AMBIGUOUS_TICKS[0] <= typical < _AMBIGUOUS_TICKS[1]:
        what = f"{raw.path}: the times are whole numbers in steps of {typical:.4g}, and their unit is not stated."
        other = "ns" if typical > _LARGEST_TICKS else "ms"
        raise DatasetError(what, f"State it, for example --column 't=1 [us]' or --column 't=1 [{other}]'.")
    return 1e-6 if typical >= 1000 else 1e-3 if typical > 10 else 1.0


# units of a column of counts
_UNITS_OF_COUNTS = {"", "1", "count", "counts", "cnt", "tick", "ticks", "pulse", "pulses", "step", "steps"}


def with_counts(raw: RawTable, options: ReadOptions) -> ReadOptions:
    """Return options in which a column of counts that the user names as the angle is a counter.

    With `--pulses-per-turn`, whole numbers without a unit of angle are counts.
    """
    columns = find_columns(raw, options)
    place = columns.place.get("angle")
    if place is None or columns.why["angle"] != "by --column":
        return options
    values = raw.numeric(place)
    known = np.zeros(0) if values is None else values[np.isfinite(values)]
    states = set(np.unique(known)) <= {0.0, 1.0}
    if states or (known != np.round(known)).any() or columns.unit["angle"].casefold() not in _UNITS_OF_COUNTS:
        return options
    names = {k: ("revolutions", "") if v[0] == "angle" else v for k, v in (options.names or {}).items()}
    return replace(options, names=names)


def _refuse_unused(raw: RawTable, options: ReadOptions) -> None:
    """Raise a UsageError if the user names a column of angles or speeds in a table whose rows are pulses."""
    columns = find_columns(raw, options)
    for role in ("angle", "omega"):
        if columns.why.get(role) == "by --column":
            name = column_name(raw, columns.place[role])
            raise UsageError(
                f"{raw.path}: {name} is given as {role}, but with --pulses-per-turn each row would be a pulse.",
                "Omit --pulses-per-turn, or give a counter by --column revolutions=N.",
            )


def with_named_counter(raw: RawTable, columns: Columns, options: ReadOptions) -> Columns:
    """Return columns with the counter of an encoder that is found by words in its name, if the option counts pulses.

    An angle, a speed, intervals or counts that are already found, and a column given by the user, exclude it. A
    DatasetError is raised for two such counters.
    """
    per_turn = options.pulses_per_turn or 0.0
    if not per_turn > 0 or not raw.headed or set(columns.place) & _MEASURED:
        return columns
    found = [
        i
        for i in _accumulating(raw, columns, per_turn)
        if _NAMES_OF_COUNTS.search(header_of(raw.names[i])[0].casefold())
    ]
    if len(found) > 1:
        wanted = (options.marker or options.body or "").casefold()
        found = [i for i in found if wanted in raw.names[i].casefold()] or found
    if len(found) > 1:
        names = ", ".join(column_name(raw, i) for i in found)
        what = f"{raw.header_place}: {len(found)} columns contain counts: {names}."
        raise DatasetError(what, f"Choose one, for example --column 'revolutions={raw.names[found[0]]}'.")
    if not found:
        return columns
    return replace(
        columns,
        place=columns.place | {"revolutions": found[0]},
        unit=columns.unit | {"revolutions": ""},
        why=columns.why | {"revolutions": "by its name"},
    )


def _accumulating(raw: RawTable, columns: Columns, per_turn: float) -> list[int]:
    """Return the columns of whole numbers that accumulate like counts, with at most a few reversals.

    A sampled signal of a sensor passes through its whole range in each period, and therefore does not accumulate.
    """
    found = []
    taken = {*columns.place.values(), *columns.drivers}
    for i in range(len(raw.names)):
        values = raw.numeric(i) if i not in taken and header_of(raw.names[i])[1] == "" else None
        values = np.zeros(0) if values is None else values[np.isfinite(values)]
        if len(values) < MIN_SAMPLES or (values != np.round(values)).any() or counts_rows(values):
            continue
        if np.ptp(values) < per_turn:  # the count may restart at each turn
            values = np.unwrap(values, period=per_turn)
        path, extent = float(np.abs(np.diff(values)).sum()), float(np.ptp(values))
        if extent >= MIN_SAMPLES and path <= _LONGEST_PATH * extent:
            found.append(i)
    return found


def _refuse_counter(raw: RawTable, options: ReadOptions) -> None:
    """Raise a DatasetError if each row would be a pulse, but another column contains whole numbers that only grow."""
    columns = find_columns(raw, options)
    if not raw.headed or columns.why.get("t") == "by --column":
        return
    for i in _accumulating(raw, columns, options.pulses_per_turn or 1.0):
        values = raw.numeric(i)
        step = np.diff(np.zeros(0) if values is None else values[np.isfinite(values)])
        if max(float((step >= 0).mean()), float((step <= 0).mean())) < 1.0 or role_of(raw.names[i]) == "t":
            continue
        time = raw.names[columns.place["t"]] if "t" in columns.place else "1"
        raise DatasetError(
            f"{raw.header_place}: {column_name(raw, i)} contains whole numbers that never reverse, which may be "
            "counts. Then the rows are samples and not pulses.",
            f"For counts, give --column 'revolutions={raw.names[i]}'. If each row is a pulse, give --column "
            f"'t={time}'.",
        )


def sampled_counts(raw: RawTable, columns: dict[str, int]) -> int | None:
    """Return the column with sampled counts of an encoder, with several counts per row; None without such a column.

    Call this only if the number of pulses per turn is given. Without a header, the second of two columns may be the
    counts.
    """
    place = columns.get("revolutions")
    if place is None and not raw.headed and len(raw.names) == 2 and not columns.keys() - {"t"}:
        place = 1
    values = None if place is None else raw.numeric(place)
    if values is None:
        return None
    values = values[np.isfinite(values)]
    if (
        len(values) < MIN_SAMPLES
        or (values != np.round(values)).any()
        or set(np.unique(values)) <= {0.0, 1.0}
    ):
        return None
    step = np.diff(values)
    events = (step >= 0).all() and np.isin(step, (0, 1)).mean() > 0.9
    return None if events else place


def read_sampled_counts(raw: RawTable, columns: Columns, counts: int, options: ReadOptions) -> MotionTable:
    """Return the angle of a body from the sampled counts of an encoder, which may turn in both senses."""
    clock = columns.place.get("t", 0), columns.unit.get("t", "")
    times = raw.numbers(clock[0], "t", times=True)
    if len(np.unique(times)) < _LEAST_SINGLE * len(times):
        what = f"{raw.path}: most times in {column_name(raw, clock[0])} are repeated."
        raise DatasetError(
            what, "Check the columns and the decimal sign, or give the times with more digits."
        )
    angles = _counted_angles(raw, counts, *clock, options)
    made = _of_changes(angles, options) or interpret(
        angles, replace(options, names=None, pulses_per_turn=None), counts=True
    )
    per_turn = f"{options.pulses_per_turn:g} per turn"
    taken = (
        Taken(
            column_name(raw, clock[0]),
            "time",
            angles.units[0] or "s",
            columns.why.get("t", "the first column"),
        ),
        Taken(
            column_name(raw, counts),
            "count",
            "",
            f"{columns.why.get('revolutions', 'whole numbers')}; {per_turn}",
        ),
    )
    others = tuple(column_name(raw, i) for i in range(len(raw.names)) if i not in {clock[0], counts})
    return replace(made, reading=Reading(raw.path.name, "", len(raw.line), taken, others))


def _of_changes(angles: RawTable, options: ReadOptions) -> MotionTable | None:
    """Return the angles at the changes of sampled counts.

    The result is None in three cases. At most 5 % of the rows repeat the previous count while the body turns; or the
    times do not increase; or the count restarts at each turn and does not determine the number of turns between two
    rows.
    """
    time = angles.numbers(0, "t") * scale_of(angles, "t", angles.units[0])
    per_turn = options.pulses_per_turn or 1.0
    count, line = np.round(angles.numbers(1) * (per_turn / TURN)), angles.line
    known = np.isfinite(time) & np.isfinite(count)
    time, count, line = time[known], count[known], line[known]
    if (np.diff(time) <= 0).any():
        return None
    if np.ptp(count) < per_turn:
        total = np.unwrap(count, period=per_turn)
        if (total != count).any() and not _turns_are_known(time, total, per_turn):
            return None
        count = total
    if not counts_coarsely(time, count):
        return None
    return from_changes(angles, time + options.start, count, line, per_turn, list(angles.notes))


def _turns_are_known(time: Floats, total: Floats, per_turn: float) -> bool:
    """Return whether the body, at its previous speed, turns by less than 0.4 turns in each interval."""
    here = np.arange(len(time) - 1)
    before = np.maximum(here - _ROWS_BEFORE, 0)
    past = np.where(here > before, time[here] - time[before], np.inf)
    return bool((np.abs(total[here] - total[before]) / past * np.diff(time) < _PART_OF_TURN * per_turn).all())


def _counted_angles(
    raw: RawTable, counts: int, time_column: int, unit: str, options: ReadOptions
) -> RawTable:
    """Return the table of times and angles of sampled counts."""
    time = raw.numbers(time_column, "t", times=True)
    note: tuple[str, ...] = ()
    if not unit and not raw.headed and (scale := clock_scale(raw, time)) != 1.0:
        unit = _TICK_UNITS[scale]
        note = (f"{raw.path.name}: times are integers and are assumed to be in {unit}",)
    per_turn = options.pulses_per_turn or 1.0
    values = raw.numbers(counts, "counts").copy()
    known = np.isfinite(values)
    if np.ptp(values[known]) >= per_turn:
        values[known], bits = _continued_count(values[known])
        if bits:
            note += (f"{raw.path.name}: the {bits}-bit counter overflows; the count was continued",)
    angle = values * (TURN / per_turn)
    return replace(
        raw, names=("t", "angle"), units=(unit, "rad"), columns=(time, angle), notes=(*raw.notes, *note)
    )


def _continued_count(count: Floats) -> tuple[Floats, int]:
    """Return counts without the overflows of an n-bit counter (steps of over 2^n / 2), and n; 0 without overflows."""
    low, high = float(count.min()), float(count.max())
    for bits in (8, 16, 24, 32):
        size = 2.0**bits
        in_range = (low >= 0 and high < size) or (low >= -size / 2 and high < size / 2)
        if in_range and (np.abs(np.diff(count)) > size / 2).any():
            return np.unwrap(count, period=size), bits
    return count, 0


def counters_of(raw: RawTable) -> list[int]:
    """Return the counters among the columns of a table without header: integers that increase in steps of 1.

    A column that increases in every row contains row numbers, unless the rows are at the irregular times of pulses.
    """
    found = []
    time = raw.numeric(0)
    sampled = time is None or counts_rows(time) or is_sampled(time)
    for i in range(1, len(raw.names)):
        values = raw.numeric(i)
        if values is None:
            continue
        values = values[np.isfinite(values)]
        if len(values) < MIN_SAMPLES or (values != np.round(values)).any():
            continue
        if sampled and counts_rows(values):
            continue
        step = np.diff(values)
        if (
            (step >= 0).mean() > 0.99
            and (step == 1).sum() >= MIN_SAMPLES
            and np.isin(step, (0, 1)).mean() > 0.9
        ):
            found.append(i)
    return found
