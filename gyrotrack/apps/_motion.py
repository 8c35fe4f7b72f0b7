"""Kind of motion of one body (spin-down, oscillation or steady rotation) and its figures, with uncertainties."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from gyrotrack._correlated_noise import least_squares_of
from gyrotrack._errors import DatasetError

Floats = npt.NDArray[np.float64]

TURN = 2 * math.pi
VIEW = (0.02, 0.02, 0.005)
"""Prior standard deviations of the first three harmonics of the angle in rad: a hub displaced by 2 % of the radius, a
camera tilted by 0.28 rad, and perspective on it."""
_FEWEST = 12
_ORDERS = range(2, 7)


@dataclass(frozen=True)
class Value:
    """A quantity and its standard uncertainty."""

    value: float
    stderr: float


@dataclass(frozen=True)
class BodyMotion:
    """The motion of one body.

    Attributes
    ----------
    kind : {"spin-down", "oscillation", "steady"}
        What the motion is.
    turns : float
        Distance between the extreme angles in turns.
    omega : dict
        Angular velocity at the "first" and the "last" sample [rad/s].
    omega_mean : Value
        Mean angular velocity [rad/s].
    alpha : Value
        Angular acceleration at the middle of the record [rad/s2].
    period, amplitude, decay : Value or None
        Of an oscillation: period [s], amplitude at the middle of the record [rad], rate of decay [1/s].
    quality_factor : Value or None
        Of an oscillation that decays: pi / (decay period), 2 pi times the energy over its loss in a period [1].
    """

    kind: str
    turns: float
    omega: dict[str, float]
    omega_mean: Value
    alpha: Value
    period: Value | None = None
    amplitude: Value | None = None
    decay: Value | None = None
    quality_factor: Value | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        period, decay = self.period, self.decay
        if period is None or decay is None or decay.value <= decay.stderr:
            return
        quality = math.pi / (decay.value * period.value)
        relative = math.hypot(decay.stderr / decay.value, period.stderr / period.value)
        object.__setattr__(self, "quality_factor", Value(quality, quality * relative))


def motion_of(time: Floats, angle: Floats, sigma: Floats) -> BodyMotion:
    """Describe a motion.

    Parameters
    ----------
    time, angle, sigma : ndarray, shape (n,)
        Time [s], unwrapped angle and its standard uncertainty [rad].

    Notes
    -----
    A rotation is fitted by a polynomial in time (of order 2 to 6, by the Bayesian information criterion) and the first
    three harmonics of the angle, which a displaced hub and a tilted camera add. The harmonics have a Gaussian prior of
    `VIEW`, so that over less than two turns, where they resemble the polynomial, they enter the uncertainty with their
    plausible size. A rotation is steady where the angular acceleration is less than three standard errors from zero.
    An oscillation is a exp(-d t) cos(2 pi t / P + phi) about a mean that may drift.

    Raises
    ------
    DatasetError
        There are fewer than 12 samples.
    """
    if len(time) < _FEWEST:
        raise DatasetError(
            f"The motion has {len(time)} samples; {_FEWEST} are needed.", "Give a longer record."
        )
    t = time - 0.5 * (time[0] + time[-1])
    turns = float(np.ptp(angle)) / TURN
    omega, mean, alpha = _rotation(t, angle, sigma)
    oscillation = _oscillation(t, angle, sigma)
    if oscillation is not None:
        period, amplitude, decay, ends, rest = oscillation
        if _reverses(t, angle, period.value) and rest < 0.2 * np.var(angle):
            return BodyMotion("oscillation", turns, ends, mean, alpha, period, amplitude, decay)
    change = abs(omega["last"] - omega["first"])
    steady = abs(alpha.value) < 3 * alpha.stderr or change < 0.01 * abs(mean.value)
    return BodyMotion("steady" if steady else "spin-down", turns, omega, mean, alpha)


def _reverses(t: Floats, angle: Floats, period: float) -> bool:
    """Tell whether the body turns back at least twice, and does not get ahead while it does."""
    net, path = abs(angle[-1] - angle[0]), float(np.abs(np.diff(angle)).sum())
    return bool(np.ptp(t) > 1.2 * period and net < 0.6 * path)


def _rotation(t: Floats, angle: Floats, sigma: Floats) -> tuple[dict[str, float], Value, Value]:
    half = max(abs(t[0]), abs(t[-1]))
    x = t / half
    psi = angle - angle[len(angle) // 2]
    # of the smooth motion: a harmonic of the measured angle would contain that angle's own noise
    smooth = np.polynomial.Polynomial.fit(x, psi, min(6, len(t) // 3))(x)
    harmonics = np.stack([f(k * smooth) for k in range(1, len(VIEW) + 1) for f in (np.cos, np.sin)], axis=1)
    most = max(order for order in _ORDERS if order == _ORDERS[0] or len(t) >= 2 * (order + 1))
    view = harmonics.shape[1]
    design = np.concatenate([harmonics, x[:, None] ** np.arange(most + 1)], axis=1)
    prior = np.concatenate([np.repeat(VIEW, 2), np.full(most + 1, np.inf)])
    models = [list(range(view + order + 1)) for order in range(_ORDERS[0], most + 1)]
    fits = least_squares_of(t, design, psi, sigma, models, prior, smooth)
    order, fit = min(enumerate(fits, _ORDERS[0]), key=lambda pair: pair[1].criterion)

    def row(values: list[float]) -> Floats:
        return np.concatenate([np.zeros(view), values])

    ends = [fit.of(row([k * e ** max(k - 1, 0) / half for k in range(order + 1)]))[0] for e in (x[0], x[-1])]
    mean = Value(*fit.of(row([(x[-1] ** k - x[0] ** k) / (t[-1] - t[0]) for k in range(order + 1)])))
    alpha = Value(*fit.of(row([0.0, 0.0, 2 / half**2, *[0.0] * (order - 2)])))
    return {"first": ends[0], "last": ends[1]}, mean, alpha


def _oscillation(
    t: Floats, angle: Floats, sigma: Floats
) -> tuple[Value, Value, Value, dict[str, float], float] | None:
    """Fit a damped oscillation about a drifting mean; None where there is none."""
    even = np.linspace(t[0], t[-1], len(t))
    value = np.interp(even, t, angle)
    value = value - np.polyval(np.polyfit(even, value, 1), even)
    power = np.abs(np.fft.rfft(value * np.hanning(len(value)), 8 * len(value))) ** 2
    frequency = np.fft.rfftfreq(8 * len(value), even[1] - even[0])
    valid = frequency > 0.7 / np.ptp(t)
    if not valid.any():
        return None
    start = float(frequency[valid][np.argmax(power[valid])])

    def model(c: Floats, t: Floats) -> Floats:
        wave = c[2] * np.cos(TURN * c[0] * t) + c[3] * np.sin(TURN * c[0] * t)
        return np.asarray(np.exp(-c[1] * t) * wave + c[4] + c[5] * t)

    c0 = np.array([start, 0.0, 0.0, 0.0, 0.0, 0.0])
    linear = np.stack([np.cos(TURN * start * t), np.sin(TURN * start * t), np.ones_like(t), t], axis=1)
    c0[2:] = np.linalg.lstsq(linear, angle, rcond=None)[0]
    limit = 5.0 / np.ptp(t)
    lower = [0.5 * start, -limit, *[-np.inf] * 4]
    upper = [2 * start, 4 * limit, *[np.inf] * 4]

    def residual(c: Floats) -> Floats:
        return (model(c, t) - angle) / sigma

    found = least_squares(residual, c0, x_scale=np.maximum(np.abs(c0), 1e-3), bounds=(lower, upper))
    c, rest = found.x, angle - model(found.x, t)
    jacobian: Floats = np.asarray(found.jac, dtype=np.float64) * sigma[:, None]
    free = np.full(6, np.inf)
    (fit,) = least_squares_of(t, jacobian, rest, sigma, [list(range(6))], free)
    c = c + fit.value
    size = float(np.hypot(c[2], c[3]))
    one = np.eye(6)
    frequency_error, decay = fit.of(one[0])[1], Value(float(c[1]), fit.of(one[1])[1])
    amplitude = Value(size, fit.of((c[2] * one[2] + c[3] * one[3]) / max(size, 1e-300))[1])
    short = 1e-4 / float(c[0])
    first, last = ((model(c, e + short) - model(c, e - short)) / (2 * short) for e in (t[0], t[-1]))
    ends = {"first": float(first), "last": float(last)}
    return (
        Value(1 / float(c[0]), frequency_error / float(c[0]) ** 2),
        amplitude,
        decay,
        ends,
        float(np.var(rest)),
    )


def start_of_motion(time: Floats, angle: Floats, sigma: Floats) -> int:
    """Return the first sample of the free motion: what a hand or a motor speeds up before it is left out.

    The speed over windows of a fiftieth of the record (5 samples at least) rises to its largest in the first half of
    the record by more than 5 % and 5 standard errors; an oscillation is never cut.
    """
    width = max(5, len(time) // 50)
    edges = np.arange(0, len(time) - width + 1, width)
    if len(edges) < 8:
        return 0
    speed = np.array([np.polyfit(time[i : i + width], angle[i : i + width], 1)[0] for i in edges])
    duration = float(np.median(np.diff(time))) * width
    error = float(np.median(sigma)) * math.sqrt(12 / width) / duration
    size = np.abs(speed)
    if (
        speed.min() < -5 * error
        and speed.max() > 5 * error
        and min(-speed.min(), speed.max()) > 0.2 * size.max()
    ):
        return 0
    top = int(np.argmax(size))
    late = float(np.median(size[len(size) // 2 :]))
    rises = size[top] - size[0] > max(0.05 * size[top], 5 * error)
    if top == 0 or top > len(size) // 2 or not rises or late > 0.98 * size[top]:
        return 0
    return int(edges[top])
