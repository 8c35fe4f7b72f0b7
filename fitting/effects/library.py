"""All effects by name, and the models of the paper as sets of names."""

from __future__ import annotations

import difflib
from types import MappingProxyType

from fitting.effects.air import AIR
from fitting.effects.bearing import BEARING
from fitting.effects.camera import CAMERA, SETUP
from fitting.effects.casing import CASING
from fitting.effects.effect import Effect
from fitting.effects.touchpoint import TOUCHPOINT
from fitting.errors import EffectError

LIBRARY = MappingProxyType({e.name: e for e in (*AIR, *BEARING, *TOUCHPOINT, *CASING, *CAMERA, *SETUP)})

LINEAR = ("rotor.air.quadratic", "touchpoint.constant", "casing.air.linear", "bearing.linear")
REDUCED = (*LINEAR, "bearing.power")
GENERAL = (*REDUCED, "rotor.air.linear", "bearing.constant", "bearing.quadratic")


def find(name: str) -> Effect:
    """Return the effect of this name.

    Raises
    ------
    EffectError
        If there is none; the closest names are offered.
    """
    if name in LIBRARY:
        return LIBRARY[name]
    close = difflib.get_close_matches(name, LIBRARY, n=3, cutoff=0.4)
    raise EffectError(
        f"there is no effect named {name[:60]!r}",
        f"did you mean {' or '.join(close)}?" if close else "`gyrotrack effects` lists them all",
    )
