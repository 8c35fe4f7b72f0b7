"""Share of the unmodelled torque that the named effect explains, and the size of the remainder.

Significance and size are separate questions. The size follows from the net torques T of three fits: the base, the base
with the named effect, and the most complete fit (end). All three are evaluated along the motion of the most complete
fit. R is the unmodelled torque of the most complete fit; it is zero unless its lack of fit is significant. Then

    U = T_end - T_base + R,      explained = 1 - <(U - T_named + T_base)^2> / <U^2>,

where <> is the mean over the record, the bodies and the cases. The mean square torque of a law of an angle follows from
its amplitude k: <(k sin(n psi - phi))^2> = k^2 / 2.

There are three exceptions. First, a named law that does not depend on an angle is compared with the slow torques only.
The reason is that angles measured once per turn do not determine angle-dependent torques, so their estimates may be
large. The message states angle-dependent torques separately. Second, if a second effect is not determined, the
unmodelled torque of the fit with the named effect alone is the better estimate of the remainder; the smaller of the two
estimates is used. Third, if the most complete fit changes only a shape constant of the named law, and the base absorbs
most of the law, the torque of the law itself replaces U.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting._numbers import format_torque, percentage, rounded
from fitting.discovery._lack_of_fit import (
    HarmonicTest,
    harmonic_test,
    unknown_law,
)
from fitting.discovery._named_effect import FormTest, form_test
from fitting.discovery._refine import with_shape_parameter
from fitting.discovery._residuals import ResidualTorque, residual_torques
from fitting.discovery._select import Candidate, Selection, reason_undetermined
from fitting.dynamics._collocation import Sampler
from fitting.dynamics._inputs import values_at
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR
from fitting.effects._effect import TORQUES, Effect, Parameter, at_site, bodies_of
from fitting.effects._expression import Tape, symbols
from fitting.effects._mechanism import GYROSCOPE, MAIN, Mechanism
from fitting.effects._words import effect_name
from fitting.inference._averaging import LARGEST_PHASE_ERROR
from fitting.inference._case_data import CAMERA_COLUMNS, largest_speed
from fitting.inference._fit import fit
from fitting.inference._initial_values import averaged_fit
from fitting.inference._noise import Noise
from fitting.inference._periodogram import PeriodogramPeak
from fitting.inference._problem import fails_grossly
from fitting.inference._result import Fit
from fitting.inference._smooth_test import SmoothTest
from fitting.inference._trace import attempt

Array = NDArray[np.float64]

_POINTS = 2000
"""Number of points of a torque along the motion [1]. Chosen: a smaller number makes the explained share coarse, a
larger one costs time."""


@dataclass(frozen=True)
class Remainder:
    """The unmodelled torque that is still significant with the named effect."""

    torque_rms_Nm: float  # rms torque on the body where it is largest [N m]
    share: float  # share of the mean square unmodelled torque (0-1)
    # smallest p-value of two kinds of tests: likelihood ratio of the further parameters, and lack of fit
    p_value: float
    sentence: str  # the size of the torque and the variable on which it depends, in words
    effects: tuple[str, ...] = ()  # further effects that describe the remainder


_ANGLE_ERRORS = {
    "camera.centre": "once-per-turn error of the angle",
    "camera.tilt": "twice-per-turn error of the angle",
    "camera.shutter": "once-per-turn variation of the delay of the angle",
}
"""Names of the camera effects if the angles are from another sensor, for example an encoder. Derived: the laws of
these effects."""


@dataclass(frozen=True)
class Nuisance:
    """An always fitted camera effect of one case: its amplitude and standard uncertainty."""

    effect: str
    label: str
    value: float
    stderr: float
    unit: str
    p_value: float
    film: bool = True
    """Whether the angles were tracked on film."""

    @property
    def words(self) -> str:
        """Name of the effect; without a film, the name of the equal error of any angle sensor."""
        words = effect_name(self.effect).words
        return words if self.film else _ANGLE_ERRORS.get(self.effect, words)


class Torques:
    """Net torques of several fits of the same data along the motion of the most complete fit, `end`.

    `residual` states that `end` has a significant lack of fit; then its unmodelled torque is added. If the mean square
    unmodelled torque is larger for `end` than for the base, the added effect did not improve the fit, and the base is
    used instead of `end`.
    """

    _mechanism = GYROSCOPE
    _inertias: tuple[str, ...] = (INERTIA_ROTOR, INERTIA_CASING)

    def __init__(self, base: Fit, end: Fit, *, residual: bool) -> None:
        curves = residual_torques(end) if residual else []
        if residual and end is not base:
            of_base = residual_torques(base)
            if _mean_square(of_base) < _mean_square(curves):
                end, curves = base, of_base
        self._base, self._end = base, end
        self._mechanism = end.model.mechanism
        self._inertias = self._mechanism.inertias
        self._time = [np.linspace(*d.record.span, _POINTS) for d in end.problem.data]
        self.unmodelled = self._difference(end)
        if residual:
            slow = {d.record.label: _slow_residual(end, i) for i, d in enumerate(end.problem.data)}
            for curve in curves:
                if slow[curve.label] is None:
                    self._add(curve)
            for label, torque in slow.items():
                if torque is not None:
                    case = end.labels.index(label)
                    self.unmodelled[case][0][MAIN] += np.interp(self._time[case], *torque)

    def _add(self, curve: ResidualTorque) -> None:
        case = self._end.labels.index(curve.label)
        added = np.interp(self._time[case], curve.time, curve.torque, left=0.0, right=0.0)
        self.unmodelled[case][0][self._mechanism.bodies.index(curve.body)] += added

    def remaining(self, named: Fit, *, slow: bool = False) -> tuple[float, float]:
        """Return the unexplained share of the mean square torque, and the largest unexplained rms of a body [N m].

        With `slow`, angle-dependent torques are excluded.
        """
        explained = self._difference(named)
        whole, bodies = np.zeros((2, len(self._mechanism.bodies)))
        for (smooth, harmonics), (fitted, fitted_harmonics) in zip(self.unmodelled, explained, strict=True):
            for body in range(len(bodies)):
                names = {k for k in (*harmonics, *fitted_harmonics) if k[0] == body and not slow}
                own = {k: harmonics.get(k, 0) for k in names}
                mean = float(np.mean(smooth[body] ** 2)) + 0.5 * sum(abs(x) ** 2 for x in own.values())
                whole[body] += mean / len(self.unmodelled)
                rests = sum(abs(x - fitted_harmonics.get(k, 0)) ** 2 for k, x in own.items())
                rest = float(np.mean((smooth[body] - fitted[body]) ** 2)) + 0.5 * rests
                bodies[body] += rest / len(self.unmodelled)
        if bodies.sum() >= whole.sum():  # the fit explains nothing: the whole torque remains
            return float(whole.sum() > 0), float(np.sqrt(whole.max()))
        return float(bodies.sum() / whole.sum()), float(np.sqrt(bodies.max()))

    def of_angle(self, named: Fit) -> float:
        """Return the rms of the unexplained angle-dependent torques on the body where this rms is largest [N m]."""
        bodies = np.zeros(len(self._mechanism.bodies))
        explained = self._difference(named)
        for (_, harmonics), (_, fitted) in zip(self.unmodelled, explained, strict=True):
            for k in {*harmonics, *fitted}:
                rest = abs(harmonics.get(k, 0) - fitted.get(k, 0)) ** 2
                bodies[k[0]] += 0.5 * rest / len(self.unmodelled)
        return float(np.sqrt(bodies.max()))

    def shape_error(self, law: Effect, freed: Effect, fit: Fit) -> tuple[float, float, float]:
        """Return the size of the difference between a law with a free shape and the optimally scaled library law.

        The first number is the mean square of the difference divided by the mean square unmodelled torque. The second
        number is the mean square of the difference divided by the mean square torque of the law with the free shape.
        The third number is the rms of the difference [N m]. `fit` has the parameters of the law with a free shape.
        """
        total, own, unexplained, bodies = 0.0, 0.0, 0.0, np.zeros(len(self._mechanism.bodies))
        for case, t in enumerate(self._time):
            y = Sampler(self._end.predictions[case].path.mesh, t).value(self._end.predictions[case].path.y)
            numbers = fit.problem.layout.numbers(fit.theta, case)
            known: dict[str, Any] = {"t": t, **self._mechanism.motion(y[:, : len(bodies)].T)}
            known |= values_at(self._end.problem.data[case].record.inputs, t)
            known |= {p.symbol: numbers[f"{freed.name}.{p.symbol}"] for p in freed.parameters}
            both = Tape([freed.expression, law.expression])(known)
            torque, unit = (np.asarray(x) * np.ones(len(t)) for x in both)
            rest = float(np.mean((torque - unit * (torque @ unit) / max(float(unit @ unit), 1e-300)) ** 2))
            acts = np.abs(self._mechanism.shares(law.site)) if law.joint in TORQUES else np.zeros(len(bodies))
            unexplained += rest * float(acts.sum())
            own += float(np.mean(torque**2) * acts.sum())
            bodies += rest * acts / len(self._time)
            total += sum(float(np.mean(u**2)) for u in self.unmodelled[case][0])
        of_unmodelled, of_law = (min(unexplained / x, 1.0) if x > 0 else 0.0 for x in (total, own))
        return of_unmodelled, of_law, float(np.sqrt(bodies.max()))

    def _difference(self, fit: Fit) -> list[tuple[list[Array], dict[tuple[int, str], complex]]]:
        """Return T_fit - T_base of each case: smooth torques on the bodies, amplitudes of laws of an angle."""
        found = []
        for case in range(len(self._time)):
            a, b = self._smooth(fit, case), self._smooth(self._base, case)
            with_, without = _amplitudes(fit, case), _amplitudes(self._base, case)
            harmonics = {k: with_.get(k, 0j) - without.get(k, 0j) for k in {*with_, *without}}
            found.append(([x - y for x, y in zip(a, b, strict=True)], harmonics))
        return found

    def _smooth(self, fit: Fit, case: int) -> list[Array]:
        t, path = self._time[case], self._end.predictions[case].path
        fitted = fit.predictions[case].path
        motion, y = Sampler(path.mesh, t).value(path.y), Sampler(fitted.mesh, t).value(fitted.y)
        # speeds and deflection are taken from the common motion; other states, for example a temperature, come from the
        # fit
        for i, name in enumerate(fitted.states[: y.shape[1]]):
            if i < len(self._inertias):
                y[:, i] = motion[:, i]
            elif name == "deflection":
                # the deflection is measured from the equilibrium of the fit, which a constant torque displaces
                common = motion[:, path.states.index(name)]
                y[:, i] = common + (y[:, i].mean() - common.mean())
        numbers = dict(fit.problem.layout.numbers(fit.theta, case))
        if self._end.model.restoring and not fit.model.restoring:
            # if a model without a restoring torque was fitted to an oscillation, its parameters have no meaning
            known = self._end.problem.layout.numbers(self._end.theta, case)
            numbers |= {k: v for k, v in known.items() if k in numbers}
        rates = fit.problem.cases[case].dynamics.rates(t, y, numbers)
        return [numbers[key] * rates[:, i] for i, key in enumerate(self._inertias)]


def _mean_square(curves: Sequence[ResidualTorque]) -> float:
    return float(sum(np.mean(curve.torque**2) for curve in curves))


def _slow_residual(end: Fit, case: int) -> tuple[Array, Array] | None:
    """Return times [s] and unmodelled torque [N m] of an oscillation whose phase the model does not describe.

    The result is None if the model describes the phase.

    Let a be the residual of the amplitude A, p the residual of the phase, and w the angular frequency. The residuals
    are caused by torques per moment of inertia with the amplitudes 2 w a' (in quadrature with the deflection) and 2 w A
    p' (in phase). A torque estimated from the residuals of the angle would contain the deflection times the error of
    the phase. The result is also None if the fit does not fail grossly, the body does not oscillate, or the averaged
    equations do not describe the phase.
    """
    data = end.problem.data[case]
    if not end.model.restoring or not fails_grossly(data, end.predictions[case], end.noise[case]):
        return None
    motion, fitted = data.motion.slow_motion, averaged_fit(end.model, [data])
    if motion is None or fitted is None or not fitted.phase_error < LARGEST_PHASE_ERROR:
        return None
    amplitude, phase = (fitted.rows[0][2] * fitted.scales[0]).reshape(2, -1)
    rate = np.gradient(motion.phase, motion.time)
    quadrature = 2 * rate * np.gradient(amplitude, motion.time)
    inphase = 2 * rate * motion.amplitude * np.gradient(phase, motion.time)
    t = data.motion.time
    at = data.motion.phase(t)
    torque = np.interp(t, motion.time, inphase) * np.cos(at)
    torque = torque - np.interp(t, motion.time, quadrature) * np.sin(at)
    return t, data.record.I_casing * torque


def _amplitudes(fit: Fit, case: int) -> dict[tuple[int, str], complex]:
    """Return the complex amplitude k exp(i phi) of each law of an angle, by body and name [N m]."""
    numbers = fit.problem.layout.numbers(fit.theta, case)
    found: dict[tuple[int, str], complex] = {}
    for e in fit.model.angle_dependent:
        values = {p.role: numbers[f"{e.name}.{p.symbol}"] for p in e.parameters}
        k = values.get("amplitude", 1.0) * np.exp(1j * values.get("phase", 0.0))
        for body, share in enumerate(e.mechanism.shares(e.site)):
            if share:
                found[body, e.name] = complex(k)
    return found


@dataclass(frozen=True)
class Grade:
    """The size of an answer: form, explained share, remainder, and the rivals that explain an equal share.

    `form` is "exact", "approximate", or None if the form is not established. `unknown` is the speed whose smooth law
    describes the data better than the named effect; empty if there is none. If no second effect was tried,
    `unknown_bic` is the BIC of this law at the noise of the fit with the named effect. `test` is the result of the form
    test. If `form` and `remainder` are None, the residuals are consistent with noise, but the form is not established.
    With `noisy`, the reason is that the fit needs more process noise than the recording shows.
    """

    form: str | None
    explained: float | None
    remainder: Remainder | None
    rivals: tuple[str, ...] = ()
    unknown: str = ""
    unknown_bic: float = math.nan
    test: FormTest | None = None
    noisy: bool = False


_INNER_KNOTS = 4
"""Number of inner knots of a smooth law [1]. Chosen: the law represents any cubic, and one sharp bend; with fewer knots
the bend is lost, with more the law absorbs noise."""
_POWERS = {"casing": (2, 3), "rotor": (0, 1, 3), "bearing": (0, 2, 3)}
"""Powers of a speed in a smooth law, by body or joint; the usual base model does not contain these powers [1]. Derived:
from the laws of the reduced model; the powers of casing and bearing also apply to the bodies and joints of a chain."""


def smooth_law(
    site: str,
    speed: str,
    powers: Sequence[int],
    low: float,
    high: float,
    mechanism: Mechanism = GYROSCOPE,
) -> Effect:
    """Return an effect whose law is a cubic spline of a speed.

    The spline consists of the powers in `_POWERS` and of `_INNER_KNOTS` truncated cubes between `low` and `high`
    [rad/s]. It represents any smooth law.
    """
    x = f"(({speed} - {low!r})/{high - low!r})"
    knots = np.linspace(0, 1, _INNER_KNOTS + 2)[1:-1].tolist()
    terms = [f"{x}**{p}" if p else "1.0" for p in powers] + [f"abs({x} - {k!r})**3" for k in knots]
    parameters = tuple(Parameter(f"c{i}", "N m", lower=-np.inf) for i in range(len(terms)))
    law = " + ".join(f"c{i}*{term}" for i, term in enumerate(terms))
    return at_site(f"any law of {speed}", site, law, parameters, mechanism)


def better_law(base: Fit, named: Fit, end: Fit, effect: Effect, criteria: Criteria) -> str:
    """Return the speed whose smooth law describes the data better than the effect; "" if there is none.

    `base` is the fit without the effect, `named` the fit with the effect, `end` the most complete fit.
    """
    bic, speed = min(
        ((f.bic, speed) for f, speed in _with_smooth_laws(base, effect, base.noise)), default=(np.inf, "")
    )
    better = bic < min(named.bic - criteria.evidence, end.bic + criteria.equivalence_width)
    return speed if better else ""


def _with_smooth_laws(base: Fit, effect: Effect, noise: Sequence[Noise]) -> Iterator[tuple[Fit, str]]:
    """Yield the fits in which a smooth law of a speed replaces the effect, and this speed.

    A speed is omitted if the effect is a law of this speed alone. A restoring torque is not replaced, because a body
    under a law of its speed alone does not oscillate.
    """
    if effect.restoring and not base.model.restoring:
        return
    mechanism = effect.mechanism
    for site, speed in mechanism.sites:
        variables = symbols(effect.expression) - {p.symbol for p in effect.parameters}
        foreign = not bodies_of(site, (speed,), mechanism) <= base.problem.data[0].record.parts
        if foreign or (effect.joint in TORQUES and site == effect.site and variables <= {speed}):
            continue
        powers = _POWERS[site if site in _POWERS else "bearing" if site in mechanism.joints else "casing"]
        law = smooth_law(site, speed, powers, *ranges_of(base)[speed], mechanism)
        start = base.values | {f"{law.name}.{p.symbol}": 0.0 for p in law.parameters}
        found = None
        with attempt(f"a smooth law of {speed} instead of {effect.name}"):
            found = fit(base.model.with_effect(law), base, start=start, noise=noise, quick=True)
        if found is not None:
            yield found, speed


def ranges_of(fit: Fit) -> dict[str, tuple[float, float]]:
    """Return the smallest and the largest value of each speed along the fitted motion, over all cases [rad/s]."""
    mechanism = fit.model.mechanism
    count = len(mechanism.speeds)
    found = np.concatenate([p.path.y[..., :count].reshape(-1, count) for p in fit.predictions])
    speeds = mechanism.motion(found.T)
    return {name: (float(v.min()), float(v.max())) for name, v in speeds.items()}


_NO_TORQUE = 1e-12
"""The named effect and the most complete fit count as the same torque if the mean square of their difference, divided
by the mean square torque, is at most this value [1]. Chosen: the rounding error of the difference; a larger value
treats small remainders as zero, a smaller one compares rounding errors."""


def grade(
    base: Fit,
    selection: Selection,
    doubt: SmoothTest | PeriodogramPeak | HarmonicTest | None,
    criteria: Criteria,
    *,
    misfit: bool,
) -> Grade:
    """Return the share of the unmodelled torque that the chosen effect explains, and the remainder.

    `doubt` is the test that contradicts the most complete fit; `misfit` states that this fit has a significant lack of
    fit.
    """
    chosen, end = selection.chosen, selection.final
    if chosen is None or chosen.fit is None:
        return Grade(None, None, None)
    significant = misfit or doubt is not None
    others = [n for n in end.model.names if n not in selection.named.model.names]
    if doubt is None and significant and chosen.effect.depends_on_angle:
        test = harmonic_test(selection.named, criteria)
        if test.p_value < criteria.doubt_adequate:
            # residuals periodic in the angle contradict the answer; a second effect of the speeds does not describe
            # them
            doubt, end, others = test, selection.named, []
    free = [e for e in end.model.effects if _is_freed(e.name, selection)]
    tested = None
    if chosen.physical and chosen.effect.mechanical and not chosen.effect.depends_on_angle:
        tested = form_test(selection.named, chosen.effect, criteria)
    if not significant and not others and not free:
        return _complete(base, selection, chosen, tested, criteria)
    harmonic = doubt.fit if isinstance(doubt, HarmonicTest) else None
    sized = harmonic is not None or not isinstance(doubt, HarmonicTest)
    torques = Torques(base, harmonic or end, residual=significant and harmonic is None)
    slow = not chosen.effect.depends_on_angle
    share, rms = unexplained = torques.remaining(selection.named, slow=slow)
    uncertain = any(
        reason_undetermined(e, end, criteria) for e in end.model.effects if e.name in others and e.amplitude
    )
    if uncertain and slow and 1 - share < criteria.explained and selection.named.converged:
        alone = Torques(base, selection.named, residual=True).remaining(selection.named, slow=True)
        share, rms = unexplained = min(unexplained, alone)
    whole = (
        "slow unmodelled torque" if slow and torques.of_angle(selection.named) > 0 else "unmodelled torque"
    )
    for e in free if not others else []:
        of_unmodelled, of_law, difference = torques.shape_error(_named(selection, e.name), e, end)
        # the fit with the fixed shape may be in another minimum; then the difference from the law with the free shape
        # is the better estimate
        share, rms = unexplained = min(unexplained, (of_unmodelled, difference))
        if not significant and of_law <= 1 - criteria.explained < share:
            # if the base absorbs most of the law, a small deviation of the law is a large part of the remainder
            share, rms, whole = of_law, difference, f"torque of the {end.name(e).words}"
    parts = [
        f"shape of the {end.name(e).words}: {_shape(end, e.name, e.parameters[-1].symbol)}" for e in free
    ]
    parts += [f"second effect {'; '.join(str(end.name(n)) for n in others)}"] if others else []
    of_angle = torques.of_angle(selection.named) if slow else 0.0
    if of_angle > 0:
        parts.append(f"an angle-dependent torque of {format_torque(of_angle, unit=base.torque_unit)} rms")
    p = _likelihood_ratio(selection.named, end)
    if significant:
        found = doubt if doubt is not None else end.smooth_test
        p = min(p, end.lack_of_fit.p_value, found.p_value)
        weak = f" (p = {found.p_value:.1g})" if found.p_value >= criteria.doubt_adequate else ""
        parts.append(
            f"it {found.words}{weak}"
            if found.p_value < criteria.doubt_named
            else "a lack of fit of unknown form"
        )
    # a contradicting test, for example of a sinusoidal torque, states the size of its own torque
    size = (
        f" {format_torque(rms, unit=base.torque_unit)} rms, {percentage(share)} of the mean square {whole}"
        if share > _NO_TORQUE and sized
        else ""
    )
    words = f"Remainder{size}: {'; '.join(parts)}."
    remainder = Remainder(rms, share, p, words, tuple(others))
    if 1 - share < criteria.explained:
        return Grade(None, 1 - share, remainder, test=tested)
    unknown = (
        ""
        if chosen.effect.depends_on_angle
        else better_law(base, selection.named, end, chosen.effect, criteria)
    )
    if unknown:
        return Grade(None, 1 - share, remainder, unknown=unknown, test=tested)
    # a rival is equivalent if its score is lower by at most the lack of fit of the fit with the chosen effect
    excess = max(selection.named.lack_of_fit.chi2 - selection.named.lack_of_fit.dof, 0.0)
    margin = max(excess, selection.named.deviance - end.deviance)
    rivals = tuple(
        c.effect.name
        for c in selection.candidates
        if c is not chosen and c.physical == chosen.physical and c.significant and c.fit is not None
        if c.effect.name != chosen.effect.name
        if c.score > chosen.score - margin and torques.remaining(c.fit, slow=slow)[0] < 2 * unexplained[0]
    )
    return Grade("approximate", 1 - share, remainder, rivals, test=tested)


def _complete(
    base: Fit, selection: Selection, chosen: Candidate, tested: FormTest | None, criteria: Criteria
) -> Grade:
    """Return the grade of an effect that makes the residuals consistent with noise.

    Smooth laws of other speeds are rivals if BIC does not separate them from the effect. The form is not established if
    these data could not refute it, or if a smooth law fits as well, regardless of its number of parameters. The same
    holds for an equivalence class.
    """
    if tested is None:
        return Grade("exact", 1.0, None)
    named = selection.named
    laws = list(_with_smooth_laws(base, chosen.effect, named.noise))
    best, speed = min(laws, key=lambda item: item[0].bic, default=(named, ""))
    if best.bic < named.bic - criteria.shape_evidence:
        share, rms = Torques(base, best, residual=False).remaining(named)
        words = f"Remainder {format_torque(rms, unit=base.torque_unit)} rms: the torque is another function of {speed}."
        p_value = _likelihood_ratio(named, best)
        remainder = Remainder(rms, share, p_value, words)
        return Grade(None, 1 - share, remainder, unknown=speed, unknown_bic=best.bic, test=tested)
    width = criteria.equivalence_width
    rivals = tuple(unknown_law(speed) for f, speed in laws if f.bic < named.bic + width)
    replaceable = any(f.deviance < named.deviance + width for f, _ in laws)
    established = tested.is_strong(criteria) and not tested.any_in_time and not replaceable
    return Grade("exact" if established else None, 1.0, None, rivals, test=tested)


def _likelihood_ratio(smaller: Fit, larger: Fit) -> float:
    """Return the p-value of the likelihood ratio of two nested fits; 1 if the larger fit has no more parameters."""
    from scipy.special import chdtrc

    more = len(larger.theta) - len(smaller.theta)
    return float(chdtrc(more, max(smaller.deviance - larger.deviance, 0.0))) if more > 0 else 1.0


def _named(selection: Selection, name: str) -> Effect:
    return next(e for e in selection.named.model.effects if e.name == name)


def _is_freed(name: str, selection: Selection) -> bool:
    before = {e.name: e for e in selection.named.model.effects}
    now = {e.name: e for e in selection.final.model.effects}
    return name in before.keys() & now.keys() and with_shape_parameter(before[name]) == now[name]


def _shape(fit: Fit, name: str, symbol: str) -> str:
    e = fit.estimates[f"{name}.{symbol}"]
    what = {"n": "exponent", "w": "width"}.get(symbol, symbol)
    return f"{what} {rounded(e.value, e.stderr, '' if e.unit == '1' else e.unit)}"


_POWER_OF_SPEED = {"camera.shutter": 1, "camera.blur": 2}
"""Exponent n of each camera effect: its amplitude multiplied by the n-th power of the speed is an angle [1]. Derived:
the laws of these effects in the library."""


def nuisance_parameters(fit: Fit) -> list[Nuisance]:
    """Return the amplitudes of the nuisance camera effects of each case.

    The amplitudes (with their priors) and the free parameters are estimated together by generalised least squares, at
    the noise level of the lack-of-fit tests. An amplitude is the root of the sum of the squares of the cosine and sine
    coefficients; its p-value follows from chi-square with two degrees of freedom.
    """
    from fitting.effects._library import LIBRARY

    found = []
    moving = ~fit.problem.layout.at_bound(fit.theta)
    for data, p, n in zip(fit.problem.data, fit.predictions, fit.noise, strict=True):
        if not data.has_camera_prior:
            continue
        columns = np.concatenate([p.jacobian[:, moving], data.nuisance], axis=1)
        size = np.linalg.norm(columns, axis=0)
        size[size == 0] = np.inf
        whitener = n.whitener.at(n.tested)
        white, r = whitener(columns / size), whitener(data.z - p.rows)
        first = columns.shape[1] - 2 * len(CAMERA_COLUMNS)
        speed = largest_speed(data.casing.samples)
        gram = np.linalg.pinv(white.T @ white, rcond=1e-12, hermitian=True)
        value = (gram @ (white.T @ r)) / size
        covariance = gram / np.outer(size, size)
        for name, places in CAMERA_COLUMNS.items():
            if not data.camera_columns[:, list(places)].any():
                continue
            at = [first + i for i in places]
            pair, cov = value[at], covariance[np.ix_(at, at)]
            amplitude = float(np.hypot(*pair))
            direction = pair / max(amplitude, 1e-300)
            stderr = float(np.sqrt(max(direction @ cov @ direction, 0.0)))
            chi2 = float(pair @ np.linalg.pinv(cov, hermitian=True) @ pair)
            scale = speed ** _POWER_OF_SPEED.get(name, 0)
            unit = next(q.unit for q in LIBRARY[name].parameters if q.role == "amplitude")
            found.append(
                Nuisance(
                    name,
                    data.record.label,
                    amplitude / scale,
                    stderr / scale,
                    unit,
                    math.exp(-0.5 * chi2),
                    film=data.record.tracked,
                )
            )
    return found
