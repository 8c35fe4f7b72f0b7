"""The column names of a table that pandas wrote, read without running what they are wrapped in.

pandas stores them as a pickle, which is a program. Here its instructions are only looked at: those that make
lists and tuples of words are followed, any other ends the reading.
"""

from __future__ import annotations

import pickletools
from typing import Any

from gyrotrack.errors import DatasetError

_MARK = object()
_MOST = 10_000


def listed_names(stored: bytes) -> list[tuple[str, ...]]:
    """Return a stored list of tuples of words.

    Raises
    ------
    DatasetError
        It is anything else.
    """
    try:
        found = _followed(bytes(stored))
    except (ValueError, IndexError, KeyError, TypeError, UnicodeError) as error:
        raise DatasetError("The names of the columns cannot be read.", "Export the points as CSV.") from error
    if not isinstance(found, list) or not all(
        isinstance(t, tuple) and t and all(isinstance(w, str) for w in t) for t in found
    ):
        raise DatasetError("The names of the columns are not a list of names.", "Export the points as CSV.")
    return found


def _followed(stored: bytes) -> Any:
    stack: list[Any] = []
    memo: dict[int, Any] = {}
    argument: Any
    for count, (code, argument, _) in enumerate(pickletools.genops(stored)):
        if count > _MOST:
            raise ValueError("too long")
        name = code.name
        if name in {"PROTO", "FRAME"}:
            continue
        if name == "STOP":
            return stack.pop()
        if name == "MARK":
            stack.append(_MARK)
        elif name in {"UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "STRING", "BINSTRING", "SHORT_BINSTRING"}:
            stack.append(str(argument))
        elif name == "EMPTY_LIST":
            stack.append([])
        elif name in {"LIST", "TUPLE", "APPENDS"}:
            _gather(stack, name)
        elif name in {"TUPLE1", "TUPLE2", "TUPLE3"}:
            size = int(name[-1])
            stack[-size:] = [tuple(stack[-size:])]
        elif name == "APPEND":
            item = stack.pop()
            stack[-1].append(item)
        elif name in {"PUT", "BINPUT", "LONG_BINPUT"}:
            memo[int(argument)] = stack[-1]
        elif name == "MEMOIZE":
            memo[len(memo)] = stack[-1]
        elif name in {"GET", "BINGET", "LONG_BINGET"}:
            stack.append(memo[int(argument)])
        else:
            raise ValueError(name)
    raise ValueError("no end")


def _gather(stack: list[Any], name: str) -> None:
    place = max((i for i, item in enumerate(stack) if item is _MARK), default=-1)
    if place < 0:
        raise ValueError(name)
    items = stack[place + 1 :]
    del stack[place:]
    if name == "APPENDS":
        stack[-1].extend(items)
    else:
        stack.append(items if name == "LIST" else tuple(items))
