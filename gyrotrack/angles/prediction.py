"""Where a body will be in the next frames, from where it was in the last ones, and how surely."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.local import median_of

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MEMORY = 128
"""Sightings that are kept."""
FEWEST = 16
LONGEST_USE = 130
"""Frames for which a fit is used before it is made anew."""
LEAST_SCATTER = 1.5e-3
"""Scatter in rad of a coarse angle that is assumed at least."""
SWING = 0.05
"""How far in rad a slanted view may move a marker once and twice a turn."""


class Prediction:
    """The last angles of a body, and an even motion through them as a slanted camera sees it.

    Notes
    -----
    The angle at frame x is a + b x + c x^2 + d cos psi + e sin psi + f cos 2 psi + g sin 2 psi, with psi the
    parabola alone. With X the rows of these functions, s the scatter about the fit and P the prior of d to g,
    it is uncertain by s sqrt(x' (X'X + P)^-1 x).
    """

    def __init__(self) -> None:
        self._frame: Floats = np.zeros(0)
        self._angle: Floats = np.zeros(0)
        self._origin: float | None = None
        self._scale = self._base = self._scatter = 1.0
        self._even: Floats = np.zeros(3)
        self._solution: Floats = np.zeros(7)
        self._inverse: Floats = np.eye(7)

    def note(self, frame: Floats, angle: Floats, seen: Mask) -> None:
        """Add the unwrapped angles of frames in which the body was seen."""
        self._frame = np.concatenate([self._frame, frame[seen]])[-MEMORY:]
        self._angle = np.concatenate([self._angle, angle[seen]])[-MEMORY:]

    def forget(self) -> None:
        """Start anew, after a loss."""
        self._frame, self._angle, self._origin = self._frame[:0], self._angle[:0], None

    def at(self, frame: Floats) -> tuple[Floats, float] | None:
        """Return the angles at some frames and the largest uncertainty among them; None if too little is known."""
        if len(self._frame) < FEWEST:
            return None
        if self._origin is None or frame[-1] - self._origin > LONGEST_USE:
            self._fit()
        rows = self._rows(frame)
        spread = np.sqrt(((rows @ self._inverse) * rows).sum(axis=1).max())
        return self._base + rows @ self._solution, self._scatter * float(spread)

    def _fit(self) -> None:
        self._origin, self._base = float(self._frame[-1]), float(self._angle[-1])
        self._scale = float(self._frame[-1] - self._frame[0])
        angle = self._angle - self._base
        self._even, _, _ = _robust(self._parabola(self._frame), angle, np.zeros(3))
        prior = np.array([0.0] * 3 + [1.0 / SWING**2] * 4)
        self._solution, self._inverse, self._scatter = _robust(self._rows(self._frame), angle, prior)

    def _parabola(self, frame: Floats) -> Floats:
        x = (frame - (self._origin or 0)) / self._scale
        return np.stack([np.ones_like(x), x, x * x], axis=1)

    def _rows(self, frame: Floats) -> Floats:
        rows = self._parabola(frame)
        psi = self._base + rows @ self._even
        return np.column_stack([rows, np.cos(psi), np.sin(psi), np.cos(2.0 * psi), np.sin(2.0 * psi)])


def _robust(rows: Floats, value: Floats, prior: Floats) -> tuple[Floats, Floats, float]:
    """Fit a linear model without what lies far off: coefficients, inverse of the normal matrix, scatter."""
    weight = np.ones(len(value))
    scatter = SWING
    for _ in range(3):
        weighted = rows * weight[:, None]
        inverse = np.linalg.inv(weighted.T @ rows + np.diag(prior) * scatter**2)
        solution = inverse @ (weighted.T @ value)
        left = np.abs(value - rows @ solution)
        before, scatter = scatter, max(1.4826 * median_of(left), LEAST_SCATTER)
        last, weight = weight, (left < 3.0 * scatter).astype(np.float64)
        if np.array_equal(weight, last) and (scatter == before or not prior.any()):
            break  # the next round would find the same
    return solution, np.asarray(inverse, dtype=np.float64), scatter
