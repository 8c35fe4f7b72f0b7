"""`gyrotrack config`: which settings hold, and where each is from."""

from __future__ import annotations

import inspect
from enum import Enum
from importlib import import_module
from typing import Annotated, Any

import typer

from gyrotrack.cli.options import Json
from gyrotrack.cli.output import Output
from gyrotrack.errors import UsageError


def command(
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
    from gyrotrack.cli.app import COMMANDS, settings_in_use
    from gyrotrack.cli.settings import options_of

    chosen = [e for e in COMMANDS if name in {None, e.name}]
    if not chosen:
        raise UsageError(f"There is no command '{str(name)[:40]}'.", "`gyrotrack --help` lists them.")
    settings = settings_in_use()
    rows: dict[str, dict[str, dict[str, Any]]] = {}
    for entry in chosen:
        defaults = inspect.signature(import_module(entry.module).command).parameters
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
