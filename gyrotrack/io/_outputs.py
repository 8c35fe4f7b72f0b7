"""The outputs of one command. They are checked before the work begins, and either all or none are written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gyrotrack._errors import UsageError
from gyrotrack.io._atomic import refuse_existing
from gyrotrack.io._command_end import marking


@contextmanager
def new_outputs(*outputs: Path | None, force: bool, reads: Iterable[Path | None] = ()) -> Iterator[None]:
    """Check the outputs of a command with `refuse_existing`.

    If the context ends with an error, remove the new outputs.
    """
    paths = [path for path in outputs if path is not None]
    sources = list(reads)
    for k, path in enumerate(paths):
        if path.resolve() in {other.resolve() for other in paths[:k]}:
            raise UsageError(f"{path} is the name of two outputs.", "Give different names.")
    for path in paths:  # check all outputs before the first is written
        refuse_existing(path, force=force, reads=sources)
    with marking() as marks:
        earlier = set(marks)
        try:
            yield
        except BaseException:
            for path in paths:
                if path.absolute() in marks.keys() - earlier:
                    with suppress(OSError):
                        path.unlink()
            raise
