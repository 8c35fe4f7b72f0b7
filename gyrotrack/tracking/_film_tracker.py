"""The tracker of a film: every frame is sampled along rings, and every batch of frames is measured, body by body.

A body is tracked coarsely by all its markers together, then each marker is measured. The angle of the body is
predicted, and only the neighbourhood of each predicted marker is searched. If the uncertainty of the prediction is too
large, or the markers are not found there, the whole rings are searched.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Bools, Floats, Integers
from gyrotrack.tracking._association import (
    LEAST_SCATTER,
    LONGEST_COAST,
    Motion,
    Prediction,
    find_lock,
    follow,
)
from gyrotrack.tracking._hub import DiscWindow, moves_fast
from gyrotrack.tracking._marker_tracker import MarkerObservations, MarkerTracker, spread_out
from gyrotrack.tracking._marker_window import AngleMap, MarkerStrip, Occlusion, common_columns
from gyrotrack.tracking._polar import boxed
from gyrotrack.tracking._scene import Marker, Samples, Scene
from gyrotrack.tracking._texture import REACH, TextureObservations, TextureTracker
from gyrotrack.video._container import Frame
from gyrotrack.video._decoder import RepeatDetector
from gyrotrack.video._time_base import FrameTimes

LEAST_SCORE = 0.4
"""Smallest score of an angle at which the body is visible; a fully visible marker has the score 1 [1]. Chosen: a
smaller value follows noise, a larger one loses shaded markers."""
MARGIN = 0.05
"""Largest distance of a marker from its prediction [rad]. Chosen: with a smaller value, whole rings are searched more
often; with a larger one, more samples are needed."""
CHECK_EVERY = 2
"""Distance between the frames that are used to check the prediction [frames]. Chosen: a larger value notices a loss
later, a smaller one costs time."""
COVERAGE_FACTOR = 3.0
"""Factor of the standard uncertainty of a prediction; the product must be less than `MARGIN` [1]. Chosen: three
standard deviations; a smaller value cuts markers off, a larger one searches whole rings."""


class BodyTracker:
    """Tracker of one body, "casing" or "rotor", with a coloured marker; see `MarkerStrip` and `Occlusion`."""

    def __init__(
        self,
        name: str,
        markers: tuple[Marker, ...],
        samples: Samples,
        centre: tuple[float, float],
        keep_out: float,
        capacity: int,
        offset: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.name = name
        columns = common_columns(markers, centre)
        strips = {
            p.name: MarkerStrip(p, samples, centre, keep_out, columns, MARGIN, capacity) for p in markers
        }
        self.markers = {p.name: MarkerTracker(p, strips[p.name]) for p in markers}
        self._coloured = [strip for strip in strips.values() if not strip.white]
        self._step = self._coloured[0].ring.step
        self._coarse = np.full(capacity, np.nan)
        self._frame = 0.0
        self.step = float("inf")
        self._motion: Motion | None = None
        self._missed: int | None = None
        self._prediction = Prediction()
        self._cover = Occlusion(self._step, offset)

    def centre_on(self, centre: tuple[float, float]) -> None:
        """Centre all rings on a point."""
        for tracker in self.markers.values():
            tracker.strip.centre_on(centre)

    def coarse(self, place: int, count: int) -> Floats:
        """Return the coarse angles of `count` frames of the batch [rad]."""
        return self._coarse[place : place + count]

    @property
    def maps(self) -> list[AngleMap]:
        """Maps of the illumination on the ring of each marker, and of the occlusion, estimated from this film."""
        return [*(tracker.light for tracker in self.markers.values()), self._cover.map]

    def take(self, frames: list[Frame], place: int, advance: Floats) -> None:
        """Track a body through frames `advance` (n,) frame periods apart; store windows from index `place` on."""
        number = self._frame + np.cumsum(advance)
        found = self._predicted(frames, place, number)
        if found is None:
            self._motion = self._motion_at(float(number[0])) or _moved(self._motion, float(advance[0]))
            coarse = self._follow(self._searched(frames), np.append(advance[1:], 0.0))
            self._cut(frames, place, coarse)
            found = self._refined(coarse, slice(place, place + len(frames)))
            if np.isnan(coarse).any():
                self._prediction.reset()
            self._prediction.add(number, *found)
        else:
            self._missed = int(np.argmax(found[1][::-1]))
        self._frame = float(number[-1])
        self.step = _usual_step(found[0])
        self._coarse[place : place + len(frames)] = found[0]

    def _predicted(self, frames: list[Frame], place: int, number: Floats) -> tuple[Floats, Bools] | None:
        """Search near the prediction; None if its uncertainty is too large, or if the body is not found there."""
        prediction = self._prediction.at(number)
        if prediction is None or COVERAGE_FACTOR * prediction[1] > MARGIN:
            return None
        self._cut(frames, place, prediction[0])
        few = slice(0, len(frames), CHECK_EVERY)
        angle, seen = self._refined(prediction[0][few], slice(place, place + len(frames), CHECK_EVERY))
        if seen.mean() <= 0.5:
            return None
        self._prediction.add(number[few], angle, seen)
        off = float(np.median((angle - prediction[0][few])[seen]))
        return prediction[0] + off, np.repeat(seen, CHECK_EVERY)[: len(frames)]

    def _motion_at(self, number: float) -> Motion | None:
        """Return the predicted motion at a frame, if the previous frames were tracked by prediction."""
        ahead = self._prediction.at(np.array([number, number + 1.0])) if self._missed is not None else None
        if ahead is None or self._missed is None:
            return None
        missed, self._missed = self._missed, None
        return Motion(float(ahead[0][0]), float(ahead[0][1] - ahead[0][0]), missed)

    def _cut(self, frames: list[Frame], place: int, coarse: Floats) -> None:
        angles = np.nan_to_num(coarse)
        for tracker in self.markers.values():
            tracker.strip.take(frames, place, angles + tracker.marker.mount)

    def _refined(self, coarse: Floats, place: slice) -> tuple[Floats, Bools]:
        """Refine coarse angles (n,) by coloured markers; occluded markers have small weights. Also return a mask."""
        total, weight = np.zeros(len(coarse)), np.full(len(coarse), 1e-9)
        expected = np.nan_to_num(coarse)
        for strip in self._coloured:
            off, height = strip.locate(expected + strip.marker.mount, place)
            own = np.where(height > LEAST_SCORE, np.minimum(height, 1.2) ** 8, 0.0)
            total, weight = total + own * off, weight + own
        seen = (weight > 1e-6) & np.isfinite(coarse)
        return np.where(seen, coarse + total / weight * self._step, coarse), seen

    def measure_batch(
        self, count: int, casing: Floats | None, *, again: bool
    ) -> tuple[Floats, dict[str, MarkerObservations]]:
        """Measure `count` frames of the batch; `casing` is the apparent angle of the body that occludes markers [rad].

        Frames that are measured `again` are not added to the map of the occlusion a second time. Return the unwrapped
        coarse angles (count,) [rad], NaN where the body is lost, and the observations.
        """
        coarse = self._coarse[:count].copy()
        windows = {
            name: tracker.window(coarse + tracker.marker.mount) for name, tracker in self.markers.items()
        }
        if casing is not None and not again:
            for name, window in windows.items():
                if not self.markers[name].strip.white:
                    self._cover.learn(window, self.markers[name].expected(window), casing)
        return coarse, {
            name: tracker.measure(
                windows[name],
                self._cover.open(windows[name], casing),
                self._cover.open(windows[name], casing, shadows=True) if tracker.strip.white else None,
            )
            for name, tracker in self.markers.items()
        }

    def _searched(self, frames: list[Frame]) -> Floats:
        """Return the joint score of all angles, (n, columns)."""
        total = np.zeros((len(frames), self._coloured[0].ring.columns))
        for strip in self._coloured:
            around = np.clip(strip.whole(frames), -0.2, 1.3)
            half = max(int(strip.marker.half_width / self._step), 1)
            total += np.roll(boxed(around, half), -round(strip.marker.mount / self._step), axis=1)
        return total

    def _follow(self, score: Floats, advance: Floats) -> Floats:
        """Return the coarse angle in each frame of a batch; `advance` is as for `follow`."""
        count = len(score)
        coarse = np.full(count, np.nan)
        begin = 0
        while begin < count:
            if self._motion is None or self._motion.missed > LONGEST_COAST:
                begin = self._lock(score, begin, advance, coarse)
                if begin == count:
                    break
            angle, _, motion = follow(
                score[begin:], self._motion or Motion(0.0, 0.0), LEAST_SCORE, advance[begin:]
            )
            self._motion = motion
            coarse[begin:] = angle
            lost = np.flatnonzero(np.isnan(angle))
            begin = begin + int(lost[0]) if len(lost) else count
        return coarse

    def _lock(self, score: Floats, begin: int, advance: Floats, coarse: Floats) -> int:
        """Find the body again after `begin` and track it backwards; otherwise extrapolate the number of turns."""
        old = self._motion
        place = np.cumsum(np.append(0.0, advance[begin:-1]))
        lock = find_lock(score[begin:], LEAST_SCORE, old.step if old else 0.0, place)
        if lock is None:
            self._motion = old and _run_on(old, float(advance[begin:].sum()))
            return len(score)
        frame, motion = begin + lock[0], lock[1]
        if old is not None:
            ahead = _run_on(old, float(advance[begin:frame].sum())).angle - motion.angle
            motion = replace(motion, angle=motion.angle + 2.0 * np.pi * round(ahead / (2.0 * np.pi)))
        if frame > begin:
            before = advance[begin:frame][::-1]
            back = Motion(motion.angle - float(before[0]) * motion.step, -motion.step)
            angle, here, _ = follow(score[begin:frame][::-1], back, LEAST_SCORE, np.append(before[1:], 0.0))
            coarse[begin:frame] = np.where(here, angle, np.nan)[::-1]
        self._motion = motion
        return frame


def _usual_step(coarse: Floats) -> float:
    known = np.abs(np.diff(coarse))
    known = known[np.isfinite(known)]
    return float(known.mean()) if len(known) else float("inf")


def _moved(motion: Motion | None, frames: float) -> Motion | None:
    return motion and replace(motion, angle=motion.angle + frames * motion.step)


def _run_on(motion: Motion, frames: float) -> Motion:
    return Motion(motion.angle + frames * motion.step, motion.step, motion.missed + round(frames))


Rows = dict[str, npt.NDArray[Any]]

Progress = Callable[[int, int | None], None]

RINGS = ("texture", "aligned")  # observations of a ring (see `TextureTracker.measure`)

BATCH = 512
"""Number of frames that are measured together [frames]. Chosen: a smaller number gives noisy templates, a larger one
gives outdated templates and takes memory."""
HOLD = 64
"""Number of frames held in memory; if a body is not found at its prediction, it is searched for in these frames
[frames]. Chosen: a smaller number may not suffice to find the body again, a larger one takes memory."""
HELD_BYTES = 24_000_000
"""Size of the frames that are held [bytes]. Chosen: a larger value needs memory, a smaller one holds fewer frames of
large pictures."""
SLOW = 3.0 * LEAST_SCATTER
"""Smallest step of the fastest body for which equal frames are repeated frames [rad]. Derived: three times the lower
limit of the scatter of a coarse angle."""
_MOVE = 0.6
"""Distance of the disc from the centre of the rings beyond which the rings are moved [px]. Chosen: with a smaller
value, noise moves the rings; a larger one displaces the markers in their windows."""


@dataclass(frozen=True)
class BodyObservations:
    """One body in all frames: unwrapped coarse angle as seen [rad], NaN where the body is lost; its markers."""

    coarse: Floats
    markers: dict[str, MarkerObservations]
    texture: TextureObservations | None = None
    # of a slow body, with the oblique view that its ring determines
    aligned: TextureObservations | None = None

    def spread_out(self, index: Integers, count: int) -> BodyObservations:
        """Place the frames at `index` of `count` frames; the other frames are NaN or False."""
        markers = {name: m.spread_out(index, count) for name, m in self.markers.items()}
        rings = (ring and ring.spread_out(index, count) for ring in (self.texture, self.aligned))
        return BodyObservations(spread_out(self.coarse, index, count), markers, *rings)

    def picked(self, index: Integers) -> BodyObservations:
        """Return the frames `index`."""
        markers = {name: m.picked(index) for name, m in self.markers.items()}
        rings = (ring and ring.picked(index) for ring in (self.texture, self.aligned))
        return BodyObservations(self.coarse[index], markers, *rings)


@dataclass(frozen=True)
class FilmObservations:
    """Observations of one pass through a film."""

    bodies: dict[str, BodyObservations]  # by name
    disc: Floats | None  # shape (n, 2); the disc's centre in every frame [px]
    pts_time: Floats  # shape (n,); the stream's own timestamps [s]
    times: FrameTimes  # times of the frames
    warnings: tuple[str, ...]  # warnings of the reader
    size: tuple[int, int]  # width and height of the picture in px
    again: Bools  # shape (n,); frames that seem to repeat the previous one


class FilmTracker:
    """Tracker of all bodies in a film; it depends on the scene alone, so copies can track parts in parallel."""

    def __init__(self, scene: Scene, samples: Samples) -> None:
        keep_out = 1.25 * scene.disc.radius + 1.0 if scene.disc else 0.0
        self.bodies = {
            b: BodyTracker(
                b,
                scene.of(b),
                samples,
                scene.axis(b),
                keep_out + float(np.hypot(*scene.offsets.get(b, (0.0, 0.0)))),
                BATCH,
                scene.offsets.get(b, (0.0, 0.0)),
            )
            for b in scene.bodies
        }
        self.textures = {
            b: TextureTracker(scene.axis(b), max(m.outer for m in scene.of(b)), samples.size, BATCH)
            for b in scene.bodies
            if b == "casing"
        }
        self.disc = DiscWindow(scene.disc, BATCH) if scene.disc else None
        self.centre = scene.centre
        self._offsets = {b: scene.offsets.get(b, (0.0, 0.0)) for b in scene.bodies}
        self.size = samples.size
        self.filled = 0
        self._new = True
        self._fresh, self._again = True, False
        self.held: list[Frame] = []
        self.steps: list[float] = []
        self.again = np.zeros(BATCH, dtype=np.bool_)
        self.repeats: RepeatDetector | None = None
        self.pending_step = 0.0
        self.hold = int(np.clip(HELD_BYTES // (1.5 * samples.frames[0].y.size), 8, HOLD))

    @property
    def maps(self) -> list[AngleMap]:
        """The maps of illumination and occlusion, which are common to the whole film."""
        return [angle_map for body in self.bodies.values() for angle_map in body.maps]

    @property
    def full(self) -> bool:
        """Whether enough frames are held to be tracked."""
        return len(self.held) == min(self.hold, BATCH - self.filled)

    def keep(self, frame: Frame, step: float, *, stamped: bool) -> None:
        """Hold the next frame of the film until enough frames are held.

        `step` is the time from the previous frame in frame periods. A frame that repeats the previous one shows the
        same moment. It replaces a missing frame, so its step is added to the step of the next frame. Regular repeats in
        a film that is not timed by its timestamps (not `stamped`) were inserted; their steps are not added. Frames are
        not compared while the bodies hardly turn.
        """
        again = self.repeats is not None and self.repeats.same(frame)
        again = again and max(body.step for body in self.bodies.values()) > SLOW
        inserted = self.repeats is not None and self.repeats.regular and not stamped
        self.again[self.filled + len(self.held)] = again
        self.held.append(frame)
        self.steps.append(0.0 if again else step + self.pending_step)
        self.pending_step = self.pending_step + step if again and not inserted else 0.0

    def take(self) -> None:
        """Track the bodies in the held frames, and store the windows of their markers."""
        advance = np.array(self.steps)
        if self.filled == 0 and self.disc is not None:
            self.disc.centre_on(self.centre, self.held[0])
            if self._new:  # the hub may have moved after the samples of the scene
                self.disc.take(self.held, 0)
                self._move(self.disc.centres(len(self.held)))
        self._new = False
        for body in self.bodies.values():
            body.take(self.held, self.filled, advance)
        if self.disc is not None:
            self.disc.take(self.held, self.filled)
        displacement = self._hub_displacement()
        for name, texture in self.textures.items():
            coarse = self.bodies[name].coarse(self.filled, len(self.held))
            texture.take(self.held, self.filled, coarse, displacement)
        self.filled += len(self.held)
        self.held.clear()
        self.steps.clear()

    def _hub_displacement(self) -> Floats | None:
        """Return the displacement of the hub in the held frames, (n, 2) [px]; None unless it moves fast.

        A ring that is sampled about a wrong centre is blurred, and its response to the centre is not linear.
        """
        if self.disc is None:
            return None
        shift = self.disc.centres(self.filled + len(self.held), self.filled) - self.centre
        if not moves_fast(shift):
            return None
        known, at = np.isfinite(shift).all(axis=1), np.arange(len(shift))
        return np.stack([np.interp(at, at[known], part[known]) for part in shift.T], axis=1)

    def learn_batch(self) -> None:
        """Estimate templates, illumination and occlusion from the stored frames, which are measured later."""
        self._fresh, self._again = False, True
        casing: Floats | None = None
        for name, body in self.bodies.items():
            coarse, _ = body.measure_batch(self.filled, casing, again=False)
            casing = coarse if name == "casing" else casing

    def measure_batch(self) -> Rows:
        """Measure the frames stored since the last call; one row per frame of every quantity."""
        if self._fresh:  # the first frames are also measured to learn the maps
            self.learn_batch()
        rows: Rows = {"again": self.again[: self.filled].copy()}
        if self.repeats is not None:
            self.repeats.copy_last()
        casing: Floats | None = None
        for name, body in self.bodies.items():
            coarse, markers = body.measure_batch(self.filled, casing, again=self._again)
            rows[f"{name}/coarse"] = coarse
            for marker, seen in markers.items():
                rows |= {
                    f"{name}/{marker}/{f.name}": getattr(seen, f.name) for f in fields(MarkerObservations)
                }
            if name == "casing":
                casing = coarse
            if name in self.textures:
                texture = self.textures[name]
                about = texture.centres(self.filled)
                rings = texture.measure(self.filled, _by_markers(coarse, markers, body, about))
                for kind, ring in zip(RINGS, rings, strict=True):
                    rows |= {
                        f"{name}/{kind}/{f.name}": getattr(ring, f.name) for f in fields(TextureObservations)
                    }
        if self.disc is not None:
            rows["disc"] = self.disc.centres(self.filled)
            self._move(rows["disc"])
        self.filled, self._again = 0, False
        return rows

    def _move(self, centres: Floats) -> None:
        recent = centres[np.isfinite(centres).all(axis=1)][-32:]
        if len(recent) < 8:
            return
        x, y = np.median(recent, axis=0)
        if np.hypot(x - self.centre[0], y - self.centre[1]) > _MOVE:
            self.centre = (float(x), float(y))
            for name, body in self.bodies.items():
                dx, dy = self._offsets[name]
                body.centre_on((self.centre[0] + dx, self.centre[1] + dy))
                if name in self.textures:
                    self.textures[name].centre = (self.centre[0] + dx, self.centre[1] + dy)


def _by_markers(
    coarse: Floats, markers: dict[str, MarkerObservations], body: BodyTracker, about: Floats
) -> Floats:
    """Return the apparent angle of a body (n,) about the centres (n, 2) [px].

    The angle is the mean over its unoccluded markers, or the coarse angle.
    """
    off = []
    for m, seen in markers.items():
        here = seen.open & np.isfinite(seen.angle)
        x, y = (seen.position(here) - about).T
        off.append(np.where(here, np.arctan2(-y, x) - coarse - body.markers[m].marker.mount, np.nan))
    ahead = np.mod(np.stack(off) + np.pi, 2.0 * np.pi) - np.pi
    known = np.isfinite(ahead) & (np.abs(ahead) < REACH)
    total = np.where(known, ahead, 0.0).sum(axis=0)
    return np.asarray(coarse + total / np.maximum(known.sum(axis=0), 1))
