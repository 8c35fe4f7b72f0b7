"""Write docs/reference/command-line.md from the commands' own help: `python docs/make_command_line.py`."""

from __future__ import annotations

import os
from pathlib import Path
from unittest import mock

from typer.main import get_command

from gyrotrack.apps.cli._app import COMMANDS, app
from gyrotrack.apps.cli._settings import load

TARGET = Path(__file__).parent / "reference" / "command-line.md"

_HEAD = """# Command line

This page is made from the help of the commands themselves by `docs/make_command_line.py`; a test compares the two.

Results go to stdout, progress and messages to stderr. With `--json`, stdout carries a single JSON document, which for
an error is `{"error": {"code", "message", "hint"}}`. Exit codes: 0 done; 1 invalid input or data; 2 wrong
usage; 3 completed, but the result is not to be trusted; 130 interrupted by Ctrl-C, 129 by SIGHUP, 143 by SIGTERM.
`--debug`, anywhere, shows the traceback of a bug.
"""


def page() -> str:
    """Return the page as it should be."""
    with mock.patch.dict(os.environ, {"COLUMNS": "80", "NO_COLOR": "1"}):
        parts = [_HEAD, _help("gyrotrack", "gyrotrack", get_command(app))]
        section = ""
        for entry in COMMANDS:
            if entry.section != section:
                section = entry.section
                parts.append(f"## {section}\n")
            parts.append(_help(f"`{entry.name}`", f"gyrotrack {entry.name}", load(entry)))
    return "\n".join(parts)


def _help(title: str, name: str, command: object) -> str:
    context = command.make_context(name, [], resilient_parsing=True)  # type: ignore[attr-defined]
    text = "\n".join(line.rstrip() for line in context.get_help().strip().splitlines())
    level = "##" if title == "gyrotrack" else "###"
    return f"{level} {title}\n\n```text\n{text}\n```\n"


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
