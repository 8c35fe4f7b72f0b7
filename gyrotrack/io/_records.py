"""Recordings and cases in memory, and their moments of inertia.

A `Recording` is one clip: frames, markers, and the angle of each body. A `Case` is one experiment: casing and rotor as
`Series` on the clock of the casing camera, with the recordings and the `Placement` of each recording on this clock. An
`Inertia` is read from a text with optional unit and standard uncertainty. Quantities are in SI units. Angles are in rad
and increase in the sense of rotation. Lengths in the image are in px. Missing values are NaN. "The paper" below is V.
Tanrıverdi and A. Erbasan, arXiv:2605.06700.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from fitting._case_format import INPUT, SERIES, Table
from gyrotrack._errors import UsageError
from gyrotrack._smoothing import angular_velocity, smoothing_width
from gyrotrack.io._schema import BODY, FRAME, MARKER, POINT, STATUS

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Codes = npt.NDArray[np.int8]


class _Tabular:
    """Content that can be exported as tables."""

    def to_dataframe(self, table: str = "motion") -> Any:
        """Return a table as a pandas DataFrame; ``attrs["units"]`` contains the units of the columns.

        Parameters
        ----------
        table : {"motion", "markers", "frames", "inputs", "points", "errors"}
            Motion of the bodies, every marker, every frame, recorded inputs, tracked points, or errors that many
            samples share.

        Raises
        ------
        UsageError
            As for `columns`, or pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            what = "A DataFrame needs pandas, which is not installed."
            raise UsageError(what, 'Install it: pip install "gyrotrack[notebook]"') from None
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
        Name of the marker, and its body, "casing" or "rotor".
    mount_angle : float
        Angle of the marker on the body [rad].
    corner : ndarray, shape (n, 2, 2)
        The two corners nearest to the centre: frame, side, (x, y) [px].
    delta, rho, beta : ndarray, shape (n,)
        Length of the base [px], radius [px], and angle between base and radius [rad].
    angle, sigma : ndarray, shape (n,)
        Mean angle of the corners, wrapped [rad], and its uncertainty as in the paper,
        sqrt((30 u_r)^2 + (150 u_1)^2 + (150 u_2)^2) [rad].
    u_r, u_1, u_2 : ndarray, shape (n,)
        The three parts of this uncertainty [1, rad, rad].
    status : ndarray of int8, shape (n,)
        A value of `STATUS`.
    angle_fine, sigma_calibrated : ndarray, shape (n,)
        An estimate of the angle that is more accurate than `angle`, wrapped, and its calibrated uncertainty [rad].
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
        Time on the clock of the clip [s], and the unwrapped angle [rad].
    sigma, sigma_paper : ndarray, shape (m,)
        The calibrated uncertainty of the angle, and the uncertainty by the paper's formula [rad].
    n_markers : ndarray of int64, shape (m,)
        Number of markers combined.
    omega, omega_sigma : ndarray, shape (m,)
        Angular velocity, smoothed by running medians, and its uncertainty [rad s-1].
    smoothing_width : int
        Number of points of the medians.
    correlated_sigma, correlated_time : float
        Standard uncertainty [rad] and correlation time [s] of a slowly varying error of the angle; 0 if there is no
        such error.
    correlated_profile : tuple of (float, float)
        Times [s], and the standard uncertainty [rad] of this error at these times; empty if the uncertainty is
        constant.
    periodic_sigma : float
        Standard deviation of the amplitudes of an error of one and two periods per turn [rad]; 0 if there is no such
        error.
    harmonic_sigma : float
        Standard deviation of the amplitudes of an error of 1 to 12 periods per turn [rad]; 0 if there is no such error.
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
    correlated_sigma: float = 0.0
    correlated_time: float = 0.0
    correlated_profile: tuple[tuple[float, float], ...] = ()
    periodic_sigma: float = 0.0
    harmonic_sigma: float = 0.0


@dataclass(frozen=True)
class PointTrack:
    """The path of one point; frames in which the point is not found are omitted.

    Attributes
    ----------
    name : str
        Name of the point.
    time : ndarray, shape (m,)
        Time on the clock of the clip [s].
    frame_number : ndarray of int64, shape (m,)
        Numbers of the frames.
    x, y, sigma_x, sigma_y : ndarray, shape (m,)
        Position and its standard uncertainty [px].
    radius : float
        Radius of the tracked patch [px].
    m_per_px : float
        Length of a pixel [m]; NaN if it is not given.
    """

    name: str
    time: Floats
    frame_number: Integers
    x: Floats
    y: Floats
    sigma_x: Floats
    sigma_y: Floats
    radius: float
    m_per_px: float = math.nan


@dataclass(frozen=True)
class Recording(_Tabular):
    """One clip: n decoded frames, the detected markers, and the angles of the bodies.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Capture time [s]: index / `capture_fps`, unless the timestamps of the stream are used.
    pts_time : ndarray, shape (n,)
        Timestamps of the container [s].
    centre, centre_sigma : ndarray, shape (n, 2)
        Centre of rotation and its standard uncertainty [px].
    sense : {1, -1}
        Factor that was applied to the angles in the image.
    markers, bodies, points : dict
        Markers, bodies and points by name.
    extra : dict
        Further metadata, serialisable as JSON.
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
    points: dict[str, PointTrack] = field(default_factory=dict)


@dataclass(frozen=True)
class ErrorMode:
    """An error common to the samples of a series: basis @ a, with amplitudes a of mean zero.

    Attributes
    ----------
    name : str
        Name of the error, for example "tilt".
    basis : ndarray, shape (n, m)
        Error of each sample for unit amplitudes.
    covariance : ndarray, shape (m, m)
        Covariance of the amplitudes.
    group : str
        Name of the amplitudes, if they are common to several series.
    origin, long_name : str
        Origin of the error ("axis", "tilt", "start" ...), and its meaning.
    """

    name: str
    basis: Floats
    covariance: Floats
    group: str = ""
    origin: str = ""
    long_name: str = ""


@dataclass(frozen=True)
class Series:
    """One body of a case on the common clock; all arrays have shape (n,).

    Attributes
    ----------
    time : ndarray
        Time on the clock of the casing camera [s], increasing within a window.
    angle, sigma : ndarray
        Unwrapped angle and its uncertainty [rad]; each window has an arbitrary constant.
    omega, omega_sigma : ndarray
        Smoothed angular velocity and its uncertainty [rad s-1].
    turn : ndarray of int64
        Whole turns in the angle, floor(angle / 2 pi).
    window : ndarray of int64, or None
        Index of the rotor clip of each sample; None for the casing.
    sigma_source : str
        "measured" (by tracking), "given" (in a table), "estimated" (from the scatter), or "mixed".
    correlated_sigma, correlated_time : float
        Standard uncertainty [rad] and correlation time [s] of a slowly varying error of the angle; 0 if there is no
        such error.
    correlated_profile : tuple of (float, float)
        Times [s], and the standard uncertainty [rad] of this error at these times; empty if the uncertainty is
        constant.
    periodic_sigma : float
        Standard deviation of the amplitudes of an error of one and two periods per turn [rad]; 0 if there is no such
        error.
    harmonic_sigma : float
        Standard deviation of the amplitudes of an error of 1 to 12 periods per turn [rad]; 0 if there is no such error.
    modes : tuple of ErrorMode
        Errors that many samples of the series share.
    """

    time: Floats
    angle: Floats
    sigma: Floats
    omega: Floats
    omega_sigma: Floats
    turn: Integers
    window: Integers | None = None
    sigma_source: str = "measured"
    correlated_sigma: float = 0.0
    correlated_time: float = 0.0
    correlated_profile: tuple[tuple[float, float], ...] = ()
    periodic_sigma: float = 0.0
    harmonic_sigma: float = 0.0
    modes: tuple[ErrorMode, ...] = ()


def series_of(parts: Sequence[Any], sense: int = 1, sigma_source: str = "measured") -> Series:
    """Join motions to one series; each motion becomes one window.

    Each motion has time, angle, sigma, omega and omega_sigma. Angles and speeds are multiplied by `sense`.
    """
    names = ("time", "angle", "sigma", "omega", "omega_sigma")
    joined: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    joined |= {name: sense * joined[name] for name in ("angle", "omega")}
    turn = np.floor(joined["angle"] / (2 * np.pi)).astype(np.int64)
    window = np.repeat(np.arange(len(parts), dtype=np.int64), [len(part.time) for part in parts])
    stated: dict[str, Any] = {
        name: max((getattr(part, name, 0.0) for part in parts), default=0.0)
        for name in ("correlated_sigma", "correlated_time", "periodic_sigma", "harmonic_sigma")
    }
    # windows of several cameras have no common profile
    profile = getattr(parts[0], "correlated_profile", ()) if len(parts) == 1 else ()
    return Series(
        **joined, turn=turn, window=window, sigma_source=sigma_source, correlated_profile=profile, **stated
    )


@dataclass(frozen=True)
class Piece:
    """A motion without gaps; all arrays have shape (n,), in s, rad and rad/s."""

    time: Floats
    angle: Floats
    sigma: Floats
    omega: Floats
    omega_sigma: Floats
    smoothing_width: int = 1


def from_angles(time: Floats, angle: Floats, sigma: Floats) -> Piece:
    """Return a motion from unwrapped angles [rad], with smoothed angular velocities."""
    width = smoothing_width(angle, sigma)
    omega, omega_sigma = angular_velocity(time, angle, sigma, width)
    return Piece(time, angle, sigma, omega, omega_sigma, width)


def from_speeds(time: Floats, omega: Floats, sigma: Floats) -> Piece:
    """Return a motion from angular velocities [rad/s]; the angle is their trapezoidal integral, whose errors grow."""
    step = np.diff(time)
    angle = np.concatenate([[0.0], np.cumsum((omega[1:] + omega[:-1]) / 2 * step)])
    share = np.concatenate([step[:1], step]) * sigma if len(step) else sigma
    return Piece(time, angle, np.sqrt(np.cumsum(share**2)), omega, sigma)


def no_series() -> Series:
    """Return an empty series."""
    none, whole = np.zeros(0), np.zeros(0, dtype=np.int64)
    return Series(none, none, none, none, none, whole, window=whole, sigma_source="given")


def windows_of(series: Series) -> Integers:
    """Return the window of each sample; 0 for a series without windows."""
    return series.window if series.window is not None else np.zeros(len(series.time), dtype=np.int64)


# two speeds count as equal if their relative difference is below this value
_EQUAL_SPEEDS = 0.003


def doubts_of(recording: Recording) -> tuple[str, ...]:
    """Return the reasons why the angles of a recording may be wrong, as stored in its file."""
    return tuple(recording.extra.get("doubts", ()))


def speed_warnings(casing: Series | BodyTrack, rotor: Series | BodyTrack, remedy: str) -> list[str]:
    """Return warnings about a casing that is faster than the rotor, or has the same motion, in all windows.

    Friction between the bodies cannot make the casing faster than the rotor. It makes both bodies turn together only at
    the end of a run. If the speeds contradict this, the bodies may be exchanged, or one body was measured twice.
    `remedy` is the recommended action.
    """
    windows = windows_of(rotor) if isinstance(rotor, Series) else np.zeros(len(rotor.time), dtype=np.int64)
    speeds = []
    for k in np.unique(windows):
        t = rotor.time[windows == k][[0, -1]]
        turned = np.ptp(rotor.angle[windows == k][[0, -1]]), np.ptp(np.interp(t, casing.time, casing.angle))
        speeds.append(np.array(turned) / max(np.ptp(t), 1e-9))
    if not speeds:
        return []
    first = f"{speeds[0][1]:.1f} and {speeds[0][0]:.1f} rad/s in the first window"
    ratio = np.array([of_rotor / max(of_casing, 1e-9) for of_rotor, of_casing in speeds])
    doubt = ""
    if np.all(np.abs(ratio - 1) < _EQUAL_SPEEDS):
        doubt = f"casing and rotor have the same motion ({first}): one body may have been measured twice"
    elif np.all(ratio < 1):
        doubt = f"the casing is faster than the rotor ({first}): the bodies may be exchanged"
    return [f"{doubt}; {remedy}"] if doubt else []


@dataclass(frozen=True)
class Placement:
    """The clock of a clip: t_case = clock_offset + clock_rate * t_clip; `angle_offset` [rad] is added to its angles."""

    id: str  #: Name of the clip.
    clock_offset: float  #: Start of the clip on the clock of the casing's camera [s].
    clock_offset_sigma: float  #: Standard uncertainty of the start [s].
    clock_rate: float  #: Rate of the clock of the clip, relative to the clock of the casing's camera [1].
    clock_rate_sigma: float  #: Standard uncertainty of the rate [1].
    angle_offset: float  #: Angle added to the angles of the clip [rad].
    ambiguous: bool  #: Whether another start cannot be excluded.
    method: str  #: Method that gave the start.


@dataclass(frozen=True)
class GeneratedCurve:
    """A computed rotor curve without gaps: time [s], omega [rad s-1]."""

    time: Floats
    omega: Floats
    method: str


@dataclass(frozen=True)
class Input:
    """A recorded input of the motion, for example a current or a commanded torque; arrays have shape (n,).

    Attributes
    ----------
    name : str
        Name of the input in laws.
    time, value, u : ndarray
        Times [s], values [unit], and standard uncertainties of the values due to calibration [unit]; NaN if unknown.
    unit : str
        SI unit: "A", "V", "N m", "K", "1".
    interpolation : {"linear", "hold"}
        Value between two samples: linear, or the value of the last sample.
    delay : float
        Dead time after which the input acts [s].
    """

    name: str
    time: Floats
    value: Floats
    u: Floats
    unit: str = "1"
    interpolation: str = "linear"
    delay: float = 0.0


@dataclass(frozen=True)
class ChainBody:
    """A body of a chain, other than the first body.

    Attributes
    ----------
    name : str
        Name of the body.
    series : Series
        Motion of the body, with windows.
    inertia, inertia_u : float
        Moment of inertia and its standard uncertainty [kg m2]; NaN if the uncertainty is not given.
    """

    name: str
    series: Series
    inertia: float
    inertia_u: float = math.nan


@dataclass(frozen=True, repr=False)
class Case(_Tabular):
    """One experiment on one clock.

    Attributes
    ----------
    I_rotor, I_casing : float
        Moments of inertia [kg m2].
    I_rotor_u, I_casing_u : float
        Standard uncertainties of the moments of inertia [kg m2]; NaN if not given.
    start_u : float
        Standard uncertainty of the start of each rotor window on the clock of the casing [s]; NaN if not given.
    quantity : {"angle", "omega"}
        Measured quantity; with "omega" the angle is the integral of the angular velocity.
    bodies : {"two", "one", "chain"}
        With "one", the series `casing` is the series of the single body, and `rotor` is empty. With "chain", `casing`
        is the series of the first body, which may come to rest, and `further` contains the other bodies.
    body_name : str
        Name of the single body, or of the first body of a chain, for example "wheel"; may be empty.
    further : tuple of ChainBody
        The other bodies of a chain.
    joints : dict of str to (str, str)
        The two bodies of each joint of a chain.
    per_inertia : int
        1 if no moment of inertia is known: `I_casing` is then 1, and torques are per unit of inertia [rad/s2].
    inputs : tuple of Input
        Recorded inputs of the motion.
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
    body_name: str = ""
    per_inertia: int = 0
    I_rotor_u: float = math.nan
    I_casing_u: float = math.nan
    start_u: float = math.nan
    inputs: tuple[Input, ...] = ()
    further: tuple[ChainBody, ...] = ()
    joints: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def main_body(self) -> str:
        """Name of the body whose motion is the series `casing`.

        The name is "casing" for two bodies, otherwise `body_name`, or "body" if `body_name` is empty.
        """
        return "casing" if self.bodies == "two" else self.body_name or "body"

    @property
    def motions(self) -> list[tuple[str, Series]]:
        """Names and series of the bodies, the main body first."""
        of_rotor = [("rotor", self.rotor)] if self.bodies == "two" else []
        return [(self.main_body, self.casing), *of_rotor, *((b.name, b.series) for b in self.further)]

    @property
    def inertias(self) -> dict[str, tuple[float, float]]:
        """Moments of inertia and their standard uncertainties [kg m2] by body."""
        of_rotor = {"rotor": (self.I_rotor, self.I_rotor_u)} if self.bodies == "two" else {}
        main = {self.main_body: (self.I_casing, self.I_casing_u)}
        return of_rotor | main | {b.name: (b.inertia, b.inertia_u) for b in self.further}

    def __repr__(self) -> str:
        lines = [f"Case {self.label!r}: {'angles' if self.quantity == 'angle' else 'angular velocities'}"]
        lines += [
            f"  {name}: {len(s.time)} samples, {s.time[0]:.6g} to {s.time[-1]:.6g} s, "
            f"{len(np.unique(windows_of(s)))} window(s)"
            for name, s in self.motions
            if len(s.time)
        ]
        lines += [
            f"  input {i.name!r} [{i.unit}]: {len(i.time)} samples, {i.interpolation}"
            for i in self.inputs[:8]
        ]
        lines.append(f"  {', '.join(f'I_{b} {value:.4g}' for b, (value, _) in self.inertias.items())} kg m2")
        lines.append(f"  {len(self.recordings)} clip(s), {len(self.warnings)} warning(s)")
        return "\n".join(lines)


_STATUS_NAMES = np.array(list(STATUS), dtype=object)


@dataclass(frozen=True)
class Column:
    """One column: name, unit ("" for text), and a value for each row."""

    name: str
    unit: str
    values: npt.NDArray[Any]

    @property
    def heading(self) -> str:
        """The name with its unit in brackets, as `import` reads it."""
        unit = _READABLE.get(self.unit, self.unit)
        return self.name if unit in {"", "1"} else f"{self.name} [{unit}]"


_READABLE = {"rad s-1": "rad/s"}


def columns(content: Recording | Case, table: str = "motion") -> tuple[Column, ...]:
    """Return a recording or a case as columns of equal length: times in s, angles in rad, speeds in rad s-1.

    Lengths are in px; lengths of points with a scale are in m. The table is "motion" (angles and speeds of the bodies),
    "markers" (every marker in every frame), "frames" (of each clip), "inputs" (recorded inputs of a case, each in its
    unit), "points" (paths of points) or "errors" (for each shared error, the standard uncertainty that it causes in
    each sample, in rad or rad s-1). Rows of several bodies, markers, points or clips follow each other; the first
    columns identify them. Values that were not measured are NaN. A UsageError is raised if the table is unknown or
    empty.
    """
    if table not in TABLES:
        raise UsageError(f"Unknown table '{table}'.", f"Use one of {', '.join(TABLES)}.")
    parts = TABLES[table](content)
    if not parts:
        hints = {
            "inputs": "`import --input` records them.",
            "errors": "The source of the file states no error that many samples share.",
        }
        hint = hints.get(table, "Only recordings of films contain this table.")
        raise UsageError(f"The file contains no table '{table}'.", hint)
    return tuple(
        Column(c.name, c.unit, np.concatenate([part[i].values for part in parts]))
        for i, c in enumerate(parts[0])
    )


def _motion(content: Recording | Case) -> list[list[Column]]:
    if isinstance(content, Recording):
        return [_part({"body": name}, BODY, vars(body)) for name, body in content.bodies.items()]
    parts = []
    for name, series in content.motions:
        part = _part({"body": name}, SERIES, vars(series))
        parts.append([part[0], Column("window", "1", windows_of(series)), *part[1:]])
    return [part for part in parts if len(part[0].values)]


def _markers(content: Recording | Case) -> list[list[Column]]:
    return [
        _part(
            {"clip": clip, "marker": name, "body": marker.body},
            MARKER,
            {**vars(marker), "frame": r.frame_index},
        )
        for clip, r in _clips(content).items()
        for name, marker in r.markers.items()
    ]


def _frames(content: Recording | Case) -> list[list[Column]]:
    return [
        _part({"clip": clip}, FRAME, {**vars(r), "frame": r.frame_index, "index": r.frame_index})
        for clip, r in _clips(content).items()
    ]


def _inputs(content: Recording | Case) -> list[list[Column]]:
    made = []
    for i in content.inputs if isinstance(content, Case) else ():
        labels = {"input": i.name, "unit": i.unit, "interpolation": i.interpolation}
        made.append([*_part(labels, INPUT, vars(i)), Column("delay", "s", np.full(len(i.time), i.delay))])
    return made


_PERIODIC_ORDERS = 2
"""Number of harmonics to which `periodic_sigma` applies [1]. Derived: one and two periods per turn."""
_HARMONIC_ORDERS = 12
"""Number of harmonics to which `harmonic_sigma` applies [1]. Derived: 1 to 12 periods per turn."""


def _errors(content: Recording | Case) -> list[list[Column]]:
    bodies: Sequence[tuple[str, BodyTrack | Series]] = (
        list(content.bodies.items()) if isinstance(content, Recording) else content.motions
    )
    unit = "rad" if isinstance(content, Recording) or content.quantity == "angle" else "rad s-1"
    parts = []
    for name, series in bodies:
        for mode in series.modes if isinstance(series, Series) else ():
            u = np.sqrt(np.maximum(np.sum((mode.basis @ mode.covariance) * mode.basis, axis=1), 0.0))
            parts.append(_error(name, series.time, (mode.name, mode.group, mode.origin), u, unit))
        for mode_name, u in _stated_errors(series):
            parts.append(_error(name, series.time, (mode_name, "", "tracking"), u, "rad"))
    return parts


def _error(body: str, time: Floats, words: tuple[str, str, str], u: Floats, unit: str) -> list[Column]:
    named = zip(("body", "mode", "group", "origin"), (body, *words), strict=True)
    constant = [Column(key, "", np.full(len(time), word, dtype=object)) for key, word in named]
    return [*constant, Column("time", "s", time), Column("u", unit, u)]


def _stated_errors(series: BodyTrack | Series) -> Iterator[tuple[str, Floats]]:
    """Yield each error of which a track states the standard uncertainty, and the resulting uncertainties [rad].

    Each sample has one standard uncertainty. For an error that repeats with the turn, the amplitudes of cosine and sine
    of each order have the same variance.
    """
    if series.correlated_sigma > 0:
        profile = np.array(series.correlated_profile or ((0.0, series.correlated_sigma),))
        yield "zero", np.interp(series.time, *profile.T)
    for name, orders in (("periodic", _PERIODIC_ORDERS), ("harmonic", _HARMONIC_ORDERS)):
        amplitude = getattr(series, f"{name}_sigma")
        if amplitude > 0:
            yield name, np.full(len(series.time), amplitude * math.sqrt(orders))


def _points(content: Recording | Case) -> list[list[Column]]:
    return [
        [_scaled(c, p.m_per_px) for c in _part({"clip": clip, "point": name}, POINT, vars(p))]
        for clip, r in _clips(content).items()
        for name, p in r.points.items()
    ]


def _scaled(column: Column, m_per_px: float) -> Column:
    """Return a column of lengths in m if the length of a pixel is known, else in px."""
    if column.unit != "px" or math.isnan(m_per_px):
        return column
    return Column(column.name, "m", column.values * m_per_px)


TABLES: dict[str, Callable[[Recording | Case], list[list[Column]]]] = {
    "motion": _motion,
    "markers": _markers,
    "frames": _frames,
    "inputs": _inputs,
    "points": _points,
    "errors": _errors,
}


def _clips(content: Recording | Case) -> dict[str, Recording]:
    return {content.source: content} if isinstance(content, Recording) else content.recordings


def _part(labels: Mapping[str, str], table: Table, values: Mapping[str, Any]) -> list[Column]:
    """Return constant columns and the fields of a table; several numbers per sample become several columns."""
    rows = len(values[table.fields[0].name])
    made = [Column(name, "", np.full(rows, word, dtype=object)) for name, word in labels.items()]
    for f in table.fields:
        value = np.asarray(values[f.name])
        if f.name == "status":
            made.append(Column(f.name, "", _STATUS_NAMES[value]))
        elif value.ndim == 1:
            made.append(Column(f.name, f.units, value))
        else:
            for place in np.ndindex(value.shape[1:]):
                *side, axis = place
                name = "_".join([f.name, *(str(s) for s in side), "xy"[axis]])
                made.append(Column(name, f.units, value[(slice(None), *place)]))
    return made


_VALUE = r"[+]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_INERTIA = re.compile(
    rf"\(?\s*(?P<value>{_VALUE})\s*(?:(?:\+-|\+/-|±)\s*(?P<u>{_VALUE})\s*(?P<percent>%)?\s*)?\)?\s*(?P<unit>[a-zµ].*)?",
    re.IGNORECASE,
)
# an uncertainty after the unit may have the same unit, no unit, or be in per cent
_UNIT_FIRST = re.compile(
    rf"(?P<value>{_VALUE})\s*(?P<unit>(?:kg|mg|g)[^+±]*?)\s*(?:\+-|\+/-|±)\s*(?P<u>{_VALUE})\s*(?P<percent>%)?\s*(?P<again>[a-z].*)?",
    re.IGNORECASE,
)
_MASS = {"kg": 1.0, "g": 1e-3, "mg": 1e-6}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_UNIT = re.compile(r"(kg|g|mg)\s*[*·. ]?\s*(m|cm|mm)\s*(?:\^|\*\*)?\s*(?:2|²)")
_INERTIA_EXAMPLE = (
    'Write, for example, "5.54e-5 +- 0.06e-5" (kg m2) or "554 g cm2 +- 6"; the uncertainty is optional.'
)

# limits of plausible moments of inertia: 1 mg at a radius of 1 mm, 1 t at a radius of 10 m
SMALLEST, LARGEST = 1e-12, 1e5


@dataclass(frozen=True)
class Inertia:
    """A moment of inertia."""

    value: float  # in kg m2
    u: float = math.nan  # standard uncertainty [kg m2]; NaN if it is not given

    @classmethod
    def of(cls, text: str | float | Inertia, body: str = "body") -> Inertia:
        """Read a moment of inertia: a number in kg m2, or a text with optional uncertainty and unit.

        Forms: "5.54e-5 +- 0.06e-5", "554 g cm2", "(554 +- 6) g cm2", "554 g cm2 +- 6", "554 g cm2 +- 1 %"; masses in
        kg, g, mg; lengths in m, cm, mm. A UsageError is raised if the text cannot be parsed, or the value is not
        plausible (`SMALLEST`, `LARGEST`).

        Examples
        --------
        >>> Inertia.of("(554 +- 6) g cm2")
        Inertia(value=5.54e-05, u=6e-07)
        """
        if isinstance(text, Inertia):
            return text
        found = _UNIT_FIRST.fullmatch(str(text).strip()) or _INERTIA.fullmatch(str(text).strip())
        if found is not None and (found.groupdict().get("again") or found["unit"]) != found["unit"]:
            found = None
        unit = _UNIT.fullmatch((found["unit"] or "kg m2").strip()) if found else None
        if found is None or unit is None:
            what = f"'{str(text)[:40]}' is not a moment of inertia of the {body}."
            raise UsageError(what, _INERTIA_EXAMPLE)
        factor = _MASS[unit[1]] * _LENGTH[unit[2]] ** 2
        # rounded, so that 554 g cm2 is exactly 5.54e-5 kg m2
        value = float(f"{float(found['value']) * factor:.15g}")
        share = value / 100.0 if found["percent"] else factor
        u = float(f"{float(found['u']) * share:.15g}") if found["u"] else math.nan
        if not SMALLEST <= value <= LARGEST:
            what = f"A moment of inertia of {value:g} kg m2 is not possible for the {body}."
            raise UsageError(what, "Check number and unit; a number without a unit is in kg m2.")
        if u >= value:
            what = f"The uncertainty of the moment of inertia of the {body} is not smaller than its value."
            raise UsageError(what, _INERTIA_EXAMPLE)
        return cls(value, u)

    @classmethod
    def required(cls, text: str | float | Inertia | None, body: str) -> Inertia:
        """Read a moment of inertia that has no default; see `of`."""
        if text is None:
            raise UsageError(
                f"The moment of inertia of the {body} is not given, but torques depend on it.",
                f'Give --inertia-{body} "VALUE +- UNCERTAINTY" in kg m2, for example "5.54e-5 +- 0.06e-5".',
            )
        return cls.of(text, body)
