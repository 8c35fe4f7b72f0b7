"""Reading a case file (HDF5), which may be damaged or malicious."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting._errors import RecordError
from fitting._files import FORMAT, MAJOR
from fitting.dynamics._inputs import Input
from fitting.inference._error_modes import MOST_AMPLITUDES, ErrorMode
from fitting.inference._record import Quantity, Record, is_body_name, make_record

Array = NDArray[np.float64]

_MAX_SAMPLES = 50_000_000
"""Samples of an array at most [samples]. Chosen: 53 hours at 260 frames per second; a smaller value refuses long films,
a larger one admits files that fill the memory."""


def series(path: Path, file: Any, group: str, key: tuple[str, str]) -> tuple[Array, Array, Array]:
    """Return time, value and sigma of a group; `key` names the last two."""
    time, value, sigma = (column(path, file, group, name) for name in ("time", *key))
    return time, value, sigma


def column(path: Path, file: Any, group: str, name: str) -> Array:
    """Return a column; refuse links, columns of another length than `time`, and decompression bombs."""
    values = _numbers(path, file, f"{group}/{name}", 1)
    if values.size != file[f"{group}/time"].size:
        raise RecordError(f"{path}: {group}/{name} and {group}/time have different lengths")
    return values


def _numbers(path: Path, file: Any, place: str, dimensions: int) -> Array:
    """Return a dataset of real numbers that the file itself holds."""
    import h5py

    from fitting._hdf5 import Guard

    data = _own(path, file, place)
    if not isinstance(data, h5py.Dataset) or data.ndim != dimensions:
        raise RecordError(f"{path}: {place} is not a plain {'column' if dimensions == 1 else 'matrix'}")
    if data.dtype.kind not in "fiu":
        raise RecordError(f"{path}: {place} holds no real numbers")
    if data.size > _MAX_SAMPLES:
        raise RecordError(f"{path}: {place} claims {data.size} samples")
    Guard(_error).check_bytes(data)
    return np.asarray(data[()], dtype=float)


def _own(path: Path, file: Any, place: str) -> Any:
    """Return a group or dataset; refuse links, which could point to another file."""
    import h5py

    parts = place.split("/")
    for i in range(len(parts)):
        if not isinstance(file.get("/".join(parts[: i + 1]), getlink=True), h5py.HardLink):
            raise RecordError(f"{path} has no {place}", "`gyrotrack info` shows its contents")
    return file[place]


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


def _error(what: str, hint: str) -> RecordError:
    """Return the error of this package with a sentence and a hint of `fitting._hdf5`."""
    return RecordError(what.removesuffix("."), f"{hint[:1].lower()}{hint[1:].removesuffix('.')}")


def read_record(path: str | Path) -> Record:
    """Read an HDF5 file of kind "case", layout version 1 or 2, or say why it cannot be read."""
    import h5py

    from fitting._hdf5 import Guard

    path = Path(path)
    if not path.is_file():
        what = "is not a regular file" if path.exists() else "does not exist"
        raise RecordError(f"{path} {what}", "give the name of a case file")
    try:
        Guard(_error).check_file(path, "Fetch a fresh copy.")
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
            f"{path} has layout version {version[:12]}; this program reads 1.x and {MAJOR}.x",
            "update gyrotrack",
        )
    if text(attributes.get("kind")) != "case":
        raise RecordError(
            f"{path} holds a {text(attributes.get('kind'))[:20] or 'file'}, not a case",
            "make a case with `gyrotrack sync`",
        )
    # `/casing` and `/rotor` are what older scripts read and change
    bodies = _bodies(path, file) if "casing" not in file and "body" in file else _of_casing(path, file)
    main, rotor = (*bodies, _NO_ROTOR)[:2]
    if any(math.isnan(b.inertia) for b in bodies) and bodies[1:]:
        raise RecordError(
            f"{path}: a gyroscope needs the inertia of both bodies", "make the case again with both inertias"
        )
    unknown = math.isnan(main.inertia)
    return make_record(
        label=text(attributes.get("label")) or path.stem,
        surface=text(attributes.get("surface")),
        I_rotor=rotor.inertia,
        I_casing=1.0 if unknown else main.inertia,
        I_rotor_u=rotor.inertia_u,
        I_casing_u=main.inertia_u,
        per_inertia=unknown,
        casing=main.series,
        rotor=[w for b in bodies[1:] for w in _windows(b.series, b.segment)],
        name=main.name if is_body_name(main.name) else "",
        start_sigma=_start_sigma(path, file, rotor.segment, _scalar(attributes, "start_u")),
        quantity=main.quantity,
        source=str(path),
        tracked=text(_own(path, file, main.place).attrs.get("sigma_source")) == "measured",
        correlated=_correlated(file, main.place),
        correlated_profile=_profile(path, file, main.place),
        inputs=_inputs(path, file),
        modes=[m for b in bodies for m in _modes(path, file, b)],
    )


@dataclass(frozen=True)
class _Body:
    """A body of a file: its name, role, moment of inertia [kg m2] (NaN without one), and series."""

    name: str
    role: str
    inertia: float
    inertia_u: float
    place: str
    quantity: Quantity
    series: tuple[Array, Array, Array]
    segment: Array


# what a case of one body has instead of a rotor
_NO_ROTOR = _Body("rotor", "rotor", 1.0, math.nan, "", "angle", (np.zeros(0),) * 3, np.zeros(0))
# groups of layout 1 by its number of bodies, each with the role of the body
_OF_LAYOUT_1 = {"one": (("casing", "body"),)}
_GYROSCOPE = (("casing", "casing"), ("rotor", "rotor"))


def _scalar(attributes: Any, name: str) -> float:
    return float(np.asarray(attributes.get(name, np.nan)))


def _of_casing(path: Path, file: Any) -> list[_Body]:
    """Return the casing, or the single body, then the rotor, from `/casing` and `/rotor`."""
    attributes = file.attrs
    quantity: Quantity = "omega" if text(attributes.get("quantity", "angle")) == "omega" else "angle"
    key = ("omega", "omega_sigma") if quantity == "omega" else ("angle", "sigma")
    found = []
    for name, role in _OF_LAYOUT_1.get(text(attributes.get("bodies")), _GYROSCOPE):
        values = series(path, file, name, key)
        segment = column(path, file, name, "window") if name == "rotor" else np.zeros(len(values[0]))
        inertia = float(np.asarray(attributes[f"I_{name}"]))
        if not 0 < inertia < math.inf:
            raise RecordError(f"{path}: the moment of inertia of the {name} is {inertia}, not positive")
        inertia = math.nan if bool(attributes.get("per_inertia", False)) else inertia
        shown = text(attributes.get("body_name"))
        u = _scalar(attributes, f"I_{name}_u")
        found.append(_Body(shown, role, inertia, u, name, quantity, values, segment))
    return found


# quantities of a series that can be fitted
_QUANTITIES: dict[str, Quantity] = {"angle": "angle", "speed": "omega"}
# the series of a body that is fitted, where it has several
_FITTED = "fused"


def _bodies(path: Path, file: Any) -> list[_Body]:
    """Return the casing, or the single body, then the rotor, from `/body`."""
    found = {b.role: b for b in (_body(path, file, name) for name in _members(path, file, "body"))}
    known = found.keys() in ({"body"}, {"casing"}, {"casing", "rotor"})
    if not known or len(found) < len(_members(path, file, "body")):
        raise RecordError(
            f"{path} has bodies of the roles {', '.join(sorted(found)) or '(none)'}",
            "a case has one body, or one casing and one rotor",
        )
    if len({b.quantity for b in found.values()}) > 1:
        raise RecordError(
            f"{path} has speeds of one body and angles of the other", "store the same quantity of both"
        )
    return [found[role] for role in ("body", "casing", "rotor") if role in found]


def _body(path: Path, file: Any, name: str) -> _Body:
    attributes = _own(path, file, f"body/{name}").attrs
    place = _fitted(path, file, name)
    group = _own(path, file, place)
    quantity = text(group.attrs.get("quantity", "angle"))
    if quantity not in _QUANTITIES:
        raise RecordError(
            f"{path}: {place} holds {quantity[:20]}, which cannot be fitted",
            "`gyrotrack import` makes angles or speeds of pulses and counts",
        )
    values = series(path, file, place, ("value", "u"))
    segment = column(path, file, place, "segment") if "segment" in group else np.zeros(len(values[0]))
    role = text(attributes.get("role", "body"))
    inertia, u = (_scalar(attributes, k) for k in ("inertia", "inertia_u"))
    if "inertia" in attributes and not 0 < inertia < math.inf:
        raise RecordError(f"{path}: the moment of inertia of the {name} is {inertia}, not positive")
    return _Body(name, role, inertia, u, place, _QUANTITIES[quantity], values, segment)


def _fitted(path: Path, file: Any, name: str) -> str:
    """Return the place of the series of a body that is fitted."""
    several = _members(path, file, f"body/{name}/series")
    if _FITTED not in several and len(several) != 1:
        raise RecordError(
            f"{path}: the body {name} has {len(several)} series and none is named {_FITTED}",
            f"name the one to be fitted {_FITTED}",
        )
    return f"body/{name}/series/{_FITTED if _FITTED in several else several[0]}"


def _places(path: Path, file: Any) -> dict[str, str]:
    """Return the places of the series of the casing, or the single body, and of the rotor."""
    names = _members(path, file, "body") if "body" in file else []
    roles = {n: text(_own(path, file, f"body/{n}").attrs.get("role", "body")) for n in names}
    return {"rotor" if role == "rotor" else "casing": _fitted(path, file, n) for n, role in roles.items()}


def _members(path: Path, file: Any, place: str) -> list[str]:
    """Return the names in a group, which has at most `_MOST_MEMBERS`."""
    import h5py

    group = _own(path, file, place)
    if not isinstance(group, h5py.Group) or len(group) > _MOST_MEMBERS:
        raise RecordError(
            f"{path}: {place} is not a group of at most {_MOST_MEMBERS} members", "write it again"
        )
    return list(group)


def _modes(path: Path, file: Any, body: _Body) -> Iterator[ErrorMode]:
    """Yield the error modes of the series of a body."""
    where = body.place
    if not where.startswith("body/"):
        where = _places(path, file).get("rotor" if body.role == "rotor" else "casing", "")
    if not where or "error" not in _members(path, file, where):
        return
    for name in _members(path, file, f"{where}/error"):
        place = f"{where}/error/{name}"
        attributes = _own(path, file, place).attrs
        basis = _numbers(path, file, f"{place}/basis", 2)
        if len(basis) != len(body.segment) or basis.shape[1] > MOST_AMPLITUDES:
            raise RecordError(
                f"{path}: {place} has a basis of the shape {basis.shape} for {len(body.segment)} samples",
                f"give one row for each sample, and at most {MOST_AMPLITUDES} columns",
            )
        measured = np.isfinite(body.series[0]) & np.isfinite(body.series[1])
        known: dict[str, Any] = {
            "covariance": _numbers(path, file, f"{place}/covariance", 2),
            "group": text(attributes.get("group")),
            "origin": text(attributes.get("origin")),
        }
        for i, window in enumerate(np.unique(body.segment)):
            rows = measured & (body.segment == window)
            rotor: dict[str, Any] = {"body": "rotor", "window": i} if body.role == "rotor" else {}
            yield ErrorMode(name=name, time=body.series[0][rows], basis=basis[rows], **rotor, **known)


_MOST_MEMBERS = 64
"""Inputs, bodies, series or error modes that are read at most [1]. Chosen: a smaller value refuses large set-ups, a
larger one admits malicious files."""


def _inputs(path: Path, file: Any) -> tuple[Input, ...]:
    """Return the recorded inputs of a case; groups of other kinds are refused."""
    if "input" not in file.keys():  # noqa: SIM118 - `in file` follows links
        return ()
    found = []
    for name in _members(path, file, "input"):
        place = f"input/{name}"
        time, value, u = series(path, file, place, ("value", "u"))
        attributes = _own(path, file, place).attrs
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
    # a rotor without samples has one window without samples, which is refused
    numbers = np.unique(window) if len(window) else np.zeros(1)
    return [(rotor[0][window == w], rotor[1][window == w], rotor[2][window == w]) for w in numbers]


def _correlated(file: Any, place: str) -> tuple[float, float, float, float]:
    """Return the stated errors of the angle of a series (see `Record.correlated`), zeros if they are absent."""
    names = ("correlated_sigma", "correlated_time", "periodic_sigma", "harmonic_sigma")
    sigma, time, periodic, harmonic = (number(file, place, name) for name in names)
    slow = (sigma, time) if math.isfinite(sigma) and math.isfinite(time) else (0.0, 0.0)
    return (*slow, *(x if math.isfinite(x) else 0.0 for x in (periodic, harmonic)))  # type: ignore[return-value]


def _profile(path: Path, file: Any, place: str) -> list[tuple[float, float]]:
    """Return times and uncertainties of the slowly varying error of a series; none where it is constant."""
    value = _own(path, file, place).attrs.get("correlated_profile")
    if value is None:
        return []
    pairs = np.asarray(value)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "fiu":
        raise RecordError(f"{path}: correlated_profile of {place} has no pairs of numbers", "remove it")
    return [(float(t), float(u)) for t, u in pairs]


def _start_sigma(path: Path, file: Any, window: Array, stated: float) -> list[float]:
    """Return the uncertainty of each window's start on the casing's clock [s], of its camera or as stated; NaN if none.

    `stated` is that of the case; it has no camera if it was imported.
    """
    sigma = [_clock_sigma(path, file, f"rotor_{int(w)}") for w in np.unique(window)]
    if not np.isfinite(sigma).any():
        return [stated if np.isfinite(stated) and stated >= 0 else float("nan")] * len(sigma)
    return [s if np.isfinite(s) and s > 0 else 0.0 for s in sigma]


def _clock_sigma(path: Path, file: Any, name: str) -> float:
    """Return the standard uncertainty of the offset of a clock [s], of layout 1 or 2; NaN without one."""
    found = number(file, f"recording/{name}", "clock_offset_sigma")
    if math.isfinite(found) or "clock" not in file or name not in _members(path, file, "clock"):
        return found
    covariance = _numbers(path, file, f"clock/{name}/covariance", 2)
    if covariance.shape != (2, 2) or not (np.isfinite(covariance).all() and covariance[0, 0] >= 0):
        raise RecordError(
            f"{path}: clock/{name} has no covariance of offset and rate", "give a matrix (2, 2)"
        )
    return float(np.sqrt(covariance[0, 0]))
