"""One clip on its own: where it may start, how noisy both cameras are, and whether it belongs here at all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.records import Floats
from gyrotrack.errors import SyncError
from gyrotrack.sync.curves import Curve
from gyrotrack.sync.matching import Normal, Pair, Solution, Start, normal, solve
from gyrotrack.sync.search import RATE_SIGMA, candidates

INTERVALS = (2, 4, 8, 16, 32)
FIRST_INTERVALS = 8
OUTLIER = 6.0
BLOCKS = 60
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


def prepare(casing: Curve, clip: Curve, name: str) -> Prepared:
    """Find where a clip may start on the casing's clock.

    Raises
    ------
    SyncError
        No stretch of the casing's record moves like the clip.
    """
    guesses = [_guess(casing, clip, offset) for offset in candidates(casing, clip)]
    pair = Pair(casing, clip, FIRST_INTERVALS)
    solutions = _distinct(pair, guesses)
    if not solutions:
        raise _foreign(casing, clip, name, "no stretch of the record turns like it")
    rejected = 0
    for _ in range(2):
        best = solutions[0].starts[0]
        pair = replace(pair, intervals=_intervals(pair, best))
        pair, dropped = _with_true_noise(pair, best)
        rejected += dropped
        solutions = _distinct(pair, [s.starts[0] for s in solutions])
        if not solutions:
            raise _foreign(casing, clip, name, "no stretch of the record turns like it")
    misfit = _misfit(normal(pair, solutions[0].starts[0]), pair)
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


def _distinct(pair: Pair, guesses: list[Start]) -> list[Solution]:
    """Refine each guess and return the different solutions worth keeping, the best first."""
    found: list[Solution] = []
    for guess in guesses:
        if not _overlaps(pair, guess):
            continue
        solution = _refine(pair, guess)
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


def _refine(pair: Pair, guess: Start) -> Solution | None:
    try:
        solution = solve([pair], [guess], rate_sigma=RATE_SIGMA)
    except (np.linalg.LinAlgError, ValueError):  # the search left the record, or the casing stands still
        return None
    start = solution.starts[0]
    sound = abs(start.eps) < RATE_LIMIT and np.isfinite(solution.covariance).all() and _overlaps(pair, start)
    return solution if sound else None


def _overlaps(pair: Pair, start: Start) -> bool:
    first, last = (start.offset + (1 + start.eps) * pair.clip.time[k] for k in (0, -1))
    seen = pair.casing.between(first, last)
    interval = float(np.median(np.diff(pair.casing.time)))
    return bool(len(seen.time) > 0.5 * (last - first) / interval)


def _intervals(pair: Pair, start: Start) -> int:
    """Choose the spline's intervals: twice as many as the Bayesian information criterion wants.

    The criterion tolerates a curve that is a little too stiff, which would bias the start within its error.
    """

    def criterion(intervals: int) -> float:
        left = normal(replace(pair, intervals=intervals), start)
        size = len(left.residual_clip) + len(left.residual_casing)
        return float(size * np.log(left.chi2 / size) + intervals * np.log(size))

    longest = [n for n in INTERVALS if n * 8 < len(pair.clip.time)]
    return 2 * min(longest, key=criterion)


def _with_true_noise(pair: Pair, start: Start) -> tuple[Pair, int]:
    """Drop outliers and scale both cameras' sigma to what the residuals show."""
    left = normal(pair, start)
    moment = start.offset + (1 + start.eps) * pair.clip.time
    first = int(np.searchsorted(pair.casing.time, _reach(moment)[0]))
    good_clip, good_seen = _inliers(left.residual_clip), _inliers(left.residual_casing)
    good_casing = np.ones(len(pair.casing.time), dtype=bool)
    good_casing[first : first + len(good_seen)] = good_seen
    parameters = pair.intervals + 16
    used = parameters / (good_clip.sum() + good_seen.sum())
    factors = [
        _noise_factor(residual[good], used)
        for residual, good in ((left.residual_casing, good_seen), (left.residual_clip, good_clip))
    ]
    scaled = replace(
        pair,
        casing=pair.casing.keep(good_casing).scaled(factors[0]),
        clip=pair.clip.keep(good_clip).scaled(factors[1]),
    )
    return scaled, int((~good_clip).sum() + (~good_seen).sum())


def _reach(moment: Floats) -> tuple[float, float]:
    from gyrotrack.sync.matching import MARGIN

    middle, width = (moment[0] + moment[-1]) / 2, (moment[-1] - moment[0]) / 2
    return middle - (1 + MARGIN) * width, middle + (1 + MARGIN) * width


def _inliers(residual: Floats) -> npt.NDArray[np.bool_]:
    spread = 1.4826 * float(np.median(np.abs(residual)))
    return np.asarray(np.abs(residual) < OUTLIER * max(spread, 1e-300))


def _noise_factor(residual: Floats, used: float) -> float:
    """Return by how much sigma must grow: the spread, and the correlation from sample to sample.

    What matters for slow quantities is the noise of averages over blocks; it is taken only when it stands out
    from that of independent samples by more than 3.5 sigma.
    """
    variance = float(np.mean(residual**2)) / max(1 - used, 0.1)
    excess, blocks = _block_excess(residual)
    free = max(1 - used * len(residual) / blocks, 0.2)
    stands_out = excess / free > 1 + 3.5 * np.sqrt(2 / blocks)
    return float(np.sqrt(variance * (excess / free if stands_out else 1.0)))


def _block_excess(residual: Floats) -> tuple[float, int]:
    """Return the variance of block means, relative to independent samples, and the number of blocks."""
    length = max(len(residual) // BLOCKS, 2)
    blocks = len(residual) // length
    means = residual[: blocks * length].reshape(blocks, length).mean(axis=1)
    return float(length * np.mean(means**2) / max(np.mean(residual**2), 1e-300)), blocks


def _misfit(left: Normal, pair: Pair) -> float:
    """Return by how much the cameras disagree beyond the noise of single frames [rad]."""
    total = 0.0
    for residual, sigma in ((left.residual_casing, pair.casing.sigma), (left.residual_clip, pair.clip.sigma)):
        length = max(len(residual) // BLOCKS, 2)
        blocks = len(residual) // length
        means = residual[: blocks * length].reshape(blocks, length).mean(axis=1)
        total += (float(np.mean(means**2)) - 1 / length) * float(np.median(sigma)) ** 2
    return float(np.sqrt(max(total, 0.0)))
