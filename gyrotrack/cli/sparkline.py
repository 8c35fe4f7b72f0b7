"""A curve in one line of text, and marks below it: for terminals, and for pipes that know only ASCII."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BLOCKS, _PLAIN = "▁▂▃▄▅▆▇█", "_.,-~=+#"
WIDTH = 64


def sparkline(value: Array, *, width: int = WIDTH) -> str:
    """Return a curve as one line: in each place the value that is farthest from zero, lowest to highest.

    Values that are no numbers leave a space.
    """
    levels = _levels()
    edges = np.linspace(0, len(value), min(width, len(value)) + 1).astype(int)
    chosen = [_farthest(value[a:b]) for a, b in pairwise(edges)]
    known = np.array([c for c in chosen if np.isfinite(c)])
    if not len(known):
        return " " * len(chosen)
    low, span = float(known.min()), float(known.max() - known.min()) or 1.0
    return "".join(levels[min(7, int(8 * (c - low) / span))] if np.isfinite(c) else " " for c in chosen)


def marks(stretches: Sequence[tuple[float, float]], start: float, stop: float, *, width: int = WIDTH) -> str:
    """Return a line with ``^`` below the stretches of time from `start` to `stop`."""
    line = [" "] * width
    span = (stop - start) or 1.0
    for a, b in stretches:
        first, last = (int(width * (t - start) / span) for t in (a, b))
        for i in range(max(0, first), min(width - 1, last) + 1):
            line[i] = "^"
    return "".join(line)


def _farthest(part: Array) -> float:
    known = part[np.isfinite(part)]
    return float(known[np.argmax(np.abs(known))]) if len(known) else float("nan")


def _levels() -> str:
    try:
        _BLOCKS.encode(sys.stdout.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return _PLAIN
    return _BLOCKS
