"""The library of physical and measurement effects: one law, one entry.

`Effect` is the noun of the package. Families stand in modules of their own (air, bearing, touchpoint,
casing, camera); `library.LIBRARY` lists them all; `user` reads effects that users write.
"""

from fitting.effects.effect import Effect, Parameter
from fitting.effects.library import GENERAL, LIBRARY, LINEAR, REDUCED, find
from fitting.effects.user import read_effects, resolve

__all__ = [
    "GENERAL",
    "LIBRARY",
    "LINEAR",
    "REDUCED",
    "Effect",
    "Parameter",
    "find",
    "read_effects",
    "resolve",
]
