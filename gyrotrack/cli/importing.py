"""`gyrotrack import`: a case from tables of angles or speeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from gyrotrack.cli.command_line import command_line
from gyrotrack.cli.options import (
    I_CASING,
    I_ROTOR,
    Force,
    InertiaCasing,
    InertiaRotor,
    Json,
    Label,
    OutputFile,
    Quiet,
    Surface,
    Verbose,
)
from gyrotrack.cli.output import Output
from gyrotrack.errors import UsageError

_TABLE = "Table with a header, t,angle[,sigma] or t,omega[,sigma], or points"


def command(
    *,
    casing: Annotated[Path | None, typer.Option("--casing", metavar="CSV", help=f"{_TABLE}.")] = None,
    rotor: Annotated[
        list[Path] | None, typer.Option("--rotor", metavar="CSV", help="The same; give it once per window.")
    ] = None,
    body: Annotated[
        Path | None,
        typer.Option("--body", metavar="CSV", help="One body that spins down by itself, in place of both."),
    ] = None,
    inertia: Annotated[
        float | None, typer.Option("--inertia", metavar="X", help="Its moment of inertia [kg m2].")
    ] = None,
    output: OutputFile,
    columns: Annotated[
        list[str] | None,
        typer.Option(
            "--column", metavar="OURS=THEIRS", help="What a column means: t=Zeit, 'angle=phi [deg]'."
        ),
    ] = None,
    marker: Annotated[
        str | None, typer.Option("--marker", metavar="NAME", help="The point to follow, in files of points.")
    ] = None,
    centre: Annotated[
        str | None,
        typer.Option(
            "--centre", metavar="C", help="What it goes about: a point, a place as 320,240, or orbit."
        ),
    ] = None,
    likelihood: Annotated[
        float,
        typer.Option("--likelihood", metavar="P", help="Leave out points that are less sure than this."),
    ] = 0.6,
    casing_fps: Annotated[
        float | None,
        typer.Option("--casing-fps", metavar="N", help="Rate of points that are counted by frame."),
    ] = None,
    rotor_fps: Annotated[
        float | None, typer.Option("--rotor-fps", metavar="N", help="The same of the rotor's.")
    ] = None,
    rotor_start: Annotated[
        list[float] | None,
        typer.Option(
            "--rotor-start", metavar="T", help="When a rotor file of points starts [s]; once per file."
        ),
    ] = None,
    label: Label = None,
    surface: Surface = "",
    inertia_rotor: InertiaRotor = I_ROTOR,
    inertia_casing: InertiaCasing = I_CASING,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make a case from tables of angles or speeds (CSV), or from points that another program followed.

    Times in s, all on one clock; angles in rad, wrapped or not. Other units are taken if the header names
    them, as in `angle [deg]`. Without a sigma column the noise is estimated from the scatter. Points are
    read from OSP Tracker (text), DeepLabCut and SLEAP (CSV or HDF5). With --body the case is a plain
    spin-down: the body stands in the casing's place, and the effects that need a rotor are left out.

    Example: gyrotrack import --casing casing.csv --rotor r1.csv --rotor r2.csv -o case1.h5
    """
    from gyrotrack.dataset import write_case
    from gyrotrack.dataset.writing import refuse_existing
    from gyrotrack.importing import Wanted, import_body, import_case, read_names, summary

    out = Output(as_json=as_json, quiet=quiet, verbose=verbose)
    refuse_existing(output, force=force)
    rotor = rotor or []
    starts = rotor_start or [0.0] * len(rotor)
    if len(starts) != len(rotor):
        raise UsageError(
            f"There are {len(rotor)} files of the rotor but {len(starts)} starts.",
            "Give --rotor-start once per file.",
        )
    points = [Wanted(marker, centre, casing_fps, 0.0, likelihood)]
    points += [Wanted(marker, centre, rotor_fps, start, likelihood) for start in starts]
    names, title = read_names(columns or ()), output.stem if label is None else label
    if body is not None and inertia is not None and casing is None and not rotor:
        case = import_body(body, inertia, label=title, surface=surface, names=names, wanted=points[0])
    elif casing is not None and body is None and inertia is None:
        case = import_case(
            casing,
            rotor,
            label=title,
            surface=surface,
            I_rotor=inertia_rotor,
            I_casing=inertia_casing,
            names=names,
            wanted=points,
        )
    else:
        raise UsageError(
            "A case is made of --casing and --rotor, or of --body and --inertia.", "Give one of these pairs."
        )
    settings = {"casing": casing, "rotor": rotor, "body": body, "inertia": inertia, **case.extra}
    write_case(output, case, command=command_line(), settings=settings, force=force)
    for warning in case.warnings:
        out.warn(warning)
    for source in case.extra["sources"]:
        out.detail(f"{source['file']}: {source['samples']} samples taken")
    document = {"output": output, **summary(case)}
    out.result(document)
    out.show(_lines(document))


def _lines(document: dict[str, Any]) -> str:
    casing, windows = document["casing"], document["rotor"]["windows"]
    unit = "rad" if casing["quantity"] == "angle" else "rad/s"
    heading = f"sigma [{unit}]"
    lines = [f"{'':<10}{'samples':>9}{'time [s]':>22}{'speed [rad/s]':>20}{heading:>16}"]
    lines.append(_line("casing" if windows else "body", casing))
    lines += [_line(f"rotor {window['window']}", window) for window in windows]
    return "\n".join([*lines, f"written: {document['output']}"])


def _line(name: str, part: dict[str, Any]) -> str:
    time = f"{part['t_start']:.3f} to {part['t_stop']:.3f}"
    known = part["omega_min"] is not None
    speed = f"{part['omega_min']:.1f} to {part['omega_max']:.1f}" if known else "-"
    return f"{name:<10}{part['samples']:>9}{time:>22}{speed:>20}{part['median_sigma']:>16.2g}"
