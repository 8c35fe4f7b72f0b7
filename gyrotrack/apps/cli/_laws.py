"""`gyrotrack laws`: laws from outside the library for the unmodelled torque of a fit."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrotrack._errors import UsageError
from gyrotrack.apps._study import open_study
from gyrotrack.apps.cli._options import (
    CaseFiles,
    EffectsFile,
    Force,
    From,
    Json,
    LedgerFile,
    Quiet,
    own_effects,
)
from gyrotrack.apps.cli._output import Output

if TYPE_CHECKING:
    from fitting.discovery._dependence import Dependence
    from fitting.discovery._laws import Law, Laws

_SHOWN = 8
_LEAST_P = 1e-300


def laws_command(
    cases: CaseFiles,
    *,
    beyond_library: Annotated[
        bool,
        typer.Option("--beyond-library", help="Search also where an effect of the library is the answer."),
    ] = False,
    save_law: Annotated[
        tuple[str, Path] | None,
        typer.Option(
            "--save-law", metavar="NAME FILE", help="Keep a law under a name in a TOML file of effects."
        ),
    ] = None,
    law: Annotated[
        int, typer.Option("--law", metavar="N", min=1, help="Law of the table that --save-law keeps.")
    ] = 1,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="FILE", help="Draw the answer: .png, .svg or .pdf."),
    ] = None,
    effects: EffectsFile = None,
    start: From = None,
    ledger: LedgerFile = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the law of an unmodelled torque: on what it depends, and which formulas describe it.

    Several cases are searched jointly. Formulas are built from a grammar, fitted, and ranked; the answer is the set of
    all formulas that the data cannot separate. An effect of the library that explains the data comes first.

    Example: gyrotrack laws case1.h5 case2.h5 --save-law lab.saturation my_lab.toml
    """
    from fitting._workers import WorkerPool
    from fitting.discovery._laws import laws
    from fitting.discovery._verdict import diagnose
    from fitting.study._law_documents import check_name, laws_document
    from fitting.study._law_documents import save_law as save
    from gyrotrack.io._atomic import refuse_existing

    out = Output(as_json=as_json, quiet=quiet)
    if picture is not None:
        _format(picture)
        refuse_existing(picture, force=force)
    if save_law is not None:
        check_name(*save_law)
    study = open_study(cases, ledger)
    with WorkerPool() as workers, out.progress("searching for laws") as progress:
        progress(0, None)
        fit, fit_id = study.base(start)
        own = own_effects(effects)
        entry = study.entry(fit_id)
        diagnosis = entry.diagnosis(fit, own) if entry is not None else None
        if diagnosis is None:
            diagnosis = diagnose(fit, own, workers=workers)
            study.keep_diagnosis(fit_id, diagnosis, own)
        found = laws(
            fit, diagnosis=diagnosis, beyond_library=beyond_library, workers=workers, progress=progress
        )
    document = laws_document(found, fit_id)
    if picture is not None:
        from gyrotrack.plotting._laws import write_laws_picture

        write_laws_picture(found, picture, force=force)
    if save_law is not None:
        name, path = save_law
        if law > len(found.laws):
            many = f"there are {len(found.laws)}" if found.laws else "no law was found"
            raise UsageError(
                f"There is no law number {law} to keep: {many}.", "Choose one of the table with --law N."
            )
        labels = ", ".join(fit.labels)
        save(found.laws[law - 1], name, path, f"gyrotrack laws on {labels} (fit {fit_id})")
    out.result(document)
    out.show(laws_table(found, fit_id))
    if save_law is not None:
        out.show(
            f"kept: {save_law[0]} in {save_law[1]}; add it with --effects {save_law[1]} --add {save_law[0]}"
        )
    if picture is not None:
        out.show(f"written: {picture}")


def _format(picture: Path) -> None:
    if picture.suffix.lower() not in {".png", ".svg", ".pdf"}:
        raise UsageError(
            f"{picture} is not the name of a picture.", "Use a name that ends in .png, .svg or .pdf."
        )


def laws_table(found: Laws, fit_id: str) -> str:
    """Return the answer as text: sentence, what the torque depends on, the set of laws, where they differ.

    Parameters
    ----------
    found : Laws
        The answer.
    fit_id : str
        Name of the base.
    """
    lines = [*textwrap.wrap(found.sentence, 79), "", f"fit {fit_id}, verdict: {found.verdict}"]
    lines += _dependences(found.depends_on)
    answer = found.answer
    unit, body = found.fit.torque_unit, found.fit.problem.data[0].record.body
    if found.laws:
        lines += ["", f"laws ({found.trials} columns tried), * = the data cannot separate them:"]
        lines.append(f"   {'':<3}{'dBIC':>10}{'rank':>8}{'p':>9}{'torque':>12}")
        for number, x in enumerate(found.laws[:_SHOWN], 1):
            lines += _law(number, x, found.laws[0], in_answer=any(x is a for a in answer))
    if len(answer) > 1:
        lines += ["", f"where they differ from {answer[0].formula}:"]
        for d in answer[0].differences:
            lines.append(f"  {d.formula}")
            lines.append(
                f"      at most {d.torque_Nm:.1g} {unit} in {d.label}, {d.t_start:.0f} s to {d.t_stop:.0f} s, {body} "
                f"{d.omega_c[0]:.0f} to {d.omega_c[1]:.0f} rad/s"
            )
    if found.next_experiment:
        lines += ["", *textwrap.wrap(f"next experiment: {found.next_experiment}", 79)]
    return "\n".join(lines)


def _dependences(depends_on: tuple[Dependence, ...]) -> list[str]:
    lines = ["", "the unmodelled torque as a smooth function of:"]
    lines.append(f"  {'variable':<20}{'torque':<10}{'explains':>9}{'p':>9}")
    for d in depends_on[:_SHOWN]:
        share = f"{100 * d.explained:.1f} %"
        lines.append(f"  {d.variable.replace('*', ', '):<20}{d.body:<10}{share:>9}{_p(d.p_value):>9}")
    return lines


def _law(number: int, x: Law, best: Law, *, in_answer: bool) -> list[str]:
    from fitting._numbers import rounded

    mark = "*" if in_answer else " "
    worse = x.penalised - best.penalised
    lines = [f"{mark} {number:>2} {x.formula}  ({x.form})"]
    lines.append(
        f"   {'':<3}{x.delta_bic:>10.1f}{'best' if worse == 0 else f'+{worse:.1f}':>8}{_p(x.p_value):>9}"
        f"{x.torque_rms_Nm:>8.2g} {x.fit.torque_unit}"
    )
    values = [
        f"{k.rpartition('.')[2]} = {rounded(e.value, e.stderr, e.unit)}" for k, e in x.estimates.items()
    ]
    return lines + textwrap.wrap(", ".join(values), 79, initial_indent="      ", subsequent_indent="      ")


def _p(p: float) -> str:
    return "<1e-300" if p < _LEAST_P else f"{p:.1g}"
