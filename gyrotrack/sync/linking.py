"""Which parameters the clips of one camera share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyrotrack.dataset.records import Floats


def link_matrix(*, common_rate: bool, shared_angle: Sequence[bool]) -> Floats:
    """Return the matrix from free parameters to (offset, eps, angle) of every clip."""
    clips = len(shared_angle)
    columns = []
    for k, shared in ((0, [False] * clips), (1, [common_rate] * clips), (2, list(shared_angle))):
        each = np.zeros((3 * clips, clips))
        each[3 * np.arange(clips) + k, np.arange(clips)] = 1
        together = np.asarray(shared)
        columns.append(each[:, ~together])
        if together.any():
            columns.append(each[:, together].sum(axis=1, keepdims=True))
    return np.hstack(columns)
