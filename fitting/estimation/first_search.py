"""The first search of a fit, while its noise is not known: cautious at first, then as loud as the data is.

It goes past the places where a wrong path would hold it: stops at wrong times, bounds far from the data, other
valleys.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from fitting.errors import EstimationError, FittingError
from fitting.estimation.noise_levels import Noise, first_noise, measure_noise
from fitting.estimation.problem import Problem
from fitting.estimation.search import search, search_around, search_widely
from fitting.estimation.shapes import start_shapes, unknown_shapes
from fitting.estimation.start import first_values
from fitting.noise import WHITE

Array = NDArray[np.float64]

_OTHER_POWERS = (0.7, 1.35)
# a casing slower than this share of its largest speed is taken to stand still
_AT_REST = 0.01
_PATIENCE = 60


def search_with_noise(
    problem: Problem, theta: Array, given: Mapping[str, float] | None, *, quick: bool
) -> tuple[Array, tuple[Noise, ...]]:
    """Return the variables of the minimum and the noise measured there.

    Parameters
    ----------
    problem : Problem
        The fit.
    theta : ndarray
        Where to start.
    given : mapping, optional
        Which of these values the user gave.
    quick : bool
        Stop where chi-square is within about 0.01 of its minimum.
    """
    problem.set_noise([n.whitener for n in first_noise(problem, theta)])
    theta, held = shaped(problem, theta, given)
    if _stops(problem, theta):
        theta = _past_stops(problem, theta)
    if held:
        theta = search_around(problem, theta, held)
        problem.set_noise([n.whitener for n in measure_noise(problem, theta)])
    theta = search_widely(problem, theta, _elsewhere(problem, theta, given), quick=quick)
    return _tight(problem, theta, measure_noise(problem, theta))


def shaped(
    problem: Problem, theta: Array, given: Mapping[str, float] | None, noise: Sequence[Noise] | None = None
) -> tuple[Array, tuple[str, ...]]:
    """Return variables with start values of those shape constants that were not given, and the names of these."""
    unknown = unknown_shapes(problem.layout, given)
    if not unknown:
        return theta, ()
    names = {n for n in problem.layout.names if not n.startswith(tuple(f"{e.name}." for e in unknown))}
    shapes = tuple(f"{e.name}.{p.symbol}" for e in unknown for p in e.parameters if p.role == "shape")
    held = tuple(n for n in problem.layout.names if n.partition("@")[0] in shapes)
    return start_shapes(problem, theta, unknown, fitted=names <= set(given or ()), noise=noise), held


def _stops(problem: Problem, theta: Array) -> bool:
    """Return whether a casing comes to rest or turns back, as it was measured or as the model has it."""
    for d in problem.data:
        speed = np.abs(d.rough_speeds[1][:, 1])
        if (speed[len(speed) // 20 :] < _AT_REST * speed.max(initial=0.0)).any():
            return True
    return any(p.path.jumps for p in problem.predict(theta))


def _past_stops(problem: Problem, theta: Array) -> Array:
    """Return variables from a search without random torque, and set the noise about them.

    What a torque does after a stop at a wrong time is wrong too, and would hold the search there.
    """
    problem.set_noise([WHITE] * len(problem.data))
    with suppress(EstimationError):
        _, theta = search(problem, theta, quick=True, most=_PATIENCE)
    problem.set_noise([n.whitener for n in first_noise(problem, theta)])
    return theta


def _tight(problem: Problem, theta: Array, noise: tuple[Noise, ...]) -> tuple[Array, tuple[Noise, ...]]:
    """Return variables and noise, found anew with less noise than the model leaves, if that describes the data better.

    What noise does to a casing that is held is told from the fitted path. About a path that stops at a wrong time it
    may hold the fit there. So may an edge of a parameter, far from the data, where noise excuses what is wrong. And
    where several cases are fitted together, noise in all of them excuses a compromise with one that the model fails.
    """
    ends = [(theta, noise)]
    for levels in _stricter(problem, theta, noise):
        problem.set_noise([n.whitener.at(level) for n, level in zip(noise, levels, strict=True)])
        # without the excuse a search may run away to where nothing can be computed
        with suppress(FittingError):
            _, other = search(problem, theta)
            ends.append((other, measure_noise(problem, other)))
    return min(ends, key=lambda end: _deviance(problem, *end))


def _stricter(problem: Problem, theta: Array, noise: Sequence[Noise]) -> Iterator[tuple[float, ...]]:
    """Yield levels of the random torque in each case with which a search may end elsewhere."""
    excused = [n for n in noise if n.level > n.pure]
    held = excused and any((p.path.sense == 0).any() for p in problem.predict(theta))
    if held or (excused and problem.layout.at_bound(theta).any()):
        # the pure level was found about a wrong path too: with none at all the angles alone have a say
        yield from dict.fromkeys([tuple(n.pure for n in noise), (0.0,) * len(noise)])
    if len(excused) > 1:
        worst = max(excused, key=lambda n: n.excess)
        yield tuple(n.level if n is worst else n.pure for n in noise)


def _deviance(problem: Problem, theta: Array, noise: Sequence[Noise]) -> float:
    problem.set_noise([n.whitener for n in noise])
    r, _ = problem.residuals(problem.predict(theta))
    return float(r @ r) + sum(n.whitener.log_determinant for n in noise)


def _elsewhere(problem: Problem, theta: Array, given: Mapping[str, float] | None) -> Iterator[Array]:
    """Yield other starts: the program's own if one was given, and other exponents of the bearing's power law."""
    own = first_values(problem, None) if given else theta
    if given:
        yield own
    for g in _OTHER_POWERS:
        begin = own.copy()
        for v in problem.valleys:
            begin = problem.physical(np.where(np.arange(len(own)) == v.g, g, problem.straight(begin)))
        if problem.valleys:
            yield begin
