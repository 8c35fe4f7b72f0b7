"""Initial values of a fit from the data alone.

The laws are linear in their strengths gamma_k. Along the approximate speeds of the recording,

    I_c [omega_c(t) - omega_c(0)] = sum_k gamma_k integral_0^t law_k dt,

and an analogous equation holds for the rotor. These equations are a linear least-squares problem with bounds.

At strength zero, chi-square has no gradient with respect to the shape of a law, and with a wrong shape the search may
end in a wrong minimum. Therefore the model is first fitted without the law. For every shape on a grid, a score test
then gives the fall of the deviance from the derivative of the rows with respect to the strength. The full search starts
at the best shape. At the random torque of the model without the law, any shape would be consistent with the data, so
the level of the random torque is optimised as well.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EstimationError, SimulationError
from fitting.dynamics._model import Dynamics, Model
from fitting.effects._effect import RATIO, Effect
from fitting.effects._library import LIBRARY
from fitting.effects._mechanism import MAIN, Coupling, inertia_of
from fitting.inference._averaging import LARGEST_PHASE_ERROR, Averaged, averaged
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._compression import integrated
from fitting.inference._linear_algebra import r_factor
from fitting.inference._noise import Noise
from fitting.inference._optimisation import minimise, search
from fitting.inference._parameters import (
    START_CASING,
    START_DEFLECTION,
    ParameterLayout,
    is_power_law,
    start_of,
)
from fitting.inference._problem import Problem, measure_noise, reference_speed, typical_speed
from fitting.inference._record import Record, Samples, scales_of
from fitting.inference._trace import attempt

Array = NDArray[np.float64]

_FIRST_SHARE = 0.1
"""Share of the power law in the bearing torque at the start of the search [1]. Chosen: at zero, chi-square has no
gradient with respect to the exponent; a larger value prefers the power law."""
_LEAST_SHARE = 1e-5
"""Smallest initial value of a bearing torque, divided by the torque that would stop the rotor within the record [1].
Chosen: the search must not start at zero strength; a larger value exceeds the torque of weak bearings."""
_AT_REST = 0.01
"""For initial values, the casing counts as at rest if its speed, as a share of its largest speed, is below this value
[1]. Chosen: a smaller value uses the sign of noise, a larger one omits slow parts."""
_END = 10
"""Number of equal parts of a run; the last part counts as the end of the run [1]. Chosen: with more parts, the end
contains few speeds; with fewer, the end includes the middle of the run."""
_DEAD_TIMES = 40
"""Number of dead times of an input that are tried [1]. Chosen: with fewer, a fit starts far from the optimum; with
more, the search takes longer."""
_LONGEST_DEAD_TIME = 0.1
"""Longest dead time, divided by the length of a record [1]. Chosen: a smaller value overlooks slow drives, a larger one
loses the start of the record."""
_FIRST_PERIODS = 2.0
"""Number of periods of the first search of an oscillation [1]. Chosen: a smaller number does not determine the
frequency; with a larger one, the initial values may be wrong by a period."""
_FEWEST_SAMPLES = 24
"""Smallest number of samples of the first search of an oscillation [samples]. Chosen: a smaller number does not
determine all laws; with a larger one, the initial values may be wrong by a period."""
_MOST_STEPS = 60
"""Largest number of steps of the first search of an oscillation [1]. Chosen: a smaller number stops before convergence,
a larger one costs time."""


def initial_values(problem: Problem, given: Mapping[str, float] | None) -> Array:
    """Return the initial values of a fit: the given values, and values from the data for all other parameters."""
    layout = problem.layout
    known = dict(given or {})
    restoring = layout.model.restoring
    if restoring and any(k in known for k in layout.names if _is(START_CASING, k)):
        if not any(k in known for k in layout.names if _is(START_DEFLECTION, k)):
            # the values of a model that does not oscillate are discarded
            known = {}
        else:
            # far from the minimum the phase slips by whole periods, so new laws have strength zero at first
            known = {n: 0.0 for n in layout.names if layout.parameter(n).role == "amplitude"} | known
    if not set(layout.names) <= set(known):
        rough = [d.initial_speeds for d in problem.data]
        deflections = [_deflection(d, times) for d, (times, _) in zip(problem.data, rough, strict=True)]
        searched = unknown_shapes(layout, given)
        found = start_values(layout, problem.reference, rough, deflections, _prior_means(problem), searched)
        if restoring and not known:
            slow = averaged(layout, problem.data, found, _strengths, _regress)
            follows = slow is not None and slow.phase_error < LARGEST_PHASE_ERROR
            found = slow.theta if slow is not None and follows else _period_by_period(problem, found)
        usual = dict(zip(layout.names, found.tolist(), strict=True))
        known = usual | {k: v for k, v in known.items() if k in usual}
    return np.array([known[n] for n in layout.names])


def _prior_means(problem: Problem) -> dict[str, float]:
    priors = [d.prior for d in problem.data if d.prior is not None]
    return {k: v for p in priors for k, v in zip(p.names, p.mean, strict=True)}


def _is(start: str, name: str) -> bool:
    return name.partition("@")[0] == start


def averaged_fit(
    model: Model, data: Sequence[CaseData], errors: Sequence[Array] | None = None
) -> Averaged | None:
    """Return the fit of the averaged equations of motion of an oscillation; None if it has too few periods."""
    if any(d.motion.slow_motion is None for d in data):
        return None
    layout = ParameterLayout.of(model, [d.record for d in data])
    rough = [d.initial_speeds for d in data]
    deflections = [_deflection(d, times) for d, (times, _) in zip(data, rough, strict=True)]
    theta = start_values(layout, reference_speed(data, model.mechanism), rough, deflections)
    return averaged(layout, data, theta, _strengths, _regress, errors)


def equation_error(model: Model, data: Sequence[CaseData]) -> float:
    """Return the error of the equations of motion under a model, without a fit.

    For many periods of an oscillation, this is the rms error of the phase [rad]. Otherwise it is the norm of the
    residuals of the integrated equations of motion, divided by the norm of the change of the speeds [1]. The strengths
    come from the linear regression; the shape constants have their declared initial values.
    """
    layout = ParameterLayout.of(model, [d.record for d in data])
    slow = averaged_fit(model, data) if model.restoring else None
    if slow is not None:
        return slow.phase_error
    rough = [d.initial_speeds for d in data]
    deflections = [_deflection(d, times) for d, (times, _) in zip(data, rough, strict=True)]
    theta = start_values(layout, reference_speed(data, model.mechanism), rough, deflections)
    residual = whole = 0.0
    for case, ((times, speeds), deflection) in enumerate(zip(rough, deflections, strict=True)):
        keys, design, target = _equations(layout, case, times, speeds, deflection, theta)
        residual += float(np.sum((design @ theta[layout.places(case, keys)] - target) ** 2))
        whole += float(np.sum(target**2))
    return math.sqrt(residual / whole) if whole > 0 else 0.0


def _deflection(data: CaseData, times: Array) -> Array:
    """Return the measured angle from the equilibrium at some times [rad]; zero for a body that turns in one sense."""
    return np.interp(times, data.motion.time, data.motion.deflection)


def _period_by_period(problem: Problem, theta: Array) -> Array:
    """Return initial values from the first periods of an oscillation: two periods, doubled up to half of the record.

    Over a record of n periods, a relative error of the frequency of 1 / (2 n) shifts the phase by half a period, and
    the search ends in a wrong minimum. The frequency from k periods is accurate enough for 2 k periods.
    """
    layout = problem.layout
    longest = max(d.motion.periods for d in problem.data)
    count = _FIRST_PERIODS
    while count < longest:
        data = [CaseData.of(_first_periods(d, count), d.criteria) for d in problem.data]
        part = Problem.of(replace(layout, records=tuple(d.record for d in data)), data)
        with attempt(f"a search through {count:g} periods", EstimationError):
            theta = search(part, theta, quick=True, max_iterations=_MOST_STEPS).theta
        count *= 2
    return theta


def _first_periods(data: CaseData, count: float) -> Record:
    record, motion = data.record, data.motion
    if motion.periods <= count:
        return record
    runs = record.casing
    size = max(_FEWEST_SAMPLES, int(np.searchsorted(runs.time, runs.time[0] + count * motion.period)))
    casing = Samples(runs.time[:size], runs.value[:size], runs.sigma[:size])
    return replace(record, casing=casing, digest="")


def start_values(
    layout: ParameterLayout,
    reference: float,
    rough: Sequence[tuple[Array, Array]],
    deflections: Sequence[Array],
    prior: Mapping[str, float] | None = None,
    searched: Sequence[Effect] = (),
) -> Array:
    """Return initial values of all variables from the rough (times, speeds) of each case.

    A power law of the first joint starts with a tenth of the torque of the linear law at the speed `reference` of the
    joint [rad/s]. `deflections` are the angles from the equilibrium at the same times [rad]. Parameters in `prior` are
    known. The strengths of the effects in `searched`, whose shapes will be searched, are 0: with a wrong shape, the
    regression may give them very large values. All other parameters are estimated.
    """
    later = {f"{e.name}.{e.amplitude.symbol}": 0.0 for e in searched if e.amplitude is not None}
    prior = later | dict(prior or {})
    theta = np.array([prior.get(name.partition("@")[0], _declared(layout, name)) for name in layout.names])
    for e in layout.model.effects:
        if e.joint == "contact" and RATIO in {p.symbol for p in e.free}:
            for case, (_, speeds) in enumerate(rough):
                theta[layout.places(case, [f"{e.name}.{RATIO}"])] = _ratio(speeds, rigid=e.rigid)
    theta = _with_dead_times(layout, rough, deflections, theta)
    parts = []
    for case, (times, speeds) in enumerate(rough):
        keys, design, target = _equations(layout, case, times, speeds, deflections[case], theta)
        free = [i for i, k in enumerate(keys) if k not in prior]
        known = design @ np.array([prior.get(k, 0.0) for k in keys])
        parts.append((layout.places(case, [keys[i] for i in free]), design[:, free], target - known))
    # shared parameters are estimated from all cases together, because the mean of separate estimates may describe no
    # case
    places, values = _regress(layout, parts)
    theta[places] = values
    for case, (_, speeds) in enumerate(rough):
        first = dict(zip(map(start_of, layout.model.mechanism.speeds), speeds[0], strict=True))
        first[START_DEFLECTION] = deflections[case][0]
        theta[layout.places(case, layout.starts)] = [first[k] for k in layout.starts]
    for i, joint in enumerate(layout.model.mechanism.couplings):
        typical = reference if i == 0 else typical_speed([s for _, s in rough], layout.model.mechanism, joint)
        _with_power_law(layout, joint, typical, rough, theta)
    return theta


def _with_power_law(
    layout: ParameterLayout,
    joint: Coupling,
    reference: float,
    rough: Sequence[tuple[Array, Array]],
    theta: Array,
) -> None:
    """Set the strengths of a joint with a linear law and a power law, if the power law has no strength yet."""
    pair = (f"{joint.name}.linear.d", f"{joint.name}.power.f", f"{joint.name}.power.g")
    if not all(k in layout.model.free for k in pair):
        return
    place = layout.model.mechanism.bodies.index(joint.first)
    stopping = [
        layout.numbers(theta, i)[inertia_of(joint.first)]
        * float(np.abs(speeds[:, place]).max())
        / float(np.ptp(times))
        for i, (times, speeds) in enumerate(rough)
    ]
    # each joint is treated once, regardless of the number of cases that share it
    for d, f, g in dict.fromkeys(tuple(layout.places(i, pair).tolist()) for i in range(len(rough))):
        if theta[f] > 0:
            continue
        torque = max(theta[d] * reference, _LEAST_SHARE * max(stopping))
        theta[f] = _FIRST_SHARE * torque / reference ** theta[g]
        theta[d] = (1 - _FIRST_SHARE) * torque / reference


def _ratio(speeds: Array, *, rigid: bool) -> float:
    """Return the median ratio of the speeds of the whole run or, if there is slip, of the end after the slip."""
    rotor, casing = (speeds if rigid else speeds[-(len(speeds) // _END) - 1 :]).T
    turning = np.abs(casing) > _AT_REST * np.abs(casing).max(initial=0.0)
    return float(np.median(rotor[turning] / casing[turning])) if turning.any() else 1.0


def _declared(layout: ParameterLayout, name: str) -> float:
    p = layout.parameter(name)
    if p.relative and p.grid:
        first, last = layout.records[0].span
        return first + p.grid[len(p.grid) // 2] * (last - first)
    return p.start


def _equations(
    layout: ParameterLayout, case: int, times: Array, speeds: Array, deflection: Array, theta: Array
) -> tuple[list[str], Array, Array]:
    """Return the strengths of one case, and the linear equations for them with both initial speeds free."""
    dynamics = Dynamics(layout.model.smooth, inputs=layout.records[case].inputs)
    numbers = layout.numbers(theta, case)
    if dynamics.ratio is not None:
        # laws that differ only by a factor would seem separable if both speeds had independent errors
        speeds = np.column_stack([numbers[dynamics.ratio] * speeds[:, MAIN], speeds[:, MAIN]])
    count, oscillates = dynamics.speeds, dynamics.free_starts > dynamics.speeds
    state = np.concatenate([speeds, np.zeros((len(times), len(dynamics.states) - count))], axis=1)
    if oscillates:
        state[:, count] = deflection
    linear = _strengths(layout, dynamics.parameters)
    with np.errstate(all="ignore"):
        # accelerations at zero strengths, due to the other parameters
        constant, _, b = dynamics.linearised(times, state, numbers | dict.fromkeys(linear, 0.0))
    columns = np.array([dynamics.parameters.index(k) for k in linear], dtype=np.intp)
    weight = np.array([numbers[k] for k in dynamics.mechanism.inertias])
    rates = b[:, :count][:, :, columns]
    singular = ~np.isfinite(rates).all(axis=(0, 1))
    if singular.any():
        name = linear[int(np.flatnonzero(singular)[0])].rpartition(".")[0]
        raise EstimationError(
            f"the law of {name[:80]!r} has no finite value at the measured speeds",
            "look for a division by zero or a huge exponent",
        )
    integrals = integrated(times, rates)
    held = integrated(times, constant[:, :count])
    # while friction holds the casing, the torque of friction balances all others and contains no information
    everywhere = np.ones(len(times), dtype=bool)
    used = [everywhere] * count
    used[MAIN] = everywhere if oscillates else _longest_motion(speeds[:, MAIN])
    # an error of the equilibrium causes a drift of the integrated deflection, so the initial speed of each period is
    # free
    free = _periods(deflection) if oscillates else None
    blocks, targets = [], []
    balances = [
        (np.column_stack([integrals[:, i], speeds[:, i] - held[:, i]]) * weight[i], used[i])
        for i in range(count)
    ]
    if dynamics.ratio is not None:
        # in the ratio times the equation of the rotor plus the equation of the casing, the torque of a contact without
        # slip cancels
        (rotor, _), (casing, moving) = balances
        balances = [(numbers[dynamics.ratio] * rotor + casing, moving)]
    for columns, chosen in balances:
        columns = columns[chosen]
        columns = columns - (columns.mean(axis=0) if free is None else _means(free[chosen], columns))
        blocks.append(columns[:, :-1])
        targets.append(columns[:, -1])
    return linear, np.concatenate(blocks), np.concatenate(targets)


def _periods(deflection: Array) -> NDArray[np.intp]:
    """Return the period to which each value belongs: from one passage upwards through the equilibrium to the next."""
    upwards = (deflection[1:] > 0) & (deflection[:-1] <= 0)
    return np.concatenate([[0], np.cumsum(upwards)])


def _means(groups: NDArray[np.intp], columns: Array) -> Array:
    """Return the mean of columns over the group to which each row belongs."""
    count = np.bincount(groups)
    sums = np.stack([np.bincount(groups, c) for c in columns.T], axis=1)
    return np.asarray((sums / count[:, None])[groups])


def _strengths(layout: ParameterLayout, parameters: Sequence[str]) -> list[str]:
    """Return the parameters in which the equations are linear, without nearly collinear parameters."""
    dead_times = _dead_times(layout)
    every = [k for k in parameters if layout.model.parameters[k].role == "amplitude" and k not in dead_times]
    # a power law is linear in its strength, but nearly collinear with the linear law while its exponent is free
    joints = [j.name for j in layout.model.mechanism.couplings]
    curved = (
        *(f"{j}.heating." for j in joints),
        *(f"{j}.power." for j in joints if f"{j}.power.g" in parameters),
    )
    linear = [k for k in every if not k.startswith(curved)] or every
    for joint in joints:
        power = f"{joint}.power.f"
        if not {f"{joint}.linear.d", power} & {*linear} and power in parameters:
            linear.append(power)
    return linear


def _dead_times(layout: ParameterLayout) -> list[str]:
    """Return the parameters that are dead times of inputs."""
    return [f"{e.name}.{p.symbol}" for e in layout.model.effects if e.joint == "input" for p in e.free]


def _with_dead_times(
    layout: ParameterLayout,
    rough: Sequence[tuple[Array, Array]],
    deflections: Sequence[Array],
    theta: Array,
) -> Array:
    """Return variables with each dead time at the point of a grid at which the regression fits best."""
    for key in _dead_times(layout):
        best: tuple[float, float] = (math.inf, 0.0)
        step = min(float(np.median(np.diff(t))) for t, _ in rough)
        longest = _LONGEST_DEAD_TIME * max(float(np.ptp(t)) for t, _ in rough)
        for delay in (0.0, *np.geomspace(step, max(longest, step), _DEAD_TIMES)):
            trial = theta.copy()
            parts = []
            for case, (times, speeds) in enumerate(rough):
                trial[layout.places(case, [key])] = delay
                keys, design, target = _equations(layout, case, times, speeds, deflections[case], trial)
                parts.append((layout.places(case, keys), design, target))
            places, values = _regress(layout, parts)
            known = dict(zip(places.tolist(), values.tolist(), strict=True))
            error = sum(
                float(np.sum((design @ [known[int(k)] for k in own] - target) ** 2))
                for own, design, target in parts
            )
            if error < best[0]:
                best = error, float(delay)
        for case in range(len(rough)):
            theta[layout.places(case, [key])] = best[1]
    return theta


def _regress(
    layout: ParameterLayout, parts: Sequence[tuple[NDArray[np.intp], Array, Array]]
) -> tuple[NDArray[np.intp], Array]:
    """Return the indices of all strengths and their values within bounds, by linear least squares."""
    places = np.unique(np.concatenate([of_case for of_case, _, _ in parts]))
    rows, aims = [], []
    for of_case, design, target in parts:
        few = r_factor(np.column_stack([design, target]))
        rows.append(np.zeros((len(few), len(places))))
        rows[-1][:, np.searchsorted(places, of_case)] = few[:, :-1]
        aims.append(few[:, -1])
    stacked, aim = np.concatenate(rows), np.concatenate(aims)
    size = np.linalg.norm(stacked, axis=0)
    size[size == 0] = 1.0
    scale = float(np.linalg.norm(aim)) or 1.0
    unit, aim = stacked / size, aim / scale
    lower, upper = (bound[places] for bound in layout.declared_bounds())
    solution = minimise(
        lambda x: (unit @ x - aim, unit), np.zeros(len(size)), lower, upper, tolerance=1e-10, absolute=1e-14
    )
    return places, solution.x / size * scale


def _longest_motion(omega_c: Array) -> NDArray[np.bool_]:
    """Return a mask of the samples that are in the longest interval without rest of the casing."""
    slow = np.abs(omega_c) < _AT_REST * np.abs(omega_c).max(initial=0.0)
    ends = np.flatnonzero(np.diff(np.concatenate([[True], slow, [True]]).astype(int)))
    if not len(ends):
        return np.ones(len(omega_c), dtype=bool)
    start, stop = max(zip(ends[::2], ends[1::2], strict=True), key=lambda pair: pair[1] - pair[0])
    inside = np.zeros(len(omega_c), dtype=bool)
    inside[start:stop] = True
    return inside


_POWERS = (0.25, 0.5, 0.75, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0)
"""Trial exponents of a power law [1]. Chosen: values on both sides of 1, the exponent of the linear law; with fewer, a
fit may start in a wrong minimum; with more, the search takes longer."""
_MOST = 80
"""Largest number of trial shapes of a law [1]. Chosen: a smaller number may omit the best shape, a larger one costs
time."""
_COLLINEAR = 1e-7
"""Relative singular value below which columns are collinear [1]. Chosen: a smaller value gives large strengths of
opposite sign, a larger one holds well-determined strengths fixed."""
_SHARES = (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3)
"""Trial levels, divided by the level of random torque without the law [1]. Chosen: at the level without the law any
shape is consistent with the data; fewer levels may give a wrong shape, more cost time."""


def _laws_of_joint(model: Model, site: str) -> int:
    return sum(e.joint == "bearing" and e.site == site for e in model.effects)


def unknown_shapes(layout: ParameterLayout, given: Mapping[str, float] | None) -> list[Effect]:
    """Return the effects of a model with shape constants that were not given and that need a search."""
    known = {name.partition("@")[0] for name in given or {}}
    effects = []
    for e in layout.model.smooth.effects:
        roles = {p.role for p in e.parameters}
        shapes = [f"{e.name}.{p.symbol}" for p in e.parameters if p.role == "shape"]
        # the power law of the bearing has transformed variables, and the initial value of its exponent suffices
        alone = e.joint == "bearing" and _laws_of_joint(layout.model, e.site) == 1
        searched = not alone and e.kind_of_law != "bearing.power" and e.joint != "contact"
        searched = searched and "phase" not in roles and e.amplitude is not None
        if shapes and searched and not known.intersection(shapes):
            effects.append(e)
    return effects


def initial_shapes(
    problem: Problem,
    theta: Array,
    effects: list[Effect],
    *,
    fitted: bool,
    noise: Sequence[Noise] | None = None,
) -> tuple[Problem, Array]:
    """Return variables with the shapes of effects at the best points of their grids, and the problem with its noise.

    `fitted` states that the other variables are at the optimum of the model without these effects. `noise` is the noise
    of that model.
    """
    layout = problem.layout
    theta = theta.copy()
    for effect in effects:
        theta[_places(layout, effect, "amplitude")] = 0.0
    if not fitted:
        theta = _without(problem, theta, effects)
    noise = measure_noise(problem, theta) if noise is None else noise
    for effect in effects:
        problem, theta = _best(problem, theta, effect, noise)
    return problem, theta


def _without(problem: Problem, theta: Array, effects: list[Effect]) -> Array:
    layout = problem.layout
    names = {e.name for e in effects}
    model = layout.model.with_only(e for e in layout.model.effects if e.name not in names)
    smaller = ParameterLayout(model, layout.records, layout.per_case, layout.ranges)
    rest = replace(Problem.of(smaller, problem.data), projections=problem.projections)
    places = [layout.index[n] for n in smaller.names]
    out = theta.copy()
    out[places] = search(rest, theta[places]).theta
    return out


def _best(problem: Problem, theta: Array, effect: Effect, noise: Sequence[Noise]) -> tuple[Problem, Array]:
    """Return variables with the best shape of one effect, and the problem at the noise of the fit with this shape."""
    layout = problem.layout
    starts = []
    for values in _grid(problem, effect):
        begin = theta.copy()
        for symbol, value in values.items():
            for case in range(len(layout.records)):
                begin[layout.places(case, [f"{effect.name}.{symbol}"])] = value
        with attempt(f"the motion for an initial value of {effect.name}", SimulationError):
            starts.append((begin, problem.predict(begin)))
    ends = []
    for share in _SHARES:
        levels = [n.at(max(n.least, share * n.level)) for n in noise]
        trial = problem.with_noise(levels)
        log_determinant = sum(n.whitener.log_determinant for n in levels)
        for begin, predictions in starts:
            found = _stepped(trial, begin, predictions, _places(layout, effect, "amplitude"))
            if found is not None:
                ends.append((log_determinant + found[0], found[1], trial))
    if not ends:
        return problem.with_noise(noise), theta
    _, chosen, trial = min(ends, key=lambda end: end[0])
    return trial, chosen


def _stepped(
    problem: Problem, begin: Array, predictions: Sequence[Prediction], strength: NDArray[np.intp]
) -> tuple[float, Array] | None:
    """Return chi-square after one linear step of all variables, and variables with the strength of this step."""
    lower, upper = problem.layout.bounds()
    r, j = problem.residuals(predictions)
    size = np.linalg.norm(j, axis=0)
    moving = size > 0
    if not np.isfinite(size).all() or not moving[strength].all():
        return None
    step = np.zeros(len(begin))
    step[moving] = np.linalg.lstsq(j[:, moving] / size[moving], -r, rcond=_COLLINEAR)[0] / size[moving]
    if (step[strength] < lower[strength]).any() or (step[strength] > upper[strength]).any():
        return None
    end = begin.copy()
    end[strength] = step[strength]
    return float(np.sum((r + j @ step) ** 2)), end


def _grid(problem: Problem, effect: Effect) -> Iterator[dict[str, float]]:
    first, last = problem.layout.records[0].span
    axes = []
    for p in effect.parameters_at(*scales_of(problem.layout.records)):
        if p.role != "shape":
            continue
        grid = np.array(p.grid or (p.start,))
        if effect.kind_of_law not in LIBRARY and is_power_law(effect, *problem.data[0].initial_speeds):
            grid = np.array([v for v in _POWERS if p.lower <= v <= p.upper] or [p.start])
        if p.relative:
            grid = grid * (last - first) + (first if p.symbol == effect.breakpoint else 0.0)
        axes.append([(p.symbol, float(v)) for v in grid])
    for values in itertools.islice(itertools.product(*axes), _MOST):
        yield dict(values)


def _places(layout: ParameterLayout, effect: Effect, role: str) -> NDArray[np.intp]:
    keys = [f"{effect.name}.{p.symbol}" for p in effect.parameters if p.role == role]
    return np.unique(np.concatenate([layout.places(i, keys) for i in range(len(layout.records))]))
