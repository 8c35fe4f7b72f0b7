"""Finding a white paper, which has no colour: what stays bright at one place of its turning body."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.coloured import LEAST_CONTRAST, Sighting
from gyrotrack.geometry.patch import aligned, extent_of
from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Paper
from gyrotrack.profile import MarkerProfile
from gyrotrack.segmentation.ring import Ring, boxed

Floats = npt.NDArray[np.float64]


def find_white(samples: Samples, ring: Ring, marker: MarkerProfile, others: list[Sighting]) -> Paper | None:
    """Find a white paper by the coloured markers of the same body, `others`.

    Every frame of the head is turned back by the body's angle, after what stands still in the picture was
    taken off; in the median of these, table, lamps and bar are gone.
    """
    body = _body_angles(others, samples.head)
    use = np.isfinite(body)
    if use.sum() < 8:
        return None
    luma = samples.luma_strips(ring).astype(np.float32)
    luma -= np.median(luma, axis=0)
    column = np.rint(body[use] / ring.step).astype(np.int64)
    index = (column[:, None] + np.arange(ring.columns)) % ring.columns
    turned = np.median(np.take_along_axis(luma[use], index[:, None, :], axis=2), axis=0).astype(np.float64)
    turned -= np.median(turned, axis=1, keepdims=True)
    for seen in others:
        _blank(turned, ring, seen.paper)
    return _brightest(turned, ring, marker, others)


def _body_angles(others: list[Sighting], head: int) -> Floats:
    """Combine sightings into the body's angle in each frame of the head; NaN where none is clear."""
    total = np.zeros(head, dtype=np.complex128)
    for seen in others:
        total += np.where(seen.clear[:head], np.exp(1j * (seen.angle[:head] - seen.paper.mount)), 0.0)
    return np.where(np.abs(total) > 0.5, np.angle(total), np.nan)


def _blank(turned: Floats, ring: Ring, paper: Paper) -> None:
    angle = np.arange(ring.columns) * ring.step
    apart = np.abs(np.angle(np.exp(1j * (angle - paper.mount))))
    turned[:, apart < 1.6 * paper.half_width] = 0.0


def _brightest(turned: Floats, ring: Ring, marker: MarkerProfile, others: list[Sighting]) -> Paper | None:
    """Pick the bright patch that is most like the body's other papers in size and radius."""
    inner = min(seen.paper.inner for seen in others)
    outer = max(seen.paper.outer for seen in others)
    half_width = float(np.median([seen.paper.half_width for seen in others]))
    rows = (ring.radii >= inner) & (ring.radii <= outer)
    if not rows.any():
        return None
    mean = boxed(turned[rows].mean(axis=0)[None, :], int(max(half_width / ring.step, 1)))
    column = np.argmax(mean, axis=1)
    patch = aligned(np.maximum(turned, 0.0)[None].astype(np.float32), column, np.array([True]))
    extent = extent_of(patch, ring)
    if extent is None or extent.half_width > 2.5 * half_width + 0.05:
        return None
    contrast = float(patch[extent.core(patch.shape[1], ring.step)].mean())
    if contrast < max(LEAST_CONTRAST, 1.5 * float(np.std(turned[rows]))):
        return None
    return Paper(
        name=marker.name,
        body=marker.body,
        colour=marker.colour,
        inner=extent.inner,
        outer=extent.outer,
        half_width=extent.half_width,
        contrast=(contrast, 0.0),
        foot=extent.foot,
        mount=float((column[0] + extent.lean) * ring.step),
    )
