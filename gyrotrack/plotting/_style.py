"""Style of all figures: colours, sizes, reproducible SVG with themes."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

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
    """A figure of the page.

    Attributes
    ----------
    name : str
        Identifier, unique on a page.
    svg : str
        Markup by matplotlib, with text as outlines.
    caption : str
        Explanation of the figure; plain text.
    finding : str
        Main result, also the text alternative; plain text.
    """

    name: str
    svg: str
    caption: str
    finding: str


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
    """Return text of users for a figure: without mathematics and unknown characters, at most `most` characters long."""
    text = "".join(c if 32 <= ord(c) < 127 or c in _DRAWN else "?" for c in text)
    text = text if len(text) <= most else text[: most - 3] + "..."
    return text.replace("$", r"\$")


def legend(axes: Axes, **changes: Any) -> None:
    """Draw the legend above the axes, on the left."""
    place = {
        "loc": "lower left",
        "bbox_to_anchor": (0.0, 1.0),
        "borderaxespad": 0.2,
        "ncols": 4,
        "handlelength": 1.6,
    }
    axes.legend(**{**place, **changes}, fontsize=9)


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
