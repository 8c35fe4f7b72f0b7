"""Where a clip may start: stretches of the casing's record that turn as fast, and speed up as much.

Each clip is summed up by the speed, acceleration and jerk in its middle, from a cubic with harmonics; so is
the casing's record around every moment. A stretch fits if the two triples agree within their errors and the
freedom of the clock rate, which multiplies them by r, r^2 and r^3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from gyrotrack.dataset.records import Floats
from gyrotrack.sync.curves import Curve, harmonics

RATE_SIGMA = 1e-3
LONGEST = 3.0
GRID = 0.1
FINE = 0.005
APART = 0.3
MOST = 5
THRESHOLD = 100.0
ALLOWANCE = np.array([0.02, 0.02, 0.05])  # what a cubic misses of a motion, in rad s-1, s-2, s-3


@dataclass(frozen=True)
class Motion:
    """Speed, acceleration and jerk at one moment, (3,) in rad s-1, s-2, s-3, and their covariance (3, 3)."""

    value: Floats
    covariance: Floats


def motion(curve: Curve, moment: float) -> Motion | None:
    """Fit a cubic with harmonics about `moment`; None if there is too little to fit."""
    s = curve.time - moment
    width = np.ptp(s) / 2 if len(s) else 0.0
    if len(s) < 24 or width <= 0:
        return None
    u = s / width
    basis = np.column_stack([np.ones_like(u), u, u**2 / 2, u**3 / 6, harmonics(curve.angle)])
    weighted = basis / curve.sigma[:, None]
    prior = np.zeros((4, 8))
    prior[:, 4:] = np.eye(4) / 0.02  # keeps the harmonics of a casing that hardly turns from running away
    matrix = np.vstack([weighted, prior])
    target = np.concatenate([(curve.angle - curve.angle.mean()) / curve.sigma, np.zeros(4)])
    solution, _, rank, _ = np.linalg.lstsq(matrix, target, rcond=None)
    if rank < basis.shape[1]:
        return None
    excess = max(1.0, float(np.sum((target - matrix @ solution) ** 2)) / (len(s) - 8))
    covariance = np.linalg.inv(matrix.T @ matrix)[1:4, 1:4] * excess
    scale = width ** -np.arange(1.0, 4.0)
    return Motion(solution[1:4] * scale, covariance * np.outer(scale, scale))


@dataclass(frozen=True)
class Survey:
    """The casing's motion all along its record, summed up over stretches of 2 `half` seconds."""

    half: float
    moments: Floats
    motions: tuple[Motion, ...]


def half_length(clip: Curve) -> float:
    """Return half the length over which a clip is summed up [s]; clips alike share it, and a survey."""
    return min(round(clip.duration / 2, 1), LONGEST / 2) or clip.duration / 2


def survey(casing: Curve, half: float) -> Survey:
    """Sum up the casing's motion around every moment of its record."""
    moments, found = [], []
    expected = 2 * half / float(np.median(np.diff(casing.time)))
    for moment in np.arange(casing.time[0], casing.time[-1], min(GRID, half / 4)):
        piece = casing.between(moment - half, moment + half)
        fitted = motion(piece, moment) if len(piece.time) > expected / 2 else None
        if fitted is not None:
            moments.append(moment)
            found.append(fitted)
    return Survey(half, np.asarray(moments), tuple(found))


def candidates(record: Survey, clip: Curve) -> list[float]:
    """Return possible starts of the clip on the casing's clock [s], at most a handful, the best first."""
    middle = (clip.time[0] + clip.time[-1]) / 2
    mine = motion(clip.between(middle - record.half, middle + record.half), middle)
    moments, theirs = record.moments, record.motions
    if mine is None or len(moments) < 4:
        return []
    fine = np.arange(moments[0], moments[-1], FINE)
    value = CubicSpline(moments, np.array([m.value for m in theirs]))(fine)
    nearest = np.clip(np.searchsorted(moments, fine), 0, len(moments) - 1)
    covariance = np.array([m.covariance for m in theirs])[nearest] + mine.covariance
    covariance = covariance + np.diag(ALLOWANCE**2)
    stretch = value * np.array([1.0, 2.0, 3.0])
    covariance = covariance + RATE_SIGMA**2 * stretch[:, :, None] * stretch[:, None, :]
    difference = mine.value - value
    distance = np.einsum("ni,ni->n", difference, np.linalg.solve(covariance, difference[:, :, None])[:, :, 0])
    return [float(fine[i] - middle) for i in _valleys(distance)]


def _valleys(distance: Floats) -> list[int]:
    """Return the lowest points of the valleys that are deep enough, the deepest first."""
    padded = np.concatenate([[np.inf], distance, [np.inf]])
    low = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] < padded[2:])
    deep = np.flatnonzero(low & (distance < distance.min() + THRESHOLD))
    chosen: list[int] = []
    for i in deep[np.argsort(distance[deep])]:
        if all(abs(i - j) * FINE > APART for j in chosen):
            chosen.append(int(i))
    return chosen[:MOST]
