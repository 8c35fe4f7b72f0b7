"""One clip on its own: where it may start, how noisy both cameras are, and whether it belongs here at all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrotrack.angles.scatter import correlation_factor
from gyrotrack.errors import SyncError
from gyrotrack.sync.curves import Curve
from gyrotrack.sync.matching import Normal, Pair, Solution, normal, solve, surroundings
from gyrotrack.sync.noise import BLOCKS, block_excess, block_means, inliers
from gyrotrack.sync.search import RATE_SIGMA, Survey, candidates
from gyrotrack.sync.start import Start
from gyrotrack.sync.stretch import window

INTERVALS = (2, 4, 8, 16, 32)
PARAMETERS = 16  # beside the intervals: ends of the spline, harmonics, start, rate, direction
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

    The noise is seen best under the most pliant spline. How pliant it need be, says the Bayesian information
    criterion for the number of independent samples, and twice that is taken: a curve a little too stiff would
    bias the start within its error. What is then left in averages over blocks raises sigma again.
    """
    pair, rejected, independent = _with_true_noise(replace(pair, intervals=2 * INTERVALS[-1]), start)

    def criterion(intervals: int) -> float:
        left = _residuals(replace(pair, intervals=intervals), start)
        chi2 = np.sum(left.residual_clip**2) + np.sum(left.residual_casing**2)
        return float(chi2 + intervals * np.log(independent))

    pair = replace(pair, intervals=2 * min(INTERVALS, key=criterion))
    left = _residuals(pair, start)
    free = max(1 - (pair.intervals + PARAMETERS) / (2 * BLOCKS), 0.3)
    casing, clip = (np.sqrt(block_excess(r, free)) for r in (left.residual_casing, left.residual_clip))
    return replace(pair, casing=pair.casing.scaled(casing), clip=pair.clip.scaled(clip)), rejected


def _with_true_noise(pair: Pair, start: Start) -> tuple[Pair, int, float]:
    """Return the pair without outliers, with true sigmas, and the number of independent samples."""
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
    independent = sum(len(residual) / factor for residual, factor in zip(residuals, factors, strict=True))
    cleaned = replace(
        pair,
        casing=pair.casing.keep(good_casing).scaled(casing),
        clip=pair.clip.keep(good_clip).scaled(clip),
    )
    return cleaned, int((~good_clip).sum() + (~good_seen).sum()), independent


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
