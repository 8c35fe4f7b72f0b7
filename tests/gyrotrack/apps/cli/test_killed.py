"""A command that was killed runs again as it is; a command that ended does not replace what it wrote."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

CLIPS = Path(__file__).parents[4] / "sample_clips"
ANGLES = "t,angle\n" + "".join(f"{0.01 * k},{0.1 * k - 1e-4 * k * k}\n" for k in range(200))
# killed when everything is written, before the result is printed
_KILLED = """
import os, signal, sys
from gyrotrack.apps.cli import _app, _output
_output._print = lambda _: os.kill(os.getpid(), signal.SIGKILL)
_app.run(sys.argv[1:])
"""

# killed when the result is printed and the libraries have ended, before the process ends
_KILLED_AT_END = """
import atexit, os, signal, sys
from gyrotrack.apps.cli import _app, _start
run = _app.run
def killed(words):
    atexit.register(lambda: os.kill(os.getpid(), signal.SIGKILL))
    return run(words)
_app.run = killed
_start.main()
"""


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
@pytest.mark.slow
def test_an_import_that_was_killed_after_writing_runs_again(gyrotrack, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "t.csv").write_text(ANGLES)
    words = ["import", "--body", "t.csv", "--inertia", "1e-5", "-o", "c.h5", "--json"]
    done = subprocess.run([sys.executable, "-c", _KILLED, *words], check=False, cwd=tmp_path)
    assert done.returncode == -signal.SIGKILL
    assert "c.h5" in names(tmp_path)
    assert gyrotrack(*words).code == 0
    assert names(tmp_path) == ["c.h5", "t.csv"]
    said = gyrotrack(*words)
    assert said.error["message"] == "c.h5 already exists."
    # what the user puts there in the meantime stays
    (tmp_path / "c.h5").unlink()
    subprocess.run([sys.executable, "-c", _KILLED, *words], check=False, cwd=tmp_path)
    (tmp_path / "c.h5").write_text("precious")
    assert gyrotrack(*words).error["message"] == "c.h5 already exists."
    assert (tmp_path / "c.h5").read_text() == "precious"


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
@pytest.mark.slow
def test_a_program_that_was_killed_while_it_ends_runs_again(tmp_path):
    (tmp_path / "t.csv").write_text(ANGLES)
    words = ["import", "--body", "t.csv", "--inertia", "1e-5", "-o", "c.h5", "--json"]

    def run(*program):
        return subprocess.run(
            [sys.executable, *program, *words], check=False, cwd=tmp_path, capture_output=True
        )

    killed = run("-c", _KILLED_AT_END)
    assert killed.returncode == -signal.SIGKILL
    assert json.loads(killed.stdout)["output"] == "c.h5"
    assert {"c.h5", "c.h5.outputs.unfinished"} < set(names(tmp_path))
    assert run("-m", "gyrotrack").returncode == 0
    assert names(tmp_path) == ["c.h5", "t.csv"]
    assert run("-m", "gyrotrack").returncode == 1


@pytest.mark.parametrize(("content", "left"), [("", []), ("foreign", [".c.h5.outputs.unfinished.lock"])])
def test_the_lock_of_a_mark_that_is_gone_is_removed(gyrotrack, tmp_path, content, left):
    """A kill after the mark was removed and before its lock was."""
    (tmp_path / "t.csv").write_text(ANGLES)
    (tmp_path / "c.h5").write_text("complete")
    (tmp_path / ".c.h5.outputs.unfinished.lock").write_text(content)
    said = gyrotrack(
        "import", "--body", tmp_path / "t.csv", "--inertia", "1e-5", "-o", tmp_path / "c.h5", "--json"
    )
    assert said.error["message"] == f"{tmp_path / 'c.h5'} already exists."
    assert names(tmp_path) == [*left, "c.h5", "t.csv"]


@pytest.mark.parametrize("name", ["case.h5", "case.fits.json", "casing.h5", "report.html", "story.png"])
def test_the_demo_replaces_nothing(gyrotrack, tmp_path, name):
    content = '{"format": "gyrotrack ledger", "version": 1, "fits": []}' if "fits" in name else "precious"
    (tmp_path / name).write_text(content)
    said = gyrotrack("demo", "--clips", CLIPS, "-o", tmp_path, "--json")
    assert said.code == 1
    assert said.error["message"] == f"{tmp_path / name} already exists."
    assert (tmp_path / name).read_text() == content
    assert names(tmp_path) == [name]
