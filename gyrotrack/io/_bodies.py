"""Bodies of a case and their file: series with their error modes, clocks and joints (layout 2).

`/body/<name>/series/fused` is the fitted series. `/casing` and `/rotor` of a gyroscope or a single body contain the
same datasets under other names, for older scripts. An error mode is an error common to several samples: the product of
its `basis`, (samples, amplitudes), and amplitudes with the stored covariance.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from fitting import _case_format as layout
from fitting._case_checks import Defect, defect_of_chain, defect_of_clock, defect_of_inertias, defect_of_mode
from fitting._stored_case import StoredSeries
from gyrotrack._errors import UsageError
from gyrotrack.io._records import Case, ErrorMode, Series, from_angles, from_speeds, no_series, series_of
from gyrotrack.io._tables import write_attributes, write_table

_INTEGRAL = "integral of the measured angular velocity, with an arbitrary constant"
_NAME = re.compile(r"[^/\\\0]{1,100}")
# the joints of a gyroscope and of a single body, each with its kind and its bodies
_JOINTS = {
    "one": (("support", "contact", "casing", "ground"),),
    "two": (("bearing", "bearing", "rotor", "casing"), ("touchpoint", "contact", "casing", "ground")),
    "chain": (),
}
# names of the groups of the bodies that older scripts read, in the order of `Case.motions`
_OLD_GROUPS = {"one": ("casing",), "two": ("casing", "rotor"), "chain": ()}


def refuse(subject: str, defect: Defect | None) -> None:
    """Raise a UsageError if there is a defect."""
    if defect:
        raise UsageError(f"{subject}: {defect.what}.", f"{defect.hint[0].upper()}{defect.hint[1:]}.")


def write_bodies(file: Any, case: Case) -> None:
    """Write the groups of bodies, clocks and joints of a case, and the groups that older scripts read.

    A UsageError is raised for a value with which the written file could not be read.
    """
    subject = f"Case '{case.label[:40]}'"
    if case.bodies == "chain":
        refuse(subject, defect_of_chain(case.inertias, case.joints))
    refuse(subject, defect_of_inertias(vars(case)))
    _write_old_groups(file, case)
    for place in range(len(case.motions)):
        _write_body(file, case, place)
    _write_clocks(file, case)
    names = {"casing": case.main_body, "rotor": "rotor", "ground": "ground"}
    joints = [(joint, kind, [names[b] for b in bodies]) for joint, kind, *bodies in _JOINTS[case.bodies]]
    joints += [(joint, "bearing", list(bodies)) for joint, bodies in case.joints.items()]
    for place, (joint, kind, bodies) in enumerate(joints):
        described = SimpleNamespace(bodies=bodies, kind=kind, place=place)
        write_attributes(file.create_group(f"joint/{joint}"), layout.JOINT_ATTRIBUTES, described)


def _write_old_groups(file: Any, case: Case) -> None:
    """Write `/casing` and `/rotor` of a gyroscope or a single body; the rotor of a single body is empty."""
    for name, series in (("casing", case.casing), ("rotor", case.rotor)) if case.bodies != "chain" else ():
        group = file.create_group(name)
        write_table(group, layout.SERIES if series.window is None else layout.WINDOWED, series)
        if case.quantity == "omega":
            group["angle"].attrs["comment"] = _INTEGRAL


def _write_body(file: Any, case: Case, place: int) -> None:
    """Write the body with the index `place` in a case: attributes, series and error modes of the series."""
    name, series = case.motions[place]
    value, u = layout.MEASURED[case.quantity]
    group = file.create_group(f"body/{name}")
    role = ("casing", "rotor")[place] if case.bodies == "two" else "body"
    inertia, inertia_u = (math.nan, math.nan) if case.per_inertia else case.inertias[name]
    body = SimpleNamespace(role=role, inertia=inertia, inertia_u=inertia_u, place=place)
    write_attributes(group, layout.CASE_BODY_ATTRIBUTES, body)
    fused = group.create_group(f"series/{layout.FITTED_SERIES}")
    columns = {"time": "time", "value": value, "u": u}
    columns |= {} if series.window is None or case.bodies == "one" else {"segment": "window"}
    quantity = {old: new for new, old in layout.QUANTITIES.items()}[case.quantity]
    of_series = SimpleNamespace(**{**vars(series), "quantity": quantity, "clock": "case"})
    if old := _OLD_GROUPS[case.bodies]:
        for column, stored in columns.items():
            fused[column] = file[f"{old[place]}/{stored}"]
        write_attributes(fused, layout.FUSED.attributes, of_series)
    else:
        arrays = {column: getattr(series, stored) for column, stored in columns.items()}
        write_table(fused, layout.FUSED.only(columns), of_series, **arrays)
        for column in ("value", "u"):
            fused[column].attrs["units"] = "rad" if case.quantity == "angle" else "rad s-1"
    measured = np.isfinite(series.time) & np.isfinite(getattr(series, value))
    for mode in series.modes:
        subject = f"Error mode '{mode.name[:40]}' of the {name}"
        refuse(subject, defect_of_mode(mode.basis, mode.covariance, measured))
        if not _NAME.fullmatch(mode.name) or mode.name in fused.get("error", ()):
            raise UsageError(f"{subject} has no unique name.", "See gyrotrack.ErrorMode.")
        own = fused.require_group("error").create_group(mode.name)
        write_table(own, layout.ERROR_MODE, mode, {"time": fused["time"]})


def _write_clocks(file: Any, case: Case) -> None:
    """Write offset and rate of each clip's clock with their covariance; the clock of the case has no uncertainty."""
    known = case.extra.get("sync_covariance", {})
    for name, placement in case.placements.items():
        covariance = np.diag([placement.clock_offset_sigma**2, placement.clock_rate_sigma**2])
        if name in known:
            # the correlation is from the synchronisation, and the variances are from the stated uncertainties
            found = np.array(known[name], dtype=float)[:2, :2]
            scale = np.sqrt(np.diag(covariance) / np.maximum(np.diag(found), 1e-300))
            covariance = found * np.outer(scale, scale)
        refuse(f"Clock of '{name}'", defect_of_clock(covariance))
        clock = SimpleNamespace(offset=placement.clock_offset, rate=placement.clock_rate)
        write_table(file.create_group(f"clock/{name}"), layout.CLOCK, clock, covariance=covariance)


def series_from(stored: StoredSeries, quantity: str) -> Series:
    """Return a series from its stored datasets.

    If a file contains only `/body`, angular velocities are computed from angles, or angles from angular velocities.
    """
    modes = tuple(ErrorMode(**vars(mode)) for mode in stored.modes)
    if stored.columns:
        return Series(**stored.columns, **stored.stated, modes=modes)
    if not len(stored.time):
        return replace(no_series(), modes=modes, **stored.stated)
    made = from_speeds if quantity == "omega" else from_angles
    order = np.argsort(stored.segment, kind="stable")
    segment = stored.segment[order]
    motion = [a[order] for a in (stored.time, stored.value, stored.u)]
    found = series_of([made(*(a[segment == s] for a in motion)) for s in np.unique(segment)])
    modes = tuple(replace(m, basis=m.basis[order]) for m in modes)
    return replace(found, modes=modes, window=segment, **stored.stated)
