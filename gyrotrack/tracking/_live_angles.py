"""Angles of a film during tracking, for programs that display them; no result depends on these reports.

Trackers report the angles of frames as soon as they are found. A `Sink` that is set with `angles_sent_to` receives the
angles in the process that found them. Because other processes track some parts of a film, the sink must be picklable.
Without a sink nothing happens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from gyrotrack._arrays import Floats, Integers

Sink = Callable[[str, int, Integers, Floats], object]
"""Called with a body, the first frame of a part, frame numbers (n,) in the part, and angles as seen (n,) [rad].

Angles are unwrapped within a part. A frame number that is not larger than the previous one shows that the tracking of
the part has restarted.
"""

_sink: ContextVar[Sink | None] = ContextVar("sink", default=None)
_TOGETHER = 16
"""Number of frames in one report of a tracker that measures frame by frame [frames]. Chosen: a smaller number costs
time, a larger one delays the display."""


@contextmanager
def angles_sent_to(sink: Sink | None) -> Iterator[None]:
    """Send all angles found within the context to `sink`."""
    token = _sink.set(sink)
    try:
        yield
    finally:
        _sink.reset(token)


def current_sink() -> Sink | None:
    """Return the sink of this thread, for its worker processes."""
    return _sink.get()


def set_sink(sink: Sink | None) -> None:
    """Set the sink of a worker process."""
    _sink.set(sink)


def report_angles(body: str, part: int, frames: Integers, angles: Floats) -> None:
    """Send angles (n,) [rad] of frames (n,) to the sink, if there is one; frames without an angle are NaN."""
    sink = _sink.get()
    known = np.isfinite(angles)
    if sink is not None and known.any():
        sink(body, part, np.asarray(frames)[known], angles[known])


class FrameAngles:
    """Reports the angles of a body that is tracked frame by frame, some frames together."""

    def __init__(self, body: str) -> None:
        self._body = body
        self._frames: list[int] = []
        self._angles: list[float] = []

    def add(self, frame: int, angle: float) -> None:
        """Add the angle [rad] of a frame to the next report."""
        self._frames.append(frame)
        self._angles.append(angle)
        if len(self._frames) == _TOGETHER:
            report_angles(self._body, 0, np.array(self._frames), np.array(self._angles))
            self._frames.clear()
            self._angles.clear()
