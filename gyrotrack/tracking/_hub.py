"""The path of the centre of rotation.

The noise of a compressed film is correlated between frames, so the best predictor of the next frame is not the true
path. Therefore the path of a disc is modelled as a slow curve plus significant spectral lines of the residuals (a
precession, or a wobble at the frequency of the casing). The slow curve consists of local parabolas, whose width is
chosen by cross-validation on points at least `HOLE` frames away.

An error n of the centre changes the radius of a marker by -n . r, with r the unit vector towards the marker. Video
encoders keep a slowly moving disc fixed in the picture. The image of the disc then does not show the motion of the
centre, but the radii of all markers over a few dozen frames do (`refine_centre`).

Without a disc, the position of a marker is c(t) + rho A (cos theta, sin theta) (see `_orbit`). Each observation
constrains c(t) along its radius; over half a turn both coordinates are determined. c(t) is piecewise linear with about
one knot per turn.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from gyrotrack._arrays import Bools, Complexes, Floats, Integers
from gyrotrack._column_store import WithBuffer, new_columns, row_blocks
from gyrotrack._native import _kernels as kernels
from gyrotrack._smoothing import local_fit, spread
from gyrotrack.tracking._polar import CHROMA_SHIFT
from gyrotrack.tracking._scene import Disc
from gyrotrack.video._container import Frame


class DiscWindow(WithBuffer):
    """A small chroma window about the disc, collected for a batch of frames."""

    _buffer = "_pixels"

    def __init__(self, disc: Disc, capacity: int) -> None:
        self.disc = disc
        self.half = int(np.ceil((1.5 * disc.radius + 6.0) / 2.0))
        side = 2 * self.half + 1
        self._pixels = np.zeros((capacity, 2, side, side), dtype=np.uint8)
        self._corner = (0, 0)

    def centre_on(self, centre: tuple[float, float], frame: Frame) -> None:
        """Move the window to a centre (luma px), inside the picture."""
        height, width = frame.u.shape
        side = 2 * self.half + 1
        x = int(np.clip(round((centre[0] - CHROMA_SHIFT[0]) / 2.0) - self.half, 0, max(width - side, 0)))
        y = int(np.clip(round((centre[1] - CHROMA_SHIFT[1]) / 2.0) - self.half, 0, max(height - side, 0)))
        self._corner = (x, y)

    def take(self, frames: list[Frame], place: int) -> None:
        """Store the windows of some frames in the batch from index `place` on."""
        self._used = True
        x, y = self._corner
        side = 2 * self.half + 1
        box = (slice(y, y + side), slice(x, x + side))
        height, width = frames[0].u[box].shape
        for frame, (u, v) in zip(frames, self._pixels[place:, :, :height, :width], strict=False):
            u[:] = frame.u[box]
            v[:] = frame.v[box]

    def centres(self, count: int, first: int = 0) -> Floats:
        """Measure the disc's centre in frames `first` to `count` - 1, (n, 2) in px; NaN where it is occluded."""
        u, v = self.disc.chroma
        norm = u * u + v * v
        place = kernels.discs(self._pixels[first:count], (u / norm, v / norm), self.disc.radius / 2.0)
        return np.asarray(2.0 * (place + self._corner) + np.array(CHROMA_SHIFT))


HOLE = 8
"""Correlation length of the errors of a compressed film [frames]. Chosen: a smaller value mistakes correlated errors
for a path, a larger one smooths a fast path."""
_HALVES = (24, 48, 96, 192)
"""Half widths that cross-validation compares for the local parabolas of a path [frames]. Chosen: factors of two;
shorter windows follow noise, longer windows smooth a precession."""
_SHORT_HALVES = (2, 6, 12, 0)
"""Half widths for a hub that moves fast, as in a hand-held film; 0 (no smoothing) if the camera shakes from frame to
frame [frames]. Chosen: about factors of two; see `marked_paths`."""
_ALTERNATIVES = 48
"""Smallest number of frames for which the radii of the markers select a path of `_SHORT_HALVES` [frames]. Chosen: with
fewer the selection is random, with more the path of the hub is smoothed in a short film."""
_PARTIAL_STEP = 6.0
"""Smallest step to or from a partly covered disc, relative to the typical step from frame to frame [1]. Chosen: a
smaller value discards good views, a larger one keeps displaced views."""
_LINE_POWER = 7.0
"""Smallest power of a line, relative to the floor of the spectrum [1]. Derived: the power of noise is exponentially
distributed and exceeds 7 with a probability of exp(-7) = 0.1 %."""
_PIECES = 64
"""Number of windows that are transformed together [1]. Chosen: a larger number needs memory, a smaller one costs
time."""
LEAST_SIGMA = 0.05
"""Lower limit of the uncertainty of the centre [px]. Chosen: encoders keep a slowly moving disc fixed in the picture; a
smaller value understates the resulting error."""


@dataclass(frozen=True)
class CentrePath:
    """The path of the centre.

    The arrays are the centre in each frame (n, 2) [px] and its uncertainty per axis (n,) [px]. `reach` is the half
    width of the smoothing [frames].
    """

    centre: Floats
    sigma: Floats
    reach: int


def smooth_path(measured: Floats) -> CentrePath:
    """Smooth a measured path, (n, 2) in px, NaN where it is unknown."""
    z, known = _without_gaps(measured)
    if not known.any():
        return CentrePath(measured, np.full(len(measured), np.nan), 0)
    weight: Floats = known.astype(np.float64)
    halves = [half for half in _HALVES if 3 * half <= len(z)]
    if not halves:
        return _steady(z, known)
    half = min(halves, key=lambda h: _prediction_error(z, weight, h))
    slow = _fitted(z, weight, half)
    path = slow + _lines(np.where(known, z - slow, 0.0))
    return _bridged(path, known, _path_sigma((z - path)[known], half), half)


def marked_paths(measured: Floats) -> list[CentrePath]:
    """Return the path of a disc by `smooth_path`, and paths that follow it over windows of a few frames.

    The errors of a compressed film are correlated, so the measured path alone does not determine which of these paths
    is right: a hand-held camera moves the disc as fast as the errors change. The radii of the markers select the path.
    """
    z, known = _without_gaps(measured)
    paths = [smooth_path(measured)]
    for half in _SHORT_HALVES if known.sum() >= _ALTERNATIVES else ():
        weight: Floats = known.astype(np.float64)
        if half == 0:  # the camera shakes from frame to frame
            paths.append(_bridged(z, known, EXPECTED_ERROR, 0))
            continue
        path = _fitted(z, weight, half)
        # a parabola over a short window absorbs a part of the noise, about 1 / (number of points in the window)
        sigma = _path_sigma((z - path)[known], half) / float(np.sqrt(1.0 - 1.0 / (1.1 * half)))
        paths.append(_bridged(path, known, sigma, half))
    return paths


FAST = 0.5
"""Motion of a hub from frame to frame that suggests camera shake, rms [px]. Chosen: five times `EXPECTED_ERROR`; a
smaller value warns of wobbling hubs, a larger one overlooks a hand-held camera."""


def moves_fast(disc: Floats) -> bool:
    """Return whether a disc (n, 2) [px], NaN where it is unknown, moves fast from frame to frame."""
    known = np.isfinite(disc).all(axis=1)
    return bool(known.sum() > 1 and robust_rms(np.diff(disc[known], axis=0)) > FAST)


def fast_motion(centre: CentrePath, measured: Floats) -> str | None:
    """Return a warning if the measured disc (n, 2) [px] moves fast and no background shows the camera's motion."""
    known = np.isfinite(measured).all(axis=1) & np.isfinite(centre.sigma)
    if known.sum() < 2:
        return None
    steps = robust_rms(np.diff(centre.centre[known], axis=0))
    if centre.reach in _SHORT_HALVES and steps > FAST:
        return (
            f"The disc of the hub moves by {steps:.2g} px rms from frame to frame, suggesting camera shake; it is "
            f"followed with an uncertainty of {np.median(centre.sigma[known]):.2g} px, which is part of the "
            "uncertainties of the angles."
        )
    rest = robust_rms((measured - centre.centre)[known])
    if rest > FAST:
        return (
            f"The disc of the hub is {rest:.2g} px rms away from its smoothed path. This suggests camera shake, which "
            "no background shows; the uncertainties of the angles include the shake."
        )
    return None


def robust_rms(steps: Floats) -> float:
    """Return the rms length of normally distributed vectors (n, 2) from the median of their squares."""
    return float(np.sqrt(np.median(np.sum(steps**2, axis=1)) / np.log(2.0)))


def _bridged(path: Complexes, known: Bools, sigma: float, half: int) -> CentrePath:
    """Return a path that is linear in the gaps and constant before the first and after the last known point.

    A parabola is not extrapolated, because its error would be many times the error of the points. The uncertainty in a
    gap includes the rms change of the path over the time to the nearest known point; beyond `half` frames it is NaN.
    """
    index = np.arange(len(path))
    place = index[known]
    after = np.minimum(np.searchsorted(place, index), len(place) - 1)
    away = np.minimum(np.abs(place[after] - index), np.abs(index - place[np.maximum(after - 1, 0)]))
    change = np.zeros(half + 1)
    for lag in range(1, min(half, int(away.max()), len(path) - 1) + 1):
        both = known[lag:] & known[:-lag]
        apart = path[lag:][both] - path[:-lag][both]
        change[lag] = np.sqrt(0.5 * np.mean(np.abs(apart) ** 2)) if len(apart) else change[lag - 1]
    centre = np.stack([np.interp(index, place, part[known]) for part in (path.real, path.imag)], axis=1)
    far = np.hypot(sigma, change[np.minimum(away, half)])
    return CentrePath(centre, np.where(away <= half, far, np.nan), half)


def _without_gaps(measured: Floats) -> tuple[Complexes, Bools]:
    """Return a path x + i y, linear in the gaps, and a mask of the known points."""
    known = _without_partial_views(measured, np.asarray(np.isfinite(measured).all(axis=1)))
    index = np.arange(len(measured))
    if not known.any():
        return np.full(len(measured), np.nan + 0j), known
    x, y = (np.interp(index, index[known], measured[known, k]) for k in (0, 1))
    return np.asarray(x + 1j * y), known


def _without_partial_views(measured: Floats, known: Bools) -> Bools:
    """Return the known points without displaced points next to a gap, where the disc is partly covered."""
    step = np.hypot(*np.diff(measured, axis=0).T)  # from each point to the next one
    if known.all() or not np.isfinite(step).any():
        return known
    limit = _PARTIAL_STEP * float(np.nanmedian(step)) + LEAST_SIGMA
    kept = known.copy()
    for _ in range(HOLE):
        with np.errstate(invalid="ignore"):
            opens = kept[:-1] & np.concatenate([[False], ~kept[:-2]]) & (step > limit)
            closes = kept[1:] & np.concatenate([~kept[2:], [False]]) & (step > limit)
        if not (opens.any() or closes.any()):
            break
        kept[:-1] &= ~opens
        kept[1:] &= ~closes
    return kept


def _steady(z: Complexes, known: Bools) -> CentrePath:
    """Return the mean as the path of a clip of a few frames."""
    mean = z[known].mean()
    scatter = float(np.sqrt(np.mean(np.abs(z[known] - mean) ** 2) / 2.0))
    centre = np.tile([mean.real, mean.imag], (len(z), 1))
    return CentrePath(centre, np.full(len(z), max(scatter, LEAST_SIGMA)), len(z))


def _fitted(z: Complexes, weight: Floats, half: int, hole: int = -1) -> Complexes:
    origin = z.mean()
    x, y = (local_fit(part, weight, half, 2, hole)[0] for part in ((z - origin).real, (z - origin).imag))
    fitted = origin + x + 1j * y
    return np.asarray(np.where(np.isfinite(fitted), fitted, z))


_TRIMMED = 0.95
"""Share of the errors that the mean includes, smallest first [1]. Chosen: a smaller value ignores fast parts of the
path, a larger one is dominated by outliers."""


def _prediction_error(z: Complexes, weight: Floats, half: int) -> float:
    """Return the trimmed mean square error of predicting points from points at least `HOLE` frames away."""
    error = np.abs(z - _fitted(z, weight, half, HOLE)) ** 2
    inner = slice(half // 2, len(z) - half // 2)
    core = np.sort(error[inner][weight[inner] > 0])
    return float(core[: max(int(_TRIMMED * len(core)), 1)].mean()) if len(core) else float("inf")


_FEWEST_OF_LINES = 96
"""Smallest number of frames for a spectrum with lines [frames]. Chosen: with fewer the floor is uncertain; with
more the precession of short films is smoothed."""


def _lines(rest: Complexes) -> Complexes:
    """Return the spectral lines of a series by short-time Fourier transform (Hann windows, half overlapping)."""
    n = len(rest)
    if n < _FEWEST_OF_LINES:
        return np.zeros(n, dtype=np.complex128)
    size = 64 if n < 1024 else 128
    hop = size // 2
    padded = np.pad(rest, (size, size + (-n) % hop))
    window = np.sqrt(np.hanning(size + 1)[:size])
    starts = range(0, len(padded) - size + 1, hop)
    inner = starts[2:-2] if len(starts) > 6 else starts
    total = np.zeros(size)
    for _, spectra in _spectra(padded, window, inner):
        for power in np.abs(spectra) ** 2:
            total += power
    floor = _floor(total / len(inner))
    out = np.zeros(len(padded), dtype=np.complex128)
    for some, spectra in _spectra(padded, window, starts):
        power = np.abs(spectra) ** 2
        kept = spectra * np.where(power > _LINE_POWER * floor, 1.0 - floor / np.maximum(power, 1e-12), 0.0)
        for start, piece in zip(some, np.fft.ifft(kept, axis=1) * window, strict=True):
            out[start : start + size] += piece
    return out[size : size + n]


def _spectra(series: Complexes, window: Floats, starts: range) -> Iterator[tuple[range, Complexes]]:
    """Yield the spectra of the pieces that begin at `starts`, (m, size), in groups."""
    for k in range(0, len(starts), _PIECES):
        some = starts[k : k + _PIECES]
        yield some, np.fft.fft(np.stack([series[s : s + len(window)] * window for s in some]), axis=1)


def _floor(power: Floats) -> Floats:
    """Return the noise floor of a spectrum: a running median, scaled to the mean of exponential noise."""
    reach = 8
    wrapped = np.concatenate([power[-reach:], power, power[:reach]])
    around = np.stack([wrapped[k : k + len(power)] for k in range(2 * reach + 1)])
    return np.asarray(np.median(around, axis=0) / np.log(2.0) + 1e-9)


_MOST_LAGS = 48
"""Largest lag of the correlation of the residuals [frames]. Chosen: a larger value adds noise to the sum, a smaller one
cuts slow correlations."""
_CORRELATED = 0.1
"""Smallest correlation that the sum includes [1]. Chosen: a smaller value sums noise, a larger one understates the
uncertainty."""


def _path_sigma(left: Complexes, half: int) -> float:
    """Return the standard uncertainty of the smoothed path: rms residual, reduced by averaging correlated noise."""
    rms = float(np.sqrt(np.mean(np.abs(left) ** 2) / 2.0))
    lags = min(_MOST_LAGS, len(left) // 4)
    base = float(np.mean(np.abs(left) ** 2)) + 1e-12
    chain = [float(np.mean((left[k:] * left[: len(left) - k].conj()).real)) / base for k in range(1, lags)]
    length = 1.0 + 2.0 * sum(c for c in chain if c > _CORRELATED)
    return max(rms * float(np.sqrt(min(length / (1.1 * half), 1.0))), LEAST_SIGMA)


_TURNS_PER_KNOT = 1.0
"""Distance of the knots of a path without a disc [turns]. Derived: half a turn determines both coordinates of the
centre; one turn has a reserve."""
_MOST_KNOTS = 400
"""Largest number of knots [1]. Chosen: a larger number costs time, a smaller one smooths the path of a long film."""
_RIDGE = 1e-9
"""Ridge of the normal equations [1]. Derived: above rounding errors; the ridge prevents changes of undetermined
knots."""


_FEWEST_PLACES = 12
"""Smallest number of places of markers that determine the path of a centre [1]. Chosen: a smaller number fits
noise, a larger one refuses short films."""


def wandering_centre(
    place: Floats, weight: Bools, start: Floats, *, still: bool = False, rounds: int = 12
) -> CentrePath:
    """Find the path of the centre of an orbit from the `place` (n, 2) [px] of the marker and an initial value.

    The model |place - c(t)| = rho (1 + p cos 2 theta + q sin 2 theta), with the path c(t) through knots, is fitted by
    the Gauss-Newton method; for given theta it is linear in the knots, rho, p and q. Outliers beyond 4 median absolute
    deviations are excluded. `weight` (n,) is a mask of trusted observations; `still` states that the centre is at rest.
    The flattening is free here so that it does not bias the path; `fit_flattening` fits it again, with the tilt.
    """
    n = len(place)
    path = np.tile(np.asarray(start, dtype=np.float64), (n, 1))
    use = weight & np.isfinite(place).all(axis=1)
    if use.sum() < _FEWEST_PLACES:
        return CentrePath(path, np.full(n, np.nan), 0)
    knots = 1 if still else _knots(place - path, use)
    error = float("nan")
    for _ in range(rounds):
        solution, error = _robust(place, path, use, knots)
        for part, ends, share in _spans(n, knots):
            path[part] += _between(solution[: 2 * knots].reshape(knots, 2), ends, share)
    # The scatter of the radius is an upper limit of the error of the centre, whose tangential component changes the
    # angle.
    return CentrePath(path, np.full(n, max(error, 1e-3)), n // max(knots - 1, 1))


def _knots(v: Floats, use: Bools) -> int:
    """Return the number of knots for a spacing of about one turn; 1 if this number is less than three."""
    theta = np.unwrap(np.arctan2(-v[use, 1], v[use, 0]))
    turns = float(np.abs(np.diff(theta)).sum()) / (2.0 * np.pi)
    knots = int(np.clip(turns / _TURNS_PER_KNOT, 1, _MOST_KNOTS))
    return knots if knots >= 3 else 1


def _spans(n: int, knots: int) -> Iterator[tuple[slice, tuple[int, int], Floats]]:
    """Yield the frames between neighbouring knots: slice, the two knots, and the weight of the second knot."""
    if knots == 1:
        for part in row_blocks(n):
            yield part, (0, 0), np.zeros(part.stop - part.start)
        return
    begins = np.ceil(np.linspace(0, n - 1, knots)).astype(np.int64)
    begins[-1] = n
    for k, (begin, end) in enumerate(itertools.pairwise(begins.tolist())):
        place = np.arange(begin, end) * ((knots - 1) / (n - 1))
        yield slice(begin, end), (k, k + 1), np.clip(place - k, 0.0, 1.0)


def _between(values: Floats, ends: tuple[int, int], share: Floats) -> Floats:
    """Interpolate linearly between two knots, (m, 2)."""
    low, high = (values[end] for end in ends)
    return np.asarray((1.0 - share)[:, None] * low + share[:, None] * high)


def _robust(place: Floats, path: Floats, use: Bools, knots: int) -> tuple[Floats, float]:
    """Fit knots (x and y alternating), rho, p and q without outliers; return them and the scatter."""
    away = np.full(len(place), np.nan)
    away[use] = np.hypot(*(place[use] - path[use]).T)
    typical = float(np.median(away[use]))
    keep, scatter = use, 1.0
    for _ in range(4):
        normal, right = np.zeros((2 * knots + 3,) * 2), np.zeros(2 * knots + 3)
        for part, at, rows in _rows(place, path, knots, typical):
            kept = rows[keep[part]]
            normal[np.ix_(at, at)] += kept.T @ kept
            right[at] += kept.T @ (away[part] - typical)[keep[part]]
        normal += _RIDGE * np.eye(len(right))  # undetermined knots do not change
        size = np.sqrt(normal.diagonal())
        solution = np.linalg.solve(normal / np.outer(size, size), right / size) / size
        left = away - typical
        for part, at, rows in _rows(place, path, knots, typical):
            left[part] -= rows @ solution[at]
        scatter = float(1.4826 * np.median(np.abs(left[keep]))) + 1e-9
        with np.errstate(invalid="ignore"):
            keep = use & (np.abs(left) < 4.0 * scatter)
    return np.asarray(solution, dtype=np.float64), scatter


def _rows(
    place: Floats, path: Floats, knots: int, typical: float
) -> Iterator[tuple[slice, Integers, Floats]]:
    """Yield the linear model of each span: its frames, its unknowns, and the rows (m, unknowns)."""
    for part, ends, share in _spans(len(place), knots):
        v = place[part] - path[part]
        theta = np.arctan2(-v[:, 1], v[:, 0])
        shape = [np.ones(len(theta)), typical * np.cos(2 * theta), typical * np.sin(2 * theta)]
        c, s = np.cos(theta), -np.sin(theta)
        bent = [2 * knots, 2 * knots + 1, 2 * knots + 2]
        if knots == 1:
            yield part, np.array([0, 1, *bent]), np.stack([c, s, *shape], axis=1)
        else:
            two = [w * d for w in (1.0 - share, share) for d in (c, s)]
            at = np.array([2 * ends[0], 2 * ends[0] + 1, 2 * ends[1], 2 * ends[1] + 1, *bent])
            yield part, at, np.stack([*two, *shape], axis=1)


_REFINED_HALF = 18
"""Half width of the window in which the error of the centre is assumed to be constant [frames]. Chosen: a few dozen
frames determine this error; a smaller value is noisy, a larger one smooths a wobble."""
EXPECTED_ERROR = 0.1
"""Standard deviation of the prior of the error of the centre [px]. Measured: 0.09 to 0.10 px per axis for the centre of
a red disc in rendered clips (H.264, crf 20)."""


@dataclass(frozen=True)
class Radii:
    """One marker: its apparent angle in each frame, (n,) [rad], and the residual of its radius [px], NaN if unused."""

    direction: Floats
    excess: Floats


_FEWEST_RADII = 20
"""Smallest number of radii of a marker that determine their scatter [1]. Chosen: a smaller number gives an uncertain
scatter, a larger one ignores markers in short films."""
LEAST_RADIUS_SCATTER = 0.02
"""Lower limit of the scatter of the radii of a marker [px]. Chosen: a smaller value gives drawn films too much weight,
a larger one ignores precise radii."""


def refine_centre(path: CentrePath, markers: Iterable[Radii]) -> CentrePath:
    """Correct the path of a centre by the radii of markers about it.

    In a window about each frame, the error n of the centre minimises sum w (excess + n . r)^2 / s^2 + |n|^2 /
    `EXPECTED_ERROR`^2, where r is the unit vector towards a marker. The residual and the scatter of the marker's radius
    are excess and s, and w is a parabolic weight over the window. The uncertainty is the standard uncertainty of n in
    this fit.
    """
    count = len(path.centre)
    normal, right = np.zeros((3, count)), np.zeros((2, count))
    for wanted in markers:
        known = np.isfinite(wanted.excess) & np.isfinite(wanted.direction)
        if known.sum() < _FEWEST_RADII:
            continue
        scatter, limits = (
            max(spread(wanted.excess[known]), LEAST_RADIUS_SCATTER),
            _limits(wanted.excess[known]),
        )
        for part in row_blocks(count):
            weight = known[part] / scatter**2
            angle = np.where(known[part], wanted.direction[part], 0.0)
            x, y = np.cos(angle), -np.sin(angle)
            excess = np.clip(np.where(known[part], wanted.excess[part], 0.0), *limits)
            normal[:, part] += weight * np.stack([x * x, x * y, y * y])
            right[:, part] -= weight * excess * np.stack([x, y])
    bell = 1.0 - (np.arange(-_REFINED_HALF, _REFINED_HALF + 1) / (_REFINED_HALF + 1)) ** 2
    for row in (*normal, *right):
        row[:] = np.convolve(np.pad(row, _REFINED_HALF), bell, mode="valid")
    better = new_columns(count, {"centre": ((2,), "f8"), "sigma": ((), "f8")})
    for part in row_blocks(count):
        (a, b, c), (u, v) = normal[:, part], right[:, part]
        a, c = a + 1.0 / EXPECTED_ERROR**2, c + 1.0 / EXPECTED_ERROR**2
        determinant = a * c - b * b
        error = np.stack([(c * u - b * v) / determinant, (a * v - b * u) / determinant], axis=1)
        sigma, before = np.sqrt(0.5 * (a + c) / determinant), path.sigma[part]
        better["centre"][part] = path.centre[part] - error
        better["sigma"][part] = np.where(
            np.isfinite(before), np.minimum(np.hypot(sigma, 0.4 * LEAST_SIGMA), before), np.nan
        )
    return CentrePath(reach=path.reach, **better)


def _limits(excess: Floats) -> tuple[float, float]:
    reach = 4.0 * spread(excess)
    return -reach, reach
