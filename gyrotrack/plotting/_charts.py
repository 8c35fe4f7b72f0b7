"""Charts, drawn by matplotlib (files, PDF) or by uPlot (browser), and the style of all figures: colours, sizes, themes.

A `Chart` consists of traces (numbers, label, colour), independent of the backend. Measured data determine its vertical
scale. Two things have no influence on it: traces for comparison, and bands that are much wider than the curves because
a parameter is not determined.
"""

from __future__ import annotations

import base64
import hashlib
import html
import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from itertools import pairwise
from textwrap import fill, wrap
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# M. Okabe, K. Ito, Color Universal Design (2008)
BLUE, VERMILLION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, YELLOW = "#56B4E9", "#CC79A7", "#F0E442"
GREY, PALE = "#8c8c8c", "#d9d9d9"
BEFORE, AFTER, FAILING = VERMILLION, BLUE, YELLOW

WIDTH = 9.2
_SETTINGS: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": "#444444",
    "axes.grid": True,
    "axes.labelsize": 11,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.unicode_minus": True,
    "figure.constrained_layout.use": True,
    "figure.facecolor": "white",
    "font.family": ["DejaVu Sans"],
    "font.size": 10.5,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.7,
    "hatch.linewidth": 0.8,
    "legend.fontsize": 9.5,
    "legend.columnspacing": 1.2,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "mathtext.fontset": "dejavusans",
    "svg.fonttype": "path",
    "svg.hashsalt": "gyrotrack",
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
}
_DROPPED = re.compile(
    r"<!--.*?-->|<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<\?xml.*?\?>|<!DOCTYPE.*?>", re.DOTALL
)
_NAMES = re.compile(r'(\bid="|xlink:href="#|url\(#)')
# further characters that may be drawn
_DRAWN = "±σχΔ²³µ−–→…×"
_SIZE = re.compile(r'<svg ([^>]*?)width="([\d.]+)pt" height="([\d.]+)pt"([^>]*)>|<svg ([^>]*)>')


@dataclass(frozen=True)
class Picture:
    """A figure of the page."""

    name: str  # identifier, unique on a page
    svg: str  # markup by matplotlib, with text as outlines
    caption: str  # explanation of the figure; plain text
    finding: str  # main result, also the text alternative; plain text


@contextmanager
def style(changes: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Use the common settings of figures within the context."""
    import matplotlib as mpl

    settings: Any = {**_SETTINGS, **(changes or {})}
    with mpl.rc_context():
        mpl.rcdefaults()  # ignore matplotlibrc of the user and of the working folder
        mpl.rcParams.update(settings)
        yield


def canvas(width: float, height: float) -> Figure:
    """Return an empty figure of this size [inch], without a window system."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def picture_file(figure: Figure, kind: str, *, dpi: int = 150, title: str | None = None) -> bytes:
    """Return a figure as a file of the kind "png", "svg" or "pdf", without date and program."""
    fixed: dict[str, dict[str, Any]] = {
        "pdf": {"CreationDate": None, "Title": title},
        "svg": {"Date": None, "Creator": None},
        "png": {"Software": None},
    }
    stream = io.BytesIO()
    metadata: Any = fixed[kind]
    figure.savefig(stream, format=kind, dpi=dpi, metadata=metadata)
    return stream.getvalue()


def markup(figure: Figure, name: str, finding: str, *, tight: bool = False) -> str:
    """Return a figure as an ``svg`` element with a text alternative, its ids starting with `name`."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    stream = io.StringIO()
    metadata: dict[str, Any] = {"Date": None, "Creator": None, "Format": None, "Type": None}
    if tight:
        figure.savefig(stream, format="svg", metadata=metadata, bbox_inches="tight", pad_inches=0.03)
    else:
        # `savefig` would compute the layout twice
        surface: Any = FigureCanvasSVG(figure)
        surface.print_svg(stream, metadata=metadata)
    text = _DROPPED.sub("", stream.getvalue()).strip()
    text = _NAMES.sub(lambda m: f"{m[1]}{name}-", text)
    label = html.escape(finding, quote=True)

    def head(m: re.Match[str]) -> str:
        rest = f"{m[1]}{m[4]}"
        return f'<svg role="img" aria-label="{label}" width="{float(m[2]):.0f}pt" {rest}>'

    return _SIZE.sub(head, text, count=1)


def plain(text: str, most: int = 34) -> str:
    """Return a user's text for a figure: no mathematics, no unknown characters, at most `most` characters."""
    text = "".join(c if 32 <= ord(c) < 127 or c in _DRAWN else "?" for c in text)
    text = text if len(text) <= most else text[: most - 3] + "..."
    return text.replace("$", r"\$")


def in_lines(text: str, width: int = 26) -> str:
    """Return words for a label of a figure in at most two lines, broken between words."""
    lines = wrap(plain(text, 2 * width + 10), width)
    return "\n".join(lines if len(lines) < 3 else [lines[0], " ".join(lines[1:])])


def legend(axes: Axes, **changes: Any) -> None:
    """Draw the legend above the axes, on the left."""
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    axes.legend(**{**place, "ncols": 4, "handlelength": 1.6, **changes}, fontsize=9)


def beside(axes: Axes, text: str, at: tuple[float, float], offset: float = 4, **changes: Any) -> None:
    """Write a text to the right of a point, at a distance [pt]."""
    axes.annotate(text, at, xytext=(offset, 0), textcoords="offset points", va="center", **changes)


def as_rows(axes: Axes, labels: Sequence[str], **changes: Any) -> None:
    """Label the rows of a bar chart, the first on top, without ticks and grid lines."""
    axes.set_yticks(range(len(labels)), labels, **changes)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()


# colours that a page replaces by those of its theme
_THEMED = {
    "#000000": "ink",
    "#444444": "ink",
    "#777777": "muted",
    "#8c8e94": "muted",
    "#a9abb1": "measured",
    "#e6e6e6": "grid",
    "#ffffff": "paper",
    "#d9d9d9": "pale",
    BLUE.lower(): "blue",
    VERMILLION.lower(): "vermillion",
    GREEN.lower(): "green",
    ORANGE.lower(): "orange",
    PURPLE.lower(): "purple",
    SKY.lower(): "sky",
}
_COLOUR = re.compile("|".join(_THEMED))


def themed(svg: str) -> str:
    """Return markup with the CSS custom properties --ink, --blue ... of the page as colours."""
    return _COLOUR.sub(lambda m: f"var(--{_THEMED[m[0]]}, {m[0]})", svg)


Array = NDArray[np.float64]
TIME = "time [s]"
# largest width of a drawn band [share of the range of the curves in the chart]
_MAX_BAND = 2.0
# 16-bit integers: the resolution of 1/65000 of the range is less than 0.1 pixel on a screen
_STEPS = 32767
_REGULAR = 1e-6
_MOST_MARKED = 300  # largest number of points of a curve with markers, as in charts.js
# characters that could end a script element are written as JSON escapes
_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


@dataclass(frozen=True)
class Trace:
    """One curve."""

    label: str  # name in the legend
    # shape (n,); increasing abscissa, and value; NaN interrupts the curve
    x: Array
    value: Array
    colour: str  # colour for CSS and matplotlib
    # shape (n,); standard uncertainty; a band of +-2 standard uncertainties is drawn
    sigma: Array | None = None
    kind: Literal["line", "points", "band"] = "line"  # a line, points joined by a line, or the band alone
    width: float = 1.5  # width of the line [px]
    dash: tuple[float, ...] = ()  # lengths of dashes and gaps [px]; empty for a solid line
    # influence on the vertical scale. If a chart has reference traces (measurements), other traces extend the scale by
    # at most its height on either side; a trace with "none" has no influence
    scale: Literal["normal", "reference", "none"] = "normal"


@dataclass(frozen=True)
class Chart:
    """One pair of axes."""

    name: str  # identifier, unique on a page
    # the quantity on the vertical axis and its unit
    title: str
    unit: str
    traces: tuple[Trace, ...]  # the curves. Bands that are too wide are removed on construction
    finding: str  # main result in one sentence (text alternative)
    x_label: str = TIME  # label of the horizontal axis; charts against time share zoom and cursor
    caption: str = ""  # explanation of the chart
    # if positive, the vertical scale (matplotlib only) is linear up to this value and logarithmic beyond
    linear_within: float = 0.0
    body: str = ""  # key of the body whose intervals are shaded; without a key, all intervals are shaded

    def __post_init__(self) -> None:
        object.__setattr__(self, "traces", informative(self.traces))

    @property
    def limits(self) -> tuple[float, float]:
        """Vertical limits, without margins."""
        return vertical_limits(self.traces)


@dataclass(frozen=True)
class Interval:
    """A shaded time interval [s] of a `body`, with a short text."""

    start: float
    stop: float
    text: str
    body: str = ""


@dataclass(frozen=True)
class Dashboard:
    """Charts of one case, and the intervals with significant lack of fit."""

    title: str
    charts: tuple[Chart, ...]
    intervals: tuple[Interval, ...] = field(default=())


def _range(values: Sequence[Array]) -> tuple[float, float]:
    known = [v[np.isfinite(v)] for v in values]
    known = [v for v in known if len(v)]
    return (min(float(v.min()) for v in known), max(float(v.max()) for v in known)) if known else (0.0, 0.0)


def _span(traces: Sequence[Trace]) -> float:
    """Return the range of the reference traces; without them, of all traces that influence the scale."""
    values = [t.value for t in traces if t.scale == "reference" and t.kind != "band"]
    low, high = _range(values or [t.value for t in traces if t.scale != "none" and t.kind != "band"])
    return high - low


def informative(traces: Sequence[Trace]) -> tuple[Trace, ...]:
    """Return the traces of a chart; parts of +-2 sigma bands that are wider than the chart are removed."""
    span = _span(traces)
    found = []
    for t in traces:
        if t.sigma is not None and t.kind != "band" and span > 0:
            known = np.isfinite(t.sigma)
            narrow = known & (2 * np.where(known, t.sigma, 0.0) <= _MAX_BAND * span)
            if not narrow.all():
                wide = bool((known & ~narrow).any())
                label = f"{t.label} (band wider than the chart)" if wide else t.label
                sigma = np.where(narrow, t.sigma, np.nan) if narrow.any() else None
                t = replace(t, sigma=sigma, label=label)
        found.append(t)
    return tuple(found)


def vertical_limits(traces: Sequence[Trace]) -> tuple[float, float]:
    """Return the vertical limits of traces.

    The reference traces determine the height; without reference traces, all traces with influence on the scale
    determine it. Other traces and bands extend the limits by at most this height on either side.
    """
    main = [t for t in traces if t.scale == "reference"] or [t for t in traces if t.scale == "normal"]
    low, high = _range([t.value for t in main if t.kind != "band"] or [t.value for t in main])
    room = high - low
    edges = []
    for t in traces:
        if t.scale != "none":
            edges += [t.value] if t.sigma is None else [t.value, t.value - 2 * t.sigma, t.value + 2 * t.sigma]
    least, most = _range(edges) if edges else (low, high)
    if room <= 0:
        return (least, most) if most > least else (low - 1.0, high + 1.0)
    return max(least, low - room), min(most, high + room)


def thin(x: Array, value: Array, most: int = 2000) -> tuple[Array, Array]:
    """Return at most `most` points of a curve, the minimum and maximum of each bin, so that no peak is lost."""
    if len(x) <= most:
        return x, value
    edges = np.linspace(0, len(x), most // 2 + 1).astype(int)
    low = [a + int(np.argmin(value[a:b])) for a, b in pairwise(edges)]
    high = [a + int(np.argmax(value[a:b])) for a, b in pairwise(edges)]
    keep = np.unique([*low, *high])
    return x[keep], value[keep]


def concatenated(
    label: str, curves: Sequence[tuple[Array, Array, Array | None]], colour: str, **options: Any
) -> Trace:
    """Concatenate curves (x, value, sigma) that do not overlap into one trace with interruptions."""
    parts = [np.zeros((3, 0))]
    for i, (t, v, s) in enumerate(curves):
        parts.append(np.stack([t, v, np.zeros_like(v) if s is None else s]))
        if i + 1 < len(curves) and len(t) and len(curves[i + 1][0]):
            parts.append(np.array([[0.5 * (t[-1] + curves[i + 1][0][0])], [np.nan], [np.nan]]))
    x, value, sigma = np.concatenate(parts, axis=1)
    return Trace(label, x, value, colour, sigma if np.nansum(sigma) > 0 else None, **options)


def draw(
    ax: Axes,
    chart: Chart,
    intervals: Sequence[Interval] = (),
    *,
    window: tuple[float, float] | None = None,
    limits: tuple[float, float] | None = None,
    most: int = 1200,
) -> None:
    """Draw a chart without legend, with shaded `intervals` [s], within a time `window` and vertical `limits`."""
    from matplotlib.ticker import NullLocator

    label: str | None = "lack of fit"
    for i in intervals:
        start, stop = i.start, i.stop
        if window is not None:
            start, stop = max(start, window[0]), min(stop, window[1])
        if start < stop:
            ax.axvspan(start, stop, color=FAILING, alpha=0.3, linewidth=0, zorder=0.5, label=label)
            label = None
    for t in chart.traces:
        x, value, sigma = t.x, t.value, t.sigma
        if window is not None:
            inside = (x >= window[0]) & (x <= window[1])
            x, value, sigma = x[inside], value[inside], None if sigma is None else sigma[inside]
        if sigma is not None:
            few = slice(None, None, max(1, len(x) // most))
            band = (value - 2 * sigma)[few], (value + 2 * sigma)[few]
            alpha, name = (0.55, t.label) if t.kind == "band" else (0.22, None)
            ax.fill_between(x[few], *band, color=t.colour, alpha=alpha, linewidth=0, label=name)
        if t.kind != "band":
            marked = t.kind == "points" and len(t.x) < _MOST_MARKED
            marks: dict[str, Any] = {"marker": "o", "markersize": 2.2} if marked else {}
            ax.plot(
                *thin(x, value, most),
                color=t.colour,
                linewidth=0.85 * t.width,
                linestyle=(0, tuple(d / (0.85 * t.width) for d in t.dash)) if t.dash else "-",
                label=plain(t.label, 60),
                **marks,
            )
    low, high = limits or chart.limits
    if chart.linear_within > 0:
        ax.set_yscale("symlog", linthresh=chart.linear_within, linscale=0.8, subs=[])
        ax.set_ylim(min(1.5 * low, -1.5 * chart.linear_within), max(1.5 * high, 1.5 * chart.linear_within))
        decades = 10.0 ** np.arange(1, 1 + max(1, np.ceil(np.log10(max(abs(low), abs(high), 10.0)))))
        ax.set_yticks([*-decades[::-1], 0.0, *decades], minor=False)
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_locator(NullLocator())
    else:
        room = 0.05 * (high - low) or 1.0
        ax.set_ylim(low - room, high + room)
    if low < 0 < high:
        ax.axhline(0, color="#777777", linewidth=0.8, zorder=0.8)
    if window is not None:
        ax.set_xlim(*window)
    else:
        ax.margins(x=0.01)
    ax.set_xlabel(chart.x_label)
    ax.set_ylabel(f"{chart.title} [{chart.unit}]")


# widths for the layout of a legend: symbol with spacing, mean character, margin left of the axes [inch]
_KEY, _CHARACTER, _LEFT = 0.4, 0.07, 0.8
_SHORT = 27  # characters of a short label


def chart_picture(
    chart: Chart,
    intervals: Sequence[Interval] = (),
    *,
    name: str = "",
    size: tuple[float, float] = (9.2, 3.3),
) -> Picture:
    """Draw a chart as SVG for a page, with shaded intervals [s]; the size is width and height [inch]."""
    with style():
        figure = canvas(*size)
        ax = figure.subplots()
        draw(ax, chart, intervals if chart.x_label == TIME else ())
        handles, labels = ax.get_legend_handles_labels()
        widest = max(map(len, labels), default=0)
        for handle, label in zip(handles, labels, strict=True):
            handle.set_label(fill(label, max(int((size[0] - _LEFT - _KEY) / _CHARACTER), 1)))
        legend(ax, ncols=max(1, int(size[0] / (_KEY + _CHARACTER * max(widest, _SHORT)))))
        name = name or chart.name
        return Picture(name, markup(figure, name, chart.finding), chart.caption, chart.finding)


def dashboard_document(board: Dashboard) -> dict[str, Any]:
    """Return a dashboard as a document for the script `charts.js`."""
    return {
        "title": board.title,
        "intervals": [interval_document(i) for i in board.intervals],
        "charts": [
            {
                key: getattr(c, key)
                for key in ("name", "title", "unit", "finding", "caption", "x_label", "body")
            }
            | {"is_time": c.x_label == TIME, "traces": [_trace(t) for t in c.traces]}
            for c in board.charts
        ],
    }


def interval_document(i: Interval) -> dict[str, Any]:
    """Return an interval as a document for the script `charts.js`."""
    return {"start": i.start, "stop": i.stop, "text": i.text, "body": i.body}


def _trace(t: Trace) -> dict[str, Any]:
    document: dict[str, Any] = {k: getattr(t, k) for k in ("label", "colour", "kind", "width", "scale")}
    document |= {"dash": list(t.dash), "x": _abscissa(t.x), "value": _values(t.value)}
    if t.sigma is not None:
        document["sigma"] = _values(t.sigma)
    return document


def _abscissa(x: Array) -> dict[str, Any]:
    """Return start and step of regularly spaced values; for other values, 32-bit values relative to the first."""
    if len(x) > 2:
        step = float(x[-1] - x[0]) / (len(x) - 1)
        if step > 0 and np.abs(x - x[0] - step * np.arange(len(x))).max() < _REGULAR * step:
            return {"start": float(x[0]), "step": step, "count": len(x)}
    first = float(x[0]) if len(x) else 0.0
    return {"floats": _packed((x - first).astype("<f4")), "first": first, "count": len(x)}


def _values(value: Array) -> dict[str, Any]:
    """Return values as 16-bit integers with scale and offset; the smallest integer represents NaN."""
    known = np.isfinite(value)
    low, high = (float(value[known].min()), float(value[known].max())) if known.any() else (0.0, 0.0)
    middle, half = 0.5 * low + 0.5 * high, max(0.5 * high - 0.5 * low, 1e-300)
    steps = np.full(len(value), -_STEPS - 1, dtype="<i2")
    steps[known] = np.round((value[known] - middle) / half * _STEPS)
    return {"steps": _packed(steps), "scale": half / _STEPS, "offset": middle, "count": len(value)}


def _packed(numbers: NDArray[Any]) -> str:
    return base64.b64encode(numbers.tobytes()).decode("ascii")


@cache
def scripts() -> tuple[str, str]:
    """Return the scripts of interactive charts: uPlot (MIT licence) and `charts.js`."""
    licence = "/* uPlot 1.6.32, (c) Leon Sorokin, MIT licence, https://github.com/leeoniya/uPlot */\n"
    return licence + _read("vendor/uPlot.iife.min.js"), _read("charts.js")


@cache
def style_sheet() -> str:
    """Return the style sheet of interactive charts."""
    return _read("vendor/uPlot.min.css") + _read("charts.css")


@cache
def theme() -> str:
    """Return the custom properties (colours, light and dark) of report and workbench."""
    return _read("theme.css")


def as_data(document: Any) -> str:
    """Return a document as JSON for a ``script`` element of the type application/json."""
    return json.dumps(document, allow_nan=False, separators=(",", ":")).translate(_ESCAPES)


# policy of a page without the hashes of its scripts
PAGE_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'none'"
)


def content_policy(scripts: Sequence[str], *, connect: bool = False) -> str:
    """Return a content security policy: only these inline scripts run; with `connect`, the page may call its server."""
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
