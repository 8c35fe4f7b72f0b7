"""`gyrotrack reveal`: open a sealed challenge and score the answer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrotrack.cli.options import Json
from gyrotrack.cli.output import Output
from gyrotrack.cli.study import LedgerFile
from gyrotrack.study import open_study

Answer = tuple[list[str], dict[str, tuple[float, float]]]


def command(
    seal: Annotated[Path, typer.Argument(metavar="SEAL.json", help="The seal, made by `simulate --hide`.")],
    case: Annotated[
        Path | None, typer.Argument(metavar="[CASE.h5]", help="The case; its latest fit is the answer.")
    ] = None,
    *,
    answer: Annotated[
        str | None,
        typer.Option("--answer", metavar="E", help="The answer: an effect, several by commas, or `none`."),
    ] = None,
    ledger: LedgerFile = None,
    as_json: Json = False,
) -> None:
    """Open a sealed challenge and score an answer: one given here, or the latest fit of the case.

    Example: gyrotrack reveal case.seal.json case.h5
    """
    from gyrotrack.challenge import grade, unseal
    from gyrotrack.errors import UsageError

    out = Output(as_json=as_json)
    if (case is None) == (answer is None):
        raise UsageError(
            "An answer is needed before the seal is opened.", "Give the case with its fits, or --answer."
        )
    named, found = _said(answer) if case is None else _fitted(case, ledger)
    truth = unseal(seal)
    score = grade(truth, named, found)
    out.result({
        "effect": truth.effect,
        "parameters": truth.parameters,
        "answer": named,
        "grade": score.grade,
        "pulls": score.pulls,
        "commitment": truth.commitment,
    })  # fmt: skip
    lines = [score.sentence, *(f"  {k} = {v:.6g}" for k, v in truth.parameters.items())]
    lines += [f"  {k}: {z:+.1f} standard errors from the truth" for k, z in score.pulls.items()]
    out.show("\n".join(lines))


def _said(answer: str | None) -> Answer:
    words = (answer or "none").strip()
    return [] if words == "none" else [a.strip() for a in words.split(",")], {}


def _fitted(case: Path, ledger: Path | None) -> Answer:
    from gyrotrack.challenge import answer_of
    from gyrotrack.errors import DatasetError

    study = open_study([case], ledger)
    entries = study.ledger.of(study.data)
    if not entries:
        raise DatasetError("There is no fit of this case yet.", "Make one with `gyrotrack improve`.")
    return answer_of(entries)
