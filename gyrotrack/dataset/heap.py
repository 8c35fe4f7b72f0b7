"""The heaps in which HDF5 keeps texts of varying length, looked through before the library reads them.

Such a collection is a chain: each object says how far away the next one is. HDF5 (2.0, as it comes with h5py)
follows the chain without a doubt, so that an empty piece of free space keeps it in one place for ever. Nothing
that Python could do would interrupt it.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

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
