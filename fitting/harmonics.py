"""Once and twice a turn: what stands in step with the measured angle, and how much of it wanders."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HARMONICS = 4
_MIN_INDEPENDENCE = 0.2


def independent_harmonics(y: Array, polynomials: Array) -> Array:
    """Return cos y, sin y, cos 2y, sin 2y, with zeros for those that are nearly polynomials here.

    In less than a turn a harmonic says nothing of its own; what is left of it beside the polynomials would
    be the noise of y itself, which must not be taken for a signal. Of a casing at rest nothing else is left.
    """
    waves = np.stack([np.cos(y), np.sin(y), np.cos(2 * y), np.sin(2 * y)], axis=1)
    r = np.abs(np.diag(np.linalg.qr(np.concatenate([polynomials, waves], axis=1), mode="r")))
    keep = r[polynomials.shape[1] :] > _MIN_INDEPENDENCE * np.sqrt(len(y) / 2)
    return np.asarray(np.where(keep, waves, 0.0))


def restlessness(rows: Array) -> Array:
    """Return by how much harmonics change from block to block beyond the noise, at least 1.

    An artefact of tracking that wanders (a centre that is smoothed, a marker cut by the codec) does so from
    block to block; what physics does to the harmonics is smooth in time and passes the second difference.
    """
    if len(rows) < 12:
        return np.ones(rows.shape[1])
    second = np.abs(rows[2:] - 2 * rows[1:-1] + rows[:-2]) / np.sqrt(6.0)
    size = np.median(second, axis=0) / 0.6745
    pairs = np.sqrt(0.5 * (size[0::2] ** 2 + size[1::2] ** 2))
    return np.asarray(np.maximum(1.0, np.repeat(pairs, 2)))
