"""Plan of an experiment: detection limits, upper limits, power curves, the proposed run."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting._numbers import unit_text
from gyrotrack.io._atomic import new_file
from gyrotrack.plotting._style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    WIDTH,
    canvas,
    plain,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fitting.discovery._next_run import NextRun
    from fitting.discovery._plan import Plan
    from fitting.discovery._power import EffectLimits

_DPI = 150
_CURVES = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY)


def write_plan_picture(found: Plan, path: Path, *, force: bool = False) -> Path:
    """Write the picture of a plan.

    Parameters
    ----------
    found : Plan
        From `fitting.plan`.
    path : Path
        A ``.png`` or ``.svg`` file.
    force : bool
        Replace an existing file.
    """
    stream = io.BytesIO()
    with style():
        figure = plan_figure(found)
        kind = path.suffix.lower().removeprefix(".")
        metadata = {"Date": None} if kind == "svg" else None
        figure.savefig(stream, format=kind, dpi=_DPI, metadata=metadata)
    with new_file(path, force=force) as file:
        file.write(stream.getvalue())
    return path


def plan_figure(found: Plan) -> Figure:
    """Return limits of the physical effects, power against torque, and the motion of the proposed run."""
    shown = [e for e in found.effects if e.effect.mechanical and np.isfinite(e.detection_torque)]
    figure = canvas(1.25 * WIDTH, 3.6 + 0.27 * max(len(shown), 10))
    parts: Any = figure.subfigures(2, 1, height_ratios=(0.27 * max(len(shown), 10), 3.4))
    top, bottom = parts
    left, right = top.subplots(1, 2, width_ratios=(1.25, 1.0))
    unit = unit_text(found.fit.torque_unit)
    _limits(left, shown, found.size, unit)
    _power(right, shown, found.size, unit)
    if found.next_run is not None:
        _run(bottom.subplots(), found.next_run)
    return figure


def _limits(ax: Axes, shown: list[EffectLimits], size: float, unit: str) -> None:
    rows = np.arange(len(shown))
    low = np.array([e.detection_range[0] for e in shown])
    high = np.array([e.detection_range[1] for e in shown])
    ax.hlines(rows, low, np.where(np.isfinite(high), high, low), color=SKY, linewidth=4, alpha=0.5)
    ax.plot([e.detection_torque for e in shown], rows, "o", color=BLUE, label="detection limit, power 90 %")
    upper = np.array([e.upper_torque for e in shown])
    ax.plot(upper, rows, "<", color=VERMILLION, label="upper limit, 95 %")
    for i in rows[np.isnan(upper)]:
        ax.annotate(
            "found",
            (shown[i].detection_torque, i),
            xytext=(8, 0),
            textcoords="offset points",
            va="center",
            color=GREEN,
        )
    ax.axvline(size, color=GREY, linestyle="--", linewidth=1, label=f"effect of {size:.1e} {unit}")
    ax.set_xscale("log")
    ax.set_yticks(rows, [plain(e.effect.name) for e in shown])
    ax.grid(visible=False, axis="y")
    ax.invert_yaxis()
    ax.set_xlabel(f"rms torque along the motion [{unit}]")
    ax.legend(
        loc="lower left",
        bbox_to_anchor=(-0.3, 1.0),
        ncols=3,
        fontsize=8.5,
        handletextpad=0.3,
        columnspacing=0.9,
    )


def _power(ax: Axes, shown: list[EffectLimits], size: float, unit: str) -> None:
    # some across the whole range of limits
    chosen = (
        [shown[i] for i in sorted({round(x) for x in np.linspace(0, len(shown) - 1, len(_CURVES))})]
        if shown
        else []
    )
    for e, colour in zip(chosen, _CURVES, strict=False):
        torque = e.curve[1:, 0] * e.stderr * e.torque
        ax.plot(torque, 100 * e.curve[1:, 1], color=colour, label=plain(e.effect.name))
    ax.axhline(90, color=GREY, linewidth=1)
    ax.axvline(size, color=GREY, linestyle="--", linewidth=1)
    ax.set_xscale("log")
    ax.set_ylim(0, 102)
    ax.set_xlabel(f"rms torque of the effect [{unit}]")
    ax.set_ylabel("probability of detection [%]")
    ax.legend(loc="lower right", fontsize=8)


def _run(ax: Axes, found: NextRun) -> None:
    run = found.run
    if run.windows:
        ax.plot(found.times, found.omega_rotor, color=VERMILLION, label="rotor")
        for i, w in enumerate(run.windows):
            ax.axvspan(
                w,
                w + run.window_length,
                color=ORANGE,
                alpha=0.35,
                label="film of the rotor" if i == 0 else None,
            )
        other = ax.twinx()
        other.grid(visible=False)
        other.spines["right"].set_visible(True)
        other.plot(found.times, found.omega_casing, color=BLUE, label="casing")
        other.set_ylabel("casing [rad/s]", color=BLUE)
        ax.set_ylabel("rotor [rad/s]", color=VERMILLION)
    else:
        ax.plot(found.times, found.omega_casing, color=BLUE, label="body")
        ax.set_ylabel("angular rate [rad/s]")
    ax.set_xlabel("time [s]")
    ring = f", casing with {run.ring:.1f} times its moment of inertia" if run.ring != 1 else ""
    ax.set_title(f"Proposed next run, predicted motion{ring}")
