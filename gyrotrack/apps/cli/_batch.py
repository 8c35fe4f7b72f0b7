"""Commands for unattended work: batch, config."""

from __future__ import annotations

import inspect
from dataclasses import asdict
from enum import Enum, StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrotrack._errors import UsageError
from gyrotrack.apps.cli._lazy import function_of
from gyrotrack.apps.cli._options import Json, Quiet, Verbose
from gyrotrack.apps.cli._output import DONE, FAULT, NOT_TRUSTED, Output, command_line

if TYPE_CHECKING:
    from gyrotrack.apps.batch._experiments import Experiment
    from gyrotrack.apps.batch._runner import Ended
    from gyrotrack.apps.batch._steps import Outcome, Step


class Until(StrEnum):
    """The last step."""

    extract = "extract"
    sync = "sync"
    fit = "fit"
    diagnose = "diagnose"
    report = "report"


def batch_command(
    source: Annotated[
        Path, typer.Argument(metavar="MANIFEST|DIR", help="A manifest (TOML or CSV), or a folder of films.")
    ],
    *,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the results.")
    ] = Path("gyrotrack_batch"),
    workers: Annotated[
        int | None, typer.Option("--workers", metavar="N", min=1, help="Processes; one a core, if not given.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="ADDRESS", help="Run on the Dask cluster of this scheduler."),
    ] = None,
    until: Annotated[Until, typer.Option("--until", help="The last step.")] = Until.report,
    model: Annotated[str, typer.Option("--model", metavar="M", help="The model to fit.")] = "reduced",
    improve: Annotated[bool, typer.Option("--improve", help="Also add effects, as `improve` does.")] = False,
    casing_fps: Annotated[
        float | None,
        typer.Option("--casing-fps", metavar="N", help="Capture rate of the casing's films in a folder."),
    ] = None,
    rotor_fps: Annotated[
        float | None, typer.Option("--rotor-fps", metavar="N", help="Capture rate of the rotor's films.")
    ] = None,
    timeout: Annotated[
        float, typer.Option("--timeout", metavar="S", min=1.0, help="Seconds that one step may take.")
    ] = 7200.0,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be done, and do nothing.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:
    """Track, synchronise, fit, diagnose and report every case of a manifest or a folder.

    What was done before, with the same films and settings, is kept. A film that fails stops no other. In a
    folder, casing*.mp4 and rotor*.mp4 are a case, NAME_casing.mp4 and NAME_rotor*.mp4 the case NAME, and
    other films are only tracked.

    Example: gyrotrack batch films/ -o results --casing-fps 260 --rotor-fps 1000
    """
    from gyrotrack.apps.batch._experiments import read_folder, read_manifest
    from gyrotrack.apps.batch._runner import work_off
    from gyrotrack.apps.batch._steps import Wishes, plan

    out = Output(as_json=as_json, quiet=quiet, verbose=verbose)
    cases = (
        read_folder(source, casing_fps=casing_fps, rotor_fps=rotor_fps, skip=output)
        if source.is_dir()
        else read_manifest(source)
    )
    steps = plan(cases, output, Wishes(until.value, _extra(), model, improve))
    if dry_run:
        return _say_plan(out, cases, steps, output)

    called = command_line()
    ended = work_off(
        cases,
        steps,
        output,
        command=called,
        workers=workers,
        scheduler=scheduler,
        timeout=timeout,
        tell=partial(_say_step, out),
        bar=lambda: out.progress("working"),
    )
    return _say_end(out, ended, {"output": output, "command": called})


def _say_step(out: Output, step: Step, outcome: Outcome) -> None:
    if outcome.state == "failed":
        out.note(f"failed: {step.name}: {outcome.document.get('error', {}).get('message', '')}")
    elif outcome.state == "done":
        out.detail(f"{step.name}: {outcome.seconds:.1f} s")


def _say_end(out: Output, ended: Ended, facts: dict[str, Any]) -> int:
    from gyrotrack.apps.batch._runner import lines

    told = {"steps": ended.steps, "seconds": ended.seconds, "cases": [asdict(r) for r in ended.rows]}
    out.result({**facts, **told, "summary": ended.summary})
    counts = ", ".join(f"{n} {state}" for state, n in ended.steps.items() if n)
    total = sum(ended.steps.values())
    out.show("\n".join([*lines(ended.rows), "", f"{counts} of {total} steps, {ended.seconds:.0f} s"]))
    out.show(f"written: {', '.join(str(p) for p in ended.summary)}")
    if any(row.state != "done" for row in ended.rows):
        return FAULT
    return DONE if all(row.trusted for row in ended.rows) else NOT_TRUSTED


def _extra() -> dict[str, tuple[str, ...]]:
    """Return what a file of settings says for the commands of the steps, as words."""
    from gyrotrack.apps.batch._steps import VERBS
    from gyrotrack.apps.cli._app import COMMANDS, settings_in_use
    from gyrotrack.apps.cli._settings import as_words

    settings = settings_in_use()
    return {e.name: as_words(settings, e, _OWN) for e in COMMANDS if e.name in VERBS and settings.values}


_OWN = frozenset(
    {"output", "force", "json", "quiet", "verbose", "ledger", "from", "label", "surface", "model"}
    | {"overlay", "contact_sheet", "resume"}
)


def _say_plan(out: Output, cases: tuple[Experiment, ...], steps: tuple[Step, ...], output: Path) -> int:
    from gyrotrack.apps.batch._runner import foresee

    fate = foresee(steps, output)
    out.result({
        "cases": [{"label": e.label, "films": [str(c.file) for c in e.clips]} for e in cases],
        "steps": [{"name": s.name, "output": s.output, "state": fate[s.name]} for s in steps],
    })  # fmt: skip
    told = [f"{fate[s.name]:<7}{s.name}" for s in steps]
    kept = sum(state == "kept" for state in fate.values())
    out.show("\n".join([*told, "", f"{len(cases)} cases, {len(steps)} steps, {kept} kept; nothing was run"]))
    return DONE


def config_command(
    name: Annotated[
        str | None, typer.Argument(metavar="[COMMAND]", help="Only the options of this one.")
    ] = None,
    *,
    everything: Annotated[bool, typer.Option("--all", help="Also what has its default.")] = False,
    as_json: Json = False,
) -> None:
    """Show the settings that hold and where each is from: a file, or the default.

    A flag on the command line beats the file, the file beats the default. The file is the one given with
    --config, else $GYROTRACK_CONFIG, else gyrotrack.toml in this folder, else the user's.

    Example: gyrotrack config extract
    """
    from gyrotrack.apps.cli._app import COMMANDS, settings_in_use
    from gyrotrack.apps.cli._settings import options_of

    chosen = [e for e in COMMANDS if name in {None, e.name}]
    if not chosen:
        raise UsageError(f"There is no command '{str(name)[:40]}'.", "`gyrotrack --help` lists them.")
    settings = settings_in_use()
    rows: dict[str, dict[str, dict[str, Any]]] = {}
    for entry in chosen:
        defaults = inspect.signature(function_of(entry)).parameters
        held = settings.values.get(entry.name, {})
        for parameter, key in options_of(entry).items():
            if parameter in held:
                place = {"from": "file", "line": settings.lines[entry.name, parameter]}
                rows.setdefault(entry.name, {})[key] = {"value": held[parameter], **place}
            elif everything or name is not None:
                default = defaults[parameter].default
                plain = default.value if isinstance(default, Enum) else default
                shown = None if plain is inspect.Parameter.empty else plain
                rows.setdefault(entry.name, {})[key] = {"value": shown, "from": "default"}
    out = Output(as_json=as_json)
    out.result({"file": settings.path, "settings": rows})
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
