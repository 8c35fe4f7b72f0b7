"""Where a law sets in: the deviance has many hollows along such a time, and a search slides into the nearest.

About a refit, the time is moved step by step through its neighbourhood, all else following linearly,

    cost(t0) = | M (z - rows(t0)) |^2,   M = 1 - J (J'J)^-1 J',

and the best place is a start for another refit. A case that stays loud beside the others has its time far off: the
first search took place while the parameters that all cases share were bent by what was missing in each. Once the
other cases have pinned them, its whole record is searched again by the score test.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitting.discovery.columns import CaseColumns
from fitting.discovery.scoring import search_alone
from fitting.discovery.stage import Stage
from fitting.effects import Effect
from fitting.errors import SimulationError
from fitting.estimation import Fit
from fitting.estimation.lack import orthonormal

Array = NDArray[np.float64]

_REACH = 0.04
_STEPS = 48
_RANK = 1e-7
# a score that empty data would hardly ever show
_CLEAR = 25.0


def distant_breaks(fit: Fit, effect: Effect) -> dict[str, float]:
    """Return the parameters of a fit with the effect set in anew in the cases in which the fit leaves a torque.

    Parameters
    ----------
    fit : Fit
        A fit with the effect.
    effect : Effect
        One that has a breakpoint.

    Returns
    -------
    dict
        Values by name; empty if nothing speaks for another time.
    """
    layout = fit.problem.layout
    strength = next(p.symbol for p in effect.parameters if p.role == "amplitude")
    keys = [f"{effect.name}.{effect.breakpoint}", f"{effect.name}.{strength}"]
    loud = [i for i, n in enumerate(fit.noise) if n.level > n.pure]
    if not loud:
        return {}
    theta, stage = fit.theta.copy(), Stage(fit, 1)
    for index in loud:
        found = search_alone(stage, effect, CaseColumns(fit, index).trials(effect), index)
        if found.score > _CLEAR:
            places = [int(layout.places(index, [k])[0]) for k in keys]
            theta[places] = found.shape[0][effect.breakpoint], found.gamma[0]
    return _moved(fit, theta)


def better_breaks(fit: Fit, effect: Effect) -> dict[str, float]:
    """Return the parameters of a fit with the times at which an effect sets in at their best places.

    Parameters
    ----------
    fit : Fit
        A fit with the effect.
    effect : Effect
        One that has a breakpoint.

    Returns
    -------
    dict
        Values by name; empty if they stand well.
    """
    layout, key = fit.problem.layout, f"{effect.name}.{effect.breakpoint}"
    theta = fit.theta.copy()
    for index in range(len(fit.problem.cases)):
        (place,) = layout.places(index, [key])
        theta[place] = _best(fit, index, int(place))
    return _moved(fit, theta)


def _moved(fit: Fit, theta: Array) -> dict[str, float]:
    """Return variables by name; nothing if they are those of the fit."""
    if np.array_equal(theta, fit.theta):
        return {}
    return dict(zip(fit.problem.layout.names, theta.tolist(), strict=True))


def _best(fit: Fit, index: int, place: int) -> float:
    case, project = fit.problem.cases[index], fit.problem.projections[index]
    first, last = case.data.record.span
    now = float(fit.theta[place])
    basis = orthonormal(project(np.delete(fit.predictions[index].jacobian, place, axis=1)), _RANK)

    def cost(t: float) -> float:
        theta = fit.theta.copy()
        theta[place] = t
        try:
            left = project(case.data.z - case.predict(theta).rows)
        except SimulationError:
            return np.inf
        left = left - basis @ (basis.T @ left)
        return float(left @ left)

    reach = _REACH * (last - first)
    times = np.linspace(max(first, now - reach), min(last, now + reach), _STEPS)
    costs = [cost(float(t)) for t in times]
    best = int(np.argmin(costs))
    return float(times[best]) if costs[best] < cost(now) else now
