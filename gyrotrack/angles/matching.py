"""The fine angle of a marker: its profile across, matched with the mean of its own recent profiles.

p(x) = a T(x - d) + b with gain a, offset b and displacement d free in every frame. T is the mean of the frames' own
profiles, each brought to zero displacement, and made symmetric: T(x) = T(-x). A paper with parallel sides smeared by an
even motion during the exposure has a symmetric profile about its middle at mid-exposure, so d is the angle of
the middle of the paper at the middle of the exposure, however wide the smear is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Match:
    """A batch of matched profiles.

    Attributes
    ----------
    shift : ndarray, shape (n,)
        Displacement d in samples.
    gain, offset : ndarray, shape (n,)
        a and b, in units of the profiles.
    misfit : ndarray, shape (n,)
        rms of what the template leaves over, relative to the gain.
    """

    shift: Floats
    gain: Floats
    offset: Floats
    misfit: Floats


def shifted(profile: Floats, shift: Floats) -> Floats:
    """Return profile(x + shift) for each row by cubic (Catmull-Rom) interpolation; the ends are repeated."""
    count = profile.shape[-1]
    whole = np.floor(shift)
    t = (shift - whole)[:, None]
    index = np.arange(count)[None, :] + whole.astype(np.int64)[:, None]
    weights = (
        0.5 * t * (t * (2.0 - t) - 1.0),
        0.5 * (t * t * (3.0 * t - 5.0) + 2.0),
        0.5 * t * (t * (4.0 - 3.0 * t) + 1.0),
        0.5 * t * t * (t - 1.0),
    )
    out = np.zeros(profile.shape)
    for k, weight in enumerate(weights):
        out += weight * np.take_along_axis(profile, np.clip(index + (k - 1), 0, count - 1), axis=1)
    return out


def match(profile: Floats, template: Floats, start: Floats | None = None, rounds: int = 3) -> Match:
    """Fit gain, offset and displacement of every profile by Gauss-Newton.

    Parameters
    ----------
    profile : ndarray, shape (n, m)
        One profile a frame.
    template : ndarray, shape (m,)
        T on the same samples.
    start : ndarray, shape (n,), optional
        First guess of the displacement in samples.
    """
    slope = np.gradient(template)
    design = np.stack([template, np.ones_like(template), slope], axis=1)
    solve = np.linalg.pinv(design).T
    shift = np.zeros(len(profile)) if start is None else np.array(start, dtype=np.float64)
    limit = 0.3 * len(template)
    for _ in range(rounds):
        aligned = shifted(profile, shift)
        gain, offset, tangent = (aligned @ solve).T
        step = -tangent / np.where(np.abs(gain) > 1e-6, gain, np.inf)
        shift = np.clip(shift + np.clip(step, -3.0, 3.0), -limit, limit)
    left = aligned - np.outer(gain, template) - offset[:, None] - np.outer(tangent, slope)
    misfit = np.sqrt(np.mean(left**2, axis=1)) / np.maximum(np.abs(gain), 1e-6)
    return Match(shift, gain, offset, misfit)


def mean_profile(profile: Floats, found: Match, use: Mask, *, symmetric: bool) -> Floats | None:
    """Return the template that the frames in `use` suggest, its top at 1 and its foot at 0; None if too few."""
    if use.sum() < 3:
        return None
    aligned = shifted(profile[use], found.shift[use])
    scaled = (aligned - found.offset[use, None]) / found.gain[use, None]
    template = np.median(scaled, axis=0) if len(scaled) < 12 else _trimmed_mean(scaled)
    if symmetric:
        template = 0.5 * (template + template[::-1])
    foot = float(min(template[0], template[-1])) if symmetric else float(template.min())
    top = float(template.max())
    return None if top - foot < 1e-3 else np.asarray((template - foot) / (top - foot))


def _trimmed_mean(values: Floats) -> Floats:
    """Mean without the lowest and highest tenth of each column."""
    cut = len(values) // 10
    order = np.sort(values, axis=0)
    return np.asarray(order[cut : len(values) - cut].mean(axis=0))


def flat_top(half_width: float, length: int) -> Floats:
    """Return a first template: 1 within `half_width` samples of the middle, falling to 0 over three samples."""
    x = np.abs(np.arange(length) - (length - 1) / 2.0)
    return np.asarray(np.clip((half_width + 1.5 - x) / 3.0, 0.0, 1.0))
