"""The report as a PDF: the same parts as the page, set by Typst, which needs no browser."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from dataclasses import is_dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from fitting.typesetting import unbroken
from gyrotrack.errors import OutputError
from gyrotrack.report.figures import Picture
from gyrotrack.report.frames import Tile


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
            resources.files("gyrotrack.report").joinpath("report.typ").read_bytes()
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
        return unbroken(value) if isinstance(value, str) else value

    def _write(self, suffix: str, data: bytes) -> str:
        self._count += 1
        name = f"{self._count}{suffix}"
        (self._folder / name).write_bytes(data)
        return name
