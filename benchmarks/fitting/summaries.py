"""How far the summaries of `gyrotrack spindown` are from the truth, in their standard uncertainties.

    python benchmarks/fitting/summaries.py --count 50 -o benchmarks/fitting/summaries.md
    python benchmarks/fitting/summaries.py --films --count 20 -o benchmarks/fitting/summaries_film.md

Rotations are slowed by a random mixture of dry, viscous and quadratic friction, to 15 to 85 % of the initial speed;
oscillations are damped and linear, or those of a pendulum. SciPy integrates them. Each recording is written as a table
and read as the command reads it. With --films a textured disc before a textured background is drawn instead, with
motion blur, noise, H.264 compression and a tilt of the camera up to 0.1 rad, and measured through the command line.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).parents[1] / "discovery"))
from answer import commit
from tabular import table

from gyrotrack.apps._motion import BodyMotion, motion_of, motion_of_speeds
from gyrotrack.apps._spindown import SpindownOptions, read_source

Floats = np.ndarray[Any, np.dtype[np.float64]]
Path_ = Callable[[Floats], Floats]


def rotation(rng: np.random.Generator, speed: float = 0.0, length: float = 0.0) -> tuple[Path_, float]:
    """Return angle and speed against time, and the length of the run; speed and length by lot if they are zero."""
    if not speed:
        speed, length = float(np.exp(rng.uniform(*np.log([5.0, 150.0])))), float(rng.uniform(8, 60))
    end, share = rng.uniform(0.15, 0.85), rng.dirichlet([1, 1, 1])

    def run(strength: float) -> Any:
        def law(_: float, y: Floats) -> list[float]:
            x = y[1] / speed
            slows = strength * speed / length * (share[0] + share[1] * x + share[2] * x**2)
            return [y[1], -slows if x > 0 else 0.0]

        return solve_ivp(law, (0, length), [0.3, speed], rtol=1e-10, atol=1e-10, dense_output=True)

    low, high = 0.01, 30.0
    for _ in range(40):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if run(middle).y[1, -1] > end * speed else (low, middle)
    return run(middle).sol, length


def slow_noise(t: Floats, sigma: float, time: float, rng: np.random.Generator) -> Floats:
    """Return an Ornstein-Uhlenbeck process."""
    keep = np.exp(-np.diff(t) / time)
    found = np.append(rng.normal() * sigma, np.zeros(len(keep)))
    for i, k in enumerate(keep):
        found[i + 1] = found[i] * k + rng.normal() * sigma * np.sqrt(1 - k * k)
    return found


def summary(file: Path, columns: list[Floats], head: str, **options: Any) -> tuple[BodyMotion, Floats]:
    """Return the motion that the command tells of a table, and the times of its samples."""
    np.savetxt(file, np.stack(columns, axis=1), delimiter=",", header=head, comments="", fmt="%.9g")
    case = read_source(file, SpindownOptions(**options)).case
    series = case.casing
    if case.quantity == "omega" and not np.any(series.window):
        return motion_of_speeds(series.time, series.omega, series.omega_sigma, series.angle), series.time
    return motion_of(series.time, series.angle, series.sigma), series.time


def spindown(kind: str, file: Path, rng: np.random.Generator) -> dict[str, float]:
    """Return the deviations of the summaries of one rotation from the truth, in their uncertainties."""
    path, length = rotation(rng)
    if kind == "pulses":
        per_turn = int(rng.choice([1, 2, 8, 60]))
        if path(length)[0] < 60 * np.pi / per_turn:
            per_turn = 60
        angles = 0.4 + 2 * np.pi / per_turn * np.arange(
            int((path(length)[0] - 0.3) / (2 * np.pi / per_turn)) - 1
        )
        fine = np.linspace(0, length, 20001)
        times = np.interp(angles, path(fine)[0], fine)
        for _ in range(3):
            at = path(times)
            times = times - (at[0] - angles) / at[1]
        jitter = min(float(np.exp(rng.uniform(*np.log([1e-6, 3e-4])))), 0.1 * float(np.diff(times).min()))
        columns = [times + rng.normal(0, jitter, len(times))]
        motion, seen = summary(file, columns, "t [s]", pulses_per_turn=per_turn)
    else:
        t = np.linspace(0, length, int(rng.uniform(400, 3000)))
        angle, speed = path(t)
        sigma = float(np.exp(rng.uniform(*np.log([3e-4, 1e-2]))))
        if kind == "speeds":
            speed = speed + rng.normal(0, sigma * rng.uniform(0.5, 5), len(t))
            motion, seen = summary(file, [t, speed], "t [s],omega [rad/s]")
        else:
            angle = angle + rng.normal(0, sigma, len(t))
            if kind == "angles, correlated noise":
                time = float(np.exp(rng.uniform(*np.log([0.1, 3.0]))))
                angle += slow_noise(t, sigma * rng.uniform(0.5, 3), time, rng)
            motion, seen = summary(file, [t, angle], "t [s],angle [rad]")
    first, last, middle, step = seen[0], seen[-1], 0.5 * (seen[0] + seen[-1]), 1e-4 * length
    mean = (path(last)[0] - path(first)[0]) / (last - first)
    alpha = (path(middle + step)[1] - path(middle - step)[1]) / (2 * step)
    return {
        "first speed": (motion.omega["first"] - path(first)[1]) / motion.omega_u["first"],
        "last speed": (motion.omega["last"] - path(last)[1]) / motion.omega_u["last"],
        "mean speed": (motion.omega_mean.value - mean) / motion.omega_mean.stderr,
        "acceleration": (motion.alpha.value - alpha) / motion.alpha.stderr,
    }


FRAMES, WIDTH, HEIGHT, EXPOSURES = 200, 240, 180, 3


def texture(rng: np.random.Generator, height: int, width: int, scale: float) -> Floats:
    """Return a random picture with structures of a scale [px]."""
    picture = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), scale)
    return np.asarray(130 + 35 * picture / picture.std())


def draw(path: Path, angle: Callable[[Floats], Floats], fps: int, rng: np.random.Generator) -> None:
    """Draw a disc whose angle is a function of time [rad against s]."""
    radius = float(rng.uniform(50, 75))
    centre = np.array([WIDTH, HEIGHT]) / 2 + rng.uniform(-8, 8, 2)
    size = int(2 * radius + 20)
    disc, behind = texture(rng, size, size, radius / 10), texture(rng, HEIGHT, WIDTH, 6.0)
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    mask = np.clip(radius + 0.5 - np.hypot(x, y), 0, 1)
    tilt, direction = rng.uniform(0, 0.1), rng.uniform(0, np.pi)
    turn = np.array([[np.cos(direction), np.sin(direction)], [-np.sin(direction), np.cos(direction)]])
    view = turn.T @ np.diag([np.cos(tilt), 1.0]) @ turn
    noise, share = float(rng.uniform(1, 4)), float(rng.uniform(0.1, 0.7))
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=fps)
        stream.width, stream.height, stream.pix_fmt, stream.options = WIDTH, HEIGHT, "yuv420p", {"crf": "18"}
        for k in range(FRAMES):
            total = np.zeros((HEIGHT, WIDTH))
            for part in (np.arange(EXPOSURES) + 0.5) / EXPOSURES - 0.5:
                a = -float(angle(np.array((k + share * part) / fps)))  # counter-clockwise in the picture
                matrix = view @ np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
                to = np.column_stack([matrix, centre - matrix @ np.full(2, (size - 1) / 2)])
                over = cv2.warpAffine(mask, to, (WIDTH, HEIGHT))
                seen = cv2.warpAffine(
                    disc, to, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
                )
                total += behind * (1 - over) + seen * over
            frame = total / EXPOSURES + rng.normal(0, noise, total.shape)
            grey = np.clip(frame, 0, 255).astype(np.uint8)
            rgb = av.VideoFrame.from_ndarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), format="rgb24")
            container.mux(stream.encode(rgb))
        container.mux(stream.encode())


def film(kind: str, file: Path, rng: np.random.Generator) -> dict[str, float]:
    """Return the deviations of the summaries of one film from the truth, in their uncertainties."""
    fps = int(rng.choice([30, 60, 120, 240]))
    path, last = file.with_suffix(".mp4"), (FRAMES - 1) / fps
    rotates = kind == "film of a rotation"
    if rotates:
        # the exposure of the first frame begins before it
        longer, _ = rotation(rng, fps * float(np.exp(rng.uniform(*np.log([0.03, 0.3])))), (FRAMES + 1) / fps)

        def run(t: Any) -> Floats:
            return np.asarray(longer(t + 1 / fps)) - [longer(1 / fps)[0], 0.0]

        draw(path, lambda t: run(t)[0], fps, rng)
    else:
        period, size = float(rng.uniform(15, 50)) / fps, float(rng.uniform(0.05, 0.35))
        decay = float(np.exp(rng.uniform(*np.log([0.02, 1.5])))) / last
        rate = float(np.sqrt((2 * np.pi / period) ** 2 + decay**2))
        phase = float(rng.uniform(0, 2 * np.pi))
        period = 2 * np.pi / np.sqrt(rate**2 - decay**2)
        draw(path, lambda t: size * np.exp(-decay * t) * np.cos(2 * np.pi * t / period + phase), fps, rng)
    words = ["spindown", str(path), "--json", "-q", "-o", str(file.with_suffix("")), "--force"]
    said = subprocess.run(
        [sys.executable, "-m", "gyrotrack", *words], capture_output=True, text=True, check=False
    )
    found = json.loads(said.stdout or "{}").get("motion")
    if found is None or (found["period"] is None) is not rotates:
        print(kind, file.stem, said.stderr[-200:] if found is None else found["kind"], file=sys.stderr)
        return {}
    if not rotates:
        largest = size * np.exp(-decay * last / 2)
        truth = {"period": period, "amplitude": largest}
        return {k: (found[k]["value"] - v) / found[k]["stderr"] for k, v in truth.items()}
    sign, step = np.sign(found["omega_mean"]["value"]), 1e-4 * last
    alpha = (run(last / 2 + step)[1] - run(last / 2 - step)[1]) / (2 * step)
    return {
        "first speed": (sign * found["omega"]["first"] - run(0.0)[1]) / found["omega_u"]["first"],
        "last speed": (sign * found["omega"]["last"] - run(last)[1]) / found["omega_u"]["last"],
        "mean speed": (sign * found["omega_mean"]["value"] - run(last)[0] / last)
        / found["omega_mean"]["stderr"],
        "acceleration": (sign * found["alpha"]["value"] - alpha) / found["alpha"]["stderr"],
    }


def oscillation(kind: str, file: Path, rng: np.random.Generator) -> dict[str, float]:
    """Return the deviations of period and amplitude at the middle of one oscillation, in their uncertainties."""
    period, count, size = float(rng.uniform(0.5, 2.5)), rng.uniform(8, 60), float(rng.uniform(0.05, 0.35))
    length = count * period
    decay, rate = float(np.exp(rng.uniform(*np.log([0.02, 1.5])))) / length, 2 * np.pi / period
    restoring = np.sin if kind == "pendulum" else lambda x: x
    run = solve_ivp(
        lambda _, y: [y[1], -(rate**2) * restoring(y[0]) - 2 * decay * y[1]],
        (0, length), [size, 0.0], rtol=1e-10, atol=1e-11, dense_output=True,
    ).sol  # fmt: skip
    fine = np.linspace(0, length, int(400 * count))
    x = run(fine)[0]
    rises = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    zeros = fine[rises] - x[rises] * (fine[1] - fine[0]) / (x[rises + 1] - x[rises])
    tops = 1 + np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:]))
    t = np.linspace(0, length, int(count * rng.uniform(12, 60)))
    sigma = size * float(np.exp(rng.uniform(*np.log([0.002, 0.05]))))
    angle = run(t)[0] + rng.uniform(-0.3, 0.3) + rng.normal(0, sigma, len(t))
    motion, seen = summary(file, [t, angle], "t [s],angle [rad]")
    if motion.period is None or motion.amplitude is None:
        return {}
    middle = 0.5 * (seen[0] + seen[-1])
    truth = np.interp(middle, 0.5 * (zeros[1:] + zeros[:-1]), np.diff(zeros))
    largest = np.exp(np.interp(middle, fine[tops], np.log(x[tops])))
    return {
        "period": (motion.period.value - truth) / motion.period.stderr,
        "amplitude": (motion.amplitude.value - largest) / motion.amplitude.stderr,
    }


KINDS = {
    "angles": spindown,
    "angles, correlated noise": spindown,
    "speeds": spindown,
    "pulses": spindown,
    "damped oscillation": oscillation,
    "pendulum": oscillation,
}
FILMS = {"film of a rotation": film, "film of an oscillation": film}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--count", type=int, default=50, help="recordings of each kind (50)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--films", action="store_true", help="measure drawn films")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    rows: list[list[object]] = []
    for i, (kind, deviations) in enumerate((FILMS if options.films else KINDS).items()):
        with tempfile.TemporaryDirectory() as folder:
            found = [
                deviations(kind, Path(folder) / f"{k}.csv", np.random.default_rng([options.seed, i, k]))
                for k in range(options.count)
            ]
        for name in max(found, key=len):
            z = np.array([f[name] for f in found if name in f])
            rows.append([kind, name, f"{np.sqrt(np.mean(z**2)):.2f}", f"{np.abs(z).max():.1f}", len(z)])
            print(*rows[-1], flush=True)
    text = table(["recording", "summary", "rms z", "largest", "recordings"], rows)
    if options.output:
        options.output.write_text(
            f"# Summaries of `spindown`\n\nCommit {commit()}.\n\n{text}\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
