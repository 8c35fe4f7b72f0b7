"""The command line as the user typed it, for the files' record of where they come from."""

from __future__ import annotations

import shlex
import sys


def command_line() -> str:
    """Return the command line in a form that a shell reads back."""
    return shlex.join(["gyrotrack", *sys.argv[1:]])
