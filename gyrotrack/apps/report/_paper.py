"""The figures and tables of the paper as files."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrotrack._errors import OutputError
from gyrotrack.io._atomic import new_file, refuse_existing
from gyrotrack.plotting._paper import PaperFigure, clear_frame, paper_cases, paper_figures
from gyrotrack.plotting._style import style

if TYPE_CHECKING:
    from fitting.inference._case_data import CaseData
    from fitting.study._scan import Scan
    from gyrotrack.io._records import Case


FORMATS = ("pdf", "svg", "png")
_DPI = 300
_TABLE = re.compile(r"\\begin\{table\}.*?\\label\{tab:([^}]*)\}.*?\\end\{table\}\n?", re.DOTALL)
# fonts that printers take, text that can be searched
_PRINT = {"pdf.fonttype": 42, "svg.fonttype": "path"}


def write_figures(
    folder: Path,
    scan: Scan,
    data: Sequence[CaseData],
    cases: Sequence[Case],
    *,
    formats: Sequence[str] = FORMATS[:1],
    films: Sequence[Path] = (),
    force: bool = False,
) -> list[Path]:
    """Write the paper's figures and tables of a study.

    Parameters
    ----------
    folder : Path
        Where to write; it is made if it is not there.
    scan : Scan
        The fits, from `fitting.study._scan`.
    data : sequence of CaseData
        The cases that were scanned.
    cases : sequence of Case
        The same as `gyrotrack.io._hdf5.read_case` gives them.
    formats : sequence of {"pdf", "svg", "png"}
        In which formats each figure is written.
    films : sequence of Path
        Folders where films may lie, for the figure of the gyroscope.
    force : bool
        Replace existing files.

    Returns
    -------
    list of Path
        The files: figures, ``figures.tex`` with their captions, a file a table, and ``tables.tex`` with all.

    Raises
    ------
    OutputError
        A file exists and `force` is not set, or the folder cannot be written.
    """
    documents: dict[str, bytes] = {}
    shown = paper_cases(scan, data, cases)
    with style(_PRINT):
        figures = paper_figures(shown, clear_frame(shown, films))
        for figure in figures:
            documents |= {f"{figure.name}.{kind}": _drawn(figure, kind) for kind in formats}
    documents["figures.tex"] = _figures_tex(figures).encode()
    documents |= {name: text.encode("utf-8") for name, text in _tables(scan).items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"Cannot create the folder {folder}: {error.strerror}.", "Choose another with -o."
        ) from None
    for name in documents:
        refuse_existing(folder / name, force=force)
    for name, document in documents.items():
        with new_file(folder / name, force=force) as stream:
            stream.write(document)
    return [folder / name for name in documents]


def _drawn(figure: PaperFigure, kind: str) -> bytes:
    stream = io.BytesIO()
    known: dict[str, dict[str, Any]] = {
        "pdf": {"CreationDate": None, "Title": figure.name},
        "svg": {"Date": None, "Creator": None},
        "png": {"Software": None},
    }
    metadata: Any = known[kind]
    figure.figure.savefig(stream, format=kind, dpi=_DPI, metadata=metadata)
    return stream.getvalue()


def _figures_tex(figures: Sequence[PaperFigure]) -> str:
    blocks = [
        "\\begin{figure}[htbp]\n  \\centering\n"
        f"  \\includegraphics[width=\\textwidth]{{{f.name}}}\n  \\caption{{{f.caption}}}\n"
        f"  \\label{{fig:{f.name}}}\n\\end{{figure}}\n"
        for f in figures
    ]
    return "% made by gyrotrack figures; needs graphicx\n" + "\n".join(blocks)


def _tables(scan: Scan) -> dict[str, str]:
    """Return all tables in one file, and each in a file of its own."""
    from fitting.study._scan_tables import scan_latex

    whole = scan_latex(scan)
    head = whole[: whole.index("\\begin{table}")]
    each: dict[str, str] = {}
    for m in _TABLE.finditer(whole):
        name = re.sub(r"[^A-Za-z0-9-]+", "-", m[1]).strip("-") or "table"
        each[f"table-{len(each) + 1}-{name}.tex"] = head + m[0]
    return {"tables.tex": whole, **each}
