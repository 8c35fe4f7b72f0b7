"""`gyrotrack scan`: every on/off combination of the paper's terms, as its tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrotrack.cli.options import CaseFiles, Force, Json, Quiet
from gyrotrack.cli.output import DONE, NOT_TRUSTED, Output
from gyrotrack.cli.study import DataKind, RotorKind
from gyrotrack.study import read_cases


def command(
    cases: CaseFiles,
    *,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write all fits as one flat table.")
    ] = None,
    latex: Annotated[
        Path | None, typer.Option("--latex", metavar="FILE", help="Write the tables as LaTeX (booktabs).")
    ] = None,
    data: DataKind = None,
    rotor: RotorKind = "windows",
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Fit every on/off combination of the paper's terms, and its reduced and general models.

    For each case: five runs that leave out one drag each, fifteen with all choices of the bearing's laws. For all
    cases: both models separately and together, their figures of merit, and how steady each parameter is.
    Nothing is kept in the ledger.

    Example: gyrotrack scan case1.h5 case2.h5 --latex tables.tex
    """
    from fitting.scanning import scan, scan_document
    from fitting.scanning.latex import scan_latex
    from fitting.scanning.table import scan_csv
    from fitting.scanning.text import scan_lines
    from gyrotrack.dataset.writing import new_file, refuse_existing

    out = Output(as_json=as_json, quiet=quiet)
    targets = {path: make for path, make in ((csv, scan_csv), (latex, scan_latex)) if path is not None}
    for path in targets:
        refuse_existing(path, force=force)
    read = read_cases(cases, data=data, rotor=rotor)
    with out.progress("fitting") as progress:
        found = scan(read, progress=progress)
    for path, make in targets.items():
        with new_file(path, force=force) as stream:
            stream.write(make(found).encode("utf-8"))
    settings = {"data": data or read[0].record.quantity, "rotor": rotor}
    out.result(scan_document(found) | settings | {"outputs": list(targets)})
    out.show("\n".join(scan_lines(found)))
    for path in targets:
        out.show(f"written: {path}")
    return DONE if found.converged else NOT_TRUSTED
