"""The reader of a case file, layout 1 or 2, for both packages.

`/casing` and `/rotor` are those of layout 1, which older scripts read and change: where they exist, their values count.
A file without them has its series in `/body`. Clocks, inputs and error modes are read from the same places in both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting import _case_format as layout
from fitting._case_checks import (
    Defect,
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

    name: str  # of the body; may be empty
    time: Array
    value: Array  # [rad or rad/s]
    u: Array
    segment: Integers
    columns: dict[str, Any]  # arrays of `/casing` or `/rotor`; empty if the file has none
    stated: dict[str, Any]  # attributes of `layout.SERIES`
    modes: tuple[StoredMode, ...]


@dataclass(frozen=True)
class StoredCase:
    """The contents of a case file, except its recordings."""

    attributes: dict[str, Any]  # of `layout.CASE_ATTRIBUTES`
    casing: StoredSeries  # or the single body
    rotor: StoredSeries | None
    inputs: dict[str, dict[str, Any]]  # datasets and attributes of `layout.INPUT` by name
    start_u: dict[str, float]  # standard uncertainty of the start of each clip by name [s]


def read_stored_case(file: Any, reader: Reader, *, every_column: bool = False) -> StoredCase:
    """Read an open case file; of `/casing` and `/rotor` only what is fitted, or every column."""
    return _CaseReader(file, reader, every_column).case()


@dataclass(frozen=True)
class _CaseReader:
    """A case file, its reader, and whether every column of `/casing` and `/rotor` is read."""

    file: Any
    reader: Reader
    every_column: bool

    def case(self) -> StoredCase:
        bodies = self._bodies()
        has_casing = bodies is None or "casing" in self.file.keys()  # noqa: SIM118 - `in file` follows links
        attributes, series = self._of_casing(bodies or {}) if has_casing else self._of_bodies(bodies or {})
        self._refuse(self.file.filename, defect_of_inertias(attributes))
        if "label" not in self.file.attrs:
            attributes["label"] = Path(self.file.filename).stem
        return StoredCase(attributes, *series, self._inputs(), self._start_u())

    def _bodies(self) -> dict[str, tuple[str, Any]] | None:
        """Return name and group of each body in `/body` by its role; None without `/body`."""
        if "body" not in self.file.keys():  # noqa: SIM118 - `in file` follows links
            return None
        found = self.reader.members(self.file, "body")
        bodies = {
            self.reader.attributes(group, layout.CASE_BODY_ATTRIBUTES)["role"]: (name, group)
            for name, group in found
        }
        known = bodies.keys() in ({"body"}, {"casing"}, {"casing", "rotor"})
        if not known or len(bodies) < len(found):
            roles = ", ".join(sorted(bodies)) or "(none)"
            raise self.reader.fail(
                f"{self.file.filename} has bodies of the roles {roles}.",
                "A case has one body, or one casing and one rotor.",
            )
        # a single body is stored as the casing
        return {"casing" if role == "body" else role: body for role, body in bodies.items()}

    def _of_casing(
        self, bodies: dict[str, tuple[str, Any]]
    ) -> tuple[dict[str, Any], tuple[StoredSeries, StoredSeries | None]]:
        """Return the attributes and the series of a file with `/casing`."""
        self.reader.child_group(self.file, "casing")
        attributes = self.reader.attributes(self.file, layout.CASE_ATTRIBUTES)
        value, u = layout.MEASURED[attributes["quantity"]]

        def series(name: str, shown: str, table: layout.Table) -> StoredSeries:
            group = self.reader.child_group(self.file, name)
            fitted = table.only(("time", value, u, "window"))
            columns = self.reader.table(group, table if self.every_column else fitted)
            time = columns["time"]
            segment = columns.get("window", np.zeros(len(time), dtype=np.int64))
            stated = self.reader.attributes(group, table.attributes)
            measured = _is_measured(time, columns[value])
            modes = self._modes(self._fitted(bodies[name][1]), measured) if name in bodies else ()
            return StoredSeries(shown, time, columns[value], columns[u], segment, columns, stated, modes)

        casing = series("casing", attributes["body_name"], layout.SERIES)
        if attributes["bodies"] == "two":
            return attributes, (casing, series("rotor", "rotor", layout.WINDOWED))
        if math.isnan(attributes["I_rotor"]):
            attributes["I_rotor"] = 1.0
        return attributes, (casing, None)

    def _of_bodies(
        self, bodies: dict[str, tuple[str, Any]]
    ) -> tuple[dict[str, Any], tuple[StoredSeries, StoredSeries | None]]:
        """Return the attributes and the series of a file with bodies alone."""
        quantities, found, inertias = set(), {}, {"I_rotor": 1.0, "I_rotor_u": math.nan}
        for role, (name, body) in bodies.items():
            group = self._fitted(body)
            # the hint of the table is not specific
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
            found[role] = StoredSeries(name, time, value, u, segment, {}, stated, modes)
            of_body = self.reader.attributes(body, layout.CASE_BODY_ATTRIBUTES)
            inertias |= {f"I_{role}": of_body["inertia"], f"I_{role}_u": of_body["inertia_u"]}
            if "inertia" in body.attrs:
                inertia, u = of_body["inertia"], of_body["inertia_u"]
                defect = defect_of_inertia(name, inertia, u, optional=role == "casing" and len(bodies) == 1)
                self._refuse(self.file.filename, defect)
        if len(quantities) > 1:
            raise self.reader.fail(
                f"{self.file.filename} has speeds of one body and angles of the other.",
                "Store the same quantity of both.",
            )
        single = "rotor" not in found
        derived = {
            **inertias,
            "quantity": quantities.pop(),
            "per_inertia": int(any(math.isnan(inertias[f"I_{role}"]) for role in found)),
            "bodies": "one" if single else "two",
            "body_name": found["casing"].name if single else "",
        }
        if single and derived["per_inertia"]:
            derived["I_casing"] = 1.0
        stored = [a for a in layout.CASE_ATTRIBUTES if a.key not in derived]
        attributes = {**self.reader.attributes(self.file, stored), **derived}
        return attributes, (found["casing"], found.get("rotor"))

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
                f"Name the one to be fitted {layout.FITTED_SERIES}.",
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
