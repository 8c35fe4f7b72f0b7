"""Projects of OSP Tracker: a point on a unit circle for each body, in the frames of one film.

A project has frames at equal intervals and no times of its own, so that only records with times on such a grid can be
exported.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from typing import BinaryIO
from xml.sax.saxutils import escape

import numpy as np

from gyrotrack._errors import UsageError
from gyrotrack.io._records import Floats

_PACKAGE = "org.opensourcephysics"
# origin of the axes [px], and radius of the circle of a body [px], which is one unit of the axes
_ORIGIN, _RADIUS = (320.0, 240.0), 200.0
_OFF_GRID = 0.05  # largest deviation of a time from the grid [interval]
_MOST_FRAMES = 1_000_000
_MEMBER = "motion.trk"


def write_project(
    stream: BinaryIO, bodies: Sequence[tuple[str, Floats, Floats]], *, zipped: bool = False
) -> None:
    """Write a project of bodies, each with its name, times [s] and angles [rad].

    If `zipped`, a .trz archive is written.
    """
    content = _document(bodies).encode()
    if not zipped:
        stream.write(content)
        return
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        # a fixed date, so that equal contents give identical files
        archive.writestr(zipfile.ZipInfo(_MEMBER, (1980, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)


def _document(bodies: Sequence[tuple[str, Floats, Floats]]) -> str:
    times = np.unique(np.concatenate([time for _, time, _ in bodies]))
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    place = (times - times[0]) / step if step > 0 else np.zeros(len(times))
    # the mean interval of the whole record is used, because the intervals between neighbouring times are rounded
    step = float(times[-1] - times[0]) / max(float(np.rint(place[-1])), 1.0) if step > 0 else 0.0
    place = (times - times[0]) / step if step > 0 else place
    if not step or np.abs(place - np.rint(place)).max() > _OFF_GRID or place[-1] > _MOST_FRAMES:
        what = (
            f"A project of OSP Tracker needs times at equal intervals and at most {_MOST_FRAMES:,} frames; the times "
            "do not meet this."
        )
        raise UsageError(what, "Export text of OSP Tracker: -o FILE.txt.")
    last = int(np.rint(place[-1])) + 1
    axes = {"xorigin": _ORIGIN[0], "yorigin": _ORIGIN[1], "xangle": 0.0, "xscale": _RADIUS, "yscale": _RADIUS}
    frame = _object("media.core.ImageCoordSystem$FrameData", "".join(_number(k, v) for k, v in axes.items()))
    array = _array(
        "media.core.ImageCoordSystem$FrameData", [f'<property name="[0]" type="object">{frame}</property>']
    )
    clip = f"{_whole('startframe', 0)}{_whole('stepsize', 1)}{_whole('stepcount', last)}"
    parts = [
        _named("videoclip", _object("media.core.VideoClip", f"{clip}{_number('starttime', 1e3 * times[0])}")),
        _named("clipcontrol", _object("media.core.StepperClipControl", _number("delta_t", 1e3 * step))),
        _named("coords", _object("media.core.ImageCoordSystem", array)),
        '<property name="tracks" type="collection" class="java.util.ArrayList">',
        *(
            f'<property name="item" type="object">{_track(name, np.rint((time - times[0]) / step), angle)}</property>'
            for name, time, angle in bodies
        ),
        "</property>",
    ]
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    return head + _object("cabrillo.tracker.TrackerPanel", "\n".join(parts)) + "\n"


def _track(name: str, frames: Floats, angle: Floats) -> str:
    cells = [
        f'<property name="[{frame}]" type="object">'
        + _object(
            "cabrillo.tracker.PointMass$FrameData", _whole("n", frame) + _number("x", x) + _number("y", y)
        )
        + "</property>"
        for frame, x, y in _positions(frames, angle)
    ]
    title = f'<property name="name" type="string">{escape(name)}</property>{_number("mass", 1.0)}'
    return _object(
        "cabrillo.tracker.PointMass", title + _array("cabrillo.tracker.PointMass$FrameData", cells)
    )


def _positions(frames: Floats, angle: Floats) -> Iterator[tuple[int, float, float]]:
    known = np.isfinite(angle)
    x, y = _ORIGIN[0] + _RADIUS * np.cos(angle), _ORIGIN[1] - _RADIUS * np.sin(angle)  # y downwards
    yield from zip(frames[known].astype(int).tolist(), x[known].tolist(), y[known].tolist(), strict=True)


def _object(kind: str, content: str) -> str:
    return f'<object class="{_PACKAGE}.{kind}">{content}</object>'


def _named(name: str, content: str) -> str:
    return f'<property name="{name}" type="object">{content}</property>'


def _array(kind: str, cells: Sequence[str]) -> str:
    return (
        f'<property name="framedata" type="array" class="[L{_PACKAGE}.{kind};">'
        + "\n".join(cells)
        + "</property>"
    )


def _number(name: str, value: float) -> str:
    return f'<property name="{name}" type="double">{float(value)!r}</property>'


def _whole(name: str, value: int) -> str:
    return f'<property name="{name}" type="int">{value}</property>'
