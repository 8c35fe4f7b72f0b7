"""A case is read while it is fitted, and used only if its file has not changed; computations have a lower priority."""

import os
import subprocess
import sys
from concurrent.futures import Future

import pytest

from gyrotrack.apps.workbench import _server as server
from gyrotrack.apps.workbench._processes import in_background


@pytest.fixture
def bench(tmp_path, monkeypatch):
    case = tmp_path / "case.h5"
    case.write_bytes(b"1")

    def of(path):
        if path.name == "broken.h5":
            raise ValueError
        return server.Opened(path, path.stat().st_mtime_ns, None, None)

    monkeypatch.setattr(server.Opened, "of", of)
    return server.Workbench(), case


def test_a_case_that_was_read_ahead_is_used_once(bench):
    bench, case = bench
    assert bench._read_before(case) is None
    bench._read_ahead(case)
    assert bench._read_before(case).case == case
    assert bench._read_before(case) is None


def test_a_changed_another_or_a_broken_case_is_read_again(bench):
    bench, case = bench
    bench._read_ahead(case)
    assert isinstance(bench._reading, Future)
    bench._reading.result()
    os.utime(case, ns=(1, 1))
    assert bench._read_before(case) is None
    bench._read_ahead(case)
    assert bench._read_before(case.with_name("other.h5")) is None
    bench._read_ahead(case.with_name("broken.h5"))
    assert bench._read_before(case.with_name("broken.h5")) is None


@pytest.mark.skipif(not hasattr(os, "getpriority"), reason="the system has no priorities")
def test_computations_give_way_to_the_page():
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        in_background(child.pid)
        assert os.getpriority(os.PRIO_PROCESS, child.pid) > os.getpriority(os.PRIO_PROCESS, 0)
    finally:
        child.communicate(b"\n", timeout=10)
    in_background(child.pid)  # of a process that has ended


def test_the_size_and_the_start_of_an_upload_are_read_from_the_request():
    from gyrotrack import UsageError

    file, offset = server.sent({"name": "a.csv", "size": "10", "offset": "4", "modified": "7"})
    assert (file.name, file.size, file.modified, offset) == ("a.csv", 10, 7, 4)
    assert server.sent({"name": "a.csv"}, "12")[0].size == 12
    assert server.sent({"name": "a.csv"}, "x")[0].size == -1
    with pytest.raises(UsageError):
        server.sent({"name": "a.csv", "offset": "-1"}, "12")


def test_modules_of_the_laboratory_are_imported_when_a_step_begins(tmp_path, monkeypatch):
    from threading import Event

    from gyrotrack.apps.workbench._project import Project

    imported = Event()
    monkeypatch.setattr(server, "import_for_laboratory", imported.set)
    project = Project(tmp_path)
    server.Workbench(project=project)
    monkeypatch.setattr(project.jobs, "start", lambda *_: None)
    assert not imported.is_set()
    project._start("fit", ["fit", "case.h5"], lambda _: None)
    assert imported.wait(5)
    project.close()


def test_every_module_that_is_imported_ahead_exists():
    from importlib.util import find_spec

    assert all(find_spec(name) for name in server._IMPORTED_AHEAD)
