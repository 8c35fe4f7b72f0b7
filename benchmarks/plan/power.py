"""Power predicted by `fitting.plan` against the detection rate of `fitting.diagnose` in simulated recordings.

    python benchmarks/plan/power.py run results.jsonl --runs 24       # adds runs until every cell has so many
    python benchmarks/plan/power.py run short.jsonl --runs 24 --short # recordings of 60 s, scores alone
    python benchmarks/plan/power.py table results.jsonl [--short]     # the table

Cells: five effects, each at the strengths for which 20, 50, 80 and 95 % are predicted from a description of the
recording (one recording of 200 s, angle noise 1 mrad, process noise 1e-7 N m rms with 1 s). A run counts as detected if
the verdict is not "adequate". The prediction knows no recording of the cell: it is made from the description alone.

With `--short`, recordings last 60 s, and a run counts as detected if the score of any candidate exceeds its threshold
in that recording: the search without refits, a tenth of the time.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binom

from fitting import Experiment, Model, diagnose, fit, simulate
from fitting.discovery._power import Search, delta_of_power
from fitting.effects._library import INERTIA_CASING, INERTIA_ROTOR, LIBRARY, PAPER, REDUCED
from fitting.planning._plan import _ESTIMATES, _SIMULATIONS, PlannedRecordings

NUMBERS = {name: value for name, value in PAPER.items() if name.rpartition(".")[0] in REDUCED}
INERTIAS = (INERTIA_ROTOR, INERTIA_CASING)
EFFECTS = ("casing.air.quadratic", "casing.windage", "bearing.drift", "touchpoint.step", "casing.unbalance")
POWERS = (0.2, 0.5, 0.8, 0.95)
# null data of the thresholds of a short recording
_DRAWS = 500


def main() -> None:
    """Run some recordings, or print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("run", "table"))
    parser.add_argument("results", type=Path)
    parser.add_argument("--runs", type=int, default=24, help="recordings of each cell")
    parser.add_argument("--first", type=int, default=0, help="first recording of each cell")
    parser.add_argument("--most", type=int, default=10_000, help="recordings of this call at most")
    parser.add_argument("--short", action="store_true", help="recordings of 60 s, scores without refits")
    args = parser.parse_args()
    duration = 60.0 if args.short else 200.0
    experiment = Experiment(
        torque_noise=1e-7, duration=duration, windows=tuple(x * duration for x in (0.02, 0.35, 0.78))
    )
    if args.what == "run":
        run(args.results, experiment, args.first, args.runs, args.most, short=args.short)
    else:
        print("\n".join(table(args.results, experiment)))


def cells(path: Path, experiment: Experiment) -> list[dict[str, Any]]:
    """Return the cells with their predictions, which are computed once and kept beside the results."""
    kept = path.with_suffix(".cells.json")
    if kept.exists():
        found: list[dict[str, Any]] = json.loads(kept.read_text())
        return found
    described = PlannedRecordings(Model.of(REDUCED), NUMBERS, INERTIAS, (experiment,), {})
    process = [described.process_noise(_SIMULATIONS + i) for i in range(_ESTIMATES)]
    search, *others = (
        Search(described.fit(i), truth=described.numbers, process=process) for i in range(_SIMULATIONS)
    )
    found = []
    for name in EFFECTS:
        limits = search.limits(LIBRARY[name], planned=True, others=others)
        for power in POWERS:
            delta = delta_of_power(limits.curve, power)
            predicted = float(np.interp(delta, limits.curve[:, 0], limits.curve[:, 1]))
            strength = delta * limits.stderr
            found.append({
                "effect": name, "symbol": limits.strength, "strength": strength, "shape": limits.shape,
                "torque_Nm": strength * limits.torque, "predicted": predicted,
            })  # fmt: skip
    kept.write_text(json.dumps(found, indent=1))
    return found


def run(path: Path, experiment: Experiment, first: int, runs: int, most: int, *, short: bool) -> None:
    """Add runs until every cell has enough."""
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known = {(r["cell"], r["seed"]) for r in done}
    wanted = [
        (c, s) for s in range(first, runs) for c in range(len(EFFECTS) * len(POWERS)) if (c, s) not in known
    ]
    all_cells = cells(path, experiment)
    for number, seed in wanted[:most]:
        cell = all_cells[number]
        effect = LIBRARY[cell["effect"]]
        prefix = f"{effect.name}."
        values = {f"{prefix}{p.symbol}": p.start for p in effect.parameters}
        values |= {f"{prefix}{k}": v for k, v in cell["shape"].items()}
        values[f"{prefix}{cell['symbol']}"] = cell["strength"]
        phases = [p.symbol for p in effect.parameters if p.role == "phase"]
        random = np.random.default_rng(1000 + seed)
        values |= {f"{prefix}{p}": float(random.uniform(0, 2 * np.pi)) for p in phases}
        record = simulate(
            Model.of([*REDUCED, effect.name]),
            NUMBERS | values,
            experiment,
            inertia_rotor=INERTIAS[0],
            inertia_casing=INERTIAS[1],
            seed=100_000 + 100 * seed + number,
        )
        base = fit(Model.of(REDUCED), record)
        line: dict[str, Any] = {"cell": number, "seed": seed}
        if short:
            scores = Search(base, draws=_DRAWS).scores()
            found = {n for n, s in scores.items() if s.score > s.threshold}
            own = scores[effect.name]
            line |= {"detected": bool(found), "named": effect.name in found}
            line |= {"score": round(own.score, 1), "threshold": round(own.threshold, 1)}
        else:
            answer = diagnose(base)
            best = answer.candidates[0] if answer.candidates else None
            names = [best.effect.name, *best.indistinguishable_from] if best and best.significant else []
            line |= {"detected": answer.verdict != "adequate", "named": effect.name in names}
        with path.open("a") as stream:
            stream.write(json.dumps(line) + "\n")


def table(path: Path, experiment: Experiment) -> list[str]:
    """Return the table: predicted and realised, with the 95 % binomial interval of the prediction."""
    done = [json.loads(line) for line in path.read_text().splitlines()]
    lines = [
        "| effect | rms torque [N m] | predicted | realised | n | 95 % interval of the prediction | inside |",
        "|---|---|---|---|---|---|---|",
    ]
    inside = 0
    counted = 0
    for number, cell in enumerate(cells(path, experiment)):
        mine = [r for r in done if r["cell"] == number]
        if not mine:
            continue
        n, found = len(mine), sum(r["detected"] for r in mine)
        low, high = binom.ppf([0.025, 0.975], n, cell["predicted"])
        good = bool(low <= found <= high)
        inside += good
        counted += 1
        lines.append(
            f"| {cell['effect']} | {cell['torque_Nm']:.2g} | {100 * cell['predicted']:.0f} % | {100 * found / n:.0f} % "
            f"({found}) | {n} | {low:.0f} to {high:.0f} | {'yes' if good else 'no'} |"
        )
    return [*lines, "", f"{inside} of {counted} cells are inside."]


if __name__ == "__main__":
    main()
