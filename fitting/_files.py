"""Files that survive a kill or a full disk, and the locks of files, for both packages.

An output is written to ``<name>.<random>.part`` in the same folder, flushed to the disk, and moved over the target.
After a kill or an interrupt, or if the disk is full, the old file is unchanged. The lock of a file is ``.<name>.lock``
in the same folder, so that all users and hosts see it. The lock file exists only while the lock is held. The lock file
contains the name of the temporary file. If a writer is killed, the next writer removes this temporary file. Other files
in the folder of an output are opened without following links.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, sleep
from typing import BinaryIO

LOCK_TIMEOUT = 10.0
"""Time after which waiting for a lock ends with an error [s]. Chosen: writing takes milliseconds; a smaller value fails
on slow network disks, a larger one delays the message about a lock that is not released."""
_POLL = 0.02
"""Time between two attempts to get a lock [s]. Chosen: a smaller value causes many disk accesses, a larger one delays
writers that wait."""
LOCK_LINE = b"gyrotrack lock\n"
LOCK_SIZE = 1024
"""Largest number of bytes that are read from a lock file [bytes]. Derived: more than the longest name of a file."""
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}
_SPECIAL = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISDIR, "a folder"),
)


def lock_file(path: Path) -> Path:
    """Return the lock of a file."""
    return path.with_name(f".{path.name}.lock")


def new_part(path: Path) -> Path:
    """Return a name for the temporary file of an output."""
    return path.with_name(f"{path.name}.{secrets.token_hex(4)}.part")


def flush(part: Path) -> None:
    """Write a temporary file to the disk. This may be slow or fail, so it precedes the last checks of the target."""
    with part.open("rb+") as stream:
        os.fsync(stream.fileno())


def publish(part: Path, path: Path) -> None:
    """Move a temporary file over its target, durably."""
    part.replace(path)
    with suppress(OSError):  # makes the rename durable, if supported
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@dataclass(frozen=True)
class Files:
    """Access to files; errors are created by `fail` from a sentence and a hint."""

    fail: Callable[[str, str], Exception]
    elsewhere: str = "Write to another disk."  # hint of the error if the disk has no locks

    @contextmanager
    def locked(self, path: Path, timeout: float = LOCK_TIMEOUT) -> Iterator[Path]:
        """Hold the lock of `path`, which need not exist, against other processes; yield the lock file.

        An error is raised if the lock is not free within `timeout` [s], or if the file system has no locks.
        """
        from filelock import FileLock, Timeout

        own = lock_file(path)
        if not own.parent.is_dir():  # filelock would create the folder
            raise self.refusal(path, FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)))
        remains = self._remains(own, path)
        # other users of the folder must be able to open it
        lock = FileLock(own, mode=0o666, thread_local=False)
        end = monotonic() + timeout
        try:
            while True:
                # a process of another user creates the lock file, and adds the permissions for all users immediately
                # afterwards
                try:
                    lock.acquire(timeout=timeout, poll_interval=_POLL)
                    break
                except PermissionError:
                    if monotonic() > end or not os.access(own.parent, os.W_OK):
                        raise
                    sleep(_POLL)
        except Timeout as error:  # an OSError
            raise self.busy(path, timeout) from error
        except (OSError, NotImplementedError) as error:
            if isinstance(error, OSError) and error.errno not in _NO_LOCKS:
                raise self.refusal(path, error) from error
            what = f"{path} cannot be locked: the file system has no locks."
            raise self.fail(what, self.elsewhere) from error
        except (
            RuntimeError
        ) as error:  # this thread holds the lock already; NotImplementedError is a RuntimeError
            raise self.busy(path, timeout) from error
        try:
            with suppress(OSError):
                for part in remains:
                    part.unlink()
            yield own
        finally:
            # the file is deleted while the lock is held; a waiting process notices this and creates a new lock file
            with suppress(OSError):
                own.unlink()
            lock.release()

    def name_in_lock(self, part: Path, own: Path) -> None:
        """Write the name of a temporary file into a lock that is held; after a kill the next writer removes it."""
        # a failure is ignored: there may be no lock, the disk may be full, and Windows does not write to a locked file
        with suppress(OSError), self.open_side_file(own, os.O_RDWR | os.O_TRUNC) as stream:
            stream.write(LOCK_LINE + os.fsencode(part.name))

    def _remains(self, own: Path, path: Path) -> list[Path]:
        """Return the temporary file of `path` that is named in its lock file, if there is one."""
        try:
            with self.open_side_file(own) as stream:
                content = stream.read(LOCK_SIZE)
        except (FileNotFoundError, PermissionError):
            # another user's lock is not readable for a moment after its creation, and Windows does not read a locked
            # file
            return []
        except OSError as error:
            raise self.refusal(path, error) from error
        name = os.fsdecode(content.removeprefix(LOCK_LINE))
        if content and not content.startswith(LOCK_LINE):
            raise self.foreign(own)
        own_part = re.fullmatch(re.escape(path.name) + r"\.[0-9a-f]{8}\.part", name)
        return [path.with_name(name)] if own_part else []

    def open_side_file(self, path: Path, flags: int = os.O_RDONLY) -> BinaryIO:
        """Open an auxiliary file in the folder of an output; an error is raised if it is a link or has several names.

        `flags` are the flags of `os.open`.
        """
        self.refuse_special(path)
        flags |= getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        try:
            handle = os.open(path, flags, 0o666)
        except OSError as error:
            if path.is_symlink():
                raise self.foreign(path) from error
            raise
        stream = os.fdopen(handle, "rb" if flags & os.O_ACCMODE == os.O_RDONLY else "r+b")
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
            stream.close()
            raise self.foreign(path)
        return stream

    def foreign(self, path: Path) -> Exception:
        """Return the error for a file that has a name of this program but was made by another program or user."""
        return self.fail(f"{path} was not made by gyrotrack.", "Move it away, or write to another name.")

    def busy(self, path: Path, waited: float = 0.0) -> Exception:
        """Return the error for a file that another program has locked."""
        after = f"; waited {waited:g} s" if waited else ""
        return self.fail(
            f"{path} is locked by another program{after}.",
            "Run the command again when the other program has finished, or write to another name.",
        )

    def refusal(self, path: Path, error: OSError) -> Exception:
        """Return the error for a failed write, with its reason."""
        reason, hint = error.strerror or str(error), "Check the folder and its permissions."
        if error.errno in {errno.ENOSPC, errno.EDQUOT}:
            reason, hint = "the disk is full", "Free some space, or use another disk."
        elif error.errno == errno.EFBIG:
            reason, hint = "the file size limit is reached", "Raise the limit (ulimit -f)."
        return self.fail(f"{path} cannot be written: {reason}.", hint)

    def refuse_special(self, path: Path) -> None:
        """Raise an error if `path` is a pipe, socket, device or folder; opening it could block for ever."""
        try:
            mode = path.stat().st_mode
        except (OSError, ValueError):
            return
        what = next((word for test, word in _SPECIAL if test(mode)), None)
        if what is not None:
            raise self.fail(f"{path} is {what}, not a regular file.", "Give the name of a file.")
