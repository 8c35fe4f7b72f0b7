"""Whether a smooth or a periodic torque describes the residuals of a model better than a random torque does.

Some recordings cannot exclude a random torque that is large enough to hide a missing law. The residuals are then
consistent with noise, although a law with few parameters would describe them without any random torque. Several
descriptions are compared, each with the free parameters of the fit. One is a random torque alone. The others are a
random torque together with one of

- a torque that is a parabola in time, on the casing and in the bearing;
- a sinusoidal torque on the casing whose frequency changes linearly in time (a precession).

In each description, the level s and the correlation time T of the random torque have their most likely values
(`fitting.inference._level_profile`). A torque with q parameters describes the data better if the deviance falls by more
than BIC requires, and by more than is probable by chance for this number of parameters,

    D0 - D1 > q ln n + `Criteria.random_torque_evidence`,    N P(chi2_c > D0 - D1) < `Criteria.lack_of_fit`,

where n is the number of rows. c of the q parameters are linear; the other parameters are tried at N independent values
(Bonferroni). In recordings with nothing but a random torque the fall exceeds chi-square for two reasons: the level is
free, and only one or two modes of a slow torque are above the noise. In 60 simulated recordings with correlation times
of 1 to 10 s the fall reaches 33 for parabolas and 28 for sinusoids, with q ln n = 27. For the effects that `diagnose`
names in films, the fall is 58 to 214.
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
"""Degree of the smooth torques in time [1]. Chosen: the parameters of the model nearly absorb a constant and a trend; a
larger value describes more torques and needs more evidence."""
_TIMES = 5
"""Number of trial correlation times of the random torque; the correlation time of the recording is tried as well [1].
Chosen: with fewer, the maximum of the likelihood is overlooked; with more, the test takes longer."""
_FEWEST_TIMES = 6.0
"""Smallest ratio of the length of a record to the correlation time of the random torque [1]. Chosen: as in
`fitting.inference._random_torque`; with a smaller ratio the torque is a trend; with a larger one, slow torques are not
tried."""
_LEVELS = np.geomspace(0.01, 4.0, 12)
"""Trial levels of the random torque, divided by the level of the fit [1]. Chosen: lower levels have no effect, and
additional free parameters never raise the level much; with more trial levels, the test takes longer."""
_RANK_FREE = 1e-7
"""Relative singular value below which a free direction is rounding error [1]. Chosen: as in
`fitting.inference._metrics`; a smaller value projects out rounding errors; with a larger one, some free columns are not
projected out."""
_RANK = 1e-4
"""Relative singular value below which the model already contains a smooth torque [1]. Chosen: as in
`fitting.inference._metrics`; a smaller value tests rounding errors, a larger one omits torques that are nearly
absorbed."""


_FEWEST_PERIODS = 4.0
"""Smallest number of periods of a periodic torque in a record [1]. Chosen: the response of the angle to a random torque
is strongest at low frequencies, so it resembles a slow sinusoid; a smaller number takes a random torque for a sinusoid,
a larger one overlooks a slow precession."""
_MOST_PERIODS = 12.0
"""Largest number of periods of a periodic torque in a record [1]. Chosen: the periodogram tests faster torques; a
larger number needs more trials."""
_PERIOD_STEP = 0.25
"""Step of the trial numbers of periods [1]. Chosen: a sinusoid that differs by a quarter of a period at the end of the
record keeps 0.95 of its power; a larger step overlooks sinusoids, a smaller one costs time."""
_CHIRPS = np.linspace(-0.4, 0.4, 9)
"""Trial changes of the frequency over half the record, divided by the mean frequency [1]. Chosen: the value is 0.33 for
a precession during which the rotor loses half of its speed; larger changes do not describe a precession."""
_CHIRP_TRIALS = 4
"""Number of independent trials among the changes of the frequency [1]. Chosen: for few periods, neighbouring changes
give correlated responses; a larger number requires a larger fall."""


@dataclass(frozen=True)
class SmoothTorque:
    """Fall of the deviance if smooth torques are added to a random torque.

    `columns` is the number of linear parameters of these torques, and `rows` is the number of rows. `searched` is the
    number of further parameters that are optimised over `trials` independent values.
    """

    fall: float
    columns: int
    rows: int
    searched: int = 0
    trials: float = 1.0

    @property
    def p_value(self) -> float:
        """Probability that a chi-square exceeds the fall in any of the trials."""
        return (
            min(self.trials * float(chdtrc(self.columns, max(self.fall, 0.0))), 1.0) if self.columns else 1.0
        )

    def is_better(self, criteria: Criteria) -> bool:
        """Return whether the torques describe the residuals better than a random torque alone, by BIC and p-value."""
        enough = (self.columns + self.searched) * np.log(self.rows) + criteria.random_torque_evidence
        return bool(self.fall > enough and self.p_value < criteria.lack_of_fit)


def smooth_torques(
    data: CaseData, prediction: Prediction, noise: Noise, free: Array, criteria: Criteria
) -> tuple[SmoothTorque, SmoothTorque]:
    """Compare a random torque plus a parabola or a sinusoid with a random torque alone, in the rows of one case.

    Parameters
    ----------
    data, prediction, noise : CaseData, Prediction, Noise
        A case, the prediction of the fitted model, and the noise; its random torque must have a level above zero.
    free : ndarray, shape (rows, columns)
        Derivatives with respect to the free parameters and nuisance columns.
    criteria : Criteria
        Range of correlation times of the random torque.
    """
    residual = data.z - prediction.rows
    response = TorqueResponse(data, prediction.motion)
    alone = scaled_columns(free, residual)
    parabola = _beside(alone, _parabolas(data, prediction), noise)
    sinusoid = _beside(alone, _sinusoid(response, alone, noise), noise)
    first, last = data.record.span
    longest = min(criteria.random_torque_longest, (last - first) / _FEWEST_TIMES)
    times = np.geomspace(min(criteria.random_torque_shortest, longest), longest, _TIMES)
    deviances = []
    for time in (noise.time, *times):
        whitener = response.whitener(TorqueNoise(0.0, float(time)))
        profiles = [
            LevelProfile(whitener, scaled_columns(np.concatenate([free, more], axis=1), residual))
            for more in (free[:, :0], parabola, sinusoid)
        ]
        deviances.append([min(p(0.0), p.least(noise.level * _LEVELS)[1]) for p in profiles])
    without, with_parabola, with_sinusoid = np.min(deviances, axis=0)
    n, trials = len(data.z), 2 * (_MOST_PERIODS - _FEWEST_PERIODS) * _CHIRP_TRIALS
    return (
        SmoothTorque(float(without - with_parabola), parabola.shape[1], n),
        SmoothTorque(float(without - with_sinusoid), sinusoid.shape[1], n, 2, trials),
    )


def _beside(alone: Array, columns: Array, noise: Noise) -> Array:
    """Return independent combinations of the columns that the free columns do not already describe."""
    basis = orthonormal(noise.whitener(alone[:, :-1]), _RANK_FREE)
    columns = scaled_columns(columns, alone[:, -1])[:, :-1]
    # some columns are dependent: for a single body, the torques on the casing and in the bearing are equal, or in the
    # model
    _, value, directions = np.linalg.svd(orthogonal_to(basis, noise.whitener(columns)), full_matrices=False)
    return np.asarray(columns @ directions[value > _RANK * value.max(initial=0.0)].T)


def _parabolas(data: CaseData, prediction: Prediction) -> Array:
    """Return the responses to polynomial torques in time, up to `_DEGREE`, on the casing and in the bearing."""
    slow = slow_responses(data, prediction)
    shapes = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, KNOTS), _DEGREE)
    each = np.split(slow, slow.shape[1] // KNOTS, axis=1)
    return np.concatenate([columns @ shapes for columns in each], axis=1)


def _sinusoid(response: TorqueResponse, alone: Array, noise: Noise) -> Array:
    """Return the responses to the cosine and sine torques that explain most at the noise level of tests.

    The phase of both is 2 pi N (x + c x (x - 1)), where x is the time divided by the length of the record, N is the
    number of periods, and c is the change of the frequency.
    """
    whitener = noise.whitener.at(noise.tested)
    white = whitener(alone)
    basis = orthonormal(white[:, :-1], _RANK_FREE)
    residual = orthogonal_to(basis, white[:, -1])
    times = response.centres
    x = (times - times[0]) / (times[-1] - times[0])
    best, found = -1.0, np.zeros((len(alone), 0))
    for periods in np.arange(_FEWEST_PERIODS, _MOST_PERIODS + _PERIOD_STEP / 2, _PERIOD_STEP):
        phases = 2 * np.pi * periods * (x + np.multiply.outer(_CHIRPS, x * (x - 1)))
        shapes = np.stack([np.cos(phases), np.sin(phases)], axis=1)
        columns = np.zeros((len(alone), 2 * len(_CHIRPS)))
        columns[: len(response.casing)] = response.casing @ shapes.reshape(-1, len(x)).T
        tested = orthogonal_to(basis, whitener(columns))
        for k in range(0, columns.shape[1], 2):
            pair = orthonormal(tested[:, k : k + 2], _RANK)
            explained = float(np.sum((pair.T @ residual) ** 2))
            if explained > best:
                best, found = explained, columns[:, k : k + 2]
    return found
