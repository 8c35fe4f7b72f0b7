"""Adding effects until nothing more is justified, then taking back what is not needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fitting.beside import Beside
from fitting.discovery.polish import polished
from fitting.discovery.ranking import ALWAYS_FREE, Candidate, rank
from fitting.effects import Effect
from fitting.estimation import Fit, fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MAX_STEPS = 5
# an effect whose strength is nearer to zero than this many standard errors is taken back
_NEEDED = 3.3
# with so many added, each is tried without: several wrong ones can stand in for a right one that comes last
_CROWDED = 3
# BIC must fall by this much: "positive" evidence after R. Kass, A. Raftery, J. Am. Stat. Assoc. 90, 773 (1995)
_EVIDENCE = 2.0
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
        from fitting.display.plots import plot_ladder

        return plot_ladder(self)

    def _repr_html_(self) -> str:
        from fitting.display.html import ladder_html

        return ladder_html(self)


def improve(
    base: Fit,
    extra: Sequence[Effect] = (),
    *,
    max_steps: int = _MAX_STEPS,
    progress: Callable[[int, int | None], None] | None = None,
    first: Sequence[Candidate] | None = None,
    beside: Beside | None = None,
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
    beside : Beside, optional
        A second process that takes its share of the work.

    Returns
    -------
    Ladder
        A list of rungs, the base first, the final model last.
    """
    known = first if first is not None else rank(base, extra, beside=beside)
    rungs = Ladder([Rung("", base, tuple(known))])
    for step in range(max_steps):
        chosen = best(rungs[-1].candidates)
        if chosen is None or chosen.fit is None:
            break
        rungs.append(Rung(f"+{chosen.effect.name}", polished(chosen.fit), ()))
        rungs[-1] = _backward(rungs)
        rungs[-1] = Rung(rungs[-1].change, rungs[-1].fit, tuple(rank(rungs[-1].fit, extra, beside=beside)))
        if progress is not None:
            progress(step + 1, None)
    return rungs


def best(candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate to add next: significant, refitted, better in BIC; None if there is none."""
    for c in candidates:
        if c.effect.name in ALWAYS_FREE:
            continue
        tracked = c.fit is not None and any(d.record.tracked for d in c.fit.problem.data)
        needed = _EVIDENCE_SWING if tracked and c.physical and c.effect.swings else _EVIDENCE
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
