"""The interpretation of a file: quantity, unit and reason for each column, and the unused columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypedDict

from gyrotrack.io.readers._raw_table import factor

_SAME_UNIT = 1e-9  # two units count as equal if their relative difference is below this value
_MOST_NAMES = 12  # largest number of unused columns that are named


@dataclass(frozen=True)
class Taken:
    """One column or point, and its interpretation."""

    column: str  #: Name of the column or point, in quotes, or its number.
    quantity: str  #: Quantity that it contains, for example `time`, `angle`, `omega` or `input`.
    unit: str  #: Unit in the file; empty if not stated.
    why: str  #: Reason for this interpretation.


class ReadingDocument(TypedDict):
    """The interpretation of one file."""

    file: str  #: Name of the file.
    format: str  #: Format of the file.
    rows: int  #: Number of rows.
    columns: list[Taken]  #: Columns that are used.
    left_out: list[str]  #: Columns or points that are not used.


@dataclass(frozen=True)
class Reading:
    """The interpretation of one file."""

    file: str
    format: str
    rows: int
    taken: tuple[Taken, ...]
    left_out: tuple[str, ...]  # columns or points that are not used

    def lines(self) -> tuple[str, str]:
        """Return two lines: the interpretation of each column with its reason; the unused columns."""
        parts = [
            f"{t.quantity} from {t.column}{f' [{t.unit}]' if t.unit else ''} ({t.why})" for t in self.taken
        ]
        more = len(self.left_out) - _MOST_NAMES
        names = [*self.left_out[:_MOST_NAMES], *([f"{more} more"] if more > 0 else [])]
        return (
            f"{self.file} ({self.format}, {self.rows} rows): {'; '.join(parts)}.",
            f"{self.file}: unused columns: {', '.join(names) or 'none'}.",
        )

    def document(self) -> ReadingDocument:
        """Return the interpretation for JSON and for the provenance of a case."""
        columns: list[Any] = [vars(t) for t in self.taken]
        return {
            "file": self.file,
            "format": self.format,
            "rows": self.rows,
            "columns": columns,
            "left_out": list(self.left_out),
        }


def units_of_file(document: Mapping[str, Any]) -> dict[str, tuple[str, float]]:
    """Return the units of angles and speeds in a file that are not SI units, with their factors to SI.

    `document` is the document of a `Reading`. If the angle is in degrees, the speed is in degrees per second; a speed
    in turns per minute does not determine a unit of the angle.
    """
    for column in document["columns"]:
        quantity, unit = column["quantity"], column["unit"]
        scale = factor(quantity, unit) if quantity in {"angle", "omega"} and unit else None
        if scale is None or abs(scale - 1) < _SAME_UNIT:
            continue
        if quantity == "omega":
            return {"omega": (unit, scale), "alpha": (f"{unit}/s", scale)}
        return {"angle": (unit, scale), "omega": (f"{unit}/s", scale), "alpha": (f"{unit}/s2", scale)}
    return {}


def reading_of(document: Mapping[str, Any]) -> Reading:
    """Return the interpretation from its document."""
    taken = tuple(Taken(**column) for column in document["columns"])
    return Reading(document["file"], document["format"], document["rows"], taken, tuple(document["left_out"]))
