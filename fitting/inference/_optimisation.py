"""Nonlinear least squares with bounds: Levenberg-Marquardt, and the search for the minimum of a fit.

J. J. More, The Levenberg-Marquardt algorithm, Lect. Notes Math. 630 (1978), with H. B. Nielsen's update of the damping
(IMM-REP-1999-05). A variable at its bound is held for the step if the negative gradient points out of the bounds.

If chi-square at the end of a search is far above the value for noise alone, the initial values or the model are wrong.
The search is then repeated from automatic initial values and from other exponents.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EstimationError, SimulationError
from fitting.inference._linear_algebra import orthogonal_to
from fitting.inference._parameters import PowerLaw
from fitting.inference._problem import Problem

Array = NDArray[np.float64]
ResidualFunction = Callable[[Array], tuple[Array, Array]]

_NEGLIGIBLE_FALL = 0.01
"""Fall of the sum of squares that is negligible, because no parameter then changes by a tenth of its standard error
[variances of the noise]. Derived: the square of a tenth."""
_NO_DAMPING = 1e-20
"""Damping of a Gauss-Newton step [1]. Derived: the value is far below rounding errors, so the step is undamped."""


@dataclass(frozen=True)
class Minimum:
    """The end of a search: variables, residuals, Jacobian, sum of squares, and whether the search converged."""

    x: Array
    residual: Array
    jacobian: Array
    cost: float
    converged: bool
    iterations: int
    at_bound: NDArray[np.bool_]


def minimise(
    problem: ResidualFunction,
    start: Array,
    lower: Array,
    upper: Array,
    *,
    tolerance: float = 1e-9,
    absolute: float = 1e-7,
    max_iterations: int = 200,
) -> Minimum:
    """Minimise the sum of squares of residuals within bounds.

    `problem` returns residuals (m,) and Jacobian (m, n), or raises a SimulationError; at the initial values, this
    becomes an EstimationError. The search ends when both the predicted and the actual fall of the sum of squares are
    less than the share `tolerance` of this sum, or less than `absolute`.
    """
    x = np.clip(start, lower, upper)
    try:
        r, j = problem(x)
    except SimulationError as fault:
        raise EstimationError(
            f"the model cannot be computed at its initial values: {fault.message}", fault.hint
        ) from None
    cost = float(r @ r)
    damping, growth = 1e-3, 2.0
    scale = np.linalg.norm(j, axis=0)
    converged = False
    iteration = 0
    for iteration in range(1, max_iterations + 1):  # noqa: B007
        scale = np.maximum(scale, np.linalg.norm(j, axis=0))
        unit = np.where(scale > 0, scale, 1.0)
        step = _step(r, j, unit, damping, lower - x, upper - x)
        predicted = cost - float(np.sum((r + j @ step) ** 2))
        enough = max(tolerance * cost, absolute)
        if damping <= 1 and predicted < 1e-3 * enough:
            if _undamped(r, j, unit, lower - x, upper - x) < _NEGLIGIBLE_FALL + enough:
                converged = True
                break
            damping *= 0.01
            continue
        try:
            r_new, j_new = problem(np.clip(x + step, lower, upper))
            with np.errstate(over="ignore"):
                cost_new = float(r_new @ r_new)
        except SimulationError:
            cost_new = np.inf
        fall = cost - cost_new
        if fall > 0:
            x, r, j, cost = np.clip(x + step, lower, upper), r_new, j_new, cost_new
            ratio = min(fall / max(predicted, 1e-300), 2.0)
            damping *= max(1 / 5, 1 - (2 * ratio - 1) ** 3)
            growth = 2.0
            if damping <= 1 and max(fall, predicted) < enough:
                if _undamped(r, j, unit, lower - x, upper - x) < _NEGLIGIBLE_FALL + enough:
                    converged = True
                    break
                damping *= 0.01
        elif damping > 1e14 or (damping > 1 and predicted < 1e-3 * enough):
            # no step lowers the sum of squares: the limit is rounding error, or a kink where dry friction holds the
            # body
            converged = _undamped(r, j, unit, lower - x, upper - x) < _NEGLIGIBLE_FALL + enough
            break
        else:
            damping *= growth
            growth *= 2
    return Minimum(x, r, j, cost, converged, iteration, (x <= lower) | (x >= upper))


def _undamped(r: Array, j: Array, unit: Array, down: Array, up: Array) -> float:
    """Return the fall of the sum of squares without damping, if the problem were linear.

    If variables are nearly collinear, a damped step predicts a small fall even far from the minimum.
    """
    step = _step(r, j, unit, _NO_DAMPING, down, up)
    return float(r @ r) - float(np.sum((r + j @ step) ** 2))


def _step(r: Array, j: Array, scale: Array, damping: float, down: Array, up: Array) -> Array:
    """Return the damped Gauss-Newton step between `down` and `up`; a variable that reaches a bound is held there."""
    gradient = j.T @ r
    step = np.zeros(len(scale))
    free = ~(((down >= 0) & (gradient > 0)) | ((up <= 0) & (gradient < 0)))
    while free.any():
        # scaled columns: units of the variables differ by ten orders of magnitude and more
        a = np.concatenate([j[:, free] / scale[free], np.sqrt(damping) * np.eye(int(free.sum()))])
        b = np.concatenate([-r - j[:, ~free] @ step[~free], np.zeros(int(free.sum()))])
        step[free] = np.linalg.lstsq(a, b, rcond=None)[0] / scale[free]
        crossing = free & ((step < down) | (step > up))
        if not crossing.any():
            break
        step = np.clip(step, down, up)
        free &= ~crossing
    return step


_CONVERGED = 1e-5
"""Fall of chi-square at which a search ends [1]. Derived: no parameter changes by a hundredth of its standard error,
with a margin of ten."""
_CONVERGED_QUICK = 3e-3
"""Fall of chi-square at which a quick search ends [1]. Chosen: it suffices for a ranking; a smaller value costs time, a
larger one makes the order of similar candidates random."""
_FAR = 10.0
"""A search is repeated from further initial values if chi-square per row exceeds this value [1]. Chosen: a smaller
value repeats searches of models with a lack of fit, a larger one accepts a wrong minimum."""
_STEPS = 60
"""Largest number of steps of each search from further initial values [1]. Chosen: a smaller number stops before the
minimum is known, a larger one costs time."""
_QUICK_STEPS = 40
"""Largest number of steps of a quick search [1]. Chosen: a smaller number stops before the minimum is known, a larger
one costs time."""
_EXPONENTS = 241
"""Number of trial exponents of a power law whose strength f is at a bound [1]. Chosen: a smaller number may omit the
best start, a larger one costs time."""
_SAME = 1e-3
"""Relative difference of chi-square below which two searches have the same minimum [1]. Chosen: a smaller value repeats
searches, a larger one takes neighbouring minima for a single minimum."""


@dataclass(frozen=True)
class ActiveBounds:
    """The bounds at which a search ended.

    d and f are the strengths of a pair of laws d x^m + f x^g. `power_laws` are the pairs that are still fitted in
    transformed variables. `held` are the indices of the variables that are held at a bound.
    """

    power_laws: tuple[PowerLaw, ...]
    held: tuple[int, ...] = ()


@dataclass(frozen=True)
class Solution:
    """The result of a search: physical variables, the minimum in transformed variables, and active bounds."""

    theta: Array
    minimum: Minimum
    active: ActiveBounds | None = None


def is_far(problem: Problem, found: Solution) -> bool:
    """Return whether a solution is so far from the data that another minimum is likely."""
    return found.minimum.cost >= _FAR * problem.rows


def search_widely(
    problem: Problem,
    theta: Array,
    others: Iterable[Array],
    *,
    quick: bool = False,
    active: ActiveBounds | None = None,
) -> Solution:
    """Return the best of several searches.

    The searches from `others` are made only if the first search ends far from the data.
    """
    best: Solution | None = None
    for begin in (theta, *others):
        try:
            found = search(problem, begin, quick=quick, max_iterations=_STEPS, active=active)
        except EstimationError:
            active = None
            continue
        active, cost = found.active, found.minimum.cost
        # if two searches end in the same minimum, the model is wrong, and the search is not repeated
        same = best is not None and abs(cost - best.minimum.cost) < _SAME * best.minimum.cost
        if best is None or cost < best.minimum.cost:
            best = found
        if same or (found.minimum.converged and not is_far(problem, found)):
            break
    # if all searches failed, the error of the first search is raised
    return search(problem, theta, quick=quick) if best is None else best


def search(
    problem: Problem,
    theta: Array,
    *,
    quick: bool = False,
    max_iterations: int = 200,
    active: ActiveBounds | None = None,
) -> Solution:
    """Minimise chi-square; the noise is the noise of the problem and does not change.

    With `quick`, the search ends within about 0.01 of the minimum of chi-square. `active` are the bounds at which an
    earlier search of a similar problem ended; the minimum along these bounds is tried first.
    """
    enough, most = (
        (_CONVERGED_QUICK, min(_QUICK_STEPS, max_iterations)) if quick else (_CONVERGED, max_iterations)
    )
    lower, upper = problem.layout.bounds()
    if active is not None:
        found = _minimum_at_bounds(problem, theta, active, enough, most)
        if (
            found is not None
            and found.minimum.converged
            and not _out_of_bounds(active.power_laws, found.theta, lower, upper)
            and _is_minimum(problem, found.theta, active.held, enough)
        ):
            return found
    follows_angle = bool(problem.layout.model.angle_dependent or problem.layout.model.measurement)
    for _ in range(2 if follows_angle else 1):
        for case in problem.cases:
            case.forget_columns()
        limits = problem.transformed_bounds(lower, upper)
        minimum = minimise(problem, problem.transformed(theta), *limits, absolute=enough, max_iterations=most)
        theta = problem.physical(minimum.x)
    # the bounds of d and f do not form a box in transformed variables: they are checked afterwards
    if not _out_of_bounds(problem.power_laws, theta, lower, upper):
        return Solution(theta, minimum)
    if not minimum.converged and minimum.cost > _FAR * problem.rows:
        return Solution(np.clip(theta, lower, upper), minimum)
    # one or two bounds are active: search quickly along every bound, and continue the best search to convergence
    ends: list[Solution] = []
    choices = [*_choices_of_bound(ActiveBounds(problem.power_laws), theta, lower, upper)]
    while choices:
        side, begin = choices.pop(0)
        end = _minimum_at_bounds(problem, begin, side, _CONVERGED_QUICK, min(_QUICK_STEPS, most))
        if end is not None and _out_of_bounds(side.power_laws, end.theta, lower, upper):
            choices = [*_choices_of_bound(side, end.theta, lower, upper), *choices]
        elif end is not None:
            ends.append(end)
    if ends:
        best = min(ends, key=lambda end: end.minimum.cost)
        theta, active = best.theta, best.active
        found = None if active is None else _minimum_at_bounds(problem, theta, active, enough, most)
        if found and active and not _out_of_bounds(active.power_laws, found.theta, lower, upper):
            return found
    return Solution(np.clip(theta, lower, upper), replace(minimum, converged=False))


def _minimum_at_bounds(
    problem: Problem, theta: Array, active: ActiveBounds, enough: float, most: int
) -> Solution | None:
    """Return the minimum along active bounds; None if the model cannot be computed there.

    The search starts at `theta`, whose held variables are at their bounds.
    """
    lower, upper = problem.layout.bounds()
    held = list(active.held)
    lower[held] = upper[held] = theta[held]
    along = replace(problem, power_laws=active.power_laws)
    start, limits = along.transformed(theta), along.transformed_bounds(lower, upper)
    try:
        minimum = minimise(along, start, *limits, absolute=enough, max_iterations=most)
        return Solution(along.physical(minimum.x), minimum, active)
    except EstimationError:
        return None


def _is_minimum(problem: Problem, theta: Array, held: Sequence[int], enough: float) -> bool:
    """Return whether chi-square rises if a variable held at its bound moves into its range."""
    lower, upper = problem.layout.bounds()
    r, j = problem.residuals(problem.predict(theta))
    others = [i for i in range(len(theta)) if i not in held and lower[i] < theta[i] < upper[i]]
    size = np.linalg.norm(j[:, others], axis=0)
    basis = np.linalg.qr(j[:, others][:, size > 0] / size[size > 0])[0]
    for i in held:
        column = orthogonal_to(basis, j[:, i])
        slope = float(column @ r)
        inward = slope < 0 if theta[i] <= lower[i] else slope > 0
        if inward and slope**2 > enough * float(column @ column):
            return False
    return True


def _out_of_bounds(
    power_laws: Sequence[PowerLaw], theta: Array, lower: Array, upper: Array
) -> list[PowerLaw]:
    """Return the power laws with d or f out of its bounds."""
    broken = []
    for v in power_laws:
        places = [i for i in (v.d, v.f) if i is not None]
        if np.any(theta[places] < lower[places]) or np.any(theta[places] > upper[places]):
            broken.append(v)
    return broken


def _choices_of_bound(
    active: ActiveBounds, theta: Array, lower: Array, upper: Array
) -> Iterator[tuple[ActiveBounds, Array]]:
    """Yield the bounds of the first power law with d or f out of its bounds.

    For each bound of d and of f, yield the active bounds and the initial variables at this bound. The torque and its
    slope at the reference speed remain the same.
    """
    v = _out_of_bounds(active.power_laws, theta, lower, upper)[0]
    rest = tuple(w for w in active.power_laws if w.f != v.f)
    if v.d is None:
        # a power law without a law of fixed power: f itself becomes the variable of the search and has bounds
        yield ActiveBounds(rest, active.held), np.clip(theta, lower, upper)
        return
    if v.held:
        place = v.f if v.held == "d" else v.d
        begin = theta.copy()
        begin[place] = np.clip(theta[place], lower[place], upper[place])
        yield ActiveBounds(rest, (*active.held, place)), begin
        return
    d, f, g = theta[v.d], theta[v.f], theta[v.g]
    straight = v.reference**v.order
    torque = max(d * straight + f * v.reference**g, 1e-12)
    curvature = (g - v.order) * f * v.reference**g
    powers = (
        np.linspace(lower[v.g], upper[v.g], _EXPONENTS)
        if np.isfinite(upper[v.g] - lower[v.g])
        else np.array([g])
    )
    for bound in {float(b[v.d]) for b in (lower, upper) if np.isfinite(b[v.d])}:
        begin = theta.copy()
        rest_torque = max(torque - bound * straight, 1e-3 * torque)
        begin[v.d], begin[v.g] = bound, np.clip(v.order + curvature / rest_torque, lower[v.g], upper[v.g])
        begin[v.f] = rest_torque / v.reference ** begin[v.g]
        yield ActiveBounds((*rest, replace(v, held="d")), (*active.held, v.d)), begin
    for bound in {float(b[v.f]) for b in (lower, upper) if np.isfinite(b[v.f])}:
        begin = theta.copy()
        curvatures = (powers - v.order) * bound * v.reference**powers
        begin[v.f], begin[v.g] = bound, powers[np.argmin(np.abs(curvatures - curvature))]
        begin[v.d] = (torque - bound * v.reference ** begin[v.g]) / straight
        yield ActiveBounds((*rest, replace(v, held="f")), (*active.held, v.f)), begin
