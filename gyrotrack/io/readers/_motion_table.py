"""Samples of one motion from the columns of a table.

Times are sorted, repeated times averaged, and rows without a value excluded; every repair is reported with its line. A
clock that restarts, or a cell that is not a number, is an error with its line. A record is split at its gaps; where it
contains no uncertainty, that of its samples is estimated from their scatter.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io._records import Floats, Integers
from gyrotrack.io.readers._raw_table import ROLES, UNITS, RawTable, clean, factor, header_of, role_of

MIN_SAMPLES = 8
_GAP = 20.0
_BLOCK = 15
_ORDER = 3
_NEIGHBOURS = 41
_FLOOR = 1e-6
_MEDIAN_OF_CHI2 = 11 * (1 - 2 / (9 * 11)) ** 3 / 11  # median of chi2 / dof for dof = _BLOCK - _ORDER - 1 = 11
_SPIKE = 20.0  # smallest change to and from an erroneous sample [largest usual change between neighbours]
# share, and number, of the changes between neighbours that are not usual; the greater applies
_RARE = (0.01, 4.0)
_TICKS = 2**32  # ticks after which the clock of a microcontroller restarts (Arduino `micros` and `millis`)

# symbols of quantities, which imply SI units
_SYMBOLS = {"t", "omega", "w", "ω", "angle", "psi", "phi", "theta", "ψ", "φ", "θ"}
# unit that is assumed for a quantity, and an example of another one
_ASSUMED = {"t": ("s", "ms"), "angle": ("rad", "deg"), "omega": ("rad/s", "rpm")}

# quantity and unit ("" if it is in the header) by column (header or number, case-folded)
Names = Mapping[str, tuple[str, str]]


@dataclass(frozen=True)
class ReadOptions:
    """Options for reading a file."""

    # columns by header or number, from `read_names`; if empty, the headers determine them
    names: Names | None = None
    # names of points; the centre may also be coordinates, "12.5,40", or "orbit", the centre of a circle fitted to
    # the path of the marker
    marker: str | None = None
    centre: str | None = None
    fps: float | None = None  # frame rate [1/s], for a file with frame numbers
    start: float = 0.0  # time of the first frame [s], added to all times
    likelihood: float = 0.6  # minimum likelihood of the points that are used
    pulses_per_turn: float | None = None  # pulses per turn, for a file with times of pulses
    body: str = ""  # "casing" or "rotor", to choose between columns whose names contain these words


@dataclass(frozen=True)
class MotionTable:
    """The samples of one file: finite, sorted by time, in SI units."""

    path: Path
    sha256: str
    quantity: str  # quantity of `value`: "angle" [rad] or "omega" [rad s-1]
    # shape (n,); times [s] and values
    time: Floats
    value: Floats
    sigma: Floats | None  # shape (n,); standard uncertainty of the values, if the file contains it
    line: Integers  # shape (n,); line of each sample in the file
    notes: tuple[str, ...]  # repairs and choices made while reading
    least_sigma: float = 0.0  # lower bound of an estimated uncertainty, from the resolution of the file
    # whether the samples are pulses: angles are unwrapped and gaps do not interrupt them
    counted: bool = False
    doubts: tuple[str, ...] = ()  # why the values may be wrong by more than their uncertainty

    def only(self, keep: npt.NDArray[np.bool_], *notes: str) -> MotionTable:
        """Return the selected samples, with further notes."""
        return replace(
            self,
            time=self.time[keep],
            value=self.value[keep],
            sigma=None if self.sigma is None else self.sigma[keep],
            line=self.line[keep],
            notes=(*self.notes, *notes),
        )


def only_one(path: Path, names: Sequence[str], what: str, options: ReadOptions) -> str:
    """Return the only name of a list, or the one that contains the option `marker`."""
    named = [n for n in names if options.marker and options.marker.casefold() in n.casefold()]
    chosen = named if len(named) == 1 else names
    if len(chosen) != 1:
        which = f": {', '.join(names)[:100]}" if names else ""
        hint = f"Choose one with --marker, for example --marker '{names[0]}'." if names else "Give a table."
        raise DatasetError(f"{path} contains {len(names)} {what}{which}.", hint)
    return chosen[0]


COORDINATES = ("x", "y")
_TURNS = {"rev", "revs", "turn", "turns", "revolution", "revolutions", "cycles"}
_DAY = 86400.0
_STEADY = 100.0  # ratio of squared mean and variance of a speed from which on it is constant


def read_names(given: Iterable[str], body: str = "casing") -> Names:
    """Parse options such as ``t=Zeit``, ``angle=phi [deg]``, ``x=2``, ``t=1 [us]``, ``casing.x=2`` for one body."""
    names: dict[str, tuple[str, str]] = {}
    for option in given:
        role_name, equals, column = (part.strip() for part in option.partition("="))
        prefix, dot, quantity = role_name.partition(".")
        role_name = quantity if dot and prefix in {"casing", "rotor"} else role_name
        if not equals or role_name not in (*ROLES, *COORDINATES) or not column:
            raise UsageError(
                f"{option[:60]!r}: unknown column.",
                f"Write for example t=Zeit; quantities: {', '.join((*ROLES, *COORDINATES))}.",
            )
        if role_name == quantity and prefix != body:
            continue
        names[column.casefold()] = (role_name, "")
        base, unit = header_of(column) if column.endswith(("]", ")")) else (column, "")
        if unit:
            names.setdefault(base.casefold(), (role_name, clean(unit)))
    return names


_SHOWN = 8
EXPECTED = "Use the header `t,angle`, `t,angle,sigma`, `t,omega` or `t,omega,sigma`, or give the columns with --column."


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(f"'{name[:30]}'" for name in names[:_SHOWN])
    return f"{shown} and {len(names) - _SHOWN} more" if len(names) > _SHOWN else shown


def find_columns(raw: RawTable, options: ReadOptions) -> tuple[dict[str, int], dict[str, str], list[str]]:
    """Return column and unit of each quantity, and the names of unused columns; two of one meaning are an error."""
    found: dict[str, list[int]] = {}
    units: dict[int, str] = {}
    for index, name in enumerate(raw.names):
        base, unit = header_of(name)
        below = clean(raw.units[index])
        named_by_unit = clean(base).casefold() == unit
        if below and unit and not named_by_unit and clean(unit).casefold() != below.casefold():
            what = f"{raw.header_place}: the unit of '{name}' is '{below}' in the next line."
            raise DatasetError(what, "Correct one of them.")
        units[index] = below or clean(unit)
        role = role_of(base) if name and not options.names else None
        if options.names:
            for text in (name.casefold(), base.casefold(), str(index + 1)):
                if text and text in options.names:
                    role, given = options.names[text]
                    units[index] = given or units[index]
                    break
        elif role in {None, "angle", "omega"} and units[index]:
            role = next(
                (r for r in ("angle", "omega") if units[index].casefold() in UNITS[r]),
                None if role is None else role,
            )
            if role == "omega" and factor("omega", units[index]) is None:
                role = None
        if role in {None, "revolutions"} and units[index].casefold() in UNITS["t"] and base == name:
            role = "t"
        if role in {"angle", "revolutions"} and clean(base).casefold() in _TURNS:
            # a column `turns` is a counter if its numbers are whole
            values = raw.numeric(index)
            whole = values is not None and bool((values == np.round(values))[np.isfinite(values)].all())
            role, units[index] = ("revolutions", "") if whole else ("angle", "turns")
        if role in {"angle", "omega"} and units[index].casefold() in {
            "km/h",
            "m/s",
            "mph",
            "v",
            "m",
            "px",
            "state",
        }:
            role = None
        if role is not None:
            found.setdefault(role, []).append(index)
    chosen: dict[str, int] = {}
    for role, places in found.items():
        chosen[role] = places[0] if len(places) == 1 else _one_of(raw, role, places, options)
    if (
        options.names
        and "t" not in chosen
        and not raw.headed
        and 0 not in chosen.values()
        and not options.fps
    ):
        chosen["t"] = 0
    if options.names and "t" not in chosen:
        chosen |= {
            role: i for i, name in reversed(list(enumerate(raw.names)))
            for role in (role_of(header_of(name)[0]),) if role in {"t", "frame"} and i not in chosen.values()
        }  # fmt: skip
    unused = [n or str(i + 1) for i, n in enumerate(raw.names) if i not in chosen.values()]
    return chosen, {role: units[i] for role, i in chosen.items()}, unused


def _one_of(raw: RawTable, role: str, places: list[int], options: ReadOptions) -> int:
    """Choose between several columns of the same quantity."""
    names = [raw.names[i] for i in places]
    exact = [i for i in places if header_of(raw.names[i])[0].casefold() in {"t", "time", "zeit"}]
    if role == "t":
        return (exact or places)[0]
    plain = [i for i in places if header_of(raw.names[i])[0].casefold() == "sigma"]
    if role == "sigma" and len(plain) == 1:
        return plain[0]
    if options.body:
        of_body = [i for i in places if options.body in raw.names[i].casefold()]
        if len(of_body) == 1:
            return of_body[0]
    # beside the axes of a sensor, its magnitude contains no sense of rotation
    axes = [
        i for i in places if not set(_words(raw.names[i])) & {"absolute", "abs", "magnitude", "norm", "total"}
    ]
    stems = {_stem_without_axis(raw.names[i]) for i in axes}
    if axes and len(stems) == 1:
        values = [without_spikes(raw.numbers(i), "", []) for i in axes]
        return axes[int(np.argmax([float(np.nanmean(np.square(v))) for v in values]))]
    what = f"{raw.header_place}: {len(places)} columns for '{role}': {', '.join(map(repr, names))[:120]}."
    raise DatasetError(what, f"Choose one, for example --column '{role}={names[0]}'.")


def _words(name: str) -> list[str]:
    return name.casefold().replace("_", " ").split()


def _stem_without_axis(name: str) -> str:
    words = [w for w in _words(name) if w not in {"x", "y", "z"}]
    # gx, gyroY, wz: the last letter is the axis
    return " ".join(w[:-1] if len(words) == 1 and w[-1:] in {"x", "y", "z"} else w for w in words)


def _along_rotation(values: Floats) -> tuple[Floats, Floats]:
    """Return angular velocities (n, axes) along the direction in which they vary most, and this direction.

    An axis of rotation that is inclined to the axes of a sensor by an angle a gives each of them a part cos a of the
    speed. A constant error of an axis does not turn the direction of the variation; a constant speed has none, and its
    direction is that of the mean.
    """
    known = values[np.isfinite(values).all(axis=1)]
    mean = known.mean(axis=0)
    size, directions = np.linalg.eigh(np.atleast_2d(np.cov(known.T)))
    direction = directions[:, -1] if float(mean @ mean) < _STEADY * size[-1] else mean / np.linalg.norm(mean)
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    return values @ direction, direction


def times_of(
    raw: RawTable, columns: Mapping[str, int], units: Mapping[str, str], options: ReadOptions
) -> Floats:
    """Return the times of a table [s]: the time column, or frame numbers, or those of the rows, divided by the rate."""
    if "t" in columns:
        time = raw.numbers(columns["t"], "t", times=True)
        return time * scale_of(raw, "t", units["t"]) + options.start
    if "frame" in columns:
        return raw.numbers(columns["frame"], "frame") / frame_rate(raw.path, options) + options.start
    where = raw.header_place
    if options.fps:
        return np.arange(len(raw.line)) / frame_rate(raw.path, options) + options.start
    if not raw.headed and not options.names:
        raise DatasetError(
            f"{where}: the {len(raw.names)} columns have no header.",
            "Give them by number: --column t=1 --column angle=2; or give --pulses-per-turn.",
        )
    raise DatasetError(f"{where}: there is no column for the time.", EXPECTED)


def _unit_since_1970(raw: RawTable, column: int) -> str:
    """Return the unit of times since 1970, by their size (dates from 1973 to 5138); "" for seconds or other times."""
    values = raw.numeric(column)
    known = np.zeros(0) if values is None else values[np.isfinite(values)]
    size = float(np.median(np.abs(known))) if len(known) else 0.0
    return next((unit for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11)) if size >= least), "")


def frame_rate(path: Path, options: ReadOptions) -> float:
    """Return the frame rate given by the user; a UsageError says that it is not given or not positive."""
    if not (options.fps and options.fps > 0):
        what = f"{path} contains frame numbers but not the capture rate."
        raise UsageError(what, "Give the rate with --casing-fps or --rotor-fps.")
    return options.fps


def scale_of(raw: RawTable, role: str, unit: str) -> float:
    """Return the factor of a column to SI units; a DatasetError names an unknown unit."""
    if not unit:
        return 1.0
    scale = factor(role, unit)
    if scale is None:
        what = f"{raw.header_place}: unknown unit '{unit[:30]}'."
        raise DatasetError(what, f"Use one of {', '.join(UNITS[role])}.")
    return scale


def interpret(raw: RawTable, options: ReadOptions) -> MotionTable:
    """Return the angle or the angular velocity in a table; a DatasetError names column and line of what is wrong."""
    columns, units, unused = find_columns(raw, options)
    quantity = "angle" if "angle" in columns else "omega"
    if quantity not in columns and ("t" in columns or "frame" in columns or options.fps):
        raise DatasetError(
            f"{raw.header_place}: there is no column for the angle or omega among {_listed(raw.names)}.",
            EXPECTED + " Times of events and signals of a light gate need --pulses-per-turn.",
        )
    notes = list(raw.notes)
    if "t" in columns and not units["t"] and (unit := _unit_since_1970(raw, columns["t"])):
        units["t"] = unit
        notes.append(f"{raw.path.name}: the times are assumed to be counted in {unit} since 1970")
    notes += _assumed_units(raw, columns, units, options)
    time = times_of(raw, columns, units, options)
    value = without_spikes(raw.numbers(columns[quantity], quantity), quantity, notes, raw.line)
    unit = units[quantity]
    if quantity == "angle" and not unit and _wraps_at_360(value):
        unit = "deg"
        notes.append(f"{raw.path.name}: the angles wrap at 360 and are assumed to be in degrees")
    scale = scale_of(raw, quantity, unit)
    sigma = None
    if "sigma" in columns:
        sigma_unit = units["sigma"]
        sigma = raw.numbers(columns["sigma"], "sigma", infinite=True) * (
            scale_of(raw, quantity, sigma_unit) if sigma_unit else scale
        )
    if quantity == "angle" and "omega" in columns:
        unused.append(raw.names[columns["omega"]] or "omega")
    title = raw.names[columns[quantity]]
    axes = [i for i, n in enumerate(raw.names) if _stem_without_axis(n) == _stem_without_axis(title)]
    parts = [raw.numeric(i) for i in axes]
    if (
        len(axes) in {2, 3}
        and not options.names
        and quantity == "omega"
        and all(p is not None for p in parts)
    ):
        others = [[] if i == columns[quantity] else notes for i in axes]
        cleared = [
            without_spikes(p, raw.names[i], o)
            for p, i, o in zip(parts, axes, others, strict=True)
            if p is not None
        ]
        value, direction = _along_rotation(np.stack(cleared, axis=1))
        text = ", ".join(f"{c:.3f}" for c in direction)
        unused = [name for name in unused if name not in {raw.names[i] for i in axes}]
        notes.append(
            f"{raw.path.name}: the speed is that along the direction ({text}) of the {len(axes)} axes of "
            f"'{_stem_without_axis(title)}', in which it varies most; the scale factor of the sensor is not determined"
        )
    if unused:
        notes.append(f"{raw.path.name}: ignored the column(s) {', '.join(map(repr, unused))[:120]}")
    least_sigma = resolution(value) * scale / float(np.sqrt(12))
    return checked(raw, quantity, time, value * scale, sigma, notes, least_sigma=least_sigma)


def _assumed_units(
    raw: RawTable, columns: Mapping[str, int], units: Mapping[str, str], options: ReadOptions
) -> list[str]:
    """Return notes on columns whose unit is not stated and not implied by the symbol of the quantity."""
    quantity = "angle" if "angle" in columns else "omega"
    notes = []
    for role in () if options.names else (quantity, "t"):
        values = raw.numeric(columns[role]) if role in columns and not units[role] else None
        name = raw.names[columns[role]] if values is not None else ""
        if values is None or not name or set(re.split(r"[\s_.,\-:]+", name.casefold())) & _SYMBOLS:
            continue
        if role == "t" and (values % 1 != 0).any():
            continue  # hardly milliseconds
        if role == "angle" and _wraps_at_360(values):
            continue  # a note of its own
        assumed, other = _ASSUMED[role]
        notes.append(
            f"{raw.path.name}: the unit of '{name}' is not stated; {assumed} is assumed "
            f"(another: --column '{role}={name} [{other}]')"
        )
    return notes


def without_spikes(value: Floats, name: str, notes: list[str], line: Integers | None = None) -> Floats:
    """Return values in which single samples far from both neighbours are NaN; they are added to `notes`.

    A transmission error or a lost point changes one sample: the changes to it and from it have opposite signs and
    exceed the usual changes of the record by far. Motion and rest, steps of the resolution and wrapped angles do not.
    """
    known = np.flatnonzero(np.isfinite(value))
    if len(known) < MIN_SAMPLES:
        return value
    step = np.diff(value[known])
    rare = min(max(_RARE[0], _RARE[1] / len(step)), 0.5)
    usual = float(np.quantile(np.abs(step), 1 - rare))
    if not usual:
        low, high = np.quantile(value[known], [rare, 1 - rare])
        usual = resolution(value[(value >= low) & (value <= high)]) or float(high - low)
    before, after = step[:-1], step[1:]
    off = (before * after < 0) & (np.minimum(np.abs(before), np.abs(after)) > _SPIKE * usual)
    rows = known[1:-1][off]
    if not len(rows) or not usual:
        return value
    where = "" if line is None else f" (first: line {line[rows[0]]})"
    notes.append(f"{len(rows)} values of '{name}' far from both neighbours were excluded{where}")
    return np.where(np.isin(np.arange(len(value)), rows), np.nan, value)


def _wraps_at_360(value: Floats) -> bool:
    """Return whether angles without a unit are in degrees: their range and their steps are about 360."""
    known = value[np.isfinite(value)]
    jumps = np.abs(np.diff(known))
    return bool(len(known) > 2 and 200 < np.ptp(known) <= 400 and (np.abs(jumps - 360) < 60).any())


def resolution(value: Floats) -> float:
    """Return the quantisation step of values; 0 if there is none."""
    known = np.unique(value[np.isfinite(value)])
    if len(known) < 3:
        return 0.0
    steps = np.diff(known)
    steps = steps[steps > 1e-9 * max(float(np.abs(known).max()), 1e-300)]
    if not len(steps):
        return 0.0
    step = float(np.median(steps[steps < 1.5 * steps.min()]))
    whole = np.round((known - known[0]) / step)
    sparse = len(known) > 0.5 * np.isfinite(value).sum()
    if not whole[-1] or (sparse and len(np.unique(np.round(steps / step))) < 2):
        return 0.0
    step = float(known[-1] - known[0]) / float(whole[-1])
    off = (known - known[0]) / step
    return step if (np.abs(off - np.round(off)) < 0.1).mean() > 0.95 else 0.0


def checked(
    raw: RawTable,
    quantity: str,
    time: Floats,
    value: Floats,
    sigma: Floats | None,
    notes: list[str],
    *,
    least_sigma: float = 0.0,
) -> MotionTable:
    """Return a motion with repaired times and without empty rows."""
    name, line = raw.path.name, raw.line
    absent = np.isnan(time)
    if absent.any():
        notes.append(
            f"{name}: {absent.sum()} rows without a time were excluded (first: line {line[absent][0]})"
        )
    valid = np.isfinite(value) & ~absent
    weightless = np.zeros(len(value), dtype=bool) if sigma is None else valid & np.isposinf(sigma)
    if weightless.any():
        notes.append(
            f"{name}: {weightless.sum()} rows with an infinite sigma have no weight and were excluded "
            f"(first: line {line[weightless][0]})"
        )
        valid &= ~weightless
    if sigma is not None:
        _raise_if(raw, valid & np.isnan(sigma), "the sigma is missing", "Add it, or remove the column.")
        _raise_if(raw, valid & ~(sigma > 0), "the sigma is not positive", "Correct it, or remove the column.")
    lost = ~valid & ~absent & ~weightless
    if lost.any():
        notes.append(f"{name}: {lost.sum()} rows without a value were excluded (first: line {line[lost][0]})")
    if valid.sum() < MIN_SAMPLES:
        what = f"{raw.path} has {valid.sum()} samples with a value; at least {MIN_SAMPLES} are needed."
        raise DatasetError(what, "Give a longer recording.")
    if quantity == "angle" and np.ptp(value[valid]) == 0:
        what = f"{raw.path}: all {valid.sum()} angles are {value[valid][0]:g} rad."
        raise DatasetError(what, "Check the column.")
    made = MotionTable(
        raw.path, raw.sha256, quantity, time[valid], value[valid], None if sigma is None else sigma[valid], line[valid],
        (), least_sigma,
    )  # fmt: skip
    made = in_order(made, notes)
    if len(made.time) < MIN_SAMPLES:
        raise DatasetError(
            f"{raw.path} has {len(made.time)} samples at different times; at least {MIN_SAMPLES} are needed.",
            "Give a longer recording.",
        )
    return replace(made, notes=tuple(notes))


def _raise_if(raw: RawTable, wrong: npt.NDArray[np.bool_], what: str, hint: str) -> None:
    if wrong.any():
        raise DatasetError(f"{raw.path}, line {raw.line[np.argmax(wrong)]}: {what}.", hint)


def in_order(table: MotionTable, notes: list[str]) -> MotionTable:
    """Sort a table by time and average repeated times, with `notes`; a DatasetError if times restart."""
    name = table.path.name
    table = replace(table, time=continued_clock(table.path, table.time, table.line, notes))
    backward = np.flatnonzero(np.diff(table.time) < 0)
    if len(backward):
        order = np.argsort(table.time, kind="stable")
        notes.append(
            f"{name}: times are not increasing (line {table.line[backward[0] + 1]}); {len(backward)} steps back, "
            "rows were sorted by time"
        )
        table = table.only(order)  # type: ignore[arg-type]
    repeated = np.flatnonzero(np.diff(table.time) == 0)
    if len(repeated):
        notes.append(
            f"{name}: {len(repeated)} repeated times (first: line {table.line[repeated[0] + 1]}); "
            "their values were averaged"
        )
        time, first, count = np.unique(table.time, return_index=True, return_counts=True)
        table = replace(
            table,
            time=time,
            value=np.add.reduceat(table.value, first) / count,
            sigma=None if table.sigma is None else np.sqrt(np.add.reduceat(table.sigma**2, first)) / count,
            line=table.line[first],
        )
    return table


def continued_clock(path: Path, time: Floats, line: Integers, notes: list[str]) -> Floats:
    """Return times without the restarts of a 32-bit counter; another restart is a DatasetError."""
    step = np.diff(time)
    back = np.flatnonzero(step < 0)
    if not len(back) or len(time) < 2 * MIN_SAMPLES:
        return time
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    for period in (_TICKS * 1e-6, _TICKS * 1e-3, float(_TICKS), _DAY):
        if (np.abs(step[back] + period) < 0.02 * period).all() and (period != _DAY or time.max() <= _DAY):
            which = "time of day" if period == _DAY else "32-bit clock"
            notes.append(
                f"{path.name}: the {which} restarts at line {line[back[0] + 1]}; times were continued"
            )
            return np.concatenate([[time[0]], time[0] + np.cumsum(np.where(step < 0, step + period, step))])
    far = back[-step[back] > 20 * usual]
    lengths = np.diff([0, *(far + 1), len(time)])
    several = 0 < len(far) <= 5 and lengths.min() >= MIN_SAMPLES
    # every restart begins at the first time of the file again
    from_first = np.abs(time[far + 1] - time[0]) < 5 * usual
    if several or (len(far) and from_first.all() and float(np.median(lengths)) >= MIN_SAMPLES):
        what = f"{path}: times are not strictly increasing (line {line[far[0] + 1]}): the clock restarts."
        raise DatasetError(what, f"Split the file at this line: it contains {len(far) + 1} recordings.")
    return time


def pieces(time: Floats) -> list[slice]:
    """Return the pieces between gaps: intervals over 20 times the median of eleven, local because a body slows down."""
    step = np.diff(time)
    if not len(step):
        return [slice(0, len(time))]
    usual = median_filter(step, 11, mode="nearest")
    cuts = np.flatnonzero(step > _GAP * usual) + 1
    return [slice(int(a), int(b)) for a, b in zip([0, *cuts], [*cuts, len(time)], strict=True)]


def scatter(time: Floats, value: Floats, floor: float = _FLOOR) -> Floats:
    """Return the standard uncertainty of each of at least 8 unwrapped samples, from the residuals of local cubics.

    Cubics are fitted to blocks of 15 samples. The variance is the running median of their residual variances over 41
    blocks, divided by the median of chi2 / dof, which is robust against outliers and follows slow changes. Errors that
    vary more slowly than a block (centre offset, tilt) are not included. `floor` is a lower bound, in the unit of
    `value`.
    """
    starts = np.arange(0, max(len(time) - _BLOCK, 0) + 1, _BLOCK)
    centre = np.array([float(np.mean(time[i : i + _BLOCK])) for i in starts])
    variance = np.array([_residual_variance(time[i : i + _BLOCK], value[i : i + _BLOCK]) for i in starts])
    half = _NEIGHBOURS // 2
    smooth = [np.median(variance[max(0, k - half) : k + half + 1]) for k in range(len(starts))]
    sigma = np.sqrt(np.interp(time, centre, np.asarray(smooth)) / _MEDIAN_OF_CHI2)
    return np.asarray(np.maximum(sigma, floor))


def _residual_variance(time: Floats, value: Floats) -> float:
    if len(time) <= _ORDER + 1:
        return 0.0
    width = max(float(np.ptp(time)), 1e-300)
    basis = np.vander((time - time.mean()) / width, _ORDER + 1)
    residual = value - basis @ np.linalg.lstsq(basis, value, rcond=None)[0]
    return float(residual @ residual) / (len(time) - _ORDER - 1)
