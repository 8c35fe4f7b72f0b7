"""Paints rotor, casing and table in linear light.

Edges are the exact picture of sharp edges seen through a Gaussian (the camera's ``psf``), so that sub-pixel
positions hold at every angle; there is no drawing on a pixel grid whose rounding would depend on the angle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrotrack.synthetic.optics import Camera, Light
from gyrotrack.synthetic.polar import PolarPicture, soft_box, soft_step
from gyrotrack.synthetic.scene import Colour, Marker, Scene

Array = NDArray[np.float64]

COLUMNS_PER_PX = 1.4  # along the rim; more towards the axis
ROWS_PER_PX = 1.4
GAP: Colour = (0.02, 0.02, 0.022)
TABLES: dict[str, Colour] = {
    "grey": (0.13, 0.13, 0.135),
    "white": (0.72, 0.72, 0.70),
    "wood": (0.30, 0.17, 0.08),
}


class _Canvas:
    """Polar grid with colour (times cover) and cover, painted from below to above."""

    def __init__(self, scene: Scene, camera: Camera, reach: float) -> None:
        self.sigma = max(camera.psf, 0.2) / camera.scale
        self.per_mm = ROWS_PER_PX * camera.scale
        columns = int(np.ceil(2.0 * np.pi * scene.ring_outer * camera.scale * COLUMNS_PER_PX / 8.0)) * 8
        self.r = (np.arange(int(np.ceil(reach * self.per_mm)) + 2) / self.per_mm)[:, None]
        self.theta = np.arange(columns)[None, :] * (2.0 * np.pi / columns)
        self.x, self.y = self.r * np.cos(self.theta), self.r * np.sin(self.theta)
        self.colour = np.zeros((*self.x.shape, 3))
        self.cover = np.zeros(self.x.shape)

    def over(self, cover: Array, colour: Colour | Array) -> None:
        """Lay a colour over what is there, as far as it covers."""
        paint = np.asarray(colour, dtype=np.float64)
        self.colour *= 1.0 - cover[..., None]
        self.colour += cover[..., None] * paint
        self.cover = self.cover + cover - self.cover * cover

    def paper(self, marker: Marker) -> None:
        """Lay a rectangle of paper on the body."""
        along, across = marker.local(self.x, self.y)
        half = 0.5 * marker.base
        cover = soft_box(along, 0.0, marker.length, self.sigma) * soft_box(across, -half, half, self.sigma)
        self.over(cover, marker.colour)

    def picture(self, fourth: Array) -> PolarPicture:
        """Return the painting with a fourth channel."""
        return PolarPicture.of(np.dstack([self.colour, fourth]), self.per_mm)


def paint_rotor(scene: Scene, camera: Camera) -> PolarPicture:
    """Paint the rotor: channels red, green, blue, and the share of bare metal, which can glint.

    It is opaque as far as beneath the ring of the casing: the gap between them is painted dark.
    """
    canvas = _Canvas(scene, camera, scene.ring_outer + 4.0)
    lathe = 1.0 + scene.structure * (np.sin(3.1 * canvas.r) + 0.6 * np.sin(7.7 * canvas.r + 1.0))
    uneven = scene.structure * (
        0.5 * np.sin(5.0 * canvas.theta + 0.4) + 0.5 * np.sin(11.0 * canvas.theta + 2.0)
    )
    metal = scene.metal * (lathe + uneven * np.clip(canvas.r / scene.rotor_radius, 0.0, 1.0))
    canvas.over(np.ones(canvas.x.shape), GAP)
    disc = np.broadcast_to(soft_step(scene.rotor_radius - canvas.r, canvas.sigma), canvas.x.shape)
    canvas.over(disc, metal[..., None] * np.array([1.0, 1.0, 1.02]))
    bare = disc.copy()
    for marker in scene.on("rotor"):
        before = canvas.cover.copy()
        canvas.cover = np.zeros_like(before)
        canvas.paper(marker)
        bare *= 1.0 - canvas.cover
        canvas.cover = before
    return canvas.picture(bare)


def paint_casing(scene: Scene, camera: Camera) -> PolarPicture:
    """Paint the casing: channels red, green, blue times cover, and the cover."""
    canvas = _Canvas(scene, camera, scene.ring_outer + 4.0)
    bright = 1.0 + scene.structure * (np.sin(3.0 * canvas.theta + 1.3) + 0.7 * np.sin(8.0 * canvas.theta))
    bevel = 1.0 + 0.25 * np.sin(np.pi * (canvas.r - scene.ring_inner) / (scene.ring_outer - scene.ring_inner))
    tone = np.array([1.0, 0.99, 0.97])
    ring = soft_box(canvas.r, scene.ring_inner, scene.ring_outer, canvas.sigma)
    metal = scene.ring_metal * bright * np.where(canvas.r > scene.ring_inner, bevel, 1.0)
    canvas.over(np.broadcast_to(ring, canvas.x.shape), metal[..., None] * tone)
    if scene.bar_width > 0.0:
        half = 0.5 * scene.bar_width
        middle = 0.5 * (scene.ring_inner + scene.ring_outer)
        bar = soft_box(canvas.y, -half, half, canvas.sigma) * soft_step(middle - canvas.r, canvas.sigma)
        canvas.over(bar, scene.ring_metal * 0.9 * tone)
        canvas.over(_everywhere(canvas, scene.hub_radius), scene.ring_metal * 1.1 * tone)
    for marker in scene.on("casing"):
        canvas.paper(marker)
    if scene.circle_radius > 0.0:
        canvas.over(_everywhere(canvas, scene.circle_radius), scene.circle_colour)
    return canvas.picture(canvas.cover)


def _everywhere(canvas: _Canvas, radius: float) -> Array:
    """Cover of a disc about the axis."""
    return np.array(np.broadcast_to(soft_step(radius - canvas.r, canvas.sigma), canvas.x.shape))


def paint_table(scene: Scene, camera: Camera, light: Light, seed: int = 0) -> Array:
    """Paint the table with the shadow of the gyroscope on it, (height, width, 3), linear, lit."""
    x, y = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
    u, v = camera.unproject(x, y)
    tone = np.array(TABLES[scene.table])
    table = _grain(u, v, scene.table, seed)[..., None] * tone
    du, dv = light.shadow_offset
    spread = 3.0
    shadow = soft_step(scene.ring_outer + 1.0 - np.hypot(u - 3.0 * du, v - 3.0 * dv), spread)
    table *= (1.0 - light.shadow * shadow)[..., None]
    return np.asarray(table * light.field(camera)[..., None])


def _grain(u: Array, v: Array, table: str, seed: int) -> Array:
    """Relative brightness of the table at points in mm: fine grain, or the rings and planks of wood."""
    rng = np.random.default_rng(seed)
    if table != "wood":
        waves = rng.uniform(0.2, 1.2, (6, 2)) * rng.choice([-1.0, 1.0], (6, 2))
        phases = rng.uniform(0.0, 2.0 * np.pi, 6)
        total = sum(np.sin(a * u + b * v + p) for (a, b), p in zip(waves, phases, strict=True))
        return np.asarray(1.0 + 0.012 * total)
    plank = np.floor((v + 200.0) / 38.0)
    offset = np.mod(plank * 0.618, 1.0)
    bend = 0.8 * np.sin(0.045 * u + 9.0 * offset) + 0.3 * np.sin(0.11 * u + 4.0 * offset)
    rings = np.sin(1.9 * (v + bend * 4.0) + 20.0 * offset) + 0.5 * np.sin(5.3 * (v + bend * 3.0))
    joint = 1.0 - 0.5 * np.exp(-0.5 * ((np.mod(v + 200.0, 38.0) - 19.0 + 18.6) / 0.35) ** 2)
    return np.asarray((0.9 + 0.25 * offset + 0.10 * rings) * joint)
