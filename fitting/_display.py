"""Results in a notebook: HTML tables, and the curves of a fit drawn into matplotlib axes.

Every function that draws takes axes and plain arrays, so that reports and notebooks share them; those that make
a whole figure or table take a result and read its attributes. No class of results is imported here, and
matplotlib only when a figure is made.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import nonbreaking, probability, short, typeset, with_uncertainty

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fitting.discovery._select import Step
    from fitting.discovery._verdict import Diagnosis
    from fitting.inference._result import Fit
    from fitting.inference._speed_residuals import SpeedResidual

Array = NDArray[np.float64]

BLUE, VERMILLION, GREY, YELLOW = "#0072B2", "#D55E00", "#BBBBBB", "#F0E442"
_VERDICTS = {
    "adequate": ("✓", "consistent with noise"),
    "misfit": ("!", "significant lack of fit"),
    "not determined": ("!", "a parameter is not determined"),
    "not converged": ("✗", "not converged: do not use these numbers"),
    "missing_effect": ("✚", "an effect is missing"),
    "unexplained": ("!", "an unexplained torque remains"),
}
_MOST_CANDIDATES = 10
_POINTS = 600


def fit_html(fit: Fit) -> str:
    """Return a fit as HTML: verdict, figures of merit, parameters with uncertainties and units."""
    merits = [
        (c.label, name, f"{body.r2:.6f}", *(short(v) for v in (body.rmse, body.reduced_chi2, body.held_out)))
        for c in fit.cases
        for name, body in (
            [("body", c.casing)] if math.isnan(c.rotor.rmse) else [("casing", c.casing), ("rotor", c.rotor)]
        )
    ]
    numbers = [
        (name, with_uncertainty(e.value, e.stderr, e.unit), "active bound" if e.at_bound else "")
        for name, e in fit.estimates.items()
    ]
    head = f"{', '.join(fit.labels)}; BIC {fit.bic:.1f}, effective samples {fit.n_eff:.0f}"
    columns = ("case", "body", "R²", "rms [rad/s]", "χ²/n", "cross-validation error [noise]")
    return _block(
        _headline(fit.verdict, head),
        _table("figures of merit", columns, merits),
        _table("parameters", ("parameter", "value", ""), numbers),
    )


def diagnosis_html(diagnosis: Diagnosis) -> str:
    """Return a diagnosis as HTML: the sentence, intervals of significant lack of fit, candidate effects."""
    failures = [
        (
            f.label,
            f.called,
            f"{f.t_start:.1f} – {f.t_stop:.1f}",
            short(f.residual_torque_Nm),
            short(f.residual_rad_s, 2),
            f"{f.size_sigma:.0f}",
        )
        for f in diagnosis.failures
    ]
    candidates = [
        (
            c.effect.name + ("" if c.physical else " (artefact)"),
            short(c.score),
            short(c.delta_bic),
            probability(c.p_value),
            ", ".join(c.indistinguishable_from) or "–",
        )
        for c in diagnosis.candidates[:_MOST_CANDIDATES]
        if c.score > 0
    ]
    parts = [_headline(diagnosis.verdict, typeset(diagnosis.sentence))]
    if failures:
        where = ("case", "body", "time [s]", "torque [N m]", "speed [rad/s]", "σ")
        parts.append(_table("significant lack of fit", where, failures))
    if candidates:
        columns = ("effect", "score", "ΔBIC", "p", "indistinguishable from")
        title = "tested, not needed" if diagnosis.verdict == "adequate" else "candidate effects"
        parts.append(_table(title, columns, candidates))
    if diagnosis.next_experiment:
        parts.append(f"<p><b>Next experiment.</b> {escape(diagnosis.next_experiment)}</p>")
    return _block(*parts)


def history_html(steps: Sequence[Step]) -> str:
    """Return a history of fits as HTML: a row per fit, with a bar as long as its rms residual."""
    largest = max((s.fit.rmse_casing for s in steps), default=1.0) or 1.0
    rows = []
    for i, step in enumerate(steps):
        fit = step.fit
        width = max(1, round(100 * fit.rmse_casing / largest))
        gain = fit.bic - steps[i - 1].fit.bic if i else 0.0
        numbers = [short(v) for v in (fit.rmse_casing, fit.reduced_chi2, fit.held_out, gain)]
        bar = f'<div style="background:{BLUE};height:.6em;width:{width}px"></div>'
        rows.append([escape(step.change or "base"), *numbers, short(fit.torque_noise, 2), bar])
    columns = (
        "change",
        "rms [rad/s]",
        "χ²/n",
        "cross-validation error [noise]",
        "ΔBIC",
        "torque left [N m]",
        "",
    )
    return _block(_markup_table("history of fits", columns, rows))


def _headline(verdict: str, text: str) -> str:
    sign, words = _VERDICTS.get(verdict, ("", verdict))
    return f"<p><b>{sign} {escape(words)}</b><br>{escape(nonbreaking(text))}</p>"


def _table(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return _markup_table(caption, head, [[escape(nonbreaking(c)) for c in row] for row in rows])


def _markup_table(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    top = "".join(f'<th scope="col" style="text-align:left">{escape(h)}</th>' for h in head)
    body = "".join(
        "<tr>" + "".join(f'<td style="text-align:left">{c}</td>' for c in row) + "</tr>" for row in rows
    )
    title = f'<caption style="text-align:left">{escape(caption)}</caption>'
    return f"<table>{title}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _block(*parts: str) -> str:
    return f"<div>{''.join(parts)}</div>"


def plot_fit(fit: Fit) -> Figure:
    """Return a figure of each case: speeds measured and modelled, and their residuals, with bands of 2 sigma."""
    cases = len(fit.labels)
    names = ("c",) if all(d.record.single for d in fit.problem.data) else ("c", "r")
    figure = _figure(4.2 * cases + 3.0, 4.0 * len(names))
    axes = figure.subplots(2 * len(names), cases, squeeze=False, height_ratios=[1.3, 1] * len(names))
    for i, label in enumerate(fit.labels):
        residuals = fit.speed_residuals(i)
        for k, name in enumerate(names):
            over, under = axes[2 * k, i], axes[2 * k + 1, i]
            body = 1 - k  # the casing above the rotor
            runs = fit.measured_speeds(i, body)
            points = _POINTS if len(runs) == 1 else _POINTS // 10
            times = [np.linspace(time[0], time[-1], points) for time, _ in runs]
            draw_speed(over, runs, [(t, *fit.modelled_speed(i, body, t)) for t in times])
            draw_speed_residual(under, residuals[1] if k else [residuals[0]])
            over.set_ylabel(rf"$\omega_{name}$ [rad/s]")
            under.set_ylabel(rf"$\omega_{name}$: residual [rad/s]")
            for ax in (over, under):
                ax.set_xlabel("time [s]")
                # above the axes, where it covers nothing
                above = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}
                ax.legend(fontsize="small", frameon=False, ncols=2, **above)
        axes[0, i].set_title(printable(label), loc="left")
    return figure


def plot_diagnosis(diagnosis: Diagnosis) -> Figure:
    """Return a figure of the unmodelled torques with their bands, and of the candidate effects."""
    labels = list(dict.fromkeys(t.label for t in diagnosis.torques))
    shown = [c for c in diagnosis.candidates if c.score > 0][:_MOST_CANDIDATES]
    figure = _figure(9.0, 2.6 * len(labels) + 0.35 * len(shown) + 1.2)
    heights = [2.6] * len(labels) + ([0.35 * len(shown) + 0.7] if shown else [])
    axes = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    bodies = {c.record.label: c.record.body for c in diagnosis.fit.problem.data}
    for ax, label in zip(axes, labels, strict=False):
        draw_torque(
            ax,
            [
                (bodies[label] if t.body == "casing" else t.body, t.time, t.torque, t.sigma)
                for t in diagnosis.torques
                if t.label == label
            ],
            [(f.t_start, f.t_stop) for f in diagnosis.failures if f.label == label],
        )
        ax.set_title(printable(label) + ": unmodelled torque; yellow: significant lack of fit")
        ax.legend(fontsize="small", frameon=False)
    if shown:
        draw_candidates(
            axes[-1],
            [c.effect.name for c in shown],
            [c.score for c in shown],
            significant=[c.significant for c in shown],
            physical=[c.physical for c in shown],
        )
    return figure


def plot_history(steps: Sequence[Step]) -> Figure:
    """Return a figure of the rms residual and the cross-validation error, one bar per fit."""
    figure = _figure(8.0, 1.6 + 0.4 * len(steps))
    left, right = figure.subplots(1, 2, sharey=True)
    changes = [s.change or "base" for s in steps]
    body = steps[0].fit.problem.data[0].record.body
    draw_history(left, changes, [s.fit.rmse_casing for s in steps], f"rms residual of the {body} [rad/s]")
    draw_history(right, changes, [s.fit.held_out for s in steps], "cross-validation error [noise]", limit=1.0)
    return figure


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def draw_speed(
    ax: Axes, measured: Sequence[tuple[Array, Array]], modelled: Sequence[tuple[Array, Array, Array]]
) -> None:
    """Draw modelled speeds with bands of 2 sigma over measured ones.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        Where to draw.
    measured : sequence of (time, speed)
        Runs [s], [rad/s].
    modelled : sequence of (time, speed, sigma)
        The model in each run [s], [rad/s].
    """
    for k, (time, omega) in enumerate(measured):
        ax.plot(time, omega, color=GREY, linewidth=3, label=None if k else "measured")
    for k, (time, omega, sigma) in enumerate(modelled):
        ax.fill_between(time, omega - 2 * sigma, omega + 2 * sigma, color=BLUE, alpha=0.3, linewidth=0)
        ax.plot(time, omega, color=BLUE, linewidth=1.2, label=None if k else "model ± 2 σ")


def draw_speed_residual(ax: Axes, runs: Sequence[SpeedResidual]) -> None:
    """Draw residual speeds over the band of 2 sigma that noise alone would give.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        Where to draw.
    runs : sequence of SpeedResidual
        With `time` [s], `value` and `sigma` [rad/s].
    """
    for k, r in enumerate(runs):
        band = None if k else "± 2 σ of noise"
        ax.fill_between(r.time, -2 * r.sigma, 2 * r.sigma, color=GREY, alpha=0.6, linewidth=0, label=band)
        ax.plot(r.time, r.value, color=VERMILLION, marker="o", markersize=2.5, linewidth=0.9)
    ax.axhline(0, color="#777777", linewidth=0.8)


def draw_torque(
    ax: Axes,
    curves: Sequence[tuple[str, Array, Array, Array]],
    intervals: Sequence[tuple[float, float]] = (),
) -> None:
    """Draw unmodelled torques with bands of 2 sigma, and shade intervals of significant lack of fit.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        Where to draw.
    curves : sequence of (body, time, torque, sigma)
        Name of the body, [s], [N m], [N m]; where sigma exceeds thrice its minimum the curve is left out.
    intervals : sequence of (start, stop)
        What to shade [s].
    """
    for (body, time, torque, sigma), colour in zip(curves, (VERMILLION, BLUE), strict=False):
        known = np.where(sigma <= 3 * sigma.min(), torque, np.nan)
        edges: dict[str, Any] = {"color": colour, "alpha": 0.25, "linewidth": 0}
        ax.fill_between(time, known - 2 * sigma, known + 2 * sigma, **edges)
        ax.plot(time, known, color=colour, label=f"on the {body} ± 2 σ")
    for start, stop in intervals:
        ax.axvspan(start, stop, color=YELLOW, alpha=0.25, linewidth=0, zorder=0)
    ax.axhline(0, color="#777777", linewidth=0.8)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("torque [N m]")


def draw_candidates(
    ax: Axes,
    names: Sequence[str],
    scores: Sequence[float],
    *,
    significant: Sequence[bool],
    physical: Sequence[bool],
) -> None:
    """Draw a bar per candidate effect, as long as the root of its score.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        Where to draw.
    names, scores : sequence
        Effects, best first, and their scores (chi-square).
    significant, physical : sequence of bool
        Grey bars are not significant, hatched ones are artefacts of the measurement.
    """
    colours = [BLUE if s else GREY for s in significant]
    hatches = ["" if p else "////" for p in physical]
    places = np.arange(len(names))
    ax.barh(places, np.sqrt(scores), color=colours, hatch=hatches, edgecolor="white")
    ax.set_yticks(places, [printable(n) for n in names])
    ax.invert_yaxis()
    ax.set_xlabel(r"$\sqrt{\mathrm{score}}$ [standard deviations]; hatched: artefact, grey: not significant")


def draw_history(
    ax: Axes, changes: Sequence[str], values: Sequence[float], label: str, limit: float | None = None
) -> None:
    """Draw one bar per fit of a history, the first on top.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        Where to draw.
    changes : sequence of str
        What each fit changed.
    values : sequence of float
        The error of each fit.
    label : str
        Name and unit of the error.
    limit : float, optional
        The error that noise alone gives.
    """
    ax.barh(range(len(values)), values, color=[VERMILLION, *[BLUE] * (len(values) - 1)])
    for i, v in enumerate(values):
        ax.annotate(f"{v:.3g}", (v, i), xytext=(3, 0), textcoords="offset points", va="center")
    ax.set_xlim(0, 1.25 * max(values))
    ax.set_ylim(len(values) - 0.5, -0.5)
    ax.set_xlabel(label)
    ax.set_yticks(range(len(values)), [printable(c) for c in changes])
    if limit is not None:
        ax.axvline(limit, color="black", linestyle="--", linewidth=1)


def printable(text: str) -> str:
    """Return a name without mathematics and without letters that the font lacks."""
    return "".join(c if c.isprintable() and ord(c) < 0x2000 else "?" for c in text).replace("$", r"\$")
