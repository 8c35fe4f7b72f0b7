"""The verdict: adequate, missing effect, or unexplained; and its sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from fitting._numbers import rounded
from fitting._workers import WorkerPool, single_blas_thread
from fitting.discovery._experiment import next_experiment
from fitting.discovery._lack_of_fit import (
    Objection,
    SpectralLine,
    any_law_of_the_casing,
    any_slow_torque,
    objection,
    spectral_line,
)
from fitting.discovery._rank import CLASS_WIDTH, Candidate, rank
from fitting.discovery._residuals import (
    Failure,
    ResidualTorque,
    Ripple,
    Whiteness,
    find_failures,
    residual_torques,
    ripples,
    whiteness,
)
from fitting.discovery._select import Rung, best, improve, is_quieter, polished, reconsidered
from fitting.effects._effect import Effect
from fitting.inference._result import Fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# stand among the names of a class
UNKNOWN_LAW = "a law of omega_c that the library does not have"
UNKNOWN_IN_TIME = "a torque that changes slowly in time"


def sentence(
    fit: Fit,
    verdict: str,
    chosen: Candidate | None,
    after: Sequence[Rung],
    failures: Sequence[Failure],
    candidates: Sequence[Candidate],
    doubt: Objection | SpectralLine | None = None,
) -> str:
    """Return the answer of a diagnosis in a few sentences.

    Parameters
    ----------
    fit : Fit
        The base.
    verdict : str
        "adequate", "missing_effect" or "unexplained".
    chosen : Candidate or None
        The effect to add.
    after : sequence of Rung
        What was added to the base, step by step, if one effect was not enough.
    failures : sequence of Failure
        Where the base fails, worst first.
    candidates : sequence of Candidate
        All of them.
    doubt : Objection or SpectralLine, optional
        What speaks against the name.
    """
    if verdict == "adequate":
        parts = ["The model is adequate: what it leaves is noise."]
    else:
        parts = [f"The model fails{f': {failures[0]}' if failures else ''}."]
        if chosen is None or verdict == "unexplained":
            parts += _remains(after[-1].fit if after else fit, chosen, doubt)
        else:
            parts += _missing(chosen, after)
        parts += _edges(fit)
    return " ".join([*parts, *_taken_out(chosen, candidates)])


def _remains(rest: Fit, chosen: Candidate | None, doubt: Objection | SpectralLine | None) -> list[str]:
    if doubt is not None:
        what = f"What {'it' if chosen is None else chosen.effect.name} leaves {doubt.words}"
        parts = [f"{what}, as noise does in {doubt.p_value:.1g} of all cases."]
        if isinstance(doubt, SpectralLine):
            return [
                *parts,
                f'No effect of the library does: add "{doubt.law}" as a hypothesis, and diagnose again.',
            ]
        if chosen is None:
            return [*parts, "No effect of the library explains it."]
        cause = "A second effect is missing as well, or a law that the library does not have"
        return [*parts, f"{cause}: take the formula of {chosen.effect.name}, the closest, as a hypothesis."]
    left = max((n.level for n in rest.noise), default=0.0)
    parts = [f"An unexplained torque of {left:.2g} N m rms remains that no effect of the library explains."]
    if chosen is not None:
        parts.append(f"The closest formula is that of {chosen.effect.name}; take it as a hypothesis.")
    return parts


def _missing(chosen: Candidate, after: Sequence[Rung]) -> list[str]:
    names = [chosen.effect.name, *chosen.indistinguishable_from]
    what = "effect" if chosen.physical else "measurement effect"
    if names[1:] and {UNKNOWN_LAW, UNKNOWN_IN_TIME}.issuperset(names[1:]):
        others = ", or ".join(names[1:])
        parts = [
            f"What is missing is {names[0]}{_strength(chosen)}, or {others}; this data cannot tell them apart."
        ]
    elif len(names) == 1:
        parts = [f"The missing {what} is {names[0]}{_strength(chosen)}."]
    else:
        parts = [f"One of {', '.join(names)} is missing; this data cannot tell them apart."]
    if chosen.apart:
        own = [
            f"--per-case {k}"
            for k in dict.fromkeys(k.partition("@")[0] for k in chosen.estimates if "@" in k)
        ]
        parts.append(f"Each case has a strength and a phase of its own: for fit, {' '.join(own)}.")
    if len(after) > 2:
        parts.append("With it " + ", ".join(r.change.lstrip("+") for r in after[2:]) + " is found as well.")
    return parts


def _edges(fit: Fit) -> list[str]:
    """Return what to know of a parameter that its range holds, and not nature or the data."""
    layout = fit.problem.layout
    held = [
        f"{name} at the edge of its range ({e.value:.4g})"
        for name, e in fit.estimates.items()
        if e.at_bound and name in layout.index and not layout.is_physical_bound(name)
    ]
    return [f"The model has {' and '.join(held)}: the law there may be another one."] if held else []


def _taken_out(chosen: Candidate | None, candidates: Sequence[Candidate]) -> list[str]:
    # what a torque that follows the angle leaves unexplained looks like a camera's fault as well
    if chosen is not None and chosen.effect.depends_on_angle:
        return []
    parts = []
    for c in candidates:
        if c.effect.nuisance and c.significant:
            size = float(np.hypot(*c.screened.gamma[:2]))
            unit = next(p.unit for p in c.effect.parameters if p.role == "amplitude")
            parts.append(f"The camera adds {c.effect.name} of {size:.2g} {unit}, which every fit takes out.")
    return parts


def _strength(c: Candidate) -> str:
    amplitude = c.effect.amplitude
    if amplitude is None:
        return ""
    found = [e for k, e in c.estimates.items() if k.partition("@")[0].endswith(f".{amplitude.symbol}")]
    if not found:
        return ""
    values = ", ".join(rounded(e.value, e.stderr, e.unit) for e in found)
    return f" with {amplitude.symbol} = {values}"


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
        from fitting._display import plot_diagnosis

        return plot_diagnosis(self)

    def _repr_html_(self) -> str:
        from fitting._display import diagnosis_html

        return diagnosis_html(self)


@single_blas_thread()
def diagnose(
    fit: Fit,
    extra: Sequence[Effect] = (),
    *,
    candidates: Sequence[Candidate] | None = None,
    workers: WorkerPool | None = None,
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
    workers : WorkerPool, optional
        A second process that takes its share of the work.

    Returns
    -------
    Diagnosis
    """
    workers = workers or WorkerPool(0)
    left, repeated = workers.submit(residual_torques, fit), workers.submit(ripples, fit)
    candidates = rank(fit, extra, workers=workers) if candidates is None else candidates
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
            after = improve(fit, extra, max_steps=1 + _FOLLOW_UP, first=candidates, workers=workers)
            end = after[-1].fit
    doubt = _doubt(chosen, end)
    explained = "adequate" if chosen is None else "missing_effect"
    verdict = "unexplained" if end.verdict == "misfit" or doubt is not None else explained
    others = _unknown(fit, chosen) if verdict == "missing_effect" and chosen is not None else ()
    if chosen is not None and others:
        sure, chosen = chosen, replace(chosen, indistinguishable_from=others)
        candidates = [chosen if c is sure else c for c in candidates]
    torques, waves = left.result(), repeated.result()
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
    if chosen.effect.periodic and any_slow_torque(fit, apart=chosen.apart) > bar:
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
