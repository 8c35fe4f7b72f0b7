"""What tracking made of each clip, on the clock of the case: uncertainties, the motion of the centre, the clocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gyrotrack.dataset import Case, Placement, Recording

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sigma:
    """Standard deviation of a body's angle in one clip [rad], against the time of the case [s]."""

    clip: str
    body: str
    time: Array
    value: Array

    @property
    def median(self) -> float:
        """Its median, nan if there is none."""
        known = self.value[np.isfinite(self.value)]
        return float(np.median(known)) if len(known) else float("nan")


@dataclass(frozen=True)
class Centre:
    """Where the centre lies against its median [px], shape (n, 2), and how far it strays (rms) [px]."""

    clip: str
    time: Array
    place: Array

    @property
    def rms(self) -> float:
        """Root of the mean square distance from the median place."""
        known = self.place[np.isfinite(self.place).all(axis=1)]
        return float(np.sqrt(np.mean(np.sum(known**2, axis=1)))) if len(known) else float("nan")


@dataclass(frozen=True)
class Span:
    """When a clip was taken on the clock of the case [s], how well that is known, and whether it is ambiguous."""

    clip: str
    start: float
    stop: float
    sigma: float
    rate: float
    rate_sigma: float
    ambiguous: bool
    method: str


@dataclass(frozen=True)
class Tracks:
    """All clips of one case."""

    sigmas: tuple[Sigma, ...]
    centres: tuple[Centre, ...]
    spans: tuple[Span, ...]


def tracks_of(case: Case) -> Tracks | None:
    """Return what tracking made of the clips of a case; None if it was not made from clips."""
    sigmas, centres, spans = [], [], []
    for key, r in case.recordings.items():
        placement = case.placements.get(key)
        if placement is None or not len(r.time):
            continue
        time = on_clock(placement, r.time)
        sigmas += [
            Sigma(r.source, name, on_clock(placement, b.time), b.sigma)
            for name, b in r.bodies.items()
            if len(b.time)
        ]
        centres.append(Centre(r.source, time, _about_median(r)))
        spans.append(
            Span(
                r.source,
                float(time[0]),
                float(time[-1]),
                placement.clock_offset_sigma,
                placement.clock_rate,
                placement.clock_rate_sigma,
                placement.ambiguous,
                placement.method,
            )
        )
    return Tracks(tuple(sigmas), tuple(centres), tuple(spans)) if spans else None


def on_clock(placement: Placement, time: Array) -> Array:
    """Return times of a clip on the clock of its case."""
    return placement.clock_offset + placement.clock_rate * time


def _about_median(recording: Recording) -> Array:
    known = recording.centre[np.isfinite(recording.centre).all(axis=1)]
    return recording.centre - (np.median(known, axis=0) if len(known) else 0.0)
