"""One writer at a time: locks on the temporary files that stand beside an output."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from gyrotrack.errors import OutputError

try:
    import fcntl
except ImportError:  # Windows: an open file cannot be removed there, which serves the same purpose
    fcntl = None  # type: ignore[assignment]


def lock(stream: BinaryIO, path: Path) -> None:
    """Lock an open file for this process alone.

    Raises
    ------
    OutputError
        Another process holds the lock. A file system without locks is no error.
    """
    if fcntl is not None:
        try:
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise busy(path) from error
        except OSError:  # a file system without locks
            return


def is_at(path: Path, stream: BinaryIO) -> bool:
    """Tell whether `path` still names the file behind `stream`."""
    try:
        return path.stat().st_ino == os.fstat(stream.fileno()).st_ino
    except FileNotFoundError:
        return False


def remove(path: Path, stream: BinaryIO) -> None:
    """Remove `path` if it is the file behind `stream`, not another process's that took its place."""
    with suppress(OSError):
        if is_at(path, stream):
            path.unlink()


def busy(path: Path) -> OutputError:
    """Return the error for a file that another process writes."""
    return OutputError(
        f"{path} is being written by another process.", "Wait until it is done, or write to another name."
    )


def gone(path: Path) -> OutputError:
    """Return the error for an output whose folder, or the drive that it is on, is no longer there."""
    return OutputError(
        f"{path} cannot be written: what was written has gone, and its folder or drive with it.",
        "Is the drive still there? Nothing else was touched; run it again.",
    )


def refusal(path: Path, error: OSError) -> OutputError:
    """Return, in one sentence, why the system does not let `path` be written."""
    if error.errno in {errno.ENOSPC, errno.EDQUOT}:
        return OutputError(
            f"{path} cannot be written: the disk is full.", "Make room, or write somewhere else."
        )
    reason = error.strerror or str(error)
    return OutputError(f"{path} cannot be written: {reason}.", "Check the folder and its permissions.")
