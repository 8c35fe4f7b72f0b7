"""What the cameras do to the angles, and what was measured wrongly before: artefacts, never physics."""

from __future__ import annotations

import math

from fitting.effects.effect import Effect, Parameter

_PHASE = Parameter("phi", "rad", "phase", -math.inf, math.inf, meaning="phase")

CAMERA = (
    Effect(
        "camera.clock",
        "camera.rotor",
        "eps*t*omega",
        (
            Parameter(
                "eps", "1", lower=-0.2, upper=0.2, meaning="share by which the rotor camera's clock is off"
            ),
        ),
        kind="measurement",
        signature="all speeds of one camera are off by the same share",
        confused_with=(),
        source="first order of psi(t (1 + eps)), t from the start of the clip",
    ),
    Effect(
        "camera.offset",
        "camera.rotor",
        "dt*omega",
        (Parameter("dt", "s", lower=-0.05, upper=0.05, meaning="how late the clips start"),),
        kind="measurement",
        signature="the speeds of the rotor clips sit beside the curve along time",
        confused_with=(),
        source="first order of psi(t + dt)",
    ),
    Effect(
        "camera.centre",
        "camera.casing",
        "eps*sin(psi - phi)",
        (Parameter("eps", "rad", meaning="offset of the centre over the marker's radius"), _PHASE),
        kind="measurement",
        signature="a ripple once a turn of constant angle",
        confused_with=("casing.unbalance", "camera.shutter"),
        source="first order of an offset centre",
    ),
    Effect(
        "camera.tilt",
        "camera.casing",
        "eps*sin(2*psi - phi)",
        (Parameter("eps", "rad", meaning="a quarter of the square of the tilt"), _PHASE),
        kind="measurement",
        signature="a ripple twice a turn of constant angle",
        confused_with=("casing.asymmetry",),
        source="a circle seen as an ellipse",
    ),
    Effect(
        "camera.shutter",
        "camera.casing",
        "-k*omega*sin(psi - phi)",
        (Parameter("k", "s", meaning="time in which the shutter rolls over the marker's radius"), _PHASE),
        kind="measurement",
        signature="a ripple once a turn that grows with the speed",
        confused_with=("camera.centre",),
        source="rolling shutter: the lag depends on where the marker stands",
    ),
)

SETUP = (
    Effect(
        "setup.inertia",
        "inertia",
        "1/(1 + eps)",
        (
            Parameter(
                "eps", "1", lower=-0.3, upper=0.3, meaning="share by which the casing's inertia is too small"
            ),
        ),
        kind="measurement",
        signature="rotor and casing disagree on the torque between them, all the time by the same share",
        confused_with=("touchpoint.load", "bearing.heating"),
        source="only ratios of torque to inertia are seen; the bearing's torque is seen on both bodies",
    ),
)
