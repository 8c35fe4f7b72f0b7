"""The next run, optimised: the initial conditions that tell most about rival explanations.

Of two rivals a and b, sets of candidates with strengths g_a and g_b, the information that b leaves of a after a refit
of the shared parameters and of its own strengths is

    D_ab = g_a' [ I_aa - I_ao I_oo^-1 I_oa ] g_a,       o = parameters and candidates of b,

the expected difference of deviance (twice the Kullback-Leibler divergence) between the two, with the information I of
all recordings and the planned run (`fitting.discovery._information`). The criterion of a run is the smallest D over all
ordered pairs of rivals (T-optimality: A. Atkinson, V. Fedorov, Biometrika 62, 57 (1975)). Without rivals it is the mean
logarithm of the information about each candidate's strength: the mean gain in detection limits.

The search is quasi-random over the bounds, then local with shrinking steps.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fitting._errors import FittingError
from fitting.discovery._criteria import Criteria
from fitting.discovery._information import Information, Run, schur
from fitting.discovery._rivals import MOST_RIVALS, Rival
from fitting.dynamics._mesh import Sampler
from fitting.effects._effect import Effect
from fitting.inference._result import Estimate, Fit

Array = NDArray[np.float64]
Progress = Callable[[int, int | None], None]

# moment of inertia of a casing with an inertia ring over the present one
_RING = 1.5
# a ring is proposed if it is worth as much as so many runs
_WORTH = 1.5
# largest logarithm of a gain in information that counts
_CAP = 50.0
_RANDOM = 20
_ELSE = "change what only one of them depends on (air pressure, surface, lubricant)."


@dataclass(frozen=True)
class Bounds:
    """What a run of this apparatus can be; each a pair (smallest, largest).

    Attributes
    ----------
    omega_rotor : tuple of float
        Initial angular rate of the rotor [rad/s].
    omega_casing : tuple of float
        Initial angular rate of the casing, spun by hand [rad/s]; negative against the rotor.
    duration : tuple of float
        Duration of the recording [s].
    inertia_casing : tuple of float
        Moment of inertia of the casing over the present one, with an inertia ring.
    reversible : bool
        The rotor can be started in the other sense of rotation.
    """

    omega_rotor: tuple[float, float]
    omega_casing: tuple[float, float]
    duration: tuple[float, float]
    inertia_casing: tuple[float, float] = (1.0, _RING)
    reversible: bool = True

    @classmethod
    def of(cls, fit: Fit) -> Bounds:
        """Return bounds within what the recordings of a fit have shown to be possible.

        The rotor starts at a third of its largest recorded rate at least and at this rate at most; a hand spins the
        casing to the largest recorded rate of the casing in either sense; a recording takes between half and twice the
        longest one.
        """
        speeds = [d.initial_speeds[1] for d in fit.problem.data]
        spans = [d.record.span for d in fit.problem.data]
        rotor = max(float(np.abs(s[:, 0]).max()) for s in speeds)
        casing = max(float(np.abs(s[:, 1]).max()) for s in speeds)
        longest = max(b - a for a, b in spans)
        single = fit.problem.data[0].record.single
        return cls(
            (0.0, 0.0) if single else (rotor / 3, rotor),
            (casing / 3, casing) if single else (-casing, casing),
            (0.5 * longest, 2.0 * longest),
            reversible=not single,
        )


@dataclass(frozen=True)
class NextRun:
    """The proposed run and what it is expected to tell.

    Attributes
    ----------
    run : Run
        Initial conditions.
    bounds : Bounds
        The bounds within which it was sought.
    rivals : tuple of tuple of str
        The explanations that it separates; empty if there are none.
    separation : float
        Smallest expected difference of deviance between two rivals after this run; NaN without rivals.
    present : float
        The same without it.
    repeated : float
        The same after a repetition of the most informative run at hand.
    gains : dict of str to float
        By effect, detection limit after the run over the present one.
    times, omega_rotor, omega_casing : ndarray
        The predicted motion [s, rad/s].
    inseparable : tuple of tuple of str
        Pairs of rivals that no run within the bounds separates.
    sentence : str
        All of this in words.
    """

    run: Run
    bounds: Bounds
    rivals: tuple[tuple[str, ...], ...]
    separation: float
    present: float
    repeated: float
    gains: dict[str, float]
    times: Array = field(repr=False)
    omega_rotor: Array = field(repr=False)
    omega_casing: Array = field(repr=False)
    inseparable: tuple[tuple[str, str], ...] = ()
    sentence: str = ""


class _Criterion:
    """The value of information: larger is better."""

    def __init__(
        self, information: Information, rivals: Sequence[Rival], ignored: Sequence[tuple[int, int]] = ()
    ) -> None:
        self._all = list(range(information.parameters))
        # what some explanation does without is no part of all of them
        questioned = {k for r in rivals for k in r.columns}
        self._base = [k for k in self._all if k not in questioned]
        self._rivals, self._ignored = rivals, set(ignored)
        self._candidates = [information.places(i) for i in range(len(information.candidates))]

    def pairs(self, total: Array) -> dict[tuple[int, int], float]:
        """Return the expected difference of deviance of each ordered pair of rivals."""
        found = {}
        for (i, a), (j, b) in itertools.permutations(enumerate(self._rivals), 2):
            own = [k for k in a.columns if k not in b.columns]
            strengths = np.array(
                [g for k, g in zip(a.columns, a.strengths, strict=True) if k not in b.columns]
            )
            if own:
                found[i, j] = float(strengths @ schur(total, own, [*self._base, *b.columns]) @ strengths)
        return found

    def separation(self, total: Array) -> float:
        """Return the smallest difference between rivals that are not ignored."""
        values = [v for k, v in self.pairs(total).items() if k not in self._ignored]
        return min(values, default=math.nan)

    def limits(self, total: Array) -> Array:
        """Return the information about the strength of each candidate alone."""
        return np.array(
            [float(np.trace(schur(total, places, self._all))) / len(places) for places in self._candidates]
        )

    def __call__(self, total: Array, present: Array) -> float:
        if self._rivals:
            pairs = [v for k, v in self.pairs(total).items() if k not in self._ignored]
            # the worst pair decides; the others break ties
            return min(pairs) + 1e-3 * float(np.mean(np.minimum(pairs, 1e6))) if pairs else 0.0
        before, after = np.maximum(self.limits(present), 1e-300), np.maximum(self.limits(total), 1e-300)
        return float(np.mean(np.minimum(np.log(after / before), _CAP)))


def next_run(
    information: Information,
    rivals: Sequence[Rival],
    criteria: Criteria,
    bounds: Bounds,
    *,
    evaluations: int = 60,
    progress: Progress | None = None,
) -> NextRun | None:
    """Return the run within some bounds that separates rivals best; without rivals, that lowers detection limits most.

    Parameters
    ----------
    information : Information
        Of the recordings at hand.
    rivals : sequence of Rival
        Explanations, or none.
    criteria : Criteria
        `equivalence_width` and `experiment_sigma`.
    bounds : Bounds
        What is possible.
    evaluations : int
        Runs that are simulated at most.
    progress : callable, optional
        Called with (runs simulated, all).

    Returns
    -------
    NextRun or None
        None if no run can be simulated.
    """
    search = _RunSearch(information, rivals, bounds, evaluations, progress)
    search.explore()
    if not search.tried:
        return None
    search.refine()
    search.vary_apparatus()
    return search.result(criteria)


_FEW = 24


def separating_run(
    fit: Fit,
    explanations: Sequence[tuple[str, Sequence[Effect], Mapping[str, Estimate]]],
    criteria: Criteria,
) -> str:
    """Return the run that separates rival explanations, in words; empty where there is nothing to separate.

    Parameters
    ----------
    fit : Fit
        The base.
    explanations : sequence of (str, sequence of Effect, mapping)
        Name, terms, and the parameters of the terms by ``<effect>.<symbol>``, of each rival.
    criteria : Criteria
        `experiment_sigma`.
    """
    smooth = [x for x in explanations if not any(e.depends_on_angle for e in x[1])][:MOST_RIVALS]
    if len(smooth) < 2:
        return ""
    terms = [(e, _mean_values(e, estimates)) for _, effects, estimates in smooth for e in effects]
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


def _mean_values(effect: Effect, estimates: Mapping[str, Estimate]) -> dict[str, float]:
    """Return the parameters of an effect by symbol; the mean of the cases where each has its own."""
    values = {}
    for p in effect.parameters:
        own = [e.value for k, e in estimates.items() if k.partition("@")[0] == f"{effect.name}.{p.symbol}"]
        values[p.symbol] = float(np.mean(own)) if own else p.start
    return values


def _strengths(effect: Effect, values: Mapping[str, float]) -> list[float]:
    """Return the strength, or those of sine and cosine of a law with a phase."""
    role = {p.role: p.symbol for p in effect.parameters}
    k = values[role["amplitude"]]
    if "phase" not in role:
        return [k]
    return [k * math.cos(values[role["phase"]]), k * math.sin(values[role["phase"]])]


class _RunSearch:
    def __init__(
        self,
        information: Information,
        rivals: Sequence[Rival],
        bounds: Bounds,
        evaluations: int,
        progress: Progress | None,
    ) -> None:
        self._information, self._rivals, self._bounds = information, rivals, bounds
        self._evaluations, self._progress = evaluations, progress
        record = information.fit.problem.data[0].record
        self._windows = len(record.rotor)
        self._length = (
            float(np.median([w.time[-1] - w.time[0] for w in record.rotor])) if record.rotor else 0.0
        )
        self._criterion = _Criterion(information, rivals)
        self.tried: list[tuple[float, Run, Array, Fit]] = []
        self._count = 0

    def _run(self, x: Array, ring: float = 1.0, sense: float = 1.0) -> Run:
        """Return the run of a point of the unit cube."""
        b = self._bounds
        rotor, casing, duration = (
            low + share * (high - low)
            for share, (low, high) in zip(x[:3], (b.omega_rotor, b.omega_casing, b.duration), strict=True)
        )
        length = min(self._length, duration / max(self._windows, 1))
        free = duration - self._windows * length
        starts = [float(s * free + i * length) for i, s in enumerate(np.sort(x[3:]))]
        return Run(float(sense * rotor), float(casing), float(duration), tuple(starts), float(length), ring)

    def _try(self, run: Run) -> float:
        self._count += 1
        if self._progress is not None:
            self._progress(min(self._count, self._evaluations), self._evaluations)
        try:
            added, planned = self._information.of_run(run)
        except (FittingError, np.linalg.LinAlgError):
            return -math.inf
        if not np.isfinite(added).all():
            return -math.inf
        value = self._criterion(self._information.present + added, self._information.present)
        self.tried.append((value, run, added, planned))
        return value

    def explore(self) -> None:
        """Try quasi-random runs, and ignore pairs of rivals that none of them separates."""
        from scipy.stats import qmc

        b = self._bounds
        points = qmc.Sobol(3, seed=1).random(32)[: max(8, min(_RANDOM, self._evaluations // 3))]
        shares = np.linspace(0.03, 0.97, self._windows) if self._windows > 1 else np.full(self._windows, 0.03)
        rest = (0.0 - b.omega_casing[0]) / max(b.omega_casing[1] - b.omega_casing[0], 1e-300)
        usual = [
            np.array([1.0, np.clip(rest, 0, 1), 0.5]),
            np.array([0.5, np.clip(rest, 0, 1), 0.5]),
            np.array([1.0, 1.0, 0.5]),
            np.array([1.0, 0.0, 0.5]),
        ]
        self._points: list[tuple[float, Array, float]] = []
        for i, p in enumerate([*usual, *points]):
            # every third run reverses the rotor where it can
            sense = -1.0 if b.reversible and i >= len(usual) and i % 3 == 2 else 1.0
            x = np.concatenate([p, shares])
            self._points.append((self._try(self._run(x, sense=sense)), x, sense))
        if self._rivals and self.tried:
            pairs = [
                self._criterion.pairs(self._information.present + added) for _, _, added, _ in self.tried
            ]
            self._inseparable = [k for k in pairs[0] if max(p[k] for p in pairs) < 1.0]
            self._criterion = _Criterion(self._information, self._rivals, self._inseparable)
            self.tried = [
                (
                    self._criterion(self._information.present + added, self._information.present),
                    run,
                    added,
                    planned,
                )
                for _, run, added, planned in self.tried
            ]
            kept = iter([v for v, _, _, _ in self.tried])
            self._points = [(next(kept) if np.isfinite(v) else v, x, s) for v, x, s in self._points]
        else:
            self._inseparable = []

    def refine(self) -> None:
        """Move the best run's settings one by one, with shrinking steps."""
        value, x, sense = max(self._points, key=lambda p: p[0])
        step = 0.25
        random = np.random.default_rng(3)
        while self._count < self._evaluations and step > 0.02:
            better = False
            for k in random.permutation(len(x)):
                for sign in (1.0, -1.0):
                    if self._count >= self._evaluations:
                        break
                    other = x.copy()
                    other[k] = np.clip(other[k] + sign * step, 0.0, 1.0)
                    if other[k] == x[k]:
                        continue
                    found = self._try(self._run(other, sense=sense))
                    if found > value:
                        value, x, better = found, other, True
                        break
            step *= 1.0 if better else 0.5
        self._best, self._sense = x, sense

    def vary_apparatus(self) -> None:
        """Try the best run with an inertia ring on the casing; it is proposed only if it is worth the work."""
        low, high = self._bounds.inertia_casing
        best = max(v for v, *_ in self.tried)
        for ring in dict.fromkeys((low, high)):
            if ring == 1.0:
                continue
            value = self._try(self._run(self._best, ring=ring, sense=self._sense))
            enough = value > _WORTH * best if self._rivals else value > best + math.log(_WORTH)
            if np.isfinite(value) and not enough:
                self.tried.pop()

    def result(self, criteria: Criteria) -> NextRun:
        _, run, added, planned = max(self.tried, key=lambda t: t[0])
        info = self._information
        present, total = info.present, info.present + added
        cases = len(info.fit.problem.cases)
        repeated = present * (cases + 1) / cases
        before, after = self._criterion.limits(present), self._criterion.limits(total)
        gains = {
            e.name: float(math.sqrt(b / a)) if a > 0 else math.nan
            for (e, _), a, b in zip(info.candidates, after, before, strict=True)
        }
        path = planned.predictions[0].path
        times = np.linspace(0.0, run.duration, 400)
        y = Sampler(path.mesh, times).value(path.y)
        names = [r.names for r in self._rivals]
        pairs = tuple(
            (" + ".join(names[i]), " + ".join(names[j]))
            for i, j in self._inseparable
            if (j, i) not in self._inseparable or i < j
        )
        found = NextRun(
            run, self._bounds, tuple(names), self._criterion.separation(total), self._criterion.separation(present),
            self._criterion.separation(repeated), gains, times, y[:, 0], y[:, 1], pairs,
        )  # fmt: skip
        return replace(found, sentence=_sentence(found, info.fit, criteria))


def _sentence(found: NextRun, fit: Fit, criteria: Criteria) -> str:
    run, record = found.run, fit.problem.data[0].record
    single = record.single
    parts = []
    if single:
        parts.append(f"start at {run.omega_casing:.3g} rad/s")
    else:
        sense = " in the other sense of rotation" if run.omega_rotor < 0 else ""
        parts.append(f"start the rotor at {abs(run.omega_rotor):.0f} rad/s{sense}")
        usual = max(abs(float(d.initial_speeds[1][0, 1])) for d in fit.problem.data)
        if abs(run.omega_casing) > 1.5 * usual + 1.0:
            against = " against the rotor" if run.omega_casing * run.omega_rotor < 0 else " with the rotor"
            parts.append(f"spin the casing by hand to {abs(run.omega_casing):.0f} rad/s{against}")
        else:
            parts.append(f"start the casing at {run.omega_casing:.1f} rad/s")
    parts.append(f"record for {run.duration:.0f} s")
    if run.windows:
        starts = ", ".join(f"{w:.0f} s" for w in run.windows)
        parts.append(f"film the rotor for {run.window_length:.1f} s from {starts}")
    if run.ring != 1.0:
        parts.append(
            f"fix a ring to the casing that makes its moment of inertia {run.ring:.1f} times as large"
        )
    plan = "; ".join(parts)
    what = f"{plan[0].upper()}{plan[1:]}."
    if not found.rivals:
        ratio = [g for g in found.gains.values() if np.isfinite(g)]
        factor = float(np.exp(np.mean(np.log(np.maximum(ratio, 1e-6))))) if ratio else math.nan
        return f"{what} It lowers the detection limits to {100 * factor:.0f} % of the present ones (geometric mean)."
    if not math.isfinite(found.separation):
        return f"No run within the bounds separates the rivals: {_ELSE}"
    sigma, now, again = (math.sqrt(max(x, 0.0)) for x in (found.separation, found.present, found.repeated))
    expected = (
        f"Expected separation of the closest rivals {sigma:.1f} sigma "
        f"(now {now:.1f}; {again:.1f} after a repetition)."
    )
    if sigma < criteria.experiment_sigma:
        expected += f" That is less than {criteria.experiment_sigma:.0f} sigma: repeat it, or {_ELSE}"
    if found.inseparable:
        a, b = found.inseparable[0]
        expected += f" No run within the bounds separates {a} from {b}."
    return f"{what} {expected}"
