"""Interactive charts on one time axis."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

# what could end the element, or begin a comment or another element, is written as an escape of JSON
_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


@cache
def script() -> str:
    """Return the script."""
    return _read("charts.js")


@cache
def style() -> str:
    """Return the style sheet."""
    return _read("charts.css")


def as_data(document: Any) -> str:
    """Return a document as JSON that may stand inside a ``script`` element of the type application/json."""
    return json.dumps(document, allow_nan=False, separators=(",", ":")).translate(_ESCAPES)


def content_policy(scripts: Sequence[str], *, connect: bool = False) -> str:
    """Return a content security policy under which these scripts run and nothing else.

    Parameters
    ----------
    scripts : sequence of str
        The exact text of each inline script.
    connect : bool
        Whether the page may talk to the server that it came from.
    """
    hashes = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts]
    allowed = " ".join(f"'sha256-{h}'" for h in hashes) or "'none'"
    parts = [
        "default-src 'none'",
        f"script-src {allowed}",
        "style-src 'unsafe-inline'",
        "img-src data: blob:" if connect else "img-src data:",
        "base-uri 'none'",
        "form-action 'none'",
    ]
    return "; ".join([*parts, "connect-src 'self'"] if connect else parts)


def _read(name: str) -> str:
    return resources.files("gyrotrack.plotting").joinpath(name).read_text("utf-8")


Array = NDArray[np.float64]

# whole numbers of 16 bits: 1/65000 of the range, less than a hundredth of a pixel of a curve that fills a screen
_STEPS = 32767
_REGULAR = 1e-6


@dataclass(frozen=True)
class Trace:
    """One curve.

    Attributes
    ----------
    label : str
        Its name in the legend.
    time, value : ndarray, shape (n,)
        Time [s] and value; a value that is no number parts the curve.
    colour : str
        Colour of the line, as in CSS.
    sigma : ndarray or None
        Standard deviation; a band of two of them is drawn.
    kind : {"line", "points", "band"}
        A line, dots joined by a line, or only the band.
    width : float
        Of the line [px].
    dash : tuple of float
        Lengths of strokes and gaps [px]; none is a full line.
    beside : bool
        Drawn as far as it lies within the panel; the panel's range is that of the others.
    """

    label: str
    time: Array
    value: Array
    colour: str
    sigma: Array | None = None
    kind: Literal["line", "points", "band"] = "line"
    width: float = 1.5
    dash: tuple[float, ...] = ()
    beside: bool = False


@dataclass(frozen=True)
class Chart:
    """One panel: `name` is its place in the page, `axis` the quantity with its unit, `finding` what it says."""

    name: str
    title: str
    axis: str
    traces: tuple[Trace, ...]
    finding: str


@dataclass(frozen=True)
class Mark:
    """A stretch of time to be marked in all panels, with a short text."""

    start: float
    stop: float
    text: str


@dataclass(frozen=True)
class Board:
    """Panels on one time axis."""

    title: str
    charts: tuple[Chart, ...]
    marks: tuple[Mark, ...] = field(default=())


def board_document(board: Board) -> dict[str, Any]:
    """Return a board as the script reads it."""
    return {
        "title": board.title,
        "marks": [{"start": m.start, "stop": m.stop, "text": m.text} for m in board.marks],
        "charts": [
            {
                "name": c.name,
                "title": c.title,
                "axis": c.axis,
                "finding": c.finding,
                "traces": [_trace(t) for t in c.traces],
            }
            for c in board.charts
        ],
    }


def _trace(t: Trace) -> dict[str, Any]:
    document: dict[str, Any] = {
        "label": t.label,
        "colour": t.colour,
        "kind": t.kind,
        "width": t.width,
        "dash": list(t.dash),
        "beside": t.beside,
        "time": _times(t.time),
        "value": _values(t.value),
    }
    if t.sigma is not None:
        document["sigma"] = _values(t.sigma)
    return document


def _times(time: Array) -> dict[str, Any]:
    """Return start and step of regular times, else each of them."""
    if len(time) > 2:
        step = float(time[-1] - time[0]) / (len(time) - 1)
        if step > 0 and np.abs(time - time[0] - step * np.arange(len(time))).max() < _REGULAR * step:
            return {"start": float(time[0]), "step": step, "count": len(time)}
    return {"floats": _packed(time.astype("<f4")), "count": len(time)}


def _values(value: Array) -> dict[str, Any]:
    """Return values as whole numbers of 16 bits with scale and offset; the lowest number stands for none."""
    known = np.isfinite(value)
    low, high = (float(value[known].min()), float(value[known].max())) if known.any() else (0.0, 0.0)
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), 1e-300)
    steps = np.full(len(value), -_STEPS - 1, dtype="<i2")
    steps[known] = np.round((value[known] - middle) / half * _STEPS)
    return {"steps": _packed(steps), "scale": half / _STEPS, "offset": middle, "count": len(value)}


def _packed(numbers: NDArray[Any]) -> str:
    return base64.b64encode(numbers.tobytes()).decode("ascii")
