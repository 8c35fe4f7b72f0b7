"""The fits of the workbench."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from threading import RLock
from typing import TYPE_CHECKING, Any

from gyrotrack._errors import GyrotrackError
from gyrotrack.plotting._charts import dashboard_document, interval_document

if TYPE_CHECKING:
    from fitting.discovery._residuals import ResidualTorque
    from fitting.inference._case_data import CaseData
    from fitting.inference._result import Fit
    from fitting.study._history import Ledger
    from gyrotrack.io._records import Case


def library_document() -> list[dict[str, Any]]:
    """Return the effects of the library for the list that the page offers; every fit takes out those `free`."""
    from fitting.effects._library import LIBRARY

    return [{"name": e.name, "joint": e.joint, "law": e.law, "free": e.nuisance} for e in LIBRARY.values()]


_LONGEST = 500


@dataclass
class Step:
    """One rung: what was changed, from which rung, the fit, and the name under which the ledger keeps it."""

    change: str
    parent: int
    fit: Fit
    fit_id: str = ""
    sharp: bool = True
    torques: tuple[ResidualTorque, ...] | None = None


class Session:
    """One case on the workbench.

    Parameters
    ----------
    data : CaseData
        The case.
    base : Fit
        Where to begin.
    fit_id : str
        Its name in the ledger.
    ledger : Ledger
        Where fits are kept, if the user asks for it.
    case : Case or None
        The case with the tracking behind it.
    """

    def __init__(
        self, data: CaseData, base: Fit, fit_id: str, ledger: Ledger, case: Case | None = None
    ) -> None:
        self._lock = RLock()
        self._data, self._ledger, self._case = data, ledger, case
        self.steps = [Step("base", -1, base, fit_id)]
        self.current = 0
        # what the last search found for the parameters of each candidate: a good place to start
        self.found: dict[str, dict[str, float]] = {}

    @property
    def fit(self) -> Fit:
        """The current fit."""
        return self.steps[self.current].fit

    def change(self, *, add: str = "", drop: str = "") -> dict[str, Any]:
        """Add an effect (by name or as ``body: law``) or drop one, fit, and return the new state.

        Raises
        ------
        GyrotrackError, FittingError
            Telling in one sentence what is wrong with the wish; the state stays as it was.
        """
        from fitting._errors import FittingError
        from fitting.discovery._select import found_starts, needs_search
        from fitting.effects._user import resolve
        from fitting.inference._fit import fit

        if len(add) > _LONGEST or len(drop) > _LONGEST:
            raise GyrotrackError(f"A law has at most {_LONGEST} characters.")
        with self._lock:
            model, words = self.fit.model, []
            start = {k: e.value for k, e in self.fit.estimates.items()}
            if add:
                effect = resolve(add.strip())
                if effect.name in model.names:
                    raise GyrotrackError(f"{effect.name} is in the model already.")
                model = model.with_effect(effect)
                if effect.name in self.found:
                    start |= self.found[effect.name]
                elif needs_search(effect):
                    start |= found_starts(self.fit, [effect])
                words.append(f"+{effect.name}")
            if drop:
                model = model.without(drop)
                words.append(f"-{drop}")
            if not words:
                raise GyrotrackError("Nothing was asked for.", "Type the name of an effect, or a law.")
            noise = self.fit.noise
            try:
                found = fit(model, [self._data], start=start, noise=noise, quick=True)
            except FittingError:  # what suited the old model may be no start for the new one
                found = fit(model, [self._data], noise=noise, quick=True)
            self.steps.append(Step(" ".join(words), self.current, found, sharp=False))
            self.current = len(self.steps) - 1
            return self.state()

    def go(self, place: int) -> dict[str, Any]:
        """Go to another rung."""
        with self._lock:
            if not 0 <= place < len(self.steps):
                raise GyrotrackError("There is no such fit.")
            self.current = place
            return self.state()

    def keep(self) -> dict[str, Any]:
        """Fit the current model to its minimum, and write it and the rungs that led to it into the ledger."""
        with self._lock:
            self._keep(self.current)
            return self.state()

    def _keep(self, place: int) -> str:
        step = self.steps[place]
        if step.fit_id:
            return step.fit_id
        parent = self._keep(step.parent)
        self._sharpen(step)
        entry = self._ledger.add(
            step.fit, parent=parent, added=step.change, previous=self.steps[step.parent].fit
        )
        step.fit_id = entry.fit_id
        return step.fit_id

    def _sharpen(self, step: Step) -> None:
        from fitting.discovery._refine import refined

        if not step.sharp:
            step.fit, step.sharp, step.torques = refined(step.fit), True, None

    def remember(self, answer: dict[str, Any]) -> dict[str, Any]:
        """Keep what a search found for the parameters of the candidates, and return its answer as it is to be read."""
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
        """Return the current model as a ledger keeps it, for the process that ranks."""
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
        """Return what the page shows; with `whole` also the curves that no fit changes."""
        from fitting._numbers import with_uncertainty

        with self._lock:
            step = self.steps[self.current]
            fit = step.fit
            board = self._board(step, whole=whole)
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
                    "parameters": [
                        {
                            "name": k,
                            "value": with_uncertainty(e.value, e.stderr, e.unit),
                            "at_bound": e.at_bound,
                        }
                        for k, e in fit.estimates.items()
                    ],
                    "ladder": [self._rung(i) for i in range(len(self.steps))],
                    "board": board,
                }
            )

    def _rung(self, place: int) -> dict[str, Any]:
        from fitting.study._serialisation import rung_document

        step = self.steps[place]
        previous = self.steps[step.parent].fit if step.parent >= 0 else None
        document = rung_document(step.fit, step.fit_id, step.change, previous)
        keys = ("added", "rmse_casing", "reduced_chi2", "held_out", "delta_bic", "torque_left_Nm", "verdict")
        return {"fit_id": step.fit_id, "parent": step.parent} | {k: document[k] for k in keys}

    def _board(self, step: Step, *, whole: bool) -> dict[str, Any]:
        from fitting.discovery._residuals import find_failures
        from fitting.discovery._select import Step as FitStep
        from gyrotrack.plotting._case_charts import case_dashboard
        from gyrotrack.plotting._study_data import case_view, intervals_of
        from gyrotrack.plotting._tracking import tracks_of

        before = self.steps[step.parent] if step.parent >= 0 else None
        steps = [s for s in (before, step) if s is not None]
        rungs = [FitStep(s.change, s.fit, ()) for s in steps]
        view = case_view(rungs, None, [self._torques(s) for s in steps], 0)
        tracks = tracks_of(self._case) if whole and self._case is not None else None
        names = ("before", "now") if before is not None else ("now",)
        board = dashboard_document(case_dashboard(view, tracks, [s.change for s in steps], names=names))
        failures = find_failures(step.fit, list(self._torques(step)))
        board["intervals"] = [interval_document(i) for i in intervals_of(failures)]
        return board

    def _torques(self, step: Step) -> tuple[ResidualTorque, ...]:
        from fitting.discovery._residuals import residual_torques

        if step.torques is None:
            step.torques = tuple(residual_torques(step.fit))
        return step.torques


def _document(found: dict[str, Any]) -> dict[str, Any]:
    from fitting._numbers import to_json

    return dict(to_json(found))
