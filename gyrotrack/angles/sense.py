"""Which way the bodies turn, and how far between two frames when that is more than half a turn."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def net_turn(angle: Floats) -> float:
    """Return by how much an unwrapped angle with gaps (NaN) has grown from its first to its last value."""
    known = angle[np.isfinite(angle)]
    return float(known[-1] - known[0]) if len(known) > 1 else 0.0


def find_sense(turns: dict[str, float], given: int | None) -> int:
    """Return the factor (+1 or -1) that makes the angles grow.

    Parameters
    ----------
    turns : dict of float
        By how much each body has turned as seen [rad].
    given : int or None
        What the profile says; it is believed.

    Notes
    -----
    The casing decides, since it never turns by half a turn between frames; where it hardly
    moves, the rotor. If nothing moves the bodies are taken to turn clockwise as seen, as in the paper.
    """
    if given is not None:
        return given
    for name in ("casing", "rotor"):
        if abs(turns.get(name, 0.0)) > 0.5:
            return 1 if turns[name] > 0 else -1
    return -1


def unfold(angle: Floats, sense: int) -> tuple[Floats, bool]:
    """Add a turn a frame to a body that seems to turn against the sense, as spokes do in a film.

    A body that turns by w between frames looks the same as one that turns by w - 2 pi. Friction carries both
    bodies the same way round, so that the rotor's sense is the casing's. Returns the angle, and whether it
    was changed.
    """
    turn = net_turn(angle)
    steps = max(int(np.isfinite(angle).sum()) - 1, 1)
    if turn * sense >= 0 or abs(turn) / steps < 0.02:
        return angle, False
    return angle + sense * 2.0 * np.pi * np.arange(len(angle)), True
