"""Friction between rotor and casing: internal torques that slow the one and drive the other.

D = omega_r - omega_c is the speed of the bearing. Two effects scale the whole bearing torque:
a temperature of its own, fed by the heat of friction, and a slow drift.
"""

from __future__ import annotations

import math

from fitting.effects.effect import Effect, Parameter, State

_ANY = -math.inf

BEARING = (
    Effect(
        "bearing.constant",
        "bearing",
        "c*sign(delta)",
        (Parameter("c", "N m", meaning="dry friction of the bearing"),),
        signature="drives the casing evenly at every speed",
        confused_with=("touchpoint.constant", "external.constant"),
        source="Coulomb friction; term c of the paper",
    ),
    Effect(
        "bearing.linear",
        "bearing",
        "d*delta",
        (Parameter("d", "N m s", meaning="viscous friction of the bearing"),),
        signature="drives the casing in proportion to the difference of the speeds",
        confused_with=("bearing.power",),
        source="term d of the paper",
    ),
    Effect(
        "bearing.quadratic",
        "bearing",
        "e*delta*abs(delta)",
        (Parameter("e", "N m s2", meaning="churning of the lubricant"),),
        signature="drives the casing most at the start",
        confused_with=("bearing.power", "bearing.load"),
        source="term e of the paper",
    ),
    Effect(
        "bearing.power",
        "bearing",
        "f*abs(delta)**g*sign(delta)",
        (
            Parameter("f", "N m s^g", meaning="strength of the power law"),
            Parameter("g", "1", "shape", 0.3, 1.4, 1.2, (0.4, 0.6, 0.8, 1.2, 1.35), meaning="its exponent"),
        ),
        signature="a fractional power of the difference of the speeds",
        confused_with=("bearing.linear", "bearing.quadratic"),
        source="rolling friction of ball bearings; terms f and g of the paper",
    ),
    Effect(
        "bearing.heating",
        "factor",
        "exp(-k*temperature)",
        (
            Parameter("k", "K-1", lower=_ANY, meaning="share by which the friction falls with each kelvin"),
            Parameter("C", "J K-1", "fixed", start=1.0, meaning="heat capacity; only k/C is observable"),
            Parameter(
                "tau_T",
                "s",
                "shape",
                0.1,
                1e5,
                30.0,
                (0.05, 0.15, 0.4, 1.2, 4.0),
                relative=True,
                meaning="cooling time",
            ),
        ),
        signature="the bearing loosens with the heat put into it, and remembers it",
        confused_with=("bearing.drift",),
        source="viscosity of a lubricant against temperature",
        state=State("temperature", "tau*delta/C - temperature/tau_T"),
    ),
    Effect(
        "bearing.load",
        "bearing",
        "k*omega_r**2",
        (Parameter("k", "N m s2", meaning="an unbalanced rotor loads the bearing"),),
        signature="drives the casing early, with the square of the rotor's speed",
        confused_with=("casing.windage",),
        source="Coulomb friction under a centrifugal load",
    ),
    Effect(
        "bearing.load_viscous",
        "bearing",
        "k*delta*omega_r**2",
        (Parameter("k", "N m s3", meaning="viscous friction under a centrifugal load"),),
        signature="steep at the start",
        confused_with=("bearing.quadratic", "bearing.load"),
        source="viscous friction under a centrifugal load",
    ),
    Effect(
        "bearing.drift",
        "factor",
        "1 + k*t",
        (Parameter("k", "s-1", lower=_ANY, meaning="share by which the friction changes each second"),),
        signature="the bearing changes with time, whatever the speeds are",
        confused_with=("bearing.heating", "touchpoint.drift"),
        source="running-in or ageing, first order in time",
    ),
)
