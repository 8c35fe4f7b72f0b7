r"""A scan as LaTeX tables in the form of the paper's: the runs, the two models, their figures of merit.

The text is a fragment for ``\input``; it needs booktabs, multirow and xcolor with its option ``table``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from fitting.estimation import Estimate
from fitting.estimation.metrics import CaseMetrics
from fitting.scanning.numerals import NEARLY_NOTHING, concise, three_digits
from fitting.scanning.robustness import Robustness
from fitting.scanning.runs import AIR_COLUMNS, BEARING_COLUMNS, COLUMNS, shade
from fitting.scanning.scan import ModelFits, Row, Scan

_PREAMBLE = r"""% made by gyrotrack scan; in the preamble:
% \usepackage{booktabs,multirow}
% \usepackage[table]{xcolor}
"""
_SHADES = {"light gray": "gray!25", "gray": "gray!50", "dark gray": "gray!75"}
_UNITS = (
    r"SI units: $[b_1]=[c]=\mathrm{N\,m}$, $[a_1]=[b_2]=[d]=\mathrm{N\,m\,s}$, $[a_2]=[e]=\mathrm{N\,m\,s^2}$, "
    r"$[f]=\mathrm{N\,m\,s}^{g}$."
)
_ERRORS = "In brackets the standard error in units of the last digit."
_SPEED = r"$R^2$ of the casing's speed."
_SHADING = r"White: $R^2\ge 0.99$; light gray: $0.99>R^2\ge 0.90$; gray: $0.90>R^2\ge 0$; dark gray: $R^2<0$."


def scan_latex(scan: Scan) -> str:
    """Return all tables of a scan as LaTeX."""
    parts = [_PREAMBLE]
    for label, rows in zip(scan.labels, scan.air, strict=True):
        caption = f"Drag of rotor and casing, {_escaped(label)}, with $c=e=f=0$. {_SPEED} {_SHADING}"
        parts.append(_table(_runs(rows, AIR_COLUMNS), "c" * 5 + "c", caption, f"scan-air-{_key(label)}"))
    for label, rows in zip(scan.labels, scan.bearing, strict=True):
        caption = (
            f"Laws of the bearing, {_escaped(label)}, with $a_1=0$; $R^2$ of the casing's speed. {_SHADING}"
        )
        parts.append(_table(_runs(rows, BEARING_COLUMNS), "c" * 9, caption, f"scan-bearing-{_key(label)}"))
    for model in scan.models:
        symbols = [s for s, c in COLUMNS.items() if c.key in model.separate[0].model.parameters]
        caption = f"Fitted parameters of the {model.name} model" + _and_joint(model) + f" {_ERRORS} {_UNITS}"
        parts.append(
            _table(
                _parameters(model, scan.labels, symbols), "l" + "c" * len(symbols), caption, f"{model.name}"
            )
        )
        caption = f"Fit metrics of the {model.name} model" + _and_joint(model)
        parts.append(_table(_metrics(model, scan.labels), "llccccc", caption, f"{model.name}-metrics"))
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


def _runs(rows: Sequence[Row], symbols: Sequence[str]) -> list[str]:
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
    if 0 < abs(value) < NEARLY_NOTHING:
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
        lines.append(
            _line([_escaped(label), *(_with_error(fit.estimates[COLUMNS[s].key], s) for s in symbols)])
        )
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


def _metrics(model: ModelFits, labels: Sequence[str]) -> list[str]:
    lines = [_line(_FIGURES_OF_MERIT), r"\midrule"]
    blocks = [
        (f"Fit {i + 1}", f, [label]) for i, (f, label) in enumerate(zip(model.separate, labels, strict=True))
    ]
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
    "held out",
    "energy drift",
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
        exponent = COLUMNS[r.symbol].exponent
        lines.append(
            _line(
                [
                    _heading(r.symbol),
                    f"${three_digits(r.mean / 10.0**exponent)}$".replace("~0", r"\approx 0"),
                    _percent(r.spread),
                    _percent(r.shift),
                    f"${r.sigma:.1f}$" if math.isfinite(r.sigma) else "",
                    r.verdict,
                ]
            )
        )
    return lines


def _percent(share: float) -> str:
    return f"${100 * share:.1f}\\,\\%$" if math.isfinite(share) else ""


def _four(x: float) -> str:
    return f"{x:.4g}" if abs(x) < 1e5 else "{:.2f}\\times 10^{{{}}}".format(*_scientific(x))


def _scientific(x: float) -> tuple[float, int]:
    mantissa, _, exponent = f"{x:.6e}".partition("e")
    return float(mantissa), int(exponent)


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _escaped(text: str) -> str:
    special = {c: "\\" + c for c in "&%$#_{}"} | {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        # with the plain encoding of fonts these would print as Spanish marks and a dash
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
    }
    return "".join(special.get(c, c) for c in text)


def _key(label: str) -> str:
    return "".join(c if c.isascii() and c.isalnum() else "-" for c in label)
