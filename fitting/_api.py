"""Reading a case, and fitting models to cases; modules that need SciPy or h5py are imported on first use."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting._arguments import CRITERIA, NUMBERS, PATH, TEXT, require
from fitting._errors import EffectError, EstimationError
from fitting._workers import single_blas_thread
from fitting.dynamics._model import Model
from fitting.inference._case import Case, model_of
from fitting.inference._record import Record

if TYPE_CHECKING:
    from fitting._criteria import Criteria
    from fitting.inference._case_data import CaseData
    from fitting.inference._result import Fit


def load(path: str | Path, *, data: str | None = None, rotor: str = "windows") -> Record:
    """Read a case.

    Parameters
    ----------
    path : str or Path
        An HDF5 file made by ``gyrotrack sync`` or ``gyrotrack import``.
    data : {"angle", "velocity"}, optional
        The quantity to fit; by default the measured quantity.
    rotor : {"windows", "generated"}
        The measured rotor windows, or the paper's generated curve through them.

    Returns
    -------
    Record
        Arrays of time [s], value and sigma [rad or rad/s] of both bodies; `fitting.make_record` makes a record from
        arrays.

    Raises
    ------
    RecordError
        If the file is missing or damaged, or has no angles where angles are requested.
    """
    from fitting.inference._case_file import read_record
    from fitting.study._preparation import prepared

    require("path", path, PATH)
    require("data", data, TEXT.optional)
    require("rotor", rotor, TEXT)
    record = read_record(path)
    if data is None and rotor == "windows":
        return record
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
        The model, names of laws or formulas (``"support.constant + air.linear"``), or one of the paper's models
        "reduced", "general" and "linear". For a record of a single body, only the laws that act on this body are used.
    cases : Case or Record, or a sequence of them
        The experiments. For several cases, touch point, casing drag and initial angular rates have one value per case.
    params : Params, or mapping of str to mapping, optional
        Settings of parameters by name, for example ``{"k": {"value": 0.7, "vary": False}}``. The keys are value (the
        initial or the fixed value), vary, min, max, and expr, an expression of other parameters that gives the value,
        for example ``{"k": {"expr": "2*d"}}``. The `params` of an earlier fit are also accepted.
    fixed : mapping of str to float, optional
        Parameters held at a value [SI]: ``{"bearing.power.g": 0.7}``.
    loss : {"linear", "huber", "cauchy"}
        Least squares, or a robust loss that limits the influence of outliers.
    share, per_case : iterable of str
        Parameters with one value for all cases (`share`), or with a separate value for each case (`per_case`).
    start : mapping of str to float, optional
        Initial values [SI]; by default they are computed from the data.
    ranges : mapping of str to (float, float), optional
        Bounds by name [SI], within the declared bounds.
    criteria : Criteria, optional
        Criteria of the noise in the recordings, and thresholds of the verdict and of searches that start from this fit.

    Returns
    -------
    Fit
        Parameters with standard uncertainties, figures of merit, verdict; see `Fit.to_dataframe` and `Fit.save`.

    Raises
    ------
    FittingError
        If an argument is wrong, or the model cannot be fitted to these data.
    """
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
        # if another fit is given as the start, its values are used for all parameters that both models contain
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
    if isinstance(pair, str) or not isinstance(pair, Sequence) or len(pair) != 2:
        return False
    return all(isinstance(x, Real) for x in pair) and bool(pair[0] <= pair[1])


def _cases(cases: object) -> list[Record | CaseData]:
    from fitting.inference._case_data import CaseData

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
    found = (names,) if isinstance(names, str) else tuple(names) if isinstance(names, Iterable) else (names,)
    if not all(isinstance(n, str) for n in found):
        raise EffectError(
            "share and per_case must be lists of names of parameters",
            'write, for example, ["casing.air.linear"]',
        )
    return found
