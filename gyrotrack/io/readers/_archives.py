"""Zip archives: workbooks of Excel, projects of Tracker (.trz), and tables of text."""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path

from gyrotrack._errors import DatasetError
from gyrotrack.io.readers._motion_table import ReadOptions, only_one
from gyrotrack.io.readers._point_files import read_project
from gyrotrack.io.readers._points import Points
from gyrotrack.io.readers._raw_table import MAX_BYTES, RawTable, factor, header_of, role_of
from gyrotrack.io.readers._spreadsheets import read_workbook
from gyrotrack.io.readers._text_table import content_lines, read_text

# errors of a damaged archive; zipfile raises a ValueError for a position before the beginning of the file
_DAMAGED = (
    zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError, OSError, ValueError, zlib.error,
)  # fmt: skip
_MOST_TABLES = 100
_START = 2**14  # number of bytes at the start of a table that are read to find its columns


def read_zip(path: Path, content: bytes, options: ReadOptions) -> RawTable | Points:
    """Return the table of an Excel workbook, the project of Tracker, or the table of text in an archive.

    An archive may contain several tables: phyphox writes a table per sensor, and tables in ``meta/``. In this case the
    only table with a motion is read. The option `marker` selects another table by its name.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(i.file_size for i in archive.infolist()) > MAX_BYTES:
                what = f"{path} is larger than {MAX_BYTES >> 20} MiB when unpacked."
                raise DatasetError(what, "Unpack it, and give a part of the record.")
            names = [n for n in archive.namelist() if not n.endswith("/")]
            if "[Content_Types].xml" in names:
                return read_workbook(path, content, options)
            if projects := [n for n in names if n.lower().endswith(".trk")]:
                return read_project(
                    path, archive.read(only_one(path, projects, "projects", options)), options
                )
            texts = [n for n in names if n.lower().endswith((".csv", ".txt", ".tsv"))]
            tables = [n for n in texts if not n.lower().startswith("meta/")]
            if len(tables) > _MOST_TABLES:
                what = f"{path} contains {len(tables):,} tables of text."
                raise DatasetError(what, "Unpack it, and give the table of the motion.")
            moving = [n for n in tables if len(tables) > 1 and _is_motion(path, archive, n)]
            chosen = only_one(path, moving if len(moving) == 1 else tables, "tables of text", options)
            return read_text(path, *content_lines(path, archive.read(chosen)))
    except _DAMAGED as error:
        what = f"{path} is a damaged archive: {error}."
        raise DatasetError(what, "Download or export it again.") from error


def _is_motion(path: Path, archive: zipfile.ZipFile, name: str) -> bool:
    """Return whether the start of a table of text has a column for an angle or an angular velocity."""
    with archive.open(name) as stream:
        start = stream.read(_START)
    if len(start) == _START:
        start = start[: start.rfind(b"\n") + 1]
    try:
        raw = read_text(path, *content_lines(path, start))
    except DatasetError:
        return False
    heads = [header_of(name) for name in raw.names]
    return any(role_of(n) in {"angle", "omega"} or factor("omega", u or "?") for n, u in heads)
