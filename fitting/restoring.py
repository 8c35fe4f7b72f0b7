"""Fits and diagnoses shown again as they were, without finding them again.

A fit is its variables and the noise about it: with both, and the data, everything else follows by one prediction. A
diagnosis is its words and its ranking; its curves follow from its fit. What was kept counts only for the
very same code and data: see `fingerprint`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from importlib import resources
from importlib.metadata import version
from typing import Any

import numpy as np

from fitting.case_data import CaseData
from fitting.diagnosis import Failure, residual_torques, ripples, whiteness
from fitting.discovery import Candidate, Diagnosis
from fitting.discovery.scoring import Score
from fitting.effects import Effect
from fitting.effects.stored import effects_of, own_effects
from fitting.estimation import Estimate, Fit
from fitting.estimation.layout import Layout
from fitting.estimation.noise_levels import Noise
from fitting.estimation.outcome import outcome
from fitting.estimation.problem import Problem
from fitting.model import Model
from fitting.noise import TorqueNoise, TorqueResponse
from fitting.plain import number, plain

# the fits of so many candidates are kept, best first: more curves than a report draws
_FITS = 4


@cache
def fingerprint() -> str:
    """Return a digest of the code that fits: this package, numpy and scipy."""
    digest = hashlib.sha256(f"numpy {version('numpy')} scipy {version('scipy')}".encode())
    folder = resources.files("fitting")

    def add(place: Any, name: str) -> None:
        for part in sorted(place.iterdir(), key=lambda p: str(p.name)):
            if part.is_dir():
                add(part, f"{name}/{part.name}")
            elif part.name.endswith(".py"):
                digest.update(f"{name}/{part.name}\n".encode() + part.read_bytes())

    add(folder, "fitting")
    return digest.hexdigest()


def kept_fit(fit: Fit) -> dict[str, Any]:
    """Return what a fit of least squares can be restored from."""
    layout = fit.problem.layout
    return {
        "code": fingerprint(),
        "theta": fit.theta.tolist(),
        "per_case": list(layout.per_case),
        "ranges": {k: list(v) for k, v in layout.ranges.items()},
        "noise": [
            {k: getattr(n, k) for k in ("scale", "pure", "level", "time", "excess")} for n in fit.noise
        ],
        "converged": fit.converged,
    }


def restored_fit(kept: Mapping[str, Any], model: Model, data: Sequence[CaseData]) -> Fit | None:
    """Return a fit as it was; None if other code made it.

    The noise is linearised about the end of the fit instead of about the place from which the last search began:
    figures of merit agree with the original's to a few digits more than their uncertainty.
    """
    if kept.get("code") != fingerprint():
        return None
    ranges = {k: (number(low), number(high)) for k, (low, high) in kept["ranges"].items()}
    problem = Problem(Layout(model, tuple(d.record for d in data), tuple(kept["per_case"]), ranges), data)
    theta = np.array(kept["theta"], dtype=float)
    noise = []
    for d, p, n in zip(data, problem.predict(theta), kept["noise"], strict=True):
        response = TorqueResponse(d, p.motion)
        noise.append(Noise(**n, whitener=response.whitener(TorqueNoise(n["level"], n["time"]))))
    problem.set_noise([n.whitener for n in noise])
    return outcome(problem, theta, tuple(noise), converged=bool(kept["converged"]))


def kept_diagnosis(found: Diagnosis, extra: Sequence[Effect] = ()) -> dict[str, Any]:
    """Return what a diagnosis can be restored from, beside its fit; `extra` is what `diagnose` was given."""
    drawn = [c for c in found.candidates if c.fit is not None and c.physical and c.significant][:_FITS]
    return {
        "code": fingerprint(),
        "extra": own_effects(extra),
        "verdict": found.verdict,
        "sentence": found.sentence,
        "failures": [asdict(f) for f in found.failures],
        "candidates": [_kept_candidate(c, fit=any(c is d for d in drawn)) for c in found.candidates],
        "next_experiment": found.next_experiment,
    }


def _kept_candidate(c: Candidate, *, fit: bool) -> dict[str, Any]:
    return {
        "effect": c.effect.name,
        "own_effects": own_effects([c.effect]),
        **{k: getattr(c, k) for k in _SCORES},
        "indistinguishable_from": list(c.indistinguishable_from),
        "estimates": {k: asdict(e) for k, e in c.estimates.items()},
        "fit": kept_fit(c.fit) if fit and c.fit is not None else None,
    }


_SCORES = ("score", "delta_bic", "p_value", "held_out_gain")


def restored_diagnosis(kept: Mapping[str, Any], fit: Fit, extra: Sequence[Effect] = ()) -> Diagnosis | None:
    """Return the diagnosis of a fit as it was; None if other code made it, or with other effects of the user.

    Its candidates have no screen behind them: it is for showing, not for going on from.

    Parameters
    ----------
    kept : mapping
        What `kept_diagnosis` returned, as it was read.
    fit : Fit
        The fit that was diagnosed.
    extra : sequence of Effect
        Effects of the user.
    """
    if kept.get("code") != fingerprint() or kept.get("extra") != plain(own_effects(extra)):
        return None
    return Diagnosis(
        fit,
        kept["verdict"],
        kept["sentence"],
        tuple(Failure(**f | {"omega_c": tuple(f["omega_c"])}) for f in kept["failures"]),
        tuple(_candidate(c, fit) for c in kept["candidates"]),
        kept["next_experiment"],
        tuple(residual_torques(fit)),
        tuple(ripples(fit)),
        tuple(whiteness(fit)),
    )


def _candidate(kept: Mapping[str, Any], base: Fit) -> Candidate:
    (effect,) = effects_of([kept["effect"]], kept["own_effects"])
    scores = {k: number(kept[k]) for k in _SCORES}
    fit = kept["fit"] and restored_fit(kept["fit"], base.model.with_effect(effect), base.problem.data)
    none = np.zeros(0)
    return Candidate(
        effect,
        **scores,
        indistinguishable_from=tuple(kept["indistinguishable_from"]),
        estimates={
            k: Estimate(number(e["value"]), number(e["stderr"]), e["unit"], e["at_bound"])
            for k, e in kept["estimates"].items()
        },
        screened=Score(effect, scores["score"], none, (), 0, 0, absorbed=False, direction=none, null=none),
        fit=fit or None,
    )
