"""Films of a bob about a pivot with exact truth: a patterned disc, a thread, a textured background, blur and noise.

Everything is an analytic function of the position, sampled at the centres of the pixels: the edge of the disc is a ramp
of one pixel. It shares no code with the package.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np


@dataclass(frozen=True)
class Bob:
    """What is drawn; lengths in px, angles in rad from the downward vertical, towards +x."""

    size: tuple[int, int] = (120, 160)
    hub: tuple[float, float] = (80.0, -120.0)
    length: float = 190.0
    radius: float = 8.0
    amplitude: float = 0.25
    period: float = 1.1
    decay: float = 0.03
    speed: float = 0.0  # of a rotation in place of the oscillation [rad/s]
    fps: float = 50.0
    frames: int = 80
    noise: float = 2.0
    texture: float = 15.0
    exposure: float = 0.4  # over the period of a frame
    thread: bool = True
    colour: bool = False
    bar: tuple[float, float] | None = None  # columns that an obstacle covers
    seed: int = 0

    @property
    def time(self):
        return np.arange(self.frames) / self.fps

    def angle(self, t):
        if self.speed:
            return self.speed * t
        return self.amplitude * np.exp(-self.decay * t) * np.cos(2 * np.pi * t / self.period + 0.3)

    @property
    def place(self):
        """Positions (n, 2) of the centre of the bob [px]."""
        a = self.angle(self.time)
        return np.array(self.hub) + self.length * np.stack([np.sin(a), np.cos(a)], axis=1)

    def _background(self, x, y):
        rng = np.random.default_rng(self.seed)
        waves = rng.normal(0, 0.25, (24, 2)), rng.uniform(0, 2 * np.pi, 24)
        total = sum(np.cos(k[0] * x + k[1] * y + p) for k, p in zip(*waves, strict=True))
        return 120.0 + self.texture * total / np.sqrt(12.0)

    def _pattern(self, u, v):
        rng = np.random.default_rng(self.seed + 1)
        waves = rng.normal(0, 2.5 / self.radius, (6, 2)), rng.uniform(0, 2 * np.pi, 6)
        total = sum(np.cos(k[0] * u + k[1] * v + p) for k, p in zip(*waves, strict=True))
        return 50.0 + 18.0 * total / np.sqrt(3.0)

    def pictures(self):
        """Return the luma of the frames."""
        height, width = self.size
        y, x = np.mgrid[0:height, 0:width].astype(float)
        still = self._background(x, y)
        rng = np.random.default_rng(self.seed + 2)
        found = []
        for t in self.time:
            total = 0.0
            for s in np.linspace(-0.5, 0.5, 5) * self.exposure / self.fps:
                a = float(self.angle(t + s))
                px, py = self.hub[0] + self.length * np.sin(a), self.hub[1] + self.length * np.cos(a)
                picture = still.copy()
                if self.thread:
                    u = np.cos(a) * (x - px) - np.sin(a) * (y - py)
                    v = np.sin(a) * (x - px) + np.cos(a) * (y - py)
                    cover = np.clip(1.0 - np.abs(u), 0.0, 1.0) * (v < 0)
                    picture += cover * (70.0 - picture)
                reach = self.radius + 2.0
                near = tuple(slice(max(int(c - reach), 0), max(int(c + reach) + 1, 0)) for c in (py, px))
                dx, dy = x[near] - px, y[near] - py
                u, v = np.cos(a) * dx - np.sin(a) * dy, np.sin(a) * dx + np.cos(a) * dy
                cover = np.clip(self.radius - np.hypot(u, v) + 0.5, 0.0, 1.0)
                picture[near] += cover * (self._pattern(u, v) - picture[near])
                total = total + picture
            picture = total / 5.0
            if self.bar is not None:
                picture = np.where((x >= self.bar[0]) & (x < self.bar[1]), 200.0, picture)
            found.append(
                np.clip(picture + rng.normal(0, self.noise, picture.shape), 0, 255).round().astype(np.uint8)
            )
        return found

    def write(self, path: Path, crf: int = 14) -> Path:
        """Encode the film; the bob is blue with `colour`."""
        with av.open(str(path), "w") as container:
            stream = container.add_stream("libx264", rate=Fraction(self.fps).limit_denominator(1000))
            stream.height, stream.width = self.size
            stream.pix_fmt, stream.options = "yuv420p", {"crf": str(crf), "preset": "veryfast"}
            height, width = self.size
            y, x = np.mgrid[0 : height // 2, 0 : width // 2] * 2 + 0.5
            for k, (luma, place) in enumerate(zip(self.pictures(), self.place, strict=True)):
                cover = (
                    np.clip((self.radius - np.hypot(x - place[0], y - place[1])) / 2 + 0.5, 0, 1)
                    * self.colour
                )
                u, v = (np.round(128 + c * cover).astype(np.uint8) for c in (60, -25))
                planes = np.concatenate([luma.ravel(), u.ravel(), v.ravel()]).reshape(height * 3 // 2, width)
                frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
                frame.pts, frame.time_base = k, 1 / Fraction(self.fps).limit_denominator(1000)
                for packet in stream.encode(frame):
                    container.mux(packet)
            for packet in stream.encode():
                container.mux(packet)
        return path
