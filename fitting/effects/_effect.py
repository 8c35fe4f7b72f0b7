"""Effect: a torque law, the body or joint on which it acts, and its parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from fitting._errors import EffectError
from fitting.effects._dimension import Dimension, dimension, format_unit, parse_unit
from fitting.effects._expression import Expr, parse, symbols

Joint = Literal["rotor", "casing", "bearing", "factor", "inertia", "camera.casing", "camera.rotor"]
Kind = Literal["physical", "measurement"]
Role = Literal["amplitude", "shape", "phase", "fixed"]

# What a law may speak of, with its unit. `tau` is the whole bearing torque, for states that it feeds.
VARIABLES: dict[str, str] = {
    "t": "s",
    "omega_r": "s-1",
    "omega_c": "s-1",
    "psi_r": "1",
    "psi_c": "1",
    "delta": "s-1",
    "temperature": "K",
    "chirp": "1",
    "tau": "N m",
    "psi": "1",
    "omega": "s-1",
}
# shares of the record at which a law may set in, tried one by one
MOMENTS = tuple(round(0.04 + 0.02 * i, 3) for i in range(47))
_RESULT: dict[str, str] = {
    "rotor": "N m",
    "casing": "N m",
    "bearing": "N m",
    "factor": "1",
    "inertia": "1",
    "camera.casing": "1",
    "camera.rotor": "1",
}


@dataclass(frozen=True)
class Parameter:
    """A number in a law: symbol, SI unit, bounds, and how a start value is found.

    Parameters
    ----------
    symbol : str
        The paper's symbol where there is one.
    unit : str
        SI unit in the style of CF, such as ``N m s2``.
    role : {"amplitude", "shape", "phase", "fixed"}
        The law is linear in its amplitude, whose start value comes from a linear regression. A shape
        constant (a time, a speed, a power) starts on the best point of `grid`. A phase has sine and
        cosine columns. A fixed parameter enters only together with others and keeps `start`.
    lower, upper : float
        Bounds; friction is not negative.
    start : float
        Value before anything is known.
    grid : tuple of float
        Values of a shape constant to try.
    relative : bool
        The grid is in units of the length of the recording.
    meaning : str
        One line for people.
    """

    symbol: str
    unit: str
    role: Role = "amplitude"
    lower: float = 0.0
    upper: float = math.inf
    start: float = 0.0
    grid: tuple[float, ...] = ()
    relative: bool = False
    meaning: str = ""


@dataclass(frozen=True)
class State:
    """A quantity of an effect's own that evolves: its symbol, its rate of change, its value at the start."""

    symbol: str
    rate: str
    start: float = 0.0


@dataclass(frozen=True)
class Effect:
    """A law that acts on a body, between the bodies, or on what the camera sees.

    The law is written once as a formula. With joint ``rotor`` or ``casing`` it is the torque on that
    body; with ``bearing`` the torque +tau on the casing and -tau on the rotor; with ``factor`` it
    multiplies the whole bearing torque, with ``inertia`` the casing's acceleration; with
    ``camera.casing`` or ``camera.rotor`` it is an angle added to what that camera measures (psi and
    omega are then those of the body filmed).

    Parameters
    ----------
    name : str
        The name that commands take and answers give.
    joint : str
        Where it acts.
    law : str
        The formula.
    parameters : tuple of Parameter
        The numbers in it.
    kind : {"physical", "measurement"}
        A measurement effect is an artefact and never physics.
    signature : str
        How it shows in data.
    confused_with : tuple of str
        Effects that look alike, and when.
    source : str
        Where the law comes from.
    state : State or None
        A state of its own.
    breakpoint : str
        Symbol of a parameter that is a time at which the law jumps.
    """

    name: str
    joint: Joint
    law: str
    parameters: tuple[Parameter, ...]
    kind: Kind = "physical"
    signature: str = ""
    confused_with: tuple[str, ...] = ()
    source: str = ""
    state: State | None = None
    breakpoint: str = ""

    @cached_property
    def expression(self) -> Expr:
        """The law as a tree."""
        return parse(self.law)

    @cached_property
    def rate(self) -> Expr | None:
        """The rate of change of the effect's own state as a tree."""
        return parse(self.state.rate) if self.state else None

    @property
    def amplitude(self) -> Parameter | None:
        """The parameter in which the law is linear; None if it is linear in more than one or in none."""
        found = [p for p in self.parameters if p.role == "amplitude"]
        return found[0] if len(found) == 1 else None

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that a fit may move."""
        return tuple(p for p in self.parameters if p.role != "fixed")

    @property
    def moves(self) -> bool:
        """Whether it has a part in the motion, and not only in what a camera sees."""
        return not self.joint.startswith("camera.")

    @cached_property
    def alone(self) -> bool:
        """Whether a body without a partner can have it: it acts on the casing and speaks of nothing but that."""
        names = symbols(self.expression) | (symbols(self.rate) if self.rate is not None else set())
        return self.joint in {"casing", "camera.casing"} and not names & {"omega_r", "psi_r", "delta", "tau"}

    @cached_property
    def of_casing_speed(self) -> bool:
        """Whether it is a torque on the casing that follows nothing but the casing's speed."""
        own = {p.symbol for p in self.parameters}
        return self.joint == "casing" and self.rate is None and symbols(self.expression) - own == {"omega_c"}

    @cached_property
    def depends_on_angle(self) -> bool:
        """Whether the law follows the angle, so that it ripples once or more a turn."""
        names = symbols(self.expression)
        return bool(names & {"psi_r", "psi_c", "psi"})

    @property
    def swings(self) -> bool:
        """Whether it goes to and fro: with an angle, or at a phase of its own."""
        return self.depends_on_angle or any(p.role == "phase" for p in self.parameters)

    def check(self) -> None:
        """Check the law: names known, units right.

        Raises
        ------
        EffectError
            If a name in the law is unknown, or the law does not come out in its unit.
        """
        own = {p.symbol for p in self.parameters}
        used = symbols(self.expression) | (symbols(self.rate) if self.rate else set())
        unknown = used - own - set(VARIABLES)
        if unknown:
            raise EffectError(
                f"the law of {self.name!r} speaks of {', '.join(sorted(unknown))}, which it does not declare",
                "variables: " + ", ".join(VARIABLES),
            )
        exponents = {p.symbol: p.start for p in self.parameters if parse_unit_is_one(p.unit)}
        units: dict[str, Dimension] = {name: parse_unit(unit) for name, unit in VARIABLES.items()}
        units |= {p.symbol: parse_unit(p.unit, exponents) for p in self.parameters}
        result = dimension(self.expression, units, exponents)
        expected = parse_unit(_RESULT[self.joint])
        if any(abs(a - b) > 1e-9 for a, b in zip(result, expected, strict=True)):
            raise EffectError(
                f"the law of {self.name!r} comes out in {format_unit(result)}, not in {_RESULT[self.joint]}"
            )


def parse_unit_is_one(unit: str) -> bool:
    """Return whether a unit is that of a pure number."""
    return unit in {"1", "rad"}
