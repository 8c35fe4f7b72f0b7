"""A group of commands that are imported when one of them runs.

`gyrotrack --help` needs only the names and one line each, and imports no numerical library.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command


@dataclass(frozen=True)
class Entry:
    """One command: its name, the module here whose `<name>_command` runs it, its section in the help, and one line."""

    name: str
    module: str
    section: str
    help: str


def function_of(entry: Entry) -> Callable[..., Any]:
    """Import the module of a command and return its function `<name>_command`."""
    return getattr(import_module(f"gyrotrack.apps.cli.{entry.module}"), f"{entry.name}_command")  # type: ignore[no-any-return]


def load(entry: Entry) -> Any:
    """Build a command from the signature of its function."""
    single = typer.Typer(add_completion=False, rich_markup_mode=None)
    single.command(name=entry.name)(function_of(entry))
    return get_command(single)


def lazy_group(entries: tuple[Entry, ...]) -> type[TyperGroup]:
    """Return a class of group that knows `entries` by name and loads them when they are asked to run."""
    table = {entry.name: entry for entry in entries}

    class LazyGroup(TyperGroup):
        """The commands of one table."""

        def list_commands(self, ctx: Any) -> list[str]:
            """Return the names in the order of the table."""
            del ctx
            return list(table)

        def get_command(self, ctx: Any, cmd_name: str) -> Any:
            """Return a placeholder with name and help line, without an import."""
            del ctx
            entry = table.get(cmd_name)
            return entry and TyperCommand(name=entry.name, help=entry.help, rich_markup_mode=None)

        def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:
            """Return the command that is to run, imported."""
            self.commands = {name: self.get_command(ctx, name) for name in table}  # for "did you mean"
            name, _, rest = super().resolve_command(ctx, args)
            return name, load(table[name]) if name in table else None, rest

        def format_commands(self, ctx: Any, formatter: Any) -> None:
            """List the commands section by section."""
            del ctx
            for section in dict.fromkeys(entry.section for entry in entries):
                with formatter.section(section):
                    formatter.write_dl([(e.name, e.help) for e in entries if e.section == section])

    return LazyGroup
