"""Undo and redo of the start page, for changes of the stored state (field by field) and of recordings.

A change of the state is stored as a list of changed fields. Undoing the change therefore keeps later changes of other
fields, for example by the end of a running step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import RLock
from typing import Any, NamedTuple

from gyrotrack._errors import UsageError

_LISTS = ("sources", "removed")
_MOST = 200  # largest number of changes that can be undone


class Change(NamedTuple):
    """One changed field: list and key of a source (both "" for a field of the state), name, old value, new value.

    Without a name, the source itself was added to, or removed from, the list. The values are then the content of the
    source, or None.
    """

    list: str
    key: str
    name: str
    values: tuple[Any, Any]
    place: int = 0  # position of the source in its list


def difference(before: dict[str, Any], after: dict[str, Any]) -> list[Change]:
    """Return the changes between two states, one per changed field."""
    found = [
        Change("", "", name, (before.get(name), after[name]))
        for name in after
        if name not in _LISTS and before.get(name) != after[name]
    ]
    for group in _LISTS:
        old, new = ({x["key"]: (n, x) for n, x in enumerate(s.get(group, []))} for s in (before, after))
        for key in {**old, **new}:
            if key in old and key in new:
                (_, a), (_, b) = old[key], new[key]
                found += [Change(group, key, n, (a.get(n), b[n])) for n in b if a.get(n) != b[n]]
            else:
                place, _ = old[key] if key in old else new[key]
                values = tuple(s[key][1] if key in s else None for s in (old, new))
                found.append(Change(group, key, "", (values[0], values[1]), place))
    return found


def apply(content: dict[str, Any], changes: Sequence[Change], side: int) -> None:
    """Set the fields of a state to their values before (`side` 0) or after (1) the changes."""
    for c in changes:
        if not c.list:
            content[c.name] = c.values[side]
            continue
        rows = content[c.list]
        at = next((n for n, x in enumerate(rows) if x["key"] == c.key), None)
        if c.name:
            if at is not None:
                rows[at][c.name] = c.values[side]
        elif c.values[side] is None:
            if at is not None:
                del rows[at]
        elif at is None:
            rows.insert(c.place, c.values[side])


class History:
    """Changes with a name, each of which can be undone and redone."""

    def __init__(self) -> None:
        self._done: list[tuple[str, Callable[[], None], Callable[[], None]]] = []
        self._undone: list[tuple[str, Callable[[], None], Callable[[], None]]] = []
        self._busy = False

    @property
    def undo_label(self) -> str:
        """Name of the change that `undo` will undo; empty without a change."""
        return self._done[-1][0] if self._done else ""

    @property
    def redo_label(self) -> str:
        """Name of the change that `redo` will redo; empty without a change."""
        return self._undone[-1][0] if self._undone else ""

    def add(self, label: str, undo: Callable[[], None], redo: Callable[[], None]) -> None:
        """Store a completed change; changes that were undone before can no longer be redone."""
        if self._busy:
            return
        self._done = [*self._done, (label, undo, redo)][-_MOST:]
        self._undone.clear()

    def undo(self, lock: RLock) -> None:
        """Undo the last change."""
        with lock:
            if not self._done:
                raise UsageError("There is nothing to undo.", "No changes were made, or all were undone.")
            self._move(self._done, self._undone, 1)

    def redo(self, lock: RLock) -> None:
        """Redo the change that was undone last."""
        with lock:
            if not self._undone:
                raise UsageError("There is nothing to redo.", "Undo a change first.")
            self._move(self._undone, self._done, 2)

    def _move(self, source: list[Any], target: list[Any], which: int) -> None:
        self._busy = True
        try:
            source[-1][which]()
        finally:
            self._busy = False
        target.append(source.pop())
