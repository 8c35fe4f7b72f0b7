"""Extracting the angles of both bodies from a film."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.joining import BodyAngles, candidate, join, plausible
from gyrotrack.angles.sightings import Sightings
from gyrotrack.angles.uncertainty import paper_angle
from gyrotrack.angles.velocity import angular_velocity
from gyrotrack.dataset.records import STATUS, BodyTrack, MarkerTrack, Recording
from gyrotrack.errors import TrackingError
from gyrotrack.geometry.acquisition import acquire
from gyrotrack.geometry.centre import CentrePath, smooth_path
from gyrotrack.geometry.samples import take_samples
from gyrotrack.geometry.scene import Scene
from gyrotrack.geometry.tilt import Flattening, fit_flattening
from gyrotrack.geometry.wander import wandering_centre
from gyrotrack.pipeline.watch import BodySightings, Progress, Watched, watch
from gyrotrack.profile import PAPER, Profile
from gyrotrack.video import capture_rate, probe
from gyrotrack.video.container import file_sha256

Floats = npt.NDArray[np.float64]
SMOOTHING = 51


def extract(
    video: Path,
    profile: Profile = PAPER,
    *,
    capture_fps: float | None = None,
    body: str | None = None,
    threads: int = 2,
    progress: Progress | None = None,
) -> Recording:
    """Track a film and return its recording; nothing is written."""
    info = probe(video)
    rate = capture_rate(info, capture_fps, profile.capture_fps)
    samples = take_samples(video)
    scene = acquire(samples, profile, video.name)
    seen = watch(video, scene, samples, threads, progress)
    centre = _centre(seen, scene)
    joined: dict[str, tuple[BodyAngles, Flattening]] = {}
    for name, sights in seen.bodies.items():
        casing = joined["casing"][0].angle if "casing" in joined else None
        joined[name] = _joined(sights, centre, profile, scene, name, casing)
    n = len(seen.pts_time)
    time = np.arange(n) / rate.fps
    sense = _sense(profile, joined)
    markers, bodies = {}, {}
    for name, (angles, _) in joined.items():
        for marker, track in _markers(name, angles, seen.bodies[name], centre, sense).items():
            markers[marker] = track
        bodies[name] = _body(name, angles, markers, time, sense)
    return Recording(
        source=video.name,
        source_sha256=file_sha256(video),
        width=info.width,
        height=info.height,
        capture_fps=rate.fps,
        container_fps=info.container_fps,
        frames_declared=info.frames_declared,
        frames_decoded=n,
        sense=sense,
        body="both" if len(bodies) == 2 else next(iter(bodies)),
        frame_index=np.arange(n),
        time=time,
        pts_time=seen.pts_time,
        centre=centre.centre,
        centre_sigma=centre.sigma,
        markers=markers,
        bodies=bodies,
        warnings=(*rate.warnings, *scene.warnings, *seen.warnings),
        extra={},
    )


def _centre(seen: Watched, scene: Scene) -> CentrePath:
    if seen.disc is not None:
        return smooth_path(seen.disc)
    sights = [s for body in seen.bodies.values() for s in body.markers.values()]
    best = max(sights, key=lambda s: int(plausible(s).sum()))
    good = plausible(best)
    return wandering_centre(best.position(good & best.open), good & best.open, np.array(scene.centre))


def _joined(
    sights: BodySightings,
    centre: CentrePath,
    profile: Profile,
    scene: Scene,
    name: str,
    casing: Floats | None,
) -> tuple[BodyAngles, Flattening]:
    whole = {m: plausible(s) & s.open for m, s in sights.markers.items()}
    place = {
        m: (s.position(whole[m]) - centre.centre) * np.array([1.0, -1.0]) for m, s in sights.markers.items()
    }
    flat = fit_flattening({m: v[whole[m] & np.isfinite(v).all(axis=1)] for m, v in place.items()})
    given = {m.name for m in profile.of(name) if m.mount_angle is not None}
    mounts = {p.name: p.mount for p in scene.of(name)}
    candidates = {}
    for m, v in place.items():
        level = flat.level(m, v)
        angle = np.arctan2(level[:, 1], level[:, 0])
        candidates[m] = candidate(sights.markers[m], angle, mounts[m], given=m in given)
    return join(sights.coarse, candidates, casing), flat


def _sense(profile: Profile, joined: dict[str, tuple[BodyAngles, Flattening]]) -> int:
    if profile.sense is not None:
        return profile.sense
    for name in ("casing", "rotor"):
        if name in joined:
            angle = joined[name][0].angle
            known = angle[np.isfinite(angle)]
            if len(known) > 1 and abs(known[-1] - known[0]) > 0.5:
                return 1 if known[-1] > known[0] else -1
    return -1


def _markers(
    body: str, angles: BodyAngles, sights: BodySightings, centre: CentrePath, sense: int
) -> dict[str, MarkerTrack]:
    tracks = {}
    for name, found in angles.markers.items():
        s = sights.markers[name]
        used = np.isfinite(found.angle)
        ok = used & s.open
        status = np.full(len(used), STATUS["lost"], dtype=np.int8)
        status[np.isfinite(s.angle)] = STATUS["occluded"]
        status[ok] = STATUS["ok"]
        xy = s.centre[:, None, :] + np.stack(
            [s.corner_radius * np.cos(s.corner_angle), -s.corner_radius * np.sin(s.corner_angle)], axis=-1
        )
        paper = paper_angle(xy, centre.centre, ok)
        tracks[name] = MarkerTrack(
            name=name,
            body=body,
            mount_angle=float(np.angle(np.exp(1j * sense * found.mount))),
            corner=xy,
            delta=paper.delta,
            rho=paper.rho,
            beta=paper.beta,
            angle=_wrap(sense * paper.angle),
            sigma=paper.sigma,
            u_r=paper.u_r,
            u_1=paper.u_1,
            u_2=paper.u_2,
            status=status,
            angle_fine=_wrap(sense * found.angle),
            sigma_calibrated=found.sigma,
        )
    return tracks


def _body(
    name: str, angles: BodyAngles, markers: dict[str, MarkerTrack], time: Floats, sense: int
) -> BodyTrack:
    use = np.isfinite(angles.angle)
    if not use.any():
        raise TrackingError(f"the {name} is never seen")
    angle = sense * angles.angle[use]
    stack = np.stack([np.where(markers[m].status == 0, markers[m].sigma, np.nan) for m in angles.markers])
    weight = np.isfinite(stack)
    paper = np.sqrt(np.nansum(stack**2, axis=0)) / np.maximum(weight.sum(axis=0), 1)
    omega, omega_sigma = angular_velocity(time[use], angle, angles.sigma[use], SMOOTHING)
    return BodyTrack(
        name=name,
        time=time[use],
        angle=angle,
        sigma=angles.sigma[use],
        sigma_paper=np.where(weight.any(axis=0), paper, np.nan)[use],
        n_markers=angles.count[use],
        omega=omega,
        omega_sigma=omega_sigma,
        smoothing_width=SMOOTHING,
    )


def _wrap(angle: Floats) -> Floats:
    return np.asarray(np.angle(np.exp(1j * angle)))
