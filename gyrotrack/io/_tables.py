"""Writing of tables and attributes of the schema, and a reader that raises the errors of `gyrotrack`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic_core import to_jsonable_python

from fitting import _case_format as layout
from fitting._case_format import Attribute, Field, Table
from fitting._dataset import Reader
from gyrotrack._column_store import release_pages
from gyrotrack._errors import DatasetError, UsageError
from gyrotrack._versions import __version__, versions

READER = Reader(DatasetError)
CHUNK = 8192  # number of values of a chunk along the first dimension: 64 kB per column


def write_table(
    group: Any, table: Table, record: Any, scales: Mapping[str, Any] | None = None, **extra: npt.ArrayLike
) -> None:
    """Write `table` from attributes of `record` and `extra`, with units, dimension scales and NXdata attributes.

    `scales` are dimension scales that are stored in other groups.
    """
    arrays = {
        f.name: np.asarray(extra[f.name] if f.name in extra else getattr(record, f.name), dtype=f.dtype)
        for f in table.fields
    }
    datasets = {}
    for f in table.fields:
        dataset = datasets[f.name] = create_dataset(group, f.name, arrays[f.name])
        dataset.attrs["units"] = f.units
        dataset.attrs["long_name"] = f.long_name
        for key, value in f.attributes.items():
            dataset.attrs[key] = np.asarray(value, dtype=f.dtype) if isinstance(value, list) else value
        release_pages()
    own: dict[str, Any] = {}
    for f in table.fields:
        _attach_scales(group, f, datasets, own, scales or {})
    if table.signal:
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


def _attach_scales(
    group: Any, f: Field, datasets: Mapping[str, Any], own: dict[str, Any], scales: Mapping[str, Any]
) -> None:
    """Attach dimension scales: `scales` from other groups, or new scales of this group, which are added to `own`."""
    dataset = datasets[f.name]
    for axis, dim in enumerate(f.dims):
        if dim in scales:
            dataset.dims[axis].attach_scale(scales[dim])
            continue
        if dim not in own:
            own[dim] = _scale(group, dim, dataset.shape[axis], datasets)
        if f.name != dim:
            dataset.dims[axis].attach_scale(own[dim])


def _scale(group: Any, dim: str, size: int, datasets: Mapping[str, Any]) -> Any:
    """Return the dimension scale `dim` of a group: one of its datasets, or an index array of length `size`."""
    scale = datasets[dim] if dim in datasets else group.get(dim)
    if scale is None:
        scale = create_dataset(group, dim, np.arange(size, dtype="i8"))
        scale.attrs["units"] = "1"
        scale.attrs["long_name"] = layout.INDICES[dim.removeprefix("other_")]
    if not scale.is_scale:
        scale.make_scale(dim)
    return scale


def write_attributes(group: Any, attributes: Sequence[Attribute], record: Any) -> None:
    """Write the attributes of `record`, each with its unit as ``<name>_units``; NaN and () are not written."""
    stated = layout.stated_attributes(record, attributes)
    for a in (a for a in attributes if a.name in stated):
        value = stated[a.name]
        if a.choices and value not in a.choices:
            raise UsageError(
                f"'{value[:40]}' is not a value of '{a.name}'.", f"Use {' or '.join(a.choices)}."
            )
        if a.kind is float and not math.isfinite(value) and not layout.is_nan(a.default):
            raise UsageError(f"'{a.name}' is {value}, not a finite number.", "Correct it.")
        group.attrs[a.name] = valid(value) if isinstance(value, str) else value
        if a.units:
            group.attrs[f"{a.name}_units"] = a.units


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
    """Return a text that HDF5 can store; file names may contain bytes that are not UTF-8."""
    return text.encode("utf-8", "replace").decode().replace("\0", "?")
