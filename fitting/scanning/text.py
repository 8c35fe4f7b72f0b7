"""A scan as lines for a terminal: 80 columns, no colour needed."""

from __future__ import annotations

import math
from collections.abc import Sequence

from fitting.estimation import Estimate, Fit
from fitting.scanning.numerals import three_digits
from fitting.scanning.robustness import Robustness
from fitting.scanning.runs import AIR_COLUMNS, BEARING_COLUMNS, COLUMNS
from fitting.scanning.scan import ModelFits, Row, Scan

_MARKS = {"white": " ", "light gray": ".", "gray": ":", "dark gray": "#"}
LEGEND = (
    "R2 of the casing's speed: . below 0.99, : below 0.90, # below 0 (the paper's three shades)",
    "- term left out   * on its bound   ? error larger than the value   ! not converged",
    "dBIC: against the best run of the table",
)
_WIDTH = 8
_HARDLY = 1e-4


def scan_lines(scan: Scan) -> list[str]:
    """Return the tables of a scan, one string a line."""
    lines = []
    for label, air, bearing in zip(scan.labels, scan.air, scan.bearing, strict=True):
        lines += [f"{label}: which drags are needed (bearing: d alone)", *_runs(air, AIR_COLUMNS), ""]
        lines += [
            f"{label}: which laws of the bearing are needed (no a1)",
            *_runs(bearing, BEARING_COLUMNS),
            "",
        ]
    lines += [*_wrapped(LEGEND), ""]
    for model in scan.models:
        lines += _model(model, scan.labels)
    return lines


def _wrapped(sentences: Sequence[str]) -> list[str]:
    import textwrap

    return [line for s in sentences for line in textwrap.wrap(s, 79, subsequent_indent="  ")]


def _runs(rows: Sequence[Row], symbols: Sequence[str]) -> list[str]:
    best = min((row.fit.bic for row in rows if row.fit is not None), default=math.nan)
    lines = [_head(symbols, ["R2", "dBIC"]), _scales(symbols)]
    for row in rows:
        if row.fit is None:
            on = " ".join(row.run.terms)
            lines.append(f"  {on}: no fit, {row.fault}"[:80])
            continue
        values = "".join(_cell(row.fit, s) for s in symbols)
        r2 = f"{row.r2:>8.5f}" if row.r2 > -10 else f"{row.r2:>8.2g}"
        end = "!" if row.fit.verdict == "not converged" else ""
        lines.append(f"{values}{r2}{_MARKS[row.shade]}{_short(row.fit.bic - best):>6}{end}".rstrip())
    return lines


def _short(x: float) -> str:
    return f"{x:.1f}" if abs(x) < 1e3 else f"{x:.0f}" if abs(x) < 1e6 else f"{x:.0e}"


def _head(symbols: Sequence[str], more: Sequence[str]) -> str:
    return "".join(f"{s:>{_WIDTH - 1}} " for s in symbols) + "".join(f"{m:>7} " for m in more).rstrip()


def _scales(symbols: Sequence[str]) -> str:
    cells = [f"1e{COLUMNS[s].exponent}" if COLUMNS[s].exponent else "1" for s in symbols]
    return "".join(f"{c:>{_WIDTH - 1}} " for c in cells).rstrip()


def _cell(fit: Fit, symbol: str, label: str = "") -> str:
    column = COLUMNS[symbol]
    e = fit.estimates.get(f"{column.key}@{label}", fit.estimates.get(column.key))
    if e is None:
        return f"{'-':>{_WIDTH - 1}} "
    return f"{three_digits(e.value / 10.0**column.exponent):>{_WIDTH - 1}}{_doubt(e)}"


def _doubt(e: Estimate) -> str:
    return "*" if e.at_bound else "?" if e.stderr > abs(e.value) else " "


def _model(model: ModelFits, labels: Sequence[str]) -> list[str]:
    symbols = [s for s, c in COLUMNS.items() if c.key in model.separate[0].model.parameters]
    width = max(len("case"), *(min(len(label), 7) for label in labels))

    def named(name: str, rest: str) -> str:
        return f"{name[:7]:<{width}}{rest}".rstrip()

    fits = [*((label, f, "separate") for label, f in zip(labels, model.separate, strict=True))]
    if model.joint is not None:
        fits += [(label, model.joint, "joint") for label in labels]
    lines = [f"{model.name} model" + (": separate fits, then the joint fit" if model.joint else "")]
    lines += [named("case", _head(symbols, [])), named("", _scales(symbols))]
    for label, fit, kind in fits:
        if kind == "joint" and label == labels[0]:
            lines.append("-" * (width + _WIDTH * len(symbols)))
        lines.append(named(label, "".join(_cell(fit, s, label) for s in symbols)))
    lines += ["", named("case", _metrics_head())]
    predicted = {p.label: p.casing for p in model.predicted}
    for label, fit, kind in fits:
        if kind == "joint" and label == labels[0]:
            lines.append("-" * (width + len(_metrics_head())))
        lines.append(
            named(label, _metrics(fit, label, predicted.get(label, math.nan), joint=kind == "joint"))
        )
    if model.joint is not None:
        lines += ["", f"robustness of the {model.name} model's parameters across the cases"]
        lines += robustness_lines(model.robustness)
    return [*lines, ""]


def _metrics_head() -> str:
    return f"{'R2 rotor':>10}{'R2 casing':>11}{'rmse':>9}{'chi2/n':>10}{'held out':>10}{'predicted':>11}{'energy':>10}"


def _metrics(fit: Fit, label: str, predicted: float, *, joint: bool) -> str:
    case = next(c for c in fit.cases if c.label == label)
    ahead = f"{predicted:.4g}" if joint and not math.isnan(predicted) else ""
    return (
        f"{case.rotor.r2:>10.6f}{case.casing.r2:>11.6f}{case.casing.rmse:>9.3g}"
        f"{case.casing.reduced_chi2:>10.4g}{case.casing.held_out:>10.4g}{ahead:>11}{case.energy_drift:>10.1e}"
    )


def robustness_lines(found: Sequence[Robustness]) -> list[str]:
    """Return the table of robustness; spread and shift are shares of the mean."""
    lines = [f"{'':<4}{'mean':>12}  {'unit':<10}{'spread':>10}{'shift':>10}{'sigma':>9}  verdict"]
    for r in found:
        sigma = "" if math.isnan(r.sigma) else f"{r.sigma:.1f}" if r.sigma < 1e5 else f"{r.sigma:.0e}"
        lines.append(
            f"{r.symbol:<4}{r.mean:>12.3e}  {r.unit:<10}{_percent(r.spread):>10}{_percent(r.shift):>10}{sigma:>9}"
            f"  {r.verdict}"
        )
    return lines


def _percent(share: float) -> str:
    if not math.isfinite(share):
        return ""
    if abs(share) < _HARDLY:
        return "< 0.01 %"
    return f"{100 * share:.2g} %" if abs(share) < 1 else f"{100 * share:.0f} %"
