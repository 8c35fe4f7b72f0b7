"""`gyrotrack view`: the workbench in the browser, on this machine only."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from gyrotrack.cli.options import CaseFile, Films, Json, Quiet, film_folders
from gyrotrack.cli.output import Output
from gyrotrack.cli.study import From, LedgerFile
from gyrotrack.errors import UsageError
from gyrotrack.study import open_study


def command(
    case: CaseFile,
    *,
    films: Films = None,
    port: Annotated[
        int,
        typer.Option("--port", metavar="N", min=0, max=65535, help="Port of the page; 0 takes a free one."),
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser of this desktop.")
    ] = True,
    start: From = None,
    ledger: LedgerFile = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Look at a case in the browser: frames with overlay, residuals, ranking; add and drop effects and see.

    The page is served on this machine's own address, to nobody but the holder of the address that is printed. It
    ends with Ctrl-C or with the button Quit. Fits are kept in the ledger when the page is told to.

    Example: gyrotrack view case1.h5
    """
    _look_for_packages()
    from gyrotrack.dataset import read_case
    from gyrotrack.view import Workbench, serve
    from gyrotrack.view.films import Clips
    from gyrotrack.view.ranking import Ranker
    from gyrotrack.view.session import Session

    out = Output(as_json=as_json, quiet=quiet)
    tracked = read_case(case)
    study = open_study([case], ledger)
    with out.progress("fitting") as progress:
        progress(0, None)
        base, fit_id = study.base(start)
    session = Session(study.data[0], base, fit_id, study.ledger, tracked)
    bench = Workbench(session, Clips(tracked, film_folders([case], films)), Ranker(case))

    def announce(url: str) -> None:
        if as_json:
            sys.stdout.write(json.dumps({"url": url}) + "\n")
        else:
            out.show(f"open: {url}", "end: Ctrl-C, or the button Quit")
        sys.stdout.flush()
        if browser and _has_desktop():
            import webbrowser

            webbrowser.open(url)

    try:
        serve(bench, port, announce)
    except KeyboardInterrupt:  # the way to end it
        return


def _has_desktop() -> bool:
    """Tell whether there is a desktop whose browser may be opened; a browser in the terminal is not meant."""
    import os

    return sys.platform in {"darwin", "win32"} or any(
        os.environ.get(n) for n in ("DISPLAY", "WAYLAND_DISPLAY")
    )


def _look_for_packages() -> None:
    """Say so if what the page is served with is not installed."""
    try:
        import starlette  # noqa: F401 - is it there?
        import uvicorn  # noqa: F401
    except ImportError:
        raise UsageError(
            "The workbench needs two packages that are not installed.", 'Run: pip install "gyrotrack[view]"'
        ) from None
