"""`gyrotrack extract`: from a film to the angles of the bodies in it."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrotrack.cli.command_line import command_line
from gyrotrack.cli.options import Force, Json, OptionalOutputFile, Quiet
from gyrotrack.cli.output import Output

if TYPE_CHECKING:
    from gyrotrack.dataset.records import Recording


class Body(StrEnum):
    """Which body to track."""

    casing = "casing"
    rotor = "rotor"
    both = "both"


def command(
    video: Annotated[Path, typer.Argument(metavar="VIDEO", help="The film.")],
    *,
    output: OptionalOutputFile = None,
    capture_fps: Annotated[
        float | None,
        typer.Option("--capture-fps", metavar="N", help="Frames per second of the camera (slow motion)."),
    ] = None,
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
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Track the markers in a film and write the angles of casing and rotor, with uncertainties.

    Example: gyrotrack extract rotor_1.mp4 --capture-fps 1000 -o rotor_1.h5
    """
    from gyrotrack import pipeline
    from gyrotrack.dataset import write_recording
    from gyrotrack.dataset.writing import refuse_existing
    from gyrotrack.pipeline.overlay import check_overlay, write_overlay
    from gyrotrack.profile import PAPER, load

    out = Output(as_json=as_json, quiet=quiet)
    target = output if output is not None else video.with_suffix(".h5")
    refuse_existing(target, force=force)
    if overlay is not None:
        check_overlay(overlay, force=force)
    chosen = load(profile) if profile is not None else PAPER
    with out.progress(f"tracking {video.name}") as progress:
        start = perf_counter()
        recording = pipeline.extract(
            video, chosen, capture_fps=capture_fps, body=body.value if body else None, progress=progress
        )
        elapsed = perf_counter() - start
    settings = {
        "video": video, "capture_fps": capture_fps, "body": body, "profile": chosen.model_dump(mode="json"),
    }  # fmt: skip
    write_recording(target, recording, command=command_line(), settings=settings, force=force)
    if overlay is not None:
        with out.progress(f"drawing {overlay.name}") as progress:
            write_overlay(overlay, video, recording, force=force, progress=progress)
    for warning in recording.warnings:
        out.warn(warning)
    document = _document(target, recording, elapsed)
    if overlay is not None:
        document["overlay"] = overlay
    out.result(document)
    out.show(_lines(document))


def _document(target: Path, recording: Recording, elapsed: float) -> dict[str, Any]:
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
        "fps": recording.frames_decoded / max(elapsed, 1e-9),
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
    lines.append(
        f"{document['frames']} frames at {document['fps']:.0f} frames/s; written: {document['output']}"
    )
    return "\n".join(lines)
