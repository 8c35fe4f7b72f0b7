"""Drag of the air on the rotor and on the casing.

Laminar flow over a disc takes a torque that grows as omega^1.5, turbulent flow as omega^1.8
(Th. von Karman, Z. angew. Math. Mech. 1, 233 (1921)); a thin viscous film takes it linearly, a bluff
body quadratically.
"""

from __future__ import annotations

from fitting.effects.effect import Effect, Parameter

_DISC = "von Karman 1921"

AIR = (
    Effect(
        "rotor.air.linear",
        "rotor",
        "-a1*omega_r",
        (Parameter("a1", "N m s", meaning="viscous drag on the rotor"),),
        signature="the rotor slows by a constant share a second",
        confused_with=("rotor.air.quadratic", "rotor.air.disk"),
        source="Stokes drag; term a1 of the paper",
    ),
    Effect(
        "rotor.air.quadratic",
        "rotor",
        "-a2*omega_r*abs(omega_r)",
        (Parameter("a2", "N m s2", meaning="pressure drag on the rotor"),),
        signature="the rotor slows most while it is fast",
        confused_with=("rotor.air.disk", "rotor.air.turbulent"),
        source="term a2 of the paper",
    ),
    Effect(
        "rotor.air.disk",
        "rotor",
        "-k*abs(omega_r)**1.5*sign(omega_r)",
        (Parameter("k", "N m s1.5", meaning="laminar drag of a disc in free air"),),
        signature="between linear and quadratic drag of the rotor",
        confused_with=("rotor.air.turbulent", "rotor.air.linear"),
        source=_DISC,
    ),
    Effect(
        "rotor.air.turbulent",
        "rotor",
        "-k*abs(omega_r)**1.8*sign(omega_r)",
        (Parameter("k", "N m s1.8", meaning="turbulent drag of a disc in free air"),),
        signature="close to quadratic drag of the rotor",
        confused_with=("rotor.air.quadratic", "rotor.air.disk"),
        source=_DISC,
    ),
    Effect(
        "casing.air.linear",
        "casing",
        "-b2*omega_c",
        (Parameter("b2", "N m s", meaning="viscous drag on the casing"),),
        signature="the tail of the casing's speed falls exponentially",
        confused_with=("casing.air.laminar",),
        source="term b2 of the paper",
    ),
    Effect(
        "casing.air.quadratic",
        "casing",
        "-k*omega_c*abs(omega_c)",
        (Parameter("k", "N m s2", meaning="pressure drag on the casing"),),
        signature="the casing loses torque near its peak speed and hardly any in the tail",
        confused_with=("casing.air.laminar",),
        source="drag of a bluff body; named and dropped in the paper",
    ),
    Effect(
        "casing.air.laminar",
        "casing",
        "-k*abs(omega_c)**1.5*sign(omega_c)",
        (Parameter("k", "N m s1.5", meaning="laminar drag of the casing as a disc"),),
        signature="as quadratic drag of the casing, gentler",
        confused_with=("casing.air.quadratic", "casing.air.linear"),
        source=_DISC,
    ),
    Effect(
        "casing.windage",
        "casing",
        "k*omega_r*abs(omega_r)",
        (Parameter("k", "N m s2", meaning="air carried round by the rotor drives the casing"),),
        signature="the casing is driven early, long before its peak",
        confused_with=("bearing.load",),
        source="momentum of the air that the rotor throws against the casing",
    ),
)
