"""The state of a tracker as plain numbers, so that a later process can go on exactly where it stopped.

An object is rebuilt from the film and the profile in the same way every time; its memento holds what has changed
in it since. Only numbers, arrays, and a few frozen records are taken and put back, each by the path of attributes
that leads to it (``bodies.casing._motion``); nothing in a memento is ever run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.following import Motion
from gyrotrack.segmentation.ring import Ring

_RECORDS = {kind.__name__: kind for kind in (Motion, Ring)}
BUFFERS = frozenset({
    "windows", "starts", "held", "steps", "again", "_grid", "_score", "_under", "_coarse", "_pixels"
})  # fmt: skip
"""Attributes that hold the batch at hand, which means nothing between batches, or follow from others."""


@dataclass(frozen=True)
class Memento:
    """Values by path, as JSON holds them, and arrays by path."""

    values: dict[str, Any]
    arrays: dict[str, npt.NDArray[Any]]

    def since(self, start: Memento) -> Memento:
        """Return only what differs from an earlier memento."""
        same = {k for k, a in self.arrays.items() if k in start.arrays and _equal(a, start.arrays[k])}
        values = {k: v for k, v in self.values.items() if k not in start.values or start.values[k] != v}
        return Memento(values, {k: a for k, a in self.arrays.items() if k not in same})


def take(thing: Any) -> Memento:
    """Take the memento of an object and of all that belongs to it.

    Raises
    ------
    TypeError
        An attribute is of a kind that cannot be put back.
    """
    memento = Memento({}, {})
    for path, _, _, value in _leaves(thing):
        if isinstance(value, np.ndarray):
            memento.arrays[path] = value.copy()
        else:
            memento.values[path] = _as_json(path, value)
    return memento


def put_back(thing: Any, memento: Memento) -> None:
    """Give an object, new from the same film and profile, the state that a memento holds.

    Raises
    ------
    TypeError
        The memento holds something that the object has no place for.
    """
    left = {*memento.arrays, *memento.values}
    for path, owner, name, _ in list(_leaves(thing)):
        if path in memento.arrays:
            _set(owner, name, memento.arrays[path].copy())
        elif path in memento.values:
            _set(owner, name, _from_json(memento.values[path]))
        left.discard(path)
    if left:
        raise TypeError(f"there is no place for {min(left)}")


def _leaves(thing: Any) -> Iterator[tuple[str, Any, Any, Any]]:
    """Yield (path, owner, name, value) of all numbers, arrays and records below an object, each once."""
    seen: set[int] = set()
    waiting = [("", thing)]
    while waiting:
        path, owner = waiting.pop()
        if id(owner) in seen:
            continue
        seen.add(id(owner))
        for name, value in _members(owner):
            below = f"{path}.{name}" if path else str(name)
            if _is_leaf(value):
                yield below, owner, name, value
            else:
                waiting.append((below, value))


def _members(owner: Any) -> list[tuple[Any, Any]]:
    if isinstance(owner, Mapping):
        return list(owner.items())
    if isinstance(owner, list | tuple):
        return list(enumerate(owner))
    if is_dataclass(owner):
        return []  # all of these are frozen: made once, never changed
    return [(name, value) for name, value in vars(owner).items() if not _passing(owner, name)]


def _passing(owner: Any, name: str) -> bool:
    return name in BUFFERS or isinstance(getattr(type(owner), name, None), cached_property)


def _is_leaf(value: Any) -> bool:
    if value is None or isinstance(value, bool | int | float | str | np.ndarray | np.generic):
        return True
    if isinstance(value, tuple):
        return all(_is_leaf(v) and not isinstance(v, np.ndarray) for v in value)
    return type(value).__name__ in _RECORDS


def _as_json(path: str, value: Any) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple):
        return {"tuple": [_as_json(path, v) for v in value]}
    kind = type(value).__name__
    if kind in _RECORDS:
        return {"record": kind, "fields": [_as_json(path, getattr(value, f.name)) for f in fields(value)]}
    raise TypeError(f"{path} is a {kind}, which no memento can hold")


def _from_json(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    if "tuple" in value:
        return tuple(_from_json(v) for v in value["tuple"])
    return _RECORDS[value["record"]](*(_from_json(v) for v in value["fields"]))


def _set(owner: Any, name: Any, value: Any) -> None:
    if isinstance(owner, dict | list):
        owner[name] = value
    elif not isinstance(owner, tuple):
        setattr(owner, name, value)


def _equal(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> bool:
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()
