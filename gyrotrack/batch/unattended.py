"""A batch from its first step to its summary, with the folder of results held against other runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from gyrotrack.batch.experiment import Experiment
from gyrotrack.batch.journal import Journal
from gyrotrack.batch.lock import held
from gyrotrack.batch.run import Run
from gyrotrack.batch.steps import Outcome, Step
from gyrotrack.batch.summary import Row, summarise, write_summary
from gyrotrack.batch.workers import ClusterWorkers, LocalWorkers, Workers, cores

STATES = ("done", "kept", "failed", "blocked")
_JOURNAL = "batch.jsonl"


@dataclass(frozen=True)
class Ended:
    """What a batch has come to.

    Attributes
    ----------
    rows : sequence of Row
        A row a case.
    steps : dict of str to int
        How many steps ended in each of `STATES`.
    seconds : float
        How long it took [s].
    summary : sequence of Path
        The files in which all this stands.
    """

    rows: Sequence[Row]
    steps: dict[str, int]
    seconds: float
    summary: Sequence[Path]


def foresee(steps: Sequence[Step], output: Path) -> dict[str, str]:
    """Return the state of each step by name as a run would find it, and run nothing."""
    return Run(tuple(steps), output, Journal(output / _JOURNAL)).look()


def work_off(
    cases: Sequence[Experiment],
    steps: Sequence[Step],
    output: Path,
    *,
    command: str,
    workers: int | None = None,
    scheduler: str | None = None,
    timeout: float = 7200.0,
    tell: Callable[[Step, Outcome], None],
    bar: Callable[[], AbstractContextManager[Callable[[int, int | None], None]]],
) -> Ended:
    """Do what is not done yet of a batch.

    Parameters
    ----------
    cases, steps
        What there is, and the steps that `plan` made of it.
    output : Path
        Folder for the results.
    command : str
        The words by which the batch was called, for the summary.
    workers : int, optional
        Processes on this machine; one a core, if not given.
    scheduler : str, optional
        Address of a Dask cluster, in place of processes here.
    timeout : float
        Seconds that one step may take.
    tell : callable
        Hears of every step that has ended.
    bar : callable
        Opens what shows (done, total).

    Raises
    ------
    OutputError
        Another run holds the folder, or it holds something else.
    """
    began = perf_counter()
    with held(output):
        journal = Journal(output / _JOURNAL)
        place: Workers = ClusterWorkers(scheduler) if scheduler else LocalWorkers(workers or cores())
        try:
            with bar() as progress:
                run = Run(tuple(steps), output, journal, timeout=timeout, tell=tell, progress=progress)
                outcomes = run.work(place)
        finally:
            place.close()
        rows = summarise(cases, steps, outcomes)
        counts = {state: sum(o.state == state for o in outcomes.values()) for state in STATES}
        seconds = round(perf_counter() - began, 3)
        facts = {"command": command, "steps": counts, "seconds": seconds}
        return Ended(rows, counts, seconds, write_summary(output, rows, facts))
