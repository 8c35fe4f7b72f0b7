"""Model against measurement, and residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import scaled, short
from gyrotrack.plotting._study_data import CaseView
from gyrotrack.plotting._style import (
    AFTER,
    BEFORE,
    WIDTH,
    Picture,
    canvas,
    failing,
    legend,
    look,
    panel,
    picture,
    thin,
    zero,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from fitting.inference._speed_residuals import SpeedResidual
    from gyrotrack.plotting._study_data import Curve


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


def misfit_picture(view: CaseView, name: str) -> Picture:
    """Draw measured minus modelled speed of the casing, for the base and for the final model."""
    after = view.models[-1].casing_misfit
    both = len(view.models) > 1
    with look():
        figure = canvas(WIDTH, 5.6 if both else 3.3)
        axes = figure.subplots(2 if both else 1, 1, sharex=True, squeeze=False)[:, 0]
        both_panel(axes[0], view)
        panel(
            axes[0], "a" if both else "", "before and after, same scale" if both else "measured minus model"
        )
        legend(axes[0])
        if both:
            alone_panel(axes[1], after, AFTER, "final model")
            panel(axes[1], "b", "after alone, magnified")
            legend(axes[1])
        axes[-1].set_xlabel("time [s]")
        return picture(name, figure, _caption(view), misfit_finding(view))


def both_panel(ax: Axes, view: CaseView) -> None:
    """Draw the misfit of all models in the same axes, with the stretches where the base fails."""
    largest = max(float(np.abs(m.casing_misfit.value).max()) for m in view.models)
    factor, prefix = scaled(largest)
    failing(ax, view, "casing")
    last = view.models[-1].casing_misfit
    _band(ax, last, factor, "±2 σ of noise")
    for seen, colour, marker, label in zip(
        view.models, (BEFORE, AFTER), ("s", "o"), ("base model", "final model"), strict=False
    ):
        m = seen.casing_misfit
        ax.plot(
            m.time, factor * m.value, color=colour, marker=marker, markersize=2.8, linewidth=1.3, label=label
        )
    zero(ax)
    ax.set_ylabel(rf"$\omega_c$ measured $-$ model [{prefix}rad/s]", fontsize=9.5)
    ax.margins(x=0.01)


def alone_panel(ax: Axes, misfit: SpeedResidual, colour: str, label: str) -> None:
    """Draw one misfit with the band of the noise."""
    factor, prefix = scaled(float(np.abs(misfit.value).max()))
    _band(ax, misfit, factor, "±2 σ of noise")
    ax.plot(
        misfit.time,
        factor * misfit.value,
        color=colour,
        marker="o",
        markersize=2.8,
        linewidth=0.8,
        label=label,
    )
    zero(ax)
    ax.set_ylabel(rf"$\omega_c$ measured $-$ model [{prefix}rad/s]", fontsize=9.5)
    ax.margins(x=0.01, y=0.12)


def _band(ax: Axes, misfit: SpeedResidual, factor: float, label: str | None = None) -> None:
    edges = 2 * factor * misfit.sigma
    ax.fill_between(misfit.time, -edges, edges, color="#bbbbbb", alpha=0.55, linewidth=0, label=label)


def in_noise(misfit: SpeedResidual) -> float:
    """Return the rms of a misfit in units of what noise alone would leave."""
    good = misfit.sigma > 0
    return (
        float(np.sqrt(np.mean((misfit.value[good] / misfit.sigma[good]) ** 2)))
        if good.any()
        else float("nan")
    )


def _caption(view: CaseView) -> str:
    width = float(np.median(view.models[0].casing_misfit.width))
    shaded = " Shaded: where the base model fails." if any(f.body == "casing" for f in view.failures) else ""
    return (
        f"Measured minus modelled angular velocity of the {view.body}: mean slopes of the angle's misfit over "
        f"{short(width, 2)} s, not smoothed.{shaded} "
        "Grey band: two standard deviations of what noise alone (of the angles and of random torques) "
        "makes after a fit."
    )


def misfit_finding(view: CaseView) -> str:
    """Return how far the models miss the casing's speed."""
    before = view.models[0].casing_misfit
    after = view.models[-1].casing_misfit if len(view.models) > 1 else None
    worst = int(np.argmax(np.abs(before.value)))
    text = (
        f"The base model misses the {view.body}'s speed by up to {short(abs(float(before.value[worst])))} rad/s, "
        f"at {short(float(before.time[worst]))} s; rms {short(in_noise(before))} times the noise."
    )
    if after is not None:
        text += (
            f" The final model misses it by at most {short(float(np.abs(after.value).max()))} rad/s; rms "
            f"{short(in_noise(after))} times the noise."
        )
    return text
