"""Fits, diagnoses and histories as documents of `fitting._schema`, and back.

A fit is restored from its variables, its noise and the data; this takes a single prediction of the model. A diagnosis
is restored from its sentence and its ranking; its curves are computed from its fit. Stored states are valid only for
the same code and the same data; see `fingerprint`. The documents of laws and plans are in separate modules, because
only the commands for laws and plans need them.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from fitting._errors import FittingError, LedgerError
from fitting._numbers import to_json
from fitting._schema import (
    AngleNoiseDocument,
    CandidateDocument,
    CaseDocument,
    CurveBiasDocument,
    DifferenceBetweenRecordings,
    EstimateDocument,
    FailureDocument,
    FirstOrderDocument,
    FitDocument,
    IntervalDocument,
    NameDocument,
    NoiseDocument,
    NuisanceDocument,
    PredictedDocument,
    PriorDocument,
    RemainderDocument,
    SavedFitDocument,
    StepDocument,
    StoredCandidate,
    StoredCertificate,
    StoredDiagnosis,
    StoredDifference,
    StoredFit,
    StoredNoise,
    UpperLimitDocument,
    as_document,
    effects_of,
    own_effects,
    read_json,
)
from fitting.discovery._certificate import Certificate, Outcome
from fitting.discovery._difference import DifferentParameter, ValuesPerRecording
from fitting.discovery._power import UpperLimit
from fitting.discovery._remainder import Nuisance, Remainder
from fitting.discovery._residuals import (
    Failure,
    ResidualTorque,
    Whiteness,
    residual_torques,
    whiteness,
)
from fitting.discovery._score import Score
from fitting.discovery._select import Candidate, Step
from fitting.discovery._verdict import Diagnosis
from fitting.dynamics._model import Model
from fitting.effects._effect import Effect
from fitting.effects._words import change_name, effect_name
from fitting.inference._angle_harmonics import AngleHarmonics
from fitting.inference._angle_noise import AngleNoise
from fitting.inference._case_data import CaseData, with_free_inertia
from fitting.inference._first_order import first_order
from fitting.inference._fit import fit
from fitting.inference._metrics import CaseMetrics
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse
from fitting.inference._parameters import ParameterLayout
from fitting.inference._params import Estimate
from fitting.inference._problem import Problem, degenerate_directions
from fitting.inference._profile import LEVEL, Interval
from fitting.inference._record import Record
from fitting.inference._result import Fit, FitSummary, Origin, not_determined, outcome
from fitting.study._preparation import CurveBias

Array = NDArray[np.float64]

_CURVE_POINTS = 200
"""Number of points of a stored curve [1]. Chosen: a smaller number shows corners, a larger one makes larger files."""
_FITS = 4
"""Number of candidates whose fits are stored, best first [1]. Chosen: a report draws fewer candidates than this; a
larger number makes larger files; with a smaller one, some curves are missing."""


def _angle_noise(noise: AngleNoise) -> AngleNoiseDocument | None:
    return AngleNoiseDocument.model_validate(vars(noise)) if noise.is_significant else None


def fit_document(
    fit: Fit,
    fit_id: str,
    intervals: Mapping[str, Interval] | None = None,
    bias: Mapping[str, CurveBias] | None = None,
    predicted: Sequence[object] | None = None,
) -> dict[str, Any]:
    """Return a fit under the keys of `fit --json`, including the results that other options add."""
    cases = [
        CaseDocument.model_validate(
            {**vars(c), **{k: getattr(n, k) for k in ("pure", "pure_u", "level", "unresolved", "scale")}}
            | {
                "angle_noise": _angle_noise(d.angle_noise),
                "rotor_angle_noise": _angle_noise(d.rotor_angle_noise),
            }
            | {"n_eff": d.n_effective}
        )
        for c, n, d in zip(fit.cases, fit.noise, fit.problem.data, strict=True)
    ]
    reliable = fit.verdict != "not_converged"
    ranges = {k: IntervalDocument(level=LEVEL, **asdict(i)) for k, i in (intervals or {}).items()}
    document = FitDocument(
        fit_id=fit_id,
        model=list(fit.model.names),
        names={e.name: NameDocument(**_in_words(fit, e)) for e in fit.model.effects},
        parameters={
            k: EstimateDocument.model_validate(
                vars(e if reliable else replace(e, stderr=math.nan)) | {"interval": ranges.get(k)}
            )
            for k, e in fit.estimates.items()
        },
        cases=cases,
        misfit=fit.misfit,
        n_eff=fit.n_eff,
        bic=fit.bic,
        verdict=fit.verdict,
        findings=list(fit.findings),
        equations=list(fit.model.equations(fit.problem.data[0].record.parts)),
        not_determined=not_determined(fit.estimates),
        not_determined_together=not_determined_together(fit),
        first_order=[FirstOrderDocument.model_validate(f) for f in first_order(fit)] if reliable else [],
        prior=None if fit.prior is None else PriorDocument.model_validate(fit.prior),
        predicted=None if predicted is None else [PredictedDocument.model_validate(p) for p in predicted],
        generated_rotor={k: CurveBiasDocument.model_validate(b) for k, b in (bias or {}).items()} or None,
    )
    return document.model_dump()


class NullDocument(TypedDict):
    """The answers to recordings that are simulated without the named effect."""

    n: int  #: Number of recordings.
    alarms: int  #: Number of false alarms.
    rate: float  #: Share of the recordings that end in a false alarm [1].
    interval: list[float]  #: 95 % interval of the probability of a false alarm [1].
    names: dict[str, int]  #: Number of recordings in which an effect is named, by effect.
    coverage: dict[str, float]  #: Share of 95 % intervals that contain the simulated value, by parameter [1].


class TruthDocument(TypedDict):
    """The answers to recordings that are simulated with the named effect."""

    n: int  #: Number of recordings.
    right_first: float  #: Share of the recordings in which the effect is named first [1].
    #: Share of the recordings in which the effect, or an indistinguishable effect, is named [1].
    in_class: float
    coverage: dict[str, float]  #: Share of 95 % intervals that contain the simulated value, by parameter [1].


class SimulatedRival(TypedDict):
    """The answers to recordings that are simulated with another effect."""

    effect: str  #: Name of the simulated effect.
    named_as: dict[str, int]  #: Number of recordings, by the effect that is named.


class CertificateDocument(TypedDict):
    """An answer, tested on simulated recordings."""

    fit_id: str  #: Name of the tested fit in the ledger.
    n: int  #: Number of recordings to simulate without the named effect.
    verdict: str  #: The tested verdict, as in a diagnosis.
    named: list[str]  #: The named effect, and the effects indistinguishable from it.
    named_words: list[str]  #: Names of these effects in words.
    sentence: str  #: The result in words.
    null: NullDocument  #: Recordings without the named effect.
    #: (1 + m) / (1 + n), if m of the n recordings without the effect have at least the score of the answer [1].
    p_empirical: float
    truth: TruthDocument | None  #: Recordings with the named effect; null if none is named.
    rivals: list[SimulatedRival]  #: Recordings with each effect that could be mistaken for the named effect.
    film: bool  #: Whether films were rendered and tracked.


def certificate_document(found: Certificate, fit_id: str) -> CertificateDocument:
    """Return a certificate under the keys of `certify --json`."""
    truth: TruthDocument | None = None
    if found.right_first is not None:
        n, coverage = len(found.of("truth")), found.coverage("truth")
        truth = as_document(TruthDocument, found, n=n, coverage=coverage)
    null, known = len(found.of("null")), found.coverage("null")
    rate, interval = found.alarms / max(null, 1), list(found.interval)
    return as_document(
        CertificateDocument,
        found,
        fit_id=fit_id,
        named=list(found.named),
        named_words=[effect_name(n, found.body).words for n in found.named],
        null=as_document(NullDocument, found, n=null, rate=rate, interval=interval, coverage=known),
        truth=truth,
        rivals=[{"effect": e, "named_as": counts} for e, counts in found.rivals.items()],
    )


def stored_certificate(found: Certificate) -> StoredCertificate:
    """Return the outcomes of a certificate with the inputs on which they depend: the code, the answer and the seed."""
    return StoredCertificate.model_validate(vars(found) | {"code": fingerprint()})


def restored_certificate(stored: StoredCertificate) -> Certificate | None:
    """Return a stored certificate; None if it was made by another version of the code."""
    if stored.code != fingerprint():
        return None
    outcomes = tuple(Outcome(**o.model_dump()) for o in stored.outcomes)
    return Certificate(
        stored.n,
        stored.verdict,
        stored.named,
        stored.score,
        outcomes,
        film=stored.film,
        seed=stored.seed,
        body=stored.body,
    )


def not_determined_together(fit: Fit) -> list[dict[str, float]]:
    """Return degenerate combinations of parameters as relative changes by name, scaled to a largest change of 1."""
    kept = [i for i, n in enumerate(fit.problem.layout.names) if not n.startswith("initial.")]
    names = [fit.problem.layout.names[i] for i in kept]
    return degenerate_directions(names, fit.theta[kept], fit.covariance[np.ix_(kept, kept)])


class ShownNuisance(NameDocument, NuisanceDocument):
    """An always fitted camera effect of one case, with its name in words."""


class ShownLimit(UpperLimitDocument):
    """An effect that could still be hidden in the recordings, with its name in words."""

    words: str  #: Name in words.


class TorqueCurve(TypedDict):
    """The unmodelled torque on one body of one case, thinned to about 200 points, with the motion."""

    label: str  #: Name of the case.
    body: str  #: Name of the body.
    time: list[float]  #: Times [s].
    omega_r: list[float]  #: Angular velocity of the rotor, or of the next body of a chain [rad s-1].
    omega_c: list[float]  #: Angular velocity of the casing or single body [rad s-1].
    delta: list[float]  #: Difference `omega_r` - `omega_c` [rad s-1].
    torque_Nm: list[float]  #: Unmodelled torque [torque].
    sigma_Nm: list[float]  #: Standard uncertainty of the torque [torque].


class HarmonicCurve(TypedDict):
    """Harmonics of the unmodelled torque in the angle of the casing of one case."""

    label: str  #: Name of the case.
    angle: list[float]  #: Angles of one turn [rad].
    torque_Nm: list[float]  #: Unmodelled torque at these angles [torque].
    sigma_Nm: list[float]  #: Standard uncertainty of the torque [torque].


class DiagnosisDocument(TypedDict):
    """The lack of fit of a model, and the effects that could be missing."""

    fit_id: str  #: Name of the diagnosed fit in the ledger.
    verdict: str  #: `adequate`, `missing_effect`, `unexplained` or `undecided`.
    sentence: str  #: The answer in words.
    form: str | None  #: `exact`, `approximate`, or null if the form is not established.
    #: Share of the mean square unmodelled torque that the named effect explains, 0 to 1 [1].
    explained: float | None
    #: Smallest detectable deviation from the named law, as a share of its torque [1].
    form_limit: float | None
    #: The measurement that separates indistinguishable effects; empty if there are none.
    next_experiment: str
    failures: list[FailureDocument]  #: Intervals of significant lack of fit, most significant first.
    candidates: list[CandidateDocument]  #: Candidate effects, best first.
    remainder: RemainderDocument | None  #: Unmodelled torque that is still significant with the named effect.
    nuisance: list[ShownNuisance]  #: Camera effects that are always fitted.
    upper_limits: list[ShownLimit]  #: Effects that could still be hidden, if the verdict is `adequate`.
    #: Names of effects that could be hidden and have no useful upper limit, if the verdict is `adequate`.
    without_limit: list[str]
    differs: DifferenceBetweenRecordings | None  #: A parameter whose separate values explain the lack of fit.
    whiteness: list[Whiteness]  #: Tests of the independence of the residuals, by case.
    energy_drift: dict[str, float]  #: Energy balance error by case, as a share of the kinetic energy [1].
    residual_torque: list[TorqueCurve]  #: Unmodelled torque, by body and case.
    residual_ripple: list[HarmonicCurve]  #: Unmodelled torque by angle, by case.


def diagnosis_document(d: Diagnosis, fit_id: str) -> DiagnosisDocument:
    """Return a diagnosis under the keys of `diagnose --json`."""
    return as_document(
        DiagnosisDocument,
        d,
        fit_id=fit_id,
        failures=[FailureDocument.model_validate(f).model_dump() for f in d.failures],
        candidates=[CandidateDocument.model_validate(_candidate(c, d)).model_dump() for c in d.candidates],
        remainder=asdict(d.remainder) if d.remainder is not None else None,
        nuisance=[asdict(n) | _in_words(d.fit, n.effect) | {"words": n.words} for n in d.nuisance],
        upper_limits=[asdict(u) | {"words": d.fit.name(u.effect).words} for u in d.upper_limits],
        without_limit=list(d.without_limit),
        differs=shown_difference(d.differs),
        whiteness=[asdict(w) for w in d.whiteness],
        energy_drift={c.label: c.energy_drift for c in d.fit.cases},
        residual_torque=[_torque(t) for t in d.torques],
        residual_ripple=[_ripple(r) for r in d.ripples],
    )


def difference_document(found: DifferentParameter | None) -> StoredDifference | None:
    """Return a parameter that differs between the recordings as plain numbers; None if there is none."""
    if found is None:
        return None
    others = [_values_document(p) for p in found.others]
    return StoredDifference.model_validate(_values_document(found) | {"others": others})


def shown_difference(found: DifferentParameter | None) -> dict[str, Any] | None:
    """Return a parameter that differs between the recordings as documents show it, without bounds."""
    if (stored := difference_document(found)) is None:
        return None
    return DifferenceBetweenRecordings.model_validate(stored.model_dump()).model_dump()


def _values_document(p: ValuesPerRecording) -> dict[str, Any]:
    return vars(p) | {"parameter": p.name, "values": p.estimates}


def _torque(found: ResidualTorque) -> TorqueCurve:
    """Return an unmodelled torque with the motion at the same times."""
    some = slice(None, None, max(1, len(found.time) // _CURVE_POINTS))
    curves = {k: getattr(found, k)[some] for k in ("time", "omega_r", "omega_c")}
    curves |= {"delta": curves["omega_r"] - curves["omega_c"]}
    curves |= {"torque_Nm": found.torque[some], "sigma_Nm": found.sigma[some]}
    return as_document(TorqueCurve, found, **{k: v.tolist() for k, v in curves.items()})


def _ripple(r: AngleHarmonics) -> HarmonicCurve:
    columns = {"angle": r.angle, "torque_Nm": r.torque, "sigma_Nm": r.sigma}
    return as_document(HarmonicCurve, r, **{k: to_json(v) for k, v in columns.items()})


def _candidate(c: Candidate, d: Diagnosis) -> dict[str, Any]:
    known = {o.effect.name: o.effect for o in d.candidates}
    return (
        vars(c)
        | _in_words(d.fit, c.effect)
        | {
            "effect": c.effect.name,
            "kind": c.effect.kind,
            "parameters": c.estimates,
            "law": f"{c.effect.site}: {c.effect.law}",
            "indistinguishable_words": [d.fit.name(known.get(n, n)).words for n in c.indistinguishable_from],
        }
    )


def _in_words(fit: Fit, effect: Effect | str) -> dict[str, str]:
    """Return the name of an effect in words, and its symbol, as parts of a document."""
    name = fit.name(effect)
    return {"words": name.words, "symbol": name.symbol}


def step_document(fit: Fit, fit_id: str, added: str, previous: Fit | None) -> dict[str, Any]:
    """Return one step of a history: the change, and the errors before and after."""
    same = (
        "samples", "n_eff", "rmse_casing", "rmse_noise", "reduced_chi2", "misfit", "held_out", "bic", "bic_noise",
        "verdict",
    )  # fmt: skip
    document = StepDocument.model_validate(
        {k: getattr(fit, k) for k in same}
        | {
            "fit_id": fit_id,
            "added": added,
            "words": change_name(added, fit.problem.data[0].record.body, fit.model.effects),
            "model": fit.model.names,
            "delta_bic": fit.bic - previous.bic if previous is not None else 0.0,
            "energy_drift": max(c.energy_drift for c in fit.cases),
            "torque_left_Nm": fit.torque_noise,
            "moved": _moved(fit, previous),
        }
    )
    return document.model_dump()


def _moved(fit: Fit, previous: Fit | None) -> list[str]:
    """Return the parameters that changed by more than three standard errors."""
    if previous is None:
        return []
    return [
        k
        for k, e in fit.estimates.items()
        if k in previous.estimates
        and not k.startswith("initial.")
        and abs(e.value - previous.estimates[k].value) > 3 * max(e.stderr, 0.0)
    ]


def history_verdict(steps: Sequence[Step]) -> str:
    """Return the verdict of a finished history: "adequate", "missing_effect" (found and added) or "unexplained"."""
    if steps[-1].fit.verdict != "no_lack_of_fit":
        return "unexplained"
    # separate values of a shared parameter for each recording are not an effect
    return "missing_effect" if steps[-1].fit.model.names != steps[0].fit.model.names else "adequate"


@dataclass(frozen=True, repr=False)
class SavedFit(FitSummary):
    """A fit read from a file, without the data."""

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
    noise: tuple[NoiseDocument, ...]
    names: tuple[str, ...]  # variables, in the order of `covariance`
    covariance: Array  # (n, n), in SI units
    sources: tuple[str, ...]  # files of the data that were fitted
    digests: tuple[str, ...]  # SHA-256 of these files

    def _origin(self) -> Origin:
        return self.names, self.covariance, self.sources, self.digests

    def refit(self, cases: Sequence[Record]) -> Fit:
        """Fit the same model again, with these values as initial values."""
        ties = {k.partition("@")[0]: e.expr for k, e in self.estimates.items() if e.expr is not None}
        return fit(self.model, cases, start=self.values, ties=ties)


def load_fit(path: str | Path) -> SavedFit:
    """Read a fit that `Fit.save` wrote.

    Parameters
    ----------
    path : str or Path
        A JSON file.

    Raises
    ------
    LedgerError
        If the file is missing, damaged, or not a fit.
    """
    path = Path(path)
    stored = read_json(path, SavedFitDocument, "is not a saved fit", "save one with Fit.save")
    try:
        model = Model(effects_of(stored.model, stored.own_effects))
    except FittingError as fault:
        raise LedgerError(f"{path} is damaged: {type(fault).__name__} {fault}"[:200]) from None
    covariance = np.array(stored.covariance, dtype=float).reshape(len(stored.covariance), -1)
    if covariance.shape != (len(stored.names), len(stored.names)):
        raise LedgerError(f"{path} is damaged: the size of the covariance differs from the number of names")
    same = ("chi2", "rows", "n_eff", "deviance", "bic", "verdict")
    lists = ("labels", "noise", "names", "sources", "digests")
    kept: dict[str, Any] = {k: getattr(stored, k) for k in same}
    kept |= {k: tuple(getattr(stored, k)) for k in lists}
    return SavedFit(
        model=model,
        estimates=_estimates(stored.estimates),
        cases=tuple(TypeAdapter(CaseMetrics).validate_python(c.model_dump()) for c in stored.cases),
        covariance=covariance,
        **kept,
    )


def _estimates(stored: Mapping[str, EstimateDocument]) -> dict[str, Estimate]:
    return {k: Estimate(**e.model_dump()) for k, e in stored.items()}


@cache
def fingerprint() -> str:
    """Return a digest of the code on which fits depend: this package, numpy and scipy."""
    digest = hashlib.sha256(f"numpy {version('numpy')} scipy {version('scipy')}".encode())

    def add(place: Any, name: str) -> None:
        for part in sorted(place.iterdir(), key=lambda p: str(p.name)):
            if part.is_dir():
                add(part, f"{name}/{part.name}")
            elif part.name.endswith(".py"):
                digest.update(f"{name}/{part.name}\n".encode() + part.read_bytes())

    add(resources.files("fitting"), "fitting")
    return digest.hexdigest()


def stored_fit(fit: Fit) -> StoredFit:
    """Return the state from which a least-squares fit is restored."""
    layout = fit.problem.layout
    return StoredFit(
        code=fingerprint(),
        theta=fit.theta.tolist(),
        per_case=list(layout.per_case),
        ranges=dict(layout.ranges),
        noise=[StoredNoise.model_validate(n) for n in fit.noise],
        converged=fit.converged,
    )


def restored_fit(stored: StoredFit, model: Model, data: Sequence[CaseData]) -> Fit | None:
    """Return a stored fit; None if it was made by another version of the code.

    The noise is linearised about the same motion as in the original fit: the motion at the start of the last
    optimisation of that fit. If a model has a very large lack of fit, the optimum may be far from this start. The noise
    of a candidate is linearised about the fit without the candidate, with strengths of zero.
    """
    if stored.code != fingerprint():
        return None
    data = with_free_inertia(data, model.names)
    layout = ParameterLayout(model, tuple(d.record for d in data), tuple(stored.per_case), stored.ranges)
    problem = Problem.of(layout, data)
    theta = np.array(stored.theta, dtype=float)
    strengths = {f"{e.name}.{p.symbol}" for e in model.effects for p in e.parameters if p.role == "amplitude"}
    noise = []
    for case, d, n in zip(problem.cases, data, stored.noise, strict=True):
        optimum = zip(layout.names, theta, strict=True)
        about = [n.about.get(k, 0.0 if k.partition("@")[0] in strengths else x) for k, x in optimum]
        motion = case.predict(np.array(about)).motion
        whitener = TorqueResponse(d, motion).whitener(TorqueNoise(n.level, n.time))
        noise.append(Noise(**n.model_dump(), process=d.process_noise, whitener=whitener))
    return outcome(problem.with_noise(noise), theta, tuple(noise), converged=stored.converged)


def stored_diagnosis(found: Diagnosis, extra: Sequence[Effect] = ()) -> StoredDiagnosis:
    """Return the state from which a diagnosis is restored, given its fit; `extra` are the user's effects."""
    # the fit of a candidate with free moments of inertia is not stored, because its model contains other parameters
    base = found.fit.model
    candidates, left = [], _FITS
    for c in found.candidates:
        drawn = c.fit if left and c.physical and c.significant else None
        if drawn is not None and len(drawn.model.names) != len(base.names) + 1:
            drawn = None
        left -= drawn is not None
        stored = {"effect": c.effect.name, "own_effects": own_effects([c.effect])}
        candidates.append(vars(c) | stored | {"fit": stored_fit(drawn) if drawn is not None else None})
    return StoredDiagnosis.model_validate(
        vars(found)
        | {
            "code": fingerprint(),
            "extra": own_effects(extra),
            "candidates": candidates,
            "differs": difference_document(found.differs),
        }
    )


def restored_diagnosis(stored: StoredDiagnosis, fit: Fit, extra: Sequence[Effect] = ()) -> Diagnosis | None:
    """Return a stored diagnosis; None if it was made by another version of the code or with other effects of the user.

    Its candidates have no screening results, so the diagnosis is for display only.
    """
    if stored.code != fingerprint() or stored.extra != own_effects(extra):
        return None
    return Diagnosis(
        fit,
        stored.verdict,
        stored.sentence,
        tuple(Failure(**f.model_dump()) for f in stored.failures),
        tuple(_restored_candidate(c, fit) for c in stored.candidates),
        stored.form,
        stored.explained,
        None
        if (r := stored.remainder) is None
        else Remainder(r.torque_rms_Nm, r.share, r.p_value, r.sentence, tuple(r.effects)),
        tuple(Nuisance(**n.model_dump()) for n in stored.nuisance),
        stored.next_experiment,
        tuple(residual_torques(fit)),
        fit.angle_harmonics,
        tuple(whiteness(fit)),
        tuple(UpperLimit(**u.model_dump()) for u in stored.upper_limits),
        tuple(stored.without_limit),
        stored.form_limit,
        None
        if (d := stored.differs) is None
        else DifferentParameter(
            d.parameter,
            _estimates(d.values),
            _estimates(d.differences),
            tuple(d.indistinguishable_from),
            d.delta_bic,
            d.p_value,
            tuple(
                ValuesPerRecording(p.parameter, _estimates(p.values), _estimates(p.differences))
                for p in d.others
            ),
        ),
    )


def _restored_candidate(stored: StoredCandidate, base: Fit) -> Candidate:
    (effect,) = effects_of([stored.effect], stored.own_effects)
    model = base.model.with_effect(effect)
    none = np.zeros(0)
    same = ("score", "delta_bic", "p_value", "held_out_gain", "significant")
    return Candidate(
        effect,
        **{k: getattr(stored, k) for k in same},
        indistinguishable_from=tuple(stored.indistinguishable_from),
        estimates=_estimates(stored.estimates),
        screened=Score(effect, stored.score, none, (), 0, 0, absorbed=False, direction=none, null=none),
        fit=restored_fit(stored.fit, model, base.problem.data) if stored.fit is not None else None,
    )
