"""The angle of the casing as each camera recorded it.

In a window about the clip the casing's true angle is a quintic spline psi(t), and the camera sees

    psi_A(t) = psi(t) + H_A,   H = sin, cos of one and two turns of the casing.

The window is chosen once and stays while a clip is moved over it: a window that moved along would let samples
in and out, and chi2 would jump with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

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
    """What the casing's samples in a window say about psi and H_A.

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
