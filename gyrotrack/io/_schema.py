"""The HDF5 schema: names, types, dimensions, units and meanings of all datasets and attributes.

Writing, reading, validation and docs/reference/format.md use the tables in this module. A `Field` is one HDF5 dataset,
an `Attribute` one scalar attribute of its group. Dimensions become dimension scales: those that are also fields (time,
frame) are coordinates, the others (side, xy) are indices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from fitting._files import MAJOR

FORMAT_VERSION = f"{MAJOR}.0"
RECORDING = "recording"
CASE = "case"

STATUS = {"ok": 0, "blurred": 1, "occluded": 2, "out_of_frame": 3, "lost": 4}


@dataclass(frozen=True)
class Field:
    """One dataset: name, dimensions, type, unit, meaning, and further attributes."""

    name: str
    dims: tuple[str, ...]
    units: str
    long_name: str
    dtype: str = "f8"
    attributes: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Attribute:
    """One attribute, required unless it has a default; NaN and () are not written; `field` is its name in memory.

    A scalar, or pairs of numbers if its kind is tuple.
    """

    name: str
    kind: type[Any]
    units: str
    long_name: str
    default: Any = None
    field: str = ""

    @property
    def key(self) -> str:
        """Name in the record in memory."""
        return self.field or self.name


@dataclass(frozen=True)
class Table:
    """The datasets and attributes of a group, and the default plot (NXdata signal)."""

    fields: tuple[Field, ...]
    signal: str
    attributes: tuple[Attribute, ...] = ()


LENGTH_ONLY = {"side": "corner of the base: 0, 1", "xy": "image axis: x to the right, y down"}

_T = ("time",)
_F = ("frame",)

FRAME = Table(
    (
        Field("frame", _F, "1", "number of the frame in the clip", "i8"),
        Field("index", _F, "1", "number of the frame in the clip", "i8"),
        Field("time", _F, "s", "capture time since the first frame"),
        Field("pts_time", _F, "s", "timestamp of the container"),
        Field("centre", ("frame", "xy"), "px", "centre of rotation in the image"),
        Field("centre_sigma", _F, "px", "uncertainty of the centre"),
    ),
    signal="centre",
)

MARKER = Table(
    (
        Field("frame", _F, "1", "number of the frame in the clip", "i8"),
        Field("corner", ("frame", "side", "xy"), "px", "the two corners nearest to the centre"),
        Field("delta", _F, "px", "length of the base"),
        Field("rho", _F, "px", "radius of the base's middle"),
        Field("beta", _F, "rad", "angle between radius and base"),
        Field("angle", _F, "rad", "mean angle of the two corners, wrapped"),
        Field("sigma", _F, "rad", "uncertainty of the angle by the paper's formula"),
        Field("u_r", _F, "1", "part of the uncertainty from the radius"),
        Field("u_1", _F, "rad", "part of the uncertainty from the length of the base"),
        Field("u_2", _F, "rad", "part of the uncertainty from the angle of the base"),
        Field(
            "status",
            _F,
            "1",
            "detection status of the marker",
            "i1",
            {"flag_values": list(STATUS.values()), "flag_meanings": " ".join(STATUS)},
        ),
        Field("angle_fine", _F, "rad", "better estimate of the angle, wrapped"),
        Field("sigma_calibrated", _F, "rad", "calibrated uncertainty of angle_fine"),
    ),
    signal="angle",
    attributes=(
        Attribute("body", str, "", "the body that carries the marker: casing or rotor"),
        Attribute("mount_angle", float, "rad", "angle of the marker on its body"),
    ),
)

# an error of the angle with the covariance s^2 exp(-|t - t'| / T) of two samples, beside the sigma of each
CORRELATED = (
    Attribute("correlated_sigma", float, "rad", "standard uncertainty of a slowly varying error", 0.0),
    Attribute("correlated_time", float, "s", "correlation time of this error", 0.0),
    Attribute(
        "correlated_profile",
        tuple,
        "s, rad",
        "times and the standard uncertainty of this error at each, (k, 2); absent where it is constant",
        (),
    ),
    Attribute(
        "periodic_sigma", float, "rad", "standard uncertainty of an error once and twice per turn", 0.0
    ),
    Attribute(
        "harmonic_sigma",
        float,
        "rad",
        "standard deviation of each amplitude of an error of 1 to 12 periods per turn",
        0.0,
    ),
)

BODY = Table(
    (
        Field("time", _T, "s", "capture time since the first frame"),
        Field("angle", _T, "rad", "angle of the body, unwrapped"),
        Field("sigma", _T, "rad", "calibrated uncertainty of the angle"),
        Field("sigma_paper", _T, "rad", "uncertainty of the angle by the paper's formula"),
        Field("n_markers", _T, "1", "number of markers combined", "i8"),
        Field("omega", _T, "rad s-1", "angular velocity, median-smoothed"),
        Field("omega_sigma", _T, "rad s-1", "uncertainty of the angular velocity"),
    ),
    signal="omega",
    attributes=(
        Attribute("smoothing_width", int, "", "points of the median that gave omega"),
        *CORRELATED,
    ),
)

POINT = Table(
    (
        Field("time", _T, "s", "capture time since the first frame"),
        Field("frame_number", _T, "1", "number of the frame in the clip", "i8"),
        Field("x", _T, "px", "position to the right of the centre of the first pixel"),
        Field("y", _T, "px", "position below the centre of the first pixel"),
        Field("sigma_x", _T, "px", "standard uncertainty of x"),
        Field("sigma_y", _T, "px", "standard uncertainty of y"),
    ),
    signal="x",
    attributes=(
        Attribute("radius", float, "px", "radius of the patch that was followed"),
        Attribute("m_per_px", float, "m", "length of a pixel; absent if not given", math.nan),
    ),
)

_SIGMA_SOURCE = Attribute(
    "sigma_source",
    str,
    "",
    "measured (tracking), given (in a table), estimated (from the scatter), mixed",
    "measured",
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

INPUT = Table(
    (
        Field("time", _T, "s", "time on the clock of the casing's camera"),
        Field("value", _T, "1", "value of the input; its unit is that of the attribute `unit`"),
        Field("u", _T, "1", "standard uncertainty of the value by calibration; NaN if it is not given"),
    ),
    signal="value",
    attributes=(
        Attribute("unit", str, "", "unit of value and u: A, V, N m, K, 1 ...", "1"),
        Attribute(
            "interpolation", str, "", "between two samples: linear, or hold (the last value)", "linear"
        ),
        Attribute("delay", float, "s", "dead time after which the input acts", 0.0),
    ),
)
INTERPOLATIONS = ("linear", "hold")

RECORDING_ATTRIBUTES = (
    Attribute("source", str, "", "file name of the film"),
    Attribute("source_sha256", str, "", "SHA-256 of the film"),
    Attribute("width", int, "px", "width of the frames"),
    Attribute("height", int, "px", "height of the frames"),
    Attribute("capture_fps", float, "s-1", "capture rate of the camera"),
    Attribute("container_fps", float, "s-1", "rate that the container declares"),
    Attribute("frames_declared", int, "", "number of frames that the container declares"),
    Attribute("frames_decoded", int, "", "number of frames decoded"),
    Attribute("sense", int, "", "factor applied to angles in the image: +1 or -1"),
    Attribute("body", str, "", "casing, rotor or both"),
)

CASE_ATTRIBUTES = (
    Attribute("I_rotor", float, "kg m2", "moment of inertia of the rotor"),
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
    Attribute("label", str, "", "name of the case"),
    Attribute("surface", str, "", "surface on which the casing turned"),
    Attribute("quantity", str, "", "what was measured: angle or omega", "angle"),
    Attribute(
        "per_inertia",
        int,
        "",
        "1 if no moment of inertia is known: I_casing is 1 and torques are in rad/s2",
        0,
    ),
    Attribute("bodies", str, "", "two, or one (a single body, stored as the casing)", "two"),
    Attribute("body_name", str, "", "name of a single body, for example wheel; empty without one", ""),
)

PLACEMENT_ATTRIBUTES = (
    Attribute("clock_offset", float, "s", "start of the clip on the casing camera's clock"),
    Attribute("clock_offset_sigma", float, "s", "standard uncertainty of clock_offset"),
    Attribute("clock_rate", float, "1", "rate of the clip's clock on the casing camera's clock"),
    Attribute("clock_rate_sigma", float, "1", "standard uncertainty of clock_rate"),
    Attribute("angle_offset", float, "rad", "angle added to the clip's angles"),
    Attribute("sync_ambiguous", int, "", "1 if another start of the clip is not excluded", field="ambiguous"),
    Attribute("sync_method", str, "", "method that gave the start of the clip", field="method"),
)

# `/body/<name>` of a case: the same numbers under names that do not depend on the body and the quantity
FUSED = Table(
    (
        Field("time", _T, "s", "time on the clock of the case"),
        Field("value", _T, "rad or rad s-1", "angle, or angular velocity"),
        Field("u", _T, "rad or rad s-1", "white standard uncertainty of the value"),
        Field("segment", _T, "1", "clip that the sample came from; only of a rotor", "i8"),
    ),
    signal="value",
    attributes=(
        Attribute("quantity", str, "", "what was measured: angle or speed", "angle"),
        Attribute("clock", str, "", "clock of the times: case, that of the casing's camera"),
        *SERIES.attributes,
    ),
)
ERROR_MODE = Table(
    (
        Field("basis", ("time", "mode"), "1", "error of each sample for unit amplitudes"),
        Field("covariance", ("mode", "other_mode"), "1", "covariance of the amplitudes"),
    ),
    signal="basis",
    attributes=(
        Attribute("group", str, "", "name of the amplitudes, if several series share them", ""),
        Attribute("origin", str, "", "where the error comes from: axis, tilt, start, rate ...", ""),
    ),
)
CASE_BODY_ATTRIBUTES = (
    Attribute("role", str, "", "casing, rotor, or body (a single one)"),
    Attribute(
        "inertia", float, "kg m2", "moment of inertia; absent: torques are per unit of inertia", math.nan
    ),
    Attribute(
        "inertia_u", float, "kg m2", "standard uncertainty of the inertia; absent if not given", math.nan
    ),
)
CLOCK_ATTRIBUTES = (
    Attribute("offset", float, "s", "start of the clip on the clock of the case"),
    Attribute("rate", float, "1", "rate of the clip's clock on that of the case"),
)

# all tables of a file with their paths, for docs/reference/format.md
GROUPS = (
    ("`/frame`: the clip, frame by frame", FRAME),
    ("`/marker/<name>`: one marker", MARKER),
    ("`/body/<name>`: casing or rotor, from all its markers", BODY),
    ("`/point/<name>`: one point, only of films in which points were followed", POINT),
    ("`/casing` of a case", SERIES),
    ("`/rotor` of a case: all windows", WINDOWED),
    ("`/rotor_generated` of a case, only if one was requested", GENERATED),
    ("`/input/<name>` of a case: a recorded input of the motion", INPUT),
    ("`/body/<name>/series/fused` of a case: the series of a body that is fitted", FUSED),
    ("`/body/<name>/series/fused/error/<mode>`: an error that its samples share", ERROR_MODE),
)

# all attributes of groups that are not tables, for docs/reference/format.md
ATTRIBUTES = (
    ("Attributes of a recording", RECORDING_ATTRIBUTES),
    ("Attributes of a case", CASE_ATTRIBUTES),
    ("Further attributes of `/recording/<name>` in a case", PLACEMENT_ATTRIBUTES),
    ("Attributes of `/body/<name>` in a case", CASE_BODY_ATTRIBUTES),
    ("Attributes of `/clock/<name>` in a case, beside the dataset `covariance` of both", CLOCK_ATTRIBUTES),
)
