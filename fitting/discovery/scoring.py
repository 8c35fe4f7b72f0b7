"""The score test: how much would each effect mend, all effects at once, before any is refitted.

With rows whitened by the noise, residuals r, Jacobian J (parameters and nuisances) and columns s of a candidate,

    M = 1 - J (J'J)^-1 J',   gamma = (s'Ms)^-1 s'Mr,   S = gamma' (s'Ms) gamma,

is the fall of chi-square that a refit would bring (C. R. Rao, Proc. Camb. Phil. Soc. 44, 50 (1948)). The level
of the random torque competes with the effect for the same residuals, so it is profiled: the score
is the fall of the deviance, minimised over the level without and with the effect.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitting.discovery.columns import Trial
from fitting.discovery.stage import Level, Stage
from fitting.effects import Effect

Array = NDArray[np.float64]
# shape constants, one set a case, and the columns over the rows of all cases
Group = tuple[tuple[dict[str, float], ...], Array]


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
    apart : bool
        Each case has a strength and a phase of its own, though not a shape.
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
    apart: bool = False


def search_alone(stage: Stage, effect: Effect, trials: list[Trial], case: int) -> Score:
    """Return the best trial of an effect in one case, beside all that is free in every case."""
    return search_groups(stage, effect, alone(stage, trials, case), stage.levels)


def alone(stage: Stage, trials: list[Trial], case: int) -> list[Group]:
    """Return the columns of one case among the rows of all."""
    groups: list[Group] = []
    for t in trials:
        rows = np.zeros((stage.ends[-1], t.columns.shape[1]))
        rows[stage.ends[case] : stage.ends[case + 1]] = t.columns
        groups.append(((t.shape,), rows))
    return groups


def search_groups(
    stage: Stage,
    effect: Effect,
    groups: list[Group],
    levels: list[Level],
    *,
    null: bool = True,
) -> Score:
    """Return the best of some groups of columns over all levels of the random torque; `null` scores empty data too."""
    bounds = _bounds(effect)
    best: tuple[float, int, Array, Array] = (-np.inf, 0, np.zeros(1), np.zeros(1))
    absorbed = stage.mimicked([c for _, c in groups])
    turned = stage.turned(np.concatenate([c for _, c in groups], axis=1))
    empty = np.zeros(0)
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
        if null and i == len(levels) - 1:
            empty = _solve(columns, stage.draws, len(groups), bounds)[0].max(axis=0)
    return Score(
        effect,
        max(best[0], 0.0),
        best[2],
        groups[best[1]][0],
        groups[0][1].shape[1],
        len(groups),
        bool(absorbed.all()),
        best[3],
        empty,
    )


def free_score(stage: Stage, columns: Array) -> float:
    """Return the fall of the deviance by columns of any strengths over all levels of the random torque."""
    turned = stage.turned(columns)
    gains = []
    for level in stage.levels:
        seen = level.gain[:, None] * turned
        seen = seen - level.basis @ (level.basis.T @ seen)
        score, _ = _solve(seen, level.residual, 1, (-np.inf, np.inf))
        gains.append(float(score[0]) - level.deviance)
    return max(gains) + min(x.deviance for x in stage.levels)


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
