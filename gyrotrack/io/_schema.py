"""The HDF5 schema of a recording: names, types, dimensions, units and meanings of its datasets and attributes.

`fitting._case_format` describes a case in the same way.
"""

from __future__ import annotations

import math

from fitting import _case_format as layout
from fitting._case_format import CORRELATED, Attribute, Field, Table

STATUS = {"ok": 0, "blurred": 1, "occluded": 2, "out_of_frame": 3, "lost": 4}
STATUS_WORDS = {code: word.replace("_", " ") for word, code in STATUS.items()}

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
        Field("angle_fine", _F, "rad", "estimate of the angle with a smaller error than `angle`, wrapped"),
        Field("sigma_calibrated", _F, "rad", "calibrated uncertainty of angle_fine"),
    ),
    signal="angle",
    attributes=(
        Attribute("body", str, "", "the body that carries the marker: casing or rotor"),
        Attribute("mount_angle", float, "rad", "angle of the marker on its body"),
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
        Attribute("smoothing_width", int, "", "number of samples of the running median for omega"),
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

RECORDING_ATTRIBUTES = (
    Attribute("source", str, "", "file name of the film"),
    Attribute("source_sha256", str, "", "SHA-256 of the film"),
    Attribute("width", int, "px", "width of the frames"),
    Attribute("height", int, "px", "height of the frames"),
    Attribute("capture_fps", float, "s-1", "capture rate of the camera"),
    Attribute(
        "container_fps",
        float,
        "s-1",
        "rate that the container declares; absent if it declares none",
        math.nan,
    ),
    Attribute("frames_declared", int, "", "number of frames that the container declares"),
    Attribute("frames_decoded", int, "", "number of frames decoded"),
    Attribute("sense", int, "", "factor applied to angles in the image: +1 or -1"),
    Attribute("body", str, "", "casing, rotor or both"),
)

# all tables and other attributes of a file with their paths, for docs/reference/format.md
GROUPS = (
    ("`/frame`: the clip, frame by frame", FRAME),
    ("`/marker/<name>`: one marker", MARKER),
    ("`/body/<name>`: casing or rotor, from all its markers", BODY),
    ("`/point/<name>`: one point, only for films in which points were followed", POINT),
    *layout.GROUPS,
)
ATTRIBUTES = (("Attributes of a recording", RECORDING_ATTRIBUTES), *layout.ATTRIBUTES)
