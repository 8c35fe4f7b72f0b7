"""What is hidden: each effect once more from its physics, laws that no library has, and faults of measuring."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from experiment import Hidden

# the strength of an effect is its torque [N m] at these speeds [rad/s], where it is about largest
OMEGA_R, OMEGA_C, D = 900.0, 160.0, 890.0
# the bearing's torque [N m] at the start, and on average
_FIRST, _AVERAGE = 1.9e-4, 1.0e-4
_POWER = 1.32


@dataclass(frozen=True)
class Draw:
    """What is drawn by lot: the moment of an event for each recording, all else once for all of them."""

    span: float
    t0: float
    w: float
    phi: float
    m: float
    cooling: float

    @classmethod
    def of(cls, span: float, shared: np.random.Generator, own: np.random.Generator) -> Draw:
        """Draw."""
        return cls(
            span,
            own.uniform(0.25, 0.75) * span,
            shared.uniform(4, 20),
            shared.uniform(0, 2 * np.pi),
            shared.uniform(200, 900),
            shared.uniform(20, 100),
        )


Maker = Callable[[float, Draw], Hidden]


def _on_rotor(power: float, symbol: str = "k") -> Maker:
    def make(x: float, z: Draw) -> Hidden:
        k = x / OMEGA_R**power
        return Hidden(rotor=(lambda t, wr, wc, psi: -k * wr**power,), truth={symbol: k})

    return make


def _air_on_casing(power: float) -> Maker:
    def make(x: float, z: Draw) -> Hidden:
        k = x / OMEGA_C**power
        return Hidden(
            casing=(lambda t, wr, wc, psi: -k * abs(wc) ** power * math.copysign(1, wc),), truth={"k": k}
        )

    return make


def _windage(x: float, z: Draw) -> Hidden:
    k = x / OMEGA_R**2
    return Hidden(casing=(lambda t, wr, wc, psi: k * wr * wr,), truth={"k": k})


def _loaded(x: float, z: Draw) -> Hidden:
    k = x / OMEGA_R**2
    return Hidden(casing=(lambda t, wr, wc, psi: -k * wr * wr * math.copysign(1, wc),), truth={"k": k})


def _bearing(law: Callable[[float, float], float], symbol: str = "k") -> Maker:
    def make(x: float, z: Draw) -> Hidden:
        k = x / law(OMEGA_R, OMEGA_R - D)
        return Hidden(bearing=(lambda t, wr, wc, psi: k * law(wr, wc),), truth={symbol: k})

    return make


def _drift(x: float, z: Draw) -> Hidden:
    k = x / _AVERAGE / 200
    return Hidden(factor=(lambda t: 1 + k * t,), truth={"k": k})


def _heating(x: float, z: Draw) -> Hidden:
    k = x / _FIRST / (0.05 * z.cooling)
    return Hidden(heating=((k, z.cooling),), truth={"k": k, "tau_T": z.cooling})


def _stribeck(x: float, z: Draw) -> Hidden:
    return Hidden(
        casing=(lambda t, wr, wc, psi: -math.copysign(x, wc) * math.exp(-abs(wc) / z.w),),
        truth={"k": x, "w": z.w},
    )


def _wear(x: float, z: Draw) -> Hidden:
    k = x / z.span
    return Hidden(casing=(lambda t, wr, wc, psi: -math.copysign(k, wc) * t,), truth={"k": k})


def _step(x: float, z: Draw) -> Hidden:
    return Hidden(
        casing=(lambda t, wr, wc, psi: -math.copysign(x, wc) if t > z.t0 else 0.0,),
        breaks=(z.t0,),
        truth={"k": x, "t0": z.t0},
    )


def _ripple(order: int) -> Maker:
    def make(x: float, z: Draw) -> Hidden:
        law = (lambda t, wr, wc, psi: x * math.sin(order * psi - z.phi),)
        return Hidden(casing=law, ripples=True, truth={"k": x, "phi": z.phi})

    return make


def _precession(x: float, z: Draw) -> Hidden:
    return Hidden(chirp=((x, z.m, z.phi),), truth={"k": x, "m": z.m, "phi": z.phi})


def _instead(constant: str, symbol: str, unit: float, **shape: float) -> Maker:
    """Return an effect of the base itself: the gyroscope has it at this strength, the base lacks it."""

    def make(x: float, z: Draw) -> Hidden:
        return Hidden(constants={constant: x / unit}, truth={symbol: x / unit} | shape)

    return make


LIBRARY: dict[str, Maker] = {
    "rotor.air.linear": _on_rotor(1.0, "a1"),
    "rotor.air.disk": _on_rotor(1.5),
    "rotor.air.turbulent": _on_rotor(1.8),
    "casing.air.quadratic": _air_on_casing(2.0),
    "casing.air.laminar": _air_on_casing(1.5),
    "casing.windage": _windage,
    "bearing.constant": _bearing(lambda wr, wc: 1.0, "c"),
    "bearing.quadratic": _bearing(lambda wr, wc: (wr - wc) ** 2, "e"),
    "bearing.load": _bearing(lambda wr, wc: wr * wr),
    "bearing.load_viscous": _bearing(lambda wr, wc: (wr - wc) * wr * wr),
    "bearing.drift": _drift,
    "bearing.heating": _heating,
    "touchpoint.stribeck": _stribeck,
    "touchpoint.drift": _wear,
    "touchpoint.load": _loaded,
    "touchpoint.step": _step,
    "casing.unbalance": _ripple(1),
    "casing.asymmetry": _ripple(2),
    "casing.precession": _precession,
    "external.constant": lambda x, z: Hidden(casing=(lambda t, wr, wc, psi: x,), truth={"k": x}),
}
# effects of the base: it is fitted without them
BASE: dict[str, Maker] = {
    "rotor.air.quadratic": _instead("a2", "a2", OMEGA_R**2),
    "touchpoint.constant": _instead("b1", "b1", 1.0),
    "casing.air.linear": _instead("b2", "b2", OMEGA_C),
    "bearing.linear": _instead("d", "d", D),
    "bearing.power": _instead("f", "f", D**_POWER, g=_POWER),
}
# names that stand for one and the same motion, as long as the base has rotor.air.quadratic or the casing its sense
TWINS = (
    frozenset({"casing.windage", "bearing.load"}),
    frozenset({"external.constant", "touchpoint.constant"}),
)


def twins(name: str) -> frozenset[str]:
    """Return all names that are as right as this one."""
    return frozenset({name}).union(*(t for t in TWINS if name in t))


def _outside(x: float, body: str, law: str, torque: Callable[[float, float, float], float]) -> Hidden:
    """Return a torque -x * torque(t, omega_r, omega_c); `law` is the same as text."""
    there = (lambda t, wr, wc, psi: -x * torque(t, wr, wc),)
    return Hidden(**{body: there}, truth={"k": x}, law=f"{body}: -k*{law}")


def _bump(x: float, z: Draw) -> Hidden:
    width = 0.06 * z.span
    law = f"exp(-((t - {z.t0:.6f})/{width:.6f})**2)"
    return _outside(x, "casing", law, lambda t, wr, wc: math.exp(-(((t - z.t0) / width) ** 2)))


OUTSIDE: dict[str, Maker] = {
    "cube of the casing's speed": lambda x, z: _outside(
        x, "casing", "(omega_c/160)**3", lambda t, wr, wc: (wc / OMEGA_C) ** 3
    ),
    "bump in time": _bump,
    "resonance of the casing": lambda x, z: _outside(
        x, "casing", "exp(-((omega_c - 110)/12)**2)", lambda t, wr, wc: math.exp(-(((wc - 110) / 12) ** 2))
    ),
    "logarithm of the bearing's speed": lambda x, z: _outside(
        x, "bearing", "log(delta/100)/2.2", lambda t, wr, wc: math.log((wr - wc) / 100) / 2.2
    ),
    "cube of the rotor's speed": lambda x, z: _outside(
        x, "rotor", "(omega_r/900)**3", lambda t, wr, wc: (wr / OMEGA_R) ** 3
    ),
    "resonance of the rotor": lambda x, z: _outside(
        x, "rotor", "exp(-((omega_r - 550)/40)**2)", lambda t, wr, wc: math.exp(-(((wr - 550) / 40) ** 2))
    ),
}
# faults of measuring, at a size that a careless setup has; those that every fit takes out are to be called nothing
FAULTS: dict[str, Maker] = {
    "setup.inertia": lambda x, z: Hidden(inertia=0.03, truth={"eps": 0.03}),
    "camera.clock": lambda x, z: Hidden(clock=-2e-3, truth={"eps": -2e-3}),
    "camera.offset": lambda x, z: Hidden(offset=0.05, truth={"dt": 0.05}),
    "camera.centre": lambda x, z: Hidden(centre=(5e-3, z.phi), truth={"eps": 5e-3, "phi": z.phi}),
    "camera.tilt": lambda x, z: Hidden(tilt=(3e-3, z.phi), truth={"eps": 3e-3, "phi": z.phi}),
    "camera.shutter": lambda x, z: Hidden(shutter=(2e-5, z.phi), truth={"k": 2e-5, "phi": z.phi}),
}
TAKEN_OUT = frozenset({"camera.centre", "camera.tilt", "camera.shutter", "camera.blur"})
