"""Tables of tracked points: text of OSP Tracker, DeepLabCut, SLEAP, and tables with one row per particle and frame."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gyrotrack._errors import DatasetError
from gyrotrack.io._records import Floats
from gyrotrack.io.readers._clock import refuse_slow_clock
from gyrotrack.io.readers._points import Points
from gyrotrack.io.readers._raw_table import RawTable, factor, header_of, is_number, number_of, role_of
from gyrotrack.io.readers._text_table import Lines, delimiter_of, split

_PARTICLE = {"particle", "track_id", "trackid", "trajectory", "trajectory_id"}
_PLACES = {"x": {"x", "position_x", "x_px"}, "y": {"y", "position_y", "y_px"}}


def particles_of(raw: RawTable) -> Points | None:
    """Return the points of a table with one row per particle and frame (trackpy, TrackMate); None for any other table.

    The column `ep` of trackpy is the standard uncertainty of x and of y.
    """
    names = [name.casefold() for name in raw.names]
    labels = [i for i, name in enumerate(names) if name in _PARTICLE]
    found = [next((i for i, n in enumerate(names) if n in known), None) for known in _PLACES.values()]
    clock = [i for i, name in enumerate(names) if name == "frame"]
    if not labels or None in found or not clock:
        return None
    label, frame = raw.columns[labels[0]], raw.numbers(clock[0], "frame")
    owner = np.array([f"{v:g}" if isinstance(v, float) else str(v) for v in label])
    place = np.stack([raw.numbers(i) for i in found if i is not None], axis=1)
    sigma = raw.numbers(names.index("ep"), "ep") if "ep" in names else None
    frames, row = np.unique(frame, return_inverse=True)
    places, errors = {}, {}
    for name in dict.fromkeys(owner.tolist()):
        mine = owner == name
        places[name] = np.full((len(frames), 2), np.nan)
        places[name][row[mine]] = place[mine]
        if sigma is not None and np.isfinite(sigma[mine]).any():
            errors[name] = np.full(len(frames), np.nanmedian(sigma[mine]))
            errors[name][row[mine]] = np.where(sigma[mine] > 0, sigma[mine], errors[name][0])
    return Points(raw.path, frames, places, {}, y_down=True, counted=True, errors=errors, notes=raw.notes)


def read_point_table(path: Path, lines: Lines) -> Points | None:
    """Read points from the lines of a file; None if it is not a table of points."""
    first = split(lines[0][1], delimiter_of(lines[0][1]))
    if _PARTICLE & {cell.casefold() for cell in first}:
        return None  # a table with one row per particle and frame
    if first[0].casefold() == "scorer":
        return _deeplabcut(path, lines)
    if "frame_idx" in first:
        return _sleap(path, lines)
    return _tracker(path, lines)


def _tracker(path: Path, lines: Lines) -> Points | None:
    """Read an export of OSP Tracker: a line with the names of the tracks, then columns t, x, y."""
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
    heads = split(head, delimiter)
    columns = _tracks(heads, titles, path)
    used = {time[0], *sum(columns.values(), ())}
    left_out = tuple(h for i, h in enumerate(heads) if h and i not in used)
    table = _numbers(path, lines[above + 1 :], delimiter, len(names), sorted(used))
    places = {name: np.stack([table[x], table[y]], axis=1) for name, (x, y) in columns.items()}
    counted = roles[time[0]] == "frame"
    if not counted and not unit:
        refuse_slow_clock(f"{path}, line {lines[above][0]}", names[time[0]], table[time[0]])
    time_of_rows = scale * table[time[0]]
    return Points(path, time_of_rows, places, {}, y_down=False, counted=counted, left_out=left_out)


def _axis(name: str) -> tuple[str, str]:
    """Split ``x``, ``x_{mass A}``, ``x_A``, ``A_x``, ``A.x`` or ``x (m)`` into axis and track."""
    bare = re.sub(r"\s*[\[(][^\])]*[\])]$", "", name.strip())
    unit = header_of(name)[1]
    if (
        "/" in unit or factor("", unit) is not None
    ):  # a name with such a unit denotes the axis of a sensor, not a coordinate
        return "", ""
    bare = re.sub(r"_(px|m|cm|mm)$", "", bare)
    found = re.fullmatch(r"([xyXY])(?:[_ ]\{?(.+?)\}?)?|(.+?)[_. ]([xyXY])", bare)
    if found is None:
        return "", ""
    axis, track = (found[1] or found[4]).casefold(), (found[2] or found[3] or "").strip()
    sensor = role_of(track) == "omega" or bool(_SENSOR.match(track))
    return ("", "") if sensor else (axis, track)


# names of vectors from sensors of a phone or an inertial unit, except the angular velocity
_SENSOR = re.compile(r"(lin(ear)?[_ ]?)?(acc|accel\w*|mag|magnet\w*|gravity|grav)$", re.IGNORECASE)


def _tracks(heads: list[str], titles: list[str], path: Path) -> dict[str, tuple[int, int]]:
    """Return the columns of x and y of each track. A name above a group of columns applies until the next name."""
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
    animals = heads.get("individuals", [""] * width)
    several = len(set(animals[1:])) > 1
    columns = []
    for i in range(1, width):
        part = f"{animals[i]}.{heads['bodyparts'][i]}" if several else heads["bodyparts"][i]
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
