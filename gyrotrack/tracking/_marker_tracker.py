"""One marker, measured a batch of frames at a time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack._smoothing import median_of
from gyrotrack.tracking._corners import near_corners
from gyrotrack.tracking._illumination import AngleMap, even_light, places_apart, unlit
from gyrotrack.tracking._marker_window import MarkerStrip, MarkerWindow
from gyrotrack.tracking._matching import Match, displaced, flat_top, match, mean_profile
from gyrotrack.tracking._observations import MarkerObservations
from gyrotrack.tracking._scene import Marker

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MOST_SHAPES = 96
"""Frames of a batch from which the template is learnt."""


class MarkerTracker:
    """The templates of a marker and the light on its ring, carried from batch to batch."""

    def __init__(self, marker: Marker, strip: MarkerStrip) -> None:
        self.marker = marker
        self.strip = strip
        self._across: Floats | None = None
        self._along: Floats | None = None
        self._light = AngleMap(1, strip.ring.columns, strip.ground if strip.white else None)

    def look(self, coarse: Floats) -> MarkerWindow:
        """Take the windows about the coarse angles (rad, NaN: not followed) out of the buffer."""
        return MarkerWindow(self.strip, coarse)

    def expected(self, look: MarkerWindow) -> Floats:
        """Return the profile across that is expected where the marker is expected, (n, m)."""
        return displaced(self.template(look.raw.shape[1]), look.fraction)

    def measure(self, look: MarkerWindow, open_: Mask, clear: Mask | None = None) -> MarkerObservations:
        """Measure the marker; `open_` (n, columns of the window) tells which samples nothing hides.

        A shadow dims a colour with all that is seen of it; beside a white marker it darkens the metal, which pulls
        the marker's foot. Where nothing hides such a marker, only samples that are `clear` of shadows are used.
        """
        dark = unlit(self._light)
        if dark.any():
            open_ = open_ & (look.here(dark) == 0)
        whole = (open_ | ~self._matters(look)).all(axis=1) & look.known
        if clear is not None:
            open_ = open_ & (clear | ~whole[:, None])
        found = self._matched_across(look, open_, whole)
        along = self._matched_along(look, found, whole)
        radius, angle = self._corners(look, found, whole)
        ring = self.strip.ring
        hide = np.where(look.known, 0.0, np.nan)
        spacing = float(ring.radii[1] - ring.radii[0])
        return MarkerObservations(
            angle=(look.start + found.shift) * ring.step + hide,
            radius=self.marker.radius + along.shift * spacing + np.where(whole, 0.0, np.nan),
            corner_angle=angle + (look.start * ring.step)[:, None],
            corner_radius=radius,
            gain=found.gain + hide,
            misfit=found.misfit + hide,
            weakness=found.weakness + hide,
            open=whole,
            centre=np.tile(np.array(ring.centre), (len(hide), 1)),
        )

    def _matters(self, look: MarkerWindow) -> Mask:
        """Return the samples of the windows in which the marker itself may show, (n, m)."""
        step, half = self.strip.ring.step, self.strip.half
        x = np.abs(np.arange(-half, half + 1)) * step
        reach = 1.15 * self.marker.half_width + 2.0 * step
        if self._across is not None:
            reach = float(x[self._across > 0.12].max(initial=self.marker.half_width)) + step
        place = np.arange(-half, half + 1)[None, :] - look.fraction[:, None]
        return np.asarray(np.abs(place) * step <= reach)

    def template(self, count: int) -> Floats:
        """Return the profile across that is expected, on the samples of the window."""
        if self._across is None:
            return flat_top(self.marker.half_width / self.strip.ring.step, count)
        return self._across

    def _matched_across(self, look: MarkerWindow, open_: Mask, whole: Mask) -> Match:
        rounds = 3 if self._across is None else 1
        ring = self.strip.ring
        reach = max(
            round(self.marker.half_width / ring.step), places_apart(look.start[look.known], ring.columns) // 2
        )
        template = self.template(look.profile.shape[1])
        found = match(look.profile, template, look.fraction, open_)
        for _ in range(rounds):
            good = _good(found, whole, look.known)
            few = _some(good, MOST_SHAPES)
            better = mean_profile(look.profile, found, few, open_, symmetric=True)
            if better is not None and np.isfinite(better).all():
                self._across = better if self._across is None or rounds > 1 else 0.5 * (self._across + better)
            if good.any():
                self._learn_light(look, displaced(template, found.shift), found.offset, open_ & good[:, None])
                look.apply_light(even_light(self._light, reach))
            template = self.template(look.profile.shape[1])
            found = match(look.profile, template, found.shift, open_)
        return found

    def _learn_light(self, look: MarkerWindow, expected: Floats, offset: Floats, use: Mask) -> None:
        expected = np.where((expected > 0.4) & use, expected, 0.0)
        column = look.column(self.strip.ring.columns)
        self._light.learn(0, column, expected, look.raw - offset[:, None])

    def _matched_along(self, look: MarkerWindow, found: Match, whole: Mask) -> Match:
        columns = np.arange(look.window.shape[2]) - self.strip.half
        reach = max(0.5 * self.marker.half_width / self.strip.ring.step, 1.0)
        weight = np.clip(reach + 0.5 - np.abs(columns[None, :] - found.shift[:, None]), 0.0, 1.0)
        profile = look.along(weight / weight.sum(axis=1)[:, None])
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

    def _corners(self, look: MarkerWindow, found: Match, whole: Mask) -> tuple[Floats, Floats]:
        ring = self.strip.ring
        radius, angle = np.full((2, len(whole), 2), np.nan)
        use = whole & (found.gain > 0.1)
        if use.any():
            shaped = look.shaped(use, found.gain[use], found.offset[use])
            angles: Floats = np.arange(-self.strip.half, self.strip.half + 1.0) * ring.step
            r, phi = near_corners(shaped, ring.radii, angles, self.marker.inner, self.marker.outer)
            likely = self._likely(r, phi, found.shift[use] * ring.step)
            radius[use], angle[use] = np.where(likely, r, np.nan), np.where(likely, phi, np.nan)
        return radius, angle

    def _likely(self, radius: Floats, angle: Floats, fine: Floats) -> Mask:
        """Tell which pairs of corners fit the marker in place and width, (n, 1)."""
        half, middle = 0.5 * (angle[:, 1] - angle[:, 0]), angle.mean(axis=1)
        known = np.isfinite(half)
        if not known.any():
            return np.zeros((len(half), 1), dtype=np.bool_)
        usual = median_of(half[known])
        length = self.marker.outer - self.marker.inner
        with np.errstate(invalid="ignore"):
            likely = (np.abs(middle - fine) < 0.25 * usual + 0.01) & (np.abs(half - usual) < 0.3 * usual)
            likely &= np.abs(radius.mean(axis=1) - self.marker.inner) < 0.35 * length + 2.0
        return np.asarray(likely[:, None])


def _some(use: Mask, most: int) -> Mask:
    """Keep at most about so many of the frames in use, spread evenly."""
    chosen = np.flatnonzero(use)
    few = np.zeros(len(use), dtype=np.bool_)
    few[chosen[:: max(len(chosen) // most, 1)]] = True
    return few


def _good(found: Match, whole: Mask, known: Mask) -> Mask:
    """Frames that may shape a template: high, with no more left over than usual."""
    usable = known & (found.gain > 0.25) & (found.gain < 4.0) & (found.weakness < 4.0)
    good = whole & usable
    if good.sum() < 6:
        good = usable
    if not good.any():
        return good
    good = good & (found.gain > 0.6 * median_of(found.gain[good]))
    return good & (found.misfit <= 1.2 * median_of(found.misfit[good]) + 1e-3)
