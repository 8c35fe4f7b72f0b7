"""The bodies of a case in its file: series with their error modes, clocks and joints (layout 2).

`/body/<name>/series/fused` is the series that is fitted. Its datasets are those of `/casing` and `/rotor` under other
names, which older scripts read; a file without those two groups is read, too. An error mode is an error that samples
share: the columns of its `basis`, (samples, amplitudes), times amplitudes of the stated covariance.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io import _schema as layout
from gyrotrack.io._records import Case, ErrorMode, Series, from_angles, from_speeds, no_series, series_of
from gyrotrack.io._tables import (
    attribute,
    check_storage,
    child,
    child_group,
    create_dataset,
    load,
    write_attributes,
)

FUSED = "fused"
_SERIES = {"angle": ("angle", "sigma"), "speed": ("omega", "omega_sigma")}
_NAME = re.compile(r"[^/\\\0]{1,100}")
# bodies, series of a body, and error modes of a series at most
_MOST = 64
# series of a case and the roles of their bodies, and joints with their kind and bodies, by the number of bodies
_ROLES = {"one": {"casing": "body"}, "two": {"casing": "casing", "rotor": "rotor"}}
_JOINTS = {
    "one": (("support", "contact", "casing", "ground"),),
    "two": (("bearing", "bearing", "rotor", "casing"), ("touchpoint", "contact", "casing", "ground")),
}
# columns of a series beside time, value and uncertainty, by the role of the body
_COLUMNS = {"rotor": {"segment": "window"}}


def write_bodies(file: Any, case: Case) -> None:
    """Write the groups of bodies, clocks and joints beside `/casing` and `/rotor` of a case."""
    quantity = "speed" if case.quantity == "omega" else "angle"
    names = {"casing": case.main_body, "rotor": "rotor", "ground": "ground"}
    for old, role in _ROLES[case.bodies].items():
        name, series = names[old], getattr(case, old)
        group = file.create_group(f"body/{name}")
        group.attrs["role"] = role
        if not case.per_inertia:
            group.attrs["inertia"], group.attrs["inertia_units"] = (
                getattr(case, f"I_{old}"),
                "kg m2",
            )
            u = getattr(case, f"I_{old}_u")
            if math.isfinite(u):
                group.attrs["inertia_u"], group.attrs["inertia_u_units"] = u, "kg m2"
        fused = group.create_group(f"series/{FUSED}")
        fused.attrs["quantity"], fused.attrs["clock"] = quantity, "case"
        value, u_name = _SERIES[quantity]
        columns = {"time": "time", "value": value, "u": u_name} | _COLUMNS.get(role, {})
        for column, stored in columns.items():
            fused[column] = file[f"{old}/{stored}"]
        write_attributes(fused, layout.SERIES.attributes, series)
        for mode in series.modes:
            reason = _defect(mode, len(series.time))
            if reason or not _NAME.fullmatch(mode.name) or mode.name in fused.get("error", ()):
                what = f"The error mode '{mode.name[:40]}' of the {name} {reason or 'has no unique name'}."
                raise UsageError(what, "See gyrotrack.ErrorMode.")
            _write_mode(fused.require_group("error").create_group(mode.name), mode, fused["time"])
    _write_clocks(file, case)
    for name, kind, *bodies in _JOINTS[case.bodies]:
        group = file.create_group(f"joint/{name}")
        group.attrs["bodies"], group.attrs["kind"] = [names[b] for b in bodies], kind


def _write_mode(group: Any, mode: ErrorMode, time: Any) -> None:
    _write_matrix(group, "basis", mode.basis, "error of each sample for unit amplitudes", (time, "mode"))
    meaning = "covariance of the amplitudes"
    _write_matrix(group, "covariance", mode.covariance, meaning, ("mode", "other_mode"))
    group.attrs["group"], group.attrs["origin"] = mode.group, mode.origin
    group.attrs["long_name"] = mode.long_name


def _write_matrix(group: Any, name: str, values: Any, meaning: str, scales: tuple[Any, str]) -> None:
    """Write a matrix with its dimension scales; a scale by name counts its rows or columns."""
    values = np.asarray(values, dtype=float)
    dataset = create_dataset(group, name, values)
    dataset.attrs["long_name"], dataset.attrs["units"] = meaning, "1"
    for axis, scale in enumerate(scales):
        if isinstance(scale, str):
            if scale not in group:
                made = create_dataset(group, scale, np.arange(values.shape[axis]))
                made.attrs["long_name"], made.attrs["units"] = "number of the amplitude", "1"
                made.make_scale(scale)
            scale = group[scale]
        dataset.dims[axis].attach_scale(scale)


def _write_clocks(file: Any, case: Case) -> None:
    """Write offset and rate of each clip's clock with their covariance; the case's own clock has none."""
    known = case.extra.get("sync_covariance", {})
    for name, placement in case.placements.items():
        group = file.create_group(f"clock/{name}")
        group.attrs["offset"], group.attrs["offset_units"] = placement.clock_offset, "s"
        group.attrs["rate"] = placement.clock_rate
        covariance = np.diag([placement.clock_offset_sigma**2, placement.clock_rate_sigma**2])
        if name in known:
            # the correlation is that of the synchronisation, the variances are those that are stated
            found = np.array(known[name], dtype=float)[:2, :2]
            scale = np.sqrt(np.diag(covariance) / np.maximum(np.diag(found), 1e-300))
            covariance = found * np.outer(scale, scale)
        meaning = "covariance of offset [s] and rate [1]"
        _write_matrix(group, "covariance", covariance, meaning, ("parameter", "other_parameter"))


def load_modes(file: Any, role: str) -> tuple[ErrorMode, ...]:
    """Return the error modes of the casing (or the single body), or of the rotor."""
    if "body" not in file.keys():  # noqa: SIM118 - `in file` follows links
        return ()
    roles = {"rotor"} if role == "rotor" else {"casing", "body"}
    series = [_fused(b) for _, b in _bodies(file) if attribute(b, "role", str, "body") in roles]
    return _modes(series[0], len(child(series[0], "time"))) if series else ()


def _modes(series: Any, samples: int) -> tuple[ErrorMode, ...]:
    if "error" not in series.keys():  # noqa: SIM118 - `in series` follows links
        return ()
    found = []
    for name, group in _groups(series, "error"):
        basis, covariance = (_matrix(group, key) for key in ("basis", "covariance"))
        words = {key: attribute(group, key, str, "") for key in ("group", "origin", "long_name")}
        mode = ErrorMode(name=name, basis=basis, covariance=covariance, **words)
        if reason := _defect(mode, samples):
            raise DatasetError(
                f"{group.file.filename}: {group.name} {reason}.", "The file is not in this layout."
            )
        found.append(mode)
    return tuple(found)


def _defect(mode: ErrorMode, samples: int) -> str:
    """Return what is wrong with an error mode of a series, in words; empty if it is right."""
    basis, covariance = (np.asarray(a, dtype=float) for a in (mode.basis, mode.covariance))
    if basis.ndim != 2 or len(basis) != samples or covariance.shape != (basis.shape[1],) * 2:
        return f"has a basis of the shape {basis.shape} and a covariance of {covariance.shape} for {samples} samples"
    if not np.isfinite(covariance).all() or np.abs(covariance - covariance.T).max(
        initial=0.0
    ) > 1e-9 * np.abs(covariance).max(initial=0.0):
        return "has no symmetric covariance"
    return ""


def _groups(parent: Any, name: str) -> list[tuple[str, Any]]:
    group = child_group(parent, name)
    if len(group) > _MOST:
        what = f"{parent.file.filename} has {len(group)} members in '{name}'; at most {_MOST} are allowed."
        raise DatasetError(what, "The file is not in this layout.")
    return [(member, child_group(group, member)) for member in group]


def _bodies(file: Any) -> list[tuple[str, Any]]:
    return _groups(file, "body")


def _fused(body: Any) -> Any:
    several = dict(_groups(body, "series"))
    if FUSED not in several and len(several) != 1:
        what = f"{body.file.filename}: {body.name} has {len(several)} series, and none is named '{FUSED}'."
        raise DatasetError(what, f"Name the one that is to be fitted '{FUSED}'.")
    return several.get(FUSED) or next(iter(several.values()))


def _matrix(group: Any, name: str, dimensions: int = 2) -> npt.NDArray[np.float64]:
    dataset = child(group, name)
    check_storage(dataset)
    if dataset.ndim != dimensions:
        what = f"{group.file.filename}: {dataset.name} has {dataset.ndim} dimensions, not {dimensions}."
        raise DatasetError(what, "The file is not in this layout.")
    return load(dataset).astype(float)


def load_bodies(file: Any) -> dict[str, Any]:
    """Return the fields of a `Case` that has bodies only, without `/casing` and `/rotor`.

    Angular velocities are computed from angles, and the other way round.
    """
    found = _bodies(file)
    bodies = {attribute(b, "role", str, "body"): (n, b) for n, b in found}
    if bodies.keys() not in ({"body"}, {"casing"}, {"casing", "rotor"}) or len(bodies) < len(found):
        what = f"{file.filename} has bodies of the roles {', '.join(sorted(bodies)) or '(none)'}."
        raise DatasetError(what, "A case has one body, or one casing and one rotor.")
    two = "rotor" in bodies
    main_name, main = bodies["casing"] if "casing" in bodies else bodies["body"]
    quantity = attribute(_fused(main), "quantity", str, "angle")
    if quantity not in _SERIES:
        what = f"{file.filename}: the series of '{main_name}' is of the quantity '{quantity[:20]}'."
        raise DatasetError(what, f"Use one of {', '.join(_SERIES)}.")
    if two and attribute(_fused(bodies["rotor"][1]), "quantity", str, "angle") != quantity:
        what = f"{file.filename} has speeds of one body and angles of the other."
        raise DatasetError(what, "Store the same quantity of both.")
    inertia, inertia_u = _inertia(main)
    rotor_inertia, rotor_u = _inertia(bodies["rotor"][1]) if two else (1.0, math.nan)
    if two and math.isnan(inertia + rotor_inertia):
        what = f"{file.filename} lacks the inertia of a body: torques between two bodies follow from their ratio."
        raise DatasetError(what, "Store the attribute 'inertia' of both.")
    return {
        "I_casing": 1.0 if math.isnan(inertia) else inertia,
        "I_casing_u": inertia_u,
        "I_rotor": rotor_inertia,
        "I_rotor_u": rotor_u,
        "per_inertia": int(math.isnan(inertia)),
        "label": attribute(file, "label", str, "case"),
        "surface": attribute(file, "surface", str, ""),
        "start_u": attribute(file, "start_u", float, math.nan),
        "quantity": "omega" if quantity == "speed" else "angle",
        "bodies": "two" if two else "one",
        "body_name": "" if two else main_name,
        "casing": replace(_series(_fused(main), quantity), window=None),
        "rotor": _series(_fused(bodies["rotor"][1]), quantity) if two else no_series(),
    }


def _inertia(body: Any) -> tuple[float, float]:
    """Return the moment of inertia and its standard uncertainty; NaN without them."""
    inertia = attribute(body, "inertia", float, math.nan)
    if inertia <= 0:
        what = f"{body.file.filename}: the moment of inertia of {body.name} is {inertia}."
        raise DatasetError(what, "Store a positive one [kg m2], or none.")
    return inertia, attribute(body, "inertia_u", float, math.nan)


def _series(group: Any, quantity: str) -> Series:
    time, value, u = (_matrix(group, name, 1) for name in ("time", "value", "u"))
    if not len(time) == len(value) == len(u):
        what = f"{group.file.filename}: the columns of {group.name} have different lengths."
        raise DatasetError(what, "The file is not in this layout.")
    segment = _matrix(group, "segment", 1) if "segment" in group.keys() else np.zeros(len(time))  # noqa: SIM118
    made = from_speeds if quantity == "speed" else from_angles
    order = np.argsort(segment, kind="stable")
    time, value, u, segment = (a[order] for a in (time, value, u, segment))
    parts = [made(*(a[segment == s] for a in (time, value, u))) for s in np.unique(segment)]
    found = series_of(parts, sigma_source=attribute(group, "sigma_source", str, "given"))
    stated = {a.key: attribute(group, a.name, a.kind, a.default) for a in layout.CORRELATED}
    modes = tuple(replace(m, basis=m.basis[order]) for m in _modes(group, len(order)))
    return replace(found, modes=modes, window=segment.astype(np.int64), **stated)
