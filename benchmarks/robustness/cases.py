"""Hostile folders, scarce machines, containers, signals: one command runs the table of these cases.

    python benchmarks/robustness/cases.py --work DIR [--only WORD] [--write]

Each case runs one command in a folder of its own, in which an earlier output lies where the command may write. It
counts a *hang* (no end within 60 s while it used less than 10 s of CPU, or no end within 240 s), a *bug* ("A bug in"
or a traceback), a *damaged* old result (changed although the command failed), a *leftover* (a new file after a
failure, but for a resumable ``.unfinished``), and a *breach* (foreign code ran, a connection was opened, a file was
written outside the folder). `--write` writes the table to cases.md. Cases that need root, namespaces or strace are
skipped, and counted, where these are missing.
"""

import argparse
import hashlib
import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from common import ROOT, commit, ensure, films

PYTHON = sys.executable
HANG, LONGEST, IDLE = 60.0, 240.0, 10.0
UNKNOWN = 54321  # a user that is in no table
MB = 2**20


@dataclass
class Case:
    """One command: its words, what is done to the process and to the folder, and what it must answer."""

    group: str
    name: str
    words: list
    prefix: list = field(default_factory=list)  # another program that starts ours
    limits: dict = field(default_factory=dict)  # resource limits
    prepare: object = None  # called with the folder
    beside: object = None  # context manager, called with the folder
    stop: object = None  # (signal, what must be there before it is sent)
    environment: dict = field(default_factory=dict)
    without: tuple = ()  # variables to remove
    codes: tuple = (0, 1, 2, 3)
    after: float = 0.0  # s before which nothing is sent
    keeps: tuple = ()  # complete outputs that may stay after a failure


def program(words):
    """Return the command line that an installed script would run."""
    return [PYTHON, "-P", "-c", "from gyrotrack.apps.cli._start import main; main()", *map(str, words)]


def state(folder):
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and not p.is_symlink()
    }


def run(case, stock, work):
    folder = work / "run" / f"{case.group} {case.name}".replace("/", "_").replace(" ", "_")[:80]
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(stock, folder / "here")
    here, outside = folder / "here", folder / "outside"
    outside.mkdir()
    (outside / "victim.h5").write_bytes(b"old")
    if case.prepare:
        case.prepare(here)
    if "setpriv" in case.prefix:
        subprocess.run(["chown", "-R", f"{UNKNOWN}:{UNKNOWN}", here], check=True)
        for place in (work, work / "run", folder):
            place.chmod(0o755)
    before, victims = state(here), state(outside)
    environment = {k: v for k, v in os.environ.items() if k not in {"PYTHONPATH", *case.without}}
    environment |= {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", **case.environment}

    def limit():
        for name, value in case.limits.items():
            resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), (value, value))

    began, used = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    context = case.default_for(here) if case.beside else None
    if context is not None:
        context.__enter__()
    with (folder / "out").open("wb") as out, (folder / "err").open("wb") as err:
        words = [*case.prefix, *program(case.words)]
        process = subprocess.Popen(
            words, cwd=here, env=environment, stdout=out, stderr=err, stdin=subprocess.DEVNULL,
            preexec_fn=limit, start_new_session=True,
        )  # fmt: skip
        code, hang = None, False
        while code is None:
            code = process.poll()
            waited = time.monotonic() - began
            if case.stop and code is None and waited > case.after and any(here.glob(case.stop[1])):
                process.send_signal(case.stop[0])
                case.stop = None
            if code is None and (waited > LONGEST or (waited > HANG and cpu_of(process.pid) < IDLE)):
                hang = True
                os.killpg(process.pid, signal.SIGKILL)
                code = process.wait()
            time.sleep(0.02)
    if context is not None:
        context.__exit__(None, None, None)
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = time.monotonic() - began
    said = (folder / "out").read_text(errors="replace") + (folder / "err").read_text(errors="replace")
    after = state(here)
    failed = code not in {0, 3}
    new = sorted(set(after) - set(before))
    leftovers = [n for n in new if n.endswith(".part") or (failed and not allowed(n) and n not in case.keeps)]
    damaged = [n for n in before if failed and after.get(n) != before[n] and not allowed(n)]
    breach = state(outside) != victims or (here / "ran").exists() or connected(here)
    return {
        "group": case.group,
        "name": case.name,
        "code": code,
        "seconds": round(seconds, 1),
        "cpu": round(now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime, 1),
        "hang": hang,
        "bug": "A bug in" in said
        or "Traceback" in said
        or (code is not None and code < 0 and not hang and code not in case.codes),
        "damaged": damaged,
        "leftovers": leftovers,
        "breach": breach,
        "unexpected": code not in case.codes,
        "said": next((line for line in said.splitlines() if line.startswith("error")), "")[:150],
    }


def allowed(name):
    """Tell whether a file may be there after a failure: checkpoints, the journal of a batch, the history of fits."""
    return (
        name.endswith((".unfinished", ".lock", ".jsonl", ".fits.json"))
        or name.startswith(("gyrotrack_batch/", "gyrotrack_demo/", "trace"))
    )  # fmt: skip


def cpu_of(pid):
    """Return the CPU time [s] of a process and its children."""
    total = 0.0
    try:
        children = subprocess.run(
            ["ps", "-o", "pid=", "-g", str(pid)], capture_output=True, text=True, check=False
        )
        for one in {str(pid), *children.stdout.split()}:
            fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
            total += sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        pass
    return total


def connected(here):
    """Tell whether a trace of system calls shows a connection to the network or a foreign program."""
    for trace in here.glob("trace*"):
        for line in trace.read_text(errors="replace").splitlines():
            if "connect(" in line and ("AF_INET" in line) and 'sin_addr=inet_addr("127.0.0.1")' not in line:
                return True
            if "execve(" in line and "/here/" in line.partition("execve(")[2].partition(",")[0]:
                return True
    return False


class Listener:
    """A scheduler that nobody may call: notes a connection."""

    def __init__(self, here):
        self.here = here
        self.socket = socket.create_server(("127.0.0.1", 47861))

    def __enter__(self):
        threading.Thread(target=self.accept, daemon=True).start()
        return self

    def accept(self):
        try:
            self.socket.accept()
            (self.here / "ran").write_text("connected")
        except OSError:
            pass

    def __exit__(self, *_):
        with suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)  # wakes the thread that waits in accept
        self.socket.close()


class Held:
    """Another program that holds the lock of a file."""

    def __init__(self, name):
        self.name = name

    def __call__(self, here):
        self.here = here
        return self

    def __enter__(self):
        code = (
            "import sys, time; from pathlib import Path; from gyrotrack.io._atomic import locked\n"
            "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(600)"
        )
        self.process = subprocess.Popen(
            [PYTHON, "-c", code, str(self.here / self.name)],
            env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE,
        )  # fmt: skip
        self.process.stdout.readline()

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()


def write(name, text):
    def prepare(here):
        path = here / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    return prepare


def fifo(name):
    def prepare(here):
        (here / name).unlink(missing_ok=True)
        os.mkfifo(here / name)

    return prepare


def together(*steps):
    def prepare(here):
        for step in steps:
            step(here)

    return prepare


def module_traps(here):
    for name in (
        "json",
        "queue",
        "numpy",
        "typer",
        "multiprocessing",
        "gyrotrack",
        "fitting",
        "sitecustomize",
    ):
        (here / f"{name}.py").write_text(f"open({str(here / 'ran')!r}, 'a').write({name!r})\n")


def linked_case(here):
    import h5py

    with h5py.File(here / "case.h5", "r+") as file:
        del file["casing"]
        file["casing"] = h5py.ExternalLink("/etc/passwd", "/")


def material(work):
    """Make films, recordings, a case and an old result of each kind once; return their folder."""
    stock = work / "stock"
    if (stock / "ready").exists():
        return stock
    shutil.rmtree(stock, ignore_errors=True)
    stock.mkdir(parents=True)
    source = films(work)
    inertias = ["--inertia-rotor", "4.2e-6", "--inertia-casing", "1.6e-6"]
    for name in ("casing", "rotor_1"):
        shutil.copy(source / f"{name}.mp4", stock)
        rate = "260" if name == "casing" else "500"
        words = ["extract", f"{name}.mp4", "--capture-fps", rate, "-o", f"{name}.h5", "-q"]
        subprocess.run(program(words), cwd=stock, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
                       stdout=subprocess.DEVNULL)  # fmt: skip
    for words in (
        ["simulate", "-o", "case.h5", "--duration", "30", "--add", "casing.air.quadratic", "-q", *inertias],
        ["fit", "case.h5", "-q"],
    ):
        subprocess.run(program(words), cwd=stock, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
                       stdout=subprocess.DEVNULL)  # fmt: skip
    for name in ("old.h5", "old.html", "old.pdf", "old.csv", "old.tex", "old.toml", "old.png", "old.mp4"):
        (stock / name).write_bytes(b"an old result")
    (stock / "casing.csv").write_text("t,angle\n" + "".join(f"{i / 100},{3 * i / 100}\n" for i in range(300)))
    (stock / "manifest.toml").write_text('[[clip]]\nfile = "casing.mp4"\ncapture_fps = 260\n')
    (stock / "ready").write_text("")
    return stock


EXTRACT = ["extract", "casing.mp4", "--capture-fps", "260", "-o", "old.h5", "--force", "-q"]
SIMULATE = ["simulate", "-o", "new.h5", "--film", "new", "--duration", "60", "--window-length", "1"]
COMMANDS = {
    "config": ["config"],
    "info": ["info", "case.h5"],
    "fit": ["fit", "case.h5"],
    "diagnose": ["diagnose", "case.h5"],
    "improve": ["improve", "case.h5"],
    "extract": EXTRACT,
    "profile": ["profile", "rotor_1.mp4", "-o", "old.toml", "--picture", "old.png", "--force"],
    "scan": ["scan", "case.h5", "--latex", "old.tex", "--csv", "old.csv", "--force", "-q"],
    "report html": ["report", "case.h5", "-o", "old.html", "--force"],
    "report pdf": ["report", "case.h5", "-o", "old.pdf", "--force"],
    "export": ["export", "case.h5", "-o", "old.csv", "--force"],
    "batch": ["batch", "manifest.toml", "--until", "extract"],
}
_RIGHTS = "+dac_override,+dac_read_search"  # where Python itself lies in another user's home
NO_USER = [
    "setpriv", f"--reuid={UNKNOWN}", f"--regid={UNKNOWN}", "--clear-groups",
    f"--inh-caps={_RIGHTS}", f"--ambient-caps={_RIGHTS}",
]  # fmt: skip


def cases(work):
    found = []

    def case(group, name, words, **options):
        found.append(Case(group, name, words, **options))

    home = {"without": ("HOME", "XDG_CONFIG_HOME", "USER", "LOGNAME")}
    for name in (
        "config",
        "info",
        "fit",
        "diagnose",
        "extract",
        "report html",
        "report pdf",
        "batch",
        "profile",
    ):
        case("container", f"no home, unknown user: {name}", COMMANDS[name], prefix=NO_USER, **home)
    mounts = 'mount -t tmpfs -o ro none /dev/shm && exec "$@"'
    for name in ("fit", "improve", "batch", "extract"):
        case(
            "container",
            f"no /dev/shm: {name}",
            COMMANDS[name],
            prefix=["unshare", "-m", "sh", "-c", mounts, "sh"],
        )
    frozen = (
        f"mount --bind {work} {work} && mount -o remount,ro,bind / && mount -t tmpfs -o ro none /tmp.ro 2>/dev/null; "
        'exec "$@"'
    )
    for name in ("config", "fit", "extract", "report html", "batch"):
        case(
            "container",
            f"read-only root: {name}",
            COMMANDS[name],
            prefix=["unshare", "-m", "sh", "-c", frozen, "sh"],
        )
    for size in (512,):
        for name in ("info", "fit", "diagnose", "extract", "report html", "batch"):
            case("container", f"{size} MB: {name}", COMMANDS[name], limits={"AS": size * MB})
    case(
        "container",
        "demo, no home, unknown user",
        ["demo", "--clips", ROOT / "sample_clips"],
        prefix=NO_USER,
        **home,
    )

    for size in (250, 350, 450, 600):
        for name in ("extract", "improve", "scan", "report pdf"):
            case("memory", f"{size} MB: {name}", COMMANDS[name], limits={"AS": size * MB})
    for count in (1, 2, 4):
        for name in ("fit", "improve", "extract", "batch", "report html"):
            few = [*NO_USER, "prlimit", f"--nproc={count}"]
            case("processes", f"ulimit -u {count}: {name}", COMMANDS[name], prefix=few, **home)
    for count in (8, 16, 32):
        for name in ("fit", "improve", "extract", "batch", "report pdf"):
            case("files", f"ulimit -n {count}: {name}", COMMANDS[name], limits={"NOFILE": count})
    for size in (0, 4096):
        for name in ("extract", "profile", "scan", "report html", "report pdf", "export"):
            case(
                "disk",
                f"file size limit {size}: {name}",
                COMMANDS[name],
                limits={"FSIZE": size},
                prepare=None,
            )

    for number, name in ((signal.SIGTERM, "SIGTERM"), (signal.SIGINT, "SIGINT")):
        codes = (143,) if number == signal.SIGTERM else (130,)
        case("signals", f"{name}: simulate --film", SIMULATE, stop=(number, "new/*.part"), codes=codes)
        case("signals", f"{name}: extract", EXTRACT, stop=(number, "old.h5.*"), codes=codes)
        case("signals", f"{name}: extract --overlay",
             ["extract", "casing.mp4", "--capture-fps", "260", "-o", "new.h5", "--overlay", "old.mp4", "--force"],
             stop=(number, "*.mp4.part"), codes=codes, keeps=("new.h5",))  # fmt: skip
        case(
            "signals",
            f"{name}: batch",
            COMMANDS["batch"],
            stop=(number, "gyrotrack_batch/*/*.unfinished"),
            codes=codes,
        )
        case(
            "signals",
            f"{name}: scan",
            COMMANDS["scan"],
            stop=(number, "case.h5"),
            after=3.0,
            codes=(*codes, 0),
        )

    for name, words in {
        "film": ["extract", "pipe", "--capture-fps", "260", "-o", "old.h5", "--force"],
        "case": ["fit", "pipe"],
        "info": ["info", "pipe"],
        "table": ["import", "--body", "pipe", "--inertia", "2e-3", "-o", "new.h5"],
        "manifest": ["batch", "pipe"],
        "profile": [*EXTRACT, "--profile", "pipe"],
        "effects": ["fit", "case.h5", "--effects", "pipe"],
        "model": ["fit", "case.h5", "--model", "pipe"],
        "settings": ["--config", "pipe", "effects"],
        "ledger": ["fit", "case.h5", "--ledger", "pipe"],
        "output": ["export", "case.h5", "-o", "pipe", "--force"],
        "seal": ["reveal", "pipe", "--answer", "none"],
        "points": ["import", "--body", "pipe", "--inertia", "2e-3", "--marker", "a", "-o", "new.h5"],
    }.items():
        case("pipes", name, words, prepare=fifo("pipe"))
    case("pipes", "found settings", ["effects"], prepare=fifo("gyrotrack.toml"))
    case("pipes", "part of the output", EXTRACT, prepare=fifo("old.h5.part"))
    case("pipes", "checkpoint", [*EXTRACT, "--resume"], prepare=fifo("old.h5.unfinished"))
    case("pipes", "part of the ledger", COMMANDS["fit"], prepare=fifo("case.fits.json.part"))
    case("pipes", "journal of a batch", COMMANDS["batch"],
         prepare=together(write("gyrotrack_batch/batch.lock", ""), fifo("gyrotrack_batch/batch.jsonl")))  # fmt: skip
    for name, words in {"case.fits.json": COMMANDS["fit"], "old.csv": COMMANDS["export"], "old.h5": EXTRACT,
                        "gyrotrack_batch": COMMANDS["batch"]}.items():  # fmt: skip
        case("locks", f"{name} is held by another program", words, beside=Held(name))

    traced = ["strace", "-f", "-qq", "-e", "trace=connect,execve", "-o", "trace"]
    hostile = {
        "scheduler": ('[batch]\nscheduler = "tcp://127.0.0.1:47861"\n', COMMANDS["batch"]),
        "output elsewhere": (
            '[extract]\noutput = "../outside/victim.h5"\nforce = true\n',
            ["extract", "casing.mp4"],
        ),
        "ledger elsewhere": ('[fit]\nledger = "../outside/victim.h5"\n', COMMANDS["fit"]),
        "port": ("[view]\nport = 22\n", ["view", "case.h5"]),
        "depth": ("a = " + "[" * 5000, ["effects"]),
    }
    for name, (text, words) in hostile.items():
        case("hostile", f"settings: {name}", words, prepare=write("gyrotrack.toml", text), beside=Listener,
             prefix=traced, codes=(1,))  # fmt: skip
    tilde = "~/.config/gyrotrack/gyrotrack.toml"
    case("hostile", "settings in a folder named ~", COMMANDS["batch"], prefix=NO_USER, beside=Listener,
         prepare=write(tilde, hostile["scheduler"][0]), **home)  # fmt: skip
    for name in ("fit", "improve", "batch", "report html"):
        case(
            "hostile",
            f"modules in the folder: {name}",
            COMMANDS[name],
            prepare=module_traps,
            prefix=traced,
            codes=(0, 3),
        )
    rc = "text.usetex: True\nbackend: module://evil\nsavefig.directory: ../outside\n"
    case("hostile", "matplotlibrc", COMMANDS["report html"], codes=(0, 3), prefix=traced,
         prepare=together(write("matplotlibrc", rc), write("evil.py", "open('ran', 'w')\n")))  # fmt: skip
    manifests = {
        "label": '[[clip]]\nlabel = "../../outside/victim"\nfile = "casing.mp4"\ncapture_fps = 260\n',
        "address": '[[clip]]\nfile = "http://127.0.0.1:47861/a.mp4"\n',
        "playlist": '[[clip]]\nfile = "list.mp4"\n',
        "option": '[[clip]]\nfile = "--help"\n',
        "key": '[defaults]\nscheduler = "tcp://127.0.0.1:47861"\n',
    }
    playlist = write("list.mp4", "#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:47861/a.ts\n")
    for name, text in manifests.items():
        case("hostile", f"manifest: {name}", COMMANDS["batch"], beside=Listener, prefix=traced,
             prepare=together(write("manifest.toml", text), playlist))  # fmt: skip
    case("hostile", "profile: unknown keys", [*EXTRACT, "--profile", "p.toml"],
         prepare=write("p.toml", "exec = 'id'\n[marker]\n"), prefix=traced)  # fmt: skip
    for name, text in {
        "not JSON": "{", "depth": "[" * 100_000, "wrong form": '{"fits": [{"fit_id": 1}]}',
        "law": json.dumps({"fits": [{"fit_id": "f1", "model": ["casing: __import__('os').system('touch ran')"]}]}),
    }.items():  # fmt: skip
        case("hostile", f"ledger: {name}", COMMANDS["fit"], prepare=write("case.fits.json", text), prefix=traced,
             codes=(1,))  # fmt: skip
    case(
        "hostile",
        "case with an external link",
        COMMANDS["fit"],
        prepare=linked_case,
        prefix=traced,
        codes=(1,),
    )
    for law in ("casing: k/(omega_c-5)", "casing: k*(omega_c-10)**-2", "casing: __import__('os').system('touch ran')",
                "casing: " + "(" * 3000, "casing: k*9**9**9**9"):  # fmt: skip
        case("formulas", law[:40], ["fit", "case.h5", "--add", law], codes=(0, 1, 2))
    return found


def possible(case):
    """Tell whether this machine can run a case."""
    if not case.prefix:
        return True
    if shutil.which(case.prefix[0]) is None or (case.prefix[0] != "strace" and os.geteuid() != 0):
        return False
    if case.prefix[0] == "unshare":
        return subprocess.run([*case.prefix, "true"], capture_output=True, check=False).returncode == 0
    return True


def table(rows, skipped):
    kinds = ("hang", "bug", "damaged", "leftovers", "breach", "unexpected")
    lines = [
        "# Robustness: the table of cases",
        "",
        f"Made by `python benchmarks/robustness/cases.py --write`; {len(rows)} cases run at the commits",
        f"{', '.join(sorted({r['commit'] for r in rows}))}, {skipped} not possible on this machine.",
        "The docstring of the script describes what is counted.",
        "",
        "| group | cases | hangs | bug messages | damaged | leftovers | breaches | other exit code | slowest [s] |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for group in [*dict.fromkeys(r["group"] for r in rows), "all"]:
        own = [r for r in rows if group in {"all", r["group"]}]
        counts = " | ".join(str(sum(bool(r[k]) for r in own)) for k in kinds)
        lines.append(f"| {group} | {len(own)} | {counts} | {max(r['seconds'] for r in own):.0f} |")
    bad = [r for r in rows if any(r[k] for k in kinds)]
    if bad:
        lines += ["", "What did not hold:", ""]
        for r in bad:
            faults = ", ".join(f"{k}: {r[k]}" if isinstance(r[k], list) else k for k in kinds if r[k])
            lines.append(
                f"- {r['group']}, {r['name']}: {faults}; exit {r['code']} after {r['seconds']} s. {r['said']}"
            )
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, default=Path("gyrotrack_cases"))
    parser.add_argument("--only", default="")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    work = options.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    stock = material(work)
    ensure((stock / "case.h5").exists(), "no case")
    rows, skipped = [], 0
    for case in cases(work):
        if options.only not in f"{case.group} {case.name}":
            continue
        if not possible(case):
            skipped += 1
            continue
        row = run(case, stock, work)
        rows.append(row)
        kinds = ("hang", "bug", "damaged", "leftovers", "breach", "unexpected")
        flags = " ".join(k.upper() for k in kinds if row[k])
        print(
            f"{row['code']!s:>4} {row['seconds']:6.1f} s  {case.group}: {case.name}  {flags}  {row['said']}",
            flush=True,
        )
    store = work / "rows.json"  # rows of earlier runs stay until their case is run again
    known = json.loads(store.read_text()) if store.exists() else {}
    known |= {f"{r['group']}: {r['name']}": r | {"commit": commit()} for r in rows}
    store.write_text(json.dumps(known, indent=1))
    text = table(list(known.values()), skipped)
    print(text)
    if options.write:
        Path(__file__).with_suffix(".md").write_text(text)
    return int(any(r[k] for r in rows for k in ("hang", "bug", "damaged", "leftovers", "breach")))


if __name__ == "__main__":
    sys.exit(main())
