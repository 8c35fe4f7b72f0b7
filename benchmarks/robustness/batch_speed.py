"""Many short clips through `batch` on one worker and on two: ratio of times, memory, and a second run.

    python benchmarks/robustness/batch_speed.py --work /tmp/robust --count 200 --frames 520

Each clip shows other pictures: it is cut from one of eight rendered films at a place of its own, and encoded anew.
Beside the wall time stands the CPU time of all processes: on a machine that does other work too, only that can be
compared. The memory is that of the largest process, in each quarter of the run.
"""

import argparse
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path

import av
from common import ROOT, ensure, report

FILMS, STEP = 8, 8


def draw(folder, count, frames):
    """Write the clips, unless they are there."""
    if len(list(folder.glob("*.mp4"))) == count:
        return
    spec = importlib.util.spec_from_file_location("foreign_film", ROOT / "tests/gyrotrack/foreign_film.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["foreign_film"] = module
    spec.loader.exec_module(module)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for k in range(min(FILMS, count)):
        film = module.Film(
            width=240,
            height=180,
            radius=78.0 + k % 3,
            frames=frames + STEP * (-(-count // FILMS)),
            casing=lambda t, k=k: (30.0 + 5 * k) * t,
            rotor=lambda t, k=k: (300.0 - 15 * k) * t,
            seed=k,
        )
        path = module.render(film, folder / "whole.mkv")
        with av.open(str(path)) as container:
            pictures = [f.to_ndarray(format="yuv420p") for f in container.decode(video=0)]
        for i in range(k, count, FILMS):
            start = STEP * (i // FILMS)
            write(folder / f"clip_{i:03d}_260fps.mp4", pictures[start : start + frames])
        path.unlink()


def write(path, pictures):
    """Encode pictures as a film."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(260))
        stream.height, stream.width = pictures[0].shape[0] * 2 // 3, pictures[0].shape[1]
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "20", "preset": "veryfast"}
        for k, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="yuv420p")
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def resident(pid):
    """Return the resident memory [MB] of the largest process among one and its descendants."""
    found, todo = [0.0], [pid]
    while todo:
        one = Path("/proc") / str(todo.pop())
        try:
            pages = int((one / "statm").read_text().split()[1])
            for thread in (one / "task").iterdir():  # a child belongs to the thread that began it
                todo += map(int, (thread / "children").read_text().split())
        except OSError:
            continue
        found.append(pages * os.sysconf("SC_PAGE_SIZE") / 1e6)
    return max(found)


def busy():
    """Return the CPU seconds that the whole machine has worked, and those that its host took away from it."""
    ticks = [int(x) for x in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return (sum(ticks) - ticks[3] - ticks[4]) / os.sysconf("SC_CLK_TCK"), ticks[7] / os.sysconf("SC_CLK_TCK")


def measured(words):
    """Run the program; return its wall and CPU seconds, those of others, its memory, and what it said."""
    before, start, machine = os.times(), time.monotonic(), busy()
    words = [sys.executable, "-m", "gyrotrack", words[0], "--json", "-q", *map(str, words[1:])]
    memory = []
    # a file, because nobody reads a pipe meanwhile, and what is said of many clips would fill it
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(words, stdout=output, text=True, cwd=ROOT)
        while process.poll() is None:
            memory.append(resident(process.pid))
            time.sleep(0.2)
        output.seek(0)
        said = json.loads(output.read())
    ensure(process.returncode == 0, str(said)[:300])
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    others = [a - b for a, b in zip(busy(), machine, strict=True)]
    others[0] -= cpu + others[1]
    quarter = -(-len(memory) // 4)
    most = [round(max(memory[i : i + quarter])) for i in range(0, len(memory), quarter)]
    return time.monotonic() - start, cpu, others, most, said


def main():
    """Run and report."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--frames", type=int, default=520)
    parser.add_argument("--workers", type=int, nargs="+", default=(1, 2))
    parser.add_argument("--draw", action="store_true", help="only write the clips")
    asked = parser.parse_args()
    began = time.monotonic()
    clips = asked.work / f"clips_{asked.count}_{asked.frames}"
    draw(clips, asked.count, asked.frames)
    if asked.draw:
        return
    found = {}
    for workers in asked.workers:
        results = asked.work / f"results_{workers}"
        shutil.rmtree(results, ignore_errors=True)
        words = ["batch", clips, "-o", results, "--until", "extract", "--workers", workers]
        wall, cpu, others, memory, said = measured(words)
        ensure(said["steps"]["done"] == asked.count, str(said["steps"]))
        again, *_, said = measured(words)
        ensure(said["steps"]["kept"] == asked.count, str(said["steps"]))
        found[workers] = {
            "wall_s": round(wall, 1),
            "cpu_s": round(cpu, 1),
            "others_cpu_s": round(others[0], 1),
            "stolen_cpu_s": round(others[1], 1),
            "memory_mb": memory,
            "second_run_s": round(again, 2),
        }
    walls = [f["wall_s"] for f in found.values()]
    report(
        "batch speed",
        began,
        count=asked.count,
        frames=asked.frames,
        load=os.getloadavg()[0],
        ratio=round(walls[0] / walls[-1], 2),
        workers=found,
    )


if __name__ == "__main__":
    main()
