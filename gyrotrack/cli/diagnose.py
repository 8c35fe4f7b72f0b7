"""`gyrotrack diagnose`: where the current fit fails, and which effects would mend it."""

from __future__ import annotations

from gyrotrack.cli.options import CaseFiles, Json, Quiet
from gyrotrack.cli.output import Output
from gyrotrack.cli.study import EffectsFile, From, LedgerFile, own_effects
from gyrotrack.cli.tables import diagnosis_tables
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
    """Say where the current fit fails, in time, speed and torque, and which effect is missing.

    Several cases are looked at together. Without a fit so far the reduced model is fitted first.

    Example: gyrotrack diagnose case1.h5
    """
    from fitting.beside import Beside
    from fitting.discovery import diagnose
    from fitting.summary import diagnosis_document

    out = Output(as_json=as_json, quiet=quiet)
    study = open_study(cases, ledger)
    with Beside() as beside, out.progress("scoring effects") as progress:
        progress(0, None)
        fit, fit_id = study.base(start)
        own = own_effects(effects)
        found = diagnose(fit, own, beside=beside)
        study.keep_diagnosis(fit_id, found, own)
    out.result(diagnosis_document(found, fit_id))
    out.show(*diagnosis_tables(found, fit_id))
