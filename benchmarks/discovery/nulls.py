"""False alarms of `fit` and `diagnose` where nothing is hidden, over random torques and correlated errors of the angle.

    python benchmarks/discovery/nulls.py -n 200 -o benchmarks/discovery/nulls.jsonl
    python benchmarks/discovery/nulls.py --table

Each recording is drawn by lot: three of four of the light gyroscope of experiment.py, the others of the paper's; a
random torque (Ornstein-Uhlenbeck) of 1e-8 to 3e-7 N m with a correlation time of 0.1 to 10 s; in every second
recording an error of the casing's angle of 0.2 to 1 mrad with a correlation time of 0.05 to 3 s, about which the
recording says nothing. The torque is one of the recording: it may be far above or below what a fit can notice.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np
from answer import commit
from experiment import CASES, LIGHT, Hidden, record
from lines import append, read_lines
from scipy.signal import lfilter
from scipy.stats import binomtest
from tabular import table

from fitting import REDUCED, Model, diagnose, fit, make_record

RESULTS = Path(__file__).parent / "nulls.jsonl"
TORQUE = 1e-8, 3e-7  # N m
TORQUE_TIME = 0.1, 10.0  # s
ANGLE = 2e-4, 1e-3  # rad
ANGLE_TIME = 0.05, 3.0  # s


def between(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(*np.log(limits))))


def correlated(rng: np.random.Generator, n: int, step: float, rms: float, duration: float) -> np.ndarray:
    """Return a stationary first-order process, exponentially correlated over `duration`."""
    decay = np.exp(-step / duration)
    white = rms * np.sqrt(1 - decay**2) * rng.standard_normal(n)
    white[0] = rms * rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -decay], white))


def answered(number: int) -> dict[str, Any]:
    """Make one recording, and return what `fit` and `diagnose` say about it."""
    rng = np.random.default_rng([21, number])
    light = number % 4 != 3
    case = LIGHT | {"span": float(rng.uniform(24, 40))} if light else CASES[number // 4 % 2]
    torque, torque_time = between(rng, TORQUE), between(rng, TORQUE_TIME)
    drawn = record(case, Hidden(), torque_noise=torque, torque_time=torque_time, rng=rng, label="run")
    angle = angle_time = 0.0
    if number % 2:
        angle, angle_time = between(rng, ANGLE), between(rng, ANGLE_TIME)
        t, psi, sigma = drawn["casing"]
        drawn["casing"] = (t, psi + correlated(rng, len(t), t[1] - t[0], angle, angle_time), sigma)
    began = time.process_time()
    base = fit(Model.of(REDUCED), [make_record(**drawn)])
    found = diagnose(base)
    best = found.candidates[0] if found.verdict == "missing_effect" else None
    return {
        "gyroscope": "light" if light else "paper",
        "torque": torque,
        "torque_time": torque_time,
        "angle": angle,
        "angle_time": angle_time,
        "fit": base.verdict,
        "verdict": found.verdict,
        "named": best.effect.name if best is not None else "",
        "kind": best.effect.kind if best is not None else "",
        "p": best.p_value if best is not None else None,
        "seconds": time.process_time() - began,
        "commit": commit(),
    }


def report(lines: list[dict[str, Any]]) -> str:
    """Return the rates of false alarms, of all recordings and of parts of them."""
    parts = {
        "all": lines,
        "light gyroscope": [x for x in lines if x["gyroscope"] == "light"],
        "paper's gyroscope": [x for x in lines if x["gyroscope"] == "paper"],
        "correlation time of the torque below 1 s": [x for x in lines if x["torque_time"] < 1],
        "correlation time of the torque above 1 s": [x for x in lines if x["torque_time"] >= 1],
        "correlated error of the angle": [x for x in lines if x["angle"]],
    }
    rows = []
    for words, some in parts.items():
        named = sum(x["verdict"] == "missing_effect" for x in some)
        unexplained = sum(x["verdict"] == "unexplained" for x in some)
        alarms, count = named + unexplained, max(len(some), 1)
        low, high = binomtest(alarms, count).proportion_ci()
        undecided = sum(x["verdict"] == "undecided" for x in some)
        contradict = sum(x["verdict"] == "missing_effect" and x["fit"] == "no_lack_of_fit" for x in some)
        rate = f"{100 * alarms / count:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
        lack = sum(x["fit"] == "lack_of_fit" for x in some)
        rows.append([words, len(some), named, unexplained, rate, undecided, lack, contradict])
    head = [
        "recordings", "number", "an effect named", "unexplained", "false alarms (95 % interval)", "undecided",
        "lack of fit in `fit`", "named, but adequate in `fit`",
    ]  # fmt: skip
    alarms = [
        f"- {x['gyroscope']}, torque {x['torque']:.1e} N m over {x['torque_time']:.2g} s, angle {1e3 * x['angle']:.2g} "
        f"mrad over {x['angle_time']:.2g} s: {x['verdict'].replace('_', ' ')} {x['named']}".rstrip()
        for x in lines
        if x["verdict"] in {"missing_effect", "unexplained"}
    ]
    return table(head, rows) + "\n\n" + "\n".join(alarms)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-n", type=int, default=200, help="number of recordings (200)")
    parser.add_argument("--table", action="store_true", help="only print the table")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    done = {x["key"] for x in read_lines(options.output)}
    for number in range(0 if options.table else options.n):
        if str(number) not in done:
            append(options.output, {"key": str(number), **answered(number)})
    print(report(read_lines(options.output)))


if __name__ == "__main__":
    main()
