"""The layout of a case file: names, types, dimensions, units and meanings of its datasets and attributes.

The tables in this module serve the writer (`gyrotrack.io`), the reader (`fitting._stored_case`), the validation
(`fitting._dataset`) and the format page; `gyrotrack.io._schema` adds the tables of a recording. A `Field` is one HDF5
dataset, an `Attribute` one attribute of its group. Dimensions become dimension scales: dimensions that are also fields
(time, frame) are coordinates, all others (side, xy) are indices.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

FORMAT = "gyrotrack"
MAJOR = 2
"""Major version of the HDF5 layout that the program writes and reads [1]. Derived: the present layout."""
FORMAT_VERSION = f"{MAJOR}.0"
RECORDING = "recording"
CASE = "case"


@dataclass(frozen=True)
class Field:
    """One dataset: name, dimensions, type, unit, meaning, and further attributes.

    A dimension with the name `other_x` has the length of the dimension `x`.
    """

    name: str
    dims: tuple[str, ...]
    units: str
    long_name: str
    dtype: str = "f8"
    attributes: dict[str, Any] = field(default_factory=dict)
    optional: bool = False


@dataclass(frozen=True)
class Attribute:
    """One attribute of a group.

    An attribute is required unless it has a default. `field` is its name in memory. `kind` is the type of the value:
    tuple for an array of pairs of numbers, list for a list of strings, otherwise the type of a scalar. `choices` are
    the allowed values; if there are none, any value is allowed. A number must be finite; NaN is allowed only if NaN is
    the default. NaN and () are not written. With `nan_is_default`, a reader replaces NaN by the default.
    """

    name: str
    kind: type[Any]
    units: str
    long_name: str
    default: Any = None
    field: str = ""
    choices: tuple[str, ...] = ()
    nan_is_default: bool = False

    @property
    def key(self) -> str:
        """Name of the field in memory: `field`, or the name of the attribute."""
        return self.field or self.name


@dataclass(frozen=True)
class Table:
    """The datasets and attributes of a group, and the default plot (NXdata signal), if it has one."""

    fields: tuple[Field, ...]
    signal: str = ""
    attributes: tuple[Attribute, ...] = ()

    def only(self, names: Collection[str]) -> Table:
        """Return the table with some of its datasets."""
        return replace(self, fields=tuple(f for f in self.fields if f.name in names))


def stated_attributes(record: Any, attributes: Iterable[Attribute]) -> dict[str, Any]:
    """Return the attributes of `record` that are written, by their names in a file; NaN and () are not written."""
    found = ((a, a.kind(getattr(record, a.key))) for a in attributes)
    return {
        a.name: value
        for a, value in found
        if value != () and not (is_nan(value) and (a.nan_is_default or is_nan(a.default)))
    }


def is_nan(value: Any) -> bool:
    """Return whether a value of any type is NaN."""
    return isinstance(value, float) and math.isnan(value)


# meaning of each dimension for which there is no dataset
INDICES = {
    "side": "corner of the base: 0, 1",
    "xy": "image axis: x to the right, y down",
    "mode": "number of the amplitude",
    "parameter": "parameter of the clock: 0 offset, 1 rate",
}
LENGTHS = {"side": 2, "xy": 2, "parameter": 2}
"""Lengths of dimensions [1]. Derived: two corners, two axes of an image, offset and rate of a clock."""

_T = ("time",)

# errors of the angle in addition to the sigma of each sample; the slowly varying error of two samples has the
# covariance s^2 exp(-|t - t'| / T)
CORRELATED = (
    Attribute(
        "correlated_sigma",
        float,
        "rad",
        "standard uncertainty of a slowly varying error",
        0.0,
        nan_is_default=True,
    ),
    Attribute("correlated_time", float, "s", "correlation time of this error", 0.0, nan_is_default=True),
    Attribute(
        "correlated_profile",
        tuple,
        "s, rad",
        "times, and the standard uncertainty of this error at each time, (k, 2); absent if the uncertainty is constant",
        (),
    ),
    Attribute(
        "periodic_sigma",
        float,
        "rad",
        "standard uncertainty of an error with one and two periods per turn",
        0.0,
        nan_is_default=True,
    ),
    Attribute(
        "harmonic_sigma",
        float,
        "rad",
        "standard deviation of each amplitude of an error of 1 to 12 periods per turn",
        0.0,
        nan_is_default=True,
    ),
)

_SIGMA_SOURCE = Attribute(
    "sigma_source",
    str,
    "",
    "measured (tracking), given (in a table), estimated (from the scatter), mixed",
    "given",
)

SERIES = Table(
    (
        Field("time", _T, "s", "time on the clock of the casing's camera"),
        Field("angle", _T, "rad", "angle of the body, unwrapped"),
        Field("sigma", _T, "rad", "uncertainty of the angle"),
        Field("omega", _T, "rad s-1", "angular velocity, median-smoothed"),
        Field("omega_sigma", _T, "rad s-1", "uncertainty of the angular velocity"),
        Field("turn", _T, "1", "whole turns in the angle", "i8"),
    ),
    signal="omega",
    attributes=(_SIGMA_SOURCE, *CORRELATED),
)

WINDOWED = Table(
    (*SERIES.fields, Field("window", _T, "1", "rotor clip that the sample came from", "i8")),
    signal="omega",
    attributes=(_SIGMA_SOURCE, *CORRELATED),
)

GENERATED = Table(
    (
        Field("time", _T, "s", "time on the clock of the casing's camera"),
        Field("omega", _T, "rad s-1", "angular velocity of the rotor, generated"),
    ),
    signal="omega",
    attributes=(Attribute("method", str, "", "method that generated the curve"),),
)

INTERPOLATIONS = ("linear", "hold")
INPUT = Table(
    (
        Field("time", _T, "s", "time on the clock of the casing's camera"),
        Field("value", _T, "1", "value of the input, in the unit of the attribute `unit`"),
        Field("u", _T, "1", "standard uncertainty of the value from its calibration; NaN if not given"),
    ),
    signal="value",
    attributes=(
        Attribute("unit", str, "", "unit of value and u, for example A, V, N m, K or 1", "1"),
        Attribute(
            "interpolation",
            str,
            "",
            "between two samples: linear, or hold (the last value)",
            "linear",
            choices=INTERPOLATIONS,
        ),
        Attribute("delay", float, "s", "dead time after which the input acts", 0.0),
    ),
)

CASE_ATTRIBUTES = (
    Attribute("I_rotor", float, "kg m2", "moment of inertia of the rotor", math.nan),
    Attribute("I_casing", float, "kg m2", "moment of inertia of the casing"),
    Attribute("I_rotor_u", float, "kg m2", "standard uncertainty of I_rotor; absent if not given", math.nan),
    Attribute(
        "I_casing_u", float, "kg m2", "standard uncertainty of I_casing; absent if not given", math.nan
    ),
    Attribute(
        "start_u",
        float,
        "s",
        "standard uncertainty of the start of each rotor window; absent if not given",
        math.nan,
    ),
    Attribute("label", str, "", "name of the case", ""),
    Attribute("surface", str, "", "surface on which the casing turned", ""),
    Attribute("quantity", str, "", "what was measured: angle or omega", "angle", choices=("angle", "omega")),
    Attribute(
        "per_inertia",
        int,
        "",
        "1 if no moment of inertia is known: I_casing is 1 and torques are in rad/s2",
        0,
    ),
    Attribute(
        "bodies",
        str,
        "",
        "two, one (a single body, stored as the casing), or chain (several in `/body`, with joints)",
        "two",
        choices=("two", "one", "chain"),
    ),
    Attribute(
        "body_name",
        str,
        "",
        "name of the single body or of the first body of a chain, for example wheel; empty if not given",
        "",
    ),
)

PLACEMENT_ATTRIBUTES = (
    Attribute("clock_offset", float, "s", "start of the clip on the casing camera's clock"),
    Attribute("clock_offset_sigma", float, "s", "standard uncertainty of clock_offset"),
    Attribute("clock_rate", float, "1", "rate of the clip's clock relative to the casing camera's clock"),
    Attribute("clock_rate_sigma", float, "1", "standard uncertainty of clock_rate"),
    Attribute("angle_offset", float, "rad", "angle added to the clip's angles"),
    Attribute("sync_ambiguous", int, "", "1 if the data allow another start of the clip", field="ambiguous"),
    Attribute("sync_method", str, "", "method that gave the start of the clip", field="method"),
)

# datasets of `/casing` and `/rotor` with the measured value and its uncertainty, by `quantity`
MEASURED = {"angle": ("angle", "sigma"), "omega": ("omega", "omega_sigma")}
# names of each measured quantity: in `/body`, and as a key of `MEASURED`
QUANTITIES = {"angle": "angle", "speed": "omega"}
# the series that the fit uses
FITTED_SERIES = "fused"

# `/body/<name>` of a case: the same numbers as in `/casing` or `/rotor`, under names that do not depend on body and
# quantity
FUSED = Table(
    (
        Field("time", _T, "s", "time on the clock of the case"),
        Field("value", _T, "rad or rad s-1", "angle, or angular velocity"),
        Field("u", _T, "rad or rad s-1", "white-noise part of the standard uncertainty of the value"),
        Field(
            "segment", _T, "1", "clip or window of the sample; absent for the first body", "i8", optional=True
        ),
    ),
    signal="value",
    attributes=(
        Attribute(
            "quantity", str, "", "what was measured: angle or speed", "angle", choices=tuple(QUANTITIES)
        ),
        Attribute(
            "clock",
            str,
            "",
            "clock of the times: case (the clock of the casing's camera)",
            "case",
            choices=("case",),
        ),
        *SERIES.attributes,
    ),
)
ERROR_MODE = Table(
    (
        Field("basis", ("time", "mode"), "1", "error of each sample for unit amplitudes"),
        Field("covariance", ("mode", "other_mode"), "1", "covariance of the amplitudes"),
    ),
    attributes=(
        Attribute("group", str, "", "name of the amplitudes, if several series share them", ""),
        Attribute("origin", str, "", "where the error comes from: axis, tilt, start, rate ...", ""),
        Attribute("long_name", str, "", "meaning of the error", ""),
    ),
)
CASE_BODY_ATTRIBUTES = (
    Attribute(
        "role",
        str,
        "",
        "casing, rotor, or body (a single body, or a body of a chain)",
        "body",
        choices=("casing", "rotor", "body"),
    ),
    Attribute(
        "inertia", float, "kg m2", "moment of inertia; absent: torques are per unit of inertia", math.nan
    ),
    Attribute(
        "inertia_u", float, "kg m2", "standard uncertainty of the inertia; absent if not given", math.nan
    ),
    Attribute(
        "place", int, "", "number of the body in a chain; 0 is the first body, which may come to rest", 0
    ),
)
CLOCK = Table(
    (Field("covariance", ("parameter", "other_parameter"), "1", "covariance of offset [s] and rate [1]"),),
    attributes=(
        Attribute("offset", float, "s", "start of the clip on the clock of the case", math.nan),
        Attribute("rate", float, "1", "rate of the clip's clock relative to the clock of the case", math.nan),
    ),
)
JOINT_ATTRIBUTES = (
    Attribute("bodies", list, "", "names of its two bodies, or of one body and `ground`"),
    Attribute("kind", str, "", "bearing, or contact", choices=("bearing", "contact")),
    Attribute("place", int, "", "number of the joint in a chain", 0),
)

# all tables of a case with their paths, for docs/reference/format.md
GROUPS = (
    ("`/casing` of a case", SERIES),
    ("`/rotor` of a case: all windows", WINDOWED),
    ("`/rotor_generated` of a case, only if a generated curve was requested", GENERATED),
    ("`/input/<name>` of a case: a recorded input of the motion", INPUT),
    ("`/body/<name>/series/fused` of a case: the series that the fit uses", FUSED),
    ("`/body/<name>/series/fused/error/<mode>`: an error that its samples share", ERROR_MODE),
    ("`/clock/<name>` of a case: the clock of a clip", CLOCK),
)

# attributes of the groups of a case that are not tables, for docs/reference/format.md
ATTRIBUTES = (
    ("Attributes of a case", CASE_ATTRIBUTES),
    ("Further attributes of `/recording/<name>` in a case", PLACEMENT_ATTRIBUTES),
    ("Attributes of `/body/<name>` in a case", CASE_BODY_ATTRIBUTES),
    ("Attributes of `/joint/<name>` in a case", JOINT_ATTRIBUTES),
)
