"""Exchanges of an added law for one or two other laws, compared to first order without a refit.

Forward selection with backward elimination may end with one wrong law that imitates two missing laws, because no single
further addition or removal lowers BIC. The remedy is sequential replacement (A. Miller, Subset Selection in Regression,
2nd ed., Chapman & Hall (2002), ch. 3). An added law is removed from the model, and its torque is added to the
residuals. Every law and every pair of laws in its place is then fitted by linear least squares, together with all other
parameters. The compared models describe nearly the same motion. Therefore the first order is accurate if a fit needs no
more process noise than the recording shows without a model. Otherwise the fall of BIC is an upper limit, because the
level of the process noise is optimised.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting.discovery._dependence import context_without, torque_rows
from fitting.discovery._refine import initial_values_of
from fitting.discovery._score import CaseColumns, Score, ScoreContext, best_group, score, stacked
from fitting.effects._effect import Effect
from fitting.effects._words import INSTEAD
from fitting.inference._fit import fit
from fitting.inference._linear_algebra import orthogonal_to
from fitting.inference._result import Fit
from fitting.inference._trace import attempt

Array = NDArray[np.float64]

_LAWS = 2
"""Largest number of laws that replace one law [1]. Chosen: with 1, a wrong law that imitates two missing laws remains;
a larger number costs time and fits noise."""
_EQUAL = 1e-9
"""Two laws are equal in a recording if one minus the cosine of the angle between their responses is at most this value;
only the first of two equal laws takes part [1]. Chosen: a smaller value refits equal laws that differ by rounding
errors, a larger one omits laws that differ."""
_SINGULAR = 1e-9
"""Relative singular value of normal equations below which a combination of columns is rounding error [1]. Chosen: a
smaller value fits rounding errors, a larger one ignores weakly determined combinations."""


class Exchange(NamedTuple):
    """A law that is removed from the model, the laws in its place, and the first-order change of BIC."""

    removed: Effect
    # scores of the laws that replace the removed law, with their strengths; empty if no law replaces it
    scores: tuple[Score, ...]
    delta_bic: float

    @property
    def change(self) -> str:
        """The change of the model, for example ``+casing.air.linear instead of casing.air.quadratic``."""
        names, old = [s.effect.name for s in self.scores], self.removed.name
        if old in names:  # with its usual shape constant
            names.remove(old)
            old += f".{self.removed.parameters[-1].symbol}"
        return " ".join(f"+{n}" for n in names) + INSTEAD + old if names else f"-{old}"

    @property
    def laws(self) -> tuple[Effect, ...]:
        """The laws in the place of the removed law."""
        return tuple(s.effect for s in self.scores)

    def refit(self, about: Fit) -> Fit | None:
        """Return the fit of the model after the exchange, from the strengths of first order; None if it fails."""
        start = {k: v for k, v in about.values.items() if not k.startswith(self.removed.name + ".")}
        new: dict[str, float] = {}
        for s in self.scores:
            new |= initial_values_of(about, s)
        shapes = {f"{e.name}.{p.symbol}" for e in self.laws for p in e.parameters if p.role == "shape"}
        with attempt(self.change):
            model = about.model.without(self.removed.name)
            for effect in self.laws:
                model = model.with_effect(effect)
            steady = [n for n in new if n.partition("@")[0] in shapes]
            found = fit(model, about, start=start | new, noise=about.noise, steady=steady, quick=True)
            return found if math.isfinite(found.deviance) else None
        return None


def exchanges(
    about: Fit, removed: Effect, effects: Sequence[Effect], cases: Sequence[CaseColumns], criteria: Criteria
) -> list[Exchange]:
    """Return the removal of an effect of a fit and its exchanges for one or two other effects that lower BIC enough.

    An exchange for two laws must also lower BIC more than the addition of one law to the fit, because a search adds
    every significant law anyway.
    """
    context = context_without(about, [removed], cases)
    own = torque_rows([removed], cases)[:, None]
    layout, prefix = about.problem.layout, removed.name + "."
    of_removed = np.array([n.startswith(prefix) for n in layout.names])
    # Laws that are equal in these recordings take part once and do not replace each other. An exception is an equal law
    # with fewer parameters than the removed law: the law without a free shape constant, or its limit at a bound.
    laws = [best_group(context, removed, [(({},), own)], context.levels, null=False)]
    for s in score(about, effects, cases, criteria, context=context):
        equal = [i for i, other in enumerate(laws) if 1 - abs(s.direction @ other.direction) <= _EQUAL]
        simpler = equal == [0] and _parameters(s) < of_removed.sum()
        if not s.absorbed and (not equal or simpler or s.effect.name == removed.name):
            laws.append(s)
    # another parameter may leave its bound when the law is removed
    held = layout.at_bound(about.theta) & ~of_removed
    room = np.stack(layout.bounds())[:, held] - about.theta[held]
    jacobian = np.concatenate([p.jacobian[:, held] for p in about.predictions])
    linear = _LinearFits(context, [jacobian, own, *(_columns(s, cases) for s in laws[1:])])
    number = [int(of_removed.sum()), *map(_parameters, laws[1:])]
    weight = math.log(about.problem.rows)
    found, added = [], 0.0
    for count in range(_LAWS + 1):
        for chosen in itertools.combinations(range(len(laws)), count):
            groups = [1 + i for i in chosen]
            deviance, (change, *strengths) = linear.least([0, *groups])
            if ((change < room[0]) | (change > room[1])).any():
                deviance, strengths = linear.least(groups)
            new = tuple(replace(laws[i], gamma=g) for i, g in zip(chosen, strengths, strict=True))
            more = sum(number[i] for i in chosen) - number[0]
            delta_bic = deviance - about.deviance + more * weight
            if not all(_within_bounds(s) for i, s in zip(chosen, new, strict=True) if i):
                continue
            if 0 in chosen:
                added = min(added, delta_bic)
            else:
                found.append(Exchange(removed, new, delta_bic))
    least = {_LAWS: added - criteria.evidence}
    return [x for x in found if x.delta_bic < least.get(len(x.scores), -criteria.evidence)]


class _LinearFits:
    """Linear fits of any selection of groups of columns to the linearised data, and their deviance."""

    def __init__(self, context: ScoreContext, groups: Sequence[Array]) -> None:
        ends = np.cumsum([0, *(g.shape[1] for g in groups)])
        self._places = [np.arange(a, b) for a, b in itertools.pairwise(ends)]
        rotated = context.rotated(np.concatenate(groups, axis=1))
        self._normal = []
        for level in context.levels:
            columns = orthogonal_to(level.basis, level.gain[:, None] * rotated)
            self._normal.append((columns.T @ columns, columns.T @ level.residual, level.deviance))

    def least(self, groups: Sequence[int]) -> tuple[float, list[Array]]:
        """Return the deviance of the fit of some groups, minimised over the levels of noise, and their coefficients."""
        places = [self._places[i] for i in groups]
        which = np.concatenate([np.zeros(0, int), *places])
        found = []
        for gram, product, deviance in self._normal:
            size = np.sqrt(np.maximum(np.diagonal(gram)[which], 1e-300))
            scaled = gram[np.ix_(which, which)] / np.outer(size, size)
            gamma = np.linalg.pinv(scaled, rcond=_SINGULAR, hermitian=True) @ (product[which] / size) / size
            found.append((deviance - float(gamma @ product[which]), gamma))
        least, gamma = min(found, key=lambda x: x[0])
        return least, np.split(gamma, np.cumsum([len(p) for p in places])[:-1]) if places else []


def _columns(s: Score, cases: Sequence[CaseColumns]) -> Array:
    """Return the columns of a law at the shape constants of its score, over the rows of all cases."""
    trials = [c.trials(s.effect, [shape]) for c, shape in zip(cases, s.shape, strict=True)]
    return stacked(trials, per_case=_is_per_case(s))[0][1]


def _is_per_case(s: Score) -> bool:
    return s.effect.per_case and len(s.shape) > 1


def _parameters(s: Score) -> int:
    return s.columns + sum(len(x) for x in (s.shape if _is_per_case(s) else s.shape[:1]))


def _within_bounds(s: Score) -> bool:
    strength = s.effect.amplitude
    return strength is None or bool(((s.gamma >= strength.lower) & (s.gamma <= strength.upper)).all())
