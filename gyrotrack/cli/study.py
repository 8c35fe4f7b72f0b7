"""Options of the commands that look at cases and their fits, declared once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fitting.effects import Effect

From = Annotated[
    str | None, typer.Option("--from", metavar="ID", help="Start from this fit; the latest, if not given.")
]
LedgerFile = Annotated[
    Path | None,
    typer.Option(
        "--ledger", metavar="FILE", help="Where the fits are kept; beside the first case, if not given."
    ),
]
EffectsFile = Annotated[
    Path | None, typer.Option("--effects", metavar="FILE", help="Effects of your own, in TOML.")
]
DataKind = Annotated[
    str | None,
    typer.Option("--data", metavar="D", help="angle or velocity (smoothed as in the paper): what is fitted."),
]
RotorKind = Annotated[
    str,
    typer.Option(
        "--rotor", metavar="R", help="windows as measured, or generated: the paper's curve through them."
    ),
]


def own_effects(path: Path | None) -> list[Effect]:
    """Read the effects of the user's file, if there is one."""
    from fitting.effects import read_effects

    return read_effects(path) if path is not None else []
