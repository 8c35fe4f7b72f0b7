"""Commands simulate, reveal and demo."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, NotRequired, TypedDict

import typer

from fitting._numbers import rounded
from fitting._workers import available_cores
from gyrotrack._errors import DatasetError, GyrotrackError, UsageError
from gyrotrack.apps._study import changed, open_study
from gyrotrack.apps.cli import _settings as shared
from gyrotrack.apps.cli._output import (
    Output,
    Progress,
    command_line,
    diagnosis_tables,
    fit_tables,
    ladder_tables,
)
from gyrotrack.apps.cli._settings import option

if TYPE_CHECKING:
    from fitting._schema import FitDocument, StepDocument
    from fitting.discovery._select import Step
    from fitting.discovery._verdict import Diagnosis
    from fitting.study._serialisation import DiagnosisDocument


_PAPER_ROTOR, _PAPER_CASING = 5.54e-5, 2.06e-5  # default moments of inertia [kg m2]
_WINDOWS = (0.025, 0.35, 0.75)  # default starts of the rotor windows [share of the duration]


class SimulationDocument(TypedDict):
    """A simulated case."""

    output: Path  #: The case.
    model: NotRequired[list[str]]  #: Names of the effects; not with `--hide`.
    parameters: NotRequired[dict[str, float]]  #: Simulated parameters by key; not with `--hide` [SI units].
    seal: NotRequired[Path]  #: The sealed file, with `--hide`.
    #: With `--hide`: SHA-256 of the hidden effect, its parameters and a random salt; it later proves that these were
    #: not changed.
    commitment: NotRequired[str]
    films: list[Path]  #: Rendered films, with `--film`.


class RevealDocument(TypedDict):
    """A sealed effect, and the grade of an answer."""

    effect: str  #: The hidden effect.
    parameters: dict[str, float]  #: Simulated parameters by key [SI units].
    answer: list[str]  #: Effects of the answer.
    grade: str  #: `right`, `right class` or `wrong`.
    #: Difference between the fitted and the simulated value of each parameter, by key [standard errors].
    pulls: dict[str, float]
    commitment: str  #: SHA-256 of the hidden effect, its parameters and a random salt, from the sealed file.


class DemoDocument(TypedDict):
    """The analysis of the sample clips."""

    case: Path  #: The case.
    report: Path  #: The report.
    picture: Path  #: A picture of the result.
    diagnosis: DiagnosisDocument  #: Diagnosis of the first fit.
    ladder: list[StepDocument]  #: Fits, oldest first.
    final: FitDocument  #: The last fit.
    verdict: str  #: `adequate`, `missing_effect` (found and added) or `unexplained`.
    seconds: float  #: Duration [s].


def simulate_command(
    *,
    output: shared.OutputFile,
    add: Annotated[
        list[str] | None, option("--add E", "Effect to add to the reduced model, by name or as a law.")
    ] = None,
    drop: Annotated[list[str] | None, option("--drop E", "Effect to remove.")] = None,
    effects: shared.EffectsFile = None,
    set_values: Annotated[
        list[str] | None,
        option("--set KEY=VALUE", "Set a parameter: casing.air.quadratic.k=1e-9 (SI units)."),
    ] = None,
    strength: Annotated[
        float,
        option("--strength", "Torque of each added effect [1e-4 N m]; --set of its parameters overrides it."),
    ] = 0.01,
    omega_rotor: Annotated[
        float, option("--omega-rotor", "Initial angular rate of the rotor [rad/s].")
    ] = 900.0,
    omega_casing: Annotated[
        float, option("--omega-casing", "Initial angular rate of the casing [rad/s].")
    ] = 5.0,
    duration: Annotated[float, option("--duration", "Duration of the recording [s].")] = 200.0,
    window: Annotated[
        list[float] | None, option("--window T", "Start of a rotor window [s]; once per window.")
    ] = None,
    window_length: Annotated[float, option("--window-length", "Duration of the rotor windows [s].")] = 3.0,
    casing_fps: Annotated[float, option("--casing-fps", "Capture rate of the casing camera [1/s].")] = 260.0,
    rotor_fps: Annotated[float, option("--rotor-fps", "Capture rate of the rotor camera [1/s].")] = 1000.0,
    sigma: Annotated[float, option("--sigma", "Standard deviation of the angle noise [rad].")] = 1e-3,
    torque_noise: Annotated[float, option("--torque-noise", "Rms of the random torque [N m].")] = 0.0,
    torque_time: Annotated[
        float, option("--torque-time", "Correlation time of the random torque [s].")
    ] = 1.0,
    centre_offset: Annotated[
        float,
        option(
            "--centre-offset", "Amplitude of the error of the angle due to an offset of the centre [rad]."
        ),
    ] = 0.0,
    seed: Annotated[int, option("--seed", "Random seed.")] = 0,
    film: Annotated[Path | None, option("--film DIR", "Also render the films into this folder.")] = None,
    hide: Annotated[
        bool, option("--hide", "Add a random effect and store its name in a sealed file.")
    ] = False,
    label: shared.Label = None,
    surface: shared.Surface = "",
    inertia_rotor: shared.InertiaRotor = None,
    inertia_casing: shared.InertiaCasing = None,
    force: shared.Force = False,
    out: shared.Out,
) -> None:
    """Simulate a case of the paper's gyroscope with chosen effects, as data or as films.

    The default moments of inertia are those of the paper, 5.54e-5 and 2.06e-5 kg m2. The simulated bodies have exactly
    the given moments of inertia; an uncertainty, if given, is stored in the case.

    Example: gyrotrack simulate -o case.h5 --add casing.air.quadratic --strength 0.03
    """
    from fitting.dynamics._model import Model
    from fitting.effects._library import REDUCED
    from fitting.inference._simulation import Experiment
    from gyrotrack.apps._simulation import SimulatedRun, hide_effect, write_record
    from gyrotrack.io._outputs import new_outputs
    from gyrotrack.io._records import Inertia

    sealed = output.with_name(f"{output.stem}.seal.json") if hide else None
    experiment = Experiment(
        omega_rotor=omega_rotor,
        omega_casing=omega_casing,
        duration=duration,
        casing_fps=casing_fps,
        rotor_fps=rotor_fps,
        windows=tuple(window) if window else tuple(round(x * duration, 6) for x in _WINDOWS),
        window_length=window_length,
        sigma=sigma,
        torque_noise=torque_noise,
        torque_time=torque_time,
        centre_offset=centre_offset,
    )
    model = changed(Model.of(REDUCED), add or (), drop or (), shared.own_effects(effects))
    hidden = hide_effect(model, strength) if hide else None
    if hidden is not None:
        model, strength, seed = hidden.model, hidden.strength, hidden.seed
    if inertia_rotor is None or inertia_casing is None:
        out.note("Default moments of inertia are those of the paper: rotor 5.54e-5, casing 2.06e-5 kg m2.")
    rotor = Inertia.of(inertia_rotor or _PAPER_ROTOR, "rotor")
    casing = Inertia.of(inertia_casing or _PAPER_CASING, "casing")
    run = SimulatedRun.of(model, strength, experiment, (rotor.value, casing.value), seed, set_values or ())
    films = run.film_files(film) if film is not None else []
    if film is not None:
        film.mkdir(parents=True, exist_ok=True)
    with new_outputs(output, sealed, *films, force=force, reads=[effects]):
        pass
    with out.progress("simulating") as progress:
        progress(0, None)
        record = run.record(label if label is not None else output.stem)
    record = replace(record, I_rotor_u=rotor.u, I_casing_u=casing.u)
    with new_outputs(output, sealed, *films, force=force, reads=[effects]):
        if sealed is None or hidden is None:
            stated: dict[str, Any] = {"model": list(model.names), "parameters": run.numbers}
            settings: dict[str, Any] = {"output": output, **stated, "seed": seed}
            lines = [f"  {key:<34}{value:.6g}" for key, value in run.numbers.items()]
        else:
            commitment = hidden.seal(sealed, run.numbers, force=force)
            stated, settings = {"seal": sealed, "commitment": commitment}, {"commitment": commitment}
            lines = [f"sealed: {sealed}"]
        settings = {"experiment": vars(experiment), **settings}
        write_record(output, record, surface=surface, command=command_line(), settings=settings, force=force)
        if film is not None:
            with out.progress("rendering films") as progress:
                run.films(film, force=force, progress=progress)
    out.result({"output": output, **stated, "films": films})
    out.show("\n".join([*lines, *(f"written: {f}" for f in (output, *films))]))


Answer = tuple[list[str], dict[str, tuple[float, float]]]


def reveal_command(
    seal: Annotated[
        Path, typer.Argument(metavar="SEAL.json", help="Sealed file, made by `simulate --hide`.")
    ],
    case: Annotated[
        Path | None, typer.Argument(metavar="CASE.h5", help="Case whose latest fit is the answer.")
    ] = None,
    *,
    answer: Annotated[
        str | None, option("--answer E", "Answer: an effect, several separated by commas, or `none`.")
    ] = None,
    ledger: shared.LedgerFile = None,
    out: shared.Out,
) -> None:
    """Open a sealed challenge and score an answer: the answer of --answer, or the latest fit of the case.

    Example: gyrotrack reveal case.seal.json case.h5
    """
    from gyrotrack.apps._simulation import grade, unseal
    from gyrotrack.io._atomic import refuse_special

    if (case is None) == (answer is None):
        what = "The file can be opened only with exactly one answer."
        raise UsageError(what, "Give the fitted case, or --answer.")
    named, found = _stated(answer) if case is None else _fitted(case, ledger)
    refuse_special(seal)
    truth = unseal(seal)
    score = grade(truth, named, found)
    document: RevealDocument = {
        "effect": truth.effect,
        "parameters": truth.parameters,
        "answer": named,
        "grade": score.grade,
        "pulls": score.pulls,
        "commitment": truth.commitment,
    }
    out.result(document)
    lines = [score.sentence, *(f"  {k} = {v:.6g}" for k, v in truth.parameters.items())]
    lines += [f"  {k}: {z:+.1f} standard errors from the true value" for k, z in score.pulls.items()]
    out.show("\n".join(lines))


def _stated(answer: str | None) -> Answer:
    words = (answer or "none").strip()
    return [] if words == "none" else [a.strip() for a in words.split(",")], {}


def _fitted(case: Path, ledger: Path | None) -> Answer:
    from gyrotrack.apps._simulation import answer_of

    study = open_study([case], ledger)
    entries = study.ledger.of(study.data)
    if not entries:
        raise DatasetError("There is no fit of this case yet.", "Run `gyrotrack improve`.")
    return answer_of(entries)


def demo_command(
    *,
    clips: Annotated[Path | None, option("--clips DIR", "Folder with study.toml and the films.")] = None,
    output: Annotated[Path, option("-o --output DIR", "Folder for the results.")] = Path("gyrotrack_demo"),
    force: shared.Force = False,
    out: shared.Out,
) -> None:
    """Run the whole analysis of the sample clips: tracking, synchronisation, fit, missing effect, report.

    Example: gyrotrack demo -o gyrotrack_demo
    """
    from gyrotrack.io._outputs import new_outputs

    began = perf_counter()
    folder = _find(clips)
    study = tomllib.loads((folder / "study.toml").read_text(encoding="utf-8"))
    output.mkdir(parents=True, exist_ok=True)
    films = [folder / clip["file"] for clip in study["clip"]]
    recordings, case = [output / f"{film.stem}.h5" for film in films], output / "case.h5"
    made = [*recordings, case, output / "report.html", output / "story.png"]
    _check_ledger(case, force=force)
    with new_outputs(*made, force=force, reads=[*films, folder / "study.toml"]):
        document = _analyse(out, folder, study, recordings, case, force=force)
    document["seconds"] = perf_counter() - began
    out.result(document)
    out.show(f"\nDone in {document['seconds']:.0f} s. Report: {document['report']}")


def _check_ledger(case: Path, *, force: bool) -> None:
    """Raise an OutputError if the case already has fits, unless an interrupted demo made the case."""
    from fitting.study._history import Ledger
    from gyrotrack.io._atomic import is_left, refuse_existing

    refuse_existing(Ledger.default_for(case).path, force=force or is_left(case))


def _analyse(
    out: Output, folder: Path, study: dict[str, Any], recordings: list[Path], case: Path, *, force: bool
) -> dict[str, Any]:
    """Run the whole analysis and return its JSON document."""
    from fitting.study._history import Ledger

    out.show(f"1. Track the markers in the films of one run, in {folder}\n")
    _extract(out, folder, study["clip"], recordings, force=force)
    out.show("\n2. Synchronise the cameras by the angle of the casing, which both cameras see\n")
    casing = [r for r, c in zip(recordings, study["clip"], strict=True) if c["body"] == "casing"]
    rotors = [r for r, c in zip(recordings, study["clip"], strict=True) if c["body"] != "casing"]
    keys = ("inertia_rotor", "inertia_casing", "label", "surface")
    options = [w for k in keys for w in (f"--{k.replace('_', '-')}", str(study[k]))]
    _run(out, [["sync", *casing, *rotors, "-o", case, *options]], [case], force=force)
    ledger = Ledger.default_for(case).path
    ledger.unlink(missing_ok=True)  # discard the fits of an interrupted demo
    try:
        return _study(out, case, folder / study["clip"][-1]["file"], force=force)
    except BaseException:
        ledger.unlink(missing_ok=True)
        raise


def _study(out: Output, case: Path, film: Path, *, force: bool) -> dict[str, Any]:
    """Fit, diagnose, improve and report; return the JSON documents."""
    from gyrotrack.apps.report._page import write_report
    from gyrotrack.io._hdf5 import read_case
    from gyrotrack.plotting._discovery import story_picture

    output = case.parent
    steps_of_history, diagnosis, document = _fit_and_diagnose(out, case)
    out.show(f"\n6. Write the report\n\n$ gyrotrack report {case} -o {output / 'report.html'}")
    target, stated = output / "report.html", {"command": "gyrotrack demo"}
    recordings = [read_case(case)]
    report = write_report(
        target, steps_of_history, diagnosis, recordings=recordings, provenance=stated, force=force
    )
    picture = story_picture(
        steps_of_history, diagnosis, output / "story.png", frame=_frame(film), force=force
    )
    return {"case": case, "report": report, "picture": picture, **document}


def _fit_and_diagnose(out: Output, case: Path) -> tuple[list[Step], Diagnosis, dict[str, Any]]:
    """Fit the reduced model, diagnose and improve it; return the history, the diagnosis, and their JSON documents."""
    from fitting.discovery._select import improve
    from fitting.discovery._verdict import diagnose
    from fitting.dynamics._model import Model
    from fitting.effects._library import REDUCED
    from fitting.inference._fit import fit
    from fitting.study._serialisation import diagnosis_document, fit_document, history_verdict

    study = open_study([case], None)
    out.show("\n3. Fit the reduced model of the paper", f"\n$ gyrotrack fit {case}\n")
    base = fit(Model.of(REDUCED), study.data)
    first = study.ledger.add(base, added="reduced")
    out.show(*fit_tables(base, first.fit_id))
    out.show(
        "\n4. Locate the lack of fit and identify the missing effect", f"\n$ gyrotrack diagnose {case}\n"
    )
    diagnosis = diagnose(base)
    out.show(*diagnosis_tables(diagnosis, first.fit_id))
    out.show("\n5. Add the effect and fit again", f"\n$ gyrotrack improve {case}\n")
    kept = study.recorder(first.fit_id, base)
    steps_of_history = improve(base, first=diagnosis.candidates, keep=kept)
    steps = [entry.document["rung"] for entry in kept.entries]
    out.show(*ladder_tables(steps, study.data[0].record))
    document = {
        "diagnosis": diagnosis_document(diagnosis, first.fit_id),
        "ladder": steps,
        "final": fit_document(steps_of_history[-1].fit, kept.entries[-1].fit_id),
        "verdict": history_verdict(steps_of_history),
    }
    return steps_of_history, diagnosis, document


def _frame(film: Path) -> Any:
    """Return the first frame of a film as red, green, blue."""
    import av

    with av.open(str(film)) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


def _find(clips: Path | None) -> Path:
    from gyrotrack.apps._sample import sample_folder

    installed = sample_folder()
    places = [clips] if clips is not None else [Path("sample_clips"), *([installed] if installed else [])]
    for place in places:
        if (place / "study.toml").is_file():
            return place
    raise DatasetError(
        f"There are no sample clips in {places[0]}.",
        "Give the folder of the films and their study.toml with --clips, or install gyrotrack again.",
    )


def _extract(
    out: Output, folder: Path, clips: Sequence[dict[str, Any]], targets: Sequence[Path], *, force: bool
) -> None:
    """Track all clips in parallel worker processes."""
    jobs = [
        ["extract", folder / clip["file"], "--capture-fps", str(clip["capture_fps"]), "-o", target]
        for clip, target in zip(clips, targets, strict=True)
    ]
    with out.progress("tracking films") as progress:
        _run(out, jobs, targets, progress, force=force)


def _run(
    out: Output,
    jobs: Sequence[Sequence[object]],
    targets: Sequence[Path],
    progress: Progress | None = None,
    *,
    force: bool,
) -> None:
    """Run commands in worker processes and show their results; raise the first error."""
    from gyrotrack.apps.batch._workers import LocalWorkers
    from gyrotrack.io._atomic import mark_new

    lines = [[str(word) for word in (*job, *(["--force"] if force else []))] for job in jobs]
    workers = LocalWorkers(min(available_cores(), len(lines)))
    try:
        answers = [workers.submit(words, None) for words in lines]
        for done, (words, answer, target) in enumerate(zip(lines, answers, targets, strict=True), 1):
            document = answer.result()["document"]
            if "error" in document:
                error = document["error"]
                raise GyrotrackError(error["message"], error["hint"])
            if not force:
                mark_new(target, target)
            out.show(f"$ gyrotrack {shlex.join(words)}\n" + _step_summary(words[0], document))
            if progress is not None:
                progress(done, len(lines))
    finally:
        workers.close()


def _step_summary(verb: str, document: dict[str, Any]) -> str:
    if verb == "extract":
        bodies = ", ".join(
            f"{n} {b['samples']} angles +- {1e3 * b['median_sigma']:.2g} mrad"
            for n, b in document["body"].items()
        )
        return f"  {document['frames']} frames at {document['fps']:.0f}/s: {bodies}"
    lines = [
        f"  {Path(c['source']).name} starts at {rounded(c['offset_s'], c['offset_sigma_s'], 's')}"
        + (" (ambiguous)" if c["ambiguous"] else "")
        for c in document.get("clips", [])
    ]
    return "\n".join(lines)
