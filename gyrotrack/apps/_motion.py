"""Kind of motion of one body (spin-down, oscillation or steady rotation) and its parameters, with uncertainties."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Legendre
from numpy.polynomial.legendre import legvander
from scipy.optimize import least_squares

from gyrotrack._correlated_noise import Estimate, correlated_least_squares
from gyrotrack._errors import DatasetError
from gyrotrack.io.readers._plausibility import rises
from gyrotrack.io.readers._pulses import Passages
from gyrotrack.io.readers._run import end_of_oscillation, start_of_oscillation, upward_crossings
from gyrotrack.tracking._tracked import white_noise

Floats = npt.NDArray[np.float64]

TURN = 2 * math.pi
# prior standard deviations of the first three harmonics of the angle [rad]: a hub displaced by 2 % of the radius, a
# camera tilt of 0.28 rad, and the perspective of this tilt
VIEW = (0.02, 0.02, 0.005)
# smallest number of samples of a motion: the fit of a quadratic in time then has seven degrees of freedom
_FEWEST_SAMPLES = 10
_MIN_SAMPLES = 12  # smallest number of samples in a window
_ROUNDING = 1e-6  # smallest range of a harmonic of the angle that exceeds rounding errors
_ORDERS = range(2, 17)
_SPEED_ORDERS = range(1, 16)
# Highest degree for the speed in a record of few turns. A polynomial of degree n resembles n / 2 periods, but errors
# that repeat with the angle have one or more periods per turn.
_FEWEST_DEGREES = 5.0
# candidate degrees of the polynomials in time for phase and logarithm of the amplitude of an oscillation
_WAVE_ORDERS = ((1, 1), (3, 2), (5, 3), (8, 4))
# the data do not separate two degrees if their criteria differ by less than this value (R. Kass, A. Raftery, 1995)
_INSEPARABLE = 10.0
# degrees of the polynomials in the fit in growing windows; polynomials of higher degree extrapolate badly
_TRACKED_ORDERS = _WAVE_ORDERS[2]
# highest degree of the polynomials for times and durations of passages through a light gate
_PASSAGE_ORDER = 4
# length of the part that determines the angular velocity at an end of the record [share of the duration]
_END = 0.05
# limits for a fluctuating speed: smallest number of turns; smallest rise, as a share of the largest speed and in
# standard errors; smallest number of rises
_FLUCTUATING_TURNS, _RISE, _RISE_SIGMA, _FEWEST_RISES = 2.0, 0.05, 6.0, 2
# number of neighbouring deviations from a mean speed that count as a single one, because they are correlated
_ALIKE = 4
_MIN_WINDOWS, _MAX_WINDOWS = 12, 100  # numbers of windows of whole periods for the demodulation of residuals
_FIRST_PERIODS = 1.5  # half length of the first window [periods]
_MAX_LOG_AMPLITUDE = 50.0
# A motion that is not a damped oscillation reverses repeatedly if it often passes the middle of its range upwards. The
# limits are the smallest number of passages, the hysteresis [share of the range], and the smallest range [standard
# uncertainties of an angle].
_PASSAGES, _HYSTERESIS, _LEAST_RANGE = 3, 0.2, 40.0
# Largest share of the variance of an angle, without noise, that may remain in the residuals of a fitted damped
# oscillation. The numbers are the limit for few periods, the number of periods that count as several, and the limit for
# several periods. The harmonics of a pendulum with an amplitude of 176 degrees have 0.023. Over few periods, the first
# links of two double pendulums have 0.06 and 0.11; an oscillation that was disturbed within eight periods has 0.07
_UNEXPLAINED, _SEVERAL_PERIODS, _UNEXPLAINED_OF_SEVERAL = 0.04, 4.0, 0.2


@dataclass(frozen=True)
class Value:
    """A quantity and its standard uncertainty."""

    value: float  #: Value [unit of the quantity].
    stderr: float  #: Standard uncertainty of the value [unit of the quantity].


@dataclass(frozen=True)
class BodyMotion:
    """The motion of one body; if only passages of light gates were measured, values that need angles are unknown."""

    kind: str  #: `spin-down`, `spin-up`, `steady`, `oscillation`, `reversing`, `fluctuating` or `driven`.
    turns: float  #: Range of the angle [turns].
    omega: dict[str, float]  #: Angular velocity at the `first` and the `last` sample [rad s-1].
    omega_mean: Value  #: Mean angular velocity [rad s-1].
    alpha: Value  #: Angular acceleration at the middle of the record [rad s-2].
    period: Value | None = None  #: Period of an oscillation [s].
    #: Amplitude of an oscillation, the deflection of its turning points, at the middle of the record [rad].
    amplitude: Value | None = None
    decay: Value | None = None  #: Decay rate of an oscillation [s-1].
    #: Standard uncertainty of `omega`; unknown for an oscillation [rad s-1].
    omega_u: dict[str, float] = field(default_factory=lambda: dict.fromkeys(("first", "last"), math.nan))
    #: Quality factor pi / (decay rate x period) of a decaying oscillation [1].
    quality_factor: Value | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        period, decay = self.period, self.decay
        if period is None or decay is None or decay.value <= decay.stderr:
            return
        quality = math.pi / (decay.value * period.value)
        relative = math.hypot(decay.stderr / decay.value, period.stderr / period.value)
        object.__setattr__(self, "quality_factor", Value(quality, quality * relative))


def motion_of(time: Floats, angle: Floats, sigma: Floats) -> BodyMotion:
    """Describe a motion from at least 10 times [s], unwrapped angles and standard uncertainties of the angles [rad].

    A rotation is fitted by a polynomial in time (of degree 2 to 16, by the criterion of Hannan and Quinn) and three
    harmonics of the angle, which a displaced hub and a tilted camera cause. The harmonics have Gaussian priors of
    widths `VIEW`. Over less than two turns they are nearly collinear with the polynomial, and the priors limit their
    contribution to the uncertainty. A rotation is steady if the angular acceleration is consistent with zero (three
    standard errors). An oscillation with amplitude A, decay rate d and period P is A exp(-d t) cos(2 pi t / P + phi)
    about a mean that may drift. If the criterion selects a higher degree, phase and logarithm of the amplitude are
    polynomials in time of this degree. Period, amplitude and decay rate are given for the middle of the record. A
    motion that passes the middle of its range repeatedly, but is not such an oscillation (beats, a drive), has no
    period, amplitude or decay rate. A motion that turns back, but is recorded over too few periods for these decisions,
    is "reversing". A rotation is "fluctuating" if its speed rises and falls repeatedly, and neither friction nor the
    view of the camera explains this. The speeds at its ends are then local slopes, and the mean speed is the angle of
    rotation divided by the time.
    """
    if len(time) < _FEWEST_SAMPLES:
        what = f"The motion has {len(time)} samples; {_FEWEST_SAMPLES} are needed."
        raise DatasetError(what, "Give a longer record.")
    t = time - 0.5 * (time[0] + time[-1])
    turns = float(np.ptp(angle)) / TURN
    first, last, mean, alpha = _rotation(t, angle, sigma)
    omega, omega_u = _ends(first, last)
    oscillation = _oscillation(t, angle, sigma)
    if oscillation is not None:
        period, amplitude, decay, ends, curve = oscillation
        noise = np.fmin(float(np.median(sigma)), white_noise(angle, time))
        left = float(np.var(angle - curve)) - noise**2
        several = float(np.ptp(time)) > _SEVERAL_PERIODS * period.value
        most = _UNEXPLAINED_OF_SEVERAL if several else _UNEXPLAINED
        if _reverses(t, curve, period.value) and left < most * np.var(angle):
            return BodyMotion("oscillation", turns, ends, mean, alpha, period, amplitude, decay)
    if np.ptp(angle) > _LEAST_RANGE * np.median(sigma):
        passages = upward_crossings(angle - 0.5 * (angle.min() + angle.max()), _HYSTERESIS)
        if len(passages) >= _PASSAGES:
            return BodyMotion("oscillation", turns, omega, mean, alpha)
    if fluctuates(time, angle, sigma):
        omega, omega_u = _ends(*(_slope_at(t, angle, place) for place in (0, -1)))
        return BodyMotion(
            "fluctuating", turns, omega, _mean_speed(time, angle, sigma), alpha, omega_u=omega_u
        )
    windows = window_speeds(time, angle, sigma, fewest=2)  # two windows are sufficient to show a reversal
    reversing = windows is not None and (
        _turns_back(*windows[1:]) or _turns_back_by_a_turn(angle, *windows[1:])
    )
    kind = "reversing" if reversing else _kind(omega, omega_u, mean, alpha)
    return BodyMotion(kind, turns, omega, mean, alpha, omega_u=omega_u)


def _kind(omega: dict[str, float], omega_u: dict[str, float], mean: Value, alpha: Value) -> str:
    """Return the kind of a rotation: "steady" without a significant change of speed, else "spin-up" or "spin-down"."""
    change = abs(omega["last"]) - abs(omega["first"])
    apart = abs(change) > 3 * math.hypot(omega_u["first"], omega_u["last"])
    if abs(change) < 0.01 * abs(mean.value) or (abs(alpha.value) < 3 * alpha.stderr and not apart):
        return "steady"
    return "spin-up" if change > 0 else "spin-down"


def fluctuates(time: Floats, angle: Floats, sigma: Floats) -> bool:
    """Return whether the speed of a rotation in one sense rises repeatedly, for example with a motor.

    Friction never makes a body faster. An unbalance, a displaced hub and a tilted camera cause harmonics of the angle
    with slowly varying amplitudes, in which the speed rises. The speed must therefore rise both with the harmonics and
    without them. Two rises by more than 5 % of the largest speed and 6 standard errors are required; the speeds are
    means over windows of a fiftieth of the record.
    """
    if np.ptp(angle) < _FLUCTUATING_TURNS * TURN or not _rises_repeatedly(time, angle, sigma):
        return False
    x = np.linspace(-1.0, 1.0, len(angle))
    even = (time - time[0]) / (time[-1] - time[0]) * 2.0 - 1.0
    smooth = np.polynomial.Polynomial.fit(even, angle, 6)(even)
    waves = [f(k * angle) * x**j for k in range(1, 4) for f in (np.cos, np.sin) for j in range(3)]
    rows = np.stack([*waves, *(even**k for k in range(7))], axis=1)
    if len(angle) < 4 * rows.shape[1]:
        return False
    # over few turns the harmonics resemble the motion, and their subtraction causes spurious rises of the speed
    found = np.linalg.lstsq(rows, angle - smooth, rcond=None)[0]
    return _rises_repeatedly(time, angle - rows[:, : len(waves)] @ found[: len(waves)], sigma)


def _rises_repeatedly(time: Floats, angle: Floats, sigma: Floats) -> bool:
    """Return whether the speed of a body that does not turn back rises repeatedly."""
    windows = window_speeds(time, angle, sigma)
    if windows is None:
        return False
    _, speed, error = windows
    if _turns_back(speed, error):
        return False
    size = np.abs(speed)
    return rises(size, max(_RISE * float(size.max()), _RISE_SIGMA * error)) >= _FEWEST_RISES


def _slope_at(t: Floats, angle: Floats, place: int) -> Value:
    """Return the mean angular velocity over the first (0) or last (-1) twentieth of a record."""
    count = max(int((np.abs(t - t[place]) < _END * (t[-1] - t[0])).sum()), _MIN_SAMPLES)
    near = slice(0, count) if place == 0 else slice(len(t) - count, len(t))
    (slope, _), covariance = np.polyfit(t[near], angle[near], 1, cov="unscaled")
    rest = angle[near] - np.polyval(np.polyfit(t[near], angle[near], 1), t[near])
    # the variance is increased, because neighbouring deviations from a constant speed are correlated
    variance = float(rest @ rest) / max(count - 2, 1) * min(count, _ALIKE)
    return Value(float(slope), math.sqrt(float(covariance[0, 0]) * variance))


def _mean_speed(time: Floats, angle: Floats, sigma: Floats) -> Value:
    """Return the angle of rotation divided by the time, with the uncertainties of the first and the last angle."""
    length = float(time[-1] - time[0])
    error = math.hypot(sigma[0], sigma[-1], math.sqrt(2.0) * VIEW[0])
    return Value(float(angle[-1] - angle[0]) / length, error / length)


def _ends(first: Value, last: Value) -> tuple[dict[str, float], dict[str, float]]:
    """Return the angular velocities at the ends of a record, and their standard uncertainties."""
    return {"first": first.value, "last": last.value}, {"first": first.stderr, "last": last.stderr}


def motion_of_speeds(time: Floats, omega: Floats, sigma: Floats, angle: Floats) -> BodyMotion:
    """Describe a motion from measured angular velocities and their standard uncertainties [rad/s].

    The speeds of a rotation are fitted by a polynomial in time (of degree 1 to 15, by the criterion of Hannan and
    Quinn). The integral of the speeds, `angle`, determines the kind of motion, and the period and decay of an
    oscillation; the errors of this integral accumulate.
    """
    step = np.append(np.diff(time), time[-1] - time[-2])
    whole = motion_of(time, angle, np.full(len(time), float(np.median(sigma * step))))
    if whole.kind == "oscillation":
        return whole
    half = 0.5 * float(time[-1] - time[0])
    x = (time - 0.5 * (time[0] + time[-1])) / half
    most = _highest(_SPEED_ORDERS, min(len(time) // 2 - 2, _free_degrees(whole.turns)))
    orders = range(_SPEED_ORDERS[0], most + 1)
    models = [list(range(order + 1)) for order in orders]
    fits = correlated_least_squares(
        x * half, legvander(x, most), omega, sigma, models, np.full(most + 1, np.inf)
    )

    def averaged(row: Floats) -> Value:
        """Average a combination of coefficients over the models; `row` also has an entry for the next higher degree."""
        value = _averaged(fits, [row[: order + 1] for order in orders])
        return Value(value.value, math.hypot(value.stderr, missing * row[most + 1]))

    missing = _next_coefficient(fits)
    first, last = (averaged(legvander(np.array([end]), most + 1)[0]) for end in (-1.0, 1.0))
    mean = averaged(np.eye(most + 2)[0])
    alpha = averaged(_derivatives(most + 1, 1, 0.0) / half)
    ends, ends_u = _ends(first, last)
    kind = _kind(ends, ends_u, mean, alpha)
    return BodyMotion(kind, whole.turns, ends, mean, alpha, omega_u=ends_u)


def motion_of_passages(passages: Passages) -> BodyMotion:
    """Return the period and the decay rate of a pendulum from its passages through light gates.

    Pairs of neighbouring passages in opposite directions are averaged. If the gates are at a distance from the
    equilibrium, one passage of a pair is too late and the other passage is too early. The durations of the passages are
    inversely proportional to the amplitude. The times of the pairs, and the logarithms of the durations, are fitted by
    polynomials in the number of the passage. Period and decay rate are given for the middle of the record. A
    DatasetError is raised if too few passages are consecutive.
    """
    t, duration = passages.time, passages.duration
    half = 0.5 * float(np.median(t[2:] - t[:-2]))
    number = np.concatenate([[0], np.cumsum(np.maximum(np.round(np.diff(t) / half), 1))])
    first = np.arange(0, len(t) - 1, 2)
    first = first[np.diff(number)[first] == 1]
    if len(first) < _MIN_SAMPLES:
        what = f"{passages.path} contains {len(first)} pairs of passages; {_MIN_SAMPLES} are needed."
        raise DatasetError(what, "Give a longer recording.")
    when, size = (0.5 * (v[first] + v[first + 1]) for v in (t, -np.log(duration)))
    count = number[first] + 0.5
    x = 2 * (count - count[0]) / (count[-1] - count[0]) - 1
    design = x[:, None] ** np.arange(_PASSAGE_ORDER + 1)
    models = [list(range(order + 1)) for order in range(1, _PASSAGE_ORDER + 1)]
    free = np.full(_PASSAGE_ORDER + 1, np.inf)
    slopes = []
    for values in (when, size):
        fits = correlated_least_squares(count, design, values, np.ones(len(values)), models, free)
        best = min(fits, key=lambda fit: fit.criterion)
        slopes.append(Value(*best.of(np.eye(len(best.value))[1])))
    by_time, by_size = slopes
    period = 4 * by_time.value / (count[-1] - count[0])
    relative = by_time.stderr / by_time.value
    decay = -by_size.value / by_time.value
    unknown, ends = Value(math.nan, math.nan), dict.fromkeys(("first", "last"), math.nan)
    return BodyMotion(
        "oscillation",
        math.nan,
        ends,
        unknown,
        unknown,
        Value(period, period * relative),
        None,
        Value(decay, math.hypot(by_size.stderr / by_time.value, decay * relative)),
    )


def _reverses(t: Floats, curve: Floats, period: float) -> bool:
    """Return whether the fitted curve of a motion reverses repeatedly without net rotation."""
    net, path = abs(curve[-1] - curve[0]), float(np.abs(np.diff(curve)).sum())
    return bool(np.ptp(t) > 1.2 * period and net < 0.6 * path)


def _rotation(t: Floats, angle: Floats, sigma: Floats) -> tuple[Value, Value, Value, Value]:
    """Return the angular velocity at both ends, its mean, and the angular acceleration at the middle."""
    half = max(abs(t[0]), abs(t[-1]))
    x = t / half
    psi = angle - angle[len(angle) // 2]
    # harmonics of the smoothed angle, because harmonics of the measured angle would be correlated with its noise
    smooth = np.polynomial.Polynomial.fit(x, psi, min(6, len(t) // 3))(x)
    # pulses at whole multiples of the period of a harmonic contain no information on this harmonic
    orders = [
        k
        for k in range(1, len(VIEW) + 1)
        if max(np.ptp(np.cos(k * psi)), np.ptp(np.sin(k * psi))) > _ROUNDING
    ]
    harmonics = [f(k * smooth) for k in orders for f in (np.cos, np.sin)]
    most = _highest(_ORDERS, min(len(t) // 2 - 1, 1 + _free_degrees(float(np.ptp(angle)) / TURN)))
    view = len(harmonics)
    design = np.concatenate([np.reshape(harmonics, (view, len(t))).T, legvander(x, most)], axis=1)
    prior = np.array([s for k in orders for s in (VIEW[k - 1], VIEW[k - 1])] + [np.inf] * (most + 1))
    degrees = range(_ORDERS[0], most + 1)
    fits = correlated_least_squares(
        t, design, psi, sigma, [list(range(view + degree + 1)) for degree in degrees], prior, smooth
    )

    def averaged(row: Floats) -> Value:
        """Average a combination of coefficients over the models; `row` also has an entry for the next higher degree."""
        value = _averaged(fits, [np.concatenate([np.zeros(view), row[: degree + 1]]) for degree in degrees])
        return Value(value.value, math.hypot(value.stderr, missing * row[most + 1]))

    missing = _next_coefficient(fits)
    ends = [averaged(_derivatives(most + 1, 1, place) / half) for place in (x[0], x[-1])]
    best = min(fits, key=lambda fit: fit.hannan_quinn)
    smoothed = angle
    # over fewer turns the harmonics cannot be separated from the motion
    if np.ptp(angle) > _FLUCTUATING_TURNS * TURN:
        smoothed = angle - design[:, :view] @ best.value[:view]
    for i, place in enumerate((0, -1)):
        local = _speed_at(t, smoothed, sigma, place)
        # a polynomial through the whole record may oscillate at its ends
        if abs(local.value - ends[i].value) > 3 * local.stderr:
            # the local speed may also be wrong, because it includes the harmonics of the angle; therefore both
            # uncertainties are added
            ends[i] = Value(local.value, math.hypot(local.stderr, ends[i].stderr))
    mean = averaged((legvander(x[-1:], most + 1)[0] - legvander(x[:1], most + 1)[0]) / (t[-1] - t[0]))
    alpha = averaged(_derivatives(most + 1, 2, 0.0) / half**2)
    return *ends, mean, alpha  # type: ignore[return-value]  # two ends


def _free_degrees(turns: float) -> float:
    """Return the highest degree at which a polynomial in time varies more slowly than the harmonics of the angle."""
    return max(_FEWEST_DEGREES, turns)


def _highest(orders: range, most: float) -> int:
    return max(order for order in orders if order == orders[0] or order <= most)


def _derivatives(most: int, order: int, place: float) -> Floats:
    """Return derivatives of the Legendre polynomials of degree 0 to `most` at a place, (most + 1,)."""
    return np.asarray([float(Legendre.basis(k).deriv(order)(place)) for k in range(most + 1)])


def _next_coefficient(fits: Sequence[Estimate]) -> float:
    """Return the plausible size of the next coefficient after the polynomial of highest degree; 0 if it is not needed.

    The coefficients c of a smooth motion decrease geometrically. With the highest degree n, the next coefficient is
    therefore c_n^2 / c_(n-1), and at most c_n. It is needed if the polynomial of degree n is the best, because further
    degrees may then be significant.
    """
    if len(fits) < 2 or fits[-1].hannan_quinn > min(fit.hannan_quinn for fit in fits):
        return 0.0
    before, last = np.abs(fits[-1].value[-2:])
    return float(last * min(last / max(before, 1e-300), 1.0))


def _averaged(fits: Sequence[Estimate], rows: Sequence[Floats]) -> Value:
    """Return a combination of coefficients, averaged over models with weights exp(-HQ / 2).

    HQ is the criterion of Hannan and Quinn. The motion is not exactly a polynomial, and the Bayesian criterion drops
    terms that are still noticeable at the ends of the record. The variance is the mean variance plus the variance of
    the values, because the degree is unknown (J. Hoeting et al., Stat. Sci. 14, 382 (1999)).
    """
    criterion = np.array([fit.hannan_quinn for fit in fits])
    weight = np.exp(-0.5 * (criterion - criterion.min()))
    weight /= weight.sum()
    value, u = np.array([fit.of(row) for fit, row in zip(fits, rows, strict=True)]).T
    mean = float(weight @ value)
    return Value(mean, math.sqrt(float(weight @ (u**2 + (value - mean) ** 2))))


def _speed_at(t: Floats, angle: Floats, sigma: Floats, place: int) -> Value:
    """Return the angular velocity at the first (0) or last (-1) sample.

    A cubic is fitted to this end of the record. The fitted part is shortened while a quartic describes it better. The
    noise may be correlated.
    """
    count = int((np.abs(t - t[place]) < _END * (t[-1] - t[0])).sum())
    cubic, quartic = list(range(4)), list(range(5))
    while True:
        count = max(count, min(_MIN_SAMPLES, len(t)))
        near = slice(0, count) if place == 0 else slice(len(t) - count, len(t))
        half = 0.5 * float(np.ptp(t[near]))
        x = (t[near] - 0.5 * (t[near][0] + t[near][-1])) / half
        free = np.full(5, np.inf)
        fits = correlated_least_squares(
            x * half, legvander(x, 4), angle[near] - angle[near][0], sigma[near], [cubic, quartic], free
        )
        bend, u = fits[1].of(np.eye(5)[4])
        if abs(bend) < 3 * u or count < 2 * _MIN_SAMPLES:
            return Value(*fits[0].of(_derivatives(3, 1, x[place]) / half))
        count //= 2


@dataclass(frozen=True)
class _Wave:
    """A damped oscillation about a drifting mean.

    With t = 0 at the middle of the record, and x = t / half of the record, the angle is

        exp(-d t - sum d_k x^k) [a cos phi + b sin phi] + m + n t,  phi = 2 pi f t + sum c_k x^k,

    with k from 2 to `phase` in phi, and from 2 to `envelope` in the exponent. Frequency and decay rate depend on the
    amplitude if the restoring torque or the friction is not linear.
    """

    half: float
    phase: int
    envelope: int

    @property
    def size(self) -> int:
        return 4 + self.phase + self.envelope

    def _parts(self, c: Floats, t: Floats) -> tuple[Floats, Floats, Floats]:
        x, split = t / self.half, 5 + self.phase
        phi = TURN * c[0] * t + sum(a * x**k for k, a in enumerate(c[6:split], 2))
        decay = c[1] * t + sum(a * x**k for k, a in enumerate(c[split:], 2))
        return np.exp(np.clip(-decay, -_MAX_LOG_AMPLITUDE, _MAX_LOG_AMPLITUDE)), np.cos(phi), np.sin(phi)

    def __call__(self, c: Floats, t: Floats) -> Floats:
        size, cos, sin = self._parts(c, t)
        return np.asarray(size * (c[2] * cos + c[3] * sin) + c[4] + c[5] * t)

    def jacobian(self, c: Floats, t: Floats) -> Floats:
        """Return the derivatives with respect to the parameters, shape (n, parameters)."""
        size, cos, sin = self._parts(c, t)
        by_phase, by_decay = size * (c[3] * cos - c[2] * sin), -size * (c[2] * cos + c[3] * sin)
        powers = [(t / self.half) ** k for k in range(2, max(self.phase, self.envelope) + 1)]
        first = [TURN * t * by_phase, t * by_decay, size * cos, size * sin, np.ones_like(t), t]
        later = [by_phase * x for x in powers[: self.phase - 1]] + [
            by_decay * x for x in powers[: self.envelope - 1]
        ]
        return np.stack([*first, *later], axis=1)

    def third_harmonic(self, c: Floats, t: Floats, rest: Floats) -> Value:
        """Return the third harmonic of the residuals at a turning point in the middle of the record, if significant.

        It is proportional to the cube of the amplitude. In a pendulum, it moves the turning points inwards.
        """
        size, cos, sin = self._parts(c, t)
        wave = (c[2] + 1j * c[3]) / max(float(np.hypot(c[2], c[3])), 1e-300)
        third = size**3 * (wave.conjugate() * (cos + 1j * sin)) ** 3
        columns = np.stack([third.real, third.imag], axis=1)
        found = np.linalg.lstsq(columns, rest, rcond=None)[0]
        left = rest - columns @ found
        u = float(np.sqrt(left @ left / len(t) / (third.real @ third.real)))
        significant = abs(found[0]) > _RISE_SIGMA * u
        return Value(float(found[0]), u) if significant else Value(0.0, 0.0)

    def errors(
        self, c: Floats, t: Floats, rest: Floats, sigma: Floats
    ) -> tuple[float, tuple[float, float, float]]:
        """Return the Bayesian information criterion, and the uncertainties of frequency, decay rate and amplitude.

        Model errors change slowly in amplitude and in phase. The residuals are therefore demodulated in windows of
        whole periods. The component in phase with the oscillation determines the amplitude, the component in quadrature
        determines the phase, and each component has its own correlated noise. For fewer than `_MIN_WINDOWS` periods the
        correlated noise is modelled as a harmonic of the phase with a slowly varying amplitude.
        """
        jacobian, one = self.jacobian(c, t), np.eye(self.size)
        size = max(float(np.hypot(c[2], c[3])), 1e-300)
        along, across = (c[2] * one[2] + c[3] * one[3]) / size, (c[3] * one[2] - c[2] * one[3]) / size
        _, cos, sin = self._parts(c, t)
        in_phase, quadrature = ((a * cos + b * sin) / size for a, b in ((c[2], c[3]), (-c[3], c[2])))
        phase = np.unwrap(np.arctan2(quadrature, in_phase))
        count = min(int(abs(phase[-1] - phase[0]) / TURN), _MAX_WINDOWS)
        free = np.full(self.size, np.inf)
        edges = (phase[-1] - phase[0]) * np.arange(count) / max(count, 1)
        # if a model does not describe the motion, its phase may decrease, and there are few windows
        first = np.unique(np.searchsorted(np.maximum.accumulate(phase - phase[0]), edges))
        if len(first) < _MIN_WINDOWS:
            models = [list(range(self.size))]
            (fit,) = correlated_least_squares(t, jacobian, rest, sigma, models, free, phase)
            return fit.criterion, (fit.of(one[0])[1], fit.of(one[1])[1], fit.of(along)[1])
        split, criterion, found = 5 + self.phase, 0.0, []
        of_amplitude = np.stack([along, one[1], *one[split:]])
        of_phase = np.stack([across, one[0], *one[6:split]])
        for wave, parameters in ((in_phase, of_amplitude), (quadrature, of_phase)):
            weight = wave / sigma**2
            total = np.add.reduceat(weight * wave, first)
            columns = np.add.reduceat(weight[:, None] * (jacobian @ parameters.T), first, axis=0)
            when, y = (np.add.reduceat(weight * v, first) / total for v in (wave * t, rest))
            (fit,) = correlated_least_squares(
                when,
                columns / total[:, None],
                y,
                1 / np.sqrt(total),
                [list(range(len(parameters)))],
                free[: len(parameters)],
            )
            criterion += fit.criterion
            found.append(fit)
        of_size, of_angle = found
        unit = np.eye(max(len(of_amplitude), len(of_phase)))
        errors = (
            of_angle.of(unit[1, : len(of_phase)])[1],
            of_size.of(unit[1, : len(of_amplitude)])[1],
            of_size.of(unit[0, : len(of_amplitude)])[1],
        )
        return criterion, errors

    def extended(self, c: Floats, other: _Wave) -> Floats:
        """Convert the parameters of another model of this class; additional parameters are zero."""
        split = 5 + other.phase
        phase = np.zeros(self.phase - 1)
        envelope = np.zeros(self.envelope - 1)
        phase[: min(len(phase), other.phase - 1)] = c[6:split][: len(phase)]
        envelope[: min(len(envelope), other.envelope - 1)] = c[split:][: len(envelope)]
        return np.concatenate([c[:6], phase, envelope])

    def fitted(self, c: Floats, t: Floats, angle: Floats, sigma: Floats) -> Floats:
        """Return the least-squares parameters from the initial values `c`."""
        span = np.ptp(t)
        lower, upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        lower[:2], upper[:2] = (0.5 * c[0], -5.0 / span), (2.0 * c[0], 20.0 / span)
        c = np.clip(c, lower + 1e-12, upper - 1e-12)
        scale = np.maximum(np.abs(c), 1e-3)
        scale[6:] = np.maximum(scale[6:], 1.0)

        def residual(c: Floats) -> Floats:
            return (self(c, t) - angle) / sigma

        def slopes(c: Floats) -> Floats:
            return self.jacobian(c, t) / sigma[:, None]

        found = least_squares(residual, c, slopes, x_scale=scale, bounds=(lower, upper), max_nfev=60)
        return np.asarray(found.x)


def _oscillation(
    t: Floats, angle: Floats, sigma: Floats
) -> tuple[Value, Value, Value, dict[str, float], Floats] | None:
    """Fit a damped oscillation about a drifting mean; None if the record is too short for one.

    The result contains period, amplitude, decay rate, the angular velocities at the ends, and the fitted curve.
    """
    start = _frequency(t, angle)
    if start is None:
        return None
    half = 0.5 * float(np.ptp(t))
    waves = [_Wave(half, *orders) for orders in _WAVE_ORDERS]
    trials = [(waves[0], waves[0].fitted(_sinusoid(start, t, angle), t, angle, sigma))]
    middle = _Wave(half, *_TRACKED_ORDERS)
    tracked = _tracked_oscillation(middle, start, t, angle, sigma)
    if tracked is not None:
        trials += [(w, w.fitted(w.extended(tracked, middle), t, angle, sigma)) for w in waves[1:]]
    found = []
    for wave, c in trials:
        criterion, errors = wave.errors(c, t, angle - wave(c, t), sigma)
        values = float(c[0]), float(c[1]), float(np.hypot(c[2], c[3]))
        found.append((criterion, wave, c, [Value(v, e) for v, e in zip(values, errors, strict=True)]))
    least, wave, c, best = min(found, key=lambda f: f[0])
    rivals = [values for criterion, _, _, values in found if criterion < least + _INSEPARABLE]
    frequency, decay, amplitude = (
        _with_rivals(value, others) for value, others in zip(best, zip(*rivals, strict=True), strict=True)
    )
    third = wave.third_harmonic(c, t, angle - wave(c, t))
    amplitude = Value(amplitude.value + third.value, math.hypot(amplitude.stderr, third.stderr))
    short = 1e-4 / float(c[0])
    first, last = ((wave(c, e + short) - wave(c, e - short)) / (2 * short) for e in (t[0], t[-1]))
    ends = {"first": float(first), "last": float(last)}
    return (
        Value(1 / frequency.value, frequency.stderr / frequency.value**2),
        amplitude,
        decay,
        ends,
        wave(c, t),
    )


def _with_rivals(value: Value, rivals: Sequence[Value]) -> Value:
    """Return a value with its uncertainty increased by the differences from models that the data do not separate.

    Only the part of a difference that exceeds two standard uncertainties of the other model is added, because the
    values of a model with more parameters scatter more.
    """
    beyond = max(max(abs(r.value - value.value) - 2 * r.stderr, 0.0) for r in rivals)
    return replace(value, stderr=math.hypot(value.stderr, beyond))


def _frequency(t: Floats, angle: Floats) -> float | None:
    """Return the frequency [Hz] of the largest spectral peak above 0.7 periods per record; None without a peak."""
    even = np.linspace(t[0], t[-1], len(t))
    value = np.interp(even, t, angle)
    value = value - np.polyval(np.polyfit(even, value, 1), even)
    power = np.abs(np.fft.rfft(value * np.hanning(len(value)), 8 * len(value))) ** 2
    frequency = np.fft.rfftfreq(8 * len(value), even[1] - even[0])
    valid = frequency > 0.7 / np.ptp(t)
    return float(frequency[valid][np.argmax(power[valid])]) if valid.any() else None


def _sinusoid(frequency: float, t: Floats, angle: Floats) -> Floats:
    """Return the least-squares parameters of an undamped sinusoid of a given frequency."""
    arc = TURN * frequency * t
    linear = np.stack([np.cos(arc), np.sin(arc), np.ones_like(t), t], axis=1)
    return np.concatenate([[frequency, 0.0], np.linalg.lstsq(linear, angle, rcond=None)[0]])


def _tracked_oscillation(
    wave: _Wave, frequency: float, t: Floats, angle: Floats, sigma: Floats
) -> Floats | None:
    """Fit an oscillation in a window that grows from the middle of the record to both ends; None for a short record.

    In a window of a few periods the phase is unambiguous, even if frequency and amplitude change outside of the
    window.
    """
    reach = _FIRST_PERIODS / frequency
    first = _Wave(wave.half, 1, 1)
    inside = np.abs(t) <= reach
    if reach >= wave.half or inside.sum() < 2 * wave.size:
        return None
    c = first.fitted(_sinusoid(frequency, t[inside], angle[inside]), t[inside], angle[inside], sigma[inside])
    c = wave.extended(c, first)
    while reach < wave.half:
        reach *= 1.5
        inside = np.abs(t) <= reach
        c = wave.fitted(c, t[inside], angle[inside], sigma[inside])
    return c


def start_of_motion(time: Floats, angle: Floats, sigma: Floats) -> int:
    """Return the first sample of the free motion, after a drive by hand or motor.

    The speeds of a rotation are means over 1/50 of the record, at least 5 samples. The rotation is driven up to the
    maximum of its speed under three conditions: the maximum is in the first half of the record; it exceeds the initial
    speed by more than 5 % and 5 standard errors; and no later rise is half as large. A later rise would indicate a
    motor. The end of the drive is then located to the sample. The free part of an oscillation is determined by
    `start_of_oscillation`.
    """
    windows = window_speeds(time, angle, sigma)
    if windows is None:
        return 0
    edges, speed, error = windows
    size = np.abs(speed)
    if _turns_back(speed, error):
        return start_of_oscillation(time, angle)
    top = int(np.argmax(size))
    late = float(np.median(size[len(size) // 2 :]))
    higher = size[top] - size[0] > max(0.05 * size[top], 5 * error)
    if top == 0 or top > len(size) // 2 or not higher or late > 0.98 * size[top]:
        return 0
    if rises(size[top:], max(_AGAIN * float(size[top] - size[0]), 5 * error)):
        return 0
    # both the window before the maximum and the window of the maximum may be partly driven and partly free
    width = int(edges[1] - edges[0])
    first, last = int(edges[top - 1]), min(int(edges[top]) + (_FREE + 1) * width, len(time))
    start = last - _joins(time[first:last][::-1], angle[first:last][::-1], _FREE * width)
    return start if first < start < last else int(edges[top])


def end_of_motion(time: Floats, angle: Floats, sigma: Floats) -> int:
    """Return the sample from which a body is at rest until the end; without rest, the number of samples.

    For a body that turns back, `end_of_oscillation` decides. Any other body is at rest if its speed over every window
    of a fiftieth of the record is below 2 % of the largest speed, or below 5 standard errors. Rest of less than a
    twentieth of the record is ignored. If the speed falls to rest within one window, the body was stopped, and the
    motion is free up to the last sample before the stop.
    """
    windows = window_speeds(time, angle, sigma)
    if windows is None:
        return len(time)
    if _turns_back(*windows[1:]):
        return end_of_oscillation(time, angle, sigma)
    edges, speed, error = windows
    size = np.abs(speed)
    moving = np.flatnonzero(size > max(0.02 * size.max(), 5 * error))
    last = int(edges[moving[-1] + 1]) if len(moving) and moving[-1] + 1 < len(edges) else len(time)
    if len(time) - last <= len(time) / 20 or last < _MIN_SAMPLES:
        return len(time)
    width = int(edges[1] - edges[0])
    stop = int(moving[-1])
    if stop > _FREE and size[stop - 1] > _ABRUPT * size.max():
        first = int(edges[stop]) - _FREE * width
        joined = _joins(time[first:last], angle[first:last], _FREE * width)
        return first + joined if joined else last
    return last


# number of windows from which a free motion is extrapolated; smallest speed before a stop [share of the largest speed]
_FREE, _ABRUPT = 3, 0.1
# smallest later rise of the speed that indicates a motor, not a drive by hand [share of the first rise]
_AGAIN = 0.5


def _joins(time: Floats, angle: Floats, known: int) -> int:
    """Return the number of samples that continue the motion of the first `known` samples; 0 if `known` is too small.

    The motion is extrapolated by a cubic, and the result includes the first `known` samples. The motion ends before the
    first sample that deviates by more than 6 standard uncertainties of the extrapolation, either from the first `known`
    samples or from all samples before it.
    """
    if known < _MIN_SAMPLES or known > len(time):
        return 0
    end = known + _continued(time, angle, known)
    for count in range(known, end):
        if not _continued(time[: count + 1], angle[: count + 1], count):
            return count
    return end


def _continued(time: Floats, angle: Floats, known: int) -> int:
    """Return the number of samples after the first `known` samples that agree with the cubic through these samples."""
    x = (time - time[0]) / (time[known - 1] - time[0])
    rows = x[:, None] ** np.arange(4)
    found = np.linalg.lstsq(rows[:known], angle[:known], rcond=None)[0]
    off = angle - rows @ found
    variance = float(off[:known] @ off[:known]) / (known - 4)
    inverse = np.linalg.inv(rows[:known].T @ rows[:known])
    error = np.sqrt(variance * (1.0 + np.einsum("ni,ij,nj->n", rows, inverse, rows)))
    away = np.flatnonzero(np.abs(off[known:]) > 6.0 * error[known:])
    return int(away[0]) if len(away) else len(time) - known


def window_speeds(
    time: Floats, angle: Floats, sigma: Floats, fewest: int = 8
) -> tuple[npt.NDArray[np.int64], Floats, float] | None:
    """Return first samples of windows, speeds in them [rad/s], and the error of a speed.

    The result is None for less than `fewest` windows of at least five samples.
    """
    width = max(5, len(time) // 50)
    edges = np.arange(0, len(time) - width + 1, width)
    if len(edges) < fewest:
        return None
    speed = np.array([np.polyfit(time[i : i + width], angle[i : i + width], 1)[0] for i in edges])
    duration = float(np.median(np.diff(time))) * width
    # an error common to all angles, for example due to an error of the hub, cancels in differences
    noise = np.fmin(float(np.median(sigma)), white_noise(angle, time))
    return edges, speed, float(noise) * math.sqrt(12 / width) / duration


def _turns_back(speed: Floats, error: float) -> bool:
    """Return whether the speed in each sense exceeds 5 standard errors and a fifth of the largest speed."""
    fastest = float(np.abs(speed).max())
    return bool(min(-speed.min(), speed.max()) > max(5 * error, 0.2 * fastest))


def _turns_back_by_a_turn(angle: Floats, speed: Floats, error: float) -> bool:
    """Return whether a body turns back by more than a turn, at a speed that is not negligible.

    No error of the hub or of the view makes a body seem to turn back by a turn; therefore a slow return is sufficient.
    """
    sense = 1.0 if angle[-1] >= angle[0] else -1.0
    back = float(np.max(np.maximum.accumulate(sense * angle) - sense * angle))
    slower, fastest = float(np.max(-sense * speed)), float(np.abs(speed).max())
    return back > TURN and slower > max(_RISE_SIGMA * error, _RISE * fastest)
