"""Execution of the steps of a batch, and its summary."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, closing
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from gyrotrack._errors import GyrotrackError
from gyrotrack.apps.batch._experiments import Experiment
from gyrotrack.apps.batch._steps import (
    Journal,
    Outcome,
    Step,
    arguments_for,
    file_digest,
    fingerprint,
    locked_folder,
    step_key,
)
from gyrotrack.apps.batch._workers import Cluster, Workers, failure
from gyrotrack.io._atomic import new_file
from gyrotrack.io._contents import plain_cell

Progress = Callable[[int, int | None], None]
Report = Callable[[Step, Outcome], None]

_NOT_TRUSTED = 3  # exit code
_MAX_TRIES = 2
_HASHING_THREADS = 4


@dataclass
class _Running:
    step: Step
    key: str
    words: list[str]
    tries: int = 1


class Run:
    """One execution of all steps.

    `report` is called with (step, outcome), `progress` with (steps ended, steps in total).
    """

    def __init__(
        self,
        steps: Sequence[Step],
        results: Path,
        journal: Journal,
        *,
        timeout: float | None = None,
        report: Report | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.steps = {s.name: s for s in steps}
        self.results, self.journal, self.timeout = results, journal, timeout
        self.ended: dict[str, Outcome] = {}
        self._report, self._progress = report, progress
        self._contents: dict[Path, str] = {}
        self._followers: dict[str, list[Step]] = {}
        for step in steps:
            for name in {*step.needs, *step.needs_any}:
                self._followers.setdefault(name, []).append(step)

    def preview(self) -> dict[str, str]:
        """Return the state of each step, "kept" or "to do"; nothing is run or written."""
        self._read_sources()
        for step in self.steps.values():
            if self._ready(step) and (kept := self._kept(step)[0]) is not None:
                self.ended[step.name] = kept
        return {name: "kept" if name in self.ended else "to do" for name in self.steps}

    def work(self, workers: Workers) -> dict[str, Outcome]:
        """Run all steps that are not complete; return their outcomes."""
        self._read_sources()
        running: dict[Future[dict[str, Any]], _Running] = {}
        fresh, taken = list(self.steps.values()), set[str]()
        while fresh or running:
            while fresh:
                step = fresh.pop(0)
                if step.name in taken or not self._ready(step):
                    continue
                taken.add(step.name)
                begun = self._begin(step)
                if begun is None:
                    fresh += self._followers.get(step.name, [])
                else:
                    running[workers.submit([step.verb, *begun.words], self.timeout)] = begun
            if not running:
                break
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                done = running.pop(future)
                answer = _answer(future)
                if _error(answer).get("code") == "crash" and done.tries < _MAX_TRIES:
                    done.tries += 1
                    running[workers.submit([done.step.verb, *done.words], self.timeout)] = done
                    continue
                self._end(done, answer)
                fresh += self._followers.get(done.step.name, [])
        return self.ended

    def _read_sources(self) -> None:
        paths = list(dict.fromkeys(p for s in self.steps.values() for p in s.files))
        try:
            with ThreadPoolExecutor(_HASHING_THREADS) as pool:
                found = list(pool.map(file_digest, paths))
        except RuntimeError:  # no thread can be started
            found = [file_digest(p) for p in paths]
        self._contents = {p: c or "" for p, c in zip(paths, found, strict=True)}

    def _ready(self, step: Step) -> bool:
        return all(name in self.ended for name in (*step.needs, *step.needs_any))

    def _blocked(self, step: Step) -> str | None:
        lost = [name for name in step.needs if not self.ended[name].good]
        if not lost and step.needs_any and not any(self.ended[name].good for name in step.needs_any):
            lost = list(step.needs_any)
        return lost[0] if lost else None

    def _kept(self, step: Step) -> tuple[Outcome | None, str, list[str]]:
        if self._blocked(step) is not None:
            return None, "", []
        words = arguments_for(step, self.steps, self.ended)
        before = [self.ended[n].fingerprint for n in (*step.needs, *step.needs_any) if self.ended[n].good]
        key = step_key(step, words, self.results, self._contents, before)
        return self.journal.kept(step, key), key, words

    def _begin(self, step: Step) -> _Running | None:
        """Return the step to be submitted, or None if the step is blocked or kept, or cannot begin."""
        before = self._blocked(step)
        if before is not None:
            cause = self.ended[before].document.get("error", {})
            self._close(step, Outcome("blocked", {"error": {**cause, "after": before}}))
            return None
        kept, key, words = self._kept(step)
        if kept is not None:
            self._close(step, kept)
            return None
        folder = step.output.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            answer = failure("output", f"{folder} cannot be created: {error.strerror}.", "")
            self._close(step, Outcome("failed", answer["document"]))
            return None
        return _Running(step, key, words)

    def _end(self, done: _Running, answer: dict[str, Any]) -> None:
        outcome = Outcome("failed", answer["document"], "", float(answer.get("seconds", 0.0)))
        if error := _error(answer):
            outcome.document = {"error": error}
        else:
            if done.step.verb == "diagnose":
                outcome = self._write(done.step, outcome)
            if "error" not in outcome.document:
                outcome.fingerprint = fingerprint(done.step, outcome.document)
                outcome.state = "done" if outcome.fingerprint else "failed"
                outcome.trusted = answer["code"] != _NOT_TRUSTED
            if outcome.state == "failed" and "error" not in outcome.document:
                outcome.document = failure(
                    "output",
                    f"{done.step.output} was not found after it was written.",
                    "Check that the worker has access to the same folders.",
                )["document"]
        self.journal.add(done.step, done.key, outcome)
        self._close(done.step, outcome)

    def _write(self, step: Step, outcome: Outcome) -> Outcome:
        try:
            with new_file(step.output, force=True) as stream:
                stream.write(json.dumps(outcome.document, indent=1).encode())
        except GyrotrackError as error:
            outcome.document = failure(error.code, error.message, error.hint)["document"]
        return outcome

    def _close(self, step: Step, outcome: Outcome) -> None:
        self.ended[step.name] = outcome
        if self._report is not None:
            self._report(step, outcome)
        if self._progress is not None:
            self._progress(len(self.ended), len(self.steps))


def _answer(future: Future[dict[str, Any]]) -> dict[str, Any]:
    try:
        return future.result()
    except Exception as error:  # a cluster may raise any error when it loses a worker
        return failure("crash", f"The worker was lost ({type(error).__name__}).", "")


def _error(answer: dict[str, Any]) -> dict[str, Any]:
    """Return the error of an answer, or {} without an error; an invalid answer is an internal error."""
    found = answer["document"].get("error")
    if isinstance(found, dict):
        return found
    if found is not None or answer["code"] not in {0, _NOT_TRUSTED}:
        message = f"The step ended with exit code {answer['code']} and no message."
        return {"code": "bug", "message": message, "hint": ""}
    return {}


@dataclass(frozen=True)
class Row:
    """The results of one case of a batch; without a fit, the numbers of the fit are null."""

    label: str  #: Name of the case.
    folder: str  #: Folder of its results.
    state: str  #: `done`, `partly` (a film failed, the other films were processed) or `failed`.
    films: int  #: Number of films.
    tracked: int  #: Number of tracked films.
    frames: int  #: Number of frames of the tracked films.
    fit: str  #: Verdict of the fit; empty without a fit.
    rmse_casing: float | None  #: Rms residual of the smoothed angular velocity of the casing [rad s-1].
    reduced_chi2: float | None  #: Chi-square of the casing divided by the effective number of samples [1].
    misfit: float | None  #: Rms residual divided by the rms of the noise [1].
    diagnosis: str  #: Verdict of the diagnosis; empty without a diagnosis.
    missing: str  #: Effects that `diagnose` or `improve` found.
    trusted: bool  #: Whether every step returned a trusted result (exit code 0).
    warnings: int  #: Number of warnings of the steps.
    seconds: float  #: Total duration of the steps, in this run and earlier runs [s].
    problem: str  #: Message of the first failure, with the name of the step.


def summarise(
    experiments: Sequence[Experiment], steps: Sequence[Step], ended: Mapping[str, Outcome]
) -> tuple[Row, ...]:
    """Return a row for each case."""
    own: dict[str, dict[str, Outcome]] = {e.folder: {} for e in experiments}
    for step in steps:
        if step.name in ended:
            own[step.folder][step.name.partition("/")[2]] = ended[step.name]
    return tuple(_row(e, own[e.folder]) for e in experiments)


def _row(e: Experiment, outcomes: dict[str, Outcome]) -> Row:
    films = [o for name, o in outcomes.items() if name.startswith("extract ")]
    good = [o.document for o in films if o.good]
    fit = outcomes["fit"].document if "fit" in outcomes and outcomes["fit"].good else {}
    diagnosis = outcomes["diagnose"].document if "diagnose" in outcomes and outcomes["diagnose"].good else {}
    bad = [(name, o) for name, o in outcomes.items() if o.state == "failed"]
    blocked = any(o.state == "blocked" for o in outcomes.values())
    casing = (fit.get("cases") or [{}])[0].get("casing", {})
    state = "failed" if blocked or not good or "fit" in dict(bad) else "partly"
    return Row(
        label=e.label,
        folder=e.folder,
        state=state if bad or blocked else "done",
        films=len(films),
        tracked=len(good),
        frames=sum(int(d.get("frames", 0)) for d in good),
        fit=str(fit.get("verdict", "")),
        rmse_casing=casing.get("rmse"),
        reduced_chi2=casing.get("reduced_chi2"),
        misfit=fit.get("misfit"),
        diagnosis=str(diagnosis.get("verdict", "")),
        missing=_missing(diagnosis, outcomes.get("improve")),
        trusted=all(o.trusted for o in outcomes.values()),
        warnings=sum(len(o.document.get("warnings", ())) for o in outcomes.values()),
        seconds=round(sum(o.seconds for o in outcomes.values()), 3),
        problem=next((f"{n}: {o.document.get('error', {}).get('message', 'it failed')}" for n, o in bad), ""),
    )


def _missing(diagnosis: dict[str, Any], improved: Outcome | None) -> str:
    if diagnosis.get("verdict") == "undecided":
        return ""
    if improved is not None and improved.good:
        return " ".join(str(r["added"]) for r in improved.document.get("ladder", [])[1:])
    if diagnosis.get("verdict") != "missing_effect":
        return ""
    best = (diagnosis.get("candidates") or [{}])[0]
    alike = [str(n) for n in best.get("indistinguishable_from", [])]
    return " or ".join([str(best.get("effect", "")), *alike])


def write_summary(folder: Path, rows: Sequence[Row], facts: Mapping[str, Any]) -> list[Path]:
    """Write ``summary.csv`` and ``summary.json`` into the folder of the results."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row.__dataclass_fields__)
    for row in rows:
        cells = asdict(row).values()
        writer.writerow([plain_cell(c) if isinstance(c, str) else "" if c is None else c for c in cells])
    document = {**facts, "cases": [asdict(row) for row in rows]}
    plain = json.dumps(document, indent=1, allow_nan=False) + "\n"
    contents = {folder / "summary.csv": text.getvalue(), folder / "summary.json": plain}
    for path, content in contents.items():
        with new_file(path, force=True) as stream:
            stream.write(content.encode("utf-8", "replace"))
    return list(contents)


def lines(rows: Sequence[Row]) -> list[str]:
    """Return the table for a terminal of 80 columns, followed by the failures."""
    out = [f"{'case':<20}{'films':>7}{'frames':>8}  {'fit':<14}{'rmse':>9}{'misfit':>9}  missing"]
    for r in rows:
        name = r.label if len(r.label) < 20 else "..." + r.label[-16:]
        rmse, misfit = ("-" if v is None else f"{v:.3g}" for v in (r.rmse_casing, r.misfit))
        films, verdict = f"{r.tracked}/{r.films}", r.fit or ("-" if r.state == "done" else r.state)
        line = f"{name:<20}{films:>7}{r.frames:>8}  {verdict:<14}{rmse:>9}{misfit:>9}  {r.missing}"
        out.append(line.rstrip())
    failures = [f"  {r.label}: {r.problem}" for r in rows if r.problem]
    return [*out, *(["", "failures:", *failures] if failures else [])]


STATES = ("done", "kept", "failed", "blocked")
_JOURNAL = "batch.jsonl"


@dataclass(frozen=True)
class BatchResult:
    """Result of a batch."""

    rows: Sequence[Row]  # one row per case
    steps: dict[str, int]  # number of steps by state
    seconds: float  # duration [s]
    summary: Sequence[Path]  # files of the summary


def preview(steps: Sequence[Step], output: Path) -> dict[str, str]:
    """Return the state of each step by name; no step is run."""
    return Run(tuple(steps), output, Journal(output / _JOURNAL)).preview()


def run_batch(
    cases: Sequence[Experiment],
    steps: Sequence[Step],
    output: Path,
    *,
    command: str,
    workers: int | None = None,
    cluster: Cluster | None = None,
    timeout: float = 7200.0,
    report: Report,
    bar: Callable[[], AbstractContextManager[Callable[[int, int | None], None]]],
) -> BatchResult:
    """Run the steps of a batch that are not complete, on this machine or on a Dask cluster.

    `report` is called with (step, outcome) when a step has ended. `bar` returns a context manager; its value is a
    function that is called with (done, total).
    """
    began = perf_counter()
    with locked_folder(output):
        journal = Journal(output / _JOURNAL)
        place = (cluster or Cluster()).workers(output, workers)
        with closing(place), bar() as progress:
            run = Run(tuple(steps), output, journal, timeout=timeout, report=report, progress=progress)
            outcomes = run.work(place)
        rows = summarise(cases, steps, outcomes)
        counts = {state: sum(o.state == state for o in outcomes.values()) for state in STATES}
        seconds = round(perf_counter() - began, 3)
        facts = {"command": command, "steps": counts, "seconds": seconds}
        return BatchResult(rows, counts, seconds, write_summary(output, rows, facts))
