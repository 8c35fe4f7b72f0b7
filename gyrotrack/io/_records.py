"""Recordings and cases in memory.

A `Recording` is one clip: its frames, its markers, and the angle of each body seen in it. A `Case` is one
experiment: the casing and the rotor as `Series` on the clock of the casing's camera, with the recordings that
they came from and the `Placement` of each on that clock. SI units; angles in rad, growing in the sense in
which the bodies turn; lengths in the image in px. A missing number is NaN, never zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import UsageError
from gyrotrack.io._schema import BODY, FRAME, MARKER, SERIES, STATUS, Table

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Codes = npt.NDArray[np.int8]


class _Tabular:
    """Content that can be written as tables."""

    def to_dataframe(self, table: str = "motion") -> Any:
        """Return a table as a pandas DataFrame; ``attrs["units"]`` has the units of its columns.

        Parameters
        ----------
        table : {"motion", "markers", "frames"}
            Bodies, every marker, or every frame.

        Raises
        ------
        UsageError
            As for `columns`, or pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise UsageError(
                "A DataFrame needs pandas, which is not installed.",
                'Install it: pip install "gyrotrack[notebook]"',
            ) from None
        made = columns(self, table)  # type: ignore[arg-type] # a Recording or a Case
        frame = pd.DataFrame({c.name: c.values for c in made})
        frame.attrs["units"] = {c.name: c.unit for c in made if c.unit}
        return frame


@dataclass(frozen=True)
class MarkerTrack:
    """One marker in all n frames of a clip; NaN where it was not detected.

    Attributes
    ----------
    name, body : str
        The marker's name, and the body that carries it, "casing" or "rotor".
    mount_angle : float
        Its angle on the body [rad].
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
        The more accurate estimate of the angle, wrapped, and its calibrated uncertainty [rad].
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
    """The markers of one body combined; frames without a usable angle are omitted.

    Attributes
    ----------
    name : str
        "casing" or "rotor".
    time, angle : ndarray, shape (m,)
        Time on the clip's own clock [s], and the unwrapped angle [rad].
    sigma, sigma_paper : ndarray, shape (m,)
        The calibrated uncertainty of the angle, and that of the paper's formula [rad].
    n_markers : ndarray of int64, shape (m,)
        Number of markers combined.
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
class Recording(_Tabular):
    """One clip: n decoded frames, the markers found in them, and the bodies' angles.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Capture time [s]: index / `capture_fps`, unless the timestamps of the stream are used.
    pts_time : ndarray, shape (n,)
        Timestamps of the container [s].
    centre, centre_sigma : ndarray, shape (n, 2)
        Centre of rotation and its standard uncertainty [px].
    sense : {1, -1}
        Factor that was applied to the angles as seen in the image.
    markers, bodies : dict
        Every marker, and the bodies' angles.
    extra : dict
        Further facts that JSON can hold.
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
    """The clock of a clip relative to that of the case: t_case = clock_offset + clock_rate * t_clip.

    `angle_offset` [rad] is added to the clip's angles to refer them to the casing camera's zero.
    `ambiguous`: another start of the clip cannot be excluded.
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
    """A rotor curve without gaps, computed by a method, not measured: time [s], omega [rad s-1]."""

    time: Floats
    omega: Floats
    method: str


@dataclass(frozen=True)
class Case(_Tabular):
    """One experiment on one clock.

    Attributes
    ----------
    I_rotor, I_casing : float
        Moments of inertia [kg m2].
    I_rotor_u, I_casing_u : float
        Their standard uncertainties [kg m2]; NaN if not given.
    quantity : {"angle", "omega"}
        What was measured; with "omega" the angle is its integral.
    bodies : {"two", "one"}
        With "one" the series `casing` is that of the single body, and `rotor` is empty.
    per_inertia : int
        1 if no moment of inertia is known: `I_casing` is 1, and torques are per unit of inertia [rad/s2].
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
    per_inertia: int = 0
    I_rotor_u: float = math.nan
    I_casing_u: float = math.nan


_WORDS = np.array(list(STATUS), dtype=object)


@dataclass(frozen=True)
class Column:
    """One column: its name, its unit ("" for text), and a value for each row."""

    name: str
    unit: str
    values: npt.NDArray[Any]

    @property
    def heading(self) -> str:
        """The name with its unit in brackets, as `import` reads it."""
        return (
            f"{self.name} [{_READABLE.get(self.unit, self.unit)}]"
            if self.unit not in {"", "1"}
            else self.name
        )


_READABLE = {"rad s-1": "rad/s"}


def columns(content: Recording | Case, table: str = "motion") -> tuple[Column, ...]:
    """Return a recording or a case as columns of equal length.

    Parameters
    ----------
    content : Recording or Case
        Source of the columns.
    table : {"motion", "markers", "frames"}
        The angles and speeds of the bodies; every marker in every frame; the frames of each clip. The rows of
        several bodies, markers or clips follow one another and are distinguished by the first columns.

    Returns
    -------
    tuple of Column
        Times in s, angles in rad, speeds in rad s-1, lengths in px; NaN where not measured.

    Raises
    ------
    UsageError
        There is no such table, or nothing in it.
    """
    if table not in TABLES:
        raise UsageError(f"Unknown table '{table}'.", f"Use one of {', '.join(TABLES)}.")
    parts = TABLES[table](content)
    if not parts:
        raise UsageError(f"The file contains no {table}.", "Only recordings of films do.")
    return tuple(
        Column(c.name, c.unit, np.concatenate([part[i].values for part in parts]))
        for i, c in enumerate(parts[0])
    )


def _motion(content: Recording | Case) -> list[list[Column]]:
    if isinstance(content, Recording):
        return [
            [_word("body", name, len(body.time)), *_of(BODY, vars(body))]
            for name, body in content.bodies.items()
        ]
    parts = []
    for name, series in (("casing", content.casing), ("rotor", content.rotor)):
        rows = len(series.time)
        window = series.window if series.window is not None else np.zeros(rows, dtype=np.int64)
        parts.append([_word("body", name, rows), Column("window", "1", window), *_of(SERIES, vars(series))])
    return [part for part in parts if len(part[0].values)]


def _markers(content: Recording | Case) -> list[list[Column]]:
    return [
        [
            _word("clip", clip, len(recording.time)),
            _word("marker", name, len(recording.time)),
            _word("body", marker.body, len(recording.time)),
            *_of(MARKER, {**vars(marker), "frame": recording.frame_index}),
        ]
        for clip, recording in _clips(content).items()
        for name, marker in recording.markers.items()
    ]


def _frames(content: Recording | Case) -> list[list[Column]]:
    return [
        [
            _word("clip", clip, len(r.time)),
            *_of(FRAME, {**vars(r), "frame": r.frame_index, "index": r.frame_index}),
        ]
        for clip, r in _clips(content).items()
    ]


TABLES: dict[str, Callable[[Recording | Case], list[list[Column]]]] = {
    "motion": _motion,
    "markers": _markers,
    "frames": _frames,
}


def _clips(content: Recording | Case) -> dict[str, Recording]:
    return {content.source: content} if isinstance(content, Recording) else content.recordings


def _word(name: str, word: str, rows: int) -> Column:
    return Column(name, "", np.full(rows, word, dtype=object))


def _of(table: Table, values: Mapping[str, Any]) -> list[Column]:
    """Return the fields of a table; a field with several numbers per sample becomes several columns."""
    made = []
    for f in table.fields:
        value = np.asarray(values[f.name])
        if f.name == "status":
            made.append(Column(f.name, "", _WORDS[value]))
        elif value.ndim == 1:
            made.append(Column(f.name, f.units, value))
        else:
            for place in np.ndindex(value.shape[1:]):
                *side, axis = place
                name = "_".join([f.name, *(str(s) for s in side), "xy"[axis]])
                made.append(Column(name, f.units, value[(slice(None), *place)]))
    return made
