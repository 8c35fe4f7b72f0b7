"""All on/off combinations of the paper's terms, the paper's two models, and the robustness of parameters.

As in the paper, tables 1 and 2 vary the drags of rotor and casing, with the linear law of the bearing: first with all
four drag terms, then without one of the terms. Tables 3 and 4 vary the laws of the bearing (without a1): all fifteen
combinations of c, d, e and f.

In the cross-validation over recordings, shared parameters have the values of a fit of the other recordings. Only
parameters that the other recordings do not determine are free: the friction at the touch point (another surface) and
the initial speeds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

from fitting._errors import EstimationError, FittingError
from fitting._numbers import on_screen
from fitting._workers import single_blas_thread
from fitting.dynamics._model import Model
from fitting.effects._library import GENERAL, LIBRARY, REDUCED
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._metrics import BodyMetrics
from fitting.inference._noise import Noise
from fitting.inference._parameters import parameters_at
from fitting.inference._params import Estimate
from fitting.inference._record import Record
from fitting.inference._result import Fit


@dataclass(frozen=True)
class Column:
    """One parameter in a table: the paper's symbol, its key, SI unit, and the power of ten in the header."""

    symbol: str
    key: str
    unit: str
    exponent: int


COLUMNS = {
    c.symbol: c
    for c in (
        Column("a1", "rotor.air.linear.a1", "N m s", -11),
        Column("a2", "rotor.air.quadratic.a2", "N m s2", -11),
        Column("b1", "touchpoint.constant.b1", "N m", -6),
        Column("b2", "casing.air.linear.b2", "N m s", -7),
        Column("c", "bearing.constant.c", "N m", -7),
        Column("d", "bearing.linear.d", "N m s", -7),
        Column("e", "bearing.quadratic.e", "N m s2", -11),
        Column("f", "bearing.power.f", "N m s^g", -7),
        Column("g", "bearing.power.g", "1", 0),
    )
}
EFFECT_OF = {symbol: c.key.rpartition(".")[0] for symbol, c in COLUMNS.items() if symbol != "g"}


@dataclass(frozen=True)
class Run:
    """One combination of terms; `g` is fitted if `f` is."""

    terms: tuple[str, ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects of the combination."""
        return tuple(EFFECT_OF[t] for t in self.terms)


AIR_COLUMNS = ("a1", "a2", "b1", "b2", "d")
AIR = tuple(Run(tuple(t for t in AIR_COLUMNS if t != left_out)) for left_out in ("", "a1", "a2", "b1", "b2"))

BEARING_COLUMNS = ("a2", "b1", "b2", "c", "d", "e", "f", "g")
BEARING = tuple(
    Run(("a2", "b1", "b2", *on))
    for on in ["cdef", "def", "cef", "cdf", "cde", "ef", "df", "de", "cf", "ce", "cd", "f", "e", "d", "c"]
)  # fmt: skip

_SHADES = ((0.99, "white"), (0.90, "light gray"), (0.0, "gray"))


def shade(r2: float) -> str:
    """Return the paper's shade of an R2: "white" from 0.99, "light gray" from 0.90, "gray" from 0, else "dark gray"."""
    return next((name for least, name in _SHADES if r2 >= least), "dark gray")


WIDTHS = {
    "rotor.air.quadratic.a2": 0.2,
    "casing.air.linear.b2": 0.2,
    "bearing.power.g": 0.2,
    "bearing.linear.d": 0.5,
    "bearing.power.f": 0.5,
}
"""Relative half width of the range of each listed parameter; other parameters keep their declared bounds [1]. Source:
bounds that the paper prints."""


def paper_ranges(reduced: Sequence[Fit], labels: Sequence[str] = ()) -> dict[str, tuple[float, float]]:
    """Return ranges about the mean of separate fits of the reduced model, by name.

    The mean is over the separate fits, as values in the paper show: for the second case, the paper prints g = 1.05 and
    f = 0.0795e-7, which are the bounds 0.8 (1.32 + 1.30)/2 and 0.5 (0.126 + 0.192)/2 e-7. In a joint fit, parameters
    may have separate values for the cases `labels`. A parameter that is zero in the reduced fits keeps its declared
    bounds.
    """
    ranges = {}
    for key, width in WIDTHS.items():
        values = [e.value for fit in reduced for e in _of(fit, key)]
        mean = sum(values) / len(values) if values else 0.0
        if mean > 0:
            for name in (key, *(f"{key}@{label}" for label in labels)):
                ranges[name] = ((1 - width) * mean, (1 + width) * mean)
    return ranges


_ROBUST = 0.1
"""A parameter is robust if its relative change is below this value [1]. Source: parameters that the paper calls robust
change by a few per cent."""
_UNSTABLE = 0.5
"""Smallest relative change of an unstable parameter [1]. Source: parameters that the paper calls unstable change by
half or more."""


@dataclass(frozen=True)
class Robustness:
    """One parameter of one model across cases.

    The larger of spread and shift determines the `verdict`: "robust" (under a tenth), "varies" (under a half) or
    "unstable". For a touch point the shift alone decides, because surfaces may differ. The verdict is "zero" or "not
    determined" if the parameter is zero or not determined in all separate fits. It is "not known" for a single case.
    `shift` is the relative change from the mean of the separate fits to the joint fit, or the largest change if each
    case has its own value.
    """

    symbol: str  #: Symbol of the parameter.
    key: str  #: Key of the parameter.
    unit: str  #: Unit of the mean.
    mean: float  #: Mean over the separate fits [`unit`].
    spread: float  #: Range of the values divided by the mean; unknown for a single case [1].
    shift: float  #: Relative change from the mean to the joint fit, if there is one [1].
    sigma: float  #: Largest difference of two fits [standard errors].
    verdict: str  #: `robust`, `varies`, `unstable`, `zero`, `not determined` or `not known`.


def robustness(separate: Sequence[Fit], joint: Fit | None) -> tuple[Robustness, ...]:
    """Return the robustness of each of the paper's parameters, from fits of one model to each case and jointly."""
    found = []
    for column in COLUMNS.values():
        own = [e for fit in separate for e in _of(fit, column.key)]
        if len(own) == len(separate) > 0:
            together = _of(joint, column.key) if joint is not None else []
            found.append(_one(column, own, [e.value for e in together]))
    return tuple(found)


def _of(fit: Fit, key: str) -> list[Estimate]:
    return [e for name, e in fit.estimates.items() if name.partition("@")[0] == key]


def _one(column: Column, own: Sequence[Estimate], together: Sequence[float]) -> Robustness:
    values = [e.value for e in own]
    mean = sum(values) / len(values)
    spread = _share(max(values) - min(values), mean) if len(values) > 1 else math.nan
    if len(together) == len(values) > 1:
        shift = max((_share(b - a, a) for a, b in zip(values, together, strict=True)), key=abs)
    else:
        shift = _share(together[0] - mean, mean) if together else math.nan
    differences = [
        abs(a.value - b.value) / math.hypot(a.stderr, b.stderr)
        for a, b in combinations(own, 2)
        if a.stderr > 0 and b.stderr > 0
    ]
    sigma = max(differences, default=math.nan)
    verdict = _verdict(column, own, spread, shift)
    return Robustness(column.symbol, column.key, column.unit, mean, spread, shift, sigma, verdict)


def _share(difference: float, of: float) -> float:
    return difference / abs(of) if of else (0.0 if difference == 0 else math.inf)


def _verdict(column: Column, own: Sequence[Estimate], spread: float, shift: float) -> str:
    if all(e.value == 0 for e in own):
        return "zero"
    if all(e.at_bound or e.stderr > abs(e.value) for e in own):
        return "not determined"
    counted = (shift,) if LIBRARY[column.key.rpartition(".")[0]].per_surface else (spread, shift)
    worst = max((abs(x) for x in counted if not math.isnan(x)), default=math.nan)
    if math.isnan(worst):
        return "not known"
    return "robust" if worst < _ROBUST else "varies" if worst < _UNSTABLE else "unstable"


@dataclass(frozen=True)
class Predicted:
    """One recording, predicted from a fit of the other recordings."""

    label: str
    casing: float  # rms prediction error divided by the noise; 1 is the noise limit
    rotor: float
    r2: float  # coefficient of determination of the casing's smoothed speed
    rmse: float  # rms error of the casing's smoothed speed [rad/s]
    others: Fit  # the fit of the other recordings, with the values of the shared parameters


def predict_recordings(
    model: Model, data: Sequence[CaseData], noise: Sequence[Noise], *, alone: Sequence[Fit] = ()
) -> tuple[Predicted, ...]:
    """Predict each recording from a fit of the other recordings.

    Parameters
    ----------
    model : Model
        The model.
    data : sequence of CaseData
        At least two recordings.
    noise : sequence of Noise
        Noise of each recording, from an earlier fit.
    alone : sequence of Fit
        Fits of the model to each recording alone, if available (saves time for two recordings).

    Raises
    ------
    EstimationError
        If there is only one recording.
    """
    if len(data) < 2:
        raise EstimationError(
            "one recording cannot be predicted from others",
            "give several cases, or use the cross-validation error of the fit",
        )
    surface = {f"{e.name}.{p.symbol}" for e in model.effects if e.per_surface for p in e.free}
    shared = [key for key in model.free if key not in surface]
    found = []
    for i, held in enumerate(data):
        rest = [k for k in range(len(data)) if k != i]
        if len(rest) == 1 and alone:
            others = alone[rest[0]]
        else:
            # a value per case would be unknown for the predicted recording, so the other recordings share one value
            others = fit(model, [data[k] for k in rest], share=shared, noise=[noise[k] for k in rest])
        held_values = {key: others.estimates[key].value for key in shared}
        free = fit(model.with_fixed(held_values), [held], noise=[noise[i]])
        (case,) = free.cases
        errors = _prediction_error(case.casing), _prediction_error(case.rotor)
        found.append(Predicted(held.record.label, *errors, case.casing.r2, case.casing.rmse, others))
    return tuple(found)


def _prediction_error(body: BodyMetrics) -> float:
    return math.sqrt(body.reduced_chi2)


_SAME_MINIMUM = 0.1
"""Largest difference between two deviances at the same minimum [1]. Chosen: a third of a standard error; a smaller
value repeats fits, a larger one accepts a wrong minimum."""

Progress = Callable[[int, int | None], None]


@dataclass(frozen=True)
class Row:
    """One run on one case: its fit, or the reason why there is none."""

    run: Run
    fit: Fit | None
    fault: str = ""

    @property
    def r2(self) -> float:
        """R2 of the casing's speed; nan without a fit."""
        return self.fit.cases[0].casing.r2 if self.fit is not None else float("nan")

    @property
    def shade(self) -> str:
        """The paper's shade of this R2; empty without a fit."""
        return shade(self.r2) if self.fit is not None else ""


@dataclass(frozen=True)
class ModelFits:
    """One of the paper's models on all cases."""

    name: str  # "reduced" or "general"
    separate: tuple[Fit, ...]  # fit of each case
    joint: Fit | None  # joint fit of all cases; None for a single case
    predicted: tuple[Predicted, ...]  # prediction of each case from the other cases; empty for a single case
    robustness: tuple[Robustness, ...]


@dataclass(frozen=True, repr=False)
class Scan:
    """The result of a scan: two tables for each case, and two models on all cases.

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

    def __repr__(self) -> str:
        runs = sum(len(rows) for rows in (*self.air, *self.bearing))
        lines = [f"scan of {', '.join(self.labels)}: {runs} combinations of terms; see scan_lines()"]
        for m in self.models:
            fits = [(f"{', '.join(f.labels)}", f) for f in m.separate]
            fits += [("joint", m.joint)] if m.joint is not None else []
            lines += [f"  {m.name}, {label}: BIC {f.bic:.1f}, {f.verdict}" for label, f in fits]
        return on_screen(lines)

    @property
    def converged(self) -> bool:
        """Whether both models converged for all cases (runs of the tables may fail)."""
        fits = [f for m in self.models for f in (*m.separate, *([m.joint] if m.joint else []))]
        return all(f.verdict != "not_converged" for f in fits)


@single_blas_thread()
def scan(cases: Sequence[Record | CaseData], *, progress: Progress | None = None) -> Scan:
    """Fit every on/off combination of the paper's terms, and the paper's two models.

    The parameters of the general model are bounded by the paper's ranges about the mean of the separate reduced fits.
    The noise of each case is estimated once, with the reduced model, and used for every run.

    Parameters
    ----------
    cases : sequence of Record or CaseData
        The experiments.
    progress : callable, optional
        Called with (fits done, fits in total).

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
    if any(d.record.is_chain for d in data):
        raise EstimationError(
            "a scan of the paper's terms is not available for several bodies with joints",
            "gyrotrack improve adds the effects that the data need",
        )
    if not data or len(set(labels)) != len(labels):
        raise EstimationError(
            "the cases of a scan need different labels", "give them with --label when making a case"
        )
    count = _Count(progress, len(data) * (len(AIR) + len(BEARING)) + 6)
    reduced = [fit(Model.of(REDUCED), [d]) for d in data]
    noise = [f.noise[0] for f in reduced]
    count.add(1)
    known = list(zip(data, noise, strict=True))
    air, bearing = (tuple(_rows(runs, d, n, count) for d, n in known) for runs in (AIR, BEARING))
    small = _model("reduced", reduced, data, noise, {}, {})
    count.add(2)
    ranges = paper_ranges(reduced, labels)
    # the extended model starts at the optimum of the smaller model, so that the extension cannot increase the deviance
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
    """Fit the runs of a table, small models first, because larger models with a power law start from a smaller fit."""
    rows: dict[Run, Row] = {}
    for run in sorted(runs, key=lambda r: len(r.terms)):
        inner = [r.fit for r in rows.values() if r.fit is not None and set(r.run.terms) < set(run.terms)]
        best = min(inner, key=lambda f: f.deviance, default=None)
        follows = best is not None and "bearing.power" in best.model.names
        row = Row(run, None) if follows else _row(run, data, noise)
        if best is not None and (row.fit is None or row.fit.deviance > best.deviance + _SAME_MINIMUM):
            # a deviance larger than the deviance of a nested model shows that the search ended in a local minimum
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
    declared = parameters_at(model.effects, inner.problem.layout.records)
    return {k: p.start for k, p in declared.items()} | inner.values


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
        # with a wrong bearing law, friction at the touch point may stop the casing; a fit without it gives initial
        # values
        rough = Model(tuple(e for e in model.effects if not e.per_surface))
        if rough == model:
            raise
        begin = fit(rough, [data], noise=[noise]).values
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
