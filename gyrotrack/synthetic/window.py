"""What stands still in the part of the picture that the gyroscope can touch; computed once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrotrack.synthetic.optics import Camera, Light
from gyrotrack.synthetic.polar import FULL, Picture
from gyrotrack.synthetic.scene import Scene

Array = NDArray[np.float64]
LAMPS = (
    (0.6, 1.0, 0.10),
    (2.3, 0.7, 0.14),
    (3.9, 0.9, 0.09),
    (5.3, 0.6, 0.12),
)  # where, strength, width


@dataclass(frozen=True)
class Window:
    """Rows and columns of the picture, and maps over them, (h, w) each.

    Attributes
    ----------
    rows, columns : slice
        The place in the picture.
    u, v : array
        Point of the table in mm that is seen at each pixel.
    table : (3, h, w) array
        Light of the table, zero where the rotor lies over it.
    lamps, lamps_inside : array
        Steady brightness per stored unit of a polar picture; the second is zero outside the rotor.
    glint : array
        Light of reflections on bare metal, per stored unit.
    papers : array of bool
        Where the papers of the rotor pass.
    """

    rows: slice
    columns: slice
    u: Picture
    v: Picture
    table: Picture
    lamps: Picture
    lamps_inside: Picture
    glint: Picture
    papers: NDArray[np.bool_]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the window."""
        return self.u.shape[0], self.u.shape[1]


def cut_window(scene: Scene, camera: Camera, light: Light, table: Array) -> Window:
    """Find the window of the gyroscope and compute its still layers from the lit table (height, width, 3)."""
    around = np.linspace(0.0, 2.0 * np.pi, 64)
    reach = scene.ring_outer + scene.wobble.radius + 5.0 * camera.psf / camera.scale
    rim = camera.project(reach * np.stack([np.cos(around), np.sin(around)], axis=-1))
    low, high = np.floor(rim.min(axis=0)).astype(int), np.ceil(rim.max(axis=0)).astype(int) + 1
    columns = slice(int(max(low[0], 0)), int(min(high[0], camera.width)))
    rows = slice(int(max(low[1], 0)), int(min(high[1], camera.height)))
    x, y = np.meshgrid(np.arange(columns.start, columns.stop), np.arange(rows.start, rows.stop))
    u, v = camera.unproject(x, y)
    r = np.hypot(u, v)
    inside = r < 0.5 * (scene.ring_inner + scene.ring_outer)  # its border lies under the ring
    lamps = light.field(camera)[rows, columns] / FULL
    near = min((m.near for m in scene.on("rotor")), default=np.inf)
    far = max((m.near + m.length for m in scene.on("rotor")), default=0.0)
    margin = scene.wobble.radius + 1.5
    still = np.where(inside[..., None], 0.0, table[rows, columns]).transpose(2, 0, 1)
    return Window(
        rows=rows,
        columns=columns,
        u=_single(u),
        v=_single(v),
        table=_single(still),
        lamps=_single(lamps),
        lamps_inside=_single(np.where(inside, lamps, 0.0)),
        glint=_single(_glints(u, v, scene, light)),
        papers=(r > near - margin) & (r < far + margin),
    )


def _glints(u: Array, v: Array, scene: Scene, light: Light) -> Array:
    """Reflections of four lamps: streaks along the radius, as turned metal shows them, still in the room."""
    angle, r = np.arctan2(v, u), np.hypot(u, v)
    total = np.zeros_like(u)
    for place, strength, width in LAMPS:
        away = np.angle(np.exp(1j * (angle - place)))
        total += strength * np.exp(-0.5 * (away / width) ** 2)
    return light.glint / FULL * total * np.clip(r / scene.ring_outer, 0.0, 1.0)


def _single(array: Array) -> Picture:
    return np.ascontiguousarray(array, dtype=np.float32)
