"""Files in the working folder run no code, open no connection and write nowhere else."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from gyrotrack.apps.cli._app import COMMANDS
from gyrotrack.apps.cli._settings import FOUND, REFUSED, VARIABLE, options_of


@pytest.fixture
def here(tmp_path, monkeypatch):
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "user"))
    monkeypatch.delenv(VARIABLE, raising=False)
    return folder


def program(*words, **options):
    """Start the program as the installed script does, in a process of its own."""
    code = "import sys; from gyrotrack.apps.cli._start import main; main()"
    return subprocess.Popen(
        [sys.executable, "-P", "-c", code, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def test_every_option_is_judged():
    """A new option must be put on the list of what a found file may set, or on the other."""
    keys = {key for entry in COMMANDS for key in options_of(entry).values()}
    assert keys <= FOUND | REFUSED
    assert not FOUND & REFUSED


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ('[batch]\nscheduler = "tcp://203.0.113.7:8786"\n', "line 2, batch.scheduler"),
        ('[batch]\ntls_ca = "ca.pem"\n', "line 2, batch.tls_ca"),
        ("[view]\nport = 80\n", "line 2, view.port"),
        ("[view]\nbrowser = true\n", "line 2, view.browser"),
        ("[extract]\nforce = true\n", "line 2, extract.force"),
        ('[extract]\noutput = "../victim.h5"\n', "line 2, extract.output"),
        ('[fit]\nledger = "/tmp/victim.json"\n', "line 2, fit.ledger"),
        ('[report]\nfilms = ["films", "/mnt/other"]\n', "line 2, report.films"),
        ('[fit]\nmodel = "../model.toml"\n', "line 2, fit.model"),
        ('[extract]\noverlay = "link/o.mp4"\n', "line 2, extract.overlay"),
        ('[extract]\nprofile = "//server/share/p.toml"\n', "line 2, extract.profile"),
    ],
)
def test_a_found_file_reaches_no_further_than_its_folder(gyrotrack, here, text, place):
    (here / "link").symlink_to(here.parent)
    (here / "gyrotrack.toml").write_text(text)
    said = gyrotrack("effects")
    assert said.code == 1
    assert place in said.err
    assert "found in the working folder" in said.err
    # the same file as the user's own word
    assert gyrotrack("--config", "gyrotrack.toml", "effects").code == 0


def test_a_found_file_may_set_what_is_computed(gyrotrack, here):
    (here / "gyrotrack.toml").write_text(
        '[extract]\ncapture_fps = 260\nprofile = "p.toml"\n[batch]\noutput = "results"\n[fit]\nmodel = "general"\n'
    )
    assert gyrotrack("effects").code == 0


@pytest.mark.slow
def test_a_scheduler_comes_from_the_environment_or_the_users_file(gyrotrack, here, monkeypatch):
    distributed = pytest.importorskip("distributed")
    asked = []

    def refuse(address, **options):
        asked.append((address, options.get("security")))
        raise OSError("no")

    monkeypatch.setattr(distributed, "Client", refuse)
    (here / "a.mp4").write_bytes(b"")
    (here.parent / "user" / "gyrotrack").mkdir(parents=True)
    (here.parent / "user" / "gyrotrack" / "gyrotrack.toml").write_text(
        '[batch]\nscheduler = "tcp://mine:1"\n'
    )
    assert "does not answer" in gyrotrack("batch", ".").err
    monkeypatch.setenv("GYROTRACK_SCHEDULER", "tcp://environment:1")
    assert "neither encrypted" in gyrotrack("batch", ".").err
    assert [address for address, _ in asked] == ["tcp://mine:1", "tcp://environment:1"]
    said = gyrotrack("batch", ".", "--scheduler", "tls://host:1")
    assert "--tls-ca" in said.err
    for name in ("ca", "cert", "key"):
        (here / f"{name}.pem").write_text("")
        monkeypatch.setenv(f"GYROTRACK_TLS_{name.upper()}", f"{name}.pem")
    gyrotrack("batch", ".", "--scheduler", "tls://host:1")
    assert asked[-1][0] == "tls://host:1"
    assert asked[-1][1].require_encryption
    said = gyrotrack("batch", ".", "--scheduler", "tcp://host:1")
    assert "tls://HOST:PORT" in said.err
    assert len(asked) == 3


def test_answers_of_a_cluster_are_parsed_not_unpickled():
    from gyrotrack.apps.batch._workers import checked, run_once

    raw = run_once(["info", "no.h5"])
    assert isinstance(raw, bytes)
    assert checked(raw)["document"]["error"]["code"] == "dataset"
    for bad in (b"", b"\x80\x04K\x01.", b"[1]", b'{"code": "0", "document": {}}', b"[" * 100_000):
        assert checked(bad)["document"]["error"]["code"] == "crash"
    assert checked(b'{"code": 0, "document": {}, "version": "9.9"}')["document"]["error"]["code"] == "version"


@pytest.mark.slow
def test_no_module_of_the_working_folder_is_imported(here, simulated):
    """Neither by the worker processes of a batch nor by those of a diagnosis."""
    for name in ("json", "queue", "multiprocessing", "numpy", "typer", "gyrotrack"):
        (here / f"{name}.py").write_text(f"open({str(here / 'ran')!r}, 'a').write({name!r})\n")
    (here / "m.toml").write_text(f"[[case]]\ndata = {json.dumps(str(simulated / 'plain.h5'))}\n")
    with program("batch", "m.toml", "--until", "fit", "--json", cwd=here) as process:
        out, err = process.communicate(timeout=120)
    assert process.returncode == 0, out + err
    with program("diagnose", simulated / "plain.h5", "--ledger", "l.json", cwd=here) as process:
        out, err = process.communicate(timeout=240)
    assert process.returncode == 0, out + err
    assert not (here / "ran").exists()


def test_no_home_is_needed(here, simulated):
    environment = {k: v for k, v in os.environ.items() if k not in {"HOME", "XDG_CONFIG_HOME"}}
    hostile = here / "~" / ".config" / "gyrotrack"
    hostile.mkdir(parents=True)
    (hostile / "gyrotrack.toml").write_text('[batch]\nscheduler = "tcp://203.0.113.7:1"\n')
    code = (
        "import os, pwd, sys\n"
        "def unknown(uid): raise KeyError(uid)\n"
        "pwd.getpwuid = unknown\n"
        "from gyrotrack.apps.cli._start import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, "config", "--json"],
        capture_output=True,
        text=True,
        env=environment,
        cwd=here,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["file"] is None


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stopped_simulation_leaves_nothing(here, number):
    words = ["simulate", "-o", "a.h5", "--film", "films", "--duration", "60", "--window-length", "1"]
    with program(*words, "--hide", cwd=here) as process:
        end = time.monotonic() + 60
        while not list(here.glob("films/*.part")) and time.monotonic() < end and process.poll() is None:
            time.sleep(0.05)
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
    assert process.returncode == (143 if number == signal.SIGTERM else 130), err
    assert "Traceback" not in err
    assert [p for p in here.rglob("*") if p.is_file()] == []
