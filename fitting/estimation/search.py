"""The search for the minimum of a fit: in straight variables, within bounds that these do not show.

Where a search ends far from anything that noise explains, the start was at fault, or the model is: it is repeated
from the program's own start, and from other exponents.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting.errors import EstimationError
from fitting.estimation.coordinates import Valley
from fitting.estimation.levenberg import Minimum, minimise
from fitting.estimation.problem import Problem

Array = NDArray[np.float64]

# a chi-square this near to its minimum moves no parameter by a hundredth of its error
_ENOUGH = 1e-5
_ENOUGH_TO_RANK = 3e-3
# chi2 per row above which a search is repeated from elsewhere
_LOST = 10.0
_PATIENCE = 60
_ALIKE = 1e-3


def search_widely(problem: Problem, theta: Array, others: Iterable[Array], *, quick: bool = False) -> Array:
    """Return the variables of the best of several searches; the others are tried only if the first is lost."""
    rows = sum(len(d.z) for d in problem.data)
    best: tuple[float, Array] | None = None
    for begin in (theta, *others):
        try:
            minimum, end = search(problem, begin, quick=quick, most=_PATIENCE)
        except EstimationError:
            continue
        # two starts that end alike: the model is at fault
        alike = best is not None and abs(minimum.cost - best[0]) < _ALIKE * best[0]
        if best is None or minimum.cost < best[0]:
            best = minimum.cost, end
        if alike or (minimum.converged and minimum.cost < _LOST * rows):
            break
    if best is None:
        # the fault of the first start, told by the solver
        return search(problem, theta, quick=quick)[1]
    return best[1]


def search(problem: Problem, theta: Array, *, quick: bool = False, most: int = 200) -> tuple[Minimum, Array]:
    """Return the minimum of a fit at its present noise, and its physical variables.

    Parameters
    ----------
    problem : Problem
        The fit.
    theta : ndarray
        Where to start.
    quick : bool
        Stop where chi-square is within about 0.01 of its minimum.
    most : int
        Steps tried at most.
    """
    enough, most = (_ENOUGH_TO_RANK, min(40, most)) if quick else (_ENOUGH, most)
    lower, upper = problem.straight_bounds(*problem.layout.bounds())
    follows_angle = bool(problem.layout.model.rippling or problem.layout.model.measurement)
    for _ in range(2 if follows_angle else 1):
        for case in problem.cases:
            case.forget_columns()
        minimum = minimise(
            problem,
            problem.straight(theta),
            lower,
            upper,
            absolute=enough,
            max_iterations=most,
        )
        theta = problem.physical(minimum.x)
    # the box around d and f is none in straight variables: whether they kept to it is seen afterwards
    lower, upper = problem.layout.bounds()
    if any(_broken(v, theta, lower, upper) for v in problem.valleys):
        return _on_the_edge(problem, minimum, theta, enough, most)
    return minimum, theta


def _on_the_edge(
    problem: Problem, minimum: Minimum, theta: Array, enough: float, most: int
) -> tuple[Minimum, Array]:
    """Return the best fit with d and f within their bounds when the free one breaks them.

    One of the two then lies on a bound: every bound is tried, with the torque at the reference speed kept.
    """
    lower, upper = problem.layout.bounds()
    valleys = problem.valleys
    try:
        while broken := [v for v in problem.valleys if _broken(v, theta, lower, upper)]:
            v = broken[0]
            problem.valleys = tuple(w for w in problem.valleys if w.f != v.f)
            ends = []
            for held, begin in _edges_of(v, theta, lower, upper):
                low, high = lower.copy(), upper.copy()
                low[held] = high[held] = begin[held]
                least, greatest = problem.straight_bounds(low, high)
                try:
                    end = minimise(
                        problem,
                        problem.straight(begin),
                        least,
                        greatest,
                        absolute=enough,
                        max_iterations=most,
                    )
                except EstimationError:
                    continue
                ends.append((end, low, high))
            if not ends:
                return replace(minimum, converged=False), np.clip(theta, lower, upper)
            minimum, lower, upper = min(ends, key=lambda end: end[0].cost)
            theta = problem.physical(minimum.x)
    finally:
        problem.valleys = valleys
    return minimum, theta


def _broken(v: Valley, theta: Array, lower: Array, upper: Array) -> bool:
    places = [i for i in (v.d, v.f) if i is not None]
    return bool(np.any(theta[places] < lower[places]) or np.any(theta[places] > upper[places]))


def _edges_of(v: Valley, theta: Array, lower: Array, upper: Array) -> Iterator[tuple[list[int], Array]]:
    """Yield what is held, and variables with d or f on a bound, the torque at the reference speed kept."""
    if v.d is None:
        # a lone power law: with f within its range, in f itself
        yield [], np.clip(theta, lower, upper)
        return
    d, f, g, reference = theta[v.d], theta[v.f], theta[v.g], v.reference
    straight = reference**v.order
    torque = max(d * straight + f * reference**g, 1e-12)
    # the power of one law that has this torque and this slope at the reference speed
    alike = float(np.clip((v.order * d * straight + g * f * reference**g) / torque, lower[v.g], upper[v.g]))
    for held, other in ((v.d, v.f), (v.f, v.d)):
        power = alike if held == v.d else g
        unit = {v.d: straight, v.f: reference**power}
        for bound in {float(b[held]) for b in (lower, upper) if np.isfinite(b[held])}:
            begin = theta.copy()
            begin[held] = bound
            begin[other] = max(torque - bound * unit[held], 0.0) / unit[other]
            begin[v.g] = power
            yield [held], begin
