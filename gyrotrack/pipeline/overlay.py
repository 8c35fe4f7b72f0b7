"""Looking at what was found: the film, or a sheet of its frames, with markers and angles drawn over it."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.records import STATUS, MarkerTrack, Recording
from gyrotrack.dataset.writing import new_file, refuse_existing
from gyrotrack.errors import UsageError
from gyrotrack.pipeline.watch import Progress
from gyrotrack.video import Frame, Reader

Picture = npt.NDArray[np.uint8]

SHEET_FRAMES = 12
_SHEET_COLUMNS = 4
_FOUND, _PARTLY, _CENTRE = (60, 255, 60), (0, 200, 255), (255, 255, 255)
_WORDS = {code: word for word, code in STATUS.items()}


def check_overlay(path: Path, *, force: bool) -> None:
    """Refuse, before any work is done, an overlay that could not be written.

    Raises
    ------
    UsageError
        If the name says neither a film (.mp4) nor a sheet (.png).
    OutputError
        If the file exists and `force` is not set.
    """
    if path.suffix.lower() not in (".mp4", ".png"):
        raise UsageError(
            f"an overlay is a film (.mp4) or a sheet (.png), not {path.name}", "change its ending"
        )
    refuse_existing(path, force=force)


def write_overlay(
    path: Path, video: Path, recording: Recording, *, force: bool = False, progress: Progress | None = None
) -> None:
    """Draw what a recording holds over its film.

    Parameters
    ----------
    path : Path
        ``.png``: a sheet of twelve frames from the whole film. ``.mp4``: the film, at its own rate.
    video : Path
        The film that the recording was made from.
    """
    check_overlay(path, force=force)
    if path.suffix.lower() == ".png":
        _write_sheet(path, video, recording, force=force)
    else:
        _write_film(path, video, recording, force=force, progress=progress)


def _write_sheet(path: Path, video: Path, recording: Recording, *, force: bool) -> None:
    count = min(SHEET_FRAMES, recording.frames_decoded)
    wanted = set(np.linspace(0, recording.frames_decoded - 1, count).astype(int).tolist())
    with Reader(video) as reader:
        tiles = [_drawn(frame, recording) for frame in reader if frame.index in wanted]
    blank = np.zeros_like(tiles[0])
    tiles += [blank] * (-len(tiles) % _SHEET_COLUMNS)
    rows = [np.hstack(tiles[k : k + _SHEET_COLUMNS]) for k in range(0, len(tiles), _SHEET_COLUMNS)]
    _, encoded = cv2.imencode(".png", np.vstack(rows))
    with new_file(path, force=force) as stream:
        stream.write(encoded.tobytes())


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
            if progress is not None and index % 100 == 0:
                progress(index, recording.frames_decoded)
        container.mux(stream.encode(None))


def _pictures(video: Path, recording: Recording) -> Iterator[Picture]:
    with Reader(video) as reader:
        for frame in reader:
            yield _drawn(frame, recording)


def _drawn(frame: Frame, recording: Recording) -> Picture:
    """Return a frame in colour (BGR) with everything that the recording knows of it."""
    picture = _colour(frame)
    k = frame.index
    centre = recording.centre[k]
    for marker in recording.markers.values():
        _draw_marker(picture, marker, k, centre, recording.sense)
    if np.isfinite(centre).all():
        cv2.drawMarker(picture, _point(centre), _CENTRE, cv2.MARKER_CROSS, 13, 1, cv2.LINE_AA)
    text = f"{k}  {1e3 * recording.time[k]:.1f} ms"
    cv2.rectangle(picture, (0, 0), (9 * len(text), 20), (0, 0, 0), cv2.FILLED)
    cv2.putText(picture, text, (6, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _CENTRE, 1, cv2.LINE_AA)
    return picture


def _colour(frame: Frame) -> Picture:
    size = (frame.y.shape[1], frame.y.shape[0])
    planes = [
        frame.y,
        *(cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR) for plane in (frame.v, frame.u)),
    ]
    return np.asarray(cv2.cvtColor(cv2.merge(planes), cv2.COLOR_YCrCb2BGR), dtype=np.uint8)


def _draw_marker(
    picture: Picture, marker: MarkerTrack, k: int, centre: npt.NDArray[np.float64], sense: int
) -> None:
    """Draw a marker's ray and near corners (green), or its ray alone where it is partly hidden (orange)."""
    radius = float(np.nanmedian(marker.rho)) if np.isfinite(marker.rho).any() else float("nan")
    angle = sense * marker.angle_fine[k]
    if not np.isfinite([radius, angle, *centre]).all():
        return
    whole = marker.status[k] == STATUS["ok"]
    direction = np.array([np.cos(angle), -np.sin(angle)])
    start, stop = centre + 0.9 * radius * direction, centre + 1.15 * radius * direction
    colour = _FOUND if whole else _PARTLY
    cv2.line(picture, _point(start), _point(stop), colour, 1, cv2.LINE_AA)
    if whole:
        first, second = marker.corner[k]
        cv2.line(picture, _point(first), _point(second), colour, 1, cv2.LINE_AA)
        for corner in (first, second):
            cv2.circle(picture, _point(corner), 3, colour, 1, cv2.LINE_AA)
    label = marker.name if whole else f"{marker.name} {_WORDS[int(marker.status[k])]}"
    place = _point(centre + 1.3 * radius * direction)
    cv2.putText(picture, label, place, cv2.FONT_HERSHEY_SIMPLEX, 0.35, colour, 1, cv2.LINE_AA)


def _point(place: npt.NDArray[np.float64]) -> tuple[int, int]:
    return round(float(place[0])), round(float(place[1]))
