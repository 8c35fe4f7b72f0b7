"""Refits of the base model with candidate effects; the chosen refit is continued to full convergence.

A refit starts at the optimum of the base and at the strength and shape of the score of the effect. All parameters vary.
The changepoint t0 of a refit is then scanned through its neighbourhood, while all other parameters follow linearly:

    cost(t0) = | M (z - rows(t0)) |^2,   M = 1 - J (J'J)^-1 J'.

Here z are the rows of the data, and J contains the columns of all other parameters. Another refit starts at the
minimum. If the process noise of one case of a joint fit remains high, its changepoint is far from the true time. The
reason is that the missing effect biased the shared parameters when the changepoint was scored. After a refit the other
cases determine the shared parameters, and the whole record of this case is scored again.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT, Criteria
from fitting._errors import SimulationError
from fitting.discovery._score import CaseColumns, Score, ScoreContext, score_in_case
from fitting.dynamics._model import Model
from fitting.effects._effect import Effect, Parameter
from fitting.effects._mechanism import MAIN
from fitting.inference._fit import fit
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._noise import Noise
from fitting.inference._oscillation import are_smooth
from fitting.inference._result import Fit
from fitting.inference._speed_residuals import holds_moving_body
from fitting.inference._trace import attempt, with_purpose

Array = NDArray[np.float64]

_NEIGHBOURHOOD = 0.04
"""Width of the scanned neighbourhood of a changepoint, as a share of the record [1]. Chosen: with a smaller value, the
refit remains in a local minimum; with a larger one, the motion is not linear in the changepoint."""
_STEPS = 48
"""Number of trial times in the neighbourhood of a changepoint [1]. Chosen: a smaller number overlooks the minimum, a
larger one costs time."""
_SEARCHES = 3
"""Largest number of searches for changepoints in cases with a high remaining process noise [1]. Chosen: with fewer,
some cases keep a wrong changepoint; with more, the search takes longer."""
_RANK = 1e-7
"""Relative singular value below which a free direction is rounding error [1]. Chosen: a smaller value projects out
rounding errors, a larger one ignores some free columns."""


def refined(found: Fit, criteria: Criteria = DEFAULT) -> Fit:
    """Return a quick fit continued to full convergence."""
    with with_purpose("to full convergence"):
        converged = refitted_at(found, found.noise)
    return at_lowest_noise(converged, criteria)


def has_less_process_noise(fit: Fit, than: Fit, criteria: Criteria) -> bool:
    """Return whether a case has clearly less random torque in `fit` than in the fit `than` (`Criteria.quieter`)."""
    return any(n.level < criteria.quieter * old.level for n, old in zip(fit.noise, than.noise, strict=True))


def has_model_noise(found: Fit) -> bool:
    """Return whether a fit has more random torque than its recordings show; the excess may absorb a lack of fit."""
    return any(n.raised for n in found.noise)


def at_lowest_noise(found: Fit, criteria: Criteria) -> Fit:
    """Return a fit, or its refit at the lowest process noise of the recordings if the refit describes the data better.

    If process noise absorbs an error in the shape of a law, the deviance has no gradient with respect to the shape.
    Oscillations are excluded for two reasons. First, they were fitted period by period, so the fit is not in a wrong
    minimum. Second, if the phase of the model is wrong by half a period, the search does not converge at low noise.
    """
    if not has_model_noise(found) or not are_smooth(d.motion for d in found.problem.data):
        return found
    # at the lowest noise a search may diverge
    with attempt("a refit at the lowest process noise"):
        least = [n.at(n.least) for n in found.noise]
        other = fit(found.model, found, start=found.values, noise=least)
        return other if other.deviance < found.deviance - criteria.evidence else found
    return found


def refitted_at(found: Fit, noise: Sequence[Noise], values: Mapping[str, float] | None = None) -> Fit:
    """Return the same model fitted at a given noise to full convergence; `values` replace some initial values."""
    begin = found.values
    begin |= {k: v for k, v in (values or {}).items() if k in begin}
    return fit(found.model, found, start=begin, noise=noise)


def restarted_from(found: Fit, other: Fit) -> Fit:
    """Return a fit, or its refit from the values of another model if the refit has a lower deviance."""
    with attempt("a refit from the values of another model"):
        return _better(found, refitted_at(found, found.noise, other.values))
    return found


def distant_changepoints(fit: Fit, effect: Effect, criteria: Criteria) -> dict[str, float]:
    """Return the parameters of a fit, by name, with new changepoints for the cases with a raised process noise.

    The whole record of such a case is searched for its changepoint. Empty if no other time is better.
    """
    layout = fit.problem.layout
    strength = next(p.symbol for p in effect.parameters if p.role == "amplitude")
    keys = [f"{effect.name}.{effect.breakpoint}", f"{effect.name}.{strength}"]
    noisy = [i for i, n in enumerate(fit.noise) if n.raised]
    if not noisy:
        return {}
    theta, context = fit.theta.copy(), ScoreContext(fit, 1)
    for index in noisy:
        found = score_in_case(context, effect, CaseColumns(fit, index).trials(effect), index)
        if found.score > criteria.changepoint_score:
            places = [int(layout.places(index, [k])[0]) for k in keys]
            theta[places] = found.shape[0][effect.breakpoint], found.gamma[0]
    return _changed(fit, theta)


def local_changepoints(fit: Fit, effect: Effect) -> dict[str, float]:
    """Return the parameters of a fit, by name, with each changepoint at the most likely time of its neighbourhood.

    Empty if no other time is better.
    """
    layout, key = fit.problem.layout, f"{effect.name}.{effect.breakpoint}"
    theta = fit.theta.copy()
    for index in range(len(fit.problem.cases)):
        (place,) = layout.places(index, [key])
        theta[place] = _best_time(fit, index, int(place))
    return _changed(fit, theta)


def _changed(fit: Fit, theta: Array) -> dict[str, float]:
    """Return parameters by name; empty if they equal the parameters of the fit."""
    if np.array_equal(theta, fit.theta):
        return {}
    return dict(zip(fit.problem.layout.names, theta.tolist(), strict=True))


def _best_time(fit: Fit, index: int, place: int) -> float:
    """Return the time [s] of least cost in the neighbourhood of the changepoint with the parameter index `place`."""
    case, project = fit.problem.cases[index], fit.problem.projections[index]
    first, last = case.data.record.span
    now = float(fit.theta[place])
    basis = orthonormal(project(np.delete(fit.predictions[index].jacobian, place, axis=1)), _RANK)

    def cost(t: float) -> float:
        theta = fit.theta.copy()
        theta[place] = t
        try:
            residual = project(case.data.z - case.predict(theta).rows)
        except SimulationError:
            return np.inf
        residual = orthogonal_to(basis, residual)
        return float(residual @ residual)

    width = _NEIGHBOURHOOD * (last - first)
    times = np.linspace(max(first, now - width), min(last, now + width), _STEPS)
    costs = [cost(float(t)) for t in times]
    best = int(np.argmin(costs))
    return float(times[best]) if costs[best] < cost(now) else now


def scores_mislead(base: Fit, criteria: Criteria) -> bool:
    """Return whether scores about a fit are unreliable because its model has a drive and a significant lack of fit.

    Drive and drag are strongly correlated. If a drag is missing, the fitted drive and drag are wrong (measured: the
    drag by 40 %). The linear score of the missing drag is then small, or the score prefers a negative strength.
    Oscillating bodies are excluded.
    """
    return not base.model.restoring and any(e.inputs for e in base.model.effects) and base.fails(criteria)


def is_far_from_the_motion(base: Fit, criteria: Criteria) -> bool:
    """Return whether a model keeps a moving body at rest, or lacks a law for a joint.

    Oscillating bodies, which friction repeatedly stops, are excluded.
    """
    if base.model.restoring or not base.fails(criteria):
        return False
    joints = {joint for d in base.problem.data for joint in d.record.joints}
    if joints - {e.site for e in base.model.effects}:
        return True
    return any(holds_moving_body(base, i) for i in range(len(base.problem.data)))


def replaced_laws(base: Fit, effect: Effect) -> list[str]:
    """Return the laws of a base that an effect replaces, by name.

    While no body reverses, such a law and the effect are the same torque except for its sign (`Effect.equivalent`). The
    strength of the law in the base is at a bound; an example is dry friction of a body driven by a constant torque. If
    the model contained both laws, only the sum of their strengths would be determined.
    """
    found = []
    for law in base.model.effects if effect.equivalent else ():
        if law.name in effect.equivalent and law.amplitude is not None:
            key = f"{law.name}.{law.amplitude.symbol}"
            own = [e for k, e in base.estimates.items() if k.partition("@")[0] == key]
            if own and all(e.at_bound for e in own):
                found.append(law.name)
    return [] if found and any(len(d.motion.reversals) for d in base.problem.data) else found


def with_candidate(base: Fit, effect: Effect) -> Model:
    """Return the model of a base with one more effect, without the laws that it replaces."""
    model = base.model
    for name in replaced_laws(base, effect):
        model = model.without(name)
    return model.with_effect(effect)


def refit(base: Fit, score: Score, criteria: Criteria, *, thorough: bool = True) -> Fit | None:
    """Return the fit of base and candidate from the optimum of the base; None if it fails.

    A base with a large lack of fit has a high process noise. At this noise the search may converge to zero strength or
    to a wrong shape. With `thorough`, a refit is therefore repeated in other ways if its deviance falls by less than
    the score predicts.
    """
    if score.effect.restoring and not base.model.restoring:
        # the motion of the base does not oscillate, so its optimum is not an initial value for an oscillation
        return fit_from_scratch(base, score.effect)
    if score.effect.inputs and not any(e.inputs for e in base.model.effects):
        # in a base without the drive, other parameters absorb the drive; therefore its optimum is not used either
        return fit_from_scratch(base, score.effect)

    def falls_short(refitted: Fit) -> bool:
        return base.deviance - refitted.deviance < score.score - criteria.refit_shortfall

    found = fit_together(base, score)
    if thorough and found is not None and has_model_noise(base) and falls_short(found):
        found = _better(found, fit_together(base, score, hold_strength=True))
        found = at_lowest_noise(found, criteria) if falls_short(found) else found
    if not score.effect.breakpoint or found is None:
        return found
    for _ in range(_SEARCHES):
        before = found
        distant = distant_changepoints(found, score.effect, criteria)
        found = _better(found, fit_together(base, score, distant) if distant else None)
        local = local_changepoints(found, score.effect)
        found = _better(found, fit_together(base, score, local) if local else None)
        # one search may end at a wrong time, so the search is repeated
        if found is before or not has_model_noise(found):
            break
    return found


def fit_from_scratch(base: Fit, effect: Effect) -> Fit | None:
    """Return the fit of base and candidate without the initial values and the noise of the base; None if it fails.

    A base without a restoring torque has a high noise level, at which a search ends before it finds phase and
    frequency.
    """
    with attempt("a candidate from scratch"):
        found = fit(with_candidate(base, effect), base.problem.data, quick=True)
        return found if np.isfinite(found.deviance) else None
    return None


def _better(found: Fit, other: Fit | None) -> Fit:
    return other if other is not None and other.deviance < found.deviance else found


def fit_together(
    base: Fit,
    score: Score,
    start: Mapping[str, float] | None = None,
    common: Sequence[str] = (),
    *,
    hold_strength: bool = False,
) -> Fit | None:
    """Return the fit of base and candidate, with the parameters `common` shared by all cases; None if it fails.

    `hold_strength` holds the strength, as well as the shape, at the value of the score until all other parameters have
    converged.
    """
    begin = base.values | initial_values_of(base, score)
    how = "" if start is None else " from another start of the search"
    with attempt(f"a candidate{' with its strength held at first' if hold_strength else how}"):
        found = fit(
            with_candidate(base, score.effect),
            base,
            share=common,
            per_case=_keys_per_case(score),
            start=begin if start is None else begin | dict(start),
            noise=base.noise,
            steady=_steady(score.effect, begin, strength=hold_strength) if start is None else (),
            quick=True,
        )
        return found if np.isfinite(found.deviance) else None
    return None


def _keys_per_case(score: Score) -> list[str]:
    """Return the parameters of an effect that have a separate value in each case."""
    roles = {"amplitude", "phase"} if score.own_phase else set()
    return [f"{score.effect.name}.{p.symbol}" for p in score.effect.parameters if p.role in roles]


def with_common_phase(score: Score) -> Score:
    """Return a score with one strength and phase for all cases, for the initial values of a fit."""
    gamma = score.gamma.reshape(-1, 2).mean(axis=0)
    return replace(score, gamma=gamma, columns=2, own_phase=False)


def _steady(effect: Effect, names: Iterable[str], *, strength: bool) -> list[str]:
    """Return the names of the shape constants of an effect; with `strength`, of all its parameters."""
    keys = {f"{effect.name}.{p.symbol}" for p in effect.parameters if strength or p.role == "shape"}
    return [n for n in names if n.partition("@")[0] in keys]


def with_common_values(base: Fit, score: Score, found: Fit) -> Fit | None:
    """Return the fit in which all cases share the per-case parameters of the candidate; None if it has none.

    If the values of all cases agree, BIC counts a single parameter instead of one per case. A law whose parameters may
    differ between cases then has no disadvantage in BIC.
    """
    prefix = score.effect.name + "."
    keys = [k for k in found.problem.layout.per_case if k.startswith(prefix)]
    if not keys:
        return None
    mean = {
        k: float(np.mean([e.value for name, e in found.estimates.items() if name.partition("@")[0] == k]))
        for k in keys
    }
    return fit_together(base, score, found.values | mean, keys)


def with_values_per_case(base: Fit, score: Score, found: Fit, common: Fit) -> Fit:
    """Return the better of two fits with per-case values: the given fit, and a fit that starts at the common values."""
    values = common.values
    start = {n: values.get(n, values.get(n.partition("@")[0])) for n in found.problem.layout.names}
    return _better(found, fit_together(base, score, {n: v for n, v in start.items() if v is not None}))


def initial_values_of(base: Fit, score: Score) -> dict[str, float]:
    """Return initial values of the parameters of a candidate, by name, from its score."""
    effect, labels = score.effect, [r.label for r in base.problem.layout.records]
    own = len(labels) > 1 and (score.own_phase or effect.per_case)
    phase = next((p.symbol for p in effect.parameters if p.role == "phase"), None)
    amplitude = next(p.symbol for p in effect.parameters if p.role == "amplitude")
    gamma = score.gamma.reshape(len(labels) if own else 1, -1)
    values: dict[str, float] = {}
    for i, label in enumerate(labels if own else [""]):
        tail = f"@{label}" if own else ""
        found = score.shape[i] | {amplitude: gamma[i][0]}
        if phase is not None:
            found |= {amplitude: np.hypot(*gamma[i]), phase: np.arctan2(gamma[i][1], gamma[i][0])}
        common = score.shape[i] if score.own_phase else {}
        values |= {f"{effect.name}.{k}{'' if k in common else tail}": float(v) for k, v in found.items()}
    return values


_WIDTHS = (0.02, 0.1, 0.5, 2.0)
"""Trial widths of a step [s]. Chosen: from a few frames to a slow transition; with fewer, a fit starts far from the
optimum; with more, the search takes longer."""
_POWER = re.compile(r"abs\((\w+)\)\*\*([\d.]+)\*sign\(\1\)|(\w+)\*abs\(\3\)|\b(omega_\w+|delta\w*)\*\*2")
_JUMP = re.compile(r"heaviside\(t - (\w+)\)")


def with_shape_parameter(effect: Effect) -> Effect | None:
    """Return a law of the library with its fixed shape constant as a parameter; None if it has no such constant.

    The parameter of a power of a speed is its exponent n. A step at t0 becomes (1 + tanh((t - t0) / w)) / 2 with the
    width w.
    """
    if effect.amplitude is None or effect.depends_on_angle or effect.state is not None:
        return None
    roles = [p.role for p in effect.parameters]
    power = _POWER.search(effect.law)
    if power and roles == ["amplitude"] and effect.law.count("*") - power[0].count("*") <= 2:
        signed, order = power[1] or power[3], float(power[2] or 2.0)
        law = f"abs({signed})**n*sign({signed})" if signed else f"abs({power[4]})**n"
        rest = effect.law.replace(power[0], "")
        if "omega" in rest.replace(f"sign({effect.mechanism.speeds[MAIN]})", "") or "delta" in rest:
            return None
        strength = replace(effect.amplitude, unit="N m s^n")
        exponent = Parameter("n", "1", "shape", max(0.1, order - 1), order + 1, order, meaning="its exponent")
        return replace(effect, law=effect.law.replace(power[0], law), parameters=(strength, exponent))
    jump = _JUMP.search(effect.law)
    if jump and effect.breakpoint == jump[1] and roles.count("shape") == 1:
        width = Parameter("w", "s", "shape", 1e-3, 1e3, _WIDTHS[0], _WIDTHS, meaning="its width")
        law = effect.law.replace(jump[0], f"(0.5 + 0.5*tanh((t - {jump[1]})/w))")
        return replace(effect, law=law, parameters=(*effect.parameters, width), breakpoint="")
    return None


def with_free_shape(found: Fit, effect: Effect, criteria: Criteria) -> Fit | None:
    """Return the fit with the shape constant of an effect as a parameter; None if BIC does not justify this."""
    general = with_shape_parameter(effect)
    if general is None:
        return None
    model = Model(tuple(general if e.name == effect.name else e for e in found.model.effects))
    symbol = general.parameters[-1].symbol
    best: Fit | None = None
    for start in general.parameters[-1].grid or (general.parameters[-1].start,):
        with attempt(f"{effect.name} with its {symbol} free"):
            other = fit(
                model,
                found,
                share=[f"{effect.name}.{symbol}"],
                start=found.values | {f"{effect.name}.{symbol}": start},
                noise=found.noise,
                quick=True,
            )
            best = other if best is None else _better(best, other)
    if best is None:
        return None
    with attempt(f"{effect.name} with its {symbol} free, to full convergence"):
        best = refined(best, criteria)
        return best if best.bic < found.bic - criteria.shape_evidence else None
    return None
