"""The ghost: the outline of a marker at the angle predicted by a model, drawn together with the real marker.

A fit gives the difference between the measured and the modelled angle at the time of each frame. This difference takes
the clock of the clip and the zero of its angle into account (`fitting.inference._angle_residuals`). The outline of the
marker consists of its two corners near the hub and two outer corners. It is turned about the hub by minus this
difference. If the difference is too small to be visible, it is multiplied by a factor; every picture states the factor.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import short, with_uncertainty
from gyrotrack._errors import OutputError, UsageError
from gyrotrack.io._atomic import new_file, refuse_existing
from gyrotrack.plotting._charts import AFTER, BEFORE
from gyrotrack.plotting._tracking import jpeg, on_clock

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

    from fitting.inference._result import Fit
    from gyrotrack.io._records import Case, MarkerTrack, Recording
    from gyrotrack.plotting._frames import Film
    from gyrotrack.tracking._film_tracker import Progress

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

# length of an outline divided by the distance between its two near corners
_LENGTH = 1.3
# a largest difference below the first number is magnified to about the second number [px at the marker]
_SMALL, _SEEN = 8.0, 16.0
# largest angle of a magnified difference [rad]
_LARGEST = 0.6
_STEPS = (1, 2, 5)
_REAL = (255, 255, 255)


@dataclass(frozen=True)
class Ghost:
    """A body in the n frames of a clip that are within the fitted run, with the outlines of its markers.

    Attributes
    ----------
    clip, body : str
        Key of the clip in its case; the body that is compared, "casing" or "rotor".
    frame : ndarray of int, shape (n,)
        Numbers of the frames.
    time : ndarray, shape (n,)
        Times of the frames on the clock of the case [s].
    models : tuple of str
        Names of the models.
    difference, sigma : ndarray, shape (models, n)
        Measured minus modelled angle, and its standard uncertainty [rad].
    outlines : dict of str to ndarray, shape (n, 4, 2)
        Measured outlines by marker: corner, (x, y) [px]; NaN where the marker was not found.
    hub : ndarray, shape (n, 2)
        Centre of rotation [px].
    sense : {1, -1}
        Ratio of the counter-clockwise angle in the picture to the angle of the body.
    """

    clip: str
    body: str
    frame: NDArray[np.int64]
    time: Array
    models: tuple[str, ...]
    difference: Array
    sigma: Array
    outlines: Mapping[str, Array]
    hub: Array
    sense: int

    def inside(self, start: float, stop: float) -> Ghost:
        """Return the part between two times on the clock of the case [s]."""
        kept = (self.time >= start) & (self.time <= stop)
        return self._part(np.flatnonzero(kept))

    def _part(self, places: NDArray[np.int64]) -> Ghost:
        return replace(
            self,
            frame=self.frame[places],
            time=self.time[places],
            difference=self.difference[:, places],
            sigma=self.sigma[:, places],
            outlines={k: v[places] for k, v in self.outlines.items()},
            hub=self.hub[places],
        )

    @cached_property
    def radius(self) -> float:
        """Median distance of the outlines from the hub [px]; NaN without outlines."""
        places = [np.linalg.norm(o.mean(axis=1) - self.hub, axis=1) for o in self.outlines.values()]
        known = np.concatenate([p[np.isfinite(p)] for p in places]) if places else np.zeros(0)
        return float(np.median(known)) if len(known) else float("nan")

    @cached_property
    def factor(self) -> int:
        """Factor (1, 2, 5, 10 ...) that makes the largest difference of any model visible."""
        largest = float(np.abs(self.difference).max(initial=0.0))
        if not largest > 0 or not np.isfinite(self.radius) or largest * self.radius >= _SMALL:
            return 1
        wanted = min(_SEEN / self.radius, _LARGEST) / largest
        powers = range(int(np.floor(np.log10(max(wanted, 1.0)))) + 2)
        return max(
            s * int(10**p) for p in powers for s in _STEPS if s * 10**p <= max(wanted, 1.0) * (1 + 1e-9)
        )

    def plot(self, ax: Axes, picture: Picture | None = None, *, frame: int = 0, model: int = 0) -> None:
        """Draw one frame with the outlines of the markers and of their ghosts into axes (matplotlib).

        Parameters
        ----------
        ax : matplotlib.axes.Axes
            Where to draw.
        picture : ndarray, shape (height, width, 3), optional
            The frame of the film (RGB).
        frame : int
            Index of the frame among those of this ghost.
        model : int
            Index of the model.
        """
        factor, colour = self.factor, BEFORE if model == 0 else AFTER
        if picture is not None:
            ax.imshow(picture)
        for name, outlines in self.outlines.items():
            for places, shown, wide in (
                (self.turned(name, model, factor), colour, 2.5),
                (outlines, "white" if picture is not None else "black", 1.0),
            ):
                closed = np.concatenate([places[frame], places[frame][:1]])
                ax.plot(*closed.T, color=shown, linewidth=wide)
        hub, reach = self.hub[frame], _VIEW * self.radius
        ax.set_xlim(hub[0] - reach, hub[0] + reach)
        ax.set_ylim(hub[1] + reach, hub[1] - reach)
        ax.set_aspect("equal")
        ax.set_axis_off()
        drawn = f", drawn × {factor}" if factor > 1 else ""
        difference = _angle(float(self.difference[model, frame]))
        ax.set_title(
            f"{self.models[model]}\n{self.time[frame]:.2f} s, {difference}{drawn}", fontsize="medium"
        )

    def turned(self, marker: str, model: int, factor: int = 1) -> Array:
        """Return the outlines of a marker at the angles predicted by a model, (n, 4, 2) [px].

        Parameters
        ----------
        marker : str
            Name of the marker.
        model : int
            Index of the model.
        factor : int
            Factor of the difference.
        """
        return turned(self.outlines[marker], self.hub, -self.sense * factor * self.difference[model])


def turned(places: Array, hub: Array, angle: Array) -> Array:
    """Return points turned about a hub by an angle, counter-clockwise in a picture whose y points down.

    Parameters
    ----------
    places : ndarray, shape (n, points, 2)
        Points (x, y) [px].
    hub : ndarray, shape (n, 2)
        Centre of rotation [px].
    angle : ndarray, shape (n,)
        Angle [rad].
    """
    away = places - hub[:, None]
    c, s = np.cos(angle[:, None]), np.sin(angle[:, None])
    x, y = away[..., 0], away[..., 1]
    return np.asarray(hub[:, None] + np.stack([c * x + s * y, c * y - s * x], axis=-1))


def ghosts(case: Case, fits: Sequence[Fit], names: Sequence[str], index: int = 0) -> list[Ghost]:
    """Return the ghosts of all clips of a case; none for a case that was not filmed.

    Parameters
    ----------
    case : Case
        The case with its clips.
    fits : sequence of Fit
        Fits of the case, the base model first.
    names : sequence of str
        Their names.
    index : int
        Index of the case in the fits.
    """
    record = fits[0].problem.data[index].record
    if record.quantity != "angle" or not case.recordings:
        return []
    runs = [f.angle_residuals(index) for f in fits]
    windows = [int(w) for w in np.unique(case.rotor.window)] if case.rotor.window is not None else []
    places = {"casing": ("casing", 0)} | {f"rotor_{w}": ("rotor", i) for i, w in enumerate(windows, start=1)}
    found = []
    for key in (k for k in case.recordings if k in places):
        body, run = places[key]
        r, placement = case.recordings[key], case.placements.get(key)
        time = r.time if placement is None else on_clock(placement, r.time)
        values = [residuals[run].at(time) for residuals in runs]
        difference, sigma = (np.stack([v[i] for v in values]) for i in (0, 1))
        outlines = _outlines(r, record.parts - {body})
        hub = _filled(r.centre)
        whole = Ghost(
            key, body, np.arange(len(time)), time, tuple(names), difference, sigma, outlines, hub, r.sense
        )
        part = whole._part(np.flatnonzero(np.isfinite(difference).all(axis=0)))  # noqa: SLF001 - its own module
        if len(part.time) and outlines:
            found.append(part)
    return found


def _filled(centre: Array) -> Array:
    """Return the hub of each frame; the median hub where the hub is unknown."""
    known = np.asarray(np.isfinite(centre).all(axis=1))
    middle = np.median(centre[known], axis=0) if known.any() else np.full(2, np.nan)
    return np.where(known[:, None], centre, middle)


def _outlines(r: Recording, others: Set[str]) -> dict[str, Array]:
    """Return the outlines of the markers of a body; for a body without markers, a pointer from its hub.

    Markers of `others`, the other bodies of the case, are omitted.
    """
    markers = [m for m in r.markers.values() if m.body not in others]
    found = {m.name: outline(m, _filled(r.centre), r.sense) for m in markers}
    found = {k: v for k, v in found.items() if np.isfinite(v).any()}
    track = next((b for name, b in r.bodies.items() if name not in others), None)
    if found or track is None:
        return found
    hub = _filled(r.centre)
    reach = np.concatenate([hub, np.array([r.width, r.height]) - hub], axis=1)
    radius = 0.5 * float(np.nanmedian(reach.min(axis=1)))
    if not radius > 0:
        return {}
    angle = np.interp(r.time, track.time, track.angle, left=np.nan, right=np.nan)
    return {"pointer": _canonical(hub, r.sense * angle, radius, 0.15)}


def outline(marker: MarkerTrack, hub: Array, sense: int) -> Array:
    """Return the outline of a marker in each frame, (n, 4, 2) [px]: near corners as found, and two outer corners.

    In frames with an angle but without corners, the corners are those of the median marker at this angle.

    Parameters
    ----------
    marker : MarkerTrack
        The marker.
    hub : ndarray, shape (n, 2)
        Centre of rotation [px].
    sense : {1, -1}
        Factor of the angles in the picture.
    """
    if not np.isfinite(marker.rho).any():
        return np.full((len(hub), 4, 2), np.nan)
    radius, width = float(np.nanmedian(marker.rho)), float(np.nanmedian(marker.delta))
    found = _canonical(hub, sense * marker.angle_fine, radius, width / radius)
    near = marker.corner
    whole = np.asarray(np.isfinite(near).all(axis=(1, 2)))
    ray = near.mean(axis=1) - hub
    ray /= np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9)
    behind = near + _LENGTH * width * ray[:, None]
    exact = np.stack([near[:, 0], near[:, 1], behind[:, 1], behind[:, 0]], axis=1)
    return np.where(whole[:, None, None], exact, found)


def _canonical(hub: Array, angle: Array, radius: float, width: float) -> Array:
    """Return outlines at angles in the picture, of a width [rad] at the radius of the near corners [px]."""
    ray = np.stack([np.cos(angle), -np.sin(angle)], axis=-1)
    across = 0.5 * width * radius * np.stack([-ray[:, 1], ray[:, 0]], axis=-1)
    near = hub + radius * ray
    far = near + _LENGTH * width * radius * ray
    return np.stack([near - across, near + across, far + across, far - across], axis=1)


def ghost_document(ghost: Ghost, model: int = 0, *, factor: int | None = None) -> dict[str, Any]:
    """Return the ghost of one model in the frames of a clip as JSON types.

    Parameters
    ----------
    ghost : Ghost
        The ghost.
    model : int
        Index of the model.
    factor : int, optional
        Factor of the difference; by default the factor that makes it visible.

    Returns
    -------
    dict
        ``clip``, ``body``, ``model`` (its name), ``factor``, ``frames`` (numbers), ``time`` [s], ``difference`` and
        ``u`` [rad] with a value per frame, ``hub`` [[x, y]], and ``markers``: by name ``measured`` and ``ghost``, the
        four corners [[x, y]] [px] in each frame, or null where the marker was not found.
    """
    chosen = ghost.factor if factor is None else factor

    def corners(outlines: Array) -> list[list[list[float]] | None]:
        return [np.round(o, 2).tolist() if np.isfinite(o).all() else None for o in outlines]

    return {
        "clip": ghost.clip,
        "body": ghost.body,
        "model": ghost.models[model],
        "factor": chosen,
        "frames": ghost.frame.tolist(),
        "time": ghost.time.tolist(),
        "difference": ghost.difference[model].tolist(),
        "u": ghost.sigma[model].tolist(),
        "hub": np.round(ghost.hub, 2).tolist(),
        "markers": {
            name: {"measured": corners(o), "ghost": corners(ghost.turned(name, model, chosen))}
            for name, o in ghost.outlines.items()
        },
    }


@dataclass(frozen=True)
class Animation:
    """An animated picture (WebP), a still picture (JPEG) for print, and their caption."""

    webp: bytes
    jpeg: bytes
    finding: str
    caption: str
    width: int
    height: int

    @property
    def url(self) -> str:
        """The animated picture as a data URL."""
        return "data:image/webp;base64," + base64.b64encode(self.webp).decode("ascii")

    @property
    def still_url(self) -> str:
        """The still picture as a data URL."""
        return "data:image/jpeg;base64," + base64.b64encode(self.jpeg).decode("ascii")


# number of frames of an animated picture, duration of a frame [ms], size of one panel [px]
_FRAMES, _DURATION, _PANEL = 24, 160, 240
# margin before and after a time interval, as a share of its length
_AROUND = 0.15
# half the side of a panel divided by the radius of the marker
_VIEW = 1.7
_TOP, _FOOT = 40, 24
_QUALITY = 35


def animation(ghost: Ghost, film: Film, start: float, stop: float) -> Animation | None:
    """Return the ghosts of all models side by side around a stretch of time; None if no frame can be decoded.

    The picture turns with the model, so the ghost of the model is stationary and the real marker moves relative to it.

    Parameters
    ----------
    ghost : Ghost
        The ghosts of a clip.
    film : Film
        Its film, open.
    start, stop : float
        The stretch on the clock of the case [s].
    """
    around = _AROUND * (stop - start)
    part = ghost.inside(start - around, stop + around)
    if not len(part.time) or not np.isfinite(part.radius):
        return None
    places = np.unique(np.linspace(0, len(part.time) - 1, _FRAMES).round().astype(np.int64))
    shown = part._part(places)  # noqa: SLF001 - its own module
    factor = part.factor
    pictures = [
        _panels(shown, i, picture, factor)
        for i, number in enumerate(shown.frame)
        if (picture := film.picture(int(number), overlay=False)) is not None
    ]
    if not pictures:
        return None
    out = io.BytesIO()
    pictures[0].save(
        out,
        "WEBP",
        save_all=True,
        append_images=pictures[1:],
        duration=[_DURATION] * (len(pictures) - 1) + [6 * _DURATION],
        loop=0,
        quality=_QUALITY,
    )
    worst = int(np.argmax(np.abs(shown.difference[0])))
    still = np.asarray(pictures[min(worst, len(pictures) - 1)])[..., ::-1]
    width, height = pictures[0].size
    return Animation(
        out.getvalue(),
        jpeg(np.ascontiguousarray(still), width, 85),
        _finding(part),
        f"{len(pictures)} frames, turned with the model. White: the marker in the film. Coloured: where the model "
        "predicts it."
        + (f" The differences are drawn {factor} times as large as they are." if factor > 1 else ""),
        width,
        height,
    )


def animated(stretch: Stretch) -> Animation | None:
    """Return the animated picture of a stretch; None if its film cannot be read."""
    from gyrotrack._errors import GyrotrackError
    from gyrotrack.plotting._frames import Film

    try:
        with Film(stretch.film, stretch.recording) as film:
            return animation(stretch.ghost, film, stretch.start, stretch.stop)
    except GyrotrackError:  # an unreadable film must not prevent the report
        return None


def _finding(part: Ghost) -> str:
    """Return the largest difference of each model as a sentence."""
    parts = []
    for name, difference, sigma in zip(part.models, part.difference, part.sigma, strict=True):
        worst = int(np.argmax(np.abs(difference)))
        size = with_uncertainty(1e3 * float(difference[worst]), 1e3 * float(sigma[worst]), "mrad")
        parts.append(f"{name} {size}")
    span = f"{part.time[0]:.2f} s to {part.time[-1]:.2f} s"
    return f"{span}, {part.body}: largest difference of the angle, film minus model: {'; '.join(parts)}."


def _angle(value: float) -> str:
    sign = "−" if value < 0 else ""
    size = abs(value)
    return f"{sign}{short(size, 2)} rad" if size >= 0.1 else f"{sign}{short(1e3 * size, 2)} mrad"


def _panels(ghost: Ghost, i: int, picture: Picture, factor: int) -> Image:
    """Return one frame, turned with each model, side by side, with the outlines and a legend."""
    from PIL import Image, ImageDraw

    count = len(ghost.models)
    sheet = Image.new("RGB", (count * (_PANEL + 4) - 4, _TOP + _PANEL + _FOOT), (255, 255, 255))
    draw = ImageDraw.Draw(sheet)
    for model, name in enumerate(ghost.models):
        left = model * (_PANEL + 4)
        sheet.paste(_turned_panel(ghost, i, picture, model, factor), (left, _TOP))
        colour = BEFORE if model == 0 else AFTER
        _write(draw, name, (left, 0), colour, bold=True)
        difference = _angle(float(ghost.difference[model, i]))
        text = f"{ghost.time[i]:.2f} s   {difference}" + (f", drawn × {factor}" if factor > 1 else "")
        _write(draw, text, (left, _TOP + _PANEL + 4), "#333333")
    return sheet


def _turned_panel(ghost: Ghost, i: int, picture: Picture, model: int, factor: int) -> Image:
    """Return a frame turned about the hub so that the ghost of a model points up, with both outlines."""
    import cv2
    from PIL import Image

    first = next(iter(ghost.outlines))
    known = [k for k, o in ghost.outlines.items() if np.isfinite(o[i]).all()]
    hub, scale = ghost.hub[i], 0.5 * _PANEL / (_VIEW * ghost.radius)
    reference = known[0] if known else first
    at = ghost.turned(reference, model, factor)[i].mean(axis=0) - hub if known else np.array([0.0, -1.0])
    # the angle by which the picture is turned, counter-clockwise, brings this direction up
    angle = 0.5 * np.pi - float(np.arctan2(-at[1], at[0]))
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    matrix = np.array([[c, s], [-s, c]])
    shift = 0.5 * _PANEL - matrix @ hub
    shown = cv2.warpAffine(
        picture,
        np.column_stack([matrix, shift]),
        (_PANEL, _PANEL),
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    colour = _rgb(BEFORE if model == 0 else AFTER)[::-1]
    for name in known:
        real = ghost.outlines[name][i] @ matrix.T + shift
        imagined = ghost.turned(name, model, factor)[i] @ matrix.T + shift
        _line(shown, imagined, colour, 3)
        _line(shown, real, _REAL, 1)
    return Image.fromarray(np.ascontiguousarray(shown[..., ::-1]))


def _line(picture: Any, corners: Array, colour: tuple[int, int, int], width: int) -> None:
    import cv2

    # coordinates in sixteenths of a pixel
    cv2.polylines(picture, [np.round(16 * corners).astype(np.int32)], True, colour, width, cv2.LINE_AA, 4)  # noqa: FBT003


def _rgb(colour: str) -> tuple[int, int, int]:
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def _write(draw: Any, text: str, place: tuple[int, int], colour: str, *, bold: bool = False) -> None:
    """Write a text of at most two lines into a panel."""
    from textwrap import wrap

    from matplotlib import font_manager
    from PIL import ImageFont

    file = font_manager.findfont(font_manager.FontProperties(weight="bold" if bold else "normal"))
    font = ImageFont.truetype(file, 13)
    draw.multiline_text(place, "\n".join(wrap(text, 33)[:2]), fill=colour, font=font, spacing=3)


@dataclass(frozen=True)
class Stretch:
    """A stretch of time [s] on the clock of a case, with the ghosts of a clip that shows it."""

    ghost: Ghost
    film: Path
    recording: Recording
    start: float
    stop: float


def stretches(
    case: Case,
    fits: Sequence[Fit],
    names: Sequence[str],
    intervals: Sequence[tuple[str, float, float]],
    folders: Sequence[Path],
    index: int = 0,
) -> list[Stretch]:
    """Return the stretches of all clips: the run of the casing (or single body), and intervals with a lack of fit.

    Parameters
    ----------
    case : Case
        The case with its clips.
    fits, names : sequence
        Fits of the case, the base model first, and their names.
    intervals : sequence of (str, float, float)
        Body, "casing" or "rotor", start and stop of each lack of fit [s].
    folders : sequence of Path
        Folders of the films.
    index : int
        Index of the case in the fits.
    """
    from gyrotrack.plotting._frames import find_film

    found = []
    for ghost in ghosts(case, fits, names, index):
        r = case.recordings[ghost.clip]
        film = find_film(r, list(folders))
        if film is None:
            continue
        first, last = float(ghost.time[0]), float(ghost.time[-1])
        if ghost.body == "casing":
            found.append(Stretch(ghost, film, r, first, last))
        found += [
            Stretch(ghost, film, r, max(a, first), min(b, last))
            for body, a, b in intervals
            if body == ghost.body and a < last and b > first
        ]
    return found


def check_ghost_film(path: Path, *, force: bool) -> None:
    """Check that a film of ghosts can be written: .mp4, or .webp for an animated picture, and new unless `force`."""
    if path.suffix.lower() not in {".mp4", ".webp"}:
        raise UsageError(
            f"Unknown format of an overlay: {path.name}.", "Use a name that ends in .mp4 or .webp."
        )
    refuse_existing(path, force=force)


# number of frames of one stretch in a film, and frame rate of the film [1/s]
_LONGEST, _RATE = 250, 25


def write_ghost_film(
    path: Path,
    shown: Sequence[Stretch],
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write a film of the ghosts in slow motion around stretches of time: consecutive frames, at 25 per second.

    For a long stretch, the frames around the largest difference are shown. A name that ends in ``.webp`` gets the
    animated picture of the first stretch.

    Parameters
    ----------
    path : Path
        The file to write.
    shown : sequence of Stretch
        The stretches.
    force : bool
        Replace an existing file.
    progress : callable, optional
        Called with (frames written, frames in total).

    Raises
    ------
    OutputError
        If there is no stretch, or no frame can be decoded.
    """
    import av

    check_ghost_film(path, force=force)
    if not shown:
        what = "There is no stretch of film to show: no lack of fit, or the films are not found."
        raise OutputError(what, "Give the folder of the films with --films.")
    if path.suffix.lower() == ".webp":
        made = animated(shown[0])
        if made is None:
            raise OutputError(f"No frame of {shown[0].film} can be decoded.", "Check the film.")
        with new_file(path, force=force) as out:
            out.write(made.webp)
        return path
    parts = [(_around_worst(s.ghost, s.start, s.stop), s.film, s.recording) for s in shown]
    total, done = sum(len(g.time) for g, _, _ in parts), 0
    with new_file(path, force=force) as file, av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(_RATE))
        stream.width, stream.height = _film_size(len(parts[0][0].models))
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "20", "preset": "veryfast"}
        for picture in _film_pictures(parts):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(np.asarray(picture)), format="rgb24")
            frame.pts = done
            container.mux(stream.encode(frame))
            done += 1
            if progress is not None and done % 20 == 0:
                progress(done, total)
        if not done:
            raise OutputError("No frame of the films can be decoded.", "Check the films.")
        container.mux(stream.encode(None))
    return path


def _around_worst(ghost: Ghost, start: float, stop: float) -> Ghost:
    """Return consecutive frames of a stretch; of a long stretch, frames around the first model's largest difference."""
    around = _AROUND * (stop - start)
    part = ghost.inside(start - around, stop + around)
    if len(part.time) <= _LONGEST:
        return part
    worst = int(np.argmax(np.abs(part.difference[0])))
    first = min(max(worst - _LONGEST // 2, 0), len(part.time) - _LONGEST)
    return part._part(np.arange(first, first + _LONGEST))  # noqa: SLF001 - its own module


_FILM_PANEL = 480


def _film_size(models: int) -> tuple[int, int]:
    return models * _FILM_PANEL, _FILM_PANEL + _TOP + _FOOT


def _film_pictures(parts: Sequence[tuple[Ghost, Path, Recording]]) -> Iterator[Image]:
    """Yield the frames of all stretches with the ghosts of all models side by side, as filmed."""
    from PIL import Image, ImageDraw

    from gyrotrack.plotting._frames import Film

    for ghost, place, r in parts:
        slow = r.capture_fps / _RATE
        with Film(place, r) as film:
            for i, number in enumerate(ghost.frame):
                picture = film.picture(int(number), overlay=False)
                if picture is None:
                    continue
                sheet = Image.new("RGB", _film_size(len(ghost.models)), (255, 255, 255))
                draw = ImageDraw.Draw(sheet)
                for model, name in enumerate(ghost.models):
                    left, colour = model * _FILM_PANEL, BEFORE if model == 0 else AFTER
                    sheet.paste(_filmed_panel(ghost, i, picture, model), (left, _TOP))
                    _write(draw, name, (left + 4, 2), colour, bold=True)
                    difference = _angle(float(ghost.difference[model, i]))
                    drawn = f", drawn × {ghost.factor}" if ghost.factor > 1 else ""
                    text = f"{ghost.time[i]:.3f} s, {slow:.0f} times slower   {difference}{drawn}"
                    _write(draw, text, (left + 4, _TOP + _FILM_PANEL + 4), "#333333")
                yield sheet


def _filmed_panel(ghost: Ghost, i: int, picture: Picture, model: int) -> Image:
    """Return a frame as filmed, cut to a square about the hub, with both outlines."""
    import cv2
    from PIL import Image

    scale = 0.5 * _FILM_PANEL / (_VIEW * ghost.radius)
    shift = 0.5 * _FILM_PANEL - scale * ghost.hub[i]
    matrix = np.column_stack([scale * np.eye(2), shift])
    shown = cv2.warpAffine(
        picture, matrix, (_FILM_PANEL, _FILM_PANEL), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    colour = _rgb(BEFORE if model == 0 else AFTER)[::-1]
    for name, outlines in ghost.outlines.items():
        if np.isfinite(outlines[i]).all():
            _line(shown, scale * ghost.turned(name, model, ghost.factor)[i] + shift, colour, 3)
            _line(shown, scale * outlines[i] + shift, _REAL, 1)
    return Image.fromarray(np.ascontiguousarray(shown[..., ::-1]))
