"""Confirmation of repeated frames by the motion of the bodies.

Two pictures may be equal because nothing turns. A frame counts as a repetition, and is not measured, if a body has not
moved although its typical step clearly exceeds the scatter. The motion in the next frame shows why the frame was
repeated. If the body moves by two steps in the next frame, the repetition replaces a missing frame, and the times of
all other frames are correct. Otherwise the repetition was inserted between two frames of the camera, for example by a
conversion to a higher rate, and the frames are numbered without the repetition.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrotrack._arrays import Bools, Floats
from gyrotrack._smoothing import median_of
from gyrotrack.tracking._association import net_turn
from gyrotrack.tracking._film_tracker import FilmObservations
from gyrotrack.tracking._fusion import wrapped
from gyrotrack.tracking._marker_tracker import plausible
from gyrotrack.tracking._scene import Scene
from gyrotrack.video._container import ClipInfo
from gyrotrack.video._decoder import REGULAR
from gyrotrack.video._time_base import LIVE, CaptureRate, FrameTimes

AROUND = 20
"""Number of frames to each side from which the typical step of a body is determined [frames]. Chosen: a smaller number
gives a noisy step, a larger one includes a change of the speed."""
CLEAR = 6.0
"""A repetition is detected if the typical step of a body, in standard deviations of its steps, exceeds this value [1].
Derived: a body counts as unmoved below half a step, which is then at least three standard deviations."""
FEWEST = 4
"""A scatter is computed from at least this number of steps, and a period from at least this number of runs of repeated
frames [1]. Chosen: a smaller number gives a random scatter, a larger one leaves repeats undetected."""


@dataclass(frozen=True)
class Repetition:
    """The repeated frames of a film."""

    again: Bools  # shape (n,); frames that repeat the previous one
    inserted: bool = False  # whether repeats were inserted between frames of the camera
    # period of the runs of repeated frames [frames], NaN if they are not regular
    period: float = float("nan")

    @property
    def original_share(self) -> float:
        """Share of the camera's original frames among all frames, if frames are repeated regularly."""
        run = float(self.again.sum()) / max(len(_runs(self.again)), 1)
        return 1.0 - run / self.period


def turning_most(seen: FilmObservations) -> str:
    """Return the name of the body that turns most."""
    return max(seen.bodies, key=lambda name: abs(net_turn(seen.bodies[name].coarse)))


def seen_angle(seen: FilmObservations, scene: Scene, name: str) -> Floats:
    """Return the mean angle of a body from its plausible markers, (n,) [rad]; NaN without plausible markers."""
    body = seen.bodies[name]
    total, count = np.zeros((2, len(body.coarse)))
    for marker in scene.of(name):
        observations = body.markers[marker.name]
        good = plausible(observations) & observations.open & np.isfinite(body.coarse)
        total += np.where(good, wrapped(np.nan_to_num(observations.angle - marker.mount - body.coarse)), 0.0)
        count += good
    return body.coarse + np.where(count > 0, total / np.maximum(count, 1), np.nan)


def judge_repeats(seen: FilmObservations, scene: Scene) -> Repetition:
    """Use the motion of the bodies to confirm the frames that seem repeated, and to determine their origin."""
    again = seen.again.copy()
    if not again.any() or not seen.bodies:
        return Repetition(again & False)
    steps = [_Steps(seen_angle(seen, scene, name), seen.again) for name in seen.bodies]
    for k in np.flatnonzero(again):
        answers = [body.still(int(k)) for body in steps if body.around(int(k))[1]]
        again[k] = True in answers or (None in answers and False not in answers)
    runs = _runs(again)
    shares = [share for body in steps for share in body.shares(runs)]
    return Repetition(again, len(shares) > 0 and median_of(np.array(shares)) < 0.5, _period(runs))


class _Steps:
    """Steps of an angle between frames that are not repeated."""

    def __init__(self, angle: Floats, again: Bools) -> None:
        self.angle = angle
        self._fresh = np.flatnonzero(~again)
        self._steps = np.diff(angle[self._fresh])

    def around(self, frame: int) -> tuple[float, bool]:
        """Return the median step in the frames around a frame, and whether this step is significant."""
        place = int(np.searchsorted(self._fresh, frame))
        known = self._steps[max(place - AROUND, 0) : place + AROUND]
        known = known[np.isfinite(known)]
        if len(known) < FEWEST:
            return float("nan"), False
        usual = median_of(known)
        return usual, abs(usual) > CLEAR * (1.4826 * median_of(np.abs(known - usual)) + 1e-6)

    def still(self, frame: int) -> bool | None:
        """Return whether the body has not moved since the previous frame; None unless it is seen in both frames."""
        step = abs(self.angle[frame] - self.angle[frame - 1])
        return bool(step < 0.5 * abs(self.around(frame)[0])) if np.isfinite(step) else None

    def shares(self, runs: list[tuple[int, int]]) -> list[float]:
        """Return the additional motion across each run, divided by the number of repeated frames, in typical steps.

        The additional motion is the motion from the frame before the run to the frame after it, minus one typical step.
        """
        found = []
        for first, after in runs:
            usual, clear = self.around(first)
            over = self.angle[after] - self.angle[first - 1] if after < len(self.angle) else np.nan
            if clear and np.isfinite(over):
                found.append((over / usual - 1.0) / (after - first))
        return found


def _period(runs: list[tuple[int, int]]) -> float:
    """Return the period of the runs [frames], NaN if they are not regular."""
    first = np.array([run[0] for run in runs])
    if len(first) < FEWEST:
        return float("nan")
    apart = np.diff(first)
    regular = (np.abs(apart - np.median(apart)) <= 1.0).mean() > REGULAR
    return float(np.polyfit(np.arange(len(first)), first, 1)[0]) if regular else float("nan")


def _runs(again: Bools) -> list[tuple[int, int]]:
    """Return the runs of repeated frames as (first, last + 1)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], again, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def left_out(seen: FilmObservations, times: FrameTimes) -> FilmObservations:
    """Return the observations without the repeated frames."""
    if times.again is None:
        return replace(seen, times=times)
    fresh, count = np.flatnonzero(~times.again), len(times.again)
    bodies = {name: body.picked(fresh).spread_out(fresh, count) for name, body in seen.bodies.items()}
    return replace(seen, bodies=bodies, times=times)


def without_repeats(
    times: FrameTimes, found: Repetition, rate: CaptureRate, info: ClipInfo
) -> tuple[FrameTimes, CaptureRate]:
    """Add a warning about repeated frames, and number the frames without inserted repeats.

    A regular conversion preserves the duration of a film. If the given capture rate is the frame rate of the file, it
    is multiplied by the share of original frames. Any other capture rate is taken as the rate of the original frames.
    """
    if not found.again.any():
        return times, rate
    count, first = int(found.again.sum()), int(np.argmax(found.again))
    warning = f"{count} frames repeat the previous frame (the first is frame {first}) and are omitted."
    if not found.inserted:
        warning += (
            " The repeats replace missing frames: in the frame after each repeat the bodies have moved by more than "
            "one step."
        )
    elif times.place is not None:
        warning += (
            " In the frame after a repeat the bodies have moved by one step only, so the timestamps are not those of "
            "the camera. Use --times frames to compute the times from the number of frames without repeats."
        )
    else:
        times = replace(times, number=times.number - np.cumsum(found.again))
        rate, more = _slower(rate, found, info)
        warning += (
            " The times are computed from the number of frames without repeats: in the frame after a repeat the bodies "
            f"have moved by one step only. {more}"
        )
    return replace(times, again=found.again, warnings=(*times.warnings, warning)), rate


def _slower(rate: CaptureRate, found: Repetition, info: ClipInfo) -> tuple[CaptureRate, str]:
    """Return the capture rate of a film with inserted frames, and a warning about it."""
    stored, true = info.container_fps, info.container_fps * found.original_share
    of_file = abs(rate.fps / stored - 1.0) < min(LIVE, np.nan_to_num(abs(rate.fps / true - 1.0), nan=np.inf))
    if of_file and np.isfinite(true):
        warning = (
            f"A film of {true:.5g} frames/s was converted to {stored:.5g}; times are from the original rate."
        )
        return CaptureRate(true, "repeated frames"), warning
    hint = " If that is not the rate of the camera, give it with --capture-fps." if of_file else ""
    return rate, f"The rate of the frames that are not repeats is assumed to be {rate.fps:g} frames/s.{hint}"
