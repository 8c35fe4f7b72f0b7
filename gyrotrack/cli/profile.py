"""`gyrotrack profile`: the markers of a film, found without being told their colours."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrotrack.cli.options import Force, Json, OptionalOutputFile, Quiet
from gyrotrack.cli.output import NOT_TRUSTED, Output

if TYPE_CHECKING:
    from gyrotrack.proposal import Proposal, ProposedMarker


def command(
    video: Annotated[
        Path, typer.Argument(metavar="VIDEO", help="The film; best one that shows all markers.")
    ],
    *,
    output: OptionalOutputFile = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture", metavar="FILE.png", help="Also draw what was chosen into a frame of the film."
        ),
    ] = None,
    capture_fps: Annotated[
        float | None,
        typer.Option("--capture-fps", metavar="N", help="Write the camera's rate into the profile too."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int | None:
    """Find the markers of a film by themselves and write a profile that `extract --profile` reads.

    Looks for colours that turn about a common centre, tells which of them sit on one body, and takes the
    faster body for the rotor. What is in doubt is said; the profile is a text file and can be changed.

    Example: gyrotrack profile rotor_1.mp4 -o mine.toml --picture mine.png
    """
    from gyrotrack.dataset.writing import new_file, refuse_existing
    from gyrotrack.errors import UsageError
    from gyrotrack.profile import to_toml
    from gyrotrack.proposal import propose, write_picture

    out = Output(as_json=as_json, quiet=quiet)
    target = output if output is not None else video.with_suffix(".toml")
    if picture is not None and picture.suffix.lower() != ".png":
        raise UsageError(f"the picture is a PNG (.png), not {picture.name}", "change its ending")
    if capture_fps is not None and not 0 < capture_fps < 1e7:
        raise UsageError(f"a capture rate of {capture_fps:g} fps is not possible", "give a positive number")
    for path in (target, picture):
        if path is not None:
            refuse_existing(path, force=force)
    found = propose(video, capture_fps=capture_fps)
    comment = "".join(f"# {note}\n" for note in (f"found in {video.name} by gyrotrack profile", *found.notes))
    with new_file(target, force=force) as stream:
        stream.write((comment + to_toml(found.profile)).encode())
    if picture is not None:
        write_picture(picture, found, force=force)
    for note in found.notes:
        out.warn(note)
    out.result(_document(target, picture, found))
    out.show(_lines(target, found))
    return None if found.sound else NOT_TRUSTED


def _document(target: Path, picture: Path | None, found: Proposal) -> dict[str, Any]:
    document: dict[str, Any] = {
        "output": target,
        "centre": {"x": found.centre[0], "y": found.centre[1], "from": found.profile.centre},
        "circle_colour": found.profile.circle_colour if found.disc else None,
        "markers": [_marker(m) for m in found.markers],
        "notes": found.notes,
        "verdict": "not_confirmed" if not found.sound else "in_doubt" if found.notes else "clear",
        "profile": found.profile.model_dump(mode="json"),
    }
    if picture is not None:
        document["picture"] = picture
    return document


def _marker(marker: ProposedMarker) -> dict[str, Any]:
    import numpy as np

    paper = marker.paper
    return {
        "name": marker.profile.name,
        "colour": marker.profile.colour,
        "hue_deg": marker.profile.hue,
        "body": marker.profile.body,
        "inner_px": paper.inner,
        "outer_px": paper.outer,
        "half_width_rad": paper.half_width,
        "contrast": float(np.hypot(*paper.contrast)),
        "seen": marker.seen,
        "step_rad": marker.step,
    }


def _lines(target: Path, found: Proposal) -> str:
    x, y = found.centre
    mark = f"a {found.profile.circle_colour} disc" if found.disc else "the markers' orbit"
    lines = [f"centre ({x:.1f}, {y:.1f}) px from {mark}"]
    lines.append(f"{'marker':<16}{'colour':<10}{'body':<8}{'radius [px]':>13}{'contrast':>10}{'seen':>7}")
    for m in map(_marker, found.markers):
        radius = f"{m['inner_px']:.0f} - {m['outer_px']:.0f}"
        lines.append(
            f"{m['name']:<16}{m['colour']:<10}{m['body']:<8}{radius:>13}{m['contrast']:>10.0f}"
            f"{100 * m['seen']:>6.0f}%"
        )
    return "\n".join([*lines, f"written: {target}"])
