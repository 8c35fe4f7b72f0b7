"""The experiments in a folder, by the names of the films.

A folder with ``study.toml`` is that study. Else ``casing*`` and ``rotor*`` in one folder are the case of the
folder's name, ``NAME_casing*`` and ``NAME_rotor*`` the case NAME, and any other film stands on its own. A
capture rate may stand in the name of a film, as in ``rotor_1_1000fps.mp4``.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from gyrotrack.batch.experiment import FILMS, Body, Clip, Experiment, named
from gyrotrack.batch.study import read_study
from gyrotrack.errors import ConfigurationError

_RULE = re.compile(r"(?:(?P<label>.+?)[ _-])?(?P<body>casing|rotor)(?![a-z]).*", re.IGNORECASE)
_RATE = re.compile(r"(?<![0-9.])(\d{2,5}(?:\.\d+)?) ?fps", re.IGNORECASE)


def read_folder(
    root: Path, *, casing_fps: float | None = None, rotor_fps: float | None = None, skip: Path | None = None
) -> tuple[Experiment, ...]:
    """Find the experiments below a folder.

    Parameters
    ----------
    root : Path
        The folder; hidden folders, and links to folders, are left out.
    casing_fps, rotor_fps : float, optional
        Capture rates of films whose names tell none.
    skip : Path, optional
        The folder of the results, which may lie inside.

    Raises
    ------
    ConfigurationError
        It holds no film, or films of a case that is not complete.
    """
    if not root.is_dir():
        raise ConfigurationError(f"there is no folder {root}", "check the path")
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
        found += _in_one_folder(here, top, films, rates)
    return named(found, root)


def _in_one_folder(
    here: Path, top: Path, films: list[str], rates: dict[str, float | None]
) -> list[Experiment]:
    relative = here.relative_to(top).as_posix() if here != top else ""
    cases: dict[str, list[Clip]] = {}
    alone: list[Experiment] = []
    for film in films:
        stem = Path(film).stem
        rule = _RULE.fullmatch(stem)
        body: Body = rule["body"].lower() if rule else ""  # type: ignore[assignment]
        told = _RATE.search(stem)
        clip = Clip(here / film, body, float(told[1]) if told else rates[body])
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
        else:  # no case can be made of them, but they can be tracked
            alone += [
                Experiment(f"{label}/{c.file.stem}", (Clip(c.file, "", c.capture_fps, c.profile),))
                for c in clips
            ]
    return [*made, *alone]
