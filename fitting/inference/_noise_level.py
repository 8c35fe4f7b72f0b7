"""Noise levels of the cases of a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse, estimate_noise, remaining_level
from fitting.inference._problem import Problem

Array = NDArray[np.float64]

_FIRST_LEVEL = 0.01


def first_noise(problem: Problem, theta: Array) -> tuple[Noise, ...]:
    """Return a cautious noise to begin with: a hundredth of the bearing's torque."""
    found = []
    predictions = problem.predict(theta)
    for case, p, level in zip(problem.cases, predictions, _first_levels(problem, theta), strict=True):
        response = TorqueResponse(case.data, p.motion)
        time = response.default_time
        whitener = response.whitener(TorqueNoise(level, time))
        found.append(Noise(case.data.casing.scale, level, level, time, whitener))
    return tuple(found)


def raised_noise(problem: Problem, theta: Array, noise: Sequence[Noise]) -> tuple[Noise, ...]:
    """Return a known noise raised to the level of `first_noise`, for a search that begins far away."""
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
    """Measure the pure noise of each case about a fitted model, and what the model leaves."""
    predictions = problem.predict(theta)
    responses = [TorqueResponse(d, p.motion) for d, p in zip(problem.data, predictions, strict=True)]
    residuals = [d.z - p.rows for d, p in zip(problem.data, predictions, strict=True)]
    found = [
        Noise(d.casing.scale, pure.rms, pure.rms, pure.time, response.whitener(pure))
        for d, response, pure in zip(
            problem.data, responses, estimate_noise(responses, residuals), strict=True
        )
    ]
    return refine_level(problem, theta, found)


def refine_level(
    problem: Problem, theta: Array, noise: Sequence[Noise], *, settled: bool = False
) -> tuple[Noise, ...]:
    """Return the noise with the level that the model at these variables leaves.

    Each case is asked for itself, its variables free to follow; if `settled`, they stand where they are: cases that
    share a variable may each want it elsewhere.
    """
    found = []
    moving = ~problem.layout.at_bound(theta) & (not settled)
    for data, p, n in zip(problem.data, problem.predict(theta), noise, strict=True):
        columns = np.concatenate([p.columns[:, moving[p.places]], data.nuisance], axis=1)
        level, excess = remaining_level(n.whitener, data.z - p.rows, columns, n.pure)
        found.append(Noise(n.scale, n.pure, level, n.time, n.whitener.at(level), excess))
    return tuple(found)
