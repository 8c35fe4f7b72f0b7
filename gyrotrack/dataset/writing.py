"""Publishing a file whole or not at all.

A file is written to ``<name>.part`` in the same folder, flushed to the disk, and renamed over the target. A killed
process, a full disk or an interrupt leaves the old file, or none, and never half a file. HDF5, which cannot survive a
full disk, writes through a `Spool`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import h5py

from gyrotrack.dataset.locking import busy, gone, is_at, lock, refusal, remove
from gyrotrack.dataset.seal import sealed
from gyrotrack.dataset.spool import Spool, interrupts_wait
from gyrotrack.errors import OutputError

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
