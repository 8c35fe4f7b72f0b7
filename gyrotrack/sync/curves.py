"""The casing's angle as each camera saw it, and the two of them as a pair to be matched."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gyrotrack.angles import median_smooth
from gyrotrack.dataset.records import Floats, Recording
from gyrotrack.errors import SyncError

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
