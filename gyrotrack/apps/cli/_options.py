"""Options shared by several commands.

::

    def command(case: CaseFile, *, output: OutputFile, as_json: Json = False) -> int | None: ...
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fitting.effects._effect import Effect


I_ROTOR = 5.54e-5
I_CASING = 2.06e-5

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout and nothing else.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="No progress and no notes.")]
Verbose = Annotated[bool, typer.Option("-v", "--verbose", help="Say more on the way.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing output.")]

OutputFile = Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="The file to write.")]
OptionalOutputFile = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="FILE", help="The file to write.")
]
CaseFile = Annotated[Path, typer.Argument(metavar="CASE.h5", help="A case, made by `sync` or `import`.")]
CaseFiles = Annotated[
    list[Path], typer.Argument(metavar="CASE.h5...", help="Cases, made by `sync` or `import`.")
]

Films = Annotated[
    list[Path] | None,
    typer.Option(
        "--films", metavar="DIR", help="Where the films lie; beside the case and here, if not given."
    ),
]

InertiaRotor = Annotated[
    float, typer.Option("--inertia-rotor", metavar="X", help="Moment of inertia of the rotor [kg m2].")
]
InertiaCasing = Annotated[
    float, typer.Option("--inertia-casing", metavar="Y", help="Moment of inertia of the casing [kg m2].")
]
Label = Annotated[
    str | None, typer.Option("--label", metavar="L", help="Name of the case; the file's, if not given.")
]
Surface = Annotated[str, typer.Option("--surface", metavar="S", help="What the casing turned on.")]


def film_folders(cases: Sequence[Path], given: Sequence[Path] | None) -> list[Path]:
    """Return the folders in which films are looked for; see `Films`."""
    return list(given) if given else list(dict.fromkeys([*(c.parent for c in cases), Path()]))


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
    from fitting.effects._user import read_effects

    return read_effects(path) if path is not None else []
