"""One case under one model: predicted rows and their derivatives by the variables of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.compression import Compressed
from fitting.effects import Effect
from fitting.estimation.layout import START_CASING, START_ROTOR, Layout
from fitting.estimation.rippling import ripple_rows
from fitting.expression import Tape
from fitting.model import Dynamics
from fitting.simulation import Mesh, Path, Sampler, Sensitivity, sensitivities, solve
from fitting.simulation.linear import LinearMotion

Array = NDArray[np.float64]

_INTERVALS = 12


@dataclass(frozen=True)
class Prediction:
    """Rows that a model predicts, their derivatives by all variables of the fit, and the solution behind."""

    rows: Array
    jacobian: Array
    path: Path
    sensitivity: Sensitivity

    @property
    def motion(self) -> LinearMotion:
        """Small motions about the solution."""
        return LinearMotion(self.path, self.sensitivity.propagator)


class CaseModel:
    """Predicts the rows of one case; remembers its last solution as the guess for the next.

    Parameters
    ----------
    data : CaseData
        The case.
    layout : Layout
        The variables.
    case : int
        Which of the layout's cases it is.
    """

    def __init__(self, data: CaseData, layout: Layout, case: int) -> None:
        self.data, self.layout, self.case = data, layout, case
        self.dynamics = Dynamics(layout.model.smooth)
        self._places = layout.places(case, (*self.dynamics.parameters, START_ROTOR, START_CASING))
        self._guess: Path | None = None
        self._columns: dict[str, tuple[Array, Array]] = {}

    def solve(self, theta: Array) -> Path:
        """Integrate the smooth part of the model."""
        first = np.array([*self.layout.start(theta, self.case), *self.dynamics.start])
        self._guess = solve(
            self.dynamics, self.layout.numbers(theta, self.case), first, self._mesh, self._guess
        )
        return self._guess

    @cached_property
    def _mesh(self) -> Mesh:
        return Mesh.uniform(*self.data.record.span, _INTERVALS)

    def predict(self, theta: Array) -> Prediction:
        """Return rows and derivatives at these variables."""
        path = self.solve(theta)
        numbers = self.layout.numbers(theta, self.case)
        sensitivity = sensitivities(self.dynamics, numbers, path)
        rows = self.data.observe(path)
        jacobian = np.zeros((len(rows), len(theta)))
        # the same variable may drive several columns: none here, each key has one place
        jacobian[:, self._places] = self.data.observe(path, sensitivity.nodes)
        for effect in (*self.layout.model.rippling, *self.layout.model.measurement):
            if effect.name not in self._columns:
                self._columns[effect.name] = self.unit_columns(effect, path, sensitivity, numbers)
            self._add(effect, numbers, rows, jacobian)
        return Prediction(rows, jacobian, path, sensitivity)

    def forget_columns(self) -> None:
        """Compute the responses to laws that follow an angle anew at the next prediction."""
        self._columns.clear()

    def _add(self, effect: Effect, numbers: dict[str, float], rows: Array, jacobian: Array) -> None:
        sine, cosine = self._columns[effect.name]
        amplitude = next(p for p in effect.parameters if p.role == "amplitude")
        k = numbers[f"{effect.name}.{amplitude.symbol}"]
        i = self.layout.places(self.case, [f"{effect.name}.{amplitude.symbol}"])[0]
        phase = next((p for p in effect.parameters if p.role == "phase"), None)
        if phase is None:
            rows += k * sine
            jacobian[:, i] = sine
            return
        key = f"{effect.name}.{phase.symbol}"
        phi, j = numbers[key], self.layout.places(self.case, [key])[0]
        jacobian[:, i] = np.cos(phi) * sine + np.sin(phi) * cosine
        jacobian[:, j] = k * (np.cos(phi) * cosine - np.sin(phi) * sine)
        rows += k * jacobian[:, i]

    def unit_columns(
        self, effect: Effect, path: Path, sensitivity: Sensitivity, numbers: dict[str, float]
    ) -> tuple[Array, Array]:
        """Return the rows for strength 1 at phase 0 and at a quarter turn."""
        if effect.moves:
            return ripple_rows(self.data, effect, path, LinearMotion(path, sensitivity.propagator), numbers)
        rows = []
        for phi in (0.0, np.pi / 2):
            values = {p.symbol: numbers.get(f"{effect.name}.{p.symbol}", p.start) for p in effect.parameters}
            values |= {p.symbol: 1.0 for p in effect.parameters if p.role == "amplitude"}
            values |= {p.symbol: phi for p in effect.parameters if p.role == "phase"}
            rows.append(self._camera(effect, path, values))
        return rows[0], rows[1]

    def _camera(self, effect: Effect, path: Path, values: dict[str, float]) -> Array:
        tape = Tape([effect.expression])

        def law(compressed: Compressed, state: int, from_start: float) -> Array:
            t = compressed.samples.time
            sampler = Sampler(path.mesh, t)
            psi = (
                compressed.samples.value
                if self.data.is_angle
                else sampler.integral(*path.angle(path.states[state]))
            )
            known: dict[str, Any] = {
                "t": t - from_start,
                "omega": sampler.value(path.y[..., state]),
                "psi": psi,
            }
            seen = np.asarray(tape(values | known)[0]) * np.ones(len(t))
            return seen if self.data.is_angle else np.gradient(seen, t)

        if effect.joint == "camera.casing":
            return self.data.casing_rows(law(self.data.casing, 1, 0.0)[:, None])[:, 0]
        out = np.zeros(len(self.data.z))
        parts = [w.at_samples(law(w, 0, w.samples.time[0])[:, None])[0][:, 0] for w in self.data.rotor]
        out[self.data.slices["rotor"]] = np.concatenate(parts)
        return out
