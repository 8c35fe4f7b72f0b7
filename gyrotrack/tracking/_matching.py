"""The fine angle of a marker: its tangential profile matched with the mean of its recent profiles.

p(x) = a T(x - d) + b with gain a, offset b and displacement d free in every frame, fitted over those samples
that nothing hides. T is the mean of the frames' own profiles, each brought to zero displacement, and made
symmetric: T(x) = T(-x). A marker with parallel sides smeared by an even motion during the exposure has a
symmetric profile about its middle at mid-exposure, so d is the angle of the middle of the marker at the
middle of the exposure, however wide the smear is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack._native import _kernels as kernels

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

ROUNDS = 8
FINENESS = 8
"""Displacements a sample at which the template is tabulated; in between the fit is linear."""


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
        rms of what the template leaves over in the open samples, relative to the gain.
    weakness : ndarray, shape (n,)
        How much larger the uncertainty of d is than with all samples open and a gain of 1 (from the
        curvature of the fit); inf where d cannot be found.
    """

    shift: Floats
    gain: Floats
    offset: Floats
    misfit: Floats
    weakness: Floats


def match(profile: Floats, template: Floats, start: Floats, seen: Mask) -> Match:
    """Fit gain, offset and displacement of every profile by Gauss-Newton.

    Parameters
    ----------
    profile : ndarray, shape (n, m)
        One profile a frame.
    template : ndarray, shape (m,)
        T on the same samples.
    start : ndarray, shape (n,)
        First guess of the displacement in samples.
    seen : ndarray of bool, shape (n, m)
        Samples that nothing hides.
    """
    slope = np.empty_like(template)
    slope[1:-1] = 0.5 * (template[2:] - template[:-2])
    slope[[0, -1]] = template[1] - template[0], template[-1] - template[-2]
    limit, stride = 0.3 * len(template), 0.08 * len(template)
    shift = np.clip(np.asarray(start, dtype=np.float64), -limit, limit)
    pad = int(np.ceil(limit)) + 2
    curve, lean = (_with_ends(line[None], pad)[0] for line in (template, slope))
    found = kernels.match(profile, curve, lean, shift, seen, pad, limit, stride, ROUNDS, FINENESS)
    shift, gain, offset, left, spread = found.T.copy()
    misfit = np.sqrt(np.maximum(left, 0.0) / np.maximum(seen.sum(axis=1), 1)) / np.maximum(np.abs(gain), 1e-3)
    open_ = np.stack([template, np.ones_like(template), slope])
    normal = open_ @ open_.T
    best = float(np.linalg.inv(normal + 1e-9 * (1.0 + np.trace(normal)) * np.eye(3))[2, 2])
    ratio = np.sqrt(np.maximum(spread, 0.0) / best) / np.maximum(np.abs(gain), 1e-3)
    return Match(shift, gain, offset, misfit, np.where(np.isfinite(ratio), ratio, np.inf))


def displaced(curve: Floats, shift: Floats) -> Floats:
    """Return curve(x - shift) for every shift, (n, m); beyond the ends the end values."""
    m = len(curve)
    place = np.arange(m)[None, :] - shift[:, None]
    return np.asarray(np.interp(place.ravel(), np.arange(m), curve).reshape(place.shape))


def shifted(profile: Floats, shift: Floats) -> Floats:
    """Return profile(x + shift) for each row by cubic (Catmull-Rom) interpolation; the ends are repeated."""
    count = profile.shape[-1]
    whole = np.floor(shift)
    t = (shift - whole)[:, None]
    reach = int(np.abs(whole).max(initial=0.0)) + 2
    padded = _with_ends(profile, reach)
    index = np.arange(len(padded)) * padded.shape[1] + whole.astype(np.int64) + reach
    flat, place = padded.ravel(), index[:, None] + np.arange(count)
    weights = (
        0.5 * t * (t * (2.0 - t) - 1.0),
        0.5 * (t * t * (3.0 * t - 5.0) + 2.0),
        0.5 * t * (t * (4.0 - 3.0 * t) + 1.0),
        0.5 * t * t * (t - 1.0),
    )
    out = np.zeros(place.shape)
    for k, weight in enumerate(weights):
        out += weight * flat.take(place + (k - 1))
    return out


def _with_ends(rows: Floats, reach: int) -> Floats:
    """Go on with the first and the last value of each row, so far to both sides."""
    return np.concatenate([rows[:, :1].repeat(reach, 1), rows, rows[:, -1:].repeat(reach, 1)], axis=1)


def mean_profile(profile: Floats, found: Match, use: Mask, seen: Mask, *, symmetric: bool) -> Floats | None:
    """Return the template that the open samples of the frames in `use` suggest, top at 1 and foot at 0.

    None if there are fewer than three frames, or a part of the profile that none of them shows.
    """
    if use.sum() < 3:
        return None
    aligned = shifted(profile[use], found.shift[use])
    whole = seen[use]
    if not whole.all():
        whole = shifted(whole.astype(np.float64), found.shift[use]) > 0.99
    scaled = (aligned - found.offset[use, None]) / found.gain[use, None]
    template = _clipped_mean(scaled, whole)
    if symmetric:
        template = 0.5 * (template + template[::-1])
    foot = float(0.5 * (template[0] + template[-1])) if symmetric else float(template.min())
    top = float(template.max())
    return np.asarray((template - foot) / (top - foot)) if top - foot > 1e-3 else None


def _clipped_mean(values: Floats, seen: Mask) -> Floats:
    """Mean of each column over its seen values, without those beyond 2.5 standard deviations; NaN if none."""
    for _ in range(2):
        count = seen.sum(axis=0)
        safe = np.maximum(count, 1)
        mean = np.where(seen, values, 0.0).sum(axis=0) / safe
        off = np.where(seen, values - mean, 0.0)
        seen = seen & (np.abs(off) <= 2.5 * np.sqrt((off**2).sum(axis=0) / safe) + 1e-9)
    count = seen.sum(axis=0)
    mean = np.where(seen, values, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, mean, np.nan)


def flat_top(half_width: float, length: int) -> Floats:
    """Return a first template: 1 within `half_width` samples of the middle, falling to 0 over three."""
    x = np.abs(np.arange(length) - (length - 1) / 2.0)
    return np.asarray(np.clip((half_width + 1.5 - x) / 3.0, 0.0, 1.0))
