"""Run the commands of docs/tutorial/walkthrough.md and insert their output: `python docs/make_walkthrough.py`.

The words are kept; in each ``console`` block, what follows a line ``$ gyrotrack ...`` is replaced by what the command
prints today, on stdout and stderr. The commands run in a separate folder, beside the sample clips.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

TARGET = Path(__file__).parent / "tutorial" / "walkthrough.md"
CLIPS = Path(__file__).resolve().parents[1] / "sample_clips"


def page(folder: Path) -> str:
    """Return the page with what its commands say now; they run in `folder`."""
    (folder / "sample_clips").symlink_to(CLIPS)
    text = TARGET.read_text(encoding="utf-8")
    return re.sub(r"(?<=^```console\n).*?(?=^```$)", lambda m: _block(m[0], folder), text, flags=re.S | re.M)


def _block(text: str, folder: Path) -> str:
    commands = [line for line in text.splitlines() if line.startswith("$ ")]
    return "\n".join(f"{line}\n{_said(line[2:], folder)}" for line in commands)


def _said(command: str, folder: Path) -> str:
    words = shlex.split(command)[1:]
    done = subprocess.run(  # noqa: S603 - our own program, no shell
        [sys.executable, "-m", "gyrotrack", *words],
        cwd=folder,
        env=os.environ | {"COLUMNS": "80", "NO_COLOR": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=True,
    )
    return "\n".join(line.rstrip() for line in done.stdout.rstrip().splitlines()) + "\n"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        written = page(Path(place))
    TARGET.write_text(written, encoding="utf-8")
