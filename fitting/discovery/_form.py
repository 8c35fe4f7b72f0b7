"""How well the data test the form of a named law: what another form would have to differ by to be seen.

An effect that leaves nothing significant need not be exact: the recordings may be unable to show that it is not. About
the fit with the effect, whose torque is tau(v) as a function of its own variable v, three questions decide.

*Strength.* Another law of v would deviate by tau(v) h(v) with a smooth h, here piecewise linear with independent normal
values at a few knots. With the whitened responses S to the functions at the knots, orthogonal to all that is free, the
smooth test (`fitting.discovery._lack_of_fit`) has the noncentrality

    lambda = h'S'S h,

and the limit is the rms of h, as a share of the torque, with which it detects nine in ten deviations with a probability
of 90 %. What the base absorbs cannot be seen: a constant torque of the bearing, say, in a narrow range of speeds.

*Active bounds.* A parameter that is held at a bound, and that the residuals pull beyond it, means that the sum of the
laws has another form. With the columns B of these parameters, orthogonal to all that is free,

    chi2 = r'B (B'B)^-1 B'r   with rank(B) degrees of freedom.

*Time.* A law with a memory or a clock of its own and a fitted time constant can imitate any torque that changes slowly
in time. It is compared with a cubic spline in time on the same body: the torque of the effect is returned to the
residual, its own parameters are held, and the spline takes its place.
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
    """Information of the data on the form of a law.

    Attributes
    ----------
    limit : float
        Rms deviation of the law that is detected with 90 % probability, as a share of its rms torque; infinite if the
        base absorbs every deviation.
    variable : str
        The variable of the deviation: "t", "omega_r", "omega_c" or "delta".
    bounds : tuple of str
        Parameters at a bound.
    bounds_p : float
        Probability that noise alone pulls them as strongly.
    any_in_time : bool
        Any torque that changes slowly in time describes the data as well.
    """

    limit: float
    variable: str
    bounds: tuple[str, ...]
    bounds_p: float
    any_in_time: bool

    def is_strong(self, criteria: Criteria) -> bool:
        """Return whether the data would show a remainder beyond an approximate answer, and no bound is pulled."""
        return self.limit < math.sqrt(1 - criteria.explained) and self.bounds_p > criteria.doubt_named


def form_test(found: Fit, effect: Effect, criteria: Criteria) -> FormTest:
    """Return how well the data test the form of an effect.

    Parameters
    ----------
    found : Fit
        The fit with the effect.
    effect : Effect
        A term of its equations of motion that is no function of an angle.
    criteria : Criteria
        `doubt_named`, `equivalence_width`.
    """
    cases = [CaseColumns(found, i) for i in range(len(found.predictions))]
    torques = [_torque(c, effect) for c in cases]
    variable = _variable(effect)
    values = [c.along_motion(variable) for c in cases]
    knots = np.linspace(min(v.min() for v in values), max(v.max() for v in values), _KNOTS)
    imitates = _has_time_constant(effect)
    deviations, splines, square, own_square = [], [], 0.0, 0.0
    for c, (rotor, casing), v in zip(cases, torques, values, strict=True):
        hats = piecewise_linear(v, knots)
        deviations.append(c.torque_rows(rotor[:, None] * hats, casing[:, None] * hats))
        square += float(np.sum(hats**2 * (rotor**2 + casing**2)[:, None]))
        own_square += float(np.sum(rotor**2 + casing**2))
        spline = _cubic_spline(c.along_motion("t")) if imitates else np.zeros((len(v), 0))
        splines.append(c.torque_rows(-spline * bool(rotor.any()), spline * bool(casing.any())))
    own = [c.torque_rows(r[:, None], k[:, None]) for c, (r, k) in zip(cases, torques, strict=True)]
    rows = [_projected(found, i, parts) for i, parts in enumerate(zip(deviations, splines, own, strict=True))]
    free, residual = np.concatenate([r[3] for r in rows]), np.concatenate([r[4][:, 0] for r in rows])
    seen = _beyond(np.concatenate([r[0] for r in rows]), free)
    names, p = _pulled(found, free, residual)
    each = len(cases) > 1 and effect.per_case
    spline = block_diagonal([r[1] for r in rows]) if each else np.concatenate([r[1] for r in rows])
    torque = np.concatenate([r[2] for r in rows])[:, 0]
    alike = imitates and _replaces(found, effect, spline, torque, free, residual) < criteria.equivalence_width
    return FormTest(_limit(seen, square / max(own_square, _TINY), criteria), variable, names, p, alike)


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
    waves = numbers.get("amplitude", 1.0) * np.array([np.cos(phase), np.sin(phase)])[: rotor.shape[1]]
    return np.asarray(rotor @ waves), np.asarray(casing @ waves)


def _variable(effect: Effect) -> str:
    """Return the variable of a law: its only one, time for a law of several or of a state, else its body's speed."""
    names = symbols(effect.expression) - {p.symbol for p in effect.parameters}
    speeds = names & {"omega_r", "omega_c", "delta"}
    if effect.state is not None or "t" in names or len(speeds) > 1:
        return "t"
    return next(iter(speeds), _OWN_SPEED.get(effect.joint, "t"))


def _has_time_constant(effect: Effect) -> bool:
    """Return whether a law has a time constant or a frequency of its own, and no changepoint."""
    names = symbols(effect.expression)
    clocked = effect.state is not None or "t" in names
    return clocked and not effect.breakpoint and any(p.role == "shape" for p in effect.parameters)


def _cubic_spline(t: Array) -> Array:
    """Return a basis of the cubic splines in time with equidistant knots, (cells, 4 + inner knots)."""
    x = (t - t[0]) / (t[-1] - t[0])
    knots = np.linspace(0, 1, _INNER_KNOTS + 2)[1:-1]
    return np.concatenate([np.vander(x, 4), np.abs(x[:, None] - knots) ** 3], axis=1)


def _projected(found: Fit, index: int, parts: Sequence[Array]) -> list[Array]:
    """Return columns, all variables of the fit and the residual as whitened rows of one case, as few as columns."""
    data, p, noise = found.problem.data[index], found.predictions[index], found.noise[index]
    project = Projection(data, noise.whitener.at(noise.pure))
    white = project(np.concatenate([*parts, p.columns, (data.z - p.rows)[:, None]], axis=1))
    *few, columns, residual = np.split(
        r_factor(white), np.cumsum([*(part.shape[1] for part in parts), p.columns.shape[1]]), axis=1
    )
    free = np.zeros((len(columns), p.count))
    free[:, p.places] = columns
    return [*few, free, residual]


def _beyond(columns: Array, free: Array) -> Array:
    return orthogonal_to(orthonormal(free, _RANK_FREE), columns)


def _limit(seen: Array, square: float, criteria: Criteria) -> float:
    """Return the rms share of a deviation that is detected, from the responses to hats times the torque.

    `square` is the mean square of the hats; of random deviations of that size, nine in ten have the noncentrality with
    which the smooth test detects nine in ten.
    """
    from scipy.special import chdtri, chndtrinc

    rank = orthonormal(seen, _RANK).shape[1]
    if not rank:
        return math.inf
    values = np.maximum(np.linalg.eigvalsh(seen.T @ seen), 0.0) / square * seen.shape[1]
    directions = np.random.default_rng(0).standard_normal((_DRAWS, len(values))) ** 2
    least = float(np.quantile(directions @ values / directions.sum(axis=1), 1 - _POWER))
    needed = float(chndtrinc(chdtri(rank, criteria.doubt_named), rank, 1 - _POWER))
    return math.sqrt(needed / least) if least > 0 else math.inf


def _pulled(found: Fit, free: Array, residual: Array) -> tuple[tuple[str, ...], float]:
    """Return the parameters at a bound of their range, and how probable noise is to pull them beyond it as strongly."""
    from scipy.special import chdtrc

    layout, bound = found.problem.layout, found.problem.layout.at_bound(found.theta)
    if not bound.any():
        return (), 1.0
    basis = orthonormal(_beyond(free[:, bound], free[:, ~bound]), _RANK_FREE)
    r = _beyond(residual[:, None], free[:, ~bound])[:, 0]
    names = tuple(name for name, b in zip(layout.names, bound, strict=True) if b)
    return names, float(chdtrc(basis.shape[1], float(np.sum((basis.T @ r) ** 2)))) if basis.size else 1.0


def _replaces(
    found: Fit, effect: Effect, spline: Array, torque: Array, free: Array, residual: Array
) -> float:
    """Return by how much chi-square rises when a spline in time takes the place of an effect."""
    layout = found.problem.layout
    moving = ~layout.at_bound(found.theta)
    others = moving & np.array([n.partition("@")[0].rpartition(".")[0] != effect.name for n in layout.names])
    with_effect = _beyond(residual[:, None], free[:, moving])
    both = np.concatenate([free[:, others], spline], axis=1)
    with_spline = _beyond((residual + torque)[:, None], both)
    return float(np.sum(with_spline**2) - np.sum(with_effect**2))
