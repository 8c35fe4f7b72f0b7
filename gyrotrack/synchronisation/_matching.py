"""Least squares for start, clock rate and direction of clips.

Within a window about the clip, the angle of the casing is a quintic spline psi(t). The casing camera measures

    psi_A(t) = psi(t) + H_A,   H: first and second harmonics of the angle,

and the rotor camera, with its own clock, direction and harmonics,

    psi_B(s) + offset = psi(t0 + (1 + eps) s) + H_B.

The model is linear in the coefficients of spline and harmonics. After their elimination, the normal matrix of each clip
is 3 x 3, for (t0, eps, offset). All clips of one camera are solved jointly by Gauss-Newton steps, with a common rate
and optionally a common offset. chi2 contains only the residuals of the clips; the data of the casing camera are given.

The window is fixed while the start of the clip changes: in a moving window the set of samples would change, and chi2
would be discontinuous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.linalg import block_diag, cho_factor, cho_solve

from gyrotrack._errors import SyncError
from gyrotrack._smoothing import median_smooth
from gyrotrack.io._records import Floats, Recording

TURN = 2 * np.pi
"""A full turn [rad]. Derived: 2 pi."""


@dataclass(frozen=True)
class Start:
    """Start, clock rate and direction of a clip: t_A = offset + (1 + eps) t_B, psi_A = psi_B + angle."""

    offset: float
    eps: float
    angle: float

    def casing_times(self, time: Floats) -> Floats:
        """Convert times of the clip to the clock of the casing camera [s]."""
        return self.offset + (1 + self.eps) * time


def with_common_direction(starts: Sequence[Start], turns: Sequence[int | None]) -> list[Start]:
    """Give clips with a number of turns a common direction, plus this number of turns."""
    common = next(s.angle - TURN * m for s, m in zip(starts, turns, strict=True) if m is not None)
    return [
        s if m is None else replace(s, angle=common + TURN * m) for s, m in zip(starts, turns, strict=True)
    ]


def moved(point: Sequence[Start], step: Floats) -> list[Start]:
    """Return the starts of clips after a step of (offset, eps, angle) of all clips, (3 k,)."""
    return [
        Start(s.offset + step[3 * k], s.eps + step[3 * k + 1], s.angle + step[3 * k + 2])
        for k, s in enumerate(point)
    ]


OUTLIER = 6.0
"""Smallest residual of an outlier, in robust standard deviations [1]. Chosen: a smaller value rejects good samples, a
larger one keeps slips."""
BLOCKS = 60
"""Number of blocks of a residual [1]. Chosen: a smaller number hides correlation, a larger one leaves few samples in
each block."""


def inliers(residual: Floats) -> npt.NDArray[np.bool_]:
    """Return a mask of the residuals within six robust standard deviations."""
    spread = 1.4826 * float(np.median(np.abs(residual)))
    return np.asarray(np.abs(residual) < OUTLIER * max(spread, 1e-300))


def block_means(residual: Floats, blocks: int = BLOCKS) -> tuple[Floats, int]:
    """Return the means of about `blocks` blocks of a residual, and the length of a block [samples]."""
    length = max(len(residual) // blocks, 2)
    count = len(residual) // length
    return residual[: count * length].reshape(count, length).mean(axis=1), length


MIN_FRAMES = 60
"""Smallest number of frames of a clip with the casing [frames]. Chosen: a smaller number does not determine a start, a
larger one refuses short clips."""
NEIGHBOURS = 15
"""Number of samples of a running median [samples]. Chosen: a smaller number follows runs of outliers, a larger one
smooths the motion."""
MIN_DURATION = 0.2
"""Smallest duration of a clip [s]. Chosen: a shorter clip does not determine speed and acceleration, a longer one
refuses short clips."""


@dataclass(frozen=True)
class Curve:
    """The casing in one recording: time on its clock [s], unwrapped angle [rad], sigma [rad]."""

    time: Floats
    angle: Floats
    sigma: Floats

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    def between(self, start: float, stop: float) -> Curve:
        """Return the samples with start <= time <= stop."""
        chosen = slice(int(np.searchsorted(self.time, start)), int(np.searchsorted(self.time, stop, "right")))
        return Curve(self.time[chosen], self.angle[chosen], self.sigma[chosen])

    def keep(self, good: npt.NDArray[np.bool_]) -> Curve:
        """Return the selected samples."""
        return Curve(self.time[good], self.angle[good], self.sigma[good])

    def scaled(self, factor: float) -> Curve:
        """Return the curve with its sigma multiplied by a factor."""
        return replace(self, sigma=self.sigma * factor)


def casing_curve(recording: Recording, name: str) -> Curve:
    """Return the angle of the casing in a recording; a SyncError is raised if too few frames show the casing."""
    body = recording.bodies.get("casing")
    if body is None:
        what = f"{name} does not show the casing."
        raise SyncError(what, "Clips are synchronised by the casing: track its marker in every clip.")
    valid = np.isfinite(body.angle) & np.isfinite(body.time) & (body.sigma > 0)
    curve = Curve(body.time[valid], body.angle[valid], body.sigma[valid])
    if len(curve.time) < MIN_FRAMES or curve.duration < MIN_DURATION:
        what = f"{name} shows the casing in only {len(curve.time)} frames."
        raise SyncError(what, f"At least {MIN_FRAMES} frames over {MIN_DURATION} s are needed.")
    return without_outliers(curve)


def without_outliers(curve: Curve) -> Curve:
    """Return the curve without samples that deviate from its running median by over six robust standard deviations."""
    step = np.diff(curve.time)
    speed = median_smooth(np.diff(curve.angle) / step, NEIGHBOURS)
    slow = curve.angle - np.concatenate([[0.0], np.cumsum(speed * step)])
    deviation = np.abs(slow - median_smooth(slow, NEIGHBOURS))
    spread = 1.4826 * float(np.median(deviation))
    return curve.keep(deviation <= OUTLIER * spread) if spread > 0 else curve


def harmonics(angle: Floats) -> Floats:
    """Return sine and cosine of the orders 1 and 2 of an angle (n, 4): the errors due to a centre offset and a tilt."""
    return np.column_stack([np.sin(angle), np.cos(angle), np.sin(2 * angle), np.cos(2 * angle)])


DEGREE = 5
"""Degree of the spline of the angle [1]. Derived: its second derivative, the torque, has continuous second
derivatives."""
MARGIN = 2.0
"""Margin of the window on both sides of a clip [half lengths]. Chosen: a smaller value stops the search at the end of
the window, a larger one needs more intervals."""
HARMONIC_SIGMA = 0.02
"""Prior standard deviation of the harmonics [rad]. Chosen: a smaller value keeps errors of an oblique view in the
residuals; with a larger one, harmonics replace motion."""
SPLINE_SIGMA = 1.0
"""Prior standard deviation of the difference between spline and quartic [rad]. Chosen: a smaller value stiffens the
motion, a larger one leaves gaps of the record undetermined."""
HARMONICS = 4
"""Number of harmonics of a camera [1]. Derived: cosine and sine of orders 1 and 2."""


@dataclass(frozen=True)
class CasingFit:
    """Fit of spline and harmonics to the casing in a window."""

    knots: Floats  # knots of the quintic spline over the window
    reference: np.polynomial.Polynomial  # a quartic in time, to which the spline is added
    best: Floats  # shape (n + 4,); coefficients of spline and harmonics
    information: Floats  # shape (n + 4, n + 4); inverse covariance of `best`
    # design matrix and residuals of the samples, in units of sigma
    rows: Floats
    residual: Floats

    def design(self, time: Floats) -> Floats:
        """Return the values of the spline basis, shape (len(time), n); a LinAlgError for a time outside the window."""
        if time[0] < self.knots[0] or time[-1] > self.knots[-1]:
            raise np.linalg.LinAlgError("the clip is outside of the window")
        matrix: Floats = BSpline.design_matrix(time, self.knots, DEGREE).toarray()
        return matrix

    def speed(self, time: Floats) -> Floats:
        """Return the speed of the casing [rad s-1]."""
        spline = BSpline(self.knots, self.best[:-HARMONICS], DEGREE)
        return np.asarray(self.reference.deriv()(time) + spline.derivative()(time))


def window(first: float, last: float) -> tuple[float, float]:
    """Return the window about a clip from `first` to `last` on the clock of the casing camera [s]."""
    middle, reach = (first + last) / 2, (1 + MARGIN) * (last - first) / 2
    return middle - reach, middle + reach


def fit_casing(casing: Curve, edges: tuple[float, float], intervals: int) -> CasingFit:
    """Fit spline and harmonics to the casing in a window; a LinAlgError is raised for too few samples."""
    record = casing.between(*edges)
    if len(record.time) < 2 * DEGREE:
        raise np.linalg.LinAlgError("too few samples of the casing")
    knots = np.linspace(edges[0], edges[1], intervals + 1)
    knots = np.concatenate([np.repeat(knots[0], DEGREE), knots, np.repeat(knots[-1], DEGREE)])
    reference = np.polynomial.Polynomial.fit(record.time, record.angle, 4)
    spline = BSpline.design_matrix(record.time, knots, DEGREE).toarray()
    rows = np.hstack([spline, harmonics(record.angle)]) / record.sigma[:, None]
    left = (record.angle - reference(record.time)) / record.sigma
    size = spline.shape[1]
    information = rows.T @ rows + np.diag(
        np.repeat([SPLINE_SIGMA**-2, HARMONIC_SIGMA**-2], [size, HARMONICS])
    )
    best: Floats = cho_solve(cho_factor(information), rows.T @ left)
    return CasingFit(knots, reference, best, information, rows, left - rows @ best)


def link_matrix(*, common_rate: bool, shared_angle: Sequence[bool]) -> Floats:
    """Return the matrix that maps the free parameters to (offset, eps, angle) of every clip."""
    clips = len(shared_angle)
    columns = []
    for k, shared in ((0, [False] * clips), (1, [common_rate] * clips), (2, list(shared_angle))):
        each = np.zeros((3 * clips, clips))
        each[3 * np.arange(clips) + k, np.arange(clips)] = 1
        together = np.asarray(shared)
        columns.append(each[:, ~together])
        if together.any():
            columns.append(each[:, together].sum(axis=1, keepdims=True))
    return np.hstack(columns)


START_SIGMA = 5.0
"""Prior standard deviation of a start about its window [s]. Chosen: this prior regularises the fit at constant speed; a
smaller value biases the start, a larger one makes the matrix singular."""
MAX_STEP = 0.3
"""Largest step of a start [s]. Chosen: a larger step leaves the range of the linear model, a smaller one costs time."""
MAX_ROUNDS = 40
"""Largest number of Gauss-Newton steps [iterations]. Chosen: a smaller number stops early, a larger one costs time."""
MAX_REDUCTIONS = 6
"""Largest number of halvings of a step that does not reduce chi2 [1]. Chosen: a smaller number ends the search early, a
larger one costs time."""
TOLERANCE = 1e-3
"""Expected decrease of chi2 at convergence [1]. Chosen: 0.03 standard deviations; a larger value stops early, a smaller
one costs time."""


@dataclass(frozen=True)
class Pair:
    """The record of the casing, one clip, and the number of spline intervals in its window."""

    casing: Curve
    clip: Curve
    intervals: int


@dataclass(frozen=True)
class _Part:
    """One clip, the fit of the casing in the window of this clip, and the start at which the window is centred."""

    clip: Curve
    casing: CasingFit
    centre: Start


@dataclass(frozen=True)
class Normal:
    """Quadratic approximation of chi2 at a step d from a `Start`, chi2 - 2 gradient . d + d . matrix . d; residuals."""

    matrix: Floats
    gradient: Floats
    chi2: float
    residual_casing: Floats
    residual_clip: Floats


@dataclass(frozen=True)
class Solution:
    """Joint solution for the starts of several clips."""

    starts: tuple[Start, ...]  # start of each clip
    covariance: Floats  # shape (3 k, 3 k); covariance of (offset, eps, angle) of all clips
    chi2: float  # minimum of chi2 of the clips, including the priors
    converged: bool  # whether the iteration has converged
    # the starts at which the windows are centred; chi2 of solutions with equal windows can be compared
    windows: tuple[Start, ...]

    def sigma(self, clip: int) -> Floats:
        """Return the uncertainties of offset, eps and angle of one clip."""
        variance = np.diag(self.covariance)[3 * clip : 3 * clip + 3]
        return np.sqrt(np.where(variance > 0, variance, np.inf))


def casing_around(pair: Pair, start: Start) -> CasingFit:
    """Fit the casing in the window about a clip."""
    first, last = start.casing_times(pair.clip.time[[0, -1]])
    return fit_casing(pair.casing, window(first, last), pair.intervals)


def normal(clip: Curve, start: Start, casing: CasingFit) -> Normal:
    """Return the normal equations of one clip at `start`, after elimination of spline and harmonics.

    A LinAlgError is raised if the clip is not within the window of `casing`.
    """
    moment = start.casing_times(clip.time)
    design = casing.design(moment)
    size = design.shape[1]
    angle = design @ casing.best[:size] + casing.reference(moment)
    left = (clip.angle + start.angle - angle) / clip.sigma
    speed = casing.speed(moment)
    change = np.column_stack([speed, speed * clip.time, -np.ones_like(speed)]) / clip.sigma[:, None]
    unseen = np.zeros((len(moment), HARMONICS))
    rows = np.hstack([design, unseen, harmonics(clip.angle)]) / clip.sigma[:, None]
    square = rows.T @ rows + block_diag(casing.information, np.eye(HARMONICS) / HARMONIC_SIGMA**2)
    right, cross = rows.T @ left, rows.T @ change
    factor = cho_factor(square)
    best = cho_solve(factor, right)
    return Normal(
        matrix=change.T @ change - cross.T @ cho_solve(factor, cross),
        gradient=change.T @ left - cross.T @ best,
        chi2=float(left @ left - right @ best),
        residual_casing=casing.residual - casing.rows @ best[: size + HARMONICS],
        residual_clip=left - rows @ best,
    )


def solve(
    pairs: Sequence[Pair],
    starts: Sequence[Start],
    *,
    rate_sigma: float,
    common_rate: bool = True,
    turns: Sequence[int | None] | None = None,
    windows: Sequence[Start] | None = None,
) -> Solution:
    """Solve for the starts of several clips, from initial values.

    `rate_sigma` is the prior standard deviation of the clock rate about 1; with `common_rate` all clips have the same
    rate. Clips with a number in `turns` have a common direction, except for this number of turns; clips with None have
    individual directions. `windows` are the starts at which the windows are centred, by default `starts`. A
    LinAlgError is raised if a clip is not within its window, or if a parameter is not determined.
    """
    shared = [turn is not None for turn in turns or [None] * len(pairs)]
    link = link_matrix(common_rate=common_rate, shared_angle=shared)
    point = with_common_direction(starts, turns) if turns is not None else list(starts)
    if common_rate:
        point = [replace(start, eps=point[0].eps) for start in point]
    windows = tuple(windows or starts)
    parts = [_Part(p.clip, casing_around(p, w), w) for p, w in zip(pairs, windows, strict=True)]
    here = _combined(parts, point, rate_sigma, link)
    converged = False
    for _ in range(MAX_ROUNDS):
        covariance = np.linalg.inv(here.matrix)
        step = covariance @ here.gradient
        converged = bool(step @ here.gradient < TOLERANCE)
        found = None if converged else _line_search(parts, point, link @ step, here.chi2, rate_sigma, link)
        if found is None:
            break
        point, here = found
    return Solution(tuple(point), link @ covariance @ link.T, here.chi2, converged, windows)


@dataclass(frozen=True)
class _Combined:
    """The normal equations of several clips for their free parameters."""

    matrix: Floats
    gradient: Floats
    chi2: float


def _line_search(
    parts: Sequence[_Part], point: list[Start], step: Floats, chi2: float, rate_sigma: float, link: Floats
) -> tuple[list[Start], _Combined] | None:
    """Reduce a step until chi2 decreases; None if chi2 does not decrease."""
    length = min(1.0, MAX_STEP / max(float(np.max(np.abs(step[::3]))), 1e-300))
    for _ in range(MAX_REDUCTIONS):
        there = moved(point, length * step)
        try:
            stacked = _combined(parts, there, rate_sigma, link)
        except np.linalg.LinAlgError:  # the step leaves the window
            stacked = None
        if stacked is not None and stacked.chi2 < chi2:
            return there, stacked
        length /= 3
    return None


def _combined(parts: Sequence[_Part], point: Sequence[Start], rate_sigma: float, link: Floats) -> _Combined:
    """Combine the normal equations of all clips for the free parameters, with priors of rates and starts."""
    size = 3 * len(parts)
    matrix, gradient, chi2 = np.zeros((size, size)), np.zeros(size), 0.0
    rates = np.flatnonzero(link[1::3].any(axis=0))
    for k, (one, start) in enumerate(zip(parts, point, strict=True)):
        part = normal(one.clip, start, one.casing)
        block = slice(3 * k, 3 * k + 3)
        matrix[block, block], gradient[block] = part.matrix, part.gradient
        chi2 += part.chi2
        share = len(rates) / len(parts) / rate_sigma**2  # a common rate has one prior, not one per clip
        matrix[3 * k + 1, 3 * k + 1] += share
        gradient[3 * k + 1] -= start.eps * share
        chi2 += start.eps**2 * share
        away = start.offset - one.centre.offset
        matrix[3 * k, 3 * k] += START_SIGMA**-2
        gradient[3 * k] -= away / START_SIGMA**2
        chi2 += away**2 / START_SIGMA**2
    return _Combined(link.T @ matrix @ link, link.T @ gradient, chi2)
