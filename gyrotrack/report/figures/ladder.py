"""The ladder: one bar a rung for each kind of error, so that one sees them fall."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fitting.typesetting import POWERS, scaled, short
from gyrotrack.report.content import Content, Step
from gyrotrack.report.figures.style import (
    AFTER,
    BEFORE,
    GREY,
    SKY,
    WIDTH,
    Picture,
    canvas,
    look,
    picture,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# title, unit, attribute
_KINDS = (
    ("rms error, {body}", "rad/s", "rmse"),
    (r"reduced $\chi^2$", "", "reduced_chi2"),
    ("held-out error", "noise", "held_out"),
    ("torque that remains", "N m", "torque_left"),
    ("energy drift", "", "energy_drift"),
    ("change of BIC", "", "delta_bic"),
)
_WORDS = (
    ("rmse", "rms error of the {body}", " rad/s"),
    ("reduced_chi2", "reduced chi-square", ""),
    ("held_out", "held-out error", " times the noise"),
    ("torque_left", "torque that remains", " N m"),
)
_CLEARLY = 0.05


def ladder_picture(content: Content) -> Picture:
    """Draw the ladder."""
    steps = content.steps
    noise = max(s.torque_pure for s in steps)
    best = {"rmse": content.rmse_floor, "reduced_chi2": 1.0, "held_out": 1.0} | (
        {"torque_left": noise} if noise else {}
    )
    with look():
        figure = canvas(WIDTH, 1.5 + 2 * (0.55 + 0.36 * len(steps)))
        axes = figure.subplots(2, 3, sharey=True)
        for ax, kind in zip(axes.flat, _KINDS, strict=True):
            _bars(ax, steps, kind[0].replace("{body}", content.body), *kind[1:], best.get(kind[2]))
        for ax in axes[:, 0]:
            ax.set_yticks(range(len(steps)), [plain(s.change, 30) for s in steps])
        axes[0, 0].invert_yaxis()
        return picture("ladder", figure, _caption(content), ladder_finding(content))


def _bars(ax: Axes, steps: tuple[Step, ...], title: str, unit: str, name: str, best: float | None) -> None:
    values = np.array([getattr(s, name) for s in steps], dtype=float)
    sizes = np.where(np.isfinite(values), np.abs(values), 0.0)
    factor, prefix = (
        scaled(float(sizes.max())) if name in {"rmse", "torque_left", "energy_drift"} else (1.0, "")
    )
    values, sizes, best = factor * values, factor * sizes, None if best is None else factor * best
    left = _axis(ax, sizes, best, may_be_wide=name != "delta_bic")
    colours = [BEFORE, *[SKY] * (len(steps) - 2), AFTER] if len(steps) > 1 else [BEFORE]
    ax.barh(np.arange(len(steps)), np.maximum(sizes - left, 0.0), left=left, color=colours, height=0.62)
    if best is not None:
        ax.axvline(best, color="black", linewidth=1, linestyle=(0, (4, 2)))
    for i, value in enumerate(values):
        text = "below the noise" if name == "torque_left" and value == 0 else short(float(value))
        if name == "delta_bic" and i == 0:
            text = "start"
        place = max(sizes[i], left)
        ax.annotate(text, (place, i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=9.5)
    measure = f"{prefix}{unit}" if unit else POWERS[prefix]
    ax.set_title(f"{title} [{measure}]" if measure else title, fontweight="normal")
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_color(GREY)


def _axis(
    ax: Axes, sizes: np.ndarray[tuple[int], np.dtype[np.float64]], best: float | None, *, may_be_wide: bool
) -> float:
    """Choose a linear or a logarithmic axis with room for the numbers; return where bars begin."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

    known = [*sizes[sizes > 0].tolist(), *([best] if best is not None else [])]
    top, bottom = (max(known), min(known)) if known else (1.0, 1.0)
    if not may_be_wide or top < 8 * bottom or len(known) < 2:
        ax.set_xlim(0, 1.5 * top)
        ax.xaxis.set_major_locator(
            MaxNLocator(4) if known else NullLocator()
        )  # no bar: a scale would say nothing
        return 0.0
    decades = np.log10(top / bottom)
    left = bottom * 10 ** (-0.12 * decades)
    ax.set_xscale("log")
    ax.set_xlim(left, top * 10 ** (0.55 * decades))
    ax.xaxis.set_major_locator(LogLocator(numticks=4))
    ax.xaxis.set_minor_locator(NullLocator())
    return float(left)


def _caption(content: Content) -> str:
    noise = max(s.torque_pure for s in content.steps)
    floor = (
        f" The data themselves hold a random torque of {short(noise, 2)} N m rms; "
        "a rung takes the torque that remains for noise, so that its chi-square and held-out error may be near 1 "
        "where it fails."
        if noise > 0
        else ""
    )
    return (
        "Every rung is one fit; wide ranges are drawn on a logarithmic scale. The dashed line is as good as "
        f"can be: what the noise alone would leave.{floor} The rms error is that of the speed smoothed as in "
        "the paper, its dashed line what the noise of the angles makes of it; the energy drift has such a floor "
        "too."
    )


def ladder_finding(content: Content) -> str:
    """Return what the ladder says: every kind of error that fell clearly."""
    steps = content.steps
    first, last = steps[0], steps[-1]
    if len(steps) == 1:
        return (
            f"One fit: rms error of the {content.body} {short(first.rmse)} rad/s, reduced chi-square "
            f"{short(first.reduced_chi2)}, held-out error {short(first.held_out)} times the noise."
        )
    said = []
    for name, words, unit in _WORDS:
        before, after = getattr(first, name), getattr(last, name)
        if abs(before - after) > _CLEARLY * abs(before):
            end = "nothing above the noise" if after == 0 else f"{short(after)}{unit}"
            said.append(
                f"the {words.replace('{body}', content.body)} goes from {short(before)}{unit} to {end}"
            )
    return f"With {changes(steps)} " + ("; ".join(said) or "no error changes much") + "."


def changes(steps: tuple[Step, ...]) -> str:
    """Return what was added and dropped after the first rung, in words."""
    said = []
    for step in steps[1:]:
        added, _, dropped = step.change.removeprefix("+").partition(" -")
        said.append(added + (f" (and without {dropped})" if dropped else ""))
    return " and ".join([", ".join(said[:-1]), said[-1]] if len(said) > 1 else said)
