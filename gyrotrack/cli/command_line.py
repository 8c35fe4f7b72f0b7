"""The command line as the user typed it, for the files' record of where they come from."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("arguments", default=())


@contextmanager
def running(arguments: Sequence[str]) -> Iterator[None]:
    """Remember the arguments of the command that runs inside the block."""
    token = _ARGUMENTS.set(tuple(arguments))
    try:
        yield
    finally:
        _ARGUMENTS.reset(token)


def command_line() -> str:
    """Return the command line in a form that a shell reads back."""
    return shlex.join(["gyrotrack", *_ARGUMENTS.get()])
