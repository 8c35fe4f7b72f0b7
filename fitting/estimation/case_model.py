"""One case under one model: predicted rows and their derivatives by the variables of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.compression import Compressed
from fitting.dynamics import Dynamics
from fitting.effects import Effect
from fitting.estimation.layout import START_CASING, START_ROTOR, Layout
from fitting.estimation.rippling import ripple_rows
from fitting.expression import Tape
from fitting.simulation import Mesh, Path, Sampler, Sensitivity, sensitivities, solve
from fitting.simulation.linear import LinearMotion

Array = NDArray[np.float64]

_INTERVALS = 12


@dataclass(frozen=True)
class Prediction:
    """Rows that a model predicts, their derivatives by the variables of the fit, and the solution behind.

    Attributes
    ----------
    rows : ndarray, shape (rows,)
        What the model predicts.
    columns : ndarray, shape (rows, own)
        Derivatives by the variables that this case has to do with.
    places : ndarray, shape (own,)
        Which these are.
    count : int
        Number of all variables of the fit.
    path, sensitivity
        The solution and its derivatives.
    """

    rows: Array
    columns: Array
    places: NDArray[np.intp]
    count: int
    path: Path
    sensitivity: Sensitivity

    @property
    def jacobian(self) -> Array:
        """Derivatives by all variables of the fit, (rows, variables)."""
        dense = np.zeros((len(self.rows), self.count))
        dense[:, self.places] = self.columns
        return dense

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
        moving = layout.places(case, (*self.dynamics.parameters, START_ROTOR, START_CASING))
        added = [
            f"{e.name}.{p.symbol}"
            for e in (*layout.model.rippling, *layout.model.measurement)
            for p in e.free
        ]
        # the variables that this case has to do with; the first ones move it
        self.places = np.concatenate([moving, layout.places(case, added)])
        self._own = {int(k): i for i, k in enumerate(self.places)}
        self._moving = len(moving)
        self._guess: Path | None = None
        self._columns: dict[str, tuple[Array, Array]] = {}

    def solve(self, theta: Array) -> Path:
        """Integrate the smooth part of the model."""
        first = np.array([*self.layout.start(theta, self.case), *self.dynamics.start])
        guess = self._guess or self._measured(first)
        self._guess = solve(self.dynamics, self.layout.numbers(theta, self.case), first, self._mesh, guess)
        return self._guess

    @cached_property
    def _mesh(self) -> Mesh:
        return Mesh.uniform(*self.data.record.span, _INTERVALS)

    def _measured(self, first: Array) -> Path:
        """Return the measured motion as a first guess."""
        times, speeds = self.data.rough_speeds
        mesh, n = self._mesh, len(first)
        y, edges = (np.tile(first, (*t.shape, 1)) for t in (mesh.times, mesh.edges))
        for i in range(2):
            y[..., i] = np.interp(mesh.times, times, speeds[:, i])
            edges[:, i] = np.interp(mesh.edges, times, speeds[:, i])
        return Path(mesh, y, edges, self.dynamics.states[:n], np.ones(len(y)), exact=False)

    def predict(self, theta: Array) -> Prediction:
        """Return rows and derivatives at these variables."""
        path = self.solve(theta)
        numbers = self.layout.numbers(theta, self.case)
        sensitivity = sensitivities(self.dynamics, numbers, path)
        seen = self.data.observe(path, np.concatenate([path.y[..., None], sensitivity.nodes], axis=3))
        rows = seen[:, 0].copy()
        columns = np.zeros((len(rows), len(self.places)))
        columns[:, : self._moving] = seen[:, 1:]
        for effect in (*self.layout.model.rippling, *self.layout.model.measurement):
            if effect.name not in self._columns:
                self._columns[effect.name] = self.unit_columns(effect, path, sensitivity, numbers)
            self._add(effect, numbers, rows, columns)
        return Prediction(rows, columns, self.places, len(theta), path, sensitivity)

    def forget_columns(self) -> None:
        """Compute the responses to laws that follow an angle anew at the next prediction."""
        self._columns.clear()

    def _add(self, effect: Effect, numbers: dict[str, float], rows: Array, columns: Array) -> None:
        sine, cosine = self._columns[effect.name]
        # what is held has neither role nor column
        own = {p.role: f"{effect.name}.{p.symbol}" for p in effect.parameters}
        places = {role: int(self.layout.places(self.case, [key])[0]) for role, key in own.items()}
        k = numbers[own["amplitude"]] if "amplitude" in own else 1.0
        phi = numbers[own["phase"]] if "phase" in own else 0.0
        wave = np.cos(phi) * sine + np.sin(phi) * cosine
        rows += k * wave
        if "amplitude" in own:
            columns[:, self._own[places["amplitude"]]] = wave
        if "phase" in own:
            columns[:, self._own[places["phase"]]] = k * (np.cos(phi) * cosine - np.sin(phi) * sine)

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
        return self.data.late_starts.whitened(out)
