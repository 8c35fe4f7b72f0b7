"""Marks of new outputs of a command. After the command was killed, the same command may replace marked outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from pathlib import Path
from typing import ParamSpec, Protocol, TypeVar


class Mark(Protocol):
    """The mark beside an output."""

    def discard(self) -> None:
        """Remove the mark."""

    def close(self) -> None:
        """Release the lock of the mark."""


_MARKS: ContextVar[dict[Path, Mark] | None] = ContextVar("marks", default=None)


def marks() -> dict[Path, Mark] | None:
    """Return the marks of the running command by absolute path of the output; None outside of a command."""
    return _MARKS.get()


@contextmanager
def marking() -> Iterator[dict[Path, Mark]]:
    """Keep the marks of new outputs until the context ends, or in nested contexts, until the outermost context ends."""
    outer = _MARKS.get()
    if outer is not None:
        yield outer
        return
    own: dict[Path, Mark] = {}
    token = _MARKS.set(own)
    try:
        yield own
    finally:
        _MARKS.reset(token)
        for mark in own.values():
            mark.discard()
            mark.close()


P = ParamSpec("P")
T = TypeVar("T")


def unmarked(command: Callable[P, T]) -> Callable[P, T]:
    """Decorate a command that runs until it is stopped: its outputs are not marked."""

    @wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        token = _MARKS.set(None)
        try:
            return command(*args, **kwargs)
        finally:
            _MARKS.reset(token)

    return run
