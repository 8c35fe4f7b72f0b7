"""Comparison of studies: differences of parameters and effects between runs, and the spread of parameters over repeats.

Two values x_1 and x_2 with standard uncertainties u_1 and u_2 differ by (x_2 - x_1) / sqrt(u_1^2 + u_2^2) standard
uncertainties. The random-effects model of k repeats is

    x_i = mu + b_i + e_i,

where mu is the mean of all runs, b_i is the deviation of run i with the standard deviation tau, and e_i is the error of
its fit with the standard uncertainty u_i. The weights are w_i = 1 / (u_i^2 + tau^2), and tau follows from Q(tau) = sum
w_i (x_i - mu)^2 = k - 1 (R. Paule, J. Mandel, J. Res. Natl. Bur. Stand. 87, 377 (1982)); tau = 0 if Q(0) < k - 1.
Because tau is estimated from the same few runs, the standard uncertainty of mu is the larger of sqrt(Q / (k - 1) / sum
w_i) and 1 / sqrt(sum w_i), with k - 1 degrees of freedom (J. Hartung, G. Knapp, Stat. Med. 20, 1771 (2001)). The
interval of tau contains all values whose Q is between two quantiles of the chi-square distribution with k - 1 degrees
of freedom (W. Viechtbauer, Stat. Med. 26, 37 (2007)). The p-value of equal parameters is the tail probability of Q(0)
in this distribution.

A single run does not show how much its parameters vary from run to run. If the value of one run is used as a value of
the body, its total standard uncertainty is sqrt(u_i^2 + tau^2). Changepoints, the times at which a law sets in, belong
to a run and are not compared.

Runs are treated as independent. A common error of all runs, above all of a moment of inertia, cancels in a difference.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EstimationError
from fitting._numbers import on_screen, probability, rounded, to_json
from fitting.comparison._population import (
    Fitted,
    MeanDocument,
    Population,
    PopulationDocument,
    compared_parameters,
    population_of,
)
from fitting.effects._words import CASING, effect_name

Array = NDArray[np.float64]

_ONE_SIGMA = 0.6827
"""Probability within one standard deviation of a normal distribution [1]. Derived: 2 Phi(1) - 1."""


@dataclass(frozen=True)
class Repeat:
    """The value of a parameter in one run: name of the run, value and standard uncertainty [unit]."""

    run: str
    value: float
    stderr: float


@dataclass(frozen=True)
class ParameterComparison:
    """One parameter over several runs."""

    name: str
    unit: str  # SI unit of the parameter
    repeats: tuple[Repeat, ...]  # value in each run that determines the parameter
    # second minus first value [standard uncertainties]; None unless there are two runs
    difference_sigma: float | None
    p_value: float  # probability of such differences if the values are equal in all runs
    mean: float  # mean of the random-effects model [unit]
    mean_u: float  # standard uncertainty of the mean [unit]
    spread: float  # standard deviation tau between the runs, without the part due to uncertainties of the fits [unit]
    spread_interval: tuple[float, float]  # 68 % interval of the spread [unit]

    def total(self, repeat: Repeat) -> float:
        """Return the total standard uncertainty of the value of one run, which includes the spread [unit]."""
        return math.hypot(repeat.stderr, self.spread)


class RunValue(TypedDict):
    """The value of a parameter in one run."""

    run: str  #: Name of the run.
    value: float  #: Value [unit of the parameter].
    stderr: float  #: Standard error of the fit [unit of the parameter].
    total: float  #: Standard uncertainty of a single run, which includes the spread [unit of the parameter].


class SpreadDocument(TypedDict):
    """The standard deviation between the runs, without the part due to uncertainties of the fits."""

    value: float  #: Standard deviation [unit of the parameter].
    interval_68: list[float]  #: 68 % interval of the standard deviation [unit of the parameter].


class ComparedParameter(TypedDict):
    """One parameter over several runs."""

    unit: str  #: Unit of the parameter.
    values: list[RunValue]  #: Value in each run that determines the parameter.
    #: Second value minus first value; null unless there are two runs [standard uncertainties].
    difference_sigma: float | None
    p_value: float  #: Probability of such differences if the values are equal in all runs [1].
    mean: MeanDocument  #: Mean of the runs.
    spread: SpreadDocument  #: Standard deviation between the runs.


class ComparisonDocument(TypedDict):
    """Comparison of the fits of several runs."""

    runs: list[str]  #: Names of the runs.
    parameters: dict[str, ComparedParameter]  #: Parameters by key, the most significant difference first.
    effects: dict[str, list[str]]  #: Runs that have an effect, by effect that some runs do not have.
    #: Runs in which a parameter is at a bound or has no uncertainty, by parameter.
    at_bound: dict[str, list[str]]
    population: PopulationDocument | None  #: Outlying runs, drifts and steps; null for fewer than eight runs.
    sentences: list[str]  #: The result in words.
    failed: dict[str, str]  #: Error messages of runs that could not be fitted, by file.


@dataclass(frozen=True, repr=False)
class Comparison:
    """Comparison of several runs, with the parameters that at least two of them determine."""

    runs: tuple[str, ...]  # names of the runs
    parameters: tuple[ParameterComparison, ...]  # the most significant difference first
    effects: dict[str, tuple[str, ...]]  # runs that have an effect, by effect that some runs do not have
    bounds: dict[
        str, tuple[str, ...]
    ]  # runs in which a parameter is at a bound or has no uncertainty, by parameter
    population: Population | None = None  # outlying runs, drifts and steps; None for fewer than eight runs
    words: Mapping[str, str] = field(default_factory=dict)  # effects and parameters in words, by key

    def called(self, key: str) -> str:
        """Return an effect or a parameter in words, with its key."""
        return self.words.get(key, key)

    def __repr__(self) -> str:
        return on_screen([f"comparison of {len(self.runs)} runs", *self.sentences])

    @property
    def sentences(self) -> list[str]:
        """The result in words."""
        count = max(len(self.parameters), 1)
        # Bonferroni correction for the number of parameters
        differing = [p for p in self.parameters if p.p_value * count < 0.01]
        lines = []
        for p in differing:
            sigma = p.difference_sigma
            size = f" by {abs(sigma):.1f} standard uncertainties" if sigma is not None else ""
            growth = max(p.total(r) / r.stderr for r in p.repeats)
            lines.append(
                f"{self.called(p.name)} differs between the runs{size} (p {probability(p.p_value)}); "
                f"mean {rounded(p.mean, p.mean_u, p.unit)}, spread {p.spread:.2g} {p.unit}; with the spread the "
                f"uncertainty of a single run is up to {growth:.2g} times that of its fit."
            )
        if not differing:
            lines.append(f"No significant difference in {len(self.parameters)} parameters.")
        if self.population is not None:
            lines = self.population.sentences
        for name, runs in self.effects.items():
            lines.append(f"{self.called(name)} is only in {_listed(runs)}.")
        for name, runs in self.bounds.items():
            lines.append(f"{self.called(name)} is at its bound in {_listed(runs)}.")
        return lines

    def document(self, failed: Mapping[str, str] | None = None) -> ComparisonDocument:
        """Return the comparison as the JSON document of `gyrotrack compare`.

        Parameters
        ----------
        failed : mapping of str to str, optional
            Error messages of runs that could not be fitted.
        """
        return {
            "runs": list(self.runs),
            "parameters": {
                p.name: {
                    "unit": p.unit,
                    "values": [
                        {"run": r.run, "value": r.value, "stderr": r.stderr, "total": p.total(r)}
                        for r in p.repeats
                    ],
                    "difference_sigma": p.difference_sigma,
                    "p_value": p.p_value,
                    "mean": {"value": p.mean, "stderr": p.mean_u},
                    "spread": {"value": p.spread, "interval_68": list(p.spread_interval)},
                }
                for p in self.parameters
            },
            "effects": {name: list(runs) for name, runs in self.effects.items()},
            "at_bound": {name: list(runs) for name, runs in self.bounds.items()},
            "population": None if self.population is None else to_json(self.population.document()),
            "sentences": self.sentences,
            "failed": dict(failed or {}),
        }


_LISTED = 12
"""Largest number of names of runs in a sentence [1]. Chosen: a smaller number hides runs, a larger one makes the
sentence unreadable."""


def _listed(runs: Sequence[str]) -> str:
    more = f" and {len(runs) - _LISTED} more" if len(runs) > _LISTED else ""
    return ", ".join(runs[:_LISTED]) + more


def compare(
    fits: Mapping[str, Fitted],
    times: Mapping[str, float] | None = None,
    *,
    time_unit: str = "run",
    body: str = "",
) -> Comparison:
    """Compare the parameters and effects of several fits.

    Parameters
    ----------
    fits : mapping of str to Fit
        Fits by the names of the runs. In a joint fit, per-case values of a parameter are repeats, named ``run:case``.
    times : mapping of str to float, optional
        Times of the runs, by name, for drifts and steps (eight runs or more); by default the numbers of the runs.
    time_unit : str
        Unit of the times.
    body : str
        Name of a single recorded body, for the names in words; by default "body".

    Returns
    -------
    Comparison
        Differences and spread of each parameter; `population` contains outlying runs, drifts and steps.

    Raises
    ------
    EstimationError
        If there are fewer than two fits, or a run has no time.
    """
    if len(fits) < 2:
        raise EstimationError("A comparison needs at least two fits.", "Give two cases, each with a fit.")
    missing = [run for run in fits if times is not None and run not in times]
    if missing:
        raise EstimationError(f"the run {missing[0]} has no time", "give the times of all runs, by name")
    repeats: dict[str, list[Repeat]] = {}
    units: dict[str, str] = {}
    bounds: dict[str, list[str]] = {}
    for run, own, key, name in compared_parameters(fits):
        e = fits[run].estimates[name]
        if e.at_bound or not (math.isfinite(e.stderr) and e.stderr > 0):
            bounds.setdefault(key, []).append(own)
            continue
        units[key] = e.unit
        repeats.setdefault(key, []).append(Repeat(own, float(e.value), float(e.stderr)))
    compared = [_compared(key, units[key], found) for key, found in repeats.items() if len(found) > 1]
    names = {n for found in fits.values() for n in found.model.names}
    having = {n: tuple(run for run, found in fits.items() if n in found.model.names) for n in sorted(names)}
    words = _in_words(fits, {*repeats, *bounds, *names}, body)
    population = population_of(fits, times, time_unit=time_unit)
    return Comparison(
        tuple(fits),
        tuple(sorted(compared, key=lambda p: p.p_value)),
        {n: runs for n, runs in having.items() if len(runs) < len(fits)},
        {n: tuple(runs) for n, runs in bounds.items()},
        population if population is None else replace(population, words=words),
        words,
    )


def _in_words(fits: Mapping[str, Fitted], keys: Iterable[str], body: str) -> dict[str, str]:
    """Return effects and parameters in words, each with its key."""
    two = any(n.partition("@")[0] == "initial.omega_r" for found in fits.values() for n in found.estimates)
    effects = {e.name: e for found in fits.values() for e in found.model.effects}
    return {k: str(effect_name(k, CASING if two else body or "body", effects.values())) for k in keys}


def _compared(name: str, unit: str, repeats: Sequence[Repeat]) -> ParameterComparison:
    from scipy.special import chdtrc, chdtri

    x = np.array([r.value for r in repeats])
    u = np.array([r.stderr for r in repeats])
    dof = len(x) - 1
    tail = 0.5 * (1 - _ONE_SIGMA)
    spread = _spread(x, u, dof)
    low, high = (_spread(x, u, float(chdtri(dof, p))) for p in (tail, 1 - tail))
    weights = 1 / (u**2 + spread**2)
    mean = float(weights @ x / weights.sum())
    scatter = float(weights @ (x - mean) ** 2) / dof
    difference = float((x[1] - x[0]) / math.hypot(u[0], u[1])) if len(x) == 2 else None
    return ParameterComparison(
        name,
        unit,
        tuple(repeats),
        difference,
        float(chdtrc(dof, _q(x, u, 0.0))),
        mean,
        math.sqrt(max(scatter, 1.0) / float(weights.sum())),
        spread,
        (low, high),
    )


def _q(x: Array, u: Array, spread: float) -> float:
    weights = 1 / (u**2 + spread**2)
    return float(weights @ (x - weights @ x / weights.sum()) ** 2)


def _spread(x: Array, u: Array, target: float) -> float:
    """Return the spread at which Q equals `target`; 0 if Q is not larger than `target` even without a spread.

    Q decreases as the spread increases.
    """
    if _q(x, u, 0.0) <= target:
        return 0.0
    from scipy.optimize import brentq

    high = float(np.ptp(x))
    while _q(x, u, high) > target:
        high *= 2
    return float(brentq(lambda spread: _q(x, u, spread) - target, 0.0, high, xtol=1e-300))
