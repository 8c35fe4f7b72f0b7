"""Contents of a file: consistency check (`info`) and export to other programs.

The export formats are CSV, Parquet, netCDF, JSON, and text and projects of OSP Tracker; `import` reads all these
formats.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NotRequired, TypedDict, cast

import h5py
import numpy as np
from numpy.typing import NDArray

from fitting._case_format import CASE, CASE_ATTRIBUTES, INPUT, stated_attributes
from gyrotrack._errors import UsageError
from gyrotrack.io import _hdf5 as hdf5
from gyrotrack.io._atomic import new_file
from gyrotrack.io._records import (
    BodyTrack,
    Case,
    Column,
    Floats,
    Input,
    Placement,
    Recording,
    Series,
    columns,
    windows_of,
)
from gyrotrack.io._schema import RECORDING_ATTRIBUTES, STATUS
from gyrotrack.io._tables import READER
from gyrotrack.io._tracker_project import write_project


class Provenance(TypedDict):
    """The origin of a file."""

    format_version: str  #: Version of the layout.
    software_version: str  #: Version of gyrotrack that wrote the file.
    created: str  #: Time of writing (ISO 8601).
    command: str  #: Command that wrote the file.
    settings: dict[str, Any]  #: Settings of this command.


class MarkerCounts(TypedDict):
    """Number of frames by status of a marker."""

    ok: int  #: Frames in which the marker is measured.
    blurred: int  #: Frames in which the marker is blurred by the motion.
    occluded: int  #: Frames in which the marker is occluded.
    out_of_frame: int  #: Frames in which the marker is outside the picture.
    lost: int  #: Frames in which the marker is not found.


class MarkerSummary(MarkerCounts):
    """Body of a marker, and its number of frames by status."""

    body: str  #: `casing` or `rotor`.


class MotionSummary(TypedDict):
    """Extent of a measured motion; numbers are null without a sample."""

    samples: int  #: Number of samples.
    t_start: float | None  #: Time of the first sample [s].
    t_stop: float | None  #: Time of the last sample [s].
    omega_min: float | None  #: Smallest angular velocity [rad s-1].
    omega_max: float | None  #: Largest angular velocity [rad s-1].
    #: Median standard uncertainty of the measured angles or angular velocities [rad, or rad s-1].
    median_sigma: float | None


class SeriesSummary(MotionSummary):
    """Extent of a measured motion, and the origin of its uncertainty."""

    sigma_source: str  #: Origin of the standard uncertainty, for example `measured`.


class WindowSummary(MotionSummary):
    """Extent of the motion in one window."""

    window: int  #: Number of the window, from 0.


class WindowsSummary(TypedDict):
    """The windows of the rotor."""

    samples: int  #: Number of samples.
    sigma_source: str  #: Origin of the standard uncertainty.
    windows: list[WindowSummary]  #: The windows.


class BodySummary(WindowsSummary):
    """A further body of a chain."""

    inertia: float  #: Moment of inertia [kg m2].
    inertia_u: float | None  #: Standard uncertainty of the inertia; null if not given [kg m2].


class InputSummary(TypedDict):
    """A recorded input of the motion; unknown numbers are null."""

    samples: int  #: Number of samples.
    t_start: float | None  #: Time of the first sample [s].
    t_stop: float | None  #: Time of the last sample [s].
    min: float | None  #: Smallest value [`unit`].
    max: float | None  #: Largest value [`unit`].
    median_u: float | None  #: Median standard uncertainty due to calibration [`unit`].


class RecordingSummary(TypedDict):
    """Contents of a recording."""

    times_from: str  #: Origin of the times: `frames` or `stamps`.
    frames: int  #: Number of stored frames.
    duration_s: float  #: Time from the first to the last frame [s].
    markers: dict[str, MarkerSummary]  #: Markers by name.
    bodies: dict[str, MotionSummary]  #: Measured angles by body.


class ClipSummary(RecordingSummary):
    """A recording in a case."""

    placement: NotRequired[Placement]  #: Clock of the clip.


class CaseSummary(TypedDict):
    """Contents of a case."""

    #: Moment of inertia of the casing, the single body, or the first body of a chain; null if it is unknown [kg m2].
    I_casing: float | None
    casing: SeriesSummary  #: The casing, the single body, or the first body of a chain.
    rotor: WindowsSummary  #: The rotor.
    further: dict[str, BodySummary]  #: Further bodies of a chain, by name.
    joints: dict[str, list[str]]  #: The two bodies of each joint of a chain.
    rotor_generated: bool  #: Whether the case contains a generated rotor curve.
    inputs: dict[str, InputSummary]  #: Recorded inputs, by name.
    recordings: dict[str, ClipSummary]  #: Recordings of its clips, by name.


@dataclass(frozen=True)
class Inspection:
    """Contents of one file."""

    path: Path
    kind: str  # "recording" or "case"
    provenance: dict[str, Any]
    summary: dict[str, Any]  # summary of the contents, serialisable as JSON
    problems: tuple[str, ...]  # inconsistencies; empty for a consistent file
    # number of datasets and chunks that were verified
    datasets_verified: int = 0
    chunks_verified: int = 0
    warnings: tuple[str, ...] = field(default=())


def inspect_file(path: Path, *, verify: bool = False) -> Inspection:
    """Read a recording or a case, and return a summary; `verify` compares every chunk with its checksum."""
    with READER.open(path) as file:
        kind = READER.attribute(file, "kind", str)
        *names, _ = Provenance.__annotations__
        provenance = {name: READER.attribute(file, name, str, "?") for name in names}
        provenance["settings"] = READER.json(file, "settings", {})
        loaded = hdf5.load_case(file) if kind == CASE else hdf5.load_recording(file)
        verified = [_chunks(dataset) for dataset in _datasets(file, set())] if verify else []
    content: Recording | Case
    if isinstance(loaded, hdf5.LoadedCase):
        content = loaded.case()
        summary, problems = describe_case(content), _case_problems(content)
    else:
        content = loaded
        summary, problems = describe_recording(content), _recording_problems(content)
    counts = len(verified), sum(verified)
    return Inspection(Path(path), kind, provenance, summary, tuple(problems), *counts, content.warnings)


def describe_recording(recording: Recording) -> dict[str, Any]:
    """Return a summary of a recording: size, duration, markers and bodies."""
    found = RecordingSummary(
        times_from=str(recording.extra.get("times_from", "frames")),
        frames=len(recording.frame_index),
        duration_s=float(recording.time[-1] - recording.time[0]) if len(recording.time) else 0.0,
        markers={name: {"body": m.body, **marker_counts(m.status)} for name, m in recording.markers.items()},
        bodies={name: describe_motion(body) for name, body in recording.bodies.items()},
    )
    return {**stated_attributes(recording, RECORDING_ATTRIBUTES), **found}


def marker_counts(status: NDArray[np.integer]) -> MarkerCounts:
    """Return the number of frames by status."""
    return cast(MarkerCounts, {word: int(np.sum(status == code)) for word, code in STATUS.items()})


def describe_case(case: Case) -> dict[str, Any]:
    """Return a summary of a case: its attributes, series, windows and clips."""
    key = "omega_sigma" if case.quantity == "omega" else "sigma"
    further: dict[str, BodySummary] = {
        b.name: {
            **_describe_series(b.series, key),
            "inertia": b.inertia,
            "inertia_u": None if math.isnan(b.inertia_u) else b.inertia_u,
        }
        for b in case.further
    }
    clips: dict[str, Any] = {name: describe_recording(r) for name, r in case.recordings.items()}
    for name in case.placements.keys() & clips.keys():
        clips[name]["placement"] = vars(case.placements[name])
    inputs: dict[str, Any] = {i.name: _describe_input(i) for i in case.inputs}
    found = CaseSummary(
        I_casing=None if case.per_inertia else case.I_casing,
        casing={**describe_motion(case.casing, key=key), "sigma_source": case.casing.sigma_source},
        rotor=_describe_series(case.rotor, key),
        further=further,
        joints={name: list(bodies) for name, bodies in case.joints.items()},
        rotor_generated=case.rotor_generated is not None,
        inputs=inputs,
        recordings=clips,
    )
    stated = case if case.bodies == "two" else replace(case, I_rotor=math.nan, I_rotor_u=math.nan)
    return {**stated_attributes(stated, CASE_ATTRIBUTES), **found}


def _describe_series(series: Series, key: str) -> WindowsSummary:
    """Return the number of samples, the origin of the uncertainty, and the windows of a series."""
    windows = describe_windows(series, key)
    return {"samples": len(series.time), "sigma_source": series.sigma_source, "windows": windows}


def _describe_input(i: Input) -> dict[str, Any]:
    """Return unit, number of samples, ranges, interpolation and delay of a recorded input."""
    known = i.u[np.isfinite(i.u)]
    found = InputSummary(
        samples=len(i.time),
        t_start=float(i.time[0]) if len(i.time) else None,
        t_stop=float(i.time[-1]) if len(i.time) else None,
        min=float(np.nanmin(i.value)) if len(i.value) else None,
        max=float(np.nanmax(i.value)) if len(i.value) else None,
        median_u=float(np.median(known)) if len(known) else None,
    )
    return {**stated_attributes(i, INPUT.attributes), **found}


def describe_motion(
    track: BodyTrack | Series, chosen: Any = slice(None), key: str = "sigma"
) -> MotionSummary:
    """Return number of samples, range of time and speed, and median uncertainty (`key`: of the angle or the speed)."""
    time, omega, sigma = track.time[chosen], track.omega[chosen], getattr(track, key)[chosen]
    fast = omega[np.isfinite(omega)]
    known = sigma[np.isfinite(sigma)]
    return {
        "samples": len(time),
        "t_start": float(time[0]) if len(time) else None,
        "t_stop": float(time[-1]) if len(time) else None,
        "omega_min": float(fast.min()) if len(fast) else None,
        "omega_max": float(fast.max()) if len(fast) else None,
        "median_sigma": float(np.median(known)) if len(known) else None,
    }


def describe_windows(series: Series, key: str) -> list[WindowSummary]:
    """Return the summary of each window of a series; see `describe_motion`."""
    windows = windows_of(series)
    return [{"window": int(k), **describe_motion(series, windows == k, key)} for k in np.unique(windows)]


def _recording_problems(recording: Recording) -> list[str]:
    found = []
    if recording.sense not in {-1, 1}:
        found.append(f"the sense is {recording.sense}, not +1 or -1")
    if not len(recording.frame_index):
        found.append("there are no frames")
    if recording.frames_decoded != (stored := len(recording.frame_index)):
        found.append(f"{recording.frames_decoded} frames were decoded but {stored} are stored")
    found += _time_problems("the frames", recording.time)
    for name, marker in recording.markers.items():
        if not np.isin(marker.status, list(STATUS.values())).all():
            found.append(f"marker '{name}' has a status that is not defined")
    for name, body in recording.bodies.items():
        found += _motion_problems(name, body)
    return found or ([] if recording.bodies else ["no body has an angle"])


def _case_problems(case: Case) -> list[str]:
    main, *others = case.motions
    found = _motion_problems("casing" if case.bodies == "one" else main[0], main[1])
    for name, series in others:
        windows = windows_of(series)
        if not len(series.time):
            found.append(f"the {name} has no samples")
        for k in np.unique(windows):
            found += _motion_problems(f"{name} window {k}", series, windows == k)
    for i in case.inputs:
        found += _time_problems(f"the input '{i.name}'", i.time)
        if not len(i.value) or not np.isfinite(i.value).all():
            found.append(f"the input '{i.name}' lacks some values")
    for name, recording in case.recordings.items():
        found += [f"clip '{name}': {problem}" for problem in _recording_problems(recording)]
    return found


def _motion_problems(name: str, track: BodyTrack | Series, rows: Any = slice(None)) -> list[str]:
    found = _time_problems(name, track.time[rows])
    valid = np.isfinite(track.angle[rows])
    if not valid.any():
        found.append(f"{name} has no angles")
    elif not (track.sigma[rows][valid] > 0).all():
        found.append(f"{name} has angles without a positive uncertainty")
    return found


def _time_problems(name: str, time: Floats) -> list[str]:
    if not np.isfinite(time).all():
        return [f"{name} {'have times that are not numbers' if name == 'the frames' else 'lacks some times'}"]
    back = np.flatnonzero(np.diff(time) <= 0)
    return [f"the times of {name} are not strictly increasing (sample {back[0] + 2})"] if len(back) else []


def _datasets(group: Any, seen: set[int]) -> Iterator[Any]:
    """Yield all datasets below `group`; only hard links are followed, and each group is visited once."""
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        member = group[name]
        if isinstance(member, h5py.Dataset):
            yield member
        elif isinstance(member, h5py.Group) and (address := h5py.h5o.get_info(member.id).addr) not in seen:
            seen.add(address)
            yield from _datasets(member, seen)


def _chunks(dataset: Any) -> int:
    """Read a dataset, which verifies the checksum of every chunk, and return the number of chunks."""
    READER.check_storage(dataset)
    READER.load(dataset)
    return int(dataset.id.get_num_chunks()) if dataset.chunks else 1


_BLOCK = 20_000
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


class ExportDocument(TypedDict):
    """The size of an exported table, or the groups of a netCDF file."""

    rows: NotRequired[int]  #: Number of rows; absent for netCDF.
    columns: NotRequired[dict[str, str]]  #: Unit of each column; absent for netCDF.
    groups: NotRequired[list[str]]  #: Groups with variables; only for netCDF.


def export_file(source: Path, target: Path, *, table: str = "motion", force: bool = False) -> ExportDocument:
    """Write a recording or a case in the format of the suffix of `target`.

    Parameters
    ----------
    source : Path
        A recording or a case.
    target : Path
        ``.csv`` (units in the header, numbers with all digits, empty cells for NaN), ``.parquet`` (units in the
        metadata of the fields), ``.json`` (columns and units), ``.txt``, ``.trk`` or ``.trz`` (text, project or zipped
        project of OSP Tracker: a point on the unit circle for each body) or ``.nc`` (netCDF-4 with the complete
        contents).
    table : str
        Table of `columns`; netCDF contains all tables.
    force : bool
        Replace an existing file.

    Returns
    -------
    dict
        ``rows`` and ``columns``, or ``groups`` of a netCDF file.

    Raises
    ------
    DatasetError, OutputError
        The source cannot be read, or the target cannot be written.
    UsageError
        The suffix or the table is unknown, or a library for it is not installed.
    """
    form = FORMATS.get(target.suffix.lower())
    if form is None:
        what = f"{target.name} has the suffix of no known format."
        raise UsageError(what, f"Known suffixes: {', '.join(FORMATS)}.")
    kind = hdf5.read_kind(source)
    if form is _netcdf:
        return _netcdf(source, target, force=force)
    made = columns(hdf5.read_case(source) if kind == CASE else hdf5.read_recording(source), table)
    with new_file(target, force=force) as stream:
        form(made, stream)
    return {"rows": len(made[0].values), "columns": {c.name: c.unit for c in made}}


def _csv(made: Sequence[Column], stream: BinaryIO) -> None:
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([c.heading for c in made])
    for start in range(0, len(made[0].values), _BLOCK):
        writer.writerows(zip(*(_cells(c, slice(start, start + _BLOCK)) for c in made), strict=True))
    text.flush()
    text.detach()


def _cells(column: Column, rows: slice) -> list[str]:
    values = column.values[rows].tolist()
    if column.values.dtype.kind == "f":
        return ["" if v != v else repr(v) for v in values]
    if column.values.dtype.kind == "O":
        return [plain_cell(str(v)) for v in values]
    return [str(v) for v in values]


def plain_cell(text: str) -> str:
    """Return a text that a spreadsheet does not interpret as a formula."""
    plain = "'" + text if text.startswith(_FORMULA) else text
    # the module `csv` does not quote a carriage return, which would begin a new row
    return plain.replace("\r", "\n")


def _parquet(made: Sequence[Column], stream: BinaryIO) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise _missing_library("Parquet", "pyarrow") from None
    fields, arrays = [], []
    for c in made:
        arrays.append(pa.array(c.values.tolist() if c.values.dtype.kind == "O" else np.asarray(c.values)))
        fields.append(pa.field(c.name, arrays[-1].type, metadata={"units": c.unit} if c.unit else None))
    units = json.dumps({c.name: c.unit for c in made if c.unit})
    schema = pa.schema(fields, metadata={"units": units})
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), stream)


def _json(made: Sequence[Column], stream: BinaryIO) -> None:
    """Write columns and units; NaN becomes null."""
    values = {c.name: [None if v != v else v for v in c.values.tolist()] for c in made}
    document = {"columns": values, "units": {c.name: c.unit for c in made if c.unit}}
    stream.write(json.dumps(document, allow_nan=False).encode())


def _angles_of_bodies(made: Sequence[Column]) -> list[tuple[str, Floats, Floats]]:
    """Return name, times [s] and angles [rad] of each body."""
    columns = {c.name: c.values for c in made}
    if not {"body", "time", "angle"} <= set(columns):
        raise UsageError("A file of OSP Tracker can contain angles of bodies only.", "Use --table motion.")
    bodies = dict.fromkeys(columns["body"].tolist())
    rows = {body: columns["body"] == body for body in bodies}
    return [(str(b), columns["time"][rows[b]], columns["angle"][rows[b]]) for b in bodies]


def _project(made: Sequence[Column], stream: BinaryIO, *, zipped: bool = False) -> None:
    write_project(stream, _angles_of_bodies(made), zipped=zipped)


def _tracker(made: Sequence[Column], stream: BinaryIO) -> None:
    """Write a track for each body, (cos, sin) of its angle about the track "origin", at the times of all bodies."""
    bodies = _angles_of_bodies(made)
    times = np.unique(np.concatenate([time for _, time, _ in bodies]))
    places = np.full((len(times), 2 * len(bodies)), np.nan)
    for k, (_, time, angle) in enumerate(bodies):
        at = np.searchsorted(times, time)
        places[at, 2 * k], places[at, 2 * k + 1] = np.cos(angle), np.sin(angle)
    titles = ["", *(f"{body}\t" for body, *_ in bodies), "origin\t"]
    lines = ["\t".join(titles), "\t".join(["t", *("x", "y") * (len(bodies) + 1)])]
    for time, row in zip(times.tolist(), places.tolist(), strict=True):
        lines.append("\t".join([repr(time), *("" if v != v else repr(v) for v in row), "0.0", "0.0"]))
    stream.write(("\n".join(lines) + "\n").encode())


def _netcdf(source: Path, target: Path, *, force: bool) -> ExportDocument:
    try:
        import h5netcdf  # noqa: F401 - xarray's engine
        import xarray as xr
    except ImportError:
        raise _missing_library("netCDF", "xarray and h5netcdf") from None
    with new_file(target, force=force) as stream, xr.open_datatree(source, engine="h5netcdf") as tree:
        stream.write(tree.to_netcdf(engine="h5netcdf"))
        return {"groups": [node.path for node in tree.subtree if node.data_vars]}


def _missing_library(form: str, libraries: str) -> UsageError:
    return UsageError(
        f"{form} needs {libraries}, not installed here.", 'Install them: pip install "gyrotrack[notebook]"'
    )


FORMATS: dict[str, Callable[..., Any]] = {
    ".csv": _csv,
    ".parquet": _parquet,
    ".nc": _netcdf,
    ".json": _json,
    ".txt": _tracker,
    ".trk": _project,
    ".trz": partial(_project, zipped=True),
}
