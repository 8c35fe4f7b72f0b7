"""Manifests: the experiments of a batch as TOML or CSV.

::

    [defaults]                      # for every case and film that does not say otherwise
    casing_fps = 260
    rotor_fps = 1000

    [[case]]
    label = "pvc 1"
    casing = "pvc1/casing.mp4"
    rotor = ["pvc1/rotor_1.mp4", "pvc1/rotor_2.mp4"]
    surface = "PVC"

    [[case]]
    study = "paper/study.toml"      # an experimenter's notes beside the films

    [[case]]
    data = "old/case7.h5"           # a case that exists already

    [[clip]]                        # a film on its own: it is tracked, no more
    file = "wheel.mp4"
    capture_fps = 300
    profile = "wheel.toml"

The same as CSV is a row a film, with the columns ``case, body, file`` and, as far as wanted, ``capture_fps,
profile, surface, inertia_rotor, inertia_casing``. Paths are taken from the manifest's folder.
"""

from __future__ import annotations

import csv
import io
from itertools import groupby
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from gyrotrack.batch.experiment import Body, Clip, Experiment, named
from gyrotrack.batch.study import read_study
from gyrotrack.configuration import read_document
from gyrotrack.configuration.document import check, read_text
from gyrotrack.errors import ConfigurationError

MOST = 100_000


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Defaults(_Strict):
    """What holds for every case and film that does not say otherwise."""

    casing_fps: float | None = Field(default=None, gt=0)
    rotor_fps: float | None = Field(default=None, gt=0)
    profile: str | None = None
    surface: str | None = None
    inertia_rotor: float | None = Field(default=None, gt=0)
    inertia_casing: float | None = Field(default=None, gt=0)


class CaseEntry(Defaults):
    """One case: films, a study with its films, or a case file."""

    label: str | None = Field(default=None, min_length=1, max_length=120)
    casing: str | None = None
    rotor: tuple[str, ...] = ()
    study: str | None = None
    data: str | None = None

    @model_validator(mode="after")
    def _one_source(self) -> CaseEntry:
        films = self.casing is not None or bool(self.rotor)
        if films + (self.study is not None) + (self.data is not None) != 1:
            raise ValueError("a case has either films (casing, rotor), a study, or data")
        if films and (self.casing is None or not self.rotor):
            raise ValueError("a case has one film of the casing and at least one of the rotor")
        return self


class ClipEntry(_Strict):
    """A film on its own."""

    file: str
    label: str | None = Field(default=None, min_length=1, max_length=120)
    capture_fps: float | None = Field(default=None, gt=0)
    profile: str | None = None


class Manifest(_Strict):
    """The whole file."""

    defaults: Defaults = Defaults()
    case: tuple[CaseEntry, ...] = Field(default=(), max_length=MOST)
    clip: tuple[ClipEntry, ...] = Field(default=(), max_length=MOST)


class _Row(_Strict):
    """One row of a CSV manifest."""

    case: str = ""
    body: Body = ""
    file: str = Field(min_length=1)
    capture_fps: float | None = Field(default=None, gt=0)
    profile: str | None = None
    surface: str | None = None
    inertia_rotor: float | None = Field(default=None, gt=0)
    inertia_casing: float | None = Field(default=None, gt=0)


def read_manifest(path: Path) -> tuple[Experiment, ...]:
    """Read a manifest, TOML or (with the suffix ``.csv``) CSV.

    Raises
    ------
    ConfigurationError
        The file is not readable or something in it is not understood; line and key are named. Whether the films
        exist is seen only when each is opened, so that one that is missing stops no other.
    """
    if path.suffix.lower() == ".csv":
        return named(_from_rows(path), path)
    manifest = read_document(path, Manifest, what="manifest")
    root = path.resolve().parent
    cases = [_case(root, entry, manifest.defaults, i) for i, entry in enumerate(manifest.case, 1)]
    clips = [
        Experiment(
            c.label or Path(c.file).stem,
            (Clip(root / c.file, "", c.capture_fps, _at(root, c.profile or manifest.defaults.profile)),),
        )
        for c in manifest.clip
    ]
    return named([*cases, *clips], path)


def _case(root: Path, entry: CaseEntry, defaults: Defaults, number: int) -> Experiment:
    def value(name: str) -> Any:
        own = getattr(entry, name)
        return own if own is not None else getattr(defaults, name)

    numbers = {name: value(name) for name in ("inertia_rotor", "inertia_casing")}
    if entry.study is not None:
        noted = read_study(root / entry.study)
        given = {"label": entry.label, "surface": entry.surface, **numbers}
        return Experiment(**{**vars(noted), **{k: v for k, v in given.items() if v is not None}})
    surface = value("surface") or ""
    if entry.data is not None:
        return Experiment(entry.label or Path(entry.data).stem, data=root / entry.data, surface=surface)
    profile = _at(root, value("profile"))
    films = [Clip(root / str(entry.casing), "casing", value("casing_fps"), profile)]
    films += [Clip(root / f, "rotor", value("rotor_fps"), profile) for f in entry.rotor]
    return Experiment(entry.label or f"case {number}", tuple(films), surface=surface, **numbers)


def _from_rows(path: Path) -> list[Experiment]:
    root = path.resolve().parent
    text = read_text(path, what="manifest", error=ConfigurationError)
    first = text.partition("\n")[0]
    delimiter = next((d for d in (";", "\t") if d in first), ",")
    reader = csv.DictReader(io.StringIO(text), delimiter=delimiter, skipinitialspace=True, restkey="?")
    rows = []
    try:
        for cells in reader:
            given = {str(k).strip(): v for k, v in cells.items() if v is not None and v != ""}
            rows.append(check(given, _Row, what="row", where=f"{path}, line {reader.line_num}"))
    except csv.Error as error:
        raise ConfigurationError(
            f"{path}, line {reader.line_num}: {error}", "write the manifest as plain CSV"
        ) from error
    own = [r for r in rows if not r.case]
    made = [
        Experiment(Path(r.file).stem, (Clip(root / r.file, "", r.capture_fps, _at(root, r.profile)),))
        for r in own
    ]
    shared = sorted((r for r in rows if r.case), key=lambda r: r.case)
    for label, group in groupby(shared, key=lambda r: r.case):
        films = list(group)
        facts = {
            name: next((v for r in films if (v := getattr(r, name)) is not None), None)
            for name in ("surface", "inertia_rotor", "inertia_casing")
        }
        clips = tuple(
            Clip(root / r.file, r.body, r.capture_fps, _at(root, r.profile))
            for r in sorted(films, key=lambda r: r.body)
        )
        made.append(Experiment(label, clips, **{**facts, "surface": facts["surface"] or ""}))  # type: ignore[arg-type]
    return made


def _at(root: Path, name: str | None) -> Path | None:
    return root / name if name is not None else None
