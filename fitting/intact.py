"""What is wrong with a case file as bytes, found before HDF5 reads one: from some files it never returns."""

from __future__ import annotations

import hashlib
from pathlib import Path

from fitting.errors import RecordError

_MARK = b"\ngyrotrack sha256 "
_SEAL = len(_MARK) + 65
_HEAP = b"GCOL\x01\x00\x00\x00"
_HEADER = 16


def check_intact(path: Path) -> None:
    """Refuse a file whose last line, a hash of all before it, is not true, or in whose texts HDF5 would be caught.

    Raises
    ------
    RecordError
        It is damaged.
    """
    content = path.read_bytes()
    seal = content[-_SEAL:]
    told = seal[len(_MARK) : -1] if seal.startswith(_MARK) else None
    if told is not None and told != hashlib.sha256(content[:-_SEAL]).hexdigest().encode():
        raise RecordError(
            f"{path} is damaged: its checksum is not that of its contents", "fetch a fresh copy"
        )
    place = content.find(_HEAP)
    while place >= 0:
        if _is_endless(content, place):
            raise RecordError(f"{path} is damaged: its texts run in circles", "fetch a fresh copy")
        place = content.find(_HEAP, place + 1)


def _is_endless(content: bytes, place: int) -> bool:
    """Tell whether a piece of free space in a heap of texts is empty: HDF5 2.0 then never comes to the next."""
    size = int.from_bytes(content[place + 8 : place + 16], "little")
    at, end = place + _HEADER, min(place + size, len(content))
    while at + _HEADER <= end:
        index, length = (int.from_bytes(content[at + a : at + b], "little") for a, b in ((0, 2), (8, 16)))
        step = length if index == 0 else _HEADER + (length + 7) // 8 * 8
        if step == 0:
            return True
        at += step
    return False
