"""How each marker looks: its radii, width, contrast and place on its body, from rings of the sample frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Disc, Paper
from gyrotrack.profile import MarkerProfile, Profile
from gyrotrack.segmentation.colour import chroma_direction, hue_score
from gyrotrack.segmentation.ring import Ring

Floats = npt.NDArray[np.float64]
Strips = npt.NDArray[np.float32]

LEAST_CONTRAST = 6.0
"""Grey levels of chroma by which a paper must differ from its surroundings."""
FAINTEST = 0.12
"""Share of the strongest marker's contrast below which a colour is only a tinge."""
LEAST_SIZE = 4.5
"""Smallest side of a paper in px."""
LONGEST_STAY = 0.3
"""Share of the samples beyond which a paper over one direction spoils the median as a background."""
WIDEST = 0.8
"""Half width in rad beyond which a marker is smeared too far to be followed."""


@dataclass(frozen=True)
class Sighting:
    """One marker in the samples: the paper, its angle in each sample (rad), and where it was seen clearly."""

    paper: Paper
    angle: Floats
    clear: npt.NDArray[np.bool_]


def find_papers(
    samples: Samples, profile: Profile, centre: tuple[float, float], disc: Disc | None, radius: float | None
) -> tuple[tuple[Paper, ...], tuple[str, ...], tuple[str, ...]]:
    """Find the markers of a profile about a centre: (papers, names of missing ones, notes)."""
    ring = _search_ring(samples, centre, disc, radius)
    strips = samples.strips(ring).astype(np.float32)
    sightings: dict[str, Sighting] = {}
    notes: list[str] = []
    for marker in profile.marker:
        if marker.colour == "white":
            continue
        seen = _find_coloured(strips, ring, marker)
        if seen is not None and _is_paper(seen.paper):
            sightings[marker.name] = seen
    strongest = max((np.hypot(*seen.paper.contrast) for seen in sightings.values()), default=0.0)
    for name in [n for n, s in sightings.items() if np.hypot(*s.paper.contrast) < FAINTEST * strongest]:
        del sightings[name]
    for body in ("casing", "rotor"):
        _place_on_body(sightings, profile, body)
    papers = {name: seen.paper for name, seen in sightings.items()}
    for marker in profile.marker:
        if marker.colour == "white":
            paper = _find_white(samples, ring, marker, sightings)
            if paper is not None and _is_paper(paper):
                papers[marker.name] = paper
    missing = tuple(marker.name for marker in profile.marker if marker.name not in papers)
    ordered = tuple(papers[marker.name] for marker in profile.marker if marker.name in papers)
    return ordered, missing, tuple(notes)


def _is_paper(paper: Paper) -> bool:
    """Tell whether what was found is large enough for a paper, and not smeared too far to be followed."""
    width = 2.0 * np.tan(min(paper.half_width, 1.4)) * paper.radius
    return paper.half_width <= WIDEST and min(width, paper.outer - paper.inner) >= LEAST_SIZE


def _search_ring(
    samples: Samples, centre: tuple[float, float], disc: Disc | None, radius: float | None
) -> Ring:
    width, height = samples.size
    x, y = centre
    border = max(min(x, y, width - 1 - x, height - 1 - y), 8.0)
    corner = max(min(max(x, width - 1 - x), max(y, height - 1 - y)), border)
    outer = corner if radius is None else min(1.9 * radius, corner)
    inner = 1.35 * disc.radius if disc is not None else 0.3 * (radius or border)
    inner = min(inner, 0.8 * outer)
    rows = int(np.clip((outer - inner) / 2.0 + 1, 8, 96))
    return Ring(centre, inner, outer, rows, 512)


def _find_coloured(strips: Strips, ring: Ring, marker: MarkerProfile) -> Sighting | None:
    """Find a coloured paper: in two rounds, the second with the radii and the shade found in the first."""
    direction = chroma_direction(marker.colour)
    still = np.median(strips, axis=1, keepdims=True)
    moving = _scores(strips - still, direction)
    seen = _sight(moving, strips - still, ring, marker)
    if seen is None or _stands(seen):
        level = np.median(strips, axis=3, keepdims=True)
        standing = _sight(_scores(strips - level, direction), strips - level, ring, marker)
        seen = standing if standing is not None else seen
    return seen


def _scores(difference: Strips, direction: tuple[float, float]) -> Strips:
    return hue_score(difference[0], difference[1], direction)


def _stands(seen: Sighting) -> bool:
    """Tell whether a paper lay over one direction so often that the median of the samples may show it."""
    return seen.paper.stay > LONGEST_STAY


def _sight(score: Strips, difference: Strips, ring: Ring, marker: MarkerProfile) -> Sighting | None:
    rows = np.ones(ring.rows, dtype=np.bool_)
    half_width = 0.15
    for _ in range(3):
        profile = _boxed(score[:, rows].mean(axis=1), int(max(half_width / ring.step, 1)))
        column = np.argmax(profile, axis=1)
        peak = profile[np.arange(len(profile)), column]
        clear = peak > 0.5 * np.median(np.sort(peak)[len(peak) // 2 :])
        patch = _aligned(score, column, clear)
        shape = _extent(patch, ring)
        if shape is None:
            return None
        rows, half_width, inner, outer, lean = shape
    middle = patch.shape[1] // 2 + lean
    core = (
        (rows[:, None]) & (np.abs(np.arange(patch.shape[1]) - middle) * ring.step < 0.6 * half_width)[None, :]
    )
    contrast = tuple(float(_aligned(difference[k], column, clear)[core].mean()) for k in (0, 1))
    if np.hypot(*contrast) < LEAST_CONTRAST or clear.mean() < 0.1:
        return None
    paper = Paper(
        marker.name, marker.body, marker.colour, inner, outer, half_width, (contrast[0], contrast[1])
    )
    angle = _refined(score[:, rows].mean(axis=1), (column + lean) * ring.step, half_width, ring)
    return Sighting(replace(paper, stay=_stay(angle, 1.3 * half_width)), angle, clear)


def _stay(angle: Floats, reach: float) -> float:
    apart = np.abs(np.angle(np.exp(1j * (angle[:, None] - angle[None, :]))))
    return float((apart < reach).mean(axis=0).max())


def _aligned(score: Strips, column: npt.NDArray[np.int64], use: npt.NDArray[np.bool_]) -> Floats:
    """Average the strips with the marker brought to the middle, +-1.2 rad of it: (rows, columns)."""
    columns = score.shape[2]
    reach = int(1.2 / (2.0 * np.pi) * columns)
    index = (column[use][:, None] + np.arange(-reach, reach + 1)) % columns
    patch = np.take_along_axis(score[use], index[:, None, :], axis=2)
    return np.asarray(patch.mean(axis=0), dtype=np.float64)


def _extent(patch: Floats, ring: Ring) -> tuple[npt.NDArray[np.bool_], float, float, float, int] | None:
    """Measure the half-maximum extent of a patch: rows, half width, inner and outer radius, column offset."""
    middle = patch.shape[1] // 2
    near = max(int(0.05 / ring.step), 1)
    along = patch[:, middle - near : middle + near + 1].mean(axis=1)
    if along.max() <= 0.0:
        return None
    first, last = _half_maximum(along, int(np.argmax(along)))
    rows = np.zeros(ring.rows, dtype=np.bool_)
    rows[int(np.ceil(first)) : int(np.floor(last)) + 1] = True
    if not rows.any():
        rows[int(np.argmax(along))] = True
    across = patch[rows].mean(axis=0)
    left, right = _half_maximum(across - min(float(np.median(across)), 0.3 * float(across.max())), middle)
    spacing = (ring.outer - ring.inner) / (ring.rows - 1)
    half_width = max(0.5 * (right - left), 0.5) * ring.step
    lean = round(0.5 * (left + right)) - middle
    return rows, half_width, ring.inner + first * spacing, ring.inner + last * spacing, lean


def _half_maximum(curve: Floats, start: int) -> tuple[float, float]:
    """Return where a curve falls to half of its value near `start`, on both sides (fractional index)."""
    half = 0.5 * float(curve[max(start - 1, 0) : start + 2].max())
    left = start
    while left > 0 and curve[left - 1] > half:
        left -= 1
    right = start
    while right < len(curve) - 1 and curve[right + 1] > half:
        right += 1
    first = left - (curve[left] - half) / max(curve[left] - curve[left - 1], 1e-9) if left > 0 else 0.0
    last = (
        right + (curve[right] - half) / max(curve[right] - curve[right + 1], 1e-9)
        if right < len(curve) - 1
        else right
    )
    return float(np.clip(first, left - 1, left)), float(np.clip(last, right, right + 1))


def _boxed(profile: Strips, half: int) -> Floats:
    """Average circularly over 2 half + 1 columns."""
    width = 2 * half + 1
    padded = np.concatenate([profile[:, -half:], profile, profile[:, :half]], axis=1).astype(np.float64)
    total = np.cumsum(np.pad(padded, ((0, 0), (1, 0))), axis=1)
    return np.asarray((total[:, width:] - total[:, :-width]) / width)


def _refined(profile: Strips, angle: Floats, half_width: float, ring: Ring) -> Floats:
    """Replace coarse angles by the centroid of the score around them."""
    reach = int(np.ceil(1.5 * half_width / ring.step)) + 1
    start = np.rint(angle / ring.step).astype(int)
    offset = np.arange(-reach, reach + 1)
    window = np.take_along_axis(profile, (start[:, None] + offset) % ring.columns, axis=1).astype(np.float64)
    window -= window.min(axis=1, keepdims=True)
    shift = (window @ offset) / np.maximum(window.sum(axis=1), 1e-9)
    return np.asarray((start + shift) * ring.step)


def _place_on_body(sightings: dict[str, Sighting], profile: Profile, body: str) -> None:
    """Measure where the markers of a body sit relative to its first one."""
    markers = [marker for marker in profile.of(body) if marker.name in sightings]
    if not markers:
        return
    first = sightings[markers[0].name]
    sense = profile.sense or -1
    zero = sense * (markers[0].mount_angle or 0.0)
    for marker in markers:
        seen = sightings[marker.name]
        both = first.clear & seen.clear
        if both.sum() < 3:
            both = np.ones_like(both)
        mount = _circular_mode(seen.angle[both] - first.angle[both]) + zero
        sightings[marker.name] = replace(seen, paper=replace(seen.paper, mount=mount))


def _circular_mode(angle: Floats) -> float:
    """Return the direction round which most angles lie: the mean of those within 0.15 rad of the densest."""
    turn = np.exp(1j * angle)
    near = np.abs(np.angle(turn[:, None] / turn[None, :])) < 0.15
    best = int(np.argmax(near.sum(axis=0)))
    return float(np.angle(np.mean(turn[near[:, best]])))


def _find_white(
    samples: Samples, ring: Ring, marker: MarkerProfile, sightings: dict[str, Sighting]
) -> Paper | None:
    """Find a white paper: what stays bright at one place of its body while the body turns."""
    others = [seen for seen in sightings.values() if seen.paper.body == marker.body]
    if not others:
        return None
    fine = Ring(ring.centre, ring.inner, ring.outer, ring.rows, ring.columns)
    luma = samples.luma_strips(fine).astype(np.float32)
    body = _body_angles(others, samples.head)
    use = np.isfinite(body)
    if use.sum() < 8:
        return None
    luma = luma - np.median(luma, axis=0)
    column = np.rint(body[use] / ring.step).astype(int)
    index = (column[:, None] + np.arange(ring.columns)) % ring.columns
    turned = np.median(np.take_along_axis(luma[use], index[:, None, :], axis=2), axis=0)
    turned = turned - np.median(turned, axis=1, keepdims=True)
    for seen in others:
        _blank(turned, ring, seen.paper)
    return _brightest(turned, ring, marker, others)


def _body_angles(others: list[Sighting], head: int) -> Floats:
    """Combine sightings into the body's angle in each frame of the head; NaN where none is clear."""
    total = np.zeros(head, dtype=np.complex128)
    for seen in others:
        total += np.where(seen.clear[:head], np.exp(1j * (seen.angle[:head] - seen.paper.mount)), 0.0)
    return np.where(np.abs(total) > 0.5, np.angle(total), np.nan)


def _blank(turned: Strips, ring: Ring, paper: Paper) -> None:
    angle = np.arange(ring.columns) * ring.step
    apart = np.abs(np.angle(np.exp(1j * (angle - paper.mount))))
    turned[:, apart < 1.6 * paper.half_width] = 0.0


def _brightest(turned: Strips, ring: Ring, marker: MarkerProfile, others: list[Sighting]) -> Paper | None:
    """Pick the bright patch that is most like the body's other papers in size and radius."""
    inner = min(seen.paper.inner for seen in others)
    outer = max(seen.paper.outer for seen in others)
    half_width = float(np.median([seen.paper.half_width for seen in others]))
    rows = (ring.radii >= inner) & (ring.radii <= outer)
    if not rows.any():
        return None
    across = _boxed(np.asarray(turned[rows].mean(axis=0)[None, :]), int(max(half_width / ring.step, 1)))
    column = np.argmax(across, axis=1)
    patch = _aligned(np.maximum(turned, 0.0)[None], column, np.array([True]))
    shape = _extent(patch, ring)
    if shape is None:
        return None
    found_rows, found_half, found_inner, found_outer, lean = shape
    middle = patch.shape[1] // 2 + lean
    core = np.abs(np.arange(patch.shape[1]) - middle) * ring.step < 0.6 * found_half
    contrast = float(patch[np.ix_(found_rows, core)].mean())
    noise = float(np.std(turned[rows]))
    if contrast < max(LEAST_CONTRAST, 1.5 * noise) or found_half > 2.5 * half_width + 0.05:
        return None
    mount = float((column[0] + lean) * ring.step)
    return Paper(
        marker.name, marker.body, marker.colour, found_inner, found_outer, found_half, (contrast, 0.0), mount
    )
