"""The rendered scene: gyroscope, markers, camera, light.

The plane of the table has axes u (right) and v (up as seen) in mm about the resting point of the gyroscope. A
body at angle ``psi`` has turned by ``sense * psi`` counter-clockwise as seen. Pictures have x right, y down,
and pixel centres at integers.

Coordinates of a body are polar, (r, theta) about its axis, theta growing in the sense in which the bodies
turn. A paper mounted at ``mount`` therefore has the angle ``psi + mount`` when its body has turned by
``psi``. Colours are linear light, 0 to 1, (red, green, blue).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """One camera: its picture, its clock, its place, its faults.

    Attributes
    ----------
    width, height : int
        Size of the picture in px; both even.
    fps : float
        Frames captured per second of the camera's own clock.
    container_fps : float or None
        Rate written into the file, for slow motion (1000 captured, 25 stored). None: as captured.
    exposure : float
        Exposure in s; everything that turns is averaged over it.
    scale : float
        Magnification in px per mm.
    centre : tuple of float or None
        Where the resting point of the gyroscope lands, (x, y) in px. None: the middle of the picture.
    tilt, tilt_azimuth : float
        Inclination in rad of the optical axis from the normal of the table, and the direction (rad,
        counter-clockwise from right) towards which the table falls away. A circle becomes an ellipse with the
        axis ratio cos(tilt), short along the azimuth.
    roll : float
        Rotation in rad of the camera about its axis: everything appears turned counter-clockwise by it, so
        that a body at angle ``psi`` appears at ``psi + sense * roll``.
    perspective : float
        Inverse distance of the camera in 1/mm; 0 is orthographic.
    start, rate : float
        The true time of frame 0, and true seconds per second of the camera's clock:
        ``t = start + rate * k / fps`` is the middle of the exposure of frame k.
    readout : float
        Seconds of true time from the first to the last row (rolling shutter); 0 is a global shutter. The
        nominal time belongs to the row that contains the resting point.
    sense : {-1, 1}
        -1: the bodies turn clockwise as seen, as in the paper.
    psf : float
        Standard deviation in px of the picture of a point (lens and pixel together).
    noise : float
        Standard deviation of the sensor noise in grey levels (of 255), independent in the three colours.
    gamma : float
        Grey level = 255 * light**(1 / gamma). 2 resembles a camera; 1 is linear, for tests of exactness.
    """

    width: int = 640
    height: int = 360
    fps: float = 260.0
    container_fps: float | None = None
    exposure: float = 1.0e-3
    scale: float = 4.4
    centre: tuple[float, float] | None = None
    tilt: float = 0.0
    tilt_azimuth: float = 1.1
    roll: float = 0.0
    perspective: float = 0.0
    start: float = 0.0
    rate: float = 1.0
    readout: float = 0.0
    sense: int = -1
    psf: float = 0.6
    noise: float = 2.0
    gamma: float = 2.0

    def __post_init__(self) -> None:
        if self.sense not in (-1, 1):
            msg = f"sense is -1 (clockwise as seen) or 1, not {self.sense}"
            raise ValueError(msg)
        if self.width % 2 or self.height % 2:
            msg = f"width and height must be even for H.264, not {self.width}x{self.height}"
            raise ValueError(msg)

    @property
    def rest(self) -> tuple[float, float]:
        """Where the resting point of the gyroscope lands, (x, y) in px."""
        return self.centre or ((self.width - 1) / 2.0, (self.height - 1) / 2.0)

    def times(self, frames: int) -> Array:
        """Return the true times in s of the middle of each exposure."""
        return np.asarray(self.start + self.rate * np.arange(frames) / self.fps, dtype=np.float64)

    def row_delay(self, rows: ArrayLike) -> Array:
        """Return how much later than the nominal time these rows are exposed, in s."""
        return self.readout * (np.asarray(rows, dtype=np.float64) - self.rest[1]) / max(self.height - 1, 1)

    def project(self, plane: ArrayLike) -> Array:
        """Project points of the table, (..., 2) in mm, into the picture, (..., 2) in px."""
        point = np.asarray(plane, dtype=np.float64)
        u, v = _rotate(point[..., 0], point[..., 1], self.roll)
        falling, level = _rotate(u, v, -self.tilt_azimuth)
        size = self.scale / (1.0 + self.perspective * np.sin(self.tilt) * falling)
        a, b = _rotate(size * np.cos(self.tilt) * falling, size * level, self.tilt_azimuth)
        x0, y0 = self.rest
        return np.stack([x0 + a, y0 - b], axis=-1)

    def unproject(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Find the points (u, v) of the table in mm that are seen at (x, y) px: the inverse of `project`."""
        x0, y0 = self.rest
        a = (np.asarray(x, dtype=np.float64) - x0) / self.scale
        b = (y0 - np.asarray(y, dtype=np.float64)) / self.scale
        short, long = _rotate(a, b, -self.tilt_azimuth)
        lean = self.perspective * np.sin(self.tilt)
        falling = short / (np.cos(self.tilt) - lean * short)
        level = long * (1.0 + lean * falling)
        return _rotate(*_rotate(falling, level, self.tilt_azimuth), -self.roll)

    def turn(self, body: ArrayLike, angle: ArrayLike) -> Array:
        """Turn points of a body, (m, 2) in mm, by its angles (n,) in rad into the plane: (n, m, 2) in mm."""
        point, psi = np.asarray(body, dtype=np.float64), np.atleast_1d(np.asarray(angle, dtype=np.float64))
        c, s = np.cos(psi)[:, None], np.sin(psi)[:, None]
        u = c * point[:, 0] - s * point[:, 1]
        v = s * point[:, 0] + c * point[:, 1]
        return np.stack([u, self.sense * v], axis=-1)


def _rotate(x: Array, y: Array, angle: float) -> tuple[Array, Array]:
    """Turn points counter-clockwise (y up)."""
    c, s = np.cos(angle), np.sin(angle)
    return c * x - s * y, s * x + c * y


@dataclass(frozen=True)
class Light:
    """The lamps: level, unevenness, flicker, and what they do to metal and table.

    Attributes
    ----------
    level : float
        Brightness at the resting point; 1 shows colours as they are.
    gradient : tuple of float
        Relative change of brightness per picture width to the right, and per picture height downwards.
    vignette : float
        Relative loss of brightness in the corners.
    flicker, flicker_hz, flicker_phase : float
        Relative amplitude, frequency in Hz and phase in rad of the brightness in true time.
    glint : float
        Brightness of lamp reflections that are fixed in space on the turning metal.
    shadow : float
        Depth, 0 to 1, of the shadows on the table and of the bar on the rotor.
    shadow_offset : tuple of float
        Where the shadow of the bar falls, (u, v) in mm from the bar.
    """

    level: float = 1.0
    gradient: tuple[float, float] = (0.0, 0.0)
    vignette: float = 0.0
    flicker: float = 0.0
    flicker_hz: float = 100.0
    flicker_phase: float = 0.0
    glint: float = 0.0
    shadow: float = 0.0
    shadow_offset: tuple[float, float] = (0.8, -1.2)

    def field(self, camera: Camera) -> Array:
        """Return the steady brightness of every pixel, (height, width)."""
        x0, y0 = camera.rest
        x = (np.arange(camera.width) - x0) / camera.width
        y = ((np.arange(camera.height) - y0) / camera.height)[:, None]
        slope = 1.0 + self.gradient[0] * x + self.gradient[1] * y
        bright = self.level * slope * (1.0 - 2.0 * self.vignette * (x**2 + y**2))
        return np.asarray(np.maximum(bright, 0.0), dtype=np.float64)

    def pulse(self, time: ArrayLike, exposure: float) -> Array:
        """Return the mean brightness over exposures whose middles are ``time``, relative to the steady one.

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
    """A rectangle of coloured paper on a body.

    Attributes
    ----------
    name, body : str
        Name in the results; "rotor" or "casing".
    colour : tuple of float
        Linear red, green, blue.
    mount : float
        Angle in rad of the middle of its near base in the frame of the body.
    near, length, base : float
        Distance in mm of the near base from the axis, extent along the radius, length of the near base.
    skew : float
        Rotation in rad about the middle of the near base: markers are glued on by hand.
    """

    name: str
    body: Literal["rotor", "casing"]
    colour: Colour
    mount: float
    near: float
    length: float
    base: float
    skew: float = 0.0

    def corners(self) -> Array:
        """Return the four corners in the frame of the body, (4, 2) in mm: near -, near +, far +, far -."""
        across = np.array([-0.5, 0.5, 0.5, -0.5]) * self.base
        along = np.array([0.0, 0.0, 1.0, 1.0]) * self.length
        x = self.near + along * np.cos(self.skew) - across * np.sin(self.skew)
        y = along * np.sin(self.skew) + across * np.cos(self.skew)
        c, s = np.cos(self.mount), np.sin(self.mount)
        return np.stack([c * x - s * y, s * x + c * y], axis=-1)

    def local(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Turn coordinates of the body into (along, across) the paper, from the middle of its near base."""
        c, s = np.cos(self.mount), np.sin(self.mount)
        u, v = c * x + s * y - self.near, c * y - s * x
        cs, ss = np.cos(self.skew), np.sin(self.skew)
        return cs * u + ss * v, cs * v - ss * u


@dataclass(frozen=True)
class Wobble:
    """The tiny circular motion of the whole gyroscope in addition to its rotation.

    The centre runs on a circle of ``radius`` mm at ``frequency`` Hz, in the sense in which the bodies turn
    (a negative frequency turns against it), from ``phase`` rad at t = 0.
    """

    radius: float = 0.0
    frequency: float = 6.0
    phase: float = 0.0

    def shift(self, time: Array) -> Array:
        """Return the displacement in mm at the given times, (..., 2)."""
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
    """The gyroscope on its table.

    Attributes
    ----------
    markers : tuple of Marker
        The markers on both bodies.
    rotor_radius, ring_inner, ring_outer : float
        Radii in mm of the rotor disc and of the ring of the casing; the gap between them is dark.
    bar_width, hub_radius, circle_radius : float
        Width in mm of the bar of the casing across the rotor (0: no bar), radii of its hub and of the red
        paper disc at the centre.
    metal, ring_metal : float
        Brightness (linear) of the metal of rotor and casing.
    structure : float
        Relative depth of the slight structure of the metal.
    table : {"grey", "white", "wood"}
        The table under the gyroscope.
    wobble : Wobble
        Circular motion of the whole gyroscope.
    """

    markers: tuple[Marker, ...] = PAPERS
    rotor_radius: float = 26.0
    ring_inner: float = 27.5
    ring_outer: float = 31.5
    bar_width: float = 7.0
    hub_radius: float = 5.0
    circle_radius: float = 3.4
    circle_colour: Colour = RED
    metal: float = 0.20
    ring_metal: float = 0.30
    structure: float = 0.06
    table: Table = "grey"
    wobble: Wobble = Wobble()

    def on(self, body: str) -> tuple[Marker, ...]:
        """Return the markers of one body."""
        return tuple(marker for marker in self.markers if marker.body == body)

    def casing_covers(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Return which points (mm, frame of the casing) are covered by bar, hub, ring or a marker of the casing."""
        r = np.hypot(x, y)
        covered = (r < self.hub_radius) | ((r >= self.ring_inner) & (r <= self.ring_outer))
        covered |= (np.abs(y) < 0.5 * self.bar_width) & (r <= self.ring_outer)
        for paper in self.on("casing"):
            along, across = paper.local(x, y)
            covered |= (along >= 0.0) & (along <= paper.length) & (np.abs(across) <= 0.5 * paper.base)
        return covered
