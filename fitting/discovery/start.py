"""Start values of laws that a local search would miss: found by the screen, on top of a fitted model."""

from __future__ import annotations

from collections.abc import Sequence

from fitting.discovery.columns import CaseColumns
from fitting.discovery.refit import start_of
from fitting.discovery.screen import screen
from fitting.effects import Effect
from fitting.estimation import Fit

_DRAWS = 2


def needs_search(effect: Effect) -> bool:
    """Return whether an effect swings: beside its frequency and phase the misfit has many minima."""
    roles = {p.role for p in effect.parameters}
    return {"phase", "shape"} <= roles


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
    return {k: v for s in scores if not s.absorbed for k, v in start_of(base, s).items()}
