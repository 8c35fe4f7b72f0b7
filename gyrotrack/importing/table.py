"""Reading a table of angles or speeds that some other program wrote, and refusing a bad one by file and line.

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

from gyrotrack.dataset.records import Floats, Integers
from gyrotrack.errors import DatasetError
from gyrotrack.importing.header import EXPECTED, Header, is_number, read_header

FEWEST = 8
MOST_BYTES = 2**30

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


def read_table(path: Path) -> Table:
    """Read one table.

    Raises
    ------
    DatasetError
        The file is missing, no table, or a line in it is wrong; the message names file and line.
    """
    path = Path(path)
    content = _read_bytes(path)
    lines = _content_lines(path, content)
    if not lines:
        raise DatasetError(f"{path} is empty.", EXPECTED)
    header = read_header(path, *lines[0])
    rows = [_read_row(path, number, text, header) for number, text in lines[1:]]
    if not rows:
        raise DatasetError(f"{path} has a header but no rows.", "Write the samples below the header.")
    cells = np.array(rows, dtype=float)
    numbers = np.array([number for number, _ in lines[1:]], dtype=np.int64)
    return _checked(path, hashlib.sha256(content).hexdigest(), header, cells, numbers)


def _read_bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > MOST_BYTES:
            raise DatasetError(
                f"{path} is larger than a table of angles can be.", "Check the name of the file."
            )
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist.", "Check the name.") from error
    except OSError as error:
        raise DatasetError(
            f"{path} cannot be read: {error.strerror}.", "Give the name of a CSV file."
        ) from error
    return content


def _content_lines(path: Path, content: bytes) -> list[tuple[int, str]]:
    """Return the lines that are neither blank nor comments, each with its number."""
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
