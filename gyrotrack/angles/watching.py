"""Watching one body: rings unrolled frame by frame, and its markers measured a batch at a time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.following import Motion, find_lock, follow
from gyrotrack.angles.matching import Match, flat_top, match, mean_profile
from gyrotrack.geometry.corners import near_corners
from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Paper
from gyrotrack.segmentation.ring import Ring, ring_for, unroll
from gyrotrack.video.planes import Frame

Floats = npt.NDArray[np.float64]
Scores = npt.NDArray[np.float32]

SEEN = 0.4
"""Share of one marker's height that the score of a direction must reach."""


@dataclass(frozen=True)
class Sightings:
    """One marker in consecutive frames, about the ring's centre; NaN where the body was not followed.

    Attributes
    ----------
    angle, radius : ndarray, shape (n,)
        Fine angle as seen [rad], radius of the middle of the paper [px].
    corner_angle, corner_radius : ndarray, shape (n, 2)
        The near corners about the ring's centre.
    gain, misfit, radial_misfit : ndarray, shape (n,)
        Height relative to the typical one, and rms of what the templates leave over, relative to the gain.
    centre : ndarray, shape (n, 2)
        Centre of the ring in px.
    """

    angle: Floats
    radius: Floats
    corner_angle: Floats
    corner_radius: Floats
    gain: Floats
    misfit: Floats
    radial_misfit: Floats
    centre: Floats

    @staticmethod
    def joined(parts: list[Sightings]) -> Sightings:
        """Put batches one after the other."""
        return Sightings(
            *(np.concatenate([getattr(p, f) for p in parts]) for f in Sightings.__dataclass_fields__)
        )


class Channel:
    """A ring in chroma or luma with a buffer for a batch, and the background on which papers lie.

    Parameters
    ----------
    papers : tuple of Paper
        Markers that are seen in it: all coloured or all white.
    """

    def __init__(
        self,
        papers: tuple[Paper, ...],
        samples: Samples,
        centre: tuple[float, float],
        keep_out: float,
        capacity: int,
    ) -> None:
        self.papers = papers
        self.white = papers[0].colour == "white"
        inner, outer = min(p.inner for p in papers), max(p.outer for p in papers)
        margin = max(6.0, 0.35 * (outer - inner))
        self.ring = ring_for(
            centre, max(inner - margin, keep_out, 2.0), outer + margin, 1.0 if self.white else 2.0
        )
        planes = 1 if self.white else 2
        self._strips = np.zeros((capacity, planes, self.ring.rows, self.ring.columns), dtype=np.uint8)
        self._ground = self._background(samples)

    def _background(self, samples: Samples) -> npt.NDArray[np.float32]:
        strips = samples.luma_strips(self.ring)[None] if self.white else samples.strips(self.ring)
        return np.asarray(np.median(strips, axis=1), dtype=np.float32)

    def flatten_background(self) -> None:
        """Replace the background by its median along each row: for bodies that hardly turned in the samples."""
        self._ground = np.broadcast_to(np.median(self._ground, axis=2, keepdims=True), self._ground.shape)

    def aim(self, centre: tuple[float, float]) -> None:
        """Put the ring about another centre."""
        self.ring = self.ring.moved(centre)

    def take(self, frame: Frame, place: int) -> None:
        """Unroll one frame into the buffer."""
        if self.white:
            unroll(frame.y, self.ring.luma_maps, self._strips[place, 0])
        else:
            maps = self.ring.chroma_maps
            unroll(frame.u, maps, self._strips[place, 0])
            unroll(frame.v, maps, self._strips[place, 1])

    def rows(self, paper: Paper) -> npt.NDArray[np.bool_]:
        """Rows that lie on a paper."""
        inside = (self.ring.radii >= paper.inner) & (self.ring.radii <= paper.outer)
        if not inside.any():
            inside[int(np.argmin(np.abs(self.ring.radii - paper.radius)))] = True
        return inside

    def weights(self, paper: Paper) -> tuple[np.float32, ...]:
        """Weights of the planes that make the score 1 on the paper and 0 beside it."""
        a, b = paper.contrast
        norm = a * a + b * b
        return (np.float32(1.0 / a),) if self.white else (np.float32(a / norm), np.float32(b / norm))

    def around(self, paper: Paper, count: int) -> Scores:
        """Return the mean score over the rows of a paper in all directions: (count, columns)."""
        rows = self.rows(paper)
        score = np.zeros((count, self.ring.columns), dtype=np.float32)
        for plane, weight in enumerate(self.weights(paper)):
            level = self._strips[:count, plane][:, rows].mean(axis=1, dtype=np.float32)
            score += weight * (level - self._ground[plane, rows].mean(axis=0))
        return score

    def window(self, paper: Paper, start: npt.NDArray[np.int64], half: int) -> Floats:
        """Return the score within `half` columns of `start` in each frame: (count, rows, 2 half + 1)."""
        index = (start[:, None] + np.arange(-half, half + 1)) % self.ring.columns
        out = np.zeros((len(start), self.ring.rows, 2 * half + 1), dtype=np.float32)
        rows = np.arange(self.ring.rows)[None, :, None]
        for plane, weight in enumerate(self.weights(paper)):
            pixels = self._strips[np.arange(len(start))[:, None, None], plane, rows, index[:, None, :]]
            out += weight * (pixels - self._ground[plane][rows, index[:, None, :]])
        return out.astype(np.float64)


class PaperWatch:
    """One marker's templates, carried from batch to batch."""

    def __init__(self, paper: Paper, channel: Channel) -> None:
        self.paper = paper
        self.channel = channel
        self._across: Floats | None = None
        self._along: Floats | None = None
        step = channel.ring.step
        self._half = int(np.ceil((1.35 * paper.half_width + max(0.10, 5.0 * step)) / step))

    def measure(self, coarse: Floats) -> Sightings:
        """Measure the marker in the frames of the buffer, near the coarse angles (rad, NaN: not followed)."""
        ring, count = self.channel.ring, len(coarse)
        known = np.isfinite(coarse)
        place = np.where(known, coarse, 0.0) / ring.step
        start = np.rint(place).astype(np.int64)
        window = self.channel.window(self.paper, start, self._half)
        across, self._across = self._matched_across(window, place - start, known)
        along, middle = self._matched_along(window, across, known)
        shaped = (window - across.offset[:, None, None]) / np.where(known, across.gain, 1.0)[:, None, None]
        angles = np.arange(-self._half, self._half + 1) * ring.step
        radius, angle = near_corners(shaped, ring.radii, angles, self.paper.inner, self.paper.outer)
        spacing = float(ring.radii[1] - ring.radii[0])
        fine = (start + across.shift) * ring.step
        hide = np.where(known, 0.0, np.nan)
        return Sightings(
            angle=fine + hide,
            radius=middle + along.shift * spacing + hide,
            corner_angle=angle + (start * ring.step + hide)[:, None],
            corner_radius=radius + hide[:, None],
            gain=across.gain + hide,
            misfit=across.misfit + hide,
            radial_misfit=along.misfit + hide,
            centre=np.tile(np.array(ring.centre), (count, 1)),
        )

    def _matched_across(
        self, window: Floats, start: Floats, known: npt.NDArray[np.bool_]
    ) -> tuple[Match, Floats]:
        profile = window[:, self.channel.rows(self.paper), :].mean(axis=1)
        template = self._across
        rounds = 1
        if template is None:
            template = flat_top(self.paper.half_width / self.channel.ring.step, profile.shape[1])
            rounds = 3
        found = match(profile, template, start)
        for _ in range(rounds):
            better = mean_profile(profile, found, _good(found, known), symmetric=True)
            if better is None:
                break
            template = better if rounds > 1 else 0.5 * (template + better)
            found = match(profile, template, found.shift)
        return found, template

    def _matched_along(
        self, window: Floats, across: Match, known: npt.NDArray[np.bool_]
    ) -> tuple[Match, float]:
        columns = np.arange(window.shape[2]) - self._half
        reach = max(0.5 * self.paper.half_width / self.channel.ring.step, 1.0)
        weight = np.clip(reach + 0.5 - np.abs(columns[None, :] - across.shift[:, None]), 0.0, 1.0)
        profile = np.einsum("nrc,nc->nr", window, weight) / weight.sum(axis=1)[:, None]
        radii = self.channel.ring.radii
        if self._along is None:
            spacing = float(radii[1] - radii[0])
            template = flat_top(0.5 * (self.paper.outer - self.paper.inner) / spacing, len(radii))
            template = np.interp(radii - self.paper.radius + float(radii.mean()), radii, template)
            found = match(profile, template)
            for _ in range(2):
                better = mean_profile(profile, found, _good(found, known), symmetric=False)
                if better is None:
                    break
                self._along = template = better
                found = match(profile, template, found.shift)
        else:
            found = match(profile, self._along)
        return found, self.paper.radius


def _good(found: Match, known: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Frames that may shape a template: high, and with no more left over than usual."""
    good = known & (found.gain > 0.25) & (found.gain < 4.0)
    if not good.any():
        return good
    typical_gain, typical_misfit = np.median(found.gain[good]), np.median(found.misfit[good])
    return good & (found.gain > 0.7 * typical_gain) & (found.misfit < 1.3 * typical_misfit + 1e-3)


class BodyWatch:
    """Everything that is watched on one body.

    Parameters
    ----------
    name : str
        "casing" or "rotor".
    papers : tuple of Paper
        Its markers.
    keep_out : float
        Radius in px inside which something of a marker's colour (the disc) lies.
    capacity : int
        Frames of a batch.
    """

    def __init__(
        self,
        name: str,
        papers: tuple[Paper, ...],
        samples: Samples,
        centre: tuple[float, float],
        keep_out: float,
        capacity: int,
    ) -> None:
        self.name = name
        coloured = tuple(p for p in papers if p.colour != "white")
        white = tuple(p for p in papers if p.colour == "white")
        self._channels = [
            Channel(group, samples, centre, keep_out, capacity) for group in (coloured, white) if group
        ]
        self.papers = {p.name: PaperWatch(p, channel) for channel in self._channels for p in channel.papers}
        self._main = self._channels[0]
        self._motion: Motion | None = None
        self._turns = 0.0

    def aim(self, centre: tuple[float, float]) -> None:
        """Put all rings about a centre."""
        for channel in self._channels:
            channel.aim(centre)

    def flatten_background(self) -> None:
        """See `Channel.flatten_background`."""
        for channel in self._channels:
            channel.flatten_background()

    def take(self, frame: Frame, place: int) -> None:
        """Unroll one frame."""
        for channel in self._channels:
            channel.take(frame, place)

    def digest(self, count: int) -> tuple[Floats, npt.NDArray[np.bool_], dict[str, Sightings]]:
        """Follow the body through the first `count` frames of the buffer and measure its markers.

        Returns
        -------
        coarse, seen, sightings
            Unwrapped coarse angle (count,) [rad], NaN where the body is lost; whether it was seen; the markers.
        """
        score = self._joint_score(count)
        coarse, seen = self._follow(score)
        found = {name: watch.measure(coarse + watch.paper.mount) for name, watch in self.papers.items()}
        return coarse, seen, found

    def _joint_score(self, count: int) -> Floats:
        step = self._main.ring.step
        total = np.zeros((count, self._main.ring.columns))
        for paper in self._main.papers:
            half = max(int(paper.half_width / step), 1)
            around = np.clip(self._main.around(paper, count), -0.2, 1.3).astype(np.float64)
            total += np.roll(_boxed(around, half), -round(paper.mount / step), axis=1)
        return total

    def _follow(self, score: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
        count = len(score)
        coarse, seen = np.full(count, np.nan), np.zeros(count, dtype=np.bool_)
        begin = 0
        while begin < count:
            if self._motion is None or self._motion.missed > 40:
                begin = self._lock(score, begin, coarse, seen)
                if self._motion is None:
                    break
            angle, here, self._motion = follow(score[begin:], self._motion, SEEN)
            coarse[begin:], seen[begin:] = angle, here
            lost = np.flatnonzero(np.isnan(angle))
            begin = begin + int(lost[0]) if len(lost) else count
        return coarse, seen

    def _lock(self, score: Floats, begin: int, coarse: Floats, seen: npt.NDArray[np.bool_]) -> int:
        """Find the body anew from frame `begin` on; fill in the frames before the lock by going backwards."""
        old = self._motion
        self._motion = None
        lock = find_lock(score[begin:], SEEN, old.step if old else 0.0)
        if lock is None:
            return len(score)
        frame, motion = begin + lock[0], lock[1]
        if old is not None:
            expected = old.angle + old.step * lock[0]
            motion = replace(
                motion, angle=motion.angle + 2.0 * np.pi * round((expected - motion.angle) / (2.0 * np.pi))
            )
        if frame > begin:
            back = Motion(motion.angle - motion.step, -motion.step)
            angle, here, _ = follow(score[begin:frame][::-1], back, SEEN)
            angle, here = angle[::-1], here[::-1]
            coarse[begin:frame], seen[begin:frame] = np.where(here, angle, np.nan), here
        self._motion = motion
        return frame


def _boxed(profile: Floats, half: int) -> Floats:
    """Average circularly over 2 half + 1 columns."""
    width = 2 * half + 1
    padded = np.concatenate([profile[:, -half:], profile, profile[:, :half]], axis=1)
    total = np.cumsum(np.pad(padded, ((0, 0), (1, 0))), axis=1)
    return np.asarray((total[:, width:] - total[:, :-width]) / width)
