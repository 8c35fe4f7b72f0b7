"""A scan as one flat table, a row a fit and case: for CSV, data frames and JSON."""

from __future__ import annotations

import csv
import io
import math
from typing import Any

from fitting.estimation import Fit
from fitting.scanning.runs import COLUMNS, shade
from fitting.scanning.scan import ModelFits, Row, Scan

_METRICS = ("r2", "rmse", "reduced_chi2", "held_out")


def scan_records(scan: Scan) -> list[dict[str, Any]]:
    """Return every fit of a scan as plain numbers in SI units; None where there is none.

    Returns
    -------
    list of dict
        ``table`` (air, bearing, reduced, general), ``fit`` (separate, joint), ``case``, ``terms``; a1 ... g and
        their ``_stderr``; figures of merit of both bodies; ``held_out_recording`` (joint fits only),
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
        return head | dict.fromkeys(_numbers_of_nothing()) | {"verdict": "no fit", "fault": row.fault}
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


def _numbers_of_nothing() -> list[str]:
    values = [name for s in COLUMNS for name in (s, f"{s}_stderr")]
    metrics = [f"{m}_{body}" for body in ("casing", "rotor") for m in _METRICS]
    return [*values, *metrics, "held_out_recording", "energy_drift", "bic", "shade"]


def scan_csv(scan: Scan) -> str:
    """Return the flat table as CSV; the header names the units as ``a2 [N m s2]``."""
    records = scan_records(scan)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([_titled(name) for name in records[0]])
    for record in records:
        writer.writerow(
            ["" if v is None else repr(v) if isinstance(v, float) else v for v in record.values()]
        )
    return stream.getvalue()


def _titled(name: str) -> str:
    column = COLUMNS.get(name.removesuffix("_stderr"))
    unit = column.unit if column is not None else "rad s-1" if name.startswith("rmse_") else ""
    return f"{name} [{unit}]" if unit and unit != "1" else name
