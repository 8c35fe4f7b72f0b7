"""Mutated films through `extract`: no crash, no hang, no memory, each a sentence or a sound result.

python benchmarks/robustness/mutate_clips.py --work /tmp/robust --count 1000
"""

import argparse
import importlib.util
import os
import sys
import time
from collections import Counter
from pathlib import Path

from common import ROOT, report
from mutations import mutate

from gyrotrack.apps.batch._workers import Child
from gyrotrack.io._contents import inspect_file

LIMIT_S = 30.0
LIMIT_MB = 1000.0
FRAMES = 30


BASES = (
    (".mp4", "libx264"),
    (".mkv", "libx264"),
    (".mov", "mpeg4"),
    (".avi", "mjpeg"),
    (".webm", "libvpx-vp9"),
    (".mp4", "libx265"),
)


def base_films(work, frames=FRAMES):
    """Films of so many frames in five containers and five codecs, by the tests' own renderer."""
    spec = importlib.util.spec_from_file_location("foreign_film", ROOT / "tests/gyrotrack/foreign_film.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["foreign_film"] = module
    spec.loader.exec_module(module)
    work.mkdir(parents=True, exist_ok=True)
    made = []
    for suffix, codec in BASES:
        path = work / f"base_{codec}{suffix}"
        if not path.exists():
            film = module.Film(
                width=160,
                height=120,
                radius=54.0,
                frames=frames,
                casing=lambda t: 60.0 * t,
                rotor=lambda t: 300.0 * t,
                codec=codec,
                pixel_format="yuvj420p" if codec == "mjpeg" else "yuv420p",
            )
            module.render(film, path)
        made.append(path)
    return made


def peak_mb(child):
    """Return the largest resident memory that a worker had so far."""
    status = Path(f"/proc/{child.pid}/status").read_text()
    return float(status.split("VmHWM:")[1].split()[0]) / 1000


def main():
    """Run and report."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument(
        "--minutes", type=float, default=1e9, help="stop early; the count tells how far it came"
    )
    parser.add_argument("--first", type=int, default=0, help="the first seed, to go on where a run ended")
    asked = parser.parse_args()
    began = time.monotonic()
    bases = [(p.suffix, p.stem, p.read_bytes()) for p in base_films(asked.work / "bases")]
    place = asked.work / f"clips_{os.getpid()}"
    place.mkdir()
    outcomes, bad, slowest, largest, child = Counter(), [], 0.0, 0.0, Child()
    lost, again = Counter(), Counter()
    done = 0
    for seed in range(asked.first, asked.first + asked.count):
        if time.monotonic() - began > 60 * asked.minutes:
            break
        done += 1
        suffix, stem, content = bases[(seed // 5) % len(bases)]
        kind, data = mutate(content, seed)
        film, output = place / f"mutated{suffix}", place / "mutated.h5"
        film.write_bytes(data)
        output.unlink(missing_ok=True)
        start = time.monotonic()
        words = ["extract", str(film), "--capture-fps", "260", "-o", str(output)]
        answer = child.run(words, LIMIT_S)
        if answer["document"].get("error", {}).get("code") == "timeout":  # was the whole machine held up?
            again["timeout"] += 1
            start = time.monotonic()
            answer = child.run(words, LIMIT_S)
        slowest = max(slowest, time.monotonic() - start)
        error = answer["document"].get("error")
        if error is None:
            problems = inspect_file(output, verify=True).problems
            outcomes["sound result" if not problems else "unsound result"] += 1
            if problems:
                bad.append((seed, stem + suffix, kind, problems[0]))
            elif answer["document"]["frames"] != FRAMES:
                told = bool(answer["document"]["warnings"])
                lost["told" if told else f"not told, {suffix}"] += 1
        else:
            outcomes[f"sentence ({error['code']})"] += 1
            if error["code"] in {"crash", "timeout", "bug"} or output.exists():
                bad.append((seed, stem + suffix, kind, error["message"]))
        if child.pid is not None:
            largest = max(largest, peak_mb(child))
            if largest > LIMIT_MB or seed % 100 == 99:
                child.close()
    child.close()
    report(
        "mutated clips",
        began,
        first=asked.first,
        count=done,
        outcomes=dict(outcomes),
        sound_results_with_fewer_frames=dict(lost),
        tried_again=dict(again),
        failures=len(bad),
        first_failures=bad[:10],
        slowest_s=round(slowest, 2),
        peak_mb=round(largest),
    )


if __name__ == "__main__":
    main()
