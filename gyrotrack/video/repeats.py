"""Frames that show the picture of the one before them once more, because a camera or a converter filled in.

An encoder has next to nothing to say of such a frame, so that small packets are suspects, and only these are looked
at. Where every picture is stored by itself the packets tell nothing, and all frames are looked at.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.video.packets import Packets
from gyrotrack.video.planes import Frame

SMALL = 0.35
"""Share of the usual packet around it below which one is a suspect."""
SAME = 0.25
"""Share of the difference between two frames before it that a repeated frame may show: noise is repeated with it."""
_AROUND = 31
_LARGE = 80
_ROWS = 48
_FEWEST = 4

Samples = npt.NDArray[np.int16]


class Repeats:
    """Tells of each frame of a film in turn whether it repeats the one before it.

    Parameters
    ----------
    packets : Packets
        Of the whole film.
    """

    def __init__(self, packets: Packets) -> None:
        small = _small(packets)
        told = packets.complete and not packets.key.all()
        # of two pictures that are alike the second may be stored first, in full; a key packet tells nothing
        near = np.concatenate(
            [small, np.minimum(small + 1, len(packets.stamps) - 1), np.flatnonzero(packets.key)]
        )
        self.suspects: frozenset[int] | None = frozenset(packets.stamps[near].tolist()) if told else None
        self.regular = told and _regular(small)
        self.held: list[Frame] = []
        self._last: Samples | None = None
        self._before: Samples | None = None
        self._usual = 0.0
        self._run = False

    def same(self, frame: Frame) -> bool:
        """Tell whether a frame, the next one of the film, repeats the one before it."""
        again = False
        if self.suspects is None or frame.pts in self.suspects:
            last, before = self._earlier()
            if last is not None and before is not None:
                if not self._run:
                    self._usual = _difference(last, before)
                again = _difference(_samples(frame), last) < SAME * self._usual
        self._run = again
        self.held = [*self.held[-1:], frame]
        return again

    def settle(self) -> None:
        """Let go of the frames, so that all that is needed of them can be kept."""
        self._last, self._before = self._earlier()
        self.held = []

    def _earlier(self) -> tuple[Samples | None, Samples | None]:
        """Return samples of the last frame and of the one before it, as far as these are known."""
        last, before, *_ = (*(_samples(frame) for frame in reversed(self.held)), self._last, self._before)
        return last, before


def _samples(frame: Frame) -> Samples:
    """Return some rows of the luma from the middle of a picture."""
    height = len(frame.y)
    return np.asarray(frame.y[height // 8 : height - height // 8 : max(height // _ROWS, 1)], dtype=np.int16)


def _difference(one: Samples, other: Samples) -> float:
    return float(np.abs(one - other).mean())


def _small(packets: Packets) -> npt.NDArray[np.int64]:
    """Return which packets are much smaller than the larger ones around them, key frames apart."""
    from scipy.ndimage import percentile_filter

    if len(packets.size) < _AROUND or packets.key.all():
        return np.zeros(0, dtype=np.int64)
    size = np.where(packets.key, 0, packets.size)
    usual = percentile_filter(size, _LARGE, size=_AROUND, mode="nearest")
    return np.flatnonzero(~packets.key & (size < SMALL * usual))


def _regular(small: npt.NDArray[np.int64]) -> bool:
    """Tell whether packets are small every so many frames, as after a conversion to another rate."""
    first = small[np.diff(small, prepend=-2) > 1]
    apart = np.diff(first)
    return len(apart) >= _FEWEST and bool((np.abs(apart - np.median(apart)) <= 1.0).mean() > 0.8)
