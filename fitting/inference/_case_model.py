"""One case under one model: predicted rows and their derivatives.

Some torques are periodic in the angle. Their argument is not the measured angle, because its noise would make the
torque random. The argument is the angle of the model, including the response to the torque itself, plus the smoothed
difference between the measured and the modelled angle. If speeds were measured, their integral is the measured angle.
The smoothed curve consists of many pieces if the model has a large lack of fit, and of few pieces if it has none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting._errors import SimulationError
from fitting.dynamics._collocation import MAX_INTERVALS, UNBOUNDED, Mesh, Path, Sampler, rule
from fitting.dynamics._events import solve
from fitting.dynamics._inputs import values_at
from fitting.dynamics._model import Dynamics
from fitting.dynamics._sensitivities import LinearMotion, Sensitivity, sensitivities
from fitting.effects._effect import Effect
from fitting.effects._expression import Tape, derivative
from fitting.effects._mechanism import MAIN
from fitting.inference._case_data import CaseData
from fitting.inference._compression import Compressed
from fitting.inference._parameters import ParameterLayout
from fitting.inference._record import Samples, hermite

_GAUSS = 3
"""Number of nodes of the Gauss rule in a cell [1]. Chosen: exact to degree 5; a smaller number loses accuracy in long
cells, a larger one costs time."""
_PASSES = 20
"""Largest number of iterations for a law of an angle whose response changes the angle [1]. Chosen: a smaller number
stops before convergence, a larger one costs time in iterations that do not converge."""
_NEGLIGIBLE = 0.01
"""The iteration has converged if the angle changes by less than this value, relative to the uncertainty of a mean of
all samples [1]. Chosen: a smaller value costs iterations, a larger one biases the angle."""
_CHANGE = 1e-3
"""The iteration has converged if the derivative of the angle changes by less than this value, relative to the part of
the derivative that is not smooth [1]. Chosen: a smaller value costs iterations, a larger one gives inaccurate
derivatives."""
_MEMORY = 6
"""Number of earlier iterations that Anderson's acceleration uses [1]. Chosen: with fewer, the convergence is slow; with
more, the least-squares problem is degenerate."""
_ERRORS = 6
"""Number of terms of the Karhunen-Loeve series of the error of an integrated angle, a random walk [1]. Derived: two
terms contain 90 % of the variance, six terms 97 %."""


class AngleRows(NamedTuple):
    """Rows of a law of an angle, linearised at its present strengths at phase 0 and at a quarter period."""

    columns: Array  # (rows, 2), derivatives with respect to the two strengths
    strength: Array  # the present strengths
    value: Array  # (rows,), response at these strengths
    # response of speeds and angles of the bodies to these strengths, at the samples of the casing, (2, bodies,
    # samples); None for an error of the measurement
    motion: Array | None = None


def angle_dependent_rows(
    data: CaseData,
    effect: Effect,
    path: Path,
    motion: LinearMotion,
    numbers: Mapping[str, float],
    error: Callable[[Array], Array] | None = None,
) -> AngleRows:
    """Return the response of the rows to a law of an angle about the solution without it.

    The law changes its own argument, the angle; this causes a mean torque of second order in the strength. With a
    constant argument, a change of the phase would wrongly cause a mean torque of first order. `error` is an error of
    the measured angle of the casing [rad] as a function of time, whose effect is computed.
    """
    record = data.record
    t = record.casing.time
    half = 0.5 * np.diff(t)
    inner = ((t[:-1] + half)[:, None] + half[:, None] * rule(_GAUSS).x).ravel()
    between = np.repeat(np.arange(len(half)), _GAUSS)
    sampler = Sampler(path.mesh, inner)
    mechanism = effect.mechanism
    known = mechanism.motion(sampler.value(path.y[..., i]) for i in range(path.speeds))
    both = zip(mechanism.angles, mechanism.speeds, strict=True)
    known |= {angle: sampler.integral(*path.angle(speed)) for angle, speed in both}
    own_angle, own_speed = mechanism.main_angle, mechanism.speeds[MAIN]
    psi = known[own_angle]
    known |= {"t": inner} | values_at(record.inputs, inner)
    measured, model = data.measured_angle, Sampler(path.mesh, t)
    direction = np.array(mechanism.shares(effect.site)) / record.inertias
    laws, strength = _unit_laws(effect, numbers)

    def torques(tape: Tape) -> Array:
        return np.stack([np.asarray(tape({**law, **known})[0]) * np.ones(len(inner)) for law in laws], axis=1)

    respond = motion.driven(t, _GAUSS, direction)

    def driven(torque: Array) -> tuple[Array, Array]:
        return respond(torque.reshape(len(half), _GAUSS, -1))

    tape, observed = Tape([effect.expression]), int(data.is_angle)
    if measured is not None:
        start = 0.0 if data.is_angle else model.integral(*path.angle(own_speed))[0]
        deviation = start + measured - model.integral(*path.angle(own_speed))
        deviation = deviation if error is None else deviation + error(t)
        of_values = deviation if data.is_angle else record.casing.value - model.value(path.y[..., MAIN])
    # speeds and angles of the casing due to the law at its present strengths; zero in the first iteration
    own, search, pieces, cubics = np.zeros((2, len(t))), _FixedPoint(), [0], data.angle_cubics
    for _ in range(_PASSES):
        if measured is not None:
            if len(pieces) < 2 or pieces[-1] != pieces[-2]:
                pieces.append(cubics.needed(of_values - own[observed]))
                search = _FixedPoint()
            smooth = np.interp(inner, t, cubics.smooth(deviation - own[1], pieces[-1]))
            known[own_angle] = psi + hermite(t, own[1], own[0], inner, interval=between) + smooth
        unit = torques(tape)
        speed, angle = driven(unit)
        found = np.stack([speed[MAIN] @ strength, angle[MAIN] @ strength])
        change = np.abs(found[observed] - own[observed]).max()
        if measured is None or change < _NEGLIGIBLE * _unit_error(record.casing):
            break
        own = search.next(own, found)
    value = _observed(data, speed, angle) @ strength
    moved = np.stack([speed @ strength, angle @ strength])
    if measured is not None and error is None and strength.any():
        # the smoothed deviation already contains a part of the response; only the remaining part changes the argument
        stiffness = torques(Tape([derivative(effect.expression, own_angle)])) @ strength
        for j in range(2):
            response, search = np.stack([speed[MAIN][:, j], angle[MAIN][:, j]]), _FixedPoint()
            for _ in range(_PASSES):
                smooth = cubics.smooth(response[1], pieces[-1])
                fast = hermite(t, response[1], response[0], inner, interval=between)
                fast -= np.interp(inner, t, smooth)
                w, a = driven(unit[:, j] + stiffness * fast)
                found = np.stack([w[MAIN][:, 0], a[MAIN][:, 0]])
                if np.abs(found[1] - response[1]).max() < _CHANGE * np.std(response[1] - smooth):
                    break
                response = search.next(response, found)
            speed[..., j], angle[..., j] = w[..., 0], a[..., 0]
    return AngleRows(_observed(data, speed, angle), strength, value, moved)


_DIVERGED = 1e100
"""Speed or angle that no body reaches [rad/s or rad]. Derived: sums of squares of larger values overflow (1e154 and
more)."""


class _FixedPoint:
    """Anderson's acceleration of an iteration x = g(x) (D. G. Anderson, J. ACM 12, 547 (1965))."""

    def __init__(self) -> None:
        self._steps: list[Array] = []
        self._values: list[Array] = []

    def next(self, x: Array, value: Array) -> Array:
        """Return the next x from x and g(x): the weighted mean of earlier g(x) with the smallest mean step g(x) - x."""
        if not np.abs(value).max() < _DIVERGED:
            raise SimulationError(UNBOUNDED)
        self._steps.append((value - x).ravel())
        self._values.append(value.ravel())
        steps, values = (np.stack(v[-_MEMORY:], axis=1) for v in (self._steps, self._values))
        weights = np.linalg.lstsq(np.diff(steps), steps[:, -1], rcond=1e-10)[0]
        return np.asarray((values[:, -1] - np.diff(values) @ weights).reshape(x.shape))


def _unit_error(samples: Samples) -> float:
    """Return the standard uncertainty of a mean of all samples."""
    return float(1 / np.sqrt(np.sum(1 / samples.sigma**2)))


def _observed(data: CaseData, speed: Array, angle: Array) -> Array:
    """Return the rows of speeds and angles (bodies, samples, columns) at the samples of the casing."""
    own = angle[MAIN] if data.is_angle else speed[MAIN]
    return data.casing_rows(own) + _rotor_rows(data, speed, angle)


def _unit_laws(effect: Effect, numbers: Mapping[str, float]) -> tuple[Sequence[dict[str, float]], Array]:
    """Return the parameters of the law at strength 1 for both phases, and both present strengths."""
    values = {p.symbol: numbers.get(f"{effect.name}.{p.symbol}", p.start) for p in effect.parameters}
    symbol = {p.role: p.symbol for p in effect.parameters}
    # a fixed parameter has the role "fixed" and keeps its value
    phase, amplitude = symbol.get("phase", ""), symbol.get("amplitude", "")
    unit = {amplitude: 1.0} if amplitude else {}
    laws = [values | unit | ({phase: phi} if phase else {}) for phi in (0.0, np.pi / 2)]
    k = numbers.get(f"{effect.name}.{amplitude}", 0.0) if amplitude else 1.0
    phi = values.get(phase, 0.0)
    return laws, k * np.array([np.cos(phi), np.sin(phi)])


def _rotor_rows(data: CaseData, speed: Array, angle: Array) -> Array:
    # the bearing transmits only slow changes; harmonics of the casing's angle are below the noise in the rotor's angle
    t = data.record.casing.time
    windows = [(w.samples.state, np.clip(w.node_times, t[0], t[-1])) for w in data.rotor]
    nodes = [hermite(t, angle[i], speed[i], w, slopes=not data.is_angle) for i, w in windows]
    return data.rows(np.zeros((len(data.casing.node_times), angle.shape[2])), nodes)


Array = NDArray[np.float64]

_INTERVALS = 12
"""Number of intervals of the first mesh [1]. Chosen: the mesh is refined to the tolerance; a smaller number needs more
refinements, a larger one costs time."""
_PER_REVERSAL = 5
"""Number of intervals of the first mesh between two reversals of an oscillation [1]. Derived: ten nodes resolve a
sinusoid over a fifth of the half period to 1e-11, the Bessel function J_8 of pi / 10, so few intervals have to be
halved."""
_LEAST_INTERVALS = 600
"""Smallest limit of the number of intervals [1]. Chosen: the solution of stiff equations takes minutes to fail; a
smaller value refuses short records, a larger one costs time in motions that cannot be computed."""
_PER_SAMPLE = 2
"""Largest number of intervals per sample [1]. Chosen: a motion with several changes between two samples is not
measured; a smaller value refuses fast changes, a larger one costs time in motions that cannot be computed."""
_MANY_REVERSALS = 3
"""Smallest number of reversals that are solved simultaneously [1]. Chosen: equal to `fitting.dynamics._events._MANY`;
with a smaller value, motions are included whose number of reversals may still change; a larger one costs time."""
_SPARE_EVENTS = 20
"""Largest number of stops and reversals of a trial motion, in excess of twice their number in the measured motion [1].
Chosen: a smaller value refuses trials that converge, a larger one costs time for trials that chatter."""
_FEW_SINGLE = 40
"""Largest number of stretches between reversals that are integrated one by one [1]. Chosen: the integration of one
stretch takes as long as the simultaneous solution of all stretches; a smaller value refuses trials that converge, a
larger one costs time."""
_HALVINGS = 2
"""Largest number of bisections of the step between two solutions [1]. Chosen: a smaller number refuses long steps, a
larger one delays failures."""


@dataclass(frozen=True)
class Prediction:
    """Rows that a model predicts, their derivatives with respect to the variables of the fit, and the solution."""

    rows: Array
    columns: Array  # (rows, own): derivatives with respect to the variables on which this case depends
    places: NDArray[np.intp]  # (own,): indices of these variables
    count: int  # number of all variables of the fit
    path: Path
    sensitivity: Sensitivity

    @property
    def jacobian(self) -> Array:
        """Derivatives with respect to all variables of the fit, (rows, variables)."""
        dense = np.zeros((len(self.rows), self.count))
        dense[:, self.places] = self.columns
        return dense

    @property
    def motion(self) -> LinearMotion:
        """The equations of motion, linearised about the solution."""
        return LinearMotion(self.path, self.sensitivity.propagator)


class CaseModel:
    """Predicts the rows of one case of a layout; each solution starts from the previous solution."""

    def __init__(self, data: CaseData, layout: ParameterLayout, case: int) -> None:
        self.data, self.layout, self.case = data, layout, case
        self.dynamics = Dynamics(layout.model.smooth, inputs=data.record.inputs)
        moving = layout.places(case, (*self.dynamics.parameters, *layout.starts))
        added = [
            f"{e.name}.{p.symbol}"
            for e in (*layout.model.angle_dependent, *layout.model.measurement)
            for p in e.free
        ]
        # the variables on which this case depends; variables of the equations of motion come first
        self.places = np.concatenate([moving, layout.places(case, added)])
        self._own = {int(k): i for i, k in enumerate(self.places)}
        self._moving = len(moving)
        prior = data.prior
        # the prior of shared parameters counts once, in the first case
        self._prior = (
            None
            if prior is None
            else prior.whitened(
                layout.names, data.record.label, shared=layout.records[0].label == data.record.label
            )
        )
        self._last: tuple[Array, Path] | None = None
        self._columns: dict[str, AngleRows] = {}

    def solve(self, theta: Array, halvings: int = _HALVINGS) -> Path:
        """Integrate the smooth part of the model; with many reversals, by continuation from the last solution.

        Over hundreds of reversals a change of the frequency shifts the later reversals far, and Newton's method
        converges only if each reversal is near its previous time. Integration from one reversal to the next takes a
        hundred times as long. Therefore a trial that fails even in short steps raises an error and is not integrated.
        """
        last = self._last
        known = self._measured(theta) if last is None else last[1]
        many = last is not None and len(known.jumps) >= _MANY_REVERSALS
        first = np.array([*self.layout.start(theta, self.case), *self.dynamics.start])
        numbers = self.layout.numbers(theta, self.case)
        limits = {"most": _FEW_SINGLE + len(known.jumps) // 25 if many else self._most_events}
        try:
            path = solve(self.dynamics, numbers, first, self._mesh, known, intervals=self._most, **limits)
        except SimulationError:
            if last is None or not many or not halvings:
                raise
            try:
                self.solve(0.5 * (last[0] + theta), halvings - 1)
                path = self.solve(theta, halvings - 1)
            except SimulationError:
                self._last = last
                raise
        self._last = theta.copy(), path
        return path

    @cached_property
    def _most_events(self) -> int:
        """Largest number of stops and reversals of a trial; with more, it is unrelated to the measured motion."""
        sense = np.sign(self.data.initial_speeds[1][:, MAIN])
        turned = int((sense[1:] != sense[:-1]).sum())
        return _SPARE_EVENTS + 2 * max(turned, len(self.data.motion.reversals))

    @cached_property
    def _most(self) -> int:
        record = self.data.record
        samples = sum(map(len, (record.casing, *record.rotor)))
        return min(MAX_INTERVALS, max(_LEAST_INTERVALS, _PER_SAMPLE * samples))

    @cached_property
    def _mesh(self) -> Mesh:
        first, last = self.data.record.span
        turns = self.data.motion.reversals
        if not len(turns):
            mesh = Mesh.uniform(first, last, _INTERVALS)
            if not self.dynamics.relaxation:
                return mesh
            settling = self.layout.model.constants[self.dynamics.relaxation]
            doublings = np.arange(-1, np.log2(np.ptp(mesh.edges[:2]) / settling))
            return mesh.with_breakpoints((first + settling * 2.0**doublings).tolist())
        ends = np.concatenate([[first], turns[(turns > first) & (turns < last)], [last]])
        share = np.arange(_PER_REVERSAL) / _PER_REVERSAL
        edges = (ends[:-1, None] + np.diff(ends)[:, None] * share).ravel()
        return Mesh(np.append(edges, last))

    def _measured(self, theta: Array) -> Path:
        """Return the measured motion, from which the first solution starts."""
        first = np.array([*self.layout.start(theta, self.case), *self.dynamics.start])
        times, speeds = self.data.initial_speeds
        mesh, n = self._mesh, len(first)
        mesh, jumps, sense = self._reversals(mesh, first)
        y, edges = (np.tile(first, (*t.shape, 1)) for t in (mesh.times, mesh.edges))
        measured = [(times, speed) for speed in speeds.T]
        if "deflection" in self.dynamics.states and len(self.data.motion.reversals):
            measured.append((self.data.motion.time, self.data.motion.deflection))
        for i, (t, value) in enumerate(measured):
            y[..., i] = np.interp(mesh.times, t, value)
            edges[:, i] = np.interp(mesh.edges, t, value)
        return Path(mesh, y, edges, self.dynamics.states[:n], sense, jumps=jumps, exact=False)

    def _reversals(self, mesh: Mesh, first: Array) -> tuple[Mesh, dict[int, Array], Array]:
        """Return the mesh with an edge at each measured reversal, indices of these edges, and senses of intervals."""
        motion = self.data.motion
        times: tuple[float, ...] = ()
        if "deflection" in self.dynamics.states:
            turns = motion.reversals
            times = tuple(turns[(turns > mesh.edges[0]) & (turns < mesh.edges[-1])])
        mesh = mesh.with_breakpoints(times)
        at = np.searchsorted(mesh.edges, times)
        turned = np.searchsorted(at, np.arange(len(mesh.edges) - 1), side="right")
        initial_sense = np.sign(first[MAIN]) or 1.0
        if len(times):
            # the initial speed of a body that is released at rest may have either sign
            ends = np.interp([mesh.edges[0], times[0]], motion.time, motion.deflection)
            initial_sense = np.sign(ends[1] - ends[0]) or initial_sense
        sense: Array = np.asarray(initial_sense * (-1.0) ** turned)
        return mesh, {int(i): np.eye(len(first)) for i in at}, sense

    def predict(self, theta: Array) -> Prediction:
        """Return rows and derivatives at these values of the variables."""
        path = self.solve(theta)
        numbers = self.layout.numbers(theta, self.case)
        sensitivity = sensitivities(self.dynamics, numbers, path)
        observed = self.data.observe(path, np.concatenate([path.y[..., None], sensitivity.nodes], axis=3))
        rows = observed[:, 0].copy()
        columns = np.zeros((len(rows), len(self.places)))
        columns[:, : self._moving] = observed[:, 1:]
        for effect in (*self.layout.model.angle_dependent, *self.layout.model.measurement):
            if effect.name not in self._columns:
                self._columns[effect.name] = self._rows_of(effect, path, sensitivity, numbers)
            self._add(effect, numbers, rows, columns)
        if self._prior is not None:
            names, mean, inverse = self._prior
            places = np.array([self.layout.index[n] for n in names], dtype=np.intp)
            first = len(rows) - self.data.prior_rows
            rows[first : first + len(names)] = inverse @ (theta[places] - mean)
            own = [self._own[int(k)] for k in places]
            columns[first : first + len(names), own] = inverse
        return Prediction(rows, columns, self.places, len(theta), path, sensitivity)

    def response_to_angles(self, prediction: Prediction, theta: Array) -> Array | None:
        """Return the response to all laws of an angle, which is not part of the path; None without such laws.

        Returns
        -------
        ndarray, shape (2, bodies, samples), or None
            Speed [rad/s] and angle [rad] of the bodies at the samples of the casing.
        """
        numbers = self.layout.numbers(theta, self.case)
        found = [
            self._rows_of(effect, prediction.path, prediction.sensitivity, numbers).motion
            for effect in self.layout.model.angle_dependent
        ]
        return np.sum([f for f in found if f is not None], axis=0) if found else None

    def forget_columns(self) -> None:
        """Clear the cached responses to laws of an angle; the next prediction computes them again."""
        self._columns.clear()

    def _add(self, effect: Effect, numbers: dict[str, float], rows: Array, columns: Array) -> None:
        known = self._columns[effect.name]
        sine, cosine = known.columns.T
        # a fixed parameter has no column
        keys = {p.role: f"{effect.name}.{p.symbol}" for p in effect.parameters}
        places = {role: int(self.layout.places(self.case, [key])[0]) for role, key in keys.items()}
        k = numbers[keys["amplitude"]] if "amplitude" in keys else 1.0
        phi = numbers[keys["phase"]] if "phase" in keys else 0.0
        row = np.cos(phi) * sine + np.sin(phi) * cosine
        rows += known.value - known.columns @ known.strength + k * row
        if "amplitude" in keys:
            columns[:, self._own[places["amplitude"]]] = row
        if "phase" in keys:
            columns[:, self._own[places["phase"]]] = k * (np.cos(phi) * cosine - np.sin(phi) * sine)

    def unit_columns(
        self, effect: Effect, path: Path, sensitivity: Sensitivity, numbers: dict[str, float]
    ) -> tuple[Array, Array]:
        """Return the derivatives of the rows with respect to the strengths at phase 0 and at a quarter period."""
        sine, cosine = self._rows_of(effect, path, sensitivity, numbers).columns.T
        return sine, cosine

    def _rows_of(
        self, effect: Effect, path: Path, sensitivity: Sensitivity, numbers: dict[str, float]
    ) -> AngleRows:
        if effect.mechanical:
            return angle_dependent_rows(
                self.data, effect, path, LinearMotion(path, sensitivity.propagator), numbers
            )
        laws, strength = _unit_laws(effect, numbers)
        columns = np.stack([self._camera(effect, path, law) for law in laws], axis=1)
        return AngleRows(columns, strength, columns @ strength)

    def integration_errors(self, prediction: Prediction, theta: Array) -> Array:
        """Return the effect of the error of an integrated angle on the rows, one column for each independent part.

        White noise of measured speeds causes a random walk of their integral. If its variance after a time T is v, its
        Karhunen-Loeve expansion has the parts sqrt(2 v) sin(w t) / (w T), w = (j - 1/2) pi / T.
        """
        run, effects = self.data.casing, self.layout.model.angle_dependent
        if self.data.is_angle or self.data.measured_angle is None or not effects:
            return np.zeros((len(prediction.rows), 0))
        t, numbers = run.samples.time, self.layout.numbers(theta, self.case)
        length = t[-1] - t[0]
        walk = run.scale * np.sqrt(np.sum((run.samples.sigma * np.gradient(t)) ** 2))

        def rows(error: Callable[[Array], Array] | None) -> Array:
            total = np.zeros(len(prediction.rows))
            for effect in effects:
                total += angle_dependent_rows(
                    self.data, effect, prediction.path, prediction.motion, numbers, error
                ).value
            return total

        def part(w: float) -> Callable[[Array], Array]:
            return lambda x: walk * np.sqrt(2) / (w * length) * np.sin(w * (x - t[0]))

        undisturbed = rows(None)
        rates = (np.arange(_ERRORS) + 0.5) * np.pi / length
        return np.stack([rows(part(w)) - undisturbed for w in rates], axis=1)

    def _camera(self, effect: Effect, path: Path, values: dict[str, float]) -> Array:
        tape = Tape([effect.expression])

        def law(compressed: Compressed, state: int, from_start: float) -> Array:
            t = compressed.samples.time
            sampler = Sampler(path.mesh, t)
            psi = compressed.samples.value
            if not self.data.is_angle:
                integrated = self.data.measured_angle if state else None
                psi = sampler.integral(*path.angle(path.states[state])) if integrated is None else integrated
            known: dict[str, Any] = {
                "t": t - from_start,
                "omega": sampler.value(path.y[..., state]),
                "psi": psi,
            }
            error = np.asarray(tape(values | known)[0]) * np.ones(len(t))
            return error if self.data.is_angle else np.gradient(error, t)

        if effect.camera == "casing":
            return self.data.casing_rows(law(self.data.casing, 1, 0.0)[:, None])[:, 0]
        out = np.zeros(len(self.data.z))
        parts = [w.at_samples(law(w, 0, w.samples.time[0])[:, None])[0][:, 0] for w in self.data.rotor]
        out[self.data.slices["rotor"]] = np.concatenate(parts)
        return self.data.whitened(out)
