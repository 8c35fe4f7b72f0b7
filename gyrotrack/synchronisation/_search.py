"""Search for possible starts of a clip on the clock of the casing camera.

Each clip is characterised by speed, acceleration and jerk at its middle, from a cubic with harmonics, and so is the
record of the casing around every time. A start is possible if both agree within their uncertainties and that of the
clock rate r, which scales them by r, r^2 and r^3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from gyrotrack._correlated_noise import slow_variance
from gyrotrack._errors import SyncError
from gyrotrack._smoothing import correlation_factor
from gyrotrack.io._records import Floats
from gyrotrack.synchronisation._matching import (
    Curve,
    Normal,
    Pair,
    Solution,
    Start,
    block_means,
    casing_around,
    harmonics,
    inliers,
    normal,
    solve,
    window,
)

RATE_SIGMA = 1e-3  # prior standard deviation of the clock rate
MAX_LENGTH = 3.0  # s
GRID = 0.1  # s
FINE_GRID = 0.005  # s
MIN_DISTANCE = 0.3  # s, between candidates
MAX_CANDIDATES = 5
THRESHOLD = 100.0  # in chi2
MODEL_ERROR = np.array([0.02, 0.02, 0.05])  # of the cubic, in rad s-1, s-2, s-3


@dataclass(frozen=True)
class Motion:
    """Speed, acceleration and jerk at one time, (3,) in rad s-1, s-2, s-3, and their covariance (3, 3)."""

    value: Floats
    covariance: Floats


def motion(curve: Curve, moment: float) -> Motion | None:
    """Fit a cubic with harmonics about the time `moment`; None if there are too few samples."""
    s = curve.time - moment
    width = np.ptp(s) / 2 if len(s) else 0.0
    if len(s) < 24 or width <= 0:
        return None
    u = s / width
    basis = np.column_stack([np.ones_like(u), u, u**2 / 2, u**3 / 6, harmonics(curve.angle)])
    weighted = basis / curve.sigma[:, None]
    prior = np.zeros((4, 8))
    prior[:, 4:] = np.eye(4) / 0.02  # harmonics are poorly determined if the casing hardly turns
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
    """Motion of the casing at times throughout its record, each from 2 `half` seconds."""

    half: float
    moments: Floats
    motions: tuple[Motion, ...]


def half_length(clip: Curve) -> float:
    """Return half the length of the part of a clip that is used [s], rounded, so that clips can use one survey."""
    return min(round(clip.duration / 2, 1), MAX_LENGTH / 2) or clip.duration / 2


def survey(casing: Curve, half: float) -> Survey:
    """Determine the motion of the casing throughout its record."""
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
    """Return possible starts of the clip on the clock of the casing camera [s], best first."""
    middle = (clip.time[0] + clip.time[-1]) / 2
    mine = motion(clip.between(middle - record.half, middle + record.half), middle)
    moments, theirs = record.moments, record.motions
    if mine is None or len(moments) < 4:
        return []
    fine = np.arange(moments[0], moments[-1], FINE_GRID)
    value = CubicSpline(moments, np.array([m.value for m in theirs]))(fine)
    nearest = np.clip(np.searchsorted(moments, fine), 0, len(moments) - 1)
    covariance = np.array([m.covariance for m in theirs])[nearest] + mine.covariance
    covariance = covariance + np.diag(MODEL_ERROR**2)
    by_rate = value * np.array([1.0, 2.0, 3.0])
    covariance = covariance + RATE_SIGMA**2 * by_rate[:, :, None] * by_rate[:, None, :]
    difference = mine.value - value
    distance = np.einsum("ni,ni->n", difference, np.linalg.solve(covariance, difference[:, :, None])[:, :, 0])
    return [float(fine[i] - middle) for i in _minima(distance)]


def _minima(distance: Floats) -> list[int]:
    """Return the local minima below the threshold, lowest first."""
    padded = np.concatenate([[np.inf], distance, [np.inf]])
    low = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] < padded[2:])
    deep = np.flatnonzero(low & (distance < distance.min() + THRESHOLD))
    chosen: list[int] = []
    for i in deep[np.argsort(distance[deep])]:
        if all(abs(i - j) * FINE_GRID > MIN_DISTANCE for j in chosen):
            chosen.append(int(i))
    return chosen[:MAX_CANDIDATES]


INTERVALS = (2, 4, 8, 16, 32)
BIC_BLOCKS = 30
PARAMETERS = 16  # in addition to one per interval: ends of the spline, harmonics, start, rate, direction
ROUNDS = 2
MAX_MISFIT = 0.015  # largest difference of the cameras beyond noise [rad]
RATE_LIMIT = 5 * RATE_SIGMA
RIVAL = 60.0  # largest increase of chi2 of alternative starts for the joint solution
NEAR = 1e-3  # starts within this interval are equal [s]


@dataclass(frozen=True)
class Prepared:
    """A clip with calibrated sigmas, and its possible starts with their chi2, best first."""

    name: str
    pair: Pair
    solutions: tuple[Solution, ...]
    misfit: float
    rejected: int


def prepare(casing: Curve, record: Survey, clip: Curve, name: str) -> Prepared:
    """Find the possible starts of a clip in the record of the casing with the survey `record`; a SyncError if none."""
    starts = [_initial_value(casing, clip, offset) for offset in candidates(record, clip)]
    pair = Pair(casing, clip, INTERVALS[-1])
    starts = [start for start in starts if _is_covered(pair, start)]
    solutions = _distinct(pair, starts, 10 * RATE_LIMIT)
    rejected = 0
    for _ in range(ROUNDS):
        if not solutions:
            raise _mismatch(casing, clip, name, "no part of the record has the same motion")
        pair, dropped = _calibrated(pair, solutions[0].starts[0])
        rejected += dropped
        solutions = _distinct(pair, [solution.starts[0] for solution in solutions])
    if not solutions:
        raise _mismatch(casing, clip, name, "no part of the record has the same motion")
    misfit = _misfit(_residuals(pair, solutions[0].starts[0]), pair)
    if misfit > MAX_MISFIT:
        raise _mismatch(casing, clip, name, f"the best match differs by {1e3 * misfit:.0f} mrad")
    return Prepared(name, pair, tuple(solutions), misfit, rejected)


def _mismatch(casing: Curve, clip: Curve, name: str, why: str) -> SyncError:
    spans = [np.diff(c.angle)[::10] / np.diff(c.time)[::10] for c in (clip, casing)]
    (a, b), (c, d) = (np.percentile(v, [5, 95]) for v in spans)
    return SyncError(
        f"{name} does not belong to this casing recording: {why} "
        f"(casing at {a:.1f} to {b:.1f} rad/s in the clip, {c:.1f} to {d:.1f} rad/s in the record).",
        "Check that both films show the same run, and the capture rates of both cameras.",
    )


def _initial_value(casing: Curve, clip: Curve, offset: float) -> Start:
    middle = (clip.time[0] + clip.time[-1]) / 2
    measured = np.interp(middle, clip.time, clip.angle)
    return Start(offset, 0.0, float(np.interp(offset + middle, casing.time, casing.angle) - measured))


def _distinct(pair: Pair, starts: list[Start], rate_limit: float = RATE_LIMIT) -> list[Solution]:
    """Refine the initial values and return the distinct solutions with small chi2, best first."""
    refined = (_refine(pair, start, rate_limit) for start in starts if _is_covered(pair, start))
    found = sorted((s for s in refined if s is not None), key=lambda solution: solution.chi2)
    distinct: list[Solution] = []
    for solution in found:
        offset = solution.starts[0].offset
        known = (abs(offset - other.starts[0].offset) < NEAR + other.sigma(0)[0] / 10 for other in distinct)
        if not any(known) and solution.chi2 < found[0].chi2 * (1 + RIVAL / len(pair.clip.time)) + RIVAL:
            distinct.append(solution)
    return distinct


def _refine(pair: Pair, start: Start, rate_limit: float) -> Solution | None:
    try:
        solution = solve([pair], [start], rate_sigma=RATE_SIGMA)
    except (np.linalg.LinAlgError, ValueError):  # outside of the record, or the casing is at rest
        return None
    start, known = solution.starts[0], np.isfinite(solution.covariance).all()
    return solution if known and abs(start.eps) < rate_limit and _is_covered(pair, start) else None


def _is_covered(pair: Pair, start: Start) -> bool:
    first, last = start.casing_times(pair.clip.time[[0, -1]])
    record = pair.casing.between(first, last)
    interval = float(np.median(np.diff(pair.casing.time)))
    return bool(len(record.time) > 0.5 * (last - first) / interval)


def _calibrated(pair: Pair, start: Start) -> tuple[Pair, int]:
    """Exclude outliers, calibrate the sigmas of both cameras, and select the number of spline intervals.

    The noise is estimated with the most flexible spline. The number of intervals is twice that with the smallest
    Bayesian information criterion of block means, which unlike single frames are nearly independent; the factor avoids
    a bias of the start by a spline that is too stiff.
    """
    pair, rejected = _with_calibrated_noise(replace(pair, intervals=2 * INTERVALS[-1]), start)

    def criterion(intervals: int) -> float:
        left = _residuals(replace(pair, intervals=intervals), start)
        means = [block_means(r, BIC_BLOCKS)[0] for r in (left.residual_clip, left.residual_casing)]
        misfit = sum(len(m) * np.log(max(float(np.mean(m**2)), 1e-300)) for m in means)
        return float(misfit + intervals * np.log(sum(map(len, means))))

    pair = replace(pair, intervals=2 * min(INTERVALS, key=criterion))
    return _with_slow_noise(pair, start), rejected


def _with_slow_noise(pair: Pair, start: Start) -> Pair:
    """Increase the sigmas to those of slow errors of tracking, which averages do not reduce."""
    left, casing = _residuals(pair, start), casing_around(pair, start)
    record = pair.casing.between(*window(*start.casing_times(pair.clip.time[[0, -1]])))
    moment = start.casing_times(pair.clip.time)
    speed = casing.speed(moment)
    change = np.column_stack([speed, speed * pair.clip.time, np.ones_like(speed), harmonics(pair.clip.angle)])
    rows = np.hstack([casing.design(moment), change]) / pair.clip.sigma[:, None]
    period = pair.clip.duration
    of_casing = slow_variance(record.time, casing.rows, left.residual_casing, period)
    of_clip = slow_variance(pair.clip.time, rows, left.residual_clip, period)
    scaled = pair.casing.scaled(np.sqrt(of_casing)), pair.clip.scaled(np.sqrt(of_clip))
    return replace(pair, casing=scaled[0], clip=scaled[1])


def _with_calibrated_noise(pair: Pair, start: Start) -> tuple[Pair, int]:
    """Return the pair without outliers and with calibrated sigmas, and the number of outliers."""
    left = _residuals(pair, start)
    good_clip, good_seen = inliers(left.residual_clip), inliers(left.residual_casing)
    edges = window(*start.casing_times(pair.clip.time[[0, -1]]))
    first = int(np.searchsorted(pair.casing.time, edges[0]))
    good_casing = np.ones(len(pair.casing.time), dtype=bool)
    good_casing[first : first + len(good_seen)] = good_seen
    residuals = left.residual_casing[good_seen], left.residual_clip[good_clip]
    used = (pair.intervals + PARAMETERS) / sum(map(len, residuals))
    factors = [correlation_factor(residual) for residual in residuals]
    casing, clip = (
        float(np.sqrt(np.mean(residual**2) / max(1 - used, 0.1) * factor))
        for residual, factor in zip(residuals, factors, strict=True)
    )
    kept = pair.casing.keep(good_casing).scaled(casing), pair.clip.keep(good_clip).scaled(clip)
    cleaned = replace(pair, casing=kept[0], clip=kept[1])
    return cleaned, int((~good_clip).sum() + (~good_seen).sum())


def _residuals(pair: Pair, start: Start) -> Normal:
    return normal(pair.clip, start, casing_around(pair, start))


def _misfit(left: Normal, pair: Pair) -> float:
    """Return the rms difference of the cameras beyond the noise of single frames [rad]."""
    total = 0.0
    for residual, sigma in ((left.residual_casing, pair.casing.sigma), (left.residual_clip, pair.clip.sigma)):
        means, length = block_means(residual)
        noise = float(np.mean(residual**2)) / length
        total += (float(np.mean(means**2)) - noise) * float(np.median(sigma)) ** 2
    return float(np.sqrt(max(total, 0.0)))
