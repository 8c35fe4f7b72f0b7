"""Whether what a model leaves swings at one frequency all the time, as no random torque does.

A table that shakes, a fan, a pendulum: a torque that swings in time is fast, so that a random torque of short memory
explains how much is left. But it stands at one frequency, and that torque at all. The model gets a cosine and a sine of
each frequency on the casing; with the whitened responses S to the two, beside all that is free,

    chi2 = r'S (S'S)^-1 S'r   with 2 degrees of freedom

if nothing is missing, which is twice the power z of a periodogram. Noise reaches it anywhere among frequencies up to f
in the share

    p = W sqrt(z) exp(-z),   W = f sqrt(4 pi var t)

of all records (R. Baluev, Mon. Not. R. Astron. Soc. 385, 1279 (2008), eq. 6). Slow swings, of which a record holds less
than ten, are left to the test of slow torques.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.estimation import Fit
from fitting.estimation.case_model import Prediction
from fitting.estimation.lack import orthonormal
from fitting.estimation.noise_levels import Noise
from fitting.estimation.problem import Projection
from fitting.noise import TorqueResponse

Array = NDArray[np.float64]

_FEWEST_PERIODS = 10
_RANK_FREE = 1e-7
# frequencies to a peak, and to a finer look about the highest one
_A_PEAK = 2
_FINER = 16
# share of its response that a torque must keep beside what is free
_SEEN = 1e-3


@dataclass(frozen=True)
class SpectralLine:
    """The torque on one body that swings at one frequency and stands out most.

    Attributes
    ----------
    rate : float
        Its frequency, 2 pi over the period [rad/s].
    torque : float
        Its amplitude [N m].
    angle : float
        The amplitude that it gives the body's angle, k / (I w^2) [rad].
    label : str
        The case.
    body : str
        What carries it: "casing", or "body" where only one was recorded.
    p_value : float
        Probability that noise stands out as much, at most.
    """

    rate: float
    torque: float
    angle: float
    label: str
    body: str
    p_value: float

    @property
    def words(self) -> str:
        """What it does, to be read behind the name of what leaves it."""
        return (
            f"swings with a period of {2 * math.pi / self.rate:.4g} s in {self.label}, like a torque of "
            f"{self.torque:.2g} N m on the {self.body}, or its angle by {1e3 * self.angle:.2g} mrad"
        )

    @property
    def law(self) -> str:
        """The formula to add."""
        return f"casing: k*cos({self.rate:.5g}*t + phi)"


def spectral_line(fit: Fit) -> SpectralLine | None:
    """Return what swings most clearly in what a fit leaves, if anything could.

    An encoder or the frames of a camera may err in step with a frequency of their own, by less than one angle errs: on
    film, what swings less is none.
    """
    found = [line for line in _lines(fit) if line is not None]
    return min(found, key=lambda line: line.p_value, default=None)


def _lines(fit: Fit) -> Iterator[SpectralLine | None]:
    cases = list(zip(fit.problem.data, fit.predictions, fit.noise, strict=True))
    for data, p, noise in cases:
        look = _Periodogram(data, p, noise)
        lowest, highest, step = look.band
        if highest <= lowest:
            continue
        coarse = np.arange(lowest, highest, step)
        peak = coarse[int(np.argmax(look(coarse)[0]))]
        fine = np.linspace(peak - step, peak + step, 2 * _FINER + 1)
        power, torque = look(fine)
        top = int(np.argmax(power))
        k, rate = float(torque[top]), float(fine[top])
        angle = k / (data.record.I_casing * rate**2)
        shown = not data.record.tracked or angle > float(np.median(data.record.casing.sigma))
        chance = len(cases) * by_noise(float(power[top]), (highest - lowest) / (2 * np.pi), look.span)
        p_value = min(chance, 1.0) if shown else 1.0
        yield SpectralLine(rate, k, angle, data.record.label, data.record.body, p_value)


def by_noise(chi2: float, band: float, span: float) -> float:
    """Return the probability that noise reaches a chi-square of two degrees of freedom somewhere in a band.

    Parameters
    ----------
    chi2 : float
        The largest one.
    band : float
        Width of the frequencies that were looked at [Hz].
    span : float
        Length of the record [s], evenly covered.
    """
    z = 0.5 * chi2
    independent = band * span * math.sqrt(4 * math.pi / 12)
    return min(1.0, math.exp(-z) * (1 + independent * math.sqrt(z)))


class _Periodogram:
    """Chi-square and amplitude [N m] of torques on the casing of one case that swing."""

    def __init__(self, data: CaseData, prediction: Prediction, noise: Noise) -> None:
        self._response = TorqueResponse(data, prediction.motion)
        self._project = Projection(data, noise.whitener.at(noise.pure))
        self._rows = len(data.z)
        self._basis = orthonormal(self._project(prediction.columns), _RANK_FREE)
        self._left = self._beside(self._project((data.z - prediction.rows)[:, None]))[:, 0]

    @property
    def span(self) -> float:
        """Length of the record [s]."""
        return float(self._response.edges[-1] - self._response.edges[0])

    @property
    def band(self) -> tuple[float, float, float]:
        """Lowest and highest frequency, and their distance [rad/s]."""
        cell = self._response.edges[1] - self._response.edges[0]
        return 2 * np.pi * _FEWEST_PERIODS / self.span, 1.0 / float(cell), 2 * np.pi / self.span / _A_PEAK

    def __call__(self, rates: Array) -> tuple[Array, Array]:
        """Return chi-square and amplitude at frequencies [rad/s]."""
        turn = np.outer(self._response.centres, rates)
        waves = np.concatenate([np.cos(turn), np.sin(turn)], axis=1)
        rows = np.zeros((self._rows, waves.shape[1]))
        rows[: len(self._response.casing)] = self._response.casing @ waves
        seen = self._project(rows)
        c, s = np.split(self._beside(seen), 2, axis=1)
        whole = np.prod(np.split(np.sum(seen**2, axis=0), 2), axis=0)
        cc, ss, cs = np.sum(c * c, axis=0), np.sum(s * s, axis=0), np.sum(c * s, axis=0)
        x, y = c.T @ self._left, s.T @ self._left
        area = cc * ss - cs**2
        known = area > _SEEN**2 * whole
        safe = np.where(known, area, 1.0)
        a, b = (ss * x - cs * y) / safe, (cc * y - cs * x) / safe
        return np.where(known, a * x + b * y, 0.0), np.hypot(a, b)

    def _beside(self, rows: Array) -> Array:
        return np.asarray(rows - self._basis @ (self._basis.T @ rows))
