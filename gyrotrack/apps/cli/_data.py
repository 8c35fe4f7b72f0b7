"""Commands for data files: import, export, info."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NotRequired, TypedDict

import typer

from fitting._numbers import rounded, speed, speed_unit
from gyrotrack._errors import UsageError
from gyrotrack.apps._study import checked_body_name
from gyrotrack.apps.cli import _settings as shared
from gyrotrack.apps.cli._output import DONE, NOT_TRUSTED, command_line, printable, sparkline
from gyrotrack.apps.cli._settings import option
from gyrotrack.io.readers._format_names import ALL

if TYPE_CHECKING:
    from gyrotrack.io._contents import Inspection
    from gyrotrack.io._records import Case
    from gyrotrack.io.readers._reading import ReadingDocument


_TABLE = "Angles, angular rates, pulses or points of the casing (CSV, Tracker, phyphox, Excel, MATLAB ...)"


class PlottedMotion(TypedDict):
    """The angular velocity of one body over time, thinned to about 200 points."""

    body: str  #: Name of the body.
    time: list[float]  #: Times [s].
    omega: list[float]  #: Angular velocity [rad s-1].


class ImportDocument(TypedDict):
    """A new case, and the interpretation of its files."""

    output: Path | None  #: The case; null with `--dry-run`.
    reading: list[ReadingDocument]  #: Interpretation of each file.
    plot: NotRequired[list[PlottedMotion]]  #: Motion of each body, with `--dry-run`.


class ExportedFile(TypedDict):
    """A file with exported data."""

    output: Path  #: The file.


class VerifiedDocument(TypedDict):
    """Numbers of checked parts; 0 without `--verify`."""

    datasets: int  #: Number of datasets.
    chunks: int  #: Number of chunks.


class InspectionDocument(TypedDict):
    """The integrity of a file."""

    file: Path  #: The file.
    bytes: int  #: Size of the file.
    kind: str  #: `recording` or `case`.
    sound: bool  #: Whether the file is consistent.
    problems: tuple[str, ...]  #: Inconsistencies.
    warnings: tuple[str, ...]  #: Warnings stored in the file.
    verified: VerifiedDocument  #: What was compared with checksums.


def import_command(
    *,
    casing: Annotated[Path | None, option("--casing FILE", f"{_TABLE}.")] = None,
    rotor: Annotated[
        list[Path] | None,
        option(
            "--rotor FILE",
            "Angles, angular rates, pulses or points of the rotor in one window; once per window.",
        ),
    ] = None,
    body: Annotated[
        list[str] | None,
        option(
            "--body FILE",
            "Angles, angular rates, pulses or points of a single body, instead of casing and rotor. For "
            "several bodies with joints, NAME=FILE for each; the first body may come to rest.",
        ),
    ] = None,
    joint: Annotated[
        list[str] | None,
        option(
            "--joint NAME=A,B", "Joint between two bodies; its torque drives B and brakes A. Once per joint."
        ),
    ] = None,
    inertia: Annotated[
        list[str] | None,
        option(
            "--inertia I",
            "Moment of inertia of the single body, for example '5.5e-5 +- 0.1e-5' (kg m2); without it, torques are "
            "per unit of inertia. For several bodies, NAME=I for each.",
        ),
    ] = None,
    output: shared.OptionalOutputFile = None,
    dry_run: Annotated[
        bool, option("--dry-run", "Show the meaning of each column and a plot; write nothing.")
    ] = False,
    columns: shared.Columns = None,
    marker: shared.Marker = None,
    centre: shared.Centre = None,
    inputs: shared.Inputs = None,
    likelihood: shared.Likelihood = 0.6,
    casing_fps: Annotated[
        float | None,
        option("--casing-fps N", "Capture rate of a file of the casing or body without times [1/s]."),
    ] = None,
    rotor_fps: Annotated[
        float | None, option("--rotor-fps N", "Capture rate of a rotor file without times [1/s].")
    ] = None,
    rotor_start: Annotated[
        list[float] | None, option("--rotor-start T", "Start of a rotor file of points [s]; once per file.")
    ] = None,
    pulses_per_turn: shared.PulsesPerTurn = None,
    start: shared.StartTime = None,
    stop: shared.StopTime = None,
    cut: shared.Cuts = None,
    keep_all: Annotated[
        bool,
        option("--keep-all", "Keep outliers, and drive, brake and rest at the ends of the record (--body)."),
    ] = False,
    start_u: Annotated[
        float | None,
        option(
            "--start-u U",
            "Standard uncertainty of the start of each rotor window on the clock of the casing [s], 0 if "
            "exact. Without this option, every diagnosis considers errors of the starts.",
        ),
    ] = None,
    label: shared.Label = None,
    body_name: shared.BodyName = "",
    surface: shared.Surface = "",
    inertia_rotor: shared.InertiaRotor = None,
    inertia_casing: shared.InertiaCasing = None,
    force: shared.Force = False,
    out: shared.VerboseOut,
) -> int:
    """Make a case from measured angles, angular rates, pulses or tracked points.

    The format is recognised by content: {formats}. Times are in s, all on one clock; angles in rad, wrapped or
    unwrapped; other units are converted if the header contains them, for example `angle [deg]`. Without a sigma column
    the noise is estimated from the scatter. With --body the case has a single body; a drive at the start and a brake or
    rest at the end are detected, reported and excluded; without --inertia its torques are per unit of inertia. For each
    file, the command prints the meaning of each column with the reason, and the unused columns. For a doubtful column,
    the command names the option that states the meaning. Every repair is reported with its line. With --input no drive,
    brake or rest is excluded, because the input describes the drive. Several bodies are connected by joints: --body
    motor=motor.csv --body drum=drum.csv --joint belt=motor,drum --inertia motor=2e-4 --inertia drum=5e-4. One file may
    contain all bodies, if its headers contain their names.

    Example: gyrotrack import --casing casing.csv --rotor r1.csv --rotor r2.csv -o case1.h5 --inertia-rotor 5.54e-5
    --inertia-casing "20.6 +- 0.2 g cm2"
    """
    from gyrotrack.io._atomic import refuse_existing
    from gyrotrack.io._hdf5 import write_case
    from gyrotrack.io._records import Inertia
    from gyrotrack.io.readers._import_case import import_body, import_case, summary
    from gyrotrack.io.readers._import_chain import import_chain, read_bodies, read_inertias, read_joints
    from gyrotrack.io.readers._inputs import read_input_options
    from gyrotrack.io.readers._motion_table import ReadOptions, read_names
    from gyrotrack.io.readers._run import Limits, read_cuts

    shared.check_pulses(pulses_per_turn)
    if output is None and not dry_run:
        raise UsageError("There is no output.", "Give -o FILE.h5, or --dry-run to check the tables only.")
    rotor = rotor or []
    bodies, joints = read_bodies(body or []), read_joints(joint or [])
    if output is not None and not dry_run:
        of_bodies = (path for paths in bodies.values() for path in paths)
        refuse_existing(output, force=force, reads=[casing, *rotor, *of_bodies])
    starts = rotor_start or [0.0] * len(rotor)
    if len(starts) != len(rotor):
        what = f"There are {len(rotor)} rotor files but {len(starts)} values of --rotor-start."
        raise UsageError(what, "Give --rotor-start once per file.")
    title = label if label is not None else "" if output is None else output.stem
    parts = ("casing", "rotor", *(bodies if len(bodies) > 1 else ()))
    names = {part: read_names(columns or (), part, parts) or None for part in parts}
    options = [
        ReadOptions(names[part], marker, centre, fps, begin, likelihood, pulses_per_turn)
        for part, fps, begin in [("casing", casing_fps, 0.0), *(("rotor", rotor_fps, t) for t in starts)]
    ]
    if start_u is not None and not 0 <= start_u < math.inf:
        raise UsageError(
            f"--start-u {start_u:g} is not an uncertainty.", "Give it in s, for example --start-u 0.002."
        )
    options[0] = replace(options[0], inputs=read_input_options(inputs or ()))
    limits = Limits(start, stop, read_cuts(cut or ()), keep_all)
    named: dict[str, Any] = {"label": title, "surface": surface, "limits": limits}
    one = "1" if dry_run else None
    alone = next(iter(bodies), None) if len(bodies) == 1 and not joints else None
    several = bodies if casing is None and not rotor else {}
    if several and alone is not None:
        moment = read_inertias(inertia or (), [alone]).get(alone)
        case = import_body(bodies[alone][0], moment, options=options[0], **named)
        case = replace(case, body_name=checked_body_name(body_name or alone))
    elif several:
        moments = {b: Inertia.of(one) for b in bodies if one} | read_inertias(inertia or (), [*bodies])
        chain = {b: replace(options[0], names=names[b], inputs=()) for b in bodies}
        chain[next(iter(bodies))] = replace(chain[next(iter(bodies))], inputs=options[0].inputs)
        case = import_chain(bodies, joints, moments, options=chain, **named)
    elif casing is not None and not bodies and inertia is None and not joints:
        r = Inertia.required(inertia_rotor or one, "rotor")
        c = Inertia.required(inertia_casing or one, "casing")
        case = import_case(casing, rotor, I_rotor=r.value, I_casing=c.value, options=options, **named)
        case = replace(case, I_rotor_u=r.u, I_casing_u=c.u, start_u=math.nan if start_u is None else start_u)
    else:
        what = "A case needs either --casing and --rotor, or --body; --inertia and --joint need --body."
        raise UsageError(what, "Give --casing and --rotor with their inertias, or --body.")
    if alone is None and body_name:
        raise UsageError("--body-name is the name of a single body.", "Use it with --body, or omit it.")
    settings = {"casing": casing, "rotor": rotor, "body": body, "joint": joint, "inertia": inertia}
    settings |= case.extra
    if dry_run:
        output = None
    if output is not None:
        write_case(output, case, command=command_line(), settings=settings, force=force)
    for warning in case.warnings:
        out.warn(warning)
    for source in case.extra["sources"]:
        out.detail(f"{source['file']}: {source['samples']} samples used")
    for sentence in _proposals(case.extra["reading"]):
        out.note(sentence)
    if case.per_inertia and not dry_run:
        out.note(
            "No moment of inertia is given: torques are per unit of inertia, in rad/s2 (--inertia: in N m)."
        )
    imported = ImportDocument(output=output, reading=case.extra["reading"])
    document: dict[str, Any] = {**imported, **summary(case)}
    if dry_run:
        document["plot"] = _plotted(case)
    out.result(document)
    if dry_run:
        out.show(*map(_reading_table, document["reading"]), *_plots(case))
    out.show(*shared.reading_lines(document["reading"]), _lines(document, case.main_body))
    return NOT_TRUSTED if case.extra["doubts"] else DONE


import_command.__doc__ = (import_command.__doc__ or "").replace("{formats}", "; ".join(ALL))


def _proposals(readings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence for each column that may be an input of the motion but is not recorded."""
    from gyrotrack.io.readers._motion_table import BY_NAME

    return [
        f"{column['column']} of {reading['file']} may drive the motion and is not recorded; record it: "
        f"--input '{_proposed_name(column['column'])}={column['column'][1:-1]}"
        f"{' [' + column['unit'] + ']' if column['unit'] else ''}'"
        for reading in readings
        for column in reading["columns"]
        if column["quantity"] == "input" and column["why"] == BY_NAME
    ]


def _proposed_name(column: str) -> str:
    """Return the name of an input in laws, from the quoted header of its column."""
    words = re.findall(r"[A-Za-z]+", column.lower())
    return next((w for w in words if w not in {"command", "commanded", "measured", "motor"}), "u")


_MOST_PLOTTED = 200  # number of points of the plot of a body


def _reading_table(reading: Mapping[str, Any]) -> Any:
    """Return the meaning of each column of a file, as a table."""
    from rich.table import Table as Grid

    grid = Grid(title=f"{reading['file']}: {reading['format']}, {reading['rows']} rows", box=None)
    for heading in ("column", "taken for", "unit", "because"):
        grid.add_column(heading)
    for column in reading["columns"]:
        grid.add_row(*(printable(column[key]) for key in ("column", "quantity", "unit", "why")))
    for name in reading["left_out"]:
        grid.add_row(printable(name), "left out", "", "")
    return grid


def _plots(case: Case) -> list[str]:
    """Return the speeds of the bodies over time, as lines of text."""
    import numpy as np

    lines = []
    for name, series in case.motions:
        omega = series.omega[np.isfinite(series.omega)]
        if len(omega):
            lines.append(
                f"speed of the {name}, {speed(omega.min()):.4g} to {speed(omega.max()):.4g} {speed_unit()}: "
                f"{sparkline(omega)}"
            )
    return lines


def _plotted(case: Case) -> list[PlottedMotion]:
    """Return the speeds of the bodies over time, reduced to fewer points, for a plot of the workbench."""
    import numpy as np

    found: list[PlottedMotion] = []
    for name, series in case.motions:
        known = np.flatnonzero(np.isfinite(series.omega))
        rows = known[:: max(len(known) // _MOST_PLOTTED, 1)]
        if len(rows):
            found.append(
                {"body": name, "time": series.time[rows].tolist(), "omega": series.omega[rows].tolist()}
            )
    return found


def _lines(document: dict[str, Any], body: str) -> str:
    casing = document["casing"]
    unit = "rad" if casing["quantity"] == "angle" else "rad/s"
    heading = f"sigma [{unit}]"
    rate = f"speed [{speed_unit()}]"
    lines = [f"{'':<10}{'samples':>9}{'time [s]':>22}{rate:>20}{heading:>16}"]
    lines.append(_line(body, casing))
    lines += [_line(name, window) for name, window in _windows(document)]
    return "\n".join(
        [*lines, f"written: {document['output']}" if document["output"] else "nothing was written"]
    )


def _windows(summary: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the windows of the rotor, or of the further bodies of a chain, with their names."""
    for name, body in ({"rotor": summary["rotor"]} | summary["further"]).items():
        for window in body["windows"]:
            numbered = name == "rotor" or len(body["windows"]) > 1
            yield f"{name} {window['window']}" if numbered else name, window


def _line(name: str, part: dict[str, Any]) -> str:
    time = f"{part['t_start']:.3f} to {part['t_stop']:.3f}"
    rate = _speeds(part)
    return f"{name:<10}{part['samples']:>9} {time:>21} {rate:>19}{part['median_sigma']:>16.2g}"


class Table(StrEnum):
    """Table to export."""

    motion = "motion"
    markers = "markers"
    frames = "frames"
    inputs = "inputs"
    points = "points"
    errors = "errors"


def export_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Case or recording.")],
    *,
    output: shared.OutputFile,
    table: Annotated[
        Table,
        option(
            "--table",
            "motion: angles of the bodies; markers: every marker; frames: every frame; inputs: recorded inputs; "
            "points: paths of points; errors: errors that samples share (CSV, Parquet, JSON).",
        ),
    ] = Table.motion,
    force: shared.Force = False,
    out: shared.Out,
) -> None:
    """Export the data as CSV, Parquet, netCDF, JSON, or OSP Tracker text or project, by the suffix of the output.

    Example: gyrotrack export case1.h5 -o case1.csv
    """
    from gyrotrack.apps._study import with_ledgers
    from gyrotrack.io._atomic import refuse_existing
    from gyrotrack.io._contents import export_file

    refuse_existing(output, force=force, reads=with_ledgers([file]))
    with out.progress(f"writing {output.name}") as progress:
        progress(0, None)
        document = export_file(file, output, table=table.value, force=force)
    out.result({**ExportedFile(output=output), **document})
    held = f"{document['rows']} rows" if "rows" in document else f"{len(document['groups'])} groups"
    out.show(f"{held}; written: {output}")


def info_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording or case.")],
    *,
    verify: Annotated[bool, option("--verify", "Check every chunk against its checksum.")] = False,
    out: shared.VerboseOut,
) -> int:
    """Show the contents of a file and check its integrity (exit code 3 if it is damaged).

    Example: gyrotrack info case1.h5 --verify
    """
    from gyrotrack.io._contents import inspect_file

    found = inspect_file(file, verify=verify)
    out.result(_document(found))
    out.show("\n".join(_verdict(found) if out.quiet else _verdict(found) + _contents(found)))
    if out.verbose:
        out.show("settings: " + json.dumps(found.provenance["settings"], indent=2))
    return NOT_TRUSTED if found.problems else DONE


def _document(found: Inspection) -> dict[str, Any]:
    document = InspectionDocument(
        file=found.path,
        bytes=found.path.stat().st_size,
        kind=found.kind,
        sound=not found.problems,
        problems=found.problems,
        warnings=found.warnings,
        verified={"datasets": found.datasets_verified, "chunks": found.chunks_verified},
    )
    return {**document, **found.provenance, **found.summary}


def _verdict(found: Inspection) -> list[str]:
    verdict = "sound" if not found.problems else "NOT SOUND"
    size = found.path.stat().st_size / 1e6
    lines = [f"{found.path}: a {found.kind}, {verdict} ({size:.1f} MB)"]
    lines += [f"  problem: {problem}" for problem in found.problems]
    return lines + [f"  warning: {warning}" for warning in found.warnings]


def _contents(found: Inspection) -> list[str]:
    lines = ["", *(_case_lines(found.summary) if found.kind == "case" else _recording_lines(found.summary))]
    version = found.provenance["software_version"]
    lines += ["", f"written by gyrotrack {version}, layout {found.provenance['format_version']}, "]
    lines[-1] += found.provenance["created"]
    lines.append(f"command: {found.provenance['command']}")
    if found.datasets_verified:
        lines.append(f"verified: {found.chunks_verified} chunks of {found.datasets_verified} datasets")
    return lines


def _case_lines(summary: dict[str, Any]) -> list[str]:
    surface = f", on {summary['surface']}" if summary["surface"] else ""
    lines = [
        f"label    {summary['label'] or '-'}{surface}",
        f"inertia  {_inertia(summary)}",
        f"measured {'angles' if summary['quantity'] == 'angle' else 'angular velocities'}",
        *(f"joint    {name} between {' and '.join(bodies)}" for name, bodies in summary["joints"].items()),
        "",
        _header("mrad" if summary["quantity"] == "angle" else "mrad/s"),
        _motion_line(_main_body(summary), summary["casing"]),
    ]
    lines += [_motion_line(name, window) for name, window in _windows(summary)]
    if summary["inputs"]:
        lines += ["", f"{'input':<10}{'samples':>9}{'time [s]':>20}{'value':>20}  unit"]
        lines += [_input_line(name, i) for name, i in summary["inputs"].items()]
    for name, clip in summary["recordings"].items():
        lines += ["", f"clip '{name}'"]
        if "placement" in clip:
            lines.append(_placement_line(clip["placement"]))
        lines += _recording_lines(clip)
    return lines


def _main_body(summary: dict[str, Any]) -> str:
    return "casing" if summary["bodies"] == "two" else summary["body_name"] or "body"


def _input_line(name: str, i: dict[str, Any]) -> str:
    time, value = _span(i["t_start"], i["t_stop"], 3), _span(i["min"], i["max"], 4)
    u = "" if i["median_u"] is None else f", u {i['median_u']:.2g}"
    delay = f", acts {i['delay']:g} s later" if i["delay"] else ""
    return f"{name:<10}{i['samples']:>9}{time:>20}{value:>20}  {i['unit']}{u}, {i['interpolation']}{delay}"


def _inertia(summary: dict[str, Any]) -> str:
    if summary["per_inertia"]:
        return "unknown; torques are per unit of inertia"
    stated = {"rotor": "I_rotor"} if summary["bodies"] == "two" else {}
    stated |= {_main_body(summary): "I_casing"}
    inertias = {name: (summary[key], summary.get(f"{key}_u", math.nan)) for name, key in stated.items()}
    further = summary["further"].items()
    inertias |= {
        n: (b["inertia"], math.nan if b["inertia_u"] is None else b["inertia_u"]) for n, b in further
    }
    return ", ".join(f"{name} {rounded(*inertia, 'kg m2')}" for name, inertia in inertias.items())


def _placement_line(p: dict[str, Any]) -> str:
    if not p["clock_rate_sigma"]:
        return f"clock    {p['method']}"
    doubt = ", AMBIGUOUS" if p["ambiguous"] else ""
    sign = "+" if p["clock_rate"] >= 1 else "-"
    return (
        f"clock    starts at {rounded(p['clock_offset'], p['clock_offset_sigma'], 's')}, "
        f"rate 1 {sign} {abs(p['clock_rate'] - 1):.1e}{doubt}"
    )


def _recording_lines(summary: dict[str, Any]) -> list[str]:
    size = f"{summary['width']} x {summary['height']} px"
    turning = "clockwise" if summary["sense"] < 0 else "counter-clockwise"
    stamped = ", times from the timestamps" if summary["times_from"] == "stamps" else ""
    lines = [
        f"film     {summary['source']}, {size}, {summary['capture_fps']:g} fps{stamped}",
        f"frames   {summary['frames']} in {summary['duration_s']:.3f} s, rotation {turning} in the image",
    ]
    if summary["markers"]:
        lines += ["", f"{'marker':<10}{'body':<10}" + "".join(f"{word:>9}" for word in _WORDS)]
    for name, marker in summary["markers"].items():
        lines.append(f"{name:<10}{marker['body']:<10}" + "".join(f"{marker[w]:>9}" for w in _WORDS.values()))
    lines += ["", _header("mrad")]
    lines += [_motion_line(name, body) for name, body in summary["bodies"].items()]
    return lines


_WORDS = {"ok": "ok", "blurred": "blurred", "occluded": "occluded", "outside": "out_of_frame", "lost": "lost"}


def _header(sigma: str) -> str:
    rate = f"speed [{speed_unit()}]"
    return f"{'':<10}{'samples':>9}{'time [s]':>20}{rate:>20}{f'sigma [{sigma}]':>16}"


def _motion_line(name: str, motion: dict[str, Any]) -> str:
    time = _span(motion["t_start"], motion["t_stop"], 3)
    rate = _speeds(motion)
    sigma = f"{1e3 * motion['median_sigma']:.2f}" if motion["median_sigma"] is not None else "-"
    return f"{name:<10}{motion['samples']:>9}{time:>20}{rate:>20}{sigma:>16}"


def _speeds(motion: dict[str, Any]) -> str:
    """Return the smallest and the largest speed in the unit in which speeds are printed."""
    low, high = (motion[k] if motion[k] is None else speed(motion[k]) for k in ("omega_min", "omega_max"))
    return _span(low, high, 1)


def _span(low: float | None, high: float | None, digits: int) -> str:
    return "-" if low is None or high is None else f"{low:.{digits}f} to {high:.{digits}f}"
