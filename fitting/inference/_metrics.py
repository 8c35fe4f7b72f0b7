"""Figures of merit of a fitted case: smoothed velocities, cross-validation error, energy balance, lack of fit.

The energy balance is

    K(t) + integral_0^t [ tau_cr D + (a1 w_r + a2 w_r^2) w_r + (b1 + b2 w_c) w_c ] dt = K(0),

with the kinetic energy K and the losses of the paper's friction terms. For any model the loss is minus the power of its
torques on both bodies, -(tau_r w_r + tau_c w_c). As in the paper, w_c is the *measured* speed of the casing. The
balance then drifts if the model lacks a relevant torque. w_r is the speed of the rotor in the model, which is fitted to
the windows of the rotor.

The cross-validation error follows without a refit. If a linear model with noise covariance C is fitted without the rows
h, the error of its prediction of these rows is exactly

    e_h = (G_hh)^-1 (G r)_h,   cov(e_h) = (G_hh)^-1,   G = C^-1 - C^-1 X (X' C^-1 X)^-1 X' C^-1,

where r are the residuals of the full fit, and X are the columns of parameters and nuisance parameters
(leave-block-out; O. Dubrule, Math. Geol. 15, 687 (1983)).

The lack-of-fit test has any slow torque as its alternative. Slow torques on the casing and in the bearing are added to
the fitted model. They are piecewise linear in time, with knots a twentieth of the record apart. With the whitened
response S to these torques, orthogonal to all free columns,

    chi2 = r'S (S'S)^-1 S'r   with rank(S) degrees of freedom

if the model is right. This is the test of lack of fit against pure error (N. Draper, H. Smith, Applied Regression
Analysis, Wiley (1998), 1.5). It does not depend on the law that is missing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np
from numpy.polynomial import hermite_e
from numpy.typing import NDArray
from scipy.special import chdtrc

from fitting._criteria import Criteria
from fitting._numbers import span_of
from fitting.dynamics._collocation import Path, Sampler
from fitting.dynamics._model import Dynamics
from fitting.effects._mechanism import MAIN
from fitting.inference._case_data import SPEED_BLOCKS, CaseData
from fitting.inference._case_model import CaseModel, Prediction
from fitting.inference._compression import CASING_DEGREE, Compressed, integrated
from fitting.inference._linear_algebra import (
    block_diagonal,
    orthogonal_to,
    orthonormal,
    piecewise_linear,
    r_factor,
)
from fitting.inference._noise import Noise, TorqueResponse, tail_probability
from fitting.inference._problem import Problem, Projection
from fitting.inference._record import Body, Record, Samples, hermite, median_width, speeds

Array = NDArray[np.float64]

_TERMS = 21
"""Terms of Mehler's series are summed up to an order below this value [1]. Chosen: a smaller number understates the
correlation of gradients, a larger one costs time and changes little."""


def as_velocities(record: Record) -> Record:
    """Return the record with the paper's velocities instead of angles: median, gradient, median, ends dropped.

    The noise of neighbouring velocities is strongly correlated, but only its low frequencies matter for the fit. The
    sigma of the velocities is therefore the sigma of independent samples with the same noise at low frequencies
    (`median_noise`).
    """
    if record.quantity == "omega":
        return record
    runs = [_velocities(record.casing, SPEED_BLOCKS), *(_velocities(s, 1) for s in record.rotor)]
    return replace(
        record,
        casing=runs[0],
        rotor=tuple(runs[1:]),
        quantity="omega",
        gradients=True,
        modes=tuple(m.rates() for m in record.modes),
        digest="",
    )


def _velocities(samples: Samples, blocks: int) -> Samples:
    time, omega = speeds(samples, "angle")
    width = median_width(len(samples))
    step = np.gradient(samples.time)
    noise = np.hypot(*(np.roll(samples.sigma, k) for k in (-1, 1))) / (2 * step)
    noise = np.interp(time, samples.time, noise)
    rise = np.abs(np.gradient(np.convolve(omega, np.full(width, 1 / width), mode="same"), time))
    # at both ends of the record, the moving average is incomplete
    rise[: width // 2 + 1], rise[-width // 2 :] = rise[width // 2 + 1], rise[-width // 2 - 1]
    cutoff = 0.5 * width * float(np.median(step)) * rise / noise
    # The sum of the gradients e_(i+1) - e_(i-1) of a block reduces to the e at both ends of the block. In the row of
    # the Legendre polynomial of degree k they have the variance (2 k + 1) / samples, on average (degree + 1) / samples.
    ends = 2 * (CASING_DEGREE + 1) * blocks / len(samples)
    return Samples(time, omega, noise * np.sqrt(median_noise(cutoff) + ends), samples.state)


def median_noise(cutoff: Array) -> Array:
    """Return the variance at low frequencies of a running median of gradients, divided by the variance of one gradient.

    If the speed rises, a sample next to the middle changes the median only if the noise of the sample exceeds the rise.
    In sums over many medians every gradient v therefore contributes psi(v), the value v limited to +- c. Here c is the
    slope of the speed multiplied by half the width of the median (`cutoff`, in standard deviations of the noise of one
    gradient). The spectral density at frequency zero is therefore the density of Huber's estimate,

        S = sum over lags of cov[psi(v_0), psi(v_k)] / P(|v| < c)^2,

    where P is the probability P(|v| < c). Gradients (e_(i+1) - e_(i-1)) / 2h of independent e have the correlation -1/2
    at lag 2 and no correlation at other lags. Mehler's formula with the Hermite polynomials He and the normal density
    phi then gives cov = sum_k (2 phi(c) He_(k-2)(c))^2 (-1/2)^k / k! over odd k. The first term is -P^2 / 2.
    """
    c = np.clip(cutoff, 0.02, 5.0)
    density = np.exp(-0.5 * c**2) / np.sqrt(2 * np.pi)
    inside = np.vectorize(math.erf, otypes=[float])(c / np.sqrt(2))
    variance = inside - 2 * c * density + c**2 * (1 - inside)
    opposed, factorial = 0.5 * inside**2, 1.0
    for k in range(3, _TERMS, 2):
        factorial *= (k - 1) * k
        polynomial = hermite_e.hermeval(c, np.eye(k - 1)[k - 2])
        opposed = opposed + (2 * density * polynomial) ** 2 * 0.5**k / factorial
    return np.asarray(np.maximum(variance - 2 * opposed, 0.0) / inside**2)


_POINTS = 2000
"""Largest number of points of an energy balance [1]. Chosen: a smaller number makes the integral coarse, a larger one
costs time."""


@dataclass(frozen=True, repr=False)
class EnergyBalance:
    """Energy balance: times [s], energy K + losses [J], and the relative change of this energy.

    The energy is constant for a right model. The change is relative to the initial energy. If a motion begins at a
    turning point, the change is relative to the largest kinetic energy. If an input drives a body, the change is
    relative to the energy that the body loses by friction, provided that this energy is larger.
    """

    time: Array
    energy: Array
    change: Array

    def __repr__(self) -> str:
        return f"EnergyBalance: {span_of('energy', self.energy, 'J')}, drift {self.drift:.2g}"

    @property
    def drift(self) -> float:
        """The largest relative change."""
        return float(np.max(np.abs(self.change)))


def energy_balance(case: CaseModel, theta: Array, path: Path) -> EnergyBalance:
    """Return the energy balance of a fitted case along its solution."""
    mechanism = case.dynamics.mechanism
    time, omega = case.data.speeds[mechanism.main]
    t = np.linspace(time[0], time[-1], min(_POINTS, len(time)))
    state = Sampler(path.mesh, t).value(path.y)
    state[:, MAIN] = np.interp(t, time, omega)
    numbers = case.layout.numbers(theta, case.case)
    rates = case.dynamics.rates(t, state, numbers)
    inertia = np.array([numbers[key] for key in mechanism.inertias])
    count = len(inertia)
    kinetic = 0.5 * (state[:, :count] ** 2) @ inertia
    power = -np.sum(rates[:, :count] * inertia * state[:, :count], axis=1)
    energy = kinetic + integrated(t, power)
    scale = energy[0] if energy[0] > _SLOW_START * kinetic.max() else kinetic.max()
    model = case.layout.model.smooth
    if any(e.inputs for e in model.effects):
        rest = Dynamics(model.with_only(e for e in model.effects if not e.inputs))
        lost = rest.rates(t, state[:, [case.dynamics.states.index(s) for s in rest.states]], numbers)
        power = np.sum(lost[:, :count] * inertia * state[:, :count], axis=1)
        scale = max(scale, float(np.trapezoid(np.abs(power), t)))
    return EnergyBalance(t, energy, (energy - energy[0]) / scale)


_SLOW_START = 0.1
"""A motion begins at a turning point if the initial kinetic energy, divided by the largest kinetic energy, is below
this value [1]. Chosen: a smaller value divides by a small energy, a larger one changes the scale of usual runs."""
FOLDS = 6
"""Number of folds of the cross-validation [1]. Chosen: with fewer folds, the gaps in the data are large; with more,
slow torques are the same in a fold and in its neighbours."""


def held_out(
    data: CaseData, project: Projection, prediction: Prediction, bodies: Sequence[str] | None = None
) -> dict[str, float]:
    """Return the cross-validation error of bodies: rms prediction error of omitted rows, divided by their noise.

    The noise limit is 1.

    Each part of the data is predicted from all other rows. A part is one of six intervals of time for ``casing`` and
    for all bodies of a chain, and a window for ``rotor``. All measured bodies by default.
    """
    jacobian = project(prediction.columns)
    size = np.linalg.norm(jacobian, axis=0)
    used = np.concatenate([project.basis, np.linalg.qr(jacobian[:, size > 0] / size[size > 0])[0]], axis=1)
    residual = project(prediction.rows - data.z)
    residual = orthogonal_to(used, residual)
    weighted = project.whitener(residual)
    result = {}
    for body, runs, folds in _folds(data):
        if bodies is not None and body not in bodies:
            continue
        total = sum(r.rest for r in runs) + sum(_error(project, used, weighted, fold) for fold in folds)
        result[body] = float(np.sqrt(total / max(sum(r.n_effective for r in runs), 1.0)))
    return result


def _error(project: Projection, used: Array, weighted: Array, fold: Array) -> float:
    columns = np.zeros((len(weighted), len(fold)))
    columns[fold, np.arange(len(fold))] = 1.0
    white = project.whitener(columns)
    inner = used.T @ white
    values, vectors = np.linalg.eigh(white.T @ white - inner.T @ inner)
    keep = values > 1e-9 * values[-1]
    rows = vectors[:, keep].T @ weighted[fold]
    return float(np.sum(rows**2 / values[keep]))


def _casing_folds(data: CaseData) -> list[Array]:
    blocks, k, _ = data.casing.lift.shape
    harmonics = len(data.casing.harmonic) // blocks
    first = data.slices["harmonic"].start
    folds = []
    for part in np.array_split(np.arange(blocks), min(FOLDS, blocks)):
        rows = (part[:, None] * k + np.arange(k)).ravel()
        tail = first + (part[:, None] * harmonics + np.arange(harmonics)).ravel()
        folds.append(np.concatenate([rows, tail]))
    return folds


def _rotor_folds(data: CaseData) -> list[Array]:
    ends = data.slices["rotor"].start + np.cumsum([0, *(len(w.z) for w in data.rotor)])
    return [np.arange(a, b) for a, b in pairwise(ends)]


def _folds(data: CaseData) -> Iterator[tuple[str, list[Compressed], list[Array]]]:
    """Yield each body with its runs, and for each fold the rows that are left out."""
    yield data.record.mechanism.main, [data.casing], _casing_folds(data)
    rows = _rotor_folds(data)
    for state, name in enumerate(data.record.mechanism.bodies):
        own = [i for i, w in enumerate(data.rotor) if state != MAIN and w.samples.state == state]
        folds = [rows[i] for i in own]
        if data.record.is_chain:
            folds = [
                part for i in own for part in np.array_split(rows[i], min(FOLDS, len(data.rotor[i].lift)))
            ]
        if own:
            yield name, [data.rotor[i] for i in own], folds


@dataclass(frozen=True)
class BodyMetrics:
    """Figures of merit of one body."""

    # coefficient of determination and rms of the measured minus the modelled angular velocity, both smoothed as in the
    # paper [1, rad/s]
    r2: float
    rmse: float
    reduced_chi2: float  # chi-square of the fitted quantity, divided by the effective number of samples
    held_out: float  # cross-validation error divided by the noise; 1 = noise limit


@dataclass(frozen=True)
class CaseMetrics:
    """Figures of merit of one case; `rows` is the number of rows that a model can describe.

    For a chain, `casing` is the main body, `rotor` is the next body, and `further` are the bodies after it.
    """

    label: str
    casing: BodyMetrics
    rotor: BodyMetrics
    energy_drift: float
    chi2_per_row: float
    rows: int
    further: tuple[BodyMetrics, ...] = ()

    @property
    def bodies(self) -> tuple[BodyMetrics, ...]:
        """The figures of merit of each measured body, the main body first."""
        return tuple(b for b in (self.casing, self.rotor, *self.further) if not math.isnan(b.rmse))

    @property
    def misfit(self) -> float:
        """Rms residual of the rows divided by the rms of the noise."""
        return math.sqrt(self.chi2_per_row)

    def fails(self, criteria: Criteria) -> bool:
        """Return whether `chi2_per_row` exceeds its limit, and whether noise alone rarely gives such a value.

        In a short record of twelve rows, noise alone gives a `chi2_per_row` above 1.4 in one case of six.
        """
        p_value = float(chdtrc(self.rows, self.rows * self.chi2_per_row))
        return self.chi2_per_row > criteria.reduced_chi2 and p_value < criteria.lack_of_fit


def chi2_per_row(data: CaseData, project: Projection, residual: Array) -> tuple[float, int]:
    """Return chi-square of projected residuals per row that a model can describe, and the number of these rows."""
    rows = max(1, data.row_count - project.basis.shape[1])
    return float(np.sum(residual**2)) / rows, rows


def case_metrics(case: CaseModel, project: Projection, prediction: Prediction, theta: Array) -> CaseMetrics:
    """Return the figures of merit of one case."""
    data = case.data
    residual = project(prediction.rows - data.z)
    square, errors = residual**2, held_out(data, project, prediction)
    bodies = []
    for body, (name, runs, folds) in zip(data.record.bodies, _folds(data), strict=True):
        r2, rmse = _speed_quality(case, prediction, theta, body)
        chi2 = sum(float(np.sum(square[rows])) for rows in folds)
        reduced = (chi2 + sum(w.rest for w in runs)) / max(1.0, sum(w.n_effective for w in runs))
        if body.state != MAIN and data.record.generated:  # a generated curve has no noise
            reduced = errors[name] = float("nan")
        bodies.append(BodyMetrics(r2, rmse, reduced, errors[name]))
    absent = BodyMetrics(*[float("nan")] * 4)
    casing, rotor, *further = (*bodies, absent) if len(bodies) == 1 else bodies
    return CaseMetrics(
        data.record.label,
        casing,
        rotor,
        energy_balance(case, theta, prediction.path).drift,
        *chi2_per_row(data, project, residual),
        tuple(further),
    )


def _speed_quality(case: CaseModel, prediction: Prediction, theta: Array, body: Body) -> tuple[float, float]:
    _, y = case.data.speeds[body.part]
    error = y - _smoothed_model(case, prediction, theta, body)
    spread = float(np.sum((y - y.mean()) ** 2))
    return 1 - float(error @ error) / spread if spread > 0 else 0.0, float(np.sqrt(np.mean(error**2)))


def _smoothed_model(case: CaseModel, prediction: Prediction, theta: Array, body: Body) -> Array:
    """Return the modelled angular velocity of a body, smoothed like the measured angular velocity.

    Smoothing removes the response to a torque that is periodic in the angle. Therefore the model is smoothed as well.
    """
    record, path = case.data.record, prediction.path
    response = case.response_to_angles(prediction, theta)
    found = []
    for run in body.series:
        values = _model_at(case.data, path, body.state, run.time)
        if response is not None:
            speed, angle = response[:, body.state]
            at = np.clip(run.time, record.casing.time[0], record.casing.time[-1])
            values = values + hermite(record.casing.time, angle, speed, at, slopes=not case.data.is_angle)
        model = Samples(run.time, values, run.sigma)
        found.append(speeds(model, record.quantity, case.data.smoothing_width)[1])
    return np.concatenate(found)


def _model_at(data: CaseData, path: Path, state: int, times: Array) -> Array:
    """Return the smooth part of the modelled angle [rad], or angular velocity [rad/s], at the times of samples."""
    sampler = Sampler(path.mesh, times)
    if data.is_angle:
        return np.asarray(sampler.integral(*path.angle(path.states[state])))
    return np.asarray(sampler.value(path.y[..., state]))


_SEED = 1
"""Seed of the simulated noise [1]. Chosen: any value makes the result reproducible; another seed changes the result
within its error."""
_NORMAL = 0.6745
"""Median of the absolute value of a standard normal variable [1]. Derived: quantile 0.75 of the standard normal
distribution."""
_THIRD_DIFFERENCE = 20.0
"""Variance of the third difference of white noise of variance 1 [1]. Derived: 1 + 9 + 9 + 1."""


def smoothing_noise(data: CaseData, path: Path) -> float:
    """Return the rms error of the casing's smoothed speed due to noise alone [rad/s].

    It is the difference between the modelled angles with and without added noise, after the smoothing of the paper. The
    noise is white: its standard deviation is the sigma of the samples multiplied by a factor from the third differences
    of the residuals. The rms of third differences is sqrt(20) times the rms of white noise. Neither a slow lack of fit
    nor irregular times of pulses change third differences.
    """
    measured = data.record.casing
    exact = _model_at(data, path, MAIN, measured.time)
    third = np.abs(np.diff(measured.value - exact, 3)) / measured.sigma[1:-2]
    noise = measured.sigma * float(np.median(third)) / _NORMAL / np.sqrt(_THIRD_DIFFERENCE)
    # a fixed seed, so that a report is the same in every run
    noisy = exact + noise * np.random.default_rng(_SEED).standard_normal(len(exact))
    runs = (Samples(measured.time, value, measured.sigma) for value in (noisy, exact))
    smoothed, of_model = (speeds(run, data.record.quantity, data.smoothing_width)[1] for run in runs)
    return float(np.sqrt(np.mean((smoothed - of_model) ** 2)))


KNOTS = 21
"""Number of knots of the slow torques of the lack-of-fit test [1]. Chosen: a twentieth of the record apart; a smaller
number overlooks short torques, a larger one lowers the power for slow torques."""
_RANK = 1e-4
"""The model absorbs a tested direction if its relative singular value is below this value [1]. Chosen: a smaller value
tests rounding errors, a larger one omits torques that are nearly absorbed."""
_RANK_FREE = 1e-7
"""Relative singular value below which a free direction is rounding error [1]. Chosen: a smaller value projects out
rounding errors; with a larger one, some free columns are not projected out."""
_MANY = 4
"""With more cases than this number, the slow torques of each case are projected out first [1]. Chosen: another value
costs time and does not change the result."""


@dataclass(frozen=True)
class LackOfFit:
    """Fall of chi-square due to slow torques, its degrees of freedom, and its p-value.

    The p-value takes account of the uncertain level of the process noise, which is integrated out.
    """

    chi2: float
    dof: int
    p_value: float


class FewRows(NamedTuple):
    """Columns that are tested in addition to a fitted model, reduced to a few rows by a QR decomposition."""

    tested: Array
    free: Array  # derivatives with respect to all variables of the fit
    residual: Array
    share: float  # share of the process noise in the variance of the tested columns

    @classmethod
    def of(cls, data: CaseData, p: Prediction, n: Noise, tested: Array, level: float | None = None) -> Self:
        """Return the whitened rows of a case without nuisance columns. The default `level` [N m] is `Noise.tested`."""
        project = Projection(data, n.whitener.at(n.tested if level is None else level))
        white = project(np.concatenate([tested, p.columns, (data.z - p.rows)[:, None]], axis=1))
        share = project.whitener.share(orthonormal(white[:, : tested.shape[1]], _RANK))
        few, own, residual = np.split(r_factor(white), [tested.shape[1], -1], axis=1)
        free = np.zeros((len(own), p.count))
        free[:, p.places] = own
        return cls(few, free, residual[:, 0], share)


def lack_of_fit(problem: Problem, predictions: Sequence[Prediction], noise: Sequence[Noise]) -> LackOfFit:
    """Return the lack of fit of a fitted model, at the noise level `Noise.tested` of each case."""
    cases = zip(problem.data, predictions, noise, strict=True)
    rows = [FewRows.of(data, p, n, slow_responses(data, p)) for data, p, n in cases]
    slow, free, residual, shares = zip(*rows, strict=True)
    # the parameters are common to all cases, so the cases are tested together
    chi2, dof = (_case_by_case if len(slow) > _MANY else _together)(slow, free, residual)
    p_value = float(tail_probability(chi2, dof, noise, shares)) if dof else 1.0
    return LackOfFit(chi2, dof, p_value)


def _together(slow: Sequence[Array], free: Sequence[Array], residual: Sequence[Array]) -> tuple[float, int]:
    basis = orthonormal(np.concatenate(free), _RANK_FREE)
    r = orthogonal_to(basis, np.concatenate(residual))
    span = orthonormal(orthogonal_to(basis, block_diagonal(slow)), _RANK)
    return float(np.sum((span.T @ r) ** 2)), span.shape[1]


def _case_by_case(
    slow: Sequence[Array], free: Sequence[Array], residual: Sequence[Array]
) -> tuple[float, int]:
    """Return the lack of fit of many cases; the slow responses of each case are projected out first.

    The result is equal to the result of `_together`, except that ranks are determined for each case. The cost is linear
    in the number of cases.
    """
    total, rank, rests = 0.0, 0, []
    for s, b, r in zip(slow, free, residual, strict=True):
        span = orthonormal(s, _RANK)
        total += float(np.sum((span.T @ r) ** 2))
        rank += span.shape[1]
        rests.append(orthogonal_to(span, np.column_stack([b, r])))
    # if slow torques absorb a parameter, its column is nearly zero
    size = np.linalg.norm(np.concatenate(free), axis=0)
    for rows, sign in (
        (np.concatenate(rests), 1),
        (np.column_stack([np.concatenate(free), np.concatenate(residual)]), -1),
    ):
        u, value, _ = np.linalg.svd(rows[:, :-1][:, size > 0] / size[size > 0], full_matrices=False)
        u = u[:, value > (_RANK if sign > 0 else _RANK_FREE) * value[0]]
        total += sign * float(np.sum((u.T @ rows[:, -1]) ** 2))
        rank += sign * u.shape[1]
    return max(total, 0.0), max(rank, 0)


def slow_responses(data: CaseData, prediction: Prediction) -> Array:
    """Return the responses of a case's rows to slow torques of 1 N m, on the casing and in the bearing.

    There is one column for each knot of each torque, shape (rows, 42); in a chain, the torques act on the main body and
    in every joint. A torque is linear between the knots, which are a twentieth of the record apart.
    """
    response = TorqueResponse(data, prediction.motion)
    times = response.centres
    hats = piecewise_linear(times, np.linspace(times[0], times[-1], KNOTS))
    columns = np.concatenate([w @ hats for w in response.random], axis=1)
    rows = np.zeros((len(data.z), columns.shape[1]))
    rows[: len(columns)] = columns
    return rows
