"""Moving colours of a film, and candidates for markers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gyrotrack.tracking._acquisition import (
    LONGEST_DWELL,
    Rings,
    SampledMarker,
    find_coloured,
    find_disc,
    is_marker_sized,
    search_ring,
)
from gyrotrack.tracking._orbit import Orbit, common_centre, orbits_about
from gyrotrack.tracking._polar import Ring
from gyrotrack.tracking._profile import Blob, Hue, MarkerProfile, find_blobs, hue_score, nearest_colour
from gyrotrack.tracking._scene import Disc, Samples

Floats = npt.NDArray[np.float64]
Images = npt.NDArray[np.float32]

BINS = 120
APART = np.deg2rad(24.0)
"""Smallest difference between two hues that count as different [rad]."""
SECTOR = np.deg2rad(45.0)
LEAST_CHANGE = 6.0
"""Smallest change of chroma of a moving colour [grey levels]."""
LEAST_SHARE = 0.004
"""Smallest share of a hue in the total change of chroma."""
MOST = 8


@dataclass(frozen=True)
class MovingColour:
    """Differences of chroma of sample frames from their median.

    Attributes
    ----------
    change : ndarray, shape (2, n, height, width)
        Chroma of each sample minus the median of all, where the saturation increases; 0 elsewhere.
    hues : tuple of float
        Directions in the chroma plane (U, V) of the colours that move [rad], the strongest first.
    """

    change: Images
    hues: tuple[float, ...]

    def scores(self, hue: float) -> Images:
        """Return the score of a hue in each pixel of each sample, (n, height, width), 0 if another hue is nearer."""
        score = hue_score(self.change[0], self.change[1], direction_of(hue))
        limit = min((0.5 * apart(hue, other) for other in self.hues if other != hue), default=SECTOR)
        if limit < SECTOR:
            along = np.cos(hue) * self.change[0] + np.sin(hue) * self.change[1]
            across = np.cos(hue) * self.change[1] - np.sin(hue) * self.change[0]
            score[np.abs(across) > np.tan(limit) * along] = 0.0
        return score


def moving_colour(samples: Samples) -> MovingColour:
    """Find the moving colours of sample frames.

    A marker causes a change towards its hue. At a place that it covers in most of the samples, the other samples have
    the opposite change, which decreases the saturation and is excluded.
    """
    chroma = samples.chroma.astype(np.float32)
    still = np.median(chroma, axis=1, keepdims=True)
    change = chroma - still
    stronger = np.hypot(*(chroma - 128.0)) > np.hypot(*(still - 128.0))
    size = np.hypot(change[0], change[1])
    noise = float(np.percentile(size, 75))
    change[:, ~(stronger & (size > max(LEAST_CHANGE, 3.0 * noise)))] = 0.0
    return MovingColour(change, _peaks(change))


def _peaks(change: Images) -> tuple[float, ...]:
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
"""Random triples of points for a centre; more than for a known profile, as most points may be outliers."""
_AMBIGUOUS = 0.35
"""Smallest contrast times share of samples of a second patch of a hue, relative to the first one."""
_SAME_HUE = 18.0
_DISC_HUES = range(0, 360, 30)
_LEAST_DISC = 14.0
"""Smallest chroma of a disc [grey levels]; metal reflects the colour of its surroundings faintly."""
_OFF_CENTRE = 0.3
"""Largest distance of a disc from the centre of the orbits, relative to the smallest radius."""


def find_orbit(
    samples: Samples, moving: MovingColour, hub: tuple[float, float] | None = None
) -> Orbit | None:
    """Find the common centre of the circles of coloured blobs, or their circles about a given hub."""
    points: list[tuple[float, float]] = []
    group: list[int] = []
    for label, hue in enumerate(moving.hues):
        for blobs in _blobs(moving, hue):
            points += [samples.to_luma(b.x, b.y) for b in blobs]
            group += [label] * len(blobs)
    if not points:
        return None
    place, label_of = np.array(points), np.array(group, dtype=np.int64)
    return (
        common_centre(place, label_of, trials=TRIALS) if hub is None else orbits_about(place, label_of, hub)
    )


def _blobs(moving: MovingColour, hue: float) -> list[list[Blob]]:
    scores = moving.scores(hue)
    peaks = [float(np.percentile(score[score > 0], 90)) for score in scores if np.any(score > 0)]
    threshold = max(4.0, 0.4 * float(np.median(peaks))) if peaks else np.inf
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
    """A coloured patch that may be a marker.

    Attributes
    ----------
    hue : float
        In degrees.
    sampled : SampledMarker
        The marker in the samples.
    ambiguous : bool
        There is another patch of the same hue, and the two may be confused.
    """

    hue: float
    sampled: SampledMarker
    ambiguous: bool = False

    @property
    def colour(self) -> Hue:
        """Name of the nearest colour."""
        return nearest_colour(self.hue)

    @property
    def contrast(self) -> float:
        """Difference of chroma from the background [grey levels]."""
        return float(np.hypot(*self.sampled.marker.contrast))


def find_candidates(
    samples: Samples, moving: MovingColour, orbit: Orbit, disc: Disc | None
) -> tuple[Ring, list[Candidate]]:
    """Find a marker of each moving hue in rings about the centre; also return the rings."""
    centre = disc.centre if disc is not None else orbit.centre
    ring = search_ring(samples, centre, disc, max(orbit.radii.values()))
    rings = Rings(samples.strips(ring, range(len(samples.frames))), ring)
    found = []
    for hue in moving.hues:
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
    """Tell whether a second patch has the hue of the first and is significant."""
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


Mask = npt.NDArray[np.bool_]

EVEN = 0.6
"""Smallest share of the observations that are in phase with a steady rotation."""
TOGETHER = 0.75
"""Smallest share of the samples in which two markers of one body have the same distance."""
_REST_STEP, _MOVED = 2e-3, 0.25
_NEAR = 0.2
_FEWEST = 8


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
        """Whether it turns neither in the first frames nor in the course of the film."""
        if abs(self.rotation.step) > _REST_STEP:
            return False
        seen = self.members[0].sampled
        turn = np.exp(1j * seen.angle[seen.clear])
        return bool(np.abs(np.angle(turn / turn.sum())).max() < _MOVED)

    @property
    def weight(self) -> float:
        """Sum of contrast times share of distinct samples over its markers."""
        return sum(c.contrast * float(c.sampled.clear.mean()) for c in self.members)


def rotation(angle: Floats, use: Mask) -> SteadyRotation:
    """Find the step for which most angles of consecutive frames, (n,) in rad, are in phase."""
    frame = np.flatnonzero(use)
    if len(frame) < _FEWEST:
        return SteadyRotation(0.0, 0.0)
    phasor = np.exp(1j * angle[frame])
    steps = np.linspace(-np.pi, np.pi, 32 * (int(frame[-1]) + 1), endpoint=False)
    power = np.abs(np.exp(-1j * np.outer(steps, frame)) @ phasor)
    step = float(steps[np.argmax(power)])
    start = float(np.angle(np.sum(phasor * np.exp(-1j * step * frame))))
    off = np.abs(np.angle(phasor * np.exp(-1j * (start + step * frame))))
    return SteadyRotation(step, float(np.mean(off < 0.35)))


def group_bodies(candidates: list[Candidate], head: int) -> tuple[list[Group], list[Candidate]]:
    """Group markers that move together, the strongest group first; also return those that do not move steadily."""
    groups: list[list[Candidate]] = []
    rotations = {id(c): rotation(c.sampled.angle[:head], c.sampled.clear[:head]) for c in candidates}
    uneven = [c for c in candidates if rotations[id(c)].share < EVEN]
    for one in sorted(candidates, key=lambda c: -c.contrast):
        if any(one is other for other in uneven):
            continue
        group = next((g for g in groups if _together(one, g[0])), None)
        if group is None:
            groups.append([one])
        else:
            group.append(one)
    made = [Group(tuple(g), max((rotations[id(c)] for c in g), key=lambda p: p.share)) for g in groups]
    return sorted(made, key=lambda g: -g.weight), uneven


def _together(a: Candidate, b: Candidate) -> bool:
    both = a.sampled.clear & b.sampled.clear
    if both.sum() < _FEWEST:
        return False
    turn = np.exp(1j * (a.sampled.angle - b.sampled.angle)[both])
    near = np.abs(np.angle(turn[:, None] / turn[None, :])) < _NEAR
    return bool(near.mean(axis=1).max() > TOGETHER)
