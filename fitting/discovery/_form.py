"""How well the data test the form of a named law: the smallest deviation from it that would be detected.

An effect with which the residuals are consistent with noise need not be exact: the recordings may be unable to show
that it is not. Three tests decide, about the fit with the effect, whose torque is tau(v) as a function of its variable
v.

*Detection limit.* Another law of v would deviate by tau(v) h(v) with a smooth h, here piecewise linear with independent
normal values at a few knots. With the whitened responses S to the functions at the knots, orthogonal to all that is
free, the smooth test (`fitting.discovery._lack_of_fit`) has the noncentrality

    lambda = h'S'S h,

and the limit is the rms of h, as a share of the torque, with which it detects nine in ten deviations with a probability
of 90 %. Deviations that the base absorbs are not detectable: a constant torque of the bearing, for example, in a narrow
range of speeds.

*Active bounds.* If chi-square would fall were a parameter to pass its bound, the sum of the laws has another form. With
the columns B of these parameters, orthogonal to all that is free,

    chi2 = r'B (B'B)^-1 B'r   with rank(B) degrees of freedom.

*Time.* A law with a state variable, or of time, with a fitted time constant can imitate any torque that changes slowly
in time. It is compared with a cubic spline in time on the same body: the torque of the effect is added to the residual,
its parameters are held, and the spline is fitted instead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting.discovery._score import CaseColumns
from fitting.effects._effect import Effect
from fitting.effects._expression import symbols
from fitting.inference._linear_algebra import (
    block_diagonal,
    orthogonal_to,
    orthonormal,
    piecewise_linear,
    r_factor,
)
from fitting.inference._problem import Projection
from fitting.inference._result import Fit

Array = NDArray[np.float64]

_KNOTS = 4
_INNER_KNOTS = 5
_POWER = 0.9
_DRAWS = 4000
_RANK = 1e-4
_RANK_FREE = 1e-7
_TINY = 1e-300
_OWN_SPEED = {"rotor": "omega_r", "casing": "omega_c", "bearing": "delta", "factor": "delta"}


@dataclass(frozen=True)
class FormTest:
    """Information of the data on the form of a law."""

    # rms deviation of the law that is detected with 90 % probability, as a share of its rms torque; infinite if the
    # base absorbs every deviation
    limit: float
    variable: str  # the variable of the deviation: "t", "omega_r", "omega_c" or "delta"
    bounds: tuple[str, ...]  # parameters at a bound
    bounds_p: float  # p-value of their values beyond the bounds
    any_in_time: bool  # any torque that changes slowly in time describes the data as well

    def is_strong(self, criteria: Criteria) -> bool:
        """Return whether a remainder above that of an exact law would be detected, and no active bound matters."""
        return self.limit < math.sqrt(1 - criteria.explained) and self.bounds_p > criteria.doubt_named


def form_test(found: Fit, effect: Effect, criteria: Criteria) -> FormTest:
    """Return how well the data test the form of an effect, which is no function of an angle, in the fit that has it."""
    cases = [CaseColumns(found, i) for i in range(len(found.predictions))]
    torques = [_torque(c, effect) for c in cases]
    variable = _variable(effect)
    values = [c.along_motion(variable) for c in cases]
    knots = np.linspace(min(v.min() for v in values), max(v.max() for v in values), _KNOTS)
    slow = _has_time_constant(effect)
    deviations, splines, square, torque_square = [], [], 0.0, 0.0
    for c, (rotor, casing), v in zip(cases, torques, values, strict=True):
        hats = piecewise_linear(v, knots)
        deviations.append(c.torque_rows(rotor[:, None] * hats, casing[:, None] * hats))
        square += float(np.sum(hats**2 * (rotor**2 + casing**2)[:, None]))
        torque_square += float(np.sum(rotor**2 + casing**2))
        spline = _cubic_spline(c.along_motion("t")) if slow else np.zeros((len(v), 0))
        splines.append(c.torque_rows(-spline * bool(rotor.any()), spline * bool(casing.any())))
    effects = [c.torque_rows(r[:, None], k[:, None]) for c, (r, k) in zip(cases, torques, strict=True)]
    rows = [
        _projected(found, i, parts) for i, parts in enumerate(zip(deviations, splines, effects, strict=True))
    ]
    free, residual = np.concatenate([r[3] for r in rows]), np.concatenate([r[4][:, 0] for r in rows])
    response = _orthogonal(np.concatenate([r[0] for r in rows]), free)
    names, p = _active_bounds(found, free, residual)
    per_case = len(cases) > 1 and effect.per_case
    spline = block_diagonal([r[1] for r in rows]) if per_case else np.concatenate([r[1] for r in rows])
    torque = np.concatenate([r[2] for r in rows])[:, 0]
    any_in_time = (
        slow and _rise_with_spline(found, effect, spline, torque, free, residual) < criteria.equivalence_width
    )
    return FormTest(
        _limit(response, square / max(torque_square, _TINY), criteria), variable, names, p, any_in_time
    )


def _torque(case: CaseColumns, effect: Effect) -> tuple[Array, Array]:
    """Return the torques of a fitted effect on rotor and casing in each cell [N m]."""
    numbers = {p.role: case.numbers[f"{effect.name}.{p.symbol}"] for p in effect.parameters}
    shape = {
        p.symbol: case.numbers[f"{effect.name}.{p.symbol}"]
        for p in effect.parameters
        if p.role in {"shape", "fixed"}
    }
    rotor, casing = case.torque(effect, shape)
    phase = numbers.get("phase", 0.0)
    strengths = numbers.get("amplitude", 1.0) * np.array([np.cos(phase), np.sin(phase)])[: rotor.shape[1]]
    return np.asarray(rotor @ strengths), np.asarray(casing @ strengths)


def _variable(effect: Effect) -> str:
    """Return the only variable of a law; time if it has several or a state, the speed of its body if it has none."""
    names = symbols(effect.expression) - {p.symbol for p in effect.parameters}
    speeds = names & {"omega_r", "omega_c", "delta"}
    if effect.state is not None or "t" in names or len(speeds) > 1:
        return "t"
    return next(iter(speeds), _OWN_SPEED.get(effect.joint, "t"))


def _has_time_constant(effect: Effect) -> bool:
    """Return whether a law has a time constant or a frequency of its own, and no changepoint."""
    names = symbols(effect.expression)
    in_time = effect.state is not None or "t" in names
    return in_time and not effect.breakpoint and any(p.role == "shape" for p in effect.parameters)


def _cubic_spline(t: Array) -> Array:
    """Return a basis of the cubic splines in time with equidistant knots, (cells, 4 + inner knots)."""
    x = (t - t[0]) / (t[-1] - t[0])
    knots = np.linspace(0, 1, _INNER_KNOTS + 2)[1:-1]
    return np.concatenate([np.vander(x, 4), np.abs(x[:, None] - knots) ** 3], axis=1)


def _projected(found: Fit, index: int, parts: Sequence[Array]) -> list[Array]:
    """Return columns, those of all variables of the fit, and the residual of one case, as R of a QR decomposition."""
    data, p, noise = found.problem.data[index], found.predictions[index], found.noise[index]
    project = Projection(data, noise.whitener.at(noise.pure))
    white = project(np.concatenate([*parts, p.columns, (data.z - p.rows)[:, None]], axis=1))
    *few, columns, residual = np.split(
        r_factor(white), np.cumsum([*(part.shape[1] for part in parts), p.columns.shape[1]]), axis=1
    )
    free = np.zeros((len(columns), p.count))
    free[:, p.places] = columns
    return [*few, free, residual]


def _orthogonal(columns: Array, free: Array) -> Array:
    """Return the part of columns that is orthogonal to the free ones."""
    return orthogonal_to(orthonormal(free, _RANK_FREE), columns)


def _limit(response: Array, square: float, criteria: Criteria) -> float:
    """Return the rms share of a deviation that is detected, from the responses at the knots.

    `square` is the mean square of the piecewise linear functions; of random deviations of that size, nine in ten have
    the noncentrality with which the smooth test detects nine in ten.
    """
    from scipy.special import chdtri, chndtrinc

    rank = orthonormal(response, _RANK).shape[1]
    if not rank:
        return math.inf
    values = np.maximum(np.linalg.eigvalsh(response.T @ response), 0.0) / square * response.shape[1]
    directions = np.random.default_rng(0).standard_normal((_DRAWS, len(values))) ** 2
    least = float(np.quantile(directions @ values / directions.sum(axis=1), 1 - _POWER))
    needed = float(chndtrinc(chdtri(rank, criteria.doubt_named), rank, 1 - _POWER))
    return math.sqrt(needed / least) if least > 0 else math.inf


def _active_bounds(found: Fit, free: Array, residual: Array) -> tuple[tuple[str, ...], float]:
    """Return the parameters at a bound, and the p-value of the fall of chi-square if they were to pass it."""
    from scipy.special import chdtrc

    layout, bound = found.problem.layout, found.problem.layout.at_bound(found.theta)
    if not bound.any():
        return (), 1.0
    basis = orthonormal(_orthogonal(free[:, bound], free[:, ~bound]), _RANK_FREE)
    r = _orthogonal(residual[:, None], free[:, ~bound])[:, 0]
    names = tuple(name for name, b in zip(layout.names, bound, strict=True) if b)
    return names, float(chdtrc(basis.shape[1], float(np.sum((basis.T @ r) ** 2)))) if basis.size else 1.0


def _rise_with_spline(
    found: Fit, effect: Effect, spline: Array, torque: Array, free: Array, residual: Array
) -> float:
    """Return the rise of chi-square when a spline in time replaces an effect."""
    layout = found.problem.layout
    moving = ~layout.at_bound(found.theta)
    others = moving & np.array([n.partition("@")[0].rpartition(".")[0] != effect.name for n in layout.names])
    with_effect = _orthogonal(residual[:, None], free[:, moving])
    both = np.concatenate([free[:, others], spline], axis=1)
    with_spline = _orthogonal((residual + torque)[:, None], both)
    return float(np.sum(with_spline**2) - np.sum(with_effect**2))
