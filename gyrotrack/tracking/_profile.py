"""The marker profile of a scene: names, colours and bodies of the markers, and the mark at the centre.

A profile names colours; sizes, radii and exact shades of the markers are measured in the clip. The default is the
gyroscope of the paper. A profile is a TOML file::

    name = "bicycle wheel"
    centre = "orbit"            # no mark at the centre: it is found from the paths of the markers
    capture_fps = 300           # optional
    sense = -1                  # optional: -1 turns clockwise as seen, +1 counter-clockwise
    wander = false              # optional: whether the centre of an orbit may move; by default only if it moves far
    tilt_correction = true      # optional: correct the angles for the tilt of the camera

    [[marker]]
    name = "tape"
    colour = "green"            # red, orange, yellow, green, cyan, blue, magenta, white
    body = "rotor"              # casing or rotor
    hue = 231.5                 # optional, degrees in the (U, V) plane: the exact shade
    mount_angle = 0.0           # optional, rad: fixes the zero of the body; by default the first marker does

In the chroma plane (U - U0, V - V0) a hue is a direction that does not depend on the brightness. A name covers a sector
of +-45 degrees about its direction: "red" includes dark red and orange-red, "blue" also cyan-blue, "green" also
yellow-green. The exact hue is then measured in the clip.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from gyrotrack._arrays import Singles
from gyrotrack._errors import ProfileError
from gyrotrack._toml import check, read_document


@contextmanager
def single_threaded() -> Iterator[None]:
    """Run OpenCV only in the calling thread within the block."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


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
"""Directions of the named colours in the chroma plane (U, V) [degrees]. Derived: red, yellow, cyan and magenta of ITU-R
BT.601, orange between red and yellow; green is 4 degrees nearer to yellow, blue 18 degrees nearer to cyan."""


def chroma_direction(colour: str, hue: float | None = None) -> tuple[float, float]:
    """Return the unit vector (U, V) of a named colour, or of its exact `hue` in degrees; (0, 0) for white."""
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


def hue_score(du: npt.ArrayLike, dv: npt.ArrayLike, direction: tuple[float, float]) -> Singles:
    """Return p - |q| for chroma differences with parts p along and q across the direction; 0 beyond 45 degrees."""
    u, v = np.asarray(du, dtype=np.float32), np.asarray(dv, dtype=np.float32)
    along = direction[0] * u + direction[1] * v
    across = direction[0] * v - direction[1] * u
    score: Singles = np.maximum(along - np.abs(across), np.float32(0.0))
    return score


_LEAST_CHROMA = 14.0
"""Smallest length of the chroma vector of a colour with a hue [grey levels]. Chosen: a smaller value names the tint of
a lamp, a larger one calls faint colours white."""
_BRIGHT = 110.0
"""Smallest luma of a white patch without a hue [grey levels]. Chosen: a smaller value calls metal white, a larger one
calls shaded paper dark."""
_LEAST_AREA = 3
"""Smallest area of a patch of colour [pixels]. Chosen: a smaller value finds noise, a larger one loses small
markers."""


def colour_name(red: float, green: float, blue: float) -> str:
    """Return the name with the nearest hue (ITU-R BT.601) to a colour, 0 to 255: white if bright grey, "" if dark."""
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    u, v = 0.564 * (blue - luma), 0.713 * (red - luma)
    if np.hypot(u, v) < _LEAST_CHROMA:
        return "white" if luma >= _BRIGHT else ""
    return nearest_colour(float(np.degrees(np.arctan2(v, u))))


@dataclass(frozen=True)
class Blob:
    """A connected patch of one colour."""

    # centroid, weighted by score, in px of the score image
    x: float
    y: float
    area: int  # pixels above the threshold
    weight: float  # sum of the scores of these pixels
    # ratio of the area to the area of the smallest circle with the same extent: 1 for a disc, less for rectangles and
    # arcs
    fill: float


def find_blobs(score: Singles, threshold: float, most: int = 4) -> list[Blob]:
    """Find the strongest connected patches above a threshold, strongest first."""
    mask = (score > threshold).astype(np.uint8)
    count, found_labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    labels = np.asarray(found_labels, dtype=np.int32)
    areas = stats[1:count, cv2.CC_STAT_AREA]
    found = []
    for label in (np.argsort(-areas)[: 4 * most] + 1).tolist():
        if areas[label - 1] < _LEAST_AREA:
            break
        found.append(_blob(score, labels, np.asarray(stats[label], dtype=np.int32), label))
    return sorted(found, key=lambda blob: -blob.weight)[:most]


def _blob(score: Singles, labels: npt.NDArray[np.int32], box: npt.NDArray[np.int32], label: int) -> Blob:
    left, top, width, height, area = (int(v) for v in box)
    window = (slice(top, top + height), slice(left, left + width))
    weights = np.where(labels[window] == label, score[window], np.float32(0.0)).astype(np.float64)
    total = float(weights.sum())
    x = left + float(weights.sum(axis=0) @ np.arange(width)) / total
    y = top + float(weights.sum(axis=1) @ np.arange(height)) / total
    fill = 4.0 * area / (np.pi * max(width, height) ** 2)
    return Blob(x, y, area, total, fill)


_ANY_MARKS = (  # alternative without a profile
    "a single body with any marks is tracked by `gyrotrack spindown FILM --hub X,Y` "
    '("single body" in the workbench)'
)
Colour = Literal["red", "orange", "yellow", "green", "cyan", "blue", "magenta", "white"]
Body = Literal["casing", "rotor"]


class MarkerProfile(BaseModel):
    """One marker: a piece of coloured paper or tape on one of the bodies."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9_\-]+$")  #: Name.
    colour: Colour  #: Colour.
    body: Body  #: Body that carries the marker.
    #: Hue; null: the hue of the named colour [degrees].
    hue: float | None = Field(default=None, ge=0.0, lt=360.0)
    #: Angle of the marker on the body, which fixes the zero of the body; null: measured [rad].
    mount_angle: float | None = None


class Profile(BaseModel):
    """A scene: the markers, and the mark at the centre.

    `centre` is the colour of a disc at the centre (or the word ``"circle"`` for a red disc), or ``"orbit"`` if the
    centre has no mark. `hub`, (x, y) in px, is a given centre.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = "custom"  #: Name of the scene.
    marker: tuple[MarkerProfile, ...] = Field(min_length=1)  #: Markers.
    centre: Literal["circle", "orbit"] = "circle"  #: A disc at the centre, or the orbit of the markers.
    circle_colour: Colour = "red"  #: Colour of the disc.
    circle_hue: float | None = Field(default=None, ge=0.0, lt=360.0)  #: Hue of the disc [degrees].
    hub: tuple[float, float] | None = None  #: Given centre, x and y [px].
    capture_fps: float | None = Field(default=None, gt=0.0, lt=1.0e7)  #: Capture rate of the camera [s-1].
    sense: Literal[-1, 1] | None = None  #: Given sense of rotation; null: measured.
    wander: bool | None = None  #: Whether the centre of an orbit may move; null: only if it moves far.
    tilt_correction: bool = True  #: Whether the angles are corrected for the tilt of the camera.

    @field_validator("marker")
    @classmethod
    def _names_differ(cls, value: tuple[MarkerProfile, ...]) -> tuple[MarkerProfile, ...]:
        names = [marker.name for marker in value]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two markers are named {twice[0]!r}")
        return value

    @model_validator(mode="after")
    def _colours_differ(self) -> Profile:
        for body in ("casing", "rotor"):
            colours = [marker.colour for marker in self.marker if marker.body == body]
            if len(set(colours)) < len(colours):
                fault = f"two markers on the {body} have the same colour and are indistinguishable"
                raise ValueError(f"{fault}; {_ANY_MARKS}")
            if colours == ["white"]:
                raise ValueError(
                    f"the {body} has only a white marker; it needs a coloured one too; {_ANY_MARKS}"
                )
        return self

    def of(self, body: str) -> tuple[MarkerProfile, ...]:
        """Return the markers of one body.

        Parameters
        ----------
        body : {"casing", "rotor"}
            The body.
        """
        return tuple(marker for marker in self.marker if marker.body == body)


# the gyroscope of the paper: red disc at the centre, red on the casing, three colours on the rotor
PAPER = Profile(
    name="paper",
    centre="circle",
    marker=(
        MarkerProfile(name="red", colour="red", body="casing"),
        MarkerProfile(name="blue", colour="blue", body="rotor"),
        MarkerProfile(name="white", colour="white", body="rotor"),
        MarkerProfile(name="green", colour="green", body="rotor"),
    ),
)


def load(path: Path) -> Profile:
    """Read a profile from a TOML file; a ProfileError names every wrong key with its line."""
    return read_document(path, Profile, what="profile", error=ProfileError)


def parse(data: dict[str, Any], where: str) -> Profile:
    """Check the content of a profile; `where` names its origin in messages."""
    return check(data, Profile, what="profile", where=where, error=ProfileError)


def to_toml(profile: Profile) -> str:
    """Write a profile as TOML text, from which `load` restores the same profile."""
    own = {"name": profile.name, "centre": profile.centre}
    own |= profile.model_dump(exclude={"marker"}, exclude_defaults=True)
    tables = [marker.model_dump(exclude_none=True) for marker in profile.marker]
    return "\n[[marker]]\n".join(map(_entries, (own, *tables)))


def _entries(values: dict[str, Any]) -> str:
    """Return the lines of a TOML table; strings, numbers and lists have the same form as in JSON."""
    return "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in values.items())
