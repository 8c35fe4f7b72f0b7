"""A marker profile proposed from the film alone.

The colours that move are found first. Then a candidate for a marker is found in each colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gyrotrack._arrays import Bools, Floats, Singles
from gyrotrack._column_store import large_blocks_returned
from gyrotrack._errors import TrackingError
from gyrotrack.tracking._acquisition import (
    LEAST_CONTRAST,
    LEAST_TOGETHER,
    LONGEST_DWELL,
    Rings,
    SampledMarker,
    acquire,
    find_coloured,
    find_disc,
    find_white,
    is_marker_sized,
    placed,
    places_of,
    search_ring,
    share_together,
)
from gyrotrack.tracking._orbit import Orbit, common_centre, orbits_about
from gyrotrack.tracking._polar import Ring
from gyrotrack.tracking._profile import (
    Blob,
    Body,
    Hue,
    MarkerProfile,
    Profile,
    find_blobs,
    hue_score,
    nearest_colour,
)
from gyrotrack.tracking._scene import Disc, FrameStore, Marker, Samples, Scene, take_samples
from gyrotrack.video._container import Frame, read_packets
from gyrotrack.video._decoder import frames_at

BINS = 120
"""Number of bins of the histogram of the hue [1]. Chosen: 3 degrees each; a smaller number joins similar colours, a
larger one gives noisy heights."""
APART = np.deg2rad(24.0)
"""Smallest difference between two different hues [rad]. Chosen: a smaller value divides one marker, a larger one joins
orange and red."""
SECTOR = np.deg2rad(45.0)
"""Half width of the sector of a hue [rad]. Derived: a name of a colour covers 45 degrees on either side, see
`_profile`."""
LEAST_CHANGE = 6.0
"""Smallest change of chroma of a moving colour [grey levels]. Chosen: a smaller value finds noise, a larger one loses
faint markers."""
LEAST_SHARE = 0.004
"""Smallest share of a hue in the total change of chroma [1]. Chosen: a smaller value proposes reflections, a larger one
loses small markers."""
MOST = 8
"""Largest number of colours that are proposed [1]. Chosen: a larger number costs time, a smaller one loses markers in
coloured surroundings."""


@dataclass(frozen=True)
class MovingColour:
    """Differences of chroma of sample frames from their median."""

    # chroma minus the median of all samples where the saturation increases, else 0, (2, n, height, width)
    change: Singles
    # directions in the chroma plane (U, V) of the colours that move [rad], the strongest first
    hues: tuple[float, ...]

    def scores(self, hue: float) -> Singles:
        """Return the score of a hue in each pixel of each sample, (n, height, width), 0 if another hue is nearer."""
        limit = min((0.5 * apart(hue, other) for other in self.hues if other != hue), default=SECTOR)
        score: Singles = np.empty_like(self.change[0])
        for own, u, v in zip(score, *self.change, strict=True):  # one by one, to limit memory
            own[...] = hue_score(u, v, direction_of(hue))
            if limit < SECTOR:
                along, across = np.cos(hue) * u + np.sin(hue) * v, np.cos(hue) * v - np.sin(hue) * u
                own[np.abs(across) > np.tan(limit) * along] = 0.0
        return score


def moving_colour(samples: Samples) -> MovingColour:
    """Find the moving colours of sample frames.

    If a marker covers a pixel in most samples, the other samples have the opposite change, with less saturation; this
    change is excluded.
    """
    chroma = samples.chroma
    still = np.median(chroma, axis=1).astype(np.float32)
    change = np.subtract(chroma, still[:, None], dtype=np.float32)
    size = np.hypot(change[0], change[1])
    limit = max(LEAST_CHANGE, 3.0 * float(np.percentile(size, 75)))
    dull = np.hypot(*(still - 128.0))
    for k in range(len(size)):  # one by one, to limit memory
        weaker = np.hypot(*(chroma[:, k].astype(np.float32) - 128.0)) <= dull
        change[:, k, weaker | (size[k] <= limit)] = 0.0
    return MovingColour(change, _peaks(change))


def _peaks(change: Singles) -> tuple[float, ...]:
    size = np.hypot(change[0], change[1]).ravel()
    moving = size > 0
    hue = np.arctan2(change[1].ravel()[moving], change[0].ravel()[moving])
    bins = np.floor(np.mod(hue, 2.0 * np.pi) * BINS / (2.0 * np.pi)).astype(np.int64) % BINS
    weight = np.bincount(bins, size[moving], BINS).astype(np.float64)
    x = np.arange(-6, 7) / 2.5
    bell = np.exp(-0.5 * x**2)
    smooth = np.convolve(np.concatenate([weight[-6:], weight, weight[:6]]), bell / bell.sum(), mode="valid")
    top = (smooth >= np.roll(smooth, 1)) & (smooth > np.roll(smooth, -1))
    found: list[float] = []
    for k in sorted(np.flatnonzero(top).tolist(), key=lambda k: -smooth[k]):
        place = (k + 0.5) * 2.0 * np.pi / BINS
        share = float(weight[(np.arange(k - 4, k + 5)) % BINS].sum() / max(weight.sum(), 1e-9))
        if share > LEAST_SHARE and all(apart(place, other) > APART for other in found):
            found.append(place)
    return tuple(found[:MOST])


def direction_of(hue: float) -> tuple[float, float]:
    """Return the unit vector (U, V) of a hue in rad."""
    return float(np.cos(hue)), float(np.sin(hue))


def apart(a: float, b: float) -> float:
    """Return the angle between two hues in rad."""
    return float(abs(np.angle(np.exp(1j * (a - b)))))


TRIALS = 1500
"""Number of random triples of points for a centre [1]. Chosen: more than for a known profile, because most points may
be outliers; a smaller number may not find the centre."""
_AMBIGUOUS = 0.35
"""A second patch may be confused with the first patch of a hue if its product of contrast and share of samples, divided
by the product for the first patch, is at least this value [1]. Chosen: with a smaller value, reflections count as
second patches; with a larger one, two marks may be confused."""
_SAME_HUE = 18.0
"""Largest difference of two hues that count as equal [degrees]. Chosen: below `APART`; a smaller value separates shades
of one paper, a larger one joins colours."""
_DISC_HUES = range(0, 360, 30)
"""Trial hues in the search for a disc [degrees]. Chosen: a finer step costs time, a coarser one loses contrast."""
_LEAST_DISC = 14.0
"""Smallest chroma of a disc [grey levels]. Chosen: metal reflects the colour of its surroundings faintly, with a
smaller chroma; a larger value loses faint discs."""
_OFF_CENTRE = 0.3
"""Largest distance of a disc from the centre of the orbits, relative to the smallest radius [1]. Chosen: a smaller
value loses discs under an oblique view, a larger one accepts a marker."""


def find_orbit(
    samples: Samples, moving: MovingColour, hub: tuple[float, float] | None = None
) -> Orbit | None:
    """Find the common centre of the circles of coloured blobs, or their circles about a given hub."""
    place, label_of = places_of(samples, [_blobs(moving, hue) for hue in moving.hues])
    if not len(place):
        return None
    return orbits_about(place, label_of, hub) if hub else common_centre(place, label_of, trials=TRIALS)


_LEAST_SCORE = 4.0
"""Smallest score of a blob [grey levels]. Chosen: a smaller value accepts noise, a larger one loses faint markers."""
_OF_PEAK = 0.4
"""Smallest score of a blob, relative to the typical 90th percentile of its colour [1]. Chosen: a smaller value joins
blobs with their surroundings, a larger one divides them."""


def _blobs(moving: MovingColour, hue: float) -> list[list[Blob]]:
    scores = moving.scores(hue)
    peaks = [float(np.percentile(score[score > 0], 90)) for score in scores if np.any(score > 0)]
    threshold = max(_LEAST_SCORE, _OF_PEAK * float(np.median(peaks))) if peaks else np.inf
    return [find_blobs(score, threshold, most=3) for score in scores]


@dataclass(frozen=True)
class Circle:
    """The disc at the centre and its hue in degrees."""

    disc: Disc
    hue: float


def find_circle(samples: Samples, orbit: Orbit) -> Circle | None:
    """Find a coloured disc at the centre of the orbits, of any colour; None if there is none."""
    limit = max(_OFF_CENTRE * min(orbit.radii.values()), 4.0)
    best: Circle | None = None
    for hue in _DISC_HUES:
        disc = find_disc(samples, direction_of(np.deg2rad(hue)), orbit)
        if disc is None or np.hypot(*np.subtract(disc.centre, orbit.centre)) > limit:
            continue
        if best is None or np.hypot(*disc.chroma) > np.hypot(*best.disc.chroma):
            best = Circle(disc, _hue(disc.chroma))
    if best is None or np.hypot(*best.disc.chroma) < _LEAST_DISC:
        return None
    again = find_disc(samples, direction_of(np.deg2rad(best.hue)), orbit)
    return best if again is None else Circle(again, _hue(again.chroma))


def _hue(chroma: tuple[float, float]) -> float:
    return float(np.rad2deg(np.arctan2(chroma[1], chroma[0])) % 360.0)


@dataclass(frozen=True)
class Candidate:
    """A coloured patch that may be a marker."""

    hue: float  # in degrees
    sampled: SampledMarker
    ambiguous: bool = False  # whether another patch of the same hue may be confused with this one

    @property
    def colour(self) -> Hue:
        """Name of the nearest colour."""
        return nearest_colour(self.hue)

    @property
    def contrast(self) -> float:
        """Difference of chroma from the background [grey levels]."""
        return float(np.hypot(*self.sampled.marker.contrast))


def find_candidates(
    samples: Samples, hues: Sequence[float], orbit: Orbit, disc: Disc | None
) -> tuple[Ring, list[Candidate]]:
    """Find a marker of each moving hue in rings about the centre; also return the rings."""
    centre = disc.centre if disc is not None else orbit.centre
    ring = search_ring(samples, centre, disc, max(orbit.radii.values()))
    rings = Rings(samples.strips(ring, range(len(samples.frames))), ring)
    found = []
    for hue in hues:
        one = _candidate(rings, float(np.rad2deg(hue) % 360.0))
        if one is None:
            continue
        other = _candidate(_without(rings, one.sampled), one.hue)
        found.append(replace(one, ambiguous=other is not None and _alike(one, other)))
    return ring, found


def _candidate(rings: Rings, hue: float) -> Candidate | None:
    wanted = MarkerProfile(name="x", colour=nearest_colour(hue), body="rotor", hue=hue)
    seen = find_coloured(rings, wanted)
    if seen is None or not is_marker_sized(seen.marker):
        return None
    return Candidate(_hue(seen.marker.contrast), seen)


def _alike(one: Candidate, other: Candidate) -> bool:
    """Return whether a second patch has the hue of the first patch and is significant."""
    share = other.contrast / one.contrast * float(other.sampled.clear.mean())
    return share > _AMBIGUOUS and abs((one.hue - other.hue + 180.0) % 360.0 - 180.0) < _SAME_HUE


def _without(rings: Rings, seen: SampledMarker) -> Rings:
    """Return the rings with a marker replaced by the background."""
    usual = rings.background
    if seen.marker.dwell > LONGEST_DWELL:  # the median shows the marker itself
        usual = np.broadcast_to(np.median(usual, axis=2, keepdims=True), usual.shape)
    column = np.arange(rings.ring.columns) * rings.ring.step
    apart = np.abs(np.angle(np.exp(1j * (column[None, :] - seen.angle[:, None]))))
    here = apart < 1.8 * seen.marker.half_width + 0.05
    plain = np.rint(usual).astype(np.uint8)
    return Rings(np.where(here[None, :, None, :], plain[:, None], rings.strips), rings.ring)


EVEN = 0.6
"""Smallest share of the observations that are in phase with a steady rotation [1]. Chosen: a smaller value accepts
random patches, a larger one rejects occluded markers."""
_REST_STEP = 2e-3
"""Largest step of a group at rest [rad per frame]. Chosen: a smaller value reports noise as a rotation, a larger one
hides a slow body."""
_MOVED = 0.25
"""Largest deviation of a group at rest from its mean angle [rad]. Chosen: a smaller value reports noise as a rotation,
a larger one hides an oscillation."""
_FEWEST = 8
"""Smallest number of observations for a test of rotation [1]. Chosen: with fewer, observations are in phase by chance;
with more, occluded markers are rejected."""


@dataclass(frozen=True)
class SteadyRotation:
    """Steady rotation through consecutive frames: step [rad/frame], share of observations in phase with it."""

    step: float
    share: float


@dataclass(frozen=True)
class Group:
    """Markers with constant angular distances, and their rotation."""

    members: tuple[Candidate, ...]
    rotation: SteadyRotation

    @property
    def is_at_rest(self) -> bool:
        """Whether the group is stationary throughout the film."""
        if abs(self.rotation.step) > _REST_STEP:
            return False
        seen = self.members[0].sampled
        turn = np.exp(1j * seen.angle[seen.clear])
        return bool(np.abs(np.angle(turn / turn.sum())).max() < _MOVED)

    @property
    def weight(self) -> float:
        """Sum over the markers of contrast times share of distinct samples."""
        return sum(c.contrast * float(c.sampled.clear.mean()) for c in self.members)


_IN_PHASE = 0.35
"""Largest deviation of an angle from a steady rotation with which it is in phase [rad]. Chosen: a smaller value rejects
changes of the speed, a larger one accepts random angles."""


def rotation(angle: Floats, use: Bools) -> SteadyRotation:
    """Find the step for which most angles of consecutive frames, (n,) [rad], are in phase."""
    frame = np.flatnonzero(use)
    if len(frame) < _FEWEST:
        return SteadyRotation(0.0, 0.0)
    phasor = np.exp(1j * angle[frame])
    steps = np.linspace(-np.pi, np.pi, 32 * (int(frame[-1]) + 1), endpoint=False)
    power = np.abs(np.exp(-1j * np.outer(steps, frame)) @ phasor)
    step = float(steps[np.argmax(power)])
    start = float(np.angle(np.sum(phasor * np.exp(-1j * step * frame))))
    off = np.abs(np.angle(phasor * np.exp(-1j * (start + step * frame))))
    return SteadyRotation(step, float(np.mean(off < _IN_PHASE)))


def group_bodies(candidates: list[Candidate], head: int) -> tuple[list[Group], list[Candidate]]:
    """Group markers that move together, the strongest group first; also return markers that do not move steadily."""
    groups: list[list[Candidate]] = []
    rotations = {id(c): rotation(c.sampled.angle[:head], c.sampled.clear[:head]) for c in candidates}
    uneven = [c for c in candidates if rotations[id(c)].share < EVEN]
    for one in sorted(candidates, key=lambda c: -c.contrast):
        if any(one is other for other in uneven):
            continue
        group = next((g for g in groups if share_together(one.sampled, g[0].sampled) > LEAST_TOGETHER), None)
        if group is None:
            groups.append(group := [])
        group.append(one)
    made = [Group(tuple(g), max((rotations[id(c)] for c in g), key=lambda p: p.share)) for g in groups]
    return sorted(made, key=lambda g: -g.weight), uneven


@dataclass(frozen=True)
class ProposedMarker:
    """A proposed marker: its entry in the profile, and its geometry and contrast in the film."""

    profile: MarkerProfile  # entry in the profile, and the marker in the film
    marker: Marker
    angle: Floats  # angle in each sample [rad], and whether the marker is distinct in it
    clear: Bools
    step: float  # rotation of its body from frame to frame [rad]

    @property
    def seen(self) -> float:
        """Share of the samples in which the marker is distinct."""
        return float(self.clear.mean())


def resting_casing(resting_groups: list[Group], groups: list[Group], circle: Circle | None) -> Group | None:
    """Return the marker, with the colour of the disc, on a casing that is at rest in the whole film."""
    if circle is None or len(groups) != 1:
        return None
    colour = nearest_colour(circle.hue)
    alike = [g for g in resting_groups if g.members[0].colour == colour]
    moving = {c.colour for c in groups[0].members}
    return alike[0] if alike and colour not in moving else None


def name_bodies(
    groups: list[Group], resting: Group | None, circle: Circle | None
) -> tuple[dict[Body, Group], list[str]]:
    """Name the bodies; the faster body is the rotor."""
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
        why = (
            "it has the colour of the disc"
            if casing
            else "no other coloured marker turns (a body with white markers only is not found: add a coloured "
            "one, or track it by `gyrotrack spindown`)"
        )
        notes.append(f"Only one body turns; it is assumed to be the {name}, because {why}.")
        return {name: one}, notes
    slow, fast = sorted(groups[:2], key=lambda g: abs(g.rotation.step))
    if abs(fast.rotation.step) < 1.25 * abs(slow.rotation.step):
        # Markers on the casing are never occluded; the bar of the casing passes over the markers on the rotor.
        slow, fast = sorted(
            (slow, fast), key=lambda g: (len(g.members), -min(c.sampled.clear.mean() for c in g.members))
        )
        notes.append("Both bodies turn about equally fast; which of them is the rotor is uncertain.")
    return {"casing": slow, "rotor": fast}, notes


def name_markers(bodies: dict[Body, Group], notes: list[str]) -> list[ProposedMarker]:
    """Name the markers; only the strongest of several markers of one colour on a body is used."""
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


_FAINT = 0.3
"""Smallest contrast of a white patch that is reported, relative to the smallest contrast of a marker [1]. Chosen: a
smaller value reports noise, a larger one leaves a faint marker unexplained."""
SPREAD = 24
"""Number of frames from the whole film that are read besides the first frames [frames]. Chosen: a smaller number may
overlook bodies that are at rest at the start, a larger one costs time."""


@dataclass(frozen=True)
class Proposal:
    """A proposed profile, and what it is based on.

    Attributes
    ----------
    profile : Profile
        Profile for `extract`.
    markers : tuple of ProposedMarker
        Proposed markers, one for each marker of the profile.
    centre : tuple of float
        (x, y) in px.
    disc : Disc or None
        Disc at the centre.
    notes : tuple of str
        Notes on uncertain assignments and omitted patches.
    sound : bool
        Whether `extract` finds every marker with this profile.
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


@large_blocks_returned()
def propose(
    video: Path, *, capture_fps: float | None = None, hub: tuple[float, float] | None = None
) -> Proposal:
    """Find the markers of a film: their colours and bodies, and the mark at the centre.

    Parameters
    ----------
    video : Path
        The film.
    capture_fps : float, optional
        Rate at which the camera captured [1/s], if the film does not state it.
    hub : tuple of float, optional
        Centre of rotation (x, y) [px]; by default determined from the markers.

    Raises
    ------
    VideoError
        The film cannot be read.
    TrackingError
        No coloured region of the film turns about a centre.
    """
    video = Path(video)
    samples = _samples(video)
    moving = moving_colour(samples)
    orbit = find_orbit(samples, moving, hub)
    hues = moving.hues
    del moving  # large
    if orbit is None:
        raise TrackingError(
            f"No markers found in {video}: no coloured region rotates about "
            + ("a centre." if hub is None else f"({hub[0]:g}, {hub[1]:g}) px."),
            "Film coloured markers on a turning body. If the film starts at rest, cut off the start.",
        )
    circle = find_circle(samples, orbit) if hub is None else None
    disc = circle.disc if circle else None
    ring, candidates = find_candidates(samples, hues, orbit, disc)
    groups, uneven = group_bodies(candidates, samples.head)
    groups, resting_groups = [g for g in groups if not g.is_at_rest], [g for g in groups if g.is_at_rest]
    if not groups:
        what = f"No markers found in {video}: no coloured patch turns steadily about a centre."
        raise TrackingError(what, "Write a profile by hand; see --profile of `gyrotrack extract`.")
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
    """Decode the first frames, and further frames equally spaced over the film."""
    first = take_samples(video)
    stamps = read_packets(video).stamps
    chosen = np.linspace(first.head, len(stamps) - 1, SPREAD).astype(int) if len(stamps) > first.head else ()
    found = frames_at(video, {int(stamps[k]) for k in chosen}, FrameStore())
    spread: list[Frame] = [found[stamp] for stamp in sorted(found)]
    keys = spread or list(first.frames[first.head :])
    return Samples((*first.frames[: first.head], *keys), first.head)


_THINNER = 0.4
"""Smallest size of a white marker, relative to the other markers of its body [1]. Chosen: the inverse of `_THICKER`; a
smaller value accepts reflections, a larger one refuses other shapes."""
_THICKER = 2.5
"""Largest size of a white marker, relative to the other markers of its body [1]. Chosen: a smaller value refuses other
shapes, a larger one accepts reflections."""


def _white(samples: Samples, ring: Ring, bodies: dict[Body, Group]) -> ProposedMarker | Marker | None:
    """Find a white marker on the rotor; a faint marker is returned without a profile."""
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
        alike = _THINNER < (marker.outer - marker.inner) / float(np.median(lengths)) < _THICKER
        alike &= _THINNER < marker.half_width / float(np.median(widths)) < _THICKER
        if alike and least < LEAST_CONTRAST:
            return marker
        if alike:
            first = others[0]  # the white marker itself is found only in the median of the frames
            angle, step = first.angle + marker.mount, group.rotation.step
            return ProposedMarker(proposed, marker, angle, first.clear, step)
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
        name, old = proposed.profile.name, proposed.marker
        marker = again.get(name)
        if marker is None:
            notes.append(f"`gyrotrack extract` does not find the {name} marker with this profile.")
        elif abs(marker.radius - old.radius) > 0.5 * (old.outer - old.inner) + 2.0:
            notes.append(f"`gyrotrack extract` finds the {name} marker at another radius with this profile.")
        else:
            continue
        sound = False
    return sound
