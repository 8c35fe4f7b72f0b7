"""Is the uncertainty of a clip's start the size of its error? Runs of two cameras with known starts and clocks.

    python benchmarks/tracking/sync.py --runs 400 --found found.jsonl -o benchmarks/tracking/sync.md

The runs are those of the tests (`tests/gyrotrack/synchronisation/conftest.py`): two equations of motion
integrated by SciPy, seen by two cameras with noise of 1 mrad and harmonics of 2 mrad; clips of 3 s at 1000
frames/s start anywhere in the first 80 s of a record of 135 s at 260 frames/s. The clocks' rates differ by 1e-4
(one sigma), the directions by anything. z is error over uncertainty. A start is lost if it is off by more than
3 ms and not marked as ambiguous.

The clips of a run share its clock and perhaps its direction, so they err together: what counts for the error of a
share is how it varies from run to run. With p_r the share in run r of n runs it is std(p_r) / sqrt(n).
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import sys
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from speed import commit

from gyrotrack.synchronisation._decision import match_clips

TURN = 2 * np.pi


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=200, help="runs in each row, at least")
    parser.add_argument(
        "--found", type=Path, help="keeps what was found (JSON lines); runs in it are not done again"
    )
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    scene = runs()
    motion = scene.integrate()
    kept = Kept(args.found)
    columns = "clips of a run | camera in between | runs | clips | within 1 sigma | spread of z | largest"
    lines = [
        "# Claimed and true uncertainty of the start",
        "",
        f"Commit {commit()}. z is error over uncertainty. The error of a share is that between runs, whose clips err",
        "together; with independent clips it would be the one in brackets.",
        "",
        f"| {columns} | rate within 1 sigma | ambiguous | lost |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for count, still in ((1, True), (2, True), (3, True), (3, False)):
        found = []
        for seed in sorted({*range(args.runs), *kept.seeds(count, still)}):
            key = f"{count} {still} {seed}"
            if key not in kept.runs:
                kept.add(key, one_run(scene, motion, count, 1000 * count + seed, still=still))
            found.append(kept.runs[key])
        lines.append(row(count, still, np.array(found)))
        print(lines[-1], flush=True)
    if args.output:
        args.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


class Kept:
    """What was found in each run, in memory and, if asked for, in a file."""

    def __init__(self, path: Path | None) -> None:
        self.path, self.runs = path, {}
        if path is not None and path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                self.runs.update(json.loads(line))

    def seeds(self, count: int, still: bool) -> list[int]:  # noqa: FBT001
        """Return the seeds of the runs of a kind that are kept."""
        return [int(key.split()[2]) for key in self.runs if key.startswith(f"{count} {still} ")]

    def add(self, key: str, found: list[tuple]) -> None:
        self.runs[key] = found
        if self.path is not None:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({key: found}) + "\n")


def runs():
    path = Path(__file__).parents[2] / "tests" / "gyrotrack" / "synchronisation" / "conftest.py"
    spec = importlib.util.spec_from_file_location("runs", path)
    sys.modules["runs"] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def one_run(scene, motion, count: int, seed: int, *, still: bool) -> list[tuple]:
    """Return (z of the start, z of the rate, ambiguous, lost) of every clip of a run."""
    rng = np.random.default_rng(seed)
    run = scene.Run(motion, rng)
    starts = np.sort(rng.uniform(0.5, 80, count))
    rate = 1 + 1e-4 * rng.normal()
    offsets = [rng.uniform(0, TURN)] * count if still else list(rng.uniform(0, TURN, count))
    clips = run.clips(starts, rate=rate, offsets=offsets)
    matches = match_clips(run.casing(), clips, [f"clip {k}" for k in range(count)], [0] * count)
    return [
        (
            (m.start.offset - start) / m.offset_sigma,
            (m.start.eps - (rate - 1)) / m.rate_sigma,
            bool(m.ambiguous),
            bool(abs(m.start.offset - start) > 3e-3 and not m.ambiguous),
        )
        for m, start in zip(matches, starts, strict=True)
    ]


def row(count: int, still: bool, found: np.ndarray) -> str:  # noqa: FBT001
    z, rate, ambiguous, lost = (found[..., k] for k in range(4))  # each (runs, clips)
    return (
        f"| {count} | {'stands still' if still else 'is turned'} | {len(z)} | {z.size} | {share(np.abs(z) < 1)} "
        f"| {np.sqrt((z**2).mean()):.2f} | {np.abs(z).max():.1f} | {share(np.abs(rate) < 1)} "
        f"| {int(ambiguous.sum())} | {int(lost.sum())} |"
    )


def share(inside: np.ndarray) -> str:
    """Return the share of (runs, clips) that is true, with its error between runs and that of independent clips."""
    mean, runs = inside.mean(), inside.mean(axis=1)
    between = runs.std(ddof=1) / np.sqrt(len(runs)) if len(runs) > 1 else np.nan
    return f"{mean:.3f} ± {between:.3f} ({np.sqrt(mean * (1 - mean) / inside.size):.3f})"


if __name__ == "__main__":
    main()
