"""Uncertainty budget of the parameters of a fit, after the GUM (JCGM 100:2008).

About its optimum, a fit is linear in its data. Let P W (m - z) be the whitened residuals, where W whitens the noise and
P projects the nuisance parameters out, and let J be their Jacobian. With G = (J'J)^-1 J' P W, each source of noise with
the covariance V_i contributes G V_i G'. A nuisance parameter that is fitted to the same data contributes the difference
of the variances with and without this parameter (type A). These contributions add up to the square of the standard
error of the fit.

A relative rate error eps of the clock changes the rows of the model by eps dm/d(eps), and the parameters by -eps G
dm/d(eps) (type B). The same holds for a relative error eps of the scale of a sensor of angular velocity, which reads
omega (1 + eps). A wrong moment of inertia also changes the residuals and thus the noise by which the data are weighted,
so its influence need not be linear. Therefore the distribution of each moment of inertia is propagated by fits at the
nodes of a Gauss-Hermite rule: the given value, and this value +- sqrt(3) standard uncertainties u.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EstimationError
from fitting._numbers import on_screen, percentage, rounded
from fitting.dynamics._collocation import Sampler
from fitting.effects._library import NUISANCE
from fitting.effects._mechanism import MAIN
from fitting.inference._case_data import CAMERA_COLUMNS, INERTIA_RATIO, CaseData
from fitting.inference._case_model import CaseModel, Prediction
from fitting.inference._compression import Compressed
from fitting.inference._fit import fit as refit
from fitting.inference._linear_algebra import covariance_of, orthogonal_to, orthonormal
from fitting.inference._noise import TorqueResponse
from fitting.inference._problem import surely_at_bound
from fitting.inference._result import Fit

Array = NDArray[np.float64]

CRYSTAL = 50e-6 / math.sqrt(3)
"""Relative standard uncertainty of a camera's clock [1]. Derived: crystals are specified to 50 ppm; the standard
deviation of a rectangular distribution is 1 / sqrt(3) of its half width."""

_NODES = (-math.sqrt(3), 0.0, math.sqrt(3))
"""Nodes of a quadrature rule for a normal distribution [standard uncertainties]. Derived: the Gauss-Hermite rule of
three nodes."""
_WEIGHTS = (1 / 6, 2 / 3, 1 / 6)
"""Weights of a quadrature rule for a normal distribution [1]. Derived: the Gauss-Hermite rule of three nodes."""
_RANK = 1e-7
"""Relative singular value below which a nuisance direction is rounding error [1]. Chosen: a smaller value projects out
rounding errors; with a larger one, some nuisance columns are not projected out."""
_ROUNDING = 1e-12
"""A contribution is rounding error if its share of the total is below this value [1]. Chosen: a smaller value lists
contributions that are zero, a larger one hides small contributions."""


@dataclass(frozen=True)
class Contribution:
    """One source of uncertainty of one parameter.

    `source` is "angle noise", "process noise", "start times", "lack of fit", a camera effect, "inertia.rotor",
    "inertia.casing", "inertia.rotor x inertia.casing" (their interaction), "clock rate" or "speed scale".
    """

    source: str  #: Source of the uncertainty, for example `angle noise` or `inertia.rotor`.
    type: Literal["A", "B"]  #: Evaluated from the data (A), or from other knowledge (B).
    u: float  #: Contribution to the standard uncertainty [unit of the parameter].
    #: Change of the parameter per unit of an input of type B; null for type A [unit of the parameter per SI unit].
    sensitivity: float | None
    share: float  #: Share of the combined variance [1].


_SHOWN = 3
"""Number of contributions in a repr [1]. Chosen: a smaller number hides important causes, a larger one makes a long
line."""


@dataclass(frozen=True, repr=False)
class ParameterBudget:
    """Value, combined standard uncertainty and unit of a parameter, with the contributions, largest first."""

    value: float  #: Value [`unit`].
    u: float  #: Combined standard uncertainty [`unit`].
    unit: str  #: Unit of the parameter.
    contributions: tuple[Contribution, ...]  #: Contributions, largest first.

    def __repr__(self) -> str:
        shares = ", ".join(f"{c.source} {percentage(c.share)}" for c in self.contributions[:_SHOWN])
        return f"{rounded(self.value, self.u, self.unit)}: {shares}"


class Budget(dict[str, ParameterBudget]):
    """The uncertainty budgets of the parameters of a fit, by name."""

    def __repr__(self) -> str:
        return on_screen(f"{name}: {own!r}" for name, own in self.items())


def budget(fit: Fit, *, clock_rate_u: float = CRYSTAL, speed_scale_u: float = 0.0) -> Budget:
    """Return the uncertainty budget of every parameter of a fit that has a standard error.

    Parameters
    ----------
    fit : Fit
        The fit. Moments of inertia contribute where their uncertainties are known (`Record.I_rotor_u`,
        `Record.I_casing_u`); equal moments of inertia of several cases are one input.
    clock_rate_u : float
        Relative standard uncertainty of the time base that all recordings share.
    speed_scale_u : float
        Relative standard uncertainty of the scale of the sensor that measured the angular velocities of all recordings,
        like the gyroscope of a phone.

    Returns
    -------
    Budget
        The budgets of the parameters, with the keys of `fit.estimates`. Calibrations of recorded inputs contribute
        where their uncertainties are known.

    Raises
    ------
    EstimationError
        If `speed_scale_u` is given for recordings of angles, whose scale is exact.
    """
    measured_speeds = [not d.is_angle and not d.record.gradients for d in fit.problem.data]
    if speed_scale_u > 0 and not any(measured_speeds):
        raise EstimationError(
            "The recordings contain angles, and the scale of an angle has no error.",
            "The speed scale applies to measured angular velocities.",
        )
    names = fit.problem.layout.names
    linear = _Linearised(fit)
    variances = linear.noise_variances()
    inputs = _inertia_contributions(fit)
    cases = list(zip(fit.problem.data, fit.predictions, strict=True))
    for name, slope in _calibrations(linear):
        inputs[f"calibration of {name}"] = np.abs(slope), None
    if clock_rate_u > 0:
        slope = linear.sensitivity([_clock_rows(d, p) for d, p in cases])
        inputs["clock rate"] = np.abs(slope) * clock_rate_u, slope
    if speed_scale_u > 0:
        rows = [
            _speed_rows(d, p) if own else np.zeros(len(d.z))
            for (d, p), own in zip(cases, measured_speeds, strict=True)
        ]
        slope = linear.sensitivity(rows)
        inputs["speed scale"] = np.abs(slope) * speed_scale_u, slope
    found = Budget()
    for i, name in enumerate(names):
        estimate = fit.estimates.get(name)
        if estimate is None or not math.isfinite(estimate.stderr):
            continue
        parts: list[tuple[str, Literal["A", "B"], float, float | None]] = [
            (source, "A", math.sqrt(max(float(v[i]), 0.0)), None) for source, v in variances.items()
        ]
        for source, (u, s) in inputs.items():
            parts.append((source, "B", float(u[i]), None if s is None else float(s[i])))
        total = math.sqrt(sum(u**2 for _, _, u, _ in parts))
        contributions = [
            Contribution(source, kind, u, s, (u / total) ** 2 if total > 0 else 0.0)
            for source, kind, u, s in parts
            if u > _ROUNDING * total
        ]
        contributions.sort(key=lambda c: -c.u)
        found[name] = ParameterBudget(estimate.value, total, estimate.unit, tuple(contributions))
    return found


def combined_uncertainties(fit: Fit) -> dict[str, float]:
    """Return the combined standard uncertainty of every parameter, with the moments of inertia to first order.

    These are the uncertainties of `budget`, computed without refits; the sentences of an answer state them.
    """
    linear = _Linearised(fit)
    cases = list(zip(fit.problem.cases, fit.predictions, strict=True))
    variance = np.diag(fit.covariance).copy()
    variance += (linear.sensitivity([_clock_rows(c.data, p) for c, p in cases]) * CRYSTAL) ** 2
    for _, body, value, u in _inertias(fit):
        rows = [_inertia_rows(c, p, fit.theta, body, value) for c, p in cases]
        if body == "rotor" and _ratio_has_prior(fit):
            rows = [
                x + _inertia_rows(c, p, fit.theta, "casing", c.data.record.I_casing) * bool(x.any())
                for x, (c, p) in zip(rows, cases, strict=True)
            ]
        variance += (linear.sensitivity(rows) * u / value) ** 2
    for _, slope in _calibrations(linear):
        variance += slope**2
    return dict(zip(fit.problem.layout.names, np.sqrt(variance).tolist(), strict=True))


def _calibrations(linear: _Linearised) -> Iterator[tuple[str, Array]]:
    """Yield the recorded inputs of known uncertainty, and the change of all variables by one standard uncertainty.

    The error of an input, divided by the uncertainty of each sample, is assumed to be the same in all samples and
    cases.
    """
    fit = linear.fit
    cases = list(zip(fit.problem.cases, fit.predictions, strict=True))
    names = dict.fromkeys(i.name for c, _ in cases for i in c.dynamics.inputs if i.u is not None)
    for name in names:
        yield name, linear.sensitivity([_input_rows(c, p, fit.theta, name) for c, p in cases])


def _input_rows(case: CaseModel, prediction: Prediction, theta: Array, name: str) -> Array:
    """Return the change of the rows of a case due to an error of the calibration of an input.

    The error is one standard uncertainty.
    """
    rows = np.zeros(len(case.data.z))
    response = TorqueResponse(case.data, prediction.motion)
    path, numbers = prediction.path, case.layout.numbers(theta, case.case)
    y = Sampler(path.mesh, response.centres).value(path.y)
    for i in case.dynamics.inputs:
        if i.name == name:
            by = case.dynamics.by_input(i, response.centres, y, numbers)
            inertias = [numbers[key] for key in case.dynamics.mechanism.inertias]
            by *= i.uncertainty(response.centres)[:, None] * inertias
            torques = zip(response.bodies.values(), by.T, strict=True)
            rows[: len(response.casing)] += sum(own @ torque for own, torque in torques)
    return rows


def _inertia_rows(case: CaseModel, prediction: Prediction, theta: Array, body: str, value: float) -> Array:
    """Return the derivative of the rows of a case with respect to the relative error of a moment of inertia."""
    rows = np.zeros(len(case.data.z))
    state = case.dynamics.mechanism.bodies.index(body)
    if case.data.record.inertias[state] != value:
        return rows
    response = TorqueResponse(case.data, prediction.motion)
    path, numbers = prediction.path, case.layout.numbers(theta, case.case)
    y = Sampler(path.mesh, response.centres).value(path.y)
    rates = case.dynamics.rates(response.centres, y, numbers)
    # a larger moment of inertia acts as the torque -I d(omega)/dt eps
    smooth = response.bodies[body]
    rows[: len(smooth)] = smooth @ (-value * rates[:, state])
    return rows


class _Linearised:
    """The estimator of a fit, linearised about its optimum."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        r, _ = fit.problem.residuals(fit.predictions)
        # the level of the process noise is the level used for the standard errors
        self.noise = [n.with_unresolved for n in fit.noise]
        self.problem = fit.problem.with_noise(self.noise)
        _, j = self.problem.residuals(fit.predictions)
        layout = fit.problem.layout
        self.free = ~surely_at_bound(layout, layout.at_bound(fit.theta), r, j)
        self.covariance = covariance_of(j, self.free)

    def _projected(self, nuisances: int) -> tuple[Array, list[Array]]:
        """Return the covariance if only the first `nuisances` camera effects are free, and P W J of each case."""
        blocks = []
        cases = zip(self.fit.problem.data, self.noise, self.fit.predictions, strict=True)
        for data, noise, prediction in cases:
            columns = data.nuisance
            has_camera = data.has_camera_prior or data.record.gradients
            first = columns.shape[1] - (2 * len(CAMERA_COLUMNS) if has_camera else 0)
            keep = [*range(first)]
            if has_camera:
                keep += [first + k for name in NUISANCE[:nuisances] for k in CAMERA_COLUMNS[name]]
            white = noise.whitener(prediction.jacobian)
            blocks.append(orthogonal_to(orthonormal(noise.whitener(columns[:, keep]), _RANK), white))
        return covariance_of(np.concatenate(blocks), self.free), blocks

    def noise_variances(self) -> dict[str, Array]:
        """Return the variance of each variable by source, type A."""
        covariance, blocks = self._projected(0)
        base = np.diag(covariance)
        process, starts = np.zeros(len(base)), np.zeros(len(base))
        for data, noise, block in zip(self.fit.problem.data, self.noise, blocks, strict=True):
            gain = covariance @ block.T
            w = noise.whitener
            m, n = len(w.vectors), len(w.values)
            roots = np.eye(len(data.z), n)
            roots[:m, :m] = w.vectors
            roots *= w.level * np.sqrt(np.maximum(w.values, 0.0))
            process += np.sum((gain @ w(roots)) ** 2, axis=1)
            for rows, direction, size in data.start_time_noise.parts:
                column = np.zeros(len(data.z))
                column[rows] = direction * size / math.hypot(1.0, size)
                starts += (gain @ w(data.with_white_angles(column))) ** 2
        variances = {"angle noise": base - process - starts, "process noise": process, "start times": starts}
        before = base
        for k, name in enumerate(NUISANCE, 1):
            after = np.diag(self._projected(k)[0])
            variances[name] = after - before
            before = after
        variances["lack of fit"] = (self.fit.variance_factor - 1) * before
        return variances

    def sensitivity(self, columns: Sequence[Array]) -> Array:
        """Return the change of all variables per unit of an input; `columns` are the changes of the rows per unit."""
        gradient = np.zeros(len(self.fit.theta))
        cases = zip(self.problem.projections, self.fit.predictions, columns, strict=True)
        for project, prediction, column in cases:
            gradient += project(prediction.jacobian).T @ project(column)
        return np.asarray(-(self.covariance @ gradient))


def _inertias(fit: Fit) -> Iterator[tuple[str, str, float, float]]:
    """Yield the moments of inertia of known uncertainty: source, body, value and uncertainty [kg m2].

    If the ratio of both moments of inertia is a parameter with a prior, its uncertainty is part of the standard errors.
    Then only the moment of inertia of the rotor is yielded, which scales both.
    """
    records = fit.problem.layout.records
    parts = [b.part for b in reversed(records[0].bodies)]
    for body in parts[:1] if _ratio_has_prior(fit) else parts:
        known = [(b.inertia, b.inertia_u) for r in records for b in r.bodies if b.part == body]
        several = len(set(known)) > 1
        for value, u in dict.fromkeys(known):
            if math.isfinite(u) and u > 0:
                label = f"@{records[known.index((value, u))].label}" if several else ""
                yield f"inertia.{body}{label}", body, value, u


def _ratio_has_prior(fit: Fit) -> bool:
    return any(d.prior is not None and INERTIA_RATIO in d.prior.names for d in fit.problem.data)


def _inertia_contributions(fit: Fit) -> dict[str, tuple[Array, Array | None]]:
    """Return the standard uncertainty of all variables due to each moment of inertia, and their mean slope."""
    inputs = list(_inertias(fit))
    # up to two inputs are propagated jointly; more than two, for example of several instruments, are propagated one by
    # one
    groups = [inputs] if len(inputs) < 3 else [[i] for i in inputs]
    found: dict[str, tuple[Array, Array | None]] = {}
    for group in groups:
        if not group:
            continue
        theta = np.empty((3,) * len(group) + fit.theta.shape)
        for place in np.ndindex(theta.shape[:-1]):
            nodes = zip(group, place, strict=True)
            moved = {(body, value): value + _NODES[k] * u for (_, body, value, u), k in nodes}
            theta[place] = _refitted(fit, moved)
        found |= propagated(theta, [(source, u) for source, _, _, u in group])
    return found


def propagated(values: Array, inputs: Sequence[tuple[str, float]]) -> dict[str, tuple[Array, Array | None]]:
    """Return the standard uncertainty due to each input, its mean slope, and the uncertainty due to their interaction.

    `values` (3, ..., results) are results at the nodes of the Gauss-Hermite rule, one axis for each (name, u) of
    `inputs`.
    """
    weights, found = np.array(_WEIGHTS), {}
    mean, square = values, values**2
    for _ in inputs:
        mean, square = (np.tensordot(weights, x, axes=(0, 0)) for x in (mean, square))
    joint = np.maximum(square - mean**2, 0.0)
    for axis, (source, u) in enumerate(inputs):
        alone = np.moveaxis(values, axis, 0)
        for _ in range(len(inputs) - 1):
            alone = np.tensordot(weights, alone, axes=(0, 1))
        variance = weights @ (alone - weights @ alone) ** 2
        found[source] = np.sqrt(variance), (alone[2] - alone[0]) / ((_NODES[2] - _NODES[0]) * u)
        joint = joint - variance
    if len(inputs) > 1:
        found[" x ".join(source for source, _ in inputs)] = np.sqrt(np.maximum(joint, 0.0)), None
    return found


def _refitted(fit: Fit, moved: Mapping[tuple[str, float], float]) -> Array:
    """Return the variables of the same fit with other moments of inertia, by body and present value [kg m2]."""
    layout = fit.problem.layout
    if all(value == other for (_, value), other in moved.items()):
        return fit.theta
    data = []
    for d in fit.problem.data:
        r = d.record
        names = zip(r.mechanism.bodies, r.inertias, strict=True)
        rotor, casing, *further = (moved.get((name, value), value) for name, value in names)
        if _ratio_has_prior(fit):
            casing = r.I_casing * rotor / r.I_rotor
        data.append(d.with_inertia(rotor, casing, further))
    share, per_case = layout.choices
    start = {n: float(x) for n, x in zip(layout.names, fit.theta, strict=True)}
    again = refit(fit.model, data, share=share, per_case=per_case, start=start, ranges=layout.ranges)
    return again.theta


def _clock_rows(data: CaseData, prediction: Prediction) -> Array:
    """Return the derivative of the rows of a case with respect to the clock error eps; t becomes t (1 + eps)."""
    start = data.record.span[0]

    def change(t: Array, omega: Array) -> Array:
        if data.is_angle:
            return (t - start) * omega
        # speeds that are gradients of angles are proportional to the clock rate
        scaled = omega if data.record.gradients else 0.0
        return (t - start) * np.gradient(omega, t) + scaled

    return _changed_rows(data, prediction, change)


def _speed_rows(data: CaseData, prediction: Prediction) -> Array:
    """Return the derivative of the rows of a case with respect to the relative error of the scale of its speeds."""
    return _changed_rows(data, prediction, lambda _, omega: omega)


def _changed_rows(data: CaseData, prediction: Prediction, of: Callable[[Array, Array], Array]) -> Array:
    """Return the rows of a change of the samples.

    The change is a function of the times and of the speed of the body.
    """
    path = prediction.path

    def change(run: Compressed, state: int) -> Array:
        t = run.samples.time
        return of(t, Sampler(path.mesh, t).value(path.y[..., state]))[:, None]

    return data.sample_rows(change(data.casing, MAIN), [change(w, w.samples.state) for w in data.rotor])[:, 0]
