"""A sheet of frames from the whole film, each with what was found in it, and its numbers below."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from gyrotrack.dataset.records import STATUS, Recording
from gyrotrack.dataset.writing import new_file, refuse_existing
from gyrotrack.errors import OutputError, UsageError
from gyrotrack.pipeline.drawing import Picture, drawn
from gyrotrack.video import Reader, frames_at, probe

FRAMES = 12
_COLUMNS = 4
_WIDTH = 520
"""Width of a tile in px: what its caption needs."""
_LINE, _INK, _FAINT = 17, (30, 30, 30), (120, 120, 120)
_WORDS = {code: word.replace("_", " ") for word, code in STATUS.items()}


def check_contact_sheet(path: Path, *, force: bool) -> None:
    """Refuse, before any work is done, a sheet that could not be written.

    Raises
    ------
    UsageError
        If the name does not end in .png.
    OutputError
        If the file exists and `force` is not set.
    """
    if path.suffix.lower() != ".png":
        raise UsageError(f"a contact sheet is a picture (.png), not {path.name}", "change its ending")
    refuse_existing(path, force=force)


def write_contact_sheet(path: Path, video: Path, recording: Recording, *, force: bool = False) -> None:
    """Draw twelve frames spread over a film with corners, rays, centre, status, angle and uncertainty.

    Parameters
    ----------
    path : Path
        The PNG to write.
    video : Path
        The film that the recording was made from; only what the frames need of it is decoded.
    """
    check_contact_sheet(path, force=force)
    tiles = [_tile(picture, k, recording) for k, picture in _chosen(video, recording)]
    if not tiles:
        raise OutputError(f"no frame of {video} can be decoded for {path}", "check the film")
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % _COLUMNS)
    rows = [np.hstack(tiles[k : k + _COLUMNS]) for k in range(0, len(tiles), _COLUMNS)]
    _, encoded = cv2.imencode(".png", np.vstack([_heading(recording, rows[0].shape[1]), *rows]))
    with new_file(path, force=force) as stream:
        stream.write(encoded.tobytes())


def _chosen(video: Path, recording: Recording) -> list[tuple[int, Picture]]:
    """Return the number and the picture of each frame that is to be shown."""
    count = min(FRAMES, recording.frames_decoded)
    wanted = np.unique(np.linspace(0, recording.frames_decoded - 1, count).astype(int)).tolist()
    base = float(probe(video).time_base)
    stamp = {k: round(recording.pts_time[k] / base) for k in wanted if np.isfinite(recording.pts_time[k])}
    found = frames_at(video, stamp.values())
    if all(stamp.get(k) in found for k in wanted):
        return [(k, drawn(found[stamp[k]], k, recording)) for k in wanted]
    with Reader(video) as reader:  # no stamps to go by
        return [(f.index, drawn(f, f.index, recording)) for f in reader if f.index in set(wanted)]


def _tile(picture: Picture, k: int, recording: Recording) -> Picture:
    """Return a frame with a caption: the angle of each body, and how each marker was seen."""
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
    text = f"  {name}: {_WORDS[int(marker.status[k])]}"
    if not np.isfinite(marker.angle_fine[k]):
        return text
    text += f", {marker.angle_fine[k]:.4f} +- {marker.sigma_calibrated[k]:.4f}"
    return text + (f" (paper {marker.sigma[k]:.2f})" if np.isfinite(marker.sigma[k]) else "")


def _heading(recording: Recording, width: int) -> Picture:
    bar = np.full((30, width, 3), 255, dtype=np.uint8)
    text = (
        f"{recording.source}: {recording.frames_decoded} frames at {recording.capture_fps:g} fps;"
        " green: whole, with its near corners; orange: partly seen; cross: centre"
    )
    _write(bar, text, (6, 20), _FAINT)
    return bar


def _write(picture: Picture, text: str, place: tuple[int, int], colour: tuple[int, int, int]) -> None:
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
