"""The line of a TOML file on which a key stands."""

from __future__ import annotations

import re

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(
    r"""^\s*((?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*'))*)\s*="""
)


def line_of(text: str, location: tuple[int | str, ...]) -> int | None:
    """Return the line (from 1) of the key at `location`, or of the nearest table around it that has one.

    Parameters
    ----------
    text : str
        Valid TOML.
    location : tuple of int or str
        Keys, and places in arrays of tables, as ``("clip", 1, "file")``.

    Notes
    -----
    A scan by line, not a parser: keys of inline tables are found as the line of the table, and a line within a
    multi-line string may be taken for a key; the fault itself is named by its path in any case.
    """
    places: dict[tuple[int | str, ...], int] = {}
    counts: dict[tuple[str, ...], int] = {}
    table: tuple[int | str, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if (head := _HEADER.match(line)) is not None:
            names = _parts(head[2])
            if head[1] == "[[":
                counts[names] = counts.get(names, -1) + 1
                # a new element begins with arrays of its own
                for inner in [n for n in counts if n[: len(names)] == names and n != names]:
                    del counts[inner]
            table = _within(names, counts)
            places.setdefault(table, number)
        elif (key := _KEY.match(line)) is not None:
            places.setdefault((*table, *_parts(key[1])), number)
    # an array as a value has one line for all its places
    known = [location[:n] for n in range(len(location), 0, -1)]
    return next((places[k] for k in known if k in places), None)


def _within(names: tuple[str, ...], counts: dict[tuple[str, ...], int]) -> tuple[int | str, ...]:
    made: list[int | str] = []
    for depth, name in enumerate(names, start=1):
        made.append(name)
        if names[:depth] in counts:
            made.append(counts[names[:depth]])
    return tuple(made)


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip().strip("\"'") for part in re.findall(r"\"[^\"]*\"|'[^']*'|[^.]+", dotted))
