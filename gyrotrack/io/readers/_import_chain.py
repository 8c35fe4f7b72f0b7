"""Cases of several bodies with joints, from tables and files of points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from fitting._case_checks import defect_of_chain
from gyrotrack._errors import UsageError
from gyrotrack.io._bodies import refuse
from gyrotrack.io._records import Case, ChainBody, Inertia, no_series, series_of
from gyrotrack.io.readers._import_case import (
    in_order,
    modes_of,
    origins,
    pieces_of,
    read_together,
    sigma_source,
    window_warnings,
)
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._number_range import within_number_range
from gyrotrack.io.readers._run import Limits


@within_number_range
def import_chain(
    bodies: Mapping[str, Sequence[Path]],
    joints: Mapping[str, tuple[str, str]],
    inertias: Mapping[str, float | Inertia],
    *,
    label: str = "",
    surface: str = "",
    options: Mapping[str, ReadOptions] | None = None,
    limits: Limits | None = None,
) -> Case:
    """Make a case of several bodies on a chain of joints from tables of one experiment, all on one clock.

    Parameters
    ----------
    bodies : mapping of str to sequence of Path
        Tables of each body by its name, as for `import_case`. Only the first body may come to rest and reverse. A table
        may contain several bodies, if the headers of its columns contain their names.
    joints : mapping of str to (str, str)
        The two bodies of each joint. The torque of a joint drives its second body and brakes its first body.
    inertias : mapping of str to float or Inertia
        Moment of inertia of each body [kg m2].
    label, surface : str
        Name of the case, and the surface on which the first body turns.
    options : mapping of str to ReadOptions, optional
        Options for reading the files of each body; inputs are read from the first file of a body.
    limits : Limits, optional
        Times to include and to exclude.

    Returns
    -------
    Case
        With the first body as the casing, ``bodies`` "chain", and the other bodies in ``further``.

    Raises
    ------
    DatasetError, UsageError
        As for `import_case`; also if a joint names an unknown body, or a body has no joint or no moment of inertia.
    """
    moments = {name: i if isinstance(i, Inertia) else Inertia(i) for name, i in inertias.items()}
    known = {name: moments.get(name, Inertia(math.nan)) for name in bodies}
    refuse(f"Case '{label[:40]}'", defect_of_chain({n: (i.value, i.u) for n, i in known.items()}, joints))
    names = [name for name, paths in bodies.items() for _ in paths]
    paths = [path for several in bodies.values() for path in several]
    given = [replace((options or {}).get(n, ReadOptions()), body=n) for n in names]
    first = [names.index(n) == k for k, n in enumerate(names)]
    given = [o if is_first else replace(o, inputs=()) for o, is_first in zip(given, first, strict=True)]
    clean, notes = read_together(paths, given, limits or Limits())
    tables = {n: [t for (t, _), of in zip(clean, names, strict=True) if of == n] for n in bodies}
    read = [pieces_of(*values, notes) for values in clean]
    parts = {n: in_order([p for p, of in zip(read, names, strict=True) if of == n]) for n in bodies}
    notes += window_warnings(parts)
    sense = 1
    driven = any(i.unit != "K" for table, _ in clean for i in table.inputs)
    if not driven and all(sum(p.angle[-1] - p.angle[0] for p in pieces) < 0 for pieces in parts.values()):
        sense = -1
        notes.append("all bodies rotate in the negative sense: all signs were reversed (sense -1)")
    series = {n: series_of(pieces, sense, sigma_source(tables[n])) for n, pieces in parts.items()}
    series = {n: replace(s, modes=modes_of(tables[n], s)) for n, s in series.items()}
    main, *others = bodies
    return Case(
        I_rotor=math.nan,
        I_casing=known[main].value,
        I_casing_u=known[main].u,
        label=label,
        surface=surface,
        casing=replace(series[main], window=None),
        rotor=no_series(),
        quantity=clean[0][0].quantity,
        bodies="chain",
        body_name=main,
        warnings=tuple(notes),
        extra=origins([t for t, _ in clean], [p for pieces in parts.values() for p in pieces], sense),
        inputs=tuple(i for table, _ in clean for i in table.inputs),
        further=tuple(ChainBody(n, series[n], known[n].value, known[n].u) for n in others),
        joints=dict(joints),
    )


def read_bodies(given: Sequence[str]) -> dict[str, list[Path]]:
    """Parse arguments ``NAME=FILE`` into the files of each body; the name of a single body may be omitted.

    A name that is given several times has several files, one for each window.
    """
    found: dict[str, list[Path]] = {}
    for text in given:
        name, equals, file = text.partition("=")
        if not equals or Path(text).exists():
            name, file = "", text
        found.setdefault(name.strip(), []).append(Path(file.strip()))
    if len(given) > 1 and ("" in found or len(found) == 1):
        what = "With several --body options, give the name of each body, and the joints between them."
        raise UsageError(what, "Write --body wheel=wheel.csv --body drum=drum.csv --joint belt=drum,wheel.")
    return found


def read_joints(given: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Parse arguments ``NAME=FIRST,SECOND`` into the two bodies of each joint."""
    found = {}
    for text in given:
        name, _, pair = text.partition("=")
        bodies = [b.strip() for b in pair.split(",")]
        if len(bodies) != 2 or not all(bodies) or name.strip() in found:
            what = f"--joint {text[:60]!r} is not of the form NAME=FIRST,SECOND, or its name is given twice."
            raise UsageError(what, "Write --joint belt=motor,drum, once for each joint.")
        found[name.strip()] = (bodies[0], bodies[1])
    return found


def read_inertias(given: Sequence[str], bodies: Sequence[str]) -> dict[str, Inertia]:
    """Parse arguments ``NAME=I``, or ``I`` for a single body, into the moments of inertia of the bodies."""
    found = {}
    for text in given:
        name, equals, inertia = text.rpartition("=")
        name = name.strip() if equals or len(bodies) != 1 else bodies[0]
        if name not in bodies or name in found:
            what = f"--inertia {text[:60]!r} is not the moment of inertia of one of the bodies."
            example = bodies[0] or "wheel"
            raise UsageError(
                what, f"Write --inertia '{example}=5.5e-5 +- 0.1e-5' (kg m2), once for each body."
            )
        found[name] = Inertia.of(inertia, name or "body")
    return found
