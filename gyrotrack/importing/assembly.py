"""From tables of angles or speeds to a case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gyrotrack.dataset.records import Case
from gyrotrack.errors import DatasetError, UsageError
from gyrotrack.importing.header import Names
from gyrotrack.importing.pieces import SMOOTHING, Piece, no_series, pieces_of, series_of
from gyrotrack.importing.points import Wanted
from gyrotrack.importing.table import Table, read_table

I_ROTOR = 5.54e-5
I_CASING = 2.06e-5


def import_case(
    casing: Path,
    rotors: Sequence[Path],
    *,
    label: str = "",
    surface: str = "",
    I_rotor: float = I_ROTOR,
    I_casing: float = I_CASING,
    names: Names | None = None,
    wanted: Sequence[Wanted] = (),
) -> Case:
    """Read tables of one experiment, all on one clock, and make a case of them.

    Parameters
    ----------
    casing : Path
        Table of the casing: time and angle, or time and angular velocity, with or without sigma.
    rotors : sequence of Path
        Tables of the rotor; a table with gaps longer than 20 sample intervals becomes several windows.
    label, surface : str
        Name of the case, and what the casing turned on.
    I_rotor, I_casing : float
        Moments of inertia [kg m2]; the paper's by default.
    names : mapping, optional
        What the columns of the tables mean, as `header.read_names` makes it.
    wanted : sequence of Wanted, optional
        How points become an angle: of the casing, then of each rotor table.

    Returns
    -------
    Case
        With angles growing in the sense in which the bodies turn; where a table had no sigma it is estimated
        from the scatter, and where it had speeds they are kept as they are and the angle is their integral.

    Raises
    ------
    DatasetError
        A table is not sound, or the tables do not hold the same quantity.
    UsageError
        A moment of inertia is not positive, or there is no rotor table.
    """
    if not (I_rotor > 0 and I_casing > 0):
        raise UsageError("A moment of inertia must be positive.", "Give it in kg m2, such as 5.54e-5.")
    if not rotors:
        raise UsageError("There is no table of the rotor.", "Give one with --rotor.")
    paths = (casing, *rotors)
    tables = [read_table(p, names, w) for p, w in zip(paths, wanted or [Wanted()] * len(paths), strict=True)]
    quantity = _common_quantity(tables)
    notes = [note for table in tables for note in table.notes]
    body, *wheels = (pieces_of(table, notes) for table in tables)
    windows = sorted((piece for wheel in wheels for piece in wheel), key=lambda piece: piece.time[0])
    notes += _misplaced(body, windows)
    sense, doubts = _sense(body, windows)
    return Case(
        I_rotor=I_rotor,
        I_casing=I_casing,
        label=label,
        surface=surface,
        casing=replace(series_of(body, sense), window=None, sigma_source=_sigma_source(tables[:1])),
        rotor=replace(series_of(windows, sense), sigma_source=_sigma_source(tables[1:])),
        quantity=quantity,
        warnings=tuple(notes + doubts),
        extra=_origins(tables, sense),
    )


def import_body(
    table: Path,
    inertia: float,
    *,
    label: str = "",
    surface: str = "",
    names: Names | None = None,
    wanted: Wanted | None = None,
) -> Case:
    """Make a case of one body that spins down by itself: a wheel, or a bearing on a rig.

    Parameters
    ----------
    table : Path
        Its angles or speeds, as for `import_case`.
    inertia : float
        Its moment of inertia [kg m2].

    Returns
    -------
    Case
        With the body in the casing's place, `bodies` "one" and an empty rotor.

    Raises
    ------
    DatasetError, UsageError
        As for `import_case`.
    """
    if not inertia > 0:
        raise UsageError("A moment of inertia must be positive.", "Give it in kg m2, such as 5.54e-5.")
    read = read_table(table, names, wanted)
    notes = list(read.notes)
    parts = pieces_of(read, notes)
    sense = 1 if sum(p.angle[-1] - p.angle[0] for p in parts) >= 0 else -1
    if sense < 0:
        notes.append("the body turns in the negative sense: all signs were reversed (sense -1)")
    body = replace(series_of(parts, sense), window=None, sigma_source=_sigma_source([read]))
    return Case(
        I_rotor=inertia,
        I_casing=inertia,
        label=label,
        surface=surface,
        casing=body,
        rotor=no_series(),
        quantity=read.quantity,
        bodies="one",
        warnings=tuple(notes),
        extra=_origins([read], sense),
    )


def _common_quantity(tables: list[Table]) -> str:
    for table in tables[1:]:
        if table.quantity != tables[0].quantity:
            raise DatasetError(
                f"{table.path} holds {table.quantity}, but {tables[0].path} holds {tables[0].quantity}.",
                "Give angles in all tables, or angular velocities in all.",
            )
    return tables[0].quantity


def _origins(tables: list[Table], sense: int) -> dict[str, Any]:
    """Return what the case file keeps of the tables."""
    return {
        "sources": [{"file": str(t.path), "sha256": t.sha256, "samples": len(t.time)} for t in tables],
        "sense": sense,
        "smoothing_width": SMOOTHING if tables[0].quantity == "angle" else 1,
    }


def _sigma_source(tables: list[Table]) -> str:
    origins = {"given" if table.sigma is not None else "estimated" for table in tables}
    return origins.pop() if len(origins) == 1 else "mixed"


def _misplaced(body: list[Piece], windows: list[Piece]) -> list[str]:
    """Say which rotor windows overlap each other or lie outside the casing's record."""
    found = []
    start, stop = body[0].time[0], body[-1].time[-1]
    for k, window in enumerate(windows):
        if window.time[0] < start or window.time[-1] > stop:
            span = f"{window.time[0]:.3f} to {window.time[-1]:.3f} s"
            found.append(f"rotor window {k} ({span}) reaches beyond the casing's record")
        if k and window.time[0] <= windows[k - 1].time[-1]:
            found.append(f"rotor windows {k - 1} and {k} overlap in time: are all times on one clock?")
    return found


def _sense(body: list[Piece], windows: list[Piece]) -> tuple[int, list[str]]:
    """Return the factor that makes the angles grow, and what is strange about the senses of rotation."""
    turned = [[piece.angle[-1] - piece.angle[0] for piece in group] for group in (body, windows)]
    casing, rotor = (int(np.sign(sum(angles))) for angles in turned)
    doubts = []
    if len({np.sign(angle) for angle in turned[1]}) > 1:
        doubts.append("the rotor windows turn in different senses")
    if casing * rotor < 0:
        doubts.append("the casing turns against the rotor: check the signs of the tables")
        return 1, doubts
    if rotor < 0:
        return -1, [*doubts, "both bodies turn in the negative sense: all signs were reversed (sense -1)"]
    return 1, doubts
