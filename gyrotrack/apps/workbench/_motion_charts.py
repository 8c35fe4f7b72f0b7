"""Charts of angle and speed of every film of the work folder, also during tracking.

For a tracked film, the motion of its recording is shown. During tracking, the angles found so far are shown, and after
an interruption the angles in the checkpoint. Synchronised clips are drawn on the clock of the casing.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrotrack._errors import GyrotrackError
from gyrotrack.apps.workbench._growing_motion import Piece, joined_motion, speed, stored_parts
from gyrotrack.io._atomic import checkpoint_path, written_records
from gyrotrack.io._hdf5 import read_case, read_kind, read_recording
from gyrotrack.plotting._charts import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    Chart,
    Dashboard,
    concatenated,
    dashboard_document,
)

if TYPE_CHECKING:
    from gyrotrack.apps.workbench._project import Project
    from gyrotrack.apps.workbench._state import Source

Array = NDArray[np.float64]
Curve = tuple[str, str, str, list[Piece]]  # film, body, colour, and pieces of the motion of a curve

_DRAWN = 900  # largest number of drawn points of a curve
_CASING, _FILMED_WITH, _ROTORS = BLUE, SKY, (VERMILLION, GREEN, ORANGE, PURPLE)
_TURN = 2 * np.pi
# names of curves: film and body, or the film alone for a single body
_LABEL, _LABELS = "{}, {}", {"single": "{}"}


def motion_board(project: Project) -> dict[str, Any]:
    """Return the charts of angle and speed of all films and tables as a document; empty if no motion is known."""
    curves: list[Curve] = []
    offsets = _offsets(project)
    rotors = 0
    for x in list(project.state.sources):
        for body, pieces in _pieces(project, x).items():
            if body != "casing" and x.body == "rotor":
                colour = _ROTORS[rotors % len(_ROTORS)]
                rotors += 1
            elif x.body == "rotor":
                # the motion of the casing in the films of the rotor is not drawn, because it is used for
                # synchronisation only
                continue
            else:
                colour = _FILMED_WITH if body == "rotor" else _CASING
            offset = offsets.get(Path(x.file).name, 0.0)
            curves.append((Path(x.file).name, body, colour, [(t + offset, a, w) for t, a, w in pieces]))
    charts = (_chart("speed", "Speed", "rad/s", curves, 2), _chart("angle", "Angle", "turns", curves, 1))
    board = dashboard_document(Dashboard("motion", tuple(c for c in charts if c.traces)))
    board["clock"] = "common" if offsets else "own"
    return board


def _chart(name: str, title: str, unit: str, curves: Sequence[Curve], column: int) -> Chart:
    traces = []
    for film, body, colour, pieces in curves:
        parts = [(t, v[column - 1] / (_TURN if column == 1 else 1.0), None) for t, *v in pieces if len(t)]
        parts.sort(key=lambda p: float(p[0][0]))
        if parts:
            traces.append(
                concatenated(_LABELS.get(body, _LABEL).format(film, body), parts, colour, width=1.6)
            )
    finding = f"{title} of {len(traces)} film{'' if len(traces) == 1 else 's'}."
    return Chart(
        name,
        title,
        unit,
        tuple(traces),
        finding,
        caption="Each film has its own clock before synchronisation.",
    )


def _pieces(project: Project, x: Source) -> dict[str, list[Piece]]:
    """Return the known pieces of the motion of each body of a source."""
    if x.kind == "table":
        job = project.jobs.get(f"read:{x.key}")
        plots = job.document.get("plot", []) if job is not None and job.state == "done" else []
        return {p["body"]: [_from_speed(np.array(p["time"]), np.array(p["omega"]))] for p in plots}
    job = project.jobs.get(f"track:{x.key}")
    output = project.folder / x.output if x.kind == "film" else project.path(x)
    if x.kind == "film" and x.capture_fps and job is not None and job.is_active:
        return joined_motion(job.motion.parts(), x.capture_fps)
    try:
        if project.is_tracked(x) and output.is_file():
            return _measured(output, output.stat().st_mtime_ns)
    except (GyrotrackError, OSError):
        return {}
    if x.kind == "film" and x.capture_fps and x.output:
        return joined_motion(stored_parts(written_records(checkpoint_path(output))), x.capture_fps)
    return {}


@lru_cache(maxsize=16)
def _measured(path: Path, _modified: int) -> dict[str, list[Piece]]:
    """Return the motion in a recording, or in the case of a single body."""
    if read_kind(path) == "recording":
        bodies = read_recording(path).bodies
        return {name: [_thinned(b.time, b.angle, b.omega)] for name, b in bodies.items()}
    series = read_case(path).casing
    return {"single": [_thinned(series.time, series.angle, series.omega)]}


def _from_speed(time: Array, omega: Array) -> Piece:
    step = np.diff(time, prepend=time[:1])
    return time, np.cumsum(omega * step), omega


def _thinned(time: Array, angle: Array, omega: Array) -> Piece:
    if not len(time):
        return time, angle, omega
    if (
        np.isfinite(omega).sum() < len(omega) / 2
    ):  # the record is shorter than the smoothing window of the speed
        omega = speed(time, angle)
    few = np.unique(np.linspace(0, len(time) - 1, min(len(time), _DRAWN)).astype(int))
    return time[few], angle[few] - angle[0], omega[few]


def _offsets(project: Project) -> dict[str, float]:
    """Return the start of each film on the clock of the casing [s]; empty before the synchronisation."""
    if not project.document()["is_matched"]:
        return {}
    return {c["name"]: float(c["offset_s"]) for c in project.state.match.get("clips", [])}
