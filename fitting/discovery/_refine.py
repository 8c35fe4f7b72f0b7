"""Refits of candidate effects on top of the base model.

About a refit, the time is moved step by step through its neighbourhood, all else following linearly,

    cost(t0) = | M (z - rows(t0)) |^2,   M = 1 - J (J'J)^-1 J',

and the best place is a start for another refit. A case that stays loud beside the others has its time far off: the
first search took place while the parameters that all cases share were bent by what was missing in each. Once the
other cases have pinned them, its whole record is searched again by the score test.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting._errors import FittingError, SimulationError
from fitting.discovery._score import CaseColumns, Score, Stage, search_alone
from fitting.effects._effect import Effect
from fitting.inference._fit import fit
from fitting.inference._lack_of_fit import orthonormal
from fitting.inference._noise import Noise
from fitting.inference._result import Fit

# BIC must fall by this much: "positive" evidence after R. Kass, A. Raftery, J. Am. Stat. Assoc. 90, 773 (1995)
_EVIDENCE = 2.0


def excused(found: Fit) -> bool:
    """Return whether a fit leaves more than the noise of the data, which counts as noise in it."""
    return any(n.level > n.pure for n in found.noise)


def sharpest(found: Fit) -> Fit:
    """Return a fit, or the one from a search with no more noise than the data has if that describes the data better.

    Where the noise that a model is excused with hides what is wrong about a shape, nothing moves it.
    """
    if not excused(found):
        return found
    pure = [replace(n, level=n.pure, whitener=n.whitener.at(n.pure)) for n in found.noise]
    # without an excuse a search may run away to where nothing can be integrated
    with suppress(FittingError):
        sharp = again(found, pure)
        return sharp if sharp.deviance < found.deviance - _EVIDENCE else found
    return found


def again(found: Fit, noise: Sequence[Noise]) -> Fit:
    """Return a fit made again from its own values at a given noise, to the end."""
    layout = found.problem.layout
    return fit(
        found.model,
        found.problem.data,
        share=[k for k in found.model.free if k not in layout.per_case] if len(layout.records) > 1 else (),
        per_case=layout.per_case,
        start={k: e.value for k, e in found.estimates.items()},
        noise=noise,
    )


Array = NDArray[np.float64]

_REACH = 0.04
_STEPS = 48
_RANK = 1e-7
# a score that empty data would hardly ever show
_CLEAR = 25.0


def distant_breaks(fit: Fit, effect: Effect) -> dict[str, float]:
    """Return the parameters of a fit with the effect set in anew in the cases in which the fit leaves a torque.

    Parameters
    ----------
    fit : Fit
        A fit with the effect.
    effect : Effect
        One that has a breakpoint.

    Returns
    -------
    dict
        Values by name; empty if nothing speaks for another time.
    """
    layout = fit.problem.layout
    strength = next(p.symbol for p in effect.parameters if p.role == "amplitude")
    keys = [f"{effect.name}.{effect.breakpoint}", f"{effect.name}.{strength}"]
    loud = [i for i, n in enumerate(fit.noise) if n.level > n.pure]
    if not loud:
        return {}
    theta, stage = fit.theta.copy(), Stage(fit, 1)
    for index in loud:
        found = search_alone(stage, effect, CaseColumns(fit, index).trials(effect), index)
        if found.score > _CLEAR:
            places = [int(layout.places(index, [k])[0]) for k in keys]
            theta[places] = found.shape[0][effect.breakpoint], found.gamma[0]
    return _moved(fit, theta)


def better_breaks(fit: Fit, effect: Effect) -> dict[str, float]:
    """Return the parameters of a fit with the times at which an effect sets in at their best places.

    Parameters
    ----------
    fit : Fit
        A fit with the effect.
    effect : Effect
        One that has a breakpoint.

    Returns
    -------
    dict
        Values by name; empty if they stand well.
    """
    layout, key = fit.problem.layout, f"{effect.name}.{effect.breakpoint}"
    theta = fit.theta.copy()
    for index in range(len(fit.problem.cases)):
        (place,) = layout.places(index, [key])
        theta[place] = _best(fit, index, int(place))
    return _moved(fit, theta)


def _moved(fit: Fit, theta: Array) -> dict[str, float]:
    """Return variables by name; nothing if they are those of the fit."""
    if np.array_equal(theta, fit.theta):
        return {}
    return dict(zip(fit.problem.layout.names, theta.tolist(), strict=True))


def _best(fit: Fit, index: int, place: int) -> float:
    case, project = fit.problem.cases[index], fit.problem.projections[index]
    first, last = case.data.record.span
    now = float(fit.theta[place])
    basis = orthonormal(project(np.delete(fit.predictions[index].jacobian, place, axis=1)), _RANK)

    def cost(t: float) -> float:
        theta = fit.theta.copy()
        theta[place] = t
        try:
            left = project(case.data.z - case.predict(theta).rows)
        except SimulationError:
            return np.inf
        left = left - basis @ (basis.T @ left)
        return float(left @ left)

    reach = _REACH * (last - first)
    times = np.linspace(max(first, now - reach), min(last, now + reach), _STEPS)
    costs = [cost(float(t)) for t in times]
    best = int(np.argmin(costs))
    return float(times[best]) if costs[best] < cost(now) else now


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
    shared = [k for k in base.model.per_case if k not in own]
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
    own = len(labels) > 1 and (score.apart or effect.per_case)
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
