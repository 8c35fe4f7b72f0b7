"""Profile likelihood intervals.

One parameter is held, and the deviance is minimised over all other parameters, at the noise of the original fit. At the
ends of the interval, this minimum exceeds the deviance of the fit by the quantile of chi-square with one degree of
freedom, 3.84 for 95 % (S. S. Wilks, Ann. Math. Statist. 9, 60 (1938)). The square root of this rise is nearly linear in
the parameter, so a few fits find each end. If the rise of the deviance does not reach the quantile on one side, this
side is open: the data do not limit the parameter there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EffectError, EstimationError, SimulationError
from fitting.inference._noise import Noise
from fitting.inference._optimisation import ActiveBounds, search
from fitting.inference._problem import Problem

Array = NDArray[np.float64]

LEVEL = 0.95
"""Coverage probability of an interval [1]. Chosen: the usual value; a larger one widens intervals, a smaller one
narrows them."""
_NEAR = 0.02
"""Tolerance of an end [standard deviations]. Chosen: a smaller value costs fits, a larger one rounds the end."""
_FITS = 20
"""Largest number of fits for each end [1]. Chosen: with a smaller number, some ends are not found; a larger one costs
time."""
_MOST_STEPS = 300
"""Largest number of steps of each fit [1]. Chosen: a smaller number stops before convergence, a larger one costs
time in fits that do not converge."""
_WEAK = 0.3
"""Relative uncertainty above which a parameter is weakly determined [1]. Chosen: a smaller value profiles parameters
with symmetric intervals, a larger one keeps symmetric intervals where the profile is asymmetric."""


@dataclass(frozen=True)
class Interval:
    """A confidence interval; an open end is the bound of the parameter, or the last value that was tried."""

    lower: float
    upper: float
    lower_open: bool
    upper_open: bool


class _Fitted(Protocol):
    """The attributes of a `Fit` that a profile uses."""

    @property
    def problem(self) -> Problem: ...
    @property
    def estimates(self) -> Mapping[str, Any]: ...
    @property
    def theta(self) -> Array: ...
    @property
    def covariance(self) -> Array: ...
    @property
    def noise(self) -> tuple[Noise, ...]: ...
    @property
    def chi2(self) -> float: ...
    @property
    def variance_factor(self) -> float: ...


def profile(fit: _Fitted, name: str, level: float = LEVEL) -> Interval:
    """Return the confidence interval of one parameter of a fit by its profile likelihood.

    Parameters
    ----------
    fit : Fit
        The fit; its noise is kept.
    name : str
        A key of `fit.estimates` that was fitted.
    level : float
        Probability that the interval contains the value.

    Returns
    -------
    Interval

    Raises
    ------
    EffectError
        If the fit has no such free parameter.
    EstimationError
        If the level is not between 0 and 1.
    """
    from scipy.special import ndtri

    if not 0 < level < 1:
        raise EstimationError(
            f"a confidence level of {level} is not between 0 and 1", "for example level=0.95"
        )
    names = fit.problem.layout.names
    if name not in names:
        raise EffectError(f"{name[:80]!r} is not a free parameter of this fit", "it has: " + ", ".join(names))
    held = _Held(fit, name, float(ndtri(0.5 + 0.5 * level)))
    ends = [held.end(sign) for sign in (-1.0, 1.0)]
    return Interval(ends[0][0], ends[1][0], ends[0][1], ends[1][1])


def weakly_determined(fit: _Fitted) -> list[str]:
    """Return the parameters that need a profile: a large relative uncertainty, or an active bound."""
    fitted = [n for n in fit.estimates if n in fit.problem.layout.index and not n.startswith("initial.")]
    known = ((n, fit.estimates[n]) for n in fitted)
    return [n for n, e in known if e.at_bound or e.stderr > _WEAK * abs(e.value)]


class _Held:
    """The deviance of a fit with one parameter held."""

    def __init__(self, fit: _Fitted, name: str, target: float) -> None:
        self._target = target
        old = fit.problem.layout
        layout = replace(old, ranges=dict(old.ranges))
        self._name, self._place = name, layout.index[name]
        lower, upper = layout.bounds()
        self._range = float(lower[self._place]), float(upper[self._place])
        problem = Problem.of(layout, fit.problem.data).with_noise(fit.noise)
        # the strengths d and f of a pair of laws d x^m + f x^g are fitted as transformed variables that contain both
        # strengths, so a pair with a held strength must not be transformed
        kept = tuple(v for v in problem.power_laws if self._place not in (v.d, v.f))
        self._problem = replace(problem, power_laws=kept)
        self._active: ActiveBounds | None = None
        self._best, self._theta = fit.chi2, fit.theta
        self._value = float(fit.theta[self._place])
        self._scale = fit.variance_factor
        error = math.sqrt(max(float(fit.covariance[self._place, self._place]), 0.0))
        usable = math.isfinite(error) and error > 0
        self._step = target * error if usable else 0.05 * max(abs(self._value), 1e-12)

    def _root(self, value: float, begin: Array) -> tuple[float, Array]:
        """Hold the parameter at `value`, and minimise the deviance.

        Return the square root of the rise of the deviance, and the variables at the minimum.
        """
        theta = begin.copy()
        theta[self._place] = value
        problem = self._problem.holding([self._name], theta)
        try:
            found = search(problem, theta, max_iterations=_MOST_STEPS, active=self._active)
        except (EstimationError, SimulationError):
            self._active = None
            return math.inf, begin
        self._active = found.active
        return math.sqrt(max(found.minimum.cost - self._best, 0.0) / self._scale), found.theta

    def end(self, sign: float) -> tuple[float, bool]:
        """Return one end of the interval, and whether it is open."""
        target = self._target
        limit = self._range[1] if sign > 0 else self._range[0]
        inside, z_inside, theta = self._value, 0.0, self._theta
        outside, z_outside = math.nan, math.nan
        step, repeated, within = self._step, 0, True
        for _ in range(_FITS):
            if math.isnan(outside):
                trial = inside + sign * step
            elif math.isinf(z_outside) or repeated > 1:
                trial = 0.5 * (inside + outside)
            else:
                # linear interpolation of the root of the rise
                share = float(np.clip((target - z_inside) / (z_outside - z_inside), 0.1, 0.9))
                trial = inside + share * (outside - inside)
            if sign * (limit - trial) <= 0:
                trial = limit
            z, end = self._root(trial, theta)
            if abs(z - target) < _NEAR:
                return trial, False
            # bisect if interpolation moves the same end of the bracketing interval repeatedly
            repeated = repeated + 1 if (z < target) == within else 1
            within = z < target
            if z < target:
                if trial == limit:
                    return limit, True
                step = max(step, abs(trial - inside)) * (2.0 if z < 0.5 * target else 1.3)
                inside, z_inside, theta = trial, z, end
            else:
                outside, z_outside = trial, z
        return (inside, True) if math.isnan(outside) else (inside + (outside - inside) * 0.5, False)


profile_interval = profile  # the public name of the function
