"""`gyrotrack improve`: diagnose, add the best effect, refit, until nothing more is justified."""

from __future__ import annotations

from gyrotrack.cli.options import CaseFiles, Json, Quiet
from gyrotrack.cli.output import Output
from gyrotrack.cli.study import EffectsFile, From, LedgerFile, own_effects
from gyrotrack.cli.tables import ladder_tables
from gyrotrack.study import open_study


def command(
    cases: CaseFiles,
    *,
    effects: EffectsFile = None,
    start: From = None,
    ledger: LedgerFile = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Add effects one by one until what is left is noise, and print the ladder of fits.

    Example: gyrotrack improve case1.h5
    """
    from fitting.beside import Beside
    from fitting.discovery import diagnose, improve
    from fitting.summary import fit_document, ladder_verdict

    out = Output(as_json=as_json, quiet=quiet)
    study = open_study(cases, ledger)
    with Beside() as beside, out.progress("adding effects") as progress:
        progress(0, None)
        base, parent = study.base(start)
        own = own_effects(effects)
        rungs = improve(base, own, progress=progress, beside=beside)
        kept = study.keep(rungs, parent)
        # a report asks for it next, and most of the work is done
        found = diagnose(base, own, candidates=rungs[0].candidates, beside=beside)
        study.keep_diagnosis(parent, found, own)
    steps = [entry.document["rung"] for entry in kept]
    verdict = ladder_verdict(rungs)
    out.result({"ladder": steps, "final": fit_document(rungs[-1].fit, kept[-1].fit_id), "verdict": verdict})
    out.show(*ladder_tables(steps, study.data[0].record.body), f"verdict: {_WORDS[verdict]}")


_WORDS = {
    "adequate": "the model was adequate already; nothing was added",
    "missing_effect": "what was missing has been added; what is left is noise",
    "unexplained": "an unexplained torque remains; see `gyrotrack diagnose`",
}
