"""Draws frames: where a body is opaque for part of an exposure, the product of both motions is averaged.

A pixel collects ``mean over the exposure of [casing + (1 - cover) * rotor]``. The mean of the casing and of
its cover are exact (see `polar`), so is that of the rotor. Their product is exact too wherever the cover does
not change during the exposure; in the narrow zone swept by the edges of the bar it is summed over
sub-exposures.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrotrack.synthetic.motion import Motion
from gyrotrack.synthetic.noise import Noise
from gyrotrack.synthetic.optics import Camera, Light
from gyrotrack.synthetic.paint import paint_casing, paint_rotor, paint_table
from gyrotrack.synthetic.polar import FULL, Picture
from gyrotrack.synthetic.scene import Scene
from gyrotrack.synthetic.window import cut_window

Array = NDArray[np.float64]
Frame = NDArray[np.uint8]

SUB_STEP_PX = 1.2  # the casing's edges move at most this far within a sub-exposure, and are smeared over it
MAX_SUB = 24
FOLD = 256  # lists of points are folded for cv2.remap, whose pictures end at 32767 columns
SOFT_SHADOW = 0.05  # rad by which the shadow of the bar is softened


class Renderer:
    """Draws frames of one scene in one motion with one camera.

    Parameters
    ----------
    scene, motion, camera, light
        What is drawn.
    seed : int
        Seed of grain and noise; the same seed draws the same frames.
    """

    def __init__(
        self, scene: Scene, motion: Motion, camera: Camera, light: Light | None = None, *, seed: int = 0
    ) -> None:
        self.scene, self.motion, self.camera, self.light = scene, motion, camera, light or Light()
        self._rotor, self._casing = paint_rotor(scene, camera), paint_casing(scene, camera)
        self._cover, self._shadow = self._casing.channel(3), self._casing.channel(3)
        self._rotor_part = self._rotor.again()
        table = paint_table(scene, camera, self.light, seed)
        self._window = cut_window(scene, camera, self.light, table)
        self._table = self._levels(table.astype(np.float32))
        self._noise = Noise(camera.height, camera.width, camera.noise, np.random.default_rng(seed))
        self._buffers: dict[str, NDArray[np.generic]] = {}

    def frames(self, count: int) -> Iterator[Frame]:
        """Yield ``count`` frames, (height, width, 3) red, green, blue, 8 bits, one at a time.

        Raises
        ------
        ValueError
            If the motion is not known over the whole film.
        """
        times = self.camera.times(count)
        reach = 0.5 * self.camera.exposure + abs(self.camera.readout)
        if count and (times[0] - reach < self.motion.start or times[-1] + reach > self.motion.stop):
            msg = (
                f"The film runs from {times[0]:.4f} s to {times[-1]:.4f} s, "
                f"but the motion is known from {self.motion.start:.4f} s to {self.motion.stop:.4f} s only"
            )
            raise ValueError(msg)
        for time in times:
            yield self.frame(float(time))

    def frame(self, time: float) -> Frame:
        """Draw the frame whose exposure has its middle at the true time ``time`` in s."""
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
        """Light of the window in steady lamps, three planes (h, w)."""
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
        self._mend_edges(seen, clear, angle, radius, time)
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
        """Angle (in columns, growing as the bodies turn) and radius (in rows) of every step-th pixel."""
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
        """Columns of rotor and casing that are seen at each pixel at a time."""
        late: Array = np.asarray(time)
        if self.camera.readout:
            lines = np.arange(self._window.rows.start, self._window.rows.stop)
            late = time + self.camera.row_delay(lines)
            late = late[:, None] if rows is None else late[rows]
        rotor, casing = self.motion.psi_rotor(late), self.motion.psi_casing(late)
        return self._rotor.seen_columns(angle, rotor), self._casing.seen_columns(angle, casing)

    def _smears(self, time: float) -> tuple[float, float]:
        """Angles by which rotor and casing turn during the exposure."""
        ends = time + np.array([-0.5, 0.5]) * self.camera.exposure
        rotor, casing = self.motion.psi_rotor(ends), self.motion.psi_casing(ends)
        return float(rotor[1] - rotor[0]), float(casing[1] - casing[0])

    def _mend_edges(
        self, seen: list[Picture], clear: Picture, angle: Picture, radius: Picture, time: float
    ) -> None:
        """Average (1 - cover) * rotor over sub-exposures where an edge of the casing passes over a paper."""
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
        """Return the brightness left by the shadow of the casing on the rotor, drawn at half the size."""
        angle, radius = self._polar(time, self.light.shadow_offset, step=2)
        columns = self._casing.seen_columns(angle, self.motion.psi_casing(time))
        cover = self._shadow.sample(columns, radius, abs(smear) + SOFT_SHADOW)
        dark = np.float32(1.0) - cover * np.float32(self.light.shadow / FULL)
        return cv2.resize(dark, self._window.shape[::-1], interpolation=cv2.INTER_LINEAR)  # type: ignore[return-value]

    def _pulse(self, time: float, rows: NDArray[np.int_]) -> float | Array:
        """Brightness of the lamps during the exposure: one number, or one for each row."""
        if not self.light.flicker:
            return 1.0
        late = self.camera.row_delay(rows) if self.camera.readout else 0.0
        pulse = self.light.pulse(time + late, self.camera.exposure)
        return pulse if self.camera.readout else float(pulse)

    def _lit_table(self, pulse: float | Array) -> Frame:
        """Return the table in the momentary light."""
        gain = np.asarray(pulse) ** (1.0 / self.camera.gamma)
        if gain.ndim == 0:
            return self._table.copy() if gain == 1.0 else cv2.convertScaleAbs(self._table, alpha=float(gain))  # type: ignore[return-value]
        return np.clip(self._table * gain[:, None, None] + 0.5, 0.0, 255.0).astype(np.uint8)

    def _levels(self, light: Picture, gain: float = 1.0) -> Frame:
        """Grey levels of linear light (which is overwritten): 255 * (gain * light) ** (1 / gamma)."""
        gamma = self.camera.gamma
        np.maximum(light, 0.0, out=light)
        if gamma == 2.0:
            np.sqrt(light, out=light)
        elif gamma != 1.0:
            np.power(light, np.float32(1.0 / gamma), out=light)
        return cv2.convertScaleAbs(light, alpha=255.0 * gain ** (1.0 / gamma))  # type: ignore[return-value]

    def _buffer(self, name: str, kind: type[np.generic] = np.float32, channels: int = 1) -> NDArray:  # type: ignore[type-arg]
        """Scratch memory of the size of the window: fresh pages cost more than the drawing."""
        if name not in self._buffers:
            shape = self._window.shape if channels == 1 else (*self._window.shape, channels)
            self._buffers[name] = np.empty(shape, dtype=kind)
        return self._buffers[name]
