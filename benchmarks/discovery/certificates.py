"""Whether the rates that `certify` predicts are those of fresh simulations.

    python benchmarks/discovery/certificates.py --worlds 5 -n 24 -o benchmarks/discovery/certificates.jsonl
    python benchmarks/discovery/certificates.py --table

Each world is a light gyroscope of experiment.py, integrated by SciPy, with one hidden effect. Its strength is doubled
until the effect is named, so that it is near the limit of detection. The answer is certified with n recordings that
are simulated from its fit. As many fresh recordings of the world itself, with the effect and without it, are analysed
in the same way. A cell is one rate of one world; the two counts agree if Fisher's exact test gives p > 0.05.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np
from answer import commit
from experiment import LIGHT, Hidden, record
from hidden import LIBRARY, Draw
from lines import append, read_lines
from scipy.stats import fisher_exact
from tabular import table

from fitting import REDUCED, Model, certify, diagnose, fit, make_record
from fitting.discovery._certificate import Certificate, outcome_of_records

RESULTS = Path(__file__).parent / "certificates.jsonl"
EFFECTS = ("casing.air.quadratic", "bearing.heating", "touchpoint.step", "bearing.constant", "bearing.load")
WEAKEST = 2e-9  # N m
DOUBLINGS = 12


def counts(found: Certificate) -> dict[str, tuple[int, int]]:
    """Return, of each rate, how many of how many recordings."""
    null, truth = found.of("null"), found.of("truth")
    return {
        "false alarm": (found.alarms, len(null)),
        "named first": (sum(o.answer == o.effect for o in truth), len(truth)),
        "in the class": (sum(o.effect in o.named for o in truth), len(truth)),
    }


def world(number: int, n: int) -> dict[str, Any]:
    """Certify one answer, and repeat the world itself."""
    rng = np.random.default_rng([11, number])
    effect = EFFECTS[number % len(EFFECTS)]
    case = LIGHT | {"span": float(rng.uniform(28, 36)), "start": (float(rng.uniform(450, 650)), 4.0)}
    draw = Draw.of(case["span"], rng, rng)

    def made(strength: float, seed: int) -> Any:
        hidden = LIBRARY[effect](strength, draw) if strength else Hidden()
        own = np.random.default_rng([12, number, seed, strength > 0])
        return make_record(**record(case, hidden, torque_noise=0.0, rng=own, label="world"))

    base, strength = Model.of(REDUCED), WEAKEST
    for k in range(DOUBLINGS):
        found = diagnose(fit(base, [made(strength, 1000 + k)]))
        best = found.candidates[0] if found.candidates else None
        named = (best.effect.name, *best.indistinguishable_from) if best is not None else ()
        if found.verdict == "missing_effect" and effect in named:
            break
        strength *= 2
    else:
        raise RuntimeError(f"{effect} is never named")
    name = best.effect.name
    certificate = certify(found, n)
    fresh = [
        outcome_of_records(found, (kind, named, k), [made(x, k)])
        for kind, named, x in (("null", "", 0.0), ("truth", name, strength))
        for k in range(n)
    ]
    repeated = Certificate.of_answer(found, fresh, n)
    # intervals are compared with the values of the certified fit, which are not those of the world
    seen = counts(repeated)
    cells = {rate: (predicted, seen[rate]) for rate, predicted in counts(certificate).items()}
    return {"effect": effect, "named": name, "strength": strength, "n": n, "cells": cells, "commit": commit()}


def report(lines: list[dict[str, Any]]) -> str:
    """Return the table of all cells."""
    rows = []
    for x in lines:
        for rate, ((a, n), (b, m)) in x["cells"].items():
            p = float(fisher_exact([[a, n - a], [b, m - b]]).pvalue)
            rows.append(
                [
                    x["effect"],
                    x["named"],
                    rate,
                    f"{a} of {n}",
                    f"{b} of {m}",
                    f"{p:.2f}",
                    "yes" if p > 0.05 else "no",
                ]
            )
    agree = sum(r[-1] == "yes" for r in rows)
    head = ["hidden", "certified", "rate", "certificate", "fresh", "p", "agree"]
    return f"{agree} of {len(rows)} cells agree.\n\n{table(head, rows)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--worlds", type=int, default=5, help="number of worlds (5)")
    parser.add_argument("-n", type=int, default=24, help="recordings of each kind (24)")
    parser.add_argument("--table", action="store_true", help="only print the table")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    done = {x["key"] for x in read_lines(options.output)}
    for number in range(0 if options.table else options.worlds):
        if str(number) in done:
            continue
        began = time.monotonic()
        append(options.output, {"key": str(number), **world(number, options.n)})
        print(number, f"{time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    print(report(read_lines(options.output)))


if __name__ == "__main__":
    main()
