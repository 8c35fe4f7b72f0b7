"""What `diagnose` answers for two recordings of one gyroscope: the same friction, other friction, or an effect in both.

    python benchmarks/discovery/pairs.py --runs 10 --limit-seconds 3600
    python benchmarks/discovery/pairs.py --table

Each pair is drawn by lot: two runs of a gyroscope of experiment.py with other starts, spans, noise and random torques.
Their angles are written as tables, and the steps are those of a user: `import` twice, `diagnose` of both. Each line of
pairs.jsonl is one pair; a pair that has its answer is not repeated.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np
from answer import commit
from experiment import CASES, LIGHT, Hidden, record
from faults import gyrotrack
from judge import Share
from lines import run_each
from tabular import table

RESULTS = Path(__file__).parent / "pairs.jsonl"
# the keys of experiment.py of the constants that recordings share, and their names
SHARED = {
    "a2": "rotor.air.quadratic.a2",
    "b2": "casing.air.linear.b2",
    "d": "bearing.linear.d",
    "f": "bearing.power.f",
}
KINDS = (
    "the same friction",
    "one constant differs by 10 to 40 %",
    "two constants differ",
    "quadratic drag in both",
)


def drawn(kind: str, rng: np.random.Generator, number: int) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the records of a pair, and the names of the constants that differ."""
    first = dict((*CASES, LIGHT)[number % 3])
    light = first["I_rotor"] == LIGHT["I_rotor"]
    differ = {"one": 1, "two": 2}.get(kind.split()[0], 0)
    chosen = [str(k) for k in rng.choice(list(SHARED), differ, replace=False)]
    drag = float(rng.uniform(1, 3)) * (2e-11 if light else 1e-10)
    hidden = (
        Hidden(casing=(lambda t, wr, wc, psi: -drag * wc * abs(wc),))
        if kind.startswith("quadratic")
        else Hidden()
    )
    records = []
    for k in range(2):
        case = dict(first)
        case["span"] = float(rng.uniform(20, 30) if light else rng.uniform(60, 120))
        case["start"] = (case["start"][0] * float(rng.uniform(0.8, 1.1)), case["start"][1])
        case["b1"] *= float(rng.uniform(0.5, 2.0))  # the touch point has its own friction in each run
        case["sigma"] = float(10 ** rng.uniform(-3.2, -2.5))
        case["windows"] = (0.03, float(rng.uniform(0.3, 0.5)), float(rng.uniform(0.7, 0.85)))
        case["rates"] = (130, 1000)
        for name in chosen if k else ():
            case[name] *= 1 + float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.4))
        torque = float(rng.choice([0.0, 10 ** rng.uniform(-8.5, -7.5)])) * (0.1 if light else 1.0)
        records.append(record(case, hidden, torque_noise=torque, rng=rng, label=str(k)))
    return records, [SHARED[k] for k in chosen]


def answer(kind: str, number: int, folder: Path) -> dict[str, Any]:
    """Write the tables of one pair, and return what the commands say."""
    rng = np.random.default_rng([number, KINDS.index(kind), 7])
    records, differ = drawn(kind, rng, number)
    began, cases = time.monotonic(), []
    for k, made in enumerate(records):
        words = ["import", "--inertia-rotor", str(made["I_rotor"]), "--inertia-casing", str(made["I_casing"])]
        for i, run in enumerate((made["casing"], *made["rotor"])):
            path = folder / f"{k}{i}.csv"
            header = "t [s],angle [rad],sigma [rad]"
            np.savetxt(path, np.stack(run, axis=1), delimiter=",", header=header, comments="", fmt="%.9g")
            words += ["--rotor" if i else "--casing", str(path)]
        cases.append(str(folder / f"case{k}.h5"))
        gyrotrack(*words, "-o", cases[-1])
    done = gyrotrack("diagnose", *cases, "--json")
    said = json.loads(done.stdout or "{}")
    if "verdict" not in said:
        raise RuntimeError(done.stderr[-300:])
    found = said.get("differs")
    line = {k: said[k] for k in ("verdict", "sentence")} | {"differ": differ}
    line["found"] = (
        [] if not found else [found["parameter"], *(o["parameter"] for o in found.get("others", ()))]
    )
    claimed = said["verdict"] == "missing_effect" and not found
    line["named"] = said["candidates"][0]["effect"] if claimed and said["candidates"] else None
    return line | {"seconds": time.monotonic() - began, "commit": commit()}


def report(lines: list[dict[str, Any]]) -> str:
    """Return the table: by kind, how often the recordings are said to differ, and how often rightly."""
    rows = []
    for kind in KINDS:
        some = [x for x in lines if x["kind"] == kind]
        right = {
            "the": lambda x: x["verdict"] == "adequate",
            "quadratic": lambda x: x["named"] == "casing.air.quadratic" and not x["found"],
        }.get(kind.split()[0], lambda x: set(x["differ"]) == set(x["found"]))
        rows.append([
            kind, len(some), Share(bool(x["found"]) for x in some), Share(x["named"] is not None for x in some),
            Share(right(x) for x in some),
        ])  # fmt: skip
    return table(["pairs", "number", "said to differ", "an effect is named", "right"], rows)


if __name__ == "__main__":
    run_each(__doc__, RESULTS, KINDS, answer, report)
