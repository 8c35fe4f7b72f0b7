"""Writes and reads recordings and cases according to the schema.

HDF5 ends the process if a write fails, or if Python raises an error during a write. Writes therefore never fail here.
The first error of the disk is stored, and later writes go to memory until the library has closed the file. An interrupt
by the user is deferred until the file is closed. Every file ends with a checksum line.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import BytesIO, RawIOBase
from pathlib import Path
from typing import Any

import h5py

from fitting import _case_format as layout
from fitting._hdf5 import checksum_line
from fitting._stored_case import StoredCase, read_stored_case
from gyrotrack._column_store import in_file
from gyrotrack._errors import DatasetError
from gyrotrack.io import _schema as schema
from gyrotrack.io._atomic import new_file
from gyrotrack.io._bodies import series_from, write_bodies
from gyrotrack.io._records import (
    BodyTrack,
    Case,
    ChainBody,
    GeneratedCurve,
    Input,
    MarkerTrack,
    Placement,
    PointTrack,
    Recording,
    no_series,
)
from gyrotrack.io._tables import READER, stamp, to_json, write_attributes, write_table


class WriteBuffer:
    """A binary file whose writes do not fail: after an `error` of the disk the data are kept in memory."""

    def __init__(self, raw: RawIOBase) -> None:
        self.error: OSError | None = None
        self._stream: RawIOBase | BytesIO = raw

    def seek(self, position: int, whence: int = 0) -> int:
        """Set the position [bytes] and return it."""
        return self._stream.seek(position, whence)

    def tell(self) -> int:
        """Return the position."""
        return self._stream.tell()

    def read(self, size: int = -1) -> bytes:
        """Read from the position."""
        return self._stream.read(size) or b""

    def write(self, data: Any) -> int:
        """Write at the position."""
        start, rest = self._stream.tell(), memoryview(data)
        try:
            while rest:
                rest = rest[self._stream.write(rest) or 0 :]
        except OSError as error:
            self._continue_in_memory(error)
            self._stream.seek(start)
            self._stream.write(data)
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Set the length."""
        try:
            return self._stream.truncate(size)
        except OSError as error:
            self._continue_in_memory(error)
            return self._stream.truncate(size)

    def flush(self) -> None:
        """Do nothing: the stream is unbuffered."""

    def _continue_in_memory(self, error: OSError) -> None:
        self.error = error
        self._stream.seek(0)
        self._stream = BytesIO(self._stream.read() or b"")


@contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Defer an interrupt by the user (SIGINT) to the end of the context."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    received: list[Any] = []
    signal.signal(signal.SIGINT, lambda *which: received.append(which))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if received:
            before(*received[0])


LIBVER = ("v110", "v110")  # the first version of the file format with checksums of the metadata


@contextmanager
def new_hdf5(path: Path, *, force: bool = False) -> Iterator[Any]:
    """Yield an empty HDF5 file; move it to `path` when the context ends without an error (see `_atomic.new_path`)."""
    with new_file(path, force=force) as stream:
        buffer = WriteBuffer(stream.raw)  # type: ignore[attr-defined]
        try:
            with deferred_interrupts(), h5py.File(buffer, "w", libver=LIBVER) as file:
                yield file
        finally:
            if buffer.error is not None:
                raise buffer.error
        stream.seek(0)
        stream.write(checksum_line(stream))


def write_recording(
    path: Path, recording: Recording, *, command: str, settings: Mapping[str, Any], force: bool = False
) -> Path:
    """Write a recording to an HDF5 file atomically.

    Parameters
    ----------
    path : Path
        The output; an existing file is replaced only with `force`.
    recording : Recording
        The recording.
    command : str
        The command line, stored in the file.
    settings : mapping
        Settings that determine the result, serialisable as JSON.

    Raises
    ------
    OutputError
        The file exists, or cannot be written.
    """
    with new_hdf5(Path(path), force=force) as file:
        stamp(file, layout.RECORDING, command=command, settings=settings)
        _write_recording_group(file, recording)
    return Path(path)


def _write_recording_group(group: Any, recording: Recording) -> None:
    write_attributes(group, schema.RECORDING_ATTRIBUTES, recording)
    group.attrs["warnings"] = to_json(recording.warnings)
    group.attrs["extra"] = to_json(recording.extra)
    index = recording.frame_index
    write_table(group.create_group("frame"), schema.FRAME, recording, frame=index, index=index)
    markers, bodies = group.create_group("marker"), group.create_group("body")
    for name, marker in recording.markers.items():
        write_table(markers.create_group(name), schema.MARKER, marker, frame=index)
    for name, body in recording.bodies.items():
        write_table(bodies.create_group(name), schema.BODY, body)
    if recording.points:
        points = group.create_group("point")
        for name, point in recording.points.items():
            write_table(points.create_group(name), schema.POINT, point)


def load_recording(group: Any) -> Recording:
    """Read a recording from its group."""
    frame: dict[str, Any] = dict(in_file(READER.table(READER.child_group(group, "frame"), schema.FRAME)))
    index = frame.pop("index")
    del frame["frame"]
    return Recording(
        **READER.attributes(group, schema.RECORDING_ATTRIBUTES),
        **frame,
        frame_index=index,
        markers={n: _load_marker(g, n, len(index)) for n, g in READER.members(group, "marker")},
        bodies={n: BodyTrack(name=n, **_load(g, schema.BODY)) for n, g in READER.members(group, "body")},
        warnings=tuple(READER.json(group, "warnings", [])),
        extra=dict(READER.json(group, "extra", {})),
        points={
            n: PointTrack(name=n, **_load(g, schema.POINT))
            for n, g in READER.members(group, "point", optional=True)
        },
    )


def _load(group: Any, table: layout.Table) -> dict[str, Any]:
    """Return the attributes of a table, and its columns as arrays stored in a file (`gyrotrack._column_store`)."""
    return {**in_file(READER.table(group, table)), **READER.attributes(group, table.attributes)}


def _load_marker(group: Any, name: str, frames: int) -> MarkerTrack:
    columns = _load(group, schema.MARKER)
    if len(columns.pop("frame")) != frames:
        raise DatasetError(f"{group.file.filename}: marker '{name}' and the clip differ in length.")
    return MarkerTrack(name=name, **columns)


def write_case(
    path: Path, case: Case, *, command: str, settings: Mapping[str, Any], force: bool = False
) -> Path:
    """Write a case to an HDF5 file atomically.

    Parameters
    ----------
    path : Path
        The output.
    case : Case
        Measured series [rad, rad/s, s] and moments of inertia [kg m2].
    command : str
        The command line, stored in the file.
    settings : mapping
        Settings that determine the result, serialisable as JSON.
    force : bool
        Replace an existing file.

    Raises
    ------
    OutputError
        The file exists and `force` is not given, or the file cannot be written.
    UsageError
        An inertia, an uncertainty or an error mode is not valid, so that the written file could not be read.
    """
    with new_hdf5(Path(path), force=force) as file:
        stamp(file, layout.CASE, command=command, settings=settings)
        write_attributes(file, layout.CASE_ATTRIBUTES, case)
        file.attrs["warnings"] = to_json(case.warnings)
        file.attrs["extra"] = to_json(case.extra)
        file.attrs["default"] = "body" if case.bodies == "chain" else "casing"
        if case.rotor_generated is not None:
            write_table(file.create_group("rotor_generated"), layout.GENERATED, case.rotor_generated)
        for i in case.inputs:
            group = file.require_group("input").create_group(i.name)
            write_table(group, layout.INPUT, i)
            for column in ("value", "u"):
                group[column].attrs["units"] = i.unit
        recordings = file.create_group("recording")
        for name, recording in case.recordings.items():
            group = recordings.create_group(name)
            _write_recording_group(group, recording)
            if name in case.placements:
                write_attributes(group, layout.PLACEMENT_ATTRIBUTES, case.placements[name])
        write_bodies(file, case)
    return Path(path)


@dataclass(frozen=True)
class LoadedCase:
    """The stored contents of a case file."""

    stored: StoredCase
    others: dict[str, Any]  # fields of `Case` that are not in `stored`, for example recordings

    def case(self) -> Case:
        """Return the case; angles or speeds that the file does not contain are computed."""
        stored, quantity = self.stored, self.stored.attributes["quantity"]
        others = [(s.name, series_from(s, quantity), *s.inertia) for s in stored.others]
        is_chain = bool(stored.joints)
        return Case(
            **stored.attributes,
            casing=replace(series_from(stored.casing, quantity), window=None),
            rotor=others[0][1] if others and not is_chain else no_series(),
            further=tuple(ChainBody(*other) for other in others) if is_chain else (),
            joints=stored.joints,
            inputs=tuple(Input(name=name, **values) for name, values in self.stored.inputs.items()),
            **self.others,
        )


def load_case(file: Any) -> LoadedCase:
    """Read a case from its root group."""
    stored = read_stored_case(file, READER, every_column=True)
    recordings = dict(READER.members(file, "recording", optional=True))
    generated = None
    if "rotor_generated" in file.keys():  # noqa: SIM118 - `in file` follows links
        group = READER.child_group(file, "rotor_generated")
        generated = GeneratedCurve(**READER.record(group, layout.GENERATED))
    others = {
        "recordings": {n: load_recording(g) for n, g in recordings.items()},
        "placements": {n: _load_placement(g, n) for n, g in recordings.items() if "clock_offset" in g.attrs},
        "rotor_generated": generated,
        "warnings": tuple(READER.json(file, "warnings", [])),
        "extra": dict(READER.json(file, "extra", {})),
    }
    return LoadedCase(stored, others)


def _load_placement(group: Any, name: str) -> Placement:
    values = READER.attributes(group, layout.PLACEMENT_ATTRIBUTES)
    return Placement(id=name, **{**values, "ambiguous": bool(values["ambiguous"])})


def read_kind(path: Path) -> str:
    """Return "recording" or "case"; a DatasetError is raised for a missing or damaged file, or an unknown format."""
    with READER.open(path) as file:
        return str(READER.attribute(file, "kind", str))


def read_settings(path: Path) -> dict[str, Any]:
    """Return the settings stored in a file."""
    with READER.open(path) as file:
        return dict(READER.json(file, "settings", {}))


def read_recording(path: Path) -> Recording:
    """Read a recording, as written by `extract`.

    Parameters
    ----------
    path : Path
        The HDF5 file.

    Raises
    ------
    DatasetError
        As for `read_kind`, or the file is a case.
    """
    with READER.open(path, layout.RECORDING) as file:
        return load_recording(file)


def read_case(path: Path) -> Case:
    """Read a case, as written by `sync` or `import`.

    Parameters
    ----------
    path : Path
        The HDF5 file.

    Raises
    ------
    DatasetError
        As for `read_kind`, or the file is a recording.
    """
    with READER.open(path, layout.CASE) as file:
        loaded = load_case(file)
    return loaded.case()
