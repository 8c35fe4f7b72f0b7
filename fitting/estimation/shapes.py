"""Start values of shape constants: exponents, time constants, characteristic speeds, moments.

A law whose strength is nothing has no gradient by its shape, and from a wrong shape the search may not find back. So
the model is fitted without the law; then, for every shape on a grid, the derivative of the rows by the strength tells
how far chi-square would fall (a score test), and the best shape is where the full search starts.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from fitting.effects import LIBRARY, Effect
from fitting.errors import SimulationError
from fitting.estimation.coordinates import is_power_law
from fitting.estimation.layout import Layout
from fitting.estimation.problem import Problem
from fitting.estimation.search import search
from fitting.model import Model

Array = NDArray[np.float64]

_POWERS = (0.25, 0.5, 0.75, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0)
_MOST = 80
_COLLINEAR = 1e-7


def unknown_shapes(layout: Layout, given: Mapping[str, float] | None) -> list[Effect]:
    """Return the effects of a model whose shape constants were not given and need a search of their own."""
    known = {name.partition("@")[0] for name in given or {}}
    effects = []
    for e in layout.model.smooth.effects:
        roles = {p.role for p in e.parameters}
        shapes = [f"{e.name}.{p.symbol}" for p in e.parameters if p.role == "shape"]
        # the exponent of the bearing's own power law has straight variables and a start that serves
        alone = e.joint == "bearing" and sum(o.joint == "bearing" for o in layout.model.effects) == 1
        searched = (
            not alone and e.name != "bearing.power" and "phase" not in roles and e.amplitude is not None
        )
        if shapes and searched and not known.intersection(shapes):
            effects.append(e)
    return effects


def start_shapes(problem: Problem, theta: Array, effects: list[Effect], *, fitted: bool) -> Array:
    """Return variables with the shapes of some effects on the best point of their grids.

    Parameters
    ----------
    problem : Problem
        The fit, at a cautious noise.
    theta : ndarray
        Variables so far.
    effects : list of Effect
        The effects.
    fitted : bool
        Whether the others are at the best fit without these effects already.
    """
    layout = problem.layout
    theta = theta.copy()
    for effect in effects:
        theta[_places(layout, effect, "amplitude")] = 0.0
    if not fitted:
        theta = _without(problem, theta, effects)
    for effect in effects:
        theta = _best(problem, theta, effect)
    return theta


def _without(problem: Problem, theta: Array, effects: list[Effect]) -> Array:
    layout = problem.layout
    names = {e.name for e in effects}
    model = Model(tuple(e for e in layout.model.effects if e.name not in names))
    smaller = Layout(model, layout.records, layout.per_case, layout.ranges)
    rest = Problem(smaller, problem.data)
    rest.set_noise([p.whitener for p in problem.projections])
    places = [layout.index[n] for n in smaller.names]
    out = theta.copy()
    out[places] = search(rest, theta[places])[1]
    return out


def _best(problem: Problem, theta: Array, effect: Effect) -> Array:
    layout = problem.layout
    strength = _places(layout, effect, "amplitude")
    lower, upper = layout.bounds()
    best, chosen = -np.inf, theta
    for values in _grid(problem, effect):
        begin = theta.copy()
        for symbol, value in values.items():
            for case in range(len(layout.records)):
                begin[layout.places(case, [f"{effect.name}.{symbol}"])] = value
        try:
            r, j = problem.residuals(problem.predict(begin))
        except SimulationError:
            continue
        size = np.linalg.norm(j, axis=0)
        moving = size > 0
        if not np.isfinite(size).all() or not moving[strength].all():
            continue
        step = np.zeros(len(theta))
        step[moving] = np.linalg.lstsq(j[:, moving] / size[moving], -r, rcond=_COLLINEAR)[0] / size[moving]
        allowed = (step[strength] >= lower[strength]) & (step[strength] <= upper[strength])
        fall = float(r @ r - np.sum((r + j @ step) ** 2)) if allowed.all() else 0.0
        if fall > best:
            best, chosen = fall, begin
            chosen[strength] = np.clip(step[strength], lower[strength], upper[strength])
    return chosen


def _grid(problem: Problem, effect: Effect) -> Iterator[dict[str, float]]:
    first, last = problem.layout.records[0].span
    axes = []
    for p in effect.parameters:
        if p.role != "shape":
            continue
        grid = np.array(p.grid or (p.start,))
        if effect.name not in LIBRARY and is_power_law(effect, *problem.data[0].rough_speeds):
            grid = np.array([v for v in _POWERS if p.lower <= v <= p.upper] or [p.start])
        if p.relative:
            grid = grid * (last - first) + (first if p.symbol == effect.breakpoint else 0.0)
        axes.append([(p.symbol, float(v)) for v in grid])
    for values in itertools.islice(itertools.product(*axes), _MOST):
        yield dict(values)


def _places(layout: Layout, effect: Effect, role: str) -> NDArray[np.intp]:
    keys = [f"{effect.name}.{p.symbol}" for p in effect.parameters if p.role == role]
    return np.unique(np.concatenate([layout.places(i, keys) for i in range(len(layout.records))]))
