"""Tracking quality of a case."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import short
from gyrotrack.plotting._style import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    WIDTH,
    Picture,
    canvas,
    failing,
    legend,
    look,
    panel,
    picture,
    plain,
    thin,
    zero,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from gyrotrack.io._records import Case, Placement, Recording
    from gyrotrack.plotting._study_data import CaseView


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


COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY)
_MOST_POINTS = 800
_MOST_CLIPS = 12


def sigma_picture(tracks: Tracks, view: CaseView, name: str) -> Picture:
    """Draw the standard deviation of the angles over time."""
    from matplotlib.ticker import LogLocator

    bodies = sorted({s.body for s in tracks.sigmas})
    with look():
        figure = canvas(WIDTH, 3.2)
        ax = figure.subplots()
        failing(ax, view, "casing")
        for body, colour, style in zip(bodies, COLOURS, ("-", "--"), strict=False):
            for i, s in enumerate(x for x in tracks.sigmas if x.body == body):
                time, value = thin(s.time, 1e3 * s.value, _MOST_POINTS)
                label = body if i == 0 else None
                ax.plot(time, value, color=colour, linewidth=0.7, linestyle=style, label=label)
        ax.set_yscale("log")
        ax.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("{x:g}")
        ax.set_xlabel("time [s]")
        ax.set_ylabel(r"$\sigma$ of the angle [mrad]")
        ax.margins(x=0.01)
        legend(ax)
        return picture(name, figure, _sigma_caption(), sigma_finding(tracks.sigmas))


def _sigma_caption() -> str:
    return (
        "One standard deviation of each angle as tracking gives it, from how far its markers agree and how "
        "sharp they are; the smallest and the largest in each bin are drawn."
    )


def sigma_finding(sigmas: tuple[Sigma, ...]) -> str:
    """Return how well the angles are known."""
    parts = []
    for body in sorted({s.body for s in sigmas}):
        medians = [1e3 * s.median for s in sigmas if s.body == body and np.isfinite(s.median)]
        if medians:
            low, high = short(min(medians), 2), short(max(medians), 2)
            parts.append(f"the {body}'s angle to {low if low == high else f'{low} to {high}'} mrad")
    return f"A frame gives {' and '.join(parts)} (median of each clip)." if parts else "No sigma is known."


def centre_picture(tracks: Tracks, view: CaseView, name: str) -> Picture:
    """Draw how the centre moves: against time, and in the plane."""
    with look():
        figure = canvas(WIDTH, 3.4)
        left, right = figure.subplots(1, 2, width_ratios=[2.2, 1])
        failing(left, view, "casing")
        for centre, colour in zip(tracks.centres[:_MOST_CLIPS], COLOURS * 2, strict=False):
            label = plain(centre.clip, 20)
            for axis, dashes in ((0, "-"), (1, ":")):
                drawn = thin(centre.time, centre.place[:, axis], _MOST_POINTS)
                left.plot(
                    *drawn, color=colour, linestyle=dashes, linewidth=0.8, label=None if axis else label
                )
            few = centre.place[:: max(1, len(centre.place) // _MOST_POINTS)]
            right.plot(few[:, 0], few[:, 1], color=colour, linewidth=0.5, alpha=0.8)
        zero(left)
        left.set_xlabel("time [s]")
        left.set_ylabel("x (full), y (dotted) [px]")
        left.margins(x=0.01)
        legend(left, ncols=3)
        right.set_aspect("equal", "datalim")
        right.set_xlabel("x [px]")
        right.set_ylabel("y [px]")
        panel(right, "", "in the picture")
        return picture(
            name,
            figure,
            "The centre of the gyroscope in each clip against its median place: the small circular motion of "
            "the paper, which tracking follows and takes out of the angles.",
            centre_finding(tracks.centres),
        )


def centre_finding(centres: tuple[Centre, ...]) -> str:
    """Return how far the centre strays."""
    worst = max(centres, key=lambda c: np.nan_to_num(c.rms))
    return f"The centre strays by {short(worst.rms, 2)} px rms at most, in {worst.clip}."


def sync_picture(tracks: Tracks, name: str) -> Picture:
    """Draw where the clips lie on the clock of the case, and how well that is known."""
    spans = tracks.spans[:_MOST_CLIPS]
    with look():
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
        return picture(name, figure, _sync_caption(spans), sync_finding(tracks.spans))


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
        "When each clip was taken on the clock of the casing's camera, with one standard deviation of its "
        "start; hatched: another start cannot be excluded." + (f" Method: {methods}." if methods else "")
    )


def sync_finding(spans: tuple[Span, ...]) -> str:
    """Return how well the clips are placed."""
    doubtful = [s.clip for s in spans if s.ambiguous]
    known = [s.sigma for s in spans if s.sigma > 0]
    text = f"{len(spans)} clips on one clock"
    if known:
        text += f", their starts known to {short(1e3 * max(known), 2)} ms or better"
    if doubtful:
        return f"{text}; ambiguous: {', '.join(doubtful)}."
    return f"{text}; no start is ambiguous."
