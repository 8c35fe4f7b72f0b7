"""Draws the sample clips: one run of a light, fast gyroscope, filmed by two cameras.

    python sample_clips/make_sample_clips.py [--out FOLDER]

The run holds one torque that the reduced model of the paper lacks. What it is, and every other answer, is
written to truth.json, which no command of gyrotrack reads. The same versions of OpenCV, NumPy and x264 draw
the same bytes.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from gyrotrack.synthetic._film import Film, Truth, render_clip
from gyrotrack.synthetic._scene import PAPERS, Camera, Light, Motion, Scene, Wobble

# The run. The hidden effect is casing: -HIDDEN_K omega_c |omega_c|, 9 % of the bearing's torque at the peak.
HIDDEN_EFFECT = "casing.air.quadratic"
HIDDEN_K = 3.6e-10  # N m s2
INERTIA_ROTOR, INERTIA_CASING = 4.2e-6, 1.6e-6  # kg m2
FRICTION = {"a1": 0.0, "a2": 3.2e-11, "b1": 6.0e-6, "b2": 3.6e-7} | {
    "c": 0.0, "d": 7.0e-8, "e": 0.0, "f": 9.5e-7, "g": 0.62
}  # fmt: skip
OMEGA_ROTOR, OMEGA_CASING = 540.0, 4.0  # rad/s at t = 0
PSI_ROTOR, PSI_CASING = 2.2, 0.9  # rad at t = 0
SPLINE_RATE = 2000.0  # Hz
SURFACE, LABEL = "grey cardstock", "sample"

# The films.
CASING_START, CASING_SECONDS = 0.0713, 29.5
ROTOR_STARTS = (2.2871, 9.4369, 24.1733)  # s of the run: on the rise, after the peak, in the tail
ROTOR_SECONDS = 2.2
ROTOR_RATE = 1.0 + 1.8e-5  # the clock of the second camera is slow
SKEW = {"red": 0.02, "blue": -0.025, "white": 0.01, "green": 0.03}  # rad: glued on by hand

SCENE = Scene(
    markers=tuple(replace(paper, skew=SKEW[paper.name]) for paper in PAPERS),
    table="grey",
    wobble=Wobble(radius=0.07, frequency=3.7, phase=1.0),
)
LIGHT = Light(gradient=(0.18, -0.10), vignette=0.12, flicker=0.03, flicker_hz=100.0, glint=0.08, shadow=0.3)
CASING_CAMERA = Camera(
    width=480,
    height=360,
    fps=260.0,
    exposure=1.0e-3,
    scale=4.7,
    centre=(236.3, 181.8),
    tilt=0.06,
    tilt_azimuth=0.4,
    start=CASING_START,
    noise=3.0,
)
ROTOR_CAMERA = Camera(
    width=480,
    height=360,
    fps=1000.0,
    container_fps=25.0,
    exposure=0.8e-3,
    scale=5.0,
    centre=(243.1, 177.4),
    tilt=0.09,
    tilt_azimuth=2.6,
    roll=0.31,
    perspective=1.0 / 600.0,
    rate=ROTOR_RATE,
    noise=3.0,
)


def rates(_t: float, y: np.ndarray) -> list[float]:
    """The accelerations of rotor and casing by the torques of the paper and the hidden one, and their speeds."""
    omega_r, omega_c = float(y[0]), float(y[1])
    slip, sense, k = abs(omega_r - omega_c), np.sign(omega_r - omega_c), FRICTION
    bearing = (k["d"] * slip + k["f"] * slip ** k["g"]) * sense
    on_rotor = -bearing - k["a2"] * omega_r * abs(omega_r)
    on_casing = bearing - k["b1"] * np.sign(omega_c) - k["b2"] * omega_c - HIDDEN_K * omega_c * abs(omega_c)
    return [float(on_rotor) / INERTIA_ROTOR, float(on_casing) / INERTIA_CASING, omega_r, omega_c]


def run() -> Motion:
    end = CASING_START + CASING_SECONDS + 0.5
    start = [OMEGA_ROTOR, OMEGA_CASING, PSI_ROTOR, PSI_CASING]
    found = solve_ivp(
        rates, (0.0, end), start, "DOP853", rtol=1e-11, atol=1e-12, max_step=0.05, dense_output=True
    )
    time = np.linspace(0.0, end, round(end * SPLINE_RATE) + 1)
    omega_rotor, omega_casing = found.sol(time)[:2]
    return Motion.from_speeds(time, omega_rotor, omega_casing, PSI_ROTOR, PSI_CASING)


def clips() -> dict[str, tuple[Camera, int]]:
    films = {"casing": (CASING_CAMERA, round(CASING_SECONDS * CASING_CAMERA.fps))}
    for k, start in enumerate(ROTOR_STARTS, start=1):
        camera = replace(ROTOR_CAMERA, start=start)
        films[f"rotor_{k}"] = (camera, round(ROTOR_SECONDS * camera.fps))
    return films


def answers(motion: Motion, truths: dict[str, Truth]) -> dict[str, object]:
    """The truth of the run, with the clips placed on the clock of the casing's camera."""
    placed = {}
    for name, truth in truths.items():
        placed[name] = {
            "clock_offset_s": (truth.clock_offset - CASING_START) / CASING_CAMERA.rate,
            "clock_rate": truth.clock_rate / CASING_CAMERA.rate,
            "frames": len(truth.time),
            "mean_centre_px": truth.centre.mean(axis=0).tolist(),
            "omega_rotor_first_last": truth.omega["rotor"][[0, -1]].tolist(),
            "omega_casing_first_last": truth.omega["casing"][[0, -1]].tolist(),
            "psi_rotor_first": float(truth.angle["rotor"][0]),
            "psi_casing_first": float(truth.angle["casing"][0]),
        }
    return {
        "hidden_effect": HIDDEN_EFFECT,
        "hidden_parameters": {"k": HIDDEN_K},
        "friction": FRICTION,
        "inertia_rotor": INERTIA_ROTOR,
        "inertia_casing": INERTIA_CASING,
        "omega_rotor_at_casing_start": float(motion.omega_rotor(CASING_START)),
        "omega_casing_at_casing_start": float(motion.omega_casing(CASING_START)),
        "rotor_camera_roll": ROTOR_CAMERA.roll,
        "wobble": asdict(SCENE.wobble),
        "markers": [asdict(marker) for marker in SCENE.markers],
        "clips": placed,
    }


def study(films: dict[str, tuple[Camera, int]]) -> str:
    """What an experimenter would note beside the films."""
    lines = [
        "# What an experimenter notes beside the films of one run.",
        f'label = "{LABEL}"',
        f'surface = "{SURFACE}"',
        f"inertia_rotor = {INERTIA_ROTOR}  # kg m2",
        f"inertia_casing = {INERTIA_CASING}  # kg m2",
    ]
    for name, (camera, _) in films.items():
        body = "casing" if name == "casing" else "rotor"
        lines += [
            "",
            "[[clip]]",
            f'file = "{name}.mp4"',
            f'body = "{body}"',
            f"capture_fps = {camera.fps:.0f}",
        ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder for the clips")
    parser.add_argument("--seconds", type=float, default=None, help="shorten every film, for a look")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    motion, films, truths = run(), clips(), {}
    for seed, (name, (camera, frames)) in enumerate(films.items(), start=1):
        count = frames if given.seconds is None else round(given.seconds * camera.fps)
        path = given.out / f"{name}.mp4"
        began = time.perf_counter()
        truths[name] = render_clip(
            path,
            SCENE,
            motion,
            camera,
            LIGHT,
            frames=count,
            film=Film(crf=22, bframes=2),
            seed=seed,
            force=True,
        )
        size, speed = path.stat().st_size / 1e6, count / (time.perf_counter() - began)
        print(f"{path}: {count} frames, {size:.2f} MB, {speed:.0f} frames/s")
    truth = json.dumps(answers(motion, truths), indent=2) + "\n"
    (given.out / "truth.json").write_text(truth, encoding="utf-8")
    (given.out / "study.toml").write_text(study(films), encoding="utf-8")


if __name__ == "__main__":
    main()
