"""Mutated case and recording files through every reader: a sentence, or exactly the numbers that were written.

python benchmarks/robustness/mutate_hdf5.py --work /tmp/robust --count 1000
"""

import argparse
import hashlib
import resource
import subprocess
import sys
import time
from collections import Counter
from dataclasses import fields, is_dataclass
from pathlib import Path

from common import films, gyrotrack, report
from mutations import mutate

LIMIT_S = 30.0


def digest(path, kind):
    """Read a file as the program does; return a hash of all that was read."""
    from fitting.record import read_record
    from gyrotrack.dataset import read_case, read_recording
    from gyrotrack.dataset.inspection import inspect_file

    inspect_file(path, verify=True)
    content = read_case(path) if kind == "case" else read_recording(path)
    whole = hashlib.sha256()
    feed(whole, content)
    if kind == "case":
        whole.update(read_record(path).digest.encode())
    return whole.hexdigest()


def feed(whole, item):
    """Add all numbers and words of a record to a hash."""
    if is_dataclass(item):
        item = {f.name: getattr(item, f.name) for f in fields(item)}
    if isinstance(item, dict):
        for key, value in item.items():
            feed(whole, key)
            feed(whole, value)
    elif isinstance(item, list | tuple):
        for value in item:
            feed(whole, value)
    else:
        whole.update(item.tobytes() if hasattr(item, "tobytes") else repr(item).encode())


def worker():
    """Read files named on stdin; answer a line each."""
    from fitting.errors import FittingError
    from gyrotrack.errors import GyrotrackError

    for line in sys.stdin:
        path, kind = line.rstrip("\n").split("\t")
        try:
            said = "value " + digest(Path(path), kind)
        except (GyrotrackError, FittingError) as error:
            said = f"sentence {type(error).__name__}"
        except Exception as error:
            said = f"bug {type(error).__name__}: {error}".replace("\n", " ")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1000
        print(f"{said}\t{peak}", flush=True)


def start():
    """Start a reader."""
    words = [sys.executable, __file__, "--worker"]
    return subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def main():
    """Run and report."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--worker", action="store_true")
    asked = parser.parse_args()
    if asked.worker:
        worker()
        return
    began = time.monotonic()
    film = films(asked.work) / "rotor_1.mp4"
    recording = asked.work / "recording.h5"
    if not recording.exists():
        gyrotrack("extract", film, "-o", recording, "--capture-fps", "500")
    bases = [("case", (asked.work / "run.h5").read_bytes()), ("recording", recording.read_bytes())]
    target, child = asked.work / "mutated.h5", start()

    def ask(kind):
        child.stdin.write(f"{target}\t{kind}\n")
        child.stdin.flush()
        return child.stdout.readline().rstrip("\n").rpartition("\t")

    truth = {}
    for kind, content in bases:
        target.write_bytes(content)
        truth[kind] = ask(kind)[0]
    outcomes, bad, slowest, peak = Counter(), [], 0.0, 0
    for seed in range(asked.count):
        kind, content = bases[seed // 5 % 2]
        how, data = mutate(content, seed)
        target.write_bytes(data)
        before = time.monotonic()
        said, _, memory = ask(kind)
        slowest = max(slowest, time.monotonic() - before)
        if not memory:
            outcomes["crash"] += 1
            bad.append((seed, kind, how, "crash"))
            child = start()
            continue
        peak = max(peak, int(memory))
        if said.startswith("value"):
            right = said == truth[kind] or data == content
            outcomes["right value" if right else "wrong value"] += 1
            if not right:
                bad.append((seed, kind, how, "wrong value"))
        else:
            outcomes[said.split(":")[0]] += 1
            if said.startswith("bug"):
                bad.append((seed, kind, how, said))
    child.kill()
    report(
        "mutated HDF5 files",
        began,
        count=asked.count,
        outcomes=dict(outcomes),
        failures=len(bad),
        first_failures=bad[:10],
        slowest_s=round(slowest, 2),
        peak_mb=peak,
        within_limit=slowest < LIMIT_S,
    )


if __name__ == "__main__":
    main()
