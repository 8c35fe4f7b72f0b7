"""The fit: initial values, noise levels, minimum, uncertainties.

It goes past the places where a wrong path would hold it: stops at wrong times, bounds far from the data, other
valleys.

Two levels of random torque are found for each case. The *pure* level is what no slow torque can explain: the
noise. The *level* of the fit is what this model leaves: the same if the model is right, more if it
misses something. Parameters are estimated at the level of the fit, so that a model that fails by a
thousand sigma somewhere is not torn there; its chi-square and held-out error are told at the pure level.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EstimationError, FittingError
from fitting.dynamics._model import Model
from fitting.inference._case_data import CaseData
from fitting.inference._initial_values import first_values, start_shapes, unknown_shapes
from fitting.inference._noise import WHITE
from fitting.inference._noise_level import Noise, cautious, first_noise, measure_noise, refine_level
from fitting.inference._optimisation import search, search_around, search_widely
from fitting.inference._parameters import Layout
from fitting.inference._problem import Problem
from fitting.inference._record import Record
from fitting.inference._result import Fit, outcome

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


# chi2 per row with which a level of random torque is what the model leaves
_EXCUSED = 1.5


def fit(
    model: Model,
    cases: Sequence[Record | CaseData],
    *,
    share: Iterable[str] = (),
    per_case: Iterable[str] = (),
    start: Mapping[str, float] | None = None,
    noise: Sequence[Noise] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    steady: Iterable[str] = (),
    quick: bool = False,
) -> Fit:
    """Fit a model to one case, or to several together.

    Parameters
    ----------
    model : Model
        The model.
    cases : sequence of Record or CaseData
        Each experiment; with several, the touch point, the casing's drag and the start speeds have
        a value for each, all else is shared.
    share, per_case : iterable of str
        Change which parameters are shared.
    start : mapping, optional
        Values to start from; the others come from a regression.
    noise : sequence of Noise, optional
        The noise found by an earlier fit of the same data, so that both can be compared.
    ranges : mapping, optional
        Bounds tighter than the declared ones.
    steady : iterable of str
        Parameters, by their names in the fit, that keep their start values until all others have followed.
    quick : bool
        Stop where chi-square is within about 0.01 of its minimum: enough to rank candidates.

    Returns
    -------
    Fit

    Raises
    ------
    EstimationError
        If there is nothing to fit, or labels repeat.
    """
    data = [c if isinstance(c, CaseData) else CaseData.of(c) for c in cases]
    _check(model, data)
    problem = Problem(Layout.of(model, [d.record for d in data], share, per_case, ranges), data)
    theta = first_values(problem, start)
    if noise is None:
        theta, noise = search_with_noise(problem, theta, start, quick=quick)
    elif not set(problem.layout.names) <= set(start or ()):
        # far from the minimum a model fails by far more than the noise, and a valley seen so sharply is hard to follow
        problem.set_noise(cautious(problem, theta, noise))
        theta, unknown = shaped(problem, theta, start, noise)
        theta = search_around(problem, theta, unknown)
        noise = refine_level(problem, theta, noise)
    problem.set_noise([n.whitener for n in noise])
    held = tuple(steady)
    if held:
        theta = search_around(problem, theta, held)
        # the noise that the model was excused with before the law came would excuse any shape
        noise = refine_level(problem, theta, noise)
        problem.set_noise([n.whitener for n in noise])
    _, theta = search(problem, theta, quick=quick)
    noise = refine_level(problem, theta, noise)
    problem.set_noise([n.whitener for n in noise])
    minimum, theta = search(problem, theta, quick=quick)
    if minimum.cost > _EXCUSED * problem.rows:
        noise = refine_level(problem, theta, noise, settled=True)
        problem.set_noise([n.whitener for n in noise])
        minimum, theta = search(problem, theta, quick=quick)
    return outcome(problem, theta, noise, converged=minimum.converged)


def _check(model: Model, data: Sequence[CaseData]) -> None:
    labels = [d.record.label for d in data]
    if not data or len(set(labels)) != len(labels):
        raise EstimationError(
            "the cases of a joint fit need different labels", "give them with --label when making a case"
        )
    single = [d.record.single for d in data]
    if any(single) != all(single):
        raise EstimationError(
            "one body alone and a rotor in its casing cannot be fitted together", "fit them one by one"
        )
    foreign = [e.name for e in model.effects if not e.single_body] if all(single) else []
    if foreign:
        raise EstimationError(
            f"{foreign[0]} speaks of a rotor, which this record of one body does not have",
            "its laws are those that act on the casing alone: `gyrotrack effects` lists them",
        )
