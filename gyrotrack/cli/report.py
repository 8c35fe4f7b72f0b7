"""`gyrotrack report`: the whole study as one page that needs nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrotrack.cli.command_line import command_line
from gyrotrack.cli.options import CaseFiles, Films, Force, Json, Quiet, film_folders
from gyrotrack.cli.output import Output
from gyrotrack.cli.study import EffectsFile, From, LedgerFile, own_effects
from gyrotrack.study import open_study


def command(
    cases: CaseFiles,
    *,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="The report to write: .html or .pdf.")
    ] = Path("report.html"),
    films: Films = None,
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
    from fitting.beside import Beside
    from gyrotrack.dataset import read_case
    from gyrotrack.dataset.writing import refuse_existing
    from gyrotrack.report import write_report
    from gyrotrack.report.figures.style import get_ready

    out = Output(as_json=as_json, quiet=quiet)
    refuse_existing(output, force=force)
    study = open_study(cases, ledger)
    with Beside() as beside, out.progress("writing the report") as progress:
        progress(0, None)
        beside.begin(get_ready)
        rungs = study.rungs_to(start)
        diagnosis = study.diagnosis(start, rungs[0].fit, own_effects(effects), beside=beside)
        recordings = [read_case(case) for case in cases]
        where = {"command": command_line(), "ledger": str(study.ledger.path)}
        write_report(
            output,
            rungs,
            diagnosis,
            recordings=recordings,
            films=film_folders(cases, films),
            provenance=where,
            force=force,
            beside=beside,
        )
    out.result({"output": output, "fits": [r.change or "base" for r in rungs], "verdict": diagnosis.verdict})
    out.show(f"written: {output}")
