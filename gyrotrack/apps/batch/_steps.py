"""The steps of a batch, their order, and the journal of completed steps.

A step is complete if its key is in the journal and its output has not changed since. The key depends on the program
version, the arguments, the contents of the sources, and the fingerprints of the required steps.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gyrotrack._errors import OutputError
from gyrotrack._versions import __version__
from gyrotrack.apps.batch._experiments import Clip, Experiment, unique_name
from gyrotrack.io._atomic import locked, open_side_file

VERBS = ("extract", "sync", "fit", "diagnose", "improve", "report")
FIT = "{fit}"


@dataclass(frozen=True)
class Request:
    """Steps to run for every case."""

    until: str = "report"  # the last command
    # further options of each command, from a settings file; options in a manifest override these options
    extra: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    model: str = "reduced"  # the model to fit
    improve: bool = False  # whether to add effects until the residuals are consistent with noise

    def includes(self, verb: str) -> bool:
        """Return whether a command is among the steps."""
        return VERBS.index(verb) <= VERBS.index(self.until) and (verb != "improve" or self.improve)


@dataclass(frozen=True)
class Step:
    """One command of one case."""

    name: str  # unique name: folder of the case, command, and film
    # folder of the case, and command
    folder: str
    verb: str
    words: tuple[str, ...]  # arguments of the command; ``{fit}`` is the latest fit of the case
    output: Path  # output file
    files: tuple[Path, ...] = ()  # source files that no step makes: films, profiles, data
    # `needs`: steps that must all have succeeded; `needs_any`: steps that must have ended, at least one of them
    # successfully (outputs of failed steps are not used)
    needs: tuple[str, ...] = ()
    needs_any: tuple[str, ...] = ()


@dataclass
class Outcome:
    """Outcome of a step: "done", "kept" (from an earlier run), "failed", or "blocked" by a failed step."""

    state: str
    document: dict[str, Any] = field(default_factory=dict)
    fingerprint: str = ""
    seconds: float = 0.0
    trusted: bool = True

    @property
    def good(self) -> bool:
        """Whether the step has an output."""
        return self.state in {"done", "kept"}


def plan(experiments: Sequence[Experiment], results: Path, request: Request) -> tuple[Step, ...]:
    """Return all steps; each step follows the steps that it needs."""
    steps = (
        step for e in experiments for step in _experiment_steps(e, results.resolve() / e.folder, request)
    )
    return tuple(
        replace(s, words=(*s.words[:1], *request.extra.get(s.verb, ()), *s.words[1:])) for s in steps
    )


def _experiment_steps(e: Experiment, folder: Path, request: Request) -> list[Step]:
    names = {"case"}
    steps = [_extract(e, c, folder / f"{unique_name(c.file.stem, names)}.h5") for c in e.clips]
    if e.alone:
        return steps
    case = folder / "case.h5" if e.data is None else e.data.resolve()
    last: tuple[str, ...] = ()
    if e.data is None and request.includes("sync"):
        steps.append(_sync(e, steps[0], steps[1:], case))
        last = (steps[-1].name,)
    source = (case,) if e.data is not None else ()

    def step(verb: str, output: Path, *words: str) -> None:
        nonlocal last
        if request.includes(verb):
            made = Step(f"{e.folder}/{verb}", e.folder, verb, words, output, source, last)
            steps.append(made)
            last = (*last, made.name) if verb != "report" else last

    ledger = folder / "case.fits.json"
    kept = f"--ledger={ledger}"
    step("fit", ledger, str(case), "--model", request.model, kept)
    step("diagnose", folder / "diagnosis.json", str(case), "--from", FIT, kept)
    step("improve", ledger, str(case), "--from", FIT, kept)
    page = folder / "report.html"
    step("report", page, str(case), "--from", FIT, kept, "-o", str(page), "--force")
    return steps


def _extract(e: Experiment, clip: Clip, output: Path) -> Step:
    words = [str(clip.file), "-o", str(output), "--force", "--resume", "--workers", "1"]
    if clip.capture_fps is not None:
        words += ["--capture-fps", f"{clip.capture_fps:g}"]
    if clip.profile is not None:
        words += ["--profile", str(clip.profile)]
    files = (clip.file,) if clip.profile is None else (clip.file, clip.profile)
    return Step(f"{e.folder}/extract {output.stem}", e.folder, "extract", tuple(words), output, files)


def _sync(e: Experiment, casing: Step, rotors: Sequence[Step], case: Path) -> Step:
    words = [str(s.output) for s in (casing, *rotors)]
    words += ["-o", str(case), "--force", f"--label={e.label}", f"--surface={e.surface}"]
    for body in ("rotor", "casing"):
        inertia = getattr(e, f"inertia_{body}")
        if inertia is not None:
            words += [f"--inertia-{body}", inertia]
    needs = (casing.name,), tuple(r.name for r in rotors)
    return Step(f"{e.folder}/sync", e.folder, "sync", tuple(words), case, (), *needs)


def arguments_for(step: Step, steps: Mapping[str, Step], ended: Mapping[str, Outcome]) -> list[str]:
    """Return the final arguments of a step: failed films are removed, and the name of the latest fit is inserted."""
    lost = {str(steps[name].output) for name in step.needs_any if not ended[name].good}
    made = [ended[name].document for name in step.needs if steps[name].verb in {"fit", "improve"}]
    fits = [_fit_of(document) for document in made if document]
    return [str(fits[-1]) if word == FIT else word for word in step.words if word not in lost]


def _fit_of(document: Mapping[str, Any]) -> Any:
    """Return the name of the fit in a document of `fit` or `improve`."""
    return document.get("fit_id") or document.get("final", {}).get("fit_id")


_TYPES = {
    "step": str,
    "key": str,
    "fingerprint": str,
    "document": dict,
    "seconds": int | float,
    "trusted": bool,
}
HEADER = {"format": "gyrotrack batch", "version": 1}


class Journal:
    """The journal of one folder of results; an existing file with its name must be a journal."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._records: dict[str, dict[str, Any]] = {}
        self._truncated = False
        self._read()

    def _read(self) -> None:
        try:
            with open_side_file(self.path) as stream:
                text = stream.read().decode(errors="replace")
        except FileNotFoundError:
            return
        except OSError as error:
            what = f"{self.path} cannot be read: {error.strerror}."
            raise OutputError(what, "Choose another folder with -o.") from error
        lines = [_parsed(line) for line in text.splitlines()]
        self._truncated = bool(text) and not text.endswith("\n")
        # the header is truncated
        if self._truncated and len(lines) == 1 and json.dumps(HEADER).startswith(text):
            self.path.write_bytes(b"")
            self._truncated, lines = False, []
        if lines and lines[0] != HEADER:
            raise OutputError(f"{self.path} is not the journal of a batch.", "Choose another folder with -o.")
        for record in lines[1:]:  # a truncated last line is ignored
            if isinstance(record, dict) and all(isinstance(record.get(k), t) for k, t in _TYPES.items()):
                self._records[record["step"]] = record

    def kept(self, step: Step, key: str) -> Outcome | None:
        """Return the outcome of an earlier run; None if the sources or the output of the step have changed."""
        record = self._records.get(step.name, {})
        document, known = record.get("document", {}), record.get("fingerprint")
        if record.get("key") != key or not known or fingerprint(step, document) != known:
            return None
        return Outcome("kept", document, known, record["seconds"], record["trusted"])

    def add(self, step: Step, key: str, outcome: Outcome) -> None:
        """Append the outcome of a step and flush it to the disk."""
        record = {
            "step": step.name,
            "key": key,
            "state": outcome.state,
            "fingerprint": outcome.fingerprint,
            "seconds": round(outcome.seconds, 3),
            "trusted": outcome.trusted,
            "version": __version__,
            "document": outcome.document,
        }
        try:
            with open_side_file(self.path, os.O_RDWR | os.O_CREAT) as stream:
                if not stream.seek(0, os.SEEK_END):
                    stream.write(json.dumps(HEADER).encode() + b"\n")
                if self._truncated:
                    stream.write(b"\n")
                    self._truncated = False
                stream.write(json.dumps(record).encode() + b"\n")
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            what = f"{self.path} cannot be written: {error.strerror}."
            raise OutputError(what, "Free space and run the batch again.") from error
        self._records[step.name] = record


def step_key(
    step: Step, words: list[str], results: Path, contents: Mapping[Path, str], before: list[str]
) -> str:
    """Return a hash of all inputs that determine the output of a step.

    It does not depend on the location of the folders.
    """
    names = {str(path): digest for path, digest in contents.items()}
    top = str(results.resolve())
    stated = [names.get(word, word.replace(top, "results")) for word in words]
    whole = [__version__, step.verb, stated, [contents[p] for p in step.files], before]
    return hashlib.sha256(json.dumps(whole).encode()).hexdigest()


def fingerprint(step: Step, document: Mapping[str, Any]) -> str:
    """Return a hash of the output of a step, or "" if there is no output."""
    if step.verb in {"fit", "improve"}:  # the fit alone is used, because its ledger may contain later fits
        return _fit_digest(step.output, str(_fit_of(document)))
    return file_digest(step.output) or ""


def _fit_digest(ledger: Path, fit_id: str) -> str:
    try:
        fits = json.loads(ledger.read_text(encoding="utf-8"))["fits"]
        (own,) = [f for f in fits if f["fit_id"] == fit_id]
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()


def file_digest(path: Path) -> str | None:
    """Return the SHA-256 of a regular file's bytes; None if it cannot be read."""
    try:
        if not path.is_file():
            return None
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return None


def _parsed(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


@contextmanager
def locked_folder(results: Path) -> Iterator[None]:
    """Create the folder if necessary, and lock it against other batches; other files in it raise an OutputError."""
    mark = results / "batch.lock"
    try:
        results.mkdir(parents=True, exist_ok=True)
        if not mark.exists() and any(results.iterdir()):
            what = f"{results} contains files that do not belong to a batch."
            raise OutputError(what, "Choose an empty folder with -o.")
        open_side_file(mark, os.O_RDWR | os.O_CREAT).close()
    except OSError as error:
        what = f"{results} cannot be written: {error.strerror or error}."
        raise OutputError(what, "Choose another folder with -o.") from error
    with locked(mark):
        yield
