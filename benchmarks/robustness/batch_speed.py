"""Many short clips through `batch` on one worker and on two: ratio of times, memory, and a second run.

    python benchmarks/robustness/batch_speed.py --work /tmp/robust --count 200 --frames 520

The clips are one film with different trailing bytes, so that each has contents of its own. Beside the wall time
stands the CPU time of all processes: on a machine that does other work too, only that can be compared.
"""

import argparse
import os
import shutil
import time

from common import ensure, gyrotrack, report
from mutate_clips import Path, base_films


def measured(words):
    """Run the program; return wall and CPU seconds of it and all its workers, and what it said."""
    before, start = os.times(), time.monotonic()
    code, said = gyrotrack(*words)
    ensure(code == 0, str(said)[:300])
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return time.monotonic() - start, cpu, said


def main():
    """Run and report."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--frames", type=int, default=520)
    asked = parser.parse_args()
    began = time.monotonic()
    film = base_films(asked.work / f"frames{asked.frames}", asked.frames)[0].read_bytes()
    clips = asked.work / "many"
    shutil.rmtree(clips, ignore_errors=True)
    clips.mkdir(parents=True)
    for i in range(asked.count):
        (clips / f"clip_{i:03d}_260fps.mp4").write_bytes(film + b"\0\0\0\x0cfree" + i.to_bytes(4, "big"))
    found = {}
    for workers in (1, 2):
        results = asked.work / f"results_{workers}"
        shutil.rmtree(results, ignore_errors=True)
        words = ["batch", clips, "-o", results, "--until", "extract", "--workers", workers]
        wall, cpu, said = measured(words)
        ensure(said["steps"]["done"] == asked.count, str(said["steps"]))
        again, _, said = measured(words)
        ensure(said["steps"]["kept"] == asked.count, str(said["steps"]))
        found[workers] = {"wall_s": round(wall, 1), "cpu_s": round(cpu, 1), "second_run_s": round(again, 2)}
    report(
        "batch speed",
        began,
        count=asked.count,
        frames=asked.frames,
        load=os.getloadavg()[0],
        ratio=round(found[1]["wall_s"] / found[2]["wall_s"], 2),
        workers=found,
    )


if __name__ == "__main__":
    main()
