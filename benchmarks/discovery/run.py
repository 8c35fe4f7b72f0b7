"""How often the missing effect is found, and how often one is named where nothing is missing.

    python benchmarks/discovery/run.py --seeds 10 --jobs 2 --limit-seconds 3600
    python benchmarks/discovery/table.py

Each line of the output is one run; a run that has its line is not run again, so that the plan can be stopped at
any time and taken up later. `--parts` and `--only` choose among the runs. A finished plan is kept compressed:
`gzip -9 benchmarks/discovery/results.jsonl`; both spellings are read.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

from answer import answer
from lines import RESULTS, append, read_lines
from plan import PARTS, Planned, plan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="how many seeds (10)")
    parser.add_argument("--first-seed", type=int, default=0, help="leave out the seeds before this one (0)")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--only", nargs="+", default=[], help="words that must all stand in the key of a run")
    parser.add_argument("--jobs", type=int, default=1, help="processes (1)")
    parser.add_argument(
        "--limit-seconds", type=float, default=float("inf"), help="begin no run after this time"
    )
    parser.add_argument(
        "--again", action="store_true", help="run also what has its line; the newest line counts"
    )
    parser.add_argument("--list", action="store_true", help="only print the keys of what would run")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    done = (
        set()
        if options.again
        else {line["key"] for line in read_lines(options.output) if "error" not in line}
    )
    runs = [
        r
        for r in plan(options.seeds, tuple(options.parts))
        if r.key not in done
        and r.seed_of_plan >= options.first_seed
        and all(w in r.key for w in options.only)
    ]
    if options.list:
        print(*(r.key for r in runs), sep="\n")
        return
    began = time.monotonic()
    for i, line in enumerate(work(runs, options.jobs, options.limit_seconds), 1):
        append(options.output, line)
        said = line.get("error") or f"{line['verdict']}: {', '.join(line['named'][:4]) or '-'}"
        print(f"{i}/{len(runs)} {time.monotonic() - began:6.0f} s  {line['key']}  {said}", flush=True)


def work(
    runs: Iterable[Planned], jobs: int, limit: float, ask: Any = answer, pool: Any = ProcessPoolExecutor
) -> Iterator[dict[str, Any]]:
    """Yield a line for each run, in the order in which they end; begin none after `limit` seconds."""
    end = time.monotonic() + limit
    left = iter(runs)
    with pool(jobs) as workers:
        waiting = {workers.submit(partial(guarded, ask), r) for r in islice(left, jobs)}
        while waiting:
            ended, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            if time.monotonic() < end:
                waiting |= {workers.submit(partial(guarded, ask), r) for r in islice(left, len(ended))}
            yield from (f.result() for f in ended)


def guarded(ask: Any, run: Planned) -> dict[str, Any]:
    """Return the line of a run; one that fails says so in its line, and is tried again the next time."""
    try:
        return dict(ask(run))
    except Exception as fault:  # whatever went wrong belongs into the table
        return {"key": run.key, "error": f"{type(fault).__name__}: {fault}"}


if __name__ == "__main__":
    main()
