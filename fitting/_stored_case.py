"""The reader of a case file, layout 1 or 2, for both packages.

`/casing` and `/rotor` are the groups of layout 1. Older scripts read and change these groups; if they exist, their
values are used. Without them, and in every file of a chain of bodies, the series are in `/body`. Clocks, inputs and
error modes are at the same places in both layouts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting import _case_format as layout
from fitting._case_checks import (
    Defect,
    defect_of_chain,
    defect_of_clock,
    defect_of_inertia,
    defect_of_inertias,
    defect_of_mode,
)
from fitting._dataset import SHOWN, Reader
from fitting._hdf5 import location

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class StoredMode:
    """An error that the samples of a series share: its basis, (samples, amplitudes), and their covariance."""

    name: str
    basis: Array
    covariance: Array
    group: str
    origin: str
    long_name: str


@dataclass(frozen=True)
class StoredSeries:
    """The series of a body that is fitted."""

    name: str  # name of the body; may be empty
    time: Array
    value: Array  # measured values [rad or rad/s]
    u: Array
    segment: Integers
    columns: dict[str, Any]  # arrays of `/casing` or `/rotor`; empty if the file has none
    stated: dict[str, Any]  # attributes of `layout.SERIES`
    modes: tuple[StoredMode, ...]
    # moment of inertia of a body of a chain, with its uncertainty [kg m2]
    inertia: tuple[float, float] = (math.nan, math.nan)


@dataclass(frozen=True)
class StoredCase:
    """The contents of a case file, except its recordings."""

    attributes: dict[str, Any]  # attributes of `layout.CASE_ATTRIBUTES`
    casing: StoredSeries  # the casing, the single body, or the first body of a chain
    others: tuple[StoredSeries, ...]  # the rotor, or the other bodies of a chain
    inputs: dict[str, dict[str, Any]]  # datasets and attributes of `layout.INPUT` by name
    start_u: dict[str, float]  # standard uncertainty of the start of each clip by name [s]
    joints: dict[str, tuple[str, ...]] = field(
        default_factory=dict
    )  # the two bodies of each joint of a chain


class _Body(NamedTuple):
    """A group in `/body`, and the attributes of `layout.CASE_BODY_ATTRIBUTES`."""

    name: str
    group: Any
    stated: dict[str, Any]


def read_stored_case(file: Any, reader: Reader, *, every_column: bool = False) -> StoredCase:
    """Read an open case file.

    Only the fitted columns of `/casing` and `/rotor` are read, unless `every_column` is set.
    """
    return _CaseReader(file, reader, every_column).case()


@dataclass(frozen=True)
class _CaseReader:
    """A case file, its reader, and whether every column of `/casing` and `/rotor` is read."""

    file: Any
    reader: Reader
    every_column: bool

    def case(self) -> StoredCase:
        bodies = self._bodies()
        has_casing = "casing" in self.file.keys()  # noqa: SIM118 - `in file` follows links
        joints = self._joints() if bodies and _is_chain(bodies) else {}
        of_casing = bodies is None or (has_casing and not _is_chain(bodies))
        attributes, series = self._of_casing(bodies or []) if of_casing else self._of_bodies(bodies or [])
        if len(series) > 1 and attributes["bodies"] == "chain":
            self._refuse(self.file.filename, defect_of_chain({s.name: s.inertia for s in series}, joints))
        self._refuse(self.file.filename, defect_of_inertias(attributes))
        if "label" not in self.file.attrs:
            attributes["label"] = Path(self.file.filename).stem
        return StoredCase(attributes, series[0], tuple(series[1:]), self._inputs(), self._start_u(), joints)

    def _bodies(self) -> list[_Body] | None:
        """Return the bodies in `/body`, the main body first; None without `/body`."""
        if "body" not in self.file.keys():  # noqa: SIM118 - `in file` follows links
            return None
        bodies = [
            _Body(name, group, self.reader.attributes(group, layout.CASE_BODY_ATTRIBUTES))
            for name, group in self.reader.members(self.file, "body")
        ]
        roles = sorted(b.stated["role"] for b in bodies)
        if roles not in (["casing"], ["casing", "rotor"]) and {*roles} != {"body"}:
            raise self.reader.fail(
                f"{self.file.filename} has bodies of the roles {', '.join(roles) or '(none)'}.",
                "A case has one body, one casing and one rotor, or several of the role body with joints.",
            )
        places = [b.stated["place"] for b in bodies]
        if _is_chain(bodies) and len({*places}) < len(places):
            raise self.reader.fail(
                f"{self.file.filename} has two bodies of the same place.",
                "Number the bodies with the attribute 'place', from 0 for the body that may come to rest.",
            )
        return sorted(bodies, key=lambda b: (b.stated["role"] == "rotor", b.stated["place"]))

    def _joints(self) -> dict[str, tuple[str, ...]]:
        """Return the two bodies of each joint of a chain by name; joints with the ground are left out."""
        found = []
        for name, group in self.reader.members(self.file, "joint", optional=True):
            joint = self.reader.attributes(group, layout.JOINT_ATTRIBUTES)
            if len(joint["bodies"]) != 2:
                raise self.reader.fail(
                    f"{location(group)} names {len(joint['bodies'])} of two bodies.",
                    "Give the names of both bodies.",
                )
            if "ground" not in joint["bodies"]:
                found.append((joint["place"], name, tuple(joint["bodies"])))
        return {name: bodies for _, name, bodies in sorted(found)}

    def _of_casing(self, bodies: list[_Body]) -> tuple[dict[str, Any], list[StoredSeries]]:
        """Return the attributes and the series of a file with `/casing`."""
        self.reader.child_group(self.file, "casing")
        attributes = self.reader.attributes(self.file, layout.CASE_ATTRIBUTES)
        if attributes["bodies"] == "chain":
            raise self.reader.fail(
                f"{self.file.filename} lacks the bodies of its chain.",
                "The file is not complete; create it again.",
            )
        value, u = layout.MEASURED[attributes["quantity"]]
        # a single body is stored as the casing
        groups = {"rotor" if b.stated["role"] == "rotor" else "casing": b.group for b in bodies}

        def series(name: str, shown: str, table: layout.Table) -> StoredSeries:
            group = self.reader.child_group(self.file, name)
            fitted = table.only(("time", value, u, "window"))
            columns = self.reader.table(group, table if self.every_column else fitted)
            time = columns["time"]
            segment = columns.get("window", np.zeros(len(time), dtype=np.int64))
            stated = self.reader.attributes(group, table.attributes)
            measured = _is_measured(time, columns[value])
            modes = self._modes(self._fitted(groups[name]), measured) if name in groups else ()
            return StoredSeries(shown, time, columns[value], columns[u], segment, columns, stated, modes)

        casing = series("casing", attributes["body_name"], layout.SERIES)
        if attributes["bodies"] == "two":
            return attributes, [casing, series("rotor", "rotor", layout.WINDOWED)]
        if math.isnan(attributes["I_rotor"]):
            attributes["I_rotor"] = 1.0
        return attributes, [casing]

    def _of_bodies(self, bodies: list[_Body]) -> tuple[dict[str, Any], list[StoredSeries]]:
        """Return the attributes and the series of a file with bodies alone."""
        quantities, found = set(), []
        for name, body, of_body in bodies:
            group = self._fitted(body)
            # the quantity is checked here, because this hint is more specific than the hint of the table
            quantity = self.reader.attribute(group, "quantity", str, "angle")
            if quantity not in layout.QUANTITIES:
                raise self.reader.fail(
                    f"{location(group)} is of the quantity '{quantity[:SHOWN]}', which cannot be fitted.",
                    "`gyrotrack import` makes angles or speeds of pulses and counts.",
                )
            quantities.add(layout.QUANTITIES[quantity])
            columns = self.reader.table(group, layout.FUSED)
            stated = self.reader.attributes(group, layout.FUSED.attributes)
            stated = {a.key: stated[a.key] for a in layout.SERIES.attributes}
            time, value, u = (columns[key] for key in ("time", "value", "u"))
            segment = columns.get("segment", np.zeros(len(time), dtype=np.int64))
            modes = self._modes(group, _is_measured(time, value))
            inertia = of_body["inertia"], of_body["inertia_u"]
            shown = name if of_body["role"] == "body" else of_body["role"]
            found.append(StoredSeries(shown, time, value, u, segment, {}, stated, modes, inertia))
            if "inertia" in body.attrs:
                defect = defect_of_inertia(name, *inertia, optional=len(bodies) == 1)
                self._refuse(self.file.filename, defect)
        if len(quantities) > 1:
            raise self.reader.fail(
                f"{self.file.filename} has speeds of one body and angles of the other.",
                "Store the same quantity of both.",
            )
        gyroscope, chain = bodies[-1].stated["role"] == "rotor", _is_chain(bodies)
        rotor = found[1].inertia if gyroscope else (1.0, math.nan)
        derived = {
            "I_casing": found[0].inertia[0],
            "I_casing_u": found[0].inertia[1],
            "I_rotor": rotor[0],
            "I_rotor_u": rotor[1],
            "quantity": quantities.pop(),
            "per_inertia": int(any(math.isnan(s.inertia[0]) for s in found)),
            "bodies": "two" if gyroscope else "chain" if chain else "one",
            "body_name": "" if gyroscope else found[0].name,
        }
        if len(found) == 1 and derived["per_inertia"]:
            derived["I_casing"] = 1.0
        stored = [a for a in layout.CASE_ATTRIBUTES if a.key not in derived]
        attributes = {**self.reader.attributes(self.file, stored), **derived}
        return attributes, found

    def _refuse(self, place: str, defect: Defect | None) -> None:
        """Raise the error of a defect, if there is one."""
        if defect:
            hint = f"{defect.hint[0].upper()}{defect.hint[1:]}."
            raise self.reader.fail(f"{place}: {defect.what}.", hint)

    def _fitted(self, body: Any) -> Any:
        """Return the series of a body that is fitted."""
        several = dict(self.reader.members(body, "series"))
        if layout.FITTED_SERIES not in several and len(several) != 1:
            raise self.reader.fail(
                f"{location(body)} has {len(several)} series and none is named {layout.FITTED_SERIES}.",
                f"Name the series to be fitted {layout.FITTED_SERIES}.",
            )
        return several.get(layout.FITTED_SERIES) or next(iter(several.values()))

    def _modes(self, series: Any, measured: Any) -> tuple[StoredMode, ...]:
        """Return the error modes of a series; `measured` is the mask of its samples that have a value."""
        found = []
        for name, group in self.reader.members(series, "error", optional=True):
            mode = StoredMode(name, **self.reader.record(group, layout.ERROR_MODE, {"time": len(measured)}))
            self._refuse(location(group), defect_of_mode(mode.basis, mode.covariance, measured))
            found.append(mode)
        return tuple(found)

    def _inputs(self) -> dict[str, dict[str, Any]]:
        found = self.reader.members(self.file, "input", optional=True)
        return {name: self.reader.record(group, layout.INPUT) for name, group in found}

    def _start_u(self) -> dict[str, float]:
        """Return the uncertainty of the starts of the clips [s].

        `clock_offset_sigma` of layout 1 takes precedence over `/clock`.
        """
        found = {}
        for name, clip in self.reader.members(self.file, "recording", optional=True):
            u = self.reader.attribute(clip, "clock_offset_sigma", float, math.nan)
            if math.isfinite(u):
                found[name] = u
        for name, clock in self.reader.members(self.file, "clock", optional=True):
            if name not in found:
                covariance = self.reader.record(clock, layout.CLOCK)["covariance"]
                self._refuse(location(clock), defect_of_clock(covariance))
                found[name] = math.sqrt(covariance[0, 0])
        return found


def _is_measured(time: Array, value: Array) -> Any:
    """Return the mask of the samples with a value."""
    return np.isfinite(time) & np.isfinite(value)


def _is_chain(bodies: list[_Body]) -> bool:
    """Return whether the bodies form a chain with named joints, unlike a single body or a gyroscope."""
    return len(bodies) > 1 and bodies[0].stated["role"] == "body"
