"""Atomic writing of output files, and locks.

An output is written to ``<name>.part`` in the same folder, flushed to the disk, and moved over the target. After a
kill, an interrupt, or with a full disk, the old file is unchanged. The lock of a file is in the temporary folder of
the system, so that no lock file remains next to the data.
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
from typing import BinaryIO

from filelock import FileLock, Timeout

from gyrotrack._errors import DatasetError, GyrotrackError, OutputError

LOCK_TIMEOUT = 10.0
"""Longest time to wait for a lock [s]."""


@contextmanager
def locked(path: Path, timeout: float | None = None) -> Iterator[None]:
    """Hold the lock of `path` against other processes within the context.

    Parameters
    ----------
    path : Path
        The file or folder; it need not exist, and is not changed.
    timeout : float
        Longest time to wait [s]; `LOCK_TIMEOUT` by default.

    Raises
    ------
    OutputError
        Another program holds the lock. If the system does not support locks, there is no error.
    """
    timeout = LOCK_TIMEOUT if timeout is None else timeout
    with ExitStack() as stack:
        try:
            stack.enter_context(_lock_of(path).acquire(timeout=timeout, poll_interval=0.02))
        except (Timeout, RuntimeError) as error:
            raise busy(path, timeout) from error
        except (OSError, NotImplementedError):
            pass
        yield


def _lock_of(path: Path) -> FileLock:
    """Return the lock of a path, in a folder of this user in the temporary folder of the system."""
    user = getattr(os, "getuid", lambda: "")()
    folder = Path(tempfile.gettempdir()) / f"gyrotrack-locks-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or (user != "" and found.st_uid != user):
        raise PermissionError(f"{folder} belongs to another user")
    name = os.fsencode(Path(path).parent.resolve() / Path(path).name)
    return FileLock(folder / f"{hashlib.sha256(name).hexdigest()[:32]}.lock", thread_local=False)


def busy(path: Path, waited: float = 0.0) -> OutputError:
    """Return the error for a file that another program has locked."""
    after = f"; waited {waited:g} s" if waited else ""
    return OutputError(
        f"{path} is locked by another program{after}.",
        "Run the command again when the other program has finished, or write to another name.",
    )


def refusal(path: Path, error: OSError) -> OutputError:
    """Return the error for a failed write, with its reason."""
    if error.errno in {errno.ENOSPC, errno.EDQUOT}:
        return OutputError(
            f"{path} cannot be written: the disk is full.", "Free some space, or use another disk."
        )
    if error.errno == errno.EFBIG:
        return OutputError(
            f"{path} cannot be written: the file size limit is reached.", "Raise the limit (ulimit -f)."
        )
    reason = error.strerror or str(error)
    return OutputError(f"{path} cannot be written: {reason}.", "Check the folder and its permissions.")


_SPECIAL = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISDIR, "a folder"),
)


def refuse_special(path: Path, error: type[GyrotrackError] = DatasetError) -> None:
    """Raise `error` if `path` is a pipe, socket, device or folder; opening it could block for ever."""
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return
    what = next((word for test, word in _SPECIAL if test(mode)), None)
    if what is not None:
        raise error(f"{path} is {what}, not a regular file.", "Give the name of a file.")


def refuse_existing(path: Path, *, force: bool) -> None:
    """Raise `OutputError` if `path` is not a regular file, has no folder, or exists and `force` is not set."""
    refuse_special(path, OutputError)
    if not path.parent.is_dir():
        raise OutputError(f"The folder {path.parent} does not exist.", "Create it, or choose another folder.")
    if not force and (path.exists() or path.is_symlink()):
        raise OutputError(f"{path} already exists.", "Use --force to replace it, or -o for another name.")


@contextmanager
def new_path(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield the path of an empty temporary file, and move it to `path` when the context ends without an error.

    Raises
    ------
    OutputError
        The target exists and `force` is not set, its folder does not exist, another program writes the same output,
        or the write fails.
    """
    path = Path(path)
    refuse_existing(path, force=force)
    part = path.with_name(path.name + ".part")
    try:
        with locked(path, 0.0):
            refuse_special(part, OutputError)
            part.unlink(missing_ok=True)  # remains of a killed process
            part.open("xb").close()
            own = part.stat().st_ino
            try:
                yield part
                _publish(part, path, own, force=force)
            except BaseException:
                with suppress(OSError):
                    if part.stat().st_ino == own:
                        part.unlink()
                raise
    except OSError as error:
        raise refusal(path, error) from error


def _publish(part: Path, path: Path, own: int, *, force: bool) -> None:
    try:
        if part.stat().st_ino != own:
            raise busy(path)
    except FileNotFoundError:
        raise OutputError(
            f"{path} cannot be written: its folder or drive was removed.",
            "Reconnect the drive and run the command again.",
        ) from None
    with part.open("rb+") as stream:
        os.fsync(stream.fileno())
    refuse_existing(path, force=force)
    part.replace(path)
    with suppress(OSError):  # makes the rename durable, if supported
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextmanager
def new_file(path: Path, *, force: bool = False) -> Iterator[BinaryIO]:
    """Yield a binary stream, and move its content to `path` when the context ends without an error.

    Raises
    ------
    OutputError
        As for `new_path`.
    """
    with new_path(path, force=force) as part, part.open("r+b") as stream:
        yield stream
