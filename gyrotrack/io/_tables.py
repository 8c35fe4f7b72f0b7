"""Reading and writing of the tables and attributes of the schema.

Before a dataset is read, it is checked that it is stored in the file itself, has the declared type and dimensions, and
is not larger than its stored chunks can be; `fitting._hdf5` validates files before they are read.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
from pydantic_core import to_jsonable_python

from fitting._files import FORMAT
from fitting._hdf5 import Guard, location
from gyrotrack._column_store import release_pages
from gyrotrack._errors import DatasetError
from gyrotrack._versions import __version__, versions
from gyrotrack.io import _schema as layout
from gyrotrack.io._schema import LENGTH_ONLY, Attribute, Field, Table

GUARD = Guard(DatasetError)
own_member, check_bytes = GUARD.own_member, GUARD.check_bytes
_OTHER_LAYOUT = "The file is not in this layout."
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
        "format": FORMAT,
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
