"""The tree of fits of one case in the workbench."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from threading import RLock
from time import monotonic
from typing import TYPE_CHECKING, Any

from fitting._errors import FittingError
from fitting._numbers import (
    interval,
    scaled,
    short,
    symbol_text,
    to_json,
    typeset,
    unit_text,
    with_uncertainty,
)
from gyrotrack._errors import GyrotrackError
from gyrotrack.plotting._charts import Interval, dashboard_document, interval_document

if TYPE_CHECKING:
    from fitting.discovery._residuals import ResidualTorque
    from fitting.dynamics._model import Model
    from fitting.inference._case_data import CaseData
    from fitting.inference._result import Fit
    from fitting.study._history import Entry, Ledger
    from gyrotrack.apps.workbench._processes import Prediction
    from gyrotrack.io._records import Case
    from gyrotrack.plotting._ghost import Ghost


def library_document() -> list[dict[str, Any]]:
    """Return the effects of the library for the page; `free` marks nuisance parameters."""
    from fitting.effects._library import LIBRARY

    return [{"name": e.name, "joint": e.joint, "law": e.law, "free": e.nuisance} for e in LIBRARY.values()]


_MAX_TEXT = 500
_MAX_NAME = 60


@dataclass
class Step:
    """One fit of the tree: change, parent, name in the ledger, name and note by the user.

    The fit is restored on first use.
    """

    change: str
    parent: int
    found: Fit | None
    fit_id: str = ""
    sharp: bool = True
    torques: tuple[ResidualTorque, ...] | None = None
    prediction: Prediction | None = None
    name: str = ""
    note: str = ""
    is_deleted: bool = False
    rung: dict[str, Any] | None = None
    restore: Callable[[], Fit] | None = None

    @property
    def fit(self) -> Fit:
        """The fit."""
        if self.found is None and self.restore is not None:
            self.found = self.restore()
        assert self.found is not None  # noqa: S101 - `found` or `restore` is given
        return self.found


@dataclass
class _Fitting:
    """A running fit."""

    label: str
    expected: float | None  # duration of the last fit [s]
    began: float = field(default_factory=monotonic)
    is_cancelled: bool = False


class Session:
    """The fits of one case as a tree with a current fit. Indices never change, and `undo` restores a deleted fit."""

    def __init__(
        self, data: CaseData, base: Fit, fit_id: str, ledger: Ledger, case: Case | None = None
    ) -> None:
        self._lock = RLock()
        self._data, self._ledger, self._case = data, ledger, case
        self.steps = _steps_of(data, ledger) or [Step("base", -1, base, fit_id)]
        self.current = next(i for i, s in enumerate(self.steps) if s.fit_id == fit_id)
        self.steps[self.current].found = base
        # index of the step to compare with the current step; if negative, the parent of the current step
        self.reference = -1
        # changes of the tree and of the view: name, undo, redo
        self._undo: list[tuple[str, Callable[[], None], Callable[[], None]]] = []
        self._redo: list[tuple[str, Callable[[], None], Callable[[], None]]] = []
        self.revision = 0  # increased by every change, so that all pages show the change
        self._fitting: _Fitting | None = None
        self.fit_seconds: float | None = None  # duration of the last fit
        # cached charts of the first view
        self._first: tuple[tuple[int, ...], dict[str, Any]] | None = None
        # predicted markers of the shown and the compared fit, and the indices of both fits
        self._ghosts: tuple[tuple[int, ...], list[Ghost]] = ((), [])
        # initial values for each candidate, from the last search
        self.found: dict[str, dict[str, float]] = {}

    @property
    def label(self) -> str:
        """Name of the case."""
        return str(self._data.record.label)

    @property
    def fit(self) -> Fit:
        """The current fit."""
        return self.steps[self.current].fit

    def change(
        self, *, add: str = "", drop: str = "", values: dict[str, float] | None = None
    ) -> dict[str, Any]:
        """Add or remove an effect (name or ``body: law``), or set initial values; then fit. An error changes nothing.

        The fit runs without the lock, so that other requests are answered; `cancel` discards its result.
        """
        from fitting.discovery._select import found_starts, needs_search
        from fitting.effects._user import resolve

        if len(add) > _MAX_TEXT or len(drop) > _MAX_TEXT:
            raise GyrotrackError(f"A law has at most {_MAX_TEXT} characters.")
        with self._lock:
            if self._fitting is not None:
                raise GyrotrackError("A fit is running.", "Wait until it has ended, or cancel it.")
            place, old = self.current, self.fit
            model, words = old.model, []
            start = {k: e.value for k, e in old.estimates.items()}
            if add:
                effect = resolve(add.strip(), self._data.record.inputs)
                if effect.name in model.names:
                    raise GyrotrackError(f"{effect.name} is already in the model.")
                model = model.with_effect(effect)
                if effect.name in self.found:
                    start |= self.found[effect.name]
                elif needs_search(effect):
                    start |= found_starts(old, [effect])
                words.append(f"+{effect.name}")
            if drop:
                model = model.without(drop)
                words.append(f"-{drop}")
            if values:
                start |= values
                words.append("fitted again")
            if not words:
                raise GyrotrackError("No change was requested.", "Enter the name of an effect, or a formula.")
            mine = self._fitting = _Fitting(" ".join(words), self.fit_seconds)
        try:
            found = self._fitted(model, start, old)
        finally:
            with self._lock:
                current, self._fitting = self._fitting, None if self._fitting is mine else self._fitting
        with self._lock:
            if current is not mine or mine.is_cancelled:
                raise GyrotrackError("The fit was cancelled.", "Nothing was changed.")
            self.fit_seconds = monotonic() - mine.began
            self.steps.append(Step(mine.label, place, found, sharp=False))
            self._added(len(self.steps) - 1)
            return self.state()

    def _fitted(self, model: Model, start: dict[str, float], old: Fit) -> Fit:
        from fitting.inference._fit import fit

        try:
            return fit(model, [self._data], start=start, noise=old.noise, quick=True)
        # the values of the previous fit are not used, because they can be poor initial values
        except FittingError:
            return fit(model, [self._data], noise=old.noise, quick=True)

    def cancel(self) -> dict[str, Any]:
        """Discard the result of the running fit."""
        running = self._fitting
        if running is not None:
            running.is_cancelled = True
            self._fitting = None
        return self.progress()

    def progress(self) -> dict[str, Any]:
        """Return the change, the elapsed and the expected duration [s] of the running fit; empty without a fit."""
        running = self._fitting
        if running is None:
            return {}
        seconds = round(monotonic() - running.began, 2)
        return {"label": running.label, "seconds": seconds, "expected": running.expected}

    def ghost(self, clip: str, index: int) -> dict[str, Any] | None:
        """Return the outlines of the markers predicted by the current model in a frame [px]; None if unknown.

        The difference from the measured markers is magnified by ``factor``, which is the same for the compared fit, so
        that the better fit is visible.
        """
        from gyrotrack.plotting._ghost import ghost_document, ghosts

        if self._case is None:
            return None
        with self._lock:
            step = self.steps[self.current]
            compared = self._compared(step)
            fits = [*([self.steps[compared].fit] if compared >= 0 else []), step.fit]
            shown = (self.current, compared, *map(id, fits))
            if self._ghosts[0] != shown:
                names = [f"fit {n + 1}" for n in (compared, self.current)][-len(fits) :]
                self._ghosts = shown, ghosts(self._case, fits, names)
            found = next((g for g in self._ghosts[1] if g.clip == clip), None)
        places = [] if found is None else list((found.frame == index).nonzero()[0])
        if found is None or not places:
            return None
        time = float(found.time[places[0]])
        document = ghost_document(found.inside(time, time), len(fits) - 1, factor=found.factor)
        return {
            "factor": found.factor,
            "difference_rad": document["difference"][0],
            "markers": [v["ghost"][0] for v in document["markers"].values() if v["ghost"][0] is not None],
        }

    def _prediction(self) -> Prediction:
        from gyrotrack.apps.workbench._processes import Prediction

        step = self.steps[self.current]
        if step.prediction is None:
            step.prediction = Prediction(step.fit)
        return step.prediction

    def sliders(self) -> dict[str, Any]:
        """Return the parameters of the current fit with their ranges, and the derivatives of the residual."""
        with self._lock:
            return _document(self._prediction().sliders()) | {"place": self.current}

    def moved(self, values: dict[str, float]) -> dict[str, Any]:
        """Return the exact residual of the current model for changed parameters."""
        with self._lock:
            return _document(self._prediction().moved(values))

    def go(self, place: int) -> dict[str, Any]:
        """Make another step the current step."""
        with self._lock:
            self._show(self._existing(place))
            return self.state()

    def compare(self, place: int) -> dict[str, Any]:
        """Compare the current step with another step, or with its parent if `place` is negative."""
        with self._lock:
            self.reference = self._existing(place) if place >= 0 else -1
            self.revision += 1
            return self.state()

    def undo(self) -> dict[str, Any]:
        """Undo the last change of the view or the tree."""
        return self._moved_back(self._undo, self._redo, 1)

    def redo(self) -> dict[str, Any]:
        """Redo the change that was undone last."""
        return self._moved_back(self._redo, self._undo, 2)

    def _moved_back(self, source: list[Any], target: list[Any], which: int) -> dict[str, Any]:
        with self._lock:
            if not source:
                raise GyrotrackError(f"There is nothing to {'undo' if which == 1 else 'redo'}.")
            source[-1][which]()
            target.append(source.pop())
            self.revision += 1
            return self.state()

    def _record(self, label: str, undo: Callable[[], None], redo: Callable[[], None]) -> None:
        """Store a completed change; changes that were undone before can no longer be redone."""
        self._undo.append((label, undo, redo))
        self._redo.clear()
        self.revision += 1

    def _added(self, place: int) -> None:
        """Show a new step; undo removes the step from the tree and from the ledger."""
        before, step = (self.current, self.reference), self.steps[place]
        entries: list[Entry] = []

        def undo() -> None:
            if step.fit_id:
                entries[:] = [self._ledger.delete(step.fit_id)]
            step.is_deleted = True
            self.current, self.reference = before

        def redo() -> None:
            for entry in entries:
                self._ledger.restore(entry)
            step.is_deleted = False
            self.current, self.reference = place, -1

        self.current, self.reference = place, -1
        self._record(f"fit {step.change}", undo, redo)

    def delete(self, place: int) -> dict[str, Any]:
        """Delete a step without successors from the tree and from the ledger."""
        with self._lock:
            step = self.steps[self._existing(place)]
            left = [i for i, s in enumerate(self.steps) if not s.is_deleted and i != place]
            if not left:
                raise GyrotrackError("The only fit cannot be deleted.")
            if any(self.steps[i].parent == place for i in left):
                raise GyrotrackError("This fit has successors.", "Delete the successors first.")
            before = self.current, self.reference
            entries: list[Entry] = []

            def remove() -> None:
                entries[:] = [self._ledger.delete(step.fit_id)] if step.fit_id else []
                step.is_deleted = True
                if self.current == place:
                    self.current = step.parent if step.parent >= 0 else left[0]
                if place == self.reference:
                    self.reference = -1

            def restore() -> None:
                for entry in entries:
                    self._ledger.restore(entry)
                step.is_deleted = False
                self.current, self.reference = before

            remove()
            self._record(f"deletion of fit {place + 1}", restore, remove)
            return self.state()

    def annotate(self, place: int, *, name: str, note: str) -> dict[str, Any]:
        """Set name and note of a step; they are stored with its fit in the ledger."""
        with self._lock:
            step = self.steps[self._existing(place)]
            old = step.name, step.note

            def write(name: str, note: str) -> None:
                name, note = name.strip()[:_MAX_NAME], note.strip()[:_MAX_TEXT]
                if step.fit_id:
                    self._ledger.annotate(step.fit_id, name=name, note=note)
                step.name, step.note = name, note

            write(name, note)
            self._record(f"name or note of fit {place + 1}", lambda: write(*old), lambda: write(name, note))
            return self.state()

    def _existing(self, place: int) -> int:
        if not 0 <= place < len(self.steps) or self.steps[place].is_deleted:
            raise GyrotrackError("There is no such fit.")
        return place

    def _show(self, place: int) -> None:
        before = self.current, self.reference

        def back() -> None:
            self.current, self.reference = before

        def again() -> None:
            self.current, self.reference = place, -1

        again()
        self._record(f"show fit {place + 1}", back, again)

    def keep(self) -> dict[str, Any]:
        """Refine the current fit, store it and its predecessors in the ledger, and return the state."""
        with self._lock:
            self._keep(self.current)
            return self.state()

    def kept(self) -> str:
        """Refine the current fit, store it and its predecessors in the ledger, and return its name."""
        with self._lock:
            return self._keep(self.current)

    def _keep(self, place: int) -> str:
        step = self.steps[place]
        if step.fit_id:
            return step.fit_id
        parent = self._keep(step.parent)
        self._sharpen(step)
        entry = self._ledger.add(
            step.fit, parent=parent, added=step.change, previous=self.steps[step.parent].fit
        )
        step.fit_id, step.rung = entry.fit_id, None
        self.revision += 1
        if step.name or step.note:
            self._ledger.annotate(step.fit_id, name=step.name, note=step.note)
        return step.fit_id

    def certificate(self) -> dict[str, Any]:
        """Return the certificate of the current fit in the format of `certify --json`; empty without a certificate."""
        from fitting.study._serialisation import certificate_document

        with self._lock:
            fit_id = self.steps[self.current].fit_id
            if not fit_id:
                return {}
            # the certificate was written by another process
            found = type(self._ledger)(self._ledger.path).find(fit_id).latest_certificate()
        return {} if found is None else _document(certificate_document(found, fit_id))

    def _sharpen(self, step: Step) -> None:
        from fitting.discovery._refine import refined

        if not step.sharp:
            step.found, step.sharp, step.torques = refined(step.fit), True, None
            step.prediction = None

    def remember(self, answer: dict[str, Any]) -> dict[str, Any]:
        """Store the parameters of candidates as initial values, and return the typeset answer of the search."""
        candidates = answer.get("diagnosis", {}).get("candidates", [])
        found = {
            c["effect"]: {k: v["value"] for k, v in c["parameters"].items() if isinstance(v["value"], float)}
            for c in candidates
        }
        with self._lock:
            self.found = found
        if "diagnosis" in answer:
            for key in ("sentence", "next_experiment"):
                answer["diagnosis"][key] = typeset(answer["diagnosis"].get(key, ""))
            for c in candidates:
                values = [
                    (k.rpartition(".")[2], with_uncertainty(v["value"], v["stderr"], v["unit"]))
                    for k, v in c["parameters"].items()
                    if isinstance(v["value"], float) and isinstance(v["stderr"], float)
                ]
                c["values"] = [f"{symbol_text(k.partition('@')[0])} = {v}" for k, v in values[:3]]
        return answer

    def model_document(self) -> dict[str, Any]:
        """Return the current model as an entry of a ledger, for the ranking process."""
        from fitting._schema import own_effects

        with self._lock:
            fit = self.fit
            return _document(
                {
                    "fit_id": "",
                    "model": list(fit.model.names),
                    "parameters": {k: {"value": e.value} for k, e in fit.estimates.items()},
                    "digests": [self._data.record.digest],
                    "own_effects": [asdict(e) for e in own_effects(fit.model.effects)],
                }
            )

    def state(self, *, whole: bool = False) -> dict[str, Any]:
        """Return the state for the page; with `whole` also the charts that do not depend on the fit."""
        with self._lock:
            step = self.steps[self.current]
            fit = step.fit
            board = self._whole_board(step) if whole else self._board(step, whole=False)
            return _document(
                {
                    "label": self._data.record.label,
                    "surface": self._data.record.surface,
                    "body": self._data.record.body,
                    "verdict": fit.verdict,
                    "sharp": step.sharp,
                    "current": self.current,
                    "effects": [
                        {"name": e.name, "joint": e.joint, "law": e.law, "words": fit.name(e).words}
                        for e in fit.model.effects
                    ],
                    "parameters": self._parameters(step),
                    "ladder": [self._rung(i) for i, s in self._tree() if not s.is_deleted],
                    "compared": self._compared(step),
                    "undo": self._undo[-1][0] if self._undo else "",
                    "redo": self._redo[-1][0] if self._redo else "",
                    "revision": self.revision,
                    "misfit": fit.misfit,
                    "measures": self._measures(step),
                    "board": board,
                }
            )

    def _parameters(self, step: Step) -> list[dict[str, Any]]:
        """Return the parameters of a fit, and their differences from the compared fit in standard uncertainties."""
        compared = self._compared(step)
        other = self.steps[compared].fit.estimates if compared >= 0 else {}
        found = []
        for name, e in step.fit.estimates.items():
            row = {
                "name": name,
                "words": step.fit.name(name).words,
                "value": with_uncertainty(e.value, e.stderr, e.unit),
                "at_bound": e.at_bound,
            }
            if (o := other.get(name)) is not None:
                row["other"] = with_uncertainty(o.value, o.stderr, o.unit)
                u = math.hypot(*(x.stderr for x in (e, o) if math.isfinite(x.stderr)))
                row["difference_u"] = (e.value - o.value) / u if u > 0 else None
            found.append(row)
        return found

    def _measures(self, step: Step) -> list[dict[str, str]]:
        """Return the measures of misfit that the first screen does not show: name, value, explanation."""
        fit, left = step.fit, self._rung(self.current).get("torque_left_Nm")
        error = "Error in intervals of the recording that were left out of the fit, divided by the noise"
        found = [
            (
                "χ²/n",
                short(fit.reduced_chi2),
                "Mean square residual of samples divided by the noise variance. Many samples hide a small misfit.",
            ),
            (
                "prediction error / noise",
                short(fit.held_out),
                f"{error}. This error grows if there are too many parameters.",
            ),
            (
                "rms residual",
                f"{short(fit.rmse_casing)} rad/s",
                f"Noise alone gives {short(fit.rmse_noise)} rad/s.",
            ),
        ]
        if isinstance(left, float):
            factor, prefix = scaled(abs(left))
            unit = unit_text(self._data.record.torque_unit)
            value = f"{short(factor * left)} {prefix}{unit}" if left else f"0 {unit}"
            found.append(
                (
                    "unmodelled torque, rms",
                    value,
                    "Torque needed beyond the model to explain the residuals, without the contribution of noise.",
                )
            )
        return [{"name": n, "value": v, "meaning": m} for n, v, m in found]

    def _rung(self, place: int) -> dict[str, Any]:
        from fitting.study._serialisation import step_document

        step = self.steps[place]
        document = step.rung
        if document is None:
            previous = self.steps[step.parent].fit if step.parent >= 0 else None
            document = step_document(step.fit, step.fit_id, step.change, previous)
        keys = (
            "added",
            "words",
            "rmse_casing",
            "misfit",
            "held_out",
            "delta_bic",
            "torque_left_Nm",
            "verdict",
        )
        depth, up = 0, step.parent
        while up >= 0:
            depth, up = depth + 1, self.steps[up].parent
        own = {key: getattr(step, key) for key in ("fit_id", "parent", "name", "note")}
        return {"place": place, "depth": depth} | own | {k: document.get(k) for k in keys}

    def _tree(self) -> list[tuple[int, Step]]:
        """Return the steps with their indices, each followed by its successors."""
        found: list[tuple[int, Step]] = []

        def visit(place: int) -> None:
            found.append((place, self.steps[place]))
            for i, s in enumerate(self.steps):
                if s.parent == place:
                    visit(i)

        for root in [i for i, s in enumerate(self.steps) if s.parent < 0]:
            visit(root)
        return found

    def _compared(self, step: Step) -> int:
        """Return the index of the step to compare with; negative if there is no such step."""
        other = self.reference >= 0 and self.steps[self.reference] is not step
        return self.reference if other else step.parent

    def _whole_board(self, step: Step) -> dict[str, Any]:
        shown = (self.current, self._compared(step), id(step.fit))
        if self._first is None or self._first[0] != shown:
            self._first = shown, self._board(step, whole=True)
        return self._first[1]

    def _board(self, step: Step, *, whole: bool) -> dict[str, Any]:
        from fitting.discovery._residuals import find_failures
        from fitting.discovery._select import Step as FitStep
        from gyrotrack.plotting._case_charts import case_dashboard, difference_chart, torque_angle_charts
        from gyrotrack.plotting._study_data import case_view
        from gyrotrack.plotting._tracking import tracks_of

        compared = self._compared(step)
        before = self.steps[compared] if compared >= 0 else None
        steps = [s for s in (before, step) if s is not None]
        history = [FitStep(s.change, s.fit, ()) for s in steps]
        view = case_view(history, None, [self._torques(s) for s in steps], 0)
        tracks = tracks_of(self._case) if whole and self._case is not None else None
        names = (f"fit {compared + 1}", f"fit {self.current + 1}") if before is not None else ("fit 1",)
        dashboard = case_dashboard(view, tracks, names, names=names)
        charts = list(dashboard.charts)
        harmonics, body = [s.fit.angle_harmonics for s in steps], self._data.record.body
        charts[3:3] = torque_angle_charts(harmonics, names, body, step.fit.torque_unit)
        charts[2:2] = difference_chart(view, names)
        board = dashboard_document(replace(dashboard, charts=tuple(charts)))
        # only the intervals that the sentence names are listed
        board["intervals"] = []
        for f in find_failures(step.fit, list(self._torques(step))):
            factor, prefix = scaled(abs(f.residual_torque_Nm))
            size = short(factor * f.residual_torque_Nm, 2)
            times = "–".join(interval(f.t_start, f.t_stop))
            text = f"{times} s, {f.called}: {size} {prefix}{view.torque_unit}"
            board["intervals"].append(interval_document(Interval(f.t_start, f.t_stop, text, f.body)))
        return board

    def _torques(self, step: Step) -> tuple[ResidualTorque, ...]:
        from fitting.discovery._residuals import residual_torques

        if step.torques is None:
            step.torques = tuple(residual_torques(step.fit))
        return step.torques


def _steps_of(data: CaseData, ledger: Ledger | None) -> list[Step]:
    """Return the fits of a case in the ledger as steps, which are restored on first use."""
    entries = ledger.of([data]) if ledger is not None else []
    places = {e.fit_id: i for i, e in enumerate(entries)}
    return [
        Step(
            change=str(e.document.get("added") or "base"),
            parent=places.get(str(e.document.get("parent", "")), -1),
            found=None,
            fit_id=e.fit_id,
            name=e.stored.name,
            note=e.stored.note,
            rung=e.document.get("rung"),
            restore=partial(e.shown, (data,)),
        )
        for e in entries
    ]


def _document(found: Mapping[str, Any]) -> dict[str, Any]:
    return dict(to_json(found))
