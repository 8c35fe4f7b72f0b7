"""The stretches in which the base model fails, marked alike in every figure against time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gyrotrack.report.figures.style import FAILING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from gyrotrack.report.case_view import CaseView


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
