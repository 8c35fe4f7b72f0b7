"""Extracting the angles of both bodies from a film: the whole way, in one function that writes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gyrotrack import __version__
from gyrotrack.dataset.journal import Journal
from gyrotrack.dataset.records import STATUS, Recording
from gyrotrack.errors import TrackingError, UsageError, VideoError
from gyrotrack.geometry.acquisition import acquire
from gyrotrack.geometry.samples import FEWEST, take_samples
from gyrotrack.geometry.scene import Scene
from gyrotrack.pipeline.assembly import body_track, marker_track
from gyrotrack.pipeline.freed import give_back
from gyrotrack.pipeline.joint import Joint, join_bodies, trusted_times
from gyrotrack.pipeline.notes import Notes
from gyrotrack.pipeline.repeated import judge_repeats, left_out, without_repeats
from gyrotrack.pipeline.timing import FrameTimes, Timing
from gyrotrack.pipeline.watch import Progress, Tracker, Watched, watch
from gyrotrack.profile import PAPER, Profile
from gyrotrack.segmentation.single_thread import single_threaded
from gyrotrack.video import CaptureRate, ClipInfo, capture_rate, file_sha256, probe

BODIES = (None, "casing", "rotor", "both")
HARDLY = 0.5
"""Turn in rad of all bodies up to which a film is said to show none."""


def extract(
    video: Path,
    profile: Profile = PAPER,
    *,
    capture_fps: float | None = None,
    body: str | None = None,
    times: str = "auto",
    threads: int = 2,
    progress: Progress | None = None,
    journal: Journal | None = None,
) -> Recording:
    """Track the markers in a film.

    Parameters
    ----------
    video : Path
        The film.
    profile : Profile
        Its markers.
    capture_fps : float, optional
        Frames per second of the camera; without it the profile's, the camera's tag, or the container's from
        100 fps.
    body : {"casing", "rotor", "both"}, optional
        "casing" looks at nothing else. "rotor" and "both" fail when that body is not seen; with "rotor" the
        casing is kept where it is seen, because synchronising needs it. Without it all that is seen is kept.
    times : {"auto", "stamps", "frames"}
        Where the times are from: counted frames over the capture rate; the film's time stamps; or the stamps where
        they are spaced as unevenly as a camera's whose rate varied, in a film that is not in slow motion.
    threads : int
        Threads of the decoder.
    progress : callable, optional
        Called with (frames done, frames declared or None).
    journal : Journal, optional
        Keeps what was measured on the way, and lets a run go on that was killed; made with `run_facts`.

    Raises
    ------
    VideoError
        The film cannot be read, or its capture rate is unknown.
    TrackingError
        No markers, or not the body that was asked for.

    Examples
    --------
    >>> from pathlib import Path
    >>> recording = extract(Path("casing.mp4"))  # doctest: +SKIP
    >>> recording.bodies["casing"].angle  # doctest: +SKIP
    """
    if body not in BODIES:
        raise UsageError(
            f"a body is casing, rotor or both, not {body}", "leave it out to keep all that is seen"
        )
    video = Path(video)
    info = probe(video)
    rate = capture_rate(info, capture_fps, profile.capture_fps)
    timing = Timing(times, rate.fps)
    if body == "casing":
        profile = _only_casing(profile)
    scene, seen = _seen(video, profile, threads, progress, timing, Notes(journal))
    give_back()
    if len(seen.pts_time) < FEWEST:  # damage may leave fewer than the samples promised
        raise VideoError(
            f"only {len(seen.pts_time)} frames of {video} can be decoded", "copy it from the camera again"
        )
    found = judge_repeats(seen, scene)
    when, rate = without_repeats(trusted_times(seen, scene), found, rate, info)
    seen = left_out(seen, when)
    joint = join_bodies(seen, scene, profile, rate.fps)
    _check_bodies(joint, body, video)
    sha256 = str(journal.facts["film"]) if journal else file_sha256(video)
    return _recording(info, sha256, rate, scene, seen, joint)


def _seen(
    video: Path, profile: Profile, threads: int, progress: Progress | None, timing: Timing, notes: Notes
) -> tuple[Scene, Watched]:
    """Find the markers and watch them through the film; what they need is let go of with the end of this."""
    samples = take_samples(video)
    with single_threaded():
        scene = acquire(samples, profile, str(video))
        tracker = Tracker(scene, samples)
        del samples  # as large as all that is held on the way
        give_back()
        return scene, watch(video, scene, tracker, threads, progress, timing, notes)


def _recording(
    info: ClipInfo, sha256: str, rate: CaptureRate, scene: Scene, seen: Watched, joint: Joint
) -> Recording:
    """Put together what the dataset keeps of a film."""
    time = seen.times.seconds(rate.fps)
    markers = {
        paper.name: marker_track(
            paper, seen.bodies[name].markers[paper.name], found, joint.centre.centre, joint.sense, seen.size
        )
        for name, found in joint.bodies.items()
        for paper in scene.of(name)
    }
    bodies = {
        name: body_track(name, found, markers, time, joint.sense) for name, found in joint.bodies.items()
    }
    still = _stillness(joint, info.path, marked=scene.disc is not None)
    of_rate = rate.warnings if seen.times.place is None else ()  # stamps have said how long a frame lasts
    film = (*of_rate, *seen.warnings, *seen.times.told)
    told = (*still, *film, *scene.warnings, *joint.warnings, *_odd_frames(markers))
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
        warnings=told,
        extra=_extra(scene, joint, rate.source, seen.times),
    )


def run_facts(video: Path, profile: Profile, body: str | None, times: str = "auto") -> dict[str, Any]:
    """Return by what a run is known again: the film's content, what was asked for, and the program."""
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
        raise UsageError(f"the profile {profile.name} has no marker on the casing", "leave out --body")
    return profile.model_copy(update={"marker": markers})


def _check_bodies(joint: Joint, body: str | None, video: Path) -> None:
    wanted = ("casing", "rotor") if body == "both" else (body,) if body else ()
    for name in wanted:
        if name not in joint.bodies:
            raise TrackingError(
                f"the {name} is not seen in {video}",
                "check the profile's colours (--profile), or leave out --body",
            )
    if not joint.bodies:
        raise TrackingError(
            f"no body can be followed in {video}: its markers do not move evenly about a centre",
            "check the profile's colours (--profile) and look at the film",
        )


def _stillness(joint: Joint, video: Path, *, marked: bool) -> tuple[str, ...]:
    """Tell of a film in which nothing turns; without a disc the centre that its angles are about is a guess."""
    turn = {name: float(np.nanmax(body.angle) - np.nanmin(body.angle)) for name, body in joint.bodies.items()}
    if max(turn.values()) >= HARDLY:
        return ()
    most = " and ".join(f"the {name} by {by:.2f} rad" for name, by in turn.items())
    about = "" if marked else ", and no disc marks their centre"
    return (f"nothing turns in {video.name}: its angles move little ({most} in all){about}",)


def _odd_frames(markers: dict[str, Any]) -> tuple[str, ...]:
    """Tell of a first frame in which nothing is where the motion says: a still before the film, a cut."""
    if any(len(m.status) < 10 for m in markers.values()):
        return ()
    first = [
        m.status[0] == STATUS["lost"] and np.any(m.status[1:6] == STATUS["ok"]) for m in markers.values()
    ]
    return (
        ("frame 0 does not belong to the motion that follows (a still?) and is left out",)
        if all(first)
        else ()
    )


def _extra(scene: Scene, joint: Joint, rate_source: str, times: FrameTimes) -> dict[str, Any]:
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
            p.name: {
                "inner": p.inner,
                "outer": p.outer,
                "half_width": p.half_width,
                "contrast": list(p.contrast),
            }
            for p in scene.papers
        },
    }
