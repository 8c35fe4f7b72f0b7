"""Screening: every candidate at its best shape constants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting.discovery._score import CaseColumns, Group, Level, Score, Stage, Trial, alone, search_groups
from fitting.effects._effect import Effect
from fitting.inference._lack_of_fit import block_diagonal
from fitting.inference._result import Fit

Array = NDArray[np.float64]

_SHARPENED = 0.1
_ROUNDS = 3
_POINTS = 9
_MOST_SWEPT = 4
# by so much more of the deviance must strength and phase of its own explain for each further case
_APART = 10.0


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
        found = _score(stage, score.effect, fresh, null=False, apart=score.apart)
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
    return cases > 1 and effect.per_case


def _trials(effect: Effect, cases: Sequence[CaseColumns]) -> list[list[Trial]]:
    first = cases[0].trials(effect)
    # what the cases share must be tried with the same shapes in all of them
    shapes = None if _own(effect, len(cases)) else [t.shape for t in first]
    return [first, *(c.trials(effect, shapes) for c in cases[1:])]


def _score(
    stage: Stage,
    effect: Effect,
    trials: list[list[Trial]],
    *,
    null: bool = True,
    apart: bool | None = None,
) -> Score:
    """Score an effect; without a word on `apart`, cases have phases of their own where that is clearly better."""
    own = _own(effect, len(trials))
    levels = stage.without(effect.name) if effect.nuisance else stage.levels
    if apart is None and has_phases(effect, len(trials)):
        gains = [
            search_groups(stage, effect, _stack(trials, each), levels, null=False).score
            for each in (False, True)
        ]
        apart = gains[1] > gains[0] + _APART * (len(trials) - 1)
    if apart:
        return replace(search_groups(stage, effect, _stack(trials, own=True), levels, null=null), apart=True)
    if not own or len(trials[0]) == 1:
        return search_groups(stage, effect, _stack(trials, own), levels, null=null)
    chosen, empty = _choose(stage, effect, trials, levels, null=null)
    together = search_groups(stage, effect, _stack([[t] for t in chosen], own), levels, null=False)
    return replace(together, null=empty, trials=sum(len(t) for t in trials))


def has_phases(effect: Effect, cases: int) -> bool:
    """Tell whether an effect swings, so that it may begin at another phase in each of several cases."""
    return cases > 1 and effect.mechanical and any(p.role == "phase" for p in effect.parameters)


def _choose(
    stage: Stage, effect: Effect, trials: list[list[Trial]], levels: list[Level], *, null: bool
) -> tuple[list[Trial], Array]:
    """Let each case choose its shapes: the clearest first, then the others beside it, then all once more."""
    groups = [alone(stage, t, i) for i, t in enumerate(trials)]
    singles = [search_groups(stage, effect, g, levels, null=null) for g in groups]
    chosen = [_place(t, s) for t, s in zip(trials, singles, strict=True)]
    order = sorted(range(len(trials)), key=lambda i: -singles[i].score)
    if len(trials) <= _MOST_SWEPT:
        for i in [*order[1:], *order]:
            beside = [groups[j][chosen[j]][1] for j in order if j != i]
            inner = stage.beside(np.concatenate(beside, axis=1))
            chosen[i] = _place(trials[i], search_groups(stage, effect, groups[i], inner, null=False))
    empty = np.sum([s.null for s in singles], axis=0)
    return [t[k] for t, k in zip(trials, chosen, strict=True)], empty


def _place(trials: list[Trial], score: Score) -> int:
    return next(k for k, t in enumerate(trials) if t.shape == score.shape[0])


def _stack(trials: list[list[Trial]], own: bool) -> list[Group]:  # noqa: FBT001
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
