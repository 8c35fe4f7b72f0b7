"""The tree of fits of one case in the workbench."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from threading import RLock
from typing import TYPE_CHECKING, Any

from gyrotrack._errors import GyrotrackError
from gyrotrack.plotting._charts import dashboard_document, interval_document

if TYPE_CHECKING:
    from fitting.discovery._residuals import AngleHarmonics, ResidualTorque
    from fitting.inference._case_data import CaseData
    from fitting.inference._result import Fit
    from fitting.study._history import Ledger
    from gyrotrack.apps.workbench._processes import Prediction
    from gyrotrack.io._records import Case


def library_document() -> list[dict[str, Any]]:
    """Return the effects of the library for the page; `free` marks nuisance parameters."""
    from fitting.effects._library import LIBRARY

    return [{"name": e.name, "joint": e.joint, "law": e.law, "free": e.nuisance} for e in LIBRARY.values()]


_MAX_TEXT = 500
_MAX_NAME = 60


@dataclass
class Step:
    """One fit of the tree: change, parent, name in the ledger, name and note by the user; restored on first use."""

    change: str
    parent: int
    found: Fit | None
    fit_id: str = ""
    sharp: bool = True
    torques: tuple[ResidualTorque, ...] | None = None
    harmonics: tuple[AngleHarmonics, ...] | None = None
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


class Session:
    """The fits of one case as a tree, one of them current; indices are kept, and `undo` restores a deleted fit."""

    def __init__(
        self, data: CaseData, base: Fit, fit_id: str, ledger: Ledger, case: Case | None = None
    ) -> None:
        self._lock = RLock()
        self._data, self._ledger, self._case = data, ledger, case
        self.steps = _steps_of(data, ledger) or [Step("base", -1, base, fit_id)]
        self.current = next(i for i, s in enumerate(self.steps) if s.fit_id == fit_id)
        self.steps[self.current].found = base
        # step to compare with the current one; if negative, the parent
        self.reference = -1
        self._undo: list[Callable[[], None]] = []
        # cached charts of the first view
        self._first: tuple[tuple[int, ...], dict[str, Any]] | None = None
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
        """Add an effect (name or ``body: law``), remove one, or set initial values; fit; an error changes nothing."""
        from fitting._errors import FittingError
        from fitting.discovery._select import found_starts, needs_search
        from fitting.effects._user import resolve
        from fitting.inference._fit import fit

        if len(add) > _MAX_TEXT or len(drop) > _MAX_TEXT:
            raise GyrotrackError(f"A law has at most {_MAX_TEXT} characters.")
        with self._lock:
            model, words = self.fit.model, []
            start = {k: e.value for k, e in self.fit.estimates.items()}
            if add:
                effect = resolve(add.strip(), self._data.record.inputs)
                if effect.name in model.names:
                    raise GyrotrackError(f"{effect.name} is already in the model.")
                model = model.with_effect(effect)
                if effect.name in self.found:
                    start |= self.found[effect.name]
                elif needs_search(effect):
                    start |= found_starts(self.fit, [effect])
                words.append(f"+{effect.name}")
            if drop:
                model = model.without(drop)
                words.append(f"-{drop}")
            if values:
                start |= values
                words.append("fitted again")
            if not words:
                raise GyrotrackError("No change was requested.", "Enter the name of an effect, or a formula.")
            noise = self.fit.noise
            try:
                found = fit(model, [self._data], start=start, noise=noise, quick=True)
            except FittingError:  # the values of the previous fit can be poor initial values
                found = fit(model, [self._data], noise=noise, quick=True)
            self.steps.append(Step(" ".join(words), self.current, found, sharp=False))
            self._show(len(self.steps) - 1)
            return self.state()

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
        """Show another step."""
        with self._lock:
            self._show(self._existing(place))
            return self.state()

    def compare(self, place: int) -> dict[str, Any]:
        """Compare the current step with another one, or with its parent if `place` is negative."""
        with self._lock:
            self.reference = self._existing(place) if place >= 0 else -1
            return self.state()

    def undo(self) -> dict[str, Any]:
        """Undo the last change of the view or the tree; fits remain in the tree."""
        with self._lock:
            if not self._undo:
                raise GyrotrackError("There is nothing to undo.")
            self._undo.pop()()
            return self.state()

    def delete(self, place: int) -> dict[str, Any]:
        """Delete a step without successors, also from the ledger."""
        with self._lock:
            step = self.steps[self._existing(place)]
            left = [i for i, s in enumerate(self.steps) if not s.is_deleted and i != place]
            if not left:
                raise GyrotrackError("The only fit cannot be deleted.")
            if any(self.steps[i].parent == place for i in left):
                raise GyrotrackError("This fit has successors.", "Delete those first.")
            before = self.current, self.reference
            entry = self._ledger.delete(step.fit_id) if step.fit_id else None
            step.is_deleted = True
            if self.current == place:
                self.current = step.parent if step.parent >= 0 else left[0]
            if place == self.reference:
                self.reference = -1

            def restore() -> None:
                if entry is not None:
                    self._ledger.restore(entry)
                step.is_deleted = False
                self.current, self.reference = before

            self._undo.append(restore)
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
            self._undo.append(lambda: write(*old))
            return self.state()

    def _existing(self, place: int) -> int:
        if not 0 <= place < len(self.steps) or self.steps[place].is_deleted:
            raise GyrotrackError("There is no such fit.")
        return place

    def _show(self, place: int) -> None:
        before = self.current, self.reference

        def back() -> None:
            self.current, self.reference = before

        self._undo.append(back)
        self.current, self.reference = place, -1

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
        if step.name or step.note:
            self._ledger.annotate(step.fit_id, name=step.name, note=step.note)
        return step.fit_id

    def _sharpen(self, step: Step) -> None:
        from fitting.discovery._refine import refined

        if not step.sharp:
            step.found, step.sharp, step.torques, step.harmonics = refined(step.fit), True, None, None
            step.prediction = None

    def remember(self, answer: dict[str, Any]) -> dict[str, Any]:
        """Store the parameters of candidates as initial values, and return the answer of the search, typeset."""
        from fitting._numbers import typeset

        candidates = answer.get("diagnosis", {}).get("candidates", [])
        found = {
            c["effect"]: {k: v["value"] for k, v in c["parameters"].items() if isinstance(v["value"], float)}
            for c in candidates
        }
        with self._lock:
            self.found = found
        if "diagnosis" in answer:
            answer["diagnosis"]["sentence"] = typeset(answer["diagnosis"]["sentence"])
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
                    "verdict": fit.verdict,
                    "sharp": step.sharp,
                    "current": self.current,
                    "effects": [
                        {"name": e.name, "joint": e.joint, "law": e.law, "signature": e.signature}
                        for e in fit.model.effects
                    ],
                    "parameters": self._parameters(step),
                    "ladder": [self._rung(i) for i, s in self._tree() if not s.is_deleted],
                    "compared": self._compared(step),
                    "can_undo": bool(self._undo),
                    "board": board,
                }
            )

    def _parameters(self, step: Step) -> list[dict[str, Any]]:
        """Return the parameters of a fit, and their differences from the compared one in standard uncertainties."""
        from fitting._numbers import with_uncertainty

        compared = self._compared(step)
        other = self.steps[compared].fit.estimates if compared >= 0 else {}
        found = []
        for name, e in step.fit.estimates.items():
            row = {"name": name, "value": with_uncertainty(e.value, e.stderr, e.unit), "at_bound": e.at_bound}
            if (o := other.get(name)) is not None:
                row["other"] = with_uncertainty(o.value, o.stderr, o.unit)
                row["difference_sigma"] = (e.value - o.value) / e.stderr if e.stderr > 0 else None
            found.append(row)
        return found

    def _rung(self, place: int) -> dict[str, Any]:
        from fitting.study._serialisation import step_document

        step = self.steps[place]
        document = step.rung
        if document is None:
            previous = self.steps[step.parent].fit if step.parent >= 0 else None
            document = step_document(step.fit, step.fit_id, step.change, previous)
        keys = ("added", "rmse_casing", "reduced_chi2", "held_out", "delta_bic", "torque_left_Nm", "verdict")
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
        """Return the index of the step to compare with; negative if there is none."""
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
        dashboard = case_dashboard(view, tracks, [s.change for s in steps], names=names)
        charts = list(dashboard.charts)
        harmonics, body = [self._harmonics(s) for s in steps], self._data.record.body
        charts[3:3] = torque_angle_charts(harmonics, names, body, step.fit.torque_unit)
        charts[2:2] = difference_chart(view, names)
        board = dashboard_document(replace(dashboard, charts=tuple(charts)))
        failures = find_failures(step.fit, list(self._torques(step)))
        board["intervals"] = [interval_document(i) for i in view.failing(failures, view.models[-1])]
        return board

    def _torques(self, step: Step) -> tuple[ResidualTorque, ...]:
        from fitting.discovery._residuals import residual_torques

        if step.torques is None:
            step.torques = tuple(residual_torques(step.fit))
        return step.torques

    def _harmonics(self, step: Step) -> tuple[AngleHarmonics, ...]:
        from fitting.discovery._residuals import angle_harmonics

        if step.harmonics is None:
            step.harmonics = tuple(angle_harmonics(step.fit))
        return step.harmonics


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


def _document(found: dict[str, Any]) -> dict[str, Any]:
    from fitting._numbers import to_json

    return dict(to_json(found))
