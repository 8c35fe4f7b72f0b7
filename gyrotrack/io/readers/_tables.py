"""Tables of other programs: text with points (OSP Tracker, DeepLabCut, SLEAP), Excel, MATLAB, Parquet, JSON."""

from __future__ import annotations

import io
import json
import math
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io._records import Floats
from gyrotrack.io.readers._points import Points
from gyrotrack.io.readers._raw_table import (
    MAX_BYTES,
    Lines,
    RawTable,
    content_lines,
    delimiter_of,
    factor,
    header_of,
    is_number,
    number_of,
    read_text,
    role_of,
    split,
    table_of,
)


def read_point_table(path: Path, lines: Lines) -> Points | None:
    """Read points from the lines of a file; None if it is not a table of points."""
    first = split(lines[0][1], delimiter_of(lines[0][1]))
    if first[0].casefold() == "scorer":
        return _deeplabcut(path, lines)
    if "frame_idx" in first:
        return _sleap(path, lines)
    return _tracker(path, lines)


def _tracker(path: Path, lines: Lines) -> Points | None:
    """Read an export of OSP Tracker: a line with the names of the tracks, then t, x, y."""
    for above in range(min(3, len(lines))):
        head = lines[above][1]
        delimiter = delimiter_of(head)
        names = [n.casefold() for n in split(head, delimiter)]
        if "x" in {_axis(n)[0] for n in names} and "y" in {_axis(n)[0] for n in names}:
            break
        if any(is_number(n) for n in names):
            return None
    else:
        return None
    if {"x", "y", "z"} <= set(names):
        raise DatasetError(
            f"{path}, line {lines[above][0]}: the columns x, y and z may be coordinates or axes of a gyroscope.",
            "Give --column omega=z for the rate about z, or --column x=x --column y=y for a path in this plane.",
        )
    titles = split(lines[above - 1][1], delimiter) if above else []
    roles = [role_of(header_of(n)[0]) for n in names]
    time = [i for i, r in enumerate(roles) if r == "t"] or [i for i, r in enumerate(roles) if r == "frame"]
    if not time:
        what = f"{path}, line {lines[above][0]}: there is no column for the time."
        raise DatasetError(what, "Export t together with x and y.")
    unit = header_of(names[time[0]])[1] if roles[time[0]] == "t" else ""
    if (scale := factor("t", unit) if unit else 1.0) is None:
        raise DatasetError(f"{path}, line {lines[above][0]}: unknown unit '{unit[:30]}' of the time.")
    columns = _tracks(split(head, delimiter), titles, path)
    table = _numbers(
        path, lines[above + 1 :], delimiter, len(names), sorted({time[0], *sum(columns.values(), ())})
    )
    places = {name: np.stack([table[x], table[y]], axis=1) for name, (x, y) in columns.items()}
    counted = roles[time[0]] == "frame"
    return Points(path, scale * table[time[0]], places, {}, y_down=False, counted=counted)


def _axis(name: str) -> tuple[str, str]:
    """Split ``x``, ``x_{mass A}``, ``x_A``, ``A_x``, ``A.x`` or ``x (m)`` into axis and track."""
    bare = re.sub(r"\s*[\[(][^\])]*[\])]$", "", name.strip())
    unit = header_of(name)[1]
    if "/" in unit or factor("", unit) is not None:  # an axis of a sensor, not a coordinate
        return "", ""
    bare = re.sub(r"_(px|m|cm|mm)$", "", bare)
    found = re.fullmatch(r"([xyXY])(?:[_ ]\{?(.+?)\}?)?|(.+?)[_. ]([xyXY])", bare)
    if found is None:
        return "", ""
    axis, track = (found[1] or found[4]).casefold(), (found[2] or found[3] or "").strip()
    sensor = role_of(track) == "omega" or bool(_SENSOR.match(track))
    return ("", "") if sensor else (axis, track)


# vectors of the sensors of a phone or an inertial unit, other than the angular velocity
_SENSOR = re.compile(r"(lin(ear)?[_ ]?)?(acc|accel\w*|mag|magnet\w*|gravity|grav)$", re.IGNORECASE)


def _tracks(heads: list[str], titles: list[str], path: Path) -> dict[str, tuple[int, int]]:
    """Return the columns of x and y of each track; a name above a group of columns applies until the next one."""
    seen: dict[str, dict[str, int]] = {}
    title = ""
    for i, head in enumerate(heads):
        title = titles[i] if i < len(titles) and titles[i] else title
        axis, track = _axis(head)
        if not axis:
            continue
        name = track or title or path.stem
        number = 1
        while axis in seen.get(name if number == 1 else f"{name} {number}", {}):
            number += 1
        seen.setdefault(name if number == 1 else f"{name} {number}", {})[axis] = i
    return {name: (axes["x"], axes["y"]) for name, axes in seen.items() if {"x", "y"} <= set(axes)}


def _deeplabcut(path: Path, lines: Lines) -> Points:
    """Read CSV of DeepLabCut: rows scorer, (individuals,) bodyparts, coords; then frame and x, y, likelihood."""
    heads: dict[str, list[str]] = {}
    rows = 0
    for _, line in lines[:4]:
        cells = split(line, ",")
        if is_number(cells[0]) or not cells[0]:
            break
        heads[cells[0].casefold()] = cells
        rows += 1
    if not {"bodyparts", "coords"} <= set(heads):
        what = f"{path} looks like a file of DeepLabCut but has no rows 'bodyparts' and 'coords'."
        raise DatasetError(what, "Export it again from DeepLabCut.")
    width = len(heads["coords"])
    table = _numbers(path, lines[rows:], ",", width, range(width))
    single = len(set(heads.get("individuals", ["", ""])[1:])) < 2
    columns = []
    for i in range(1, width):
        part = heads["bodyparts"][i] if single else f"{heads['individuals'][i]}.{heads['bodyparts'][i]}"
        columns.append((part, heads["coords"][i], table[i]))
    return grouped_points(path, table[0], columns)


def _sleap(path: Path, lines: Lines) -> Points:
    """Read CSV of SLEAP: track, frame_idx, instance.score, then node.x, node.y, node.score."""
    delimiter = delimiter_of(lines[0][1])
    heads = split(lines[0][1], delimiter)
    track = heads.index("track") if "track" in heads else None
    tracks = {split(line, delimiter)[track] for _, line in lines[1:]} if track is not None else {""}
    if len(tracks) > 1:
        raise DatasetError(f"{path} contains {len(tracks)} tracked instances.", "Export one instance.")
    split_heads = [h.rpartition(".") for h in heads]
    wanted = [i for i, (_, _, what) in enumerate(split_heads) if what in {"frame_idx", "x", "y", "score"}]
    table = _numbers(path, lines[1:], delimiter, len(heads), wanted)
    parts = [(split_heads[i][0], split_heads[i][2], values) for i, values in table.items()]
    return grouped_points(
        path, table[heads.index("frame_idx")], [p for p in parts if p[0] and p[0] != "instance"]
    )


def grouped_points(path: Path, frame: Floats, columns: list[tuple[str, str, Floats]]) -> Points:
    """Return points in an image from columns of (name of the point, x or y or likelihood or score, values)."""
    points: dict[str, dict[str, Floats]] = {}
    for name, what, values in columns:
        points.setdefault(name, {})["likelihood" if what in {"likelihood", "score"} else what] = values
    whole = {n: p for n, p in points.items() if {"x", "y"} <= set(p)}
    places = {n: np.stack([p["x"], p["y"]], axis=1) for n, p in whole.items()}
    likelihood = {n: p["likelihood"] for n, p in whole.items() if "likelihood" in p}
    return Points(path, frame, places, likelihood, y_down=True, counted=True)


def _numbers(
    path: Path, lines: Lines, delimiter: str | None, width: int, wanted: Sequence[int] | range
) -> dict[int, Floats]:
    rows: list[list[float]] = []
    for number, line in lines:
        cells = split(line, delimiter)
        if delimiter is not None and len(cells) == width + 1 and not cells[-1]:
            cells = cells[:-1]
        if number == lines[-1][0] and len(cells) < width and len(rows) > 1:
            break  # truncated last row
        if len(cells) > width or (len(cells) < width and delimiter is None):
            raise DatasetError(f"{path}, line {number}: {len(cells)} cells where the header has {width}.")
        cells += [""] * (width - len(cells))
        rows.append([_number(path, number, cells[i], decimal=delimiter != ",") for i in wanted])
    table = np.array(rows, dtype=float).reshape(len(rows), len(wanted))
    return {i: table[:, k] for k, i in enumerate(wanted)}


def _number(path: Path, line: int, cell: str, *, decimal: bool) -> float:
    value = number_of(cell, decimal_comma=decimal)
    if value is None:
        what = f"{path}, line {line}: '{cell[:30]}' is not a number."
        raise DatasetError(what, "Use an empty cell for a missing value.")
    return value


def read_zip(path: Path, content: bytes, _options: object) -> RawTable:
    """Return the table of an Excel workbook, or of the only CSV file in an archive (except ``meta/`` of phyphox)."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(i.file_size for i in archive.infolist()) > MAX_BYTES:
                what = f"{path} is larger than 1 GiB when unpacked."
                raise DatasetError(what, "Unpack it and give the table.")
            names = [n for n in archive.namelist() if not n.endswith("/")]
            if "[Content_Types].xml" in names:
                return _workbook(path, content)
            texts = [n for n in names if n.lower().endswith((".csv", ".txt", ".tsv"))]
            tables = [n for n in texts if not n.lower().startswith("meta/")]
            if len(tables) != 1:
                which = f": {', '.join(tables)[:100]}" if tables else ""
                what = f"{path} contains {len(tables)} tables of text{which}."
                raise DatasetError(what, "Unpack it and give one of them.")
            return read_text(path, *content_lines(path, archive.read(tables[0])))
    except (zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError, OSError) as error:
        what = f"{path} is a damaged archive: {error}."
        raise DatasetError(what, "Download or export it again.") from error


def _workbook(path: Path, content: bytes) -> RawTable:
    """Return the first sheet with numbers of an Excel workbook (.xlsx)."""
    try:
        import openpyxl
    except ImportError:
        raise _missing_library("Excel workbooks need openpyxl") from None
    try:
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        sheets = [[list(row) for row in sheet.iter_rows(values_only=True)] for sheet in book.worksheets]
    except Exception as error:
        raise DatasetError(f"{path} is a damaged workbook: {str(error)[:100]}.", "Save it again.") from error
    return _first_sheet(path, sheets)


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


def read_matlab(path: Path, content: bytes, _options: object) -> RawTable:
    """Return the vectors of equal length, or the columns of a matrix, in a MATLAB file (before version 7.3)."""
    from scipy.io import loadmat

    try:
        held = loadmat(io.BytesIO(content))  # type: ignore[arg-type]
    except Exception as error:
        what = f"{path} is not a readable MATLAB file: {str(error)[:100]}."
        raise DatasetError(what, "Save it with -v7.") from error
    arrays = {k: v for k, v in held.items() if not k.startswith("__") and isinstance(v, np.ndarray)}
    for name, value in list(arrays.items()):  # the fields of a struct
        if value.dtype.names and value.size == 1:
            arrays |= {n: np.asarray(value[n].ravel()[0]) for n in value.dtype.names}
            del arrays[name]
    return table_of_arrays(path, arrays)


def table_of_arrays(path: Path, arrays: Mapping[str, npt.NDArray[Any]]) -> RawTable:
    """Return the longest vectors of equal length, or the columns of the only matrix, among named arrays."""
    plain = {k: v for k, v in arrays.items() if v.dtype.kind in "iuf" and v.ndim <= 2 and v.size > 1}
    vectors = {k: v.ravel() for k, v in plain.items() if min(v.shape) == 1 or v.ndim == 1}
    if vectors:
        longest = max(len(v) for v in vectors.values())
        vectors = {k: v for k, v in vectors.items() if len(v) == longest}
        return table_of(path, list(vectors), list(vectors.values()))
    matrices = [v for v in plain.values() if v.ndim == 2]
    if len(matrices) == 1:
        matrix = matrices[0]
        return table_of(path, [""] * matrix.shape[1], list(matrix.T))
    what = f"{path} contains neither vectors of equal length nor a single matrix."
    raise DatasetError(what, "Save time and angle as vectors.")


def read_parquet(path: Path, content: bytes, _options: object) -> RawTable:
    """Return the numeric columns of a Parquet file, with the units of their metadata."""
    try:
        import pyarrow.parquet as pq
    except ImportError:
        what = "Parquet needs pyarrow, which is not installed."
        raise UsageError(what, 'Run: pip install "gyrotrack[notebook]"') from None
    try:
        table = pq.read_table(io.BytesIO(content))
    except Exception as error:
        what = f"{path} is a damaged Parquet file: {str(error)[:100]}."
        raise DatasetError(what, "Export it again.") from error
    names, units, columns = [], [], []
    for field, column in zip(table.schema, table.columns, strict=True):
        names.append(field.name)
        units.append(((field.metadata or {}).get(b"units", b"")).decode("utf-8", "replace"))
        columns.append(column.to_pylist())
    return _table_of_lists(path, names, units, columns)


def read_json(path: Path, content: bytes, _options: object) -> RawTable:
    """Return the columns of a JSON table: an object of lists, or a list of objects; ``units`` next to it."""
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
    named = [str(units.get(k, "")) for k in columns]
    return _table_of_lists(path, list(columns), named, list(columns.values()))


def _table_of_lists(path: Path, names: list[str], units: list[str], columns: list[list[Any]]) -> RawTable:
    """Return a table of columns of numbers or text."""
    made: list[Any] = []
    for values in columns:
        if all(v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in values):
            made.append(np.array([math.nan if v is None else float(v) for v in values]))
        else:
            made.append(["" if v is None else str(v) for v in values])
    rows = len(made[0]) if made else 0
    return RawTable(path, tuple(names), tuple(units), tuple(made), np.arange(1, rows + 1, dtype=np.int64))
