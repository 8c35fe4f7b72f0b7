"""Gauss-Legendre collocation of the equations of motion, all intervals at once.

On an interval of length h that starts with y0, the states at the K Gauss nodes fulfil

    y_k = y0 + h/2 sum_j S_kj f(t_j, y_j),    S_kj = integral of L_j from -1 to x_k,

with the Lagrange polynomials L_j of the nodes: an implicit Runge-Kutta method of order 2K
(E. Hairer, G. Wanner, Solving ODEs II, IV.5). Newton's method treats all intervals together; the
linear systems of the intervals are solved in one batch and chained by their transfer matrices. An
interval whose Legendre coefficients have not decayed is halved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
_UNBOUNDED = "the equations of motion have no bounded solution for these numbers"
_HINT = "if the casing comes to rest within the record, leave out what follows: friction then has no law here"
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

    def with_breakpoints(self, breakpoints: Sequence[float]) -> Mesh:
        """Return the mesh with an edge at each breakpoint that lies inside."""
        inside = [b for b in breakpoints if self.edges[0] < b < self.edges[-1]]
        return Mesh(np.unique(np.concatenate([self.edges, inside]))) if inside else self


@dataclass(frozen=True)
class Path:
    """A solution: states at the nodes (intervals, nodes, states) and at the edges (intervals + 1, states)."""

    mesh: Mesh
    y: Array
    edges: Array
    states: tuple[str, ...]
    kinks: tuple[float, ...] = ()

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


def solve(
    dynamics: Dynamics,
    numbers: Mapping[str, float],
    start: Array,
    mesh: Mesh,
    guess: Path | None = None,
) -> Path:
    """Integrate the equations of motion.

    Parameters
    ----------
    dynamics : Dynamics
        The equations.
    numbers : mapping of str to float
        Parameters by key, and both inertias [kg m2].
    start : ndarray, shape (states,)
        State at the first edge.
    mesh : Mesh
        Intervals to begin with; they are halved where needed, and cut at the model's breakpoints.
    guess : Path, optional
        A solution for numbers near these.

    Returns
    -------
    Path
        Exact to about 1e-9 of the largest value of each state.

    Raises
    ------
    SimulationError
        If Newton's method does not converge or the states leave the finite numbers.
    """
    kinks = tuple(numbers[k] for k in dynamics.breakpoints if mesh.edges[0] < numbers[k] < mesh.edges[-1])
    mesh = mesh.with_breakpoints(kinks)
    first = _transfer(guess, mesh, start) if guess is not None else _explicit(dynamics, numbers, start, mesh)
    for _ in range(40):
        path = _newton(dynamics, numbers, start, mesh, first)
        rough = _unresolved(path)
        if not rough.any():
            return replace(path, kinks=kinks)
        if len(mesh.edges) + rough.sum() > _MAX_INTERVALS:
            break
        middle = 0.5 * (mesh.edges[1:] + mesh.edges[:-1])[rough]
        mesh = Mesh(np.sort(np.concatenate([mesh.edges, middle])))
        first = _transfer(path, mesh, start)
    raise SimulationError("the equations of motion change too sharply to be integrated")


def _newton(dynamics: Dynamics, numbers: Mapping[str, float], start: Array, mesh: Mesh, first: Path) -> Path:
    times, half = mesh.times, mesh.half
    y, edges = first.y.copy(), first.edges.copy()
    edges[0] = start
    gauss = rule()
    with np.errstate(all="ignore"):
        for _ in range(_MAX_NEWTON):
            f, a, _ = dynamics.linearised(times, y, numbers)
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
                return replace(first, mesh=mesh, y=y, edges=edges)
    raise SimulationError(_UNBOUNDED, _HINT)


class Propagator:
    """The linearised equations d(dy)/dt = A dy + b on a mesh, factored once for any right-hand sides."""

    def __init__(self, mesh: Mesh, a: Array) -> None:
        intervals, k, n = a.shape[:3]
        self._half, self._a = mesh.half, a
        s = rule().s
        # G[(k,n),(j,m)] = delta - h/2 S_kj A_j[n,m]
        g = -np.einsum("i,kj,ijnm->iknjm", mesh.half[:, 0], s, a).reshape(intervals, k * n, k * n)
        g[:, np.arange(k * n), np.arange(k * n)] += 1.0
        try:
            self._inverse = np.linalg.inv(g)
        except np.linalg.LinAlgError:
            raise SimulationError(_UNBOUNDED, _HINT) from None
        unit = np.tile(np.eye(n), (k, 1))
        self.transfer: Array = (self._inverse @ unit).reshape(intervals, k, n, n)
        self._step = np.eye(n) + mesh.half[..., None] * np.einsum(
            "j,ijnm,ijmq->inq", rule().w, a, self.transfer
        )

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
        return out


def _transfer(guess: Path, mesh: Mesh, start: Array) -> Path:
    sampler = Sampler(guess.mesh, mesh.times.ravel())
    y = sampler.value(guess.y).reshape(*mesh.times.shape, -1)
    edges = Sampler(guess.mesh, mesh.edges).value(guess.y)
    edges[0] = start
    return Path(mesh, y, edges, guess.states)


def _explicit(dynamics: Dynamics, numbers: Mapping[str, float], start: Array, mesh: Mesh) -> Path:
    """Return a rough solution by classical Runge-Kutta steps: a first guess for Newton's method."""
    times = np.concatenate([mesh.edges[:-1, None], mesh.times], axis=1).ravel()
    times = np.append(times, mesh.edges[-1])
    y = np.empty((len(times), len(start)))
    y[0] = start
    with np.errstate(all="ignore"):
        for i, h in enumerate(np.diff(times)):
            t, state = times[i], y[i]
            k1 = dynamics.rates(t, state, numbers)
            k2 = dynamics.rates(t + h / 2, state + h / 2 * k1, numbers)
            k3 = dynamics.rates(t + h / 2, state + h / 2 * k2, numbers)
            k4 = dynamics.rates(t + h, state + h * k3, numbers)
            y[i + 1] = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    if not np.isfinite(y).all():
        raise SimulationError(_UNBOUNDED, _HINT)
    blocks = y[:-1].reshape(len(mesh.edges) - 1, -1, len(start))
    edges = np.concatenate([blocks[:, 0], y[-1:]])
    return Path(mesh, blocks[:, 1:].copy(), edges, dynamics.states)


def _unresolved(path: Path) -> NDArray[np.bool_]:
    coefficients = np.abs(np.einsum("kj,ijn->ikn", rule().to_legendre, path.y))
    scale = 1e-300 + np.abs(path.y).max(axis=(0, 1))
    tail = (coefficients[:, -2:].max(axis=1) / scale).max(axis=1)
    return np.asarray(tail > _TOLERANCE)
