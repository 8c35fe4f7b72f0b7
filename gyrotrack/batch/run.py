"""Running the steps of a batch: what was done is kept, what fails stops nothing but what follows from it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrotrack.batch.journal import Journal, contents_of, fingerprint, key_of
from gyrotrack.batch.steps import Outcome, Step, words_for
from gyrotrack.batch.workers import Workers
from gyrotrack.dataset.writing import new_file
from gyrotrack.errors import GyrotrackError

Progress = Callable[[int, int | None], None]
Told = Callable[[Step, Outcome], None]

_NOT_TRUSTED = 3
_TRIES = 2
_READERS = 4


@dataclass
class _Running:
    step: Step
    key: str
    words: list[str]
    tries: int = 1


class Run:
    """One run through all steps.

    Parameters
    ----------
    steps : sequence of Step
        Each after those that it needs.
    results : Path
        Folder of the results.
    journal : Journal
        What was done before.
    timeout : float, optional
        Seconds that a step may take.
    tell : callable, optional
        Told of each step that ended.
    progress : callable, optional
        Called with (steps ended, steps in all).
    """

    def __init__(
        self,
        steps: Sequence[Step],
        results: Path,
        journal: Journal,
        *,
        timeout: float | None = None,
        tell: Told | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.steps = {s.name: s for s in steps}
        self.results, self.journal, self.timeout = results, journal, timeout
        self.ended: dict[str, Outcome] = {}
        self._tell, self._progress = tell, progress
        self._contents: dict[Path, str] = {}
        self._followers: dict[str, list[Step]] = {}
        for step in steps:
            for name in {*step.needs, *step.wants}:
                self._followers.setdefault(name, []).append(step)

    def look(self) -> dict[str, str]:
        """Return what would become of each step: "kept" or "to do"; nothing is run or written."""
        self._read_sources()
        for step in self.steps.values():
            if self._ready(step) and (kept := self._kept(step)[0]) is not None:
                self.ended[step.name] = kept
        return {name: "kept" if name in self.ended else "to do" for name in self.steps}

    def work(self, workers: Workers) -> dict[str, Outcome]:
        """Run all steps that are not done; return how each ended."""
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
                if _error(answer).get("code") == "crash" and done.tries < _TRIES:
                    done.tries += 1
                    running[workers.submit([done.step.verb, *done.words], self.timeout)] = done
                    continue
                self._end(done, answer)
                fresh += self._followers.get(done.step.name, [])
        return self.ended

    def _read_sources(self) -> None:
        paths = list(dict.fromkeys(p for s in self.steps.values() for p in s.files))
        with ThreadPoolExecutor(_READERS) as pool:
            self._contents = {p: c or "" for p, c in zip(paths, pool.map(contents_of, paths), strict=True)}

    def _ready(self, step: Step) -> bool:
        return all(name in self.ended for name in (*step.needs, *step.wants))

    def _blocked(self, step: Step) -> str | None:
        lost = [name for name in step.needs if not self.ended[name].good]
        if not lost and step.wants and not any(self.ended[name].good for name in step.wants):
            lost = list(step.wants)
        return lost[0] if lost else None

    def _kept(self, step: Step) -> tuple[Outcome | None, str, list[str]]:
        if self._blocked(step) is not None:
            return None, "", []
        words = words_for(step, self.steps, self.ended)
        before = [self.ended[n].fingerprint for n in (*step.needs, *step.wants) if self.ended[n].good]
        key = key_of(step, words, self.results, self._contents, before)
        return self.journal.kept(step, key), key, words

    def _begin(self, step: Step) -> _Running | None:
        """Return what is to be submitted, or None if the step has ended already."""
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
            told = {"code": "output", "message": f"{folder} cannot be made: {error.strerror}.", "hint": ""}
            self._close(step, Outcome("failed", {"error": told}))
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
                told = {
                    "code": "output",
                    "message": f"{done.step.output} was not found after it was written.",
                }
                outcome.document = {"error": {**told, "hint": "Does the worker see the same folders?"}}
        self.journal.add(done.step, done.key, outcome)
        self._close(done.step, outcome)

    def _write(self, step: Step, outcome: Outcome) -> Outcome:
        try:
            with new_file(step.output, force=True) as stream:
                stream.write(json.dumps(outcome.document, indent=1).encode())
        except GyrotrackError as error:
            outcome.document = {"error": {"code": error.code, "message": error.message, "hint": error.hint}}
        return outcome

    def _close(self, step: Step, outcome: Outcome) -> None:
        self.ended[step.name] = outcome
        if self._tell is not None:
            self._tell(step, outcome)
        if self._progress is not None:
            self._progress(len(self.ended), len(self.steps))


def _answer(future: Future[dict[str, Any]]) -> dict[str, Any]:
    try:
        return future.result()
    except Exception as error:  # whatever a cluster raises when a worker is lost for good
        told = {"code": "crash", "message": f"The worker was lost: {type(error).__name__}.", "hint": ""}
        return {"code": 1, "document": {"error": told}}


def _error(answer: dict[str, Any]) -> dict[str, Any]:
    """Return the error of an answer, {} if there is none; an answer that makes no sense is a bug."""
    found = answer["document"].get("error")
    if isinstance(found, dict):
        return found
    if found is not None or answer["code"] not in {0, _NOT_TRUSTED}:
        return {
            "code": "bug",
            "message": f"It ended with the exit code {answer['code']} and no word.",
            "hint": "",
        }
    return {}
