"""Start values of laws that a local search would miss: found by the screen, on top of a fitted model."""

from __future__ import annotations

from collections.abc import Sequence

from fitting.discovery.columns import CaseColumns
from fitting.discovery.refit import at_one_phase, refit, start_of
from fitting.discovery.scoring import Score
from fitting.discovery.screen import screen
from fitting.effects import Effect
from fitting.estimation import Fit

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
