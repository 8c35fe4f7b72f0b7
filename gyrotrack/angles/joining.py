"""From the sightings of markers to the angle of their body, without a slipped turn.

The coarse path that followed the body counts the turns; each marker adds its fine angle as a small departure from it. Markers
are brought together by where they sit on the body, weighted by how much each one scatters about the smooth motion;
one that departs from the others is flagged and left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.local import local_fit, spread
from gyrotrack.angles.watching import Sightings
from gyrotrack.dataset.records import STATUS

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

HALF_WINDOW = 20
FAR = 6.0
"""Standard deviations beyond which a sighting is taken for a fault."""


@dataclass(frozen=True)
class MarkerAngles:
    """One marker's fine angles after the correction of the view.

    Attributes
    ----------
    angle : ndarray, shape (n,)
        As seen, wrapped [rad].
    sigma : ndarray, shape (n,)
        Uncertainty from the marker's own scatter [rad].
    status : ndarray of int8, shape (n,)
        See `STATUS`.
    mount : float
        Where it sits on the body, as seen [rad].
    """

    angle: Floats
    sigma: Floats
    status: npt.NDArray[np.int8]
    mount: float


@dataclass(frozen=True)
class BodyAngles:
    """A body's angle: unwrapped as seen [rad], its uncertainty, and how many markers gave it; NaN where none did."""

    angle: Floats
    sigma: Floats
    count: npt.NDArray[np.int64]
    markers: dict[str, MarkerAngles]


def plausible(seen: Sightings) -> Mask:
    """Frames in which a marker stands out at its usual height with its usual profile."""
    known = np.isfinite(seen.gain)
    if not known.any():
        return known
    tall = known & (seen.gain > 0.5 * np.nanpercentile(seen.gain, 75))
    if not tall.any():
        return tall
    limit = max(3.0 * float(np.median(seen.misfit[tall])), 0.03)
    radial = max(4.0 * float(np.median(seen.radial_misfit[tall])), 0.05)
    return tall & (seen.misfit < limit) & (seen.radial_misfit < radial)


def join(
    coarse: Floats,
    fine: dict[str, Floats],
    good: dict[str, Mask],
    mounts: dict[str, float],
    *,
    given: frozenset[str],
) -> BodyAngles:
    """Join the markers of one body.

    Parameters
    ----------
    coarse : ndarray, shape (n,)
        Unwrapped coarse angle of the body as seen [rad], NaN where it was lost.
    fine : dict of ndarray, shape (n,)
        Fine angle of each marker as seen [rad].
    good : dict of ndarray of bool, shape (n,)
        Where each marker is to be trusted by its looks.
    mounts : dict of float
        First values of where they sit.
    given : frozenset of str
        Markers whose place the profile fixes; the others' places are measured relative to the first marker.
    """
    use = {name: mask & np.isfinite(coarse) & np.isfinite(fine[name]) for name, mask in good.items()}
    mounts = dict(mounts)
    scatter = dict.fromkeys(fine, 0.01)
    body = _weighted(coarse, fine, use, mounts, scatter)[0]
    for _ in range(4):
        mounts = _placed(coarse, body, fine, use, mounts, given)
        body = _weighted(coarse, fine, use, mounts, scatter)[0]
        smooth, leverage = local_fit(body - coarse, np.isfinite(body).astype(float), HALF_WINDOW)
        for name in fine:
            off = _wrap(fine[name] - coarse - mounts[name]) - smooth
            mine = off[use[name]] / np.sqrt(np.maximum(1.0 - leverage[use[name]] / len(fine), 0.1))
            if np.isfinite(mine).sum() >= 8:
                scatter[name] = max(spread(mine), 1e-5)
            use[name] = use[name] & ~(np.abs(off) > FAR * scatter[name] + 1e-3)
    angle, sigma, count = _weighted(coarse, fine, use, mounts, scatter)
    markers = {}
    for name in fine:
        status = np.full(len(coarse), STATUS["lost"], dtype=np.int8)
        status[np.isfinite(coarse) & np.isfinite(fine[name])] = STATUS["occluded"]
        status[use[name]] = STATUS["ok"]
        markers[name] = MarkerAngles(
            np.where(use[name], _wrap(fine[name]), np.nan),
            np.where(use[name], scatter[name], np.nan),
            status,
            mounts[name],
        )
    return BodyAngles(angle, sigma, count, markers)


def _weighted(
    coarse: Floats,
    fine: dict[str, Floats],
    use: dict[str, Mask],
    mounts: dict[str, float],
    scatter: dict[str, float],
) -> tuple[Floats, Floats, npt.NDArray[np.int64]]:
    total, weight = np.zeros(len(coarse)), np.zeros(len(coarse))
    count = np.zeros(len(coarse), dtype=np.int64)
    for name, angle in fine.items():
        w = use[name] / scatter[name] ** 2
        total += np.where(use[name], w * _wrap(angle - coarse - mounts[name]), 0.0)
        weight += w
        count += use[name]
    seen = weight > 0
    safe = np.where(seen, weight, 1.0)
    return (
        np.where(seen, coarse + total / safe, np.nan),
        np.where(seen, 1.0 / np.sqrt(safe), np.nan),
        count,
    )


def _placed(
    coarse: Floats,
    body: Floats,
    fine: dict[str, Floats],
    use: dict[str, Mask],
    mounts: dict[str, float],
    given: frozenset[str],
) -> dict[str, float]:
    """Measure the markers' places anew against the body's smooth path; the first free one keeps its own."""
    smooth, _ = local_fit(body - coarse, np.isfinite(body).astype(float), HALF_WINDOW)
    shift = {}
    for name in fine:
        off = _wrap(fine[name] - coarse - mounts[name]) - smooth
        off = off[use[name] & np.isfinite(off)]
        shift[name] = float(np.median(off)) if len(off) else 0.0
    fixed = [name for name in fine if name in given] or [next(iter(fine))]
    zero = float(np.mean([shift[name] for name in fixed]))
    return {name: mounts[name] + (0.0 if name in given else shift[name] - zero) for name in fine}


def _wrap(angle: Floats) -> Floats:
    return np.asarray(np.angle(np.exp(1j * angle)))
