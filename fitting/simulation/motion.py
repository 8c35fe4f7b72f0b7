"""The motion of both bodies, through the moments at which the casing stops, is held by friction, or moves on.

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

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics import Dynamics
from fitting.errors import SimulationError
from fitting.simulation.mesh import Mesh, Path
from fitting.simulation.stretch import NOTHING, Stretches

Array = NDArray[np.float64]

_CASING = 1
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
    run = Stretches(dynamics, numbers, breaks)
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
