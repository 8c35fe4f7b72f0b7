"""JSON files of fits, diagnoses and histories: one schema for reading and writing; atomic writing.

Numbers are in SI units. JSON has neither nan nor infinity: nan is written as null, infinity as "inf" (see
`fitting._numbers.to_json`), and both are read back. Unknown keys are ignored, keys with a default may be missing, so
that files of older versions stay readable.

Files are written and locked as `fitting._files` describes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AliasChoices, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from fitting._errors import LedgerError
from fitting._files import Files, flush, lock_file, new_part, publish
from fitting._numbers import TORQUE, to_json
from fitting.effects._effect import Effect
from fitting.effects._library import LIBRARY


def _ledger_error(what: str, hint: str) -> LedgerError:
    """Return the error of this package with a sentence and a hint of `fitting._files`."""
    return LedgerError(what.removesuffix("."), f"{hint[:1].lower()}{hint[1:].removesuffix('.')}")


_FILES = Files(_ledger_error, "Choose a file on another disk with --ledger.")
locked, refuse_special = _FILES.locked, _FILES.refuse_special


def write_text(path: Path, text: str, *, unchanged: Callable[[], bool] = lambda: True) -> None:
    """Write a text file (UTF-8) atomically; a LedgerError says why the system refuses.

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
        with suppress(OSError):  # on a read-only disk not even that is allowed
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
    """An object of a JSON document; made from keywords, or from an object with attributes of the same names."""

    model_config = ConfigDict(from_attributes=True, extra="ignore")


def selected(source: object, names: Iterable[str]) -> dict[str, Any]:
    """Return attributes of an object as a part of a document that is written only."""
    return {name: getattr(source, name) for name in names}


class EstimateDocument(Document):
    """A parameter: value, standard error (nan on a bound), unit, whether its bound is active."""

    value: Number
    stderr: Number = math.nan
    unit: str = ""
    at_bound: Flag = False


class StoredEstimate(EstimateDocument):
    """A parameter with its bounds, whether it is varied, and the expression that it follows."""

    vary: bool = True
    min: Number = -math.inf
    max: Number = math.inf
    expr: str | None = None


class BodyDocument(Document):
    """Figures of merit of one body: R2, rms residual [rad/s], reduced chi2, cross-validation error [noise]."""

    r2: Number
    rmse: Number
    reduced_chi2: Number
    held_out: Number


class MetricsDocument(Document):
    """Figures of merit of one case; `rows` is the number of rows that a model can describe."""

    label: str
    casing: BodyDocument
    rotor: BodyDocument
    energy_drift: Number
    further: list[BodyDocument] = []
    chi2_per_row: Number = Field(validation_alias=AliasChoices("chi2_per_row", "misfit"))
    # the default is for fits that were stored without it
    rows: int = Field(1000, validation_alias=AliasChoices("rows", "misfit_rows"))


class AngleNoiseDocument(Document):
    """Correlated angle noise: standard deviation and its standard uncertainty [rad], correlation time [s].

    The same three for the part that is periodic in the angle.
    """

    sigma_rad: Number = Field(validation_alias=AliasChoices("sigma_rad", "sigma"))
    sigma_u_rad: Number = Field(validation_alias=AliasChoices("sigma_u_rad", "sigma_u"))
    time_s: Number = Field(validation_alias=AliasChoices("time_s", "time"))
    turn_sigma_rad: Number = Field(0.0, validation_alias=AliasChoices("turn_sigma_rad", "turn_sigma"))
    turn_sigma_u_rad: Number = Field(0.0, validation_alias=AliasChoices("turn_sigma_u_rad", "turn_sigma_u"))
    turn_time_s: Number = Field(0.0, validation_alias=AliasChoices("turn_time_s", "turn_time"))


class CaseDocument(MetricsDocument):
    """The same with the process noise, of the recording and of this fit [N m], and the scale of the angle noise.

    `torque_unresolved_Nm`: random torque that is not separable from the angle noise, included in the uncertainties.
    """

    torque_noise_Nm: Number = Field(validation_alias=AliasChoices("torque_noise_Nm", "pure"))  # noqa: N815
    torque_noise_u_Nm: Number = Field(  # noqa: N815
        math.nan, validation_alias=AliasChoices("torque_noise_u_Nm", "pure_u")
    )
    torque_left_Nm: Number = Field(validation_alias=AliasChoices("torque_left_Nm", "level"))  # noqa: N815
    torque_unresolved_Nm: Number = Field(  # noqa: N815
        0.0, validation_alias=AliasChoices("torque_unresolved_Nm", "unresolved")
    )
    noise_scale: Number = Field(validation_alias=AliasChoices("noise_scale", "scale"))
    angle_noise: AngleNoiseDocument | None = None
    rotor_angle_noise: AngleNoiseDocument | None = None
    n_eff: Number = math.nan


class PriorDocument(Document):
    """A Gaussian prior: parameters of another study with their covariance [SI]."""

    source: str
    names: list[str]
    mean: list[Number]
    covariance: list[list[Number]]


class FirstOrderDocument(Document):
    """First-order response of a driven body of one case: time constant [s], gain and dead time of each input."""

    label: str
    body: str
    time_constant: EstimateDocument
    gains: dict[str, EstimateDocument]
    delays: dict[str, EstimateDocument]


class NameDocument(Document):
    """The name of an effect in words, and the symbol of its strength."""

    words: str
    symbol: str


class FitDocument(Document):
    """What `fit --json` prints."""

    fit_id: str
    model: list[str]
    names: dict[str, NameDocument] = {}
    parameters: dict[str, EstimateDocument]
    cases: list[CaseDocument] = []
    misfit: Number = math.nan
    n_eff: Number = math.nan
    bic: Number = math.nan
    verdict: str = ""
    findings: list[str] = []
    equations: list[str] = []
    not_determined: list[str] = []
    not_determined_together: list[dict[str, Number]] = []
    first_order: list[FirstOrderDocument] = []
    prior: PriorDocument | None = None


class FailureDocument(Document):
    """An interval of significant lack of fit."""

    label: str
    body: str
    t_start: Number
    t_stop: Number
    kind: str
    where: str
    size_sigma: Number
    residual_rad_s: Number
    residual_torque_Nm: Number  # noqa: N815 - the unit's own capitals
    torque_sigma_Nm: Number = math.nan  # noqa: N815
    omega_c: tuple[Number, Number]


class StoredFailure(FailureDocument):
    """The same with the name of the body in sentences and the uncertainty of the torque."""

    called: str
    unit: str = TORQUE


class CandidateDocument(Document):
    """A candidate effect with its score."""

    effect: str
    words: str
    symbol: str
    kind: str
    score: Number
    delta_bic: Number
    p_value: Number
    significant: Flag
    held_out_gain: Number
    indistinguishable_from: list[str]
    indistinguishable_words: list[str]
    parameters: dict[str, EstimateDocument]
    law: str


class RemainderDocument(Document):
    """What is still significant after the named effect: rms torque, share of the mean square, p-value."""

    torque_rms_Nm: Number  # noqa: N815 - the unit's own capitals
    share: Number
    p_value: Number
    sentence: str


class NuisanceDocument(Document):
    """An always fitted camera effect of one case."""

    effect: str
    label: str
    value: Number
    stderr: Number
    unit: str
    p_value: Number


class UpperLimitDocument(Document):
    """An effect that could still be hidden: 95 % upper limit of its strength, and of its rms torque."""

    effect: str
    symbol: str
    upper_limit: Number
    unit: str
    torque_Nm: Number  # noqa: N815 - the unit's own capitals


class ValuesInRecordings(Document):
    """The value of a parameter in each recording, by label; `differences` are those from the first recording."""

    parameter: str
    values: dict[str, EstimateDocument]
    differences: dict[str, EstimateDocument]


class DifferenceBetweenRecordings(ValuesInRecordings):
    """A parameter shared by the recordings that differs between them; `others` have separate values as well."""

    delta_bic: Number
    p_value: Number
    indistinguishable_from: list[str]
    others: list[ValuesInRecordings] = []


class StepDocument(Document):
    """One fit of a history: the change, and the errors; `_noise` marks values for noise alone."""

    fit_id: str
    added: str
    words: str = ""
    model: list[str]
    samples: int = 0
    n_eff: Number = math.nan
    rmse_casing: Number
    rmse_noise: Number = math.nan
    reduced_chi2: Number
    misfit: Number = math.nan  # of fits that were stored without it
    held_out: Number
    bic: Number = math.nan
    bic_noise: Number = math.nan
    delta_bic: Number
    energy_drift: Number
    torque_left_Nm: Number  # noqa: N815
    moved: list[str]
    verdict: FitVerdict


class NoiseDocument(Document):
    """Noise of one case: scale of the white noise, process noise, its uncertainty, and that of the model [N m].

    `unresolved` is the random torque that the residuals do not exclude.
    """

    scale: Number
    pure: Number
    pure_u: Number = 0.0
    level: Number
    unresolved: Number = 0.0


class StoredNoise(NoiseDocument):
    """The same with the correlation time [s], the excess, and the variables about which it is linearised."""

    time: Number
    excess: Number
    about: dict[str, Number]


class StoredFit(Document):
    """The state from which a fit is restored without a search; valid for the code with this digest alone."""

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
    differs: StoredDifference | None = None


class OutcomeDocument(Document):
    """The answer to one simulated recording, under the names of `fitting.discovery._certificate.Outcome`."""

    kind: Literal["null", "truth", "rival"]
    effect: str
    number: int
    verdict: str
    named: tuple[str, ...] = ()
    score: Number = math.nan
    inside: dict[str, bool] = {}


class StoredCertificate(Document):
    """The outcomes of a certificate, complete or not, with what they depend on."""

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

    `restored_from` (`StoredFit`), `diagnosis` (`StoredDiagnosis`), `certificate` and `certificate_of_films`
    (`StoredCertificate`) save time only: they are checked where they are used, and ignored if they are damaged.
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
    """What `Fit.save` writes: a fit without its data."""

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
    """Return the effects that are not, or not in this form, in the library, as are the laws of a chain of bodies."""
    return [e for e in effects if LIBRARY.get(e.name) != e]


def effects_of(names: Iterable[str], own: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return effects by name: the user's own, all others from the library."""
    known = LIBRARY | {e.name: e for e in own}
    found = {n: known.get(n) for n in names}
    if missing := [n for n, e in found.items() if e is None]:
        raise LedgerError(
            f"a stored fit contains the effect {missing[0][:60]!r}, which is not in the library of this version",
            "use the version of gyrotrack that wrote it, or another file of fits",
        )
    return tuple(e for e in found.values() if e is not None)


def as_json(document: Document) -> dict[str, Any]:
    """Return a document as `json` can write it."""
    return dict(to_json(document.model_dump()))


def as_text(document: Document) -> str:
    """Return a document as the text of a JSON file."""
    return json.dumps(as_json(document), indent=1, allow_nan=False)


_D = TypeVar("_D", LedgerDocument, SavedFitDocument)


def read_json(path: Path, kind: type[_D], what: str, hint: str) -> _D:
    """Read a JSON file of a kind: a ledger or a saved fit.

    A LedgerError says that the file is missing, of another kind, of a newer version, or damaged.
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
    """Return the document that a text of `path` contains; errors as for `read_json`."""
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
    """Return where and what the first error of a document is."""
    error = fault.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(map(str, error['loc'])) or 'document'}: {error['msg'][:120]}"
