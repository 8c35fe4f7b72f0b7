"""One marker, measured in batches of frames: its tangential profile is matched with the mean of recent profiles.

The model of a profile is p(x) = a T(x - d) + b. The gain a, the offset b and the displacement d are fitted in every
frame to the samples that are not occluded. The gain is also called the height of the marker. T is the mean of the
profiles of the frames, each shifted to zero displacement, and is made symmetric: T(x) = T(-x). A marker with parallel
sides that moves uniformly during the exposure has a smeared profile that is symmetric about the middle of the marker at
mid-exposure. Therefore d is the angle of the middle of the marker at the middle of the exposure, for any width of the
smear.

Glare, shadows and encoder blocks increase the misfit of a profile and displace it. The relation between misfit and
displacement depends on the film and is estimated from the scatter of the marker. The variance of an observation is s^2
(1 + share x), where x is its squared misfit, divided by the squared misfit of a typical observation, minus 1. `share`
is estimated by maximum likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Bools, Floats, Integers
from gyrotrack._column_store import in_file, row_blocks
from gyrotrack._native import _kernels as kernels
from gyrotrack._smoothing import median_of
from gyrotrack.tracking._corners import near_corners
from gyrotrack.tracking._marker_window import (
    AngleMap,
    MarkerStrip,
    MarkerWindow,
    even_light,
    shaded_columns,
)
from gyrotrack.tracking._scene import Marker


class FrameColumns:
    """A record whose fields are arrays with one row per frame."""

    def spread_out(self, index: Integers, count: int) -> Self:
        """Place the frames at `index` of `count` frames; see the function `spread_out`."""
        return type(self)(**in_file({k: spread_out(v, index, count) for k, v in vars(self).items()}))

    def picked(self, index: Integers) -> Self:
        """Return the frames `index`."""
        return type(self)(**in_file({k: v[index] for k, v in vars(self).items()}))


@dataclass(frozen=True)
class MarkerObservations(FrameColumns):
    """Observations of one marker in consecutive frames, about the centre of the ring; NaN where the body is lost."""

    # shape (n,); fine angle as seen [rad], radius of the middle of the marker [px]
    angle: Floats
    radius: Floats
    # shape (n, 2); polar coordinates of the near corners about the ring's centre
    corner_angle: Floats
    corner_radius: Floats
    # shape (n,); height relative to the typical height, and rms residual from the template relative to the gain
    gain: Floats
    misfit: Floats
    weakness: Floats  # shape (n,); factor on the uncertainty for occlusion and low gain; see `Match`
    open: Bools  # shape (n,); no part of the marker is known to be occluded
    centre: Floats  # shape (n, 2); centre of the ring in px

    def at(self, part: slice) -> MarkerObservations:
        """Return some of the frames."""
        return MarkerObservations(**{name: values[part] for name, values in vars(self).items()})

    def outside(self, inner: float, outer: float, half_width: float, size: tuple[int, int]) -> Bools:
        """Return a mask of the frames in which a part of the marker is outside a picture of (width, height) px."""
        found = np.zeros(len(self.angle), dtype=np.bool_)
        for part in row_blocks(len(found)):
            for radius in (inner, outer):
                for side in (-half_width, half_width):
                    x = self.centre[part, 0] + radius * np.cos(self.angle[part] + side)
                    y = self.centre[part, 1] - radius * np.sin(self.angle[part] + side)
                    with np.errstate(invalid="ignore"):
                        found[part] |= (x < 0) | (y < 0) | (x > size[0] - 1) | (y > size[1] - 1)
        return found

    def position(self, good: Bools) -> Floats:
        """Return the position of the middle of the marker, (n, 2) [px], at the median radius in frames not `good`."""
        usual = float(np.nanmedian(self.radius[good])) if good.any() else np.nan
        r = np.where(good, self.radius, usual)
        place = np.empty(self.centre.shape)
        place[:, 0] = self.centre[:, 0] + r * np.cos(self.angle)
        place[:, 1] = self.centre[:, 1] - r * np.sin(self.angle)
        return place


def spread_out(values: npt.NDArray[Any], index: Integers, count: int) -> npt.NDArray[Any]:
    """Place rows at `index` of `count` rows; the other rows are NaN, 0 or False."""
    nothing = np.nan if values.dtype.kind == "f" else 0
    out = np.full((count, *values.shape[1:]), nothing, dtype=values.dtype)
    out[index] = values
    return out


LARGEST = 24.0
"""Upper limit of the excess of a squared misfit [1]. Derived: a misfit of 5 times the typical misfit, 5^2 - 1."""
FEWEST = 30
"""Smallest number of frames for a scatter [frames]. Chosen: the scatter of 30 frames is known within 13 %; with a
smaller number, the share estimated by `variance_inflation` is random."""
_SHARES = np.concatenate([[0.0], np.geomspace(0.01, 1.0, 21)])
"""Grid of shares of the excess misfit in the variance [1]. Chosen: steps of 26 %; finer steps do not change the
uncertainty by more than a few percent."""
_FAULT = 5.0
"""Largest residual of a valid angle, in standard deviations [1]. Chosen: a smaller value discards good angles; with a
larger one, false angles raise the share of `variance_inflation`."""


def excess_misfit(misfit: Floats, usual: float) -> Floats:
    """Return the relative excess of squared misfits over the typical squared misfit, (n,), at least 0."""
    ratio = np.nan_to_num(misfit, nan=0.0) / max(usual, 1e-9)
    return np.asarray(np.clip(ratio**2 - 1.0, 0.0, LARGEST))


def variance_inflation(off: Floats, excess: Floats) -> float:
    """Return the maximum-likelihood share (0 to 1) of the excess misfit for normal residuals, clipped at 5 sigma."""
    known = np.isfinite(off)
    if known.sum() < FEWEST:
        return 0.0
    clip = _FAULT**2 / 0.4549
    unlikely = kernels.likelihood(off[known] ** 2, excess[known], _SHARES, clip)
    return float(_SHARES[int(np.argmin(unlikely))])


LARGEST_MISFIT = 0.12
"""Largest misfit of a profile, relative to its height, that illumination alone can cause [1]. Chosen: occlusion of a
tenth of a marker causes a larger misfit; a larger value accepts this occlusion, a smaller one rejects glare."""
WEAKEST = 4.0
"""Largest factor on the uncertainty of a partly occluded marker that is used [1]. Chosen: 1/16 of the information; a
larger value admits the errors of an edge, a smaller one discards angles."""


@dataclass(frozen=True)
class Candidate:
    """Fine angles of one marker before the fusion."""

    angle: Floats  # as seen, wrapped [rad]
    good: Bools  # frames in which height and profile are plausible
    open: Bools  # frames in which no part of the marker is occluded
    weak: Floats  # factor on the uncertainty for occlusion and low gain
    misfit_excess: Floats  # excess of the misfit of the profile; see `variance_inflation`
    mount: float  # initial value of the mount angle, as seen [rad]


_LOWEST = 0.5
"""Smallest plausible height of a marker, divided by its median height [1]. Chosen: a smaller value keeps half-covered
markers, a larger one omits shaded markers."""
_HIGHEST = 2.0
"""Largest plausible height of a marker, divided by its median height [1]. Chosen: a larger value keeps glare, a smaller
one omits markers in bright light."""
_POOR = 6.0
"""Largest misfit of a plausible profile, in robust standard deviations above the typical misfit [1]. Chosen: a smaller
value omits good angles, a larger one keeps disturbed angles."""


def plausible(seen: MarkerObservations) -> Bools:
    """Return the frames in which a marker has a plausible height and profile."""
    known = np.isfinite(seen.gain) & (seen.weakness < WEAKEST * _usual(seen, seen.weakness))
    whole = known & seen.open
    if not whole.any():
        return whole
    height = float(np.median(seen.gain[whole]))
    known &= (seen.gain > _LOWEST * height) & (seen.gain < _HIGHEST * height)
    typical = float(np.median(seen.misfit[whole]))
    scatter = 1.4826 * float(np.median(np.abs(seen.misfit[whole] - typical)))
    return np.asarray(known & (seen.misfit < max(typical + _POOR * scatter, LARGEST_MISFIT)))


def candidate(seen: MarkerObservations, angle: Floats, good: Bools, mount: float) -> Candidate:
    """Return a candidate from observations and the corrected angle."""
    columns = {
        "angle": angle,
        "good": good,
        "weak": seen.weakness / _usual(seen, seen.weakness),
        "misfit_excess": excess_misfit(seen.misfit, _usual(seen, seen.misfit)),
    }
    return Candidate(open=seen.open, mount=mount, **in_file(columns))


def _usual(seen: MarkerObservations, values: Floats) -> float:
    whole = seen.open & np.isfinite(values)
    return float(np.median(values[whole])) if whole.any() else 1.0


ROUNDS = 8
"""Number of iterations of a match [iterations]. Chosen: Gauss-Newton steps converge in fewer iterations; a larger
number costs time."""
FINENESS = 8
"""Tabulated displacements of the template per sample [1]. Chosen: linear interpolation between 1/8 of a sample; a
smaller number biases the angle, a larger one takes memory."""


@dataclass(frozen=True)
class Match:
    """A batch of matched profiles."""

    shift: Floats  # displacement d in samples
    gain: Floats  # a and b, in units of the profiles
    offset: Floats
    misfit: Floats  # rms residual in the open samples, relative to the gain
    # uncertainty of d relative to the uncertainty with all samples open and a gain of 1 (curvature of the fit); inf
    # where d is not determined
    weakness: Floats


def match(profile: Floats, template: Floats, start: Floats, seen: Bools) -> Match:
    """Fit gain, offset and displacement [samples] of a template to the samples `seen` of profiles (n, m)."""
    slope = np.empty_like(template)
    slope[1:-1] = 0.5 * (template[2:] - template[:-2])
    slope[[0, -1]] = template[1] - template[0], template[-1] - template[-2]
    limit, stride = 0.3 * len(template), 0.08 * len(template)
    shift = np.clip(np.asarray(start, dtype=np.float64), -limit, limit)
    pad = int(np.ceil(limit)) + 2
    curve, lean = (_with_ends(line[None], pad)[0] for line in (template, slope))
    found = kernels.match(profile, curve, lean, shift, seen, pad, limit, stride, ROUNDS, FINENESS)
    shift, gain, offset, left, spread = found.T.copy()
    misfit = np.sqrt(np.maximum(left, 0.0) / np.maximum(seen.sum(axis=1), 1)) / np.maximum(np.abs(gain), 1e-3)
    open_ = np.stack([template, np.ones_like(template), slope])
    normal = open_ @ open_.T
    best = float(np.linalg.inv(normal + 1e-9 * (1.0 + np.trace(normal)) * np.eye(3))[2, 2])
    ratio = np.sqrt(np.maximum(spread, 0.0) / best) / np.maximum(np.abs(gain), 1e-3)
    return Match(shift, gain, offset, misfit, np.where(np.isfinite(ratio), ratio, np.inf))


def displaced(curve: Floats, shift: Floats) -> Floats:
    """Return curve(x - shift) for every shift, (n, m); the ends are repeated."""
    m = len(curve)
    place = np.arange(m)[None, :] - shift[:, None]
    return np.asarray(np.interp(place.ravel(), np.arange(m), curve).reshape(place.shape))


def shifted(profile: Floats, shift: Floats) -> Floats:
    """Return profile(x + shift) for each row by cubic (Catmull-Rom) interpolation; the ends are repeated."""
    count = profile.shape[-1]
    whole = np.floor(shift)
    t = (shift - whole)[:, None]
    reach = int(np.abs(whole).max(initial=0.0)) + 2
    padded = _with_ends(profile, reach)
    index = np.arange(len(padded)) * padded.shape[1] + whole.astype(np.int64) + reach
    flat, place = padded.ravel(), index[:, None] + np.arange(count)
    weights = (
        0.5 * t * (t * (2.0 - t) - 1.0),
        0.5 * (t * t * (3.0 * t - 5.0) + 2.0),
        0.5 * t * (t * (4.0 - 3.0 * t) + 1.0),
        0.5 * t * t * (t - 1.0),
    )
    out = np.zeros(place.shape)
    for k, weight in enumerate(weights):
        out += weight * flat.take(place + (k - 1))
    return out


def _with_ends(rows: Floats, reach: int) -> Floats:
    """Extend each row by `reach` copies of its first and last value."""
    return np.concatenate([rows[:, :1].repeat(reach, 1), rows, rows[:, -1:].repeat(reach, 1)], axis=1)


def mean_profile(profile: Floats, found: Match, use: Bools, seen: Bools, *, symmetric: bool) -> Floats | None:
    """Average the unoccluded samples of the frames in `use`, scaled to 0 to 1 (NaN: no sample); None for few frames."""
    if use.sum() < 3:
        return None
    aligned = shifted(profile[use], found.shift[use])
    whole = seen[use]
    if not whole.all():
        whole = shifted(whole.astype(np.float64), found.shift[use]) > 0.99
    scaled = (aligned - found.offset[use, None]) / found.gain[use, None]
    template = _clipped_mean(scaled, whole)
    if symmetric:
        template = 0.5 * (template + template[::-1])
    foot = float(0.5 * (template[0] + template[-1])) if symmetric else float(template.min())
    top = float(template.max())
    return np.asarray((template - foot) / (top - foot)) if top - foot > 1e-3 else None


_CLIPPED = 2.5
"""Largest deviation of a sample that enters the mean profile, in standard deviations [1]. Chosen: a smaller value
narrows the distribution, a larger one admits hands and glare."""


def _clipped_mean(values: Floats, seen: Bools) -> Floats:
    """Return the mean of each column over its seen values without outliers; NaN if there are none."""
    for _ in range(2):
        count = seen.sum(axis=0)
        safe = np.maximum(count, 1)
        mean = np.where(seen, values, 0.0).sum(axis=0) / safe
        off = np.where(seen, values - mean, 0.0)
        seen = seen & (np.abs(off) <= _CLIPPED * np.sqrt((off**2).sum(axis=0) / safe) + 1e-9)
    count = seen.sum(axis=0)
    mean = np.where(seen, values, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, mean, np.nan)


def flat_top(half_width: float, length: int) -> Floats:
    """Return an initial template: 1 within `half_width` samples of the middle, falling to 0 over three samples."""
    x = np.abs(np.arange(length) - (length - 1) / 2.0)
    return np.asarray(np.clip((half_width + 1.5 - x) / 3.0, 0.0, 1.0))


MOST_SHAPES = 96
"""Largest number of frames of a batch from which the template is learnt [frames]. Chosen: a larger number costs time, a
smaller one gives a noisier template."""


_OFF_MIDDLE = 0.25
"""Largest distance of the middle of the corners from the fine angle, in half widths [1]. Chosen: a smaller value omits
corners of blurred markers, a larger one keeps corners of other edges."""
_OFF_MIDDLE_BY = 0.01
"""Constant part of the largest distance of the middle of the corners from the fine angle; `_OFF_MIDDLE` half widths are
added to it [rad]. Chosen: for narrow markers; a smaller value omits their corners, a larger one keeps corners of other
edges."""
_OTHER_WIDTH = 0.3
"""Largest relative difference of the half width of the corners from the typical half width [1]. Chosen: a smaller value
omits corners of blurred markers, a larger one keeps corners of other edges."""
_OFF_EDGE = 0.35
"""Largest distance of the corners from the near edge, in lengths of the marker [1]. Chosen: a smaller value omits
corners of an oblique view, a larger one keeps corners of other edges."""
_OFF_EDGE_BY = 2.0
"""Constant part of the largest distance of the corners from the near edge; `_OFF_EDGE` lengths of the marker are added
to it [px]. Chosen: one sample of the chroma; a smaller value omits corners of short markers, a larger one keeps corners
of other edges."""


class MarkerTracker:
    """The templates of a marker and the illumination of its ring, updated from batch to batch."""

    def __init__(self, marker: Marker, strip: MarkerStrip) -> None:
        self.marker = marker
        self.strip = strip
        self._across: Floats | None = None
        self._along: Floats | None = None
        self.light = AngleMap(1, strip.ring.columns, strip.ground if strip.white else None)

    def window(self, coarse: Floats) -> MarkerWindow:
        """Return the windows about the coarse angles (rad, NaN: lost) in the buffer."""
        return MarkerWindow(self.strip, coarse)

    def expected(self, window: MarkerWindow) -> Floats:
        """Return the tangential profile at the expected angle of the marker, (n, m)."""
        return displaced(self.template(window.raw.shape[1]), window.fraction)

    def measure(self, window: MarkerWindow, open_: Bools, clear: Bools | None = None) -> MarkerObservations:
        """Measure the marker; `open_` (n, columns of the window) marks the samples that nothing occludes.

        A shadow reduces the chroma of a coloured marker as a whole. Next to a white marker, a shadow darkens the
        metal, which distorts the edge of the profile. If a white marker is unoccluded, only samples `clear` of shadows
        are used.
        """
        dark = shaded_columns(self.light)
        if dark.any():
            open_ = open_ & (window.here(dark) == 0)
        whole = (open_ | ~self._matters(window)).all(axis=1) & window.known
        if clear is not None:
            open_ = open_ & (clear | ~whole[:, None])
        found = self._without_neighbours(window, self._matched_across(window, open_, whole), open_)
        along = self._matched_along(window, found, whole)
        radius, angle = self._corners(window, found, whole)
        ring = self.strip.ring
        hide = np.where(window.known, 0.0, np.nan)
        spacing = float(ring.radii[1] - ring.radii[0])
        return MarkerObservations(
            angle=(window.start + found.shift) * ring.step + hide,
            radius=self.marker.radius + along.shift * spacing + np.where(whole, 0.0, np.nan),
            corner_angle=angle + (window.start * ring.step)[:, None],
            corner_radius=radius,
            gain=found.gain + hide,
            misfit=found.misfit + hide,
            weakness=found.weakness + hide,
            open=whole,
            centre=np.tile(np.array(ring.centre), (len(hide), 1)),
        )

    def _matters(self, window: MarkerWindow) -> Bools:
        """Return the samples of the windows within the extent of the marker, (n, m)."""
        step, half = self.strip.ring.step, self.strip.half
        x = np.abs(np.arange(-half, half + 1)) * step
        reach = 1.15 * self.marker.half_width + 2.0 * step
        if self._across is not None:
            reach = float(x[self._across > 0.12].max(initial=self.marker.half_width)) + step
        place = np.arange(-half, half + 1)[None, :] - window.fraction[:, None]
        return np.asarray(np.abs(place) * step <= reach)

    def template(self, count: int) -> Floats:
        """Return the tangential template on the samples of the window."""
        if self._across is None:
            return flat_top(self.marker.half_width / self.strip.ring.step, count)
        return self._across

    def _matched_across(self, window: MarkerWindow, open_: Bools, whole: Bools) -> Match:
        rounds = 3 if self._across is None else 1
        reach = max(round(self.marker.half_width / self.strip.ring.step), 1)
        template = self.template(window.profile.shape[1])
        if self._across is not None:
            window.apply_light(even_light(self.light, reach))
        found = match(window.profile, template, window.fraction, open_)
        for _ in range(rounds):
            good = _good(found, whole, window.known)
            few = _some(good, MOST_SHAPES)
            better = mean_profile(window.profile, found, few, open_, symmetric=True)
            if better is not None and np.isfinite(better).all():
                self._across = better if self._across is None or rounds > 1 else 0.5 * (self._across + better)
            if good.any():
                self._learn_light(
                    window, displaced(template, found.shift), found.offset, open_ & good[:, None]
                )
                window.apply_light(even_light(self.light, reach))
            template = self.template(window.profile.shape[1])
            found = match(window.profile, template, found.shift, open_)
        return found

    def _without_neighbours(self, window: MarkerWindow, found: Match, open_: Bools) -> Match:
        """Match profiles with an implausible misfit again, without the disturbing samples beside the marker.

        The markers of the rotor pass below the markers of the casing and do not change their profiles. An object beside
        a marker of the rotor, for example the bar of the casing, may cover a part of this marker.
        """
        poor = window.known & (found.misfit > LARGEST_MISFIT)
        if self.marker.body != "casing" or not poor.any():
            return found
        profile, beside = window.profile[poor], ~self._matters(window)[poor]
        template = self.template(profile.shape[1])
        own = Match(**{f.name: getattr(found, f.name)[poor] for f in fields(Match)})
        for _ in range(2):
            expected = own.gain[:, None] * displaced(template, own.shift) + own.offset[:, None]
            differs = np.abs(profile - expected) > 2.0 * LARGEST_MISFIT * np.abs(own.gain[:, None])
            own = match(profile, template, own.shift, open_[poor] & ~(beside & differs))
        for f in fields(Match):
            getattr(found, f.name)[poor] = getattr(own, f.name)
        return found

    def _learn_light(self, window: MarkerWindow, expected: Floats, offset: Floats, use: Bools) -> None:
        expected = np.where((expected > 0.4) & use, expected, 0.0)
        column = window.column(self.strip.ring.columns)
        self.light.learn(0, column, expected, window.raw - offset[:, None])

    def _matched_along(self, window: MarkerWindow, found: Match, whole: Bools) -> Match:
        columns = np.arange(window.scores.shape[2]) - self.strip.half
        reach = max(0.5 * self.marker.half_width / self.strip.ring.step, 1.0)
        weight = np.clip(reach + 0.5 - np.abs(columns[None, :] - found.shift[:, None]), 0.0, 1.0)
        profile = window.along(weight / weight.sum(axis=1)[:, None])
        nothing, everything = np.zeros(len(profile)), np.ones(profile.shape, dtype=np.bool_)
        if self._along is not None:
            return match(profile, self._along, nothing, everything)
        radii = self.strip.ring.radii
        spacing = float(radii[1] - radii[0])
        template = flat_top(0.5 * (self.marker.outer - self.marker.inner) / spacing, len(radii))
        template = np.interp(radii - self.marker.radius + float(radii.mean()), radii, template)
        along = match(profile, template, nothing, everything)
        for _ in range(2):
            better = mean_profile(profile, along, _good(along, whole, whole), everything, symmetric=False)
            if better is None or not np.isfinite(better).all():
                break
            self._along = better
            along = match(profile, better, along.shift, everything)
        return along

    def _corners(self, window: MarkerWindow, found: Match, whole: Bools) -> tuple[Floats, Floats]:
        ring = self.strip.ring
        radius, angle = np.full((2, len(whole), 2), np.nan)
        use = whole & (found.gain > 0.1)
        if use.any():
            shaped = window.shaped(use, found.gain[use], found.offset[use])
            angles: Floats = np.arange(-self.strip.half, self.strip.half + 1.0) * ring.step
            r, phi = near_corners(shaped, ring.radii, angles, self.marker.inner, self.marker.outer)
            likely = self._likely(r, phi, found.shift[use] * ring.step)
            radius[use], angle[use] = np.where(likely, r, np.nan), np.where(likely, phi, np.nan)
        return radius, angle

    def _likely(self, radius: Floats, angle: Floats, fine: Floats) -> Bools:
        """Return a mask (n, 1) of the pairs of corners consistent with the position and width of the marker."""
        half, middle = 0.5 * (angle[:, 1] - angle[:, 0]), angle.mean(axis=1)
        known = np.isfinite(half)
        if not known.any():
            return np.zeros((len(half), 1), dtype=np.bool_)
        usual = median_of(half[known])
        length = self.marker.outer - self.marker.inner
        with np.errstate(invalid="ignore"):
            likely = (np.abs(middle - fine) < _OFF_MIDDLE * usual + _OFF_MIDDLE_BY) & (
                np.abs(half - usual) < _OTHER_WIDTH * usual
            )
            likely &= np.abs(radius.mean(axis=1) - self.marker.inner) < _OFF_EDGE * length + _OFF_EDGE_BY
        return np.asarray(likely[:, None])


def _some(use: Bools, most: int) -> Bools:
    """Return about `most` of the frames in use, equally spaced."""
    chosen = np.flatnonzero(use)
    few = np.zeros(len(use), dtype=np.bool_)
    few[chosen[:: max(len(chosen) // most, 1)]] = True
    return few


_LEAST_GAIN = 0.25
"""Smallest height, relative to the template, of a profile that enters a template [1]. Chosen: a smaller value admits
noise, a larger one fails where the light falls."""
_MOST_GAIN = 4.0
"""Largest height, relative to the template, of a profile that enters a template [1]. Chosen: a larger value admits
glare, a smaller one fails where the light rises."""
_MOST_WEAKNESS = 4.0
"""Largest factor on the uncertainty of a profile that enters a template [1]. Chosen: a larger value admits covered
markers, a smaller one leaves few profiles."""
_FEWEST_WHOLE = 6
"""Number of unoccluded profiles that make the use of other profiles unnecessary [frames]. Chosen: a smaller number
gives a noisy template, a larger one admits covered markers."""
_OF_TYPICAL = 0.6
"""Smallest height of a profile that enters a template, divided by the median height [1]. Chosen: a smaller value admits
shaded markers, a larger one leaves few profiles."""
_OF_MISFIT = 1.2
"""Largest misfit of a profile that enters a template, divided by the median misfit [1]. Chosen: a larger value admits
disturbed profiles, a smaller one leaves few profiles."""


def _good(found: Match, whole: Bools, known: Bools) -> Bools:
    """Return a mask of the frames that may enter a template: with a large gain, and with a usual or smaller misfit."""
    usable = (
        known & (found.gain > _LEAST_GAIN) & (found.gain < _MOST_GAIN) & (found.weakness < _MOST_WEAKNESS)
    )
    good = whole & usable
    if good.sum() < _FEWEST_WHOLE:
        good = usable
    if not good.any():
        return good
    good = good & (found.gain > _OF_TYPICAL * median_of(found.gain[good]))
    return good & (found.misfit <= _OF_MISFIT * median_of(found.misfit[good]) + 1e-3)
