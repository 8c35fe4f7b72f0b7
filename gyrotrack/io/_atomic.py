"""Atomic writing: files appear whole or not at all; one writer at a time.

HDF5 ends the process when a write fails under it, or when Python raises an error inside of one. Here no write fails:
the first error of the disk is kept for later, and what follows goes to memory, so that HDF5 comes to its end in peace;
and an interrupt by the user waits until then.

A file is written to ``<name>.part`` in the same folder, flushed to the disk, and renamed over the target. A killed
process, a full disk or an interrupt leaves the old file, or none, and never half a file. HDF5, which cannot survive a
full disk, writes through a `Spool`.
"""

from __future__ import annotations

import errno
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO, RawIOBase
from pathlib import Path
from typing import Any, BinaryIO

import h5py

from gyrotrack._errors import OutputError
from gyrotrack.io._validation import sealed

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


class Spool:
    """A binary file whose writes do not fail.

    Parameters
    ----------
    raw : RawIOBase
        Open for reading and writing, without a buffer.

    Attributes
    ----------
    error : OSError or None
        Why not all is on the disk.
    """

    def __init__(self, raw: RawIOBase) -> None:
        self.error: OSError | None = None
        self._stream: RawIOBase | BytesIO = raw

    def seek(self, place: int, whence: int = 0) -> int:
        """Go to a place."""
        return self._stream.seek(place, whence)

    def tell(self) -> int:
        """Return the place."""
        return self._stream.tell()

    def read(self, size: int = -1) -> bytes:
        """Read on from the place."""
        return self._stream.read(size) or b""

    def write(self, data: Any) -> int:
        """Write at the place."""
        place, left = self._stream.tell(), memoryview(data)
        try:
            while left:
                left = left[self._stream.write(left) or 0 :]
        except OSError as error:
            self._go_on_in_memory(error)
            self._stream.seek(place)
            self._stream.write(data)
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Set the length."""
        try:
            return self._stream.truncate(size)
        except OSError as error:
            self._go_on_in_memory(error)
            return self._stream.truncate(size)

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def _go_on_in_memory(self, error: OSError) -> None:
        self.error = error
        self._stream.seek(0)
        self._stream = BytesIO(self._stream.read() or b"")


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Let an interrupt by the user wait until the end of the block."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    came: list[Any] = []
    signal.signal(signal.SIGINT, lambda *which: came.append(which))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            before(*came[0])


LIBVER = ("v110", "v110")  # metadata carry checksums from this layout on


@contextmanager
def new_hdf5(path: Path, *, force: bool = False) -> Iterator[Any]:
    """Yield an empty HDF5 file, and publish it at `path` when the block ends without an error.

    Raises
    ------
    OutputError
        The target exists and `force` is not set, the folder is missing, or the disk refuses.
    """
    with new_file(path, force=force) as stream:
        spool = Spool(stream.raw)  # type: ignore[attr-defined]
        try:
            with interrupts_wait(), h5py.File(spool, "w", libver=LIBVER) as file:
                yield file
        finally:
            if spool.error is not None:
                raise spool.error
        stream.seek(0)
        seal = sealed(stream)
        stream.write(seal)


@contextmanager
def new_file(path: Path, *, force: bool = False) -> Iterator[BinaryIO]:
    """Yield a binary stream, and publish what was written at `path` when the block ends without an error.

    Raises
    ------
    OutputError
        As for `new_hdf5`.
    """
    path = Path(path)
    refuse_existing(path, force=force)
    part = path.with_name(path.name + ".part")
    try:
        with _open_part(part) as stream:
            lock(stream, part)
            try:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
                refuse_existing(path, force=force)
            except BaseException:
                remove(part, stream)
                raise
            if not is_at(part, stream):
                raise busy(part) if part.exists() else gone(path)
        part.replace(path)
    except OSError as error:
        raise _refusal(path, error) from error
    _sync_folder(path.parent)


def refuse_existing(path: Path, *, force: bool) -> None:
    """Raise `OutputError` if `path` cannot be written: a folder is there, or a file and not `force`."""
    if path.is_dir():
        raise OutputError(f"{path} is a folder.", "Give the name of a file.")
    if not path.parent.is_dir():
        raise OutputError(f"The folder {path.parent} does not exist.", "Create it, or write somewhere else.")
    if not force and (path.exists() or path.is_symlink()):
        raise OutputError(f"{path} exists already.", "Use --force to replace it, or -o for another name.")


def _open_part(part: Path) -> BinaryIO:
    """Open the temporary file, which must be new; one left behind by a killed process is cleared away."""
    try:
        return part.open("x+b")
    except FileExistsError:
        _clear_if_abandoned(part)
        return part.open("x+b")


def _clear_if_abandoned(part: Path) -> None:
    """Remove a temporary file that nobody writes any more; refuse if somebody does."""
    try:
        with part.open("rb") as stream:
            lock(stream, part)
            remove(part, stream)
    except FileNotFoundError:  # published or removed a moment ago
        return
    except PermissionError as error:
        raise busy(part) from error


def _refusal(path: Path, error: OSError) -> OutputError:
    if isinstance(error, FileExistsError):
        return busy(path.with_name(path.name + ".part"))
    return refusal(path, error)


def _sync_folder(folder: Path) -> None:
    """Make the rename itself durable, where the system knows how."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
