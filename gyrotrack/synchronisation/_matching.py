"""Least squares for start, clock rate and direction of clips.

While a clip runs, the casing's camera knows the true angle psi(t) as a `stretch.Stretch`. The other camera
sees the same, on its own clock, from its own direction, with harmonics of its own:

    psi_B(s) + offset = psi(t0 + (1 + eps) s) + H_B

Spline and harmonics are linear; they are eliminated, which leaves for each clip a 3 x 3 normal matrix of
(t0, eps, offset). The clips of one camera are then solved together, with a common rate and, if asked for, a
common offset, by Gauss-Newton steps. chi2 is that of the clips, given what the casing's camera saw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve

from gyrotrack.io._records import Floats
from gyrotrack.synchronisation._curves import (
    HARMONIC_SIGMA,
    HARMONICS,
    Curve,
    Start,
    Stretch,
    harmonics,
    moved,
    on_lattice,
    stretch,
    window,
)


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
        A clip leaves its window, or the clips say nothing of some parameter.
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
