"""The equations of motion of a model with their derivatives, ready to evaluate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitting.effects import Effect
from fitting.expression import Expr, Tape, derivative
from fitting.expression.nodes import ONE, ZERO, call, div, mul, neg, sub, substitute, sym, symbols, total
from fitting.model import Model

Array = NDArray[np.float64]

INERTIA_ROTOR = "inertia.rotor"
INERTIA_CASING = "inertia.casing"
# the sense in which the casing turns: +1, -1, or 0 while friction holds it
SENSE = "sense"
_CASING = 1


class Dynamics:
    """The equations of motion of a model with their derivatives, ready to evaluate.

    Parameters
    ----------
    model : Model
        Measurement effects are left out: they do not move bodies.
    angles : bool
        Carry both angles as states, as laws that follow an angle need.

    Attributes
    ----------
    states : tuple of str
        ``omega_r, omega_c``, then states of effects, then the angles if asked for.
    parameters : tuple of str
        Keys of the parameters whose derivatives are given.
    dry : bool
        Whether a torque jumps where the casing stops: then rates are given for one sense of its motion.
    """

    def __init__(self, model: Model, *, angles: bool = False) -> None:
        physical = [e for e in model.effects if e.moves]
        own = [(e, e.state) for e in physical if e.state is not None]
        self.states = (
            "omega_r",
            "omega_c",
            *(s.symbol for _, s in own),
            *(("psi_r", "psi_c") if angles else ()),
        )
        self.start = tuple(s.start for _, s in own)
        self.parameters = tuple(f"{e.name}.{p.symbol}" for e in physical for p in e.free)
        self.breakpoints = tuple(f"{e.name}.{e.breakpoint}" for e in physical if e.breakpoint)
        self.constants = {
            k: v for k, v in model.constants.items() if k.rpartition(".")[0] in {e.name for e in physical}
        }
        rates = [_in_one_sense(rate) for rate in self._rates(physical)]
        self.dry = any(SENSE in symbols(rate) for rate in rates)
        if angles:
            rates += [sym("omega_r"), sym("omega_c")]
        outputs = list(rates)
        self._jacobian_at = self._collect(outputs, rates, self.states)
        self._sensitivity_at = self._collect(outputs, rates, self.parameters)
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

    def _rates(self, physical: list[Effect]) -> list[Expr]:
        laws: dict[str, list[Expr]] = {"rotor": [], "casing": [], "bearing": [], "factor": [], "inertia": []}
        difference = {"delta": sub(sym("omega_r"), sym("omega_c"))}
        own: list[Expr] = []
        for e in physical:
            rename = {p.symbol: sym(f"{e.name}.{p.symbol}") for p in e.parameters} | difference
            laws[e.joint].append(substitute(e.expression, rename))
        tau = total(laws["bearing"])
        for factor in laws["factor"]:
            tau = mul(tau, factor)
        for e in physical:
            if e.rate is not None:
                rename = (
                    {p.symbol: sym(f"{e.name}.{p.symbol}") for p in e.parameters} | difference | {"tau": tau}
                )
                own.append(substitute(e.rate, rename))
        inverse_rotor, inverse_casing = (div(ONE, sym(k)) for k in (INERTIA_ROTOR, INERTIA_CASING))
        rotor = mul(total([neg(tau), *laws["rotor"]]), inverse_rotor)
        casing = mul(total([tau, *laws["casing"]]), inverse_casing)
        for factor in laws["inertia"]:
            casing = mul(casing, factor)
        self.bearing_torque = tau
        return [rotor, casing, *own]

    def _values(self, t: Array, y: Array, numbers: Mapping[str, float]) -> dict[str, object]:
        values: dict[str, object] = {"t": t, **self.constants, **numbers}
        for i, name in enumerate(self.states):
            values[name] = y[..., i]
        return values

    def _sense(self, y: Array, sense: ArrayLike | None) -> Array:
        return np.asarray(np.sign(y[..., _CASING]) if sense is None else sense, dtype=np.float64)

    def rates(
        self, t: Array, y: Array, numbers: Mapping[str, float], sense: ArrayLike | None = None
    ) -> Array:
        """Return dy/dt, shaped like y.

        Parameters
        ----------
        t : ndarray
            Times [s].
        y : ndarray, shape (..., states)
            States at these times.
        numbers : mapping of str to float
            Parameters by key, and both inertias.
        sense : array_like, optional
            +1 or -1 where the casing turns that way, 0 where friction holds it; from y, if not given.
        """
        sense = self._sense(y, sense)
        outputs = self._rates_tape(self._values(t, y, numbers) | {SENSE: sense})
        f = np.empty(y.shape)
        for i, value in enumerate(outputs):
            f[..., i] = value
        if self.dry:
            f[..., _CASING] *= np.abs(sense)
        return f

    def tangent(
        self, t: Array, y: Array, numbers: Mapping[str, float], sense: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return dy/dt and its derivative by the states (..., n, n)."""
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
            f[..., _CASING] *= turning
            a[..., _CASING, :] *= turning[..., None]
        return f, a

    def linearised(
        self, t: Array, y: Array, numbers: Mapping[str, float], sense: ArrayLike | None = None
    ) -> tuple[Array, Array, Array]:
        """Return dy/dt, its derivative by the states (..., n, n) and by the parameters (..., n, p)."""
        sense = self._sense(y, sense)
        outputs = self._tape(self._values(t, y, numbers) | {SENSE: sense})
        f, a = self._tangent(outputs, y, sense)
        b = np.zeros((*y.shape, len(self.parameters)))
        for i, j, k in self._sensitivity_at:
            b[..., i, j] = outputs[k]
        if self.dry and not sense.all():
            b[..., _CASING, :] *= np.abs(sense)[..., None]
        return f, a, b


def _in_one_sense(rate: Expr) -> Expr:
    """Return a rate with sign(omega_c) as a number given beside the state, so that it is smooth through rest."""
    if rate == call("sign", sym("omega_c")):
        return sym(SENSE)
    if rate.op in {"num", "sym"}:
        return rate
    return Expr(rate.op, tuple(_in_one_sense(a) for a in rate.args))
