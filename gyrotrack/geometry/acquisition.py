"""Finding the scene in a clip: what turns about which centre, and how each marker looks.

Nothing is known beforehand but the names of colours. First blobs that change from frame to frame are
collected for each colour, and the point that they circle; then the disc at that point; then, in rings
unrolled about it, each paper with its radii, width and true shade (`papers`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.errors import TrackingError
from gyrotrack.geometry.orbit import Orbit, common_centre
from gyrotrack.geometry.papers import find_papers
from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Disc, Scene
from gyrotrack.profile import Profile
from gyrotrack.segmentation.blobs import Blob, find_blobs
from gyrotrack.segmentation.colour import chroma_direction, hue_score

Floats = npt.NDArray[np.float64]
_NO_DISC = "no disc at the centre: the centre is taken from the markers' orbit"


def acquire(samples: Samples, profile: Profile, where: str) -> Scene:
    """Find the scene in sample frames.

    Raises
    ------
    TrackingError
        If no marker of the profile can be found.
    """
    orbit = _find_orbit(samples, profile)
    circle = chroma_direction(profile.circle_colour, profile.circle_hue)
    disc = find_disc(samples, circle, orbit) if profile.centre == "circle" else None
    if disc is None and orbit is None:
        raise TrackingError(
            f"no markers found in {where}: nothing in the profile's colours turns about a centre",
            "check the profile's colours (--profile); where nothing turns, a disc must mark the centre",
        )
    centre = disc.centre if disc is not None else orbit.centre if orbit is not None else (0.0, 0.0)
    radius = max(orbit.radii.values()) if orbit is not None else None
    papers = find_papers(samples, profile, centre, disc, radius)
    if not papers:
        names = ", ".join(marker.name for marker in profile.marker)
        raise TrackingError(
            f"no markers found in {where}: none of {names} is seen about the centre",
            "check the profile's colours (--profile)",
        )
    missing = tuple(marker.name for marker in profile.marker if marker.name not in papers)
    warnings = (_NO_DISC,) if disc is None and profile.centre == "circle" else ()
    return Scene(centre, disc, tuple(papers.values()), missing, warnings)


def _find_orbit(samples: Samples, profile: Profile) -> Orbit | None:
    chroma = samples.chroma
    still = np.median(chroma, axis=1).astype(np.float32)
    points: list[tuple[float, float]] = []
    group: list[int] = []
    colours = {chroma_direction(m.colour, m.hue): m.colour for m in profile.marker if m.colour != "white"}
    for label, direction in enumerate(sorted(colours, key=colours.__getitem__)):
        scores = [hue_score(u - still[0], v - still[1], direction) for u, v in zip(*chroma, strict=True)]
        for blobs in _blobs_in(scores, most=2):
            points += [samples.to_luma(b.x, b.y) for b in blobs]
            group += [label] * len(blobs)
    if not points:
        return None
    return common_centre(np.array(points), np.array(group, dtype=np.int64))


def _blobs_in(scores: list[npt.NDArray[np.float32]], most: int) -> list[list[Blob]]:
    """Find blobs above half of the typical peak of a colour, in every sample."""
    peaks = np.array([np.percentile(score, 99.9) if score.size else 0.0 for score in scores])
    noise = float(np.median([np.percentile(score, 90) for score in scores]))
    threshold = max(6.0, 4.0 * noise, 0.4 * float(np.median(peaks)))
    return [find_blobs(score, threshold, most) for score in scores]


def find_disc(samples: Samples, direction: tuple[float, float], orbit: Orbit | None) -> Disc | None:
    """Find a disc whose chroma lies in a direction (U, V), well inside the orbit; None where there is none."""
    still = np.median(samples.chroma, axis=1).astype(np.float32)
    neutral = [_neutral(plane, samples, orbit) for plane in still]
    score = hue_score(still[0] - neutral[0], still[1] - neutral[1], direction)
    if orbit is not None:
        score = score * _near(score.shape, samples, orbit)
    peak = float(np.percentile(score[score > 0], 99)) if np.any(score > 6.0) else 0.0
    if peak < 10.0:
        return None
    blobs = find_blobs(score, 0.5 * peak, most=6)
    if orbit is None:
        blobs = [blob for blob in blobs if blob.fill > 0.7]
    if not blobs:
        return None
    blob = max(blobs, key=lambda b: b.weight * b.fill**2)
    mean = _mean_chroma(still, neutral, score, 0.5 * peak, blob)
    return Disc(samples.to_luma(blob.x, blob.y), samples.scale * float(np.sqrt(blob.area / np.pi)), mean)


def _neutral(plane: npt.NDArray[np.float32], samples: Samples, orbit: Orbit | None) -> float:
    if orbit is None:
        return float(np.median(plane))
    near = _near(plane.shape, samples, orbit) > 0
    return float(np.median(plane[near])) if near.any() else float(np.median(plane))


def _near(shape: tuple[int, ...], samples: Samples, orbit: Orbit) -> npt.NDArray[np.float32]:
    """Mask of what lies within 0.45 of the largest orbit around its centre."""
    y, x = np.ogrid[: shape[0], : shape[1]]
    lx, ly = samples.scale * x + (samples.scale - 1) / 2.0, samples.scale * y + (samples.scale - 1) / 2.0
    reach = 0.45 * max(orbit.radii.values())
    return (np.hypot(lx - orbit.centre[0], ly - orbit.centre[1]) < reach).astype(np.float32)


def _mean_chroma(
    still: npt.NDArray[np.float32],
    neutral: list[float],
    score: npt.NDArray[np.float32],
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
