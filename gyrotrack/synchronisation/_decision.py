"""Starts of the clips on the clock of the casing camera: search, joint solution, ambiguity; and the resulting case.

Each clip is characterised by speed, acceleration and jerk at its middle, from a cubic with harmonics; the record of the
casing is characterised in the same way at every time. A start is possible if the values of clip and record agree within
their uncertainties and the uncertainty of the clock rate r, which scales the three values by r, r^2 and r^3.

Clips of one camera have a common clock rate, and a common direction if the camera was not moved in between. A common
rate is assumed unless it increases chi2 by more than tracking errors can explain. A common direction determines the
start modulo whole turns of the casing. It is assumed if the probability that the directions agree by chance is less
than 0.001.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.stats import chi2 as chi2_distribution

from gyrotrack._correlated_noise import slow_variance
from gyrotrack._errors import SyncError, UsageError
from gyrotrack._smoothing import correlation_factor
from gyrotrack.io._records import (
    BodyTrack,
    Case,
    Floats,
    Placement,
    Recording,
    doubts_of,
    series_of,
    speed_warnings,
)
from gyrotrack.synchronisation._matching import (
    TURN,
    Curve,
    Normal,
    Pair,
    Solution,
    Start,
    block_means,
    casing_around,
    casing_curve,
    harmonics,
    inliers,
    normal,
    solve,
    window,
)

RATE_SIGMA = 1e-3
"""Prior standard deviation of the clock rate [1]. Chosen: a smaller value biases the rate of a camera with a wrong
nominal rate, a larger one leaves a constant speed undetermined."""
ONE_CLOCK = 2e-4
"""Smallest difference of the rates of clips that proves two cameras [1]. Chosen: a crystal changes by 1e-6 in a run,
and slow errors of tracking imitate a difference of about 1e-5; a larger value joins two cameras."""
UNLIKELY = 1e-4
"""Largest p-value of a significant difference of clock rates, for white errors [1]. Chosen: a larger value separates
clips of one camera, a smaller one joins two cameras."""
MAX_LENGTH = 3.0
"""Largest length of the part of a clip that is compared with the record in the search [s]. Chosen: a cubic describes
the motion over this length; a longer part needs a higher degree, a shorter one is noisy."""
GRID = 0.1
"""Largest step of the survey of the casing's record [s]. Chosen: a larger step omits starts, a smaller one costs
time."""
FINE_GRID = 0.005
"""Step of the interpolated search for starts [s]. Chosen: a larger step leaves the range of the refinement, a smaller
one costs time."""
MIN_DISTANCE = 0.3
"""Smallest time between two candidates [s]. Chosen: a smaller value refines one start twice, a larger one omits a
start."""
MAX_CANDIDATES = 5
"""Largest number of starts of a clip that are refined [1]. Chosen: a larger number costs time, a smaller one may omit
the true start."""
THRESHOLD = 100.0
"""Largest excess of chi2 of a candidate [1]. Chosen: a smaller value omits true starts, a larger one costs time."""
MODEL_ERROR = np.array([0.02, 0.02, 0.05])
"""Standard deviations of speed, acceleration and jerk due to the error of the cubic [rad/s, rad/s2, rad/s3]. Chosen:
smaller values reject true starts, larger values accept many wrong starts."""
INTERVALS = (2, 4, 8, 16, 32)
"""Numbers of intervals of the spline that are tried [1]. Chosen: factors of two; a larger number costs time, a smaller
one smooths the motion."""
BIC_BLOCKS = 30
"""Number of blocks of residuals whose means are taken as independent [1]. Chosen: with fewer, the number of intervals
cannot be selected; with more, the means are correlated."""
PARAMETERS = 16
"""Number of parameters besides one parameter per interval [1]. Derived: 5 for the ends of the spline, 8 harmonics,
start, rate and direction."""
ROUNDS = 2
"""Number of passes of the calibration of noise and the rejection of outliers [iterations]. Chosen: a smaller number
keeps outliers, a larger one costs time."""
MAX_MISFIT = 0.015
"""Largest difference between the angles of two cameras, without the part due to noise [rad]. Chosen: a smaller value
refuses oblique cameras, a larger one accepts clips of another run."""
RATE_LIMIT = 5 * RATE_SIGMA
"""Largest deviation of the clock rate of a solution from 1 [1]. Derived: five prior standard deviations."""
RIVAL = 60.0
"""Largest increase of chi2 for which an alternative start is tried in the joint solution [1]. Chosen: above `EXCLUDED`;
a smaller value omits alternative starts, a larger one costs time."""
NEAR = 1e-3
"""Largest difference of starts that count as equal [s]. Chosen: a smaller value lists one start twice, a larger one
joins different starts."""
EXCLUDED = 25.0
"""Increase of chi2 above which an alternative start is excluded [1]. Derived: 5^2, for five standard deviations."""
MAX_START_SIGMA = 1e-3
"""Largest uncertainty of a start that is not ambiguous [s]. Chosen: a smaller value rejects clips of nearly constant
speed, a larger one accepts an uncertain start."""
MAX_CHANCE = 1e-3
"""Largest probability that directions agree by chance [1]. Chosen: a larger value wrongly assumes a common direction, a
smaller one does not use a true common direction."""
AGREE = 4.0
"""Largest difference of two directions, or two rates, that count as equal, in standard deviations [1]. Chosen: a
smaller value separates equal values, a larger one joins different values."""
RESOLVED = TURN / 10
"""Largest uncertainty of a direction that identifies the turn [rad]. Chosen: a tenth of a turn, so that half a turn is
five standard deviations; a larger value counts turns wrongly."""
MAX_COMBINATIONS = 64
"""Largest number of combinations of starts that are compared [1]. Chosen: a larger number costs time, a smaller one may
omit the true combination."""


@dataclass(frozen=True)
class Motion:
    """Speed, acceleration and jerk at one time, (3,) [rad s-1, rad s-2, rad s-3], and their covariance (3, 3)."""

    value: Floats
    covariance: Floats


FEWEST_SAMPLES = 24
"""Smallest number of samples of a cubic with harmonics [samples]. Chosen: three times its 8 parameters; a smaller
number fits noise, a larger one refuses short clips."""


def motion(curve: Curve, moment: float) -> Motion | None:
    """Fit a cubic with harmonics about the time `moment`; None if there are too few samples."""
    s = curve.time - moment
    width = np.ptp(s) / 2 if len(s) else 0.0
    if len(s) < FEWEST_SAMPLES or width <= 0:
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
    """Motion of the casing at times throughout its record, each fitted to an interval of 2 `half` seconds."""

    half: float
    moments: Floats
    motions: tuple[Motion, ...]


def half_length(clip: Curve) -> float:
    """Return half the length of the used part of a clip [s], rounded, so that several clips can use one survey."""
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


@dataclass(frozen=True)
class Prepared:
    """A clip with calibrated uncertainties, and its possible starts, each with chi2, best first."""

    name: str
    pair: Pair
    solutions: tuple[Solution, ...]
    misfit: float
    rejected: int


def prepare(casing: Curve, record: Survey, clip: Curve, name: str) -> Prepared:
    """Find the possible starts of a clip by the survey `record` of the casing; a SyncError if there is none."""
    starts = [_initial_value(casing, clip, offset) for offset in candidates(record, clip)]
    pair = Pair(casing, clip, INTERVALS[-1])
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
        "Check that both films show the same run, and that both capture rates are correct.",
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
    except (np.linalg.LinAlgError, ValueError):  # outside the record, or the casing is at rest
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

    The noise is estimated with the most flexible spline. The number of intervals is twice the number with the smallest
    Bayesian information criterion. This criterion uses means of blocks, which are nearly independent, unlike single
    frames. The factor of two avoids a bias of the start due to a spline that is too stiff.
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
    """Increase the sigmas for slow errors of tracking, which averages do not reduce."""
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
    """Return the rms difference of the cameras without the part due to the noise of single frames [rad]."""
    total = 0.0
    for residual, sigma in ((left.residual_casing, pair.casing.sigma), (left.residual_clip, pair.clip.sigma)):
        means, length = block_means(residual)
        noise = float(np.mean(residual**2)) / length
        total += (float(np.mean(means**2)) - noise) * float(np.median(sigma)) ** 2
    return float(np.sqrt(max(total, 0.0)))


@dataclass(frozen=True)
class Rival:
    """An alternative start of a clip."""

    offset: float  #: Start of the clip [s].
    delta_chi2: float  #: Increase of chi-square [1].
    kind: str  #: `turn` (the casing one turn earlier or later) or `stretch` (another part of the record).


@dataclass(frozen=True)
class Match:
    """Start, rate and direction of one clip with uncertainties and `covariance` (3, 3) of (offset, rate, angle)."""

    name: str
    start: Start
    offset_sigma: float
    rate_sigma: float
    angle_sigma: float
    rivals: tuple[Rival, ...]
    misfit: float
    rejected: int
    common_rate: bool
    common_direction: bool
    covariance: Floats

    @property
    def ambiguous(self) -> bool:
        """Whether another start cannot be excluded, or the uncertainty is too large."""
        return self.offset_sigma > MAX_START_SIGMA or any(r.delta_chi2 < EXCLUDED for r in self.rivals)

    @property
    def method(self) -> str:
        """Description of the method."""
        parts = ["casing angle in both cameras"]
        parts += ["one clock rate for all clips"] if self.common_rate else []
        parts += ["one direction for all clips"] if self.common_direction else []
        return ", ".join(parts)


def match_clips(
    casing: Curve,
    clips: Sequence[Curve],
    names: Sequence[str],
    cameras: Sequence[object],
    progress: Callable[[int, int | None], None] | None = None,
) -> list[Match]:
    """Determine start, rate and direction of every clip; clips with equal entries of `cameras` are from one camera."""
    surveys = {half: survey(casing, half) for half in {half_length(clip) for clip in clips}}
    prepared = []
    for clip, name in zip(clips, names, strict=True):
        prepared.append(prepare(casing, surveys[half_length(clip)], clip, name))
        if progress is not None:
            progress(len(prepared), len(clips))
    found: dict[int, Match] = {}
    for camera in dict.fromkeys(cameras):
        members = [k for k, other in enumerate(cameras) if other == camera]
        together = _match_camera([prepared[k] for k in members])
        found.update(zip(members, together, strict=True))
    return [found[k] for k in range(len(clips))]


def _match_camera(prepared: list[Prepared]) -> list[Match]:
    """Match the clips of one camera.

    The clips have one clock rate. If separate rates fit better, but differ by less than the clocks of two cameras, the
    difference is attributed to tracking. All variances are then multiplied by the increase of chi2 due to the common
    rate, divided by its degrees of freedom (R. T. Birge, Phys. Rev. 40, 207 (1932)).
    """
    pairs = [p.pair for p in prepared]
    common, excess = len(prepared) > 1, 0.0
    fits = [_solve(pairs, combo, common_rate=common) for combo in _combinations(prepared)]
    best = min(fits, key=lambda fit: fit.chi2)
    if common:
        free = _solve(pairs, best.starts, common_rate=False, windows=best.windows)
        excess = (best.chi2 - free.chi2) / (len(prepared) - 1)
        if chi2_distribution.sf(best.chi2 - free.chi2, len(prepared) - 1) < UNLIKELY:
            common = not _are_two_clocks(free)
            if not common:
                fits = [_solve(pairs, combo, common_rate=False) for combo in _combinations(prepared)]
                best = min(fits, key=lambda fit: fit.chi2)
    inflation = excess if common and excess > 1.0 else 1.0
    rivals = [_rivals(fits, best, k) for k in range(len(prepared))]
    turns, locked = _common_direction(pairs, best, common_rate=common)
    matches = []
    for k, p in enumerate(prepared):
        sigma = np.sqrt(inflation) * locked.sigma(k)
        turn_rivals = _next_turns(p.pair, best, locked, k) if turns[k] is not None else []
        matches.append(
            Match(
                name=p.name,
                start=locked.starts[k],
                offset_sigma=float(sigma[0]),
                rate_sigma=float(sigma[1]),
                angle_sigma=float(sigma[2]),
                rivals=tuple(sorted(rivals[k] + turn_rivals, key=lambda rival: rival.delta_chi2)),
                misfit=p.misfit,
                rejected=p.rejected,
                common_rate=common,
                common_direction=turns[k] is not None,
                covariance=inflation * locked.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3],
            )
        )
    return matches


def _solve(
    pairs: Sequence[Pair],
    starts: Sequence[Start],
    *,
    common_rate: bool,
    turns: Sequence[int | None] | None = None,
    windows: Sequence[Start] | None = None,
) -> Solution:
    return solve(pairs, starts, rate_sigma=RATE_SIGMA, common_rate=common_rate, turns=turns, windows=windows)


def _are_two_clocks(free: Solution) -> bool:
    """Return whether the rates of clips differ by more than the drift of one clock plus their uncertainties."""
    rate = np.array([s.eps for s in free.starts])
    sigma = np.array([free.sigma(k)[1] for k in range(len(rate))])
    best = int(np.argmin(sigma))
    return bool((np.abs(rate - rate[best]) > ONE_CLOCK + AGREE * np.hypot(sigma, sigma[best])).any())


def _combinations(prepared: list[Prepared]) -> list[tuple[Start, ...]]:
    """Return the most likely combinations of possible starts."""
    options = [[s for s in p.solutions if s.chi2 < p.solutions[0].chi2 + RIVAL] for p in prepared]
    combos = sorted(product(*options), key=lambda combo: sum(solution.chi2 for solution in combo))
    return [tuple(solution.starts[0] for solution in combo) for combo in combos[:MAX_COMBINATIONS]]


def _rivals(fits: list[Solution], best: Solution, clip: int) -> list[Rival]:
    """Return the distinct alternative starts of a clip with their increase of chi2."""
    near = NEAR + best.sigma(clip)[0] / 10
    others: dict[int, Rival] = {}
    for fit in sorted(fits, key=lambda fit: fit.chi2):
        offset = fit.starts[clip].offset
        if abs(offset - best.starts[clip].offset) > near:
            others.setdefault(round(offset / 0.01), Rival(offset, fit.chi2 - best.chi2, "stretch"))
    return list(others.values())


def _common_direction(
    pairs: Sequence[Pair], best: Solution, *, common_rate: bool
) -> tuple[list[int | None], Solution]:
    """Return the whole turns between the directions of clips (None where unknown), and the solution with these turns.

    The clip with the best known direction is the reference; the other clips are added in order of increasing
    uncertainty.
    """
    count = len(pairs)
    none: list[int | None] = [None] * count
    reference = int(np.argmin([best.sigma(k)[2] for k in range(count)]))
    turns, solution, chance = list(none), best, 1.0
    turns[reference] = 0
    remaining = set(range(count)) - {reference}
    while remaining:
        spread = {k: _difference(solution, k, reference)[1] for k in remaining}
        k = min(remaining, key=spread.__getitem__)
        remaining.discard(k)
        difference, sigma = _difference(solution, k, reference)
        turn = round(difference / TURN)
        if sigma > RESOLVED or abs(difference - TURN * turn) > AGREE * sigma:
            continue
        chance *= min(1.0, 2 * AGREE * sigma / TURN)
        turns[k] = turn
        solution = _solve(pairs, solution.starts, common_rate=common_rate, turns=turns)
    if chance > MAX_CHANCE or not solution.converged:
        return none, best
    return turns, solution


def _difference(solution: Solution, k: int, reference: int) -> tuple[float, float]:
    """Return the difference of the directions of two clips, and its uncertainty [rad]."""
    a, b = 3 * k + 2, 3 * reference + 2
    c = solution.covariance
    variance = c[a, a] + c[b, b] - 2 * c[a, b]
    return solution.starts[k].angle - solution.starts[reference].angle, float(np.sqrt(max(variance, 0.0)))


def _next_turns(pair: Pair, best: Solution, locked: Solution, k: int) -> list[Rival]:
    """Return the starts one turn earlier and later, with their chi2 in the fit without a common direction."""
    middle = locked.starts[k].offset + pair.clip.time.mean()
    window = pair.casing.between(middle - 0.5, middle + 0.5)
    speed = abs(np.polyfit(window.time - middle, window.angle, 1)[0])
    offset, sigma = locked.starts[k].offset, best.sigma(k)[0]
    rivals = []
    for step in (-TURN / speed, TURN / speed):
        distance = (offset + step - best.starts[k].offset) / sigma
        here = (offset - best.starts[k].offset) / sigma
        rivals.append(Rival(float(offset + step), float(distance**2 - here**2), "turn"))
    return rivals


Progress = Callable[[int, int | None], None]


@dataclass(frozen=True)
class Synchronised:
    """A case, and the match of each clip in the order of the input."""

    case: Case
    matches: tuple[Match, ...]


def synchronise(
    casing: Recording,
    rotors: Sequence[Recording],
    names: Sequence[str],
    *,
    I_rotor: float,
    I_casing: float,
    label: str = "",
    surface: str = "",
    progress: Progress | None = None,
) -> Synchronised:
    """Synchronise the rotor clips of one experiment with the casing camera.

    The `names` are used in messages; the first is the name of the casing recording. Moments of inertia are in kg m2.
    `progress` is called with (clips done, clips in total). A SyncError is raised if a clip does not belong to this run,
    is given twice, or does not show both bodies; a UsageError if a moment of inertia is not positive or no clip is
    given.
    """
    if not (I_rotor > 0 and I_casing > 0):
        raise UsageError("A moment of inertia must be positive.", "Give it in kg m2, for example 5.54e-5.")
    if not rotors:
        raise UsageError("There is no rotor clip.", "Give the rotor recordings after the casing recording.")
    _check_distinct_films([casing, *rotors], names)
    rotor_tracks = [_rotor(recording, name) for recording, name in zip(rotors, names[1:], strict=True)]
    curves = [casing_curve(r, name) for r, name in zip([casing, *rotors], names, strict=True)]
    cameras = [(r.capture_fps, r.width, r.height) for r in rotors]
    matches = match_clips(curves[0], curves[1:], names[1:], cameras, progress)
    order = sorted(range(len(rotors)), key=lambda k: matches[k].start.offset)
    ids = {k: f"rotor_{window}" for window, k in enumerate(order)}
    of_casing = replace(series_of([casing.bodies["casing"]]), window=None)
    of_rotor = series_of([_on_clock(rotor_tracks[k], matches[k]) for k in order])
    remedy = (
        "name the bodies in a profile (`gyrotrack profile VIDEO -o P.toml`) and repeat "
        "`gyrotrack extract VIDEO --profile P.toml`"
    )
    still = Placement("casing", 0.0, 0.0, 1.0, 0.0, 0.0, ambiguous=False, method="the reference clock")
    case = Case(
        I_rotor=I_rotor,
        I_casing=I_casing,
        label=label,
        surface=surface,
        casing=of_casing,
        rotor=of_rotor,
        recordings={"casing": casing, **{ids[k]: rotors[k] for k in order}},
        placements={"casing": still, **{ids[k]: _placement(ids[k], matches[k]) for k in order}},
        warnings=(
            *(
                f"{n}: {doubt}"
                for n, r in zip(names, [casing, *rotors], strict=True)
                for doubt in doubts_of(r)
            ),
            *_warnings(matches, rotor_tracks, order),
            *speed_warnings(of_casing, of_rotor, remedy),
        ),
        extra={"sync_covariance": {ids[k]: matches[k].covariance.tolist() for k in order}},
    )
    return Synchronised(case, tuple(matches))


def _check_distinct_films(recordings: Sequence[Recording], names: Sequence[str]) -> None:
    seen: dict[str, str] = {}
    for recording, name in zip(recordings, names, strict=True):
        if recording.source_sha256 and recording.source_sha256 in seen:
            other = seen[recording.source_sha256]
            raise SyncError(f"{name} and {other} come from the same film.", "Give each film once.")
        seen[recording.source_sha256] = name


def _rotor(recording: Recording, name: str) -> BodyTrack:
    body = recording.bodies.get("rotor")
    if body is None or not len(body.time):
        what = f"{name} does not show the rotor."
        raise SyncError(what, "Track the markers of the rotor, or omit the recording.")
    return body


def _on_clock(body: BodyTrack, match: Match) -> BodyTrack:
    """Transform the rotor of a clip to the clock and the direction of the casing camera."""
    rate = 1 + match.start.eps
    return replace(
        body,
        time=match.start.offset + rate * body.time,
        angle=body.angle + match.start.angle % TURN,
        omega=body.omega / rate,
        omega_sigma=body.omega_sigma / rate,
        correlated_time=rate * body.correlated_time,
        correlated_profile=tuple((match.start.offset + rate * t, u) for t, u in body.correlated_profile),
    )


def _placement(name: str, match: Match) -> Placement:
    return Placement(
        id=name,
        clock_offset=float(match.start.offset),
        clock_offset_sigma=float(match.offset_sigma),
        clock_rate=float(1 + match.start.eps),
        clock_rate_sigma=float(match.rate_sigma),
        angle_offset=float(match.start.angle % TURN),
        ambiguous=match.ambiguous,
        method=match.method,
    )


FASTER = 1.02
"""Largest ratio of the speeds of the rotor in a later and an earlier clip without a warning about the starts [1].
Chosen: a smaller value warns of noise, a larger one overlooks exchanged clips."""


def _warnings(matches: Sequence[Match], rotor_tracks: Sequence[BodyTrack], order: Sequence[int]) -> list[str]:
    """Return warnings about uncertain starts and inconsistent clips."""
    found = []
    for match in matches:
        rivals = [rival for rival in match.rivals if rival.delta_chi2 < EXCLUDED]
        if rivals:
            away = {"turn": " (one turn of the casing away)"}
            others = ", ".join(f"{r.offset:.3f} s{away.get(r.kind, '')}" for r in rivals[:3])
            found.append(f"{match.name}: ambiguous start, {match.start.offset:.3f} s or {others}")
        elif match.offset_sigma > MAX_START_SIGMA:
            found.append(
                f"{match.name}: the uncertainty of the start is {1e3 * match.offset_sigma:.1f} ms, "
                "because the speed of the casing changes little in this clip"
            )
    for a, b in pairwise(order):
        first, second = _on_clock(rotor_tracks[a], matches[a]), _on_clock(rotor_tracks[b], matches[b])
        pair = f"{matches[a].name} and {matches[b].name}"
        if second.time[0] < first.time[-1]:
            found.append(f"{pair} overlap in time")
        elif np.nanmedian(second.omega) > FASTER * np.nanmedian(first.omega):
            found.append(f"{pair}: the rotor is faster in the later clip; one of the starts may be wrong")
    return found
