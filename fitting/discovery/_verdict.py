"""The answer: verdict, sentences, and the line of stages that leads to them.

    rank (score, refine) -> select -> lack of fit -> verdict

Each stage takes what the one before returns; nothing goes back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from fitting._numbers import rounded
from fitting._workers import WorkerPool, single_blas_thread
from fitting.discovery._criteria import DEFAULT, Criteria
from fitting.discovery._experiment import next_experiment
from fitting.discovery._lack_of_fit import (
    UNKNOWN_IN_TIME,
    UNKNOWN_LAW,
    PeriodogramPeak,
    SmoothTest,
    contradiction,
    nonparametric_rivals,
)
from fitting.discovery._residuals import (
    Failure,
    ResidualTorque,
    Ripple,
    Whiteness,
    find_failures,
    micro_newton_metres,
    residual_torques,
    ripples,
    whiteness,
)
from fitting.discovery._select import Candidate, Selection, fails, rank, select
from fitting.effects._effect import Effect
from fitting.inference._result import Fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Diagnosis:
    """Where a model fails and which effects are candidates.

    Attributes
    ----------
    fit : Fit
        The fit in question.
    verdict : {"adequate", "missing_effect", "unexplained"}
        The answer.
    sentence : str
        The answer in words.
    failures : tuple of Failure
        Where it fails, most significant first.
    candidates : tuple of Candidate
        Candidate effects, best first.
    next_experiment : str
        The measurement that separates the rivals; empty if there are none.
    torques : tuple of ResidualTorque
        The unmodelled torque, as curves with bands.
    ripples : tuple of Ripple
        Harmonics of the unmodelled torque in the angle of the casing, with bands.
    whiteness : tuple of Whiteness
        Whether the residuals are independent.
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
        """Draw the unmodelled torque with its band, where the model fails, and the candidates (matplotlib)."""
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
    criteria: Criteria = DEFAULT,
    candidates: Sequence[Candidate] | None = None,
    workers: WorkerPool | None = None,
) -> Diagnosis:
    """Return where a fit fails and which effect is missing.

    Parameters
    ----------
    fit : Fit
        The fit in question.
    extra : sequence of Effect
        Effects of the user, besides the library.
    criteria : Criteria
        Thresholds of every decision.
    candidates : sequence of Candidate, optional
        The ranking of the fit, if it is known already.
    workers : WorkerPool, optional
        Processes that share the work.

    Returns
    -------
    Diagnosis

    Raises
    ------
    FittingError
        If the fit cannot be evaluated.
    """
    workers = workers or WorkerPool(0)
    curves, harmonics = workers.submit(residual_torques, fit), workers.submit(ripples, fit)
    ranked = rank(fit, extra, criteria=criteria, workers=workers) if candidates is None else candidates
    selection = select(fit, ranked, extra, criteria, workers)
    misfit = fails(selection.end, criteria)
    doubt = None if misfit else contradiction(selection.chosen, selection.end, criteria)
    verdict = "unexplained" if misfit or doubt else "missing_effect" if selection.chosen else "adequate"
    if verdict == "missing_effect":
        selection = _with_rivals(selection, nonparametric_rivals(fit, selection.chosen, criteria))
    torques, waves = curves.result(), harmonics.result()
    failures = find_failures(fit, torques, waves, criteria) if verdict != "adequate" else []
    return Diagnosis(
        fit,
        verdict,
        _sentence(fit, verdict, selection, failures, doubt),
        tuple(failures),
        tuple(selection.candidates),
        next_experiment(fit, _class_of(selection), criteria),
        tuple(torques),
        tuple(waves),
        tuple(whiteness(fit)),
    )


def _with_rivals(selection: Selection, rivals: tuple[str, ...]) -> Selection:
    if selection.chosen is None or not rivals:
        return selection
    chosen = replace(selection.chosen, indistinguishable_from=rivals)
    ranked = [chosen if c is selection.chosen else c for c in selection.candidates]
    return selection._replace(candidates=ranked, chosen=chosen)


def _class_of(selection: Selection) -> list[Candidate]:
    """Return the chosen candidate and those that are indistinguishable from it."""
    chosen = selection.chosen
    if chosen is None:
        return []
    return [chosen, *(c for c in selection.candidates if c.effect.name in chosen.indistinguishable_from)]


def _sentence(
    fit: Fit,
    verdict: str,
    selection: Selection,
    failures: Sequence[Failure],
    doubt: SmoothTest | PeriodogramPeak | None,
) -> str:
    """Return the answer in a few sentences."""
    if verdict == "adequate":
        parts = ["The residuals are consistent with noise; the model is adequate."]
    else:
        parts = [f"Significant lack of fit{f': {failures[0]}' if failures else ''}."]
        parts += _unexplained(selection, doubt) if verdict == "unexplained" else _missing(selection)
        parts += _active_bounds(fit)
    return " ".join([*parts, *_nuisance(selection)])


def _unexplained(selection: Selection, doubt: SmoothTest | PeriodogramPeak | None) -> list[str]:
    chosen = selection.chosen
    if doubt is None:
        level = max((n.level for n in selection.end.noise), default=0.0)
        parts = [
            f"An unexplained torque of {micro_newton_metres(level)} rms remains; no effect of the library explains it."
        ]
        if chosen is not None:
            parts.append(f"The closest law is {chosen.effect.name}; treat it as a hypothesis.")
        return parts
    after = "" if chosen is None else f" after {chosen.effect.name}"
    parts = [f"The residual torque{after} {doubt.words} (p = {doubt.p_value:.1g})."]
    if isinstance(doubt, PeriodogramPeak):
        return [
            *parts,
            f'No effect of the library explains it: add "{doubt.law}" as a hypothesis and diagnose again.',
        ]
    if chosen is None:
        return [*parts, "No effect of the library explains it."]
    return [
        *parts,
        "A second effect is missing, or a law that is not in the library.",
        f"Treat {chosen.effect.name}, the closest, as a hypothesis.",
    ]


def _missing(selection: Selection) -> list[str]:
    chosen = selection.chosen
    if chosen is None:
        return []
    names = [chosen.effect.name, *chosen.indistinguishable_from]
    what = "effect" if chosen.physical else "measurement effect"
    if names[1:] and {UNKNOWN_LAW, UNKNOWN_IN_TIME}.issuperset(names[1:]):
        others = ", or ".join(names[1:])
        parts = [
            f"The missing effect is {names[0]}{_strength(chosen)}, or {others}; this data cannot separate them."
        ]
    elif len(names) == 1:
        parts = [f"The missing {what} is {names[0]}{_strength(chosen)}."]
    else:
        parts = [f"One of {', '.join(names)} is missing; this data cannot separate them."]
    if chosen.own_phase:
        own = dict.fromkeys(k.partition("@")[0] for k in chosen.estimates if "@" in k)
        parts.append(
            f"Each case has its own strength and phase: add {' '.join(f'--per-case {k}' for k in own)} to `fit`."
        )
    if len(selection.history) > 2:
        parts.append(f"Also found: {', '.join(s.change.lstrip('+') for s in selection.history[2:])}.")
    return parts


def _active_bounds(fit: Fit) -> list[str]:
    """Return the parameters whose range, not nature or the data, determines their value."""
    layout = fit.problem.layout
    held = [
        f"{name} = {e.value:.4g}"
        for name, e in fit.estimates.items()
        if e.at_bound and name in layout.index and not layout.is_physical_bound(name)
    ]
    return [f"Active bound: {', '.join(held)}; the law there may be another one."] if held else []


_NUISANCE = {
    "camera.centre": "Camera centre offset",
    "camera.tilt": "Camera tilt",
    "camera.shutter": "Rolling shutter",
}


def _nuisance(selection: Selection) -> list[str]:
    # an unexplained torque that depends on the angle looks like a camera effect as well
    if selection.chosen is not None and selection.chosen.effect.depends_on_angle:
        return []
    parts = []
    for c in selection.candidates:
        if c.effect.nuisance and c.significant:
            size = float(np.hypot(*c.screened.gamma[:2]))
            unit = next(p.unit for p in c.effect.parameters if p.role == "amplitude")
            parts.append(f"{_NUISANCE[c.effect.name]} {1e3 * size:.2g} m{unit} (nuisance parameter, fitted).")
    return parts


def _strength(c: Candidate) -> str:
    if c.effect.amplitude is None:
        return ""
    symbol = c.effect.amplitude.symbol
    found = [e for k, e in c.estimates.items() if k.partition("@")[0].endswith(f".{symbol}")]
    return f", {symbol} = {', '.join(rounded(e.value, e.stderr, e.unit) for e in found)}" if found else ""
