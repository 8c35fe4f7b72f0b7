"""Fits, diagnoses and ladders as plain numbers for JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from fitting.diagnosis import ResidualTorque
from fitting.discovery import Candidate, Diagnosis, Rung
from fitting.estimation import Estimate, Fit
from fitting.estimation.account import not_determined
from fitting.estimation.covariance import loose_directions
from fitting.estimation.profile import LEVEL, Interval
from fitting.rotor_curve import CurveBias
from fitting.rounding import rounded

__all__ = [
    "diagnosis_document",
    "fit_document",
    "interval_document",
    "ladder_verdict",
    "not_determined",
    "not_determined_together",
    "rounded",
    "rung_document",
]

_CURVE_POINTS = 200


def fit_document(fit: Fit, fit_id: str) -> dict[str, Any]:
    """Return a fit under the keys that other programs rely on."""
    return {
        "fit_id": fit_id,
        "model": list(fit.model.names),
        "parameters": {k: _estimate(e) for k, e in fit.estimates.items()},
        "cases": [
            {
                "label": c.label,
                "casing": _body(c.casing),
                "rotor": _body(c.rotor),
                "energy_drift": c.energy_drift,
                "misfit": c.misfit,
                "torque_noise_Nm": n.pure,
                "torque_left_Nm": n.level,
                "noise_scale": n.scale,
            }
            for c, n in zip(fit.cases, fit.noise, strict=True)
        ],
        "n_eff": fit.n_eff,
        "bic": fit.bic,
        "verdict": fit.verdict,
        "equations": list(fit.model.equations(single=fit.problem.data[0].record.single)),
        "not_determined": not_determined(fit.estimates),
        "not_determined_together": not_determined_together(fit),
    }


def bias_document(bias: Mapping[str, CurveBias]) -> dict[str, dict[str, float]]:
    """Return what a generated rotor curve did to each parameter as plain numbers."""
    return {name: {**asdict(b), "errors": b.errors} for name, b in bias.items()}


def not_determined_together(fit: Fit) -> list[dict[str, float]]:
    """Return combinations of parameters that the data does not hold: relative changes by name, the largest 1."""
    kept = [i for i, n in enumerate(fit.problem.layout.names) if not n.startswith("initial.")]
    names = [fit.problem.layout.names[i] for i in kept]
    return loose_directions(names, fit.theta[kept], fit.covariance[np.ix_(kept, kept)])


def interval_document(interval: Interval) -> dict[str, Any]:
    """Return a 95 % interval as plain numbers."""
    return {"level": LEVEL, **asdict(interval)}


def _estimate(e: Estimate) -> dict[str, Any]:
    return {"value": e.value, "stderr": e.stderr, "unit": e.unit, "at_bound": e.at_bound}


def _body(metrics: Any) -> dict[str, float]:
    return {k: getattr(metrics, k) for k in ("r2", "rmse", "reduced_chi2", "held_out")}


def diagnosis_document(d: Diagnosis, fit_id: str) -> dict[str, Any]:
    """Return a diagnosis under the keys that other programs rely on."""
    return {
        "fit_id": fit_id,
        "verdict": d.verdict,
        "sentence": d.sentence,
        "failures": [
            {
                "label": f.label,
                "body": f.body,
                "t_start": f.t_start,
                "t_stop": f.t_stop,
                "kind": f.kind,
                "where": f.where,
                "size_sigma": f.size_sigma,
                "residual_rad_s": f.residual_rad_s,
                "residual_torque_Nm": f.residual_torque_Nm,
                "omega_c": list(f.omega_c),
            }
            for f in d.failures
        ],
        "candidates": [_candidate(c) for c in d.candidates],
        "next_experiment": d.next_experiment,
        "whiteness": [{"label": w.label, "p_value": w.p_value} for w in d.whiteness],
        "energy_drift": {c.label: c.energy_drift for c in d.fit.cases},
        "residual_torque": [_curve(t) for t in d.torques],
        "residual_ripple": [
            {
                "label": r.label,
                "angle": r.angle.tolist(),
                "torque_Nm": r.torque.tolist(),
                "sigma_Nm": r.sigma.tolist(),
            }
            for r in d.ripples
        ],
    }


def _curve(torque: ResidualTorque) -> dict[str, Any]:
    """Return a residual torque with what it can be drawn against."""
    step = max(1, len(torque.time) // _CURVE_POINTS)
    return {
        "label": torque.label,
        "body": torque.body,
        "time": torque.time[::step].tolist(),
        "omega_r": torque.omega_r[::step].tolist(),
        "omega_c": torque.omega_c[::step].tolist(),
        "delta": (torque.omega_r - torque.omega_c)[::step].tolist(),
        "torque_Nm": torque.torque[::step].tolist(),
        "sigma_Nm": torque.sigma[::step].tolist(),
    }


def _candidate(c: Candidate) -> dict[str, Any]:
    return {
        "effect": c.effect.name,
        "kind": c.effect.kind,
        "score": c.score,
        "delta_bic": c.delta_bic,
        "p_value": c.p_value,
        "significant": c.significant,
        "held_out_gain": c.held_out_gain,
        "indistinguishable_from": list(c.indistinguishable_from),
        "parameters": {k: _estimate(e) for k, e in c.estimates.items()},
        "law": f"{c.effect.joint}: {c.effect.law}",
    }


def rung_document(fit: Fit, fit_id: str, added: str, previous: Fit | None) -> dict[str, Any]:
    """Return one rung of a ladder: what was added and what the error did."""
    cases = fit.cases
    return {
        "fit_id": fit_id,
        "added": added,
        "model": list(fit.model.names),
        "rmse_casing": math.sqrt(sum(c.casing.rmse**2 for c in cases) / len(cases)),
        "reduced_chi2": fit.reduced_chi2,
        "held_out": math.sqrt(sum(c.casing.held_out**2 for c in cases) / len(cases)),
        "delta_bic": fit.bic - previous.bic if previous is not None else 0.0,
        "energy_drift": max(c.energy_drift for c in cases),
        "torque_left_Nm": fit.torque_noise,
        "moved": _moved(fit, previous),
        "verdict": fit.verdict,
    }


def _moved(fit: Fit, previous: Fit | None) -> list[str]:
    """Return the parameters that moved by more than three of their errors."""
    if previous is None:
        return []
    return [
        k
        for k, e in fit.estimates.items()
        if k in previous.estimates
        and not k.startswith("initial.")
        and abs(e.value - previous.estimates[k].value) > 3 * max(e.stderr, 0.0)
    ]


def ladder_verdict(rungs: Sequence[Rung]) -> str:
    """Return "adequate", "missing_effect" (found and added) or "unexplained" for a finished ladder."""
    if rungs[-1].fit.verdict != "adequate":
        return "unexplained"
    return "missing_effect" if len(rungs) > 1 else "adequate"
