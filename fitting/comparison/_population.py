"""Many runs of one machine: population of the parameters, outlying runs, drifts and steps over the times of the runs.

**Population.** Run i has estimates y_i of p parameters with the covariance C_i of its fit. The true values are X_i beta
+ b_i. X_i beta is the mean; if there is a drift or a step over the times of the runs, the mean contains it. b_i is a
random deviation with the distribution N(0, T). Let r_i = y_i - X_i beta be the residuals, V_i = C_i + T, and T = L L'
with a lower triangular L. Restricted maximum likelihood (D. A. Harville, J. Am. Stat. Assoc. 72, 320 (1977)) minimises

    -2 log L_R = sum log|V_i| + log|sum X_i' V_i^-1 X_i| + sum r_i' V_i^-1 r_i.

A parameter that a run does not determine has a very large variance in this run. The uncertainties of the elements of T
follow from the expected information 1/2 sum tr(V^-1 E_j V^-1 E_k), where E_j is the derivative of T with respect to its
element j.

**Outlying runs.** Let T be estimated from m runs. If the spread dominates the uncertainties of the fits, the statistic
(m - p) / (p (m - 1)) r_i' V_i^-1 r_i has an F distribution with p and m - p degrees of freedom (H. Hotelling, Ann.
Math. Statist. 2, 360 (1931)). If the uncertainties dominate, the quantiles of the statistic are smaller, so that fewer
runs are outlying. A run is outlying if its p-value is below the level divided by the number of runs (Bonferroni).
Outlying runs are omitted, and T is estimated again until the set of outlying runs no longer changes. In the first
round, the median of neighbouring runs replaces the fitted mean.

**Changes.** Each parameter is tested for a drift (regression on the time of the run, Student's t) and for a step at any
time. The statistic of the step is the largest F over all changepoints with at least `FEWEST` runs on each side; its
null distribution is simulated with the weights of the runs in this regression. Holm's procedure (S. Holm, Scand. J.
Statist. 6, 65 (1979)) over all parameters and both tests limits the probability of any false change in the whole set of
runs to `LEVEL`. BIC decides between drift and step; a step has one parameter more than a drift.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypedDict

import numpy as np
from numpy.typing import NDArray

from fitting._numbers import on_screen, probability, rounded
from fitting.dynamics._model import Model

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

FEWEST_RUNS = 8
"""Smallest number of runs of a population [runs]. Chosen: a smaller number of runs does not determine a spread, a
larger limit refuses short studies."""
FEWEST = 3
"""Smallest number of runs on each side of a step [runs]. Chosen: a smaller number takes an outlying run for a step, a
larger one overlooks steps near the ends."""
LEVEL = 0.01
"""Probability of any false change in a set of runs [1]. Chosen: a larger value reports more false changes, a smaller
one overlooks changes."""
OUTLYING = 0.01
"""Probability of any false outlying run in a set of runs [1]. Chosen: a larger value omits regular runs, a smaller one
keeps outlying runs."""
_SETS = 20000
"""Number of simulated sets for the null distribution of the largest step [1]. Chosen: a smaller number makes small
p-values coarse, a larger one costs time."""
_AT_A_TIME = 2**21
"""Number of random numbers that are simulated at once [1]. Chosen: 16 MiB; another value costs time or memory and does
not change the result."""
_NEIGHBOURS = 7
"""Number of runs on each side of a run in its running median, which replaces the fitted mean in the first round [runs].
Chosen: a smaller number follows outlying runs, a larger one blurs a drift."""
_ROUNDS = 8
"""Largest number of rounds that omit outlying runs [1]. Chosen: a smaller number stops before the set is stable, a
larger one delays the end."""
_MOST_OUT = 0.2
"""Largest share of runs that are omitted as outlying [1]. Chosen: a larger value takes a second population for outlying
runs, a smaller one keeps outlying runs."""
_PREFERRED = 2.0
"""Difference of BIC above which either drift or step is preferred [1]. Source: R. E. Kass, A. E. Raftery, JASA 90, 773
(1995)."""
_UNKNOWN = 1e10
"""Variance of a parameter that a run does not determine, in units of its variance over the runs [1]. Derived: so large
that the parameter has no weight, but small enough that rounding errors of the inverse matrix are negligible."""
_LEAST_SHARE = 0.8
"""Share of the runs that must determine a parameter [1]. Chosen: a smaller value tests parameters that few runs
determine; with a larger one, a single run that does not determine a parameter excludes it."""
_SHOWN = 12
"""Largest number of outlying runs in a sentence [1]. Chosen: a smaller number hides runs, a larger one makes the
sentence unreadable."""


@dataclass(frozen=True)
class Change:
    """A drift or a step of one parameter."""

    kind: str  # "drift", "step", or "drift or step" if BIC prefers neither
    slope: float  # slope of the drift [unit per unit of time]
    slope_u: float  # standard uncertainty of the slope
    time: float  # time of the step, midway between the runs before and after the step
    before: str  # the last run before the step
    after: str  # the first run after the step
    size: float  # size of the step [unit]
    size_u: float  # standard uncertainty of the size
    delta_bic: float  # BIC of the step minus BIC of the drift


class MeanDocument(TypedDict):
    """A number with its standard error."""

    value: float  #: Value [unit of the parameter].
    stderr: float  #: Standard error of the number [unit of the parameter].


class ChangeDocument(TypedDict):
    """A drift or a step of one parameter; a drift is per `time_unit`."""

    kind: str  #: `drift`, `step`, or `drift or step` if the data prefer neither.
    drift: MeanDocument  #: Slope of the drift.
    step: MeanDocument  #: Size of the step.
    step_time: float  #: Time of the step, midway between two runs [`time_unit`].
    last_before: str  #: The last run before the step.
    first_after: str  #: The first run after the step.
    delta_bic: float  #: BIC of the step minus BIC of the drift [1].


class PopulationParameterDocument(TypedDict):
    """One parameter over all runs."""

    unit: str  #: Unit of the parameter.
    mean: MeanDocument  #: Mean of the runs.
    #: Standard deviation between the runs, without the part due to uncertainties of the fits.
    spread: MeanDocument
    runs: int  #: Number of runs that determine the parameter and are not outlying.
    p_drift: float  #: Probability of an equal or more significant drift if there is no drift [1].
    p_step: float  #: Probability of an equal or more significant step if there is no step [1].
    #: The smaller of `p_drift` and `p_step`, adjusted for all parameters and both tests [1].
    p_adjusted: float
    change: ChangeDocument | None  #: Drift or step; null if not significant.


class OutlyingRun(TypedDict):
    """A run whose parameters differ from the parameters of the other runs."""

    run: str  #: Name of the run.
    #: Probability of an equal or larger deviation by chance, adjusted for the number of runs [1].
    p_adjusted: float


class PopulationDocument(TypedDict):
    """Outlying runs, drifts and steps of many runs of one machine."""

    level: float  #: False-alarm probability of all tests together [1].
    time_unit: str  #: Unit of the times of the runs.
    times: dict[str, float]  #: Time of each run [`time_unit`].
    parameters: dict[str, PopulationParameterDocument]  #: Parameters by key, as in a fit.
    #: Correlation of the true values of two parameters over the runs; null if a spread is zero [1].
    correlation: list[list[float]]
    outlying: list[OutlyingRun]  #: Outlying runs, which are excluded.
    #: Parameters that too few runs determine, each with the number of runs that do not determine it.
    untested: dict[str, int]
    sentences: list[str]  #: The result in words.


@dataclass(frozen=True)
class PopulationParameter:
    """One parameter over all runs."""

    name: str
    unit: str
    mean: float
    mean_u: float
    # standard deviation between runs, without the part due to uncertainties of the fits: about a significant drift or
    # step, otherwise about the mean
    spread: float
    spread_u: float
    runs: int  # number of runs that determine the parameter and are not outlying
    p_drift: float
    p_step: float
    p_adjusted: float  # the smaller of p_drift and p_step, adjusted for all parameters and both tests (Holm)
    change: Change | None  # None if not significant


@dataclass(frozen=True, repr=False)
class Population:
    """Parameters of many runs of one machine, in the order of their times."""

    runs: tuple[str, ...]
    times: Array  # shape (n,)
    time_unit: str
    parameters: tuple[PopulationParameter, ...]
    # shape (p, p); correlation of the true values of two parameters over the runs; NaN if a spread is zero
    correlation: Array
    outlying: tuple[tuple[str, float], ...]  # outlying runs, with p-values adjusted for the number of runs
    untested: Mapping[
        str, int
    ]  # parameters that too few runs determine, and the number of runs that do not determine them
    values: Array  # shape (n, p); NaN if a run does not determine a parameter
    stderr: Array  # shape (n, p)
    level: float
    words: Mapping[str, str] = field(default_factory=dict)  # parameters in words, by key

    def called(self, key: str) -> str:
        """Return a parameter in words, with its key."""
        return self.words.get(key, key)

    def __repr__(self) -> str:
        return on_screen([f"population of {len(self.runs)} runs", *self.sentences])

    @property
    def changed(self) -> tuple[PopulationParameter, ...]:
        """The parameters that drift or step."""
        return tuple(p for p in self.parameters if p.change is not None)

    @property
    def sentences(self) -> list[str]:
        """The result in words."""
        per = f"per {self.time_unit}"
        lines = []
        for p in self.changed:
            assert p.change is not None  # noqa: S101
            c = p.change
            drift = f"drifts by {rounded(c.slope, c.slope_u, p.unit)} {per}"
            step = f"steps by {rounded(c.size, c.size_u, p.unit)} between {c.before} and {c.after}"
            what = {"drift": drift, "step": step}.get(c.kind, f"{drift}, or {step}")
            lines.append(f"{self.called(p.name)} {what} (p {probability(p.p_adjusted)}, adjusted).")
        if not lines and self.parameters:
            lines.append(
                f"No drift or step in {len(self.parameters)} parameters of {len(self.runs)} runs "
                f"(family-wise level {self.level:g})."
            )
        if self.outlying:
            names = ", ".join(name for name, _ in self.outlying[:_SHOWN])
            more = f" and {len(self.outlying) - _SHOWN} more" if len(self.outlying) > _SHOWN else ""
            lines.append(f"Outlying runs, excluded: {names}{more}.")
        for name, count in self.untested.items():
            lines.append(
                f"{self.called(name)} is not determined in {count} of {len(self.runs)} runs and not tested."
            )
        return lines

    def document(self) -> PopulationDocument:
        """Return the population as a part of the JSON document of `gyrotrack compare`."""
        return {
            "level": self.level,
            "time_unit": self.time_unit,
            "times": dict(zip(self.runs, self.times.tolist(), strict=True)),
            "parameters": {
                p.name: {
                    "unit": p.unit,
                    "mean": {"value": p.mean, "stderr": p.mean_u},
                    "spread": {"value": p.spread, "stderr": p.spread_u},
                    "runs": p.runs,
                    "p_drift": p.p_drift,
                    "p_step": p.p_step,
                    "p_adjusted": p.p_adjusted,
                    "change": None
                    if p.change is None
                    else {
                        "kind": p.change.kind,
                        "drift": {"value": p.change.slope, "stderr": p.change.slope_u},
                        "step": {"value": p.change.size, "stderr": p.change.size_u},
                        "step_time": p.change.time,
                        "last_before": p.change.before,
                        "first_after": p.change.after,
                        "delta_bic": p.change.delta_bic,
                    },
                }
                for p in self.parameters
            },
            "correlation": self.correlation.tolist(),
            "outlying": [{"run": name, "p_adjusted": p} for name, p in self.outlying],
            "untested": dict(self.untested),
            "sentences": self.sentences,
        }


def population(
    names: Sequence[str],
    units: Sequence[str],
    runs: Sequence[str],
    times: Array,
    values: Array,
    covariances: Array,
    *,
    time_unit: str = "run",
    level: float = LEVEL,
    seed: int = 0,
) -> Population:
    """Return the population of the parameters of several runs, the outlying runs, and the changes with time.

    If a run does not determine a parameter, its entry of `values` (n, p) is NaN, and its variance in `covariances`
    (n, p, p) is not finite. At least `FEWEST_RUNS` runs are needed.
    """
    order = np.argsort(times, kind="stable")
    runs, times = [runs[i] for i in order], times[order]
    values, covariances = values[order].copy(), covariances[order]
    variances = np.einsum("ijj->ij", covariances)
    known = np.isfinite(values) & np.isfinite(variances) & (variances > 0)
    values[~known] = np.nan
    tested = known.sum(axis=0) >= max(FEWEST_RUNS, _LEAST_SHARE * len(runs))
    untested = {n: int((~known[:, j]).sum()) for j, n in enumerate(names) if not tested[j]}
    kept = np.flatnonzero(tested)
    shown_u = np.sqrt(np.where(known, variances, np.nan))[:, kept]
    y, c, known = values[:, kept], covariances[:, kept][:, :, kept], known[:, kept]
    shown = y.copy()
    if not len(kept):
        empty = np.zeros((len(runs), 0))
        return Population(
            tuple(runs), times, time_unit, (), np.zeros((0, 0)), (), untested, empty, empty, level
        )
    scale = np.nanstd(y, axis=0)
    scale = np.where(scale > 0, scale, np.nanmedian(shown_u, axis=0))
    y, c = y / scale, c / np.outer(scale, scale)
    y, c = _filled(y, c, known)
    rng = np.random.default_rng(seed)
    out, chosen, p_out = _left_out(y, c, times, known)
    inside = ~out
    found, spread_u, correlation = [], np.zeros(len(kept)), np.full((len(kept), len(kept)), np.nan)
    design = [_columns(kind, place, times, inside) for kind, place in chosen]
    tests = [_tests(y[:, j], c[:, j, j], times, inside & known[:, j], rng) for j in range(len(kept))]
    p_values = np.array([[t.p_drift, t.p_step] for t in tests])
    adjusted = _holm(p_values.ravel()).reshape(p_values.shape).min(axis=1)
    # the mean model of a parameter without a significant change is a constant
    for j, t in enumerate(tests):
        chosen[j] = (t.kind, t.place) if adjusted[j] < level else ("", 0)
        design[j] = _columns(*chosen[j], times, inside)
    spread, beta_u, beta = _reml(y[inside], c[inside], [d[inside] for d in design])
    spread_u = _spread_u(c[inside], spread)
    size = np.sqrt(np.diag(spread))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.where(np.outer(size, size) > 1e-6, spread / np.outer(size, size), np.nan)
    for j, t in enumerate(tests):
        change = None
        if adjusted[j] < level:
            after = t.place
            before = np.flatnonzero((inside & known[:, j])[:after])[-1]
            change = Change(
                t.label, t.slope * scale[j], t.slope_u * scale[j],
                0.5 * float(times[before] + times[after]), runs[before], runs[after],
                t.size * scale[j], t.size_u * scale[j], t.delta_bic,
            )  # fmt: skip
        found.append(
            PopulationParameter(
                names[kept[j]],
                units[kept[j]],
                float(beta[j][0] * scale[j]),
                float(beta_u[j][0] * scale[j]),
                float(size[j] * scale[j]),
                float(spread_u[j] * scale[j]),
                int((inside & known[:, j]).sum()),
                t.p_drift,
                t.p_step,
                float(adjusted[j]),
                change,
            )
        )
    outlying = tuple((runs[i], float(p_out[i])) for i in np.flatnonzero(out))
    return Population(
        tuple(runs), times, time_unit, tuple(found), correlation, outlying, untested, shown, shown_u, level
    )


class Fitted(Protocol):
    """A fit, a saved fit, or a fit in a ledger (a file of saved fits)."""

    @property
    def model(self) -> Model: ...

    @property
    def estimates(self) -> Mapping[str, Any]: ...


def compared_parameters(fits: Mapping[str, Fitted]) -> Iterator[tuple[str, str, str, str]]:
    """For each parameter that is compared between runs, yield its run, case, key and name.

    The case is ``run:case``, or the run if the parameter has no case. The key does not contain the case. The name in
    the fit is ``key@case``.

    Initial values, constants and changepoints are not compared.
    """
    for run, found in fits.items():
        changepoints = {f"{e.name}.{e.breakpoint}" for e in found.model.effects if e.breakpoint}
        excluded = {*found.model.constants, *changepoints}
        for name in found.estimates:
            key, _, case = name.partition("@")
            if not key.startswith("initial.") and key not in excluded:
                yield run, f"{run}:{case}" if case else run, key, name


def population_of(
    fits: Mapping[str, Fitted],
    times: Mapping[str, float] | None = None,
    *,
    time_unit: str = "run",
    level: float = LEVEL,
) -> Population | None:
    """Return the population of the runs of several fits; None for fewer than `FEWEST_RUNS` runs or without a parameter.

    `times` contains the times of the runs by name; by default they are the numbers of the runs. In a joint fit, the
    per-case values of each case count as a separate run.
    """
    rows: dict[str, dict[str, tuple[float, str]]] = {}
    origin: dict[str, str] = {}
    units: dict[str, str] = {}
    for run, own, key, name in compared_parameters(fits):
        e = fits[run].estimates[name]
        rows.setdefault(own, {})[key] = float(e.value), name
        origin[own] = run
        units.setdefault(key, e.unit)
    if len(rows) < FEWEST_RUNS or not units:
        return None
    keys = list(units)
    values = np.full((len(rows), len(keys)), np.nan)
    covariances = np.full((len(rows), len(keys), len(keys)), np.nan)
    for i, (own, row) in enumerate(rows.items()):
        found = fits[origin[own]]
        variables = list(getattr(found, "variables", ()))
        matrix: Any = np.asarray(getattr(found, "covariance", ()))
        for j, key in enumerate(keys):
            if key not in row:
                continue
            value, name = row[key]
            e = found.estimates[name]
            if e.at_bound or not (math.isfinite(e.stderr) and e.stderr > 0):
                continue
            values[i, j] = value
            covariances[i, j, j] = e.stderr**2
            for k, other in enumerate(keys[:j]):
                c = 0.0
                if other in row and {name, row[other][1]} <= set(variables) and matrix.size:
                    c = float(matrix[variables.index(name), variables.index(row[other][1])])
                covariances[i, j, k] = covariances[i, k, j] = c
    names = list(rows)
    at = (
        np.arange(1.0, len(names) + 1)
        if times is None
        else np.array([float(times[origin[n]]) for n in names])
    )
    return population(
        keys, [units[k] for k in keys], names, at, values, covariances, time_unit=time_unit, level=level
    )


def _filled(y: Array, c: Array, known: Flags) -> tuple[Array, Array]:
    """Return values and covariances; undetermined parameters have the mean value, a huge variance, no correlation."""
    y, c = np.where(known, y, np.nanmean(y, axis=0)), c.copy()
    both = known[:, :, None] & known[:, None, :]
    c[~both] = 0.0
    i, j = np.nonzero(~known)
    c[i, j, j] = _UNKNOWN
    return y, c


def _columns(kind: str, place: int, times: Array, inside: Flags) -> Array:
    """Return the columns (n, k) of a mean model: a constant and, unless `kind` is empty, a centred drift or step.

    `place` is the index of the first run after the step, among all n runs. `inside` marks the runs that are not
    outlying; the columns are centred on their mean.
    """
    columns = [np.ones(len(times))]
    if kind == "drift":
        columns.append(times - times[inside].mean())
    elif kind == "step":
        after = np.zeros(len(times))
        after[place:] = 1.0
        columns.append(after - after[inside].mean())
    return np.stack(columns, axis=1)


def _left_out(y: Array, c: Array, times: Array, known: Flags) -> tuple[Flags, list[tuple[str, int]], Array]:
    """Return a mask of the outlying runs, the mean model of each parameter, and the adjusted p-values of all runs."""
    from scipy.special import fdtrc

    n, p = y.shape
    level = OUTLYING / n
    residual = y - np.stack([_running_median(y[:, j]) for j in range(p)], axis=1)
    spread = np.diag(
        np.maximum(
            (1.4826 * np.median(np.abs(residual), axis=0)) ** 2 - np.median(np.einsum("ijj->ij", c), axis=0),
            0.0,
        )
    )
    chosen: list[tuple[str, int]] = [("", 0)] * p
    out = np.zeros(n, dtype=bool)
    p_values = np.ones(n)
    for step in range(_ROUNDS):
        distance = np.einsum("ij,ij->i", residual, np.linalg.solve(c + spread, residual[..., None])[..., 0])
        count, dof = max(int((~out).sum()), p + 2), np.maximum(known.sum(axis=1), 1)
        p_values = np.asarray(fdtrc(dof, count - dof, distance * (count - dof) / (dof * (count - 1))))
        worst = np.argsort(p_values)[: int(_MOST_OUT * n)]
        flagged = np.zeros(n, dtype=bool)
        flagged[worst] = p_values[worst] < level
        if (flagged == out).all() and step > 0:
            break
        out = flagged
        inside = ~out
        chosen = [_best(y[:, j], c[:, j, j], times, inside & known[:, j]) for j in range(p)]
        design = [_columns(kind, place, times, inside) for kind, place in chosen]
        spread, _, beta = _reml(y[inside], c[inside], [d[inside] for d in design])
        residual = np.stack([y[:, j] - design[j] @ beta[j] for j in range(p)], axis=1)
    return out, chosen, np.minimum(n * p_values, 1.0)


def _running_median(y: Array) -> Array:
    n = len(y)
    return np.array([np.median(y[max(0, i - _NEIGHBOURS) : i + _NEIGHBOURS + 1]) for i in range(n)])


@dataclass(frozen=True)
class _Tests:
    """Tests of one parameter, in scaled values."""

    p_drift: float
    p_step: float
    kind: str  # the mean model of smaller BIC: "drift" or "step"
    label: str  # `kind`, or "drift or step" if BIC prefers neither
    place: int  # index of the first run after the step, among all runs
    slope: float
    slope_u: float
    size: float
    size_u: float
    delta_bic: float


def _weights(y: Array, u2: Array, design: Array) -> tuple[Array, float]:
    """Return the weights 1 / (u^2 + tau^2) of the regression of one parameter, and the REML estimate of tau^2."""
    from scipy.optimize import minimize_scalar

    def cost(log_spread: float) -> float:
        w = 1 / (u2 + math.exp(log_spread))
        gram = design.T @ (design * w[:, None])
        r = y - design @ np.linalg.solve(gram, design.T @ (w * y))
        return float(-np.log(w).sum() + np.linalg.slogdet(gram)[1] + w @ r**2)

    # range of tau^2: from 1e-5 of the squared uncertainty to more than the whole variance
    low, high = (
        math.log(1e-5 * float(np.median(u2)) + 1e-300),
        math.log(float(np.var(y)) + float(np.median(u2))),
    )
    best = minimize_scalar(cost, bounds=(low, high + 1.0), method="bounded", options={"xatol": 1e-3})
    spread = math.exp(float(best.x)) if cost(float(best.x)) < cost(low) else 0.0
    return 1 / (u2 + spread), spread


def _tests(y: Array, u2: Array, times: Array, used: Flags, rng: np.random.Generator) -> _Tests:
    y, u2, times = y[used], u2[used], times[used]
    n = len(y)
    ones = np.ones((n, 1))
    # the columns of a line are a constant and a drift; the spread is estimated about the line and, below, about the
    # constant alone
    straight = np.column_stack([np.ones(n), times - times.mean()])
    p_drift, slope, slope_u = 1.0, 0.0, 0.0
    from scipy.special import stdtr

    if np.ptp(times) > 0:
        w, _ = _weights(y, u2, straight)
        slope, slope_u, dof = _coefficient(y, w, straight)
        p_drift = float(2 * stdtr(dof, -abs(slope) / slope_u))
    w, _ = _weights(y, u2, ones)
    f, largest = _step_statistics(y, w)
    place = int(np.argmax(f)) + FEWEST
    p_step = _p_step(float(largest), w, rng)
    step = _columns("step", place, times, np.ones(n, dtype=bool))
    w_step, _ = _weights(y, u2, step)
    size, size_u, _ = _coefficient(y, w_step, step)
    # the time of a step is an additional parameter
    line = straight if np.ptp(times) > 0 else ones  # if all times are equal, there is no drift
    delta = _deviance(y, u2, step) + 2 * math.log(n) - _deviance(y, u2, line) - math.log(n)
    kind = "drift" if delta > 0 and np.ptp(times) > 0 else "step"
    label = kind if abs(delta) > _PREFERRED else "drift or step"
    place = int(np.flatnonzero(used)[place])
    return _Tests(p_drift, p_step, kind, label, place, slope, slope_u, size, size_u, delta)


def _best(y: Array, u2: Array, times: Array, used: Flags) -> tuple[str, int]:
    """Return kind and place of the mean model of smallest BIC: constant (""), drift or step.

    The place of a step is the index of the first run after it, among all runs.
    """
    y, u2, times = y[used], u2[used], times[used]
    n, inside = len(y), np.ones(len(y), dtype=bool)
    w, _ = _weights(y, u2, np.ones((n, 1)))
    place = int(np.argmax(_step_statistics(y, w)[0])) + FEWEST
    step = _columns("step", place, times, inside)
    costs = {("", 0): _deviance(y, u2, np.ones((n, 1)))}
    costs["step", place] = _deviance(y, u2, step) + 2 * math.log(n)
    if np.ptp(times) > 0:
        costs["drift", 0] = _deviance(y, u2, _columns("drift", 0, times, inside)) + math.log(n)
    kind, place = min(costs, key=lambda k: costs[k])
    return kind, int(np.flatnonzero(used)[place]) if kind == "step" else 0


def _deviance(y: Array, u2: Array, design: Array) -> float:
    """Return minus twice the (unrestricted) log-likelihood of a mean model, at the REML estimate of its spread."""
    w, _ = _weights(y, u2, design)
    r = y - design @ np.linalg.solve(design.T @ (design * w[:, None]), design.T @ (w * y))
    return float(w @ r**2 - np.log(w).sum())


def _coefficient(y: Array, w: Array, design: Array) -> tuple[float, float, int]:
    """Return the last coefficient of a weighted regression, its standard uncertainty and degrees of freedom.

    The uncertainty is multiplied by the root of the reduced chi-square if this root exceeds 1 (J. Hartung, G. Knapp,
    Stat. Med. 20, 1771 (2001)).
    """
    gram = np.linalg.inv(design.T @ (design * w[:, None]))
    beta = gram @ (design.T @ (w * y))
    dof = len(y) - design.shape[1]
    factor = max(float(w @ (y - design @ beta) ** 2) / dof, 1.0)
    return float(beta[-1]), math.sqrt(factor * float(gram[-1, -1])), dof


_ROUNDING = 1e-14
"""Relative rounding error of a value [1]. Derived: about fifty times the precision of double numbers; smaller
differences of the values are not a step."""


def _step_statistics(y: Array, w: Array) -> tuple[Array, Array]:
    """Return F of a step at each place with at least `FEWEST` runs on both sides, and the largest F.

    `y` contains one or several series, shape (..., n).
    """
    total, mass = np.sum(w * y, axis=-1, keepdims=True), w.sum()
    before, left = np.cumsum(w * y, axis=-1)[..., :-1], np.cumsum(w)[:-1]
    mean = total / mass
    whole = np.sum(w * (y - mean) ** 2, axis=-1, keepdims=True)
    explained = (before - mean * left) ** 2 * mass / (left * (mass - left))
    explained = explained[..., FEWEST - 1 : len(w) - FEWEST]
    rounding = _ROUNDING**2 * np.sum(w * y**2, axis=-1, keepdims=True) + 1e-300  # equal values have no step
    f = explained * (len(w) - 2) / np.maximum(whole - explained, rounding)
    return np.asarray(f), np.asarray(f.max(axis=-1))


def _p_step(largest: float, w: Array, rng: np.random.Generator) -> float:
    """Return the probability of a larger F statistic at any place if there is no step.

    The probability is simulated. If no simulated set has a larger statistic, the result is the smaller of two values:
    the resolution of the simulation, and the Bonferroni bound over all places.
    """
    from scipy.special import fdtrc

    n = len(w)
    beyond, done, size = 0, 0, max(1, min(_SETS, _AT_A_TIME // n))
    while done < _SETS:
        count = min(size, _SETS - done)
        sets = rng.standard_normal((count, n)) / np.sqrt(w)
        beyond += int((_step_statistics(sets, w)[1] >= largest).sum())
        done += count
        # a large probability need not be known precisely
        if beyond > _ENOUGH:
            break
    simulated = (beyond + 1) / (done + 1)
    bound = (n + 1 - 2 * FEWEST) * float(fdtrc(1, n - 2, largest))
    return min(simulated, bound) if beyond == 0 else simulated


_ENOUGH = 400
"""Number of simulated sets with a larger step at which the simulation ends [1]. Derived: the relative standard error of
the probability is 1 / sqrt(400), 5 %."""


def _holm(p: Array) -> Array:
    """Return p-values adjusted by Holm's procedure."""
    order = np.argsort(p)
    adjusted = np.maximum.accumulate(p[order] * (len(p) - np.arange(len(p))))
    out = np.empty(len(p))
    out[order] = np.minimum(adjusted, 1.0)
    return out


def _reml(y: Array, c: Array, design: Sequence[Array]) -> tuple[Array, list[Array], list[Array]]:
    """Return T by restricted maximum likelihood, and the mean model of each parameter.

    The mean models are two lists: the standard uncertainties of the coefficients, and the coefficients.

    `design` contains the columns (n, k) of the mean model of each parameter.
    """
    from scipy.optimize import minimize

    n, p = y.shape
    widths = [d.shape[1] for d in design]
    starts = np.concatenate([[0], np.cumsum(widths)])
    x = np.zeros((n, p, starts[-1]))
    for j, d in enumerate(design):
        x[:, j, starts[j] : starts[j + 1]] = d
    rows, columns = np.tril_indices(p)

    def solved(free: Array) -> tuple[Any, ...]:
        root = np.zeros((p, p))
        root[rows, columns] = free
        v = c + root @ root.T
        w = np.linalg.inv(v)
        wx = w @ x
        gram = np.einsum("ipk,ipl->kl", x, wx)
        beta = np.linalg.solve(gram, np.einsum("ipk,ip->k", wx, y))
        r = y - x @ beta
        cost = np.linalg.slogdet(v)[1].sum() + np.linalg.slogdet(gram)[1] + np.einsum("ip,ipq,iq->", r, w, r)
        return root, w, wx, gram, r, float(cost)

    def value_and_slope(free: Array) -> tuple[float, Array]:
        root, w, wx, gram, r, cost = solved(free)
        wr = (w @ r[..., None])[..., 0]
        # d cost / d T = sum of V^-1 - V^-1 X G^-1 X' V^-1 - V^-1 r r' V^-1
        by_t = w.sum(axis=0) - np.einsum("ipk,kl,iql->pq", wx, np.linalg.inv(gram), wx) - wr.T @ wr
        return cost, (2 * by_t @ root)[rows, columns]

    first = np.zeros((p, p))
    about = np.stack(
        [y[:, j] - d @ np.linalg.lstsq(d, y[:, j], rcond=None)[0] for j, d in enumerate(design)], axis=1
    )
    typical = np.median(np.einsum("ijj->ij", c), axis=0)
    np.fill_diagonal(first, np.sqrt(np.maximum(np.var(about, axis=0) - typical, 0.05 * typical)))
    found = minimize(
        value_and_slope, first[rows, columns], jac=True, method="BFGS", options={"gtol": 1e-4 * n}
    )
    root, _, wx, gram, _, _ = solved(found.x)
    cov = np.linalg.inv(gram)
    beta = np.linalg.solve(gram, np.einsum("ipk,ip->k", wx, y))
    errors = np.sqrt(np.diag(cov))
    parts = [slice(starts[j], starts[j + 1]) for j in range(p)]
    return root @ root.T, [errors[s] for s in parts], [beta[s] for s in parts]


def _spread_u(c: Array, spread: Array) -> Array:
    """Return the standard uncertainties of the spreads (roots of the diagonal of T) from the expected information."""
    p = len(spread)
    w = np.linalg.inv(c + spread)
    pairs = list(zip(*np.tril_indices(p), strict=True))
    basis = []
    for a, b in pairs:
        e = np.zeros((p, p))
        e[a, b] = e[b, a] = 1.0
        basis.append(w @ e)
    information = np.array([[0.5 * np.einsum("ipq,iqp->", s, t) for s in basis] for t in basis])
    covariance = np.linalg.pinv(information, hermitian=True)
    variance_u = np.array([math.sqrt(max(covariance[k, k], 0.0)) for k, (a, b) in enumerate(pairs) if a == b])
    size = np.sqrt(np.diag(spread))
    # Near zero, the uncertainty of the variance cannot be propagated linearly to the spread. The uncertainty of the
    # spread is then the square root of the uncertainty of the variance.
    return np.asarray(
        np.where(size**2 > variance_u, variance_u / np.maximum(2 * size, 1e-300), np.sqrt(variance_u))
    )
