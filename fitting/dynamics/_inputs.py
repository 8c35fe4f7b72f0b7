"""Recorded inputs of a motion: currents, voltages, commanded torques, temperatures.

An input is a function of time, given by samples at times that differ from the times of the motion. Between two samples
it is linear, or it holds the value of the earlier sample. A torque that depends on an input therefore changes abruptly
at the samples: its value jumps if a held input changes, and its slope jumps if the slope of a linear input changes. The
equations of motion are integrated from one such time to the next, because they are smooth in between. An input with
more than `MOST_CHANGES` changes is replaced by its means over short cells, which give the body the same impulse.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fitting._arguments import FINITE
from fitting._case_format import INTERPOLATIONS
from fitting._errors import ExpressionError, RecordError
from fitting.effects._effect import input_symbol, parse_unit, refuse_input_name

Array = NDArray[np.float64]
Interpolation = Literal["linear", "hold"]

MOST_CHANGES = 4000
"""Largest number of times at which an input changes value or slope [1]. Chosen: a smaller value averages over longer
cells, a larger one costs time."""
_ROUNDING = 1e-9
"""A step of a held input is rounding error if its size, divided by the largest value of the input, is below this value
[1]. Chosen: a smaller value splits the integration at rounding errors, a larger one overlooks steps."""
_ROUNDED = 1e-7
"""A change of slope counts as rounding error if it changes the next sample by less than this share of the range of the
input [1]. Derived: eight digits of a number in a file, with a margin of ten."""


@dataclass(frozen=True, repr=False)
class Input:
    """A measured function of time on which torques may depend.

    Parameters
    ----------
    name : str
        Name of the input in laws: letters, digits and underscores.
    time : ndarray, shape (n,)
        Times of the samples on the clock of the record [s], strictly increasing.
    value : ndarray, shape (n,)
        Values of the samples [unit].
    unit : str
        Unit in the style of CF: ``A``, ``V``, ``N m``, ``K``, ``1``.
    u : ndarray, shape (n,), or None
        Standard uncertainty of the values due to the calibration of the instrument [unit]: a common error of all
        samples, proportional to `u`. It does not include the noise of the samples.
    interpolation : {"linear", "hold"}
        Value between two samples: linear interpolation, or the value of the earlier sample.
    delay : float
        Dead time after which the input acts [s].
    """

    name: str
    time: Array
    value: Array
    unit: str = "1"
    u: Array | None = None
    interpolation: Interpolation = "linear"
    delay: float = 0.0

    def __post_init__(self) -> None:
        refuse_input_name(self.name)
        if not isinstance(self.interpolation, str) or self.interpolation not in INTERPOLATIONS:
            raise RecordError(
                f"input {self.name}: the interpolation is {str(self.interpolation)[:20]!r}",
                f"use {' or '.join(INTERPOLATIONS)}",
            )
        try:
            parse_unit(self.unit)
        except (ExpressionError, AttributeError, TypeError):
            raise RecordError(
                f"input {self.name}: {str(self.unit)[:20]!r} is not a unit",
                "write, for example, A, V, N m, K or 1",
            ) from None
        arrays = {"time": self.time, "value": self.value} | ({} if self.u is None else {"u": self.u})
        for name, values in arrays.items():
            object.__setattr__(self, name, self._checked(name, values))
        if len(self.time) > 1 and not (np.diff(self.time) > 0).all():
            raise RecordError(f"input {self.name}: the times are not strictly increasing")
        if self.u is not None and (self.u < 0).any():
            raise RecordError(f"input {self.name}: an uncertainty is negative")
        if not FINITE.fits(self.delay):
            raise RecordError(f"input {self.name}: the delay is not a finite number", "give it in s")

    def __repr__(self) -> str:
        span = f"{self.time[0]:.6g} to {self.time[-1]:.6g} s"
        range_ = f"{self.value.min():.6g} to {self.value.max():.6g} {self.unit}"
        late = f", acts {self.delay:g} s later" if self.delay else ""
        return f"Input {self.name!r}: {range_}, {len(self.time)} samples, {span}, {self.interpolation}{late}"

    def _checked(self, name: str, values: object) -> Array:
        try:
            array = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise RecordError(f"input {self.name}: {name} holds no numbers", "use a NumPy array") from None
        if array.ndim != 1 or len(array) != len(np.atleast_1d(self.time)) or not len(array):
            raise RecordError(
                f"input {self.name}: {name} has the shape {array.shape}",
                "use one-dimensional arrays of the same length",
            )
        if not np.isfinite(array).all():
            raise RecordError(f"input {self.name}: {name} has values that are not finite", "leave them out")
        array.flags.writeable = False
        return array

    @property
    def symbol(self) -> str:
        """The symbol of the input in the expression of a law."""
        return input_symbol(self.name)

    @property
    def varies(self) -> bool:
        """Whether the value is not constant."""
        return bool(np.ptp(self.value) > 0)

    @cached_property
    def _acting(self) -> Array:
        """Times at which the samples act [s]."""
        return np.asarray(self.time + self.delay)

    def __call__(self, times: Array | float, late: float = 0.0) -> Array:
        """Return the value at times [s] with the additional dead time `late` [s].

        Before the first and after the last sample, the value is the value of the nearest sample.
        """
        return self._interpolated(self.value, times, late)

    def slope(self, times: Array | float, late: float = 0.0) -> Array:
        """Return the right-hand derivative at times [unit/s]; zero for a held input, whose value jumps."""
        t = np.asarray(times, dtype=np.float64)
        if self.interpolation == "hold" or len(self.time) < 2:
            return np.zeros(t.shape)
        at = self._acting + late
        slopes = np.concatenate([[0.0], np.diff(self.value) / np.diff(self.time), [0.0]])
        return np.asarray(slopes[np.searchsorted(at, t, side="right")])

    def uncertainty(self, times: Array | float) -> Array:
        """Return the standard uncertainty at times [s], in the unit of the input; zero if no uncertainty is given."""
        return self._interpolated(np.zeros(len(self.time)) if self.u is None else self.u, times)

    def _interpolated(self, values: Array, times: Array | float, late: float = 0.0) -> Array:
        # the delay is added to the times of the samples instead of subtracted from `times`, so that a change is exactly
        # at its time
        t, at = np.asarray(times, dtype=np.float64), self._acting + late
        if self.interpolation == "linear":
            return np.asarray(np.interp(t, at, values))
        # right-continuous, like heaviside(t - t0) in a law
        return np.asarray(values[np.maximum(np.searchsorted(at, t, side="right") - 1, 0)])

    def integral(self, times: Array) -> Array:
        """Return the integral from the first time to each of `times` [unit s]."""
        t = np.asarray(times, dtype=np.float64)
        knots = np.unique(np.concatenate([self._acting, t]))
        step = np.diff(knots)
        value = self(knots)
        mean = value[:-1] if self.interpolation == "hold" else 0.5 * (value[1:] + value[:-1])
        total = np.concatenate([[0.0], np.cumsum(mean * step)])
        found = total[np.searchsorted(knots, t)]
        return np.asarray(found - found[0])

    def means(self, edges: Array) -> Array:
        """Return the mean value in each cell between two successive edges [unit]."""
        return np.asarray(np.diff(self.integral(edges)) / np.diff(edges))

    def jumps(self) -> tuple[Array, Array]:
        """Return the times of all samples but the first [s], and the change of the value from the previous sample."""
        change = np.diff(self.value)
        return self._acting[1:], change

    def changes(self, first: float, last: float, late: float = 0.0) -> Array:
        """Return the times between `first` and `last` at which the value (held) or the slope (linear) changes [s]."""
        if len(self.time) < 2:
            return np.zeros(0)
        if self.interpolation == "hold":
            size = np.abs(np.diff(self.value))
            at = self._acting[1:][size > _ROUNDING * float(np.abs(self.value).max())]
        else:
            # before the first and after the last sample the value is constant
            step = np.diff(self.time)
            slope = np.concatenate([[0.0], np.diff(self.value) / step, [0.0]])
            # change of the next sample due to the change of the slope
            size = np.abs(np.diff(slope)) * np.minimum(np.append(step, step[-1]), np.append(step[0], step))
            at = self._acting[size > _ROUNDED * max(float(np.ptp(self.value)), 1e-300)]
        at = at + late
        return np.asarray(at[(at > first) & (at < last)])

    def followed(self, first: float, last: float, most: int = MOST_CHANGES) -> Input:
        """Return the input with at most `most` changes between two times [s].

        If the input has more changes, it is replaced by a held input with its means over equal cells.
        """
        if len(self.changes(first, last)) <= most:
            return self
        edges = np.linspace(first, last, most + 1)
        u = None if self.u is None else self.uncertainty(edges[:-1])
        return replace(self, time=edges[:-1] - self.delay, value=self.means(edges), u=u, interpolation="hold")

    def refuse_uncovered(self, first: float, last: float) -> None:
        """Raise a RecordError unless the samples cover the times of a record [s].

        The last sample of a held input covers all later times. Otherwise one sample interval plus the delay may be
        missing at either end.
        """
        step = float(np.median(np.diff(self.time))) if len(self.time) > 1 else math.inf
        slack = step + abs(self.delay)
        late = self.interpolation == "linear" and self.time[-1] < last - slack
        if self.time[0] > first + slack or late:
            raise RecordError(
                f"the input {self.name} is known from {self.time[0]:.6g} to {self.time[-1]:.6g} s, the motion from "
                f"{first:.6g} to {last:.6g} s",
                "give an input that covers the record, or a part of the record",
            )


def values_at(inputs: Iterable[Input], times: Array) -> dict[str, Array]:
    """Return the values of each input at times [s], by the symbol of the input in laws."""
    return {i.symbol: i(times) for i in inputs}


def means_in(inputs: Iterable[Input], edges: Array) -> dict[str, Array]:
    """Return the means of each input between successive edges [s], by the symbol of the input in laws."""
    return {i.symbol: i.means(edges) for i in inputs}
