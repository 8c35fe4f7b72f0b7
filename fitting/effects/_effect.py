"""Effect: a torque law, the body or joint on which it acts, and its parameters.

The unit of every torque law is the newton metre. A dimension is a vector of exponents of (kg, m, s, K, A, V); radians
and pixels count as 1. The volt is a base unit here, so that N m V-1 can be proposed as the unit of the constant of a
motor. If an exponent is a parameter (the g of a power law), its value must be given to determine the dimension.

A law may depend on recorded inputs. In formulas, inputs have separate symbols (`input_symbol`), so that an input may
have the name of a variable or a parameter.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, cast

from fitting._errors import EffectError, ExpressionError, RecordError
from fitting.effects._expression import FUNCTIONS, Expr, parse, substitute, sym, symbols
from fitting.effects._mechanism import GYROSCOPE, MAIN, Mechanism, renamed

Dimension = tuple[float, ...]

_SYMBOLS = ("kg", "m", "s", "K", "A", "V")
NONE: Dimension = (0.0,) * len(_SYMBOLS)
"""Exponents of the dimension of a pure number [1]. Derived: zero for each of the base units kg, m, s, K, A and V."""
_BASE: dict[str, Dimension] = {
    "1": NONE, "rad": NONE, "px": NONE, "N": (1, 1, -2, 0, 0, 0), "J": (1, 2, -2, 0, 0, 0),
} | {name: (*NONE[:i], 1.0, *NONE[i + 1 :]) for i, name in enumerate(_SYMBOLS)}  # fmt: skip
"""Exponents of kg, m, s, K, A and V in each unit [1]. Source: the International System of Units; the volt is a base
unit here."""
_TOKEN = re.compile(r"^([A-Za-z]+|1)(?:\^?(-?[0-9.]+|-?[a-z]))?$")
_TOLERANCE = 1e-9
"""Largest difference between exponents of units that counts as a rounding error [1]. Chosen: a smaller value refuses
sums of decimal exponents, a larger one accepts wrong units."""


def parse_unit(unit: str, exponents: Mapping[str, float] | None = None) -> Dimension:
    """Return the dimension of a unit like ``N m s2``, ``K-1`` or ``N m s^g``.

    A part of a unit is one of kg, m, s, K, A, V, N, J, rad, px, 1 and may have an exponent. An ExpressionError names a
    part that has another form.
    """
    result = NONE
    for token in unit.split():
        match = _TOKEN.match(token)
        if match is None or match[1] not in _BASE:
            raise ExpressionError(f"{token!r} in {unit!r} is not a unit", "write, for example: N m s2")
        exponent = match[2] or "1"
        value = (exponents or {}).get(exponent.removeprefix("-"))
        sign = -1.0 if exponent.startswith("-") else 1.0
        try:
            n = float(exponent) if value is None else sign * value
            result = _times(result, _to_power(_BASE[match[1]], n))
        except ValueError:
            raise ExpressionError(f"the exponent of {token!r} in {unit!r} is not a number") from None
    return result


def format_unit(dimension: Dimension) -> str:
    """Return a dimension as a unit, with N m factored out if the unit is then shorter, for example ``N m s2``."""
    kg, m, s, *others = dimension
    parts = []
    if abs(kg - 1) < _TOLERANCE and abs(m - 2) < _TOLERANCE:
        parts, kg, m, s = ["N", "m"], 0.0, 0.0, s + 2
    for name, exponent in zip(_SYMBOLS, (kg, m, s, *others), strict=True):
        if abs(exponent) > _TOLERANCE:
            parts.append(name if abs(exponent - 1) < _TOLERANCE else f"{name}{exponent:g}")
    return " ".join(parts) or "1"


def dimension(e: Expr, units: Mapping[str, Dimension], exponents: Mapping[str, float]) -> Dimension:
    """Return the dimension of an expression, given the `units` of its symbols and the values of symbols in `exponents`.

    An ExpressionError is raised if quantities of different units are added, or the argument of a function has a unit.
    """
    if e.op == "num":
        return NONE
    if e.op == "sym":
        return units[e.name]
    parts = [dimension(a, units, exponents) for a in e.args]
    if e.op == "add":
        if not _same(parts[0], parts[1]):
            raise ExpressionError(
                f"quantities of unlike units are added: {format_unit(parts[0])} and {format_unit(parts[1])}"
            )
        return parts[0]
    if e.op == "mul":
        return _times(parts[0], parts[1])
    if e.op == "pow":
        return _to_power(parts[0], _exponent(e.args[1], exponents))
    if e.op == "abs":
        return parts[0]
    if e.op == "sqrt":
        return _to_power(parts[0], 0.5)
    if e.op not in {"sign", "heaviside"} and not _same(parts[0], NONE):
        raise ExpressionError(f"the argument of {e.op} has the unit {format_unit(parts[0])}")
    return NONE


def _exponent(e: Expr, exponents: Mapping[str, float]) -> float:
    if e.op == "num":
        return e.value
    if e.op == "sym" and e.name in exponents:
        return exponents[e.name]
    if e.op in {"add", "mul"}:
        a, b = (_exponent(x, exponents) for x in e.args)
        return a + b if e.op == "add" else a * b
    raise ExpressionError("an exponent must be a number or a parameter without a unit")


def _same(a: Dimension, b: Dimension) -> bool:
    return all(abs(x - y) < _TOLERANCE for x, y in zip(a, b, strict=True))


def _times(a: Dimension, b: Dimension) -> Dimension:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def quotient(a: Dimension, b: Dimension) -> Dimension:
    """Return the dimension of a / b."""
    return _times(a, _to_power(b, -1.0))


def _to_power(a: Dimension, n: float) -> Dimension:
    return tuple(x * n for x in a)


Joint = Literal[
    "rotor", "casing", "bearing", "contact", "factor", "inertia", "input", "camera.casing", "camera.rotor"
]
Kind = Literal["physical", "measurement"]
Role = Literal["amplitude", "shape", "phase", "fixed"]
Scale = Literal["", "speed", "length", "chirp"]

# The variables of a law, with their units. `tau` is the whole bearing torque; states of effects may depend on `tau`.
# `deflection` is the angle of the casing, or of the single body, from its equilibrium. In a contact with the ratio n,
# `slip` is omega_r - n omega_c, and `inertia_slip` is the effective inertia 1 / (1 / I_r + n^2 / I_c). `torque_held` is
# the torque of the contact on the rotor that keeps the slip constant under all other torques.
VARIABLES: dict[str, str] = {
    "t": "s", "omega_r": "s-1", "omega_c": "s-1", "psi_r": "1", "psi_c": "1", "deflection": "1",
    "delta": "s-1", "temperature": "K", "chirp": "1", "strain": "1", "tau": "N m", "lag": "s-1", "psi": "1",
    "omega": "s-1", "bristle": "1", "element_a": "1", "element_b": "1",
}  # fmt: skip
# Variables of laws in a contact only.
_CONTACT_VARIABLES: dict[str, str] = {"slip": "s-1", "inertia_slip": "kg m2", "torque_held": "N m"}
# variables that laws of users must not contain; inputs may have these names
NOT_FOR_USERS = frozenset(
    {"temperature", "chirp", "strain", "tau", "psi", "omega", "lag", "bristle", "element_a", "element_b"}
)


def variables_of(mechanism: Mechanism) -> dict[str, str]:
    """Return the variables of laws about the bodies of a mechanism, with their units."""
    if mechanism == GYROSCOPE:
        return VARIABLES
    # the deflection is a variable of a single body only, because only a single body may oscillate
    absent = {*GYROSCOPE.variables, "deflection"}
    return {k: u for k, u in VARIABLES.items() if k not in absent} | mechanism.variables


_INPUT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}")
_INPUT, _SLOPE = "input.", "slope."


def slope_symbol(symbol: str) -> str:
    """Return the symbol of the time derivative of a recorded input."""
    return f"{_SLOPE}{symbol}"


def input_symbol(name: str) -> str:
    """Return the symbol of a recorded input in the expression of a law."""
    return f"{_INPUT}{name}"


def is_input_symbol(symbol: str) -> bool:
    """Return whether a symbol of a law is a recorded input."""
    return symbol.startswith(_INPUT)


def refuse_input_name(name: str) -> None:
    """Raise a RecordError if a name cannot be the name of an input in a law."""
    what = f"{str(name)[:40]!r} cannot be the name of an input"
    if not isinstance(name, str) or not _INPUT_NAME.fullmatch(name):
        raise RecordError(what, "use letters, digits and underscores, beginning with a letter")
    if name in {*FUNCTIONS, "pi", *(set(VARIABLES) - NOT_FOR_USERS)}:
        raise RecordError(
            f"{what}: it has another meaning in laws", "choose another name, for example current"
        )


MOMENTS = tuple(round(0.04 + 0.02 * i, 3) for i in range(47))
"""Trial changepoints, as shares of the length of the recording [1]. Chosen: steps of 0.02, except at the ends, where a
change is equivalent to a different initial value; with fewer, a fit starts far from the optimum; with more, the search
takes longer."""
# joints whose law is a torque; laws of other joints are numbers
TORQUES: tuple[Joint, ...] = ("rotor", "casing", "bearing", "contact")
# symbol of the ratio omega_r / omega_c of a contact without slip
RATIO = "n"
_CAMERAS: dict[Joint, Literal["casing", "rotor"]] = {"camera.casing": "casing", "camera.rotor": "rotor"}


THE_ROTOR, THE_CASING = frozenset({"rotor"}), frozenset({"casing"})
# bodies affected by the laws that act neither on a single body of a gyroscope nor in the bearing
_BODIES: dict[str, frozenset[str]] = {
    "camera.rotor": THE_ROTOR,
    "camera.casing": THE_CASING,
    **dict.fromkeys(("contact", "factor", "inertia"), THE_ROTOR | THE_CASING),
}
# body or joint of a gyroscope on which a factor or an inertia acts
_SITES = {"factor": "bearing", "inertia": "casing"}


def bodies_of(joint: str, variables: Iterable[str], mechanism: Mechanism = GYROSCOPE) -> frozenset[str]:
    """Return the bodies on which a law with this joint acts, and the bodies whose variables are in the law."""
    known = _BODIES | mechanism.bodies_by_symbol if mechanism == GYROSCOPE else mechanism.bodies_by_symbol
    return frozenset().union(*(known.get(name, frozenset()) for name in (joint, *variables)))


@dataclass(frozen=True)
class Parameter:
    """A number in a law: symbol, SI unit, bounds, and the source of its initial value.

    Parameters
    ----------
    symbol : str
        The paper's symbol if there is one.
    unit : str
        SI unit in the style of CF, for example ``N m s2``.
    role : {"amplitude", "shape", "phase", "fixed"}
        The law is linear in its amplitude; a linear regression gives the initial value of the amplitude. The initial
        value of a shape constant (a time, a speed, an exponent) is the best point of `grid`. A law with a phase has one
        column for the sine and one for the cosine. A fixed parameter is never fitted and keeps `start`.
    lower, upper : float
        Bounds [unit]; friction is not negative.
    start : float
        Initial value if the data do not determine one [unit].
    grid : tuple of float
        Trial values of a shape constant [unit, or lengths of the recording].
    relative : bool
        Whether the grid is in lengths of the recording.
    scale : {"", "speed", "length", "chirp"}
        Unit of the bounds, of `start` and of the grid: "speed" is the largest speed of the body, "length" is the length
        of the recording, "chirp" is the quotient of these two, "" is `unit`.
    meaning : str
        One line of description.
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
    scale: Scale = ""

    def at(self, speed: float, length: float) -> Parameter:
        """Return the parameter with values in `unit`, for recordings of this largest speed [rad/s] and length [s]."""
        if not self.scale:
            return self
        unit = {"speed": speed, "length": length, "chirp": speed / length}[self.scale]
        return replace(
            self,
            lower=self.lower * unit,
            upper=self.upper * unit,
            start=self.start * unit,
            grid=tuple(v * unit for v in self.grid),
            scale="",
        )


@dataclass(frozen=True)
class State:
    """A state variable that belongs to an effect: its symbol, its rate of change, its initial value."""

    symbol: str
    rate: str
    start: float = 0.0


@dataclass(frozen=True, repr=False)
class Effect:
    """A law that acts on a body, between the bodies, or on the angles that a camera measures.

    The law is written once, as a formula. The joint determines its meaning:

    - ``rotor`` or ``casing``: the torque on this body;
    - ``bearing``: the torque +tau on the casing and -tau on the rotor;
    - ``contact`` (rims that touch, gears, a belt): the torque tau on the rotor and -n tau on the casing, where n is the
      ratio of the contact;
    - ``factor``: a factor of the whole bearing torque;
    - ``inertia``: a factor of the acceleration of the casing;
    - ``camera.casing`` or ``camera.rotor``: an angle added to the angles that the camera measures; psi and omega are
      then the angle and the speed of the filmed body;
    - ``input``: the dead time of a recorded input.

    All properties of an effect are fields or properties of this class. No code depends on the name of an effect, so a
    new law is one entry of the library.

    Parameters
    ----------
    name : str
        The name in commands and results.
    joint : str
        The body or joint on which the law acts.
    law : str
        The formula, in SI units.
    parameters : tuple of Parameter
        The numbers in the law.
    kind : {"physical", "measurement"}
        A measurement effect is an error of the set-up or of a camera.
    signature : str
        The signature of the effect in the data.
    confused_with : tuple of str
        Effects of similar shape.
    source : str
        Origin of the law.
    state, second : State or None
        State variables of the law; the second does not depend on the first.
    breakpoint : str
        Symbol of the parameter that is a changepoint: the time at which the law jumps.
    per_case : bool
        Whether the effect has, by default, separate parameters in each case of a fit.
    per_surface : bool
        Whether the parameters depend on the surface under the touch point, which may differ between recordings.
    nuisance : bool
        Whether the effect is always fitted, as a nuisance effect.
    equivalent : tuple of str
        Effects that a usual recording does not separate from this effect.
    searched : bool
        Whether the effect is a candidate of every search. A contact between bodies is not a candidate, because it is
        visible on the apparatus. Laws that only few motions distinguish from simpler laws are not candidates either.
    contact : bool
        Whether the effect is friction whose states depend on the angle since the last reversal. A body that turns in
        one sense slides after a small angle; from then on, the law is a function of the speed.
    rigid : bool
        Whether the effect is a contact without slip: its law contains torque_held, and the initial speed of one body
        follows from the initial speed of the other body.
    inputs : tuple of (str, str)
        Names and units of the recorded inputs in the law.
    words : str
        The name in words, for example "quadratic air drag of the casing".
    mechanism : Mechanism
        The bodies and joints of the law: by default a gyroscope, or the bodies and joints of another case.
    place : str
        The body or joint of the mechanism on which the law acts, if `joint` does not name it.
    pattern : str
        Name of the law in the library if the law was rewritten for `place`; otherwise empty.
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
    per_case: bool = False
    per_surface: bool = False
    nuisance: bool = False
    equivalent: tuple[str, ...] = ()
    searched: bool = True
    rigid: bool = False
    inputs: tuple[tuple[str, str], ...] = ()
    second: State | None = None
    contact: bool = False
    words: str = ""
    mechanism: Mechanism = GYROSCOPE
    place: str = ""
    pattern: str = ""

    def __repr__(self) -> str:
        units = ", ".join(f"{p.symbol} [{p.unit}]" for p in self.parameters)
        law = "" if self.law in self.name else f": {self.law}"
        return f"Effect {self.name}{law}; {units}"

    @cached_property
    def expression(self) -> Expr:
        """The law as a tree."""
        return with_input_symbols(parse(self.law), [name for name, _ in self.inputs])

    @cached_property
    def rate(self) -> Expr | None:
        """The rate of change of the state variable as a tree."""
        if self.state is None:
            return None
        return with_input_symbols(parse(self.state.rate), [name for name, _ in self.inputs])

    @property
    def site(self) -> str:
        """The body or joint on which the law acts."""
        return self.place or _SITES.get(self.joint, self.joint)

    @property
    def kind_of_law(self) -> str:
        """The name of the law in the library, regardless of the body or joint on which it acts."""
        return self.pattern or self.name

    @property
    def states(self) -> tuple[State, ...]:
        """The state variables of the law."""
        return tuple(s for s in (self.state, self.second) if s is not None)

    @cached_property
    def rates(self) -> tuple[Expr, ...]:
        """The rates of change of the state variables as trees."""
        names = [name for name, _ in self.inputs]
        return tuple(with_input_symbols(parse(s.rate), names) for s in self.states)

    @property
    def amplitude(self) -> Parameter | None:
        """The parameter in which the law is linear; None if there is no such parameter, or more than one."""
        found = [p for p in self.parameters if p.role == "amplitude"]
        return found[0] if len(found) == 1 else None

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that a fit varies."""
        return tuple(p for p in self.parameters if p.role != "fixed")

    @property
    def camera(self) -> Literal["casing", "rotor"] | None:
        """The body whose measured angles the effect changes; None for an effect of the motion."""
        return _CAMERAS.get(self.joint)

    @property
    def mechanical(self) -> bool:
        """Whether the effect is a term of the equations of motion."""
        return self.camera is None

    @cached_property
    def bodies(self) -> frozenset[str]:
        """The bodies on which the effect acts or depends.

        The effect does not apply to cases in which one of these bodies is missing.
        """
        site = self.place or self.joint
        return bodies_of(site, symbols(self.expression).union(*map(symbols, self.rates)), self.mechanism)

    @cached_property
    def depends_on_angle(self) -> bool:
        """Whether the law is a function of an angle: a harmonic of psi."""
        return not symbols(self.expression).isdisjoint((*self.mechanism.angles, "psi"))

    @cached_property
    def about_equilibrium(self) -> Effect:
        """The law for an oscillating body: its angle is measured from the equilibrium and is a state of the motion.

        A response linearised about the measured angle does not suffice, because a change of the frequency accumulates
        to a large error of the phase over a hundred periods.
        """
        angle = self.mechanism.main_angle
        if not self.mechanical or angle not in symbols(self.expression):
            return self
        return replace(self, law=renamed(self.law, {angle: "deflection"}))

    def parameters_at(self, speeds: Mapping[str, float], length: float) -> tuple[Parameter, ...]:
        """Return the parameters for recordings with these largest speeds [rad/s], by symbol, and this length [s]."""
        used = symbols(self.expression).union(*map(symbols, self.rates))
        main = self.mechanism.speeds[MAIN]
        symbol = next((s for s in self.mechanism.speeds if s in used and s != main), main)
        return tuple(p.at(speeds[symbol], length) for p in self.parameters)

    @cached_property
    def restoring(self) -> bool:
        """Whether the law depends on the angle from equilibrium, like a torque that causes an oscillation."""
        return "deflection" in symbols(self.expression)

    @property
    def periodic(self) -> bool:
        """Whether the law is a function of an angle, or a sinusoid with a phase."""
        return self.depends_on_angle or any(p.role == "phase" for p in self.parameters)

    def check(self) -> None:
        """Check names and units of the law.

        Raises
        ------
        EffectError
            If a name in the law is unknown, or the law has a wrong unit.
        """
        own = {p.symbol for p in self.parameters}
        used = symbols(self.expression).union(*map(symbols, self.rates))
        variables = variables_of(self.mechanism) | (_CONTACT_VARIABLES if self.joint == "contact" else {})
        variables |= {input_symbol(name): unit for name, unit in self.inputs}
        own_states = (s.symbol for s in self.states if self.place)
        variables |= {name: VARIABLES[name.removesuffix(f"_{self.place}")] for name in own_states}
        unknown = used - own - set(variables)
        if self.joint == "contact" and RATIO not in own:
            raise EffectError(f"{self.name!r} acts in a contact but has no ratio {RATIO}", f"declare {RATIO}")
        if unknown:
            raise EffectError(
                f"the law of {self.name!r} has undeclared names: {', '.join(sorted(unknown))}",
                "variables: " + ", ".join(variables),
            )
        exponents = {p.symbol: p.start for p in self.parameters if p.unit in {"1", "rad"}}
        units: dict[str, Dimension] = {name: parse_unit(unit) for name, unit in variables.items()}
        units |= {p.symbol: parse_unit(p.unit, exponents) for p in self.parameters}
        result = dimension(self.expression, units, exponents)
        unit = "N m" if self.joint in TORQUES else "s" if self.joint == "input" else "1"
        if not _same(result, parse_unit(unit)):
            raise EffectError(f"the law of {self.name!r} has the unit {format_unit(result)}, not {unit}")


def mechanism_of(effects: Iterable[Effect]) -> Mechanism:
    """Return the mechanism of some effects; without effects, the mechanism of a gyroscope."""
    return next((e.mechanism for e in effects), GYROSCOPE)


def at_site(
    name: str, site: str, law: str, parameters: tuple[Parameter, ...], mechanism: Mechanism, **more: Any
) -> Effect:
    """Return a law at a body or a joint of a mechanism."""
    if mechanism == GYROSCOPE:
        return Effect(name, cast("Joint", site), law, parameters, **more)
    joint: Joint = "bearing" if site in mechanism.joints else "casing"
    return Effect(name, joint, law, parameters, mechanism=mechanism, place=site, **more)


def with_input_symbols(expression: Expr, names: Iterable[str]) -> Expr:
    """Return an expression in which the names of inputs are replaced by their symbols (`input_symbol`)."""
    return substitute(expression, {name: sym(input_symbol(name)) for name in names})
