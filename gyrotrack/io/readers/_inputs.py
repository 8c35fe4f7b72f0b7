"""Recorded inputs of a motion from columns of a table: options that name them, units, interpolation.

An option has the form ``NAME=COLUMN [UNIT] +- U, hold, delay=T, file=PATH``; all parts except name and column are
optional.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fitting._case_format import INTERPOLATIONS
from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io._records import Floats, Input
from gyrotrack.io.readers._raw_table import RawTable, clean, header_of

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_COLUMN = re.compile(
    rf"(?P<column>.*?)\s*(?:\[\s*(?P<unit>[^\[\]]*?)\s*\])?\s*(?:(?:\+-|\+/-|±)\s*(?P<u>{_NUMBER}))?\s*"
)
EXAMPLE = "Write, for example, --input 'current=3 [A]' or --input 'command=Torque [N m], hold, delay=0.02'."
# names that already have a meaning in laws
_TAKEN = {
    "t", "omega_r", "omega_c", "psi_r", "psi_c", "deflection", "delta", "pi",
    "abs", "sign", "sqrt", "exp", "log", "sin", "cos", "tanh", "atan", "heaviside",
}  # fmt: skip
# a column with at least this share of equal neighbours counts as a command; each value holds until the next
_HELD = 0.5


class Unit(NamedTuple):
    """A unit of an input in a file: SI unit in CF notation, factor and offset (SI value = factor * value + offset)."""

    si: str
    factor: float = 1.0
    offset: float = 0.0


_BASES = {"A": "A", "V": "V", "Nm": "N m", "N": "N", "K": "K", "s": "s", "rad": "rad", "Pa": "kg m-1 s-2"}
_PREFIXES = {"": 1.0, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "k": 1e3}
UNITS: dict[str, Unit] = {
    f"{p}{name}": Unit(si, x) for name, si in _BASES.items() for p, x in _PREFIXES.items()
} | {
    "": Unit("1"), "1": Unit("1"), "%": Unit("1", 0.01), "percent": Unit("1", 0.01), "counts": Unit("1"),
    "amps": Unit("A"), "volts": Unit("V"), "volt": Unit("V"), "ampere": Unit("A"), "Ncm": Unit("N m", 0.01),
    "degC": Unit("K", 1.0, 273.15), "°C": Unit("K", 1.0, 273.15), "C": Unit("K", 1.0, 273.15),
    "rad/s": Unit("s-1"), "rpm": Unit("s-1", math.pi / 30), "RPM": Unit("s-1", math.pi / 30),
}  # fmt: skip


@dataclass(frozen=True)
class InputOption:
    """An option that defines an input."""

    name: str
    column: str  # header or number of the column
    unit: str | None = None  # unit in the file; None: the unit in the header
    u: float = math.nan  # standard uncertainty, in the unit of the file; NaN if not given
    interpolation: str = ""  # interpolation; "" if the values determine it
    delay: float = 0.0  # dead time [s]
    file: Path | None = None  # separate table with this input, on the same clock

    def place(self, raw: RawTable) -> int | None:
        """Return the index of the column; None if the table does not contain the column."""
        wanted = self.column.casefold()
        for index, name in enumerate(raw.names):
            if name and wanted in {name.casefold(), header_of(name)[0].casefold()}:
                return index
        number = int(self.column) - 1 if self.column.isdecimal() else -1
        return number if 0 <= number < len(raw.columns) else None

    def made(self, raw: RawTable, index: int, time: Floats) -> Input:
        """Return the input from a column, at the times of the rows [s]; missing values are omitted."""
        header = raw.names[index] if raw.names else ""
        text = self.unit if self.unit is not None else (raw.units[index] or header_of(header)[1])
        unit = UNITS.get(clean(text))
        if unit is None and self.unit is not None:
            raise UsageError(
                f"--input {self.name}: unknown unit '{text[:30]}'.",
                "Use A, V, N m, K, s, 1, % or a multiple.",
            )
        unit = unit or Unit("1")
        values = raw.numbers(index, self.name) * unit.factor + unit.offset
        known = np.isfinite(time) & np.isfinite(values)
        if known.sum() < 1:
            raise DatasetError(
                f"{raw.path}: the input '{self.name}' has no value.", "Choose another column with --input."
            )
        time, first = np.unique(time[known], return_index=True)
        values = values[known][first]
        u = np.full(len(time), self.u * unit.factor)
        held = len(values) < 2 or float(np.mean(np.diff(values) == 0)) > _HELD
        kind = self.interpolation or ("hold" if held else "linear")
        return Input(self.name, time, values, u, unit.si, kind, self.delay)


def read_input_options(given: Sequence[str]) -> tuple[InputOption, ...]:
    """Parse options ``NAME=COLUMN [UNIT] +- U, hold, delay=T, file=PATH``; a UsageError names an error."""
    found: list[InputOption] = []
    for text in given:
        first, *more = (part.strip() for part in text.split(","))
        name, equals, column = (part.strip() for part in first.partition("="))
        parsed = _COLUMN.fullmatch(column)
        if not equals or parsed is None or not parsed["column"]:
            raise UsageError(f"{text[:60]!r} does not name a column.", EXAMPLE)
        if not _NAME.fullmatch(name) or name in _TAKEN:
            what = f"{name[:40]!r} cannot be the name of an input."
            raise UsageError(
                what, "Use letters, digits and underscores; t, omega_c, psi_c ... have a meaning."
            )
        if any(option.name == name for option in found):
            raise UsageError(f"The input {name} is given twice.", "Give each input a different name.")
        u = float(parsed["u"]) if parsed["u"] else math.nan
        option = InputOption(name, parsed["column"], parsed["unit"], u)
        for word in more:
            option = _with(option, word, text)
        found.append(option)
    return tuple(found)


def _with(option: InputOption, word: str, text: str) -> InputOption:
    """Return an option with one more word parsed."""
    key, equals, value = (part.strip() for part in word.partition("="))
    if word in INTERPOLATIONS:
        return replace(option, interpolation=word)
    if equals and key == "file" and value:
        return replace(option, file=Path(value))
    if equals and key == "delay":
        seconds = re.fullmatch(rf"({_NUMBER})\s*(?:s|\[s\])?", value)
        if seconds and math.isfinite(float(seconds[1])):
            return replace(option, delay=float(seconds[1]))
    raise UsageError(
        f"--input {text[:60]!r}: {word[:30]!r} is unknown.", f"{EXAMPLE} Words: linear, hold, file=."
    )


def described(found: Input) -> str:
    """Return interpolation and delay of an input, in words."""
    between = "the last value holds" if found.interpolation == "hold" else "linear between samples"
    return f"{between}{f'; acts after {found.delay:g} s' if found.delay else ''}"
