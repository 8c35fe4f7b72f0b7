"""MATLAB files: vectors, matrices and structs, and the captures of dSPACE."""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import h5py
import numpy as np
import numpy.typing as npt

from gyrotrack._errors import DatasetError
from gyrotrack.io._tables import READER
from gyrotrack.io.readers._matlab_process import Damaged, Unreadable, arrays_in, description
from gyrotrack.io.readers._raw_table import MAX_BYTES, RawTable, header_of, role_of, table_of

_COMPRESSED = 15  # type of a compressed element of a MATLAB file
_ARRAYS_OF_ITEMS = {
    1,
    2,
    3,
}  # classes of arrays with items (cell, struct, object); each item has a tag of 8 bytes
_MAX_DIMENSIONS = 128  # largest number of bytes that state the sizes of an array


def read_matlab(path: Path, content: bytes, _options: object) -> RawTable:
    """Return the vectors of equal length, or the columns of a matrix, in a MATLAB file (before version 7.3)."""
    _refuse_inflation(path, content)
    try:
        numbers, others = arrays_in(content)
    except Damaged as error:
        raise DatasetError(f"{path} is damaged: {error}.", "Save it again with -v7.") from error
    except Unreadable as error:
        what = f"{path} is not a readable MATLAB file: {error}."
        raise DatasetError(what, "Save it with -v7.") from error
    return table_of_arrays(path, numbers, others)


def _refuse_inflation(path: Path, content: bytes) -> None:
    """Raise a DatasetError for a MATLAB file whose compressed elements expand beyond the limit."""
    order: Literal["big", "little"] = "big" if content[126:128] == b"MI" else "little"
    at, size = 128, 0
    while at + 8 <= len(content):
        kind, length = (int.from_bytes(content[at + k : at + k + 4], order) for k in (0, 4))
        element = content[at + 8 : at + 8 + length]
        if kind == _COMPRESSED:
            inflater, rest, pieces = zlib.decompressobj(), element, []
            while rest and size <= MAX_BYTES:
                try:
                    pieces.append(inflater.decompress(rest, 2**24))
                except zlib.error:
                    break
                size += len(pieces[-1])
                rest = inflater.unconsumed_tail
            element = b"".join(pieces)
        _refuse_empty_arrays(path, element, order)
        at += 8 + length
    if size > MAX_BYTES:
        what = f"{path} is larger than {MAX_BYTES >> 20} MiB when expanded."
        raise DatasetError(what, "Save the variables of time and angle alone.")


def _refuse_empty_arrays(path: Path, element: bytes, order: Literal["big", "little"]) -> None:
    """Raise a DatasetError for a struct or cell array with more items than fit into the element."""
    flags = (6).to_bytes(4, order) + (8).to_bytes(4, order)
    dimensions = (5).to_bytes(4, order)
    for found in re.finditer(
        re.escape(flags) + rb"(.{8})" + re.escape(dimensions) + b"(.{4})", element, re.DOTALL
    ):
        kind = found[1][0 if order == "little" else 3]
        sizes = element[found.end() : found.end() + min(int.from_bytes(found[2], order), _MAX_DIMENSIONS)]
        count = math.prod(int.from_bytes(sizes[k : k + 4], order) for k in range(0, len(sizes), 4))
        if kind in _ARRAYS_OF_ITEMS and count > len(element) / 8:
            what = f"{path} declares an array of {count:,} items that it does not contain."
            raise DatasetError(what, "Save it with -v7.")


def table_of_arrays(
    path: Path, arrays: Mapping[str, npt.NDArray[Any]], others: Mapping[str, str] = MappingProxyType({})
) -> RawTable:
    """Return the longest vectors of equal length among named arrays, or the columns of the only matrix.

    If the names of the vectors do not show both a time and a motion, the columns of matrices of the same length follow,
    named by the matrix and the number of the column.
    """
    plain = {k: v for k, v in arrays.items() if v.dtype.kind in "iuf" and v.ndim <= 2 and v.size > 1}
    vectors = {k: v.ravel() for k, v in plain.items() if min(v.shape) == 1 or v.ndim == 1}
    if vectors:
        longest = max(len(v) for v in vectors.values())
        vectors = {k: v for k, v in vectors.items() if len(v) == longest}
        if not _describe_a_motion(vectors):
            for name, matrix in plain.items():
                if name not in vectors and matrix.ndim == 2 and len(matrix) == longest:
                    vectors |= {f"{name} {k}": column for k, column in enumerate(matrix.T, 1)}
        return table_of(path, list(vectors), list(vectors.values()))
    matrices = [v for v in plain.values() if v.ndim == 2]
    if len(matrices) == 1:
        matrix = matrices[0]
        return table_of(path, [""] * matrix.shape[1], list(matrix.T))
    held = {k: description(v) for k, v in arrays.items()} | dict(others)
    kept = [f"{name} ({what})" for name, what in held.items()]
    raise DatasetError(
        f"{path} contains neither vectors of equal length nor a single matrix, but "
        f"{', '.join(kept)[:200] or 'nothing'}.",
        "Save time and angle as vectors.",
    )


def _describe_a_motion(names: Iterable[str]) -> bool:
    """Return whether the names of the vectors include a time, and an angle or a speed."""
    roles = {role_of(header_of(name)[0]) for name in names}
    return "t" in roles and bool(roles & {"angle", "omega"})


def read_matlab_hdf5(path: Path, _content: bytes, _options: object) -> RawTable:
    """Return the vectors, or the columns of a matrix, in a MATLAB 7.3 file: HDF5 with arrays in column order."""
    try:
        with h5py.File(path, "r", locking=False) as file:
            READER.check_tree(file)
            held = dict(file.items())
            for name, value in list(held.items()):
                if isinstance(value, h5py.Group):
                    del held[name]
                    held |= {} if name.startswith("#") else dict(value.items())
            arrays = {}
            for name, value in held.items():
                numeric = isinstance(value, h5py.Dataset) and value.dtype.kind in "iuf"
                if numeric and "MATLAB_empty" not in value.attrs:
                    READER.check_storage(value)
                    arrays[name] = np.asarray(READER.load(value)).T
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        what = f"{path} is not a readable MATLAB file: {str(error)[:100]}."
        raise DatasetError(what, "Save it with -v7.") from error
    return table_of_arrays(path, arrays)
