"""The answer: adequate, this effect (or this class) is missing, or an unexplained torque remains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from fitting.beside import Beside
from fitting.diagnosis import (
    Failure,
    ResidualTorque,
    Ripple,
    Whiteness,
    find_failures,
    residual_torques,
    ripples,
    whiteness,
)
from fitting.discovery.any_law import any_law_of_the_casing, any_slow_torque
from fitting.discovery.experiment import next_experiment
from fitting.discovery.improve import Rung, best, improve
from fitting.discovery.objection import Objection, objection
from fitting.discovery.polish import is_quieter, polished, reconsidered
from fitting.discovery.ranking import CLASS_WIDTH, Candidate, rank
from fitting.discovery.spectral_line import SpectralLine, spectral_line
from fitting.discovery.wording import UNKNOWN_IN_TIME, UNKNOWN_LAW, sentence
from fitting.effects import Effect
from fitting.estimation import Fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# a second effect may be hidden beside the first; a story of three is told as unexplained
_FOLLOW_UP = 1
# so often is a right name doubted, and a model that misses nothing
_DOUBTFUL = 0.01
_ALARMING = 0.001


@dataclass(frozen=True)
class Diagnosis:
    """Where a model fails and what would mend it.

    Attributes
    ----------
    verdict : {"adequate", "missing_effect", "unexplained"}
        The answer.
    sentence : str
        The answer in words.
    failures : tuple of Failure
        Where it fails, worst first.
    candidates : tuple of Candidate
        What would mend it, best first.
    next_experiment : str
        What to measure to tell the rivals apart; empty if there are none.
    torques : tuple of ResidualTorque
        The torque that is missing, as curves with bands.
    ripples : tuple of Ripple
        What is missing against the angle of the casing, with bands.
    whiteness : tuple of Whiteness
        Whether what is left is independent.
    """

    fit: Fit
    verdict: str
    sentence: str
    failures: tuple[Failure, ...]
    candidates: tuple[Candidate, ...]
    next_experiment: str
    torques: tuple[ResidualTorque, ...] = field(repr=False)
    ripples: tuple[Ripple, ...] = field(repr=False)
    whiteness: tuple[Whiteness, ...] = field(repr=False)

    def plot(self) -> Figure:
        """Draw the torque that is missing with its band, where the model fails, and the candidates (matplotlib)."""
        from fitting.display.plots import plot_diagnosis

        return plot_diagnosis(self)

    def _repr_html_(self) -> str:
        from fitting.display.html import diagnosis_html

        return diagnosis_html(self)


def diagnose(
    fit: Fit,
    extra: Sequence[Effect] = (),
    *,
    candidates: Sequence[Candidate] | None = None,
    beside: Beside | None = None,
) -> Diagnosis:
    """Say where a fit fails and which effect is missing.

    Parameters
    ----------
    fit : Fit
        The fit in question.
    extra : sequence of Effect
        Effects of the user beside the library.
    candidates : sequence of Candidate, optional
        The ranking of the fit, if it is known already.
    beside : Beside, optional
        A second process that takes its share of the work.

    Returns
    -------
    Diagnosis
    """
    beside = beside or Beside()
    left, repeated = beside.begin(residual_torques, fit), beside.begin(ripples, fit)
    candidates = rank(fit, extra, beside=beside) if candidates is None else candidates
    chosen = best(candidates)
    after: list[Rung] = []
    end = fit
    if chosen is not None and chosen.fit is not None:
        end = polished(chosen.fit)
        # noise that fell when the effect was added may have hidden another one, and what tells rivals apart
        quieter = is_quieter(end, chosen.fit)
        if quieter:
            candidates = reconsidered(fit, candidates, chosen, end.noise)
            clearer = best(candidates)
            if clearer is not None and clearer.fit is not None:
                chosen, end = clearer, clearer.fit
        if end.verdict == "misfit" or quieter:
            after = improve(fit, extra, max_steps=1 + _FOLLOW_UP, first=candidates, beside=beside)
            end = after[-1].fit
    doubt = _doubt(chosen, end)
    explained = "adequate" if chosen is None else "missing_effect"
    verdict = "unexplained" if end.verdict == "misfit" or doubt is not None else explained
    others = _unknown(fit, chosen) if verdict == "missing_effect" and chosen is not None else ()
    if chosen is not None and others:
        sure, chosen = chosen, replace(chosen, indistinguishable_from=others)
        candidates = [chosen if c is sure else c for c in candidates]
    torques, waves = left(), repeated()
    failures = find_failures(fit, torques, waves) if verdict != "adequate" else []
    words = sentence(fit, verdict, chosen, after, failures, candidates, doubt)
    rivals = [c for c in candidates if chosen and c.effect.name in chosen.indistinguishable_from]
    return Diagnosis(
        fit,
        verdict,
        words,
        tuple(failures),
        tuple(candidates),
        next_experiment(fit, [chosen, *rivals] if chosen else []),
        tuple(torques),
        tuple(waves),
        tuple(whiteness(fit)),
    )


def _unknown(fit: Fit, chosen: Candidate) -> tuple[str, ...]:
    """Return what no library has and would do as well as a single name.

    An effect that swings, or sets in at a time of its own, can look like a law of the casing's speed; one that swings
    so slowly that it hardly comes back looks like anything that changes in time.
    """
    if chosen.indistinguishable_from or not chosen.physical:
        return ()
    bar = max(chosen.score, chosen.screened.score) - CLASS_WIDTH
    found = []
    if not chosen.effect.of_casing_speed and any_law_of_the_casing(fit) > bar:
        found.append(UNKNOWN_LAW)
    if chosen.effect.swings and any_slow_torque(fit, apart=chosen.apart) > bar:
        found.append(UNKNOWN_IN_TIME)
    return tuple(found)


def _doubt(chosen: Candidate | None, end: Fit) -> Objection | SpectralLine | None:
    """Return what speaks against an answer."""
    if end.verdict == "misfit":
        return None
    line = spectral_line(end)
    if line is not None and line.p_value < _ALARMING:
        return line
    # a class of names leaves the question of the law open by itself
    if chosen is not None and chosen.indistinguishable_from:
        return None
    found = objection(end)
    return found if found.p_value < (_ALARMING if chosen is None else _DOUBTFUL) else None
