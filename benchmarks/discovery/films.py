"""How often the whole chain, from the film on, names what is hidden, and how often it names what is not there.

    python benchmarks/discovery/films.py --nothing 10 --one 10 --two 5 --fault 5 --limit-seconds 3600
    python benchmarks/discovery/films.py --table

Gyroscope, cameras, light, table and codec of each rig are drawn by lot from the seed. Its motion is integrated in
plain Python (experiment.py), rendered, and then every step is the command line of a user: `extract`, `sync`, `fit`,
`diagnose`, and `improve` where an effect is found. The strength of a hidden effect is drawn between 5 and 20 times
its detection limit, which the oracle finds for data with a white angle noise of 1 mrad. Each line of films.jsonl is
one rig; a rig that has its line is not run again.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np
from answer import commit
from experiment import CASES as PAPER
from experiment import LIGHT, Hidden, integrate, record, shake, together
from hidden import LIBRARY, Draw, twins
from judge import Share
from lines import append, read_lines
from oracle import Oracle
from tabular import table

from fitting.dynamics._model import Model
from fitting.effects._library import REDUCED
from fitting.inference._fit import fit
from fitting.inference._record import make_record
from gyrotrack.io._hdf5 import read_recording
from gyrotrack.synthetic._film import Film, render_clip
from gyrotrack.synthetic._scene import Camera, Light, Motion, Scene

RESULTS = Path(__file__).parent / "films.jsonl"
# the place of a part is in the seed of its rigs
PARTS = ("nothing", "one", "fault", "two")
_DETECTED = 3.6  # sigma at which a test of the whole library detects in half of the recordings
_STRENGTHS = (5.0, 20.0)  # detection limits
_TRIAL = 0.01  # share of the torque budget
_POINTS_PER_SECOND = 500
# what a careless set-up does: an inertia 1 to 3 % wrong, a clock 1e-3 wrong
FAULTS = {"setup.inertia": (0.01, 0.03), "camera.clock": (0.7e-3, 1.5e-3)}


@dataclass(frozen=True)
class Rig:
    """One gyroscope as it is filmed.

    Attributes
    ----------
    case : dict
        The gyroscope, as in experiment.py, with the starts of the windows as shares of its span.
    cameras : tuple of Camera
        Cameras of casing and rotor; their start is set for each clip.
    light, scene, film : Light, Scene, Film
        Illumination, bodies and table, codec.
    """

    case: dict[str, Any]
    cameras: tuple[Camera, Camera]
    light: Light
    scene: Scene
    film: Film

    @classmethod
    def of(cls, rng: np.random.Generator, *, paper: bool) -> Rig:
        """Draw a rig at the scale of the paper, or a light gyroscope whose run takes half a minute."""
        case = dict(PAPER[0] if paper else LIGHT)
        case["span"] = 60.0 if paper else float(rng.uniform(20, 40))
        case["start"] = (float(rng.uniform(850, 950) if paper else rng.uniform(450, 750)), 5.0)
        case["windows"] = (0.05, 0.42, 0.8)
        tilt, azimuth, scale = rng.uniform(0, 0.07), rng.uniform(0, 6.28), rng.uniform(4.0, 4.9)
        psf, noise, share = rng.uniform(0.5, 0.9), rng.uniform(1, 3), rng.uniform(0.2, 0.6)
        optics: dict[str, Any] = {"tilt_azimuth": azimuth, "psf": psf, "noise": noise, "scale": scale}
        cameras = tuple(
            Camera(fps=fps, container_fps=stored, exposure=share / fps, tilt=tilt * part, **optics)
            for fps, stored, part in ((260.0, 260.0, 1.0), (1000.0, 25.0, 0.7))
        )
        light = Light(
            level=rng.uniform(0.75, 1.1),
            vignette=rng.uniform(0, 0.15),
            flicker=float(rng.choice([0.0, 0.02])),
            flicker_hz=float(rng.choice([100.0, 120.0])),
            glint=rng.uniform(0, 0.2),
            shadow=rng.uniform(0, 0.3),
        )
        scene = Scene(structure=rng.uniform(0.03, 0.1), table=rng.choice(["grey", "white", "wood"]))
        film = Film(crf=int(rng.integers(18, 24)), bframes=int(rng.choice([0, 2])))
        return cls(case, (cameras[0], cameras[1]), light, scene, film)

    def films(self, folder: Path, world: Hidden, rng: np.random.Generator) -> list[Path]:
        """Render the clips of casing and rotor, and store the true angles beside them."""
        case = self.case | world.constants
        path = integrate(case, world, shake(case["span"], 0.0, 1.0, rng))
        time = np.linspace(0.0, case["span"], int(case["span"] * _POINTS_PER_SECOND) + 1)
        motion = Motion.from_angles(time, path.angle(time, 0), path.angle(time, 1))
        starts = [0.0, *(s * case["span"] for s in case["windows"])]
        files = []
        for i, start in enumerate(starts):
            camera = self.cameras[min(i, 1)]
            camera = replace(camera, start=start + 1 / camera.fps, rate=1 + world.clock * (i > 0))
            frames = int((case["span"] if not i else case["window"]) * camera.fps) - 2
            files.append(folder / (f"rotor_{i}.mp4" if i else "casing.mp4"))
            seed = int(rng.integers(2**31))
            shot = {"frames": frames, "film": self.film, "seed": seed}
            render_clip(files[-1], self.scene, motion, camera, self.light, **shot)
            np.save(files[-1].with_suffix(".npy"), path.angle(camera.times(frames), int(i == 0)))
        return files


def answer(part: str, seed: int, folder: Path) -> dict[str, Any]:
    """Film one rig, run the chain, and keep what is needed to judge it."""
    rng = np.random.default_rng([seed, PARTS.index(part)])
    rig = Rig.of(rng, paper=bool(seed % 2))
    draw = Draw.of(rig.case["span"], rng, rng)
    hidden: list[str] = []
    sizes: list[dict[str, Any]] = []
    world = Hidden()
    if part in ("one", "two"):
        left = [n for n in LIBRARY if n != "external.constant"]
        while len(hidden) < ("one", "two").index(part) + 1:
            hidden.append(str(rng.choice(left)))
            left = [n for n in left if n not in twins(hidden[-1])]
            effect, size = _sized(rig, hidden[-1], draw, rng)
            world = together([world, effect])
            sizes.append(size)
    elif part == "fault":
        hidden = [str(rng.choice(list(FAULTS)))]
        low, high = FAULTS[hidden[0]]
        error = float(rng.uniform(low, high) * rng.choice([-1, 1]))
        world = Hidden(clock=error) if hidden == ["camera.clock"] else Hidden(inertia=error)
        sizes = [{"truth": {"eps": error}}]
    began = time.monotonic()
    files = rig.films(folder, world, rng)
    line = {"hidden": hidden, "size": sizes, "rendered_s": time.monotonic() - began}
    return {"key": f"{part}|{seed}", "part": part, **line, **_chain(rig, files)}


def _sized(rig: Rig, name: str, draw: Draw, rng: np.random.Generator) -> tuple[Hidden, dict[str, Any]]:
    """Return the effect at 5 to 20 times its detection limit, and its size in sigma."""
    budget = 1.33e-4 * rig.case["I_rotor"] / PAPER[0]["I_rotor"]
    trial = LIBRARY[name](_TRIAL * budget, draw)
    data = record(rig.case, Hidden(), torque_noise=0.0, rng=rng, label="data")
    oracle = Oracle(fit(Model.of(list(REDUCED)), [make_record(**data)]), 0.0, 1.0)
    reach = oracle.reach(name, [trial])
    size = _DETECTED * float(np.exp(rng.uniform(*np.log(_STRENGTHS))))
    strength = _TRIAL * size / max(reach.beside_base, 1e-6)
    world = LIBRARY[name](strength * budget, draw)
    shown = {"sigma": size, "apart": reach.beside_rival * strength / _TRIAL, "rival": reach.rival}
    return world, {"strength": strength, "truth": world.truth, **shown}


def _chain(rig: Rig, films: list[Path]) -> dict[str, Any]:
    """Run the commands of a user on the films; return what they say."""
    folder, recordings = films[0].parent, []
    line: dict[str, Any] = {"exit": {}, "rms": [], "z": []}
    for film in films:
        fps = "260" if film.stem == "casing" else "1000"
        recordings.append(film.with_suffix(".h5"))
        words = [str(film), "--capture-fps", fps, "-o", str(recordings[-1]), "--workers", "1", "-q"]
        line["exit"][film.stem], _ = _gyrotrack("extract", *words)
        if not line["exit"][film.stem]:
            rms, z = _error(film)
            line["rms"].append(rms)
            line["z"].append(z)
    case = str(folder / "case.h5")
    inertias = ["--inertia-rotor", str(rig.case["I_rotor"]), "--inertia-casing", str(rig.case["I_casing"])]
    line["exit"]["sync"], _ = _gyrotrack("sync", *map(str, recordings), "-o", case, *inertias)
    began = time.monotonic()
    line["exit"]["fit"], fitted = _gyrotrack("fit", case, "--json")
    line["exit"]["diagnose"], said = _gyrotrack("diagnose", case, "--json")
    line["answered_s"] = time.monotonic() - began
    found, base = json.loads(said or "{}"), json.loads(fitted or "{}")
    refused = [x["error"]["message"] for x in (base, found) if "error" in x]
    if refused:
        raise RuntimeError("; ".join(refused))
    line |= {"commit": commit(), "fit": base.get("verdict"), "verdict": found.get("verdict")}
    line |= {"sentence": found.get("sentence"), "nuisance": found.get("nuisance")}
    if found.get("verdict") == "missing_effect" and found["candidates"]:
        first = found["candidates"][0]
        line["named"] = [first["effect"], *first.get("indistinguishable_from", [])]
        line["parameters"] = first.get("parameters")
        _, said = _gyrotrack("improve", case, "--json")
        improved = json.loads(said)
        if "error" in improved:
            raise RuntimeError(improved["error"]["message"])
        line["added"] = [r["added"].lstrip("+") for r in improved["ladder"] if r["added"]]
    return line


def _error(film: Path) -> tuple[float, float]:
    """Return the rms of the angle errors of a clip [rad], and of the errors over their sigma."""
    recording = read_recording(film.with_suffix(".h5"))
    body = recording.bodies["casing" if film.stem == "casing" else "rotor"]
    frames = np.rint(body.time * recording.capture_fps).astype(int)
    error = body.angle - np.load(film.with_suffix(".npy"))[frames]
    error -= np.median(error)
    return float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean((error / body.sigma) ** 2)))


def _gyrotrack(*words: str) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-m", "gyrotrack", *words], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout


def report(lines: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the tables: by part and scale, how often the answer is right; then each line that is wrong."""
    rows, wrong = [], []
    for part in PARTS:
        for scale in ("light", "paper"):
            some = [
                x
                for x in lines
                if x["part"] == part and (int(x["key"].split("|")[1]) % 2 == 1) == (scale == "paper")
            ]
            if some:
                rows.append([part, scale, *_shares(part, some)])
            wrong += [
                [x["key"], ", ".join(x["hidden"]), x["verdict"], ", ".join(x.get("named") or ["-"])]
                for x in some
                if not _right(x)
            ]
    header = ["part", "scale", "right", "right and first", "95 % intervals that cover", "`fit` agrees"]
    yield table(header, rows)
    yield table(["rig", "hidden", "verdict", "named"], wrong)


def _right(line: dict[str, Any]) -> bool:
    """Tell whether nothing false is claimed, and whether all that is hidden is found."""
    named = line.get("named") or []
    match line["part"]:
        case "nothing":
            return line["verdict"] in ("adequate", "undecided")
        case "one":
            return bool(twins(line["hidden"][0]) & set(named))
        case "two":
            # the class of the first effect stands for it: the ladder adds one of its members
            return all(twins(h) & {*named, *line.get("added", [])} for h in line["hidden"])
        case _:
            return not named or named[0] == line["hidden"][0]


def _shares(part: str, lines: list[dict[str, Any]]) -> list[Any]:
    named = [(x.get("named") or [""])[0] for x in lines]
    first = [any(n in twins(h) for h in x["hidden"]) for n, x in zip(named, lines, strict=True)]
    agree = [
        (x["fit"] in ("no_lack_of_fit", "adequate")) == (x["verdict"] != "missing_effect") for x in lines
    ]
    inside = [c for n, x in zip(named, lines, strict=True) if (c := _covers(x, n)) is not None]
    return [
        Share(map(_right, lines)),
        Share(first) if part != "nothing" else "-",
        Share(inside),
        Share(agree),
    ]


def _covers(line: dict[str, Any], named: str) -> bool | None:
    """Tell whether the 95 % interval of the strength contains the truth, where the first name is right."""
    if named not in line["hidden"]:
        return None
    symbol, truth = next(iter(line["size"][line["hidden"].index(named)]["truth"].items()))
    found = line["parameters"].get(f"{named}.{symbol}")
    return None if found is None else bool(abs(found["value"] - truth) < 1.96 * found["stderr"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    for part in PARTS:
        parser.add_argument(
            f"--{part}", type=int, default=0, metavar="N", help="number of rigs of this part (0)"
        )
    parser.add_argument(
        "--limit-seconds", type=float, default=float("inf"), help="begin no rig after this time"
    )
    parser.add_argument("--keep", type=Path, help="keep the films of each rig in this folder")
    parser.add_argument("--table", action="store_true", help="only print the tables")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    if not options.table:
        began = time.monotonic()
        done = {x["key"] for x in read_lines(options.output) if "error" not in x}
        # one of each part in turn, so that a run that is stopped has some of all
        plan = sorted((i, p) for p in PARTS for i in range(getattr(options, p)))
        for seed, part in plan:
            key = f"{part}|{seed}"
            if key in done or time.monotonic() - began > options.limit_seconds:
                continue
            folder = (options.keep or Path(tempfile.mkdtemp())) / key.replace("|", "-")
            folder.mkdir(parents=True)
            try:
                line = answer(part, seed, folder)
            except Exception as fault:  # whatever went wrong belongs into the table
                line = {"key": key, "error": f"{type(fault).__name__}: {fault}"}
            append(options.output, line)
            print(
                f"{time.monotonic() - began:6.0f} s  {key}  {', '.join(line.get('hidden') or ['-'])}  ",
                end="",
            )
            print(
                line.get("error") or f"{line['verdict']}: {', '.join(line.get('named') or ['-'])}", flush=True
            )
            if not options.keep:
                shutil.rmtree(folder.parent)
    for text in report([x for x in read_lines(options.output) if "error" not in x]):
        print(text, end="\n\n")


if __name__ == "__main__":
    main()
