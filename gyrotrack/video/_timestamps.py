"""Timestamps of a film against its capture rate.

A frame's time is its index divided by the capture rate. Slow-motion films are stored at a lower rate than
they were captured with, so a container's rate below 100 fps is never taken for the capture rate by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import VideoError
from gyrotrack.video._container import ClipInfo

SLOWEST_PLAIN_RATE = 100.0
"""Container rates [fps] below this may be slow motion, and need a word about the capture rate."""


@dataclass(frozen=True)
class CaptureRate:
    """Frames per second of the camera, where that number is from, and what to tell the user."""

    fps: float
    source: str
    warnings: tuple[str, ...] = ()


def capture_rate(info: ClipInfo, asked: float | None = None, profile: float | None = None) -> CaptureRate:
    """Decide the capture rate: asked for, else the profile's, else the camera's tag, else the container's.

    Raises
    ------
    VideoError
        If nothing but a container rate below 100 fps is known, or a rate is not a positive number.
    """
    for fps, source in ((asked, "asked for"), (profile, "profile"), (info.tag_fps, "tag of the camera")):
        if fps is not None:
            if not (np.isfinite(fps) and fps > 0.0):
                raise VideoError(f"a capture rate of {fps:g} fps is not possible", "give a positive number")
            return CaptureRate(float(fps), source, _differences(info, float(fps), source))
    if not np.isfinite(info.container_fps) or info.container_fps < SLOWEST_PLAIN_RATE:
        rate = f"{info.container_fps:g} fps" if np.isfinite(info.container_fps) else "no rate"
        raise VideoError(
            f"{info.path} is stored at {rate} and does not say at what rate it was captured",
            "give the camera's rate with --capture-fps",
        )
    return CaptureRate(info.container_fps, "container")


def _differences(info: ClipInfo, fps: float, source: str) -> tuple[str, ...]:
    found = []
    if np.isfinite(info.container_fps) and abs(fps / info.container_fps - 1.0) > 1.0e-3:
        found.append(
            f"the container plays at {info.container_fps:g} fps; "
            f"times are from the capture rate of {fps:g} fps ({source})"
        )
    if info.tag_fps is not None and abs(fps / info.tag_fps - 1.0) > 1.0e-3:
        found.append(f"the camera's own tag says {info.tag_fps:g} fps, not {fps:g}")
    return tuple(found)


COARSEST_TICK = 1e-3
"""Unit of timestamps in s beyond which a container counts frames, not time."""


def frame_numbers(pts: npt.NDArray[np.float64], tick: float = COARSEST_TICK) -> npt.NDArray[np.int64]:
    """Return the numbers of a film's frames by their timestamps, without those of missing frames.

    Parameters
    ----------
    pts : ndarray, shape (n,)
        Timestamps in s, in order, NaN where a frame has none.
    tick : float
        Unit of the timestamps in s; 1 ms at most counts.

    Notes
    -----
    The period is the median spacing. A step counts as a gap only beyond 1.5 periods and 1.1 ticks more than one,
    because stamps in whole ticks jitter by one: in Matroska (1 ms) a single missing frame cannot be told above 900
    frames/s. Films whose stamps are not evenly spaced
    otherwise (one step in ten is no whole number of periods), or that do not grow (one step in a hundred; AVI knows
    only when a frame is decoded, not when it is shown), are numbered without gaps.
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


def _uneven(step: npt.NDArray[np.float64], tick: float) -> bool:
    """Tell whether more than one step between timestamps in ten is no whole number of periods."""
    period = float(np.median(step))
    off = np.abs(step / period - np.rint(step / period)) * period
    return bool((off > np.maximum(0.2 * period, 1.1 * min(tick, COARSEST_TICK))).mean() > 0.1)


def gap_warnings(number: npt.NDArray[np.int64]) -> tuple[str, ...]:
    """Tell of missing frames by the numbers of the others."""
    advance = np.diff(number)
    gaps = np.flatnonzero(advance > 1)
    told = (
        f"timestamps show {int((advance - 1).sum())} missing frames at {len(gaps)} places, "
        f"the first after frame {int(gaps[0]) if len(gaps) else 0}; their times are left out"
    )
    return (told,) if len(gaps) else ()


def stamp_warnings(pts: npt.NDArray[np.float64]) -> tuple[str, ...]:
    """Tell of timestamps (n,) [s] that are missing (NaN) or do not grow."""
    if len(pts) < 3:
        return ()
    stamps = pts[np.isfinite(pts)]
    if len(stamps) < len(pts):
        return (f"{len(pts) - len(stamps)} frames have no timestamp; times count decoded frames",)
    backwards = int(np.sum(np.diff(stamps) <= 0.0))
    counted = "; times count decoded frames" if backwards > 0.01 * (len(stamps) - 1) else ""
    return (f"{backwards} timestamps do not grow{counted}",) if backwards else ()
