"""Optimisation of the next run: the initial conditions that best separate rival explanations.

Two rivals a and b are sets of candidates with strengths g_a and g_b. If a is right, a refit of b, with free shared
parameters and strengths, has the expected deviance

    D_ab = g_a' [ I_aa - I_ao I_oo^-1 I_oa ] g_a,       o = parameters and candidates of b.

D_ab is the expected difference of deviance of the two rivals, twice the Kullback-Leibler divergence. I is the
information of all recordings and the planned run (`fitting.discovery._information`).

The criterion of a run is the sum of the gains of two numbers, in natural units of information. The first number is the
logarithm of 1 + D, where D is the smallest D_ab over all ordered pairs of rivals (T-optimality: A. Atkinson, V.
Fedorov, Biometrika 62, 57 (1975)). D counts only up to a clear separation. The second number is the logarithm of the
information about the strength of a candidate, averaged over the candidates; more information lowers the detection
limits.

The search is quasi-random within the bounds, then local with decreasing steps.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting._errors import FittingError
from fitting._numbers import speed, speed_unit
from fitting.discovery._information import MOST_RIVALS, Information, Rival, Run, schur
from fitting.dynamics._collocation import Sampler
from fitting.effects._effect import Effect
from fitting.inference._parameters import parameters_at
from fitting.inference._params import Estimate
from fitting.inference._record import Record
from fitting.inference._result import Fit

Array = NDArray[np.float64]
Progress = Callable[[int, int | None], None]

_RING = 1.5
"""Moment of inertia of the casing with an inertia ring, divided by the present value [1]. Chosen: such a ring is easily
made; a larger value proposes heavy rings, a smaller one gains little information."""
_SURFACE = 3.0
"""Largest ratio of the friction of another surface to the friction of the present surface [1]. Chosen: usual surfaces
differ by about this factor; a larger value proposes unusual surfaces, a smaller one gains little information."""
_APPARATUS_GAIN = 1.5
"""A change of the apparatus is proposed only if it raises the information by at least this factor [1]. Chosen: a
smaller value proposes changes of little use, a larger one hides useful changes."""
_AMPLE = 4.0
"""Upper limit of the separation in the criterion of a run, divided by the square of `Criteria.experiment_sigma` [1].
Chosen: a smaller value accepts a narrow separation, a larger one neglects the detection limits."""
_CAP = 50.0
"""Upper limit of the logarithm of a gain in information in the criterion of a run [1]. Chosen: without the limit, the
gain is infinite for a strength that only this run determines. With a larger value, this strength decides alone; a
smaller one hides differences between runs."""
_RANDOM = 20
"""Largest number of quasi-random runs before the local search [1]. Chosen: with fewer, the local search may start at a
local maximum; with more, fewer runs are left for the local search."""
_FINEST = 0.02
"""Step, as a share of the range between the bounds, at which the local search ends [1]. Chosen: a run cannot be
prepared with finer steps; a larger value loses information."""
_SEPARABLE = 1.0
"""Two rivals count as inseparable if their difference of deviance is below this value in every run [1]. Chosen: one
standard deviation; a smaller value plans runs that decide nothing, a larger one gives up rivals that several runs
separate."""
_ELSE = "change a condition on which only one of them depends (air pressure, surface, lubricant)."


@dataclass(frozen=True)
class Bounds:
    """Bounds of the runs that are possible with this apparatus; each is a pair (smallest, largest)."""

    omega_rotor: tuple[float, float]  #: Initial angular velocity of the rotor [rad s-1].
    #: Initial angular velocity of the casing; negative against the rotor [rad s-1].
    omega_casing: tuple[float, float]
    duration: tuple[float, float]  #: Length of the recording [s].
    #: Moment of inertia of the casing with an inertia ring, divided by the present one [1].
    inertia_casing: tuple[float, float] = (1.0, _RING)
    #: Friction of the support, divided by the present one [1].
    touchpoint: tuple[float, float] = (1 / _SURFACE, _SURFACE)
    reversible: bool = True  #: Whether the rotor can be started in the other sense of rotation.

    @classmethod
    def of(cls, fit: Fit) -> Bounds:
        """Return bounds derived from the recordings of a fit.

        The initial rate of the spun body is between one third and all of its largest recorded rate. The initial rate of
        the other body is at most its largest recorded rate, in either sense of rotation. The duration is between half
        and twice the duration of the longest recording.
        """
        speeds = [d.initial_speeds[1] for d in fit.problem.data]
        spans = [d.record.span for d in fit.problem.data]
        longest = max(b - a for a, b in spans)
        record = fit.problem.data[0].record
        rates = {"rotor": (0.0, 0.0)}
        for body in record.bodies:
            largest = max(float(np.abs(s[:, body.state]).max()) for s in speeds)
            rates[body.part] = (largest / 3 if body is record.spun else -largest, largest)
        return cls(
            rates["rotor"],
            rates["casing"],
            (0.5 * longest, 2.0 * longest),
            reversible=record.spun.role == "rotor",
        )


@dataclass(frozen=True)
class NextRun:
    """The proposed run and its expected information."""

    run: Run
    bounds: Bounds
    rivals: tuple[tuple[str, ...], ...]  # the explanations that the run separates
    separation: (
        float  # smallest expected difference of deviance of two rivals after the run; NaN without rivals
    )
    present: float  # smallest expected difference of deviance without the run
    repeated: float  # smallest expected difference of deviance after one more run like the present runs
    gains: dict[str, float]  # by effect: detection limit after the run, divided by the present limit
    times: Array = field(repr=False)  # times of the predicted motion [s]
    omega_rotor: Array = field(repr=False)  # predicted speed of the rotor [rad/s]
    omega_casing: Array = field(repr=False)  # predicted speed of the casing [rad/s]
    inseparable: tuple[tuple[str, str], ...] = ()  # pairs of rivals that no run within the bounds separates
    sentence: str = ""  # the result in words


class _Criterion:
    """The value of a run, in natural units of information: larger is better."""

    def __init__(
        self,
        information: Information,
        rivals: Sequence[Rival],
        criteria: Criteria,
        ignored: Sequence[tuple[int, int]] = (),
    ) -> None:
        self._all = list(range(information.parameters))
        # parameters that all rivals have in common
        disputed = {k for r in rivals for k in r.columns}
        self._base = [k for k in self._all if k not in disputed]
        self._rivals, self._ignored = rivals, set(ignored)
        self._candidates = [information.places(i) for i in range(len(information.candidates))]
        self._present = information.present
        self._before = np.maximum(self.limits(self._present), 1e-300)
        # a separation above this limit has no further value
        self._enough = _AMPLE * criteria.experiment_sigma**2

    def pairs(self, total: Array) -> dict[tuple[int, int], float]:
        """Return the expected difference of deviance of each ordered pair of rivals."""
        found = {}
        for (i, a), (j, b) in itertools.permutations(enumerate(self._rivals), 2):
            own = [k for k in a.columns if k not in b.columns]
            strengths = a.strengths[[k not in b.columns for k in a.columns]]
            if own:
                found[i, j] = float(strengths @ schur(total, own, [*self._base, *b.columns]) @ strengths)
        return found

    def separation(self, total: Array) -> float:
        """Return the smallest difference of deviance of pairs of rivals that are not ignored; NaN if there is none."""
        values = [v for k, v in self.pairs(total).items() if k not in self._ignored]
        return min(values, default=math.nan)

    def limits(self, total: Array) -> Array:
        """Return the information about the strength of each single candidate, averaged over its columns."""
        traces = [float(np.trace(schur(total, places, self._all))) for places in self._candidates]
        return np.array(traces) / [len(places) for places in self._candidates]

    def __call__(self, total: Array) -> float:
        after = np.maximum(self.limits(total), 1e-300)
        value = float(np.mean(np.minimum(np.log(after / self._before), _CAP)))
        if not self._rivals:
            return value
        # a separation of zero may be slightly negative because of rounding errors
        now, then = (max(0.0, min(self.separation(x), self._enough)) for x in (self._present, total))
        return value + math.log((1 + then) / (1 + now)) if math.isfinite(then) else value


def next_run(
    information: Information,
    rivals: Sequence[Rival],
    criteria: Criteria,
    bounds: Bounds,
    *,
    evaluations: int = 60,
    progress: Progress | None = None,
) -> NextRun | None:
    """Return the run within the bounds that best separates the rivals or, without rivals, lowers detection limits most.

    At most `evaluations` runs within the bounds are simulated; None if no run can be simulated. `progress` is called
    with the number of simulated runs and their total number.
    """
    search = _RunSearch(information, rivals, criteria, bounds, evaluations, progress)
    search.explore()
    if not search.tried:
        return None
    search.refine()
    search.vary_apparatus()
    return search.result()


_FEW = 24
"""Number of simulated runs of a search that is part of a diagnosis [1]. Chosen: a smaller number gives a worse
proposal, a larger one delays the diagnosis."""


def separating_run(
    fit: Fit, explanations: Sequence[tuple[str, Sequence[Effect], Mapping[str, Estimate]]], criteria: Criteria
) -> str:
    """Return the run that best separates rival explanations, in words; empty for fewer than two explanations.

    An explanation consists of its name, its effects, and their parameters by ``<effect>.<symbol>``. Laws of an angle
    are ignored.
    """
    smooth = [x for x in explanations if not any(e.depends_on_angle for e in x[1])][:MOST_RIVALS]
    if len(smooth) < 2:
        return ""
    if len(fit.problem.data[0].motion.reversals):
        # a planned run starts with given speeds, but an oscillation starts with a release from an angle
        restoring = [x for x in smooth if any(e.restoring for e in x[1])]
        return _LARGER_AMPLITUDE if len(restoring) > 1 else ""
    if fit.model.rigid_contact is not None or fit.problem.data[0].record.is_chain:
        # the initial speeds of bodies in contact are not independent; runs of a chain are not planned
        return ""
    records = fit.problem.layout.records
    terms = [(e, _mean_values(e, estimates, records)) for _, effects, estimates in smooth for e in effects]
    information = Information(
        fit, [(e, {p.symbol: v[p.symbol] for p in e.parameters if p.role == "shape"}) for e, v in terms]
    )
    alternatives, first = [], 0
    for name, effects, _ in smooth:
        places = [k for i in range(first, first + len(effects)) for k in information.places(i)]
        strengths = [g for e, v in terms[first : first + len(effects)] for g in _strengths(e, v)]
        alternatives.append(Rival((name,), tuple(places), np.array(strengths)))
        first += len(effects)
    found = next_run(information, alternatives, criteria, Bounds.of(fit), evaluations=_FEW)
    return "" if found is None else found.sentence


_LARGER_AMPLITUDE = (
    "Release the body from a larger angle: there the restoring torques of these laws differ more."
)


def _mean_values(
    effect: Effect, estimates: Mapping[str, Estimate], records: Sequence[Record]
) -> dict[str, float]:
    """Return the parameters of an effect by symbol; for per-case values, the mean over the cases."""
    values = {}
    for key, p in parameters_at([effect], records).items():
        own = [e.value for k, e in estimates.items() if k.partition("@")[0] == key]
        values[p.symbol] = float(np.mean(own)) if own else p.start
    return values


def _strengths(effect: Effect, values: Mapping[str, float]) -> list[float]:
    """Return the strength, or the sine and cosine strengths of a law with a phase."""
    role = {p.role: p.symbol for p in effect.parameters}
    k = values[role["amplitude"]]
    if "phase" not in role:
        return [k]
    return [k * math.cos(values[role["phase"]]), k * math.sin(values[role["phase"]])]


class _Tried(NamedTuple):
    """A simulated run: value, point in the unit cube, sense of rotation (+1 or -1), settings, information, and fit."""

    value: float
    x: Array
    sense: float
    run: Run
    added: Array
    planned: Fit


class _RunSearch:
    """The search for the next run; `tried` are the runs that could be simulated."""

    def __init__(
        self,
        information: Information,
        rivals: Sequence[Rival],
        criteria: Criteria,
        bounds: Bounds,
        evaluations: int,
        progress: Progress | None,
    ) -> None:
        self._information, self._rivals, self._bounds = information, rivals, bounds
        self._criteria, self._evaluations, self._progress = criteria, evaluations, progress
        data = information.fit.problem.data
        windows = data[0].record.rotor
        self._windows = len(windows)
        self._length = float(np.median([w.time[-1] - w.time[0] for w in windows])) if windows else 0.0
        self._start = float(data[0].initial_speeds[1][0, 1])
        self._criterion = _Criterion(information, rivals, criteria)
        self._inseparable: list[tuple[int, int]] = []
        self.tried: list[_Tried] = []
        self._count = 0

    @property
    def _best(self) -> _Tried:
        return max(self.tried, key=lambda t: t.value)

    def _run(self, x: Array, sense: float) -> Run:
        """Return the run of a point of the unit cube."""
        b = self._bounds
        rotor, casing, duration = (
            low + share * (high - low)
            for share, (low, high) in zip(x[:3], (b.omega_rotor, b.omega_casing, b.duration), strict=True)
        )
        length = min(self._length, duration / max(self._windows, 1))
        free = duration - self._windows * length
        starts = [float(s * free + i * length) for i, s in enumerate(np.sort(x[3:]))]
        return Run(float(sense * rotor), float(casing), float(duration), tuple(starts), float(length))

    def _try(self, x: Array, sense: float, run: Run) -> _Tried | None:
        self._count += 1
        if self._progress is not None:
            self._progress(min(self._count, self._evaluations), self._evaluations)
        try:
            added, planned = self._information.of_run(run)
        except (FittingError, np.linalg.LinAlgError):
            return None
        if not np.isfinite(added).all():
            return None
        return _Tried(self._criterion(self._information.present + added), x, sense, run, added, planned)

    def _keep(self, x: Array, sense: float) -> None:
        found = self._try(x, sense, self._run(x, sense))
        if found is not None:
            self.tried.append(found)

    def explore(self) -> None:
        """Try usual and quasi-random runs; then exclude the pairs of rivals that none of these runs separates."""
        from scipy.stats import qmc

        b = self._bounds
        low, high = b.omega_casing
        usual = float(np.clip((self._start - low) / max(high - low, 1e-300), 0.0, 1.0))
        corners = [(1.0, usual), (0.5, usual), (1.0, 1.0), (1.0, 0.0)]
        count = max(4, min(_RANDOM, self._evaluations // 3))
        points = [*(np.array([*c, 0.5]) for c in corners), *qmc.Sobol(3, seed=1).random(32)[:count]]
        shares = np.linspace(0.03, 0.97, self._windows) if self._windows > 1 else np.full(self._windows, 0.03)
        for i, p in enumerate(points):
            # every third of the quasi-random runs is reversed, if the apparatus allows it
            reversed_ = b.reversible and i >= len(corners) and i % 3 == 2
            self._keep(np.concatenate([p, shares]), -1.0 if reversed_ else 1.0)
        if self._rivals and self.tried:
            present = self._information.present
            pairs = [self._criterion.pairs(present + t.added) for t in self.tried]
            self._inseparable = [k for k in pairs[0] if max(p[k] for p in pairs) < _SEPARABLE]
            self._criterion = _Criterion(self._information, self._rivals, self._criteria, self._inseparable)
            self.tried = [t._replace(value=self._criterion(present + t.added)) for t in self.tried]

    def refine(self) -> None:
        """Vary the settings of the best run one by one, with decreasing steps."""
        best, step = self._best, 0.25
        random = np.random.default_rng(3)
        while self._count < self._evaluations and step > _FINEST:
            for k, sign in itertools.product(random.permutation(len(best.x)), (1.0, -1.0)):
                other = best.x.copy()
                other[k] = np.clip(other[k] + sign * step, 0.0, 1.0)
                if other[k] != best.x[k] and self._count < self._evaluations:
                    self._keep(other, best.sense)
            step *= 1.0 if self._best is not best else 0.5
            best = self._best

    def vary_apparatus(self) -> None:
        """Try the best run with an inertia ring and on other surfaces.

        A change of the apparatus is kept if it raises the information by the factor `_APPARATUS_GAIN`.
        """
        best = self._best
        rings = [replace(best.run, ring=r) for r in self._bounds.inertia_casing if r != 1.0]
        surfaces = [replace(best.run, surface=r) for r in self._bounds.touchpoint if r != 1.0]
        for run in dict.fromkeys((*rings, *surfaces)):
            found = self._try(best.x, best.sense, run)
            if found is not None and found.value > best.value + math.log(_APPARATUS_GAIN):
                self.tried.append(found)

    def result(self) -> NextRun:
        best, info = self._best, self._information
        run, present, total = best.run, info.present, info.present + best.added
        cases = len(info.fit.problem.cases)
        repeated = present * (cases + 1) / cases
        before, after = self._criterion.limits(present), self._criterion.limits(total)
        gains = {
            e.name: float(math.sqrt(b / a)) if a > 0 else math.nan
            for (e, _), a, b in zip(info.candidates, after, before, strict=True)
        }
        path = best.planned.predictions[0].path
        times = np.linspace(0.0, run.duration, 400)
        y = Sampler(path.mesh, times).value(path.y)
        names = [r.names for r in self._rivals]
        pairs = dict.fromkeys(tuple(sorted(pair)) for pair in self._inseparable)
        found = NextRun(
            run, self._bounds, tuple(names), self._criterion.separation(total), self._criterion.separation(present),
            self._criterion.separation(repeated), gains, times, y[:, 0], y[:, 1],
            tuple((" + ".join(names[i]), " + ".join(names[j])) for i, j in pairs),
        )  # fmt: skip
        return replace(found, sentence=_sentence(found, info.fit, self._criteria))


def _start_of_body(run: Run, _fit: Fit) -> str:
    return f"start at {speed(run.omega_casing):.3g} {speed_unit()}"


def _start_of_rotor(run: Run, _fit: Fit) -> str:
    sense = " in the other sense of rotation" if run.omega_rotor < 0 else ""
    return f"start the rotor at {abs(speed(run.omega_rotor)):.0f} {speed_unit()}{sense}"


def _start_of_casing(run: Run, fit: Fit) -> str:
    usual = max(abs(float(d.initial_speeds[1][0, 1])) for d in fit.problem.data)
    casing, unit = speed(run.omega_casing), speed_unit()
    if abs(run.omega_casing) > 1.5 * usual + 1.0:
        against = "against" if run.omega_casing * run.omega_rotor < 0 else "with"
        return f"spin the casing by hand to {abs(casing):.0f} {unit} {against} the rotor"
    return f"start the casing at {casing:.1f} {unit}"


# by role of a body: its start in words, and the word for its support
_STARTS = {"rotor": _start_of_rotor, "casing": _start_of_casing, "body": _start_of_body}
_GROUND = {"casing": "surface", "body": "support"}


def _sentence(found: NextRun, fit: Fit, criteria: Criteria) -> str:
    run, record = found.run, fit.problem.data[0].record
    parts = [_STARTS[body.role](run, fit) for body in reversed(record.bodies)]
    parts.append(f"record for {run.duration:.0f} s")
    if run.windows:
        starts = ", ".join(f"{w:.0f} s" for w in run.windows)
        parts.append(f"film the rotor for {run.window_length:.1f} s from {starts}")
    if run.ring != 1.0:
        parts.append(
            f"fix a ring to the {record.body} that makes its moment of inertia {run.ring:.1f} times as large"
        )
    if run.surface != 1.0:
        parts.append(f"use a {_GROUND[record.bodies[0].role]} with {run.surface:.1f} times the friction")
    plan = "; ".join(parts)
    what = f"{plan[0].upper()}{plan[1:]}."
    if not found.rivals:
        ratio = [g for g in found.gains.values() if np.isfinite(g)]
        factor = float(np.exp(np.mean(np.log(np.maximum(ratio, 1e-6))))) if ratio else math.nan
        return f"{what} This run lowers the detection limits to {100 * factor:.0f} % (geometric mean)."
    if not math.isfinite(found.separation):
        return f"No run within the bounds separates the rivals: {_ELSE}"
    sigma, now, again = (math.sqrt(max(x, 0.0)) for x in (found.separation, found.present, found.repeated))
    expected = (
        f"Expected separation of the closest rivals {sigma:.1f} sigma "
        f"(now {now:.1f}; {again:.1f} after a repetition)."
    )
    if sigma < criteria.experiment_sigma:
        expected += f" This is less than {criteria.experiment_sigma:.0f} sigma: repeat the run, or {_ELSE}"
    if found.inseparable:
        a, b = found.inseparable[0]
        expected += f" No run within the bounds separates {a} from {b}."
    return f"{what} {expected}"
