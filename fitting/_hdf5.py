"""Validation of HDF5 files before they are read, for both packages.

A file is refused if it has external or soft links, external storage, virtual datasets, filters that load plugins, or
datasets larger than their stored bytes can be. The check does not follow links.

The string heap (global heap collections, ``GCOL``) is a sequence of objects with their lengths. If an object of free
space has the length zero, HDF5 2.0 never returns, and Python cannot interrupt it. HDF5 has checksums of data and most
metadata, but not of this heap. Every file therefore ends with a line that contains the SHA-256 of all bytes before it;
HDF5 ignores this line. If another program changes a file, the file has no such line, or the checksum no longer matches.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import h5py

MAX_MEMBERS = 20_000
"""Largest number of members of a file [1]. Chosen: a smaller value refuses recordings of many clips, a larger one lets
the check of a malicious file take minutes."""
MAX_DEPTH = 32
"""Largest depth of groups [1]. Chosen: the layout has eight levels; a larger value costs time."""
MAX_BYTES = 2**31
"""Largest size of a dataset [bytes]. Chosen: a smaller value refuses long films, a larger one fills the memory."""
MAX_INFLATION = 1100
"""Largest ratio of the size of a dataset to its stored size [1]. Derived: deflate compresses by a factor of at most
1032; the excess is a margin."""
SLACK = 2**22
"""A dataset may exceed the product of its stored size and `MAX_INFLATION` by at most this size [bytes]. Chosen: chunks
are padded; a smaller value refuses small datasets, a larger one admits malicious files."""
KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
CHECKSUM_MARK = b"\ngyrotrack sha256 "
CHECKSUM_LENGTH = len(CHECKSUM_MARK) + 65
"""Length of the line with the checksum [bytes]. Derived: its mark, 64 digits of SHA-256 and a line end."""
_NOT_SOUND = "The file is damaged or malicious."
_HEAP_MARK = b"GCOL\x01\x00\x00\x00"
_HEAP_HEADER = 16
"""Length of the header of an object in a string heap [bytes]. Source: HDF5 file format, level 1E."""
_BLOCK = 2**20
"""Number of bytes that are read at once [bytes]. Chosen: a smaller number makes reading slow, a larger one needs
memory."""


@dataclass(frozen=True)
class Guard:
    """Checks of HDF5 files; `fail` makes an error from a sentence and a hint."""

    fail: Callable[[str, str], Exception]

    def check_file(self, path: Path, recreate: str) -> None:
        """Refuse a file that another program is writing, or a damaged file with the hint `recreate`."""
        if is_open_elsewhere(path):
            raise self.fail(f"{path} is open in another program.", "Close it there.")
        if checksum_fails(path):
            raise self.fail(f"{path} is damaged: the checksum does not match the contents.", recreate)
        if has_endless_heap(path):
            raise self.fail(f"{path} is damaged: corrupt string heap.", recreate)

    def check_tree(self, file: Any) -> None:
        """Check a file for links, external storage and sizes beyond the stored bytes."""
        seen: set[Any] = set()
        # identifiers are used because the objects of h5py take ten times as long to open
        todo: list[tuple[Any, int]] = [(file.id, 0)]
        count = 0
        while todo:
            group, depth = todo.pop()
            address = h5py.h5o.get_info(group).addr
            if address in seen:
                continue
            seen.add(address)
            if depth > MAX_DEPTH:
                raise self.fail(f"{location(h5py.Group(group))} is nested too deeply.", _NOT_SOUND)
            for name in group:
                count += 1
                if count > MAX_MEMBERS:
                    raise self.fail(f"{file.filename} has too many members.", _NOT_SOUND)
                if group.links.get_info(name).type != h5py.h5l.TYPE_HARD:
                    raise self._link(h5py.Group(group), name.decode("utf-8", "surrogateescape"))
                member = h5py.h5o.open(group, name)
                if isinstance(member, h5py.h5g.GroupID):
                    todo.append((member, depth + 1))
                elif isinstance(member, h5py.h5d.DatasetID):
                    self._check_bytes(member)

    def own_member(self, group: Any, name: str) -> Any:
        """Return a direct member of `group`; raise an error if it is a link."""
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise self._link(group, name)
        return group[name]

    def _link(self, group: Any, name: str) -> Exception:
        what = f"{location(group)} has a link, '{name}'."
        return self.fail(what, "Links are not followed; copy the data into the file.")

    def check_bytes(self, dataset: Any) -> None:
        """Refuse a dataset with external storage, with an unknown filter, or larger than its stored bytes can be."""
        self._check_bytes(dataset.id)

    def _check_bytes(self, dataset: Any) -> None:
        plist = dataset.get_create_plist()
        layout = plist.get_layout()
        if layout == h5py.h5d.VIRTUAL or plist.get_external_count() > 0:
            what = f"{location(h5py.Dataset(dataset))} stores its data in another file."
            raise self.fail(what, "Copy the data into the file.")
        filters = {plist.get_filter(i)[0] for i in range(plist.get_nfilters())}
        if not filters <= KNOWN_FILTERS:
            what = f"{location(h5py.Dataset(dataset))} uses an unknown compression filter."
            raise self.fail(what, "Write it with gzip or uncompressed.")
        if dataset.get_space().get_simple_extent_type() == h5py.h5s.NULL:
            return
        size = _item_bytes(dataset)
        claimed = math.prod(int(n) for n in dataset.shape) * size
        stored = int(dataset.get_storage_size())
        chunk = math.prod(plist.get_chunk() if layout == h5py.h5d.CHUNKED else (0,)) * size
        if claimed > MAX_BYTES or max(claimed, chunk) > stored * MAX_INFLATION + SLACK:
            what = f"{location(h5py.Dataset(dataset))} declares {claimed:,} bytes but contains {stored:,}."
            raise self.fail(what, _NOT_SOUND)


def _item_bytes(dataset: Any) -> int:
    """Return the size of an element in memory [bytes]."""
    # the size is taken from HDF5, because h5py takes long to find NumPy's type
    if dataset.get_type().equal(h5py.h5t.IEEE_F64LE):
        return 8
    return int(dataset.dtype.itemsize)


def location(item: Any) -> str:
    """Return file name and path in the file, for messages."""
    return f"{item.file.filename}:{item.name}"


def has_endless_heap(path: Path) -> bool:
    """Return whether the string heap of an HDF5 file is corrupt, so that reading it would not end."""
    with path.open("rb") as stream:
        return any(_is_endless(stream, place) for place in _collections(stream))


def _collections(stream: BinaryIO) -> list[int]:
    places, start, tail = [], 0, b""
    while block := stream.read(_BLOCK):
        held = tail + block
        place = held.find(_HEAP_MARK)
        while place >= 0:
            places.append(start - len(tail) + place)
            place = held.find(_HEAP_MARK, place + 1)
        start += len(block)
        tail = held[1 - len(_HEAP_MARK) :]
    return places


def _is_endless(stream: BinaryIO, place: int) -> bool:
    size = _number(stream, place + len(_HEAP_MARK), 8)
    at, end = place + _HEAP_HEADER, min(place + size, stream.seek(0, 2))
    while at + _HEAP_HEADER <= end:
        index, length = _number(stream, at, 2), _number(stream, at + 8, 8)
        step = length if index == 0 else _HEAP_HEADER + (length + 7) // 8 * 8
        if step == 0:
            return True
        at += step
    return False


def _number(stream: BinaryIO, place: int, size: int) -> int:
    stream.seek(place)
    return int.from_bytes(stream.read(size), "little")


def checksum_line(stream: BinaryIO) -> bytes:
    """Return the checksum line for the rest of `stream`."""
    return _line(stream, None)


def is_open_elsewhere(path: Path) -> bool:
    """Whether another program has opened an HDF5 file for writing; HDF5 then locks the file."""
    try:
        import fcntl
    except ImportError:  # on Windows, such a file cannot be opened
        return False
    with path.open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError as error:
            return isinstance(error, BlockingIOError)  # some file systems have no locks
    return False


def checksum_fails(path: Path) -> bool:
    """Return whether a file ends with a checksum line that does not match; False without such a line."""
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        if size < CHECKSUM_LENGTH:
            return False
        stream.seek(size - CHECKSUM_LENGTH)
        line = stream.read(CHECKSUM_LENGTH)
        if not line.startswith(CHECKSUM_MARK):
            return False
        stream.seek(0)
        return line != _line(stream, size - CHECKSUM_LENGTH)


def _line(stream: BinaryIO, left: int | None) -> bytes:
    """Return the checksum line for the next `left` bytes of a stream, or for all bytes to its end."""
    digest = hashlib.sha256()
    while left != 0 and (block := stream.read(_BLOCK if left is None else min(_BLOCK, left))):
        digest.update(block)
        left = None if left is None else left - len(block)
    return CHECKSUM_MARK + digest.hexdigest().encode() + b"\n"
