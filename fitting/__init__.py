"""Friction models of two spinning bodies: fit them, test them, find the missing effect.

>>> from fitting import Case, fit  # doctest: +SKIP
>>> result = fit("reduced", Case.load("case1.h5"))  # doctest: +SKIP

Public names are imported on first use; ``import fitting`` alone imports nothing else.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fitting._criteria import Criteria
    from fitting._errors import (
        EffectError,
        EstimationError,
        ExpressionError,
        FittingError,
        LedgerError,
        RecordError,
        SimulationError,
    )
    from fitting.discovery._certificate import Certificate, certify
    from fitting.discovery._laws import laws
    from fitting.discovery._plan import plan
    from fitting.discovery._select import Candidate, improve
    from fitting.discovery._verdict import Diagnosis, diagnose
    from fitting.dynamics._inputs import Input
    from fitting.dynamics._model import Model
    from fitting.effects._effect import Effect, Parameter
    from fitting.effects._library import GENERAL, LIBRARY, LINEAR, REDUCED
    from fitting.effects._user import read_effects
    from fitting.effects._user import resolve as effect
    from fitting.effects._words import EffectName, effect_name
    from fitting.inference._budget import budget
    from fitting.inference._case import Case
    from fitting.inference._case_data import CaseData
    from fitting.inference._error_modes import ErrorMode
    from fitting.inference._first_order import FirstOrder, first_order
    from fitting.inference._params import Estimate, Params
    from fitting.inference._profile import profile as profile_interval
    from fitting.inference._record import Record, make_record
    from fitting.inference._result import Fit
    from fitting.inference._simulation import Experiment, simulate
    from fitting.study._comparison import compare
    from fitting.study._history import Ledger
    from fitting.study._scan import Scan, predict_recordings, scan
    from fitting.study._scan_tables import scan_lines
    from fitting.study._serialisation import load_fit

__all__ = [
    "GENERAL",
    "LIBRARY",
    "LINEAR",
    "REDUCED",
    "Candidate",
    "Case",
    "Certificate",
    "Criteria",
    "Diagnosis",
    "Effect",
    "EffectError",
    "EffectName",
    "ErrorMode",
    "Estimate",
    "EstimationError",
    "Experiment",
    "ExpressionError",
    "FirstOrder",
    "Fit",
    "FittingError",
    "Input",
    "Ledger",
    "LedgerError",
    "Model",
    "Parameter",
    "Params",
    "Record",
    "RecordError",
    "Scan",
    "SimulationError",
    "budget",
    "certify",
    "compare",
    "diagnose",
    "effect",
    "effect_name",
    "first_order",
    "fit",
    "improve",
    "laws",
    "load",
    "load_fit",
    "make_record",
    "plan",
    "predict_recordings",
    "profile_interval",
    "read_effects",
    "scan",
    "scan_lines",
    "simulate",
]  # fmt: skip

_MODULES = {
    "fitting._errors": tuple(n for n in __all__ if n.endswith("Error")),
    "fitting._criteria": ("Criteria",),
    "fitting.discovery._certificate": ("Certificate", "certify"),
    "fitting.discovery._laws": ("laws",),
    "fitting.discovery._plan": ("plan",),
    "fitting.discovery._select": ("Candidate", "improve"),
    "fitting.discovery._verdict": ("Diagnosis", "diagnose"),
    "fitting.dynamics._inputs": ("Input",),
    "fitting.dynamics._model": ("Model",),
    "fitting.effects._effect": ("Effect", "Parameter"),
    "fitting.effects._library": ("GENERAL", "LIBRARY", "LINEAR", "REDUCED"),
    "fitting.effects._user": ("effect", "read_effects"),
    "fitting.effects._words": ("EffectName", "effect_name"),
    "fitting.inference._budget": ("budget",),
    "fitting.inference._case": ("Case",),
    "fitting.inference._error_modes": ("ErrorMode",),
    "fitting.inference._first_order": ("FirstOrder", "first_order"),
    "fitting.inference._params": ("Estimate", "Params"),
    "fitting.inference._profile": ("profile_interval",),
    "fitting.inference._record": ("Record", "make_record"),
    "fitting.inference._result": ("Fit",),
    "fitting.inference._simulation": ("Experiment", "simulate"),
    "fitting.study._comparison": ("compare",),
    "fitting.study._history": ("Ledger",),
    "fitting.study._scan": ("Scan", "predict_recordings", "scan"),
    "fitting.study._scan_tables": ("scan_lines",),
    "fitting.study._serialisation": ("load_fit",),
}
_ALIASES = {"effect": "resolve", "profile_interval": "profile"}
_PLACES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name where it is first used."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from fitting._arguments import PUBLIC, checked, of_function

    value = getattr(import_module(_PLACES[name]), _ALIASES.get(name, name))
    if name in PUBLIC:
        value = checked(value, name, of_function(name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted({*globals(), *__all__})


def load(path: str | Path, *, data: str | None = None, rotor: str = "windows") -> Record:
    """Read a case.

    Parameters
    ----------
    path : str or Path
        An HDF5 file made by ``gyrotrack sync`` or ``gyrotrack import``.
    data : {"angle", "velocity"}, optional
        The quantity to fit; the measured one by default.
    rotor : {"windows", "generated"}
        The measured rotor windows, or the paper's generated curve through them.

    Returns
    -------
    Record
        Arrays of time [s], value and sigma [rad or rad/s] of both bodies; `fitting.make_record` makes one from arrays.

    Raises
    ------
    RecordError
        If the file is missing or damaged, or has no angles where angles are requested.
    """
    from fitting._arguments import PATH, TEXT, require
    from fitting.inference._case_file import read_record

    require("path", path, PATH)
    require("data", data, TEXT.optional)
    require("rotor", rotor, TEXT)
    record = read_record(path)
    if data is None and rotor == "windows":
        return record
    from fitting.study._paper import prepared

    return prepared(record, data, rotor)


def fit(
    model: Model | str | Sequence[str],
    cases: Case | Record | CaseData | Sequence[Case | Record | CaseData],
    *,
    params: Mapping[str, Any] | None = None,
    fixed: Mapping[str, float] | None = None,
    loss: str = "linear",
    share: Iterable[str] = (),
    per_case: Iterable[str] = (),
    start: Mapping[str, float] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    criteria: Criteria | None = None,
) -> Fit:
    """Fit a model to one case, or to several together.

    Parameters
    ----------
    model : Model, str or sequence of str
        The model; names of laws or formulas (``"support.constant + air.linear"``); or one of the paper's models:
        "reduced", "general", "linear" (for a record of a single body: the part of it that acts on this body).
    cases : Case or Record, or a sequence of them
        The experiments. With several, touch point, casing drag and initial angular rates have a value for each.
    params : Params, or mapping of str to mapping, optional
        Settings of parameters by name: ``{"k": {"value": 0.7, "vary": False}}``, with value (initial, or held), vary,
        min, max, and expr, an expression of other parameters that it follows: ``{"k": {"expr": "2*d"}}``. The
        `params` of an earlier fit are such settings.
    fixed : mapping of str to float, optional
        Parameters held at a value [SI]: ``{"bearing.power.g": 0.7}``.
    loss : {"linear", "huber", "cauchy"}
        Least squares, or a robust loss that limits the influence of outliers.
    share, per_case : iterable of str
        Parameters with one value for all cases, or with a value for each.
    start : mapping of str to float, optional
        Initial values [SI]; by default they are computed from the data.
    ranges : mapping of str to (float, float), optional
        Bounds by name [SI], within the declared ones.
    criteria : Criteria, optional
        What counts as noise in the recordings, and the thresholds of the verdict and of a search from this fit.

    Returns
    -------
    Fit
        Parameters with standard uncertainties, figures of merit, verdict; see `Fit.to_dataframe` and `Fit.save`.

    Raises
    ------
    FittingError
        If an argument is wrong, or the model cannot be fitted to these data.
    """
    from fitting._arguments import CRITERIA, NUMBERS, TEXT, require
    from fitting._errors import EstimationError
    from fitting._workers import single_blas_thread
    from fitting.inference._case_data import CaseData
    from fitting.inference._fit import robust_fit
    from fitting.inference._params import Names, Settings, settings_of

    require("loss", loss, TEXT)
    require("criteria", criteria, CRITERIA.optional)
    several = _cases(cases)
    records = [c.record if isinstance(c, CaseData) else c for c in several]
    chosen = _model(model, records)
    for name, mapping in (("fixed", fixed), ("start", start), ("ranges", ranges)):
        if not isinstance(mapping, Mapping | None):
            raise EstimationError(
                f"{name} is a {type(mapping).__name__}; use a mapping", 'for example {"bearing.power.g": 0.7}'
            )
    for name, mapping in (("fixed", fixed), ("start", start)):
        require(name, mapping, NUMBERS.optional)
    for key, pair in (ranges or {}).items():
        if not _is_range(pair):
            raise EstimationError(f"the range of {key!r} is {pair!r}", "use a pair (lower, upper)")
    names = Names.of(chosen, records)
    asked = Settings(
        {names(k): float(v) for k, v in (fixed or {}).items()},
        # values of another fit are initial values of the parameters that both have
        {k if names.missing(k) else names(k): float(v) for k, v in (start or {}).items()},
        {names(k): (float(a), float(b)) for k, (a, b) in (ranges or {}).items()},
    )
    asked = settings_of(params, chosen, records).joined(asked)
    options: dict[str, Any] = {
        "share": _names(share),
        "per_case": _names(per_case),
        "start": asked.start or None,
        "ranges": asked.ranges or None,
        "ties": {k: names.tie(text) for k, text in asked.ties.items()} or None,
    }
    if criteria is not None:
        several = [c.with_criteria(criteria) if isinstance(c, CaseData) else c for c in several]
        options["criteria"] = criteria
    with single_blas_thread():
        return robust_fit(chosen.with_fixed(asked.fixed), several, loss, **options)


def _model(model: object, records: Sequence[Record]) -> Model:
    from fitting._errors import EffectError
    from fitting.dynamics._model import Model
    from fitting.inference._case import model_of

    if isinstance(model, Model):
        return model
    if not isinstance(model, str | Sequence) or not model:
        raise EffectError(
            f"a {type(model).__name__} is not a model",
            'use a Model, names of laws ("air.linear + support.constant") or one of "reduced", "general", "linear"',
        )
    if not records:
        return Model.of(model)
    return model_of(model, records[0])


def _is_range(pair: object) -> bool:
    from numbers import Real

    if isinstance(pair, str) or not isinstance(pair, Sequence) or len(pair) != 2:
        return False
    return all(isinstance(x, Real) for x in pair) and bool(pair[0] <= pair[1])


def _cases(cases: object) -> list[Record | CaseData]:
    from fitting._errors import EstimationError
    from fitting.inference._case import Case
    from fitting.inference._case_data import CaseData
    from fitting.inference._record import Record

    several: list[Any] = (
        list(cases) if isinstance(cases, Iterable) and not isinstance(cases, str) else [cases]
    )
    several = [c.record if isinstance(c, Case) else c for c in several]
    wrong = [type(c).__name__ for c in several if not isinstance(c, Record | CaseData)]
    if wrong:
        raise EstimationError(
            f"a case is a {wrong[0]}, not a Record",
            "read a file with fitting.load or use fitting.Case.from_arrays",
        )
    return several


def _names(names: Iterable[str]) -> tuple[str, ...]:
    from fitting._errors import EffectError

    found = (names,) if isinstance(names, str) else tuple(names) if isinstance(names, Iterable) else (names,)
    if not all(isinstance(n, str) for n in found):
        raise EffectError(
            "share and per_case are names of parameters", 'write for example ["casing.air.linear"]'
        )
    return found
