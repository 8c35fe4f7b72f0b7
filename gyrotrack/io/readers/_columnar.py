"""Tables stored by column: Parquet and JSON, and the tests of SysId."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io.readers._motion_table import ReadOptions, only_one
from gyrotrack.io.readers._raw_table import MAX_CELLS, RawTable, refuse_size, table_of
from gyrotrack.io.readers._spreadsheets import too_many_cells

_MAX_JSON = 2**25  # largest size of a JSON text [bytes]; its parsed objects need thirty times as much memory
_MOST_NUMBERS = 30_000_000  # largest number of numbers in a Parquet file
_NESTED = ("list", "struct", "map", "large_list", "fixed_size_list")
# indices of the columns of time, voltage, position and velocity in a test of a drive train, for each side
_SIDES = {"left": (0, 1, 3, 5), "right": (0, 2, 4, 6)}
_ROTATIONS = {"rotations": "turns", "radians": "rad", "degrees": "deg"}


def read_parquet(path: Path, content: bytes, _options: object) -> RawTable:
    """Return the numeric columns of a Parquet file, with the units of their metadata."""
    try:
        import pyarrow.parquet as pq
    except ImportError:
        what = "Parquet needs pyarrow, which is not installed."
        raise UsageError(what, 'Run: pip install "gyrotrack[notebook]"') from None
    try:
        file = pq.ParquetFile(io.BytesIO(content))
        kinds = {f.name: str(f.type) for f in file.schema_arrow}
    except Exception as error:
        raise _damaged(path, error) from error
    rows = file.metadata.num_rows
    refuse_size(path, rows, file.metadata.num_columns)
    plain = [n for n, kind in kinds.items() if not kind.startswith(_NESTED)]
    words = [n for n in plain if "string" in kinds[n] or "binary" in kinds[n]]
    if not plain:
        raise DatasetError(f"{path} contains nested columns only.", "Export columns of numbers.")
    if rows * len(words) > MAX_CELLS:
        raise too_many_cells(path)
    if rows * len(plain) > _MOST_NUMBERS:
        raise too_many_cells(path, _MOST_NUMBERS)
    try:
        # repeated texts are stored once
        table = pq.read_table(io.BytesIO(content), columns=plain, read_dictionary=words)
    except Exception as error:
        raise _damaged(path, error) from error
    names, units, columns = [], [], []
    for field, column in zip(table.schema, table.columns, strict=True):
        names.append(field.name)
        units.append(((field.metadata or {}).get(b"units", b"")).decode("utf-8", "replace"))
        columns.append(_parquet_column(column))
    return _table_of_lists(path, names, units, columns)


def _damaged(path: Path, error: Exception) -> DatasetError:
    return DatasetError(f"{path} is a damaged Parquet file: {str(error)[:100]}.", "Export it again.")


def _parquet_column(column: Any) -> Any:
    """Return the values of a column: numbers as an array, others as a list."""
    kind = str(column.type)
    if kind.startswith("dictionary"):
        parts = [(c.dictionary.to_pylist(), c.indices.to_pylist()) for c in column.chunks]
        return [None if i is None else words[i] for words, held in parts for i in held]
    if kind.startswith(("int", "uint", "float", "double", "half")):
        return np.asarray(column.to_numpy(), dtype=float)
    if kind.startswith("timestamp"):
        return column.cast("timestamp[ns]").cast("int64").to_numpy() * 1e-9
    return column.to_pylist()


def read_json(path: Path, content: bytes, options: ReadOptions) -> RawTable:
    """Return the columns of a JSON table (object of lists, or list of objects), with units from ``units`` beside it."""
    if len(content) > _MAX_JSON:
        what = f"{path} is larger than {_MAX_JSON >> 20} MiB."
        raise DatasetError(what, "Export a part of the record, or CSV.")
    try:
        document = json.loads(content.decode("utf-8-sig"))
        if isinstance(document, dict) and "sysid" in document:
            return _characterisation(path, document, options)
        units: dict[str, Any] = {}
        if isinstance(document, dict) and isinstance(document.get("columns"), dict):
            units, document = dict(document.get("units") or {}), document["columns"]
        if isinstance(document, list):
            refuse_size(path, len(document), len(document[0]))
            document = {k: [row.get(k) for row in document] for k in document[0]}
        columns = {str(k): v for k, v in document.items() if isinstance(v, list) and v}
        longest = max(len(v) for v in columns.values())
        refuse_size(path, longest, len(columns))
    except (ValueError, RecursionError, AttributeError, LookupError, TypeError) as error:
        raise DatasetError(f"{path} is not a JSON table.", 'Write {"t": [...], "angle": [...]}.') from error
    columns = {k: v for k, v in columns.items() if len(v) == longest}
    named = [str(units.get(k, "")) for k in columns]
    return _table_of_lists(path, list(columns), named, list(columns.values()))


def _characterisation(path: Path, document: Mapping[str, Any], options: ReadOptions) -> RawTable:
    """Return one test of a motor-driven mechanism by SysId of WPILib: voltage, position and velocity.

    The option `marker` selects the test, and the side of a drive train: "fast-forward left".
    """
    tests = {k: v for k, v in document.items() if isinstance(v, list) and v and isinstance(v[0], list)}
    width = {len(row) for rows in tests.values() for row in rows}
    if width not in ({4}, {9}):
        what = f"{path} is a file of SysId whose rows have {sorted(width)} numbers; 4 or 9 are known."
        raise DatasetError(what, "Export t, position and velocity as CSV.")
    sides = _SIDES if width == {9} else {"": (0, 1, 2, 3)}
    series = {f"{test} {side}".strip(): (rows, sides[side]) for test, rows in tests.items() for side in sides}
    name = only_one(path, list(series), "driven tests", options)
    rows, places = series[name]
    table = np.array([[float(row[i]) for i in places] for row in rows])
    unit = _ROTATIONS.get(str(document.get("units", "")).casefold(), str(document.get("units", "")))
    return replace(
        table_of(path, ["t", "voltage", "angle", "omega"], list(table.T)), units=("s", "V", unit, f"{unit}/s")
    )


def _table_of_lists(path: Path, names: list[str], units: list[str], columns: list[Any]) -> RawTable:
    """Return a table of columns of numbers or text."""
    made: list[Any] = []
    for values in columns:
        if isinstance(values, np.ndarray):
            made.append(values)
        elif all(v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in values):
            made.append(np.array([math.nan if v is None else float(v) for v in values]))
        else:
            made.append(["" if v is None else str(v) for v in values])
    rows = len(made[0]) if made else 0
    return RawTable(path, tuple(names), tuple(units), tuple(made), np.arange(1, rows + 1, dtype=np.int64))
