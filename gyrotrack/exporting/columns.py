"""Recordings and cases as one flat table: a row a sample, a unit a column."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.layout import BODY, FRAME, MARKER, SERIES, Table
from gyrotrack.dataset.records import STATUS, Case, Recording
from gyrotrack.errors import UsageError

_WORDS = np.array(list(STATUS), dtype=object)


@dataclass(frozen=True)
class Column:
    """One column: its name, its unit ("" for words), and a value for each row."""

    name: str
    unit: str
    values: npt.NDArray[Any]

    @property
    def heading(self) -> str:
        """The name with its unit in brackets, as `import` reads it."""
        return (
            f"{self.name} [{_READABLE.get(self.unit, self.unit)}]"
            if self.unit not in {"", "1"}
            else self.name
        )


_READABLE = {"rad s-1": "rad/s"}


def columns(content: Recording | Case, table: str = "motion") -> tuple[Column, ...]:
    """Return a recording or a case as columns of equal length.

    Parameters
    ----------
    content : Recording or Case
        What to hand on.
    table : {"motion", "markers", "frames"}
        The angles and speeds of the bodies; every marker in every frame; the frames of each clip. The rows of
        several bodies, markers or clips follow one another and are told apart by the first columns.

    Returns
    -------
    tuple of Column
        Times in s, angles in rad, speeds in rad s-1, lengths in px; NaN where nothing is known.

    Raises
    ------
    UsageError
        There is no such table, or nothing in it.
    """
    if table not in TABLES:
        raise UsageError(f"There is no table '{table}'.", f"There are: {', '.join(TABLES)}.")
    parts = TABLES[table](content)
    if not parts:
        raise UsageError(f"There are no {table} in this file.", "Recordings of films hold them.")
    return tuple(
        Column(c.name, c.unit, np.concatenate([part[i].values for part in parts]))
        for i, c in enumerate(parts[0])
    )


def to_dataframe(content: Recording | Case, table: str = "motion") -> Any:
    """Return `columns` as a pandas DataFrame; the units stand in its ``attrs["units"]``.

    Raises
    ------
    UsageError
        As for `columns`, or pandas is not installed.

    Examples
    --------
    >>> from gyrotrack.dataset import read_case
    >>> frame = to_dataframe(read_case("case1.h5"))  # doctest: +SKIP
    >>> frame.groupby("body")["omega"].max()  # doctest: +SKIP
    """
    try:
        import pandas as pd
    except ImportError:
        raise UsageError(
            "A DataFrame needs pandas, which is not installed.",
            'Install it: pip install "gyrotrack[notebook]"',
        ) from None
    made = columns(content, table)
    frame = pd.DataFrame({c.name: c.values for c in made})
    frame.attrs["units"] = {c.name: c.unit for c in made if c.unit}
    return frame


def _motion(content: Recording | Case) -> list[list[Column]]:
    if isinstance(content, Recording):
        return [
            [_word("body", name, len(body.time)), *_of(BODY, vars(body))]
            for name, body in content.bodies.items()
        ]
    parts = []
    for name, series in (("casing", content.casing), ("rotor", content.rotor)):
        rows = len(series.time)
        window = series.window if series.window is not None else np.zeros(rows, dtype=np.int64)
        parts.append([_word("body", name, rows), Column("window", "1", window), *_of(SERIES, vars(series))])
    return [part for part in parts if len(part[0].values)]


def _markers(content: Recording | Case) -> list[list[Column]]:
    return [
        [
            _word("clip", clip, len(recording.time)),
            _word("marker", name, len(recording.time)),
            _word("body", marker.body, len(recording.time)),
            *_of(MARKER, {**vars(marker), "frame": recording.frame_index}),
        ]
        for clip, recording in _clips(content).items()
        for name, marker in recording.markers.items()
    ]


def _frames(content: Recording | Case) -> list[list[Column]]:
    return [
        [
            _word("clip", clip, len(r.time)),
            *_of(FRAME, {**vars(r), "frame": r.frame_index, "index": r.frame_index}),
        ]
        for clip, r in _clips(content).items()
    ]


TABLES: dict[str, Callable[[Recording | Case], list[list[Column]]]] = {
    "motion": _motion,
    "markers": _markers,
    "frames": _frames,
}


def _clips(content: Recording | Case) -> dict[str, Recording]:
    return {content.source: content} if isinstance(content, Recording) else content.recordings


def _word(name: str, word: str, rows: int) -> Column:
    return Column(name, "", np.full(rows, word, dtype=object))


def _of(table: Table, values: Mapping[str, Any]) -> list[Column]:
    """Return the fields of a layout's table, those with more than one number a sample spread out."""
    made = []
    for f in table.fields:
        value = np.asarray(values[f.name])
        if f.name == "status":
            made.append(Column(f.name, "", _WORDS[value]))
        elif value.ndim == 1:
            made.append(Column(f.name, f.units, value))
        else:
            for place in np.ndindex(value.shape[1:]):
                *side, axis = place
                name = "_".join([f.name, *(str(s) for s in side), "xy"[axis]])
                made.append(Column(name, f.units, value[(slice(None), *place)]))
    return made
