"""The settings of tracking: every number that decides, with its unit, meaning and origin.

A setting is a constant of a module. The text below it, its attribute docstring, describes it::

    STRAIGHT = 4.0
    \"\"\"Smallest curvature of a path that determines a hub, in standard uncertainties [1]. Chosen: a smaller value
    gives a hub with an unbounded uncertainty, a larger one refuses short arcs.\"\"\"

The meaning ends with the unit in brackets. The origin begins with one of four words: "derived", with the formula or
the reason; "measured", with the films; "source", with a publication or a standard; "chosen", a convention or a
trade-off, with what happens at other values. `tracking_settings` reads these texts; nothing is evaluated before.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby, pairwise
from types import MappingProxyType, ModuleType
from typing import Any, TypeAlias

import numpy as np

Value: TypeAlias = "float | tuple[Value, ...] | Mapping[str, float]"

PACKAGES = ("gyrotrack.tracking", "gyrotrack.video", "gyrotrack.synchronisation")
ORIGINS = ("derived", "measured", "source", "chosen")
_DESCRIPTION = re.compile(rf"(.+?) \[([^\]]+)\]\. ({'|'.join(map(str.capitalize, ORIGINS))}): (.+)\.")


@dataclass(frozen=True)
class Setting:
    """A number, or several, that a module decides by; `origin` begins with one of `ORIGINS`."""

    module: str
    name: str
    value: Value
    unit: str
    meaning: str
    origin: str

    @property
    def value_text(self) -> str:
        """The value as text, to six digits."""
        return _text(self.value)


@dataclass(frozen=True)
class TrackingSettings:
    """The settings of all modules, in the order of the modules and of their lines."""

    settings: tuple[Setting, ...]

    def __iter__(self) -> Iterator[Setting]:
        return iter(self.settings)

    def by_module(self) -> dict[str, tuple[Setting, ...]]:
        """Return the settings of each module."""
        return {module: tuple(own) for module, own in groupby(self.settings, lambda s: s.module)}

    def to_json(self) -> list[dict[str, Any]]:
        """Return the settings as lists, dicts, numbers and texts."""
        return [{**vars(s), "value": _plain(s.value)} for s in self.settings]

    def __str__(self) -> str:
        parts = []
        for module, own in self.by_module().items():
            lines = (f"  {s.name} = {s.value_text} [{s.unit}]\n    {s.meaning}\n    {s.origin}" for s in own)
            parts.append("\n".join([module, *lines]))
        return "\n\n".join(parts)


def tracking_settings() -> TrackingSettings:
    """Collect the settings of tracking, video and synchronisation; a LookupError names one without a description."""
    found: list[Setting] = []
    for package in map(importlib.import_module, PACKAGES):
        names = sorted(m.name for m in pkgutil.iter_modules(package.__path__, f"{package.__name__}."))
        for name in names:
            found += settings_of(importlib.import_module(name))
    return TrackingSettings(tuple(found))


def settings_of(module: ModuleType) -> list[Setting]:
    """Return the settings of one module."""
    found = []
    body: list[ast.stmt | None] = [*ast.parse(inspect.getsource(module)).body, None]
    for node, below in pairwise(body):
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for name in (
            n.id for target in targets if target for n in ast.walk(target) if isinstance(n, ast.Name)
        ):
            value = _number(getattr(module, name, None))
            if value is None:
                continue
            described = _DESCRIPTION.fullmatch(" ".join(_docstring(below).split()))
            if described is None:
                raise LookupError(f"{module.__name__}.{name} lacks its unit, meaning or origin.")
            meaning, unit, kind, reason = described.groups()
            found.append(Setting(module.__name__, name, value, unit, meaning, f"{kind.lower()}: {reason}"))
    return found


def _docstring(node: ast.stmt | None) -> str:
    text = node.value if isinstance(node, ast.Expr) else None
    return text.value if isinstance(text, ast.Constant) and isinstance(text.value, str) else ""


def _number(value: object) -> Value | None:
    """Return a number, or several as a tuple or a mapping that cannot change; None for anything else."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, int | float):
        return None if isinstance(value, bool) else value
    if isinstance(value, dict):
        own = {name: _number(v) for name, v in value.items() if isinstance(name, str)}
        numbers = {name: v for name, v in own.items() if isinstance(v, int | float)}
        return MappingProxyType(numbers) if numbers and len(numbers) == len(value) else None
    if isinstance(value, tuple | list | range):
        each = [_number(v) for v in value]
        known = tuple(v for v in each if v is not None)
        return known if known and len(known) == len(each) else None
    return None


def _plain(value: Value) -> object:
    if isinstance(value, Mapping):
        return dict(value)
    return [_plain(v) for v in value] if isinstance(value, tuple) else value


def _text(value: Value) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(number)}" for name, number in value.items())
    if isinstance(value, tuple):
        return f"({', '.join(map(_text, value))})"
    return str(value) if isinstance(value, int) else f"{value:.6g}"
