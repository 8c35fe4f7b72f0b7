"""Point tables as text: OSP Tracker, DeepLabCut, SLEAP."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gyrotrack._errors import DatasetError
from gyrotrack.io._records import Floats
from gyrotrack.io.readers._points import Points
from gyrotrack.io.readers._raw_table import Lines, delimiter_of, is_number, number_of, split
from gyrotrack.io.readers._units import factor, header_of, role_of


def read_point_table(path: Path, sha256: str, lines: Lines) -> Points | None:
    """Read points from the lines of a file; None if it is no table of points.

    Raises
    ------
    DatasetError
        It is one, but a line in it is wrong.
    """
    first = split(lines[0][1], delimiter_of(lines[0][1]))
    if first[0].casefold() == "scorer":
        return _deeplabcut(path, sha256, lines)
    if "frame_idx" in first:
        return _sleap(path, sha256, lines)
    return _tracker(path, sha256, lines)


def _tracker(path: Path, sha256: str, lines: Lines) -> Points | None:
    """Read what OSP Tracker exports: a line with the track's name (or several), then t, x, y."""
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
    titles = split(lines[above - 1][1], delimiter) if above else []
    roles = [role_of(header_of(n)[0]) for n in names]
    time = [i for i, r in enumerate(roles) if r == "t"] or [i for i, r in enumerate(roles) if r == "frame"]
    if not time:
        raise DatasetError(
            f"{path}, line {lines[above][0]}: there is no column for the time.",
            "Export t together with x and y.",
        )
    columns = _tracks(split(head, delimiter), titles, path)
    table = _numbers(
        path, lines[above + 1 :], delimiter, len(names), sorted({time[0], *sum(columns.values(), ())})
    )
    places = {name: np.stack([table[x], table[y]], axis=1) for name, (x, y) in columns.items()}
    return Points(path, sha256, table[time[0]], places, {}, y_down=False, counted=roles[time[0]] == "frame")


def _axis(name: str) -> tuple[str, str]:
    """Split ``x``, ``x_{mass A}``, ``x_A``, ``A_x``, ``A.x`` or ``x (m)`` into axis and track."""
    bare = re.sub(r"\s*[\[(][^\])]*[\])]$", "", name.strip())
    unit = header_of(name)[1]
    if "/" in unit or factor("", unit) is not None:  # an axis of a sensor, not a place
        return "", ""
    bare = re.sub(r"_(px|m|cm|mm)$", "", bare)
    found = re.fullmatch(r"([xyXY])(?:[_ ]\{?(.+?)\}?)?|(.+?)[_. ]([xyXY])", bare)
    if found is None:
        return "", ""
    return (found[1] or found[4]).casefold(), (found[2] or found[3] or "").strip()


def _tracks(heads: list[str], titles: list[str], path: Path) -> dict[str, tuple[int, int]]:
    """Return the columns of x and y of each track; a name above a group of columns holds until the next one."""
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


def _deeplabcut(path: Path, sha256: str, lines: Lines) -> Points:
    """Read DeepLabCut's CSV: rows scorer, (individuals,) bodyparts, coords; then the frame and x, y, likelihood."""
    heads: dict[str, list[str]] = {}
    rows = 0
    for _, line in lines[:4]:
        cells = split(line, ",")
        if is_number(cells[0]) or not cells[0]:
            break
        heads[cells[0].casefold()] = cells
        rows += 1
    if not {"bodyparts", "coords"} <= set(heads):
        raise DatasetError(
            f"{path} begins like a file of DeepLabCut but has no rows 'bodyparts' and 'coords'.",
            "Export it again from DeepLabCut.",
        )
    width = len(heads["coords"])
    table = _numbers(path, lines[rows:], ",", width, range(width))
    single = len(set(heads.get("individuals", ["", ""])[1:])) < 2
    return _grouped(
        path,
        sha256,
        table[0],
        [
            (
                heads["bodyparts"][i] if single else f"{heads['individuals'][i]}.{heads['bodyparts'][i]}",
                heads["coords"][i],
                table[i],
            )
            for i in range(1, width)
        ],
    )


def _sleap(path: Path, sha256: str, lines: Lines) -> Points:
    """Read SLEAP's CSV of points: track, frame_idx, instance.score, then node.x, node.y, node.score."""
    delimiter = delimiter_of(lines[0][1])
    heads = split(lines[0][1], delimiter)
    tracks = [
        split(line, delimiter)[heads.index("track")] if "track" in heads else "" for _, line in lines[1:]
    ]
    if len(set(tracks)) > 1:
        raise DatasetError(
            f"{path} holds {len(set(tracks))} tracked instances.",
            "Export one instance; a body is one of them.",
        )
    wanted = [
        i for i, h in enumerate(heads) if h == "frame_idx" or h.rpartition(".")[2] in {"x", "y", "score"}
    ]
    table = _numbers(path, lines[1:], delimiter, len(heads), wanted)
    parts = [
        (h.rpartition(".")[0], h.rpartition(".")[2], table[i]) for i, h in enumerate(heads) if i in table
    ]
    return _grouped(
        path, sha256, table[heads.index("frame_idx")], [p for p in parts if p[0] and p[0] != "instance"]
    )


def _grouped(path: Path, sha256: str, frame: Floats, columns: list[tuple[str, str, Floats]]) -> Points:
    points: dict[str, dict[str, Floats]] = {}
    for name, what, values in columns:
        points.setdefault(name, {})["likelihood" if what in {"likelihood", "score"} else what] = values
    whole = {n: p for n, p in points.items() if {"x", "y"} <= set(p)}
    return Points(
        path,
        sha256,
        frame,
        {n: np.stack([p["x"], p["y"]], axis=1) for n, p in whole.items()},
        {n: p["likelihood"] for n, p in whole.items() if "likelihood" in p},
        y_down=True,
        counted=True,
    )


def _numbers(
    path: Path, lines: Lines, delimiter: str | None, width: int, wanted: Sequence[int] | range
) -> dict[int, Floats]:
    rows: list[list[float]] = []
    for number, line in lines:
        cells = split(line, delimiter)
        if delimiter is not None and len(cells) == width + 1 and not cells[-1]:
            cells = cells[:-1]
        if number == lines[-1][0] and len(cells) < width and len(rows) > 1:
            break  # the last row is cut short
        if len(cells) > width or (len(cells) < width and delimiter is None):
            raise DatasetError(f"{path}, line {number}: {len(cells)} cells where the header has {width}.")
        cells += [""] * (width - len(cells))
        rows.append([_number(path, number, cells[i], decimal=delimiter != ",") for i in wanted])
    table = np.array(rows, dtype=float).reshape(len(rows), len(wanted))
    return {i: table[:, k] for k, i in enumerate(wanted)}


def _number(path: Path, line: int, cell: str, *, decimal: bool) -> float:
    value = number_of(cell, decimal_comma=decimal)
    if value is None:
        raise DatasetError(
            f"{path}, line {line}: '{cell[:30]}' is not a number.",
            "Leave the cell empty where a value is missing.",
        )
    return value
