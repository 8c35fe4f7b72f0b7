"""Adding effects while they are justified; backward elimination.

What fluctuates fast and was missing before may have been taken for noise: it hid whatever is smaller, and made
candidates look alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fitting._errors import FittingError
from fitting._workers import WorkerPool, single_blas_thread
from fitting.discovery._rank import Candidate, arranged, rank
from fitting.discovery._refine import again, at_one_phase, refit, sharpest, start_of
from fitting.discovery._score import CaseColumns, Score
from fitting.discovery._screen import screen
from fitting.effects._effect import Effect
from fitting.inference._fit import fit
from fitting.inference._noise import Noise
from fitting.inference._noise_level import measure_noise
from fitting.inference._result import Fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# noise that falls by less when an effect is added is the same noise, measured twice
_QUIETER = 0.8
# BIC must fall by this much: "positive" evidence after R. Kass, A. Raftery, J. Am. Stat. Assoc. 90, 773 (1995)
_EVIDENCE = 2.0


def polished(found: Fit) -> Fit:
    """Return a fit that was made quickly, at its minimum, with the noise that its own model leaves."""
    end = sharpest(again(found, found.noise))
    noise = measure_noise(end.problem, end.theta)
    if all(new.pure >= _QUIETER * old.pure for new, old in zip(noise, end.noise, strict=True)):
        return end
    quieter = sharpest(again(end, noise))
    return quieter if quieter.bic < end.bic - _EVIDENCE else end


def is_quieter(fit: Fit, than: Fit) -> bool:
    """Return whether there is less noise than in another fit: what no torque explains, or what the model leaves."""
    return any(
        n.pure < old.pure or n.level < _QUIETER * old.level
        for n, old in zip(fit.noise, than.noise, strict=True)
    )


def reconsidered(
    base: Fit, candidates: Sequence[Candidate], chosen: Candidate, noise: Sequence[Noise]
) -> list[Candidate]:
    """Return the candidates in their order and classes, one and its look-alikes refitted at another noise.

    Parameters
    ----------
    base : Fit
        The fit without them.
    candidates : sequence of Candidate
        As they were ranked at the noise of the base.
    chosen : Candidate
        One of them.
    noise : sequence of Noise
        What it leaves.
    """
    try:
        plain = again(base, noise)
    except FittingError:
        return list(candidates)
    alike = {chosen.effect.name, *chosen.indistinguishable_from}
    return arranged([_refitted(c, plain, noise) if c.effect.name in alike else c for c in candidates])


def _refitted(c: Candidate, base: Fit, noise: Sequence[Noise]) -> Candidate:
    """Return a candidate with its refit at another noise; without one if the search runs away there."""
    if c.fit is None:
        return c
    try:
        end = again(c.fit, noise)
    except FittingError:
        return replace(c, delta_bic=float("nan"), fit=None)
    own = {k: e for k, e in end.estimates.items() if k.startswith(c.effect.name + ".")}
    return replace(
        c, score=base.deviance - end.deviance, delta_bic=end.bic - base.bic, estimates=own, fit=end
    )


_MAX_STEPS = 5
# an effect whose strength is nearer to zero than this many standard errors is taken back
_NEEDED = 3.3
# with so many added, each is tried without: several wrong ones can stand in for a right one that comes last
_CROWDED = 3
# BIC must fall by this much: "positive" evidence after R. Kass, A. Raftery, J. Am. Stat. Assoc. 90, 773 (1995)
# tracking errs in step with the turns of casing and rotor and with their beats: physics that swings needs "very strong"
# evidence there
_EVIDENCE_SWING = 10.0


@dataclass(frozen=True)
class Rung:
    """One step of a ladder: what was added or dropped, and the fit."""

    change: str
    fit: Fit
    candidates: tuple[Candidate, ...]


class Ladder(list[Rung]):
    """The rungs of `improve`, the base first; a notebook shows them as a table."""

    def plot(self) -> Figure:
        """Draw how the error falls from rung to rung (matplotlib)."""
        from fitting._display import plot_history

        return plot_history(self)

    def _repr_html_(self) -> str:
        from fitting._display import history_html

        return history_html(self)


@single_blas_thread()
def improve(
    base: Fit,
    extra: Sequence[Effect] = (),
    *,
    max_steps: int = _MAX_STEPS,
    progress: Callable[[int, int | None], None] | None = None,
    first: Sequence[Candidate] | None = None,
    workers: WorkerPool | None = None,
) -> Ladder:
    """Go on adding the best effect while one is significant, then drop what is not needed.

    Parameters
    ----------
    base : Fit
        Where to begin.
    extra : sequence of Effect
        Effects of the user beside the library.
    max_steps : int
        At most so many effects are added.
    progress : callable, optional
        Called with (steps done, None).
    first : sequence of Candidate, optional
        The ranking of the base, if it is known already.
    workers : WorkerPool, optional
        A second process that takes its share of the work.

    Returns
    -------
    Ladder
        A list of rungs, the base first, the final model last.
    """
    known = first if first is not None else rank(base, extra, workers=workers)
    rungs = Ladder([Rung("", base, tuple(known))])
    for step in range(max_steps):
        chosen = best(rungs[-1].candidates)
        if chosen is None or chosen.fit is None:
            break
        rungs.append(Rung(f"+{chosen.effect.name}", polished(chosen.fit), ()))
        rungs[-1] = _backward(rungs)
        rungs[-1] = Rung(rungs[-1].change, rungs[-1].fit, tuple(rank(rungs[-1].fit, extra, workers=workers)))
        if progress is not None:
            progress(step + 1, None)
    return rungs


def best(candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate to add next: significant, refitted, better in BIC; None if there is none."""
    for c in candidates:
        if c.effect.nuisance:
            continue
        tracked = c.fit is not None and any(d.record.tracked for d in c.fit.problem.data)
        needed = _EVIDENCE_SWING if tracked and c.physical and c.effect.periodic else _EVIDENCE
        if c.significant and c.fit is not None and c.delta_bic < -needed:
            return c
    return None


def _backward(rungs: list[Rung]) -> Rung:
    """Drop effects added before that the newest makes unnecessary."""
    newest = rungs[-1]
    change, current = newest.change, newest.fit
    base_names = set(rungs[0].fit.model.names)
    while True:
        added = [e for e in current.model.effects if e.name not in base_names and e.amplitude is not None]
        crowded = len(added) >= _CROWDED
        spare = [e for e in added if newest.change != f"+{e.name}" and (crowded or not _stands(current, e))]
        tried = ((e, _without(current, e)) for e in spare)
        gone = next(((e, found) for e, found in tried if found.bic < current.bic), None)
        if gone is None:
            return newest if current is newest.fit else Rung(change, current, ())
        change, current = f"{change} -{gone[0].name}", gone[1]


def _stands(fitted: Fit, effect: Effect) -> bool:
    """Return whether the strength of an effect is far from zero in some case."""
    key = f"{effect.name}.{effect.amplitude.symbol}" if effect.amplitude else ""
    found = [e for k, e in fitted.estimates.items() if k.partition("@")[0] == key]
    return any(not np.isfinite(e.stderr) or abs(e.value) > _NEEDED * e.stderr for e in found)


def _without(fitted: Fit, effect: Effect) -> Fit:
    smaller = fitted.model.without(effect.name)
    share, per_case = ([k for k in names if k in smaller.free] for names in fitted.problem.layout.choices)
    return fit(
        smaller,
        fitted.problem.data,
        share=share,
        per_case=per_case,
        start={k: e.value for k, e in fitted.estimates.items()},
        noise=fitted.noise,
    )


_DRAWS = 2


def needs_search(effect: Effect) -> bool:
    """Return whether the misfit has many minima: an effect that swings at a rate, or sets in at a time, of its own."""
    roles = {p.role for p in effect.parameters}
    return {"phase", "shape"} <= roles or bool(effect.breakpoint)


def found_starts(base: Fit, effects: Sequence[Effect]) -> dict[str, float]:
    """Return where to start the parameters of effects that are added to a fitted model.

    Parameters
    ----------
    base : Fit
        The model without them, fitted.
    effects : sequence of Effect
        What is added.

    Returns
    -------
    dict of str to float
        Values by the names that the parameters have in a fit; nothing for an effect whose responses vanish.
    """
    cases = [CaseColumns(base, i) for i in range(len(base.problem.cases))]
    scores = screen(base, effects, cases, draws=_DRAWS)
    return {k: v for s in scores if not s.absorbed for k, v in _start(base, s).items()}


def _start(base: Fit, score: Score) -> dict[str, float]:
    if score.apart:
        # whether strength and phase are common to all cases is not said yet
        return start_of(base, at_one_phase(score)) | start_of(base, score)
    found = refit(base, score) if score.effect.breakpoint else None
    if found is None:
        return start_of(base, score)
    prefix = f"{score.effect.name}."
    return {name: e.value for name, e in found.estimates.items() if name.startswith(prefix)}
