"""Long columns in an unnamed memory-mapped file, so that memory does not grow with the film.

A film's quantities have as many values as it has frames. Kept here they are arrays like any other, but only those
that are being worked on lie in memory: `set_down` gives back what was touched, and it comes from the file when it is
touched again. Columns of short films, and all where the system has no such files, are plain arrays.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator, Mapping
from tempfile import TemporaryFile
from typing import Any
from weakref import WeakSet

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

LEAST_BYTES = 1 << 18
"""Size of a table from which it is worth a file."""
STRETCH = 4096
"""Rows that are worked on at a time."""
_TOGETHER = 8
"""Stretches after which columns are set down: the system takes its time for it."""
MOST_FILES = 128
"""Files at a time: each takes a handle, of which a process may have some hundred."""
_ALIGNED = 64
_LEAVE: int | None = getattr(mmap, "MADV_DONTNEED", None)  # not on Windows
_files: WeakSet[mmap.mmap] = WeakSet()


def new_columns(rows: int, kinds: Mapping[str, tuple[tuple[int, ...], npt.DTypeLike]]) -> dict[str, Array]:
    """Return columns of undefined values.

    Parameters
    ----------
    rows : int
        Length of all of them.
    kinds : mapping
        Shape of one row and type, by name.
    """
    places, end = {}, 0
    for name, (shape, kind) in kinds.items():
        places[name] = end
        size = rows * int(np.prod(shape, dtype=np.int64)) * np.dtype(kind).itemsize
        end += -(-size // _ALIGNED) * _ALIGNED
    file = _mapped(end) if end >= LEAST_BYTES else None
    if file is None:
        return {name: np.empty((rows, *shape), kind) for name, (shape, kind) in kinds.items()}
    return {
        name: np.ndarray((rows, *shape), np.dtype(kind), file, places[name])
        for name, (shape, kind) in kinds.items()
    }


def put_away(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the same columns, kept out of the way; all have the same length."""
    rows = len(next(iter(columns.values()))) if columns else 0
    kept = new_columns(rows, {name: (values.shape[1:], values.dtype) for name, values in columns.items()})
    for name, values in columns.items():
        kept[name][...] = values
    set_down()
    return kept


def stretches(rows: int) -> Iterator[slice]:
    """Yield slices of some thousand rows that cover all, and set down now and then what was touched meanwhile."""
    for count, start in enumerate(range(0, rows, STRETCH), start=1):
        yield slice(start, min(start + STRETCH, rows))
        if count % _TOGETHER == 0:
            set_down()


def set_down() -> None:
    """Give the memory back in which columns lie for the moment; their values stay."""
    for file in list(_files):
        if _LEAVE is not None:
            file.madvise(_LEAVE)


def _mapped(size: int) -> mmap.mmap | None:
    """Return an unnamed file of this size in memory; None if the system does not give one, or has no room."""
    if _LEAVE is None or len(_files) >= MOST_FILES or not hasattr(os, "posix_fallocate"):
        return None
    try:
        with TemporaryFile(prefix="gyrotrack-") as stream:
            os.posix_fallocate(
                stream.fileno(), 0, size
            )  # a page without room behind it would end the process
            file = mmap.mmap(stream.fileno(), size)
    except OSError:
        return None
    _files.add(file)
    return file
