"""A marker profile proposed from the film alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import TrackingError
from gyrotrack.tracking._acquisition import LEAST_CONTRAST, acquire, find_white, is_marker_sized, placed
from gyrotrack.tracking._moving_colours import (
    Candidate,
    Circle,
    Group,
    find_candidates,
    find_circle,
    find_orbit,
    group_bodies,
    moving_colour,
)
from gyrotrack.tracking._polar import Ring
from gyrotrack.tracking._profile import Body, MarkerProfile, Profile, nearest_colour
from gyrotrack.tracking._scene import Disc, Marker, Samples, Scene, take_samples
from gyrotrack.video._container import Frame, read_raw_stamps
from gyrotrack.video._decoder import frames_at


@dataclass(frozen=True)
class ProposedMarker:
    """A proposed marker: its entry in the profile, and its geometry and contrast in the film.

    Attributes
    ----------
    profile, marker
        Entry in the profile, and the marker in the film.
    angle, clear : ndarray, shape (n,)
        Its angle in each sample [rad], and whether it is distinct.
    step : float
        Rotation of its body from frame to frame [rad].
    """

    profile: MarkerProfile
    marker: Marker
    angle: npt.NDArray[np.float64]
    clear: npt.NDArray[np.bool_]
    step: float

    @property
    def seen(self) -> float:
        """Share of the samples in which it is distinct."""
        return float(self.clear.mean())


def resting_casing(resting_groups: list[Group], groups: list[Group], circle: Circle | None) -> Group | None:
    """Return the marker on a casing that is at rest in the whole film; it has the colour of the disc."""
    if circle is None or len(groups) != 1:
        return None
    colour = nearest_colour(circle.hue)
    alike = [g for g in resting_groups if g.members[0].colour == colour]
    moving = {c.colour for c in groups[0].members}
    return alike[0] if alike and colour not in moving else None


def name_bodies(
    groups: list[Group], resting: Group | None, circle: Circle | None
) -> tuple[dict[Body, Group], list[str]]:
    """Name the bodies; the rotor is the one that turns faster."""
    notes = []
    if len(groups) > 2:
        colours = ", ".join(c.colour for g in groups[2:] for c in g.members)
        notes.append(f"More than two bodies seem to turn; these markers are omitted: {colours}.")
    if resting is not None:
        colour = resting.members[0].colour
        notes.append(
            f"The {colour} marker is at rest and has the colour of the disc; it is assigned to the casing."
        )
        return {"casing": resting, "rotor": groups[0]}, notes
    if len(groups) == 1:
        (one,) = groups
        alone = len(one.members) == 1
        casing = alone and circle is not None and nearest_colour(circle.hue) == one.members[0].colour
        name: Body = "casing" if casing else "rotor"
        why = "it has the colour of the disc" if casing else "nothing else turns"
        notes.append(f"Only one body turns; it is assumed to be the {name}, because {why}.")
        return {name: one}, notes
    slow, fast = sorted(groups[:2], key=lambda g: abs(g.rotation.step))
    if abs(fast.rotation.step) < 1.25 * abs(slow.rotation.step):
        # Markers on the casing are never occluded; its bar passes over those on the rotor.
        open_share = [min(float(c.sampled.clear.mean()) for c in g.members) for g in (slow, fast)]
        if len(fast.members) < len(slow.members) or (
            len(fast.members) == len(slow.members) and open_share[1] > open_share[0]
        ):
            slow, fast = fast, slow
        notes.append("Both bodies turn about equally fast; which of them is the rotor is uncertain.")
    return {"casing": slow, "rotor": fast}, notes


def name_markers(bodies: dict[Body, Group], notes: list[str]) -> list[ProposedMarker]:
    """Name the markers; of several markers of one colour on a body only the strongest is used."""
    found: list[ProposedMarker] = []
    taken: set[str] = set()
    for body, group in bodies.items():
        markers = placed([c.sampled for c in group.members])
        colours: set[str] = set()
        for candidate, seen in zip(group.members, markers, strict=True):
            colour = candidate.colour
            if colour in colours:  # the strongest patch of a colour comes first
                notes.append(
                    f"Another {colour} patch (hue {candidate.hue:.0f} deg) moves with the {body} and is omitted: only "
                    "one marker of each colour can be tracked on a body."
                )
                continue
            colours.add(colour)
            name = colour if colour not in taken else f"{colour}_{body}"
            if name in taken:
                name = f"{name}_{sum(t.startswith(name) for t in taken) + 1}"
            if candidate.ambiguous:
                notes.append(
                    f"There is a second {colour} marker besides that on the {body}, and the two may be confused. "
                    "Give one of them another colour."
                )
            taken.add(name)
            proposed = MarkerProfile(name=name, colour=colour, body=body, hue=round(candidate.hue, 1))
            marker = replace(seen.marker, name=name, body=body, colour=colour)
            found.append(ProposedMarker(proposed, marker, seen.angle, seen.clear, group.rotation.step))
    return found


def left_out(candidate: Candidate) -> str:
    """Return the reason why a moving colour is not a marker of the profile."""
    if candidate.ambiguous:
        return (
            f"There are two {candidate.colour} markers, which are indistinguishable and omitted. "
            "Give one of them another colour."
        )
    return f"A {candidate.colour} patch does not move steadily about the centre and is omitted."


_FAINT = (
    0.3  # contrast of a white patch from which it is reported, relative to the smallest contrast of a marker
)
SPREAD = 24
"""Frames from the whole film in addition to its first ones, for bodies at rest at the start."""


@dataclass(frozen=True)
class Proposal:
    """A proposed profile, and its basis.

    Attributes
    ----------
    profile : Profile
        Profile for `extract`.
    markers : tuple of ProposedMarker
        One for each marker of the profile.
    centre : tuple of float
        (x, y) in px.
    disc : Disc or None
        Disc at the centre.
    notes : tuple of str
        Uncertain assignments, and omitted patches.
    sound : bool
        `extract` finds every marker with this profile.
    samples : Samples
        The frames that were used.
    """

    profile: Profile
    markers: tuple[ProposedMarker, ...]
    centre: tuple[float, float]
    disc: Disc | None
    notes: tuple[str, ...]
    sound: bool
    samples: Samples


def propose(
    video: Path, *, capture_fps: float | None = None, hub: tuple[float, float] | None = None
) -> Proposal:
    """Find the markers of a film: their colours and bodies, and what marks the centre.

    Parameters
    ----------
    video : Path
        The film.
    capture_fps : float, optional
        Rate at which the camera captured [1/s], if the film does not state it.
    hub : tuple of float, optional
        Centre of rotation (x, y) [px], if it is not to be determined by the markers.

    Raises
    ------
    VideoError
        The film cannot be read.
    TrackingError
        Nothing coloured turns about a centre in it.
    """
    video = Path(video)
    samples = _samples(video)
    moving = moving_colour(samples)
    orbit = find_orbit(samples, moving, hub)
    if orbit is None:
        raise TrackingError(
            f"No markers found in {video}: nothing coloured turns about "
            + ("a centre." if hub is None else f"({hub[0]:g}, {hub[1]:g}) px."),
            "Film coloured markers on a turning body. If the film starts at rest, cut off the start.",
        )
    circle = find_circle(samples, orbit) if hub is None else None
    disc = circle.disc if circle else None
    ring, candidates = find_candidates(samples, moving, orbit, disc)
    groups, uneven = group_bodies(candidates, samples.head)
    groups, resting_groups = [g for g in groups if not g.is_at_rest], [g for g in groups if g.is_at_rest]
    if not groups:
        raise TrackingError(
            f"No markers found in {video}: no coloured patch turns steadily about a centre.",
            "Write a profile by hand; see --profile of `gyrotrack extract`.",
        )
    named, notes = name_bodies(groups, resting_casing(resting_groups, groups, circle), circle)
    notes += [left_out(c) for c in uneven]
    markers = name_markers(named, notes)
    white = _white(samples, ring, named)
    if isinstance(white, ProposedMarker):
        markers.append(white)
    elif white is not None:
        notes.append(
            f"A faint white patch turns with the rotor at a radius of {white.radius:.0f} px and is omitted: its "
            f"contrast is {white.contrast[0]:.1f} grey levels, {LEAST_CONTRAST:g} are required. Improve the "
            "illumination of the marker, or avoid glare, which shortens the exposure."
        )
    profile = Profile(
        name=video.stem,
        marker=tuple(m.profile for m in markers),
        centre="circle" if circle else "orbit",
        circle_colour=nearest_colour(circle.hue) if circle else "red",
        circle_hue=round(circle.hue, 1) if circle else None,
        hub=hub,
        capture_fps=capture_fps,
    )
    sound = _confirmed(video, profile, markers, notes)
    centre = disc.centre if disc is not None else orbit.centre
    return Proposal(profile, tuple(markers), centre, disc, tuple(notes), sound, samples)


def _samples(video: Path) -> Samples:
    """Decode the first frames, and others equally spaced over the film."""
    first = take_samples(video)
    stamps = read_raw_stamps(video)
    chosen = np.linspace(first.head, len(stamps) - 1, SPREAD).astype(int) if len(stamps) > first.head else ()
    found = frames_at(video, {int(stamps[k]) for k in chosen})
    spread: list[Frame] = [found[stamp] for stamp in sorted(found)]
    keys = spread or list(first.frames[first.head :])
    return Samples((*first.frames[: first.head], *keys), first.head)


def _white(samples: Samples, ring: Ring, bodies: dict[Body, Group]) -> ProposedMarker | Marker | None:
    """Find a white marker on the rotor; a faint one is returned without a profile."""
    group = bodies.get("rotor")
    if group is None:
        return None
    others = placed([c.sampled for c in group.members])
    proposed = MarkerProfile(name="white", colour="white", body="rotor")
    lengths = [s.marker.outer - s.marker.inner for s in others]
    widths = [s.marker.half_width for s in others]
    for least in (LEAST_CONTRAST, _FAINT * LEAST_CONTRAST):
        marker = find_white(samples, range(samples.head), ring, proposed, others, least)
        if marker is None or not is_marker_sized(marker):
            continue
        alike = 0.4 < (marker.outer - marker.inner) / float(np.median(lengths)) < 2.5
        alike &= 0.4 < marker.half_width / float(np.median(widths)) < 2.5
        if alike and least < LEAST_CONTRAST:
            return marker
        if alike:
            first = others[0]  # the white marker itself is found in the median of the frames only
            return ProposedMarker(
                proposed, marker, first.angle + marker.mount, first.clear, group.rotation.step
            )
    return None


def _confirmed(video: Path, profile: Profile, markers: list[ProposedMarker], notes: list[str]) -> bool:
    """Repeat the acquisition of `extract` with the profile, and compare."""
    try:
        scene: Scene = acquire(take_samples(video), profile, str(video))
    except TrackingError as error:
        notes.append(f"`gyrotrack extract` fails with this profile. {error.message}")
        return False
    again = {marker.name: marker for marker in scene.markers}
    sound = True
    for proposed in markers:
        marker = again.get(proposed.profile.name)
        if marker is None:
            notes.append(
                f"`gyrotrack extract` does not find the {proposed.profile.name} marker with this profile."
            )
        elif (
            abs(marker.radius - proposed.marker.radius)
            > 0.5 * (proposed.marker.outer - proposed.marker.inner) + 2.0
        ):
            notes.append(
                f"`gyrotrack extract` finds the {proposed.profile.name} marker at another radius with this profile."
            )
        else:
            continue
        sound = False
    return sound
