"""Pulses in a sampled signal: the voltage of a photodiode, a Hall sensor or a microphone, the brightness of a window.

A pulse is where the signal rises through the middle between its local lowest and highest values, after it was in the
lower third and before it is in the upper third (a Schmitt trigger: noise near the middle makes no pulses). The time of
the crossing is interpolated linearly between two samples.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gyrotrack._errors import DatasetError
from gyrotrack.io._records import Floats, Integers
from gyrotrack.io.readers._raw_table import RawTable

# largest relative deviation of 90 % of the intervals between samples from their median, for a clocked sampler
_CLOCKED = 0.01
_REGULAR = 0.3  # largest relative change (median) between intervals of pulses; noise has 0.7
_LEVELS = 8  # least number of distinct values of a signal; states of a light gate have two
_PULSES_PER_PART = 6  # number of the longest typical periods in which the extremes are taken
_EXTREMES = (2.0, 98.0)  # percentiles of the low and the high level
# least amplitude of a signal relative to its typical one; below it the body is at rest or gone
_PRESENT = 0.25
# least number of samples per pulse (in three of four neighbouring intervals); with fewer, pulses are missed
_LEAST_SAMPLES = 4.0
_NEIGHBOURS = 9
_LEAST_PART = 16


def is_sampled(time: Floats) -> bool:
    """Return whether times are those of a clocked sampler and not of events."""
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
    """Return whether pulses follow each other regularly, as those of a rotation do."""
    step = np.diff(edges)
    return len(step) > 2 and float(np.median(np.abs(np.diff(np.log(step))))) < _REGULAR


def rising_edges(time: Floats, signal: Floats, name: str, notes: list[str]) -> tuple[Floats, Integers]:
    """Return the times at which a signal rises through its local middle, and the sample after each, both (pulses,).

    Only the longest stretch with enough samples per pulse is used: beyond it, pulses are lost between samples.

    Raises
    ------
    DatasetError
        No stretch has enough samples per pulse.
    """
    part = len(signal)
    while True:
        edges, after = _edges(time, signal, part)
        longest = float(np.percentile(np.diff(after), 90)) if len(after) > 1 else np.inf
        if not (smaller := max(_LEAST_PART, _PULSES_PER_PART * longest)) < 0.9 * part:
            break
        part = int(smaller)
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
    state[~present] = -1
    decided = np.flatnonzero(state)
    turn = np.flatnonzero((state[decided][1:] > 0) & (state[decided][:-1] < 0))
    times, after = [], []
    for begin, end in zip(decided[turn], decided[turn + 1], strict=True):
        k = begin + int(np.flatnonzero(relative[begin : end + 1] >= 0.5)[0])
        fraction = (0.5 - relative[k - 1]) / (relative[k] - relative[k - 1])
        times.append(time[k - 1] + fraction * (time[k] - time[k - 1]))
        after.append(k)
    return np.array(times), np.array(after, dtype=int)
