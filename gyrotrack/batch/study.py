"""An experimenter's notes beside the films of one run: `study.toml`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from gyrotrack.batch.experiment import Clip, Experiment
from gyrotrack.configuration import read_document


class Film(BaseModel):
    """One film."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: str
    body: Literal["casing", "rotor"]
    capture_fps: float | None = Field(default=None, gt=0)
    profile: str | None = None


class Study(BaseModel):
    """The notes."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    label: str = Field(min_length=1, max_length=120)
    surface: str = ""
    inertia_rotor: float | None = Field(default=None, gt=0)
    inertia_casing: float | None = Field(default=None, gt=0)
    clip: tuple[Film, ...] = Field(min_length=1, max_length=100)


def read_study(path: Path) -> Experiment:
    """Read the notes of one run; the films are looked for beside them.

    Raises
    ------
    ConfigurationError
        Naming line and key of every fault.
    """
    study = read_document(path, Study, what="study")
    root = path.resolve().parent
    clips = tuple(
        Clip(root / c.file, c.body, c.capture_fps, root / c.profile if c.profile is not None else None)
        for c in sorted(study.clip, key=lambda c: c.body)
    )
    return Experiment(
        study.label,
        clips,
        surface=study.surface,
        inertia_rotor=study.inertia_rotor,
        inertia_casing=study.inertia_casing,
    )
