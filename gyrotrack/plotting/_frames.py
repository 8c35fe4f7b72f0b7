"""Frames of films with overlaid detections.

A frame is identified by its timestamp in the recording: the film is decoded from the preceding key frame. If timestamps
repeat or are missing, the frame is not found, so that no wrong frame is shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import av
import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack._column_store import release_pages
from gyrotrack._errors import OutputError, UsageError, VideoError
from gyrotrack.io._atomic import new_file, refuse_existing
from gyrotrack.io._records import MarkerTrack, Recording
from gyrotrack.io._schema import STATUS
from gyrotrack.tracking._film_tracker import Progress
from gyrotrack.video._container import (
    Frame,
    file_sha256,
    opened,
    orientation_of,
    planes_of,
    probe,
    read_raw_stamps,
)
from gyrotrack.video._decoder import Reader, frames_at

Picture = npt.NDArray[np.uint8]

_FOUND, _PARTIAL, _CENTRE = (60, 255, 60), (0, 200, 255), (255, 255, 255)
_STATUS_NAMES = {code: word.replace("_", " ") for word, code in STATUS.items()}


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
    cv2.putText(picture, text, (6, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _CENTRE, 1, cv2.LINE_AA)
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
    """Draw ray and inner corners of a complete marker (green), or the ray of a partly occluded one (orange)."""
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
    label = marker.name if whole else f"{marker.name} {_STATUS_NAMES[int(marker.status[k])]}"
    place = _point(centre + 1.3 * radius * direction)
    cv2.putText(picture, label, place, cv2.FONT_HERSHEY_SIMPLEX, 0.35, colour, 1, cv2.LINE_AA)


def _point(place: npt.NDArray[np.float64]) -> tuple[int, int]:
    return round(float(place[0])), round(float(place[1]))


_MAX_AHEAD = 24  # frames that are skipped by decoding instead of seeking
_MAX_HASHED = 256 * 2**20  # bytes


def find_film(recording: Recording, folders: list[Path]) -> Path | None:
    """Return a recording's film in these folders or the samples, by SHA-256 or, over 256 MiB, by size and frames."""
    name = Path(recording.source).name
    places = [*folders, Path(__file__).parents[2] / "sample_clips"]
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
    """Random access to the frames of a film, with the detections of its recording, if one is given."""

    def __init__(self, path: Path, recording: Recording | None = None) -> None:
        self.recording = recording
        self._manager = opened(path)  # single-threaded: threads delay the first frame after a seek
        self._stamps: npt.NDArray[np.floating[Any]] = (
            float(probe(path).time_base) * read_raw_stamps(path) if recording is None else recording.pts_time
        )

    def __len__(self) -> int:
        return len(self._stamps)

    def __enter__(self) -> Self:
        self._container, self._stream = self._manager.__enter__()
        self._base = float(self._stream.time_base)
        self._frames: Any = None
        self._at = -1
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._frames = None
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
        try:
            if self._frames is None or not self._at < index <= self._at + _MAX_AHEAD:
                self._container.seek(wanted, stream=self._stream, backward=True)
                self._frames = self._decoded(wanted)
            for raw in self._frames:
                if raw.pts is not None and raw.pts >= wanted:
                    self._at = index
                    # a later timestamp means that the frame is missing
                    return planes_of(raw, index, orientation_of(raw)) if raw.pts == wanted else None
        except av.error.FFmpegError:
            pass
        self._frames = None
        return None

    def _decoded(self, first: int) -> Iterator[Any]:
        """Decode from here on; before the timestamp `first` only reference frames."""
        decoder = self._stream.codec_context
        # other codecs may use such frames as references
        can_skip = decoder.codec.name == "h264"
        for packet in self._container.demux(self._stream):
            unneeded = can_skip and packet.pts is not None and packet.pts < first
            decoder.skip_frame = "NONREF" if unneeded else "DEFAULT"
            yield from packet.decode()


FRAMES = 12
_COLUMNS = 4
_WIDTH = 520
"""Width of a tile [px]."""
_LINE, _INK, _GREY = 17, (30, 30, 30), (120, 120, 120)


def check_contact_sheet(path: Path, *, force: bool) -> None:
    """Check that a contact sheet can be written: its name ends in .png, and it does not exist or `force` is set."""
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
    _, encoded = cv2.imencode(".png", np.vstack([_heading(recording, rows[0].shape[1]), *rows]))
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
    picture = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=how), dtype=np.uint8)
    lines = [_body_line(name, k, recording) for name in recording.bodies]
    lines += [_marker_line(name, k, recording) for name in recording.markers]
    tile = np.full((picture.shape[0] + _LINE * len(lines) + 14, picture.shape[1] + 8, 3), 255, dtype=np.uint8)
    tile[4 : 4 + picture.shape[0], 4 : 4 + picture.shape[1]] = picture
    for row, text in enumerate(lines):
        _write(tile, text, (6, picture.shape[0] + 4 + _LINE * (row + 1) - 4), _INK)
    return tile


def _body_line(name: str, k: int, recording: Recording) -> str:
    body = recording.bodies[name]
    place = int(np.searchsorted(body.time, recording.time[k] - 1e-9))
    if place == len(body.time) or abs(body.time[place] - recording.time[k]) > 1e-9:
        return f"{name}: no angle"
    count = int(body.n_markers[place])
    return f"{name}: {body.angle[place]:.4f} +- {body.sigma[place]:.4f} rad, {count} marker{'' if count == 1 else 's'}"


def _marker_line(name: str, k: int, recording: Recording) -> str:
    marker = recording.markers[name]
    text = f"  {name}: {_STATUS_NAMES[int(marker.status[k])]}"
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
    _write(bar, text, (6, 20), _GREY)
    return bar


def _write(picture: Picture, text: str, place: tuple[int, int], colour: tuple[int, int, int]) -> None:
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)


def check_overlay(path: Path, *, force: bool) -> None:
    """Check that an overlay can be written: .mp4 (film) or .png (contact sheet), and new unless `force` is set."""
    if path.suffix.lower() not in (".mp4", ".png"):
        raise UsageError(
            f"Unknown format of an overlay: {path.name}.", "Use a name that ends in .mp4 or .png."
        )
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
