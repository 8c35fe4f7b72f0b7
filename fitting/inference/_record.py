"""Measured angles or angular velocities of one experiment.

A `Record` is made from arrays (`make_record`) or a case file (`fitting.inference._case_file`). All times are on one
clock [s]. Angles are unwrapped [rad], and speeds are in rad/s. `quantity` states what was measured: angles or angular
velocities.

Angular velocities are computed from angles and smoothed as in the paper. Between its windows, the speed of the rotor is
interpolated with the slopes that are measured in the windows.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress, pairwise
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from fitting._errors import RecordError
from fitting._numbers import SI, WITHOUT_INERTIA, Units, rounded, span_of
from fitting.dynamics._inputs import Input
from fitting.effects._mechanism import GYROSCOPE, MAIN, Mechanism
from fitting.inference._error_modes import ErrorMode, checked_modes, of_windows
from fitting.inference._prior import Prior

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Quantity = Literal["angle", "omega"]
Role = Literal["rotor", "casing", "body"]

_FEWEST_OF_BODY = 24
"""Smallest number of samples of the first body [samples]. Derived: a block needs 12 samples for the model and 12 for
the noise."""
_PIECES = (480, 240, 120, 60, 30, 15, 8, 4, 2, 1)
"""Trial numbers of pieces of a smoothed curve [1]. Chosen: BIC selects one of them; a coarser list smooths too much or
too little, a finer list costs time."""
_MIN_PIECE = 12
"""Smallest number of samples of a piece [samples]. Chosen: a smaller number follows noise, a larger one blurs the
motion."""
_CUBIC = 4
"""Number of coefficients of a piece [1]. Derived: a polynomial of degree 3."""
_FEWEST: dict[str, int] = {"angle": 8, "omega": 1}
"""Smallest number of samples of a rotor window, by quantity [samples]. Chosen: a measured speed suffices, but a speed
from angles needs several samples; with fewer angles, the uncertainty of the speed is unknown; a larger number refuses
short films."""
_SHOWN = 6
"""Number of windows and inputs in a repr [1]. Chosen: a smaller number hides windows, a larger one fills the
console."""
_SPEED_SAMPLES = 5
"""Number of samples of an average speed; the largest average is the unit of trial speeds in laws [samples]. Chosen: a
smaller number contains more noise, a larger one averages over a period of an oscillation."""
_LARGEST_SHARE = 0.95
"""Quantile of the speeds that counts as the largest speed [1]. Chosen: a higher quantile depends on outliers, a lower
one is a mean."""
_MOVES = 3.0
"""A body counts as moving if the ratio of its largest speed to the noise of an average speed exceeds this value [1].
Derived: for noise alone, the quantile 0.95 of the absolute value is 2.0."""
LARGEST = 1e20
"""Largest time, angle or rate [SI units]. Derived: products of several such values are finite."""
SMALLEST = 1e-20
"""Lower limit of the largest value of a moving body [SI units]. Derived: products of several such values do not
vanish."""
PRECISION = 1e18
"""Largest ratio of a value to its uncertainty [1]. Derived: the relative precision of floating-point numbers is 1e-16,
so a larger ratio has no meaning."""


@dataclass(frozen=True, repr=False)
class Samples:
    """An uninterrupted run of measured values: time [s], value [rad or rad/s], sigma (same unit).

    `state` is the index of the speed of the body in the state of the motion, for any body except the main one;
    `harmonic` is the standard deviation of the amplitudes of an error of 1 to 12 periods per turn of its angle [rad].
    """

    time: Array
    value: Array
    sigma: Array
    state: int = 0
    harmonic: float = 0.0

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        return f"Samples: {span_of('time', self.time, 's')}, {span_of('value', self.value, '')}"


@dataclass(frozen=True)
class Body:
    """A body of a recording.

    Parameters
    ----------
    name : str
        The name of the body.
    role : {"rotor", "casing", "body"}
        The role in the apparatus; "body" for a single body and for the bodies of a chain.
    part : str
        The body whose laws in the library apply: "rotor", "casing", or in a chain the name of the body.
    state : int
        Index of the speed in the state vector of the motion.
    inertia, inertia_u : float
        Moment of inertia and its standard uncertainty [kg m2]; NaN if the uncertainty is not given.
    series : tuple of Samples
        The measured runs, each without interruption.
    """

    name: str
    role: Role
    part: str
    state: int
    inertia: float
    inertia_u: float
    series: tuple[Samples, ...]

    @property
    def relative_u(self) -> float:
        """Relative standard uncertainty of the moment of inertia [1]; 0 if none is given."""
        return 0.0 if math.isnan(self.inertia_u) else self.inertia_u / self.inertia


@dataclass(frozen=True, repr=False)
class Record:
    """One experiment on one clock.

    In a chain of bodies, `casing` is the main body (the second body of the `mechanism`). `rotor` contains the runs of
    all other bodies, each with the index of its body in the state.

    Parameters
    ----------
    label, surface : str
        Names; the label distinguishes the cases of a joint fit.
    I_rotor, I_casing : float
        Moments of inertia [kg m2].
    I_rotor_u, I_casing_u : float
        Standard uncertainties of the moments of inertia [kg m2]; NaN if not given.
    casing : Samples
        The casing through the whole run.
    rotor : tuple of Samples
        The rotor in each window.
    quantity : {"angle", "omega"}
        What the values are.
    source : str
        The file, for provenance.
    tracked : bool
        Whether the angles come from film, with tracking errors of one and two periods per turn.
    gradients : bool
        Whether the speeds are gradients of filmed angles, including the errors of the camera.
    generated : bool
        Whether the values of the rotor are a generated curve and not measured (see `fitting.study._preparation`).
    windows : tuple of Samples
        The measured windows of a generated rotor.
    start_sigma : tuple of float
        Uncertainty of the start of each rotor window on the casing's clock [s]; empty if exact, NaN if not stated.
    units : Units
        Units of torques: SI units, or units per unit of inertia if the moment of inertia is unknown; it is then 1.
    correlated : tuple of float
        Four numbers about errors of the casing's angle; zeros for an absent error. The first two are the standard
        uncertainty [rad] and the correlation time [s] of a slowly varying error. The other two are standard deviations
        of amplitudes [rad]: of an error with one and two periods per turn, and of an error of 1 to 12 periods per turn.
    correlated_profile : tuple of (float, float)
        Times [s] and the standard uncertainty [rad] of the slowly varying error at each of them; empty if it is
        constant.
    digest : str
        SHA-256 of the numbers.
    prior : Prior, optional
        Prior of the parameters from another study.
    inputs : tuple of Input
        Recorded inputs on which torques may depend.
    name : str
        Name of a single body; empty for several bodies or without a name.
    modes : tuple of ErrorMode
        Errors that samples share.
    mechanism : Mechanism
        The bodies and the joints between them.
    further : tuple of (float, float)
        Moments of inertia of the third and later bodies of the mechanism, and their standard uncertainties [kg m2]; NaN
        if not given.
    """

    label: str
    I_rotor: float
    I_casing: float
    casing: Samples
    rotor: tuple[Samples, ...]
    quantity: Quantity = "angle"
    surface: str = ""
    source: str = ""
    tracked: bool = False
    gradients: bool = False
    generated: bool = False
    windows: tuple[Samples, ...] = ()
    start_sigma: tuple[float, ...] = ()
    I_rotor_u: float = math.nan
    I_casing_u: float = math.nan
    units: Units = SI
    correlated: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    correlated_profile: tuple[tuple[float, float], ...] = ()
    digest: str = field(default="")
    prior: Prior | None = None
    inputs: tuple[Input, ...] = ()
    name: str = ""
    modes: tuple[ErrorMode, ...] = ()
    mechanism: Mechanism = GYROSCOPE
    further: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if not self.digest:
            object.__setattr__(self, "digest", _digest(self))

    def __repr__(self) -> str:
        what = "angles" if self.quantity == "angle" else "angular velocities"
        first, last = self.span
        words = ", ".join(
            f"I_{b.name} {rounded(b.inertia, b.inertia_u, self.units.inertia)}" for b in reversed(self.bodies)
        )
        lines = [
            f"Record {self.label!r}: {what}, {first:.6g} to {last:.6g} s",
            f"  {self.body}: {len(self.casing)} samples",
            *(
                f"  {self.mechanism.bodies[w.state]}, {len(w)} samples from {w.time[0]:.6g} to {w.time[-1]:.6g} s"
                for w in self.rotor[:_SHOWN]
            ),
            *([f"  ... {len(self.rotor) - _SHOWN} more windows"] if len(self.rotor) > _SHOWN else []),
            *(f"  {i!r}" for i in self.inputs[:_SHOWN]),
            *([f"  ... {len(self.inputs) - _SHOWN} more inputs"] if len(self.inputs) > _SHOWN else []),
            *(f"  {m!r}" for m in self.modes[:_SHOWN]),
            *([f"  ... {len(self.modes) - _SHOWN} more error modes"] if len(self.modes) > _SHOWN else []),
            f"  {self.units.note or words}",
        ]
        return "\n".join(lines)

    @cached_property
    def bodies(self) -> tuple[Body, ...]:
        """The bodies: the main body (the casing or the single body), then the other bodies that were measured."""
        names, chain = self.mechanism.bodies, self.is_chain
        role: Role = "body" if chain else _MAIN[bool(self.rotor)]
        name = names[MAIN] if chain else self.name or role
        main = Body(name, role, names[MAIN], MAIN, self.I_casing, self.I_casing_u, (self.casing,))
        others = [main]
        for i, inertia in {
            0: (self.I_rotor, self.I_rotor_u),
            **dict(enumerate(self.further, MAIN + 1)),
        }.items():
            runs = tuple(run for run in self.rotor if run.state == i)
            others.append(Body(names[i], "body" if chain else "rotor", names[i], i, *inertia, runs))
        return tuple(b for b in others if b.series)

    @property
    def is_chain(self) -> bool:
        """Whether the bodies have separate names and joints, unlike a gyroscope or a single body."""
        return self.mechanism != GYROSCOPE

    @property
    def inertias(self) -> tuple[float, ...]:
        """The moments of inertia in the order of the speeds in a state [kg m2]."""
        return (self.I_rotor, self.I_casing, *(value for value, _ in self.further))

    @property
    def parts(self) -> frozenset[str]:
        """The bodies of the library whose laws apply to the motion."""
        return frozenset(b.part for b in self.bodies)

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints between its bodies."""
        return tuple(self.mechanism.joints) if self.rotor else ()

    @property
    def spun(self) -> Body:
        """The body that is spun up or driven: the rotor of a gyroscope, and the fastest body of a chain."""
        largest = self.largest_speeds
        fastest = max(self.bodies, key=lambda b: largest[self.mechanism.speeds[b.state]])
        return fastest if self.is_chain else self.bodies[-1]

    @property
    def single(self) -> bool:
        """Whether the record contains a single body, which is stored as the casing."""
        return not self.rotor

    @property
    def per_inertia(self) -> bool:
        """Whether no moment of inertia is known, so that torques are per unit of inertia."""
        return self.units == WITHOUT_INERTIA

    @property
    def body(self) -> str:
        """Name of the casing: "casing"; for a single body, its name or "body"."""
        return self.bodies[0].name

    @property
    def torque_unit(self) -> str:
        """Unit of torques: "N m", or "rad/s2" per unit of inertia."""
        return self.units.torque

    @property
    def unstated_starts(self) -> bool:
        """Whether the uncertainty of the starts of the rotor windows is not stated."""
        return any(math.isnan(s) for s in self.start_sigma)

    @property
    def driving(self) -> tuple[Input, ...]:
        """The varying inputs that may change the speed or reverse the body; a temperature is not among them."""
        return tuple(i for i in self.inputs if i.varies and i.unit != "K")

    @property
    def span(self) -> tuple[float, float]:
        """The first and the last time of any sample [s]."""
        ends = [(s.time[0], s.time[-1]) for s in (self.casing, *self.rotor)]
        return float(min(a for a, _ in ends)), float(max(b for _, b in ends))

    @cached_property
    def largest_speeds(self) -> dict[str, float]:
        """Largest speed by symbol [rad/s]; for a body that is at rest or not measured, the speed of the fastest body.

        To limit outliers and noise, the quantile 0.95 of mean speeds over a few samples is used. A body counts as at
        rest if noise alone would give a quantile of this size.
        """
        found = {}
        for i, symbol in enumerate(self.mechanism.speeds):
            runs = (self.casing,) if i == MAIN else [run for run in self.rotor if run.state == i]
            found[symbol] = self._largest_speed(runs)
        return {k: v or max(found.values()) or 1.0 for k, v in found.items()}

    def _largest_speed(self, runs: Sequence[Samples]) -> float:
        speeds, noise = [np.zeros(0)], [np.zeros(0)]
        for run in runs:
            rows = np.arange(0, len(run), min(_SPEED_SAMPLES, max(len(run) - 1, 1)))
            if self.quantity == "omega":
                count = np.diff(rows, append=len(run))
                speeds.append(np.add.reduceat(run.value, rows) / count)
                noise.append(run.sigma[rows] / np.sqrt(count))
            else:
                speeds.append(np.diff(run.value[rows]) / np.diff(run.time[rows]))
                noise.append(math.sqrt(2.0) * run.sigma[rows[1:]] / np.diff(run.time[rows]))
        speed = np.abs(np.concatenate(speeds))
        if not len(speed):
            return 0.0
        found = float(np.quantile(speed, _LARGEST_SHARE))
        return found if found > _MOVES * float(np.median(np.concatenate(noise))) else 0.0


# role of the body of the series `casing`, without and with a rotor
_MAIN: tuple[Role, ...] = ("body", "casing")


def scales_of(records: Sequence[Record]) -> tuple[dict[str, float], float]:
    """Return the largest speeds by symbol [rad/s] and the largest length [s] of records."""
    speeds = [r.largest_speeds for r in records]
    return {k: max(s[k] for s in speeds) for k in speeds[0]}, max(float(np.ptp(r.span)) for r in records)


def make_record(
    *,
    casing: tuple[Array, Array, Array],
    rotor: list[tuple[Array, Array, Array]],
    I_rotor: float,
    I_casing: float,
    label: str = "case",
    surface: str = "",
    quantity: Quantity = "angle",
    source: str = "",
    tracked: bool = False,
    single: bool = False,  # noqa: ARG001 - of earlier scripts
    start_sigma: Sequence[float] = (),
    I_rotor_u: float = math.nan,
    I_casing_u: float = math.nan,
    per_inertia: bool = False,
    correlated: Sequence[float] = (),
    correlated_profile: Sequence[tuple[float, float]] = (),
    inputs: Sequence[Input] = (),
    name: str = "",
    modes: Sequence[ErrorMode] = (),
    mechanism: Mechanism = GYROSCOPE,
    states: Sequence[int] = (),
    further: Sequence[tuple[float, float]] = (),
    harmonics: Sequence[float] = (),
) -> Record:
    """Make a record from arrays of (time, value, sigma); samples that are not finite are omitted.

    Parameters
    ----------
    casing : tuple of ndarray, shape (n,)
        Time [s], value [rad or rad/s] and standard uncertainty of the casing, or of the single body.
    rotor : list of tuple of ndarray
        The same for each film of the rotor; empty for one body.
    I_rotor, I_casing : float
        Moments of inertia [kg m2].
    label, surface, source : str
        Name of the recording, surface under the casing, origin of the data.
    quantity : {"angle", "omega"}
        What the values are.
    tracked : bool
        Whether the data come from film.
    single : bool
        Not used: without a film of a rotor, `casing` is the only body.
    start_sigma : sequence of float
        Standard uncertainty of the start of each film of the rotor on the casing's clock [s]; empty if exact, NaN if
        unknown.
    I_rotor_u, I_casing_u : float
        Standard uncertainties of the moments of inertia [kg m2]; NaN if unknown.
    per_inertia : bool
        Whether no moment of inertia is known: it is then 1, and torques are per unit of inertia [rad/s2].
    correlated : tuple of float
        Up to four numbers about errors of the casing's angle; missing numbers are zero. The first two are the standard
        uncertainty [rad] and the correlation time [s] of a slowly varying error. The other two are standard deviations
        of amplitudes [rad]: of an error with one and two periods per turn, and of an error of 1 to 12 periods per turn.
    correlated_profile : sequence of (float, float)
        Times [s] and the standard uncertainty [rad] of the slowly varying error at each of them, between which it is
        linear; empty if it is constant.
    inputs : sequence of Input
        Recorded inputs on which torques may depend, on the same clock.
    name : str
        Name of a single body.
    modes : sequence of ErrorMode
        Errors that samples share.
    mechanism : Mechanism
        The bodies and joints of a chain: `casing` is its second body, and `rotor` are the runs of all other bodies.
    states : sequence of int
        Index in the mechanism of the body of each run of `rotor`; if empty, all runs belong to the first body.
    further : sequence of (float, float)
        Moments of inertia of the third and later bodies of a chain, and their standard uncertainties [kg m2].
    harmonics : sequence of float
        Standard deviation of the amplitudes of an error of 1 to 12 periods per turn of the angle of each run of `rotor`
        [rad]; all are zero if empty.

    Raises
    ------
    RecordError
        If an argument is wrong, too few samples are usable, times are not strictly increasing, or an input does not
        cover the record.
    """
    _refuse_wrong(casing, rotor, quantity)
    chain, names = mechanism != GYROSCOPE, mechanism.bodies
    body = names[MAIN] if chain else _MAIN[bool(rotor)]
    of = list(states) or [0] * len(rotor)
    runs = [_clean(*casing, what=body)]
    errors = [max(0.0, float(h)) for h in harmonics] or [0.0] * len(rotor)
    runs += [
        replace(_clean(*r, what=names[i]), state=i, harmonic=error)
        for r, i, error in zip(rotor, of, errors, strict=True)
    ]
    if len(runs[0]) < _FEWEST_OF_BODY:
        raise RecordError(
            f"{label}: the {body} has {len(runs[0])} usable samples; at least {_FEWEST_OF_BODY} are needed"
        )
    kept = [len(r) >= _FEWEST[quantity] for r in runs[1:]]
    windows = tuple(compress(runs[1:], kept))
    if rotor and not windows:
        raise RecordError(
            f"{label}: no rotor window with at least {_FEWEST[quantity]} usable samples",
            "give at least one rotor clip",
        )
    if chain and not all(kept):
        raise RecordError(
            f"{label}: {names[of[kept.index(False)]]} has a run with fewer than {_FEWEST[quantity]} usable samples",
            "leave it out",
        )
    return Record(
        label, I_rotor, I_casing, runs[0], windows, quantity, surface=surface, source=source, tracked=tracked,
        start_sigma=tuple(compress(map(float, start_sigma), kept)), I_rotor_u=I_rotor_u, I_casing_u=I_casing_u,
        units=(SI, WITHOUT_INERTIA)[per_inertia], correlated=_stated(*correlated),
        correlated_profile=_profile(correlated_profile, stated=any(_stated(*correlated)[:2])),
        inputs=_covering(inputs, runs[0], windows), name="" if windows else name,
        modes=of_windows(checked_modes(modes), kept), mechanism=mechanism, further=tuple(further),
    )  # fmt: skip


def _refuse_wrong(casing: object, rotor: object, quantity: object) -> None:
    """Raise a RecordError for arguments of `make_record` that are not arrays of time, value and sigma."""
    if quantity not in _FEWEST:
        raise RecordError(f"the quantity is {str(quantity)[:20]!r}", f"use {' or '.join(_FEWEST)}")
    if not isinstance(rotor, Iterable):
        raise RecordError(
            "the rotor is not a list of windows", "give a list of (time, value, sigma), empty for one body"
        )
    for what, run in (("casing", casing), *(("rotor window", r) for r in rotor)):
        if not isinstance(run, Sequence) or len(run) != len(("time", "value", "sigma")):
            raise RecordError(
                f"the {what} is not a triple of arrays",
                "give (time, value, sigma); sigma may be NaN where it is unknown",
            )
        try:
            shapes = {np.asarray(a, dtype=float).shape for a in run}
        except (TypeError, ValueError):
            raise RecordError(f"an array of the {what} holds no numbers", "use NumPy arrays") from None
        if len(shapes) > 1 or len(next(iter(shapes))) != 1:
            raise RecordError(
                f"the arrays of the {what} have the shapes {', '.join(map(str, sorted(shapes)))}",
                "use one-dimensional arrays of the same length",
            )


def _covering(inputs: Sequence[Input], casing: Samples, windows: Sequence[Samples]) -> tuple[Input, ...]:
    """Return the inputs of a record; a RecordError if a name occurs twice or an input does not cover the record."""
    if not isinstance(inputs, Iterable) or not all(isinstance(i, Input) for i in inputs):
        raise RecordError("an input is not an Input", 'use fitting.Input("current", time, value, "A")')
    names = [i.name for i in inputs]
    if len(set(names)) < len(names):
        twice = next(n for n in names if names.count(n) > 1)
        raise RecordError(f"there are several inputs named {twice}", "give each a different name")
    first = min(float(run.time[0]) for run in (casing, *windows))
    last = max(float(run.time[-1]) for run in (casing, *windows))
    for i in inputs:
        i.refuse_uncovered(first, last)
    return tuple(i.followed(first, last) for i in inputs)


_UNITS = "check the units of the data"


def _clean(time: Array, value: Array, sigma: Array, *, what: str) -> Samples:
    time, value, sigma = (np.asarray(a, dtype=float) for a in (time, value, sigma))
    keep = np.isfinite(time) & np.isfinite(value)
    time, value, sigma = time[keep], value[keep], sigma[keep]
    if len(time) > 1 and not (np.diff(time) > 0).all():
        raise RecordError(f"the times of the {what} are not strictly increasing")
    good = np.isfinite(sigma) & (sigma > 0)
    size = np.abs(value)
    for numbers in (np.abs(time), size, sigma[good]):
        if numbers.max(initial=0.0) >= LARGEST:
            raise RecordError(f"a number of the {what} exceeds {LARGEST:g} in SI units", _UNITS)
    if 0 < size.max(initial=0.0) < SMALLEST:
        raise RecordError(f"no value of the {what} exceeds {SMALLEST:g} in SI units", _UNITS)
    if not (np.maximum(size[good], SMALLEST) < PRECISION * sigma[good]).all():
        raise RecordError(f"an uncertainty of the {what} is less than {1 / PRECISION:g} of its value", _UNITS)
    # if no uncertainty is known, all samples have the same weight, and the noise level is estimated from the data
    typical = float(np.median(sigma[good])) if good.any() else 1e-3
    return Samples(time, value, np.where(good, sigma, typical))


def _stated(
    sigma: float = 0.0, time: float = 0.0, periodic: float = 0.0, harmonic: float = 0.0
) -> tuple[float, float, float, float]:
    """Return the stated errors; an error without a level or a correlation time is omitted."""
    slow = (sigma, time) if sigma > 0 and time > 0 else (0.0, 0.0)
    return (*slow, max(periodic, 0.0), max(harmonic, 0.0))


def _profile(pairs: Sequence[tuple[float, float]], *, stated: bool) -> tuple[tuple[float, float], ...]:
    """Return a profile with increasing times and non-negative uncertainties."""
    found = tuple((float(t), float(u)) for t, u in pairs)
    times = [t for t, _ in found]
    if found and not stated:
        raise RecordError(
            "a profile of an error has no correlation time", "state `correlated`: uncertainty and time"
        )
    if not all(math.isfinite(x) for pair in found for x in pair):
        raise RecordError("a profile of an error has values that are not finite", "leave them out")
    if any(u < 0 for _, u in found):
        raise RecordError(
            "a profile of an error has a negative uncertainty", "state standard uncertainties [rad]"
        )
    if any(b <= a for a, b in pairwise(times)):
        raise RecordError("the times of a profile of an error do not increase", "sort them")
    return found


def _digest(record: Record) -> str:
    hasher = hashlib.sha256(f"{record.I_rotor!r} {record.I_casing!r} {record.quantity}".encode())
    for samples in (record.casing, *record.rotor):
        for a in (samples.time, samples.value, samples.sigma):
            hasher.update(np.ascontiguousarray(a).tobytes())
    if any(s > 0 for s in record.start_sigma):
        hasher.update(repr(record.start_sigma).encode())
    if any(record.correlated):
        # ledgers of earlier versions do not contain the last of these errors
        stated = record.correlated if record.correlated[3] else record.correlated[:3]
        hasher.update(repr(stated).encode())
    if record.correlated_profile:
        hasher.update(repr(record.correlated_profile).encode())
    uncertainties = (record.I_rotor_u, record.I_casing_u)
    if not all(map(math.isnan, uncertainties)):
        hasher.update(repr(uncertainties).encode())
    for i in record.inputs:
        hasher.update(f"{i.name} {i.unit} {i.interpolation} {i.delay!r}".encode())
        for a in (i.time, i.value, *(() if i.u is None else (i.u,))):
            hasher.update(np.ascontiguousarray(a).tobytes())
    if any(harmonics := [run.harmonic for run in record.rotor]):
        hasher.update(repr(harmonics).encode())
    if record.is_chain:
        states = [run.state for run in record.rotor]
        hasher.update(f"{record.mechanism} {record.further} {states}".encode())
    for m in record.modes:
        hasher.update(f"{m.key} {m.body} {m.window}".encode())
        for a in (m.time, m.basis, m.covariance):
            hasher.update(np.ascontiguousarray(a).tobytes())
    return hasher.hexdigest()


WIDTH = 51
"""Number of points of the running median [samples]. Source: the paper."""
DROPPED = 50
"""Number of points that are dropped at each end of a smoothed curve [samples]. Source: the paper."""
_CHUNK = 1024
"""Number of windows that are sorted together [1]. Chosen: their copies stay in the cache; another value costs time and
does not change the result."""


def speeds(
    samples: Samples, quantity: Quantity, width: int = WIDTH, dropped: int = DROPPED
) -> tuple[Array, Array]:
    """Return times [s] and angular velocities [rad/s]: median of the angle, gradient, median, ends dropped.

    The paper has a `width` of 51 points and drops 50 points at each end. In short runs, at most a tenth of the samples
    is dropped at each end.
    """
    width = median_width(len(samples), width)
    value = samples.value
    if quantity == "angle":
        # the median of a monotonic angle is its middle point, so the median changes only outliers
        value = np.gradient(running_median(value, width), samples.time)
    omega = running_median(value, width)
    cut = min(dropped, len(samples) // 10)
    keep = slice(cut, len(samples) - cut)
    return samples.time[keep], np.asarray(omega[keep])


def median_width(count: int, width: int = WIDTH) -> int:
    """Return the width of the running median of `count` samples: at most a tenth of the samples."""
    return min(width, max(3, count // 10 | 1))


def running_median(value: Array, width: int) -> Array:
    """Return the running median over `width` points (odd); beyond the ends, the end values are repeated."""
    half = width // 2
    padded = np.concatenate([np.full(half, value[0]), value, np.full(half, value[-1])])
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    out = np.empty(len(value))
    for i in range(0, len(value), _CHUNK):
        out[i : i + _CHUNK] = np.partition(windows[i : i + _CHUNK], half, axis=1)[:, half]
    return out


_POINTS = 160
"""Number of approximate speeds of a run [1]. Chosen: with fewer, the motion is blurred; with more, each speed is
noisy."""
_LONG_WINDOW = 0.5
"""A rotor window is divided like the run of the casing if it covers at least this share of the run [1]. Chosen: a
smaller value divides windows in which the speed is nearly constant, a larger one averages a changing speed."""


def initial_speeds(record: Record, points: int = _POINTS, samples: int = 12) -> tuple[Array, Array]:
    """Return times and speeds of the bodies (points, bodies) from local regressions over at least `samples` samples."""
    is_angle = record.quantity == "angle"
    casing = _local(record.casing, min(points, len(record.casing) // samples), is_angle)
    times = np.linspace(*record.span, points)
    found = np.zeros((points, len(record.mechanism.speeds)))
    found[:, MAIN] = np.interp(times, casing[:, 0], casing[:, 1])
    for i in {run.state for run in record.rotor}:
        runs = [run for run in record.rotor if run.state == i]
        windows = [_local(w, _pieces(w, record, points, samples), is_angle) for w in runs]
        found[:, i] = _rotor_curve(np.concatenate(windows), times)
    return times, found


def _pieces(window: Samples, record: Record, points: int, samples: int) -> int:
    """Return the number of regressions in a rotor window: one, unless it covers most of the run."""
    share = (window.time[-1] - window.time[0]) / (record.span[1] - record.span[0])
    return min(round(points * share), len(window) // samples) if share > _LONG_WINDOW else 1


def _local(samples: Samples, count: int, is_angle: bool) -> Array:  # noqa: FBT001
    """Return (time, speed, slope) of equal pieces of a run, from the normal equations of all pieces."""
    pieces = np.array_split(np.arange(len(samples)), max(1, count))
    first = np.array([p[0] for p in pieces])
    size = np.array([len(p) for p in pieces])

    def sums(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, first))

    middle = sums(samples.time) / size
    half = np.maximum(0.5 * (samples.time[first + size - 1] - samples.time[first]), 1e-9)
    x = (samples.time - np.repeat(middle, size)) / np.repeat(half, size)
    y = samples.value - np.repeat(samples.value[first], size)
    rows = np.full((len(first), 3), np.nan)
    rows[:, 0] = middle
    # the lengths of the pieces differ by at most one sample; the shortest piece determines the degree of all pieces
    degree = min(2 if is_angle else 1, int(size.min()) - 1)
    powers = [np.ones(len(x)), x, x * x][: degree + 1]
    gram = np.stack([np.stack([sums(p * q) for q in powers], axis=-1) for p in powers], axis=-1)
    right = np.stack([sums(p * y) for p in powers], axis=-1)
    c = np.linalg.solve(gram, right[..., None])[..., 0]
    c[:, 0] += samples.value[first]
    if is_angle:
        order = np.arange(1, degree + 1)
        rows[:, 1 : degree + 1] = c[:, 1:] / half[:, None] ** order * order
    else:
        rows[:, 1 : degree + 2] = c / half[:, None] ** np.arange(degree + 1)
    return rows


def _rotor_curve(windows: Array, times: Array) -> Array:
    windows = windows[np.argsort(windows[:, 0])]
    t, speed, slope = windows.T
    finite_difference = np.gradient(speed, t) if len(t) > 1 else np.zeros(1)
    slope = np.where(np.isfinite(slope), slope, finite_difference)
    if len(t) == 1:
        curve = speed[0] + slope[0] * (times - t[0])
    else:
        clipped = np.clip(times, t[0], t[-1])
        end_slope = np.where(times < t[0], slope[0], slope[-1])
        curve = hermite(t, speed, slope, clipped) + end_slope * (times - clipped)
    # the rotor does not reverse
    sense = 1.0 if speed.mean() >= 0 else -1.0
    return np.asarray(sense * np.maximum(sense * curve, 0.05 * np.abs(speed).min()))


def hermite(
    t: Array,
    value: Array,
    slope: Array,
    times: Array,
    *,
    slopes: bool = False,
    interval: Indices | None = None,
) -> Array:
    """Evaluate the cubics through values and slopes (n, ...), or with `slopes` their derivatives, at some times.

    `interval` contains the indices of the intervals around the times, if known.
    """
    if interval is None:
        interval = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
    i = interval
    shape = (-1, *[1] * (value.ndim - 1))
    h = (t[i + 1] - t[i]).reshape(shape)
    u = (times - t[i]).reshape(shape) / h
    rise = value[i + 1] - value[i]
    first, last = slope[i] * h - rise, rise - slope[i + 1] * h
    if slopes:
        return np.asarray(
            (rise + (1 - 2 * u) * (first * (1 - u) + last * u) + u * (1 - u) * (last - first)) / h
        )
    return np.asarray(value[i] + u * rise + u * (1 - u) * (first * (1 - u) + last * u))


class PiecewiseCubics:
    """Piecewise least-squares cubics at given times. The numbers of samples of the pieces differ by at most one."""

    def __init__(self, time: Array) -> None:
        self._time = time
        self._known: dict[int, tuple[Array, Indices, Indices]] = {}

    def needed(self, values: Array) -> int:
        """Return the number of pieces with the smallest BIC = N log(residual sum of squares) + 4 pieces log(N).

        G. Schwarz, Ann. Stat. 6, 461 (1978).
        """
        n = len(self._time)
        counts = sorted({max(1, min(c, n // _MIN_PIECE)) for c in _PIECES})
        squares = [float(np.sum((values - self.smooth(values, c)) ** 2)) for c in counts]
        bic = [n * np.log(x + 1e-300) + _CUBIC * c * np.log(n) for x, c in zip(squares, counts, strict=True)]
        return counts[int(np.argmin(bic))]

    def smooth(self, values: Array, pieces: int) -> Array:
        """Return values (n,) smoothed with a given number of pieces."""
        if pieces not in self._known:
            self._known[pieces] = self._basis(pieces)
        basis, first, length = self._known[pieces]
        cubic = np.add.reduceat(basis * values, first, axis=1)
        return np.asarray((basis * np.repeat(cubic, length, axis=1)).sum(axis=0))

    def _basis(self, pieces: int) -> tuple[Array, Indices, Indices]:
        """Return orthonormal cubics (4, n), and the first sample and the number of samples of each piece."""
        n = len(self._time)
        length: Indices = n // pieces + (np.arange(pieces) < n % pieces)
        first: Indices = np.cumsum(length) - length
        last, piece = first + length - 1, np.repeat(np.arange(pieces), length)
        middle = 0.5 * (self._time[first] + self._time[last])
        half = np.maximum(0.5 * (self._time[last] - self._time[first]), 1e-9)
        powers = legvander((self._time - middle[piece]) / half[piece], _CUBIC - 1)
        gram = np.add.reduceat(powers[:, :, None] * powers[:, None, :], first)
        size, vectors = np.linalg.eigh(gram)
        # with fewer than four samples in a piece, some eigenvalues are zero
        inverse = np.where(size > 1e-12 * size[:, -1:], 1 / np.sqrt(np.maximum(size, 1e-300)), 0.0)
        basis = (powers[:, None, :] @ (vectors * inverse[:, None, :])[piece])[:, 0]
        return np.ascontiguousarray(basis.T), first, length
