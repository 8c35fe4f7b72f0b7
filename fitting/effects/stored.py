"""Effects as plain fields, for files: a fit is kept with the laws that no library of a later version need have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

from fitting.effects.effect import Effect, Parameter, State
from fitting.effects.library import LIBRARY
from fitting.plain import number

_NUMBERS = ("lower", "upper", "start")


def own_effects(effects: Iterable[Effect]) -> list[dict[str, Any]]:
    """Return the fields of those effects that are not, or not so, in the library."""
    return [asdict(e) for e in effects if LIBRARY.get(e.name) != e]


def effects_of(names: Iterable[str], own: Iterable[Mapping[str, Any]]) -> tuple[Effect, ...]:
    """Return effects by name: those of the fields given, all others from the library."""
    known = {str(e["name"]): effect_of(e) for e in own}
    return tuple(known[n] if n in known else LIBRARY[n] for n in names)


def effect_of(stored: Mapping[str, Any]) -> Effect:
    """Return an effect from its fields."""
    fields = dict(stored)
    fields["parameters"] = tuple(_parameter(p) for p in fields["parameters"])
    fields["confused_with"] = tuple(fields.get("confused_with", ()))
    state = fields.get("state")
    fields["state"] = State(**state) if state else None
    return Effect(**fields)


def _parameter(stored: Mapping[str, Any]) -> Parameter:
    values: dict[str, Any] = {
        k: tuple(v) if k == "grid" else number(v) if k in _NUMBERS else v for k, v in stored.items()
    }
    return Parameter(**values)
