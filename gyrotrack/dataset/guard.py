"""What is refused in an HDF5 file before anything of it is read.

A file can lead a reader elsewhere: by external and soft links, by datasets whose bytes lie in other files
(external storage, virtual datasets), by filters that load plugins; and it can claim terabytes in a few bytes. The
whole tree is walked, link by link, without following any that is not a plain one.
"""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np

from gyrotrack.errors import DatasetError

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
