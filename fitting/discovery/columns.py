"""What each candidate effect would do to the rows of a fitted case, without a refit.

A small torque u(t) on a body moves the rows by W u, with the response W of the linearised motion to a torque
in each of many short cells. So one matrix product gives the rows of all candidates and of all values of
their shape constants; only laws that follow an angle, and what cameras do, are computed on the samples.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics import INERTIA_CASING
from fitting.effects import Effect
from fitting.effects.effect import Parameter
from fitting.estimation import Fit
from fitting.estimation.case_model import CaseModel, Prediction
from fitting.expression import Tape, derivative
from fitting.noise import TorqueResponse
from fitting.simulation import Sampler

Array = NDArray[np.float64]

# an oscillation is looked for at frequencies so near that its phase drifts by this much in between [rad]
_PHASE_STEP = 1.5
# and up to the frequency that the cells resolve [rad per cell]
_FASTEST = 1.0
_MAX_FREQUENCIES = 1500
# times of a break are tried this many times finer than their grid says
_FINER = 8


@dataclass(frozen=True)
class Trial:
    """A candidate with one choice of its shape constants: its columns in the rows of one case."""

    shape: dict[str, float]
    columns: Array


class CaseColumns:
    """Makes the columns of candidates for one case of a fit.

    Parameters
    ----------
    fit : Fit
        The base.
    index : int
        Which of its cases.
    """

    def __init__(self, fit: Fit, index: int) -> None:
        self.case: CaseModel = fit.problem.cases[index]
        self.prediction: Prediction = fit.predictions[index]
        self.numbers = fit.problem.layout.numbers(fit.theta, index)
        self.response = TorqueResponse(self.case.data, self.prediction.motion)
        path = self.prediction.path
        y = Sampler(path.mesh, self.response.centres).value(path.y)
        self._known: dict[str, Any] = {name: y[:, i] for i, name in enumerate(path.states)}
        self._known |= {"t": self.response.centres, "delta": y[:, 0] - y[:, 1]}
        tau = Tape([self.case.dynamics.bearing_torque])(
            self._known | self.case.dynamics.constants | self.numbers
        )
        self._known["tau"] = np.asarray(tau[0]) * np.ones(len(y))
        rates = self.case.dynamics.rates(self.response.centres, y, self.numbers)
        # the whole torque on a body is its inertia times its acceleration
        self._whole = {"factor": self._known["tau"], "inertia": self.numbers[INERTIA_CASING] * rates[:, 1]}

    def trials(self, effect: Effect, choices: list[dict[str, float]] | None = None) -> list[Trial]:
        """Return the columns of a candidate for every choice of its shape constants, or for the choices given."""
        if not effect.moves or effect.depends_on_angle:
            sine, cosine = self.case.unit_columns(
                effect, self.prediction.path, self.prediction.sensitivity, self.numbers
            )
            pair = [sine, cosine] if _phase(effect) else [sine]
            return [Trial({}, np.stack(pair, axis=1))]
        if choices is None:
            shapes = [p for p in effect.parameters if p.role == "shape"]
            grids = [self._grid(effect, p) for p in shapes]
            symbols = [p.symbol for p in shapes]
            choices = [dict(zip(symbols, map(float, v), strict=True)) for v in itertools.product(*grids)]
        torques = [self._torque(effect, choice) for choice in choices]
        rotor = np.concatenate([t[0] for t in torques], axis=1)
        casing = np.concatenate([t[1] for t in torques], axis=1)
        rows = self.response.rotor @ rotor + self.response.casing @ casing
        rows = np.concatenate([rows, np.zeros((len(self.case.data.z) - len(rows), rows.shape[1]))])
        width = torques[0][0].shape[1]
        return [Trial(c, rows[:, i * width : (i + 1) * width]) for i, c in enumerate(choices)]

    def _grid(self, effect: Effect, p: Parameter) -> Array:
        first, last = self.case.data.record.span
        if effect.state is not None and _phase(effect):
            # phase of the oscillation per unit of its frequency parameter, over the whole record
            turns = self._state(effect, {p.symbol: 1.0})
            reach = float(np.ptp(turns))
            fastest = _FASTEST / max(float(np.abs(np.diff(turns)).max()), 1e-300)
            count = int(min(_MAX_FREQUENCIES, fastest * reach / _PHASE_STEP))
            return np.linspace(fastest / max(count, 1), fastest, max(count, 1))
        grid = np.array(p.grid or (p.start,))
        if p.symbol == effect.breakpoint:
            # the clearer a break, the narrower the hollow about its time
            finer = np.interp(np.arange((len(grid) - 1) * _FINER + 1) / _FINER, np.arange(len(grid)), grid)
            return np.asarray(first + finer * (last - first))
        return grid * (last - first) if p.relative else grid

    def _torque(self, effect: Effect, shape: dict[str, float]) -> tuple[Array, Array]:
        values = self._known | {p.symbol: p.start for p in effect.parameters} | shape
        if effect.state is not None:
            values[effect.state.symbol] = self._state(effect, shape)
        amplitude = next(p.symbol for p in effect.parameters if p.role == "amplitude")
        if effect.joint in self._whole:
            values[amplitude] = 0.0
            slope = Tape([derivative(effect.expression, amplitude)])(values)[0]
            law = [self._whole[effect.joint] * np.asarray(slope)]
        else:
            values[amplitude] = 1.0
            tape, phase = Tape([effect.expression]), _phase(effect)
            law = [
                np.asarray(tape(values | ({phase: phi} if phase else {}))[0])
                for phi in ((0.0, np.pi / 2) if phase else (0.0,))
            ]
        unit = np.stack([v * np.ones(len(self.response.centres)) for v in law], axis=1)
        if effect.breakpoint:
            self._part_of_cell(effect, values, unit)
        on_rotor = {"rotor": 1.0, "casing": 0.0, "inertia": 0.0}.get(effect.joint, -1.0)
        on_casing = {"rotor": 0.0, "casing": 1.0}.get(effect.joint, 1.0)
        return on_rotor * unit, on_casing * unit

    def _part_of_cell(self, effect: Effect, values: dict[str, Any], unit: Array) -> None:
        """Let a jump within a cell act for the part of the cell that comes after it."""
        edges = self.response.edges
        cell = int(np.searchsorted(edges, values[effect.breakpoint], side="right")) - 1
        if not 0 <= cell < len(unit):
            return
        late = (edges[cell + 1] - values[effect.breakpoint]) / (edges[cell + 1] - edges[cell])
        here = {k: v[cell] if isinstance(v, np.ndarray) and v.ndim else v for k, v in values.items()}
        before, after = (
            Tape([effect.expression])(here | {"t": float(t)})[0]
            for t in (edges[cell] - 1e-9, edges[cell + 1] + 1e-9)
        )
        unit[cell] = (1 - late) * before + late * after

    def _state(self, effect: Effect, shape: dict[str, float]) -> Array:
        """Integrate the effect's own state along the base's path (Crank-Nicolson on the cells)."""
        if effect.state is None or effect.rate is None:
            return np.zeros(0)
        symbol = effect.state.symbol
        tape = Tape([effect.rate, derivative(effect.rate, symbol)])
        values = self._known | {p.symbol: p.start for p in effect.parameters} | shape | {symbol: 0.0}
        n = len(self.response.centres)
        source, decay = (np.asarray(v) * np.ones(n) for v in tape(values))
        h = self.response.edges[1] - self.response.edges[0]
        push = 0.5 * h * (source[1:] + source[:-1])
        if not decay.any():
            return np.asarray(
                effect.state.start + np.concatenate([[0.0], np.cumsum(push)]) + 0.5 * h * source[0]
            )
        keep = (1 + 0.5 * h * decay[:-1]) / (1 - 0.5 * h * decay[1:])
        gain = push / (1 - 0.5 * h * decay[1:])
        state = np.empty(n)
        state[0] = effect.state.start + 0.5 * h * source[0]
        for i in range(n - 1):
            state[i + 1] = keep[i] * state[i] + gain[i]
        return state


def _phase(effect: Effect) -> str:
    return next((p.symbol for p in effect.parameters if p.role == "phase"), "")
