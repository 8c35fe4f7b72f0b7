"""Elements of the display of results in a notebook: HTML tables, and curves in matplotlib axes.

The functions take texts, arrays and axes. Each class of results uses them in its methods `plot` and `_repr_html_`.
matplotlib is imported only when a figure is made.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import cycle
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EstimationError
from fitting._numbers import TORQUE, nonbreaking

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_ANSWERS = ("#0072B2", "#BBBBBB", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
BLUE, VERMILLION, GREY, YELLOW = "#0072B2", "#D55E00", "#BBBBBB", "#F0E442"
_BODIES = (VERMILLION, BLUE, *_ANSWERS[3:])
_VERDICTS = {
    "adequate": ("✓", "consistent with noise"),
    "no_lack_of_fit": ("✓", "no significant lack of fit"),
    "lack_of_fit": ("!", "significant lack of fit"),
    "not_determined": ("!", "a parameter is not determined"),
    "not_converged": ("✗", "not converged: do not use these numbers"),
    "undecided": ("?", "undecided: nothing is established"),
    "missing_effect": ("✚", "an effect is missing"),
    "unexplained": ("!", "an unexplained torque remains"),
}


class SpeedCurve(Protocol):
    """Times [s] and speeds with their standard uncertainties [rad/s]."""

    @property
    def time(self) -> Array:
        """Times [s]."""

    @property
    def value(self) -> Array:
        """Speeds [rad/s]."""

    @property
    def sigma(self) -> Array:
        """Standard uncertainties [rad/s]."""


def headline(verdict: str, text: str) -> str:
    """Return a verdict with its symbol, and a text below it (HTML)."""
    sign, words = _VERDICTS.get(verdict, ("", verdict))
    return f"<p><b>{sign} {escape(words)}</b><br>{escape(nonbreaking(text))}</p>"


def table(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of texts (HTML)."""
    return markup_table(caption, head, [[escape(nonbreaking(c)) for c in row] for row in rows])


def markup_table(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table whose cells are HTML."""
    top = "".join(f'<th scope="col" style="text-align:left">{escape(h)}</th>' for h in head)
    body = "".join(
        "<tr>" + "".join(f'<td style="text-align:left">{c}</td>' for c in row) + "</tr>" for row in rows
    )
    title = f'<caption style="text-align:left">{escape(caption)}</caption>'
    return f"<table>{title}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def block(*parts: str) -> str:
    """Return HTML parts enclosed in one block."""
    return f"<div>{''.join(parts)}</div>"


def figure(width: float, height: float) -> Figure:
    """Return an empty figure of this size [inch]."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def figure_of(ax: Axes) -> Figure:
    """Return the figure to which axes belong."""
    found = ax.get_figure(root=True)
    if found is None:
        raise EstimationError(
            "these axes do not belong to a figure", "create them with matplotlib.pyplot.subplots()"
        )
    return found


def draw_speed(
    ax: Axes, measured: Sequence[tuple[Array, Array]], modelled: Sequence[tuple[Array, Array, Array]]
) -> None:
    """Draw modelled speeds (time, speed, sigma) [s, rad/s] with 2 sigma bands, and measured speeds (time, speed)."""
    for k, (time, omega) in enumerate(measured):
        ax.plot(time, omega, color=GREY, linewidth=3, label=None if k else "measured")
    for k, (time, omega, sigma) in enumerate(modelled):
        ax.fill_between(time, omega - 2 * sigma, omega + 2 * sigma, color=BLUE, alpha=0.3, linewidth=0)
        ax.plot(time, omega, color=BLUE, linewidth=1.2, label=None if k else "model ± 2 σ")


def draw_speed_residual(ax: Axes, runs: Sequence[SpeedCurve]) -> None:
    """Draw residual speeds over the band of 2 sigma that noise alone would give."""
    for k, r in enumerate(runs):
        band = None if k else "± 2 σ of noise"
        ax.fill_between(r.time, -2 * r.sigma, 2 * r.sigma, color=GREY, alpha=0.6, linewidth=0, label=band)
        ax.plot(r.time, r.value, color=VERMILLION, marker="o", markersize=2.5, linewidth=0.9)
    ax.axhline(0, color="#777777", linewidth=0.8)


def draw_torque(
    ax: Axes,
    curves: Sequence[tuple[str, Array, Array, Array]],
    intervals: Sequence[tuple[float, float]] = (),
    unit: str = TORQUE,
) -> None:
    """Draw unmodelled torques with bands of 2 sigma, and shade intervals of significant lack of fit.

    `curves` are (body, time [s], torque, sigma [unit]). Where sigma exceeds three times its minimum, nothing is drawn.
    `intervals` are (start, stop) [s].
    """
    for (body, time, torque, sigma), colour in zip(curves, cycle(_BODIES), strict=False):
        known = np.where(sigma <= 3 * sigma.min(), torque, np.nan)
        edges: dict[str, Any] = {"color": colour, "alpha": 0.25, "linewidth": 0}
        ax.fill_between(time, known - 2 * sigma, known + 2 * sigma, **edges)
        ax.plot(time, known, color=colour, label=f"on the {body} ± 2 σ")
    for start, stop in intervals:
        ax.axvspan(start, stop, color=YELLOW, alpha=0.25, linewidth=0, zorder=0)
    ax.axhline(0, color="#777777", linewidth=0.8)
    ax.set_xlabel("time [s]")
    ax.set_ylabel(f"torque [{unit}]")


def draw_candidates(
    ax: Axes,
    names: Sequence[str],
    scores: Sequence[float],
    *,
    significant: Sequence[bool],
    physical: Sequence[bool],
) -> None:
    """Draw one bar for each candidate effect; its length is the root of the score.

    Effects are given best first. Grey bars are not significant; hatched bars are effects of the measurement.
    """
    colours = [BLUE if s else GREY for s in significant]
    hatches = ["" if p else "////" for p in physical]
    places = np.arange(len(names))
    ax.barh(places, np.sqrt(scores), color=colours, hatch=hatches, edgecolor="white")
    ax.set_yticks(places, [printable(n) for n in names])
    ax.invert_yaxis()
    ax.set_xlabel(
        r"$\sqrt{\mathrm{improvement\ of\ }\chi^2}$ [σ]; hatched: measurement effect, grey: not significant"
    )


def draw_answers(ax: Axes, groups: Sequence[tuple[str, Mapping[str, int]]], words: Mapping[str, str]) -> None:
    """Draw one bar for each simulated effect, divided into the shares of the answers.

    `groups` are the names of the bars with the counts of each answer. `words` are the texts of the answers.
    """
    colours = dict(zip(words, _ANSWERS * (1 + len(words) // len(_ANSWERS)), strict=False))
    labelled: set[str] = set()
    for row, (_, counts) in enumerate(groups):
        total, left = max(sum(counts.values()), 1), 0.0
        for answer, count in counts.items():
            share = 100 * count / total
            label = None if answer in labelled else printable(words[answer])
            ax.barh(row, share, left=left, color=colours[answer], edgecolor="white", label=label)
            labelled.add(answer)
            left += share
    ax.set_yticks(range(len(groups)), [printable(name) for name, _ in groups])
    ax.invert_yaxis()
    ax.set_xlim(0, 100)
    ax.set_xlabel("answers to the simulated recordings [%]")
    ax.legend(fontsize="small", frameon=False, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)


def draw_history(
    ax: Axes, changes: Sequence[str], values: Sequence[float], label: str, limit: float | None = None
) -> None:
    """Draw one bar for each fit of a history, the first on top.

    `changes` and `values` are the change and the error of each fit. `label` is the name of the error with its unit, and
    `limit` is the error of noise alone.
    """
    ax.barh(range(len(values)), values, color=[VERMILLION, *[BLUE] * (len(values) - 1)])
    for i, v in enumerate(values):
        ax.annotate(f"{v:.3g}", (v, i), xytext=(3, 0), textcoords="offset points", va="center")
    ax.set_xlim(0, 1.25 * max(*values, limit or 0.0))
    ax.set_ylim(len(values) - 0.5, -0.5)
    ax.set_xlabel(label)
    ax.set_yticks(range(len(values)), [printable(c) for c in changes])
    if limit is not None:
        ax.axvline(limit, color="black", linestyle="--", linewidth=1)


def printable(text: str) -> str:
    """Return a name without mathematics and without letters that the font lacks."""
    known = "\N{MINUS SIGN}"
    return "".join(c if c.isprintable() and (ord(c) < 0x2000 or c in known) else "?" for c in text).replace(
        "$", r"\$"
    )
