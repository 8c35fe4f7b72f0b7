r"""Tables of a scan as text, LaTeX, CSV and JSON.

The LaTeX text is a fragment for ``\input``; it needs booktabs, multirow and xcolor with the option ``table``.
"""

from __future__ import annotations

import csv
import io
import math
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, TypedDict

from fitting._schema import FitDocument, PredictedDocument, as_document
from fitting.inference._metrics import CaseMetrics
from fitting.inference._params import Estimate
from fitting.inference._result import Fit
from fitting.paper._scan import AIR_COLUMNS, BEARING_COLUMNS, COLUMNS, ModelFits, Robustness, Row, Scan, shade
from fitting.study._serialisation import fit_document

NEARLY_ZERO = 1e-4
"""A parameter is printed as approximately 0 if its value, in units of the header, is below this value [1]. Source: the
tables of the paper."""


def three_digits(x: float) -> str:
    """Return a number with three significant digits: ``0.0432``, ``9.97``, ``4080``; ``~0`` below 1e-4."""
    if not math.isfinite(x):
        return "-"
    if x == 0:
        return "0"
    if abs(x) < NEARLY_ZERO:
        return "~0"
    places = 2 - math.floor(math.log10(float(f"{abs(x):.2e}")))
    if places < -3:
        return f"{x:.1e}"
    return f"{round(x, places):.{max(0, places)}f}"


def concise(value: float, error: float) -> str:
    """Return a number with its standard error in units of the last digit: ``9.97(12)``, ``4080(120)``.

    The error has two digits if these digits are between 10 and 29, otherwise one digit. A number without a standard
    error has three significant digits.
    """
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return three_digits(value)
    leading = math.floor(math.log10(error))
    places = -leading + (1 if error / 10.0**leading < 2.95 else 0)
    shown = round(error, places)
    number = f"{round(value, places):.{max(0, places)}f}"
    return f"{number}({shown * 10.0 ** max(0, places):.0f})"


_MARKS = {"white": " ", "light gray": ".", "gray": ":", "dark gray": "#"}
LEGEND = (
    "R2 of the casing's speed: . below 0.99, : below 0.90, # below 0 (the paper's three shades)",
    "- term excluded   * active bound   ? uncertainty larger than the value   ! not converged",
    "dBIC: against the best run of the table",
)
_WIDTH = 8
"""Width of a column [characters]. Chosen: four digits, sign and mark fit; a smaller value joins columns, a larger one
widens the table."""
_SMALLEST_SHARE = 1e-4
"""Smallest share that is printed as a number [1]. Chosen: a smaller value prints digits without meaning, a larger one
hides small shares."""


def scan_lines(scan: Scan) -> list[str]:
    """Return the tables of a scan, one string per line.

    Parameters
    ----------
    scan : Scan
        From `fitting.scan`.

    Returns
    -------
    list of str
        At most 80 columns; parameters in SI units.
    """
    lines = []
    for label, air, bearing in zip(scan.labels, scan.air, scan.bearing, strict=True):
        lines += [f"{label}: which drags are needed (bearing: d alone)", *_runs(air, AIR_COLUMNS), ""]
        lines += [f"{label}: which laws of the bearing are needed (no a1)"]
        lines += [*_runs(bearing, BEARING_COLUMNS), ""]
    lines += [line for s in LEGEND for line in textwrap.wrap(s, 79, subsequent_indent="  ")]
    lines.append("")
    for model in scan.models:
        lines += _model(model, scan.labels)
    return lines


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
        end = "!" if row.fit.verdict == "not_converged" else ""
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
    return f"{three_digits(e.value / 10.0**column.exponent):>{_WIDTH - 1}}{_mark(e)}"


def _mark(e: Estimate) -> str:
    return "*" if e.at_bound else "?" if e.stderr > abs(e.value) else " "


def _model(model: ModelFits, labels: Sequence[str]) -> list[str]:
    symbols = [s for s, c in COLUMNS.items() if c.key in model.separate[0].model.parameters]
    names = _short_names(labels)
    width = max(len("case"), *map(len, names.values()))

    def named(label: str, rest: str) -> str:
        return f"{names.get(label, label):<{width}}{rest}".rstrip()

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
        ahead = predicted.get(label, math.nan)
        lines.append(named(label, _metrics(fit, label, ahead, joint=kind == "joint")))
    if model.joint is not None:
        lines += ["", f"robustness of the {model.name} model's parameters across the cases"]
        lines += robustness_lines(model.robustness)
    return [*lines, ""]


def _short_names(labels: Sequence[str]) -> dict[str, str]:
    """Return for each label a unique name of at most 7 characters: its first or last characters, or a number."""
    beginnings = [label[:7] for label in labels]
    ends = [label if len(label) < 8 else f"…{label[-6:]}" for label in labels]
    numbers = [f"case {i}" for i in range(1, len(labels) + 1)]
    different = next(n for n in (beginnings, ends, numbers) if len(set(n)) == len(labels))
    return dict(zip(labels, different, strict=True))


def _metrics_head() -> str:
    return f"{'R2 rotor':>10}{'R2 casing':>11}{'rmse':>9}{'misfit':>10}{'predict.':>10}{'predicted':>11}{'energy':>10}"


def _metrics(fit: Fit, label: str, predicted: float, *, joint: bool) -> str:
    case = next(c for c in fit.cases if c.label == label)
    ahead = f"{predicted:.4g}" if joint and not math.isnan(predicted) else ""
    return (
        f"{case.rotor.r2:>10.6f}{case.casing.r2:>11.6f}{case.casing.rmse:>9.3g}"
        f"{case.misfit:>10.4g}{case.casing.held_out:>10.4g}{ahead:>11}{case.energy_drift:>10.1e}"
    )


def robustness_lines(found: Sequence[Robustness]) -> list[str]:
    """Return the lines of the table of robustness; spread and shift are relative to the mean."""
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
    if abs(share) < _SMALLEST_SHARE:
        return "< 0.01 %"
    return f"{100 * share:.2g} %" if abs(share) < 1 else f"{100 * share:.0f} %"


_PREAMBLE = r"""% made by gyrotrack scan; in the preamble:
% \usepackage{booktabs,multirow}
% \usepackage[table]{xcolor}
"""
_SHADES = {"light gray": "gray!25", "gray": "gray!50", "dark gray": "gray!75"}
_UNITS = (
    r"SI units: $[b_1]=[c]=\mathrm{N\,m}$, $[a_1]=[b_2]=[d]=\mathrm{N\,m\,s}$, $[a_2]=[e]=\mathrm{N\,m\,s^2}$, "
    r"$[f]=\mathrm{N\,m\,s}^{g}$."
)
_ERRORS = "The standard error in units of the last digit is given in brackets."
_SPEED = r"$R^2$ of the casing's speed."
_SHADING = r"White: $R^2\ge 0.99$; light gray: $0.99>R^2\ge 0.90$; gray: $0.90>R^2\ge 0$; dark gray: $R^2<0$."


def scan_latex(scan: Scan) -> str:
    """Return all tables of a scan as LaTeX."""
    parts = [_PREAMBLE]
    for label, rows in zip(scan.labels, scan.air, strict=True):
        caption = f"Drag of rotor and casing, {_escaped(label)}, with $c=e=f=0$. {_SPEED} {_SHADING}"
        parts.append(_table(_latex_runs(rows, AIR_COLUMNS), "c" * 6, caption, f"scan-air-{_key(label)}"))
    for label, rows in zip(scan.labels, scan.bearing, strict=True):
        caption = f"Laws of the bearing, {_escaped(label)}, with $a_1=0$; {_SPEED} {_SHADING}"
        runs = _latex_runs(rows, BEARING_COLUMNS)
        parts.append(_table(runs, "c" * 9, caption, f"scan-bearing-{_key(label)}"))
    for model in scan.models:
        symbols = [s for s, c in COLUMNS.items() if c.key in model.separate[0].model.parameters]
        caption = f"Fitted parameters of the {model.name} model" + _and_joint(model) + f" {_ERRORS} {_UNITS}"
        lines = _parameters(model, scan.labels, symbols)
        parts.append(_table(lines, "l" + "c" * len(symbols), caption, model.name))
        caption = f"Fit metrics of the {model.name} model" + _and_joint(model)
        parts.append(_table(_latex_metrics(model, scan.labels), "llccccc", caption, f"{model.name}-metrics"))
        if model.joint is not None:
            caption = (
                f"Robustness of the {model.name} model's parameters: spread of the separate fits and shift to the "
                "joint fit, as shares of the mean."
            )
            parts.append(_table(_robustness(model.robustness), "lccccl", caption, f"{model.name}-robustness"))
    return "\n".join(parts)


def _and_joint(model: ModelFits) -> str:
    return ": separate fits, then the joint fit." if model.joint is not None else "."


def _table(rows: Sequence[str], columns: str, caption: str, key: str) -> str:
    body = "\n".join(f"    {row}" for row in rows)
    return (
        "\\begin{table}[htbp]\n  \\centering\n  \\scriptsize\n"
        f"  \\begin{{tabular}}{{{columns}}}\n    \\toprule\n{body}\n    \\bottomrule\n  \\end{{tabular}}\n"
        f"  \\caption{{{caption}}}\n  \\label{{tab:{key}}}\n\\end{{table}}\n"
    )


def _heading(symbol: str) -> str:
    column = COLUMNS[symbol]
    name = f"{symbol[0]}_{symbol[1]}" if len(symbol) > 1 else symbol
    return f"${name}\\,(10^{{{column.exponent}}})$" if column.exponent else f"${name}$"


def _latex_runs(rows: Sequence[Row], symbols: Sequence[str]) -> list[str]:
    lines = [_line([*map(_heading, symbols), "$R^2$"]), r"\midrule"]
    for row in rows:
        if row.fit is None:
            lines.append(rf"\multicolumn{{{len(symbols) + 1}}}{{l}}{{{' '.join(row.run.terms)}: no fit}} \\")
            continue
        values = [_value(row.fit.estimates.get(COLUMNS[s].key), s) for s in symbols]
        cells = [*values, f"${row.r2:.3f}$"]
        colour = _SHADES.get(row.shade)
        if colour:
            cells = [rf"\cellcolor{{{colour}}}{c}" for c in cells]
        lines.append(_line(cells))
    return lines


def _value(estimate: object, symbol: str) -> str:
    value = getattr(estimate, "value", 0.0) / 10.0 ** COLUMNS[symbol].exponent
    if 0 < abs(value) < NEARLY_ZERO:
        return r"$\approx 0$"
    return f"${three_digits(value)}$"


def _with_error(estimate: Estimate | None, symbol: str) -> str:
    if estimate is None:
        return "$0$"
    unit = 10.0 ** COLUMNS[symbol].exponent
    return f"${concise(estimate.value / unit, estimate.stderr / unit)}$".replace("~0", r"\approx 0")


def _parameters(model: ModelFits, labels: Sequence[str], symbols: Sequence[str]) -> list[str]:
    lines = [_line(["", *map(_heading, symbols)]), r"\midrule"]
    for label, fit in zip(labels, model.separate, strict=True):
        values = [_with_error(fit.estimates[COLUMNS[s].key], s) for s in symbols]
        lines.append(_line([_escaped(label), *values]))
    if model.joint is not None:
        lines.append(r"\midrule")
        found = model.joint.estimates
        for i, label in enumerate(labels):
            cells = [_escaped(label)]
            for s in symbols:
                own = found.get(f"{COLUMNS[s].key}@{label}")
                shared = rf"\multirow{{{len(labels)}}}{{*}}{{{_with_error(found.get(COLUMNS[s].key), s)}}}"
                cells.append(_with_error(own, s) if own is not None else shared if i == 0 else "")
            lines.append(_line(cells))
    return lines


def _latex_metrics(model: ModelFits, labels: Sequence[str]) -> list[str]:
    lines = [_line(_FIGURES_OF_MERIT), r"\midrule"]
    separate = enumerate(zip(model.separate, labels, strict=True), 1)
    blocks = [(f"Fit {i}", f, [label]) for i, (f, label) in separate]
    if model.joint is not None:
        blocks.append((f"Fit {len(labels) + 1}", model.joint, list(labels)))
    for name, fit, of in blocks:
        if len(of) > 1:
            lines.append(r"\midrule")
        for i, label in enumerate(of):
            case = next(c for c in fit.cases if c.label == label)
            heading = name if len(of) == 1 else rf"\multirow{{{len(of)}}}{{*}}{{{name}}}"
            lines.append(_line([heading if i == 0 else "", *_merits(case)]))
    return lines


_FIGURES_OF_MERIT = (
    "",
    "",
    r"$R^2$ for $\dot\psi_r$",
    r"$R^2$ for $\dot\psi_c$",
    r"reduced $\chi^2$ for $\dot\psi_c$",
    "cross-validation error",
    "energy balance error",
)


def _merits(case: CaseMetrics) -> list[str]:
    colour = _SHADES.get(shade(case.casing.r2))
    r2 = f"${case.casing.r2:.4f}$"
    return [
        _escaped(case.label),
        f"${case.rotor.r2:.4f}$",
        rf"\cellcolor{{{colour}}}{r2}" if colour else r2,
        f"${_four(case.casing.reduced_chi2)}$",
        f"${_four(case.casing.held_out)}$",
        f"${100 * case.energy_drift:.2g}\\,\\%$",
    ]


def _robustness(found: Sequence[Robustness]) -> list[str]:
    lines = [_line(["", "mean", "spread", "shift", r"$\sigma$", ""]), r"\midrule"]
    for r in found:
        mean = three_digits(r.mean / 10.0 ** COLUMNS[r.symbol].exponent).replace("~0", r"\approx 0")
        shares = [_latex_percent(r.spread), _latex_percent(r.shift)]
        sigma = f"${r.sigma:.1f}$" if math.isfinite(r.sigma) else ""
        lines.append(_line([_heading(r.symbol), f"${mean}$", *shares, sigma, r.verdict]))
    return lines


def _latex_percent(share: float) -> str:
    return f"${100 * share:.1f}\\,\\%$" if math.isfinite(share) else ""


def _four(x: float) -> str:
    if abs(x) < 1e5:
        return f"{x:.4g}"
    mantissa, _, exponent = f"{x:.2e}".partition("e")
    return rf"{mantissa}\times 10^{{{int(exponent)}}}"


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _escaped(text: str) -> str:
    special = {c: "\\" + c for c in "&%$#_{}"} | {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        # the OT1 font encoding prints these as other characters
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
    }
    return "".join(special.get(c, c) for c in text)


def _key(label: str) -> str:
    return "".join(c if c.isascii() and c.isalnum() else "-" for c in label)


_METRICS = ("r2", "rmse", "reduced_chi2", "held_out")


def scan_records(scan: Scan) -> list[dict[str, Any]]:
    """Return every fit of a scan as a flat record of numbers in SI units; a missing number is None.

    The keys are ``table`` (air, bearing, reduced, general), ``fit`` (separate, joint), ``case``, ``terms``; a1 ... g
    and their ``_stderr``; the figures of merit of both bodies; ``held_out_recording`` (joint fits only),
    ``energy_drift``, ``bic``, ``shade``, ``verdict``, ``fault``.
    """
    records = []
    for table, blocks in (("air", scan.air), ("bearing", scan.bearing)):
        for label, rows in zip(scan.labels, blocks, strict=True):
            records += [_row(table, label, row) for row in rows]
    for model in scan.models:
        records += _fits(model, scan.labels)
    return records


def _row(table: str, label: str, row: Row) -> dict[str, Any]:
    head = {"table": table, "fit": "separate", "case": label, "terms": " ".join(row.run.terms)}
    if row.fit is None:
        return head | dict.fromkeys(_number_names()) | {"verdict": "no fit", "fault": row.fault}
    return head | _numbers(row.fit, label, math.nan) | {"verdict": row.fit.verdict, "fault": ""}


def _fits(model: ModelFits, labels: tuple[str, ...]) -> list[dict[str, Any]]:
    predicted = {p.label: p.casing for p in model.predicted}
    blocks = [("separate", f, label) for f, label in zip(model.separate, labels, strict=True)]
    if model.joint is not None:
        blocks += [("joint", model.joint, label) for label in labels]
    records = []
    for kind, fit, label in blocks:
        terms = [s for s, c in COLUMNS.items() if c.key in fit.model.parameters and s != "g"]
        head = {"table": model.name, "fit": kind, "case": label, "terms": " ".join(terms)}
        ahead = predicted.get(label, math.nan) if kind == "joint" else math.nan
        records.append(head | _numbers(fit, label, ahead) | {"verdict": fit.verdict, "fault": ""})
    return records


def _numbers(fit: Fit, label: str, predicted: float) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for symbol, column in COLUMNS.items():
        e = fit.estimates.get(f"{column.key}@{label}", fit.estimates.get(column.key))
        found[symbol] = e.value if e is not None else None
        found[f"{symbol}_stderr"] = e.stderr if e is not None and not math.isnan(e.stderr) else None
    case = next(c for c in fit.cases if c.label == label)
    for body, metrics in (("casing", case.casing), ("rotor", case.rotor)):
        found |= {f"{m}_{body}": getattr(metrics, m) for m in _METRICS}
    return found | {
        "held_out_recording": predicted if not math.isnan(predicted) else None,
        "energy_drift": case.energy_drift,
        "bic": fit.bic,
        "shade": shade(case.casing.r2),
    }


def _number_names() -> list[str]:
    values = [name for s in COLUMNS for name in (s, f"{s}_stderr")]
    metrics = [f"{m}_{body}" for body in ("casing", "rotor") for m in _METRICS]
    return [*values, *metrics, "held_out_recording", "energy_drift", "bic", "shade"]


def scan_csv(scan: Scan) -> str:
    """Return the records of a scan as CSV; the header contains the units, for example ``a2 [N m s2]``."""
    records = scan_records(scan)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([_titled(name) for name in records[0]])
    writer.writerows(record.values() for record in records)
    return stream.getvalue()


def _titled(name: str) -> str:
    column = COLUMNS.get(name.removesuffix("_stderr"))
    unit = column.unit if column is not None else "rad s-1" if name.startswith("rmse_") else ""
    return f"{name} [{unit}]" if unit and unit != "1" else name


class ScanRow(TypedDict):
    """One combination of the paper's terms, fitted to one case."""

    terms: list[str]  #: Symbols of the terms.
    model: list[str]  #: Names of the effects.
    fault: str  #: Reason why there is no fit; empty for a fit.
    r2: float | None  #: Coefficient of determination of the smoothed angular velocity of the casing [1].
    #: The paper's shade of `r2`: `white`, `light gray`, `gray` or `dark gray`; empty without a fit.
    shade: str
    delta_bic: float | None  #: BIC minus the smallest BIC of the table [1].
    fit: FitDocument | None  #: The fit.


class ScanTable(TypedDict):
    """One table of one case."""

    table: str  #: `air` (without one of the drag terms) or `bearing` (all combinations of the bearing laws).
    case: str  #: Name of the case.
    rows: list[ScanRow]  #: Combinations of terms.


class ScanModel(TypedDict):
    """One of the paper's models, fitted to all cases."""

    name: str  #: `reduced` or `general`.
    separate: list[FitDocument]  #: Fit of each case.
    joint: FitDocument | None  #: Joint fit; null for one case.
    predicted: list[PredictedDocument]  #: Prediction of each case from a fit of the other cases.
    robustness: list[Robustness]  #: Scatter of each parameter.


class ScanDocument(TypedDict):
    """Fits of every combination of the paper's terms."""

    cases: list[str]  #: Names of the cases.
    tables: list[ScanTable]  #: The tables `air` and `bearing` of each case.
    models: list[ScanModel]  #: The reduced and the general model.


def scan_document(scan: Scan) -> ScanDocument:
    """Return a scan as a JSON document; its keys must not change, because other programs use them."""
    tables: list[ScanTable] = []
    for name, blocks in (("air", scan.air), ("bearing", scan.bearing)):
        for label, rows in zip(scan.labels, blocks, strict=True):
            best = min((row.fit.bic for row in rows if row.fit is not None), default=0.0)
            tables.append({"table": name, "case": label, "rows": [_row_document(row, best) for row in rows]})
    return {"cases": list(scan.labels), "tables": tables, "models": [_model_document(m) for m in scan.models]}


def _row_document(row: Row, best: float) -> ScanRow:
    return as_document(
        ScanRow,
        row,
        terms=list(row.run.terms),
        model=list(row.run.effects),
        r2=None if row.fit is None else row.r2,
        delta_bic=None if row.fit is None else row.fit.bic - best,
        fit=None if row.fit is None else fit_document(row.fit, ""),
    )


def _model_document(model: ModelFits) -> ScanModel:
    return as_document(
        ScanModel,
        model,
        separate=[fit_document(f, "") for f in model.separate],
        joint=fit_document(model.joint, "") if model.joint is not None else None,
        predicted=[PredictedDocument.model_validate(p).model_dump() for p in model.predicted],
        robustness=[asdict(r) for r in model.robustness],
    )
