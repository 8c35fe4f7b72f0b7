"""Slips of whole turns in a series of angles: detection as steps of 2 pi between two samples, and correction.

All later angles are shifted by a whole turn if a tracker confuses two similar markers, if a counter loses an overflow,
or if a gap is unwrapped wrongly. Let v be the local speed, the median of the difference quotients of the neighbouring
samples. From one sample to the next the angle changes by v dt plus noise, and a slip of n turns is

    e = y[i+1] - y[i] - v (t[i+1] - t[i]) = 2 pi n + noise,   n = round(e / 2 pi) != 0.

The number of turns is an integer that the data determine without uncertainty, so the correction adds no error to the
angles. The slips are stored with the data, and every fit reports them. Neither a motion nor noise causes such a step.
Without the correction, a window with a slip would seem to have angle noise of hundreds of milliradians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT, Criteria
from fitting.inference._record import Record, Samples, running_median

Array = NDArray[np.float64]

_TURN = 2 * math.pi
"""One turn [rad]. Derived: 2 pi."""
_NEIGHBOURS = 31
"""Number of difference quotients from which a local speed is estimated [1]. Chosen: a smaller number follows noise and
slips, a larger one blurs a changing speed."""
_MAD = 1.4826
"""Standard deviation divided by the median absolute deviation of a normal variable [1]. Derived: the reciprocal of the
quantile 0.75 of the standard normal distribution."""


@dataclass(frozen=True)
class Slip:
    """Whole turns that slipped in one series.

    Attributes
    ----------
    body : str
        "casing", "rotor", or "body" if only one body was recorded.
    window : int or None
        Number of the rotor window, from 1; None for the casing.
    time : float
        Time of the first sample after the step [s].
    turns : int
        Whole turns by which the measured angle is too large from then on.
    """

    body: str
    window: int | None
    time: float
    turns: int

    @property
    def where(self) -> str:
        """The series, in words."""
        return f"{self.body} window {self.window}" if self.window is not None else f"the {self.body}"

    @property
    def sentence(self) -> str:
        """A sentence with the number of slipped turns, the series and the time."""
        many = "a whole turn" if abs(self.turns) == 1 else f"{abs(self.turns)} whole turns"
        sign = "+" if self.turns > 0 else "-"
        return f"{many} slipped in {self.where} at {self.time:.3f} s ({sign}{abs(self.turns)})"


def slipped_turns(samples: Samples, criteria: Criteria = DEFAULT) -> list[tuple[int, int]]:
    """Return index and number of turns of every slip: all angles from this index on are too large by these turns.

    Parameters
    ----------
    samples : Samples
        Angles [rad].
    criteria : Criteria
        Its `slip_tolerance` is the largest deviation from a whole turn, as a share of a turn.
    """
    step, interval = np.diff(samples.value), np.diff(samples.time)
    # above half a turn per sample, a slip cannot be distinguished from a faster motion
    if len(step) < _NEIGHBOURS or not np.median(np.abs(step)) < 0.5 * _TURN:
        return []
    quotient = step / interval
    before = quotient[np.maximum(np.arange(len(step)) - 1, 0)]
    if not (np.abs(step - before * interval) > 0.5 * _TURN).any():
        return []
    speed = running_median(quotient, _NEIGHBOURS)
    # at each end, the running median equals the end value, because this value is repeated
    speed[[0, -1]] = speed[[1, -2]]
    excess = step - speed * interval
    scatter = _MAD * float(np.median(np.abs(excess)))
    allowed = criteria.slip_tolerance * _TURN
    if not criteria.slip_sigma * scatter < allowed:
        return []
    turns = np.rint(excess / _TURN).astype(int)
    found = np.flatnonzero((turns != 0) & (np.abs(excess - _TURN * turns) < allowed))
    return [(int(i) + 1, int(turns[i])) for i in found]


def without_slips(record: Record, criteria: Criteria = DEFAULT) -> tuple[Record, tuple[Slip, ...]]:
    """Return the record with slipped turns corrected, under the digest of the measured numbers, and the slips."""
    if record.quantity != "angle" or record.generated:
        return record, ()
    slips: list[Slip] = []
    runs = []
    for i, run in enumerate((record.casing, *record.rotor)):
        found = slipped_turns(run, criteria)
        body, window = (record.body, None) if i == 0 else (record.mechanism.bodies[run.state], i)
        slips += [Slip(body, window, float(run.time[k]), n) for k, n in found]
        runs.append(_corrected(run, found))
    if not slips:
        return record, ()
    return replace(record, casing=runs[0], rotor=tuple(runs[1:])), tuple(slips)


def as_measured(record: Record, slips: Sequence[Slip]) -> Record:
    """Return a corrected record with its slipped turns restored."""
    runs = [record.casing, *record.rotor]
    for slip in slips:
        i = slip.window or 0
        runs[i] = _corrected(runs[i], [(int(np.searchsorted(runs[i].time, slip.time)), -slip.turns)])
    return replace(record, casing=runs[0], rotor=tuple(runs[1:])) if slips else record


def _corrected(samples: Samples, slips: Sequence[tuple[int, int]]) -> Samples:
    value: Array = samples.value.copy()
    for first, turns in slips:
        value[first:] -= _TURN * turns
    return replace(samples, value=value)
