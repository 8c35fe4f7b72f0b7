"""What the robustness benchmarks share: films drawn once, and a line of JSON for the results table."""

import json
import platform
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).parents[2]


def gyrotrack(*words, **options):
    """Run the program in a process of its own; return (exit code, its JSON)."""
    done = subprocess.run(
        [sys.executable, "-m", "gyrotrack", words[0], "--json", "-q", *map(str, words[1:])],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        **options,
    )
    return done.returncode, json.loads(done.stdout or "{}")


def ensure(holds, why):
    """Stop if the benchmark itself cannot go on."""
    if not holds:
        raise SystemExit(f"cannot go on: {why}")


def films(work):
    """Draw a casing and three rotor films of one run, small and short, unless they are there."""
    folder = work / "films"
    if not (folder / "rotor_3.mp4").exists():
        folder.mkdir(parents=True, exist_ok=True)
        words = ["simulate", "-o", work / "run.h5", "--film", folder, "--force", "--duration", "8"]
        words += ["--window-length", "0.6", "--casing-fps", "260", "--rotor-fps", "500"]
        code, said = gyrotrack(*words, "--inertia-rotor", "4.2e-6", "--inertia-casing", "1.6e-6")
        ensure(code == 0, str(said))
    return folder


def commit():
    """Return the commit that was measured."""
    words = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    return subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT).stdout.strip()


def report(name, began, **figures):
    """Print one line of JSON: what was measured, of which commit, when, in how long."""
    facts = {
        "benchmark": name,
        "commit": commit(),
        "date": datetime.now(UTC).isoformat(timespec="minutes"),
        "python": platform.python_version(),
        "seconds": round(time.monotonic() - began, 1),
    }
    print(json.dumps({**facts, **figures}), flush=True)
