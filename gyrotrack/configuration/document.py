"""One TOML file and the model that it must fit."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from gyrotrack.configuration.lines import line_of
from gyrotrack.errors import ConfigurationError, GyrotrackError

Model = TypeVar("Model", bound=BaseModel)

MOST_BYTES = 2**20
_MOST_FAULTS = 8


def read_document(
    path: Path, model: type[Model], *, what: str, error: type[GyrotrackError] = ConfigurationError
) -> Model:
    """Read a TOML file and check it.

    Parameters
    ----------
    path : Path
        The file; at most 1 MB of text.
    model : type of pydantic.BaseModel
        What it must hold.
    what : str
        What the file is, for messages ("profile", "manifest").
    error : type of GyrotrackError
        What to raise.

    Raises
    ------
    GyrotrackError
        Of the class `error`: the file is missing, no TOML, or holds keys or values that are not understood; all
        of them are named at once, each with its line.
    """
    text = read_text(path, what=what, error=error)
    try:
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as fault:
        raise error(f"{path} is not valid TOML: {str(fault)[:200]}", "correct the line named") from fault
    return check(data, model, what=what, where=str(path), text=text, error=error)


def read_text(path: Path, *, what: str, error: type[GyrotrackError]) -> str:
    """Return the text of a file of moderate size; errors as for `read_document`."""
    try:
        if path.is_file() and path.stat().st_size > MOST_BYTES:
            raise error(f"{path} is too large to be a {what}", "check the name of the file")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as fault:
        raise error(f"there is no {what} {path}", "check the path") from fault
    except (OSError, UnicodeDecodeError) as fault:
        raise error(f"{path} cannot be read as a text file", f"give a {what} in TOML") from fault


def check(
    data: dict[str, Any],
    model: type[Model],
    *,
    what: str,
    where: str,
    text: str = "",
    error: type[GyrotrackError] = ConfigurationError,
) -> Model:
    """Return `data` as `model`; `text` is the TOML that it came from, to name lines."""
    try:
        return model.model_validate(data)
    except ValidationError as fault:
        found = [_told(dict(one), text, what) for one in fault.errors()]
        more = f"; and {len(found) - _MOST_FAULTS} more" if len(found) > _MOST_FAULTS else ""
        raise error(f"{where}: {'; '.join(found[:_MOST_FAULTS])}{more}", "correct these keys") from fault


def _told(fault: dict[str, Any], text: str, what: str) -> str:
    location = tuple(fault["loc"])
    line = line_of(text, location)
    place = f"line {line}, " if line else ""
    return f"{place}{_path(location) or what}: {_plain(fault['msg'])}"


def _path(location: tuple[int | str, ...]) -> str:
    parts = [f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in location]
    return "".join(parts).lstrip(".")[:120]


def _plain(message: str) -> str:
    text = message.removeprefix("Value error, ")
    return text[:1].lower() + text[1:]
