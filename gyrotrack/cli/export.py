"""`gyrotrack export`: data for other programs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gyrotrack.cli.options import Force, Json, OutputFile, Quiet
from gyrotrack.cli.output import Output


class Table(StrEnum):
    """What to export."""

    motion = "motion"
    markers = "markers"
    frames = "frames"


def command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A case or a recording.")],
    *,
    output: OutputFile,
    table: Annotated[
        Table,
        typer.Option(
            "--table", help="Angles of the bodies, or every marker or frame of the films (CSV, Parquet)."
        ),
    ] = Table.motion,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Hand the data on as CSV, Parquet or netCDF, by the suffix of the output.

    Example: gyrotrack export case1.h5 -o case1.csv
    """
    from gyrotrack.exporting import export_file

    out = Output(as_json=as_json, quiet=quiet)
    with out.progress(f"writing {output.name}") as progress:
        progress(0, None)
        document = export_file(file, output, table=table.value, force=force)
    out.result({"output": output, **document})
    held = f"{document['rows']} rows" if "rows" in document else f"{len(document['groups'])} groups"
    out.show(f"{held}; written: {output}")
