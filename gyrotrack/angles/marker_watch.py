"""One marker, measured a batch of frames at a time, with what was learnt of it in the batches before."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.matching import Match, flat_top, match, mean_profile
from gyrotrack.angles.sightings import Sightings
from gyrotrack.angles.surroundings import AngleMap, even_light, unlit
from gyrotrack.geometry.channel import Channel
from gyrotrack.geometry.corners import near_corners
from gyrotrack.geometry.scene import Paper

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

LAYERS = 3
"""Parts of the radius in which a marker can be hidden by itself."""


class MarkerWatch:
    """The templates of a marker and the light on its ring, carried from batch to batch."""

    def __init__(self, paper: Paper, channel: Channel) -> None:
        self.paper = paper
        self.channel = channel
        step = channel.ring.step
        # Paper and smear of equal width make a triangle twice as wide at its foot as at half its height.
        self.half = int(np.ceil((2.0 * paper.half_width + max(0.06, 4.0 * step)) / step))
        self._across: Floats | None = None
        self._along: Floats | None = None
        self._light = AngleMap(1, channel.ring.columns)

    def look(self, coarse: Floats) -> Look:
        """Cut the windows about the coarse angles (rad, NaN: not followed) out of the buffer."""
        return Look(self, coarse)

    def measure(self, look: Look, open_: Mask) -> Sightings:
        """Measure the marker; `open_` (n, columns of the window) tells which samples nothing hides."""
        open_ = open_ & ~unlit(self._light)[look.column]
        whole = (open_ | ~self._matters()).all(axis=1) & look.known
        found = self._matched_across(look, open_, whole)
        along = self._matched_along(look, found, whole)
        radius, angle = self._corners(look, found, whole)
        ring = self.channel.ring
        hide = np.where(look.known, 0.0, np.nan)
        spacing = float(ring.radii[1] - ring.radii[0])
        return Sightings(
            angle=(look.start + found.shift) * ring.step + hide,
            radius=self.paper.radius + along.shift * spacing + np.where(whole, 0.0, np.nan),
            corner_angle=angle + (look.start * ring.step)[:, None],
            corner_radius=radius,
            gain=found.gain + hide,
            misfit=found.misfit + hide,
            weakness=found.weakness + hide,
            radial_misfit=along.misfit + np.where(whole, 0.0, np.nan),
            open=whole,
            centre=np.tile(np.array(ring.centre), (len(hide), 1)),
        )

    def _matters(self) -> Mask:
        """Return the samples of the window in which the marker itself may show."""
        step = self.channel.ring.step
        x = np.abs(np.arange(-self.half, self.half + 1)) * step
        if self._across is None:
            return np.asarray(x < 1.15 * self.paper.half_width + 2.0 * step)
        foot = float(x[self._across > 0.12].max(initial=self.paper.half_width))
        return np.asarray(x <= foot + step)

    def template(self, count: int) -> Floats:
        """Return the profile across that is expected, on the samples of the window."""
        if self._across is None:
            return flat_top(self.paper.half_width / self.channel.ring.step, count)
        return self._across

    def _matched_across(self, look: Look, open_: Mask, whole: Mask) -> Match:
        rounds = 3 if self._across is None else 1
        found = match(look.profile, self.template(look.profile.shape[1]), look.fraction, open_)
        for _ in range(rounds):
            good = _good(found, whole, look.known)
            better = mean_profile(look.profile, found, good, open_, symmetric=True)
            if better is not None and np.isfinite(better).all():
                self._across = better if self._across is None or rounds > 1 else 0.5 * (self._across + better)
            if good.any():
                self._learn_light(look, found, good, open_)
                look.apply_light(even_light(self._light, self.channel.ring.columns))
            found = match(look.profile, self.template(look.profile.shape[1]), found.shift, open_)
        return found

    def _learn_light(self, look: Look, found: Match, good: Mask, open_: Mask) -> None:
        x = np.arange(look.profile.shape[1])[None, :] - found.shift[good, None]
        template = self.template(look.profile.shape[1])
        expected = np.interp(x.ravel(), np.arange(len(template)), template)
        value = (look.raw[good] - found.offset[good, None]).ravel()
        core = (expected > 0.4) & open_[good].ravel()
        self._light.learn(0, look.column[good].ravel()[core], expected[core], value[core])

    def _matched_along(self, look: Look, found: Match, whole: Mask) -> Match:
        columns = np.arange(look.window.shape[2]) - self.half
        reach = max(0.5 * self.paper.half_width / self.channel.ring.step, 1.0)
        weight = np.clip(reach + 0.5 - np.abs(columns[None, :] - found.shift[:, None]), 0.0, 1.0)
        profile = np.einsum("nrc,nc->nr", look.window, weight) / weight.sum(axis=1)[:, None]
        nothing, everything = np.zeros(len(profile)), np.ones(profile.shape, dtype=np.bool_)
        if self._along is not None:
            return match(profile, self._along, nothing, everything)
        radii = self.channel.ring.radii
        spacing = float(radii[1] - radii[0])
        template = flat_top(0.5 * (self.paper.outer - self.paper.inner) / spacing, len(radii))
        template = np.interp(radii - self.paper.radius + float(radii.mean()), radii, template)
        along = match(profile, template, nothing, everything)
        for _ in range(2):
            better = mean_profile(profile, along, _good(along, whole, whole), everything, symmetric=False)
            if better is None or not np.isfinite(better).all():
                break
            self._along = better
            along = match(profile, better, along.shift, everything)
        return along

    def _corners(self, look: Look, found: Match, whole: Mask) -> tuple[Floats, Floats]:
        ring = self.channel.ring
        radius, angle = np.full((2, len(whole), 2), np.nan)
        if whole.any():
            gain = np.where(np.abs(found.gain) > 1e-3, found.gain, np.nan)[whole, None, None]
            shaped = (look.window[whole] - found.offset[whole, None, None]) / gain
            angles = np.asarray(np.arange(-self.half, self.half + 1) * ring.step, dtype=np.float64)
            shaped = np.nan_to_num(shaped)
            r, phi = near_corners(shaped, ring.radii, angles, self.paper.inner, self.paper.outer)
            likely = self._likely(r, phi, found.shift[whole] * ring.step)
            radius[whole], angle[whole] = np.where(likely, r, np.nan), np.where(likely, phi, np.nan)
        return radius, angle

    def _likely(self, radius: Floats, angle: Floats, fine: Floats) -> Mask:
        """Tell which pairs of corners fit the marker in place and width, (n, 1)."""
        half, middle = 0.5 * (angle[:, 1] - angle[:, 0]), angle.mean(axis=1)
        if not np.isfinite(half).any():
            return np.zeros((len(half), 1), dtype=np.bool_)
        usual = float(np.nanmedian(half))
        length = self.paper.outer - self.paper.inner
        with np.errstate(invalid="ignore"):
            likely = (np.abs(middle - fine) < 0.25 * usual + 0.01) & (np.abs(half - usual) < 0.3 * usual)
            likely &= np.abs(radius.mean(axis=1) - self.paper.inner) < 0.35 * length + 2.0
        return np.asarray(likely[:, None])


class Look:
    """The windows about one marker in a batch, raw and under even light.

    Attributes
    ----------
    known : ndarray of bool, shape (n,)
        Frames in which the body was followed.
    start, fraction : ndarray, shape (n,)
        Column in the middle of the window, and where between columns the marker is expected.
    column : ndarray of int, shape (n, m)
        Columns of the ring in the window.
    window : ndarray, shape (n, rows, m)
        Scores.
    raw, profile : ndarray, shape (n, m)
        Mean over the rows of the paper, as seen and under even light.
    layers : ndarray, shape (n, layers, m)
        The same for parts of the radius, as seen.
    """

    def __init__(self, watch: MarkerWatch, coarse: Floats) -> None:
        ring = watch.channel.ring
        self.known = np.isfinite(coarse)
        place = np.where(self.known, coarse, 0.0) / ring.step
        self.start = np.rint(place).astype(np.int64)
        self.fraction = place - self.start
        self.window = watch.channel.window(watch.paper, self.start, watch.half)
        self.column = (self.start[:, None] + np.arange(-watch.half, watch.half + 1)) % ring.columns
        rows = watch.channel.rows(watch.paper)
        parts = np.array_split(rows, min(LAYERS, len(rows)))
        self.layers = np.stack([self.window[:, part].mean(axis=1) for part in parts], axis=1)
        self.raw = self.window[:, rows].mean(axis=1)
        self.profile = self.raw
        self._uneven = self.window

    def apply_light(self, light: Floats) -> None:
        """Divide by the relative brightness of every column of the ring."""
        here = light[self.column]
        self.profile = self.raw / here
        self.window = self._uneven / here[:, None, :]


def _good(found: Match, whole: Mask, known: Mask) -> Mask:
    """Frames that may shape a template: high, with no more left over than usual."""
    usable = known & (found.gain > 0.25) & (found.gain < 4.0) & (found.weakness < 4.0)
    good = whole & usable
    if good.sum() < 6:
        good = usable
    if not good.any():
        return good
    good = good & (found.gain > 0.6 * np.median(found.gain[good]))
    return good & (found.misfit <= 1.2 * np.median(found.misfit[good]) + 1e-3)
