"""What a batch works on: experiments, each with its films, checked and with absolute paths."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gyrotrack.errors import ConfigurationError

Body = Literal["casing", "rotor", ""]

FILMS = {".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi"}
_DEVICES = {"con", "prn", "aux", "nul", *(f"{d}{n}" for d in ("com", "lpt") for n in range(1, 10))}


@dataclass(frozen=True)
class Clip:
    """One film: the body that it is about ("" for a film on its own), its capture rate [fps], its profile."""

    file: Path
    body: Body = ""
    capture_fps: float | None = None
    profile: Path | None = None


@dataclass(frozen=True)
class Experiment:
    """One case to be made and studied.

    Attributes
    ----------
    label : str
        Its name for people.
    clips : tuple of Clip
        One of the casing and any number of the rotor, or a single film that is only tracked.
    data : Path or None
        A case file that exists already, in place of films.
    surface : str
        What the casing turned on.
    inertia_rotor, inertia_casing : float or None
        Moments of inertia [kg m2].
    folder : str
        Name of its folder among the results; unique.
    """

    label: str
    clips: tuple[Clip, ...] = ()
    data: Path | None = None
    surface: str = ""
    inertia_rotor: float | None = None
    inertia_casing: float | None = None
    folder: str = ""

    @property
    def alone(self) -> bool:
        """Whether it is a film on its own, which is tracked and nothing more."""
        return self.data is None and all(c.body == "" for c in self.clips)


def named(experiments: Iterable[Experiment], where: Path) -> tuple[Experiment, ...]:
    """Return the experiments with a folder each, whose names no label can lead out of the results.

    Raises
    ------
    ConfigurationError
        There is none, two have the same label, or one has not exactly one film of the casing.
    """
    found, folders = [], set[str]()
    labels: set[str] = set()
    for e in experiments:
        if e.label in labels:
            raise ConfigurationError(
                f"{where}: two cases are called '{e.label[:60]}'", "give each a label of its own"
            )
        labels.add(e.label)
        _check_films(e, where)
        folder = stem = folder_name(e.label)
        number = 1
        while folder.casefold() in folders:
            number += 1
            folder = f"{stem}_{number}"
        folders.add(folder.casefold())
        found.append(Experiment(**{**vars(e), "folder": folder}))
    if not found:
        raise ConfigurationError(
            f"{where} names no film and no case",
            "films are called casing.mp4 and rotor_1.mp4 in a folder a case, or are listed in a manifest",
        )
    return tuple(found)


def _check_films(e: Experiment, where: Path) -> None:
    casings = sum(c.body == "casing" for c in e.clips)
    if e.data is None and not e.alone and (casings != 1 or len(e.clips) < 2):
        raise ConfigurationError(
            f"{where}: the case '{e.label[:60]}' has {casings} films of the casing and "
            f"{len(e.clips) - casings} of the rotor",
            "a case has one film of the casing and at least one of the rotor",
        )


def folder_name(label: str) -> str:
    """Return a label as the name of a folder: letters, digits, ``._-`` only, no device of any system."""
    name = re.sub(r"[^A-Za-z0-9._-]+", "_", label).strip("._-")[:80] or "case"
    return f"{name}_" if name.partition(".")[0].casefold() in _DEVICES else name
