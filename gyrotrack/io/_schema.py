"""The HDF5 schema: names, dimensions, units and meanings of everything in a file.

A `Field` is one HDF5 dataset. The dimensions named here become dimension scales: one that is also a field
(time, frame) is a coordinate with values, the others (side, xy) only count.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from gyrotrack.io._records import STATUS

FORMAT = "gyrotrack"
FORMAT_VERSION = "1.0"
RECORDING = "recording"
CASE = "case"


@dataclass(frozen=True)
class Field:
    """One dataset: its name, dimensions, number type, unit, meaning, and further attributes."""

    name: str
    dims: tuple[str, ...]
    units: str
    long_name: str
    dtype: str = "f8"
    attributes: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Table:
    """The datasets of one kind of group, and its natural plot (NXdata signal and axes)."""

    fields: tuple[Field, ...]
    signal: str
    axis: str

    @property
    def scale(self) -> str:
        """The dimension that all fields share, the first of the first field."""
        return self.fields[0].dims[0]


LENGTH_ONLY = {"side": "corner of the base: 0, 1", "xy": "image axis: x to the right, y down"}

_T = ("time",)
_F = ("frame",)

FRAME = Table(
    (
        Field("frame", _F, "1", "number of the frame in the clip", "i8"),
        Field("index", _F, "1", "number of the frame in the clip", "i8"),
        Field("time", _F, "s", "capture time since the first frame"),
        Field("pts_time", _F, "s", "time stamp of the container"),
        Field("centre", ("frame", "xy"), "px", "centre of rotation in the image"),
        Field("centre_sigma", _F, "px", "uncertainty of the centre"),
    ),
    signal="centre",
    axis="frame",
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
            "how the marker was seen",
            "i1",
            {"flag_values": list(STATUS.values()), "flag_meanings": " ".join(STATUS)},
        ),
        Field("angle_fine", _F, "rad", "better estimate of the angle, wrapped"),
        Field("sigma_calibrated", _F, "rad", "calibrated uncertainty of angle_fine"),
    ),
    signal="angle",
    axis="frame",
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
    axis="time",
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
    axis="time",
)

WINDOWED = Table(
    (*SERIES.fields, Field("window", _T, "1", "rotor clip that the sample came from", "i8")),
    signal="omega",
    axis="time",
)

GENERATED = Table(
    (
        Field("time", _T, "s", "time on the clock of the casing's camera"),
        Field("omega", _T, "rad s-1", "angular velocity of the rotor, generated"),
    ),
    signal="omega",
    axis="time",
)

RECORDING_ATTRIBUTES = (
    "source",
    "source_sha256",
    "width",
    "height",
    "capture_fps",
    "container_fps",
    "frames_declared",
    "frames_decoded",
    "sense",
    "body",
)
"""Scalar attributes of a recording, named like the fields of `records.Recording`."""

ATTRIBUTE_UNITS = {
    "width": "px",
    "height": "px",
    "capture_fps": "s-1",
    "container_fps": "s-1",
    "I_rotor": "kg m2",
    "I_casing": "kg m2",
    "clock_offset": "s",
    "clock_offset_sigma": "s",
    "clock_rate": "1",
    "clock_rate_sigma": "1",
    "angle_offset": "rad",
    "mount_angle": "rad",
}
"""Units of the attributes that have one; stored beside them as `<name>_units`."""
