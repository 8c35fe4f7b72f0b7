"""Frames of a file in a format unknown to the decoder, as a stream of raw 8-bit pixels for its demultiplexer."""

from __future__ import annotations

from abc import ABC, abstractmethod


class FrameStream(ABC):
    """Frames of `size` bytes as raw pixels, with the methods of a file; only one frame at a time is in memory."""

    def __init__(self, frames: int, size: int) -> None:
        self._frames, self._size = frames, size
        self._place = 0
        self._number = -1  # number of the frame in memory
        self._frame = b""

    @abstractmethod
    def frame(self, number: int) -> bytes:
        """Return the pixels of a frame."""

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    def read(self, size: int) -> bytes:
        """Return up to `size` bytes of one frame."""
        number, first = divmod(self._place, self._size)
        if number >= self._frames:
            return b""
        if number != self._number:
            self._frame, self._number = self.frame(number), number
        found = self._frame[first : first + size]
        self._place += len(found)
        return found

    def seek(self, offset: int, whence: int = 0) -> int:
        """Move to a byte and return its number."""
        start = (0, self._place, self._frames * self._size)[whence]
        self._place = max(start + offset, 0)
        return self._place

    def tell(self) -> int:
        """Return the number of the next byte."""
        return self._place
