"""Start values of shape constants: exponents, time constants, characteristic speeds, moments.

A law whose strength is nothing has no gradient by its shape, and from a wrong shape the search may not find back. So
the model is fitted without the law; then, for every shape on a grid, the derivative of the rows by the strength tells
how far the deviance would fall (a score test), and the best shape is where the full search starts. The random torque
that a model without the law is excused with would excuse any shape: its level competes with the law for what is left.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from fitting.effects import LIBRARY, Effect
from fitting.errors import SimulationError
from fitting.estimation.case_model import Prediction
from fitting.estimation.coordinates import is_power_law
from fitting.estimation.layout import Layout
from fitting.estimation.noise_levels import Noise, measure_noise
from fitting.estimation.problem import Problem
from fitting.estimation.search import search
from fitting.model import Model

Array = NDArray[np.float64]

_POWERS = (0.25, 0.5, 0.75, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0)
_MOST = 80
_COLLINEAR = 1e-7
# of the level of random torque without the law
_SHARES = (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3)


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


def start_shapes(
    problem: Problem,
    theta: Array,
    effects: list[Effect],
    *,
    fitted: bool,
    noise: Sequence[Noise] | None = None,
) -> Array:
    """Return variables with the shapes of some effects on the best point of their grids.

    The problem's noise is then what they leave.

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
    noise : sequence of Noise, optional
        The noise without these effects, if it is known.
    """
    layout = problem.layout
    theta = theta.copy()
    for effect in effects:
        theta[_places(layout, effect, "amplitude")] = 0.0
    if not fitted:
        theta = _without(problem, theta, effects)
    noise = measure_noise(problem, theta) if noise is None else noise
    for effect in effects:
        theta = _best(problem, theta, effect, noise)
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


def _best(problem: Problem, theta: Array, effect: Effect, noise: Sequence[Noise]) -> Array:
    """Return variables with the best shape of one effect; the noise of the problem is then what it leaves."""
    layout = problem.layout
    starts = []
    for values in _grid(problem, effect):
        begin = theta.copy()
        for symbol, value in values.items():
            for case in range(len(layout.records)):
                begin[layout.places(case, [f"{effect.name}.{symbol}"])] = value
        with suppress(SimulationError):
            starts.append((begin, problem.predict(begin)))
    ends = []
    for share in _SHARES:
        whiteners = [n.whitener.at(max(n.pure, share * n.level)) for n in noise]
        problem.set_noise(whiteners)
        loud = sum(w.log_determinant for w in whiteners)
        for begin, predictions in starts:
            found = _stepped(problem, begin, predictions, _places(layout, effect, "amplitude"))
            if found is not None:
                ends.append((loud + found[0], found[1], whiteners))
    if not ends:
        problem.set_noise([n.whitener for n in noise])
        return theta
    _, chosen, whiteners = min(ends, key=lambda end: end[0])
    problem.set_noise(whiteners)
    return chosen


def _stepped(
    problem: Problem, begin: Array, predictions: Sequence[Prediction], strength: NDArray[np.intp]
) -> tuple[float, Array] | None:
    """Return chi-square after one linear step of all variables, and variables with the strength it gives."""
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
