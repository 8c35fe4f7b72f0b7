"""Samples of one motion from the columns of a table.

Times are sorted, repeated times averaged, and rows without a value excluded; every repair is reported with its line. A
clock that restarts, or a cell that is not a number, raises an error that names the line. A record is split at its gaps.
If the table contains no uncertainty, the uncertainty of the samples is estimated from their scatter.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numpy.polynomial.legendre import legvander
from scipy.ndimage import median_filter

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io._records import ErrorMode, Floats, Input, Integers
from gyrotrack.io.readers._clock import MIN_SAMPLES, ordered, refuse_slow_clock
from gyrotrack.io.readers._inputs import InputOption, described
from gyrotrack.io.readers._plausibility import (
    are_exchanged,
    counts_rows,
    doubt_of_rad,
    ratio_of_units,
    row_numbers,
    wrapping_unit,
)
from gyrotrack.io.readers._raw_table import (
    ROLES,
    TURN,
    UNITS,
    RawTable,
    clean,
    factor,
    header_of,
    is_acceleration,
    is_input,
    role_of,
)
from gyrotrack.io.readers._reading import Reading, Taken

_GAP = 20.0
_BLOCK = 15  # number of samples of a local polynomial; with degree 9, five degrees of freedom remain
# degrees of a local polynomial; the last degree is only used to test whether the previous degree is sufficient
_DEGREES = (3, 5, 7, 9)
# a degree is not sufficient if the ratio of its residual variance to the variance of the next degree exceeds this
# value; the ratio is 1.36 for a random walk and 1 for white noise
_INSUFFICIENT = 1.6
_NEIGHBOURS = 41  # number of blocks of a running median; its standard error is 8 %
# The motion is an oscillation if frequencies near the largest peak of the spectrum have at least this share of the
# variance (without a linear trend), which is more than all other motion together.
_OSCILLATES = 0.5
# trial frequencies of a block, divided by the frequency of the largest peak of the record; the frequency of a pendulum
# is 7 % lower at an amplitude of 60 degrees
_NEARBY = np.linspace(0.9, 1.1, 9)
_FLOOR = 1e-6
_MOST_REPEATED = 0.7  # largest share of rows that have the same time as the previous row
# smallest change at an erroneous sample, before and after this sample [largest usual change]
_SPIKE = 20.0
# largest share and largest number of unusual changes between neighbours; the larger of the two limits applies
_RARE = (0.01, 4.0)
# symbols of quantities that imply SI units
_SYMBOLS = {"t", "omega", "w", "ω", "angle", "psi", "phi", "theta", "ψ", "φ", "θ"}
# units that are proposed for a quantity without a unit
_CHOICES = {"t": ("s", "ms"), "angle": ("rad", "deg"), "omega": ("rad/s", "rpm")}

# by column (header or number, case-folded): quantity, and unit ("" if the header states the unit)
Names = Mapping[str, tuple[str, str]]


@dataclass(frozen=True)
class ReadOptions:
    """Options for reading a file."""

    # columns by header or number, from `read_names`; if empty, the headers determine them
    names: Names | None = None
    # names of points; the centre may also be coordinates, "12.5,40", or "orbit": the centre of a circle fitted to the
    # path of the marker
    marker: str | None = None
    centre: str | None = None
    fps: float | None = None  # frame rate [1/s], for a file with frame numbers
    start: float = 0.0  # time of the first frame [s], added to all times
    likelihood: float = 0.6  # minimum likelihood of the points that are used
    pulses_per_turn: float | None = None  # pulses per turn, for a file with times of pulses
    body: str = ""  # name of the body, to choose between columns whose names contain it
    inputs: tuple[InputOption, ...] = ()  # recorded inputs


@dataclass(frozen=True)
class Driver:
    """A column that may drive the motion, for example a voltage or a commanded torque, at the times of the rows."""

    name: str
    unit: str
    value: Floats  # shape (n,); in the unit of the file


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
    doubts: tuple[str, ...] = ()  # reasons why the values may be wrong by more than their uncertainty
    drivers: tuple[Driver, ...] = ()
    inputs: tuple[Input, ...] = ()  # inputs that the user records, with their own times
    reading: Reading | None = None  # the meaning of each column
    modes: tuple[ErrorMode, ...] = ()  # errors that samples share, in the unit of `value`
    # shape (n, m); changes of the values due to m independent errors of one standard deviation. The uncertainties of
    # motion parameters contain these errors, but fits do not: an error of the centre is nearly a factor of all angles.
    changes: Floats | None = None

    def only(self, keep: npt.NDArray[np.bool_] | Integers, *notes: str) -> MotionTable:
        """Return the selected samples, with further notes."""
        return replace(
            self,
            time=self.time[keep],
            value=self.value[keep],
            sigma=None if self.sigma is None else self.sigma[keep],
            line=self.line[keep],
            drivers=tuple(replace(i, value=i.value[keep]) for i in self.drivers),
            modes=tuple(replace(m, basis=m.basis[keep]) for m in self.modes),
            changes=None if self.changes is None else self.changes[keep],
            notes=(*self.notes, *notes),
        )


_LISTED = 8  # largest number of names in a message


def only_one(path: Path, names: Sequence[str], what: str, options: ReadOptions) -> str:
    """Return the only name of a list, or the name that matches the option `marker`."""
    named = [n for n in names if options.marker and options.marker.casefold() in n.casefold()]
    chosen = named if len(named) == 1 else names
    if len(chosen) != 1:
        more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
        which = f": {', '.join(n[:40] for n in names[:_LISTED])}{more}" if names else ""
        hint = f"Choose one with --marker, for example --marker '{names[0]}'." if names else "Give a table."
        raise DatasetError(f"{path} contains {len(names)} {what}{which}.", hint)
    return chosen[0]


COORDINATES = ("x", "y")
_TURNS = {"rev", "revs", "turn", "turns", "revolution", "revolutions", "cycles"}
# a speed counts as constant if the ratio of its squared mean to its variance is at least this value
_STEADY = 100.0

_LAST_UNIT = re.compile(r"(.*\S)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")


def read_names(
    given: Iterable[str], body: str = "casing", bodies: Iterable[str] = ("casing", "rotor")
) -> Names:
    """Parse options like ``t=Zeit``, ``angle=phi [deg]``, ``x=2``, ``t=1 [us]``, or for one body ``casing.x=2``."""
    names: dict[str, tuple[str, str]] = {}
    for option in given:
        role_name, equals, column = (part.strip() for part in option.partition("="))
        prefix, dot, quantity = role_name.partition(".")
        role_name = quantity if dot and prefix in {*bodies} else role_name
        if not equals or role_name not in (*ROLES, *COORDINATES) or not column:
            raise UsageError(
                f"{option[:60]!r}: unknown column.",
                f"Write, for example, t=Zeit; quantities: {', '.join((*ROLES, *COORDINATES))}.",
            )
        if role_name == quantity and prefix != body:
            continue
        names[column.casefold()] = (role_name, "")
        # the name may be given without the unit that follows it in the header
        last = _LAST_UNIT.fullmatch(column)
        base, unit = last.groups() if last else (column, "")
        if unit:
            names.setdefault(base.casefold(), (role_name, clean(unit)))
    return names


_SHOWN = 8
EXPECTED = "Use the header `t,angle`, `t,angle,sigma`, `t,omega` or `t,omega,sigma`, or give the columns with --column."


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(f"'{name[:30]}'" for name in names[:_SHOWN])
    return f"{shown} and {len(names) - _SHOWN} more" if len(names) > _SHOWN else shown


@dataclass(frozen=True)
class Columns:
    """The columns of a table by quantity."""

    place: dict[str, int]  # column of each quantity
    unit: dict[str, str]  # unit of the column; "" if none is stated
    why: dict[str, str]  # the reason of the choice
    axes: list[int]  # all columns of the chosen quantity, if the columns are the axes of a sensor
    drivers: list[int]  # measured causes of the motion

    def taken(self, raw: RawTable, *roles: str) -> tuple[Taken, ...]:
        """Return the meaning of the columns of some quantities."""
        found = []
        for role in (r for r in roles if r in self.place):
            unit, why = self.unit[role], self.why[role]
            if not unit and role in _SI:
                unit, why = _SI[role], f"{why}; SI by convention"
            found.append(Taken(column_name(raw, self.place[role]), _QUANTITY.get(role, role), unit, why))
        return tuple(found)


_SI = {"t": "s", "angle": "rad", "omega": "rad/s"}
_QUANTITY = {"t": "time", "revolutions": "count", "interval": "intervals", "sigma": "uncertainty"}


def column_name(raw: RawTable, index: int) -> str:
    """Return the header of a column in quotes, or its number."""
    return f"'{raw.names[index][:40]}'" if raw.names[index] else f"column {index + 1}"


def find_columns(raw: RawTable, options: ReadOptions) -> Columns:
    """Return column, unit and reason of each quantity; raise an error for two columns with the same meaning."""
    found: dict[str, list[int]] = {}
    units: dict[int, str] = {}
    why: dict[int, str] = {}
    given_names = {" ".join(_words(n)): r for n, r in (options.names or {}).items()} | dict(
        options.names or {}
    )
    recorded = {place for o in options.inputs if o.file is None and (place := o.place(raw)) is not None}
    for index, name in enumerate(raw.names):
        base, unit = header_of(name)
        below = clean(raw.units[index])
        named_by_unit = clean(base).casefold() == unit
        if below and unit and not named_by_unit and clean(unit).casefold() != below.casefold():
            what = f"{raw.header_place}: the unit of '{name}' is '{below}' in the next line."
            raise DatasetError(what, "Correct one of them.")
        units[index] = below or clean(unit)
        role = role_of(base) if name and not options.names and not is_acceleration(name) else None
        if options.names:
            for text in (name.casefold(), base.casefold(), str(index + 1), _stem_without_axis(base)):
                if text and text in given_names:
                    role, given = given_names[text]
                    units[index] = given or units[index]
                    why[index] = "by --column"
                    break
        elif role in {None, "angle", "omega"} and units[index]:
            by_unit = next((r for r in ("angle", "omega") if units[index].casefold() in UNITS[r]), role)
            why[index] = "by its name" if by_unit == role else "by its unit"
            role = by_unit
            if role == "omega" and factor("omega", units[index]) is None:
                role = None
        if role in {None, "revolutions"} and units[index].casefold() in UNITS["t"] and base == name:
            role, why[index] = "t", "by its unit"
        if role in {"angle", "revolutions"} and clean(base).casefold() in _TURNS:
            # a column `turns` is a counter if its numbers are whole
            values = raw.numeric(index)
            whole = values is not None and bool((values == np.round(values))[np.isfinite(values)].all())
            role, units[index] = ("revolutions", "") if whole else ("angle", "turns")
        if (
            why.get(index) != "by --column"
            and role in {"angle", "omega"}
            and units[index].casefold()
            in {
                "km/h",
                "m/s",
                "mph",
                "v",
                "m",
                "px",
                "state",
            }
        ):
            role = None
        if index in recorded and why.get(index) != "by --column":
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
        chosen["t"], why[0] = 0, "the first column"
    if options.names and "t" not in chosen:
        chosen |= {
            role: i for i, name in reversed(list(enumerate(raw.names)))
            for role in (role_of(header_of(name)[0]),) if role in {"t", "frame"} and i not in chosen.values()
        }  # fmt: skip
    quantity = "angle" if "angle" in chosen else "omega"
    stem = _stem_without_axis(raw.names[chosen[quantity]]) if len(found.get(quantity, [])) > 1 else None
    axes = [i for i, n in enumerate(raw.names) if stem is not None and _stem_without_axis(n) == stem]
    axes = axes if len({raw.names[i] for i in axes}) == len(axes) else []
    return Columns(
        chosen,
        {role: units[i] for role, i in chosen.items()},
        {role: why.get(i, "by its name") for role, i in chosen.items()},
        axes,
        [
            i
            for i, n in enumerate(raw.names)
            if is_input(header_of(n)[0]) and i not in recorded and i not in chosen.values()
        ],
    )


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
        of_body = [i for i in places if options.body.casefold() in raw.names[i].casefold()]
        if len(of_body) == 1:
            return of_body[0]
    first, *copies = (raw.numeric(i) for i in places) if len(set(names)) == 1 else (None,)
    if first is not None and all(c is not None and np.array_equal(c, first, equal_nan=True) for c in copies):
        return places[0]
    # the axes of a sensor are preferred to the magnitude, which does not contain the sense of rotation
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
    return re.split(r"[\s_./]+", name.casefold().strip("/ "))


def _stem_without_axis(name: str) -> str:
    words = [w for w in _words(name) if w not in {"x", "y", "z"}]
    # gx, gyroY, wz: the last letter is the axis
    return " ".join(w[:-1] if len(words) == 1 and w[-1:] in {"x", "y", "z"} else w for w in words)


def _along_rotation(values: Floats) -> tuple[Floats, Floats]:
    """Return angular velocities (n, axes) along the direction in which they vary most, and this direction.

    A sensor axis at an angle a to the axis of rotation measures the part cos a of the speed. A constant error of a
    sensor axis does not change the direction of the variation. A constant speed has the direction of the mean.
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
    """Return the times of a table [s]: the time column, or the numbers of the frames or rows, divided by the rate."""
    if "t" in columns:
        time = raw.numbers(columns["t"], "t", times=True)
        return time * scale_of(raw, "t", units["t"]) + options.start
    if "frame" in columns:
        return raw.numbers(columns["frame"], "frame") / frame_rate(raw.path, options) + options.start
    where = raw.header_place
    if options.fps:
        return np.arange(len(raw.line)) / frame_rate(raw.path, options) + options.start
    if not raw.headed and not options.names:
        raise _without_header(raw)
    among = f" among {_listed(raw.names)}" if any(raw.names) else ""
    what = f"{where}: there is no column for the time{among}."
    raise DatasetError(what, f"Give the rate of the rows with --casing-fps N. {EXPECTED}")


def _without_header(raw: RawTable) -> DatasetError:
    """Return the error for columns without names; its hint follows from the numbers in the columns."""
    indices = row_numbers(raw)
    what = f"{raw.header_place}: the {len(raw.names)} columns have no header"
    if indices:
        which = " and ".join(str(i + 1) for i in indices)
        what += f", and {which} {'number' if len(indices) > 1 else 'numbers'} the rows"
    if len(raw.names) == 1:
        return DatasetError(
            f"{raw.header_place}: the only column has no header.",
            "Give --pulses-per-turn N for times of pulses or intervals between them, or --casing-fps N --column "
            "'angle=1 [deg]' for samples.",
        )
    time = "--casing-fps N" if 0 in indices else "--column t=1"
    angle = next((i + 1 for i in range(1, len(raw.names)) if i not in indices), 2)
    return DatasetError(
        f"{what}.",
        f"Give them by number: {time} --column 'angle={angle} [deg]'; or give --pulses-per-turn for pulses or counts.",
    )


def _unit_since_1970(raw: RawTable, column: int) -> str:
    """Return the unit of times since 1970 from their size (dates from 1973 to 5138); "" for seconds or other times."""
    values = raw.numeric(column)
    known = np.zeros(0) if values is None else values[np.isfinite(values)]
    size = float(np.median(np.abs(known))) if len(known) else 0.0
    return next((unit for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11)) if size >= least), "")


def frame_rate(path: Path, options: ReadOptions) -> float:
    """Return the frame rate given by the user; raise a UsageError if it is missing or not positive."""
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


def interpret(raw: RawTable, options: ReadOptions, *, counts: bool = False) -> MotionTable:
    """Return the angle or the angular velocity in a table; a DatasetError names column and line of an error.

    Angles that are `counts` of an encoder may increase in equal steps.
    """
    columns = find_columns(raw, options)
    place, units, why = columns.place, columns.unit, columns.why
    quantity = "angle" if "angle" in place else "omega"
    if quantity not in place and ("t" in place or "frame" in place or options.fps):
        raise _without_motion(raw, columns)
    notes = list(raw.notes)
    if "t" in place and not units["t"] and (unit := _unit_since_1970(raw, place["t"])):
        units["t"] = unit
        notes.append(f"{raw.path.name}: the times are assumed to be counted in {unit} since 1970")
    time = times_of(raw, place, units, options)
    value = without_spikes(raw.numbers(place[quantity], quantity), quantity, notes, raw.line)
    if quantity == "angle":
        units["angle"], why["angle"] = _unit_of_angle(
            raw, place["angle"], units["angle"], why["angle"], value
        )
    if "omega" in place and quantity == "angle":
        _compare(raw, columns, time, value)
    _ask_for_units(raw, columns, quantity, options)
    unit = units[quantity]
    scale = scale_of(raw, quantity, unit) if unit not in _SIGNALS else 1.0
    if unit in _SIGNALS:
        notes.append(
            f"{raw.path.name}: the signal in {unit} is proportional to the {quantity} by an unknown factor: 1 {unit} "
            f"is taken as 1 {'rad' if quantity == 'angle' else 'rad/s'}, so only times and ratios are meaningful"
        )
    if "t" in place and not counts and are_exchanged(time, value, TURN / scale):
        raise DatasetError(
            f"{raw.path}: {column_name(raw, place[quantity])} grows in equal steps and "
            f"{column_name(raw, place['t'])} does not: they may be exchanged.",
            f"Give the columns: --column 't=...' --column '{quantity}=...'.",
        )
    sigma = None
    if "sigma" in place:
        sigma_unit = units["sigma"]
        sigma = raw.numbers(place["sigma"], "sigma", infinite=True) * (
            scale_of(raw, quantity, sigma_unit) if sigma_unit else scale
        )
    parts = [raw.numeric(i) for i in columns.axes]
    used = {place[role] for role in ("t", "frame", quantity, "sigma") if role in place}
    if len(parts) in {2, 3} and quantity == "omega" and all(p is not None for p in parts):
        others = [[] if i == place[quantity] else notes for i in columns.axes]
        cleared = [
            without_spikes(p, raw.names[i], o)
            for p, i, o in zip(parts, columns.axes, others, strict=True)
            if p is not None
        ]
        value, direction = _along_rotation(np.stack(cleared, axis=1))
        text = ", ".join(f"{c:.3f}" for c in direction)
        used |= set(columns.axes)
        why["omega"] = f"{why['omega']}, with the other axes"
        notes.append(
            f"{raw.path.name}: the speed is the component in the direction ({text}) of the {len(parts)} axes of "
            f"'{_stem_without_axis(raw.names[place[quantity]])}', in which it varies most; the scale factor of the "
            "sensor is not determined"
        )
    inputs, input_columns, as_inputs = _recorded_inputs(raw, options, time)
    used |= set(input_columns)
    drivers = tuple(
        Driver(header_of(raw.names[i])[0], raw.units[i] or header_of(raw.names[i])[1], values)
        for i in (*columns.drivers, *input_columns)
        if (i in input_columns or i not in used) and (values := raw.numeric(i)) is not None
    )
    taken = columns.taken(raw, "t", "frame", quantity, "sigma")
    if not {"t", "frame"} & set(place):
        taken = (Taken("the number of the row", "time", "s", f"at {options.fps:g} rows/s"), *taken)
    proposed = [i for i in columns.drivers if i not in used and raw.numeric(i) is not None]
    taken += as_inputs
    taken += tuple(
        Taken(f"'{header_of(raw.names[i])[0]}'", "input", raw.units[i] or header_of(raw.names[i])[1], BY_NAME)
        for i in proposed
    )
    shown = {header_of(raw.names[i])[0] for i in proposed}
    left_out = tuple(
        column_name(raw, i) for i, n in enumerate(raw.names) if i not in used and header_of(n)[0] not in shown
    )
    least_sigma = resolution(value) * scale / float(np.sqrt(12))
    made = checked(raw, quantity, time, value * scale, sigma, notes, least_sigma=least_sigma, drivers=drivers)
    _refuse_unusual(raw, columns, made)
    return replace(made, inputs=inputs, reading=Reading(raw.path.name, "", len(raw.line), taken, left_out))


BY_NAME = "by its name"


def _recorded_inputs(
    raw: RawTable, options: ReadOptions, time: Floats
) -> tuple[tuple[Input, ...], list[int], tuple[Taken, ...]]:
    """Return the inputs that the user records from a table, their columns, and their descriptions."""
    inputs, places, taken = [], [], []
    for option in (o for o in options.inputs if o.file is None):
        place = option.place(raw)
        if place is None:
            raise DatasetError(
                f"{raw.header_place}: there is no column '{option.column[:40]}' for the input {option.name} among "
                f"{_listed(raw.names)}.",
                "Give a header or a number: --input 'current=3 [A]'.",
            )
        found = option.made(raw, place, time)
        inputs.append(found)
        places.append(place)
        taken.append(
            Taken(
                column_name(raw, place), f"input {option.name}", found.unit, f"by --input; {described(found)}"
            )
        )
    return tuple(inputs), places, tuple(taken)


def _refuse_unusual(raw: RawTable, columns: Columns, made: MotionTable) -> None:
    """Raise a DatasetError for an unstated unit if the motion would be unusual in s and rad."""
    asked = [r for r in columns.place if not columns.unit[r] and columns.why[r] != "by --column"]
    names = {r: raw.names[columns.place[r]] or str(columns.place[r] + 1) for r in asked}
    # a time of day is text, and its unit is known
    if "t" in asked and raw.numeric(columns.place["t"]) is not None:
        refuse_slow_clock(raw.header_place, names["t"], made.time)
    if "angle" in asked and (doubt := doubt_of_rad(made.value)):
        stated = (f"--column 'angle={names['angle']} [{unit}]'" for unit in _CHOICES["angle"])
        what = f"{raw.header_place}: the unit of '{names['angle']}' is not stated, and in rad {doubt}."
        raise DatasetError(what, f"State it: {' or '.join(stated)}.")


# units of a signal that may be proportional to an angle or a speed
_SIGNALS = {"V", "mV", "A", "mA", "m", "cm", "mm", "px", "counts"}


def _without_motion(raw: RawTable, columns: Columns) -> DatasetError:
    """Return the error for a table without a column for the angle or the speed; it lists columns that may be one."""
    what = f"{raw.header_place}: there is no column for the angle or omega among {_listed(raw.names)}."
    others = [
        i for i in range(len(raw.names)) if i not in columns.place.values() and raw.numeric(i) is not None
    ]
    name = raw.names[others[0]] if others else ""
    if not name:
        return DatasetError(what, EXPECTED)
    return DatasetError(
        what,
        f"State what a column is, for example --column 'angle={name}' or --column 'omega={name} [rpm]'; times of "
        "events and signals with pulses need --pulses-per-turn.",
    )


def _unit_of_angle(raw: RawTable, column: int, unit: str, why: str, value: Floats) -> tuple[str, str]:
    """Return the unit of an angle and the reason; a stated unit that contradicts the wrapping raises a DatasetError."""
    wraps = wrapping_unit(value)
    if not wraps:
        return unit, why
    name = column_name(raw, column)
    if unit and abs((factor("angle", unit) or 0.0) / UNITS["angle"].get(wraps, 1.0) - 1) > 0.01:
        raise DatasetError(
            f"{raw.header_place}: {name} is stated in {unit[:30]}, but it wraps at a whole turn in {wraps}.",
            f"State its unit: --column 'angle={raw.names[column] or column + 1} [{wraps}]'.",
        )
    return wraps, f"{why}; it wraps at a whole turn in {wraps}"


def _compare(raw: RawTable, columns: Columns, time: Floats, angle: Floats) -> None:
    """Compare an angle with the speed in the same table; contradictory units raise a DatasetError."""
    units = columns.unit
    scales = [factor(role, units[role]) if units[role] else 1.0 for role in ("angle", "omega")]
    speed = raw.numeric(columns.place["omega"])
    if None in scales or speed is None:
        return
    ratio, cause = ratio_of_units(time, angle * (scales[0] or 1.0), speed * (scales[1] or 1.0))
    if not cause:
        return
    names = [column_name(raw, columns.place[role]) for role in ("angle", "omega")]
    raise DatasetError(
        f"{raw.header_place}: the slope of {names[0]} is {abs(ratio):.4g} times {names[1]}: {cause}.",
        f"State the unit of the column to use: --column 'angle={raw.names[columns.place['angle']]} [deg]'.",
    )


def _ask_for_units(raw: RawTable, columns: Columns, quantity: str, options: ReadOptions) -> None:
    """Raise a DatasetError for a column whose unit is not stated and not implied by the symbol of the quantity."""
    for role in (quantity, "t"):
        if role not in columns.place or columns.unit[role] or columns.why[role].startswith("by --column"):
            continue
        column = columns.place[role]
        values, name = raw.numeric(column), raw.names[column]
        if values is None or not name:
            continue
        if role == "t" and not options.fps and counts_rows(values[np.isfinite(values)]):
            raise DatasetError(
                f"{raw.header_place}: {column_name(raw, column)} numbers the rows.",
                f"Give the rate with --casing-fps N, or the unit with --column 't={name} [s]'.",
            )
        symbol = set(re.split(r"[\s_.,\-:]+", name.casefold())) & _SYMBOLS
        if symbol or (
            role == "t" and (values % 1 != 0).any()
        ):  # times that are not whole numbers are hardly in milliseconds
            continue
        first, second = (f"--column '{role}={name} [{unit}]'" for unit in _CHOICES[role])
        what = f"{raw.header_place}: the unit of {column_name(raw, column)} is not stated."
        raise DatasetError(what, f"State it: {first} or {second}.")


def without_spikes(value: Floats, name: str, notes: list[str], line: Integers | None = None) -> Floats:
    """Return values in which single samples far from both neighbours are NaN; `notes` reports them.

    A transmission error or a lost point changes one sample: the changes before and after it have opposite signs and far
    exceed the usual changes of the record. Motion and rest, steps of the resolution and wrapped angles do not cause
    such changes.
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
    drivers: tuple[Driver, ...] = (),
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
    if np.ptp(value[valid]) == 0:
        kind, unit = ("angles", "rad") if quantity == "angle" else ("speeds", "rad/s")
        what = f"{raw.path}: all {valid.sum()} {kind} are {value[valid][0]:g} {unit}."
        raise DatasetError(what, "Check the column.")
    made = MotionTable(
        raw.path, raw.sha256, quantity, time[valid], value[valid], None if sigma is None else sigma[valid], line[valid],
        (), least_sigma, drivers=tuple(replace(i, value=i.value[valid]) for i in drivers),
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


def is_wrapped(angle: Floats) -> bool:
    """Return whether angles are wrapped: within one turn (except for noise), with steps of more than half a turn."""
    return bool(np.ptp(angle) <= 1.05 * TURN and (np.abs(np.diff(angle)) > TURN / 2).any())


def in_order(table: MotionTable, notes: list[str]) -> MotionTable:
    """Order a table by time, average the values at repeated times, and add to `notes`.

    An uncertain order raises a DatasetError.
    """
    name, value = table.path.name, table.value
    if table.quantity == "angle" and len(value) and is_wrapped(value):
        value = np.unwrap(value)
    time, order = ordered(table.path, table.time, table.line, value, notes)
    table = replace(table, time=time).only(order)
    repeated = np.flatnonzero(np.diff(table.time) == 0)
    if len(repeated) > _MOST_REPEATED * len(table.time):
        raise DatasetError(
            f"{table.path}: {len(repeated)} of {len(table.time)} rows repeat a time.",
            "Check the column of the time (--column t=COLUMN), give the times with more digits, or give the rate of "
            "the rows with --casing-fps N.",
        )
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
            drivers=tuple(replace(i, value=i.value[first]) for i in table.drivers),
        )
    return table


def pieces(time: Floats) -> list[slice]:
    """Return the pieces between gaps.

    A gap is an interval longer than 20 times the median of eleven neighbouring intervals.
    """
    step = np.diff(time)
    if not len(step):
        return [slice(0, len(time))]
    usual = median_filter(step, 11, mode="reflect")  # "nearest" would count a gap at an end six times
    cuts = np.flatnonzero(step > _GAP * usual) + 1
    return [slice(int(a), int(b)) for a, b in zip([0, *cuts], [*cuts, len(time)], strict=True)]


def scatter(time: Floats, value: Floats, floor: float = _FLOOR) -> Floats:
    """Return the standard uncertainty of each of at least 8 unwrapped samples from residuals of local polynomials.

    Polynomials are fitted to blocks of 15 samples. The variance is the running median of the residual variances over 41
    blocks, divided by the median of chi2 / dof; it is robust against outliers and follows slow changes. The degree is
    the lowest of 3, 5 and 7 whose variance is less than 1.6 times the variance of the next degree. Degree 3 is
    therefore used for white and correlated noise. For an oscillation with few samples per period, cubics would leave a
    part of the motion in the residuals. If an oscillation with a period of at most a block has most of the variance, a
    sinusoid is added to the cubics. Errors that vary more slowly than a block (centre offset, tilt) are not included.
    `floor` is a lower bound, in the unit of `value`.
    """
    size = min(_BLOCK, len(time))
    count = len(time) // size
    t, v = time[: count * size].reshape(count, size), value[: count * size].reshape(count, size)
    centre = t.mean(axis=1)
    away = (t - centre[:, None]) / np.maximum(np.ptp(t, axis=1), 1e-300)[:, None] * 2
    # column j of Q belongs to degree j: the coefficients of higher degrees give the squared residuals of a degree
    orthogonal = np.linalg.qr(legvander(away, min(_DEGREES[-1], size - 1)), mode="complete")[0]
    off = v - v.mean(axis=1, keepdims=True)
    squares = np.einsum("kij,ki->kj", orthogonal, off) ** 2
    smooth = np.zeros((len(_DEGREES), count))
    for d, degree in enumerate(_DEGREES):
        free = size - degree - 1
        if free > 0:
            smooth[d] = _running_variance(squares[:, degree + 1 :].sum(axis=1), free)
    sufficient = smooth[:-1] < _INSUFFICIENT * smooth[1:]
    lowest = np.where(sufficient.any(axis=0), sufficient.argmax(axis=0), 0)
    known = smooth[lowest, np.arange(count)]
    if frequency := _fast_oscillation(time, value):
        remaining = np.array(
            [_about_sinusoids(t - centre[:, None], off, frequency * near) for near in _NEARBY]
        )
        periodic = _running_variance(remaining.min(axis=0), size - _SINUSOID)
        known = np.where(periodic < known / _INSUFFICIENT, periodic, known)
    # constant values of a body at rest, measured with a coarse resolution, do not show the noise
    shows = known > floor**2
    if shows.any():
        known = np.where(shows, known, np.median(known[shows]))
    return np.asarray(np.maximum(np.sqrt(np.interp(time, centre, known)), floor))


def _running_variance(squares: Floats, free: int) -> Floats:
    """Return the running median, over blocks, of the variance; each block has `free` degrees of freedom."""
    half = _NEIGHBOURS // 2
    middle = np.array([np.median(squares[max(0, k - half) : k + half + 1]) for k in range(len(squares))])
    # the median of chi2 / dof (E. B. Wilson and M. M. Hilferty, PNAS 17, 1931)
    return np.asarray(middle / free / (1 - 2 / (9 * free)) ** 3)


def _fast_oscillation(time: Floats, value: Floats) -> float:
    """Return the frequency of an oscillation with most of the variance and at least one period per block, else 0."""
    count = len(time)
    if count < 3 * _BLOCK:
        return 0.0
    even = np.linspace(time[0], time[-1], count)
    at_even = np.interp(even, time, value)
    deviation = at_even - np.polynomial.Polynomial.fit(even, at_even, 1)(even)
    power = np.abs(np.fft.rfft(deviation * np.hanning(count), 8 * count)) ** 2
    peak = int(np.argmax(power))
    within = power[int(_NEARBY[0] * peak) : int(_NEARBY[-1] * peak) + 1]
    if peak * _BLOCK < 8 * count or within.sum() < _OSCILLATES * power.sum():
        return 0.0
    return peak / 8 * (count - 1) / (count * float(time[-1] - time[0]))


_SINUSOID = 7  # parameters of a cubic, and amplitude, phase and frequency of a sinusoid


def _about_sinusoids(time: Floats, value: Floats, frequency: float) -> Floats:
    """Return the sum of the squared residuals of each block (row) from a cubic and a sinusoid of a frequency."""
    away = time / np.maximum(np.abs(time).max(axis=1, keepdims=True), 1e-300)
    phase = TURN * frequency * time
    columns = np.concatenate([legvander(away, 3), np.cos(phase)[..., None], np.sin(phase)[..., None]], axis=2)
    along = np.einsum("kij,ki->kj", np.linalg.qr(columns)[0], value)
    return np.asarray(np.maximum((value**2).sum(axis=1) - (along**2).sum(axis=1), 0.0))
