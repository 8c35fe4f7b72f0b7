"""The report as one HTML file or PDF."""

from __future__ import annotations

import gc
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import is_dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting._numbers import nonbreaking
from fitting._workers import WorkerPool
from gyrotrack._errors import OutputError
from gyrotrack.apps.report._frames import Tile
from gyrotrack.apps.report._parts import report_parts
from gyrotrack.io._atomic import new_file, refusal, refuse_existing
from gyrotrack.plotting._study_data import gather
from gyrotrack.plotting._style import Picture

if TYPE_CHECKING:
    from fitting.discovery._select import Step
    from fitting.discovery._verdict import Diagnosis
    from gyrotrack.io._records import Case


def pdf(parts: Mapping[str, Any]) -> bytes:
    """Return the report as a PDF file.

    Parameters
    ----------
    parts : mapping
        As `parts.report_parts` returns them. All text reaches Typst as data and is never read as markup.

    Raises
    ------
    OutputError
        If the package `typst` is not installed, or it cannot set the report.
    """
    try:
        import typst
    except ImportError:
        raise OutputError(
            "A PDF needs the package typst, which is not installed.",
            "Run: pip install typst; or write .html and print that from a browser.",
        ) from None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        images = _Images(folder)
        document = images.plain({k: v for k, v in parts.items() if k not in {"content", "boards"}})
        content = parts["content"]
        document |= {
            "improved": content.improved,
            "body": content.body,
            "cases": len(content.cases),
            "surfaces": [[v.label, v.surface] for v in content.cases if v.surface],
            "next_experiment": content.next_experiment,
        }
        # what is no text (a name of a file may hold such bytes) becomes a question mark
        text = json.dumps(document, ensure_ascii=False).encode("utf-8", "replace")
        (folder / "report.json").write_bytes(text)
        (folder / "report.typ").write_bytes(
            resources.files("gyrotrack.apps.report").joinpath("report.typ").read_bytes()
        )
        try:
            return bytes(typst.compile(folder / "report.typ", root=folder))
        except typst.TypstError as error:
            raise OutputError(
                f"The PDF could not be set: {str(error).splitlines()[0]}.",
                "Write .html instead, and print that.",
            ) from error


class _Images:
    """Writes pictures into a folder and leaves their names in the document."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._count = 0

    def plain(self, value: Any) -> Any:
        """Return a value as JSON can hold it."""
        if isinstance(value, Picture):
            return {
                "file": self._write(".svg", value.svg.encode("utf-8", "replace")),
                "caption": value.caption,
                "finding": value.finding,
            }
        if isinstance(value, Tile):
            return {"file": self._write(".jpg", value.jpeg), "text": value.text}
        if is_dataclass(value) and not isinstance(value, type):
            # one level: what lies inside is looked at in its turn
            value = {k: getattr(value, k) for k in value.__dataclass_fields__}
        if isinstance(value, Mapping):
            found = {str(k): self.plain(v) for k, v in value.items()}
            if isinstance(value.get("svg"), str):
                found["svg"] = self._write(".svg", value["svg"].encode("utf-8")) if value["svg"] else ""
            return found
        if isinstance(value, list | tuple):
            return [self.plain(v) for v in value]
        return nonbreaking(value) if isinstance(value, str) else value

    def _write(self, suffix: str, data: bytes) -> str:
        self._count += 1
        name = f"{self._count}{suffix}"
        (self._folder / name).write_bytes(data)
        return name


def write_report(
    path: Path,
    rungs: Sequence[Step],
    diagnosis: Diagnosis | None,
    *,
    recordings: Sequence[Case] = (),
    films: Sequence[Path] = (),
    provenance: Mapping[str, str] | None = None,
    force: bool = False,
    workers: WorkerPool | None = None,
) -> Path:
    """Write the report of a ladder of fits.

    Parameters
    ----------
    path : Path
        The file to write, ``.pdf`` or else HTML; it appears whole or not at all.
    rungs : sequence of Step
        The ladder, base first; one rung is enough.
    diagnosis : Diagnosis or None
        That of the first rung.
    recordings : sequence of Case
        The cases as `gyrotrack.io._hdf5.read_case` gives them, for the tracking behind the fits.
    films : sequence of Path
        Folders where the films of the recordings may lie; frames of those found are shown.
    provenance : mapping of str to str, optional
        More lines on where this comes from, such as ``command`` and ``date``.
    force : bool
        Replace an existing file.
    workers : WorkerPool, optional
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
            gather(rungs, diagnosis), recordings, films, provenance or {}, workers or WorkerPool(0)
        )
    # names of files may hold bytes that are not valid UTF-8
    try:
        document = pdf(parts) if path.suffix.lower() == ".pdf" else render(parts).encode("utf-8", "replace")
    except OSError as error:  # the parts of a PDF are written to the temporary folder first
        raise refusal(Path(tempfile.gettempdir()), error) from error
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

    from gyrotrack.plotting import _interactive as charts

    folder = resources.files("gyrotrack.apps.report")
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: nonbreaking(value) if type(value) is str else value,  # never what is markup
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
