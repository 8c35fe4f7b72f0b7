"""How far the markers depart from their body's even motion: what of that repeats, and what scatters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.bias import KNOTS, closed_curve, curve_at, without_common_motion
from gyrotrack.angles.candidates import Candidate
from gyrotrack.angles.evenness import line_through, whole_turns
from gyrotrack.angles.oddity import most_likely_share
from gyrotrack.angles.scatter import FAR, core_scatter
from gyrotrack.geometry.local import local_fit

Floats = npt.NDArray[np.float64]

TURN = 2.0 * np.pi
FAST = 70.0
"""Speed in rad/s at which a swing of the acceleration by 10 rad/s^2, a heavy unbalance, is 2 mrad."""
MOSTLY = 0.5
"""Share of the frames in which a body must turn round for its errors by place to be known."""
ENOUGH = 0.2
"""Share of the frames that must be fast for curves to be learnt from these alone."""


class Departures:
    """The markers' departures from the coarse path of their body, and what is thought of them so far.

    Parameters
    ----------
    path : ndarray, shape (n,)
        Smooth coarse path of the body as seen [rad], NaN where it was lost.
    candidates : dict of Candidate
        Its markers.
    fps : float
        Frames per second of the camera.
    """

    def __init__(self, path: Floats, candidates: dict[str, Candidate], fps: float) -> None:
        self.path = path
        self._fps = fps
        self.turning = np.zeros(len(path), dtype=np.bool_)
        with np.errstate(invalid="ignore"):
            self.fast = np.abs(np.gradient(path)) * fps > FAST
        self.bend = path - line_through(path)
        self.candidates = candidates
        self.mounts = {name: c.mount for name, c in candidates.items()}
        self.weak = {name: c.weak for name, c in candidates.items()}
        self.scatter = dict.fromkeys(candidates, (0.01, 0.03))
        self.by_place = {name: np.zeros(len(path)) for name in candidates}
        self.by_neighbour = {name: np.zeros(len(path)) for name in candidates}
        self.use = {n: c.good & np.isfinite(path) & np.isfinite(c.angle) for n, c in candidates.items()}

    def departure(self, name: str) -> Floats:
        """Return by how much a marker puts the body ahead of its path [rad]."""
        return wrapped(self.candidates[name].angle - self.path - self.mounts[name] - self.bias(name))

    def bias(self, name: str) -> Floats:
        """Return what was learnt of a marker's repeating errors, in each frame [rad]."""
        return self.by_place[name] + self.by_neighbour[name]

    def sigma(self, name: str) -> Floats:
        """Return the uncertainty of each sighting: scatter of open or partly hidden ones, times their weakness."""
        c = self.candidates[name]
        clear, partly = self.scatter[name]
        return np.asarray(np.where(c.open, clear, partly) * self.weak[name])

    def mean(self) -> tuple[Floats, Floats, npt.NDArray[np.int64]]:
        """Return the weighted mean departure, its uncertainty, and the number of markers in it."""
        total, weight = np.zeros(len(self.path)), np.zeros(len(self.path))
        count = np.zeros(len(self.path), dtype=np.int64)
        for name in self.candidates:
            w = np.where(self.use[name], 1.0 / self.sigma(name) ** 2, 0.0)
            total += np.where(w > 0, w * self.departure(name), 0.0)
            weight += w
            count += w > 0
        seen = weight > 0
        safe = np.where(seen, weight, 1.0)
        nothing = np.where(seen, 0.0, np.nan)
        return total / safe + nothing, 1.0 / np.sqrt(safe) + nothing, count

    def smooth(self, half: int, degree: int = 2) -> tuple[Floats, Floats]:
        """Fit a smooth curve to the body's angle; return its departure from the path, and leverages."""
        fitted, leverage = local_fit(self.bend + self.mean()[0], self.weight(), half, degree)
        return fitted - self.bend, leverage

    def weight(self) -> Floats:
        """Return weights of the mean departures for a smooth curve through them, 1 for usual ones."""
        sigma = self.mean()[1]
        known = np.isfinite(sigma)
        if not known.any():
            return np.zeros(len(sigma))
        return np.where(known, (np.median(sigma[known]) / np.where(known, sigma, 1.0)) ** 2, 0.0)

    def replace_mounts(self, smooth: Floats) -> None:
        """Measure anew where the markers sit; the first one stays where it is."""
        shift = {name: self._median_off(name, smooth) for name in self.candidates}
        zero = next(iter(shift.values()))
        for name in self.candidates:
            self.mounts[name] += shift[name] - zero

    def _median_off(self, name: str, smooth: Floats) -> float:
        off = (self.departure(name) - smooth)[self.use[name]]
        off = off[np.isfinite(off)]
        return float(np.median(off)) if len(off) else 0.0

    def judge(self, smooth: Floats, leverage: Floats) -> None:
        """Measure each marker's scatter about the smooth motion, and drop what lies far off."""
        for name, c in self.candidates.items():
            self._weigh_oddities(name, smooth, leverage)
            off = self._standardised(name, smooth, leverage)
            clear = core_scatter(off[self.use[name] & c.open], self.scatter[name][0])
            partly = max(core_scatter(off[self.use[name] & ~c.open], 3.0 * clear), clear)
            self.scatter[name] = (clear, partly)
            limit = FAR * np.where(c.open, clear, min(partly, 5.0 * clear)) + 5e-4
            self.use[name] = self.use[name] & ~(np.abs(off) > limit)

    def _weigh_oddities(self, name: str, smooth: Floats, leverage: Floats) -> None:
        """Learn how much more a marker errs where its profile fits less well (see `oddity`)."""
        c = self.candidates[name]
        self.weak[name] = c.weak
        off = self._standardised(name, smooth, leverage)
        for part in (c.open, ~c.open):
            some = self.use[name] & part
            share = most_likely_share(off[some], c.odd[some])
            self.weak[name] = np.where(part, c.weak * np.sqrt(1.0 + share * c.odd), self.weak[name])

    def measure_scatter(self, smooth: Floats, leverage: Floats) -> None:
        """Measure the scatter once more about a curve that is smooth over whole turns.

        Errors that repeat with the turn are no motion there, and count. What the learnt curves have taken up is
        not given back: they have taken it out of the angles too, so that what is left over is their error. A
        scatter far above that about the short curve is a motion in earnest and is not believed.
        """
        for name, c in self.candidates.items():
            off = self._standardised(name, smooth, leverage)
            short = self.scatter[name]
            clear, partly = (
                float(np.clip(core_scatter(off[self.use[name] & part & self.turning], s), s, 2.5 * s))
                for part, s in zip((c.open, ~c.open), short, strict=True)
            )
            self.scatter[name] = (clear, partly)

    def _standardised(self, name: str, smooth: Floats, leverage: Floats) -> Floats:
        share = np.clip(1.0 - leverage / max(len(self.candidates), 1), 0.1, 1.0)
        return np.asarray((self.departure(name) - smooth) / self.weak[name] / np.sqrt(share))

    def note_turns(self, short: Floats, smooth: Floats, half: int) -> None:
        """Note where errors that repeat with the turn can be told from motion.

        There the long window holds a whole turn, and its curve follows the motion: a sudden start is in no
        curve.
        """
        usual = min(clear for clear, _ in self.scatter.values())
        with np.errstate(invalid="ignore"):
            self.turning = whole_turns(self.path, half) & (np.abs(smooth - short) < 12.0 * usual)

    def learn_places(self, smooth: Floats) -> None:
        """Learn each marker's error by its place in the picture (see `bias`)."""
        fast = self.turning & self.fast
        geometry_only = fast.sum() > ENOUGH * self.turning.sum()
        when = fast if geometry_only else self.turning
        curves = {}
        for name, c in self.candidates.items():
            off = wrapped(c.angle - self.path - self.mounts[name] - self.by_neighbour[name]) - smooth
            fit = self.use[name] & c.open & when
            weight = np.where(fit, 1.0 / self.sigma(name) ** 2, 0.0)
            curves[name] = closed_curve(c.angle, off, weight)
        if not geometry_only:
            curves = without_common_motion(curves, self.mounts)
        for name, curve in curves.items():
            self.by_place[name] = curve_at(curve - curve.mean(), np.nan_to_num(self.candidates[name].angle))

    def place_error(self) -> float:
        """Return the root mean square of the errors by place that were learnt, of the marker that errs least [rad].

        A marker that is faint or smeared errs more than the place makes it. NaN if none could be learnt, or if the
        markers come back to the same few places.
        """
        if self.turning.mean() < MOSTLY:
            return float("nan")
        learnt = []
        for name, c in self.candidates.items():
            seen = self.use[name] & c.open & self.turning
            if len(np.unique(np.rint(c.angle[seen] * KNOTS / TURN))) >= KNOTS / 2:
                learnt.append(float(np.sqrt(np.mean(self.by_place[name][seen] ** 2))))
        return min(learnt, default=float("nan"))

    def learn_neighbours(self, smooth: Floats, other: Floats, *, above: bool) -> None:
        """Learn each marker's error by its angle to the other body (see `bias`).

        Markers below it err where it hides a part of them. Markers above it (`above`) err wherever the other body's
        own markers pass beside them; that is learnt where these pass so fast that no motion follows them.
        """
        with np.errstate(invalid="ignore"):
            passing = self.turning & (np.abs(np.gradient(other - self.path)) * self._fps > FAST)
        if above and passing.sum() <= ENOUGH * self.turning.sum():
            return
        for name, c in self.candidates.items():
            off = wrapped(c.angle - self.path - self.mounts[name] - self.by_place[name]) - smooth
            near = self.use[name] & np.isfinite(other)
            when = near & (passing if above else self.turning)
            weight = np.where(when, 1.0 / self.sigma(name) ** 2, 0.0)
            curve = closed_curve(np.nan_to_num(c.angle - other), off, weight)
            self.by_neighbour[name] = np.where(
                near & (above | ~c.open), curve_at(curve, np.nan_to_num(c.angle - other)), 0.0
            )


def wrapped(angle: Floats) -> Floats:
    """Return angles in [-pi, pi]."""
    return np.asarray(angle - TURN * np.rint(angle / TURN))
