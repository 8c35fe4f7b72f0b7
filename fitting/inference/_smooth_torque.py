"""Whether a smooth torque describes the residuals of a model better than a random torque does.

A recording may not exclude a random torque that would hide a missing law: the residuals are then consistent with noise,
although a law would describe them with few parameters and no random torque at all. Two descriptions are compared, both
with the free parameters of the fit: a random torque alone, and a random torque beside a torque that is a parabola in
time, on the casing and in the bearing. Level s and correlation time T of the random torque are the most likely ones in
each of them (`fitting.inference._level_profile`). The parabolas describe the data better if the deviance falls by more
than BIC requires, and improbably much for their number,

    D0 - D1 > q ln n + `Criteria.evidence`,    P(chi2_q > D0 - D1) < `Criteria.lack_of_fit`,

with q independent torques beside the free parameters, and n rows. In recordings with nothing but a random torque the
fall is larger than chi-square, because the level is free: 22 of 70 simulated recordings are compared, with p-values
down to 1e-4, and none exceeds the limit of BIC.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from fitting._criteria import Criteria
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._level_profile import LevelProfile, scaled_columns
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._metrics import KNOTS, slow_responses
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse

Array = NDArray[np.float64]

_DEGREE = 2
"""Degree of the smooth torques in time [1]. Chosen: a constant and a trend are nearly parameters of the model; more
degrees describe more and need more evidence."""
_TIMES = 5
"""Trial correlation times of the random torque beside that of the recording [1]. Chosen: fewer pass over the maximum of
the likelihood, more cost time."""
_FEWEST_TIMES = 6.0
"""Smallest length of a record, in correlation times of the random torque [1]. Chosen: as in
`fitting.discovery._random_torque`; with fewer the torque is a trend, a larger value leaves slow torques untried."""
_LEVELS = np.geomspace(0.01, 4.0, 12)
"""Trial levels of the random torque over that of the fit [1]. Chosen: lower ones are none, with more freedom none is
much larger; more cost time."""
_RANK_FREE = 1e-7
"""Relative singular value below which a free direction is rounding [1]. Chosen: as in `fitting.inference._metrics`; a
smaller value projects out rounding, a larger one leaves a part of the free columns."""
_RANK = 1e-4
"""Relative singular value below which a smooth torque is one of the model [1]. Chosen: as in
`fitting.inference._metrics`; a smaller value tests rounding, a larger one omits torques that are nearly absorbed."""


@dataclass(frozen=True)
class SmoothTorque:
    """Fall of the deviance by smooth torques beside a random one, their number, and the rows of the case."""

    fall: float
    columns: int
    rows: int

    @property
    def p_value(self) -> float:
        """Probability of a larger fall, of a chi-square."""
        return float(chdtrc(self.columns, max(self.fall, 0.0))) if self.columns else 1.0

    def is_better(self, criteria: Criteria) -> bool:
        """Return whether they describe the residuals better than a random torque alone, by BIC and p-value."""
        enough = self.columns * np.log(self.rows) + criteria.evidence
        return bool(self.fall > enough and self.p_value < criteria.lack_of_fit)


def smooth_torque(
    data: CaseData, prediction: Prediction, noise: Noise, free: Array, criteria: Criteria
) -> SmoothTorque:
    """Compare smooth torques beside a random one with a random torque alone, in the rows of one case.

    Parameters
    ----------
    data, prediction, noise : CaseData, Prediction, Noise
        A case, the prediction of the fitted model, and the noise with the random torque that it needs, above zero.
    free : ndarray, shape (rows, columns)
        Derivatives by the free parameters and nuisance columns.
    criteria : Criteria
        Range of correlation times of the random torque.
    """
    slow = slow_responses(data, prediction)
    shapes = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, KNOTS), _DEGREE)
    smooth = np.concatenate([slow[:, :KNOTS] @ shapes, slow[:, KNOTS:] @ shapes], axis=1)
    residual = data.z - prediction.rows
    alone = scaled_columns(free, residual)
    smooth = scaled_columns(smooth, residual)[:, :-1]
    basis = orthonormal(noise.whitener(alone[:, :-1]), _RANK_FREE)
    # of a single body both torques are the same one, and some are those of the model
    _, value, directions = np.linalg.svd(orthogonal_to(basis, noise.whitener(smooth)), full_matrices=False)
    smooth = smooth @ directions[value > _RANK * value.max(initial=0.0)].T
    if not smooth.shape[1]:
        return SmoothTorque(0.0, 0, len(data.z))
    both = scaled_columns(np.concatenate([free, smooth], axis=1), residual)
    response = TorqueResponse(data, prediction.motion)
    first, last = data.record.span
    longest = min(criteria.random_torque_longest, (last - first) / _FEWEST_TIMES)
    times = np.geomspace(min(criteria.random_torque_shortest, longest), longest, _TIMES)
    deviances = []
    for time in (noise.time, *times):
        whitener = response.whitener(TorqueNoise(0.0, float(time)))
        profiles = [LevelProfile(whitener, columns) for columns in (alone, both)]
        deviances.append([min(p(0.0), p.least(noise.level * _LEVELS)[1]) for p in profiles])
    without, with_smooth = np.min(deviances, axis=0)
    return SmoothTorque(float(without - with_smooth), smooth.shape[1], len(data.z))
