"""The answer in words: where the model fails, what is missing, what remains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fitting.diagnosis import Failure
from fitting.discovery.improve import Rung
from fitting.discovery.objection import Objection
from fitting.discovery.ranking import ALWAYS_FREE, Candidate
from fitting.discovery.spectral_line import SpectralLine
from fitting.estimation import Fit
from fitting.rounding import rounded

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
        if c.effect.name in ALWAYS_FREE and c.significant:
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
