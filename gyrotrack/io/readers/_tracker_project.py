"""Projects of OSP Tracker (.trk): XML with the points of each track in every frame, scale, axes and frame rate."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from gyrotrack._errors import DatasetError
from gyrotrack.io._records import Floats
from gyrotrack.io.readers._points import Points

_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "in": 0.0254, "ft": 0.3048}


def read_project(path: Path, sha256: str, content: bytes) -> Points:
    """Return the point masses of a Tracker project, in its own coordinates (m, y upwards), with its origin.

    Raises
    ------
    DatasetError
        The XML is damaged, declares entities, or has no points.
    """
    if re.search(rb"<!(DOCTYPE|ENTITY)", content[:100_000], re.IGNORECASE):
        raise DatasetError(f"{path} declares XML entities.", "A Tracker project has none; export it again.")
    try:
        root = ET.fromstring(content)  # noqa: S314 - entities are refused above
    except (ET.ParseError, ValueError) as error:
        raise DatasetError(
            f"{path} is not a complete Tracker project: {error}.", "Save it again in Tracker."
        ) from error
    try:
        return _points(path, sha256, root)
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DatasetError(
            f"{path} is not a complete Tracker project: {error}.", "Save it again in Tracker."
        ) from error


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


def _points(path: Path, sha256: str, root: ET.Element) -> Points:
    clip = _object(root, "videoclip")
    control = _object(root, "clipcontrol")
    first, step = int(_value(clip, "startframe", 0)), int(_value(clip, "stepsize", 1))
    duration = _value(control, "delta_t", math.nan) / 1e3  # of one frame
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
    for name, marked in tracks.items():
        for row, frame in enumerate(frames):
            places[name][row] = _in_world(root, frame, marked[frame], metres) if frame in marked else np.nan
    places["origin"] = np.zeros((len(frames), 2))
    index = np.array(frames, dtype=float)
    if math.isfinite(duration) and duration > 0:
        time, counted = begin + (index - first) * duration, False
    else:
        time, counted = (index - first) / max(step, 1), True
    return Points(path, sha256, time, places, {}, y_down=False, counted=counted)


def _in_world(root: ET.Element, frame: int, place: tuple[float, float], metres: float) -> Floats:
    """Return a place in the axes of the project that hold in a frame: origin, angle of the x axis, pixels per unit."""
    axes = [
        (int((c.get("name") or "[0]").strip("[]")), c.find("object"))
        for p in [_property(_object(root, "coords"), "framedata")] if p is not None for c in p.findall("property")
    ]  # fmt: skip
    held = [item for number, item in axes if number <= frame] or [item for _, item in axes[:1]]
    item = held[-1] if held else None
    turned = math.radians(_value(item, "angle", 0.0))
    dx = place[0] - _value(item, "xorigin", 0.0)
    dy = -(place[1] - _value(item, "yorigin", 0.0))
    x = (dx * math.cos(turned) + dy * math.sin(turned)) / _value(item, "xscale", 1.0)
    y = (-dx * math.sin(turned) + dy * math.cos(turned)) / _value(item, "yscale", 1.0)
    return np.array([x, y]) * metres
