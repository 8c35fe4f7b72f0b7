"""A slow random torque as the alternative to every answer.

The process noise of a recording is measured without a model, in short stretches whose fit follows any slow motion.
A random torque that is slower than these stretches counts as motion and is not measured. Therefore its level s and its
correlation time T are free here. T is between `Criteria.random_torque_shortest` and `Criteria.random_torque_longest`; s
is at most the share `Criteria.random_torque` of the mean torque. To first order the deviance is

    D = min over s, T of  log det C + min over x of (r - J x)' C^-1 (r - J x),

with the covariance C(s, T) of the whitened rows, the residuals r and the free columns J.

The random torque is free in the fit without an effect (D0) and in the fit with the effect (D1). The effect is
established if it is significant with any random torque: D0 - D1 exceeds the penalty of BIC, and the p-value for the
whole list of effects is below the significance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting._numbers import percentage
from fitting.discovery._residuals import format_torque
from fitting.discovery._score import RANK, NullDistribution, Score
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._level_profile import LevelProfile, least_between, scaled_columns
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse
from fitting.inference._result import Fit

Array = NDArray[np.float64]

_TIMES = 8
"""Trial correlation times of a random torque [1]. Chosen: fewer overlook the maximum of the likelihood, more cost
time."""
_LEVELS = 16
"""Trial levels of a random torque [1]. Chosen: fewer overlook the maximum of the likelihood, more cost time."""
_FEWEST_TIMES = 6.0
"""Smallest length of a record, divided by the correlation time of the random torque [1]. Chosen: at a smaller value the
torque is a trend, which absorbs any effect; a larger value leaves slow torques untried."""
_CERTAIN = 3.0
"""Inflation of the deviance above which the inflation need not be simulated [1]. Measured: the inflation in all
simulated recordings is 1.0 to 1.8."""
_SEED = 11
"""Seed of the simulated recordings [1]. Chosen: any value makes the verdict reproducible; another one changes the
inflation within its error."""
_DRAWS = 200
"""Simulated recordings of one inflation [1]. Chosen: fewer make the inflation uncertain, more cost time."""
_RANGE = 4.0
"""Largest ratio of trial times and levels to the true values, and of the true to the trial values [1]. Chosen: a
smaller value understates the inflation, a larger one spreads the trials too far."""
_NEAR_TIMES = 7
"""Trial correlation times of a simulated recording [1]. Chosen: fewer understate the inflation, more cost time."""
_NEAR_LEVELS = 11
"""Trial levels of a simulated recording [1]. Chosen: fewer understate the inflation, more cost time."""
_LOWEST = 1e-3
"""Lowest trial level, as a share of the ceiling [1]. Chosen: a smaller level cannot be distinguished from zero, a
larger one leaves a gap above zero."""


@dataclass(frozen=True)
class RandomTorque:
    """A fit with the most likely random torque of any level and correlation time, one for each case."""

    fit: Fit
    deviance: float
    mean_torque: float  # mean absolute torque of the case with the largest random torque [N m]

    @property
    def noise(self) -> Noise:
        """The noise of the case with the largest random torque."""
        return max(self.fit.noise, key=lambda n: n.level)

    @property
    def words(self) -> str:
        """Level, share of the mean torque, and correlation time, in words."""
        noise = self.noise
        size = format_torque(noise.level, unit=self.fit.torque_unit)
        # a model whose strengths are all zero has no torque
        share = (
            f" ({percentage(noise.level / self.mean_torque)} of the mean torque)" if self.mean_torque else ""
        )
        return f"a random torque of {size} rms{share} with a correlation time of {noise.time:.2g} s"

    @cached_property
    def is_raised(self) -> bool:
        """Whether the random torque exceeds the process noise that a recording shows without a model."""
        return any(n.raised for n in self.fit.noise)


def with_random_torque(fit: Fit, criteria: Criteria) -> RandomTorque:
    """Return a fit with the most likely random torque of each case, if that lowers the deviance."""
    found: list[tuple[Noise, float]] = []
    moving = ~fit.problem.layout.at_bound(fit.theta)
    for i, (data, p, noise) in enumerate(zip(fit.problem.data, fit.predictions, fit.noise, strict=True)):
        columns = np.concatenate([p.columns[:, moving[p.places]], data.nuisance], axis=1)
        torque = mean_torque(fit, i)
        found.append(
            (_most_likely(data, p, columns, noise, criteria.random_torque * torque, criteria), torque)
        )
    noises = tuple(n for n, _ in found)
    deviance = _deviance(fit, noises, moving)
    if deviance >= fit.deviance:
        deviance, noises = fit.deviance, fit.noise
    largest = int(np.argmax([n.level for n in noises]))
    return RandomTorque(replace(fit, noise=noises, deviance=deviance), deviance, found[largest][1])


def mean_torque(fit: Fit, case: int) -> float:
    """Return the mean absolute net torque along the fitted motion, of the body with the largest one [N m]."""
    model, prediction = fit.problem.cases[case], fit.predictions[case]
    numbers = fit.problem.layout.numbers(fit.theta, case)
    path, record = prediction.path, fit.problem.data[case].record
    rates = (
        np.abs(model.dynamics.rates(path.mesh.times, path.y, numbers))
        .reshape(-1, path.y.shape[-1])
        .mean(axis=0)
    )
    return float(max(b.inertia * rates[b.state] for b in record.bodies))


def _most_likely(
    data: CaseData, prediction: Prediction, columns: Array, noise: Noise, ceiling: float, criteria: Criteria
) -> Noise:
    """Return the noise of one case with the most likely random torque up to a ceiling [N m]."""
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


def _deviance(fit: Fit, noises: Sequence[Noise], moving: NDArray[np.bool_]) -> float:
    """Return the deviance of all cases with the given noise, to first order in the parameters."""
    r, j = fit.problem.with_noise(noises).residuals(fit.predictions)
    size = np.linalg.norm(j, axis=0)
    used = moving & (size > 0)
    both = np.concatenate([j[:, used] / size[used], r[:, None]], axis=1)
    least = np.abs(np.diag(np.linalg.qr(both, mode="r")))[-1]
    return float(least**2) + sum(n.whitener.log_determinant for n in noises)


def is_established(
    without: RandomTorque, screened: Score, named: Fit, tests: int, criteria: Criteria
) -> bool:
    """Return whether a fit with an effect describes the data better than any random torque without the effect.

    `named` is the fit with the effect, `screened` is the score of the effect, `tests` is the number of tried effects.
    """
    more = len(named.theta) - len(without.fit.theta)

    def passes(fall: float, factor: float) -> bool:
        p_value = min(1.0, tests * NullDistribution(screened).at_one_level(fall / factor))
        enough = more * float(np.log(named.rows)) + criteria.evidence
        return fall / factor > enough and p_value < criteria.significance

    # a random torque in addition to the effect only increases the fall
    if more > 0 and passes(without.deviance - named.deviance, _CERTAIN):
        return True
    fall = without.deviance - with_random_torque(named, criteria).deviance
    if more < 1:
        return fall > criteria.evidence
    if not passes(fall, 1.0):
        return False
    return passes(fall, _CERTAIN) or passes(fall, inflation(without, named, criteria))


def inflation(without: RandomTorque, named: Fit, criteria: Criteria) -> float:
    """Return the Bartlett factor of the fall of the deviance due to an effect, at least 1.

    Level and correlation time of the random torque are optimised without and with the effect. The fall under the null
    hypothesis is therefore larger than a chi-square with the same number of columns. Its mean is simulated to first
    order from the most likely random torque of the fit without the effect. The factor is this mean divided by the
    number of columns; the fall is divided by the factor (M. S. Bartlett, Proc. R. Soc. A 160, 268 (1937)). With several
    cases, the largest factor counts.
    """
    old = set(without.fit.problem.layout.names)
    added = np.array([n not in old for n in named.problem.layout.names])
    moving = ~named.problem.layout.at_bound(named.theta)
    random = np.random.default_rng(_SEED)
    ratios = [1.0]
    for data, p, noise in zip(named.problem.data, named.predictions, without.fit.noise, strict=True):
        effect, base = added[p.places], moving[p.places]
        free = np.concatenate([p.columns[:, base & ~effect], data.nuisance], axis=1)
        columns = p.columns[:, base & effect]
        if noise.level > 0 and columns.any():
            ratios.append(_mean_fall(data, p, free, columns, noise, criteria, random))
    return max(ratios)


def _mean_fall(
    data: CaseData,
    prediction: Prediction,
    free: Array,
    columns: Array,
    noise: Noise,
    criteria: Criteria,
    random: np.random.Generator,
) -> float:
    """Return the mean fall of the deviance per added column in `_DRAWS` simulations of the rows of one case."""
    draws = noise.whitener.coloured(random.standard_normal((len(data.z), _DRAWS)))
    response = TorqueResponse(data, prediction.motion)
    times = noise.time * np.geomspace(1 / _RANGE, _RANGE, _NEAR_TIMES)
    inside = (times >= criteria.random_torque_shortest) & (times <= criteria.random_torque_longest)
    levels = noise.level * np.geomspace(1 / _RANGE, _RANGE, _NEAR_LEVELS)
    least = np.full((2, _DRAWS), np.inf)
    rank = 0
    for time in (noise.time, *times[inside]):
        axes = response.whitener(TorqueNoise(0.0, float(time)))
        for level in levels:
            whitener = axes.at(float(level))
            basis = orthonormal(whitener(free), RANK)
            more = orthonormal(orthogonal_to(basis, whitener(columns)), RANK)
            rest = orthogonal_to(basis, whitener(draws))
            without = whitener.log_determinant + np.sum(rest**2, axis=0)
            least = np.minimum(least, [without, without - np.sum((more.T @ rest) ** 2, axis=0)])
            rank = more.shape[1]
    return float(np.mean(least[0] - least[1])) / max(rank, 1)


def describes(without: RandomTorque, criteria: Criteria) -> bool:
    """Return whether the residuals of a fit are consistent with noise at the most likely random torque.

    The reduced chi-square must be below `Criteria.reduced_chi2`.
    """
    logs = sum(n.whitener.log_determinant for n in without.fit.noise)
    return (without.deviance - logs) < criteria.reduced_chi2 * without.fit.rows
