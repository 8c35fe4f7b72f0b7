"""The steps of a batch and their order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gyrotrack.apps.batch._experiments import Clip, Experiment, folder_name

VERBS = ("extract", "sync", "fit", "diagnose", "improve", "report")
FIT = "{fit}"


@dataclass(frozen=True)
class Request:
    """Steps to run for every case.

    Attributes
    ----------
    until : str
        The last verb.
    extra : mapping
        Further options of each verb, from a settings file; those of a manifest override them.
    model : str
        The model to fit.
    improve : bool
        Also add effects until the residuals are consistent with noise.
    """

    until: str = "report"
    extra: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    model: str = "reduced"
    improve: bool = False

    def wants(self, verb: str) -> bool:
        """Tell whether a verb is among the steps."""
        return VERBS.index(verb) <= VERBS.index(self.until) and (verb != "improve" or self.improve)


@dataclass(frozen=True)
class Step:
    """One command of one case.

    Attributes
    ----------
    name : str
        Unique: the case's folder, the verb, and the film.
    folder, verb : str
        The case and the command.
    words : tuple of str
        Arguments of the command; ``{fit}`` is the latest fit of the case.
    files : tuple of Path
        Sources: films, profiles, data that no step makes.
    output : Path
        What it makes.
    needs, wants : tuple of str
        Steps that must have succeeded, and steps that must have ended: the outputs of those that failed are left
        out, and one of them at least must have succeeded.
    """

    name: str
    folder: str
    verb: str
    words: tuple[str, ...]
    output: Path
    files: tuple[Path, ...] = ()
    needs: tuple[str, ...] = ()
    wants: tuple[str, ...] = ()


@dataclass
class Outcome:
    """How a step ended: "done", "kept" (from an earlier run), "failed", or "blocked" by one before it."""

    state: str
    document: dict[str, Any] = field(default_factory=dict)
    fingerprint: str = ""
    seconds: float = 0.0
    trusted: bool = True

    @property
    def good(self) -> bool:
        """Whether there is an output to go on with."""
        return self.state in {"done", "kept"}


def plan(experiments: Sequence[Experiment], results: Path, request: Request) -> tuple[Step, ...]:
    """Return all steps, each after those that it needs."""
    steps = (step for e in experiments for step in _of(e, results.resolve() / e.folder, request))
    return tuple(
        replace(s, words=(*s.words[:1], *request.extra.get(s.verb, ()), *s.words[1:])) for s in steps
    )


def _of(e: Experiment, folder: Path, request: Request) -> list[Step]:
    steps: list[Step] = []
    names: set[str] = set()
    for clip in e.clips:
        stem = _unique(clip.file.stem, names)
        steps.append(_extract(e, clip, folder / f"{stem}.h5"))
    if e.alone:
        return steps
    case = folder / "case.h5" if e.data is None else e.data.resolve()
    last: tuple[str, ...] = ()
    if e.data is None and request.wants("sync"):
        steps.append(_sync(e, steps[0], steps[1:], case))
        last = (steps[-1].name,)
    source = (case,) if e.data is not None else ()

    def step(verb: str, output: Path, *words: str) -> None:
        nonlocal last
        if request.wants(verb):
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
    words = [str(clip.file), "-o", str(output), "--force", "--resume"]
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
    return Step(
        f"{e.folder}/sync",
        e.folder,
        "sync",
        tuple(words),
        case,
        (),
        (casing.name,),
        tuple(r.name for r in rotors),
    )


def words_for(step: Step, steps: Mapping[str, Step], ended: Mapping[str, Outcome]) -> list[str]:
    """Return the words of a step whose needs are met: failed films left out, the latest fit put in."""
    lost = {str(steps[name].output) for name in step.wants if not ended[name].good}
    fits = [
        document.get("fit_id") or document.get("final", {}).get("fit_id")
        for name in step.needs
        if steps[name].verb in {"fit", "improve"} and (document := ended[name].document)
    ]
    return [str(fits[-1]) if word == FIT else word for word in step.words if word not in lost]


def _unique(stem: str, taken: set[str]) -> str:
    name = base = folder_name(stem)
    number = 1
    while name.casefold() in taken or name.casefold() == "case":
        number += 1
        name = f"{base}_{number}"
    taken.add(name.casefold())
    return name
