"""Detection of an oscillation in the measured motion: period, reversals and equilibrium.

Turning points are found with hysteresis: an extreme of the angle counts if the angle then returns by more than the
noise and by more than a hundredth of its range. Three successive turning points e_1, e_2, e_3 of a damped oscillation
give the equilibrium (e_1 + 2 e_2 + e_3) / 4. In this mean, the decay cancels to first order. The shift by dry friction
also cancels, because its sign alternates from one turning point to the next.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.inference._compression import integrated
from fitting.inference._record import Record

Array = NDArray[np.float64]

_SIGMAS = 8.0
"""A reversal counts only if the angle returns by at least this value [standard uncertainties]. Chosen: a smaller value
counts noise as reversals, a larger one ends a decaying oscillation early."""
_SHARE = 0.01
"""A reversal counts only if the angle returns by at least this share of its range [1]. Chosen: a smaller value counts
vibrations as reversals, a larger one ends a decaying oscillation early."""
_FEWEST = 3
"""Smallest number of reversals of an oscillation [1]. Derived: three successive turning points determine the
equilibrium."""
_PROGRESS = 0.6
"""Largest net rotation of a body that oscillates, divided by its total path [1]. Chosen: a larger value takes a
rotation with a reversal for an oscillation, a smaller one refuses strongly damped oscillations."""
_PHASE_DEGREE = 5
"""Degree of the polynomial of the phase [1]. Chosen: a smaller value does not follow a changing frequency, a larger one
oscillates at the ends."""
_HARMONICS = 3
"""Number of harmonics of an oscillation [1]. Chosen: with a smaller value, a part of the motion counts as noise; a
larger one absorbs noise."""
_MODULATION = 3
"""Highest power of time in the polynomial for the amplitude of each harmonic [1]. Chosen: a smaller value does not
follow the decay, a larger one absorbs noise."""
_MOST_WINDOWS = 300
"""Largest number of windows of an oscillation, in each of which amplitude and phase are determined [1]. Chosen: a
smaller number blurs the decay, a larger one costs time."""
_WINDOWS = 20
"""Number of windows of a record of 20 to 60 periods. In longer records a window contains three periods, in shorter
records one period [1]. Chosen: a smaller number does not resolve the decay of short records, a larger one gives
uncertain amplitudes."""
_POINTS_PER_PERIOD = 24
"""Number of approximate speeds in each period of an oscillation, from which a fit begins [1]. Chosen: with fewer, the
largest deflections are averaged away; with more, each speed is noisy."""
_ROUGH_SAMPLES = 3
"""Smallest number of samples from which one approximate speed of an oscillation is computed [samples]. Derived: three
samples determine a line and its error."""
_FEWEST_SAMPLES = 10
"""Smallest number of samples in a window [samples]. Chosen: a smaller number does not determine amplitude and phase, a
larger one refuses slow cameras."""


class SlowMotion(NamedTuple):
    """Amplitude [rad] and phase [rad] of an oscillation at some times [s]: deflection = amplitude cos phase."""

    time: Array
    amplitude: Array
    phase: Array


class Rotation:
    """A motion without reversals: the properties of an oscillation are empty, zero or infinite."""

    is_smooth = True
    reversals: Array = np.zeros(0)
    period = amplitude = math.inf
    time: Array = np.zeros(1)
    deflection: Array = np.zeros(1)
    slow_motion = None
    rough: tuple[int, ...] = ()

    @property
    def periods(self) -> float:
        """Length of the record in periods."""
        return 0.0

    def phase(self, times: Array) -> Array:
        """Return the phase of the motion at some times [rad]: zero."""
        return np.zeros(len(times))

    def samples_per_period(self, _samples: int) -> float:
        """Return the number of samples in a period."""
        return math.inf

    def harmonics(self, samples: int) -> Array:
        """Return the harmonics of the motion: none."""
        return np.zeros((samples, 0))

    def offsets(self, samples: int) -> Array:
        """Return functions that describe an unknown zero of measured speeds: none.

        In a rotation, a torque can describe the effect of an unknown zero.
        """
        return np.zeros((samples, 0))

    def beyond_motion(self, columns: Array, _angle: Array) -> Array:
        """Return functions of the angle: in a rotation, all of them are distinguishable from the motion."""
        return columns


@dataclass(frozen=True)
class Oscillation:
    """The measured oscillation of a body."""

    reversals: Array  # shape (n,); times at which the body reverses [s]
    period: float  # median of twice the time between neighbouring reversals [s]
    # shape (samples,); times of the samples [s], and angles from the equilibrium [rad]; measured speeds are integrated
    # to angles, and the drift is removed
    time: Array
    deflection: Array

    # within a block the motion is not a polynomial
    is_smooth: ClassVar[bool] = False

    @property
    def periods(self) -> float:
        """Length of the record in periods."""
        return float((self.time[-1] - self.time[0]) / self.period)

    @property
    def amplitude(self) -> float:
        """Half the range of the deflection [rad]."""
        return 0.5 * float(np.ptp(self.deflection))

    @property
    def rough(self) -> tuple[int, ...]:
        """Number of approximate speeds, and smallest number of samples of each (see `initial_speeds`)."""
        return math.ceil(_POINTS_PER_PERIOD * self.periods), _ROUGH_SAMPLES

    def samples_per_period(self, samples: int) -> float:
        """Return the number of samples in a period, given the number of samples of the record."""
        return samples / self.periods

    def offsets(self, samples: int) -> Array:
        """Return functions that describe an unknown zero of measured speeds: a constant (zero-rate output)."""
        return np.ones((samples, 1))

    def beyond_motion(self, columns: Array, angle: Array) -> Array:
        """Return functions of the angle without the part that is linear in the angle.

        Over a part of a turn, the complete functions are nearly linear in the angle and would absorb any motion.
        """
        linear = np.stack([np.ones_like(angle), angle - angle.mean()], axis=1)
        return np.asarray(columns - linear @ np.linalg.lstsq(linear, columns, rcond=None)[0])

    def phase(self, times: Array) -> Array:
        """Return the phase of the oscillation at some times [rad], a polynomial in time through the reversals."""
        return _smooth_phase(self.reversals, np.pi * np.arange(len(self.reversals), dtype=np.float64), times)

    @cached_property
    def slow_motion(self) -> SlowMotion | None:
        """Amplitude and phase in windows of a period or more; None if periods or samples are few.

        A least-squares fit in each window contains the first harmonic with linearly varying amplitude and phase, the
        third harmonic, a constant and a drift. The phase from the reversals, whose times are known to a sample, is
        corrected by the phase from the windows, and the fit is repeated.
        """
        # within one period a drift and a change of the phase are hardly distinguishable
        count = min(_MOST_WINDOWS, int(max(self.periods / 3, min(self.periods, _WINDOWS))))
        edges = np.linspace(self.time[0], self.time[-1], count + 1)
        first = np.searchsorted(self.time, edges[:-1])
        if count < _FEWEST or np.diff([*first, len(self.time)]).min() < _FEWEST_SAMPLES:
            return None
        middle, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
        window = np.minimum(((self.time - edges[0]) / width).astype(int), count - 1)
        first = np.searchsorted(window, np.arange(count))
        x = (self.time - middle[window]) / width
        phase, at_middle = self.phase(self.time), self.phase(middle)
        for repeated in (False, True):
            cos, sin = np.cos(phase), np.sin(phase)
            columns = np.stack(
                [cos, sin, x * cos, x * sin, np.cos(3 * phase), np.sin(3 * phase), np.ones_like(x), x], axis=1
            )
            normal = np.add.reduceat(columns[:, :, None] * columns[:, None], first)
            right = np.add.reduceat(columns * self.deflection[:, None], first)
            weak = 1e-9 * np.eye(len(normal[0])) * normal[:, :1, :1]
            a, b = np.linalg.solve(normal + weak, right[..., None])[:, :2, 0].T
            found = np.unwrap(np.arctan2(-b, a)) + at_middle
            if not repeated:
                phase, at_middle = (_smooth_phase(middle, found, t) for t in (self.time, middle))
        return SlowMotion(middle, np.hypot(a, b), found)

    def harmonics(self, _samples: int) -> Array:
        """Return harmonics of the oscillation with slowly varying amplitude and phase: products with powers of time.

        Returns
        -------
        ndarray, shape (samples, columns)
        """
        phase = self.phase(self.time)
        x = 2 * (self.time - self.time[0]) / np.ptp(self.time) - 1
        slow = np.polynomial.legendre.legvander(x, _MODULATION)
        columns = [f(m * phase)[:, None] * slow for m in range(1, _HARMONICS + 1) for f in (np.cos, np.sin)]
        return np.concatenate(columns, axis=1)


def _smooth_phase(at: Array, phase: Array, times: Array) -> Array:
    """Return a phase at other times from a polynomial in time; outside the given times, it is a straight line."""
    middle, half = 0.5 * (at[0] + at[-1]), 0.5 * float(np.ptp(at))
    degree = min(_PHASE_DEGREE, max(1, len(at) - 2))
    c = np.polynomial.chebyshev.chebfit((at - middle) / half, phase, degree)
    x = (times - middle) / half
    inside = np.clip(x, -1.0, 1.0)
    slope = np.polynomial.chebyshev.chebval(inside, np.polynomial.chebyshev.chebder(c))
    return np.asarray(np.polynomial.chebyshev.chebval(inside, c) + slope * (x - inside))


Motion = Rotation | Oscillation
ROTATION = Rotation()


def are_smooth(motions: Iterable[Motion]) -> bool:
    """Return whether all motions are polynomials within the blocks of their records."""
    return all(m.is_smooth for m in motions)


def motion_of(record: Record) -> Motion:
    """Return the motion of a recording: the oscillation of a body without joints and inputs, or a rotation.

    A body that an input drives to and fro does not oscillate about an equilibrium.
    """
    return (None if record.driving else find_oscillation(record)) or ROTATION


def find_oscillation(record: Record) -> Oscillation | None:
    """Return the oscillation of a body; None if it turns in one sense, or has a joint to another body."""
    if record.joints:
        return None
    t, y = record.casing.time, record.casing.value
    angle = y if record.quantity == "angle" else integrated(t, y)
    least = _SHARE * float(np.ptp(angle))
    if record.quantity == "angle":
        least = max(least, _SIGMAS * float(np.median(record.casing.sigma)))
        turns = turning_points(angle, least)
    else:
        turns = _sign_changes(
            y, max(_SHARE * float(np.abs(y).max()), _SIGMAS * float(np.median(record.casing.sigma)))
        )
    if len(turns) < _FEWEST:
        return None
    extreme = angle[turns]
    path = float(np.abs(np.diff(extreme)).sum())
    if abs(extreme[-1] - extreme[0]) > _PROGRESS * path:
        return None
    middle = 0.25 * (extreme[:-2] + 2 * extreme[1:-1] + extreme[2:])
    if record.quantity == "angle" or len(middle) < _FEWEST:
        rest: Array = np.full(len(t), np.median(middle))
    else:
        rest = np.asarray(np.polyval(np.polyfit(t[turns[1:-1]], middle, 1), t))
    period = 2 * float(np.median(np.diff(t[turns])))
    return Oscillation(t[turns], period, t, angle - rest)


def turning_points(angle: Array, least: float) -> NDArray[np.intp]:
    """Return the samples at which a curve reverses by more than `least`; its ends do not count."""
    found: list[int] = []
    low = high = extreme = 0
    sense = 0
    values = angle.tolist()
    for i, x in enumerate(values):
        if sense == 0:
            low, high = (i if x < values[low] else low), (i if x > values[high] else high)
            sense = 1 if x - values[low] > least else -1 if values[high] - x > least else 0
            extreme = i
        elif sense * (x - values[extreme]) > 0:
            extreme = i
        elif sense * (values[extreme] - x) > least:
            found.append(extreme)
            sense, extreme = -sense, i
    return np.array(found, dtype=np.intp)


def _sign_changes(speed: Array, least: float) -> NDArray[np.intp]:
    """Return the samples at which a speed changes its sign; before and after, its magnitude is larger than `least`."""
    significant = np.flatnonzero(np.abs(speed) > least)
    change = np.flatnonzero(np.diff(np.sign(speed[significant])) != 0)
    before, after = significant[change], significant[change + 1]
    share = speed[before] / (speed[before] - speed[after])
    return np.asarray(np.round(before + share * (after - before)), dtype=np.intp)
