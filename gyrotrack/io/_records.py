"""Recordings and cases in memory.

A `Recording` is one clip: its frames, its markers, and the angle of each body seen in it. A `Case` is one
experiment: the casing and the rotor as `Series` on the clock of the casing's camera, with the recordings that
they came from and the `Placement` of each on that clock. SI units; angles in rad, growing in the sense in
which the bodies turn; lengths in the image in px. A missing number is NaN, never zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Codes = npt.NDArray[np.int8]

STATUS = {"ok": 0, "blurred": 1, "occluded": 2, "out_of_frame": 3, "lost": 4}


@dataclass(frozen=True)
class MarkerTrack:
    """One marker through all n frames of a clip; NaN where it was not seen.

    Attributes
    ----------
    name, body : str
        The marker's name, and the body that it sits on, "casing" or "rotor".
    mount_angle : float
        Where it sits on its body [rad].
    corner : ndarray, shape (n, 2, 2)
        The two corners nearest to the centre: frame, side, (x, y) [px].
    delta, rho, beta : ndarray, shape (n,)
        Length of the base [px], radius [px], angle between them [rad].
    angle, sigma : ndarray, shape (n,)
        Mean angle of the corners, wrapped [rad], and the paper's uncertainty of it,
        sqrt((30 u_r)^2 + (150 u_1)^2 + (150 u_2)^2) [rad].
    u_r, u_1, u_2 : ndarray, shape (n,)
        The three parts of that uncertainty [1, rad, rad].
    status : ndarray of int8, shape (n,)
        One of the values of `STATUS`.
    angle_fine, sigma_calibrated : ndarray, shape (n,)
        The better estimate of the angle, wrapped [rad], and its true uncertainty [rad].
    """

    name: str
    body: str
    mount_angle: float
    corner: Floats
    delta: Floats
    rho: Floats
    beta: Floats
    angle: Floats
    sigma: Floats
    u_r: Floats
    u_1: Floats
    u_2: Floats
    status: Codes
    angle_fine: Floats
    sigma_calibrated: Floats


@dataclass(frozen=True)
class BodyTrack:
    """The markers of one body combined; frames without a usable angle are left out.

    Attributes
    ----------
    name : str
        "casing" or "rotor".
    time, angle : ndarray, shape (m,)
        Time on the clip's own clock [s], and the unwrapped angle [rad].
    sigma, sigma_paper : ndarray, shape (m,)
        The calibrated uncertainty of the angle, and the paper's formula beside it [rad].
    n_markers : ndarray of int64, shape (m,)
        How many markers gave the angle.
    omega, omega_sigma : ndarray, shape (m,)
        Angular velocity and its uncertainty after the median smoothing [rad s-1].
    smoothing_width : int
        Points of that median.
    """

    name: str
    time: Floats
    angle: Floats
    sigma: Floats
    sigma_paper: Floats
    n_markers: Integers
    omega: Floats
    omega_sigma: Floats
    smoothing_width: int


@dataclass(frozen=True)
class Recording:
    """One clip: n decoded frames, the markers found in them, and the bodies' angles.

    `time` is the capture time (index / `capture_fps` unless the stream's own stamps were asked for) and
    `pts_time` what the container claims. `sense` (+1 or -1) is the factor that was applied to the angles as
    seen in the image. `extra` holds whatever else is worth keeping, as JSON can hold it.
    """

    source: str
    source_sha256: str
    width: int
    height: int
    capture_fps: float
    container_fps: float
    frames_declared: int
    frames_decoded: int
    sense: int
    body: str
    frame_index: Integers
    time: Floats
    pts_time: Floats
    centre: Floats
    centre_sigma: Floats
    markers: dict[str, MarkerTrack]
    bodies: dict[str, BodyTrack]
    warnings: tuple[str, ...] = ()
    extra: dict[str, Any] = field(default_factory=dict)

    def to_dataframe(self, table: str = "motion") -> Any:
        """Return the table "motion", "markers" or "frames" as a pandas DataFrame (see `gyrotrack.exporting`)."""
        from gyrotrack.io._export import to_dataframe

        return to_dataframe(self, table)


@dataclass(frozen=True)
class Series:
    """One body of a case on the common clock; all arrays have shape (n,).

    Attributes
    ----------
    time : ndarray
        Time on the clock of the casing's camera [s], increasing within a window.
    angle, sigma : ndarray
        Unwrapped angle and its uncertainty [rad]; the constant is free for each window.
    omega, omega_sigma : ndarray
        Smoothed angular velocity and its uncertainty [rad s-1].
    turn : ndarray of int64
        Whole turns in the angle, floor(angle / 2 pi).
    window : ndarray of int64, or None
        Which rotor clip a sample came from; None for the casing.
    sigma_source : str
        "measured" (by tracking), "given" (in a table), "estimated" (from the scatter), or "mixed".
    """

    time: Floats
    angle: Floats
    sigma: Floats
    omega: Floats
    omega_sigma: Floats
    turn: Integers
    window: Integers | None = None
    sigma_source: str = "measured"


@dataclass(frozen=True)
class Placement:
    """Where a clip lies on the case's clock: t_case = clock_offset + clock_rate * t_clip.

    `angle_offset` [rad] is what is added to the clip's angles to bring them to the casing camera's zero.
    `ambiguous` says that another start of the clip cannot be excluded.
    """

    id: str
    clock_offset: float
    clock_offset_sigma: float
    clock_rate: float
    clock_rate_sigma: float
    angle_offset: float
    ambiguous: bool
    method: str


@dataclass(frozen=True)
class GeneratedCurve:
    """A rotor curve without gaps, made by a method, not measured: time [s], omega [rad s-1]."""

    time: Floats
    omega: Floats
    method: str


@dataclass(frozen=True)
class Case:
    """One experiment on one clock.

    `I_rotor` and `I_casing` are moments of inertia [kg m2]; `quantity` is what was measured, "angle" or
    "omega" (then the angle is its integral). With `bodies` "one" a single body stands in the casing's place, and the
    rotor's series is empty.
    """

    I_rotor: float
    I_casing: float
    label: str
    surface: str
    casing: Series
    rotor: Series
    recordings: dict[str, Recording] = field(default_factory=dict)
    placements: dict[str, Placement] = field(default_factory=dict)
    rotor_generated: GeneratedCurve | None = None
    quantity: str = "angle"
    warnings: tuple[str, ...] = ()
    extra: dict[str, Any] = field(default_factory=dict)
    bodies: str = "two"

    def to_dataframe(self, table: str = "motion") -> Any:
        """Return the table "motion", "markers" or "frames" as a pandas DataFrame (see `gyrotrack.exporting`)."""
        from gyrotrack.io._export import to_dataframe

        return to_dataframe(self, table)
