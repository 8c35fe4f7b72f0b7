"""`gyrotrack extract`: from a film to the angles of the bodies in it."""

from __future__ import annotations

from enum import StrEnum
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrotrack.cli.command_line import command_line
from gyrotrack.cli.options import Force, Json, OptionalOutputFile, Quiet
from gyrotrack.cli.output import Output

if TYPE_CHECKING:
    from gyrotrack.dataset.records import Recording
    from gyrotrack.pipeline.task import Task


class Body(StrEnum):
    """Which body to track."""

    casing = "casing"
    rotor = "rotor"
    both = "both"


class Times(StrEnum):
    """Where the times of the frames are from."""

    auto = "auto"
    stamps = "stamps"
    frames = "frames"


def command(
    video: Annotated[Path, typer.Argument(metavar="VIDEO", help="The film.")],
    *,
    output: OptionalOutputFile = None,
    capture_fps: Annotated[
        float | None,
        typer.Option("--capture-fps", metavar="N", help="Frames per second of the camera (slow motion)."),
    ] = None,
    times: Annotated[
        Times,
        typer.Option(
            "--times",
            help="Count frames, or take the time stamps; auto: these where the camera's rate varied.",
        ),
    ] = Times.auto,
    profile: Annotated[
        Path | None,
        typer.Option("--profile", metavar="P.toml", help="Markers and colours; the paper's, if not given."),
    ] = None,
    body: Annotated[
        Body | None, typer.Option("--body", help="Track only this body; all that are seen, if not given.")
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option(
            "--overlay", metavar="FILE", help="Also draw what was found: a film (.mp4) or a sheet (.png)."
        ),
    ] = None,
    contact_sheet: Annotated[
        Path | None,
        typer.Option(
            "--contact-sheet",
            metavar="FILE.png",
            help="Also draw twelve frames with corners, angle, status, sigma.",
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a run that was killed; start, if there is none.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Track the markers in a film and write the angles of casing and rotor, with uncertainties.

    What is measured on the way is kept beside the output (OUT.h5.unfinished) until that is written.

    Example: gyrotrack extract rotor_1.mp4 --capture-fps 1000 -o rotor_1.h5
    """
    from gyrotrack.dataset.writing import refuse_existing
    from gyrotrack.pipeline.contact_sheet import check_contact_sheet, write_contact_sheet
    from gyrotrack.pipeline.overlay import check_overlay, write_overlay
    from gyrotrack.pipeline.task import Task
    from gyrotrack.profile import PAPER, load

    out = Output(as_json=as_json, quiet=quiet)
    target = output if output is not None else video.with_suffix(".h5")
    chosen = load(profile) if profile is not None else PAPER
    task = Task(video, target, chosen, capture_fps, body.value if body else None, times.value)
    done = task.earlier() if resume and not force else None
    if done is None:
        refuse_existing(target, force=force)
    if overlay is not None:
        check_overlay(overlay, force=force)
    if contact_sheet is not None:
        check_contact_sheet(contact_sheet, force=force)
    recording, fps = _tracked(task, done, out, resume=resume, force=force)
    for warning in recording.warnings:
        out.warn(warning)
    document = _document(target, recording, fps)
    if overlay is not None:
        with out.progress(f"drawing {overlay.name}", "frames") as progress:
            write_overlay(overlay, video, recording, force=force, progress=progress)
        document["overlay"] = overlay
    if contact_sheet is not None:
        write_contact_sheet(contact_sheet, video, recording, force=force)
        document["contact_sheet"] = contact_sheet
    out.result(document)
    out.show(_lines(document))


def _tracked(
    task: Task, done: Recording | None, out: Output, *, resume: bool, force: bool
) -> tuple[Recording, float]:
    """Return the recording, tracked now unless that is done, and the frames tracked in a second."""
    if done is not None:
        out.note(f"{task.target} is complete already")
        return done, float("nan")
    return task.run(
        command=command_line(),
        bar=lambda: out.progress(f"tracking {task.video.name}", "frames"),
        tell=out.note,
        resume=resume,
        force=force,
    )


def _document(target: Path, recording: Recording, fps: float) -> dict[str, Any]:
    import numpy as np

    from gyrotrack.dataset.records import STATUS

    return {
        "output": target,
        "frames": recording.frames_decoded,
        "markers": {
            name: {word: int(np.sum(track.status == code)) for word, code in STATUS.items()}
            for name, track in recording.markers.items()
        },
        "body": {
            name: {"samples": len(track.time), "median_sigma": float(np.median(track.sigma))}
            for name, track in recording.bodies.items()
        },
        "sense": recording.sense,
        "capture_fps": recording.capture_fps,
        "capture_fps_from": recording.extra.get("capture_rate_from", ""),
        "times_from": recording.extra.get("times_from", "frames"),
        "frames_declared": recording.frames_declared,
        "fps": fps,
        "warnings": list(recording.warnings),
    }


def _lines(document: dict[str, Any]) -> str:
    words = ("ok", "blurred", "occluded", "out_of_frame", "lost")
    lines = [f"{'marker':<12}" + "".join(f"{word.replace('_', ' '):>14}" for word in words)]
    lines += [
        f"{name:<12}" + "".join(f"{counts[word]:>14}" for word in words)
        for name, counts in document["markers"].items()
    ]
    lines += [
        f"{name}: {part['samples']} angles, median uncertainty {1e3 * part['median_sigma']:.2g} mrad"
        for name, part in document["body"].items()
    ]
    pace = f" at {document['fps']:.0f} frames/s" if isfinite(document["fps"]) else ""
    source = {"asked for": "as asked for", "profile": "by the profile"}.get(
        document["capture_fps_from"], f"by the {document['capture_fps_from']}"
    )
    stamped = "; times from the time stamps" if document["times_from"] == "stamps" else ""
    lines.append(f"captured at {document['capture_fps']:g} fps, {source}{stamped}")
    lines.append(f"{document['frames']} frames{pace}; written: {document['output']}")
    return "\n".join(lines)
