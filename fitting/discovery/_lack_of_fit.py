"""Tests of what a named law leaves: smooth tests, nonparametric laws, periodogram.

A law of the wrong shape leaves a torque that is a smooth function of the speed which the true law depends on, the same
in all cases. Few numbers describe it, and noise has fewer ways to look like it than like any slow torque. The
model gets torques piecewise linear in the speed of the casing, the rotor or the bearing, on the casing or in the
bearing, with a few knots or with more. Each choice S, beside all that is free, takes

    chi2 = r'S (S'S)^-1 S'r   with rank(S) degrees of freedom

away if nothing is missing: a smooth test of the model at several resolutions (J. Hart, Nonparametric Smoothing and
Lack-of-Fit Tests, Springer (1997), ch. 5-7). The least of their p-values is set against that of noise put through the
same choices.

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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fitting.discovery._score import CaseColumns, Stage, free_score, over_many
from fitting.dynamics._mesh import Sampler
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._lack_of_fit import block_diagonal, orthonormal
from fitting.inference._noise import Noise, TorqueResponse
from fitting.inference._problem import Projection, turned
from fitting.inference._result import Fit

Array = NDArray[np.float64]

KNOTS = (4, 8)


def speeds(times: Array, prediction: Prediction) -> Array:
    """Return the speeds of casing, rotor and bearing, shape (3, times) [rad/s]."""
    y = Sampler(prediction.path.mesh, times).value(prediction.path.y)
    return np.stack([y[:, 1], y[:, 0], y[:, 0] - y[:, 1]])


def hats(speed: Array, knots: Array) -> Array:
    """Return the functions that are 1 at one knot and 0 at the others, at some speeds, shape (speeds, knots)."""
    return np.stack([np.interp(speed, knots, row) for row in np.eye(len(knots))], axis=1)


def any_law_of_the_casing(fit: Fit) -> float:
    """Return the fall of the deviance by a torque on the casing that follows its speed in whatever way.

    The law is the same in all cases. It is scored as a candidate is, without a refit.
    """
    return _fall(fit, lambda case, p: speeds(case.response.centres, p)[0])


def any_slow_torque(fit: Fit, *, apart: bool = False) -> float:
    """Return the fall of the deviance by a torque on the casing that changes slowly in time, scored in the same way.

    It is the same in all cases, or each has one of its own (`apart`).
    """
    return _fall(fit, lambda case, _: case.response.centres, apart=apart)


def _fall(fit: Fit, followed: Callable[[CaseColumns, Prediction], Array], *, apart: bool = False) -> float:
    cases = [CaseColumns(fit, i) for i in range(len(fit.predictions))]
    stage = Stage(fit, 1)
    own = [followed(c, p) for c, p in zip(cases, fit.predictions, strict=True)]
    least, most = min(float(x.min()) for x in own), max(float(x.max()) for x in own)
    found = []
    for count in KNOTS:
        knots = np.linspace(least, most, count)
        rows = [_rows(c, c.response.casing @ hats(x, knots)) for c, x in zip(cases, own, strict=True)]
        found.append(free_score(stage, block_diagonal(rows) if apart else np.concatenate(rows)))
    return max(found)


def _rows(case: CaseColumns, smooth: Array) -> Array:
    rows = np.zeros((len(case.case.data.z), smooth.shape[1]))
    rows[: len(smooth)] = smooth
    return rows


_RANK = 1e-4
_RANK_FREE = 1e-7
_TINY = 1e-300
_DRAWS = 2000


@dataclass(frozen=True)
class Objection:
    """Whose speed a remaining torque follows best, and the probability of as much by noise (at most)."""

    body: str
    p_value: float

    @property
    def words(self) -> str:
        """What the torque does, to be read behind the name of what leaves it."""
        return f"follows the speed of the {self.body}"


def objection(fit: Fit) -> Objection:
    """Return how clearly what a fit leaves follows a speed.

    Parameters
    ----------
    fit : Fit
        The fit with the law that was named.
    """
    named, tried, free, residual = _smooth_rows(fit)
    basis = orthonormal(free, _RANK_FREE)
    left = residual - basis @ (basis.T @ residual)
    looked = [(name, s) for name, s in zip(named, (_beside(s, basis) for s in tried), strict=True) if s.size]
    if not looked:
        return Objection("", 1.0)
    # all that is looked at lies in few dimensions, and noise is the same in each of them
    whole = orthonormal(np.concatenate([s for _, s in looked], axis=1), _RANK_FREE)
    looks = [s.T @ whole for _, s in looked]
    seen = _p_values(looks, (whole.T @ left)[:, None])[:, 0]
    empty = _p_values(looks, np.random.default_rng(0).standard_normal((whole.shape[1], _DRAWS)))
    best = int(np.argmin(seen))
    return Objection(looked[best][0], over_many(float(seen[best]), empty.min(axis=0)))


def _beside(columns: Array, basis: Array) -> Array:
    """Return an orthonormal basis of what columns do beside an orthonormal basis."""
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), _TINY)
    columns = columns - basis @ (basis.T @ columns)
    return orthonormal(columns[:, np.linalg.norm(columns, axis=0) > _RANK_FREE], _RANK)


def _p_values(looks: list[Array], rows: Array) -> Array:
    """Return the p-value of each look (rows) at each set of data (columns)."""
    from scipy.special import chdtrc

    return np.array([chdtrc(len(look), np.sum((look @ rows) ** 2, axis=0)) for look in looks])


def _smooth_rows(fit: Fit) -> tuple[list[str], list[Array], Array, Array]:
    """Return names, and as whitened rows of all cases: torques that follow a speed, what is free, the residual."""
    cases = list(zip(fit.problem.data, fit.predictions, fit.noise, strict=True))
    responses = [TorqueResponse(data, p.motion) for data, p, _ in cases]
    each = [speeds(r.centres, p) for r, (_, p, _) in zip(responses, cases, strict=True)]
    record = cases[0][0].record
    bodies = (record.body,) if record.single else (record.body, "rotor", "bearing")
    choices = _choices(np.concatenate(each, axis=1)[: len(bodies)])
    tried, free, residual = [], [], []
    for response, own, (data, p, noise) in zip(responses, each, cases, strict=True):
        acting = response.casing, response.casing - response.rotor
        torques = [acting[body] @ hats(own[which], knots) for which, knots, body in choices]
        rows = np.zeros((len(data.z), sum(t.shape[1] for t in torques)))
        rows[: len(response.casing)] = np.concatenate(torques, axis=1)
        project = Projection(data, noise.whitener.at(noise.pure))
        few = turned(project(np.concatenate([rows, p.columns, (data.z - p.rows)[:, None]], axis=1)))
        *parts, rest = np.split(few, np.cumsum([t.shape[1] for t in torques]), axis=1)
        tried.append(parts)
        free.append(np.zeros((len(few), p.count)))
        free[-1][:, p.places] = rest[:, :-1]
        residual.append(rest[:, -1])
    # a law is the same in all cases
    joined = [np.concatenate(parts) for parts in zip(*tried, strict=True)]
    return [bodies[which] for which, _, _ in choices], joined, np.concatenate(free), np.concatenate(residual)


def _choices(seen: Array) -> list[tuple[int, Array, int]]:
    """Return which speed, the knots in it [rad/s], and whether on the casing (0) or in the bearing (1)."""
    return [
        (which, np.linspace(speed.min(), speed.max(), count), body)
        for (which, speed), count, body in product(enumerate(seen), KNOTS, (0, 1))
    ]


_FEWEST_PERIODS = 10
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
