"""Binary and XML files: HDF5 of SLEAP, DeepLabCut, movement and gyrotrack, and projects of OSP Tracker.

A project (.trk) is an XML file. It contains the scale, the axes, the frame rate, and the points of each track in every
frame. In HDF5 files, pandas stores the names of columns as a pickle, which can contain code. The pickle is never
executed: only opcodes for lists and tuples of strings are interpreted; any other opcode raises an error.
"""

from __future__ import annotations

import math
import pickletools
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fitting._case_format import CASE, FORMAT
from fitting._stored_case import read_stored_case
from gyrotrack._errors import DatasetError
from gyrotrack.io._records import Floats
from gyrotrack.io._tables import READER
from gyrotrack.io.readers._point_tables import grouped_points
from gyrotrack.io.readers._points import Points
from gyrotrack.io.readers._raw_table import RawTable, table_of

_MARK = object()
_MAX_OPCODES = 10_000


def listed_names(stored: bytes) -> list[tuple[str, ...]]:
    """Return a pickled list of tuples of strings; any other content raises a DatasetError."""
    try:
        found = _interpreted(bytes(stored))
    except (ValueError, IndexError, KeyError, TypeError, UnicodeError) as error:
        raise DatasetError("The names of the columns cannot be read.", "Export the points as CSV.") from error
    if not isinstance(found, list) or not all(
        isinstance(t, tuple) and t and all(isinstance(w, str) for w in t) for t in found
    ):
        raise DatasetError("The names of the columns are not a list of names.", "Export the points as CSV.")
    return found


def _interpreted(stored: bytes) -> Any:
    stack: list[Any] = []
    memo: dict[int, Any] = {}
    argument: Any
    for count, (code, argument, _) in enumerate(pickletools.genops(stored)):
        if count > _MAX_OPCODES:
            raise ValueError("too long")
        name = code.name
        if name in {"PROTO", "FRAME"}:
            continue
        if name == "STOP":
            return stack.pop()
        if name == "MARK":
            stack.append(_MARK)
        elif name in {"UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "STRING", "BINSTRING", "SHORT_BINSTRING"}:
            stack.append(str(argument))
        elif name == "EMPTY_LIST":
            stack.append([])
        elif name in {"LIST", "TUPLE", "APPENDS"}:
            _gather(stack, name)
        elif name in {"TUPLE1", "TUPLE2", "TUPLE3"}:
            size = int(name[-1])
            stack[-size:] = [tuple(stack[-size:])]
        elif name == "APPEND":
            item = stack.pop()
            stack[-1].append(item)
        elif name in {"PUT", "BINPUT", "LONG_BINPUT"}:
            memo[int(argument)] = stack[-1]
        elif name == "MEMOIZE":
            memo[len(memo)] = stack[-1]
        elif name in {"GET", "BINGET", "LONG_BINGET"}:
            stack.append(memo[int(argument)])
        else:
            raise ValueError(name)
    raise ValueError("no end")


def _gather(stack: list[Any], name: str) -> None:
    place = max((i for i, item in enumerate(stack) if item is _MARK), default=-1)
    if place < 0:
        raise ValueError(name)
    items = stack[place + 1 :]
    del stack[place:]
    if name == "APPENDS":
        stack[-1].extend(items)
    else:
        stack.append(items if name == "LIST" else tuple(items))


_FOREIGN = "Supported: analysis files of SLEAP, tables of DeepLabCut, poses of movement, and cases."


def read_hdf5(path: Path, body: str = "") -> Points | RawTable:
    """Read points from an HDF5 file of another program, or a body from a case or exported netCDF.

    A file with links to other files is refused.
    """
    try:
        with h5py.File(path, "r", locking=False) as file:
            READER.check_tree(file)
            if str(file.attrs.get("format", "")) != FORMAT:
                return _foreign(path, file)
            if "_NCProperties" in file.attrs:
                return _exported_body(path, file, body)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, IndexError) as error:
        raise DatasetError(f"{path} cannot be read as points: {str(error)[:100]}.", _FOREIGN) from error
    return _case_body(path, body)


def _foreign(path: Path, file: Any) -> Points:
    """Return the points in a file of another program."""
    if "position" in file and {"keypoint", "keypoints"} & set(file.keys()):
        return _movement(path, file)
    if {"tracks", "node_names"} <= set(file.keys()):
        return _sleap(path, file)
    table = file.get("df_with_missing/table")
    if isinstance(table, h5py.Dataset):
        return _deeplabcut(path, table)
    frame = file.get("df_with_missing")
    if isinstance(frame, h5py.Group) and "block0_values" in frame:
        return _pandas_fixed(path, frame)
    raise DatasetError(f"{path} is an HDF5 file without points in a supported format.", _FOREIGN)


def _case_body(path: Path, body: str) -> RawTable:
    """Return a body of a case from `sync` or `import`: the series that a fit uses."""
    with READER.open(path, CASE) as file:
        stored = read_stored_case(file, READER)
    # the first body has the key "casing", and also its name if it has a name
    bodies = {"casing": stored.casing, **{s.name: s for s in (stored.casing, *stored.others)}}
    series = bodies.get(body or "casing")
    if series is None:
        what = f"{path} has no series '{body}'."
        raise DatasetError(what, f"Its series: {', '.join(filter(None, bodies))}.")
    columns = ["t", stored.attributes["quantity"], "sigma"]
    return table_of(path, columns, [series.time, series.value, series.u])


def _exported_body(path: Path, file: Any, body: str) -> RawTable:
    """Return a body of a case that was exported as netCDF."""
    name = body or "casing"
    if name not in file or "time" not in file[name]:
        what = f"{path} has no series '{name}'."
        raise DatasetError(what, "Name a body that the file contains, or give another case.")
    group = file[name]
    wanted = {"time": "t", "angle": "angle", "sigma": "sigma"}
    if str(file.attrs.get("quantity", "angle")) == "omega":
        wanted = {"time": "t", "omega": "omega", "omega_sigma": "sigma"}
    for column in wanted:
        READER.check_storage(group[column])
    return table_of(path, list(wanted.values()), [READER.load(group[column]) for column in wanted])


def _movement(path: Path, file: Any) -> Points:
    """Return the keypoints in a netCDF of `movement`: position (time, space, keypoint, individual)."""
    # until version 0.16 the names of the dimensions were plural
    names = file["keypoint"] if "keypoint" in file else file["keypoints"]
    position, times = file["position"], file["time"]
    for dataset in (position, times):
        READER.check_storage(dataset)
    if position.ndim == 3:
        values = READER.load(position)[..., None]
    elif position.ndim == 4:
        values = READER.load(position)
    else:
        what = f"{path}: 'position' has the shape {position.shape}, not (time, 2, keypoints)."
        raise DatasetError(what, _FOREIGN)
    if values.shape[3] != 1 or values.shape[1] < 2 or values.shape[2] != names.shape[0]:
        what = f"{path} contains {values.shape[3]} tracked individuals."
        raise DatasetError(what, "Export one individual.")
    points = _texts(names)
    confidence_of = {}
    if "confidence" in file and file["confidence"].shape[:2] == (values.shape[0], len(points)):
        READER.check_storage(file["confidence"])
        confidence = np.asarray(READER.load(file["confidence"]), dtype=float)
        confidence = confidence.reshape(values.shape[0], len(points), -1)[..., 0]
        confidence_of = dict(zip(points, confidence.T, strict=True))
    unit = file.attrs.get("time_unit", times.attrs.get("units", "frames"))
    unit = unit.decode() if isinstance(unit, bytes) else str(unit)
    places = {name: np.asarray(values[:, :2, i, 0], dtype=float) for i, name in enumerate(points)}
    frames, counted = np.asarray(READER.load(times), dtype=float), not unit.startswith("s")
    return Points(path, frames, places, confidence_of, y_down=True, counted=counted)


def _texts(dataset: Any) -> list[str]:
    return [n.decode("utf-8", "replace") if isinstance(n, bytes) else str(n) for n in dataset[()].tolist()]


def _sleap(path: Path, file: Any) -> Points:
    tracks, names = file["tracks"], file["node_names"]
    READER.check_storage(tracks)
    if tracks.ndim != 4 or tracks.shape[1] != 2 or tracks.shape[2] != names.shape[0] or names.shape[0] > 1000:
        what = f"{path}: 'tracks' has the shape {tracks.shape}, not (1, 2, points, frames)."
        raise DatasetError(what, _FOREIGN)
    if tracks.shape[0] != 1:
        raise DatasetError(f"{path} contains {tracks.shape[0]} tracked instances.", "Export one instance.")
    points = _texts(names)
    values = np.asarray(READER.load(tracks)[0], dtype=float)
    confidence_of: dict[str, Any] = {}
    if "point_scores" in file and file["point_scores"].shape == (1, len(points), tracks.shape[3]):
        READER.check_storage(file["point_scores"])
        scores = np.asarray(READER.load(file["point_scores"])[0], dtype=float)
        confidence_of = dict(zip(points, scores, strict=True))
    places = {name: values[:, i].T.copy() for i, name in enumerate(points)}
    frames = np.arange(tracks.shape[3], dtype=float)
    return Points(path, frames, places, confidence_of, y_down=True, counted=True)


def _deeplabcut(path: Path, table: Any) -> Points:
    fields = set(table.dtype.names or ())
    blocks = sorted(n for n in fields if n.startswith("values_block_"))
    if table.ndim != 1 or "index" not in fields or blocks != ["values_block_0"]:
        raise DatasetError(f"{path}: the table is not in the format of DeepLabCut.", "Export it as CSV.")
    if table.nbytes > 2**31 or table.nbytes > table.id.get_storage_size() * 1100 + 2**22:
        raise DatasetError(f"{path} declares {table.nbytes:,} bytes.", "The file is damaged or malicious.")
    names = listed_names(bytes(np.asarray(table.attrs["values_block_0_kind"])[()]))
    rows = table[()]
    return _points(path, names, rows["values_block_0"], rows["index"])


def _pandas_fixed(path: Path, frame: Any) -> Points:
    """Read a pandas table in the "fixed" format of older versions of DeepLabCut and of `movement`."""
    values, index = frame["block0_values"], frame["axis1"]
    for dataset in (values, index):
        READER.check_storage(dataset)
    if "block1_values" in frame or index.shape != values.shape[:1]:
        raise DatasetError(f"{path}: the table is not in the format of DeepLabCut.", "Export it as CSV.")
    levels = []
    for k in range(int(frame.attrs["block0_items_nlevels"])):
        words, labels = (frame[f"block0_items_{what}{k}"] for what in ("level", "label"))
        if words.dtype.kind != "S" or labels.dtype.kind not in "iu" or labels.ndim != 1:
            raise DatasetError(f"{path}: the table is not in the format of DeepLabCut.", "Export it as CSV.")
        known = [w.decode("utf-8", "replace") for w in words[()].tolist()]
        levels.append([known[i] for i in labels[()].tolist()])
    return _points(path, list(zip(*levels, strict=True)), READER.load(values), READER.load(index))


def _points(path: Path, names: list[tuple[str, ...]], columns: Any, index: Any) -> Points:
    values = np.asarray(columns, dtype=float)
    if values.ndim != 2 or len(names) != values.shape[1]:
        raise DatasetError(f"{path}: {len(names)} names for {values.shape[1:]} columns.", "Export it as CSV.")
    individuals = {name[1] for name in names if len(name) == 4}
    first = 2 if len(individuals) == 1 else 1
    parts = [(".".join(n[first:-1]), n[-1], column) for n, column in zip(names, values.T, strict=True)]
    return grouped_points(path, np.asarray(index, dtype=float), parts)


_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "in": 0.0254, "ft": 0.3048}


_MAX_PROJECT = 2**26  # largest size of the XML [bytes]
_MAX_MARKUP = (
    3_000_000  # largest number of elements and attributes of the XML; each needs 250 bytes of memory
)


def read_project(path: Path, content: bytes, _options: object) -> Points:
    """Return the point masses of a Tracker project in the coordinates of the project (m, y upwards), and the origin."""
    if re.search(rb"<!(DOCTYPE|ENTITY)", content[:100_000], re.IGNORECASE):
        what = f"{path} declares XML entities."
        raise DatasetError(what, "A Tracker project contains none; export it again.")
    if content.count(b"<") + content.count(b"=") > _MAX_MARKUP or len(content) > _MAX_PROJECT:
        what = f"{path} is larger than any Tracker project of 100,000 frames."
        raise DatasetError(what, "Export the points as text.")
    try:
        root = ET.fromstring(content)  # noqa: S314 - entities are refused above
        return _project_points(path, root)
    except (ET.ParseError, TypeError, ValueError, AttributeError, OverflowError) as error:
        what = f"{path} is not a complete Tracker project: {error}."
        raise DatasetError(what, "Save it again in Tracker.") from error


def _property(node: ET.Element | None, name: str) -> ET.Element | None:
    return (
        None if node is None else next((p for p in node.findall("property") if p.get("name") == name), None)
    )


def _object(node: ET.Element | None, name: str) -> ET.Element | None:
    found = _property(node, name)
    return None if found is None else found.find("object")


def _value(node: ET.Element | None, name: str, default: float) -> float:
    found = _property(node, name)
    return default if found is None or not found.text else float(found.text)


def _project_points(path: Path, root: ET.Element) -> Points:
    clip = _object(root, "videoclip")
    control = _object(root, "clipcontrol")
    first, step = int(_value(clip, "startframe", 0)), int(_value(clip, "stepsize", 1))
    frame_duration = _value(control, "delta_t", math.nan) / 1e3
    begin = _value(clip, "starttime", 0.0) / 1e3
    tracks: dict[str, dict[int, tuple[float, float]]] = {}
    for track in root.iter("object"):
        if not (track.get("class") or "").endswith((".PointMass", ".CenterOfMass")):
            continue
        data = _property(track, "framedata")
        title = _property(track, "name")
        name = (title.text if title is not None else None) or f"track {len(tracks) + 1}"
        for cell in () if data is None else data.findall("property"):
            item = cell.find("object")
            frame = int((cell.get("name") or "[]").strip("[]"))
            x, y = _value(item, "x", math.nan), _value(item, "y", math.nan)
            tracks.setdefault(name, {})[frame] = (x, y)
    frames = sorted({f for points in tracks.values() for f in points})
    if not frames:
        raise DatasetError(f"{path} has no points.", "Mark a point mass in Tracker, or export a table.")
    unit = _property(root, "length_unit")
    metres = _METRES.get((unit.text or "").strip(), 1.0) if unit is not None else 1.0
    places = {name: np.full((len(frames), 2), np.nan) for name in tracks}
    rows = {frame: row for row, frame in enumerate(frames)}
    for name, marked in tracks.items():
        for frame, place in marked.items():
            places[name][rows[frame]] = _world_position(root, frame, place, metres)
    places["origin"] = np.zeros((len(frames), 2))
    index = np.array(frames, dtype=float)
    if math.isfinite(frame_duration) and frame_duration > 0:
        time, counted = begin + (index - first) * frame_duration, False
    else:
        time, counted = (index - first) / max(step, 1), True
    return Points(path, time, places, {}, y_down=False, counted=counted)


def _world_position(root: ET.Element, frame: int, place: tuple[float, float], metres: float) -> Floats:
    """Transform a position [px] in a frame to the axes of the project.

    The axes have an origin, an angle of the x axis, and a scale (px per unit). They may change from frame to frame.
    """
    axes = [
        (int((c.get("name") or "[0]").strip("[]")), c.find("object"))
        for p in [_property(_object(root, "coords"), "framedata")] if p is not None for c in p.findall("property")
    ]  # fmt: skip
    held = [item for number, item in axes if number <= frame] or [item for _, item in axes[:1]]
    item = held[-1] if held else None
    turned = math.radians(_value(item, "angle", 0.0))
    dx = place[0] - _value(item, "xorigin", 0.0)
    dy = -(place[1] - _value(item, "yorigin", 0.0))
    scales = [_value(item, axis, 1.0) for axis in ("xscale", "yscale")]
    if not all(scales):
        raise ValueError("the scale is zero")
    x = (dx * math.cos(turned) + dy * math.sin(turned)) / scales[0]
    y = (-dx * math.sin(turned) + dy * math.cos(turned)) / scales[1]
    return np.array([x, y]) * metres
