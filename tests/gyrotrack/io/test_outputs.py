"""The outputs of one command: all or none, after an error and after a kill; no file of anybody else is replaced."""

import os
import signal
import subprocess
import sys

import pytest

from gyrotrack import OutputError, UsageError
from gyrotrack.io._atomic import is_left, new_file
from gyrotrack.io._command_end import marking
from gyrotrack.io._outputs import new_outputs


def write(path, content=b"new", **options):
    with new_file(path, **options) as stream:
        stream.write(content)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


_KILLED = """
import os, signal, sys
from pathlib import Path
from gyrotrack.io._atomic import is_left, new_file
from gyrotrack.io._command_end import marking
from gyrotrack.io._outputs import new_outputs
paths = [Path(name) for name in "abc"]
with new_outputs(*paths, force=False):
    for path in paths[: int(sys.argv[1])]:
        with new_file(path) as stream:
            stream.write(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def killed(tmp_path):
    """Kill a command with the outputs a, b and c after the first `count`."""

    def run(count):
        done = subprocess.run([sys.executable, "-c", _KILLED, str(count)], cwd=tmp_path, check=False)
        assert done.returncode == -signal.SIGKILL
        return [tmp_path / name for name in "abc"]

    return run


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
@pytest.mark.parametrize("count", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 3)), 2])
def test_the_command_that_was_killed_runs_again(killed, tmp_path, count):
    paths = killed(count)
    assert [p.exists() for p in paths] == [k < count for k in range(3)]
    assert [is_left(p) for p in paths] == [k < count for k in range(3)]
    with new_outputs(*paths, force=False):
        for path in paths:
            write(path)
    assert names(tmp_path) == ["a", "b", "c"]
    assert {p.read_bytes() for p in paths} == {b"new"}
    with pytest.raises(OutputError, match="already exists"), new_outputs(*paths, force=False):
        pass


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
@pytest.mark.parametrize("how", ["other content", "same content"])
def test_what_the_user_has_put_there_meanwhile_is_kept(killed, tmp_path, how):
    paths = killed(2)
    paths[1].unlink()
    paths[1].write_bytes(b"half" if how == "same content" else b"precious")
    kept = paths[1].read_bytes()
    for _ in range(2):
        with pytest.raises(OutputError, match="b already exists"), new_outputs(*paths, force=False):
            pass
        assert paths[1].read_bytes() == kept


def _stop_after(path):
    write(path, force=True)
    raise KeyboardInterrupt


def test_after_an_error_new_outputs_go_and_old_ones_stay(tmp_path):
    a, b, c = (tmp_path / name for name in "abc")
    b.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), new_outputs(a, b, None, c, force=True):
        _stop_after(a)
    assert names(tmp_path) == ["b"]
    assert b.read_bytes() == b"old"


def test_a_planted_list_leads_to_no_deletion(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    a.write_bytes(b"precious")
    listed = tmp_path / "a.outputs.unfinished"
    listed.write_bytes(b"gyrotrack journal 1\n")
    with pytest.raises(OutputError, match="already exists"), new_outputs(a, b, force=False):
        pass
    listed.write_bytes(b"other")
    with pytest.raises(OutputError, match="already exists"), new_outputs(a, b, force=False):
        pass
    assert a.read_bytes() == b"precious"
    a.unlink()
    with pytest.raises(OutputError, match="was not made by gyrotrack"), new_outputs(a, b, force=False):
        write(a)
    assert listed.read_bytes() == b"other"
    assert names(tmp_path) == ["a.outputs.unfinished"]


def test_an_output_of_a_running_command_is_not_replaced(tmp_path):
    path = tmp_path / "a"
    with marking():
        write(path)
        assert names(tmp_path) == [".a.outputs.unfinished.lock", "a", "a.outputs.unfinished"]
        with pytest.raises(OutputError, match="already exists"):
            write(path)
        ask = "from gyrotrack.io._atomic import is_left as f; from pathlib import Path; print(f(Path('a')))"
        told = subprocess.run([sys.executable, "-c", ask], cwd=tmp_path, capture_output=True, check=True)
        assert told.stdout.strip() == b"False"
    assert names(tmp_path) == ["a"]


def test_two_outputs_have_two_names(tmp_path):
    twice = new_outputs(tmp_path / "a", tmp_path / "x" / ".." / "a", force=True)
    with pytest.raises(UsageError, match="name of two outputs"), twice:
        pass
