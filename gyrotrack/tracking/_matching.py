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

from gyrotrack._native._kernels import loops

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
    if loops is None:
        shift, gain, offset, left, spread = _fit(profile, template, slope, shift, seen, limit, stride)
    else:
        pad = int(np.ceil(limit)) + 2
        padded = (_with_ends(line[None], pad)[0] for line in (template, slope))
        found = np.empty((len(shift), 5))
        given = np.ascontiguousarray(profile), *padded, shift, np.ascontiguousarray(seen)
        loops.fit(*given, found, pad, limit, stride, ROUNDS, FINENESS)
        shift, gain, offset, left, spread = found.T.copy()
    misfit = np.sqrt(np.maximum(left, 0.0) / np.maximum(seen.sum(axis=1), 1)) / np.maximum(np.abs(gain), 1e-3)
    open_ = np.stack([template, np.ones_like(template), slope])
    normal = open_ @ open_.T
    best = float(np.linalg.inv(normal + 1e-9 * (1.0 + np.trace(normal)) * np.eye(3))[2, 2])
    ratio = np.sqrt(np.maximum(spread, 0.0) / best) / np.maximum(np.abs(gain), 1e-3)
    return Match(shift, gain, offset, misfit, np.where(np.isfinite(ratio), ratio, np.inf))


def _fit(
    profile: Floats, template: Floats, slope: Floats, start: Floats, seen: Mask, limit: float, stride: float
) -> Floats:
    """Go on with each profile until its place in the table stands.

    Displacement, gain, offset, sum of squares left over, last entry of the inverse: (5, n).
    """
    weight = seen.astype(np.float64)
    whole = bool(seen.all())
    weighted = profile if whole else weight * profile
    squares = np.einsum("nm,nm->n", weighted, profile)
    table = _Table(template, slope, limit)
    found = np.zeros((5, len(start)))
    found[0] = start
    moving: slice | npt.NDArray[np.int64] = slice(None)
    for _ in range(ROUNDS):
        place = table.place(found[0, moving])
        curve, lean = table.curve[place], table.slope[place]
        normal = table.normal[:, place] if whole else _moments(weight[moving], curve, lean)
        right = _right(weighted[moving], curve, lean)
        solution, spread = _solved(normal, right)
        gain = solution[0]
        off = -solution[2] / np.where(np.abs(gain) > 1e-3, gain, np.inf)
        shift = np.clip(table.shift[place] + np.clip(off, -stride, stride), -limit, limit)
        left = squares[moving] - (solution * right).sum(axis=0)
        found[:, moving] = shift, gain, solution[1], left, spread
        left_over = np.arange(len(start))[moving][table.place(shift) != place]
        if not len(left_over):
            break
        moving = left_over
    return found


class _Table:
    """A template and its slope at many displacements, and the normal equations that go with them."""

    def __init__(self, template: Floats, slope: Floats, limit: float) -> None:
        self._most = int(np.ceil(limit * FINENESS))
        self.shift = np.arange(-self._most, self._most + 1) / FINENESS
        self.curve, self.slope = displaced(template, self.shift), displaced(slope, self.shift)
        self.normal = _moments(np.ones_like(self.curve), self.curve, self.slope)

    def place(self, shift: Floats) -> npt.NDArray[np.int64]:
        """Return the rows of the table that are nearest to displacements."""
        return np.rint(shift * FINENESS).astype(np.int64) + self._most


def _moments(weight: Floats, curve: Floats, slope: Floats) -> Floats:
    """Return the upper triangle of the normal equations of (curve, 1, slope): cc, c1, cs, 11, 1s, ss."""
    a, b = weight * curve, weight * slope
    dot = "nm,nm->n"
    return np.stack([
        np.einsum(dot, a, curve), a.sum(axis=1), np.einsum(dot, a, slope),
        weight.sum(axis=1), b.sum(axis=1), np.einsum(dot, b, slope),
    ])  # fmt: skip


def _right(weighted: Floats, curve: Floats, slope: Floats) -> Floats:
    dot = "nm,nm->n"
    return np.stack([np.einsum(dot, weighted, curve), weighted.sum(axis=1), np.einsum(dot, weighted, slope)])


def _solved(normal: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Solve symmetric 3 x 3 systems by their cofactors; also the last diagonal entry of each inverse."""
    a, b, c, d, e, f = normal
    ridge = 1e-9 * (1.0 + a + d + f)
    a, d, f = a + ridge, d + ridge, f + ridge
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * aa + b * bb + c * cc
    x, y, z = right
    solution = np.stack([aa * x + bb * y + cc * z, bb * x + dd * y + ee * z, cc * x + ee * y + ff * z])
    return solution / determinant, ff / determinant


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
