"""The outputs of one command: checked before the work begins, and all written or none.

A command that is killed between two of its outputs has written a list of those that are complete,
``<first output>.outputs.unfinished``; the same command then replaces exactly these files, without ``--force``.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gyrotrack._errors import UsageError
from gyrotrack.io._atomic import CheckpointFile, checkpoint_path, refuse_existing, reported


@contextmanager
def new_outputs(*outputs: Path | None, force: bool, reads: Iterable[Path | None] = ()) -> Iterator[None]:
    """Check the outputs of a command as `refuse_existing`; if the context ends with an error, remove the new ones."""
    paths = [path for path in outputs if path is not None]
    sources = list(reads)
    for k, path in enumerate(paths):
        if path.resolve() in {other.resolve() for other in paths[:k]}:
            raise UsageError(f"{path} is the name of two outputs.", "Give different names.")
    if len(paths) < 2 or not paths[0].parent.is_dir():
        for path in paths:
            refuse_existing(path, force=force, reads=sources)
        yield
        return
    for path in paths:  # before anything is written
        refuse_existing(path, force=force or is_unfinished(paths[0]), reads=sources)
    with CheckpointFile(_listed(paths[0]), {"command": "outputs"}, resume=True) as journal:
        known = [record.facts for record in journal.records()]
        for path in paths:
            with suppress(OSError):
                if _identity(path, path.stat()) in known:
                    path.unlink()
            refuse_existing(path, force=force, reads=sources)
        journal.restart()
        new = [path for path in paths if not path.exists()]

        def report(path: Path, part: os.stat_result) -> None:
            if path in new:
                journal.append(_identity(path, part), {})

        try:
            with reported(report):
                yield
        except BaseException:
            for path in new:
                with suppress(OSError):
                    path.unlink()
            journal.discard()
            raise
        journal.discard()


def is_unfinished(first: Path) -> bool:
    """Whether a command was killed that has this first output."""
    return checkpoint_path(_listed(first)).exists()


def _listed(first: Path) -> Path:
    return first.with_name(f"{first.name}.outputs")


def _identity(path: Path, status: os.stat_result) -> dict[str, object]:
    """Return what distinguishes a file from any other that may have its name later."""
    return {"name": path.name, "ino": status.st_ino, "size": status.st_size, "mtime_ns": status.st_mtime_ns}
