"""Which markers sit on one body, how fast each body turns, and which of them is the rotor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.proposal.markers import Candidate

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

EVEN = 0.6
"""Share of the sightings that must be in phase with an even motion."""
TOGETHER = 0.75
"""Share of the samples in which two markers of one body keep their distance."""
_STANDS, _MOVED = 2e-3, 0.25
_NEAR = 0.2
_FEWEST = 8


@dataclass(frozen=True)
class Pace:
    """An even motion through consecutive frames: step in rad a frame, and the share of sightings in phase with it."""

    step: float
    share: float


@dataclass(frozen=True)
class Group:
    """Markers that keep their distance, and how they move."""

    members: tuple[Candidate, ...]
    pace: Pace

    @property
    def stands(self) -> bool:
        """Whether it does not turn, in the first frames nor in the course of the film."""
        if abs(self.pace.step) > _STANDS:
            return False
        seen = self.members[0].sighting
        turn = np.exp(1j * seen.angle[seen.clear])
        return bool(np.abs(np.angle(turn / turn.sum())).max() < _MOVED)

    @property
    def weight(self) -> float:
        """How much there is to see of it."""
        return sum(c.contrast * float(c.sighting.clear.mean()) for c in self.members)


def pace(angle: Floats, use: Mask) -> Pace:
    """Find the step that brings most angles of consecutive frames, (n,) in rad, into phase."""
    frame = np.flatnonzero(use)
    if len(frame) < _FEWEST:
        return Pace(0.0, 0.0)
    phasor = np.exp(1j * angle[frame])
    steps = np.linspace(-np.pi, np.pi, 32 * (int(frame[-1]) + 1), endpoint=False)
    power = np.abs(np.exp(-1j * np.outer(steps, frame)) @ phasor)
    step = float(steps[np.argmax(power)])
    start = float(np.angle(np.sum(phasor * np.exp(-1j * step * frame))))
    off = np.abs(np.angle(phasor * np.exp(-1j * (start + step * frame))))
    return Pace(step, float(np.mean(off < 0.35)))


def group_bodies(candidates: list[Candidate], head: int) -> tuple[list[Group], list[Candidate]]:
    """Put markers that move together into groups, the strongest group first; also return those that move unevenly."""
    groups: list[list[Candidate]] = []
    paces = {id(c): pace(c.sighting.angle[:head], c.sighting.clear[:head]) for c in candidates}
    uneven = [c for c in candidates if paces[id(c)].share < EVEN]
    for one in sorted(candidates, key=lambda c: -c.contrast):
        if any(one is other for other in uneven):
            continue
        home = next((g for g in groups if _together(one, g[0])), None)
        if home is None:
            groups.append([one])
        else:
            home.append(one)
    made = [Group(tuple(g), max((paces[id(c)] for c in g), key=lambda p: p.share)) for g in groups]
    return sorted(made, key=lambda g: -g.weight), uneven


def _together(a: Candidate, b: Candidate) -> bool:
    both = a.sighting.clear & b.sighting.clear
    if both.sum() < _FEWEST:
        return False
    turn = np.exp(1j * (a.sighting.angle - b.sighting.angle)[both])
    near = np.abs(np.angle(turn[:, None] / turn[None, :])) < _NEAR
    return bool(near.mean(axis=1).max() > TOGETHER)
