"""TOML files written by users: the size is limited, the content validated, and every error has line and key."""

from __future__ import annotations

import re
import stat
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from gyrotrack._errors import ConfigurationError, GyrotrackError

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(
    r"""^\s*((?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*'))*)\s*="""
)


def line_of(text: str, location: tuple[int | str, ...]) -> int | None:
    """Return the line (from 1) of the key at `location`; if it is not found, the line of the nearest enclosing table.

    A location consists of keys, and of indices in arrays of tables: ``("clip", 1, "file")``. The function scans lines
    and is not a parser. For keys of inline tables, it returns the line of the table. It may mistake a line within a
    multi-line string for a key.
    """
    places: dict[tuple[int | str, ...], int] = {}
    counts: dict[tuple[str, ...], int] = {}
    table: tuple[int | str, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if (head := _HEADER.match(line)) is not None:
            names = _parts(head[2])
            if head[1] == "[[":
                counts[names] = counts.get(names, -1) + 1
                # count the arrays within a new element from zero
                for inner in [n for n in counts if n[: len(names)] == names and n != names]:
                    del counts[inner]
            table = _within(names, counts)
            places.setdefault(table, number)
        elif (key := _KEY.match(line)) is not None:
            places.setdefault((*table, *_parts(key[1])), number)
    # an element of an inline array has the line of the array
    known = [location[:n] for n in range(len(location), 0, -1)]
    return next((places[k] for k in known if k in places), None)


def _within(names: tuple[str, ...], counts: dict[tuple[str, ...], int]) -> tuple[int | str, ...]:
    made: list[int | str] = []
    for depth, name in enumerate(names, start=1):
        made.append(name)
        if names[:depth] in counts:
            made.append(counts[names[:depth]])
    return tuple(made)


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip().strip("\"'") for part in re.findall(r"\"[^\"]*\"|'[^']*'|[^.]+", dotted))


Model = TypeVar("Model", bound=BaseModel)

MOST_BYTES = 2**20
_MOST_FAULTS = 8


def read_document(
    path: Path, model: type[Model], *, what: str, error: type[GyrotrackError] = ConfigurationError
) -> Model:
    """Read a TOML file of at most 1 MB and validate it; an `error` lists the invalid keys with their lines."""
    text = read_text(path, what=what, error=error)
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as fault:  # a number with thousands of digits is also a ValueError
        raise error(f"{path} is not valid TOML: {str(fault)[:200]}.", "Correct this line.") from fault
    return check(data, model, what=what, where=str(path), text=text, error=error)


def read_text(path: Path, *, what: str, error: type[GyrotrackError]) -> str:
    """Return the text of a file of moderate size; raise the same errors as `read_document`."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # reading a named pipe could block forever
            raise error(f"{path} is not a regular file.", f"Give a {what} in TOML.")
        if status.st_size > MOST_BYTES:
            raise error(f"{path} is too large to be a {what}.", "Check the name of the file.")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as fault:
        raise error(f"There is no {what} {path}.", "Check the path.") from fault
    except (OSError, UnicodeDecodeError) as fault:
        raise error(f"{path} cannot be read as a text file.", f"Give a {what} in TOML.") from fault


def check(
    data: dict[str, Any],
    model: type[Model],
    *,
    what: str,
    where: str,
    text: str = "",
    error: type[GyrotrackError] = ConfigurationError,
) -> Model:
    """Validate `data` against `model`; `text` is its TOML source, to report lines."""
    try:
        return model.model_validate(data)
    except ValidationError as fault:
        found = [_fault(dict(one), text, what) for one in fault.errors()]
        more = f"; and {len(found) - _MOST_FAULTS} more" if len(found) > _MOST_FAULTS else ""
        raise error(f"{where}: {'; '.join(found[:_MOST_FAULTS])}{more}.", "Correct these keys.") from fault


def _fault(fault: dict[str, Any], text: str, what: str) -> str:
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
