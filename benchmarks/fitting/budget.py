"""The uncertainty budget against Monte Carlo (GUM Supplement 1): noise, inertias and clock are drawn anew in each fit.

    python benchmarks/fitting/budget.py --count 400

The budgets of ten recordings, in quadratic mean, are compared with the scatter of the parameters of `count` others.
The lines go to ``budget.jsonl`` (a seed that has its line is not run again), the table to ``budget.md``.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

import fitting
from fitting.inference._budget import budget
from fitting.inference._record import Record

HERE = Path(__file__).parent
LINES, TABLE = HERE / "budget.jsonl", HERE / "budget.md"
MODEL = fitting.Model.of("linear")
NUMBERS = {
    "rotor.air.quadratic.a2": 9.97e-11,
    "touchpoint.constant.b1": 2.88e-6,
    "casing.air.linear.b2": 8.28e-7,
    "bearing.linear.d": 1.57e-7,
}
EXPERIMENT = fitting.Experiment(
    duration=40.0, casing_fps=30.0, rotor_fps=100.0, windows=(3.0, 18.0, 34.0), sigma=3e-3
)
BUDGETS = 10
I_ROTOR, I_CASING, U_ROTOR, U_CASING, U_CLOCK = 5.54e-5, 2.06e-5, 1.2e-8, 6e-9, 3e-4


def recording(seed: int) -> Record:
    """Simulate a recording."""
    inertias = {"inertia_rotor": I_ROTOR, "inertia_casing": I_CASING}
    return fitting.simulate(MODEL, NUMBERS, EXPERIMENT, seed=seed, label="run", **inertias)


def drawn(seed: int) -> dict[str, float]:
    """Return the parameters of one draw."""
    random = np.random.default_rng([5, seed])
    rate = 1 + U_CLOCK * random.standard_normal()
    record = recording(1000 + seed)
    casing, *rotor = (replace(s, time=s.time * rate) for s in (record.casing, *record.rotor))
    inertias = (v + u * random.standard_normal() for v, u in ((I_ROTOR, U_ROTOR), (I_CASING, U_CASING)))
    i_rotor, i_casing = inertias
    changed = replace(
        record, casing=casing, rotor=tuple(rotor), I_rotor=i_rotor, I_casing=i_casing, digest=""
    )
    return {k: e.value for k, e in fitting.fit(MODEL, changed).estimates.items()}


def _budget(seed: int) -> dict[str, float]:
    """Return the combined standard uncertainties of one recording."""
    known = replace(recording(seed), I_rotor_u=U_ROTOR, I_casing_u=U_CASING)
    return {k: b.u for k, b in budget(fitting.fit(MODEL, known), clock_rate_u=U_CLOCK).items()}


def table(lines: list[dict[str, float]]) -> str:
    """Return u of the budget over the scatter of the draws."""
    budgets = [_budget(seed) for seed in range(BUDGETS)]
    error = 100 / math.sqrt(2 * (len(lines) - 1))
    rows = ["| parameter | u of the budget | scatter of the draws | u / scatter |", "|---|---|---|---|"]
    for name in budgets[0]:
        # the uncertainty of one recording depends on its noise, as its value does
        u = math.sqrt(np.mean([b[name] ** 2 for b in budgets]))
        scatter = float(np.std([x[name] for x in lines], ddof=1))
        rows.append(f"| `{name}` | {u:.4g} | {scatter:.4g} | {u / scatter:.3f} |")
    return "\n".join([*rows, "", f"Standard error of the last column: {error:.1f} %. Goal: within 5 %."])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--count", type=int, default=400, help="number of draws (400)")
    count = parser.parse_args().count
    stored = [json.loads(x) for x in LINES.read_text().splitlines()] if LINES.exists() else []
    with LINES.open("a", encoding="utf-8") as stream:
        for seed in range(len(stored), count):
            stored.append(drawn(seed))
            stream.write(json.dumps(stored[-1]) + "\n")
            stream.flush()
    made = f"{len(stored)} draws, made by `python benchmarks/fitting/budget.py --count {len(stored)}`."
    TABLE.write_text(
        f"# Uncertainty budget against Monte Carlo\n\n{made}\n\n{table(stored)}\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
