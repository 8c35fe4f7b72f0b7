"""From the sightings of markers to the angle of their body, without a slipped turn.

The coarse path that followed the body counts the turns; each marker adds its fine angle as a small departure from it.
Markers are brought together by where they sit on the body, weighted by how much each one scatters about the
smooth motion; one that departs from the others is flagged and left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.bias import closed_curve, curve_at, without_common_motion
from gyrotrack.angles.sightings import Sightings
from gyrotrack.geometry.local import local_fit, spread

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

HALF_WINDOW = 20
"""Frames to each side over which a body's motion is taken to be a parabola."""
FAR = 6.0
"""Standard deviations beyond which a sighting is taken for a fault."""
FAST = 70.0
"""Speed in rad/s above which no weight on a wheel makes the angle swing by 2 mrad: 10 rad/s^2 over its square."""
LARGEST_MISFIT = 0.12
"""Misfit that light alone can cause: something that hides a tenth of a marker leaves more."""
WEAKEST = 4.0
"""Factor on the uncertainty beyond which a partly hidden marker is not used."""


@dataclass(frozen=True)
class Candidate:
    """Fine angles of one marker before they are joined.

    Attributes
    ----------
    angle : ndarray, shape (n,)
        As seen, wrapped [rad].
    good : ndarray of bool, shape (n,)
        Where it is to be trusted by its looks.
    open : ndarray of bool, shape (n,)
        Nothing stands before any part of it.
    weak : ndarray, shape (n,)
        Factor on its uncertainty for what is hidden or dim.
    mount : float
        First value of where it sits on the body, as seen [rad].
    given : bool
        Whether that place is fixed by the profile.
    """

    angle: Floats
    good: Mask
    open: Mask
    weak: Floats
    mount: float
    given: bool = False


@dataclass(frozen=True)
class MarkerAngles:
    """One marker's fine angles as seen, wrapped, and their uncertainty [rad]; NaN where not used. `mount`: its place."""

    angle: Floats
    sigma: Floats
    mount: float


@dataclass(frozen=True)
class BodyAngles:
    """A body's angle: unwrapped as seen [rad], its uncertainty, and how many markers gave it; NaN where none did."""

    angle: Floats
    sigma: Floats
    count: npt.NDArray[np.int64]
    markers: dict[str, MarkerAngles]


def plausible(seen: Sightings) -> Mask:
    """Frames in which a marker stands out at its usual height, with its usual profile where it is open."""
    known = np.isfinite(seen.gain) & (seen.weakness < WEAKEST * _usual_weakness(seen))
    whole = known & seen.open
    if not whole.any():
        return whole
    height = float(np.median(seen.gain[whole]))
    known &= (seen.gain > 0.5 * height) & (seen.gain < 2.0 * height)
    typical = float(np.median(seen.misfit[whole]))
    scatter = 1.4826 * float(np.median(np.abs(seen.misfit[whole] - typical)))
    return np.asarray(known & (seen.misfit < max(typical + 6.0 * scatter, LARGEST_MISFIT)))


def candidate(seen: Sightings, angle: Floats, mount: float, *, given: bool) -> Candidate:
    """Make a candidate from sightings and their corrected angle."""
    return Candidate(angle, plausible(seen), seen.open, seen.weakness / _usual_weakness(seen), mount, given)


def _usual_weakness(seen: Sightings) -> float:
    whole = seen.open & np.isfinite(seen.weakness)
    return float(np.median(seen.weakness[whole])) if whole.any() else 1.0


def join(
    coarse: Floats,
    candidates: dict[str, Candidate],
    fps: float,
    other: Floats | None = None,
    floor: float = 0.0,
) -> BodyAngles:
    """Join the markers of one body.

    Parameters
    ----------
    coarse : ndarray, shape (n,)
        Unwrapped coarse angle of the body as seen [rad], NaN where it was lost.
    candidates : dict of Candidate
        Its markers. Places that the profile does not fix are measured relative to the first marker.
    fps : float
        Frames per second of the camera.
    other : ndarray, shape (n,), optional
        Angle as seen of the body that hides the markers now and then [rad].
    floor : float
        Uncertainty in rad for errors by place that cannot be learnt because the body does not turn round.
    """
    path = smooth_path(coarse)
    state = _Joint(path, candidates, fps)
    half, degree = learning_window(path)
    for _ in range(5):
        smooth, leverage = state.smooth(HALF_WINDOW)
        state.replace_mounts(smooth)
        state.judge(smooth, leverage)
        short, (smooth, _) = smooth, state.smooth(half, degree)
        state.note_turns(short, smooth, half)
        state.learn_places(smooth)
        if other is not None:
            state.learn_neighbours(smooth, other)
    smooth, leverage = state.smooth(HALF_WINDOW)
    state.judge(smooth, leverage)
    smooth, leverage = state.smooth(half, degree)
    state.measure_scatter(smooth, leverage)
    departure, sigma, count = state.mean()
    sigma = np.where(state.turning, sigma, np.hypot(sigma, floor))
    normalised = np.where(state.turning, (departure - smooth) / sigma, np.nan)
    sigma = sigma * state.excess(normalised, leverage)
    markers = {
        name: MarkerAngles(
            np.where(state.use[name], _wrap(c.angle - state.bias(name)), np.nan),
            np.where(
                state.use[name], np.hypot(state.sigma(name), np.where(state.turning, 0.0, floor)), np.nan
            ),
            state.mounts[name],
        )
        for name, c in candidates.items()
    }
    return BodyAngles(path + departure, sigma, count, markers)


class _Joint:
    """The markers' departures from the coarse path, and what is thought of them so far."""

    def __init__(self, path: Floats, candidates: dict[str, Candidate], fps: float) -> None:
        self.path = path
        self.turning = np.zeros(len(path), dtype=np.bool_)
        with np.errstate(invalid="ignore"):
            self.fast = np.abs(np.gradient(path)) * fps > FAST
        self.bend = path - _line(path)
        self.candidates = candidates
        self.mounts = {name: c.mount for name, c in candidates.items()}
        self.scatter = dict.fromkeys(candidates, (0.01, 0.03))
        self.used_up = dict.fromkeys(candidates, 0.0)
        self.by_place = {name: np.zeros(len(path)) for name in candidates}
        self.by_neighbour = {name: np.zeros(len(path)) for name in candidates}
        self.use = {n: c.good & np.isfinite(path) & np.isfinite(c.angle) for n, c in candidates.items()}

    def departure(self, name: str) -> Floats:
        return _wrap(self.candidates[name].angle - self.path - self.mounts[name] - self.bias(name))

    def bias(self, name: str) -> Floats:
        return self.by_place[name] + self.by_neighbour[name]

    def sigma(self, name: str) -> Floats:
        """Uncertainty of each sighting: the scatter of open or of partly hidden ones, times their weakness."""
        c = self.candidates[name]
        clear, partly = self.scatter[name]
        return np.asarray(np.where(c.open, clear, partly) * c.weak)

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
        """Fit a smooth curve to the body's angle; returns its departure from the path, and the leverages."""
        fitted, leverage = local_fit(self.bend + self.mean()[0], self.weight(), half, degree)
        return fitted - self.bend, leverage

    def weight(self) -> Floats:
        """Weights of the mean departures for a smooth curve through them, about 1 where they are usual."""
        sigma = self.mean()[1]
        known = np.isfinite(sigma)
        if not known.any():
            return np.zeros(len(sigma))
        return np.where(known, (np.median(sigma[known]) / np.where(known, sigma, 1.0)) ** 2, 0.0)

    def replace_mounts(self, smooth: Floats) -> None:
        """Measure the places of the markers anew; the mean of the fixed ones (or the first) stays as it is."""
        shift = {}
        for name in self.candidates:
            off = (self.departure(name) - smooth)[self.use[name]]
            off = off[np.isfinite(off)]
            shift[name] = float(np.median(off)) if len(off) else 0.0
        fixed = [name for name, c in self.candidates.items() if c.given] or [next(iter(self.candidates))]
        zero = float(np.mean([shift[name] for name in fixed]))
        for name, c in self.candidates.items():
            if not c.given:
                self.mounts[name] += shift[name] - zero

    def judge(self, smooth: Floats, leverage: Floats) -> None:
        """Measure each marker's scatter about the smooth motion, and drop what lies far off."""
        for name, c in self.candidates.items():
            off = self._standardised(name, smooth, leverage)
            clear = _scatter(off[self.use[name] & c.open], self.scatter[name][0])
            partly = max(_scatter(off[self.use[name] & ~c.open], 3.0 * clear), clear)
            self.scatter[name] = (clear, partly)
            limit = FAR * np.where(c.open, clear, min(partly, 5.0 * clear)) + 5e-4
            self.use[name] = self.use[name] & ~(np.abs(off) > limit)

    def measure_scatter(self, smooth: Floats, leverage: Floats) -> None:
        """Measure the scatter once more about a curve that is smooth over whole turns.

        Errors that repeat with the turn are no motion there, and count; what the learnt curves have taken up is given
        back. A scatter far above that about the short curve is a motion in earnest and is not believed.
        """
        for name, c in self.candidates.items():
            off = self._standardised(name, smooth, leverage)
            for k, part in enumerate((c.open, ~c.open)):
                some = self.use[name] & part & self.turning
                grown = np.sqrt(1.0 / max(1.0 - self.used_up[name] / max(float(some.sum()), 1.0), 0.25))
                short = self.scatter[name][k]
                wide = float(np.clip(grown * _scatter(off[some], short), short, 2.5 * short))
                self.scatter[name] = (
                    (wide, self.scatter[name][1]) if k == 0 else (self.scatter[name][0], wide)
                )

    def excess(self, normalised: Floats, leverage: Floats) -> float:
        """Return by how much the body's angles scatter more than their markers' uncertainties say."""
        used = min(sum(self.used_up.values()) / max(float(np.isfinite(normalised).sum()), 1.0), 0.75)
        scatter = _scatter(normalised / np.sqrt(np.clip(1.0 - leverage, 0.1, 1.0)), 1.0)
        return float(np.clip(scatter / np.sqrt(1.0 - used), 0.5, 3.0))

    def _standardised(self, name: str, smooth: Floats, leverage: Floats) -> Floats:
        share = np.clip(1.0 - leverage / max(len(self.candidates), 1), 0.1, 1.0)
        return np.asarray((self.departure(name) - smooth) / self.candidates[name].weak / np.sqrt(share))

    def note_turns(self, short: Floats, smooth: Floats, half: int) -> None:
        """Note where errors that repeat with the turn can be told from motion.

        There the long window holds a whole turn, and its curve follows the motion: a sudden start is in no curve.
        """
        usual = min(clear for clear, _ in self.scatter.values())
        with np.errstate(invalid="ignore"):
            self.turning = whole_turns(self.path, half) & (np.abs(smooth - short) < 12.0 * usual)

    def learn_places(self, smooth: Floats) -> None:
        """Learn each marker's error by its place in the picture (see `bias`)."""
        fast = self.turning & self.fast
        geometry_only = fast.sum() > 0.2 * self.turning.sum()
        when = fast if geometry_only else self.turning
        curves = {}
        for name, c in self.candidates.items():
            off = _wrap(c.angle - self.path - self.mounts[name] - self.by_neighbour[name]) - smooth
            fit = self.use[name] & c.open & when
            weight = np.where(fit, 1.0 / self.sigma(name) ** 2, 0.0)
            curves[name], self.used_up[name] = closed_curve(c.angle, off, weight)
        if not geometry_only:
            curves = without_common_motion(curves, self.mounts)
        for name, curve in curves.items():
            self.by_place[name] = curve_at(curve - curve.mean(), np.nan_to_num(self.candidates[name].angle))

    def learn_neighbours(self, smooth: Floats, other: Floats) -> None:
        """Learn each marker's error by its angle to the body that hides it (see `bias`)."""
        for name, c in self.candidates.items():
            off = _wrap(c.angle - self.path - self.mounts[name] - self.by_place[name]) - smooth
            near = self.use[name] & np.isfinite(other)
            weight = np.where(near & self.turning, 1.0 / self.sigma(name) ** 2, 0.0)
            curve, _ = closed_curve(np.nan_to_num(c.angle - other), off, weight)
            self.by_neighbour[name] = np.where(
                near & ~c.open, curve_at(curve, np.nan_to_num(c.angle - other)), 0.0
            )


def whole_turns(path: Floats, half: int) -> Mask:
    """Return where the window of `half` frames to both sides holds a whole turn, so that what repeats with it shows."""
    ahead, behind = np.roll(path, -half), np.roll(path, half)
    swept = np.abs(ahead - behind)
    swept[:half] = 2.0 * np.abs(ahead - path)[:half]
    swept[len(path) - half :] = 2.0 * np.abs(path - behind)[len(path) - half :]
    return np.asarray(np.nan_to_num(swept) > 2.0 * np.pi)


def _line(path: Floats) -> Floats:
    """Return the straight line through a path, to keep numbers small."""
    known = np.isfinite(path)
    if known.sum() < 2:
        return np.zeros(len(path))
    index = np.arange(len(path), dtype=np.float64)
    return np.asarray(np.polyval(np.polyfit(index[known], path[known], 1), index))


def _scatter(off: Floats, otherwise: float) -> float:
    return max(spread(off), 1e-5) if np.isfinite(off).sum() >= 8 else otherwise


def learning_window(path: Floats) -> tuple[int, int]:
    """Return half width and degree of the local polynomials against which repeating errors are learnt.

    A little more than a turn to each side, so that an error that repeats with the turn is not taken for motion.
    """
    step = np.abs(np.diff(path))
    step = step[np.isfinite(step)]
    typical = float(np.median(step)) if len(step) else 0.0
    half = int(np.clip(1.2 * 2.0 * np.pi / max(typical, 1e-3), HALF_WINDOW, 6 * HALF_WINDOW))
    return half, 2 if half < 2 * HALF_WINDOW else 3


def smooth_path(coarse: Floats) -> Floats:
    """Smooth a coarse path, so that departures from it are departures from an even motion.

    Local parabolas replace it wherever they stay within 0.3 rad of it, so that turns are kept.
    """
    known = np.isfinite(coarse)
    if known.sum() < 8:
        return coarse
    trend = _line(coarse)
    smooth, _ = local_fit(coarse - trend, known.astype(float), HALF_WINDOW)
    near = np.abs(smooth + trend - coarse) < 0.3
    return np.where(known, np.where(near, smooth + trend, coarse), np.nan)


def _wrap(angle: Floats) -> Floats:
    return np.asarray(np.angle(np.exp(1j * angle)))
