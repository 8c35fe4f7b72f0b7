"""The library of physical and measurement effects; one entry for each law.

The drag torque of a disc is proportional to omega^1.5 in laminar flow and to omega^1.8 in turbulent flow (Th. von
Karman, Z. angew. Math. Mech. 1, 233 (1921)). The drag torque of a thin viscous film is proportional to omega, and the
drag torque of a bluff body to omega^2.

D = omega_r - omega_c is the speed of the bearing. Two effects scale the whole bearing torque: the temperature of the
bearing, which frictional heat raises, and a slow drift.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from fitting._errors import EffectError
from fitting.effects._effect import MOMENTS, RATIO, THE_CASING, Effect, Parameter, State
from fitting.effects._expression import Tape, latex, substitute, sym

_DISC = "von Karman 1921"

# fmt: off
AIR = (
    Effect("rotor.air.linear", "rotor", "-a1*omega_r",
        (Parameter("a1", "N m s", meaning="viscous drag on the rotor"),),
        words="linear air drag of the rotor",
        signature="the speed of the rotor falls exponentially",
        confused_with=("rotor.air.quadratic", "rotor.air.disk"), source="Stokes drag; term a1 of the paper"),
    Effect("rotor.air.quadratic", "rotor", "-a2*omega_r*abs(omega_r)",
        (Parameter("a2", "N m s2", meaning="pressure drag on the rotor"),),
        words="quadratic air drag of the rotor",
        signature="the rotor decelerates most at high speed",
        confused_with=("rotor.air.disk", "rotor.air.turbulent"), source="term a2 of the paper"),
    Effect("rotor.support", "rotor", "-k*sign(omega_r)",
        (Parameter("k", "N m", meaning="dry friction of the rotor's own bearings"),),
        words="dry friction of the rotor's support",
        signature="constant deceleration of a rotor that does not turn in the casing",
        confused_with=("rotor.air.linear",),
        source="Coulomb friction in bearings that are fixed to the laboratory", searched=False),
    Effect("rotor.air.disk", "rotor", "-k*abs(omega_r)**1.5*sign(omega_r)",
        (Parameter("k", "N m s1.5", meaning="laminar drag of a disc in free air"),),
        words="laminar disc drag of the rotor",
        signature="dependence on the speed between linear and quadratic drag of the rotor",
        confused_with=("rotor.air.turbulent", "rotor.air.linear"), source=_DISC),
    Effect("rotor.air.turbulent", "rotor", "-k*abs(omega_r)**1.8*sign(omega_r)",
        (Parameter("k", "N m s1.8", meaning="turbulent drag of a disc in free air"),),
        words="turbulent disc drag of the rotor",
        signature="similar to quadratic drag of the rotor",
        confused_with=("rotor.air.quadratic", "rotor.air.disk"), source=_DISC),
    Effect("casing.air.linear", "casing", "-b2*omega_c",
        (Parameter("b2", "N m s", meaning="viscous drag on the casing"),),
        words="linear air drag of the casing",
        signature="at the end of the run the casing's speed falls exponentially", confused_with=("casing.air.laminar",),
        source="term b2 of the paper", per_case=True),
    Effect("casing.air.quadratic", "casing", "-k*omega_c*abs(omega_c)",
        (Parameter("k", "N m s2", meaning="pressure drag on the casing"),),
        words="quadratic air drag of the casing",
        signature="a braking torque near the peak speed of the casing, and almost none at the end of the run",
        confused_with=("casing.air.laminar",),
        source="drag of a bluff body; mentioned but not fitted in the paper"),
    Effect("casing.air.laminar", "casing", "-k*abs(omega_c)**1.5*sign(omega_c)",
        (Parameter("k", "N m s1.5", meaning="laminar drag of the casing as a disc"),),
        words="laminar disc drag of the casing",
        signature="like quadratic drag of the casing, with a weaker dependence on the speed",
        confused_with=("casing.air.quadratic", "casing.air.linear"), source=_DISC),
    Effect("casing.brake.eddy", "casing", "-k*omega_c/(1 + (omega_c/w)**2)",
        (
            Parameter("k", "N m s", meaning="braking torque per unit of speed, at low speed"),
            Parameter("w", "s-1", "shape", 1e-3, 1e3, 0.3, (0.007, 0.02, 0.07, 0.2, 0.7, 2.0), scale="speed",
                meaning="critical speed, at which the torque is largest"),
        ),
        words="eddy-current braking of the casing",
        signature="linear at low speed; the torque decreases above the critical speed",
        confused_with=("casing.air.linear",),
        source="W. R. Smythe, Trans. AIEE 61, 681 (1942); J. H. Wouterse, IEE Proc. B 138, 153 (1991)"),
    Effect("casing.windage", "casing", "k*omega_r*abs(omega_r)",
        (Parameter("k", "N m s2", meaning="air set in rotation by the rotor drives the casing"),),
        words="air drive of the casing by the rotor",
        signature="a driving torque on the casing early in the run, long before its peak speed",
        confused_with=("bearing.load",),
        source="momentum of the air that the rotor accelerates towards the casing", equivalent=("bearing.load",)),
)

_ANY = -math.inf
"""Lower bound of a parameter that may have any sign [1]. Derived: minus infinity; it is in the unit of the
parameter."""

BEARING = (
    Effect("bearing.constant", "bearing", "c*sign(delta)",
        (Parameter("c", "N m", meaning="dry friction of the bearing"),),
        words="dry friction of the bearing",
        signature="a driving torque on the casing that does not depend on the speed",
        confused_with=("touchpoint.constant", "external.constant"),
        source="Coulomb friction; term c of the paper"),
    Effect("bearing.linear", "bearing", "d*delta",
        (Parameter("d", "N m s", meaning="viscous friction of the bearing"),),
        words="viscous friction of the bearing",
        signature="drives the casing in proportion to the difference of the speeds",
        confused_with=("bearing.power",), source="term d of the paper"),
    Effect("bearing.quadratic", "bearing", "e*delta*abs(delta)",
        (Parameter("e", "N m s2", meaning="churning of the lubricant"),),
        words="quadratic friction of the bearing",
        signature="drives the casing most at the start", confused_with=("bearing.power", "bearing.load"),
        source="term e of the paper"),
    Effect("bearing.power", "bearing", "f*abs(delta)**g*sign(delta)",
        (
            Parameter("f", "N m s^g", meaning="strength of the power law"),
            Parameter("g", "1", "shape", 0.3, 1.4, 1.2, (0.4, 0.6, 0.8, 1.2, 1.35), meaning="exponent of the law"),
        ),
        words="power-law friction of the bearing",
        signature="a fractional power of the difference of the speeds",
        confused_with=("bearing.linear", "bearing.quadratic"),
        source="rolling friction of ball bearings; terms f and g of the paper"),
    Effect("bearing.heating", "factor", "exp(-k*temperature)",
        (
            Parameter("k", "K-1", lower=_ANY, meaning="relative decrease of the friction per kelvin"),
            Parameter("C", "J K-1", "fixed", start=1.0, meaning="heat capacity; only k/C is observable"),
            Parameter("tau_T", "s", "shape", 1e-3, 1e3, 0.4, (0.05, 0.15, 0.4, 1.2, 4.0), scale="length",
                meaning="cooling time"),
        ),
        words="temperature dependence of the bearing friction",
        signature="the friction falls as the bearing warms; it depends on the history of the speeds",
        confused_with=("bearing.drift",), source="viscosity of a lubricant as a function of temperature",
        state=State("temperature", "tau*delta/C - temperature/tau_T")),
    Effect("bearing.load", "bearing", "k*omega_r**2",
        (Parameter("k", "N m s2", meaning="load of an unbalanced rotor on the bearing"),),
        words="load-dependent dry friction of the bearing",
        signature="drives the casing early, with the square of the rotor's speed",
        confused_with=("casing.windage",), source="Coulomb friction under a centrifugal load",
        equivalent=("casing.windage",)),
    Effect("bearing.load_viscous", "bearing", "k*delta*omega_r**2",
        (Parameter("k", "N m s3", meaning="viscous friction under a centrifugal load"),),
        words="load-dependent viscous friction of the bearing",
        signature="decreases steeply at the start of the run",
        confused_with=("bearing.quadratic", "bearing.load"), source="viscous friction under a centrifugal load"),
    Effect("bearing.drift", "factor", "1 + k*t",
        (Parameter("k", "s-1", lower=_ANY, meaning="relative change of the friction per second"),),
        words="drift of the bearing friction",
        signature="the friction of the bearing changes with time, at any speed",
        confused_with=("bearing.heating", "touchpoint.drift"),
        source="running-in or ageing, first order in time"),
)

# rate of the strain of a contact that first yields and then slides; while it slides, the strain approaches the Stribeck
# curve 1 + r exp(-(omega_c/w)^2)
_BRISTLE = "(omega_c - abs(omega_c)*{z}/(1 + r*exp(-(omega_c/w)**2)))/{s}"
_SLOW = (0.007, 0.013, 0.033, 0.08, 0.2, 0.6)
"""Trial speeds at which the additional friction of slow motion has decreased to 1/e, relative to the largest speed [1].
Chosen: 1 to 90 rad/s for the casing of the paper; a smaller number omits narrow maxima of the score, a larger one costs
time."""
_STATIC = Parameter("r", "1", "shape", 0.0, 10.0, 0.5, (0.1, 0.7),
    meaning="ratio of static to Coulomb friction, minus 1")
_STRIBECK = Parameter(
    "w", "s-1", "shape", 1e-5, 3.0, 0.15, (0.01, 0.15), scale="speed",
    meaning="Stribeck speed, at which the excess has decreased to 1/e",
)

TOUCHPOINT = (
    Effect("touchpoint.constant", "casing", "-b1*sign(omega_c)",
        (Parameter("b1", "N m", meaning="dry friction at the touch point"),),
        words="dry friction at the touch point",
        signature="the speed of the casing falls linearly at the end", confused_with=("external.constant",),
        source="Coulomb friction; term b1 of the paper", per_case=True, per_surface=True,
        equivalent=("external.constant",)),
    Effect("touchpoint.stribeck", "casing", "-k*exp(-abs(omega_c)/w)*sign(omega_c)",
        (
            Parameter("k", "N m", meaning="extra friction at low speed"),
            Parameter("w", "s-1", "shape", 1e-3, 3.0, 0.03, _SLOW, scale="speed",
                meaning="speed at which the extra friction has decreased to 1/e"),
        ),
        words="Stribeck friction at the touch point",
        signature="additional friction while the casing is slow: in the first seconds and at the end",
        confused_with=("touchpoint.constant",), source="R. Stribeck, Z. VDI 46 (1902)", per_case=True,
        per_surface=True),
    Effect("touchpoint.drift", "casing", "-k*t*sign(omega_c)",
        (Parameter("k", "N m s-1", lower=_ANY, meaning="increase of the friction per second"),),
        words="drift of the friction at the touch point",
        signature="friction that increases with time: wear of tip or surface",
        confused_with=("bearing.drift", "bearing.heating"), source="wear, first order in time", per_case=True,
        per_surface=True),
    Effect("touchpoint.load", "casing", "-k*omega_r**2*sign(omega_c)",
        (Parameter("k", "N m s2", meaning="load of a wobbling rotor on the touch point"),),
        words="load-dependent friction at the touch point",
        signature="a braking torque on the casing early in the run: windage with the opposite sign",
        confused_with=("casing.windage",),
        source="Coulomb friction under a load that increases with the rotor's speed", per_case=True,
        per_surface=True),
    Effect("touchpoint.step", "casing", "-k*heaviside(t - t0)*sign(omega_c)",
        (
            Parameter("k", "N m", lower=_ANY, meaning="jump of the friction"),
            Parameter("t0", "s", "shape", grid=MOMENTS, relative=True, meaning="time of the jump"),
        ),
        words="step of the friction at the touch point",
        signature="a kink in the speed of the casing at the time of the step", confused_with=("touchpoint.drift",),
        source="the tip moves to another part of the surface", breakpoint="t0", per_case=True, per_surface=True),
    Effect("casing.friction.presliding", "casing", "-k*strain",
        (
            Parameter("k", "N m", meaning="dry friction once the contact slides"),
            Parameter("s", "1", "shape", 1e-5, 10.0, 0.01, (0.001, 0.003, 0.01, 0.03, 0.1, 0.3),
                meaning="angle through which the contact yields before it slides [rad]"),
        ),
        words="presliding friction of the casing",
        signature="dry friction that reverses gradually over an angle: hysteresis near rest",
        confused_with=("touchpoint.constant",), source="P. R. Dahl, Aerospace Corp. TOR-0158 (1968)",
        state=State("strain", "(omega_c - abs(omega_c)*strain)/s"), contact=True),
    Effect("casing.friction.lugre", "casing",
        f"-k*(bristle + T*({_BRISTLE.format(z='bristle', s='s')}))",
        (
            Parameter("k", "N m", meaning="Coulomb friction"),
            Parameter("s", "1", "shape", 1e-5, 10.0, 0.01, (0.003, 0.03, 0.3),
                meaning="angle through which the contact yields before it slides [rad]; k/s is a stiffness"),
            _STATIC, _STRIBECK,
            Parameter("T", "s", "shape", 0.0, 1.0, 0.0, (0.0,), scale="length",
                meaning="ratio of damping to stiffness of the bristles"),
        ),
        words="LuGre friction of the casing",
        signature="dry friction with hysteresis near rest, and a maximum before the contact slides",
        confused_with=("casing.friction.presliding", "touchpoint.stribeck", "casing.friction.gms"),
        source="C. Canudas de Wit et al., IEEE Trans. Autom. Control 40, 419 (1995), without its viscous term",
        state=State("bristle", _BRISTLE.format(z="bristle", s="s")), contact=True, searched=False),
    Effect("casing.friction.gms", "casing", "-k*(a*element_a + (1 - a)*element_b)",
        (
            Parameter("k", "N m", meaning="Coulomb friction of both elements together"),
            Parameter("a", "1", "shape", 0.02, 0.98, 0.5, (0.5, 0.98), meaning="share of the first element"),
            Parameter("s", "1", "shape", 1e-5, 10.0, 0.01, (0.003, 0.03),
                meaning="angle through which the first element yields before it slides [rad]"),
            Parameter("q", "1", "shape", 1.5, 1e3, 10.0, (3.0, 10.0, 30.0),
                meaning="angle of the second element, divided by the angle of the first element"),
            _STATIC, _STRIBECK,
        ),
        words="two-element Maxwell-slip friction of the casing",
        signature="dry friction that reverses in two stages: a hysteresis of two stiffnesses",
        confused_with=("casing.friction.presliding", "casing.friction.lugre"),
        source="F. Al-Bender, V. Lampaert, J. Swevers, IEEE Trans. Autom. Control 50, 1883 (2005): two elements, each "
        "with the smooth transition to sliding of the LuGre model",
        state=State("element_a", _BRISTLE.format(z="element_a", s="s")),
        second=State("element_b", _BRISTLE.format(z="element_b", s="(q*s)")), contact=True, searched=False),
    Effect("casing.friction.starvation", "casing", "-k*exp(-(abs(omega_c)/w)**1.4)*sign(omega_c)",
        (
            Parameter("k", "N m", meaning="additional friction where no lubricant film separates the surfaces"),
            Parameter("w", "s-1", "shape", 3e-4, 3.0, 0.03, _SLOW, scale="speed",
                meaning="speed at which a film has formed to 63 %"),
        ),
        words="friction of the casing with lubricant starvation",
        signature="additional friction at low speed that is nearly constant close to rest",
        confused_with=("touchpoint.stribeck",),
        source="weighting factor of the sliding frictional moment: SKF, Rolling bearings (2018), p. 132",
        searched=False),
    Effect("casing.seal.cooling", "casing", "-k*(1 - exp(-t/tau_T))*sign(omega_c)",
        (
            Parameter("k", "N m", meaning="increase of the friction while a warm seal cools"),
            Parameter("tau_T", "s", "shape", 1e-4, 1e4, 0.3, (0.03, 0.1, 0.3, 1.0, 3.0), scale="length",
                meaning="cooling time"),
        ),
        words="friction of a cooling seal on the casing",
        signature="friction that increases from the start to a constant value, at any speed",
        confused_with=("touchpoint.drift", "touchpoint.stribeck"),
        source="viscosity and contact pressure of a lip seal as functions of temperature; Newton's law of cooling"),
)

_PHASE = Parameter("phi", "rad", "phase", -math.inf, math.inf, meaning="phase")

CASING = (
    Effect("casing.unbalance", "casing", "k*sin(psi_c - phi)",
        (Parameter("k", "N m", meaning="gravity on a tilted, unbalanced casing"), _PHASE),
        words="unbalance of the casing",
        signature="a first harmonic of the angle; in speed, its amplitude falls as 1/omega_c",
        confused_with=("camera.centre",), source="m g s sin(tilt), once a turn"),
    Effect("casing.asymmetry", "casing", "k*sin(2*psi_c - phi)",
        (Parameter("k", "N m", meaning="torque of an asymmetric casing"), _PHASE),
        words="asymmetry of the casing",
        signature="a second harmonic of the angle; in speed, its amplitude falls as 1/omega_c",
        confused_with=("camera.tilt",), source="unequal moments of inertia across the axis"),
    Effect("casing.precession", "casing", "k*cos(chirp + phi)",
        (
            Parameter("k", "N m", meaning="torque that follows the precession"),
            Parameter("m", "s-2", "shape", 0.0, math.inf, 13.0, tuple(round(3.3 * 1.12**i, 3) for i in range(40)),
                scale="chirp", meaning="precession rate times rotor speed, M g l / I_r"),
            _PHASE,
        ),
        words="precession torque on the casing",
        signature="a chirp whose rate grows as the rotor slows; it also appears in the tracked centre",
        source="precession of a fast top at m / omega_r", state=State("chirp", "m/omega_r")),
    Effect("external.constant", "casing", "k",
        (
            Parameter("k", "N m", lower=_ANY,
                meaning="constant torque, for example of a falling weight, minus dry friction missing from the model"),
        ),
        words="constant external torque on the casing",
        signature="the same as dry friction while the casing keeps its sense of rotation",
        confused_with=("touchpoint.constant",), source="a constant external torque",
        equivalent=("touchpoint.constant",)),
)

OSCILLATOR = (
    Effect("casing.spring.linear", "casing", "-k*deflection",
        (Parameter("k", "N m", meaning="stiffness per radian"),),
        words="linear spring on the casing",
        signature="an oscillation whose period does not depend on the amplitude",
        confused_with=("casing.gravity",), source="Hooke's law of a torsion wire or a spiral spring"),
    Effect("casing.spring.cubic", "casing", "-k*deflection**3",
        (Parameter("k", "N m", lower=_ANY, meaning="stiffness that grows with the deflection"),),
        words="cubic spring on the casing",
        signature="the frequency rises (falls, if negative) with the square of the amplitude",
        confused_with=("casing.gravity",), source="third-order term of a symmetric spring (G. Duffing, 1918)"),
    Effect("casing.gravity", "casing", "-k*sin(deflection)",
        (Parameter("k", "N m", meaning="weight times distance of the centre of mass from the axis"),),
        words="gravity on the casing as a pendulum",
        signature="an oscillation that is slower at large amplitude: a pendulum",
        confused_with=("casing.spring.linear", "casing.spring.cubic"),
        source="m g s sin(angle), at any amplitude"),
)

CAMERA = (
    Effect("camera.clock", "camera.rotor", "eps*t*omega",
        (
            Parameter("eps", "1", lower=-0.2, upper=0.2,
                meaning="relative error of the rate of the rotor camera's clock"),
        ),
        kind="measurement", words="clock error of the rotor camera",
        signature="all speeds of one camera have the same relative error",
        source="first-order term of psi(t (1 + eps)), with t from the start of the clip"),
    Effect("camera.offset", "camera.rotor", "dt*omega",
        (Parameter("dt", "s", lower=-0.05, upper=0.05, meaning="delay of the start of the clips"),),
        kind="measurement",
        words="common start error of the rotor clips",
        signature="the speeds of the rotor clips are shifted in time with respect to the modelled curve",
        source="first-order term of psi(t + dt)"),
    Effect("camera.centre", "camera.casing", "eps*sin(psi - phi)",
        (Parameter("eps", "rad", meaning="offset of the centre, divided by the marker's radius"), _PHASE),
        kind="measurement", words="camera centre offset",
        signature="a first harmonic of the angle with a constant amplitude",
        confused_with=("casing.unbalance", "camera.shutter"), source="first-order effect of an offset centre",
        nuisance=True),
    Effect("camera.tilt", "camera.casing", "eps*sin(2*psi - phi)",
        (Parameter("eps", "rad", meaning="a quarter of the square of the tilt"), _PHASE),
        kind="measurement", words="camera tilt",
        signature="a second harmonic of the angle with a constant amplitude",
        confused_with=("casing.asymmetry",), source="a circle seen as an ellipse", nuisance=True),
    Effect("camera.shutter", "camera.casing", "-k*omega*sin(psi - phi)",
        (Parameter("k", "s", meaning="time in which the shutter moves by the marker's radius"), _PHASE),
        kind="measurement", words="rolling shutter of the camera",
        signature="a first harmonic that grows with the speed",
        confused_with=("camera.centre",),
        source="rolling shutter: the delay depends on the position of the marker", nuisance=True),
    Effect("camera.blur", "camera.casing", "k*omega**2*sin(psi - phi)",
        (Parameter("k", "s2", meaning="increase of the first harmonic per square of the speed"), _PHASE),
        kind="measurement", words="motion blur of the marker",
        signature="a first harmonic that changes with the square of the speed",
        confused_with=("camera.centre", "casing.unbalance"),
        source="second-order term of motion blur, whose length is proportional to the speed; fitted to films only",
        nuisance=True),
)

SETUP = (
    Effect("setup.inertia", "inertia", "1/(1 + eps)",
        (
            Parameter("eps", "1", lower=-0.3, upper=0.3,
                meaning="relative amount by which the given inertia is too small"),
        ),
        kind="measurement",
        words="error of the given inertia of the casing",
        signature="the bearing torques that follow from rotor and casing differ by a constant factor",
        confused_with=("touchpoint.load", "bearing.heating"),
        source="only ratios of torque to inertia are observable; the bearing torque acts on both bodies"),
)

# errors of single windows and samples, which the search for effects fits by separate methods
START = Effect("camera.start", "camera.rotor", "dt*omega",
    (Parameter("dt", "s", meaning="error of the start of a window"),),
    kind="measurement", words="start errors of the rotor windows",
    signature="each rotor window is shifted in time by its own amount",
    confused_with=("camera.offset",), source="first order of psi(t + dt)", searched=False)
SLIP = Effect("camera.slip", "camera.rotor", "n*omega",
    (Parameter("n", "1", meaning="number of whole turns"),),
    kind="measurement", words="slipped turns", signature="a step of whole turns between two samples",
    source="an angle is measured only up to whole turns", searched=False)

_RATIO = Parameter(
    RATIO, "1", "shape", _ANY, math.inf, 1.0,
    meaning="ratio omega_r / omega_c without slip; negative: opposite senses",
)

CONTACT = (
    Effect("contact.rolling", "contact", "torque_held*(1 - c*inertia_slip*abs(omega_r)/T) - inertia_slip*slip/T",
        (
            _RATIO,
            Parameter("c", "N-1 m-1", meaning="creep: relative slip per unit of transmitted torque"),
            Parameter("T", "s", "fixed", 1e-3, math.inf, 0.1, meaning="relaxation time of the slip"),
        ),
        words="rolling contact of both bodies",
        signature="a constant ratio of the speeds of the two bodies",
        source="the constraint omega_r = n omega_c, stabilised as proposed by J. Baumgarte, Comput. Methods Appl. "
        "Mech. Eng. 1, 1 (1972), and linear creep: K. L. Johnson, Contact Mechanics (1985), ch. 8",
        searched=False, rigid=True),
    Effect("contact.sliding", "contact", "-k*tanh(slip/w)",
        (
            Parameter("k", "N m", meaning="torque of the sliding contact on the rotor"),
            _RATIO,
            Parameter("w", "s-1", "fixed", 1e-9, math.inf, 1.0, meaning="slip above which the contact slides"),
        ),
        words="sliding contact of both bodies",
        signature="the faster rim slows down and the slower rim speeds up at constant rates until both roll",
        source="Coulomb friction of two rims, regularised at small slip", searched=False),
)
# fmt: on

LIBRARY = MappingProxyType(
    {e.name: e for e in (*AIR, *BEARING, *TOUCHPOINT, *CASING, *OSCILLATOR, *CONTACT, *CAMERA, *SETUP)}
)
# friction laws of a contact that `plan --friction` and `diagnose --friction` distinguish, the simplest first
FRICTION = (
    "touchpoint.constant", "casing.air.linear", "touchpoint.stribeck", "casing.friction.starvation",
    "casing.friction.presliding", "casing.friction.lugre", "casing.friction.gms",
)  # fmt: skip
# nuisance effects, which are always fitted
NUISANCE = tuple(e.name for e in LIBRARY.values() if e.nuisance)

LINEAR = ("rotor.air.quadratic", "touchpoint.constant", "casing.air.linear", "bearing.linear")
REDUCED = (*LINEAR, "bearing.power")
GENERAL = (*REDUCED, "rotor.air.linear", "bearing.constant", "bearing.quadratic")


# roles that the keys of a single body omit or replace
_ROLES = (("casing.", ""), ("touchpoint.", "support."))


def shortened(key: str) -> str:
    """Return a key of the library for a single body: ``air.quadratic``, ``support.constant``."""
    return next((short + key.removeprefix(role) for role, short in _ROLES if key.startswith(role)), key)


def find(name: str) -> Effect:
    """Return the effect of this name, which may be shortened; otherwise an EffectError with the closest names."""
    if name in LIBRARY:
        return LIBRARY[name]
    for role, short in _ROLES:
        if name.startswith(short) and role + name.removeprefix(short) in LIBRARY:
            return LIBRARY[role + name.removeprefix(short)]
    if not name.replace(".", "").replace("_", "").isalnum():
        raise EffectError(
            f"{name[:60]!r} does not say on which body the law acts",
            "write rotor:, casing: or bearing: before it, for example casing: -k*omega_c**3",
        )
    raise unknown(name, LIBRARY, "`gyrotrack effects` lists them all")


def unknown(name: str, names: Iterable[str], hint: str) -> EffectError:
    """Return the error for an unknown name, with the closest names, or with a hint if no name is close."""
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.4)
    return EffectError(
        f"there is no effect named {name[:60]!r}", f"did you mean {' or '.join(close)}?" if close else hint
    )


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
"""Typical values of the parameters, used as initial values [SI units]. Source: table 5 of the paper, case 1, the
reduced model on full data; this model does not contain a1, c and e, and the origin of their values is not recorded."""
INERTIA_ROTOR = 5.54e-5
"""Moment of inertia of the rotor of the paper [kg m2]. Source: the paper."""
INERTIA_CASING = 2.06e-5
"""Moment of inertia of the casing of the paper [kg m2]. Source: the paper."""
_BUDGET = 1e-4
"""Torque that scales the initial values of constants [N m]. Source: the torque budget of the paper."""


def of_the_rotor(effect: Effect) -> Effect | None:
    """Return the effect of the rotor that has the law of a given effect of a single body.

    None if there is no such effect.
    """

    def law(e: Effect) -> tuple[str, ...]:
        own = {p.symbol: sym(f"p{i}") for i, p in enumerate(e.parameters)}
        tree = substitute(e.expression, own | {"omega_c": sym("omega_r"), "psi_c": sym("psi_r")})
        return latex(tree), str(len(own))

    if not effect.bodies <= THE_CASING or effect.state is not None or effect.camera:
        return None
    return next((e for e in LIBRARY.values() if e.joint == "rotor" and law(e) == law(effect)), None)


def typical_values(
    effect: Effect, share: float, *, duration: float, speeds: Mapping[str, float]
) -> dict[str, float]:
    """Return values of the parameters of an effect with which its torque is a given share of the torque budget.

    `share` is the largest torque at the typical `speeds` omega_r and omega_c [rad/s], divided by the budget of
    1e-4 N m. Time constants follow from the `duration` of the recording [s].
    """
    own = effect.parameters_at(speeds, duration)
    values = {p.symbol: 1.0 if p.role == "amplitude" else p.start for p in own}
    for p in own:
        if p.role == "shape":
            middle = p.grid[len(p.grid) // 2] if p.grid else p.start
            values[p.symbol] = middle * duration if p.relative else middle
    amplitude = next((p.symbol for p in effect.parameters if p.role == "amplitude"), None)
    if amplitude is not None:
        values[amplitude] = _typical_strength(effect, values, share, duration, speeds)
    return {f"{effect.name}.{k}": v for k, v in values.items()}


def _typical_strength(
    effect: Effect, values: Mapping[str, float], share: float, duration: float, speeds: Mapping[str, float]
) -> float:
    """Return the strength with which the torque of an effect is a given share of the torque budget."""
    if effect.joint == "inertia":
        return share
    delta = speeds["omega_r"] - speeds["omega_c"]
    if effect.joint == "factor":
        # the drift over the run, or the heat of friction, changes the bearing torque by `share`
        return share / (_BUDGET * delta * values.get("tau_T", duration) if effect.state else duration)
    at: dict[str, Any] = {
        **values,
        **speeds,
        "delta": delta,
        **dict.fromkeys(("deflection", "psi_c", "psi_r", "psi"), 1.0),
        "t": duration,
        "omega": speeds["omega_c"],
        "tau": _BUDGET,
        "slip": speeds["omega_r"],
        "torque_held": _BUDGET,
        "inertia_slip": INERTIA_ROTOR,
    }
    at |= dict.fromkeys((s.symbol for s in effect.states), 1.0)
    tape, unit = Tape([effect.expression]), 0.0
    for part in (0.05, 0.3, 1.0, 1.5):
        slower = {"omega_c": part * speeds["omega_c"], "omega": part * speeds["omega_c"]}
        unit = max(unit, abs(float(tape(at | slower)[0])))
    return share * _BUDGET / unit if unit > 0 and math.isfinite(unit) else share * _BUDGET


def typical_of_model(
    effects: Iterable[Effect], share: float, *, duration: float, speeds: Mapping[str, float]
) -> dict[str, float]:
    """Return a value for each parameter of a model: the paper's value if there is one, otherwise a typical value.

    `typical_values` explains the other arguments.
    """
    values: dict[str, float] = {}
    for effect in effects:
        values |= typical_values(effect, share, duration=duration, speeds=speeds)
    return values | {k: v for k, v in PAPER.items() if k in values}
