"""The lines of the benchmark: JSON, one a run, plain while it grows and compressed when it is kept."""

from __future__ import annotations

import argparse
import gzip
import json
import math
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results.jsonl"
_DIGITS = 4


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Return the newest line of each run, from `path` and from its compressed twin; a torn line is left out."""
    packed = path.with_name(path.name + ".gz")
    text = gzip.decompress(packed.read_bytes()).decode() if packed.is_file() else ""
    text += path.read_text(encoding="utf-8") if path.is_file() else ""
    found: dict[str, dict[str, Any]] = {}
    for row in text.splitlines():
        try:
            line = json.loads(row)
            found[line["key"]] = line
        except (ValueError, KeyError, TypeError):
            continue
    return list(found.values())


def append(path: Path, line: dict[str, Any]) -> None:
    """Add a line; a line that a kill tore off is ended first."""
    with path.open("ab+") as stream:
        stream.seek(0, 2)
        if stream.tell():
            stream.seek(-1, 2)
            if stream.read(1) != b"\n":
                stream.write(b"\n")
        stream.write(json.dumps(shortened(line), separators=(",", ":")).encode() + b"\n")


def shortened(value: Any) -> Any:
    """Return the same with numbers of four digits, and None for what is not finite."""
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {k: shortened(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [shortened(v) for v in value]
    return value


def run_each(
    words: str,
    results: Path,
    kinds: Iterable[str],
    answer: Callable[[str, int, Path], dict[str, Any]],
    report: Callable[[list[dict[str, Any]]], str],
) -> None:
    """Run a benchmark of numbered runs of each kind from its command line, and print its table.

    `answer` makes the line of a kind and a number in an empty folder; runs with a line are not repeated. `words`
    describe the benchmark.
    """
    parser = argparse.ArgumentParser(description=words, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=10, metavar="N", help="runs of each kind (10)")
    parser.add_argument("--first", type=int, default=0, metavar="K", help="number of the first run (0)")
    parser.add_argument(
        "--limit-seconds", type=float, default=float("inf"), help="begin no run after this time"
    )
    parser.add_argument("--table", action="store_true", help="only print the table")
    parser.add_argument("-o", "--output", type=Path, default=results)
    options = parser.parse_args()
    began = time.monotonic()
    done = {x["key"] for x in read_lines(options.output) if "error" not in x}
    plan = [] if options.table else range(options.first, options.first + options.runs)
    for number, kind in ((n, k) for n in plan for k in kinds):
        key = f"{kind}|{number}"
        if key in done or time.monotonic() - began > options.limit_seconds:
            continue
        with tempfile.TemporaryDirectory() as folder:
            try:
                line = answer(kind, number, Path(folder))
            except (RuntimeError, ValueError) as problem:
                line = {"error": str(problem)}
        append(options.output, {"key": key, "kind": kind, **line})
        told = line.get("error") or line["sentence"][:90]
        print(f"{time.monotonic() - began:6.0f} s  {key}  {told}", flush=True)
    print(report([x for x in read_lines(options.output) if "error" not in x]))
