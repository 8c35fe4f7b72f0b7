"""From scores to a ranking, and from a ranking to the effects that are added.

1. `rank`: score every candidate, refit the promising candidates, order them by BIC, and mark indistinguishable
   candidates.
2. `select`: refine the best candidate; rank it and its rivals again at the lower noise of its fit
   (`ranked_at_noise`); add a second effect if one effect does not suffice.
3. `improve`: forward selection while a candidate is significant, each step followed by backward elimination.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fitting._criteria import DEFAULT, Criteria
from fitting._display import BLUE, block, draw_history, figure, figure_of, markup_table
from fitting._errors import FittingError
from fitting._numbers import rounded, short, unit_text
from fitting._workers import WorkerPool, single_blas_thread
from fitting.discovery._difference import SeparateValues, different_parameter, improves_on_difference
from fitting.discovery._exchange import Exchange, exchanges
from fitting.discovery._measurement import StartErrors, starts_are_unknown
from fitting.discovery._oscillator import possible_restoring
from fitting.discovery._random_torque import describes, is_established, with_random_torque
from fitting.discovery._refine import (
    at_lowest_noise,
    fit_from_scratch,
    has_less_process_noise,
    initial_values_of,
    is_far_from_the_motion,
    refined,
    refit,
    refitted_at,
    restarted_from,
    scores_mislead,
    with_common_phase,
    with_common_values,
    with_free_shape,
    with_values_per_case,
)
from fitting.discovery._score import CaseColumns, FamilywiseNull, NullDistribution, Score, score
from fitting.effects._effect import Effect, mechanism_of
from fitting.effects._expression import substitute, sym
from fitting.effects._instances import laws_of
from fitting.effects._library import START
from fitting.effects._user import drives
from fitting.effects._words import change_name
from fitting.inference._case_data import CaseData
from fitting.inference._fit import deviance_at_noise_of, fit, measured_with
from fitting.inference._initial_values import equation_error
from fitting.inference._noise import Noise
from fitting.inference._oscillation import are_smooth
from fitting.inference._params import Estimate
from fitting.inference._result import Fit
from fitting.inference._trace import Refit, attempt, recorded_map, recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_SHOWN = 4
"""Number of parameters in the repr of a candidate [1]. Chosen: a smaller number hides shape constants, a larger one
needs several lines."""


@dataclass(frozen=True, repr=False)
class Candidate:
    """A candidate effect and the evidence for it.

    Attributes
    ----------
    effect : Effect
        The effect.
    score : float
        Decrease of the deviance when the effect is added, from the refit or, without a refit, from the score test.
    delta_bic : float
        BIC with the effect minus BIC without the effect; a negative value favours the effect. nan without a refit.
    p_value : float
        Family-wise p-value: probability that any candidate of the list has a score this large if nothing is missing.
    held_out_gain : float
        Decrease of the casing's cross-validation error in units of the noise. nan without a refit.
    indistinguishable_from : tuple of str
        Other candidates that these data cannot separate from this candidate.
    estimates : dict
        Parameters of the effect.
    significant : bool
        Whether `p_value` is below `Criteria.significance`.
    screened : Score
        The result of the score test.
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
    significant: bool
    screened: Score = field(repr=False)
    fit: Fit | None = field(repr=False, default=None)

    def __repr__(self) -> str:
        strengths = ", ".join(
            f"{name.removeprefix(f'{self.effect.name}.')} = {rounded(e.value, e.stderr, e.unit)}"
            for name, e in list(self.estimates.items())[:_SHOWN]
        )
        mark = "significant" if self.significant else "not significant"
        return f"{self.effect.name}: score {self.score:.4g}, {mark}{f'; {strengths}' if strengths else ''}"

    @property
    def own_phase(self) -> bool:
        """Whether each case has its own strength and phase."""
        return self.effect.periodic and any("@" in name for name in self.estimates)

    @property
    def physical(self) -> bool:
        """Whether the effect is physical, not an effect of the measurement."""
        return self.effect.kind == "physical"


def equivalence_classes(candidates: Sequence[Candidate]) -> dict[str, str]:
    """Return the letter of the equivalence class of each candidate that is indistinguishable from another candidate."""
    letters: dict[str, str] = {}
    for c in candidates:
        if c.indistinguishable_from and c.effect.name not in letters:
            letter = chr(ord("A") + len(set(letters.values())))
            for name in (c.effect.name, *c.indistinguishable_from):
                letters.setdefault(name, letter)
    return letters


def rank(
    base: Fit,
    extra: Sequence[Effect] = (),
    *,
    criteria: Criteria = DEFAULT,
    refitting: bool = True,
    workers: WorkerPool | None = None,
) -> list[Candidate]:
    """Return all candidates for a fit, best first; without `refitting`, they are ordered by the score test alone.

    `extra` are effects of the user, in addition to the library; `workers` run some of the refits.
    """
    data = base.problem.data
    # if the base lacks the restoring torque, its motion does not oscillate, and scores about this motion are not
    # reliable
    restoring_only = base.lacks_restoring_torque
    effects = [e for e in applicable_effects(base, extra) if e.restoring or not restoring_only]
    driving = needed_drives(base, effects)
    effects = [e for e in effects if not driving or e.name in driving]
    cases = [CaseColumns(base, i) for i in range(len(base.problem.cases))]
    scores = score(base, effects, cases, criteria)
    nulls = {s.effect.name: NullDistribution(s) for s in scores}
    family = FamilywiseNull(list(nulls.values()))
    found = []
    for s in scores:
        null = nulls[s.effect.name]
        p = family(null(s.score), null.weights)
        found.append(Candidate(s.effect, s.score, np.nan, p, np.nan, (), {}, p < criteria.significance, s))
    found.sort(key=lambda c: -c.score)
    chosen = [True] * len(found) if driving else _to_refit(found, criteria)
    afresh = [False] * len(found)
    if scores_mislead(base, criteria):
        afresh = [
            not (w or c.screened.absorbed or c.effect.depends_on_angle) and c.effect.mechanical
            for w, c in zip(chosen, found, strict=True)
        ]
        chosen = [w or a for w, a in zip(chosen, afresh, strict=True)]
    elif is_far_from_the_motion(base, criteria):
        near = _nearest(base, [c.effect for c in found if c.effect.mechanical], criteria)
        chosen = afresh = [c.effect.name in near[: criteria.refit_most] for c in found]
    if base.model.restoring:
        # a refit over many periods takes long; moreover, the parameters of a law with a small score are degenerate
        most = criteria.refit_oscillation_p
        least = criteria.refit_share * max((c.score for c in found), default=0.0)
        chosen = [w and c.p_value < most and c.score >= least for w, c in zip(chosen, found, strict=True)]
        allowed = criteria.refits_through(len(data[0].motion.reversals))
        chosen = [w and sum(chosen[:i]) < allowed for i, w in enumerate(chosen)]
    if restoring_only:
        possible = possible_restoring(base.model, effects, data, criteria)
        if possible is None:
            possible = {*_nearest(base, effects, criteria)}
        chosen = [c.effect.name in possible for c in found]
        found = [
            c if w else replace(c, score=0.0, p_value=1.0, significant=False)
            for c, w in zip(found, chosen, strict=True)
        ]
    if refitting:
        best_score = max((c.score for c, w in zip(found, chosen, strict=True) if w), default=0.0)
        promising = [
            _Promising(
                c, nulls[c.effect.name], family, criteria, c.score > criteria.rival_share * best_score, a
            )
            for c, w, a in zip(found, chosen, afresh, strict=True)
            if w
        ]
        refits = iter(recorded_map(workers or WorkerPool(0), _refit_candidate, base, promising, shared_data))
        found = [next(refits) if w else c for c, w in zip(found, chosen, strict=True)]
        if rivals := _noisier_rivals(found, criteria):
            again = [_Promising(c, nulls[c.effect.name], family, criteria) for c in rivals]
            quieter = recorded_map(workers or WorkerPool(0), _at_lowest_noise, base, again, shared_data)
            renewed = {c.effect.name: c for c in quieter}
            found = [renewed.get(c.effect.name, c) for c in found]
        if starts_are_unknown(data):
            found.append(_start_candidate(base, family, criteria))
    return ordered(found, criteria)


def _nearest(base: Fit, effects: Iterable[Effect], criteria: Criteria) -> list[str]:
    """Return the names of the effects with which the equations of motion describe the measured speeds best."""
    error = {e.name: equation_error(base.model.with_effect(e), base.problem.data) for e in effects}
    most = criteria.equation_error * min(error.values(), default=math.inf)
    return sorted((name for name, value in error.items() if value <= most), key=lambda name: error[name])


def _start_candidate(base: Fit, family: FamilywiseNull, criteria: Criteria) -> Candidate:
    """Return the errors of the starts of the rotor windows, whose uncertainty is not stated, as a candidate."""
    starts = StartErrors(base, criteria)
    p_value = family(np.array([starts.p_value]), np.ones(1))
    significant = p_value < criteria.significance
    refitted, errors = starts.refit() if significant else (None, starts)
    evidence = starts.evidence if refitted is None else starts.evidence_of(refitted)
    return Candidate(
        START, max(starts.fall, 0.0), -evidence, p_value, np.nan, (), errors.estimates, significant,
        starts.score, refitted,
    )  # fmt: skip


_SMALLEST_RANGE = 1.0
"""Smallest range of an oscillation in which a harmonic of the angle is distinguishable from the first terms of its
Taylor series [rad]. Chosen: a smaller value adds candidates equivalent to springs, a larger one overlooks harmonics of
wide oscillations."""


def shared_data(fit: Fit) -> Sequence[CaseData]:
    """Return the parts of a fit that all refits in the workers use."""
    return fit.problem.data


def applicable_effects(base: Fit, extra: Sequence[Effect]) -> list[Effect]:
    """Return the effects of the library and of the user that may be missing in a fit."""
    first, *others = ({(i.name, i.unit) for i in d.record.inputs} for d in base.problem.data)
    varying = {i.name for d in base.problem.data for i in d.record.driving}
    common = {name: unit for name, unit in sorted(first.intersection(*others)) if name in varying}
    mechanism = mechanism_of(base.model.effects)
    recorded = [e for e in drives(common, mechanism) if not any(_same_law(e, b) for b in base.model.effects)]
    known = {e.name: e for e in (*laws_of(mechanism).values(), *recorded, *extra)}
    names = set(base.model.names)
    asked = {e.name for e in extra}
    return [
        e
        for e in known.values()
        if e.name not in names and not e.nuisance and _is_applicable(e, base, asked=e.name in asked)
    ]


_DRIVE_ERROR = 0.5
"""A recorded input counts as the drive of the body if the rms residual speed with a law of this input, divided by the
rms without this law, is below this value [1]. Chosen: a larger value mistakes a chance correlation for a drive, a
smaller one overlooks weak drives."""


def needed_drives(base: Fit, effects: Sequence[Effect]) -> set[str]:
    """Return the laws of recorded inputs that a model of a driven body needs before other effects can be scored.

    Scores about a model without the drive are not reliable, so each law is fitted from scratch. Empty if the model
    contains a law of an input, or if no input halves the rms residual speed.
    """
    laws = [e for e in effects if e.inputs and e.joint != "input" and e.amplitude is not None]
    if any(e.inputs for e in base.model.effects):
        return set()
    fits = {e.name: fit_from_scratch(base, e) for e in laws}
    error = {name: f.rmse_casing for name, f in fits.items() if f is not None}
    return {name for name, value in error.items() if value < _DRIVE_ERROR * base.rmse_casing}


def _same_law(one: Effect, other: Effect) -> bool:
    """Return whether two effects have the same law except for the name of the strength."""
    if (
        (one.joint, one.site) != (other.joint, other.site)
        or one.inputs != other.inputs
        or one.amplitude is None
        or other.amplitude is None
    ):
        return False
    law, own = one.expression, {other.amplitude.symbol: sym(one.amplitude.symbol)}
    return law == substitute(other.expression, own)


def _without_dead_time(base: Fit) -> bool:
    """Return whether the model contains a law of a varying input without its dead time.

    A torque that sets in after a step of the input imitates a dead time, with more parameters.
    """
    delayed = {name for e in base.model.effects if e.joint == "input" for name, _ in e.inputs}
    used = {name for e in base.model.effects for name, _ in e.inputs}
    return bool(used & {i.name for i in base.problem.data[0].record.driving} - delayed)


def _is_applicable(effect: Effect, base: Fit, *, asked: bool = False) -> bool:
    if effect.breakpoint and _without_dead_time(base):
        return False
    if effect.joint == "input":  # the dead time of an input has no influence if no law depends on the input
        return any(effect.inputs[0] in e.inputs for e in base.model.effects)
    if not (effect.searched or asked) or not effect.bodies <= base.problem.data[0].record.parts:
        return False
    # a contact that turns in one sense begins to slide after a small angle; from then on its friction is constant
    reversing = effect.restoring or effect.contact
    motion = base.problem.data[0].motion
    if reversing and motion.is_smooth:
        return False
    # over a small part of a turn a harmonic of the angle is equivalent to a constant and a spring
    if not motion.is_smooth and effect.about_equilibrium is not effect:
        return bool(np.ptp(motion.deflection) > _SMALLEST_RANGE)
    # before the body has turned once, a harmonic is not distinguishable from other laws
    if motion.is_smooth and effect.depends_on_angle and not asked:
        angle = base.problem.data[0].measured_angle
        if angle is not None and np.ptp(angle) < 2 * np.pi:
            return False
    if not effect.mechanical:
        return base.problem.data[0].is_angle
    joints = {e.site for e in base.model.effects if e.joint == "bearing"}
    return not (effect.joint == "factor" and effect.site not in joints)


def _to_refit(candidates: Sequence[Candidate], criteria: Criteria) -> list[bool]:
    """Return a mask of the candidates, sorted by score, that are to be refitted."""
    chosen, count, best_score = [], 0, None
    significant = any(c.significant for c in candidates)
    for c in candidates:
        testable = not c.screened.absorbed
        if testable and best_score is None:
            best_score = c.score
        promising = (
            count < criteria.refit_most
            and c.p_value < criteria.refit_p
            and c.score > criteria.refit_share * (best_score or 0.0)
        )
        # the base may have absorbed a part of a measurement error, so that its linear score is small; it is refitted
        # anyway
        faulty = significant and not c.physical
        chosen.append(testable and (count < criteria.refit_least or promising or faulty))
        count += testable
    return chosen


class _Promising(NamedTuple):
    candidate: Candidate
    null: NullDistribution
    family: FamilywiseNull
    criteria: Criteria
    thorough: bool = False
    afresh: bool = False  # whether to fit from scratch, because scores about the base are not reliable


def _refit_candidate(base: Fit, promising: _Promising) -> Candidate:
    """Fit base and effect together, from the base's optimum or from scratch."""
    candidate, _, _, criteria, thorough, afresh = promising
    screened = candidate.screened
    found = (
        fit_from_scratch(base, candidate.effect)
        if afresh
        else refit(base, screened, criteria, thorough=thorough)
    )
    if found is None:
        return candidate
    if screened.own_phase:
        other = refit(base, with_common_phase(screened), criteria, thorough=thorough)
        found = other if other is not None and other.bic < found.bic else found
    if not found.converged:
        # if a parameter of the base was at its bound, a quick search ends far from the minimum
        found = _refined(found, criteria)
    return _with_fit(base, promising, found)


def _noisier_rivals(found: Sequence[Candidate], criteria: Criteria) -> list[Candidate]:
    """Return the rivals of the candidate with the lowest BIC whose refits have clearly more process noise.

    As a function of the noise level, the deviance may have two minima. If the search ends at the higher minimum of the
    deviance, the law is wrongly ranked behind another law of similar shape.
    """
    fits = {c.effect.name: c.fit for c in found if c.fit is not None and c.significant}
    leader = min((c for c in found if c.effect.name in fits), key=lambda c: c.delta_bic, default=None)
    if leader is None:
        return []
    least, best_fit = criteria.rival_share * leader.score, fits[leader.effect.name]
    return [
        c
        for c in found
        if c.effect.name in fits
        and c.score > least
        and has_less_process_noise(best_fit, fits[c.effect.name], criteria)
    ]


def _at_lowest_noise(base: Fit, promising: _Promising) -> Candidate:
    """Return a candidate, refitted again at the lowest process noise if this describes the data better."""
    fitted = promising.candidate.fit
    end = None if fitted is None else at_lowest_noise(fitted, promising.criteria)
    return promising.candidate if end is None or end is fitted else _with_fit(base, promising, end)


def _with_fit(base: Fit, promising: _Promising, found: Fit) -> Candidate:
    """Return a candidate with the evidence of its refit."""
    candidate, null, family, criteria, *_ = promising
    screened = candidate.screened
    delta_bic, p = found.bic - base.bic, null(base.deviance - found.deviance)
    common = None if screened.own_phase else with_common_values(base, screened, found)
    if common is not None:
        if common.deviance < found.deviance:
            # a fit with per-case values that is worse than the fit with common values did not reach its minimum
            found = with_values_per_case(base, screened, found, common)
            delta_bic, p = found.bic - base.bic, null(base.deviance - found.deviance)
        delta_bic = min(delta_bic, common.bic - base.bic)
        width = screened.columns // len(base.problem.layout.records)
        p = np.minimum(p, 2 * null.of(base.deviance - common.deviance, width))
    p_value = family(p, null.weights)
    excess = base.deviance - deviance_at_noise_of(base, found) if p_value < criteria.significance else 0.0
    if excess > 0:  # a lower noise level causes a part of the improvement
        delta_bic, p_value = (
            delta_bic + excess,
            family(null(base.deviance - excess - found.deviance), null.weights),
        )
    return replace(
        candidate,
        score=base.deviance - excess - found.deviance,
        delta_bic=delta_bic,
        p_value=p_value,
        significant=p_value < criteria.significance,
        held_out_gain=base.held_out_of_first_casing - found.held_out_of_first_casing,
        estimates=_own_estimates(found, candidate.effect),
        fit=found,
    )


def _own_estimates(found: Fit, effect: Effect) -> dict[str, Estimate]:
    return {k: e for k, e in found.estimates.items() if k.startswith(effect.name + ".")}


_TIE = 1
"""Number of decimal places to which BIC is rounded when candidates are ordered [1]. Chosen: with fewer, the library
decides the order of different laws; with more, rounding errors decide the order of equal laws."""


def ordered(found: Sequence[Candidate], criteria: Criteria) -> list[Candidate]:
    """Return candidates in order, best first, each with the candidates that the data cannot separate from it."""
    place = {name: i for i, name in enumerate(laws_of(mechanism_of(c.effect for c in found)))}

    def order(c: Candidate) -> tuple[bool, float, int]:
        penalised = c.delta_bic
        if c.fit is None:
            penalised = (
                -c.score + (c.screened.columns + len(c.screened.shape[0])) * criteria.equivalence_width
            )
        penalised += 0.0 if c.physical else criteria.measurement_penalty
        # laws that are equal in a recording differ only by rounding errors; they are sorted as in the library
        return (not c.significant, round(penalised, _TIE), place.get(c.effect.name, len(place)))

    def indistinguishable(a: Candidate, b: Candidate) -> bool:
        if a.screened.absorbed or b.screened.absorbed or not (a.significant and b.significant):
            return False
        if a.fit is None or b.fit is None:
            cosine = abs(float(a.screened.direction @ b.screened.direction))
            return cosine > criteria.collinearity
        return min(abs(a.delta_bic - b.delta_bic), abs(a.score - b.score)) < criteria.equivalence_width

    candidates = sorted(found, key=order)
    unstated = next(
        (c for c in candidates if c.effect is START and c.significant and c.fit is not None), None
    )
    if unstated is not None and all(
        unstated.delta_bic < c.delta_bic + criteria.equivalence_width for c in candidates if c.fit is not None
    ):
        # an effect that cannot be separated from start errors of unstated uncertainty is not established as physical
        candidates = [unstated, *(c for c in candidates if c is not unstated)]
    return [
        replace(
            c,
            indistinguishable_from=tuple(
                o.effect.name for o in candidates if o is not c and indistinguishable(c, o)
            ),
        )
        for c in candidates
    ]


def best(candidates: Sequence[Candidate], criteria: Criteria = DEFAULT) -> Candidate | None:
    """Return the candidate to add next: significant, refitted, better in BIC; None if there is none.

    If the strength of the best candidate is not determined, for example because its shape constant diverges, the first
    indistinguishable candidate with a determined strength is returned instead.
    """
    fitting = [
        c
        for c in candidates
        if c.fit is not None and c.significant and c.delta_bic < -needed_evidence(c.effect, c.fit, criteria)
    ]
    if not fitting:
        return None
    alike = (c for c in fitting if c is fitting[0] or c.effect.name in fitting[0].indistinguishable_from)
    return next(
        (c for c in alike if c.fit is not None and not reason_undetermined(c.effect, c.fit, criteria)),
        fitting[0],
    )


def reason_undetermined(effect: Effect, fit: Fit, criteria: Criteria) -> str:
    """Return the reason why the strength of an effect is not determined, as a sentence; empty if it is determined."""
    name, amplitude = effect.name, effect.amplitude
    if not fit.converged:
        return f"The fit with {fit.name(effect)} did not converge"
    for key, e in fit.estimates.items():
        is_strength = amplitude is not None and key.partition("@")[0] == f"{name}.{amplitude.symbol}"
        if is_strength and math.isfinite(e.stderr) and not abs(e.value) >= criteria.named_sigma * e.stderr:
            return f"The strength {key} = {rounded(e.value, e.stderr, e.unit)} is not determined"
    return ""


def needed_evidence(effect: Effect, fit: Fit, criteria: Criteria) -> float:
    """Return the decrease of BIC that is required for adding an effect to a fit.

    Tracking errors are periodic in the angles of casing and rotor and in their beats. Therefore a periodic law needs
    more evidence if the data were measured on film.
    """
    tracked = any(d.record.tracked for d in fit.problem.data)
    periodic = tracked and effect.kind == "physical" and effect.periodic
    return criteria.evidence_periodic if periodic else criteria.evidence


def ranked_at_noise(
    base: Fit, candidates: Sequence[Candidate], chosen: Candidate, noise: Sequence[Noise], criteria: Criteria
) -> list[Candidate]:
    """Return the candidates in order, with `chosen` and its equivalence class refitted at another noise.

    `noise` was measured about the refined fit of `chosen`.
    """
    without = None
    with attempt("the base at the noise of the best candidate"):
        without = refitted_at(base, noise)
    if without is None:
        return list(candidates)
    members = {chosen.effect.name, *chosen.indistinguishable_from}
    found = []
    for c in candidates:
        if c.effect.name not in members or c.fit is None:
            found.append(c)
            continue
        end = None
        with attempt("a candidate at the noise of the best one"):
            end = refitted_at(c.fit, noise)
        if end is None:
            # the search diverges at this noise
            found.append(replace(c, delta_bic=float("nan"), fit=None))
            continue
        found.append(
            replace(
                c,
                score=without.deviance - end.deviance,
                delta_bic=end.bic - without.bic,
                estimates=_own_estimates(end, c.effect),
                fit=end,
            )
        )
    return ordered(found, criteria)


@dataclass(frozen=True)
class Step:
    """One step of a history: the added, dropped or exchanged effect, the fit, and the candidates for the next step.

    Exchanges are the last steps; they have no candidates.
    """

    change: str
    fit: Fit
    candidates: tuple[Candidate, ...]
    is_exchange: bool = False

    @property
    def words(self) -> str:
        """The change in words; "base" for the first step."""
        return change_name(
            self.change or "base", self.fit.problem.data[0].record.body, self.fit.model.effects
        )

    def adds(self, effect: Effect) -> bool:
        """Return whether this step added an effect; laws that it replaced are dropped in the same step."""
        added = f"+{effect.name}"
        return self.change == added or self.change.startswith(f"{added} -")

    def __repr__(self) -> str:
        return f"Step({self.change or 'base'}: {self.fit.verdict}, {len(self.candidates)} candidates)"


class History(list[Step]):
    """The steps of `improve`, the base first; a notebook shows them as a table.

    `stopped` is the reason for an early end: the message of a failed fit, or a statement that information on the data
    is missing. `trace` lists every fit of the search, including failed fits.
    """

    stopped: str = ""
    trace: tuple[Refit, ...] = ()

    def __repr__(self) -> str:
        width = max((len(s.change) for s in self), default=0) + 2
        lines = [f"{'change':<{width}}{'rms [rad/s]':>12}{'misfit':>11}{'prediction':>11}  verdict"]
        for s in self:
            numbers = f"{s.fit.rmse_casing:>12.4g}{s.fit.misfit:>11.4g}{s.fit.held_out:>10.4g}"
            lines.append(f"{s.change or 'base':<{width}}{numbers}  {s.fit.verdict}")
        return "\n".join(lines)

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the error of each step in `ax`, or in a new figure that also shows the cross-validation error."""
        changes = [s.words for s in self]
        body = self[0].fit.problem.data[0].record.body
        rms, name = [s.fit.rmse_casing for s in self], f"rms residual of the {body} [rad/s]"
        if ax is not None:
            draw_history(ax, changes, rms, name)
            return figure_of(ax)
        drawn = figure(8.0, 1.6 + 0.4 * len(self))
        left, right = drawn.subplots(1, 2, sharey=True)
        draw_history(left, changes, rms, name)
        draw_history(
            right, changes, [s.fit.held_out for s in self], "cross-validation error [noise]", limit=1.0
        )
        return drawn

    def _repr_html_(self) -> str:
        largest = max((s.fit.rmse_casing for s in self), default=1.0) or 1.0
        rows = []
        for i, step in enumerate(self):
            found = step.fit
            width = max(1, round(100 * found.rmse_casing / largest))
            gain = found.bic - self[i - 1].fit.bic if i else 0.0
            numbers = [short(v) for v in (found.rmse_casing, found.misfit, found.held_out, gain)]
            bar = f'<div style="background:{BLUE};height:.6em;width:{width}px"></div>'
            rows.append([escape(step.words), *numbers, short(found.torque_noise, 2), bar])
        columns = (
            "change",
            "rms [rad/s]",
            "misfit [noise]",
            "cross-validation error [noise]",
            "ΔBIC",
            f"remaining torque [{unit_text(self[0].fit.torque_unit)}]",
            "",
        )
        return block(markup_table("history of fits", columns, rows))


class Selection(NamedTuple):
    """The outcome of `select`."""

    candidates: list[Candidate]  # candidates in their final order
    chosen: Candidate | None  # the effect to add
    named: Fit  # the refined fit with this effect alone; the base if no effect is added
    # the refined fit with everything that was added, for example also a free shape constant or a second effect; the
    # base if nothing was added
    final: Fit


def select(
    base: Fit,
    candidates: Sequence[Candidate],
    extra: Sequence[Effect],
    criteria: Criteria,
    workers: WorkerPool,
    known: Sequence[Step] = (),
    *,
    follow_up: bool = False,
) -> Selection:
    """Return the effect to add to a fit, and the fit with this effect and any further parameters that are needed.

    `known` is the history of an earlier `improve` of the same fit; its first steps are reused if it added the same
    effect. With `follow_up`, further effects are tried even if the fit with the first effect has no lack of fit.
    """
    ranked = list(candidates)
    chosen = best(ranked, criteria)
    if chosen is None or chosen.fit is None:
        return Selection(ranked, None, base, base)
    ranked = [chosen, *(c for c in ranked if c is not chosen)]
    if chosen.effect is START:
        return Selection(ranked, chosen, chosen.fit, chosen.fit)
    end = _refined(chosen.fit, criteria)
    # if an effect reduces the process noise, the earlier noise may have masked another effect or a difference between
    # rivals
    less_noise = has_less_process_noise(end, chosen.fit, criteria)
    if less_noise:
        ranked = ranked_at_noise(base, ranked, chosen, end.noise, criteria)
        now_best = best(ranked, criteria)
        if now_best is not None and now_best.fit is not None:
            chosen, end = now_best, now_best.fit
    if follow_up or less_noise or end.fails(criteria):
        most = 1 + criteria.follow_up
        # an exchange changes the effect that is named
        history = [s for s in known if not s.is_exchange][: 1 + most]
        if len(known) < 2 or not known[1].adds(chosen.effect):
            history = improve(
                base, extra, criteria=criteria, max_steps=most, first=ranked, workers=workers, exchange=False
            )
        named, end = (history[1].fit, history[-1].fit) if len(history) > 1 else (end, end)
        left = _superseding(base, history, ranked, chosen) if len(history) > 1 else None
        if left is not None and left.fit is not None:
            ranked = [left, *(c for c in ranked if c.effect.name != left.effect.name)]
            chosen, named = left, left.fit
    else:
        named = end
        end = _with_free_shape(end, chosen, (), criteria) or end
    if end is not named and not named.model.restoring:
        # an oscillation is fitted by averaged equations first, which have only one minimum
        named = restarted_from(named, end)
    if chosen.indistinguishable_from and end is not named:
        # at the noise of the most complete fit the data may separate the class
        separated = ranked_at_noise(base, ranked, chosen, end.noise, criteria)
        now_best = best(separated, criteria)
        if now_best is not None and now_best.effect.name == chosen.effect.name:
            ranked, chosen = separated, now_best
    if chosen.effect.name in named.model.names:
        stated = replace(chosen, estimates=_own_estimates(named, chosen.effect))
        ranked, chosen = [stated if c is chosen else c for c in ranked], stated
    return Selection(ranked, chosen, named, end)


def _superseding(
    base: Fit, history: Sequence[Step], candidates: Sequence[Candidate], chosen: Candidate
) -> Candidate | None:
    """Return the effect that made the chosen effect unnecessary.

    None if the most complete fit contains the chosen effect.

    If the base does not describe the motion, scores are misleading, and the second effect may describe the data without
    the first effect. The result is the first effect of the history that was alone in one step and is part of the last
    step.
    """
    last = history[-1].fit.model.names
    for step in history[1:] if chosen.effect.name not in last else ():
        found = step.fit
        added = [n for n in found.model.names if n not in base.model.names]
        left = next((c for c in candidates if [c.effect.name] == added and c.effect.name in last), None)
        if left is not None:
            return replace(
                left,
                fit=found,
                score=base.deviance - found.deviance,
                delta_bic=found.bic - base.bic,
                p_value=min(left.p_value, chosen.p_value),
                held_out_gain=base.held_out_of_first_casing - found.held_out_of_first_casing,
                indistinguishable_from=(),
                significant=True,
            )
    return None


def _refined(found: Fit, criteria: Criteria) -> Fit:
    """Return a fit continued to full convergence.

    The fit is unchanged if the model cannot be computed during the search.
    """
    with attempt("to full convergence"):
        return refined(found, criteria)
    return found


def _with_free_shape(
    found: Fit, chosen: Candidate, following: Sequence[Candidate], criteria: Criteria
) -> Fit | None:
    """Return the fit with a free shape constant of the newest law if this lowers BIC more than a further effect."""
    if chosen.effect not in found.model.effects:
        return None
    general = with_free_shape(found, chosen.effect, criteria)
    rival = best(following, criteria) if general is not None else None
    if general is None or rival is None or rival.fit is None:
        return general
    return general if general.bic < refined(rival.fit, criteria).bic else None


def separate_values(
    base: Fit, candidates: Sequence[Candidate], extra: Sequence[Effect], criteria: Criteria
) -> SeparateValues | None:
    """Return the shared parameters that differ between the recordings, if no effect describes the data as well.

    `candidates` is the ranking of `base`; `extra` are effects of the user.
    """
    if not base.fails(criteria):
        return None
    # scores of large effects are approximate: separate values may have a smaller score than an effect, but fit better
    least = criteria.rival_share * max((c.score for c in candidates if c.physical), default=0.0)
    separate = different_parameter(base, criteria, least=least)
    if separate is None or separate.fit.fails(criteria):
        return None
    if any(c.fit is not None and c.fit.bic < separate.penalised_bic for c in candidates):
        return None
    effects = applicable_effects(base, extra)
    return None if improves_on_difference(separate, effects, [0.0] * len(effects), criteria) else separate


@single_blas_thread()
def improve(
    base: Fit,
    extra: Sequence[Effect] = (),
    *,
    criteria: Criteria | None = None,
    max_steps: int | None = None,
    progress: Callable[[int, int | None], None] | None = None,
    first: Sequence[Candidate] | None = None,
    workers: WorkerPool | None = None,
    keep: Callable[[Step], object] | None = None,
    exchange: bool = True,
) -> History:
    """Add the best effect while any is significant, free its shape constant if needed, and drop unnecessary effects.

    Finally exchange an added effect for one or two other effects while this lowers BIC.

    Parameters
    ----------
    base : Fit
        The initial model, fitted.
    extra : sequence of Effect
        Effects of the user, in addition to the library.
    criteria : Criteria, optional
        Thresholds of every decision; by default the criteria of the fit. If criteria of the noise differ, the fit is
        repeated first, and `first` is not used.
    max_steps : int, optional
        Maximum number of added effects; `Criteria.max_steps` if not given.
    progress : callable, optional
        Called with (steps done, None).
    first : sequence of Candidate, optional
        The ranking of the base, if available.
    workers : WorkerPool, optional
        Processes that share the work.
    keep : callable, optional
        Called with each step after the base as soon as it is complete, so that an interrupted search loses no step.
    exchange : bool
        End with exchanges of added effects.

    Returns
    -------
    History
        A list of steps, the base first, the final model last. A failed fit ends the history; earlier steps remain.
    """
    criteria = criteria or base.criteria
    with recording() as trace:
        measured = measured_with(base, criteria)
        history = _improved(
            measured, extra, criteria, criteria.max_steps if max_steps is None else max_steps, progress,
            first if measured is base else None, workers, keep,
        )  # fmt: skip
        for _ in range(criteria.max_steps if exchange else 0):
            step = None
            with attempt("exchanges of an effect"):
                step = _exchanged(history, extra, criteria)
            if step is None:
                break
            history.append(step)
            if not step.fit.fails(criteria):
                history.stopped = ""  # the stored reason applied to the model before the exchange
            if keep is not None:
                keep(step)
    history.trace = tuple(trace.refits)
    return history


def _improved(
    base: Fit,
    extra: Sequence[Effect],
    criteria: Criteria,
    most: int,
    progress: Callable[[int, int | None], None] | None,
    first: Sequence[Candidate] | None,
    workers: WorkerPool | None,
    keep: Callable[[Step], object] | None,
    *,
    alternatives: bool = True,
) -> History:
    known = first if first is not None else rank(base, extra, criteria=criteria, workers=workers)
    history = History([Step("", base, tuple(known))])
    separate = separate_values(base, known, extra, criteria)
    if separate is not None:
        freed = rank(separate.fit, extra, criteria=criteria, workers=workers)
        change = f"+{', '.join(separate.parameter.names)} per recording"
        history.append(Step(change, separate.fit, tuple(freed)))
        if keep is not None:
            keep(history[-1])
    for step in range(most):
        chosen = best(history[-1].candidates, criteria)
        if chosen is None or chosen.fit is None:
            break
        if chosen.effect is START:
            history.stopped = (
                "errors of the starts of the rotor windows explain the residuals; "
                "state their uncertainty with `import --start-u`"
            )
            break
        if _may_be_random(history, chosen, chosen.fit, criteria):
            history.stopped = (
                f"a random torque describes the remainder as well as {chosen.effect.name}, which is not added"
            )
            break
        two = (
            _of_determined(history[-1], chosen, chosen.fit, extra, criteria, workers) if alternatives else []
        )
        try:
            known_steps = len(history)
            for following in two or _steps(history, chosen, chosen.fit, extra, criteria, workers):
                history.append(following)
                if keep is not None:
                    keep(following)
            if len(history) == known_steps:
                break
        except FittingError as error:
            history.stopped = f"{chosen.effect.name}: {error.message}"
            break
        if progress is not None:
            progress(step + 1, None)
    return history


def _of_determined(
    last: Step,
    chosen: Candidate,
    found: Fit,
    extra: Sequence[Effect],
    criteria: Criteria,
    workers: WorkerPool | None,
) -> Sequence[Step]:
    """Return steps that add two effects instead of `chosen`, whose refit is `found` and whose strength is undetermined.

    The shape of one law may imitate the sum of two laws. The steps are returned if the two effects do not raise BIC.
    """
    if not reason_undetermined(chosen.effect, found, criteria):
        return []
    others = [
        c for c in last.candidates if c.fit is None or not reason_undetermined(c.effect, c.fit, criteria)
    ]
    steps: Sequence[Step] = []
    with attempt("two effects of determined strength"):
        steps = _improved(last.fit, extra, criteria, 2, None, others, workers, None, alternatives=False)[1:]
    return steps if len(steps) > 1 and steps[-1].fit.bic <= found.bic else []


def _steps(
    history: Sequence[Step],
    chosen: Candidate,
    found: Fit,
    extra: Sequence[Effect],
    criteria: Criteria,
    workers: WorkerPool | None,
) -> Iterator[Step]:
    """Yield the step that adds a candidate with the refit `found`, and the step that also frees its shape constant."""
    converged = _refined(found, criteria)
    # a search at a new noise level may end in a worse minimum; this is most frequent for an oscillation with dry
    # friction
    found = converged if converged.bic < found.bic + criteria.evidence else found
    if found.bic > history[-1].fit.bic - criteria.evidence:
        return
    replaced = [n for n in history[-1].fit.model.names if n not in found.model.names]
    newest = Step(" -".join([f"+{chosen.effect.name}", *replaced]), found, ())
    last = _backward([*history, newest], criteria)
    try:
        candidates = rank(last.fit, extra, criteria=criteria, workers=workers)
    except FittingError:
        yield last
        raise
    yield replace(last, candidates=tuple(candidates))
    general = _with_free_shape(last.fit, chosen, candidates, criteria)
    if general is None:
        return
    symbol = general.model.effects[general.model.names.index(chosen.effect.name)].parameters[-1].symbol
    candidates = rank(general, extra, criteria=criteria, workers=workers)
    yield Step(f"+{chosen.effect.name}.{symbol}", general, tuple(candidates))


def _may_be_random(history: Sequence[Step], chosen: Candidate, found: Fit, criteria: Criteria) -> bool:
    """Return whether a random torque describes the data as well as a further effect, for a fit without a lack of fit.

    The first effect is excluded, because the diagnosis tests it. Oscillations are excluded.
    """
    before = history[-1].fit
    first = before.model.names == history[0].fit.model.names
    if first or before.fails(criteria) or not are_smooth(d.motion for d in before.problem.data):
        return False
    random = with_random_torque(before, criteria)
    tests = len(history[-1].candidates)
    return describes(random, criteria) and not is_established(random, chosen.screened, found, tests, criteria)


def _backward(history: Sequence[Step], criteria: Criteria) -> Step:
    """Drop effects that the newest effect makes unnecessary.

    If many effects were added, each effect is omitted in a separate fit, because several wrong effects can imitate a
    right effect that is added last.
    """
    newest = history[-1]
    change, current = newest.change, newest.fit
    base_names = set(history[0].fit.model.names)
    while True:
        added = [e for e in current.model.effects if e.name not in base_names and e.amplitude is not None]
        droppable = [
            e
            for e in added
            if not newest.adds(e)
            and (len(added) >= criteria.crowded or not _is_essential(current, e, criteria))
        ]
        tried = ((e, _without(current, e)) for e in droppable)
        dropped = next(((e, found) for e, found in tried if found and found.bic < current.bic), None)
        if dropped is None:
            return newest if current is newest.fit else Step(change, current, ())
        change, current = f"{change} -{dropped[0].name}", dropped[1]


def _is_essential(fitted: Fit, effect: Effect, criteria: Criteria) -> bool:
    """Return whether the strength of an effect is significantly different from zero in some case."""
    key = f"{effect.name}.{effect.amplitude.symbol}" if effect.amplitude else ""
    found = [e for k, e in fitted.estimates.items() if k.partition("@")[0] == key]
    return any(not np.isfinite(e.stderr) or abs(e.value) > criteria.essential_sigma * e.stderr for e in found)


def _without(fitted: Fit, effect: Effect) -> Fit | None:
    """Return the fit without an effect; None if the motion cannot be computed without it (a drive)."""
    with attempt("without an effect that may be unnecessary"):
        return fit(fitted.model.without(effect.name), fitted, start=fitted.values, noise=fitted.noise)
    return None


_EXCHANGES = 3
"""Largest number of refits of exchanges for one step [1]. Chosen: with fewer refits, the ranking by linearised fits
decides; with more, the search takes longer."""


def _exchanged(history: Sequence[Step], extra: Sequence[Effect], criteria: Criteria) -> Step | None:
    """Return the step that removes or exchanges an effect that was added; None if none lowers BIC enough.

    Only laws without a search for a frequency or a changepoint take part. Oscillations are excluded, as their refits
    take long.
    """
    current, names = history[-1].fit, history[0].fit.model.names
    added = [e for e in current.model.effects if e.name not in names and _is_friction(e)]
    if not added or current.model.restoring:
        return None
    effects = [e for e in applicable_effects(current, extra) if _is_friction(e)]
    known = {**laws_of(mechanism_of(current.model.effects)), **{e.name: e for e in extra}}
    cases = [CaseColumns(current, i) for i in range(len(current.problem.cases))]
    found: list[Exchange] = []
    for e in added:
        usual = [known[e.name]] if known.get(e.name, e) != e else []
        found += exchanges(current, e, [*usual, *effects], cases, criteria)
    found.sort(key=lambda x: round(x.delta_bic, _TIE))
    fits = {x.change: refitted for x in found[:_EXCHANGES] if (refitted := x.refit(current)) is not None}
    change = min(fits, key=lambda k: round(fits[k].bic, _TIE), default=None)
    if change is None:
        return None
    end = _refined(fits[change], criteria)
    # a lower noise level causes a part of the fall
    fall = current.bic - end.bic - max(current.deviance - deviance_at_noise_of(current, end), 0.0)
    if not current.fails(criteria):
        # the fall must also remain if both models have their most likely random torque
        old, new = (f.bic - f.deviance + with_random_torque(f, criteria).deviance for f in (current, end))
        fall = min(fall, old - new)
    if fall < criteria.evidence:
        return None
    return Step(change, end, (), is_exchange=True)


def _is_friction(effect: Effect) -> bool:
    return effect.kind == "physical" and effect.mechanical and not (effect.periodic or needs_search(effect))


_DRAWS = 2
"""Number of null data sets for a score that only gives an initial value [1]. Chosen: the p-value is not used; a larger
number costs time; with one data set, the spread of the scores is undefined."""


def needs_search(effect: Effect) -> bool:
    """Return whether chi-square has many minima because the effect has a frequency or a changepoint."""
    roles = {p.role for p in effect.parameters}
    return {"phase", "shape"} <= roles or bool(effect.breakpoint)


def found_starts(base: Fit, effects: Sequence[Effect]) -> dict[str, float]:
    """Return initial values of the parameters of effects that are added to a fitted model, by their names in a fit.

    An effect that the base absorbs has no initial values.
    """
    cases = [CaseColumns(base, i) for i in range(len(base.problem.cases))]
    values: dict[str, float] = {}
    for s in score(base, effects, cases, base.criteria, draws=_DRAWS):
        if s.absorbed:
            continue
        if s.own_phase:
            # the fit decides whether strength and phase are common to all cases
            values |= initial_values_of(base, with_common_phase(s)) | initial_values_of(base, s)
            continue
        found = refit(base, s, base.criteria) if s.effect.breakpoint else None
        values |= (
            initial_values_of(base, s)
            if found is None
            else {k: e.value for k, e in _own_estimates(found, s.effect).items()}
        )
    return values
