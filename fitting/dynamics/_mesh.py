"""Time intervals with Gauss-Legendre nodes, and functions given at these nodes.

On an interval of length h a function is the polynomial through its values at the K Gauss nodes; its integral up to
node k is h/2 sum_j S_kj f_j, with S_kj the integral of the Lagrange polynomial L_j from -1 to x_k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Array = NDArray[np.float64]

NODES = 10
# times per interval above which one product for each interval is faster than one for each time
_MANY_PER_INTERVAL = 12


class Rule(NamedTuple):
    """Nodes x, weights w, integration matrix S, and linear maps of node values.

    `to_legendre` gives Legendre coefficients, `antiderivative` those of the integral that vanishes at -1, `ends` the
    values at -1 and 1.
    """

    x: Array
    w: Array
    s: Array
    to_legendre: Array
    antiderivative: Array
    ends: Array


@lru_cache(maxsize=8)
def rule(k: int = NODES) -> Rule:
    """Return the Gauss-Legendre rule of k nodes on [-1, 1]."""
    x, w = legendre.leggauss(k)
    to_legendre: Array = np.asarray(np.linalg.inv(legendre.legvander(x, k - 1)), dtype=np.float64)
    # column j: coefficients of the antiderivative of L_j that vanishes at -1
    antiderivative: Array = np.asarray(legendre.legint(to_legendre, lbnd=-1, axis=0), dtype=np.float64)
    integral: Array = np.asarray(legendre.legvander(x, k) @ antiderivative, dtype=np.float64)
    ends: Array = np.asarray(legendre.legvander(np.array([-1.0, 1.0]), k - 1) @ to_legendre)
    return Rule(x, w, integral, to_legendre, antiderivative, ends)


@dataclass(frozen=True)
class Mesh:
    """Interval edges; `times` are the Gauss nodes of all intervals, shape (intervals, nodes)."""

    edges: Array

    @cached_property
    def half(self) -> Array:
        """Half the length of each interval, shaped to broadcast over nodes."""
        return np.asarray(0.5 * (self.edges[1:] - self.edges[:-1]))[:, None]

    @cached_property
    def times(self) -> Array:
        """Node times, shape (intervals, nodes)."""
        middle = 0.5 * (self.edges[1:] + self.edges[:-1])
        return np.asarray(middle[:, None] + self.half * rule().x)

    @classmethod
    def uniform(cls, start: float, stop: float, intervals: int) -> Mesh:
        """Return equal intervals."""
        return cls(np.linspace(start, stop, intervals + 1))

    def between(self, start: float, stop: float) -> Mesh:
        """Return the mesh cut to start and end at these times."""
        close = 1e-9 * (stop - start)
        inside = self.edges[(self.edges > start + close) & (self.edges < stop - close)]
        return Mesh(np.concatenate([[start], inside, [stop]]))

    def with_breakpoints(self, breakpoints: Sequence[float]) -> Mesh:
        """Return the mesh with an edge at each breakpoint inside it."""
        inside = [b for b in breakpoints if self.edges[0] < b < self.edges[-1]]
        return Mesh(np.unique(np.concatenate([self.edges, inside]))) if inside else self

    def moved(self, anchors: Sequence[float], places: Sequence[float]) -> Mesh:
        """Return the mesh stretched, linearly between anchors, so that each anchor moves to its place."""
        if list(anchors) == list(places):
            return self
        edges = np.interp(self.edges, anchors, places)
        # no rounding error for an anchor that is an edge
        edges[np.searchsorted(self.edges, anchors)] = places
        return Mesh(edges)


@dataclass(frozen=True)
class Path:
    """A solution."""

    mesh: Mesh  # its intervals
    # states at the nodes (intervals, nodes, states) and at the edges (intervals + 1, states)
    y: Array
    edges: Array
    states: tuple[str, ...]  # their names
    sense: Array  # shape (intervals,); the casing's sense of motion: +1 or -1; 0 while friction holds it
    kinks: tuple[float, ...] = ()  # times at which a torque jumps [s]
    # saltation matrices of small deviations at the edges at which the casing stops or reverses
    jumps: dict[int, Array] = field(default_factory=dict)
    # the error of a Newton step over the square of the previous step, for solutions near this one
    newton_ratio: float = 1.0
    exact: bool = True  # whether it is a solution, and not the measured motion
    # least value to which errors of a speed are relative [rad/s]. At a stretch where an oscillating casing hardly
    # moves, its torques cancel, and errors relative to its own speed are rounding
    least_scale: float = 0.0

    @property
    def scale(self) -> Array:
        """Values to which errors of the states are relative, (states,)."""
        largest = 1e-300 + np.abs(self.y).max(axis=(0, 1))
        largest[:2] = np.maximum(largest[:2], self.least_scale)
        return np.asarray(largest)

    def angle(self, state: str) -> tuple[Array, Array]:
        """Return the integral of a speed: at the start of each interval, and the speed at the nodes."""
        speed = self.y[..., self.states.index(state)]
        steps = self.mesh.half[:, 0] * (speed @ rule().w)
        return np.concatenate([[0.0], np.cumsum(steps)]), speed

    @property
    def breaks(self) -> tuple[float, ...]:
        """The kinks without those at reversals and stops of the casing: times at which a law sets in [s]."""
        events = {float(self.mesh.edges[i]) for i in self.jumps}
        return tuple(k for k in self.kinks if k not in events)

    def pieces(self) -> list[Path]:
        """Return the stretches between reversals and stops of the casing."""
        ends, breaks = [0, *sorted(self.jumps), len(self.y)], self.breaks
        return [
            Path(
                Mesh(self.mesh.edges[a : b + 1]),
                self.y[a:b],
                self.edges[a : b + 1],
                self.states,
                self.sense[a:b],
                tuple(k for k in breaks if self.mesh.edges[a] < k < self.mesh.edges[b]),
                newton_ratio=self.newton_ratio,
                least_scale=self.least_scale,
            )
            for a, b in pairwise(ends)
        ]


class Sampler:
    """Values and integrals of node data of a mesh at any times inside it [s], as sparse rows."""

    def __init__(self, mesh: Mesh, times: Array) -> None:
        edges = mesh.edges
        self.index = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, len(edges) - 2)
        self._half = mesh.half[self.index, 0]
        self._vander = legendre.legvander((times - edges[self.index]) / self._half - 1.0, NODES)
        # many ordered times in few intervals: one product for each interval
        few = len(times) > _MANY_PER_INTERVAL * (len(edges) - 1)
        self._runs = None
        if few and (self.index[1:] >= self.index[:-1]).all():
            self._runs = np.searchsorted(self.index, np.arange(len(edges)))

    def value(self, nodes: Array) -> Array:
        """Return node data (intervals, nodes, ...) at the times, shape (times, ...)."""
        return self._weighted(self._vander[:, :-1], rule().to_legendre, nodes)

    def integral(self, starts: Array, nodes: Array) -> Array:
        """Return the running integral of node data, given its values at the edges."""
        inner = self._weighted(self._vander, rule().antiderivative, nodes)
        return np.asarray(starts[self.index] + inner * self._half.reshape(-1, *[1] * (inner.ndim - 1)))

    def _weighted(self, powers: Array, to_powers: Array, nodes: Array) -> Array:
        shape = nodes.shape[2:]
        series = to_powers @ nodes.reshape(*nodes.shape[:2], -1)
        if self._runs is None:
            found = (powers[:, None, :] @ series[self.index])[:, 0]
        else:
            found = np.empty((len(powers), series.shape[2]))
            for a, b, own in zip(self._runs[:-1], self._runs[1:], series, strict=True):
                np.matmul(powers[a:b], own, out=found[a:b])
        return np.asarray(found.reshape(len(powers), *shape))


def transfer(guess: Path, mesh: Mesh, start: Array, sense: float) -> Path:
    """Return a known path on another mesh, as the initial solution for one with another start."""
    sampler = Sampler(guess.mesh, mesh.times.ravel())
    y = sampler.value(guess.y).reshape(*mesh.times.shape, -1)
    edges = Sampler(guess.mesh, mesh.edges).value(guess.y)
    edges[0] = start
    return Path(
        mesh,
        y,
        edges,
        guess.states,
        np.full(len(y), sense),
        newton_ratio=guess.newton_ratio,
        least_scale=guess.least_scale,
    )
