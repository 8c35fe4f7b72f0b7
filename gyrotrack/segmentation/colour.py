"""Named colours as directions of chroma, and how strongly a pixel has one of them.

In the chroma plane (U - U0, V - V0) a hue is a direction, whatever the brightness of the lamp. A name covers
a sector of +-45 degrees about its direction: "red" takes in dark red and orange-red, "blue" also cyan-blue,
"green" also yellow-green. The true shade is then measured in the clip.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]

Hue = Literal["red", "orange", "yellow", "green", "cyan", "blue", "magenta"]

_HUE_DEGREES: dict[str, float] = {
    "red": 108.0,
    "orange": 138.0,
    "yellow": 171.0,
    "green": 228.0,
    "cyan": 289.0,
    "blue": 333.0,
    "magenta": 52.0,
}


def chroma_direction(colour: str, hue: float | None = None) -> tuple[float, float]:
    """Return the unit vector (U, V) of a named colour, or of its exact `hue` in degrees if that is given.

    White has none and gives (0, 0).
    """
    if colour == "white":
        return (0.0, 0.0)
    angle = np.deg2rad(_HUE_DEGREES[colour] if hue is None else hue)
    return (float(np.cos(angle)), float(np.sin(angle)))


def nearest_colour(hue: float) -> Hue:
    """Return the name whose direction in the chroma plane is nearest to a hue in degrees."""

    def apart(name: str) -> float:
        return abs((hue - _HUE_DEGREES[name] + 180.0) % 360.0 - 180.0)

    names: tuple[Hue, ...] = get_args(Hue)
    return min(names, key=apart)


def hue_score(du: npt.ArrayLike, dv: npt.ArrayLike, direction: tuple[float, float]) -> Floats:
    """Return how far a chroma difference reaches into the sector of a hue.

    The score is p - |q|, with p the part of (du, dv) along the direction and q the part across it; it is
    positive within 45 degrees of the direction, and cut off at zero outside.
    """
    u, v = np.asarray(du, dtype=np.float32), np.asarray(dv, dtype=np.float32)
    along = direction[0] * u + direction[1] * v
    across = direction[0] * v - direction[1] * u
    score: Floats = np.maximum(along - np.abs(across), np.float32(0.0))
    return score


# below this length of the chroma vector (of 255) a colour has no hue to speak of
_LEAST_CHROMA = 14.0
_BRIGHT = 110.0


def colour_name(red: float, green: float, blue: float) -> str:
    """Return the name whose hue is nearest to a colour (0 to 255 each): white for bright grey, empty for dark.

    U and V are those of ITU-R BT.601.
    """
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    u, v = 0.564 * (blue - luma), 0.713 * (red - luma)
    if np.hypot(u, v) < _LEAST_CHROMA:
        return "white" if luma >= _BRIGHT else ""
    hue = np.degrees(np.arctan2(v, u))
    return min(_HUE_DEGREES, key=lambda name: abs((hue - _HUE_DEGREES[name] + 180.0) % 360.0 - 180.0))
