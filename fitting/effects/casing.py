"""Torques on the casing that depend on its angle, on the rotor's precession, or on the surroundings."""

from __future__ import annotations

import math

from fitting.effects.effect import Effect, Parameter, State

_ANY = -math.inf
_PHASE = Parameter("phi", "rad", "phase", -math.inf, math.inf, meaning="phase")

CASING = (
    Effect(
        "casing.unbalance",
        "casing",
        "k*sin(psi_c - phi)",
        (Parameter("k", "N m", meaning="gravity on a tilted, unbalanced casing"), _PHASE),
        signature="a ripple once a turn whose speed falls as 1/omega_c",
        confused_with=("camera.centre",),
        source="m g s sin(tilt), once a turn",
    ),
    Effect(
        "casing.asymmetry",
        "casing",
        "k*sin(2*psi_c - phi)",
        (Parameter("k", "N m", meaning="torque of an asymmetric casing"), _PHASE),
        signature="a ripple twice a turn whose speed falls as 1/omega_c",
        confused_with=("camera.tilt",),
        source="unequal moments of inertia across the axis",
    ),
    Effect(
        "casing.precession",
        "casing",
        "k*cos(chirp + phi)",
        (
            Parameter("k", "N m", meaning="torque that follows the precession"),
            Parameter(
                "m",
                "s-2",
                "shape",
                1.0,
                1e5,
                200.0,
                tuple(round(50.0 * 1.12**i, 1) for i in range(40)),
                meaning="precession rate times rotor speed, M g l / I_r",
            ),
            _PHASE,
        ),
        signature="a chirp whose rate grows as the rotor slows, also in the tracked centre",
        confused_with=(),
        source="precession of a fast top at m / omega_r",
        state=State("chirp", "m/omega_r"),
    ),
    Effect(
        "external.constant",
        "casing",
        "k",
        (Parameter("k", "N m", lower=_ANY, meaning="a steady draught"),),
        signature="the same as dry friction while the casing keeps its sense",
        confused_with=("touchpoint.constant",),
        source="a constant outer torque",
    ),
)
