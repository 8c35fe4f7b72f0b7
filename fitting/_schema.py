"""JSON files of fits, diagnoses and histories: one schema for reading and writing; atomic writing.

Numbers are in SI units. JSON has neither nan nor infinity: nan is written as null, infinity as "inf" (see
`fitting._numbers.to_json`). Both are converted back when a file is read. Unknown keys are ignored, and keys with a
default may be missing; files of older versions therefore remain readable.

A comment `#:` at a key states its meaning, with the unit in brackets; docs/reference/json.md is made from these
comments.

Files are written and locked as `fitting._files` describes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, cast

from pydantic import (
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)

from fitting._errors import LedgerError
from fitting._files import Files, flush, lock_file, new_part, publish
from fitting._numbers import TORQUE, to_json
from fitting.effects._effect import Effect
from fitting.effects._library import LIBRARY


def _ledger_error(what: str, hint: str) -> LedgerError:
    """Return an error of this package for an error of `fitting._files`, given its sentence and hint."""
    return LedgerError(what.removesuffix("."), f"{hint[:1].lower()}{hint[1:].removesuffix('.')}")


_FILES = Files(_ledger_error, "Choose a file on another disk with --ledger.")
locked, refuse_special = _FILES.locked, _FILES.refuse_special


def write_text(path: Path, text: str, *, unchanged: Callable[[], bool] = lambda: True) -> None:
    """Write a text file (UTF-8) atomically; a LedgerError states why this failed.

    The file is not replaced if it is no longer `unchanged`.
    """
    refuse_special(path)
    part = new_part(path)
    _FILES.name_in_lock(part, lock_file(path))
    try:
        with part.open("x", encoding="utf-8") as stream:
            stream.write(text)
        flush(part)
        if not unchanged():
            raise LedgerError(
                f"{path} was changed by another program at the same time", "run the command again"
            )
        publish(part, path)
    except OSError as fault:
        raise _FILES.refusal(path, fault) from None
    finally:
        with suppress(OSError):  # on a read-only disk, the temporary file cannot be removed either
            part.unlink(missing_ok=True)


# fields of an effect that files of older versions do not contain
_ADDED_FIELDS = ("per_case", "per_surface", "nuisance", "equivalent", "words")


def _with_added_fields(stored: Any) -> Any:
    """Return a stored effect, with missing fields from the effect of the same name in the library."""
    known = LIBRARY.get(str(stored.get("name"))) if isinstance(stored, Mapping) else None
    return {**{k: getattr(known, k) for k in _ADDED_FIELDS}, **stored} if known is not None else stored


Number = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
# words of earlier versions for the verdict of a fit
_EARLIER_VERDICTS = {
    "adequate": "no_lack_of_fit",
    "misfit": "lack_of_fit",
    "not determined": "not_determined",
    "not converged": "not_converged",
}
FitVerdict = Annotated[
    str, BeforeValidator(lambda word: _EARLIER_VERDICTS.get(word, word) if isinstance(word, str) else word)
]
Flag = Annotated[bool, BeforeValidator(bool)]
StoredEffect = Annotated[Effect, BeforeValidator(_with_added_fields)]


class Document(BaseModel):
    """An object of a JSON document. It is made from keywords, or from an object with attributes of the same names."""

    model_config = ConfigDict(from_attributes=True, extra="ignore")


_T = TypeVar("_T")


def as_document(kind: type[_T], source: object, /, **computed: Any) -> _T:
    """Return a document of a TypedDict; keys that are not computed are attributes of the source."""
    return cast(_T, {k: computed[k] if k in computed else getattr(source, k) for k in kind.__annotations__})


class WithOptionalKeys(Document):
    """A document in which the keys of `absent` are left out if they have no value."""

    absent: ClassVar[frozenset[str]]

    @model_serializer(mode="wrap")
    def _present(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: v for k, v in dump(self).items() if v is not None or k not in self.absent}


class IntervalDocument(Document):
    """A confidence interval by profile likelihood."""

    level: Number  #: Confidence level [1].
    #: Lower end; for an open end, the bound of the parameter or the last value that was tried [`unit`].
    lower: Number
    #: Upper end; for an open end, the bound of the parameter or the last value that was tried [`unit`].
    upper: Number
    lower_open: bool  #: Whether the data give no lower limit.
    upper_open: bool  #: Whether the data give no upper limit.


class EstimateDocument(WithOptionalKeys):
    """A parameter or a difference of parameters."""

    absent = frozenset({"interval"})

    value: Number  #: Value [`unit`].
    #: Standard error; null if a bound is active or the fit did not converge [`unit`].
    stderr: Number = math.nan
    #: SI unit; for a torque on a body of unknown moment of inertia, the unit of an angular acceleration.
    unit: str = ""
    at_bound: Flag = False  #: Whether a bound is active.
    interval: IntervalDocument | None = None  #: 95 % interval, with `--profile`.


class StoredEstimate(EstimateDocument):
    """A parameter with its bounds, and with the expression that determines it, if there is one."""

    vary: bool = True  #: Whether the parameter was fitted, and not held.
    min: Number = -math.inf  #: Lower bound; null if there is none [`unit`].
    max: Number = math.inf  #: Upper bound; null if there is none [`unit`].
    #: Expression of other parameters that determines the parameter; null if it is free.
    expr: str | None = None


class BodyDocument(Document):
    """Figures of merit of one body; null for a body that was not measured."""

    r2: Number  #: Coefficient of determination of the smoothed angular velocity [1].
    rmse: Number  #: Rms residual of the smoothed angular velocity [rad s-1].
    #: Chi-square of the fitted quantity, divided by the effective number of samples [1].
    reduced_chi2: Number
    held_out: Number  #: Cross-validation error divided by the noise; 1 is the noise limit [1].


class MetricsDocument(Document):
    """Figures of merit of one case."""

    label: str  #: Name of the case.
    casing: BodyDocument  #: The casing; in other cases, the single body, or the first body of a chain.
    rotor: BodyDocument  #: The rotor, or the second body of a chain.
    energy_drift: Number  #: Energy balance error, as a share of the initial or largest kinetic energy [1].
    further: list[BodyDocument] = []  #: The third and the following bodies of a chain.
    #: Chi-square, divided by the number of rows that a model can describe [1].
    chi2_per_row: Number = Field(validation_alias=AliasChoices("chi2_per_row", "misfit"))
    # the default is for fits that were stored without this number
    #: Number of rows that a model can describe; a row is a combination of samples.
    rows: int = Field(1000, validation_alias=AliasChoices("rows", "misfit_rows"))


class AngleNoiseDocument(Document):
    """Correlated noise of the angles of one body, with a part that is periodic in the angle."""

    #: Standard deviation [rad].
    sigma_rad: Number = Field(validation_alias=AliasChoices("sigma_rad", "sigma"))
    #: Standard uncertainty of `sigma_rad` [rad].
    sigma_u_rad: Number = Field(validation_alias=AliasChoices("sigma_u_rad", "sigma_u"))
    #: Correlation time [s].
    time_s: Number = Field(validation_alias=AliasChoices("time_s", "time"))
    #: Standard deviation of the periodic part [rad].
    turn_sigma_rad: Number = Field(0.0, validation_alias=AliasChoices("turn_sigma_rad", "turn_sigma"))
    #: Standard uncertainty of `turn_sigma_rad` [rad].
    turn_sigma_u_rad: Number = Field(0.0, validation_alias=AliasChoices("turn_sigma_u_rad", "turn_sigma_u"))
    #: Correlation time of the amplitude of the periodic part [s].
    turn_time_s: Number = Field(0.0, validation_alias=AliasChoices("turn_time_s", "turn_time"))


class CaseDocument(MetricsDocument):
    """Figures of merit and noise of one case."""

    #: Rms of the process noise of the recording [torque].
    torque_noise_Nm: Number = Field(validation_alias=AliasChoices("torque_noise_Nm", "pure"))
    #: Standard uncertainty of `torque_noise_Nm` [torque].
    torque_noise_u_Nm: Number = Field(math.nan, validation_alias=AliasChoices("torque_noise_u_Nm", "pure_u"))
    #: Rms of the random torque in the residuals of this fit [torque].
    torque_left_Nm: Number = Field(validation_alias=AliasChoices("torque_left_Nm", "level"))
    #: Rms of a random torque that is not separable from the angle noise, included in the uncertainties [torque].
    torque_unresolved_Nm: Number = Field(
        0.0, validation_alias=AliasChoices("torque_unresolved_Nm", "unresolved")
    )
    #: White noise of the casing's samples, divided by their stated standard uncertainty [1].
    noise_scale: Number = Field(validation_alias=AliasChoices("noise_scale", "scale"))
    #: Correlated angle noise of the casing; null if not significant.
    angle_noise: AngleNoiseDocument | None = None
    #: Correlated angle noise of the rotor; null if not significant.
    rotor_angle_noise: AngleNoiseDocument | None = None
    n_eff: Number = math.nan  #: Number of equivalent independent samples [1].


class PriorDocument(Document):
    """A Gaussian prior: parameters of another study with their covariance."""

    source: str  #: Name of the other study.
    names: list[str]  #: Keys of the parameters.
    mean: list[Number]  #: Values of the parameters [SI units].
    covariance: list[list[Number]]  #: Covariance of the parameters [SI units].


class FirstOrderDocument(Document):
    """First-order response of a driven body of one case."""

    label: str  #: Name of the case.
    body: str  #: Name of the body.
    time_constant: EstimateDocument  #: Moment of inertia divided by the coefficient of linear drag.
    gains: dict[str, EstimateDocument]  #: Change of the final speed per unit of an input, by input.
    delays: dict[str, EstimateDocument]  #: Dead time of each input whose dead time is fitted, by input.


class NameDocument(Document):
    """The name of an effect in words, and the symbol of its strength."""

    words: str  #: Name in words.
    symbol: str  #: Symbol of the strength; empty if there is no strength.


class PredictedDocument(Document):
    """One recording, predicted from a fit of the other recordings."""

    label: str  #: Name of the case.
    casing: Number  #: Rms error of the casing divided by the noise; 1 is the noise limit [1].
    rotor: Number  #: Rms error of the rotor divided by the noise [1].
    r2: Number  #: Coefficient of determination of the smoothed angular velocity of the casing [1].
    rmse: Number  #: Rms error of the smoothed angular velocity of the casing [rad s-1].


class CurveBiasDocument(Document):
    """A parameter from a generated rotor curve and from the rotor windows."""

    generated: Number  #: Value from the curve [unit of the parameter].
    claimed: Number  #: Standard error of `generated`, without the error of the curve [unit of the parameter].
    measured: Number  #: Value from the windows [unit of the parameter].
    stderr: Number  #: Standard error of `measured` [unit of the parameter].
    errors: Number  #: Difference of the values divided by the standard error from the curve [1].


class FitDocument(WithOptionalKeys):
    """A fit of one case, or of several cases together."""

    absent = frozenset({"predicted", "generated_rotor"})

    fit_id: str  #: Name of the fit in the ledger: f1, f2, ...; empty if the fit is not stored.
    model: list[str]  #: Names of the effects.
    names: dict[str, NameDocument] = {}  #: The effects in words, by name.
    #: Parameters by key: `effect.symbol`, or `effect.symbol@label` if each case has its own value. Initial speeds have
    #: the keys `initial.omega_r@label` and `initial.omega_c@label`.
    parameters: dict[str, EstimateDocument]
    cases: list[CaseDocument] = []  #: Figures of merit of each case.
    misfit: Number = math.nan  #: Rms residual divided by the rms of the noise; 1 is the noise limit [1].
    n_eff: Number = math.nan  #: Number of equivalent independent samples of all cases [1].
    bic: Number = math.nan  #: Bayesian information criterion [1].
    verdict: str = ""  #: `lack_of_fit`, `no_lack_of_fit`, `not_determined` or `not_converged`.
    findings: list[str] = []  #: Faults of the measurement that the recordings show without a model.
    equations: list[str] = []  #: Equations of motion (LaTeX).
    not_determined: list[str] = []  #: Parameters whose standard error exceeds their value.
    #: Degenerate combinations: relative changes by parameter, scaled to a largest change of 1 [1].
    not_determined_together: list[dict[str, Number]] = []
    first_order: list[FirstOrderDocument] = []  #: Response of bodies that recorded inputs drive.
    prior: PriorDocument | None = None  #: The prior of the parameters, with `--prior`.
    #: Prediction of each case from a fit of the other cases, with `--hold-out`.
    predicted: list[PredictedDocument] | None = None
    #: Shift of each parameter by the generated curve, with `--rotor generated`.
    generated_rotor: dict[str, CurveBiasDocument] | None = None


class FailureDocument(Document):
    """An interval, or a harmonic of the angle, of significant lack of fit."""

    label: str  #: Name of the case.
    body: str  #: Name of the body.
    t_start: Number  #: Start of the interval [s].
    t_stop: Number  #: End of the interval [s].
    kind: str  #: `loses torque` or `gains torque` relative to the model; `ripple` for a harmonic.
    where: str  #: Place in words, for example `while speeding up`.
    size_sigma: Number  #: Largest distance from zero [standard uncertainties].
    residual_rad_s: Number  #: Extreme residual of the speed, or amplitude of a harmonic [rad s-1].
    residual_torque_Nm: Number  #: Mean unmodelled torque, or amplitude of a harmonic [torque].
    torque_sigma_Nm: Number = math.nan  #: Standard uncertainty of `residual_torque_Nm` [torque].
    omega_c: tuple[Number, Number]  #: Smallest and largest speed of the casing or single body [rad s-1].


class StoredFailure(FailureDocument):
    """A failure as it is stored, with the name of the body in sentences and the unit of the torque."""

    called: str
    unit: str = TORQUE


class CandidateDocument(Document):
    """A candidate effect with its score."""

    effect: str  #: Name of the effect.
    words: str  #: Name in words.
    symbol: str  #: Symbol of the strength.
    kind: str  #: `physical` or `measurement`.
    score: Number  #: Decrease of the deviance when the effect is added [1].
    delta_bic: Number  #: BIC with the effect minus BIC without it; null without a refit [1].
    p_value: Number  #: Probability of an equal or larger score anywhere in the list if no law is missing [1].
    significant: Flag  #: Whether `p_value` is below the level of the search.
    held_out_gain: Number  #: Decrease of the cross-validation error / noise; null without a refit [1].
    indistinguishable_from: list[str]  #: Candidates that the data cannot separate from this candidate.
    indistinguishable_words: list[str]  #: Names of these candidates in words.
    parameters: dict[str, EstimateDocument]  #: Parameters of the effect, by key as in a fit.
    law: str  #: Body or joint, and formula.


class RemainderDocument(Document):
    """The unmodelled torque that is still significant with the named effect."""

    torque_rms_Nm: Number  #: Rms torque on the body where it is largest [torque].
    share: Number  #: Share of the mean square unmodelled torque, 0 to 1 [1].
    p_value: Number  #: Probability that noise alone causes an equal or larger remainder [1].
    sentence: str  #: Size of the remainder, and the variable on which it depends, in words.
    effects: list[str] = []  #: Further effects that describe the remainder.


class NuisanceDocument(Document):
    """A camera effect that is always fitted, in one case."""

    effect: str  #: Name of the effect.
    label: str  #: Name of the case.
    value: Number  #: Amplitude [`unit`].
    stderr: Number  #: Standard error of the amplitude [`unit`].
    unit: str  #: Unit of the amplitude.
    p_value: Number  #: Probability that noise alone causes an equal or larger amplitude [1].
    film: bool = True  #: Whether the angles were tracked on film.


class UpperLimitDocument(Document):
    """An effect that could still be hidden in the recordings."""

    effect: str  #: Name of the effect.
    symbol: str  #: Symbol of the strength.
    upper_limit: Number  #: 95 % upper limit of the strength [`unit`].
    unit: str  #: Unit of the strength.
    torque_Nm: Number  #: Upper limit as an rms torque along the motion [torque].


class ValuesInRecordings(Document):
    """The value of a parameter in each recording."""

    parameter: str  #: Key of the parameter.
    values: dict[str, EstimateDocument]  #: Values of the parameter, by name of the case.
    #: Differences from the value in the first case, by name of the case.
    differences: dict[str, EstimateDocument]


class DifferenceBetweenRecordings(ValuesInRecordings):
    """A parameter shared by the recordings that differs between them."""

    delta_bic: Number  #: BIC with a value for each recording minus BIC with a shared value [1].
    #: Probability of an equal or more significant difference in any shared parameter if no parameter differs [1].
    p_value: Number
    #: Other parameters that describe the data equally well if their values differ.
    indistinguishable_from: list[str]
    others: list[ValuesInRecordings] = []  #: Further parameters with a value for each recording.


class StepDocument(Document):
    """One fit of a history: the change, and the errors."""

    fit_id: str  #: Name of the fit in the ledger.
    #: The change: `+effect`, `-effect`, or a text; for a first fit the name of its model, or empty.
    added: str
    words: str = ""  #: The change in words.
    model: list[str]  #: Names of the effects.
    samples: int = 0  #: Number of samples of all cases.
    n_eff: Number = math.nan  #: Number of equivalent independent samples [1].
    rmse_casing: Number  #: Rms residual of the smoothed angular velocity of the casings [rad s-1].
    rmse_noise: Number = math.nan  #: Rms residual that noise alone would give [rad s-1].
    reduced_chi2: Number  #: Chi-square of the casings, divided by the effective number of samples [1].
    misfit: Number = math.nan  #: Rms residual divided by the rms of the noise; null in older files [1].
    held_out: Number  #: Cross-validation error of the casings divided by the noise; 1 is the noise limit [1].
    bic: Number = math.nan  #: Bayesian information criterion [1].
    #: BIC that a model with the same number of parameters would have if its residuals were noise [1].
    bic_noise: Number = math.nan
    delta_bic: Number  #: BIC minus the BIC of the previous fit; 0 for the first fit [1].
    energy_drift: Number  #: Largest energy balance error of a case, as a share of the kinetic energy [1].
    torque_left_Nm: Number  #: Largest rms of the random torque in the residuals of a case [torque].
    moved: list[str]  #: Parameters that changed by more than three standard errors.
    verdict: FitVerdict  #: Verdict of the fit.


class ListedStep(StepDocument):
    """One fit of a history, with the fit on which it is based, and the name and note of the user."""

    parent: str  #: Name of the fit on which this fit is based; empty for a first fit.
    name: str  #: Name, from `--name`.
    note: str  #: Note, from `--note`.


class NoiseDocument(Document):
    """Noise of one case.

    `scale` is the white noise divided by the stated uncertainty. `pure` and `pure_u` are the process noise of the
    recording and its standard uncertainty [N m]. `level` is the random torque in the residuals of the model [N m].
    `unresolved` is the random torque that the residuals do not exclude [N m].
    """

    scale: Number
    pure: Number
    pure_u: Number = 0.0
    level: Number
    unresolved: Number = 0.0


class StoredNoise(NoiseDocument):
    """Noise with its correlation time [s], its log-likelihood ratio, and the variables about which it is linearised."""

    time: Number
    excess: Number
    about: dict[str, Number]


class StoredFit(Document):
    """The state from which a fit is restored without a search; valid only for the code with this digest."""

    code: str
    theta: list[Number]
    per_case: list[str]
    ranges: dict[str, tuple[Number, Number]]
    noise: list[StoredNoise]
    converged: bool


class StoredCandidate(Document):
    """A candidate effect as it is restored for display."""

    effect: str
    own_effects: list[StoredEffect]
    score: Number
    delta_bic: Number
    p_value: Number
    held_out_gain: Number
    significant: Flag
    indistinguishable_from: list[str]
    estimates: dict[str, StoredEstimate]
    fit: StoredFit | None


class StoredValues(ValuesInRecordings):
    """The value of a parameter in each recording, with its bounds."""

    values: dict[str, StoredEstimate]  # type: ignore[assignment]
    differences: dict[str, StoredEstimate]  # type: ignore[assignment]


class StoredDifference(StoredValues, DifferenceBetweenRecordings):
    """A parameter that differs between the recordings, with the bounds of its values."""

    others: list[StoredValues] = []  # type: ignore[assignment]


class StoredDiagnosis(Document):
    """The state from which a diagnosis is restored without a search; `extra` are the user's effects."""

    code: str
    extra: list[StoredEffect]
    verdict: str
    sentence: str
    failures: list[StoredFailure]
    candidates: list[StoredCandidate]
    form: str | None = None
    explained: float | None = None
    form_limit: float | None = None
    remainder: RemainderDocument | None = None
    nuisance: list[NuisanceDocument] = []
    next_experiment: str
    upper_limits: list[UpperLimitDocument] = []
    without_limit: list[str] = []
    differs: StoredDifference | None = None


class OutcomeDocument(Document):
    """The answer to one simulated recording, with the names of the attributes of `Outcome`."""

    kind: Literal["null", "truth", "rival"]
    effect: str
    number: int
    verdict: str
    named: tuple[str, ...] = ()
    score: Number = math.nan
    inside: dict[str, bool] = {}


class StoredCertificate(Document):
    """The outcomes of a certificate, also of an incomplete one, with the inputs on which they depend."""

    code: str
    n: int
    seed: int
    film: bool = False
    body: str = "casing"
    verdict: str
    named: tuple[str, ...] = ()
    score: Number = 0.0
    outcomes: list[OutcomeDocument] = []


class EntryDocument(FitDocument):
    """One fit of a ledger.

    The keys `restored_from` (`StoredFit`), `diagnosis` (`StoredDiagnosis`), `certificate` and `certificate_of_films`
    (`StoredCertificate`) only save time. They are checked when they are used, and ignored if they are damaged.
    """

    parent: str = ""
    added: str = ""
    name: str = Field(default="", max_length=200)
    note: str = Field(default="", max_length=2000)
    rung: StepDocument | None = None
    digests: list[str]
    sources: list[str] = []
    own_effects: list[StoredEffect] = []
    share: list[str] = []
    per_case: list[str] = []
    ranges: dict[str, tuple[Number, Number]] = {}
    loss: str = "linear"
    data: str = "angle"
    rotor: str = "windows"
    created: str = ""
    software_version: str = ""
    variables: list[str] = []
    covariance: list[list[Number]] = []
    restored_from: Any = None
    diagnosis: Any = None
    certificate: Any = None
    certificate_of_films: Any = None


class LedgerDocument(Document):
    """A ledger: the history of fits of one or several studies. Entries keep keys that are unknown to this version."""

    format: str = "gyrotrack ledger"
    version: int = 1
    fits: list[dict[str, Any]] = []


class SavedFitDocument(Document):
    """The document that `Fit.save` writes: a fit without its data."""

    format: str = "gyrotrack fit"
    version: int = 1
    model: list[str]
    own_effects: list[StoredEffect]
    labels: list[str]
    estimates: dict[str, StoredEstimate]
    cases: list[MetricsDocument]
    noise: list[NoiseDocument]
    verdict: FitVerdict
    names: list[str]
    covariance: list[list[Number]]
    sources: list[str]
    digests: list[str]
    chi2: Number
    rows: int
    n_eff: Number
    deviance: Number
    bic: Number


def own_effects(effects: Iterable[Effect]) -> list[Effect]:
    """Return the effects that are not in the library in this form, for example the laws of a chain of bodies."""
    return [e for e in effects if LIBRARY.get(e.name) != e]


def effects_of(names: Iterable[str], own: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return effects by name, from the user's effects `own` or, if a name is not among them, from the library."""
    known = LIBRARY | {e.name: e for e in own}
    found = {n: known.get(n) for n in names}
    if missing := [n for n, e in found.items() if e is None]:
        raise LedgerError(
            f"a stored fit contains the effect {missing[0][:60]!r}, which is not in the library of this version",
            "use the version of gyrotrack that wrote it, or another file of fits",
        )
    return tuple(e for e in found.values() if e is not None)


def as_json(document: Document) -> dict[str, Any]:
    """Return a document in the form that the module `json` can write."""
    return dict(to_json(document.model_dump()))


def as_text(document: Document) -> str:
    """Return a document as the text of a JSON file."""
    return json.dumps(as_json(document), indent=1, allow_nan=False)


_D = TypeVar("_D", LedgerDocument, SavedFitDocument)


def read_json(path: Path, kind: type[_D], what: str, hint: str) -> _D:
    """Read a JSON file of a kind: a ledger or a saved fit.

    A LedgerError is raised if the file is missing, of another kind, of a newer version, or damaged.
    """
    refuse_special(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as fault:
        raise LedgerError(f"{path}: {fault.strerror or fault}") from None
    except ValueError:
        text = ""
    return parse_json(text, path, kind, what, hint)


def parse_json(text: str, path: Path, kind: type[_D], what: str, hint: str) -> _D:
    """Return the document in a text that was read from `path`; raise the same errors as `read_json`."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        document = None
    expected = kind.model_fields["format"].default
    if not isinstance(document, dict) or document.get("format") != expected:
        raise LedgerError(f"{path} {what}", hint)
    version = document.get("version")
    if isinstance(version, int) and version > kind.model_fields["version"].default:
        raise LedgerError(f"{path} was written by a newer version", "update gyrotrack")
    try:
        return kind.model_validate(document)
    except ValidationError as fault:
        raise LedgerError(f"{path} is damaged: {first_error(fault)}", hint) from None


def first_error(fault: ValidationError) -> str:
    """Return the place and the message of the first error of a document."""
    error = fault.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(map(str, error['loc'])) or 'document'}: {error['msg'][:120]}"
