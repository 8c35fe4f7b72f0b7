"""New recordings of a fitted motion: the same bodies, samples and windows, with new random errors.

The expected values are those of the fit at every sample, with the fitted initial angles, camera errors, laws of an
angle and measurement effects. The random errors are those that the fit assumes (a parametric bootstrap; A. C. Davison,
D. V. Hinkley, Bootstrap Methods and their Application, 1997, ch. 4): white noise at the measured level, correlated
angle noise at a level drawn from its uncertainty, the random torque in the residuals of the fit, the errors that
tracking states, the starts of the windows, and moments of inertia that differ from the stated ones by their standard
uncertainties.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EstimationError
from fitting.dynamics._collocation import Path, Sampler, rule
from fitting.dynamics._inputs import values_at
from fitting.effects._effect import Effect
from fitting.effects._expression import Tape
from fitting.inference._angle_noise import HARMONICS, TURNS_PER_BLOCK, AngleNoise, profile_at
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import CaseModel, Prediction
from fitting.inference._record import Record, Samples, hermite
from fitting.inference._result import Fit
from fitting.inference._sampled import predicted_samples

Array = NDArray[np.float64]
Random = np.random.Generator

_GAUSS = 3
"""Nodes of the Gauss rule in a cell [1]. Chosen: exact to degree 5; fewer lose accuracy in long cells, more cost
time."""
_PASSES = 8
"""Iterations of a law of an angle that changes its own argument [1]. Chosen: the response is small compared with a
radian; fewer leave an error, more cost time."""
_CELLS_PER_TIME = 5
"""Smallest number of cells of a random torque per correlation time [1]. Chosen: fewer make it a sequence of steps, more
cost time."""
_FEWEST_CELLS = 400
"""Smallest number of cells of a random torque [1]. Chosen: fewer do not resolve the record, more cost time."""
_MOST_CELLS = 40_000
"""Largest number of cells of a random torque [1]. Chosen: a limit of memory; fewer blur short correlation times, more
cost memory."""


def replica(fit: Fit, seed: int | Sequence[int]) -> list[Record]:
    """Return simulated repetitions of the recordings of a fit, with new random errors.

    Parameters
    ----------
    fit : Fit
        The motion and its noise.
    seed : int or sequence of int
        Seed of all random errors.

    Returns
    -------
    list of Record
        One for each case, with the sample times, stated uncertainties and label of the original.

    Raises
    ------
    EstimationError
        The values of a case are a curve that was generated from data, or gradients of filmed angles.
    SimulationError
        The motion with other moments of inertia cannot be integrated.
    """
    random = np.random.default_rng(seed)
    for data in fit.problem.data:
        if data.record.generated or data.record.gradients:
            raise EstimationError(
                f"{data.record.label}: only measured values can be simulated, not curves made from them",
                "fit the case as it was measured, without --data and --rotor",
            )
    return [_recording(_Motion(fit, case, data), random) for case, data in enumerate(fit.problem.data)]


def motion_of(fit: Fit, case: int, times: Array, seed: int | Sequence[int]) -> tuple[Array, Array]:
    """Return the angles of casing and rotor [rad] in a repetition of a recording, without measurement errors.

    Parameters
    ----------
    fit : Fit
        The motion and its random torque.
    case : int
        Index of the recording.
    times : ndarray, shape (n,)
        Times within the recording [s].
    seed : int or sequence of int
        Seed of moments of inertia and random torque.
    """
    random = np.random.default_rng(seed)
    known = fit.problem.data[case]
    first = _Motion(fit, case, known)
    zero = float(np.median(known.record.casing.value - first.expected(known.record.casing.time, rotor=False)))
    angles = [first.expected(times, rotor=False) + zero, first.expected(times, rotor=True)]
    runs = [Samples(times, angle, np.ones(len(times))) for angle in angles]
    motion = _Motion(
        fit, case, replace(known, record=replace(known.record, casing=runs[0], rotor=(runs[1],)))
    )
    changes = [_other_inertias(motion, random), _random_torque(motion, random)]
    changes += [motion.angle_response(effect, zero) for effect in fit.model.angle_dependent]
    casing, rotor = (a + np.sum([c[i] for c in changes], axis=0) for i, a in enumerate(angles))
    return casing, rotor


@dataclass(frozen=True)
class _Motion:
    """The fitted motion of one case."""

    fit: Fit
    case: int
    data: CaseData

    @property
    def prediction(self) -> Prediction:
        return self.fit.predictions[self.case]

    @property
    def numbers(self) -> dict[str, float]:
        return self.fit.problem.layout.numbers(self.fit.theta, self.case)

    def expected(self, times: Array, path: Path | None = None, *, rotor: bool) -> Array:
        """Return angles, up to a constant, or speeds of the smooth motion."""
        path = path or self.prediction.path
        sampler, state = Sampler(path.mesh, times), int(not rotor)
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
        """Return the error of the camera's angle at the samples of a run; of speeds, its derivative."""
        path = self.prediction.path
        sampler, state = Sampler(path.mesh, run.time), int(not rotor)
        psi = value if self.data.is_angle else sampler.integral(*path.angle(path.states[state]))
        known = {"t": run.time - (run.time[0] if rotor else 0.0), "psi": psi}
        known["omega"] = sampler.value(path.y[..., state])
        error = np.asarray(Tape([effect.expression])(self._law(effect) | known)[0]) * np.ones(len(run))
        return error if self.data.is_angle else np.gradient(error, run.time)

    def angle_response(self, effect: Effect, zero: float) -> list[Array]:
        """Return the response of the casing and of each window to a law of the angle, whose initial value is `zero`."""
        record, path, motion = self.data.record, self.prediction.path, self.prediction.motion
        t = record.casing.time
        half = 0.5 * np.diff(t)
        inner = ((t[:-1] + half)[:, None] + half[:, None] * rule(_GAUSS).x).ravel()
        sampler = Sampler(path.mesh, inner)
        known = {name: sampler.value(path.y[..., i]) for i, name in enumerate(path.states[:2])}
        known |= {"delta": known["omega_r"] - known["omega_c"], "t": inner}
        known |= values_at(record.inputs, inner)
        known["psi_r"] = sampler.integral(*path.angle("omega_r"))
        psi = sampler.integral(*path.angle("omega_c")) + (zero if self.data.is_angle else 0.0)
        on_rotor, on_casing = {"rotor": (1, 0), "casing": (0, 1), "bearing": (-1, 1)}[effect.joint]
        direction = np.array([on_rotor / record.I_rotor, on_casing / record.I_casing])
        respond = motion.driven(t, _GAUSS, direction)
        tape, law = Tape([effect.expression]), self._law(effect)
        between = np.repeat(np.arange(len(half)), _GAUSS)
        own = np.zeros(len(inner))
        for _ in range(_PASSES):
            torque = np.asarray(tape(law | known | {"psi_c": psi + own})[0]) * np.ones(len(inner))
            speed, angle = (x[..., 0] for x in respond(torque.reshape(len(half), _GAUSS, 1)))
            own = hermite(t, angle[1], speed[1], inner, interval=between)
        found = [angle[1] if self.data.is_angle else speed[1]]
        for run in record.rotor:
            at = np.clip(run.time, t[0], t[-1])
            found.append(hermite(t, angle[0], speed[0], at, slopes=not self.data.is_angle))
        return found


def _recording(motion: _Motion, random: Random) -> Record:
    data, record = motion.data, motion.data.record
    runs = (record.casing, *record.rotor)
    values = motion.values()
    for changes in (_other_inertias(motion, random), _random_torque(motion, random)):
        values = [v + c for v, c in zip(values, changes, strict=True)]
    starts = (0.0, *(record.start_sigma or (0.0,) * len(record.rotor)))
    for i, (run, compressed, u) in enumerate(zip(runs, (data.casing, *data.rotor), starts, strict=True)):
        values[i] += compressed.scale * run.sigma * random.standard_normal(len(run))
        if u > 0:  # NaN where nothing is stated
            values[i] += (
                u * random.standard_normal() * np.gradient(motion.expected(run.time, rotor=i > 0), run.time)
            )
        if data.is_angle:
            values[i] += _slow_error(run, data.rotor_angle_noise if i else data.angle_noise, random)
    if data.is_angle and data.motion.is_smooth:
        values[0] += _stated_error(data, random)
    amplitudes = random.standard_normal(data.mode_columns[0].shape[1])
    for value, columns in zip(values, (data.mode_columns[0], *data.mode_columns[1]), strict=True):
        value += columns @ amplitudes
    casing, *rotor = (Samples(r.time, v, r.sigma) for r, v in zip(runs, values, strict=True))
    return replace(record, casing=casing, rotor=tuple(rotor), digest="")


def _other_inertias(motion: _Motion, random: Random) -> list[Array]:
    """Return the change of the values by moments of inertia that differ from the stated ones, which the record keeps.

    The torques are those of the fit.
    """
    data, record = motion.data, motion.data.record
    runs = (record.casing, *record.rotor)
    known = {"I_casing": record.I_casing_u, "I_rotor": record.I_rotor_u}
    known = {name: u for name, u in known.items() if math.isfinite(u) and u > 0}
    if not known:
        return [np.zeros(len(run)) for run in runs]
    drawn = {name: getattr(record, name) + u * random.standard_normal() for name, u in known.items()}
    other = replace(record, **drawn)
    layout = motion.fit.problem.layout
    records = [other if i == motion.case else r for i, r in enumerate(layout.records)]
    model = CaseModel(replace(data, record=other), replace(layout, records=tuple(records)), motion.case)
    path = model.solve(motion.fit.theta)
    return [
        motion.expected(run.time, path, rotor=i > 0) - motion.expected(run.time, rotor=i > 0)
        for i, run in enumerate(runs)
    ]


def _random_torque(motion: _Motion, random: Random) -> list[Array]:
    """Return the change of the values by random torques on the casing and between the bodies.

    Their level is the one that the uncertainties of the fit include.
    """
    noise, record = motion.fit.noise[motion.case].with_unresolved, motion.data.record
    runs, level = (record.casing, *record.rotor), noise.level
    if not level > 0:
        return [np.zeros(len(run)) for run in runs]
    first, last = record.span
    cells = np.clip(_CELLS_PER_TIME * (last - first) / noise.time, _FEWEST_CELLS, _MOST_CELLS)
    times = np.linspace(first, last, int(cells) + 1)
    inertia = 1 / record.I_rotor, 1 / record.I_casing
    speed, angle = np.zeros((2, len(times))), np.zeros((2, len(times)))
    for direction in ((0.0, inertia[1]), (-inertia[0], inertia[1])):
        torque = level * _ornstein_uhlenbeck(times[:-1], noise.time, random)
        change = motion.prediction.motion.driven(times, 1, np.array(direction))(torque[:, None, None])
        speed, angle = speed + change[0][..., 0], angle + change[1][..., 0]
    found = []
    for i, run in enumerate(runs):
        state = 0 if i else 1
        found.append(hermite(times, angle[state], speed[state], run.time, slopes=not motion.data.is_angle))
    return found


def _slow_error(run: Samples, noise: AngleNoise, random: Random) -> Array:
    """Return correlated angle noise at a level drawn from its uncertainty, and its part that repeats with the angle."""
    found = np.zeros(len(run))
    if noise.sigma > 0:
        level = abs(random.normal(noise.sigma, noise.sigma_u))
        found += level * _ornstein_uhlenbeck(run.time, noise.time, random)
    if noise.turn_sigma > 0:
        level = abs(random.normal(noise.turn_sigma, noise.turn_sigma_u))
        for wave in (np.cos, np.sin):
            found += level * wave(run.value) * _ornstein_uhlenbeck(run.time, noise.turn_time, random)
    return found


def _stated_error(data: CaseData, random: Random) -> Array:
    """Return the errors of the casing's angles that tracking states (see `stated_error_rows`)."""
    run = data.record.casing
    sigma, time, periodic, harmonic = data.record.correlated
    found = np.zeros(len(run))
    if sigma > 0:
        size = profile_at(run.time, sigma, data.record.correlated_profile)
        found += size * _ornstein_uhlenbeck(run.time, time, random)
    for where, _ in data.casing.operators if periodic > 0 or harmonic > 0 else ():
        psi = run.value[where]
        few = np.ptp(psi) < TURNS_PER_BLOCK * 2 * np.pi
        slow = math.hypot(harmonic, periodic if few else 0.0)
        amplitudes = dict.fromkeys(HARMONICS, harmonic) | {1: slow, 2: slow}
        for order, amplitude in amplitudes.items():
            a, b = amplitude * random.standard_normal(2)
            found[where] += a * np.cos(order * psi) + b * np.sin(order * psi)
    return found


def _ornstein_uhlenbeck(times: Array, time: float, random: Random) -> Array:
    """Return a stationary Ornstein-Uhlenbeck process of standard deviation 1 at increasing times."""
    decay = np.exp(-np.diff(times) / time)
    steps = np.sqrt(1 - decay**2) * random.standard_normal(len(decay))
    value = random.standard_normal()
    found = np.empty(len(times))
    for i in range(len(times)):
        found[i] = value
        if i < len(decay):
            value = decay[i] * value + steps[i]
    return found
