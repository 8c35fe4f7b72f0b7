"""First-order constants of a body that an input drives: time constant and gain.

A body with J d(omega)/dt = k u - c omega - b sign(omega) follows its input u with the time constant tau = J / c and the
gain k / c. Here J is the moment of inertia, c the linear drag, b the dry friction, and k the torque per unit of the
input. The gain is the change of the final speed per unit of the input. Time constant and gain are functions of the
parameters alone, so their standard uncertainties follow, to first order, from the covariance of the fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fitting._errors import EstimationError
from fitting._numbers import rounded
from fitting.effects._effect import format_unit, parse_unit, quotient
from fitting.effects._expression import ONE, Expr, Tape, derivative, div
from fitting.inference._params import Estimate
from fitting.inference._result import Fit


@dataclass(frozen=True)
class FirstOrder:
    """First-order constants of a body of one case.

    Attributes
    ----------
    label, body : str
        The case, and the body ("body" if it is alone).
    time_constant : Estimate
        tau = J / c [s].
    gains : dict of str to Estimate
        Change of the final speed per unit of each input [rad/s per unit of the input].
    delays : dict of str to Estimate
        Dead time of each input whose dead time is fitted [s].
    """

    label: str
    body: str
    time_constant: Estimate
    gains: Mapping[str, Estimate]
    delays: Mapping[str, Estimate]


def first_order_lines(found: Iterable[FirstOrder]) -> list[str]:
    """Return time constant, gains and dead times as lines of text."""
    found = list(found)
    lines = []
    for f in found:
        case = f" of {f.label}" if len(found) > 1 else ""
        rows = [("time constant", f.time_constant), *((f"gain of {n}", e) for n, e in f.gains.items())]
        rows += [(f"dead time of {n}", e) for n, e in f.delays.items()]
        lines.append(f"first-order response of the {f.body}{case}")
        lines += [f"  {name:<32}{rounded(e.value, e.stderr, e.unit)}" for name, e in rows]
    return lines


def first_order(fit: Fit) -> tuple[FirstOrder, ...]:
    """Return the constants of each case in which a body has a first-order response to an input.

    Parameters
    ----------
    fit : Fit
        A fit of a model with a law that is proportional to a recorded input.

    Returns
    -------
    tuple of FirstOrder
        Empty if no body is driven by an input, or no response is of first order.
    """
    if not isinstance(fit, Fit):
        raise EstimationError(f"a {type(fit).__name__} is not a Fit", "use the result of fitting.fit")
    found = []
    for index, case in enumerate(fit.problem.cases):
        linear = case.dynamics.first_order
        if linear is None:
            continue
        decay, slopes = linear
        time_constant = _estimate(fit, index, div(ONE, decay), "s")
        if time_constant is None:
            continue
        record = case.data.record
        units = {i.name: i.unit for i in record.inputs}
        gains = {}
        for name, slope in slopes.items():
            unit = format_unit(quotient(parse_unit("rad s-1"), parse_unit(units[name])))
            gain = _estimate(fit, index, div(slope, decay), f"rad {unit}" if unit != "1" else "rad")
            if gain is not None:
                gains[name] = gain
        delays = {}
        for e in (e for e in fit.model.effects if e.joint == "input"):
            key = f"{e.name}.{e.parameters[0].symbol}"
            delay = fit.estimates.get(f"{key}@{record.label}") or fit.estimates.get(key)
            if delay is not None:
                delays[e.inputs[0][0]] = delay
        found.append(FirstOrder(record.label, record.body, time_constant, gains, delays))
    return tuple(found)


def _estimate(fit: Fit, index: int, quantity: Expr, unit: str) -> Estimate | None:
    """Evaluate a function of the parameters of one case, with standard uncertainty; None if it is not finite."""
    layout, dynamics = fit.problem.layout, fit.problem.cases[index].dynamics
    numbers = dynamics.constants | layout.numbers(fit.theta, index)
    tape = Tape([quantity, *(derivative(quantity, key) for key in dynamics.parameters)])
    with np.errstate(all="ignore"):
        value, *slopes = (float(x) for x in tape(numbers))
    if not math.isfinite(value):
        return None
    places = layout.places(index, dynamics.parameters)
    gradient = np.array(slopes)
    used = gradient != 0
    own = fit.covariance[np.ix_(places[used], places[used])]
    variance = float(gradient[used] @ own @ gradient[used]) if used.any() else 0.0
    # parameters at a bound and held parameters have no known uncertainty
    stderr = math.sqrt(variance) if math.isfinite(variance) and variance > 0 else math.nan
    return Estimate(value, stderr, unit, at_bound=False)
