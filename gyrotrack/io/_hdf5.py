"""Writes and reads recordings and cases according to the schema.

HDF5 ends the process if a write fails, or if Python raises an error during a write. Therefore writes do not fail here:
the first error of the disk is stored, later writes go to memory until the library has closed the file, and an interrupt
by the user is deferred until then. Every file ends with a checksum line.
"""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO, RawIOBase
from pathlib import Path
from typing import Any

import h5py

from fitting._files import FORMAT
from fitting._hdf5 import checksum_line
from gyrotrack._column_store import in_file
from gyrotrack._errors import DatasetError
from gyrotrack.io import _schema as layout
from gyrotrack.io._atomic import new_file, refuse_special
from gyrotrack.io._bodies import load_bodies, load_modes, write_bodies
from gyrotrack.io._records import (
    BodyTrack,
    Case,
    GeneratedCurve,
    Input,
    MarkerTrack,
    Placement,
    PointTrack,
    Recording,
    Series,
)
from gyrotrack.io._tables import (
    GUARD,
    attribute,
    child_group,
    read_attributes,
    read_table,
    stamp,
    to_json,
    write_attributes,
    write_table,
)

MAX_MEMBERS = 64


class WriteBuffer:
    """A binary file whose writes do not fail: after an `error` of the disk the data are kept in memory."""

    def __init__(self, raw: RawIOBase) -> None:
        self.error: OSError | None = None
        self._stream: RawIOBase | BytesIO = raw

    def seek(self, position: int, whence: int = 0) -> int:
        """Set the position."""
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


LIBVER = ("v110", "v110")  # the first with checksums of the metadata


@contextmanager
def new_hdf5(path: Path, *, force: bool = False) -> Iterator[Any]:
    """Yield an empty HDF5 file, and move it to `path` when the context ends without an error, as `_atomic.new_path`."""
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
    write_attributes(group, layout.RECORDING_ATTRIBUTES, recording)
    group.attrs["warnings"] = to_json(recording.warnings)
    group.attrs["extra"] = to_json(recording.extra)
    index = recording.frame_index
    write_table(group.create_group("frame"), layout.FRAME, recording, frame=index, index=index)
    markers, bodies = group.create_group("marker"), group.create_group("body")
    for name, marker in recording.markers.items():
        write_table(markers.create_group(name), layout.MARKER, marker, frame=index)
    for name, body in recording.bodies.items():
        write_table(bodies.create_group(name), layout.BODY, body)
    if recording.points:
        points = group.create_group("point")
        for name, point in recording.points.items():
            write_table(points.create_group(name), layout.POINT, point)


def load_recording(group: Any) -> Recording:
    """Read a recording from its group."""
    frame: dict[str, Any] = dict(in_file(read_table(child_group(group, "frame"), layout.FRAME)))
    index = frame.pop("index")
    del frame["frame"]
    return Recording(
        **read_attributes(group, layout.RECORDING_ATTRIBUTES),
        **frame,
        frame_index=index,
        markers={n: _load_marker(g, n, len(index)) for n, g in members(group, "marker")},
        bodies={n: _load_body(g, n) for n, g in members(group, "body")},
        warnings=tuple(load_json(group, "warnings", [])),
        extra=dict(load_json(group, "extra", {})),
        points=_load_points(group),
    )


def _load_points(group: Any) -> dict[str, PointTrack]:
    if "point" not in group.keys():  # noqa: SIM118 - `in group` follows links
        return {}
    return {
        n: PointTrack(name=n, **_load_table(child_group(group, "point"), n, layout.POINT))
        for n, _ in members(group, "point")
    }


def _load_marker(group: Any, name: str, frames: int) -> MarkerTrack:
    columns: dict[str, Any] = dict(in_file(read_table(group, layout.MARKER)))
    if len(columns.pop("frame")) != frames:
        raise DatasetError(f"{group.file.filename}: marker '{name}' and the clip differ in length.")
    return MarkerTrack(name=name, **read_attributes(group, layout.MARKER.attributes), **columns)


def _load_body(group: Any, name: str) -> BodyTrack:
    columns: dict[str, Any] = dict(in_file(read_table(group, layout.BODY)))
    return BodyTrack(name=name, **read_attributes(group, layout.BODY.attributes), **columns)


def members(group: Any, name: str) -> list[tuple[str, Any]]:
    """List the groups below the member `name` of `group`."""
    parent = child_group(group, name)
    if len(parent) > MAX_MEMBERS:
        what = (
            f"{group.file.filename} has {len(parent)} members in '{name}'; at most {MAX_MEMBERS} are allowed."
        )
        raise DatasetError(what, "The file is not in this layout.")
    return [(member, child_group(parent, member)) for member in parent]


def load_json(group: Any, name: str, default: Any) -> Any:
    """Return a JSON attribute, which must have the type of `default`."""
    text = attribute(group, name, str, json.dumps(default))
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{group.file.filename}: the attribute '{name}' is not JSON.") from error
    if not isinstance(value, type(default)):
        kind = "object" if isinstance(default, dict) else "list"
        raise DatasetError(f"{group.file.filename}: the attribute '{name}' is not a JSON {kind}.")
    return value


_INTEGRAL = "integral of the measured angular velocity, with an arbitrary constant"


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
        The file exists and `force` is not given, or it cannot be written.
    """
    with new_hdf5(Path(path), force=force) as file:
        stamp(file, layout.CASE, command=command, settings=settings)
        write_attributes(file, layout.CASE_ATTRIBUTES, case)
        file.attrs["warnings"] = to_json(case.warnings)
        file.attrs["extra"] = to_json(case.extra)
        file.attrs["default"] = "casing"
        for name, series in (("casing", case.casing), ("rotor", case.rotor)):
            group = file.create_group(name)
            write_table(group, layout.SERIES if series.window is None else layout.WINDOWED, series)
            if case.quantity == "omega":
                group["angle"].attrs["comment"] = _INTEGRAL
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


def load_case(file: Any) -> Case:
    """Read a case from its root group."""
    # `in file` follows links
    names = set(file.keys())
    recordings = dict(members(file, "recording")) if "recording" in names else {}
    generated = None
    if "rotor_generated" in names:
        generated = GeneratedCurve(**_load_table(file, "rotor_generated", layout.GENERATED))
    inputs: tuple[Input, ...] = ()
    if "input" in names:
        inputs = tuple(_load_input(file, name) for name, _ in members(file, "input"))
    fields = load_bodies(file) if "casing" not in names and "body" in names else _load_series(file)
    return Case(
        **fields,
        recordings={n: load_recording(g) for n, g in recordings.items()},
        placements={n: _load_placement(g, n) for n, g in recordings.items() if "clock_offset" in g.attrs},
        rotor_generated=generated,
        inputs=inputs,
        warnings=tuple(load_json(file, "warnings", [])),
        extra=dict(load_json(file, "extra", {})),
    )


def _load_series(file: Any) -> dict[str, Any]:
    """Return the fields of a case from `/casing` and `/rotor`."""
    tables = {"casing": layout.SERIES, "rotor": layout.WINDOWED}
    series = {
        name: Series(**_load_table(file, name, table), modes=load_modes(file, name))
        for name, table in tables.items()
    }
    return {**read_attributes(file, layout.CASE_ATTRIBUTES), **series}


def _load_table(file: Any, name: str, table: layout.Table) -> dict[str, Any]:
    group = child_group(file, name)
    return {**read_table(group, table), **read_attributes(group, table.attributes)}


def _load_input(file: Any, name: str) -> Input:
    values = _load_table(child_group(file, "input"), name, layout.INPUT)
    if values["interpolation"] not in layout.INTERPOLATIONS:
        what = (
            f"{file.filename}: the interpolation of the input '{name}' is '{values['interpolation'][:20]}'."
        )
        raise DatasetError(what, f"Use one of {', '.join(layout.INTERPOLATIONS)}.")
    return Input(name=name, **values)


def _load_placement(group: Any, name: str) -> Placement:
    values = read_attributes(group, layout.PLACEMENT_ATTRIBUTES)
    return Placement(id=name, **{**values, "ambiguous": bool(values["ambiguous"])})


_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_RECREATE = "Create it again with `gyrotrack extract`, `sync` or `import`."


def read_kind(path: Path) -> str:
    """Return "recording" or "case"; a DatasetError if the file is missing, damaged, or of another or a newer format."""
    with open_dataset(path) as file:
        return attribute(file, "kind", str)  # type: ignore[no-any-return]


def read_settings(path: Path) -> dict[str, Any]:
    """Return the settings stored in a file."""
    with open_dataset(path) as file:
        return dict(load_json(file, "settings", {}))


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
    with open_dataset(path, layout.RECORDING) as file:
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
    with open_dataset(path, layout.CASE) as file:
        return load_case(file)


@contextmanager
def open_dataset(path: Path, kind: str | None = None) -> Iterator[Any]:
    """Validate a file of this format and open it for reading; errors of HDF5 become a `DatasetError`."""
    path = Path(path)
    _check_signature(path)
    GUARD.check_file(path, _RECREATE)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise DatasetError(f"{path} is damaged or truncated.", _RECREATE) from error
    try:
        with file:
            _check_root(file, path, kind)
            GUARD.check_tree(file)
            yield file
    except (OSError, RuntimeError, KeyError, ValueError, UnicodeError, MemoryError) as error:
        why = (str(error).strip().splitlines() or ["it cannot be read"])[0].rstrip(".")[:120]
        raise DatasetError(f"{path} is damaged: {why}.", _RECREATE) from error


def _check_signature(path: Path) -> None:
    refuse_special(path)
    try:
        with path.open("rb") as stream:
            head = stream.read(len(_SIGNATURE))
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist.", "Check the name.") from error
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}.", "Give the name of a file.") from error
    if not head:
        raise DatasetError(f"{path} is empty.", _RECREATE)
    if head != _SIGNATURE:
        hint = "Use `gyrotrack import` for tables, `gyrotrack extract` for films."
        raise DatasetError(f"{path} is not an HDF5 file.", hint)


def _check_root(file: Any, path: Path, kind: str | None) -> None:
    if attribute(file, "format", str, "?") != FORMAT:
        what = f"{path} is an HDF5 file, but was not written by gyrotrack."
        raise DatasetError(what, "The attribute 'format' is missing.")
    version = attribute(file, "format_version", str)
    major = version.partition(".")[0]
    if not major.isdecimal():
        raise DatasetError(f"{path} has no valid format version ({version!r}).", _RECREATE)
    if int(major) < 1:
        raise DatasetError(f"{path} has the layout {version}; the oldest supported one is 1.0.", _RECREATE)
    if int(major) > int(layout.FORMAT_VERSION.partition(".")[0]):
        what = f"{path} has the layout {version}; the newest supported one is {layout.FORMAT_VERSION}."
        raise DatasetError(what, "Update gyrotrack.")
    found = attribute(file, "kind", str)
    if found not in {layout.RECORDING, layout.CASE} or (kind is not None and found != kind):
        wanted = kind or "recording or case"
        hint = "Create a recording with `gyrotrack extract`."
        if wanted == layout.CASE:
            hint = "Create a case with `gyrotrack sync` or `gyrotrack import`."
        raise DatasetError(f"{path} is a {found}, not a {wanted}.", hint)
