"""Detection of a driven body, whose speed rises, and its first-order response to the drive.

Friction never makes a body faster. A body counts as driven if its mean speed over whole turns rises significantly and
by more than a share of the largest speed. The mean is needed because an unbalance makes the speed rise and fall within
one turn. A friction law fitted to the record of a driven body would describe the drive. Instead of a friction law, the
record of a driven body shows the response

    tau d(omega)/dt = gain u(t - delay) + offset - omega

to a measured input u, taken as constant between two samples, or to a constant drive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize

from gyrotrack.apps._motion import TURN, Floats, Value, window_speeds
from gyrotrack.io._records import Series
from gyrotrack.io.readers._motion_table import Driver
from gyrotrack.io.readers._plausibility import rises
from gyrotrack.io.readers._pulses import varies_both_ways

_LEAST_RISE = 0.05  # smallest rise of the speed of a driven body [share of the largest speed]
_SIGNIFICANT = 6.0  # smallest change of the speed that is significant [standard uncertainties]
_FEWEST_TURNS = 8  # smallest number of turns; in fewer turns, an unbalance may cause the rise
_BLOCKS = 100  # largest number of intervals in which mean speeds are compared
# an input drives the body if its median is at least this value [share of the largest value of the input]
_LEAST_LEVEL = 0.05
_EXPLAINED = 0.9  # smallest share of the variance of the speed that a first-order response explains
_REST = 0.02  # largest speed at rest before a constant drive [share of the range of the speed]
_AT_REST = 0.05  # largest speed of a body that is at rest at the start [share of the largest speed]
_GRID = 24  # number of time constants in the search grid; the number of delays is half of it
_LONGEST_DELAY = 0.1  # largest dead time in the search [share of the length of the record]
_FEWEST = 12


@dataclass(frozen=True)
class Response:
    """The first-order response of a driven body."""

    input: str  #: Name of the input; empty for a constant drive.
    unit: str  #: Unit of the input in the file.
    time_constant: Value  #: Time constant [s].
    delay: Value | None  #: Dead time of the response to a step of the input; null if none is found [s].
    #: Change of the final speed per unit of the input; null if the input has only one level [rad s-1 per `unit`].
    gain: Value | None
    final: Value  #: Speed that the body approaches with the last value of the input [rad s-1].
    explained: float  #: Share of the variance of the speed that the response explains, 0 to 1 [1].


@dataclass(frozen=True)
class Drive:
    """Evidence that a body is driven, and its response to the drive."""

    reason: str  # the evidence for a drive, as a clause that ends a sentence
    # mean speeds over the "first" and the "last" turn, and their standard uncertainties [rad/s]; None for few turns
    omega: dict[str, float] | None
    omega_u: dict[str, float] | None
    response: Response | None  # response to the drive; None if no first-order response explains the motion


def drive_of(
    series: Series, quantity: str, inputs: Sequence[Driver], *, pulses: bool = False
) -> Drive | None:
    """Return the drive of a moving body; None if the motion may be free.

    Parameters
    ----------
    series : Series
        The motion.
    quantity : str
        What was measured: "angle" or "omega".
    inputs : sequence of Driver
        Measured inputs at the times of the series.
    pulses : bool, optional
        Whether the times of the series are times of pulses.
    """
    driving = [i for i in inputs if _drives(i.value)]
    speeds = _speed_of_turns(series, quantity)
    count = 0
    if speeds is not None:
        least = _LEAST_RISE * float(np.abs(speeds[0]).max())
        count = rises(speeds[0], np.maximum(_SIGNIFICANT * speeds[1], least))
    if pulses and varies_both_ways(series.time):
        reason, count = "its speed rises and falls repeatedly", max(count, 2)
    elif count:
        reason = f"its speed rises {count} time{'s' * (count > 1)}"
    elif driving:
        reason = f"its input '{driving[0].name}' is not zero"
    else:
        return None
    return _drive(series, quantity, reason, driving, speeds, count)


def drive_from_rest(series: Series, quantity: str) -> Drive | None:
    """Return the drive of a body that is at rest at the start and then turns in one sense; None for any other motion.

    Mean speeds over short windows are compared, also in a record of few turns: an unbalance does not start a body at
    rest.
    """
    step = float(np.median(np.diff(series.time)))
    sigma = series.sigma if quantity == "angle" else series.omega_sigma * step
    windows = window_speeds(series.time, series.angle, np.full(len(series.time), float(np.median(sigma))))
    if windows is None:
        return None
    _, speed, error = windows
    sense = 1.0 if series.angle[-1] >= series.angle[0] else -1.0
    top = float((sense * speed).max())
    rest = _AT_REST * top
    if top < 2 * _SIGNIFICANT * error or abs(speed[0]) > rest + 3 * error:
        return None
    if float((sense * speed).min()) < -rest - _SIGNIFICANT * error:
        return None
    return _drive(series, quantity, "its speed rises from rest", [], _speed_of_turns(series, quantity), 1)


def _drive(
    series: Series,
    quantity: str,
    reason: str,
    driving: Sequence[Driver],
    speeds: tuple[Floats, Floats] | None,
    count: int,
) -> Drive:
    """Return a drive with its response; `count` is the number of rises of the speed."""
    found = [r for i in driving if (r := _response(series, quantity, i)) is not None]
    if not driving and count == 1:
        found = [r for r in [_response(series, quantity, None)] if r is not None]
    best = max(found, key=lambda r: r.explained, default=None)
    ends, ends_u = (
        (None, None) if speeds is None else ({"first": float(x[0]), "last": float(x[-1])} for x in speeds)
    )
    return Drive(reason, ends, ends_u, best if best is not None and best.explained > _EXPLAINED else None)


def _drives(value: Floats) -> bool:
    known = np.abs(value[np.isfinite(value)])
    late = known[len(known) // 2 :]
    return bool(len(late)) and float(np.median(late)) > _LEAST_LEVEL * float(known.max()) > 0


def _speed_of_turns(series: Series, quantity: str) -> tuple[Floats, Floats] | None:
    """Return mean speeds over intervals of equal numbers of whole turns, and their standard uncertainties [rad/s]."""
    time, angle = series.time, series.angle
    turns = float(np.ptp(angle)) / TURN
    if turns < _FEWEST_TURNS:
        return None
    sense = 1.0 if angle[-1] >= angle[0] else -1.0
    gone = np.maximum.accumulate(sense * (angle - angle[0]))
    each = TURN * math.ceil(turns / _BLOCKS)
    at = np.concatenate([[0], np.searchsorted(gone, each * np.arange(1, int(gone[-1] / each) + 1))])
    at = np.unique(np.minimum(at, len(time) - 1))
    if len(at) < _FEWEST_TURNS:
        return None
    step = np.diff(time[at])
    if quantity == "omega":
        error = np.array([float(np.median(series.omega_sigma[a:b])) for a, b in pairwise(at)])
        error = error / np.sqrt(np.diff(at))
    else:
        error = np.sqrt(2.0) * series.sigma[at[1:]] / step
    return sense * np.diff(angle[at]) / step, error


def _response(series: Series, quantity: str, cause: Driver | None) -> Response | None:
    """Fit the response to an input, or to a constant drive from the end of rest."""
    from scipy.signal import lfilter  # slow import, needed by few motions

    time = series.time
    measured = series.omega if quantity == "omega" else series.angle
    begin = _end_of_rest(series) if cause is None else 0
    if len(time) - begin < _FEWEST:
        return None
    even = np.linspace(time[begin], time[-1], len(time) - begin)
    measured = np.interp(even, time, measured)
    value = np.ones(len(even))
    if cause is not None:
        early = 1e-6 * float(even[1] - even[0])  # allows for rounding errors of the times
        rows = np.clip(np.searchsorted(time, even + early, side="right") - 1, 0, None)
        value = np.nan_to_num(cause.value)[rows]
    several = len(np.unique(value)) > 1
    step, span = float(even[1] - even[0]), float(even[-1] - even[0])

    def design(tau: float, delay: float) -> Floats:
        a = math.exp(-step / tau)
        delayed = _delayed(value, delay / step)
        inputs = [delayed, np.ones_like(value)] if several else [delayed]
        columns = [np.exp(-(even - even[0]) / tau), *(lfilter([0.0, 1 - a], [1.0, -a], u) for u in inputs)]
        if quantity == "angle":
            columns = [*(_integrated(even, c) for c in columns), np.ones_like(even)]
        return np.column_stack(columns)

    def misfit(x: Floats) -> float:
        columns = design(math.exp(min(x[0], log_tau[-1])), float(np.clip(x[1], 0.0, delays[-1])))
        rest = measured - columns @ np.linalg.lstsq(columns, measured, rcond=None)[0]
        return float(rest @ rest)

    log_tau = np.linspace(math.log(2 * step), math.log(3 * span), _GRID)
    # a delay cannot be determined without a step of the input
    delays = (
        np.concatenate([[0.0], np.geomspace(step, _LONGEST_DELAY * span, _GRID // 2)])
        if several
        else np.zeros(1)
    )
    losses = np.array([[misfit(np.array([x, d])) for d in delays] for x in log_tau])
    k, m = np.unravel_index(int(np.argmin(losses)), losses.shape)
    if k in {0, _GRID - 1}:
        return None
    start = np.array([log_tau[k], delays[m]])
    simplex = np.stack(
        [start, start + np.array([log_tau[1] - log_tau[0], 0]), start + np.array([0, max(delays[m], step)])]
    )
    found = minimize(misfit, start, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 1e-7})
    tau, delay = math.exp(float(found.x[0])), float(np.clip(found.x[1], 0.0, delays[-1]))
    columns = design(tau, delay)
    coefficients = np.linalg.lstsq(columns, measured, rcond=None)[0]
    rest = measured - columns @ coefficients
    by_tau = (design(tau * 1.001, delay) - design(tau * 0.999, delay)) @ coefficients / (0.002 * tau)
    slopes = [by_tau]
    if delay > 0:
        slopes.append(
            (design(tau, delay + 0.5 * step) - design(tau, max(delay - 0.5 * step, 0.0))) @ coefficients
        )
        slopes[-1] /= delay + 0.5 * step - max(delay - 0.5 * step, 0.0)
    whole = np.column_stack([*columns.T, *slopes])
    covariance = np.linalg.pinv(whole.T @ whole) * float(rest @ rest) / max(len(rest) - whole.shape[1], 1)
    covariance *= _inflation(rest)
    last = np.zeros(whole.shape[1])
    last[1 : 3 if several else 2] = [value[-1], 1.0] if several else [value[-1]]
    final = Value(float(last[: len(coefficients)] @ coefficients), math.sqrt(float(last @ covariance @ last)))
    changes = measured if quantity == "omega" else measured - np.polyval(np.polyfit(even, measured, 1), even)
    errors = np.sqrt(np.diag(covariance))
    return Response(
        "" if cause is None else cause.name,
        "" if cause is None else cause.unit,
        Value(tau, float(errors[len(coefficients)])),
        Value(delay, float(errors[-1])) if delay > 0 else None,
        Value(float(coefficients[1]), float(errors[1])) if several else None,
        final,
        1 - float(rest @ rest) / max(float(np.sum((changes - changes.mean()) ** 2)), 1e-300),
    )


def _end_of_rest(series: Series) -> int:
    """Return the last sample before the speed changes; samples without a smoothed speed at the ends are ignored."""
    known = np.flatnonzero(np.isfinite(series.omega) & np.isfinite(series.omega_sigma))
    if not len(known):
        return 0
    change = np.abs(series.omega[known] - series.omega[known[0]])
    noise = _SIGNIFICANT * np.hypot(series.omega_sigma[known], series.omega_sigma[known[0]])
    moving = np.flatnonzero(change > np.maximum(_REST * float(change.max()), noise))
    return max(int(known[moving[0]]) - 1, 0) if len(moving) else 0


def _delayed(value: Floats, rows: float) -> Floats:
    """Return an input delayed by a number of rows, interpolated linearly for a fraction of a row."""
    whole = int(rows)
    part = rows - whole
    shifted = [np.concatenate([np.full(k, value[0]), value[: len(value) - k]]) for k in (whole, whole + 1)]
    return (1 - part) * shifted[0] + part * shifted[1]


def _integrated(time: Floats, speed: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])


def _inflation(rest: Floats) -> float:
    """Return the factor by which correlated residuals increase a variance: 1 + 2 times the sum of correlations.

    The sum ends before the first correlation that is not positive (the initial positive sequence of C. Geyer, 1992).
    """
    size = float(rest @ rest)
    if not size:
        return 1.0
    spectrum = np.abs(np.fft.rfft(rest, 2 * len(rest))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(rest)] / size
    end = np.flatnonzero(correlation <= 0)
    return float(1 + 2 * correlation[1 : int(end[0]) if len(end) else len(rest)].sum())
