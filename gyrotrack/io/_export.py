"""Recordings and cases for other programs: CSV, Parquet, netCDF, JSON, text of OSP Tracker; `import` reads all back."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from gyrotrack._errors import UsageError
from gyrotrack.io._atomic import new_file
from gyrotrack.io._hdf5 import read_case, read_kind, read_recording
from gyrotrack.io._records import Column, columns
from gyrotrack.io._schema import CASE

_BLOCK = 20_000
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def export_file(source: Path, target: Path, *, table: str = "motion", force: bool = False) -> dict[str, Any]:
    """Write a recording or a case in the form that the suffix of `target` names.

    Parameters
    ----------
    source : Path
        A recording or a case.
    target : Path
        ``.csv`` (units in the header, numbers with all their digits, empty cells for NaN), ``.parquet`` (units
        in the fields' metadata), ``.json`` (columns and units), ``.txt`` (OSP Tracker: a point on the unit circle for
        each body) or ``.nc`` (netCDF-4 with everything that the file holds).
    table : str
        Which table of `columns`; netCDF takes them all.
    force : bool
        Replace an existing file.

    Returns
    -------
    dict
        ``rows`` and ``columns``, or ``groups`` of a netCDF file.

    Raises
    ------
    DatasetError, OutputError
        The source cannot be read, or the target not written.
    UsageError
        The suffix or the table is none of those known, or a library for it is not installed.
    """
    form = FORMATS.get(target.suffix.lower())
    if form is None:
        raise UsageError(
            f"{target.name} has a suffix that is no known format.", f"Known: {', '.join(FORMATS)}."
        )
    kind = read_kind(source)
    if form is _netcdf:
        return _netcdf(source, target, force=force)
    made = columns(read_case(source) if kind == CASE else read_recording(source), table)
    with new_file(target, force=force) as stream:
        form(made, stream)
    return {"rows": len(made[0].values), "columns": {c.name: c.unit for c in made}}


def _csv(made: Sequence[Column], stream: BinaryIO) -> None:
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([c.heading for c in made])
    for start in range(0, len(made[0].values), _BLOCK):
        writer.writerows(zip(*(_cells(c, slice(start, start + _BLOCK)) for c in made), strict=True))
    text.flush()
    text.detach()


def _cells(column: Column, rows: slice) -> list[str]:
    values = column.values[rows].tolist()
    if column.values.dtype.kind == "f":
        return ["" if v != v else repr(v) for v in values]
    if column.values.dtype.kind == "O":
        return [plain_cell(str(v)) for v in values]
    return [str(v) for v in values]


def plain_cell(text: str) -> str:
    """Return a text that no spreadsheet interprets as a formula."""
    return "'" + text if text.startswith(_FORMULA) else text


def _parquet(made: Sequence[Column], stream: BinaryIO) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise _lacking("Parquet", "pyarrow") from None
    words = [c.values.dtype.kind == "O" for c in made]
    arrays = [
        pa.array(c.values.tolist() if w else np.asarray(c.values)) for c, w in zip(made, words, strict=True)
    ]
    fields = [
        pa.field(c.name, a.type, metadata={"units": c.unit} if c.unit else None)
        for c, a in zip(made, arrays, strict=True)
    ]
    units = json.dumps({c.name: c.unit for c in made if c.unit})
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={"units": units}))
    pq.write_table(table, stream)


def _json(made: Sequence[Column], stream: BinaryIO) -> None:
    """Write columns and units; NaN becomes null."""
    values = {c.name: [None if v != v else v for v in c.values.tolist()] for c in made}
    document = {"columns": values, "units": {c.name: c.unit for c in made if c.unit}}
    stream.write(json.dumps(document, allow_nan=False).encode())


def _tracker(made: Sequence[Column], stream: BinaryIO) -> None:
    """Write a track for each body, cos and sin of its angle about the track "origin", at the times of all bodies."""
    columns = {c.name: c.values for c in made}
    if not {"body", "time", "angle"} <= set(columns):
        raise UsageError("A text of OSP Tracker holds angles of bodies only.", "Export --table motion.")
    bodies = list(dict.fromkeys(columns["body"].tolist()))
    times = np.unique(columns["time"])
    places = np.full((len(times), 2 * len(bodies)), np.nan)
    for k, body in enumerate(bodies):
        rows = columns["body"] == body
        at, angle = np.searchsorted(times, columns["time"][rows]), columns["angle"][rows]
        places[at, 2 * k], places[at, 2 * k + 1] = np.cos(angle), np.sin(angle)
    titles = ["", *(f"{body}\t" for body in bodies), "origin\t"]
    lines = ["\t".join(titles), "\t".join(["t", *("x", "y") * (len(bodies) + 1)])]
    for time, row in zip(times.tolist(), places.tolist(), strict=True):
        lines.append("\t".join([repr(time), *("" if v != v else repr(v) for v in row), "0.0", "0.0"]))
    stream.write(("\n".join(lines) + "\n").encode())


def _netcdf(source: Path, target: Path, *, force: bool) -> dict[str, Any]:
    try:
        import h5netcdf  # noqa: F401 - xarray's engine
        import xarray as xr
    except ImportError:
        raise _lacking("netCDF", "xarray and h5netcdf") from None
    with new_file(target, force=force) as stream, xr.open_datatree(source, engine="h5netcdf") as tree:
        stream.write(tree.to_netcdf(engine="h5netcdf"))
        return {"groups": [node.path for node in tree.subtree if node.data_vars]}


def _lacking(form: str, libraries: str) -> UsageError:
    return UsageError(
        f"{form} needs {libraries}, not installed here.", 'Install them: pip install "gyrotrack[notebook]"'
    )


FORMATS: dict[str, Callable[..., Any]] = {
    ".csv": _csv,
    ".parquet": _parquet,
    ".nc": _netcdf,
    ".json": _json,
    ".txt": _tracker,
}
