"""Detection limits and power of recordings, and the next run.

The recordings are given as a fit or as a description. Three results are computed in order: the power of the search for
a missing effect, the rival explanations that the recordings do not separate, and the next run.

The recordings are either measured, and a model is fitted to them, or described in a TOML file and simulated::

    model = "reduced"

    [inertia]                      # kg m2
    rotor = 5.54e-5
    casing = 2.06e-5

    [parameters]                   # SI, every parameter of the model
    "rotor.air.quadratic.a2" = 1.0e-10
    ...

    [noise] angle = 1e-3                   # rad, of each frame torque = 1e-7                  # N m rms, random torque;
    0 for none torque_time = 1.0              # s, correlation time of the torque

    [[run]]
    omega_rotor = 900.0            # rad/s at the start
    omega_casing = 5.0
    duration = 200.0               # s
    casing_fps = 260.0             # frames per second
    rotor_fps = 1000.0
    windows = [5.0, 70.0, 150.0]   # s, start of each film of the rotor
    window_length = 3.0            # s

    [bounds]                       # optional: smallest and largest value for the next run
    omega_rotor = [300.0, 900.0]

Only the bounds are optional. All other values must be given, because detection limits depend on them.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import wrap
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fitting._criteria import DEFAULT, Criteria
from fitting._errors import EstimationError, FittingError
from fitting._numbers import on_screen
from fitting._workers import single_blas_thread
from fitting.discovery._information import Information, rivals
from fitting.discovery._next_run import Bounds, NextRun, next_run
from fitting.discovery._power import EffectLimits, Search
from fitting.dynamics._model import Model
from fitting.effects._effect import Effect
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit as fit_model
from fitting.inference._fit import measured_with
from fitting.inference._process_noise import ProcessNoise
from fitting.inference._record import Record
from fitting.inference._result import Fit
from fitting.inference._simulation import Experiment, simulate

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Pair = tuple[Finite, Finite]

_SEED = 1
"""Seed of simulated runs [1]. Chosen: any value makes a plan reproducible; another seed changes limits within their
error."""
_LARGEST = 1_000_000
"""Longest text of a plan [characters]. Chosen: a limit of memory; a larger value admits malicious files, a smaller one
refuses long descriptions."""
_EXAMPLE = "The guide docs/how-to/plan-an-experiment.md has a complete example."


_SHOWN = 8
"""Number of effects in a repr [1]. Chosen: a smaller number hides detection limits, a larger one fills the console."""
_WIDTH = 100
"""Width of a sentence in a repr [characters]. Chosen: it fits into usual consoles; a larger width wraps there, a
smaller one needs more lines."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=False)


class _Inertia(_Table):
    rotor: Positive
    casing: Positive


class _NoiseTable(_Table):
    angle: Positive
    torque: NotNegative
    torque_time: Positive


class _RunTable(_Table):
    omega_rotor: Finite
    omega_casing: Finite
    duration: Positive
    casing_fps: Positive
    rotor_fps: Positive
    windows: Annotated[list[NotNegative], Field(min_length=1)]
    window_length: Positive


class _BoundsTable(_Table):
    omega_rotor: Pair | None = None
    omega_casing: Pair | None = None
    duration: Pair | None = None
    inertia_casing: Pair | None = None
    touchpoint: Pair | None = None
    reversible: bool | None = None


class _PlanTable(_Table):
    model: str | list[str]
    inertia: _Inertia
    parameters: dict[str, Finite]
    noise: _NoiseTable
    run: Annotated[list[_RunTable], Field(min_length=1)]
    bounds: _BoundsTable = _BoundsTable()


@dataclass(frozen=True)
class PlannedRecordings:
    """Planned recordings of an apparatus."""

    model: Model  # the friction model of the apparatus
    numbers: dict[str, float]  # every parameter [SI]
    inertias: tuple[float, float]  # moments of inertia of rotor and casing [kg m2]
    experiments: tuple[Experiment, ...]  # the runs
    given: dict[str, Any]  # bounds of the next run, if the file contains them

    def fit(self, simulation: int = 0, criteria: Criteria = DEFAULT) -> Fit:
        """Simulate the recordings with the random numbers of one simulation, and fit the model to them."""
        records = self._records(simulation)
        start = {k: self.numbers[k] for k in self.model.free} if len(records) == 1 else {}
        return fit_model(self.model, records, start=start, criteria=criteria)

    def process_noise(self, simulation: int, criteria: Criteria = DEFAULT) -> tuple[ProcessNoise, ...]:
        """Simulate the recordings, and return the estimate of the process noise of each recording."""
        return tuple(CaseData.of(r, criteria).process_noise for r in self._records(simulation))

    def _records(self, simulation: int) -> list[Record]:
        return [
            simulate(
                self.model,
                self.numbers,
                e,
                inertia_rotor=self.inertias[0],
                inertia_casing=self.inertias[1],
                seed=_SEED + i + 1000 * simulation,
                label=f"run {i + 1}",
            )
            for i, e in enumerate(self.experiments)
        ]

    @property
    def bounds(self) -> Bounds:
        """Bounds of the next run from the file; bounds that are not in the file are derived from the planned runs."""
        rotor = max(abs(e.omega_rotor) for e in self.experiments)
        longest = max(e.duration for e in self.experiments)
        casing = max(abs(e.omega_casing) for e in self.experiments)
        hand = max(casing, 0.15 * rotor)
        usual = Bounds((rotor / 3, rotor), (-hand, hand), (0.5 * longest, 2.0 * longest))
        return replace(usual, **self.given)


def read_planned(path: str | Path) -> PlannedRecordings:
    """Read the description of recordings in a TOML file (format: docstring of the module).

    If the description is not valid, an EstimationError names the key that is missing, unknown or out of range, or the
    window that ends after the recording.
    """
    name = Path(path).name
    try:
        text = Path(path).read_bytes()
        if len(text) > _LARGEST:
            raise EstimationError(f"{name} is larger than 1 MB and is not a plan.", _EXAMPLE)
        table = _PlanTable.model_validate(tomllib.loads(text.decode("utf-8")))
    except (OSError, UnicodeDecodeError) as fault:
        reason = fault.strerror if isinstance(fault, OSError) else "it is not UTF-8 text"
        raise EstimationError(f"{name} cannot be read: {reason}.", "Give a plan in TOML.") from None
    except ValidationError as fault:
        raise EstimationError(f"{name}: {_first_error(fault)}.", _EXAMPLE) from None
    except (
        ValueError,
        RecursionError,
    ) as fault:  # a number with thousands of digits also raises a ValueError
        raise EstimationError(f"{name} is not valid TOML: {fault}.", _EXAMPLE) from None
    model = _model(table.model, name)
    _check_parameters(model, table.parameters, name)
    experiments = []
    for i, run in enumerate(table.run, 1):
        late = [w for w in run.windows if w + run.window_length > run.duration]
        if late:
            raise EstimationError(
                f"{name}: run {i}: the window from {late[0]:g} s to {late[0] + run.window_length:g} s ends after the "
                f"recording ({run.duration:g} s).",
                "Move the window or record for longer.",
            )
        if run.duration * run.casing_fps < 60 or run.window_length * run.rotor_fps < 8:
            raise EstimationError(
                f"{name}: run {i} has too few frames.",
                "A recording needs 60 frames of the casing and 8 of the rotor in each window.",
            )
        if run.duration * max(run.casing_fps, run.rotor_fps) > 1e7:
            raise EstimationError(
                f"{name}: run {i} has more than 10 million frames.", "Check duration and frame rates."
            )
        if run.omega_rotor == 0 and run.omega_casing == 0:
            raise EstimationError(
                f"{name}: in run {i} both initial speeds are zero.", "Give omega_rotor or omega_casing."
            )
        experiments.append(
            Experiment(
                **run.model_dump(exclude={"windows"}),
                windows=tuple(run.windows),
                sigma=table.noise.angle,
                torque_noise=table.noise.torque,
                torque_time=table.noise.torque_time,
            )
        )
    given = {k: v for k, v in table.bounds.model_dump().items() if v is not None}
    for key, pair in given.items():
        if isinstance(pair, tuple) and pair[0] > pair[1]:
            raise EstimationError(
                f"{name}: bounds.{key}: {pair[0]:g} is larger than {pair[1]:g}.", "Give (smallest, largest)."
            )
        if key in {"duration", "inertia_casing", "touchpoint"} and pair[0] <= 0:
            raise EstimationError(
                f"{name}: the lower bound of bounds.{key} is not positive.", "Give a positive lower bound."
            )
    return PlannedRecordings(
        model, dict(table.parameters), (table.inertia.rotor, table.inertia.casing), tuple(experiments), given
    )


def _model(names: str | list[str], file: str) -> Model:
    try:
        model = Model.of(names)
    except FittingError as fault:
        raise EstimationError(f"{file}: model: {fault.message}", fault.hint) from None
    if model.measurement:
        raise EstimationError(
            f"{file}: {model.measurement[0].name} is an effect of the measurement.",
            "Remove it: the model of a plan may contain only torques.",
        )
    return model


def _check_parameters(model: Model, given: Mapping[str, float], file: str) -> None:
    missing = [k for k in model.free if k not in given]
    if missing:
        raise EstimationError(
            f"{file}: parameters: no value of {', '.join(missing)}.",
            "Give every parameter of the model, in SI units.",
        )
    unknown = [k for k in given if k not in model.free]
    if unknown:
        raise EstimationError(
            f"{file}: parameters: {unknown[0]!r} is not a parameter of the model.",
            f"It has: {', '.join(model.free)}.",
        )
    for key, value in given.items():
        p = model.parameters[key]
        # the bounds of such a parameter are in units of the speed or length of a recording, so only its sign is checked
        if p.scale:
            p = replace(p, lower=0.0, upper=math.inf)
        if not p.lower <= value <= p.upper or math.isnan(value):
            raise EstimationError(
                f"{file}: parameters: {key} = {value:g} is outside {p.lower:g} to {p.upper:g}.", ""
            )


def _first_error(fault: ValidationError) -> str:
    error = fault.errors()[0]
    # tables of a list are counted from 1
    place = ".".join(str(p + 1) if isinstance(p, int) else str(p) for p in error["loc"])
    if error["type"] == "missing":
        return f"{place} is missing"
    if error["type"] == "extra_forbidden":
        return f"{place} is an unknown key"
    message = str(error["msg"])
    return f"{place}: {message[0].lower()}{message[1:]}"


Progress = Callable[[int, int | None], None]

_EVALUATIONS = 60
"""Number of runs that the search for the next run evaluates [1]. Chosen: a smaller number may omit the best run, a
larger one costs time."""
_SIMULATIONS = 2
"""Number of simulations of described recordings over which the power is averaged [1]. Chosen: a smaller number makes
the limits depend on the noise of one simulation, a larger one costs time."""
_ESTIMATES = 8
"""Number of further simulations, from which only the process noise is estimated [1]. Chosen: the threshold of a
significant score depends on the estimated process noise, which varies between simulations; with fewer estimates, the
limits depend on a single one; with more, the plan takes longer."""


@dataclass(frozen=True, repr=False)
class Plan:
    """Detection limits and power of some recordings, and the next run."""

    fit: Fit  # fit to the recordings, which are measured or simulated
    planned: bool  # True if the recordings are described, False if measured
    size: float  # rms torque of an effect [N m] to which `power` and `runs_needed` refer
    effects: tuple[EffectLimits, ...]  # limits of each effect, in ascending order of the detection limit
    classes: tuple[tuple[str, ...], ...]  # sets of effects that these recordings would not separate
    next_run: NextRun | None  # proposed run; None if no run can be simulated
    warning: str = field(
        default=""
    )  # reason why the limits are restricted or unreliable; empty if there is none

    def __repr__(self) -> str:
        unit = self.fit.torque_unit
        head = f"plan: {len(self.effects)} effects, for an rms torque of {self.size:.3g} {unit}"
        lines = [head, *wrap(self.warning, _WIDTH)]
        lines += [
            f"  {e.effect.name}.{e.strength}: detection limit {e.detection_limit:.3g} {e.unit}"
            for e in self.effects[:_SHOWN]
        ]
        if len(self.effects) > _SHOWN:
            lines.append(f"  ... {len(self.effects) - _SHOWN} more")
        lines += [] if self.next_run is None else wrap(f"next run: {self.next_run.sentence}", _WIDTH)
        return on_screen(lines)


@single_blas_thread()
def plan(
    recordings: Fit | str | Path,
    extra: Sequence[Effect] = (),
    *,
    size: float | None = None,
    bounds: Bounds | None = None,
    criteria: Criteria | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Return detection limit, upper limit and power for every effect, and the most informative next run.

    Parameters
    ----------
    recordings : Fit, str or Path
        A fit to measured recordings, or a TOML file that describes planned recordings.
    extra : sequence of Effect
        Effects of the user, in addition to the library.
    size : float, optional
        Rms torque of an effect [N m] for `power` and `runs_needed`; by default 1 % of the rms torque of the bearing
        (for a single body, of the net torque).
    bounds : Bounds, optional
        Smallest and largest values for the next run; by default the values of the file, or values derived from the
        recordings.
    criteria : Criteria, optional
        Thresholds of the search whose power is computed; by default the criteria of the fit.
    progress : callable, optional
        Called with the number of steps done and the total number.

    Returns
    -------
    Plan

    Raises
    ------
    FittingError
        If the description is not valid, the size is not positive, the body oscillates about an equilibrium, or the
        bodies roll on each other.
    """
    if size is not None and not 0 < size < np.inf:
        raise EstimationError(f"the size of the effect is {size:g} N m", "give a positive rms torque in N m")
    planned = not isinstance(recordings, Fit)
    truth: dict[str, float] = {}
    process: list[tuple[ProcessNoise, ...]] = []
    if isinstance(recordings, Fit):
        recordings.model.refuse_chain(
            "a plan",
            "gyrotrack diagnose states upper limits of the torques that the recording may still contain",
        )
        if len(recordings.problem.data[0].motion.reversals):
            raise EstimationError(
                "a plan needs runs that start at given speeds, but this body oscillates about an equilibrium",
                "release it from a larger angle, or record it for longer: both separate restoring torques better",
            )
        if recordings.model.rigid_contact is not None:
            raise EstimationError(
                "a plan needs independent initial speeds, but these bodies roll on each other",
                "plan the run of each body alone, from its own study",
            )
        criteria = criteria or recordings.criteria
        fit = measured_with(recordings, criteria)
        fits = [fit]
    else:
        criteria = criteria or DEFAULT
        described = read_planned(recordings)
        fits = [described.fit(i, criteria) for i in range(_SIMULATIONS)]
        fit, bounds, truth = fits[0], bounds or described.bounds, described.numbers
        process = [described.process_noise(_SIMULATIONS + i, criteria) for i in range(_ESTIMATES)]
    report = progress or (lambda done, total: None)  # noqa: ARG005
    search, *others = (Search(f, extra, criteria, truth=truth, process=process) for f in fits)
    total = len(search.effects) + _EVALUATIONS
    found = []
    for i, effect in enumerate(search.effects):
        report(i, total)
        found.append(search.limits(effect, size, planned=planned, others=others))
    found.sort(key=lambda e: (not np.isfinite(e.detection_limit), np.isnan(e.torque), e.detection_torque))
    limits = {e.effect.name: e for e in found}
    scores = search.scores()
    information = Information(
        fit, [(e, scores[e.name].shape) for e in search.effects if not limits[e.name].absorbed]
    )
    significant = [s.threshold for s in scores.values()]
    alternatives = [] if planned else rivals(information, significant, criteria)
    proposed = next_run(
        information,
        alternatives,
        criteria,
        bounds or Bounds.of(fit),
        evaluations=_EVALUATIONS,
        progress=lambda done, all_: report(total - (all_ or 0) + done, total),
    )
    used = size if size is not None else search.default_size
    return Plan(fit, planned, used, tuple(found), _classes(found), proposed, _warning(fit, criteria))


def _classes(found: Sequence[EffectLimits]) -> tuple[tuple[str, ...], ...]:
    """Return the connected components of indistinguishable effects, as names in the order of the effects."""
    groups: list[set[str]] = []
    for e in found:
        if not e.indistinguishable_from:
            continue
        joined = {e.effect.name, *e.indistinguishable_from}
        separate = [g for g in groups if not g & joined]
        for g in groups:
            if g & joined:
                joined |= g
        groups = [*separate, joined]
    order = [e.effect.name for e in found]
    return tuple(tuple(sorted(g, key=order.index)) for g in groups)


def _warning(fit: Fit, criteria: Criteria) -> str:
    if not fit.converged:
        return "The fit has not converged: the limits are not reliable."
    if fit.fails(criteria):
        return (
            "The model has a significant lack of fit: the limits are valid only for a model without lack of fit. "
            "Run `gyrotrack improve` first."
        )
    return ""
