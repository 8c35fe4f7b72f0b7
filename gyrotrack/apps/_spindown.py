"""Analysis of one body: from a film or a table to its motion, its torque law and a report."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, cast

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import DatasetError, GyrotrackError, TrackingError, UsageError, VideoError
from gyrotrack.apps._drive import Drive, Response, drive_from_rest, drive_of
from gyrotrack.apps._motion import (
    TURN,
    BodyMotion,
    Value,
    end_of_motion,
    motion_of,
    motion_of_passages,
    motion_of_speeds,
    start_of_motion,
)
from gyrotrack.apps._points import point_track, with_differences, with_pivot_errors, write_point_picture
from gyrotrack.apps._study import Recorder, changed, open_study
from gyrotrack.apps.report._laws import LawOfBody, laws_of_body
from gyrotrack.apps.report._page import write_report
from gyrotrack.io._atomic import refuse_special
from gyrotrack.io._hdf5 import read_case, read_recording, write_case
from gyrotrack.io._records import (
    BodyTrack,
    Case,
    ErrorMode,
    Inertia,
    Input,
    Placement,
    Recording,
    Series,
    doubts_of,
    from_angles,
    no_series,
    series_of,
)
from gyrotrack.io.readers._import_case import case_of_body
from gyrotrack.io.readers._inputs import UNITS, Unit, read_input_options
from gyrotrack.io.readers._motion_table import Driver, MotionTable, ReadOptions, read_names
from gyrotrack.io.readers._number_range import check_numbers, usable_numbers
from gyrotrack.io.readers._raw_table import clean
from gyrotrack.io.readers._registry import read_motion, read_passages
from gyrotrack.io.readers._run import Limits, enough_within, within
from gyrotrack.plotting._frames import write_body_picture
from gyrotrack.tracking._any_body import track_body
from gyrotrack.tracking._diagnosis import RefusedFilmError
from gyrotrack.tracking._extract import LEAST_TURN, extract, has_corners, track_doubts
from gyrotrack.tracking._film import Film, Tilt, fresh_frames, is_coloured
from gyrotrack.tracking._first_look import FirstLook, first_look, follow_long_body
from gyrotrack.tracking._moving_hub import track_free_body
from gyrotrack.tracking._point_motion import (
    OFF_AXIS,
    TrackedPoint,
    follow_links,
    follow_path,
    follow_point,
    point_details,
)
from gyrotrack.tracking._point_tracker import PointPath
from gyrotrack.tracking._profile import load
from gyrotrack.tracking._silhouettes import Foreground
from gyrotrack.tracking._tracked import Tracked, white_noise
from gyrotrack.video._container import file_sha256, is_film
from gyrotrack.video._time_base import SLOWEST_PLAIN_RATE, Timing

if TYPE_CHECKING:
    from fitting._schema import StepDocument, StoredEstimate
    from fitting.discovery._oscillator import OscillatorLaws
    from fitting.discovery._select import Step
    from fitting.inference._case_data import CaseData
    from fitting.inference._result import Fit
    from fitting.study._serialisation import DiagnosisDocument
    from gyrotrack.io.readers._reading import ReadingDocument

Floats = npt.NDArray[np.float64]
Progress = Callable[[int, int | None], None]

# kinds of refused films that no other method can track; if a film shows two bodies, the user must select one body
_NO_OTHER_WAY = ("cut", "no motion", "two bodies", "two links")
# smallest share of the change of brightness that one rotation explains if its parts, for example blades, are not bodies
_ONE_ROTATION = 0.85
_MIN_TRACKED = 0.8  # the paper's markers are used only if they are found in at least this share of the frames


@dataclass(frozen=True)
class SpindownOptions:
    """Options of `spindown`."""

    hub: tuple[float, float] | None = None  # centre of rotation (x, y) [px]
    # point to follow in a film, by its position (x, y) in the first frame [px]; length of a pixel in its plane [m]
    point: tuple[float, float] | None = None
    colour: str | None = None  # colour of a point to follow
    scale: float | None = None
    tilt: Tilt | None = None  # angle between the axis of rotation and the line of sight
    capture_fps: float | None = None  # frames per second of the camera
    # moment of inertia [kg m2], for example "5.5e-5 +- 0.1e-5"; without a value, torques are per unit of inertia
    # [rad/s2]
    inertia: str | None = None
    # number of pulses per turn, for a table with one column of times of pulses
    pulses_per_turn: float | None = None
    # times to include and to exclude; whether to keep drive and rest at the ends of the record
    limits: Limits = field(default_factory=Limits)
    label: str = ""  # name of the case
    body_name: str = ""  # name of the body, for example wheel
    # markers and colours of a film; without a profile, the texture of the body or the paper's markers are tracked
    profile: Path | None = None
    body: str | None = None  # body to analyse, "casing" or "rotor", in a film or recording of both bodies
    columns: tuple[str, ...] = ()  # meaning of columns of a table, for example "t=1" and "angle=2"
    # point to follow and centre of rotation, in a table or project of points
    marker: str | None = None
    centre: str | None = None
    likelihood: float = 0.6  # minimum likelihood of the points that are used
    inputs: tuple[str, ...] = ()  # recorded inputs of a table, for example "current=3 [A]"


@dataclass(frozen=True)
class Source:
    """The data that were read from a source."""

    case: Case
    film: tuple[Film, Tracked | TrackedPoint] | None = (
        None  # the film of a body tracked by its texture or by a point
    )
    table: MotionTable | None = None  # the samples of a table that are used


def read_source(source: Path, options: SpindownOptions, progress: Progress | None = None) -> Source:
    """Make a case of one body from a film, a recording or a table."""
    moment = Inertia(1.0) if options.inertia is None else Inertia.of(options.inertia)
    if not (source.is_dir() and is_film(source)):
        refuse_special(source)
    if not source.is_file() and not (source.is_dir() and is_film(source)):
        raise DatasetError(f"There is no file {source}.", "Check the path.")
    body, table = None, None
    filmed = is_film(source) and options.pulses_per_turn is None
    if filmed and (options.columns or options.marker or options.centre):
        what = "--column, --marker and --centre apply to tables and tracked points, not to a film."
        raise UsageError(what, "Give the centre of rotation in a film by --hub X,Y.")
    tabulated = not filmed and source.suffix.lower() not in (".h5", ".hdf5")
    if options.inputs and not tabulated:
        what = "--input names a column of a table; a film or a recording has none."
        raise UsageError(what, "Write the angles with `gyrotrack export`, and add the input as a column.")
    if not filmed and (options.point or options.colour or options.scale or options.tilt):
        what = "--point, --colour, --scale and --tilt apply to films."
        raise UsageError(what, "Select a column or a tracked point of a table by --column or --marker.")
    if filmed:
        recording, body = _film(source, options, progress)
        case = _recording_case(recording, moment.value, options.body)
        if body is not None and isinstance(body[1], Tracked):
            case = replace(case, casing=replace(case.casing, modes=_tilt_mode(body[1])))
    elif source.suffix.lower() in (".h5", ".hdf5") and (found := _recording_in(source)) is not None:
        case = _recording_case(found, moment.value, options.body)
    else:
        with usable_numbers(source):
            read = read_motion(source, _reading(options))
            case, table = case_of_body(read, moment.value, limits=options.limits)
        check_numbers(case)
    case = replace(case, I_casing_u=moment.u, per_inertia=int(options.inertia is None))
    warnings = list(case.warnings)
    if options.inertia is None:
        warnings.append("No inertia is given: torques are per unit of inertia, in rad/s2 (inertia 1).")
    series = case.casing
    is_table = (
        table is not None
    )  # the reader of tables has already applied the limits and removed drive and rest
    if not is_table:
        series = _within(series, options.limits, warnings)
    if not (options.limits.keep_all or is_table):
        whole = (series.time, series.angle, series.sigma)
        first, last = start_of_motion(*whole), end_of_motion(*whole)
        if first:
            warnings.append(
                f"The body is driven until {series.time[first]:.3f} s (by hand or motor); the {first} samples before "
                "are excluded. --keep-all keeps them."
            )
        if last < len(series.time):
            warnings.append(
                f"The body is at rest after {series.time[last - 1]:.3f} s; the {len(series.time) - last} samples after "
                "it are excluded. --keep-all keeps them."
            )
        series = _rows(series, slice(first, last))
    case = replace(case, casing=series, warnings=tuple(warnings), label=options.label or source.stem)
    case = replace(case, body_name=options.body_name)
    return Source(case, body, table)


def _reading(options: SpindownOptions) -> ReadOptions:
    return ReadOptions(
        read_names(options.columns) or None,
        options.marker,
        options.centre,
        options.capture_fps,
        likelihood=options.likelihood,
        pulses_per_turn=options.pulses_per_turn,
        inputs=read_input_options(options.inputs),
    )


def _passages(source: Path, options: SpindownOptions) -> dict[str, Any] | None:
    """Return the document of a pendulum in light gates, without angles and case; None for another source."""
    if not source.is_file() or is_film(source) or source.suffix.lower() in (".h5", ".hdf5"):
        return None
    with usable_numbers(source):
        found = read_passages(source, _reading(options))
    if found is None:
        return None
    if options.inputs:
        what = "Light gates measure period and decay of a pendulum; inputs are not supported."
        raise UsageError(what, "Repeat the command without --input.")
    keep = within(found.time, options.limits)
    found = replace(found, time=found.time[keep], duration=found.duration[keep])
    motion = motion_of_passages(found)
    note = (
        f"{source.name}: {len(found.time)} passages of a pendulum through the light gates; they show its period and "
        "decay, but no angle. Therefore no case is made and no torque law is fitted."
    )
    parts = dict.fromkeys(("case", "report", "picture", "oscillator", "response", "diagnosis"))
    parts["reading"] = []
    return {
        **parts,
        "motion": motion,
        "first_order": [],
        "laws": [],
        "ladder": [],
        "warnings": [*found.notes, note],
        "ambiguous": False,
    }


def _rows(series: Series, rows: slice | npt.NDArray[np.bool_]) -> Series:
    names = ("time", "angle", "sigma", "omega", "omega_sigma", "turn")
    modes = tuple(replace(mode, basis=mode.basis[rows]) for mode in series.modes)
    return replace(series, modes=modes, **{name: getattr(series, name)[rows] for name in names})


def _within(series: Series, limits: Limits, warnings: list[str]) -> Series:
    """Return the samples of a film within the limits of the user, and add their number to the warnings."""
    keep = enough_within(series.time, limits)
    if keep.all():
        return series
    warnings.append(f"{int((~keep).sum())} samples are excluded by --from, --to or --cut.")
    return _rows(series, keep)


def _recording_in(path: Path) -> Recording | None:
    try:
        return read_recording(path)
    except DatasetError:
        return None


def _film(
    source: Path, options: SpindownOptions, progress: Progress | None
) -> tuple[Recording, tuple[Film, Tracked | TrackedPoint] | None]:
    """Track by the first method that applies: profile, texture, the paper's markers (without a hub), moving body.

    If one of the bodies of the paper's markers is selected, the markers come first. A point is followed in four cases:
    a point is selected, no rotating body is found, the hub is outside the picture, or only one compact body moves on an
    arc. An example of the last case is a ball on a thread, whose path is measured better than its rotation.
    """
    if options.profile is not None:
        return extract(
            source,
            load(options.profile),
            capture_fps=options.capture_fps,
            body=options.body,
            progress=progress,
        ), None
    if options.point is not None or options.colour is not None:
        film = Film(source, colour=options.colour, tilt=options.tilt)
        _limit(film, options)  # an unknown rate is reported before the film is tracked
        recording, point = point_recording(film, options, progress)
        return recording, (film, point)
    film = Film(source) if options.tilt is None else Film(source, tilt=options.tilt)
    _limit(film, options)
    # in a film of the paper's gyroscope, the tracked texture may belong to either body
    if options.body is not None and (found := _papers_markers(source, film, options, progress)) is not None:
        return found, None
    look = first_look(film)
    if (known := _by_silhouette(film, look, options, progress)) is not None:
        recording, point = known
        return recording, (film, point)
    try:
        recording, tracked = film_recording(film, options, progress)
    except TrackingError as error:
        kind = error.kind if isinstance(error, RefusedFilmError) else ""
        if kind in _NO_OTHER_WAY:
            raise
        if options.body is None and (found := _papers_markers(source, film, options, progress)) is not None:
            return found, None
        if kind == "moving camera":
            raise
        several: RefusedFilmError | None = None
        try:
            recording, point = point_recording(
                film, options, progress, None if film.stabilised else look.seen
            )
        # the body may be one of several compact bodies that move across the picture
        except TrackingError as other:
            several = other if isinstance(other, RefusedFilmError) else None
        else:
            return recording, (film, point)
        with suppress(TrackingError):
            recording, tracked = film_recording(film, options, progress, free=True)
            return recording, (film, tracked)
        if several is not None and not _is_loose_rotation(error):
            raise several from error
        raise
    x, y = tracked.ring.hub
    if not (0 <= x < recording.width and 0 <= y < recording.height):
        with suppress(TrackingError):
            recording, point = point_recording(film, options, progress)
            return recording, (film, point)
    return recording, (film, tracked)


def _is_loose_rotation(error: TrackingError) -> bool:
    """Return whether one rotation explains a refused film, although its hub moves: a body before a moving camera."""
    known = error.evidence if isinstance(error, RefusedFilmError) else {}
    return "hub_moves_px" in known and float(known.get("explained", 0.0)) >= _ONE_ROTATION


def _by_silhouette(
    film: Film, look: FirstLook, options: SpindownOptions, progress: Progress | None
) -> tuple[Recording, TrackedPoint] | None:
    """Track a ball on a string or a long body about a tilted axis if the silhouettes in a few frames show one.

    The result is None for any other film.
    """
    if look.long is not None and options.tilt is None:
        with suppress(TrackingError):
            found = follow_long_body(film, look.long)
            return _recording_of(film, options, found), found
    if look.pendulum:
        with suppress(TrackingError):
            return point_recording(film, options, progress, look.seen)
    return None


def _papers_markers(
    source: Path, film: Film, options: SpindownOptions, progress: Progress | None
) -> Recording | None:
    """Track the paper's markers; None if a hub is given, or if no tracked body turns."""
    if options.hub is not None or options.tilt is not None:
        return None
    fps, _, warnings = _rate(film, options.capture_fps)
    # the angle of a body at rest in a rendered film is exactly constant, so its prediction is singular
    with suppress(GyrotrackError, np.linalg.LinAlgError):
        if not is_coloured(source):
            return None
        found = extract(source, capture_fps=fps, body=options.body, progress=progress)
        tracks = [b for b in found.bodies.values() if len(b.time) > _MIN_TRACKED * len(film)]
        # coloured objects at rest or in a hand are not markers, nor are coloured patches without corners
        turns = any(float(np.ptp(b.angle)) >= LEAST_TURN for b in tracks)
        if turns and has_corners(found.markers.values()):
            note = "The paper's coloured markers are tracked; give --profile or --hub X,Y for another body."
            return replace(found, warnings=(*warnings, note, *found.warnings))
    return None


def _rate(film: Film, requested: float | None) -> tuple[float, str, list[str]]:
    """Return the capture rate of a film [1/s], its origin, and a warning if it is uncertain."""
    if requested is not None:
        if not (math.isfinite(requested) and requested > 0):
            raise VideoError(f"Invalid capture rate: {requested:g} fps.", "Give a positive number.")
        if film.interlaced:
            text = (
                f"--capture-fps {requested:g} is the rate of the frames, which contain {2 * requested:g} fields per "
                "second."
            )
            return 2 * requested, "--capture-fps", [text]
        return requested, "--capture-fps", []
    if film.info.tag_fps is not None:
        return film.info.tag_fps, "tag of the camera", []
    fps = film.info.container_fps
    if not math.isfinite(fps):
        raise VideoError(f"{film.path} does not state its capture rate.", "Give --capture-fps.")
    slow = (
        f"The capture rate is taken from the container: {fps:g} fps. A slow-motion film needs --capture-fps."
    )
    return fps, "container", [slow] if fps < SLOWEST_PLAIN_RATE else []


def _limit(film: Film, options: SpindownOptions) -> None:
    """Select the frames of a film within the limits of the user, before it is tracked."""
    fps, *_ = _rate(film, options.capture_fps)
    limits = options.limits
    if limits.start is None and limits.stop is None and not limits.cuts:
        return
    keep = enough_within(Timing("auto", fps).of(film.stamps, float(film.info.time_base)).seconds(fps), limits)
    film.selected &= keep
    text = f"{int((~keep).sum())} of {len(keep)} frames are excluded by --from, --to or --cut."
    film.warnings = (*film.warnings, text)


def film_recording(
    film: Film, options: SpindownOptions, progress: Progress | None = None, *, free: bool = False
) -> tuple[Recording, Tracked]:
    """Track one body, which turns about a hub or is `free` to move across the picture, and make a recording."""
    tracked = (track_free_body if free else track_body)(film, _levelled(film, options.hub), progress)
    return _recording_of(film, options, tracked), tracked


def point_recording(
    film: Film,
    options: SpindownOptions,
    progress: Progress | None = None,
    seen: Foreground | None = None,
) -> tuple[Recording, TrackedPoint]:
    """Follow a point of a film, selected by the options or found, about its pivot, and make a recording.

    `seen` is the foreground of the film, if available.
    """
    point, hub = (_levelled(film, place) for place in (options.point, options.hub))
    tracked = follow_point(film, point, hub, progress, seen)
    return _recording_of(film, options, tracked), tracked


def _levelled(film: Film, place: tuple[float, float] | None) -> tuple[float, float] | None:
    return place if place is None or film.tilt is None else film.levelled(place)


def points_recording(
    film: Film,
    starts: Sequence[tuple[float, float] | None],
    options: SpindownOptions,
    progress: Progress | None = None,
) -> Recording:
    """Follow several points of a film, each about its own pivot, and make one recording.

    The body of the recording turns with the first point that has a pivot. If no point has a pivot, the recording
    contains only paths.
    """
    hub = _levelled(film, options.hub)
    found = [follow_path(film, _levelled(film, start), hub, progress) for start in starts]
    names = ["point"] if len(found) == 1 else [f"point_{k + 1}" for k in range(len(found))]
    about = [p for p in found if isinstance(p, TrackedPoint)]
    first = about[0] if about else None
    recording = _recording_of(film, options, first or found[0])
    tracks = {
        n: point_track(n, p, recording.time[p.frame], recording.frame_index, film, options.scale)
        for n, p in zip(names, found, strict=True)
    }
    warnings = list(recording.warnings)
    for name, path in zip(names, found, strict=True):
        if isinstance(path, TrackedPoint) and path is not first:
            warnings += [f"{name}: {w}" for w in path.warnings if w not in recording.warnings]
        elif not isinstance(path, TrackedPoint):
            warnings.append(
                f"{name}: the path does not determine a pivot; --hub X,Y gives it. It has no angle."
            )
    return replace(recording, points=tracks, warnings=tuple(warnings))


def links_recording(
    film: Film,
    starts: Sequence[tuple[float, float]],
    options: SpindownOptions,
    progress: Progress | None = None,
) -> Recording:
    """Follow the joint of two links and a point of the second link, and make a recording of both bodies.

    The casing is the first link, the rotor is the second link. Both angles are relative to the ground,
    counter-clockwise from the right of the picture; their difference is the angle between the links.
    """
    if len(starts) != 2:
        what = f"--links needs two points, but {len(starts)} are given."
        raise UsageError(
            what, "Give the joint and a point of the second link with --points X,Y --points X,Y."
        )
    joint, second = follow_links(film, (starts[0], starts[1]), options.hub, progress)
    first = replace(joint, warnings=())
    recording = _recording_of(film, options, first)
    time = recording.time
    bodies = {
        "casing": _body_of(time[joint.frame], joint.angle, joint.whole_sigma),
        "rotor": replace(_body_of(time[second.frame], second.angle, second.sigma), name="rotor"),
    }
    tracks = {
        name: point_track(name, path, time[path.frame], recording.frame_index, film, options.scale)
        for name, path in (("joint", joint), ("second_link", second.path))
    }
    beside = OFF_AXIS / float(np.median(np.hypot(*(joint.place - joint.hub).T)))
    text = (
        "The casing is the first link, about the pivot; the rotor is the second link, about the joint. Their angles "
        "are relative to the ground; the angle between the links is rotor minus casing. The points may be "
        f"{1e3 * beside:.2g} mrad off the axes of the links, which "
        "causes an error of the zero of the first angle."
    )
    extra = {**recording.extra, "links": ["casing", "rotor"]}
    warnings = (*recording.warnings, *joint.warnings, text)
    return replace(recording, sense=1, bodies=bodies, points=tracks, warnings=warnings, extra=extra)


def _recording_of(
    film: Film, options: SpindownOptions, tracked: Tracked | TrackedPoint | PointPath
) -> Recording:
    """Return the recording of a body or a point that was tracked."""
    fps, origin, warnings = _rate(film, options.capture_fps)
    times = Timing("auto", fps).of(film.stamps, float(film.info.time_base))
    time_all = times.seconds(fps)
    time = time_all[tracked.frame]
    sense, bodies, unsure = 1, dict[str, BodyTrack](), list[str]()
    if not isinstance(tracked, PointPath):
        sense = 1 if tracked.angle[-1] >= tracked.angle[0] else -1
        body = _body_of(time, sense * tracked.angle, tracked.sigma)
        if isinstance(tracked, TrackedPoint):
            body = replace(body, harmonic_sigma=tracked.error_by_place(film.info.width))
        bodies["casing"] = body
        # frames before a body enters the picture, or after it leaves the picture, do not count as lost
        shown = fresh_frames(film)
        count = int(np.count_nonzero((shown >= tracked.frame[0]) & (shown <= tracked.frame[-1])))
        unsure = track_doubts("body", body, count, "the picture of the body (.png)")
    doubts = [*tracked.warnings[-1:]] if not isinstance(tracked, PointPath) and tracked.ambiguous else []
    centre = np.full((len(film), 2), np.nan)
    points = {}
    if isinstance(tracked, TrackedPoint):
        centre[tracked.frame] = tracked.hub
        points = {"point": point_track("point", tracked, time, times.number, film, options.scale)}
        details = point_details(tracked)
    elif isinstance(tracked, PointPath):
        details = {"method": "registration of a patch"}
    else:
        centre[tracked.frame] = np.array(tracked.ring.hub) + tracked.hub_path
        details = {
            "method": "registration of the polar picture",
            "hub_px": list(tracked.ring.hub),
            "stretch": list(tracked.ring.stretch),
            "ring_px": [tracked.ring.inner, tracked.ring.outer],
            "explained": tracked.explained,
            "scatter_over_bound": tracked.scale,
            "correlated_rad": tracked.correlated,
            "hub_motion_px": tracked.template.hub_sigma,
        }
    centre = film.seen(centre)
    rows, columns = next(iter(film.frames(0, 1))).shape
    return Recording(
        source=film.path.name,
        source_sha256=file_sha256(film.path),
        width=columns,
        height=rows,
        capture_fps=fps,
        # streams without a container, and folders of pictures, do not state a rate
        container_fps=film.info.container_fps if math.isfinite(film.info.container_fps) else fps,
        frames_declared=film.info.frames_declared,
        frames_decoded=len(film),
        sense=sense,
        body="casing",
        frame_index=times.number,
        time=time_all,
        pts_time=film.stamps,
        centre=centre,
        centre_sigma=np.full(len(film), np.nan),
        markers={},
        bodies=bodies,
        warnings=(*warnings, *getattr(tracked, "warnings", film.warnings), *unsure, *times.warnings),
        extra={
            "times_from": "frames" if times.place is None else "stamps",
            "capture_rate_from": origin,
            "centre_from": getattr(tracked, "way", "none"),
            "doubts": [*doubts, *unsure],
            "tilt_given": None if film.tilt is None else vars(film.tilt),
            "tracking": details,
        },
        points=points,
    )


def _body_of(time: Floats, angle: Floats, sigma: Floats) -> BodyTrack:
    motion = vars(from_angles(time, angle, sigma))
    one = np.ones(len(time), dtype=np.int64)
    return BodyTrack("casing", sigma_paper=np.full(len(time), np.nan), n_markers=one, **motion)


def _recording_case(recording: Recording, inertia: float, name: str | None = None) -> Case:
    """Make a case of one body of a recording, stored as the casing; by default the body with most samples."""
    if name is not None and name not in recording.bodies:
        what = f"{recording.source} does not contain the {name}."
        raise DatasetError(what, f"It contains: {', '.join(recording.bodies)}.")
    if not recording.bodies:
        raise DatasetError(f"{recording.source} contains no body.", "Track the film again.")
    count = {key: len(body.time) for key, body in recording.bodies.items()}
    name = name or max(
        count, key=lambda key: (count[key] > 0.9 * max(count.values()), key == recording.body, count[key])
    )
    if len(recording.bodies) > 1:
        other = next(key for key in recording.bodies if key != name)
        text = (
            f"The {name} is one of {len(recording.bodies)} bodies and is analysed; "
            f"--body {other} selects the other body."
        )
        recording = replace(recording, warnings=(*recording.warnings, text))
    body = recording.bodies[name]
    return Case(
        I_rotor=inertia,
        I_casing=inertia,
        label="",
        surface="",
        casing=replace(series_of([body]), window=None),
        rotor=no_series(),
        recordings={"casing": recording},
        placements={
            "casing": Placement("casing", 0.0, 0.0, 1.0, 0.0, 0.0, ambiguous=False, method="one film")
        },
        bodies="one",
        warnings=recording.warnings,
        extra={"sense": recording.sense, "smoothing_width": body.smoothing_width},
    )


def picture_path(source: Path, target: Path) -> Path | None:
    """Return the path of the picture of a body that is tracked by its texture; None for a table or recording."""
    return target.with_suffix(".png") if is_film(source) else None


class BodyResponse(TypedDict):
    """First-order response of the body to recorded inputs, from the fit."""

    label: str  #: Name of the case.
    body: str  #: Name of the body.
    time_constant: StoredEstimate  #: Moment of inertia divided by the coefficient of linear drag.
    gains: dict[str, StoredEstimate]  #: Change of the final speed per unit of an input, by input.
    delays: dict[str, StoredEstimate]  #: Dead time of each input whose dead time is fitted, by input.


class SpindownDocument(TypedDict):
    """The motion of one body, its torque law, and the written files."""

    case: Path | None  #: The case; null for light gates, which measure no angle.
    picture: Path | None  #: Picture of the tracked body; null for a table or recording.
    motion: BodyMotion  #: The motion.
    response: Response | None  #: Response to a drive without a fit; null for a free body or with `--input`.
    reading: list[ReadingDocument]  #: Interpretation of the columns of a table.
    ambiguous: bool  #: Whether a doubt remains, for example about the hub; the exit code is then 3.
    report: Path | None  #: The report; null without a diagnosis.
    oscillator: OscillatorLaws | None  #: Laws of an oscillation; null for another motion.
    first_order: list[BodyResponse]  #: Response to recorded inputs, with `--input`.
    laws: Sequence[LawOfBody]  #: Fitted laws; empty without a torque law.
    ladder: list[StepDocument]  #: Fits, oldest first.
    diagnosis: DiagnosisDocument | None  #: Diagnosis of the first fit; null without a torque law.
    warnings: list[str]  #: Warnings.


def spindown(
    source: Path,
    target: Path,
    report: Path | None,
    options: SpindownOptions,
    *,
    command: str,
    force: bool = False,
    progress: Progress | None = None,
) -> SpindownDocument:
    """Measure the motion of one body, fit, diagnose, improve, write case and report; return the JSON document."""
    from fitting._workers import single_blas_thread

    with single_blas_thread():
        found = _passages(source, options)
        if found is None:
            found = _analysed(
                source, target, report, options, command=command, force=force, progress=progress
            )
        return cast(SpindownDocument, found)


_LEAST_RANGE = 10  # smallest range of the angle for which a rotation is found, in standard uncertainties


def _analysed(
    source: Path,
    target: Path,
    report: Path | None,
    options: SpindownOptions,
    *,
    command: str,
    force: bool,
    progress: Progress | None,
) -> dict[str, Any]:
    from fitting._criteria import DEFAULT
    from fitting._errors import FittingError
    from fitting._workers import WorkerPool
    from fitting.discovery._oscillator import fit_oscillator, oscillator_laws
    from fitting.discovery._select import improve, rank
    from fitting.discovery._verdict import diagnose
    from fitting.effects._library import REDUCED
    from fitting.inference._first_order import first_order
    from fitting.inference._fit import fit
    from fitting.study._serialisation import diagnosis_document

    picture = picture_path(source, target)
    read = read_source(source, options, progress)
    case, body = read.case, read.film
    series = case.casing
    if case.quantity == "omega" and not np.any(series.window):
        motion = motion_of_speeds(series.time, series.omega, series.omega_sigma, series.angle)
    else:
        motion = motion_of(series.time, series.angle, series.sigma)
    drives = drives_of(case)
    drive = None if motion.kind == "oscillation" and not drives else _drive(read)
    if drive is None and motion.kind == "steady":
        # equal speeds at both ends, or an acceleration without significance, do not show a constant speed
        drive = drive_from_rest(series, case.quantity)
    if drive is not None and motion.kind == "fluctuating" and not drives:
        drive = replace(drive, response=None)
    elif drive is not None:
        motion = replace(
            motion,
            kind="driven",
            period=None,
            omega=drive.omega or motion.omega,
            omega_u=drive.omega_u or motion.omega_u,
        )
    elif drives:
        motion = replace(motion, kind="driven", period=None)
    if body is not None:
        recording = case.recordings["casing"]
        motion = (
            with_pivot_errors(motion, series, recording, body[1])
            if isinstance(body[1], TrackedPoint)
            else _with_view_errors(motion, series, recording, body[1])
        )
    elif read.table is not None and read.table.changes is not None:
        moved = [motion_of(series.time, series.angle + c, series.sigma) for c in read.table.changes.T]
        motion = with_differences(motion, moved)
    # an uncertainty that all angles share, for example due to the distance of the hub, also scales the range
    usual = min(float(np.median(series.sigma)), white_noise(series.angle, series.time))
    if motion.turns * TURN < _LEAST_RANGE * usual:
        what = f"No rotation was found in {source}: the angle ranges over {motion.turns * TURN:.2g} rad"
        hint = "state the unit of the angle."
        if body is not None:
            hint = "give the hub of a film with --hub X,Y." if options.hub is None else "check the hub."
        raise TrackingError(
            f"{what}, and its uncertainty is {usual:.2g} rad.", f"Check that this is the right file; {hint}"
        )
    settings = {
        "source": source,
        "hub": options.hub,
        "point": options.point,
        "colour": options.colour,
        "scale": options.scale,
        "tilt": None if options.tilt is None else vars(options.tilt),
        "capture_fps": options.capture_fps,
        "inertia": options.inertia,
        "inputs": list(options.inputs),
    }
    write_case(target, case, command=command, settings=settings, force=force)
    ambiguous = any(doubts_of(recording) for recording in case.recordings.values())
    ambiguous |= bool(case.extra.get("doubts"))
    if body is None:
        picture = None
    else:
        assert picture is not None  # noqa: S101 - `body` is of a film
        if isinstance(body[1], TrackedPoint):
            write_point_picture(picture, body[0], body[1], force=force)
        else:
            write_body_picture(picture, body[0], body[1], force=force)
        body = None  # releases the pictures of the film
    recorder: Recorder | None = None
    laws: OscillatorLaws | None = None
    strengths: tuple[LawOfBody, ...] = ()
    responses: list[dict[str, Any]] = []
    diagnosis: DiagnosisDocument | None = None
    warnings = list(case.warnings)
    written = None
    document = {
        "case": target,
        "picture": picture,
        "motion": motion,
        "response": None if drive is None or drives else drive.response,
        "reading": case.extra.get("reading", []),
        "ambiguous": ambiguous,
    }
    if not drives and (drive is not None or motion.kind == "fluctuating"):
        reason = "its speed rises and falls repeatedly"
        if drive is not None and motion.kind == "driven":
            reason = drive.reason
        text = f"No torque law: the body is driven ({reason}), so its friction is not determined."
        if read.table is not None:
            text += " If a column is the drive, repeat with --input NAME=COLUMN."
        warnings.append(text)
        nothing = dict.fromkeys(("report", "oscillator", "diagnosis"))
        return {**document, **nothing, "first_order": [], "laws": [], "ladder": [], "warnings": warnings}
    try:
        study = open_study([target], None)
        laws = oscillator_laws(study.data[0]) if motion.period is not None else None
        with WorkerPool() as workers:
            # A new history, independent of earlier fits of this case. An oscillation needs a restoring torque from the
            # start, because other laws would imitate a missing restoring torque.
            if drives:
                base = _first_order_fit(study.data, [i.name for i in drives])
            elif laws is None:
                base = fit(study.model(REDUCED), study.data)
            else:
                laws, base = fit_oscillator(laws, study.model, study.data[0])
            parent = study.ledger.add(base).fit_id
            _check_law(motion, base)
            lost = "" if laws is None else laws.wrong_period(base)
            document["ambiguous"] = ambiguous or bool(lost)
            _refuse(lost)
            recorder = study.recorder(parent, base)
            reversals = len(base.problem.data[0].motion.reversals)
            long = DEFAULT.refits_through(reversals) == 1
            # an exact fit over hundreds of reversals takes long, so the averaged equations are used instead
            first = rank(base, refitting=False) if long and laws is not None else None
            steps = None if not long else int(laws is None)
            history = improve(base, [], max_steps=steps, first=first, workers=workers, keep=recorder)
            if long:
                tried = (
                    "one effect was added"
                    if laws is None
                    else "no law was fitted except those that amplitude and phase show"
                )
                warnings.append(
                    f"The oscillation has {reversals} reversals: {tried}; `gyrotrack improve` "
                    "continues the search."
                )
            if history.stopped:
                warnings.append(f"The search stopped: {history.stopped}")
            _check_law(motion, history[-1].fit, final=True)
            found = diagnose(base, [], candidates=history[0].candidates, history=history, workers=workers)
            supported = _supported(base, history, found.verdict)
            if laws is not None:
                # the last supported fit that is consistent with amplitude and phase
                fits = [base] if supported is base else [step.fit for step in reversed(history)]
                found_laws = [laws.with_fit(f) for f in fits]
                laws, disagreement = next((f for f in found_laws if not f[1]), found_laws[-1])
                warnings += [disagreement] if disagreement else []
            strengths = laws_of_body(supported)
            responses = [] if base.verdict == "not_converged" else [vars(r) for r in first_order(base)]
            study.keep_diagnosis(parent, found, [])
            diagnosis = diagnosis_document(found, parent)
            if report is not None:
                shown = study.steps_to(None)
                recordings = [read_case(target)]
                where = {"command": command, "ledger": str(study.ledger.path)}
                write_report(
                    report,
                    shown,
                    found,
                    recordings=recordings,
                    films=[source.parent],
                    provenance=where,
                    force=force,
                )
                written = report
    except FittingError as error:
        missing = "diagnosis" if recorder is not None and len(recorder.entries) > 1 else "torque law"
        warnings.append(f"No {missing}: {error.message.rstrip('.')}.")
    return {
        **document,
        "report": written,
        "oscillator": laws,
        "first_order": responses,
        "laws": strengths,
        "ladder": [] if recorder is None else [entry.document["rung"] for entry in recorder.entries],
        "diagnosis": diagnosis,
        "warnings": warnings,
    }


def drives_of(case: Case) -> tuple[Input, ...]:
    """Return the recorded inputs that drive the body: all inputs except temperatures, which are not drives."""
    return tuple(i for i in case.inputs if i.unit != "K")


def _first_order_fit(data: Sequence[CaseData], drives: Sequence[str]) -> Fit:
    """Return the first-order fit of a driven body: viscous friction, and a torque in proportion to each drive.

    A dead time of a drive is added if there is evidence for it, because laws of friction would imitate it.
    """
    from fitting._errors import FittingError
    from fitting.dynamics._model import Model
    from fitting.inference._fit import fit

    inputs = data[0].record.inputs
    model = changed(
        Model.of(["casing.air.linear"]), [f"casing.input.{name}" for name in drives], (), (), inputs
    )
    found = fit(model, data)
    for name in drives:
        with suppress(FittingError):
            late = fit(changed(found.model, [f"input.{name}.delay"], (), (), inputs), data)
            if late.converged and late.bic < found.bic - found.criteria.evidence:
                found = late
    return found


def _supported(base: Fit, history: Sequence[Step], verdict: str) -> Fit:
    """Return the fit whose laws the answer states: the last fit, or the first fit if no effect is established."""
    return base if verdict in {"undecided", "unexplained"} else history[-1].fit


def _drive(read: Source) -> Drive | None:
    """Return the drive of a body, from the speed and the measured inputs of a table."""
    series, table = read.case.casing, read.table
    inputs: tuple[Driver, ...] = ()
    if table is not None:
        rows = np.searchsorted(table.time, series.time, side="right") - 1
        inputs = tuple(
            replace(i, value=i.value[np.clip(rows, 0, None)])
            for i in table.drivers
            if UNITS.get(clean(i.unit), Unit("1")).si != "K"  # a temperature is not a drive
        )
    pulses = table is not None and table.counted
    return drive_of(series, read.case.quantity, inputs, pulses=pulses)


def _check_law(motion: BodyMotion, fit: Fit, *, final: bool = False) -> None:
    """Raise an error for a rotation without significant acceleration, or an oscillation without a restoring torque."""
    from fitting._errors import FittingError
    from fitting._numbers import rounded

    if motion.kind == "steady" and abs(motion.alpha.value) < 3 * motion.alpha.stderr:
        raise FittingError(
            f"the angular acceleration, {rounded(motion.alpha.value, motion.alpha.stderr, 'rad/s2')}, is consistent "
            "with zero."
        )
    if motion.kind == "reversing":
        raise FittingError(
            "the body turns back, and the record does not show a damped oscillation through at least 1.2 periods. It "
            "does not separate a restoring torque from a drive or from another body."
        )
    if motion.kind != "oscillation":
        return
    if motion.period is None:
        raise FittingError(
            "the motion reverses repeatedly, but is not one damped oscillation: the body is coupled to another one "
            "(beats), driven or disturbed; --from and --to select a part in which it oscillates freely."
        )
    if not len(fit.problem.data[0].motion.reversals):
        raise FittingError("the oscillation has too few turning points to fit a restoring torque.")
    if final and not fit.model.restoring:
        raise FittingError(
            "the motion is an oscillation, and no exact fit with a restoring torque of the library succeeded."
        )


def _refuse(reason: str) -> None:
    """Raise an error if `reason` states why a fit does not describe the motion."""
    from fitting._errors import FittingError

    if reason:
        raise FittingError(reason)


# smallest number of turns in which harmonics of the angle are distinguishable from the motion
_TURNS_WITH_HARMONICS = 2.0


# smallest number of turns in which the error due to a tilt is distinguishable from a multiple of the angle
_FEWEST_TURNS_OF_TILT = 0.5
_STRETCH_U = 0.03
"""Largest standard uncertainty of the stretch s of a fitted ellipse [1]. Derived: (1 - cos phi) / (1 + cos phi) for 20
degrees, the smallest tilt that a result states."""


def _tilt_mode(tracked: Tracked) -> tuple[ErrorMode, ...]:
    """Return the error of the angles of a textured body due to its tilt, if it turns by half a turn to a few turns.

    A circle that is seen as an ellipse with the axis ratio (1 - s) / (1 + s) changes the angles by s times a second
    harmonic. A small fitted s is not distinguishable from noise, so that its error is as large as s. In such a short
    motion this error resembles the effect of a law, for example of gravity at a large amplitude. For more turns the
    error is not needed, because fits include the harmonics of the angle. For less than half a turn the error is nearly
    a multiple of the angle, which a fit cannot separate from the motion.
    """
    u = min(math.hypot(*tracked.ring.stretch), _STRETCH_U)
    if u == 0.0 or not _FEWEST_TURNS_OF_TILT <= np.ptp(tracked.angle) / TURN < _TURNS_WITH_HARMONICS:
        return ()
    basis = np.stack([np.cos(2.0 * tracked.angle), np.sin(2.0 * tracked.angle)], axis=1)
    # a constant error is part of the unknown zero of the angle
    basis -= basis.mean(axis=0)
    text = "error of the angle due to the tilt of the axis"
    return (ErrorMode("tilt", basis, u**2 * np.eye(2), origin="tilt", long_name=text),)


def _with_view_errors(
    motion: BodyMotion, series: Series, recording: Recording, tracked: Tracked
) -> BodyMotion:
    """Add the difference between the inner and the outer half of the ring to the uncertainties.

    Perspective, a displaced hub and objects fixed in the image affect the halves differently; these errors are
    systematic. A displaced hub causes an error of `hub_leverage` times the difference of the halves. In less than two
    turns this error is not distinguishable from the motion. In more turns it is a harmonic of the angle, which
    `motion_of` fits. If the hub is outside the picture, an error of its distance scales all values except times.
    """
    leverage = max(0.5, tracked.hub_leverage) if motion.turns < _TURNS_WITH_HARMONICS else 0.5
    taken = np.isin(np.round(recording.bodies["casing"].time, 9), np.round(series.time, 9))
    inner, outer = (motion_of(series.time, half[taken], series.sigma) for half in tracked.halves)

    def widened(value: Value, a: Value | None, b: Value | None, scale: float = 0.0) -> Value:
        difference = 0.0 if a is None or b is None else leverage * abs(abs(a.value) - abs(b.value))
        return replace(value, stderr=math.hypot(value.stderr, max(difference, scale * abs(value.value))))

    scale = tracked.distance_error

    return replace(
        motion,
        omega_mean=widened(motion.omega_mean, inner.omega_mean, outer.omega_mean, scale),
        alpha=widened(motion.alpha, inner.alpha, outer.alpha, scale),
        period=motion.period and widened(motion.period, inner.period, outer.period),
        amplitude=motion.amplitude and widened(motion.amplitude, inner.amplitude, outer.amplitude, scale),
        decay=motion.decay and widened(motion.decay, inner.decay, outer.decay),
    )
