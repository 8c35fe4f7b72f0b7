"""Variables in which a torque that swings is linear.

A law of strength k and phase phi is k [cos(phi) s + sin(phi) c] with its responses s and c at phase 0 and at a quarter
turn. In k and phi a search that begins at k = 0 has no slope by phi, cannot turn round once k is at its bound, and
moves the others, above all the start speed, which have to make room for both. In

    a = k cos(phi),   b = k sin(phi)

there is neither a bound nor a bend.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.estimation.layout import Layout

Array = NDArray[np.float64]

# a strength that moves nothing, but still has a phase
_TINY = 1e-30


@dataclass(frozen=True)
class Wave:
    """Places of a strength and of its phase among the variables."""

    strength: int
    phase: int


def find_waves(layout: Layout) -> tuple[Wave, ...]:
    """Return the pairs of strength and phase that nothing holds or limits.

    A law whose shape is free as well has none: about its shape the data say nothing while its strength is small. Nor
    has one whose strength is each case's own while all share the phase, or the other way round.
    """
    found: dict[Wave, None] = {}
    for effect in layout.model.effects:
        keys = {p.role: f"{effect.name}.{p.symbol}" for p in effect.free}
        if set(keys) != {"amplitude", "phase"}:
            continue
        pair = [keys["amplitude"], keys["phase"]]
        if len(set(pair) & set(layout.per_case)) == 1:
            continue
        for case in range(len(layout.records)):
            found[Wave(*layout.places(case, pair).tolist())] = None
    if not found:
        return ()
    lower, upper = layout.bounds()
    return tuple(w for w in found if lower[w.strength] <= 0 and np.isinf(_ends(w, lower, upper)).all())


def _ends(w: Wave, lower: Array, upper: Array) -> list[float]:
    return [float(upper[w.strength]), float(lower[w.phase]), float(upper[w.phase])]


def to_polar(u: Array, waves: Sequence[Wave]) -> tuple[Array, Array]:
    """Return (k, phi) in place of (a, b), the other variables as they are, and the derivatives of all."""
    theta, slope = u.copy(), np.eye(len(u))
    for w in waves:
        a, b = u[w.strength], u[w.phase]
        k, phi = max(float(np.hypot(a, b)), _TINY), float(np.arctan2(b, a))
        theta[w.strength], theta[w.phase] = k, phi
        pair = [w.strength, w.phase]
        slope[np.ix_(pair, pair)] = [[np.cos(phi), np.sin(phi)], [-np.sin(phi) / k, np.cos(phi) / k]]
    return theta, slope


def from_polar(theta: Array, waves: Sequence[Wave]) -> Array:
    """Return (a, b) in place of (k, phi)."""
    u = theta.copy()
    for w in waves:
        k, phi = theta[w.strength], theta[w.phase]
        u[w.strength], u[w.phase] = k * np.cos(phi), k * np.sin(phi)
    return u
