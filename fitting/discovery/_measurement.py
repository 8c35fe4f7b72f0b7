"""Measurement errors as alternatives to a missing effect: start times of the rotor windows, slipped turns.

An error dt_i of the start of window i changes the angles of the window by c_i dt_i, apart from the free phase (see
`fitting.inference._case_data`). If the uncertainty of the starts is not stated, all dt_i are drawn from a normal
distribution with an unknown standard deviation s. Let r be the residuals and C = (c_1, c_2 ...) the columns, both
whitened by the noise of the fit and orthogonal to its free columns. Then

    -2 log L(s) = r'r - r'C (C'C + 1/s^2)^-1 C'r + log det(1 + s^2 C'C).

The evidence is twice the logarithm of the mean of L(s) / L(0) over s, with ln s uniform from a tenth to ten times
`Criteria.start_u`. The evidence integrates over all parameters with their priors, so it is directly comparable with the
fall of BIC of an effect. The errors are estimated by the conditional means (C'C + 1/s^2)^-1 C'r.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting.discovery._score import Score, ScoreContext
from fitting.effects._library import SLIP, START
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._linear_algebra import orthogonal_to
from fitting.inference._noise import Noise
from fitting.inference._parameters import ParameterLayout
from fitting.inference._params import Estimate
from fitting.inference._problem import Problem, recording_noise, refine_level
from fitting.inference._result import Fit, outcome
from fitting.inference._slips import Slip
from fitting.inference._trace import attempt

Array = NDArray[np.float64]

_LEVELS = 21
"""Number of trial standard deviations of the start times, over two decades [1]. Chosen: a smaller number makes the mean
likelihood coarse, a larger one costs time."""
_REFITS = 3
"""Largest number of fits in which the uncertainty of the starts is improved from fit to fit [1]. Chosen: the second fit
corrects the bias of the base; a smaller number leaves this bias, a larger one costs time."""
_SAME_SIZE = math.log(2.0)
"""The fit is not repeated if the logarithm of the size of the start errors changes by less than this value [1].
Derived: n errors determine their size with a relative uncertainty of 1 / sqrt(2 n), 40 % for three errors; a smaller
value repeats fits that do not differ."""


class StartErrors:
    """The errors of the starts of all rotor windows of a fit, as random effects of unknown standard deviation."""

    def __init__(self, base: Fit, criteria: Criteria) -> None:
        self.base, self.criteria = base, criteria
        context = ScoreContext(base, 1)
        columns, self._names = [], []
        several = len(base.problem.data) > 1
        for index, data in enumerate(base.problem.data):
            for i, own in data.start_columns():
                column = np.zeros(int(context.ends[-1]))
                column[context.ends[index] : context.ends[index + 1]] = own
                columns.append(column)
                at = f" of {data.record.label}" if several else ""
                self._names.append(f"{START.name}.dt@window {i + 1}{at}")
        rotated = context.rotated(np.stack(columns, axis=1))
        sizes = np.geomspace(0.1, 10.0, _LEVELS) * criteria.start_u
        lowest = min(level.deviance for level in context.levels)
        best = (-math.inf, 0, 0)
        falls = []
        for k, level in enumerate(context.levels):
            c = orthogonal_to(level.basis, level.gain[:, None] * rotated)
            gram, b = c.T @ c, c.T @ level.residual
            fall = np.array([_fall(gram, b, s) for s in sizes]) + lowest - level.deviance
            falls.append(fall)
            top = int(np.argmax(fall))
            best = max(best, (float(fall[top]), k, top))
        _, k, top = best
        level, self.u = context.levels[k], float(sizes[top])
        c = orthogonal_to(level.basis, level.gain[:, None] * rotated)
        covariance = np.linalg.inv(c.T @ c + np.eye(c.shape[1]) / self.u**2)
        self.errors: Array = covariance @ (c.T @ level.residual)
        self.stderrs: Array = np.sqrt(np.diag(covariance))
        self.fall = best[0]
        whole = np.array(falls)
        self.evidence = float(2 * np.log(np.mean(np.exp(0.5 * (whole.max(axis=0) - best[0])))) + best[0])
        direction = c @ self.errors
        self.direction: Array = direction / max(float(np.linalg.norm(direction)), 1e-300)

    @property
    def p_value(self) -> float:
        """Probability of this fall of the deviance if the starts have no errors.

        The parameter s is then at its bound 0 in half of the data sets.
        """
        from scipy.special import chdtrc

        return 0.5 * float(chdtrc(1, max(self.fall, 0.0)))

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The error of each start with its standard uncertainty [s], by window."""
        return {
            name: Estimate(float(value), float(u), "s", at_bound=False)
            for name, value, u in zip(self._names, self.errors, self.stderrs, strict=True)
        }

    @property
    def score(self) -> Score:
        """The fall of the deviance and the estimated errors, in the form of the score of a candidate."""
        none = np.zeros(0)
        shape: tuple[dict[str, float], ...] = ({},)
        size = max(self.fall, 0.0)
        return Score(
            START, size, self.errors, shape, 1, 1, absorbed=False, direction=self.direction, null=none
        )

    def evidence_of(self, refitted: Fit) -> float:
        """Return the evidence from `refitted`, a fit with starts of uncertainty `u` and the noise of its own residuals.

        Errors of the starts bias the base: its noise is too large, and the fall in a linear fit is too small. The
        average over s lowers this evidence by the same amount as the evidence of the linear fit.
        """
        more, base = (
            sum(d.start_time_noise.log_determinant for d in f.problem.data) for f in (refitted, self.base)
        )
        fall = self.base.deviance - refitted.deviance - (more - base)
        return max(self.evidence, fall + self.evidence - self.fall)

    def refit(self) -> tuple[Fit | None, StartErrors]:
        """Return the fit with starts of the uncertainty `u`, and the errors of the starts, linearised about this fit.

        Errors of the starts bias the parameters of the base. An error that is common to all windows resembles a change
        of friction, so its linear estimate about such a base may be wrong by many standard uncertainties (measured: 72
        +- 9 ms for 1 ms). The errors and their size `u` are estimated again about the refit. The fit is repeated with
        the new size until the size no longer changes. If the first refit fails, the fit is None, and the errors of this
        object are returned.
        """
        refitted, found, u = None, self, self.u
        for _ in range(_REFITS):
            with attempt("errors of the starts of the rotor windows"):
                refitted = with_start_u(self.base, u)
                found = StartErrors(_with_parameters(self.base, refitted), self.criteria)
            if refitted is None or abs(math.log(found.u / u)) < _SAME_SIZE:
                break
            u = found.u
        return refitted, found


def _with_parameters(base: Fit, other: Fit) -> Fit:
    """Return the data of a base, whose starts are exact, evaluated at the parameters and the noise of another fit."""
    problem = base.problem
    predictions = problem.predict(other.theta)
    noise = [
        recording_noise(d, p).at(n.level)
        for d, p, n in zip(problem.data, predictions, other.noise, strict=True)
    ]
    return outcome(problem.with_noise(noise), other.theta, tuple(noise), converged=other.converged)


def _fall(gram: Array, b: Array, s: float) -> float:
    n = len(b)
    gain = float(b @ np.linalg.solve(gram + np.eye(n) / s**2, b))
    return gain - float(np.linalg.slogdet(np.eye(n) + s**2 * gram)[1])


def with_start_u(base: Fit, u: float) -> Fit:
    """Return the fit in which the starts without a stated uncertainty have the standard uncertainty `u` [s]."""
    data = [d.with_start_u(u) for d in base.problem.data]
    old = base.problem.layout
    layout = ParameterLayout.of(base.model, [d.record for d in data], *old.choices, old.ranges, old.ties)
    problem = Problem.of(layout, data)
    predictions = problem.predict(base.theta)
    noise: Sequence[Noise] = [recording_noise(d, p) for d, p in zip(data, predictions, strict=True)]
    noise = refine_level(problem, base.theta, noise)
    share, per_case = old.choices
    return fit(base.model, data, share=share, per_case=per_case, start=base.values, noise=noise)


def starts_are_unknown(data: Sequence[CaseData]) -> bool:
    """Return whether the uncertainty of the start of a rotor window is not stated."""
    return any(d.is_angle and d.record.rotor and d.record.unstated_starts for d in data)


def slip_estimates(slips: Sequence[Slip]) -> dict[str, Estimate]:
    """Return the number of slipped turns, by series and time."""
    return {
        f"{SLIP.name}.n@{s.where}, {s.time:.3f} s": Estimate(float(s.turns), 0.0, "1", at_bound=False)
        for s in slips
    }
