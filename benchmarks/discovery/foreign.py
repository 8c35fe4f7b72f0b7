"""Laws that the library does not have, written down when the search was finished, to see what it says of them."""

from __future__ import annotations

import math
from collections.abc import Callable

from experiment import Hidden
from hidden import Draw, Maker

# t, omega_r, omega_c, and the moment that is drawn by lot
Law = Callable[[float, float, float, float], float]


def _law(body: str, formula: str, law: Law) -> Maker:
    """Return a torque -x * law on a body, or in the bearing; `formula` is the same as text, {t0} the moment."""

    def make(x: float, z: Draw) -> Hidden:
        torque = (lambda t, wr, wc, psi: -x * law(t, wr, wc, z.t0),)
        breaks = (z.t0, z.t0 + _PULSE) if "{t0" in formula else ()
        text = formula.format(t0=f"{z.t0:.6f}", t1=f"{z.t0 + _PULSE:.6f}")
        return Hidden(**{body: torque}, breaks=breaks, truth={"k": x}, law=f"{body}: -k*({text})")

    return make


_PULSE = 10.0  # s

FOREIGN: dict[str, Maker] = {
    "root of the casing's speed": _law(
        "casing", "sqrt(omega_c/160)", lambda t, wr, wc, t0: math.sqrt(max(wc, 0.0) / 160)
    ),
    "drag that saturates": _law("casing", "tanh(omega_c/40)", lambda t, wr, wc, t0: math.tanh(wc / 40)),
    "drag beyond 100 rad/s": _law(
        "casing", "heaviside(omega_c-100)*(omega_c-100)/60", lambda t, wr, wc, t0: max(wc - 100, 0.0) / 60
    ),
    "product of the speeds": _law("casing", "omega_r*omega_c/1e5", lambda t, wr, wc, t0: wr * wc / 1e5),
    "torque that dies away": _law("casing", "exp(-t/30)", lambda t, wr, wc, t0: math.exp(-t / 30)),
    "square of the time": _law("casing", "(t/200)**2", lambda t, wr, wc, t0: (t / 200) ** 2),
    "logarithm of the time": _law(
        "casing", "log(1+t/5)/3.7", lambda t, wr, wc, t0: math.log(1 + t / 5) / 3.7
    ),
    "ramp": _law("casing", "heaviside(t-{t0})*(t-{t0})/60", lambda t, wr, wc, t0: max(t - t0, 0.0) / 60),
    "pulse of 10 s": _law(
        "casing", "heaviside(t-{t0})*heaviside({t1}-t)", lambda t, wr, wc, t0: float(t0 < t < t0 + _PULSE)
    ),
    "draught with a period of 20 s": _law(
        "casing", "sin(0.3141593*t)", lambda t, wr, wc, t0: math.sin(0.3141593 * t)
    ),
    "table that swings in 2 s": _law(
        "casing", "sin(3.1415927*t)", lambda t, wr, wc, t0: math.sin(3.1415927 * t)
    ),
    "mixed friction of the bearing": _law(
        "bearing", "2*exp(-delta/250)", lambda t, wr, wc, t0: 2 * math.exp(-(wr - wc) / 250)
    ),
    "step of the bearing": _law("bearing", "heaviside(t-{t0})", lambda t, wr, wc, t0: float(t > t0)),
    "bearing that ages and recovers": _law(
        "bearing", "sin(0.0157*t)", lambda t, wr, wc, t0: math.sin(0.0157 * t)
    ),
    "step of the rotor": _law("rotor", "heaviside(t-{t0})", lambda t, wr, wc, t0: float(t > t0)),
    "drag of the rotor that saturates": _law(
        "rotor", "tanh(omega_r/300)", lambda t, wr, wc, t0: math.tanh(wr / 300)
    ),
}
