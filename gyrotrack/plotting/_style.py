"""One style for all figures: colours, sizes, reproducible SVG."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gyrotrack.plotting._study_data import CaseView


# M. Okabe, K. Ito, Color Universal Design (2008)
BLUE, VERMILLION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, YELLOW = "#56B4E9", "#CC79A7", "#F0E442"
GREY, PALE = "#8c8c8c", "#d9d9d9"
BEFORE, AFTER, FAILING = VERMILLION, BLUE, YELLOW

WIDTH = 9.2
_LOOK: dict[str, Any] = {
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
_SIZE = re.compile(r'<svg ([^>]*?)width="([\d.]+)pt" height="([\d.]+)pt"([^>]*)>|<svg ([^>]*)>')


@dataclass(frozen=True)
class Picture:
    """A figure of the page.

    Attributes
    ----------
    name : str
        Its place in the page, unique, made by the program.
    svg : str
        Markup made by matplotlib alone: all text is drawn as outlines.
    caption : str
        What is seen; plain text.
    finding : str
        What it says, for those who do not see it; plain text.
    """

    name: str
    svg: str
    caption: str
    finding: str


@contextmanager
def look(changes: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Use the look of the report inside the block."""
    import matplotlib as mpl

    settings: Any = {**_LOOK, **(changes or {})}
    with mpl.rc_context():
        mpl.rcdefaults()  # neither a matplotlibrc in the working folder nor the user's changes a figure
        mpl.rcParams.update(settings)
        yield


def canvas(width: float, height: float) -> Figure:
    """Return an empty figure, in inches; no window system is asked."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def picture(name: str, figure: Figure, caption: str, finding: str) -> Picture:
    """Return a figure as markup for the page."""
    return Picture(name, markup(figure, name, finding), caption, finding)


def markup(figure: Figure, name: str, finding: str, *, tight: bool = False) -> str:
    """Return a figure as an ``svg`` element with a text alternative, its ids starting with `name`."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    stream = io.StringIO()
    nothing: dict[str, Any] = {"Date": None, "Creator": None, "Format": None, "Type": None}
    if tight:
        figure.savefig(stream, format="svg", metadata=nothing, bbox_inches="tight", pad_inches=0.03)
    else:
        # one pass: `savefig` would draw all of it once more, to find the places that are found here while drawing
        surface: Any = FigureCanvasSVG(figure)
        surface.print_svg(stream, metadata=nothing)
    text = _DROPPED.sub("", stream.getvalue()).strip()
    text = _NAMES.sub(lambda m: f"{m[1]}{name}-", text)
    label = html.escape(finding, quote=True)

    def head(m: re.Match[str]) -> str:
        rest = f"{m[1]}{m[4]}"
        return f'<svg role="img" aria-label="{label}" width="{float(m[2]):.0f}pt" {rest}>'

    return _SIZE.sub(head, text, count=1)


def plain(text: str, most: int = 34) -> str:
    """Return text of users for a figure: no mathematics, no characters that the font lacks, not too long."""
    text = "".join(c if 32 <= ord(c) < 127 else "?" for c in text)
    text = text if len(text) <= most else text[: most - 3] + "..."
    return text.replace("$", r"\$")


def legend(axes: Axes, **changes: Any) -> None:
    """Write the legend above the axes, on the right, where it covers nothing."""
    place = {
        "loc": "lower right",
        "bbox_to_anchor": (1.0, 1.0),
        "borderaxespad": 0.2,
        "ncols": 4,
        "handlelength": 1.6,
    }
    axes.legend(**{**place, **changes})


def zero(axes: Axes) -> None:
    """Draw a line at zero, behind everything."""
    axes.axhline(0, color="#777777", linewidth=0.8, zorder=0.8)


def panel(axes: Axes, letter: str, title: str) -> None:
    """Write the letter and the title of a panel."""
    axes.set_title(f"({letter})  {title}" if letter else title)


def get_ready() -> None:
    """Load what all figures need, in a process that will draw some."""
    import matplotlib.backends.backend_svg  # noqa: F401


Array = NDArray[np.float64]

MOST = 2000


def thin(time: Array, value: Array, most: int = MOST) -> tuple[Array, Array]:
    """Return at most `most` of the points, in order.

    Parameters
    ----------
    time, value : ndarray, shape (n,)
        The curve; no value is made up, each point that is returned is one of these.
    most : int
        How many points may stay.
    """
    if len(time) <= most:
        return time, value
    edges = np.linspace(0, len(time), most // 2 + 1).astype(int)
    low = [a + int(np.argmin(value[a:b])) for a, b in pairwise(edges)]
    high = [a + int(np.argmax(value[a:b])) for a, b in pairwise(edges)]
    keep = np.unique([*low, *high])
    return time[keep], value[keep]


def failing(ax: Axes, view: CaseView, body: str, within: tuple[float, float] | None = None) -> None:
    """Shade where the base model fails on a body; only what lies `within` two times, if they are given."""
    label: str | None = "base model fails"
    for f in view.failures:
        start, stop = (
            (f.t_start, f.t_stop) if within is None else (max(f.t_start, within[0]), min(f.t_stop, within[1]))
        )
        if f.body != body or start >= stop:
            continue
        ax.axvspan(start, stop, color=FAILING, alpha=0.3, linewidth=0, zorder=0.5, label=label)
        label = None
