"""Command compare: fits of two runs and more, and the population of many runs of one machine."""

from __future__ import annotations

import csv
import math
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import closing
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fitting._numbers import probability, rounded
from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.apps._study import FitRequest, latest_fits, open_study, with_ledgers
from gyrotrack.apps.batch._workers import Workers
from gyrotrack.apps.cli import _settings as shared
from gyrotrack.apps.cli._discovery import check_picture, drawn
from gyrotrack.apps.cli._output import DONE, NOT_TRUSTED
from gyrotrack.apps.cli._settings import option

if TYPE_CHECKING:
    from fitting.comparison._comparison import Comparison
    from fitting.comparison._population import Population

# largest number of runs whose values are listed; number of runs that a cluster worker fits in one command
_LISTED, _PART = 12, 8
_SECONDS_PER_DAY = 86400.0
_TIME = re.compile(r"time(?:\s*[\[(]\s*(?P<unit>[^\])]+?)\s*[\])])?", re.IGNORECASE)
Progress = Callable[[int, "int | None"], None]


def compare_command(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN...", help="Cases (.h5), ledgers of fits (.fits.json), or folders of cases."
        ),
    ],
    *,
    model: Annotated[
        str | None,
        option(
            "--model M",
            "Fit this model to every run that has no such fit: reduced, general, linear, or a TOML file.",
        ),
    ] = None,
    add: Annotated[list[str] | None, option("--add E", "Effect to add to the model.")] = None,
    run_times: Annotated[
        Path | None,
        option(
            "--run-times FILE",
            "Table (CSV) with the columns run and time ('time [h]', or dates); by default runs are numbered in order.",
        ),
    ] = None,
    workers: Annotated[
        int | None, option("--workers N", "Processes that fit runs; by default one per core.", min=1)
    ] = None,
    cluster: shared.OfCluster,
    picture: shared.Picture = None,
    force: shared.Force = False,
    out: shared.Out,
) -> int:
    """Compare fits of several runs: differences, spread, and with many runs drifts, steps and outlying runs.

    Each parameter has a mean and a spread between the runs (random effects); the total uncertainty of a single run
    includes the spread. With eight or more runs, the command also names outlying runs, and parameters that drift or
    step with the time of the run. The false-alarm probability is 0.01 for all parameters and times together. Without
    --model the latest fit of each run is used. With --model, runs are fitted in parallel, and each fit is kept next to
    its case, so that an interrupted command continues. The runs are assumed to be independent.

    Example: gyrotrack compare left.h5 right.h5 --picture difference.png
    """
    from fitting.comparison._comparison import compare

    files = _files(runs)
    if len(files) < 2:
        raise UsageError("A comparison needs at least two runs.", "Give two cases that have been fitted.")
    if add and model is None:
        raise UsageError("--add needs --model.", "Name the model to which the effect is added.")
    check_picture(picture, force=force, reads=[*with_ledgers(files), run_times])
    at = None if run_times is None else _read_times(run_times)
    wanted: tuple[str, ...] | None = None
    failed: dict[str, str] = {}
    if model is not None:
        request = FitRequest(model=model, add=tuple(add or ()))
        wanted = _model_names(files[0], request)
        missing = [f for f in files if not _fitted(f, wanted)]
        if missing:
            place = cluster.workers(files[0].resolve().parent, workers)
            words = ["--model", model, *(w for e in add or () for w in ("--add", e))]
            with closing(place), out.progress("fitting runs") as progress:
                failed = _fit(missing, words, place, 1 if cluster.scheduler is None else _PART, progress)
        files = [f for f in files if str(f) not in failed]
        if len(files) < 2:
            first = next(iter(failed.items()), ("", ""))
            raise DatasetError(f"{len(failed)} runs could not be fitted; {first[0]}: {first[1]}", "")
    fits = latest_fits(files, wanted)
    unit = "run"
    times: Mapping[str, float] | None = None
    if at is not None:
        times, unit = _times_of(fits, at[0]), at[1]
    found = compare(fits, times, time_unit=unit, body=_single_body(files))
    written = drawn(found, picture, force=force)
    out.result(found.document(failed))
    out.show(comparison_table(found), *(f"not fitted: {n}: {why}" for n, why in failed.items()), *written)
    return NOT_TRUSTED if failed else DONE


def _files(runs: Sequence[Path]) -> list[Path]:
    """Return the files of the runs.

    The cases of a folder are in the order of the numbers in the names of the cases.
    """
    files: list[Path] = []
    for run in runs:
        if not run.is_dir():
            files.append(run)
            continue
        cases = sorted(run.glob("*.h5"), key=_by_numbers)
        if not cases:
            raise DatasetError(f"The folder {run} has no case (.h5).", "Make cases with `gyrotrack import`.")
        files += cases
    return files


def _single_body(files: Sequence[Path]) -> str:
    """Return the name of the body in the first case; "" if all files are ledgers."""
    from fitting.inference._case_file import read_record

    first = next((f for f in files if f.suffix == ".h5" and f.is_file()), None)
    return "" if first is None else read_record(first).body


def _by_numbers(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts run9 before run10."""
    return [(int(x), "") if x.isdecimal() else (-1, x) for x in re.split(r"(\d+)", path.name)]


def _model_names(case: Path, request: FitRequest) -> tuple[str, ...]:
    """Return the names of the effects in the requested model, for the bodies of this case."""
    if case.suffix != ".h5":
        raise UsageError(f"{case} cannot be fitted.", "With --model, give cases (.h5) or folders of cases.")
    return tuple(sorted(request.model_for(open_study([case], None)).names))


def _fitted(case: Path, wanted: tuple[str, ...]) -> bool:
    try:
        latest_fits([case], wanted)
    except DatasetError:
        if case.is_file():
            return False
        raise
    return True


def _fit(
    cases: Sequence[Path], words: Sequence[str], place: Workers, size: int, progress: Progress
) -> dict[str, str]:
    """Fit a model to each case; return the error messages of failed cases.

    Every fit is stored in the ledger of its case when it is complete. If one of several cases in a command fails,
    these cases are fitted again one by one.
    """
    failed: dict[str, str] = {}
    parts = [list(cases[i : i + size]) for i in range(0, len(cases), size)]

    def begin(part: Sequence[Path]) -> Any:
        return place.submit(["fit", *(str(c.resolve()) for c in part), *words, "--json", "--quiet"], None)

    running = {begin(part): part for part in parts}
    done = 0
    progress(0, len(cases))
    while running:
        ended, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in ended:
            part, document = running.pop(future), future.result()["document"]
            if "error" in document and len(part) > 1:
                running |= {begin([case]): [case] for case in part}
                continue
            if "error" in document:
                failed[str(part[0])] = str(document["error"]["message"])
            done += len(part)
            progress(done, len(cases))
    return failed


def _read_times(path: Path) -> tuple[dict[str, float], str]:
    """Read times of runs, and their unit, from a table with the columns run and time."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            rows = [(reader.line_num, [c.strip() for c in row]) for row in reader if any(row)]
    except (OSError, UnicodeDecodeError, csv.Error) as fault:
        raise DatasetError(
            f"{path} cannot be read: {getattr(fault, 'strerror', None) or fault}.", ""
        ) from None
    head = rows[0][1] if rows else []
    names = [h.lower() for h in head]
    column = next((i for i, h in enumerate(head) if _TIME.fullmatch(h)), None)
    if "run" not in names or column is None:
        raise DatasetError(
            f"{path} has no columns run and time.", "Its first line is for example: run,time [h]"
        )
    place, found = names.index("run"), {}
    dates = False
    for line, row in rows[1:]:
        if len(row) <= max(place, column):
            raise DatasetError(f"{path}, line {line}: a value is missing.", "")
        text = row[column]
        try:
            found[row[place]] = float(text)
        except ValueError:
            try:
                found[row[place]] = datetime.fromisoformat(text).timestamp() / _SECONDS_PER_DAY
            except ValueError:
                what = f"{path}, line {line}: {text[:30]!r} is neither a number nor a date."
                raise DatasetError(what, "Write, for example, 3.5 or 2024-05-17T14:30.") from None
            dates = True
        if not math.isfinite(found[row[place]]):
            raise DatasetError(f"{path}, line {line}: the time is not finite.", "")
    unit = _TIME.fullmatch(head[column])
    return found, "day" if dates else (unit["unit"] if unit and unit["unit"] else "unit of time")


def _times_of(fits: Mapping[str, Any], times: Mapping[str, float]) -> dict[str, float]:
    """Return the times of runs; the table may name runs with or without folder and suffix."""
    short = {Path(name).name.removesuffix(".h5"): value for name, value in times.items()}
    found = {run: times.get(run, short.get(Path(run).name)) for run in fits}
    missing = [run for run, value in found.items() if value is None]
    if missing:
        raise DatasetError(f"The table of times has no run {missing[0]}.", "Add a line for each run.")
    return {run: value for run, value in found.items() if value is not None}


def comparison_table(found: Comparison) -> str:
    """Return a comparison as text: every run if there are few runs, otherwise the population."""
    runs = {r.run for p in found.parameters for r in p.repeats}
    if found.population is not None and len(runs) > _LISTED:
        return "\n".join([*_population_lines(found.population), "", *found.sentences])
    lines = []
    for p in found.parameters:
        size = f", {p.difference_sigma:+.1f} sigma" if p.difference_sigma is not None else ""
        heading = f"{found.called(p.name)}: p {probability(p.p_value)}{size}"
        lines += textwrap.wrap(heading, 79, subsequent_indent="  ")
        width = max(len(name) for name in ("mean", *(r.run for r in p.repeats)))
        for r in p.repeats:
            total = f" (with the spread +- {p.total(r):.2g})" if p.spread > 0 else ""
            lines.append(f"  {r.run:<{width}}  {rounded(r.value, r.stderr, p.unit)}{total}")
        spread = f"spread {p.spread:.2g} ({p.spread_interval[0]:.2g} to {p.spread_interval[1]:.2g}) {p.unit}"
        lines.append(f"  {'mean':<{width}}  {rounded(p.mean, p.mean_u, p.unit)}, {spread}")
    return "\n".join([*lines, *([""] if lines else []), *found.sentences])


def _population_lines(found: Population) -> list[str]:
    lines = [f"{len(found.runs)} runs"]
    for p in found.parameters:
        mean, spread = rounded(p.mean, p.mean_u, p.unit), rounded(p.spread, p.spread_u, p.unit)
        drift, step, adjusted = map(probability, (p.p_drift, p.p_step, p.p_adjusted))
        lines += [
            *textwrap.wrap(found.called(p.name), 79, initial_indent="  ", subsequent_indent="    "),
            f"    mean {mean}, spread {spread}, {p.runs} runs",
            f"    p of a drift {drift}, of a step {step}; smaller one adjusted {adjusted}",
        ]
    return lines
