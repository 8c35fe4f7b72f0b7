"""Commands report, figures and view."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, NotRequired, TypedDict

import typer

from fitting._workers import WorkerPool
from gyrotrack._errors import OutputError, UsageError
from gyrotrack.apps._study import open_study, read_cases, with_ledgers
from gyrotrack.apps.cli import _settings as shared
from gyrotrack.apps.cli._output import DONE, NOT_TRUSTED, command_line
from gyrotrack.apps.cli._settings import option
from gyrotrack.io._command_end import unmarked


class ReportFiles(TypedDict):
    """The files of a report."""

    output: Path  #: The report.
    overlay: NotRequired[Path]  #: The film, with `--overlay`.


class ReportDocument(ReportFiles):
    """A new report."""

    fits: list[str]  #: Changes of the displayed fits, oldest first; `base` for the first fit.
    verdict: str  #: Verdict of the diagnosis.


class FiguresDocument(TypedDict):
    """New figures and tables."""

    output: Path  #: Folder of the figures and tables.
    files: Sequence[Path]  #: Files of the figures and tables.
    figures: int  #: Number of figures.


class ViewDocument(TypedDict):
    """The workbench; the command prints this line when the page is ready, and keeps running."""

    url: str  #: Address of the page, with its secret.


def report_command(
    cases: shared.CaseFiles,
    *,
    output: Annotated[Path, option("-o --output FILE", "Report to write: .html or .pdf.")] = Path(
        "report.html"
    ),
    films: shared.Films = None,
    overlay: Annotated[
        Path | None,
        option(
            "--overlay OUT.mp4",
            "Also write a slow-motion film of every lack of fit, with the marker at the angle of the model; .webp: an "
            "animated picture of the whole run.",
        ),
    ] = None,
    appendix: Annotated[
        bool, option("--appendix", "Add all tables and figures to the four pages of a PDF.")
    ] = False,
    effects: shared.EffectsFile = None,
    start: shared.From = None,
    ledger: shared.LedgerFile = None,
    force: shared.Force = False,
    out: shared.Out,
) -> None:
    """Write a report of the latest fit and its history: one self-contained HTML file or a PDF of four pages.

    Frames of the films are included if the films are found.

    Example: gyrotrack report case1.h5 -o report.html
    """
    from gyrotrack.apps.report._page import write_overlay, write_report
    from gyrotrack.io._atomic import refuse_existing
    from gyrotrack.io._hdf5 import read_case
    from gyrotrack.plotting._ghost import check_ghost_film

    refuse_existing(output, force=force, reads=with_ledgers(cases, ledger, effects))
    if overlay is not None:
        check_ghost_film(overlay, force=force)
    study = open_study(cases, ledger)
    with WorkerPool() as workers, out.progress("writing the report") as progress:
        progress(0, None)
        steps = study.steps_to(start)
        diagnosis = study.diagnosis(
            start, steps[0].fit, shared.own_effects(effects, study.mechanism), workers=workers
        )
        recordings = [read_case(case) for case in cases]
        where = {"command": command_line(), "ledger": str(study.ledger.path)}
        write_report(
            output,
            steps,
            diagnosis,
            recordings=recordings,
            films=shared.film_folders(cases, films),
            provenance=where,
            certificate=study.certificate(start, diagnosis),
            appendix=appendix,
            force=force,
        )
    written: ReportFiles = {"output": output}
    if overlay is not None:
        written["overlay"] = overlay
        with out.progress("writing the film", "frame") as progress:
            folders = shared.film_folders(cases, films)
            write_overlay(overlay, steps, diagnosis, recordings, folders, force=force, progress=progress)
    document: ReportDocument = {
        **written,
        "fits": [r.change or "base" for r in steps],
        "verdict": diagnosis.verdict,
    }
    out.result(document)
    out.show(*(f"written: {path}" for path in written.values()))


def figures_command(
    cases: shared.CaseFiles,
    *,
    output: Annotated[Path, option("-o --output DIR", "Folder for figures and tables.")] = Path("figures"),
    formats: Annotated[
        list[str] | None, option("--format F", "pdf (default), svg or png; repeatable.")
    ] = None,
    films: shared.Films = None,
    force: shared.Force = False,
    out: shared.Out,
) -> int:
    """Draw the seven figures and write the eight tables of the paper for any study, as files for LaTeX.

    The fits are those of `gyrotrack scan`; the history of fits is not changed. The figure of the gyroscope needs a
    film.

    Example: gyrotrack figures case1.h5 case2.h5 -o figures --format pdf --format png
    """
    from fitting.paper._scan import scan
    from gyrotrack.apps.report._paper import write_figures
    from gyrotrack.io._hdf5 import read_case

    wanted = _wanted(formats, output, force=force)
    data = read_cases(cases)
    if alone := next((d.record.label for d in data if not d.record.joints), None):
        what = f"The paper's figures need a rotor and a casing; {alone} is a recording of one body."
        raise UsageError(what, "Use `gyrotrack report`.")
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
            films=shared.film_folders(cases, films),
            force=force,
        )
    drawn = {f.stem for f in files if f.suffix.lstrip(".") in wanted}
    out.result(FiguresDocument(output=output, files=files, figures=len(drawn)))
    out.show(f"written: {len(files)} files in {output}")
    if "gyroscope" not in drawn:
        out.note("No film was found for the figure of the gyroscope; give its folder with --films.")
    return DONE if found.converged else NOT_TRUSTED


def _wanted(formats: list[str] | None, output: Path, *, force: bool) -> list[str]:
    """Return the requested formats; raise an error if a format is unknown or the folder cannot be used."""
    from gyrotrack.apps.report._paper import FORMATS, MAIN
    from gyrotrack.io._atomic import is_left

    wanted = list(dict.fromkeys(formats or FORMATS[:1]))
    unknown = [f for f in wanted if f not in FORMATS]
    if unknown:
        raise UsageError(f"Unknown figure format: {unknown[0]}.", f"Formats: {', '.join(FORMATS)}.")
    if output.exists() and not output.is_dir():
        raise OutputError(f"{output} is a file.", "Give the name of a folder with -o.")
    if not force and (output / MAIN).exists() and not is_left(output / MAIN):
        what = f"{output} already contains figures."
        raise OutputError(what, "Use --force to replace them, or -o for another folder.")
    return wanted


@unmarked
def view_command(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILM|CASE]...",
            help="A case to analyse; or films, tables, recordings or study.toml of a new project.",
        ),
    ] = None,
    *,
    folder: Annotated[Path, option("--folder DIR", "Work folder, for the results of films.")] = Path(),
    films: shared.Films = None,
    port: Annotated[int, option("--port N", "Port of the page; 0 selects a free one.", min=0, max=65535)] = 0,
    browser: Annotated[
        bool, option("--browser/--no-browser", "Open the page in the browser of the desktop.")
    ] = True,
    window: Annotated[
        bool, option("--window", "Open the page in a separate window (package pywebview).")
    ] = False,
    start: shared.From = None,
    ledger: shared.LedgerFile = None,
    out: shared.Out,
) -> None:
    """Open the workbench in the browser: from films to a case, and from a case to the missing effect.

    Without a case the page starts with films: choose them, mark hub and markers, track, synchronise, fit. Entries and
    results are stored in the work folder; the same command resumes the work there. The page is served on the loopback
    interface, and access needs the secret in the printed address. Ctrl-C or the button Quit ends the program. Each
    folder and each case has one server: a second command opens the page of the first command.

    Example: gyrotrack view case1.h5
    """
    _require_packages(window=window)
    from gyrotrack.apps.workbench._address import Address
    from gyrotrack.apps.workbench._project import Project
    from gyrotrack.apps.workbench._server import Laboratory, Workbench, serve

    case = _only_case(sources or [])

    def announce(url: str, *, is_running: bool = False) -> None:
        if out.as_json:
            sys.stdout.write(json.dumps(ViewDocument(url=url)) + "\n")
        elif is_running:
            out.show(f"already open: {url}")
        else:
            out.show(f"open: {url}", "end: Ctrl-C, or the button Quit")
        sys.stdout.flush()
        displays = os.environ.get("DISPLAY") or os.environ.get(
            "WAYLAND_DISPLAY"
        )  # no browser without a display
        if browser and not window and (displays or sys.platform in {"darwin", "win32"}):
            import webbrowser

            webbrowser.open(url)

    own = Address(folder.resolve() / "workbench" if case is None else (ledger or case).resolve())
    if url := own.running():
        if sources and case is None:
            out.warn("The workbench of this folder is already open; add the files on its page.")
        announce(url, is_running=True)
        return
    if case is not None:
        with out.progress("fitting") as progress:
            progress(0, None)
            laboratory = Laboratory.open(case, shared.film_folders([case], films), ledger, start)
            bench = Workbench(laboratory, address=own)
    else:
        project = Project(folder)
        for note in project.notes:
            out.warn(note)
        for source in sources or []:
            project.add(source)
        bench = Workbench(project=project, address=own)
    try:
        serve(bench, port, announce, window=window)
    except KeyboardInterrupt:  # Ctrl-C quits
        return


def _only_case(sources: Sequence[Path]) -> Path | None:
    """Return the case among the sources, None without a case; a case must be the only source."""
    from gyrotrack.io._hdf5 import read_kind

    cases = [s for s in sources if s.suffix.lower() in (".h5", ".hdf5") and read_kind(s) == "case"]
    if cases and len(sources) > 1:
        raise UsageError("The workbench opens one case at a time.", "Give only the case.")
    return cases[0] if cases else None


def _require_packages(*, window: bool) -> None:
    """Raise an error if the packages that serve the page, or show its window, are not installed."""
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
    except ImportError:
        what = "The workbench needs two packages that are not installed."
        raise UsageError(what, 'Run: pip install "gyrotrack[view]"') from None
    if window and find_spec("webview") is None:
        what = "A separate window needs a package that is not installed."
        raise UsageError(what, 'Run: pip install "gyrotrack[window]", or omit --window.')
