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
from fitting._dataset import Reader
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


_ROUNDING = 1e-9
"""Asymmetry of a covariance over its largest value that is rounding [1]. Chosen: a smaller value refuses computed
covariances, a larger one accepts invalid ones."""


def defect_of_mode(basis: Any, covariance: Any, samples: int) -> str:
    """Return what is wrong with an error mode of a series, in words; empty if it is right."""
    basis, covariance = (np.asarray(a, dtype=float) for a in (basis, covariance))
    if basis.ndim != 2 or len(basis) != samples or covariance.shape != (basis.shape[1],) * 2:
        return f"has a basis of the shape {basis.shape} and a covariance of {covariance.shape} for {samples} samples"
    asymmetry = np.abs(covariance - covariance.T).max(initial=0.0)
    if not np.isfinite(covariance).all() or asymmetry > _ROUNDING * np.abs(covariance).max(initial=0.0):
        return "has no symmetric covariance"
    return ""


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
        of_layout_1 = bodies is None or "casing" in self.file.keys()  # noqa: SIM118 - `in file` follows links
        attributes, series = self._of_casing(bodies or {}) if of_layout_1 else self._of_bodies(bodies or {})
        self._check_inertias(attributes)
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
            modes = self._modes(self._fitted(bodies[name][1]), len(time)) if name in bodies else ()
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
            quantity = self.reader.attribute(group, "quantity", str, "angle")
            if quantity not in layout.QUANTITIES:
                raise self.reader.fail(
                    f"{location(group)} is of the quantity '{quantity[:20]}', which cannot be fitted.",
                    "`gyrotrack import` makes angles or speeds of pulses and counts.",
                )
            quantities.add(layout.QUANTITIES[quantity])
            columns = self.reader.table(group, layout.FUSED)
            time, value, u = (columns[key] for key in ("time", "value", "u"))
            segment = columns.get("segment", np.zeros(len(time), dtype=np.int64))
            stated = self.reader.attributes(group, layout.SERIES.attributes)
            modes = self._modes(group, len(time))
            found[role] = StoredSeries(name, time, value, u, segment, {}, stated, modes)
            of_body = self.reader.attributes(body, layout.CASE_BODY_ATTRIBUTES)
            inertias |= {f"I_{role}": of_body["inertia"], f"I_{role}_u": of_body["inertia_u"]}
            if "inertia" in body.attrs:
                self._check_inertia(name, of_body["inertia"])
        if len(quantities) > 1:
            raise self.reader.fail(
                f"{self.file.filename} has speeds of one body and angles of the other.",
                "Store the same quantity of both.",
            )
        single = "rotor" not in found
        known = [a for a in layout.CASE_ATTRIBUTES if a.name in {"label", "surface", "start_u"}]
        attributes = {
            **self.reader.attributes(self.file, known),
            **inertias,
            "quantity": quantities.pop(),
            "per_inertia": int(any(math.isnan(inertias[f"I_{role}"]) for role in found)),
            "bodies": "one" if single else "two",
            "body_name": found["casing"].name if single else "",
        }
        if single and attributes["per_inertia"]:
            attributes["I_casing"] = 1.0
        return attributes, (found["casing"], found.get("rotor"))

    def _check_inertias(self, attributes: dict[str, Any]) -> None:
        two = attributes["bodies"] == "two"
        if two and attributes["per_inertia"]:
            raise self.reader.fail(
                f"{self.file.filename} lacks an inertia: torques between two bodies follow from the ratio of inertias.",
                "Store the attribute 'inertia' of both.",
            )
        for name in ("casing", "rotor")[: 1 + two]:
            self._check_inertia(name, attributes[f"I_{name}"])

    def _check_inertia(self, name: str, inertia: float) -> None:
        if not 0 < inertia < math.inf:
            raise self.reader.fail(
                f"{self.file.filename}: the moment of inertia of the {name} is {inertia:g}, not positive.",
                "Store a positive one [kg m2], or none.",
            )

    def _fitted(self, body: Any) -> Any:
        """Return the series of a body that is fitted."""
        several = dict(self.reader.members(body, "series"))
        if layout.FITTED not in several and len(several) != 1:
            raise self.reader.fail(
                f"{location(body)} has {len(several)} series and none is named {layout.FITTED}.",
                f"Name the one to be fitted {layout.FITTED}.",
            )
        return several.get(layout.FITTED) or next(iter(several.values()))

    def _modes(self, series: Any, samples: int) -> tuple[StoredMode, ...]:
        found = []
        for name, group in self.reader.members(series, "error", optional=True):
            mode = StoredMode(name, **self.reader.record(group, layout.ERROR_MODE, {"time": samples}))
            if reason := defect_of_mode(mode.basis, mode.covariance, samples):
                raise self.reader.fail(f"{location(group)} {reason}.", "Correct it, or remove it.")
            found.append(mode)
        return tuple(found)

    def _inputs(self) -> dict[str, dict[str, Any]]:
        found = self.reader.members(self.file, "input", optional=True)
        return {name: self.reader.record(group, layout.INPUT) for name, group in found}

    def _start_u(self) -> dict[str, float]:
        """Return the uncertainty of the starts of the clips [s], of layout 2, and where it exists that of layout 1."""
        found = {}
        for name, clock in self.reader.members(self.file, "clock", optional=True):
            covariance = self.reader.table(clock, layout.CLOCK)["covariance"]
            if not (np.isfinite(covariance).all() and covariance[0, 0] >= 0):
                raise self.reader.fail(
                    f"{location(clock)} has no covariance of offset and rate.",
                    "Store a covariance matrix (2, 2).",
                )
            found[name] = math.sqrt(covariance[0, 0])
        for name, clip in self.reader.members(self.file, "recording", optional=True):
            u = self.reader.attribute(clip, "clock_offset_sigma", float, math.nan)
            if math.isfinite(u):
                found[name] = u
        return found
