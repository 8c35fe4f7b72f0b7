"""All runs of the paper's tables on some cases, and its two models fitted separately and together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fitting.case_data import CaseData
from fitting.effects import GENERAL, REDUCED
from fitting.errors import EstimationError, FittingError
from fitting.estimation import Fit, fit
from fitting.estimation.noise_levels import Noise
from fitting.estimation.prediction import Predicted, predict_recordings
from fitting.model import Model
from fitting.record import Record
from fitting.scanning.ranges import paper_ranges
from fitting.scanning.robustness import Robustness, robustness
from fitting.scanning.runs import AIR, BEARING, Run, shade

# a fall of the deviance that no parameter would notice
_SIDE_VALLEY = 0.1

Progress = Callable[[int, int | None], None]


@dataclass(frozen=True)
class Row:
    """One run on one case: its fit, or why there is none."""

    run: Run
    fit: Fit | None
    fault: str = ""

    @property
    def r2(self) -> float:
        """R2 of the casing's speed; nan without a fit."""
        return self.fit.cases[0].casing.r2 if self.fit is not None else float("nan")

    @property
    def shade(self) -> str:
        """The paper's shade of it; empty without a fit."""
        return shade(self.r2) if self.fit is not None else ""


@dataclass(frozen=True)
class ModelFits:
    """One of the paper's models on all cases.

    Attributes
    ----------
    name : str
        "reduced" or "general".
    separate : tuple of Fit
        On each case.
    joint : Fit or None
        On all together; None for a single case.
    predicted : tuple of Predicted
        Each case predicted from the others; empty for a single case.
    robustness : tuple of Robustness
        How steady each parameter is.
    """

    name: str
    separate: tuple[Fit, ...]
    joint: Fit | None
    predicted: tuple[Predicted, ...]
    robustness: tuple[Robustness, ...]


@dataclass(frozen=True)
class Scan:
    """What a scan found: two tables a case, and two models on all cases.

    Attributes
    ----------
    labels : tuple of str
        The cases.
    air, bearing : tuple of tuple of Row
        For each case the runs of `AIR` and of `BEARING`.
    models : tuple of ModelFits
        The reduced and the general model.
    """

    labels: tuple[str, ...]
    air: tuple[tuple[Row, ...], ...]
    bearing: tuple[tuple[Row, ...], ...]
    models: tuple[ModelFits, ...]

    @property
    def converged(self) -> bool:
        """Whether both models converged everywhere (a run of the tables may fail: that is an answer)."""
        fits = [f for m in self.models for f in (*m.separate, *([m.joint] if m.joint else []))]
        return all(f.verdict != "not converged" for f in fits)


def scan(cases: Sequence[Record | CaseData], *, progress: Progress | None = None) -> Scan:
    """Fit every on/off combination of the paper's terms, and its two models.

    The general model moves within the paper's ranges about the mean of the separate reduced fits. The noise of
    each case is measured once, with the reduced model, and every run is weighed by it.

    Parameters
    ----------
    cases : sequence of Record or CaseData
        The experiments.
    progress : callable, optional
        Called with fits done and fits in all.

    Returns
    -------
    Scan

    Raises
    ------
    EstimationError
        If there is no case, labels repeat, or the reduced model cannot be fitted.
    """
    data = [c if isinstance(c, CaseData) else CaseData.of(c) for c in cases]
    labels = tuple(d.record.label for d in data)
    if not data or len(set(labels)) != len(labels):
        raise EstimationError(
            "the cases of a scan need different labels", "give them with --label when making a case"
        )
    count = _Count(progress, len(data) * (len(AIR) + len(BEARING)) + 6)
    reduced = [fit(Model.of(REDUCED), [d]) for d in data]
    noise = [f.noise[0] for f in reduced]
    count.add(1)
    air, bearing = (
        tuple(_rows(runs, d, n, count) for d, n in zip(data, noise, strict=True)) for runs in (AIR, BEARING)
    )
    small = _model("reduced", reduced, data, noise, {}, {})
    count.add(2)
    ranges = paper_ranges(reduced, labels)
    # an extension starts from the model that it extends: it cannot end worse, and soon is there
    wide = Model.of(GENERAL)
    general = [
        fit(wide, [d], noise=[n], ranges=ranges, start=_extended(wide, f))
        for d, n, f in zip(data, noise, reduced, strict=True)
    ]
    start = _extended(wide, small.joint) if small.joint is not None else {}
    large = _model("general", general, data, noise, ranges, start)
    count.add(3)
    return Scan(labels, air, bearing, (small, large))


def _model(
    name: str,
    separate: Sequence[Fit],
    data: Sequence[CaseData],
    noise: Sequence[Noise],
    ranges: dict[str, tuple[float, float]],
    start: dict[str, float],
) -> ModelFits:
    model = separate[0].model
    if len(data) == 1:
        return ModelFits(name, tuple(separate), None, (), robustness(separate, None))
    joint = fit(model, data, noise=noise, ranges=ranges, start=start)
    predicted = predict_recordings(model, data, noise, alone=separate)
    return ModelFits(name, tuple(separate), joint, predicted, robustness(separate, joint))


def _rows(runs: Sequence[Run], data: CaseData, noise: Noise, count: _Count) -> tuple[Row, ...]:
    """Fit the runs of a table, the small ones first: a power law beside others is sought from what it extends."""
    rows: dict[Run, Row] = {}
    for run in sorted(runs, key=lambda r: len(r.terms)):
        inner = [r.fit for r in rows.values() if r.fit is not None and set(r.run.terms) < set(run.terms)]
        best = min(inner, key=lambda f: f.deviance, default=None)
        follows = best is not None and "bearing.power" in best.model.names
        row = Row(run, None) if follows else _row(run, data, noise)
        if best is not None and (row.fit is None or row.fit.deviance > best.deviance + _SIDE_VALLEY):
            # no model can do worse than one that it contains: that search ended in a side valley
            row = _better(row, best, data, noise)
        rows[run] = row
        count.add(1)
    return tuple(rows[run] for run in runs)


def _better(row: Row, inner: Fit, data: CaseData, noise: Noise) -> Row:
    model = Model.of(row.run.effects)
    try:
        again = fit(model, [data], noise=[noise], start=_extended(model, inner))
    except FittingError as fault:
        return row if row.fit is not None or row.fault else Row(row.run, None, fault.message)
    return Row(row.run, again) if row.fit is None or again.deviance < row.fit.deviance else row


def _extended(model: Model, inner: Fit) -> dict[str, float]:
    return {k: p.start for k, p in model.parameters.items()} | {
        k: e.value for k, e in inner.estimates.items()
    }


def _row(run: Run, data: CaseData, noise: Noise) -> Row:
    model = Model.of(run.effects)
    try:
        return Row(run, _fit(model, data, noise))
    except FittingError as fault:
        return Row(run, None, fault.message)


def _fit(model: Model, data: CaseData, noise: Noise) -> Fit:
    try:
        return fit(model, [data], noise=[noise])
    except FittingError:
        # a wrong bearing law may ask for a touch point that stops the casing: begin without one
        rough = Model(tuple(e for e in model.effects if not e.name.startswith("touchpoint.")))
        if rough == model:
            raise
        begin = {k: e.value for k, e in fit(rough, [data], noise=[noise]).estimates.items()}
        held = {k: 0.0 for k in model.free if k not in begin}
        return fit(model, [data], noise=[noise], start=begin | held)


class _Count:
    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0
        self.add(0)

    def add(self, steps: int) -> None:
        self._done += steps
        if self._progress is not None:
            self._progress(self._done, self._total)
