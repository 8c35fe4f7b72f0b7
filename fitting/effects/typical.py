"""Values to begin with when nothing is measured: the paper's gyroscope, and a strength for any other effect."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from fitting.effects.effect import Effect
from fitting.expression import Tape

# table 5 of the paper, case 1, the reduced model on full data
PAPER = MappingProxyType(
    {
        "rotor.air.quadratic.a2": 9.97e-11,
        "touchpoint.constant.b1": 2.88e-6,
        "casing.air.linear.b2": 8.28e-7,
        "bearing.linear.d": 1.57e-7,
        "bearing.power.f": 1.26e-8,
        "bearing.power.g": 1.32,
        "rotor.air.linear.a1": 4.02e-8,
        "bearing.constant.c": 1.94e-6,
        "bearing.quadratic.e": 8.01e-11,
    }
)
INERTIA_ROTOR, INERTIA_CASING = 5.54e-5, 2.06e-5
_BUDGET = 1e-4


def typical_values(
    effect: Effect, share: float, *, duration: float, speeds: Mapping[str, float]
) -> dict[str, float]:
    """Return values of an effect's parameters so that it makes a given share of the torque budget.

    Parameters
    ----------
    effect : Effect
        The effect.
    share : float
        Its largest torque over the budget of 1e-4 N m, at typical speeds.
    duration : float
        Length of the recording [s], for time constants.
    speeds : mapping
        Typical omega_r and omega_c [rad/s].
    """
    values: dict[str, float] = {}
    for p in effect.parameters:
        if p.role == "shape":
            middle = p.grid[len(p.grid) // 2] if p.grid else p.start
            values[p.symbol] = middle * duration if p.relative else middle
        else:
            values[p.symbol] = 1.0 if p.role == "amplitude" else p.start
    amplitude = next(p.symbol for p in effect.parameters if p.role == "amplitude")
    at: dict[str, Any] = {
        **values,
        **speeds,
        "delta": speeds["omega_r"] - speeds["omega_c"],
        "t": duration,
        "temperature": 1.0,
        "chirp": 0.0,
        "psi_c": 1.0,
        "psi_r": 1.0,
        "psi": 1.0,
        "omega": speeds["omega_c"],
        "tau": _BUDGET,
    }
    if effect.joint == "inertia":
        values[amplitude] = share
        return {f"{effect.name}.{k}": v for k, v in values.items()}
    if effect.joint == "factor":
        # at full share the whole bearing torque changes by `share`, over the run or in the heat of friction
        heat = _BUDGET * at["delta"] * values.get("tau_T", duration) if effect.state else duration
        values[amplitude] = share / heat
        return {f"{effect.name}.{k}": v for k, v in values.items()}
    tape, unit = Tape([effect.expression]), 0.0
    for part in (0.05, 0.3, 1.0, 1.5):
        slower = {"omega_c": part * speeds["omega_c"], "omega": part * speeds["omega_c"]}
        unit = max(unit, abs(float(tape(at | slower)[0])))
    values[amplitude] = share * _BUDGET / unit if unit > 0 and math.isfinite(unit) else share * _BUDGET
    return {f"{effect.name}.{k}": v for k, v in values.items()}


def typical_of_model(
    effects: Iterable[Effect], share: float, *, duration: float, speeds: Mapping[str, float]
) -> dict[str, float]:
    """Return a value for each parameter of a model: the paper's where it has one, typical ones elsewhere.

    Parameters
    ----------
    effects : iterable of Effect
        What the model consists of.
    share, duration, speeds
        As for `typical_values`.
    """
    values: dict[str, float] = {}
    for effect in effects:
        values |= typical_values(effect, share, duration=duration, speeds=speeds)
    return values | {k: v for k, v in PAPER.items() if k in values}
