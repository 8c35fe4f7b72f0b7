"""Correlated angle noise in both cameras: do 95 % intervals cover, and is anything missing where nothing is hidden?

    python benchmarks/fitting/angle_noise.py --start 1000 --count 40 --jobs 2

Each recording has the reduced model, white noise of 1 mrad, and in each camera an Ornstein-Uhlenbeck angle noise whose
standard deviation (0.3 to 3 mrad) and correlation time (0.1 to 1 s) are drawn. The lines go to ``angle_noise.jsonl``
(a seed that has its line is not run again), the table to ``angle_noise.md``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
import numpy as np
from reduced import INERTIA, REDUCED
from scipy.signal import lfilter
from scipy.stats import beta

import fitting
from fitting.inference._record import Samples

HERE = Path(__file__).parent
LINES, TABLE = HERE / "angle_noise.jsonl", HERE / "angle_noise.md"


def wandering(samples: Samples, sigma: float, correlation: float, random: np.random.Generator) -> Samples:
    """Return samples with an Ornstein-Uhlenbeck noise added."""
    keep = np.exp(-float(np.median(np.diff(samples.time))) / correlation)
    kicks = sigma * np.sqrt(1 - keep**2) * random.standard_normal(len(samples))
    kicks[0] = sigma * random.standard_normal()
    return Samples(samples.time, samples.value + lfilter([1.0], [1.0, -keep], kicks), samples.sigma)


def run(seed: int) -> dict[str, Any]:
    """Simulate, fit and diagnose one recording."""
    random = np.random.default_rng(seed)
    levels, times = 10 ** random.uniform(-3.52, -2.52, 2), 10 ** random.uniform(-1, 0, 2)
    experiment = fitting.Experiment(duration=100.0, windows=(8.0, 50.0, 90.0))
    record = fitting.simulate(fitting.Model.of("reduced"), REDUCED, experiment, seed=seed, **INERTIA)
    casing = wandering(record.casing, levels[0], times[0], random)
    rotor = tuple(wandering(w, levels[1], times[1], random) for w in record.rotor)
    began = time.process_time()
    found = fitting.fit("reduced", replace(record, casing=casing, rotor=rotor, digest=""))
    pulls = {
        k: (found.estimates[k].value - v) / found.estimates[k].stderr
        for k, v in REDUCED.items()
        if not found.estimates[k].at_bound
    }
    answer = fitting.diagnose(found)
    data = found.problem.data[0]
    return {
        "seed": seed,
        "sigma": levels.tolist(),
        "time": times.tolist(),
        "found": [[n.sigma, n.sigma_u, n.time] for n in (data.angle_noise, data.rotor_angle_noise)],
        "n_eff": data.n_effective,
        "pulls": pulls,
        "fit": found.verdict,
        "verdict": answer.verdict,
        "named": [c.effect.name for c in answer.candidates[:1]] if answer.verdict != "adequate" else [],
        "seconds": time.process_time() - began,
    }


def share(hits: int, n: int) -> str:
    """Return a share with its 95 % interval (Clopper-Pearson)."""
    low = float(beta.ppf(0.025, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, n - hits)) if hits < n else 1.0
    return f"{100 * hits / n:.0f} % ({hits} of {n}; {100 * low:.0f}-{100 * high:.0f} %)"


def table(lines: list[dict[str, Any]]) -> str:
    """Return coverage, rms pull and false alarms."""
    z = {k: np.array([x["pulls"][k] for x in lines if k in x["pulls"]]) for k in REDUCED}
    rows = ["| parameter | 95 % intervals that cover | rms of (value - truth) / u |", "|---|---|---|"]
    rows += [
        f"| `{k}` | {share(int(np.sum(np.abs(v) < 1.96)), len(v))} | {np.sqrt(np.mean(v**2)):.2f} |"
        for k, v in z.items()
    ]
    every = np.concatenate(list(z.values()))
    rows.append(
        f"| all | {share(int(np.sum(np.abs(every) < 1.96)), len(every))} | {np.sqrt(np.mean(every**2)):.2f} |"
    )
    alarms = [x for x in lines if x["verdict"] != "adequate"]
    told = [sum(x["found"][i][0] > 0 for x in lines) for i in (0, 1)]
    failed = sum(x["fit"] != "adequate" for x in lines)
    sentences = (
        f"False alarms of `diagnose` where nothing is hidden: {share(len(alarms), len(lines))}.",
        f"Fits that are not adequate: {share(failed, len(lines))}.",
        f"Angle noise found in the casing's camera: {share(told[0], len(lines))}.",
        f"Angle noise found in the rotor's camera: {share(told[1], len(lines))}.",
        "The pulls of one recording are correlated: the interval of the row `all` is too narrow.",
    )
    rows += [line for sentence in sentences for line in ("", sentence)]
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--start", type=int, default=0, help="first seed (0)")
    parser.add_argument("--count", type=int, default=40, help="number of recordings (40)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (1)")
    parser.add_argument("-o", "--output", type=Path, default=LINES, help="lines of results")
    options = parser.parse_args()
    output: Path = options.output
    lines = [json.loads(x) for x in output.read_text().splitlines()] if output.exists() else []
    seeds = [
        s for s in range(options.start, options.start + options.count) if s not in {x["seed"] for x in lines}
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        for waiting in as_completed([pool.submit(run, s) for s in seeds]):
            line = waiting.result()
            lines.append(line)
            output.write_text(
                "".join(json.dumps(x) + "\n" for x in sorted(lines, key=lambda x: int(x["seed"])))
            )
            print(f"{line['seed']}: {line['verdict']} {line['named']} {line['seconds']:.0f} s", flush=True)
    if output != LINES:
        print(table(lines))
        return
    made = f"{len(lines)} recordings, made by `python benchmarks/fitting/angle_noise.py`."
    TABLE.write_text(f"# Correlated angle noise\n\n{made}\n\n{table(lines)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
