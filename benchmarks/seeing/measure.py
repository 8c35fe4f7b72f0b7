"""How long a report takes and how large it is, how its page and the workbench answer: one command, one table.

    python benchmarks/seeing/measure.py             # everything, some eight minutes
    python benchmarks/seeing/measure.py page view   # these parts only; the others stay as they were measured

The study is two recordings of 200 s at 260 and 1000 frames a second with a hidden drag and a random torque. The machine
must have nothing else to do. GYROTRACK_BENCHMARK_ROUNDS (3) is how often each report is made. Results go to
results.json and results.md beside this file.
"""

from __future__ import annotations

import json
import os
import platform
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from typing import Any

import browser as seen

HERE = Path(__file__).parent
FILMS = HERE.parents[1] / "sample_clips"
_SECRET = ["--add", "casing.air.quadratic", "--strength", "0.02", "--torque-noise", "2e-8"]


def gyrotrack(*words: object) -> tuple[float, float]:
    """Run a command; return its wall-clock and processor time [s]."""
    used, began = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "gyrotrack", *map(str, words), "-q"], capture_output=True, text=True
    )
    if done.returncode not in {0, 3}:
        raise SystemExit(done.stderr)
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return perf_counter() - began, spent.ru_utime + spent.ru_stime - used.ru_utime - used.ru_stime


def study(folder: Path) -> list[Path]:
    """Make the two recordings."""
    cases = [folder / "one.h5", folder / "two.h5"]
    others = (["--seed", "1"], ["--seed", "2", "--omega-rotor", "700", "--omega-casing", "12"])
    for case, other in zip(cases, others, strict=True):
        if not case.exists():
            gyrotrack("simulate", "-o", case, *_SECRET, *other)
    return cases


def reports(folder: Path) -> dict[str, Any]:
    """Time the report from nothing, after `diagnose`, after `improve`, and as PDF."""
    cases, page, paper = study(folder), folder / "report.html", folder / "report.pdf"
    ledger = folder / "one.fits.json"
    times: dict[str, list[tuple[float, float]]] = {}

    def timed(name: str, *words: object) -> None:
        times.setdefault(name, []).append(gyrotrack(*words))

    for _ in range(int(os.environ.get("GYROTRACK_BENCHMARK_ROUNDS", "3"))):
        ledger.unlink(missing_ok=True)
        timed("cold", "report", *cases, "-o", page, "--force")
        ledger.unlink()
        timed("diagnose", "diagnose", *cases)
        timed("diagnosed", "report", *cases, "-o", page, "--force")
        ledger.unlink()
        timed("improve", "improve", *cases)
        timed("improved", "report", *cases, "-o", page, "--force")
        timed("pdf", "report", *cases, "-o", paper, "--force")
    return {"times": times, "html_MB": page.stat().st_size / 1e6, "pdf_MB": paper.stat().st_size / 1e6}


def report_page(folder: Path) -> dict[str, Any]:
    """Open the page of the full study."""
    cases, page = study(folder), folder / "report.html"
    if not page.exists():
        gyrotrack("improve", *cases)
        gyrotrack("report", *cases, "-o", page)
    with seen.chromium() as browser:
        return seen.page_of_report(browser, page)


def workbench(folder: Path) -> dict[str, Any]:
    """Visit the workbench of a full recording ten times."""
    with seen.chromium() as browser:
        return seen.visits(browser, study(folder)[0], folder)


def film(folder: Path) -> dict[str, Any]:
    """Ask for frames of the sample films, click into a chart, move sliders."""
    case = folder / "demo" / "case.h5"
    if not case.exists():
        gyrotrack("demo", "-o", case.parent)
    with seen.chromium() as browser:
        return seen.frames(browser, case, FILMS, folder)


PARTS: dict[str, Callable[[Path], dict[str, Any]]] = {
    "report": reports,
    "page": report_page,
    "view": workbench,
    "frames": film,
}


def table(found: dict[str, Any]) -> str:
    """Return the results as a page."""
    lines = [
        "# Seeing: the report, its page, the workbench",
        "",
        "Made by `python benchmarks/seeing/measure.py`, which describes what is measured. Two recordings of 200 s,",
        "52,000 angles of the casing and 3 x 3,000 of the rotor each.",
        "",
    ]
    for part, result in found.items():
        lines += [
            f"## {part}",
            "",
            f"{result['when']}, {result['machine']}",
            "",
            "| what | figure |",
            "|---|---|",
        ]
        lines += [f"| {what} | {figure} |" for what, figure in _ROWS[part](result)] + [""]
    return "\n".join(lines)


def _each(values: list[float], digits: int, unit: str) -> str:
    return f"{min(values):.{digits}f} to {max(values):.{digits}f} {unit} (N = {len(values)})"


def _report_rows(r: dict[str, Any]) -> list[tuple[str, str]]:
    names = {
        "cold": "`report` with no fit so far: fit, diagnosis, HTML",
        "diagnosed": "`report` after `diagnose`, HTML",
        "improved": "`report` after `improve`, HTML",
        "pdf": "`report` after `improve`, PDF",
        "diagnose": "`diagnose` with no fit so far",
        "improve": "`improve` with no fit so far",
    }
    rows = [
        (
            words,
            f"{_each([t[0] for t in r['times'][k]], 1, 's')}; processor {min(t[1] for t in r['times'][k]):.1f} s",
        )
        for k, words in names.items()
    ]
    return [*rows, ("size, HTML", f"{r['html_MB']:.2f} MB"), ("size, PDF", f"{r['pdf_MB']:.2f} MB")]


def _page_rows(r: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        ("from navigation to plots drawn and zoom answering", _each(r["usable_ms"], 0, "ms")),
        ("points of the longest curve of each case", ", ".join(str(n) for n in r["points"])),
        (
            "tasks over 50 ms while zooming and panning",
            f"{r['long_tasks']}, the longest {r['longest_task_ms']:.0f} ms",
        ),
        (
            "time between pictures meanwhile",
            f"99 % within {r['gap_p99_ms']:.0f} ms, at most {r['gap_max_ms']:.0f} ms ({r['pictures']} pictures)",
        ),
    ]


def _view_rows(r: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        ("from the command to its address (reads and fits)", _each(r["ready_s"], 1, "s")),
        ("from navigation to plots drawn and zoom answering", _each(r["usable_ms"], 0, "ms")),
        ("an effect of the library added: fitted and redrawn", _each(r["add_s"], 2, "s")),
        ("a typed law added: fitted and redrawn", _each(r["law_s"], 2, "s")),
        ("an effect dropped: fitted and redrawn", _each(r["drop_s"], 2, "s")),
        ("processes left behind after Quit", f"{r['left_behind']} in {r['visits']} visits"),
    ]


_SHARES = {"median": "median", "p95": "95 % within", "max": "at most"}


def _frame_rows(r: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        (
            f"{what}, film of {r['frames']} frames",
            ", ".join(f"{words} {r[f'{k}_{n}_ms']:.0f} ms" for n, words in _SHARES.items()),
        )
        for k, what in (
            ("next", "the next frame (N = 60)"),
            ("far", "a frame anywhere (N = 40)"),
            ("click", "click into the residual to its frame (N = 40)"),
            ("linear", "slider to the linearised residual (N = 40)"),
            ("exact", "slider to the exact residual (N = 40)"),
        )
    ]


_ROWS = {"report": _report_rows, "page": _page_rows, "view": _view_rows, "frames": _frame_rows}


def _machine() -> str:
    return (
        f"{os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}, commit {_commit()}"
    )


def _commit() -> str:
    done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=HERE, capture_output=True, text=True)
    return done.stdout.strip() or "unknown"


def main() -> None:
    """Measure the parts that are asked for, all if none is."""
    wanted = sys.argv[1:] or list(PARTS)
    if unknown := [w for w in wanted if w not in PARTS]:
        raise SystemExit(f"no such part: {unknown[0]}; parts: {', '.join(PARTS)}")
    kept = HERE / "results.json"
    found = json.loads(kept.read_text()) if kept.exists() else {}
    given = os.environ.get("GYROTRACK_BENCHMARK_FOLDER")
    folder = Path(given or tempfile.mkdtemp())
    folder.mkdir(exist_ok=True)
    for part in wanted:
        when = datetime.now(UTC).strftime("%Y-%m-%d")
        found[part] = {"when": when, "machine": _machine(), **PARTS[part](folder)}
        kept.write_text(json.dumps(found, indent=1) + "\n")
        print(part, json.dumps(found[part]))
    (HERE / "results.md").write_text(table({p: found[p] for p in PARTS if p in found}))
    if not given:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
