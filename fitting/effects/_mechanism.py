"""The bodies of a case, the joints between them, and the symbols of their motion in laws.

The speed of the body ``wheel`` is omega_wheel and its angle psi_wheel. A joint acts between two bodies: delta_belt is
the speed of its first body minus the speed of its second body. Its torque tau_belt drives the second body and brakes
the first body. In a gyroscope the symbols are omega_r, omega_c, psi_r, psi_c, delta and tau.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# symbols of the bodies of a gyroscope, and its joint
_SUFFIXES = {"rotor": "r", "casing": "c"}
_BEARING = "bearing"
MAIN = 1
"""Place of the main body in a state [1]. Derived: a state begins with omega_r and omega_c, and the casing is the main
body of a gyroscope."""


class Coupling(NamedTuple):
    """A joint: its torque brakes the first body and drives the second body."""

    name: str
    first: str
    second: str

    @property
    def delta(self) -> str:
        """The symbol of the speed of the first body relative to the second body."""
        return "delta" if self.name == _BEARING else f"delta_{self.name}"

    @property
    def tau(self) -> str:
        """The symbol of the torque of the joint."""
        return "tau" if self.name == _BEARING else f"tau_{self.name}"


def speed_of(body: str) -> str:
    """Return the symbol of the speed of a body."""
    return f"omega_{_SUFFIXES.get(body, body)}"


def angle_of(body: str) -> str:
    """Return the symbol of the angle of a body."""
    return f"psi_{_SUFFIXES.get(body, body)}"


def inertia_of(body: str) -> str:
    """Return the key of the moment of inertia of a body."""
    return f"inertia.{body}"


@dataclass(frozen=True)
class Mechanism:
    """Coaxial bodies and the joints between them.

    Parameters
    ----------
    bodies : tuple of str
        Names in the order of the speeds in a state. The second body is the main body: it may come to rest and reverse,
        and laws of an angle act on it.
    couplings : tuple of Coupling
        The joints.
    """

    bodies: tuple[str, ...]
    couplings: tuple[Coupling, ...]

    @classmethod
    def of(cls, bodies: Sequence[str], joints: Mapping[str, Sequence[str]]) -> Mechanism:
        """Return the mechanism of `bodies`, the main body first; `joints` gives the two bodies of each joint."""
        main, second, *others = bodies
        couplings = (Coupling(name, *pair) for name, pair in joints.items())
        return cls((second, main, *others), tuple(couplings))

    @property
    def main(self) -> str:
        """The main body."""
        return self.bodies[MAIN]

    @cached_property
    def speeds(self) -> tuple[str, ...]:
        """The symbols of the speeds."""
        return tuple(map(speed_of, self.bodies))

    @cached_property
    def angles(self) -> tuple[str, ...]:
        """The symbols of the angles."""
        return tuple(map(angle_of, self.bodies))

    @cached_property
    def inertias(self) -> tuple[str, ...]:
        """The keys of the moments of inertia."""
        return tuple(map(inertia_of, self.bodies))

    @cached_property
    def joints(self) -> dict[str, Coupling]:
        """The joints by name."""
        return {c.name: c for c in self.couplings}

    def joints_of(self, body: str) -> int:
        """Return the number of joints of a body."""
        return sum(body in {c.first, c.second} for c in self.couplings)

    def short_names(self, site: str) -> dict[str, str]:
        """Return the symbols that the short names omega, psi and delta mean at a body or joint.

        Empty for a gyroscope.
        """
        if self == GYROSCOPE:
            return {}
        joint = self.joints.get(site)
        return {"omega": speed_of(site), "psi": angle_of(site)} if joint is None else {"delta": joint.delta}

    def shares(self, site: str) -> tuple[float, ...]:
        """Return the factor with which a torque at a body or joint acts on each body: 1, -1 or 0."""
        joint = self.joints.get(site)
        if joint is None:
            return tuple(float(b == site) for b in self.bodies)
        return tuple(float(b == joint.second) - float(b == joint.first) for b in self.bodies)

    @cached_property
    def sites(self) -> tuple[tuple[str, str], ...]:
        """The bodies, the main one first, and the joints, each with the symbol of its speed."""
        both = tuple(zip(self.bodies, self.speeds, strict=True))
        joints = ((c.name, c.delta) for c in self.couplings)
        return (both[MAIN], *both[:MAIN], *both[MAIN + 1 :], *joints)

    @property
    def main_angle(self) -> str:
        """The symbol of the angle of the main body."""
        return self.angles[MAIN]

    def motion(self, speeds: Iterable[Array]) -> dict[str, Array]:
        """Return the speeds of bodies and joints by symbol, from the speeds of the bodies in their order."""
        known = dict(zip(self.speeds, speeds, strict=True))
        first_second = (
            (c.delta, known[speed_of(c.first)], known[speed_of(c.second)]) for c in self.couplings
        )
        return known | {delta: first - second for delta, first, second in first_second}

    @cached_property
    def variables(self) -> dict[str, str]:
        """The variables of laws of this mechanism, with their units."""
        units = dict.fromkeys((*self.speeds, *(c.delta for c in self.couplings)), "s-1")
        return units | dict.fromkeys(self.angles, "1") | {c.tau: "N m" for c in self.couplings}

    @cached_property
    def bodies_by_symbol(self) -> dict[str, frozenset[str]]:
        """The bodies to which each body, joint or variable refers."""
        found = {
            name: frozenset({body})
            for body, *symbols in zip(self.bodies, self.speeds, self.angles, strict=True)
            for name in (body, *symbols)
        }
        return found | {
            name: frozenset({c.first, c.second}) for c in self.couplings for name in (c.name, c.delta, c.tau)
        }


GYROSCOPE = Mechanism(("rotor", "casing"), (Coupling(_BEARING, "rotor", "casing"),))


def renamed(text: str, symbols: Mapping[str, str]) -> str:
    """Return a formula with other symbols."""
    return re.sub(r"\b[A-Za-z]\w*", lambda m: symbols.get(m[0], m[0]), text)
