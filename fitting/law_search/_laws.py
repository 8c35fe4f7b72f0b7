"""Search for a formula outside the library that explains the unmodelled torque.

    grammar -> score -> refit -> score about the best refit -> refit -> equivalence set

1. All laws of the grammar, each at many values of its shape constants, are scored together about the base
   (`_score`: matrix products). Null data are searched in the same way. The family-wise p-value is calibrated by the
   smallest p-value of all laws in each null data set; it therefore accounts for the number of laws.
2. The laws with the highest scores are refitted with the base. A law of a few per cent of the torque changes the motion
   by more than the noise, so scores about the base are inaccurate. Therefore all laws are scored again about the best
   refit, with its law removed from the model. The residual is then

       r' = z - rows(theta) + W u_law,

   with the data z, the parameters theta of the refit, and the response W u_law to the removed law. With this residual,
   the motion must be linear only in the difference of two laws. With the residual of the base, it would have to be
   linear in the whole law. Shape constants are refined on these scores.
3. The best laws of the second search are refitted at the same noise and ranked by BIC plus the description length of
   the formula. If any of these laws is significant, the answer is a set: every law within `Criteria.equivalence_width`
   of the best law belongs to it. Two formulas of the set have the same torque along the recorded motion if the deviance
   that would separate them is small:

       |M (x - y)|^2 < `Criteria.evidence`,

   where x and y are the rows that the two formulas predict, and M projects out the nuisance parameters. Such formulas
   are grouped. The groups show how many torques the data cannot separate, and how many formulas describe each torque.
4. If the best fit has a significant lack of fit, a second law is searched for in the same way, starting from this fit.

An effect of the library that describes the data as well as a law is named first. A shared parameter of the base is also
named first if separate values in the recordings describe the data better than any law.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from textwrap import wrap
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT, Criteria
from fitting._numbers import format_torque, on_screen, rounded
from fitting._workers import WorkerPool, single_blas_thread
from fitting.discovery._dependence import Dependence, context_without, dependence, torque_rows
from fitting.discovery._difference import (
    DifferentParameter,
    SeparateValues,
    different_parameter,
    improves_on_difference,
    penalised,
)
from fitting.discovery._grammar import LawForm, grammar
from fitting.discovery._lack_of_fit import UNKNOWN_LAWS
from fitting.discovery._next_run import separating_run
from fitting.discovery._refine import initial_values_of, refined, refitted_at
from fitting.discovery._remainder import ranges_of
from fitting.discovery._score import (
    CaseColumns,
    FamilywiseNull,
    NullDistribution,
    Score,
    ScoreContext,
    best_group,
    score,
    score_of_columns,
    stacked,
)
from fitting.discovery._select import Candidate, applicable_effects, rank
from fitting.discovery._select import best as best_candidate
from fitting.discovery._verdict import Diagnosis, diagnose
from fitting.dynamics._collocation import Sampler
from fitting.dynamics._inputs import values_at
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Model
from fitting.effects._effect import Effect
from fitting.effects._expression import Tape, symbols
from fitting.effects._library import GENERAL
from fitting.effects._words import CASING, effect_name
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit, measured_with
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._noise import Noise
from fitting.inference._params import Estimate
from fitting.inference._result import Fit
from fitting.inference._trace import Refit, attempt, recorded_map, recording

Array = NDArray[np.float64]
Progress = Callable[[int, int | None], None]

_DRAWS = 1000
"""Number of null data sets [1]. Chosen: ten data sets exceed the quantile of 1 %, so a p-value of 1 % has a relative
error of a third; with fewer, this error is larger; with more, the search takes longer."""
_FIRST = 5
"""Number of laws that are refitted after the first search [1]. Chosen: a smaller number may omit the right form, a
larger one costs time; the later searches refine the list."""
_LATER = 9
"""Number of laws that are refitted after each later search [1]. Chosen: a smaller number may omit the best form, a
larger one costs time."""
_KEPT = 48
"""Number of laws that take part in the later searches [1]. Chosen: a smaller number may omit the best form, a larger
one costs time."""
_SEARCHES = 3
"""Number of searches; each later search scores about the best refit so far [1]. Chosen: with fewer, the scores are
about a wrong motion; with more, the search takes longer and changes little."""
_POINTS = 1000
"""Number of points of a curve along the motion [1]. Chosen: a smaller number blurs narrow laws, a larger one costs
time."""
_COMPARABLE_SHARE = 0.8
"""An effect of the library is fitted at the same noise as the best law if its fall of deviance, divided by the fall of
the best law, is at least this value [1]. Chosen: a smaller value costs time, a larger one names a formula although a
known effect describes the data as well."""
_EXPLAINED_TIE = 0.01
"""Difference of explained shares below which two variables count as equal [1]. Chosen: with a smaller value, chance
decides between the variables; a larger one hides the better variable."""
_ROUNDS = 4
"""Number of steps of the refinement of two shape constants [1]. Chosen: each step narrows the grid; with fewer steps,
the refit starts far from the optimum; with more, the refinement takes longer."""
_GRID = 5
"""Number of points of each shape constant in a step of the refinement [1]. Chosen: a smaller number may overlook the
optimum, a larger one costs time."""
_STEPS = 8
"""Number of steps of the progress bar [1]. Chosen: the usual number of searches and refits; with another value, the bar
jumps to its end or stops before it."""
_RANK = 1e-9
"""Relative singular value below which a nuisance direction is rounding error [1]. Chosen: a smaller value projects out
rounding errors, a larger one ignores some nuisance columns."""


@dataclass(frozen=True)
class Difference:
    """The largest difference of two laws of a set within the recordings."""

    formula: str  #: The other law.
    torque_Nm: float  #: Largest difference of the net torques on a body, base model included [torque].
    label: str  #: Name of the case with the largest difference.
    t_start: float  #: Start of the interval in which the difference exceeds half of its maximum [s].
    t_stop: float  #: End of this interval [s].
    omega_c: tuple[float, float]  #: Smallest and largest speed of the casing in this interval [rad s-1].
    omega_r: tuple[float, float]  #: Smallest and largest speed of the rotor in this interval [rad s-1].


_SHOWN = 6
"""Largest number of laws, and of lines of the sentence, in a repr [1]. Chosen: a smaller number hides equivalent laws,
a larger one fills the console."""
_WIDTH = 100
"""Width of a sentence in a repr [characters]. Chosen: it fits into usual consoles; a larger width wraps there, a
smaller one needs more lines."""


@dataclass(frozen=True, repr=False)
class Law:
    """A law that explains the unmodelled torque, and the evidence for it."""

    formula: str  # terms as ``body: law``, joined by " + "; `fit --add` takes a single term
    form: str  # form of the law in words
    effects: tuple[Effect, ...]  # terms of the law, one or two
    score: float  # fall of the deviance when the law is added to the base
    delta_bic: float  # BIC with the law minus BIC of the base
    description_length: float  # penalty of the length of the formula, added to BIC in the ranking
    # family-wise: probability of an equal or larger score in the whole search if no law is missing
    p_value: float
    torque_rms_Nm: float  # rms torque along the measured motion [N m]
    estimates: dict[str, Estimate]  # parameters by ``<effect>.<symbol>``
    indistinguishable_from: tuple[str, ...]  # formulas of the other laws within the equivalence width
    same_torque_as: tuple[str, ...]  # formulas of laws with the same torque along the recorded motion
    differences: tuple[Difference, ...]  # largest difference of this law from each other law of the answer
    fit: Fit = field(repr=False)  # the refit of base and law

    def __repr__(self) -> str:
        values = ", ".join(
            f"{k.rpartition('.')[2]} = {rounded(e.value, e.stderr, e.unit)}"
            for k, e in self.estimates.items()
        )
        return f"{self.formula}: score {self.score:.4g}; {values}"

    @property
    def body(self) -> str:
        """The body or joint on which the law acts; two bodies or joints are joined by " and "."""
        return " and ".join(dict.fromkeys(e.joint for e in self.effects))

    @property
    def penalised(self) -> float:
        """BIC plus description length, by which laws are ranked."""
        return self.fit.bic + self.description_length


@dataclass(frozen=True, repr=False)
class Laws:
    """The answer of `laws`.

    `verdict` is "law" (a law was found), "library" (an effect of the library describes the data), "parameter" (a shared
    parameter differs between the recordings), or "none" (no law is significant).
    """

    fit: Fit  # fit of the base model
    verdict: str
    sentence: str
    # best first; the answer consists of the laws within the equivalence width of the first law
    laws: tuple[Law, ...]
    library: Candidate | None  # the effect of the library that describes the data as well as any law
    # unmodelled torque as a function of each variable, the largest explained share first
    depends_on: tuple[Dependence, ...]
    next_experiment: str  # the run that separates the laws of the set; empty for one law
    trials: int  # number of scored columns
    diagnosis: Diagnosis | None = field(default=None, repr=False)  # diagnosis of the base, if it was made
    differs: DifferentParameter | None = (
        None  # shared parameter whose separate values describe the data as well as the laws do
    )
    trace: tuple[Refit, ...] = field(default=(), repr=False)  # every fit of the search, including failed fits

    def __repr__(self) -> str:
        shown = [f"  {law!r}" for law in self.laws[:_SHOWN]]
        more = [f"  ... {len(self.laws) - _SHOWN} more"] if len(self.laws) > _SHOWN else []
        return on_screen([f"laws: {self.verdict}", *wrap(self.sentence, _WIDTH)[:_SHOWN], *shown, *more])

    @property
    def answer(self) -> tuple[Law, ...]:
        """The laws within the equivalence width of the best law."""
        if not self.laws:
            return ()
        others = set(self.laws[0].indistinguishable_from)
        return (self.laws[0], *(law for law in self.laws[1:] if law.formula in others))

    @property
    def torques(self) -> tuple[tuple[Law, ...], ...]:
        """The answer in groups of laws with the same torque along the recorded motion.

        Each group begins with its best law.
        """
        groups: list[tuple[Law, ...]] = []
        known: set[str] = set()
        for law in self.answer:
            if law.formula not in known:
                own = {law.formula, *law.same_torque_as}
                groups.append(tuple(x for x in self.answer if x.formula in own))
                known |= own
        return tuple(groups)


@single_blas_thread()
def laws(
    base: Fit,
    extra: Sequence[Effect] = (),
    *,
    diagnosis: Diagnosis | None = None,
    beyond_library: bool = False,
    criteria: Criteria | None = None,
    workers: WorkerPool | None = None,
    progress: Progress | None = None,
) -> Laws:
    """Return the set of laws outside the library that explain the unmodelled torque of a fit.

    Parameters
    ----------
    base : Fit
        The fit with unmodelled torque.
    extra : sequence of Effect
        Effects of the user, in addition to the library.
    diagnosis : Diagnosis, optional
        The diagnosis of the fit, if it exists. If it names an effect of the library without a significant remainder,
        the search stops. Without `diagnosis`, `diagnose` runs only if a fit with an effect of the library has no
        significant lack of fit.
    beyond_library : bool
        Search for laws although an effect of the library describes the data.
    criteria : Criteria, optional
        Thresholds of every decision; by default the criteria of the fit. If the criteria of the noise differ from those
        of the fit, the fit is repeated first, and `diagnosis` is ignored.
    workers : WorkerPool, optional
        Processes that share the refits.
    progress : callable, optional
        Called with the number of steps done and the total number.

    Returns
    -------
    Laws

    Raises
    ------
    FittingError
        If the fit cannot be evaluated.
    """
    base.model.refuse_chain(
        "a search for laws outside the library",
        'fit your own laws, for example --add "wheel: -k*omega_wheel**3"',
    )
    criteria = criteria or base.criteria
    with recording() as trace:
        measured = measured_with(base, criteria)
        known = diagnosis if measured is base else None
        pool = workers or WorkerPool(0)
        found = _laws(measured, extra, known, criteria, pool, progress, beyond_library=beyond_library)
    return replace(found, trace=tuple(trace.refits))


def _laws(
    base: Fit,
    extra: Sequence[Effect],
    diagnosis: Diagnosis | None,
    criteria: Criteria,
    workers: WorkerPool,
    progress: Progress | None,
    *,
    beyond_library: bool,
) -> Laws:
    steps = _Steps(progress)
    search = _Search(base, criteria, workers, steps)
    separate = different_parameter(base, criteria)
    if (
        separate is not None
        and not beyond_library
        and not separate.fit.fails(criteria)
        and not search.improves_on_difference(separate, extra)
    ):
        depends_on = tuple(dependence(base))
        steps.done()
        differs = separate.parameter
        return Laws(
            base, "parameter", differs.sentence, (), None, depends_on, "", search.trials, diagnosis, differs
        )
    if diagnosis is None:
        candidates: Sequence[Candidate] = rank(base, extra, criteria=criteria, workers=workers)
        steps.next()
        if not beyond_library and _may_suffice(candidates, criteria):
            diagnosis = diagnose(base, extra, criteria=criteria, candidates=candidates, workers=workers)
    if diagnosis is not None:
        candidates = diagnosis.candidates
    steps.next()
    named = None if beyond_library or diagnosis is None else library_answer(diagnosis, criteria)
    if named is not None and not search.improves_on(named):
        depends_on = tuple(dependence(base))
        steps.done()
        members = (base.name(named.effect), *map(base.name, named.indistinguishable_from))
        names = " or ".join(map(str, members))
        sentence = (
            f"{_capital(names)} explains the "
            "unmodelled torque, and nothing significant remains: no other law is needed."
        )
        return Laws(base, "library", sentence, (), named, depends_on, "", search.trials, diagnosis)
    found = search.best_set()
    terms = [e.name for e in found[0].effects] if found else []
    depends_on = tuple(dependence(found[0].fit if found else base, without=terms))
    steps.done()
    if not found:
        verdict, sentence = (
            "none",
            _nothing_sentence(base.model, depends_on, criteria, base.problem.data[0].record.body),
        )
        known = None if separate is None else separate.parameter
        if known is not None:
            verdict, sentence = "parameter", known.sentence
        return Laws(base, verdict, sentence, (), None, depends_on, "", search.trials, diagnosis, known)
    separate = different_parameter(base, criteria, rival=(found[0].fit, found[0].penalised))
    library = _equivalent_effect(candidates, found[0], criteria)
    clear = separate is not None and found[0].penalised - separate.penalised_bic > criteria.equivalence_width
    answer = Laws(
        base,
        "library" if library is not None else "parameter" if clear else "law",
        "",
        with_classes(found, criteria),
        library,
        depends_on,
        "",
        search.trials,
        diagnosis,
        None if separate is None else separate.parameter,
    )
    # formulas with the same torque in these recordings may differ at other speeds
    rivals = [x for group in answer.torques for x in group[:1]] + [x for g in answer.torques for x in g[1:]]
    return replace(
        answer,
        sentence=_sentence(answer, criteria),
        next_experiment=separating_run(base, [(x.formula, x.effects, x.estimates) for x in rivals], criteria),
    )


def library_answer(known: Diagnosis, criteria: Criteria = DEFAULT) -> Candidate | None:
    """Return the effect of the library that makes other laws unnecessary; None if there is none.

    The result is None if the diagnosis has a remainder, or if the equivalence class contains a law outside the library.
    It is also None if the fit needs more process noise than the recording shows, because the excess noise then
    describes a part of the data.
    """
    if known.verdict != "missing_effect" or known.remainder is not None or not known.candidates:
        return None
    best = next((c for c in known.candidates if c.physical and c.significant), known.candidates[0])
    if not set(UNKNOWN_LAWS.values()).isdisjoint(best.indistinguishable_from):
        return None
    return None if best.fit is not None and best.fit.has_excess_noise(criteria) else best


def _may_suffice(candidates: Sequence[Candidate], criteria: Criteria) -> bool:
    """Return whether the fit with the best effect, or with an effect of its equivalence class, has no lack of fit."""
    chosen = best_candidate(candidates, criteria)
    if chosen is None:
        return False
    names = {chosen.effect.name, *chosen.indistinguishable_from}
    fits = (c.fit for c in candidates if c.effect.name in names and c.fit is not None)
    return any(not f.fails(criteria) or not refined(f, criteria).fails(criteria) for f in fits)


class _Steps:
    """Counts the steps of a search for a progress bar."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress, self._count = progress, 0
        if progress is not None:
            progress(0, _STEPS)

    def next(self) -> None:
        self._count = min(self._count + 1, _STEPS - 1)
        if self._progress is not None:
            self._progress(self._count, _STEPS)

    def done(self) -> None:
        if self._progress is not None:
            self._progress(_STEPS, _STEPS)


class _Trial(NamedTuple):
    """A law to refit: form, score, initial values of the other parameters, and the model without the law."""

    law: LawForm
    score: Score
    start: Mapping[str, float]
    model: Model


class _Scored(NamedTuple):
    """Scores of all laws, and the linearised data from which they were computed."""

    scores: list[Score]
    context: ScoreContext
    cases: list[CaseColumns]

    def start(self, about: Fit, s: Score) -> dict[str, float]:
        """Return the parameters of a fit, changed to first order by the addition of the scored law."""
        trials = [c.trials(s.effect, [x])[:1] for c, x in zip(self.cases, s.shape, strict=True)]
        ((_, columns),) = stacked(trials, per_case=s.effect.per_case or s.own_phase)
        layout = about.problem.layout
        theta = about.theta
        if columns.shape[1] == len(s.gamma):
            theta = theta + self.context.base_change(columns @ s.gamma)
        lower, upper = layout.bounds()
        return dict(zip(layout.names, np.clip(theta, lower, upper).tolist(), strict=True))


class _Chosen(NamedTuple):
    """A law to refit, its score, and the data from which the score was computed."""

    law: LawForm
    score: Score
    scored: _Scored


class _Refitted(NamedTuple):
    """Terms of a law and the fit of base and law."""

    terms: tuple[LawForm, ...]
    fit: Fit

    @property
    def length(self) -> float:
        """Description length of all terms."""
        return sum(t.description_length for t in self.terms)

    @property
    def penalised(self) -> float:
        return self.fit.bic + self.length


class _Search:
    """The search for laws that a base lacks: scores, refits, scores about the best refit, refits."""

    def __init__(self, base: Fit, criteria: Criteria, workers: WorkerPool, steps: _Steps) -> None:
        self.base, self.criteria, self.workers, self.steps = base, criteria, workers, steps
        data = base.problem.data
        self.forms = grammar(
            ranges_of(base),
            max(d.record.span[1] - d.record.span[0] for d in data),
            bodies=data[0].record.parts,
            angles=data[0].is_angle,
        )
        self.trials = 0

    def best_set(self) -> list[Law]:
        """Return the laws, best first; none if no law is significant."""
        scored = self._scored(self.base, ())
        nulls = {s.effect.name: NullDistribution(s) for s in scored.scores}
        self._nulls, self._family = nulls, FamilywiseNull(list(nulls.values()))
        self.steps.next()
        significant = min(self._p(s) for s in scored.scores) < self.criteria.significance
        # scores are of first order, and not reliable about a base with a large lack of fit
        if not significant and not self.base.fails(self.criteria):
            return []
        chosen = self._promising(scored, _FIRST)
        kept = self._promising(scored, _KEPT)
        if _at_bound(self.base):
            released = self._scored(self.base, (), release=True)
            chosen = _without_repetition(chosen, self._promising(released, _FIRST))
            kept = _without_repetition(kept, self._promising(released, _KEPT))
        self.forms = [c.law for c in kept]
        refits = self._refits(chosen, self.base, self.base.noise)
        self.steps.next()
        if not refits:
            return []
        best = min(refits, key=lambda r: r.penalised)
        for _ in range(_SEARCHES - 1):
            best = best._replace(fit=refined(best.fit, self.criteria))
            terms = [t.effect for t in best.terms]
            chosen = self._promising(self._scored(best.fit, terms), _LATER, about=best)
            if _at_bound(best.fit):
                released = self._scored(best.fit, terms, release=True)
                chosen = _without_repetition(chosen, self._promising(released, _FIRST, about=best))
            refits = self._refits(chosen, best.fit, best.fit.noise, best.terms)
            self.steps.next()
            refits = _best_of_each_law([*refits, best])
            now = min(refits, key=lambda r: r.penalised)
            moved = now.terms != best.terms and now.penalised < best.penalised - self.criteria.evidence
            best = now
            if not moved:
                break
        refits = [r for r in refits if r.fit.bic < self.base.bic - self.criteria.evidence]
        if not refits:
            return []
        if best.fit.fails(self.criteria):
            # a second term that BIC does not justify only corrects the form of the first term
            limit = best.penalised - self.criteria.evidence
            refits = [*refits, *(r for r in self._with_second_term(best) if r.penalised < limit)]
        self.steps.next()
        found = sorted((self._law(r) for r in refits), key=lambda x: x.penalised)
        if min(x.p_value for x in found) >= self.criteria.significance:
            return []
        # laws equivalent to the best law belong to the set, even if they are not significant themselves
        limit = found[0].penalised + self.criteria.equivalence_width
        return [x for x in found if x.penalised < limit or x.p_value < self.criteria.significance]

    def _p(self, s: Score) -> float:
        null = self._nulls[s.effect.name]
        return self._family(null(s.score), null.weights)

    def improves_on(self, known: Candidate) -> bool:
        """Return whether a law describes the data clearly better than an effect, to first order about its fit."""
        if known.fit is None or not known.physical:
            return False
        scored = self._scored(known.fit, [known.effect])
        own = score_of_columns(scored.context, torque_rows([known.effect], scored.cases)[:, None])
        own -= (len(known.fit.theta) - len(self.base.theta)) * float(np.log(self.base.n_eff))
        lengths = [f.description_length for f in self.forms]
        return max(map(self._worth, scored.scores, lengths)) > own + self.criteria.equivalence_width

    def improves_on_difference(self, separate: SeparateValues, extra: Sequence[Effect]) -> bool:
        """Return whether a law or an effect describes the data better than different values of a parameter."""
        effects = applicable_effects(self.base, extra)
        everything = [*(f.effect for f in self.forms), *effects]
        lengths = [f.description_length for f in self.forms] + [0.0] * len(effects)
        return improves_on_difference(separate, everything, lengths, self.criteria)

    def _worth(self, s: Score, length: float) -> float:
        return penalised(s, length, self.base.n_eff)

    def _scored(self, about: Fit, removed: Sequence[Effect], *, release: bool = False) -> _Scored:
        """Return the scores of all laws about a fit with some of its effects removed.

        If the right law is added, a friction coefficient at its bound may become positive, or it may remain at the
        bound. In the first case, scores with `release` find the law, because they treat parameters at a bound as free.
        In the second case, scores without `release` find it, because they hold these parameters.
        """
        cases = [CaseColumns(about, i) for i in range(len(about.problem.cases))]
        effects = [f.effect for f in self.forms]
        if not removed and not release:
            context = ScoreContext(about, _DRAWS)
            scores = score(about, effects, cases, self.criteria, context=context)
            self.trials = max(self.trials, sum(s.trials for s in scores))
            return _Scored(scores, context, cases)
        context = context_without(about, removed, cases, release=release)
        scores = score(about, effects, cases, self.criteria, context=context)
        return _Scored([_refined_shapes(context, s, cases) for s in scores], context, cases)

    def _promising(
        self, scored: _Scored, most: int, *, about: _Refitted | None = None, stateless: bool = False
    ) -> list[_Chosen]:
        """Return the `most` laws with the largest score minus the penalty of their constants and formula length.

        The terms of `about` are excluded. With `stateless`, laws that have a state are excluded as well.
        """
        known = set() if about is None else {t.effect.name for t in about.terms}
        found = [
            _Chosen(law, s, scored)
            for law, s in zip(self.forms, scored.scores, strict=True)
            if not s.absorbed and s.score > 0 and law.effect.name not in known
            if law.effect.state is None or not stateless
        ]
        found.sort(key=lambda c: self._worth(c.score, c.law.description_length), reverse=True)
        return found[:most]

    def _refits(
        self, chosen: Sequence[_Chosen], about: Fit, noise: Sequence[Noise], replaced: Sequence[LawForm] = ()
    ) -> list[_Refitted]:
        """Return refits in which laws replace the effects `replaced` of a fit.

        The values of the fit are the initial values.
        """
        model = about.model
        for t in replaced:
            model = model.without(t.effect.name)
        trials = [_Trial(c.law, c.score, c.scored.start(about, c.score), model) for c in chosen]
        found = recorded_map(self.workers, _refit, _Common(self.base, tuple(noise)), trials, _shared_data)
        return [_Refitted((c.law,), f) for c, f in zip(chosen, found, strict=True) if f is not None]

    def _with_second_term(self, best: _Refitted) -> list[_Refitted]:
        """Return fits with a second law in addition to the best law."""
        if len(best.terms) > 1:
            return []
        # a model has at most one state variable `lag`
        stateless = best.terms[0].effect.state is not None
        scored = self._scored(best.fit, ())
        chosen = self._promising(scored, _FIRST, about=best, stateless=stateless)
        found = self._refits(chosen, best.fit, best.fit.noise)
        return [_Refitted((*best.terms, *r.terms), r.fit) for r in found]

    def _law(self, r: _Refitted) -> Law:
        fall = self.base.deviance - r.fit.deviance
        single = self._nulls[r.terms[0].effect.name]
        effects = tuple(_with_positive_strength(t.effect, r.fit) for t in r.terms)
        names = {t.effect.name for t in r.terms}
        estimates = {k: e for k, e in r.fit.estimates.items() if k.rpartition(".")[0] in names}
        for now, t in zip(effects, r.terms, strict=True):
            for key, e in estimates.items():
                if now.law != t.effect.law and key.partition("@")[0] == f"{now.name}.k":
                    estimates[key] = replace(e, value=-e.value)
        return Law(
            " + ".join(formula_of(e) for e in effects),
            " + ".join(t.form for t in r.terms),
            effects,
            fall,
            r.fit.bic - self.base.bic,
            r.length,
            self._family(single(fall), single.weights),
            _torque_rms(r.fit, [t.effect for t in r.terms]),
            estimates,
            (),
            (),
            (),
            r.fit,
        )


def _at_bound(found: Fit) -> bool:
    return bool(found.problem.layout.at_bound(found.theta).any())


def _without_repetition(chosen: Sequence[_Chosen], more: Sequence[_Chosen]) -> list[_Chosen]:
    """Return the concatenated lists, with each law once."""
    names = {c.law.effect.name for c in chosen}
    return [*chosen, *(c for c in more if c.law.effect.name not in names)]


def _refined_shapes(context: ScoreContext, s: Score, cases: Sequence[CaseColumns]) -> Score:
    """Return a score whose two shape constants, shared by all cases, are refined between the points of their grids."""
    shapes = [p for p in cases[0].parameters(s.effect) if p.role == "shape"]
    if len(shapes) != 2 or s.effect.per_case or s.absorbed or s.score <= 0:
        return s
    best = s
    ratio = [_ratio(p.grid, best.shape[0][p.symbol]) for p in shapes]
    for _ in range(_ROUNDS):
        axes = [
            np.clip(best.shape[0][p.symbol] * q ** np.linspace(-1, 1, _GRID), p.lower, p.upper)
            for p, q in zip(shapes, ratio, strict=True)
        ]
        choices = [{shapes[0].symbol: float(a), shapes[1].symbol: float(b)} for a in axes[0] for b in axes[1]]
        trials = [c.trials(s.effect, choices) for c in cases]
        groups = stacked(trials, per_case=False)
        found = best_group(context, s.effect, groups, context.levels, null=False)
        if found.score > best.score:
            best = replace(found, null=s.null, trials=s.trials)
        ratio = [q**0.5 for q in ratio]
    return best


def _ratio(grid: Sequence[float], value: float) -> float:
    """Return the ratio of the two points of a grid that enclose a value."""
    ordered = np.sort(np.abs(np.array(grid)))
    ordered = ordered[ordered > 0]
    if len(ordered) < 2:
        return 1.5
    i = int(np.clip(np.searchsorted(ordered, abs(value)), 1, len(ordered) - 1))
    return float(max(ordered[i] / ordered[i - 1], 1.02))


class _Common(NamedTuple):
    base: Fit
    noise: tuple[Noise, ...]


def _shared_data(common: _Common) -> Sequence[CaseData]:
    return common.base.problem.data


def _refit(common: _Common, trial: _Trial) -> Fit | None:
    """Refit base and law together; None if the fit fails."""
    base = common.base
    with attempt("a law"):
        found = fit(
            trial.model.with_effect(trial.law.effect),
            base,
            start={**trial.start, **initial_values_of(base, trial.score)},
            noise=common.noise,
            quick=True,
        )
        return found if np.isfinite(found.deviance) else None
    return None


def _best_of_each_law(refits: Sequence[_Refitted]) -> list[_Refitted]:
    """Return the best refit of each law."""
    best: dict[tuple[str, ...], _Refitted] = {}
    for r in refits:
        key = tuple(t.effect.name for t in r.terms)
        if key not in best or r.penalised < best[key].penalised:
            best[key] = r
    return list(best.values())


def formula_of(effect: Effect) -> str:
    """Return a law as ``body: law``, followed by the differential equation of its state if it has one."""
    state = f", d({effect.state.symbol})/dt = {effect.state.rate}" if effect.state else ""
    return f"{effect.joint}: {effect.law}{state}"


def _with_positive_strength(effect: Effect, found: Fit) -> Effect:
    """Return the effect; if its strength is negative in all recordings, its law is written with a minus sign."""
    own = [e.value for k, e in found.estimates.items() if k.partition("@")[0] == f"{effect.name}.k"]
    return replace(effect, law=f"-{effect.law}") if own and max(own) < 0 else effect


def net_torques(found: Fit, along: Fit, case: int, times: Array) -> Array:
    """Return the net torques on rotor and casing of one fit along the motion of another fit, shape (2, times) [N m]."""
    y = Sampler(along.predictions[case].path.mesh, times).value(along.predictions[case].path.y)[:, :2]
    own = found.predictions[case].path
    if own.y.shape[-1] > 2:
        y = np.concatenate([y, Sampler(own.mesh, times).value(own.y)[:, 2:]], axis=1)
    numbers = found.problem.layout.numbers(found.theta, case)
    rates = found.problem.cases[case].dynamics.rates(times, y, numbers)
    return np.stack([numbers[INERTIA_ROTOR] * rates[:, 0], numbers[INERTIA_CASING] * rates[:, 1]])


def _torque_rms(found: Fit, effects: Sequence[Effect]) -> float:
    """Return the rms of the torque of some effects of a fit along its motion, over all cases [N m]."""
    squares = []
    for case, p in enumerate(found.predictions):
        t = np.linspace(*found.problem.data[case].record.span, _POINTS)
        y = Sampler(p.path.mesh, t).value(p.path.y)
        known: dict[str, Any] = {name: y[:, i] for i, name in enumerate(p.path.states)}
        known |= {"t": t, "delta": y[:, 0] - y[:, 1]}
        known |= values_at(found.problem.data[case].record.inputs, t)
        known["psi_c"] = Sampler(p.path.mesh, t).integral(*p.path.angle("omega_c"))
        numbers = found.problem.layout.numbers(found.theta, case)
        total = np.zeros(len(t))
        for e in effects:
            own = {q.symbol: numbers[f"{e.name}.{q.symbol}"] for q in e.parameters}
            total = total + np.asarray(Tape([e.expression])(known | own)[0])
        squares.append(float(np.mean(total**2)))
    return float(np.sqrt(np.mean(squares)))


def with_classes(found: Sequence[Law], criteria: Criteria) -> tuple[Law, ...]:
    """Return the laws, each with its differences and the formulas of the other laws and of laws of equal torque."""
    answer = [x for x in found if x.penalised - found[0].penalised < criteria.equivalence_width]
    groups: list[list[Law]] = []
    for law in answer:
        same = next((g for g in groups if _separation(g[0].fit, law.fit) < criteria.evidence), None)
        if same is None:
            groups.append([law])
        else:
            same.append(law)
    complete = []
    for law in found:
        group = next((g for g in groups if any(x is law for x in g)), [])
        others = [x for x in answer if x is not law] if group else []
        differences = tuple(d for x in others if (d := _difference(law, x)) is not None)
        complete.append(
            replace(
                law,
                indistinguishable_from=tuple(x.formula for x in others),
                same_torque_as=tuple(x.formula for x in group if x is not law),
                differences=differences,
            )
        )
    return tuple(complete)


def _separation(one: Fit, other: Fit) -> float:
    """Return the deviance of a fit for noise-free data of another fit, with nuisance parameters projected out."""
    total = 0.0
    both = zip(one.problem.data, one.noise, one.predictions, other.predictions, strict=True)
    for data, noise, a, b in both:
        white = noise.whitener(np.column_stack([data.nuisance, a.rows - b.rows]))
        free = orthonormal(white[:, :-1], _RANK)
        projected = orthogonal_to(free, white[:, -1])
        total += float(projected @ projected)
    return total


def _difference(one: Law, other: Law) -> Difference | None:
    """Return the largest difference of the net torques of two fits along the motion of the first fit."""
    worst: Difference | None = None
    for case, data in enumerate(one.fit.problem.data):
        t = np.linspace(*data.record.span, _POINTS)
        own, others = (net_torques(x.fit, one.fit, case, t) for x in (one, other))
        difference = np.abs(own - others).max(axis=0)
        peak = int(np.argmax(difference))
        if worst is not None and difference[peak] <= worst.torque_Nm:
            continue
        low = high = peak
        while low > 0 and difference[low - 1] > 0.5 * difference[peak]:
            low -= 1
        while high < len(t) - 1 and difference[high + 1] > 0.5 * difference[peak]:
            high += 1
        path = one.fit.predictions[case].path
        y = Sampler(path.mesh, t[low : high + 1]).value(path.y)
        worst = Difference(
            other.formula,
            float(difference[peak]),
            data.record.label,
            float(t[low]),
            float(t[high]),
            (float(y[:, 1].min()), float(y[:, 1].max())),
            (float(y[:, 0].min()), float(y[:, 0].max())),
        )
    return worst


def _equivalent_effect(candidates: Sequence[Candidate], best: Law, criteria: Criteria) -> Candidate | None:
    """Return the effect of the library that describes the data as well as the best law; None if there is none."""
    for c in candidates:
        if c.fit is None or not c.physical or not c.significant or c.score < _COMPARABLE_SHARE * best.score:
            continue
        with attempt("an effect of the library at the noise of a law"):
            refitted = refitted_at(c.fit, best.fit.noise)
            if refitted.bic < best.penalised + criteria.equivalence_width:
                return replace(c, fit=refitted)
    return None


def _nothing_sentence(
    model: Model, depends_on: Sequence[Dependence], criteria: Criteria, body: str = CASING
) -> str:
    """Return the sentence for a search that found no law; it names effects of the base that may imitate the law."""
    if not depends_on or depends_on[0].p_value >= criteria.significance:
        return "No law is significant: this search finds nothing beyond noise."
    sentence = f"No law improves this fit, although its unmodelled torque depends on {depends_on[0].words}."
    added = [e.name for e in model.effects if e.kind == "physical" and e.name not in GENERAL]
    if added:
        names = " and ".join(str(effect_name(n, body)) for n in added)
        sentence += (
            f" It contains {names}, which may imitate the law: search again from the fit without "
            "added effects (`--from f1`)."
        )
    return sentence


def _capital(text: object) -> str:
    return f"{str(text)[:1].upper()}{str(text)[1:]}"


def _sentence(found: Laws, criteria: Criteria) -> str:
    parts = []
    if found.differs is not None:
        parts.append(found.differs.sentence)
    if found.library is not None:
        parts.append(
            f"{_capital(found.fit.name(found.library.effect))} of the library describes the data as well as any law "
            "found, so it is listed first."
        )
    best, depends_on = found.laws[0], found.depends_on
    # in a single run, one variable may nearly be a function of another variable; then the variable of the law is named
    of_law = {(e.joint, v) for e in best.effects for v in symbols(e.expression)}
    least = depends_on[0].explained - _EXPLAINED_TIE if depends_on else 0.0
    preferred = [d for d in depends_on if (d.body, d.variable) in of_law and d.explained > least]
    first = next(iter([*preferred, *depends_on]), None)
    if first is not None and first.p_value < criteria.significance:
        parts.append(
            f"The unmodelled torque depends most clearly on {first.words}: a smooth dependence explains "
            f"{100 * first.explained:.0f} % of the lack of fit."
        )
    parts.append(
        f"Best law: {best.formula} ({best.form}), {format_torque(best.torque_rms_Nm, unit=best.fit.torque_unit)} rms, "
        f"dBIC {best.delta_bic:.0f}."
    )
    same, others = len(found.torques[0]) - 1, len(found.torques) - 1
    if same:
        parts.append(
            f"{same} other formula{'s have' if same > 1 else ' has'} the same torque along the recorded motion."
        )
    if others:
        parts.append(
            f"{others} law{'s' if others > 1 else ''} with a different torque cannot be separated from the best law."
        )
    return " ".join(parts)
