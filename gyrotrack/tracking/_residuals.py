"""Residuals of the markers about the smooth motion of their body, and their scatter."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack._column_store import in_file, release_pages, row_blocks
from gyrotrack._smoothing import (
    FAR,
    TimeBase,
    core_scatter,
    line_through,
    local_fit,
    median_of,
    smooth_path,
    whole_turns,
)
from gyrotrack.tracking._observations import Candidate, variance_inflation

Floats = npt.NDArray[np.float64]

TURN = 2.0 * np.pi
ALL = slice(None)
FAST = 70.0
"""Angular rate [rad/s] at which an amplitude of the acceleration of 10 rad/s^2 (large unbalance) is 2 mrad."""
_LEFT = 0.2


class Residuals:
    """Residuals of the markers about the coarse path of their body, and the current estimates of their errors.

    Parameters
    ----------
    coarse : ndarray, shape (n,)
        Coarse path of the body as seen [rad], NaN where it was lost.
    candidates : dict of Candidate
        Its markers.
    fps : float
        Frames per second of the camera.
    time_base : TimeBase, optional
        Times of the frames, if they are not equally spaced.
    """

    def __init__(
        self, coarse: Floats, candidates: dict[str, Candidate], fps: float, time_base: TimeBase | None = None
    ) -> None:
        self._fps, self._time_base = fps, time_base
        path, even = (smooth_path(coarse),) * 2 if time_base is None else time_base.path(coarse)
        with np.errstate(invalid="ignore"):
            fast = self.speed(path) > FAST
        of_body = in_file({"path": path, "fast": fast, "turning": np.zeros_like(fast)})
        self.path, self.fast, self.turning = of_body.values()
        (self.bend,) = in_file({"bend": even - line_through(even)}).values()
        self.candidates = candidates
        self.mounts = {name: c.mount for name, c in candidates.items()}
        self.scatter = dict.fromkeys(candidates, (0.01, 0.03))
        self.axis_off: dict[str, complex] = {}
        nothing = np.zeros(len(path))
        own = {
            name: in_file({
                "weak": c.weak,
                "place": nothing,
                "neighbour": nothing,
                "use": c.good & np.isfinite(path) & np.isfinite(c.angle),
            })
            for name, c in candidates.items()
        }  # fmt: skip
        self.weak, self.by_place, self.by_neighbour, self.use = (
            {name: columns[what] for name, columns in own.items()}
            for what in ("weak", "place", "neighbour", "use")
        )

    def speed(self, path: Floats) -> Floats:
        """Return the magnitude of the angular rate of a path [rad/s], (n,)."""
        step = np.gradient(path) if self._time_base is None else self._time_base.speed(path)
        return np.asarray(np.abs(step) * self._fps)

    def time_sigma(self) -> Floats | float:
        """Return the uncertainty of the angle due to that of the time of a frame [rad]."""
        if self._time_base is None or self._time_base.sigma == 0.0:
            return 0.0
        return np.abs(self._time_base.speed(self.path)) * self._time_base.sigma

    def residual(self, name: str, part: slice = ALL) -> Floats:
        """Return the residual of the body's angle from a marker about the path [rad]."""
        off = self.candidates[name].angle[part] - self.path[part]
        off -= self.mounts[name]
        off -= self.bias(name, part)
        return wrapped(off)

    def bias(self, name: str, part: slice = ALL) -> Floats:
        """Return the learnt repeatable error of a marker in each frame [rad]."""
        return np.asarray(self.by_place[name][part] + self.by_neighbour[name][part])

    def sigma(self, name: str, part: slice = ALL) -> Floats:
        """Return the uncertainty of each observation: scatter of open or partly occluded ones, times `weak`."""
        clear, partly = self.scatter[name]
        return np.asarray(np.where(self.candidates[name].open[part], clear, partly) * self.weak[name][part])

    def mean(self) -> tuple[Floats, Floats, npt.NDArray[np.int64]]:
        """Return the weighted mean residual, its uncertainty, and the number of markers in it."""
        mean, sigma = np.zeros((2, len(self.path)))
        count = np.zeros(len(self.path), dtype=np.int64)
        for part in row_blocks(len(self.path)):
            weight = np.zeros(len(mean[part]))
            for name in self.candidates:
                w = np.where(self.use[name][part], 1.0 / self.sigma(name, part) ** 2, 0.0)
                mean[part] += np.where(w > 0, w * self.residual(name, part), 0.0)
                weight += w
                count[part] += w > 0
            seen = weight > 0
            safe = np.where(seen, weight, 1.0)
            nothing = np.where(seen, 0.0, np.nan)
            mean[part] = mean[part] / safe + nothing
            sigma[part] = 1.0 / np.sqrt(safe) + nothing
        return mean, sigma, count

    def smooth(self, half: int, degree: int = 2) -> tuple[Floats, Floats]:
        """Fit a smooth curve to the angle of the body; return its difference from the path, and leverages."""
        mean, sigma, _ = self.mean()
        if self._time_base is not None:
            return self._time_base.smooth(mean, _weight(sigma), self.bend, half, degree)
        mean += self.bend
        fitted, leverage = local_fit(mean, _weight(sigma), half, degree)
        fitted -= self.bend
        return fitted, leverage

    def replace_mounts(self, smooth: Floats) -> None:
        """Update the mount angles of the markers; that of the first one is fixed."""
        shift = {name: self._median_off(name, smooth) for name in self.candidates}
        zero = next(iter(shift.values()))
        for name in self.candidates:
            self.mounts[name] += shift[name] - zero

    def _median_off(self, name: str, smooth: Floats) -> float:
        off = self.residual(name)
        off -= smooth
        off = off[self.use[name] & np.isfinite(off)]
        release_pages()
        return median_of(off) if len(off) else 0.0

    def reject_outliers(self, smooth: Floats, leverage: Floats) -> None:
        """Measure the scatter of each marker about the smooth motion, and reject outliers."""
        for name, c in self.candidates.items():
            self._inflate_variance(name, smooth, leverage)
            off = self._standardised(name, smooth, leverage)
            clear = core_scatter(off[self.use[name] & c.open], self.scatter[name][0])
            partly = max(core_scatter(off[self.use[name] & ~c.open], 3.0 * clear), clear)
            self.scatter[name] = (clear, partly)
            limit = FAR * np.where(c.open, clear, min(partly, 5.0 * clear)) + 5e-4
            self.use[name] &= ~(np.abs(off) > limit)
            release_pages()

    def _inflate_variance(self, name: str, smooth: Floats, leverage: Floats) -> None:
        """Estimate the increase of the variance of a marker with its misfit (see `variance_inflation`)."""
        c = self.candidates[name]
        weak = self.weak[name]
        weak[:] = c.weak
        off = self._standardised(name, smooth, leverage)
        for part in (c.open, ~c.open):
            some = self.use[name] & part
            share = variance_inflation(off[some], c.misfit_excess[some])
            weak[part] = c.weak[part] * np.sqrt(1.0 + share * c.misfit_excess[part])

    def measure_scatter(self, smooth: Floats, leverage: Floats) -> None:
        """Measure the scatter again about a curve that is smooth over whole turns.

        It contains errors that repeat with the turn, except for those that the learnt curves have removed from the
        angles. It is limited to 2.5 times the scatter about the short curve, since a larger one is due to real motion.
        """
        for name, c in self.candidates.items():
            off = self._standardised(name, smooth, leverage)
            short = self.scatter[name]
            clear, partly = (
                float(np.clip(core_scatter(off[self.use[name] & part & self.turning], s), s, 2.5 * s))
                for part, s in zip((c.open, ~c.open), short, strict=True)
            )
            self.scatter[name] = (clear, partly)

    def subtract_time_scatter(self, from_time: Floats) -> None:
        """Subtract from the scatter the part caused by the uncertainty of the times, which all markers share."""
        shared = float(np.nanmean(from_time**2))
        for name, scatter in self.scatter.items():
            clear, partly = (float(np.sqrt(max(s**2 - shared, (_LEFT * s) ** 2))) for s in scatter)
            self.scatter[name] = (clear, partly)

    def _standardised(self, name: str, smooth: Floats, leverage: Floats) -> Floats:
        off = np.empty(len(self.path))
        for part in row_blocks(len(off)):
            share = np.clip(1.0 - leverage[part] / max(len(self.candidates), 1), 0.1, 1.0)
            off[part] = self.residual(name, part) - smooth[part]
            off[part] /= self.weak[name][part]
            off[part] /= np.sqrt(share)
        return off

    def mark_whole_turns(self, short: Floats, smooth: Floats, half: int) -> None:
        """Mark the frames in which errors that repeat with the turn can be distinguished from motion.

        In these the long window contains a whole turn and its curve fits the motion, unlike at a sudden start.
        """
        usual = min(clear for clear, _ in self.scatter.values())
        with np.errstate(invalid="ignore"):
            self.turning[:] = whole_turns(self.path, half) & (np.abs(smooth - short) < 12.0 * usual)
        release_pages()


def wrapped(angle: Floats) -> Floats:
    """Return angles in [-pi, pi]."""
    return np.asarray(angle - TURN * np.rint(angle / TURN))


def _weight(sigma: Floats) -> Floats:
    """Return the weights of the mean residuals in the fit of a smooth curve, 1 for the median uncertainty."""
    known = np.isfinite(sigma)
    if not known.any():
        return np.zeros(len(sigma))
    return np.where(known, (median_of(sigma[known]) / np.where(known, sigma, 1.0)) ** 2, 0.0)
