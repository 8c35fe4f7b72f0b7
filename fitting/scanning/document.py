"""A scan as plain numbers for JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fitting.scanning.scan import ModelFits, Row, Scan
from fitting.summary import fit_document


def scan_document(scan: Scan) -> dict[str, Any]:
    """Return a scan under the keys that other programs rely on.

    Returns
    -------
    dict
        ``cases``; ``tables``: for each case "air" and "bearing" with their ``rows`` (terms, shade, delta_bic within
        the table, and a fit as `fit` has it); ``models``: "reduced" and "general" with ``separate``, ``joint``,
        ``predicted`` and ``robustness``.
    """
    tables = []
    for name, blocks in (("air", scan.air), ("bearing", scan.bearing)):
        for label, rows in zip(scan.labels, blocks, strict=True):
            best = min((row.fit.bic for row in rows if row.fit is not None), default=0.0)
            tables.append({"table": name, "case": label, "rows": [_row(row, best) for row in rows]})
    return {"cases": list(scan.labels), "tables": tables, "models": [_model(m) for m in scan.models]}


def _row(row: Row, best: float) -> dict[str, Any]:
    head = {"terms": list(row.run.terms), "model": list(row.run.effects), "fault": row.fault}
    if row.fit is None:
        return head | {"r2": None, "shade": "", "delta_bic": None, "fit": None}
    return head | {
        "r2": row.r2,
        "shade": row.shade,
        "delta_bic": row.fit.bic - best,
        "fit": fit_document(row.fit, ""),
    }


def _model(model: ModelFits) -> dict[str, Any]:
    return {
        "name": model.name,
        "separate": [fit_document(f, "") for f in model.separate],
        "joint": fit_document(model.joint, "") if model.joint is not None else None,
        "predicted": [
            {"label": p.label, "casing": p.casing, "rotor": p.rotor, "r2": p.r2, "rmse": p.rmse}
            for p in model.predicted
        ],
        "robustness": [asdict(r) for r in model.robustness],
    }
