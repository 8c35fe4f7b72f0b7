"""The fit as users ask for it: load cases, fit one or several."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from fitting._workers import single_blas_thread
from fitting.dynamics._model import Model
from fitting.inference._case_data import CaseData
from fitting.inference._case_file import read_record
from fitting.inference._record import Record
from fitting.inference._result import Fit
from fitting.inference._robust import robust_fit


def load(path: str | Path, *, data: str | None = None, rotor: str = "windows") -> Record:
    """Read a case.

    Parameters
    ----------
    path : str or Path
        An HDF5 file made by ``gyrotrack sync`` or ``gyrotrack import``.
    data : {"angle", "velocity"}, optional
        What is to be fitted; what was measured, if not given.
    rotor : {"windows", "generated"}
        The rotor's windows as measured, or the paper's curve through them.

    Returns
    -------
    Record
        Arrays of time, value and sigma of both bodies; `fitting.make_record` makes one from arrays.

    Raises
    ------
    RecordError
        If the file is missing or not sound, or holds no angles where angles are asked for.
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
        The model, or the name of one of the paper's: "reduced", "general", "linear"
        (of these the part that one body alone has, where there is no rotor).
    cases : Record, or sequence of Record
        Each experiment. With several, touch point, casing drag and start speeds are each case's own.
    fixed : mapping, optional
        Parameters held at a value: ``{"bearing.power.g": 0.7}``.
    loss : {"linear", "huber", "cauchy"}
        How much outliers count.
    share, per_case : iterable of str
        Change which parameters are shared.
    start : mapping, optional
        Values to start from; none are needed.
    ranges : mapping, optional
        Bounds by name, within the declared ones.

    Returns
    -------
    Fit
        Parameters with errors, figures of merit, verdict; prints itself, `to_dataframe`, `save`.

    Raises
    ------
    FittingError
        If the model cannot be fitted to these data; the message says why.
    """
    several = [cases] if isinstance(cases, Record | CaseData) else list(cases)
    wanted = Model.of(model) if isinstance(model, str) else model
    records = [c.record if isinstance(c, CaseData) else c for c in several]
    if isinstance(model, str) and records and all(r.single for r in records):
        wanted = wanted.alone
    options = {"share": tuple(share), "per_case": tuple(per_case), "start": start, "ranges": ranges}
    return robust_fit(wanted.with_fixed(fixed or {}), several, loss, **options)
