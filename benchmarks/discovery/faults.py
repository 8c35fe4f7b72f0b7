"""What is answered where nothing but the measurement is wrong: tables by lot, through the command line.

    python benchmarks/discovery/faults.py --runs 10 --limit-seconds 1800
    python benchmarks/discovery/faults.py --table

Each run is a gyroscope of experiment.py with other speeds, spans, windows and noise, and one fault. Its angles are
written as tables, and the steps are those of a user: `import`, `diagnose`. Right is the fault itself, corrected or
named, or an answer that claims no physical effect. Each line of faults.jsonl is one run; a run that has its answer is
not repeated.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np
from answer import commit
from experiment import CASES, LIGHT, Hidden, record
from judge import Share
from lines import run_each
from tabular import table

RESULTS = Path(__file__).parent / "faults.jsonl"
TURN = 2 * np.pi
# what a right answer says of each fault: an effect that it names, or words on the screen; "" where nothing need be said
SAID = {
    "inertia of the casing wrong by 1 to 3 %": "setup.inertia",
    "starts wrong by 1 to 10 ms rms, not stated": "camera.start",
    "starts wrong by 1 to 10 ms rms, stated": "",
    "a turn slipped in the casing": "slipped",
    "a turn slipped in a window": "slipped",
    "the clock of the casing steps by 10 to 100 ms": "the clock steps",
    "rate of the rotor's clock wrong by 0.7e-3 to 1.5e-3": "camera.clock",
    "harmonics of 5 mrad": "",
    "sigma half": "",
    "sigma double": "",
}


@dataclass
class Tables:
    """The tables of one recording, and what is given with them."""

    casing: list[Any]
    rotor: list[list[Any]]
    options: list[str] = field(default_factory=list)


def spoiled(fault: str, rng: np.random.Generator, number: int) -> tuple[Tables, dict[str, Any]]:
    """Return the tables of a recording with a fault, and its moments of inertia."""
    case = dict((*CASES, LIGHT)[number % 3])
    light = case["I_rotor"] == LIGHT["I_rotor"]
    case["span"] = float(rng.uniform(20, 40) if light else rng.uniform(60, 140))
    case["start"] = (case["start"][0] * float(rng.uniform(0.85, 1.1)), case["start"][1])
    case["sigma"] = float(10 ** rng.uniform(-3.0, -2.5))
    case["windows"] = (0.03, float(rng.uniform(0.3, 0.5)), float(rng.uniform(0.7, 0.85)))
    case["rates"] = (130, 1000)
    sign = float(rng.choice([-1.0, 1.0]))
    hidden = Hidden()
    if fault.startswith("inertia"):
        hidden = Hidden(inertia=sign * float(rng.uniform(0.01, 0.03)))
    elif fault.startswith("rate"):
        hidden = Hidden(clock=sign * float(rng.uniform(0.7e-3, 1.5e-3)))
    elif fault.startswith("harmonics"):
        size, phase = 5e-3, rng.uniform(0, TURN, 2)
        hidden = Hidden(centre=(size * float(rng.random() < 0.5), phase[0]), tilt=(size, phase[1]))
    made = record(case, hidden, torque_noise=0.0, rng=rng, label=fault)
    out = Tables(list(made["casing"]), [list(w) for w in made["rotor"]])
    _change(out, fault, rng)
    return out, {k: made[k] for k in ("I_rotor", "I_casing")}


def _change(out: Tables, fault: str, rng: np.random.Generator) -> None:
    """Change the tables as the fault does."""
    if fault.startswith("starts"):
        u = float(10 ** rng.uniform(-3, -2))
        for window in out.rotor:
            window[0] = window[0] + u * rng.standard_normal()
        if not fault.endswith("not stated"):
            out.options = ["--start-u", str(u)]
        return
    runs = [out.casing, *out.rotor]
    series = out.rotor[int(rng.integers(len(out.rotor)))] if fault.endswith("window") else out.casing
    at = int(rng.integers(len(series[0]) // 10, len(series[0]) * 9 // 10))
    after = np.arange(len(series[0])) >= at
    if fault.startswith("a turn"):
        series[1] = series[1] + rng.choice([-TURN, TURN]) * after
    elif fault.startswith("the clock"):
        series[0] = series[0] + float(10 ** rng.uniform(-2, -1)) * after
    elif fault.startswith("sigma"):
        for run in runs:
            run[2] = run[2] * (0.5 if fault.endswith("half") else 2.0)


def answer(fault: str, number: int, folder: Path) -> dict[str, Any]:
    """Write the tables of one run, and return what the commands say."""
    rng = np.random.default_rng([number, list(SAID).index(fault)])
    tables, inertias = spoiled(fault, rng, number)
    words = ["import", "--inertia-rotor", str(inertias["I_rotor"])]
    words += ["--inertia-casing", str(inertias["I_casing"]), *tables.options]
    for k, run in enumerate((tables.casing, *tables.rotor)):
        path = folder / f"{k}.csv"
        header = "t [s],angle [rad],sigma [rad]"
        np.savetxt(path, np.stack(run, axis=1), delimiter=",", header=header, comments="", fmt="%.9g")
        words += ["--rotor" if k else "--casing", str(path)]
    case = str(folder / "case.h5")
    began = time.monotonic()
    imported = gyrotrack(*words, "-o", case)
    said = json.loads(gyrotrack("diagnose", case, "--json").stdout or "{}")
    if "verdict" not in said:
        raise RuntimeError((imported.stderr + json.dumps(said))[-300:])
    line = {k: said[k] for k in ("verdict", "sentence")}
    first = said["candidates"][0] if said["candidates"] and said["verdict"] == "missing_effect" else None
    named = None if first is None else first["effect"]
    physical = first is not None and first["kind"] == "physical"
    line |= {"named": named, "physical": physical, "warnings": imported.stderr}
    return line | {"seconds": time.monotonic() - began, "commit": commit()}


def gyrotrack(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gyrotrack", *words], capture_output=True, text=True, check=False
    )


def report(lines: list[dict[str, Any]]) -> str:
    """Return the table: by fault, how often physics is claimed, and how often the fault is named or mended."""
    rows = []
    for fault, words in SAID.items():
        some = [x for x in lines if x["kind"] == fault]
        texts = [" ".join(str(x.get(k)) for k in ("named", "sentence", "warnings")) for x in some]
        claims = Share(x["verdict"] == "unexplained" or x["physical"] for x in some)
        rows.append([fault, len(some), claims, Share(words in t for t in texts) if words else "-"])
    return table(
        ["fault", "runs", "a physical effect named first, or unexplained", "the fault named or mended"], rows
    )


if __name__ == "__main__":
    run_each(__doc__, RESULTS, SAID, answer, report)
