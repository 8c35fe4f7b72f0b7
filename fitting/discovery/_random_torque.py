"""A slow random torque as the alternative to every answer.

The process noise of a recording is measured without a model, in stretches of time that follow any slow motion; a random
torque that is slower than these stretches is part of the motion there and is not seen. So its level and its correlation
time T are free here, from `Criteria.random_torque_shortest` to `Criteria.random_torque_longest`, and the level has a
ceiling, the share `Criteria.random_torque` of the mean torque. With the covariance C(s, T) of the whitened rows, the
residuals r and the free columns J, to first order,

    D = min over s, T of  log det C + min over x of (r - J x)' C^-1 (r - J x).

The same alternative is granted to the fit without an effect (D0) and to the fit with it (D1). The effect is established
if it is significant beside any random torque: D0 - D1 passes BIC, and its p-value the significance for the whole list.
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
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse, Whitener
from fitting.inference._result import Fit

Array = NDArray[np.float64]

_TIMES, _LEVELS = 8, 16
# correlation times in the shortest record of which at least this number passes
_FEWEST_TIMES = 6.0
# lowest level, as a share of the ceiling
_LOWEST = 1e-3


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
        """Its size and its correlation time."""
        noise = self.noise
        size = format_torque(noise.level, unit=self.fit.torque_unit)
        # a model whose strengths are all zero has no torque
        share = (
            f" ({percentage(noise.level / self.mean_torque)} of the mean torque)" if self.mean_torque else ""
        )
        return f"a random torque of {size} rms{share} with a correlation time of {noise.time:.2g} s"

    @cached_property
    def is_raised(self) -> bool:
        """Whether it is larger than the process noise that the recordings show without a model."""
        return any(n.raised for n in self.fit.noise)


def with_random_torque(fit: Fit, criteria: Criteria) -> RandomTorque:
    """Return a fit with the most likely random torque of each case."""
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
    """Return the mean absolute torque on the bodies of a case along the fitted motion, the larger of both [N m]."""
    model, prediction = fit.problem.cases[case], fit.predictions[case]
    numbers = fit.problem.layout.numbers(fit.theta, case)
    path, record = prediction.path, fit.problem.data[case].record
    rates = (
        np.abs(model.dynamics.rates(path.mesh.times, path.y, numbers))
        .reshape(-1, path.y.shape[-1])
        .mean(axis=0)
    )
    return float(max(record.I_casing * rates[1], 0.0 if record.single else record.I_rotor * rates[0]))


def _most_likely(
    data: CaseData, prediction: Prediction, columns: Array, noise: Noise, ceiling: float, criteria: Criteria
) -> Noise:
    """Return the noise of one case with the most likely random torque up to a ceiling [N m]."""
    first, last = data.record.span
    longest = min(criteria.random_torque_longest, (last - first) / _FEWEST_TIMES)
    times = np.geomspace(min(criteria.random_torque_shortest, longest), longest, _TIMES)
    levels = np.geomspace(_LOWEST, 1.0, _LEVELS) * ceiling
    response = TorqueResponse(data, prediction.motion)
    both = np.concatenate([columns, (data.z - prediction.rows)[:, None]], axis=1)
    size = np.linalg.norm(both[:, :-1], axis=0)
    both = np.concatenate([both[:, :-1][:, size > 0] / size[size > 0], both[:, -1:]], axis=1)
    # the level that the recording shows at its own time is part of every alternative
    best = (
        _profiled(noise.whitener.at(min(noise.level, ceiling)), both),
        noise.at(min(noise.level, ceiling)),
    )
    for time in times:
        whitener = response.whitener(TorqueNoise(0.0, float(time)))
        deviances = [_profiled(whitener.at(float(s)), both) for s in levels]
        k = int(np.argmin(deviances))
        if deviances[k] < best[0]:
            level = float(levels[k])
            pure = min(noise.pure, level)
            best = (
                deviances[k],
                replace(noise, pure=pure, level=level, time=float(time), whitener=whitener.at(level)),
            )
    return best[1]


def _profiled(whitener: Whitener, both: Array) -> float:
    """Return the deviance of the last column with the others free."""
    r = np.abs(np.diag(np.linalg.qr(whitener(both), mode="r")))
    return whitener.log_determinant + float(r[-1] ** 2)


def _deviance(fit: Fit, noises: Sequence[Noise], moving: NDArray[np.bool_]) -> float:
    """Return the deviance of all cases at these noises, to first order in the variables."""
    r, j = fit.problem.with_noise(noises).residuals(fit.predictions)
    size = np.linalg.norm(j, axis=0)
    used = moving & (size > 0)
    both = np.concatenate([j[:, used] / size[used], r[:, None]], axis=1)
    least = np.abs(np.diag(np.linalg.qr(both, mode="r")))[-1]
    return float(least**2) + sum(n.whitener.log_determinant for n in noises)


def is_established(without: RandomTorque, named: Fit, tests: int, criteria: Criteria) -> bool:
    """Return whether a fit with an effect describes the data better than any random torque without it.

    `tests` is the number of effects that were tried.
    """
    from scipy.special import chdtrc

    more = len(named.theta) - len(without.fit.theta)
    fall = without.deviance - with_random_torque(named, criteria).deviance
    if more < 1:
        return fall > criteria.evidence
    p_value = min(1.0, tests * float(chdtrc(more, max(fall, 0.0))))
    return fall > more * float(np.log(named.rows)) + criteria.evidence and p_value < criteria.significance


def describes(without: RandomTorque, criteria: Criteria) -> bool:
    """Return whether the residuals of a fit are consistent with noise at its most likely random torque."""
    logs = sum(n.whitener.log_determinant for n in without.fit.noise)
    return without.is_raised and (without.deviance - logs) < criteria.reduced_chi2 * without.fit.rows
