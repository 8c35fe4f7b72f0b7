"""Start values that need no guess from the user: linear regression on the integrated equations.

The laws are linear in their strengths gamma_k, so along the rough speeds

    I_c [omega_c(t) - omega_c(0)] = sum_k gamma_k integral_0^t law_k dt,

and the same for the rotor: a linear least-squares problem with bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics import INERTIA_CASING, INERTIA_ROTOR, Dynamics
from fitting.errors import EstimationError
from fitting.estimation.layout import START_CASING, START_ROTOR, Layout
from fitting.estimation.levenberg import minimise
from fitting.estimation.problem import Problem, turned

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
    parts = []
    for case, (times, speeds) in enumerate(rough):
        keys, design, target = _equations(layout, case, times, speeds, theta)
        parts.append((layout.places(case, keys), design, target))
    # what cases share is sought in all of them at once: a mean of what each says alone need not suit any
    places, values = _regress(layout, parts)
    theta[places] = values
    for case, (_, speeds) in enumerate(rough):
        theta[layout.places(case, (START_ROTOR, START_CASING))] = speeds[0]
    pair = ("bearing.linear.d", "bearing.power.f", "bearing.power.g")
    if all(k in layout.model.free for k in pair):
        # each bearing once, however many cases share it
        for d, f, g in dict.fromkeys(tuple(layout.places(i, pair).tolist()) for i in range(len(rough))):
            if theta[f] > 0:
                continue
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


def _equations(
    layout: Layout, case: int, times: Array, speeds: Array, theta: Array
) -> tuple[list[str], Array, Array]:
    """Return the strengths of one case, and the linear equations for them with both start speeds free."""
    dynamics = Dynamics(layout.model.smooth)
    numbers = layout.numbers(theta, case)
    state = np.concatenate([speeds, np.zeros((len(times), len(dynamics.states) - 2))], axis=1)
    linear = _strengths(layout, dynamics.parameters)
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
    blocks, targets = [], []
    for i in (0, 1):
        columns = np.column_stack([integrals[:, i], speeds[:, i] - held[:, i]])[seen[i]] * weight[i]
        columns = columns - columns.mean(axis=0)
        blocks.append(columns[:, :-1])
        targets.append(columns[:, -1])
    return linear, np.concatenate(blocks), np.concatenate(targets)


def _strengths(layout: Layout, parameters: Sequence[str]) -> list[str]:
    """Return the parameters in which the equations are linear, and which the data can tell apart so."""
    every = [k for k in parameters if layout.model.parameters[k].role == "amplitude"]
    # linear in its strength, but hardly to be told from the linear law while its power is free
    curved = ("bearing.heating.", *(("bearing.power.",) if "bearing.power.g" in parameters else ()))
    linear = [k for k in every if not k.startswith(curved)] or every
    if not {"bearing.linear.d", "bearing.power.f"} & {*linear} and "bearing.power.f" in parameters:
        linear.append("bearing.power.f")
    return linear


def _regress(
    layout: Layout, parts: Sequence[tuple[NDArray[np.intp], Array, Array]]
) -> tuple[NDArray[np.intp], Array]:
    """Return the places of all strengths and their values within bounds, by linear least squares."""
    places = np.unique(np.concatenate([own for own, _, _ in parts]))
    rows, aims = [], []
    for own, design, target in parts:
        few = turned(np.column_stack([design, target]))
        rows.append(np.zeros((len(few), len(places))))
        rows[-1][:, np.searchsorted(places, own)] = few[:, :-1]
        aims.append(few[:, -1])
    stacked, aim = np.concatenate(rows), np.concatenate(aims)
    size = np.linalg.norm(stacked, axis=0)
    size[size == 0] = 1.0
    scale = float(np.linalg.norm(aim)) or 1.0
    unit, aim = stacked / size, aim / scale
    lower, upper = (bound[places] for bound in layout.declared_bounds())
    solution = minimise(
        lambda x: (unit @ x - aim, unit), np.zeros(len(size)), lower, upper, tolerance=1e-10, absolute=1e-14
    )
    return places, solution.x / size * scale


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
