"""The laws that rival methods choose among: columns of torque on the casing, from measured speeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

BASE_TERMS = ("constant", "linear bearing", "power bearing", "linear drag")
_POWER = 1.32


@dataclass(frozen=True)
class Speeds:
    """Time [s], speeds of rotor and casing [rad/s], angle of the casing [rad] of one recording."""

    t: np.ndarray
    wr: np.ndarray
    wc: np.ndarray
    psi: np.ndarray

    @property
    def slip(self) -> np.ndarray:
        """Speed of the bearing."""
        return self.wr - self.wc

    def base(self) -> np.ndarray:
        """Columns of what is known to be there: constant, linear and power bearing, linear drag."""
        return np.stack([np.ones_like(self.t), self.slip, self.slip**_POWER, self.wc], axis=1)

    def integrated(self, columns: np.ndarray) -> np.ndarray:
        """Integrals of columns over time, from the first sample on."""
        return np.asarray(cumulative_trapezoid(columns, self.t, axis=0, initial=0.0))


# name, columns of each case, whether each case has its own strength, number of shape constants
Law = tuple[str, list[np.ndarray], bool, int]


def laws(cases: list[Speeds]) -> Iterator[Law]:
    """Yield the laws of the library, on a grid of shape constants."""

    def law(name: str, column: object, *, own: bool = False, shapes: int = 0) -> Law:
        found = [np.asarray(column(s)) for s in cases]  # type: ignore[operator]
        return name, [f[:, None] if f.ndim == 1 else f for f in found], own, shapes

    yield law("casing.air.quadratic", lambda s: s.wc**2)
    yield law("casing.air.laminar", lambda s: s.wc**1.5)
    yield law("casing.windage", lambda s: s.wr**2)
    yield law("bearing.quadratic", lambda s: s.slip**2)
    yield law("bearing.load_viscous", lambda s: s.slip * s.wr**2)
    yield law("bearing.drift", lambda s: s.slip * s.t)
    yield law("touchpoint.drift", lambda s: s.t, own=True)
    yield law("touchpoint.load", lambda s: s.wr**2, own=True)
    yield law("casing.unbalance", lambda s: np.stack([np.sin(s.psi), np.cos(s.psi)], axis=1))
    yield law("casing.asymmetry", lambda s: np.stack([np.sin(2 * s.psi), np.cos(2 * s.psi)], axis=1))
    for cooling in (20.0, 50.0, 100.0):
        yield law("bearing.heating", lambda s, c=cooling: s.slip * _warmth(s, c), shapes=1)
    for w in (4.0, 8.0, 16.0):
        yield law("touchpoint.stribeck", lambda s, w=w: np.exp(-s.wc / w), own=True, shapes=1)
    for share in np.linspace(0.1, 0.9, 33):
        yield law("touchpoint.step", lambda s, x=share: 1.0 * (s.t > x * s.t[-1]), own=True, shapes=1)
    for m in np.geomspace(200, 900, 40):
        yield law("casing.precession", lambda s, m=m: _chirp(s, m), shapes=1)


def generic(cases: list[Speeds]) -> Iterator[Law]:
    """Yield the products of the speeds up to degree three; a name lists every effect that has the term."""
    effects = {
        (0, 2): "casing.air.quadratic|casing.air.laminar",
        (2, 0): "casing.windage|touchpoint.load|bearing.quadratic",
        (1, 1): "bearing.quadratic",
        (3, 0): "bearing.load_viscous",
        (2, 1): "bearing.load_viscous",
        (0, 3): "cube of the casing's speed",
        (1, 2): "omega_r omega_c^2",
    }
    for (i, j), name in effects.items():
        yield name, [(s.wr**i * s.wc**j)[:, None] for s in cases], False, 0


def _warmth(s: Speeds, cooling: float) -> np.ndarray:
    heat, out = 0.0, np.empty(len(s.t))
    step = float(s.t[1] - s.t[0])
    for i, source in enumerate(s.slip**2):
        out[i] = heat
        heat += step * (source - heat / cooling)
    return out


def _chirp(s: Speeds, m: float) -> np.ndarray:
    turn = m * cumulative_trapezoid(1 / s.wr, s.t, initial=0.0)
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)
