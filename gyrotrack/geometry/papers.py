"""All markers of a scene: how each looks in the clip, and where it sits on its body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.coloured import Rings, Sighting, find_coloured
from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Disc, Paper
from gyrotrack.geometry.white import find_white
from gyrotrack.profile import Profile
from gyrotrack.segmentation.ring import Ring

Floats = npt.NDArray[np.float64]

FAINTEST = 0.12
"""Share of the strongest marker's contrast below which a colour is only a tinge."""
LEAST_SIZE = 4.5
"""Smallest side of a paper in px."""
WIDEST = 0.8
"""Half width in rad beyond which a marker is smeared too far to be followed."""


def find_papers(
    samples: Samples, profile: Profile, centre: tuple[float, float], disc: Disc | None, radius: float | None
) -> dict[str, Paper]:
    """Find the markers of a profile about a centre; those that are not seen are left out.

    Parameters
    ----------
    centre : tuple of float
        (x, y) in px.
    disc : Disc or None
        What lies at the centre and is no marker.
    radius : float or None
        The largest orbit that was seen, in px.
    """
    ring = search_ring(samples, centre, disc, radius)
    rings = Rings(samples.strips(ring), ring)
    sightings = {
        marker.name: seen
        for marker in profile.marker
        if marker.colour != "white"
        and (seen := find_coloured(rings, marker)) is not None
        and is_paper(seen.paper)
    }
    sightings = _placed(_strong(sightings), profile)
    papers = {name: seen.paper for name, seen in sightings.items()}
    for marker in profile.marker:
        others = [seen for seen in sightings.values() if seen.paper.body == marker.body]
        if marker.colour == "white" and others:
            paper = find_white(samples, ring, marker, others)
            if paper is not None and is_paper(paper):
                papers[marker.name] = paper
    return {marker.name: papers[marker.name] for marker in profile.marker if marker.name in papers}


def search_ring(
    samples: Samples, centre: tuple[float, float], disc: Disc | None, radius: float | None
) -> Ring:
    """Lay a ring that holds all markers: from the disc to beyond the largest orbit, in the picture."""
    width, height = samples.size
    x, y = centre
    border = max(min(x, y, width - 1 - x, height - 1 - y), 8.0)
    corner = max(min(max(x, width - 1 - x), max(y, height - 1 - y)), border)
    outer = corner if radius is None else min(1.9 * radius, corner)
    inner = 1.35 * disc.radius if disc is not None else 0.3 * (radius or border)
    inner = min(inner, 0.8 * outer)
    rows = int(np.clip((outer - inner) / 2.0 + 1, 8, 96))
    return Ring(centre, inner, outer, rows, 512)


def is_paper(paper: Paper) -> bool:
    """Tell whether what was found is large enough, and not smeared too far to be followed."""
    width = 2.0 * np.tan(min(paper.half_width, 1.4)) * paper.radius
    return bool(paper.half_width <= WIDEST and min(width, paper.outer - paper.inner) >= LEAST_SIZE)


def _strong(sightings: dict[str, Sighting]) -> dict[str, Sighting]:
    contrast = {name: float(np.hypot(*seen.paper.contrast)) for name, seen in sightings.items()}
    least = FAINTEST * max(contrast.values(), default=0.0)
    return {name: seen for name, seen in sightings.items() if contrast[name] >= least}


def _placed(sightings: dict[str, Sighting], profile: Profile) -> dict[str, Sighting]:
    found: dict[str, Sighting] = {}
    for body in ("casing", "rotor"):
        names = [marker.name for marker in profile.of(body) if marker.name in sightings]
        found |= dict(zip(names, placed([sightings[name] for name in names]), strict=True))
    return found


def placed(sightings: list[Sighting]) -> list[Sighting]:
    """Measure where the markers of one body sit relative to the first one of them."""
    found = []
    for seen in sightings:
        first = sightings[0]
        both = first.clear & seen.clear
        apart = (seen.angle - first.angle)[both if both.sum() >= 3 else slice(None)]
        found.append(replace(seen, paper=replace(seen.paper, mount=_circular_mode(apart))))
    return found


def _circular_mode(angle: Floats) -> float:
    """Return the direction round which most angles lie: the mean of those within 0.15 rad of it."""
    turn = np.exp(1j * angle)
    near = np.abs(np.angle(turn[:, None] / turn[None, :])) < 0.15
    best = int(np.argmax(near.sum(axis=0)))
    return float(np.angle(np.mean(turn[near[:, best]])))
