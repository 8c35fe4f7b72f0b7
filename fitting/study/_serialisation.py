"""Fits, diagnoses and histories as JSON documents, and back.

A fit is its variables and the noise about it: with both, and the data, everything else follows by one prediction. A
diagnosis is its words and its ranking; its curves follow from its fit. What was kept counts only for the
very same code and data: see `fingerprint`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting._atomic import write_text
from fitting._errors import FittingError, LedgerError
from fitting._numbers import from_json, rounded, to_json
from fitting.discovery._remainder import Nuisance, Remainder
from fitting.discovery._residuals import Failure, ResidualTorque, residual_torques, ripples, whiteness
from fitting.discovery._score import Score
from fitting.discovery._select import Candidate, Step
from fitting.discovery._verdict import Diagnosis
from fitting.dynamics._model import Model
from fitting.effects._effect import Effect
from fitting.effects._user import effects_of, own_effects
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._metrics import BodyMetrics, CaseMetrics
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse
from fitting.inference._parameters import ParameterLayout
from fitting.inference._problem import Problem, degenerate_directions
from fitting.inference._profile import LEVEL, Interval
from fitting.inference._record import Record
from fitting.inference._result import Estimate, Fit, FitSummary, not_determined, outcome
from fitting.study._paper import CurveBias

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
    return degenerate_directions(names, fit.theta[kept], fit.covariance[np.ix_(kept, kept)])


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
        "form": d.form,
        "explained": d.explained,
        "remainder": asdict(d.remainder) if d.remainder is not None else None,
        "nuisance": [asdict(n) for n in d.nuisance],
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
    return {
        "fit_id": fit_id,
        "added": added,
        "model": list(fit.model.names),
        "rmse_casing": fit.rmse_casing,
        "reduced_chi2": fit.reduced_chi2,
        "held_out": fit.held_out,
        "delta_bic": fit.bic - previous.bic if previous is not None else 0.0,
        "energy_drift": max(c.energy_drift for c in fit.cases),
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


def ladder_verdict(rungs: Sequence[Step]) -> str:
    """Return "adequate", "missing_effect" (found and added) or "unexplained" for a finished ladder."""
    if rungs[-1].fit.verdict != "adequate":
        return "unexplained"
    return "missing_effect" if len(rungs) > 1 else "adequate"


Array = NDArray[np.float64]

FORMAT = "gyrotrack fit"
VERSION = 1
_NUMBERS = ("chi2", "rows", "n_eff", "deviance", "bic")


@dataclass(frozen=True)
class SavedNoise:
    """Rms of the random torque of one case [N m]: what no slow torque explains, and what the model leaves."""

    pure: float
    level: float
    scale: float


@dataclass(frozen=True, repr=False)
class SavedFit(FitSummary):
    """A fit read from a file: everything but the data.

    Attributes
    ----------
    names : tuple of str
        The variables, in the order of `covariance`.
    covariance : ndarray
        Of the variables, in SI units.
    sources, digests : tuple of str
        Files and SHA-256 of the data that were fitted.
    """

    model: Model
    labels: tuple[str, ...]
    estimates: Mapping[str, Estimate]
    cases: tuple[CaseMetrics, ...]
    chi2: float
    rows: int
    n_eff: float
    deviance: float
    bic: float
    verdict: str
    noise: tuple[SavedNoise, ...]
    names: tuple[str, ...]
    covariance: Array
    sources: tuple[str, ...]
    digests: tuple[str, ...]

    def refit(self, cases: Sequence[Record]) -> Fit:
        """Fit the same model again, from these values."""
        return fit(self.model, cases, start={k: e.value for k, e in self.estimates.items()})


def save_fit(found: FitSummary, path: Path) -> None:
    """Write a fit as JSON, whole or not at all.

    Raises
    ------
    LedgerError
        If the file cannot be written.
    """
    write_text(path, json.dumps(_document(found), indent=1, allow_nan=False))


def load_fit(path: str | Path) -> SavedFit:
    """Read a fit that `Fit.save` wrote.

    Raises
    ------
    LedgerError
        If the file is missing, damaged, or no fit.
    """
    path = Path(path)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as fault:
        raise LedgerError(f"{path}: {fault.strerror or fault}") from None
    except (ValueError, RecursionError):
        raise LedgerError(f"{path} is not a saved fit", "save one with Fit.save") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise LedgerError(f"{path} is not a saved fit", "save one with Fit.save")
    if document.get("version") != VERSION:
        raise LedgerError(f"{path} was written by a newer version", "update gyrotrack")
    try:
        return _fit(document)
    except (KeyError, TypeError, ValueError, AttributeError, FittingError) as fault:
        raise LedgerError(f"{path} is damaged: {type(fault).__name__} {fault}"[:200]) from None


def _document(found: FitSummary) -> dict[str, Any]:
    names, covariance, sources, digests = _behind(found)
    document: dict[str, Any] = to_json(
        {
            "format": FORMAT,
            "version": VERSION,
            "model": list(found.model.names),
            "own_effects": own_effects(found.model.effects),
            "labels": [c.label for c in found.cases],
            "estimates": {k: asdict(e) for k, e in found.estimates.items()},
            "cases": [asdict(c) for c in found.cases],
            "noise": [
                {k: getattr(n, k) for k in ("pure", "level", "scale")} for n in getattr(found, "noise", ())
            ],
            "verdict": found.verdict,
            "names": list(names),
            "covariance": covariance.tolist(),
            "sources": list(sources),
            "digests": list(digests),
        }
        | {k: getattr(found, k) for k in _NUMBERS}
    )
    return document


def _behind(found: FitSummary) -> tuple[Sequence[str], Array, Sequence[str], Sequence[str]]:
    if isinstance(found, Fit):
        records = [d.record for d in found.problem.data]
        sources, digests = [r.source for r in records], [r.digest for r in records]
        return found.problem.layout.names, found.covariance, sources, digests
    if isinstance(found, SavedFit):
        return found.names, found.covariance, found.sources, found.digests
    raise LedgerError("only a fit can be saved")


def _fit(document: dict[str, Any]) -> SavedFit:
    covariance = np.array([[from_json(x) for x in row] for row in document["covariance"]], dtype=float)
    names = tuple(str(n) for n in document["names"])
    if covariance.shape != (len(names), len(names)):
        raise ValueError("the covariance has another size")
    return SavedFit(
        model=Model(effects_of(document["model"], document["own_effects"])),
        labels=tuple(str(x) for x in document["labels"]),
        estimates={
            str(k): Estimate(
                from_json(e["value"]), from_json(e["stderr"]), str(e["unit"]), bool(e["at_bound"])
            )
            for k, e in document["estimates"].items()
        },
        cases=tuple(_case(c) for c in document["cases"]),
        chi2=from_json(document["chi2"]),
        rows=int(document["rows"]),
        n_eff=from_json(document["n_eff"]),
        deviance=from_json(document["deviance"]),
        bic=from_json(document["bic"]),
        verdict=str(document["verdict"]),
        noise=tuple(
            SavedNoise(*(from_json(n[k]) for k in ("pure", "level", "scale"))) for n in document["noise"]
        ),
        names=names,
        covariance=covariance,
        sources=tuple(str(s) for s in document["sources"]),
        digests=tuple(str(s) for s in document["digests"]),
    )


def _case(stored: dict[str, Any]) -> CaseMetrics:
    bodies = [
        BodyMetrics(*(from_json(stored[b][k]) for k in ("r2", "rmse", "reduced_chi2", "held_out")))
        for b in ("casing", "rotor")
    ]
    return CaseMetrics(
        str(stored["label"]),
        bodies[0],
        bodies[1],
        from_json(stored["energy_drift"]),
        from_json(stored["misfit"]),
    )


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
    ranges = {k: (from_json(low), from_json(high)) for k, (low, high) in kept["ranges"].items()}
    problem = Problem.of(
        ParameterLayout(model, tuple(d.record for d in data), tuple(kept["per_case"]), ranges), data
    )
    theta = np.array(kept["theta"], dtype=float)
    noise = []
    for d, p, n in zip(data, problem.predict(theta), kept["noise"], strict=True):
        response = TorqueResponse(d, p.motion)
        noise.append(Noise(**n, whitener=response.whitener(TorqueNoise(n["level"], n["time"]))))
    return outcome(problem.with_noise(noise), theta, tuple(noise), converged=bool(kept["converged"]))


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
        "form": found.form,
        "explained": found.explained,
        "remainder": asdict(found.remainder) if found.remainder is not None else None,
        "nuisance": [asdict(n) for n in found.nuisance],
        "next_experiment": found.next_experiment,
    }


def _kept_candidate(c: Candidate, *, fit: bool) -> dict[str, Any]:
    return {
        "effect": c.effect.name,
        "own_effects": own_effects([c.effect]),
        **{k: getattr(c, k) for k in _SCORES},
        "significant": c.significant,
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
    if kept.get("code") != fingerprint() or kept.get("extra") != to_json(own_effects(extra)):
        return None
    return Diagnosis(
        fit,
        kept["verdict"],
        kept["sentence"],
        tuple(Failure(**f | {"omega_c": tuple(f["omega_c"])}) for f in kept["failures"]),
        tuple(_restored_candidate(c, fit) for c in kept["candidates"]),
        kept["form"],
        from_json(kept["explained"]) if kept["explained"] is not None else None,
        Remainder(**_numbers(kept["remainder"])) if kept["remainder"] is not None else None,
        tuple(Nuisance(**_numbers(n)) for n in kept["nuisance"]),
        kept["next_experiment"],
        tuple(residual_torques(fit)),
        tuple(ripples(fit)),
        tuple(whiteness(fit)),
    )


def _numbers(stored: Mapping[str, Any]) -> dict[str, Any]:
    texts = {"sentence", "effect", "label", "unit"}
    return {str(k): str(v) if k in texts else from_json(v) for k, v in stored.items()}


def _restored_candidate(kept: Mapping[str, Any], base: Fit) -> Candidate:
    (effect,) = effects_of([kept["effect"]], kept["own_effects"])
    scores = {k: from_json(kept[k]) for k in _SCORES}
    fit = kept["fit"] and restored_fit(kept["fit"], base.model.with_effect(effect), base.problem.data)
    none = np.zeros(0)
    return Candidate(
        effect,
        **scores,
        indistinguishable_from=tuple(kept["indistinguishable_from"]),
        estimates={
            k: Estimate(from_json(e["value"]), from_json(e["stderr"]), e["unit"], e["at_bound"])
            for k, e in kept["estimates"].items()
        },
        significant=bool(kept["significant"]),
        screened=Score(effect, scores["score"], none, (), 0, 0, absorbed=False, direction=none, null=none),
        fit=fit or None,
    )
