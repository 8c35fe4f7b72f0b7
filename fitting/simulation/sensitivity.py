"""Sensitivities of a solution: to parameters, to the start, and to any small extra torque.

All solve the same linear equation d(dy)/dt = A(t) dy + b(t) on the mesh of the solution; a parameter that
is the time of a jump enters as a kick at that time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics import Dynamics
from fitting.simulation.mesh import Path, Sampler, rule
from fitting.simulation.propagator import Propagator

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of the states at nodes and edges, last axis the columns.

    Columns are the parameters of the dynamics, then the start values of omega_r and omega_c.
    """

    nodes: Array
    edges: Array
    propagator: Propagator


def sensitivities(dynamics: Dynamics, numbers: Mapping[str, float], path: Path) -> Sensitivity:
    """Return the derivatives of a solution by parameters and by the two start speeds."""
    _, a, b = dynamics.linearised(path.mesh.times, path.y, numbers, path.sense[:, None])
    propagator = Propagator(path.mesh, a, path.jumps)
    n, p = len(dynamics.states), len(dynamics.parameters)
    forcing = np.concatenate([b, np.zeros((*b.shape[:3], 2))], axis=3)
    first = np.zeros((n, p + 2))
    first[0, p] = first[1, p + 1] = 1.0
    kicks = _kicks(dynamics, numbers, path, p + 2)
    nodes, edges = _march(path, propagator, forcing, first, kicks)
    return Sensitivity(nodes, edges, propagator)


def respond(path: Path, propagator: Propagator, forcing: Array) -> tuple[Array, Array]:
    """Return the response (nodes, edges) of the states to extra rates (intervals, nodes, n, columns).

    While friction holds the casing, what pushes it has no effect.
    """
    first = np.zeros(forcing.shape[2:])
    if not path.sense.all():
        forcing = forcing.copy()
        forcing[path.sense == 0, :, 1] = 0.0
    return _march(path, propagator, forcing, first, {})


def _march(
    path: Path, propagator: Propagator, forcing: Array, first: Array, kicks: Mapping[int, Array]
) -> tuple[Array, Array]:
    half = path.mesh.half[..., None]
    flat = forcing.reshape(*forcing.shape[:2], -1)
    node_defect = (half * (rule().s @ flat)).reshape(forcing.shape)
    edge_defect = (half[..., 0] * (rule().w @ flat)).reshape(len(flat), *forcing.shape[2:])
    for i, kick in kicks.items():
        edge_defect[i] += kick
    response = propagator.nodes(node_defect)
    edges = propagator.chain(response, edge_defect, first)
    return response + propagator.carried(edges), edges


def _kicks(dynamics: Dynamics, numbers: Mapping[str, float], path: Path, columns: int) -> dict[int, Array]:
    """Return what a later jump would have added: (rate before - rate after) at each breakpoint's edge."""
    kicks: dict[int, Array] = {}
    for key in dynamics.breakpoints:
        time = numbers[key]
        i = int(np.searchsorted(path.mesh.edges, time))
        if not 0 < i < len(path.mesh.edges) - 1 or path.mesh.edges[i] != time:
            continue
        y = path.edges[i]
        before = dynamics.rates(np.nextafter(time, -np.inf), y, numbers, path.sense[i - 1])
        after = dynamics.rates(np.asarray(time), y, numbers, path.sense[i])
        kick = np.zeros((len(y), columns))
        kick[:, dynamics.parameters.index(key)] = before - after
        kicks[i - 1] = kicks.get(i - 1, 0.0) + kick
    return kicks


def angles(sampler: Sampler, path: Path, state: int, nodes: Array) -> Array:
    """Return the integral of the columns of a sensitivity of a speed, at the sampler's times."""
    speed = nodes[:, :, state]
    steps = path.mesh.half * (rule().w @ speed)
    starts = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
    return sampler.integral(starts, speed)
