"""What came of a batch: a row a case, as records, CSV and lines of text."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gyrotrack.batch.experiment import Experiment
from gyrotrack.batch.steps import Outcome, Step
from gyrotrack.dataset.writing import new_file
from gyrotrack.exporting.files import plain_cell


@dataclass(frozen=True)
class Row:
    """One case.

    Attributes
    ----------
    state : str
        "done", "partly" (a film was lost, the rest went on) or "failed".
    films, tracked, frames : int
        Films given, films tracked, frames in those.
    fit, missing, diagnosis : str
        Verdict of the fit, effects that a diagnosis or improvement names, verdict of the diagnosis.
    rmse_casing, reduced_chi2 : float or None
        Of the fit [rad/s, 1].
    trusted : bool
        Whether no step said that its result is not to be relied on.
    seconds : float
        Work in all its steps, in this run or an earlier one.
    problem : str
        The first thing that went wrong, with its step.
    """

    label: str
    folder: str
    state: str
    films: int
    tracked: int
    frames: int
    fit: str
    rmse_casing: float | None
    reduced_chi2: float | None
    diagnosis: str
    missing: str
    trusted: bool
    warnings: int
    seconds: float
    problem: str


def summarise(
    experiments: Sequence[Experiment], steps: Sequence[Step], ended: Mapping[str, Outcome]
) -> tuple[Row, ...]:
    """Return a row for each case."""
    own: dict[str, dict[str, Outcome]] = {e.folder: {} for e in experiments}
    for step in steps:
        if step.name in ended:
            own[step.folder][step.name.partition("/")[2]] = ended[step.name]
    return tuple(_row(e, own[e.folder]) for e in experiments)


def _row(e: Experiment, outcomes: dict[str, Outcome]) -> Row:
    films = [o for name, o in outcomes.items() if name.startswith("extract ")]
    good = [o.document for o in films if o.good]
    fit = outcomes["fit"].document if "fit" in outcomes and outcomes["fit"].good else {}
    diagnosis = outcomes["diagnose"].document if "diagnose" in outcomes and outcomes["diagnose"].good else {}
    bad = [(name, o) for name, o in outcomes.items() if o.state == "failed"]
    blocked = any(o.state == "blocked" for o in outcomes.values())
    casing = (fit.get("cases") or [{}])[0].get("casing", {})
    return Row(
        label=e.label,
        folder=e.folder,
        state="done"
        if not bad and not blocked
        else "failed"
        if blocked or not good or "fit" in dict(bad)
        else "partly",
        films=len(films),
        tracked=len(good),
        frames=sum(int(d.get("frames", 0)) for d in good),
        fit=str(fit.get("verdict", "")),
        rmse_casing=casing.get("rmse"),
        reduced_chi2=casing.get("reduced_chi2"),
        diagnosis=str(diagnosis.get("verdict", "")),
        missing=_missing(diagnosis, outcomes.get("improve")),
        trusted=all(o.trusted for o in outcomes.values()),
        warnings=sum(len(o.document.get("warnings", ())) for o in outcomes.values()),
        seconds=round(sum(o.seconds for o in outcomes.values()), 3),
        problem=_problem(*bad[0]) if bad else "",
    )


def _missing(diagnosis: dict[str, Any], improved: Outcome | None) -> str:
    if improved is not None and improved.good:
        return " ".join(str(r["added"]) for r in improved.document.get("ladder", [])[1:])
    if diagnosis.get("verdict") != "missing_effect":
        return ""
    best = (diagnosis.get("candidates") or [{}])[0]
    alike = [str(n) for n in best.get("indistinguishable_from", [])]
    return " or ".join([str(best.get("effect", "")), *alike])


def _problem(name: str, outcome: Outcome) -> str:
    error = outcome.document.get("error", {})
    return f"{name}: {error.get('message', 'it failed')}"


def write_summary(folder: Path, rows: Sequence[Row], facts: Mapping[str, Any]) -> list[Path]:
    """Write ``summary.csv`` and ``summary.json`` into the folder of the results."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row.__dataclass_fields__)
    for row in rows:
        cells = asdict(row).values()
        writer.writerow([plain_cell(c) if isinstance(c, str) else "" if c is None else c for c in cells])
    document = {**facts, "cases": [asdict(row) for row in rows]}
    written = []
    for name, content in (
        ("summary.csv", text.getvalue()),
        ("summary.json", json.dumps(document, indent=1, allow_nan=False) + "\n"),
    ):
        with new_file(folder / name, force=True) as stream:
            stream.write(content.encode())
        written.append(folder / name)
    return written


def lines(rows: Sequence[Row]) -> list[str]:
    """Return the table for a terminal of 80 columns, and below it what went wrong."""
    out = [f"{'case':<20}{'films':>7}{'frames':>8}  {'fit':<14}{'rmse':>9}{'chi2/n':>9}  missing"]
    for r in rows:
        name = r.label if len(r.label) < 20 else "..." + r.label[-16:]
        numbers = "".join(
            f"{v:>9.3g}" if v is not None else f"{'-':>9}" for v in (r.rmse_casing, r.reduced_chi2)
        )
        verdict = r.fit or ("-" if r.state == "done" else r.state)
        out.append(
            f"{name:<20}{f'{r.tracked}/{r.films}':>7}{r.frames:>8}  {verdict:<14}{numbers}  {r.missing}".rstrip()
        )
    told = [f"{r.label}: {r.problem}" for r in rows if r.problem]
    return [*out, *(["", "what went wrong:", *(f"  {line}" for line in told)] if told else [])]
