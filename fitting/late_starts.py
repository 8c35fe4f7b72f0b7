"""The uncertainty of a rotor window's start, as a noise that all samples of the window share.

A camera that was started dt later than thought shows an angle that is off by psi'(t) dt. Beside the window's free phase
that is c dt with c = alpha (t - mean t), alpha the rotor's acceleration; a measured speed is off by c = alpha. With the
standard deviation s of the start the rows of a window, white otherwise, have the covariance 1 + s^2 c c'. They are
whitened by its symmetric root, which changes one direction only:

    A = 1 - (1 - 1 / sqrt(1 + |s c|^2)) u u',   u = c / |c|.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.compression import Compressed
from fitting.record import Samples

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LateStarts:
    """Whitens the rows of rotor windows whose starts are uncertain.

    Attributes
    ----------
    parts : tuple of (slice, ndarray, float)
        For each such window its rows, the unit vector u, and |s c|.
    """

    parts: tuple[tuple[slice, Array, float], ...]

    @classmethod
    def of(
        cls, windows: Sequence[Compressed], sigma: Sequence[float], first: int, *, angle: bool
    ) -> LateStarts:
        """Return the whitening for windows whose rows begin at `first`, with the uncertainty of each start [s]."""
        parts = []
        for window, s in zip(windows, sigma, strict=False):
            rows = slice(first, first + len(window.z))
            first = rows.stop
            t = window.node_times
            c = window.at_nodes(
                acceleration(window.samples, angle=angle) * (t - t.mean() if angle else np.ones_like(t))
            )
            size = float(np.linalg.norm(c))
            if s > 0 and size > 0:
                parts.append((rows, c / size, s * size))
        return cls(tuple(parts))

    def whitened(self, rows: Array) -> Array:
        """Return A rows."""
        return self._scaled(rows, [1 / np.hypot(1.0, size) for *_, size in self.parts])

    def plain(self, rows: Array) -> Array:
        """Return the rows before they were whitened."""
        return self._scaled(rows, [float(np.hypot(1.0, size)) for *_, size in self.parts])

    def _scaled(self, rows: Array, factors: Sequence[float]) -> Array:
        if not self.parts:
            return rows
        rows = rows.copy()
        for (where, u, _), factor in zip(self.parts, factors, strict=True):
            along = u @ rows[where]
            rows[where] += (factor - 1) * (u * along if rows.ndim == 1 else np.outer(u, along))
        return rows


def acceleration(samples: Samples, *, angle: bool) -> float:
    """Return the mean acceleration in a window [rad/s2]: of a parabola through angles, a line through speeds."""
    degree = 2 if angle else 1
    if len(samples) <= degree:
        return 0.0
    t = samples.time - samples.time.mean()
    return float(np.polyfit(t, samples.value, degree)[0] * degree)
