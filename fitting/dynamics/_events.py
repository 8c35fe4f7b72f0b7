"""The motion through events: the casing stops, is held by friction, and starts again.

Dry friction jumps where the casing's speed passes zero. Between such moments the casing turns in one sense, or
rests, and the equations are smooth; the moments themselves are found as roots. The casing comes to rest if
friction would push it back from either sense (A. F. Filippov, Differential Equations with Discontinuous
Righthand Sides, 1988), and moves on when the other torques overcome friction. A deviation dy of the state just
before a jump of the rates from f- to f+, on the surface omega_c = 0, is afterwards

    dy+ = dy- - (f- - f+) dy-_c / f-_c        (the saltation matrix).

A known solution for numbers nearby is followed: stretch by stretch on its own mesh, with the time of each stop as one
more unknown. Only where the motion is no longer alike are meshes and moments sought from nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._errors import SimulationError
from fitting.dynamics._collocation import coarsened, collocate, newton, refine, runge_kutta
from fitting.dynamics._mesh import Mesh, Path, Sampler, transfer
from fitting.dynamics._model import Dynamics
from fitting.dynamics._sensitivities import UNBOUNDED

Array = NDArray[np.float64]

_CASING = 1
# a speed so small beside the largest one is rounding, not the other sense
NOTHING = 1e-10
_STOPPED = 1e-11


@dataclass(frozen=True)
class Segments:
    """One integration: equations, numbers, and the times at which a law jumps."""

    dynamics: Dynamics
    numbers: Mapping[str, float]
    breaks: Sequence[float]

    def push(self, time: Array | float, y: Array, sense: float) -> Array:
        """Return the casing's acceleration if it moved in this sense."""
        with np.errstate(all="ignore"):
            return np.asarray(
                self.dynamics.rates(np.asarray(time), y, self.numbers, np.full(y.shape[:-1], sense))[
                    ..., _CASING
                ]
            )

    def sense_after(self, time: float, y: Array, sense: float) -> float:
        """Return the sense of motion from a moment on; at rest, whether friction holds the casing."""
        if not self.dynamics.dry:
            return 1.0
        if y[_CASING] != 0:
            return sense
        onward, back = self.push(time, y, sense or 1.0), self.push(time, y, -(sense or 1.0))
        if sense == 0 and onward > 0:
            return 1.0
        return -(sense or 1.0) if back * -(sense or 1.0) > 0 else 0.0

    def freed(self, time: float, y: Array) -> float:
        """Return the sense in which a casing moves on that friction no longer holds."""
        return 1.0 if self.push(time, y, 1.0) > -self.push(time, y, -1.0) else -1.0

    def saltation(self, time: float, y: Array, before: float, after: float) -> Array:
        """Return what a deviation of the state is multiplied by."""
        matrix = np.eye(len(y))
        if before != 0:
            t = np.asarray(time)
            first, then = (self.dynamics.rates(t, y, self.numbers, s) for s in (before, after))
            if not (np.isfinite(first).all() and np.isfinite(then).all()):
                raise SimulationError(UNBOUNDED)
            # a casing that only just touches rest goes through it unchanged
            if first[_CASING] != 0:
                matrix[:, _CASING] -= (first - then) / first[_CASING]
        return matrix

    def alike(
        self, start: Array, time: float, end: float, sense: float, known: Path, *, stops: bool
    ) -> Path | None:
        """Return the path from an event to the next as that of a known solution went, or None if it does not go so.

        Parameters
        ----------
        start, time, sense
            State, time, and sense of motion at the event.
        end : float
            Where the record ends.
        known : Path
            This stretch of the known solution.
        stops : bool
            Whether it ended with the casing at rest, and not with the record.
        """
        edges = known.mesh.edges
        within = [b for b in self.breaks if time < b < (edges[-1] if stops else end)]
        if known.sense[0] != sense or len(within) != len(known.kinks) or (stops and sense == 0):
            return None
        places = [time, *sorted(within), float(edges[-1]) if stops else end]
        if not np.all(np.diff(places) > 0):
            return None
        known = coarsened(known)
        mesh = known.mesh.moved([float(edges[0]), *known.kinks, float(edges[-1])], places)
        first = replace(known, mesh=mesh, edges=known.edges.copy(), kinks=())
        first.edges[0] = start
        pivot = places[-2] if stops else None
        try:
            path = collocate(self.dynamics, self.numbers, first, pivot=pivot)
        except SimulationError:
            return None
        if sense == 0:
            return path if self._release(path) is None else None
        if stops and not self._rests(path, end):
            return None
        return path if not self.dynamics.dry or _first_crossing(path) is None else None

    def _rests(self, path: Path, end: float) -> bool:
        stop, y, sense = float(path.mesh.edges[-1]), path.edges[-1], float(path.sense[0])
        largest = np.abs(path.y[..., _CASING]).max()
        between = any(b <= stop for b in self.breaks if b > path.mesh.edges[0] and b not in path.mesh.edges)
        braked = self.push(stop, y, sense) * sense < 0
        return bool(stop < end and not between and braked and abs(y[_CASING]) <= _STOPPED * largest)

    def turning(self, start: Array, mesh: Mesh, sense: float, guess: Path | None) -> Path:
        """Return the path until the casing comes to rest, or to the end of the mesh."""
        path = self._rough(start, mesh, sense, guess)
        if not self.dynamics.dry:
            return refine(self.dynamics, self.numbers, path)
        stop = _first_crossing(path)
        if stop is None:
            path = refine(self.dynamics, self.numbers, path)
            stop = _first_crossing(path)
            if stop is None:
                return path
        return self._until_rest(path, mesh, stop)

    def _rough(self, start: Array, mesh: Mesh, sense: float, guess: Path | None) -> Path:
        if guess is not None:
            try:
                first = transfer(guess, mesh, start, sense)
                return newton(self.dynamics, self.numbers, first)
            except SimulationError:
                pass
        first = runge_kutta(self.dynamics, self.numbers, start, mesh, sense)
        return newton(self.dynamics, self.numbers, first)

    def _until_rest(self, path: Path, mesh: Mesh, stop: float) -> Path:
        sense, first = float(path.sense[0]), float(mesh.edges[0])
        breaks = [b for b in self.breaks if first < b < stop]
        try:
            part = Mesh(path.mesh.edges[:-1]).between(first, stop).with_breakpoints(breaks)
            guess = transfer(path, part, path.edges[0], sense)
            found = collocate(self.dynamics, self.numbers, guess, pivot=max([first, *breaks]))
            if self._rests(found, float(mesh.edges[-1])) and _first_crossing(found) is None:
                return found
        except SimulationError:
            pass
        for _ in range(40):
            part = Mesh(path.mesh.edges[:-1]).between(first, stop)
            path = collocate(self.dynamics, self.numbers, transfer(path, part, path.edges[0], sense))
            y = path.edges[-1]
            earlier = _first_crossing(path)
            if earlier is not None and earlier < stop - 1e-6 * (stop - first):
                stop = earlier
                continue
            rate = float(self.dynamics.rates(np.asarray(stop), y, self.numbers, sense)[_CASING])
            move = -float(y[_CASING]) / rate if rate else np.inf
            if not np.isfinite(move):
                break
            if abs(y[_CASING]) <= _STOPPED * np.abs(path.y[..., _CASING]).max() or abs(move) < 1e-13 * stop:
                return path
            if stop + move > mesh.edges[-1]:
                # it only nearly comes to rest
                return collocate(self.dynamics, self.numbers, transfer(path, mesh, path.edges[0], sense))
            stop = max(stop + move, first + 0.5 * (stop - first))
        raise SimulationError(UNBOUNDED)

    def held(self, start: Array, mesh: Mesh, guess: Path | None) -> Path:
        """Return the path until friction no longer holds the casing, or to the end of the mesh."""
        path = self._rough(start, mesh, 0.0, None if guess is None else _at_rest(guess))
        path = refine(self.dynamics, self.numbers, path)
        time = self._release(path)
        if time is None:
            return path
        part = path.mesh.between(float(mesh.edges[0]), time)
        return collocate(self.dynamics, self.numbers, transfer(path, part, path.edges[0], 0.0))

    def _release(self, path: Path) -> float | None:
        edges = path.mesh.edges
        times = np.sort(
            np.concatenate([path.mesh.times.ravel(), edges[1:], np.nextafter(edges[1:], -np.inf)])
        )
        y = Sampler(path.mesh, times).value(path.y)
        excess = np.maximum(self.push(times, y, 1.0), -self.push(times, y, -1.0))
        free = np.flatnonzero(excess > 0)
        if not len(free):
            return None
        from scipy.optimize import brentq

        i = int(free[0])

        def overcome(t: float) -> float:
            state = Sampler(path.mesh, np.array([t])).value(path.y)
            return float(
                np.maximum(self.push(np.array([t]), state, 1.0), -self.push(np.array([t]), state, -1.0))[0]
            )

        begin = times[i - 1] if i else edges[0]
        time = float(brentq(overcome, begin, times[i], xtol=1e-12)) if overcome(begin) < 0 else begin
        near = [b for b in self.breaks if abs(b - time) < 1e-9 * edges[-1]]
        return near[0] if near else time


def _at_rest(path: Path) -> Path:
    y, edges = path.y.copy(), path.edges.copy()
    y[..., _CASING] = edges[:, _CASING] = 0.0
    return replace(path, y=y, edges=edges)


def _first_crossing(path: Path) -> float | None:
    """Return the time at which the casing first turns against the sense of the path, nearly."""
    times = np.concatenate([path.mesh.times, path.mesh.edges[1:, None]], axis=1).ravel()
    speed = (
        np.concatenate([path.y[..., _CASING], path.edges[1:, None, _CASING]], axis=1).ravel() * path.sense[0]
    )
    against = np.flatnonzero(speed < -NOTHING * np.abs(speed).max())
    if not len(against):
        return None
    i = int(against[0])
    before, t = (speed[i - 1], times[i - 1]) if i else (abs(path.edges[0, _CASING]), path.mesh.edges[0])
    share = max(before, 0.0) / (max(before, 0.0) - speed[i])
    return float(t + share * (times[i] - t))


_MAX_EVENTS = 2000


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
        Intervals to begin with; they are halved where needed, and cut at the model's breakpoints
        and where the casing stops, turns back or moves on.
    guess : Path, optional
        A solution for numbers near these, or what is measured.

    Returns
    -------
    Path
        Exact to about 1e-9 of the largest value of each state.

    Raises
    ------
    SimulationError
        If Newton's method does not converge or the states leave the finite numbers.
    """
    breaks = tuple(numbers[k] for k in dynamics.breakpoints if mesh.edges[0] < numbers[k] < mesh.edges[-1])
    mesh = mesh.with_breakpoints(breaks)
    run = Segments(dynamics, numbers, breaks)
    pieces: list[Path] = []
    jumps: list[Array] = []
    y, time, end = np.asarray(start, dtype=np.float64), float(mesh.edges[0]), float(mesh.edges[-1])
    sense = run.sense_after(time, y, float(np.sign(y[_CASING])))
    known = guess.pieces() if guess is not None and guess.exact else []
    for _ in range(_MAX_EVENTS):
        alike = known[len(pieces)] if len(pieces) < len(known) else None
        stops = len(pieces) + 1 < len(known)
        piece = None if alike is None else run.alike(y, time, end, sense, alike, stops=stops)
        if piece is None:
            rest = mesh.between(time, end)
            piece = run.held(y, rest, guess) if sense == 0 else run.turning(y, rest, sense, guess)
        pieces.append(piece)
        time = float(piece.mesh.edges[-1])
        if time >= end:
            return _joined(pieces, jumps, breaks)
        y = piece.edges[-1].copy()
        if abs(y[_CASING]) > NOTHING * np.abs(piece.y[..., _CASING]).max():
            jumps.append(np.eye(len(y)))
            continue
        y[_CASING] = 0.0
        following = run.sense_after(time, y, sense) if sense else run.freed(time, y)
        jumps.append(run.saltation(time, y, sense, following))
        sense = following
    raise SimulationError("the casing stops and starts too often to be followed")


def _joined(pieces: list[Path], jumps: list[Array], breaks: tuple[float, ...]) -> Path:
    if len(pieces) == 1:
        return replace(pieces[0], kinks=breaks)
    ends = np.cumsum([len(p.y) for p in pieces])[:-1]
    events = tuple(float(p.mesh.edges[-1]) for p in pieces[:-1])
    return Path(
        Mesh(np.concatenate([pieces[0].mesh.edges, *(p.mesh.edges[1:] for p in pieces[1:])])),
        np.concatenate([p.y for p in pieces]),
        np.concatenate([pieces[0].edges, *(p.edges[1:] for p in pieces[1:])]),
        pieces[0].states,
        np.concatenate([p.sense for p in pieces]),
        tuple(sorted({*breaks, *events})),
        dict(zip(ends.tolist(), jumps, strict=True)),
    )
