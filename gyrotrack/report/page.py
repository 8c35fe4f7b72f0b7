"""The report as one file that needs nothing else: no network, no script but its own, every name escaped."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting.beside import Beside
from fitting.typesetting import unbroken
from gyrotrack.dataset.writing import new_file, refuse_existing
from gyrotrack.report.content import gather
from gyrotrack.report.parts import report_parts

if TYPE_CHECKING:
    from fitting.discovery import Diagnosis, Rung
    from gyrotrack.dataset import Case


def write_report(
    path: Path,
    rungs: Sequence[Rung],
    diagnosis: Diagnosis | None,
    *,
    recordings: Sequence[Case] = (),
    films: Sequence[Path] = (),
    provenance: Mapping[str, str] | None = None,
    force: bool = False,
    beside: Beside | None = None,
) -> Path:
    """Write the report of a ladder of fits.

    Parameters
    ----------
    path : Path
        The file to write, ``.pdf`` or else HTML; it appears whole or not at all.
    rungs : sequence of Rung
        The ladder, base first; one rung is enough.
    diagnosis : Diagnosis or None
        That of the first rung.
    recordings : sequence of Case
        The cases as `gyrotrack.dataset.read_case` gives them, for the tracking behind the fits.
    films : sequence of Path
        Folders where the films of the recordings may lie; frames of those found are shown.
    provenance : mapping of str to str, optional
        More lines on where this comes from, such as ``command`` and ``date``.
    force : bool
        Replace an existing file.
    beside : Beside, optional
        A second process for some of the figures; without it all are drawn in this one.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    OutputError
        The file exists and `force` is not set, or it cannot be written.
    """
    path = Path(path)
    refuse_existing(path, force=force)
    with _seldom_collected():
        parts = report_parts(
            gather(rungs, diagnosis), recordings, films, provenance or {}, beside or Beside(cores=1)
        )
    if path.suffix.lower() == ".pdf":
        from gyrotrack.report.pdf import pdf

        document = pdf(parts)
    else:
        # names of files may hold bytes that are no text
        document = render(parts).encode("utf-8", "replace")
    with new_file(path, force=force) as stream:
        stream.write(document)
    return path


@contextmanager
def _seldom_collected() -> Iterator[None]:
    # drawing makes millions of small objects, and the search for cycles among them took a sixth of its time
    usual = gc.get_threshold()
    gc.set_threshold(50_000, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)


def render(parts: Mapping[str, Any]) -> str:
    """Return the page."""
    from jinja2 import Environment, StrictUndefined

    from gyrotrack import charts

    folder = resources.files("gyrotrack.report")
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: unbroken(value) if type(value) is str else value,  # never what is markup
    )
    template = environment.from_string(folder.joinpath("page.html.jinja").read_text("utf-8"))
    scripts = (charts.script(), folder.joinpath("page.js").read_text("utf-8"))
    return template.render(
        **parts,
        style=folder.joinpath("page.css").read_text("utf-8") + charts.style(),
        scripts=scripts,
        policy=charts.content_policy(scripts),
        data=charts.as_data([charts.board_document(b) for b in parts["boards"]]),
    )
