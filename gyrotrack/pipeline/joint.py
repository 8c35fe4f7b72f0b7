"""From the sightings of one pass to the angles of the bodies: centre, tilt, joining, sense."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.candidates import plausible
from gyrotrack.angles.joining import BodyAngles, MarkerAngles, join
from gyrotrack.angles.pace import Pace, jitter_is_real
from gyrotrack.angles.sense import find_sense, net_turn, unfold
from gyrotrack.angles.sightings import spread_out
from gyrotrack.geometry.centre import CentrePath, smooth_path
from gyrotrack.geometry.scene import Scene
from gyrotrack.geometry.tilt import Flattening
from gyrotrack.geometry.wander import wandering_centre
from gyrotrack.pipeline.repeated import seen_angle, turning_most
from gyrotrack.pipeline.slant import error_by_place, in_perspective, pulled, slanted, usual_error_by_place
from gyrotrack.pipeline.timing import FrameTimes
from gyrotrack.pipeline.views import View, view
from gyrotrack.pipeline.watch import BodySightings, Watched
from gyrotrack.profile import Profile

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_FAR = 0.05
"""Share of the orbit's radius that a centre must move before it is taken to move at all."""


@dataclass(frozen=True)
class Joint:
    """All bodies of a clip.

    Attributes
    ----------
    centre : CentrePath
        The centre in every frame.
    bodies : dict of BodyAngles
        Angles as seen.
    flattening : dict of Flattening
        What the slanted view does to each body's orbits.
    sense : int
        Factor that makes the angles grow.
    warnings : tuple of str
        What the user should know.
    """

    centre: CentrePath
    bodies: dict[str, BodyAngles]
    flattening: dict[str, Flattening]
    sense: int
    warnings: tuple[str, ...]


def join_bodies(seen: Watched, scene: Scene, profile: Profile, fps: float) -> Joint:
    """Find the centre's path, and join the markers of each body about it.

    Frames that are missing in the film get empty places, so that the motion is even in between; the result has
    the film's frames only. A frame that repeats the one before it tells nothing new, and gets no angle.
    """
    if seen.times.again is None:
        return _join_fresh(seen, scene, profile, fps)
    fresh, count = np.flatnonzero(~seen.times.again), len(seen.times.again)
    joint = _join_fresh(_picked(seen, fresh), scene, profile, fps)
    row = np.searchsorted(fresh, np.arange(count), side="right") - 1
    centre = CentrePath(joint.centre.centre[row], joint.centre.sigma[row], joint.centre.reach)
    bodies = {name: body.spread_out(fresh, count) for name, body in joint.bodies.items()}
    return replace(joint, centre=centre, bodies=bodies)


def _picked(seen: Watched, index: Integers) -> Watched:
    """Return the frames `index` alone."""
    bodies = {
        name: BodySightings(body.coarse[index], {m: s.picked(index) for m, s in body.markers.items()})
        for name, body in seen.bodies.items()
    }
    disc = None if seen.disc is None else seen.disc[index]
    return replace(seen, bodies=bodies, disc=disc, times=seen.times.at(index))


def _join_fresh(seen: Watched, scene: Scene, profile: Profile, fps: float) -> Joint:
    index = seen.times.number
    joint = _join_even(_with_gaps(seen, index), scene, profile, fps, _pace(seen.times))
    if len(index) == 0 or index[-1] + 1 == len(index):
        return joint
    centre = CentrePath(joint.centre.centre[index], joint.centre.sigma[index], joint.centre.reach)
    return replace(joint, centre=centre, bodies={name: body.at(index) for name, body in joint.bodies.items()})


def _pace(times: FrameTimes) -> Pace | None:
    """Return when frames were taken, also those that are missing, if that is from the stamps."""
    if times.place is None:
        return None
    return Pace(np.interp(np.arange(times.number[-1] + 1), times.number, times.place), times.sigma)


def trusted_times(seen: Watched, scene: Scene) -> FrameTimes:
    """Return the times of a film without jitter of its stamps that the body that turns most does not follow."""
    times = seen.times
    if times.place is None or times.smooth is None or not seen.bodies:
        return times
    angle = seen_angle(seen, scene, turning_most(seen))
    return times if jitter_is_real(times.place, times.smooth, angle) else times.even()


def _with_gaps(seen: Watched, index: Integers) -> Watched:
    """Put the frames where they belong on the camera's even grid; what lies between is NaN or False."""
    count = int(index[-1]) + 1 if len(index) else 0
    if count == len(index):
        return seen
    bodies = {
        name: BodySightings(
            spread_out(body.coarse, index, count),
            {m: s.spread_out(index, count) for m, s in body.markers.items()},
        )
        for name, body in seen.bodies.items()
    }
    disc = None if seen.disc is None else spread_out(seen.disc, index, count)
    return replace(seen, bodies=bodies, disc=disc)


def _join_even(seen: Watched, scene: Scene, profile: Profile, fps: float, pace: Pace | None = None) -> Joint:
    views = {name: view(scene.of(name), body.markers, seen.size) for name, body in seen.bodies.items()}
    centre, flattening = slanted(_centre(seen, scene, profile), views, profile, marked=seen.disc is not None)
    bodies, warnings = _followed(seen, views, centre, flattening, fps, pace)
    sense = find_sense({name: net_turn(body.angle) for name, body in bodies.items()}, profile.sense)
    for name, body in bodies.items():
        angle, changed = unfold(body.angle, sense)
        if changed:
            bodies[name] = replace(body, angle=angle)
            warnings.append(
                f"the {name} turns by more than half a turn between frames; its sense is taken as known"
            )
    for name, body in bodies.items():
        bodies[name] = _zeroed(body, profile, sense)
    slants = {name: flattening[name] for name in bodies}
    return Joint(centre, bodies, slants, sense, tuple(warnings))


def _followed(
    seen: Watched,
    views: dict[str, View],
    centre: CentrePath,
    flattening: dict[str, Flattening],
    fps: float,
    pace: Pace | None,
) -> tuple[dict[str, BodyAngles], list[str]]:
    """Join the markers of each body; the casing twice, since the rotor's markers pass beneath its own.

    A body that turns too little to show its errors by place is given those of the other one, in px: lamps, encoder and
    picture are the same.
    """
    candidates = {name: look.candidates(centre, flattening[name]) for name, look in views.items()}

    bodies: dict[str, BodyAngles] = {}

    def joined(name: str, other: Floats | None, *, above: bool = False) -> BodyAngles:
        radius = views[name].radius
        by_place = next(
            (
                error_by_place(views[n], flattening[n], b)
                for n, b in bodies.items()
                if n != name and b.place_error > 0.0
            ),
            usual_error_by_place(views[name]),
        )
        beside = np.hypot(np.nan_to_num(centre.sigma), pulled(candidates[name], flattening[name]))
        floor, axis = by_place / radius, beside / radius
        coarse = seen.bodies[name].coarse
        return join(coarse, candidates[name], fps, other, floor, axis, above=above, pace=pace)

    warnings: list[str] = []
    for name in views:
        found = joined(name, bodies["casing"].angle if "casing" in bodies else None)
        if _credible(found):
            bodies[name] = found
        else:
            warnings.append(f"the {name}'s markers cannot be followed; it is left out")
    if len(bodies) == 2:
        flattening["casing"] = in_perspective(centre, views, flattening, bodies["rotor"])
        candidates["casing"] = views["casing"].candidates(centre, flattening["casing"])
        better = joined("casing", bodies["rotor"].angle, above=True)
        bodies["casing"] = better if _credible(better) else bodies["casing"]
    return bodies, warnings


def _centre(seen: Watched, scene: Scene, profile: Profile) -> CentrePath:
    if seen.disc is not None:
        return smooth_path(seen.disc)
    sights = [s for body in seen.bodies.values() for s in body.markers.values()]
    best = max(sights, key=lambda s: int(plausible(s).sum()))
    good = plausible(best) & best.open
    place, first = best.position(good), np.array(scene.centre)
    still = wandering_centre(place, good, first, still=True)
    if profile.wander is False:
        return still
    moving = wandering_centre(place, good, first)
    reach = float(np.ptp(moving.centre, axis=0).max())
    radius = float(np.nanmedian(np.hypot(*(place[good] - still.centre[good]).T)))
    return moving if profile.wander or reach > _FAR * radius else still


def _zeroed(body: BodyAngles, profile: Profile, sense: int) -> BodyAngles:
    """Move the body's zero to where the profile puts it by naming a mount angle, if it names one."""
    named = {
        m.name: m.mount_angle for m in profile.marker if m.mount_angle is not None and m.name in body.markers
    }
    if not named:
        return body
    turn = [np.exp(1j * (sense * angle - body.markers[name].mount)) for name, angle in named.items()]
    shift = float(np.angle(np.sum(turn)))
    markers = {name: MarkerAngles(m.angle, m.sigma, m.mount + shift) for name, m in body.markers.items()}
    return replace(body, angle=body.angle - shift, markers=markers)


def _credible(body: BodyAngles) -> bool:
    """Tell whether a body was really followed: in at least a twentieth of the frames, and evenly."""
    used = np.isfinite(body.angle)
    return bool(used.sum() >= max(3, 0.05 * len(used)) and np.median(body.sigma[used]) < 0.2)
