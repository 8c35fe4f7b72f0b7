"""The marker profile of a scene: names, colours, bodies, and the mark of the centre.

A profile names colours; how large the papers are, how far from the centre they sit and what exact shade they
have under the lamps is found in the clip itself. The default is the gyroscope of the paper. A profile is a
TOML file::

    name = "bicycle wheel"
    centre = "orbit"            # no mark at the centre: it is found from the markers' path
    capture_fps = 300           # optional
    sense = -1                  # optional: -1 turns clockwise as seen, +1 counter-clockwise
    wander = false              # optional: does the centre of an orbit move? if not said, only when it moves far
    tilt_correction = true      # optional: correct the angles for the slant of the camera

    [[marker]]
    name = "tape"
    colour = "green"            # red, orange, yellow, green, cyan, blue, magenta, white
    body = "rotor"              # casing or rotor
    hue = 231.5                 # optional, degrees in the (U, V) plane: the exact shade
    mount_angle = 0.0           # optional, rad: fixes the body's zero; else that is the first marker
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from gyrotrack._errors import ProfileError
from gyrotrack._toml import check, read_document

Colour = Literal["red", "orange", "yellow", "green", "cyan", "blue", "magenta", "white"]
Body = Literal["casing", "rotor"]


class MarkerProfile(BaseModel):
    """One marker: a piece of coloured paper or tape on one of the bodies."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9_\-]+$")
    colour: Colour
    body: Body
    hue: float | None = Field(default=None, ge=0.0, lt=360.0)
    mount_angle: float | None = None


class Profile(BaseModel):
    """A scene: its markers, and what marks the centre.

    `centre` is the colour of a disc at the centre (or the word ``"circle"``, a red one), or ``"orbit"`` where
    nothing marks it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = "custom"
    marker: tuple[MarkerProfile, ...] = Field(min_length=1)
    centre: Literal["circle", "orbit"] = "circle"
    circle_colour: Colour = "red"
    circle_hue: float | None = Field(default=None, ge=0.0, lt=360.0)
    capture_fps: float | None = Field(default=None, gt=0.0, lt=1.0e7)
    sense: Literal[-1, 1] | None = None
    wander: bool | None = None
    tilt_correction: bool = True

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
                raise ValueError(f"two markers on the {body} have the same colour and are indistinguishable")
            if colours == ["white"]:
                raise ValueError(f"the {body} has only a white marker; it needs a coloured one too")
        return self

    def of(self, body: str) -> tuple[MarkerProfile, ...]:
        """Return the markers of one body.

        Parameters
        ----------
        body : {"casing", "rotor"}
            The body.
        """
        return tuple(marker for marker in self.marker if marker.body == body)


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
"""The gyroscope of the paper: red disc at the centre, red on the casing, three colours on the rotor."""


def load(path: Path) -> Profile:
    """Read a profile from a TOML file.

    Raises
    ------
    ProfileError
        Naming the file and every key that is wrong, with its line.
    """
    return read_document(path, Profile, what="profile", error=ProfileError)


def parse(data: dict[str, Any], where: str) -> Profile:
    """Check a profile's content; `where` names its origin in messages."""
    return check(data, Profile, what="profile", where=where, error=ProfileError)


_WORDS = {"name", "colour", "body"}


def to_toml(profile: Profile) -> str:
    """Write a profile as TOML text that `load` reads back to the same profile."""
    lines = [f'name = "{_escaped(profile.name)}"', f'centre = "{profile.centre}"']
    if profile.circle_colour != "red":
        lines.append(f'circle_colour = "{profile.circle_colour}"')
    if profile.circle_hue is not None:
        lines.append(f"circle_hue = {profile.circle_hue!r}")
    if profile.capture_fps is not None:
        lines.append(f"capture_fps = {profile.capture_fps!r}")
    if profile.sense is not None:
        lines.append(f"sense = {profile.sense}")
    if profile.wander is not None:
        lines.append(f"wander = {str(profile.wander).lower()}")
    if not profile.tilt_correction:
        lines.append("tilt_correction = false")
    for marker in profile.marker:
        lines += ["", "[[marker]]"]
        lines += [f'{key} = "{value}"' for key, value in marker.model_dump(include=_WORDS).items()]
        if marker.hue is not None:
            lines.append(f"hue = {marker.hue!r}")
        if marker.mount_angle is not None:
            lines.append(f"mount_angle = {marker.mount_angle!r}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')
