"""kill -9 at random moments of every command that writes: nothing lost, and the same command again ends well.

    python benchmarks/robustness/kill.py --work /tmp/robust --count 300

A trial copies a folder of small inputs, starts one command and kills it; the moment is drawn over the time that the
command takes. Every file that was there must then be unchanged, or, where the command replaces it, sound. The same
command must end with 0 or 3, and leave the files that an undisturbed run leaves, none beside them and none in the
folder of temporary files. `view` is the workbench's server, killed while it stores entries and receives files.
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
from dataclasses import dataclass, field
from http.client import HTTPException
from pathlib import Path
from urllib.error import URLError
from urllib.request import HTTPCookieProcessor, Request, build_opener

ROOT = Path(__file__).parents[2]
INERTIAS = ["--inertia-rotor", "4.2e-6", "--inertia-casing", "1.6e-6"]

# command, and the files that it needs
COMMANDS = {
    "profile": (["profile", "rotor_1.mp4", "-o", "p.toml", "--picture", "p.png"], ["rotor_1.mp4"]),
    "extract": (["extract", "rotor_1.mp4", "--capture-fps", "500", "-o", "r.h5"], ["rotor_1.mp4"]),
    "extract overlay": (
        ["extract", "rotor_1.mp4", "--capture-fps", "500", "-o", "r.h5", "--overlay", "o.png"],
        ["rotor_1.mp4"],
    ),
    "extract --force": (
        ["extract", "rotor_1.mp4", "--capture-fps", "500", "-o", "rotor_1.h5", "--force"],
        ["rotor_1.mp4", "rotor_1.h5"],
    ),
    "import": (["import", "--body", "t.csv", "--inertia", "1e-5", "-o", "c.h5"], ["t.csv"]),
    "spindown": (["spindown", "t.csv", "-o", "c.h5"], ["t.csv"]),
    "sync": (["sync", "casing.h5", "rotor_1.h5", *INERTIAS, "-o", "c.h5"], ["casing.h5", "rotor_1.h5"]),
    "fit": (["fit", "wheel.h5"], ["wheel.h5", "wheel.fits.json"]),
    "diagnose": (["diagnose", "wheel.h5"], ["wheel.h5", "wheel.fits.json"]),
    "improve": (["improve", "wheel.h5"], ["wheel.h5"]),
    "ladder": (["ladder", "wheel.h5", "--note", "f1=a note"], ["wheel.h5", "wheel.fits.json"]),
    "budget": (["budget", "wheel.h5"], ["wheel.h5", "wheel.fits.json"]),
    "report": (["report", "wheel.h5", "-o", "r.html"], ["wheel.h5", "wheel.fits.json"]),
    "report pdf": (["report", "wheel.h5", "-o", "r.pdf"], ["wheel.h5", "wheel.fits.json"]),
    "compare": (
        ["compare", "wheel.h5", "other.h5", "--picture", "d.png"],
        ["wheel.h5", "wheel.fits.json", "other.h5", "other.fits.json"],
    ),
    "plan": (["plan", "wheel.h5", "--picture", "p.png"], ["wheel.h5", "wheel.fits.json"]),
    "export": (["export", "wheel.h5", "-o", "w.csv"], ["wheel.h5"]),
    "export parquet": (["export", "wheel.h5", "-o", "w.parquet"], ["wheel.h5"]),
    "simulate": (["simulate", "-o", "s.h5", "--hide", "--duration", "20"], []),
    "scan": (["scan", "run.h5", "--csv", "s.csv", "--latex", "s.tex"], ["run.h5"]),
    "figures": (["figures", "run.h5", "-o", "f"], ["run.h5"]),
    "batch": (["batch", "films", "-o", "b", "--until", "extract", "--workers", "2"], ["films"]),
}
# inputs that are films, or made from films
FILMS = {"rotor_1.mp4", "casing.h5", "rotor_1.h5", "films"}
QUICK = ("import", "export", "fit", "ladder", "report", "simulate")


@dataclass
class Outcome:
    """Counts of one command."""

    killed: int = 0
    ended: int = 0  # before the kill
    finished: int = 0  # everything was written and removed, and the program about to end
    wrong: list[str] = field(default_factory=list)


def environment(temporary):
    """Return the environment of a command with its own folder of temporary files."""
    temporary.mkdir(exist_ok=True)
    return {**os.environ, "TMPDIR": str(temporary), "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def begin(words, folder, **options):
    """Start a command in a folder."""
    options = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, **options}
    env = environment(folder.with_name(folder.name + ".tmp"))
    return subprocess.Popen([sys.executable, "-m", "gyrotrack", *words], cwd=folder, env=env, **options)


def contents(folder):
    """Return the hash of each file in a folder."""
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def sound(path):
    """Whether a file of gyrotrack can be read to its end."""
    from gyrotrack.io._contents import inspect_file

    if path.suffix == ".lock":
        return True
    if path.suffix == ".h5":
        return not inspect_file(path, verify=True).problems
    if path.suffix in {".json", ".jsonl"}:
        return all(
            json.loads(line) for line in ([path.read_text()] if path.suffix == ".json" else path.open())
        )
    return path.stat().st_size > 0


def make(place, names):
    """Make the inputs of commands, each once; films are drawn and tracked only for commands that need them."""
    store = place / "inputs"

    def run(*words):
        process = begin([*map(str, words), "-q"], store, stderr=None)
        if process.wait() not in {0, 3}:
            raise SystemExit(f"cannot go on: {words}")

    if not (store / "made").exists():
        shutil.rmtree(place, ignore_errors=True)
        store.mkdir(parents=True)
        make_tables(store, run)
        (store / "made").touch()
    needed = {file for name in names if name in COMMANDS for file in COMMANDS[name][1]}
    if needed & FILMS and not (store / "drawn.done").exists():
        make_films(store, run)
        (store / "drawn.done").touch()
    return store


def make_tables(store, run):
    """Make tables, cases and fits, and a film that is only listed."""
    shutil.copy(ROOT / "sample_clips/rotor_1.mp4", store / "listed.mp4")
    run("simulate", "-o", "run.h5", "--duration", "20", "--casing-fps", "100", "--rotor-fps", "300")
    for name, scale in (("t", 1.0), ("wheel", 1.0), ("other", 1.3)):
        rows = [wheel(0.02 * k, scale) for k in range(1500)]
        (store / f"{name}.csv").write_text("t [s],omega [rad/s],sigma [rad/s]\n" + "".join(rows))
        if name != "t":
            run("import", "--body", f"{name}.csv", "--inertia", "2e-3", "-o", f"{name}.h5")
            run("fit", f"{name}.h5")


def make_films(store, run):
    """Draw films, and track two of them."""
    shutil.rmtree(store / "films", ignore_errors=True)
    (store / "films").mkdir()
    times = [*INERTIAS, "--window-length", "0.6", "--casing-fps", "260", "--rotor-fps", "500"]
    run("simulate", "-o", "drawn.h5", "--film", "drawn", "--duration", "8", "--force", *times)
    for name, rate in (("casing", "260"), ("rotor_1", "500")):
        shutil.copy(store / f"drawn/{name}.mp4", store)
        run("extract", f"{name}.mp4", "--capture-fps", rate, "-o", f"{name}.h5", "--force")
    shutil.copy(store / "rotor_1.mp4", store / "films/a_500fps.mp4")
    shutil.copy(store / "drawn/rotor_2.mp4", store / "films/b_500fps.mp4")


def wheel(t, scale):
    """Return a line of a table: a wheel with dry friction and noise."""
    chance = random.Random(f"{t} {scale}")  # noqa: S311 - noise, not secrets
    return f"{t:.3f},{scale * (80 - 1.5 * t) + chance.gauss(0, 0.05):.5f},0.05\n"


def laid_out(store, needed, folder):
    """Make a fresh folder with the needed inputs."""
    temporary = folder.with_name(folder.name + ".tmp")
    for old in (folder, temporary):
        shutil.rmtree(old, ignore_errors=True)
    folder.mkdir()
    for name in needed:
        copy = shutil.copytree if (store / name).is_dir() else shutil.copy
        copy(store / name, folder / name)


def measured(name, store, folder):
    """Run a command undisturbed; return how long it takes [s] and which files it leaves."""
    words, needed = COMMANDS[name]
    laid_out(store, needed, folder)
    start = time.monotonic()
    code = begin(words, folder).wait()
    if code not in {0, 3}:
        raise SystemExit(f"cannot go on: {name} ends with {code}")
    return time.monotonic() - start, set(contents(folder))


def trial(name, store, folder, moment, expected, outcome):
    """Kill a command once, at a moment [s]."""
    words, needed = COMMANDS[name]
    laid_out(store, needed, folder)
    before = contents(folder)
    process = begin(words, folder)
    time.sleep(moment)
    process.kill()
    if process.wait() != -signal.SIGKILL:
        outcome.ended += 1
        return
    outcome.killed += 1
    after = contents(folder)
    wrong = []
    for path, old in before.items():
        if path not in after:
            wrong.append(f"{path} was lost")
        elif after[path] != old and not sound(folder / path):
            wrong.append(f"{path} is not sound")
    complete = set(after) == expected and all(sound(folder / p) for p in expected)
    with (folder.with_name("said")).open("w+") as said:
        code = begin(words, folder, stderr=said).wait()
        said.seek(0)
        text = said.read()
    if code == 1 and complete and "already exists" in text:
        outcome.finished += 1
    elif code not in {0, 3}:
        wrong.append(f"the next run ended with {code}: {text[-300:]}")
    files = set(contents(folder))
    wrong += [f"{p} was left" for p in sorted(files - expected)]
    wrong += [f"{p} is missing" for p in sorted(expected - files)]
    wrong += [f"{p} is not sound" for p in sorted(files) if not sound(folder / p)]
    temporary = folder.with_name(folder.name + ".tmp")
    wrong += [f"{p.name} was left among the temporary files" for p in temporary.iterdir()]
    outcome.wrong += [f"{name}, {moment:.3f} s: {what}" for what in wrong]


class Server:
    """The workbench's server on a folder, as the page talks to it."""

    def __init__(self, folder):
        words = ["view", "--folder", str(folder), "--no-browser", "--json"]
        self.process = begin(words, folder, stdout=subprocess.PIPE, text=True)
        self.address = json.loads(self.process.stdout.readline())["url"]
        self.opener = build_opener(HTTPCookieProcessor())
        self.opener.open(self.address, timeout=20).read()
        self.root = self.address.partition("?")[0]

    def ask(self, path, content=None):
        """Return the answer to a request; `content` is sent."""
        request = Request(self.root + path, content, {"Sec-Fetch-Site": "same-origin"})  # noqa: S310 - own server
        return json.loads(self.opener.open(request, timeout=20).read())

    def set(self, name, value):
        """Store an entry."""
        document = {"key": "", "name": name, "value": value}
        return self.ask("api/project/set", json.dumps(document).encode())


def server_trial(store, folder, moment, chance, outcome):
    """Kill the server while entries are stored and a file is received; what it has confirmed must be there again."""
    laid_out(store, ["t.csv", "listed.mp4"], folder)
    server, confirmed, sent = Server(folder), "", 0
    content = (store / "t.csv").read_bytes()
    end = time.monotonic() + moment
    pid = os.fork()
    if pid == 0:
        time.sleep(max(0.0, end - time.monotonic()))
        os.kill(server.process.pid, signal.SIGKILL)
        os._exit(0)
    try:
        while True:
            label = f"label {sent}"
            server.set("label", label)
            confirmed, sent = label, sent + 1
            if chance.random() < 0.2:
                server.ask(f"api/project/upload?name=u{sent}.csv", content)
    except (URLError, HTTPException, OSError, ValueError):
        pass
    os.waitpid(pid, 0)
    server.process.wait()
    server.process.stdout.close()
    outcome.killed += 1
    again = Server(folder)
    found = again.ask("api/project")
    label = found["fields"]["label"]
    if label not in {confirmed, f"label {sent}"}:
        outcome.wrong.append(f"view, {moment:.3f} s: {label!r} instead of {confirmed!r}")
    # the part of a file that had arrived is kept, listed, and completed when the file is sent again
    for upload in found["uploads"]:
        again.ask(f"api/project/upload?name={upload['name']}", content)
    again.process.send_signal(signal.SIGINT)
    if again.process.wait(timeout=20) != 0:
        outcome.wrong.append(f"view, {moment:.3f} s: ended with {again.process.returncode}")
    again.process.stdout.close()
    stray = [n for n in contents(folder) if n.startswith(".upload-") or n.endswith((".lock", ".unfinished"))]
    outcome.wrong += [f"view, {moment:.3f} s: {n} was left" for n in stray]
    half = [p.name for p in folder.glob("u*.csv") if p.read_bytes() != content]
    outcome.wrong += [f"view, {moment:.3f} s: {n} is incomplete" for n in half]


def kills(place, names, count, seed):
    """Kill each command equally often; return the outcomes by command."""
    store, chance = make(place, names), random.Random(seed)  # noqa: S311 - moments, not secrets
    outcomes = {name: Outcome() for name in names}
    for k, name in enumerate(names):
        share, folder = (count + k) // len(names), place / "work"
        outcome = outcomes[name]
        if name == "view":
            while outcome.killed < share:
                server_trial(store, folder, chance.uniform(0.0, 2.0), chance, outcome)
            continue
        seconds, expected = measured(name, store, folder)
        while outcome.killed < share:
            trial(name, store, folder, chance.uniform(0.0, seconds), expected, outcome)
        print(name, f"{seconds:.1f} s", outcome, flush=True)
    return outcomes


def main():
    """Run and report."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--commands", nargs="+", default=[*COMMANDS, "view"], choices=[*COMMANDS, "view"])
    asked = parser.parse_args()
    began = time.monotonic()
    outcomes = kills(asked.work.resolve() / "kill", asked.commands, asked.count, asked.seed)
    total = Counter()
    for outcome in outcomes.values():
        total.update(killed=outcome.killed, ended=outcome.ended, finished=outcome.finished)
    failures = [what for outcome in outcomes.values() for what in outcome.wrong]
    from common import report

    report("kill -9", began, **total, failures=len(failures), first_failures=failures[:20])


if __name__ == "__main__":
    main()
