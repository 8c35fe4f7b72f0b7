"""The same hidden effects in other forms, through the real commands: tables, case files, films, films with faults.

    python benchmarks/discovery/forms.py [--only film] [--shorter 0.5]

Films show a light, fast gyroscope for half a minute, as the sample clips do; a set takes minutes. The faulty ones have
one frame in forty dropped, a lamp that loses a fifth of its light halfway, glints, a camera tilted by 9 degrees,
stronger sensor noise, and poor compression.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from answer import commit
from experiment import CASES, LIGHT, Hidden, integrate, record, shake
from hidden import LIBRARY, Draw
from lines import append, read_lines

from fitting.inference._record import make_record
from gyrotrack.apps._simulation import write_record
from gyrotrack.synthetic._render import Renderer
from gyrotrack.synthetic._scene import Camera, Light, Motion, Scene

TARGET = Path(__file__).parent / "forms.jsonl"
_HIDDEN = ("casing.air.quadratic", "touchpoint.step", "bearing.drift", "")
_IN_FILMS = {"casing.air.quadratic": 9.2e-6, "touchpoint.step": 2e-6, "": 0.0}
_STRENGTH = 1.33e-6
_CASING_FPS, _ROTOR_FPS, _STORED_FPS = 260.0, 1000.0, 25.0
_ROTOR_AT, _ROTOR_LENGTH = (0.08, 0.32, 0.8), 1.5


def world(name: str, x: float, span: float) -> Hidden:
    """Return what is hidden; the same in every form."""
    draw = Draw(span, 0.57 * span, 9.0, 1.0, 400.0, 50.0)
    return LIBRARY[name](x, draw) if name else Hidden()


def as_table(folder: Path, name: str) -> list[Path]:
    """Write CSV tables and import them."""
    made = _recorded(name)
    parts = {"casing": made["casing"], **{f"rotor{i}": r for i, r in enumerate(made["rotor"])}}
    for part, (t, psi, sigma) in parts.items():
        np.savetxt(
            folder / f"{part}.csv",
            np.stack([t, psi, sigma], 1),
            "%.12g",
            ",",
            header="t,angle,sigma",
            comments="",
        )
    rotors = [w for part in list(parts)[1:] for w in ("--rotor", f"{part}.csv")]
    command(folder, "import", "--casing", "casing.csv", *rotors, "-o", "case.h5", "--label", "case1")
    return [folder / "case.h5"]


def as_case(folder: Path, name: str) -> list[Path]:
    """Write a case file."""
    made = make_record(**_recorded(name))
    return [write_record(folder / "case.h5", made, surface="", command="benchmark", settings={})]


def _recorded(name: str) -> dict[str, Any]:
    hidden = world(name, _STRENGTH, CASES[0]["span"])
    return record(CASES[0], hidden, torque_noise=0.0, rng=np.random.default_rng(11), label="case1")


def as_film(folder: Path, name: str, *, faulty: bool, shorter: float) -> list[Path]:
    """Draw films, track them, put them on one clock."""
    case = LIGHT | {"span": LIGHT["span"] * shorter}
    hidden = world(name, _IN_FILMS[name], case["span"])
    path = integrate(case, hidden, shake(case["span"], 0.0, 1.0, np.random.default_rng(0)))
    t = np.arange(0, path.time[-1], 1e-3)
    motion = Motion.from_angles(t, path.angle(t, 0) + 2.2, path.angle(t, 1) + 0.9)
    clips = {"casing": (_CASING_FPS, _CASING_FPS, 0.05, case["span"] - 0.2)}
    clips |= {
        f"rotor_{i}": (_ROTOR_FPS, _STORED_FPS, s * case["span"], _ROTOR_LENGTH)
        for i, s in enumerate(_ROTOR_AT)
    }
    for i, (clip, (fps, stored, start, length)) in enumerate(clips.items()):
        _draw(folder / f"{clip}.mp4", motion, (fps, stored, start, length), seed=i, faulty=faulty)
        rate = ["--capture-fps", f"{fps:g}"] if fps != stored else []
        command(folder, "extract", f"{clip}.mp4", *rate, "-o", f"{clip}.h5")
        (folder / f"{clip}.mp4").unlink()
    inertias = ["--inertia-rotor", f"{LIGHT['I_rotor']}", "--inertia-casing", f"{LIGHT['I_casing']}"]
    command(folder, "sync", *(f"{c}.h5" for c in clips), "-o", "case.h5", *inertias)
    return [folder / "case.h5"]


def _draw(
    path: Path, motion: Motion, clip: tuple[float, float, float, float], *, seed: int, faulty: bool
) -> None:
    fps, stored, start, length = clip
    rng = np.random.default_rng(seed)
    camera = Camera(
        width=480, height=360, fps=fps, container_fps=stored, exposure=0.3 / fps if fps < 500 else 0.8e-3, start=start,
        tilt=0.16 if faulty else 0.06, noise=5.0 if faulty else 2.5, roll=0.0 if fps < 500 else 0.31,
    )  # fmt: skip
    light = Light(glint=0.12, gradient=(0.2, -0.1), flicker=0.03) if faulty else Light()
    frames = int(length * fps)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(stored))
        stream.width, stream.height, stream.pix_fmt = camera.width, camera.height, "yuv420p"
        stream.options = {"crf": "27" if faulty else "20", "preset": "veryfast"}
        stream.codec_context.thread_count = 1
        for k, picture in enumerate(Renderer(Scene(), motion, camera, light, seed=seed).frames(frames)):
            if faulty and 0 < k < frames - 1 and rng.random() < 1 / 40:
                continue
            dimmed = (0.8 * picture).astype(np.uint8) if faulty and k > frames / 2 else picture
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(dimmed), format="rgb24")
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def command(folder: Path, *words: str, ends: tuple[int, ...] = (0,)) -> str:
    """Run a command as a user would, and return what it prints."""
    full = [sys.executable, "-m", "gyrotrack", *words]
    done = subprocess.run(full, cwd=folder, capture_output=True, text=True, check=False, env=os.environ)
    if done.returncode not in ends:
        raise RuntimeError(f"gyrotrack {words[0]}: {done.stderr.strip().splitlines()[-1:]}")
    return done.stdout


FORMS = {
    "table (CSV), import": lambda folder, name, _: as_table(folder, name),
    "case file": lambda folder, name, _: as_case(folder, name),
    "film, extract, sync": lambda folder, name, shorter: as_film(folder, name, faulty=False, shorter=shorter),
    "film with faults, extract, sync": lambda folder, name, shorter: as_film(
        folder, name, faulty=True, shorter=shorter
    ),
}


def ask(form: str, name: str, shorter: float) -> dict[str, Any]:
    """Return the line of one run."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as place:
        cases = FORMS[form](Path(place), name, shorter)
        words = [str(c) for c in cases]
        fitted = json.loads(command(Path(place), "fit", *words, "--json", ends=(0, 3)))
        found = json.loads(command(Path(place), "diagnose", *words, "--json", ends=(0, 3)))
    refitted = [c for c in found["candidates"] if c["delta_bic"] is not None and c["significant"]]
    first = refitted[0] if refitted and found["verdict"] != "adequate" else None
    return {
        "key": f"{form}|{name or 'nothing'}",
        "form": form,
        "hidden": [name] if name else [],
        "verdict": found["verdict"],
        "named": [first["effect"], *first["indistinguishable_from"]] if first else [],
        "note": _strength(name, first, form),
        "base": fitted.get("verdict"),
        "commit": commit(),
        "seconds": time.monotonic() - began,
    }


def _strength(name: str, first: dict[str, Any] | None, form: str) -> str:
    if first is None or first["effect"] != name:
        return ""
    film = form.startswith("film")
    truth = world(name, _IN_FILMS[name] if film else _STRENGTH, 1.0).truth["k"]
    value = next(p for key, p in first["parameters"].items() if key.partition("@")[0].endswith(".k"))
    return f"k / truth = {value['value'] / truth:.4f} ± {value['stderr'] / truth:.4f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", help="a word that must stand in the key of a run")
    parser.add_argument("--shorter", type=float, default=1.0, help="share of the length of the films")
    parser.add_argument("-o", "--output", type=Path, default=TARGET)
    options = parser.parse_args()
    done = {x["key"] for x in read_lines(options.output) if "error" not in x}
    for form in FORMS:
        for name in _IN_FILMS if form.startswith("film") else _HIDDEN:
            key = f"{form}|{name or 'nothing'}"
            if options.only not in key or key in done:
                continue
            try:
                line = ask(form, name, options.shorter)
            except Exception as fault:  # whatever went wrong belongs into the table
                line = {"key": key, "form": form, "hidden": [name] if name else [], "error": f"{fault}"}
            append(options.output, line)
            print(line, flush=True)


if __name__ == "__main__":
    main()
