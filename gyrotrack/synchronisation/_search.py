"""Possible starts of a clip on the clock of the casing.

Each clip is summed up by the speed, acceleration and jerk in its middle, from a cubic with harmonics; so is
the casing's record around every moment. A stretch fits if the two triples agree within their errors and the
freedom of the clock rate, which multiplies them by r, r^2 and r^3.
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
    harmonics,
    inliers,
    normal,
    solve,
    surroundings,
    window,
)

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


INTERVALS = (2, 4, 8, 16, 32)
BIC_BLOCKS = 30
PARAMETERS = 16  # in addition to the intervals: ends of the spline, harmonics, start, rate, direction
ROUNDS = 2
MISFIT = 0.015  # rad; two cameras that see the same motion agree better than this
RATE_LIMIT = 5 * RATE_SIGMA
RIVAL = 60.0  # chi2 above the best up to which another start is kept for the joint fit
NEAR = 1e-3  # s; starts closer than this are one


@dataclass(frozen=True)
class Prepared:
    """A clip with true sigmas, and its possible starts with their chi2, the best first."""

    name: str
    pair: Pair
    solutions: tuple[Solution, ...]
    misfit: float
    rejected: int


def prepare(casing: Curve, record: Survey, clip: Curve, name: str) -> Prepared:
    """Find where a clip may start on the casing's clock; `record` is the casing's survey.

    Raises
    ------
    SyncError
        No stretch of the casing's record moves like the clip.
    """
    guesses = [_guess(casing, clip, offset) for offset in candidates(record, clip)]
    pair = Pair(casing, clip, INTERVALS[-1])
    guesses = [guess for guess in guesses if _overlaps(pair, guess)]
    solutions = _distinct(pair, guesses, 10 * RATE_LIMIT)
    rejected = 0
    for _ in range(ROUNDS):
        if not solutions:
            raise _foreign(casing, clip, name, "no stretch of the record turns like it")
        pair, dropped = _tuned(pair, solutions[0].starts[0])
        rejected += dropped
        solutions = _distinct(pair, [solution.starts[0] for solution in solutions])
    if not solutions:
        raise _foreign(casing, clip, name, "no stretch of the record turns like it")
    misfit = _misfit(_residuals(pair, solutions[0].starts[0]), pair)
    if misfit > MISFIT:
        raise _foreign(casing, clip, name, f"the best stretch differs by {1e3 * misfit:.0f} mrad")
    return Prepared(name, pair, tuple(solutions), misfit, rejected)


def _foreign(casing: Curve, clip: Curve, name: str, why: str) -> SyncError:
    spans = [np.diff(c.angle)[::10] / np.diff(c.time)[::10] for c in (clip, casing)]
    (a, b), (c, d) = (np.percentile(v, [5, 95]) for v in spans)
    return SyncError(
        f"{name} does not belong to this casing recording: {why} "
        f"(casing at {a:.1f} to {b:.1f} rad/s in the clip, {c:.1f} to {d:.1f} rad/s in the record).",
        "Check that both films show the same run, and the capture rates of both cameras.",
    )


def _guess(casing: Curve, clip: Curve, offset: float) -> Start:
    middle = (clip.time[0] + clip.time[-1]) / 2
    seen = np.interp(middle, clip.time, clip.angle)
    return Start(offset, 0.0, float(np.interp(offset + middle, casing.time, casing.angle) - seen))


def _distinct(pair: Pair, guesses: list[Start], rate_limit: float = RATE_LIMIT) -> list[Solution]:
    """Refine each guess and return the different solutions worth keeping, the best first."""
    found: list[Solution] = []
    for guess in guesses:
        if not _overlaps(pair, guess):
            continue
        solution = _refine(pair, guess, rate_limit)
        if solution is not None:
            found.append(solution)
    found.sort(key=lambda solution: solution.chi2)
    distinct: list[Solution] = []
    for solution in found:
        offset = solution.starts[0].offset
        known = (abs(offset - other.starts[0].offset) < NEAR + other.sigma(0)[0] / 10 for other in distinct)
        if not any(known) and solution.chi2 < found[0].chi2 * (1 + RIVAL / len(pair.clip.time)) + RIVAL:
            distinct.append(solution)
    return distinct


def _refine(pair: Pair, guess: Start, rate_limit: float) -> Solution | None:
    try:
        solution = solve([pair], [guess], rate_sigma=RATE_SIGMA)
    except (np.linalg.LinAlgError, ValueError):  # the search left the record, or the casing stands still
        return None
    start = solution.starts[0]
    sound = abs(start.eps) < rate_limit and np.isfinite(solution.covariance).all() and _overlaps(pair, start)
    return solution if sound else None


def _overlaps(pair: Pair, start: Start) -> bool:
    first, last = start.moments(pair.clip.time[[0, -1]])
    seen = pair.casing.between(first, last)
    interval = float(np.median(np.diff(pair.casing.time)))
    return bool(len(seen.time) > 0.5 * (last - first) / interval)


def _tuned(pair: Pair, start: Start) -> tuple[Pair, int]:
    """Drop outliers, give both cameras their true sigma, and choose the spline's intervals.

    The noise is estimated with the most flexible spline; how flexible it must be is decided by the Bayesian information
    criterion for block means, which are nearly independent where neighbouring frames are not (slow errors of tracking
    would make the spline follow them), and twice that is taken: a curve a little too stiff would bias the start within
    its error.
    """
    pair, rejected = _with_true_noise(replace(pair, intervals=2 * INTERVALS[-1]), start)

    def criterion(intervals: int) -> float:
        left = _residuals(replace(pair, intervals=intervals), start)
        means = [block_means(r, BIC_BLOCKS)[0] for r in (left.residual_clip, left.residual_casing)]
        misfit = sum(len(m) * np.log(max(float(np.mean(m**2)), 1e-300)) for m in means)
        return float(misfit + intervals * np.log(sum(map(len, means))))

    pair = replace(pair, intervals=2 * min(INTERVALS, key=criterion))
    return _with_slow_noise(pair, start), rejected


def _with_slow_noise(pair: Pair, start: Start) -> Pair:
    """Return the pair with sigmas that hold for averages over long times, in which slow errors of tracking remain."""
    left, casing = _residuals(pair, start), surroundings(pair, start)
    seen = pair.casing.between(*window(*start.moments(pair.clip.time[[0, -1]])))
    moment = start.moments(pair.clip.time)
    speed = casing.speed(moment)
    change = np.column_stack([speed, speed * pair.clip.time, np.ones_like(speed), harmonics(pair.clip.angle)])
    rows = np.hstack([casing.design(moment), change]) / pair.clip.sigma[:, None]
    return replace(
        pair,
        casing=pair.casing.scaled(
            np.sqrt(slow_variance(seen.time, casing.rows, left.residual_casing, pair.clip.duration))
        ),
        clip=pair.clip.scaled(
            np.sqrt(slow_variance(pair.clip.time, rows, left.residual_clip, pair.clip.duration))
        ),
    )


def _with_true_noise(pair: Pair, start: Start) -> tuple[Pair, int]:
    """Return the pair without outliers and with true sigmas, and how many outliers there were."""
    left = _residuals(pair, start)
    good_clip, good_seen = inliers(left.residual_clip), inliers(left.residual_casing)
    edges = window(*start.moments(pair.clip.time[[0, -1]]))
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
    cleaned = replace(
        pair,
        casing=pair.casing.keep(good_casing).scaled(casing),
        clip=pair.clip.keep(good_clip).scaled(clip),
    )
    return cleaned, int((~good_clip).sum() + (~good_seen).sum())


def _residuals(pair: Pair, start: Start) -> Normal:
    return normal(pair.clip, start, surroundings(pair, start))


def _misfit(left: Normal, pair: Pair) -> float:
    """Return by how much the cameras disagree beyond the noise of single frames [rad]."""
    total = 0.0
    for residual, sigma in ((left.residual_casing, pair.casing.sigma), (left.residual_clip, pair.clip.sigma)):
        means, length = block_means(residual)
        noise = float(np.mean(residual**2)) / length
        total += (float(np.mean(means**2)) - noise) * float(np.median(sigma)) ** 2
    return float(np.sqrt(max(total, 0.0)))
