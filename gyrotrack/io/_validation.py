"""Validation of HDF5 files before they are read.

External and soft links, external storage, virtual datasets, filters that load plugins, and sizes beyond the stored
bytes are rejected; the whole tree is checked without following links.

The string heap (global heap collections, ``GCOL``) is a sequence of objects with their lengths; HDF5 2.0 never returns
from an empty object of free space, and Python cannot interrupt it. HDF5 has checksums of data and most metadata but not
of this heap. Every file therefore ends with a line with the SHA-256 of all bytes before it, which HDF5 ignores. A file
that was changed by another program has no such line, or fails the check.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from gyrotrack._errors import DatasetError

MAX_MEMBERS = 20_000
MAX_DEPTH = 32
MAX_BYTES = 2**31
MAX_INFLATION = 1100  # the largest compression ratio of deflate is 1032
SLACK = 2**22  # additional bytes of small datasets, because chunks are padded
KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}


def check_tree(file: Any) -> None:
    """Check a file for links, external storage and sizes beyond the stored bytes.

    Raises
    ------
    DatasetError
        The check fails; the message contains the path in the file.
    """
    seen: set[Any] = set()
    todo: list[tuple[Any, int]] = [(file, 0)]
    count = 0
    while todo:
        group, depth = todo.pop()
        address = h5py.h5o.get_info(group.id).addr
        if address in seen:
            continue
        seen.add(address)
        if depth > MAX_DEPTH:
            raise DatasetError(
                f"{location(group)} is nested too deeply.", "The file is damaged or malicious."
            )
        for name in group:
            count += 1
            if count > MAX_MEMBERS:
                raise DatasetError(
                    f"{file.filename} has too many members.", "The file is damaged or malicious."
                )
            member = own_member(group, name)
            if isinstance(member, h5py.Group):
                todo.append((member, depth + 1))
            elif isinstance(member, h5py.Dataset):
                check_bytes(member)


def own_member(group: Any, name: str) -> Any:
    """Return a direct member of `group`; raise an error if it is a link."""
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise DatasetError(
            f"{location(group)} has a link, '{name}'.",
            "Links are not followed; copy the data into the file.",
        )
    return group[name]


def check_bytes(dataset: Any) -> None:
    """Raise an error for a dataset with external storage, an unknown filter, or a size beyond its stored bytes.

    Raises
    ------
    DatasetError
        The check fails; the message contains the path in the file.
    """
    if dataset.is_virtual or dataset.external:
        raise DatasetError(
            f"{location(dataset)} stores its data in another file.", "Copy the data into the file."
        )
    plist = dataset.id.get_create_plist()
    filters = {plist.get_filter(i)[0] for i in range(plist.get_nfilters())}
    if not filters <= KNOWN_FILTERS:
        raise DatasetError(
            f"{location(dataset)} uses an unknown compression filter.", "Write it with gzip or uncompressed."
        )
    if dataset.shape is None:
        return
    claimed = int(np.prod([int(n) for n in dataset.shape], dtype=object)) * dataset.dtype.itemsize
    stored = int(dataset.id.get_storage_size())
    chunk = int(np.prod(dataset.chunks or (0,), dtype=object)) * dataset.dtype.itemsize
    if claimed > MAX_BYTES or max(claimed, chunk) > stored * MAX_INFLATION + SLACK:
        raise DatasetError(
            f"{location(dataset)} declares {claimed:,} bytes but contains {stored:,}.",
            "The file is damaged or malicious.",
        )


def location(item: Any) -> str:
    """Return file name and path in the file, for messages."""
    return f"{item.file.filename}:{item.name}"


_MARK = b"GCOL\x01\x00\x00\x00"
_HEADER = 16
_BLOCK = 2**20


def has_endless_heap(path: Path) -> bool:
    """Return whether the string heap of an HDF5 file is corrupt, so that reading it would not end."""
    with path.open("rb") as stream:
        return any(_is_endless(stream, place) for place in _collections(stream))


def _collections(stream: BinaryIO) -> list[int]:
    places, start, tail = [], 0, b""
    while block := stream.read(_BLOCK):
        held = tail + block
        place = held.find(_MARK)
        while place >= 0:
            places.append(start - len(tail) + place)
            place = held.find(_MARK, place + 1)
        start += len(block)
        tail = held[1 - len(_MARK) :]
    return places


def _is_endless(stream: BinaryIO, place: int) -> bool:
    size = _number(stream, place + len(_MARK), 8)
    at, end = place + _HEADER, min(place + size, stream.seek(0, 2))
    while at + _HEADER <= end:
        index, length = _number(stream, at, 2), _number(stream, at + 8, 8)
        step = length if index == 0 else _HEADER + (length + 7) // 8 * 8
        if step == 0:
            return True
        at += step
    return False


def _number(stream: BinaryIO, place: int, size: int) -> int:
    stream.seek(place)
    return int.from_bytes(stream.read(size), "little")


MARK = b"\ngyrotrack sha256 "
LENGTH = len(MARK) + 65


def checksum_line(stream: BinaryIO) -> bytes:
    """Return the checksum line for the rest of `stream`."""
    return _line(stream, None)


def checksum_fails(path: Path) -> bool:
    """Return whether a file ends with a checksum line that does not match; False without such a line."""
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        if size < LENGTH:
            return False
        stream.seek(size - LENGTH)
        line = stream.read(LENGTH)
        if not line.startswith(MARK):
            return False
        stream.seek(0)
        return line != _line(stream, size - LENGTH)


def _line(stream: BinaryIO, left: int | None) -> bytes:
    """Return the checksum line for the next `left` bytes, or for all bytes to the end."""
    digest = hashlib.sha256()
    while left != 0 and (block := stream.read(_BLOCK if left is None else min(_BLOCK, left))):
        digest.update(block)
        left = None if left is None else left - len(block)
    return MARK + digest.hexdigest().encode() + b"\n"
