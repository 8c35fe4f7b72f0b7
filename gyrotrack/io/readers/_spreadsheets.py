"""Workbooks of Excel."""

from __future__ import annotations

import io
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io.readers._raw_table import MAX_CELLS, RawTable

_MOST_CELLS = 2_000_000  # largest number of cells of a workbook, because its XML is slow to read


def read_workbook(path: Path, content: bytes) -> RawTable:
    """Return the first sheet with numbers of an Excel workbook (.xlsx)."""
    try:
        import openpyxl
    except ImportError:
        raise _missing_library("Excel workbooks need openpyxl") from None
    _refuse_markup(path, content)
    try:
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        sheets, cells = [], 0
        for sheet in book.worksheets:
            sheet.reset_dimensions()  # the stated size may be much larger than the range of cells with values
            rows: list[list[Any]] = []
            for row in sheet.iter_rows(values_only=True):
                # a row far below the other rows would be preceded by many empty rows
                cells += max(len(row), 1)
                if cells > _MOST_CELLS:
                    break
                rows.append(list(row))
            sheets.append(rows)
    except Exception as error:
        raise DatasetError(f"{path} is a damaged workbook: {str(error)[:100]}.", "Save it again.") from error
    if cells > _MOST_CELLS:
        raise too_many_cells(path, _MOST_CELLS)
    return _first_sheet(path, sheets)


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


def read_excel_97(path: Path, content: bytes, _options: object) -> RawTable:
    """Return the first sheet with numbers of an Excel 97 workbook (.xls), a format of phyphox and older loggers."""
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
        sheets = [[[value(c) for c in row] for row in sheet.get_rows()] for sheet in book.sheets()]
    except Exception as error:
        raise DatasetError(f"{path} is a damaged workbook: {str(error)[:100]}.", "Save it again.") from error
    return _first_sheet(path, sheets)


def _missing_library(what: str) -> UsageError:
    return UsageError(
        f"{what}, which is not installed.", 'Run: pip install "gyrotrack[tables]"; or export CSV.'
    )


def _first_sheet(path: Path, sheets: list[list[list[Any]]]) -> RawTable:
    """Return the first sheet with a row of mostly numbers."""
    for rows in sheets:
        for first, row in enumerate(rows):
            if sum(isinstance(c, int | float) for c in row) >= max(1, sum(c is not None for c in row) / 2):
                return _table_of_cells(path, rows, first)
    raise DatasetError(f"{path} has no sheet with numbers.", "Give the sheet as CSV.")


def _table_of_cells(path: Path, rows: list[list[Any]], first: int) -> RawTable:
    width = max(len(r) for r in rows[first:])
    head = rows[first - 1] if first else []
    names = tuple(str(head[i]) if i < len(head) and head[i] is not None else "" for i in range(width))
    filled = {i: r for i, r in enumerate(rows[first:], first + 1) if any(c is not None for c in r)}
    cells = tuple(
        ["" if i >= len(r) or r[i] is None else str(r[i]) for r in filled.values()] for i in range(width)
    )
    line = np.array(list(filled), dtype=np.int64)
    return RawTable(path, names, ("",) * width, cells, line, max(first, 1))
