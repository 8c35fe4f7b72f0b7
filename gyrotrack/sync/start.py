"""Where a clip lies on the casing's clock: its start, its clock rate and its camera's direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrotrack.dataset.records import Floats

TURN = 2 * np.pi


@dataclass(frozen=True)
class Start:
    """Where a clip lies: t_A = offset + (1 + eps) t_B, psi_A = psi_B + angle."""

    offset: float
    eps: float
    angle: float

    def moments(self, time: Floats) -> Floats:
        """Return times of the clip's clock on the casing's clock [s]."""
        return self.offset + (1 + self.eps) * time


def on_lattice(starts: Sequence[Start], turns: Sequence[int | None]) -> list[Start]:
    """Give the clips with a turn number one offset, up to their turns, without moving them in angle."""
    common = next(s.angle - TURN * m for s, m in zip(starts, turns, strict=True) if m is not None)
    return [
        s if m is None else replace(s, angle=common + TURN * m) for s, m in zip(starts, turns, strict=True)
    ]


def moved(point: Sequence[Start], step: Floats) -> list[Start]:
    """Return the starts of clips after a step in (offset, eps, angle) of all of them, (3 k,)."""
    return [
        Start(s.offset + step[3 * k], s.eps + step[3 * k + 1], s.angle + step[3 * k + 2])
        for k, s in enumerate(point)
    ]
