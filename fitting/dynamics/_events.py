"""The motion through events: the casing stops, is held by friction, and starts again.

Dry friction jumps where the speed of the casing passes zero. Between these events the casing turns in one sense or
rests, and the equations are smooth. The times of the events are roots of the speed or of the excess of the other
torques over friction. The casing comes to rest if friction would decelerate it in either sense (A. F. Filippov,
Differential Equations with Discontinuous Righthand Sides, 1988). It starts again when the other torques exceed
friction. On the surface omega_c = 0 the rates jump from f- to f+, and a deviation dy- of the state before the jump
becomes

    dy+ = dy- - (f- - f+) dy-_c / f-_c        (the saltation matrix).

A known solution for similar parameters is the initial solution: each stretch between events is solved on the mesh of
this solution, and the time at which the casing stops is an additional unknown. If the sequence of events differs from
that of the known solution, meshes and events are determined anew.

An oscillation has hundreds of events. In this case Newton's method treats all stretches simultaneously. At an edge
where the casing reverses, let y be the state, w the speed of the casing, f- and f+ the rates. The edge moves by -(w +
dw) / f-_c. The next stretch, extrapolated to the old time of the edge, has the deviation S dy - (f- - f+) w / f-_c,
with the saltation matrix S.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._errors import SimulationError
from fitting.dynamics._collocation import (
    MAX_INTERVALS,
    TOLERANCE,
    TOO_SHARP,
    UNBOUNDED,
    Mesh,
    Path,
    Propagator,
    Sampler,
    coarsened,
    newton,
    refine,
    rule,
    runge_kutta,
    transfer,
    truncation_error,
)
from fitting.dynamics._model import Dynamics
from fitting.effects._mechanism import MAIN

Array = NDArray[np.float64]

ROUNDING = 1e-10
"""Relative speed below which a change of sign is rounding error [1]. Derived: the truncation error of the motion,
`fitting.dynamics._collocation.TOLERANCE`."""
_STOPPED = 1e-11
"""The casing is at rest if its speed, as a share of its largest speed, is below this value [1]. Derived: the size of
rounding errors, below `ROUNDING`."""


@dataclass(frozen=True)
class Segments:
    """One integration: equations, numbers, and the times at which a law jumps."""

    dynamics: Dynamics
    numbers: Mapping[str, float]
    breaks: Sequence[float]
    intervals: int = MAX_INTERVALS  # largest number of intervals in one stretch
    least_scale: float = 0.0

    def acceleration(self, time: Array | float, y: Array, sense: float) -> Array:
        """Return the acceleration of the casing with friction for this sense of motion."""
        with np.errstate(all="ignore"):
            rates = self.dynamics.rates(np.asarray(time), y, self.numbers, np.full(y.shape[:-1], sense))
            return np.asarray(rates[..., MAIN])

    def sense_after(self, time: float, y: Array, sense: float) -> float:
        """Return the sense of motion after a time; 0 if the casing is at rest and friction holds it."""
        if not self.dynamics.dry:
            return 1.0
        if y[MAIN] != 0:
            return sense
        onward, back = self.acceleration(time, y, sense or 1.0), self.acceleration(time, y, -(sense or 1.0))
        if sense == 0 and onward > 0:
            return 1.0
        return -(sense or 1.0) if back * -(sense or 1.0) > 0 else 0.0

    def released(self, time: float, y: Array) -> float:
        """Return the sense in which the casing starts to rotate when friction no longer holds it."""
        return 1.0 if self.acceleration(time, y, 1.0) > -self.acceleration(time, y, -1.0) else -1.0

    def _solved(self, first: Path, pivot: float | None = None) -> Path:
        path = newton(self.dynamics, self.numbers, first, pivot=pivot)
        return refine(self.dynamics, self.numbers, path, pivot=pivot, most=self.intervals)

    def saltation(self, time: float, y: Array, before: float, after: float) -> Array:
        """Return the saltation matrix of a deviation of the state."""
        matrix = np.eye(len(y))
        if before != 0:
            t = np.asarray(time)
            first, then = (self.dynamics.rates(t, y, self.numbers, s) for s in (before, after))
            if not (np.isfinite(first).all() and np.isfinite(then).all()):
                raise SimulationError(UNBOUNDED)
            # without acceleration at a reversal there is no jump
            if first[MAIN] != 0:
                matrix[:, MAIN] -= (first - then) / first[MAIN]
        return matrix

    def reversals(self, pieces: Sequence[Path]) -> list[Array]:
        """Return the saltation matrices at the ends of the first stretches, up to the first rest of the casing."""
        ends = [p.edges[-1] for p in pieces]
        if not ends:
            return []
        y, time = np.array(ends), np.array([float(p.mesh.edges[-1]) for p in pieces])
        sense = np.array([float(p.sense[0]) for p in pieces])
        y[:, MAIN] = 0.0
        with np.errstate(all="ignore"):
            before, after = (self.dynamics.rates(time, y, self.numbers, s) for s in (sense, -sense))
        onward = np.append(sense[1:], -sense[-1]) == -sense
        turns = onward & (sense != 0) & (-sense * after[:, MAIN] > 0) & (before[:, MAIN] != 0)
        turns &= np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
        count = len(turns) if turns.all() else int(np.argmin(turns))
        matrices = np.tile(np.eye(y.shape[1]), (count, 1, 1))
        matrices[:, :, MAIN] -= (before - after)[:count] / before[:count, MAIN, None]
        return list(matrices)

    def continued(
        self, start: Array, time: float, end: float, sense: float, known: Path, *, stops: bool
    ) -> Path | None:
        """Return the path between two events from a known solution; None if the sequence of events differs.

        `known` is this stretch of the known solution. With `stops` it ends where the casing stops, otherwise where the
        record ends.
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
        first = replace(known, mesh=mesh, edges=known.edges.copy(), kinks=(), least_scale=self.least_scale)
        first.edges[0] = start
        pivot = places[-2] if stops else None
        try:
            path = self._solved(first, pivot)
        except SimulationError:
            return None
        if sense == 0:
            return path if self._release(path) is None else None
        if stops and not self._rests(path, end):
            return None
        return path if not self.dynamics.dry or _first_crossing(path) is None else None

    def _rests(self, path: Path, end: float) -> bool:
        stop, y, sense = float(path.mesh.edges[-1]), path.edges[-1], float(path.sense[0])
        largest = path.scale()[MAIN]
        between = any(b <= stop for b in self.breaks if b > path.mesh.edges[0] and b not in path.mesh.edges)
        braked = self.acceleration(stop, y, sense) * sense < 0
        return bool(stop < end and not between and braked and abs(y[MAIN]) <= _STOPPED * largest)

    def oscillating(self, start: Array, sense: float, known: Path) -> list[Path]:
        """Return the first stretches of a motion with many reversals, as far as their events agree with a known motion.

        `known` is a solution for similar numbers, or the measured motion. Its jumps are at edges where the casing
        reverses.
        """
        adapted = self._with_beginning(start, sense, known)
        if adapted is None or len(adapted.breaks) != len(self.breaks):
            return []
        known = adapted
        anchors = [*known.mesh.edges[[0, *sorted(known.jumps), -1]].tolist(), *known.breaks]
        places = [*anchors[: len(anchors) - len(known.breaks)], *sorted(self.breaks)]
        if np.any(np.argsort(anchors) != np.argsort(places)):
            return []  # the order of reversals and changepoints has changed
        known = replace(known, mesh=known.mesh.moved(sorted(anchors), sorted(places)))
        at = sorted(known.jumps)
        for share in _NEARBY if known.exact else _SHARES:
            count = math.ceil(share * len(at))
            path = known if count == len(at) else _until(known, at[count])
            path = replace(path, edges=path.edges.copy(), y=path.y.copy())
            path.edges[0] = start
            try:
                found = self._resolved(path).pieces()
            except SimulationError:
                continue
            # the last stretch of an incomplete motion does not end with an event
            return self._valid(found if count == len(at) else found[:-1])
        return []

    def _with_beginning(self, start: Array, sense: float, known: Path) -> Path | None:
        """Return a known motion with its first reversal adapted to the initial speed.

        A body that is released nearly at rest may reverse immediately, depending on the sign of its small initial
        speed; this does not change the later reversals.
        """
        known = replace(known, kinks=known.breaks)
        at, edges = sorted(known.jumps), known.mesh.edges
        if len(at) > 1 and edges[at[0]] - edges[0] < _BRIEF * (edges[at[1]] - edges[at[0]]):
            first, last = float(edges[0]), float(edges[-1])
            later = Mesh(edges[at[0] :]).moved(
                [float(edges[at[0]]), float(edges[at[1]]), last], [first, float(edges[at[1]]), last]
            )
            known = replace(
                known,
                mesh=later,
                y=known.y[at[0] :],
                edges=known.edges[at[0] :],
                sense=known.sense[at[0] :],
                jumps={i - at[0]: known.jumps[i] for i in at[1:]},
            )
        if sense == known.sense[0] or not known.jumps:
            return known if sense == known.sense[0] else None
        first, turn, last = (float(known.mesh.edges[i]) for i in (0, min(known.jumps), -1))
        rate = float(self.acceleration(first, start, sense))
        delay = -float(start[MAIN]) / rate if rate else math.inf
        if not 0 < delay < _LONGEST_BEGINNING * (turn - first):
            return None
        later = known.mesh.moved([first, turn, last], [first + delay, turn, last])
        mesh = Mesh(np.concatenate([[first], later.edges]))
        turned = start.copy()
        turned[MAIN] = 0.0
        share = (mesh.times[0] - first) / delay
        return replace(
            known,
            mesh=mesh,
            y=np.concatenate([(start + share[:, None] * (turned - start))[None], known.y]),
            edges=np.concatenate([start[None], turned[None], known.edges[1:]]),
            sense=np.concatenate([[sense], known.sense]),
            jumps={1: np.eye(len(start))} | {i + 1: m for i, m in known.jumps.items()},
        )

    def _resolved(self, path: Path) -> Path:
        for _ in range(40):
            path = self._through_reversals(path)
            rough = truncation_error(path) > TOLERANCE
            if not rough.any():
                return path
            path = halved(path, rough, self.intervals)
        raise SimulationError(UNBOUNDED)

    def _valid(self, pieces: list[Path]) -> list[Path]:
        """Return the stretches before the first stretch in which the casing reverses, or friction does not hold it."""
        largest = max(float(np.abs(p.y[..., MAIN]).max()) for p in pieces)
        for i, piece in enumerate(pieces):
            if piece.sense[0] == 0:
                return pieces[: i + (self._release(piece) is None)]
            if (piece.y[..., MAIN] * piece.sense[0] < -ROUNDING * largest).any():
                return pieces[:i]
        return pieces

    def _through_reversals(self, path: Path) -> Path:
        """Solve the collocation equations of all stretches simultaneously; the times of the reversals are unknowns."""
        gauss, dynamics = rule(), self.dynamics
        mesh, y, edges, sense = path.mesh, path.y.copy(), path.edges.copy(), path.sense[:, None]
        at = np.array(sorted(path.jumps))
        before = np.inf
        with np.errstate(all="ignore"):
            for _ in range(_MOST_STEPS):
                f, a = dynamics.tangent(mesh.times, y, self.numbers, sense)
                node_defect = edges[:-1, None] + mesh.half[..., None] * (gauss.s @ f) - y
                edge_defect = edges[:-1] + mesh.half * (gauss.w @ f) - edges[1:]
                times = mesh.edges[at]
                ending, following = (
                    dynamics.rates(times, edges[at], self.numbers, path.sense[at - side]) for side in (1, 0)
                )
                step = (ending - following) / ending[:, MAIN, None]
                jumps = np.tile(np.eye(y.shape[-1]), (len(at), 1, 1))
                jumps[:, :, MAIN] -= step
                offsets = -step * edges[at, MAIN, None]
                shape = Propagator(
                    mesh, a, dict(zip(at.tolist(), jumps, strict=True)), defect=node_defect[..., None]
                )
                moves = shape.chain(
                    shape.response,
                    edge_defect[..., None],
                    added=dict(zip(at.tolist(), offsets[..., None], strict=True)),
                )
                nodes = (shape.response + shape.carried(moves))[..., 0]
                arriving = moves[at - 1, :, 0] + edge_defect[at - 1]
                arriving += mesh.half[at - 1] * np.einsum("k,eknm,ekm->en", gauss.w, a[at - 1], nodes[at - 1])
                moved = -(edges[at, MAIN] + arriving[:, MAIN]) / ending[:, MAIN]
                y += nodes
                edges += moves[..., 0]
                edges[at] += arriving - moves[at, :, 0] + ending * moved[:, None]
                fixed = [b for b in (mesh.edges[0], *self.breaks, mesh.edges[-1]) if b <= mesh.edges[-1]]
                anchors = np.concatenate([fixed, times])
                order = np.argsort(anchors)
                places = np.concatenate([fixed, times + moved])[order]
                anchors = anchors[order]
                gaps = np.diff(anchors)
                shift = np.abs(places - anchors)[1:-1]
                delay = float((shift / np.minimum(gaps[:-1], gaps[1:])).max())
                scale = 1e-300 + np.abs(y).max(axis=(0, 1))
                size = max(float((np.abs(nodes).max(axis=(0, 1)) / scale).max()), delay)
                if not size < 1e8 or not delay < _LONGEST_DELAY:
                    break
                new = mesh.moved(anchors.tolist(), places.tolist())
                y += f * (new.times - mesh.times)[..., None]
                inner = np.setdiff1d(np.arange(1, len(edges) - 1), at)
                edges[inner] += (gauss.ends[1] @ f)[inner - 1] * (new.edges - mesh.edges)[inner, None]
                mesh = new
                if size < _SMALL or 10 * size**2 < _EXACT < before**2:
                    edges[at, MAIN] = 0.0
                    return replace(path, mesh=mesh, y=y, edges=edges)
                before = size
        raise SimulationError(UNBOUNDED)

    def moving(
        self,
        start: Array,
        mesh: Mesh,
        span: tuple[float, float],
        sense: float,
        guess: Path | None,
        horizon: float,
    ) -> Path:
        """Return the path from the start of `span` until the casing comes to rest, or to the end of `span`.

        The stop is first searched for within `horizon` [s]. Otherwise each stretch of an oscillation with dry friction
        would needlessly be solved far beyond the next reversal.
        """
        time, end = span
        while True:
            until = min(end, time + horizon)
            part = mesh.between(time, until)
            path = self._rough(start, part, sense, guess)
            stop = _first_crossing(path) if self.dynamics.dry else None
            if stop is None:
                path = refine(self.dynamics, self.numbers, path, most=self.intervals)
                stop = _first_crossing(path) if self.dynamics.dry else None
            if stop is not None:
                path = self._until_rest(path, part, stop)
            if until >= end or path.mesh.edges[-1] < until:
                return path
            horizon *= 4.0

    def _rough(self, start: Array, mesh: Mesh, sense: float, guess: Path | None) -> Path:
        if guess is not None:
            try:
                first = transfer(guess, mesh, start, sense)
                return newton(self.dynamics, self.numbers, replace(first, least_scale=self.least_scale))
            except SimulationError:
                pass
        first = runge_kutta(self.dynamics, self.numbers, start, mesh, sense)
        return newton(self.dynamics, self.numbers, replace(first, least_scale=self.least_scale))

    def _until_rest(self, path: Path, mesh: Mesh, stop: float) -> Path:
        sense, first = float(path.sense[0]), float(mesh.edges[0])
        breaks = [b for b in self.breaks if first < b < stop]
        try:
            part = Mesh(path.mesh.edges[:-1]).between(first, stop).with_breakpoints(breaks)
            guess = transfer(path, part, path.edges[0], sense)
            found = self._solved(guess, max([first, *breaks]))
            if self._rests(found, float(mesh.edges[-1])) and _first_crossing(found) is None:
                return found
        except SimulationError:
            pass
        for _ in range(40):
            part = Mesh(path.mesh.edges[:-1]).between(first, stop)
            path = self._solved(transfer(path, part, path.edges[0], sense))
            y = path.edges[-1]
            earlier = _first_crossing(path)
            if earlier is not None and earlier < stop - 1e-6 * (stop - first):
                stop = earlier
                continue
            rate = float(self.dynamics.rates(np.asarray(stop), y, self.numbers, sense)[MAIN])
            move = -float(y[MAIN]) / rate if rate else np.inf
            if not np.isfinite(move):
                break
            if abs(y[MAIN]) <= _STOPPED * path.scale()[MAIN] or abs(move) < 1e-13 * stop:
                return path
            if stop + move > mesh.edges[-1]:
                # the casing does not come to rest within the record
                return self._solved(transfer(path, mesh, path.edges[0], sense))
            stop = max(stop + move, first + 0.5 * (stop - first))
        raise SimulationError(UNBOUNDED)

    def held(self, start: Array, mesh: Mesh, guess: Path | None) -> Path:
        """Return the path until friction no longer holds the casing, or to the end of the mesh."""
        still = guess or Path(
            mesh,
            np.tile(start, (*mesh.times.shape, 1)),
            np.tile(start, (len(mesh.edges), 1)),
            self.dynamics.states,
            np.zeros(len(mesh.edges) - 1),
        )
        path = self._rough(start, mesh, 0.0, _at_rest(still))
        path = refine(self.dynamics, self.numbers, path, most=self.intervals)
        time = self._release(path)
        if time is None:
            return path
        part = path.mesh.between(float(mesh.edges[0]), time)
        return self._solved(transfer(path, part, path.edges[0], 0.0))

    def _release(self, path: Path) -> float | None:
        """Return the time at which the other torques first exceed friction; None if they never exceed it."""
        edges = path.mesh.edges
        ends = [edges[1:], np.nextafter(edges[1:], -np.inf)]
        times = np.sort(np.concatenate([path.mesh.times.ravel(), *ends]))

        def excess(*at: float) -> Array:
            t = np.array(at)
            y = Sampler(path.mesh, t).value(path.y)
            return np.maximum(self.acceleration(t, y, 1.0), -self.acceleration(t, y, -1.0))

        exceeded = np.flatnonzero(excess(*times) > 0)
        if not len(exceeded):
            return None
        from scipy.optimize import brentq

        i = int(exceeded[0])
        begin = times[i - 1] if i else edges[0]
        time = begin
        if excess(begin)[0] < 0:
            time = float(brentq(lambda t: float(excess(t)[0]), begin, times[i], xtol=1e-12))
        near = [b for b in self.breaks if abs(b - time) < 1e-9 * edges[-1]]
        return near[0] if near else time


def _until(path: Path, edge: int) -> Path:
    """Return a path up to an edge."""
    jumps = {i: matrix for i, matrix in path.jumps.items() if i < edge}
    edges = path.mesh.edges[: edge + 1]
    return replace(
        path,
        mesh=Mesh(edges),
        y=path.y[:edge],
        edges=path.edges[: edge + 1],
        sense=path.sense[:edge],
        jumps=jumps,
    )


def halved(path: Path, rough: NDArray[np.bool_], most: int) -> Path:
    """Return a path with its `rough` intervals halved, with at most `most` intervals in total.

    Senses of rotation and jumps keep their times.
    """
    edges = path.mesh.edges
    parent = np.repeat(np.arange(len(rough)), 1 + rough)
    middle = 0.5 * (edges[1:] + edges[:-1])[rough]
    mesh = Mesh(np.sort(np.concatenate([edges, middle])))
    if len(mesh.edges) > most:
        raise SimulationError(TOO_SHARP)
    y = Sampler(path.mesh, mesh.times.ravel()).value(path.y).reshape(*mesh.times.shape, -1)
    states = np.empty((len(mesh.edges), path.edges.shape[1]))
    old = np.searchsorted(mesh.edges, edges)
    states[old] = path.edges
    states[np.searchsorted(mesh.edges, middle)] = Sampler(path.mesh, middle).value(path.y)
    jumps = {int(old[i]): matrix for i, matrix in path.jumps.items()}
    return replace(path, mesh=mesh, y=y, edges=states, sense=path.sense[parent], jumps=jumps)


def _at_rest(path: Path) -> Path:
    y, edges = path.y.copy(), path.edges.copy()
    y[..., MAIN] = edges[:, MAIN] = 0.0
    return replace(path, y=y, edges=edges)


def _first_crossing(path: Path) -> float | None:
    """Return the approximate time at which the casing first reverses; None if it does not."""
    times = np.concatenate([path.mesh.times, path.mesh.edges[1:, None]], axis=1).ravel()
    speed = np.concatenate([path.y[..., MAIN], path.edges[1:, None, MAIN]], axis=1).ravel()
    speed = speed * path.sense[0]
    reversed_ = np.flatnonzero(speed < -ROUNDING * max(float(np.abs(speed).max()), path.least_scale))
    if not len(reversed_):
        return None
    i = int(reversed_[0])
    before, t = (speed[i - 1], times[i - 1]) if i else (abs(path.edges[0, MAIN]), path.mesh.edges[0])
    share = max(before, 0.0) / (max(before, 0.0) - speed[i])
    return float(t + share * (times[i] - t))


_MAX_EVENTS = 2000
"""Largest number of reversals of a record [1]. Chosen: a limit of time; a smaller value refuses long oscillations, a
larger one costs time for a motion that chatters."""
_MANY = 3
"""Smallest number of reversals for which all stretches are solved simultaneously [1]. Chosen: with a smaller value the
number of events may still change, a larger one costs time."""
_MOST_STEPS = 25
"""Largest number of Newton steps for the times of all reversals [1]. Chosen: a smaller number stops early, a
larger one delays failures."""
_HORIZON = 2.0
"""Time within which the next event is first searched for, relative to the largest time between two reversals [1].
Chosen: a smaller value overlooks the next reversal, a larger one integrates needlessly."""
_NEARBY = (1.0, 0.97)
"""Trial shares of the reversals that are solved simultaneously, if a known solution is the initial solution [1].
Chosen: the second share omits reversals at the end that may not exist; a smaller share costs time."""
_SHARES = (*_NEARBY, 0.9, 0.7, 0.4)
"""Trial shares of the reversals that are solved simultaneously, if the measured motion is the initial solution [1].
Chosen: smaller shares allow larger errors of the frequency; with fewer shares, the solution may fail; with more, it
takes longer."""
_BRIEF = 0.1
"""The first stretch is determined again if its length, divided by the length of the second stretch, is below this value
[1]. Chosen: a smaller value keeps a first stretch that may not exist, a larger one discards a valid stretch."""
_LONGEST_BEGINNING = 0.3
"""Largest length of a first stretch that is added before the known motion, relative to the time to the first reversal
[1]. Chosen: a smaller value solves a motion without its first reversal, a larger one extrapolates the first rate too
far."""
_SMALL = 1e-9
"""Relative change of the times below which Newton's method has converged [1]. Derived: convergence is quadratic, so the
next change is rounding error."""
_EXACT = 1e-13
"""Relative change of the times that is rounding error [1]. Derived: several hundred times the relative precision of a
number, for sums over many reversals."""
_SLOW = 1e-3
"""Smallest scale of the errors of the speed of an oscillating casing, relative to its largest speed [1]. Chosen: a
smaller value refines the mesh at each reversal, a larger one makes slow parts inaccurate."""
_LONGEST_DELAY = 0.45
"""Largest change of the time of a reversal in a step, as a share of the time to its neighbours [1]. Derived: below one
half, so that two reversals do not change their order."""


def solve(
    dynamics: Dynamics,
    numbers: Mapping[str, float],
    start: Array,
    mesh: Mesh,
    guess: Path | None = None,
    *,
    most: int = _MAX_EVENTS,
    intervals: int = MAX_INTERVALS,
) -> Path:
    """Integrate the equations of motion, exact to about 1e-9 of the largest value of each state.

    The intervals of `mesh` are halved where necessary. They are also divided at the changepoints of the model, at the
    changes of its inputs, and where the casing stops, reverses or starts. `guess` is a solution for similar numbers, or
    the measured motion. If the sequence of events differs from that of `guess`, at most `most` stretches are integrated
    one by one, each with at most `intervals` intervals. A SimulationError is raised if these limits are exceeded,
    Newton's method diverges, or states overflow.
    """
    span = float(mesh.edges[0]), float(mesh.edges[-1])
    own = (numbers[k] for k in dynamics.breakpoints if span[0] < numbers[k] < span[1])
    breaks = tuple(sorted({*own, *dynamics.changes(*span, numbers)}))
    mesh = mesh.with_breakpoints(breaks)
    run = Segments(dynamics, numbers, breaks, intervals)
    pieces: list[Path] = []
    jumps: list[Array] = []
    y, time, end = np.asarray(start, dtype=np.float64), float(mesh.edges[0]), float(mesh.edges[-1])
    sense = run.sense_after(time, y, float(np.sign(y[MAIN])))
    known = guess.pieces() if guess is not None and guess.exact else []
    ready: list[Path] = []
    horizon = math.inf
    if dynamics.dry and guess is not None and len(guess.jumps) >= _MANY:
        run = replace(run, least_scale=_SLOW * float(np.abs(guess.y[..., MAIN]).max()))
        horizon = _HORIZON * float(np.diff(guess.mesh.edges[sorted(guess.jumps)]).max())
        ready = run.oscillating(y, sense, guess)
        if len(guess.jumps) - len(ready) > most:
            raise SimulationError(UNBOUNDED)
        guess = None
    if ready and ready[0].sense[0] == sense:
        # a single vector operation is faster for hundreds of reversals
        jumps = run.reversals([p for p in ready if p.mesh.edges[-1] < end])
        pieces, ready = ready[: len(jumps)], ready[len(jumps) :]
        if pieces:
            last = pieces[-1]
            y, time, sense = last.edges[-1].copy(), float(last.mesh.edges[-1]), -float(last.sense[0])
            y[MAIN] = 0.0
    while most >= 0 and len(pieces) < _MAX_EVENTS:
        known_piece = known[len(pieces)] if len(pieces) < len(known) else None
        stops = len(pieces) + 1 < len(known)
        ready = ready if ready and ready[0].sense[0] == sense else []
        piece = ready.pop(0) if ready else None
        if piece is None and known_piece is not None:
            piece = run.continued(y, time, end, sense, known_piece, stops=stops)
        most -= piece is None
        if piece is None:
            piece = (
                run.held(y, mesh.between(time, end), guess)
                if sense == 0
                else run.moving(y, mesh, (time, end), sense, guess, horizon)
            )
        pieces.append(piece)
        time = float(piece.mesh.edges[-1])
        if time >= end:
            return _joined(pieces, jumps, breaks)
        y = piece.edges[-1].copy()
        if abs(y[MAIN]) > ROUNDING * piece.scale()[MAIN]:
            jumps.append(np.eye(len(y)))
            continue
        y[MAIN] = 0.0
        following = run.sense_after(time, y, sense) if sense else run.released(time, y)
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
