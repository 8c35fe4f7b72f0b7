"""Test of an answer by a parametric bootstrap: recordings simulated from the fit are analysed like the original.

Recordings are simulated under three kinds of hypotheses (`fitting.inference._replica`). They are then fitted and
diagnosed with the base model of the original:

- "null": the base model alone. The false-alarm rate is the share of null recordings in which an effect is named or the
  model is rejected, although no effect is missing. The share of null recordings whose best score is at least the score
  of the answer is the empirical p-value of the answer.
- "truth": the base model with the named effect. The results are how often this effect is named first, how often it is
  in the named equivalence class, and how often the 95 % intervals contain the simulated values.
- "rival": the base model with an effect that could be mistaken for the named effect, either a member of its equivalence
  class or the next candidate. The result is how often each effect is named.

The rates have Clopper-Pearson intervals (C. Clopper, E. Pearson, Biometrika 26, 404 (1934)). An empirical p-value of n
recordings is at least 1 / (n + 1) (A. Davison, D. Hinkley, Bootstrap Methods and their Application, 1997, ch. 4).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, Self

from fitting._criteria import Criteria
from fitting._display import block, draw_answers, figure, figure_of, headline, table
from fitting._errors import EstimationError, FittingError
from fitting._workers import WorkerPool, single_blas_thread
from fitting.discovery._refine import with_candidate
from fitting.discovery._verdict import Diagnosis, diagnose
from fitting.effects._effect import Effect
from fitting.effects._words import effect_name
from fitting.inference._budget import combined_uncertainties
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit as fit_model
from fitting.inference._record import Record
from fitting.inference._replica import replica
from fitting.inference._result import Fit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fitting.discovery._select import Candidate

Kind = Literal["null", "truth", "rival"]

_MOST_RIVALS = 3
"""Largest number of simulated rivals [1]. Chosen: with fewer, some confusions of effects remain unknown; with more, the
certificate takes longer."""
_RIVAL_SHARE = 0.25
"""Simulated recordings of each rival per null recording [1]. Chosen: a smaller value widens the intervals of the rates,
a larger one costs time."""
_FEWEST = 4
"""Smallest number of simulated recordings of a rival [recordings]. Chosen: fewer recordings do not show which effect is
usually named; more recordings cost time in a short test."""
_INTERVAL = 1.96
"""Half width of an interval that contains the true value in 95 % of the cases [standard uncertainties]. Derived:
quantile 0.975 of the standard normal distribution."""
_PER_PROCESS = 4
"""Number of recordings of each process between two calls of the function `keep` [recordings]. Chosen: with fewer,
processes are idle for longer; with more, a killed run loses more work."""
_FAILED = "failed"


@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis that is simulated: its fit, and the name of the `effect` that the base model lacks ("" for none)."""

    kind: Kind
    effect: str
    fit: Fit = field(repr=False)


@dataclass(frozen=True)
class Outcome:
    """The answer to one simulated recording; for a joint fit, to one simulated recording of every case.

    Attributes
    ----------
    kind, effect : str
        The hypothesis (see `Hypothesis`).
    number : int
        Number of the recording under its hypothesis, from 0; this number and the seed determine all random errors.
    verdict : str
        The verdict of `diagnose`, or "failed" if the analysis ended with an error.
    named : tuple of str
        The named effect and those indistinguishable from it.
    score : float
        Score of the best candidate.
    inside : dict of str to bool
        Whether the 95 % interval of each parameter contains the simulated value; empty if the model of the answer is
        not the simulated model.
    """

    kind: str
    effect: str
    number: int
    verdict: str
    named: tuple[str, ...]
    score: float
    inside: dict[str, bool]

    @property
    def answer(self) -> str:
        """The named effect, or else the verdict."""
        return self.named[0] if self.named else self.verdict


@dataclass(frozen=True)
class Certificate:
    """Rates of right and wrong answers on recordings simulated from an answer.

    Attributes
    ----------
    n : int
        Number of recordings simulated without the named effect.
    verdict, named, score : str, tuple of str, float
        The tested answer: its verdict, the named effect and its equivalence class, the score of the best candidate.
    outcomes : tuple of Outcome
        The answers to all simulated recordings.
    film : bool
        Whether films were rendered and tracked; otherwise angles were simulated.
    seed : int
        Seed of the random errors.
    body : str
        The name of the body of the first case, used in the names of effects.
    """

    n: int
    verdict: str
    named: tuple[str, ...]
    score: float
    outcomes: tuple[Outcome, ...] = field(repr=False)
    film: bool = False
    seed: int = 0
    body: str = "casing"

    @classmethod
    def of_answer(
        cls, found: Diagnosis, outcomes: Sequence[Outcome], n: int, seed: int = 0, *, film: bool = False
    ) -> Self:
        """Return the certificate of an answer.

        Parameters
        ----------
        found : Diagnosis
            The answer.
        outcomes : sequence of Outcome
            The answers to simulated recordings.
        n, seed : int
            Number of recordings without the named effect, seed.
        film : bool
            Whether films were rendered and tracked.
        """
        best = found.candidates[0] if found.candidates else None
        named: tuple[str, ...] = ()
        if best is not None and found.verdict == "missing_effect":
            named = (best.effect.name, *best.indistinguishable_from)
        body = found.fit.problem.data[0].record.body
        return cls(n, found.verdict, named, best.score if best else 0.0, tuple(outcomes), film, seed, body)

    def of(self, kind: Kind, effect: str | None = None) -> list[Outcome]:
        """Return the outcomes under one kind of hypothesis.

        Parameters
        ----------
        kind : {"null", "truth", "rival"}
            The kind.
        effect : str, optional
            The simulated effect; by default all effects.
        """
        return [o for o in self.outcomes if o.kind == kind and effect in {None, o.effect}]

    @property
    def alarms(self) -> int:
        """Number of null recordings that end in a false alarm: any verdict but "adequate" and "undecided"."""
        return sum(o.verdict not in {"adequate", "undecided"} for o in self.of("null"))

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval (95 %) of the false-alarm rate."""
        return rate_interval(self.alarms, len(self.of("null")))

    @property
    def p_empirical(self) -> float:
        """Empirical p-value (1 + m) / (1 + n); m of n null recordings have at least the score of the answer."""
        null = self.of("null")
        return (1 + sum(o.score >= self.score for o in null)) / (1 + len(null))

    @property
    def right_first(self) -> float | None:
        """Share of the "truth" recordings whose named effect is the simulated effect; None without such recordings."""
        found = [bool(o.named) and o.named[0] == o.effect for o in self.of("truth")]
        return sum(found) / len(found) if found else None

    @property
    def in_class(self) -> float | None:
        """Share of the "truth" recordings whose named equivalence class contains the simulated effect.

        None without such recordings.
        """
        found = [o.effect in o.named for o in self.of("truth")]
        return sum(found) / len(found) if found else None

    def coverage(self, kind: Kind) -> dict[str, float]:
        """Return the share of 95 % intervals that contain the simulated value, by parameter.

        Parameters
        ----------
        kind : {"null", "truth", "rival"}
            The kind of hypothesis.
        """
        inside: dict[str, list[bool]] = {}
        for o in self.of(kind):
            for name, hit in o.inside.items():
                inside.setdefault(name, []).append(hit)
        return {name: sum(hits) / len(hits) for name, hits in inside.items()}

    @property
    def rivals(self) -> dict[str, dict[str, int]]:
        """Number of recordings by answer (effect named first, or verdict), for each simulated rival."""
        effects = dict.fromkeys(o.effect for o in self.of("rival"))
        return {e: _counted(self.of("rival", e)) for e in effects}

    @property
    def names(self) -> dict[str, int]:
        """Number of null recordings by answer (effect named first, or verdict), without the answer "adequate"."""
        return {k: n for k, n in _counted(self.of("null")).items() if k != "adequate"}

    @property
    def sentence(self) -> str:
        """The result in words."""
        null = len(self.of("null"))
        low, high = self.interval
        name = str(effect_name(self.named[0], self.body)) if self.named else ""
        what = f"without the {name}" if self.named else "of the fitted model"
        what = f"{what} (films, rendered and tracked)" if self.film else what
        interval = f"95 % interval {100 * low:.1f} to {100 * high:.1f} %"
        parts = [f"Of {null} simulated recordings {what}, {self.alarms} end in a false alarm ({interval})."]
        if self.named:
            parts.append(f"The empirical p-value of this answer is {self.p_empirical:.2g}.")
        if self.right_first is not None and self.in_class is not None:
            parts.append(
                f"Of {len(self.of('truth'))} recordings with this effect, {100 * self.right_first:.0f} % lead to an "
                f"answer that names it first, and {100 * self.in_class:.0f} % to an answer with it or an "
                "indistinguishable effect."
            )
        return " ".join(parts)

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Simulated effect, number of recordings and counted answers of each hypothesis, as texts."""
        return [
            (
                effect or "none",
                str(len(found)),
                "; ".join(f"{self.in_words(a)} {n}" for a, n in _counted(found).items()),
            )
            for effect, found in self._simulated
        ]

    @property
    def _simulated(self) -> list[tuple[str, list[Outcome]]]:
        """Each simulated effect in words ("" for no effect), with its outcomes."""
        kinds = dict.fromkeys((o.kind, o.effect) for o in self.outcomes)
        return [
            (self.in_words(key[1]) if key[1] else "", [o for o in self.outcomes if (o.kind, o.effect) == key])
            for key in kinds
        ]

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw one stacked bar for each simulated effect, with the share of each answer (matplotlib).

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; by default the axes of a new figure.

        Returns
        -------
        matplotlib.figure.Figure
            The new figure, or the figure of `ax`.
        """
        groups = [(effect or "no effect", _counted(found)) for effect, found in self._simulated]
        drawn = figure_of(ax) if ax is not None else figure(8.0, 1.4 + 0.5 * len(groups))
        draw_answers(
            ax if ax is not None else drawn.subplots(),
            [(f"{name} ({sum(counts.values())})", counts) for name, counts in groups],
            {answer: self.in_words(answer) for _, counts in groups for answer in counts},
        )
        return drawn

    def in_words(self, answer: str) -> str:
        """Return an answer, an effect or a parameter in words.

        Parameters
        ----------
        answer : str
            The key of an effect or of a parameter, or a verdict.
        """
        return _VERDICT_WORDS.get(answer) or effect_name(answer, self.body).words

    def _repr_html_(self) -> str:
        columns = ("simulated effect", "recordings", "answers")
        return block(
            headline("certificate", self.sentence), table("simulated recordings", columns, self.rows)
        )


_VERDICT_WORDS = {"adequate": "no effect"}


def _counted(outcomes: Sequence[Outcome]) -> dict[str, int]:
    return dict(Counter(o.answer for o in outcomes).most_common())


def rate_interval(count: int, n: int) -> tuple[float, float]:
    """Return the limits of the Clopper-Pearson interval (95 %) of a rate.

    Parameters
    ----------
    count, n : int
        Number of successes, and of trials.
    """
    from scipy.special import betaincinv

    low = float(betaincinv(count, n - count + 1, 0.025)) if count else 0.0
    high = float(betaincinv(count + 1, n - count, 0.975)) if count < n else 1.0
    return low, high


def hypotheses(found: Diagnosis) -> list[Hypothesis]:
    """Return the hypotheses that test an answer: null and, if an effect is named, truth and rivals.

    Only the null hypothesis is simulated if the answer is a measurement error that no law describes (a slipped turn,
    wrong start times of windows).

    Parameters
    ----------
    found : Diagnosis
        The answer.
    """
    base = found.fit
    if found.verdict != "missing_effect" or not found.candidates:
        return [Hypothesis("null", "", base)]
    named, *others = found.candidates
    truth = _with_effect(base, named)
    if truth is None:
        return [Hypothesis("null", "", base)]
    in_class = [c for c in others if c.effect.name in named.indistinguishable_from]
    next_best = [c for c in others if c.significant and c not in in_class]
    rivals: list[Hypothesis] = []
    for c in (*in_class, *next_best):
        other = _with_effect(found.fit, c) if len(rivals) < _MOST_RIVALS else None
        if other is not None:
            # the rival is a wrong model, and its estimated random torque contains its lack of fit; so the noise of
            # `truth` is used
            rivals.append(Hypothesis("rival", c.effect.name, replace(other, noise=truth.noise)))
    null = Hypothesis("null", "", replace(base, noise=truth.noise))
    return [null, Hypothesis("truth", named.effect.name, truth), *rivals]


def _with_effect(base: Fit, candidate: Candidate) -> Fit | None:
    """Return the fit of the base model with a candidate effect; None if it fails or does not converge."""
    model, known = with_candidate(base, candidate.effect), candidate.fit
    if known is None or set(known.model.names) != set(model.names):
        start = {k: e.value for k, e in (base.estimates | candidate.estimates).items()}
        try:
            known = fit_model(model, base, start=start)
        except FittingError:
            return None
    return known if known.converged else None


Item = tuple[str, str, int]


def planned(found: Diagnosis, n: int) -> list[Item]:
    """Return kind, effect and number of each recording that tests an answer.

    Parameters
    ----------
    found : Diagnosis
        The answer.
    n : int
        Number of null recordings; there are as many with the named effect, and a quarter as many with each rival.
    """
    return _planned(hypotheses(found), n)


def _planned(simulated: Iterable[Hypothesis], n: int) -> list[Item]:
    items = [(w.kind, w.effect, k) for w in simulated for k in range(_count(w, n))]
    # sorted by number, so that an interrupted run has recordings of every hypothesis
    return sorted(items, key=lambda item: item[2])


@dataclass(frozen=True)
class _Work:
    """Input of every worker: the hypotheses, the fit whose analysis is repeated, and the settings of the analysis."""

    hypotheses: dict[tuple[str, str], Hypothesis]
    base: Fit
    extra: tuple[Effect, ...]
    criteria: Criteria
    seed: int

    @classmethod
    def of(cls, found: Diagnosis, extra: Sequence[Effect], criteria: Criteria, seed: int) -> Self:
        simulated: dict[tuple[str, str], Hypothesis] = {(w.kind, w.effect): w for w in hypotheses(found)}
        return cls(simulated, found.fit, tuple(extra), criteria, seed)


@single_blas_thread()
def certify(
    found: Diagnosis,
    n: int = 200,
    *,
    seed: int = 0,
    extra: Sequence[Effect] = (),
    criteria: Criteria | None = None,
    known: Sequence[Outcome] = (),
    workers: WorkerPool | None = None,
    keep: Callable[[Sequence[Outcome], int], None] | None = None,
) -> Certificate:
    """Test an answer on recordings that are simulated from its fit.

    Parameters
    ----------
    found : Diagnosis
        The answer.
    n : int
        Number of null recordings; there are as many with the named effect, and a quarter as many with each rival.
    seed : int
        Seed of all random errors. The result does not depend on the number of workers.
    extra : sequence of Effect
        Effects of the user, in addition to the library.
    criteria : Criteria, optional
        Thresholds of the analysis; by default the criteria of the fit.
    known : sequence of Outcome
        Outcomes of an earlier run with the same answer and seed; these recordings are not simulated again.
    workers : WorkerPool, optional
        Processes that share the work.
    keep : callable, optional
        Called after each round with all outcomes so far and the number of recordings in total.

    Returns
    -------
    Certificate

    Raises
    ------
    EstimationError
        If the cases are curves made from measured values (see `replica`).
    """
    workers = workers or WorkerPool(0)
    work = _Work.of(found, extra, criteria or found.fit.criteria, seed)
    wanted = _planned(work.hypotheses.values(), n)
    done: dict[Item, Outcome] = {(o.kind, o.effect, o.number): o for o in known}
    missing = [item for item in wanted if item not in done]
    several = workers.processes + 1
    # the first round is short; the duration of the later rounds is predicted from it
    edges = {0, *range(several, len(missing), _PER_PROCESS * several), len(missing)}
    for first, last in pairwise(sorted(edges)):
        part = missing[first:last]
        done |= dict(zip(part, workers.map(_outcome, work, part), strict=True))
        if keep is not None:
            keep([done[item] for item in wanted if item in done], len(wanted))
    return Certificate.of_answer(found, [done[item] for item in wanted], n, seed)


@single_blas_thread()
def outcomes_of(
    found: Diagnosis,
    items: Sequence[Item],
    *,
    seed: int = 0,
    extra: Sequence[Effect] = (),
    criteria: Criteria | None = None,
) -> list[Outcome]:
    """Return the answers to some of the `planned` recordings.

    Parameters
    ----------
    found, seed, extra, criteria
        The same as for `certify`.
    items : sequence of (str, str, int)
        Kind, effect and number of each recording.

    Raises
    ------
    EstimationError
        If the kind and the effect of an item do not belong to a hypothesis.
    """
    work = _Work.of(found, extra, criteria or found.fit.criteria, seed)
    if not {item[:2] for item in items} <= work.hypotheses.keys():
        raise EstimationError("the answer has changed since its test began", "begin the test again")
    return [_outcome(work, item) for item in items]


def _count(hypothesis: Hypothesis, n: int) -> int:
    return max(math.ceil(_RIVAL_SHARE * n), min(n, _FEWEST)) if hypothesis.kind == "rival" else n


def _outcome(work: _Work, item: Item) -> Outcome:
    """Simulate one recording and analyse it like the original."""
    _, effect, number = item
    records = replica(work.hypotheses[item[:2]].fit, (work.seed, *effect.encode(), number))
    return _analysed(work, item, records)


def outcome_of_records(
    found: Diagnosis,
    item: Item,
    records: Sequence[Record],
    *,
    extra: Sequence[Effect] = (),
    criteria: Criteria | None = None,
) -> Outcome:
    """Return the answer to recordings that were simulated elsewhere, for example from rendered films.

    Parameters
    ----------
    found, extra, criteria
        The same as for `certify`.
    item : (str, str, int)
        Kind, effect and number of the simulation.
    records : sequence of Record
        One record for each case; empty if their measurement failed.
    """
    work = _Work.of(found, extra, criteria or found.fit.criteria, 0)
    return _analysed(work, item, records) if records else Outcome(*item, _FAILED, (), math.nan, {})


def _analysed(work: _Work, item: Item, records: Sequence[Record]) -> Outcome:
    hypothesis, layout = work.hypotheses[item[:2]], work.base.problem.layout
    share, per_case = ([k for k in keys if k in work.base.model.free] for keys in layout.choices)
    try:
        data = [CaseData.of(r, work.criteria) for r in records]
        again = fit_model(work.base.model, data, share=share, per_case=per_case, ranges=layout.ranges)
        found = diagnose(again, work.extra, criteria=work.criteria, brief=True)
    except FittingError:
        return Outcome(*item, _FAILED, (), math.nan, {})
    best = found.candidates[0] if found.candidates else None
    named: tuple[str, ...] = ()
    if best is not None and found.verdict == "missing_effect":
        named = (best.effect.name, *best.indistinguishable_from)
    final = best.fit if best is not None and named else again
    inside = {}
    if final is not None and set(final.model.names) == set(hypothesis.fit.model.names):
        inside = _inside(final, hypothesis.fit)
    return Outcome(*item, found.verdict, named, best.score if best is not None else 0.0, inside)


def _inside(found: Fit, truth: Fit) -> dict[str, bool]:
    """Return whether the 95 % interval of each physical parameter contains the simulated value."""
    if not found.converged:
        return {}
    total = combined_uncertainties(found)
    return {
        name: abs(e.value - truth.estimates[name].value) <= _INTERVAL * max(total.get(name, 0.0), e.stderr)
        for name, e in found.estimates.items()
        if name in truth.estimates and e.stderr > 0 and math.isfinite(e.stderr)
    }
