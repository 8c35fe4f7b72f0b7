"""Rendering of frames with exact motion blur.

Bodies are painted in polar coordinates, so that motion blur is exactly a box filter along the columns: a body that
turns by w during the exposure appears at each angle as the mean of its picture over w.

Each edge is a step convolved with a Gaussian (the ``psf`` of the camera) in closed form, so that sub-pixel positions
are correct at every angle.

A pixel is the mean over the exposure of ``casing + (1 - cover) * rotor``, where cover is the opacity of the casing. The
means of casing, cover and rotor are exact. The mean of the product is exact where the cover does not change during the
exposure. In the narrow zone swept by the edges of the bar, the mean is a sum over sub-exposures.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrotrack.synthetic._scene import Camera, Colour, Light, Marker, Motion, Scene

Array = NDArray[np.float64]
Picture = NDArray[np.float32]
Paint = NDArray[np.uint16]

FULL = 40000.0  # stored value of the intensity 1; 16-bit integers are faster than floats
WIDTH_STEP = 0.25  # step to which the width of the blur is rounded [columns], about 0.1 px


@dataclass(frozen=True)
class PolarPicture:
    """Picture of a body in its polar coordinates, in linear intensity."""

    # row i is the radius ``i / per_mm``, column j the angle ``2 pi j / columns``; the intensity 1 is stored as
    # ``FULL``
    pixels: Paint
    per_mm: float  # rows per mm
    _blurred: dict[float, Paint] = field(default_factory=dict, init=False, repr=False, compare=False)

    @classmethod
    def of(cls, light: Array, per_mm: float) -> PolarPicture:
        """Store a picture in linear intensity, (rows, columns, channels)."""
        return cls(np.rint(np.clip(light * FULL, 0.0, 65535.0)).astype(np.uint16), per_mm)

    @property
    def columns(self) -> int:
        """Number of columns in a full turn."""
        return int(self.pixels.shape[1])

    @property
    def per_rad(self) -> float:
        """Columns per radian."""
        return self.columns / (2.0 * np.pi)

    def copy(self) -> PolarPicture:
        """Return the same picture with a separate cache."""
        return PolarPicture(self.pixels, self.per_mm)

    def channel(self, index: int) -> PolarPicture:
        """Return one channel as a separate picture."""
        return PolarPicture(np.ascontiguousarray(self.pixels[:, :, index : index + 1]), self.per_mm)

    def blurred(self, angle: float) -> Paint:
        """Return two turns of the picture, blurred by a rotation by ``angle`` [rad].

        The result is cached, because ``angle`` changes little.
        """
        width = round(abs(angle) * self.per_rad / WIDTH_STEP) * WIDTH_STEP
        width = max(1.0, min(width, float(self.columns)))
        if width not in self._blurred:
            self._blurred.clear()
            once, half = _box(self.pixels, width), self.columns // 2
            self._blurred[width] = np.concatenate([once[:, half:], once, once[:, : half + 1]], axis=1)
        return self._blurred[width]

    def sample(self, columns: Picture, rows: Picture, smear: float, out: Paint | None = None) -> Paint:
        """Interpolate the picture bilinearly at positions (column, row), with a motion blur of ``smear`` rad.

        Columns are in [0, 2 columns], with the angle 0 at ``columns / 2``.
        """
        paint = self.blurred(smear)
        return cv2.remap(  # type: ignore[return-value]
            paint, columns, rows, cv2.INTER_LINEAR, dst=out, borderMode=cv2.BORDER_REPLICATE
        )

    def seen_columns(self, angle: Picture, psi: Array) -> Picture:
        """Convert angles (in columns, within half a turn) to columns for `sample`, for a body at the angle psi."""
        n = self.columns
        shift = np.mod(-np.asarray(psi) * self.per_rad, n) + 0.5 * n
        return angle + shift.astype(np.float32)


def _box(pixels: Paint, width: float) -> Paint:
    """Average cyclically over ``width`` = n + 2 f centred columns: n columns (n odd), and a fraction f at each end."""
    columns = pixels.shape[1]
    odd = int(width) if int(width) % 2 else int(width) - 1
    share = 0.5 * (width - odd)
    pad = odd // 2 + 2
    mean = np.pad(pixels, ((0, 0), (pad, pad), (0, 0)), mode="wrap")
    if share > 0.0:
        inner, outer = cv2.blur(mean, (odd, 1)), cv2.blur(mean, (odd + 2, 1))
        mean = cv2.addWeighted(inner, (1.0 - share) * odd / width, outer, share * (odd + 2) / width, 0.0)  # type: ignore[assignment]
    elif odd > 1:
        mean = cv2.blur(mean, (odd, 1))  # type: ignore[assignment]
    mean = mean.reshape(pixels.shape[0], -1, pixels.shape[2])
    return np.ascontiguousarray(mean[:, pad : pad + columns])


def soft_step(x: Array, sigma: float) -> Array:
    """Return the unit step at 0, convolved with a Gaussian of standard deviation ``sigma``."""
    from scipy.special import ndtr

    return np.asarray(ndtr(x / sigma), dtype=np.float64)


def soft_box(x: Array, low: float, high: float, sigma: float) -> Array:
    """Return the box from ``low`` to ``high``, convolved with a Gaussian."""
    return soft_step(x - low, sigma) - soft_step(x - high, sigma)


LAMPS = (
    (0.6, 1.0, 0.10),
    (2.3, 0.7, 0.14),
    (3.9, 0.9, 0.09),
    (5.3, 0.6, 0.12),
)  # angle [rad], intensity, width [rad]


@dataclass(frozen=True)
class Window:
    """The part of the image with the gyroscope, and maps of it, (h, w) each."""

    # rows and columns in the image
    rows: slice
    columns: slice
    # point of the table at each pixel [mm]
    u: Picture
    v: Picture
    table: Picture  # intensity of the table, zero where the rotor covers the table
    # constant illumination per stored unit of a polar picture; the second array is zero outside of the rotor
    lamps: Picture
    lamps_inside: Picture
    glint: Picture  # intensity of reflections on bare metal, per stored unit
    papers: NDArray[np.bool_]  # region that the markers of the rotor sweep

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the window."""
        return self.u.shape[0], self.u.shape[1]


def cut_window(scene: Scene, camera: Camera, light: Light, table: Array) -> Window:
    """Find the window of the gyroscope and compute its static layers from the illuminated table (height, width, 3)."""
    around = np.linspace(0.0, 2.0 * np.pi, 64)
    reach = scene.ring_outer + scene.wobble.radius + 5.0 * camera.psf / camera.scale
    rim = camera.project(reach * np.stack([np.cos(around), np.sin(around)], axis=-1))
    low, high = np.floor(rim.min(axis=0)).astype(int), np.ceil(rim.max(axis=0)).astype(int) + 1
    columns = slice(int(max(low[0], 0)), int(min(high[0], camera.width)))
    rows = slice(int(max(low[1], 0)), int(min(high[1], camera.height)))
    x, y = np.meshgrid(np.arange(columns.start, columns.stop), np.arange(rows.start, rows.stop))
    u, v = camera.unproject(x, y)
    r = np.hypot(u, v)
    # including the edge of the rotor, which the ring of the casing occludes
    inside = r < 0.5 * (scene.ring_inner + scene.ring_outer)
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
    """Return the reflections of four lamps on turned metal: radial streaks that are fixed in space."""
    angle, r = np.arctan2(v, u), np.hypot(u, v)
    total = np.zeros_like(u)
    for place, strength, width in LAMPS:
        away = np.angle(np.exp(1j * (angle - place)))
        total += strength * np.exp(-0.5 * (away / width) ** 2)
    return light.glint / FULL * total * np.clip(r / scene.ring_outer, 0.0, 1.0)


def _single(array: Array) -> Picture:
    return np.ascontiguousarray(array, dtype=np.float32)


COLUMNS_PER_PX = 1.4  # at the rim; nearer to the axis, there are more columns per px
ROWS_PER_PX = 1.4
GAP: Colour = (0.02, 0.02, 0.022)
TABLES: dict[str, Colour] = {
    "grey": (0.13, 0.13, 0.135),
    "white": (0.72, 0.72, 0.70),
    "wood": (0.30, 0.17, 0.08),
}


class _Canvas:
    """Polar grid with two layers: cover (opacity), and colour times cover. The lowest object is painted first."""

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
        """Paint a colour over the canvas with the weight ``cover``."""
        paint = np.asarray(colour, dtype=np.float64)
        self.colour *= 1.0 - cover[..., None]
        self.colour += cover[..., None] * paint
        self.cover = self.cover + cover - self.cover * cover

    def paper(self, marker: Marker) -> None:
        """Paint a marker."""
        along, across = marker.local(self.x, self.y)
        half = 0.5 * marker.base
        cover = soft_box(along, 0.0, marker.length, self.sigma) * soft_box(across, -half, half, self.sigma)
        self.over(cover, marker.colour)

    def picture(self, fourth: Array) -> PolarPicture:
        """Return the picture with a fourth channel."""
        return PolarPicture.of(np.dstack([self.colour, fourth]), self.per_mm)


def paint_rotor(scene: Scene, camera: Camera) -> PolarPicture:
    """Paint the rotor, opaque out to a radius under the casing ring.

    The channels are red, green, blue and the fraction of bare metal.
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
    """Return the cover of a disc about the axis."""
    return np.array(np.broadcast_to(soft_step(radius - canvas.r, canvas.sigma), canvas.x.shape))


def paint_table(scene: Scene, camera: Camera, light: Light, seed: int = 0) -> Array:
    """Paint the illuminated table with the shadow of the gyroscope, (height, width, 3), linear."""
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
    """Return the relative brightness of the table at points in mm: fine grain, or rings and planks of wood."""
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


Frame = NDArray[np.uint8]

SUB_STEP_PX = 1.2  # largest motion of the edges of the casing in a sub-exposure [px]
MAX_SUB = 24
FOLD = 256  # number of rows of an array of points, because cv2.remap is limited to 32767 columns
SOFT_SHADOW = 0.05  # blur of the shadow of the bar [rad]

BANKS = 4
MARGIN = 96  # margin of a stored noise picture [px], which gives 9216 different crops


class Noise:
    """Gaussian noise in grey levels, independent in every pixel and colour; rounding adds a variance of 1/12."""

    def __init__(self, height: int, width: int, deviation: float, rng: np.random.Generator) -> None:
        self._rng, self._size = rng, (height, width)
        shape = (height + MARGIN, width + MARGIN, 3)
        self._banks = []
        for _ in range(BANKS if deviation > 0.0 else 0):
            grain = np.rint(rng.standard_normal(shape, dtype=np.float32) * np.float32(deviation))
            self._banks.append(np.clip(grain, -127, 127).astype(np.int8))

    def on(self, picture: Frame) -> Frame:
        """Return the picture with independent noise."""
        if not self._banks:
            return picture
        bank = self._banks[int(self._rng.integers(BANKS))]
        top, left = (int(n) for n in self._rng.integers(MARGIN, size=2))
        grain = bank[top : top + self._size[0], left : left + self._size[1]]
        return cv2.add(picture, grain, dtype=cv2.CV_8U)  # type: ignore[return-value]


class Renderer:
    """Renders frames of a scene with given motion, camera and light; `seed` determines grain and noise."""

    def __init__(
        self, scene: Scene, motion: Motion, camera: Camera, light: Light | None = None, *, seed: int = 0
    ) -> None:
        self.scene, self.motion, self.camera, self.light = scene, motion, camera, light or Light()
        self._rotor, self._casing = paint_rotor(scene, camera), paint_casing(scene, camera)
        self._cover, self._shadow = self._casing.channel(3), self._casing.channel(3)
        self._rotor_part = self._rotor.copy()
        table = paint_table(scene, camera, self.light, seed)
        self._window = cut_window(scene, camera, self.light, table)
        self._table = self._levels(table.astype(np.float32))
        self._noise = Noise(camera.height, camera.width, camera.noise, np.random.default_rng(seed))
        self._buffers: dict[str, NDArray[np.generic]] = {}

    def frames(self, count: int) -> Iterator[Frame]:
        """Yield ``count`` frames, (height, width, 3) RGB, 8 bits; a ValueError is raised if the motion is unknown."""
        times = self.camera.times(count)
        reach = 0.5 * self.camera.exposure + abs(self.camera.readout)
        if count and (times[0] - reach < self.motion.start or times[-1] + reach > self.motion.stop):
            raise ValueError(
                f"The film runs from {times[0]:.4f} s to {times[-1]:.4f} s, "
                f"but the motion is known from {self.motion.start:.4f} s to {self.motion.stop:.4f} s only"
            )
        for time in times:
            yield self.frame(float(time))

    def frame(self, time: float) -> Frame:
        """Render the frame with the middle of its exposure at the true time ``time`` in s."""
        window = self._window
        pulse = self._pulse(time, np.arange(self.camera.height))
        picture = self._lit_table(pulse)
        planes = self._gyroscope(time)
        if isinstance(pulse, np.ndarray):
            planes = [plane * pulse[window.rows, None].astype(np.float32) for plane in planes]
        gain = 1.0 if isinstance(pulse, np.ndarray) else pulse
        merged = cv2.merge(planes, dst=self._buffer("merged", np.float32, 3))
        picture[window.rows, window.columns] = self._levels(np.asarray(merged, dtype=np.float32), gain)
        return self._noise.on(picture)

    def _gyroscope(self, time: float) -> list[Picture]:
        """Return the intensity of the window in constant illumination, three planes (h, w)."""
        w = self._window
        angle, radius = self._polar(time)
        smear_r, smear_c = self._smears(time)
        at_rotor, at_casing = self._columns(angle, time)
        rotor = cv2.split(self._rotor.sample(at_rotor, radius, smear_r, self._buffer("rotor", np.uint16, 4)))
        casing = cv2.split(
            self._casing.sample(at_casing, radius, smear_c, self._buffer("casing", np.uint16, 4))
        )
        cover = casing[3].astype(np.float32)
        clear = cover * np.float32(-1.0 / FULL)
        clear += np.float32(1.0)
        seen = [plane * clear for plane in rotor]
        self._average_edges(seen, clear, angle, radius, time)
        if self.light.shadow > 0.0:
            dark = self._bar_shadow(time, smear_c)
            for plane in seen:
                np.multiply(plane, dark, out=plane)
        if self.light.glint > 0.0:
            cover *= np.float32(0.7)
            cover += seen[3]
            cover *= w.glint
        out = []
        for k in range(3):
            plane = np.multiply(w.table[k], clear)
            plane += np.multiply(seen[k], w.lamps_inside, out=seen[k])
            plane += casing[k] * w.lamps
            if self.light.glint > 0.0:
                plane += cover
            out.append(plane)
        return out

    def _polar(
        self, time: float, offset: tuple[float, float] = (0.0, 0.0), step: int = 1
    ) -> tuple[Picture, Picture]:
        """Return angle (in columns, in the sense of rotation) and radius (in rows) of every step-th pixel."""
        shift = self.scene.wobble.shift(np.asarray(time)) + offset
        u = self._window.u[::step, ::step] - np.float32(shift[0])
        v = self._window.v[::step, ::step] - np.float32(shift[1])
        if self.camera.sense < 0:
            np.negative(v, out=v)
        angle = np.arctan2(v, u)
        angle *= np.float32(self._rotor.per_rad)
        radius = np.multiply(u, u, out=u)
        radius += np.multiply(v, v, out=v)
        np.sqrt(radius, out=radius)
        radius *= np.float32(self._rotor.per_mm)
        return angle, radius

    def _columns(
        self, angle: Picture, time: float, rows: NDArray[np.intp] | None = None
    ) -> tuple[Picture, Picture]:
        """Return the columns of rotor and casing at each pixel at a time."""
        late: Array = np.asarray(time)
        if self.camera.readout:
            lines = np.arange(self._window.rows.start, self._window.rows.stop)
            late = time + self.camera.row_delay(lines)
            late = late[:, None] if rows is None else late[rows]
        rotor, casing = self.motion.psi_rotor(late), self.motion.psi_casing(late)
        return self._rotor.seen_columns(angle, rotor), self._casing.seen_columns(angle, casing)

    def _smears(self, time: float) -> tuple[float, float]:
        """Return the rotation of rotor and casing during the exposure."""
        ends = time + np.array([-0.5, 0.5]) * self.camera.exposure
        rotor, casing = self.motion.psi_rotor(ends), self.motion.psi_casing(ends)
        return float(rotor[1] - rotor[0]), float(casing[1] - casing[0])

    def _average_edges(
        self, seen: list[Picture], clear: Picture, angle: Picture, radius: Picture, time: float
    ) -> None:
        """Average (1 - cover) * rotor over sub-exposures where an edge of the casing crosses a marker of the rotor."""
        smear_r, smear_c = self._smears(time)
        rim = max((m.near + m.length for m in self.scene.on("rotor")), default=0.0) * self.camera.scale
        parts = min(int(np.ceil(abs(smear_c) * rim / SUB_STEP_PX)), MAX_SUB)
        if parts < 2:
            return
        zone = (clear > 0.004) & (clear < 0.996) & self._window.papers
        line, place = (np.resize(index, -(-index.size // FOLD) * FOLD) for index in np.nonzero(zone))
        if line.size == 0:
            return
        a, r = angle[line, place], radius[line, place].reshape(FOLD, -1)
        total = np.zeros((*r.shape, 4), dtype=np.float32)
        for late in (np.arange(parts) + 0.5) / parts - 0.5:
            columns = self._columns(a, time + float(late) * self.camera.exposure, line)
            at_rotor, at_casing = (c.reshape(r.shape) for c in columns)
            cover = self._cover.sample(at_casing, r, smear_c / parts)
            share = np.float32(1.0 / parts) - cover * np.float32(1.0 / (FULL * parts))
            total += self._rotor_part.sample(at_rotor, r, smear_r / parts) * share[..., None]
        for k in range(4):
            seen[k][line, place] = total[..., k].ravel()

    def _bar_shadow(self, time: float, smear: float) -> Picture:
        """Return the brightness in the shadow of the casing on the rotor, computed at half resolution."""
        angle, radius = self._polar(time, self.light.shadow_offset, step=2)
        columns = self._casing.seen_columns(angle, self.motion.psi_casing(time))
        cover = self._shadow.sample(columns, radius, abs(smear) + SOFT_SHADOW)
        dark = np.float32(1.0) - cover * np.float32(self.light.shadow / FULL)
        return cv2.resize(dark, self._window.shape[::-1], interpolation=cv2.INTER_LINEAR)  # type: ignore[return-value]

    def _pulse(self, time: float, rows: NDArray[np.int_]) -> float | Array:
        """Return the brightness of the lamps during the exposure, as one number or one for each row."""
        if not self.light.flicker:
            return 1.0
        late = self.camera.row_delay(rows) if self.camera.readout else 0.0
        pulse = self.light.pulse(time + late, self.camera.exposure)
        return pulse if self.camera.readout else float(pulse)

    def _lit_table(self, pulse: float | Array) -> Frame:
        """Return the table in the illumination of a frame."""
        gain = np.asarray(pulse) ** (1.0 / self.camera.gamma)
        if gain.ndim == 0:
            return self._table.copy() if gain == 1.0 else cv2.convertScaleAbs(self._table, alpha=float(gain))  # type: ignore[return-value]
        return np.clip(self._table * gain[:, None, None] + 0.5, 0.0, 255.0).astype(np.uint8)

    def _levels(self, light: Picture, gain: float = 1.0) -> Frame:
        """Return grey levels of linear intensity (which is overwritten): 255 * (gain * light) ** (1 / gamma)."""
        gamma = self.camera.gamma
        np.maximum(light, 0.0, out=light)
        if gamma == 2.0:
            np.sqrt(light, out=light)
        elif gamma != 1.0:
            np.power(light, np.float32(1.0 / gamma), out=light)
        return cv2.convertScaleAbs(light, alpha=255.0 * gain ** (1.0 / gamma))  # type: ignore[return-value]

    def _buffer(self, name: str, kind: type[np.generic] = np.float32, channels: int = 1) -> NDArray:  # type: ignore[type-arg]
        """Return reusable memory of the size of the window, because allocation is slow."""
        if name not in self._buffers:
            shape = self._window.shape if channels == 1 else (*self._window.shape, channels)
            self._buffers[name] = np.empty(shape, dtype=kind)
        return self._buffers[name]
