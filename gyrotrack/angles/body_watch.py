"""One body: followed coarsely through its markers together, then each marker measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.following import LONGEST_COAST, Motion, find_lock, follow
from gyrotrack.angles.marker_watch import LAYERS, Look, MarkerWatch
from gyrotrack.angles.sightings import Sightings
from gyrotrack.angles.surroundings import AngleMap, open_columns
from gyrotrack.geometry.channel import Channel
from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Paper
from gyrotrack.segmentation.ring import boxed
from gyrotrack.video.planes import Frame

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

SEEN = 0.4
"""Share of one marker's height that the score of a direction must reach."""
_COVER_COLUMNS = 360


class BodyWatch:
    """Everything that is watched on one body.

    Parameters
    ----------
    name : str
        "casing" or "rotor".
    papers : tuple of Paper
        Its markers, at least one of them coloured.
    samples, centre, keep_out, capacity
        See `Channel`.
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
        groups = [group for group in (coloured, white) if group]
        self._channels = [Channel(group, samples, centre, keep_out, capacity) for group in groups]
        self.markers = {p.name: MarkerWatch(p, channel) for channel in self._channels for p in channel.papers}
        self._main = self._channels[0]
        self._motion: Motion | None = None
        self._fresh = True
        self._cover = AngleMap(LAYERS, _COVER_COLUMNS)

    def aim(self, centre: tuple[float, float]) -> None:
        """Put all rings about a centre."""
        for channel in self._channels:
            channel.aim(centre)

    def take(self, frame: Frame, place: int) -> None:
        """Unroll one frame."""
        for channel in self._channels:
            channel.take(frame, place)

    def digest(
        self, count: int, advance: Integers, casing: Floats | None
    ) -> tuple[Floats, dict[str, Sightings]]:
        """Follow the body through the first `count` frames of the buffer and measure its markers.

        Parameters
        ----------
        count : int
            Frames in the buffer.
        advance : ndarray of int, shape (count,)
            Frames of the camera from each frame to the next; more than 1 where frames are missing.
        casing : ndarray, shape (count,), or None
            Angle as seen of the other body, whose bar may hide markers [rad].

        Returns
        -------
        coarse, sightings
            Unwrapped coarse angle (count,) [rad], NaN where the body is lost; the markers.
        """
        coarse = self._follow(self._joint_score(count), advance)
        looks = {name: watch.look(coarse + watch.paper.mount) for name, watch in self.markers.items()}
        if casing is not None:
            for name, look in looks.items():
                if not self.markers[name].channel.white:
                    self._learn_cover(self.markers[name], look, casing)
        if self._fresh:  # the first batch is measured twice: once to learn from, once to give
            self._fresh = False
            self._measured(looks, casing)
        return coarse, self._measured(looks, casing)

    def _measured(self, looks: dict[str, Look], casing: Floats | None) -> dict[str, Sightings]:
        return {
            name: self.markers[name].measure(look, self._open(self.markers[name], look, casing))
            for name, look in looks.items()
        }

    def _learn_cover(self, watch: MarkerWatch, look: Look, casing: Floats) -> None:
        known = look.known & np.isfinite(casing)
        if not known.any():
            return
        template = watch.template(look.column.shape[1])
        x = np.arange(len(template))[None, :] - look.fraction[known, None]
        expected = np.interp(x, np.arange(len(template)), template)
        core = expected > 0.7
        column = self._relative(watch, look, casing)[known]
        for layer in range(look.layers.shape[1]):
            value = np.clip(look.layers[known, layer], -0.2, 1.5)
            self._cover.learn(layer, column[core], expected[core], value[core])

    def _open(self, watch: MarkerWatch, look: Look, casing: Floats | None) -> Mask:
        everything = np.ones(look.column.shape, dtype=np.bool_)
        if casing is None:
            return everything
        known = np.isfinite(casing)[:, None]
        return np.where(known, open_columns(self._cover, 1)[self._relative(watch, look, casing)], everything)

    def _relative(self, watch: MarkerWatch, look: Look, casing: Floats) -> npt.NDArray[np.int64]:
        """Columns of the cover map (fixed on the casing) for the samples of the windows."""
        angle = look.column * watch.channel.ring.step - np.nan_to_num(casing)[:, None]
        return np.rint(angle * _COVER_COLUMNS / (2.0 * np.pi)).astype(np.int64) % _COVER_COLUMNS

    def _joint_score(self, count: int) -> Floats:
        step = self._main.ring.step
        total = np.zeros((count, self._main.ring.columns))
        for paper in self._main.papers:
            half = max(int(paper.half_width / step), 1)
            around = np.clip(self._main.around(paper, count), -0.2, 1.3)
            total += np.roll(boxed(around, half), -round(paper.mount / step), axis=1)
        return total

    def _follow(self, score: Floats, advance: Integers) -> Floats:
        """Return the coarse angle in each frame of a batch; `advance` is as for `following.follow`."""
        count = len(score)
        coarse = np.full(count, np.nan)
        begin = 0
        while begin < count:
            if self._motion is None or self._motion.missed > LONGEST_COAST:
                begin = self._lock(score, begin, advance, coarse)
                if begin == count:
                    break
            angle, _, motion = follow(score[begin:], self._motion_now(), SEEN, advance[begin:])
            self._motion = motion
            coarse[begin:] = angle
            lost = np.flatnonzero(np.isnan(angle))
            begin = begin + int(lost[0]) if len(lost) else count
        return coarse

    def _motion_now(self) -> Motion:
        return self._motion if self._motion is not None else Motion(0.0, 0.0)

    def _lock(self, score: Floats, begin: int, advance: Integers, coarse: Floats) -> int:
        """Find the body anew from frame `begin` on; fill in the frames before the lock by going backwards.

        Without a lock the old motion runs on, so that its turns are still counted when the body comes back.
        """
        old = self._motion
        lock = find_lock(score[begin:], SEEN, old.step if old else 0.0)
        if lock is None:
            self._motion = old and _run_on(old, int(advance[begin:].sum()))
            return len(score)
        frame, motion = begin + lock[0], lock[1]
        if old is not None:
            ahead = _run_on(old, int(advance[begin:frame].sum())).angle - motion.angle
            motion = replace(motion, angle=motion.angle + 2.0 * np.pi * round(ahead / (2.0 * np.pi)))
        if frame > begin:
            back = Motion(motion.angle - motion.step, -motion.step)
            angle, here, _ = follow(score[begin:frame][::-1], back, SEEN)
            coarse[begin:frame] = np.where(here, angle, np.nan)[::-1]
        self._motion = motion
        return frame


def _run_on(motion: Motion, frames: int) -> Motion:
    return Motion(motion.angle + frames * motion.step, motion.step, motion.missed + frames)
