"""A file that HDF5 can write to piece by piece, though it cannot survive a write that fails.

HDF5 ends the process when a write fails under it, or when Python raises an error inside of one. Here no write fails:
the first error of the disk is kept for later, and what follows goes to memory, so that HDF5 comes to its end in peace;
and an interrupt by the user waits until then.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, RawIOBase
from typing import Any


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
