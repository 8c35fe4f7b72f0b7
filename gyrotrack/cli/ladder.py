"""`gyrotrack ladder`: the fits so far, what was added, and what the error did."""

from __future__ import annotations

from gyrotrack.cli.options import CaseFiles, Json, Quiet
from gyrotrack.cli.output import Output
from gyrotrack.cli.study import DataKind, LedgerFile, RotorKind
from gyrotrack.cli.tables import ladder_tables
from gyrotrack.errors import DatasetError
from gyrotrack.study import open_study


def command(
    cases: CaseFiles,
    *,
    data: DataKind = None,
    rotor: RotorKind = "windows",
    ledger: LedgerFile = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """List the fits of these cases so far: a bar a rung.

    Example: gyrotrack ladder case1.h5
    """
    out = Output(as_json=as_json, quiet=quiet)
    study = open_study(cases, ledger, data=data, rotor=rotor)
    entries = study.ledger.of(study.data)
    if not entries:
        raise DatasetError("There is no fit of these cases yet.", "Make one with `gyrotrack fit`.")
    rungs = [{**e.document["rung"], "parent": e.document.get("parent", "")} for e in entries]
    out.result({"ladder": rungs})
    out.show(*ladder_tables(rungs, study.data[0].record.body))
