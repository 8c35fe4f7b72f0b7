"""What is refused in an HDF5 file before anything of it is read.

A file can lead a reader elsewhere: by external and soft links, by datasets whose bytes lie in other files
(external storage, virtual datasets), by filters that load plugins; and it can claim terabytes in a few bytes. The
whole tree is walked, link by link, without following any that is not a plain one.

Such a collection is a chain: each object says how far away the next one is. HDF5 (2.0, as it comes with h5py)
follows the chain without a doubt, so that an empty piece of free space keeps it in one place for ever. Nothing
that Python could do would interrupt it.

HDF5 keeps checksums of data and of most metadata, but not of the heap with texts of varying length, and a byte
flipped there can send the library round in circles for ever. Every file written here therefore ends with a line
that holds the SHA-256 of all before it; HDF5 does not look beyond its own end. A file that another program has
changed has lost the line, or is told to be damaged.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from gyrotrack._errors import DatasetError

MOST_MEMBERS = 20_000
DEEPEST = 32
MAX_BYTES = 2**31
MAX_INFLATION = 1100  # deflate cannot do better than 1032 : 1
SLACK = 2**22  # bytes that a small dataset may claim beyond that (chunks are padded)
KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}


def guarded(file: Any) -> None:
    """Walk a whole file and refuse it if anything in it leads out of it or claims more than it holds.

    Raises
    ------
    DatasetError
        Naming the place.
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
        if depth > DEEPEST:
            raise DatasetError(f"{place(group)} lies too deep.", "The file is damaged or forged.")
        for name in group:
            count += 1
            if count > MOST_MEMBERS:
                raise DatasetError(f"{file.filename} has too many members.", "The file is damaged or forged.")
            member = own_member(group, name)
            if isinstance(member, h5py.Group):
                todo.append((member, depth + 1))
            elif isinstance(member, h5py.Dataset):
                check_bytes(member)


def own_member(group: Any, name: str) -> Any:
    """Return a direct member of `group`, refusing links that lead out of the file or to another name."""
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise DatasetError(
            f"{place(group)} holds '{name}' as a link to somewhere else.", "Such links are not followed."
        )
    return group[name]


def check_bytes(dataset: Any) -> None:
    """Refuse a dataset whose bytes lie in another file, are packed in an unknown way, or cannot be so many.

    Raises
    ------
    DatasetError
        Naming the place.
    """
    if dataset.is_virtual or dataset.external:
        raise DatasetError(f"{place(dataset)} takes its numbers from another file.", "That is not followed.")
    plist = dataset.id.get_create_plist()
    filters = {plist.get_filter(i)[0] for i in range(plist.get_nfilters())}
    if not filters <= KNOWN_FILTERS:
        raise DatasetError(
            f"{place(dataset)} is packed in an unknown way.", "Write it with gzip or unpacked."
        )
    if dataset.shape is None:
        return
    claimed = int(np.prod([int(n) for n in dataset.shape], dtype=object)) * dataset.dtype.itemsize
    stored = int(dataset.id.get_storage_size())
    chunk = int(np.prod(dataset.chunks or (0,), dtype=object)) * dataset.dtype.itemsize
    if claimed > MAX_BYTES or max(claimed, chunk) > stored * MAX_INFLATION + SLACK:
        raise DatasetError(
            f"{place(dataset)} claims {claimed:,} bytes but holds {stored:,}.",
            "The file is damaged or forged.",
        )


def place(item: Any) -> str:
    """Name the file and the place in it, for a message."""
    return f"{item.file.filename}:{item.name}"


_MARK = b"GCOL\x01\x00\x00\x00"
_HEADER = 16
_BLOCK = 2**20


def has_endless_heap(path: Path) -> bool:
    """Tell whether reading a text from a file of HDF5 could take for ever."""
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


def sealed(stream: BinaryIO) -> bytes:
    """Return the line that follows in a file what is left of `stream`."""
    return _line(stream, None)


def is_broken(path: Path) -> bool:
    """Tell whether a file ends with a seal that is not that of its contents; without a seal it is not broken."""
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        if size < LENGTH:
            return False
        stream.seek(size - LENGTH)
        seal = stream.read(LENGTH)
        if not seal.startswith(MARK):
            return False
        stream.seek(0)
        return seal != _line(stream, size - LENGTH)


def _line(stream: BinaryIO, left: int | None) -> bytes:
    """Return the seal of the next `left` bytes, or of all to the end."""
    digest = hashlib.sha256()
    while left != 0 and (block := stream.read(_BLOCK if left is None else min(_BLOCK, left))):
        digest.update(block)
        left = None if left is None else left - len(block)
    return MARK + digest.hexdigest().encode() + b"\n"
