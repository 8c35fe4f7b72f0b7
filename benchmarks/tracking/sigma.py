"""Is the uncertainty of an angle the size of its error? One cell a kind of film, two renderers that share no code.

    python benchmarks/tracking/sigma.py --seeds 2 -o benchmarks/tracking/sigma.md

z is error over uncertainty, the error without its median over the clip; its spread should be 1. The spreads of single
markers are given from the lowest to the highest. Of the views of markers those are counted that
nothing covers in any part.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from speed import commit

from gyrotrack._errors import GyrotrackError
from gyrotrack.synthetic._film import Film, render_clip
from gyrotrack.synthetic._scene import Camera, Light, Motion, Scene, Wobble
from gyrotrack.tracking._extract import extract

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
    "markers at 300 px": ({"width": 1280, "height": 1100, "scale": 16.5}, LIGHT, "grey"),
    "markers at 300 px, dim": (
        {"width": 1280, "height": 1100, "scale": 16.5, "tilt": 0.12},
        replace(LIGHT, level=0.5, gradient=(0.4, -0.2)),
        "white",
    ),
    "tilt 0.3": ({"tilt": 0.3}, LIGHT, "wood"),
    "260 frames/s": (
        {"width": 400, "height": 300, "fps": 260.0, "exposure": 1e-3, "scale": 4.2, "noise": 4.0},
        LIGHT,
        "grey",
    ),
    "compressed hard": ({}, LIGHT, "grey"),
    "compressed little": ({"noise": 5.0}, LIGHT, "grey"),
    "casing at 10 rad/s": ({}, LIGHT, "grey"),
}
QUALITY = {"compressed hard": 30, "compressed little": 12}
CASING = {"casing at 10 rad/s": 10.0, "markers at 300 px": 95.0, "markers at 300 px, dim": 130.0}
FOREIGN = {
    "other renderer": {},
    "other renderer, wood": {"table": "wood"},
    "other renderer, white table": {"table": "white"},
    "other renderer, noise 9, flicker": {"noise": 9.0, "flicker": 0.25},
    "other renderer, tilt 0.2, disc high": {"tilt": 0.2, "lift": 0.15},
    "other renderer, dark table, glint": {"table": "dark", "gradient": 0.4, "glint": 0.7},
    "other renderer, small papers": {"size": 0.7, "noise": 5.0},
    "other renderer, bright metal": {
        "metal": 170,
        "bar_metal": (200, 200, 198),
        "gradient": 0.3,
        "flicker": 0.1,
    },
    "other renderer, markers at 40 px": {"width": 200, "height": 150, "radius": 62.0},
    "other renderer, markers at 220 px": {"width": 720, "height": 640, "radius": 300.0},
    "other renderer, compressed hard": {"crf": 28},
    "other renderer, wandering centre": {"wobble": 1.5, "wobble_hz": 7.0},
    **{
        f"other renderer, 120 frames, {period} a turn": {
            "frames": 120,
            "rotor": lambda t, period=period: 1.0 + 1000 * 2 * np.pi / period * t,
        }
        for period in (4, 8.01, 10, 12.5, 16, 20.02)
    },
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument(
        "--only", action="append", help="only the cells whose name holds this; may be given several times"
    )
    parser.add_argument(
        "--found", type=Path, help="folder that keeps what was found; films in it are not drawn again"
    )
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    lines = [
        "# Claimed and true uncertainty",
        "",
        f"Commit {commit()}; {args.seeds} films a cell, {args.frames} frames each. Errors in mrad.",
        "",
        "| cell | body | frames | error, rms | sigma, median | spread of z | beyond 5 | markers | views kept |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    every: list[dict] = []
    cells = [(name, "own") for name in OWN] + [(name, "foreign") for name in FOREIGN]
    cells = [cell for cell in cells if not args.only or any(part in cell[0] for part in args.only)]
    with tempfile.TemporaryDirectory() as folder:
        for name, kind in cells:
            found = []
            for seed in range(args.seeds):
                path = Path(folder) / "film.mp4"
                make = own if kind == "own" else foreign
                try:
                    found.append(kept(args.found, make, path, name, seed, args.frames))
                except GyrotrackError as error:
                    found.append({})
                    print(f"{name}, seed {seed}: {error}", file=sys.stderr)
            every += found
            for line in rows(name, found):
                print(line, flush=True)
                lines.append(line)
    lines += ["", total(every)]
    print(lines[-1])
    if args.output:
        args.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


def kept(
    folder: Path | None, make: Callable[..., dict], path: Path, name: str, seed: int, frames: int
) -> dict:
    """Return what was found in a film: from the folder that keeps it, or now."""
    if folder is None:
        return make(path, name, seed, frames)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name.replace(' ', '_').replace('/', '_')}_{seed}_{frames}.npz"
    if not file.exists():
        found = make(path, name, seed, frames)
        np.savez(file, **{key.replace("/", "|"): np.asarray(value) for key, value in found.items()})
    with np.load(file) as held:
        return {key.replace("|", "/"): held[key] for key in held.files}


def own(path: Path, name: str, seed: int, frames: int) -> dict:
    changes, light, table = OWN[name]
    camera = replace(CAMERA, **{"tilt_azimuth": 0.7 + seed, **changes})
    motion = Motion.from_speeds(
        SPAN, 310.0 + 53 * seed - 15 * SPAN, CASING.get(name, 60 + 21 * seed) + 5 * SPAN, 0.3, 0.7 * seed
    )
    scene = Scene(wobble=Wobble(0.08, 3.0 + 0.4 * seed, phase=seed), table=table)
    film = Film(crf=QUALITY[name]) if name in QUALITY else None
    truth = render_clip(path, scene, motion, camera, light, frames=frames, film=film, seed=seed, force=True)
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
    for name, marker in recording.markers.items():
        seen = np.isfinite(marker.angle_fine)
        turn = np.exp(1j * (marker.angle_fine - angle[marker.body][recording.frame_index]))[seen]
        off = np.angle(turn / turn.mean())
        found[f"{marker.body}/{name}"] = ((off - np.median(off)), marker.sigma_calibrated[seen])
    return found


def rows(name: str, found: list[dict]) -> list[str]:
    lines = []
    kept = [f["kept"] for f in found if "kept" in f]
    share = f"{np.concatenate(kept).mean():.3f}" if kept else ""
    for body in ("casing", "rotor"):
        parts = [f[body] for f in found if body in f]
        if not parts:
            lines.append(f"| {name} | {body} | 0 | | | | | | |")
            continue
        error, sigma = (np.concatenate([p[k] for p in parts]) for k in (0, 1))
        z = error / sigma
        markers = sorted({key for f in found for key in f if key.startswith(f"{body}/")})
        own = [np.concatenate([f[m][0] / f[m][1] for f in found if m in f]).std() for m in markers]
        lines.append(
            f"| {name} | {body} | {len(z)} | {1e3 * error.std():.2f} | {1e3 * np.median(sigma):.2f} "
            f"| {z.std():.2f} | {(np.abs(z) > 5).sum()} | {min(own):.2f} to {max(own):.2f} | {share} |"
        )
    return lines


def total(found: list[dict]) -> str:
    z = np.concatenate([f[body][0] / f[body][1] for f in found for body in ("casing", "rotor") if body in f])
    return (
        f"Together {len(z)} angles: spread of z {z.std():.3f}, {(np.abs(z) < 1).mean():.3f} within 1, "
        f"{(np.abs(z) > 3).sum()} beyond 3, {(np.abs(z) > 4).sum()} beyond 4, {(np.abs(z) > 5).sum()} beyond 5."
    )


if __name__ == "__main__":
    main()
