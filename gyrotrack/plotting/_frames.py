"""Frames of films with an overlay: detections, markers of a proposed profile, or a body and its hub.

A frame is identified by its timestamp in the recording: the film is decoded from the preceding key frame. If timestamps
repeat or are missing, the frame is not found, so that no wrong frame is shown.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import av
import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack._column_store import release_pages
from gyrotrack._errors import OutputError, UsageError, VideoError
from gyrotrack.io._atomic import new_file, refuse_existing
from gyrotrack.io._records import MarkerTrack, Recording
from gyrotrack.io._schema import STATUS, STATUS_WORDS
from gyrotrack.tracking._film_tracker import Progress
from gyrotrack.tracking._polar import CHROMA_SHIFT
from gyrotrack.video._container import (
    Frame,
    file_sha256,
    opened,
    orientation_of,
    planes_of,
    probe,
    read_packets,
)
from gyrotrack.video._decoder import Reader, frames_at

if TYPE_CHECKING:
    from gyrotrack.tracking._film import Film as TrackedFilm
    from gyrotrack.tracking._proposal import Proposal, ProposedMarker
    from gyrotrack.tracking._scene import Marker
    from gyrotrack.tracking._tracked import Tracked

Picture = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]

_FOUND, _PARTIAL, _CENTRE = (60, 255, 60), (0, 200, 255), (255, 255, 255)


def with_detections(frame: Frame, k: int, recording: Recording) -> Picture:
    """Return a frame in colour (BGR) with the detections of frame `k` of the recording."""
    picture = colour_picture(frame)
    centre = recording.centre[k]
    for marker in recording.markers.values():
        _draw_marker(picture, marker, k, centre, recording.sense)
    if np.isfinite(centre).all():
        cv2.drawMarker(picture, _point(centre), _CENTRE, cv2.MARKER_CROSS, 13, 1, cv2.LINE_AA)
    text = f"{k}  {1e3 * recording.time[k]:.1f} ms"
    cv2.rectangle(picture, (0, 0), (9 * len(text), 20), (0, 0, 0), cv2.FILLED)
    _write(picture, text, (6, 15), _CENTRE)
    return picture


def colour_picture(frame: Frame) -> Picture:
    """Return a frame in colour, (height, width, 3) blue, green, red."""
    size = (frame.y.shape[1], frame.y.shape[0])
    planes = [
        frame.y,
        *(cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR) for plane in (frame.v, frame.u)),
    ]
    return np.asarray(cv2.cvtColor(cv2.merge(planes), cv2.COLOR_YCrCb2BGR), dtype=np.uint8)


def _draw_marker(
    picture: Picture, marker: MarkerTrack, k: int, centre: npt.NDArray[np.float64], sense: int
) -> None:
    """Draw ray and inner corners of a complete marker (green), or the ray of a partly occluded marker (orange)."""
    radius = float(np.nanmedian(marker.rho)) if np.isfinite(marker.rho).any() else float("nan")
    angle = sense * marker.angle_fine[k]
    if not np.isfinite([radius, angle, *centre]).all():
        return
    whole = marker.status[k] == STATUS["ok"]
    direction = np.array([np.cos(angle), -np.sin(angle)])
    start, stop = centre + 0.9 * radius * direction, centre + 1.15 * radius * direction
    colour = _FOUND if whole else _PARTIAL
    cv2.line(picture, _point(start), _point(stop), colour, 1, cv2.LINE_AA)
    if whole:
        first, second = marker.corner[k]
        cv2.line(picture, _point(first), _point(second), colour, 1, cv2.LINE_AA)
        for corner in (first, second):
            cv2.circle(picture, _point(corner), 3, colour, 1, cv2.LINE_AA)
    label = marker.name if whole else f"{marker.name} {STATUS_WORDS[int(marker.status[k])]}"
    place = _point(centre + 1.3 * radius * direction)
    _write(picture, label, place, colour, 0.35)


def _point(place: npt.NDArray[np.float64]) -> tuple[int, int]:
    return round(float(place[0])), round(float(place[1]))


_MAX_AHEAD = 24  # largest number of frames that are skipped by decoding instead of seeking
# decoded frames before the requested frame are kept, so that a step back needs no seek: number, and size [bytes]
_BEHIND, _HELD = 12, 48 * 2**20
_MAX_HASHED = 256 * 2**20  # bytes


def find_film(recording: Recording, folders: list[Path]) -> Path | None:
    """Find a recording's film in folders or the samples: by SHA-256, above 256 MiB by frame size and frame count."""
    name = Path(recording.source).name
    here = Path(__file__)
    places = [*folders, here.parents[2] / "sample_clips", here.parents[1] / "sample_clips"]
    return next((f / name for f in places if name and _is_film_of(f / name, recording)), None)


def _is_film_of(path: Path, recording: Recording) -> bool:
    try:
        if not path.is_file():
            return False
        if recording.source_sha256 and path.stat().st_size <= _MAX_HASHED:
            return file_sha256(path) == recording.source_sha256
        info = probe(path)
    except (OSError, ValueError, VideoError):  # the name in the recording may be invalid
        return False
    return {info.width, info.height} == {recording.width, recording.height} and (
        info.frames_declared == recording.frames_declared
    )


class Film:
    """Random access to the frames of a film, with the detections of its recording (optional)."""

    def __init__(self, path: Path, recording: Recording | None = None) -> None:
        self.recording = recording
        self._manager = opened(path)  # single-threaded: threads delay the first frame after a seek
        self._stamps: npt.NDArray[np.floating[Any]] = (
            float(probe(path).time_base) * read_packets(path).stamps
            if recording is None
            else recording.pts_time
        )

    def __len__(self) -> int:
        return len(self._stamps)

    def __enter__(self) -> Self:
        self._container, self._stream = self._manager.__enter__()
        self._base = float(self._stream.time_base)
        self._frames: Any = None
        self._at = -1
        self._begun = False
        self._held: dict[int, Any] = {}  # decoded frames by timestamp, the oldest first
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._frames = None
        self._held.clear()
        self._manager.__exit__(kind, value, trace)

    def picture(self, index: int, *, overlay: bool = True) -> Picture | None:
        """Return a frame in colour (BGR), or None if it is not found."""
        if not 0 <= index < len(self._stamps) or not np.isfinite(self._stamps[index]):
            return None
        frame = self._frame(index)
        if frame is None:
            return None
        if self.recording is None or not overlay:
            return colour_picture(frame)
        return with_detections(frame, index, self.recording)

    def _frame(self, index: int) -> Frame | None:
        wanted = round(float(self._stamps[index]) / self._base)
        if wanted not in self._held:
            self._decode(wanted, index)
        raw = self._held.get(wanted)
        return None if raw is None else planes_of(raw, index, orientation_of(raw, self._stream))

    def _decode(self, wanted: int, index: int) -> None:
        """Decode up to the timestamp `wanted` of a frame, and hold the latest decoded frames."""
        try:
            if self._frames is None or not self._at < index <= self._at + _MAX_AHEAD:
                self._container.seek(wanted, stream=self._stream, backward=True)
                self._begun = False
                before = float(self._stamps[max(0, index - _BEHIND)]) / self._base
                self._frames = self._decoded(round(before) if np.isfinite(before) else wanted)
            for raw in self._frames:
                if raw.pts is None:
                    continue
                # frames that precede the first key frame may lack their references
                self._begun = self._begun or bool(raw.key_frame)
                if self._begun or raw.pts >= wanted:
                    self._hold(raw)
                if raw.pts >= wanted:  # a later timestamp means that the frame is missing
                    self._at = index
                    return
        except av.error.FFmpegError:
            pass
        self._frames = None

    def _hold(self, raw: Any) -> None:
        self._held.pop(raw.pts, None)
        self._held[raw.pts] = raw
        most = max(2, min(2 * _MAX_AHEAD, int(_HELD // (1.5 * raw.width * raw.height))))
        while len(self._held) > most:
            del self._held[next(iter(self._held))]

    def _decoded(self, first: int) -> Iterator[Any]:
        """Decode from the current position; before the timestamp `first`, only reference frames are decoded."""
        decoder = self._stream.codec_context
        # with other codecs, such frames may be references of later frames
        can_skip = decoder.codec.name == "h264"
        for packet in self._container.demux(self._stream):
            unneeded = can_skip and packet.pts is not None and packet.pts < first
            decoder.skip_frame = "NONREF" if unneeded else "DEFAULT"
            yield from packet.decode()


FRAMES = 12
_COLUMNS = 4
_WIDTH = 520  # width of a tile [px]
_LINE, _GREY = 17, (110, 110, 110)


def check_contact_sheet(path: Path, *, force: bool) -> None:
    """Check that a contact sheet can be written: its name ends in .png, and the file is new unless `force` is set."""
    if path.suffix.lower() != ".png":
        raise UsageError(f"Unknown format of a contact sheet: {path.name}.", "Use a name that ends in .png.")
    refuse_existing(path, force=force)


def write_contact_sheet(path: Path, video: Path, recording: Recording, *, force: bool = False) -> None:
    """Draw twelve frames, evenly distributed over a film, with corners, rays, centre, status, angle and uncertainty."""
    check_contact_sheet(path, force=force)
    tiles = [_tile(picture, k, recording) for k, picture in _selected_frames(video, recording)]
    if not tiles:
        raise OutputError(f"No frame of {video} can be decoded for {path}.", "Check the film.")
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % _COLUMNS)
    rows = [np.hstack(tiles[k : k + _COLUMNS]) for k in range(0, len(tiles), _COLUMNS)]
    _write_png(path, [_heading(recording, rows[0].shape[1]), *rows], force=force)


def _write_png(path: Path, rows: Sequence[Picture], *, force: bool) -> None:
    _, encoded = cv2.imencode(".png", np.vstack(rows))
    with new_file(path, force=force) as stream:
        stream.write(encoded.tobytes())


def _selected_frames(video: Path, recording: Recording) -> list[tuple[int, Picture]]:
    """Return number and picture of the frames of a contact sheet."""
    count = min(FRAMES, recording.frames_decoded)
    wanted = np.unique(np.linspace(0, recording.frames_decoded - 1, count).astype(int)).tolist()
    base = float(probe(video).time_base)
    stamp = {k: round(recording.pts_time[k] / base) for k in wanted if np.isfinite(recording.pts_time[k])}
    found = frames_at(video, stamp.values())
    if all(stamp.get(k) in found for k in wanted):
        return [(k, with_detections(found[stamp[k]], k, recording)) for k in wanted]
    with Reader(video) as reader:  # no timestamps
        return [(f.index, with_detections(f, f.index, recording)) for f in reader if f.index in set(wanted)]


def _tile(picture: Picture, k: int, recording: Recording) -> Picture:
    """Return a frame with a caption: angle of each body, and status of each marker."""
    scale = _WIDTH / picture.shape[1]
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
    picture = _resized(picture, scale, how)
    lines = [_body_line(name, k, recording) for name in recording.bodies]
    lines += [_marker_line(name, k, recording) for name in recording.markers]
    tile = np.full((picture.shape[0] + _LINE * len(lines) + 14, picture.shape[1] + 8, 3), 255, dtype=np.uint8)
    tile[4 : 4 + picture.shape[0], 4 : 4 + picture.shape[1]] = picture
    for row, text in enumerate(lines):
        _write(tile, text, (6, picture.shape[0] + 4 + _LINE * (row + 1) - 4), size=0.42)
    return tile


def _resized(picture: Picture, scale: float, how: int) -> Picture:
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=how), dtype=np.uint8)


def _body_line(name: str, k: int, recording: Recording) -> str:
    body = recording.bodies[name]
    place = int(np.searchsorted(body.time, recording.time[k] - 1e-9))
    if place == len(body.time) or abs(body.time[place] - recording.time[k]) > 1e-9:
        return f"{name}: no angle"
    count = int(body.n_markers[place])
    return f"{name}: {body.angle[place]:.4f} +- {body.sigma[place]:.4f} rad, {count} marker{'' if count == 1 else 's'}"


def _marker_line(name: str, k: int, recording: Recording) -> str:
    marker = recording.markers[name]
    text = f"  {name}: {STATUS_WORDS[int(marker.status[k])]}"
    if not np.isfinite(marker.angle_fine[k]):
        return text
    text += f", {marker.angle_fine[k]:.4f} +- {marker.sigma_calibrated[k]:.4f}"
    return text + (f" (marker {marker.sigma[k]:.2f})" if np.isfinite(marker.sigma[k]) else "")


def _heading(recording: Recording, width: int) -> Picture:
    bar = np.full((30, width, 3), 255, dtype=np.uint8)
    text = (
        f"{recording.source}: {recording.frames_decoded} frames at {recording.capture_fps:g} fps;"
        " green: complete, with inner corners; orange: partly visible; cross: centre"
    )
    _write(bar, text, (6, 20), _GREY, 0.42)
    return bar


def _write(
    picture: Picture,
    text: str,
    place: tuple[int, int],
    colour: tuple[int, int, int] = (30, 30, 30),
    size: float = 0.45,
) -> None:
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def check_overlay(path: Path, *, force: bool) -> None:
    """Check that an overlay can be written: .mp4 (film) or .png (contact sheet), and new unless `force` is set."""
    if path.suffix.lower() not in (".mp4", ".png"):
        what = f"Unknown format of an overlay: {path.name}."
        raise UsageError(what, "Use a name that ends in .mp4 or .png.")
    refuse_existing(path, force=force)


def write_overlay(
    path: Path, video: Path, recording: Recording, *, force: bool = False, progress: Progress | None = None
) -> None:
    """Write the detections of a recording as a contact sheet (.png) or as a film (.mp4) at the container's rate."""
    check_overlay(path, force=force)
    if path.suffix.lower() == ".png":
        write_contact_sheet(path, video, recording, force=force)
    else:
        _write_film(path, video, recording, force=force, progress=progress)


def _write_film(
    path: Path, video: Path, recording: Recording, *, force: bool, progress: Progress | None
) -> None:
    rate = recording.container_fps if np.isfinite(recording.container_fps) else 30.0
    with new_file(path, force=force) as file, av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1001))
        stream.width, stream.height = recording.width // 2 * 2, recording.height // 2 * 2
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "20", "preset": "veryfast"}
        for index, picture in enumerate(_pictures(video, recording)):
            even = np.ascontiguousarray(picture[: stream.height, : stream.width])
            frame = av.VideoFrame.from_ndarray(even, format="bgr24")
            frame.pts = index
            container.mux(stream.encode(frame))
            if index % 100 == 0:
                release_pages()
                if progress is not None:
                    progress(index, recording.frames_decoded)
        container.mux(stream.encode(None))


def _pictures(video: Path, recording: Recording) -> Iterator[Picture]:
    with Reader(video) as reader:
        for frame in reader:
            if frame.index < recording.frames_decoded:
                yield with_detections(frame, frame.index, recording)


_MIN_WIDTH, _MAX_WIDTH, _PANEL = 800, 1400, 430
_MARK, _EDGE = (255, 255, 255), (0, 0, 0)
_RING, _HAND = (0, 200, 255), (0, 0, 255)


def write_picture(
    path: Path, proposal: Proposal, *, body: tuple[TrackedFilm, Tracked] | None = None, force: bool = False
) -> None:
    """Write a PNG of the frame with most markers, all proposed markers, and a `body` that turns about a hub."""
    index = int(np.argmax(np.sum([m.clear for m in proposal.markers], axis=0)))
    frame = proposal.samples.frames[index]
    picture = colour_picture(frame)
    colours = {
        m.profile.name: _mean_colour(picture, m.marker, m.angle[index], proposal.centre)
        for m in proposal.markers
    }
    scale = float(np.clip(np.ceil(_MIN_WIDTH / picture.shape[1]), 1, 4))
    scale = min(scale, _MAX_WIDTH / picture.shape[1])
    big = _resized(picture, scale, cv2.INTER_CUBIC)
    for marker in proposal.markers:
        _draw_proposed(big, marker, frame, float(marker.angle[index]), proposal.centre, scale)
    _draw_centre(big, proposal, scale)
    panel = _panel(proposal, colours, big.shape[0])
    rows = [np.hstack([_padded(big, panel.shape[0]), panel])]
    width = rows[0].shape[1]
    if body is not None:
        rows += _body_rows(*body, width)
    _write_png(path, [*rows, _notes_panel(proposal.notes, width)], force=force)


def write_body_picture(path: Path, film: TrackedFilm, tracked: Tracked, *, force: bool = False) -> None:
    """Write a PNG of four frames with hub, ring and angle of a body, and its mean polar picture below."""
    _write_png(path, _body_rows(film, tracked, 1600), force=force)


def write_tiles(path: Path, tiles: Sequence[Picture], text: str, *, force: bool = False) -> None:
    """Write a PNG of pictures of the same size side by side, with a text above."""
    width = 1600
    each = width // len(tiles)
    size = (each, round(tiles[0].shape[0] * each / tiles[0].shape[1]))
    row = np.hstack(
        [np.asarray(cv2.resize(t, size, interpolation=cv2.INTER_AREA), dtype=np.uint8) for t in tiles]
    )
    _write_png(path, [_text_panel([text], row.shape[1]), row], force=force)


def _body_rows(film: TrackedFilm, tracked: Tracked, width: int) -> list[Picture]:
    ring = tracked.ring
    p, q = ring.stretch
    index = np.linspace(0, len(tracked.frame) - 1, 4).astype(int)
    tiles = []

    def places(hub: Floats, radius: float | Floats, phi: float | Floats) -> npt.NDArray[np.int32]:
        x = hub[0] + radius * ((1 + p) * np.cos(phi) + q * np.sin(phi))
        y = hub[1] + radius * (q * np.cos(phi) + (1 - p) * np.sin(phi))
        return np.stack([x, y], axis=-1).clip(-30000, 30000).round().astype(np.int32)

    for k, picture in zip(index, film.some(tracked.frame[index]), strict=True):
        tile = np.asarray(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
        hub = np.array(ring.hub) + tracked.hub_path[k]
        shown = tracked.ring_at(int(k))
        for radius in (shown.inner, shown.outer):
            around = places(hub, radius, np.linspace(ring.start, ring.start + ring.span, 200))
            cv2.polylines(tile, [around], isClosed=False, color=_RING, thickness=1)
        cv2.drawMarker(tile, places(hub, 0.0, 0.0).tolist(), _RING, cv2.MARKER_CROSS, 12, 1)
        theta = -tracked.angle[k] + ring.start
        hand = places(hub, np.array([shown.inner, shown.outer]), theta)
        cv2.line(tile, hand[0].tolist(), hand[1].tolist(), _HAND, 2)
        size = (width // 4, round(tile.shape[0] * width / (4 * tile.shape[1])))
        tiles.append(np.asarray(cv2.resize(tile, size, interpolation=cv2.INTER_AREA), dtype=np.uint8))
    row = np.hstack(tiles)
    row = np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)))
    learnt = np.clip(tracked.template.body, 0, 255).astype(np.uint8)
    learnt = np.asarray(cv2.resize(cv2.cvtColor(learnt, cv2.COLOR_GRAY2BGR), (width, 160)), dtype=np.uint8)
    x, y = ring.hub
    text = (
        f"picture of a body about ({x:.0f}, {y:.0f}) px, radius {ring.inner:.0f} to {ring.outer:.0f} px; tracking "
        f"quality {100 * tracked.explained:.0f} %. Below: its polar picture."
    )
    return [_text_panel([text], width), row, learnt]


def _mean_colour(
    picture: Picture, geometry: Marker, angle: float, centre: tuple[float, float]
) -> tuple[int, int, int]:
    """Return the mean colour (blue, green, red) of the central part of a marker."""
    mask = np.zeros(picture.shape[:2], dtype=np.uint8)
    depth = 0.25 * (geometry.outer - geometry.inner)
    cv2.fillPoly(mask, [_sector(geometry, angle, centre, 1.0, depth, 0.5)], 255)
    b, g, r, _ = cv2.mean(picture, mask)
    return round(b), round(g), round(r)


def _sector(
    geometry: Marker,
    angle: float,
    centre: tuple[float, float],
    scale: float,
    inset: float = 0.0,
    width: float = 1.0,
) -> npt.NDArray[np.int32]:
    """Return the outline of a marker as a sector of a ring, (m, 2) in px of the enlarged picture."""
    turn = angle + width * geometry.half_width * np.linspace(-1.0, 1.0, 9)
    radius = np.repeat([geometry.inner + inset, geometry.outer - inset], 9)
    turn = np.concatenate([turn, turn[::-1]])
    x = centre[0] + radius * np.cos(turn)
    y = centre[1] - radius * np.sin(turn)
    return np.rint((np.stack([x, y], axis=1) + 0.5) * scale).astype(np.int32)


def _draw_proposed(
    big: Picture,
    marker: ProposedMarker,
    frame: Frame,
    angle: float,
    centre: tuple[float, float],
    scale: float,
) -> None:
    geometry = marker.marker
    middle = _enlarged(centre, scale)
    for radius in (geometry.inner, geometry.outer):
        cv2.circle(big, middle, round(radius * scale), _MARK, 1, cv2.LINE_AA)
    contours, _ = cv2.findContours(
        _mask(frame, marker, angle, centre, big.shape), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    for thickness, colour in ((3, _EDGE), (1, _MARK)):
        cv2.drawContours(big, contours, -1, colour, thickness, cv2.LINE_AA)
    away = (geometry.outer + 14.0) * np.array([np.cos(angle), -np.sin(angle)])
    x, y = _enlarged((centre[0] + away[0], centre[1] + away[1]), scale)
    text = marker.profile.name
    wide, high = 10 * len(text) + 6, 20
    x = int(np.clip(x - wide // 2, 0, big.shape[1] - wide))
    y = int(np.clip(y - high // 2, 0, big.shape[0] - high))
    cv2.rectangle(big, (x, y), (x + wide, y + high), _EDGE, cv2.FILLED)
    _write(big, text, (x + 4, y + 15), _MARK, 0.5)


def _mask(
    frame: Frame, marker: ProposedMarker, angle: float, centre: tuple[float, float], shape: tuple[int, ...]
) -> npt.NDArray[np.uint8]:
    """Return the pixels of the enlarged picture near a marker that have its colour."""
    geometry = marker.marker
    planes = [frame.y] if geometry.colour == "white" else [frame.u, frame.v]
    weights = geometry.contrast[: len(planes)]
    norm = float(np.sum(np.square(weights)))
    score = np.sum([w * p.astype(np.float32) for w, p in zip(weights, planes, strict=True)], axis=0) / norm
    step = 1 if geometry.colour == "white" else 2
    y, x = np.mgrid[: score.shape[0], : score.shape[1]].astype(np.float64) * step
    if step == 2:
        x, y = x + CHROMA_SHIFT[0], y + CHROMA_SHIFT[1]
    radius = np.hypot(x - centre[0], y - centre[1])
    off = np.abs(np.angle(np.exp(1j * (np.arctan2(-(y - centre[1]), x - centre[0]) - angle))))
    ring = (radius > geometry.inner - 4) & (radius < geometry.outer + 4)
    ground = float(np.median(score[ring & (off > 1.5 * geometry.half_width)]))
    level = float(np.median(score[ring & (off < 0.5 * geometry.half_width)]))
    here = ring & (off < 1.4 * geometry.half_width + 0.05)
    soft = np.where(here, (score - ground) / max(level - ground, 1e-6), 0.0).astype(np.float32)
    large = cv2.resize(soft, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
    return np.asarray(large > 0.5, dtype=np.uint8)


def _draw_centre(big: Picture, proposal: Proposal, scale: float) -> None:
    middle = _enlarged(proposal.centre, scale)
    for thickness, colour in ((3, _EDGE), (1, _MARK)):
        if proposal.disc is not None:
            cv2.circle(big, middle, round(proposal.disc.radius * scale), colour, thickness, cv2.LINE_AA)
        cv2.drawMarker(big, middle, colour, cv2.MARKER_CROSS, 16, thickness, cv2.LINE_AA)


def _panel(proposal: Proposal, colours: dict[str, tuple[int, int, int]], height: int) -> Picture:
    """Draw a colour swatch of each marker with its properties."""
    rows = 78 * len(proposal.markers) + 100
    panel = np.full((max(height, rows), _PANEL, 3), 255, dtype=np.uint8)
    _write(panel, proposal.profile.name, (16, 30), size=0.6)
    disc = proposal.disc
    middle = f"({proposal.centre[0]:.0f}, {proposal.centre[1]:.0f}) px"
    mark = (
        f"{proposal.profile.circle_colour} disc, radius {disc.radius:.0f} px"
        if disc
        else "the markers' orbit"
    )
    _write(panel, f"centre {middle}: {mark}", (16, 56), _GREY)
    for k, marker in enumerate(proposal.markers):
        top = 76 + 78 * k
        cv2.rectangle(panel, (16, top), (80, top + 60), colours[marker.profile.name], cv2.FILLED)
        cv2.rectangle(panel, (16, top), (80, top + 60), _GREY, 1)
        geometry = marker.marker
        hue = "" if marker.profile.hue is None else f", hue {marker.profile.hue:.0f} deg"
        wide = 2.0 * geometry.radius * np.tan(min(geometry.half_width, 1.4))
        _write(panel, f"{marker.profile.name} on the {marker.profile.body}", (94, top + 16), size=0.55)
        _write(
            panel,
            f"{marker.profile.colour}{hue}; contrast {np.hypot(*geometry.contrast):.0f} of 255",
            (94, top + 36),
            _GREY,
        )
        size = f"{geometry.outer - geometry.inner:.0f} x {wide:.0f} px at {geometry.radius:.0f} px"
        _write(panel, f"{size}; fully visible in {100 * marker.seen:.0f} %", (94, top + 54), _GREY)
    return panel


def _notes_panel(notes: Sequence[str], width: int) -> Picture:
    """Draw the notes below the picture, wrapped."""
    lines: list[str] = []
    for note in notes:
        line = "-"
        for word in note.split():
            if 8.2 * (len(line) + len(word)) > width - 40:
                lines.append(line)
                line = " "
            line += " " + word
        lines.append(line)
    return _text_panel(lines, width)


def _text_panel(lines: Sequence[str], width: int) -> Picture:
    strip = np.full((20 * len(lines) + (16 if lines else 0), width, 3), 255, dtype=np.uint8)
    for k, line in enumerate(lines):
        _write(strip, line, (16, 22 + 20 * k))
    return strip


def _padded(picture: Picture, height: int) -> Picture:
    below = np.full((height - picture.shape[0], picture.shape[1], 3), 255, dtype=np.uint8)
    return np.vstack([picture, below])


def _enlarged(place: tuple[float, float], scale: float) -> tuple[int, int]:
    return round((place[0] + 0.5) * scale), round((place[1] + 0.5) * scale)
