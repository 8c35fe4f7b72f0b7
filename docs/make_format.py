"""Write the tables of docs/reference/format.md from the HDF5 schema: `python docs/make_format.py`."""

from __future__ import annotations

from pathlib import Path

from fitting import _case_format as layout
from gyrotrack.io import _schema as schema

TARGET = Path(__file__).parent / "reference" / "format.md"
BEGIN, END = "<!-- made by docs/make_format.py: begin -->\n", "<!-- made by docs/make_format.py: end -->\n"


def tables() -> str:
    """Return the part of the page that lists every dataset."""
    parts = [f"Layout version {layout.FORMAT_VERSION}.\n"]
    for title, table in schema.GROUPS:
        parts += [
            f"### {title}\n",
            "| dataset | dimensions | type | units | meaning |",
            "|---|---|---|---|---|",
        ]
        parts += [
            f"| {f.name} | {', '.join(f.dims)} | {f.dtype} | {f.units} | {f.long_name} |"
            for f in table.fields
        ]
        if table.attributes:
            parts += [
                "",
                "| attribute | type | units | meaning |",
                "|---|---|---|---|",
                *_attributes(table.attributes),
            ]
        parts.append("")
    parts += ["### Values of `status`\n", "| value | meaning |", "|---|---|"]
    parts += [*(f"| {v} | {k} |" for k, v in schema.STATUS.items()), ""]
    for title, attributes in schema.ATTRIBUTES:
        parts += [f"### {title}\n", "| attribute | type | units | meaning |", "|---|---|---|---|"]
        parts += [*_attributes(attributes), ""]
    return "\n".join(parts)


def _attributes(attributes: tuple[layout.Attribute, ...]) -> list[str]:
    return [f"| {a.name} | {a.kind.__name__} | {a.units or '-'} | {a.long_name} |" for a in attributes]


def page() -> str:
    """Return the page: its text, and the tables between the two marks."""
    head, rest = TARGET.read_text(encoding="utf-8").split(BEGIN)
    return head + BEGIN + tables() + END + rest.split(END)[1]


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
