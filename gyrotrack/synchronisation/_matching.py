"""Least squares for start, clock rate and direction of clips.

While a clip runs, the casing's camera knows the true angle psi(t) as a `stretch.Stretch`. The other camera
sees the same, on its own clock, from its own direction, with harmonics of its own:

    psi_B(s) + offset = psi(t0 + (1 + eps) s) + H_B

Spline and harmonics are linear; they are eliminated, which leaves for each clip a 3 x 3 normal matrix of
(t0, eps, offset). The clips of one camera are then solved together, with a common rate and, on request, a
common offset, by Gauss-Newton steps. chi2 is that of the clips, given what the casing's camera saw.

In a window about the clip the casing's true angle is a quintic spline psi(t), and the camera sees

    psi_A(t) = psi(t) + H_A,   H = sin, cos of one and two turns of the casing.

The window is chosen once and stays while a clip is moved over it: if it moved along, samples would enter and leave, and
chi2 would jump with them.
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


@dataclass(frozen=True)
class Start:
    """Where a clip lies: t_A = offset + (1 + eps) t_B, psi_A = psi_B + angle."""

    offset: float
    eps: float
    angle: float

    def moments(self, time: Floats) -> Floats:
        """Return times of the clip's clock on the casing's clock [s]."""
        return self.offset + (1 + self.eps) * time


def on_lattice(starts: Sequence[Start], turns: Sequence[int | None]) -> list[Start]:
    """Give the clips with a turn number one offset, up to their turns, without moving them in angle."""
    common = next(s.angle - TURN * m for s, m in zip(starts, turns, strict=True) if m is not None)
    return [
        s if m is None else replace(s, angle=common + TURN * m) for s, m in zip(starts, turns, strict=True)
    ]


def moved(point: Sequence[Start], step: Floats) -> list[Start]:
    """Return the starts of clips after a step in (offset, eps, angle) of all of them, (3 k,)."""
    return [
        Start(s.offset + step[3 * k], s.eps + step[3 * k + 1], s.angle + step[3 * k + 2])
        for k, s in enumerate(point)
    ]


OUTLIER = 6.0
BLOCKS = 60


def inliers(residual: Floats) -> npt.NDArray[np.bool_]:
    """Return which residuals lie within six robust spreads."""
    spread = 1.4826 * float(np.median(np.abs(residual)))
    return np.asarray(np.abs(residual) < OUTLIER * max(spread, 1e-300))


def block_means(residual: Floats, blocks: int = BLOCKS) -> tuple[Floats, int]:
    """Return the means of about so many blocks, and the length of a block."""
    length = max(len(residual) // blocks, 2)
    count = len(residual) // length
    return residual[: count * length].reshape(count, length).mean(axis=1), length


FEWEST = 60
NEIGHBOURS = 15
SHORTEST = 0.2


@dataclass(frozen=True)
class Curve:
    """One camera's casing: time on its own clock [s], unwrapped angle [rad], sigma [rad]."""

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
        """Return the samples that are good."""
        return Curve(self.time[good], self.angle[good], self.sigma[good])

    def scaled(self, factor: float) -> Curve:
        """Return the curve with its sigma multiplied by a factor."""
        return replace(self, sigma=self.sigma * factor)


def casing_curve(recording: Recording, name: str) -> Curve:
    """Return the casing's angle in a recording.

    Raises
    ------
    SyncError
        The recording does not show the casing, or too little of it.
    """
    body = recording.bodies.get("casing")
    if body is None:
        raise SyncError(
            f"{name} does not show the casing.",
            "Clips are matched by the casing: track its marker in every clip.",
        )
    seen = np.isfinite(body.angle) & np.isfinite(body.time) & (body.sigma > 0)
    curve = Curve(body.time[seen], body.angle[seen], body.sigma[seen])
    if len(curve.time) < FEWEST or curve.duration < SHORTEST:
        raise SyncError(
            f"{name} shows the casing in only {len(curve.time)} frames.",
            f"At least {FEWEST} frames over {SHORTEST} s are needed.",
        )
    return without_outliers(curve)


def without_outliers(curve: Curve) -> Curve:
    """Return the curve without samples that lie apart from their neighbours.

    The speed, as a running median, is integrated and taken off; what remains drifts slowly, and a sample more
    than six spreads from the median around it is left out.
    """
    step = np.diff(curve.time)
    speed = median_smooth(np.diff(curve.angle) / step, NEIGHBOURS)
    left = curve.angle - np.concatenate([[0.0], np.cumsum(speed * step)])
    apart = np.abs(left - median_smooth(left, NEIGHBOURS))
    spread = 1.4826 * float(np.median(apart))
    return curve.keep(apart <= 6 * spread) if spread > 0 else curve


def harmonics(angle: Floats) -> Floats:
    """Return what a centre that is off, or a tilt, adds to a seen angle: sin, cos of one and two turns.

    Parameters
    ----------
    angle : ndarray, shape (n,)
        Angles as this camera sees them [rad].

    Returns
    -------
    ndarray, shape (n, 4)
    """
    return np.column_stack([np.sin(angle), np.cos(angle), np.sin(2 * angle), np.cos(2 * angle)])


DEGREE = 5
MARGIN = 2.0  # the window reaches beyond the clip by this many times half its length, on both sides
HARMONIC_SIGMA = 0.02  # rad; larger harmonics are not expected of any camera
LOOSE = 1.0  # rad; how far the spline may leave the quartic where nothing is seen
HARMONICS = 4


@dataclass(frozen=True)
class Stretch:
    """Information of the casing's samples in a window on psi and H_A.

    Attributes
    ----------
    knots : ndarray
        Of the quintic spline, over the whole window.
    reference : Polynomial
        A quartic of time, from which the spline is measured.
    best : ndarray, shape (n + 4,)
        Coefficients of spline and harmonics from these samples alone.
    information : ndarray, shape (n + 4, n + 4)
        Inverse covariance of `best`.
    rows, residual : ndarray
        The design matrix of the samples, and what `best` leaves of them, in units of sigma.
    """

    knots: Floats
    reference: np.polynomial.Polynomial
    best: Floats
    information: Floats
    rows: Floats
    residual: Floats

    def design(self, time: Floats) -> Floats:
        """Return the values of the spline's basis, shape (len(time), n).

        Raises
        ------
        LinAlgError
            A time is outside the window.
        """
        if time[0] < self.knots[0] or time[-1] > self.knots[-1]:
            raise np.linalg.LinAlgError("the clip left the window")
        matrix: Floats = BSpline.design_matrix(time, self.knots, DEGREE).toarray()
        return matrix

    def speed(self, time: Floats) -> Floats:
        """Return the casing's true speed [rad s-1], from these samples alone."""
        spline = BSpline(self.knots, self.best[:-HARMONICS], DEGREE)
        return np.asarray(self.reference.deriv()(time) + spline.derivative()(time))


def window(first: float, last: float) -> tuple[float, float]:
    """Return the window about a clip that runs from `first` to `last` on the casing's clock [s]."""
    middle, reach = (first + last) / 2, (1 + MARGIN) * (last - first) / 2
    return middle - reach, middle + reach


def stretch(casing: Curve, edges: tuple[float, float], intervals: int) -> Stretch:
    """Fit spline and harmonics to the casing's samples in a window.

    Raises
    ------
    LinAlgError
        There are too few samples.
    """
    seen = casing.between(*edges)
    if len(seen.time) < 2 * DEGREE:
        raise np.linalg.LinAlgError("too few samples of the casing")
    knots = np.linspace(edges[0], edges[1], intervals + 1)
    knots = np.concatenate([np.repeat(knots[0], DEGREE), knots, np.repeat(knots[-1], DEGREE)])
    reference = np.polynomial.Polynomial.fit(seen.time, seen.angle, 4)
    spline = BSpline.design_matrix(seen.time, knots, DEGREE).toarray()
    rows = np.hstack([spline, harmonics(seen.angle)]) / seen.sigma[:, None]
    left = (seen.angle - reference(seen.time)) / seen.sigma
    size = spline.shape[1]
    information = rows.T @ rows + np.diag(np.repeat([LOOSE**-2, HARMONIC_SIGMA**-2], [size, HARMONICS]))
    best: Floats = cho_solve(cho_factor(information), rows.T @ left)
    return Stretch(knots, reference, best, information, rows, left - rows @ best)


def link_matrix(*, common_rate: bool, shared_angle: Sequence[bool]) -> Floats:
    """Return the matrix from free parameters to (offset, eps, angle) of every clip."""
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


FAR = 5.0  # s; a start is not sought further from its window; keeps a casing of constant speed solvable
MAX_STEP = 0.3  # s
MAX_ROUNDS = 40
MAX_HALVINGS = 6
CLOSE = 1e-3  # expected fall of chi2 at which the search ends


@dataclass(frozen=True)
class Pair:
    """The casing's record, one clip, and the number of intervals of the spline over the clip."""

    casing: Curve
    clip: Curve
    intervals: int


@dataclass(frozen=True)
class _Part:
    """One clip, the casing around it, and the start about which that was looked at."""

    clip: Curve
    casing: Stretch
    centre: Start


@dataclass(frozen=True)
class Normal:
    """The sum of squares near a `Start`, chi2 - 2 gradient . d + d . matrix . d, and the residuals there."""

    matrix: Floats
    gradient: Floats
    chi2: float
    residual_casing: Floats
    residual_clip: Floats


@dataclass(frozen=True)
class Solution:
    """The best starts of some clips together.

    Attributes
    ----------
    starts : tuple of Start
        One for each clip.
    covariance : ndarray, shape (3 k, 3 k)
        Of (offset, eps, angle) of all clips, one after the other.
    chi2 : float
        Sum of squares of the clips at the best point, with the prior of the rate.
    converged : bool
        Whether the steps became small.
    windows : tuple of Start
        The starts about which the windows lie; solutions with the same windows can be compared in chi2.
    """

    starts: tuple[Start, ...]
    covariance: Floats
    chi2: float
    converged: bool
    windows: tuple[Start, ...]

    def sigma(self, clip: int) -> Floats:
        """Return the uncertainties of offset, eps and angle of one clip."""
        variance = np.diag(self.covariance)[3 * clip : 3 * clip + 3]
        return np.sqrt(np.where(variance > 0, variance, np.inf))


def surroundings(pair: Pair, start: Start) -> Stretch:
    """Return the casing's motion in the window about a clip."""
    first, last = start.moments(pair.clip.time[[0, -1]])
    return stretch(pair.casing, window(first, last), pair.intervals)


def normal(clip: Curve, start: Start, casing: Stretch) -> Normal:
    """Return the normal equations of one clip about `start`, spline and harmonics eliminated.

    Raises
    ------
    LinAlgError
        The clip has left the window of `casing`.
    """
    moment = start.moments(clip.time)
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
    """Find the starts of clips together.

    Parameters
    ----------
    pairs, starts : sequences of the same length
        The clips, and where the search begins.
    rate_sigma : float
        Prior uncertainty of the clock rate about 1.
    common_rate : bool
        Whether the clips share one rate.
    turns : sequence of int or None
        The clips with a number share one offset of the angle, up to that many whole turns; the others, with
        None, have their own.
    windows : sequence of Start, or None
        The starts about which the casing is looked at; `starts`, if not given.

    Raises
    ------
    LinAlgError
        A clip leaves its window, or a parameter is not determined by the clips.
    """
    shared = [turn is not None for turn in turns or [None] * len(pairs)]
    link = link_matrix(common_rate=common_rate, shared_angle=shared)
    point = on_lattice(starts, turns) if turns is not None else list(starts)
    if common_rate:
        point = [replace(start, eps=point[0].eps) for start in point]
    windows = tuple(windows or starts)
    parts = [_Part(p.clip, surroundings(p, w), w) for p, w in zip(pairs, windows, strict=True)]
    here = _stack(parts, point, rate_sigma, link)
    converged = False
    for _ in range(MAX_ROUNDS):
        covariance = np.linalg.inv(here.matrix)
        step = covariance @ here.gradient
        converged = bool(step @ here.gradient < CLOSE)
        found = None if converged else _downhill(parts, point, link @ step, here.chi2, rate_sigma, link)
        if found is None:
            break
        point, here = found
    return Solution(tuple(point), link @ covariance @ link.T, here.chi2, converged, windows)


@dataclass(frozen=True)
class _Stacked:
    """The normal equations of several clips in their free parameters."""

    matrix: Floats
    gradient: Floats
    chi2: float


def _downhill(
    parts: Sequence[_Part], point: list[Start], step: Floats, chi2: float, rate_sigma: float, link: Floats
) -> tuple[list[Start], _Stacked] | None:
    """Go along a step as far as chi2 falls; None if it does not."""
    length = min(1.0, MAX_STEP / max(float(np.max(np.abs(step[::3]))), 1e-300))
    for _ in range(MAX_HALVINGS):
        there = moved(point, length * step)
        try:
            stacked = _stack(parts, there, rate_sigma, link)
        except np.linalg.LinAlgError:  # too far
            stacked = None
        if stacked is not None and stacked.chi2 < chi2:
            return there, stacked
        length /= 3
    return None


def _stack(parts: Sequence[_Part], point: Sequence[Start], rate_sigma: float, link: Floats) -> _Stacked:
    """Sum the normal equations of all clips in the free parameters, with the priors of rates and starts."""
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
        matrix[3 * k, 3 * k] += FAR**-2
        gradient[3 * k] -= away / FAR**2
        chi2 += away**2 / FAR**2
    return _Stacked(link.T @ matrix @ link, link.T @ gradient, chi2)
