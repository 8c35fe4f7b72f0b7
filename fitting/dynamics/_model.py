"""A model: a set of effects, its equations of motion, and their derivatives.

The torque tau_j of each joint j is the sum of all torque laws between its two bodies, multiplied by all effects that
are declared as factors of this joint. This torque drives the second body and brakes the first body. The equations of
motion are

    I_b d(omega_b)/dt = sum of the torques on the body b + sum of tau_j (b second) - sum of tau_j (b first),

and there is one more equation for each effect with its own state. In a gyroscope the rotor is the first and the casing
the second body of the bearing. A model cannot be changed after it is made, and it contains no values of free
parameters. Values are passed separately, as a mapping from ``<effect>.<symbol>`` to a value.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitting._arguments import NUMBERS, TEXT, Kind, require
from fitting._errors import EffectError, EstimationError
from fitting._numbers import on_screen
from fitting.dynamics._inputs import Input
from fitting.effects._effect import RATIO, Effect, Parameter, slope_symbol
from fitting.effects._expression import (
    ONE,
    ZERO,
    Expr,
    Tape,
    add,
    call,
    derivative,
    div,
    latex,
    mul,
    neg,
    nodes,
    sub,
    substitute,
    sym,
    symbols,
    total,
)
from fitting.effects._instances import counterparts
from fitting.effects._library import GENERAL, LINEAR, REDUCED
from fitting.effects._mechanism import GYROSCOPE, MAIN, Coupling, Mechanism, inertia_of
from fitting.effects._user import read_effects, read_toml, resolve

Array = NDArray[np.float64]

NAMED = {"reduced": REDUCED, "general": GENERAL, "linear": LINEAR}


_EFFECTS = Kind(
    "a list of effects",
    lambda x: all(hasattr(e, "name") for e in x),
    'use Model.of(["air.linear"]) for names',
)


@dataclass(frozen=True, repr=False)
class Model:
    """A set of effects.

    Parameters
    ----------
    effects : tuple of Effect
        The effects, each once.
    mechanism : Mechanism
        The bodies and joints of the model. If the model has effects, their mechanism is used instead of this argument.
    """

    effects: tuple[Effect, ...]
    mechanism: Mechanism = field(default=GYROSCOPE, compare=False)

    def __post_init__(self) -> None:
        require("effects", self.effects, _EFFECTS)
        for effect in self.effects:
            if effect.mechanism != self.effects[0].mechanism:
                raise EffectError(
                    f"{self.effects[0].name} and {effect.name} are laws of different bodies",
                    "build the model with case.model(...): it gives all laws the bodies of this case",
                )
            object.__setattr__(self, "mechanism", effect.mechanism)
        names = [e.name for e in self.effects]
        if len(set(names)) != len(names):
            twice = next(n for n in names if names.count(n) > 1)
            raise EffectError(f"the effect {twice!r} is in the model twice")

    @classmethod
    def of(cls, names: str | Iterable[str], mechanism: Mechanism = GYROSCOPE) -> Model:
        """Return the model of some effects of the library, or a model of the paper by its name.

        Parameters
        ----------
        names : str or iterable of str
            "reduced", "general" or "linear"; or names of effects.
        mechanism : Mechanism
            The bodies of the model. In a chain, the first body has the laws of the casing, all other bodies have the
            laws of the rotor, and every joint has the laws of the bearing.

        Raises
        ------
        EffectError
            If a name is not known.
        """
        if isinstance(names, str):
            if names not in NAMED:
                raise EffectError(f"there is no model named {names[:60]!r}", "models: " + ", ".join(NAMED))
            names = NAMED[names]
        names = tuple(names) if isinstance(names, Iterable) else names
        require("names", names, TEXT.several)
        return cls(tuple(e for n in names for e in counterparts(n, mechanism)), mechanism)

    def __add__(self, effect: Effect | str) -> Model:
        """Return the model with one more effect: a name, a law (``"casing: -k*omega_c**3"``), or an `Effect`."""
        return self.with_effect(resolve(effect) if isinstance(effect, str) else effect)

    def __sub__(self, name: str) -> Model:
        """Return the model without the effect of this name."""
        return self.without(name)

    def __str__(self) -> str:
        return " + ".join(self.names)

    def __repr__(self) -> str:
        return on_screen(["Model", *(f"  {e!r}" for e in self.effects)])

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the effects."""
        return tuple(e.name for e in self.effects)

    def with_effect(self, effect: Effect) -> Model:
        """Return the model with one more effect.

        Parameters
        ----------
        effect : Effect
            A law of the library (`fitting.effect`) or your own.
        """
        return Model((*self.effects, effect))

    def without(self, name: str) -> Model:
        """Return the model without an effect.

        Parameters
        ----------
        name : str
            Name of the effect.

        Raises
        ------
        EffectError
            If the effect is not in the model.
        """
        require("name", name, TEXT)
        if name not in self.names:
            raise EffectError(f"{name!r} is not in the model", "it has: " + ", ".join(self.names))
        return self.with_only(e for e in self.effects if e.name != name)

    def with_only(self, effects: Iterable[Effect]) -> Model:
        """Return a model with the bodies of this model and only these effects."""
        return Model(tuple(effects), self.mechanism)

    def with_fixed(self, values: Mapping[str, float]) -> Model:
        """Return the model with some parameters held at given values.

        Parameters
        ----------
        values : mapping of str to float
            Values in SI units by key (``bearing.power.g``), or by symbol (``g``) if only one parameter has the symbol.

        Raises
        ------
        EffectError
            If a name belongs to no free parameter or to several, or a value is not finite.
        """
        require("values", values, NUMBERS)
        held: dict[str, float] = {}
        for name, value in values.items():
            keys = [k for k in self.free if k == name or k.rpartition(".")[2] == name]
            if len(keys) != 1:
                many = "several parameters of the model are", "give the whole key; keys: "
                none = "no parameter of the model that can be fitted is", "it has: "
                what, hint = many if keys else none
                raise EffectError(f"{what} named {name[:60]!r}", hint + ", ".join(keys or self.free))
            if not np.isfinite(value):
                raise EffectError(
                    f"{name[:60]} cannot be held at {value}", "give a finite number, in SI units"
                )
            held[keys[0]] = float(value)
        return self.with_only(_holding(e, held) for e in self.effects)

    def of_bodies(self, bodies: Set[str]) -> Model:
        """Return the model without the effects that act on, or depend on, a body that is not in `bodies`."""
        return self.with_only(e for e in self.effects if e.bodies <= bodies)

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter by its key ``<effect>.<symbol>``."""
        return {f"{e.name}.{p.symbol}": p for e in self.effects for p in e.parameters}

    @cached_property
    def free(self) -> tuple[str, ...]:
        """The keys of the parameters that a fit may vary, in the order of the effects."""
        return tuple(f"{e.name}.{p.symbol}" for e in self.effects for p in e.free)

    @cached_property
    def per_case(self) -> tuple[str, ...]:
        """The keys of the parameters that by default have a separate value for each case."""
        return tuple(f"{e.name}.{p.symbol}" for e in self.effects if e.per_case for p in e.free)

    @cached_property
    def constants(self) -> dict[str, float]:
        """The parameters that are never fitted, with their values."""
        return {k: p.start for k, p in self.parameters.items() if p.role == "fixed"}

    @cached_property
    def smooth(self) -> Model:
        """The model with only the physical effects whose torque is a function of the states of the motion.

        If a torque restores an equilibrium, the deflection of the casing is a state.
        """
        physical = (e.about_equilibrium if self.restoring else e for e in self.effects if e.mechanical)
        return self.with_only(e for e in physical if not e.depends_on_angle)

    @cached_property
    def angle_dependent(self) -> tuple[Effect, ...]:
        """The physical effects that depend on an angle, if this angle is not a state of the motion."""
        names = self.smooth.names
        return tuple(e for e in self.effects if e.mechanical and e.name not in names)

    @cached_property
    def restoring(self) -> bool:
        """Whether a torque restores an equilibrium of the casing; the deflection is then a state of the motion."""
        return any(e.restoring for e in self.effects if e.mechanical)

    @cached_property
    def rigid_contact(self) -> Effect | None:
        """The contact in which the bodies roll on each other without slip; None if there is none."""
        return next((e for e in self.effects if e.rigid), None)

    @cached_property
    def measurement(self) -> tuple[Effect, ...]:
        """The effects of the cameras on the measured angles."""
        return tuple(e for e in self.effects if not e.mechanical)

    def refuse_chain(self, what: str, instead: str) -> None:
        """Raise an EstimationError if the model is a chain, for which `what` is not available; `instead` is a hint."""
        if self.mechanism != GYROSCOPE:
            raise EstimationError(f"{what} is not available for several bodies with joints", instead)

    def equations(self, bodies: Set[str] | None = None) -> tuple[str, ...]:
        """Return the equations of motion as LaTeX, one line for each body and one for the torque of each joint.

        Parameters
        ----------
        bodies : set of str, optional
            The bodies that the case has, for example "rotor" and "casing"; by default the bodies of the mechanism.
        """
        mechanism = self.mechanism
        present = mechanism.bodies if bodies is None else bodies
        laws: dict[str, list[str]] = {site: [] for site in (*mechanism.bodies, *mechanism.joints, "contact")}
        factors: dict[str, list[str]] = {site: [] for site in mechanism.joints}
        for e in self.effects:
            kind = factors if e.joint == "factor" else laws
            if e.site in kind and e.joint != "inertia":
                kind[e.site].append(latex(e.expression))

        def join(terms: list[str]) -> str:
            return " ".join(t if t.startswith("-") else f"+ {t}" for t in terms).removeprefix("+ ")

        lines, torques = [], []
        used = [
            c
            for c in mechanism.couplings
            if {c.first, c.second} <= {*present} and (laws[c.name] or not laws["contact"])
        ]
        for joint in used:
            tau = join(laws[joint.name]) or "0"
            if factors[joint.name]:
                scale = " ".join(rf"\left({f}\right)" for f in factors[joint.name])
                tau = rf"\left({tau}\right) {scale}"
            torques.append(f"{_tau(joint)} = {tau}")
        for i, body in enumerate(mechanism.bodies):
            of_joints = [_tau(c) if c.second == body else f"-{_tau(c)}" for c in used if body in c[1:]]
            total_torque = join([*of_joints, *laws[body], *(laws["contact"] if i == 0 else [])])
            if i == MAIN:
                total_torque += "".join(rf" - n \left({c}\right)" for c in laws["contact"])
            name = mechanism.speeds[i].removeprefix("omega_")
            name = name if len(name) == 1 else rf"\mathrm{{{name}}}"
            if body in present:
                lines.append(rf"I_{name} \dot\omega_{name} = {total_torque or '0'}")
        return (*lines, *torques)


def _tau(joint: Coupling) -> str:
    """Return the symbol of the torque of a joint as LaTeX."""
    return r"\tau_{cr}" if joint.tau == "tau" else rf"\tau_\mathrm{{{joint.name}}}"


def _holding(effect: Effect, held: Mapping[str, float]) -> Effect:
    keys = {p.symbol: f"{effect.name}.{p.symbol}" for p in effect.parameters}
    if not any(k in held for k in keys.values()):
        return effect
    parameters = (
        replace(p, role="fixed", start=held[keys[p.symbol]]) if keys[p.symbol] in held else p
        for p in effect.parameters
    )
    return replace(effect, parameters=tuple(parameters))


def read_model(
    path: Path, own: Iterable[Effect] = (), inputs: Iterable[Input] = (), mechanism: Mechanism = GYROSCOPE
) -> Model:
    """Return the model in a TOML file: ``effects = ["rotor.air.quadratic", ...]`` and ``[[effect]]`` tables.

    The list ``effects`` contains names of the library, names of the effects `own` and laws ``body: law``; laws may
    contain the recorded `inputs`. They act on the bodies of the `mechanism`.
    """
    document = read_toml(path)
    names = document.get("effects", [])
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        raise EffectError(
            f"{path}: effects must be a list of names", 'write: effects = ["bearing.linear", ...]'
        )
    declared = read_effects(path, mechanism) if "effect" in document else []
    known = {e.name: e for e in (*own, *declared)}
    units = {i.name: i.unit for i in inputs}
    chosen = [known[n] if n in known else resolve(n, units, mechanism) for n in names]
    chosen += [e for e in declared if e.name not in names]
    if not chosen:
        raise EffectError(f"{path} names no effect", 'write: effects = ["bearing.linear", ...]')
    return Model(tuple(chosen))


INERTIA_ROTOR, INERTIA_CASING = map(inertia_of, GYROSCOPE.bodies)
# sense of rotation of the main body: +1, -1, or 0 while friction holds it
SENSE = "sense"


class Dynamics:
    """The equations of motion of a model and their derivatives, compiled for evaluation.

    If `angles` is True, the angles are states too. Laws that depend on an angle require this. Measurement effects are
    left out: they do not change the motion. `states` are the speeds of the bodies of the `mechanism` (``omega_r,
    omega_c``), then ``deflection`` if a torque depends on it, then states of effects, then the angles. The initial
    values of the first `free_starts` states are parameters of each recording. States of effects start at declared
    values. `ratio` is the key of the ratio of a contact without slip; the initial omega_r is then this ratio times the
    initial omega_c. If `dry`, a torque jumps where the main body (the casing) stops, and the rates are evaluated for
    one sense of its motion. All other bodies are assumed to keep their sense of rotation. `inputs` are the inputs of
    the recording.
    """

    def __init__(self, model: Model, *, angles: bool = False, inputs: Iterable[Input] = ()) -> None:
        physical = [e for e in model.effects if e.mechanical]
        self.mechanism = mechanism = model.mechanism
        # number of speeds in a state
        self.speeds = len(mechanism.speeds)
        used = {name for e in physical for name, _ in e.inputs}
        self.inputs = tuple(i for i in inputs if i.name in used)
        # key of the dead time of each input: `delays` is indexed by the name of the input, `self._delays` by its symbol
        delays = {
            e.inputs[0][0]: f"{e.name}.{e.parameters[0].symbol}" for e in physical if e.joint == "input"
        }
        self._delays = {i.symbol: delays[i.name] for i in self.inputs if i.name in delays}
        own = [(e, s) for e in physical for s in e.states]
        restoring = any(e.restoring for e in physical)
        self.free_starts = self.speeds + restoring
        self.states = (
            *mechanism.speeds,
            *(("deflection",) if restoring else ()),
            *(s.symbol for _, s in own),
            *(mechanism.angles if angles else ()),
        )
        self.start = tuple(s.start for _, s in own)
        rigid = model.rigid_contact
        self.ratio = None if rigid is None else f"{rigid.name}.{RATIO}"
        self.relaxation = "" if rigid is None else f"{rigid.name}.T"
        # states that are constant while friction holds the main body
        self._held = slice(MAIN, MAIN + 1) if rigid is None else slice(0, MAIN + 1)
        self.parameters = tuple(f"{e.name}.{p.symbol}" for e in physical for p in e.free)
        self.breakpoints = tuple(f"{e.name}.{e.breakpoint}" for e in physical if e.breakpoint)
        self.constants = {
            k: v for k, v in model.constants.items() if k.rpartition(".")[0] in {e.name for e in physical}
        }
        self._equations = rates = [self._in_one_sense(rate) for rate in self._rates(physical)]
        self.dry = any(SENSE in symbols(rate) for rate in rates)
        if angles:
            rates = [*rates, *map(sym, mechanism.speeds)]
        outputs = list(rates)
        self._jacobian_at = self._collect(outputs, rates, self.states)
        self._sensitivity_at = self._collect(outputs, rates, self.parameters)
        self._sensitivity_at += self._collect_delays(outputs, rates)
        self._tape = Tape(outputs)
        self._tangent_tape = Tape(outputs[: len(rates) + len(self._jacobian_at)])
        self._rates_tape = Tape(rates)

    @staticmethod
    def _collect(
        outputs: list[Expr], rates: list[Expr], names: tuple[str, ...]
    ) -> list[tuple[int, int, int]]:
        places = []
        for i, rate in enumerate(rates):
            for j, name in enumerate(names):
                slope = derivative(rate, name)
                if slope != ZERO:
                    places.append((i, j, len(outputs)))
                    outputs.append(slope)
        return places

    def _collect_delays(self, outputs: list[Expr], rates: list[Expr]) -> list[tuple[int, int, int]]:
        """Return the indices (rate, parameter, output) of each derivative with respect to a dead time T.

        At times at which the input u does not jump, d(rate)/dT = -d(rate)/du du/dt.
        """
        places = []
        for symbol, key in self._delays.items():
            if key not in self.parameters:
                continue
            for i, rate in enumerate(rates):
                slope = mul(neg(derivative(rate, symbol)), sym(slope_symbol(symbol)))
                if slope != ZERO:
                    places.append((i, self.parameters.index(key), len(outputs)))
                    outputs.append(slope)
        return places

    def _rates(self, physical: list[Effect]) -> list[Expr]:
        mechanism = self.mechanism
        physical = [e for e in physical if e.joint != "input"]
        laws: dict[str, list[Expr]] = {site: [] for site in (*mechanism.bodies, *mechanism.joints)}
        factors: dict[str, list[Expr]] = {site: [] for site in laws}
        inverse = {b: div(ONE, sym(key)) for b, key in zip(mechanism.bodies, mechanism.inertias, strict=True)}
        speed = {b: sym(s) for b, s in zip(mechanism.bodies, mechanism.speeds, strict=True)}
        differences = {c.delta: sub(speed[c.first], speed[c.second]) for c in mechanism.couplings}
        own: list[Expr] = []
        contacts: list[tuple[Expr, Expr, Expr]] = []
        for e in physical:
            rename = {p.symbol: sym(f"{e.name}.{p.symbol}") for p in e.parameters} | differences
            if e.joint != "contact":
                kind = factors if e.joint in {"factor", "inertia"} else laws
                kind[e.site].append(substitute(e.expression, rename))
                continue
            n, (rotor, casing) = rename[RATIO], mechanism.bodies
            rename["slip"] = sub(speed[rotor], mul(n, speed[casing]))
            rename["inertia_slip"] = div(ONE, total([inverse[rotor], mul(mul(n, n), inverse[casing])]))
            contacts.append((n, rename["inertia_slip"], substitute(e.expression, rename)))
        # torque of each joint, by its symbol
        self.joint_torques = {}
        for joint in mechanism.couplings:
            tau = total(laws[joint.name])
            for factor in factors[joint.name]:
                tau = mul(tau, factor)
            self.joint_torques[joint.tau] = tau
        for e in physical:
            if e.rates:
                rename = {p.symbol: sym(f"{e.name}.{p.symbol}") for p in e.parameters} | differences
                own += [substitute(rate, rename | self.joint_torques) for rate in e.rates]
        rates = {}
        for body in mechanism.bodies:
            of_joints = [self.joint_torques[c.tau] for c in mechanism.couplings if c.second == body]
            of_joints += [neg(self.joint_torques[c.tau]) for c in mechanism.couplings if c.first == body]
            rates[body] = mul(total([*of_joints, *laws[body]]), inverse[body])
        for n, inertia, law in contacts:
            rotor, casing = mechanism.bodies
            torque = substitute(law, {"torque_held": mul(inertia, sub(mul(n, rates[casing]), rates[rotor]))})
            rates[rotor] = add(rates[rotor], mul(torque, inverse[rotor]))
            rates[casing] = sub(rates[casing], mul(mul(n, torque), inverse[casing]))
        for body in mechanism.bodies:
            for factor in factors[body]:
                rates[body] = mul(rates[body], factor)
        deflection = [speed[mechanism.main]] if self.free_starts > self.speeds else []
        return [*rates.values(), *deflection, *own]

    def _in_one_sense(self, rate: Expr) -> Expr:
        """Return a rate in which the sign of the speed of the main body is a separate symbol.

        With a fixed value of this symbol, the rate is smooth where the body stops.
        """
        sign = call("sign", sym(self.mechanism.speeds[MAIN]))
        new: dict[int, Expr] = {}
        for node in nodes(rate):
            args = tuple(new[id(a)] for a in node.args)
            new[id(node)] = sym(SENSE) if node == sign else Expr(node.op, args) if args else node
        return new[id(rate)]

    def _values(self, t: Array, y: Array, numbers: Mapping[str, float]) -> dict[str, object]:
        states = {name: y[..., i] for i, name in enumerate(self.states)}
        values = {"t": t, **self.constants, **numbers, **states}
        for i in self.inputs:
            if i.symbol not in self._delays:
                values[i.symbol] = i(t)
                continue
            late = self._delay(i, numbers)
            values |= {i.symbol: i(t, late), slope_symbol(i.symbol): i.slope(t, late)}
        return values

    def _delay(self, i: Input, numbers: Mapping[str, float]) -> float:
        key = self._delays.get(i.symbol)
        return 0.0 if key is None else float((self.constants | dict(numbers))[key])

    def changes(self, first: float, last: float, numbers: Mapping[str, float]) -> tuple[float, ...]:
        """Return the times between `first` and `last` at which an input changes its value or slope [s]."""
        found = [i.changes(first, last, self._delay(i, numbers)) for i in self.inputs]
        return tuple(np.unique(np.concatenate(found)).tolist()) if found else ()

    def moving_breaks(
        self, first: float, last: float, numbers: Mapping[str, float]
    ) -> dict[str, list[float]]:
        """Return the times of jumps of a torque that a free parameter shifts, by the key of this parameter [s].

        These times are changepoints. If the dead time of an input is free and the input is constant between its samples
        (interpolation "hold"), its steps between `first` and `last` are included.
        """
        found = {k: [numbers[k]] for k in self.breakpoints if k in self.parameters}
        for i in self.inputs:
            key = self._delays.get(i.symbol)
            if key in self.parameters and i.interpolation == "hold":
                found[str(key)] = i.changes(first, last, self._delay(i, numbers)).tolist()
        return found

    def by_input(self, i: Input, t: Array, y: Array, numbers: Mapping[str, float]) -> Array:
        """Return the derivative of the accelerations of the bodies with respect to an input, (times, bodies)."""
        slopes = Tape([derivative(rate, i.symbol) for rate in self._equations[: self.speeds]])
        values = self._values(t, y, numbers) | {SENSE: self._sense(y, None)}
        return np.stack([np.asarray(s) * np.ones(len(t)) for s in slopes(values)], axis=1)

    def by_delay(self, name: str, t: Array, edges: Array, y: Array, numbers: Mapping[str, float]) -> Array:
        """Return the derivative of the accelerations with respect to the dead time of an input, (cells, bodies).

        The derivative is -d(rate)/du du/dt at the times `t`; du/dt is the mean between the edges of each cell.
        """
        i = next(i for i in self.inputs if i.name == name)
        change = np.diff(i(edges, self._delay(i, numbers))) / np.diff(edges)
        return -self.by_input(i, t, y, numbers) * change[:, None]

    @cached_property
    def first_order(self) -> tuple[Expr, dict[str, Expr]] | None:
        """Return the decay rate of the main body's speed [1/s] and its acceleration per unit of each input.

        The response is linear and of first order: d(omega_c)/dt = -decay omega_c + sum of slope times input + terms
        that depend neither on omega_c nor on an input. None if the response has another form.
        """
        motion = {*self.states, "t", *(i.symbol for i in self.inputs)}
        rate, main = self._equations[MAIN], self.mechanism.speeds[MAIN]
        decay = neg(derivative(rate, main))
        slopes = {i.name: derivative(rate, i.symbol) for i in self.inputs}
        coupled = any(derivative(rate, s) != ZERO for s in self.states if s != main)
        if coupled or decay == ZERO or not slopes or any(e == ZERO for e in slopes.values()):
            return None
        # the response is not linear if a coefficient depends on the motion, the time or an input
        if any(symbols(e) & motion for e in (decay, *slopes.values())):
            return None
        return decay, slopes

    def constraint(self, numbers: Mapping[str, float]) -> Array | None:
        """Return the matrix (2, 2) that maps accelerations without contact to accelerations of rolling bodies.

        Torques tau_r and tau_c give omega_c' = (tau_c + n tau_r) / (I_c + n^2 I_r) and omega_r' = n omega_c'.
        n is the ratio of the contact. None if the bodies may slip.
        """
        if self.ratio is None:
            return None
        n, rotor, casing = numbers[self.ratio], numbers[INERTIA_ROTOR], numbers[INERTIA_CASING]
        return np.outer([n, 1.0], [n * rotor, casing]) / (casing + n**2 * rotor)

    def _sense(self, y: Array, sense: ArrayLike | None) -> Array:
        return np.asarray(np.sign(y[..., MAIN]) if sense is None else sense, dtype=np.float64)

    def rates(
        self, t: Array, y: Array, numbers: Mapping[str, float], sense: ArrayLike | None = None
    ) -> Array:
        """Return dy/dt, with the shape of y (..., states).

        `sense` is the sense of rotation of the main body: +1 or -1, or 0 where friction holds the body. By default it
        follows from y.
        """
        sense = self._sense(y, sense)
        outputs = self._rates_tape(self._values(t, y, numbers) | {SENSE: sense})
        f = np.empty(y.shape)
        for i, value in enumerate(outputs):
            f[..., i] = value
        if self.dry:
            f[..., self._held] *= np.abs(sense)[..., None]
        return f

    def tangent(
        self, t: Array, y: Array, numbers: Mapping[str, float], sense: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return dy/dt and its derivative with respect to the n states, shape (..., n, n)."""
        sense = self._sense(y, sense)
        outputs = self._tangent_tape(self._values(t, y, numbers) | {SENSE: sense})
        return self._tangent(outputs, y, sense)

    def _tangent(self, outputs: Sequence[Any], y: Array, sense: Array) -> tuple[Array, Array]:
        n = len(self.states)
        f = np.empty(y.shape)
        for i in range(n):
            f[..., i] = outputs[i]
        a = np.zeros((*y.shape, n))
        for i, j, k in self._jacobian_at:
            a[..., i, j] = outputs[k]
        if self.dry and not sense.all():
            turning = np.abs(sense)
            f[..., self._held] *= turning[..., None]
            a[..., self._held, :] *= turning[..., None, None]
        return f, a

    def linearised(
        self, t: Array, y: Array, numbers: Mapping[str, float], sense: ArrayLike | None = None
    ) -> tuple[Array, Array, Array]:
        """Return dy/dt and its derivatives with respect to the states (..., n, n) and the parameters (..., n, p)."""
        sense = self._sense(y, sense)
        outputs = self._tape(self._values(t, y, numbers) | {SENSE: sense})
        f, a = self._tangent(outputs, y, sense)
        b = np.zeros((*y.shape, len(self.parameters)))
        for i, j, k in self._sensitivity_at:
            b[..., i, j] = outputs[k]
        if self.dry and not sense.all():
            b[..., self._held, :] *= np.abs(sense)[..., None, None]
        return f, a, b
