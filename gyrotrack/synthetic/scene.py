"""What stands on the table: the gyroscope with its papers, in millimetres, seen from above.

Coordinates of a body are polar, (r, theta) about its axis, theta growing in the sense in which the bodies
turn. A paper mounted at ``mount`` therefore has the angle ``psi + mount`` when its body has turned by
``psi``. Colours are linear light, 0 to 1, (red, green, blue).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
        Rotation in rad about the middle of the near base: papers are glued on by hand.
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
    """The tiny circular motion of the whole gyroscope beside its rotation.

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
        The papers on both bodies.
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
        What the gyroscope stands on.
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
        """Return the papers of one body."""
        return tuple(marker for marker in self.markers if marker.body == body)

    def casing_covers(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Tell which points (mm, frame of the casing) lie under bar, hub, ring or a paper of the casing."""
        r = np.hypot(x, y)
        covered = (r < self.hub_radius) | ((r >= self.ring_inner) & (r <= self.ring_outer))
        covered |= (np.abs(y) < 0.5 * self.bar_width) & (r <= self.ring_outer)
        for paper in self.on("casing"):
            along, across = paper.local(x, y)
            covered |= (along >= 0.0) & (along <= paper.length) & (np.abs(across) <= 0.5 * paper.base)
        return covered
