"""The time base of a film: when each frame was captured.

The timestamps of a film in real time come from the camera. The timestamps of a film in slow motion are for playback,
and an editor may have changed them. If timestamps are equally spaced, the times are computed from frame numbers; the
result is the same.

In a film with a constant rate, the time of a frame is its index divided by the capture rate. Slow-motion films are
stored at a lower rate than their capture rate, so a container's rate below 100 fps is never taken as the capture rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrotrack._arrays import Bools, Floats, Integers
from gyrotrack._errors import UsageError, VideoError
from gyrotrack._smoothing import local_fit
from gyrotrack.video._container import ClipInfo

SLOWEST_PLAIN_RATE = 100.0
"""Container rate below which a film may be in slow motion and the capture rate must be given [1/s]. Chosen: slow motion
is stored at 24 to 60 fps; a smaller value takes slow motion for real time, a larger one requires the rate
needlessly."""


@dataclass(frozen=True)
class CaptureRate:
    """Frames per second of the camera, the origin of this rate, and warnings for the user."""

    fps: float
    source: str
    warnings: tuple[str, ...] = ()


def capture_rate(info: ClipInfo, requested: float | None = None, profile: float | None = None) -> CaptureRate:
    """Return the capture rate [1/s] from the first source that states it.

    The sources are, in this order, the request, the profile, the tag of the camera, and the container (if it has at
    least 100 fps).
    """
    for fps, source in (
        (requested, "--capture-fps"),
        (profile, "profile"),
        (info.tag_fps, "tag of the camera"),
    ):
        if fps is not None:
            if not (np.isfinite(fps) and fps > 0.0):
                raise VideoError(f"A capture rate of {fps:g} fps is not possible.", "Give a positive number.")
            return CaptureRate(float(fps), source, _differences(info, float(fps), source))
    if not np.isfinite(info.container_fps) or info.container_fps < SLOWEST_PLAIN_RATE:
        rate = f"{info.container_fps:g} fps" if np.isfinite(info.container_fps) else "an unknown rate"
        what = f"{info.path} is stored at {rate} and does not state at what rate it was captured."
        raise VideoError(what, "Give the rate of the camera with --capture-fps.")
    return CaptureRate(info.container_fps, "container")


_SAME_RATE = 1.0e-3
"""Largest relative difference of two rates that count as equal [1]. Chosen: a smaller value warns of rounded rates, a
larger one hides a wrong rate."""


def _differences(info: ClipInfo, fps: float, source: str) -> tuple[str, ...]:
    found = []
    if np.isfinite(info.container_fps) and abs(fps / info.container_fps - 1.0) > _SAME_RATE:
        found.append(
            f"The container plays at {info.container_fps:g} fps; "
            f"times are from the capture rate of {fps:g} fps ({source})."
        )
    if info.tag_fps is not None and abs(fps / info.tag_fps - 1.0) > _SAME_RATE:
        found.append(f"The tag of the camera states {info.tag_fps:g} fps, not {fps:g} fps.")
    return tuple(found)


COARSEST_TICK = 1e-3
"""Largest unit of timestamps for which a jitter of one unit is accepted between frames [s]. Chosen: whole milliseconds
are common; with a smaller value, timestamps in whole ms count as uneven, and with a larger one, missing frames remain
undetected."""


def frame_numbers(pts: Floats, tick: float = COARSEST_TICK) -> Integers:
    """Return the numbers of a film's frames from their timestamps (n,) [s] (NaN where missing).

    At a gap, the numbers of the missing frames are skipped. `tick` is the unit of the timestamps [s]. If it is larger
    than 1 ms, the tolerance is computed for 1 ms. The period is the median spacing. A step is a gap only if it is
    longer than 1.5 periods and longer than one period plus 1.1 ticks, because timestamps in whole ticks jitter by one
    tick: in Matroska (1 ms) a single missing frame cannot be detected above 900 frames/s.

    Frames are numbered without gaps in three cases. First, timestamps are missing. Second, the timestamps are not
    equally spaced: more than one step in ten is not a whole number of periods. Third, the timestamps do not increase:
    more than one step in a hundred is not positive (AVI stores the order of decoding, not of display).
    """
    plain = np.arange(len(pts), dtype=np.int64)
    step = np.diff(pts)
    period = float(np.median(step[np.isfinite(step)])) if np.isfinite(step).any() else 0.0
    if len(pts) < 3 or period <= 0.0 or not np.isfinite(pts).all():
        return plain
    ratio, jitter = step / period, 1.1 * min(tick, COARSEST_TICK)
    if _uneven(step, tick) or (step <= 0.0).mean() > 0.01:
        return plain
    gap = (step > 1.5 * period) & (step > period + jitter)
    advance = np.where(gap, np.rint(ratio), 1.0).astype(np.int64)
    return np.concatenate([[0], np.cumsum(advance)])


def _uneven(step: Floats, tick: float) -> bool:
    """Return whether more than one in ten steps between timestamps is not a whole number of periods."""
    period = float(np.median(step))
    off = np.abs(step / period - np.rint(step / period)) * period
    return bool((off > np.maximum(0.2 * period, 1.1 * min(tick, COARSEST_TICK))).mean() > 0.1)


def gap_warnings(number: Integers) -> tuple[str, ...]:
    """Return a warning about missing frames, from the numbers of the frames that are present."""
    advance = np.diff(number)
    gaps = np.flatnonzero(advance > 1)
    warnings = (
        f"The timestamps show {int((advance - 1).sum())} missing frames at {len(gaps)} places, "
        f"the first after frame {int(gaps[0]) if len(gaps) else 0}; the times contain these gaps."
    )
    return (warnings,) if len(gaps) else ()


def stamp_warnings(pts: Floats) -> tuple[str, ...]:
    """Return a warning about timestamps (n,) [s] that are missing (NaN) or do not increase."""
    if len(pts) < 3:
        return ()
    stamps = pts[np.isfinite(pts)]
    if len(stamps) < len(pts):
        return (
            f"{len(pts) - len(stamps)} frames have no timestamp; times are counted from the decoded frames.",
        )
    backwards = int(np.sum(np.diff(stamps) <= 0.0))
    counted = "; times are counted from the decoded frames" if backwards > 0.01 * (len(stamps) - 1) else ""
    return (f"{backwards} timestamps do not increase{counted}.",) if backwards else ()


SOURCES = ("auto", "stamps", "frames")
LIVE = 0.05
"""Largest relative difference between the rate of the timestamps and the capture rate in a film that was not slowed
down [1]. Chosen: a smaller value discards timestamps of a camera with a varying rate, a larger one uses timestamps of
an edited film."""
EVEN = 5e-3
"""Largest residual of equally spaced timestamps about a line, or `_ROUNDED` ticks if these are longer [periods].
Chosen: a smaller value takes jitter for a varying rate; with a larger one, the frames of a camera with a varying rate
are counted."""
_ROUNDED = 0.75
"""Largest residual of rounded timestamps [ticks]. Derived: half a tick, plus a margin of a quarter."""
_ODD = 0.01
"""Largest share of wrong timestamps [1]. Chosen: a smaller value discards timestamps because of single errors, a larger
one uses damaged timestamps."""
_HALF = 20
"""Number of timestamps before and after a frame that a local fit uses [frames]. Chosen: a smaller number leaves
jitter, a larger one smooths a change of the rate."""


@dataclass(frozen=True)
class FrameTimes:
    """Times of the frames of a film."""

    number: Integers  # shape (n,); numbers of the frames; numbers of missing frames are skipped
    # shape (n,); times of the frames from the timestamps, multiplied by the capture rate; None if the frames are
    # counted
    place: Floats | None = None
    # standard deviation of a place, due to the tick of the timestamps; independent between frames
    sigma: float = 0.0
    # shape (n,); the smoothed places, which are used if the jitter is not due to the camera; None if the jitter is not
    # larger than rounding errors
    smooth: Floats | None = None
    warnings: tuple[str, ...] = ()  # for the user
    again: Bools | None = None  # shape (n,); frames that repeat the previous frame; None if there are none

    def even(self) -> FrameTimes:
        """Return the smoothed times, with a warning."""
        if self.place is None or self.smooth is None:
            return self
        warnings = (
            *self.warnings,
            "The markers move steadily while the stamps jitter; the stamps are smoothed.",
        )
        return replace(self, place=self.smooth, sigma=0.0, smooth=None, warnings=warnings)

    def at(self, index: Integers) -> FrameTimes:
        """Return the times of the frames `index`. No frame among them may repeat another frame."""
        some = (None if a is None else a[index] for a in (self.place, self.smooth))
        return FrameTimes(self.number[index], next(some), self.sigma, next(some), self.warnings)

    def seconds(self, fps: float) -> Floats:
        """Return the times [s] at a capture rate, (n,).

        A repeated frame with the number of the previous frame was inserted by a conversion. Its time is between the
        times of its neighbours.
        """
        time = np.asarray((self.number if self.place is None else self.place) / fps)
        if self.again is not None and self.place is None:
            same = self.again & (np.diff(self.number, prepend=-1) == 0)
            run = np.arange(len(same)) - np.maximum.accumulate(np.where(same, 0, np.arange(len(same))))
            time = np.where(same, time + (1.0 - 0.5**run) / fps, time)
        return time

    @property
    def places(self) -> Floats:
        """Times of the frames in periods 1 / (capture rate), (n,)."""
        return self.number.astype(np.float64) if self.place is None else self.place


@dataclass(frozen=True)
class Timing:
    """Source of the times of a film."""

    source: str  # timestamps ("stamps"), counted frames ("frames"), or a choice for each film ("auto")
    fps: float  # the capture rate in frames/s

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            what = f"Unknown source of times {self.source!r}; use auto, stamps or frames."
            raise UsageError(what, "Omit --times for the default.")

    def of(self, pts: Floats, tick: float) -> FrameTimes:
        """Return the times of frames from their timestamps `pts` (n,) [s]; `tick` is the unit of the timestamps [s].

        Raise a VideoError if the source is "stamps" and timestamps are missing or do not increase.
        """
        step = np.diff(pts)
        grows = len(pts) > 2 and bool(np.isfinite(pts).all())
        grows = grows and float(np.median(step)) > 0.0 and float((step <= 0.0).mean()) <= _ODD
        usable = grows and bool((step > 0.0).all())
        if self.source == "stamps" and not usable:
            what = "Times from timestamps were requested, but timestamps are missing or do not increase."
            raise VideoError(what, "Omit --times to count frames.")
        tick = _real_tick(pts, tick) if grows else tick
        number = frame_numbers(pts, tick)
        varied = grows and uneven(number, pts, tick)
        if self.source == "stamps" or (self.source == "auto" and usable and varied and self._live(pts)):
            return self._stamped(number, pts, tick, varied=varied)
        warnings = (self._counted(pts),) if varied else ()
        return FrameTimes(number, warnings=(*warnings, *gap_warnings(number)))

    def _live(self, pts: Floats) -> bool:
        """Return whether the film was not slowed down: the rate of its timestamps is about the capture rate."""
        step = np.diff(pts)
        return any(abs(self.fps * float(period) - 1.0) < LIVE for period in (np.median(step), step.mean()))

    def _counted(self, pts: Floats) -> str:
        wrong = "times are counted from the decoded frames, and are wrong if the rate of the camera varied"
        if self.source == "frames" or self._live(pts):
            return f"The timestamps are spaced unevenly; {wrong}."
        return (
            f"The timestamps are spaced unevenly. Their mean rate, {_rate(pts)}, is the playback rate of a film in "
            f"slow motion; {wrong}. To use the stamps, scaled to the capture rate, give --times stamps."
        )

    def _stamped(self, number: Integers, pts: Floats, tick: float, *, varied: bool) -> FrameTimes:
        line = np.polyfit(number, pts - pts[0], 1)
        scale = self.fps if self._live(pts) else 1.0 / float(line[0])
        place = (pts - pts[0]) * scale
        if not varied:
            return FrameTimes(number, number * line[0] * scale, warnings=gap_warnings(number))
        warnings = [_stamps_used(pts)]
        if not self._live(pts):
            warnings.append(
                f"The stamps, at {_rate(pts)}, are scaled to the capture rate of {self.fps:g} frames/s."
            )
        best, sigma = _without_rounding(number, place, tick * scale)
        if best is not place:
            return FrameTimes(number, best, sigma, warnings=(*warnings, *gap_warnings(number)))
        smooth = _without_jitter(number, place)
        jitters = float(np.std(place - smooth)) > max(0.5 * tick * scale, EVEN)
        return FrameTimes(number, place, sigma, smooth if jitters else None, tuple(warnings))


def uneven(number: Integers, pts: Floats, tick: float) -> bool:
    """Return whether more than one in a hundred timestamps deviates from a line over the frames' numbers."""
    off = pts - np.polyval(np.polyfit(number, pts, 1), number)
    return bool((np.abs(off) > max(_ROUNDED * tick, EVEN * float(np.median(np.diff(pts))))).mean() > _ODD)


def _real_tick(pts: Floats, tick: float) -> float:
    """Return the unit of the timestamps [s].

    If the container has a finer unit than 1 ms but all timestamps are whole milliseconds, they were copied from another
    container, and the unit is 1 ms.
    """
    whole = (pts - pts[0]) / COARSEST_TICK
    copied = tick < COARSEST_TICK and bool(
        (np.abs(whole - np.rint(whole)) <= 0.51 * tick / COARSEST_TICK).all()
    )
    return COARSEST_TICK if copied else tick


def _smoothed(number: Integers, place: Floats) -> tuple[Floats, float]:
    """Fit a local parabola about each place; return its value there and the weight of the place in this value."""
    line = np.polyval(np.polyfit(number, place, 1), number)
    value, weight = np.zeros((2, int(number[-1]) + 1))
    value[number], weight[number] = place - line, 1.0
    curve, leverage = local_fit(value, weight, _HALF)
    known = np.isfinite(curve[number])
    share = float(np.median(leverage[number][known])) if known.any() else 1.0
    return np.where(known, line + curve[number], place), share


def _without_rounding(number: Integers, place: Floats, tick: float) -> tuple[Floats, float]:
    """Smooth the places to reduce the error of rounding to whole ticks. Return the places and their standard deviation.

    A place rounded to a tick d has the standard deviation d / sqrt(12). After smoothing by a parabola through its
    neighbours, the variance is multiplied by the leverage of the place. Scatter in excess of the rounding error is
    attributed to the parabola. The places remain unchanged if the smoothed places would be less accurate than the
    rounded ones, or if a place would change by more than 1.1 ticks.
    """
    rounding = tick**2 / 12.0
    smooth, share = _smoothed(number, place)
    left = place - smooth
    variance = max(float(np.mean(left**2)) - (1.0 - share) * rounding, 0.0) + share * rounding
    if variance < rounding and float(np.abs(left).max()) <= 1.1 * tick:
        return smooth, float(np.sqrt(variance))
    return place, float(np.sqrt(rounding))


def _without_jitter(number: Integers, place: Floats) -> Floats:
    """Return smoothed places: for a slowly varying rate if the variation is significant, else for a constant rate."""
    smooth, share = _smoothed(number, place)
    line = np.asarray(np.polyval(np.polyfit(number, place, 1), number), dtype=np.float64)
    noise = float(np.std(place - smooth)) * np.sqrt(share)
    return smooth if float(np.std(smooth - line)) > 2.0 * noise else line


def _rate(pts: Floats) -> str:
    return f"{1.0 / float(np.diff(pts).mean()):.4g} frames/s"


def _stamps_used(pts: Floats) -> str:
    short, long = 1e3 * np.percentile(np.diff(pts), [1, 99])
    return (
        f"The timestamps are spaced unevenly ({short:.3g} to {long:.3g} ms), as for a camera whose rate varied; "
        "times are from the stamps."
    )
