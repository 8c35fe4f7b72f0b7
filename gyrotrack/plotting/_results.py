"""Figures of the commands `laws`, `plan` and `compare`.

`laws`: unmodelled torque and laws against their variable, explained shares, ranking. `plan`: detection limits, upper
limits, power curves, next run. `compare`: each parameter in each run, as a difference from the mean; for many runs,
against the time of the run.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting._numbers import probability, scaled, unit_text
from fitting.effects._expression import Tape, symbols
from gyrotrack.io._atomic import new_file
from gyrotrack.plotting._charts import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PALE,
    PURPLE,
    SKY,
    VERMILLION,
    WIDTH,
    as_rows,
    beside,
    canvas,
    in_lines,
    legend,
    picture_file,
    plain,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fitting.comparison._comparison import Comparison
    from fitting.comparison._population import Population
    from fitting.discovery._dependence import Dependence
    from fitting.discovery._next_run import NextRun
    from fitting.discovery._power import EffectLimits
    from fitting.law_search._laws import Law, Laws
    from fitting.planning._plan import Plan

_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE)
_DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (2, 1.5)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1)))
_MAX_ROWS = 8
_AXES = {
    "omega_c": "angular rate of the casing [rad/s]",
    "omega_r": "angular rate of the rotor [rad/s]",
    "delta": "angular rate of the bearing [rad/s]",
    "t": "time [s]",
    "psi_c": "angle of the casing [rad]",
    "psi_r": "angle of the rotor [rad]",
}
_NAMES = {
    "omega_c": "ω casing",
    "omega_r": "ω rotor",
    "delta": "ω bearing",
    "t": "time",
    "psi_c": "ψ casing",
    "psi_r": "ψ rotor",
}
_ON = {"casing": "on the casing", "rotor": "on the rotor", "bearing": "in the bearing"}
# smallest share whose number is written within its bar [%]
_WIDE = 60


def write_picture(found: Laws | Plan | Comparison, path: Path, *, force: bool = False) -> None:
    """Write the figure of a result as PNG, SVG or PDF, by the suffix of `path`."""
    figures: dict[str, Callable[[Any], Figure]] = {
        "Laws": _laws_figure,
        "Plan": _plan_figure,
        "Comparison": _comparison_figure,
    }
    with style(), new_file(path, force=force) as stream:
        figure = figures[type(found).__name__](found)
        stream.write(picture_file(figure, path.suffix.lower().lstrip(".")))


def _shown(found: Laws) -> Dependence | None:
    """Return the curve to draw: against the variable of the best law, or without a law the most significant curve."""
    curves = [d for d in found.depends_on if len(d.value)]
    if found.laws:
        effect = found.laws[0].effects[0]
        own = [d for d in curves if d.body == effect.joint and d.variable in effect.law]
        curves = own or [d for d in curves if d.body == effect.joint] or curves
    return curves[0] if curves else None


def _laws_figure(found: Laws) -> Figure:
    figure = canvas(WIDTH, 7.4)
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.25, 1.0))
    above, below = parts
    curve = _shown(found)
    if curve is not None:
        _draw_curve(above.subplots(), found, curve)
    axes: Any = below.subplots(1, 2 if found.laws else 1, squeeze=False)[0]
    _draw_shares(axes[0], found)
    if found.laws:
        _draw_ranking(axes[1], found)
    return figure


def _draw_curve(ax: Axes, found: Laws, d: Dependence) -> None:
    drawn = [(x, _law_curve(x, d)) for x in found.answer[: len(_COLOURS)]]
    size = max(float(np.abs(d.torque).max()), 1e-300)
    factor, prefix = scaled(size)
    band = np.minimum(2 * d.sigma, 3 * size)
    limits = factor * (d.torque - band), factor * (d.torque + band)
    ax.fill_between(d.value, *limits, color=PALE, linewidth=0, label="unmodelled torque ± 2 u")
    ax.plot(d.value, factor * d.torque, color=GREY, linewidth=4.0, alpha=0.6)
    for (law, values), colour, dash in zip(drawn, _COLOURS, _DASHES, strict=False):
        if values is not None:
            label = plain(law.formula, 46)
            ax.plot(d.value, factor * values, color=colour, linestyle=dash, linewidth=1.5, label=label)
    ax.axhline(0.0, color="#444444", linewidth=0.7)
    ax.set_xlabel(_AXES[d.variable])
    ax.set_ylabel(f"torque {_ON[d.body]} [{prefix}{unit_text(found.fit.torque_unit)}]")
    ax.set_xlim(float(d.value[0]), float(d.value[-1]))
    legend(ax, ncols=2)


def _law_curve(law: Law, d: Dependence) -> Any:
    """Return the values of a law that are comparable with the curve; None if the law depends on other variables."""
    total = np.zeros(len(d.value))
    for e in law.effects:
        own = {p.symbol for p in e.parameters}
        if e.joint != d.body or e.state is not None or symbols(e.expression) - own != {d.variable}:
            return None
        keys = {
            k.partition("@")[0]: v.value for k, v in reversed(law.estimates.items())
        }  # estimates of the first case
        numbers = {symbol: keys[f"{e.name}.{symbol}"] for symbol in own}
        total = total + np.asarray(Tape([e.expression])({d.variable: d.value, **numbers})[0])
    return d.comparable(total)


def _draw_shares(ax: Axes, found: Laws) -> None:
    shown = found.depends_on[:_MAX_ROWS]
    labels = [f"{' × '.join(_NAMES[v] for v in d.variable.split('*'))}, {_ON[d.body]}" for d in shown]
    colours = [SKY if d.p_value < 0.05 else PALE for d in shown]
    ax.barh(np.arange(len(shown)), [100 * d.explained for d in shown], color=colours, height=0.66)
    for i, d in enumerate(shown):
        text = f"{100 * d.explained:.1f} %" + ("" if d.p_value < 0.05 else f", p = {d.p_value:.2g}")
        offset, side = (-4, "right") if 100 * d.explained > _WIDE else (4, "left")
        beside(ax, text, (100 * d.explained, i), offset, ha=side, fontsize=9)
    as_rows(ax, labels, fontsize=9)
    ax.set_xlim(0, 100)
    ax.set_xlabel("explained lack of fit [%]")


def _draw_ranking(ax: Axes, found: Laws) -> None:
    shown = found.laws[:_MAX_ROWS]
    answer = found.answer
    worse = np.array([x.penalised - found.laws[0].penalised for x in shown])
    colours = []
    for x in shown:
        place = next((i for i, a in enumerate(answer) if a is x), None)
        colours.append(PALE if place is None else _COLOURS[place % len(_COLOURS)])
    width = np.log10(1 + worse)
    ax.barh(np.arange(len(shown)), np.maximum(width, 0.03), color=colours, height=0.66)
    for i, x in enumerate(shown):
        text = ("best: " if i == 0 else f"+{worse[i]:.0f}  ") + plain(x.formula, 36)
        beside(ax, text, (max(width[i], 0.03), i), fontsize=8.5)
    ax.set_yticks([])
    ax.set_xlim(0, 2.6 * max(float(width.max()), 0.5) + 0.8)
    powers = range(int(np.ceil(float(width.max()))) + 1)
    ax.set_xticks(
        [float(np.log10(1 + 10.0**p)) if p else 0.0 for p in powers],
        [f"$10^{p}$" if p else "0" for p in powers],
    )
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    ax.set_xlabel("BIC + description length above the best")


_CURVES = (*_COLOURS, SKY)


def _plan_figure(found: Plan) -> Figure:
    """Return a figure of limits of the physical effects, power against torque, and motion of the next run."""
    shown = [e for e in found.effects if e.effect.mechanical and np.isfinite(e.detection_torque)]
    figure = canvas(1.25 * WIDTH, 3.6 + 0.27 * max(len(shown), 10))
    parts: Any = figure.subfigures(2, 1, height_ratios=(0.27 * max(len(shown), 10), 3.4))
    top, bottom = parts
    left, right = top.subplots(1, 2, width_ratios=(1.25, 1.0))
    unit = unit_text(found.fit.torque_unit)
    names = [found.fit.name(e.effect).words for e in shown]
    _limits(left, shown, names, found.size, unit)
    _power(right, shown, names, found.size, unit)
    if found.next_run is not None:
        _run(bottom.subplots(), found.next_run)
    return figure


def _limits(ax: Axes, shown: list[EffectLimits], names: list[str], size: float, unit: str) -> None:
    rows = np.arange(len(shown))
    low = np.array([e.detection_range[0] for e in shown])
    high = np.array([e.detection_range[1] for e in shown])
    ax.hlines(rows, low, np.where(np.isfinite(high), high, low), color=SKY, linewidth=4, alpha=0.5)
    ax.plot([e.detection_torque for e in shown], rows, "o", color=BLUE, label="detection limit, power 90 %")
    upper = np.array([e.upper_torque for e in shown])
    ax.plot(upper, rows, "<", color=VERMILLION, label="upper limit, 95 %")
    for i in rows[np.isnan(upper)]:
        beside(ax, "found", (shown[i].detection_torque, i), 8, color=GREEN)
    ax.axvline(size, color=GREY, linestyle="--", linewidth=1, label=f"effect of {size:.1e} {unit}")
    ax.set_xscale("log")
    as_rows(ax, [in_lines(n) for n in names])
    ax.set_xlabel(f"rms torque along the motion [{unit}]")
    narrow: dict[str, Any] = {"ncols": 3, "fontsize": 8.5, "handletextpad": 0.3, "columnspacing": 0.9}
    ax.legend(loc="lower left", bbox_to_anchor=(-0.3, 1.0), **narrow)


def _power(ax: Axes, shown: list[EffectLimits], names: list[str], size: float, unit: str) -> None:
    # evenly distributed over the range of limits
    places = sorted({round(x) for x in np.linspace(0, len(shown) - 1, len(_CURVES))}) if shown else []
    chosen = [(shown[i], names[i]) for i in places]
    for (e, name), colour in zip(chosen, _CURVES, strict=False):
        torque = e.curve[1:, 0] * e.stderr * e.torque
        ax.plot(torque, 100 * e.curve[1:, 1], color=colour, label=plain(name, 44))
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
            label = "film of the rotor" if i == 0 else None
            ax.axvspan(w, w + run.window_length, color=ORANGE, alpha=0.35, label=label)
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
    ax.set_title(f"Next run, predicted motion{ring}")


_MAX_PARAMETERS = 14


def _population_figure(found: Population) -> Figure:
    """Return a figure with one chart per parameter: its value in each run, against the time of the run.

    The bars show 2 u. The line is the mean of the runs, or a significant drift or step; the band is the spread between
    the runs.
    """
    shown = sorted(found.parameters, key=lambda p: p.p_adjusted)[:_MAX_PARAMETERS]
    names = [p.name for p in found.parameters]
    figure = canvas(WIDTH, 0.6 + 2.3 * max(len(shown), 1))
    axes: Any = figure.subplots(max(len(shown), 1), 1, squeeze=False, sharex=True)[:, 0]
    out = np.isin(found.runs, [name for name, _ in found.outlying])
    t = found.times
    for ax, p in zip(axes, shown, strict=False):
        j = names.index(p.name)
        values, u = found.values[:, j], found.stderr[:, j]
        factor, prefix = scaled(float(np.nanmax(np.abs(values))))
        model = np.full(len(t), p.mean)
        c = p.change
        if c is not None and c.kind == "drift":
            model = p.mean + c.slope * (t - t[~out].mean())
        elif c is not None:
            after = (t > c.time).astype(float)
            model = p.mean + c.size * (after - after[~out].mean())
        ax.fill_between(
            t, factor * (model - p.spread), factor * (model + p.spread), color=PALE, linewidth=0, step="mid",
            label="spread between runs",
        )  # fmt: skip
        drawn: dict[str, Any] = {} if c is None or c.kind == "drift" else {"drawstyle": "steps-mid"}
        ax.plot(t, factor * model, color=BLUE, linewidth=1.4, label="mean" if c is None else c.kind, **drawn)
        bars: dict[str, Any] = {"fmt": "o", "markersize": 3, "elinewidth": 0.7}
        ax.errorbar(
            t[~out], factor * values[~out], 2 * factor * u[~out], color="#555555", label="runs ± 2 u", **bars
        )
        if out.any():
            ax.errorbar(
                t[out], factor * values[out], 2 * factor * u[out], color=VERMILLION, label="outlying", **bars
            )
        ax.set_ylabel(f"[{prefix}{unit_text(p.unit) or 1}]")
        ax.set_title(plain(p.name), loc="left")
        ax.set_title(
            f"adjusted p {probability(p.p_adjusted)}", loc="right", fontweight="normal", fontsize="small"
        )
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize="small")
    axes[-1].set_xlabel("run" if found.time_unit == "run" else f"time of the run [{found.time_unit}]")
    return figure


def _comparison_figure(found: Comparison) -> Figure:
    """Return a figure with one row per parameter: the runs with bars of 2 sigma, and the spread between the runs."""
    if found.population is not None and found.population.parameters:
        return _population_figure(found.population)
    shown = found.parameters[:_MAX_PARAMETERS]
    names = list(dict.fromkeys(r.run for p in shown for r in p.repeats))
    figure = canvas(WIDTH, 1.3 + 0.55 * max(len(shown), 1))
    ax = figure.subplots()
    for row, p in enumerate(shown):
        scale = abs(p.mean) or 1.0
        band = np.array([-1, 1]) * p.spread / scale * 100
        ax.fill_betweenx([row - 0.38, row + 0.38], *band, color="#d9d9d9", linewidth=0, zorder=0)
        labelled = {q.run for above in shown[:row] for q in above.repeats}
        for i, r in enumerate(p.repeats):
            place = names.index(r.run)
            ax.errorbar(
                (r.value - p.mean) / scale * 100,
                row + 0.5 * ((i + 1) / (len(p.repeats) + 1) - 0.5),
                xerr=200 * r.stderr / scale,
                fmt="o",
                markersize=5,
                color=_COLOURS[place % len(_COLOURS)],
                label=None if r.run in labelled else plain(r.run, 24),
            )
    labels = [f"{plain(p.name)}\np {probability(p.p_value)}" for p in shown]
    ax.set_yticks(range(len(shown)), labels)
    ax.set_ylim(len(shown) - 0.5, -0.5)
    ax.axvline(0, color="#444444", linewidth=0.8)
    ax.set_xlabel("difference from the mean of the runs [%]; bars ±2σ, grey: spread between the runs")
    if shown:
        legend(ax)
    return figure
