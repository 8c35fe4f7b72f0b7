"""`gyrotrack compare`: differences between runs, and the spread of parameters over repeats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrotrack._errors import UsageError
from gyrotrack.apps.cli._options import Force, Json, Quiet
from gyrotrack.apps.cli._output import Output

if TYPE_CHECKING:
    from fitting.study._comparison import Comparison


def compare_command(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="A B...", help="Cases (.h5) that have been fitted, or ledgers (.fits.json)."),
    ],
    *,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="FILE", help="Draw the result: .png, .svg or .pdf.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare the latest fits of runs: which parameters and effects differ, and by how many standard uncertainties.

    Of three runs and more, each parameter has a mean and a spread between the runs (random effects). Runs are taken
    as independent.

    Example: gyrotrack compare left.h5 right.h5 --picture difference.png
    """
    from fitting.study._comparison import compare
    from gyrotrack.apps._study import latest_fits
    from gyrotrack.io._atomic import refuse_existing

    out = Output(as_json=as_json, quiet=quiet)
    if len(runs) < 2:
        raise UsageError("A comparison needs two runs at least.", "Name two cases that have been fitted.")
    if picture is not None:
        if picture.suffix.lower() not in {".png", ".svg", ".pdf"}:
            raise UsageError(
                f"{picture} is not the name of a picture.", "Use a name that ends in .png, .svg or .pdf."
            )
        refuse_existing(picture, force=force)
    found = compare(latest_fits(runs))
    if picture is not None:
        from gyrotrack.plotting._comparison import write_comparison_picture

        write_comparison_picture(found, picture, force=force)
    out.result(found.document())
    out.show(_table(found))
    if picture is not None:
        out.show(f"written: {picture}")


def _table(found: Comparison) -> str:
    from fitting._numbers import probability, rounded

    lines = []
    for p in found.parameters:
        size = f", {p.difference_sigma:+.1f} sigma" if p.difference_sigma is not None else ""
        lines.append(f"{p.name}  (p {probability(p.p_value)}{size})")
        width = max(len(r.run) for r in p.repeats)
        lines += [f"  {r.run:<{width}}  {rounded(r.value, r.stderr, p.unit)}" for r in p.repeats]
        spread = f"spread {p.spread:.2g} ({p.spread_interval[0]:.2g} to {p.spread_interval[1]:.2g}) {p.unit}"
        lines.append(f"  {'mean':<{width}}  {rounded(p.mean, p.mean_u, p.unit)}, {spread}")
    return "\n".join([*lines, *([""] if lines else []), *found.sentences])
