"""Output of the commands: results to stdout, messages to stderr.

With ``--json`` stdout contains one JSON document and nothing else, also if the command fails. Progress bars are drawn
only if stderr is a terminal and none of ``--json``, ``-q`` and NO_COLOR is set.
"""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console


# C0 and C1 controls except line feed and tab; characters that reorder or hide text; line separators
_COMMANDS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028\u2029\u202a-\u202e\u2060-\u2069\ufeff]"
)


def printable(text: str) -> str:
    r"""Return `text` with control and direction characters escaped, for example as ``\x1b``.

    Examples
    --------
    >>> printable("a\x1b[31mb")
    'a\\x1b[31mb'
    """
    return _COMMANDS.sub(lambda found: ascii(found[0])[1:-1], text.encode("utf-8", "replace").decode())


_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("arguments", default=())


@contextmanager
def running(arguments: Sequence[str]) -> Iterator[None]:
    """Store the arguments of the command that runs within the context."""
    token = _ARGUMENTS.set(tuple(arguments))
    try:
        yield
    finally:
        _ARGUMENTS.reset(token)


def command_line() -> str:
    """Return the command line, quoted for a shell."""
    return shlex.join(["gyrotrack", *_ARGUMENTS.get()])


DONE = 0
FAULT = 1
USAGE = 2
NOT_TRUSTED = 3
INTERRUPTED = 130
TERMINATED = 143

Progress = Callable[[int, int | None], None]


@dataclass(frozen=True)
class Output:
    """Output of one command, controlled by ``--json``, ``-q`` and ``-v``."""

    as_json: bool = False
    quiet: bool = False
    verbose: bool = False

    def result(self, document: Mapping[str, Any]) -> None:
        """Print the result as JSON; without ``--json`` nothing is printed (see `show`)."""
        if self.as_json:
            print_json(document)

    def show(self, *renderables: Any) -> None:
        """Print the result as text or renderables of rich; with ``--json`` nothing is printed."""
        if not self.as_json:
            console = _console(sys.stdout)
            for item in renderables:
                console.print(printable(item) if isinstance(item, str) else item)

    def note(self, text: str) -> None:
        """Print a progress message."""
        if not self.quiet:
            _write(text)

    def detail(self, text: str) -> None:
        """Print a message with ``-v`` only."""
        if self.verbose and not self.quiet:
            _write(text)

    def warn(self, text: str) -> None:
        """Print a warning; also with ``-q``."""
        _write(f"warning: {text}", style="yellow")

    @contextmanager
    def progress(self, label: str, unit: str = "") -> Iterator[Progress]:
        """Yield a callback (done, total) that draws a progress bar, or does nothing without a terminal.

        With a `unit` the bar also shows the rate. With ``GYROTRACK_PROGRESS=json`` in the environment the progress is
        written to stderr as JSON lines ``{"progress": {"label", "done", "total"}}``, at most five a second.
        """
        if os.environ.get("GYROTRACK_PROGRESS") == "json":
            yield _json_lines(label)
            return
        if self.as_json or self.quiet or not _interactive():
            yield _ignore
            return
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        left = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        right = (TextColumn("{task.fields[rate]}"), TimeRemainingColumn())
        with Bars(*left, *right, console=_console(sys.stderr), transient=True) as bars:
            task = bars.add_task(label, total=None, rate="")

            def update(done: int, total: int | None) -> None:
                speed = bars.tasks[0].speed
                rate = f"{speed:.0f} {unit}/s" if unit and speed else ""
                bars.update(task, completed=done, total=total, rate=rate)

            yield update


@contextmanager
def all_or_nothing(*outputs: Path | None) -> Iterator[None]:
    """Remove new outputs if the context ends with an error, so that either all are written or none."""
    new = [path for path in outputs if path is not None and not path.exists()]
    try:
        yield
    except BaseException:
        for path in new:
            with suppress(OSError):
                path.unlink()
        raise


def _json_lines(label: str) -> Progress:
    """Return a callback that writes progress as JSON lines."""
    latest = -math.inf

    def update(done: int, total: int | None) -> None:
        nonlocal latest
        now = monotonic()
        if now - latest >= _INTERVAL or done == total:
            latest = now
            line = {"progress": {"label": label, "done": done, "total": total}}
            sys.stderr.write(json.dumps(line) + "\n")
            sys.stderr.flush()

    return update


_INTERVAL = 0.2  # s


def _ignore(done: int, total: int | None) -> None:
    del done, total


def _interactive() -> bool:
    return sys.stderr.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def _console(stream: Any) -> Console:
    from rich.console import Console

    return Console(file=stream, highlight=False, markup=False, emoji=False, soft_wrap=not stream.isatty())


def _write(text: str, style: str | None = None) -> None:
    text = printable(text)
    if _interactive():
        _console(sys.stderr).print(text, style=style)
    else:
        sys.stderr.write(text + "\n")


def print_json(document: Any) -> None:
    """Write one JSON document to stdout; NaN and infinities become null."""
    from pydantic_core import to_jsonable_python

    plain = to_jsonable_python(document, inf_nan_mode="null", fallback=lambda value: value.tolist())
    json.dump(plain, sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")


def report_error(code: str, message: str, hint: str, *, as_json: bool) -> None:
    """Print an error: message and hint, or a JSON document."""
    if as_json:
        print_json({"error": {"code": code, "message": message, "hint": hint}})
        return
    _write(f"error: {message}", style="red")
    if hint:
        _write(f" hint: {hint}")
