"""From scores to a ranking: error control, refits, equivalence classes.

Candidates overlap, and some try many shapes, so p-values come from empty data sets put through the very same
search: for each candidate the number of independent trials that its largest score in empty data amounts
to, and for the whole list the number of independent candidates. The promising ones are refitted
from the base's optimum with base and effect moving together, and ranked by their deviance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting._workers import WorkerPool
from fitting.discovery._refine import at_one_phase, refit, with_one_value, with_own_values
from fitting.discovery._score import CaseColumns, Chance, Family, Score
from fitting.discovery._screen import screen
from fitting.effects._effect import Effect
from fitting.effects._library import LIBRARY
from fitting.inference._case_data import CaseData
from fitting.inference._result import Estimate, Fit

Array = NDArray[np.float64]

# family-wise probability of naming anything in empty data
FAMILY_LEVEL = 0.03
# two refitted candidates nearer than this in BIC are not told apart
CLASS_WIDTH = 10.0
_REFITTED_SHARE = 0.1
# so many are refitted whatever the screen says: the order of the list is that of refits
_ALWAYS_REFITTED = 4
# who weighs the bodies and sets the cameras errs in one study of five: twice the logarithm of those odds
_RARER = 3.2
_MAX_REFITS = 14
# from this share of the best score on a candidate may turn out to be the best: where its refit fails, others are tried
_RIVAL = 0.5
_SAME_DIRECTION = 0.9999


@dataclass(frozen=True)
class Candidate:
    """A candidate effect with what speaks for it.

    Attributes
    ----------
    effect : Effect
        The effect.
    score : float
        Fall of the deviance when it is added: after a refit, or as predicted by the screen.
    delta_bic : float
        BIC with it minus BIC without: negative is better. nan without a refit.
    p_value : float
        Probability of such a score anywhere in the list if nothing is missing.
    held_out_gain : float
        Fall of the casing's held-out error in units of the noise. nan without a refit.
    indistinguishable_from : tuple of str
        Other candidates that this data cannot tell from it.
    estimates : dict
        Its own parameters.
    fit : Fit or None
        The refit.
    """

    effect: Effect
    score: float
    delta_bic: float
    p_value: float
    held_out_gain: float
    indistinguishable_from: tuple[str, ...]
    estimates: dict[str, Estimate]
    screened: Score = field(repr=False)
    fit: Fit | None = field(repr=False, default=None)

    @property
    def significant(self) -> bool:
        """Whether empty data would hardly ever show it."""
        return self.p_value < FAMILY_LEVEL

    @property
    def apart(self) -> bool:
        """Whether each case has a strength and a phase of its own."""
        return self.effect.periodic and any("@" in name for name in self.estimates)

    @property
    def physical(self) -> bool:
        """Whether it is physics and not an artefact of the measurement."""
        return self.effect.kind == "physical"


def rank(
    base: Fit, extra: Sequence[Effect] = (), *, refitting: bool = True, workers: WorkerPool | None = None
) -> list[Candidate]:
    """Return all candidates for a fit, best first.

    Parameters
    ----------
    base : Fit
        The fit that may miss something.
    extra : sequence of Effect
        Effects of the user beside the library.
    refitting : bool
        Refit the promising candidates (otherwise the screen alone ranks).
    workers : WorkerPool, optional
        Processes that run some of the refits.
    """
    known = {e.name: e for e in (*LIBRARY.values(), *extra)}
    names = set(base.model.names)
    effects = [e for e in known.values() if e.name not in names and _fits_in(e, base)]
    cases = [CaseColumns(base, i) for i in range(len(base.problem.cases))]
    scores = screen(base, effects, cases)
    chances = [Chance(s) for s in scores]
    family = Family(chances)
    rough = [
        Candidate(s.effect, s.score, np.nan, family(c(s.score)), np.nan, (), {}, s)
        for s, c in zip(scores, chances, strict=True)
    ]
    rough.sort(key=lambda c: -c.score)
    if refitting:
        chance = {s.effect.name: c for s, c in zip(scores, chances, strict=True)}
        worth = _worth(rough)
        best = max((c.score for c, w in worth if w), default=0.0)
        promising = [
            _Promising(c, chance[c.effect.name], family, c.score > _RIVAL * best) for c, w in worth if w
        ]
        refits = iter((workers or WorkerPool(0)).map(_refitted, base, promising, _measured))
        rough = [next(refits) if w else c for c, w in worth]
    return arranged(rough)


def _measured(fit: Fit) -> Sequence[CaseData]:
    return fit.problem.data


def _fits_in(effect: Effect, base: Fit) -> bool:
    if base.problem.data[0].record.single and not effect.single_body:
        return False
    if not effect.mechanical:
        return base.problem.data[0].is_angle
    return not (effect.joint == "factor" and not any(e.joint == "bearing" for e in base.model.effects))


def _worth(candidates: list[Candidate]) -> list[tuple[Candidate, bool]]:
    """Return which candidates, sorted by score, to refit."""
    open_ones = [c for c in candidates if not c.effect.nuisance and not c.screened.absorbed]
    best = max((c.score for c in open_ones), default=0.0)
    chosen = [
        c
        for i, c in enumerate(open_ones)
        if i < _ALWAYS_REFITTED or (i < _MAX_REFITS and c.p_value < 0.5 and c.score > _REFITTED_SHARE * best)
    ]
    return [(c, any(c is o for o in chosen)) for c in candidates]


def _order(c: Candidate) -> tuple[bool, float]:
    penalised = (
        c.delta_bic
        if c.fit is not None
        else -c.score + (c.screened.columns + len(c.screened.shape[0])) * 10.0
    )
    return (not c.significant, penalised + (0.0 if c.physical else _RARER))


class _Promising(NamedTuple):
    candidate: Candidate
    chance: Chance
    family: Family
    thorough: bool


def _refitted(base: Fit, promising: _Promising) -> Candidate:
    """Refit base and effect together from the base's optimum."""
    candidate, chance, family, thorough = promising
    found = refit(base, candidate.screened, thorough=thorough)
    if found is None:
        return candidate
    if candidate.screened.apart:
        one = refit(base, at_one_phase(candidate.screened), thorough=thorough)
        found = one if one is not None and one.bic < found.bic else found
    gain, delta_bic = base.deviance - found.deviance, found.bic - base.bic
    p = chance(gain)
    common = None if candidate.screened.apart else with_one_value(base, candidate.screened, found)
    if common is not None:
        if common.deviance < found.deviance:
            # with a value for each case no fit can be worse: the search had lost its way
            found = with_own_values(base, candidate.screened, found, common)
            gain, delta_bic = base.deviance - found.deviance, found.bic - base.bic
            p = chance(gain)
        delta_bic = min(delta_bic, common.bic - base.bic)
        width = candidate.screened.columns // len(base.problem.layout.records)
        p = min(p, min(1.0, 2 * chance.of(base.deviance - common.deviance, width)))
    prefix = candidate.effect.name + "."
    return replace(
        candidate,
        score=gain,
        delta_bic=delta_bic,
        p_value=family(p),
        held_out_gain=base.cases[0].casing.held_out - found.cases[0].casing.held_out,
        estimates={k: e for k, e in found.estimates.items() if k.startswith(prefix)},
        fit=found,
    )


def arranged(found: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates in their order, best first, each with those that the data cannot tell from it."""
    candidates = sorted(found, key=_order)

    def alike(a: Candidate, b: Candidate) -> bool:
        if a.screened.absorbed or b.screened.absorbed:
            return False
        same = abs(float(a.screened.direction @ b.screened.direction)) > _SAME_DIRECTION
        if a.fit is None or b.fit is None:
            return same and a.significant and b.significant
        near = min(abs(a.delta_bic - b.delta_bic), abs(a.score - b.score))
        return a.significant and b.significant and near < CLASS_WIDTH

    return [
        replace(
            c, indistinguishable_from=tuple(o.effect.name for o in candidates if o is not c and alike(c, o))
        )
        for c in candidates
    ]
