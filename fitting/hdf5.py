"""Columns of an HDF5 file that may be damaged or hostile: what is no plain column of numbers is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.errors import RecordError

Array = NDArray[np.float64]

_MAX_SAMPLES = 50_000_000
# deflate cannot do better than 1032 : 1; chunks are padded
_INFLATION, _SLACK = 1100, 2**22


def series(path: Path, file: Any, group: str, key: tuple[str, str]) -> tuple[Array, Array, Array]:
    """Return time, value and sigma of a group; `key` names the last two."""
    value, sigma = key
    return (
        column(path, file, group, "time"),
        column(path, file, group, value),
        column(path, file, group, sigma),
    )


def column(path: Path, file: Any, group: str, name: str) -> Array:
    """Return a column, if it is a plain one of the length of its group, and no link or bomb."""
    import h5py

    for place in (group, f"{group}/{name}"):
        # a link that leads out of the file would read what its author chose, not what was measured
        if not isinstance(file.get(place, getlink=True), h5py.HardLink):
            raise RecordError(f"{path} has no {place}", "`gyrotrack info` tells what it holds")
    data = file[f"{group}/{name}"]
    if not isinstance(data, h5py.Dataset) or data.ndim != 1 or data.is_virtual or data.external:
        raise RecordError(f"{path}: {group}/{name} is not a plain column")
    if data.dtype.kind not in "fiu":
        raise RecordError(f"{path}: {group}/{name} holds no real numbers")
    if data.size != file[f"{group}/time"].size:
        raise RecordError(f"{path}: {group}/{name} and {group}/time have different lengths")
    chunk = int(np.prod(data.chunks or (0,), dtype=object)) * data.dtype.itemsize
    held = data.id.get_storage_size()
    if data.size > _MAX_SAMPLES or max(data.nbytes, chunk) > held * _INFLATION + _SLACK:
        raise RecordError(f"{path}: {group}/{name} claims {data.size} samples")
    plist = data.id.get_create_plist()
    filters = {plist.get_filter(i)[0] for i in range(plist.get_nfilters())}
    if not filters <= {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}:
        raise RecordError(f"{path}: {group}/{name} is packed in an unknown way", "write it with gzip")
    return np.asarray(data[()], dtype=float)


def number(file: Any, group: str, name: str) -> float:
    """Return a number that is told of a group; nan where there is none."""
    import h5py

    parts = group.split("/")
    places = ["/".join(parts[: i + 1]) for i in range(len(parts))]
    if not all(isinstance(file.get(p, getlink=True), h5py.HardLink) for p in places):
        return float("nan")
    value = np.asarray(file[group].attrs.get(name, np.nan))
    return float(value) if value.ndim == 0 and value.dtype.kind in "fiu" else float("nan")


def text(value: Any) -> str:
    """Return an attribute as text, nothing if it is missing."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return "" if value is None else str(value)
