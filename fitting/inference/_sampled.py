"""The fitted curve at the samples and at any time, with the fitted nuisance parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fitting._arguments import TEXT, require
from fitting._errors import EstimationError
from fitting.dynamics._collocation import Path, Sampler, rule
from fitting.dynamics._inputs import values_at
from fitting.dynamics._model import Model
from fitting.effects._effect import Effect
from fitting.effects._expression import Tape
from fitting.effects._mechanism import MAIN
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._noise import Noise
from fitting.inference._problem import Problem
from fitting.inference._record import Samples, hermite

Array = NDArray[np.float64]

GAUSS = 3
"""Number of nodes of the Gauss rule in a cell [1]. Chosen: exact to degree 5; a smaller number loses accuracy in long
cells, a larger one costs time."""
_PASSES = 8
"""Number of iterations for a law of an angle whose response changes the angle [1]. Chosen: the response is small
compared with a radian, so few iterations suffice; with a smaller number, an error remains; a larger one costs time."""


class Solved(Protocol):
    """The attributes of a `Fit` that determine its curve."""

    @property
    def problem(self) -> Problem: ...
    @property
    def predictions(self) -> tuple[Prediction, ...]: ...
    @property
    def model(self) -> Model: ...
    @property
    def theta(self) -> Array: ...
    @property
    def noise(self) -> tuple[Noise, ...]: ...


def _nuisance(case: int, found: Solved) -> Array:
    """Return the nuisance parameters of a case by generalised least squares: start angles, then camera parameters."""
    prediction, fitted = found.predictions[case], found.problem.data[case]
    rows = np.concatenate([fitted.nuisance, (fitted.z - prediction.rows)[:, None]], axis=1)
    white = found.problem.projections[case].whitener(rows)
    size = np.linalg.norm(white[:, :-1], axis=0)
    size[size == 0] = np.inf
    return np.asarray(np.linalg.lstsq(white[:, :-1] / size, white[:, -1], rcond=1e-7)[0] / size)


def predicted_samples(data: CaseData, case: int, found: Solved) -> Iterator[Array]:
    """Yield the prediction with fitted nuisance parameters at the samples of the casing, then of each window."""
    record, fitted = data.record, found.problem.data[case]
    path = found.predictions[case].path
    coefficients = _nuisance(case, found)
    # initial angles come first, then the amplitudes of error modes
    angles = 1 + len(record.rotor) if data.is_angle else 0
    columns = (fitted.mode_columns[0], *fitted.mode_columns[1])
    for i, samples in enumerate((record.casing, *record.rotor)):
        state = path.states[samples.state if i else MAIN]
        sampler = Sampler(path.mesh, samples.time)
        modes = columns[i] @ coefficients[angles : angles + columns[i].shape[1]]
        if not data.is_angle:
            yield sampler.value(path.y[..., path.states.index(state)]) + modes
            continue
        angle = sampler.integral(*path.angle(state)) + coefficients[i] + modes
        if i == 0 and fitted.has_camera_prior:
            angle = angle + fitted.camera_columns @ coefficients[-fitted.camera_columns.shape[1] :]
        yield angle


@dataclass(frozen=True)
class FittedMotion:
    """The fitted motion of one case, and the expected values at its samples."""

    fit: Solved
    case: int
    data: CaseData

    @property
    def prediction(self) -> Prediction:
        return self.fit.predictions[self.case]

    @property
    def numbers(self) -> dict[str, float]:
        return self.fit.problem.layout.numbers(self.fit.theta, self.case)

    def expected(self, times: Array, path: Path | None = None, *, rotor: bool) -> Array:
        """Return angles, up to a constant, or speeds of the smooth motion of rotor or casing."""
        return self.expected_of(0 if rotor else MAIN, times, path)

    def expected_of(self, state: int, times: Array, path: Path | None = None) -> Array:
        """Return angles, up to a constant, or speeds of the smooth motion of the body with this index in the state."""
        path = path or self.prediction.path
        sampler = Sampler(path.mesh, times)
        if self.data.is_angle:
            return sampler.integral(*path.angle(path.states[state]))
        return sampler.value(path.y[..., state])

    def values(self) -> list[Array]:
        """Return the expected values at the samples of the casing and of each window."""
        values = [np.array(v) for v in predicted_samples(self.data, self.case, self.fit)]
        runs = (self.data.record.casing, *self.data.record.rotor)
        zero = float(np.median(values[0] - self.expected(runs[0].time, rotor=False)))
        for effect in self.fit.model.angle_dependent:
            for value, change in zip(values, self.angle_response(effect, zero), strict=True):
                value += change
        for effect in self.fit.model.measurement:
            for i, run in enumerate(runs):
                if (effect.camera == "casing") == (i == 0):
                    values[i] += self._camera_error(effect, run, values[i], rotor=i > 0)
        return values

    def _law(self, effect: Effect) -> dict[str, float]:
        numbers = self.numbers
        return {p.symbol: numbers.get(f"{effect.name}.{p.symbol}", p.start) for p in effect.parameters}

    def _camera_error(self, effect: Effect, run: Samples, value: Array, *, rotor: bool) -> Array:
        """Return the error of the camera's angle at the samples of a run; for speeds, the derivative of this error."""
        path = self.prediction.path
        sampler, state = Sampler(path.mesh, run.time), int(not rotor)
        psi = value if self.data.is_angle else sampler.integral(*path.angle(path.states[state]))
        known = {"t": run.time - (run.time[0] if rotor else 0.0), "psi": psi}
        known["omega"] = sampler.value(path.y[..., state])
        error = np.asarray(Tape([effect.expression])(self._law(effect) | known)[0]) * np.ones(len(run))
        return error if self.data.is_angle else np.gradient(error, run.time)

    def angle_response(self, effect: Effect, zero: float) -> list[Array]:
        """Return the response of the casing and of each window to a law of the angle; `zero` is the initial angle."""
        record, path, motion = self.data.record, self.prediction.path, self.prediction.motion
        t = record.casing.time
        half = 0.5 * np.diff(t)
        inner = ((t[:-1] + half)[:, None] + half[:, None] * rule(GAUSS).x).ravel()
        sampler = Sampler(path.mesh, inner)
        mechanism = effect.mechanism
        known = mechanism.motion(sampler.value(path.y[..., i]) for i in range(path.speeds))
        known |= {"t": inner} | values_at(record.inputs, inner)
        both = zip(mechanism.angles, mechanism.speeds, strict=True)
        known |= {angle: sampler.integral(*path.angle(speed)) for angle, speed in both}
        psi = known[mechanism.main_angle] + (zero if self.data.is_angle else 0.0)
        direction = np.array(mechanism.shares(effect.site)) / record.inertias
        respond = motion.driven(t, GAUSS, direction)
        tape, law = Tape([effect.expression]), self._law(effect)
        between = np.repeat(np.arange(len(half)), GAUSS)
        own = np.zeros(len(inner))
        for _ in range(_PASSES):
            torque = np.asarray(tape(law | known | {mechanism.main_angle: psi + own})[0]) * np.ones(
                len(inner)
            )
            speed, angle = (x[..., 0] for x in respond(torque.reshape(len(half), GAUSS, 1)))
            own = hermite(t, angle[MAIN], speed[MAIN], inner, interval=between)
        found = [angle[MAIN] if self.data.is_angle else speed[MAIN]]
        for run in record.rotor:
            at, i = np.clip(run.time, t[0], t[-1]), run.state
            found.append(hermite(t, angle[i], speed[i], at, slopes=not self.data.is_angle))
        return found


def residuals_of(found: Solved) -> Array:
    """Return measured minus fitted values of all samples, divided by their stated standard uncertainties."""
    parts = []
    for case, data in enumerate(found.problem.data):
        runs = (data.record.casing, *data.record.rotor)
        for samples, model in zip(runs, FittedMotion(found, case, data).values(), strict=True):
            parts.append((samples.value - model) / samples.sigma)
    return np.concatenate(parts)


def evaluate(found: Solved, time: Any, body: int, case: int, quantity: str | None) -> Array:
    """Return the fitted angle [rad] or speed [rad/s] of the body with an index in the state, at some times [s]."""
    data = found.problem.data[case]
    measured = data.record.quantity
    require("quantity", quantity, TEXT.optional)
    chosen = measured if quantity is None else quantity
    if chosen not in ("angle", "omega"):
        raise EstimationError(f"the quantity is {str(chosen)[:20]!r}", "use angle or omega")
    if chosen == "angle" and measured == "omega":
        raise EstimationError("speeds were measured, which have no start angle", 'use quantity="omega"')
    numbers = [i for i, run in enumerate(data.record.rotor, 1) if run.state == body] if body != MAIN else [0]
    runs = [(data.record.casing, *data.record.rotor)[i] for i in numbers]
    first, last = data.record.span
    try:
        at = np.concatenate([r.time for r in runs]) if time is None else np.asarray(time, dtype=np.float64)
    except (TypeError, ValueError):
        raise EstimationError("the times are not numbers", "use a NumPy array [s]") from None
    flat = np.atleast_1d(at).ravel()
    if not ((flat >= first) & (flat <= last)).all():
        raise EstimationError(
            "a time is not within the record", f"give times from {first:.6g} to {last:.6g} s"
        )
    path = found.predictions[case].path
    sampler = Sampler(path.mesh, flat)
    response = found.problem.cases[case].response_to_angles(found.predictions[case], found.theta)
    of_laws = np.zeros(len(flat))
    if response is not None:
        speed, angle = response[:, body]
        of_laws = hermite(data.record.casing.time, angle, speed, flat, slopes=chosen == "omega")
    if chosen == "omega":
        value = sampler.value(path.y[..., body])
        return np.asarray(value + of_laws).reshape(at.shape)
    start = _nuisance(case, found)[numbers]
    angle = sampler.integral(*path.angle(path.states[body])) + of_laws
    # the start angle differs between the windows
    begins = np.array([run.time[0] for run in runs])
    window = np.clip(np.searchsorted(begins, flat, side="right") - 1, 0, len(begins) - 1)
    return np.asarray(angle + start[window]).reshape(at.shape)
