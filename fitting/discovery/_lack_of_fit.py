"""Tests that contradict an answer, and laws outside the library that describe the data as well as the answer.

Every fit has a smooth test (`fitting.inference._smooth_test`) and a periodogram (`fitting.inference._periodogram`).
Answers with an angle-dependent torque have a third test: harmonics of third or higher order in the angle of the casing.
If a test contradicts the fit with the named effect, or without an effect, the answer is not complete.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting._numbers import TORQUE, format_torque
from fitting.discovery._named_effect import FormTest
from fitting.discovery._score import CaseColumns, ScoreContext, score_of_columns
from fitting.discovery._select import Candidate
from fitting.effects._effect import TORQUES, Effect, Parameter, at_site, bodies_of, mechanism_of
from fitting.effects._expression import symbols
from fitting.effects._mechanism import Mechanism
from fitting.inference._fit import fit as fit_model
from fitting.inference._linear_algebra import orthogonal_to, orthonormal, piecewise_linear
from fitting.inference._noise import tail_probability
from fitting.inference._periodogram import PeriodogramPeak
from fitting.inference._problem import Projection
from fitting.inference._result import Fit
from fitting.inference._smooth_test import SPEED_KNOTS, SmoothTest
from fitting.inference._trace import attempt

Array = NDArray[np.float64]


def nonparametric_law(fit: Fit, site: str, speed: str) -> float:
    """Return the fall of the deviance due to a torque, any smooth function of a speed, on a body or in a joint.

    The function is the same in all cases. It is scored like a candidate, without a refit. It is a spline with 4 or 8
    knots, whichever gives the larger fall.
    """
    cases = [CaseColumns(fit, i) for i in range(len(fit.predictions))]
    context = ScoreContext(fit, 1)
    values = [c.along_motion(speed) for c in cases]
    least, most = min(float(x.min()) for x in values), max(float(x.max()) for x in values)
    shares = fit.model.mechanism.shares(site)
    found = []
    for count in SPEED_KNOTS:
        knots = np.linspace(least, most, count)
        shapes = [piecewise_linear(x, knots) for x in values]
        rows = [c.torque_rows(*(x * h for x in shares)) for c, h in zip(cases, shapes, strict=True)]
        found.append(score_of_columns(context, np.concatenate(rows)))
    return max(found)


_RANK = 1e-4
"""A direction is not tested if its singular value, divided by the largest, is below this value [1]. Chosen: a smaller
value tests rounding errors, a larger one omits deviations that are nearly absorbed."""
_RANK_FREE = 1e-7
"""A direction is not projected out if its singular value, divided by the largest, is below this value [1]. Chosen: a
smaller value projects out rounding errors, a larger one ignores some free columns."""
_ORDERS = (3, 4, 5, 6)
"""Orders of the tested harmonics of the angle, which no law of the library has [1]. Chosen: with more orders, the
significance is lower; with fewer, torques of several periods per turn are overlooked."""
_HARMONIC_AMPLITUDE = "harmonic.k"
_FIRST_SHARE = 0.01
"""Largest initial amplitude of a harmonic, as a share of the largest torque [1]. Chosen: with a larger value, the fit
starts from a wrong motion; with a smaller one, it needs more steps."""
_DETERMINED = 2.0
"""Smallest amplitude of a harmonic that counts as determined [standard errors]. Chosen: the p-value is tested first; a
smaller value reports harmonics of noise, a larger one omits weak harmonics."""
_AMPLITUDE_AND_PHASE = (Parameter("k", "N m"), Parameter("phi", "rad", "phase"))


@dataclass(frozen=True)
class HarmonicTest:
    """The most significant harmonic of the residual torque in the angle of the casing, of third or higher order."""

    order: int  # periods per turn
    p_value: (
        float  # probability that noise has a harmonic of this significance (Bonferroni bound over the orders)
    )
    unit: str = TORQUE  # unit of the torque: "N m", or "rad/s2" per unit of inertia
    fit: Fit | None = None  # fit with the harmonic as an effect; None if its amplitude is not determined

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
        # A harmonic of high order hardly moves the body. To describe an error of the motion, it would have to exceed
        # all other torques.
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

    `end` is the fit with `chosen`.
    """
    peak = end.significant_peak(criteria)
    if peak is not None:
        return peak
    if chosen is not None and chosen.effect.depends_on_angle:
        harmonic = harmonic_test(end, criteria)
        if harmonic.p_value < criteria.doubt_adequate:
            return harmonic
    # without an effect, or with an equivalence class, no single law is named
    unnamed = chosen is None or bool(chosen.indistinguishable_from)
    test = end.smooth_test
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
