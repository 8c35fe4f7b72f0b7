"""Extraction of the angles of both bodies from a film."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from fitting._workers import available_cores
from gyrotrack._arrays import Bools, Floats, Plane
from gyrotrack._column_store import in_file, large_blocks_returned, new_columns, release_memory, row_blocks
from gyrotrack._errors import DatasetError, TrackingError, UsageError, VideoError
from gyrotrack._smoothing import WIDTH, angular_velocity
from gyrotrack._versions import __version__
from gyrotrack.io._atomic import CheckpointFile
from gyrotrack.io._hdf5 import read_recording, read_settings, write_recording
from gyrotrack.io._records import BodyTrack, MarkerTrack, Recording, speed_warnings
from gyrotrack.io._schema import STATUS
from gyrotrack.tracking._acquisition import acquire
from gyrotrack.tracking._body_angles import TrackedBodies, join_bodies, trusted_times
from gyrotrack.tracking._camera_motion import Shake, background_roll, camera_shake
from gyrotrack.tracking._corners import paper_angle
from gyrotrack.tracking._film_parts import PartWorkers, frames_done, split, track_film
from gyrotrack.tracking._film_tracker import (
    FilmObservations,
    FilmTracker,
    Progress,
)
from gyrotrack.tracking._frame_repeats import judge_repeats, left_out, without_repeats
from gyrotrack.tracking._fusion import BodyAngles, wrapped
from gyrotrack.tracking._hub import moves_fast
from gyrotrack.tracking._marker_tracker import MarkerObservations
from gyrotrack.tracking._profile import PAPER, Profile, single_threaded
from gyrotrack.tracking._scene import FEWEST, Marker, Scene, take_samples
from gyrotrack.video._container import ClipInfo, file_sha256, probe, read_packets
from gyrotrack.video._decoder import Reader
from gyrotrack.video._time_base import CaptureRate, FrameTimes, Timing, capture_rate

Codes = npt.NDArray[np.int8]


def marker_track(
    marker: Marker,
    seen: MarkerObservations,
    body: BodyAngles,
    centre: Floats,
    sense: int,
    size: tuple[int, int],
) -> MarkerTrack:
    """Build the record of one marker; corners are given only in frames in which the marker is unoccluded."""
    found = body.markers[marker.name]
    kinds = {"corner": ((2, 2), "f8"), "status": ((), "i1"), "angle_fine": ((), "f8")}
    own = new_columns(len(found.angle), kinds)
    for part in row_blocks(len(found.angle)):
        some, angle = seen.at(part), found.angle[part]
        own["status"][part] = status = _status(marker, some, np.isfinite(angle), size)
        own["corner"][part] = np.where((status == STATUS["ok"])[:, None, None], _corners(some), np.nan)
        own["angle_fine"][part] = wrapped(sense * angle)
    measured = paper_angle(own["corner"], centre, own["status"] == STATUS["ok"])
    for part in row_blocks(len(found.angle)):
        measured.angle[part] = wrapped(sense * measured.angle[part])
    return MarkerTrack(
        name=marker.name,
        body=marker.body,
        mount_angle=float(np.angle(np.exp(1j * sense * found.mount))),
        corner=own["corner"] if sense > 0 else own["corner"][:, ::-1],
        **vars(measured),
        status=own["status"],
        angle_fine=own["angle_fine"],
        sigma_calibrated=found.sigma,
    )


def _corners(seen: MarkerObservations) -> Floats:
    """Return the near corners in the picture, (n, 2, 2) [px], in the order of their angles as seen."""
    x = seen.centre[:, None, 0] + seen.corner_radius * np.cos(seen.corner_angle)
    y = seen.centre[:, None, 1] - seen.corner_radius * np.sin(seen.corner_angle)
    return np.stack([x, y], axis=-1)


def _status(marker: Marker, seen: MarkerObservations, used: Bools, size: tuple[int, int]) -> Codes:
    """Return the status of a marker in each frame.

    ok: unoccluded, with both corners. blurred: unoccluded, but without corners. occluded: a part is occluded.
    out_of_frame: a part is outside the picture. lost: not found at the expected position.
    """
    status = np.full(len(used), STATUS["lost"], dtype=np.int8)
    status[np.isfinite(seen.angle) & ~seen.open] = STATUS["occluded"]
    status[used & seen.open] = STATUS["blurred"]
    status[used & seen.open & np.isfinite(seen.corner_angle).all(axis=1)] = STATUS["ok"]
    status[seen.outside(marker.inner, marker.outer, 0.7 * marker.half_width, size)] = STATUS["out_of_frame"]
    return status


def body_track(
    name: str, body: BodyAngles, markers: dict[str, MarkerTrack], time: Floats, sense: int, fps: float
) -> BodyTrack:
    """Build the record of one body from the frames in which its angle is known.

    `sigma_paper` is the uncertainty as defined in the paper (see `_corners`), for the mean of the n unoccluded markers
    of a frame: sqrt(sum sigma_m^2) / n. It is NaN without such markers.
    """
    use = np.isfinite(body.angle)
    angle, sigma = sense * body.angle[use], body.sigma[use]
    columns = {"time": time[use], "angle": angle, "sigma": sigma, "n_markers": body.count[use]}
    columns["sigma_paper"] = _paper_sigma([markers[m].sigma for m in body.markers])[use]
    columns["omega"], columns["omega_sigma"] = angular_velocity(columns["time"], angle, sigma, WIDTH)
    stored: dict[str, Any] = dict(in_file(columns))
    return BodyTrack(
        name=name,
        smoothing_width=WIDTH,
        correlated_sigma=body.slow[0],
        correlated_time=body.slow[1] / fps,
        correlated_profile=_profile(body.slow_parts, time),
        periodic_sigma=body.periodic,
        harmonic_sigma=body.harmonic,
        **stored,
    )


_MOST_PARTS = 1000
"""Largest number of parts of a film whose uncertainty is stored [1]. Chosen: an attribute of HDF5 can contain 4000; a
smaller number rounds the change of the uncertainty in long films."""


def _profile(parts: Floats, time: Floats) -> tuple[tuple[float, float], ...]:
    """Return times [s] and standard uncertainties [rad] of the slowly varying error in parts of a film."""
    kept = parts[:: max(1, -(-len(parts) // _MOST_PARTS))]
    known = np.flatnonzero(np.isfinite(time))
    if not len(known):
        return ()
    kept = kept[(kept[:, 0] >= known[0]) & (kept[:, 0] <= known[-1])]
    at = np.interp(kept[:, 0], known, time[known])
    return tuple((float(t), float(u)) for t, u in zip(at, kept[:, 1], strict=True))


def _paper_sigma(own: list[Floats]) -> Floats:
    """Return sqrt(sum sigma_m^2) / n per frame over the n markers with a known uncertainty; NaN without any."""
    out = np.empty(len(own[0]))
    for part in row_blocks(len(out)):
        sigma = np.stack([one[part] for one in own])
        known = np.isfinite(sigma)
        count = known.sum(axis=0)
        total = np.sqrt((np.where(known, sigma, 0.0) ** 2).sum(axis=0))
        out[part] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return out


BODIES = (None, "casing", "rotor", "both")
LEAST_TURN = 0.5
"""Smallest range of an angle for which a body counts as turning [rad]. Chosen: a smaller value reports noise as a
rotation, a larger one warns about slow bodies."""


def extract(
    video: Path,
    profile: Profile = PAPER,
    *,
    capture_fps: float | None = None,
    body: str | None = None,
    times: str = "auto",
    threads: int = 2,
    workers: int | None = 1,
    progress: Progress | None = None,
    journal: CheckpointFile | None = None,
) -> Recording:
    """Track the markers of a profile in a film.

    Without `capture_fps` the capture rate is taken from the profile, the camera's tag, or the container (if it is 100
    fps or more). `body`: "casing" tracks the casing only; "rotor" and "both" raise an error if the body is not visible;
    with "rotor" a visible casing is tracked as well, because synchronisation needs the casing. `times`: "frames" uses
    frame numbers divided by the capture rate, "stamps" uses the timestamps of the film, and "auto" uses the timestamps
    only if they show a varying rate and the film is not in slow motion. The result does not depend on the number of
    `workers` (None: one per core). The `journal`, created with `run_facts`, stores intermediate results, so that a
    killed run can be resumed.
    """
    if body not in BODIES:
        what = f"Unknown body {body!r}; use casing, rotor or both."
        raise UsageError(what, "Omit --body to track all visible bodies.")
    video = Path(video)
    info = probe(video)
    rate = capture_rate(info, capture_fps, profile.capture_fps)
    timing = Timing(times, rate.fps)
    if body == "casing":
        profile = _only_casing(profile)
    scene, seen, shake = _observe(video, profile, threads, workers, progress, timing, journal)
    release_memory()
    if len(seen.pts_time) < FEWEST:  # a damaged film may have fewer decodable frames than samples
        what = f"Only {len(seen.pts_time)} frames of {video} can be decoded."
        raise VideoError(what, "Copy the film from the camera again.")
    still = seen if shake is None else _stabilised(seen, shake)
    found = judge_repeats(still, scene)
    when, rate = without_repeats(trusted_times(still, scene), found, rate, info)
    seen = left_out(seen, when)
    joint = join_bodies(seen if shake is None else _stabilised(seen, shake), scene, profile, rate.fps)
    if shake is not None:
        joint = _as_seen(joint, scene, shake)
    elif seen.disc is not None and moves_fast(seen.disc):
        joint = replace(joint, warnings=(_UNKNOWN_ROLL, *joint.warnings))
    _check_bodies(joint, body, video)
    sha256 = str(journal.facts["film"]) if journal else file_sha256(video)
    return _recording(info, sha256, rate, scene, seen, joint)


_UNKNOWN_ROLL = (
    "The camera shakes, and no background shows whether it rolls. A roll of the camera would change all angles; the "
    "uncertainties do not include it."
)


def _observe(
    video: Path,
    profile: Profile,
    threads: int,
    workers: int | None,
    progress: Progress | None,
    timing: Timing,
    journal: CheckpointFile | None,
) -> tuple[Scene, FilmObservations, Shake | None]:
    """Find and track the markers; measure the motion of the camera if the background is visible."""
    with PartWorkers(video, workers) as processes, single_threaded():
        samples = take_samples(video, workers or available_cores())
        scene = acquire(samples, profile, str(video))
        tracker = FilmTracker(scene, samples)
        with Reader(video, threads) as reader:
            body = (*scene.centre, _BODY * max(marker.outer for marker in scene.markers))
            shake = camera_shake([frame.y for frame in samples.frames], (frame.y for frame in reader), body)
        del samples  # free memory: the samples are as large as the buffers of the tracker
        release_memory()
        with large_blocks_returned():
            seen = track_film(processes, video, scene, tracker, threads, progress, timing, journal)
        if shake is None and seen.disc is not None and moves_fast(seen.disc):
            with Reader(video, threads) as reader:
                planes = (frame.y for frame in reader)
                shake = background_roll(_counted(planes, len(seen.pts_time), progress), body)
        whole = shake is not None and len(shake.roll) == len(seen.pts_time)
        return scene, seen, shake if whole else None


def _counted(planes: Iterable[Plane], count: int, progress: Progress | None) -> Iterator[Plane]:
    """Yield the pictures of a film of `count` frames, and report their number."""
    for k, plane in enumerate(planes):
        if progress is not None:
            progress(k + 1, count)
        yield plane


def _stabilised(seen: FilmObservations, shake: Shake) -> FilmObservations:
    """Return disc and markers as seen by a camera at rest; the corners of the markers are not used.

    This correction is needed because the position of the hub is smoothed over many frames, and a moving camera
    displaces the hub from frame to frame.
    """
    # the roll is clockwise in the picture, angles are counter-clockwise
    bodies = {}
    for name, body in seen.bodies.items():
        markers = {
            m: replace(own, angle=own.angle + shake.roll, centre=shake.still(own.centre))
            for m, own in body.markers.items()
        }
        rings = {
            kind: ring and replace(ring, angle=ring.angle + shake.roll, centre=shake.still(ring.centre))
            for kind, ring in (("texture", body.texture), ("aligned", body.aligned))
        }
        bodies[name] = replace(body, coarse=body.coarse + shake.roll, markers=markers, **rings)
    return replace(seen, bodies=bodies, disc=None if seen.disc is None else shake.still(seen.disc))


def _as_seen(joint: TrackedBodies, scene: Scene, shake: Shake) -> TrackedBodies:
    """Return the centre as seen by the moving camera; all angles include the uncertainty of the camera's motion."""
    centre = replace(
        joint.centre,
        centre=shake.seen(joint.centre.centre),
        sigma=np.hypot(joint.centre.sigma, shake.shift_sigma),
    )
    bodies, largest = {}, 0.0
    for name, body in joint.bodies.items():
        radius = float(np.mean([marker.radius for marker in scene.of(name)]))
        own = float(np.hypot(shake.roll_sigma, shake.shift_sigma / radius))
        largest = max(largest, own)
        markers = {m: replace(one, sigma=np.hypot(one.sigma, own)) for m, one in body.markers.items()}
        bodies[name] = replace(body, markers=markers, sigma=np.hypot(body.sigma, own))
    rolls = f"rolls by {1e3 * shake.roll.std():.2g} mrad rms" if shake.roll.any() else ""
    included = f"Its uncertainty of {1e3 * largest:.2g} mrad is included."
    if shake.features:
        also = rolls and f" and {rolls}"
        text = (
            f"The camera moves by {shake.rms:.2g} px rms{also}; {shake.features} features of the background are used "
            f"to subtract this. {included}"
        )
    elif rolls:
        text = f"The camera {rolls}; the whole background is used to subtract this. {included}"
    else:
        text = f"The background shows no significant roll of the camera. {included}"
    return replace(joint, centre=centre, bodies=bodies, warnings=(text, *joint.warnings))


def _recording(
    info: ClipInfo, sha256: str, rate: CaptureRate, scene: Scene, seen: FilmObservations, joint: TrackedBodies
) -> Recording:
    """Build the recording of a film."""
    time = seen.times.seconds(rate.fps)
    markers, bodies = {}, {}
    for name, found in joint.bodies.items():
        for m in scene.of(name):
            own = seen.bodies[name].markers[m.name]
            markers[m.name] = marker_track(m, own, found, joint.centre.centre, joint.sense, seen.size)
        bodies[name] = body_track(name, found, markers, time, joint.sense, rate.fps)
    at_rest = _rest_warning(joint, info.path, marked=scene.disc is not None)
    of_rate = (
        rate.warnings if seen.times.place is None else ()
    )  # with timestamps, the capture rate is not used
    film = (*of_rate, *seen.warnings, *seen.times.warnings)
    doubts = (*joint.doubts, *_doubts(scene, bodies, time), *_without_corners(markers))
    remedy = (
        f"`gyrotrack profile {info.path.name} -o P.toml`, exchange the names of the bodies in it, and "
        f"`gyrotrack extract {info.path.name} --profile P.toml`"
    )
    speeds = speed_warnings(bodies["casing"], bodies["rotor"], remedy) if len(bodies) == 2 else ()
    warnings = (
        *at_rest,
        *film,
        *scene.warnings,
        *_unseen(scene),
        *joint.warnings,
        *_first_frame_warning(markers),
        *speeds,
        *doubts,
    )
    return Recording(
        source=info.path.name,
        source_sha256=sha256,
        width=seen.size[0],
        height=seen.size[1],
        capture_fps=rate.fps,
        container_fps=info.container_fps,
        frames_declared=info.frames_declared,
        frames_decoded=len(time),
        sense=joint.sense,
        body="both" if len(bodies) == 2 else next(iter(bodies)),
        frame_index=seen.times.number,
        time=time,
        pts_time=seen.pts_time,
        centre=joint.centre.centre,
        centre_sigma=joint.centre.sigma,
        markers=markers,
        bodies=bodies,
        warnings=warnings,
        extra={**_extra(scene, joint, rate.source, seen.times), "doubts": list(doubts)},
    )


_BODY = 1.5
"""Radius of the bodies, for example the ring of the casing, relative to the outer end of the markers [1]. Chosen: a
smaller value takes the rim for the background, a larger one leaves no background."""
LEAST_TRACKED = 0.8
"""Smallest share of frames with an angle for which no warning is given [1]. Chosen: a smaller value accepts poor
films, a larger one doubts films with a hand at the start."""
_STEPS = 12
"""Number of frames over which the speed on either side of a gap is measured [frames]. Chosen: a smaller number measures
noise, a larger one includes a change of the speed."""


def _doubts(scene: Scene, bodies: dict[str, BodyTrack], time: Floats) -> tuple[str, ...]:
    """Return reasons to inspect a recording: lost frames, gaps with an unknown number of turns, missing markers."""
    found = list(scene.doubts)
    for name, track in bodies.items():
        found += track_doubts(name, track, len(time), "an overlay of the film (--overlay)")
        absent = [m for m in scene.missing if scene.body_of.get(m) == name]
        if absent:
            found.append(
                f"No {' and no '.join(absent)} marker is found on the {name}. "
                "Check the film and the profile (--profile)."
            )
    return tuple(found)


_FEWEST_CORNERS = 0.05
"""Smallest share of the frames in which the near corners of a rectangular paper marker are found [1]. Measured: 0.06
and more for each marker of 60 rendered films, 1 for the marker of a slow casing, 0 for the red tips of a wind turbine.
A larger value doubts films of a blurred rotor, a smaller one accepts coloured patches of other bodies."""


def has_corners(markers: Iterable[MarkerTrack]) -> bool:
    """Return whether a marker shows its near corners in at least the share `_FEWEST_CORNERS` of the frames."""
    return any(np.isfinite(m.rho).mean() >= _FEWEST_CORNERS for m in markers if len(m.rho))


def _without_corners(markers: dict[str, MarkerTrack]) -> tuple[str, ...]:
    if not markers or has_corners(markers.values()):
        return ()
    text = (
        "No marker shows its near corners, so the coloured patches may not be rectangles of paper, and the centre of "
        "rotation may be wrong. Inspect the contact sheet (--contact-sheet), or use `gyrotrack spindown`."
    )
    return (text,)


_GAP = 3.5
"""Smallest time between two angles in which turns may be lost [median times between angles]. Chosen: a smaller value
doubts single missing frames, a larger one overlooks lost turns."""


def track_doubts(name: str, track: BodyTrack, count: int, inspect: str) -> list[str]:
    """Return warnings about a track: angles in too few of `count` frames, gaps with an unknown number of turns.

    The number of turns is unknown if the angular rates before and after the gap predict angles that differ by more
    than half a turn.
    """
    found = []
    if len(track.time) < LEAST_TRACKED * count:
        found.append(
            f"The {name} has an angle in {len(track.time)} of {count} frames "
            f"({len(track.time) / max(count, 1):.0%}). Inspect {inspect}."
        )
    step = np.diff(track.time)
    period = float(np.median(step)) if len(step) else np.inf
    gaps = [int(k) for k in np.flatnonzero(step > _GAP * period) if k >= _STEPS and k + _STEPS < len(step)]
    rates = [
        (track.angle[k] - track.angle[k - _STEPS]) / (track.time[k] - track.time[k - _STEPS])
        - (track.angle[k + 1 + _STEPS] - track.angle[k + 1])
        / (track.time[k + 1 + _STEPS] - track.time[k + 1])
        for k in gaps
    ]
    hidden = [k for k, rate in zip(gaps, rates, strict=True) if abs(rate) * step[k] > np.pi]
    if hidden:
        found.append(
            f"The number of turns of the {name} is not determined in {len(hidden)} gap(s), the first of "
            f"{step[hidden[0]]:.3g} s at {track.time[hidden[0]]:.3f} s. The angular rates before and after the gap "
            "predict angles that differ by more than half a turn."
        )
    return found


def _unseen(scene: Scene) -> tuple[str, ...]:
    """Return a warning for each body of the profile without any marker in the film."""
    found = {marker.body for marker in scene.markers}
    absent: dict[str, list[str]] = {}
    for name, body in scene.body_of.items():
        if body not in found:
            absent.setdefault(body, []).append(name)
    return tuple(
        f"The {body} is not tracked: no {' and no '.join(names)} marker is found."
        + (" Synchronisation needs the casing in every film." if body == "casing" else "")
        for body, names in absent.items()
    )


def run_facts(video: Path, profile: Profile, body: str | None, times: str = "auto") -> dict[str, Any]:
    """Return the facts that identify a run: content of the film, settings, and program version."""
    probe(video)
    return {
        "film": file_sha256(video),
        "profile": profile.model_dump(mode="json"),
        "body": body,
        "times": times,
        "version": __version__,
    }


def _only_casing(profile: Profile) -> Profile:
    markers = profile.of("casing")
    if not markers:
        raise UsageError(f"The profile {profile.name} has no marker on the casing.", "Omit --body.")
    return profile.model_copy(update={"marker": markers})


def _check_bodies(joint: TrackedBodies, body: str | None, video: Path) -> None:
    wanted = ("casing", "rotor") if body == "both" else (body,) if body else ()
    for name in wanted:
        if name not in joint.bodies:
            what = f"The {name} is not visible in {video}."
            raise TrackingError(what, "Check the colours of the profile (--profile), or omit --body.")
    if not joint.bodies:
        what = f"No body can be tracked in {video}: its markers do not move steadily about a centre."
        raise TrackingError(what, "Check the colours of the profile (--profile) and inspect the film.")


def _rest_warning(joint: TrackedBodies, video: Path, *, marked: bool) -> tuple[str, ...]:
    """Return a warning for a film without rotation, in which only a disc determines the centre."""
    turn = {name: float(np.nanmax(body.angle) - np.nanmin(body.angle)) for name, body in joint.bodies.items()}
    if max(turn.values()) >= LEAST_TURN:
        return ()
    most = " and ".join(f"the {name} by {by:.2f} rad" for name, by in turn.items())
    about = "" if marked else " No disc marks the centre of rotation."
    return (f"Nothing turns in {video.name}: the angles hardly change ({most} in total).{about}",)


def _first_frame_warning(markers: dict[str, Any]) -> tuple[str, ...]:
    """Return a warning if all markers of the first frame are away from the predicted positions, as before a cut."""
    if any(len(m.status) < 10 for m in markers.values()):
        return ()
    status = [m.status for m in markers.values()]
    if not all(s[0] == STATUS["lost"] and np.any(s[1:6] == STATUS["ok"]) for s in status):
        return ()
    return (
        "Frame 0 is omitted: it does not match the following motion (for example a still image before the film).",
    )


def _extra(scene: Scene, joint: TrackedBodies, rate_source: str, times: FrameTimes) -> dict[str, Any]:
    return {
        "times_from": "frames" if times.place is None else "stamps",
        "repeated_frames": 0 if times.again is None else int(times.again.sum()),
        "capture_rate_from": rate_source,
        "centre_from": "disc" if scene.disc else "orbit",
        "centre_smoothing_reach": joint.centre.reach,
        "missing_markers": list(scene.missing),
        "tilt": {
            name: {"p": flat.p, "q": flat.q, "angle": flat.tilt, "offset": flat.offset}
            for name, flat in joint.flattening.items()
        },
        "papers": {
            p.name: {k: getattr(p, k) for k in ("inner", "outer", "half_width")}
            | {"contrast": list(p.contrast)}
            for p in scene.markers
        },
    }


Bar = Callable[[], AbstractContextManager[Callable[[int, int | None], None]]]


@dataclass(frozen=True)
class ExtractionJob:
    """The extraction of one film: input, output and settings."""

    video: Path  # the film
    target: Path
    profile: Profile
    # capture rate of the camera [1/s]; None: the rate of the profile or of the film
    capture_fps: float | None = None
    body: str | None = None
    times: str = "auto"  # auto, stamps or frames; see `extract`
    # number of processes that track parts of the film; None: one per core. The result does not depend on this number
    workers: int | None = 1

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that determine the result, as stored in the file."""
        own = {key: getattr(self, key) for key in ("video", "capture_fps", "body", "times")}
        return own | {"profile": self.profile.model_dump(mode="json")}

    def earlier(self) -> Recording | None:
        """Return the existing output if it was made from this film with these settings, else None."""
        probe(self.video)
        try:
            same = {**read_settings(self.target), "video": None} == {**self.settings, "video": None}
            recording = read_recording(self.target) if same else None
        except DatasetError:
            return None
        if recording is None or recording.source_sha256 != file_sha256(self.video):
            return None
        # checkpoint of a run that was killed just after writing the output
        with CheckpointFile(self.target, {}) as journal:
            journal.discard()
        return recording

    def run(
        self,
        *,
        command: str,
        bar: Bar,
        tell: Callable[[str], None],
        resume: bool = False,
        force: bool = False,
    ) -> tuple[Recording, float]:
        """Track the film and write the output; return the recording and the number of frames tracked per second.

        `tell` is called with messages: the limit of the number of processes, the start of a resumed run, and the
        stored frames after an interruption. With `resume` the checkpoint of an earlier run is continued.
        """
        with CheckpointFile(
            self.target, run_facts(self.video, self.profile, self.body, self.times), resume=resume
        ) as journal:
            taken = frames_done(journal)
            if origin := _resumed(journal, taken):
                tell(origin)
            if limit := self._limit_of_processes():
                tell(limit)
            start = perf_counter()
            try:
                with bar() as progress:
                    own = {k: getattr(self, k) for k in ("capture_fps", "body", "times", "workers")}
                    recording = extract(self.video, self.profile, **own, progress=progress, journal=journal)
            except KeyboardInterrupt:
                if kept := frames_done(journal):
                    word = "" if resume else " and --resume"
                    tell(f"{kept} frames are stored. Continue with the same command{word}.")
                raise
            rate = (recording.frames_decoded - taken) / max(perf_counter() - start, 1e-9)
            write_recording(self.target, recording, command=command, settings=self.settings, force=force)
            journal.discard()
        return recording, rate

    def _limit_of_processes(self) -> str:
        """Return a message if the film has fewer parts than the allowed number of processes, else None."""
        allowed, parts = self.workers or available_cores(), len(split(read_packets(self.video)))
        if allowed <= parts or (self.workers is None and parts == 1):
            return ""
        what = "one part" if parts == 1 else f"{parts} parts at key frames"
        return f"The film is divided into {what} and tracked by {parts} of {allowed} processes."


def _resumed(journal: CheckpointFile, taken: int) -> str:
    if taken:
        return f"{taken} frames of an earlier run are used."
    if journal.other:
        return f"{journal.path.name} belongs to another film, profile or version; tracking starts from the first frame."
    return ""
