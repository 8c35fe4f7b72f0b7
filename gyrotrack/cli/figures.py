"""`gyrotrack figures`: the paper's figures and tables of a study, as files for a paper of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrotrack.cli.options import CaseFiles, Films, Force, Json, Quiet, film_folders
from gyrotrack.cli.output import DONE, NOT_TRUSTED, Output
from gyrotrack.errors import OutputError, UsageError
from gyrotrack.study import read_cases


def command(
    cases: CaseFiles,
    *,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for figures and tables.")
    ] = Path("figures"),
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format", metavar="F", help="pdf, svg or png; several by giving it again. pdf, if not given."
        ),
    ] = None,
    films: Films = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Draw the paper's seven figures and write its eight tables for any study, ready for LaTeX.

    The fits are those of `gyrotrack scan`; nothing is kept in the ledger. The figure of the gyroscope needs a film.

    Example: gyrotrack figures case1.h5 case2.h5 -o figures --format pdf --format png
    """
    from fitting.scanning import scan
    from gyrotrack.dataset import read_case
    from gyrotrack.report.paper import write_figures

    wanted = _wanted(formats, output, force=force)
    out = Output(as_json=as_json, quiet=quiet)
    data = read_cases(cases)
    if alone := next((d.record.label for d in data if d.record.single), None):
        raise UsageError(
            f"The paper's figures need a rotor and a casing; {alone} is a record of one body.",
            "`gyrotrack report` draws it.",
        )
    with out.progress("fitting") as progress:
        found = scan(data, progress=progress)
    with out.progress("drawing") as progress:
        progress(0, None)
        files = write_figures(
            output,
            found,
            data,
            [read_case(case) for case in cases],
            formats=wanted,
            films=film_folders(cases, films),
            force=force,
        )
    drawn = {f.stem for f in files if f.suffix.lstrip(".") in wanted}
    out.result({"output": output, "files": files, "figures": len(drawn)})
    out.show(f"written: {len(files)} files in {output}")
    if "gyroscope" not in drawn:
        out.note("no film was found for the figure of the gyroscope; name its folder with --films")
    return DONE if found.converged else NOT_TRUSTED


def _wanted(formats: list[str] | None, output: Path, *, force: bool) -> list[str]:
    """Return the formats asked for, or say what is wrong with them or with the folder."""
    from gyrotrack.report.paper.writing import FORMATS

    wanted = list(dict.fromkeys(formats or FORMATS[:1]))
    unknown = [f for f in wanted if f not in FORMATS]
    if unknown:
        raise UsageError(f"{unknown[0]} is no format of figures.", f"Formats: {', '.join(FORMATS)}.")
    if output.exists() and not output.is_dir():
        raise OutputError(f"{output} is a file.", "Give the name of a folder with -o.")
    if not force and output.is_dir() and any(output.glob("tables.tex")):
        raise OutputError(
            f"{output} holds figures already.", "Use --force to replace them, or -o for another folder."
        )
    return wanted
