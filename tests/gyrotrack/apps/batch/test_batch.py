"""The command as a user runs it: real films, real processes, a real cluster."""

import csv
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time

import pytest

from gyrotrack import read_recording
from gyrotrack.apps.batch._workers import Child, LocalWorkers, checked, run_once

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def films(casing_clip, rotor_clip, tmp_path_factory, program):
    """Six good films, three bad ones, and a case that exists already, with a manifest of them all."""
    folder = tmp_path_factory.mktemp("batch films")
    for i in range(3):
        film = casing_clip[0].read_bytes() + b"\0\0\0\x08free" * i  # other contents, the same pictures
        (folder / f"wheel {i}.mp4").write_bytes(film)
    (folder / "cut.mp4").write_bytes(casing_clip[0].read_bytes()[:20_000])
    (folder / "\x1b[31mred.mp4").write_text("no film")
    shutil.copy(rotor_clip[0], folder / "rotor.mp4")
    assert (
        program(["simulate", "-o", str(folder / "old.h5"), "--duration", "12", "--window-length", "1"]) == 0
    )
    names = sorted(p.name for p in folder.glob("*.mp4"))
    text = "".join(
        f"[[clip]]\nfile = {json.dumps(n)}\ncapture_fps = {260 if 'w' in n else 1000}\n" for n in names
    )
    (folder / "few.toml").write_text("".join(f"[[clip]]\nfile = 'wheel {i}.mp4'\n" for i in range(3)))
    (folder / "m.toml").write_text(text + '[[clip]]\nfile = "missing.mp4"\n[[case]]\ndata = "old.h5"\n')
    return folder


@pytest.fixture
def batch(films, tmp_path, capsys, program):
    """Run the command on the films: batch("--until", "fit") -> (exit code, document)."""

    def run(*words, source="m.toml"):
        capsys.readouterr()
        code = program(["batch", str(films / source), "-o", str(tmp_path / "out"), "--json", *words])
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return code, json.loads(said.out)

    return run


@pytest.mark.slow
@pytest.mark.release
def test_a_batch_from_films_to_fit_and_again(batch, tmp_path, capsys):
    code, plan = batch("--dry-run", "--until", "fit")
    assert code == 0
    assert {s["state"] for s in plan["steps"]} == {"to do"}
    assert not (tmp_path / "out").exists()

    code, said = batch("--until", "fit", "--workers", "2")
    assert code == 1
    assert said["steps"] == {"done": 5, "kept": 0, "failed": 3, "blocked": 0}
    rows = {r["label"]: r for r in said["cases"]}
    assert {label for label, r in rows.items() if r["state"] != "done"} == {"cut", "missing", "\x1b[31mred"}
    assert "no file" in rows["missing"]["problem"]
    assert rows["wheel 1"]["frames"] == 100
    assert rows["old"]["fit"]
    assert read_recording(tmp_path / "out" / "wheel_2" / "wheel_2.h5").frames_decoded == 100
    with (tmp_path / "out" / "summary.csv").open(newline="") as stream:
        assert [r["label"] for r in csv.DictReader(stream)] == list(rows)

    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "out").rglob("*.h5")}
    code, said = batch("--until", "fit")
    assert said["steps"] == {"done": 0, "kept": 5, "failed": 3, "blocked": 0}
    assert {p: p.stat().st_mtime_ns for p in before} == before


def test_names_of_files_are_shown_and_not_obeyed(films, tmp_path, capsys, program):
    (tmp_path / "\x1b[31mred\u202e").mkdir()
    shutil.copy(films / "cut.mp4", tmp_path / "\x1b[31mred\u202e" / "a\x9bb.mp4")
    assert program(["batch", str(tmp_path), "-o", str(tmp_path / "out"), "--until", "extract"]) == 1
    said = capsys.readouterr()
    assert not {"\x1b", "\x9b", "\u202e"} & set(said.out + said.err)
    assert "\\x1b[31mred" in said.out
    assert "\\x1b[31mred" in said.err


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the cluster's own libraries
@pytest.mark.release
def test_a_cluster_whose_worker_is_killed(batch, films, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        killed = []

        def kill():
            deadline = time.monotonic() + 60
            while time.monotonic() < deadline and not killed:
                time.sleep(0.05)
                if list((tmp_path / "out").glob("*/*.h5")):  # one film is done, others are at work
                    busy = [w.name for w in cluster.scheduler.workers.values() if w.processing]
                    if busy:
                        killed.append(cluster.workers[busy[0]].pid)
                        os.kill(killed[0], signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        code, said = batch("--scheduler", cluster.scheduler_address, source="few.toml")
        killer.join()
    assert killed, "no worker had a film to lose"
    assert "error" not in said, said
    assert [r["problem"] for r in said["cases"]] == [""] * 3
    assert code == 0
    assert said["steps"] == {"done": 3, "kept": 0, "failed": 0, "blocked": 0}
    for i in range(3):
        assert read_recording(tmp_path / "out" / f"wheel_{i}" / f"wheel_{i}.h5").frames_decoded == 100
    assert not list((tmp_path / "out").rglob("*.part"))


@pytest.mark.filterwarnings("default")  # of the cluster's own libraries
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
@pytest.mark.release
def test_an_interrupted_batch_leaves_no_step_on_the_cluster(batch, films, tmp_path, number):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        words = [
            "batch",
            films / "few.toml",
            "-o",
            tmp_path / "out",
            "--scheduler",
            cluster.scheduler_address,
        ]
        process = subprocess.Popen([sys.executable, "-P", "-m", "gyrotrack", *map(str, words), "-q"])
        deadline = time.monotonic() + 60
        while not list((tmp_path / "out").glob("*/*.unfinished")) and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(number)
        assert process.wait(30) == (130 if number == signal.SIGINT else -number)
        if number == signal.SIGINT:  # what was begun has ended with the command
            assert not list((tmp_path / "out").rglob("*.part"))
            assert not list((tmp_path / "out").rglob(".*.lock"))
        code, said = batch("--scheduler", cluster.scheduler_address, source="few.toml")
    assert code == 0, said
    assert [r["problem"] for r in said["cases"]] == [""] * 3
    assert not list((tmp_path / "out").glob("batch.running.*"))


@pytest.mark.filterwarnings("default")
def test_a_scheduler_that_is_lost_ends_in_a_summary(batch, films, tmp_path):
    pytest.importorskip("distributed")
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    dask = [
        sys.executable,
        "-m",
        "distributed.cli.dask_scheduler",
        "--no-dashboard",
        "--port",
        address[-5:].lstrip(":"),
    ]
    worker = [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        address,
        "--nthreads",
        "1",
        "--no-dashboard",
    ]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(dask, **quiet) as scheduler, subprocess.Popen(worker, **quiet) as work:

        def kill():
            deadline = time.monotonic() + 60
            while not list((tmp_path / "out").glob("*/*.unfinished")) and time.monotonic() < deadline:
                time.sleep(0.02)
            scheduler.kill()

        killer = threading.Thread(target=kill)
        killer.start()
        try:
            code, said = batch("--scheduler", address, source="few.toml")
        finally:
            killer.join()
            work.kill()
            scheduler.kill()
    assert code == 1
    assert "error" not in said
    assert said["steps"]["failed"] >= 1
    assert "lost" in " ".join(r["problem"] for r in said["cases"])
    assert (tmp_path / "out" / "summary.json").is_file()


def test_no_scheduler_at_the_address(batch, monkeypatch):
    distributed = pytest.importorskip("distributed")

    def refuse(*args, **kwargs):
        raise OSError("Timed out trying to connect")

    monkeypatch.setattr(distributed, "Client", refuse)
    code, said = batch("--scheduler", "tcp://127.0.0.1:1")
    assert code == 1
    assert "does not answer" in said["error"]["message"]


def test_a_process_that_dies_is_reported_and_replaced():
    child = Child()
    child.run(["info", "nothing.h5"])
    first = child._process.pid
    threading.Timer(0.3, os.kill, (first, signal.SIGKILL)).start()
    end = time.monotonic() + 20
    while time.monotonic() < end:
        answer = child.run(["info", "nothing.h5"])
        if answer["document"]["error"]["code"] == "crash":
            break
    assert "signal 9" in answer["document"]["error"]["message"]
    assert child.run(["info", "nothing.h5"])["document"]["error"]["code"] == "dataset"
    assert child._process.pid != first
    child.close()


def test_a_step_that_takes_too_long_is_stopped(films):
    words = ["extract", str(films / "wheel 0.mp4"), "-o", str(films / "never.h5")]
    answer = checked(run_once(words, timeout=0.3))
    assert answer["document"]["error"]["code"] == "timeout"
    assert not (films / "never.h5").exists()


def test_workers_end_with_us(films):
    workers = LocalWorkers(1)
    future = workers.submit(["extract", str(films / "wheel 0.mp4"), "-o", str(films / "never2.h5")], None)
    while not workers._children or workers._children[0]._process is None:
        time.sleep(0.01)
    pid = workers._children[0]._process.pid
    workers.close()
    assert future.result()["document"]["error"]["code"] == "crash"
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert not (films / "never2.h5").exists()


def test_a_worker_ends_when_its_master_is_killed(films):
    """As after kill -9 of the batch: the pipe closes, and the worker stops in the middle of its film."""
    child = Child()
    answers = []
    words = ["extract", str(films / "wheel 0.mp4"), "-o", str(films / "never3.h5")]
    thread = threading.Thread(target=lambda: answers.append(child.run(words)))
    thread.start()
    while child._process is None:
        time.sleep(0.01)
    process = child._process
    time.sleep(0.2)
    process.stdin.close()
    process.wait(timeout=20)
    thread.join()
    assert answers[0]["document"]["error"]["code"] == "crash"
    assert not (films / "never3.h5").exists()
