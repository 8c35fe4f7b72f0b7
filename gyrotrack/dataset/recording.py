"""One clip as a group of datasets: `write_recording`, and the group's form that a case holds too."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gyrotrack.dataset import layout
from gyrotrack.dataset.columns import put_away
from gyrotrack.dataset.provenance import stamp, to_json
from gyrotrack.dataset.records import BodyTrack, MarkerTrack, Recording
from gyrotrack.dataset.tables import attribute, child_group, read_table, write_attributes, write_table
from gyrotrack.dataset.writing import new_hdf5
from gyrotrack.errors import DatasetError

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
