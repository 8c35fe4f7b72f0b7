"""Noise of the cases of a fit: that of each recording, and the random torque in the residuals of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse, remaining_level
from fitting.inference._problem import Problem

Array = NDArray[np.float64]

_FIRST_LEVEL = 0.01
# chi2 per row above which the residuals of an oscillation are no random torque: an error of ten standard deviations
_GROSS_MISFIT = 100.0
# correlation time over the length of the record: a slower torque would absorb the error of the initial values
_FIRST_TIME = 1 / 200


def recording_noise(data: CaseData, prediction: Prediction) -> Noise:
    """Return the noise of a recording, with the response of its rows linearised about a prediction.

    The random torques on the casing and between the bodies have the same rms; their sum accelerates the casing.
    """
    process = data.process_noise
    torque = data.record.I_casing / float(np.sqrt(2))
    pure = TorqueNoise(torque * process.level, process.time)
    whitener = TorqueResponse(data, prediction.motion).whitener(pure)
    return Noise(
        data.casing.scale, pure.rms, torque * process.level_u, pure.rms, pure.time, whitener, process
    )


def first_noise(problem: Problem, theta: Array) -> tuple[Noise, ...]:
    """Return the noise of a first search: a random torque of a hundredth of that on the rotor."""
    found = []
    predictions = problem.predict(theta)
    for case, p, level in zip(problem.cases, predictions, _first_levels(problem, theta), strict=True):
        first, last = case.data.record.span
        time = _FIRST_TIME * (last - first)
        whitener = TorqueResponse(case.data, p.motion).whitener(TorqueNoise(level, time))
        process = case.data.process_noise
        found.append(Noise(case.data.casing.scale, level, 0.0, level, time, whitener, process))
    return tuple(found)


def raised_noise(problem: Problem, theta: Array, noise: Sequence[Noise]) -> tuple[Noise, ...]:
    """Return a known noise raised to the level of `first_noise`, for a search that starts far from the minimum."""
    levels = _first_levels(problem, theta)
    return tuple(n.at(max(n.level, level)) for n, level in zip(noise, levels, strict=True))


def _first_levels(problem: Problem, theta: Array) -> list[float]:
    levels = []
    for case, p in zip(problem.cases, problem.predict(theta), strict=True):
        numbers = problem.layout.numbers(theta, case.case)
        rates = np.abs(case.dynamics.rates(p.path.mesh.times, p.path.y, numbers))
        levels.append(_FIRST_LEVEL * case.data.record.I_rotor * float(np.median(rates[..., 0])))
    return levels


def measure_noise(problem: Problem, theta: Array) -> tuple[Noise, ...]:
    """Return the noise of each case about a fitted model, with the level of its residuals."""
    found = [recording_noise(d, p) for d, p in zip(problem.data, problem.predict(theta), strict=True)]
    return refine_level(problem, theta, found)


def fails_grossly(data: CaseData, prediction: Prediction, noise: Noise) -> bool:
    """Return whether the residuals of a model of an oscillation are far too large for a random torque."""
    if data.oscillation is None or data.oscillation.slow_motion is None:
        return False
    whitener = noise.at(noise.pure).whitener
    columns = whitener(np.concatenate([prediction.columns, data.nuisance], axis=1))
    residual = whitener(data.z - prediction.rows)
    residual = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
    return float(residual @ residual) > _GROSS_MISFIT * len(residual)


def refine_level(
    problem: Problem, theta: Array, noise: Sequence[Noise], *, fixed: bool = False
) -> tuple[Noise, ...]:
    """Return the noise with the level of the residuals of the model at these variables.

    The level of each case is estimated separately, with its variables free, or with `fixed` ones: cases that share a
    variable may have different optima of it.

    A model of an oscillation that fails grossly keeps the level of the recording: at the level of its residuals the
    phase would be random, and the period, which is known best, would have no weight (measured: the torque of a pendulum
    6 % too small). The uncertainties are scaled by the residuals instead.
    """
    found = []
    moving = ~problem.layout.at_bound(theta) & (not fixed)
    restoring = problem.layout.model.restoring
    for data, p, n in zip(problem.data, problem.predict(theta), noise, strict=True):
        columns = np.concatenate([p.columns[:, moving[p.places]], data.nuisance], axis=1)
        level, excess = remaining_level(n.whitener, data.z - p.rows, columns)
        grossly = restoring and fails_grossly(data, p, n)
        found.append(replace(n.at(n.pure if grossly else level), excess=excess))
    return tuple(found)
