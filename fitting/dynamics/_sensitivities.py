"""Sensitivities of a solution to parameters, to initial values and to small additional torques.

Let Phi(t) be the fundamental matrix of the linearised equations. A torque u(t) causes the accelerations b u(t). The
response to this torque is

    d omega(t) = Phi(t) integral Phi^-1(s) b u(s) ds,
    d psi(t)   = integral [Psi(t) - Psi(s)] Phi^-1(s) b u(s) ds,    Psi = integral of Phi.

The integrals are running sums over the times at which u is known; u may therefore have any frequency. After the casing
has come to rest, earlier deviations have no influence. A millionth of these deviations is kept nevertheless, so that
Phi has an inverse.

If one mode decays long before the end of the record, all columns of Phi become parallel to each other, and the inverse
is inaccurate. In this case the modes, ordered from slow to fast decay, are used as columns. With the QR decompositions
of the steps, Phi_(i+1) Q_i = Q_(i+1) R_i, the modes are Q_i C_i with triangular C_i = R_i^-1 C_(i+1). They are computed
backwards from the end, because in this direction each mode grows faster than all modes of slower decay. The integrals
of decaying modes are also computed backwards. This is the dichotomy of U. Ascher, R. Mattheij, R. Russell, Numerical
Solution of Boundary Value Problems for Ordinary Differential Equations, SIAM (1995), ch. 6.

All sensitivities solve the same linear equation d(dy)/dt = A(t) dy + b(t) on the mesh of the solution (`Propagator` of
`fitting.dynamics._collocation`). The derivative with respect to the time of a jump is an impulse at that time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting._errors import SimulationError
from fitting.dynamics._collocation import UNBOUNDED, Path, Propagator, Sampler, rule
from fitting.dynamics._model import Dynamics
from fitting.effects._mechanism import MAIN

Array = NDArray[np.float64]

_KEPT = 1e-6
"""Share of a deviation that is kept when the casing comes to rest [1]. Chosen: Phi needs an inverse; a smaller value
makes the inverse inaccurate, a larger one keeps deviations after the stop."""
_DEPENDENT = 1e-9
"""Smallest singular value of the scaled columns of Phi with which the inverse is used [1]. Chosen: half of the digits
remain; a smaller value gives inaccurate responses, a larger one costs time for the dichotomy."""


class LinearMotion:
    """The linearised motion of the speeds of all bodies about a solution.

    States of effects (a temperature, a phase) are coupled with the speeds. If a state decays so fast that Phi has no
    accurate inverse, all states of effects are held constant.
    """

    def __init__(self, path: Path, propagator: Propagator) -> None:
        self._sense, self._mesh, self._constraint = path.sense, path.mesh, propagator.constraint
        self._speeds = path.speeds
        decaying = slice(0)
        self._nodes = _fundamental(propagator)
        if not _independent(self._nodes):
            propagator = propagator.of_speeds(self._speeds)
            self._nodes = _fundamental(propagator)
            if not _independent(self._nodes):
                self._nodes, decaying = _modes(propagator), slice(1, None)
        steps = path.mesh.half[..., None] * np.tensordot(self._nodes, rule().w, (1, 0))
        self._starts = np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])
        self._starts[:-1, :, decaying] = -np.cumsum(steps[::-1, :, decaying], axis=0)[::-1]
        self._starts[-1, :, decaying] = 0.0

    def fundamental(self, times: Array) -> Array:
        """Return the speeds' rows of Phi at some times, shape (times, bodies, n)."""
        return Sampler(self._mesh, times).value(self._nodes)[:, : self._speeds]

    def integrated(self, times: Array) -> Array:
        """Return the speeds' rows of Psi at some times, shape (times, bodies, n)."""
        return Sampler(self._mesh, times).integral(self._starts, self._nodes)[:, : self._speeds]

    def impulses(self, times: Array, direction: Array) -> Array:
        """Return Phi^-1(s) b, shape (times, n).

        b = `direction` (2,) contains the accelerations that a torque of 1 N m causes in bodies without contact [rad
        s-2].
        """
        return self._impulses(Sampler(self._mesh, times), direction)

    def _impulses(self, sampler: Sampler, direction: Array) -> Array:
        phi = sampler.value(self._nodes)
        accelerations = np.zeros(phi.shape[:2])
        accelerations[:, : self._speeds] = self.accelerations(direction)
        held = slice(MAIN, MAIN + 1) if self._constraint is None else slice(0, MAIN + 1)
        accelerations[:, held] *= np.abs(self._sense[sampler.index])[:, None]
        try:
            return np.asarray(np.linalg.solve(phi, accelerations[..., None])[..., 0])
        except np.linalg.LinAlgError:
            # after several stops, the kept shares of earlier deviations underflow
            if not np.isfinite(phi).all():
                raise SimulationError(UNBOUNDED) from None
            return np.asarray((np.linalg.pinv(phi) @ accelerations[..., None])[..., 0])

    def accelerations(self, direction: Array) -> Array:
        """Return the accelerations of the bodies, given the accelerations that they would have without a contact."""
        return direction if self._constraint is None else self._constraint @ direction

    def moving(self, times: Array) -> Array:
        """Return 1 where the main body responds to a torque, 0 where friction holds it."""
        return np.abs(self._sense[Sampler(self._mesh, times).index])

    def driven(self, times: Array, nodes: int, direction: Array) -> Callable[[Array], tuple[Array, Array]]:
        """Return the response of the bodies at n sample times to a torque on or between them.

        The response maps torques [N m] at the q Gauss nodes between samples, shape (n - 1, q, columns), to d omega and
        d psi, each of shape (bodies, n, columns), in the order of the speeds. `direction` (bodies,) are the
        accelerations that a unit torque causes.
        """
        gauss = rule(nodes)
        half = 0.5 * np.diff(times)
        inner = (times[:-1] + half)[:, None] + half[:, None] * gauss.x
        sampler = Sampler(self._mesh, inner.ravel())
        impulses = self._impulses(sampler, direction).reshape(*inner.shape, -1)
        count = self._speeds
        psi_inner = sampler.integral(self._starts, self._nodes)[:, :count].reshape(*inner.shape, count, -1)
        impulses *= (half[:, None] * gauss.w)[..., None]
        change = np.ascontiguousarray(impulses.transpose(0, 2, 1))
        delay = np.ascontiguousarray((psi_inner @ impulses[..., None])[..., 0].transpose(0, 2, 1))
        sampler = Sampler(self._mesh, times)
        maps = (
            sampler.value(self._nodes)[:, :count],
            sampler.integral(self._starts, self._nodes)[:, :count],
        )

        def response(torque: Array) -> tuple[Array, Array]:
            sums, late = (
                np.concatenate([np.zeros((1, *x.shape[1:])), np.cumsum(x, axis=0)])
                for x in (change @ torque, delay @ torque)
            )
            speed, angle = (np.moveaxis(m @ sums, 1, 0) for m in maps)
            return speed, angle - np.moveaxis(late, 1, 0)

        return response


def _fundamental(propagator: Propagator) -> Array:
    """Return Phi of all states at the nodes, shape (intervals, nodes, n, n)."""
    first = np.eye(propagator.transfer.shape[-1])
    return propagator.carried(_chained(propagator, first))


def _chained(propagator: Propagator, first: Array) -> Array:
    """Return the deviations at all edges that the deviations `first` at the start cause."""
    zero = np.zeros((*propagator.transfer.shape[:2], *first.shape))
    return propagator.with_regular_jumps(_KEPT).chain(zero, zero[:, 0], first)


def _modes(propagator: Propagator) -> Array:
    """Return the modes of the speeds at the nodes, from slow to fast decay."""
    steps = propagator.with_regular_jumps(_KEPT).steps()
    count = steps.shape[-1]
    # the first column contains the slowest mode of all bodies
    q = np.empty((len(steps) + 1, count, count))
    q[0] = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, count), increasing=True))[0]
    r = np.empty_like(steps)
    for i, step in enumerate(steps):
        q[i + 1], r[i] = np.linalg.qr(step @ q[i])
    c = np.empty_like(q)
    c[-1] = np.eye(count)
    with np.errstate(all="ignore"):
        try:
            for i in reversed(range(len(r))):
                c[i] = np.linalg.solve(r[i], c[i + 1])
        except np.linalg.LinAlgError:
            raise SimulationError(UNBOUNDED) from None
        modes = q @ c
        modes /= np.linalg.norm(modes[0], axis=0)
    if not np.isfinite(modes).all():
        raise SimulationError(UNBOUNDED)
    return propagator.carried(modes)


def _independent(phi: Array) -> bool:
    """Return whether the columns of Phi are linearly independent at all nodes (`_DEPENDENT`)."""
    size = np.linalg.norm(phi, axis=-2, keepdims=True)
    if not (size > 0).all():
        return False
    return float(np.linalg.svd(phi / size, compute_uv=False)[..., -1].min()) > _DEPENDENT


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of the states at nodes and edges, with the columns on the last axis.

    The columns are the parameters of the dynamics, then the initial speeds, then the initial deflection if the
    deflection is a state. In a contact without slip, only the initial speed of the casing has a column.
    """

    nodes: Array
    edges: Array
    propagator: Propagator


def sensitivities(dynamics: Dynamics, numbers: Mapping[str, float], path: Path) -> Sensitivity:
    """Return the derivatives of a solution with respect to parameters and to the initial values of the recording."""
    _, a, b = dynamics.linearised(path.mesh.times, path.y, numbers, path.sense[:, None])
    propagator = Propagator(path.mesh, a, path.jumps, constraint=dynamics.constraint(numbers))
    n, p, n0 = len(dynamics.states), len(dynamics.parameters), dynamics.free_starts
    starts = n0 if dynamics.ratio is None else n0 - 1
    forcing = np.concatenate([b, np.zeros((*b.shape[:3], starts))], axis=3)
    first = np.zeros((n, p + starts))
    if dynamics.ratio is None:
        first[np.arange(starts), p + np.arange(starts)] = 1.0
    else:
        first[np.arange(1, n0), p + np.arange(starts)] = 1.0
        first[0, p] = numbers[dynamics.ratio]
        if dynamics.ratio in dynamics.parameters:
            first[0, dynamics.parameters.index(dynamics.ratio)] = path.edges[0, MAIN]
    half = path.mesh.half[..., None]
    flat = forcing.reshape(*forcing.shape[:2], -1)
    node_defect = (half * (rule().s @ flat)).reshape(forcing.shape)
    edge_defect = (half[..., 0] * (rule().w @ flat)).reshape(len(flat), *forcing.shape[2:])
    for i, impulse in _jump_impulses(dynamics, numbers, path, p + starts).items():
        edge_defect[i] += impulse
    response = propagator.nodes(node_defect)
    edges = propagator.chain(response, edge_defect, first)
    return Sensitivity(response + propagator.carried(edges), edges, propagator)


def _jump_impulses(
    dynamics: Dynamics, numbers: Mapping[str, float], path: Path, columns: int
) -> dict[int, Array]:
    """Return the derivative of the states with respect to the time of each jump, by the index of its interval.

    The derivative at the edge of the jump is the rate before minus the rate after the jump.
    """
    impulses: dict[int, Array] = {}
    edges = path.mesh.edges
    for key, times in dynamics.moving_breaks(float(edges[0]), float(edges[-1]), numbers).items():
        column = dynamics.parameters.index(key)
        for time in times:
            i = int(np.searchsorted(edges, time))
            if not 0 < i < len(edges) - 1 or edges[i] != time:
                continue
            y = path.edges[i]
            before = dynamics.rates(np.nextafter(time, -np.inf), y, numbers, path.sense[i - 1])
            after = dynamics.rates(np.asarray(time), y, numbers, path.sense[i])
            impulse = np.zeros((len(y), columns))
            impulse[:, column] = before - after
            impulses[i - 1] = impulses.get(i - 1, 0.0) + impulse
    return impulses


def angles(sampler: Sampler, path: Path, state: int, nodes: Array) -> Array:
    """Return the integral of the sensitivity `nodes` of a speed (index `state`) at the times of the sampler."""
    speed = nodes[:, :, state]
    steps = path.mesh.half * (rule().w @ speed)
    starts = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
    return sampler.integral(starts, speed)
