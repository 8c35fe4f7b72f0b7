"""A slow random torque as the alternative to a named effect.

The level and the correlation time of the random torque (`fitting.inference._random_torque`) are free in two fits: one
without the effect (deviance D0) and one with the effect (D1). The effect is established if D0 - D1 exceeds the penalty
of BIC, and if the p-value for the whole list of effects is below the significance level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting._numbers import format_torque, percentage
from fitting.discovery._score import RANK, NullDistribution, Score
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse
from fitting.inference._random_torque import LikelyNoise, most_likely_noise
from fitting.inference._result import Fit

Array = NDArray[np.float64]

_CERTAIN = 3.0
"""Largest plausible inflation (see `inflation`); an effect that is significant with this inflation needs no simulation
[1]. Measured: the inflation in all simulated recordings is 1.0 to 1.8."""
_SEED = 11
"""Seed of the simulated recordings [1]. Chosen: any value makes the verdict reproducible; another seed changes the
inflation within its error."""
_DRAWS = 200
"""Number of simulated recordings for one inflation [1]. Chosen: a smaller number makes the inflation uncertain, a
larger one costs time."""
_RANGE = 4.0
"""Factor by which the trial times and levels reach above and below the true values [1]. Chosen: a smaller value
understates the inflation, a larger one spreads the trials too far."""
_NEAR_TIMES = 7
"""Number of trial correlation times of a simulated recording [1]. Chosen: a smaller number understates the inflation, a
larger one costs time."""
_NEAR_LEVELS = 11
"""Number of trial levels of a simulated recording [1]. Chosen: a smaller number understates the inflation, a larger one
costs time."""


@dataclass(frozen=True)
class RandomTorque:
    """A fit with the most likely random torque of each case, at any level and correlation time."""

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

    @property
    def likely(self) -> LikelyNoise:
        """Noise, deviance and mean torque, without the fit."""
        return LikelyNoise(self.fit.noise, self.deviance, self.mean_torque)

    @property
    def is_raised(self) -> bool:
        """Whether the random torque exceeds the process noise that the recording of any case shows without a model."""
        return self.likely.is_raised


def with_random_torque(fit: Fit, criteria: Criteria) -> RandomTorque:
    """Return a fit with the most likely random torque of each case, if that lowers the deviance."""
    likely = most_likely_noise(fit.problem, fit.predictions, fit.noise, fit.theta, fit.deviance, criteria)
    found = replace(fit, noise=likely.noise, deviance=likely.deviance)
    return RandomTorque(found, likely.deviance, likely.mean_torque)


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

    # with a random torque beside the effect, the fall could only be larger, so this fit is not needed
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

    Level and correlation time of the random torque are optimised both without and with the effect. Under the null
    hypothesis the fall is therefore larger, on average, than chi-square with one degree of freedom per added column.
    The mean fall is simulated to first order from the most likely random torque of the fit without the effect. The
    factor is the mean fall per column; an observed fall is divided by the factor (M. S. Bartlett, Proc. R. Soc. A 160,
    268 (1937)). With several cases, the largest factor counts.
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
    """Return whether the residuals of a fit are consistent with noise at the most likely random torque."""
    return without.likely.describes(without.fit.rows, criteria)
