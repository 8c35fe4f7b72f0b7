"""Sensitivities of a solution to parameters, to initial values and to small extra torques.

With A at the nodes, the deviations dy_k in an interval of length h that starts with dy_0 fulfil

    dy_k - h/2 sum_j S_kj A_j dy_j = dy_0 + b_k:

one small dense system per interval, all solved in one batch and chained by their transfer matrices.

With the fundamental matrix Phi(t) of the linearised equations, a torque u(t) along b gives

    d omega(t) = Phi(t) integral Phi^-1(s) b u(s) ds,
    d psi(t)   = integral [Psi(t) - Psi(s)] Phi^-1(s) b u(s) ds,    Psi = integral of Phi,

which needs only running sums over the times at which u is known, for any frequency of u. After the casing has come to
rest, deviations before do not matter; so that Phi has an inverse, a millionth of them is kept.

Where one mode decays long before the end of the record, all columns of Phi become parallel to the other mode, and the
inverse is inaccurate. Then the decaying column is computed backwards from the end, in which direction it grows faster
than the other, and its integral as well: the dichotomy of U. Ascher, R. Mattheij, R. Russell, Numerical
Solution of Boundary Value Problems for Ordinary Differential Equations, SIAM (1995), ch. 6.

All solve the same linear equation d(dy)/dt = A(t) dy + b(t) on the mesh of the solution; the derivative by the time of
a jump is an impulse at that time.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fitting._errors import SimulationError
from fitting.dynamics._mesh import Mesh, Path, Sampler, rule
from fitting.dynamics._model import Dynamics

UNBOUNDED = "the equations of motion have no bounded solution for these numbers"
# fewer edges than this are chained one by one
_FEW = 24


class Propagator:
    """The linearised equations d(dy)/dt = A dy + b on a mesh.

    Parameters
    ----------
    mesh : Mesh
        The intervals.
    a : ndarray, shape (intervals, nodes, n, n)
        A at the nodes.
    jumps : mapping of int to ndarray, optional
        Saltation matrices at edges where the torque jumps.
    defect : ndarray, shape (intervals, nodes, n), optional
        A right-hand side: `response` is then the same as its `nodes`, at less cost.
    constraint : ndarray, shape (2, 2), optional
        Matrix from accelerations of free bodies to those of bodies in contact.
    """

    def __init__(
        self,
        mesh: Mesh,
        a: Array,
        jumps: Mapping[int, Array] | None = None,
        defect: Array | None = None,
        constraint: Array | None = None,
    ) -> None:
        self.constraint = constraint
        intervals, k, n = a.shape[:3]
        self._mesh, self._half, self._a, self._jumps = mesh, mesh.half, a, jumps or {}
        scaled = (-mesh.half[..., None, None] * a).transpose(0, 2, 1, 3)
        # G[(k,n),(j,m)] = delta - h/2 S_kj A_j[n,m]
        g = (rule().s[:, None, :, None] * scaled[:, None]).reshape(intervals, k * n, k * n)
        g.reshape(intervals, -1)[:, :: k * n + 1] += 1.0
        self._system = g
        right = np.empty((intervals, k * n, n + (defect is not None)))
        right[..., :n] = np.tile(np.eye(n), (k, 1))
        if defect is not None:
            right[..., n] = defect.reshape(intervals, k * n)
        try:
            solved = np.linalg.solve(g, right)
        except np.linalg.LinAlgError:
            raise SimulationError(UNBOUNDED) from None
        self.transfer: Array = np.asarray(solved[..., :n].reshape(intervals, k, n, n))
        self.response: Array = np.asarray(solved[..., n:].reshape(intervals, k, n, -1))
        self._step = np.eye(n) + self._gained(self.transfer)

    @cached_property
    def _inverse(self) -> Array:
        return np.asarray(np.linalg.inv(self._system))

    def _gained(self, deviation: Array) -> Array:
        """Return the integral of A dy over each interval."""
        rates = self._a @ deviation
        intervals, k, n, columns = rates.shape
        total = rule().w @ rates.reshape(intervals, k, n * columns)
        return np.asarray(self._half[..., None] * total.reshape(intervals, n, columns))

    def with_regular_jumps(self, share: float) -> Propagator:
        """Return the same equations with jumps that keep a share of the deviations that they eliminate."""
        if not self._jumps:
            return self
        other = copy(self)
        other._jumps = {  # noqa: SLF001
            i: m + share * np.diag((np.diag(m) == 0).astype(float)) for i, m in self._jumps.items()
        }
        return other

    def of_speeds(self) -> Propagator:
        """Return the equations of the first two states, the others held."""
        if self._a.shape[-1] == 2:
            return self
        return Propagator(self._mesh, self._a[..., :2, :2], {i: m[:2, :2] for i, m in self._jumps.items()})

    def nodes(self, defect: Array) -> Array:
        """Return the response at the nodes to right-hand sides (intervals, nodes, n, columns), edges held."""
        intervals, k, n, columns = defect.shape
        return np.asarray(self._inverse @ defect.reshape(intervals, k * n, columns)).reshape(defect.shape)

    def carried(self, edges: Array) -> Array:
        """Return the deviations at the nodes that follow from those at the edges (intervals + 1, n, columns)."""
        return np.asarray(self.transfer @ edges[:-1, None])

    def chain(
        self,
        response: Array,
        edge_defect: Array,
        first: Array | None = None,
        added: Mapping[int, Array] | None = None,
    ) -> Array:
        """Return the deviations at all edges, (intervals + 1, n, columns), from the first edge on.

        At some edges a deviation is added, after the jump.
        """
        gain = edge_defect + self._gained(response)
        for i, jump in self._jumps.items():
            gain[i - 1] = jump @ gain[i - 1]
        for i, deviation in (added or {}).items():
            gain[i - 1] += deviation
        step = self._steps()
        out = np.zeros((gain.shape[0] + 1, *gain.shape[1:]))
        if first is not None:
            out[0] = first
        _fill(out, step, gain)
        return out

    def back(self, last: Array) -> Array:
        """Return the homogeneous solution that ends as `last`, at all edges, (intervals + 1, n, columns)."""
        try:
            inverse: Array = np.asarray(np.linalg.inv(self._steps()))[::-1]
        except np.linalg.LinAlgError:
            raise SimulationError(UNBOUNDED) from None
        out = np.zeros((len(inverse) + 1, *last.shape))
        out[0] = last
        _fill(out, inverse, np.zeros_like(out[1:]))
        return out[::-1]

    def _steps(self) -> Array:
        """Return the matrices that carry a deviation from edge to edge."""
        if not self._jumps:
            return self._step
        step = self._step.copy()
        for i, jump in self._jumps.items():
            step[i - 1] = jump @ step[i - 1]
        return step


def _fill(out: Array, step: Array, gain: Array) -> None:
    """Fill out[i + 1] = step[i] out[i] + gain[i], by recursive combination of pairs of steps."""
    levels = []
    while len(step) >= _FEW:
        levels.append((out, step, gain))
        pairs = len(step) // 2 * 2
        second = step[1:pairs:2]
        out = out[: pairs + 1 : 2]
        step, gain = second @ step[0:pairs:2], second @ gain[0:pairs:2] + gain[1:pairs:2]
    for i in range(len(step)):
        out[i + 1] = step[i] @ out[i] + gain[i]
    for out, step, gain in reversed(levels):  # from the coarsest level to the finest
        out[1::2] = step[0::2] @ out[0 : len(step) : 2] + gain[0::2]


Array = NDArray[np.float64]

# share of a deviation that is kept where the casing comes to rest
_KEPT = 1e-6
# smallest singular value of the scaled columns of Phi for an accurate inverse
_DEPENDENT = 1e-9


class LinearMotion:
    """The linearised motion of both speeds about a solution.

    States of effects (a temperature, a phase) are coupled with the speeds. Where one of them decays so fast that Phi
    has no inverse, all of these states are held.

    Parameters
    ----------
    path : Path
        The solution.
    propagator : Propagator
        Its linearised equations.
    """

    def __init__(self, path: Path, propagator: Propagator) -> None:
        self._sense, self._mesh, self._constraint = path.sense, path.mesh, propagator.constraint
        decaying: list[int] = []
        self._nodes = _fundamental(propagator)
        if not _independent(self._nodes):
            propagator = propagator.of_speeds()
            self._nodes = _fundamental(propagator)
            if not _independent(self._nodes):
                self._nodes, decaying = _slow_and_fast_mode(propagator), [1]
        steps = path.mesh.half[..., None] * np.tensordot(self._nodes, rule().w, (1, 0))
        self._starts = np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])
        self._starts[:-1, :, decaying] = -np.cumsum(steps[::-1, :, decaying], axis=0)[::-1]
        self._starts[-1, :, decaying] = 0.0

    def fundamental(self, times: Array) -> Array:
        """Return the speeds' rows of Phi at some times, shape (times, 2, n)."""
        return Sampler(self._mesh, times).value(self._nodes)[:, :2]

    def integrated(self, times: Array) -> Array:
        """Return the speeds' rows of Psi at some times, shape (times, 2, n)."""
        return Sampler(self._mesh, times).integral(self._starts, self._nodes)[:, :2]

    def impulses(self, times: Array, direction: Array) -> Array:
        """Return Phi^-1(s) b, shape (times, n); b holds the rates that a unit torque gives [rad s-2]."""
        return self._impulses(Sampler(self._mesh, times), direction)

    def _impulses(self, sampler: Sampler, direction: Array) -> Array:
        phi = sampler.value(self._nodes)
        accelerations = np.zeros(phi.shape[:2])
        accelerations[:, :2] = self.accelerations(direction)
        held = slice(1, 2) if self._constraint is None else slice(0, 2)
        accelerations[:, held] *= np.abs(self._sense[sampler.index])[:, None]
        try:
            return np.asarray(np.linalg.solve(phi, accelerations[..., None])[..., 0])
        except np.linalg.LinAlgError:
            # after several stops the kept share of earlier deviations underflows
            if not np.isfinite(phi).all():
                raise SimulationError(UNBOUNDED) from None
            return np.asarray((np.linalg.pinv(phi) @ accelerations[..., None])[..., 0])

    def accelerations(self, direction: Array) -> Array:
        """Return the accelerations by a unit torque of bodies that may be in contact, from those of free bodies."""
        return direction if self._constraint is None else self._constraint @ direction

    def moving(self, times: Array) -> Array:
        """Return 1 where the casing responds to a torque, 0 where friction holds it."""
        return np.abs(self._sense[Sampler(self._mesh, times).index])

    def driven(self, times: Array, torque: Array, direction: Array) -> tuple[Array, Array]:
        """Return d omega and d psi of both bodies at sample times, for a torque between them.

        Parameters
        ----------
        times : ndarray, shape (n,)
            Sample times [s].
        torque : ndarray, shape (n - 1, q, columns)
            Torques [N m] at the q Gauss nodes of each interval between samples.
        direction : ndarray, shape (2,)
            Rates of both speeds that a unit torque gives.

        Returns
        -------
        tuple of ndarray, each of shape (2, n, columns)
            The rotor first, the casing second.
        """
        gauss = rule(torque.shape[1])
        half = 0.5 * np.diff(times)
        inner = (times[:-1] + half)[:, None] + half[:, None] * gauss.x
        sampler = Sampler(self._mesh, inner.ravel())
        impulses = self._impulses(sampler, direction).reshape(*inner.shape, -1)
        psi_inner = sampler.integral(self._starts, self._nodes)[:, :2].reshape(*inner.shape, 2, -1)
        impulses *= (half[:, None] * gauss.w)[..., None]
        changes = impulses.transpose(0, 2, 1) @ torque
        delayed = (psi_inner @ impulses[..., None])[..., 0]
        sums = np.concatenate([np.zeros((1, *changes.shape[1:])), np.cumsum(changes, axis=0)])
        late = np.moveaxis(delayed.transpose(0, 2, 1) @ torque, 1, 0)
        late = np.concatenate([np.zeros((2, 1, late.shape[2])), np.cumsum(late, axis=1)], axis=1)
        sampler = Sampler(self._mesh, times)
        phi, psi = sampler.value(self._nodes), sampler.integral(self._starts, self._nodes)
        speed, angle = (np.moveaxis(m[:, :2] @ sums, 1, 0) for m in (phi, psi))
        return speed, angle - late


def _fundamental(propagator: Propagator) -> Array:
    """Return Phi of all states at the nodes, shape (intervals, nodes, n, n)."""
    first = np.eye(propagator.transfer.shape[-1])
    return propagator.carried(_chained(propagator, first))


def _chained(propagator: Propagator, first: Array) -> Array:
    """Return the deviations at all edges that follow from small deviations at the start."""
    zero = np.zeros((*propagator.transfer.shape[:2], *first.shape))
    return propagator.with_regular_jumps(_KEPT).chain(zero, zero[:, 0], first)


def _slow_and_fast_mode(propagator: Propagator) -> Array:
    """Return the modes of slow and of fast decay of the speeds, at the nodes."""
    slow = _chained(propagator, np.array([[1.0], [0.0]]))
    end = slow[-1] / np.linalg.norm(slow[-1])
    fast = propagator.with_regular_jumps(_KEPT).back(np.array([-end[1], end[0]]))
    size = np.linalg.norm(fast[0])
    if not np.isfinite(size):
        raise SimulationError(UNBOUNDED)
    return propagator.carried(np.concatenate([slow, fast / size], axis=2))


def _independent(phi: Array) -> bool:
    """Return whether the columns of Phi are linearly independent everywhere."""
    size = np.linalg.norm(phi, axis=-2, keepdims=True)
    if not (size > 0).all():
        return False
    return float(np.linalg.svd(phi / size, compute_uv=False)[..., -1].min()) > _DEPENDENT


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of the states at nodes and edges, last axis the columns.

    Columns are the parameters of the dynamics, then the initial values of the speeds (of the casing alone in a contact
    without slip), and of the deflection if it is a state.
    """

    nodes: Array
    edges: Array
    propagator: Propagator


def sensitivities(dynamics: Dynamics, numbers: Mapping[str, float], path: Path) -> Sensitivity:
    """Return the derivatives of a solution by parameters and by the initial values that belong to the recording."""
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
            first[0, dynamics.parameters.index(dynamics.ratio)] = path.edges[0, 1]
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
    """Return the derivative of the states by the time of each jump: rate before minus rate after, at its edge."""
    impulses: dict[int, Array] = {}
    for key in dynamics.breakpoints:
        time = numbers[key]
        i = int(np.searchsorted(path.mesh.edges, time))
        if not 0 < i < len(path.mesh.edges) - 1 or path.mesh.edges[i] != time:
            continue
        y = path.edges[i]
        before = dynamics.rates(np.nextafter(time, -np.inf), y, numbers, path.sense[i - 1])
        after = dynamics.rates(np.asarray(time), y, numbers, path.sense[i])
        impulse = np.zeros((len(y), columns))
        impulse[:, dynamics.parameters.index(key)] = before - after
        impulses[i - 1] = impulses.get(i - 1, 0.0) + impulse
    return impulses


def angles(sampler: Sampler, path: Path, state: int, nodes: Array) -> Array:
    """Return the integral of the columns of a sensitivity of a speed, at the sampler's times."""
    speed = nodes[:, :, state]
    steps = path.mesh.half * (rule().w @ speed)
    starts = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
    return sampler.integral(starts, speed)
