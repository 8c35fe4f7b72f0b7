"""Observations of one marker, frame by frame, and which of them are usable.

Glare, shadows and encoder blocks increase the misfit of a profile and displace it. The relation depends on the film and
is estimated from the scatter of the marker: with x the squared misfit of an observation relative to the median, minus
1, its variance is s^2 (1 + share x), and `share` is the maximum-likelihood estimate.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack._column_store import in_file, row_blocks
from gyrotrack._native import _kernels as kernels

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class MarkerObservations:
    """One marker in consecutive frames, about the centre of the ring; NaN where its body is lost."""

    # shape (n,); fine angle as seen [rad], radius of the middle of the marker [px]
    angle: Floats
    radius: Floats
    # shape (n, 2); the near corners about the ring's centre
    corner_angle: Floats
    corner_radius: Floats
    # shape (n,); height relative to the typical one, and rms residual from the template relative to the gain
    gain: Floats
    misfit: Floats
    weakness: Floats  # shape (n,); factor on the uncertainty for occlusion and low gain; see `Match`
    open: Mask  # shape (n,); no part of the marker is known to be occluded
    centre: Floats  # shape (n, 2); centre of the ring in px

    def spread_out(self, index: npt.NDArray[np.int64], count: int) -> MarkerObservations:
        """Place the frames at `index` of `count` frames; see `spread_out`."""
        return MarkerObservations(
            **in_file(
                {f.name: spread_out(getattr(self, f.name), index, count) for f in fields(MarkerObservations)}
            )
        )

    def picked(self, index: npt.NDArray[np.int64]) -> MarkerObservations:
        """Return the frames `index`."""
        return MarkerObservations(
            **in_file({f.name: getattr(self, f.name)[index] for f in fields(MarkerObservations)})
        )

    def at(self, part: slice) -> MarkerObservations:
        """Return some of the frames."""
        return MarkerObservations(**{f.name: getattr(self, f.name)[part] for f in fields(MarkerObservations)})

    def outside(self, inner: float, outer: float, half_width: float, size: tuple[int, int]) -> Mask:
        """Return where a part of the marker lies outside a picture of (width, height) px."""
        found = np.zeros(len(self.angle), dtype=np.bool_)
        for part in row_blocks(len(found)):
            for radius in (inner, outer):
                for side in (-half_width, half_width):
                    x = self.centre[part, 0] + radius * np.cos(self.angle[part] + side)
                    y = self.centre[part, 1] - radius * np.sin(self.angle[part] + side)
                    with np.errstate(invalid="ignore"):
                        found[part] |= (x < 0) | (y < 0) | (x > size[0] - 1) | (y > size[1] - 1)
        return found

    def position(self, good: Mask) -> Floats:
        """Return the position of the middle of the marker, (n, 2) in px; at its median radius where not good."""
        usual = float(np.nanmedian(self.radius[good])) if good.any() else np.nan
        r = np.where(good, self.radius, usual)
        place = np.empty(self.centre.shape)
        place[:, 0] = self.centre[:, 0] + r * np.cos(self.angle)
        place[:, 1] = self.centre[:, 1] - r * np.sin(self.angle)
        return place


def spread_out(values: npt.NDArray[Any], index: npt.NDArray[np.int64], count: int) -> npt.NDArray[Any]:
    """Place rows at `index` of `count` rows; the others are NaN or False."""
    out = np.zeros((count, *values.shape[1:]), dtype=values.dtype)
    if values.dtype != np.bool_:
        out[:] = np.nan
    out[index] = values
    return out


LARGEST = 24.0  # upper limit of the excess of a squared misfit
FEWEST = 30
_SHARES = np.concatenate([[0.0], np.geomspace(0.01, 1.0, 21)])
_FAULT = 5.0


def excess_misfit(misfit: Floats, usual: float) -> Floats:
    """Return the relative excess of squared misfits over the typical one, (n,), at least 0."""
    ratio = np.nan_to_num(misfit, nan=0.0) / max(usual, 1e-9)
    return np.asarray(np.clip(ratio**2 - 1.0, 0.0, LARGEST))


def variance_inflation(off: Floats, excess: Floats) -> float:
    """Return the maximum-likelihood share (0 to 1) of the excess misfit for normal residuals, clipped at 5 sigma."""
    known = np.isfinite(off)
    if known.sum() < FEWEST:
        return 0.0
    clip = _FAULT**2 / 0.4549
    unlikely = kernels.likelihood(off[known] ** 2, excess[known], _SHARES, clip)
    return float(_SHARES[int(np.argmin(unlikely))])


# misfit that illumination alone can cause; occlusion of a tenth of a marker causes more
LARGEST_MISFIT = 0.12
WEAKEST = 4.0  # factor on the uncertainty beyond which a partly occluded marker is not used


@dataclass(frozen=True)
class Candidate:
    """Fine angles of one marker before the fusion."""

    angle: Floats  # as seen, wrapped [rad]
    good: Mask  # where its height and profile are plausible
    open: Mask  # no part of it is occluded
    weak: Floats  # factor on its uncertainty for occlusion and low gain
    misfit_excess: Floats  # excess of the misfit of its profile; see `variance_inflation`
    mount: float  # start value of its mount angle, as seen [rad]


def plausible(seen: MarkerObservations) -> Mask:
    """Return the frames in which a marker has a plausible height and profile."""
    known = np.isfinite(seen.gain) & (seen.weakness < WEAKEST * _usual(seen, seen.weakness))
    whole = known & seen.open
    if not whole.any():
        return whole
    height = float(np.median(seen.gain[whole]))
    known &= (seen.gain > 0.5 * height) & (seen.gain < 2.0 * height)
    typical = float(np.median(seen.misfit[whole]))
    scatter = 1.4826 * float(np.median(np.abs(seen.misfit[whole] - typical)))
    return np.asarray(known & (seen.misfit < max(typical + 6.0 * scatter, LARGEST_MISFIT)))


def candidate(seen: MarkerObservations, angle: Floats, good: Mask, mount: float) -> Candidate:
    """Return a candidate from observations and their corrected angle."""
    columns = {
        "angle": angle,
        "good": good,
        "weak": seen.weakness / _usual(seen, seen.weakness),
        "misfit_excess": excess_misfit(seen.misfit, _usual(seen, seen.misfit)),
    }
    return Candidate(open=seen.open, mount=mount, **in_file(columns))


def _usual(seen: MarkerObservations, values: Floats) -> float:
    whole = seen.open & np.isfinite(values)
    return float(np.median(values[whole])) if whole.any() else 1.0
