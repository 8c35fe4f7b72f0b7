"""Writing HDF5 safely.

HDF5 ends the process when a write fails inside it, or when Python raises an error inside one. Here no write fails: the
first error of the disk is kept, later writes go to memory until the library has closed the file, and an interrupt by
the user is deferred until then. Every file ends with a checksum line (see `_validation`).
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, RawIOBase
from pathlib import Path
from typing import Any

import h5py

from gyrotrack.io._atomic import new_file
from gyrotrack.io._validation import checksum_line


class WriteBuffer:
    """A binary file whose writes do not fail: after the first error of the disk the data go to memory.

    Parameters
    ----------
    raw : RawIOBase
        Open for reading and writing, without a buffer.

    Attributes
    ----------
    error : OSError or None
        First error of the disk.
    """

    def __init__(self, raw: RawIOBase) -> None:
        self.error: OSError | None = None
        self._stream: RawIOBase | BytesIO = raw

    def seek(self, position: int, whence: int = 0) -> int:
        """Set the position."""
        return self._stream.seek(position, whence)

    def tell(self) -> int:
        """Return the position."""
        return self._stream.tell()

    def read(self, size: int = -1) -> bytes:
        """Read from the position."""
        return self._stream.read(size) or b""

    def write(self, data: Any) -> int:
        """Write at the position."""
        start, rest = self._stream.tell(), memoryview(data)
        try:
            while rest:
                rest = rest[self._stream.write(rest) or 0 :]
        except OSError as error:
            self._continue_in_memory(error)
            self._stream.seek(start)
            self._stream.write(data)
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Set the length."""
        try:
            return self._stream.truncate(size)
        except OSError as error:
            self._continue_in_memory(error)
            return self._stream.truncate(size)

    def flush(self) -> None:
        """Do nothing: the stream is unbuffered."""

    def _continue_in_memory(self, error: OSError) -> None:
        self.error = error
        self._stream.seek(0)
        self._stream = BytesIO(self._stream.read() or b"")


@contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Defer an interrupt by the user (SIGINT) to the end of the block."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    received: list[Any] = []
    signal.signal(signal.SIGINT, lambda *which: received.append(which))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if received:
            before(*received[0])


LIBVER = ("v110", "v110")  # metadata carry checksums from this layout on


@contextmanager
def new_hdf5(path: Path, *, force: bool = False) -> Iterator[Any]:
    """Yield an empty HDF5 file, and publish it at `path` when the block ends without an error.

    Raises
    ------
    OutputError
        As for `_atomic.new_path`.
    """
    with new_file(path, force=force) as stream:
        buffer = WriteBuffer(stream.raw)  # type: ignore[attr-defined]
        try:
            with deferred_interrupts(), h5py.File(buffer, "w", libver=LIBVER) as file:
                yield file
        finally:
            if buffer.error is not None:
                raise buffer.error
        stream.seek(0)
        line = checksum_line(stream)
        stream.write(line)
