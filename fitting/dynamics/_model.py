"""A model: a set of effects, its equations of motion, and their derivatives.

The equations of motion are

    I_r d(omega_r)/dt = -tau + sum of the torques on the rotor,
    I_c d(omega_c)/dt = +tau + sum of the torques on the casing,

where the bearing torque tau is the sum of the laws between the bodies, multiplied by all factors. Each state of an
effect adds one equation. A model is immutable and contains no values of fitted parameters; these are passed separately
as a mapping from ``<effect>.<symbol>`` to a value.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitting._arguments import NUMBERS, TEXT, Kind, require
from fitting._errors import EffectError
from fitting._numbers import on_screen
from fitting.dynamics._inputs import Input
from fitting.effects._effect import RATIO, THE_CASING, THE_ROTOR, Effect, Parameter, bodies_of, slope_symbol
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
from fitting.effects._library import GENERAL, LINEAR, REDUCED, find
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
    """

    effects: tuple[Effect, ...]

    def __post_init__(self) -> None:
        require("effects", self.effects, _EFFECTS)
        names = [e.name for e in self.effects]
        if len(set(names)) != len(names):
            twice = next(n for n in names if names.count(n) > 1)
            raise EffectError(f"the effect {twice!r} is in the model twice")

    @classmethod
    def of(cls, names: str | Iterable[str]) -> Model:
        """Return the model of some effects of the library, or a model of the paper by its name.

        Parameters
        ----------
        names : str or iterable of str
            "reduced", "general" or "linear"; or names of effects.

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
        return cls(tuple(find(n) for n in names))

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
        return Model(tuple(e for e in self.effects if e.name != name))

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
                what = "several parameters" if keys else "no parameter that could be fitted"
                raise EffectError(f"{name[:60]!r} is {what} of the model", "it has: " + ", ".join(self.free))
            if not np.isfinite(value):
                raise EffectError(
                    f"{name[:60]} cannot be held at {value}", "give a finite number, in SI units"
                )
            held[keys[0]] = float(value)
        return Model(tuple(_holding(e, held) for e in self.effects))

    def of_bodies(self, bodies: Set[str]) -> Model:
        """Return the model of the effects that act on, and depend on, these bodies of the library only."""
        return Model(tuple(e for e in self.effects if e.bodies <= bodies))

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
        """The model of the physical effects whose torque is a function of the states of the motion.

        If a torque restores an equilibrium, the deflection of the casing is a state.
        """
        physical = (e.about_equilibrium if self.restoring else e for e in self.effects if e.mechanical)
        return Model(tuple(e for e in physical if not e.depends_on_angle))

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

    def equations(self, bodies: Set[str] = THE_ROTOR | THE_CASING) -> tuple[str, ...]:
        """Return the equations of motion as LaTeX, one line for each body and one for the bearing torque.

        Parameters
        ----------
        bodies : set of str
            The bodies of the library that the case has: "rotor", "casing".
        """
        laws: dict[str, list[str]] = {"rotor": [], "casing": [], "bearing": [], "factor": [], "contact": []}
        for e in self.effects:
            if e.joint in laws:
                laws[e.joint].append(latex(e.expression))

        def join(terms: list[str]) -> str:
            return " ".join(t if t.startswith("-") else f"+ {t}" for t in terms).removeprefix("+ ")

        tau = join(laws["bearing"]) or "0"
        if laws["factor"]:
            tau = rf"\left({tau}\right) " + " ".join(rf"\left({f}\right)" for f in laws["factor"])
        bearing = bodies_of("bearing", ()) <= bodies and (bool(laws["bearing"]) or not laws["contact"])
        rotor = join([*([r"-\tau_{cr}"] if bearing else []), *laws["rotor"], *laws["contact"]])
        casing = join([*([r"\tau_{cr}"] if bearing else []), *laws["casing"]])
        casing += "".join(rf" - n \left({c}\right)" for c in laws["contact"])
        sums = {"rotor": rf"I_r \dot\omega_r = {rotor}", "casing": rf"I_c \dot\omega_c = {casing or '0'}"}
        lines = tuple(line for body, line in sums.items() if body in bodies)
        return (*lines, rf"\tau_{{cr}} = {tau}") if bearing else lines


def _holding(effect: Effect, held: Mapping[str, float]) -> Effect:
    keys = {p.symbol: f"{effect.name}.{p.symbol}" for p in effect.parameters}
    if not any(k in held for k in keys.values()):
        return effect
    parameters = (
        replace(p, role="fixed", start=held[keys[p.symbol]]) if keys[p.symbol] in held else p
        for p in effect.parameters
    )
    return replace(effect, parameters=tuple(parameters))


def read_model(path: Path, own: Iterable[Effect] = (), inputs: Iterable[Input] = ()) -> Model:
    """Return the model in a TOML file: ``effects = ["rotor.air.quadratic", ...]`` and ``[[effect]]`` tables.

    The list ``effects`` contains names of the library, names of the effects `own` and laws ``body: law``; laws may
    contain the recorded `inputs`.
    """
    document = read_toml(path)
    names = document.get("effects", [])
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        raise EffectError(
            f"{path}: effects must be a list of names", 'write: effects = ["bearing.linear", ...]'
        )
    declared = read_effects(path) if "effect" in document else []
    known = {e.name: e for e in (*own, *declared)}
    units = {i.name: i.unit for i in inputs}
    chosen = [known[n] if n in known else resolve(n, units) for n in names]
    chosen += [e for e in declared if e.name not in names]
    if not chosen:
        raise EffectError(f"{path} names no effect", 'write: effects = ["bearing.linear", ...]')
    return Model(tuple(chosen))


INERTIA_ROTOR = "inertia.rotor"
INERTIA_CASING = "inertia.casing"
# symbol of the sense of rotation of the casing: +1, -1, or 0 while friction holds the casing
SENSE = "sense"
_CASING = 1
"""Index of the speed of the casing in a state vector [1]. Derived: a state begins with omega_r and omega_c."""


class Dynamics:
    """The equations of motion of a model and their derivatives, compiled for evaluation.

    With `angles`, both angles are states, for laws of an angle. Measurement effects are ignored, because they do not
    change the motion. `inputs` contains the inputs of the recording.

    `states` contains ``omega_r, omega_c``, then ``deflection`` if a torque restores an equilibrium, then the states of
    effects, then the angles. The initial values of the first `free_starts` states are parameters of the recording.
    `ratio` is the key of the ratio of a contact without slip; the initial omega_r is then ratio times the initial
    omega_c. `dry` states that a torque jumps when the casing stops; rates are then given for one sense of rotation.
    """

    def __init__(self, model: Model, *, angles: bool = False, inputs: Iterable[Input] = ()) -> None:
        physical = [e for e in model.effects if e.mechanical]
        used = {name for e in physical for name, _ in e.inputs}
        self.inputs = tuple(i for i in inputs if i.name in used)
        # key of the dead time of each input, first by name, then by symbol
        delays = {
            e.inputs[0][0]: f"{e.name}.{e.parameters[0].symbol}" for e in physical if e.joint == "input"
        }
        self._delays = {i.symbol: delays[i.name] for i in self.inputs if i.name in delays}
        own = [(e, s) for e in physical for s in e.states]
        restoring = any(e.restoring for e in physical)
        self.free_starts = 3 if restoring else 2
        self.states = (
            "omega_r",
            "omega_c",
            *(("deflection",) if restoring else ()),
            *(s.symbol for _, s in own),
            *(("psi_r", "psi_c") if angles else ()),
        )
        self.start = tuple(s.start for _, s in own)
        rigid = model.rigid_contact
        self.ratio = None if rigid is None else f"{rigid.name}.{RATIO}"
        self.relaxation = "" if rigid is None else f"{rigid.name}.T"
        # states that are constant while friction holds the casing
        self._held = slice(_CASING, _CASING + 1) if rigid is None else slice(0, _CASING + 1)
        self.parameters = tuple(f"{e.name}.{p.symbol}" for e in physical for p in e.free)
        self.breakpoints = tuple(f"{e.name}.{e.breakpoint}" for e in physical if e.breakpoint)
        self.constants = {
            k: v for k, v in model.constants.items() if k.rpartition(".")[0] in {e.name for e in physical}
        }
        self._equations = rates = [_in_one_sense(rate) for rate in self._rates(physical)]
        self.dry = any(SENSE in symbols(rate) for rate in rates)
        if angles:
            rates = [*rates, sym("omega_r"), sym("omega_c")]
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
        """Return the places (rate, parameter, output) of the derivatives with respect to the dead times T.

        d(rate)/dT = -d(rate)/du du/dt, where the input u does not jump.
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
        physical = [e for e in physical if e.joint != "input"]
        laws: dict[str, list[Expr]] = {j: [] for j in ("rotor", "casing", "bearing", "factor", "inertia")}
        inverse_rotor, inverse_casing = (div(ONE, sym(k)) for k in (INERTIA_ROTOR, INERTIA_CASING))
        difference = {"delta": sub(sym("omega_r"), sym("omega_c"))}
        own: list[Expr] = []
        contacts: list[tuple[Expr, Expr, Expr]] = []
        for e in physical:
            rename = {p.symbol: sym(f"{e.name}.{p.symbol}") for p in e.parameters} | difference
            if e.joint != "contact":
                laws[e.joint].append(substitute(e.expression, rename))
                continue
            n = rename[RATIO]
            rename["slip"] = sub(sym("omega_r"), mul(n, sym("omega_c")))
            rename["inertia_slip"] = div(ONE, total([inverse_rotor, mul(mul(n, n), inverse_casing)]))
            contacts.append((n, rename["inertia_slip"], substitute(e.expression, rename)))
        tau = total(laws["bearing"])
        for factor in laws["factor"]:
            tau = mul(tau, factor)
        for e in physical:
            if e.rates:
                rename = (
                    {p.symbol: sym(f"{e.name}.{p.symbol}") for p in e.parameters} | difference | {"tau": tau}
                )
                own += [substitute(rate, rename) for rate in e.rates]
        rotor = mul(total([neg(tau), *laws["rotor"]]), inverse_rotor)
        casing = mul(total([tau, *laws["casing"]]), inverse_casing)
        for n, inertia, law in contacts:
            torque = substitute(law, {"torque_held": mul(inertia, sub(mul(n, casing), rotor))})
            rotor = add(rotor, mul(torque, inverse_rotor))
            casing = sub(casing, mul(mul(n, torque), inverse_casing))
        for factor in laws["inertia"]:
            casing = mul(casing, factor)
        self.bearing_torque = tau
        return [rotor, casing, *([sym("omega_c")] if self.free_starts > 2 else []), *own]

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
        """Return the times of the jumps of a torque that depend on a free parameter [s], by the key of the parameter.

        These are changepoints, and the steps of held inputs between `first` and `last` if a dead time is free.
        """
        found = {k: [numbers[k]] for k in self.breakpoints if k in self.parameters}
        for i in self.inputs:
            key = self._delays.get(i.symbol)
            if key in self.parameters and i.interpolation == "hold":
                found[str(key)] = i.changes(first, last, self._delay(i, numbers)).tolist()
        return found

    def by_input(self, i: Input, t: Array, y: Array, numbers: Mapping[str, float]) -> Array:
        """Return the derivative of the accelerations of rotor and casing with respect to an input, (times, 2)."""
        slopes = Tape([derivative(rate, i.symbol) for rate in self._equations[:2]])
        values = self._values(t, y, numbers) | {SENSE: self._sense(y, None)}
        return np.stack([np.asarray(s) * np.ones(len(t)) for s in slopes(values)], axis=1)

    def by_delay(self, name: str, t: Array, edges: Array, y: Array, numbers: Mapping[str, float]) -> Array:
        """Return the derivative of the accelerations with respect to the dead time of an input, (cells, 2).

        The derivative is -d(rate)/du du/dt at the times `t`; du/dt is the mean between the edges of each cell.
        """
        i = next(i for i in self.inputs if i.name == name)
        change = np.diff(i(edges, self._delay(i, numbers))) / np.diff(edges)
        return -self.by_input(i, t, y, numbers) * change[:, None]

    @cached_property
    def first_order(self) -> tuple[Expr, dict[str, Expr]] | None:
        """Decay rate of the speed of the casing [1/s] and its acceleration per unit of each input, as expressions.

        The response is linear and of first order: d(omega_c)/dt = -decay omega_c + sum of slope times input + terms
        that depend on neither. None if the response has another form.
        """
        motion = {*self.states, "t", *(i.symbol for i in self.inputs)}
        rate = self._equations[_CASING]
        decay = neg(derivative(rate, "omega_c"))
        slopes = {i.name: derivative(rate, i.symbol) for i in self.inputs}
        coupled = any(derivative(rate, s) != ZERO for s in self.states if s != "omega_c")
        if coupled or decay == ZERO or not slopes or any(e == ZERO for e in slopes.values()):
            return None
        # the response is not linear if a coefficient depends on the motion, the time or an input
        if any(symbols(e) & motion for e in (decay, *slopes.values())):
            return None
        return decay, slopes

    def constraint(self, numbers: Mapping[str, float]) -> Array | None:
        """Return the matrix (2, 2) from the accelerations of free bodies to those of bodies that roll on each other.

        Torques tau_r and tau_c give omega_c' = (tau_c + n tau_r) / (I_c + n^2 I_r) and omega_r' = n omega_c'.
        None if the bodies may slip.
        """
        if self.ratio is None:
            return None
        n, rotor, casing = numbers[self.ratio], numbers[INERTIA_ROTOR], numbers[INERTIA_CASING]
        return np.outer([n, 1.0], [n * rotor, casing]) / (casing + n**2 * rotor)

    def _sense(self, y: Array, sense: ArrayLike | None) -> Array:
        return np.asarray(np.sign(y[..., _CASING]) if sense is None else sense, dtype=np.float64)

    def rates(
        self, t: Array, y: Array, numbers: Mapping[str, float], sense: ArrayLike | None = None
    ) -> Array:
        """Return dy/dt, with the shape of y (..., states).

        `sense` is the sense of rotation of the casing, +1 or -1, or 0 while friction holds the casing; by default the
        sign of omega_c in y.
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


def _in_one_sense(rate: Expr) -> Expr:
    """Return a rate in which the symbol `SENSE` replaces sign(omega_c), so that the rate is smooth through rest."""
    sign = call("sign", sym("omega_c"))
    new: dict[int, Expr] = {}
    for node in nodes(rate):
        args = tuple(new[id(a)] for a in node.args)
        new[id(node)] = sym(SENSE) if node == sign else Expr(node.op, args) if args else node
    return new[id(rate)]
