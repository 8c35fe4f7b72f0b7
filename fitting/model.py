"""A model: a set of effects, and the equations of motion that they make.

With the bearing torque tau (all laws between the bodies, times all factors),

    I_r d(omega_r)/dt = -tau + sum of the torques on the rotor
    I_c d(omega_c)/dt = +tau + sum of the torques on the casing

and one more equation for each effect that has a state of its own. The structure is frozen; numbers
travel beside it as a mapping from ``<effect>.<symbol>`` to a value.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitting.effects import GENERAL, LINEAR, REDUCED, Effect, find, read_effects, resolve
from fitting.effects.effect import Parameter
from fitting.errors import EffectError
from fitting.expression import latex

Array = NDArray[np.float64]

NAMED = {"reduced": REDUCED, "general": GENERAL, "linear": LINEAR}


@dataclass(frozen=True)
class Model:
    """A set of effects.

    Parameters
    ----------
    effects : tuple of Effect
        The effects, each once.
    """

    effects: tuple[Effect, ...]

    def __post_init__(self) -> None:
        names = [e.name for e in self.effects]
        if len(set(names)) != len(names):
            twice = next(n for n in names if names.count(n) > 1)
            raise EffectError(f"the effect {twice!r} is in the model twice")

    @classmethod
    def of(cls, names: str | Iterable[str]) -> Model:
        """Return the model of these effects of the library, or one of the paper's by its name.

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
        return cls(tuple(find(n) for n in names))

    def __add__(self, effect: Effect | str) -> Model:
        """Return the model with one more effect: by name, as a law (``"casing: -k*omega_c**3"``), or an `Effect`."""
        return self.with_effect(resolve(effect) if isinstance(effect, str) else effect)

    def __sub__(self, name: str) -> Model:
        """Return the model without the effect of this name."""
        return self.without(name)

    def __str__(self) -> str:
        return " + ".join(self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the effects."""
        return tuple(e.name for e in self.effects)

    def with_effect(self, effect: Effect) -> Model:
        """Return the model with one more effect."""
        return Model((*self.effects, effect))

    def without(self, name: str) -> Model:
        """Return the model without the effect of this name.

        Raises
        ------
        EffectError
            If it is not in the model.
        """
        if name not in self.names:
            raise EffectError(f"{name!r} is not in the model", "it has: " + ", ".join(self.names))
        return Model(tuple(e for e in self.effects if e.name != name))

    def with_fixed(self, values: Mapping[str, float]) -> Model:
        """Return the model with some parameters held at values instead of fitted.

        Parameters
        ----------
        values : mapping of str to float
            By key (``bearing.power.g``), or by symbol where only one parameter has it (``g``).

        Raises
        ------
        EffectError
            If a name is no parameter of the model, names several, or its value is not finite.
        """
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

    @property
    def alone(self) -> Model:
        """The part of it that a body without a partner has."""
        return Model(tuple(e for e in self.effects if e.alone))

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter by its key ``<effect>.<symbol>``."""
        return {f"{e.name}.{p.symbol}": p for e in self.effects for p in e.parameters}

    @cached_property
    def free(self) -> tuple[str, ...]:
        """The keys of the parameters that a fit may move, in order."""
        return tuple(f"{e.name}.{p.symbol}" for e in self.effects for p in e.free)

    @cached_property
    def constants(self) -> dict[str, float]:
        """The parameters that are never fitted, with their values."""
        return {k: p.start for k, p in self.parameters.items() if p.role == "fixed"}

    @cached_property
    def smooth(self) -> Model:
        """The physical effects that do not depend on an angle."""
        return Model(tuple(e for e in self.effects if e.moves and not e.depends_on_angle))

    @cached_property
    def rippling(self) -> tuple[Effect, ...]:
        """The physical effects that follow an angle."""
        return tuple(e for e in self.effects if e.moves and e.depends_on_angle)

    @cached_property
    def measurement(self) -> tuple[Effect, ...]:
        """What the cameras add to the angles."""
        return tuple(e for e in self.effects if not e.moves)

    def equations(self, *, single: bool = False) -> tuple[str, ...]:
        """Return the equations of motion as LaTeX: one line a body and the bearing, or that of a `single` body."""
        laws: dict[str, list[str]] = {"rotor": [], "casing": [], "bearing": [], "factor": []}
        for e in self.effects:
            if e.joint in laws:
                laws[e.joint].append(latex(e.expression))

        def join(terms: list[str]) -> str:
            return " ".join(t if t.startswith("-") else f"+ {t}" for t in terms).removeprefix("+ ")

        if single:
            return (rf"I_c \dot\omega_c = {join(laws['casing']) or '0'}",)
        tau = join(laws["bearing"]) or "0"
        if laws["factor"]:
            tau = rf"\left({tau}\right) " + " ".join(rf"\left({f}\right)" for f in laws["factor"])
        rotor = join([r"-\tau_{cr}", *laws["rotor"]])
        casing = join([r"\tau_{cr}", *laws["casing"]])
        return (rf"I_r \dot\omega_r = {rotor}", rf"I_c \dot\omega_c = {casing}", rf"\tau_{{cr}} = {tau}")


def _holding(effect: Effect, held: Mapping[str, float]) -> Effect:
    keys = {p.symbol: f"{effect.name}.{p.symbol}" for p in effect.parameters}
    if not any(k in held for k in keys.values()):
        return effect
    parameters = (
        replace(p, role="fixed", start=held[keys[p.symbol]]) if keys[p.symbol] in held else p
        for p in effect.parameters
    )
    return replace(effect, parameters=tuple(parameters))


def read_model(path: Path, own: Iterable[Effect] = ()) -> Model:
    """Read a model from a TOML file: ``effects = ["rotor.air.quadratic", ...]`` and ``[[effect]]`` tables.

    Raises
    ------
    EffectError
        If the file cannot be read, has no list of effects, or names one that is unknown.
    """
    try:
        with path.open("rb") as file:
            document = tomllib.load(file)
    except OSError as fault:
        raise EffectError(f"{path}: {fault.strerror or fault}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise EffectError(f"{path} is not a TOML file: {fault}") from None
    names = document.get("effects", [])
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        raise EffectError(
            f"{path}: effects must be a list of names", 'write: effects = ["bearing.linear", ...]'
        )
    declared = read_effects(path) if "effect" in document else []
    known = {e.name: e for e in (*own, *declared)}
    chosen = [known[n] if n in known else resolve(n) for n in names]
    chosen += [e for e in declared if e.name not in names]
    if not chosen:
        raise EffectError(f"{path} names no effect", 'write: effects = ["bearing.linear", ...]')
    return Model(tuple(chosen))
