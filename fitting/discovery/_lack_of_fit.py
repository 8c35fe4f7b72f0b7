"""Lack-of-fit tests of a fit with its named law: smooth tests, nonparametric laws, periodogram.

Smooth tests. If a law has the wrong shape, the residual torque is a smooth function of the speed on which the true law
depends. This function is the same in all cases, and few numbers describe it. The model is extended by torques that are
piecewise linear in the speed of the casing, the rotor or the bearing, with 4 or 8 knots; they act on the casing or in
the bearing. Let S be the responses of one choice, orthogonal to the free columns. Then chi-square falls by

    chi2 = r'S (S'S)^-1 S'r,

which has rank(S) degrees of freedom if no torque is missing. This is a smooth test at several resolutions (J. Hart,
Nonparametric Smoothing and Lack-of-Fit Tests, Springer (1997), ch. 5-7). The smallest p-value of all choices is
calibrated by null data that are tested with the same choices.

Periodogram. A sinusoidal torque in time (a vibrating table, a fan) is fast. Process noise of short correlation time
therefore absorbs its variance, but not its single frequency. The model is extended by a cosine and a sine of each
frequency on the casing. With their whitened responses S, orthogonal to the free columns,

    chi2 = r'S (S'S)^-1 S'r

has 2 degrees of freedom if no torque is missing; it is twice the power z of a periodogram. The probability that noise
exceeds z at some frequency up to f is

    p = W sqrt(z) exp(-z),   W = f sqrt(4 pi var t)

(R. Baluev, Mon. Not. R. Astron. Soc. 385, 1279 (2008), eq. 6). Torques with fewer than ten periods in the record are
left to the test against slow torques.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting._numbers import TORQUE
from fitting.discovery._named_effect import FormTest
from fitting.discovery._residuals import format_torque
from fitting.discovery._score import CaseColumns, ScoreContext, over_many_tests, score_of_columns
from fitting.discovery._select import Candidate
from fitting.dynamics._collocation import Sampler
from fitting.effects._effect import TORQUES, Effect, Parameter, at_site, bodies_of, mechanism_of
from fitting.effects._expression import symbols
from fitting.effects._mechanism import GYROSCOPE, MAIN, Mechanism
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._fit import fit as fit_model
from fitting.inference._linear_algebra import orthogonal_to, orthonormal, piecewise_linear
from fitting.inference._metrics import FewRows
from fitting.inference._noise import Noise, TorqueResponse, tail_probability
from fitting.inference._problem import Projection
from fitting.inference._result import Fit
from fitting.inference._spectral_lines import false_alarm_probability
from fitting.inference._trace import attempt

Array = NDArray[np.float64]

KNOTS = (4, 8)
"""Knots of the piecewise linear torques of a speed, coarse and fine [1]. Chosen: fewer overlook narrow deviations, more
lower the power for broad ones."""


def speeds(times: Array, prediction: Prediction, mechanism: Mechanism = GYROSCOPE) -> Array:
    """Return the speeds of casing, rotor and bearing, or of all bodies and joints, shape (3, times) [rad/s]."""
    path = prediction.path
    motion = mechanism.motion(Sampler(path.mesh, times).value(path.y)[:, : path.speeds].T)
    main = mechanism.speeds[MAIN]
    return np.stack([motion[main], *(v for s, v in motion.items() if s != main)])


def nonparametric_law(fit: Fit, site: str, speed: str) -> float:
    """Return the fall of the deviance by any smooth function of a speed as a torque on a body or in a joint.

    The function is the same in all cases. It is scored like a candidate, without a refit; the larger fall with 4 or 8
    knots counts.
    """
    cases = [CaseColumns(fit, i) for i in range(len(fit.predictions))]
    context = ScoreContext(fit, 1)
    values = [c.along_motion(speed) for c in cases]
    least, most = min(float(x.min()) for x in values), max(float(x.max()) for x in values)
    shares = fit.model.mechanism.shares(site)
    found = []
    for count in KNOTS:
        knots = np.linspace(least, most, count)
        shapes = [piecewise_linear(x, knots) for x in values]
        rows = [c.torque_rows(*(x * h for x in shares)) for c, h in zip(cases, shapes, strict=True)]
        found.append(score_of_columns(context, np.concatenate(rows)))
    return max(found)


_RANK = 1e-4
"""Singular values, relative to the largest, below which a direction is not tested [1]. Chosen: a smaller value tests
rounding errors, a larger one omits deviations that are nearly absorbed."""
_RANK_FREE = 1e-7
"""Singular values, relative to the largest, below which a direction is not projected out [1]. Chosen: a smaller value
projects out rounding errors, a larger one ignores some free columns."""
_TINY = 1e-300
"""Smallest norm by which a column is divided [1]. Derived: it avoids a division by zero and is below any other norm."""
_DRAWS = 2000
"""Null data sets for the smallest of several p-values [1]. Chosen: fewer make p-values coarser than
`Criteria.doubt_adequate`, more cost time."""


@dataclass(frozen=True)
class SmoothTest:
    """The body or joint on whose speed the residual torque depends most clearly, and the p-value (an upper bound)."""

    body: str
    p_value: float

    @property
    def words(self) -> str:
        """The predicate of a sentence about the residual torque."""
        return f"depends on the speed of the {self.body}"


def smooth_test(fit: Fit) -> SmoothTest:
    """Return the speed on which the residual torque depends most significantly; p = 1 if no torque can be tested."""
    named, tried, free, residual, shares = _smooth_rows(fit)
    basis = orthonormal(free, _RANK_FREE)
    projected = orthogonal_to(basis, residual)
    columns = [(name, _orthogonal(s, basis)) for name, s in zip(named, tried, strict=True)]
    columns = [(name, s) for name, s in columns if s.size]
    if not columns:
        return SmoothTest("", 1.0)
    # all columns are in a space of few dimensions; white noise remains white in this space
    whole = orthonormal(np.concatenate([s for _, s in columns], axis=1), _RANK_FREE)
    tests = [s.T @ whole for _, s in columns]
    data = whole.T @ projected
    found = [float(tail_probability(np.sum((t @ data) ** 2), len(t), fit.noise, shares)) for t in tests]
    null = _p_values(tests, np.random.default_rng(0).standard_normal((whole.shape[1], _DRAWS)))
    best = int(np.argmin(found))
    return SmoothTest(columns[best][0], over_many_tests(found[best], null.min(axis=0)))


def _orthogonal(columns: Array, basis: Array) -> Array:
    """Return an orthonormal basis of the components of columns that are orthogonal to `basis`."""
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), _TINY)
    columns = orthogonal_to(basis, columns)
    return orthonormal(columns[:, np.linalg.norm(columns, axis=0) > _RANK_FREE], _RANK)


def _p_values(tests: list[Array], rows: Array) -> Array:
    """Return the p-values, shape (tests, data sets)."""
    from scipy.special import chdtrc

    return np.array([chdtrc(len(test), np.sum((test @ rows) ** 2, axis=0)) for test in tests])


def _smooth_rows(fit: Fit) -> tuple[list[str], list[Array], Array, Array, list[float]]:
    """Return names, tested columns, free columns, residual, and shares of the process noise.

    The columns and the residual are whitened rows of all cases; a name and its columns belong to one choice.
    """
    cases = list(zip(fit.problem.data, fit.predictions, fit.noise, strict=True))
    responses = [TorqueResponse(data, p.motion) for data, p, _ in cases]
    values = [
        speeds(r.centres, p, fit.model.mechanism) for r, (_, p, _) in zip(responses, cases, strict=True)
    ]
    record = cases[0][0].record
    bodies = (*(b.name for b in record.bodies), *record.joints)
    choices = _choices(np.concatenate(values, axis=1)[: len(bodies)], len(responses[0].random))
    found, widths = [], np.cumsum([len(knots) for _, knots, _ in choices])[:-1]
    for response, speed, (data, p, noise) in zip(responses, values, cases, strict=True):
        acting = response.random
        torques = [acting[body] @ piecewise_linear(speed[which], knots) for which, knots, body in choices]
        rows = np.zeros((len(data.z), sum(t.shape[1] for t in torques)))
        rows[: len(response.casing)] = np.concatenate(torques, axis=1)
        found.append(FewRows.of(data, p, noise, rows))
    tried, free, residual, shares = zip(*found, strict=True)
    joined = np.split(np.concatenate(tried), widths, axis=1)
    names = [bodies[which] for which, _, _ in choices]
    return names, joined, np.concatenate(free), np.concatenate(residual), list(shares)


def _choices(values: Array, torques: int = 2) -> list[tuple[int, Array, int]]:
    """Return the index of the speed, the knots [rad/s], and the place of the torque: casing (0) or joint (from 1)."""
    return [
        (which, np.linspace(speed.min(), speed.max(), count), body)
        for (which, speed), count, body in product(enumerate(values), KNOTS, range(torques))
    ]


_FEWEST_PERIODS = 10
"""Smallest number of periods in a record at which a frequency is tried [1]. Chosen: with fewer, the torque is a trend,
which the test against slow torques covers; a larger value leaves a gap between the two tests."""
_PER_PEAK = 2
"""Trial frequencies per width of a peak, 2 pi divided by the length of the record [1]. Chosen: fewer overlook peaks,
more cost time; the finer search follows."""
_FINER = 16
"""Trial frequencies of the finer search about the highest peak, per coarse step [1]. Chosen: fewer understate the peak,
more cost time."""
_RETAINED = 1e-3
"""Smallest share of the response to a torque that is orthogonal to the free columns [1]. Chosen: a smaller value tests
rounding errors, a larger one omits torques that are nearly absorbed."""


_NEAR_RESONANCE = 0.01
"""Smallest difference of the squared frequencies of a drive and an oscillator, divided by that of the oscillator [1].
Chosen: a smaller value gives unlimited angles, a larger one understates a resonance."""


@dataclass(frozen=True)
class PeriodogramPeak:
    """The highest peak of the periodogram of the residual torque on one body."""

    rate: float  # its frequency, 2 pi divided by the period [rad/s]
    torque: float  # its amplitude [N m]
    angle: float  # amplitude of the angle that the torque causes [rad]; k / (I w^2) far above a resonance
    label: str  # the case
    body: str  # name of the body for the user, for example "casing"
    p_value: float  # probability that noise has a peak of this height (an upper bound)
    unit: str = TORQUE  # unit of the torque: "N m", or "rad/s2" per unit of inertia
    site: str = "casing"  # the body in laws

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


def periodogram_peak(fit: Fit) -> PeriodogramPeak | None:
    """Return the most significant peak of the periodograms of all cases; None if no record is long enough.

    A camera may have a systematic error of a single frequency that is smaller than the noise of one angle. The p-value
    of a peak with such a small angle is therefore 1 if the recording was tracked on film.
    """
    cases = list(zip(fit.problem.data, fit.predictions, fit.noise, strict=True))
    peaks = [peak for case in cases if (peak := _highest_peak(*case, len(cases))) is not None]
    return min(peaks, key=lambda peak: peak.p_value, default=None)


def significant_peak(fit: Fit, criteria: Criteria) -> PeriodogramPeak | None:
    """Return the most significant peak if it contradicts an adequate fit (`Criteria.doubt_adequate`), else None."""
    peak = periodogram_peak(fit)
    return peak if peak is not None and peak.p_value < criteria.doubt_adequate else None


def _highest_peak(data: CaseData, prediction: Prediction, noise: Noise, cases: int) -> PeriodogramPeak | None:
    """Return the highest peak of one of `cases` cases; None if its record is too short."""
    periodogram = _Periodogram(data, prediction, noise)
    lowest, highest, step = periodogram.band
    if highest <= lowest:
        return None
    coarse = np.arange(lowest, highest, step)
    peak = coarse[int(np.argmax(periodogram(coarse)[0]))]
    fine = np.linspace(peak - step, peak + step, 2 * _FINER + 1)
    power, torque = periodogram(fine)
    top = int(np.argmax(power))
    k, rate = float(torque[top]), float(fine[top])
    motion, record = data.motion, data.record
    # amplitude of the angle of a driven oscillator without damping, or of a free body
    stiffness = (2 * np.pi / motion.period) ** 2
    angle = k / (record.I_casing * max(abs(stiffness - rate**2), _NEAR_RESONANCE * stiffness))
    credible = not record.tracked or angle > float(np.median(record.casing.sigma))
    # if the model loses the phase, the residual is the whole motion, which no additional torque explains
    credible = credible and angle < motion.amplitude
    share = periodogram.share(rate)
    p_values = [
        false_alarm_probability(
            float(power[top]) / (1 - share + share * x), (highest - lowest) / (2 * np.pi), periodogram.span
        )
        for x in noise.process.ratios
    ]
    p_value = min(cases * float(np.dot(p_values, noise.process.weights)), 1.0) if credible else 1.0
    site = record.mechanism.main
    return PeriodogramPeak(rate, k, angle, record.label, record.body, p_value, record.torque_unit, site)


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


_ORDERS = (3, 4, 5, 6)
"""Orders of the harmonics of the angle that no law of the library has [1]. Chosen: more orders cost significance, fewer
overlook torques of several periods per turn."""
_HARMONIC_AMPLITUDE = "harmonic.k"
_FIRST_SHARE = 0.01
"""Largest initial amplitude of a harmonic, as a share of the largest torque [1]. Chosen: a larger value starts in a
wrong motion, a smaller one needs more steps."""
_DETERMINED = 2.0
"""Smallest amplitude of a harmonic that counts as determined [standard errors]. Chosen: a smaller value reports
harmonics of noise, a larger one omits weak ones; the p-value is tested first."""
_AMPLITUDE_AND_PHASE = (Parameter("k", "N m"), Parameter("phi", "rad", "phase"))


@dataclass(frozen=True)
class HarmonicTest:
    """The most significant harmonic of the residual torque in the angle of the casing, of third or higher order."""

    order: int  # periods per turn
    p_value: (
        float  # probability that noise has a harmonic of this significance (Bonferroni bound over the orders)
    )
    unit: str = TORQUE  # unit of the torque: "N m", or "rad/s2" per unit of inertia
    fit: Fit | None = None  # with the harmonic as an effect; None if its amplitude is not determined

    @property
    def words(self) -> str:
        """The predicate of a sentence about the residual torque."""
        size = "of undetermined amplitude"
        if self.fit is not None:
            k = self.fit.estimates[_HARMONIC_AMPLITUDE]
            size = f"amplitude {format_torque(abs(k.value), k.stderr, self.unit)}"
        return f"contains harmonic {self.order} of psi_c, {size}"


def harmonic_test(fit: Fit, criteria: Criteria) -> HarmonicTest:
    """Return the most significant harmonic of the angle of the casing that no law of the library describes.

    The statistic chi2 = r'S (S'S)^-1 S'r has 2 degrees of freedom per case. S contains the whitened responses to
    sin(n psi) and cos(n psi), orthogonal to the free columns. In slow turns the motion is not linear in these torques,
    so the amplitude of this regression is wrong; the amplitude of a significant harmonic is therefore fitted.
    """
    found, start = HarmonicTest(0, 1.0), {}
    others = [np.abs(CaseColumns(fit, i).typical_torque).max() for i in range(len(fit.problem.cases))]
    for e in fit.model.effects:
        if e.depends_on_angle and e.amplitude is not None:
            key = f"{e.name}.{e.amplitude.symbol}"
            others += [abs(x.value) for name, x in fit.estimates.items() if name.partition("@")[0] == key]
    mechanism = mechanism_of(fit.model.effects)
    for order in _ORDERS:
        law = _harmonic_law(order, mechanism)
        chi2, torque, phase, count, shares = 0.0, 0.0, 0.0, 0, []
        for index, (data, p, n) in enumerate(zip(fit.problem.data, fit.predictions, fit.noise, strict=True)):
            if data.measured_angle is None:
                shares.append(0.0)
                continue
            numbers = fit.problem.layout.numbers(fit.theta, index)
            sine, cosine = fit.problem.cases[index].unit_columns(law, p.path, p.sensitivity, numbers)
            project = Projection(data, n.whitener.at(n.tested))
            basis = orthonormal(project(p.columns), _RANK_FREE)
            rows = project(np.stack([sine, cosine, data.z - p.rows], axis=1))
            rows = orthogonal_to(basis, rows)
            s, r = rows[:, :2], rows[:, 2]
            shares.append(project.whitener.share(orthonormal(s, _RANK)))
            gamma = np.linalg.pinv(s.T @ s, hermitian=True) @ (s.T @ r)
            chi2, count = chi2 + float(gamma @ (s.T @ r)), count + 2
            if np.hypot(*gamma) > torque:
                torque, phase = float(np.hypot(*gamma)), math.atan2(gamma[1], gamma[0])
        single = float(tail_probability(chi2, count, fit.noise, shares)) if count else 1.0
        p_value = min(1.0, len(_ORDERS) * single)
        # a torque of high order hardly moves the body; to describe an error of the motion, it has to exceed all others
        if p_value < found.p_value and torque <= max(others):
            found = HarmonicTest(order, p_value, fit.torque_unit)
            start = {_HARMONIC_AMPLITUDE: min(torque, _FIRST_SHARE * max(others)), f"{law.name}.phi": phase}
    if found.p_value >= criteria.doubt_adequate:
        return found
    with attempt(f"harmonic {found.order} of the angle"):
        model = fit.model.with_effect(_harmonic_law(found.order, mechanism))
        fitted = fit_model(model, fit, start=fit.values | start, noise=fit.noise, quick=True)
        k = fitted.estimates[_HARMONIC_AMPLITUDE]
        if _DETERMINED * k.stderr < abs(k.value) <= max(others):
            return replace(found, fit=fitted)
    return found


def _harmonic_law(order: int, mechanism: Mechanism) -> Effect:
    law = f"k*sin({order}*{mechanism.main_angle} - phi)"
    return at_site("harmonic", mechanism.main, law, _AMPLITUDE_AND_PHASE, mechanism)


def unknown_law(speed: str) -> str:
    """Return the name of a law of a speed that is not an effect of the library."""
    return f"{_UNKNOWN}{speed}"


def is_unknown(name: str) -> bool:
    """Return whether a rival is not an effect of the library: another law of a speed, or a torque in time."""
    return name.startswith(_UNKNOWN) or name == UNKNOWN_IN_TIME


_UNKNOWN = "another law of "
UNKNOWN_LAWS = {speed: unknown_law(speed) for speed in ("omega_c", "omega_r", "delta")}
UNKNOWN_IN_TIME = "a torque that changes slowly in time"


def contradiction(
    chosen: Candidate | None, end: Fit, criteria: Criteria
) -> SmoothTest | PeriodogramPeak | HarmonicTest | None:
    """Return the lack-of-fit test that contradicts an answer (the effect `chosen`, or no effect); None if no test does.

    `end` is the fit with this effect.
    """
    peak = significant_peak(end, criteria)
    if peak is not None:
        return peak
    if chosen is not None and chosen.effect.depends_on_angle:
        harmonic = harmonic_test(end, criteria)
        if harmonic.p_value < criteria.doubt_adequate:
            return harmonic
    # no law is named if there is no effect or an equivalence class
    unnamed = chosen is None or bool(chosen.indistinguishable_from)
    test = smooth_test(end)
    return test if test.p_value < (criteria.doubt_adequate if unnamed else criteria.doubt_named) else None


def nonparametric_rivals(
    fit: Fit, chosen: Candidate | None, test: FormTest | None, criteria: Criteria
) -> tuple[str, ...]:
    """Return the nonparametric torques that explain as much as the named effect or its equivalence class.

    `fit` does not contain the effect. A law of one speed can resemble a law of another speed on another body. A law
    with a free time constant or frequency can resemble any slow torque in time.
    """
    if chosen is None or not chosen.physical:
        return ()
    least = max(chosen.score, chosen.screened.score) - criteria.equivalence_width
    effect, bodies = chosen.effect, fit.problem.data[0].record.parts
    variables = symbols(effect.expression) - {p.symbol for p in effect.parameters}
    found = [
        unknown_law(speed)
        for site, speed in effect.mechanism.sites
        if not (effect.joint in TORQUES and effect.site == site and variables <= {speed})
        and bodies_of(site, (speed,), effect.mechanism) <= bodies
        and nonparametric_law(fit, site, speed) > least
    ]
    if test is not None and test.any_in_time:
        found.append(UNKNOWN_IN_TIME)
    return tuple(found)
