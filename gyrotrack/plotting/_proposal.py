"""What was found in a film, drawn into its frames: markers of a proposed profile, or a body and its hub."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack.io._atomic import new_file
from gyrotrack.plotting._frames import Picture as Pixels
from gyrotrack.plotting._frames import colour_picture
from gyrotrack.tracking._polar import CHROMA_SHIFT

if TYPE_CHECKING:
    from gyrotrack.tracking._film import Film
    from gyrotrack.tracking._proposal import Proposal, ProposedMarker
    from gyrotrack.tracking._scene import Marker
    from gyrotrack.tracking._tracked import Tracked
    from gyrotrack.video._container import Frame

Floats = npt.NDArray[np.float64]

_MIN_WIDTH, _MAX_WIDTH, _PANEL = 800, 1400, 430
_INK, _GREY, _MARK, _EDGE = (30, 30, 30), (110, 110, 110), (255, 255, 255), (0, 0, 0)
_RING, _HAND = (0, 200, 255), (0, 0, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def write_picture(
    path: Path, proposal: Proposal, *, body: tuple[Film, Tracked] | None = None, force: bool = False
) -> None:
    """Write a PNG of the frame with most markers and all that was chosen, and of a `body` that turns about a hub."""
    index = int(np.argmax(np.sum([m.clear for m in proposal.markers], axis=0)))
    frame = proposal.samples.frames[index]
    picture = colour_picture(frame)
    colours = {
        m.profile.name: _mean_colour(picture, m.marker, m.angle[index], proposal.centre)
        for m in proposal.markers
    }
    scale = float(np.clip(np.ceil(_MIN_WIDTH / picture.shape[1]), 1, 4))
    scale = min(scale, _MAX_WIDTH / picture.shape[1])
    big = np.asarray(
        cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), dtype=np.uint8
    )
    for marker in proposal.markers:
        _draw_marker(big, marker, frame, float(marker.angle[index]), proposal.centre, scale)
    _draw_centre(big, proposal, scale)
    panel = _panel(proposal, colours, big.shape[0])
    rows = [np.hstack([_padded(big, panel.shape[0]), panel])]
    width = rows[0].shape[1]
    if body is not None:
        rows += _body_rows(*body, width)
    _, encoded = cv2.imencode(".png", np.vstack([*rows, _notes_panel(proposal.notes, width)]))
    with new_file(path, force=force) as stream:
        stream.write(encoded.tobytes())


def write_body_picture(path: Path, film: Film, tracked: Tracked, *, force: bool = False) -> None:
    """Write a PNG of four frames with hub, ring and angle of a body, and its learnt polar picture below."""
    _, encoded = cv2.imencode(".png", np.vstack(_body_rows(film, tracked, 1600)))
    with new_file(path, force=force) as stream:
        stream.write(encoded.tobytes())


def _body_rows(film: Film, tracked: Tracked, width: int) -> list[Pixels]:
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
        for radius in (ring.inner, ring.outer):
            around = places(hub, radius, np.linspace(ring.start, ring.start + ring.span, 200))
            cv2.polylines(tile, [around], isClosed=False, color=_RING, thickness=1)
        cv2.drawMarker(tile, places(hub, 0.0, 0.0).tolist(), _RING, cv2.MARKER_CROSS, 12, 1)
        theta = -tracked.angle[k] + ring.start
        hand = places(hub, np.array([ring.inner, ring.outer]), theta)
        cv2.line(tile, hand[0].tolist(), hand[1].tolist(), _HAND, 2)
        size = (width // 4, round(tile.shape[0] * width / (4 * tile.shape[1])))
        tiles.append(np.asarray(cv2.resize(tile, size, interpolation=cv2.INTER_AREA), dtype=np.uint8))
    row = np.hstack(tiles)
    row = np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)))
    learnt = np.clip(tracked.template.body, 0, 255).astype(np.uint8)
    learnt = np.asarray(cv2.resize(cv2.cvtColor(learnt, cv2.COLOR_GRAY2BGR), (width, 160)), dtype=np.uint8)
    x, y = ring.hub
    text = (
        f"picture of a body about ({x:.0f}, {y:.0f}) px, radius {ring.inner:.0f} to {ring.outer:.0f} px; its rotation "
        f"explains {100 * tracked.explained:.0f} % of the change of brightness. Below: its polar picture."
    )
    return [_text_panel([text], width), row, learnt]


def _mean_colour(
    picture: Pixels, geometry: Marker, angle: float, centre: tuple[float, float]
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


def _draw_marker(
    big: Pixels,
    marker: ProposedMarker,
    frame: Frame,
    angle: float,
    centre: tuple[float, float],
    scale: float,
) -> None:
    geometry = marker.marker
    middle = _point(centre, scale)
    for radius in (geometry.inner, geometry.outer):
        cv2.circle(big, middle, round(radius * scale), _MARK, 1, cv2.LINE_AA)
    contours, _ = cv2.findContours(
        _mask(frame, marker, angle, centre, big.shape), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    for thickness, colour in ((3, _EDGE), (1, _MARK)):
        cv2.drawContours(big, contours, -1, colour, thickness, cv2.LINE_AA)
    away = (geometry.outer + 14.0) * np.array([np.cos(angle), -np.sin(angle)])
    x, y = _point((centre[0] + away[0], centre[1] + away[1]), scale)
    text = marker.profile.name
    wide, high = 10 * len(text) + 6, 20
    x = int(np.clip(x - wide // 2, 0, big.shape[1] - wide))
    y = int(np.clip(y - high // 2, 0, big.shape[0] - high))
    cv2.rectangle(big, (x, y), (x + wide, y + high), _EDGE, cv2.FILLED)
    cv2.putText(big, text, (x + 4, y + 15), _FONT, 0.5, _MARK, 1, cv2.LINE_AA)


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


def _draw_centre(big: Pixels, proposal: Proposal, scale: float) -> None:
    middle = _point(proposal.centre, scale)
    for thickness, colour in ((3, _EDGE), (1, _MARK)):
        if proposal.disc is not None:
            cv2.circle(big, middle, round(proposal.disc.radius * scale), colour, thickness, cv2.LINE_AA)
        cv2.drawMarker(big, middle, colour, cv2.MARKER_CROSS, 16, thickness, cv2.LINE_AA)


def _panel(proposal: Proposal, colours: dict[str, tuple[int, int, int]], height: int) -> Pixels:
    """Draw a colour swatch of each marker with its properties."""
    rows = 78 * len(proposal.markers) + 100
    panel = np.full((max(height, rows), _PANEL, 3), 255, dtype=np.uint8)
    _write(panel, proposal.profile.name, (16, 30), _INK, 0.6)
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
        _write(panel, f"{marker.profile.name} on the {marker.profile.body}", (94, top + 16), _INK, 0.55)
        _write(
            panel,
            f"{marker.profile.colour}{hue}; contrast {np.hypot(*geometry.contrast):.0f} of 255",
            (94, top + 36),
            _GREY,
        )
        size = f"{geometry.outer - geometry.inner:.0f} x {wide:.0f} px at {geometry.radius:.0f} px"
        _write(panel, f"{size}; fully visible in {100 * marker.seen:.0f} %", (94, top + 54), _GREY)
    return panel


def _notes_panel(notes: Sequence[str], width: int) -> Pixels:
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


def _text_panel(lines: Sequence[str], width: int) -> Pixels:
    strip = np.full((20 * len(lines) + (16 if lines else 0), width, 3), 255, dtype=np.uint8)
    for k, line in enumerate(lines):
        _write(strip, line, (16, 22 + 20 * k), _INK)
    return strip


def _padded(picture: Pixels, height: int) -> Pixels:
    below = np.full((height - picture.shape[0], picture.shape[1], 3), 255, dtype=np.uint8)
    return np.vstack([picture, below])


def _point(place: tuple[float, float], scale: float) -> tuple[int, int]:
    return round((place[0] + 0.5) * scale), round((place[1] + 0.5) * scale)


def _write(
    picture: Pixels, text: str, place: tuple[int, int], colour: tuple[int, int, int], size: float = 0.45
) -> None:
    cv2.putText(picture, text, place, _FONT, size, colour, 1, cv2.LINE_AA)
