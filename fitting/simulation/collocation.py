"""Gauss-Legendre collocation of the equations of motion, all intervals at once.

On an interval of length h that starts with y0, the states at the K Gauss nodes fulfil

    y_k = y0 + h/2 sum_j S_kj f(t_j, y_j),    S_kj = integral of L_j from -1 to x_k,

with the Lagrange polynomials L_j of the nodes: an implicit Runge-Kutta method of order 2K
(E. Hairer, G. Wanner, Solving ODEs II, IV.5). Newton's method treats all intervals together; the
linear systems of the intervals are solved in one batch and chained by their transfer matrices. An
interval whose Legendre coefficients have not decayed is halved. Here the casing turns in one sense, or rests;
`motion` puts such stretches together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from fitting.errors import SimulationError
from fitting.model import Dynamics

Array = NDArray[np.float64]

NODES = 10
_TOLERANCE = 1e-10
_MAX_NEWTON = 25
UNBOUNDED = "the equations of motion have no bounded solution for these numbers"
_MAX_INTERVALS = 40_000


class Rule(NamedTuple):
    """Nodes x, weights w, integration matrix S, and the map from node values to Legendre coefficients."""

    x: Array
    w: Array
    s: Array
    to_legendre: Array
    antiderivative: Array


@lru_cache(maxsize=8)
def rule(k: int = NODES) -> Rule:
    """Return the Gauss-Legendre rule of k nodes on [-1, 1]."""
    x, w = legendre.leggauss(k)
    to_legendre: Array = np.asarray(np.linalg.inv(legendre.legvander(x, k - 1)), dtype=np.float64)
    # column j: coefficients of the antiderivative of L_j that vanishes at -1
    antiderivative: Array = np.asarray(legendre.legint(to_legendre, lbnd=-1, axis=0), dtype=np.float64)
    integral: Array = np.asarray(legendre.legvander(x, k) @ antiderivative, dtype=np.float64)
    return Rule(x, w, integral, to_legendre, antiderivative)


@dataclass(frozen=True)
class Mesh:
    """Interval edges; `times` are the Gauss nodes of all intervals, shape (intervals, nodes)."""

    edges: Array

    @property
    def half(self) -> Array:
        """Half the length of each interval, shaped to broadcast over nodes."""
        return np.asarray(0.5 * np.diff(self.edges))[:, None]

    @property
    def times(self) -> Array:
        """Node times, shape (intervals, nodes)."""
        middle = 0.5 * (self.edges[1:] + self.edges[:-1])
        return np.asarray(middle[:, None] + self.half * rule().x)

    @classmethod
    def uniform(cls, start: float, stop: float, intervals: int, breakpoints: Sequence[float] = ()) -> Mesh:
        """Return equal intervals with further edges at the breakpoints inside."""
        edges = np.linspace(start, stop, intervals + 1)
        return cls(edges).with_breakpoints(breakpoints)

    def between(self, start: float, stop: float) -> Mesh:
        """Return the mesh cut to start and end at these times."""
        close = 1e-9 * (stop - start)
        inside = self.edges[(self.edges > start + close) & (self.edges < stop - close)]
        return Mesh(np.concatenate([[start], inside, [stop]]))

    def with_breakpoints(self, breakpoints: Sequence[float]) -> Mesh:
        """Return the mesh with an edge at each breakpoint that lies inside."""
        inside = [b for b in breakpoints if self.edges[0] < b < self.edges[-1]]
        return Mesh(np.unique(np.concatenate([self.edges, inside]))) if inside else self


@dataclass(frozen=True)
class Path:
    """A solution.

    Attributes
    ----------
    mesh : Mesh
        Its intervals.
    y, edges : ndarray, shapes (intervals, nodes, states) and (intervals + 1, states)
        States at the nodes and at the edges.
    states : tuple of str
        Their names.
    sense : ndarray, shape (intervals,)
        The casing's sense of motion: +1 or -1; 0 while friction holds it.
    kinks : tuple of float
        Times at which a torque jumps [s].
    jumps : dict of int to ndarray
        How a small deviation changes at the edges at which the casing stops or turns back.
    """

    mesh: Mesh
    y: Array
    edges: Array
    states: tuple[str, ...]
    sense: Array
    kinks: tuple[float, ...] = ()
    jumps: dict[int, Array] = field(default_factory=dict)

    def angle(self, state: str) -> tuple[Array, Array]:
        """Return the integral of a speed: at the start of each interval, and the speed at the nodes."""
        speed = self.y[..., self.states.index(state)]
        steps = self.mesh.half[:, 0] * (speed @ rule().w)
        return np.concatenate([[0.0], np.cumsum(steps)]), speed


class Sampler:
    """Values and integrals of node data at any times, as sparse rows.

    Parameters
    ----------
    mesh : Mesh
        Where the node data live.
    times : ndarray
        Times inside the mesh [s].
    """

    def __init__(self, mesh: Mesh, times: Array) -> None:
        edges = mesh.edges
        self.index = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, len(edges) - 2)
        half = mesh.half[self.index, 0]
        x = (times - edges[self.index]) / half - 1.0
        gauss = rule()
        vander = legendre.legvander(x, len(gauss.x))
        self._value = vander[:, :-1] @ gauss.to_legendre
        self._integral = (vander @ gauss.antiderivative) * half[:, None]

    def value(self, nodes: Array) -> Array:
        """Return node data (intervals, nodes, ...) at the times, shape (times, ...)."""
        return np.asarray(np.einsum("tk,tk...->t...", self._value, nodes[self.index]))

    def integral(self, starts: Array, nodes: Array) -> Array:
        """Return the running integral of node data, given its values at the edges."""
        return np.asarray(starts[self.index] + np.einsum("tk,tk...->t...", self._integral, nodes[self.index]))


def glide(dynamics: Dynamics, numbers: Mapping[str, float], first: Path) -> Path:
    """Solve the equations of motion for one sense of the casing's motion, from a guess near enough.

    Parameters
    ----------
    dynamics : Dynamics
        The equations.
    numbers : mapping of str to float
        Parameters by key, and both inertias [kg m2].
    first : Path
        The guess; its mesh is where the search begins, its first edge the start.

    Raises
    ------
    SimulationError
        If Newton's method does not converge or the states leave the finite numbers.
    """
    return refine(dynamics, numbers, settle(dynamics, numbers, first))


def refine(dynamics: Dynamics, numbers: Mapping[str, float], path: Path) -> Path:
    """Halve the intervals of a solution until it is resolved."""
    for _ in range(40):
        rough = _unresolved(path)
        if not rough.any():
            return path
        edges = path.mesh.edges
        if len(edges) + rough.sum() > _MAX_INTERVALS:
            break
        middle = 0.5 * (edges[1:] + edges[:-1])[rough]
        mesh = Mesh(np.sort(np.concatenate([edges, middle])))
        path = settle(dynamics, numbers, transfer(path, mesh, path.edges[0], path.sense[0]))
    raise SimulationError("the equations of motion change too sharply to be integrated")


def settle(dynamics: Dynamics, numbers: Mapping[str, float], first: Path) -> Path:
    """Solve the collocation equations on the mesh of a guess, by Newton's method."""
    mesh, sense = first.mesh, first.sense[:, None]
    times, half = mesh.times, mesh.half
    y, edges = first.y.copy(), first.edges.copy()
    gauss = rule()
    with np.errstate(all="ignore"):
        for _ in range(_MAX_NEWTON):
            f, a, _ = dynamics.linearised(times, y, numbers, sense)
            node_defect = edges[:-1, None] + half[..., None] * np.einsum("kj,ijn->ikn", gauss.s, f) - y
            edge_defect = edges[:-1] + half * np.einsum("j,ijn->in", gauss.w, f) - edges[1:]
            shape = Propagator(mesh, a)
            response = shape.nodes(node_defect[..., None])
            steps = shape.chain(response, edge_defect[..., None])[..., 0]
            move = response[..., 0] + np.einsum("iknm,im->ikn", shape.transfer, steps[:-1])
            y += move
            edges += steps
            scale = 1e-300 + np.abs(y).max(axis=(0, 1))
            size = float((np.abs(move).max(axis=(0, 1)) / scale).max())
            if not np.isfinite(size) or size > 1e8:
                break
            # Newton squares the error: what is left after a step this small is rounding
            if size < 1e-9:
                return replace(first, y=y, edges=edges)
    raise SimulationError(UNBOUNDED)


class Propagator:
    """The linearised equations d(dy)/dt = A dy + b on a mesh, factored once for any right-hand sides.

    Parameters
    ----------
    mesh : Mesh
        The intervals.
    a : ndarray, shape (intervals, nodes, n, n)
        A at the nodes.
    jumps : mapping of int to ndarray, optional
        Matrices by which a deviation changes at some edges: there the torque jumps with the state.
    """

    def __init__(self, mesh: Mesh, a: Array, jumps: Mapping[int, Array] | None = None) -> None:
        intervals, k, n = a.shape[:3]
        self._half, self._a, self._jumps = mesh.half, a, jumps or {}
        s = rule().s
        # G[(k,n),(j,m)] = delta - h/2 S_kj A_j[n,m]
        g = -np.einsum("i,kj,ijnm->iknjm", mesh.half[:, 0], s, a).reshape(intervals, k * n, k * n)
        g[:, np.arange(k * n), np.arange(k * n)] += 1.0
        try:
            self._inverse = np.linalg.inv(g)
        except np.linalg.LinAlgError:
            raise SimulationError(UNBOUNDED) from None
        unit = np.tile(np.eye(n), (k, 1))
        self.transfer: Array = (self._inverse @ unit).reshape(intervals, k, n, n)
        self._step = np.eye(n) + mesh.half[..., None] * np.einsum(
            "j,ijnm,ijmq->inq", rule().w, a, self.transfer
        )

    def remembering(self, share: float) -> Propagator:
        """Return the same equations with jumps that keep a share of what they would wipe out."""
        if not self._jumps:
            return self
        other = copy(self)
        other._jumps = {  # noqa: SLF001
            i: m + share * np.diag((np.diag(m) == 0).astype(float)) for i, m in self._jumps.items()
        }
        return other

    def nodes(self, defect: Array) -> Array:
        """Return the response at the nodes to right-hand sides (intervals, nodes, n, columns), edges held."""
        intervals, k, n, columns = defect.shape
        return np.asarray(self._inverse @ defect.reshape(intervals, k * n, columns)).reshape(defect.shape)

    def chain(self, response: Array, edge_defect: Array, first: Array | None = None) -> Array:
        """Return the deviations at all edges, (intervals + 1, n, columns), from the first edge on."""
        weights = rule().w
        gain = edge_defect + self._half[..., None] * np.einsum("j,ijnm,ijmq->inq", weights, self._a, response)
        out = np.zeros((gain.shape[0] + 1, *gain.shape[1:]))
        if first is not None:
            out[0] = first
        for i in range(gain.shape[0]):
            out[i + 1] = self._step[i] @ out[i] + gain[i]
            if i + 1 in self._jumps:
                out[i + 1] = self._jumps[i + 1] @ out[i + 1]
        return out


def transfer(guess: Path, mesh: Mesh, start: Array, sense: float) -> Path:
    """Return a known path on another mesh, as a guess for one that starts elsewhere."""
    sampler = Sampler(guess.mesh, mesh.times.ravel())
    y = sampler.value(guess.y).reshape(*mesh.times.shape, -1)
    edges = Sampler(guess.mesh, mesh.edges).value(guess.y)
    edges[0] = start
    return Path(mesh, y, edges, guess.states, np.full(len(y), sense))


def march(dynamics: Dynamics, numbers: Mapping[str, float], start: Array, mesh: Mesh, sense: float) -> Path:
    """Return a rough solution by classical Runge-Kutta steps: a first guess for Newton's method.

    It ends with the interval in which the casing comes to rest.
    """
    times = np.concatenate([mesh.edges[:-1, None], mesh.times], axis=1)
    width = times.shape[1]
    times = np.append(times.ravel(), mesh.edges[-1])
    y = np.empty((len(times), len(start)))
    y[0] = start
    last = len(times) - 1
    with np.errstate(all="ignore"):
        for i, h in enumerate(np.diff(times)):
            t, state = times[i], y[i]
            k1 = dynamics.rates(t, state, numbers, sense)
            k2 = dynamics.rates(t + h / 2, state + h / 2 * k1, numbers, sense)
            k3 = dynamics.rates(t + h / 2, state + h / 2 * k2, numbers, sense)
            k4 = dynamics.rates(t + h, state + h * k3, numbers, sense)
            y[i + 1] = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            if dynamics.dry and sense * y[i + 1, 1] < 0:
                last = min(last, width * (i // width + 1))
            if i + 1 == last:
                break
    y = y[: last + 1]
    if not np.isfinite(y).all():
        raise SimulationError(UNBOUNDED)
    blocks = y[:-1].reshape(-1, width, len(start))
    edges = np.concatenate([blocks[:, 0], y[-1:]])
    mesh = Mesh(mesh.edges[: len(blocks) + 1])
    return Path(mesh, blocks[:, 1:].copy(), edges, dynamics.states, np.full(len(blocks), sense))


def _unresolved(path: Path) -> NDArray[np.bool_]:
    coefficients = np.abs(np.einsum("kj,ijn->ikn", rule().to_legendre, path.y))
    scale = 1e-300 + np.abs(path.y).max(axis=(0, 1))
    tail = (coefficients[:, -2:].max(axis=1) / scale).max(axis=1)
    return np.asarray(tail > _TOLERANCE)
