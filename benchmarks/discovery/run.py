"""How often the missing effect is found, and how often one is named where nothing is missing.

    python benchmarks/discovery/run.py --seeds 3 --strength 0.01 --cases 2 --noise 1e-7 -o results.jsonl

Each line of the output is one hidden effect; `table.py` turns lines into the table.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from experiment import BUDGET, CASES, Hidden, hidden_effects, outside, record

from fitting.discovery import diagnose
from fitting.effects import REDUCED
from fitting.estimation import fit
from fitting.model import Model
from fitting.record import make_record

EQUAL = {
    "casing.windage": {"bearing.load"},
    "bearing.load": {"casing.windage"},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--strength", type=float, default=0.01)
    parser.add_argument("--cases", type=int, default=1)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--kind", choices=["library", "outside", "nothing"], default="library")
    parser.add_argument("-o", "--output", type=Path, default=Path("discovery.jsonl"))
    options = parser.parse_args()
    for seed in options.seeds:
        for name in names(options):
            line = one(name, seed, options)
            with options.output.open("a") as stream:
                stream.write(json.dumps(line) + "\n")
            print(
                line["hidden"],
                seed,
                line["verdict"],
                line["first"],
                line["class"],
                f"{line['seconds']:.1f} s",
                flush=True,
            )


def names(options) -> list[str]:
    rng = np.random.default_rng(0)
    if options.kind == "nothing":
        return ["nothing", "nothing, centre offset", "wrong inertia"]
    table = hidden_effects(1.0, 200.0, rng) if options.kind == "library" else outside(1.0, 200.0, rng)
    return [n for n in table if not options.only or n in options.only]


def one(name: str, seed: int, options) -> dict:
    records = []
    for i, case in enumerate(CASES[: options.cases]):
        rng = np.random.default_rng([seed, sum(map(ord, name))])
        x = options.strength * BUDGET
        if options.kind == "nothing":
            hidden = Hidden(
                centre=2e-3 if "centre" in name else 0.0, inertia=1.03 if "inertia" in name else 1.0
            )
        else:
            hidden = (hidden_effects if options.kind == "library" else outside)(x, case["span"], rng)[name]
        rng = np.random.default_rng([seed, i, sum(map(ord, name))])
        records.append(
            make_record(**record(case, hidden, torque_noise=options.noise, rng=rng, label=f"case{i + 1}"))
        )
    began = time.perf_counter()
    base = fit(Model.of(REDUCED), records)
    found = diagnose(base)
    seconds = time.perf_counter() - began
    physical = [
        c for c in found.candidates if c.effect.name not in ("camera.centre", "camera.tilt", "camera.shutter")
    ]
    first = physical[0]
    named = [first.effect.name, *first.indistinguishable_from] if found.verdict != "adequate" else []
    after = first.fit.cases[0] if first.fit is not None else None
    return {
        "hidden": name,
        "seed": seed,
        "strength": options.strength,
        "cases": options.cases,
        "noise": options.noise,
        "verdict": found.verdict,
        "first": first.effect.name,
        "kind": first.effect.kind,
        "class": named,
        "score": first.score,
        "delta_bic": first.delta_bic,
        "p": first.p_value,
        "right_first": first.effect.name == name or first.effect.name in EQUAL.get(name, set()),
        "right_named": name in named,
        "reduced_chi2_after": after.casing.reduced_chi2 if after else None,
        "held_out_after": after.casing.held_out if after else None,
        "top": [(c.effect.name, round(c.score, 1), round(c.delta_bic, 1)) for c in physical[:5]],
        "seconds": seconds,
    }


if __name__ == "__main__":
    main()
