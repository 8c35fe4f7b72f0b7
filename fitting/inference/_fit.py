"""The fit: initial values, noise levels, minimum, uncertainties; and the fit with a robust loss.

The search avoids wrong minima. In such a minimum, for example, the modelled motion stops at a wrong time, a parameter
is at a bound far from its optimum, or a power law has a wrong exponent.

Parameters are estimated at the level of random torque that the residuals of the model show. Otherwise all parameters
would be dominated by a short interval in which the model fails by a thousand standard deviations. Chi-square,
cross-validation error and tests use the noise of the recording, which does not depend on a model
(`fitting.inference._noise`).

With a robust loss the result is an M-estimate: sum psi(r_i / s) J_i vanishes instead of sum r_i J_i. Here r_i are the
residuals, J_i their derivatives, and psi is the derivative of the loss. The M-estimate is found by least squares on
pseudo-values

    y*_i = m_i + s psi(r_i / s) / <psi'>,

with the model m and the measured scale s, until they converge (P. J. Huber, Robust Statistics, 7.8). The noise of the
pseudo-values has the variance s^2 <psi^2> / <psi'>^2, which is the asymptotic variance of the M-estimate. Therefore a
fit of the pseudo-values, with their noise estimated as usual, has the right covariance without a correction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT, Criteria
from fitting._errors import EstimationError, SimulationError
from fitting.dynamics._model import Model
from fitting.effects._effect import Effect
from fitting.effects._expression import Expr, Tape, divisors, symbols
from fitting.effects._mechanism import GYROSCOPE, MAIN, Mechanism
from fitting.inference._case_data import CaseData, with_free_inertia
from fitting.inference._initial_values import initial_shapes, initial_values, unknown_shapes
from fitting.inference._noise import Noise
from fitting.inference._optimisation import ActiveBounds, Solution, is_far, search, search_widely
from fitting.inference._oscillation import are_smooth
from fitting.inference._parameters import ParameterLayout
from fitting.inference._problem import (
    Problem,
    common_level,
    first_noise,
    measure_noise,
    raised_noise,
    refine_level,
)
from fitting.inference._record import Record
from fitting.inference._result import Fit, outcome
from fitting.inference._sampled import predicted_samples
from fitting.inference._ties import follow
from fitting.inference._trace import attempt, of_model, record_result, with_purpose

Array = NDArray[np.float64]

_OTHER_POWERS = (0.7, 1.35)
"""Further initial exponents of a power law, on either side of 1 [1]. Chosen: chi-square has a minimum on each side of
the exponent of the linear law; with fewer, a fit may end in the wrong minimum; with more, the search takes longer."""
_AT_REST = 0.01
"""The casing counts as at rest if its speed, as a share of its largest speed, is below this value [1]. Chosen: a
smaller value overlooks stops in noise, a larger one takes slow bodies for stopped bodies."""
_MOST_STEPS = 60
"""Number of iterations of a trial search [1]. Chosen: a search that needs more is continued later; with fewer, trials
are too far from their minima to be compared; with more, the search takes longer."""


def search_with_noise(
    problem: Problem, theta: Array, given: Mapping[str, float] | None, *, quick: bool
) -> tuple[Solution, tuple[Noise, ...]]:
    """Return the minimum of a fit and the noise measured at this minimum; `given` are the values given by the user.

    With `quick` the search stops where chi-square is within about 0.01 of its minimum.
    """
    try:
        noise = first_noise(problem, theta)
    except SimulationError:
        # for nearly collinear laws, the regression may give strengths with which the motion diverges
        theta = _without_strengths(problem, theta, given)
        noise = first_noise(problem, theta)
    problem = problem.with_noise(noise)
    problem, theta, held = with_initial_shapes(problem, theta, given)
    active = None
    is_smooth = are_smooth(d.motion for d in problem.data)
    if is_smooth and _comes_to_rest(problem, theta):
        problem, theta, active = _past_stops(problem, theta)
    if held:
        # The other parameters must first adapt to a new law. Until then the residuals contain no information about the
        # shape of the law, and a step of all variables would change this shape arbitrarily.
        found = search(problem.holding(held, theta), theta, quick=True, active=active)
        theta, active = found.theta, found.active
        problem = problem.with_noise(measure_noise(problem, theta))
    others = _other_starts(problem, theta, given)
    found = search_widely(problem, theta, others, quick=quick, active=active)
    noise = measure_noise(problem, found.theta)
    # an oscillation was fitted period by period, so its fit is not in a wrong minimum
    return _with_less_noise(problem, found, noise, quick=quick) if is_smooth else (found, noise)


def _without_strengths(problem: Problem, theta: Array, given: Mapping[str, float] | None) -> Array:
    """Return initial values in which the strengths that were not given are 0, or the allowed value nearest to 0."""
    layout = problem.layout
    names = [n for n in layout.names if layout.parameter(n).role == "amplitude" and n not in (given or {})]
    places = [layout.index[n] for n in names]
    lower, upper = layout.bounds()
    begin = theta.copy()
    begin[places] = np.clip(0.0, lower[places], upper[places])
    return begin


def with_initial_shapes(
    problem: Problem, theta: Array, given: Mapping[str, float] | None, noise: Sequence[Noise] | None = None
) -> tuple[Problem, Array, tuple[str, ...]]:
    """Search initial values of the shape constants that were not given.

    Return the problem at the noise of these values, the initial values, and the names of these constants.
    """
    unknown = unknown_shapes(problem.layout, given)
    if not unknown:
        return problem, theta, ()
    names = {n for n in problem.layout.names if not n.startswith(tuple(f"{e.name}." for e in unknown))}
    shapes = tuple(f"{e.name}.{p.symbol}" for e in unknown for p in e.parameters if p.role == "shape")
    held = tuple(n for n in problem.layout.names if n.partition("@")[0] in shapes)
    return *initial_shapes(problem, theta, unknown, fitted=names <= set(given or ()), noise=noise), held


def _comes_to_rest(problem: Problem, theta: Array) -> bool:
    """Return whether a casing comes to rest or reverses, as measured or in the model."""
    for d in problem.data:
        speed = np.abs(d.initial_speeds[1][:, MAIN])
        if (speed[len(speed) // 20 :] < _AT_REST * speed.max(initial=0.0)).any():
            return True
    return any(p.path.jumps for p in problem.predict(theta))


def _past_stops(problem: Problem, theta: Array) -> tuple[Problem, Array, ActiveBounds | None]:
    """Search without process noise.

    Return the problem with the noise measured at the result, the variables of the result, and its active bounds.

    If the modelled motion stops at a wrong time, the response to a torque is wrong after the stop, and a search would
    not correct the time.
    """
    active = None
    with attempt("a search without process noise", EstimationError):
        found = search(problem.with_white_noise(), theta, quick=True, max_iterations=_MOST_STEPS)
        theta, active = found.theta, found.active
    return problem.with_noise(first_noise(problem, theta)), theta, active


def _with_less_noise(
    problem: Problem, found: Solution, noise: tuple[Noise, ...], *, quick: bool
) -> tuple[Solution, tuple[Noise, ...]]:
    """Search again with less process noise; return the solution that describes the data best, and its noise.

    A fit may be in a wrong minimum for three reasons. First, the modelled motion stops at a wrong time, and the
    response to process noise is computed for this motion. Second, a parameter is at a bound far from its optimum, and
    process noise accounts for the residuals. Third, the model does not describe one of several cases. The parameters
    are then a compromise, and the residuals of all cases are attributed to process noise.
    """
    ends, active = [(found, noise)], found.active
    for levels in _lower_levels(problem, found.theta, noise):
        trial = problem.with_noise([n.at(level) for n, level in zip(noise, levels, strict=True)])
        # at a low noise level a search may reach values at which the model cannot be computed
        with attempt("a search with less process noise"):
            other = search(trial, found.theta, quick=quick, active=active)
            active = other.active
            ends.append((other, measure_noise(trial, other.theta)))
    return min(ends, key=lambda end: _deviance(problem, end[0].theta, end[1]))


def _ends_at_a_bound_with_more_noise(
    problem: Problem, first: Array, last: Array, given: Sequence[Noise], noise: Sequence[Noise]
) -> bool:
    """Return whether a search ended at a bound at which it did not start, with more process noise than was given."""
    reached = problem.layout.at_bound(last) & ~problem.layout.at_bound(first)
    raised = any(n.raised and not g.raised for n, g in zip(noise, given, strict=True))
    return bool(reached.any()) and raised


def _lower_levels(problem: Problem, theta: Array, noise: Sequence[Noise]) -> Iterator[tuple[float, ...]]:
    """Yield levels of the process noise of each case at which a search may end at other values."""
    raised = [n for n in noise if n.raised]
    rests = raised and any((p.path.sense == 0).any() for p in problem.predict(theta))
    if rests or (raised and problem.layout.at_bound(theta).any()):
        yield from dict.fromkeys([tuple(n.least for n in noise), (0.0,) * len(noise)])
    if len(raised) > 1:
        worst = max(raised, key=lambda n: n.excess)
        yield tuple(n.level if n is worst else n.least for n in noise)


def _deviance(problem: Problem, theta: Array, noise: Sequence[Noise]) -> float:
    r, _ = problem.with_noise(noise).residuals(problem.predict(theta))
    return float(r @ r) + sum(n.whitener.log_determinant for n in noise)


def deviance_at_noise_of(base: Fit, other: Fit) -> float:
    """Return the deviance of a fit, or its deviance at the process noise of another fit if this is lower.

    The level of the process noise maximises the restricted likelihood. If this likelihood is flat, the deviance may be
    lower by 10 to 100 at a lower level. A second fit that ends at a lower level would then seem to describe the data
    better.
    """
    if all(o.level >= n.level for n, o in zip(base.noise, other.noise, strict=True)):
        return base.deviance
    noise = [n.at(min(n.level, o.level)) for n, o in zip(base.noise, other.noise, strict=True)]
    problem = base.problem.with_noise(noise)
    with attempt("the base at the noise of a refit"):
        return min(base.deviance, _deviance(problem, search(problem, base.theta).theta, noise))
    return base.deviance


def _other_starts(problem: Problem, theta: Array, given: Mapping[str, float] | None) -> Iterator[Array]:
    """Yield further initial values: the automatic values if some were given, no dry friction, other exponents.

    If dry friction stops the body too early in the model, a search cannot use the measured motion after this stop.
    """
    usual = initial_values(problem, None) if given else theta
    if given:
        yield usual
    model = problem.layout.model
    dry = [
        f"{e.name}.{e.amplitude.symbol}"
        for e in model.effects
        if e.amplitude is not None and _jumps_at_rest(e, model.mechanism.speeds[MAIN])
    ]
    if dry:
        yield initial_values(problem, {**(given or {}), **dict.fromkeys(dry, 0.0)})
    for g in _OTHER_POWERS:
        begin = usual.copy()
        for v in problem.power_laws:
            begin = problem.physical(np.where(np.arange(len(usual)) == v.g, g, problem.transformed(begin)))
        if problem.power_laws:
            yield begin


def _from_other_starts(
    problem: Problem, found: Solution, others: Iterable[Array], *, quick: bool
) -> Solution:
    """If a solution is far from the data, search from further initial values and return the best solution.

    At a low level of random torque a search may have ended in a wrong minimum. At a level as large as the lack of fit,
    it may leave this minimum.
    """
    for begin in others:
        with attempt("a search from further initial values", EstimationError):
            other = search(problem, begin, quick=quick)
            found = other if other.minimum.cost < found.minimum.cost else found
    return found


_GIVEN_UP = 30.0
"""The model does not describe a case if the random torque of the fit, divided by the random torque that the recording
shows, exceeds this value [1]. Chosen: a smaller value gives up recordings with a small lack of fit, a larger one lets a
wrong motion determine shared parameters."""


def _from_separate_fits(
    problem: Problem, found: Solution, noise: tuple[Noise, ...], *, quick: bool
) -> tuple[Solution, tuple[Noise, ...]]:
    """Search again from fits of each case alone; return the solution of a joint fit and its noise.

    If the model does not describe a case even in a separate fit, the random torque of this case absorbs the lack of
    fit, and the other cases are not biased. If the model describes each case alone, the shared parameters differ
    between the cases. With separate levels of random torque, one case would then have hardly any weight, so all cases
    get a common level.
    """
    alone: list[Fit] = []
    with attempt("a case alone"):
        alone.extend(fit(problem.layout.model, [d], quick=True) for d in problem.data)
    if len(alone) < len(problem.data):
        return found, noise
    start = {name: _of_separate_fits(name, alone) for name in problem.layout.names}
    ends = [(found, noise)]
    with attempt("a joint search from the fits of each case alone"):
        ends.append(search_with_noise(problem, initial_values(problem, start), start, quick=quick))
    found, noise = min(ends, key=lambda end: _deviance(problem, end[0].theta, end[1]))
    given_up = any(n.level > _GIVEN_UP * n.pure for n in noise)
    described = all(n.level <= _GIVEN_UP * n.pure for f in alone for n in f.noise)
    return found, common_level(noise) if given_up and described else noise


def _of_separate_fits(name: str, alone: Sequence[Fit]) -> float:
    """Return the value of a variable of a joint fit: the value from its case, or the weighted mean over all cases."""
    key, _, label = name.partition("@")
    chosen = [f.estimates for f in alone if not label or f.labels == (label,)]
    own = [e for found in chosen if (e := found.get(name, found.get(key))) is not None]
    if not own:
        return 0.0  # a fit of a single body does not contain the speed of a rotor
    known = [e for e in own if np.isfinite(e.stderr) and e.stderr > 0]
    if not known:
        return float(np.mean([e.value for e in own]))
    return float(np.average([e.value for e in known], weights=[e.stderr**-2 for e in known]))


_REFINED_ABOVE = 1.5
"""Chi-square per row above which the process noise is estimated again at the minimum [1]. Chosen: a smaller value costs
time, a larger one keeps the noise that was estimated at the initial values."""


def fit(
    model: Model,
    cases: Sequence[Record | CaseData] | Fit,
    *,
    share: Iterable[str] = (),
    per_case: Iterable[str] = (),
    start: Mapping[str, float] | None = None,
    noise: Sequence[Noise] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    ties: Mapping[str, str] | None = None,
    steady: Iterable[str] = (),
    quick: bool = False,
    criteria: Criteria = DEFAULT,
) -> Fit:
    """Fit a model to one case, or to several together (see `fitting.fit`).

    If another fit is given instead of cases, its data are fitted, with its shared and per-case parameters. `noise` is
    the noise of an earlier fit of the same data; it makes both fits comparable. `ranges` are bounds tighter than the
    declared bounds. `ties` are expressions of parameters that follow other parameters, by key. `steady` parameters, by
    their names in the fit, keep their initial values until all other parameters have converged. With `quick`, the
    search stops where chi-square is within about 0.01 of its minimum, which suffices to rank candidates. `criteria`
    determine the noise of cases that are given as a `Record`. An EstimationError is raised if there is nothing to fit,
    or if labels repeat.
    """
    with of_model(model):
        try:
            found = _fitted(
                model, cases, share=share, per_case=per_case, start=start, noise=noise, ranges=ranges, ties=ties,
                steady=steady, quick=quick, criteria=criteria,
            )  # fmt: skip
        except SimulationError as error:
            raise SimulationError(error.message, error.hint or _hint_about_rest(model)) from error
        record_result(found)
        return found


def measured_with(found: Fit, criteria: Criteria) -> Fit:
    """Return a fit, or the same fit repeated from the start if these criteria change the noise of its recordings."""
    if all(d.has_noise_of(criteria) for d in found.problem.data):
        return found
    data = [d.with_criteria(criteria) for d in found.problem.data]
    layout = found.problem.layout
    share, per_case = ([k for k in keys if k in found.model.free] for keys in layout.choices)
    with with_purpose("the fit with other criteria of the noise"):
        return fit(found.model, data, share=share, per_case=per_case, ranges=layout.ranges, ties=layout.ties)


def _fitted(
    model: Model,
    cases: Sequence[Record | CaseData] | Fit,
    *,
    share: Iterable[str],
    per_case: Iterable[str],
    start: Mapping[str, float] | None,
    noise: Sequence[Noise] | None,
    ranges: Mapping[str, tuple[float, float]] | None,
    ties: Mapping[str, str] | None,
    steady: Iterable[str],
    quick: bool,
    criteria: Criteria,
) -> Fit:
    if isinstance(cases, Fit):
        shared, own = ([k for k in keys if k in model.free] for keys in cases.problem.layout.choices)
        if ties is None:
            ties = {k: text for k, text in cases.problem.layout.ties.items() if k in model.free}
        share, per_case, cases = [*shared, *share], [*own, *per_case], cases.problem.data
    data = [c if isinstance(c, CaseData) else CaseData.of(c, criteria) for c in cases]
    _check(model, data)
    layout = ParameterLayout.of(model, [d.record for d in data], share, per_case, ranges, ties)
    problem = Problem.of(layout, data)
    theta = first = follow(initial_values(problem, start), layout.tied)
    given = noise
    active: ActiveBounds | None = None
    if noise is None:
        found, noise = search_with_noise(problem, theta, start, quick=quick)
        if any(n.level > _GIVEN_UP * n.pure for n in noise) and len(data) > 1:
            found, noise = _from_separate_fits(problem, found, noise, quick=quick)
        theta, active = found.theta, found.active
    elif not _free_names(problem) <= set(start or ()):
        # far from the minimum, residuals far exceed the noise; a search at a low noise level would then take long
        problem = problem.with_noise(raised_noise(problem, theta, noise))
        problem, theta, unknown = with_initial_shapes(problem, theta, start, noise)
        found = search(problem.holding(unknown, theta), theta, quick=True)
        theta, active = found.theta, found.active
        noise = refine_level(problem, theta, noise)
    problem = problem.with_noise(noise)
    # parameters of a model without a restoring torque that was fitted to an oscillation have no meaning
    quick = quick or not (model.restoring or are_smooth(d.motion for d in data))
    held = tuple(steady)
    if held:
        found = search(problem.holding(held, theta), theta, quick=True, active=active)
        theta, active = found.theta, found.active
        # at the noise level of the model without the new law, any shape of the law would be consistent with the data
        noise = refine_level(problem, theta, noise)
        problem = problem.with_noise(noise)
    found = search(problem, theta, quick=quick, active=active)
    if given is None and is_far(problem, found):
        found = _from_other_starts(problem, found, _other_starts(problem, first, start), quick=quick)
    noise = refine_level(problem, found.theta, noise)
    problem = problem.with_noise(noise)
    found = search(problem, found.theta, quick=quick, active=found.active)
    if found.minimum.cost > _REFINED_ABOVE * problem.rows:
        noise = refine_level(problem, found.theta, noise, fixed=True)
        problem = problem.with_noise(noise)
        found = search(problem, found.theta, quick=quick, active=found.active)
    if given is not None and _ends_at_a_bound_with_more_noise(problem, first, found.theta, given, noise):
        found, noise = _with_less_noise(problem, found, noise, quick=quick)
        problem = problem.with_noise(noise)
        found = search(problem, found.theta, quick=quick, active=found.active)
    return outcome(problem, found.theta, noise, converged=found.minimum.converged)


def _free_names(problem: Problem) -> set[str]:
    """Return the names of the variables on which the rows depend."""
    return {n for n in problem.layout.names if n.partition("@")[0] not in problem.layout.absent}


def _refuse_other_bodies(model: Model, data: Sequence[CaseData]) -> None:
    """Raise an EstimationError for a chain whose laws name other bodies, or whose bodies come to rest."""
    for record in (d.record for d in data):
        if record.mechanism != model.mechanism:
            raise EstimationError(
                f"the laws contain bodies or joints that the recording {record.label} does not have",
                f"its bodies and joints: {', '.join((*record.mechanism.bodies, *record.mechanism.joints))}",
            )
    if model.mechanism == GYROSCOPE:
        return
    for effect in model.effects:
        for site, speed in model.mechanism.sites[1:]:
            if _jumps_at_rest(effect, speed) and any(_reverses(d, speed) for d in data):
                raise EstimationError(
                    f"{effect.name}: dry friction of {site} cannot be fitted where its speed passes through zero; only "
                    f"{model.mechanism.main}, the first body of the case, may come to rest or reverse.",
                    f"Give the body that comes to rest first, or leave out {effect.name}.",
                )


def _hint_about_rest(model: Model) -> str:
    """Return what to do if dry friction may have brought a body of a chain other than the first to rest."""
    if model.mechanism == GYROSCOPE:
        return ""
    speeds = [speed for _, speed in model.mechanism.sites[1:]]
    dry = [e.name for e in model.effects if any(_jumps_at_rest(e, speed) for speed in speeds)]
    if not dry:
        return ""
    return (
        f"Dry friction ({', '.join(dry)}) may stop a body in the model, but only {model.mechanism.main}, the first "
        "body of the case, may rest. Begin without it, for example with --model linear, and add it later."
    )


def _reverses(data: CaseData, symbol: str) -> bool:
    """Return whether the measured speed of a body or joint has both signs."""
    mechanism, first = data.record.mechanism, data.record.bodies[0]
    time = data.speeds[first.part][0]
    speeds = [np.interp(time, *data.speeds[body]) for body in mechanism.bodies]
    speed = mechanism.motion(speeds)[symbol]
    least = _AT_REST * float(np.abs(speed).max())
    return bool(speed.min() < -least and speed.max() > least)


def _jumps_at_rest(effect: Effect, speed: str) -> bool:
    """Return whether a law jumps where a speed passes through zero, as dry friction does."""
    values = dict.fromkeys(symbols(effect.expression), 1.0)
    if speed not in values:
        return False
    with np.errstate(all="ignore"):
        before, after = (float(Tape([effect.expression])(values | {speed: x})[0]) for x in (-_REST, _REST))
    return abs(after - before) > _JUMP


_REST = 1e-12
"""Speed on either side of rest at which a law is evaluated [rad/s]. Chosen: a continuous law has the same torque at
both speeds; a smaller value is rounding error, a larger one takes a steep law for a jump."""
_JUMP = 1e-3
"""Smallest jump of a law for which dry friction is assumed, if all its parameters are 1 [1]. Chosen: the jump of dry
friction is 2; a smaller value takes a steep law for a jump, a larger one overlooks a part of the torque that jumps."""


def _check(model: Model, data: Sequence[CaseData]) -> None:
    labels = [d.record.label for d in data]
    if not data or len(set(labels)) != len(labels):
        raise EstimationError(
            "the cases of a joint fit need different labels", "give them with --label when making a case"
        )
    known = {d.record.parts for d in data}
    if len(known) > 1:
        raise EstimationError(
            "one body alone and a rotor in its casing cannot be fitted together", "fit them one by one"
        )
    foreign = [e.name for e in model.effects if not e.bodies <= data[0].record.parts]
    if foreign:
        raise EstimationError(
            f"{foreign[0]} needs rotor data, which this record of one body does not have",
            "its laws are those that act on the casing alone: `gyrotrack effects` lists them",
        )
    _refuse_missing_inputs(model, data)
    for effect in model.effects:
        for divisor in divisors(effect.expression):
            if any(_changes_sign(divisor, d, effect.mechanism) for d in data):
                raise EstimationError(
                    f"{effect.name} is singular within the measured motion: a divisor of its law, which no "
                    "parameter changes, passes through zero.",
                    "Write a law that is finite at every measured speed, or make the position of the pole a parameter.",
                )


def _refuse_missing_inputs(model: Model, data: Sequence[CaseData]) -> None:
    """Raise an EstimationError if an input of a law is absent or has another unit, or if a dead time has no law."""
    used = {i for e in model.effects if e.joint != "input" for i in e.inputs}
    for effect in model.effects:
        if effect.joint == "input" and effect.inputs[0] not in used:
            name = effect.inputs[0][0]
            raise EstimationError(
                f"{effect.name} has no influence: no law of the model depends on {name}",
                f"add a law like '{model.mechanism.main}: k*{name}'",
            )
        for name, unit in effect.inputs:
            for record in (d.record for d in data):
                known = {i.name: i.unit for i in record.inputs}
                if name not in known:
                    have = f"it has: {', '.join(known)}" if known else "it has none"
                    raise EstimationError(
                        f"{effect.name} needs the input {name} of {record.label}; {have}",
                        "record the input with `gyrotrack import --input`",
                    )
                if known[name] != unit:
                    raise EstimationError(
                        f"{effect.name} needs the input {name} in the unit {unit}, but the record has it in "
                        f"{known[name]}",
                        "write the law with the inputs of this record",
                    )


def _changes_sign(divisor: Expr, data: CaseData, mechanism: Mechanism = GYROSCOPE) -> bool:
    """Return whether an expression without parameters passes through zero along the measured motion.

    The range of each speed is extended by a tenth on both sides, but not beyond zero, because a trial of the fit may be
    a little slower or faster than the record.
    """
    names = symbols(divisor)
    if not names or not names <= {"t", *(speed for _, speed in mechanism.sites)}:
        return False  # a constant, a parameter that the fit may change, or an angle
    time, speeds = data.initial_speeds
    measured = mechanism.motion(speeds.T)
    motion = {"t": np.concatenate([time, time[[0, -1]]])}
    for name, value in measured.items():
        low, high = float(value.min()), float(value.max())
        margin = 0.1 * (high - low)
        ends = [max(low - margin, min(low, 0.0)), min(high + margin, max(high, 0.0))]
        motion[name] = np.concatenate([value, ends])
    with np.errstate(all="ignore"):
        value = np.asarray(Tape([divisor])(motion)[0])
    return bool(np.nanmin(value, initial=np.inf) < 0 < np.nanmax(value, initial=-np.inf))


Psi = Callable[[Array], tuple[Array, Array]]

_HUBER = 1.345
"""Deviation from which Huber's loss is linear [standard deviations]. Derived: 95 % of the efficiency of least squares
for normal noise."""
_CAUCHY = 2.385
"""Scale of the Cauchy loss [standard deviations]. Derived: 95 % of the efficiency of least squares for normal noise."""
_ITERATIONS = 12
"""Largest number of iterations of a robust fit [1]. Chosen: a smaller number stops before convergence, a larger one
costs time in fits that do not converge."""
_CONVERGED = 0.01
"""Change of the parameters below which a robust fit has converged [standard errors]. Chosen: a smaller value costs
iterations; with a larger one, a bias remains."""


def huber(x: Array) -> tuple[Array, Array]:
    """Return psi and its slope: linear up to 1.345 standard deviations, constant beyond."""
    inside = np.abs(x) <= _HUBER
    return np.clip(x, -_HUBER, _HUBER), inside.astype(float)


def cauchy(x: Array) -> tuple[Array, Array]:
    """Return psi and its slope: x / (1 + (x / 2.385)^2), which tends to zero for outliers."""
    q = (x / _CAUCHY) ** 2
    return x / (1 + q), (1 - q) / (1 + q) ** 2


_LOSSES: dict[str, tuple[Psi, ...]] = {"linear": (), "huber": (huber,), "cauchy": (huber, cauchy)}


def robust_fit(model: Model, cases: Sequence[Record | CaseData], loss: str = "linear", **options: Any) -> Fit:
    """Fit a model with a loss that limits the influence of outliers; `options` are passed to `fit`.

    "linear" is least squares. "huber" limits the influence of a sample. "cauchy" starts at the result of "huber"; the
    influence of an outlier tends to zero. R2, rmse and energy refer to the measured data; chi-square and
    cross-validation error refer to the pseudo-values.
    """
    if loss not in _LOSSES:
        raise EstimationError(f"there is no loss named {str(loss)[:40]!r}", "use linear, huber or cauchy")
    if loss != "linear" and (model.angle_dependent or model.measurement):
        raise EstimationError(
            "a robust loss is not supported with laws of an angle or effects of a camera",
            "fit without them, or with --loss linear",
        )
    criteria = options.get("criteria", DEFAULT)
    known = [c if isinstance(c, CaseData) else CaseData.of(c, criteria) for c in cases]
    _refuse_other_bodies(model, known)
    found = fit(model, with_free_inertia(known, model.names), **options)
    data = found.problem.data
    for psi in _LOSSES[loss]:
        for _ in range(_ITERATIONS):
            pseudo = [_pseudo(d, case, found, psi) for case, d in enumerate(data)]
            before = found.theta
            again: Mapping[str, Any] = options | {"start": found.values}
            found = fit(model, pseudo, **again)
            errors = np.sqrt(np.diag(found.covariance))
            moved = np.abs(found.theta - before) > _CONVERGED * errors
            if not np.any(moved & (errors > 0)):
                break
    return found


def _pseudo(data: CaseData, case: int, found: Fit, psi: Psi) -> CaseData:
    """Return the case with pseudo-values about a fit; its record contains the measured data."""
    runs = []
    measured = (data.record.casing, *data.record.rotor)
    for samples, model in zip(measured, predicted_samples(data, case, found), strict=True):
        x = (samples.value - model) / samples.sigma
        scale = 1.4826 * float(np.median(np.abs(x)))
        influence, slope = psi(x / scale)
        value = model + samples.sigma * scale * influence / max(float(slope.mean()), 0.1)
        runs.append(replace(samples, value=value))
    made = CaseData.of(replace(data.record, casing=runs[0], rotor=tuple(runs[1:])), data.criteria)
    return CaseData(
        data.record, made.casing, made.rotor, free_inertia=data.free_inertia, criteria=data.criteria
    )
