"""Errors and uncertainties of points, links and discs in drawn films, beside those of a filter that knows the picture.

    python benchmarks/tracking/drawn.py --seeds 1 -o benchmarks/tracking/drawn.md

Every picture is a function of the position, averaged over half of the period of a frame, symmetrically about its time.
The films are tracked as `spindown` does: bobs and discs with no option, points with `--point`, two links with
`--links`. The filter knows everything but one angle (two of links) and sees the same decoded pixels: those of a disc,
or those within three pixels of the points that are followed. The error is without a constant, without what a displaced
pivot does (bobs, points: a displacement in both directions; discs: three harmonics of the angle); z is error over
uncertainty. The pivot of bobs and points has a z of its own: its distance from the true one over its uncertainty, per
axis; a constant error of the place of a patch that does not turn is left out. The uncertainty of links contains a
followed point beside the joint, whose displacement is drawn from the distribution that `_point_motion.OFF_AXIS` states;
their errors are without a constant only.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import av
import numpy as np
from scipy.integrate import solve_ivp
from speed import commit

from gyrotrack._errors import GyrotrackError
from gyrotrack.apps._spindown import SpindownOptions, _film, links_recording
from gyrotrack.tracking._film import Film
from gyrotrack.tracking._point_motion import OFF_AXIS, TrackedPoint

EXPOSURE, PARTS = 0.5, 5  # of the period of a frame; times that are averaged
NOISE, CRF = 2.0, 16  # grey levels; of the encoder
STEP = 2e-3  # of an angle, for the derivative of the picture [rad]
FILTERED = 40  # frames that the filter sees
NEAR = 3.0  # the filter sees so many pixels beyond the edge of a point


class Waves:
    """A smooth texture, a sum of waves of about one wavelength [px], with the standard deviation `size`."""

    def __init__(
        self, rng: np.random.Generator, wavelength: float, mean: float, size: float, count: int = 10
    ):
        self.k = rng.normal(0.0, 2 * np.pi / wavelength / np.sqrt(2), (count, 2))
        self.phase = rng.uniform(0, 2 * np.pi, count)
        self.mean, self.size = mean, size * np.sqrt(2 / count)

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        total = sum(np.cos(k[0] * x + k[1] * y + p) for k, p in zip(self.k, self.phase, strict=True))
        return self.mean + self.size * np.asarray(total)


@dataclass
class Drawn:
    """A film: how it is drawn, how its angles go, and how it is tracked."""

    kind: str
    what: str
    size: tuple[int, int]  # height, width
    fps: float
    frames: int
    still: np.ndarray  # what does not move
    paint: Callable[[np.ndarray, np.ndarray], None]  # draws the bodies with these angles over a picture
    angle: Callable[
        [float], np.ndarray
    ]  # the angles at a time, (1,) or (2,), counter-clockwise as seen [rad]
    seen: Callable[[np.ndarray], np.ndarray]  # mask of the pixels that the filter sees
    options: SpindownOptions = field(default_factory=SpindownOptions)
    hub: tuple[float, float] | None = None  # true pivot of a point
    length: float = 0.0  # its distance from the pivot [px]
    starts: tuple[tuple[float, float], ...] = ()  # of links

    def place(self, angles: np.ndarray) -> np.ndarray:
        """Return the place of a point."""
        return np.asarray(self.hub) + self.length * direction(angles[0])

    def picture(self, t: float, ahead: np.ndarray | float = 0.0) -> np.ndarray:
        total = np.zeros(self.size)
        for part in range(PARTS):
            now = self.still.copy()
            self.paint(now, self.angle(t + ((part + 0.5) / PARTS - 0.5) * EXPOSURE / self.fps) + ahead)
            total += now
        return total / PARTS

    def write(self, path: Path, seed: int) -> None:
        rng = np.random.default_rng(seed)
        with av.open(str(path), "w") as container:
            stream = container.add_stream("libx264", rate=round(self.fps))
            stream.height, stream.width = self.size
            stream.pix_fmt, stream.options = "yuv420p", {"crf": str(CRF), "preset": "veryfast"}
            height, width = self.size
            grey = np.full((height // 2, width), 128, np.uint8)
            for k in range(self.frames):
                luma = self.picture(k / self.fps) + rng.normal(0, NOISE, self.size)
                planes = np.concatenate([np.clip(np.rint(luma), 0, 255).astype(np.uint8), grey])
                for packet in stream.encode(av.VideoFrame.from_ndarray(planes, format="yuv420p")):
                    container.mux(packet)
            for packet in stream.encode():
                container.mux(packet)

    def filtered(self, path: Path) -> tuple[np.ndarray, np.ndarray]:
        """Return the errors of the filter, (frames, angles), and its bound with white noise of `NOISE` [rad]."""
        wanted = set(np.linspace(0, self.frames - 1, FILTERED).astype(int).tolist())
        found, bound = [], []
        with av.open(str(path)) as container:
            for k, frame in enumerate(container.decode(video=0)):
                if k not in wanted:
                    continue
                t = k / self.fps
                luma = frame.to_ndarray(format="yuv420p")[: self.size[0]].astype(float)
                angles = self.angle(t)
                mask = self.seen(angles)
                left = (luma - self.picture(t))[mask]
                rows = np.stack(
                    [
                        (self.picture(t, STEP * e) - self.picture(t, -STEP * e))[mask] / (2 * STEP)
                        for e in np.eye(len(angles))
                    ],
                    axis=1,
                )
                rows = np.column_stack([rows, np.ones(len(left))])
                found.append(np.linalg.lstsq(rows, left, rcond=None)[0][: len(angles)])
                bound.append(NOISE * np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))[: len(angles)])
        return np.array(found), np.sqrt(np.mean(np.square(bound), axis=0))


def grid(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(float)
    return x, y


def direction(angle: float) -> np.ndarray:
    """Unit vector of an angle, counter-clockwise from the right as seen; y is downwards."""
    return np.array([np.cos(angle), -np.sin(angle)])


def disc_at(
    picture: np.ndarray,
    place: np.ndarray,
    radius: float,
    turn: float,
    shade: Callable[[np.ndarray, np.ndarray], np.ndarray],
    stretch: np.ndarray | None = None,
) -> None:
    """Draw a disc with the shades of its own coordinates, its edge one pixel wide; `stretch` tilts it."""
    reach = radius + 2.0
    height, width = picture.shape
    top, bottom = max(int(place[1] - reach), 0), min(int(place[1] + reach) + 2, height)
    left, right = max(int(place[0] - reach), 0), min(int(place[0] + reach) + 2, width)
    if bottom <= top or right <= left:
        return
    y, x = np.mgrid[top:bottom, left:right].astype(float)
    flat = np.stack([x - place[0], place[1] - y])  # y upwards
    back = np.eye(2) if stretch is None else np.linalg.inv(stretch)
    flat = np.einsum("ij,jyx->iyx", back, flat)
    far = np.hypot(*flat)
    slope = np.hypot(*np.einsum("ji,jyx->iyx", back, flat / np.maximum(far, 1e-9)))
    cover = np.clip((radius - far) / slope + 0.5, 0.0, 1.0)
    c, s = np.cos(turn), np.sin(turn)
    own = c * flat[0] + s * flat[1], c * flat[1] - s * flat[0]
    near = picture[top:bottom, left:right]
    near += cover * (shade(*own) - near)


def rod(picture: np.ndarray, one: np.ndarray, two: np.ndarray, half: float, level: float) -> None:
    """Draw a straight rod between two places."""
    height, width = picture.shape
    low, high = np.minimum(one, two) - half - 2, np.maximum(one, two) + half + 3
    x0, y0 = np.clip(low.astype(int), 0, (width, height))
    x1, y1 = np.clip(high.astype(int), 0, (width, height))
    if x1 <= x0 or y1 <= y0:
        return
    y, x = np.mgrid[y0:y1, x0:x1].astype(float)
    along = (two - one) / np.hypot(*(two - one))
    u = (x - one[0]) * along[0] + (y - one[1]) * along[1]
    v = (y - one[1]) * along[0] - (x - one[0]) * along[1]
    cover = np.clip(half - np.abs(v) + 0.5, 0, 1) * (u > 0) * (u < np.hypot(*(two - one)))
    near = picture[y0:y1, x0:x1]
    near += cover * (level - near)


def constant(level: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    return lambda u, v: np.full(u.shape, level)


def background(rng: np.random.Generator, size: tuple[int, int], mean: float = 130.0) -> np.ndarray:
    return Waves(rng, rng.uniform(25, 50), mean, 12.0)(*grid(size))


def swing(rng: np.random.Generator, amplitude: float, period: float) -> Callable[[float], np.ndarray]:
    phase, decay = rng.uniform(0, 2 * np.pi), 0.03
    return lambda t: np.array(
        [-np.pi / 2 + amplitude * np.exp(-decay * t) * np.cos(2 * np.pi * t / period + phase)]
    )


def spin(start: float, speed: float, change: float) -> Callable[[float], np.ndarray]:
    return lambda t: np.array([start + speed * t + 0.5 * change * t**2])


def around(
    size: tuple[int, int], places: Callable[[np.ndarray], list[tuple[np.ndarray, float]]]
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the mask of the pixels near points, as a function of the angles."""
    x, y = grid(size)

    def mask(angles: np.ndarray) -> np.ndarray:
        return np.any([np.hypot(x - p[0], y - p[1]) < r + NEAR for p, r in places(angles)], axis=0)

    return mask


def bob(
    rng: np.random.Generator, look: str, *, light: bool, inside: bool, thread: bool, radius: float
) -> Drawn:
    size = (240, 360)
    length = rng.uniform(90, 120) if inside else rng.uniform(250, 420)
    low = rng.uniform(185, 205)
    hub = np.array([180 + rng.uniform(-20, 20), low - length])
    amplitude = rng.uniform(0.4, 0.8) if inside else rng.uniform(70, 110) / length
    angle = swing(rng, amplitude, rng.uniform(0.9, 1.6))
    level = 215.0 if light else 50.0
    shades = {
        "plain": constant(level),
        "textured": Waves(rng, radius, level, 22.0),
        "shaded": lambda u, v: np.clip(level + 40 * (u + v) / (1.5 * radius), 5, 250),
    }
    shade = shades[look]

    def place(a: np.ndarray) -> np.ndarray:
        return hub + length * direction(a[0])

    def paint(picture: np.ndarray, a: np.ndarray) -> None:
        if thread:
            rod(picture, hub, place(a), 0.6, 70.0)
        # the light that shades a bob does not turn with it
        disc_at(picture, place(a), radius, 0.0 if look == "shaded" else a[0], shade)

    what = (
        f"{look}, {'light' if light else 'dark'}, r {radius:g} px, pivot {'inside' if inside else 'outside'}"
    )
    return Drawn(
        "bob",
        what + (", thread" if thread else ""),
        size,
        60.0,
        200,
        background(rng, size, 120.0 if light else 150.0),
        paint,
        angle,
        around(size, lambda a: [(place(a), radius)]),
        hub=(float(hub[0]), float(hub[1])),
        length=length,
    )


def point(rng: np.random.Generator, look: str) -> Drawn:
    """A point of a body that turns: a dot of a disc, a target with four quadrants at the end of an arm, a lamp."""
    size = (280, 320)
    hub = np.array([160.0, 140.0]) + rng.uniform(-8, 8, 2)
    swings = look == "target"
    length = {"dot": 70.0, "target": 95.0, "lamp": 100.0, "square": 80.0}[look] + rng.uniform(-5, 5)
    radius = {"dot": 8.0, "target": 14.0, "lamp": 3.5, "square": 9.0}[look]
    angle = swing(rng, 0.6, 1.2) if swings else spin(rng.uniform(0, 6), rng.uniform(4, 8), rng.uniform(-1, 1))
    body = Waves(rng, 40.0, 150.0, 8.0)
    shade = {
        "dot": constant(40.0),
        "target": lambda u, v: 130 - 100 * np.tanh(1.2 * u) * np.tanh(1.2 * v),
        "lamp": lambda u, v: 240.0 * np.exp(-(u**2 + v**2) / 30.0),
        "square": lambda u, v: np.where(
            np.ones_like(u, bool), 60.0 + 150.0 / (1 + np.exp(-2 * (np.maximum(abs(u), abs(v)) - 5.5))), 0
        ),
    }[look]

    def place(a: np.ndarray) -> np.ndarray:
        return hub + length * direction(a[0])

    def paint(picture: np.ndarray, a: np.ndarray) -> None:
        if look in ("dot", "square"):
            disc_at(picture, hub, length + 25.0, a[0], body)
        else:
            rod(picture, hub, place(a), 3.0, 60.0)
        disc_at(picture, place(a), radius, a[0], shade)

    first = place(angle(0.0)) + rng.normal(0, 1.0, 2)  # a click
    return Drawn(
        "point",
        {
            "dot": "dot of a disc",
            "target": "target of a pendulum",
            "lamp": "lamp of an arm",
            "square": "square of a disc",
        }[look],
        size,
        60.0,
        180,
        background(rng, size, 90.0),
        paint,
        angle,
        around(size, lambda a: [(place(a), radius)]),
        SpindownOptions(point=(float(first[0]), float(first[1]))),
        (float(hub[0]), float(hub[1])),
        length,
    )


def links(rng: np.random.Generator, beside: str) -> Drawn:
    """A double pendulum; the followed point of the joint is displaced on the first or on the second link."""
    size, fps, frames = (360, 380), 120.0, 240
    hub = np.array([190.0, 110.0]) + rng.uniform(-5, 5, 2)
    one, two = rng.uniform(70, 95), rng.uniform(65, 90)
    radii = rng.uniform(6, 10, 2)
    off = rng.normal(0, OFF_AXIS, 2)

    def rates(_: float, y: np.ndarray) -> list[float]:
        a, b, p, q = y
        d, m, g = a - b, 0.8, 2300.0
        den = 2 + m - m * np.cos(2 * d)
        pa = -g * (2 + m) * np.sin(a) - m * g * np.sin(a - 2 * b)
        pa -= 2 * np.sin(d) * m * (q * q * two + p * p * one * np.cos(d))
        qb = 2 * np.sin(d) * (p * p * one * (1 + m) + g * (1 + m) * np.cos(a) + q * q * two * m * np.cos(d))
        return [p, q, pa / (one * den), qb / (two * den)]

    start = [*(rng.uniform(0.5, 0.9, 2) * rng.choice([-1, 1], 2)), 0.0, 0.0]
    motion = solve_ivp(rates, (-0.1, frames / fps + 0.1), start, dense_output=True, rtol=1e-9, atol=1e-9).sol

    def angle(t: float) -> np.ndarray:
        return motion(t)[:2] - np.pi / 2

    def places(a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        joint = hub + one * direction(a[0])
        along = direction(a[0] if beside == "first" else a[1])
        marked = joint + off[0] * along + off[1] * np.array([-along[1], along[0]])
        return joint, marked, joint + two * direction(a[1])

    def paint(picture: np.ndarray, a: np.ndarray) -> None:
        joint, marked, end = places(a)
        rod(picture, hub, joint, 2.0, 90.0)
        rod(picture, joint, end, 2.0, 90.0)
        disc_at(picture, marked, radii[0], 0.0, constant(30.0))
        disc_at(picture, end, radii[1], 0.0, constant(35.0))

    _, marked, end = places(angle(0.0))
    return Drawn(
        "links",
        f"mark {np.hypot(*off):.1f} px beside the joint on the {beside} link",
        size,
        fps,
        frames,
        background(rng, size, 150.0),
        paint,
        angle,
        around(size, lambda a: [(places(a)[1], radii[0]), (places(a)[2], radii[1])]),
        starts=tuple((float(p[0]), float(p[1])) for p in (marked, end)),
    )


def disc(rng: np.random.Generator, tilt: float, look: str) -> Drawn:
    """A disc whose axis is tilted against the line of sight [degrees], without perspective."""
    size, radius = (280, 320), rng.uniform(95, 115)
    hub = np.array([160.0, 140.0]) + rng.uniform(-10, 10, 2)
    short = rng.uniform(0, np.pi)
    axis = np.array([np.cos(short), np.sin(short)])
    stretch = np.eye(2) + (np.cos(np.radians(tilt)) - 1) * np.outer(axis, axis)
    angle = spin(rng.uniform(0, 6), rng.choice([-1, 1]) * rng.uniform(4, 9), rng.uniform(-1, 1))
    texture = Waves(rng, radius / 3, 150.0, 25.0)
    marks = [(0.6 * radius * np.cos(k * 1.3), 0.6 * radius * np.sin(k * 1.3)) for k in range(4)]

    def shade(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        if look == "textured":
            return texture(u, v)
        level = np.full(u.shape, 190.0)
        for x, y in marks:
            level -= 140 * np.clip(0.1 * radius - np.hypot(u - x, v - y) + 0.5, 0, 1)
        return level

    x, y = grid(size)
    flat = np.einsum("ij,jyx->iyx", np.linalg.inv(stretch), np.stack([x - hub[0], hub[1] - y]))
    inside = np.hypot(*flat) < radius - 1.0
    return Drawn(
        "disc",
        f"tilt {tilt:.0f} degrees, {look}",
        size,
        60.0,
        180,
        background(rng, size, 110.0),
        lambda picture, a: disc_at(picture, hub, radius, a[0], shade, stretch),
        angle,
        lambda a: inside,
    )


def films(seed: int) -> list[Drawn]:
    rng = np.random.default_rng([41, seed])
    bobs = [
        bob(rng, "plain", light=False, inside=False, thread=True, radius=12.0),
        bob(rng, "textured", light=False, inside=False, thread=True, radius=14.0),
        bob(rng, "shaded", light=True, inside=False, thread=False, radius=13.0),
        bob(rng, "plain", light=True, inside=False, thread=True, radius=6.0),
        bob(rng, "plain", light=False, inside=True, thread=True, radius=11.0),
        bob(rng, "textured", light=True, inside=True, thread=True, radius=15.0),
        bob(rng, "shaded", light=False, inside=True, thread=False, radius=14.0),
        bob(rng, "textured", light=True, inside=False, thread=False, radius=8.0),
    ]
    points = [point(rng, look) for look in ("dot", "target", "lamp", "square")]
    pairs = [links(rng, beside) for beside in ("first", "second", "first", "second", "first")]
    looks = ("textured", "marks")
    discs = [disc(rng, t, looks[k % 2]) for k, t in enumerate((0, 10, 20, 30, 40, 50, 55, 60))]
    return bobs + points + pairs + discs


@dataclass(frozen=True)
class Result:
    film: Drawn
    name: str  # of the angle
    error: np.ndarray  # (m,) [rad]
    sigma: np.ndarray  # (m,) [rad]
    best: float  # rms error of the filter [rad]
    bound: float  # with white noise
    hub_z: float  # of the pivot
    whole: float  # rms error with all that repeats [rad]
    seconds: float


def without(error: np.ndarray, columns: list[np.ndarray], sigma: np.ndarray) -> np.ndarray:
    rows = np.stack([np.ones(len(error)), *columns], axis=1)
    found = np.linalg.lstsq(rows / sigma[:, None], error / sigma, rcond=None)[0]
    return np.asarray(error - rows @ found)


def measure(film: Drawn, path: Path) -> list[Result]:
    """Track a film and compare; an error is raised as the program raises it."""
    start = time.process_time()
    hub_z = np.nan
    if film.kind == "links":
        recording = links_recording(Film(path), film.starts, film.options)
        tracked = None
    else:
        recording, found = _film(path, film.options, None)
        tracked = None if found is None else found[1]
    seconds = time.process_time() - start
    best, bound = film.filtered(path)
    results = []
    for k, (name, body) in enumerate(recording.bodies.items()):
        frame = np.rint(body.time * film.fps).astype(int)
        true = np.array([film.angle(f / film.fps)[k] for f in frame])
        sense = 1.0 if film.kind == "links" else float(recording.sense)
        error = sense * body.angle - true
        error -= 2 * np.pi * np.rint(np.median(error) / (2 * np.pi))
        if film.kind != "links" and np.std(error) > np.std(sense * body.angle + true):
            raise GyrotrackError("The sense of rotation is wrong.", "")
        sigma = np.hypot(body.sigma, body.correlated_sigma)
        whole = float(np.std(error))
        if film.kind in ("bob", "point"):
            rest = without(error, [np.cos(true), np.sin(true)], sigma)
        elif film.kind == "disc":
            rest = without(error, [f(n * true) for n in (1, 2, 3) for f in (np.cos, np.sin)], sigma)
        else:
            rest = without(error, [], sigma)
        if isinstance(tracked, TrackedPoint) and film.hub is not None:
            # the place of a patch that does not turn has a constant error, which moves path and pivot alike
            beside = np.zeros(2)
            if not tracked.path.turns:
                true_place = np.array([film.place(film.angle(f / film.fps)) for f in tracked.frame])
                beside = np.mean(tracked.place - true_place, axis=0)
            away = tracked.hub - beside - np.array(film.hub)
            hub_z = float(np.sqrt(away @ np.linalg.solve(tracked.hub_covariance, away) / 2))
        filtered = float(np.sqrt(np.mean(best[:, k] ** 2)))
        results.append(Result(film, name, rest, sigma, filtered, float(bound[k]), hub_z, whole, seconds))
    return results


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def line(r: Result) -> str:
    z = rms(r.error / r.sigma)
    e, s, w, b, c = (1e3 * v for v in (rms(r.error), float(np.median(r.sigma)), r.whole, r.best, r.bound))
    hub = "" if np.isnan(r.hub_z) else f"{r.hub_z:.2f}"
    name = {"casing": "first", "rotor": "second"}[r.name] if r.film.kind == "links" else ""
    return (
        f"| {r.film.kind} | {r.film.what} | {name} | {len(r.error)} | {w:.3f} | {e:.3f} | {b:.3f} | {c:.3f} | "
        f"{rms(r.error) / r.best:.2f} | {s:.3f} | {z:.2f} | {hub} | {r.seconds:.1f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--kinds", nargs="+", default=["bob", "point", "links", "disc"])
    parser.add_argument("--films", type=Path, help="folder that keeps the films")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    kept = options.films or Path(tempfile.mkdtemp())
    kept.mkdir(parents=True, exist_ok=True)
    results, lines = [], []
    for seed in options.seeds:
        for k, film in enumerate(films(seed)):
            if film.kind not in options.kinds:
                continue
            path = kept / f"{film.kind}_{seed}_{k}.mp4"
            if not path.exists():
                film.write(path, 1000 * seed + k)
            try:
                found = measure(film, path)
            except GyrotrackError as error:
                lines.append(
                    f"| {film.kind} | {film.what} | refused: {str(error)[:100]} | | | | | | | | | | |"
                )
            else:
                results += found
                lines += [line(r) for r in found]
            print(path.name, *lines[-2 if film.kind == "links" else -1 :], flush=True)
    head = (
        "| kind | film | link | frames | error with pivot, rms | error, rms | filter | bound | error / filter | "
        "sigma | z | z of pivot | CPU s |\n" + "|---" * 13 + "|\n"
    )
    pooled = []
    for kind in [*options.kinds, "all"]:
        of = [r for r in results if kind in (r.film.kind, "all")]
        if of:
            z = rms(np.concatenate([r.error / r.sigma for r in of]))
            ratio = np.array([rms(r.error) / r.best for r in of])
            hubs = np.array([r.hub_z for r in of if not np.isnan(r.hub_z)])
            pooled.append(
                f"| {kind} | {len(of)} | {1e3 * rms(np.concatenate([r.error for r in of])):.3f} | "
                f"{np.median(ratio):.2f} | "
                f"{ratio.max():.2f} | {z:.2f} | {'' if len(hubs) == 0 else f'{rms(hubs):.2f}'} |"
            )
    text = (
        f"# Points, links and discs in drawn films\n\nCommit {commit()}; `drawn.py --seeds "
        f"{' '.join(map(str, options.seeds))}`. Errors in mrad.\n\n"
        "| kind | angles | error, rms | error / filter, median | highest | z | z of pivot |\n"
        + "|---" * 7
        + "|\n"
        + "\n".join(pooled)
        + "\n\n"
        + head
        + "\n".join(lines)
        + "\n"
    )
    print(text) if options.output is None else options.output.write_text(text)


if __name__ == "__main__":
    main()
