"""The state of a work folder in the workbench: films and tables with settings and results, and all entries."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

FASTEST = 1e7  # upper limit of a capture rate [1/s]


class Pick(BaseModel):
    """A marker that was clicked in the first frame: position [px], name, colour and body."""

    model_config = ConfigDict(extra="forbid")

    x: FiniteFloat
    y: FiniteFloat
    name: str = Field(max_length=40)
    colour: str = Field(max_length=20)
    body: Literal["casing", "rotor"] = "casing"


_Key = Annotated[str, Field(pattern=r"^[1-9][0-9]{0,8}$")]
# text that becomes an argument of a command
_Text = Annotated[str, Field(max_length=120, pattern=r"^[^\x00-\x1f\x7f]*$")]
# output files: names without folder, so that a manipulated state file cannot name files outside of the work folder
_OwnFile = Annotated[str, Field(pattern=r"^([^-./\\\x00][^/\\\x00]{0,200}\.h5)?$")]
_OwnProfile = Annotated[str, Field(pattern=r"^([^-./\\\x00][^/\\\x00]{0,200}\.toml)?$")]


Body = Literal["", "casing", "rotor", "single"]


class Source(BaseModel):
    """One film, recording or table, with its settings and results."""

    model_config = ConfigDict(extra="forbid")

    key: _Key
    file: Annotated[str, Field(pattern=r"^[^\x00]+$")]
    kind: Literal["film", "recording", "table"]
    body: Body = ""
    capture_fps: Annotated[float, Field(gt=0, lt=FASTEST)] | None = None
    rate_from: str = ""
    profile: str = ""
    hub: tuple[FiniteFloat, FiniteFloat] | None = None
    picks: list[Pick] = Field(default_factory=list, max_length=20)
    disc: Annotated[str, Field(max_length=20)] = ""  # colour of a disc that marks the hub
    output: _OwnFile = ""
    marked: _OwnProfile = ""
    words: list[str] = Field(default_factory=list)
    result: dict[str, Any] = Field(default_factory=dict)


class State(BaseModel):
    """The content of ``workbench.json``."""

    model_config = ConfigDict(extra="forbid")

    version: Literal[1] = 1
    sources: list[Source] = Field(default_factory=list)
    inertia_rotor: _Text = ""
    inertia_casing: _Text = ""
    inertia: _Text = ""
    body_name: Annotated[str, Field(pattern=r"^([A-Za-z][A-Za-z0-9_]{0,40})?$")] = ""
    label: _Text = ""
    surface: _Text = ""
    case: _OwnFile = ""
    matched: list[str] = Field(default_factory=list)
    match: dict[str, Any] = Field(default_factory=dict)
    fitted: list[str] = Field(default_factory=list)
    fit: dict[str, Any] = Field(default_factory=dict)
    removed: list[Source] = Field(
        default_factory=list
    )  # removed sources with all their settings, for `restore`
    seconds: dict[str, FiniteFloat] = Field(default_factory=dict)  # duration of the last run of each step [s]
