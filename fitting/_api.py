"""The interface for users: load cases, fit one or several."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fitting._errors import EffectError, EstimationError
from fitting._workers import single_blas_thread
from fitting.dynamics._model import Model
from fitting.inference._case_data import CaseData
from fitting.inference._case_file import read_record
from fitting.inference._fit import robust_fit
from fitting.inference._record import Record
from fitting.inference._result import Fit


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
    record = read_record(path)
    if data is None and rotor == "windows":
        return record
    from fitting.study._paper import prepared

    return prepared(record, data, rotor)


@single_blas_thread()
def fit(
    model: Model | str,
    cases: Record | CaseData | Sequence[Record | CaseData],
    *,
    fixed: Mapping[str, float] | None = None,
    loss: str = "linear",
    share: Iterable[str] = (),
    per_case: Iterable[str] = (),
    start: Mapping[str, float] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> Fit:
    """Fit a model to one case, or to several together.

    Parameters
    ----------
    model : Model or str
        The model, or the name of one of the paper's models: "reduced", "general", "linear"
        (for a record of a single body: the part of it that acts on this body).
    cases : Record, or sequence of Record
        The experiments. With several, touch point, casing drag and initial angular rates have a value for each.
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

    Returns
    -------
    Fit
        Parameters with standard uncertainties, figures of merit, verdict; see `Fit.to_dataframe` and `Fit.save`.

    Raises
    ------
    FittingError
        If an argument is wrong, or the model cannot be fitted to these data.
    """
    several = _cases(cases)
    if not isinstance(model, Model | str):
        raise EffectError(
            f"a {type(model).__name__} is not a model", 'use a Model or one of "reduced", "general", "linear"'
        )
    chosen = Model.of(model) if isinstance(model, str) else model
    records = [c.record if isinstance(c, CaseData) else c for c in several]
    if isinstance(model, str) and records and all(r.single for r in records):
        chosen = chosen.alone
    for name, mapping in (("fixed", fixed), ("start", start), ("ranges", ranges)):
        if not isinstance(mapping, Mapping | None):
            raise EstimationError(
                f"{name} is a {type(mapping).__name__}; use a mapping", 'for example {"bearing.power.g": 0.7}'
            )
    for key, pair in (ranges or {}).items():
        if not isinstance(pair, Sequence) or len(pair) != 2 or not pair[0] <= pair[1]:
            raise EstimationError(f"the range of {key!r} is {pair!r}", "use a pair (lower, upper)")
    options = {"share": _names(share), "per_case": _names(per_case), "start": start, "ranges": ranges}
    return robust_fit(chosen.with_fixed(fixed or {}), several, loss, **options)


def _cases(cases: object) -> list[Record | CaseData]:
    several: list[Any] = (
        list(cases) if isinstance(cases, Iterable) and not isinstance(cases, str) else [cases]
    )
    wrong = [type(c).__name__ for c in several if not isinstance(c, Record | CaseData)]
    if wrong:
        raise EstimationError(
            f"a case is a {wrong[0]}, not a Record",
            "read a file with fitting.load or use fitting.make_record",
        )
    return several


def _names(names: Iterable[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)
