"""Counting the turns in wrapped angles, by predicting each sample from the speed around it."""

from __future__ import annotations

import numpy as np

from gyrotrack.angles import median_smooth
from gyrotrack.dataset.records import Floats

TURN = 2 * np.pi
GAP = 20.0
_SMOOTHING = 31


def is_wrapped(angle: Floats) -> bool:
    """Tell whether all angles lie within one turn, as wrapped ones do."""
    return bool(np.ptp(angle) <= TURN * (1 + 1e-6))


def pieces(time: Floats) -> list[slice]:
    """Return the pieces between gaps longer than 20 sample intervals."""
    step = np.diff(time)
    if not len(step):
        return [slice(0, len(time))]
    cuts = np.flatnonzero(step > GAP * np.median(step)) + 1
    return [slice(int(a), int(b)) for a, b in zip([0, *cuts], [*cuts, len(time)], strict=True)]


def unwrap(time: Floats, angle: Floats) -> tuple[Floats, list[float]]:
    """Return the angles without steps of a turn, and the times of gaps in which a turn may be lost.

    The speed is the running median of the wrapped differences of neighbours, which must be less than half a
    turn apart; integrated, it predicts every sample, also across gaps, and whole turns are added to bring
    the sample next to the prediction. A gap of length T is doubtful if the speed changes across it by so much
    that the prediction may be off by a radian: |change| T / 8 > 1.
    """
    step = np.diff(time)
    turned = np.angle(np.exp(1j * np.diff(angle)))
    near = step < 1.5 * np.median(step)
    middle = (time[1:] + time[:-1])[near] / 2
    speed = np.interp(time, middle, median_smooth(turned[near] / step[near], _SMOOTHING))
    increment = (speed[1:] + speed[:-1]) / 2 * step
    prediction = np.concatenate([[0.0], np.cumsum(increment)])
    unwrapped = np.unwrap(angle - prediction) + prediction
    doubtful = np.abs(np.diff(speed)) * step / 8 > 1
    return unwrapped, [float(t) for t in time[:-1][doubtful]]
