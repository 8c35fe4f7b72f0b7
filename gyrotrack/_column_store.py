"""Long columns in an anonymous memory-mapped file, so that memory use does not grow with the length of the film.

The columns are ordinary arrays, but only pages in use occupy memory. `release_pages` releases these pages. On the next
access to a page, the operating system reads it from the file again. Columns of short films are plain arrays. On systems
without support for such files, all columns are plain arrays.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from tempfile import TemporaryFile
from typing import Any, ClassVar, overload
from weakref import WeakSet

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

LEAST_BYTES = 1 << 18  # smallest size of a table that is stored in a file [bytes]
BLOCK_ROWS = 4096  # number of rows of a block; columns are processed in blocks
_BLOCKS_PER_RELEASE = 8  # blocks of rows between two releases of pages; each release takes time
MOST_FILES = 128  # largest number of files; each needs a file handle
_ALIGNMENT = 64
_DONTNEED: int | None = getattr(mmap, "MADV_DONTNEED", None)  # not on Windows
_files: WeakSet[mmap.mmap] = WeakSet()


def new_columns(rows: int, kinds: Mapping[str, tuple[tuple[int, ...], npt.DTypeLike]]) -> dict[str, Array]:
    """Return columns of `rows` undefined values; `kinds` maps the name of a column to the shape and type of a row."""
    places, end = {}, 0
    for name, (shape, kind) in kinds.items():
        places[name] = end
        size = rows * int(np.prod(shape, dtype=np.int64)) * np.dtype(kind).itemsize
        end += -(-size // _ALIGNMENT) * _ALIGNMENT
    file = _mapped(end) if end >= LEAST_BYTES else None
    if file is None:
        return {name: np.empty((rows, *shape), kind) for name, (shape, kind) in kinds.items()}
    return {
        name: np.ndarray((rows, *shape), np.dtype(kind), file, places[name])
        for name, (shape, kind) in kinds.items()
    }


def in_file(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return copies of columns of equal length in a file."""
    rows = len(next(iter(columns.values()))) if columns else 0
    stored = new_columns(rows, {name: (values.shape[1:], values.dtype) for name, values in columns.items()})
    for name, values in columns.items():
        stored[name][...] = values
    release_pages()
    return stored


def row_blocks(rows: int) -> Iterator[slice]:
    """Yield slices of `BLOCK_ROWS` rows that cover all rows; release pages after every `_BLOCKS_PER_RELEASE` slices."""
    for count, start in enumerate(range(0, rows, BLOCK_ROWS), start=1):
        yield slice(start, min(start + BLOCK_ROWS, rows))
        if count % _BLOCKS_PER_RELEASE == 0:
            release_pages()


def release_pages() -> None:
    """Release the memory of all columns; their values remain in the file."""
    for file in list(_files):
        if _DONTNEED is not None:
            file.madvise(_DONTNEED)


def release_memory() -> None:
    """Return freed memory to the system.

    Without this call, glibc retains the memory, and freed frames fragment the heap.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # a libc other than glibc
            ctypes.CDLL(None).malloc_trim(0)


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of <malloc.h>
# Two sizes [bytes]: the smallest freed block that is returned, and the free memory kept at the end of the heap. While
# a film is tracked, both are larger than the temporary arrays of a batch of frames. Afterwards, both are the largest
# values that glibc sets by itself.
_TRACKING, _AFTERWARDS = (1 << 20, 1 << 22), (1 << 25, 1 << 26)


@contextmanager
def large_blocks_returned() -> Iterator[None]:
    """While a film is tracked, let glibc return large blocks to the system as soon as they are freed.

    glibc returns blocks above a threshold size. By default, it raises this threshold to the size of the largest freed
    block, up to 32 MB. Pictures and the buffers of trackers would then fragment the heap. After tracking, the threshold
    is set to 32 MB. With a lower threshold, the system would have to clear each large array of a fit, and the clearing
    takes half as long as the fit.
    """
    _set_thresholds(*_TRACKING)
    try:
        yield
    finally:
        _set_thresholds(*_AFTERWARDS)


def _set_thresholds(block: int, kept: int) -> None:
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # a libc other than glibc
            libc = ctypes.CDLL(None)
            libc.mallopt(_MMAP_THRESHOLD, block)
            libc.mallopt(_TRIM_THRESHOLD, kept)


_LEAST_READ = 8 << 20  # bytes of pictures that are read between two releases of pages


class StoredPictures(Sequence[Array]):
    """Pictures in a file instead of memory: the rows `places` of a column (m, height, width) made by `new_columns`."""

    def __init__(self, pictures: Array, places: Array) -> None:
        self._pictures, self._places = pictures, places
        self._each = max(int(pictures[:1].nbytes), 1)
        self._read = 0

    @classmethod
    def of(cls, count: int, pictures: Iterable[Array]) -> StoredPictures:
        """Store at most `count` pictures of an iterator."""
        stored, number = np.empty((0, 0, 0), np.uint8), 0
        for number, picture in zip(range(1, count + 1), pictures, strict=False):
            if number == 1:
                stored = new_columns(count, {"picture": (picture.shape, picture.dtype)})["picture"]
            stored[number - 1] = picture
            if number * picture.nbytes % _LEAST_READ < picture.nbytes:
                release_pages()
        release_pages()
        return cls(stored, np.arange(number))

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, place: int) -> Array: ...
    @overload
    def __getitem__(self, place: slice) -> StoredPictures: ...
    def __getitem__(self, place: int | slice) -> Array | StoredPictures:
        if isinstance(place, slice):
            return StoredPictures(self._pictures, self._places[place])
        self._read += self._each
        if self._read > _LEAST_READ:
            self._read = 0
            release_pages()
        picture: Array = self._pictures[self._places[place]]
        return picture

    def at(self, places: npt.ArrayLike) -> StoredPictures:
        """Return the pictures with the indices `places`."""
        return StoredPictures(self._pictures, self._places[np.asarray(places, dtype=np.int64)])


class WithBuffer:
    """A tracker with an array for a batch of frames; the array is pickled only if it contains frames."""

    _buffer: ClassVar[str]  # name of the array
    _used = False  # whether it contains frames

    def __getstate__(self) -> dict[str, Any]:
        array = getattr(self, self._buffer)
        return {**vars(self), self._buffer: array if self._used else (array.shape, array.dtype)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if not self._used:
            setattr(self, self._buffer, np.zeros(*state[self._buffer]))


def _mapped(size: int) -> mmap.mmap | None:
    """Return an anonymous memory-mapped file of this size; None if the system has no support or no space for it."""
    if _DONTNEED is None or len(_files) >= MOST_FILES or not hasattr(os, "posix_fallocate"):
        return None
    try:
        with TemporaryFile(prefix="gyrotrack-") as stream:
            # reserve space: otherwise writing to a page on a full disk would end the process (SIGBUS)
            os.posix_fallocate(stream.fileno(), 0, size)
            file = mmap.mmap(stream.fileno(), size)
    except OSError:
        return None
    _files.add(file)
    return file
