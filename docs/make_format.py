"""Write the tables of docs/reference/format.md from the layout that the program writes: `python docs/make_format.py`."""

from __future__ import annotations

from pathlib import Path

from gyrotrack.io import _schema as layout
from gyrotrack.io._records import STATUS

TARGET = Path(__file__).parent / "reference" / "format.md"
BEGIN, END = "<!-- made by docs/make_format.py: begin -->\n", "<!-- made by docs/make_format.py: end -->\n"

_GROUPS = (
    ("`/frame`: the clip, frame by frame", layout.FRAME),
    ("`/marker/<name>`: one marker", layout.MARKER),
    ("`/body/<name>`: casing or rotor, from all its markers", layout.BODY),
    ("`/casing` of a case", layout.SERIES),
    ("`/rotor` of a case: all windows together", layout.WINDOWED),
    ("`/rotor_generated` of a case, only if one was asked for", layout.GENERATED),
)


def tables() -> str:
    """Return the part of the page that lists every dataset."""
    parts = [f"Layout version {layout.FORMAT_VERSION}.\n"]
    for title, table in _GROUPS:
        parts += [
            f"### {title}\n",
            "| dataset | dimensions | type | units | meaning |",
            "|---|---|---|---|---|",
        ]
        parts += [
            f"| {f.name} | {', '.join(f.dims)} | {f.dtype} | {f.units} | {f.long_name} |"
            for f in table.fields
        ]
        parts.append("")
    parts.append("### Values of `status`\n")
    parts += ["| value | meaning |", "|---|---|", *(f"| {v} | {k} |" for k, v in STATUS.items()), ""]
    parts.append("### Attributes of a recording\n")
    parts += ["| attribute | units |", "|---|---|"]
    parts += [f"| {a} | {layout.ATTRIBUTE_UNITS.get(a, '-')} |" for a in layout.RECORDING_ATTRIBUTES]
    parts.append("")
    return "\n".join(parts)


def page() -> str:
    """Return the page as it should be: its own words, and the tables between the two marks."""
    head, rest = TARGET.read_text(encoding="utf-8").split(BEGIN)
    return head + BEGIN + tables() + END + rest.split(END)[1]


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
