"""Reading and writing of the tables and attributes of the schema, and validation of HDF5 files before they are read.

External and soft links, external storage, virtual datasets, filters that load plugins, and sizes beyond the stored
bytes are rejected; the whole tree is checked without following links. Before a dataset is read, it is checked that it
is stored in the file itself, has the declared type and dimensions, and is not larger than its stored chunks can be.

The string heap (global heap collections, ``GCOL``) is a sequence of objects with their lengths; HDF5 2.0 never returns
from an empty object of free space, and Python cannot interrupt it. HDF5 has checksums of data and most metadata but not
of this heap. Every file therefore ends with a line with the SHA-256 of all bytes before it, which HDF5 ignores. A file
that was changed by another program has no such line, or fails the check.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
import numpy.typing as npt
from pydantic_core import to_jsonable_python

from gyrotrack._column_store import release_pages
from gyrotrack._errors import DatasetError
from gyrotrack._versions import __version__, versions
from gyrotrack.io import _schema as layout
from gyrotrack.io._schema import LENGTH_ONLY, Attribute, Field, Table

_NOT_SOUND = "The file is damaged or malicious."
_OTHER_LAYOUT = "The file is not in this layout."
MAX_MEMBERS = 20_000
MAX_DEPTH = 32
MAX_BYTES = 2**31
MAX_INFLATION = 1100  # the largest compression ratio of deflate is 1032
SLACK = 2**22  # additional bytes of small datasets, because chunks are padded
KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}


def check_tree(file: Any) -> None:
    """Check a file for links, external storage and sizes beyond the stored bytes; a DatasetError contains the path."""
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
            raise DatasetError(f"{location(group)} is nested too deeply.", _NOT_SOUND)
        for name in group:
            count += 1
            if count > MAX_MEMBERS:
                raise DatasetError(f"{file.filename} has too many members.", _NOT_SOUND)
            member = own_member(group, name)
            if isinstance(member, h5py.Group):
                todo.append((member, depth + 1))
            elif isinstance(member, h5py.Dataset):
                check_bytes(member)


def own_member(group: Any, name: str) -> Any:
    """Return a direct member of `group`; raise an error if it is a link."""
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        what = f"{location(group)} has a link, '{name}'."
        raise DatasetError(what, "Links are not followed; copy the data into the file.")
    return group[name]


def check_bytes(dataset: Any) -> None:
    """Raise a DatasetError for a dataset with external storage, an unknown filter, or more than its stored bytes."""
    if dataset.is_virtual or dataset.external:
        what = f"{location(dataset)} stores its data in another file."
        raise DatasetError(what, "Copy the data into the file.")
    plist = dataset.id.get_create_plist()
    filters = {plist.get_filter(i)[0] for i in range(plist.get_nfilters())}
    if not filters <= KNOWN_FILTERS:
        what = f"{location(dataset)} uses an unknown compression filter."
        raise DatasetError(what, "Write it with gzip or uncompressed.")
    if dataset.shape is None:
        return
    claimed = int(np.prod([int(n) for n in dataset.shape], dtype=object)) * dataset.dtype.itemsize
    stored = int(dataset.id.get_storage_size())
    chunk = int(np.prod(dataset.chunks or (0,), dtype=object)) * dataset.dtype.itemsize
    if claimed > MAX_BYTES or max(claimed, chunk) > stored * MAX_INFLATION + SLACK:
        what = f"{location(dataset)} declares {claimed:,} bytes but contains {stored:,}."
        raise DatasetError(what, _NOT_SOUND)


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


def is_open_elsewhere(path: Path) -> bool:
    """Whether another program has opened an HDF5 file for writing, which HDF5 marks by a lock of the file."""
    try:
        import fcntl
    except ImportError:  # Windows, where such a file cannot be opened
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


CHUNK = 8192  # values along the first dimension: 64 kB per column


def write_table(group: Any, table: Table, record: Any, **extra: npt.ArrayLike) -> None:
    """Write `table` from attributes of `record` and `extra`, with units, dimension scales and NXdata attributes."""
    arrays = {
        f.name: np.asarray(extra[f.name] if f.name in extra else getattr(record, f.name), dtype=f.dtype)
        for f in table.fields
    }
    for f in table.fields:
        dataset = create_dataset(group, f.name, arrays[f.name])
        dataset.attrs["units"] = f.units
        dataset.attrs["long_name"] = f.long_name
        for key, value in f.attributes.items():
            dataset.attrs[key] = np.asarray(value, dtype=f.dtype) if isinstance(value, list) else value
        release_pages()
    for f in table.fields:
        _attach_scales(group, f, arrays[f.name].shape)
    group.attrs["NX_class"] = "NXdata"
    group.attrs["signal"] = table.signal
    group.attrs["axes"] = [d for f in table.fields if f.name == table.signal for d in f.dims]
    write_attributes(group, table.attributes, record)


def create_dataset(group: Any, name: str, array: npt.NDArray[Any]) -> Any:
    """Create a compressed dataset with checksums."""
    chunks = (min(max(array.shape[0], 1), CHUNK), *array.shape[1:])
    return group.create_dataset(
        name,
        data=array,
        chunks=chunks,
        maxshape=None if array.size else (None, *array.shape[1:]),
        compression="gzip",
        shuffle=True,
        fletcher32=True,
    )


def _attach_scales(group: Any, f: Field, shape: tuple[int, ...]) -> None:
    for axis, dim in enumerate(f.dims):
        if dim not in group:
            scale = group.create_dataset(dim, data=np.arange(shape[axis], dtype="i8"))
            scale.attrs["units"] = "1"
            scale.attrs["long_name"] = LENGTH_ONLY[dim]
        if not group[dim].is_scale:
            group[dim].make_scale(dim)
        if f.name != dim:
            group[f.name].dims[axis].attach_scale(group[dim])


def write_attributes(group: Any, attributes: Sequence[Attribute], record: Any) -> None:
    """Write the attributes of `record`, each with its unit as ``<name>_units``; NaN and () are not written."""
    for a in attributes:
        value = a.kind(getattr(record, a.key))
        if value != value or value == ():
            continue
        group.attrs[a.name] = valid(value) if isinstance(value, str) else value
        if a.units:
            group.attrs[f"{a.name}_units"] = a.units


def read_attributes(group: Any, attributes: Sequence[Attribute]) -> dict[str, Any]:
    """Read attributes by the names of the fields in the record; one without a default must exist."""
    return {a.key: attribute(group, a.name, a.kind, a.default) for a in attributes}


def read_table(group: Any, table: Table) -> dict[str, npt.NDArray[Any]]:
    """Read the datasets of `table` from `group`, checked against the schema; see `read_attributes` for the others."""
    values: dict[str, npt.NDArray[Any]] = {}
    for f in table.fields:
        dataset = child(group, f.name)
        check_storage(dataset)
        length = values[table.fields[0].name].shape[0] if values else None
        _check_shape(dataset, f, length)
        values[f.name] = load(dataset).astype(f.dtype, copy=False)
    return values


def child(group: Any, name: str) -> Any:
    """Return a direct member of `group`; it must exist and not be a link."""
    link = group.get(name, getlink=True) if name in group.keys() else None  # noqa: SIM118 - `in group` follows links
    if link is None:
        raise DatasetError(f"{location(group)} lacks '{name}'.", "The file is not complete; create it again.")
    return own_member(group, name)


def child_group(group: Any, name: str) -> Any:
    """Return a direct member of `group` that is itself a group."""
    member = child(group, name)
    if not isinstance(member, h5py.Group):
        raise DatasetError(f"{location(group)}: '{name}' is not a group.", _OTHER_LAYOUT)
    return member


def check_storage(dataset: Any) -> None:
    """Raise an error for a dataset in another file, or one that is larger than its stored bytes can be."""
    if not isinstance(dataset, h5py.Dataset):
        raise DatasetError(f"{location(dataset)} is not a dataset.", _OTHER_LAYOUT)
    if dataset.shape is None or dataset.dtype.kind not in "iuf" or dataset.dtype.itemsize > 16:
        raise DatasetError(f"{location(dataset)} does not contain plain numbers.", _OTHER_LAYOUT)
    check_bytes(dataset)


def _check_shape(dataset: Any, f: Field, length: int | None) -> None:
    shape, fixed = tuple(dataset.shape), {"side": 2, "xy": 2}
    wanted = tuple(fixed.get(d, shape[0] if length is None else length) for d in f.dims if shape)
    if len(shape) != len(f.dims) or shape != wanted:
        raise DatasetError(f"{location(dataset)} has the shape {shape}, not {wanted}.", _OTHER_LAYOUT)
    if f.dtype != "f8" and dataset.dtype.kind == "f":
        raise DatasetError(f"{location(dataset)} does not contain integers.", _OTHER_LAYOUT)


def load(dataset: Any) -> npt.NDArray[Any]:
    """Read all values of a dataset whose storage has been checked."""
    try:
        return np.asarray(dataset[()])
    except (OSError, RuntimeError, ValueError) as error:
        what = f"{location(dataset)} cannot be read: the file is damaged."
        raise DatasetError(what, "Create it again, or restore a copy.") from error


def attribute(group: Any, name: str, kind: type[Any], default: Any = None) -> Any:
    """Return an attribute as `kind` (int, float, str, or pairs for tuple); one without a `default` must exist."""
    if name not in group.attrs:
        if default is not None:
            return default
        what = f"{location(group)} lacks the attribute '{name}'."
        raise DatasetError(what, "The file is not complete; create it again.")
    try:
        if kind is tuple:
            pairs = np.asarray(group.attrs[name], dtype=np.float64)
            if pairs.ndim == 2 and pairs.shape[1] == 2 and np.isfinite(pairs).all():
                return tuple(map(tuple, pairs.tolist()))
        elif group.attrs.get_id(name).shape in {(), (1,)}:
            value = np.asarray(group.attrs[name]).reshape(())[()]
            value = value.decode() if isinstance(value, bytes) else value
            if (kind is str) == isinstance(value, str):
                return kind(value)
        cause = None
    except (TypeError, ValueError, OSError, RuntimeError, OverflowError) as error:
        cause = error
    what = f"{location(group)}: the attribute '{name}' is not {_KIND_NAMES[kind]}."
    raise DatasetError(what, _OTHER_LAYOUT) from cause


_KIND_NAMES: dict[type[Any], str] = {
    int: "an integer",
    float: "a number",
    str: "a text",
    tuple: "a table of pairs",
}


def stamp(file: Any, kind: str, *, command: str, settings: Mapping[str, Any]) -> None:
    """Write the root attributes of a file."""
    file.attrs.update({
        "format": layout.FORMAT,
        "format_version": layout.FORMAT_VERSION,
        "kind": kind,
        "software_version": __version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": valid(command),
        "settings": to_json(settings),
        "environment": to_json(versions()),
    })  # fmt: skip


def to_json(value: Any) -> str:
    """Write `value` as JSON; NumPy numbers, arrays, tuples and paths are converted."""
    plain = to_jsonable_python(value, fallback=lambda array: array.tolist())
    return valid(json.dumps(plain, ensure_ascii=False))


def valid(text: str) -> str:
    """Return a text as HDF5 can store it: names of files may contain bytes that are not UTF-8."""
    return text.encode("utf-8", "replace").decode().replace("\0", "?")
