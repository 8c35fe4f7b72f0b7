"""Score test of all candidate effects at once, without a refit; null distributions of the scores.

The covariance of the rows of a case is C = V (1 + s^2 L) V' with a diagonal matrix L, and with the same V at every
level s of the process noise. Therefore rows are rotated by V' once, and whitened at each level by one factor per row.

A small torque u(t) on a body changes the rows by W u. W is the response of the linearised motion to a torque in each of
many short cells, the intervals into which the record is divided. One matrix product gives the rows of all candidates at
all values of their shape constants. Only laws of an angle and camera effects are evaluated at the samples.

Let r be the whitened residuals, J the Jacobian (parameters and nuisance parameters) and s the columns of a candidate.
Then

    S = gamma' (s'Ms) gamma,   gamma = (s'Ms)^-1 s'Mr,   M = 1 - J (J'J)^-1 J',

is the fall of chi-square that a refit would give to first order (C. R. Rao, Proc. Camb. Phil. Soc. 44, 50 (1948)). The
process noise can describe the same residuals as the effect, so its level is profiled: the score is the smallest
deviance over all levels without the effect, minus the smallest deviance over all levels with the effect.

Candidates are correlated, and some have many trial shapes. Therefore p-values are calibrated with simulated null data
that undergo the same search. A candidate with many shapes is equivalent to N independent trials, each with the p-value
p1 of a single shape: p = 1 - (1 - p1)^N. N reproduces the upper tail of the largest scores of the candidate in null
data. The whole list is equivalent to a number of independent candidates in the same sense (P. Westfall, S. Young,
Resampling-Based Multiple Testing, Wiley (1993)).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting.dynamics._collocation import Sampler
from fitting.dynamics._inputs import means_in
from fitting.effects._effect import Effect, Parameter, State
from fitting.effects._expression import Expr, Tape, derivative
from fitting.inference._case_model import CaseModel, Prediction
from fitting.inference._linear_algebra import block_diagonal, orthogonal_to, orthonormal
from fitting.inference._multiple_tests import any_of, independent_tests, number_of_trials
from fitting.inference._noise import Noise, TorqueResponse, Whitener, possible_scales
from fitting.inference._record import scales_of
from fitting.inference._result import Fit

Array = NDArray[np.float64]

_LEVELS = 9
"""Number of trial levels of the process noise [1]. Chosen: a smaller number makes the profiled score coarse, a larger
one costs time and memory."""
_ABSORBED = 1e-7
"""The base absorbs a column if, before whitening, the norm of the part orthogonal to the free columns, divided by the
norm of the column, is below this value [1]. Chosen: a smaller value scores rounding errors, a larger one drops weakly
determined effects."""
RANK = 1e-10
"""Relative singular value below which a direction of the free columns is rounding error [1]. Chosen: a smaller value
projects out rounding errors, a larger one ignores some free columns."""
_SEED = 7
"""Seed of the null data sets [1]. Chosen: any value makes p-values reproducible; another seed changes p-values within
their error."""


class Level(NamedTuple):
    """One level of process noise: gain of each row, basis of the free columns, projected residual, deviance."""

    gain: Array
    basis: Array
    residual: Array
    deviance: float


class ScoreContext:
    """Whitened residuals, free columns and null data of a fit at several levels of process noise.

    The effects `without` are removed from the model: their parameters are not free, and their contribution
    `torque_rows` (rows,) to the prediction is added to the residual. With `release`, parameters at a bound are free as
    well. The parameters `shared` have separate values for the cases in the fit, but one common value here.
    """

    def __init__(
        self,
        fit: Fit,
        draws: int,
        *,
        without: Sequence[str] = (),
        torque_rows: Array | None = None,
        release: bool = False,
        shared: Sequence[str] = (),
    ) -> None:
        self.fit = fit
        data = fit.problem.data
        self.ends = np.cumsum([0, *(len(d.z) for d in data)])
        random = np.random.default_rng(_SEED)
        shares = np.linspace(0, 1, _LEVELS) if any(n.raised for n in fit.noise) else np.array([1.0])
        self._axes = [n.whitener.vectors for n in fit.noise]
        levels = [[_level_between(n.least, n.level, x) for n in fit.noise] for x in shares]
        self._whiteners = [[n.whitener.at(x) for n, x in zip(fit.noise, at, strict=True)] for at in levels]
        # parameters at a bound are held unless released, because only a refit enforces bounds
        moving = np.ones(len(fit.theta), dtype=bool) if release else ~fit.problem.layout.at_bound(fit.theta)
        names = fit.problem.layout.names
        moving &= np.array([n.partition("@")[0].rpartition(".")[0] not in without for n in names], dtype=bool)
        jacobian = np.concatenate([p.jacobian for p in fit.predictions])
        for key in shared:
            own = [i for i, n in enumerate(names) if n.partition("@")[0] == key]
            jacobian[:, own[0]] = jacobian[:, own].sum(axis=1)
            moving[own[1:]] = False
        free = jacobian[:, moving]
        nuisance = block_diagonal([d.nuisance for d in data])
        residual = np.concatenate([d.z - p.rows for d, p in zip(data, fit.predictions, strict=True)])
        residual = residual if torque_rows is None else residual + torque_rows
        self._moving = moving
        everything = np.concatenate([free, nuisance], axis=1)
        self.free = self.rotated(everything)
        self._residual = self.rotated(residual)
        self._unwhitened_basis = orthonormal(free, RANK)
        self.levels = [self._level(w, self.free) for w in self._whiteners]
        self.draws = self.rotated(random.standard_normal((len(residual), draws)))

    def rotated(self, rows: Array) -> Array:
        """Return rows of all cases along the principal axes of their noise."""
        parts = []
        for v, a, b in zip(self._axes, self.ends, self.ends[1:], strict=False):
            parts += [v.T @ rows[a : a + len(v)], rows[a + len(v) : b]]
        return np.concatenate(parts)

    def base_change(self, rows: Array) -> Array:
        """Return the change of the parameters of the fit, to first order, if rows are added to its prediction.

        The change follows from generalised least squares at the level of the fit; it is zero for fixed parameters.
        """
        gain = self.levels[-1].gain
        columns, data = gain[:, None] * self.free, gain * (self._residual - self.rotated(rows))
        size = np.linalg.norm(columns, axis=0)
        size[size == 0] = np.inf
        found = np.linalg.lstsq(columns / size, data, rcond=1e-10)[0] / size
        change = np.zeros(len(self._moving))
        change[self._moving] = found[: int(self._moving.sum())]
        return change

    def absorbed_by_base(self, groups: Sequence[Array]) -> NDArray[np.bool_]:
        """Return a mask of the groups of columns that the free columns of the base absorb."""
        everything = np.concatenate(groups, axis=1)
        projected = orthogonal_to(self._unwhitened_basis, everything)
        share = np.linalg.norm(projected, axis=0) / np.maximum(np.linalg.norm(everything, axis=0), 1e-300)
        return np.asarray(share.reshape(len(groups), -1).max(axis=1) < _ABSORBED)

    def _level(self, whiteners: Sequence[Whitener], free: Array) -> Level:
        gain = np.concatenate([
            np.concatenate([1 / np.sqrt(1 + w.level**2 * w.values), np.ones(b - a - len(w.values))])
            for w, a, b in zip(whiteners, self.ends, self.ends[1:], strict=False)
        ])  # fmt: skip
        q = orthonormal(gain[:, None] * free, RANK)
        r = orthogonal_to(q, gain * self._residual)
        return Level(gain, q, r, float(r @ r) + sum(w.log_determinant for w in whiteners))

    def shares(self, direction: Array) -> tuple[float, ...]:
        """Return the share of the process noise of each case in the variance of a response.

        The response is rotated, whitened, and of unit length. If a lack of fit raises the level of a case, its share is
        zero, because the raised level is not process noise.
        """
        found = []
        for n, a in zip(self.fit.noise, self.ends, strict=False):
            torque = n.level**2 * n.whitener.values
            square = direction[a : a + len(torque)] ** 2
            found.append(0.0 if n.raised else float(square @ (torque / (1 + torque))))
        return tuple(found)

    def with_free(self, columns: Array) -> list[Level]:
        """Return the levels with additional free columns."""
        free = np.concatenate([self.free, self.rotated(columns)], axis=1)
        return [self._level(w, free) for w in self._whiteners]


def _level_between(least: float, level: float, share: float) -> float:
    if level <= least:
        return level
    floor = max(least, 1e-3 * level)
    return float(floor * (level / floor) ** share)


_PHASE_STEP = 1.5
"""Spacing of trial frequencies, as a phase difference at the end of the record [rad]. Chosen: a smaller value costs
time, a larger one overlooks narrow peaks."""
_FASTEST = 1.0
"""Highest trial frequency that the cells resolve [rad per cell]. Chosen: a larger value blurs the torque within a cell,
a smaller one overlooks fast chirps."""
_MAX_FREQUENCIES = 1500
"""Largest number of trial frequencies [1]. Chosen: with fewer, the highest frequency in long records is lower; with
more, the search takes longer."""
_FINER = 8
"""Number of trial changepoints per interval between the trial values that an effect declares [1]. Chosen: a smaller
value overlooks narrow maxima of the score, a larger one costs time."""
_CHOICES = 128
"""Number of choices of shape constants that are evaluated at once [1]. Chosen: a smaller number makes the matrix
products small and slow, a larger one needs memory; the result does not depend on this number."""


@dataclass(frozen=True)
class Trial:
    """One choice of the shape constants of a candidate, and the columns of the candidate in the rows of one case."""

    shape: dict[str, float]
    columns: Array


class CaseColumns:
    """The columns of candidates in the rows of one case of a fit."""

    def __init__(self, fit: Fit, index: int) -> None:
        self.case: CaseModel = fit.problem.cases[index]
        self.prediction: Prediction = fit.predictions[index]
        self.numbers = fit.problem.layout.numbers(fit.theta, index)
        self._scales = scales_of(fit.problem.layout.records)
        self.response = TorqueResponse(self.case.data, self.prediction.motion)
        path = self.prediction.path
        self._restoring = fit.model.restoring
        y = Sampler(path.mesh, self.response.centres).value(path.y)
        self._states_of_motion = y
        self._known: dict[str, Any] = {name: y[:, i] for i, name in enumerate(path.states)}
        mechanism = self.case.dynamics.mechanism
        self._known |= {"t": self.response.centres, **mechanism.motion(y[:, : path.speeds].T)}
        self._known |= means_in(self.case.data.record.inputs, self.response.edges)
        motion = self.case.data.motion
        deflection = np.interp(self.response.centres, motion.time, motion.deflection)
        self._known = {"deflection": deflection} | self._known
        dynamics = self.case.dynamics
        torques = Tape(list(dynamics.joint_torques.values()))(self._known | dynamics.constants | self.numbers)
        taus = zip(dynamics.joint_torques, torques, strict=True)
        self._known |= {symbol: np.asarray(tau) * np.ones(len(y)) for symbol, tau in taus}
        rates = dynamics.rates(self.response.centres, y, self.numbers)
        # some effects multiply an existing torque by a factor: the torque of a joint, or inertia times acceleration
        self._scaled_torque = {c.name: self._known[c.tau] for c in mechanism.couplings}
        for i, (body, key) in enumerate(zip(mechanism.bodies, mechanism.inertias, strict=True)):
            self._scaled_torque[body] = self.numbers[key] * rates[:, i]
        # torque that represents the size of all torques of a recording; it depends on the body that is spun up
        joint, main = mechanism.couplings[0].name, mechanism.main
        self._typical = {"rotor": self._scaled_torque[joint], "body": self._scaled_torque[main]}

    def trials(self, effect: Effect, choices: list[dict[str, float]] | None = None) -> list[Trial]:
        """Return the columns of a candidate for the given choices of its shape constants, by default for its grid."""
        effect = effect.about_equilibrium if self._restoring else effect
        if not effect.mechanical or effect.depends_on_angle:
            sine, cosine = self.case.unit_columns(
                effect, self.prediction.path, self.prediction.sensitivity, self.numbers
            )
            pair = [sine, cosine] if _phase_symbol(effect) else [sine]
            return [Trial({}, np.stack(pair, axis=1))]
        if choices is None:
            shapes = [p for p in self.parameters(effect) if p.role == "shape"]
            grids = [self._grid(effect, p) for p in shapes]
            symbols = [p.symbol for p in shapes]
            choices = [dict(zip(symbols, map(float, v), strict=True)) for v in itertools.product(*grids)]
        if effect.joint == "input":
            return [Trial({}, self.torque_rows(*self.torque(effect, {})))]
        unit = self._units(effect, choices)
        rows = np.zeros((len(self.response.casing), unit.shape[1]))
        for share, response in zip(self._shares(effect), self.response.bodies.values(), strict=True):
            if share:
                rows += share * (response @ unit)
        rows = self.padded(rows)
        width = unit.shape[1] // len(choices)
        return [Trial(c, rows[:, i * width : (i + 1) * width]) for i, c in enumerate(choices)]

    def fitted(self, effect: Effect) -> tuple[dict[str, float], Array]:
        """Return the shape constants of an effect of the fit, and the strengths at phase 0 and at a quarter period."""
        values = [(p, self.numbers[f"{effect.name}.{p.symbol}"]) for p in effect.parameters]
        role = {p.role: x for p, x in values}
        phase = role.get("phase", 0.0)
        strengths = role.get("amplitude", 1.0) * np.array([np.cos(phase), np.sin(phase)])
        return {p.symbol: x for p, x in values if p.role in {"shape", "fixed"}}, strengths

    def padded(self, smooth: Array) -> Array:
        """Return smooth rows followed by zeros for the rows that do not respond to slow torques."""
        return np.concatenate([smooth, np.zeros((len(self.case.data.z) - len(smooth), smooth.shape[1]))])

    def parameters(self, effect: Effect) -> tuple[Parameter, ...]:
        """Return the parameters of an effect with bounds and trial values of these recordings, in SI units."""
        return effect.parameters_at(*self._scales)

    def _grid(self, effect: Effect, p: Parameter) -> Array:
        first, last = self.case.data.record.span
        if effect.state is not None and _phase_symbol(effect):
            # phase of the sinusoid per unit of its frequency parameter, over the whole record
            phase = self._states(effect, effect.state, effect.rates[0], {p.symbol: np.ones(1)})[:, 0]
            range_ = float(np.ptp(phase))
            fastest = _FASTEST / max(float(np.abs(np.diff(phase)).max()), 1e-300)
            count = int(min(_MAX_FREQUENCIES, fastest * range_ / _PHASE_STEP))
            return np.linspace(fastest / max(count, 1), fastest, max(count, 1))
        grid = np.array(p.grid or (p.start,))
        if p.symbol == effect.breakpoint:
            # the stronger an effect, the narrower is the minimum of chi-square about its changepoint
            finer = np.interp(np.arange((len(grid) - 1) * _FINER + 1) / _FINER, np.arange(len(grid)), grid)
            return np.asarray(first + finer * (last - first))
        return grid * (last - first) if p.relative else grid

    @property
    def typical_torque(self) -> Array:
        """Torque of the bearing in each cell [N m]; for a single body or a chain, the net torque on the main body."""
        return np.asarray(self._typical[self.case.data.record.spun.role])

    @staticmethod
    def _shares(effect: Effect) -> tuple[float, ...]:
        """Return the share of the torque of a law that acts on each body."""
        return effect.mechanism.shares(effect.site)

    def torque(self, effect: Effect, shape: dict[str, float]) -> tuple[Array, ...]:
        """Return the torques of a unit strength on each body, each (cells, columns) [N m]."""
        if effect.joint == "input":
            dynamics, y = self.case.dynamics, self._states_of_motion
            by = dynamics.by_delay(
                effect.inputs[0][0], self.response.centres, self.response.edges, y, self.numbers
            )
            keys = dynamics.mechanism.inertias
            return tuple(self.numbers[key] * by[:, i : i + 1] for i, key in enumerate(keys))
        unit = self._units(effect, [shape])
        return tuple(share * unit for share in self._shares(effect))

    def along_motion(self, variable: str) -> Array:
        """Return the time "t" [s] or a speed [rad/s] at the centre of each cell."""
        return np.asarray(self._known[variable])

    def torque_rows(self, *torques: Array) -> Array:
        """Return the response of the rows to torques on each body, each (cells, columns) [N m]."""
        first, *others = zip(self.response.bodies.values(), torques, strict=True)
        rows = first[0] @ first[1]
        for response, torque in others:
            rows = rows + response @ torque
        return self.padded(rows)

    def _units(self, effect: Effect, choices: Sequence[dict[str, float]]) -> Array:
        """Return the torque of a law of strength 1 in each cell, for all choices of its shape constants (columns)."""
        few = [choices[i : i + _CHOICES] for i in range(0, len(choices), _CHOICES)]
        return np.concatenate([self._units_of_few(effect, c) for c in few], axis=1)

    def _units_of_few(self, effect: Effect, choices: Sequence[dict[str, float]]) -> Array:
        amplitude = next(p.symbol for p in effect.parameters if p.role == "amplitude")
        shapes = {symbol: np.array([c[symbol] for c in choices]) for symbol in choices[0]}
        values = self._cells | {p.symbol: p.start for p in self.parameters(effect)} | shapes
        for state, rate in zip(effect.states, effect.rates, strict=True):
            values[state.symbol] = self._states(effect, state, rate, shapes)
        with np.errstate(all="ignore"):
            if effect.joint in {"factor", "inertia"}:
                slope = derivative(effect.expression, amplitude)
                scale = self._scaled_torque[effect.site][:, None]
                law = [scale * np.asarray(Tape([slope])(values | {amplitude: 0.0})[0])]
            else:
                values[amplitude] = 1.0
                law = _at_phases(effect, values)
            size = (len(self.response.centres), len(choices))
            unit = np.stack([np.broadcast_to(v, size) for v in law], axis=2)
            if effect.breakpoint:
                self._jump_within_cell(effect, values, unit)
        unit = unit.reshape(size[0], -1)
        # a choice is not tested if the law is singular along the motion
        return np.where(np.isfinite(unit).all(axis=0), unit, 0.0)

    @property
    def _cells(self) -> dict[str, Any]:
        """The variables of the motion in each cell, each as a column (cells, 1)."""
        return {k: np.asarray(v)[:, None] if np.ndim(v) else v for k, v in self._known.items()}

    def _jump_within_cell(self, effect: Effect, values: dict[str, Any], unit: Array) -> None:
        """Replace the torque of the cell that contains the changepoint by its mean over the cell, for each choice."""
        edges, count = self.response.edges, unit.shape[1]
        at = np.broadcast_to(values[effect.breakpoint], count)
        cell = np.searchsorted(edges, at, side="right") - 1
        inside = np.flatnonzero((cell >= 0) & (cell < len(unit)))
        cell, at = cell[inside], at[inside]
        share_after = (edges[cell + 1] - at) / (edges[cell + 1] - edges[cell])
        wide = {k: np.broadcast_to(v, unit.shape[:2]) if np.ndim(v) else v for k, v in values.items()}
        in_cell = {k: v[cell, inside] if np.ndim(v) else v for k, v in wide.items()}
        tape = Tape([effect.expression])
        before, after = (
            np.broadcast_to(tape(in_cell | {"t": t})[0], len(inside))
            for t in (edges[cell] - 1e-9, edges[cell + 1] + 1e-9)
        )
        unit[cell, inside] = ((1 - share_after) * before + share_after * after)[:, None]

    def _states(self, effect: Effect, state: State, rate: Expr, shapes: dict[str, Array]) -> Array:
        """Return a state of an effect along the motion of the base, integrated with constant rates in each cell.

        There is one column for each choice of the shape constants.
        """
        symbol = state.symbol
        tape = Tape([rate, derivative(rate, symbol)])
        values = self._cells | {p.symbol: p.start for p in self.parameters(effect)} | shapes | {symbol: 0.0}
        size = (len(self.response.centres), max((len(v) for v in shapes.values()), default=1))
        source, decay = (np.broadcast_to(v, size) for v in tape(values))
        h = self.response.edges[1] - self.response.edges[0]
        first = state.start + 0.5 * h * source[0]
        increment = 0.5 * h * (source[1:] + source[:-1])
        if not decay.any():
            return np.asarray(first + np.concatenate([np.zeros((1, size[1])), np.cumsum(increment, axis=0)]))
        # because a state may decay within a cell, the step is exact for a constant decay rate
        exponent = 0.5 * h * (decay[:-1] + decay[1:])
        factor = np.exp(exponent)
        safe = np.where(exponent == 0, 1.0, exponent)
        gain = increment * np.where(exponent == 0, 1.0, np.expm1(exponent) / safe)
        found = np.empty(size)
        found[0] = first
        for i in range(size[0] - 1):
            found[i + 1] = factor[i] * found[i] + gain[i]
        return found


def _phase_symbol(effect: Effect) -> str:
    return next((p.symbol for p in effect.parameters if p.role == "phase"), "")


def _at_phases(effect: Effect, values: dict[str, Any]) -> list[Array]:
    """Return a law at phase 0 and at a quarter period, or once if it has no phase."""
    tape, phase = Tape([effect.expression]), _phase_symbol(effect)
    phases: list[dict[str, float]] = [{phase: 0.0}, {phase: np.pi / 2}] if phase else [{}]
    return [np.asarray(tape(values | p)[0]) for p in phases]


# shape constants of each case, and the columns over the rows of all cases
Group = tuple[tuple[dict[str, float], ...], Array]


@dataclass(frozen=True)
class Score:
    """The best trial of a candidate."""

    effect: Effect  # the candidate
    score: float  # predicted fall of the deviance
    # strength of each column (sine and cosine of a law with a phase; one set for each case if the effect is per case)
    gamma: Array = field(repr=False)
    shape: tuple[dict[str, float], ...]  # shape constants, for each case
    columns: int  # degrees of freedom of its strengths
    trials: int  # number of tried choices of its shape constants
    absorbed: bool  # whether the base absorbs the candidate completely
    # whitened, projected response at the fitted strength, of unit length, for cosines between candidates
    direction: Array = field(repr=False)
    null: Array = field(repr=False)  # scores of the null data
    # share of the process noise of each case in the variance of the response
    shares: tuple[float, ...] = field(default=(), repr=False)
    noise: tuple[Noise, ...] = field(default=(), repr=False)  # noise of each case
    own_phase: bool = False  # whether each case has a separate strength and phase; the shape is shared


def score_in_case(context: ScoreContext, effect: Effect, trials: list[Trial], case: int) -> Score:
    """Return the best trial of an effect that acts in one case, with the free columns of all cases."""
    return best_group(context, effect, rows_of_case(context, trials, case), context.levels)


def rows_of_case(context: ScoreContext, trials: list[Trial], case: int) -> list[Group]:
    """Return the columns of one case, padded to the rows of all cases."""
    groups: list[Group] = []
    for t in trials:
        rows = np.zeros((context.ends[-1], t.columns.shape[1]))
        rows[context.ends[case] : context.ends[case + 1]] = t.columns
        groups.append(((t.shape,), rows))
    return groups


def best_group(
    context: ScoreContext, effect: Effect, groups: list[Group], levels: list[Level], *, null: bool = True
) -> Score:
    """Return the score of the best group of columns over all levels of process noise; `null` scores null data too."""
    bounds = _bounds(effect)
    best: tuple[float, int, Array, Array] = (-np.inf, 0, np.zeros(1), np.zeros(1))
    absorbed = context.absorbed_by_base([c for _, c in groups])
    rotated = context.rotated(np.concatenate([c for _, c in groups], axis=1))
    null_scores = np.zeros(0)
    for i, level in enumerate(levels):
        columns = level.gain[:, None] * rotated
        columns = orthogonal_to(level.basis, columns)
        scores, gammas = _solve(columns, level.residual, len(groups), bounds)
        scores = np.where(absorbed, 0.0, scores)
        place = int(np.argmax(scores))
        gain = float(scores[place]) - (level.deviance - min(x.deviance for x in levels))
        if gain > best[0]:
            width = columns.shape[1] // len(groups)
            direction = columns[:, place * width : (place + 1) * width] @ gammas[place]
            best = (gain, place, gammas[place], direction / max(float(np.linalg.norm(direction)), 1e-300))
        if null and i == len(levels) - 1:
            null_scores = _solve(columns, context.draws, len(groups), bounds)[0].max(axis=0)
    return Score(
        effect,
        max(best[0], 0.0),
        best[2],
        groups[best[1]][0],
        groups[0][1].shape[1],
        len(groups),
        bool(absorbed.all()),
        best[3],
        null_scores,
        context.shares(best[3]),
        context.fit.noise,
    )


def score_of_columns(context: ScoreContext, columns: Array) -> float:
    """Return the fall of the deviance due to columns of free strength; deviances are minimised over the levels."""
    rotated = context.rotated(columns)
    gains = []
    for level in context.levels:
        projected = level.gain[:, None] * rotated
        projected = orthogonal_to(level.basis, projected)
        score, _ = _solve(projected, level.residual, 1, (-np.inf, np.inf))
        gains.append(float(score[0]) - level.deviance)
    return max(gains) + min(x.deviance for x in context.levels)


def _solve(columns: Array, r: Array, groups: int, bounds: tuple[float, float]) -> tuple[Array, Array]:
    """Return score and strengths of each group of columns, for a residual (rows,) or many residuals (rows, draws)."""
    width = columns.shape[1] // groups
    projected = (columns.T @ r).reshape(groups, width, -1)
    if width == 1:
        gram = np.einsum("rg,rg->g", columns, columns)[:, None, None]
    else:
        c = columns.T.reshape(groups, width, -1)
        gram = c @ c.transpose(0, 2, 1)
    size = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-300))[..., None]
    scaled = gram / (size * size.transpose(0, 2, 1))
    inverse = np.linalg.pinv(scaled, rcond=1e-9, hermitian=True) if width > 1 else np.sign(scaled)
    product = np.matmul if width > 1 else np.multiply
    projected = projected / size
    gamma = product(inverse, projected)
    if bounds != (-np.inf, np.inf):
        gamma = np.clip(gamma, bounds[0] * size, bounds[1] * size)
    score = np.sum(gamma * (2 * projected - product(scaled, gamma)), axis=1)
    gamma = gamma / size
    return (score, gamma) if r.ndim > 1 else (score[:, 0], gamma[..., 0])


def _bounds(effect: Effect) -> tuple[float, float]:
    if any(p.role == "phase" for p in effect.parameters):
        return (-np.inf, np.inf)
    return (effect.amplitude.lower, effect.amplitude.upper) if effect.amplitude else (-np.inf, np.inf)


class NullDistribution:
    """Null distribution of the score of one candidate, from simulated null data, for each possible process noise.

    An error of the noise level multiplies the scores of all trials and of all candidates by the same factor. Therefore
    the number of trials is corrected at each level, and only the family-wise p-value is averaged over the levels, with
    their probabilities `weights` (levels,).
    """

    def __init__(self, score: Score) -> None:
        self._columns = score.columns
        self._scales, self.weights = possible_scales(score.noise, score.shares)
        self.draws = score.null
        middle = float(np.median(self.draws))
        tail = float(np.quantile(self.draws, 0.9))
        self._number_of_trials = max(
            number_of_trials(float(_tail(middle, score.columns)), 0.5),
            number_of_trials(float(_tail(tail, score.columns)), 0.1),
        )

    def __call__(self, score: float) -> Array:
        """Return the p-value of a score at each level (levels,)."""
        return self.of(score, self._columns)

    def of(self, score: float, columns: int) -> Array:
        """Return the p-values (levels,) of a score with `columns` strengths, for the same number of trial shapes."""
        single = np.minimum(_tail(max(score, 0.0) / self._scales, max(columns, 1)), 1 - 1e-12)
        return np.asarray(-np.expm1(self._number_of_trials * np.log1p(-single)))

    def at_one_level(self, score: float) -> float:
        """Return the p-value of a score if the process noise is known exactly."""
        single = min(float(_tail(score, max(self._columns, 1))), 1 - 1e-12)
        return float(any_of(self._number_of_trials, np.array(single)))

    def of_draws(self) -> Array:
        """Return the p-value of each null data set."""
        single = np.minimum(_tail(self.draws, self._columns), 1 - 1e-12)
        return np.asarray(-np.expm1(self._number_of_trials * np.log1p(-single)))


def _tail(chi2: float | Array, columns: int) -> Array:
    """Return the probability of a larger chi-square."""
    from scipy.special import chdtrc

    return np.asarray(chdtrc(columns, np.maximum(chi2, 0.0)))


class FamilywiseNull:
    """Family-wise p-values over the list of candidates, calibrated on the smallest p of each null data set."""

    def __init__(self, nulls: Sequence[NullDistribution]) -> None:
        self._tests = independent_tests(np.min([n.of_draws() for n in nulls], axis=0))

    def __call__(self, p: Array, weights: Array) -> float:
        """Return the family-wise p-value from the p-values at each level, averaged over the levels."""
        return float(any_of(self._tests, p) @ weights)


_ROUNDS = 3
"""Number of refinements of a shape constant [1]. Chosen: with fewer, the constant remains near the coarse grid; further
refinements change the score by less than the noise."""
_POINTS = 9
"""Number of points of a refinement of a shape constant [1]. Chosen: a smaller number may overlook the optimum, a larger
one costs time."""
_MOST_SWEPT = 4
"""Largest number of cases whose shapes are optimised in turn [1]. Chosen: a larger value costs time, a smaller one
scores joint fits with shapes that are not optimal."""


def score(
    fit: Fit,
    effects: Sequence[Effect],
    cases: Sequence[CaseColumns],
    criteria: Criteria,
    draws: int = 1500,
    context: ScoreContext | None = None,
) -> list[Score]:
    """Return the scores of candidates that are not in the base, in the order of `effects`.

    `cases` contains the columns of each case of the fit. `context` contains the linearised data; by default it is
    computed from the fit with all its effects and `draws` null data sets.
    """
    context = ScoreContext(fit, draws) if context is None else context
    tried = {e.name: _all_trials(e, cases) for e in effects}
    scores = [_score(context, effect, tried[effect.name], criteria) for effect in effects]
    promising = criteria.shape_share * max((s.score for s in scores), default=0.0)
    return [
        _shape_refined(context, s, tried[s.effect.name], cases, criteria) if s.score > promising else s
        for s in scores
    ]


def _shape_refined(
    context: ScoreContext,
    score: Score,
    tried: list[list[Trial]],
    cases: Sequence[CaseColumns],
    criteria: Criteria,
) -> Score:
    """Return the score with a shape constant between the points of its grid, if the effect has one shape constant."""
    shapes = [p.symbol for p in score.effect.parameters if p.role == "shape"]
    if len(shapes) != 1:
        return score
    symbol, per_case = shapes[0], _is_per_case(score.effect, len(cases))
    best = score
    range_ = [
        _neighbours([t.shape[symbol] for t in of_case], best.shape[i][symbol])
        for i, of_case in enumerate(tried)
    ]
    for _ in range(_ROUNDS):
        values = [np.linspace(low, high, _POINTS) for low, high in range_]
        if not per_case:
            values = [values[0]] * len(cases)
        trials = [
            c.trials(score.effect, [{symbol: float(x)} for x in v])
            for c, v in zip(cases, values, strict=True)
        ]
        found = _score(context, score.effect, trials, criteria, null=False, own_phase=score.own_phase)
        if found.score > best.score:
            best = replace(found, null=score.null, trials=score.trials)
        range_ = [_neighbours(list(v), best.shape[i][symbol]) for i, v in enumerate(values)]
    return best


def _neighbours(grid: list[float], value: float) -> tuple[float, float]:
    """Return the points of a grid below and above a value; at an end of the grid, one further step is added."""
    ordered = np.sort(np.array(grid))
    near = 1e-12 * abs(value)
    below, above = ordered[ordered < value - near], ordered[ordered > value + near]
    step = (ordered[-1] - ordered[0]) / max(len(ordered) - 1, 1)
    low = below[-1] if len(below) else max(value - step, 0.3 * value)
    return float(low), float(above[0] if len(above) else value + step)


def _is_per_case(effect: Effect, cases: int) -> bool:
    """Return whether an effect has separate parameters in each case."""
    return cases > 1 and effect.per_case


def _all_trials(effect: Effect, cases: Sequence[CaseColumns]) -> list[list[Trial]]:
    first = cases[0].trials(effect)
    # a shape constant that the cases share has the same trial values in all cases
    shapes = None if _is_per_case(effect, len(cases)) else [t.shape for t in first]
    return [first, *(c.trials(effect, shapes) for c in cases[1:])]


def _score(
    context: ScoreContext,
    effect: Effect,
    trials: list[list[Trial]],
    criteria: Criteria,
    *,
    null: bool = True,
    own_phase: bool | None = None,
) -> Score:
    """Return the score of an effect; by default cases have separate phases if that is clearly better."""
    per_case = _is_per_case(effect, len(trials))
    levels = context.levels
    if own_phase is None and has_phases(effect, len(trials)):
        gains = [
            best_group(context, effect, stacked(trials, per_case=each), levels, null=False).score
            for each in (False, True)
        ]
        own_phase = gains[1] > gains[0] + criteria.own_phase * (len(trials) - 1)
    if own_phase:
        found = best_group(context, effect, stacked(trials, per_case=True), levels, null=null)
        return replace(found, own_phase=True)
    if not per_case or len(trials[0]) == 1:
        return best_group(context, effect, stacked(trials, per_case=per_case), levels, null=null)
    chosen, null_scores = _choose_shapes(context, effect, trials, levels, null=null)
    joint = best_group(context, effect, stacked([[t] for t in chosen], per_case=True), levels, null=False)
    return replace(joint, null=null_scores, trials=sum(len(t) for t in trials))


def has_phases(effect: Effect, cases: int) -> bool:
    """Return whether there are several cases and the effect is periodic.

    Its phase may then differ between the cases.
    """
    return cases > 1 and effect.mechanical and any(p.role == "phase" for p in effect.parameters)


def _choose_shapes(
    context: ScoreContext, effect: Effect, trials: list[list[Trial]], levels: list[Level], *, null: bool
) -> tuple[list[Trial], Array]:
    """Return the best trial of each case and the null scores.

    The shape of the case with the largest score is chosen first. The shapes of the other cases follow, each with the
    chosen shapes held. Finally the shapes of all cases are chosen once more.
    """
    groups = [rows_of_case(context, t, i) for i, t in enumerate(trials)]
    singles = [best_group(context, effect, g, levels, null=null) for g in groups]
    chosen = [_trial_index(t, s) for t, s in zip(trials, singles, strict=True)]
    order = sorted(range(len(trials)), key=lambda i: -singles[i].score)
    if len(trials) <= _MOST_SWEPT:
        for i in [*order[1:], *order]:
            others = [groups[j][chosen[j]][1] for j in order if j != i]
            inner = context.with_free(np.concatenate(others, axis=1))
            chosen[i] = _trial_index(trials[i], best_group(context, effect, groups[i], inner, null=False))
    null_scores = np.sum([s.null for s in singles], axis=0)
    return [t[k] for t, k in zip(trials, chosen, strict=True)], null_scores


def _trial_index(trials: list[Trial], score: Score) -> int:
    return next(k for k, t in enumerate(trials) if t.shape == score.shape[0])


def stacked(trials: list[list[Trial]], *, per_case: bool) -> list[Group]:
    """Return, for each choice of shapes, the columns over the rows of all cases; with `per_case`, block diagonal."""
    result = []
    for i in range(max(len(t) for t in trials)):
        chosen = [t[min(i, len(t) - 1)] for t in trials]
        columns = (block_diagonal if per_case else np.concatenate)([t.columns for t in chosen])
        result.append((tuple(t.shape for t in chosen), columns))
    return result
