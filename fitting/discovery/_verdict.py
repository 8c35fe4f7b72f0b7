"""The answer: verdict, sentences, and the sequence of steps that leads to them.

    rank (score, refine) -> select -> lack of fit -> grade -> verdict

The input of each step is the result of the previous step. Two steps repeat the search once: `select` ranks the
candidates again at the noise of the best candidate, and `with_free_inertia` ranks them with a free ratio of the moments
of inertia.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from textwrap import wrap
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fitting._criteria import Criteria
from fitting._display import (
    block,
    draw_candidates,
    draw_torque,
    figure,
    figure_of,
    headline,
    printable,
    table,
)
from fitting._numbers import (
    format_torque,
    percentage,
    plain,
    probability,
    rounded,
    short,
    stated_probability,
    typeset,
    unit_text,
)
from fitting._workers import Task, WorkerPool, single_blas_thread
from fitting.discovery._difference import DifferentParameter
from fitting.discovery._drive import unrecorded_drive
from fitting.discovery._lack_of_fit import (
    HarmonicTest,
    contradiction,
    is_unknown,
    nonparametric_rivals,
)
from fitting.discovery._measurement import slip_estimates
from fitting.discovery._named_effect import (
    FormTest,
    InertiaRival,
    inertia_within_uncertainty,
    reselected,
    with_free_inertia,
)
from fitting.discovery._next_run import separating_run
from fitting.discovery._power import HiddenEffects, UpperLimit, largest_hidden
from fitting.discovery._random_torque import RandomTorque, describes, is_established, with_random_torque
from fitting.discovery._remainder import Grade, Nuisance, Remainder, grade, nuisance_parameters
from fitting.discovery._residuals import (
    Failure,
    ResidualTorque,
    Whiteness,
    find_failures,
    residual_torques,
    whiteness,
)
from fitting.discovery._score import Score
from fitting.discovery._select import (
    Candidate,
    Selection,
    Step,
    rank,
    reason_undetermined,
    select,
    separate_values,
)
from fitting.effects._effect import Effect
from fitting.effects._library import SLIP, START
from fitting.inference._angle_harmonics import AngleHarmonics, angle_harmonics
from fitting.inference._budget import combined_uncertainties
from fitting.inference._fit import measured_with
from fitting.inference._oscillation import are_smooth
from fitting.inference._params import Estimate
from fitting.inference._periodogram import PeriodogramPeak
from fitting.inference._result import Fit
from fitting.inference._slips import Slip
from fitting.inference._smooth_test import SmoothTest
from fitting.inference._trace import Refit, recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_CANDIDATES = 10
"""Number of candidates that a notebook shows [1]. Chosen: a smaller number hides alternatives, a larger one makes a
long table."""
_IN_REPR = 8
"""Largest number of lines of the sentence, and of candidates, in a repr [1]. Chosen: a smaller number hides
alternatives, a larger one fills the console."""
_WIDTH = 100
"""Width of a repr [characters]. Chosen: it fits into usual consoles; a larger width wraps there, a smaller one cuts
sentences."""


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """The lack of fit of a model, and the candidate effects.

    Attributes
    ----------
    fit : Fit
        The diagnosed fit.
    verdict : {"adequate", "missing_effect", "unexplained", "undecided"}
        The answer. "undecided": no effect is established, because the best effect is not determined, or because a
        random torque describes the data as well as the effect.
    sentence : str
        The answer in words.
    failures : tuple of Failure
        Intervals and harmonics with significant unmodelled torque, most significant first.
    candidates : tuple of Candidate
        Candidate effects, best first.
    form : {"exact", "approximate", None}
        "exact": with the named effect or equivalence class no remainder is significant, and the test of the form would
        detect a deviation as large as an approximate answer allows. "approximate": a remainder is significant, but the
        effect explains at least `Criteria.explained` of the unmodelled torque. None has three possible reasons: no
        single effect explains this share; no remainder is significant, but the data cannot test the form; the verdict
        is not "missing_effect".
    explained : float or None
        Share of the mean square unmodelled torque that the best effect explains (0-1); None without a best effect. If
        the effect changes only a shape constant of a law of the model, and the base absorbs most of this law, the share
        refers to the torque of the law.
    remainder : Remainder or None
        The remainder that is still significant with the best effect.
    nuisance : tuple of Nuisance
        Nuisance camera effects with their values.
    next_experiment : str
        The measurement that separates the rivals; empty if there are none.
    torques : tuple of ResidualTorque
        The unmodelled torque, as curves with bands.
    ripples : tuple of AngleHarmonics
        Harmonics of the unmodelled torque in the angle of the casing, with bands.
    whiteness : tuple of Whiteness
        Tests of the independence of the residuals.
    upper_limits : tuple of UpperLimit
        Physical effects that could still be hidden, with their largest torques, if the verdict is "adequate".
    without_limit : tuple of str
        Physical effects that the recordings do not limit, if the verdict is "adequate": the model absorbs them, or the
        upper limit exceeds the torque of the bearing (of a single body: the net torque).
    form_limit : float or None
        Rms deviation from the named law that would be detected with 90 % probability, as a share of its torque; None
        if the form was not tested or no deviation would be detected.
    differs : DifferentParameter or None
        The shared parameter whose per-recording values explain the lack of fit without another effect; the verdict is
        then "unexplained".
    trace : tuple of Refit
        Every fit of the search in the order in which they ended: purpose, model, and result or reason of the failure.
        Empty for a diagnosis that was read from a file.
    """

    fit: Fit
    verdict: str
    sentence: str
    failures: tuple[Failure, ...]
    candidates: tuple[Candidate, ...]
    form: str | None
    explained: float | None
    remainder: Remainder | None
    nuisance: tuple[Nuisance, ...]
    next_experiment: str
    torques: tuple[ResidualTorque, ...]
    ripples: tuple[AngleHarmonics, ...]
    whiteness: tuple[Whiteness, ...]
    upper_limits: tuple[UpperLimit, ...] = ()
    without_limit: tuple[str, ...] = ()
    form_limit: float | None = None
    differs: DifferentParameter | None = None
    trace: tuple[Refit, ...] = ()

    def __repr__(self) -> str:
        shown = [f"  {c!r}"[:_WIDTH] for c in self.candidates[:_IN_REPR]]
        more = len(self.candidates) - len(shown)
        sentence = wrap(self.sentence, _WIDTH)
        if len(sentence) > _IN_REPR:
            sentence = [*sentence[: _IN_REPR - 1], "..."]
        lines = [f"diagnosis: {self.verdict}", *sentence, *(["candidates"] if shown else []), *shown]
        return "\n".join([*lines, *([f"  ... {more} more"] if more else [])])

    def plot(self, ax: Axes | None = None, *, case: int = 0) -> Figure:
        """Draw the unmodelled torque with its band, the intervals of lack of fit, and the candidates (matplotlib).

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes for the unmodelled torque of one case; by default a new figure shows all cases and the candidates.
        case : int
            Index of the case that is drawn on `ax`.

        Returns
        -------
        matplotlib.figure.Figure
            The new figure, or the figure of `ax`.
        """
        labels = list(dict.fromkeys(t.label for t in self.torques))
        if ax is not None:
            self._draw_torque(ax, labels[case])
            return figure_of(ax)
        shown = [c for c in self.candidates if c.score > 0][:_MOST_CANDIDATES]
        drawn = figure(9.0, 2.6 * len(labels) + 0.35 * len(shown) + 1.2)
        heights = [2.6] * len(labels) + ([0.35 * len(shown) + 0.7] if shown else [])
        axes = drawn.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
        for panel, label in zip(axes, labels, strict=False):
            self._draw_torque(panel, label)
        if shown:
            draw_candidates(
                axes[-1],
                [self.fit.name(c.effect).words for c in shown],
                [c.score for c in shown],
                significant=[c.significant for c in shown],
                physical=[c.physical for c in shown],
            )
        return drawn

    def _draw_torque(self, ax: Axes, label: str) -> None:
        body = next(d.record.body for d in self.fit.problem.data if d.record.label == label)
        draw_torque(
            ax,
            [
                (body if t.body == "casing" else t.body, t.time, t.torque, t.sigma)
                for t in self.torques
                if t.label == label
            ],
            [(f.t_start, f.t_stop) for f in self.failures if f.label == label],
            unit=unit_text(self.fit.torque_unit),
        )
        ax.set_title(printable(label) + ": unmodelled torque; yellow: significant lack of fit")
        ax.legend(fontsize="small", frameon=False)

    def _repr_html_(self) -> str:
        failures = [
            (
                f.label,
                f.called,
                " – ".join(f.times),
                short(f.residual_torque_Nm),
                short(f.residual_rad_s, 2),
                f"{f.size_sigma:.0f}",
            )
            for f in self.failures
        ]
        candidates = [
            (
                str(self.fit.name(c.effect)) + ("" if c.physical else ", measurement effect"),
                short(c.score),
                short(c.delta_bic),
                probability(c.p_value),
                "; ".join(self.fit.name(n).words for n in c.indistinguishable_from) or "–",
            )
            for c in self.candidates[:_MOST_CANDIDATES]
            if c.score > 0
        ]
        parts = [headline(self.verdict, typeset(self.sentence))]
        if failures:
            where = (
                "case",
                "body",
                "time [s]",
                f"torque [{unit_text(self.fit.torque_unit)}]",
                "speed [rad/s]",
                "σ",
            )
            parts.append(table("significant lack of fit", where, failures))
        if candidates:
            columns = (
                "effect",
                "improvement of χ²",
                "ΔBIC",
                "false-alarm probability",
                "indistinguishable from",
            )
            title = "tested, not needed" if self.verdict == "adequate" else "candidate effects"
            parts.append(table(title, columns, candidates))
        if self.next_experiment:
            parts.append(f"<p><b>Next experiment.</b> {escape(self.next_experiment)}</p>")
        return block(*parts)


@single_blas_thread()
def diagnose(
    fit: Fit,
    extra: Sequence[Effect] = (),
    *,
    criteria: Criteria | None = None,
    candidates: Sequence[Candidate] | None = None,
    history: Sequence[Step] = (),
    workers: WorkerPool | None = None,
    brief: bool = False,
) -> Diagnosis:
    """Return the lack of fit of a model and the missing effect.

    Parameters
    ----------
    fit : Fit
        The fit to diagnose.
    extra : sequence of Effect
        Effects of the user, in addition to the library.
    criteria : Criteria, optional
        Thresholds of every decision; by default the criteria of the fit. If the criteria of the noise differ from those
        of the fit, the fit is repeated first, and `candidates` and `history` are ignored.
    candidates : sequence of Candidate, optional
        The ranking of the candidates about the fit, if it exists.
    history : sequence of Step
        The steps of `improve` from the fit, if they exist.
    workers : WorkerPool, optional
        Processes that share the work.
    brief : bool
        Omit results that the verdict does not depend on: curves, failing intervals, upper limits and the next run.

    Returns
    -------
    Diagnosis

    Raises
    ------
    FittingError
        If the fit cannot be evaluated.
    """
    criteria = criteria or fit.criteria
    with recording() as trace:
        measured = measured_with(fit, criteria)
        if measured is not fit:
            candidates, history = None, ()
        found = _diagnosis(measured, extra, criteria, candidates, history, workers, brief=brief)
    return replace(_with_findings(found), trace=tuple(trace.refits))


def _with_findings(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis with the measurement faults that are visible in the data without a model.

    Slipped turns become the first candidate, and the answer if the fit is otherwise adequate.
    """
    fit = found.fit
    if not fit.findings:
        return found
    slips = [s for d in fit.problem.data for s in d.slips]
    told = replace(found, sentence=" ".join([*fit.findings, found.sentence]))
    if not slips:
        return replace(told, verdict="unexplained") if found.verdict == "adequate" else told
    told = replace(told, candidates=(slipped(fit, slips), *found.candidates))
    if found.verdict != "adequate":
        return told
    return replace(told, verdict="missing_effect", form="exact", explained=1.0)


def slipped(fit: Fit, slips: Sequence[Slip]) -> Candidate:
    """Return slipped turns as a candidate.

    A step is 2 pi times the number of slipped turns. The score is half the sum of the squared steps, each divided by
    the smallest white noise of a sample.
    """
    sigma = min(
        r.scale * float(np.median(r.samples.sigma)) for d in fit.problem.data for r in (d.casing, *d.rotor)
    )
    score = sum((2 * math.pi * s.turns / sigma) ** 2 for s in slips) / 2
    none = np.zeros(0)
    screened = Score(SLIP, score, none, ({},), len(slips), 1, absorbed=False, direction=none, null=none)
    bic = len(slips) * math.log(fit.rows) - score
    return Candidate(
        SLIP, score, bic, 0.0, math.nan, (), slip_estimates(slips), significant=True, screened=screened
    )


def _diagnosis(
    fit: Fit,
    extra: Sequence[Effect],
    criteria: Criteria,
    candidates: Sequence[Candidate] | None,
    history: Sequence[Step],
    workers: WorkerPool | None,
    *,
    brief: bool,
) -> Diagnosis:
    workers = workers or WorkerPool(0)
    curves, harmonics = (
        (Task(list, None), Task(list, None))
        if brief
        else (workers.submit(residual_torques, fit), workers.submit(angle_harmonics, fit))
    )
    ranked = rank(fit, extra, criteria=criteria, workers=workers) if candidates is None else candidates
    separate = separate_values(fit, ranked, extra, criteria)
    if separate is not None:
        torques, ripples = curves.result(), harmonics.result()
        failures = find_failures(fit, torques, ripples, criteria)
        return Diagnosis(
            fit=fit,
            verdict="unexplained",
            sentence=f"{_opening(fit, failures, criteria)} {separate.parameter.sentence}",
            failures=tuple(failures),
            candidates=tuple(ranked),
            form=None,
            explained=None,
            remainder=None,
            nuisance=tuple(nuisance_parameters(separate.fit)),
            next_experiment="",
            torques=tuple(torques),
            ripples=tuple(ripples),
            whiteness=tuple(whiteness(fit)),
            differs=separate.parameter,
        )
    search = _Search(fit, ranked, tuple(extra), criteria, workers, history)
    found = search.graded()
    if search.suggests_two(found):
        both = search.of_determined().graded(follow_up=True)
        bic = found.size.unknown_bic if found.size.unknown else found.selection.final.bic
        is_named = not _undetermined(both.selection, criteria)
        found = both if is_named and _are_two_effects(both, bic, criteria) else found
    selection, as_given, rival, misfit, doubt, size = found
    if size.form is None and isinstance(doubt, PeriodogramPeak):
        # an effect that does not explain the sinusoidal torque is not part of the answer
        peak = fit.significant_peak(criteria)
        selection, doubt = (selection, doubt) if peak is None else (selection._replace(chosen=None), peak)
    verdict = _verdict(selection, size, criteria, significant=misfit or doubt is not None)
    complete = verdict == "missing_effect" and size.remainder is None
    # with process noise, the residuals of a driven motion may be consistent with noise although the drive is unknown
    drive = unrecorded_drive(selection.final if verdict == "missing_effect" else fit)
    within_uncertainty = (
        inertia_within_uncertainty(fit, _class_of(selection), criteria) if complete and not drive else ""
    )
    if within_uncertainty:
        verdict, size = "adequate", Grade(None, None, None)
    hint = drive or (_undetermined(selection, criteria) if verdict == "missing_effect" else "")
    random = None if hint else _random_alternative(fit, selection, verdict, doubt, criteria)
    noisy = (
        verdict == "adequate"
        and not (within_uncertainty or drive)
        and (fit.needs_random_torque(criteria) or fit.has_smooth_torque(criteria))
    )
    if noisy:
        random = with_random_torque(fit, criteria)
        # a random torque is an explanation only if its level is below the largest level that counts as noise
        random = random if random.is_raised and describes(random, criteria) else None
    if hint or noisy or random is not None:
        unexplained = random is None and (misfit or noisy or doubt is not None)
        verdict, size = "unexplained" if unexplained else "undecided", Grade(None, None, None)
    if verdict == "missing_effect":
        selection, size = _with_unknown_laws(fit, selection, as_given, size, criteria)
        selection = _with_values_of_final(selection)
    nuisance = nuisance_parameters(selection.final)
    torques, ripples = [] if fit.lacks_restoring_torque else curves.result(), harmonics.result()
    hidden = (
        largest_hidden(fit, extra, criteria, selection.candidates)
        if verdict == "adequate" and not brief
        else HiddenEffects()
    )
    failures = find_failures(fit, torques, ripples, criteria) if verdict != "adequate" and not brief else []
    # for an oscillation, camera effects are hardly distinguishable from harmonics of the motion
    told = nuisance if are_smooth(d.motion for d in fit.problem.data) else ()
    sentence = (
        _undecided(
            selection, random, hint, told, criteria, lack_of_fit=bool(hint) and fit.has_lack_of_fit(criteria)
        )
        if verdict == "undecided"
        else f"{drive} {_sentence(fit, verdict, selection, failures, doubt, size, told, criteria, hidden)}".strip()
    )
    return Diagnosis(
        fit=fit,
        verdict=verdict,
        sentence=f"{within_uncertainty or sentence} {rival.sentence(criteria) if rival is not None else ''}".strip(),
        failures=tuple(failures),
        candidates=tuple(selection.candidates),
        form=size.form if verdict == "missing_effect" else None,
        explained=size.explained,
        remainder=size.remainder,
        nuisance=tuple(nuisance),
        next_experiment=""
        if brief
        else separating_run(
            fit, [(c.effect.name, [c.effect], c.estimates) for c in _class_of(selection) if c.fit], criteria
        ),
        torques=tuple(torques),
        ripples=tuple(ripples),
        whiteness=tuple(whiteness(fit)),
        upper_limits=hidden.limits,
        without_limit=hidden.without_limit,
        form_limit=size.test.limit if size.test is not None and math.isfinite(size.test.limit) else None,
    )


class _Graded(NamedTuple):
    """A selection, its effect with the given moments of inertia, its tests, and its grade."""

    selection: Selection
    as_given: Candidate | None
    rival: InertiaRival | None
    misfit: bool
    doubt: SmoothTest | PeriodogramPeak | HarmonicTest | None
    size: Grade


class _Search(NamedTuple):
    """The ranked candidates for a fit, and the other inputs of the selection among them."""

    fit: Fit
    ranked: Sequence[Candidate]
    extra: tuple[Effect, ...]
    criteria: Criteria
    workers: WorkerPool
    history: Sequence[Step]

    def graded(self, *, follow_up: bool = False) -> _Graded:
        """Select an effect, test the most complete fit, and grade the effect."""
        fit, criteria = self.fit, self.criteria
        selection = select(
            fit, self.ranked, self.extra, criteria, self.workers, self.history, follow_up=follow_up
        )
        as_given = selection.chosen
        rival = with_free_inertia(fit, selection, self.extra, criteria)
        selection = selection if rival is None else reselected(selection, rival)
        misfit = selection.final.fails(criteria)
        doubt = _contradiction(fit, selection, criteria, misfit=misfit)
        size = _graded(fit, selection, doubt, rival, criteria, misfit=misfit)
        return _Graded(selection, as_given, rival, misfit, doubt, size)

    def of_determined(self) -> _Search:
        """Return the search without the refitted candidates whose strength is not determined."""
        ranked = [
            c for c in self.ranked if c.fit is None or not reason_undetermined(c.effect, c.fit, self.criteria)
        ]
        return self._replace(ranked=ranked)

    def suggests_two(self, found: _Graded) -> bool:
        """Return whether to search for a second effect: none was tried, and one effect does not suffice.

        One effect does not suffice in three cases. In the first case a smooth law of a speed describes the data better
        than the effect. In the other cases a test of lack of fit must be significant, because otherwise the second
        effect may be a tracking error. In the second case the strength of the effect is not determined: the shape of
        one law may imitate the sum of two laws. In the third case the score of a second effect about the fit with the
        first effect exceeds the threshold of `_are_two_effects`.
        """
        selection = found.selection
        end = selection.final
        if selection.chosen is None or end.model.names != selection.named.model.names:
            return False
        if found.size.unknown:
            return True
        is_smooth = are_smooth(d.motion for d in end.problem.data)
        if found.misfit or not is_smooth or not self.fit.has_lack_of_fit(self.criteria):
            return False
        if _undetermined(selection, self.criteria):
            return True
        log_rows = math.log(end.rows)
        return any(
            c.significant and c.score - c.screened.columns * log_rows > _needed(selection, self.criteria)
            for c in rank(end, self.extra, criteria=self.criteria, refitting=False)
        )


def _needed(selection: Selection, criteria: Criteria) -> float:
    """Return the needed fall of BIC for two effects.

    The second effect is the best of N effects, so its prior odds are 1:N.
    """
    return criteria.equivalence_width + 2 * math.log(max(len(selection.candidates), 1))


def _are_two_effects(found: _Graded, bic: float, criteria: Criteria) -> bool:
    """Return whether two effects describe the data completely, and clearly better than one law with this BIC."""
    selection = found.selection
    complete = not found.misfit and found.doubt is None and not found.size.unknown
    more = _has_more_effects(selection)
    return complete and more and selection.final.bic < bic - _needed(selection, criteria)


def _undetermined(selection: Selection, criteria: Criteria) -> str:
    """Return a sentence with the reason why a significant effect is only a hint; empty if the effect is named."""
    chosen = selection.chosen
    if chosen is None or chosen.effect is START:
        return ""
    why = reason_undetermined(chosen.effect, selection.named, criteria)
    return f"{why}, so {selection.final.name(chosen.effect)} is a hint only." if why else ""


def _random_alternative(
    fit: Fit,
    selection: Selection,
    verdict: str,
    doubt: SmoothTest | PeriodogramPeak | HarmonicTest | None,
    criteria: Criteria,
) -> RandomTorque | None:
    """Return the slow random torque that describes the data as well as the answer; None if no random torque does."""
    is_smooth = are_smooth(d.motion for d in fit.problem.data)
    # a torque periodic in an angle or in time is not a random torque
    periodic = isinstance(doubt, PeriodogramPeak | HarmonicTest)
    if verdict not in {"missing_effect", "unexplained"} or not is_smooth or periodic:
        return None
    chosen = selection.chosen
    if chosen is not None and chosen.effect in (START, SLIP):
        return None
    random = with_random_torque(fit, criteria)
    if not describes(random, criteria):
        return None
    if chosen is None and not random.is_raised:
        return None
    if chosen is not None and is_established(
        random, chosen.screened, selection.named, len(selection.candidates), criteria
    ):
        return None
    # if a law of a speed is missing, the residuals depend on this speed; the residuals of a random torque do not
    return random if random.fit.smooth_test.p_value > criteria.doubt_adequate else None


def _undecided(
    selection: Selection,
    random: RandomTorque | None,
    hint: str,
    nuisance: Sequence[Nuisance],
    criteria: Criteria,
    *,
    lack_of_fit: bool = False,
) -> str:
    """Return the sentence of the verdict "undecided"."""
    parts = [
        "Significant lack of fit, but no effect is established." if lack_of_fit else "Nothing is established."
    ]
    if hint:
        parts.append(hint)
    if random is not None:
        chosen = selection.chosen
        names = [] if chosen is None else _class_names(selection, chosen)
        rivals = f" as well as {'; '.join(names)}" if names else ""
        other = "a random torque"
        if random.noise.level > 0:
            words = f"{random.words[0].upper()}{random.words[1:]}"
            level = (
                "without the model the recording does not establish its level"
                if random.is_raised
                else "the recording shows this level without a model"
            )
            parts.append(f"{words} describes the data{rivals}; {level}.")
        else:
            other = "a chance agreement"
            parts.append(f"The noise of the angles alone describes the data{rivals}.")
        if chosen is not None:
            parts.append(f"Repeat the recording: a law returns with the same strength, {other} does not.")
    return " ".join([*parts, *_nuisance(selection.chosen, nuisance, criteria)])


def _contradiction(
    fit: Fit, selection: Selection, criteria: Criteria, *, misfit: bool
) -> SmoothTest | PeriodogramPeak | HarmonicTest | None:
    """Return the test that contradicts the final fit; None if there is none.

    If the fit has a significant lack of fit (`misfit`), only a sinusoidal torque in time counts.
    """
    if not misfit:
        return contradiction(selection.chosen, selection.final, criteria)
    # a sinusoidal torque in time is neither noise nor an effect of the library
    any_lines = any(d.spectral_lines for d in fit.problem.data)
    return selection.final.significant_peak(criteria) if any_lines else None


def _graded(
    fit: Fit,
    selection: Selection,
    doubt: SmoothTest | PeriodogramPeak | HarmonicTest | None,
    rival: InertiaRival | None,
    criteria: Criteria,
    *,
    misfit: bool,
) -> Grade:
    """Return the grade of the chosen effect.

    An error of the moments of inertia or excess process noise may change its form.
    """
    size = grade(fit, selection, doubt, criteria, misfit=misfit)
    if rival is not None and rival.better and size.form is not None:
        # an error of inertia within the stated uncertainty is not a remainder
        allowed_error = rival.is_allowed(criteria) and not misfit and doubt is None
        size = (
            replace(size, form="exact", explained=1.0, remainder=None)
            if allowed_error
            else replace(size, form="approximate")
        )
    if size.form == "exact" and selection.final.has_excess_noise(criteria):
        # the agreement with the data may be due to the excess process noise instead of the law
        size = replace(size, form=None, noisy=True)
    return size


def _with_unknown_laws(
    fit: Fit, selection: Selection, as_given: Candidate | None, size: Grade, criteria: Criteria
) -> tuple[Selection, Grade]:
    """Return selection and grade with the laws outside the library that describe the data as well as the chosen effect.

    These laws are compared with `as_given`, the candidate with the given moments of inertia, if it is the same effect.
    """
    chosen = selection.chosen
    if as_given is not None and chosen is not None and as_given.effect is chosen.effect:
        chosen = as_given
    rivals = size.rivals
    if size.form != "approximate" or not rivals:
        rivals = (*rivals, *nonparametric_rivals(fit, chosen, size.test, criteria))
    if rivals and size.form == "exact":
        size = replace(size, form=None)
    return _with_rivals(selection, rivals), size


def _verdict(selection: Selection, size: Grade, criteria: Criteria, *, significant: bool) -> str:
    """Return "adequate", "missing_effect" or "unexplained" from the effect size and the significance."""
    if selection.chosen is None:
        return "unexplained" if significant else "adequate"
    if any(
        k.startswith(f"{selection.chosen.effect.name}.") for k in selection.named.undetermined_at(criteria)
    ):
        return "unexplained"
    if size.form is not None or (size.remainder is None and not significant):
        return "missing_effect"
    if significant or (size.explained is not None and size.explained < 1 - criteria.explained):
        return "unexplained"
    # with a second effect of the library the answer is complete; without one, the law has a shape outside the library
    return "missing_effect" if _has_more_effects(selection) else "unexplained"


def _with_rivals(selection: Selection, rivals: tuple[str, ...]) -> Selection:
    if selection.chosen is None or not rivals:
        return selection
    own = selection.chosen.indistinguishable_from
    others = dict.fromkeys(n for n in (*own, *rivals) if n != selection.chosen.effect.name)
    chosen = replace(selection.chosen, indistinguishable_from=tuple(others))
    ranked = [chosen if c is selection.chosen else c for c in selection.candidates]
    return selection._replace(candidates=ranked, chosen=chosen)


def _has_more_effects(selection: Selection) -> bool:
    """Return whether the final fit contains the chosen effect and further effects."""
    return set(selection.final.model.names) > set(selection.named.model.names)


def _with_values_of_final(selection: Selection) -> Selection:
    """Return the selection with the parameters of the chosen effect from the final fit if it contains further effects.

    The fit with the chosen effect alone is biased by the effects that it lacks.
    """
    chosen, final = selection.chosen, selection.final
    if chosen is None or not _has_more_effects(selection):
        return selection
    own = {k: e for k, e in final.estimates.items() if k.startswith(f"{chosen.effect.name}.")}
    if not own:
        return selection
    complete = replace(chosen, estimates=own)
    ranked = [complete if c is chosen else c for c in selection.candidates]
    return selection._replace(candidates=ranked, chosen=complete)


def _class_of(selection: Selection) -> list[Candidate]:
    """Return the chosen candidate and the candidates that are indistinguishable from it."""
    chosen = selection.chosen
    if chosen is None:
        return []
    return [chosen, *(c for c in selection.candidates if c.effect.name in chosen.indistinguishable_from)]


def _sentence(
    fit: Fit,
    verdict: str,
    selection: Selection,
    failures: Sequence[Failure],
    doubt: SmoothTest | PeriodogramPeak | HarmonicTest | None,
    size: Grade,
    nuisance: Sequence[Nuisance],
    criteria: Criteria,
    hidden: HiddenEffects,
) -> str:
    """Return the answer in a few sentences."""
    if verdict == "adequate":
        # if the measurement has a fault, the sentence does not call the model adequate
        answer = "nothing else is missing" if fit.findings else "the model is adequate"
        parts = [f"The residuals are consistent with noise; {answer}."]
        if hidden.limits:
            unit = fit.torque_unit
            limits = "; ".join(
                f"{fit.name(u.effect)} {format_torque(u.torque_Nm, unit=unit)}" for u in hidden.limits
            )
            parts.append(
                f"Effects that could still be hidden, with 95 % upper limits of the rms torque: {limits}."
            )
            if hidden.without_limit:
                parts.append(f"No useful limit: {'; '.join(str(fit.name(e)) for e in hidden.without_limit)}.")
        else:
            parts.append(
                "The recording is too short or too noisy for a useful upper limit of another effect."
            )
    else:
        parts = [_opening(fit, failures, criteria, selection.chosen)]
        parts += (
            _unexplained(selection, doubt, size, criteria)
            if verdict == "unexplained"
            else _missing(selection, size, criteria)
        )
        parts += _active_bounds(selection.final if verdict == "missing_effect" else fit)
    return " ".join([*parts, *_nuisance(selection.chosen, nuisance, criteria)])


def _opening(
    fit: Fit, failures: Sequence[Failure], criteria: Criteria, added: Candidate | None = None
) -> str:
    """Return a sentence on the lack of fit; without one, it contains the p-value of an added effect."""
    if fit.has_lack_of_fit(criteria):
        return f"Significant lack of fit{f': {failures[0]}' if failures else ''}."
    but = "" if added is None else f", but an added effect is ({stated_probability(added.p_value)})"
    return f"No test of lack of fit is significant{but}."


def _unexplained(
    selection: Selection,
    doubt: SmoothTest | PeriodogramPeak | HarmonicTest | None,
    size: Grade,
    criteria: Criteria,
) -> list[str]:
    chosen = selection.chosen
    name = "" if chosen is None else selection.final.name(chosen.effect)
    nothing = _nothing_explains(selection)
    if isinstance(doubt, PeriodogramPeak):
        after = "" if chosen is None else f" after {name}"
        return [
            f"The residual torque{after} {doubt.words} (p = {doubt.p_value:.1g}).",
            f'{nothing}: add "{doubt.law}" as a hypothesis and diagnose again.',
        ]
    if chosen is not None and size.explained is not None and size.remainder is not None and size.unknown:
        share = f"{percentage(max(size.explained, 0.0))} of the mean square unmodelled torque"
        closest = f"the closest one, {name}, with {share}"
        return [
            f"No effect of the library explains it: a smooth law of {size.unknown} explains more than {closest}.",
            "`gyrotrack laws` lists such laws.",
            size.remainder.sentence,
        ]
    if chosen is not None and size.explained is not None and size.remainder is not None:
        if size.explained < 1 - criteria.explained:
            # a wrong law explains a similar share, so the effect is not stated as a hypothesis
            return [
                f"No effect of the library explains more than {percentage(1 - criteria.explained)} of it.",
                size.remainder.sentence,
                "Check the tracking and the noise of the angle; `gyrotrack laws` searches beyond the library.",
            ]
        share = f"{percentage(size.explained)} of the mean square unmodelled torque"
        # the share would suffice if the strength of the effect were determined
        but = ", but with an undetermined strength" if size.form is not None else ""
        return [
            f"No effect of the library explains it; the closest, {name}, explains {share}{but}.",
            size.remainder.sentence,
            f"A second effect is missing, or a law that is not in the library: {name} is a hypothesis.",
        ]
    if doubt is not None:
        return [
            f"The residual torque {doubt.words} (p = {doubt.p_value:.1g}).",
            f"{nothing}.",
        ]
    level = max((n.level for n in selection.final.noise), default=0.0)
    if not level > 0:
        return [
            f"{nothing}, and no random torque describes it.",
            "Check the tracking and the noise of the angle.",
        ]
    unit = selection.final.torque_unit
    rest = f"{nothing[0].lower()}{nothing[1:]}"
    return [f"An unexplained torque of {format_torque(level, unit=unit)} rms remains; {rest}."]


def _nothing_explains(selection: Selection) -> str:
    """Return the beginning of a sentence: no effect of the library explains the data, or no effect was fitted.

    For an oscillation with hundreds of reversals, candidates are scored but not refitted.
    """
    waiting = max((c for c in selection.candidates if c.significant), key=lambda c: c.score, default=None)
    if waiting is None or any(c.fit is not None for c in selection.candidates):
        return "No effect of the library explains it"
    name = selection.final.name(waiting.effect)
    return f"No effect of the library was fitted to it (`gyrotrack improve` begins with {name})"


def _missing(selection: Selection, size: Grade, criteria: Criteria) -> list[str]:
    chosen = selection.chosen
    if chosen is None:
        return []
    names = _class_names(selection, chosen)
    if chosen.effect is START:
        return _start_errors(chosen, names[1:])
    what = "Missing" if chosen.physical else "Fault of the measurement"
    close = "a law close to " if size.form == "approximate" else ""
    strength = _strength(chosen, selection.final if _has_more_effects(selection) else chosen.fit)
    if names[1:] and all(map(is_unknown, chosen.indistinguishable_from)):
        others = ", or ".join(names[1:])
        parts = [f"{what}: {close}{names[0]}{strength}, or {others}; these data cannot separate them."]
    elif len(names) == 1:
        parts = [f"{what}: {close}{names[0]}{strength}."]
    else:
        one = f"{close}one of these effects, which these data cannot separate"
        parts = [f"{what}: {one}: {'; '.join(names)}."]
    if chosen.own_phase:
        keys = dict.fromkeys(k.partition("@")[0] for k in chosen.estimates if "@" in k)
        parts.append(
            f"Each case has its own strength and phase: add {' '.join(f'--per-case {k}' for k in keys)} to `fit`."
        )
    if size.remainder is not None:
        parts.append(size.remainder.sentence)
    elif size.noisy:
        most = max(selection.final.noise, key=lambda n: n.level - n.pure)
        needed, shown = (format_torque(x, unit=selection.final.torque_unit) for x in (most.level, most.pure))
        parts.append(
            f"The form is not established: the fit needs a random torque of {needed} rms, the recording shows {shown}."
        )
    elif size.form is None and size.test is not None:
        parts += _untested(size.test, criteria)
    return parts


def _class_names(selection: Selection, chosen: Candidate) -> list[str]:
    """Return the chosen effect and the effects indistinguishable from it, in words with their keys."""
    known = {c.effect.name: c.effect for c in selection.candidates}
    alike = [known.get(n, n) for n in chosen.indistinguishable_from]
    return [str(selection.final.name(e)) for e in (chosen.effect, *alike)]


def _start_errors(chosen: Candidate, others: Sequence[str]) -> list[str]:
    """Return the answer that the start times of rotor windows may be wrong; their uncertainty is not stated."""
    errors = [e.value for e in chosen.estimates.values()]
    rms = 1e3 * math.sqrt(sum(x**2 for x in errors) / len(errors))
    sentence = (
        f"Errors of the starts of the rotor windows (camera.start) of {rms:.2g} ms rms explain it; their uncertainty "
        "is not stated: import the recording with --start-u."
    )
    if not others:
        return [sentence]
    return [sentence, f"No effect is established; these data cannot separate them from: {'; '.join(others)}."]


def _untested(test: FormTest, criteria: Criteria) -> list[str]:
    """Return the reason why the form of a law is not established although the residuals are consistent with noise."""
    if test.is_strong(criteria):
        return []  # this reason is stated with the rivals
    if test.bounds_p <= criteria.doubt_named:
        pulled = f"the fit prefers {', '.join(test.bounds)} outside its bounds"
        return [f"The form is not established: {pulled} ({stated_probability(test.bounds_p)})."]
    if not math.isfinite(test.limit):
        return ["The form is not established: the other parameters absorb every deviation from this law."]
    if test.limit >= 1:
        return ["The form is not established: any law of similar size and shape would fit equally well."]
    limit = f"{100 * test.limit:.2g} % of the torque of the law"
    return [f"The form is not established: only a deviation above {limit} would be detected."]


def _active_bounds(fit: Fit) -> list[str]:
    """Return a sentence with the parameters at an arbitrary bound; empty if there is none."""
    layout = fit.problem.layout
    at_bound = [
        f"{name} = {e.value:.4g}"
        for name, e in fit.estimates.items()
        if e.at_bound and name in layout.index and not layout.is_physical_bound(name)
    ]
    return [f"Active bound: {', '.join(at_bound)}; outside it, another law may act."] if at_bound else []


def _capital(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


_PER_MILLI = {"rad": 1e3, "s": 1e3, "s2": 1e6}
"""Thousandths in one unit, by unit [1]. Derived: 1000, and its square for a squared time."""


def _nuisance(chosen: Candidate | None, found: Sequence[Nuisance], criteria: Criteria) -> list[str]:
    # camera effects are not reported if an angle-dependent torque is missing, because this torque changes their fitted
    # values
    if chosen is not None and chosen.effect.depends_on_angle:
        return []
    return [
        f"{_capital(n.words)} {n.value * _PER_MILLI[n.unit]:.2g} m{n.unit} (nuisance parameter, fitted)."
        for n in found
        if len(found) * n.p_value < criteria.significance
    ]


def _strength(c: Candidate, fit: Fit | None) -> str:
    """Return the strength of a candidate with its combined uncertainty in the fit that determines this strength."""
    if c.effect.amplitude is None:
        return ""
    symbol = c.effect.amplitude.symbol
    found = {k: e for k, e in c.estimates.items() if k.partition("@")[0].endswith(f".{symbol}")}
    total = combined_uncertainties(fit) if fit is not None and found else {}
    stated = [_with_both(e, total.get(k, e.stderr)) for k, e in found.items()]
    return f", {symbol} = {', '.join(stated)}" if stated else ""


_MOSTLY_STATISTICAL = 0.05
"""Relative excess of the combined uncertainty over the statistical uncertainty above which both are stated [1]. Chosen:
a smaller value repeats equal numbers, a larger one hides systematic parts."""


def _with_both(e: Estimate, total: float) -> str:
    """Return a value with its combined standard uncertainty, and the statistical part if that is clearly smaller."""
    text = rounded(e.value, total, e.unit)
    if not total > (1 + _MOSTLY_STATISTICAL) * e.stderr:
        return text
    return f"{text} (statistical part {plain(e.stderr)} {e.unit})"
