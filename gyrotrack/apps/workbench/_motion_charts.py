"""Charts of angle and speed of every film of the work folder, also while it is tracked.

The motion of a tracked film is that of its recording. While a film is tracked, the finished parts of its checkpoint are
shown. When the clips are synchronised, all are drawn on the clock of the casing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrotrack._errors import GyrotrackError
from gyrotrack.io._atomic import Record, checkpoint_path, written_records
from gyrotrack.io._hdf5 import read_case
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
from gyrotrack.tracking._film_parts import turns_between

if TYPE_CHECKING:
    from gyrotrack.apps.workbench._project import Project, Source

Array = NDArray[np.float64]
Curve = tuple[
    str, str, str, list[tuple[Array, Array, Array]]
]  # film, body, colour, pieces (time, angle, speed)

_DRAWN = 900  # points of a curve
_WIDTH = 9  # samples of the running median of a speed while the film is tracked
_CASING, _FILMED_WITH, _ROTORS = BLUE, SKY, (VERMILLION, GREEN, ORANGE, PURPLE)
_TURN = 2 * np.pi


def motion_board(project: Project) -> dict[str, Any]:
    """Return the charts of angle and speed of all films and tables as a document; without charts if none is known."""
    curves: list[Curve] = []
    offsets = _offsets(project)
    rotors = 0
    for x in list(project.state.sources):
        for body, pieces in _pieces(project, x).items():
            if body != "casing" and x.body == "rotor":
                colour = _ROTORS[rotors % len(_ROTORS)]
                rotors += 1
            elif x.body == "rotor":
                continue  # the casing in the films of the rotor serves the synchronisation
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
            label = f"{film}, {body}" if body != "single" else film
            traces.append(concatenated(label, parts, colour, width=1.6))
    finding = f"{title} of {len(traces)} film{'' if len(traces) == 1 else 's'}."
    return Chart(
        name, title, unit, tuple(traces), finding, caption="Each film on its own clock until synchronised."
    )


def _pieces(project: Project, x: Source) -> dict[str, list[tuple[Array, Array, Array]]]:
    """Return the known pieces of the motion of each body of a source."""
    if x.kind == "table":
        job = project.jobs.get(f"read:{x.key}")
        plots = job.document.get("plot", []) if job is not None and job.state == "done" else []
        return {p["body"]: [_from_speed(np.array(p["time"]), np.array(p["omega"]))] for p in plots}
    try:
        if x.body == "single":
            return _of_case(project.folder / x.output) if x.result else {}
        recording = project.recording(x.key)
    except GyrotrackError:
        return {}
    if recording is not None:
        return {name: [_thinned(b.time, b.angle, b.omega)] for name, b in recording.bodies.items()}
    if x.kind == "film" and x.capture_fps and x.output:
        return _tracked_so_far(written_records(checkpoint_path(project.folder / x.output)), x.capture_fps)
    return {}


def _of_case(path: Path) -> dict[str, list[tuple[Array, Array, Array]]]:
    series = read_case(path).casing
    return {"single": [_thinned(series.time, series.angle, series.omega)]}


def _from_speed(time: Array, omega: Array) -> tuple[Array, Array, Array]:
    step = np.diff(time, prepend=time[:1])
    return time, np.cumsum(omega * step), omega


def _thinned(time: Array, angle: Array, omega: Array) -> tuple[Array, Array, Array]:
    if not len(time):
        return time, angle, omega
    if np.isfinite(omega).sum() < len(omega) / 2:  # the record is shorter than the smoothing of its speed
        omega = _speed(time, angle)
    few = np.unique(np.linspace(0, len(time) - 1, min(len(time), _DRAWN)).astype(int))
    return time[few], angle[few] - angle[0], omega[few]


def _tracked_so_far(records: Sequence[Record], rate: float) -> dict[str, list[tuple[Array, Array, Array]]]:
    """Return the motion in the finished parts of a film, with angles that continue from one part to the next."""
    parts = sorted(
        (r for r in records if isinstance(r.facts.get("part"), int) and "stamps" in r.arrays),
        key=lambda r: int(r.facts["part"]),
    )
    known = np.unique(np.concatenate([p.arrays["stamps"] for p in parts])) if parts else np.zeros(0)
    tick = float(np.median(np.diff(known))) if len(known) > 1 else 1.0
    found: dict[str, list[tuple[Array, Array, Array]]] = {}
    last: dict[str, tuple[Array, Array]] = {}
    for part in parts:
        frame = np.rint(np.asarray(part.arrays["stamps"], dtype=np.float64) / max(tick, 1e-9))
        for key, values in part.arrays.items():
            body, _, kind = key.partition("/")
            if kind != "coarse":
                continue
            angle = np.asarray(values, dtype=np.float64)
            if body in last:
                angle = angle + turns_between(*last[body], frame, angle)
            last[body] = frame, angle
            seen = np.isfinite(angle)
            if seen.sum() > _WIDTH:
                step = max(1, int(seen.sum()) // _DRAWN)
                time, some = frame[seen][::step] / rate, angle[seen][::step]
                found.setdefault(body, []).append((time, some, _speed(time, some)))
    return found


def _speed(time: Array, angle: Array) -> Array:
    from scipy.ndimage import median_filter

    steps = np.diff(angle) / np.maximum(np.diff(time), 1e-12)
    return np.asarray(median_filter(np.append(steps, steps[-1]), _WIDTH, mode="nearest"))


def _offsets(project: Project) -> dict[str, float]:
    """Return the start of each film on the clock of the casing [s]; empty before the synchronisation."""
    if not project.document()["is_matched"]:
        return {}
    return {c["name"]: float(c["offset_s"]) for c in project.state.match.get("clips", [])}
