"""Commands profile, extract, sync and spindown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NotRequired, TypedDict

import typer

from fitting._numbers import rounded, speed, speed_unit
from gyrotrack._errors import TrackingError, UsageError
from gyrotrack.apps._study import checked_body_name
from gyrotrack.apps.cli import _settings as shared
from gyrotrack.apps.cli._output import DONE, NOT_TRUSTED, Output, command_line
from gyrotrack.apps.cli._settings import option

if TYPE_CHECKING:
    from gyrotrack.apps._drive import Response
    from gyrotrack.apps._spindown import SpindownOptions
    from gyrotrack.io._contents import MarkerCounts
    from gyrotrack.io._records import Floats, Recording
    from gyrotrack.synchronisation._decision import Match, Rival
    from gyrotrack.tracking._film import Film
    from gyrotrack.tracking._profile import Profile
    from gyrotrack.tracking._proposal import Proposal, ProposedMarker
    from gyrotrack.tracking._tracked import Tracked


class BodyReading(TypedDict):
    """A rotating body whose texture can be tracked without markers."""

    kind: str  #: Kind of the reading: `picture of a body`.
    hub_px: list[float]  #: Centre of rotation, x and y [px].
    #: Method by which the centre was found; `outline` for a body that moves across the picture.
    hub_from: str
    ring_px: list[float]  #: Inner and outer radius of the texture [px].
    explained: float  #: Share of the change of brightness that the rotation explains, 0 to 1 [1].


_From = TypedDict("_From", {"from": Annotated[str, "Mark at the centre: `circle` or `orbit`."]})


class CentreDocument(_From):
    """The centre of rotation in the picture."""

    x: float  #: Distance from the left edge [px].
    y: float  #: Distance from the upper edge [px].


class FoundMarker(TypedDict):
    """A marker that was found in the film."""

    name: str  #: Name in the profile.
    colour: str  #: Colour.
    hue_deg: float | None  #: Hue; null for a colour without a hue [degrees].
    body: str  #: `casing` or `rotor`.
    inner_px: float  #: Inner radius of its orbit [px].
    outer_px: float  #: Outer radius of its orbit [px].
    half_width_rad: float  #: Half of its angular width [rad].
    contrast: float  #: Contrast of its colour with its surroundings [levels of brightness].
    seen: float  #: Share of the frames in which the marker is seen, 0 to 1 [1].
    step_rad: float  #: Rotation of the marker per frame [rad].


class ProfileDocument(TypedDict):
    """A new profile, and the markers on which it is based."""

    output: Path  #: The profile.
    centre: CentreDocument  #: Centre of rotation.
    circle_colour: str | None  #: Colour of the disc at the centre; null without a disc.
    markers: list[FoundMarker]  #: Markers.
    notes: Sequence[str]  #: Doubts about the markers, as sentences.
    verdict: str  #: Verdict: `clear`, `in_doubt` or `not_confirmed`.
    profile: Profile  #: Contents of the profile.
    picture: NotRequired[Path]  #: The drawing, with `--picture`.
    #: Alternative interpretation, if the markers show one body only.
    readings: NotRequired[list[BodyReading]]


class NoMarkersDocument(TypedDict):
    """A body that rotates in a film without markers."""

    output: None  #: No profile is written.
    picture: Path | None  #: The drawing, with `--picture`.
    verdict: str  #: Verdict: `no_markers`.
    readings: list[BodyReading]  #: The rotating body.


def profile_command(
    video: Annotated[Path, typer.Argument(metavar="VIDEO", help="Film that shows all markers.")],
    *,
    output: shared.OptionalOutputFile = None,
    picture: Annotated[
        Path | None,
        option("--picture FILE.png", "Also draw a frame of the film with the markers that were found."),
    ] = None,
    capture_fps: Annotated[
        float | None, option("--capture-fps N", "Capture rate of the camera, for the profile [1/s].")
    ] = None,
    hub: shared.Hub = None,
    force: shared.Force = False,
    out: shared.Out,
) -> int | None:
    """Find the markers of a film and write a profile that `extract --profile` reads.

    Finds coloured regions that rotate about a common centre and groups them by body; the faster body is the rotor.
    Uncertain results are reported. The profile is a text file and can be edited. If no markers, or only markers of one
    body, are found, the texture of a rotating body is shown as an alternative interpretation; `spindown` measures such
    a body.

    Example: gyrotrack profile rotor_1.mp4 -o mine.toml --picture mine.png
    """
    from gyrotrack.io._atomic import new_file
    from gyrotrack.io._outputs import new_outputs
    from gyrotrack.plotting._frames import write_body_picture, write_picture
    from gyrotrack.tracking._any_body import read_excerpt
    from gyrotrack.tracking._profile import to_toml
    from gyrotrack.tracking._proposal import propose

    target = output if output is not None else video.with_suffix(".toml")
    if picture is not None and picture.suffix.lower() != ".png":
        raise UsageError(f"Unknown picture format: {picture.name}.", "Use a name that ends in .png.")
    if capture_fps is not None and not 0 < capture_fps < 1e7:
        raise UsageError(f"Invalid capture rate: {capture_fps:g} fps.", "Give a positive number.")
    place = _position(hub)
    reads = [video]
    with new_outputs(target, picture, force=force, reads=reads):
        pass
    body: tuple[Film, Tracked] | None = None
    try:
        found = propose(video, capture_fps=capture_fps, hub=place)
    except TrackingError:
        with out.progress(f"searching for a body in {video.name}", "frames") as progress:
            body = read_excerpt(video, place, progress)
        if body is None:
            raise
        if picture is not None:
            write_body_picture(picture, *body, force=force)
        reading = _body_reading(body[1])
        out.result(NoMarkersDocument(output=None, picture=picture, verdict="no_markers", readings=[reading]))
        out.show(f"No coloured markers were found. {_body_sentence(reading, video)}")
        return NOT_TRUSTED
    if len({m.profile.body for m in found.markers}) == 1:
        with out.progress(f"searching for a body in {video.name}", "frames") as progress:
            body = read_excerpt(video, place, progress)
    comment = "".join(f"# {note}\n" for note in (f"found in {video.name} by gyrotrack profile", *found.notes))
    with new_outputs(target, picture, force=force, reads=reads):
        # the larger file is written first: if this fails, an old profile is preserved
        if picture is not None:
            write_picture(picture, found, body=body, force=force)
        with new_file(target, force=force) as stream:
            stream.write((comment + to_toml(found.profile)).encode("utf-8", "replace"))
    for note in found.notes:
        out.warn(note)
    document = _profile_document(target, picture, found)
    lines = [_profile_lines(target, found)]
    if body is not None:
        document["readings"] = [_body_reading(body[1])]
        lines.append(f"Alternative interpretation: {_body_sentence(document['readings'][0], video)}")
    out.result(document)
    out.show(*lines)
    return None if found.sound else NOT_TRUSTED


def _body_reading(tracked: Tracked) -> BodyReading:
    return {
        "kind": "picture of a body",
        "hub_px": list(tracked.ring.hub),
        "hub_from": tracked.way,
        "ring_px": [tracked.ring.inner, tracked.ring.outer],
        "explained": tracked.explained,
    }


def _body_sentence(reading: BodyReading, video: Path) -> str:
    x, y = reading["hub_px"]
    where = (
        f"A body turns while it moves across the picture, near ({x:.0f}, {y:.0f}) px"
        if reading["hub_from"] == "outline"
        else f"One body turns about ({x:.1f}, {y:.1f}) px"
    )
    return (
        f"{where}; tracking quality {100 * reading['explained']:.0f} %.\n"
        f"`gyrotrack spindown {video.name}` measures it without markers."
    )


def _profile_document(target: Path, picture: Path | None, found: Proposal) -> ProfileDocument:
    document: ProfileDocument = {
        "output": target,
        "centre": {"x": found.centre[0], "y": found.centre[1], "from": found.profile.centre},
        "circle_colour": found.profile.circle_colour if found.disc else None,
        "markers": [_marker(m) for m in found.markers],
        "notes": found.notes,
        "verdict": "not_confirmed" if not found.sound else "in_doubt" if found.notes else "clear",
        "profile": found.profile,
    }
    if picture is not None:
        document["picture"] = picture
    return document


def _marker(marker: ProposedMarker) -> FoundMarker:
    import numpy as np

    entry, found = marker.profile, marker.marker
    return {
        "name": entry.name,
        "colour": entry.colour,
        "hue_deg": entry.hue,
        "body": entry.body,
        "inner_px": found.inner,
        "outer_px": found.outer,
        "half_width_rad": found.half_width,
        "contrast": float(np.hypot(*found.contrast)),
        "seen": marker.seen,
        "step_rad": marker.step,
    }


def _profile_lines(target: Path, found: Proposal) -> str:
    x, y = found.centre
    mark = f"a {found.profile.circle_colour} disc" if found.disc else "the markers' orbit"
    lines = [f"centre ({x:.1f}, {y:.1f}) px from {mark if found.profile.hub is None else '--hub'}"]
    lines.append(f"{'marker':<16}{'colour':<10}{'body':<8}{'radius [px]':>13}{'contrast':>10}{'seen':>7}")
    for m in map(_marker, found.markers):
        radius = f"{m['inner_px']:.0f} - {m['outer_px']:.0f}"
        lines.append(
            f"{m['name']:<16}{m['colour']:<10}{m['body']:<8}{radius:>13}{m['contrast']:>10.0f}"
            f"{100 * m['seen']:>6.0f}%"
        )
    return "\n".join([*lines, f"written: {target}"])


class Body(StrEnum):
    """Body to track."""

    casing = "casing"
    rotor = "rotor"
    both = "both"


class Times(StrEnum):
    """Origin of the times of the frames."""

    auto = "auto"
    stamps = "stamps"
    frames = "frames"


class TrackedBody(TypedDict):
    """The angles of one body."""

    samples: int  #: Number of angles.
    median_sigma: float  #: Median standard uncertainty of the angle [rad].


class TrackedPath(TypedDict):
    """The path of one point."""

    samples: int  #: Number of positions.
    median_sigma_px: float  #: Median standard uncertainty of x and y [px].


class ExtractionDocument(TypedDict):
    """A new recording."""

    output: Path  #: The recording.
    frames: int  #: Number of decoded frames.
    markers: dict[str, MarkerCounts]  #: Number of frames by status, by marker.
    body: dict[str, TrackedBody]  #: Angles, by body.
    sense: int  #: Factor applied to angles in the image: 1 or -1.
    capture_fps: float  #: Capture rate of the camera [s-1].
    capture_fps_from: str  #: Origin of the capture rate.
    times_from: str  #: Origin of the times: `frames` or `stamps`.
    frames_declared: int  #: Number of frames that the film declares.
    fps: float  #: Frames that were processed per second; null for points and for a complete output [s-1].
    warnings: list[str]  #: Warnings.
    overlay: NotRequired[Path]  #: The drawn film, with `--overlay`.
    contact_sheet: NotRequired[Path]  #: The drawn frames, with `--contact-sheet`.
    points: NotRequired[dict[str, TrackedPath]]  #: Paths by point, with `--point` or `--colour`.


def extract_command(
    video: Annotated[Path, typer.Argument(metavar="VIDEO", help="Film.")],
    *,
    output: shared.OptionalOutputFile = None,
    capture_fps: Annotated[
        float | None, option("--capture-fps N", "Capture rate of the camera [1/s].")
    ] = None,
    times: Annotated[
        Times,
        option(
            "--times",
            "frames: from the frame number; stamps: from the timestamps; auto: timestamps if the rate "
            "varied.",
        ),
    ] = Times.auto,
    profile: Annotated[
        Path | None, option("--profile P.toml", "Markers and colours; by default those of the paper.")
    ] = None,
    body: Annotated[Body | None, option("--body", "Track this body only; by default all bodies.")] = None,
    points: Annotated[
        list[str] | None,
        option(
            "--point --points X,Y",
            "Follow points instead of markers, by their positions in the first frame [px]; repeat the option, or give "
            "several positions in quotes.",
        ),
    ] = None,
    links: Annotated[
        bool,
        option(
            "--links",
            "The two --points are the joint of two links (double pendulum) and a point of the second link: measure "
            "the angles of both links.",
        ),
    ] = False,
    colour: shared.PointColour = None,
    hub: shared.Hub = None,
    scale: shared.PixelScale = None,
    overlay: Annotated[
        Path | None,
        option("--overlay FILE", "Also draw the detections: film (.mp4) or contact sheet (.png)."),
    ] = None,
    contact_sheet: Annotated[
        Path | None,
        option(
            "--contact-sheet FILE.png", "Also draw twelve frames with corners, angle, status and uncertainty."
        ),
    ] = None,
    workers: Annotated[
        int | None,
        option(
            "--workers N",
            "Number of processes; by default one per core. The result does not depend on this number.",
            min=1,
        ),
    ] = None,
    resume: Annotated[
        bool,
        option(
            "--resume",
            "Use the frames tracked by an interrupted run, or a complete output, even with --force.",
        ),
    ] = False,
    force: shared.Force = False,
    out: shared.Out,
) -> int:
    """Track the markers in a film and write the angles of casing and rotor, with uncertainties.

    A checkpoint (OUT.h5.unfinished) is kept until the output is written; the same command continues from it. With
    --point or --colour, points are followed: `gyrotrack export OUT.h5 --table points` gives their paths.

    Example: gyrotrack extract rotor_1.mp4 --capture-fps 1000 -o rotor_1.h5
    """
    from gyrotrack.io._atomic import is_left, mark_new, refuse_existing
    from gyrotrack.io._records import doubts_of
    from gyrotrack.plotting._frames import (
        check_contact_sheet,
        check_overlay,
        write_contact_sheet,
        write_overlay,
    )
    from gyrotrack.tracking._extract import ExtractionJob
    from gyrotrack.tracking._profile import PAPER, load

    target = output if output is not None else video.with_suffix(".h5")
    if points or colour is not None:
        from gyrotrack.apps._spindown import SpindownOptions

        if profile is not None or body is not None or overlay is not None or contact_sheet is not None:
            what = "--profile, --body, --overlay and --contact-sheet apply to markers, not to points."
            raise UsageError(what, "Omit these options, or omit --point and --colour.")
        options = SpindownOptions(
            hub=_position(hub),
            capture_fps=capture_fps,
            colour=None if colour is None else colour.value,
            scale=shared.checked_scale(scale),
        )
        return _extract_points(out, video, target, points or [], options, links=links, force=force)
    if links:
        raise UsageError("--links applies to points.", "Give the two points with --points X,Y --points X,Y.")
    if hub is not None or scale is not None:
        raise UsageError("--hub and --scale apply to points.", "Select a point with --point X,Y or --colour.")
    chosen = load(profile) if profile is not None else PAPER
    task = ExtractionJob(
        video, target, chosen, capture_fps, body.value if body else None, times.value, workers
    )
    left = is_left(target) and not force
    done = task.earlier() if (resume and not force) or left else None
    for path, replace in ((target, force or done is not None), (overlay, force), (contact_sheet, force)):
        if path is not None:
            refuse_existing(path, force=replace, reads=[video, profile])
    if overlay is not None:
        check_overlay(overlay, force=force)
    if contact_sheet is not None:
        check_contact_sheet(contact_sheet, force=force)
    recording, fps = done, math.nan
    if recording is None:
        bar = partial(out.progress, f"tracking {video.name}", "frames")
        recording, fps = task.run(
            command=command_line(), bar=bar, tell=out.note, resume=resume or not force, force=force
        )
    else:
        if left:
            mark_new(target, target)
        out.note(f"{target} is already complete.")
    for warning in recording.warnings:
        out.warn(warning)
    document = _extraction_document(target, recording, fps)
    try:
        if overlay is not None:
            with out.progress(f"drawing {overlay.name}", "frames") as progress:
                write_overlay(overlay, video, recording, force=force, progress=progress)
            document["overlay"] = overlay
        if contact_sheet is not None:
            write_contact_sheet(contact_sheet, video, recording, force=force)
            document["contact_sheet"] = contact_sheet
    except KeyboardInterrupt:
        out.note(f"{target} is complete; run the command again with --resume to write the pictures.")
        raise
    out.result(document)
    out.show(_extraction_lines(document))
    return NOT_TRUSTED if doubts_of(recording) else DONE


def _extract_points(
    out: Output,
    video: Path,
    target: Path,
    points: Sequence[str],
    options: SpindownOptions,
    *,
    links: bool,
    force: bool,
) -> int:
    """Follow points of a film and write their paths and angles."""
    import numpy as np

    from gyrotrack.apps._points import read_point
    from gyrotrack.apps._spindown import links_recording, points_recording
    from gyrotrack.io._atomic import refuse_existing
    from gyrotrack.io._hdf5 import write_recording
    from gyrotrack.io._records import doubts_of
    from gyrotrack.tracking._film import Film

    refuse_existing(target, force=force, reads=[video])
    starts = [read_point(word) for text in points for word in text.replace(";", " ").split()]
    with out.progress(f"following points in {video.name}", "frames") as progress:
        film = Film(video, colour=options.colour)
        if links:
            recording = links_recording(film, starts, options, progress)
        else:
            recording = points_recording(film, starts or [None], options, progress)
    stated = {name: getattr(options, name) for name in ("colour", "hub", "capture_fps")}
    settings = {"video": video, "points": starts, **stated}
    write_recording(target, recording, command=command_line(), settings=settings, force=force)
    for warning in recording.warnings:
        out.warn(warning)
    document = _extraction_document(target, recording, math.nan)
    document["points"] = {
        p.name: {"samples": len(p.time), "median_sigma_px": float(np.median([p.sigma_x, p.sigma_y]))}
        for p in recording.points.values()
    }
    out.result(document)
    lines = [
        f"{name}: {part['samples']} positions, median uncertainty {part['median_sigma_px']:.2g} px"
        for name, part in document["points"].items()
    ]
    out.show("\n".join([*lines, *_extraction_lines(document).splitlines()[1:]]))
    return NOT_TRUSTED if doubts_of(recording) else DONE


def _extraction_document(target: Path, recording: Recording, fps: float) -> ExtractionDocument:
    import numpy as np

    from gyrotrack.io._contents import marker_counts

    return {
        "output": target,
        "frames": recording.frames_decoded,
        "markers": {name: marker_counts(track.status) for name, track in recording.markers.items()},
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


def _extraction_lines(document: Mapping[str, Any]) -> str:
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
    rate = f" at {document['fps']:.0f} frames/s" if math.isfinite(document["fps"]) else ""
    source = document["capture_fps_from"].replace("asked for", "--capture-fps")
    stamped = "; times from the timestamps" if document["times_from"] == "stamps" else ""
    lines.append(f"capture rate {document['capture_fps']:g} fps (from {source}){stamped}")
    lines.append(f"{document['frames']} frames{rate}; written: {document['output']}")
    return "\n".join(lines)


class ClipDocument(TypedDict):
    """The clock of one clip, relative to the clock of the casing's camera."""

    source: Path  #: The recording.
    offset_s: float  #: Start of the clip [s].
    offset_sigma_s: float  #: Standard uncertainty of the start [s].
    rate: float  #: Rate of the clock of the clip [1].
    rate_sigma: float  #: Standard uncertainty of the rate [1].
    angle_offset: float  #: Angle added to the angles of the clip [rad].
    angle_offset_sigma: float  #: Standard uncertainty of `angle_offset` [rad].
    covariance: Floats  #: Covariance matrix of start, rate and angle [products of s, 1 and rad].
    ambiguous: bool  #: Whether the data also allow another start of the clip.
    rivals: tuple[Rival, ...]  #: Alternative starts.
    misfit_rad: float  #: Rms difference of the angles of the two cameras [rad].
    outliers: int  #: Number of samples that are not used.
    common_rate: bool  #: Whether a common clock rate was fitted to all clips.
    common_direction: bool  #: Whether a common direction of the zero of the angle was fitted to all clips.


class SyncDocument(TypedDict):
    """A new case of synchronised clips."""

    output: Path  #: The case.
    clips: list[ClipDocument]  #: The clips of the rotor.
    warnings: tuple[str, ...]  #: Warnings.


def sync_command(
    casing: Annotated[Path, typer.Argument(metavar="CASING.h5", help="Recording of the casing.")],
    rotors: Annotated[list[Path], typer.Argument(metavar="ROTOR.h5", help="Recordings of the rotor.")],
    *,
    output: shared.OutputFile,
    label: shared.Label = None,
    surface: shared.Surface = "",
    inertia_rotor: shared.InertiaRotor = None,
    inertia_casing: shared.InertiaCasing = None,
    force: shared.Force = False,
    out: shared.VerboseOut,
) -> None:
    """Synchronise the clips of one experiment, and combine them into a case.

    The rotor clips must also show the casing: its angle, measured by both cameras, determines the start of each clip.
    Torques follow from the moments of inertia, which have no default; an uncertainty is optional.

    Example: gyrotrack sync casing.h5 rotor_1.h5 rotor_2.h5 -o case1.h5 --inertia-rotor "5.54e-5 +- 0.06e-5"
    --inertia-casing "206 g cm2"
    """
    from gyrotrack.apps._api import synchronised
    from gyrotrack.io._atomic import refuse_existing
    from gyrotrack.io._hdf5 import write_case
    from gyrotrack.io._records import Inertia

    inertias = Inertia.required(inertia_rotor, "rotor"), Inertia.required(inertia_casing, "casing")
    refuse_existing(output, force=force, reads=[casing, *rotors])
    title = label if label is not None else output.stem
    with out.progress("synchronising clips") as progress:
        done = synchronised(casing, rotors, title, surface, inertias, progress)
    moments = dict(zip(("I_rotor", "I_casing"), (i.value for i in inertias), strict=True))
    settings = {"casing": casing, "rotors": rotors, **moments}
    write_case(output, done.case, command=command_line(), settings=settings, force=force)
    for warning in done.case.warnings:
        out.warn(warning)
    for match in done.matches:
        misfit = 1e3 * match.misfit
        out.detail(f"{match.name}: {match.method}; rms difference of the cameras {misfit:.2f} mrad")
    clips = [_clip(path, match) for path, match in zip(rotors, done.matches, strict=True)]
    out.result(SyncDocument(output=output, clips=clips, warnings=done.case.warnings))
    out.show("\n".join([_HEADER, *(_line(clip) for clip in clips), f"written: {output}"]))


def _clip(path: Path, match: Match) -> ClipDocument:
    from gyrotrack.synchronisation._matching import TURN

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


_HEADER = f"{'clip':<24}{'start [s]':>12}{'+- [ms]':>10}{'clock error [ppm]':>20}{'+-':>8}"


def _line(clip: ClipDocument) -> str:
    doubt = "ambiguous" if clip["ambiguous"] else ""
    name = clip["source"].name
    name = name if len(name) < 24 else "..." + name[-20:]
    return (
        f"{name:<24}{clip['offset_s']:>12.5f}{1e3 * clip['offset_sigma_s']:>10.3f}"
        f"{1e6 * (clip['rate'] - 1):>20.1f}{1e6 * clip['rate_sigma']:>8.1f}  {doubt}"
    ).rstrip()


class SingleBody(StrEnum):
    """Body to analyse."""

    casing = "casing"
    rotor = "rotor"


def spindown_command(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="Film, recording, or a table that `import` reads.")
    ],
    *,
    output: Annotated[Path | None, option("-o --output FILE", "Case to write; by default SOURCE.h5.")] = None,
    report: Annotated[
        Path | None, option("--report FILE", "Report to write; by default next to the case.")
    ] = None,
    hub: shared.Hub = None,
    point: shared.Point = None,
    colour: shared.PointColour = None,
    scale: shared.PixelScale = None,
    tilt: shared.PlaneTilt = None,
    profile: Annotated[
        Path | None, option("--profile P", "Markers and colours of the film; by default detected.")
    ] = None,
    body: Annotated[
        SingleBody | None, option("--body", "Body to analyse, if the film or recording contains two bodies.")
    ] = None,
    capture_fps: Annotated[
        float | None,
        option(
            "--capture-fps --casing-fps N",
            "Frames per second of the camera, or rows per second of a table without times.",
        ),
    ] = None,
    inertia: shared.BodyInertia = None,
    pulses_per_turn: shared.PulsesPerTurn = None,
    columns: shared.Columns = None,
    inputs: shared.Inputs = None,
    marker: shared.Marker = None,
    centre: shared.Centre = None,
    likelihood: shared.Likelihood = 0.6,
    start: shared.StartTime = None,
    stop: shared.StopTime = None,
    cut: shared.Cuts = None,
    keep_all: Annotated[
        bool,
        option(
            "--keep-all",
            "Keep the whole record, including a driven start, rest at the end, and outliers.",
        ),
    ] = False,
    label: Annotated[str, option("--label L", "Name of the case; by default the name of the file.")] = "",
    body_name: shared.BodyName = "",
    force: shared.Force = False,
    out: shared.Out,
) -> int:
    """Measure one rotating body: film or table to motion, torque law and report.

    A film needs no markers: each frame is registered to the mean image of the body. A point about a pivot, for example
    the bob of a pendulum, is followed with --point or --colour, or if it is the only compact body that moves. Without
    --inertia, torques are per unit of inertia.

    Example: gyrotrack spindown wheel.mp4 --capture-fps 300
    """
    from gyrotrack.apps._points import read_point, read_tilt
    from gyrotrack.apps._refusal import pictured_refusal
    from gyrotrack.apps._spindown import SpindownOptions, picture_path, spindown
    from gyrotrack.io._outputs import new_outputs
    from gyrotrack.io.readers._run import Limits, read_cuts

    shared.check_pulses(pulses_per_turn)
    target = output if output is not None else Path(source.with_suffix(".h5").name)
    if target.resolve() == source.resolve():
        target = target.with_name(f"{target.stem}_case.h5")
    page = report if report is not None else target.with_suffix(".html")
    if page.resolve() in (target.resolve(), source.resolve()):
        what = f"{page} is the name of both the case and the report."
        raise UsageError(what, "Name the case with -o FILE.h5 and the report with --report.")
    options = SpindownOptions(
        hub=_position(hub),
        capture_fps=capture_fps,
        inertia=inertia,
        pulses_per_turn=pulses_per_turn,
        limits=Limits(start, stop, read_cuts(cut or ()), keep_all),
        label=label,
        body_name=checked_body_name(body_name),
        profile=profile,
        body=body.value if body else None,
        columns=tuple(columns or ()),
        marker=marker,
        centre=centre,
        likelihood=likelihood,
        inputs=tuple(inputs or ()),
        point=None if point is None else read_point(point),
        colour=None if colour is None else colour.value,
        scale=shared.checked_scale(scale),
        tilt=None if tilt is None else read_tilt(tilt),
    )
    outputs = new_outputs(target, page, picture_path(source, target), force=force, reads=[source, profile])
    with pictured_refusal(target), outputs, out.progress(f"tracking {source.name}", "frames") as progress:
        document = spindown(
            source, target, page, options, command=command_line(), force=force, progress=progress
        )
    if document["case"] is None and (output is not None or report is not None):
        what = f"{source}: light gates show period and decay of a pendulum, but no angle to write."
        raise UsageError(what, "Repeat the command without -o and --report.")
    for warning in document["warnings"]:
        out.warn(warning)
    out.result(document)
    out.show(*shared.reading_lines(document["reading"]), *_lines(document))
    if document["ambiguous"]:
        return NOT_TRUSTED
    if document["diagnosis"] is None:
        motion = document["motion"]
        free = motion.kind in ("steady", "fluctuating") or motion.period is not None
        return DONE if free or document["response"] is not None else NOT_TRUSTED
    return NOT_TRUSTED if document["diagnosis"]["verdict"] == "unexplained" else DONE


def _position(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        what = f"--hub {text[:40]!r} is not a position."
        raise UsageError(what, "Give two numbers in px, for example 320,240.")
    return x, y


_MOST_ALTERNATIVES = 3


def _oscillator_lines(laws: Any) -> list[str]:
    """Return the restoring torque and the damping of an oscillator, with the sets of indistinguishable laws."""

    def of(chosen: tuple[str, ...], classes: tuple[tuple[str, ...], ...]) -> str:
        values = [
            f"{key} {'about' if p.approximate else '='} {rounded(p.value, p.stderr, p.unit)}"
            for key, p in laws.parameters.items()
            if key.rpartition(".")[0] in chosen
        ]
        others = [" + ".join(names) or "none" for names in classes if names != chosen]
        if len(others) > _MOST_ALTERNATIVES:
            others = [*others[:_MOST_ALTERNATIVES], f"{len(others) - _MOST_ALTERNATIVES} more"]
        return ", ".join(values or ["none"]) + (f" (or {' or '.join(others)})" if others else "")

    return [
        f"restoring  {of(laws.restoring, laws.restoring_classes)}",
        f"damping    {of(laws.damping, laws.damping_classes)}",
    ]


def _response_lines(response: Response | None) -> list[str]:
    """Return the first-order response of a driven body."""
    if response is None:
        return ["response   not of first order"]
    cause = f"input '{response.input}'" if response.input else "constant drive"
    per = f" per {response.unit or 'unit'}"
    quantities = [
        ("tau", response.time_constant, "s"),
        ("delay", response.delay, "s"),
        ("gain", response.gain, "rad/s"),
        ("final", response.final, "rad/s"),
    ]
    lines = [f"response   of first order to the {cause}; it explains {100 * response.explained:.1f} %"]
    return lines + [
        f"{n:<9}  {rounded(q.value, q.stderr, u)}{per if n == 'gain' else ''}"
        for n, q, u in quantities
        if q is not None
    ]


def _first_order_lines(document: Mapping[str, Any]) -> list[str]:
    """Return the constants of the first-order fit of a body driven by recorded inputs."""
    found = document["first_order"]
    values = [
        (name, e)
        for f in found
        for name, e in (
            ("tau", f["time_constant"]),
            *((f"gain of {n}", e) for n, e in f["gains"].items()),
            *((f"dead time of {n}", e) for n, e in f["delays"].items()),
        )
    ]
    if not values:
        return []
    complete = (document["diagnosis"] or {}).get("verdict") == "adequate"
    return [
        "response   of the first-order fit to the recorded input"
        + ("" if complete else ", which is not complete"),
        *(f"{name:<9}  {rounded(e.value, e.stderr, e.unit)}" for name, e in values),
    ]


def _law_lines(document: Mapping[str, Any]) -> list[str]:
    """Return the strengths of the fitted laws (not for an oscillator), and their effects on the motion."""
    known = () if document["oscillator"] is None else document["oscillator"].parameters
    return [
        f"{'law':<9}  {law.words}"
        + ("" if law.parameter in known else f" = {rounded(law.value, law.stderr, law.unit)}")
        + f": {law.meaning}"
        for law in document["laws"]
    ]


def _with_u(value: float, u: float) -> str:
    return rounded(value, u, "").rstrip() if math.isfinite(u) and u > 0 else f"{value:.6g}"


def _lines(document: Mapping[str, Any]) -> list[str]:
    from gyrotrack.io.readers._reading import units_of_file

    motion = document["motion"]
    own = next((found for reading in document["reading"] if (found := units_of_file(reading))), {})
    lines = [motion.kind if math.isnan(motion.turns) else f"{motion.kind}, {motion.turns:.3f} turns"]
    if motion.kind == "oscillation":
        quantities = [
            ("period", motion.period, "s", ""),
            ("amplitude", motion.amplitude, "rad", "angle"),
            ("decay", motion.decay, "1/s", ""),
            ("Q", motion.quality_factor, "", ""),
        ]
    else:
        ends = (_with_u(speed(motion.omega[end]), speed(motion.omega_u[end])) for end in ("first", "last"))
        lines.append(f"omega      {' to '.join(ends)} {speed_unit()}")
        if "omega" in own:
            unit, scale = own["omega"]
            first, last = (motion.omega[end] / scale for end in ("first", "last"))
            lines[-1] += f" ({first:.6g} to {last:.6g} {unit})"
        quantities = [
            ("mean", motion.omega_mean, "rad/s", "omega"),
            ("alpha", motion.alpha, "rad/s2", "alpha"),
        ]
        # values from the polynomial are not shown, because it describes a free motion, not a driven one
        quantities = {"driven": [], "fluctuating": quantities[:1]}.get(motion.kind, quantities)
    for name, q, unit, kind in quantities:
        if q is not None:
            lines.append(f"{name:<9}  {rounded(q.value, q.stderr, unit)}")
            if kind in own:
                unit, scale = own[kind]
                lines[-1] += f" ({rounded(q.value / scale, q.stderr / scale, unit)})"
            if name == "amplitude":
                lines[-1] += ", at the middle of the record"
    if motion.kind == "driven" and document["diagnosis"] is None:
        lines += _response_lines(document["response"])
    lines += _first_order_lines(document)
    if document["oscillator"] is not None:
        lines += _oscillator_lines(document["oscillator"])
    lines += _law_lines(document)
    if document["diagnosis"] is not None:
        lines.append(document["diagnosis"]["sentence"])
        lines += [
            f"fit {step['fit_id']}: {step['added'] or 'base model'}, misfit {step['misfit']:.3g} times the noise"
            for step in document["ladder"]
        ]
        lines.append(
            "Uncertainties are those of this record alone; repeats of a run may differ by more: `gyrotrack compare`."
        )
    written = [str(document[key]) for key in ("case", "report", "picture") if document[key] is not None]
    return ["\n".join([*lines, *([f"written: {', '.join(written)}"] if written else [])])]
