"""Residuals of a fit: whiteness, unmodelled torque, failing intervals.

The residuals are r = W_c u_c + W_r u_r + noise. The matrices W_c and W_r are the responses of the rows to the
unmodelled torques u_c on the casing and u_r on the rotor. The prior of each torque is an Ornstein-Uhlenbeck process
with a long correlation time; its level is estimated from the residuals. The unmodelled torque is the posterior mean,
with the posterior standard deviation, of this Gaussian process (C. Rasmussen, C. Williams, Gaussian Processes for
Machine Learning, 2.2). Start angles and phases are free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT, Criteria
from fitting._numbers import TORQUE, format_torque, interval, span_of
from fitting.dynamics._collocation import Sampler
from fitting.effects._mechanism import MAIN
from fitting.inference._angle_harmonics import AngleHarmonics
from fitting.inference._case_data import CaseData
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._noise import TorqueNoise, TorqueResponse, decaying_sums, remaining_level
from fitting.inference._problem import Projection
from fitting.inference._record import speeds
from fitting.inference._result import Fit
from fitting.inference._speed_residuals import holds_moving_body, modelled_speed

Array = NDArray[np.float64]

_LAGS = 12
"""Largest lag of the test of independence [blocks]. Chosen: a smaller number overlooks slow correlations, a larger one
lowers the power; the lag is also at most a quarter of the number of blocks."""
_POWERS = 4
"""Number of rows of each block that are tested, lowest order first [1]. Chosen: a smaller number overlooks correlations
within a block, a larger one lowers the power for slow correlations."""


@dataclass(frozen=True)
class Whiteness:
    """Ljung-Box test of the casing's whitened residuals, block by block."""

    label: str  #: Name of the case.
    #: Probability of the Ljung-Box statistic; see G. Ljung, G. Box, Biometrika 65, 297 (1978) [1].
    p_value: float


def whiteness(fit: Fit) -> list[Whiteness]:
    """Return the Ljung-Box test of the residuals of each case."""
    from scipy.special import chdtrc

    results = []
    for data, n, p in zip(fit.problem.data, fit.noise, fit.predictions, strict=True):
        # process noise at the raised level of the fit would absorb a lack of fit
        project = Projection(data, n.whitener.at(n.tested))
        blocks, k, _ = data.casing.lift.shape
        rows = project(p.rows - data.z)[data.slices["casing"]].reshape(blocks, k)[:, :_POWERS]
        lags = min(_LAGS, blocks // 4)
        rows = rows - rows.mean(axis=0)
        power = float((rows**2).sum())
        rho = np.array([float((rows[m:] * rows[:-m]).sum()) / power for m in range(1, lags + 1)])
        weights = _POWERS / (blocks - np.arange(1, lags + 1))
        statistic = float(blocks * (blocks + 2) * (rho**2 * weights).sum())
        results.append(Whiteness(data.record.label, float(chdtrc(max(lags, 1), statistic))))
    return results


_SHARE = 1 / 30
"""Correlation time of the unmodelled torque, divided by the length of the record [1]. Chosen: a smaller value follows
noise, a larger one blurs failing intervals."""
_FLOOR = 3e-3
"""Smallest standard deviation of the unmodelled torque, divided by its prior value [1]. Chosen: rounding errors would
otherwise give negative variances; a larger value hides well-determined torques, a smaller one shows rounding errors."""


@dataclass(frozen=True, repr=False)
class ResidualTorque:
    """Unmodelled torque on one body: times [s], torque and its standard deviation [N m], and the speeds at these times.

    `omega_c` is the speed of the casing or main body, `omega_r` the speed of the rotor or of the next body of a chain.
    """

    label: str
    body: str
    time: Array
    torque: Array
    sigma: Array
    omega_r: Array
    omega_c: Array

    def __repr__(self) -> str:
        return f"ResidualTorque on the {self.body} of {self.label}: {span_of('torque', self.torque, '')}"


def residual_torques(fit: Fit) -> list[ResidualTorque]:
    """Return the unmodelled torque on each body of each case of a fit."""
    return [curve for i in range(len(fit.problem.cases)) for curve in _of_case(fit, i)]


def _of_case(fit: Fit, index: int) -> list[ResidualTorque]:
    data, prediction, noise = fit.problem.data[index], fit.predictions[index], fit.noise[index]
    response = TorqueResponse(data, prediction.motion)
    smooth = data.slices["smooth"]
    residual = data.z - prediction.rows
    time = _SHARE * float(response.edges[-1] - response.edges[0])
    slow = response.whitener(TorqueNoise(0.0, time))
    level = min(remaining_level(slow, residual, data.nuisance)[0], data.largest_torque)
    floor = noise.pure**2 * response.covariance(noise.time) if noise.pure > 0 else 0.0
    covariance = np.eye(smooth.stop) + floor
    # covariance of the rows with the torque of each body, for a torque of rms 1 N m
    responses = response.bodies
    cross = {name: _times_covariance(w, response, time) for name, w in responses.items()}
    for name, w in responses.items():
        covariance = covariance + level**2 * cross[name] @ w.T
    nuisance = data.nuisance[smooth]
    inverse = _inverse_without_nuisance(covariance, nuisance)
    # angles of thousands of turns have rounding errors as large as the effect of a torque; so constants are removed
    # first
    weighted = inverse @ orthogonal_to(orthonormal(nuisance, _RANK), residual[smooth])
    y = Sampler(prediction.path.mesh, response.centres).value(prediction.path.y)
    curves = []
    for body in (b.part for b in data.record.bodies):
        mean = level**2 * cross[body].T @ weighted
        reduction = level**4 * np.einsum("ic,ij,jc->c", cross[body], inverse, cross[body], optimize=True)
        # where the data determine the torque almost completely, the difference of variances is rounding error
        sigma = np.sqrt(np.maximum(level**2 - reduction, (_FLOOR * level) ** 2))
        if body == data.record.mechanism.main and holds_moving_body(fit, index):
            y[:, MAIN], mean, u = _of_the_measured_motion(fit, index, response.centres, y, time)
            sigma = np.hypot(u, noise.pure)
        filmed = _is_filmed(response.centres, data, body)
        values = (v[filmed] for v in (response.centres, mean, sigma, y[:, 0], y[:, MAIN]))
        curves.append(ResidualTorque(data.record.label, body, *values))
    return curves


def _of_the_measured_motion(
    fit: Fit, index: int, times: Array, y: Array, width: float
) -> tuple[Array, Array, Array]:
    """Return the measured speed of the main body, the unmodelled torque I dw/dt - T(w), and the torque uncertainty.

    Speed and acceleration are derivatives of a local polynomial that is fitted to the samples within `width` [s] about
    each time. Its degree is 3 for an angle and 2 for a speed. `y` are the states of the model. The variances of the
    samples are multiplied by chi-square per degree of freedom and by (1 + r) / (1 - r), where r is the correlation of
    successive residuals, if these factors exceed 1.
    """
    case, record = fit.problem.cases[index], fit.problem.data[index].record
    samples, inertia = record.casing, record.inertias[MAIN]
    order = 2 if record.quantity == "angle" else 1  # order of the derivative that is the acceleration
    speed, acceleration, u = np.zeros((3, len(times)))
    for i, t in enumerate(times):
        middle = np.clip(t, samples.time[0] + 0.5 * width, samples.time[-1] - 0.5 * width)
        near = np.abs(samples.time - middle) <= 0.5 * width
        near[np.argsort(np.abs(samples.time - middle))[: order + 4]] = True
        weights = 1 / samples.sigma[near]
        c, covariance = np.polyfit(
            samples.time[near] - t, samples.value[near], order + 1, w=weights, cov="unscaled"
        )
        rest = weights * (samples.value[near] - np.polyval(c, samples.time[near] - t))
        power = float(rest @ rest)
        r = float(rest[1:] @ rest[:-1]) / power if power > 0 else 0.0
        excess = max(power / max(len(rest) - order - 2, 1), 1.0) * max((1 + r) / (1 - r), 1.0)
        speed[i], acceleration[i] = c[-order], order * c[-order - 1]
        u[i] = order * np.sqrt(excess * covariance[-order - 1, -order - 1])
    moved = y.copy()
    moved[:, MAIN] = speed
    numbers = fit.problem.layout.numbers(fit.theta, index)
    modelled = case.dynamics.rates(times, moved, numbers)[:, MAIN]
    return speed, inertia * (acceleration - modelled), inertia * u


def _is_filmed(times: Array, data: CaseData, body: str) -> NDArray[np.bool_]:
    """Return a mask of the times within the recording of a body; for the rotor, from the first window to the last."""
    runs = next(b.series for b in data.record.bodies if b.part == body)
    first = min(float(r.time[0]) for r in runs)
    last = max(float(r.time[-1]) for r in runs)
    return np.asarray((times >= first) & (times <= last))


def _times_covariance(w: Array, response: TorqueResponse, time: float) -> Array:
    """Return W R with the covariance R of an Ornstein-Uhlenbeck process of rms 1."""
    decay = float(np.exp(-(response.edges[1] - response.edges[0]) / time))
    later, earlier = decaying_sums(w.T, decay), decaying_sums(w.T[::-1], decay)[::-1]
    return np.asarray((later + earlier).T - w)


def _inverse_without_nuisance(covariance: Array, nuisance: Array) -> Array:
    """Return C^-1 with the columns of the nuisance parameters projected out."""
    inverse = np.linalg.inv(0.5 * (covariance + covariance.T))
    size = np.linalg.norm(nuisance, axis=0)
    columns = nuisance[:, size > 0] / size[size > 0]
    weighted = inverse @ columns
    return np.asarray(inverse - weighted @ np.linalg.pinv(columns.T @ weighted, hermitian=True) @ weighted.T)


_RANK = 1e-6
"""Relative singular value below which a nuisance direction is rounding error [1]. Chosen: a smaller value projects out
rounding errors, a larger one ignores some nuisance columns."""

_BAND = 1.96
"""An interval of significant torque ends where the size of the torque falls below this value [standard deviations].
Derived: quantile 0.975 of the standard normal distribution, a band of 95 %."""
_TURNS = {1: "once a turn", 2: "twice a turn"}
_SHORTEST = 1 / 100
"""Shortest reported interval, as a share of the record [1]. Chosen: a smaller value reports fluctuations, a larger one
overlooks short events."""
_MOST = 6
"""Largest number of reported intervals [1]. Chosen: a smaller number hides failures, a larger one makes the list
unreadable."""


@dataclass(frozen=True)
class Failure:
    """An interval with a significant unmodelled torque."""

    label: str
    body: str
    t_start: float  # start of the interval [s]
    t_stop: float  # end of the interval [s]
    # "loses torque" or "gains torque" compared with the model; "ripple" for a harmonic of the angle
    kind: str
    where: str  # place in words, for example "while speeding up", "near the peak", "once a turn"
    size_sigma: float  # largest distance from zero in standard deviations
    # extreme (5 % or 95 %) speed residual with its sign; for a harmonic, its speed amplitude
    residual_rad_s: float
    residual_torque_Nm: float  # mean torque, weighted by inverse variances; for a harmonic, its amplitude
    omega_c: tuple[float, float]  # lowest and highest speed of the casing in the interval [rad/s]
    called: str  # name of the body for the user, for example "body" if a single body was recorded
    # standard uncertainty of the torque; for a mean over an interval, its upper bound
    torque_sigma_Nm: float = float("nan")
    unit: str = TORQUE  # "N m", or "rad/s2" for torques per unit of inertia

    def __str__(self) -> str:
        torque = format_torque(self.residual_torque_Nm, self.torque_sigma_Nm, self.unit)
        if self.kind == "ripple":
            return (
                f"unmodelled torque on the {self.called} {self.where}, amplitude {torque} "
                f"({self.size_sigma:.0f} sigma)"
            )
        sign = "+" if self.residual_torque_Nm > 0 else ""
        first, last = self.times
        return (
            f"unmodelled torque on the {self.called} {sign}{torque}, {first} s to {last} s, "
            f"{self.where} (up to {self.size_sigma:.0f} sigma)"
        )

    @property
    def times(self) -> tuple[str, str]:
        """Start and end of the interval [s], with enough digits to show its length."""
        return interval(self.t_start, self.t_stop)


def find_failures(
    fit: Fit,
    curves: Sequence[ResidualTorque],
    harmonics: Sequence[AngleHarmonics] = (),
    criteria: Criteria = DEFAULT,
) -> list[Failure]:
    """Return at most `_MOST` intervals and harmonics with a significant unmodelled torque, most significant first.

    A harmonic is reported only if it is more significant than every interval of its case, because a torque that acts
    for less than a turn while the casing is slow also has harmonics.
    """
    found = [f for curve in curves for f in _intervals(fit, curve, criteria.failure_sigma)]
    worst = {c.label: 0.0 for c in curves}
    for f in found:
        worst[f.label] = max(worst[f.label], f.size_sigma)
    found += [
        f
        for found in harmonics
        for n in _TURNS
        for f in _harmonic(fit, found, n, criteria.harmonic_sigma)
        if f.size_sigma > worst.get(f.label, 0.0)
    ]
    return sorted(found, key=lambda f: -f.size_sigma)[:_MOST]


_SLOWEST = 1e-4
"""Speed, divided by the largest speed, below which a body counts as at rest [1]. Chosen: a smaller value gives
unlimited speed amplitudes of harmonics, a larger one understates these amplitudes for slow bodies."""


def _harmonic(fit: Fit, found: AngleHarmonics, n: int, least: float) -> list[Failure]:
    amplitude, size = found.size(n)
    if size < least:
        return []
    index = fit.labels.index(found.label)
    record, path = fit.problem.data[index].record, fit.predictions[index].path
    t = record.casing.time
    speed = np.abs(Sampler(path.mesh, t).value(path.y[..., MAIN]))
    # the amplitude of the speed is torque / (I n omega), largest where the casing is slowest without resting
    slowest = max(
        float(speed.min()), float(np.sqrt(amplitude / record.I_casing)), _SLOWEST * float(speed.max())
    )
    speed_amplitude = amplitude / (record.I_casing * n * slowest)
    span = float(t[0]), float(t[-1])
    return [
        Failure(
            found.label, record.mechanism.main, *span, "ripple", _TURNS[n], size, speed_amplitude, amplitude,
            (float(speed.min()), float(speed.max())), record.body, amplitude / size,
            record.torque_unit,
        )
    ]  # fmt: skip


def _intervals(fit: Fit, curve: ResidualTorque, least: float) -> list[Failure]:
    ratio = curve.torque / np.maximum(curve.sigma, 1e-300)
    outside = np.abs(ratio) > _BAND
    record = fit.problem.data[fit.labels.index(curve.label)].record
    called = record.body if curve.body == record.mechanism.main else curve.body
    change = np.flatnonzero(np.diff(np.sign(ratio) * outside) != 0) + 1
    edges = np.concatenate([[0], change, [len(ratio)]])
    span = curve.time[-1] - curve.time[0]
    failures = []
    for a, b in pairwise(edges):
        if not outside[a] or curve.time[b - 1] - curve.time[a] < _SHORTEST * span:
            continue
        size = float(np.abs(ratio[a:b]).max())
        if size < least:
            continue
        weight = 1 / np.maximum(curve.sigma[a:b], 1e-300)
        mean = float(curve.torque[a:b] @ weight**2 / np.sum(weight**2))
        failures.append(
            Failure(
                curve.label,
                curve.body,
                float(curve.time[a]),
                float(curve.time[b - 1]),
                "gains torque" if mean > 0 else "loses torque",
                _place(curve, a, b),
                size,
                _largest_speed_residual(fit, curve, a, b),
                mean,
                (float(curve.omega_c[a:b].min()), float(curve.omega_c[a:b].max())),
                called,
                float(weight.sum() / np.sum(weight**2)),
                record.torque_unit,
            )
        )
    return failures


_AT_START = 0.02
"""A body counts as slowing down only if its highest speed occurs within this first share of the record [1]. Chosen: a
smaller value takes noise at the start for a rise, a larger one overlooks a short rise."""


def _place(curve: ResidualTorque, a: int, b: int) -> str:
    peak = int(np.argmax(np.abs(curve.omega_c)))
    if a == 0 and b == len(curve.time):
        return "throughout"
    if peak < _AT_START * len(curve.time):  # the body only slows down
        return (
            "at the start"
            if a <= peak
            else "while slowing down"
            if a > len(curve.time) // 2
            else "in the middle"
        )
    if a <= peak < b:
        near = np.abs(curve.omega_c[a:b]).min() > 0.9 * abs(curve.omega_c[peak])
        return "near the peak" if near else "around the peak"
    return "while speeding up" if b <= peak else "while slowing down"


def _largest_speed_residual(fit: Fit, curve: ResidualTorque, a: int, b: int) -> float:
    """Return the 5 % or the 95 % quantile of the speed residuals in an interval, whichever is larger in size [rad/s].

    With several windows of the rotor, the extreme quantile of all windows is returned.
    """
    index = fit.labels.index(curve.label)
    record = fit.problem.data[index].record
    body = next(b for b in record.bodies if b.part == curve.body)
    worst = 0.0
    for samples in body.series:
        time, omega = speeds(samples, record.quantity, fit.problem.data[index].smoothing_width)
        inside = (time >= curve.time[a]) & (time <= curve.time[b - 1])
        if inside.any():
            residual = omega[inside] - modelled_speed(fit, index, body.state, time[inside])[0]
            low, high = np.percentile(residual, [5, 95])
            worst = max((worst, float(low), float(high)), key=abs)
    return worst
