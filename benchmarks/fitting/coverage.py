"""How often 95 % intervals hold the truth: recordings with angle noise, random torques and an offset centre.

    python benchmarks/fitting/coverage.py --recordings 200 [--data velocity --torque 0]

Each recording has white angle noise of 1e-3 rad, an Ornstein-Uhlenbeck torque of 1e-7 N m rms and 1 s on the casing
and one in the bearing, and a centre offset of 2e-3 rad of random phase. They come from the tests' own oracle.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
import recordings  # noqa: F401  (finds the oracle)
import twobody

from fitting.dynamics._model import Model
from fitting.effects._library import REDUCED
from fitting.inference._fit import fit
from fitting.inference._record import make_record
from fitting.study._preparation import prepared

TRUTH = twobody.truth()
_NORMAL_95 = 1.959964


def noisy(seed: int, torque: float = 1e-7):
    """Return one recording with all of the noise, and its true motion."""
    motion = twobody.simulate(ou=torque, ou_time=1.0, seed=seed)
    phase = np.random.default_rng([seed, 5]).uniform(0, 2 * np.pi)
    cameras = twobody.Cameras(sigma=1e-3, centre=(2e-3, phase))
    return make_record(**twobody.film(motion, seed=seed, cameras=cameras)), motion


def pulls(
    seed: int, data: str | None = None, rotor: str = "windows", torque: float = 1e-7
) -> dict[str, float | str]:
    """Fit one recording; return (estimate - truth) / error of every parameter, and the verdict."""
    record, motion = noisy(seed, torque)
    record = prepared(record, data, rotor)
    result = fit(Model.of(REDUCED), [record])
    # smoothed speeds begin later than the run did
    speeds = [float(motion.at(np.array(record.span[:1]), body)[1][0]) for body in (0, 1)]
    true = TRUTH | dict(zip([k for k in TRUTH if "initial" in k], speeds, strict=True))
    table = {k: (e.value - true[k]) / e.stderr for k, e in result.estimates.items() if not e.at_bound}
    return {"seed": seed, "verdict": result.verdict, "torque_noise": result.noise[0].pure} | table


def summary(rows: list[dict]) -> list[str]:
    """Return coverage, spread and mean of the pulls of every parameter as lines of a table."""
    lines = ["| parameter | n | coverage of 95 % | spread of the pulls | mean |", "|---|---|---|---|---|"]
    every = []
    for key in TRUTH:
        z = np.array([r[key] for r in rows if key in r and np.isfinite(r[key])])
        every.append(z)
        inside = np.mean(np.abs(z) < _NORMAL_95)
        lines.append(f"| {key} | {len(z)} | {100 * inside:.1f} % | {np.std(z):.2f} | {np.mean(z):+.2f} |")
    z = np.concatenate(every)
    lines.append(f"| all | {len(z)} | {100 * np.mean(np.abs(z) < _NORMAL_95):.1f} % | {np.std(z):.2f} | |")
    lines.append(
        f"verdicts: {sum(r['verdict'] == 'no_lack_of_fit' for r in rows)} of {len(rows)} without lack of fit"
    )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--data", choices=("angle", "velocity"))
    parser.add_argument("--rotor", choices=("windows", "generated"), default="windows")
    parser.add_argument("--torque", type=float, default=1e-7, help="rms of the random torque [N m]")
    parser.add_argument("-o", "--output", type=Path, default=Path("coverage.jsonl"))
    options = parser.parse_args()
    rows = []
    with options.output.open("a") as stream:
        for seed in range(options.first, options.first + options.recordings):
            rows.append(pulls(seed, options.data, options.rotor, options.torque))
            stream.write(json.dumps(rows[-1]) + "\n")
            stream.flush()
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
