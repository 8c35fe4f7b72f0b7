"""From the observations of the markers to the angle of their body.

The coarse path that followed the body counts the turns; each marker adds its fine angle as a small residual
from it. Markers are brought together by where they sit on the body, weighted by how much each one scatters
about the smooth motion; one that departs from the others is flagged and left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from gyrotrack._column_store import put_away
from gyrotrack._smoothing import (
    HALF_WINDOW,
    TimeBase,
    correlation_factor,
    excess,
    learning_window,
    share_of_floor,
    tail_factor,
)
from gyrotrack.tracking._observations import Candidate, spread_out
from gyrotrack.tracking._residuals import Residuals, wrapped
from gyrotrack.tracking._systematic_errors import learn_neighbours, learn_places, place_error, places_passed

Floats = npt.NDArray[np.float64]

ROUNDS = 5


@dataclass(frozen=True)
class MarkerAngles:
    """One marker: angle as seen, wrapped, its uncertainty, its place [rad]; NaN where not used."""

    angle: Floats
    sigma: Floats
    mount: float


@dataclass(frozen=True)
class BodyAngles:
    """A body: unwrapped angle as seen, uncertainty [rad], number of markers; NaN where none.

    `place_error` is the usual size of the errors by place that were learnt and taken out [rad], of the marker
    that errs least; NaN if none could be. `axis_off` tells for each marker of a fast body how far beside the assumed
    axis it turns, x + i y (y up) over its radius.
    """

    angle: Floats
    sigma: Floats
    count: npt.NDArray[np.int64]
    markers: dict[str, MarkerAngles]
    place_error: float = float("nan")
    axis_off: dict[str, complex] = field(default_factory=dict)

    def spread_out(self, index: npt.NDArray[np.int64], count: int) -> BodyAngles:
        """Put the frames at the places `index` of `count`; what lies between has no angle."""
        number = np.zeros(count, dtype=np.int64)
        number[index] = self.count
        angle, sigma = (spread_out(a, index, count) for a in (self.angle, self.sigma))
        markers = {
            name: MarkerAngles(spread_out(m.angle, index, count), spread_out(m.sigma, index, count), m.mount)
            for name, m in self.markers.items()
        }
        return replace(self, angle=angle, sigma=sigma, count=number, markers=markers)

    def at(self, index: npt.NDArray[np.int64]) -> BodyAngles:
        """Return the frames `index` alone."""
        markers = {
            name: MarkerAngles(m.angle[index], m.sigma[index], m.mount) for name, m in self.markers.items()
        }
        return replace(
            self,
            angle=self.angle[index],
            sigma=self.sigma[index],
            count=self.count[index],
            markers=markers,
        )


def join(
    coarse: Floats,
    candidates: dict[str, Candidate],
    fps: float,
    other: Floats | None = None,
    floor: float = 0.0,
    axis: float | Floats = 0.0,
    *,
    above: bool = False,
    time_base: TimeBase | None = None,
) -> BodyAngles:
    """Join the markers of one body; its zero is the angle of the first one.

    Parameters
    ----------
    coarse : ndarray, shape (n,)
        Unwrapped coarse angle of the body as seen [rad], NaN where it was lost.
    candidates : dict of Candidate
        Its markers.
    fps : float
        Frames per second of the camera.
    other : ndarray, shape (n,), optional
        Angle as seen of the body that hides the markers now and then, or passes beneath them [rad].
    floor, axis : float or ndarray, shape (n,)
        Uncertainties in rad of what does not show as scatter because the body does not turn round: errors by place, as
        far as they are not seen on the way, and an axis that is off.
    above : bool
        Whether the markers lie above the other body.
    time_base : TimeBase, optional
        When the frames were taken, if that was not evenly.
    """
    state = Residuals(coarse, candidates, fps, time_base)
    half, degree = learning_window(state.path)
    for _ in range(ROUNDS):
        short, leverage = state.smooth(HALF_WINDOW)
        state.replace_mounts(short)
        state.judge(short, leverage)
        smooth, _ = state.smooth(half, degree)
        state.note_turns(short, smooth, half)
        learn_places(state, smooth)
        if other is not None:
            learn_neighbours(state, smooth, other, (half, degree), above=above)
    state.judge(*state.smooth(HALF_WINDOW))
    return _result(state, half, degree, floor, axis)


def _result(state: Residuals, half: int, degree: int, floor: float, axis: float | Floats) -> BodyAngles:
    smooth, leverage = state.smooth(half, degree)
    state.measure_scatter(smooth, leverage)
    late = state.late()
    if isinstance(late, np.ndarray):
        state.set_apart(late)
    residual, sigma, count = state.mean()
    off = np.where(state.turning, np.nan, residual - smooth)
    floor *= share_of_floor(off, sigma, floor, places_passed(state) - float(np.nansum(leverage)))
    unlearnt = np.where(state.turning, 0.0, np.hypot(floor, axis))

    def calibrated(residual: Floats, sigma: Floats, share: float) -> Floats:
        """Raise or lower uncertainties until they are the size of the residuals about the smooth motion.

        Errors that stay alike for some frames look like motion in part: the smooth motion follows them by its leverage
        times their correlation factor.
        """
        whole = np.hypot(np.hypot(sigma, unlearnt), late)
        off = np.where(state.turning, (residual - smooth) / whole, np.nan)
        alike = correlation_factor(np.nan_to_num(off))
        off = off / np.sqrt(np.clip(1.0 - share * alike * leverage, 0.5, 1.0))
        scale = excess(off)
        return np.asarray(whole * scale * tail_factor(off / scale))

    own = {"angle": state.path + residual, "sigma": calibrated(residual, sigma, 1.0), "count": count}
    del residual, sigma, count
    body = put_away(own)
    markers = {}
    for name, c in state.candidates.items():
        use = state.use[name]
        own = {"angle": np.where(use, wrapped(c.angle - state.bias(name)), np.nan)}
        own["sigma"] = calibrated(
            np.where(use, state.residual(name), np.nan),
            np.where(use, state.sigma(name), np.nan),
            1.0 / len(state.candidates),
        )
        markers[name] = MarkerAngles(mount=state.mounts[name], **put_away(own))
    return BodyAngles(markers=markers, place_error=place_error(state), axis_off=state.axis_off, **body)
