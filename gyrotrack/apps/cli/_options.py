"""Options shared by several commands.

::

    def command(cases: CaseFiles, *, output: OutputFile, as_json: Json = False) -> int | None: ...
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fitting.effects._effect import Effect


Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout and nothing else.")]
Quiet = Annotated[
    bool, typer.Option("-q", "--quiet", help="Show warnings only, no progress or other messages.")
]
Verbose = Annotated[bool, typer.Option("-v", "--verbose", help="Verbose output.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing output.")]

OutputFile = Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")]
OptionalOutputFile = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="FILE", help="File to write.")
]
CaseFiles = Annotated[
    list[Path], typer.Argument(metavar="CASE.h5", help="Case files, made by `sync` or `import`.")
]

Films = Annotated[
    list[Path] | None,
    typer.Option(
        "--films", metavar="DIR", help="Folder of the films; by default the folders of the case and this one."
    ),
]

InertiaRotor = Annotated[
    str | None,
    typer.Option(
        "--inertia-rotor",
        metavar="I",
        help="Moment of inertia of the rotor: '5.54e-5 +- 0.06e-5' (kg m2) or '554 g cm2'.",
    ),
]
InertiaCasing = Annotated[
    str | None,
    typer.Option("--inertia-casing", metavar="I", help="Moment of inertia of the casing, in the same form."),
]
Label = Annotated[
    str | None, typer.Option("--label", metavar="L", help="Name of the case; by default that of the file.")
]
Surface = Annotated[str, typer.Option("--surface", metavar="S", help="Surface on which the casing turns.")]


def film_folders(cases: Sequence[Path], given: Sequence[Path] | None) -> list[Path]:
    """Return the folders that are searched for films; see `Films`."""
    return list(given) if given else list(dict.fromkeys([*(c.parent for c in cases), Path()]))


From = Annotated[
    str | None, typer.Option("--from", metavar="ID", help="Fit to start from; by default the latest.")
]
PriorStudy = Annotated[
    Path | None,
    typer.Option(
        "--prior",
        metavar="STUDY",
        help="Case or ledger of other recordings; the parameters of its latest fit become a prior.",
    ),
]
PriorRotor = Annotated[
    Path | None,
    typer.Option(
        "--prior-rotor",
        metavar="STUDY",
        help="Prior from a study of the rotor alone; its parameters are matched by their laws.",
    ),
]
LedgerFile = Annotated[
    Path | None,
    typer.Option("--ledger", metavar="FILE", help="File of the fits; by default next to the first case."),
]
EffectsFile = Annotated[
    Path | None, typer.Option("--effects", metavar="FILE", help="Your own effects, in TOML.")
]
DataKind = Annotated[
    str | None,
    typer.Option(
        "--data", metavar="D", help="Fitted quantity: angle, or velocity (smoothed as in the paper)."
    ),
]
RotorKind = Annotated[
    str,
    typer.Option(
        "--rotor",
        metavar="R",
        help="Rotor data: windows (as measured) or generated (a curve through them, as in the paper).",
    ),
]


def own_effects(path: Path | None) -> list[Effect]:
    """Read user-defined effects, if a file is given."""
    if path is None:
        return []
    from fitting.effects._user import read_effects
    from gyrotrack.io._atomic import refuse_special

    refuse_special(path)
    return read_effects(path)
