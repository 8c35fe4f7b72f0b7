"""Write the tables of docs/how-to/import-data.md from the registry of formats: `python docs/make_import.py`."""

from __future__ import annotations

from pathlib import Path

from gyrotrack.io.readers import _format_names as names

TARGET = Path(__file__).parent / "how-to" / "import-data.md"
BEGIN, END = "<!-- made by docs/make_import.py: begin -->\n", "<!-- made by docs/make_import.py: end -->\n"


def tables() -> str:
    """Return what to add for which data, and the formats with their usual suffixes."""
    parts = ["| you have | command |", "|---|---|", *(f"| {u.what} | {u.how} |" for u in names.USES)]
    parts += ["", "| format | usual suffixes |", "|---|---|", *_suffixes(names.SUFFIXES)]
    parts += [
        "",
        "`profile`, `extract` and `spindown` read films. The header of a Photron camera states the capture rate; its",
        "frames are shown in grey, also those of a Bayer sensor. A TIFF stack states it if ImageJ or an OME program",
        "wrote it; grey values are scaled by the darkest and the brightest one. `spindown` reads interlaced film as",
        "two fields.",
        "",
        *("| film | usual suffixes |", "|---|---|", *_suffixes(names.FILMS)),
    ]
    return "\n".join([*parts, ""])


def _suffixes(formats: dict[str, tuple[str, ...]]) -> list[str]:
    return [
        f"| {name} | {', '.join(f'`{s}`' for s in suffixes) or '-'} |" for name, suffixes in formats.items()
    ]


def page() -> str:
    """Return the page: its text, and the tables between the two marks."""
    head, rest = TARGET.read_text(encoding="utf-8").split(BEGIN)
    return head + BEGIN + tables() + END + rest.split(END)[1]


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
