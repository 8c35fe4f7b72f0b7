"""Atomic writing of text files and locks, for ledgers and saved fits.

A file is written to ``<name>.part`` in the same folder, flushed to the disk, and moved over the target (as in
`gyrotrack.io._atomic`, which this package does not import).
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from fitting._errors import LedgerError

LOCK_TIMEOUT = 10.0
"""Time [s] after which waiting for a lock ends with an error."""


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8) atomically.

    Raises
    ------
    LedgerError
        The path is not a regular file, or the system refuses to write.
    """
    refuse_special(path)
    part = path.with_name(path.name + ".part")
    refuse_special(part)
    try:
        with part.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(path)
    except OSError as fault:
        reason = {errno.ENOSPC: "the disk is full", errno.EFBIG: "the file size limit is reached"}
        raise LedgerError(
            f"{path} cannot be written: {reason.get(fault.errno or 0, fault.strerror)}",
            "free space, or choose another file",
        ) from None
    finally:
        with suppress(OSError):  # on a read-only disk not even that is allowed
            part.unlink(missing_ok=True)


def refuse_special(path: Path) -> None:
    """Raise `LedgerError` if `path` exists and is not a regular file: opening a pipe could block for ever."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return
    if not stat.S_ISREG(mode):
        raise LedgerError(f"{path} is not a regular file", "give the name of a file")


@contextmanager
def locked(path: Path, timeout: float | None = None) -> Iterator[None]:
    """Hold the lock of `path` against other processes while the block runs; the file is not touched.

    Raises
    ------
    LedgerError
        Another program holds the lock for longer than `timeout` [s]. A system without locks is no error.
    """
    timeout = LOCK_TIMEOUT if timeout is None else timeout
    with ExitStack() as stack:
        try:
            stack.enter_context(_lock_of(path).acquire(timeout=timeout, poll_interval=0.02))
        except (Timeout, RuntimeError):
            raise LedgerError(
                f"{path} is locked by another program; waited {timeout:g} s",
                "run the command again when the other program has finished",
            ) from None
        except (OSError, NotImplementedError):
            pass
        yield


def _lock_of(path: Path) -> FileLock:
    """Return the lock of a path, in a folder of the system's temporary one that belongs to this user alone."""
    user = getattr(os, "getuid", lambda: "")()
    folder = Path(tempfile.gettempdir()) / f"gyrotrack-locks-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or (user != "" and found.st_uid != user):
        raise PermissionError(f"{folder} belongs to another user")
    name = os.fsencode(path.parent.resolve() / path.name)
    return FileLock(folder / f"{hashlib.sha256(name).hexdigest()[:32]}.lock", thread_local=False)
