"""The next run, optimised: the initial conditions that tell most about rival explanations.

A run that is planned is simulated without noise, and its rows and their derivatives are computed as those of a
recording, with the measurement and process noise of the recordings at hand. With J the derivatives by the free
parameters, s_k the responses to the candidate effects, and everything that belongs to one run alone (its initial angular
rates, touch point, casing drag, phases of the films) projected out,

    I = sum over runs of [J s]' C^-1 [J s]

is the Fisher information of all recordings together; present and planned runs add up. Of two rivals a and b, sets of
candidates with strengths g_a and g_b, the information that b leaves of a after a refit of the shared parameters and of its
own strengths is

    D_ab = g_a' [ I_aa - I_ao I_oo^-1 I_oa ] g_a,       o = parameters and candidates of b,

the expected difference of deviance (twice the Kullback-Leibler divergence) between the two. The criterion of a run is the
smallest D over all ordered pairs of rivals (T-optimality: A. Atkinson, V. Fedorov, Biometrika 62, 57 (1975)). Without
rivals it is the mean logarithm of the information about each candidate's strength: the mean gain in detection limits.

The search is quasi-random over the bounds, then a local search with shrinking steps.
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
from fitting.discovery._score import CaseColumns
from fitting.effects._effect import Effect
from fitting.effects._library import GENERAL
from fitting.inference._case_data import CaseData
from fitting.inference._compression import CASING_DEGREE, ROTOR_DEGREE, compress
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse
from fitting.inference._parameters import START_CASING, START_ROTOR, ParameterLayout
from fitting.inference._problem import Problem
from fitting.inference._record import Record, Samples
from fitting.inference._result import Fit
from fitting.inference._simulation import Experiment, simulate_path
from fitting.dynamics._mesh import Sampler
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR

Array = NDArray[np.float64]
Progress = Callable[[int, int | None], None]

# blocks of a planned recording, and samples of each: a smooth motion needs no more
_BLOCKS = 24
_PER_BLOCK = 64
_RING = 1.5
_ROUNDS = 3
# a change of the apparatus is proposed if it is worth as much as so many runs
_WORTH = 1.5
_CAP = 50.0
_RANDOM = 20
_TINY = 1e-12
# determinant of the correlation of two candidates below which no data separates them
_COLLINEAR = 1e-6


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
class Rival:
    """An explanation: candidate effects with their shape constants and strengths.

    Attributes
    ----------
    names : tuple of str
        The effects.
    columns : tuple of int
        Their places among the columns of `Information`.
    strengths : ndarray
        Strength of each column.
    weight : float
        Its posterior probability among the rivals.
    """

    names: tuple[str, ...]
    columns: tuple[int, ...]
    strengths: Array
    weight: float = 1.0


@dataclass(frozen=True)
class Run:
    """A run that is planned.

    Attributes
    ----------
    omega_rotor, omega_casing : float
        Initial angular rates [rad/s].
    duration : float
        Length of the casing's recording [s].
    windows : tuple of float
        Start of each rotor window [s].
    window_length : float
        Length of each window [s].
    ring : float
        Moment of inertia of the casing over the present one.
    """

    omega_rotor: float
    omega_casing: float
    duration: float
    windows: tuple[float, ...]
    window_length: float
    ring: float = 1.0


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


class Information:
    """Fisher information of runs about the shared parameters and the strengths of candidates.

    Parameters
    ----------
    fit : Fit
        The recordings at hand.
    candidates : sequence of (Effect, dict)
        Effects with their shape constants.
    """

    def __init__(self, fit: Fit, candidates: Sequence[tuple[Effect, Mapping[str, float]]]) -> None:
        self.fit = fit
        self.candidates = [(e, dict(s)) for e, s in candidates if not e.depends_on_angle]
        layout, model = fit.problem.layout, fit.model.smooth
        self._shared = [k for k in model.free if k not in model.per_case]
        # a parameter at its bound is held, as in the search
        bound = dict(zip(layout.names, layout.at_bound(fit.theta), strict=True))
        self._held = {k for k in self._shared if bound.get(k, False)}
        parts = [self._of(fit, i) for i in range(len(fit.problem.cases))]
        self.present = np.asarray(np.sum([p[0] for p in parts], axis=0))
        # products of all columns with the residuals of the fit
        self.right = np.asarray(np.sum([p[1] for p in parts], axis=0))

    def added(self) -> dict[str, tuple[int, float]]:
        """Return the effects of the model beyond the paper's that have one strength for all runs: place and strength."""
        found = {}
        for e in self.fit.model.smooth.effects:
            key = f"{e.name}.{e.amplitude.symbol}" if e.amplitude is not None else ""
            if (
                e.name not in GENERAL
                and e.kind == "physical"
                and key in self._shared
                and key not in self._held
            ):
                found[e.name] = self._shared.index(key), self.fit.estimates[key].value
        return found

    @property
    def parameters(self) -> int:
        """Number of shared parameters, which come before the candidates."""
        return len(self._shared)

    def _of(self, fit: Fit, case: int) -> tuple[Array, Array]:
        """Return the information of one run, its own parameters projected out, and its products with the residuals."""
        data, prediction, noise = fit.problem.data[case], fit.predictions[case], fit.noise[case]
        whitener = noise.whitener.at(noise.pure)
        layout, jacobian = fit.problem.layout, prediction.jacobian
        places = [int(p) for p in layout.places(case, self._shared)]
        shared = jacobian[:, places]
        shared[:, [k in self._held for k in self._shared]] = 0.0
        rest = [i for i in range(jacobian.shape[1]) if i not in places]
        columns = CaseColumns(fit, case)
        strengths = []
        for effect, shape in self.candidates:
            trial = columns.trials(effect, [shape])[0]
            strengths.append(trial.columns)
        everything = whitener(np.concatenate([shared, *strengths], axis=1))
        own = whitener(np.concatenate([jacobian[:, rest], data.nuisance], axis=1))
        size = np.linalg.norm(own, axis=0)
        u, s, _ = np.linalg.svd(own[:, size > 0] / size[size > 0], full_matrices=False)
        basis = u[:, s > 1e-7 * s.max(initial=1.0)]
        everything = everything - basis @ (basis.T @ everything)
        left = whitener(data.z - prediction.rows)
        return np.asarray(everything.T @ everything), np.asarray(everything.T @ left)

    def places(self, candidate: int) -> list[int]:
        """Return the columns of a candidate: two for a law with a phase."""
        widths = [2 if any(p.role == "phase" for p in e.parameters) else 1 for e, _ in self.candidates]
        first = self.parameters + sum(widths[:candidate])
        return list(range(first, first + widths[candidate]))

    def of_run(self, run: Run) -> tuple[Array, Fit]:
        """Return the information of a planned run, and its noiseless simulation.

        Raises
        ------
        FittingError
            If the run cannot be simulated.
        """
        planned = simulated(self.fit, run)
        return self._of(planned, 0)[0], planned


def schur(information: Array, kept: Sequence[int], free: Sequence[int]) -> Array:
    """Return the information about some columns when others are free."""
    kept, free = list(kept), list(free)
    block = information[np.ix_(free, free)]
    size = np.sqrt(np.maximum(np.diag(block), 1e-300))
    inverse = np.linalg.pinv(block / np.outer(size, size), rcond=_TINY, hermitian=True) / np.outer(size, size)
    cross = information[np.ix_(kept, free)]
    return np.asarray(information[np.ix_(kept, kept)] - cross @ inverse @ cross.T)


def simulated(fit: Fit, run: Run) -> Fit:
    """Return the noiseless recording of a planned run with the parameters and noise of a fit, as a fit."""
    template = fit.problem.data[0].record
    layout = fit.problem.layout
    numbers = layout.numbers(fit.theta, 0) | {INERTIA_CASING: template.I_casing * run.ring}
    experiment = Experiment(
        omega_rotor=run.omega_rotor,
        omega_casing=run.omega_casing,
        duration=run.duration,
        windows=run.windows,
        window_length=run.window_length,
    )
    _, path = simulate_path(fit.model.smooth, numbers, experiment)
    count = _BLOCKS * _PER_BLOCK
    time = np.linspace(0.0, run.duration, count)
    angle = template.quantity == "angle"

    def samples(t: Array, state: str, like: Samples, effective: float, fewest: int) -> Samples:
        sampler = Sampler(path.mesh, t)
        value = (
            sampler.integral(*path.angle(state))
            if angle
            else sampler.value(path.y[..., path.states.index(state)])
        )
        # as many samples a second, with the correlation of the recording's
        rate = effective / max(float(like.time[-1] - like.time[0]), 1e-9)
        seconds = max(float(t[-1] - t[0]), 1e-9)
        sigma = float(np.median(like.sigma)) * math.sqrt(fewest / (rate * seconds))
        return Samples(t, value, np.full(len(t), sigma))

    first = fit.problem.data[0]
    casing = samples(
        time, "omega_c", template.casing, first.casing.n_effective / first.casing.scale**2, count
    )
    windows = []
    if template.rotor:
        like, run_of = template.rotor[0], first.rotor[0]
        for start in run.windows:
            t = start + np.linspace(0.0, run.window_length, 2 * _PER_BLOCK)
            windows.append(samples(t, "omega_r", like, run_of.n_effective / run_of.scale**2, len(t)))
    record = Record(
        "planned",
        template.I_rotor,
        template.I_casing * run.ring,
        casing,
        tuple(windows),
        template.quantity,
        digest="planned",
    )
    data = CaseData(
        record,
        compress(casing, degree=CASING_DEGREE, harmonics=False, blocks=_BLOCKS, noisy=False),
        tuple(compress(w, degree=ROTOR_DEGREE, harmonics=False, blocks=1, noisy=False) for w in windows),
    )
    problem = Problem.of(ParameterLayout.of(fit.model.smooth, [record]), [data])
    values = numbers | {START_ROTOR: run.omega_rotor, START_CASING: run.omega_casing}
    theta = np.array([values[n.partition("@")[0]] for n in problem.layout.names])
    predictions = tuple(problem.predict(theta))
    own = fit.noise[0]
    response = TorqueResponse(data, predictions[0].motion)
    whitener = response.whitener(TorqueNoise(own.pure, own.time))
    noise = (Noise(1.0, own.pure, own.pure, own.time, whitener),)
    return replace(
        fit,
        model=problem.layout.model,
        labels=("planned",),
        theta=theta,
        noise=noise,
        problem=problem,
        predictions=predictions,
    )


_MOST_RIVALS = 6


def rivals(information: Information, threshold: Sequence[float], criteria: Criteria) -> list[Rival]:
    """Return the explanations that the recordings at hand do not separate, in the linear theory of the score test.

    Every set of at most two effects, among the candidates and the effects that the model has beyond the paper's, is
    scored; those within the equivalence width of the best BIC are rivals, unless a part of them does as well.

    Parameters
    ----------
    information : Information
        Of the recordings at hand.
    threshold : sequence of float
        Score from which each candidate is significant in the whole list.
    criteria : Criteria
        `equivalence_width`, `evidence`.
    """
    added = information.added()
    names = [*added, *(e.name for e, _ in information.candidates)]
    columns = [[place] for place, _ in added.values()]
    columns += [information.places(i) for i in range(len(information.candidates))]
    count = [1 for _ in added] + [len(e.free) for e, _ in information.candidates]
    # friction is not negative
    one_sided = [False for _ in added] + [
        e.amplitude is not None and e.amplitude.lower >= 0 and len(c) == 1
        for (e, _), c in zip(information.candidates, columns[len(added) :], strict=True)
    ]
    physical = [True for _ in added] + [e.kind == "physical" for e, _ in information.candidates]
    places, strengths = [p for p, _ in added.values()], np.array([g for _, g in added.values()])
    base = [k for k in range(information.parameters) if k not in places]
    everything = [k for c in columns for k in c]
    n = len(information.present)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n], augmented[n, :n] = (
        information.present,
        information.right,
        information.right,
    )
    reduced = schur(augmented, [*everything, n], base)
    full, right = reduced[:-1, :-1], reduced[:-1, -1]
    index = {k: i for i, k in enumerate(everything)}
    if places:
        right = right + full[:, [index[p] for p in places]] @ strengths
    size = np.sqrt(np.maximum(np.diag(full), 1e-300))
    per_parameter = math.log(information.fit.problem.rows)
    scored: dict[frozenset[int], tuple[float, Array]] = {frozenset(): (0.0, np.zeros(0))}
    usable = [
        i
        for i, c in enumerate(columns)
        if physical[i] and all(full[index[k], index[k]] > _TINY * information.present[k, k] for k in c)
    ]
    for n in (1, 2):
        for chosen in itertools.combinations(usable, n):
            at = [index[k] for i in chosen for k in columns[i]]
            block = full[np.ix_(at, at)] / np.outer(size[at], size[at])
            if np.linalg.det(block) < _COLLINEAR:
                continue
            g = np.linalg.solve(block, right[at] / size[at])
            gain = float(g @ (right[at] / size[at]))
            signs = [
                v < 0 and one_sided[i]
                for i, v in zip([i for i in chosen for _ in columns[i]], g, strict=True)
            ]
            if any(signs):
                continue
            bic = -gain + per_parameter * sum(count[i] for i in chosen)
            scored[frozenset(chosen)] = bic, g / size[at]
    best = min(bic for bic, _ in scored.values())
    most = max(scored, key=lambda s: -scored[s][0])
    if not added:
        score = -best + per_parameter * sum(count[i] for i in most)
        if not most or score < min(threshold) or best > -criteria.evidence:
            return []
    kept = []
    for chosen, (bic, g) in sorted(scored.items(), key=lambda item: item[1][0]):
        inner = any(scored[part][0] <= bic for part in scored if part < chosen)
        if chosen and not inner and bic < best + criteria.equivalence_width:
            order = [i for i in usable if i in chosen]
            where = tuple(k for i in order for k in columns[i])
            kept.append(Rival(tuple(names[i] for i in order), where, g, math.exp(-0.5 * (bic - best))))
    kept = kept[:_MOST_RIVALS]
    return kept if len(kept) > 1 else []


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
    what = f"Next run: {'; '.join(parts)}."
    if not found.rivals:
        ratio = [g for g in found.gains.values() if np.isfinite(g)]
        factor = float(np.exp(np.mean(np.log(np.maximum(ratio, 1e-6))))) if ratio else math.nan
        return f"{what} It lowers the detection limits to {100 * factor:.0f} % of the present ones (geometric mean)."
    if not math.isfinite(found.separation):
        return "No run within the bounds separates the rivals: change what only one of them depends on (air pressure, surface, lubricant)."
    sigma, now, again = (math.sqrt(max(x, 0.0)) for x in (found.separation, found.present, found.repeated))
    expected = f"Expected separation of the closest rivals {sigma:.1f} sigma (now {now:.1f}; {again:.1f} after a repetition)."
    if sigma < criteria.experiment_sigma:
        expected += f" That is less than {criteria.experiment_sigma:.0f} sigma: repeat it, or change what only one of them depends on (air pressure, surface, lubricant)."
    if found.inseparable:
        a, b = found.inseparable[0]
        expected += f" No run within the bounds separates {a} from {b}."
    return f"{what} {expected}"
