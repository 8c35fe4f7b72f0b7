"""Experiments of a batch, read from a manifest or a folder.

docs/how-to/batch.md describes the names of films in a folder, and the manifests in TOML and CSV.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from gyrotrack._errors import ConfigurationError, UsageError
from gyrotrack._toml import check, read_document, read_text
from gyrotrack.io._records import Inertia

Body = Literal["casing", "rotor", ""]

FILMS = {".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".cih"}
_DEVICES = {"con", "prn", "aux", "nul", *(f"{d}{n}" for d in ("com", "lpt") for n in range(1, 10))}


@dataclass(frozen=True)
class Clip:
    """One film: the tracked body ("" for a single film), its capture rate [fps], its profile."""

    file: Path
    body: Body = ""
    capture_fps: float | None = None
    profile: Path | None = None


@dataclass(frozen=True)
class Experiment:
    """One case to be processed."""

    label: str  # name of the case
    # one film of the casing and one or more films of the rotor, or a single film that is only tracked
    clips: tuple[Clip, ...] = ()
    data: Path | None = None  # an existing case file instead of films
    surface: str = ""  # surface on which the casing turns
    # moments of inertia as texts, in the format of `gyrotrack.io._records.Inertia`
    inertia_rotor: str | None = None
    inertia_casing: str | None = None
    folder: str = ""  # unique name of the folder of results

    @property
    def alone(self) -> bool:
        """Whether the experiment is a single film, which is only tracked."""
        return self.data is None and all(c.body == "" for c in self.clips)


def with_folders(experiments: Iterable[Experiment], where: Path) -> tuple[Experiment, ...]:
    """Assign a unique folder name to each experiment.

    Check that the experiments are complete and have different labels.
    """
    found, folders, labels = [], set[str](), set[str]()
    for e in experiments:
        if e.label in labels:
            what = f"{where}: two cases have the label '{e.label[:60]}'."
            raise ConfigurationError(what, "Give each case a different label.")
        labels.add(e.label)
        _check_films(e, where)
        found.append(replace(e, folder=unique_name(e.label, folders)))
    if not found:
        raise ConfigurationError(
            f"{where} contains no film and no case.",
            "Put the films of a case in one folder, as casing.mp4 and rotor_1.mp4, or list them in a manifest.",
        )
    return tuple(found)


def _check_films(e: Experiment, where: Path) -> None:
    casings = sum(c.body == "casing" for c in e.clips)
    if e.data is None and not e.alone and (casings != 1 or len(e.clips) < 2):
        raise ConfigurationError(
            f"{where}: the case '{e.label[:60]}' has {casings} films of the casing and "
            f"{len(e.clips) - casings} of the rotor.",
            "A case needs one film of the casing and at least one of the rotor.",
        )


def folder_name(label: str) -> str:
    """Convert a label to the name of a folder: letters, digits and ``._-`` only, not the name of a device."""
    name = re.sub(r"[^A-Za-z0-9._-]+", "_", label).strip("._-")[:80] or "case"
    return f"{name}_" if name.partition(".")[0].casefold() in _DEVICES else name


def unique_name(label: str, taken: set[str]) -> str:
    """Return a folder name for a label, different from the names in `taken`, and add it to `taken`."""
    name = stem = folder_name(label)
    number = 1
    while name.casefold() in taken:
        number += 1
        name = f"{stem}_{number}"
    taken.add(name.casefold())
    return name


def with_inertias(
    experiments: Iterable[Experiment], given: Mapping[str, str | None], skip: Collection[str] = ()
) -> tuple[Experiment, ...]:
    """Set missing inertias of experiments to the values `given` by body; options in `skip` may be missing."""
    made = []
    for e in experiments:
        own: dict[str, Any] = {}
        for body in ("rotor", "casing") if e.data is None and not e.alone else ():
            own[f"inertia_{body}"] = text = getattr(e, f"inertia_{body}") or given[body]
            if text is not None:
                Inertia.of(text, body)
            elif f"--inertia-{body}" not in skip:
                raise UsageError(
                    f"The moment of inertia of the {body} of the case '{e.label[:60]}' is not given.",
                    f"Write inertia_{body} in the manifest or study.toml, or give --inertia-{body}.",
                )
        made.append(replace(e, **own))
    return tuple(made)


def _inertia_text(value: Any) -> str | None:
    if value is None:
        return None
    text = value if isinstance(value, str) else repr(value)
    try:
        Inertia.of(text)
    except UsageError as error:
        raise ValueError(error.message) from None
    return text


InertiaText = Annotated[str | None, BeforeValidator(_inertia_text)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Film(_Strict):
    """One film."""

    file: str
    body: Literal["casing", "rotor"]
    capture_fps: float | None = Field(default=None, gt=0)
    profile: str | None = None


class Study(_Strict):
    """A study file (``study.toml``)."""

    label: str = Field(min_length=1, max_length=120)
    surface: str = ""
    inertia_rotor: InertiaText = None
    inertia_casing: InertiaText = None
    clip: tuple[Film, ...] = Field(min_length=1, max_length=100)


def read_study(path: Path) -> Experiment:
    """Read a study file; the paths of its films are relative to its folder."""
    study = read_document(path, Study, what="study")
    root = path.resolve().parent
    clips = tuple(
        Clip(root / c.file, c.body, c.capture_fps, root / c.profile if c.profile is not None else None)
        for c in sorted(study.clip, key=lambda c: c.body)
    )
    return Experiment(study.label, clips, None, study.surface, study.inertia_rotor, study.inertia_casing)


_RULE = re.compile(r"(?:(?P<label>.+?)[ _-])?(?P<body>casing|rotor)(?![a-z]).*", re.IGNORECASE)
STATED_RATE = re.compile(r"(?<![0-9.])(\d{2,5}(?:\.\d+)?) ?fps", re.IGNORECASE)


def read_folder(
    root: Path, *, casing_fps: float | None = None, rotor_fps: float | None = None, skip: Path | None = None
) -> tuple[Experiment, ...]:
    """Find the experiments in a folder, but not in hidden folders, links and `skip`. Both rates are default values."""
    if not root.is_dir():
        raise ConfigurationError(f"There is no folder {root}.", "Check the path.")
    rates = {"casing": casing_fps, "rotor": rotor_fps, "": None}
    top, avoid = root.resolve(), skip.resolve() if skip is not None else None
    found: list[Experiment] = []
    for place, folders, files in os.walk(top):
        here = Path(place)
        folders[:] = sorted(f for f in folders if not f.startswith(".") and here / f != avoid)
        if "study.toml" in files:
            found.append(read_study(here / "study.toml"))
            continue
        films = sorted(f for f in files if Path(f).suffix.lower() in FILMS and not f.startswith("."))
        found += _experiments_in(here, top, films, rates)
    return with_folders(found, root)


def _experiments_in(
    here: Path, top: Path, films: list[str], rates: dict[str, float | None]
) -> list[Experiment]:
    relative = here.relative_to(top).as_posix() if here != top else ""
    cases: dict[str, list[Clip]] = {}
    alone: list[Experiment] = []
    for film in films:
        stem = Path(film).stem
        rule = _RULE.fullmatch(stem)
        body: Body = rule["body"].lower() if rule else ""  # type: ignore[assignment]
        stated = STATED_RATE.search(stem)
        clip = Clip(here / film, body, float(stated[1]) if stated else rates[body])
        if rule is None:
            alone.append(Experiment("/".join(filter(None, (relative, stem))), (clip,)))
        else:
            label = "/".join(filter(None, (relative, rule["label"]))) or here.name
            cases.setdefault(label, []).append(clip)
    made = []
    for label, clips in cases.items():
        clips.sort(key=lambda c: c.body)  # the casing first
        bodies = [c.body for c in clips]
        if bodies.count("casing") == 1 and "rotor" in bodies:
            made.append(Experiment(label, tuple(clips)))
        else:  # incomplete case: the films are only tracked
            alone += [Experiment(f"{label}/{c.file.stem}", (replace(c, body=""),)) for c in clips]
    return [*made, *alone]


MOST = 100_000


class _Facts(_Strict):
    profile: str | None = None
    surface: str | None = None
    inertia_rotor: InertiaText = None
    inertia_casing: InertiaText = None


class Defaults(_Facts):
    """Values for every case and film without its own values."""

    casing_fps: float | None = Field(default=None, gt=0)
    rotor_fps: float | None = Field(default=None, gt=0)


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
            raise ValueError("a case needs exactly one of: films (casing, rotor), a study, data")
        if films and (self.casing is None or not self.rotor):
            raise ValueError("a case needs one film of the casing and at least one of the rotor")
        return self


class ClipEntry(_Strict):
    """A single film."""

    file: str
    label: str | None = Field(default=None, min_length=1, max_length=120)
    capture_fps: float | None = Field(default=None, gt=0)
    profile: str | None = None


class Manifest(_Strict):
    """A manifest."""

    defaults: Defaults = Defaults()
    case: tuple[CaseEntry, ...] = Field(default=(), max_length=MOST)
    clip: tuple[ClipEntry, ...] = Field(default=(), max_length=MOST)


class _Row(_Facts):
    """One row of a CSV manifest."""

    case: str = ""
    body: Body = ""
    file: str = Field(min_length=1)
    capture_fps: float | None = Field(default=None, gt=0)


def read_manifest(path: Path) -> tuple[Experiment, ...]:
    """Read a manifest in TOML or CSV.

    Films are checked only when they are opened, so an unreadable film does not stop the batch.
    """
    if path.suffix.lower() == ".csv":
        return with_folders(_from_rows(path), path)
    manifest = read_document(path, Manifest, what="manifest")
    root = path.resolve().parent
    cases = [_case(root, entry, manifest.defaults, i) for i, entry in enumerate(manifest.case, 1)]
    for c in manifest.clip:
        profile = _resolved(root, c.profile or manifest.defaults.profile)
        clip = Clip(root / c.file, "", c.capture_fps, profile)
        cases.append(Experiment(c.label or Path(c.file).stem, (clip,)))
    return with_folders(cases, path)


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
    profile = _resolved(root, value("profile"))
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
        what = f"{path}, line {reader.line_num}: {error}."
        raise ConfigurationError(what, "Write the manifest as plain CSV.") from error

    def clip(r: _Row, body: Body) -> Clip:
        return Clip(root / r.file, body, r.capture_fps, _resolved(root, r.profile))

    made = [Experiment(Path(r.file).stem, (clip(r, ""),)) for r in rows if not r.case]
    shared = sorted((r for r in rows if r.case), key=lambda r: (r.case, r.body))
    for label, group in groupby(shared, key=lambda r: r.case):
        films = list(group)
        facts: dict[str, Any] = {
            name: next((v for r in films if (v := getattr(r, name)) is not None), None)
            for name in ("surface", "inertia_rotor", "inertia_casing")
        }
        facts["surface"] = facts["surface"] or ""
        made.append(Experiment(label, tuple(clip(r, r.body) for r in films), **facts))
    return made


def _resolved(root: Path, name: str | None) -> Path | None:
    return root / name if name is not None else None
