"""Settings: every number on which a result depends, with its unit, meaning and origin.

A setting is a constant of a module. The text below it, its attribute docstring, describes it::

    FOLDS = 6
    \"\"\"Folds of the cross-validation [1]. Chosen: a smaller number leaves large gaps, a larger one costs time.\"\"\"

The meaning ends with the unit in brackets. The origin begins with one of four words: "derived", with the formula or the
reason; "measured", with the data; "source", with a publication or a standard; "chosen", a convention or a trade-off,
with the effect of other values. A dataclass in which all defaults of the fields are numbers, for example
`fitting.Criteria`, is a table of settings. Its fields are described in the same way. `settings_in` reads the texts.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import math
import pkgutil
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from itertools import groupby
from types import MappingProxyType, ModuleType
from typing import Any, TypeAlias

import numpy as np

Value: TypeAlias = "float | tuple[Value, ...] | Mapping[str, Value]"

ORIGINS = ("derived", "measured", "source", "chosen")
_SHOWN = 20
"""Largest number of values of a grid that is printed in full [1]. Chosen: a larger value fills the table, a smaller one
hides short lists. A longer grid is printed by its ends only, but the JSON contains all values."""
_DESCRIPTION = re.compile(rf"(.+?) \[([^\]]+)\]\. ({'|'.join(map(str.capitalize, ORIGINS))}): (.+)\.")


@dataclass(frozen=True)
class Setting:
    """One or several numbers on which the results of a module depend."""

    module: str  #: Module that uses the setting.
    name: str  #: Name in the module.
    value: Value  #: A number, an array, or an object by name; infinity is the text `inf` [`unit`].
    unit: str  #: Unit; `1` for a ratio or a count.
    meaning: str  #: Meaning.
    origin: str  #: One of `ORIGINS` (derived, measured, source, chosen), a colon, and an explanation.

    @property
    def value_text(self) -> str:
        """The value as text, to six digits; for a long grid, only its ends."""
        return _text(self.value)

    def __str__(self) -> str:
        return f"  {self.name} = {self.value_text} [{self.unit}]\n    {self.meaning}\n    {self.origin}"


@dataclass(frozen=True)
class Settings:
    """The settings of several modules, in the order of the modules and of their lines."""

    settings: tuple[Setting, ...]

    def __iter__(self) -> Iterator[Setting]:
        return iter(self.settings)

    def by_module(self) -> dict[str, tuple[Setting, ...]]:
        """Return the settings of each module."""
        return {module: tuple(own) for module, own in groupby(self.settings, lambda s: s.module)}

    def to_json(self) -> list[dict[str, Any]]:
        """Return the settings as lists, dicts, numbers and texts; infinity is "inf"."""
        return [{**vars(s), "value": _plain(s.value)} for s in self.settings]

    def __str__(self) -> str:
        return "\n\n".join("\n".join([module, *map(str, own)]) for module, own in self.by_module().items())


def fitting_settings() -> Settings:
    """Collect the settings of fits, noise estimates, searches and verdicts."""
    return settings_in("fitting")


def settings_in(*packages: str) -> Settings:
    """Collect the settings of all modules of packages; a LookupError names a setting without a description."""
    found: list[Setting] = []
    for package in map(importlib.import_module, packages):
        names = sorted(m.name for m in pkgutil.walk_packages(package.__path__, f"{package.__name__}."))
        for name in names:
            found += settings_of(importlib.import_module(name))
    return Settings(tuple(found))


def settings_of(module: ModuleType) -> list[Setting]:
    """Return the settings of one module."""
    body = ast.parse(inspect.getsource(module)).body
    found = _described(module, module, "", body)
    for node in body:
        if isinstance(node, ast.ClassDef) and _is_table(own := getattr(module, node.name)):
            found += _described(module, own, f"{node.name}.", node.body)
    return found


def _described(module: ModuleType, owner: object, prefix: str, body: list[ast.stmt]) -> list[Setting]:
    found = []
    for i, node in enumerate(body):
        text = ast.get_docstring(ast.Module(body[i + 1 : i + 2], [])) or ""
        targets = getattr(node, "targets", [getattr(node, "target", None)])
        for name in (n.id for t in targets if t for n in ast.walk(t) if isinstance(n, ast.Name)):
            if (value := _number(getattr(owner, name, None))) is None:
                continue
            described = _DESCRIPTION.fullmatch(" ".join(text.split()))
            if described is None:
                raise LookupError(f"{module.__name__}.{prefix}{name} lacks its unit, meaning or origin.")
            meaning, unit, kind, reason = described.groups()
            origin = f"{kind.lower()}: {reason}"
            found.append(Setting(module.__name__, prefix + name, value, unit, meaning, origin))
    return found


def _is_table(kind: object) -> bool:
    return is_dataclass(kind) and all(_number(f.default) is not None for f in fields(kind))


def _number(value: object) -> Value | None:
    """Return a number, or several numbers as an immutable tuple or mapping; None for any other value."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, int | float):
        return None if isinstance(value, bool) else value
    if isinstance(value, Mapping):
        own = {name: _number(v) for name, v in value.items() if isinstance(name, str)}
        numbers = {name: n for name, n in own.items() if n is not None}
        return MappingProxyType(numbers) if numbers and len(numbers) == len(value) else None
    if isinstance(value, tuple | list | range):
        known = tuple(n for v in value if (n := _number(v)) is not None)
        return known if known and len(known) == len(value) else None
    return None


def _plain(value: Value) -> object:
    if isinstance(value, Mapping):
        return {name: _plain(v) for name, v in value.items()}
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    return value if math.isfinite(value) else str(value)


def _text(value: Value) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(number)}" for name, number in value.items())
    if isinstance(value, tuple):
        shown = [*map(_text, value)]
        return f"({', '.join(shown if len(shown) <= _SHOWN else [*shown[:2], '...', shown[-1]])})"
    return str(value) if isinstance(value, int) else f"{value:.6g}"
