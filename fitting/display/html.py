"""Tables in HTML for notebooks; every name is escaped."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

from fitting.typesetting import measured, probability, short, typeset, unbroken

if TYPE_CHECKING:
    from fitting.discovery import Diagnosis, Rung
    from fitting.estimation import Fit

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
        (name, measured(e.value, e.stderr, e.unit), "on its bound" if e.at_bound else "")
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
    from fitting.summary import rung_document

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
    return f"<p><b>{sign} {escape(words)}</b><br>{escape(unbroken(text))}</p>"


def _table(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return _markup_table(caption, head, [[escape(unbroken(c)) for c in row] for row in rows])


def _markup_table(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    top = "".join(f'<th scope="col" style="text-align:left">{escape(h)}</th>' for h in head)
    body = "".join(
        "<tr>" + "".join(f'<td style="text-align:left">{c}</td>' for c in row) + "</tr>" for row in rows
    )
    title = f'<caption style="text-align:left">{escape(caption)}</caption>'
    return f"<table>{title}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _block(*parts: str) -> str:
    return f"<div>{''.join(parts)}</div>"
