"""Do the numbers of two versions agree? The outputs of fixed commands, kept and compared.

    python benchmarks/regression/run.py keep OLD_CHECKOUT old/
    python benchmarks/regression/run.py keep . new/
    python benchmarks/regression/run.py compare old/ new/

`keep` runs the sample clips (extract, sync, fit, diagnose, improve, scan) and ten simulated studies, one of them empty,
two of them jointly, with the package of a checkout, and writes one JSON file per command: the JSON document that the
command prints, or checksums of the datasets of a file. It takes three minutes. `compare` lists every number that
differs by more than 1e-9 of itself, and exits with 1 if there is one; sentences are shown with `--sentences`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np

INERTIAS = ["--inertia-rotor", "5.54e-5", "--inertia-casing", "2.06e-5"]
STUDIES = {
    "none": [],
    "quadratic": ["--add", "casing.air.quadratic", "--strength", "0.01"],
    "step": ["--add", "touchpoint.step", "--strength", "0.02"],
    "unbalance": ["--add", "casing.unbalance", "--strength", "0.01"],
    "heating": ["--add", "bearing.heating", "--strength", "0.03"],
    "process_noise": ["--add", "casing.windage", "--strength", "0.02", "--torque-noise", "1e-7"],
    "drift": ["--add", "bearing.drift", "--strength", "0.02"],
    "disk": ["--add", "rotor.air.disk", "--strength", "0.02"],
    "precession": ["--add", "casing.precession", "--strength", "0.01"],
    "own_law": ["--add", "casing: -k*omega_c**3", "--set", "casing: -k*omega_c**3.k=1e-12"],
}
VOLATILE = {
    "seconds",
    "fps",
    "software_version",
    "created",
    "output",
    "source",
    "command",
    "fit_id",
    "from",
    "parent",
    "ledger",
}
RELATIVE, ABSOLUTE = 1e-9, 1e-13


class Keeper:
    """Runs commands of one checkout in a scratch folder and keeps what they say."""

    def __init__(self, checkout: Path, folder: Path, scratch: Path) -> None:
        self.checkout, self.folder, self.scratch = checkout.resolve(), folder, scratch
        threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self.environment = {**os.environ, **threads, "PYTHONPATH": str(self.checkout)}

    def command(self, name: str, *words: object) -> None:
        line = [sys.executable, "-m", "gyrotrack", *map(str, words), "--json", "-q"]
        done = subprocess.run(
            line, cwd=self.scratch, env=self.environment, capture_output=True, text=True, check=False
        )
        self._write(name, {"exit_code": done.returncode, "document": json.loads(done.stdout or "null")})

    def datasets(self, name: str, file: Path) -> None:
        """Keep shape, sums and number of missing values of every numeric dataset."""
        found = {}

        def visit(path: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu":
                a = np.asarray(item[...], dtype=float).ravel()
                mixed = float(np.nansum(a * np.cos(np.arange(a.size))))
                found[path] = [list(item.shape), float(np.nansum(a)), mixed, int(np.isnan(a).sum())]

        with h5py.File(file) as opened:
            opened.visititems(visit)
        self._write(name, found)

    def _write(self, name: str, document: Any) -> None:
        (self.folder / f"{name}.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
        print(name, flush=True)


def keep(checkout: Path, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    _refuse_another_package(checkout.resolve())
    with tempfile.TemporaryDirectory() as scratch:
        keeper, work = Keeper(checkout, folder, Path(scratch)), Path(scratch)
        clips = {"casing": 260, "rotor_1": 1000, "rotor_2": 1000, "rotor_3": 1000}
        for name, fps in clips.items():
            film = keeper.checkout / "sample_clips" / f"{name}.mp4"
            keeper.command(
                f"extract_{name}", "extract", film, "--capture-fps", fps, "-o", work / f"{name}.h5"
            )
            keeper.datasets(f"recording_{name}", work / f"{name}.h5")
        keeper.command(
            "sync", "sync", *(work / f"{name}.h5" for name in clips), "-o", work / "case.h5", *INERTIAS
        )
        keeper.datasets("case", work / "case.h5")
        for verb in ("fit", "diagnose", "improve", "scan", "ladder"):
            keeper.command(f"clips_{verb}", verb, work / "case.h5")
        for seed, (name, options) in enumerate(STUDIES.items()):
            file = work / f"{name}.h5"
            windows = ["--duration", 100, "--window", 10, "--window", 50, "--window", 90]
            keeper.command(
                f"{name}_simulate", "simulate", "-o", file, *windows, "--seed", seed, *options, *INERTIAS
            )
            for verb in ("fit", "diagnose", "improve"):
                keeper.command(f"{name}_{verb}", verb, file)
        pair = [work / "quadratic.h5", work / "step.h5"]
        keeper.command("joint_fit", "fit", *pair, "--joint")
        keeper.command("joint_diagnose", "diagnose", *pair)
        keeper.command("scan", "scan", pair[0])


def _refuse_another_package(checkout: Path) -> None:
    """Stop if this interpreter imports another copy: the finder of an editable install precedes PYTHONPATH."""
    line = [sys.executable, "-c", "import fitting; print(fitting.__file__)"]
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    found = subprocess.run(
        line, env=environment, cwd=checkout, capture_output=True, text=True, check=True
    ).stdout
    if not Path(found.strip()).is_relative_to(checkout):
        sys.exit(
            f"{found.strip()} would be measured, not {checkout}: run with the interpreter of that checkout"
        )


def compare(old: Path, new: Path, *, sentences: bool) -> int:
    """Print what differs and return how many numbers do."""
    count = 0

    def say(place: str, *what: object) -> None:
        nonlocal count
        count += 1
        print(place, *what)

    def walk(a: Any, b: Any, place: str) -> None:
        if isinstance(a, dict) and isinstance(b, dict):
            for key in a:
                if key not in VOLATILE:
                    walk(a[key], b[key], f"{place}/{key}") if key in b else say(f"{place}/{key}", "is gone")
        elif isinstance(a, list) and isinstance(b, list):
            if len(a) != len(b):
                say(place, "has", len(b), "entries instead of", len(a))
            for k, (x, y) in enumerate(zip(a, b, strict=False)):
                walk(x, y, f"{place}[{k}]")
        elif isinstance(a, str) and isinstance(b, str):
            if sentences and a != b:
                print(f"{place}\n  - {a}\n  + {b}")
        elif isinstance(a, int | float) and isinstance(b, int | float):
            both_missing = math.isnan(a) and math.isnan(b)
            if not both_missing and not math.isclose(a, b, rel_tol=RELATIVE, abs_tol=ABSOLUTE):
                say(place, a, "->", b)
        elif a != b:
            say(place, a, "->", b)

    for file in sorted(old.glob("*.json")):
        if not (new / file.name).exists():
            say(file.stem, "is missing")
            continue
        walk(
            *(json.loads((folder / file.name).read_text(encoding="utf-8")) for folder in (old, new)),
            file.stem,
        )
    print(f"{count} differences")
    return count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    keeping = verbs.add_parser("keep")
    keeping.add_argument("checkout", type=Path)
    keeping.add_argument("folder", type=Path)
    comparing = verbs.add_parser("compare")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    comparing.add_argument("--sentences", action="store_true")
    options = parser.parse_args()
    if options.verb == "keep":
        keep(options.checkout, options.folder)
    else:
        raise SystemExit(1 if compare(options.old, options.new, sentences=options.sentences) else 0)


if __name__ == "__main__":
    main()
