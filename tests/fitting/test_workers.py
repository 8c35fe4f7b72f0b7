import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fitting._workers import WorkerPool, single_blas_thread


def _where(value):
    return value, os.getpid()


def _wrong(value):
    raise ValueError(value)


def test_a_task_runs_in_a_worker_that_ends_afterwards():
    with WorkerPool(1) as workers:
        value, where = workers.submit(_where, 3).result()
    assert value == 3
    assert where != os.getpid()
    with pytest.raises(ProcessLookupError):
        os.kill(where, 0)


class Changing:
    """An object that a thread changes while it is pickled, for the first `times`."""

    def __init__(self, times):
        self.times = times

    def __getstate__(self):
        self.times -= 1
        if self.times >= 0:
            raise RuntimeError("dictionary changed size during iteration")
        return {"times": 0}


@pytest.mark.parametrize(("times", "there"), [(0, True), (3, True), (1000, False)])
def test_arguments_that_change_while_they_are_pickled_are_pickled_again(times, there):
    """Where it does not succeed, the call runs in the calling process."""
    with WorkerPool(1) as workers:
        (_, where) = workers.submit(_where, Changing(times)).result()
    assert (where != os.getpid()) == there


def test_arguments_are_those_at_the_time_of_the_call():
    value = [1]
    with WorkerPool(1) as workers:
        task = workers.submit(_where, value)
        value[0] = 2
        assert task.result()[0] == [1]


def test_exceptions_of_workers_are_raised_in_the_caller():
    with WorkerPool(1) as workers, pytest.raises(ValueError, match="seven"):
        workers.submit(_wrong, "seven").result()


def test_an_interrupt_does_not_wait_for_running_tasks():
    where = 0

    def interrupted():
        nonlocal where
        with WorkerPool(1) as workers:
            where = workers.submit(os.getpid).result()
            workers.submit(time.sleep, 60)
            raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert time.monotonic() - began < 30
    with pytest.raises(ProcessLookupError):
        os.kill(where, 0)


def test_on_one_core_tasks_run_in_the_caller():
    with WorkerPool(0) as workers:
        assert workers.submit(_where, 3).result() == (3, os.getpid())


def test_tasks_of_a_killed_worker_run_in_the_caller():
    with WorkerPool(1) as workers:
        _, where = workers.submit(_where, 0).result()
        os.kill(where, signal.SIGKILL)
        assert workers.submit(_where, 3).result() == (3, os.getpid())
        assert workers.submit(_where, 4).result() == (4, os.getpid())


@pytest.mark.slow
def test_workers_end_with_a_killed_command(tmp_path):
    script = tmp_path / "command.py"
    script.write_text(
        "import os, time\n"
        "from fitting._workers import WorkerPool\n"
        "if __name__ == '__main__':\n"
        "    with WorkerPool(1) as workers:\n"
        "        print(workers.submit(os.getpid).result(), flush=True)\n"
        "        time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as command:
        where = int(command.stdout.readline())
        command.kill()
    for _ in range(100):
        if not Path(f"/proc/{where}").exists():
            return
        time.sleep(0.1)
    pytest.fail("it is still there")


def test_without_processes_tasks_run_in_the_caller(monkeypatch):
    """As under ``ulimit -u``: the start of a process fails with an OSError."""

    def refuse(*_):
        raise BlockingIOError("Resource temporarily unavailable")

    monkeypatch.setattr("multiprocessing.context.SpawnProcess.start", refuse)
    with WorkerPool(1) as workers:
        assert workers.submit(_where, 3).result() == (3, os.getpid())
        assert workers.map(_first_and, ("a",), [1]) == [("a", 1, os.getpid())]


def test_blas_threads_are_limited_within_the_context_only():
    pytest.importorskip("numpy")  # loads the library whose threads are limited
    from threadpoolctl import threadpool_info, threadpool_limits

    def threads():
        return {i["num_threads"] for i in threadpool_info() if i["user_api"] == "blas"}

    with threadpool_limits(2, "blas"):
        before = threads()  # a library that was built for one thread stays at 1
        assert 2 in before
        with single_blas_thread():
            assert threads() == {1}
        assert threads() == before


class _Part:
    pass


def _parts(common):
    return common


def _first_and(common, item):
    time.sleep(0.05)
    return common[0], item, os.getpid()


def test_mapped_results_refer_to_shared_objects():
    common = (_Part(), _Part())
    with WorkerPool(1) as workers:
        workers.submit(_where, 0).result()
        found = workers.map(_first_and, common, range(8), _parts)
    assert [item for _, item, _ in found] == list(range(8))
    assert len({where for _, _, where in found}) == 2
    assert all(part is common[0] for part, _, _ in found)


def test_mapped_items_of_a_killed_worker_run_in_the_caller():
    with WorkerPool(1) as workers:
        _, where = workers.submit(_where, 0).result()
        os.kill(where, signal.SIGKILL)
        found = workers.map(_first_and, ("a",), range(3))
    assert found == [("a", i, os.getpid()) for i in range(3)]


def _killed(common, item):
    if os.getpid() != common:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def test_an_item_that_kills_its_worker_runs_in_the_caller():
    with WorkerPool(1) as workers:
        assert workers.map(_killed, os.getpid(), range(4)) == [0, 1, 2, 3]


def test_without_entering_the_pool_no_process_is_started():
    assert WorkerPool(1).map(_first_and, ("a",), [1]) == [("a", 1, os.getpid())]


def _interrupted(common, item):
    if os.getpid() == common:
        time.sleep(0.3)
        raise KeyboardInterrupt
    time.sleep(0.6)
    return item


def test_an_interruption_prints_nothing(caplog):
    """Tasks that have started end after the pool is closed, without a result."""
    with pytest.raises(KeyboardInterrupt), WorkerPool(1) as workers:
        workers.map(_interrupted, workers.submit(os.getppid).result(), range(6))
    assert caplog.records == []
