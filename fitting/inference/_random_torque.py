"""The most likely slow random torque in the residuals of a fit.

The process noise of a recording is measured without a model, in short stretches, in each of which a polynomial follows
any slow motion. A random torque that is slower than these stretches counts as motion and is not measured. Therefore its
level s and its correlation time T are free here. T is between `Criteria.random_torque_shortest` and
`Criteria.random_torque_longest`; s is at most the share `Criteria.random_torque` of the mean torque. To first order the
deviance is

    D = min over s, T of  log det C + min over x of (r - J x)' C^-1 (r - J x),

with the covariance C(s, T) of the whitened rows, the residuals r and the free columns J.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._level_profile import LevelProfile, least_between, scaled_columns
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse
from fitting.inference._problem import Problem

Array = NDArray[np.float64]

_TIMES = 8
"""Number of trial correlation times of a random torque [1]. Chosen: a smaller number overlooks the maximum of the
likelihood, a larger one costs time."""
_LEVELS = 16
"""Number of trial levels of a random torque [1]. Chosen: a smaller number overlooks the maximum of the likelihood, a
larger one costs time."""
_FEWEST_TIMES = 6.0
"""Smallest ratio of the length of a record to the correlation time of the random torque [1]. Chosen: with a smaller
value the torque is a trend, which absorbs any effect; with a larger one, slow torques are not tried."""
_LOWEST = 1e-3
"""Lowest trial level, as a share of the highest allowed level [1]. Chosen: a smaller level cannot be distinguished from
zero; with a larger one, the gap between zero and the lowest trial is too large."""


@dataclass(frozen=True)
class LikelyNoise:
    """The noise of each case with the most likely random torque of any level and correlation time."""

    noise: tuple[Noise, ...]
    deviance: float
    mean_torque: float  # mean absolute torque of the case with the largest random torque [N m]

    @property
    def is_raised(self) -> bool:
        """Whether the random torque of a case exceeds the process noise that its recording shows without a model."""
        return any(n.raised for n in self.noise)

    def describes(self, rows: int, criteria: Criteria) -> bool:
        """Return whether the residuals of `rows` rows are consistent with this noise.

        The reduced chi-square must be below `Criteria.reduced_chi2`.
        """
        logs = sum(n.whitener.log_determinant for n in self.noise)
        return (self.deviance - logs) < criteria.reduced_chi2 * rows


def most_likely_noise(
    problem: Problem,
    predictions: Sequence[Prediction],
    noise: Sequence[Noise],
    theta: Array,
    deviance: float,
    criteria: Criteria,
) -> LikelyNoise:
    """Return the noise with the most likely random torque of each case, or the given noise if its deviance is lower."""
    found: list[tuple[Noise, float]] = []
    moving = ~problem.layout.at_bound(theta)
    for i, (data, p, n) in enumerate(zip(problem.data, predictions, noise, strict=True)):
        columns = np.concatenate([p.columns[:, moving[p.places]], data.nuisance], axis=1)
        torque = mean_torque(problem, predictions, theta, i)
        found.append((_most_likely(data, p, columns, n, criteria.random_torque * torque, criteria), torque))
    noises = tuple(n for n, _ in found)
    least = _deviance(problem, predictions, noises, moving)
    if least >= deviance:
        least, noises = deviance, tuple(noise)
    largest = int(np.argmax([n.level for n in noises]))
    return LikelyNoise(noises, least, found[largest][1])


def mean_torque(problem: Problem, predictions: Sequence[Prediction], theta: Array, case: int) -> float:
    """Return the mean absolute net torque along the fitted motion, on the body where it is largest [N m]."""
    model, prediction = problem.cases[case], predictions[case]
    numbers = problem.layout.numbers(theta, case)
    path, record = prediction.path, problem.data[case].record
    rates = (
        np.abs(model.dynamics.rates(path.mesh.times, path.y, numbers))
        .reshape(-1, path.y.shape[-1])
        .mean(axis=0)
    )
    return float(max(b.inertia * rates[b.state] for b in record.bodies))


def _most_likely(
    data: CaseData, prediction: Prediction, columns: Array, noise: Noise, ceiling: float, criteria: Criteria
) -> Noise:
    """Return the noise of one case with the most likely random torque whose rms is at most `ceiling` [N m]."""
    first, last = data.record.span
    longest = min(criteria.random_torque_longest, (last - first) / _FEWEST_TIMES)
    times = np.geomspace(min(criteria.random_torque_shortest, longest), longest, _TIMES)
    levels = np.geomspace(_LOWEST, 1.0, _LEVELS) * ceiling
    response = TorqueResponse(data, prediction.motion)
    both = scaled_columns(columns, data.z - prediction.rows)
    # the level of the fit, at the correlation time of the recording, is always one of the alternatives
    own = noise.at(min(noise.level, ceiling))
    if not ceiling > 0:
        return own
    best = (LevelProfile(own.whitener, both)(own.level), own)

    def at(log_time: float) -> float:
        nonlocal best
        time = float(np.exp(log_time))
        whitener = response.whitener(TorqueNoise(0.0, time))
        level, deviance = LevelProfile(whitener, both).least(levels)
        if deviance < best[0]:
            pure = min(noise.pure, level)
            best = (
                deviance,
                replace(noise, pure=pure, level=level, time=time, whitener=whitener.at(level)),
            )
        return deviance

    k = int(np.argmin([at(float(np.log(t))) for t in times]))
    bounds = times[max(k - 1, 0)], times[min(k + 1, _TIMES - 1)]
    if bounds[1] > bounds[0]:
        least_between(at, *np.log(bounds))
    return best[1]


def _deviance(
    problem: Problem, predictions: Sequence[Prediction], noises: Sequence[Noise], moving: NDArray[np.bool_]
) -> float:
    """Return the deviance of all cases with the given noise, to first order in the parameters."""
    r, j = problem.with_noise(noises).residuals(predictions)
    size = np.linalg.norm(j, axis=0)
    used = moving & (size > 0)
    both = np.concatenate([j[:, used] / size[used], r[:, None]], axis=1)
    least = np.abs(np.diag(np.linalg.qr(both, mode="r")))[-1]
    return float(least**2) + sum(n.whitener.log_determinant for n in noises)
