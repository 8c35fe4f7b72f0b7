"""`gyrotrack report`: the whole study as one page that needs nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrotrack.cli.command_line import command_line
from gyrotrack.cli.options import CaseFiles, Force, Json, Quiet
from gyrotrack.cli.output import Output
from gyrotrack.cli.study import EffectsFile, From, LedgerFile, Study, open_study, own_effects

if TYPE_CHECKING:
    from fitting.discovery import Rung


def command(
    cases: CaseFiles,
    *,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="The report to write: .html or .pdf.")
    ] = Path("report.html"),
    films: Annotated[
        list[Path] | None,
        typer.Option(
            "--films", metavar="DIR", help="Where the films lie; beside the case and here, if not given."
        ),
    ] = None,
    effects: EffectsFile = None,
    start: From = None,
    ledger: LedgerFile = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a report of the latest fit and the rungs that led to it: one HTML file or a PDF, no network.

    Frames of the films are shown where the films are found.

    Example: gyrotrack report case1.h5 -o report.html
    """
    from fitting.discovery import diagnose
    from gyrotrack.dataset import read_case
    from gyrotrack.dataset.writing import refuse_existing
    from gyrotrack.report import write_report

    out = Output(as_json=as_json, quiet=quiet)
    refuse_existing(output, force=force)
    study = open_study(cases, ledger)
    with out.progress("writing the report") as progress:
        progress(0, None)
        rungs = _rungs(study, start)
        diagnosis = diagnose(rungs[0].fit, own_effects(effects))
        recordings = [read_case(case) for case in cases]
        where = {"command": command_line(), "ledger": str(study.ledger.path)}
        write_report(
            output,
            rungs,
            diagnosis,
            recordings=recordings,
            films=folders(cases, films),
            provenance=where,
            force=force,
        )
    out.result({"output": output, "fits": [r.change or "base" for r in rungs], "verdict": diagnosis.verdict})
    out.show(f"written: {output}")


def folders(cases: Sequence[Path], given: Sequence[Path] | None) -> list[Path]:
    """Return the folders in which films are looked for."""
    return list(given) if given else list(dict.fromkeys([*(c.parent for c in cases), Path()]))


def _rungs(study: Study, start: str | None) -> list[Rung]:
    """Return the latest fit and those that it was made from, the first one first."""
    from fitting.discovery import Rung

    entry = study.entry(start)
    if entry is None:
        fit, _ = study.base(None)
        return [Rung("", fit, ())]
    known = {e.fit_id: e for e in study.ledger.of(study.data)}
    chain = [entry]
    while (
        parent := known.get(str(chain[-1].document.get("parent", "")))
    ) is not None and parent not in chain:
        chain.append(parent)
    return [Rung(str(e.document.get("added", "")), e.refit(study.data), ()) for e in reversed(chain)]
