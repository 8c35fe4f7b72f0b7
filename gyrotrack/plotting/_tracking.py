"""Tracking quality of a case: uncertainty of the angles, motion of the centre, synchronisation of the clips."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import short
from gyrotrack.plotting._style import BLUE, VERMILLION, WIDTH, Picture, canvas, markup, plain, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from gyrotrack.io._records import Case, Placement, Recording


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sigma:
    """Standard uncertainty of the angle of a body in one clip [rad], against the time of the case [s]."""

    clip: str
    body: str
    time: Array
    value: Array

    @property
    def median(self) -> float:
        """Median; NaN if it is unknown."""
        known = self.value[np.isfinite(self.value)]
        return float(np.median(known)) if len(known) else float("nan")


@dataclass(frozen=True)
class Centre:
    """Centre in the image minus its median [px], `place` of shape (n, 2), against time [s]."""

    clip: str
    time: Array
    place: Array

    @property
    def rms(self) -> float:
        """Root mean square distance from the median [px]."""
        known = self.place[np.isfinite(self.place).all(axis=1)]
        return float(np.sqrt(np.mean(np.sum(known**2, axis=1)))) if len(known) else float("nan")


@dataclass(frozen=True)
class Span:
    """Interval of a clip on the clock of the case [s], with the uncertainty of its start and rate."""

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
    """Return the tracking quality of the clips of a case; None if it has no clips."""
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


_MAX_CLIPS = 12


def sigma_finding(sigmas: tuple[Sigma, ...]) -> str:
    """Return the standard uncertainty of the angles as a sentence."""
    parts = []
    for body in sorted({s.body for s in sigmas}):
        medians = [1e3 * s.median for s in sigmas if s.body == body and np.isfinite(s.median)]
        if medians:
            low, high = short(min(medians), 2), short(max(medians), 2)
            parts.append(f"{body} {low if low == high else f'{low} to {high}'} mrad")
    return (
        f"Standard uncertainty of an angle, median of each clip: {', '.join(parts)}." if parts else "Unknown."
    )


def centre_finding(centres: tuple[Centre, ...]) -> str:
    """Return the size of the motion of the centre as a sentence."""
    worst = max(centres, key=lambda c: np.nan_to_num(c.rms))
    return f"Motion of the centre: {short(worst.rms, 2)} px rms at most ({worst.clip})."


def sync_picture(tracks: Tracks, name: str) -> Picture:
    """Draw the intervals of the clips on the clock of the case, with the uncertainty of their starts."""
    spans = tracks.spans[:_MAX_CLIPS]
    with style():
        figure = canvas(WIDTH, 0.9 + 0.42 * len(spans))
        ax = figure.subplots()
        for i, s in enumerate(spans):
            colour = VERMILLION if s.ambiguous else BLUE
            ax.barh(
                i,
                max(s.stop - s.start, 1e-9),
                left=s.start,
                height=0.55,
                color=colour,
                hatch="////" if s.ambiguous else "",
                edgecolor="white",
            )
        room = (max(s.stop for s in spans) - min(s.start for s in spans)) or 1.0
        ax.set_xlim(min(s.start for s in spans) - 0.02 * room, max(s.stop for s in spans) + 0.34 * room)
        _notes(ax, spans)
        ax.set_yticks(range(len(spans)), [plain(s.clip, 24) for s in spans])
        ax.invert_yaxis()
        ax.set_xlabel("time [s]")
        ax.grid(visible=False, axis="y")
        finding = sync_finding(tracks.spans)
        return Picture(name, markup(figure, name, finding), _sync_caption(spans), finding)


def _notes(ax: Axes, spans: tuple[Span, ...]) -> None:
    for i, s in enumerate(spans):
        text = "reference clock" if s.sigma == 0 else f"start ± {short(1e3 * s.sigma, 2)} ms"
        ax.annotate(
            text + ("  AMBIGUOUS" if s.ambiguous else ""),
            (s.stop, i),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=9.5,
        )


def _sync_caption(spans: tuple[Span, ...]) -> str:
    methods = "; ".join(dict.fromkeys(s.method for s in spans if s.sigma > 0))
    return (
        "Clips on the clock of the casing camera, with the standard uncertainty of their start; hatched: ambiguous "
        "start." + (f" Method: {methods}." if methods else "")
    )


def sync_finding(spans: tuple[Span, ...]) -> str:
    """Return the uncertainty of the starts of the clips as a sentence."""
    doubtful = [s.clip for s in spans if s.ambiguous]
    known = [s.sigma for s in spans if s.sigma > 0]
    text = f"{len(spans)} clips on one clock"
    if known:
        text += f", standard uncertainty of a start at most {short(1e3 * max(known), 2)} ms"
    if doubtful:
        return f"{text}; ambiguous: {', '.join(doubtful)}."
    return f"{text}; no start is ambiguous."
