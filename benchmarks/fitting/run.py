"""Speed and accuracy of the fits, measured in one go.

    python benchmarks/fitting/run.py -o benchmarks/fitting/results.md [--only reduced shell scan ...]

Times are CPU seconds of one core, minima over repeats; where two ways are compared their repeats alternate, so that
what else the machine does falls on both. Wall seconds stand beside them.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from baseline import SCALE, Baseline, straight
from recordings import RUNS, recording, truth

from fitting.dynamics._model import Model
from fitting.effects._library import LIBRARY, REDUCED
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit

ROOT = Path(__file__).parents[2]


def timed(work):
    """Return the result, CPU seconds and wall seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, time.process_time() - cpu, time.perf_counter() - wall


def best(work, repeats: int = 3):
    runs = [timed(work) for _ in range(repeats)]
    return runs[0][0], min(r[1] for r in runs), min(r[2] for r in runs)


def factor_two(name: str, seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    start = {k: v * 2.0 ** rng.choice([-1, 1]) for k, v in truth(name).items() if "initial" not in k}
    start["bearing.power.g"] = 1.2
    return start


def reduced(repeats: int) -> list[str]:
    """The reduced model on a full recording, beside Radau + SciPy and lmfit."""
    record = recording("glass")
    count = len(record.casing) + sum(len(w) for w in record.rotor)
    start = factor_two("glass", 0)
    d, f, g = (start[f"bearing.{k}"] for k in ("linear.d", "power.f", "power.g"))
    plain = [start["rotor.air.quadratic.a2"], start["touchpoint.constant.b1"], start["casing.air.linear.b2"]]
    begin = np.array([*plain, *straight(d, f, g), g, 870.0, 6.0]) / SCALE
    ours, scipy, lm = [], [], []
    for _ in range(repeats):
        ours.append(timed(lambda: fit(Model.of(REDUCED), [CaseData.of(record)], start=start)))
        scipy.append(timed(lambda: Baseline(record).scipy(begin)))
        lm.append(timed(lambda: Baseline(record).lmfit(begin)))
        ours.append(timed(lambda: fit(Model.of(REDUCED), [CaseData.of(record)], start=start)))
    found = ours[0][0]
    x, chi2 = scipy[0][0]
    y, lm_chi2 = lm[0][0]
    value = {k: e.value for k, e in found.estimates.items()}
    d, f, g = (value[f"bearing.{k}"] for k in ("linear.d", "power.f", "power.g"))
    mine = np.array([
        value["rotor.air.quadratic.a2"], value["touchpoint.constant.b1"], value["casing.air.linear.b2"],
        *straight(d, f, g), g, value["initial.omega_r@glass"], value["initial.omega_c@glass"],
    ])  # fmt: skip
    errors = {k: e.stderr for k, e in found.estimates.items()}
    linear = ("rotor.air.quadratic.a2", "touchpoint.constant.b1", "casing.air.linear.b2")
    sigma = np.array([*(errors[k] for k in linear), np.inf, np.inf, errors["bearing.power.g"],
                      errors["initial.omega_r@glass"], errors["initial.omega_c@glass"]])  # fmt: skip
    there = x if chi2 <= lm_chi2 + 0.01 else y
    # chi2 of everybody's parameters by one integration that is sharper than all of theirs
    judge = Baseline(record, 1e-12, "DOP853")
    ours_there, chi2, lm_chi2 = (float(np.sum(judge.residuals(p / SCALE) ** 2)) for p in (mine, x, y))
    cpu = [min(r[1] for r in runs) for runs in (ours, scipy, lm)]
    wall = [min(r[2] for r in runs) for runs in (ours, scipy, lm)]
    return [
        f"Reduced model, {count} points, start a factor 2 off, data preparation and noise estimate included.",
        "",
        "| way | CPU s | wall s | times slower | chi2 over the best |",
        "|---|---|---|---|---|",
        f"| gyrotrack | {cpu[0]:.3f} | {wall[0]:.3f} | 1 | {ours_there - min(ours_there, chi2, lm_chi2):.4f} |",
        (
            f"| Radau, SciPy least_squares | {cpu[1]:.1f} | {wall[1]:.1f} | {cpu[1] / cpu[0]:.0f} |"
            f" {chi2 - min(ours_there, chi2, lm_chi2):.4f} |"
        ),
        (
            f"| Radau, lmfit | {cpu[2]:.1f} | {wall[2]:.1f} | {cpu[2] / cpu[0]:.0f} |"
            f" {lm_chi2 - min(ours_there, chi2, lm_chi2):.4f} |"
        ),
        "",
        f"Largest difference of a parameter: {np.abs((mine - there) / sigma).max():.4f} of its standard error.",
    ]


def paper(repeats: int) -> list[str]:
    """Radau and SciPy in the paper's own variables, from the same start."""
    record = recording("glass")
    start = factor_two("glass", 0)
    begin = np.array([*(start[k] for k in list(start) if "initial" not in k), 870.0, 6.0])
    (x, chi2, message), cpu, wall = timed(lambda: Baseline(record).paper(begin))
    best = float(np.sum(Baseline(record).residuals(_true("glass")) ** 2))
    return [
        (
            f"Radau, SciPy least_squares in d, f, g: {cpu:.1f} CPU s, {wall:.1f} wall s, chi2 {chi2 - best:.4g} above "
            f"that of the truth, at d {x[3]:.3g}, f {x[4]:.3g}, g {x[5]:.4g} ({message})"
        )
    ]


def _true(name: str) -> np.ndarray:
    value = truth(name)
    d, f, g = (value[f"bearing.{k}"] for k in ("linear.d", "power.f", "power.g"))
    names = ("rotor.air.quadratic.a2", "touchpoint.constant.b1", "casing.air.linear.b2")
    speeds = [v for k, v in value.items() if "initial" in k]
    return np.array([*(value[k] for k in names), *straight(d, f, g), g, *speeds]) / SCALE


def core(repeats: int) -> list[str]:
    """The least squares alone: known white noise, as the plain way has it."""
    from fitting.inference._optimisation import search
    from fitting.inference._parameters import ParameterLayout
    from fitting.inference._problem import Problem

    record = recording("glass")
    start = factor_two("glass", 0) | {"initial.omega_r@glass": 870.0, "initial.omega_c@glass": 6.0}

    def work():
        data = CaseData.of(record)
        problem = Problem.of(ParameterLayout.of(Model.of(REDUCED), [record]), [data])
        return search(problem, np.array([start[n] for n in problem.layout.names]))

    found, cpu, wall = best(work, repeats)
    minimum = found.minimum
    return [
        (
            f"The same least squares with known white noise, compression included: {cpu:.3f} CPU s, {wall:.3f} wall s, "
            f"{minimum.iterations} iterations, converged: {minimum.converged}."
        )
    ]


def shell(repeats: int) -> list[str]:
    """From the shell to the printed result."""
    import h5py  # noqa: F401

    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder) / "case.h5"
        gyrotrack = Path(sys.executable).with_name("gyrotrack")
        subprocess.run([gyrotrack, "simulate", "-o", case, "-q"], check=True, capture_output=True)

        def work():
            (Path(folder) / "case.fits.json").unlink(missing_ok=True)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run(
                [gyrotrack, "fit", case, "--model", "reduced", "-q"], check=True, capture_output=True
            )
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

        runs = [timed(work) for _ in range(repeats + 2)]
    return [
        (
            f"`gyrotrack fit case.h5` from the shell to the printed result: {min(r[0] for r in runs):.2f} CPU s, "
            f"{min(r[2] for r in runs):.2f} wall s."
        )
    ]


def scan(repeats: int) -> list[str]:
    """The paper's tables of two cases."""
    from fitting.paper._scan import scan as run_scan

    data = [recording(n) for n in ("glass", "steel")]
    _, cpu, wall = best(lambda: run_scan([CaseData.of(r) for r in data]), repeats)
    return [f"The paper's scans and fits of two full recordings: {cpu:.2f} CPU s, {wall:.2f} wall s."]


def candidates(repeats: int) -> list[str]:
    """Twenty-five candidates refitted on top of the base."""
    data = CaseData.of(recording("glass"))
    base = fit(Model.of(REDUCED), [data])
    start = {k: e.value for k, e in base.estimates.items()}
    names = [n for n, e in LIBRARY.items() if n not in REDUCED and e.mechanical and e.searched][:25]
    names += [n for n, e in LIBRARY.items() if n not in REDUCED and not e.mechanical][: 25 - len(names)]

    def work():
        for n in names:
            effect = LIBRARY[n]
            begin = {f"{n}.{p.symbol}": p.start for p in effect.parameters if p.role != "fixed"}
            begin |= {
                f"{n}.{p.symbol}": (p.grid[len(p.grid) // 2] * (200.0 if p.relative else 1.0))
                for p in effect.parameters
                if p.role == "shape" and p.grid
            }
            model = Model.of((*REDUCED, n))
            fit(model, [data], start=start | begin, noise=base.noise, quick=True)

    _, cpu, wall = best(work, repeats)
    return [
        f"{len(names)} candidates refitted on top of the reduced model: {cpu:.2f} CPU s, {wall:.2f} wall s."
    ]


def ripple(repeats: int) -> list[str]:
    """A model of twelve parameters with laws that follow the angle, on the full grid of samples."""
    data = CaseData.of(recording("glass"))
    names = (*REDUCED, "casing.unbalance", "casing.asymmetry")
    found, cpu, wall = best(lambda: fit(Model.of(names), [data]), repeats)
    count = len(found.theta)
    return [
        f"{count} parameters, two laws that follow the angle, full grid: {cpu:.2f} CPU s, {wall:.2f} wall s."
    ]


def scaling(repeats: int) -> list[str]:
    """Cost against samples, and against recordings fitted jointly, each in a process of its own."""
    lines = ["| recordings | samples | CPU s | CPU s per recording | memory [MB] |", "|---|---|---|---|---|"]
    for count, rate in ((1, 130), (1, 260), (1, 520), (1, 1040), (3, 260), (10, 260), (30, 260), (100, 260)):
        here = str(Path(__file__).parent)
        script = f"import sys; sys.path.insert(0, {here!r}); import run; run.joint({count}, {rate})"
        done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
        samples, cpu, memory = done.stdout.split()[-3:]
        lines.append(
            f"| {count} | {samples} | {float(cpu):.2f} | {float(cpu) / count:.2f} | {float(memory):.0f} |"
        )
    return lines


def joint(count: int, rate: float) -> None:
    """Fit some recordings together; print samples, CPU seconds of preparation and fit, and peak memory [MB]."""
    from dataclasses import replace

    names = [list(RUNS)[i % len(RUNS)] for i in range(count)]
    seen = {n: recording(n, 0, rate) for n in set(names)}
    rng = np.random.default_rng(0)
    records = []
    for i, n in enumerate(names):
        r = seen[n]
        noise = 1e-3 * rng.standard_normal(len(r.casing)) * (i >= len(RUNS))
        records.append(
            replace(r, label=f"r{i}", casing=replace(r.casing, value=r.casing.value + noise), digest="")
        )
    samples = sum(len(r.casing) + sum(len(w) for w in r.rotor) for r in records)
    _, cpu, _ = timed(lambda: fit(Model.of(REDUCED), [CaseData.of(r) for r in records]))
    print(samples, cpu, own_peak())


def own_peak() -> float:
    """Return the peak memory [MB] of this process; `ru_maxrss` would start at the parent's."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def nist(repeats: int) -> list[str]:
    """The NIST reference problems of nonlinear regression, from both starts."""
    sys.path[:0] = [str(ROOT / "tests" / "fitting"), str(ROOT / "tests" / "fitting" / "inference")]
    from nist import PROBLEMS
    from test_optimisation import TRAPS, problem_of

    from fitting.inference._optimisation import minimise
    from fitting.inference._problem import covariance_of

    digits, errors, runs = [], [], 0
    for name, certified in PROBLEMS.items():
        for k in (0, 1):
            if (name, k) in TRAPS:
                continue
            free = np.full(len(certified.values), np.inf)
            start = np.array(certified.starts[k], dtype=float)
            m = minimise(
                problem_of(certified), start, -free, free, tolerance=1e-14, absolute=1e-14, max_iterations=500
            )
            off = np.abs(m.x / certified.values - 1).max()
            spread = np.sqrt(np.diag(covariance_of(m.jacobian, np.ones(len(m.x), dtype=bool))))
            digits.append(-np.log10(max(off, 1e-16)))
            errors.append(-np.log10(max(np.abs(spread / certified.errors - 1).max(), 1e-16)))
            runs += 1
    return [
        (
            f"NIST StRD: {len(PROBLEMS)} problems, {runs} of {2 * len(PROBLEMS)} starts (BoxBOD's first is a trap): "
            f"parameters to {min(digits):.1f} digits or better, standard errors to {min(errors):.1f}."
        )
    ]


PARTS = {f.__name__: f for f in (reduced, paper, core, shell, scan, candidates, ripple, scaling, nist)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", choices=list(PARTS), default=list(PARTS))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    commit = subprocess.run(
        ["git", "-C", ROOT, "rev-parse", "--short", "HEAD"], check=True, capture_output=True, text=True
    ).stdout.strip()
    lines = ["# Fitting, measured", "", f"Commit {commit}, {os.cpu_count()} cores, one thread.", ""]
    for name in options.only:
        part = PARTS[name](options.repeats)
        print("\n".join(part), flush=True)
        lines += [*part, ""]
        if options.output:
            options.output.write_text("\n".join(lines))


if __name__ == "__main__":
    main()
