"""Papers that turn about a common centre, one colour after the other, and the disc at that centre."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrotrack.geometry.acquisition import find_disc
from gyrotrack.geometry.coloured import LONGEST_STAY, Rings, Sighting, find_coloured
from gyrotrack.geometry.orbit import Orbit, common_centre
from gyrotrack.geometry.papers import is_paper, search_ring
from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Disc
from gyrotrack.profile import MarkerProfile
from gyrotrack.proposal.hues import MovingColour, direction_of
from gyrotrack.segmentation.blobs import Blob, find_blobs
from gyrotrack.segmentation.colour import Hue, nearest_colour
from gyrotrack.segmentation.ring import Ring

TRIALS = 1500
"""Triples of points tried for a centre; more than for a known profile, as most colours may be chance."""
_TWIN = 0.35
"""Contrast times share of samples, relative to the first patch, from which a second one of the hue is no accident."""
_SAME_HUE = 18.0
_DISC_HUES = range(0, 360, 30)
_LEAST_DISC = 14.0
"""Chroma in grey levels that makes a disc: metal mirrors a tinge of its surroundings."""
_OFF_CENTRE = 0.3
"""Share of the smallest orbit's radius by which a disc may lie beside the centre of the orbits."""


def find_orbit(samples: Samples, moving: MovingColour) -> Orbit | None:
    """Find the centre that coloured blobs circle, whatever else moves in the picture."""
    points: list[tuple[float, float]] = []
    group: list[int] = []
    for label, hue in enumerate(moving.hues):
        for blobs in _blobs(moving, hue):
            points += [samples.to_luma(b.x, b.y) for b in blobs]
            group += [label] * len(blobs)
    if not points:
        return None
    return common_centre(np.array(points), np.array(group, dtype=np.int64), trials=TRIALS)


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
    """Find a coloured disc at the centre of the orbits, of whatever colour; None where there is none."""
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
    sighting : Sighting
        How it was seen.
    twin : bool
        Another patch of the same hue is there, so that the two can be taken for each other.
    """

    hue: float
    sighting: Sighting
    twin: bool = False

    @property
    def colour(self) -> Hue:
        """Nearest name."""
        return nearest_colour(self.hue)

    @property
    def contrast(self) -> float:
        """Chroma against what lies around it, in grey levels."""
        return float(np.hypot(*self.sighting.paper.contrast))


def find_candidates(
    samples: Samples, moving: MovingColour, orbit: Orbit, disc: Disc | None
) -> tuple[Ring, list[Candidate]]:
    """Look for a paper of each moving hue in rings about the centre; also return the rings."""
    centre = disc.centre if disc is not None else orbit.centre
    ring = search_ring(samples, centre, disc, max(orbit.radii.values()))
    rings = Rings(samples.strips(ring), ring)
    found = []
    for hue in moving.hues:
        one = _candidate(rings, float(np.rad2deg(hue) % 360.0))
        if one is None:
            continue
        other = _candidate(_without(rings, one.sighting), one.hue)
        found.append(replace(one, twin=other is not None and _alike(one, other)))
    return ring, found


def _candidate(rings: Rings, hue: float) -> Candidate | None:
    marker = MarkerProfile(name="x", colour=nearest_colour(hue), body="rotor", hue=hue)
    seen = find_coloured(rings, marker)
    if seen is None or not is_paper(seen.paper):
        return None
    return Candidate(_hue(seen.paper.contrast), seen)


def _alike(one: Candidate, other: Candidate) -> bool:
    """Tell whether a second patch has the hue of the first, and stands out too often to be an accident."""
    share = other.contrast / one.contrast * float(other.sighting.clear.mean())
    return share > _TWIN and abs((one.hue - other.hue + 180.0) % 360.0 - 180.0) < _SAME_HUE


def _without(rings: Rings, seen: Sighting) -> Rings:
    """Return the rings with what usually lies there in the place of a marker."""
    usual = rings.usual
    if seen.paper.stay > LONGEST_STAY:  # the median shows the marker itself
        usual = np.broadcast_to(np.median(usual, axis=2, keepdims=True), usual.shape)
    column = np.arange(rings.ring.columns) * rings.ring.step
    apart = np.abs(np.angle(np.exp(1j * (column[None, :] - seen.angle[:, None]))))
    here = apart < 1.8 * seen.paper.half_width + 0.05
    plain = np.rint(usual).astype(np.uint8)
    return Rings(np.where(here[None, :, None, :], plain[:, None], rings.strips), rings.ring)
