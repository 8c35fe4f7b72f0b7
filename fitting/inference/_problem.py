"""All cases of a fit as one least-squares problem, its noise, and the covariance of its variables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fitting._errors import SimulationError
from fitting.dynamics._collocation import UNBOUNDED
from fitting.dynamics._model import Model
from fitting.effects._mechanism import GYROSCOPE, MAIN, Coupling, Mechanism
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import CaseModel, Prediction
from fitting.inference._linear_algebra import covariance_of, orthogonal_to, orthonormal, r_factor
from fitting.inference._noise import WHITE, Noise, TorqueNoise, TorqueResponse, Whitener, remaining_level
from fitting.inference._parameters import (
    ParameterLayout,
    PowerLaw,
    find_power_laws,
    find_sinusoids,
    from_physical,
    from_polar,
    to_physical,
    to_polar,
)
from fitting.inference._ties import chain, follow

Array = NDArray[np.float64]

_RANK = 1e-7
"""Relative singular value below which a nuisance direction is rounding error [1]. Chosen: a smaller value projects out
rounding errors; with a larger one, some nuisance columns are not projected out."""
_ROUNDING = 1e-11
"""The part of a column orthogonal to the nuisance columns is rounding error if its share of the column is below this
value [1]. Chosen: a smaller value determines parameters by rounding errors, a larger one holds weakly determined
parameters fixed."""


class Projection:
    """Whitens the rows of a case and projects out its nuisance parameters."""

    def __init__(self, data: CaseData, whitener: Whitener) -> None:
        self.whitener = whitener
        self.basis = orthonormal(whitener(data.nuisance), _RANK)

    def __call__(self, rows: Array) -> Array:
        """Return the whitened rows, orthogonal to the nuisance columns."""
        return orthogonal_to(self.basis, self.whitener(rows))

    def unexplained(self, columns: Array) -> Array:
        """Return whitened columns, orthogonal to the nuisance columns; zero if only rounding errors remain."""
        white = self.whitener(columns)
        projected = orthogonal_to(self.basis, white)
        size = np.linalg.norm(white, axis=0)
        return np.asarray(np.where(np.linalg.norm(projected, axis=0) > _ROUNDING * size, projected, 0.0))


@dataclass(frozen=True)
class Problem:
    """Residuals and Jacobian of all cases at given noise levels.

    Immutable: a change of noise, ranges or transformed variables returns a new problem.
    """

    layout: ParameterLayout
    data: tuple[CaseData, ...]
    cases: tuple[CaseModel, ...]  # case models; they cache their last solutions
    projections: tuple[Projection, ...]  # noise and nuisance columns of each case
    power_laws: tuple[PowerLaw, ...]  # power laws that are fitted in transformed variables

    @classmethod
    def of(cls, layout: ParameterLayout, data: Sequence[CaseData]) -> Self:
        """Return the problem with white measurement noise only."""
        return cls(
            layout,
            tuple(data),
            tuple(CaseModel(d, layout, i) for i, d in enumerate(data)),
            tuple(Projection(d, WHITE) for d in data),
            find_power_laws(layout, [d.initial_speeds for d in data]),
        )

    def with_noise(self, noise: Sequence[Noise]) -> Self:
        """Return the problem with this noise of each case."""
        projections = (Projection(d, n.whitener) for d, n in zip(self.data, noise, strict=True))
        return replace(self, projections=tuple(projections))

    def with_white_noise(self) -> Self:
        """Return the problem with white measurement noise only."""
        return replace(self, projections=tuple(Projection(d, WHITE) for d in self.data))

    def holding(self, names: Iterable[str], theta: Array) -> Self:
        """Return the problem with some variables held at their values."""
        values = {name: float(theta[self.layout.index[name]]) for name in names}
        ranges = {**self.layout.ranges, **{name: (x, x) for name, x in values.items()}}
        return replace(self, layout=replace(self.layout, ranges=ranges))

    @cached_property
    def reference(self) -> float:
        """A typical speed of the bearing, or of the first joint, in these cases [rad/s]."""
        return reference_speed(self.data, self.layout.model.mechanism)

    def predict(self, theta: Array) -> list[Prediction]:
        """Return the prediction of each case at physical variables, with derivatives for the free variables."""
        tied = self.layout.tied
        if not tied:
            return [case.predict(theta) for case in self.cases]
        theta = follow(theta, tied)
        slope = chain(theta, tied)
        found = (case.predict(theta) for case in self.cases)
        return [replace(p, columns=p.columns @ slope[np.ix_(p.places, p.places)]) for p in found]

    def residuals(self, predictions: Sequence[Prediction]) -> tuple[Array, Array]:
        """Return whitened, projected residuals and their Jacobian with respect to the physical variables.

        The rows of each case are reduced by a QR decomposition: a case with p variables has p + 1 rows. Sums of squares
        and products of columns, which determine the least-squares problem, are unchanged. A SimulationError is raised
        if a sum of squares is not finite.
        """
        r, j = [], []
        for data, project, p in zip(self.data, self.projections, predictions, strict=True):
            deviation = p.rows - data.z
            with np.errstate(over="ignore"):
                if not np.isfinite(deviation @ deviation):
                    raise SimulationError(UNBOUNDED)
            both = project.unexplained(np.concatenate([p.columns, deviation[:, None]], axis=1))
            few = r_factor(both)
            r.append(few[:, -1])
            dense = np.zeros((len(few), p.count))
            dense[:, p.places] = few[:, :-1]
            j.append(dense)
        return np.concatenate(r), np.concatenate(j)

    @property
    def rows(self) -> int:
        """Number of rows of all cases minus the number of nuisance parameters."""
        return sum(d.row_count - p.basis.shape[1] for d, p in zip(self.data, self.projections, strict=True))

    def __call__(self, u: Array) -> tuple[Array, Array]:
        """Return residuals and their Jacobian with respect to the transformed variables u."""
        sinusoids = find_sinusoids(self.layout)
        theta, slope = to_physical(u, self.power_laws)
        theta, polar_slope = to_polar(theta, sinusoids)
        r, j = self.residuals(self.predict(theta))
        if sinusoids:
            j = j @ polar_slope
        return r, j @ slope if self.power_laws else j

    def transformed(self, theta: Array) -> Array:
        """Return the transformed variables that correspond to physical variables."""
        return from_physical(from_polar(theta, find_sinusoids(self.layout)), self.power_laws)

    def physical(self, u: Array) -> Array:
        """Return the physical variables that correspond to transformed variables."""
        theta = to_polar(to_physical(u, self.power_laws)[0], find_sinusoids(self.layout))[0]
        return follow(theta, self.layout.tied)

    def transformed_bounds(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return the bounds of the transformed variables.

        During the search, the strengths d and f of a pair of laws, and a strength with a phase, have no bounds. The
        strength f of a single power law has no upper bound.
        """
        lower, upper = lower.copy(), upper.copy()
        for w in find_sinusoids(self.layout):
            lower[w.strength], upper[w.strength] = -np.inf, np.inf
        for v in self.power_laws:
            if v.held:
                free = v.f if v.held == "d" else v.d
                lower[free], upper[free] = -np.inf, np.inf
            elif v.d is not None:
                lower[[v.d, v.f]], upper[[v.d, v.f]] = -np.inf, np.inf
            else:
                lower[v.f], upper[v.f] = 0.0 if lower[v.f] >= 0 else -np.inf, np.inf
        return lower, upper


def reference_speed(data: Sequence[CaseData], mechanism: Mechanism = GYROSCOPE) -> float:
    """Return a typical speed of the bearing, or of the first joint, in these cases [rad/s]."""
    return typical_speed([d.initial_speeds[1] for d in data], mechanism, mechanism.couplings[0])


def typical_speed(speeds: Sequence[Array], mechanism: Mechanism, joint: Coupling) -> float:
    """Return a typical relative speed of a joint, from the speeds (times, bodies) of each case [rad/s]."""
    typical = [np.median(np.abs(mechanism.motion(s.T)[joint.delta])) for s in speeds]
    return float(np.mean(typical)) or 1.0  # for bodies at rest, any positive value is suitable


_BEYOND = 3.0
"""A parameter is taken to equal its bound if the unconstrained optimum is beyond the bound by more than this distance
[standard errors]. Chosen: a smaller value ignores the uncertainty at a bound, a larger one treats a fixed parameter as
free."""
_LEAST_CHANGE = 0.2
"""Smallest relative change of a parameter that is listed in a degenerate combination [1]. Chosen: a smaller value lists
uninvolved parameters, a larger one omits involved parameters."""


def surely_at_bound(
    layout: ParameterLayout, at_bound: NDArray[np.bool_], r: Array, j: Array
) -> NDArray[np.bool_]:
    """Return a mask of the variables that are known to equal their bound.

    A friction coefficient whose unconstrained optimum is far below zero is known to be zero. If the optimum is only
    slightly below zero, or if an exponent is at a bound of its range, the parameter is treated as free: its uncertainty
    contributes to the standard errors of correlated parameters.
    """
    no_influence = np.linalg.norm(j, axis=0) == 0
    covariance = covariance_of(j, ~no_influence)
    with np.errstate(invalid="ignore", divide="ignore"):
        beyond = np.abs(covariance @ (j.T @ r)) / np.sqrt(np.diag(covariance))
    physical = np.array([layout.is_physical_bound(name) for name in layout.names])
    return np.asarray(no_influence | (at_bound & physical & (np.nan_to_num(beyond) > _BEYOND)))


def degenerate_directions(names: Sequence[str], theta: Array, covariance: Array) -> list[dict[str, float]]:
    """Return combinations of parameters that the data do not determine although each alone may seem determined.

    Each combination is a dict of relative changes, scaled to a largest change of +1. If the parameters change together
    along the combination, the change is within one standard error. Relative changes below a fifth of the largest
    change, and combinations of a single parameter, are left out.
    """
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    kept = np.flatnonzero((theta != 0) & np.isfinite(error) & (error > 0))
    if not len(kept):
        return []
    relative = covariance[np.ix_(kept, kept)] / np.outer(theta[kept], theta[kept])
    values, vectors = np.linalg.eigh(relative)
    directions = []
    for i in np.flatnonzero(values > 1.0)[::-1]:
        weights = vectors[:, i] / vectors[np.argmax(np.abs(vectors[:, i])), i]
        chosen = {names[kept[k]]: float(w) for k, w in enumerate(weights) if abs(w) > _LEAST_CHANGE}
        if len(chosen) > 1:
            directions.append(chosen)
    return directions


_FIRST_LEVEL = 0.01
"""First random torque, as a share of the median torque on the rotor, or of the largest median torque on a body other
than the main one [1]. Chosen: with a smaller value, the worst interval dominates the search; a larger one hides the
shape of laws."""
_MOST_AT_REST = 0.5
"""Blocks at rest are left out of the estimate of the random torque if they are at most this share of the blocks [1].
Chosen: a smaller value includes blocks that do not respond; with a larger one, few blocks remain."""
_FIRST_TIME = 1 / 200
"""Correlation time of the first random torque, divided by the length of the record [1]. Chosen: a slower torque would
absorb the error of the initial values, a faster one is white noise."""


def recording_noise(data: CaseData, prediction: Prediction) -> Noise:
    """Return the noise of a recording; the response of the rows to random torques is linearised about a prediction.

    The random torques on the main body and in the joints have the same rms; their sum accelerates the main body.
    """
    process, mechanism = data.process_noise, data.record.mechanism
    torque = data.record.I_casing / float(np.sqrt(1 + mechanism.joints_of(mechanism.main)))
    pure = TorqueNoise(torque * process.level, process.time)
    whitener = TorqueResponse(data, prediction.motion).whitener(pure)
    return Noise(
        data.casing.scale, pure.rms, torque * process.level_u, pure.rms, pure.time, whitener, process
    )


def first_noise(problem: Problem, theta: Array) -> tuple[Noise, ...]:
    """Return the noise of a first search, a random torque of a hundredth of the median torque on the rotor."""
    found = []
    predictions = problem.predict(theta)
    for case, p, level in zip(problem.cases, predictions, _first_levels(problem, theta), strict=True):
        first, last = case.data.record.span
        time = _FIRST_TIME * (last - first)
        whitener = TorqueResponse(case.data, p.motion).whitener(TorqueNoise(level, time))
        process = case.data.process_noise
        found.append(Noise(case.data.casing.scale, level, 0.0, level, time, whitener, process))
    return tuple(found)


def raised_noise(problem: Problem, theta: Array, noise: Sequence[Noise]) -> tuple[Noise, ...]:
    """Return a known noise raised to the level of `first_noise`, for a search that starts far from the minimum."""
    levels = _first_levels(problem, theta)
    return tuple(n.at(max(n.level, level)) for n, level in zip(noise, levels, strict=True))


def _first_levels(problem: Problem, theta: Array) -> list[float]:
    levels = []
    for case, p in zip(problem.cases, problem.predict(theta), strict=True):
        numbers = problem.layout.numbers(theta, case.case)
        rates = np.abs(case.dynamics.rates(p.path.mesh.times, p.path.y, numbers))
        inertias = enumerate(case.data.record.inertias)
        levels.append(
            max(_FIRST_LEVEL * x * float(np.median(rates[..., i])) for i, x in inertias if i != MAIN)
        )
    return levels


def measure_noise(problem: Problem, theta: Array) -> tuple[Noise, ...]:
    """Return the noise of each case about a fitted model, with the level of its residuals."""
    about = dict(zip(problem.layout.names, theta.tolist(), strict=True))
    predictions = problem.predict(theta)
    found = [
        replace(recording_noise(d, p), about=about) for d, p in zip(problem.data, predictions, strict=True)
    ]
    return refine_level(problem, theta, found)


def fails_grossly(data: CaseData, prediction: Prediction, noise: Noise) -> bool:
    """Return whether a random torque as large as the residuals would make the phase of an oscillation random.

    After the time t, a random acceleration with spectral density S has changed the phase of an oscillation of amplitude
    a and frequency w by an rms of sqrt(S t / 2) / (a w). An acceleration of rms s and correlation time tau has S = 2
    s^2 tau / (1 + w^2 tau^2). The limit of the phase is `Criteria.gross_misfit`.
    """
    motion = data.motion
    slow = motion.slow_motion
    if slow is None:
        return False
    columns = np.concatenate([prediction.columns, data.nuisance], axis=1)
    level, _ = remaining_level(noise.whitener, data.z - prediction.rows, columns)
    w = 2 * np.pi / motion.period
    density = 2 * (level / data.record.I_casing) ** 2 * noise.time / (1 + (w * noise.time) ** 2)
    duration = motion.periods * motion.period
    phase = np.sqrt(density * duration / 2 / np.mean(slow.amplitude**2)) / w
    return bool(phase > data.criteria.gross_misfit)


def _rows_at_rest(data: CaseData, prediction: Prediction) -> Array:
    """Return unit columns for the smooth rows of all blocks in which the modelled casing is at rest or comes to rest.

    There are no columns if more than half of the blocks would be left out.
    """
    edges, still = prediction.path.mesh.edges, prediction.path.sense == 0
    k = data.casing.lift.shape[1]
    times = data.casing.samples.time
    spans = np.array([(times[where][0], times[where][-1]) for where, _ in data.casing.operators])
    overlaps = (edges[:-1][still] < spans[:, 1:]) & (edges[1:][still] > spans[:, :1])
    rests = overlaps.any(axis=1)
    if not rests.any() or rests.mean() > _MOST_AT_REST:
        return np.zeros((len(data.z), 0))
    return np.eye(len(data.z))[:, np.flatnonzero(np.repeat(rests, k))]


def free_columns(data: CaseData, prediction: Prediction, moving: NDArray[np.bool_]) -> Array:
    """Return the free columns for the estimate of a random torque: `moving` variables, nuisance, harmonics, rest."""
    own = prediction.columns[:, moving[prediction.places]]
    return np.concatenate(
        [own, data.nuisance, data.harmonic_responses, _rows_at_rest(data, prediction)], axis=1
    )


def refine_level(
    problem: Problem, theta: Array, noise: Sequence[Noise], *, fixed: bool = False
) -> tuple[Noise, ...]:
    """Return the noise of each case with the level that the residuals of the model show at these variables.

    The level of each case is estimated separately, with its variables free or `fixed`, because the optimum of a shared
    variable may differ between cases.

    If the model of an oscillation fails grossly, the level of the recording is kept. At the level of the residuals, the
    phase would be random. The period, which the data determine best, would then have no weight (measured: the fitted
    torque of a pendulum was 6 % too small). The uncertainties are scaled by the residuals instead.

    For a body that is driven by a recorded input, the level is at most the lowest level that the recording allows. This
    lowest level is estimated with the linear response to the input as a free function. The response to a change of the
    input determines the parameters. At a larger level, random torques would describe the motion after such a change
    instead of an inexact model (measured: the time constant of a motor becomes 39 ms instead of 25 ms). If the model
    lacks the drive, random torques would even describe the whole motion.

    Rows in which the model is at rest are left out: they hardly respond to a torque, so that only unlimited torques
    would explain their residuals. A random torque is never larger than the largest torque of the recording. Cases whose
    noise is `common` have the largest level of all cases.
    """
    found = []
    moving = ~problem.layout.at_bound(theta) & (not fixed)
    restoring = problem.layout.model.restoring
    for data, p, n in zip(problem.data, problem.predict(theta), noise, strict=True):
        columns = free_columns(data, p, moving)
        level, excess = remaining_level(n.whitener, data.z - p.rows, columns)
        level = min(level, data.largest_torque or np.inf)
        if restoring and fails_grossly(data, p, n):
            level = n.pure
        elif data.driven:
            level = min(level, n.least)
        found.append(replace(n.at(level), excess=excess, limited=bool(data.driven)))
    return common_level(found) if any(n.common for n in found) else tuple(found)


def is_driven(model: Model, data: CaseData) -> bool:
    """Return whether a law of the model depends on a varying input of the record."""
    varying = {i.name for i in data.record.driving}
    return any(name in varying for e in model.effects for name, _ in e.inputs)


def common_level(noise: Sequence[Noise]) -> tuple[Noise, ...]:
    """Return the noise of each case at the largest level of all cases; later estimates also use a common level."""
    largest = max(n.level for n in noise)
    return tuple(replace(n.at(largest), common=True) for n in noise)
