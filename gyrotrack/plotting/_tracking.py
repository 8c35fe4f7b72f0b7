"""Figures of tracking: uncertainty of the angles, motion of the centre, synchronisation, contact sheets."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import short
from gyrotrack._errors import GyrotrackError
from gyrotrack.io._schema import STATUS_WORDS
from gyrotrack.plotting._charts import BLUE, VERMILLION, WIDTH, Picture, beside, canvas, markup, plain, style

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
        """Median [rad]; NaN if unknown."""
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
    """Interval of a clip on the clock of the case [s], with the uncertainty of its start."""

    clip: str
    start: float
    stop: float
    sigma: float
    ambiguous: bool
    method: str


@dataclass(frozen=True)
class Tracks:
    """All clips of one case."""

    sigmas: tuple[Sigma, ...]
    centres: tuple[Centre, ...]
    spans: tuple[Span, ...]


def tracks_of(case: Case) -> Tracks | None:
    """Return the tracking quality of the clips of a case; None without clips."""
    sigmas, centres, spans = [], [], []
    for key, r in case.recordings.items():
        placement = case.placements.get(key)
        if placement is None or not len(r.time):
            continue
        time = on_clock(placement, r.time)
        for name, b in r.bodies.items():
            if len(b.time):
                sigmas.append(Sigma(r.source, name, on_clock(placement, b.time), b.sigma))
        centres.append(Centre(r.source, time, _about_median(r)))
        ends, sigma = (float(time[0]), float(time[-1])), placement.clock_offset_sigma
        spans.append(Span(r.source, *ends, sigma, placement.ambiguous, placement.method))
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
    if not parts:
        return "The standard uncertainty of the angles is unknown."
    return f"Standard uncertainty of an angle, median of each clip: {', '.join(parts)}."


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
            colour, hatch = (VERMILLION, "////") if s.ambiguous else (BLUE, "")
            options: dict[str, Any] = {"color": colour, "hatch": hatch, "edgecolor": "white"}
            ax.barh(i, max(s.stop - s.start, 1e-9), left=s.start, height=0.55, **options)
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
        beside(ax, text + ("  AMBIGUOUS" if s.ambiguous else ""), (s.stop, i), 5, fontsize=9.5)


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


_FRAMES = 6
_WIDTH = 320
_QUALITY = 78


@dataclass(frozen=True)
class Tile:
    """One frame as JPEG, with a description."""

    jpeg: bytes
    text: str

    @property
    def url(self) -> str:
        """The picture as a data URL."""
        return "data:image/jpeg;base64," + base64.b64encode(self.jpeg).decode("ascii")


@dataclass(frozen=True)
class Sheet:
    """Frames of one clip."""

    clip: str
    tiles: tuple[Tile, ...]


def contact_sheets(
    case: Case, folders: Sequence[Path], intervals: Iterable[tuple[float, float]] = ()
) -> list[Sheet]:
    """Return frames of the clips whose films are found, including the middle of each interval [s]."""
    wanted = list(intervals)
    sheets = []
    for key, r in list(case.recordings.items())[:_MAX_CLIPS]:
        tiles = _tiles(r, case.placements.get(key), folders, wanted)
        if tiles:
            sheets.append(Sheet(r.source, tuple(tiles)))
    return sheets


def _tiles(
    r: Recording,
    placement: Placement | None,
    folders: Sequence[Path],
    intervals: Sequence[tuple[float, float]],
) -> list[Tile]:
    from gyrotrack.plotting._frames import Film, find_film

    path = find_film(r, list(folders))
    if path is None:
        return []
    tiles = []
    try:
        with Film(path, r) as film:
            for index in _selected_frames(r, placement, intervals):
                picture = film.picture(index)
                if picture is not None:
                    tiles.append(Tile(jpeg(picture, _WIDTH), _description(r, placement, index)))
    except GyrotrackError:  # an unreadable film must not prevent the report
        return tiles
    return tiles


def jpeg(
    picture: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], width: int, quality: int = _QUALITY
) -> bytes:
    """Return a picture (BGR) as JPEG, downscaled to `width` if it is wider."""
    import cv2

    if picture.shape[1] > width:
        height = max(1, round(picture.shape[0] * width / picture.shape[1]))
        picture = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())


def _selected_frames(
    r: Recording, placement: Placement | None, intervals: Sequence[tuple[float, float]]
) -> list[int]:
    """Return frames evenly distributed over the clip; the nearest ones are replaced by the middle of each interval."""
    spread = [int(i) for i in np.linspace(0, len(r.time) - 1, min(_FRAMES, len(r.time)))]
    if placement is None or not spread:
        return spread
    time = on_clock(placement, r.time)
    middles = [0.5 * (a + b) for a, b in intervals]
    inside = [int(np.argmin(np.abs(time - m))) for m in middles if time[0] <= m <= time[-1]]
    for index in inside[: _FRAMES // 2]:
        nearest = min(range(1, len(spread) - 1), key=lambda k: abs(spread[k] - index), default=0)
        spread[nearest] = index
    return sorted(set(spread))


def _description(r: Recording, placement: Placement | None, index: int) -> str:
    time = r.time[index] if placement is None else on_clock(placement, r.time)[index]
    markers = ", ".join(
        f"{m.name} {STATUS_WORDS.get(int(m.status[index]), 'unknown')}" for m in r.markers.values()
    )
    return f"frame {index}, {time:.3f} s: {markers}"
