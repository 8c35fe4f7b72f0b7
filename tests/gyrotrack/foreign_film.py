"""A second, independent renderer of the paper's scene, so that tracking is not tuned to one oracle.

It paints polygons with OpenCV at twice the size, averages sub-exposures, adds light and noise in sRGB, and
encodes with libx264 from RGB. It shares no code with the package.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

Angle = Callable[[np.ndarray], np.ndarray]
Edit = Callable[[int, np.ndarray], np.ndarray | None]


@dataclass(frozen=True)
class Film:
    """Everything that is drawn; lengths in px, colours in RGB."""

    width: int = 640
    height: int = 360
    fps: float = 260.0
    container_fps: float | None = None
    frames: int = 200
    exposure: float = 0.8e-3
    casing: Angle = lambda t: 30.0 * t
    rotor: Angle = lambda t: 200.0 * t
    sense: int = -1
    radius: float = 130.0  # outer radius of the casing ring
    centre: tuple[float, float] | None = None
    tilt: float = 0.05
    tilt_azimuth: float = 0.7
    lift: float = 0.0  # how high the disc lies above the papers, in radii
    depth: float = 0.0  # how far the rotor lies below the casing, in radii
    wobble: float = 0.6
    wobble_hz: float = 3.0
    red: tuple[int, int, int] = (190, 35, 40)
    disc: tuple[int, int, int] | None = (190, 35, 40)
    blue: tuple[int, int, int] = (35, 70, 175)
    white: tuple[int, int, int] | None = (235, 235, 230)
    green: tuple[int, int, int] = (30, 135, 60)
    size: float = 1.0  # of the papers
    bar: float = 0.22  # width in radii
    table: str = "grey"
    metal: int = 120
    bar_metal: tuple[int, int, int] = (160, 160, 158)
    noise: float = 3.0
    flicker: float = 0.0
    gradient: float = 0.15
    glint: float = 0.0
    crf: int = 20
    gop: int = 250
    seed: int = 1
    tag: float | None = None
    pixel_format: str = "yuv420p"
    codec: str = "libx264"
    mounts: tuple[float, float, float] = (0.3, 2.2, 4.5)
    rotor_papers: bool = True
    casing_paper: bool = True

    @property
    def time(self) -> np.ndarray:
        return np.arange(self.frames) / self.fps


_CIRCLE = np.stack([f(np.linspace(0, 2 * np.pi, 96, endpoint=False)) for f in (np.cos, np.sin)], axis=-1)
_TABLES = {"grey": (150, 150, 150), "white": (225, 225, 222), "wood": (170, 125, 80), "dark": (40, 42, 45)}


def render(film: Film, path: Path, edit: Edit | None = None) -> Path:
    """Write the film; the true angles are `film.casing(film.time)` and `film.rotor(film.time)`.

    `edit(k, picture)` may change frame k before the noise is added; a frame for which it gives None is left out.
    """
    cv2.setNumThreads(1)
    rng = np.random.default_rng(film.seed)
    table = _table(film, rng)
    light = (1.0 + film.gradient * np.linspace(-1, 1, film.width)[None, :, None]).astype(np.float32)
    options = {"movflags": "use_metadata_tags"} if film.tag is not None else {}
    with av.open(str(path), "w", options=options) as container:
        rate = Fraction(film.container_fps or film.fps).limit_denominator(1000)
        stream = container.add_stream(film.codec, rate=rate)
        stream.width, stream.height, stream.pix_fmt = film.width, film.height, film.pixel_format
        if film.codec == "libx264":
            # with mbtree the same pictures give another film in each run
            stream.options = {
                "crf": str(film.crf),
                "preset": "veryfast",
                "g": str(film.gop),
                "x264-params": "mbtree=0",
            }
        if film.tag is not None:
            container.metadata["com.android.capture.fps"] = str(film.tag)
        for k, t in enumerate(film.time):
            picture = _exposed(film, table, float(t))
            if edit is not None:
                picture = edit(k, picture)
                if picture is None:
                    continue
            picture = picture * light * (1.0 + film.flicker * np.sin(2 * np.pi * 100.0 * t + 0.3))
            picture = picture + film.noise * rng.standard_normal(picture.shape, dtype=np.float32)
            frame = av.VideoFrame.from_ndarray(np.clip(picture, 0, 255).astype(np.uint8), format="rgb24")
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def _table(film: Film, rng: np.random.Generator) -> np.ndarray:
    base = np.ones((2 * film.height, 2 * film.width, 3)) * np.array(_TABLES[film.table], dtype=float)
    if film.table == "wood":
        grain = cv2.GaussianBlur(rng.normal(0, 60, base.shape[:2]), (0, 0), sigmaX=60, sigmaY=2)
        base *= (1.0 + 0.3 * np.tanh(grain / 4.0))[..., None]
    return np.clip(base, 0, 255).astype(np.uint8)


def _exposed(film: Film, table: np.ndarray, t: float) -> np.ndarray:
    swept = abs(float(film.rotor(np.array(t + 1e-5)) - film.rotor(np.array(t - 1e-5)))) / 2e-5 * film.exposure
    parts = int(np.clip(np.ceil(swept / 0.04), 1, 24))
    total = np.zeros((film.height, film.width, 3), dtype=np.float32)
    for shift in ((np.arange(parts) + 0.5) / parts - 0.5) * film.exposure:
        big = _paint(film, table.copy(), t + float(shift))
        total += cv2.resize(big, (film.width, film.height), interpolation=cv2.INTER_AREA)
    return total / parts


def _paint(film: Film, image: np.ndarray, t: float) -> np.ndarray:
    psi_c, psi_r = (film.sense * float(f(np.array(t))) for f in (film.casing, film.rotor))
    unit = film.radius
    turn = 2 * np.pi * film.wobble_hz * t
    x0, y0 = film.centre or (film.width / 2 - 0.5, film.height / 2 - 0.5)
    shift = film.wobble * np.array([np.cos(turn), np.sin(turn)])

    def place(points: np.ndarray, height: float = 0.0) -> np.ndarray:
        c, s = np.cos(film.tilt_azimuth), np.sin(film.tilt_azimuth)
        a, b = c * points[:, 0] + s * points[:, 1], c * points[:, 1] - s * points[:, 0]
        a = a * np.cos(film.tilt) + height * np.sin(film.tilt)
        x, y = c * a - s * b, s * a + c * b
        return np.stack([x0 + shift[0] + unit * x, y0 + shift[1] - unit * y], axis=-1)

    def fill(points: np.ndarray, colour: tuple[int, int, int], height: float = 0.0) -> None:
        big = 2.0 * place(points, height) + 0.5  # px centres of the doubled picture
        cv2.fillPoly(image, [np.rint(big * 16).astype(np.int32)], colour, cv2.LINE_AA, 4)

    def disc(radius: float) -> np.ndarray:
        return radius * _CIRCLE

    def paper(psi: float, near: float, length: float, base: float) -> np.ndarray:
        u = near + np.array([0, 0, length, length])
        v = np.array([-0.5, 0.5, 0.5, -0.5]) * base
        return np.stack([np.cos(psi) * u - np.sin(psi) * v, np.sin(psi) * u + np.cos(psi) * v], axis=-1)

    m = film.metal
    fill(disc(1.0), film.bar_metal)
    fill(disc(0.88), (25, 25, 25))
    fill(disc(0.84), (m, m, m))
    for k in range(5):  # holes of the rotor
        fill(
            disc(0.05) + 0.7 * np.array([[np.cos(psi_r + 1.256 * k), np.sin(psi_r + 1.256 * k)]]),
            (m - 40,) * 3,
            -film.depth,
        )
    if film.rotor_papers:
        for colour, mount in zip((film.blue, film.white, film.green), film.mounts, strict=True):
            if colour is not None:
                fill(
                    paper(psi_r + film.sense * mount, 0.42, 0.28 * film.size, 0.20 * film.size),
                    colour,
                    -film.depth,
                )
    half = 0.5 * film.bar
    c, s = np.cos(psi_c), np.sin(psi_c)
    if film.bar > 0:
        bar = np.array([[-0.95, -half], [0.95, -half], [0.95, half], [-0.95, half]])
        fill(bar @ np.array([[c, s], [-s, c]]), film.bar_metal)
    if film.casing_paper:
        fill(paper(psi_c, 0.6, 0.26 * film.size, 0.18 * film.size), film.red)
    if film.glint > 0:
        fill(disc(0.12) + np.array([[0.35, 0.45]]), (int(255 * film.glint),) * 3)
    fill(disc(0.17), film.bar_metal, film.lift)
    if film.disc is not None:
        fill(disc(0.12), film.disc, film.lift)
    return image
