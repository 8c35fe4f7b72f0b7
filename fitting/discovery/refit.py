"""Refits of a candidate on top of the base, both moving together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fitting.discovery.breaks import better_breaks, distant_breaks
from fitting.discovery.scoring import Score
from fitting.discovery.sharpening import excused, sharpest
from fitting.effects import Effect
from fitting.errors import FittingError
from fitting.estimation import Fit, fit
from fitting.estimation.layout import PER_CASE

# a refit that lowers the deviance by so much less than promised has lost its way: rivals nearer than this are alike
_SHORT = 10.0


def refit(base: Fit, score: Score, *, thorough: bool = True) -> Fit | None:
    """Return the fit of base and candidate from the base's optimum; None if there is none.

    A `thorough` one tries other ways where it falls short of what the screen promised.
    """
    found = together(base, score)
    if thorough and found is not None:
        found = _as_promised(base, score, found)
    if not score.effect.breakpoint:
        return found
    for look in (distant_breaks, better_breaks):
        elsewhere = look(found, score.effect) if found is not None else {}
        other = together(base, score, elsewhere) if elsewhere else None
        found = (
            other if other is not None and found is not None and other.deviance < found.deviance else found
        )
    return found


def _as_promised(base: Fit, score: Score, found: Fit) -> Fit:
    """Return a refit, or if it falls short of what the screen promised the best of several ways to one.

    A base that misses much excuses it with a random torque, and at that noise the search may throw away a strength,
    or stay beside a shape, that would explain what is missed.
    """

    def short(reached: Fit) -> bool:
        return base.deviance - reached.deviance < score.score - _SHORT

    if not excused(base) or not short(found):
        return found
    other = together(base, score, held=True)
    if other is not None and other.deviance < found.deviance:
        found = other
    return sharpest(found) if short(found) else found


def together(
    base: Fit,
    score: Score,
    start: Mapping[str, float] | None = None,
    common: Sequence[str] = (),
    *,
    held: bool = False,
) -> Fit | None:
    """Return the fit of base and candidate, with some parameters common to all cases; None if there is none.

    `held` keeps the strength, too, where the screen saw it until all else has followed.
    """
    layout = base.problem.layout
    own = [k for k in layout.per_case if k in base.model.free]
    shared = [k for k in base.model.free if k.startswith(PER_CASE) and k not in own]
    begin = {name: e.value for name, e in base.estimates.items()} | start_of(base, score)
    try:
        found = fit(
            base.model.with_effect(score.effect),
            base.problem.data,
            share=[*shared, *common] if len(layout.records) > 1 else (),
            per_case=[*own, *_apart(score)] if len(layout.records) > 1 else (),
            start=begin if start is None else begin | dict(start),
            noise=base.noise,
            steady=[n for n in begin if _keeps(score.effect, n, held=held)] if start is None else (),
            quick=True,
        )
    except FittingError:
        return None
    return found if np.isfinite(found.deviance) else None


def _apart(score: Score) -> list[str]:
    """Return the parameters of which each case has its own though the effect is common to all."""
    roles = {"amplitude", "phase"} if score.apart else set()
    return [f"{score.effect.name}.{p.symbol}" for p in score.effect.parameters if p.role in roles]


def at_one_phase(score: Score) -> Score:
    """Return a score as a start where all cases have the same strength and phase."""
    gamma = score.gamma.reshape(-1, 2).mean(axis=0)
    return replace(score, gamma=gamma, columns=2, apart=False)


def _keeps(effect: Effect, name: str, *, held: bool) -> bool:
    own = [p for p in effect.parameters if held or p.role == "shape"]
    return name.partition("@")[0] in {f"{effect.name}.{p.symbol}" for p in own}


def with_one_value(base: Fit, score: Score, found: Fit) -> Fit | None:
    """Return the fit in which all cases have the same value of what may differ from case to case.

    Surfaces that happen to agree need one number and not one each: a law must not lose against a rival
    because its parameters are free to differ.
    """
    prefix = score.effect.name + "."
    keys = [k for k in found.problem.layout.per_case if k.startswith(prefix)]
    if not keys:
        return None
    mean = {
        k: float(np.mean([e.value for name, e in found.estimates.items() if name.partition("@")[0] == k]))
        for k in keys
    }
    return together(base, score, {n: e.value for n, e in found.estimates.items()} | mean, keys)


def with_own_values(base: Fit, score: Score, found: Fit, common: Fit) -> Fit:
    """Return the fit in which each case has its own values, begun where all have the same; the better of two."""
    values = {name: e.value for name, e in common.estimates.items()}
    start = {n: values.get(n, values.get(n.partition("@")[0])) for n in found.problem.layout.names}
    again = together(base, score, {n: v for n, v in start.items() if v is not None})
    return again if again is not None and again.deviance < found.deviance else found


def start_of(base: Fit, score: Score) -> dict[str, float]:
    """Return start values of a candidate's parameters from its score."""
    effect, labels = score.effect, [r.label for r in base.problem.layout.records]
    own = len(labels) > 1 and (score.apart or effect.name.startswith(PER_CASE))
    phase = next((p.symbol for p in effect.parameters if p.role == "phase"), None)
    amplitude = next(p.symbol for p in effect.parameters if p.role == "amplitude")
    gamma = score.gamma.reshape(len(labels) if own else 1, -1)
    values: dict[str, float] = {}
    for i, label in enumerate(labels if own else [""]):
        tail = f"@{label}" if own else ""
        found: Mapping[str, float] = score.shape[i]
        if phase is not None:
            found = {
                **found,
                amplitude: float(np.hypot(*gamma[i])),
                phase: float(np.arctan2(gamma[i][1], gamma[i][0])),
            }
        else:
            found = {**found, amplitude: float(gamma[i][0])}
        common = score.shape[i] if score.apart else {}
        values |= {f"{effect.name}.{k}{'' if k in common else tail}": float(v) for k, v in found.items()}
    return values
