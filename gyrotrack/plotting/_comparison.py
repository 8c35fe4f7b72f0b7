"""The picture of a comparison: each parameter in each run, as a difference from the mean of the runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting._numbers import probability
from gyrotrack.io._atomic import new_file
from gyrotrack.plotting._style import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    VERMILLION,
    WIDTH,
    canvas,
    legend,
    plain,
    style,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fitting.study._comparison import Comparison

_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE)
_MOST = 14


def write_comparison_picture(found: Comparison, path: Path, *, force: bool = False) -> None:
    """Write the picture as a file: PNG, SVG or PDF, by its suffix.

    Parameters
    ----------
    found : Comparison
        From `fitting.compare`.
    path : Path
        A ``.png``, ``.svg`` or ``.pdf`` file.
    force : bool
        Replace an existing file.
    """
    kind = path.suffix.lower().lstrip(".")
    with style(), new_file(path, force=force) as stream:
        metadata: dict[str, Any] = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[kind]
        comparison_figure(found).savefig(stream, format=kind, dpi=150, metadata=metadata)


def comparison_figure(found: Comparison) -> Figure:
    """Return one row per parameter: the runs with bars of 2 sigma, the mean and the spread between runs behind them."""
    shown = found.parameters[:_MOST]
    names = list(dict.fromkeys(r.run for p in shown for r in p.repeats))
    figure = canvas(WIDTH, 1.3 + 0.55 * max(len(shown), 1))
    ax = figure.subplots()
    for row, p in enumerate(shown):
        scale = abs(p.mean) or 1.0
        band = np.array([-1, 1]) * p.spread / scale * 100
        ax.fill_betweenx([row - 0.38, row + 0.38], *band, color="#d9d9d9", linewidth=0, zorder=0)
        for i, r in enumerate(p.repeats):
            place = names.index(r.run)
            ax.errorbar(
                (r.value - p.mean) / scale * 100,
                row + 0.5 * ((i + 1) / (len(p.repeats) + 1) - 0.5),
                xerr=200 * r.stderr / scale,
                fmt="o",
                markersize=5,
                color=_COLOURS[place % len(_COLOURS)],
                label=plain(r.run, 24) if r.run not in {q.run for q in _before(shown, row)} else None,
            )
    labels = [f"{plain(p.name)}\np {probability(p.p_value)}" for p in shown]
    ax.set_yticks(range(len(shown)), labels)
    ax.set_ylim(len(shown) - 0.5, -0.5)
    ax.axvline(0, color="#444444", linewidth=0.8)
    ax.set_xlabel("difference from the mean of the runs [%]; bars ±2σ, grey: spread between the runs")
    if shown:
        legend(ax)
    return figure


def _before(shown: Any, row: int) -> list[Any]:
    """Return the repeats of the rows above one."""
    return [r for p in shown[:row] for r in p.repeats]
