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


def test_it_is_done_in_another_process_which_is_gone_afterwards():
    with WorkerPool(1) as workers:
        value, where = workers.submit(_where, 3).result()
    assert value == 3
    assert where != os.getpid()
    with pytest.raises(ProcessLookupError):
        os.kill(where, 0)


def test_what_goes_wrong_there_is_told_here():
    with WorkerPool(1) as workers, pytest.raises(ValueError, match="seven"):
        workers.submit(_wrong, "seven").result()


def test_without_a_second_core_it_is_done_here():
    with WorkerPool(0) as workers:
        assert workers.submit(_where, 3).result() == (3, os.getpid())


def test_if_the_process_is_killed_it_is_done_here():
    with WorkerPool(1) as workers:
        _, where = workers.submit(_where, 0).result()
        os.kill(where, signal.SIGKILL)
        assert workers.submit(_where, 3).result() == (3, os.getpid())
        assert workers.submit(_where, 4).result() == (4, os.getpid())


@pytest.mark.slow
def test_it_does_not_outlive_a_command_that_is_killed(tmp_path):
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


def test_where_no_process_can_be_started_it_is_done_here(monkeypatch):
    """As under ``ulimit -u``: the start of a process fails with an OSError."""

    def refuse(*_):
        raise BlockingIOError("Resource temporarily unavailable")

    monkeypatch.setattr("multiprocessing.context.SpawnProcess.start", refuse)
    with WorkerPool(1) as workers:
        assert workers.submit(_where, 3).result() == (3, os.getpid())
        assert workers.map(_first_and, ("a",), [1]) == [("a", 1, os.getpid())]


def test_blas_has_one_thread_inside_and_as_many_as_before_afterwards():
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


def test_two_processes_share_the_items_and_results_refer_to_what_is_kept():
    common = (_Part(), _Part())
    with WorkerPool(1) as workers:
        workers.submit(_where, 0).result()
        found = workers.map(_first_and, common, range(8), _parts)
    assert [item for _, item, _ in found] == list(range(8))
    assert len({where for _, _, where in found}) == 2
    assert all(part is common[0] for part, _, _ in found)


def test_items_are_all_done_here_if_the_process_is_killed():
    with WorkerPool(1) as workers:
        _, where = workers.submit(_where, 0).result()
        os.kill(where, signal.SIGKILL)
        found = workers.map(_first_and, ("a",), range(3))
    assert found == [("a", i, os.getpid()) for i in range(3)]


def _killed(common, item):
    if os.getpid() != common:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def test_an_item_that_kills_the_process_is_done_here():
    with WorkerPool(1) as workers:
        assert workers.map(_killed, os.getpid(), range(4)) == [0, 1, 2, 3]


def test_nothing_is_started_without_with():
    assert WorkerPool(1).map(_first_and, ("a",), [1]) == [("a", 1, os.getpid())]


def _interrupted(common, item):
    if os.getpid() == common:
        time.sleep(0.3)
        raise KeyboardInterrupt
    time.sleep(0.6)
    return item


def test_an_interruption_leaves_no_words_behind(caplog):
    """What is begun there comes to its end after the pool is closed, and hands nothing more over."""
    with pytest.raises(KeyboardInterrupt), WorkerPool(1) as workers:
        workers.map(_interrupted, workers.submit(os.getppid).result(), range(6))
    assert caplog.records == []
