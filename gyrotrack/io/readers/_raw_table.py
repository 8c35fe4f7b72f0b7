"""Tables before interpretation: named columns of numbers or text, and the parser of text files.

Text may be UTF-8, UTF-16 or Latin-1; cells may be separated by comma, semicolon, tab or blanks; a comma that is not the
separator is a decimal comma; comment lines with ``#``, lines above the header and units below it are accepted. Units in
a header, of seconds, angles and angular velocities, have factors to s, rad and rad/s.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import DatasetError
from gyrotrack.io._atomic import refuse_special
from gyrotrack.io._records import Floats, Integers

MAX_BYTES = 2**30
_MISSING = {"", "nan", "na", "n/a", "-", "none", "null", "#n/a"}

_QUOTED = re.compile(r'"[^"]*"')
# a comment after the last number of a line
_COMMENT = re.compile(r"(?<=[\d.])[\s,;]+#.*$")

Lines = Sequence[tuple[int, str]]
_MOST_SETTINGS = 10  # largest number of lines of settings between header and samples
_FEW_ROWS = 5  # largest number of rows of a transposed table, which has five times as many columns at least


@dataclass(frozen=True)
class RawTable:
    """The columns of a file."""

    path: Path  # the file
    # header of each column, and its unit if in a separate line; names are empty without a header
    names: tuple[str, ...]
    units: tuple[str, ...]
    # numbers (ndarray, shape (n,)) or cells of text (list of str), one per column
    columns: tuple[Floats | list[str], ...]
    line: Integers  # shape (n,); line of each sample in the file
    header_line: int = 0  # line of the header; 0 in files without lines
    decimal_comma: bool = False
    notes: tuple[str, ...] = field(default=())  # repairs made while reading
    sha256: str = ""  # hash of the file

    @property
    def headed(self) -> bool:
        """Whether the columns have names."""
        return any(self.names)

    @property
    def header_place(self) -> str:
        """The file, and the line of the header if it has lines, for messages."""
        return f"{self.path}, line {self.header_line}" if self.header_line else str(self.path)

    def numbers(self, index: int, name: str = "", *, times: bool = False) -> Floats:
        """Return a column as numbers; NaN for empty cells, and a DatasetError for cells of text."""
        column = self.columns[index]
        if isinstance(column, np.ndarray):
            return np.asarray(column, dtype=float)
        made = np.empty(len(column))
        for row, cell in enumerate(column):
            value = number_of(cell, decimal_comma=self.decimal_comma, times=times)
            if value is None:
                raise DatasetError(
                    f"{self.path}, line {self.line[row]}: '{cell[:30]}' in the column "
                    f"'{name or self.names[index] or index + 1}' is not a number.",
                    "Use an empty cell for a missing value.",
                )
            made[row] = value
        return made

    def numeric(self, index: int) -> Floats | None:
        """Return a column as numbers, or None if it contains text."""
        try:
            return self.numbers(index)
        except DatasetError:
            return None


def number_of(cell: str, *, decimal_comma: bool = False, times: bool = False) -> float | None:
    """Return the number in a cell (with `times` also clock and ISO 8601), NaN if empty or infinite, else None."""
    text = cell.replace(",", ".") if decimal_comma else cell
    if text.casefold() in _MISSING:
        return math.nan
    if is_number(text):
        value = float(text)
        return value if math.isfinite(value) else math.nan  # loggers write inf after a division by zero
    if times and ":" in text:
        try:
            date = datetime.fromisoformat(text)
            return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
        except ValueError:
            clock = re.fullmatch(r"(?:(\d+):)?(\d+):(\d+(?:\.\d*)?)", text)
            if clock:
                return 3600.0 * float(clock[1] or 0) + 60.0 * float(clock[2]) + float(clock[3])
    return None


def is_number(text: str) -> bool:
    """Return whether a text is a number, without the underscores that Python allows."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file; a DatasetError says that it is missing, not a regular file, or too large."""
    refuse_special(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DatasetError(f"{path} is larger than 1 GiB.", "Check the name of the file.")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist.", "Check the name.") from error
    except OSError as error:
        what = f"{path} cannot be read: {error.strerror}."
        raise DatasetError(what, "Give the name of a CSV file.") from error


def content_lines(path: Path, content: bytes) -> tuple[list[tuple[int, str]], tuple[str, ...]]:
    """Return numbered lines without blank ones, comments, repeated headers and text below the samples, and notes."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = content.decode("utf-16", errors="replace")
    elif b"\0" in content:
        halves = content[1:4000:2], content[0:4000:2]
        zeros = [half.count(0) > 0.9 * max(len(half), 1) and len(half) > 8 for half in halves]
        if not any(zeros):
            what = f"{path} is not a table of text."
            raise DatasetError(what, "Give a CSV file; use `gyrotrack extract` for films.")
        text = content.decode("utf-16-le" if zeros[0] else "utf-16-be", errors="replace").lstrip("\ufeff")
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
    lines = [
        (number, _COMMENT.sub("", line))
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip(' \t,;"') and not line.lstrip().startswith("#")
    ]
    notes = []
    first = next((i for i, (_, line) in enumerate(lines) if _holds_samples(line)), len(lines))
    heads = {line for _, line in lines[:first]}
    again = {number for number, line in lines[first:] if line in heads}
    if again:
        notes.append(f"{path.name}: the header is repeated in line {min(again)}; the line was excluded")
        lines = [pair for pair in lines if pair[0] not in again]
    last = next((i for i in range(len(lines), first, -1) if _holds_samples(lines[i - 1][1])), len(lines))
    if last < len(lines) <= last + _MOST_SETTINGS:
        notes.append(f"{path.name}: the text from line {lines[last][0]} on was excluded")
        lines = lines[:last]
    return lines, tuple(notes)


def _holds_samples(line: str) -> bool:
    return _is_data(split(line, delimiter_of(line)), comma=True)


def split(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line, without surrounding blanks and quotes; a quoted cell may contain the separator."""
    quoted = delimiter is not None and any(delimiter in cell for cell in _QUOTED.findall(line))
    cells = next(csv.reader([line], delimiter=delimiter or " ")) if quoted else line.split(delimiter)
    return [cell.strip().strip('"').strip() for cell in cells]


def delimiter_of(line: str) -> str | None:
    """Return the separator of the cells of a line: semicolon, tab, comma, or None for blanks."""
    plain = _QUOTED.sub("", line)
    return next((d for d in (";", "\t", ",") if d in plain), None)


def _is_data(cells: Sequence[str], *, comma: bool) -> bool:
    """Return whether a line contains samples: its first non-empty cell, or most of them, are numbers or clock times."""
    filled = [c for c in cells if c]
    known = [number_of(c, decimal_comma=comma, times=True) is not None for c in filled]
    return bool(filled) and (known[0] or sum(known) > len(known) / 2)


def read_text(path: Path, lines: Lines, notes: tuple[str, ...] = ()) -> RawTable:
    """Return the table in the lines of a text file; lines and header must have equal numbers of cells."""
    delimiter = delimiter_of(lines[0][1]) or delimiter_of(lines[len(lines) // 2][1])
    comma = delimiter != ","
    first = next(
        (i for i, (_, text) in enumerate(lines) if _is_data(split(text, delimiter), comma=comma)), None
    )
    if first is None:
        raise DatasetError(f"{path} has a header but no rows.", "Write the samples below the header.")
    delimiter = (
        delimiter_of(lines[first][1]) if first and not delimiter_of(lines[first - 1][1]) else delimiter
    )
    if delimiter == "\t" and any(_is_list(cell) for cell in split(lines[first][1], delimiter)):
        delimiter = None  # tabs and blanks are mixed
    comma = delimiter != ","
    rows = [split(text, delimiter) for _, text in lines[first:]]
    names: list[str] = []
    units: list[str] = []
    header_line = lines[first][0]
    if first:
        above = [split(text, delimiter) for _, text in lines[:first]]
        names, header_line = above[-1], lines[first - 1][0]
        if len(above) > 1 and len(above[-2]) == len(names) and _are_units(names):
            units, names, header_line = names, above[-2], lines[first - 2][0]
    # a title, separated from the samples by an empty line, may have as many words as there are columns
    apart = bool(names) and delimiter is None and lines[first][0] > header_line + 1
    titled = apart and not any(map(role_of, names))
    if titled:
        names, header_line = [], lines[first][0]
    usual = max({len(r) for r in rows}, key=[len(r) for r in rows].count)
    above_table = next((i for i, r in enumerate(rows) if len(r) == usual), 0)
    preamble: list[str] = []
    regular = all(len(r) == usual for r in rows[above_table:-1])
    if 0 < above_table <= _MOST_SETTINGS and len(names) != usual and regular:
        # settings of the instrument, in a table of their own
        preamble = [
            f"{path.name}: ignored the lines before line {lines[first + above_table][0]} (another table)"
        ]
        rows, first, names, units = rows[above_table:], first + above_table, [], []
    elif len(rows) <= _FEW_ROWS < usual / _FEW_ROWS and not names:
        preamble = [f"{path.name}: the {len(rows)} rows are the columns of the table"]
        rows = [list(cells) for cells in zip(*rows, strict=False)]
        usual = len(rows[0])
        lines, first = [(lines[first][0], "")] * len(rows), 0
    if first and delimiter is None and not titled and len(names) != usual:
        names = _names_between_blanks(lines[first - 1][1], usual) or names
    width = len(names) or usual
    rows, kept, repairs = _checked_rows(
        path, rows, np.array([n for n, _ in lines[first:]], dtype=np.int64), width, delimiter
    )
    return RawTable(
        path,
        tuple(names) if names else ("",) * width,
        tuple(units) if units else ("",) * width,
        tuple([row[i] for row in rows] for i in range(width)),
        kept,
        header_line,
        comma,
        (*notes, *preamble, *repairs),
    )


def _is_list(cell: str) -> bool:
    """Return whether a cell contains several numbers, separated by blanks."""
    words = cell.split()
    return len(words) > 1 and all(number_of(word, decimal_comma=True) is not None for word in words)


def _names_between_blanks(line: str, width: int) -> list[str]:
    """Return names with blanks, such as ``t [s] angle [rad]``; empty unless there are `width` of them."""
    names = (
        [line.strip().strip('"')]
        if width == 1
        else re.findall(r"[^\s\[({]+(?:\s*[\[({][^\])}]*[\])}])?", line)
    )
    return names if len(names) == width else []


def _are_units(cells: Sequence[str]) -> bool:
    filled = [c.strip("[]()") for c in cells if c]
    return bool(filled) and sum(is_unit(c) for c in filled) >= len(filled) / 2


def _checked_rows(
    path: Path, rows: list[list[str]], line: Integers, width: int, delimiter: str | None
) -> tuple[list[list[str]], Integers, list[str]]:
    """Check that all rows have the same number of cells; a truncated last row is excluded."""
    notes: list[str] = []
    if delimiter == "," and all(
        len(r) == 2 * width and all(c.lstrip("+-").isdigit() for c in r[::2]) for r in rows
    ):
        rows = [[f"{r[2 * i]}.{r[2 * i + 1]}" for i in range(width)] for r in rows]
        notes.append(f"{path.name}: the comma is both decimal sign and separator; pairs of cells were joined")
    keep = np.ones(len(rows), dtype=bool)
    for i, row in enumerate(rows):
        if delimiter is not None and len(row) == width + 1 and not row[-1]:
            row.pop()  # a delimiter at the end of the line
        if len(row) == width:
            continue
        if i == len(rows) - 1 and len(row) < width and i:
            keep[i] = False
            notes.append(f"{path.name}, line {line[i]}: the last row is truncated and was excluded")
            continue
        raise DatasetError(
            f"{path}, line {line[i]}: {len(row)} cells where the header has {width}.",
            "Use ';' as separator if the comma is the decimal sign." if len(row) > width else "",
        )
    return [r for r, k in zip(rows, keep, strict=True) if k], line[keep], notes


def table_of(path: Path, names: Sequence[str], columns: Sequence[npt.ArrayLike]) -> RawTable:
    """Return a table of numeric columns of equal length."""
    made = tuple(np.asarray(c, dtype=float).ravel() for c in columns)
    rows = len(made[0]) if made else 0
    line = np.arange(1, rows + 1, dtype=np.int64)
    return RawTable(path, tuple(names), ("",) * len(made), made, line)


TURN = 2 * math.pi

# factor of each unit to SI, by quantity
UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "milliseconds": 1e-3,
          "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "microseconds": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "angle": {"rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180,
              "degree": math.pi / 180, "degrees": math.pi / 180, "°": math.pi / 180, "gon": math.pi / 200,
              "rev": TURN, "turn": TURN, "turns": TURN, "revolutions": TURN, "cycles": TURN},
    "omega": {"rad/s": 1.0, "rads-1": 1.0, "rads^-1": 1.0, "rad/sec": 1.0, "s-1": 1.0, "s^-1": 1.0, "1/s": 1.0,
              "mrad/s": 1e-3, "deg/s": math.pi / 180, "°/s": math.pi / 180, "degs-1": math.pi / 180,
              "dps": math.pi / 180,
              "rpm": TURN / 60, "1/min": TURN / 60, "min-1": TURN / 60, "u/min": TURN / 60, "rev/min": TURN / 60,
              "rev/s": TURN, "rps": TURN, "turns/s": TURN, "hz": TURN},
}  # fmt: skip

# words in a header for each quantity; the first match is used
_HEADER_WORDS = {
    "t": {"t", "time", "times", "zeit", "temps", "tiempo", "tempo", "timestamp", "timestamps", "clock", "elapsed",
          "millis", "micros", "datetime", "epoch", "unixtime"},
    "angle": {"angle", "angles", "psi", "phi", "theta", "ψ", "φ", "θ", "winkel", "yaw", "heading", "azimuth", "alpha"},
    "omega": {"omega", "w", "ω", "speed", "angularvelocity", "gyro", "gyroscope", "gyr", "drehzahl", "rpm",
              "winkelgeschwindigkeit", "rotationrate", "angularspeed", "angularrate",
              "gx", "gy", "gz", "gyrox", "gyroy", "gyroz", "gyrx", "gyry", "gyrz", "wx", "wy", "wz"},
    "sigma": {"sigma", "σ", "error", "err", "uncertainty", "std", "sd"},
    "frame": {"frame", "frames", "step", "frameidx"},
    "revolutions": {"revolutions", "revs", "counts", "count", "counter", "pulses", "revolution"},
}  # fmt: skip

# units that also stand alone in a header, in place of a name; shorter ones may be symbols of something else
_NAMED_BY_UNIT = {
    unit for role in ("angle", "omega") for unit in UNITS[role] if len(unit) > 2
} | {"ms", "us", "sec", "seconds", "milliseconds", "microseconds"}  # fmt: skip

_TICKS = {"millis": "ms", "micros": "us"}  # functions of microcontrollers that give times, and their units

ROLES = tuple(_HEADER_WORDS)


def clean(unit: str) -> str:
    """Return a unit without blanks and multiplication signs."""
    return re.sub(r"[\s*·_]", "", unit)


def is_unit(text: str) -> bool:
    """Return whether a word is a unit, of the supported quantities or others."""
    return factor("", text) is not None or clean(text).casefold() in {
        "state",
        "px",
        "m",
        "cm",
        "mm",
        "1",
        "v",
    }


def factor(role: str, unit: str) -> float | None:
    """Return the factor of a unit to SI for a role (any if empty), with `pint` if installed; None if it is unknown."""
    bare = clean(unit)
    tables = [UNITS[role]] if role else list(UNITS.values())
    for table in tables:
        for text in (bare, bare.casefold()):
            if text in table:
                return table[text]
    return _by_pint(role, unit) if role else None


def _by_pint(role: str, unit: str) -> float | None:
    try:
        import pint
    except ImportError:
        return None
    try:
        target = {"t": "s", "angle": "rad", "omega": "rad/s"}[role]
        return float(pint.UnitRegistry().Quantity(1.0, unit).to(target).magnitude)
    except Exception:
        return None


def header_of(name: str) -> tuple[str, str]:
    """Split ``t [s]``, ``t (s)``, ``t / s`` or ``t_ms`` into name and unit ("" without one); ``rpm`` is both."""
    if clean(name).casefold() in _NAMED_BY_UNIT:
        return name.strip(), clean(name).casefold()
    match = re.fullmatch(r"([^\[\](){}/]+?)\s*(?:[\[({]\s*(.*?)\s*[\])}]|/\s*(.*))?", name.strip())
    word, unit = (match[1], match[2] or match[3] or "") if match else (name, "")
    unit = unit or _TICKS.get(word.strip().casefold(), "")
    if not unit:
        parts = [p for p in word.split("_") if not re.fullmatch(r"\d+fps", p)]
        for size in (2, 1):
            tail = "/".join(parts[-size:]) if size == 2 else parts[-1]
            if len(parts) > size and factor("", tail) is not None:
                return "_".join(parts[:-size]), tail
    return word.strip(), unit


def role_of(name: str) -> str | None:
    """Return the quantity of a column by its name without unit; None if it is unknown."""
    text = name.casefold()
    if re.search(r"accel|(^|_)(acc|mag|magnet\w*)_", text):
        return None
    if text.startswith(("sigma_", "err_", "d_", "u_")) or text.endswith(
        ("_sigma", "_err", "_error", " error")
    ):
        return "sigma"
    words = [w for w in re.split(r"[\s_.,\-:#]+", text) if w]
    words = [re.sub(r"(?<=[^\W\d]{3})\d+$", "", w) for w in words]  # angle1, angle2
    whole = "".join(words)
    for role, known in _HEADER_WORDS.items():
        if whole in known:
            return role
    return next(
        (role for w in words for role, known in _HEADER_WORDS.items() if w in known and role != "sigma"), None
    )
