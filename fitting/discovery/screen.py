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
from fitting.discovery.stage import Level, Stage
from fitting.effects import Effect
from fitting.estimation import Fit
from fitting.estimation.lack import block_diagonal
from fitting.estimation.layout import PER_CASE

Array = NDArray[np.float64]

_SHARPENED = 0.1
_ROUNDS = 3
_POINTS = 9
_MOST_SWEPT = 4


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
    stage = Stage(fit, draws)
    tried = {e.name: _trials(e, cases) for e in effects}
    scores = [_score(stage, effect, tried[effect.name]) for effect in effects]
    promising = _SHARPENED * max((s.score for s in scores), default=0.0)
    return [_sharpened(stage, s, tried[s.effect.name], cases) if s.score > promising else s for s in scores]


def _sharpened(stage: Stage, score: Score, tried: list[list[Trial]], cases: Sequence[CaseColumns]) -> Score:
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


def _score(stage: Stage, effect: Effect, trials: list[list[Trial]]) -> Score:
    own = _own(effect, len(trials))
    levels = stage.without(effect.name) if effect.name in CAMERA_COLUMNS else stage.levels
    if not own or len(trials[0]) == 1:
        groups = _stack(trials, own)
        return _search(stage, effect, groups, levels)
    chosen, null = _choose(stage, effect, trials, levels)
    together = _search(stage, effect, _stack([[t] for t in chosen], own), levels)
    return replace(together, null=null, trials=sum(len(t) for t in trials))


def _choose(
    stage: Stage, effect: Effect, trials: list[list[Trial]], levels: list[Level]
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


def search_alone(stage: Stage, effect: Effect, trials: list[Trial], case: int) -> Score:
    """Return the best trial of an effect in one case, beside all that is free in every case."""
    return _search(stage, effect, _alone(stage, trials, case), stage.levels)


def _place(trials: list[Trial], score: Score) -> int:
    return next(k for k, t in enumerate(trials) if t.shape == score.shape[0])


def _alone(stage: Stage, trials: list[Trial], case: int) -> list[tuple[tuple[dict[str, float], ...], Array]]:
    """Return the columns of one case among the rows of all."""
    groups: list[tuple[tuple[dict[str, float], ...], Array]] = []
    for t in trials:
        rows = np.zeros((stage.ends[-1], t.columns.shape[1]))
        rows[stage.ends[case] : stage.ends[case + 1]] = t.columns
        groups.append(((t.shape,), rows))
    return groups


def _search(
    stage: Stage,
    effect: Effect,
    groups: list[tuple[tuple[dict[str, float], ...], Array]],
    levels: list[Level],
) -> Score:
    """Return the best of some groups of columns over all levels of the random torque."""
    bounds = _bounds(effect)
    best: tuple[float, int, Array, Array] = (-np.inf, 0, np.zeros(1), np.zeros(1))
    absorbed = stage.mimicked([c for _, c in groups])
    turned = stage.turned(np.concatenate([c for _, c in groups], axis=1))
    for i, level in enumerate(levels):
        columns = level.gain[:, None] * turned
        columns = columns - level.basis @ (level.basis.T @ columns)
        scores, gammas = _solve(columns, level.residual, len(groups), bounds)
        scores = np.where(absorbed, 0.0, scores)
        place = int(np.argmax(scores))
        gain = float(scores[place]) - (level.deviance - min(x.deviance for x in levels))
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
            block_diagonal([t.columns for t in chosen])
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
