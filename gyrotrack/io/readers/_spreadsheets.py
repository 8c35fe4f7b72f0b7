"""Workbooks of Excel.

A sheet may contain a title, settings of the instrument, merged cells and a row of units above the samples. The samples
begin with the first long block of rows with numbers.
"""

from __future__ import annotations

import io
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._raw_table import MAX_CELLS, RawTable
from gyrotrack.io.readers._text_table import header_among

_MOST_CELLS = 2_000_000  # largest number of cells of a workbook, because its XML is slow to read
# Smallest number of rows of a block of samples, and of the samples of a sheet that is read [share of the largest
# number in the workbook]. Fewer rows are settings of the instrument.
_LONG = 0.5

Rows = list[list[Any]]


def read_workbook(path: Path, content: bytes, options: ReadOptions) -> RawTable:
    """Return a sheet with samples of an Excel workbook (.xlsx): the first one, or the one that `marker` names."""
    try:
        import openpyxl
    except ImportError:
        raise _missing_library("Excel workbooks need openpyxl") from None
    _refuse_markup(path, content)
    try:
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        sheets: dict[str, Rows] = {}
        cells = 0
        for sheet in book.worksheets:
            sheet.reset_dimensions()  # the stated size may be much larger than the range of cells with values
            rows: Rows = []
            for row in sheet.iter_rows(values_only=True):
                # a row far below the other rows would be preceded by many empty rows
                cells += max(len(row), 1)
                if cells > _MOST_CELLS:
                    break
                rows.append(list(row))
            sheets[sheet.title] = rows
    except Exception as error:
        raise DatasetError(f"{path} is a damaged workbook: {str(error)[:100]}.", "Save it again.") from error
    if cells > _MOST_CELLS:
        raise too_many_cells(path, _MOST_CELLS)
    return _sheet_of_samples(path, sheets, options)


def _refuse_markup(path: Path, content: bytes) -> None:
    """Raise a DatasetError for a workbook whose XML has too many elements to be read in a few seconds."""
    large = small = 0
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for name in archive.namelist():
            with archive.open(name) as stream:
                count = sum(piece.count(b"<") for piece in iter(partial(stream.read, 2**20), b""))
            if name.startswith(("xl/worksheets/", "xl/sharedStrings")):
                large += count
            else:
                small += count
    if large > 5 * _MOST_CELLS or small > _MOST_CELLS / 10:
        raise too_many_cells(path, _MOST_CELLS)


def too_many_cells(path: Path, most: int = MAX_CELLS) -> DatasetError:
    """Return the error for a table with too many cells."""
    what = f"{path} has more than {most:,} cells."
    return DatasetError(what, "Export the columns of time and angle alone, as CSV.")


def read_excel_97(path: Path, content: bytes, options: ReadOptions) -> RawTable:
    """Return a sheet with samples of an Excel 97 workbook (.xls), a format of phyphox and older loggers."""
    try:
        import xlrd
    except ImportError:
        raise _missing_library("Excel 97 workbooks need xlrd") from None

    def value(cell: Any) -> Any:
        if cell.ctype == xlrd.XL_CELL_DATE:
            return xlrd.xldate.xldate_as_datetime(cell.value, book.datemode)
        return cell.value if cell.ctype in {xlrd.XL_CELL_NUMBER, xlrd.XL_CELL_TEXT} else None

    try:
        book = xlrd.open_workbook(file_contents=content, logfile=io.StringIO())
        sheets = {
            sheet.name: [[value(c) for c in row] for row in sheet.get_rows()] for sheet in book.sheets()
        }
    except Exception as error:
        raise DatasetError(f"{path} is a damaged workbook: {str(error)[:100]}.", "Save it again.") from error
    return _sheet_of_samples(path, sheets, options)


def _missing_library(what: str) -> UsageError:
    return UsageError(
        f"{what}, which is not installed.", 'Run: pip install "gyrotrack[tables]"; or export CSV.'
    )


def _sheet_of_samples(path: Path, sheets: dict[str, Rows], options: ReadOptions) -> RawTable:
    """Return the first sheet with about as many samples as the largest sheet, or the sheet that `marker` names.

    A note names the other sheets with samples. A `marker` may also be the name of a column. If it names neither one
    sheet nor a column, and there are several sheets, the table is refused.
    """
    blocks = {name: found for name, rows in sheets.items() if (found := _block_of_samples(rows)) is not None}
    if not blocks:
        raise DatasetError(f"{path} has no sheet with numbers.", "Give the sheet as CSV.")
    most = max(count for _, count in blocks.values())
    long = [name for name, (_, count) in blocks.items() if count >= _LONG * most]
    marker = (options.marker or "").casefold()
    named = [n for n in blocks if n.casefold() == marker] or [
        n for n in blocks if marker and marker in n.casefold()
    ]
    chosen = named[0] if len(named) == 1 else long[0]
    header = " ".join(str(c) for row in sheets[chosen][: blocks[chosen][0]] for c in row if c is not None)
    if marker and len(named) != 1 and len(long) > 1 and marker not in header.casefold():
        names = ", ".join(f"'{n[:40]}'" for n in long)
        which = f"{len(named)} sheets" if named else "no sheet"
        raise UsageError(
            f"--marker {options.marker} names {which} of {path.name}, and no column.",
            f"Give the name of one sheet: {names}.",
        )
    others = ", ".join(f"'{n[:40]}'" for n in long if n != chosen)
    note = f"{path.name}: the sheet '{chosen[:40]}' was read; --marker NAME selects another sheet: {others}"
    return _table_of_cells(path, sheets[chosen], blocks[chosen][0], (note,) if others else ())


def _block_of_samples(rows: Rows) -> tuple[int, int] | None:
    """Return the first row of the first long block of rows with mostly numbers, and the rows of the longest block.

    Empty rows do not interrupt a block.
    """
    filled = np.array([i for i, row in enumerate(rows) if any(c is not None for c in row)], dtype=np.int64)
    numeric = np.array([_has_numbers(rows[i]) for i in filled], dtype=np.int64)
    change = np.diff(numeric, prepend=0, append=0)
    starts, lengths = np.flatnonzero(change > 0), np.flatnonzero(change < 0) - np.flatnonzero(change > 0)
    if not len(starts):
        return None
    first = starts[np.argmax(lengths >= _LONG * lengths.max())]
    return int(filled[first]), int(lengths.max())


def _has_numbers(row: list[Any]) -> bool:
    return sum(isinstance(c, int | float) for c in row) >= max(1, sum(c is not None for c in row) / 2)


def _table_of_cells(path: Path, rows: Rows, first: int, notes: tuple[str, ...]) -> RawTable:
    width = max(len(r) for r in rows[first:])
    above = {
        i: [str(c) if c is not None else "" for c in (*r[:width], *[None] * (width - len(r)))]
        for i, r in enumerate(rows[:first], 1)
        if any(c is not None for c in r)
    }
    names, units, row = header_among(list(above.values()), width)
    filled = {i: r for i, r in enumerate(rows[first:], first + 1) if any(c is not None for c in r)}
    cells = tuple(
        ["" if i >= len(r) or r[i] is None else str(r[i]) for r in filled.values()] for i in range(width)
    )
    line = np.array(list(filled), dtype=np.int64)
    header_line = list(above)[row] if above else 1
    return RawTable(path, names, units, cells, line, header_line, notes=notes)
