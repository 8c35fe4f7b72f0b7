"""With --json there is one document, whatever happens: to stdout, to the memory, to the result while it is shown."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gyrotrack.apps.cli._output import Output
from gyrotrack.apps.cli._start import LEAST_MEMORY

PROGRAM = f"{sys.executable} -P -m gyrotrack"


def shell(command):
    return subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=240)


def test_an_error_after_the_result_is_the_only_document(gyrotrack, monkeypatch):
    shown = Output.show

    def fail(self, *renderables):
        shown(self, *renderables)
        raise OverflowError("int too large")

    monkeypatch.setattr(Output, "show", fail)
    said = gyrotrack("effects", "--json")
    assert said.code == 1
    assert said.error["code"] == "bug"


def test_an_interrupt_after_the_result_is_the_only_document(gyrotrack, monkeypatch):
    monkeypatch.setattr(Output, "show", lambda self, *_: signal.raise_signal(signal.SIGINT))
    said = gyrotrack("effects", "--json")
    assert said.code == 130
    assert said.error["code"] == "interrupted"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("options", ["", "--json"])
@pytest.mark.parametrize(("where", "words"), [(">/dev/full", "no space left"), (">&-", "stdout is closed")])
def test_a_result_that_cannot_be_printed_is_one_sentence_on_stderr(where, words, options):
    said = shell(f"{PROGRAM} effects {options} {where}")
    assert said.returncode == 1
    assert said.stdout == ""
    assert words in said.stderr.splitlines()[0]
    assert len(said.stderr.splitlines()) == 2
    missing = shell(f"{PROGRAM} info absent.h5 {options} {where}")
    assert missing.returncode == 1
    assert "absent.h5 does not exist" in missing.stderr


@pytest.mark.slow
def test_a_closed_stderr_takes_nothing_from_the_result():
    said = shell(f"{PROGRAM} effects --json 2>&-")
    assert said.returncode == 0
    assert len(json.loads(said.stdout)["effects"]) > 10


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs a limit of the address space")
@pytest.mark.parametrize(("size", "code"), [(LEAST_MEMORY - 1, 1), (40, 1), (2048, 0)])
def test_too_little_memory_is_said_before_anything_is_imported(size, code):
    said = shell(f"ulimit -v {1024 * size}; {PROGRAM} effects --json")
    assert said.returncode == code
    document = json.loads(said.stdout)
    assert ("error" in document) == bool(code)
    if code:
        assert document["error"]["code"] == "memory"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="needs SIGHUP")
@pytest.mark.parametrize("ignored", [False, True])
def test_a_closed_terminal_ends_a_command_and_leaves_nothing(tmp_path, ignored):
    """But for one that was started by `nohup`."""
    words = "simulate -o a.h5 --film films --duration 20 --window-length 1 --json"
    start = "trap '' HUP; exec" if ignored else "exec"
    process = subprocess.Popen(
        ["bash", "-c", f"{start} {PROGRAM} {words}"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        # the tests themselves may run under `nohup`
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )
    end = time.monotonic() + 60
    while not list(tmp_path.glob("films/*.part")) and time.monotonic() < end and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(signal.SIGHUP)
    if ignored:
        time.sleep(0.5)
        assert process.poll() is None
        process.terminate()
    out, _ = process.communicate(timeout=240)
    assert process.returncode == (143 if ignored else 129)
    assert json.loads(out)["error"]["code"] == "interrupted"
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == []
