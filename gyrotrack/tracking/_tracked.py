"""The motion of one tracked body, and the part of its uncertainty that a displaced hub causes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Floats, Integers
from gyrotrack.tracking._registration import TURN, Ring, Template

_MANY_TURNS = 3.0
"""Smallest number of turns in which an error once per turn is distinguishable from a motion [turns]. Chosen: a smaller
number understates the uncertainty, a larger one overstates it."""
_APART = 5.0
"""Largest slowly varying difference between the angles of the two halves of a rigid body, divided by the standard
uncertainty of the angle [1]. Measured: up to 3 for real wheels and discs, 10 for a drawn rim with an oscillation of 10
to 30 mrad relative to its disc."""


@dataclass(frozen=True)
class Tracked:
    """The motion of one body in a film."""

    frame: Integers  # shape (m,); frames in which the motion was measured
    # shape (m,); unwrapped angle, counter-clockwise as seen, and its standard uncertainty [rad]
    angle: Floats
    sigma: Floats
    ring: Ring  # ring in which the motion was measured
    template: Template  # the learnt picture of the body
    hub_path: Floats  # shape (m, 2); displacement of the hub [px]
    explained: float  # share of the change of brightness that the motion explains, 0 to 1
    way: str  # method by which the hub was found
    scale: float  # measured scatter of the angles divided by the Cramer-Rao bound
    # shape (2, m); the angle from the inner half and from the outer half of the ring alone [rad]; their difference is
    # due to the view (perspective, a displaced hub) and to parts that are fixed in the image
    halves: Floats
    # correlated uncertainty from the difference of two methods of measurement [rad]; 0 for one method
    correlated: float
    warnings: tuple[str, ...]  # warnings for the user
    # relative error of the distance of a hub outside the picture; all angles are inversely proportional to this
    # distance
    distance_error: float = 0.0
    ambiguous: bool = False  # whether the result is doubtful; the last warning then states the reason
    # shape (m,); size of the body in the picture relative to `ring`; None if it is constant
    size: Floats | None = None

    def ring_at(self, index: int) -> Ring:
        """Return the ring about the body in a frame, given by its index in `frame`, without the motion of the hub."""
        return self.ring if self.size is None else self.ring.scaled(float(self.size[index]))

    @property
    def hub_leverage(self) -> float:
        """Error due to a displaced hub, divided by the resulting difference between the halves of the ring."""
        return hub_leverage(self.template.halves())


def white_noise(value: Floats, at: npt.ArrayLike | None = None) -> float:
    """Return the standard deviation of the white noise in a series: the smallest from differences of orders 2 to 6.

    A divided difference of order m over the increasing places `at` has the weights 1 / prod_k (x_j - x_k), which
    cancel polynomials up to order m - 1. Scaled to unit norm, this difference has the variance of the noise. The
    estimate is robust: 1.4826 times the median of the moduli.
    """
    x = np.arange(len(value), dtype=np.float64) if at is None else np.asarray(at, dtype=np.float64)
    found = []
    for order in range(2, 7):
        if len(value) <= 3 * order:
            continue
        places = np.lib.stride_tricks.sliding_window_view(x, order + 1)
        apart = places[:, :, None] - places[:, None, :] + np.eye(order + 1)
        weight = 1.0 / np.prod(apart, axis=2)
        weight /= np.sqrt(np.sum(weight**2, axis=1, keepdims=True))
        difference = np.sum(weight * np.lib.stride_tricks.sliding_window_view(value, order + 1), axis=1)
        found.append(1.4826 * float(np.median(np.abs(difference))))
    return min(found) if found else float("nan")


def correlated_variance(rest: Floats, least: float = 0.0) -> float:
    """Return the variance of independent residuals that determine a fit as well as the correlated residuals `rest`.

    n residuals with the correlation q of neighbours are equivalent to n (1 - q) / (1 + q) independent residuals. The
    variance of `rest` is increased by `least`.
    """
    alike = float(np.clip(np.sum(rest[1:] * rest[:-1]) / max(np.sum(rest**2), 1e-12), 0.0, 0.95))
    return (float(np.var(rest)) + least) * (1.0 + alike) / (1.0 - alike)


_SIGNIFICANT = 3.0
"""Smallest significant error due to a displaced hub, in standard errors [1]. Chosen: a smaller value states noise as an
error, a larger one hides a displaced hub."""


def hub_error(angle: Floats, halves: Floats, parts: tuple[Template, Template]) -> float:
    """Return the rms error of the angles due to a displaced hub [rad], from the two `halves` (2, n) of the ring.

    A hub displaced by e causes an error e / r once per turn at radius r. The halves at r1 and r2 therefore differ by e
    (1 / r1 - 1 / r2); perspective causes a similar difference. The difference is fitted by a first harmonic, a mean and
    a trend. Over less than half a turn, the harmonic resembles mean and trend, and the difference is fitted by a
    multiple of the angle: if the hub is too near, all angles of a pendulum are too large. Values below three standard
    errors are set to 0. Over `_MANY_TURNS` the error does not resemble a motion (fits include it as a nuisance
    parameter), and the result is 0.
    """
    if np.ptp(angle) > _MANY_TURNS * TURN:
        return 0.0
    apart = halves[0] - halves[1]
    columns = [np.cos(angle), np.sin(angle)] if np.ptp(angle) > 0.5 * TURN else [angle - angle.mean()]
    free = len(columns)
    rows = np.stack([*columns, np.ones_like(angle), np.linspace(-1.0, 1.0, len(angle))], axis=1)
    found, *_ = np.linalg.lstsq(rows, apart, rcond=None)
    rest = apart - rows @ found
    variance = np.linalg.pinv(rows.T @ rows)[:free, :free] * float(np.var(rest))
    if float(np.sum(found[:free] ** 2)) < _SIGNIFICANT**2 * float(np.trace(variance)):
        return 0.0
    return float(np.std(rows[:, :free] @ found[:free])) * hub_leverage(parts)


def apart_beyond_harmonics(angle: Floats, halves: Floats, at: Integers, sigma: float) -> float | None:
    """Return the error of the angles if the halves of the ring turn differently over many turns [rad]; None if small.

    The halves of a rigid body differ by harmonics of the angle, a slow trend of the view, and noise. A further
    variation that exceeds `_APART` times the standard uncertainty `sigma` of the angles [rad] is another motion. The
    angle is approximately the mean of the two halves (2, n), so that its error is half of the difference. `at` (n,) are
    the frames.
    """
    if np.ptp(angle) <= _MANY_TURNS * TURN:
        return None
    apart = halves[0] - halves[1]
    orders = [f(k * angle) for k in (1, 2) for f in (np.cos, np.sin)]
    rows = np.stack([*orders, np.ones_like(angle), np.linspace(-1.0, 1.0, len(angle))], axis=1)
    found, *_ = np.linalg.lstsq(rows, apart, rcond=None)
    rest = apart - rows @ found
    slow = math.sqrt(max(float(np.var(rest)) - white_noise(rest, at) ** 2, 0.0))
    return 0.5 * slow if slow > _APART * sigma else None


def hub_leverage(parts: tuple[Template, Template]) -> float:
    """Return 1 / r divided by |1 / r1 - 1 / r2| for the radii of a ring and of its halves."""
    r1, r2, r = (_radius_of(part) for part in (*parts, parts[0].whole()))
    return 1.0 / r / max(abs(1.0 / r1 - 1.0 / r2), 1e-9)


def _radius_of(part: Template) -> float:
    """Return the effective radius of a part of a ring: the mean weighted by the information about the angle [px]."""
    known = part.information()
    return float(np.sum(known * part.ring.radius) / max(float(np.sum(known)), 1e-12))
