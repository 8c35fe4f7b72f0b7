"""Other gyroscopes, filmed otherwise: everything about them is drawn by lot, so that no table can be fitted to one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from experiment import BUDGET, CASES

_LONGEST_WINDOW = 4.0  # s


def gyroscopes(rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return two runs of one gyroscope on two tables, as `experiment.CASES` has them.

    Its bodies, how its friction is shared out, its speeds, the length of the runs, the cameras' rates, the number and
    place of the rotor's windows and the noise of an angle are drawn.
    """
    first = rng.uniform(400, 1200)
    torque = _spread(rng, 6e-5, 6e-4)
    inertia = torque * rng.uniform(100, 300) / first
    air, power, g = rng.uniform(0.1, 0.6), rng.uniform(0.2, 0.9), rng.uniform(0.5, 1.35)
    bearing = (1 - air) * torque
    body = {
        "a2": air * torque / first**2,
        "d": (1 - power) * bearing / first,
        "f": power * bearing / first**g,
        "g": g,
        "I_rotor": inertia,
        "I_casing": inertia * rng.uniform(0.2, 0.8),
        "rates": (int(rng.choice([120, 240, 260, 480])), int(rng.choice([500, 1000]))),
        "sigma": _spread(rng, 3e-4, 4e-3),
    }
    drive, fastest = 0.6 * bearing, rng.uniform(50, 250)
    rub = rng.uniform(0.01, 0.2) * drive
    runs = []
    for b1, speed in ((rub, first), (rub * _spread(rng, 0.3, 4), first * rng.uniform(0.7, 1.1))):
        count = int(rng.integers(2, 6))
        span = rng.uniform(60, 240)
        latest = 1 - 2 * _LONGEST_WINDOW / span
        places = (np.arange(count) + rng.uniform(0, 0.6, count)) / count * latest
        runs.append(
            body
            | {
                "b1": b1,
                "b2": (drive - rub) / fastest,
                "start": (speed, rng.uniform(5, 30)),
                "span": span,
                "windows": tuple(places.tolist()),
                "window": rng.uniform(1.5, _LONGEST_WINDOW),
            }
        )
    return runs[0], runs[1]


def budget(case: dict[str, Any]) -> float:
    """Return the torque that strengths are shares of [N m]: the bearing's at the start, as `BUDGET` is for `CASES`."""
    return BUDGET * _bearing(case) / _bearing(CASES[0])


def _bearing(case: dict[str, Any]) -> float:
    speed = case["start"][0]
    return float(case["d"] * speed + case["f"] * speed ** case["g"])


def _spread(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))
