"""Friction where the casing stands on its surface."""

from __future__ import annotations

import math

from fitting.effects.effect import MOMENTS, Effect, Parameter

_ANY = -math.inf

TOUCHPOINT = (
    Effect(
        "touchpoint.constant",
        "casing",
        "-b1*sign(omega_c)",
        (Parameter("b1", "N m", meaning="dry friction at the touch point"),),
        signature="the end of the tail falls in a straight line",
        confused_with=("external.constant",),
        source="Coulomb friction; term b1 of the paper",
    ),
    Effect(
        "touchpoint.stribeck",
        "casing",
        "-k*exp(-abs(omega_c)/w)*sign(omega_c)",
        (
            Parameter("k", "N m", meaning="extra friction at low speed"),
            Parameter(
                "w",
                "s-1",
                "shape",
                0.2,
                500.0,
                5.0,
                (1.0, 2.0, 5.0, 12.0, 30.0),
                meaning="speed at which it has fallen to 1/e",
            ),
        ),
        signature="extra loss while the casing is slow: the first seconds and the end",
        confused_with=("touchpoint.constant",),
        source="R. Stribeck, Z. VDI 46 (1902)",
    ),
    Effect(
        "touchpoint.drift",
        "casing",
        "-k*t*sign(omega_c)",
        (Parameter("k", "N m s-1", lower=_ANY, meaning="growth of the friction each second"),),
        signature="a loss that grows with time: wear of tip or surface",
        confused_with=("bearing.drift", "bearing.heating"),
        source="wear, first order in time",
    ),
    Effect(
        "touchpoint.load",
        "casing",
        "-k*omega_r**2*sign(omega_c)",
        (Parameter("k", "N m s2", meaning="wobble of the rotor loads the touch point"),),
        signature="a loss of the casing early on; windage with the other sign",
        confused_with=("casing.windage",),
        source="Coulomb friction under a load that grows with the rotor's speed",
    ),
    Effect(
        "touchpoint.step",
        "casing",
        "-k*heaviside(t - t0)*sign(omega_c)",
        (
            Parameter("k", "N m", lower=_ANY, meaning="jump of the friction"),
            Parameter(
                "t0",
                "s",
                "shape",
                grid=MOMENTS,
                relative=True,
                meaning="when it jumps",
            ),
        ),
        signature="a kink in the casing's speed at one moment",
        confused_with=("touchpoint.drift",),
        source="the tip walks onto another patch of the surface",
        breakpoint="t0",
    ),
)
