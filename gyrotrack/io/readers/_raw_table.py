"""Tables before interpretation: named columns of numbers or text, and the limits of what is read.

Units of times, angles and angular velocities in a header are converted to s, rad and rad/s by factors.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import DatasetError
from gyrotrack.io._atomic import refuse_special
from gyrotrack.io._records import Floats, Integers

# limits of a table, so that reading a file takes at most about 1 GB of memory
MAX_BYTES = 2**28  # largest size of a file, and of an unpacked archive [bytes]
MAX_ROWS = 5_000_000
MAX_COLUMNS = 5_000
MAX_CELLS = 10_000_000  # largest number of cells of text; numbers need a tenth of their memory
_LONGEST_NAME = 500  # largest number of characters of a header
_LONGEST_UNIT = 30  # largest number of characters of a unit that is not in the tables below
# texts with which spreadsheets mark errors
CELL_ERRORS = ("#n/a", "#div/0!", "#value!", "#ref!", "#num!", "#name?", "#null!")
_MISSING = {
    "", "nan", "na", "n/a", "n.a.", "-", "--", "---", "\N{EN DASH}", "\N{EM DASH}", "none", "null", *CELL_ERRORS
}  # fmt: skip
# a number with separators of thousands: point, comma, apostrophe or an unbreakable blank
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:([.,'\u2019\xa0\u202f])\d{3})(?:\1\d{3})*(?:(?!\1)([.,])\d*)?")


@dataclass(frozen=True)
class RawTable:
    """The columns of a file."""

    path: Path  # the file
    # header of each column (empty without a header line), and its unit if units are in a separate line
    names: tuple[str, ...]
    units: tuple[str, ...]
    # numbers (ndarray, shape (n,)) or cells of text (list of str), one per column
    columns: tuple[Floats | list[str], ...]
    line: Integers  # shape (n,); line of each sample in the file
    header_line: int = 0  # line of the header; 0 in files without lines
    decimal_comma: bool = False
    notes: tuple[str, ...] = field(default=())  # repairs made while reading
    sha256: str = ""  # hash of the file

    def __post_init__(self) -> None:
        refuse_size(self.path, len(self.line), len(self.names))
        refuse_long_names(self.path, self.names)

    @property
    def headed(self) -> bool:
        """Whether the columns have names."""
        return any(self.names)

    @property
    def header_place(self) -> str:
        """The file, and the line of the header if it has lines, for messages."""
        return f"{self.path}, line {self.header_line}" if self.header_line else str(self.path)

    def numbers(self, index: int, name: str = "", *, times: bool = False, infinite: bool = False) -> Floats:
        """Return a column as numbers, with NaN for empty cells; cells of text raise a DatasetError.

        Loggers write inf after a division by zero; it becomes NaN unless `infinite` is set.
        """
        values = self._parsed(index, name, times=times)
        return values if infinite else np.where(np.isinf(values), np.nan, values)

    def _parsed(self, index: int, name: str, *, times: bool) -> Floats:
        column = self.columns[index]
        if isinstance(column, np.ndarray):
            return np.asarray(column, dtype=float)
        comma = self.decimal_comma
        separator = next((s for cell in column if (s := _separator_of_thousands(cell, comma=comma))), "")
        made = np.empty(len(column))
        for row, cell in enumerate(column):
            plain = cell.replace(separator, "") if separator else cell
            value = number_of(plain, decimal_comma=comma or separator == ".", times=times)
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


def refuse_size(path: Path, rows: int, columns: int) -> None:
    """Raise a DatasetError for a table that is too large to be read."""
    if rows > MAX_ROWS or columns > MAX_COLUMNS:
        raise DatasetError(
            f"{path} has {rows:,} rows and {columns:,} columns; at most {MAX_ROWS:,} and {MAX_COLUMNS:,} are read.",
            "Export a part of the record, or fewer columns.",
        )


def refuse_long_names(path: Path, names: Sequence[str]) -> None:
    """Raise a DatasetError if a header is too long for the name of a column."""
    if (longest := max(map(len, names), default=0)) > _LONGEST_NAME:
        what = f"{path}: a cell of the header has {longest:,} characters; at most {_LONGEST_NAME} are read."
        raise DatasetError(what, "Check the header.")


def number_of(cell: str, *, decimal_comma: bool = False, times: bool = False) -> float | None:
    """Return the number in a cell; NaN if it is empty, None for text.

    With `times`, clock times and ISO 8601 times are read.
    """
    text = cell.replace(",", ".") if decimal_comma else cell
    if text.casefold() in _MISSING:
        return math.nan
    if is_number(text):
        return float(text)
    if separator := _separator_of_thousands(cell, comma=decimal_comma):
        return float(cell.replace(separator, "").replace(",", "."))
    if times and ":" in text:
        try:
            date = datetime.fromisoformat(text)
            return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
        except ValueError:
            clock = re.fullmatch(r"(?:(\d+):)?(\d+):(\d+(?:\.\d*)?)", text)
            if clock:
                return 3600.0 * float(clock[1] or 0) + 60.0 * float(clock[2]) + float(clock[3])
    return None


def _separator_of_thousands(cell: str, *, comma: bool) -> str:
    """Return the separator of thousands in a cell; "" without one, or if it may be a decimal sign.

    A point or a comma before a single group of three digits separates thousands only if a decimal sign follows. With
    `comma` false, a comma is never a decimal sign.
    """
    found = _GROUPED.fullmatch(cell)
    if found is None:
        return ""
    separator = str(found[1])
    single = separator in ".," and cell.count(separator) == 1 and not found[2]
    return "" if single and (separator == "." or comma) else separator


def is_number(text: str) -> bool:
    """Return whether a text is a number, without the underscores that Python allows."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file; raise a DatasetError if it is missing, not a regular file, or too large."""
    refuse_special(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            what = f"{path} is larger than {MAX_BYTES >> 20} MiB."
            raise DatasetError(what, "Check the name, or export a part of the record.")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist.", "Check the name.") from error
    except OSError as error:
        what = f"{path} cannot be read: {error.strerror}."
        raise DatasetError(what, "Give the name of a CSV file.") from error


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
    "interval": {"interval", "intervals", "impulsetime"},
    "revolutions": {"revolutions", "revs", "counts", "count", "counter", "pulses", "revolution"},
}  # fmt: skip

# units that may replace the name in a header; shorter units are not listed, because they may be symbols of other
# quantities
_NAMED_BY_UNIT = {
    unit for role in ("angle", "omega") for unit in UNITS[role] if len(unit) > 2
} | {"ms", "us", "sec", "seconds", "milliseconds", "microseconds"}  # fmt: skip

_TICKS = {
    "millis": "ms",
    "micros": "us",
}  # functions of microcontrollers that return times, and the units of these times

_AMBIGUOUS = {"grad", "grade", "grads"}  # this unit means degrees in German, and gon elsewhere

ROLES = tuple(_HEADER_WORDS)


def clean(unit: str) -> str:
    """Return a unit without blanks and multiplication signs."""
    return re.sub(r"[\s*·_]", "", unit)


def is_unit(text: str) -> bool:
    """Return whether a word is a unit, of a supported quantity or of any other quantity."""
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
    """Return the factor of a unit to SI for a quantity ("": any quantity), from `pint` if it is installed.

    The result is None for an unknown unit.
    """
    bare = clean(unit)
    if bare.casefold() in _AMBIGUOUS:
        return None
    tables = [UNITS[role]] if role else list(UNITS.values())
    for table in tables:
        for text in (bare, bare.casefold()):
            if text in table:
                return table[text]
    return _by_pint(role, unit) if role else None


def _by_pint(role: str, unit: str) -> float | None:
    powers = unit.count("**") + unit.count("^")
    # long texts are refused, because pint would compute 9**9**9
    if len(unit) > _LONGEST_UNIT or powers > 1 or re.search(r"\d{4}", unit):
        return None
    try:
        target = {"t": "s", "angle": "rad", "omega": "rad/s"}[role]
        return float(_unit_registry().Quantity(1.0, unit).to(target).magnitude)
    except Exception:
        return None


@cache
def _unit_registry() -> Any:
    """Return the unit registry of pint, which takes half a second to load."""
    import pint

    return pint.UnitRegistry()


def header_of(name: str) -> tuple[str, str]:
    """Split ``t [s]``, ``t (s)``, ``t / s`` or ``t_ms`` into name and unit ("" without one); ``rpm`` is both."""
    if clean(name).casefold() in _NAMED_BY_UNIT:
        return name.strip(), clean(name).casefold()
    if name.startswith("/"):  # the name of a column of a ROS topic
        topic, _, unit = name.strip().rstrip("])").partition("[" if "[" in name else "(")
        return topic.strip(), unit.strip()
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


_INPUTS = {
    "pwm",
    "voltage",
    "volts",
    "current",
    "duty",
    "throttle",
    "torque",
    "command",
    "commanded",
    "cmd",
    "setpoint",
}


def is_input(name: str) -> bool:
    """Return whether a column is a measured cause of the motion, by its name without unit."""
    return bool(_INPUTS & set(re.split(r"[\s_.,\-:#]+", name.casefold())))


# a unit of angular acceleration in a header, for example rad/s2, rad_s2, deg/s^2, rad s-2
_ACCELERATION = re.compile(r"(?:rad|deg|°|rev|turns?)[\s_/·*]+s(?:ec)?(?:\^|\*\*)?-?[2²](?![a-z0-9])")


def is_acceleration(name: str) -> bool:
    """Return whether a header contains a unit of angular acceleration."""
    return _ACCELERATION.search(name.casefold()) is not None


def role_of(name: str) -> str | None:
    """Return the quantity of a column by its name without unit; None if it is unknown."""
    text = name.casefold()
    if re.search(r"accel|(^|_)(acc|mag|magnet\w*)_", text):
        return None
    if text.startswith(("sigma_", "err_", "d_", "u_")) or text.endswith(
        ("_sigma", "_err", "_error", " error")
    ):
        return "sigma"
    words = [w for w in re.split(r"[\s_.,\-:#%/]+", text) if w]
    words = [re.sub(r"(?<=[^\W\d]{3})\d+$", "", w) for w in words]  # angle1, angle2
    whole = "".join(words)
    for role, known in _HEADER_WORDS.items():
        if whole in known:
            return role
    words += [a + b for a, b in pairwise(words)]  # angular_velocity
    return next(
        (role for w in words for role, known in _HEADER_WORDS.items() if w in known and role != "sigma"), None
    )
