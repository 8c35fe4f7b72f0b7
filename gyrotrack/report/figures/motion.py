"""Model against measurement: the casing through the run, the rotor in its windows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitting.typesetting import scaled, short
from gyrotrack.report.case_view import CaseView
from gyrotrack.report.figures.failing import failing
from gyrotrack.report.figures.style import AFTER, BEFORE, WIDTH, Picture, canvas, legend, look, picture, zero
from gyrotrack.report.thinning import thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from gyrotrack.report.case_view import Curve

MEASURED = "#c9c9c9"
_MOST_WINDOWS = 8
_ACROSS = 4
_MOST_POINTS = 1200


def casing_picture(view: CaseView, name: str) -> Picture:
    """Draw the casing's speed through the run."""
    with look():
        figure = canvas(WIDTH, 3.7)
        ax = figure.subplots()
        failing(ax, view, "casing")
        casing_panel(ax, view)
        for i, window in enumerate(view.rotor):
            ax.axvspan(
                window.time[0],
                window.time[-1],
                ymax=0.02,
                color="black",
                label="rotor filmed" if i == 0 else None,
            )
        legend(ax)
        largest = max(float(m.casing.sigma.max()) for m in view.models)
        caption = (
            f"Angular velocity of the {view.body}, smoothed as in the paper (median over 51 points); of the "
            "measured points the smallest and "
            f"largest in each bin are drawn. The models' own uncertainty is at most {short(largest, 2)} "
            "rad/s. "
            "At this scale all models look right; the misfit is seen above."
        )
        return picture(name, figure, caption, motion_finding(view))


def casing_panel(ax: Axes, view: CaseView) -> None:
    """Draw the measured speed of the casing and that of the models."""
    drawn = thin(view.casing.time, view.casing.value, _MOST_POINTS)
    ax.plot(*drawn, color=MEASURED, linewidth=5.0, label="measured")
    _models(ax, [m.casing for m in view.models])
    ax.set_xlabel("time [s]")
    ax.set_ylabel(r"$\omega_c$ [rad/s]")
    ax.margins(x=0.01)


def _models(ax: Axes, curves: list[Curve]) -> None:
    looks = [(BEFORE, "-", "base model"), (AFTER, (0, (5, 3)), "final model")]
    for curve, (colour, dashes, label) in zip(curves, looks, strict=False):
        ax.fill_between(
            curve.time,
            curve.value - 2 * curve.sigma,
            curve.value + 2 * curve.sigma,
            color=colour,
            alpha=0.25,
            linewidth=0,
        )
        ax.plot(curve.time, curve.value, color=colour, linestyle=dashes, linewidth=1.3, label=label)


def motion_finding(view: CaseView) -> str:
    """Return what the casing does."""
    peak = int(np.argmax(np.abs(view.casing.value)))
    return (
        f"The {view.body}'s speed is {short(float(view.casing.value[0]))} rad/s at first, "
        f"{short(float(view.casing.value[peak]))} rad/s "
        f"at its peak at {short(float(view.casing.time[peak]))} s, and "
        f"{short(float(view.casing.value[-1]))} rad/s at the end; "
        "the models follow it to within the width of the line or nearly so."
    )


def rotor_picture(view: CaseView, name: str) -> Picture:
    """Draw the rotor's speed in each window, and below it what the models miss."""
    count = len(view.rotor)
    shown = np.unique(np.linspace(0, count - 1, min(count, _MOST_WINDOWS)).round().astype(int))
    across = min(_ACROSS, len(shown))
    down = -(-len(shown) // across)
    largest = max(float(np.abs(m.rotor_misfit[i].value).max()) for m in view.models for i in shown)
    factor, prefix = scaled(largest)
    limits = _limits(view, shown, factor)
    with look():
        figure = canvas(WIDTH, 4.3 * down)
        axes = figure.subplots(2 * down, across, squeeze=False, height_ratios=[1.15, 1] * down, sharey=False)
        for ax in axes.flat:
            ax.set_visible(False)
        for place, i in enumerate(shown):
            row, column = divmod(place, across)
            _window(axes[2 * row, column], axes[2 * row + 1, column], view, int(i), factor)
            axes[2 * row + 1, column].set_ylim(*limits)
            if column == 0:
                axes[2 * row, 0].set_ylabel(r"$\omega_r$ [rad/s]")
                axes[2 * row + 1, 0].set_ylabel(f"misfit [{prefix}rad/s]")
        handles, names = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper right", ncols=3)
        more = f" {len(shown)} of {count} windows are shown." if len(shown) < count else ""
        return picture(
            name,
            figure,
            "Angular velocity of the rotor in its windows, and measured minus modelled below, in fifths "
            "of a window. Band: two standard deviations of "
            f"what noise makes.{more}",
            rotor_finding(view),
        )


def rotor_finding(view: CaseView) -> str:
    """Return how far the models miss the rotor's speed."""
    ratio = [
        float(np.sqrt(np.mean(np.concatenate([(m.value / m.sigma) ** 2 for m in s.rotor_misfit]))))
        for s in view.models
    ]
    text = (
        f"In {len(view.rotor)} windows the rotor's speed differs from the base model by {short(ratio[0])} "
        "times the noise"
    )
    return text + (
        f", from the final model by {short(ratio[-1])} times (rms)." if len(ratio) > 1 else " (rms)."
    )


def _limits(view: CaseView, shown: NDArray[np.intp], factor: float) -> tuple[float, float]:
    """Return limits that hold the misfits of all windows shown and the band."""
    values = [factor * m.rotor_misfit[i].value for m in view.models for i in shown]
    values += [2.2 * s * factor * view.models[-1].rotor_misfit[i].sigma for i in shown for s in (-1, 1)]
    low, high = float(np.min(np.concatenate(values))), float(np.max(np.concatenate(values)))
    room = 0.06 * (high - low)
    return low - room, high + room


def _window(top: Axes, bottom: Axes, view: CaseView, index: int, factor: float) -> None:
    for ax in (top, bottom):
        ax.set_visible(True)
    window = view.rotor[index]
    drawn = thin(window.time, window.value, _MOST_POINTS // _ACROSS)
    top.plot(*drawn, color=MEASURED, linewidth=2.5, label="measured")
    _models(top, [m.rotor[index] for m in view.models])
    top.set_title(f"window {index + 1}", fontweight="normal")
    top.set_xticklabels([])
    last = view.models[-1].rotor_misfit[index]
    bottom.fill_between(
        last.time, -2 * factor * last.sigma, 2 * factor * last.sigma, color="#bbbbbb", alpha=0.5, linewidth=0
    )
    for seen, colour, marker in zip(view.models, (BEFORE, AFTER), ("s", "o"), strict=False):
        m = seen.rotor_misfit[index]
        bottom.plot(m.time, factor * m.value, color=colour, marker=marker, markersize=4, linewidth=1)
    zero(bottom)
    for ax in (top, bottom):
        failing(ax, view, "rotor", (window.time[0], window.time[-1]))
    bottom.set_xlabel("time [s]")
    bottom.set_xlim(top.get_xlim())
