"""The score test: how much would each effect mend, all effects at once, before any is refitted.

With rows whitened by the noise, residuals r, Jacobian J (parameters and nuisances) and columns s of a candidate,

    M = 1 - J (J'J)^-1 J',   gamma = (s'Ms)^-1 s'Mr,   S = gamma' (s'Ms) gamma,

is the fall of chi-square that a refit would bring (C. R. Rao, Proc. Camb. Phil. Soc. 44, 50 (1948)). The level
of the random torque competes with the effect for the same residuals, so it is profiled: the score
is the fall of the deviance, minimised over the level without and with the effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CAMERA_COLUMNS
from fitting.discovery.columns import CaseColumns, Trial
from fitting.effects import Effect
from fitting.estimation import Fit
from fitting.estimation.layout import PER_CASE

Array = NDArray[np.float64]

_LEVELS = 9
_CAMERA_WIDTH = 6
_SHARPENED = 0.1
_ROUNDS = 3
_POINTS = 9
_MOST_SWEPT = 4
# share of a column that is left beside the base, angles taken as exact, below which the base mimics it
_ABSORBED = 1e-7


@dataclass(frozen=True)
class Score:
    """A candidate's best trial.

    Attributes
    ----------
    effect : Effect
        The candidate.
    score : float
        Predicted fall of the deviance.
    gamma : ndarray
        Strength of each column (sine and cosine; one per case where a case has its own).
    shape : tuple of dict
        Shape constants, for each case.
    columns : int
        Degrees of freedom of its strengths.
    trials : int
        How many choices of its shape constants were tried.
    absorbed : bool
        The base can mimic it completely.
    direction : ndarray
        Its whitened, projected column at the fitted strength, of unit length (for cosines).
    """

    effect: Effect
    score: float
    gamma: Array = field(repr=False)
    shape: tuple[dict[str, float], ...]
    columns: int
    trials: int
    absorbed: bool
    direction: Array = field(repr=False)
    null: Array = field(repr=False)


def screen(
    fit: Fit, effects: Sequence[Effect], cases: Sequence[CaseColumns], draws: int = 1500
) -> list[Score]:
    """Score all candidates on a fit.

    Parameters
    ----------
    fit : Fit
        The base.
    effects : sequence of Effect
        Candidates that are not in the base.
    cases : sequence of CaseColumns
        One for each case of the fit.
    draws : int
        How many empty data sets to draw for the null distribution.

    Returns
    -------
    list of Score
        In the order of the effects.
    """
    stage = _Stage(fit, draws)
    tried = {e.name: _trials(e, cases) for e in effects}
    scores = [_score(stage, effect, tried[effect.name]) for effect in effects]
    promising = _SHARPENED * max((s.score for s in scores), default=0.0)
    return [_sharpened(stage, s, tried[s.effect.name], cases) if s.score > promising else s for s in scores]


def _sharpened(stage: _Stage, score: Score, tried: list[list[Trial]], cases: Sequence[CaseColumns]) -> Score:
    """Search between the points of the grid for a better shape constant, for effects that have one."""
    shapes = [p.symbol for p in score.effect.parameters if p.role == "shape"]
    if len(shapes) != 1:
        return score
    symbol, own = shapes[0], _own(score.effect, len(cases))
    best = score
    reach = [
        _neighbours([t.shape[symbol] for t in trials], best.shape[i][symbol])
        for i, trials in enumerate(tried)
    ]
    for _ in range(_ROUNDS):
        values = [np.linspace(low, high, _POINTS) for low, high in reach]
        if not own:
            values = [values[0]] * len(cases)
        fresh = [
            c.trials(score.effect, [{symbol: float(x)} for x in v])
            for c, v in zip(cases, values, strict=True)
        ]
        found = _score(stage, score.effect, fresh)
        if found.score > best.score:
            best = replace(found, null=score.null, trials=score.trials)
        reach = [_neighbours(list(v), best.shape[i][symbol]) for i, v in enumerate(values)]
    return best


def _neighbours(grid: list[float], value: float) -> tuple[float, float]:
    """Return the points of a grid next to a value."""
    ordered = np.sort(np.array(grid))
    below, above = (
        ordered[ordered < value - 1e-12 * abs(value)],
        ordered[ordered > value + 1e-12 * abs(value)],
    )
    step = (ordered[-1] - ordered[0]) / max(len(ordered) - 1, 1)
    low = below[-1] if len(below) else max(value - step, 0.3 * value)
    return float(low), float(above[0] if len(above) else value + step)


def _own(effect: Effect, cases: int) -> bool:
    """Tell whether each case has its own parameters of an effect."""
    return cases > 1 and effect.name.startswith(PER_CASE)


def _trials(effect: Effect, cases: Sequence[CaseColumns]) -> list[list[Trial]]:
    first = cases[0].trials(effect)
    # what the cases share must be tried with the same shapes in all of them
    shapes = None if _own(effect, len(cases)) else [t.shape for t in first]
    return [first, *(c.trials(effect, shapes) for c in cases[1:])]


class _Stage:
    """Whitened residuals, Jacobian and empty data at several levels of the random torque."""

    def __init__(self, fit: Fit, draws: int) -> None:
        self.fit = fit
        data = fit.problem.data
        self.ends = np.cumsum([0, *(len(d.z) for d in data)])
        random = np.random.default_rng(7)
        shares = np.linspace(0, 1, _LEVELS) if any(n.level > n.pure for n in fit.noise) else np.array([1.0])
        self.whiteners = [[n.whitener.at(_between(n.pure, n.level, x)) for n in fit.noise] for x in shares]
        # a parameter on its bound is held there: what an effect would free is left to the refit
        moving = ~fit.problem.layout.at_bound(fit.theta)
        free = np.concatenate([p.jacobian[:, moving] for p in fit.predictions])
        nuisance = _block_diagonal([d.nuisance for d in data])
        residual = np.concatenate([d.z - p.rows for d, p in zip(data, fit.predictions, strict=True)])
        self.free = np.concatenate([free, nuisance], axis=1)
        self.nuisance_at = free.shape[1] + np.cumsum([0, *(d.nuisance.shape[1] for d in data)])
        self.levels = [self._level(w, self.free, residual) for w in self.whiteners]
        self.residual = residual
        self.plain = _orthonormal(self.free[:, : self.nuisance_at[0]])
        self.draws = random.standard_normal((len(residual), draws))
        base = min(value for _, _, value in self.levels)
        self.penalty = np.array([value - base for _, _, value in self.levels])

    def white(self, whiteners: Sequence[object], rows: Array) -> Array:
        """Whiten rows of all cases."""
        parts = [w(rows[a:b]) for w, a, b in zip(whiteners, self.ends, self.ends[1:], strict=False)]  # type: ignore[operator]
        return np.concatenate(parts)

    def mimicked(self, groups: Sequence[Array]) -> NDArray[np.bool_]:
        """Return which groups of columns lie within what is free."""
        everything = np.concatenate(groups, axis=1)
        left = everything - self.plain @ (self.plain.T @ everything)
        share = np.linalg.norm(left, axis=0) / np.maximum(np.linalg.norm(everything, axis=0), 1e-300)
        return np.asarray(share.reshape(len(groups), -1).max(axis=1) < _ABSORBED)

    def _level(self, whiteners: Sequence[object], free: Array, residual: Array) -> tuple[Array, Array, float]:
        q = _orthonormal(self.white(whiteners, free))
        r = self.white(whiteners, residual)
        r = r - q @ (q.T @ r)
        value = float(r @ r) + sum(w.log_determinant for w in whiteners)  # type: ignore[attr-defined]
        return q, r, value

    def beside(self, columns: Array) -> list[tuple[Array, Array, float]]:
        """Return the levels with further columns free."""
        free = np.concatenate([self.free, columns], axis=1)
        return [self._level(w, free, self.residual) for w in self.whiteners]

    def without(self, name: str) -> list[tuple[Array, Array, float]]:
        """Return the levels with a camera's nuisance taken out of what is free."""
        skip = [int(end) - _CAMERA_WIDTH + i for end in self.nuisance_at[1:] for i in CAMERA_COLUMNS[name]]
        free = np.delete(self.free, skip, axis=1)
        return [self._level(w, free, self.residual) for w in self.whiteners]


def _score(stage: _Stage, effect: Effect, trials: list[list[Trial]]) -> Score:
    own = _own(effect, len(trials))
    levels = stage.without(effect.name) if effect.name in CAMERA_COLUMNS else stage.levels
    if not own or len(trials[0]) == 1:
        groups = _stack(trials, own)
        return _search(stage, effect, groups, levels)
    chosen, null = _choose(stage, effect, trials, levels)
    together = _search(stage, effect, _stack([[t] for t in chosen], own), levels)
    return replace(together, null=null, trials=sum(len(t) for t in trials))


def _choose(
    stage: _Stage, effect: Effect, trials: list[list[Trial]], levels: list[tuple[Array, Array, float]]
) -> tuple[list[Trial], Array]:
    """Let each case choose its shapes: the clearest first, then the others beside it, then all once more."""
    groups = [_alone(stage, t, i) for i, t in enumerate(trials)]
    singles = [_search(stage, effect, g, levels) for g in groups]
    chosen = [_place(t, s) for t, s in zip(trials, singles, strict=True)]
    order = sorted(range(len(trials)), key=lambda i: -singles[i].score)
    if len(trials) <= _MOST_SWEPT:
        for i in [*order[1:], *order]:
            beside = [groups[j][chosen[j]][1] for j in order if j != i]
            inner = stage.beside(np.concatenate(beside, axis=1))
            chosen[i] = _place(trials[i], _search(stage, effect, groups[i], inner))
    null = np.sum([s.null for s in singles], axis=0)
    return [t[k] for t, k in zip(trials, chosen, strict=True)], null


def _place(trials: list[Trial], score: Score) -> int:
    return next(k for k, t in enumerate(trials) if t.shape == score.shape[0])


def _alone(stage: _Stage, trials: list[Trial], case: int) -> list[tuple[tuple[dict[str, float], ...], Array]]:
    """Return the columns of one case among the rows of all."""
    groups = []
    for t in trials:
        rows = np.zeros((stage.ends[-1], t.columns.shape[1]))
        rows[stage.ends[case] : stage.ends[case + 1]] = t.columns
        groups.append(((t.shape,), rows))
    return groups


def _search(
    stage: _Stage,
    effect: Effect,
    groups: list[tuple[tuple[dict[str, float], ...], Array]],
    levels: list[tuple[Array, Array, float]],
) -> Score:
    """Return the best of some groups of columns over all levels of the random torque."""
    bounds = _bounds(effect)
    best: tuple[float, int, Array, Array] = (-np.inf, 0, np.zeros(1), np.zeros(1))
    absorbed = stage.mimicked([c for _, c in groups])
    for i, (q, r, value) in enumerate(levels):
        columns = stage.white(stage.whiteners[i], np.concatenate([c for _, c in groups], axis=1))
        columns = columns - q @ (q.T @ columns)
        scores, gammas = _solve(columns, r, len(groups), bounds)
        scores = np.where(absorbed, 0.0, scores)
        place = int(np.argmax(scores))
        gain = float(scores[place]) - (value - min(v for _, _, v in levels))
        if gain > best[0]:
            width = columns.shape[1] // len(groups)
            direction = columns[:, place * width : (place + 1) * width] @ gammas[place]
            best = (gain, place, gammas[place], direction / max(float(np.linalg.norm(direction)), 1e-300))
        if i == len(levels) - 1:
            null, _ = _solve(columns, stage.draws, len(groups), bounds)
    return Score(
        effect,
        max(best[0], 0.0),
        best[2],
        groups[best[1]][0],
        groups[0][1].shape[1],
        len(groups),
        bool(absorbed.all()),
        best[3],
        np.asarray(null.max(axis=0)),
    )


def _stack(trials: list[list[Trial]], own: bool) -> list[tuple[tuple[dict[str, float], ...], Array]]:  # noqa: FBT001
    """Return for each choice of shapes the columns over the rows of all cases."""
    result = []
    for i in range(max(len(t) for t in trials)):
        chosen = [t[min(i, len(t) - 1)] for t in trials]
        columns = (
            _block_diagonal([t.columns for t in chosen])
            if own
            else np.concatenate([t.columns for t in chosen])
        )
        result.append((tuple(t.shape for t in chosen), columns))
    return result


def _solve(columns: Array, r: Array, groups: int, bounds: tuple[float, float]) -> tuple[Array, Array]:
    """Return score and strengths of each group of columns, for one residual or many."""
    width = columns.shape[1] // groups
    c = columns.reshape(len(columns), groups, width)
    seen = np.einsum("rgw,r...->gw...", c, r) if r.ndim == 1 else (columns.T @ r).reshape(groups, width, -1)
    gram = np.einsum("rgw,rgv->gwv", c, c)
    size = np.sqrt(np.maximum(np.einsum("gww->gw", gram), 1e-300))
    scaled = gram / (size[:, :, None] * size[:, None, :])
    inverse = np.linalg.pinv(scaled, rcond=1e-9, hermitian=True)
    seen = seen / size.reshape(size.shape + (1,) * (seen.ndim - 2))
    gamma = np.einsum("gwv,gv...->gw...", inverse, seen)
    if bounds != (-np.inf, np.inf):
        edge = size.reshape(size.shape + (1,) * (seen.ndim - 2))
        gamma = np.clip(gamma, bounds[0] * edge, bounds[1] * edge)
    score = np.einsum("gw...,gw...->g...", gamma, 2 * seen - np.einsum("gwv,gv...->gw...", scaled, gamma))
    return np.asarray(score), np.asarray(gamma / size.reshape(size.shape + (1,) * (gamma.ndim - 2)))


def _bounds(effect: Effect) -> tuple[float, float]:
    if any(p.role == "phase" for p in effect.parameters):
        return (-np.inf, np.inf)
    return (effect.amplitude.lower, effect.amplitude.upper) if effect.amplitude else (-np.inf, np.inf)


def _between(pure: float, level: float, share: float) -> float:
    if level <= pure:
        return pure
    floor = max(pure, 1e-3 * level)
    return floor * (level / floor) ** share


def _orthonormal(columns: Array) -> Array:
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return np.asarray(u[:, s > 1e-10 * s[0]])


def _block_diagonal(parts: Sequence[Array]) -> Array:
    rows, columns = sum(len(p) for p in parts), sum(p.shape[1] for p in parts)
    out = np.zeros((rows, columns))
    i = j = 0
    for p in parts:
        out[i : i + len(p), j : j + p.shape[1]] = p
        i, j = i + len(p), j + p.shape[1]
    return out
