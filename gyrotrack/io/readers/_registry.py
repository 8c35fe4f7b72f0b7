"""The formats of imported files. A new format needs a module with a reader and an entry in `FORMATS`.

A format is recognised by the content of the file, not by its name; the first matching entry reads the file.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io._records import Input
from gyrotrack.io.readers import _format_names as names
from gyrotrack.io.readers._archives import read_zip
from gyrotrack.io.readers._columnar import read_json, read_parquet
from gyrotrack.io.readers._inputs import InputOption, described
from gyrotrack.io.readers._matlab import read_matlab, read_matlab_hdf5
from gyrotrack.io.readers._motion_table import (
    COORDINATES,
    EXPECTED,
    MotionTable,
    ReadOptions,
    find_columns,
    in_order,
    interpret,
    scale_of,
    times_of,
    without_spikes,
)
from gyrotrack.io.readers._number_range import check_motion
from gyrotrack.io.readers._point_files import read_hdf5, read_project
from gyrotrack.io.readers._point_tables import particles_of, read_point_table
from gyrotrack.io.readers._points import Points, angle_of, changes_by_centre
from gyrotrack.io.readers._pulses import (
    Passages,
    counters_of,
    passages_of,
    read_counter,
    read_pulses,
    read_sampled_counts,
    refuse_passages,
    sampled_counts,
    with_counts,
    with_named_counter,
)
from gyrotrack.io.readers._raw_table import RawTable, read_bytes
from gyrotrack.io.readers._reading import Reading, Taken
from gyrotrack.io.readers._sound import read_wav
from gyrotrack.io.readers._spreadsheets import read_excel_97
from gyrotrack.io.readers._text_table import content_lines, read_text

Content = RawTable | Points


@dataclass(frozen=True)
class Format:
    """One format: name, test of the bytes of a file, and reader (path, bytes, options)."""

    name: str
    matches: Callable[[bytes], bool]
    read: Callable[[Path, bytes, ReadOptions], Content]


def _text(path: Path, content: bytes, options: ReadOptions) -> Content:
    lines, notes = content_lines(path, content)
    if not lines:
        raise DatasetError(f"{path} is empty.", EXPECTED)
    points = read_point_table(path, lines) if not options.names else None
    return read_text(path, lines, notes) if points is None else replace(points, notes=notes)


def _begins(start: bytes) -> Callable[[bytes], bool]:
    return lambda content: content.startswith(start)


_BLANK = b"\xef\xbb\xbf \r\n\t"


FORMATS: tuple[Format, ...] = (
    Format(
        names.HDF5,
        _begins(b"\x89HDF"),
        lambda path, _, options: read_hdf5(path, options.body),
    ),
    Format(
        names.TRACKER,
        lambda c: c.lstrip(_BLANK)[:1] == b"<" and b"cabrillo.tracker" in c[:5000],
        read_project,
    ),
    Format(names.ARCHIVE, _begins(b"PK"), read_zip),
    Format(names.EXCEL_97, _begins(b"\xd0\xcf\x11\xe0"), read_excel_97),
    Format(names.MATLAB_7_3, _begins(b"MATLAB 7.3"), read_matlab_hdf5),
    Format(names.MATLAB, _begins(b"MATLAB 5.0"), read_matlab),
    Format(names.PARQUET, _begins(b"PAR1"), read_parquet),
    Format(names.WAV, lambda c: c[:4] == b"RIFF" and c[8:12] == b"WAVE", read_wav),
    Format(names.JSON, lambda c: c.lstrip(_BLANK)[:1] in {b"{", b"["}, read_json),
    Format(names.TEXT, _begins(b""), _text),  # the fallback
)


def read_motion(path: Path, options: ReadOptions | None = None) -> MotionTable:
    """Read the motion of one body from any supported file. Errors name the file and line, or the missing option."""
    options = options or ReadOptions()
    name, found = _content(Path(path), options)
    made = _from_points(found, options) if isinstance(found, Points) else _from_table(found, options)
    quantity = {"omega": "speed"}.get(made.quantity, made.quantity)
    check_motion(f"body in {made.path.name}", quantity, made.time, made.value, made.sigma)
    made = _with_inputs(made, options)
    return made if made.reading is None else replace(made, reading=replace(made.reading, format=name))


def _with_inputs(made: MotionTable, options: ReadOptions) -> MotionTable:
    """Return a motion with its inputs from the file or from separate tables; missing columns raise a UsageError."""
    if made.reading is None or not options.inputs:
        return made
    missing = [o for o in options.inputs if o.file is None and o.name not in {i.name for i in made.inputs}]
    if missing:
        what = f"{made.path} is not a table of angles or speeds; --input reads a column of such a table."
        raise UsageError(
            what, f"Give the input in a separate table: --input '{missing[0].name}=2, file=TABLE'."
        )
    inputs, taken, notes = [*made.inputs], [*made.reading.taken], [*made.notes]
    for option in (o for o in options.inputs if o.file is not None):
        found, of_file = _input_of_file(option)
        inputs.append(found)
        taken.append(of_file)
        notes.append(f"the times of {of_file.column} and of {made.path.name} are on one clock")
    order = {o.name: k for k, o in enumerate(options.inputs)}
    inputs.sort(key=lambda i: order[i.name])
    reading = replace(made.reading, taken=tuple(taken))
    return replace(made, inputs=tuple(inputs), reading=reading, notes=tuple(notes))


def _input_of_file(option: InputOption) -> tuple[Input, Taken]:
    """Return an input from a separate table, and its interpretation."""
    assert option.file is not None  # noqa: S101 - the caller selects these
    _, raw = _content(option.file, ReadOptions())
    if isinstance(raw, Points):
        raise DatasetError(f"{option.file} contains points, not a table of an input.", "Give a table.")
    columns = find_columns(raw, ReadOptions(inputs=(replace(option, file=None),)))
    place = option.place(raw)
    if place is None:
        what = f"{raw.header_place}: there is no column '{option.column[:40]}' for the input {option.name}."
        raise DatasetError(
            what, f"Its columns: {', '.join(n or str(k + 1) for k, n in enumerate(raw.names))[:80]}."
        )
    clock = columns.place.get("t", 0)
    if clock == place:
        what = f"{raw.header_place}: the column of the input {option.name} contains the time."
        raise DatasetError(what, "Give another column.")
    unit = columns.unit.get("t", "")
    time = raw.numbers(clock, "t", times=True) * scale_of(raw, "t", unit)
    found = option.made(raw, place, time)
    name = raw.names[place] or str(place + 1)
    return found, Taken(
        f"'{name}' of {option.file.name}",
        f"input {option.name}",
        found.unit,
        f"by --input; {described(found)}",
    )


def read_passages(path: Path, options: ReadOptions) -> Passages | None:
    """Read the passages of a pendulum through light gates; None if a file contains other data."""
    _, found = _content(Path(path), options)
    return None if isinstance(found, Points) else passages_of(found, options)


def _content(path: Path, options: ReadOptions) -> tuple[str, Content]:
    """Return the name of the format of a file, and its content."""
    content = read_bytes(path)
    form = next(f for f in FORMATS if f.matches(content))
    found = form.read(path, content, options)
    return form.name.partition(" (")[0], replace(found, sha256=hashlib.sha256(content).hexdigest())


def _from_table(raw: RawTable, options: ReadOptions) -> MotionTable:
    """Return the motion in a table of angles, speeds, pulses or counts."""
    if not options.names and (particles := particles_of(raw)) is not None:
        return _from_points(replace(particles, sha256=raw.sha256), options)
    raw = _rows_of_body(raw, options)
    if options.pulses_per_turn:
        options = with_counts(raw, options)
        columns = with_named_counter(raw, find_columns(raw, options), options)
        counts = sampled_counts(raw, columns.place)
        if counts is not None and not set(columns.place) & {"angle", "omega"}:
            return read_sampled_counts(raw, columns, counts, options)
    if raw.headed or options.names:
        columns = with_named_counter(raw, find_columns(raw, options), options)
        if set(COORDINATES) <= set(columns.place):
            place = np.stack([raw.numbers(columns.place[axis], axis) for axis in COORDINATES], axis=1)
            time = times_of(raw, columns.place, columns.unit, replace(options, start=0.0))
            places = {raw.path.stem: place}
            points = Points(raw.path, time, places, {}, y_down=False, counted=False, notes=raw.notes)
            return _from_points(replace(points, sha256=raw.sha256), options)
        if "revolutions" in columns.place and not set(columns.place) & {"angle", "omega"}:
            why = columns.why["revolutions"]
            clock = columns.place.get("t", 0), columns.unit.get("t", "")
            return read_counter(raw, columns.place["revolutions"], options, *clock, why=why)
        refuse_passages(raw, options)
    elif not options.pulses_per_turn:
        counters = counters_of(raw)
        if len(counters) > 1:
            numbers = ", ".join(str(i + 1) for i in counters)
            what = f"{raw.path}: the columns {numbers} count revolutions."
            raise DatasetError(what, f"Choose one: --column revolutions={counters[0] + 1}.")
        if counters:
            return read_counter(raw, counters[0], options)
    return read_pulses(raw, options) if options.pulses_per_turn else interpret(raw, options)


def _rows_of_body(raw: RawTable, options: ReadOptions) -> RawTable:
    """Return the rows of one body if a table contains several bodies, for example a table of `export`."""
    labels = (c for n, c in zip(raw.names, raw.columns, strict=True) if n.casefold() == "body")
    names = next((c for c in labels if isinstance(c, list)), None)
    if names is None:
        return raw
    words = np.array([str(w) for w in names])
    bodies = sorted(set(words))
    body = options.body if options.body in bodies else bodies[0] if len(bodies) == 1 else None
    if body is None:
        what = f"{raw.path} contains the bodies {', '.join(bodies)[:80]}."
        raise DatasetError(
            what, "Import the table with --casing and --rotor, or with --body NAME=FILE for each body."
        )
    rows = np.flatnonzero(words == body)
    columns = tuple(c[rows] if isinstance(c, np.ndarray) else [c[i] for i in rows] for c in raw.columns)
    return replace(raw, columns=columns, line=raw.line[rows])


def _from_points(points: Points, options: ReadOptions) -> MotionTable:
    notes = [*points.notes]
    places = {
        n: np.stack([without_spikes(v, n, notes) for v in p.T], axis=1) for n, p in points.places.items()
    }
    found = angle_of(replace(points, places=places), options)
    valid = np.isfinite(found.angle) & np.isfinite(found.time)
    lost = int((~valid).sum())
    notes += found.notes
    if lost:
        notes.append(f"{points.path.name}: {lost} frames without the marker were excluded")
    rows = np.flatnonzero(valid)
    sigma = None if found.sigma is None else found.sigma[rows]
    origin, values = (points.path, points.sha256, "angle"), (found.time[rows], found.angle[rows], sigma)
    table = in_order(MotionTable(*origin, *values, rows + 1, (), doubts=found.doubts), notes)
    if found.centre_covariance is not None:
        changes = changes_by_centre(table.value, found.radius, found.centre_covariance)
        table = replace(table, changes=changes)
    others = tuple(f"point '{n}'" for n in points.places if n not in found.used)
    others += tuple(f"'{name}'" for name in points.left_out)
    reading = Reading(points.path.name, "", len(points.time), found.taken, others)
    return replace(table, notes=tuple(notes), reading=reading)
