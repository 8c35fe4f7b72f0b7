"""Variables in which the valley of the fit is straight.

A bearing torque d D + f D^g has a curved valley in (d, f, g): near g = 1 both terms are the same. With
x = D / D_ref it reads T1 x + K (x^g - x) / (g - 1), where T1 is the torque at D_ref and K its curvature:

    T1 = d D_ref + f D_ref^g,    K = (g - 1) f D_ref^g.

A power law without a linear one beside it has the torque F = f D_ref^g for f.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# closer to 1 the two terms cancel too many digits; the torque itself hardly changes from here to 1
_NEAREST = 3e-3


@dataclass(frozen=True)
class Valley:
    """A power term, alone (d is None) or beside a linear one: places among the variables, and D_ref [rad/s]."""

    d: int | None
    f: int
    g: int
    reference: float


def to_physical(u: Array, valleys: tuple[Valley, ...]) -> tuple[Array, Array]:
    """Return (d, f, g, ...) and their derivatives by (T1, K, g, ...)."""
    theta, slope = u.copy(), np.eye(len(u))
    for v in valleys:
        if v.d is None:
            full = v.reference ** u[v.g]
            theta[v.f] = u[v.f] / full
            slope[v.f, v.f] = 1 / full
            slope[v.f, v.g] = -theta[v.f] * np.log(v.reference)
            continue
        t1, curvature, g = u[v.d], u[v.f], _away_from_one(u[v.g])
        full = v.reference**g
        theta[v.g] = g
        theta[v.f] = curvature / ((g - 1) * full)
        theta[v.d] = (t1 - curvature / (g - 1)) / v.reference
        slope[v.f, v.f] = 1 / ((g - 1) * full)
        slope[v.f, v.g] = -theta[v.f] * (1 / (g - 1) + np.log(v.reference))
        slope[v.d, v.d] = 1 / v.reference
        slope[v.d, v.f] = -1 / ((g - 1) * v.reference)
        slope[v.d, v.g] = curvature / ((g - 1) ** 2 * v.reference)
    return theta, slope


def from_physical(theta: Array, valleys: tuple[Valley, ...]) -> Array:
    """Return (T1, K, g, ...) from (d, f, g, ...)."""
    u = theta.copy()
    for v in valleys:
        if v.d is None:
            u[v.f] = theta[v.f] * v.reference ** theta[v.g]
            continue
        g = _away_from_one(theta[v.g])
        power = theta[v.f] * v.reference**g
        u[v.d] = theta[v.d] * v.reference + power
        u[v.f] = (g - 1) * power
        u[v.g] = g
    return u


def _away_from_one(g: float) -> float:
    if abs(g - 1) >= _NEAREST:
        return float(g)
    return 1 + _NEAREST if g >= 1 else 1 - _NEAREST
