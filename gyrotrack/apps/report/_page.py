"""The report as one HTML file or PDF."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting._numbers import nonbreaking
from gyrotrack._errors import OutputError
from gyrotrack.apps.report._frames import Tile
from gyrotrack.apps.report._parts import report_parts
from gyrotrack.io._atomic import new_file, refusal, refuse_existing
from gyrotrack.plotting import _charts as charts
from gyrotrack.plotting._study_data import gather
from gyrotrack.plotting._style import Picture, themed

if TYPE_CHECKING:
    from fitting.discovery._select import Step
    from fitting.discovery._verdict import Diagnosis
    from gyrotrack.io._records import Case


def pdf(parts: Mapping[str, Any]) -> bytes:
    """Return the report as a PDF file.

    Parameters
    ----------
    parts : mapping
        As `report_parts` returns them. All text reaches Typst as data and is never read as markup.

    Raises
    ------
    OutputError
        If the package `typst` is not installed, or it fails.
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
        document = images.plain({k: v for k, v in parts.items() if k != "view"})
        view = parts["view"]
        document |= {
            "improved": view.improved,
            "body": view.body,
            "cases": len(view.cases),
            "surfaces": [[v.label, v.surface] for v in view.cases if v.surface],
            "next_experiment": view.next_experiment,
        }
        # bytes of file names that are not UTF-8 become question marks
        text = json.dumps(document, ensure_ascii=False).encode("utf-8", "replace")
        (folder / "report.json").write_bytes(text)
        (folder / "report.typ").write_bytes(
            resources.files("gyrotrack.apps.report").joinpath("report.typ").read_bytes()
        )
        try:
            return bytes(typst.compile(folder / "report.typ", root=folder))
        except typst.TypstError as error:
            raise OutputError(
                f"Typst cannot set the PDF: {str(error).splitlines()[0]}.",
                "Write .html instead, and print that.",
            ) from error


class _Images:
    """Writes pictures into a folder and puts the names of their files into the document."""

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
            # charts are for the browser alone
            value = {k: getattr(value, k) for k in value.__dataclass_fields__ if k != "dashboard"}
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
    history: Sequence[Step],
    diagnosis: Diagnosis | None,
    *,
    recordings: Sequence[Case] = (),
    films: Sequence[Path] = (),
    provenance: Mapping[str, str] | None = None,
    force: bool = False,
) -> Path:
    """Write the report of a history of fits.

    Parameters
    ----------
    path : Path
        The file to write, ``.pdf`` or else HTML; it is written whole or not at all.
    history : sequence of Step
        The history of fits, base first; one is enough.
    diagnosis : Diagnosis or None
        That of the base.
    recordings : sequence of Case
        The cases as `gyrotrack.io._hdf5.read_case` returns them, for clips and tracking.
    films : sequence of Path
        Folders that may contain the films of the recordings; frames of those found are shown.
    provenance : mapping of str to str, optional
        Further lines of provenance, such as ``command`` and ``date``.
    force : bool
        Replace an existing file.

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
    is_pdf = path.suffix.lower() == ".pdf"
    parts = report_parts(gather(history, diagnosis), recordings, films, provenance or {}, static=is_pdf)
    # names of files may contain bytes that are not valid UTF-8
    try:
        document = pdf(parts) if is_pdf else html(parts).encode("utf-8", "replace")
    except OSError as error:  # the parts of a PDF are written to the temporary folder first
        raise refusal(Path(tempfile.gettempdir()), error) from error
    with new_file(path, force=force) as stream:
        stream.write(document)
    return path


def html(parts: Mapping[str, Any]) -> str:
    """Return the report as one HTML page without any reference to a network."""
    from jinja2 import Environment, StrictUndefined

    folder = resources.files("gyrotrack.apps.report")
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: nonbreaking(value) if type(value) is str else value,  # never markup
    )
    environment.filters["themed"] = themed
    template = environment.from_string(folder.joinpath("page.html.jinja").read_text("utf-8"))
    scripts = (*charts.scripts(), folder.joinpath("page.js").read_text("utf-8"))
    return template.render(
        **parts,
        style=charts.theme() + folder.joinpath("page.css").read_text("utf-8") + charts.style(),
        scripts=scripts,
        policy=charts.content_policy(scripts),
        data=charts.as_data([charts.dashboard_document(s.dashboard) for s in parts["sections"]]),
    )
