"""The answer: adequate, this effect (or this class) is missing, or an unexplained torque remains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

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
from fitting.discovery.experiment import next_experiment
from fitting.discovery.improve import Rung, best, improve
from fitting.discovery.polish import is_quieter, polished, reconsidered
from fitting.discovery.ranking import ALWAYS_FREE, Candidate, rank
from fitting.effects import Effect
from fitting.estimation import Fit
from fitting.rounding import rounded

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# a second effect may be hidden beside the first; a story of three is told as unexplained
_FOLLOW_UP = 1


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
    fit: Fit, extra: Sequence[Effect] = (), *, candidates: Sequence[Candidate] | None = None
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

    Returns
    -------
    Diagnosis
    """
    candidates = rank(fit, extra) if candidates is None else candidates
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
            after = improve(fit, extra, max_steps=1 + _FOLLOW_UP, first=candidates)
            end = after[-1].fit
    explained = "adequate" if chosen is None else "missing_effect"
    verdict = "unexplained" if end.verdict == "misfit" else explained
    torques, waves = residual_torques(fit), ripples(fit)
    failures = find_failures(fit, torques, waves) if verdict != "adequate" else []
    sentence = _sentence(fit, verdict, chosen, after, failures, candidates)
    rivals = [c for c in candidates if chosen and c.effect.name in chosen.indistinguishable_from]
    return Diagnosis(
        fit,
        verdict,
        sentence,
        tuple(failures),
        tuple(candidates),
        next_experiment(fit, [chosen, *rivals] if chosen else []),
        tuple(torques),
        tuple(waves),
        tuple(whiteness(fit)),
    )


def _sentence(
    fit: Fit,
    verdict: str,
    chosen: Candidate | None,
    after: list[Rung],
    failures: list[Failure],
    candidates: Sequence[Candidate],
) -> str:
    parts = []
    where = str(failures[0]) if failures else ""
    if verdict == "adequate":
        parts.append("The model is adequate: what it leaves is noise.")
    elif chosen is None or verdict == "unexplained":
        rest = after[-1].fit if after else fit
        left = max((n.level for n in rest.noise), default=0.0)
        parts.append(f"The model fails{': ' + where if where else ''}.")
        parts.append(
            f"An unexplained torque of {left:.2g} N m rms remains that no effect of the library explains."
        )
        if chosen is not None:
            parts.append(f"The closest formula is that of {chosen.effect.name}; take it as a hypothesis.")
    else:
        parts.append(f"The model fails{': ' + where if where else ''}.")
        names = [chosen.effect.name, *chosen.indistinguishable_from]
        what = "measurement effect" if not chosen.physical else "effect"
        if len(names) == 1:
            parts.append(f"The missing {what} is {names[0]}{_strength(chosen)}.")
        else:
            parts.append(f"One of {', '.join(names)} is missing; this data cannot tell them apart.")
        if len(after) > 2:
            parts.append(
                "With it " + ", ".join(r.change.lstrip("+") for r in after[2:]) + " is found as well."
            )
    for c in candidates:
        # what a torque that follows the angle leaves unexplained looks like a camera's fault as well
        rippling = chosen is not None and chosen.effect.depends_on_angle
        if c.effect.name in ALWAYS_FREE and c.significant and not rippling:
            size = float(np.hypot(*c.screened.gamma[:2]))
            unit = next(p.unit for p in c.effect.parameters if p.role == "amplitude")
            parts.append(f"The camera adds {c.effect.name} of {size:.2g} {unit}, which every fit takes out.")
    return " ".join(parts)


def _strength(c: Candidate) -> str:
    amplitude = c.effect.amplitude
    if amplitude is None:
        return ""
    found = [e for k, e in c.estimates.items() if k.partition("@")[0].endswith(f".{amplitude.symbol}")]
    if not found:
        return ""
    values = ", ".join(rounded(e.value, e.stderr, e.unit) for e in found)
    return f" with {amplitude.symbol} = {values}"
