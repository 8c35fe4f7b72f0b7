"""What a score is computed against: residuals, free columns and empty data, whitened at several noise levels.

The covariance of the rows of a case is C = V (1 + s^2 L) V' with the same V at every level s. So rows are turned by V'
once, and whitened at each level by a factor a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CAMERA_COLUMNS
from fitting.estimation import Fit
from fitting.estimation.lack import block_diagonal
from fitting.noise import Whitener

Array = NDArray[np.float64]

_LEVELS = 9
_CAMERA_WIDTH = 6
# share of a column that is left beside the base, angles taken as exact, below which the base mimics it
_ABSORBED = 1e-7
_SEED = 7


class Level(NamedTuple):
    """One level of the random torque: factor of each row, basis of what is free, what is left, and the deviance."""

    gain: Array
    basis: Array
    residual: Array
    deviance: float


class Stage:
    """Whitened residuals, Jacobian and empty data at several levels of the random torque."""

    def __init__(self, fit: Fit, draws: int) -> None:
        self.fit = fit
        data = fit.problem.data
        self.ends = np.cumsum([0, *(len(d.z) for d in data)])
        random = np.random.default_rng(_SEED)
        shares = np.linspace(0, 1, _LEVELS) if any(n.level > n.pure for n in fit.noise) else np.array([1.0])
        self._turns = [n.whitener.vectors for n in fit.noise]
        self._whiteners = [[n.whitener.at(_between(n.pure, n.level, x)) for n in fit.noise] for x in shares]
        # a parameter on its bound is held there: what an effect would free is left to the refit
        moving = ~fit.problem.layout.at_bound(fit.theta)
        free = np.concatenate([p.jacobian[:, moving] for p in fit.predictions])
        nuisance = block_diagonal([d.nuisance for d in data])
        residual = np.concatenate([d.z - p.rows for d, p in zip(data, fit.predictions, strict=True)])
        everything = np.concatenate([free, nuisance], axis=1)
        self._free = self.turned(everything)
        self._nuisance_at = free.shape[1] + np.cumsum([0, *(d.nuisance.shape[1] for d in data)])
        self._residual = self.turned(residual)
        self._plain = _orthonormal(everything[:, : self._nuisance_at[0]])
        self.levels = [self._level(w, self._free) for w in self._whiteners]
        self.draws = self.turned(random.standard_normal((len(residual), draws)))

    def turned(self, rows: Array) -> Array:
        """Turn rows of all cases into the axes of their noise."""
        parts = []
        for v, a, b in zip(self._turns, self.ends, self.ends[1:], strict=False):
            parts += [v.T @ rows[a : a + len(v)], rows[a + len(v) : b]]
        return np.concatenate(parts)

    def mimicked(self, groups: Sequence[Array]) -> NDArray[np.bool_]:
        """Return which groups of columns lie within what is free."""
        everything = np.concatenate(groups, axis=1)
        left = everything - self._plain @ (self._plain.T @ everything)
        share = np.linalg.norm(left, axis=0) / np.maximum(np.linalg.norm(everything, axis=0), 1e-300)
        return np.asarray(share.reshape(len(groups), -1).max(axis=1) < _ABSORBED)

    def _level(self, whiteners: Sequence[Whitener], free: Array) -> Level:
        gain = np.concatenate([
            np.concatenate([1 / np.sqrt(1 + w.level**2 * w.values), np.ones(b - a - len(w.values))])
            for w, a, b in zip(whiteners, self.ends, self.ends[1:], strict=False)
        ])  # fmt: skip
        q = _orthonormal(gain[:, None] * free)
        r = gain * self._residual
        r = r - q @ (q.T @ r)
        return Level(gain, q, r, float(r @ r) + sum(w.log_determinant for w in whiteners))

    def beside(self, columns: Array) -> list[Level]:
        """Return the levels with further columns free."""
        free = np.concatenate([self._free, self.turned(columns)], axis=1)
        return [self._level(w, free) for w in self._whiteners]

    def without(self, name: str) -> list[Level]:
        """Return the levels with a camera's nuisance taken out of what is free."""
        skip = [int(end) - _CAMERA_WIDTH + i for end in self._nuisance_at[1:] for i in CAMERA_COLUMNS[name]]
        free = np.delete(self._free, skip, axis=1)
        return [self._level(w, free) for w in self._whiteners]


def _between(pure: float, level: float, share: float) -> float:
    if level <= pure:
        return pure
    floor = max(pure, 1e-3 * level)
    return float(floor * (level / floor) ** share)


def _orthonormal(columns: Array) -> Array:
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return np.asarray(u[:, s > 1e-10 * s[0]])
