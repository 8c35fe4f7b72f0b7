"""From every corner of a factor of two: 64 starts in each of three recordings, 192 in all.

    python benchmarks/fitting/convergence.py

A start has each of a2, b1, b2, d, f, g halved or doubled (g kept in its range of 0.3 to 1.4); the start speeds come
from the program. It counts as converged if the fit says so, and its deviance is no more than 0.01 above that of a fit
that starts by itself, its parameters within 0.05 of their errors.
"""

from __future__ import annotations

import itertools
import os
import time

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from recordings import RUNS, recording, truth

from fitting.dynamics._model import Model
from fitting.effects._library import REDUCED
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit


def corners(true: dict[str, float]):
    names = [n for n in true if not n.startswith("initial.")]
    for factors in itertools.product((0.5, 2.0), repeat=len(names)):
        start = {n: true[n] * f for n, f in zip(names, factors, strict=True)}
        start["bearing.power.g"] = float(np.clip(start["bearing.power.g"], 0.3, 1.4))
        yield start


def converge(name: str, *, every: int = 1) -> dict[str, float]:
    """Return how many of the 64 starts of a recording end in the lowest deviance, and the time a fit takes."""
    data = CaseData.of(recording(name))
    base = fit(Model.of(REDUCED), [data])
    ends, seconds = [], []
    for start in itertools.islice(corners(truth(name)), 0, None, every):
        began = time.perf_counter()
        found = fit(Model.of(REDUCED), [data], start=start)
        seconds.append(time.perf_counter() - began)
        off = max(abs(found.estimates[k].value - e.value) / e.stderr for k, e in base.estimates.items())
        ends.append((found.verdict, found.deviance - base.deviance, off))
    right = [v == "adequate" and d < 0.01 and off < 0.05 for v, d, off in ends]
    worst = [e for e, ok in zip(ends, right, strict=True) if not ok]
    return {
        "recording": name,
        "starts": len(ends),
        "converged": int(sum(right)),
        "median_s": float(np.median(seconds)),
        "max_s": float(max(seconds)),
        "misses": worst,
    }


def main() -> None:
    for name in RUNS:
        print(converge(name), flush=True)


if __name__ == "__main__":
    main()
