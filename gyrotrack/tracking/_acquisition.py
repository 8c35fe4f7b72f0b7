"""Acquisition of the scene: centre of rotation, disc and markers.

Only the names of the colours are known beforehand. The score of a pixel is the difference of its colour from the
background in the hue of a marker (`hue_score`). A strip is a ring about the centre, unrolled to rows of equal radius
and columns of equal angle. First, blobs that change between frames are collected for each colour, and the common centre
of their circles is found. Then the disc at this centre is found. Finally, each marker is found in rings about the
centre, with its radii, width and measured shade (`find_markers`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Bools, Floats, Integers, Singles
from gyrotrack._errors import TrackingError
from gyrotrack._smoothing import spread
from gyrotrack.tracking._orbit import Orbit, common_centre, covered_angle, orbits_about
from gyrotrack.tracking._polar import Ring, boxed
from gyrotrack.tracking._profile import (
    Blob,
    MarkerProfile,
    Profile,
    chroma_direction,
    find_blobs,
    hue_score,
    nearest_colour,
)
from gyrotrack.tracking._scene import Disc, Marker, Samples, Scene

REACH = 1.2
"""Half width of the region about a marker that is used [rad]. Chosen: larger than `WIDEST`; a smaller value cuts off
blurred markers, a larger one includes their neighbours."""


@dataclass(frozen=True)
class Extent:
    """Region in which a patch exceeds half of its maximum."""

    rows: Bools  # rows of the ring on the marker
    inner: float  # inner and outer radius [px]
    outer: float
    half_width: float  # half width at half maximum [rad]
    lean: int  # displacement of the middle of the region from the middle of the patch [columns]
    foot: float = 0.0  # half width at a tenth of the maximum [rad]

    def core(self, columns: int, step: float) -> Bools:
        """Return the mask of the pixels well inside the marker, (rows, columns)."""
        x = (np.arange(columns) - columns // 2 - self.lean) * step
        return np.asarray(self.rows[:, None] & (np.abs(x) < 0.6 * self.half_width)[None, :])


def aligned(score: Singles, column: Integers, use: Bools, reach: int | None = None) -> Floats:
    """Return the trimmed mean of the strips about a marker over the samples `use`, (rows, columns).

    The mean of the middle quarter of the values is used, because a hand may occlude the marker in some samples. The
    strips extend by `reach` columns to both sides of the marker, by default by the angle `REACH`.
    """
    rows, columns = score.shape[1:]
    reach = _reach(columns) if reach is None else reach
    chosen = np.flatnonzero(use)
    patch = np.empty((len(chosen), rows, 2 * reach + 1), dtype=score.dtype)
    for own, k in zip(patch, chosen, strict=True):
        np.take(score[k], np.arange(column[k] - reach, column[k] + reach + 1), axis=1, out=own, mode="wrap")
    patch.sort(axis=0)
    tail = 3 * len(patch) // 8
    return np.asarray(patch[tail : len(patch) - tail].mean(axis=0), dtype=np.float64)


def _reach(columns: int) -> int:
    return int(REACH / (2.0 * np.pi) * columns)


def extent_of(patch: Floats, ring: Ring) -> Extent | None:
    """Measure the region in which a patch exceeds half of its maximum; None if its score is not positive."""
    middle = patch.shape[1] // 2
    near = max(int(0.05 / ring.step), 1)
    along = patch[:, middle - near : middle + near + 1].mean(axis=1)
    if along.max() <= 0.0:
        return None
    first, last = half_maximum(along, int(np.argmax(along)))
    rows = np.zeros(ring.rows, dtype=np.bool_)
    rows[int(np.ceil(first)) : int(np.floor(last)) + 1] = True
    if not rows.any():
        rows[int(np.argmax(along))] = True
    across = patch[rows].mean(axis=0)
    across = across - min(float(np.median(across)), 0.3 * float(across.max()))
    left, right = half_maximum(across, middle)
    low, high = half_maximum(across, middle, 0.1)
    spacing = (ring.outer - ring.inner) / (ring.rows - 1)
    half_width = max(0.5 * (right - left), 0.5) * ring.step
    lean = round(0.5 * (left + right)) - middle
    foot = 0.5 * (high - low) * ring.step
    return Extent(rows, ring.inner + first * spacing, ring.inner + last * spacing, half_width, lean, foot)


def half_maximum(curve: Floats, start: int, part: float = 0.5) -> tuple[float, float]:
    """Return where a curve falls to half (or another `part`) of its maximum, on both sides of `start`."""
    half = part * float(curve[max(start - 1, 0) : start + 2].max())
    return start - _fall(curve[start::-1], half), start + _fall(curve[start:], half)


def _fall(curve: Floats, level: float) -> float:
    """Return where a curve first falls to a level; its last index if it never does."""
    below = np.flatnonzero(curve[1:] <= level)
    if not len(below):
        return float(len(curve) - 1)
    k = int(below[0])
    return k + float(np.clip((curve[k] - level) / max(float(curve[k] - curve[k + 1]), 1e-9), 0.0, 1.0))


LEAST_CONTRAST = 6.0
"""Smallest difference of a marker from its surroundings, in chroma, or in luma for a white marker [grey levels].
Chosen: a smaller value accepts noise, a larger one loses markers in dim light."""
CLEAREST = 5.0
"""Smallest brightness of a white marker above its ring, in standard deviations of the ring [1]. Chosen: a smaller value
accepts remains of other markers, a larger one loses faint white markers."""
LONGEST_DWELL = 0.3
"""Largest share of the samples in which a marker may be at one angle if the median of the samples serves as the
background [1]. Chosen: above 0.5 the median shows the marker itself; a smaller value discards the background of slow
bodies."""


@dataclass(frozen=True)
class SampledMarker:
    """One marker in the samples: the marker, its angle [rad], and a mask of the samples that show it clearly."""

    marker: Marker
    angle: Floats
    clear: Bools


class Rings:
    """Unrolled chroma of the samples, (2, n, rows, columns) of uint8, and its difference from the background."""

    def __init__(self, strips: npt.NDArray[np.uint8], ring: Ring) -> None:
        self.strips, self.ring = strips, ring

    @cached_property
    def background(self) -> Singles:
        """Median over the samples at every pixel, (2, rows, columns)."""
        return np.asarray(np.median(self.strips, axis=1), dtype=np.float32)

    @cached_property
    def row_background(self) -> Singles:
        """Median of each sample along each row, (2, n, rows, 1)."""
        return np.asarray(np.median(self.strips, axis=3, keepdims=True), dtype=np.float32)

    # not cached: this array, and the array of rings without a marker, would be the largest arrays in memory
    @property
    def foreground(self) -> Singles:
        """Difference of each sample from `background`."""
        return np.subtract(self.strips, self.background[:, None], dtype=np.float32)

    @property
    def ring_difference(self) -> Singles:
        """Difference of each sample from the median along each row, for markers that hardly move."""
        return np.subtract(self.strips, self.row_background, dtype=np.float32)


def find_coloured(rings: Rings, wanted: MarkerProfile) -> SampledMarker | None:
    """Find a coloured marker in rings about the centre.

    By default, the background is the median over the samples at every pixel. It is the median along each row in two
    cases: the marker is at one angle in more than `LONGEST_DWELL` of the samples, or the patch does not have the size
    of a marker. An example of such a patch is the residue that a codec leaves of a marker at rest.
    """
    seen = _locate(rings.foreground, rings.ring, wanted)
    if seen is None or seen.marker.dwell > LONGEST_DWELL or not is_marker_sized(seen.marker):
        by_ring = _locate(rings.ring_difference, rings.ring, wanted)
        seen = by_ring if by_ring is not None else seen
    return seen


_LEAST_CLEAR = 0.1
"""Smallest share of the samples in which a marker is clearly visible [1]. Chosen: a smaller value accepts random
patches, a larger one loses markers that are often occluded."""


def _locate(difference: Singles, ring: Ring, wanted: MarkerProfile) -> SampledMarker | None:
    """Find the patch of a colour in each sample.

    If the background is not grey, the hue of the difference from the background is not the hue of the marker. The patch
    is first found with the hue of the profile, and its hue is measured. If a search with the measured hue finds the
    same patch, the measured hue is used.
    """
    score = _scores(difference, chroma_direction(wanted.colour, wanted.hue))
    own = score
    extent = Extent(np.ones(ring.rows, dtype=np.bool_), ring.inner, ring.outer, 0.15, 0)
    for _ in range(3):
        half = int(max(extent.half_width / ring.step, 1))
        column, clear = _brightest(score[:, extent.rows].mean(axis=1), half)
        found = extent_of(aligned(own, column, clear), ring) if clear.any() else None
        if found is None:
            return None
        extent = found
        u, v = (_mean_in(part, column, clear, extent, ring) for part in difference)
        size = float(np.hypot(u, v))
        own = _scores(difference, (u / size, v / size)) if size > 0.0 else score
        again, _ = _brightest(own[:, extent.rows].mean(axis=1), half)
        apart = (again - column + ring.columns // 2) % ring.columns - ring.columns // 2
        if np.mean(np.abs(apart[clear]) <= 2 * half) > 0.5:
            score = own
    if size < LEAST_CONTRAST or clear.mean() < _LEAST_CLEAR:
        return None
    coarse = np.asarray((column + extent.lean) * ring.step, dtype=np.float64)
    angle = _refined(own[:, extent.rows].mean(axis=1), coarse, extent.half_width, ring)
    marker = _marker(wanted, extent, (u, v), dwell=_dwell(angle, 1.3 * extent.half_width))
    return SampledMarker(marker, angle, clear)


def _mean_in(part: Singles, column: Integers, use: Bools, extent: Extent, ring: Ring) -> float:
    """Return the mean of the strips well inside the marker."""
    most = _reach(ring.columns)
    reach = min(int(np.ceil(0.6 * extent.half_width / ring.step)) + abs(extent.lean), most)
    patch = aligned(part, column, use, reach)
    return float(patch[extent.core(patch.shape[1], ring.step)].mean())


def _marker(wanted: MarkerProfile, extent: Extent, contrast: tuple[float, float], **place: Any) -> Marker:
    named: dict[str, Any] = {key: getattr(wanted, key) for key in ("name", "body", "colour")}
    sized: dict[str, Any] = {key: getattr(extent, key) for key in ("inner", "outer", "half_width", "foot")}
    return Marker(**named, **sized, contrast=contrast, **place)


def _scores(difference: Singles, direction: tuple[float, float]) -> Singles:
    return np.stack([hue_score(u, v, direction) for u, v in zip(*difference, strict=True)])


_TYPICAL = 0.6
"""Quantile, over the samples, of the largest score in a sample; it is the typical score of the marker [1]. Chosen: the
marker is occluded in less than half of the samples, and a hand has a larger score in less than a third of the
samples."""
_CLEARLY = 0.5
"""A marker is clearly visible in a sample if the largest score in the sample, divided by the typical score, is at least
this value [1]. Chosen: a smaller value accepts residues of the codec, a larger one loses shaded markers."""


def _brightest(profile: Singles, half: int) -> tuple[Integers, Bools]:
    """Return the column with the largest score in each sample, and whether this score is typical."""
    mean = boxed(profile, half)
    column = np.argmax(mean, axis=1)
    peak = mean[np.arange(len(mean)), column]
    return column, peak > _CLEARLY * float(np.quantile(peak, _TYPICAL))


def _dwell(angle: Floats, reach: float) -> float:
    """Return the largest share of the angles that are within `reach` of one angle."""
    apart = np.abs(np.angle(np.exp(1j * (angle[:, None] - angle[None, :]))))
    return float((apart < reach).mean(axis=0).max())


def _refined(profile: Singles, angle: Floats, half_width: float, ring: Ring) -> Floats:
    """Replace coarse angles by the centroid of the score around them."""
    reach = int(np.ceil(1.5 * half_width / ring.step)) + 1
    start = np.rint(angle / ring.step).astype(int)
    offset = np.arange(-reach, reach + 1)
    window = np.take_along_axis(profile, (start[:, None] + offset) % ring.columns, axis=1).astype(np.float64)
    window -= window.min(axis=1, keepdims=True)
    shift = (window @ offset) / np.maximum(window.sum(axis=1), 1e-9)
    return np.asarray((start + shift) * ring.step)


_LEAST_KNOWN = 8
"""A white marker is searched for if the angle of the body is known in at least this number of samples [samples].
Chosen: with fewer the mean contains other objects, with more the marker is lost in short films."""


def find_white(
    samples: Samples,
    frames: Sequence[int],
    ring: Ring,
    wanted: MarkerProfile,
    others: list[SampledMarker],
    least: float = LEAST_CONTRAST,
) -> Marker | None:
    """Find a white marker with the coloured markers of the same body, `others`, in the samples `frames`.

    The median of the frames is subtracted, and each frame is rotated back by the angle of the body. The median of the
    rotated frames shows only what turns with the body, without table, lamps or bar.
    """
    body = _body_angles(others, len(frames))
    use = np.isfinite(body)
    if use.sum() < _LEAST_KNOWN:
        return None
    luma = samples.luma_strips(ring, frames).astype(np.float32)
    luma -= np.median(luma, axis=0)
    column = np.rint(body[use] / ring.step).astype(np.int64)
    index = (column[:, None] + np.arange(ring.columns)) % ring.columns
    turned = np.median(np.take_along_axis(luma[use], index[:, None, :], axis=2), axis=0).astype(np.float64)
    turned -= np.median(turned, axis=1, keepdims=True)
    for seen in others:
        _blank(turned, ring, seen.marker)
    return _brightest_place(turned, ring, wanted, others, least)


def _body_angles(others: list[SampledMarker], count: int) -> Floats:
    """Combine observations into the angle of the body in each of the first samples; NaN without a clear marker."""
    total = np.zeros(count, dtype=np.complex128)
    for seen in others:
        total += np.where(seen.clear[:count], np.exp(1j * (seen.angle[:count] - seen.marker.mount)), 0.0)
    return np.where(np.abs(total) > 0.5, np.angle(total), np.nan)


def _blank(turned: Floats, ring: Ring, marker: Marker) -> None:
    angle = np.arange(ring.columns) * ring.step
    apart = np.abs(np.angle(np.exp(1j * (angle - marker.mount))))
    turned[:, apart < 1.6 * marker.half_width] = 0.0


_WIDER = 2.5
"""Largest half width of a white marker: this value times the half width of the other markers, plus `_WIDER_BY` [1].
Chosen: a smaller value refuses white markers of another shape, a larger one accepts reflections."""
_WIDER_BY = 0.05
"""Constant part of the largest half width of a white marker (see `_WIDER`) [rad]. Chosen: for narrow markers; a smaller
value refuses blurred markers, a larger one accepts reflections."""


def _brightest_place(
    turned: Floats, ring: Ring, wanted: MarkerProfile, others: list[SampledMarker], least: float
) -> Marker | None:
    """Return the brightest patch of the width and at the radii of the other markers of the body."""
    inner = min(seen.marker.inner for seen in others)
    outer = max(seen.marker.outer for seen in others)
    half_width = float(np.median([seen.marker.half_width for seen in others]))
    rows = (ring.radii >= inner) & (ring.radii <= outer)
    if not rows.any():
        return None
    mean = boxed(turned[rows].mean(axis=0)[None, :], int(max(half_width / ring.step, 1)))
    column = np.argmax(mean, axis=1)
    patch = aligned(np.maximum(turned, 0.0)[None].astype(np.float32), column, np.array([True]))
    extent = extent_of(patch, ring)
    if extent is None or extent.half_width > _WIDER * half_width + _WIDER_BY:
        return None
    contrast = float(patch[extent.core(patch.shape[1], ring.step)].mean())
    apart = np.abs(np.angle(np.exp(1j * (np.arange(ring.columns) - column[0]) * ring.step)))
    scatter = spread(mean[0][apart > 2.0 * half_width])  # robust against the remains of other markers
    if contrast < least or mean[0, column[0]] < CLEAREST * scatter:
        return None
    mount = float((column[0] + extent.lean) * ring.step)
    return _marker(wanted, extent, (contrast, 0.0), mount=mount)


FAINTEST = 0.12
"""Smallest contrast of a marker, relative to the contrast of the strongest marker [1]. Chosen: a smaller value accepts
residues of the codec, a larger one loses markers in shadow."""
LEAST_SIZE = 4.5
"""Smallest side of a marker [px]. Chosen: two samples of the chroma; a smaller value accepts single noisy samples, a
larger one refuses small markers."""
WIDEST = 0.8
"""Largest half width of a marker that can be tracked despite motion blur [rad]. Chosen: a larger value accepts coloured
rings, a smaller one refuses films of long exposure."""


def find_markers(
    samples: Samples,
    profile: Profile,
    centre: tuple[float, float],
    disc: Disc | None,
    radius: float | None,
    where: str,
) -> tuple[dict[str, Marker], dict[str, tuple[float, float]], tuple[str, ...]]:
    """Find the visible markers of a profile; also return `Scene.offsets` and `Scene.doubts`.

    Each body is searched for in a ring about the hub `centre` (x, y) [px], without the `disc`, and again about the
    centre of its orbits if this centre differs from the hub. `radius` is the radius of the largest orbit [px], and
    `where` is the name of the film for messages.
    """
    frames = samples.spread
    ring = search_ring(samples, centre, disc, radius)
    about_hub = Rings(samples.strips(ring, frames), ring)
    observations: dict[str, SampledMarker] = {}
    offsets: dict[str, tuple[float, float]] = {}
    for body in ("casing", "rotor"):
        rings, found = about_hub, _coloured(about_hub, profile, body)
        for _ in range(2):
            offset = orbit_offset(rings, list(found.values()))
            if offset is None:
                break
            x, y = offsets.get(body, (0.0, 0.0))
            offsets[body] = x + offset[0], y + offset[1]
            moved = ring.moved((centre[0] + offsets[body][0], centre[1] + offsets[body][1]))
            rings = Rings(samples.strips(moved, frames), moved)
            found = _coloured(rings, profile, body)
        observations |= found
    observations = _strong(observations)
    misplaced = {name: observations.pop(name).marker for name in _on_other_body(observations, where)}
    observations = _placed(observations, profile)
    markers = {name: seen.marker for name, seen in observations.items()}
    for wanted in profile.marker:
        others = [seen for seen in observations.values() if seen.marker.body == wanted.body]
        if wanted.colour == "white" and others:
            x, y = offsets.get(wanted.body, (0.0, 0.0))
            marker = find_white(samples, frames, ring.moved((centre[0] + x, centre[1] + y)), wanted, others)
            if marker is not None and is_marker_sized(marker):
                markers[wanted.name] = marker
    doubts = tuple(
        f"The {name} marker of the {marker.body} turns with the markers of the other body and is omitted: it is on "
        f"that body, and its {_hue_of(marker)} was taken for {marker.colour}. Write a profile with `gyrotrack profile`."
        for name, marker in misplaced.items()
    )
    return {m.name: markers[m.name] for m in profile.marker if m.name in markers}, offsets, doubts


def _hue_of(marker: Marker) -> str:
    return nearest_colour(float(np.rad2deg(np.arctan2(marker.contrast[1], marker.contrast[0]))))


def _coloured(rings: Rings, profile: Profile, body: str) -> dict[str, SampledMarker]:
    coloured = [wanted for wanted in profile.of(body) if wanted.colour != "white"]
    found = ((wanted.name, find_coloured(rings, wanted)) for wanted in coloured)
    return {name: seen for name, seen in found if seen is not None and is_marker_sized(seen.marker)}


LEAST_COVERED = 4.0
"""The centre of a body is measured if the samples of its markers cover at least this angle [rad]. Chosen: a smaller
value mistakes the radius of an arc for an offset, a larger one needs more samples."""
LEAST_TURNED = 0.5
"""The markers that turn with a marker are determined if the samples of this marker cover at least this angle [rad].
Chosen: a smaller value compares markers at rest, a larger one compares none in slow films."""
LEAST_OFFSET = 1.0
"""Offset of the orbits from the hub below which rings about the hub are used [px]. Chosen: half a chroma sample; a
smaller value follows noise, with a larger one the windows are off centre."""


def orbit_offset(rings: Rings, found: list[SampledMarker]) -> tuple[float, float] | None:
    """Return the offset of the centre of a body's orbits from the centre of the rings, (x, y) in px, y downwards.

    The offset e is fitted by least squares to the radii of the markers, r = rho_m + e . (cos theta, sin theta), where
    rho_m is the radius of the orbit of marker m, and theta is the angle of the marker. Residuals beyond three standard
    deviations are excluded. The result is None unless the length of e exceeds three standard errors and `LEAST_OFFSET`.
    """
    rows, radii, directions = [], [], []
    for k, seen in enumerate(found):
        radius = _radii(rings, seen)
        use = seen.clear & np.isfinite(radius)
        own = np.zeros((int(use.sum()), 2 + len(found)))
        own[:, 0], own[:, 1], own[:, 2 + k] = np.cos(seen.angle[use]), np.sin(seen.angle[use]), 1.0
        rows.append(own)
        radii.append(radius[use])
        directions.append(seen.angle[use])
    if not rows or sum(map(len, radii)) < 12 or covered_angle(np.concatenate(directions)) < LEAST_COVERED:
        return None
    design, radius = np.concatenate(rows), np.concatenate(radii)
    keep = np.ones(len(radius), dtype=np.bool_)
    for _ in range(4):
        if keep.sum() < 4 + len(found):
            return None
        solution = np.linalg.lstsq(design[keep], radius[keep], rcond=None)[0]
        residual = radius - design @ solution
        scatter = max(spread(residual[keep]), 0.2)
        keep = np.abs(residual) < 3.0 * scatter
    error = scatter * np.sqrt(np.linalg.pinv(design[keep].T @ design[keep])[:2, :2].trace())
    x, y = float(solution[0]), float(solution[1])
    return (x, -y) if np.hypot(x, y) > max(3.0 * error, LEAST_OFFSET) else None


def _radii(rings: Rings, seen: SampledMarker) -> Floats:
    """Return the radius of the middle of a marker in each sample [px]; NaN where an edge is not found."""
    difference = rings.ring_difference if seen.marker.dwell > LONGEST_DWELL else rings.foreground
    u, v = seen.marker.contrast
    score = (u * difference[0] + v * difference[1]) / (u * u + v * v)
    step, ring = rings.ring.step, rings.ring
    reach = max(int(0.6 * seen.marker.half_width / step), 1)
    column = np.rint(seen.angle / step).astype(np.int64)[:, None] + np.arange(-reach, reach + 1)
    along = np.take_along_axis(score, (column % ring.columns)[:, None, :], axis=2).mean(axis=2)
    spacing = float(ring.radii[1] - ring.radii[0])
    out = np.full(len(along), np.nan)
    for k, curve in enumerate(along.astype(np.float64)):
        low, high = half_maximum(curve, int(np.argmax(curve)))
        if low > 0.0 and high < len(curve) - 1:
            out[k] = ring.inner + 0.5 * (low + high) * spacing
    return out


def search_ring(
    samples: Samples, centre: tuple[float, float], disc: Disc | None, radius: float | None
) -> Ring:
    """Return a ring that contains all markers: from the disc to beyond the largest orbit, within the picture."""
    width, height = samples.size
    x, y = centre
    border = max(min(x, y, width - 1 - x, height - 1 - y), 8.0)
    corner = max(min(max(x, width - 1 - x), max(y, height - 1 - y)), border)
    outer = corner if radius is None else min(1.9 * radius, corner)
    inner = 1.35 * disc.radius if disc is not None else 0.3 * (radius or border)
    inner = min(inner, 0.8 * outer)
    rows = int(np.clip((outer - inner) / 2.0 + 1, 8, 96))
    return Ring(centre, inner, outer, rows, 512)


def is_marker_sized(marker: Marker) -> bool:
    """Return whether a patch is at least `LEAST_SIZE` large and not wider than `WIDEST`."""
    width = 2.0 * np.tan(min(marker.half_width, 1.4)) * marker.radius
    return bool(marker.half_width <= WIDEST and min(width, marker.outer - marker.inner) >= LEAST_SIZE)


def _strong(observations: dict[str, SampledMarker]) -> dict[str, SampledMarker]:
    contrast = {name: float(np.hypot(*seen.marker.contrast)) for name, seen in observations.items()}
    least = FAINTEST * max(contrast.values(), default=0.0)
    return {name: seen for name, seen in observations.items() if contrast[name] >= least}


LEAST_TOGETHER = 0.75
"""Smallest share of the samples in which two markers of one body have the same angular distance [1]. Chosen: a smaller
value joins two bodies, a larger one separates markers that are often occluded."""
_LEAST_COMMON = 8
"""Smallest number of samples that show both markers [samples]. Chosen: with a smaller value, markers agree by chance;
with a larger one, fewer markers are compared."""
_NEAR = 0.2
"""Largest difference of two angular distances that count as equal [rad]. Chosen: a smaller value separates blurred
markers, a larger one joins bodies of similar speed."""


def share_together(a: SampledMarker, b: SampledMarker) -> float:
    """Return the largest share of the samples in which two markers have one angular distance; NaN for few samples."""
    both = a.clear & b.clear
    if both.sum() < _LEAST_COMMON:
        return float("nan")
    turn = np.exp(1j * (a.angle - b.angle)[both])
    near = np.abs(np.angle(turn[:, None] / turn[None, :])) < _NEAR
    return float(near.mean(axis=1).max())


def _on_other_body(found: dict[str, SampledMarker], where: str) -> list[str]:
    """Return markers of one body that turn with the other body's markers; a TrackingError if this is ambiguous.

    If the colours of a film differ from the profile, the colour of a rotor marker may be nearest to the colour of the
    casing's marker. If two markers turn together, the one with fewer co-rotating markers of its body is wrong.
    """
    turning = [one for one in found.values() if covered_angle(one.angle[one.clear]) > LEAST_TURNED]

    def agreement(one: SampledMarker) -> int:
        own = [m for m in turning if m is not one and m.marker.body == one.marker.body]
        share = [share_together(one, other) for other in own]
        return sum(s > LEAST_TOGETHER for s in share) - sum(s <= LEAST_TOGETHER for s in share)

    wrong = []
    for one in (m for m in turning if m.marker.body == "casing"):
        for other in (m for m in turning if m.marker.body != "casing"):
            if not share_together(one, other) > LEAST_TOGETHER:
                continue
            if agreement(one) == agreement(other):
                raise TrackingError(
                    f"The {one.marker.name} marker of the casing and the {other.marker.name} marker of the rotor turn "
                    f"together in {where}: the colours of the profile are not those of the film.",
                    "Write a profile with `gyrotrack profile`, or track the casing only (--body casing).",
                )
            wrong.append(min(one, other, key=agreement).marker.name)
    return list(dict.fromkeys(wrong))


def _placed(observations: dict[str, SampledMarker], profile: Profile) -> dict[str, SampledMarker]:
    found: dict[str, SampledMarker] = {}
    for body in ("casing", "rotor"):
        names = [wanted.name for wanted in profile.of(body) if wanted.name in observations]
        found |= dict(zip(names, placed([observations[name] for name in names]), strict=True))
    return found


def placed(observations: list[SampledMarker]) -> list[SampledMarker]:
    """Measure the mount angles of the markers of one body relative to the first marker."""
    found = []
    for seen in observations:
        first = observations[0]
        both = first.clear & seen.clear
        apart = (seen.angle - first.angle)[both if both.sum() >= 3 else slice(None)]
        found.append(replace(seen, marker=replace(seen.marker, mount=_circular_mode(apart))))
    return found


_OF_MODE = 0.15
"""Largest distance of an averaged angle from the mode of the angles [rad]. Chosen: a smaller value averages few angles,
a larger one includes outliers."""


def _circular_mode(angle: Floats) -> float:
    """Return the mean of the angles within `_OF_MODE` of the angle with most neighbours."""
    turn = np.exp(1j * angle)
    near = np.abs(np.angle(turn[:, None] / turn[None, :])) < _OF_MODE
    best = int(np.argmax(near.sum(axis=0)))
    return float(np.angle(np.mean(turn[near[:, best]])))


LEAST_AGREEMENT = 1.0 / 3.0
"""Smallest share of the blobs, and of the samples, that are inliers of an orbit [1]. Measured: a quarter of random
blobs are inliers; it is not recorded in which films."""
_NO_DISC = "There is no disc at the centre; the orbits of the markers determine it."


def acquire(samples: Samples, profile: Profile, where: str) -> Scene:
    """Find the scene in sample frames; a TrackingError if no marker is found, or if two bodies are confused."""
    orbit = _find_orbit(samples, profile, where)
    circle = chroma_direction(profile.circle_colour, profile.circle_hue)
    disc = find_disc(samples, circle, orbit) if profile.centre == "circle" and profile.hub is None else None
    if disc is None and orbit is None:
        raise TrackingError(
            f"No markers found in {where}: nothing in the colours of the profile turns about a centre.",
            "Check the colours of the profile (--profile). If the camera moves by more than a few pixels, film from a "
            "stand. If nothing turns, mark the centre with a disc.",
        )
    centre = disc.centre if disc is not None else orbit.centre if orbit is not None else (0.0, 0.0)
    radius = max(orbit.radii.values()) if orbit is not None else None
    markers, offsets, doubts = find_markers(samples, profile, centre, disc, radius, where)
    if not markers:
        names = ", ".join(wanted.name for wanted in profile.marker)
        what = f"No markers found in {where}: none of {names} is visible about the centre."
        raise TrackingError(what, "Check the colours of the profile (--profile).")
    missing = tuple(wanted.name for wanted in profile.marker if wanted.name not in markers)
    sought = profile.centre == "circle" and profile.hub is None
    warnings = (_NO_DISC,) if disc is None and sought else ()
    body_of: dict[str, str] = {wanted.name: wanted.body for wanted in profile.marker}
    return Scene(centre, disc, tuple(markers.values()), missing, warnings, offsets, body_of, doubts)


def _find_orbit(samples: Samples, profile: Profile, where: str) -> Orbit | None:
    chroma = samples.chroma
    still = samples.still
    colours = {chroma_direction(m.colour, m.hue): m.colour for m in profile.marker if m.colour != "white"}
    found = []
    for direction in sorted(colours, key=colours.__getitem__):
        scores = [hue_score(u - still[0], v - still[1], direction) for u, v in zip(*chroma, strict=True)]
        found.append(_blobs_in(scores, most=2))
    place, label_of = places_of(samples, found)
    if not len(place):
        return None
    if profile.hub is not None:
        return orbits_about(place, label_of, profile.hub)
    orbit = common_centre(place, label_of)
    enough = LEAST_AGREEMENT * max(len(place), chroma.shape[1])
    if orbit is None or orbit.inliers <= enough:
        return None
    _refuse_second_body(orbit, place, label_of, chroma.shape[1], where)
    return orbit


def places_of(samples: Samples, found: Sequence[list[list[Blob]]]) -> tuple[Floats, Integers]:
    """Return the positions of blobs in the luma plane, (n, 2) [px], and the index of their colour in `found`."""
    group = [k for k, frames in enumerate(found) for blobs in frames for _ in blobs]
    points = [samples.to_luma(b.x, b.y) for frames in found for blobs in frames for b in blobs]
    return np.array(points, dtype=np.float64), np.array(group, dtype=np.int64)


_BEYOND = 1.1
"""Smallest distance of the blobs of a second body from the centre, relative to the outermost orbit [1]. Chosen: a
smaller value includes blurred markers, a larger one misses neighbouring bodies."""


def _refuse_second_body(orbit: Orbit, place: Floats, label: Integers, count: int, where: str) -> None:
    """Raise a TrackingError if blobs outside the orbits that were found turn about a second centre."""
    outer = max(orbit.radii.values())
    beyond = np.hypot(*(place - orbit.centre).T) > _BEYOND * outer
    other = common_centre(place[beyond], label[beyond])
    if other is None or other.inliers <= 0.5 * count or other.spread < LEAST_COVERED:
        return
    if np.hypot(*np.subtract(other.centre, orbit.centre)) > outer + 0.5 * max(other.radii.values()):
        (x, y), (u, v) = sorted((orbit.centre, other.centre))
        raise TrackingError(
            f"Two bodies with markers of these colours turn in {where}: one about ({x:.0f}, {y:.0f}) px, one about "
            f"({u:.0f}, {v:.0f}) px.",
            "In the profile, give the centre of the body to track (hub).",
        )


_LEAST_SCORE = 6.0
"""Smallest score of a blob [grey levels]. Chosen: as `LEAST_CONTRAST`; a smaller value accepts noise, a larger one
loses faint markers."""
_OVER_NOISE = 4.0
"""Smallest score of a blob, divided by the 90th percentile of the scores [1]. Chosen: a smaller value accepts noise, a
larger one loses faint markers."""
_OF_PEAK = 0.4
"""Smallest score of a blob, divided by the typical peak of its colour [1]. Chosen: a smaller value joins blobs with
their surroundings, a larger one divides blobs."""


def _blobs_in(scores: list[Singles], most: int) -> list[list[Blob]]:
    """Find blobs above `_OF_PEAK` times the typical peak of a colour in every sample."""
    levels = [np.percentile(score, [90.0, 99.9]) if score.size else (0.0, 0.0) for score in scores]
    noise, peaks = float(np.median([low for low, _ in levels])), [high for _, high in levels]
    threshold = max(_LEAST_SCORE, _OVER_NOISE * noise, _OF_PEAK * float(np.median(peaks)))
    return [find_blobs(score, threshold, most) for score in scores]


_DISC_SEEN = 6.0
"""Smallest score of a pixel that may belong to a disc [grey levels]. Chosen: as `LEAST_CONTRAST`; a smaller value
searches in noise, a larger one loses faint discs."""
_DISC_PEAK = 10.0
"""Smallest peak score of a disc; the peak is the 99th percentile of the scores [grey levels]. Chosen: a smaller value
accepts reflections, a larger one loses faint discs."""
_DISC_FILL = 0.7
"""If no orbit is known, smallest area of a disc, divided by the area of the smallest circle about the disc [1]. Chosen:
a full disc has 1; a smaller value accepts rectangles and arcs, a larger one loses noisy discs."""


def find_disc(samples: Samples, direction: tuple[float, float], orbit: Orbit | None) -> Disc | None:
    """Find a disc whose chroma has the direction (U, V), well inside the orbit; None if there is none."""
    still = samples.still
    neutral = [_neutral(plane, samples, orbit) for plane in still]
    score = hue_score(still[0] - neutral[0], still[1] - neutral[1], direction)
    if orbit is not None:
        score = score * _near(score.shape, samples, orbit)
    peak = float(np.percentile(score[score > 0], 99)) if np.any(score > _DISC_SEEN) else 0.0
    if peak < _DISC_PEAK:
        return None
    blobs = find_blobs(score, 0.5 * peak, most=6)
    if orbit is None:
        blobs = [blob for blob in blobs if blob.fill > _DISC_FILL]
    if not blobs:
        return None
    blob = max(blobs, key=lambda b: b.weight * b.fill**2)
    mean = _mean_chroma(still, neutral, score, 0.5 * peak, blob)
    return Disc(samples.to_luma(blob.x, blob.y), samples.scale * float(np.sqrt(blob.area / np.pi)), mean)


def _neutral(plane: Singles, samples: Samples, orbit: Orbit | None) -> float:
    if orbit is None:
        return float(np.median(plane))
    near = _near(plane.shape, samples, orbit) > 0
    return float(np.median(plane[near])) if near.any() else float(np.median(plane))


def _near(shape: tuple[int, ...], samples: Samples, orbit: Orbit) -> Singles:
    """Return the mask of the pixels within 0.45 of the largest radius from the centre of the orbits."""
    y, x = np.ogrid[: shape[0], : shape[1]]
    lx, ly = samples.scale * x + (samples.scale - 1) / 2.0, samples.scale * y + (samples.scale - 1) / 2.0
    reach = 0.45 * max(orbit.radii.values())
    return (np.hypot(lx - orbit.centre[0], ly - orbit.centre[1]) < reach).astype(np.float32)


def _mean_chroma(
    still: Singles,
    neutral: list[float],
    score: Singles,
    threshold: float,
    blob: Blob,
) -> tuple[float, float]:
    reach = int(np.ceil(np.sqrt(blob.area)))
    y0, x0 = max(int(blob.y) - reach, 0), max(int(blob.x) - reach, 0)
    window = (slice(y0, y0 + 2 * reach + 1), slice(x0, x0 + 2 * reach + 1))
    core = score[window] > threshold
    return (
        float(np.mean(still[0][window][core]) - neutral[0]),
        float(np.mean(still[1][window][core]) - neutral[1]),
    )
