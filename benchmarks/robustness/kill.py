"""kill -9 at random moments of extract, sync, fit and batch: nothing half-written, nothing lost, and it goes on.

    python benchmarks/robustness/kill.py --work /tmp/robust --count 50

`--count` kills that land for each of the four: a moment is drawn over the time that the command took when it last
ran to its end, and again where it came too late. An earlier output is there each time; after each kill every
output must be either the earlier one, byte for byte, or a new one that is sound; then the same command must
complete.
"""

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from common import ROOT, commit, ensure, films, gyrotrack, report

from gyrotrack.io._contents import inspect_file

VERBS = ("extract", "sync", "fit", "batch")


def sound(path):
    """Tell whether a file of ours can be read to its last byte."""
    if path.suffix == ".h5":
        return not inspect_file(path, verify=True).problems
    if path.suffix == ".json":
        return bool(json.loads(path.read_text()))
    return path.name.endswith((".lock", ".jsonl", ".unfinished", ".csv", ".html"))


def states(folder):
    """Return the hash of each output; what is on its way (``.part``, ``.unfinished``) is no output."""
    return {
        p: hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and not p.name.endswith((".part", ".unfinished", ".lock"))
    }


def begin(words):
    """Start a command, in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "gyrotrack", *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=ROOT,
        start_new_session=True,
    )


def finish(words):
    """Run a command to its end; return its exit code."""
    return begin(words).wait()


def trial(verb, words, folder, moment, rung_count):
    """Kill once; return whether it was in time, what was wrong, and how long a whole run took [s]."""
    before = states(folder)
    process = begin(words)
    start, whole = time.monotonic(), None
    try:
        process.wait(timeout=moment)
        landed, whole = "ended before", time.monotonic() - start
    except subprocess.TimeoutExpired:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        landed = "killed"
    time.sleep(0.1 if verb == "batch" else 0.0)  # its workers end with it
    wrong = []
    after = states(folder)
    for path, old in before.items():
        if path not in after:
            wrong.append(f"{path.name} was lost")
        elif after[path] != old and not sound(path):
            wrong.append(f"{path.name} is not sound")
    wrong += [f"{p.name} is not sound" for p in after if p not in before and not sound(p)]
    if verb == "fit":
        count = rung_count(folder)
        if count < rung_count.before:
            wrong.append("an earlier fit was lost")
    code = finish(words)
    if code not in {0, 3}:
        wrong.append(f"the next run ended with {code}")
    wrong += [f"{p.name} is not sound after the next run" for p in states(folder) if not sound(p)]
    left = [p.name for p in folder.rglob("*") if p.name.endswith((".part", ".unfinished"))]
    wrong += [f"{name} was left behind" for name in left]
    return landed, wrong, whole


def rungs(folder):
    """Return how many fits the ledger holds."""
    return len(json.loads((folder / "run.fits.json").read_text())["fits"])


def prepared(work, verbs):
    """Lay out a folder for each command, with an earlier output in it; return the words of each."""
    clips, place = films(work), work / "kill"
    for verb in verbs:
        shutil.rmtree(place / verb, ignore_errors=True)
        (place / verb).mkdir(parents=True)
    sources = tracked(clips, place / f"sources_{verbs[0]}")
    film, output = clips / "rotor_1.mp4", place / "extract/r.h5"
    if "extract" in verbs:
        shutil.copy(sources / "rotor_1.h5", output)
    if "fit" in verbs:
        shutil.copy(work / "run.h5", place / "fit" / "run.h5")
    few = place / "few"
    few.mkdir(exist_ok=True)
    shutil.copy(film, few / "a_500fps.mp4")
    shutil.copy(clips / "rotor_2.mp4", few / "b_500fps.mp4")
    both = [sources / "casing.h5", sources / "rotor_1.h5"]
    return {
        "extract": ["extract", film, "--capture-fps", "500", "-o", output, "--force", "--resume"],
        "sync": ["sync", *both, "-o", place / "sync/c.h5", "--force"],
        "fit": ["fit", place / "fit/run.h5", "--model", "reduced"],
        "batch": ["batch", few, "-o", place / "batch", "--until", "extract", "--workers", "2"],
    }


def tracked(clips, sources):
    """Track a casing film and a rotor film, unless that is done; return where the recordings are."""
    sources.mkdir(exist_ok=True)
    for name, fps in (("casing", "260"), ("rotor_1", "500")):
        output = sources / f"{name}.h5"
        if not output.exists():
            code, said = gyrotrack("extract", clips / f"{name}.mp4", "--capture-fps", fps, "-o", output)
            ensure(code == 0, str(said))
    return sources


def kills(verb, words, folder, record, chance):
    """Kill one command again and again; yield after each trial, which is a line of the record."""
    seconds = timed(verb, words)
    while True:
        if verb == "batch":  # something to do each time, and something done before
            (folder / "b_500fps" / "b_500fps.h5").unlink()
        rungs.before = rungs(folder) if verb == "fit" else 0
        moment = chance.uniform(0.0, seconds)
        how, wrong, whole = trial(verb, words, folder, moment, rungs)
        seconds = whole or seconds
        line = {"verb": verb, "how": how, "moment": round(moment, 3), "wrong": wrong, "commit": commit()}
        with record.open("a") as stream:
            stream.write(json.dumps(line) + "\n")
        yield


def summed_up(record, began):
    """Print what the record holds."""
    moments = told(record)
    bad = [line for line in map(json.loads, record.read_text().splitlines()) if line["wrong"]]
    killed = sum(c["killed"] for c in moments.values())
    report("kill -9", began, kills=killed, moments=moments, failures=len(bad), first_failures=bad[:10])


def main():
    """Run and report."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--verbs", nargs="+", default=VERBS, choices=VERBS)
    parser.add_argument(
        "--minutes", type=float, default=1e9, help="stop early; another run goes on from there"
    )
    asked = parser.parse_args()
    began = time.monotonic()
    words = prepared(asked.work, asked.verbs)
    record = asked.work / "kill.jsonl"  # a line a trial, so that a run can be cut into pieces
    done = sum(sum(c.values()) for c in told(record).values())
    chance = random.Random(1000 * asked.seed + done)  # noqa: S311 - moments, not secrets
    for verb in asked.verbs:
        if told(record)[verb]["killed"] >= asked.count:
            continue
        for _ in kills(verb, words[verb], asked.work / "kill" / verb, record, chance):
            if told(record)[verb]["killed"] >= asked.count or time.monotonic() - began > 60 * asked.minutes:
                break
    summed_up(record, began)


def timed(verb, words):
    """Run a command to its end; return how long it took [s]."""
    start = time.monotonic()
    ensure(finish(words) == 0, verb)
    return time.monotonic() - start


def told(record):
    """Return how many trials of each kind there have been."""
    lines = map(json.loads, record.read_text().splitlines()) if record.exists() else ()
    counts = {verb: Counter() for verb in VERBS}
    for line in lines:
        counts[line["verb"]][line["how"]] += 1
    return counts


if __name__ == "__main__":
    main()
