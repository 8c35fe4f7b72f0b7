"""Start values that need no guess from the user: linear regression on the integrated equations.

The laws are linear in their strengths gamma_k, so along the rough speeds

    I_c [omega_c(t) - omega_c(0)] = sum_k gamma_k integral_0^t law_k dt,

and the same for the rotor: a linear least-squares problem with bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fitting.errors import EstimationError
from fitting.estimation.layout import START_CASING, START_ROTOR, Layout
from fitting.estimation.levenberg import minimise
from fitting.estimation.problem import Problem
from fitting.model import INERTIA_CASING, INERTIA_ROTOR, Dynamics

Array = NDArray[np.float64]

_FIRST_SHARE = 0.1
# a casing slower than this share of its largest speed is taken to stand still, for start values
_AT_REST = 0.01


def first_values(problem: Problem, given: Mapping[str, float] | None) -> Array:
    """Return where a fit starts: what was given, and the start values of all else."""
    layout = problem.layout
    known = dict(given or {})
    if not set(layout.names) <= set(known):
        rough = [d.rough_speeds for d in problem.data]
        guessed = dict(
            zip(layout.names, start_values(layout, problem.reference, rough).tolist(), strict=True)
        )
        known = guessed | {k: v for k, v in known.items() if k in guessed}
    return np.array([known[n] for n in layout.names])


def start_values(layout: Layout, reference: float, rough: Sequence[tuple[Array, Array]]) -> Array:
    """Return start values of all variables.

    Parameters
    ----------
    layout : Layout
        The variables.
    rough : sequence of (times, speeds)
        Of each case, as `fitting.rough_speeds` gives them.
    reference : float
        Speed difference [rad/s] at which a power law starts with a tenth of the linear law's torque.
    """
    theta = np.array([_resting(layout, name) for name in layout.names])
    found: dict[int, list[float]] = {}
    for case, (times, speeds) in enumerate(rough):
        keys, values = _regress(layout, case, times, speeds, theta)
        for key, value in zip(keys, values, strict=True):
            found.setdefault(int(layout.places(case, [key])[0]), []).append(value)
        i, j = layout.places(case, (START_ROTOR, START_CASING))
        theta[i], theta[j] = speeds[0]
    for place, several in found.items():
        theta[place] = float(np.mean(several))
    pair = ("bearing.linear.d", "bearing.power.f", "bearing.power.g")
    if all(k in layout.model.free for k in pair):
        places = [layout.places(i, pair) for i in range(len(rough))]
        for d, f, g in [p for p in places if theta[p[1]] <= 0]:
            torque = max(theta[d] * reference, 1e-9)
            theta[f] = _FIRST_SHARE * torque / reference ** theta[g]
            theta[d] = (1 - _FIRST_SHARE) * torque / reference
    return theta


def _resting(layout: Layout, name: str) -> float:
    p = layout.parameter(name)
    if p.relative and p.grid:
        first, last = layout.records[0].span
        return first + p.grid[len(p.grid) // 2] * (last - first)
    return p.start


def _regress(layout: Layout, case: int, times: Array, speeds: Array, theta: Array) -> tuple[list[str], Array]:
    dynamics = Dynamics(layout.model.smooth)
    numbers = layout.numbers(theta, case)
    state = np.concatenate([speeds, np.zeros((len(times), len(dynamics.states) - 2))], axis=1)
    # linear in its strength, but hardly to be told from the linear law while its power is free
    curved = ("bearing.heating.", *(("bearing.power.",) if "bearing.power.g" in dynamics.parameters else ()))
    linear = [
        k
        for k in dynamics.parameters
        if layout.model.parameters[k].role == "amplitude" and not k.startswith(curved)
    ] or [k for k in dynamics.parameters if layout.model.parameters[k].role == "amplitude"]
    if not {"bearing.linear.d", "bearing.power.f"} & {*linear} and "bearing.power.f" in dynamics.parameters:
        linear.append("bearing.power.f")
    with np.errstate(all="ignore"):
        # without the strengths that are sought: what parameters held at a value do
        still, _, b = dynamics.linearised(times, state, numbers | dict.fromkeys(linear, 0.0))
    columns = np.array([dynamics.parameters.index(k) for k in linear])
    weight = np.array([numbers[INERTIA_ROTOR], numbers[INERTIA_CASING]])
    rates = b[:, :2][:, :, columns]
    wild = ~np.isfinite(rates).all(axis=(0, 1))
    if wild.any():
        name = linear[int(np.flatnonzero(wild)[0])].rpartition(".")[0]
        raise EstimationError(
            f"the law of {name[:80]!r} has no finite value at the measured speeds",
            "look for a division by zero or a huge exponent",
        )
    integrals = _integral(times, rates)
    held = _integral(times, still[:, :2])
    # while friction holds the casing its torque is what it has to be, and says nothing
    seen = [np.ones(len(times), dtype=bool), _turning(speeds[:, 1])]
    blocks = [
        np.concatenate([integrals[:, i], _start_column(len(times), i)], axis=1)[seen[i]] * weight[i]
        for i in (0, 1)
    ]
    target = np.concatenate([(speeds[:, i] - held[:, i])[seen[i]] * weight[i] for i in (0, 1)])
    design = np.concatenate(blocks)
    size = np.linalg.norm(design, axis=0)
    size[size == 0] = 1.0
    lower = np.array([*(layout.model.parameters[k].lower for k in linear), -np.inf, -np.inf])
    upper = np.array([*(layout.model.parameters[k].upper for k in linear), np.inf, np.inf])
    unit, aim = design / size, target / np.linalg.norm(target)
    solution = minimise(
        lambda x: (unit @ x - aim, unit), np.zeros(len(size)), lower, upper, tolerance=1e-10, absolute=1e-14
    )
    values = solution.x / size * np.linalg.norm(target)
    return linear, values[: len(linear)]


def _turning(omega_c: Array) -> NDArray[np.bool_]:
    """Return the longest stretch in which the casing does not rest."""
    slow = np.abs(omega_c) < _AT_REST * np.abs(omega_c).max(initial=0.0)
    ends = np.flatnonzero(np.diff(np.concatenate([[True], slow, [True]]).astype(int)))
    if not len(ends):
        return np.ones(len(omega_c), dtype=bool)
    start, stop = max(zip(ends[::2], ends[1::2], strict=True), key=lambda pair: pair[1] - pair[0])
    inside = np.zeros(len(omega_c), dtype=bool)
    inside[start:stop] = True
    return inside


def _integral(times: Array, rates: Array) -> Array:
    steps = np.diff(times).reshape(-1, *[1] * (rates.ndim - 1))
    middle = 0.5 * (rates[1:] + rates[:-1]) * steps
    return np.concatenate([np.zeros((1, *rates.shape[1:])), np.cumsum(middle, axis=0)])


def _start_column(n: int, body: int) -> Array:
    column = np.zeros((n, 2))
    column[:, body] = 1.0
    return column
