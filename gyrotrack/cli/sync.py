"""`gyrotrack sync`: the clips of one experiment on one clock."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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

if TYPE_CHECKING:
    from gyrotrack.sync import Match


def command(
    casing: Annotated[Path, typer.Argument(metavar="CASING.h5", help="The recording of the casing.")],
    rotors: Annotated[list[Path], typer.Argument(metavar="ROTOR.h5...", help="The recordings of the rotor.")],
    *,
    output: OutputFile,
    label: Label = None,
    surface: Surface = "",
    inertia_rotor: InertiaRotor = I_ROTOR,
    inertia_casing: InertiaCasing = I_CASING,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Put the clips of one experiment on one clock, and make a case of them.

    The rotor clips must show the casing too: its angle, seen by both cameras, tells when each clip started.

    Example: gyrotrack sync casing.h5 rotor_1.h5 rotor_2.h5 -o case1.h5 --surface "grey cardstock"
    """
    from gyrotrack.dataset import read_recording, write_case
    from gyrotrack.dataset.writing import refuse_existing
    from gyrotrack.sync import synchronise

    out = Output(as_json=as_json, quiet=quiet, verbose=verbose)
    refuse_existing(output, force=force)
    recordings = [read_recording(path) for path in (casing, *rotors)]
    with out.progress("matching clips") as progress:
        done = synchronise(
            recordings[0],
            recordings[1:],
            [path.name for path in (casing, *rotors)],
            label=label if label is not None else output.stem,
            surface=surface,
            I_rotor=inertia_rotor,
            I_casing=inertia_casing,
            progress=progress,
        )
    settings = {"casing": casing, "rotors": rotors, "I_rotor": inertia_rotor, "I_casing": inertia_casing}
    write_case(output, done.case, command=command_line(), settings=settings, force=force)
    for warning in done.case.warnings:
        out.warn(warning)
    for match in done.matches:
        out.detail(f"{match.name}: {match.method}; the cameras differ by {1e3 * match.misfit:.2f} mrad")
    clips = [_clip(path, match) for path, match in zip(rotors, done.matches, strict=True)]
    out.result({"output": output, "clips": clips, "warnings": done.case.warnings})
    out.show("\n".join([_HEADER, *(_line(clip) for clip in clips), f"written: {output}"]))


def _clip(path: Path, match: Match) -> dict[str, Any]:
    from gyrotrack.sync.start import TURN

    return {
        "source": path,
        "offset_s": match.start.offset,
        "offset_sigma_s": match.offset_sigma,
        "rate": 1 + match.start.eps,
        "rate_sigma": match.rate_sigma,
        "angle_offset": match.start.angle % TURN,
        "angle_offset_sigma": match.angle_sigma,
        "covariance": match.covariance,
        "ambiguous": match.ambiguous,
        "rivals": match.rivals,
        "misfit_rad": match.misfit,
        "outliers": match.rejected,
        "common_rate": match.common_rate,
        "common_direction": match.common_direction,
    }


_HEADER = f"{'clip':<24}{'start [s]':>12}{'+- [ms]':>10}{'rate - 1':>12}{'+-':>10}"


def _line(clip: dict[str, Any]) -> str:
    doubt = "ambiguous" if clip["ambiguous"] else ""
    name = clip["source"].name
    name = name if len(name) < 24 else "..." + name[-20:]
    return (
        f"{name:<24}{clip['offset_s']:>12.5f}{1e3 * clip['offset_sigma_s']:>10.3f}"
        f"{clip['rate'] - 1:>12.2e}{clip['rate_sigma']:>10.1e}  {doubt}"
    ).rstrip()
