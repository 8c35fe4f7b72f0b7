"""The rendered experiment: gyroscope, markers, camera, light, and the exact motion of both bodies.

The plane of the table has axes u (right) and v (up in the image) in mm about the mean position of the axis of the
gyroscope. A body at the angle ``psi`` has turned by ``sense * psi`` counter-clockwise in the image. In images x points
right, y points down, and pixel centres are at integers.

Coordinates of a body are polar, (r, theta) about its axis, with theta increasing in the sense of rotation. A marker
mounted at ``mount`` has the angle ``psi + mount``. Colours are linear intensities, 0 to 1, (red, green, blue).

Angles are in rad, unwrapped, and increase in the sense of rotation; times are in s on the true clock. The motion shares
no code with `fitting`, so that tests do not repeat its errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """One camera: image, clock, position, imperfections."""

    # size of the image in px; both even
    width: int = 640
    height: int = 360
    fps: float = 260.0  # capture rate on the clock of the camera in 1/s
    # rate in the container, for slow motion (1000 captured, 25 stored). None: the capture rate
    container_fps: float | None = None
    exposure: float = 1.0e-3  # exposure time in s
    scale: float = 4.4  # magnification in px per mm
    # image of the mean position of the axis, (x, y) in px. None: the middle of the image
    centre: tuple[float, float] | None = None
    # angle in rad between the optical axis and the normal of the table, and its azimuth (rad, counter-clockwise
    # from right). A circle becomes an ellipse with the axis ratio cos(tilt) and the minor axis along the azimuth
    tilt: float = 0.0
    tilt_azimuth: float = 1.1
    # rotation in rad of the camera about its axis: a body at the angle ``psi`` appears at ``psi + sense * roll``
    roll: float = 0.0
    perspective: float = 0.0  # inverse distance of the camera in 1/mm; 0 is orthographic
    # true time of frame 0 in s, and true seconds per second of the camera clock: ``t = start + rate * k / fps`` is
    # the middle of the exposure of frame k
    start: float = 0.0
    rate: float = 1.0
    # true time in s from the first to the last row (rolling shutter); 0 is a global shutter. The nominal time of a
    # frame is the time of the row of ``rest``
    readout: float = 0.0
    # -1: the bodies turn clockwise in the image, as in the films of the paper (arXiv:2605.06700)
    sense: int = -1
    psf: float = 0.6  # standard deviation in px of the point spread function (lens and pixel)
    # standard deviation of the sensor noise in grey levels (of 255), independent in the three colours
    noise: float = 2.0
    gamma: float = 2.0  # grey level = 255 * intensity**(1 / gamma). 2 resembles a camera; 1 is linear

    def __post_init__(self) -> None:
        if self.sense not in (-1, 1):
            raise ValueError(f"sense must be -1 (clockwise in the image) or 1, not {self.sense}")
        if self.width % 2 or self.height % 2:
            raise ValueError(f"width and height must be even for H.264, not {self.width}x{self.height}")

    @property
    def rest(self) -> tuple[float, float]:
        """Image of the mean position of the axis, (x, y) in px."""
        return self.centre or ((self.width - 1) / 2.0, (self.height - 1) / 2.0)

    def times(self, frames: int) -> Array:
        """Return the true times in s of the middle of each exposure."""
        return np.asarray(self.start + self.rate * np.arange(frames) / self.fps, dtype=np.float64)

    def row_delay(self, rows: ArrayLike) -> Array:
        """Return the delay of the exposure of rows relative to the nominal time, in s."""
        return self.readout * (np.asarray(rows, dtype=np.float64) - self.rest[1]) / max(self.height - 1, 1)

    def project(self, plane: ArrayLike) -> Array:
        """Project points of the table, (..., 2) in mm, to the image, (..., 2) in px."""
        point = np.asarray(plane, dtype=np.float64)
        u, v = _rotate(point[..., 0], point[..., 1], self.roll)
        falling, level = _rotate(u, v, -self.tilt_azimuth)
        size = self.scale / (1.0 + self.perspective * np.sin(self.tilt) * falling)
        a, b = _rotate(size * np.cos(self.tilt) * falling, size * level, self.tilt_azimuth)
        x0, y0 = self.rest
        return np.stack([x0 + a, y0 - b], axis=-1)

    def unproject(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Return the points (u, v) of the table in mm at (x, y) px: the inverse of `project`."""
        x0, y0 = self.rest
        a = (np.asarray(x, dtype=np.float64) - x0) / self.scale
        b = (y0 - np.asarray(y, dtype=np.float64)) / self.scale
        short, long = _rotate(a, b, -self.tilt_azimuth)
        lean = self.perspective * np.sin(self.tilt)
        falling = short / (np.cos(self.tilt) - lean * short)
        level = long * (1.0 + lean * falling)
        return _rotate(*_rotate(falling, level, self.tilt_azimuth), -self.roll)

    def turn(self, body: ArrayLike, angle: ArrayLike) -> Array:
        """Rotate points of a body, (m, 2) in mm, by its angles (n,) in rad: points of the table, (n, m, 2) in mm."""
        point, psi = np.asarray(body, dtype=np.float64), np.atleast_1d(np.asarray(angle, dtype=np.float64))
        c, s = np.cos(psi)[:, None], np.sin(psi)[:, None]
        u = c * point[:, 0] - s * point[:, 1]
        v = s * point[:, 0] + c * point[:, 1]
        return np.stack([u, self.sense * v], axis=-1)


def _rotate(x: Array, y: Array, angle: float) -> tuple[Array, Array]:
    """Rotate points counter-clockwise (y up)."""
    c, s = np.cos(angle), np.sin(angle)
    return c * x - s * y, s * x + c * y


@dataclass(frozen=True)
class Light:
    """Illumination: level, non-uniformity, flicker, reflections and shadows."""

    level: float = 1.0  # brightness at the centre; 1 reproduces the colours
    # relative change of brightness per image width to the right, and per image height downwards
    gradient: tuple[float, float] = (0.0, 0.0)
    vignette: float = 0.0  # relative loss of brightness in the corners
    # relative amplitude, frequency in Hz and phase in rad of the brightness in true time
    flicker: float = 0.0
    flicker_hz: float = 100.0
    flicker_phase: float = 0.0
    glint: float = 0.0  # brightness of lamp reflections on the metal, which are fixed in space
    shadow: float = 0.0  # depth, 0 to 1, of the shadows on the table and of the bar on the rotor
    shadow_offset: tuple[float, float] = (0.8, -1.2)  # displacement of the shadow of the bar, (u, v) in mm

    def field(self, camera: Camera) -> Array:
        """Return the constant brightness of every pixel, (height, width)."""
        x0, y0 = camera.rest
        x = (np.arange(camera.width) - x0) / camera.width
        y = ((np.arange(camera.height) - y0) / camera.height)[:, None]
        slope = 1.0 + self.gradient[0] * x + self.gradient[1] * y
        bright = self.level * slope * (1.0 - 2.0 * self.vignette * (x**2 + y**2))
        return np.asarray(np.maximum(bright, 0.0), dtype=np.float64)

    def pulse(self, time: ArrayLike, exposure: float) -> Array:
        """Return the mean brightness over exposures centred at ``time``, relative to constant brightness.

        The mean of 1 + a sin(2 pi f t + phi) over an exposure T is 1 + a sinc(f T) sin(2 pi f t_mid + phi).
        """
        angle = 2.0 * np.pi * self.flicker_hz * np.asarray(time, dtype=np.float64) + self.flicker_phase
        return 1.0 + self.flicker * np.sinc(self.flicker_hz * exposure) * np.sin(angle)


Colour = tuple[float, float, float]
Table = Literal["grey", "white", "wood"]

RED: Colour = (0.56, 0.035, 0.045)
BLUE: Colour = (0.03, 0.13, 0.58)
GREEN: Colour = (0.05, 0.38, 0.10)
WHITE: Colour = (0.86, 0.86, 0.84)


@dataclass(frozen=True)
class Marker:
    """A rectangular marker of coloured paper on a body."""

    # name in the results; "rotor" or "casing"
    name: str
    body: Literal["rotor", "casing"]
    colour: Colour  # linear red, green, blue
    mount: float  # angle on the body of the middle of the inner base in rad
    # distance of the inner base from the axis, length along the radius, length of the inner base in mm
    near: float
    length: float
    base: float
    skew: float = 0.0  # rotation about the middle of the inner base in rad

    def corners(self) -> Array:
        """Return the four corners in the frame of the body, (4, 2) in mm: inner -, inner +, outer +, outer -."""
        across = np.array([-0.5, 0.5, 0.5, -0.5]) * self.base
        along = np.array([0.0, 0.0, 1.0, 1.0]) * self.length
        x = self.near + along * np.cos(self.skew) - across * np.sin(self.skew)
        y = along * np.sin(self.skew) + across * np.cos(self.skew)
        c, s = np.cos(self.mount), np.sin(self.mount)
        return np.stack([c * x - s * y, s * x + c * y], axis=-1)

    def local(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Convert coordinates of the body to (along, across) the marker, from the middle of its inner base."""
        c, s = np.cos(self.mount), np.sin(self.mount)
        u, v = c * x + s * y - self.near, c * y - s * x
        cs, ss = np.cos(self.skew), np.sin(self.skew)
        return cs * u + ss * v, cs * v - ss * u


@dataclass(frozen=True)
class Wobble:
    """A circular motion of the axis: ``radius`` [mm], ``frequency`` [Hz], ``phase`` [rad] at time 0."""

    radius: float = 0.0
    frequency: float = 6.0
    phase: float = 0.0

    def shift(self, time: Array) -> Array:
        """Return the displacement at the given times in mm, (..., 2)."""
        angle = 2.0 * np.pi * self.frequency * np.asarray(time, dtype=np.float64) + self.phase
        return self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


PAPERS: tuple[Marker, ...] = (
    Marker("red", "casing", RED, 0.0, 16.5, 9.0, 6.0),
    Marker("blue", "rotor", BLUE, 0.35, 12.5, 9.0, 6.5),
    Marker("white", "rotor", WHITE, 2.47, 12.5, 9.0, 6.5),
    Marker("green", "rotor", GREEN, 4.51, 12.5, 9.0, 6.5),
)


@dataclass(frozen=True)
class Scene:
    """The gyroscope on a table."""

    markers: tuple[Marker, ...] = PAPERS  # the markers on both bodies
    # radii in mm of the rotor and of the ring of the casing; the gap between them is dark
    rotor_radius: float = 26.0
    ring_inner: float = 27.5
    ring_outer: float = 31.5
    # width in mm of the bar of the casing across the rotor (0: no bar), radii of its hub and of the red disc at the
    # centre
    bar_width: float = 7.0
    hub_radius: float = 5.0
    circle_radius: float = 3.4
    circle_colour: Colour = RED
    # linear brightness of the metal of rotor and casing
    metal: float = 0.20
    ring_metal: float = 0.30
    structure: float = 0.06  # relative amplitude of the texture of the metal
    table: Table = "grey"  # kind of table
    wobble: Wobble = Wobble()  # circular motion of the axis

    def on(self, body: str) -> tuple[Marker, ...]:
        """Return the markers of one body."""
        return tuple(marker for marker in self.markers if marker.body == body)

    def casing_covers(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Return a mask of points [mm, frame of the casing] occluded by bar, hub, ring or a marker of the casing."""
        r = np.hypot(x, y)
        covered = (r < self.hub_radius) | ((r >= self.ring_inner) & (r <= self.ring_outer))
        covered |= (np.abs(y) < 0.5 * self.bar_width) & (r <= self.ring_outer)
        for paper in self.on("casing"):
            along, across = paper.local(x, y)
            covered |= (along >= 0.0) & (along <= paper.length) & (np.abs(across) <= 0.5 * paper.base)
        return covered


Curve = Callable[[ArrayLike], Array]


@dataclass(frozen=True)
class Motion:
    """The angles and speeds of both bodies as functions of the true time."""

    # angle in rad, unwrapped, at times in s (scalar or array)
    psi_rotor: Curve
    psi_casing: Curve
    # angular velocity in rad/s
    omega_rotor: Curve
    omega_casing: Curve
    # limits of the time for which the motion is known [s]
    start: float = -np.inf
    stop: float = np.inf

    @classmethod
    def constant(
        cls, omega_rotor: float, omega_casing: float, psi_rotor: float = 0.0, psi_casing: float = 0.0
    ) -> Motion:
        """Both bodies at constant speed: psi = psi_0 + omega t."""

        def line(offset: float, slope: float) -> Curve:
            return lambda t: offset + slope * np.asarray(t, dtype=np.float64)

        angles = line(psi_rotor, omega_rotor), line(psi_casing, omega_casing)
        return cls(*angles, line(omega_rotor, 0.0), line(omega_casing, 0.0))

    @classmethod
    def from_speeds(
        cls,
        time: ArrayLike,
        omega_rotor: ArrayLike,
        omega_casing: ArrayLike,
        psi_rotor: float = 0.0,
        psi_casing: float = 0.0,
    ) -> Motion:
        """Angles by integration of splines through at least four speeds [rad/s].

        ``psi_rotor`` and ``psi_casing`` are the angles at ``time[0]``.
        """
        t, rotor, casing = _splines(time, omega_rotor, omega_casing)
        angles = _curve(rotor.antiderivative(), psi_rotor), _curve(casing.antiderivative(), psi_casing)
        return cls(*angles, _curve(rotor), _curve(casing), float(t[0]), float(t[-1]))

    @classmethod
    def from_angles(cls, time: ArrayLike, psi_rotor: ArrayLike, psi_casing: ArrayLike) -> Motion:
        """Speeds from unwrapped angles: cubic splines through psi(t) and their derivatives."""
        t, rotor, casing = _splines(time, psi_rotor, psi_casing)
        speeds = _curve(rotor.derivative()), _curve(casing.derivative())
        return cls(_curve(rotor), _curve(casing), *speeds, float(t[0]), float(t[-1]))


def _splines(time: ArrayLike, rotor: ArrayLike, casing: ArrayLike) -> tuple[Array, Any, Any]:
    from scipy.interpolate import CubicSpline

    t, first, second = (np.asarray(x, dtype=np.float64) for x in (time, rotor, casing))
    return t, CubicSpline(t, first, extrapolate=False), CubicSpline(t, second, extrapolate=False)


def _curve(spline: Callable[[Array], Array], offset: float = 0.0) -> Curve:
    return lambda t: np.asarray(offset + spline(np.asarray(t, dtype=np.float64)))
