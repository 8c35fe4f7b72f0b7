"""Settings files: `gyrotrack.toml` and the user's own.

::

    [extract]
    capture_fps = 260
    profile = "lab.toml"        # paths are taken from the folder of this file

    [sync]
    inertia_rotor = 5.54e-5

The sections are the commands and the keys their options, written with ``_`` for ``-``.
"""

from __future__ import annotations

import os
import tomllib
import typing
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from gyrotrack._errors import ConfigurationError

if TYPE_CHECKING:
    from pydantic import BaseModel

    from gyrotrack.apps.cli._lazy import Entry


NAME = "gyrotrack.toml"
VARIABLE = "GYROTRACK_CONFIG"
NONE = "none"  # as a name of a file: there is none


@dataclass(frozen=True)
class Settings:
    """What a file says, by command and parameter, and the line on which it says it."""

    path: Path | None = None
    values: dict[str, dict[str, Any]] = field(default_factory=dict)
    lines: dict[tuple[str, str], int | None] = field(default_factory=dict)


def find(asked: Path | None = None) -> Path | None:
    """Return the file that holds: the one asked for, $GYROTRACK_CONFIG, ./gyrotrack.toml, or the user's.

    Raises
    ------
    ConfigurationError
        The file that was asked for is not there.
    """
    named = asked or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
    if named == Path(NONE):
        return None
    if named is not None:
        if not named.is_file():
            raise ConfigurationError(
                f"there is no settings file {named}", "check --config and $GYROTRACK_CONFIG"
            )
        return named
    base = Path(os.environ.get("XDG_CONFIG_HOME") or os.environ.get("APPDATA") or Path.home() / ".config")
    return next((p for p in (Path(NAME), base / "gyrotrack" / NAME) if p.is_file()), None)


def read(path: Path | None, entries: tuple[Entry, ...]) -> Settings:
    """Read a file of settings and check it against the options of all commands.

    Raises
    ------
    ConfigurationError
        Naming line and key of every fault.
    """
    if path is None:
        return Settings()
    from gyrotrack._toml import line_of, read_document, read_text

    document = read_document(path, _model(entries), what="settings file")
    text = read_text(path, what="settings file", error=ConfigurationError)
    said = tomllib.loads(text)
    options = {entry.name: options_of(entry) for entry in entries if entry.name in said}
    folder = path.resolve().parent
    values: dict[str, dict[str, Any]] = {}
    lines = {}
    for command, own in options.items():
        section = getattr(document, command)
        for name, key in own.items():
            if key in said[command]:
                values.setdefault(command, {})[name] = _plain(getattr(section, name), folder)
                lines[command, name] = line_of(text, (command, key))
    return Settings(path, values, lines)


def as_words(settings: Settings, entry: Entry, given: frozenset[str]) -> tuple[str, ...]:
    """Return the settings of a command as words of a command line, but for the keys that are `given` there."""
    keys = options_of(entry)
    words: list[str] = []
    for name, value in settings.values.get(entry.name, {}).items():
        option = f"--{keys[name].replace('_', '-')}"
        if keys[name] in given or value is False:
            continue
        items = value if isinstance(value, list) else [value]
        words += [option] if value is True else [f"{option}={item}" for item in items]
    return tuple(words)


def options_of(entry: Entry) -> dict[str, str]:
    """Return the options of a command: the parameter's name and the key in a file."""
    return {name: key for name, (key, _) in _options(entry).items()}


def _options(entry: Entry) -> dict[str, tuple[str, Any]]:
    from gyrotrack.apps.cli._lazy import function_of

    command = function_of(entry)
    hints = typing.get_type_hints(command, include_extras=True)
    found = {}
    for name, hint in hints.items():
        marks = [m for m in getattr(hint, "__metadata__", ()) if isinstance(m, typer.models.OptionInfo)]
        if marks:
            # in this form of annotation typer takes the first name for a default
            names = (marks[0].default, *(marks[0].param_decls or ()))
            words = [w for w in names if isinstance(w, str) and w.startswith("--")]
            key = (words[0] if words else f"--{name}").partition("/")[0].lstrip("-").replace("-", "_")
            found[name] = (key, typing.get_args(hint)[0])
    return found


def _model(entries: tuple[Entry, ...]) -> type[BaseModel]:
    from pydantic import ConfigDict, Field, create_model

    strict = ConfigDict(extra="forbid")
    sections: dict[str, Any] = {}
    for entry in entries:
        fields: dict[str, Any] = {
            name: (kind | None, Field(default=None, alias=key))
            for name, (key, kind) in _options(entry).items()
        }
        section = create_model(f"section_{entry.name}", __config__=strict, **fields)
        sections[entry.name] = (section | None, None)
    return create_model("settings", __config__=strict, **sections)


def _plain(value: Any, folder: Path) -> Any:
    if isinstance(value, Path):
        return str(folder / value)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, list):
        return [_plain(v, folder) for v in value]
    return value
