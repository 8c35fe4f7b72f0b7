"""Least squares for the start, clock rate and direction of clips, from the casing's angle in both cameras.

While a clip runs, the true angle of the casing is a quintic spline psi(t) on the casing camera's clock. Both
cameras measure it, each with harmonics of its own (H: sin, cos of one and two turns):

    psi_A(t)          = psi(t) + H_A
    psi_B(s) + offset = psi(t0 + (1 + eps) s) + H_B

The spline and the harmonics are linear; they are eliminated, which leaves for each clip a 3 x 3 normal matrix
of (t0, eps, offset). The clips of one camera are then solved together, with a common rate and, if asked for,
a common offset, by Gauss-Newton steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from gyrotrack.dataset.records import Floats
from gyrotrack.sync.curves import Curve, harmonics

DEGREE = 5
HARMONIC_SIGMA = 0.02  # rad; larger harmonics are not expected of any camera
MARGIN = 2.0  # the spline reaches beyond the clip by this part of half its length
MAX_STEP = 0.3  # s
MAX_ROUNDS = 40
TURN = 2 * np.pi


@dataclass(frozen=True)
class Start:
    """Where a clip lies: t_A = offset + (1 + eps) t_B, psi_A = psi_B + angle."""

    offset: float
    eps: float
    angle: float

    @property
    def vector(self) -> Floats:
        """Offset [s], eps [1] and angle [rad] as an array."""
        return np.array([self.offset, self.eps, self.angle])


@dataclass(frozen=True)
class Pair:
    """The casing's record, one clip, and the number of intervals of the spline over the clip."""

    casing: Curve
    clip: Curve
    intervals: int


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
        Sum of squares at the best point, with the prior of the rate.
    converged : bool
        Whether the steps became small.
    """

    starts: tuple[Start, ...]
    covariance: Floats
    chi2: float
    converged: bool

    def sigma(self, clip: int) -> Floats:
        """Return the uncertainties of offset, eps and angle of one clip."""
        return np.sqrt(np.diag(self.covariance)[3 * clip : 3 * clip + 3])


def normal(pair: Pair, start: Start) -> Normal:
    """Return the normal equations of one clip about `start`, spline and harmonics eliminated."""
    clip = pair.clip
    moment = start.offset + (1 + start.eps) * clip.time
    middle, width = (moment[0] + moment[-1]) / 2, (moment[-1] - moment[0]) / 2
    reach = (1 + MARGIN) * width
    casing = pair.casing.between(middle - reach, middle + reach)
    edges = min(casing.time[0], moment[0]), max(casing.time[-1], moment[-1])
    curve = np.polynomial.Polynomial.fit((moment - middle) / width, clip.angle + start.angle, 4)
    speed = curve.deriv()((moment - middle) / width) / width
    knots = _knots(*edges, pair.intervals)
    n, h = pair.intervals + DEGREE, 4
    rows_a = np.zeros((len(casing.time), n + 2 * h))
    rows_b = np.zeros((len(moment), n + 2 * h))
    rows_a[:, :n] = BSpline.design_matrix(casing.time, knots, DEGREE).toarray()
    rows_b[:, :n] = BSpline.design_matrix(moment, knots, DEGREE).toarray()
    rows_a[:, n : n + h] = harmonics(casing.angle)
    rows_b[:, n + h :] = harmonics(clip.angle)
    left_a = (casing.angle - curve((casing.time - middle) / width)) / casing.sigma
    left_b = (clip.angle + start.angle - curve((moment - middle) / width)) / clip.sigma
    change = np.column_stack([speed, speed * clip.time, -np.ones_like(speed)]) / clip.sigma[:, None]
    rows_a /= casing.sigma[:, None]
    rows_b /= clip.sigma[:, None]
    square = rows_a.T @ rows_a + rows_b.T @ rows_b
    square[np.arange(n, n + 2 * h), np.arange(n, n + 2 * h)] += HARMONIC_SIGMA**-2
    right = rows_a.T @ left_a + rows_b.T @ left_b
    cross = rows_b.T @ change
    factor = cho_factor(square)
    best = cho_solve(factor, right)
    return Normal(
        matrix=change.T @ change - cross.T @ cho_solve(factor, cross),
        gradient=change.T @ left_b - cross.T @ best,
        chi2=float(left_a @ left_a + left_b @ left_b - right @ best),
        residual_casing=left_a - rows_a @ best,
        residual_clip=left_b - rows_b @ best,
    )


def _knots(start: float, stop: float, intervals: int) -> Floats:
    margin = 1e-9 * max(1.0, abs(start), abs(stop))
    inner = np.linspace(start - margin, stop + margin, intervals + 1)
    return np.concatenate([np.repeat(inner[0], DEGREE), inner, np.repeat(inner[-1], DEGREE)])


def solve(
    pairs: Sequence[Pair],
    starts: Sequence[Start],
    *,
    rate_sigma: float,
    common_rate: bool = True,
    turns: Sequence[int | None] | None = None,
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
    """
    shared = [turn is not None for turn in turns or [None] * len(pairs)]
    link = _link(common_rate=common_rate, shared_angle=shared)
    point = _on_lattice(starts, turns) if turns is not None else list(starts)
    if common_rate:
        point = [replace(start, eps=point[0].eps) for start in point]
    converged = False
    for _ in range(MAX_ROUNDS):
        matrix, gradient, chi2 = _stack(pairs, point, rate_sigma, link)
        covariance = np.linalg.inv(matrix)
        step = covariance @ gradient
        longest = float(np.max(np.abs((link @ step)[::3])))
        if converged or not np.isfinite(longest):
            break
        converged = bool(step @ gradient < 1e-4)  # chi2 changes by less than that
        step = step * min(1.0, MAX_STEP / max(longest, 1e-300))
        point = _moved(point, link @ step)
    return Solution(tuple(point), link @ covariance @ link.T, chi2, converged)


def _stack(
    pairs: Sequence[Pair], point: Sequence[Start], rate_sigma: float, link: Floats
) -> tuple[Floats, Floats, float]:
    """Sum the normal equations of all clips in the free parameters, with the prior of each free rate."""
    size = 3 * len(pairs)
    matrix, gradient, chi2 = np.zeros((size, size)), np.zeros(size), 0.0
    rates = np.flatnonzero(link[1::3].any(axis=0))
    for k, (pair, start) in enumerate(zip(pairs, point, strict=True)):
        part = normal(pair, start)
        block = slice(3 * k, 3 * k + 3)
        matrix[block, block], gradient[block] = part.matrix, part.gradient
        chi2 += part.chi2
        share = len(rates) / len(pairs) / rate_sigma**2  # a common rate has one prior, not one per clip
        matrix[3 * k + 1, 3 * k + 1] += share
        gradient[3 * k + 1] -= start.eps * share
        chi2 += start.eps**2 * share
    return link.T @ matrix @ link, link.T @ gradient, chi2


def _link(*, common_rate: bool, shared_angle: Sequence[bool]) -> Floats:
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


def _on_lattice(starts: Sequence[Start], turns: Sequence[int | None]) -> list[Start]:
    """Give the clips with a turn number one offset, up to their turns, without moving them in angle."""
    common = next(s.angle - TURN * m for s, m in zip(starts, turns, strict=True) if m is not None)
    return [
        s if m is None else replace(s, angle=common + TURN * m) for s, m in zip(starts, turns, strict=True)
    ]


def _moved(point: Sequence[Start], step: Floats) -> list[Start]:
    return [
        Start(s.offset + step[3 * k], s.eps + step[3 * k + 1], s.angle + step[3 * k + 2])
        for k, s in enumerate(point)
    ]
