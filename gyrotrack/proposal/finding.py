"""From a film to a profile, without being told a colour: what was chosen, and what is in doubt."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrotrack.errors import TrackingError
from gyrotrack.geometry.acquisition import acquire
from gyrotrack.geometry.papers import is_paper, placed
from gyrotrack.geometry.samples import Samples, take_samples
from gyrotrack.geometry.scene import Disc, Scene
from gyrotrack.geometry.white import find_white
from gyrotrack.profile import Body, MarkerProfile, Profile
from gyrotrack.proposal.bodies import Group, group_bodies
from gyrotrack.proposal.hues import moving_colour
from gyrotrack.proposal.markers import find_candidates, find_circle, find_orbit
from gyrotrack.proposal.naming import ProposedMarker, left_out, name_bodies, name_markers, resting_casing
from gyrotrack.segmentation.colour import nearest_colour
from gyrotrack.segmentation.ring import Ring
from gyrotrack.video import Frame, frames_at, read_raw_stamps

SPREAD = 24
"""Frames from the whole film, beside its first ones: what rests at the start moves somewhere."""


@dataclass(frozen=True)
class Proposal:
    """A profile that was found, and what led to it.

    Attributes
    ----------
    profile : Profile
        What `extract` needs.
    markers : tuple of ProposedMarker
        One for each marker of the profile.
    centre : tuple of float
        (x, y) in px.
    disc : Disc or None
        What marks the centre.
    notes : tuple of str
        What is in doubt, or was left out.
    sound : bool
        `extract` finds every marker with this profile.
    samples : Samples
        The frames that were looked at.
    """

    profile: Profile
    markers: tuple[ProposedMarker, ...]
    centre: tuple[float, float]
    disc: Disc | None
    notes: tuple[str, ...]
    sound: bool
    samples: Samples


def propose(video: Path, *, capture_fps: float | None = None) -> Proposal:
    """Find the markers of a film: their colours and bodies, and what marks the centre.

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
    orbit = find_orbit(samples, moving)
    if orbit is None:
        raise TrackingError(
            f"no markers found in {video}: nothing coloured turns about a centre",
            "film coloured papers on a turning body; where the film starts at rest, cut the start off",
        )
    circle = find_circle(samples, orbit)
    disc = circle.disc if circle else None
    ring, candidates = find_candidates(samples, moving, orbit, disc)
    groups, uneven = group_bodies(candidates, samples.head)
    groups, standing = [g for g in groups if not g.stands], [g for g in groups if g.stands]
    if not groups:
        raise TrackingError(
            f"no markers found in {video}: what is coloured there does not turn evenly about a centre",
            "a profile can be written by hand; see --profile of `gyrotrack extract`",
        )
    named, notes = name_bodies(groups, resting_casing(standing, groups, circle), circle)
    notes += [left_out(c) for c in uneven]
    markers = name_markers(named, notes)
    white = _white(samples, ring, named)
    if white is not None:
        markers.append(white)
    profile = Profile(
        name=video.stem,
        marker=tuple(m.profile for m in markers),
        centre="circle" if circle else "orbit",
        circle_colour=nearest_colour(circle.hue) if circle else "red",
        circle_hue=round(circle.hue, 1) if circle else None,
        capture_fps=capture_fps,
    )
    sound = _confirmed(video, profile, markers, notes)
    centre = disc.centre if disc is not None else orbit.centre
    return Proposal(profile, tuple(markers), centre, disc, tuple(notes), sound, samples)


def _samples(video: Path) -> Samples:
    """Take the first frames in a row, and others spread evenly over the film."""
    first = take_samples(video)
    stamps = read_raw_stamps(video)
    chosen = np.linspace(first.head, len(stamps) - 1, SPREAD).astype(int) if len(stamps) > first.head else ()
    found = frames_at(video, {int(stamps[k]) for k in chosen})
    spread: list[Frame] = [found[stamp] for stamp in sorted(found)]
    keys = spread or list(first.frames[first.head :])
    return Samples((*first.frames[: first.head], *keys), first.head)


def _white(samples: Samples, ring: Ring, bodies: dict[Body, Group]) -> ProposedMarker | None:
    """Look for a white marker on the rotor, which has no colour to be found by."""
    group = bodies.get("rotor")
    if group is None:
        return None
    others = placed([c.sighting for c in group.members])
    marker = MarkerProfile(name="white", colour="white", body="rotor")
    paper = find_white(samples, ring, marker, others)
    if paper is None or not is_paper(paper):
        return None
    lengths = [s.paper.outer - s.paper.inner for s in others]
    widths = [s.paper.half_width for s in others]
    alike = 0.4 < (paper.outer - paper.inner) / float(np.median(lengths)) < 2.5
    alike &= 0.4 < paper.half_width / float(np.median(widths)) < 2.5
    first = others[0]  # the paper itself was seen on the average of frames only
    return (
        ProposedMarker(marker, paper, first.angle + paper.mount, first.clear, group.pace.step)
        if alike
        else None
    )


def _confirmed(video: Path, profile: Profile, markers: list[ProposedMarker], notes: list[str]) -> bool:
    """Find the scene anew as `extract` will, and compare."""
    try:
        scene: Scene = acquire(take_samples(video), profile, str(video))
    except TrackingError as error:
        notes.append(f"with this profile extract fails: {error.message}")
        return False
    again = {paper.name: paper for paper in scene.papers}
    sound = True
    for marker in markers:
        paper = again.get(marker.profile.name)
        if paper is None:
            notes.append(f"extract does not find the {marker.profile.name} marker again with this profile")
        elif abs(paper.radius - marker.paper.radius) > 0.5 * (marker.paper.outer - marker.paper.inner) + 2.0:
            notes.append(
                f"extract finds the {marker.profile.name} marker at another radius with this profile"
            )
        else:
            continue
        sound = False
    return sound
