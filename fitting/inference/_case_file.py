"""Reading a case file (HDF5), which may be damaged or malicious."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting._errors import RecordError
from fitting.dynamics._inputs import Input
from fitting.inference._record import Quantity, Record, is_body_name, make_record

Array = NDArray[np.float64]

_MAX_SAMPLES = 50_000_000  # samples of an array: 53 hours at 260 frames per second
# largest compression ratio of deflate is 1032; chunks are padded
_INFLATION, _SLACK = 1100, 2**22


def series(path: Path, file: Any, group: str, key: tuple[str, str]) -> tuple[Array, Array, Array]:
    """Return time, value and sigma of a group; `key` names the last two."""
    time, value, sigma = (column(path, file, group, name) for name in ("time", *key))
    return time, value, sigma


def column(path: Path, file: Any, group: str, name: str) -> Array:
    """Return a column; refuse links, columns of another length than `time`, and decompression bombs."""
    import h5py

    for place in (group, f"{group}/{name}"):
        # a link could point to another file
        if not isinstance(file.get(place, getlink=True), h5py.HardLink):
            raise RecordError(f"{path} has no {place}", "`gyrotrack info` shows its contents")
    data = file[f"{group}/{name}"]
    if not isinstance(data, h5py.Dataset) or data.ndim != 1 or data.is_virtual or data.external:
        raise RecordError(f"{path}: {group}/{name} is not a plain column")
    if data.dtype.kind not in "fiu":
        raise RecordError(f"{path}: {group}/{name} holds no real numbers")
    if data.size != file[f"{group}/time"].size:
        raise RecordError(f"{path}: {group}/{name} and {group}/time have different lengths")
    chunk = int(np.prod(data.chunks or (0,), dtype=object)) * data.dtype.itemsize
    stored = data.id.get_storage_size()
    if data.size > _MAX_SAMPLES or max(data.nbytes, chunk) > stored * _INFLATION + _SLACK:
        raise RecordError(f"{path}: {group}/{name} claims {data.size} samples")
    plist = data.id.get_create_plist()
    filters = {plist.get_filter(i)[0] for i in range(plist.get_nfilters())}
    if not filters <= {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}:
        raise RecordError(f"{path}: {group}/{name} is packed in an unknown way", "write it with gzip")
    return np.asarray(data[()], dtype=float)


def number(file: Any, group: str, name: str) -> float:
    """Return a numeric attribute of a group; nan where there is none."""
    import h5py

    parts = group.split("/")
    places = ["/".join(parts[: i + 1]) for i in range(len(parts))]
    if not all(isinstance(file.get(p, getlink=True), h5py.HardLink) for p in places):
        return float("nan")
    value = np.asarray(file[group].attrs.get(name, np.nan))
    return float(value) if value.ndim == 0 and value.dtype.kind in "fiu" else float("nan")


def text(value: Any) -> str:
    """Return an attribute as text; empty if it is missing."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return "" if value is None else str(value)


_CHECKSUM_PREFIX = b"\ngyrotrack sha256 "
_CHECKSUM_LENGTH = len(_CHECKSUM_PREFIX) + 65
_STRING_HEAP = b"GCOL\x01\x00\x00\x00"
_HEADER = 16  # bytes of the header of a heap object (HDF5 file format, level 1E)


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


def check_intact(path: Path) -> None:
    """Refuse a file with a wrong checksum in its last line, or with a string heap that HDF5 would read without end."""
    content = path.read_bytes()
    line = content[-_CHECKSUM_LENGTH:]
    stated = line[len(_CHECKSUM_PREFIX) : -1] if line.startswith(_CHECKSUM_PREFIX) else None
    if stated is not None and stated != hashlib.sha256(content[:-_CHECKSUM_LENGTH]).hexdigest().encode():
        raise RecordError(
            f"{path} is damaged: the checksum does not match the contents", "fetch a fresh copy"
        )
    place = content.find(_STRING_HEAP)
    while place >= 0:
        if _is_endless(content, place):
            raise RecordError(f"{path} is damaged: corrupt string heap", "fetch a fresh copy")
        place = content.find(_STRING_HEAP, place + 1)


def _is_endless(content: bytes, place: int) -> bool:
    """Return whether a string heap has an object of size zero, at which HDF5 2.0 enters an endless loop."""
    size = int.from_bytes(content[place + 8 : place + 16], "little")
    at, end = place + _HEADER, min(place + size, len(content))
    while at + _HEADER <= end:
        index, length = (int.from_bytes(content[at + a : at + b], "little") for a, b in ((0, 2), (8, 16)))
        step = length if index == 0 else _HEADER + (length + 7) // 8 * 8
        if step == 0:
            return True
        at += step
    return False


FORMAT = "gyrotrack"
MAJOR = 1  # major version of the layout


def read_record(path: str | Path) -> Record:
    """Read an HDF5 file of kind "case", layout version 1, or say why it cannot be read."""
    import h5py

    path = Path(path)
    if not path.is_file():
        what = "is not a regular file" if path.exists() else "does not exist"
        raise RecordError(f"{path} {what}", "give the name of a case file")
    try:
        if is_open_elsewhere(path):
            raise RecordError(f"{path} is open in another program", "close it there")
        check_intact(path)
        with h5py.File(path, "r") as file:
            return _read(path, file)
    except (OSError, KeyError, ValueError, TypeError, RuntimeError) as fault:
        if isinstance(fault, RecordError):
            raise
        if not h5py.is_hdf5(path):
            raise RecordError(
                f"{path} is not an HDF5 file", "make a case with `gyrotrack sync` or `gyrotrack import`"
            ) from None
        raise RecordError(
            f"{path} is damaged or incomplete: {fault}", "`gyrotrack info` shows its contents"
        ) from None


def _read(path: Path, file: Any) -> Record:
    attributes = dict(file.attrs)
    if text(attributes.get("format")) != FORMAT:
        raise RecordError(
            f"{path} was not written by gyrotrack", "make a case with `gyrotrack sync` or `gyrotrack import`"
        )
    version = text(attributes.get("format_version", "1.0"))
    if not version.split(".")[0].isdigit() or int(version.split(".")[0]) > MAJOR:
        raise RecordError(
            f"{path} has layout version {version[:12]}; this program reads {MAJOR}.x", "update gyrotrack"
        )
    if text(attributes.get("kind")) != "case":
        raise RecordError(
            f"{path} holds a {text(attributes.get('kind'))[:20] or 'file'}, not a case",
            "make a case with `gyrotrack sync`",
        )
    quantity: Quantity = "omega" if text(attributes.get("quantity", "angle")) == "omega" else "angle"
    key = ("omega", "omega_sigma") if quantity == "omega" else ("angle", "sigma")
    casing = series(path, file, "casing", key)
    single = text(attributes.get("bodies")) == "one"
    window = np.zeros(0) if single else column(path, file, "rotor", "window")
    rotor = [] if single else _windows(series(path, file, "rotor", key), window)
    inertias = [float(np.asarray(attributes[k])) for k in ("I_rotor", "I_casing")]
    if not all(np.isfinite(i) and i > 0 for i in inertias):
        raise RecordError(f"{path}: the moments of inertia {inertias} are not positive")
    return make_record(
        label=text(attributes.get("label")) or path.stem,
        surface=text(attributes.get("surface")),
        I_rotor=inertias[0],
        I_casing=inertias[1],
        I_rotor_u=float(np.asarray(attributes.get("I_rotor_u", np.nan))),
        I_casing_u=float(np.asarray(attributes.get("I_casing_u", np.nan))),
        per_inertia=bool(attributes.get("per_inertia", False)),
        casing=casing,
        rotor=rotor,
        single=single,
        name=_body_name(attributes) if single else "",
        start_sigma=_start_sigma(file, window, float(np.asarray(attributes.get("start_u", np.nan)))),
        quantity=quantity,
        source=str(path),
        tracked=text(file["casing"].attrs.get("sigma_source")) == "measured",
        correlated=_correlated(file),
        inputs=_inputs(path, file),
    )


def _body_name(attributes: dict[str, Any]) -> str:
    """Return the name of a single body; empty if there is none that keys of laws may begin with."""
    name = text(attributes.get("body_name"))
    return name if is_body_name(name) else ""


# largest number of inputs that are read
_MOST_INPUTS = 64


def _inputs(path: Path, file: Any) -> tuple[Input, ...]:
    """Return the recorded inputs of a case; groups of other kinds are refused."""
    import h5py

    if "input" not in file.keys():  # noqa: SIM118 - `in file` follows links
        return ()
    group = file["input"] if isinstance(file.get("input", getlink=True), h5py.HardLink) else None
    if not isinstance(group, h5py.Group) or len(group) > _MOST_INPUTS:
        raise RecordError(f"{path}: /input is not a group of at most {_MOST_INPUTS} inputs", "write it again")
    found = []
    for name in group:
        place = f"input/{name}"
        time, value, u = series(path, file, place, ("value", "u"))
        attributes = group[name].attrs
        kind: Any = text(attributes.get("interpolation", "linear"))
        known = np.isfinite(u)
        if known.any() and not known.all():
            raise RecordError(f"{path}: {place}/u lacks some values", "give all uncertainties, or none")
        delay = number(file, place, "delay")
        found.append(
            Input(
                name,
                time,
                value,
                text(attributes.get("unit", "1")),
                u if known.any() else None,
                kind,
                0.0 if math.isnan(delay) else delay,
            )
        )
    return tuple(found)


def _windows(rotor: tuple[Array, Array, Array], window: Array) -> list[tuple[Array, Array, Array]]:
    return [(rotor[0][window == w], rotor[1][window == w], rotor[2][window == w]) for w in np.unique(window)]


def _correlated(file: Any) -> tuple[float, float, float, float]:
    """Return the stated errors of the casing's angle (see `Record.correlated`), zeros if they are absent."""
    names = ("correlated_sigma", "correlated_time", "periodic_sigma", "harmonic_sigma")
    sigma, time, periodic, harmonic = (number(file, "casing", name) for name in names)
    slow = (sigma, time) if math.isfinite(sigma) and math.isfinite(time) else (0.0, 0.0)
    return (*slow, *(x if math.isfinite(x) else 0.0 for x in (periodic, harmonic)))  # type: ignore[return-value]


def _start_sigma(file: Any, window: Array, stated: float) -> list[float]:
    """Return the uncertainty of each window's start on the casing's clock [s], of its camera or as stated; NaN if none.

    `stated` is that of the case; it has no camera if it was imported.
    """
    sigma = [number(file, f"recording/rotor_{int(w)}", "clock_offset_sigma") for w in np.unique(window)]
    if not np.isfinite(sigma).any():
        return [stated if np.isfinite(stated) and stated >= 0 else float("nan")] * len(sigma)
    return [s if np.isfinite(s) and s > 0 else 0.0 for s in sigma]
