"""Variables in which the valley of the fit is straight.

A law d x^m and a power law f x^g on the same body have a curved valley in (d, f, g): near g = m both are the same.
With X = x / x_ref they read T1 X^m + K (X^g - X^m) / (g - m), where T1 is the torque at x_ref and K its curvature:

    T1 = d x_ref^m + f x_ref^g,    K = (g - m) f x_ref^g.

So it is for the bearing's d D + f D^g, with m = 1, and for any power law that a user adds to a law of fixed power.
A power law without such a one beside it has the torque F = f x_ref^g for f. Where d or f is held at a bound, the other
is replaced by T1, which the data know well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fitting.effects import Effect
from fitting.effects.effect import Parameter
from fitting.estimation.layout import Layout
from fitting.expression import Tape

Array = NDArray[np.float64]

# closer to m the two terms cancel too many digits; the torque itself hardly changes from here to m
_NEAREST = 3e-3
_SAME = 1e-9


@dataclass(frozen=True)
class Valley:
    """A power law, alone (d is None) or beside a law of fixed power m: places among the variables, x_ref, and m.

    `held` tells which of d and f stays what it is.
    """

    d: int | None
    f: int
    g: int
    reference: float
    order: float = 1.0
    held: Literal["", "d", "f"] = ""


def to_physical(u: Array, valleys: Sequence[Valley]) -> tuple[Array, Array]:
    """Return (d, f, g, ...) and their derivatives by (T1, K, g, ...)."""
    theta, slope = u.copy(), np.eye(len(u))
    for v in valleys:
        if v.d is None:
            full = v.reference ** u[v.g]
            theta[v.f] = u[v.f] / full
            slope[v.f, v.f] = 1 / full
            slope[v.f, v.g] = -theta[v.f] * np.log(v.reference)
            continue
        if v.held:
            _beside_held(theta, slope, u, v, v.d)
            continue
        t1, curvature, g = u[v.d], u[v.f], _away(u[v.g], v.order)
        beyond, full, unit = g - v.order, v.reference**g, v.reference**v.order
        theta[v.g] = g
        theta[v.f] = curvature / (beyond * full)
        theta[v.d] = (t1 - curvature / beyond) / unit
        slope[v.f, v.f] = 1 / (beyond * full)
        slope[v.f, v.g] = -theta[v.f] * (1 / beyond + np.log(v.reference))
        slope[v.d, v.d] = 1 / unit
        slope[v.d, v.f] = -1 / (beyond * unit)
        slope[v.d, v.g] = curvature / (beyond**2 * unit)
    return theta, slope


def _beside_held(theta: Array, slope: Array, u: Array, v: Valley, d: int) -> None:
    full, unit = v.reference ** u[v.g], v.reference**v.order
    if v.held == "d":
        theta[v.f] = (u[v.f] - u[d] * unit) / full
        slope[v.f, v.f], slope[v.f, d] = 1 / full, -unit / full
        slope[v.f, v.g] = -theta[v.f] * np.log(v.reference)
    else:
        theta[d] = (u[d] - u[v.f] * full) / unit
        slope[d, d], slope[d, v.f] = 1 / unit, -full / unit
        slope[d, v.g] = -u[v.f] * full / unit * np.log(v.reference)


def from_physical(theta: Array, valleys: Sequence[Valley]) -> Array:
    """Return (T1, K, g, ...) from (d, f, g, ...)."""
    u = theta.copy()
    for v in valleys:
        if v.d is None:
            u[v.f] = theta[v.f] * v.reference ** theta[v.g]
            continue
        if v.held:
            u[v.f if v.held == "d" else v.d] = (
                theta[v.d] * v.reference**v.order + theta[v.f] * v.reference ** theta[v.g]
            )
            continue
        g = _away(theta[v.g], v.order)
        power = theta[v.f] * v.reference**g
        u[v.d] = theta[v.d] * v.reference**v.order + power
        u[v.f] = (g - v.order) * power
        u[v.g] = g
    return u


def _away(g: float, order: float) -> float:
    if abs(g - order) >= _NEAREST:
        return float(g)
    return order + _NEAREST if g >= order else order - _NEAREST


def find_valleys(layout: Layout, rough: Sequence[tuple[Array, Array]]) -> tuple[Valley, ...]:
    """Return the pairs of laws of a model that need straight variables.

    Parameters
    ----------
    layout : Layout
        The variables. A pair whose f or g is a case's own while the other, or d, is shared has none.
    rough : sequence of (times, speeds)
        Of each case, for x_ref: the median of x.
    """
    known = [_variables(*r) for r in rough]
    valleys: list[Valley] = []
    taken: set[str] = set()
    for power in layout.model.smooth.effects:
        shape = exponent(power)
        if shape is None:
            continue
        found = [
            (abs(order - shape.start), order, straight)
            for straight in layout.model.smooth.effects
            if straight.name not in taken and (order := _order(power, straight, known[0])) is not None
            if shape.lower <= order <= shape.upper
        ]
        typical = [float(np.median(x)) for k in known if (x := _base(power, k)) is not None]
        if not typical:
            continue
        reference = max(float(np.mean(typical)), 1e-3)
        _, order, straight = min(found, key=lambda pair: pair[0], default=(0.0, 1.0, None))
        if straight is not None:
            taken.add(straight.name)
        valleys += _places(layout, power, straight, reference, order)
    return tuple(valleys)


def exponent(effect: Effect) -> Parameter | None:
    """Return the parameter of an effect that may be the exponent of its law: its only shape, a pure number."""
    shapes = [p for p in effect.parameters if p.role == "shape"]
    if effect.state or effect.joint not in {"rotor", "casing", "bearing"} or effect.depends_on_angle:
        return None
    if len(effect.parameters) != 2 or len(shapes) != 1 or shapes[0].unit != "1" or effect.amplitude is None:
        return None
    return shapes[0]


def is_power_law(effect: Effect, times: Array, speeds: Array) -> bool:
    """Return whether a law is k x^n, with x a positive quantity, along these speeds."""
    return exponent(effect) is not None and _base(effect, _variables(times, speeds)) is not None


def _variables(times: Array, speeds: Array) -> dict[str, Array]:
    rotor, casing = speeds.T
    return {"t": times, "omega_r": rotor, "omega_c": casing, "delta": rotor - casing}


def _law(effect: Effect, known: dict[str, Array], n: float | None = None) -> Array:
    values = {p.symbol: 1.0 if p.role == "amplitude" or n is None else n for p in effect.parameters}
    with np.errstate(all="ignore"):
        return np.asarray(Tape([effect.expression])(known | values)[0] * np.ones(len(known["t"])))


def _base(effect: Effect, known: dict[str, Array]) -> Array | None:
    """Return x of a law k x^n, or None if it is none."""
    at = [_law(effect, known, n) for n in (0.0, 1.0, 2.0)]
    with np.errstate(all="ignore"):
        x, again = at[1] / at[0], at[2] / at[1]
    sound = np.isfinite(x) & np.isfinite(again)
    if sound.sum() < len(x) / 2 or (x[sound] <= 0).any():
        return None
    return x[sound] if np.allclose(x[sound], again[sound], rtol=_SAME, atol=0) else None


def _order(power: Effect, straight: Effect, known: dict[str, Array]) -> float | None:
    """Return the exponent m at which a power law is the other law, or None."""
    if straight.joint != power.joint or straight.state or straight.depends_on_angle:
        return None
    if len(straight.parameters) != 1 or straight.amplitude is None or _base(power, known) is None:
        return None
    at = [_law(power, known, n) for n in (0.0, 1.0)]
    with np.errstate(all="ignore"):
        x, share = at[1] / at[0], _law(straight, known) / at[0]
        m = np.log(share) / np.log(x)
    sound = np.isfinite(m) & (np.abs(np.log(np.where(x > 0, x, 1.0))) > 0.1)
    if sound.sum() < len(x) / 2 or np.ptp(m[sound]) > 1e-6:
        return None
    return round(float(np.median(m[sound])), 9)


def _places(
    layout: Layout, power: Effect, straight: Effect | None, reference: float, order: float
) -> list[Valley]:
    shape, strength = exponent(power), power.amplitude
    if shape is None or strength is None:
        return []
    keys = [f"{power.name}.{strength.symbol}", f"{power.name}.{shape.symbol}"]
    if straight is not None and straight.amplitude is not None:
        keys.append(f"{straight.name}.{straight.amplitude.symbol}")
    own = [k in layout.per_case for k in keys]
    if own[0] != own[1] or (own[0] and not own[-1]):
        return []
    places = dict.fromkeys(tuple(layout.places(i, keys).tolist()) for i in range(len(layout.records)))
    return [Valley(d[0] if d else None, f, g, reference, order) for f, g, *d in places]
