"""The picture that convinces: what the casing's speed leaves before and after, in the same axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fitting.typesetting import scaled, short
from gyrotrack.report.case_view import CaseView
from gyrotrack.report.figures.failing import failing
from gyrotrack.report.figures.style import (
    AFTER,
    BEFORE,
    WIDTH,
    Picture,
    canvas,
    legend,
    look,
    panel,
    picture,
    zero,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from fitting.diagnosis.misfit import Misfit


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


def alone_panel(ax: Axes, misfit: Misfit, colour: str, label: str) -> None:
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


def _band(ax: Axes, misfit: Misfit, factor: float, label: str | None = None) -> None:
    edges = 2 * factor * misfit.sigma
    ax.fill_between(misfit.time, -edges, edges, color="#bbbbbb", alpha=0.55, linewidth=0, label=label)


def in_noise(misfit: Misfit) -> float:
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
