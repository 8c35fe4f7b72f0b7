"""How fast films are tracked, beside decoding alone and beside usual ways, and how much memory it takes.

    python benchmarks/tracking/speed.py -o benchmarks/tracking/speed.md

All arms run in turn, several times over, in one process and one thread; CPU time is compared, and the fastest turn of
each counts. Start-up (finding the scene in a film) is told apart from the time a frame takes. Some arms use two threads
or two workers, as `gyrotrack extract` does on two cores: for them the time on the clock counts, beside that of decoding
in one thread. See README.md
for what has to be installed.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
import warnings
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = "threads;1"

import arms
import cv2
import numpy as np
from clips import CAMERAS, film, repeated

from gyrotrack._native._kernels import COMPILED
from gyrotrack.tracking._acquisition import acquire
from gyrotrack.tracking._profile import PAPER
from gyrotrack.tracking._scene import take_samples

FRAMES = {"casing": 3000, "rotor": 2000}
FEW = {"scikit-image regionprops": 12, "trackpy.locate": 4}
# A child's `ru_maxrss` starts at what its parent held when it was started; VmHWM is its own.
_PEAK = """
import sys
from pathlib import Path
from gyrotrack.apps.cli._app import run
# a film that is repeated jumps from its end to its start, which extract reports (3)
assert run(["extract", sys.argv[1], "-o", sys.argv[2], "-q", "--force", "--capture-fps", sys.argv[3]]) in (0, 3)
lines = Path("/proc/self/status").read_text().splitlines()
print(next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024)
"""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--films", type=Path, default=Path.home() / ".cache" / "gyrotrack-benchmarks")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--part",
        choices=("speed", "memory"),
        help="measure only this; the other is kept from the .json beside the table",
    )
    parser.add_argument(
        "-o", "--output", type=Path, help="table (.md); a .json of the numbers stands beside it"
    )
    args = parser.parse_args()
    cv2.setNumThreads(1)
    results: dict = {}
    if args.part and args.output and args.output.with_suffix(".json").exists():
        results = json.loads(args.output.with_suffix(".json").read_text(encoding="utf-8"))
    if args.part != "memory":
        results |= {"commit": commit(), "machine": machine(), "notes": []}
        results["clips"] = {clip: timed(clip, n, args.films, args.rounds) for clip, n in FRAMES.items()}
    if args.part != "speed":
        results["memory_commit"] = commit()
        results["memory_mb"] = {clip: peaks(clip, n, args.films) for clip, n in FRAMES.items()}
    if args.output:
        args.output.with_suffix(".json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    text = table(results)
    print(text)
    if args.output:
        args.output.write_text(text, encoding="utf-8")


def timed(clip: str, frames: int, folder: Path, rounds: int) -> dict:
    path, truth = film(clip, frames, folder)
    fps = CAMERAS[clip].fps
    todo = {
        "decoding alone": lambda: arms.decode(path, frames),
        "gyrotrack, all markers": lambda: arms.gyrotrack(path, fps),
        "gyrotrack, casing only": lambda: arms.gyrotrack(path, fps, "casing"),
        "gyrotrack, all markers, two threads": lambda: arms.gyrotrack(path, fps, threads=2),
        "gyrotrack, all markers, two workers": lambda: arms.gyrotrack(path, fps, workers=2),
        "gyrotrack, casing only, two threads": lambda: arms.gyrotrack(path, fps, "casing", threads=2),
        "VideoCapture, HSV, contours": lambda: arms.opencv(path, frames // 4),
        "scikit-image regionprops": lambda: arms.regionprops(path, FEW["scikit-image regionprops"]),
        "trackpy.locate": lambda: arms.trackpy(path, FEW["trackpy.locate"]),
    }
    counts = {"VideoCapture, HSV, contours": frames // 4, **FEW}
    seconds: dict[str, list[float]] = {name: [] for name in todo}
    clock: dict[str, list[float]] = {name: [] for name in todo}
    starts: dict[str, list[float]] = {name: [] for name in todo if name.startswith("gyrotrack")}
    angles = {}
    for _ in range(rounds):
        for name, work in todo.items():
            if name in starts:
                starts[name].append(start_up(path, casing_only="casing" in name))
            begin = time.process_time(), time.perf_counter()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                angles[name] = work()
            seconds[name].append(time.process_time() - begin[0])
            clock[name].append(time.perf_counter() - begin[1])
    arms_found = {}
    decoding = min(seconds["decoding alone"]) / frames
    decoding_clock = min(clock["decoding alone"]) / frames
    for name, spent in seconds.items():
        start = min(starts[name]) if name in starts else 0.0
        a_frame = (min(spent) - start) / counts.get(name, frames)
        arms_found[name] = {
            "us_per_frame": 1e6 * a_frame,
            "share_of_decoding": decoding / a_frame,
            "start_up_s": start,
        }
        if name.endswith(("two threads", "two workers")):
            on_clock = (min(clock[name]) - start) / frames
            arms_found[name] |= {
                "clock_us_per_frame": 1e6 * on_clock,
                "share_on_clock": decoding_clock / on_clock,
            }
        if angles[name] is not None:
            arms_found[name]["casing_rms_mrad"] = error(angles[name], truth)
    return {"frames": frames, "rounds": rounds, "arms": arms_found}


def start_up(path: Path, *, casing_only: bool) -> float:
    begin = time.process_time()
    profile = PAPER.model_copy(update={"marker": PAPER.of("casing")}) if casing_only else PAPER
    acquire(take_samples(path), profile, str(path))
    return time.process_time() - begin


def error(angle: np.ndarray, truth) -> float:
    """Return the rms error in mrad of an angle as seen, without its mean; frames without one are left out."""
    off = angle - truth.sense * truth.angle["casing"][: len(angle)]
    off = np.angle(np.exp(1j * off)[np.isfinite(off)])
    off = np.angle(np.exp(1j * (off - np.angle(np.mean(np.exp(1j * off))))))
    return float(1e3 * np.sqrt(np.mean(off**2)))


def peaks(clip: str, frames: int, folder: Path) -> dict[str, float]:
    path, _ = film(clip, frames, folder)
    found = {}
    most = -(-52000 // frames)
    for times in (1, most // 2, most):
        longer = repeated(path, folder / f"long_{clip}.mp4", times)
        words = [sys.executable, "-c", _PEAK, str(longer), str(folder / "long.h5"), str(CAMERAS[clip].fps)]
        done = subprocess.run(words, check=True, capture_output=True, text=True)
        found[str(times * frames)] = float(done.stdout.split()[-1])
        longer.unlink()
    return found


def commit() -> str:
    words = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    return subprocess.run(words, check=False, capture_output=True, text=True).stdout.strip() or "unknown"


def machine() -> str:
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    inner = "compiled" if COMPILED else "not compiled"
    return f"{platform.machine()}, {os.cpu_count()} cores, load {load:.1f} at the start; inner loops {inner}"


def table(results: dict) -> str:
    lines = [
        "# Speed and memory of tracking",
        "",
        f"Commit {results['commit']}; {results['machine']}. CPU time of the calling process, the fastest of several",
        "turns; with two threads or workers also the time on the clock, beside that of decoding in one thread.",
    ]
    lines += ["", *results["notes"]] if results.get("notes") else []
    for clip, found in results.get("clips", {}).items():
        camera = CAMERAS[clip]
        lines += [
            "",
            f"## The {clip}'s camera: {camera.width} x {camera.height}, {found['frames']} frames",
            "",
            "| arm | us a frame | share of decoding | clock, us | share | start-up, s | casing's angle, rms, mrad |",
            "|---|---|---|---|---|---|---|",
        ]
        for name, arm in found["arms"].items():
            start = f"{arm['start_up_s']:.2f}" if arm["start_up_s"] else ""
            rms = f"{arm['casing_rms_mrad']:.2f}" if "casing_rms_mrad" in arm else ""
            both = (
                f"{arm['clock_us_per_frame']:.0f} | {arm['share_on_clock']:.3g}"
                if "share_on_clock" in arm
                else " | "
            )
            lines.append(
                f"| {name} | {arm['us_per_frame']:.0f} | {arm['share_of_decoding']:.3g} | {both} | {start} | {rms} |"
            )
    if results.get("memory_mb"):
        lines += [
            "",
            "## Peak memory of `gyrotrack extract`",
            "",
            f"Commit {results['memory_commit']}; VmHWM of the process. The longer films are the",
            "shortest one over and over. Up to some thousand frames a film has fewer than the twenty key frames",
            "by which a longer one is got to know.",
            "",
            "| clip | frames | MB |",
            "|---|---|---|",
        ]
        for clip, found in results["memory_mb"].items():
            lines += [f"| {clip} | {frames} | {peak:.0f} |" for frames, peak in found.items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
