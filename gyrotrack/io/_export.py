"""Recordings and cases as flat tables: CSV, Parquet, netCDF."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import UsageError
from gyrotrack.io._atomic import new_file
from gyrotrack.io._hdf5 import read_case, read_kind, read_recording
from gyrotrack.io._records import STATUS, Case, Recording
from gyrotrack.io._schema import BODY, CASE, FRAME, MARKER, SERIES, Table

_WORDS = np.array(list(STATUS), dtype=object)


@dataclass(frozen=True)
class Column:
    """One column: its name, its unit ("" for words), and a value for each row."""

    name: str
    unit: str
    values: npt.NDArray[Any]

    @property
    def heading(self) -> str:
        """The name with its unit in brackets, as `import` reads it."""
        return (
            f"{self.name} [{_READABLE.get(self.unit, self.unit)}]"
            if self.unit not in {"", "1"}
            else self.name
        )


_READABLE = {"rad s-1": "rad/s"}


def columns(content: Recording | Case, table: str = "motion") -> tuple[Column, ...]:
    """Return a recording or a case as columns of equal length.

    Parameters
    ----------
    content : Recording or Case
        What to hand on.
    table : {"motion", "markers", "frames"}
        The angles and speeds of the bodies; every marker in every frame; the frames of each clip. The rows of
        several bodies, markers or clips follow one another and are told apart by the first columns.

    Returns
    -------
    tuple of Column
        Times in s, angles in rad, speeds in rad s-1, lengths in px; NaN where nothing is known.

    Raises
    ------
    UsageError
        There is no such table, or nothing in it.
    """
    if table not in TABLES:
        raise UsageError(f"There is no table '{table}'.", f"There are: {', '.join(TABLES)}.")
    parts = TABLES[table](content)
    if not parts:
        raise UsageError(f"There are no {table} in this file.", "Recordings of films hold them.")
    return tuple(
        Column(c.name, c.unit, np.concatenate([part[i].values for part in parts]))
        for i, c in enumerate(parts[0])
    )


def to_dataframe(content: Recording | Case, table: str = "motion") -> Any:
    """Return `columns` as a pandas DataFrame; the units stand in its ``attrs["units"]``.

    Raises
    ------
    UsageError
        As for `columns`, or pandas is not installed.

    Examples
    --------
    >>> from gyrotrack.dataset import read_case
    >>> frame = to_dataframe(read_case("case1.h5"))  # doctest: +SKIP
    >>> frame.groupby("body")["omega"].max()  # doctest: +SKIP
    """
    try:
        import pandas as pd
    except ImportError:
        raise UsageError(
            "A DataFrame needs pandas, which is not installed.",
            'Install it: pip install "gyrotrack[notebook]"',
        ) from None
    made = columns(content, table)
    frame = pd.DataFrame({c.name: c.values for c in made})
    frame.attrs["units"] = {c.name: c.unit for c in made if c.unit}
    return frame


def _motion(content: Recording | Case) -> list[list[Column]]:
    if isinstance(content, Recording):
        return [
            [_word("body", name, len(body.time)), *_of(BODY, vars(body))]
            for name, body in content.bodies.items()
        ]
    parts = []
    for name, series in (("casing", content.casing), ("rotor", content.rotor)):
        rows = len(series.time)
        window = series.window if series.window is not None else np.zeros(rows, dtype=np.int64)
        parts.append([_word("body", name, rows), Column("window", "1", window), *_of(SERIES, vars(series))])
    return [part for part in parts if len(part[0].values)]


def _markers(content: Recording | Case) -> list[list[Column]]:
    return [
        [
            _word("clip", clip, len(recording.time)),
            _word("marker", name, len(recording.time)),
            _word("body", marker.body, len(recording.time)),
            *_of(MARKER, {**vars(marker), "frame": recording.frame_index}),
        ]
        for clip, recording in _clips(content).items()
        for name, marker in recording.markers.items()
    ]


def _frames(content: Recording | Case) -> list[list[Column]]:
    return [
        [
            _word("clip", clip, len(r.time)),
            *_of(FRAME, {**vars(r), "frame": r.frame_index, "index": r.frame_index}),
        ]
        for clip, r in _clips(content).items()
    ]


TABLES: dict[str, Callable[[Recording | Case], list[list[Column]]]] = {
    "motion": _motion,
    "markers": _markers,
    "frames": _frames,
}


def _clips(content: Recording | Case) -> dict[str, Recording]:
    return {content.source: content} if isinstance(content, Recording) else content.recordings


def _word(name: str, word: str, rows: int) -> Column:
    return Column(name, "", np.full(rows, word, dtype=object))


def _of(table: Table, values: Mapping[str, Any]) -> list[Column]:
    """Return the fields of a layout's table, those with more than one number a sample spread out."""
    made = []
    for f in table.fields:
        value = np.asarray(values[f.name])
        if f.name == "status":
            made.append(Column(f.name, "", _WORDS[value]))
        elif value.ndim == 1:
            made.append(Column(f.name, f.units, value))
        else:
            for place in np.ndindex(value.shape[1:]):
                *side, axis = place
                name = "_".join([f.name, *(str(s) for s in side), "xy"[axis]])
                made.append(Column(name, f.units, value[(slice(None), *place)]))
    return made


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
        in the fields' metadata) or ``.nc`` (netCDF-4 with everything that the file holds).
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
    """Return a word that no spreadsheet takes for a formula."""
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


FORMATS: dict[str, Callable[..., Any]] = {".csv": _csv, ".parquet": _parquet, ".nc": _netcdf}
