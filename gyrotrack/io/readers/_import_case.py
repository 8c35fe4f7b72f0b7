"""Cases from tables and files of points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack._smoothing import median_smooth
from gyrotrack.io._contents import SeriesSummary, WindowSummary, describe_motion, describe_windows
from gyrotrack.io._records import (
    Case,
    ErrorMode,
    Floats,
    Inertia,
    Piece,
    Series,
    from_angles,
    from_speeds,
    no_series,
    series_of,
    speed_warnings,
)
from gyrotrack.io.readers._motion_table import (
    MotionTable,
    ReadOptions,
    is_wrapped,
    pieces,
    resolution,
    scatter,
)
from gyrotrack.io.readers._number_range import within_number_range
from gyrotrack.io.readers._outliers import without_outliers
from gyrotrack.io.readers._plausibility import wraps_at_no_turn
from gyrotrack.io.readers._raw_table import TURN
from gyrotrack.io.readers._registry import read_motion
from gyrotrack.io.readers._run import Limits, limited, reverses, run_of

_SMOOTHING = 31
_MIN_SAMPLES = 3  # smallest number of samples of a piece between two gaps; shorter pieces are excluded


def unwrap(time: Floats, angle: Floats) -> tuple[Floats, list[float]]:
    """Unwrap angles, and return the times of gaps in which the number of turns is uncertain.

    The speed is the running median of the wrapped differences of neighbouring samples, which must differ by less than
    half a turn. The integral of the speed predicts every sample, also across gaps; the number of whole turns minimises
    the difference from the prediction. A gap of length T is uncertain if the change of the speed across the gap can
    cause an error of the prediction of 1 rad: |change| T / 8 > 1.
    """
    step = np.diff(time)
    turned = np.angle(np.exp(1j * np.diff(angle)))
    near = step < 1.5 * np.median(step)
    middle = (time[1:] + time[:-1])[near] / 2
    speed = np.interp(time, middle, median_smooth(turned[near] / step[near], _SMOOTHING))
    increment = (speed[1:] + speed[:-1]) / 2 * step
    prediction = np.concatenate([[0.0], np.cumsum(increment)])
    unwrapped = np.unwrap(angle - prediction) + prediction
    uncertain = np.abs(np.diff(speed)) * step / 8 > 1
    return unwrapped, [float(t) for t in time[:-1][uncertain]]


# smallest jump of the angle, as a multiple of the neighbouring changes and of the usual change
_JUMP = 20.0
# a change does not continue the motion if it exceeds both of these limits: a multiple of other changes, and a multiple
# of the noise
_CLEAR_JUMP, _UNSTEADY = 3.0, 40.0
# smallest change of a wrapped angle whose sense is in doubt [rad], and largest share of such changes in either sense
_HALF_TURN, _MOST_HALF_TURNS = 0.8 * np.pi, 0.01
_MOST_SLIPPED = 3.5  # largest slip [turns]; a step of more turns is an overflow
_SLIP = 0.05  # largest deviation from a whole number of turns with which a step counts as a slip [turns]
# times above this limit [s] (three years) count as seconds since 1970, not since the start of a record
_DATES = 1e8


def unwrapped(table: MotionTable, notes: list[str]) -> Floats:
    """Return the values of a table, with unwrapped angles; `notes` reports uncertain gaps, jumps are an error."""
    if table.quantity != "angle" or table.counted:
        return table.value
    if not is_wrapped(table.value):
        _refuse_jumps(table)
        return table.value
    _refuse_half_turns(table)
    value, uncertain = unwrap(table.time, table.value)
    notes += [
        f"{table.path.name}: the number of turns is uncertain in the gap after {t:.3f} s" for t in uncertain
    ]
    return value


def _refuse_half_turns(table: MotionTable) -> None:
    """Refuse a wrapped angle that changes by about half a turn between samples, in an unknown sense."""
    interval = np.diff(table.time)
    turned = np.angle(np.exp(1j * np.diff(table.value)))[interval < 1.5 * np.median(interval)]
    share = min(float((sign * turned > _HALF_TURN).mean()) for sign in (1, -1))
    if share > _MOST_HALF_TURNS:
        raise DatasetError(
            f"{table.path}: the body turns by about half a turn between two samples; the number of turns is unknown.",
            "Give a recording with more samples per turn, or the part in which the body is slower.",
        )


def _refuse_jumps(table: MotionTable) -> None:
    """Refuse an angle that changes between two samples by far more than its neighbouring and its usual changes.

    A jump is at least `_JUMP` times as large as other changes. A smaller change is also a jump under two conditions: it
    is clearly larger than other changes, and its deviation from the continued motion exceeds the noise.
    """
    if wraps_at_no_turn(table.value):
        raise DatasetError(
            f"{table.path}: the angle jumps repeatedly by its whole range of {np.ptp(table.value):.5g} rad, which "
            "is not a whole turn.",
            "State the unit of the angle; counts of an encoder are read with --pulses-per-turn N, which continues a "
            "counter that overflows.",
        )
    interval, step = np.diff(table.time), np.diff(table.value)
    step[interval > 1.5 * np.median(interval)] = 0.0
    padded = np.pad(step, 2, mode="reflect")
    around = np.stack([padded[k : len(step) + k] for k in (0, 1, 3, 4)])
    off = np.abs(step - np.median(around, axis=0))
    noise = max(1.4826 * float(np.median(off)), resolution(table.value))
    step = np.abs(step)
    usual = max(float(np.quantile(step, 0.99)), resolution(table.value))
    beside = np.maximum(np.append(step[1:], 0.0), np.insert(step[:-1], 0, 0.0))
    # a deviation of whole turns from the motion is a slip, which the fit finds and corrects
    turns = off / TURN
    slipped = (np.rint(turns) > 0) & (turns < _MOST_SLIPPED) & (np.abs(turns - np.rint(turns)) < _SLIP)
    far = step > _JUMP * np.maximum(beside, usual)
    far |= (step > _CLEAR_JUMP * np.maximum(beside, usual)) & (off > _UNSTEADY * noise)
    jumps = np.flatnonzero(far & ~slipped)
    if len(jumps) and usual:
        first = jumps[0]
        raise DatasetError(
            f"{table.path}, line {table.line[first + 1]}: the angle jumps by "
            f"{table.value[first + 1] - table.value[first]:.5g} rad at {table.time[first + 1]:.6g} s, too far for a "
            f"motion ({len(jumps)} such jump{'s' * (len(jumps) > 1)}).",
            "Counts of an encoder are read with --pulses-per-turn N, which continues a counter that overflows; else "
            "use a part of the record with --from and --to.",
        )


def pieces_of(table: MotionTable, value: Floats, notes: list[str]) -> list[Piece]:
    """Split a table at its gaps; compute angles, speeds and uncertainties of each piece, and add to `notes`.

    A missing sigma is estimated from the scatter; it is at least the quantisation step of the file / sqrt(12).
    """
    cuts = [slice(0, len(table.time))] if table.counted else pieces(table.time)
    short = [cut for cut in cuts if cut.stop - cut.start < _MIN_SAMPLES]
    if short and len(short) < len(cuts):
        lost = sum(cut.stop - cut.start for cut in short)
        notes.append(f"{table.path.name}: {lost} isolated samples between gaps were excluded")
        cuts = [cut for cut in cuts if cut not in short]
    if len(cuts) > 1:
        gaps = [table.time[b.start] - table.time[a.stop - 1] for a, b in pairwise(cuts)]
        notes.append(
            f"{table.path.name}: {len(gaps)} gaps; the longest, {max(gaps):.3g} s, is after "
            f"{table.time[cuts[int(np.argmax(gaps))].stop - 1]:.6g} s"
        )
    sigma = table.sigma
    if sigma is None:
        sigma = np.full(len(value), np.nan)
        for cut in cuts:
            sigma[cut] = np.maximum(scatter(table.time[cut], value[cut]), table.least_sigma)
        median = float(np.nanmedian(sigma))
        notes.append(f"{table.path.name}: sigma was estimated from the scatter, median {median:.2g}")
        if table.least_sigma > 0.5 * median:
            notes.append(
                f"{table.path.name}: the values are quantised; sigma is at least step / sqrt(12) = "
                f"{table.least_sigma:.2g}"
            )
    if table.quantity == "angle":
        made = [from_angles(table.time[cut], value[cut], sigma[cut]) for cut in cuts]
    else:
        made = _continued([from_speeds(table.time[cut], value[cut], sigma[cut]) for cut in cuts])
    for piece in made:
        if not np.isfinite(piece.omega).any():
            start = f"{table.path.name}: the piece at {piece.time[0]:.3f} s"
            notes.append(f"{start} is too short for a smoothed speed ({len(piece.time)} samples)")
    return made


def _continued(parts: list[Piece]) -> list[Piece]:
    """Return pieces of measured speeds with angles that continue through the gaps, at the mean of the adjacent speeds.

    The uncertainty of the angle after a gap follows from a uniform distribution of the speed between the two adjacent
    speeds.
    """
    made = parts[:1]
    for piece in parts[1:]:
        last, gap = made[-1], piece.time[0] - made[-1].time[-1]
        start = last.angle[-1] + gap * (last.omega[-1] + piece.omega[0]) / 2
        u = np.hypot(last.sigma[-1], gap * (piece.omega[0] - last.omega[-1]) / np.sqrt(12))
        made.append(replace(piece, angle=piece.angle + start, sigma=np.hypot(piece.sigma, u)))
    return made


class ImportedSeries(SeriesSummary):
    """The motion of the casing, the single body, or the first body of a chain."""

    quantity: str  #: Measured quantity: `angle` or `omega`.


class ImportedWindows(TypedDict):
    """The windows of the rotor, or of a further body."""

    windows: list[WindowSummary]  #: The windows.
    quantity: str  #: Measured quantity: `angle` or `omega`.
    sigma_source: str  #: Origin of the standard uncertainty.


class ImportSummary(TypedDict):
    """Contents of an imported case."""

    label: str  #: Name of the case.
    casing: ImportedSeries  #: The casing, the single body, or the first body of a chain.
    rotor: ImportedWindows  #: The rotor; without windows if there is no rotor.
    further: dict[str, ImportedWindows]  #: Further bodies of a chain, by name.
    sense: int  #: Factor applied to the angles so that the motion is positive: 1 or -1.
    warnings: list[str]  #: Repairs and doubts.


def summary(case: Case) -> ImportSummary:
    """Return a summary of an imported case: samples, times and sigmas of the casing and of each window."""
    key = "omega_sigma" if case.quantity == "omega" else "sigma"

    def windows(series: Series) -> ImportedWindows:
        found = describe_windows(series, key)
        return {"windows": found, "quantity": case.quantity, "sigma_source": series.sigma_source}

    return {
        "label": case.label,
        "casing": {
            **describe_motion(case.casing, key=key),
            "quantity": case.quantity,
            "sigma_source": case.casing.sigma_source,
        },
        "rotor": windows(case.rotor),
        "further": {b.name: windows(b.series) for b in case.further},
        "sense": case.extra["sense"],
        "warnings": list(case.warnings),
    }


@within_number_range
def import_case(
    casing: Path,
    rotors: Sequence[Path],
    *,
    I_rotor: float,
    I_casing: float,
    label: str = "",
    surface: str = "",
    options: Sequence[ReadOptions] = (),
    limits: Limits | None = None,
) -> Case:
    """Make a case from tables of one experiment, all on one clock.

    Parameters
    ----------
    casing : Path
        Table of the casing: time and angle, or time and angular velocity, with or without sigma.
    rotors : sequence of Path
        Tables of the rotor; a table with gaps longer than 20 sample intervals becomes several windows.
    label, surface : str
        Name of the case, and the surface on which the casing turned.
    I_rotor, I_casing : float
        Moments of inertia [kg m2].
    options : sequence of ReadOptions, optional
        Options for reading the file of the casing, then the options for the files of the rotor.
    limits : Limits, optional
        Times to include and to exclude.

    Returns
    -------
    Case
        The case, with angles that increase in the sense of rotation. A missing sigma is estimated from the scatter;
        speeds are kept as measured, and the angle is their integral.

    Raises
    ------
    DatasetError
        A table is not valid, or the tables do not contain the same quantity.
    UsageError
        A moment of inertia is not positive, or there is no rotor table.
    """
    if not (I_rotor > 0 and I_casing > 0):
        raise UsageError("A moment of inertia must be positive.", "Give it in kg m2, for example 5.54e-5.")
    if not rotors:
        raise UsageError("There is no table of the rotor.", "Give a table with --rotor.")
    paths = (casing, *rotors)
    given = [
        replace(o, body=o.body or ("rotor" if k else "casing"))
        for k, o in enumerate(options or [ReadOptions()] * len(paths))
    ]
    clean, notes = read_together(paths, given, limits or Limits())
    tables = [table for table, _ in clean]
    body, *rotor = (pieces_of(*values, notes) for values in clean)
    windows = in_order(rotor)
    notes += window_warnings({"casing": body, "rotor": windows})
    sense, warnings = _sense(body, windows)
    of_casing, of_rotor = series_of(body, sense), series_of(windows, sense)
    warnings += speed_warnings(
        of_casing, of_rotor, "exchange the files of `gyrotrack import --casing FILE --rotor FILE`"
    )
    return Case(
        I_rotor=I_rotor,
        I_casing=I_casing,
        label=label,
        surface=surface,
        casing=replace(of_casing, window=None, sigma_source=sigma_source(tables[:1]), modes=tables[0].modes),
        rotor=replace(
            of_rotor,
            sigma_source=sigma_source(tables[1:]),
            modes=modes_of(tables[1:], of_rotor),
        ),
        quantity=tables[0].quantity,
        warnings=tuple(notes + warnings),
        extra=origins(tables, [*body, *windows], sense),
        inputs=tuple(i for table in tables for i in table.inputs),
    )


@within_number_range
def import_body(
    table: Path,
    inertia: float | Inertia | None = None,
    *,
    label: str = "",
    surface: str = "",
    options: ReadOptions | None = None,
    limits: Limits | None = None,
) -> Case:
    """Make a case of one body: a wheel, a bearing on a rig, a pendulum.

    Parameters
    ----------
    table : Path
        Angles or speeds of the body, as for `import_case`.
    inertia : float or Inertia, optional
        Moment of inertia [kg m2]; without it torques are per unit of inertia.
    label, surface : str
        Name of the case, and the surface on which the body turns.
    options : ReadOptions, optional
        Options for reading the file.
    limits : Limits, optional
        Times to include and to exclude; without `keep_all`, drive, brake and rest are also excluded.

    Returns
    -------
    Case
        With the body as the casing, ``bodies`` "one" and an empty rotor.

    Raises
    ------
    DatasetError, UsageError
        As for `import_case`.
    """
    return case_of_body(read_motion(table, options), inertia, label=label, surface=surface, limits=limits)[0]


def case_of_body(
    table: MotionTable,
    inertia: float | Inertia | None = None,
    *,
    label: str = "",
    surface: str = "",
    limits: Limits | None = None,
) -> tuple[Case, MotionTable]:
    """Return the case of one body from its table, and the part of the table that is used; see `import_body`."""
    moment = inertia if isinstance(inertia, Inertia) else Inertia(1.0 if inertia is None else inertia)
    if not moment.value > 0:
        raise UsageError("A moment of inertia must be positive.", "Give it in kg m2, for example 5.54e-5.")
    limits = limits or Limits()
    driven = any(i.unit != "K" for i in table.inputs)
    if driven:
        # an input describes drive and brake, so nothing is excluded; a temperature is not such an input
        limits = replace(limits, keep_all=True)
    read = limited(_from_origin([table])[0], limits)
    notes: list[str] = []
    clean = without_outliers(read, unwrapped(read, notes), notes, keep_all=limits.keep_all)
    read, value = run_of(*clean, limits)
    notes = [*read.notes, *notes]
    parts = pieces_of(read, value, notes)
    sense = 1
    # with an input no sign is reversed, because the signs of input and motion are related
    if not driven and not reverses(read, value) and sum(p.angle[-1] - p.angle[0] for p in parts) < 0:
        sense = -1
        notes.append("the body rotates in the negative sense: all signs were reversed (sense -1)")
    body = replace(series_of(parts, sense), window=None, sigma_source=sigma_source([read]), modes=read.modes)
    case = Case(
        I_rotor=moment.value,
        I_casing=moment.value,
        I_casing_u=moment.u,
        per_inertia=int(inertia is None),
        label=label,
        surface=surface,
        casing=body,
        rotor=no_series(),
        quantity=read.quantity,
        bodies="one",
        warnings=tuple(notes),
        extra=origins([read], parts, sense),
        inputs=read.inputs,
    )
    return case, read


def read_together(
    paths: Sequence[Path], options: Sequence[ReadOptions], limits: Limits
) -> tuple[list[tuple[MotionTable, Floats]], list[str]]:
    """Return tables on one clock with their unwrapped values, without outliers, and notes about the changes."""
    tables = _from_origin([read_motion(p, o) for p, o in zip(paths, options, strict=True)])
    tables = [limited(table, limits) for table in tables]
    _refuse_different_quantities(tables)
    notes = [note for table in tables for note in table.notes]
    return [
        without_outliers(table, unwrapped(table, notes), notes, keep_all=limits.keep_all) for table in tables
    ], notes


def in_order(parts: Sequence[list[Piece]]) -> list[Piece]:
    """Return the pieces of several tables in the order of time."""
    return sorted((piece for pieces in parts for piece in pieces), key=lambda piece: piece.time[0])


def modes_of(tables: list[MotionTable], series: Series) -> tuple[ErrorMode, ...]:
    """Return the error modes of tables as modes of their common series; a mode is zero in the rows of other tables."""
    found = []
    for k, table in enumerate(tables):
        own = np.searchsorted(table.time, series.time).clip(max=len(table.time) - 1)
        inside = table.time[own] == series.time
        for mode in table.modes:
            basis = np.where(inside[:, None], mode.basis[own], 0.0)
            found.append(replace(mode, name=f"{mode.name} {k + 1}" if k else mode.name, basis=basis))
    return tuple(found)


def _from_origin(tables: list[MotionTable]) -> list[MotionTable]:
    """Return tables with dates (seconds since 1970) converted to times from the first second of the earliest table."""
    first = min(float(table.time[0]) for table in tables)
    if first < _DATES:
        return tables
    origin = float(np.floor(first))
    date = datetime.fromtimestamp(origin, UTC).strftime("%Y-%m-%d %H:%M:%S")
    note = f"times are counted from {date} ({origin:.0f} s)"
    return [
        replace(
            table,
            time=table.time - origin,
            inputs=tuple(replace(i, time=i.time - origin) for i in table.inputs),
            notes=(*table.notes, f"{table.path.name}: {note}"),
        )
        for table in tables
    ]


def _refuse_different_quantities(tables: list[MotionTable]) -> None:
    for table in tables[1:]:
        if table.quantity != tables[0].quantity:
            raise DatasetError(
                f"{table.path} contains {table.quantity}, but {tables[0].path} contains {tables[0].quantity}.",
                "Give either angles or angular velocities in all tables.",
            )


def origins(tables: list[MotionTable], parts: Sequence[Piece], sense: int) -> dict[str, Any]:
    """Return the provenance for the case file."""
    return {
        "sources": [{"file": str(t.path), "sha256": t.sha256, "samples": len(t.time)} for t in tables],
        "reading": [t.reading.document() for t in tables if t.reading is not None],
        "doubts": [doubt for t in tables for doubt in t.doubts],
        "sense": sense,
        "smoothing_width": min(part.smoothing_width for part in parts),
    }


def sigma_source(tables: list[MotionTable]) -> str:
    origins = {"given" if table.sigma is not None else "estimated" for table in tables}
    return origins.pop() if len(origins) == 1 else "mixed"


def window_warnings(bodies: Mapping[str, list[Piece]]) -> list[str]:
    """Return warnings for windows that overlap or are not within the record of the first body."""
    found = []
    (main, record), *others = bodies.items()
    start, stop = record[0].time[0], record[-1].time[-1]
    for name, windows in others:
        for k, window in enumerate(windows):
            if window.time[0] < start or window.time[-1] > stop:
                span = f"{window.time[0]:.3f} to {window.time[-1]:.3f} s"
                found.append(f"{name} window {k} ({span}) is not within the record of the {main}")
            if k and window.time[0] <= windows[k - 1].time[-1]:
                found.append(
                    f"{name} windows {k - 1} and {k} overlap in time; check that all times are on one clock"
                )
    return found


def _sense(body: list[Piece], windows: list[Piece]) -> tuple[int, list[str]]:
    """Return the sign that makes the angles increase, and warnings about the senses of rotation."""
    turned = [[piece.angle[-1] - piece.angle[0] for piece in group] for group in (body, windows)]
    casing, rotor = (int(np.sign(sum(angles))) for angles in turned)
    warnings = []
    if len({np.sign(angle) for angle in turned[1]}) > 1:
        warnings.append("the rotor windows have different senses of rotation")
    if casing * rotor < 0:
        warnings.append("casing and rotor have opposite senses of rotation: check the signs in the tables")
        return 1, warnings
    if rotor < 0:
        return -1, [*warnings, "both bodies rotate in the negative sense: all signs were reversed (sense -1)"]
    return 1, warnings
