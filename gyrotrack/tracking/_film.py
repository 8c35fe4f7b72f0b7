"""The luma of a film's frames, for trackers that go through a film several times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrotrack.tracking._shake import Shake
from gyrotrack.video._decoder import Reader

Plane = npt.NDArray[np.uint8]

_HELD = 600_000_000
"""Largest size of the decoded pictures that are kept in memory [bytes]."""


class Film:
    """The luma of a film's frames, kept in memory where it fits, else decoded again for each pass.

    Parameters
    ----------
    path : Path
        The film.
    threads : int
        Threads of the decoder.
    most : int, optional
        Largest number of frames that are read.
    """

    def __init__(self, path: Path, threads: int = 2, most: int | None = None) -> None:
        self.path = path
        self._threads = threads
        self._shake: Shake | None = None
        self._kept: list[Plane] | None = []
        held = 0
        seen: list[Plane] = []
        self.repeats: list[bool] = []
        before: npt.NDArray[np.int16] | None = None
        changes = []
        with Reader(path, threads) as reader:
            for frame in islice(reader, most):
                plane = np.ascontiguousarray(frame.y)
                small = plane[::4, ::4].astype(np.int16)
                changes.append(255.0 if before is None else float(np.mean(np.abs(small - before))))
                before = small
                held += plane.nbytes
                if held <= _HELD:
                    seen.append(plane.copy())
            self.info = reader.info
            self.stamps = reader.pts_seconds()
            self.warnings = reader.warnings
        self._kept = seen if held <= _HELD else None
        self.changes = np.array(changes)
        self.count = len(changes)

    def __len__(self) -> int:
        return self.count

    def stabilise(self, shake: Shake | None) -> None:
        """Compensate the motion of the camera in all frames from now on; None: do not."""
        self._shake = shake

    def frames(self, first: int = 0, stop: int | None = None) -> Iterator[Plane]:
        """Yield the luma of the frames from `first` to before `stop`."""
        stop = self.count if stop is None else min(stop, self.count)
        if self._kept is not None:
            for index, plane in enumerate(self._kept[first:stop], first):
                yield self._still(plane, index)
            return
        with Reader(self.path, self._threads) as reader:
            for frame in reader:
                if frame.index >= stop:
                    return
                if frame.index >= first:
                    yield self._still(np.ascontiguousarray(frame.y), frame.index)

    def _still(self, plane: Plane, index: int) -> Plane:
        return plane if self._shake is None else self._shake.stabilised(plane, index)

    def some(self, index: Sequence[int] | npt.NDArray[np.int64]) -> list[Plane]:
        """Return chosen frames, in the order of their numbers."""
        if self._kept is not None:
            return [self._still(self._kept[i], int(i)) for i in index]
        wanted = {int(i) for i in index}
        return [f.copy() for i, f in enumerate(self.frames(0, max(wanted) + 1)) if i in wanted]


def fresh_frames(film: Film) -> npt.NDArray[np.int64]:
    """Return the numbers of the frames that do not repeat the previous frame."""
    change = film.changes
    usual = float(np.median(change[1:])) if len(change) > 1 else 0.0
    return np.flatnonzero(~(change < 0.1 * usual)).astype(np.int64) if usual > 0 else np.arange(len(change))
