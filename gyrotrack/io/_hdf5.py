"""Writing and reading recordings and cases.

No link is followed out of the file, no number is taken from another file, and no array is allocated that the
stored bytes could not fill.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from gyrotrack._column_store import put_away
from gyrotrack._errors import DatasetError
from gyrotrack.io import _schema as layout
from gyrotrack.io._atomic import new_hdf5
from gyrotrack.io._records import BodyTrack, Case, GeneratedCurve, MarkerTrack, Placement, Recording, Series
from gyrotrack.io._tables import (
    attribute,
    child_group,
    read_table,
    stamp,
    to_json,
    write_attributes,
    write_table,
)
from gyrotrack.io._validation import guarded, has_endless_heap, is_broken

MAX_MEMBERS = 64


def write_recording(
    path: Path, recording: Recording, *, command: str, settings: Mapping[str, Any], force: bool = False
) -> Path:
    """Write a clip's tracking to an HDF5 file, whole or not at all.

    Parameters
    ----------
    path : Path
        The file to make; an existing one is only replaced with `force`.
    recording : Recording
        What to write.
    command : str
        The command line, kept in the file.
    settings : mapping
        Everything that shaped the result, as JSON can hold it.

    Raises
    ------
    OutputError
        The file exists, or cannot be written.
    """
    with new_hdf5(Path(path), force=force) as file:
        stamp(file, layout.RECORDING, command=command, settings=settings)
        fill_recording(file, recording)
    return Path(path)


def fill_recording(group: Any, recording: Recording) -> None:
    """Write `recording` into an HDF5 group that is new."""
    write_attributes(group, {name: getattr(recording, name) for name in layout.RECORDING_ATTRIBUTES})
    group.attrs["warnings"] = to_json(recording.warnings)
    group.attrs["extra"] = to_json(recording.extra)
    columns = {f.name: getattr(recording, f.name, recording.frame_index) for f in layout.FRAME.fields}
    write_table(group.create_group("frame"), layout.FRAME, columns)
    markers = group.create_group("marker")
    for name, marker in recording.markers.items():
        _fill_marker(markers.create_group(name), marker, recording)
    bodies = group.create_group("body")
    for name, body in recording.bodies.items():
        target = bodies.create_group(name)
        write_table(target, layout.BODY, {f.name: getattr(body, f.name) for f in layout.BODY.fields})
        target.attrs["smoothing_width"] = body.smoothing_width


def _fill_marker(group: Any, marker: MarkerTrack, recording: Recording) -> None:
    columns = {f.name: getattr(marker, f.name, recording.frame_index) for f in layout.MARKER.fields}
    write_table(group, layout.MARKER, columns)
    write_attributes(group, {"body": marker.body, "mount_angle": marker.mount_angle})


def load_recording(group: Any) -> Recording:
    """Read a recording from its group; see `reading.read_recording` for whole files."""
    frame = put_away(read_table(child_group(group, "frame"), layout.FRAME))
    kinds = {"width": int, "height": int, "frames_declared": int, "frames_decoded": int, "sense": int}
    kinds |= {"capture_fps": float, "container_fps": float}  # type: ignore[dict-item]
    scalars = {name: attribute(group, name, kinds.get(name, str)) for name in layout.RECORDING_ATTRIBUTES}
    return Recording(
        **scalars,
        frame_index=frame["index"],
        time=frame["time"],
        pts_time=frame["pts_time"],
        centre=frame["centre"],
        centre_sigma=frame["centre_sigma"],
        markers={n: _load_marker(g, n, len(frame["index"])) for n, g in members(group, "marker")},
        bodies={n: _load_body(g, n) for n, g in members(group, "body")},
        warnings=tuple(load_json(group, "warnings", [])),
        extra=dict(load_json(group, "extra", {})),
    )


def members(group: Any, name: str) -> list[tuple[str, Any]]:
    """List the groups below the member `name` of `group`."""
    parent = child_group(group, name)
    if len(parent) > MAX_MEMBERS:
        raise DatasetError(
            f"{group.file.filename} holds {len(parent)} of '{name}'.", "The file is not in this layout."
        )
    return [(member, child_group(parent, member)) for member in parent]


def _load_marker(group: Any, name: str, frames: int) -> MarkerTrack:
    columns = put_away(read_table(group, layout.MARKER))
    if len(columns.pop("frame")) != frames:
        raise DatasetError(f"{group.file.filename}: marker '{name}' and the clip differ in length.")
    return MarkerTrack(
        name=name,
        body=attribute(group, "body", str),
        mount_angle=attribute(group, "mount_angle", float),
        **columns,
    )


def _load_body(group: Any, name: str) -> BodyTrack:
    columns = put_away(read_table(group, layout.BODY))
    return BodyTrack(name=name, smoothing_width=attribute(group, "smoothing_width", int), **columns)


def load_json(group: Any, name: str, default: Any) -> Any:
    """Return a JSON attribute, which must be of the same kind as `default`."""
    text = attribute(group, name, str, json.dumps(default))
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{group.file.filename}: the attribute '{name}' is not JSON.") from error
    if not isinstance(value, type(default)):
        raise DatasetError(f"{group.file.filename}: the attribute '{name}' is not what it should be.")
    return value


_PLACED = ("clock_offset", "clock_offset_sigma", "clock_rate", "clock_rate_sigma", "angle_offset")


def write_case(
    path: Path, case: Case, *, command: str, settings: Mapping[str, Any], force: bool = False
) -> Path:
    """Write one experiment to an HDF5 file, whole or not at all.

    Parameters and errors are those of `recording.write_recording`.
    """
    with new_hdf5(Path(path), force=force) as file:
        stamp(file, layout.CASE, command=command, settings=settings)
        write_attributes(file, {"I_rotor": case.I_rotor, "I_casing": case.I_casing})
        write_attributes(
            file,
            {"label": case.label, "surface": case.surface, "quantity": case.quantity, "bodies": case.bodies},
        )
        write_attributes(file, {"warnings": to_json(case.warnings), "extra": to_json(case.extra)})
        file.attrs["default"] = "casing"
        _fill_series(file.create_group("casing"), case.casing, case.quantity)
        _fill_series(file.create_group("rotor"), case.rotor, case.quantity)
        if case.rotor_generated is not None:
            _fill_generated(file.create_group("rotor_generated"), case.rotor_generated)
        recordings = file.create_group("recording")
        for name, recording in case.recordings.items():
            group = recordings.create_group(name)
            fill_recording(group, recording)
            if name in case.placements:
                _fill_placement(group, case.placements[name])
    return Path(path)


def _fill_series(group: Any, series: Series, quantity: str) -> None:
    table = layout.SERIES if series.window is None else layout.WINDOWED
    write_table(group, table, {f.name: getattr(series, f.name) for f in table.fields})
    group.attrs["sigma_source"] = series.sigma_source
    if quantity == "omega":
        group["angle"].attrs["comment"] = "integral of the measured angular velocity; its start is arbitrary"


def _fill_generated(group: Any, curve: GeneratedCurve) -> None:
    write_table(group, layout.GENERATED, {"time": curve.time, "omega": curve.omega})
    group.attrs["method"] = curve.method


def _fill_placement(group: Any, placement: Placement) -> None:
    write_attributes(group, {name: getattr(placement, name) for name in _PLACED})
    group.attrs["sync_ambiguous"] = int(placement.ambiguous)
    group.attrs["sync_method"] = placement.method


def load_case(file: Any) -> Case:
    """Read a case from its root group; see `reading.read_case` for whole files."""
    recordings = dict(members(file, "recording"))
    placements = {n: _load_placement(g, n) for n, g in recordings.items() if "clock_offset" in g.attrs}
    return Case(
        I_rotor=attribute(file, "I_rotor", float),
        I_casing=attribute(file, "I_casing", float),
        label=attribute(file, "label", str),
        surface=attribute(file, "surface", str),
        casing=_load_series(child_group(file, "casing"), layout.SERIES),
        rotor=_load_series(child_group(file, "rotor"), layout.WINDOWED),
        recordings={n: load_recording(g) for n, g in recordings.items()},
        placements=placements,
        rotor_generated=_load_generated(file),
        quantity=attribute(file, "quantity", str, "angle"),
        bodies=attribute(file, "bodies", str, "two"),
        warnings=tuple(load_json(file, "warnings", [])),
        extra=dict(load_json(file, "extra", {})),
    )


def _load_series(group: Any, table: layout.Table) -> Series:
    return Series(**read_table(group, table), sigma_source=attribute(group, "sigma_source", str, "measured"))


def _load_generated(file: Any) -> GeneratedCurve | None:
    if "rotor_generated" not in file.keys():  # noqa: SIM118 - `in file` follows links
        return None
    group = child_group(file, "rotor_generated")
    return GeneratedCurve(**read_table(group, layout.GENERATED), method=attribute(group, "method", str))


def _load_placement(group: Any, name: str) -> Placement:
    return Placement(
        id=name,
        **{key: attribute(group, key, float) for key in _PLACED},
        ambiguous=bool(attribute(group, "sync_ambiguous", int)),
        method=attribute(group, "sync_method", str),
    )


_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MAKE_AGAIN = "Make it again with `gyrotrack extract`, `sync` or `import`."


def read_kind(path: Path) -> str:
    """Return "recording" or "case".

    Raises
    ------
    DatasetError
        The file is missing, not HDF5, damaged, of another format, or newer than this program.
    """
    with open_dataset(path) as file:
        return attribute(file, "kind", str)  # type: ignore[no-any-return]


def read_settings(path: Path) -> dict[str, Any]:
    """Return what shaped the content of a file, as it was asked for.

    Raises
    ------
    DatasetError
        As for `read_kind`.
    """
    with open_dataset(path) as file:
        return dict(load_json(file, "settings", {}))


def read_recording(path: Path) -> Recording:
    """Read what `extract` wrote.

    Raises
    ------
    DatasetError
        As for `read_kind`, or the file is a case.
    """
    with open_dataset(path, layout.RECORDING) as file:
        return load_recording(file)


def read_case(path: Path) -> Case:
    """Read what `sync` or `import` wrote.

    Raises
    ------
    DatasetError
        As for `read_kind`, or the file is a recording.
    """
    with open_dataset(path, layout.CASE) as file:
        return load_case(file)


@contextmanager
def open_dataset(path: Path, kind: str | None = None) -> Iterator[Any]:
    """Open a file of this format for reading, after checking what it is.

    Whatever HDF5 finds wrong inside the block becomes a `DatasetError`.
    """
    path = Path(path)
    _check_signature(path)
    if is_broken(path):
        raise DatasetError(f"{path} is damaged: its checksum is not that of its contents.", _MAKE_AGAIN)
    if has_endless_heap(path):
        raise DatasetError(f"{path} is damaged: its texts run in circles.", _MAKE_AGAIN)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        if "unable to lock" in str(error):
            message, hint = f"{path} is being written by another process.", "Wait until it is done."
        else:
            message, hint = f"{path} is damaged or cut short.", _MAKE_AGAIN
        raise DatasetError(message, hint) from error
    try:
        with file:
            _check_root(file, path, kind)
            guarded(file)
            yield file
    except (OSError, RuntimeError, KeyError, ValueError, UnicodeError, MemoryError) as error:
        raise DatasetError(f"{path} is damaged: {_first_line(error)}.", _MAKE_AGAIN) from error


def _check_signature(path: Path) -> None:
    try:
        with path.open("rb") as stream:
            head = stream.read(len(_SIGNATURE))
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist.", "Check the name.") from error
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}.", "Give the name of a file.") from error
    if not head:
        raise DatasetError(f"{path} is empty.", _MAKE_AGAIN)
    if head != _SIGNATURE:
        raise DatasetError(
            f"{path} is not an HDF5 file.",
            "Tables go through `gyrotrack import`, films through `gyrotrack extract`.",
        )


def _check_root(file: Any, path: Path, kind: str | None) -> None:
    if attribute(file, "format", str, "?") != layout.FORMAT:
        raise DatasetError(
            f"{path} is an HDF5 file, but not one of gyrotrack.", "Its attribute 'format' is missing."
        )
    version = attribute(file, "format_version", str)
    major = version.partition(".")[0]
    if not major.isdecimal():
        raise DatasetError(f"{path} has no valid format version ({version!r}).", _MAKE_AGAIN)
    if int(major) < 1:
        raise DatasetError(
            f"{path} has the layout {version}, from before the first that is read (1.0).", _MAKE_AGAIN
        )
    if int(major) > int(layout.FORMAT_VERSION.partition(".")[0]):
        raise DatasetError(
            f"{path} has the layout {version}, newer than {layout.FORMAT_VERSION} that this program knows.",
            "Update gyrotrack.",
        )
    found = attribute(file, "kind", str)
    if found not in {layout.RECORDING, layout.CASE} or (kind is not None and found != kind):
        wanted = kind or "recording or case"
        hint = {layout.CASE: "Make a case with `gyrotrack sync` or `gyrotrack import`."}.get(
            wanted, "Make a recording with `gyrotrack extract`."
        )
        raise DatasetError(f"{path} is a {found}, not a {wanted}.", hint)


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or ["it cannot be read"])[0].rstrip(".")[:120]
