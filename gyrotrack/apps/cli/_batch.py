"""Commands batch and config, and the worker process of a batch (``python -m gyrotrack.apps.cli._batch``)."""

from __future__ import annotations

import inspect
import io
import json
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from enum import Enum, StrEnum
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, NotRequired, TypedDict

import typer

from gyrotrack._errors import UsageError
from gyrotrack._versions import __version__
from gyrotrack.apps.cli import _settings as shared
from gyrotrack.apps.cli._output import (
    DONE,
    FAULT,
    HUNG_UP,
    INTERRUPTED,
    NOT_TRUSTED,
    TERMINATED,
    Output,
    command_line,
)
from gyrotrack.apps.cli._settings import option

if TYPE_CHECKING:
    from fitting._settings import Setting
    from gyrotrack.apps.batch._experiments import Experiment
    from gyrotrack.apps.batch._runner import BatchResult, Row
    from gyrotrack.apps.batch._steps import Outcome, Step


class Until(StrEnum):
    """Last step of a batch."""

    extract = "extract"
    sync = "sync"
    fit = "fit"
    diagnose = "diagnose"
    report = "report"


class BatchDocument(TypedDict):
    """The results of a batch."""

    output: Path  #: Folder of the results.
    command: str  #: The command.
    steps: dict[str, int]  #: Number of steps by state: `done`, `kept`, `failed`, `blocked`.
    seconds: float  #: Duration [s].
    cases: Sequence[Row]  #: Results of each case.
    summary: Sequence[Path]  #: Files of the summary.


class PlannedCase(TypedDict):
    """A case of a batch."""

    label: str  #: Name of the case.
    films: list[str]  #: Films of the case.


class PlannedStep(TypedDict):
    """A step of a batch."""

    name: str  #: Name of the step.
    output: Path  #: File that the step writes.
    state: str  #: `kept` (complete) or `to do`.


class BatchPlan(TypedDict):
    """The cases and steps of a batch."""

    cases: list[PlannedCase]  #: Cases.
    steps: list[PlannedStep]  #: Steps.


_From = TypedDict("_From", {"from": Annotated[str, "Origin: `file` or `default`."]})


class OptionDocument(_From):
    """An option of a command."""

    value: Any  #: Value of the option; null without a value.
    line: NotRequired[int | None]  #: Line of the settings file, for an option from this file.


class ConfigDocument(TypedDict):
    """The settings in use."""

    file: Path | None  #: The settings file; null without a settings file.
    settings: dict[str, dict[str, OptionDocument]]  #: Options by command and key of the settings file.


class NumbersDocument(TypedDict):
    """The numbers on which the results of the program depend."""

    tracking: NotRequired[
        list[Setting]
    ]  #: Numbers of tracking, video and synchronisation, with `--tracking`.
    fitting: NotRequired[
        list[Setting]
    ]  #: Numbers of fits, noise estimates, searches and verdicts, with `--fitting`.


def batch_command(
    source: Annotated[
        Path, typer.Argument(metavar="MANIFEST|DIR", help="Manifest (TOML or CSV), or folder of films.")
    ],
    *,
    output: Annotated[Path, option("-o --output DIR", "Folder for the results.")] = Path("gyrotrack_batch"),
    workers: Annotated[
        int | None, option("--workers N", "Worker processes; by default one per core.", min=1)
    ] = None,
    cluster: shared.OfCluster,
    until: Annotated[Until, option("--until", "Last step to run.")] = Until.report,
    model: Annotated[str, option("--model M", "Model to fit.")] = "reduced",
    improve: Annotated[bool, option("--improve", "Also run `improve`.")] = False,
    casing_fps: Annotated[
        float | None, option("--casing-fps N", "Capture rate of the casing films in a folder [1/s].")
    ] = None,
    rotor_fps: Annotated[
        float | None, option("--rotor-fps N", "Capture rate of the rotor films in a folder [1/s].")
    ] = None,
    inertia_rotor: shared.InertiaRotor = None,
    inertia_casing: shared.InertiaCasing = None,
    timeout: Annotated[float, option("--timeout S", "Time limit of one step [s].", min=1.0)] = 7200.0,
    dry_run: Annotated[bool, option("--dry-run", "List the steps and run none.")] = False,
    out: shared.VerboseOut,
) -> int:
    """Track, synchronise, fit, diagnose and report every case of a manifest or a folder.

    Steps that were completed with the same films and settings are not repeated. If a film fails, the other films are
    still processed. In a folder, casing*.mp4 and rotor*.mp4 form a case, NAME_casing.mp4 and NAME_rotor*.mp4 form the
    case NAME; other films are only tracked. The address of a scheduler is read from the command line, the environment
    or your own settings file, never from a gyrotrack.toml in the folder of the data.

    Example: gyrotrack batch films/ -o results --casing-fps 260 --rotor-fps 1000 --inertia-rotor 5.54e-5
    --inertia-casing 2.06e-5
    """
    from gyrotrack.apps.batch._experiments import read_folder, read_manifest, with_inertias
    from gyrotrack.apps.batch._runner import run_batch
    from gyrotrack.apps.batch._steps import Request, plan

    cases = (
        read_folder(source, casing_fps=casing_fps, rotor_fps=rotor_fps, skip=output)
        if source.is_dir()
        else read_manifest(source)
    )
    extra = _step_settings()
    if until is not Until.extract:
        by_settings = {word.partition("=")[0] for word in extra.get("sync", ())}
        given = {
            body: value if f"--inertia-{body}" not in by_settings else None
            for body, value in (("rotor", inertia_rotor), ("casing", inertia_casing))
        }
        cases = with_inertias(cases, given, skip=by_settings)
    steps = plan(cases, output, Request(until.value, extra, model, improve))
    if dry_run:
        return _show_plan(out, cases, steps, output)

    if cluster.scheduler is not None and not cluster.scheduler.startswith("tls://"):
        out.warn(
            "the connection to the scheduler is neither encrypted nor authenticated; use a tls:// address."
        )
    called = command_line()
    ended = run_batch(
        cases,
        steps,
        output,
        command=called,
        workers=workers,
        cluster=cluster,
        timeout=timeout,
        report=partial(_report_step, out),
        bar=lambda: out.progress("running"),
    )
    return _show_result(out, ended, output, called)


def _report_step(out: Output, step: Step, outcome: Outcome) -> None:
    if outcome.state == "failed":
        out.note(f"failed: {step.name}: {outcome.document.get('error', {}).get('message', '')}")
    elif outcome.state == "done":
        out.detail(f"{step.name}: {outcome.seconds:.1f} s")


def _show_result(out: Output, ended: BatchResult, output: Path, command: str) -> int:
    from gyrotrack.apps.batch._runner import lines

    document: BatchDocument = {
        "output": output,
        "command": command,
        "steps": ended.steps,
        "seconds": ended.seconds,
        "cases": ended.rows,
        "summary": ended.summary,
    }
    out.result(document)
    counts = ", ".join(f"{n} {state}" for state, n in ended.steps.items() if n)
    total = sum(ended.steps.values())
    out.show("\n".join([*lines(ended.rows), "", f"{counts} of {total} steps, {ended.seconds:.0f} s"]))
    out.show(f"written: {', '.join(str(p) for p in ended.summary)}")
    if any(row.state != "done" for row in ended.rows):
        return FAULT
    return DONE if all(row.trusted for row in ended.rows) else NOT_TRUSTED


def _step_settings() -> dict[str, tuple[str, ...]]:
    """Return the settings of the steps as command-line arguments."""
    from gyrotrack.apps.batch._steps import VERBS
    from gyrotrack.apps.cli._app import COMMANDS, settings_in_use
    from gyrotrack.apps.cli._settings import as_words

    settings = settings_in_use()
    return {
        e.name: as_words(settings, e, _SET_BY_BATCH) for e in COMMANDS if e.name in VERBS and settings.values
    }


_SET_BY_BATCH = frozenset(
    {"output", "force", "json", "quiet", "verbose", "ledger", "from", "label", "surface", "model"}
    | {"overlay", "contact_sheet", "resume"}
)


def _show_plan(out: Output, cases: tuple[Experiment, ...], steps: tuple[Step, ...], output: Path) -> int:
    from gyrotrack.apps.batch._runner import preview

    state = preview(steps, output)
    out.result(
        BatchPlan(
            cases=[{"label": e.label, "films": [str(c.file) for c in e.clips]} for e in cases],
            steps=[{"name": s.name, "output": s.output, "state": state[s.name]} for s in steps],
        )
    )
    listed = [f"{state[s.name]:<7}{s.name}" for s in steps]
    kept = sum(found == "kept" for found in state.values())
    out.show(
        "\n".join([*listed, "", f"{len(cases)} cases, {len(steps)} steps, {kept} kept; nothing was run"])
    )
    return DONE


def config_command(
    name: Annotated[
        str | None, typer.Argument(metavar="COMMAND", help="Show the options of one command.")
    ] = None,
    *,
    everything: Annotated[bool, option("--all", "Also show options at their defaults.")] = False,
    tracking: Annotated[
        bool, option("--tracking", "Show the numbers of tracking instead of the options.")
    ] = False,
    fitting: Annotated[
        bool, option("--fitting", "Show the numbers of fits and diagnoses instead of the options.")
    ] = False,
    out: shared.Out,
) -> None:
    """Show the settings in use and the origin of each: a file or the default.

    An option on the command line overrides the file; the file overrides the default. The file is the first of:
    --config, $GYROTRACK_CONFIG, gyrotrack.toml in this folder, the settings file of the user. A gyrotrack.toml in this
    folder may not set addresses, ports, certificates, --force or paths outside of the folder.

    --tracking shows every number of tracking, video and synchronisation with its unit, meaning and origin: it is
    derived, measured, taken from a source, or chosen. --fitting shows the numbers of fits, noise estimates, searches
    and verdicts. These numbers are part of the program and cannot be set in a file.

    Example: gyrotrack config extract
    """
    from gyrotrack.apps.cli._app import COMMANDS, settings_in_use
    from gyrotrack.apps.cli._settings import options_of

    if tracking or fitting:
        if name is not None or everything:
            kind = "--tracking" if tracking else "--fitting"
            raise UsageError(f"{kind} shows no options of commands.", "Omit the command and --all.")
        from fitting._settings import fitting_settings
        from gyrotrack._tracking_settings import tracking_settings

        numbers = {"tracking": tracking_settings()} if tracking else {}
        numbers |= {"fitting": fitting_settings()} if fitting else {}
        out.result({of: s.to_json() for of, s in numbers.items()})
        out.show("\n\n".join(map(str, numbers.values())))
        return
    chosen = [e for e in COMMANDS if name in {None, e.name}]
    if not chosen:
        raise UsageError(f"There is no command '{str(name)[:40]}'.", "`gyrotrack --help` lists the commands.")
    settings = settings_in_use()
    rows: dict[str, dict[str, OptionDocument]] = {}
    for entry in chosen:
        defaults = inspect.signature(shared.function_of(entry)).parameters
        held = settings.values.get(entry.name, {})
        for parameter, key in options_of(entry).items():
            if parameter in held:
                line = settings.lines[entry.name, parameter]
                rows.setdefault(entry.name, {})[key] = {
                    "value": held[parameter],
                    "from": "file",
                    "line": line,
                }
            elif everything or name is not None:
                default = defaults[parameter].default
                plain = default.value if isinstance(default, Enum) else default
                shown = None if plain is inspect.Parameter.empty else plain
                rows.setdefault(entry.name, {})[key] = {"value": shown, "from": "default"}
    out.result(ConfigDocument(file=settings.path, settings=rows))
    lines = [f"file: {settings.path or 'none'}"]
    for section, keys in rows.items():
        lines += ["", f"[{section}]"]
        for key, row in keys.items():
            origin = f"{settings.path}, line {row['line']}" if row["from"] == "file" else "default"
            lines.append(f"{key} = {_toml(row['value'])}".ljust(40) + f" # {origin}")
    out.show("\n".join(lines))


def _toml(value: Any) -> str:
    if value is None:
        return '""'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return (
        repr(value)
        if isinstance(value, int | float)
        else '"' + str(value).replace("\\", "\\\\").replace('"', '\\"') + '"'
    )


_GRACE = 5.0  # time for a command to remove its unfinished outputs [s]


def perform(words: list[str]) -> dict[str, Any]:
    """Run one command of the program and return its exit code and its JSON document."""
    from gyrotrack.apps.cli._app import run

    printed, began = io.StringIO(), perf_counter()
    with redirect_stdout(printed):
        code = run([words[0], "--json", "-q", *words[1:]])
    try:
        document = json.loads(printed.getvalue() or "{}")
    except ValueError:
        document = {
            "error": {"code": "bug", "message": "The command did not print a JSON document.", "hint": ""}
        }
    seconds = round(perf_counter() - began, 3)
    return {"code": code, "document": document, "version": __version__, "seconds": seconds}


def work() -> None:
    """Run the commands from stdin, one JSON array of arguments per line, and write one JSON answer per line."""
    from gyrotrack.apps.cli._app import catch_sigterm

    catch_sigterm()
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(
        os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno()
    )  # output of libraries must not be read as an answer
    tasks: queue.SimpleQueue[list[str]] = queue.SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            tasks.put(json.loads(line))
        if hasattr(signal, "pthread_kill"):  # the parent has ended: clean up and end
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
            time.sleep(_GRACE)
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    try:
        while True:
            answer = perform(tasks.get())
            if answer["code"] in {HUNG_UP, INTERRUPTED, TERMINATED}:
                return
            answers.write(json.dumps(answer) + "\n")
            answers.flush()
    except (KeyboardInterrupt, BrokenPipeError):
        return


if __name__ == "__main__":
    work()
