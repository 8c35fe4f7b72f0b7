"""From scores to a ranking: error control over all candidates, refits, and classes that cannot be told apart.

Candidates overlap, and some try many shapes, so p-values come from empty data sets put through the very same
search: for each candidate the number of independent trials that its largest score in empty data amounts
to, and for the whole list the number of independent candidates. The promising ones are refitted
from the base's optimum with base and effect moving together, and ranked by their deviance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CAMERA_COLUMNS
from fitting.discovery.columns import CaseColumns
from fitting.discovery.screen import Score, screen
from fitting.effects import LIBRARY, Effect
from fitting.errors import FittingError
from fitting.estimation import Estimate, Fit, fit
from fitting.estimation.layout import PER_CASE

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
_SAME_DIRECTION = 0.9999
# what every fit frees anyway is found by the screen, and is no discovery
ALWAYS_FREE = tuple(CAMERA_COLUMNS)


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
    def physical(self) -> bool:
        """Whether it is physics and not an artefact of the measurement."""
        return self.effect.kind == "physical"


def rank(base: Fit, extra: Sequence[Effect] = (), *, refit: bool = True) -> list[Candidate]:
    """Return all candidates for a fit, best first.

    Parameters
    ----------
    base : Fit
        The fit that may miss something.
    extra : sequence of Effect
        Effects of the user beside the library.
    refit : bool
        Refit the promising candidates (otherwise the screen alone ranks).
    """
    known = {e.name: e for e in (*LIBRARY.values(), *extra)}
    names = set(base.model.names)
    effects = [e for e in known.values() if e.name not in names and _fits_in(e, base)]
    cases = [CaseColumns(base, i) for i in range(len(base.problem.cases))]
    scores = screen(base, effects, cases)
    chances = [_Chance(s) for s in scores]
    family = _Family(chances)
    rough = [
        Candidate(s.effect, s.score, np.nan, family(c(s.score)), np.nan, (), {}, s)
        for s, c in zip(scores, chances, strict=True)
    ]
    rough.sort(key=lambda c: -c.score)
    if refit:
        chance = {s.effect.name: c for s, c in zip(scores, chances, strict=True)}
        rough = [_refitted(base, c, chance[c.effect.name], family) if w else c for c, w in _worth(rough)]
    return _classed(sorted(rough, key=_order))


def _fits_in(effect: Effect, base: Fit) -> bool:
    if base.problem.data[0].record.single and not effect.alone:
        return False
    if not effect.moves:
        return base.problem.data[0].is_angle
    return not (effect.joint == "factor" and not any(e.joint == "bearing" for e in base.model.effects))


def _worth(candidates: list[Candidate]) -> list[tuple[Candidate, bool]]:
    """Return which candidates, sorted by score, to refit."""
    open_ones = [c for c in candidates if c.effect.name not in ALWAYS_FREE and not c.screened.absorbed]
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


class _Chance:
    """Tail probability of a candidate's score in empty data."""

    def __init__(self, score: Score) -> None:
        from scipy.stats import chi2

        self._chi2, self._columns = chi2, score.columns
        middle = float(np.median(score.null))
        tail = float(np.quantile(score.null, 0.9))
        self._trials = max(
            _trials(float(chi2.sf(middle, score.columns)), 0.5),
            _trials(float(chi2.sf(tail, score.columns)), 0.1),
        )
        self.null = np.array([self(x) for x in np.quantile(score.null, np.linspace(0, 1, 64))])
        self._sorted = np.sort(score.null)
        self.draws = score.null

    def __call__(self, score: float) -> float:
        return self.of(score, self._columns)

    def of(self, score: float, columns: int) -> float:
        """Return the probability of a score with fewer strengths, searched over as many shapes."""
        single = float(self._chi2.sf(max(score, 0.0), max(columns, 1)))
        return float(-np.expm1(self._trials * np.log1p(-min(single, 1 - 1e-12))))

    def of_draws(self) -> Array:
        """Return the p-value of each empty data set."""
        single = np.minimum(self._chi2.sf(self.draws, self._columns), 1 - 1e-12)
        return np.asarray(-np.expm1(self._trials * np.log1p(-single)))


def _trials(single: float, share: float) -> float:
    # share = 1 - (1 - single)^N, solved for N
    return float(np.log1p(-share) / np.log1p(-min(max(single, 1e-12), 1 - 1e-12)))


class _Family:
    """p-value over the whole list: calibrated on the smallest p of each empty data set."""

    def __init__(self, chances: Sequence[_Chance]) -> None:
        smallest = np.min([c.of_draws() for c in chances], axis=0)
        self._candidates = max(1.0, _trials(float(np.quantile(smallest, 0.1)), 0.1))

    def __call__(self, p: float) -> float:
        return float(-np.expm1(self._candidates * np.log1p(-min(p, 1 - 1e-12))))


def _refitted(base: Fit, candidate: Candidate, chance: _Chance, family: _Family) -> Candidate:
    """Refit base and effect together from the base's optimum."""
    found = _together(base, candidate)
    if found is None:
        return candidate
    gain, delta_bic = base.deviance - found.deviance, found.bic - base.bic
    p = chance(gain)
    common = _with_one_value(base, candidate, found)
    if common is not None:
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


def _together(
    base: Fit, candidate: Candidate, start: Mapping[str, float] | None = None, common: Sequence[str] = ()
) -> Fit | None:
    """Return the fit of base and candidate, with some parameters common to all cases; None if there is none."""
    layout = base.problem.layout
    own = [k for k in layout.per_case if k in base.model.free]
    shared = [k for k in base.model.free if k.startswith(PER_CASE) and k not in own]
    begin = {name: e.value for name, e in base.estimates.items()} | start_of(base, candidate.screened)
    try:
        found = fit(
            base.model.with_effect(candidate.effect),
            base.problem.data,
            share=[*shared, *common] if len(layout.records) > 1 else (),
            per_case=own if len(layout.records) > 1 else (),
            start=begin if start is None else begin | dict(start),
            noise=base.noise,
            quick=True,
        )
    except FittingError:
        return None
    return found if np.isfinite(found.deviance) else None


def _with_one_value(base: Fit, candidate: Candidate, found: Fit) -> Fit | None:
    """Return the fit in which all cases have the same value of what may differ from case to case.

    Surfaces that happen to agree need one number and not one each: a law must not lose against a rival
    because its parameters are free to differ.
    """
    prefix = candidate.effect.name + "."
    keys = [k for k in found.problem.layout.per_case if k.startswith(prefix)]
    if not keys:
        return None
    mean = {
        k: float(np.mean([e.value for name, e in found.estimates.items() if name.partition("@")[0] == k]))
        for k in keys
    }
    return _together(base, candidate, {n: e.value for n, e in found.estimates.items()} | mean, keys)


def start_of(base: Fit, score: Score) -> dict[str, float]:
    """Return start values of a candidate's parameters from its score."""
    effect, labels = score.effect, [r.label for r in base.problem.layout.records]
    own = len(labels) > 1 and effect.name.startswith(PER_CASE)
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
        values |= {f"{effect.name}.{k}{tail}": float(v) for k, v in found.items()}
    return values


def _classed(candidates: list[Candidate]) -> list[Candidate]:
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
