"""New recordings of a fitted motion: the same bodies, samples and windows, with new random errors.

The expected values are the values of the fit at every sample, with the fitted initial angles, camera errors, laws of an
angle and measurement effects. The random errors have the distributions that the fit assumes (a parametric bootstrap; A.
C. Davison, D. V. Hinkley, Bootstrap Methods and their Application, 1997, ch. 4). They are white noise at the measured
level, correlated angle noise at a level drawn from its distribution, the random torque in the residuals of the fit, and
the errors that tracking states. Errors of the starts of the windows and of the stated moments of inertia are drawn from
their standard uncertainties.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EstimationError
from fitting.effects._mechanism import MAIN
from fitting.inference._angle_noise import HARMONICS, TURNS_PER_BLOCK, AngleNoise, profile_at
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import CaseModel
from fitting.inference._compression import Compressed
from fitting.inference._record import Record, Samples, hermite
from fitting.inference._result import Fit
from fitting.inference._sampled import FittedMotion

Array = NDArray[np.float64]
Random = np.random.Generator

_CELLS_PER_TIME = 5
"""Smallest number of cells of a random torque per correlation time [1]. Chosen: a smaller number gives a series of
steps, a larger one costs time."""
_FEWEST_CELLS = 400
"""Smallest number of cells of a random torque [1]. Chosen: a smaller number does not resolve the record, a larger one
costs time."""
_MOST_CELLS = 40_000
"""Largest number of cells of a random torque [1]. Chosen: a limit of memory; a smaller number blurs short correlation
times, a larger one costs memory."""


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
        The values of a case are not measured: a curve generated from data, or gradients of filmed angles.
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
    return [_recording(FittedMotion(fit, case, data), random) for case, data in enumerate(fit.problem.data)]


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
    first = FittedMotion(fit, case, known)
    zero = float(np.median(known.record.casing.value - first.expected(known.record.casing.time, rotor=False)))
    angles = [first.expected(times, rotor=False) + zero, first.expected(times, rotor=True)]
    runs = [Samples(times, angle, np.ones(len(times))) for angle in angles]
    motion = FittedMotion(
        fit, case, replace(known, record=replace(known.record, casing=runs[0], rotor=(runs[1],)))
    )
    changes = [_other_inertias(motion, random), _random_torque(motion, random)]
    changes += [motion.angle_response(effect, zero) for effect in fit.model.angle_dependent]
    casing, rotor = (a + np.sum([c[i] for c in changes], axis=0) for i, a in enumerate(angles))
    return casing, rotor


def _recording(motion: FittedMotion, random: Random) -> Record:
    data, record = motion.data, motion.data.record
    runs = (record.casing, *record.rotor)
    values = motion.values()
    for changes in (_other_inertias(motion, random), _random_torque(motion, random)):
        values = [v + c for v, c in zip(values, changes, strict=True)]
    starts = (0.0, *(record.start_sigma or (0.0,) * len(record.rotor)))
    for i, (run, compressed, u) in enumerate(zip(runs, (data.casing, *data.rotor), starts, strict=True)):
        values[i] += compressed.scale * run.sigma * random.standard_normal(len(run))
        if u > 0:  # NaN if no uncertainty is stated
            values[i] += (
                u
                * random.standard_normal()
                * np.gradient(motion.expected_of(_state(i, run), run.time), run.time)
            )
        if data.is_angle:
            values[i] += _slow_error(run, data.rotor_angle_noise if i else data.angle_noise, random)
    if data.is_angle and data.motion.is_smooth:
        values[0] += _stated_error(data, random)
        for value, of_rotor in zip(values[1:], data.rotor, strict=True):
            value += _harmonics(of_rotor, of_rotor.samples.harmonic, random)
    amplitudes = random.standard_normal(data.mode_columns[0].shape[1])
    for value, columns in zip(values, (data.mode_columns[0], *data.mode_columns[1]), strict=True):
        value += columns @ amplitudes
    casing, *rotor = (replace(r, value=v) for r, v in zip(runs, values, strict=True))
    return replace(record, casing=casing, rotor=tuple(rotor), digest="")


def _other_inertias(motion: FittedMotion, random: Random) -> list[Array]:
    """Return the change of the values due to random errors of the stated moments of inertia.

    The torques are the torques of the fit. The record contains the stated moments of inertia.
    """
    data, record = motion.data, motion.data.record
    runs = (record.casing, *record.rotor)
    known = {"I_casing": record.I_casing_u, "I_rotor": record.I_rotor_u}
    known = {name: u for name, u in known.items() if math.isfinite(u) and u > 0}
    drawn: dict[str, Any] = {
        name: getattr(record, name) + u * random.standard_normal() for name, u in known.items()
    }
    if any(u > 0 for _, u in record.further):
        drawn["further"] = tuple(
            (value + (u * random.standard_normal() if u > 0 else 0.0), u) for value, u in record.further
        )
    if not drawn:
        return [np.zeros(len(run)) for run in runs]
    other = replace(record, **drawn)
    layout = motion.fit.problem.layout
    records = [other if i == motion.case else r for i, r in enumerate(layout.records)]
    model = CaseModel(replace(data, record=other), replace(layout, records=tuple(records)), motion.case)
    path = model.solve(motion.fit.theta)
    return [
        motion.expected_of(_state(i, run), run.time, path) - motion.expected_of(_state(i, run), run.time)
        for i, run in enumerate(runs)
    ]


def _random_torque(motion: FittedMotion, random: Random) -> list[Array]:
    """Return the change of the values due to random torques on the casing and between the bodies.

    The level of the torques is the level that the uncertainties of the fit include.
    """
    noise, record = motion.fit.noise[motion.case].with_unresolved, motion.data.record
    runs, level = (record.casing, *record.rotor), noise.level
    if not level > 0:
        return [np.zeros(len(run)) for run in runs]
    first, last = record.span
    cells = np.clip(_CELLS_PER_TIME * (last - first) / noise.time, _FEWEST_CELLS, _MOST_CELLS)
    times = np.linspace(first, last, int(cells) + 1)
    mechanism, inertias = record.mechanism, np.array(record.inertias)
    speed, angle = np.zeros((2, len(inertias), len(times)))
    for site in (mechanism.main, *mechanism.joints):
        torque = level * _ornstein_uhlenbeck(times[:-1], noise.time, random)
        direction = np.array(mechanism.shares(site)) / inertias
        change = motion.prediction.motion.driven(times, 1, direction)(torque[:, None, None])
        speed, angle = speed + change[0][..., 0], angle + change[1][..., 0]
    found = []
    for i, run in enumerate(runs):
        state = _state(i, run)
        found.append(hermite(times, angle[state], speed[state], run.time, slopes=not motion.data.is_angle))
    return found


def _state(number: int, run: Samples) -> int:
    """Return the index in the state of the body of a run; the first run belongs to the main body."""
    return run.state if number else MAIN


def _slow_error(run: Samples, noise: AngleNoise, random: Random) -> Array:
    """Return correlated angle noise at a level drawn from its uncertainty, with its part periodic in the angle."""
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
    return found + _harmonics(data.casing, harmonic, random, periodic)


def _harmonics(run: Compressed, harmonic: float, random: Random, periodic: float = 0.0) -> Array:
    """Return harmonics of the angle with amplitudes that are independent in each block.

    The standard deviation of the amplitudes is `harmonic`; in blocks of few turns, the amplitudes of orders 1 and 2
    contain `periodic` as well.
    """
    found = np.zeros(len(run.samples))
    for where, _ in run.operators if periodic > 0 or harmonic > 0 else ():
        psi = run.samples.value[where]
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
