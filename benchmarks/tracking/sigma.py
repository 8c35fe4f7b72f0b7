"""Is the uncertainty of an angle the size of its error? One cell a kind of film, two renderers that share no code.

    python benchmarks/tracking/sigma.py --seeds 2 -o benchmarks/tracking/sigma.md

z is error over uncertainty, the error without its median over the clip; its spread should be 1. A view of a marker
counts as unhidden when nothing covers any of it.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from speed import commit

from gyrotrack.errors import GyrotrackError
from gyrotrack.pipeline import extract
from gyrotrack.synthetic import Camera, Light, Motion, Scene, Wobble, render_clip

SPAN = np.linspace(-0.1, 4.0, 60)
LIGHT = Light(gradient=(0.2, -0.1), vignette=0.15, flicker=0.04, glint=0.1, shadow=0.3)
CAMERA = Camera(320, 240, 1000.0, exposure=0.6e-3, scale=3.4, tilt=0.05, tilt_azimuth=0.7, noise=3.0)

OWN = {  # cell: changes of camera, light, table
    "as usual": ({}, LIGHT, "grey"),
    "white table": ({}, LIGHT, "white"),
    "wooden table": ({}, LIGHT, "wood"),
    "even light": ({}, Light(), "grey"),
    "dim, uneven, flicker": ({}, replace(LIGHT, level=0.5, gradient=(0.5, -0.3), flicker=0.15), "grey"),
    "noise 1": ({"noise": 1.0}, LIGHT, "grey"),
    "noise 8": ({"noise": 8.0}, LIGHT, "grey"),
    "blur 1.5 px": ({"psf": 1.5}, LIGHT, "grey"),
    "smear x 0.2": ({"exposure": 0.12e-3}, LIGHT, "grey"),
    "smear x 1.6": ({"exposure": 0.95e-3}, LIGHT, "grey"),
    "tilt 0.2": ({"tilt": 0.2}, LIGHT, "grey"),
    "tilt 0": ({"tilt": 0.0}, LIGHT, "grey"),
    "markers at 30 px": ({"width": 160, "height": 120, "scale": 1.75}, LIGHT, "grey"),
    "markers at 150 px": ({"width": 640, "height": 576, "scale": 8.8}, LIGHT, "grey"),
}
FOREIGN = {
    "other renderer": {},
    "other renderer, wood": {"table": "wood"},
    "other renderer, white table": {"table": "white"},
    "other renderer, noise 9, flicker": {"noise": 9.0, "flicker": 0.25},
    "other renderer, tilt 0.2, disc high": {"tilt": 0.2, "lift": 0.15},
    "other renderer, 120 frames, resonant": {
        "frames": 120,
        "rotor": lambda t: 1.0 + 1000 * 2 * np.pi / 20.02 * t,
    },
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    lines = [
        "# Claimed and true uncertainty",
        "",
        f"Commit {commit()}; {args.seeds} films a cell, {args.frames} frames each. Errors in mrad.",
        "",
        "| cell | body | frames | error, rms | sigma, median | spread of z | beyond 5 | unhidden views kept |",
        "|---|---|---|---|---|---|---|---|",
    ]
    cells = [(name, "own") for name in OWN] + [(name, "foreign") for name in FOREIGN]
    with tempfile.TemporaryDirectory() as folder:
        for name, kind in cells:
            found = []
            for seed in range(args.seeds):
                path = Path(folder) / "film.mp4"
                make = own if kind == "own" else foreign
                try:
                    found.append(make(path, name, seed, args.frames))
                except GyrotrackError as error:
                    found.append({})
                    print(f"{name}, seed {seed}: {error}", file=sys.stderr)
            for line in rows(name, found):
                print(line, flush=True)
                lines.append(line)
    if args.output:
        args.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


def own(path: Path, name: str, seed: int, frames: int) -> dict:
    changes, light, table = OWN[name]
    camera = replace(CAMERA, **{"tilt_azimuth": 0.7 + seed, **changes})
    motion = Motion.from_speeds(
        SPAN, 310.0 + 53 * seed - 15 * SPAN, 60 + 21 * seed + 5 * SPAN, 0.3, 0.7 * seed
    )
    scene = Scene(wobble=Wobble(0.08, 3.0 + 0.4 * seed, phase=seed), table=table)
    truth = render_clip(path, scene, motion, camera, light, frames=frames, seed=seed, force=True)
    recording = extract(path, capture_fps=camera.fps, threads=1)
    kept = [
        np.isfinite(marker.angle_fine)[truth.visible[m][recording.frame_index] > 0.999]
        for m, marker in recording.markers.items()
    ]
    return {"kept": np.concatenate(kept), **errors(recording, truth.angle)}


def foreign(path: Path, name: str, seed: int, frames: int) -> dict:
    module = foreign_module()
    film = replace(module.Film(), **{
        "width": 320, "height": 240, "radius": 105.0, "fps": 1000.0, "frames": frames, "exposure": 0.4e-3,
        "seed": seed, "casing": lambda t: 2.0 + (83.0 + 7 * seed) * t, "rotor": lambda t: 0.5 + (437.0 + 97 * seed) * t,
        **FOREIGN[name],
    })  # fmt: skip
    module.render(film, path)
    recording = extract(path, capture_fps=film.fps, threads=1)
    return errors(recording, {"casing": film.casing(film.time), "rotor": film.rotor(film.time)})


def foreign_module():
    if "foreign_film" not in sys.modules:
        path = Path(__file__).parents[2] / "tests" / "gyrotrack" / "foreign_film.py"
        spec = importlib.util.spec_from_file_location("foreign_film", path)
        sys.modules["foreign_film"] = module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return sys.modules["foreign_film"]


def errors(recording, angle: dict) -> dict:
    found = {}
    for name, track in recording.bodies.items():
        off = track.angle - angle[name][np.rint(track.time * recording.capture_fps).astype(int)]
        found[name] = (off - np.median(off), track.sigma)
    return found


def rows(name: str, found: list[dict]) -> list[str]:
    lines = []
    kept = [f["kept"] for f in found if "kept" in f]
    share = f"{np.concatenate(kept).mean():.3f}" if kept else ""
    for body in ("casing", "rotor"):
        parts = [f[body] for f in found if body in f]
        if not parts:
            lines.append(f"| {name} | {body} | 0 | | | | | |")
            continue
        error, sigma = (np.concatenate([p[k] for p in parts]) for k in (0, 1))
        z = error / sigma
        lines.append(
            f"| {name} | {body} | {len(z)} | {1e3 * error.std():.2f} | {1e3 * np.median(sigma):.2f} "
            f"| {z.std():.2f} | {(np.abs(z) > 5).sum()} | {share} |"
        )
    return lines


if __name__ == "__main__":
    main()
