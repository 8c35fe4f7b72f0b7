"""Periodogram of the residual torque: whether it contains a sinusoid in time.

A vibrating table or a fan causes a sinusoidal torque in time, which is fast. Process noise of short correlation time
absorbs the variance of this torque, but cannot imitate a single frequency. For each frequency, a cosine and a sine
torque on the casing are added to the model. Let r be the whitened residuals and S the whitened responses to cosine and
sine. Both are projected orthogonally to the derivatives with respect to the fitted parameters (the free columns). Then

    chi2 = r'S (S'S)^-1 S'r

has 2 degrees of freedom if no torque is missing; it is twice the power z of a periodogram. The probability that noise
exceeds z at some trial frequency is

    p = (1 + W sqrt(z)) exp(-z),   W = f T sqrt(4 pi / 12)

(R. Baluev, Mon. Not. R. Astron. Soc. 385, 1279 (2008), eq. 6). Here f is the width of the band of trial frequencies,
and T is the length of the record, which samples cover evenly. Correlated noise raises chi2 in a whole range of
frequencies, a sinusoid only at its own. chi2 is therefore divided by the level of the noise near the frequency: the
median of chi2 over the neighbouring trial frequencies, divided by the median of a chi-square of 2 degrees of freedom,
but at least 1. The lack-of-fit test against slow torques covers torques
with fewer than ten periods in the record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import TORQUE, format_torque
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._noise import Noise, TorqueResponse
from fitting.inference._problem import Problem, Projection
from fitting.inference._spectral_lines import false_alarm_probability

Array = NDArray[np.float64]

_FEWEST_PERIODS = 10
"""Smallest number of periods in a record at which a frequency is tried [1]. Chosen: with fewer, the torque is a trend,
which the test against slow torques covers; a larger value leaves a gap between the two tests."""
_PER_PEAK = 2
"""Number of trial frequencies per width of a peak; the width is 2 pi divided by the length of the record [1]. Chosen: a
smaller number overlooks peaks, a larger one costs time; the finer search follows."""
_FINER = 16
"""Number of trial frequencies of the finer search about the highest peak, per coarse step [1]. Chosen: a smaller number
understates the peak, a larger one costs time."""
_RETAINED = 1e-3
"""A torque is tested if at least this share of its response is orthogonal to the free columns [1]. Chosen: a smaller
value tests rounding errors, a larger one omits torques that are nearly absorbed."""
_RANK = 1e-4
"""A direction is not tested if its singular value, divided by the largest, is below this value [1]. Chosen: a smaller
value tests rounding errors, a larger one omits deviations that are nearly absorbed."""
_RANK_FREE = 1e-7
"""A direction is not projected out if its singular value, divided by the largest, is below this value [1]. Chosen: a
smaller value projects out rounding errors, a larger one ignores some free columns."""
_NEIGHBOURS = 120
"""Number of trial frequencies whose median is the local level of the noise [1]. Chosen: 60 independent values, so that
the level has a relative standard error of 19 %; a larger number blurs the spectrum of the noise. With fewer trial
frequencies, the level is 1."""
_OWN = 4
"""Number of trial frequencies on each side that are not neighbours, because a sinusoid raises their chi2 as well [1].
Derived: two widths of a peak; a larger number changes little, a smaller one takes the flank of a peak for noise."""
_MEDIAN = 2 * math.log(2)
"""Median of a chi-square of two degrees of freedom [1]. Derived: from its exponential distribution."""
_NEAR_RESONANCE = 0.01
"""Smallest difference of the squared frequencies of a drive and an oscillator, divided by the squared frequency of the
oscillator [1]. Chosen: with a smaller value, the computed angle is unlimited; a larger one understates a resonance."""


@dataclass(frozen=True)
class PeriodogramPeak:
    """The highest peak of the periodogram of the residual torque on one body."""

    rate: float  # frequency of the torque, 2 pi divided by the period [rad/s]
    torque: float  # amplitude of the torque [N m]
    angle: float  # amplitude of the angle that the torque causes [rad]; k / (I w^2) far above a resonance
    label: str  # the case
    body: str  # name of the body for the user, for example "casing"
    p_value: float  # probability that noise has a peak of this height (an upper bound)
    unit: str = TORQUE  # unit of the torque: "N m", or "rad/s2" per unit of inertia
    site: str = "casing"  # name of the body in the keys and formulas of laws

    @property
    def words(self) -> str:
        """The predicate of a sentence about the residual torque."""
        return (
            f"is sinusoidal with a period of {2 * math.pi / self.rate:.4g} s in {self.label}: a torque of "
            f"{format_torque(self.torque, unit=self.unit)} on the {self.body}, "
            f"or {1e3 * self.angle:.2g} mrad of its angle"
        )

    @property
    def law(self) -> str:
        """The formula to add to the model, for the option --add."""
        return f"{self.site}: k*cos({self.rate:.5g}*t + phi)"


def periodogram_peak(
    problem: Problem, predictions: Sequence[Prediction], noise: Sequence[Noise]
) -> PeriodogramPeak | None:
    """Return the most significant peak of the periodograms of all cases; None if no record is long enough.

    A camera may have a systematic error of a single frequency that is smaller than the noise of one angle. The p-value
    of a peak with such a small angle is therefore 1 if the recording was tracked on film.
    """
    cases = list(zip(problem.data, predictions, noise, strict=True))
    peaks = [peak for case in cases if (peak := _highest_peak(*case, len(cases))) is not None]
    return min(peaks, key=lambda peak: peak.p_value, default=None)


def _highest_peak(data: CaseData, prediction: Prediction, noise: Noise, cases: int) -> PeriodogramPeak | None:
    """Return the highest peak of one case; None if its record is too short.

    The p-value is for the best of `cases` cases.
    """
    periodogram = _Periodogram(data, prediction, noise)
    lowest, highest, step = periodogram.band
    if highest <= lowest:
        return None
    coarse = np.arange(lowest, highest, step)
    spectrum = periodogram(coarse)[0]
    levels = _noise_levels(spectrum)
    best = int(np.argmax(spectrum / levels))
    peak, level = coarse[best], float(levels[best])
    fine = np.linspace(peak - step, peak + step, 2 * _FINER + 1)
    power, torque = periodogram(fine)
    top = int(np.argmax(power))
    k, rate = float(torque[top]), float(fine[top])
    motion, record = data.motion, data.record
    # amplitude of the angle of a driven oscillator without damping, or of a free body
    stiffness = (2 * np.pi / motion.period) ** 2
    angle = k / (record.I_casing * max(abs(stiffness - rate**2), _NEAR_RESONANCE * stiffness))
    credible = not record.tracked or angle > float(np.median(record.casing.sigma))
    # if the modelled phase is wrong, the residual is the whole motion, which no additional torque explains
    credible = credible and angle < motion.amplitude
    share = periodogram.share(rate)
    p_values = [
        false_alarm_probability(
            float(power[top]) / level / (1 - share + share * x),
            (highest - lowest) / (2 * np.pi),
            periodogram.span,
        )
        for x in noise.process.ratios
    ]
    p_value = min(cases * float(np.dot(p_values, noise.process.weights)), 1.0) if credible else 1.0
    site = record.mechanism.main
    return PeriodogramPeak(rate, k, angle, record.label, record.body, p_value, record.torque_unit, site)


def _noise_levels(chi2: Array) -> Array:
    """Return the level of the noise at each trial frequency, at least 1, from chi2 at neighbouring frequencies."""
    levels = np.ones(len(chi2))
    if len(chi2) < _NEIGHBOURS:
        return levels
    for k in range(len(chi2)):
        # at the ends of the band, most neighbours are on one side
        first = max(min(k - _NEIGHBOURS // 2, len(chi2) - _NEIGHBOURS - 1), 0)
        near = np.arange(first, min(first + _NEIGHBOURS + 1, len(chi2)))
        levels[k] = max(1.0, float(np.median(chi2[near[np.abs(near - k) > _OWN]])) / _MEDIAN)
    return levels


class _Periodogram:
    """Chi-square and amplitude [N m] of sinusoidal torques on the casing of one case."""

    def __init__(self, data: CaseData, prediction: Prediction, noise: Noise) -> None:
        self._response = TorqueResponse(data, prediction.motion)
        self._project = Projection(data, noise.whitener.at(noise.tested))
        self._rows = len(data.z)
        self._basis = orthonormal(self._project(prediction.columns), _RANK_FREE)
        self._residual = self._orthogonal(self._project((data.z - prediction.rows)[:, None]))[:, 0]

    @property
    def span(self) -> float:
        """Length of the record [s]."""
        return float(self._response.edges[-1] - self._response.edges[0])

    @property
    def band(self) -> tuple[float, float, float]:
        """Lowest and highest trial frequency, and the step between trial frequencies [rad/s]."""
        cell = self._response.edges[1] - self._response.edges[0]
        return 2 * np.pi * _FEWEST_PERIODS / self.span, 1.0 / float(cell), 2 * np.pi / self.span / _PER_PEAK

    def share(self, rate: float) -> float:
        """Return the share of the process noise in the variance of the response at a frequency [rad/s]."""
        response = self._orthogonal(self._response_to(np.array([rate])))
        return self._project.whitener.share(orthonormal(response, _RANK))

    def _response_to(self, rates: Array) -> Array:
        phase = np.outer(self._response.centres, rates)
        torque = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
        rows = np.zeros((self._rows, torque.shape[1]))
        rows[: len(self._response.casing)] = self._response.casing @ torque
        return self._project(rows)

    def __call__(self, rates: Array) -> tuple[Array, Array]:
        """Return chi-square and amplitude at frequencies [rad/s]."""
        response = self._response_to(rates)
        c, s = np.split(self._orthogonal(response), 2, axis=1)
        whole = np.prod(np.split(np.sum(response**2, axis=0), 2), axis=0)
        cc, ss, cs = np.sum(c * c, axis=0), np.sum(s * s, axis=0), np.sum(c * s, axis=0)
        x, y = c.T @ self._residual, s.T @ self._residual
        determinant = cc * ss - cs**2
        determined = determinant > _RETAINED**2 * whole
        safe = np.where(determined, determinant, 1.0)
        a, b = (ss * x - cs * y) / safe, (cc * y - cs * x) / safe
        return np.where(determined, a * x + b * y, 0.0), np.hypot(a, b)

    def _orthogonal(self, rows: Array) -> Array:
        return orthogonal_to(self._basis, rows)
