"""The result of a fit: parameters, uncertainties, figures of merit, verdict.

Cross-validation errors, the lack-of-fit test and the energy balance take longer than a step of the optimisation. They
are computed on first access, because the ranking of most candidate effects does not need them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting._arguments import INTEGER, NOT_NEGATIVE, NUMBER, PATH, SEED, TEXT, Kind, require
from fitting._criteria import Criteria
from fitting._display import (
    block,
    draw_speed,
    draw_speed_residual,
    figure,
    figure_of,
    headline,
    printable,
    table,
)
from fitting._errors import EstimationError
from fitting._numbers import PER_INERTIA, TORQUE, Units, rounded, short, speed, speed_unit, with_uncertainty
from fitting.dynamics._model import Model
from fitting.effects._effect import Effect
from fitting.effects._mechanism import MAIN
from fitting.effects._words import EffectName, effect_name
from fitting.inference._angle_harmonics import AngleHarmonics, angle_harmonics
from fitting.inference._angle_noise import AngleNoise
from fitting.inference._angle_residuals import AngleResidual, angle_residuals
from fitting.inference._case import outward
from fitting.inference._case_model import Prediction
from fitting.inference._linear_algebra import covariance_of
from fitting.inference._metrics import (
    CaseMetrics,
    EnergyBalance,
    LackOfFit,
    case_metrics,
    energy_balance,
    held_out,
    lack_of_fit,
    smoothing_noise,
)
from fitting.inference._noise import Noise, unresolved_level, variance_factor
from fitting.inference._parameters import ParameterLayout
from fitting.inference._params import LEAST_CORRELATION, Estimate, Names, Params, report, shown_name
from fitting.inference._periodogram import PeriodogramPeak, periodogram_peak
from fitting.inference._prior import Prior
from fitting.inference._problem import Problem, Projection, free_columns, surely_at_bound
from fitting.inference._process_noise import CONSISTENT
from fitting.inference._random_torque import LikelyNoise, most_likely_noise
from fitting.inference._record import speeds
from fitting.inference._sampled import evaluate, residuals_of
from fitting.inference._smooth_test import SmoothTest, smooth_test
from fitting.inference._smooth_torque import smooth_torques
from fitting.inference._speed_residuals import SpeedResidual, modelled_speed, speed_residuals
from fitting.inference._ties import chain, find_key, follow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fitting.inference._profile import Interval


VERDICT_TEXT = {
    "no_lack_of_fit": "no significant lack of fit; `gyrotrack diagnose` tests other effects",
    "lack_of_fit": "significant lack of fit; run `gyrotrack diagnose`",
    "not_determined": "a parameter is not determined: its uncertainty exceeds its value a hundredfold",
    "not_converged": "not converged; the values are not reliable",
}


_SCREEN = 20
"""Largest number of lines of a repr [lines]. Chosen: one screen of a console; a smaller value hides parameters, a
larger one scrolls."""
_POINTS = 600
"""Number of points of a drawn curve [1]. Chosen: a smaller number shows corners, a larger one makes larger files."""
# warning that is printed with a fit to a generated curve
GENERATED = (
    "the rotor curve is generated, not measured: the uncertainties do not include its systematic error, which is often "
    "more than ten times larger; fit the rotor windows instead"
)


Array = NDArray[np.float64]
Origin = tuple[tuple[str, ...], Array, tuple[str, ...], tuple[str, ...]]


class FitSummary:
    """Tables and text that a fit and a saved fit have in common."""

    model: Model
    labels: tuple[str, ...]
    estimates: Mapping[str, Estimate]
    n_eff: float
    deviance: float
    bic: float
    covariance: Array

    @property
    def torque_unit(self) -> str:
        """Unit of torques: "N m", or "rad/s2" where they are per unit of inertia."""
        return TORQUE if any(e.unit.startswith(TORQUE) for e in self.estimates.values()) else PER_INERTIA

    @property
    def misfit(self) -> float:
        """Rms residual of all rows that a model can describe, divided by the rms of the noise; 1 is the noise limit.

        Unlike the reduced chi-square of the samples, it does not depend on the sampling rate, because further samples
        add no rows.
        """
        return math.sqrt(sum(c.rows * c.chi2_per_row for c in self.cases) / sum(c.rows for c in self.cases))

    def _origin(self) -> Origin:
        """Return the names of the variables, their covariance, and sources and digests of the data."""
        raise NotImplementedError

    if TYPE_CHECKING:

        @property
        def cases(self) -> tuple[CaseMetrics, ...]:
            """Figures of merit of each case."""
            ...

        @property
        def verdict(self) -> str:
            """The verdict on the fit, a key of `VERDICT_TEXT`."""
            ...

    def __repr__(self) -> str:
        lines = [f"fit: {VERDICT_TEXT[self.verdict]}", "", *summary_lines(self)]
        if len(lines) > _SCREEN:
            lines = [*lines[: _SCREEN - 1], f"... {len(lines) - _SCREEN + 1} more lines: see to_dataframe()"]
        return "\n".join(lines)

    def to_dataframe(self) -> Any:
        """Return the parameters as a pandas data frame, one row each, indexed by name.

        Returns
        -------
        pandas.DataFrame
            Columns value, stderr (nan at a bound and for held parameters), unit, at_bound.

        Raises
        ------
        EstimationError
            If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise EstimationError(
                "a data frame needs pandas, which is not installed", 'pip install "gyrotrack[notebook]"'
            ) from None
        rows = {k: (e.value, e.stderr, e.unit, e.at_bound) for k, e in self.estimates.items()}
        frame = pd.DataFrame.from_dict(rows, orient="index", columns=["value", "stderr", "unit", "at_bound"])
        return frame.rename_axis("parameter")

    @property
    def values(self) -> dict[str, float]:
        """The values of the parameters by name."""
        return {name: e.value for name, e in self.estimates.items()}

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the variables of `covariance`."""
        return self._origin()[0]

    @property
    def body_name(self) -> str:
        """Name of a single body; empty for a gyroscope and for a body without a name."""
        return ""

    def shown_name(self, key: str) -> str:
        """Return the name of a parameter in `params`, given its name in `estimates`."""
        return shown_name(key, self.body_name, len(self.labels))

    @property
    def shown_model(self) -> str:
        """Names of the effects, joined by " + "; effects of a single body begin with the name of the body."""
        return " + ".join(outward(name, self.body_name) for name in self.model.names)

    @cached_property
    def params(self) -> Params:
        """The parameters by name; the end of a name suffices if it is unique: ``params["b2"]``."""
        return Params({self.shown_name(k): e for k, e in self.estimates.items()})

    @property
    def aic(self) -> float:
        """Akaike's information criterion, deviance + 2 p, up to the constant of `bic`."""
        return self.deviance + 2 * sum(e.vary for e in self.estimates.values())

    def correlations(self) -> list[tuple[str, str, float]]:
        """Return the correlation of each pair of fitted parameters, by the names of `params`, largest first."""
        names = self.variables
        size = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        used = [
            i for i, n in enumerate(names) if n in self.estimates and np.isfinite(size[i]) and size[i] > 0
        ]
        shown = {i: self.shown_name(names[i]) for i in used}
        pairs = [
            (shown[i], shown[j], float(self.covariance[i, j] / (size[i] * size[j])))
            for k, i in enumerate(used)
            for j in used[k + 1 :]
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))

    def save(self, path: str | Path) -> None:
        """Write the fit as JSON, atomically; `fitting.load_fit` reads it."""
        from fitting._schema import SavedFitDocument, as_text, own_effects, write_text

        require("path", path, PATH)
        names, covariance, sources, digests = self._origin()
        scalars = ("chi2", "rows", "n_eff", "deviance", "bic", "verdict")
        same = (*scalars, "labels", "estimates", "cases", "noise")
        document = SavedFitDocument.model_validate(
            {k: getattr(self, k) for k in same}
            | {"model": self.model.names, "own_effects": own_effects(self.model.effects)}
            | {"names": names, "covariance": covariance.tolist(), "sources": sources, "digests": digests}
        )
        write_text(Path(path), as_text(document))


def summary_lines(fit: FitSummary) -> list[str]:
    """Return the figures of merit and the parameters of a fit, by their keys, as lines of at most 80 columns."""
    lines = [*merit_lines(fit), ""]
    for name in fit.estimates:
        value = estimate_text(fit, name)
        lines += [f"  {name}"] if len(name) >= 32 else []
        lines.append(f"  {name if len(name) < 32 else '':<32}{value}")
    if getattr(fit, "generated", False):
        lines += ["", *wrap(GENERATED, 79)]
    weak = not_determined(fit.estimates)
    if weak:
        lines += ["", *wrap(f"not determined by these data: {', '.join(weak)}", 79)]
    return lines


def estimate_text(fit: FitSummary, name: str) -> str:
    """Return value, uncertainty and unit of a parameter, and whether it is at its bound or was held."""
    e = fit.estimates[name]
    note = " (at its bound)" if e.at_bound else " (held)" if name in fit.model.constants else ""
    # if the search did not converge, the curvature at its last point is not an uncertainty
    reliable = fit.verdict != "not_converged"
    return rounded(e.value, e.stderr if reliable else math.nan, e.unit) + note


def merit_lines(fit: FitSummary) -> list[str]:
    """Return the figures of merit and the noise of a fit as lines of at most 80 columns."""
    lines = [f"{'':<12}{'R2':>10}{f'rmse [{speed_unit()}]':>14}{'prediction':>11}"]
    for case in fit.cases:
        bodies = case.bodies
        # a fit that was read from a file does not contain the names of bodies
        named = fit.problem.data[0].record.bodies if isinstance(fit, Fit) else ()
        names = [b.name for b in named] or _NAMES[len(bodies)]
        for name, body in zip(names, bodies, strict=False):
            title = f"{case.label[:5]} {name}" if len(fit.cases) > 1 else name
            lines.append(f"{title:<12}{body.r2:>10.6f}{speed(body.rmse):>14.4g}{body.held_out:>11.4g}")
    lines.append(f"misfit {fit.misfit:.3g} times the noise (1: the residuals are noise)")
    lines.append(
        f"energy balance error {max(c.energy_drift for c in fit.cases):.2g}, "
        f"effective samples {fit.n_eff:.0f}, BIC {fit.bic:.1f}"
    )
    noises = getattr(fit, "noise", ())
    if noises:
        unit = fit.torque_unit
        pure = ", ".join(rounded(n.pure, n.pure_u, unit) for n in noises)
        text = f"process noise {pure} rms; with this model {_levels(noises)} {unit}"
        lines += wrap(text, 79, subsequent_indent="  ")
        unestablished = isinstance(fit, Fit) and fit.needs_unestablished_torque()
        if unestablished and fit.verdict == "no_lack_of_fit":
            text = "the recording does not establish this random torque without the model: "
            text += "`gyrotrack diagnose` tests whether an effect describes it better"
            lines += wrap(text, 79, initial_indent="  ", subsequent_indent="  ")
        if any(n.unresolved > n.level for n in noises):
            unresolved = ", ".join(f"{max(n.level, n.unresolved):.2g}" for n in noises)
            text = f"not separable from the angle noise, included in the uncertainties: {unresolved} {unit}"
            lines += wrap(text, 79, initial_indent="  ", subsequent_indent="  ")
    for text in angle_noise_lines(fit):
        lines += wrap(text, 79, subsequent_indent="  ")
    prior = fit.prior if isinstance(fit, Fit) else None
    if prior is not None:
        known = {name.partition("@")[0] for name in fit.estimates}
        used = [n for n in prior.names if n in known]
        lines += wrap(
            f"prior from {prior.source}: {', '.join(used) or 'none of its parameters is in the model'}",
            79,
            subsequent_indent="  ",
        )
    for text in getattr(fit, "findings", ()):
        lines += wrap(text, 79, subsequent_indent="  ")
    return lines


# names of the bodies of a fit that was read from a file, by their number
_NAMES: dict[int, tuple[str, ...]] = {0: (), 1: ("body",), 2: ("casing", "rotor")}


def _levels(noises: Sequence[Noise]) -> str:
    return ", ".join(f"{n.level:.2g}" for n in noises)


def angle_noise_lines(fit: FitSummary) -> list[str]:
    """Return level and correlation time of the correlated angle noise of each camera, in words."""
    found = []
    for label, noise in _angle_noises(fit):
        level = rounded(1e3 * noise.sigma, 1e3 * noise.sigma_u, "mrad")
        parts = [f"{level}, correlation time {noise.time:.2g} s"] if noise.sigma else []
        if noise.turn_sigma:
            level = rounded(1e3 * noise.turn_sigma, 1e3 * noise.turn_sigma_u, "mrad")
            parts.append(f"{level} that repeats with the turn, changing in {noise.turn_time:.2g} s")
        found.append(f"correlated angle noise{label}: {'; '.join(parts)}")
    return found


def _angle_noises(fit: FitSummary) -> list[tuple[str, AngleNoise]]:
    data = fit.problem.data if isinstance(fit, Fit) else ()
    found = []
    for d in data:
        case = f" of {d.record.label}" if len(data) > 1 else ""
        found += [(case, d.angle_noise), (f"{case} in the rotor's windows", d.rotor_angle_noise)]
    return [(label, noise) for label, noise in found if noise.is_significant]


def not_determined(estimates: Mapping[str, Estimate], limit: float = 1.0) -> list[str]:
    """Return the parameters with a standard uncertainty larger than `limit` times their value."""
    return [
        k
        for k, e in estimates.items()
        if not k.startswith("initial.") and math.isfinite(e.stderr) and e.stderr > limit * abs(e.value)
    ]


_FEWEST_TURNS = 5.0
"""In records with fewer turns of the casing, a harmonic of its angle is not distinguished from a slow torque [1].
Measured: constant torques imitate a first harmonic of up to 6 standard deviations within 1.5 turns, of 2.9 within three
turns, and of no more than noise within six turns; the recordings are not stated."""


@dataclass(frozen=True, repr=False)
class Fit(FitSummary):
    """A fitted model.

    Attributes
    ----------
    model : Model
        The fitted model.
    estimates : dict of str to Estimate
        Every parameter and initial value by name.
    chi2, rows, n_eff, deviance, bic : float
        `chi2` is the chi-square of the rows that a model can describe, and `rows` is the number of these rows; only
        these rows differ between models, and all other combinations of the samples are noise. `n_eff` is the effective
        number of samples. `deviance` is minus twice the log-likelihood (up to a constant of the data). `bic` is
        deviance + p ln rows, with p fitted parameters.
    converged : bool
        Whether the optimisation converged.
    """

    model: Model
    labels: tuple[str, ...]
    estimates: dict[str, Estimate]
    chi2: float
    rows: int
    n_eff: float
    deviance: float
    bic: float
    converged: bool
    covariance: Array = field(repr=False)
    theta: Array = field(repr=False)
    noise: tuple[Noise, ...] = field(repr=False)
    problem: Problem = field(repr=False)
    predictions: tuple[Prediction, ...] = field(repr=False)

    def _origin(self) -> Origin:
        records = [d.record for d in self.problem.data]
        sources, digests = tuple(r.source for r in records), tuple(r.digest for r in records)
        return self.problem.layout.names, self.covariance, sources, digests

    @cached_property
    def cases(self) -> tuple[CaseMetrics, ...]:
        """Figures of merit of each case."""
        pure = (
            Projection(d, n.whitener.at(n.pure)) for d, n in zip(self.problem.data, self.noise, strict=True)
        )
        return tuple(
            case_metrics(c, project, p, self.theta)
            for c, project, p in zip(self.problem.cases, pure, self.predictions, strict=True)
        )

    @cached_property
    def held_out_of_first_casing(self) -> float:
        """Cross-validation error of the casing of the first case, without the other figures of merit."""
        (data, *_), (noise, *_), (prediction, *_) = self.problem.data, self.noise, self.predictions
        project = Projection(data, noise.whitener.at(noise.pure))
        main = data.record.mechanism.main
        return held_out(data, project, prediction, [main])[main]

    @property
    def body_name(self) -> str:
        """Name of a single body; empty for a gyroscope and for a body without a name."""
        return self.problem.data[0].record.name

    def fit_report(self, least_correlation: float = LEAST_CORRELATION) -> str:
        """Return model, figures of merit, parameters and their correlations as text.

        Parameters
        ----------
        least_correlation : float
            Smallest correlation that is listed.
        """
        require("least_correlation", least_correlation, NOT_NEGATIVE)
        return report(self, least_correlation)

    def eval(
        self, time: Any = None, *, body: str | None = None, case: int = 0, quantity: str | None = None
    ) -> Array:
        """Return the fitted curve.

        Parameters
        ----------
        time : array_like, shape (n,), optional
            Times within the record [s]; by default the times of the samples (of all windows of a rotor, joined).
        body : str, optional
            "casing", "rotor", or the name of the body; by default the casing, the single or the main body.
        case : int
            Index of the case.
        quantity : {"angle", "omega"}, optional
            Angle [rad] or speed [rad/s]; by default what was measured. An angle has the start angle of the fit.

        Returns
        -------
        ndarray, shape (n,)

        Raises
        ------
        EstimationError
            If a time is outside the record, if there is no such body or case, or if angles are requested but speeds
            were measured.
        """
        return evaluate(self, time, self._place(body, case), case, quantity)

    def _place(self, body: str | None, case: int) -> int:
        require("body", body, TEXT.optional)
        record = self.problem.data[self._index(case)].record
        places = {b.name: b.state for b in record.bodies} | {record.mechanism.main: MAIN}
        if body is not None and body not in places:
            raise EstimationError(f"there is no body {str(body)[:30]!r}", f"bodies: {', '.join(places)}")
        return MAIN if body is None else places[body]

    def _index(self, case: int) -> int:
        require("case", case, INTEGER)
        if not 0 <= case < len(self.labels):
            raise EstimationError(
                f"there is no case {case}", f"give an index from 0 to {len(self.labels) - 1}"
            )
        return int(case)

    def _refuse_body(self, body: int) -> None:
        names = self.problem.layout.model.mechanism.bodies
        numbers = " or ".join(f"{i} ({name})" for i, name in enumerate(names))
        require("body", body, Kind(numbers, lambda x: INTEGER.fits(x) and x in range(len(names))))

    @cached_property
    def residual(self) -> Array:
        """Measured minus fitted value of every sample, divided by its stated standard uncertainty.

        The samples are sorted by case; the samples of the casing or the single body precede the samples of the rotor
        windows.
        """
        return residuals_of(self)

    def to_arviz(
        self, draws: int = 1000, *, chains: int = 4, method: str = "linearised", seed: int = 0
    ) -> Any:
        """Return draws from the posterior distribution of the parameters, for ArviZ (needs arviz).

        Parameters
        ----------
        draws, chains : int
            Number of draws of each chain, and of chains.
        method : {"linearised", "emcee"}
            "linearised" is the normal distribution of the linearised problem. "emcee" samples the likelihood with a
            flat prior within the bounds (about 10 ms for each draw); it may need more chains.
        seed : int
            Random seed.

        Returns
        -------
        arviz.InferenceData or xarray.DataTree
            The group `posterior`, with the names of `params`.

        Raises
        ------
        EstimationError
            If arviz or emcee is not installed, or an argument is wrong.
        """
        from fitting.inference._posterior import to_arviz

        require("method", method, TEXT)
        require("seed", seed, SEED)
        index = self.problem.layout.index
        names = {self.shown_name(k): index[k] for k in self.estimates if k in index}
        return to_arviz(self, names, count=draws, chains=chains, method=method, seed=seed)

    @cached_property
    def lack_of_fit(self) -> LackOfFit:
        """The lack-of-fit test against slow torques."""
        return lack_of_fit(self.problem, self.predictions, self.noise)

    @cached_property
    def smooth_test(self) -> SmoothTest:
        """The speed on which the residual torque depends most significantly; p = 1 if no torque can be tested."""
        return smooth_test(self.problem, self.predictions, self.noise)

    @cached_property
    def periodogram_peak(self) -> PeriodogramPeak | None:
        """The most significant peak of the periodograms of all cases; None if no record is long enough."""
        return periodogram_peak(self.problem, self.predictions, self.noise)

    def significant_peak(self, criteria: Criteria | None = None) -> PeriodogramPeak | None:
        """Return the most significant peak of the periodograms if it contradicts an adequate fit, else None.

        Parameters
        ----------
        criteria : Criteria
            Its `doubt_adequate` is the limit of the p-value. By default the criteria of the fit.
        """
        peak, limit = self.periodogram_peak, (criteria or self.criteria).doubt_adequate
        return peak if peak is not None and peak.p_value < limit else None

    @cached_property
    def verdict(self) -> str:
        """One of "no_lack_of_fit", "lack_of_fit", "not_determined" and "not_converged"."""
        if self.lacks_restoring_torque:
            # a significant lack of fit precedes, because a fit of a wrong model need not converge
            return "lack_of_fit"
        if not self.converged:
            return "not_converged"
        if self.has_lack_of_fit():
            return "lack_of_fit"
        return "not_determined" if self.undetermined else "no_lack_of_fit"

    def has_lack_of_fit(self, criteria: Criteria | None = None) -> bool:
        """Return whether a test finds a significant lack of fit; no candidate effect is tested.

        Parameters
        ----------
        criteria : Criteria
            The limits of all tests. By default the criteria of the fit.
        """
        criteria = criteria or self.criteria
        return (
            self.fails(criteria)
            or self.needs_random_torque(criteria)
            or self.has_torque_of_the_angle(criteria)
            or self.has_smooth_law(criteria)
            or self.significant_peak(criteria) is not None
            or self.has_smooth_torque(criteria)
        )

    @property
    def findings(self) -> tuple[str, ...]:
        """Faults of the measurement that the recordings show without a model, as sentences."""
        several = len(self.problem.data) > 1
        return tuple(
            f"{d.record.label}: {text}" if several else text for d in self.problem.data for text in d.findings
        )

    @property
    def lacks_restoring_torque(self) -> bool:
        """Whether the body oscillates but the model has no restoring torque; residuals then have no meaning."""
        return not (self.problem.data[0].motion.is_smooth or self.model.restoring)

    @property
    def criteria(self) -> Criteria:
        """The criteria of the verdict, with which the noise of the recordings was measured as well."""
        return self.problem.data[0].criteria

    def fails(self, criteria: Criteria | None = None) -> bool:
        """Return whether the fit converged and has a significant lack of fit.

        Parameters
        ----------
        criteria : Criteria
            Its `lack_of_fit` is the limit of the p-value of the test against slow torques. In a case whose reduced
            chi-square exceeds `reduced_chi2`, the same limit applies to the p-value of chi-square. By default the
            criteria of the fit.
        """
        criteria = criteria or self.criteria
        return self.converged and (
            self.lack_of_fit.p_value < criteria.lack_of_fit or any(c.fails(criteria) for c in self.cases)
        )

    @cached_property
    def angle_harmonics(self) -> tuple[AngleHarmonics, ...]:
        """Harmonics of the unmodelled torque in the angle of the casing, of each case whose angle is known."""
        return tuple(angle_harmonics(self))

    def has_torque_of_the_angle(self, criteria: Criteria | None = None) -> bool:
        """Return whether an unmodelled torque repeats once or twice a turn of the casing, over at least five turns.

        Parameters
        ----------
        criteria : Criteria
            Its `harmonic_sigma` is the smallest significant amplitude, in standard deviations. By default the
            criteria of the fit.
        """
        least = (criteria or self.criteria).harmonic_sigma
        return any(
            found.size(n)[1] >= least
            for found in self.angle_harmonics
            for n in (1, 2)
            if found.turns >= _FEWEST_TURNS
        )

    def has_excess_noise(self, criteria: Criteria | None = None) -> bool:
        """Return whether the fit needs more process noise than the recording shows without a model.

        Parameters
        ----------
        criteria : Criteria
            Its `excess_noise` is the smallest excess that counts, in standard uncertainties of the recording's level.
            By default the criteria of the fit.
        """
        criteria = criteria or self.criteria
        return any(n.level > n.pure + criteria.excess_noise * n.pure_u for n in self.noise)

    def needs_random_torque(self, criteria: Criteria | None = None) -> bool:
        """Return whether the fit needs a random torque that the recording does not show without the model.

        For a joint fit the result is False: only the lack-of-fit test decides, because the level of each case also
        depends on the parameters that the recordings share.

        Parameters
        ----------
        criteria : Criteria
            Its `excess_noise` is the smallest excess that counts, in standard uncertainties of the recording's level.
            Its `random_torque_evidence` is the smallest fall of the deviance by the random torque. By default the
            criteria of the fit.
        """
        criteria = criteria or self.criteria
        if len(self.noise) > 1:
            return False
        (n,) = self.noise
        excess = n.level > n.pure + criteria.excess_noise * n.pure_u
        return excess and n.excess > criteria.random_torque_evidence

    def needs_unestablished_torque(self, criteria: Criteria | None = None) -> bool:
        """Return whether a case needs a random torque whose level its recording does not establish.

        The residuals are then consistent with noise, but a missing effect may describe them better.

        Parameters
        ----------
        criteria : Criteria
            Its `random_torque_evidence` is the fall of the deviance by the random torque. By default the criteria of
            the fit.
        """
        criteria = criteria or self.criteria
        return any(n.raised and n.excess > criteria.random_torque_evidence for n in self.noise)

    def most_likely_noise(self, criteria: Criteria | None = None) -> LikelyNoise:
        """Return the noise with the most likely slow random torque of each case, if that lowers the deviance.

        Parameters
        ----------
        criteria : Criteria
            Limits of level and correlation time. By default the criteria of the fit.
        """
        return most_likely_noise(
            self.problem, self.predictions, self.noise, self.theta, self.deviance, criteria or self.criteria
        )

    def has_smooth_law(self, criteria: Criteria | None = None) -> bool:
        """Return whether the residual torque depends on a speed, and no slow random torque explains this dependence.

        Parameters
        ----------
        criteria : Criteria
            Its `doubt_adequate` is the limit of the p-value. By default the criteria of the fit.
        """
        criteria = criteria or self.criteria
        limit = criteria.doubt_adequate
        if self.smooth_test.p_value >= limit:
            return False
        if not all(d.motion.is_smooth for d in self.problem.data):
            return True
        likely = self.most_likely_noise(criteria)
        if not (likely.is_raised and likely.describes(self.rows, criteria)):
            return True
        # if a law of a speed is missing, the residuals depend on this speed; the residuals of a random torque do not
        return smooth_test(self.problem, self.predictions, likely.noise).p_value <= limit

    def has_smooth_torque(self, criteria: Criteria | None = None) -> bool:
        """Return whether a smooth or periodic torque describes a case better than the random torque of the model.

        Only a random torque that the recording does not establish is compared (see `needs_unestablished_torque`).

        Parameters
        ----------
        criteria : Criteria
            Its `random_torque_evidence` and `lack_of_fit` decide. By default the criteria of the fit.
        """
        criteria = criteria or self.criteria
        moving = ~self.problem.layout.at_bound(self.theta)
        for data, p, n in zip(self.problem.data, self.predictions, self.noise, strict=True):
            unestablished = n.raised and n.excess > criteria.random_torque_evidence
            if unestablished and data.motion.is_smooth and not data.driven:
                free = free_columns(data, p, moving)
                if any(t.is_better(criteria) for t in smooth_torques(data, p, n, free, criteria)):
                    return True
        return False

    @property
    def undetermined(self) -> list[str]:
        """Parameters that the data do not determine (`undetermined_at` the criteria of the fit)."""
        return self.undetermined_at(self.criteria)

    def undetermined_at(self, criteria: Criteria) -> list[str]:
        """Return the parameters whose standard uncertainty exceeds `Criteria.undetermined` times their value.

        Phases, and parameters with a prior, are not among them.
        """
        known = {k for d in self.problem.data if d.prior is not None for k in d.prior.names}
        return [
            k
            for k in not_determined(self.estimates, criteria.undetermined)
            if k.partition("@")[0] not in known and self.problem.layout.parameter(k).role != "phase"
        ]

    @property
    def reduced_chi2(self) -> float:
        """Chi-square of the casings, divided by their effective number of samples."""
        return sum(
            c.casing.reduced_chi2 * d.casing.n_effective
            for c, d in zip(self.cases, self.problem.data, strict=True)
        ) / sum(d.casing.n_effective for d in self.problem.data)

    @property
    def rmse_casing(self) -> float:
        """Rms residual speed of the casings [rad/s]."""
        return math.sqrt(sum(c.casing.rmse**2 for c in self.cases) / len(self.cases))

    @property
    def held_out(self) -> float:
        """Rms cross-validation error of the casings, in units of the noise."""
        return math.sqrt(sum(c.casing.held_out**2 for c in self.cases) / len(self.cases))

    @property
    def samples(self) -> int:
        """Number of samples of all runs."""
        runs = [(d.record.casing, *d.record.rotor) for d in self.problem.data]
        return sum(len(r) for several in runs for r in several)

    @cached_property
    def rmse_noise(self) -> float:
        """Rms residual speed of the casings that noise alone would give after the smoothing of the paper [rad/s]."""
        both = zip(self.problem.data, self.predictions, strict=True)
        return math.sqrt(float(np.mean([smoothing_noise(d, p.path) ** 2 for d, p in both])))

    @property
    def bic_noise(self) -> float:
        """BIC that a model with the same number of parameters would have if its residuals were noise."""
        logs = sum(n.whitener.at(n.tested).log_determinant for n in self.noise)
        free = int(self.problem.layout.is_free.sum())
        return logs + self.rows - free + free * float(np.log(self.rows))

    @property
    def prior(self) -> Prior | None:
        """The prior of the parameters; None if the fit has none."""
        return next((d.record.prior for d in self.problem.data if d.record.prior is not None), None)

    @property
    def generated(self) -> bool:
        """Whether a rotor curve was generated instead of measured (see `fitting.study._preparation`)."""
        return any(d.record.generated for d in self.problem.data)

    def measured_speeds(self, case: int, body: int) -> list[tuple[Array, Array]]:
        """Return times [s] and smoothed speeds [rad/s] of each run of a body, given its index in the state vector.

        Parameters
        ----------
        case : int
            Index of the case.
        body : int
            0 is the rotor, 1 the casing, the single or the main body; larger indices are further bodies of a chain.
        """
        data = self.problem.data[self._index(case)]
        self._refuse_body(body)
        own = [run for run in data.record.rotor if run.state == body]
        runs = [data.record.casing] if body == MAIN else own
        return [speeds(run, data.record.quantity, data.smoothing_width) for run in runs]

    def modelled_speed(self, case: int, body: int, time: Array) -> tuple[Array, Array]:
        """Return the modelled speed of a body and its standard uncertainty at some times [rad/s].

        Parameters
        ----------
        case : int
            Index of the case.
        body : int
            0 is the rotor, 1 the casing, the single or the main body; larger indices are further bodies of a chain.
        time : ndarray, shape (n,)
            Times [s].
        """
        require("time", time, NUMBER.several)
        self._refuse_body(body)
        return modelled_speed(self, self._index(case), body, np.asarray(time, dtype=float))

    @property
    def units(self) -> Units:
        """Units of torques and of quantities that follow from torques."""
        return self.problem.layout.units

    @property
    def torque_unit(self) -> str:
        """Unit of torques: "N m", or "rad/s2" where they are per unit of inertia."""
        return self.units.torque

    def angle_residuals(self, case: int) -> tuple[AngleResidual, ...]:
        """Return the residual angle of a case's casing, or single body, and of its rotor in each window.

        Parameters
        ----------
        case : int
            Index of the case.

        Raises
        ------
        EstimationError
            If speeds were fitted, not angles.
        """
        return angle_residuals(self, case)

    def name(self, effect: Effect | str) -> EffectName:
        """Return an effect or a parameter by its name, for a reader; see `fitting.effect_name`."""
        own = () if isinstance(effect, str) else (effect,)
        key = effect if isinstance(effect, str) else effect.name
        return effect_name(key, self.problem.data[0].record.body, (*own, *self.model.effects))

    def speed_residuals(self, case: int) -> tuple[SpeedResidual, tuple[SpeedResidual, ...]]:
        """Return the residual speed of a case's casing, and of its rotor in each window (or of all other runs).

        Parameters
        ----------
        case : int
            Index of the case.
        """
        return speed_residuals(self, self._index(case))

    def plot(self, ax: Axes | None = None, *, case: int = 0, residual: bool = False) -> Figure:
        """Draw measured and modelled speeds, and their residuals, with bands of 2 sigma (matplotlib).

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes for one chart, of the casing or the single body; by default a new figure shows all charts.
        case : int
            Index of the case that is drawn into `ax`.
        residual : bool
            Draw the residual of the speed into `ax`, instead of the speed.

        Returns
        -------
        matplotlib.figure.Figure
            The new figure, or the figure of `ax`.
        """
        if ax is not None:
            self._draw(ax, case, MAIN, residual=residual)
            return figure_of(ax)
        cases = len(self.labels)
        bodies = sorted({b.state for d in self.problem.data for b in d.record.bodies}, reverse=True)
        drawn = figure(4.2 * cases + 3.0, 4.0 * len(bodies))
        axes = drawn.subplots(2 * len(bodies), cases, squeeze=False, height_ratios=[1.3, 1] * len(bodies))
        for i, label in enumerate(self.labels):
            for k, body in enumerate(bodies):
                self._draw(axes[2 * k, i], i, body, residual=False)
                self._draw(axes[2 * k + 1, i], i, body, residual=True)
            axes[0, i].set_title(printable(label), loc="left")
        return drawn

    def _draw(self, ax: Axes, case: int, body: int, *, residual: bool) -> None:
        record = self.problem.data[case].record
        suffix = record.mechanism.speeds[body].removeprefix("omega_")
        symbol = rf"$\omega_{suffix}$" if len(suffix) == 1 else rf"$\omega_\mathrm{{{suffix}}}$"
        if residual:
            casing, rotor = self.speed_residuals(case)
            own = [r for r, run in zip(rotor, record.rotor, strict=True) if run.state == body]
            draw_speed_residual(ax, [casing] if body == MAIN else own)
            ax.set_ylabel(f"{symbol}: residual [rad/s]")
        else:
            runs = self.measured_speeds(case, body)
            points = _POINTS if len(runs) == 1 else _POINTS // 10
            times = [np.linspace(time[0], time[-1], points) for time, _ in runs]
            draw_speed(ax, runs, [(t, *self.modelled_speed(case, body, t)) for t in times])
            ax.set_ylabel(f"{symbol} [rad/s]")
        ax.set_xlabel("time [s]")
        # above the axes
        above: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}
        ax.legend(fontsize="small", frameon=False, ncols=2, **above)

    def conf_interval(
        self, *names: str, level: float | Sequence[float] = 0.95
    ) -> dict[str, Interval] | dict[str, dict[float, Interval]]:
        """Return confidence intervals of parameters by their profile likelihood.

        For each value of the parameter, all others are fitted again. At the ends of the interval the deviance exceeds
        its minimum by the quantile of chi-square with one degree of freedom. The interval need not be symmetric. Each
        parameter takes about ten fits.

        Parameters
        ----------
        *names : str
            Names of fitted parameters, or their unique ends; by default all but the initial speeds.
        level : float or sequence of float
            Probability that the interval contains the value; several levels give several intervals.

        Returns
        -------
        dict of str to Interval, or of str to dict of float to Interval
            `lower` and `upper` in the unit of the parameter, and whether each end is open; for several levels, one
            interval for each.

        Raises
        ------
        EffectError
            If no fitted parameter has one of the names.
        EstimationError
            If the level is not between 0 and 1.
        """
        from fitting.inference._profile import profile

        layout = self.problem.layout
        free = [n for n, f in zip(layout.names, layout.is_free, strict=True) if f and n in self.estimates]
        find = Names(tuple(free), self.body_name)
        chosen = {n: find(n) for n in names} or {
            self.shown_name(n): n for n in free if not n.startswith("initial.")
        }
        if isinstance(level, float | int):
            return {n: profile(self, key, float(level)) for n, key in chosen.items()}
        require("level", level, NUMBER.several)
        return {n: {float(x): profile(self, key, float(x)) for x in level} for n, key in chosen.items()}

    def _repr_html_(self) -> str:
        merits = [
            (
                c.label,
                name,
                f"{body.r2:.6f}",
                *(short(v) for v in (body.rmse, body.held_out)),
            )
            for c in self.cases
            for name, body in zip(
                [b.part if len(c.bodies) > 1 else "body" for b in self.problem.data[0].record.bodies],
                c.bodies,
                strict=False,
            )
        ]
        numbers = [
            (name, with_uncertainty(e.value, e.stderr, e.unit), "active bound" if e.at_bound else "")
            for name, e in self.estimates.items()
        ]
        misfit = f"misfit {short(self.misfit)} times the noise"
        head = f"{', '.join(self.labels)}; {misfit}, BIC {self.bic:.1f}, effective samples {self.n_eff:.0f}"
        columns = ("case", "body", "R²", "rms [rad/s]", "cross-validation error [noise]")
        return block(
            headline(self.verdict, head),
            table("figures of merit", columns, merits),
            table("parameters", ("parameter", "value", ""), numbers),
        )

    def energy(self, label: str | None = None) -> EnergyBalance:
        """Return the energy balance of a case (by default the first): kinetic energy plus losses against time.

        Parameters
        ----------
        label : str, optional
            Name of the case.

        Raises
        ------
        EstimationError
            If there is no case with this label.
        """
        require("label", label, TEXT.optional)
        if label is not None and label not in self.labels:
            raise EstimationError(f"there is no case {label[:40]!r}", "it has: " + ", ".join(self.labels))
        i = 0 if label is None else self.labels.index(label)
        return energy_balance(self.problem.cases[i], self.theta, self.predictions[i].path)

    @property
    def variance_factor(self) -> float:
        """Factor by which a lack of fit increases the variances of all parameters."""
        free = ~self.problem.layout.at_bound(self.theta) & self.problem.layout.is_free
        return variance_factor(self.chi2, self.rows - int(free.sum()))

    @property
    def torque_noise(self) -> float:
        """Process noise of this model: rms torque [N m]."""
        return max(n.level for n in self.noise)


def outcome(problem: Problem, theta: Array, noise: tuple[Noise, ...], *, converged: bool) -> Fit:
    """Return the fit at these variables."""
    layout = problem.layout
    theta = follow(theta, layout.tied)
    predictions = tuple(problem.predict(theta))
    r, j = problem.residuals(predictions)
    chi2 = float(r @ r)
    rows = problem.rows
    at_bound = layout.at_bound(theta)
    noise = tuple(_with_unresolved(problem, predictions, noise, at_bound))
    determined = ~surely_at_bound(layout, at_bound, r, j) & layout.is_free
    if any(n.unresolved > n.level for n in noise):
        j = problem.with_noise([n.with_unresolved for n in noise]).residuals(predictions)[1]
    covariance = covariance_of(j, determined)
    covariance += _by_integration_errors(problem, theta, predictions, covariance)
    # if there is a significant lack of fit, an uncertainty from the noise alone is too small
    factor = variance_factor(chi2, rows - int((~at_bound & layout.is_free).sum()))
    covariance *= factor
    if factor > _INEXACT and any(d.driven for d in problem.data):
        covariance = _with_slow_residuals(problem, predictions, covariance)
    if layout.tied:
        slope = chain(theta, layout.tied)
        covariance = slope @ covariance @ slope.T
    deviance = chi2 + sum(n.whitener.log_determinant for n in noise)
    return Fit(
        model=layout.model,
        labels=tuple(r.label for r in layout.records),
        estimates=_estimates(layout, theta, np.sqrt(np.diag(covariance)), at_bound),
        chi2=chi2,
        rows=rows,
        n_eff=sum(d.n_effective for d in problem.data),
        deviance=deviance,
        bic=deviance + int(layout.is_free.sum()) * float(np.log(rows)),
        converged=converged,
        covariance=covariance,
        theta=theta,
        noise=noise,
        problem=problem,
        predictions=predictions,
    )


_INEXACT = 1.5
"""The residuals of a driven body do not count as white noise if a lack of fit increases the variances by more than this
factor [1]. Chosen: a smaller value enlarges uncertainties by chance, a larger one understates uncertainties."""


def _with_slow_residuals(problem: Problem, predictions: Sequence[Prediction], covariance: Array) -> Array:
    """Return the covariance, increased where slow residuals change a variable by more than its standard error.

    The fit of a driven body assumes white noise, but the residuals of a model that is not exact follow each change of
    the input. Let s_i = J_i' r_i be the score of block i. The variance (W. Newey, K. West, Econometrica 55, 703 (1987))
    is (J'J)^-1 [sum of w_l s_i s_(i+l)'] (J'J)^-1, with weights w_l that fall linearly with the lag l to zero at the
    cube root of the number of blocks. The correlations of the fit are kept.
    """
    count = len(covariance)
    information, scatter = np.zeros((count, count)), np.zeros((count, count))
    for data, project, p in zip(problem.data, problem.projections, predictions, strict=True):
        columns = project.unexplained(p.jacobian)
        information += columns.T @ columns
        scores = columns * project(p.rows - data.z)[:, None]
        rows = len(data.casing.z)
        blocks = scores[:rows].reshape(-1, data.casing.lift.shape[1], count).sum(axis=1)
        scatter += blocks.T @ blocks + scores[rows:].T @ scores[rows:]
        lags = math.ceil(len(blocks) ** (1 / 3))
        for lag in range(1, min(lags, len(blocks) - 1) + 1):
            product = blocks[:-lag].T @ blocks[lag:]
            scatter += (1 - lag / (lags + 1)) * (product + product.T)
    variance = np.diag(covariance)
    used = np.flatnonzero(np.isfinite(variance) & (variance > 0) & (np.diag(information) > 0))
    size = np.sqrt(np.diag(information)[used])
    scale = np.outer(size, size)
    inverse = np.linalg.pinv(information[np.ix_(used, used)] / scale, rcond=1e-12, hermitian=True) / scale
    slow = np.diag(inverse @ scatter[np.ix_(used, used)] @ inverse)
    factors = np.ones(count)
    factors[used] = np.sqrt(np.maximum(slow / variance[used], 1.0))
    return np.asarray(covariance * np.outer(factors, factors))


def _by_integration_errors(
    problem: Problem, theta: Array, predictions: Sequence[Prediction], covariance: Array
) -> Array:
    """Return the covariance of the variables due to the errors of integrated angles, which are arguments of laws."""
    parts = [np.zeros((len(theta), 0))]
    for case, project, p in zip(problem.cases, problem.projections, predictions, strict=True):
        errors = case.integration_errors(p, theta)
        gradient = np.zeros((len(theta), errors.shape[1]))
        gradient[p.places] = project.unexplained(p.columns).T @ project(errors)
        parts.append(gradient)
    shifts = np.nan_to_num(covariance, posinf=0.0) @ np.concatenate(parts, axis=1)
    return np.asarray(shifts @ shifts.T)


def _with_unresolved(
    problem: Problem, predictions: Sequence[Prediction], noise: Sequence[Noise], at_bound: NDArray[np.bool_]
) -> Iterator[Noise]:
    """Yield the noise of each case with the random torque that its residuals do not exclude.

    A random torque can cause correlated deviations of an angle, but not white deviations.
    """
    for data, p, n in zip(problem.data, predictions, noise, strict=True):
        unresolved = 0.0
        if n.excess < CONSISTENT and not data.angle_noise.is_white:
            columns = np.concatenate([p.columns[:, ~at_bound[p.places]], data.nuisance], axis=1)
            unresolved = unresolved_level(n.whitener, data.z - p.rows, columns, n.pure)
        yield replace(n, unresolved=unresolved)


def _estimates(
    layout: ParameterLayout, theta: Array, errors: Array, at_bound: NDArray[np.bool_]
) -> dict[str, Estimate]:
    limits = np.transpose(layout.bounds()).tolist()
    ties = {find_key(name, layout.model.free): text for name, text in layout.ties.items()}
    estimates = {}
    for i, name in enumerate(layout.names):
        if name.partition("@")[0] in layout.absent:
            continue
        bound = bool(at_bound[i])
        error = math.nan if bound else float(errors[i])
        unit = layout.unit(name)
        expr = ties.get(name.partition("@")[0])
        estimates[name] = Estimate(
            float(theta[i]), error, unit, bound, expr is None, limits[i][0], limits[i][1], expr
        )
    for key, value in layout.model.constants.items():
        estimates[key] = Estimate(value, math.nan, layout.unit(key), at_bound=False, vary=False)
    return estimates
