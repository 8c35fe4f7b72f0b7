"""A joint fit of many recordings, and the same fit again and again: does the memory grow?

    python benchmarks/robustness/soak.py --count 100 --again 5

The recordings are simulated, each with start speeds and noise of its own; the memory is what the process holds at
the end of each fit [MB].
"""

import argparse
import gc
import os
import time
from pathlib import Path

from common import report

from fitting.dynamics._model import Model
from fitting.effects._library import REDUCED, typical_of_model
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._simulation import Experiment, simulate


def recordings(count):
    """Simulate so many short runs of one gyroscope."""
    model = Model.of(REDUCED)
    numbers = typical_of_model(
        model.effects, 0.01, duration=20.0, speeds={"omega_r": 500.0, "omega_c": 100.0}
    )
    for i in range(count):
        experiment = Experiment(
            omega_rotor=700.0 + 3.0 * i,
            omega_casing=5.0 + 0.1 * i,
            duration=20.0,
            casing_fps=100.0,
            rotor_fps=300.0,
            windows=(1.0, 8.0, 16.0),
            window_length=1.0,
        )
        inertias = {"inertia_rotor": 5.54e-5, "inertia_casing": 2.06e-5}
        yield CaseData.of(simulate(model, numbers, experiment, **inertias, seed=i, label=f"run{i}"))


def resident():
    """Return the memory that this process holds [MB]."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)


def main():
    """Run and report."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--again", type=int, default=5)
    asked = parser.parse_args()
    began = time.monotonic()
    data = list(recordings(asked.count))
    memory, seconds = [resident()], []
    for _ in range(asked.again):
        start = time.process_time()
        found = fit(Model.of(REDUCED), data)
        seconds.append(round(time.process_time() - start, 1))
        verdict, free = found.verdict, len(found.problem.layout.names)
        del found
        memory.append(resident())
    single = [resident()]
    for _ in range(20):
        fit(Model.of(REDUCED), data[:1])
    single.append(resident())
    report(
        "soak of joint fits",
        began,
        recordings=asked.count,
        free_parameters=free,
        verdict=verdict,
        cpu_s=seconds,
        memory_mb=memory,
        memory_mb_around_20_single_fits=single,
    )


if __name__ == "__main__":
    main()
