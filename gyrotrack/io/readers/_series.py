"""Tables of angles or angular velocities as text.

Taken as they come: comma, semicolon, tab or blanks between the cells, a decimal comma where the comma does
not part the cells, comment lines with ``#``, a byte order mark, units in the header (``t [s]``).
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import DatasetError
from gyrotrack.io._records import Floats, Integers
from gyrotrack.io.readers._point_files import read_point_file
from gyrotrack.io.readers._point_tables import read_point_table
from gyrotrack.io.readers._points import Points, Wanted, angle_of
from gyrotrack.io.readers._text import (
    EXPECTED,
    Header,
    Names,
    content_lines,
    is_number,
    read_bytes,
    read_header,
)

FEWEST = 8

_MISSING = {"", "nan", "na", "n/a", "-", "none", "null"}


@dataclass(frozen=True)
class Table:
    """One file's samples, all finite, in order of time, in SI units.

    Attributes
    ----------
    quantity : str
        What `value` is: "angle" [rad] or "omega" [rad s-1].
    time, value : ndarray, shape (n,)
        Times [s] and values; rows without a value are left out.
    sigma : ndarray, shape (n,), or None
        Uncertainty of the values, if the file gives one.
    line : ndarray, shape (n,)
        The line of the file that each sample stood in.
    notes : tuple of str
        What a user should know of how the file was taken.
    """

    path: Path
    sha256: str
    quantity: str
    time: Floats
    value: Floats
    sigma: Floats | None
    line: Integers
    notes: tuple[str, ...]


def read_table(path: Path, names: Names | None = None, wanted: Wanted | None = None) -> Table:
    """Read one table of angles or speeds, or of points that another program followed.

    Parameters
    ----------
    path : Path
        CSV or the like; or points, as text of OSP Tracker, or as CSV or HDF5 of DeepLabCut or SLEAP.
    names : mapping, optional
        Headers of the file that mean one of our columns, as `header.read_names` makes it.
    wanted : Wanted, optional
        How points become an angle.

    Raises
    ------
    DatasetError
        The file is missing, no table, or a line in it is wrong; the message names file and line.
    UsageError
        The points' marker, centre or rate is not known.
    """
    path = Path(path)
    content = read_bytes(path)
    sha256 = hashlib.sha256(content).hexdigest()
    if content.startswith(b"\x89HDF"):
        return _from_points(read_point_file(path, sha256), wanted or Wanted())
    lines = content_lines(path, content)
    if not lines:
        raise DatasetError(f"{path} is empty.", EXPECTED)
    points = read_point_table(path, sha256, lines) if not names else None
    if points is not None:
        return _from_points(points, wanted or Wanted())
    header = read_header(path, *lines[0], names or {})
    rows = [_read_row(path, number, text, header) for number, text in lines[1:]]
    if not rows:
        raise DatasetError(f"{path} has a header but no rows.", "Write the samples below the header.")
    cells = np.array(rows, dtype=float)
    numbers = np.array([number for number, _ in lines[1:]], dtype=np.int64)
    return _checked(path, sha256, header, cells, numbers)


def _from_points(points: Points, wanted: Wanted) -> Table:
    found = angle_of(points, wanted)
    seen = np.isfinite(found.angle) & np.isfinite(found.time)
    if (np.diff(found.time[seen]) <= 0).any():
        raise DatasetError(f"{points.path}: the times do not grow from row to row.", "Sort the rows by time.")
    lost = int((~seen).sum())
    notes = (f"{points.path.name}: {lost} frames without the marker were left out",) if lost else ()
    return Table(
        path=points.path,
        sha256=points.sha256,
        quantity="angle",
        time=found.time[seen],
        value=found.angle[seen],
        sigma=None,
        line=np.flatnonzero(seen),
        notes=(*found.notes, *notes),
    )


def _read_row(path: Path, number: int, text: str, header: Header) -> list[float]:
    cells = text.split(header.delimiter)
    if header.delimiter is not None and len(cells) == header.width + 1 and not cells[-1].strip():
        cells = cells[:-1]  # a delimiter at the end of the line
    if len(cells) != header.width:
        hint = (
            "Part the cells with ';' where the comma is the decimal sign."
            if len(cells) > header.width
            else ""
        )
        raise DatasetError(
            f"{path}, line {number}: {len(cells)} cells where the header has {header.width}.", hint
        )
    row = []
    for name in ("t", header.quantity, "sigma"):
        cell = cells[header.columns[name]].strip().strip('"').strip() if name in header.columns else ""
        if header.delimiter != ",":
            cell = cell.replace(",", ".")
        if cell.lower() in _MISSING:
            row.append(math.nan)
        elif not is_number(cell) or math.isinf(float(cell)):
            raise DatasetError(
                f"{path}, line {number}: '{cell[:30]}' in the column '{name}' is not a number.",
                "Leave the cell empty where a value is missing.",
            )
        else:
            row.append(float(cell) * header.scales[name])
    return row


def _checked(path: Path, sha256: str, header: Header, cells: Floats, numbers: Integers) -> Table:
    """Check order and signs, and leave out the rows without a value."""
    time = cells[:, 0]
    _refuse(path, numbers, np.isnan(time), "the time is missing", "Every row needs its time.")
    step = np.diff(time, prepend=-np.inf)
    _refuse(
        path, numbers, step == 0, "the time is the same as in the row before", "Remove one of the two rows."
    )
    _refuse(path, numbers, step < 0, "the time is earlier than in the row before", "Sort the rows by time.")
    seen = np.isfinite(cells[:, 1])
    sigma = cells[:, 2] if "sigma" in header.columns else None
    if sigma is not None:
        _refuse(path, numbers, seen & np.isnan(sigma), "the sigma is missing", "Give it, or drop the column.")
        _refuse(path, numbers, seen & ~(sigma > 0), "the sigma is not positive", "A sigma is above zero.")
    if seen.sum() < FEWEST:
        raise DatasetError(
            f"{path} has {seen.sum()} samples with a value; at least {FEWEST} are needed.",
            "Give a longer piece.",
        )
    lost = int((~seen).sum())
    notes = (*header.notes, *((f"{path.name}: {lost} rows without a value were left out",) if lost else ()))
    return Table(
        path=path,
        sha256=sha256,
        quantity=header.quantity,
        time=time[seen],
        value=cells[seen, 1],
        sigma=None if sigma is None else sigma[seen],
        line=numbers[seen],
        notes=notes,
    )


def _refuse(path: Path, numbers: Integers, wrong: npt.NDArray[np.bool_], what: str, hint: str) -> None:
    if wrong.any():
        raise DatasetError(f"{path}, line {numbers[np.argmax(wrong)]}: {what}.", hint)
