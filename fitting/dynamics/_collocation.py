"""Gauss-Legendre collocation of the equations of motion.

On an interval of length h with the initial state y0, the states at the K Gauss nodes satisfy

    y_k = y0 + h/2 sum_j S_kj f(t_j, y_j),    S_kj = integral of L_j from -1 to x_k,

with the Lagrange polynomials L_j of the nodes. This is an implicit Runge-Kutta method of order 2K (E. Hairer, G.
Wanner, Solving ODEs II, IV.5). Newton's method solves all intervals together. An interval whose Legendre coefficients
have not decayed is halved. In each solution the casing turns in one sense or is at rest; `fitting.dynamics._events`
joins several solutions.

With the Jacobian A of f at the nodes, deviations dy_k in an interval with the initial deviation dy_0 satisfy

    dy_k - h/2 sum_j S_kj A_j dy_j = dy_0 + b_k.

This is one small dense linear system per interval. All systems are solved in one batch and chained by their transfer
matrices.

The time at which the casing comes to rest is an additional unknown. Each step of Newton's method stretches the end of
the mesh, and extrapolates the states with their rates to the new node times.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from fitting._errors import SimulationError
from fitting.dynamics._model import Dynamics
from fitting.effects._mechanism import MAIN

Array = NDArray[np.float64]

NODES = 10
"""Number of Gauss nodes of an interval [1]. Chosen: the order of the method is twice this number; a smaller number
needs more intervals, a larger one makes larger systems."""
_MANY_PER_INTERVAL = 12
"""With more times per interval than this number, a matrix product for each interval is faster than a product for each
time [1]. Chosen: another value costs time and does not change the result."""
TOLERANCE = 1e-10
"""Relative truncation error of an interval [1]. Chosen: far below the noise of any camera; a smaller value needs more
intervals, a larger one makes derivatives inaccurate."""
_MAX_NEWTON = 25
"""Largest number of iterations of Newton's method [1]. Chosen: each iteration doubles the digits; a smaller number
stops too early, a larger one costs time in solutions that do not converge."""
MAX_INTERVALS = 40_000
"""Largest number of intervals [1]. Chosen: a limit of memory; a smaller value refuses long motions, a larger one delays
the failure of stiff motions."""
_SMALL = 1e-9
"""After a relative step of Newton's method below this value, the remaining error is rounding error [1]. Derived:
convergence is quadratic, so the next step is about the square of this step."""
_LARGEST_ERROR = 1e-13
"""Largest error after the last step, predicted from the convergence of the previous steps with a margin of ten [1].
Chosen: a smaller value adds steps of the size of rounding errors, a larger one stops before convergence."""
_MEASURED = 1e-6
"""Smallest Newton step from which the convergence is measured [1]. Chosen: smaller steps contain rounding errors; a
larger value uses too few steps."""
_RESOLVED = 1e-14
"""If the truncation error is below this value, an interval of twice the length is resolved as well [1]. Derived:
`TOLERANCE` divided by the factor of at least 2^9 by which the error grows, with a margin."""
_FEWEST = 12
"""Smallest number of intervals of a coarsened mesh [1]. Chosen: a smaller number overlooks changes between the nodes, a
larger one costs time."""
_CONSTANT_SLIP = 1e12
"""Relaxation time of a slip that is constant during the record [s]. Derived: longer than any record, so that the
relaxation has no effect."""
UNBOUNDED = "the equations of motion have no bounded solution for these numbers"
TOO_SHARP = "the equations of motion change too sharply to be integrated"
_FEW = 24
"""With fewer steps of the mesh than this number, the steps are chained one by one [1]. Chosen: another value costs time
and does not change the result."""


class Rule(NamedTuple):
    """Nodes x, weights w, integration matrix S, and linear maps of node values.

    `to_legendre` gives Legendre coefficients, `antiderivative` gives the Legendre coefficients of the integral that
    vanishes at -1, and `ends` gives the values at -1 and 1.
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

    def __getstate__(self) -> dict[str, Array]:
        """Return only the edges; a worker recomputes everything else."""
        return {"edges": self.edges}

    @cached_property
    def _samplers(self) -> dict[int, tuple[Array, Sampler]]:
        return {}

    def sampler(self, times: Array) -> Sampler:
        """Return the sampler at these times.

        The sampler is cached by the identity of the array, so the array must not be changed.
        """
        known = self._samplers.get(id(times))
        if known is None:
            known = self._samplers[id(times)] = times, Sampler(self, times)
        return known[1]

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
        """Return a mesh of equal intervals."""
        return cls(np.linspace(start, stop, intervals + 1))

    def between(self, start: float, stop: float) -> Mesh:
        """Return the part of the mesh between two times [s]."""
        close = 1e-9 * (stop - start)
        inside = self.edges[(self.edges > start + close) & (self.edges < stop - close)]
        return Mesh(np.concatenate([[start], inside, [stop]]))

    def with_breakpoints(self, breakpoints: Sequence[float]) -> Mesh:
        """Return the mesh with an edge at each breakpoint inside it."""
        inside = [b for b in breakpoints if self.edges[0] < b < self.edges[-1]]
        return Mesh(np.unique(np.concatenate([self.edges, inside]))) if inside else self

    def moved(self, anchors: Sequence[float], places: Sequence[float]) -> Mesh:
        """Return the mesh in which each anchor [s] is moved to its place [s].

        Between anchors it is stretched linearly.
        """
        if list(anchors) == list(places):
            return self
        edges = np.interp(self.edges, anchors, places)
        # edges at anchors move exactly, without rounding errors
        edges[np.searchsorted(self.edges, anchors)] = places
        return Mesh(edges)


@dataclass(frozen=True)
class Path:
    """A solution of the equations of motion."""

    mesh: Mesh  # intervals of the solution
    # states at the nodes (intervals, nodes, states) and at the edges (intervals + 1, states)
    y: Array
    edges: Array
    states: tuple[str, ...]  # names of the states
    sense: Array  # shape (intervals,); sense of rotation of the casing: +1 or -1; 0 while friction holds the casing
    kinks: tuple[float, ...] = ()  # times at which a torque jumps [s]
    # saltation matrices (jumps of small deviations), by the index of the edge at which the casing stops or reverses
    jumps: dict[int, Array] = field(default_factory=dict)
    # error of a Newton step divided by the square of the previous step, for solutions near this solution
    newton_ratio: float = 1.0
    exact: bool = True  # True for a solution, False for the measured motion
    # Smallest scale of the errors of a speed [rad/s]. In a stretch in which an oscillating casing hardly moves, the
    # torques cancel, so that errors relative to the speed in this stretch are only rounding errors.
    least_scale: float = 0.0

    @cached_property
    def speeds(self) -> int:
        """Number of speeds in a state; they are its first values."""
        return sum(s.startswith("omega_") for s in self.states)

    def scale(self, y: Array | None = None) -> Array:
        """Return the scale of the errors of each state, (states,): its largest absolute value at the nodes.

        For speeds it is at least `least_scale`. If `y` is given, its states at the nodes replace the states of this
        path.
        """
        least = [self.least_scale if name.startswith("omega_") else 0.0 for name in self.states]
        largest = np.abs(self.y if y is None else y).max(axis=(0, 1))
        return np.asarray(np.maximum(1e-300 + largest, least))

    def angle(self, state: str) -> tuple[Array, Array]:
        """Return the integral of a speed at all edges [rad], and the speed at the nodes [rad/s]."""
        speed = self.y[..., self.states.index(state)]
        steps = self.mesh.half[:, 0] * (speed @ rule().w)
        return np.concatenate([[0.0], np.cumsum(steps)]), speed

    @property
    def breaks(self) -> tuple[float, ...]:
        """Times at which a torque jumps, except at reversals and stops of the casing [s]."""
        events = {float(self.mesh.edges[i]) for i in self.jumps}
        return tuple(k for k in self.kinks if k not in events)

    def pieces(self) -> list[Path]:
        """Return the stretches between reversals and stops of the casing."""
        ends, breaks = [0, *sorted(self.jumps), len(self.y)], self.breaks
        return [
            Path(
                Mesh(self.mesh.edges[a : b + 1]) if self.jumps else self.mesh,
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
    """Interpolation of node data of a mesh, and of their integrals, at times inside the mesh [s]."""

    def __init__(self, mesh: Mesh, times: Array) -> None:
        edges = mesh.edges
        self.index = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, len(edges) - 2)
        self._half = mesh.half[self.index, 0]
        self._vander = legendre.legvander((times - edges[self.index]) / self._half - 1.0, NODES)
        # many ordered times in few intervals: one product for each interval is faster
        few = len(times) > _MANY_PER_INTERVAL * (len(edges) - 1)
        self._runs = None
        if few and (self.index[1:] >= self.index[:-1]).all():
            self._runs = np.searchsorted(self.index, np.arange(len(edges)))

    def value(self, nodes: Array) -> Array:
        """Return node data (intervals, nodes, ...) at the times, shape (times, ...)."""
        return self._weighted(self._vander[:, :-1], rule().to_legendre, nodes)

    def integral(self, starts: Array, nodes: Array) -> Array:
        """Return the running integral of node data at the times; `starts` are its values at the edges."""
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
    """Return a known path interpolated on another mesh, as an initial solution with the initial states `start`."""
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


class Propagator:
    """The linearised equations d(dy)/dt = A dy + b on a mesh, with A of shape (intervals, nodes, n, n) at its nodes.

    `jumps` contains saltation matrices at edges where the torque jumps. If right-hand sides `defect` (intervals, nodes,
    n, columns) are given, `response` equals `nodes(defect)` at less cost. `constraint` (2, 2) maps the accelerations of
    bodies without contact to their accelerations in contact.
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
        right = np.empty((intervals, k, n, n + (0 if defect is None else defect.shape[3])))
        right[..., :n] = np.eye(n)
        if defect is not None:
            right[..., n:] = defect
        try:
            solved = np.linalg.solve(g, right.reshape(intervals, k * n, -1))
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
        """Return the equations with invertible jumps: a deviation that a jump eliminates is multiplied by `share`."""
        if not self._jumps:
            return self
        other = copy(self)
        other._jumps = {  # noqa: SLF001
            i: m + share * np.diag((np.diag(m) == 0).astype(float)) for i, m in self._jumps.items()
        }
        return other

    def of_speeds(self, count: int) -> Propagator:
        """Return the equations of the first states, which are speeds, with the other states held fixed."""
        if self._a.shape[-1] == count:
            return self
        jumps = {i: m[:count, :count] for i, m in self._jumps.items()}
        return Propagator(self._mesh, self._a[..., :count, :count], jumps)

    def nodes(self, defect: Array) -> Array:
        """Return the response at the nodes to right-hand sides (intervals, nodes, n, columns), with fixed edges."""
        intervals, k, n, columns = defect.shape
        return np.asarray(self._inverse @ defect.reshape(intervals, k * n, columns)).reshape(defect.shape)

    def carried(self, edges: Array) -> Array:
        """Return the deviations at the nodes that deviations at the edges (intervals + 1, n, columns) cause."""
        return np.asarray(self.transfer @ edges[:-1, None])

    def chain(
        self,
        response: Array,
        edge_defect: Array,
        first: Array | None = None,
        added: Mapping[int, Array] | None = None,
    ) -> Array:
        """Return the deviations at all edges, (intervals + 1, n, columns).

        `response` and `edge_defect` are the inhomogeneous parts at the nodes and at the ends of the intervals; `first`
        is the deviation at the first edge, zero by default. The deviations `added` are added at their edges, after the
        jump.
        """
        gain = edge_defect + self._gained(response)
        for i, jump in self._jumps.items():
            gain[i - 1] = jump @ gain[i - 1]
        for i, deviation in (added or {}).items():
            gain[i - 1] += deviation
        step = self.steps()
        out = np.zeros((gain.shape[0] + 1, *gain.shape[1:]))
        if first is not None:
            out[0] = first
        _fill(out, step, gain)
        return out

    def steps(self) -> Array:
        """Return the matrices that carry a deviation from edge to edge."""
        if not self._jumps:
            return self._step
        step = self._step.copy()
        for i, jump in self._jumps.items():
            step[i - 1] = jump @ step[i - 1]
        return step


def _fill(out: Array, step: Array, gain: Array) -> None:
    """Compute out[i + 1] = step[i] out[i] + gain[i] in place, by recursive combination of pairs of steps."""
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


def refine(
    dynamics: Dynamics,
    numbers: Mapping[str, float],
    path: Path,
    *,
    pivot: float | None = None,
    most: int = MAX_INTERVALS,
) -> Path:
    """Return a solution whose intervals are halved until it is resolved.

    A SimulationError is raised if more than `most` intervals are necessary.
    """
    for _ in range(40):
        rough = truncation_error(path) > TOLERANCE
        if not rough.any():
            return path
        edges = path.mesh.edges
        if len(edges) + rough.sum() > most:
            break
        middle = 0.5 * (edges[1:] + edges[:-1])[rough]
        mesh = Mesh(np.sort(np.concatenate([edges, middle])))
        path = newton(dynamics, numbers, transfer(path, mesh, path.edges[0], path.sense[0]), pivot=pivot)
    raise SimulationError(TOO_SHARP)


def newton(
    dynamics: Dynamics, numbers: Mapping[str, float], first: Path, *, pivot: float | None = None
) -> Path:
    """Return the solution of the collocation equations for one sense of rotation of the casing, by Newton's method.

    `first` is a sufficiently close initial solution; the states at its first edge are the initial states. If `pivot` is
    given, the edges after this time are stretched so that the mesh ends when the casing comes to rest. A
    SimulationError is raised if the method does not converge or a state is not finite.
    """
    mesh, sense = first.mesh, first.sense[:, None]
    y, edges = first.y.copy(), first.edges.copy()
    gauss, ratio, before = rule(), first.newton_ratio, np.inf
    with np.errstate(all="ignore"):
        for _ in range(_MAX_NEWTON):
            f, a = dynamics.tangent(mesh.times, y, numbers, sense)
            half = mesh.half
            node_defect = edges[:-1, None] + half[..., None] * (gauss.s @ f) - y
            edge_defect = edges[:-1] + half * (gauss.w @ f) - edges[1:]
            shape = Propagator(mesh, a, defect=node_defect[..., None])
            steps = shape.chain(shape.response, edge_defect[..., None])
            move = (shape.response + shape.carried(steps))[..., 0]
            y += move
            edges += steps[..., 0]
            size = float((np.abs(move).max(axis=(0, 1)) / first.scale(y)).max())
            if pivot is not None:
                mesh, change = _stretched(mesh, y, edges, f, pivot)
                size = max(size, change)
            if not np.isfinite(size) or size > 1e8:
                break
            if _MEASURED < before < 1:
                ratio = max(size / before**2, 1.0)
            # quadratic convergence
            if size < _SMALL or 10 * ratio * size**2 < _LARGEST_ERROR:
                return replace(first, mesh=mesh, y=y, edges=edges, newton_ratio=ratio)
            before = size
    raise SimulationError(UNBOUNDED)


def _stretched(mesh: Mesh, y: Array, edges: Array, f: Array, pivot: float) -> tuple[Mesh, float]:
    """Return the mesh that ends where the speed of the casing vanishes to first order.

    Also return the relative change of the length of the mesh after `pivot`.

    The states are extrapolated along their rates to the new times, in place.
    """
    ends = rule().ends
    end, begin = float(mesh.edges[-1]), pivot
    rate = float(ends[1] @ f[-1, :, MAIN])
    move = -float(edges[-1, MAIN]) / rate if rate else np.inf
    share = move / (end - begin) if end > begin else np.inf
    if not abs(share) < 0.5:
        raise SimulationError(UNBOUNDED)
    i = int(np.searchsorted(mesh.edges, pivot))
    moved = mesh.edges.copy()
    moved[i:] = begin + (mesh.edges[i:] - begin) * (1 + share)
    new = Mesh(moved)
    y += f * (new.times - mesh.times)[..., None]
    after = ends[1] @ f
    edges[1:] += after * (new.edges - mesh.edges)[1:, None]
    return new, abs(share)


def truncation_error(path: Path) -> Array:
    """Return the largest of the last two Legendre coefficients in each interval, relative to the scale of its state."""
    coefficients = np.abs(rule().to_legendre[-2:] @ path.y)
    return np.asarray((coefficients.max(axis=1) / path.scale()).max(axis=1))


def coarsened(path: Path) -> Path:
    """Return a path without edges between intervals that are resolved at twice their length."""
    if len(path.y) <= _FEWEST:
        return path
    resolved = truncation_error(path) < _RESOLVED
    edges = path.mesh.edges
    redundant, i, kinks = [], 0, set(path.kinks)
    while i < len(resolved) - 1:
        equal = 0.4 < (edges[i + 1] - edges[i]) / (edges[i + 2] - edges[i]) < 0.6
        if resolved[i] and resolved[i + 1] and equal and edges[i + 1] not in kinks:
            redundant.append(i + 1)
            i += 1
        i += 1
    if not redundant or len(path.y) - len(redundant) < _FEWEST:
        return path
    coarse = transfer(path, Mesh(np.delete(edges, redundant)), path.edges[0], float(path.sense[0]))
    return replace(coarse, kinks=path.kinks)


_PARTS_OF_STEPS = (1, 4, 16, 64)
"""Trial numbers of Runge-Kutta steps between two nodes of the mesh [1]. Chosen: the integration fails if the motion
needs more steps; a larger last value costs time for stiff motions."""
_STABLE = 2.5
"""Largest step of the Runge-Kutta method, divided by the time constant of decay [1]. Derived: the method of order 4 is
stable up to 2.8; the difference is a margin."""
_SHORT_INTERVALS = 400
"""If the mesh has more edges than this number, each interval has a single step, with linear interpolation of the states
[1]. Chosen: the intervals of such a mesh are short enough for Newton's method; a smaller value gives a poor initial
solution, a larger one costs time."""


def _stepped(
    dynamics: Dynamics,
    numbers: Mapping[str, float],
    start: Array,
    times: Array,
    sense: float,
    width: int,
    parts: int,
) -> Array:
    """Return the states at the given times, with `parts` steps between two times.

    The result ends with the interval in which the casing comes to rest, or with the first state that is not finite.
    `width` is the number of times per interval.
    """
    y = np.empty((len(times), len(start)))
    y[0] = start
    last = len(times) - 1
    with np.errstate(all="ignore"):
        for i, step in enumerate(np.diff(times)):
            state, h = y[i], step / parts
            for t in times[i] + h * np.arange(parts):
                k1 = dynamics.rates(t, state, numbers, sense)
                k2 = dynamics.rates(t + h / 2, state + h / 2 * k1, numbers, sense)
                k3 = dynamics.rates(t + h / 2, state + h / 2 * k2, numbers, sense)
                k4 = dynamics.rates(t + h, state + h * k3, numbers, sense)
                state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            y[i + 1] = state
            if not np.isfinite(state).all():
                return y[: i + 2]
            if dynamics.dry and sense * y[i + 1, MAIN] < 0:
                last = min(last, width * (i // width + 1))
            if i + 1 == last:
                break
    return y[: last + 1]


def runge_kutta(
    dynamics: Dynamics, numbers: Mapping[str, float], start: Array, mesh: Mesh, sense: float
) -> Path:
    """Return a rough solution by classical Runge-Kutta steps, the initial solution for Newton's method.

    The solution ends with the interval in which the casing comes to rest. Steps longer than 2.8 time constants of decay
    are unstable. Therefore the steps are divided until they are stable at the start. A SimulationError is raised if the
    number of steps is too large or a state is not finite.
    """
    if dynamics.relaxation:
        # explicit steps are unstable if a slip relaxes within a step
        numbers = {**numbers, dynamics.relaxation: _CONSTANT_SLIP}
    short = len(mesh.edges) > _SHORT_INTERVALS
    inside = mesh.times[:, :0] if short else mesh.times
    times = np.concatenate([mesh.edges[:-1, None], inside], axis=1)
    width = times.shape[1]
    times = np.append(times.ravel(), mesh.edges[-1])
    with np.errstate(all="ignore"):
        jacobian = dynamics.tangent(times[:1], start[None], numbers, sense)[1][0]
    # at rest, the square root of a speed has no finite derivative, but the rates are finite
    known = np.isfinite(jacobian).all()
    decay = max(0.0, float(-np.linalg.eigvals(jacobian).real.min())) if known else 0.0
    parts = next((n for n in _PARTS_OF_STEPS if decay * float(np.diff(times).max()) < _STABLE * n), None)
    if parts is None:
        raise SimulationError(UNBOUNDED)
    y = _stepped(dynamics, numbers, start, times, sense, width, parts)
    if not np.isfinite(y).all():
        raise SimulationError(UNBOUNDED)
    blocks = y[:-1].reshape(-1, width, len(start))
    edges = np.concatenate([blocks[:, 0], y[-1:]])
    mesh = Mesh(mesh.edges[: len(blocks) + 1])
    nodes = blocks[:, 1:].copy()
    if short:
        share = (mesh.times - mesh.edges[:-1, None]) / np.diff(mesh.edges)[:, None]
        nodes = edges[:-1, None] + share[..., None] * np.diff(edges, axis=0)[:, None]
    return Path(mesh, nodes, edges, dynamics.states, np.full(len(blocks), sense))
