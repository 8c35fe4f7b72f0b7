"""`gyrotrack budget`: the uncertainty budget of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

import typer

from gyrotrack._errors import UsageError
from gyrotrack.apps._study import open_study
from gyrotrack.apps.cli._options import CaseFiles, From, Json, LedgerFile, Quiet
from gyrotrack.apps.cli._output import Output

if TYPE_CHECKING:
    from fitting.inference._budget import ParameterBudget

# contributions of a smaller share of the variance are left out of the table, not of the JSON document
_SHOWN = 1e-3


def budget_command(
    cases: CaseFiles,
    *,
    start: From = None,
    clock_rate: Annotated[
        float | None,
        typer.Option(
            "--clock-rate",
            metavar="U",
            help="Relative standard uncertainty of the time base; by default that of a crystal, 2.9e-5.",
        ),
    ] = None,
    ledger: LedgerFile = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Uncertainty budget of every parameter: contributions, type A or B, sensitivity, share (GUM).

    Inertias contribute where the case has their uncertainties (`--inertia-rotor "5.54e-5 +- 0.06e-5"`).

    Example: gyrotrack budget case1.h5
    """
    from fitting.inference._budget import CRYSTAL, budget
    from fitting.study._serialisation import budget_document

    if clock_rate is not None and not 0 <= clock_rate < 1:
        raise UsageError(
            f"--clock-rate {clock_rate:g} is outside 0 to 1.", "Give a relative uncertainty: 1e-4."
        )
    out = Output(as_json=as_json, quiet=quiet)
    study = open_study(cases, ledger)
    with out.progress("fitting with other inertias") as progress:
        progress(0, None)
        fit, fit_id = study.base(start)
        found = budget(fit, clock_rate_u=CRYSTAL if clock_rate is None else clock_rate)
    out.result({"fit_id": fit_id, **budget_document(found)})
    out.show(_table(found, fit_id))


def _table(found: Mapping[str, ParameterBudget], fit_id: str) -> str:
    from fitting._numbers import rounded

    lines = [f"uncertainty budget of fit {fit_id} (combined standard uncertainties)"]
    for name, b in found.items():
        lines += ["", f"{name}  {rounded(b.value, b.u, b.unit)}"]
        lines.append(f"  {'source':<32}{'type':<6}{'u':>10}{'sensitivity':>13}{'share':>9}")
        for c in b.contributions:
            if c.share >= _SHOWN:
                slope = "" if c.sensitivity is None else f"{c.sensitivity:.3g}"
                lines.append(f"  {c.source:<32}{c.type:<6}{c.u:>10.2g}{slope:>13}{100 * c.share:>7.1f} %")
    return "\n".join(lines)
