"""The process that reads MATLAB files: what crosses, and how a crash, an endless reading and a failed start end."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from gyrotrack import DatasetError
from gyrotrack.io.readers import _matlab_process
from gyrotrack.io.readers._matlab import read_matlab

posix = pytest.mark.skipif(sys.platform == "win32", reason="replaces the reader by a script of the shell")
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits by resource and /proc")


@pytest.fixture
def good(tmp_path):
    path = tmp_path / "a.mat"
    t = np.arange(60) / 100
    savemat(path, {"t": t, "angle": 3 * t, "note": "x", "run": {"flag": True}})
    return path


def _instead(monkeypatch, tmp_path, lines):
    """Replace the reader by a script."""
    script = tmp_path / "reader"
    script.write_text(f"#!/bin/sh\n{lines}\n")
    script.chmod(0o755)
    monkeypatch.setattr(_matlab_process.sys, "executable", str(script))


def test_numbers_cross_and_other_variables_are_described(good):
    numbers, others = _matlab_process.arrays_in(good.read_bytes())
    np.testing.assert_array_equal(numbers["angle"].ravel(), 3 * (np.arange(60) / 100))
    assert others == {"note": "1 text"}
    assert sorted(numbers) == ["angle", "flag", "t"]


def test_the_fields_of_a_single_struct_are_variables_and_those_of_an_array_of_structs_are_not(tmp_path):
    runs = np.zeros((1, 2), dtype=[("omega", object)])
    runs["omega"][0] = [np.arange(3.0), np.arange(4.0)]
    savemat(tmp_path / "a.mat", {"run": {"angle": np.arange(5.0)}, "runs": runs})
    assert sorted(_matlab_process._read((tmp_path / "a.mat").read_bytes())) == ["angle", "runs"]


@posix
@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("echo ready; kill -SEGV $$", "is damaged: its reader crashed or did not end."),
        ("echo ready; exec sleep 20", "is damaged: its reader does not end within 0.5 s."),
        (
            "kill -SEGV $$",
            "is not a readable MATLAB file: its reader did not start; there may be too little memory.",
        ),
        ('echo ready; echo \'{"error": "Unknown type"}\'', "is not a readable MATLAB file: Unknown type."),
    ],
    ids=["crash", "endless", "no start", "refused"],
)
def test_an_end_of_the_reader_without_an_answer_is_one_sentence(monkeypatch, tmp_path, good, lines, said):
    _instead(monkeypatch, tmp_path, lines)
    monkeypatch.setattr(_matlab_process, "_MOST_S", 0.5 if "sleep" in lines else 30)
    with pytest.raises(DatasetError) as error:
        read_matlab(good, good.read_bytes(), None)
    assert error.value.message == f"{good} {said}"


@linux
@pytest.mark.parametrize(
    ("work", "ends_well"),
    [
        pytest.param("while True: pass", False, marks=pytest.mark.slow),
        ("import numpy; numpy.empty(2**25)", True),  # a quarter of the memory
        ("import numpy; numpy.empty(2**28)", False),  # twice the memory
    ],
    ids=["endless", "small", "large"],
)
def test_limits_of_the_process(work, ends_well):
    program = (
        f"import numpy\nfrom {_matlab_process.__name__} import *\nimport {_matlab_process.__name__} as m\n"
    )
    program += f"m._MOST_CPU_S = {1 if 'while' in work else 20}\nm._limit()\n{work}"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=60, check=False)
    assert (ended.returncode == 0) == ends_well


def test_memory_and_time_of_a_reading_process_are_limited(monkeypatch):
    resource = pytest.importorskip("resource")
    pages = 1000
    limits = {
        resource.RLIMIT_AS: (resource.RLIM_INFINITY, resource.RLIM_INFINITY),
        resource.RLIMIT_CPU: (5, 7),
        resource.RLIMIT_CORE: (3, resource.RLIM_INFINITY),
    }
    found = {}
    monkeypatch.setattr(Path, "read_text", lambda self, encoding: f"{pages} 5 3")
    monkeypatch.setattr(resource, "getpagesize", lambda: 4096)
    monkeypatch.setattr(resource, "getrlimit", limits.get)
    monkeypatch.setattr(resource, "setrlimit", lambda kind, both: found.update({kind: both}))
    monkeypatch.setattr(_matlab_process.os, "times", lambda: (1.5, 2.6, 100.0, 100.0, 100.0))
    _matlab_process._limit()
    memory = pages * 4096 + _matlab_process._MOST_MEMORY
    assert found[resource.RLIMIT_AS] == (memory, memory)
    assert found[resource.RLIMIT_CPU] == (5, 5)
    assert found[resource.RLIMIT_CORE] == (0, 0)
    limits[resource.RLIMIT_CPU] = (resource.RLIM_INFINITY,) * 2
    limits[resource.RLIMIT_AS] = (2**20, 2**30)
    _matlab_process._limit()
    seconds = 4 + _matlab_process._MOST_CPU_S
    assert found[resource.RLIMIT_CPU] == (seconds, seconds)
    assert found[resource.RLIMIT_AS] == (2**20, 2**20)

    def absent(self, encoding):
        raise OSError

    found.clear()
    monkeypatch.setattr(Path, "read_text", absent)
    _matlab_process._limit()
    assert found == {}
