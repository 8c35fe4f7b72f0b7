"""Which sightings of a marker are to be trusted by their looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.oddity import excess_misfit
from gyrotrack.angles.sightings import Sightings
from gyrotrack.dataset.columns import put_away

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

LARGEST_MISFIT = 0.12
"""Misfit that light alone can cause: something that hides a tenth of a marker leaves more."""
WEAKEST = 4.0
"""Factor on the uncertainty beyond which a partly hidden marker is not used."""


@dataclass(frozen=True)
class Candidate:
    """Fine angles of one marker before they are joined.

    Attributes
    ----------
    angle : ndarray, shape (n,)
        As seen, wrapped [rad].
    good : ndarray of bool, shape (n,)
        Where it is to be trusted by its looks.
    open : ndarray of bool, shape (n,)
        Nothing stands before any part of it.
    weak : ndarray, shape (n,)
        Factor on its uncertainty for what is hidden or dim.
    odd : ndarray, shape (n,)
        By how much its profile fits less well than usual; see `oddity`.
    mount : float
        First value of where it sits on the body, as seen [rad].
    """

    angle: Floats
    good: Mask
    open: Mask
    weak: Floats
    odd: Floats
    mount: float


def plausible(seen: Sightings) -> Mask:
    """Frames in which a marker stands out at its usual height, with its usual profile where it is open."""
    known = np.isfinite(seen.gain) & (seen.weakness < WEAKEST * _usual(seen, seen.weakness))
    whole = known & seen.open
    if not whole.any():
        return whole
    height = float(np.median(seen.gain[whole]))
    known &= (seen.gain > 0.5 * height) & (seen.gain < 2.0 * height)
    typical = float(np.median(seen.misfit[whole]))
    scatter = 1.4826 * float(np.median(np.abs(seen.misfit[whole] - typical)))
    return np.asarray(known & (seen.misfit < max(typical + 6.0 * scatter, LARGEST_MISFIT)))


def candidate(seen: Sightings, angle: Floats, good: Mask, mount: float) -> Candidate:
    """Make a candidate from sightings and their corrected angle."""
    columns = {
        "angle": angle,
        "good": good,
        "weak": seen.weakness / _usual(seen, seen.weakness),
        "odd": excess_misfit(seen.misfit, _usual(seen, seen.misfit)),
    }
    return Candidate(open=seen.open, mount=mount, **put_away(columns))


def _usual(seen: Sightings, values: Floats) -> float:
    whole = seen.open & np.isfinite(values)
    return float(np.median(values[whole])) if whole.any() else 1.0
