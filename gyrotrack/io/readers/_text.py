"""Text files of other programs: encoding, lines, and the header of a table."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io._atomic import refuse_special

MOST_BYTES = 2**30


def read_bytes(path: Path) -> bytes:
    """Return a file's bytes.

    Raises
    ------
    DatasetError
        It is missing, not a file, or far too large.
    """
    refuse_special(path)
    try:
        if path.stat().st_size > MOST_BYTES:
            raise DatasetError(
                f"{path} is larger than a table of angles can be.", "Check the name of the file."
            )
        return path.read_bytes()
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist.", "Check the name.") from error
    except OSError as error:
        raise DatasetError(
            f"{path} cannot be read: {error.strerror}.", "Give the name of a CSV file."
        ) from error


def content_lines(path: Path, content: bytes) -> list[tuple[int, str]]:
    """Return the lines that are neither blank nor comments, each with its number.

    Raises
    ------
    DatasetError
        It is no text.
    """
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = content.decode("utf-16", errors="replace")
    elif b"\0" in content:
        raise DatasetError(
            f"{path} is not a table of text.", "Give a CSV file; films go through `gyrotrack extract`."
        )
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
    lines = enumerate(text.splitlines(), start=1)
    return [(number, line) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]


def split(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line, without blanks and quotes around them."""
    return [cell.strip().strip('"').strip() for cell in line.split(delimiter)]


def delimiter_of(line: str) -> str | None:
    """Return what parts the cells of a header: semicolon, tab or comma, else blanks (None)."""
    return next((d for d in (";", "\t", ",") if d in line), None)


EXPECTED = "The header must be `t,angle`, `t,angle,sigma`, `t,omega` or `t,omega,sigma`."

_NAMES = {
    "t": {"t", "time", "zeit"},
    "angle": {"angle", "psi", "phi", "theta", "ψ", "φ", "θ", "winkel"},
    "omega": {"omega", "w", "ω", "speed", "angular_velocity", "angularvelocity"},
    "sigma": {"sigma", "σ", "error", "err", "uncertainty", "std", "sd"},
}
_UNITS = {
    "t": {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "angle": {"": 1.0, "rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180},
    "omega": {"": 1.0, "rad/s": 1.0, "rads-1": 1.0, "s-1": 1.0, "1/s": 1.0, "rpm": math.pi / 30},
}
_UNITS["omega"] |= {"deg/s": math.pi / 180, "°/s": math.pi / 180, "rads^-1": 1.0, "rev/s": 2 * math.pi}


Names = Mapping[str, tuple[str, str | None]]
"""Which of our columns a header of the file means, and its unit if the header does not tell it."""


@dataclass(frozen=True)
class Header:
    """What the header says: the columns, the factors to SI units, and the quantity that was measured."""

    line: int
    delimiter: str | None
    width: int
    columns: dict[str, int]
    scales: dict[str, float]
    quantity: str
    notes: tuple[str, ...]


def read_names(given: Iterable[str]) -> Names:
    """Understand wishes such as ``t=Zeit`` or ``angle=phi [deg]``: our column, and theirs with its unit.

    Raises
    ------
    UsageError
        One is not of this form, or names no column of ours.
    """
    names: dict[str, tuple[str, str | None]] = {}
    for wish in given:
        ours, equals, theirs = (part.strip() for part in wish.partition("="))
        if not equals or ours not in _NAMES or not theirs:
            raise UsageError(
                f"{wish[:60]!r} is no column.", f"Write for example t=Zeit; ours are {', '.join(_NAMES)}."
            )
        bare = re.fullmatch(r"(.+?)\s*\[([^\[\]]*)\]", theirs)
        names[theirs.casefold()] = (ours, None)
        if bare is not None:
            names.setdefault(bare[1].casefold(), (ours, re.sub(r"[\s*·]", "", bare[2])))
    return names


def read_header(path: Path, number: int, text: str, named: Names | None = None) -> Header:
    """Understand the header, line `number` of the file.

    Raises
    ------
    DatasetError
        There is no header, or a column or unit is missing, doubled or unknown.
    """
    delimiter = next((d for d in (";", "\t", ",") if d in text), None)
    names = [cell.strip().strip('"').strip() for cell in text.split(delimiter)]
    if any(is_number(name) for name in names):
        raise DatasetError(f"{path}, line {number}: there is no header above the numbers.", EXPECTED)
    columns: dict[str, int] = {}
    units: dict[str, str] = {}
    strange = []
    for position, name in enumerate(names):
        known, unit = _identify(name, named or {})
        if known is None:
            strange.append(name)
        elif known in columns:
            raise DatasetError(f"{path}, line {number}: two columns are called '{known}'.", EXPECTED)
        else:
            columns[known], units[known] = position, unit
    quantity = "angle" if "angle" in columns else "omega"
    if "t" not in columns or quantity not in columns:
        missing = "time" if "t" not in columns else "angle or omega"
        raise DatasetError(f"{path}, line {number}: there is no column for the {missing}.", EXPECTED)
    if quantity == "angle" and columns.pop("omega", None) is not None:
        strange.append("omega")
    scales = {name: _scale(path, number, name, units[name], quantity) for name in columns}
    if "sigma" in columns and not units["sigma"]:
        scales["sigma"] = scales[quantity]
    notes = (f"{path.name}: ignored the column(s) {', '.join(map(repr, strange))}",) if strange else ()
    return Header(number, delimiter, len(names), columns, scales, quantity, notes)


def _identify(name: str, named: Names) -> tuple[str | None, str]:
    """Split ``t [s]``, ``t (s)`` or ``t / s`` and return our name for the column and its unit.

    Where the user has said what columns mean, only those count.
    """
    if named:
        told = named.get(name.casefold())
        if told is None:
            return None, ""
        return told[0], told[1] if told[1] is not None else _identify(name, {})[1]
    match = re.fullmatch(r"([^\[\](){}/]+?)\s*(?:[\[({]\s*(.*?)\s*[\])}]|/\s*(.*))?", name)
    word, unit = (match[1], match[2] or match[3] or "") if match else (name, "")
    word = word.strip().lower().replace(" ", "_")
    if word.startswith(("sigma_", "err_", "d_")) or word.endswith(("_sigma", "_err", "_error")):
        word = "sigma"
    known = next((ours for ours, theirs in _NAMES.items() if word in theirs), None)
    return known, re.sub(r"[\s*·]", "", unit)


def _scale(path: Path, number: int, name: str, unit: str, quantity: str) -> float:
    table = _UNITS[quantity if name == "sigma" else name]
    scale = table.get(unit, table.get(unit.lower()))
    if scale is None:
        known = ", ".join(u for u in table if u)
        raise DatasetError(f"{path}, line {number}: the unit '{unit}' is not known.", f"Use one of {known}.")
    return scale


def is_number(text: str) -> bool:
    """Tell whether a cell is a number as other programs write them."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
