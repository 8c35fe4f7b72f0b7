"""A hash of the whole file behind its end, compared before HDF5 looks at a byte.

HDF5 keeps checksums of data and of most metadata, but not of the heap with texts of varying length, and a byte
flipped there can send the library round in circles for ever. Every file written here therefore ends with a line
that holds the SHA-256 of all before it; HDF5 does not look beyond its own end. A file that another program has
changed has lost the line, or is told to be damaged.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import BinaryIO

MARK = b"\ngyrotrack sha256 "
LENGTH = len(MARK) + 65
_BLOCK = 2**20


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
