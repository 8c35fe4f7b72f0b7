"""The angles of a film during tracking, stored in bounded memory, and their motion for the charts.

A film is tracked in parts, several parts at a time. The angles of each part are unwrapped separately, then joined in
the same way as in the recording. The parts come from the running command, or from the checkpoint of an interrupted
command.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrotrack.io._atomic import Record
from gyrotrack.tracking._association import find_rotation_sense, net_turn
from gyrotrack.tracking._film_parts import turns_between

Array = NDArray[np.float64]
Part = dict[str, tuple[Array, Array]]  # frames, and angles as seen by the camera [rad], by body
Piece = tuple[Array, Array, Array]  # time [s], angle [rad], speed [rad/s]

MOST = 4000  # largest number of samples that are kept per film
_WIDTH = 9  # number of samples of the running median of a speed


class GrowingMotion:
    """The angles that a running command has reported: for all frames, or for every n-th frame of a long film."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._every = 1
        self._parts: dict[tuple[int, str], tuple[list[int], list[float]]] = {}
        self._kept = 0
        self.reported = 0  # number of frames so far; an increase indicates new angles to a page

    def add(self, report: Mapping[str, Any]) -> None:
        """Add the angles of some frames of a part; if a frame is reported again, the part is restarted."""
        frames, angles = [int(f) for f in report["frame"]], [float(a) for a in report["angle"]]
        with self._lock:
            key = int(report["part"]), str(report["body"])
            held = self._parts.setdefault(key, ([], []))
            if held[0] and frames and frames[0] <= held[0][-1]:
                self._kept -= len(held[0])
                held = self._parts[key] = [], []
            for frame, angle in zip(frames, angles, strict=True):
                if frame % self._every == 0:
                    held[0].append(frame)
                    held[1].append(angle)
                    self._kept += 1
            self.reported += len(frames)
            while self._kept > MOST:
                self._thin()

    def _thin(self) -> None:
        self._every *= 2
        for key, (frames, angles) in self._parts.items():
            pairs = [(f, a) for f, a in zip(frames, angles, strict=True) if f % self._every == 0]
            self._parts[key] = [f for f, _ in pairs], [a for _, a in pairs]
        self._kept = sum(len(frames) for frames, _ in self._parts.values())

    def parts(self) -> list[Part]:
        """Return the parts in the order of the film."""
        found: dict[int, Part] = {}
        with self._lock:
            for (part, body), (frames, angles) in sorted(self._parts.items()):
                if frames:
                    found.setdefault(part, {})[body] = np.array(frames, dtype=np.float64), np.array(angles)
        return list(found.values())


def stored_parts(records: Iterable[Record]) -> list[Part]:
    """Return the finished parts in the checkpoint of a film, in the order of the film."""
    parts = sorted(
        (r for r in records if isinstance(r.facts.get("part"), int) and "stamps" in r.arrays),
        key=lambda r: int(r.facts["part"]),
    )
    known = np.unique(np.concatenate([p.arrays["stamps"] for p in parts])) if parts else np.zeros(0)
    tick = max(float(np.median(np.diff(known))), 1e-9) if len(known) > 1 else 1.0
    every = 1 + len(known) // MOST
    found = []
    for part in parts:
        frame = np.rint(np.asarray(part.arrays["stamps"], dtype=np.float64) / tick)
        some = frame % every == 0
        columns = {key.partition("/")[0]: a for key, a in part.arrays.items() if key.endswith("/coarse")}
        found.append({b: (frame[some], np.asarray(a, dtype=np.float64)[some]) for b, a in columns.items()})
    return found


# the angle of a single body keeps the sign that the camera sees
_SENSES = {"single": 1}


def joined_motion(parts: Iterable[Part], rate: float) -> dict[str, list[Piece]]:
    """Return the motion of each body in the parts of a film, with angles that continue from one part to the next.

    `rate` is the frame rate [1/s]. The first angle is zero. As in a recording with markers, the angles increase.
    """
    found: dict[str, list[tuple[Array, Array]]] = {}
    last: dict[str, tuple[Array, Array]] = {}
    for part in parts:
        for body, (frame, seen) in part.items():
            angle = seen
            if body in last:
                angle = angle + turns_between(*last[body], frame, angle)
            last[body] = frame, angle
            known = np.isfinite(angle)
            if known.sum() > _WIDTH:
                found.setdefault(body, []).append((frame[known] / rate, angle[known]))
    begin = {b: p[0][1][0] for b, p in found.items()}
    turns = {b: net_turn(np.concatenate([a for _, a in p])) for b, p in found.items()}
    sense = find_rotation_sense(turns, next((_SENSES[b] for b in found if b in _SENSES), None))
    return {b: [(t, sense * (a - begin[b]), speed(t, sense * a)) for t, a in p] for b, p in found.items()}


def speed(time: Array, angle: Array) -> Array:
    """Return the running median of the differences of the angle [rad/s]."""
    steps = np.diff(angle) / np.maximum(np.diff(time), 1e-12)
    padded = np.pad(np.append(steps, steps[-1]), _WIDTH // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, _WIDTH), axis=1))
