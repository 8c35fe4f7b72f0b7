"""Mutated case and recording files through every reader: a sentence, or exactly the numbers that were written.

python benchmarks/robustness/mutate_hdf5.py --work /tmp/robust --count 1000
"""

import argparse
import hashlib
import json
import os
import resource
import select
import subprocess
import sys
import time
from collections import Counter
from dataclasses import fields, is_dataclass
from pathlib import Path

import h5py
import numpy as np
from common import ensure, films, gyrotrack, report
from mutations import mislead, mutate, resealed, torn, unsealed

LIMIT_S = 30.0


def readings(path, kind):
    """Yield what each reader of the program says of a file: a hash of all that it read, or a sentence."""
    from fitting._errors import FittingError
    from fitting.inference._case_file import read_record
    from gyrotrack._errors import GyrotrackError
    from gyrotrack.io._contents import inspect_file
    from gyrotrack.io._hdf5 import read_case, read_recording

    def verified(path):
        return inspect_file(path, verify=True).holds

    for read in (verified, read_case, read_record) if kind == "case" else (verified, read_recording):
        whole = hashlib.sha256()
        try:
            feed(whole, read(path))
        except (GyrotrackError, FittingError) as error:
            yield f"sentence {type(error).__name__}"
        except Exception as error:
            yield f"bug {type(error).__name__}: {error}".replace("\n", " ").replace("\t", " ")
        else:
            yield "value " + whole.hexdigest()


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
    for line in sys.stdin:
        path, kind = line.rstrip("\n").split("\t")
        said = json.dumps(list(readings(Path(path), kind)))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1000
        print(f"{said}\t{peak}", flush=True)


class Reader:
    """A process that reads files; it is begun again when it has died or hangs."""

    def __init__(self, target):
        self._target, self._process = target, None

    def ask(self, kind):
        """Return what each reader says of the file, and the memory needed so far [MB]."""
        if self._process is None:
            words = [sys.executable, __file__, "--worker"]
            self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._process.stdin.write(f"{self._target}\t{kind}\n")
        self._process.stdin.flush()
        late = not select.select([self._process.stdout], [], [], LIMIT_S)[0]
        said, _, memory = ("hang", "", "") if late else self._process.stdout.readline().rpartition("\t")
        if not memory:
            self.close()
        return json.loads(said) if memory else [said or "crash"], int(memory or 0)

    def close(self):
        """End it."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def made(content, seed, target):
    """Write a mutated file; return in which way it was mutated.

    Of ten seeds five are sealed files with other bytes, three have no seal, or a true one about other bytes, one
    has a torn chunk under a true seal, and one was rebuilt by the HDF5 library to lead elsewhere.
    """
    bare = unsealed(content)
    if seed % 10 < 5:
        how, data = mutate(content, seed)
    elif seed % 10 < 8:
        how, data = mutate(bare, seed // 2)
        how, data = (f"{how}, no seal", data) if seed % 4 else (f"{how}, true seal", resealed(data))
    else:
        target.write_bytes(bare)
        how = f"torn chunk of {torn(target, seed)}" if seed % 10 == 8 else mislead(target, seed)
        data = resealed(target.read_bytes()) if seed % 10 == 8 else target.read_bytes()
    target.write_bytes(data)
    return how


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
    place = asked.work / f"hdf5_{os.getpid()}"
    place.mkdir()
    with h5py.File(place / "elsewhere.h5", "w") as file:
        file["x"] = np.full(400, 42.0)
    bases = [("case", (asked.work / "run.h5").read_bytes()), ("recording", recording.read_bytes())]
    target = place / "mutated.h5"
    reader, truth = Reader(target), {}
    for kind, content in bases:
        target.write_bytes(content)
        truth[kind] = reader.ask(kind)[0]
        ensure(all(said.startswith("value") for said in truth[kind]), str(truth[kind]))
    outcomes, bad, slowest, peak = Counter(), [], 0.0, 0
    for seed in range(asked.count):
        kind, content = bases[seed // 10 % 2]
        how = made(content, seed, target)
        before = time.monotonic()
        said, memory = reader.ask(kind)
        slowest, peak = max(slowest, time.monotonic() - before), max(peak, memory)
        way = (
            "as written"
            if seed % 10 < 5
            else how.partition(" of ")[0].partition(", ")[2] or how.split(" of ")[0]
        )
        judged = [
            s if not s.startswith("value") else "right value" if s == t else f"wrong value of reader {i}"
            for i, (s, t) in enumerate(zip(said, truth[kind], strict=False))
        ]
        worst = min(judged, key=lambda j: (j.startswith("right"), j.startswith("sentence")))
        outcomes[f"{way}: {worst.split(' ')[0]}"] += 1
        if not worst.startswith(("right", "sentence")):
            bad.append((seed, kind, how, worst))
    reader.close()
    report(
        "mutated HDF5 files",
        began,
        count=asked.count,
        outcomes=dict(sorted(outcomes.items())),
        failures=len(bad),
        first_failures=bad[:10],
        slowest_s=round(slowest, 2),
        peak_mb=peak,
        within_limit=slowest < LIMIT_S,
    )


if __name__ == "__main__":
    main()
