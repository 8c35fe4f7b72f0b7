"""Nonlinear least squares with bounds: Levenberg-Marquardt on the free variables.

J. J. More, The Levenberg-Marquardt algorithm, Lect. Notes Math. 630 (1978), with H. B. Nielsen's update of
the damping (IMM-REP-1999-05). A variable on its bound whose gradient points outward is held for the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.errors import EstimationError, SimulationError

Array = NDArray[np.float64]
Problem = Callable[[Array], tuple[Array, Array]]

# a fall of the sum of squares, in variances of the noise, that moves no parameter by a tenth of its error
_WORTH_WHILE = 0.01
_HARDLY_DAMPED = 1e-20


@dataclass(frozen=True)
class Minimum:
    """Where the search ended: variables, residuals, Jacobian, sum of squares, and whether it converged."""

    x: Array
    residual: Array
    jacobian: Array
    cost: float
    converged: bool
    iterations: int
    at_bound: NDArray[np.bool_]


def minimise(
    problem: Problem,
    start: Array,
    lower: Array,
    upper: Array,
    *,
    tolerance: float = 1e-9,
    absolute: float = 1e-7,
    max_iterations: int = 200,
) -> Minimum:
    """Minimise the sum of squares of residuals.

    Parameters
    ----------
    problem : callable
        x -> (residuals (m,), Jacobian (m, n)); may raise `SimulationError` where it has no value.
    start, lower, upper : ndarray, shape (n,)
        Start and bounds.
    tolerance : float
        The search ends when the sum of squares is predicted to fall, and falls, by less than this
        share of itself, or by less than `absolute` in all.
    absolute : float
        See `tolerance`.
    max_iterations : int
        Steps tried at most.

    Returns
    -------
    Minimum

    Raises
    ------
    EstimationError
        If the problem has no value at the start.
    """
    x = np.clip(start, lower, upper)
    try:
        r, j = problem(x)
    except SimulationError as fault:
        raise EstimationError(
            f"the model cannot be computed at its start values: {fault.message}", fault.hint
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
            if _undamped(r, j, unit, lower - x, upper - x) < _WORTH_WHILE + enough:
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
                if _undamped(r, j, unit, lower - x, upper - x) < _WORTH_WHILE + enough:
                    converged = True
                    break
                damping *= 0.01
        elif damping > 1e14:
            # no step helps, however short: rounding has the last word
            converged = _undamped(r, j, unit, lower - x, upper - x) < _WORTH_WHILE + enough
            break
        else:
            damping *= growth
            growth *= 2
    return Minimum(x, r, j, cost, converged, iteration, (x <= lower) | (x >= upper))


def _undamped(r: Array, j: Array, unit: Array, down: Array, up: Array) -> float:
    """Return by how much the sum of squares would fall with no damping, if the problem were linear.

    Where variables are nearly collinear a damped step promises little although the valley still falls.
    """
    step = _step(r, j, unit, _HARDLY_DAMPED, down, up)
    return float(r @ r) - float(np.sum((r + j @ step) ** 2))


def _step(r: Array, j: Array, scale: Array, damping: float, down: Array, up: Array) -> Array:
    """Return the damped Gauss-Newton step within the room `down` to `up`; who hits a bound stays there."""
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
