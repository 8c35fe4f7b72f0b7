"""The command spindown: one body, one command."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from gyrotrack._errors import UsageError
from gyrotrack.apps.cli._options import Force, Json, Quiet
from gyrotrack.apps.cli._output import DONE, NOT_TRUSTED, Output, command_line


class Body(StrEnum):
    """Body to analyse."""

    casing = "casing"
    rotor = "rotor"


def spindown_command(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="Film, recording, or a table that `import` reads.")
    ],
    *,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Case to write; SOURCE.h5 if not given."),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", metavar="FILE", help="Report to write; beside the case if not given."),
    ] = None,
    hub: Annotated[
        str | None,
        typer.Option("--hub", metavar="X,Y", help="Centre of rotation [px]; it may be outside the picture."),
    ] = None,
    profile: Annotated[
        Path | None,
        typer.Option(
            "--profile", metavar="P", help="Markers and colours of the film; found by itself if not given."
        ),
    ] = None,
    body: Annotated[
        Body | None, typer.Option("--body", help="The body to analyse where the film or recording shows two.")
    ] = None,
    capture_fps: Annotated[
        float | None, typer.Option("--capture-fps", metavar="N", help="Frames per second of the camera.")
    ] = None,
    inertia: Annotated[
        str | None,
        typer.Option("--inertia", metavar="X", help='Moment of inertia [kg m2], such as "5.5e-5 +- 0.1e-5".'),
    ] = None,
    pulses_per_turn: Annotated[
        float | None,
        typer.Option("--pulses-per-turn", metavar="N", help="SOURCE is a column of times of pulses [s]."),
    ] = None,
    keep_all: Annotated[
        bool, typer.Option("--keep-all", help="Keep the start, in which a hand or a motor drives the body.")
    ] = False,
    label: Annotated[
        str, typer.Option("--label", metavar="L", help="Name of the case; the file's if not given.")
    ] = "",
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Measure one rotating body: film or table to motion, torque law and report.

    A film needs no marker: whatever turns about one hub is registered against its own mean picture. Without
    --inertia torques are per unit of inertia.

    Example: gyrotrack spindown wheel.mp4 --capture-fps 300
    """
    from gyrotrack.apps._spindown import Wish, spindown
    from gyrotrack.io._atomic import refuse_existing

    out = Output(as_json=as_json, quiet=quiet)
    target = output if output is not None else Path(source.with_suffix(".h5").name)
    if target.resolve() == source.resolve():
        target = target.with_name(f"{target.stem}_case.h5")
    page = report if report is not None else target.with_suffix(".html")
    for path in (target, page):
        refuse_existing(path, force=force)
    wish = Wish(
        _place(hub),
        capture_fps,
        inertia,
        pulses_per_turn,
        keep_all,
        label,
        profile,
        body.value if body else None,
    )
    with out.progress(f"tracking {source.name}", "frames") as progress:
        document = spindown(
            source, target, page, wish, command=command_line(), force=force, progress=progress
        )
    for warning in document["warnings"]:
        out.warn(warning)
    out.result(document)
    out.show(*_lines(document))
    verdict = (document["diagnosis"] or {}).get("verdict")
    if document["diagnosis"] is None:
        return NOT_TRUSTED if document["motion"].kind == "spin-down" else DONE
    return NOT_TRUSTED if verdict == "unexplained" else DONE


def _place(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(
            f"--hub {text[:40]!r} is not a place.", "Give two numbers in px, such as 320,240."
        ) from error
    return x, y


def _lines(document: dict[str, Any]) -> list[str]:
    motion = document["motion"]
    lines = [f"{motion.kind}, {motion.turns:.3f} turns"]
    if motion.kind == "oscillation":
        lines.append(f"period     {motion.period.value:.6g} +- {motion.period.stderr:.2g} s")
        lines.append(f"amplitude  {motion.amplitude.value:.6g} +- {motion.amplitude.stderr:.2g} rad")
        lines.append(f"decay      {motion.decay.value:.4g} +- {motion.decay.stderr:.2g} 1/s")
        if motion.quality_factor is not None:
            lines.append(
                f"Q          {motion.quality_factor.value:.4g} +- {motion.quality_factor.stderr:.2g}"
            )
    else:
        lines.append(f"omega      {motion.omega['first']:.6g} to {motion.omega['last']:.6g} rad/s")
        lines.append(f"mean       {motion.omega_mean.value:.6g} +- {motion.omega_mean.stderr:.2g} rad/s")
        lines.append(f"alpha      {motion.alpha.value:.4g} +- {motion.alpha.stderr:.2g} rad/s2")
    if document["diagnosis"] is not None:
        lines.append(document["diagnosis"]["sentence"])
    written = [str(document[key]) for key in ("case", "report", "picture") if document[key] is not None]
    return ["\n".join([*lines, f"written: {', '.join(written)}"])]
