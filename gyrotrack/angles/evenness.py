"""How even a motion is: smooth paths, straight lines, and windows that hold whole turns."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.local import local_fit

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

HALF_WINDOW = 20
"""Frames to each side over which a body's motion is taken to be a parabola."""


def smooth_path(coarse: Floats) -> Floats:
    """Smooth a coarse path, so that departures from it are departures from an even motion.

    Local parabolas replace it wherever they stay within 0.3 rad of it, so that turns are kept.
    """
    known = np.isfinite(coarse)
    if known.sum() < 8:
        return coarse
    trend = line_through(coarse)
    smooth, _ = local_fit(coarse - trend, known.astype(float), HALF_WINDOW)
    near = np.abs(smooth + trend - coarse) < 0.3
    return np.where(known, np.where(near, smooth + trend, coarse), np.nan)


def learning_window(path: Floats) -> tuple[int, int]:
    """Return half width and degree of the local polynomials against which repeating errors are learnt.

    A little more than a turn to each side, so that an error that repeats with the turn is not taken for
    motion; and never so short that an error is followed which creeps because the turn and the film's rate
    are in step.
    """
    step = np.abs(np.diff(path))
    step = step[np.isfinite(step)]
    typical = float(np.median(step)) if len(step) else 0.0
    half = int(np.clip(1.2 * 2.0 * np.pi / max(typical, 1e-3), 3 * HALF_WINDOW, 6 * HALF_WINDOW))
    return half, 3


def whole_turns(path: Floats, half: int) -> Mask:
    """Return where `half` frames to both sides hold a whole turn, so that what repeats with it shows.

    Nowhere in a path of less than two turns: a place that was passed once tells nothing of what repeats there.
    """
    known = path[np.isfinite(path)]
    if len(known) == 0 or np.ptp(known) < 4.0 * np.pi:
        return np.zeros(len(path), dtype=np.bool_)
    ahead, behind = np.roll(path, -half), np.roll(path, half)
    swept = np.abs(ahead - behind)
    swept[:half] = 2.0 * np.abs(ahead - path)[:half]
    swept[len(path) - half :] = 2.0 * np.abs(path - behind)[len(path) - half :]
    return np.asarray(np.nan_to_num(swept) > 2.0 * np.pi)


def line_through(path: Floats) -> Floats:
    """Return the straight line through a path, to keep numbers small."""
    known = np.isfinite(path)
    if known.sum() < 2:
        return np.zeros(len(path))
    index = np.arange(len(path), dtype=np.float64)
    return np.asarray(np.polyval(np.polyfit(index[known], path[known], 1), index))
