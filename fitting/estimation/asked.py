"""The fit as a person asks for it: one case or several, what is held, which loss."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from fitting.case_data import CaseData
from fitting.estimation.outcome import Fit
from fitting.estimation.robust import robust_fit
from fitting.model import Model
from fitting.record import Record


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
