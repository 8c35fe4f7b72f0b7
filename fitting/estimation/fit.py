"""The fit: start values, straight variables, measured noise, errors that count it.

Two levels of random torque are found for each case. The *pure* level is what no slow torque can explain: the
noise. The *level* of the fit is what this model leaves: the same if the model is right, more if it
misses something. Parameters are estimated at the level of the fit, so that a model that fails by a
thousand sigma somewhere is not torn there; its chi-square and held-out error are told at the pure level.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.errors import EstimationError
from fitting.estimation.account import Account
from fitting.estimation.case_model import Prediction
from fitting.estimation.covariance import covariance_of, surely_at_bound
from fitting.estimation.energy import EnergyBalance, energy_balance
from fitting.estimation.lack import LackOfFit, lack_of_fit
from fitting.estimation.layout import START_ROTOR, Layout
from fitting.estimation.metrics import CaseMetrics, case_metrics
from fitting.estimation.noise_levels import Noise, cautious, first_noise, measure_noise, refine_level
from fitting.estimation.problem import Problem, Projection
from fitting.estimation.search import search, search_widely
from fitting.estimation.shapes import start_shapes, unknown_shapes
from fitting.estimation.start import start_values
from fitting.model import Model
from fitting.noise import WHITE
from fitting.record import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

# chi2 per reachable row above which the model is said to miss something (2000 rows: 1.0 +- 0.03)
_MISFIT = 1.4
# probability of the slow torque that a model leaves, if that is noise, below which it is said to miss something
_IMPROBABLE = 1e-5
_OTHER_POWERS = (0.7, 1.35)
# a casing slower than this share of its largest speed is taken to stand still
_AT_REST = 0.01
_PATIENCE = 60


@dataclass(frozen=True)
class Estimate:
    """A fitted number: value, standard error (nan on a bound), unit, and whether it lies on a bound."""

    value: float
    stderr: float
    unit: str
    at_bound: bool


@dataclass(frozen=True, repr=False)
class Fit(Account):
    """A fitted model.

    Attributes
    ----------
    model : Model
        What was fitted.
    estimates : dict of str to Estimate
        Every parameter and start speed by name.
    cases : tuple of CaseMetrics
        Figures of merit of each case.
    chi2, rows, n_eff, deviance, bic : float
        Chi-square over the rows a model can reach and their number; effective number of samples;
        minus twice the log-likelihood (up to a constant of the data); deviance + p ln rows: only the
        rows can tell one model from another, all other combinations of the samples are noise to both.
    lack : LackOfFit
        What slow torques would still take away, against what noise alone would give them.
    verdict : str
        "adequate", "misfit" or "not converged".
    """

    model: Model
    labels: tuple[str, ...]
    estimates: dict[str, Estimate]
    cases: tuple[CaseMetrics, ...]
    chi2: float
    rows: int
    n_eff: float
    deviance: float
    bic: float
    lack: LackOfFit
    verdict: str
    covariance: Array = field(repr=False)
    theta: Array = field(repr=False)
    noise: tuple[Noise, ...] = field(repr=False)
    problem: Problem = field(repr=False)
    predictions: tuple[Prediction, ...] = field(repr=False)

    @property
    def reduced_chi2(self) -> float:
        """Chi-square of the casings over their effective number of samples."""
        return sum(
            c.casing.reduced_chi2 * d.casing.n_effective
            for c, d in zip(self.cases, self.problem.data, strict=True)
        ) / sum(d.casing.n_effective for d in self.problem.data)

    def plot(self) -> Figure:
        """Draw speeds measured and modelled, and what the model leaves, with bands of 2 sigma (matplotlib)."""
        from fitting.display.plots import plot_fit

        return plot_fit(self)

    def _repr_html_(self) -> str:
        from fitting.display.html import fit_html

        return fit_html(self)

    def energy(self, label: str | None = None) -> EnergyBalance:
        """Return the energy balance of a case (the first, if not named): kinetic energy plus losses, as a curve.

        Raises
        ------
        EstimationError
            If there is no case of this label.
        """
        if label is not None and label not in self.labels:
            raise EstimationError(f"there is no case {label[:40]!r}", "it has: " + ", ".join(self.labels))
        i = 0 if label is None else self.labels.index(label)
        return energy_balance(self.problem.cases[i], self.theta, self.predictions[i].path)

    @property
    def torque_noise(self) -> float:
        """Rms of the random torque that this model leaves [N m]."""
        return max(n.level for n in self.noise)


def fit(
    model: Model,
    cases: Sequence[Record | CaseData],
    *,
    share: Iterable[str] = (),
    per_case: Iterable[str] = (),
    start: Mapping[str, float] | None = None,
    noise: Sequence[Noise] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    quick: bool = False,
) -> Fit:
    """Fit a model to one case, or to several together.

    Parameters
    ----------
    model : Model
        The model.
    cases : sequence of Record or CaseData
        Each experiment; with several, the touch point, the casing's drag and the start speeds have
        a value for each, all else is shared.
    share, per_case : iterable of str
        Change which parameters are shared.
    start : mapping, optional
        Values to start from; the others come from a regression.
    noise : sequence of Noise, optional
        The noise found by an earlier fit of the same data, so that both can be compared.
    ranges : mapping, optional
        Bounds tighter than the declared ones.
    quick : bool
        Stop where chi-square is within about 0.01 of its minimum: enough to rank candidates.

    Returns
    -------
    Fit

    Raises
    ------
    EstimationError
        If there is nothing to fit, or labels repeat.
    """
    data = [c if isinstance(c, CaseData) else CaseData.of(c) for c in cases]
    labels = [d.record.label for d in data]
    if not data or len(set(labels)) != len(labels):
        raise EstimationError(
            "the cases of a joint fit need different labels", "give them with --label when making a case"
        )
    _check_bodies(model, data)
    layout = Layout.of(model, [d.record for d in data], share, per_case, ranges)
    problem = Problem(layout, data)
    theta = _start(layout, problem, start)
    if noise is None:
        noise = first_noise(problem, theta)
        problem.set_noise([n.whitener for n in noise])
        theta = _shaped(problem, theta, start)
        if _stops(problem, theta):
            theta = _past_stops(problem, theta)
        theta = search_widely(problem, theta, _elsewhere(layout, problem, theta, start), quick=quick)
        noise = measure_noise(problem, theta)
        theta, noise = _tight(problem, theta, noise)
    elif not set(layout.names) <= set(start or ()):
        # far from the minimum a model fails by far more than the noise, and a valley seen so sharply is hard to follow
        problem.set_noise(cautious(problem, theta, noise))
        theta = _shaped(problem, theta, start)
        _, theta = search(problem, theta, quick=True)
        noise = refine_level(problem, theta, noise)
    problem.set_noise([n.whitener for n in noise])
    minimum, theta = search(problem, theta, quick=quick)
    noise = tuple(refine_level(problem, theta, noise))
    problem.set_noise([n.whitener for n in noise])
    minimum, theta = search(problem, theta, quick=quick)
    return summarise(problem, theta, noise, converged=minimum.converged)


def _stops(problem: Problem, theta: Array) -> bool:
    """Return whether a casing comes to rest or turns back, as it was measured or as the model has it."""
    for d in problem.data:
        speed = np.abs(d.rough_speeds[1][:, 1])
        if (speed[len(speed) // 20 :] < _AT_REST * speed.max(initial=0.0)).any():
            return True
    return any(p.path.jumps for p in problem.predict(theta))


def _past_stops(problem: Problem, theta: Array) -> Array:
    """Return variables from a search without random torque, and set the noise about them.

    What a torque does after a stop at a wrong time is wrong too, and would hold the search there.
    """
    problem.set_noise([WHITE] * len(problem.data))
    with suppress(EstimationError):
        _, theta = search(problem, theta, quick=True, most=_PATIENCE)
    problem.set_noise([n.whitener for n in first_noise(problem, theta)])
    return theta


def _shaped(problem: Problem, theta: Array, given: Mapping[str, float] | None) -> Array:
    unknown = unknown_shapes(problem.layout, given)
    if not unknown:
        return theta
    names = {n for n in problem.layout.names if not n.startswith(tuple(f"{e.name}." for e in unknown))}
    return start_shapes(problem, theta, unknown, fitted=names <= set(given or ()))


def _tight(problem: Problem, theta: Array, noise: tuple[Noise, ...]) -> tuple[Array, tuple[Noise, ...]]:
    """Return variables and noise, found anew with no more noise than the data has, if that describes it better.

    What noise does to a casing that is held is told from the fitted path. About a path that stops at a wrong time it
    may hold the fit there. So may an edge of a parameter, far from the data, where noise excuses what is wrong.
    """
    if all(n.level <= n.pure for n in noise):
        return theta, noise
    held = any((p.path.sense == 0).any() for p in problem.predict(theta))
    if not held and not problem.layout.at_bound(theta).any():
        return theta, noise
    ends = [(theta, noise)]
    # the pure level was found about a wrong path too: with none at all the angles alone have a say
    for share in (1.0, 0.0):
        problem.set_noise([n.whitener.at(share * n.pure) for n in noise])
        _, other = search(problem, theta)
        ends.append((other, measure_noise(problem, other)))
    return min(ends, key=lambda end: _deviance(problem, *end))


def _deviance(problem: Problem, theta: Array, noise: Sequence[Noise]) -> float:
    problem.set_noise([n.whitener for n in noise])
    r, _ = problem.residuals(problem.predict(theta))
    return float(r @ r) + sum(n.whitener.log_determinant for n in noise)


def _elsewhere(
    layout: Layout, problem: Problem, theta: Array, given: Mapping[str, float] | None
) -> Iterator[Array]:
    """Yield other starts: the program's own if one was given, and other exponents of the bearing's power law."""
    own = _start(layout, problem, None) if given else theta
    if given:
        yield own
    for g in _OTHER_POWERS:
        begin = own.copy()
        for v in problem.valleys:
            begin = problem.physical(np.where(np.arange(len(own)) == v.g, g, problem.straight(begin)))
        if problem.valleys:
            yield begin


def _check_bodies(model: Model, data: Sequence[CaseData]) -> None:
    single = [d.record.single for d in data]
    if any(single) != all(single):
        raise EstimationError(
            "one body alone and a rotor in its casing cannot be fitted together", "fit them one by one"
        )
    foreign = [e.name for e in model.effects if not e.alone] if all(single) else []
    if foreign:
        raise EstimationError(
            f"{foreign[0]} speaks of a rotor, which this record of one body does not have",
            "its laws are those that act on the casing alone: `gyrotrack effects` lists them",
        )


def _start(layout: Layout, problem: Problem, given: Mapping[str, float] | None) -> Array:
    known = dict(given or {})
    if not set(layout.names) <= set(known):
        rough = [d.rough_speeds for d in problem.data]
        guessed = dict(
            zip(layout.names, start_values(layout, problem.reference, rough).tolist(), strict=True)
        )
        known = guessed | {k: v for k, v in known.items() if k in guessed}
    return np.array([known[n] for n in layout.names])


def summarise(problem: Problem, theta: Array, noise: tuple[Noise, ...], *, converged: bool) -> Fit:
    """Return the fit at these variables with errors and figures of merit."""
    layout = problem.layout
    predictions = tuple(problem.predict(theta))
    r, j = problem.residuals(predictions)
    chi2 = float(r @ r)
    rows = problem.rows
    at_bound = layout.at_bound(theta)
    covariance = covariance_of(j, ~surely_at_bound(layout, at_bound, r, j))
    free = int((~at_bound).sum())
    # a model that fails has errors of its own beside the noise's
    covariance *= max(1.0, chi2 / max(1, rows - free))
    pure = [Projection(d, n.whitener.at(n.pure)) for d, n in zip(problem.data, noise, strict=True)]
    cases = tuple(
        case_metrics(c, project, p, theta)
        for c, project, p in zip(problem.cases, pure, predictions, strict=True)
    )
    n_eff = sum(d.n_effective for d in problem.data)
    deviance = chi2 + sum(n.whitener.log_determinant for n in noise)
    lack = lack_of_fit(problem, predictions, noise)
    left = lack.p_value < _IMPROBABLE or any(c.misfit > _MISFIT for c in cases)
    verdict = "not converged" if not converged else "misfit" if left else "adequate"
    errors = np.sqrt(np.diag(covariance))
    estimates = {
        name: Estimate(
            float(theta[i]),
            float("nan") if at_bound[i] else float(errors[i]),
            _unit(layout, name),
            bool(at_bound[i]),
        )
        for i, name in enumerate(layout.names)
        if not (layout.records[0].single and name.startswith(START_ROTOR))
    }
    for key, value in layout.model.constants.items():
        estimates[key] = Estimate(value, float("nan"), layout.parameter(key).unit, at_bound=False)
    return Fit(
        layout.model,
        tuple(r.label for r in layout.records),
        estimates,
        cases,
        chi2,
        rows,
        n_eff,
        deviance,
        deviance + len(theta) * float(np.log(rows)),
        lack,
        verdict,
        covariance,
        theta,
        noise,
        problem,
        predictions,
    )


def _unit(layout: Layout, name: str) -> str:
    return layout.parameter(name).unit
