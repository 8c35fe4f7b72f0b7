"""Fits, diagnoses and histories in a notebook: HTML tables and figures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import nonbreaking, probability, short, typeset, with_uncertainty
from fitting.discovery._residuals import CASING, ROTOR, Misfit, misfits, modelled_speed
from fitting.inference._velocity import speeds

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fitting.discovery._rank import Candidate
    from fitting.discovery._residuals import ResidualTorque
    from fitting.discovery._select import Rung
    from fitting.discovery._verdict import Diagnosis
    from fitting.inference._result import Fit


_VERDICTS = {
    "adequate": ("✓", "adequate: what the model leaves is noise"),
    "misfit": ("!", "the model misses something"),
    "not converged": ("✗", "not converged: do not trust these numbers"),
    "missing_effect": ("✚", "an effect is missing"),
    "unexplained": ("!", "an unexplained torque remains"),
}
_MOST = 10


def fit_html(fit: Fit) -> str:
    """Return a fit: verdict, equations' effects, figures of merit, parameters with errors and units."""
    merits = [
        (c.label, name, f"{body.r2:.6f}", *(short(v) for v in (body.rmse, body.reduced_chi2, body.held_out)))
        for c in fit.cases
        for name, body in (
            [("body", c.casing)] if math.isnan(c.rotor.rmse) else [("casing", c.casing), ("rotor", c.rotor)]
        )
    ]
    numbers = [
        (name, with_uncertainty(e.value, e.stderr, e.unit), "on its bound" if e.at_bound else "")
        for name, e in fit.estimates.items()
    ]
    return _block(
        _headline(
            fit.verdict, f"{', '.join(fit.labels)}; BIC {fit.bic:.1f}, effective samples {fit.n_eff:.0f}"
        ),
        _table("figures of merit", ("case", "body", "R²", "rms [rad/s]", "χ²/n", "held out [noise]"), merits),
        _table("parameters", ("parameter", "value", ""), numbers),
    )


def diagnosis_html(d: Diagnosis) -> str:
    """Return a diagnosis: the sentence, where the model fails, what would mend it."""
    failures = [
        (
            f.label,
            f.called,
            f"{f.t_start:.1f} – {f.t_stop:.1f}",
            short(f.residual_torque_Nm),
            short(f.residual_rad_s, 2),
            f"{f.size_sigma:.0f}",
        )
        for f in d.failures
    ]
    candidates = [
        (
            c.effect.name + ("" if c.physical else " (artefact)"),
            short(c.score),
            short(c.delta_bic),
            probability(c.p_value),
            ", ".join(c.indistinguishable_from) or "–",
        )
        for c in d.candidates[:_MOST]
        if c.score > 0
    ]
    parts = [_headline(d.verdict, typeset(d.sentence))]
    if failures:
        where = ("case", "body", "time [s]", "torque [N m]", "speed [rad/s]", "σ")
        parts.append(_table("where it fails", where, failures))
    if candidates:
        head = ("effect", "score", "ΔBIC", "p", "same class")
        title = "tried, and not needed" if d.verdict == "adequate" else "what would mend it"
        parts.append(_table(title, head, candidates))
    if d.next_experiment:
        parts.append(f"<p><b>Next experiment.</b> {escape(d.next_experiment)}</p>")
    return _block(*parts)


def ladder_html(rungs: Sequence[Rung]) -> str:
    """Return a ladder: a row a rung, with a bar as long as its error."""
    from fitting.study._serialisation import rung_document

    rows, documents = [], []
    for i, rung in enumerate(rungs):
        documents.append(rung_document(rung.fit, "", rung.change, rungs[i - 1].fit if i else None))
    largest = max((d["rmse_casing"] for d in documents), default=1.0) or 1.0
    for d in documents:
        width = round(100 * d["rmse_casing"] / largest)
        bar = f'<div style="background:#0072b2;height:.6em;width:{max(1, width)}px"></div>'
        cells = [escape(d["added"] or "base")]
        cells += [short(d[k]) for k in ("rmse_casing", "reduced_chi2", "held_out", "delta_bic")]
        cells.append(short(d["torque_left_Nm"], 2))
        rows.append([*cells, bar])
    head = ("change", "rms [rad/s]", "χ²/n", "held out [noise]", "ΔBIC", "torque left [N m]", "")
    return _block(_markup_table("ladder", head, rows))


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


Array = NDArray[np.float64]

BLUE, VERMILLION, GREEN, GREY, YELLOW = "#0072B2", "#D55E00", "#009E73", "#BBBBBB", "#F0E442"
_POINTS = 600


def plot_fit(fit: Fit) -> Figure:
    """Draw each case of a fit: speeds measured and modelled, and what the model leaves, with bands of 2 sigma."""
    cases = len(fit.problem.data)
    alone = all(d.record.single for d in fit.problem.data)
    figure = _figure(4.2 * cases + 3.0, 4.0 if alone else 8.0)
    heights = [1.3, 1] if alone else [1.3, 1, 1.3, 1]
    axes = figure.subplots(len(heights), cases, squeeze=False, height_ratios=heights)
    for i, data in enumerate(fit.problem.data):
        casing, rotor = misfits(fit, i)
        record = data.record
        _speed(axes[0, i], fit, i, CASING, [speeds(record.casing, record.quantity)])
        _left(axes[1, i], [casing])
        axes[0, i].set_title(_plain(record.label), loc="left")
        axes[0, i].set_ylabel(r"$\omega_c$ [rad/s]")
        axes[1, i].set_ylabel(r"$\omega_c$: data $-$ model [rad/s]")
        if not alone:
            _speed(axes[2, i], fit, i, ROTOR, [speeds(w, record.quantity) for w in record.rotor])
            _left(axes[3, i], rotor)
            axes[2, i].set_ylabel(r"$\omega_r$ [rad/s]")
            axes[3, i].set_ylabel(r"$\omega_r$: data $-$ model [rad/s]")
        for ax in axes[:, i]:
            ax.set_xlabel("time [s]")
            # above the axes, where it covers nothing
            above = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}
            ax.legend(fontsize="small", frameon=False, ncols=2, **above)
    return figure


def plot_diagnosis(d: Diagnosis) -> Figure:
    """Draw the torque that is missing on each body with its band, where it fails, and the candidates."""
    labels = list(dict.fromkeys(t.label for t in d.torques))
    shown = [c for c in d.candidates if c.score > 0][:_MOST]
    figure = _figure(9.0, 2.6 * len(labels) + 0.35 * len(shown) + 1.2)
    heights = [2.6] * len(labels) + ([0.35 * len(shown) + 0.7] if shown else [])
    axes = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    called = {c.record.label: c.record.body for c in d.fit.problem.data}
    for ax, label in zip(axes, labels, strict=False):
        _torques(ax, [t for t in d.torques if t.label == label], called[label])
        for f in d.failures:
            if f.label == label:
                ax.axvspan(f.t_start, f.t_stop, color=YELLOW, alpha=0.25, linewidth=0, zorder=0)
        ax.set_title(_plain(label) + ": torque that the model lacks; yellow where it fails")
        ax.legend(fontsize="small", frameon=False)
    if shown:
        _candidates(axes[-1], shown)
    return figure


def plot_ladder(rungs: Sequence[Rung]) -> Figure:
    """Draw how the casing's rms error and the held-out error fall from rung to rung."""
    figure = _figure(8.0, 1.6 + 0.4 * len(rungs))
    left, right = figure.subplots(1, 2, sharey=True)
    names = [_plain(r.change or "base") for r in rungs]
    errors = (
        ("rmse", f"rms error of the {rungs[0].fit.problem.data[0].record.body} [rad/s]"),
        ("held_out", "held-out error [noise]"),
    )
    for ax, (name, title) in zip((left, right), errors, strict=True):
        values = [np.sqrt(np.mean([getattr(c.casing, name) ** 2 for c in r.fit.cases])) for r in rungs]
        ax.barh(range(len(rungs)), values, color=[VERMILLION, *[BLUE] * (len(rungs) - 1)])
        for i, v in enumerate(values):
            ax.annotate(f"{v:.3g}", (v, i), xytext=(3, 0), textcoords="offset points", va="center")
        ax.set_xlim(0, 1.25 * max(values))
        ax.set_xlabel(title)
    left.set_yticks(range(len(rungs)), names)
    left.invert_yaxis()
    right.axvline(1.0, color="black", linestyle="--", linewidth=1)
    return figure


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _speed(ax: Axes, fit: Fit, case: int, body: int, runs: Sequence[tuple[Array, Array]]) -> None:
    for k, (time, omega) in enumerate(runs):
        first = k == 0
        ax.plot(time, omega, color=GREY, linewidth=3, label="measured" if first else None)
        t = np.linspace(time[0], time[-1], _POINTS if len(runs) == 1 else _POINTS // 10)
        value, sigma = modelled_speed(fit, case, body, t)
        ax.fill_between(t, value - 2 * sigma, value + 2 * sigma, color=BLUE, alpha=0.3, linewidth=0)
        ax.plot(t, value, color=BLUE, linewidth=1.2, label="model ± 2 σ" if first else None)


def _left(ax: Axes, runs: Sequence[Misfit]) -> None:
    for k, m in enumerate(runs):
        band = "± 2 σ of noise" if k == 0 else None
        ax.fill_between(m.time, -2 * m.sigma, 2 * m.sigma, color=GREY, alpha=0.6, linewidth=0, label=band)
        ax.plot(m.time, m.value, color=VERMILLION, marker="o", markersize=2.5, linewidth=0.9)
    ax.axhline(0, color="#777777", linewidth=0.8)


def _torques(ax: Axes, curves: Sequence[ResidualTorque], called: str) -> None:
    for curve, colour in zip(curves, (VERMILLION, BLUE), strict=False):
        known = curve.sigma <= 3 * curve.sigma.min()
        torque = np.where(known, curve.torque, np.nan)
        edges: dict[str, Any] = {"color": colour, "alpha": 0.25, "linewidth": 0}
        ax.fill_between(curve.time, torque - 2 * curve.sigma, torque + 2 * curve.sigma, **edges)
        body = called if curve.body == "casing" else curve.body
        ax.plot(curve.time, torque, color=colour, label=f"on the {body} ± 2 σ")
    ax.axhline(0, color="#777777", linewidth=0.8)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("torque [N m]")


def _candidates(ax: Axes, shown: Sequence[Candidate]) -> None:
    colours = [BLUE if c.significant else GREY for c in shown]
    hatches = ["" if c.physical else "////" for c in shown]
    places = np.arange(len(shown))
    ax.barh(places, np.sqrt([c.score for c in shown]), color=colours, hatch=hatches, edgecolor="white")
    ax.set_yticks(places, [_plain(c.effect.name) for c in shown])
    ax.invert_yaxis()
    ax.set_xlabel(r"$\sqrt{\mathrm{score}}$ [standard deviations]; hatched: artefact, grey: not significant")


def _plain(text: str) -> str:
    """Return a name without mathematics and letters that the font lacks."""
    return "".join(c if c.isprintable() and ord(c) < 0x2000 else "?" for c in text).replace("$", r"\$")
