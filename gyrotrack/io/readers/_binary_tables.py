"""Tables in binary files: Excel, zipped CSV, MATLAB, Parquet, JSON, netCDF."""

from __future__ import annotations

import io
import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io.readers._raw_table import MOST_BYTES, RawTable, content_lines, read_text, table_of


def read_zip(path: Path, sha256: str, content: bytes) -> RawTable:
    """Return the table of an Excel workbook, or of the one CSV in an archive (phyphox puts its data beside ``meta/``).

    Raises
    ------
    DatasetError
        The archive is damaged, holds no table or several, or is far too large.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(i.file_size for i in archive.infolist()) > MOST_BYTES:
                raise DatasetError(f"{path} unpacks to more than 1 GiB.", "Unpack it and give the table.")
            names = [n for n in archive.namelist() if not n.endswith("/")]
            if "[Content_Types].xml" in names:
                return _workbook(path, sha256, content)
            tables = [
                n
                for n in names
                if n.lower().endswith((".csv", ".txt", ".tsv")) and not n.lower().startswith("meta/")
            ]
            if len(tables) != 1:
                raise DatasetError(
                    f"{path} holds {len(tables)} tables of text{': ' + ', '.join(tables)[:100] if tables else ''}.",
                    "Unpack it and give one of them.",
                )
            return read_text(path, sha256, content_lines(path, archive.read(tables[0])))
    except (zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError, OSError) as error:
        raise DatasetError(f"{path} is a damaged archive: {error}.", "Fetch or export it again.") from error


def _workbook(path: Path, sha256: str, content: bytes) -> RawTable:
    """Return the first sheet with numbers of an Excel workbook (.xlsx)."""
    try:
        import openpyxl
    except ImportError:
        raise UsageError(
            "Excel workbooks need openpyxl, which is not installed.",
            'Run: pip install "gyrotrack[tables]"; or export CSV.',
        ) from None
    try:
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        sheets = [[list(row) for row in sheet.iter_rows(values_only=True)] for sheet in book.worksheets]
    except Exception as error:
        raise DatasetError(f"{path} is a damaged workbook: {str(error)[:100]}.", "Save it again.") from error
    for rows in sheets:
        first = next(
            (
                i
                for i, r in enumerate(rows)
                if sum(isinstance(c, int | float) for c in r) >= max(1, sum(c is not None for c in r) / 2)
            ),
            None,
        )
        if first is not None:
            return _of_cells(path, sha256, rows, first)
    raise DatasetError(f"{path} has no sheet with numbers.", "Give the sheet as CSV.")


def _of_cells(path: Path, sha256: str, rows: list[list[Any]], first: int) -> RawTable:
    width = max(len(r) for r in rows[first:])
    head = rows[first - 1] if first else []
    names = tuple(str(head[i]) if i < len(head) and head[i] is not None else "" for i in range(width))
    cells = tuple(
        [
            "" if i >= len(r) or r[i] is None else str(r[i])
            for r in rows[first:]
            if any(c is not None for c in r)
        ]
        for i in range(width)
    )
    line = np.array(
        [i + 1 for i, r in enumerate(rows) if i >= first and any(c is not None for c in r)], dtype=np.int64
    )
    return RawTable(path, sha256, names, ("",) * width, cells, line, max(first, 1))


def read_matlab(path: Path, sha256: str, content: bytes) -> RawTable:
    """Return the vectors of equal length, or the columns of the one matrix, in a MATLAB file (version 5 or older).

    Raises
    ------
    DatasetError
        The file is damaged or has no such variables.
    """
    from scipy.io import loadmat

    try:
        held = loadmat(io.BytesIO(content))  # type: ignore[arg-type]
    except Exception as error:
        raise DatasetError(
            f"{path} is not a readable MATLAB file: {str(error)[:100]}.", "Save it with -v7."
        ) from error
    arrays = {k: v for k, v in held.items() if not k.startswith("__") and isinstance(v, np.ndarray)}
    for name, value in list(arrays.items()):  # a struct: its fields
        if value.dtype.names and value.size == 1:
            arrays |= {n: np.asarray(value[n].ravel()[0]) for n in value.dtype.names}
            del arrays[name]
    plain = {k: v for k, v in arrays.items() if v.dtype.kind in "iuf" and v.ndim <= 2 and v.size > 1}
    vectors = {k: v.ravel() for k, v in plain.items() if min(v.shape) == 1 or v.ndim == 1}
    if vectors:
        longest = max(len(v) for v in vectors.values())
        vectors = {k: v for k, v in vectors.items() if len(v) == longest}
        return table_of(path, sha256, list(vectors), list(vectors.values()))
    matrices = [v for v in plain.values() if v.ndim == 2]
    if len(matrices) == 1:
        matrix = matrices[0]
        return table_of(path, sha256, [""] * matrix.shape[1], list(matrix.T))
    raise DatasetError(
        f"{path} has no vectors of equal length and not one matrix.", "Save time and angle as vectors."
    )


def read_parquet(path: Path, sha256: str, content: bytes) -> RawTable:
    """Return the numeric columns of a Parquet file, with the units of their metadata.

    Raises
    ------
    DatasetError, UsageError
        The file is damaged, or pyarrow is not installed.
    """
    try:
        import pyarrow.parquet as pq
    except ImportError:
        raise UsageError(
            "Parquet needs pyarrow, not installed here.", 'Run: pip install "gyrotrack[notebook]"'
        ) from None
    try:
        table = pq.read_table(io.BytesIO(content))
    except Exception as error:
        raise DatasetError(
            f"{path} is a damaged Parquet file: {str(error)[:100]}.", "Export it again."
        ) from error
    names, units, columns = [], [], []
    for field, column in zip(table.schema, table.columns, strict=True):
        values = column.to_pylist()
        names.append(field.name)
        units.append(((field.metadata or {}).get(b"units", b"")).decode("utf-8", "replace"))
        columns.append(values)
    return _typed(path, sha256, names, units, columns)


def read_json(path: Path, sha256: str, content: bytes) -> RawTable:
    """Return the columns of a JSON table: an object of lists, or a list of objects; ``units`` beside it.

    Raises
    ------
    DatasetError
        It is not JSON, or not of this form.
    """
    try:
        document = json.loads(content.decode("utf-8-sig"))
        units: dict[str, Any] = {}
        if isinstance(document, dict) and isinstance(document.get("columns"), dict):
            units, document = dict(document.get("units") or {}), document["columns"]
        if isinstance(document, list):
            document = {k: [row.get(k) for row in document] for k in document[0]}
        columns = {str(k): v for k, v in document.items() if isinstance(v, list) and v}
        longest = max(len(v) for v in columns.values())
    except (ValueError, RecursionError, AttributeError, LookupError, TypeError) as error:
        raise DatasetError(f"{path} is not a JSON table.", 'Write {"t": [...], "angle": [...]}.') from error
    columns = {k: v for k, v in columns.items() if len(v) == longest}
    return _typed(
        path, sha256, list(columns), [str(units.get(k, "")) for k in columns], list(columns.values())
    )


def _typed(path: Path, sha256: str, names: list[str], units: list[str], columns: list[list[Any]]) -> RawTable:
    """Return a table of columns as they come: numbers, or cells of text."""
    made: list[Any] = []
    for values in columns:
        if all(v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in values):
            made.append(np.array([math.nan if v is None else float(v) for v in values]))
        else:
            made.append(["" if v is None else str(v) for v in values])
    rows = len(made[0]) if made else 0
    return RawTable(
        path, sha256, tuple(names), tuple(units), tuple(made), np.arange(1, rows + 1, dtype=np.int64)
    )
