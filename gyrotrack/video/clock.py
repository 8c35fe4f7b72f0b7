"""When a frame was captured: the capture rate, and what the time stamps give away.

A frame's time is its index divided by the capture rate. Slow-motion films are stored at a lower rate than
they were captured with, so a container's rate below 100 fps is never taken for the capture rate by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack.errors import VideoError
from gyrotrack.video.container import ClipInfo

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


def stamp_warnings(pts: npt.NDArray[np.float64], fps: float) -> tuple[str, ...]:
    """Find missing and repeated time stamps.

    Parameters
    ----------
    pts : ndarray, shape (n,)
        Time stamps in s, NaN where a frame has none.
    fps : float
        Nominal rate of the container. The true spacing is taken from the stamps (their median).

    Notes
    -----
    A step counts as a gap only beyond 1.5 periods: containers with a 1 ms clock jitter by half a period.
    """
    stamps = pts[np.isfinite(pts)]
    if len(stamps) < 3:
        return () if len(pts) < 3 else ("the film has no time stamps",)
    step = np.diff(stamps)
    period = float(np.median(step)) if not np.isfinite(fps) or fps <= 0 else 1.0 / fps
    if period <= 0.0:
        return ("the film's time stamps do not grow",)
    found = []
    # Each step is judged with its neighbours' rounding taken out: two half-period errors are no gap.
    lost = np.rint(step / period).astype(int) - 1
    gaps = np.flatnonzero((lost >= 1) & (step > 1.5 * period + 1.1e-3))
    if len(gaps):
        found.append(
            f"time stamps show {int(lost[gaps].sum())} missing frames at {len(gaps)} places, "
            f"the first after frame {int(gaps[0])}; times count decoded frames"
        )
    if np.any(step <= 0.0):
        found.append(f"{int(np.sum(step <= 0.0))} time stamps do not grow")
    return tuple(found)
