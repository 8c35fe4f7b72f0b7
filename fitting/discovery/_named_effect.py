"""Tests of a named effect: of its form, and of the moments of inertia with which it was found.

If the residuals are consistent with noise, the form of the effect may still be wrong: the recordings may not contain
enough information to refute it. Three tests of the form use the fit with the effect. tau(v) is the torque of the effect
as a function of its variable v.

*Detection limit.* Another law of v deviates by tau(v) h(v) with a smooth function h. Here h is piecewise linear with
independent normal values at a few knots. Let S be the whitened responses to the functions of the knots, orthogonal to
all free columns. The smooth test (`fitting.inference._smooth_test`) then has the noncentrality

    lambda = h'S'S h.

The limit is the rms of h, as a share of the torque. At this rms the test detects nine in ten random deviations h, each
with a probability of at least 90 %. Deviations that the base absorbs are not detectable. An example is a constant
torque of the bearing in a narrow range of speeds.

*Active bounds.* If chi-square falls when parameters at a bound are allowed to pass this bound, the true torque differs
in form from the sum of the laws. With the columns B of these parameters, orthogonal to all free columns, the fall of
chi-square is

    chi2 = r'B (B'B)^-1 B'r   with rank(B) degrees of freedom.

*Time.* A law with a fitted time constant (a law of time, or a law with a state variable) can imitate any torque that
changes slowly in time. Such a law is compared with a cubic spline in time on the same body: the spline replaces the
effect in a linear refit.

*Inertia.* This test concerns the given moments of inertia. Only ratios of torque to inertia are observable, and the
torque between the bodies acts on both bodies. The data therefore determine the ratio of the moments of inertia. If the
given ratio is wrong, the base has a systematic error. A wrong effect, or the right effect with a wrong form, may then
describe the data best. Therefore all candidates are scored again with a free ratio, and the best candidates are
refitted with a free ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import Criteria
from fitting._numbers import rounded
from fitting.discovery._refine import refit
from fitting.discovery._score import CaseColumns
from fitting.discovery._select import Candidate, Selection, rank
from fitting.effects._effect import Effect
from fitting.effects._expression import symbols
from fitting.effects._library import LIBRARY
from fitting.effects._mechanism import GYROSCOPE, Mechanism
from fitting.effects._words import effect_name
from fitting.inference._fit import fit
from fitting.inference._linear_algebra import (
    block_diagonal,
    orthogonal_to,
    orthonormal,
    piecewise_linear,
)
from fitting.inference._metrics import FewRows
from fitting.inference._params import Estimate
from fitting.inference._result import Fit
from fitting.inference._trace import attempt

Array = NDArray[np.float64]

_KNOTS = 4
"""Number of knots of the relative deviation of a law from the named law [1]. Chosen: a smaller number describes linear
deviations only, a larger one raises the detection limit of broad deviations."""
_INNER_KNOTS = 5
"""Number of inner knots of the spline in time [1]. Chosen: a smaller number does not follow a change of the torque, a
larger one absorbs noise."""
_POWER = 0.9
"""Probability of detection at the limit, and share of the random deviations that are detected with this probability
[1]. Chosen: equal to `fitting.discovery._power.POWER`; a larger value raises the limit, a smaller one gives a limit at
which deviations often remain undetected."""
_DRAWS = 4000
"""Number of random deviations from which the limit is computed [1]. Chosen: a smaller number makes the limit random, a
larger one costs time."""
_RANK = 1e-4
"""A direction is not tested if its singular value, divided by the largest, is below this value [1]. Chosen: as in
`fitting.inference._smooth_test`; a smaller value tests rounding errors, a larger one omits deviations that are nearly
absorbed."""
_RANK_FREE = 1e-7
"""A direction is not projected out if its singular value, divided by the largest, is below this value [1]. Chosen: as
in `fitting.inference._smooth_test`; a smaller value projects out rounding errors, a larger one ignores some free
columns."""
_TINY = 1e-300
"""Smallest mean square torque that is used as a divisor [1]. Derived: any smaller mean square is zero, and a division
by zero is avoided."""


@dataclass(frozen=True)
class FormTest:
    """Information of the data on the form of a law."""

    # rms deviation from the law that is detected with 90 % probability, as a share of the rms torque; infinite if the
    # other parameters absorb every deviation
    limit: float
    variable: str  # the variable of the deviation: "t", "omega_r", "omega_c" or "delta"
    bounds: tuple[str, ...]  # parameters at a bound
    bounds_p: float  # p-value of the fall of chi-square if these parameters pass their bounds; 1 without active bounds
    any_in_time: bool  # whether any torque that changes slowly in time describes the data as well

    def is_strong(self, criteria: Criteria) -> bool:
        """Return whether the data would show any deviation that is too large for an approximate answer.

        False also if the fit significantly prefers values outside active bounds.
        """
        return self.limit < math.sqrt(1 - criteria.explained) and self.bounds_p > criteria.doubt_named


def form_test(found: Fit, effect: Effect, criteria: Criteria) -> FormTest:
    """Return how well the data test the form of `effect`, which is part of the fit and does not depend on an angle."""
    cases = [CaseColumns(found, i) for i in range(len(found.predictions))]
    torques = [_torque(c, effect) for c in cases]
    variable = _variable(effect, found.model.mechanism)
    values = [c.along_motion(variable) for c in cases]
    knots = np.linspace(min(v.min() for v in values), max(v.max() for v in values), _KNOTS)
    slow = _has_time_constant(effect)
    deviations, splines, square, torque_square = [], [], 0.0, 0.0
    for c, on_bodies, v in zip(cases, torques, values, strict=True):
        hats = piecewise_linear(v, knots)
        deviations.append(c.torque_rows(*(x[:, None] * hats for x in on_bodies)))
        squares = np.sum(np.square(on_bodies), axis=0)
        square += float(np.sum(hats**2 * squares[:, None]))
        torque_square += float(np.sum(squares))
        spline = _cubic_spline(c.along_motion("t")) if slow else np.zeros((len(v), 0))
        senses = _senses(effect, on_bodies)
        splines.append(c.torque_rows(*(sense * spline for sense in senses)))
    effects = [c.torque_rows(*(x[:, None] for x in own)) for c, own in zip(cases, torques, strict=True)]
    columns = [np.concatenate(parts, axis=1) for parts in zip(deviations, splines, effects, strict=True)]
    known = zip(found.problem.data, found.predictions, found.noise, columns, strict=True)
    # a deviation may raise the process noise of the fit, but the test uses at most the level that the recording shows
    rows = [FewRows.of(*case, level=case[2].pure) for case in known]
    free, residual = np.concatenate([r.free for r in rows]), np.concatenate([r.residual for r in rows])
    tested = [np.split(r.tested, [_KNOTS, -1], axis=1) for r in rows]
    response = _orthogonal(np.concatenate([t[0] for t in tested]), free)
    names, p = _active_bounds(found, free, residual)
    per_case = len(cases) > 1 and effect.per_case
    spline = (block_diagonal if per_case else np.concatenate)([t[1] for t in tested])
    torque = np.concatenate([t[2] for t in tested])[:, 0]
    rise = _rise_with_spline(found, effect, spline, torque, free, residual) if slow else math.inf
    limit = _limit(response, square / max(torque_square, _TINY), criteria)
    return FormTest(limit, variable, names, p, rise < criteria.equivalence_width)


def _torque(case: CaseColumns, effect: Effect) -> tuple[Array, ...]:
    """Return the torques of a fitted effect on each body in each cell [N m]."""
    shape, strengths = case.fitted(effect)
    return tuple(x @ strengths[: x.shape[1]] for x in case.torque(effect, shape))


def _senses(effect: Effect, torques: Sequence[Array]) -> list[float]:
    """Return the factor of a torque in time on each body; 0 for a body on which the effect does not act."""
    shares = effect.mechanism.shares(effect.site)
    return [share if own.any() else 0.0 for share, own in zip(shares, torques, strict=True)]


_OWN_SPEED = dict(GYROSCOPE.sites) | {"factor": "delta"}


def _variable(effect: Effect, mechanism: Mechanism = GYROSCOPE) -> str:
    """Return the variable of a law: the speed in the law or, without a speed, the speed of its body or joint.

    The variable is time if the law depends on time, on several speeds, on a state or on an input.
    """
    names = symbols(effect.expression) - {p.symbol for p in effect.parameters}
    motion = dict(mechanism.sites)
    speeds = names & {*motion.values()}
    if effect.state is not None or "t" in names or effect.inputs or len(speeds) > 1:
        return "t"
    own = _OWN_SPEED.get(effect.joint, "t") if mechanism == GYROSCOPE else motion.get(effect.site, "t")
    return next(iter(speeds), own)


def _has_time_constant(effect: Effect) -> bool:
    """Return whether a law of time, or a law with a state, has a shape constant and no changepoint."""
    names = symbols(effect.expression)
    in_time = effect.state is not None or "t" in names
    return in_time and not effect.breakpoint and any(p.role == "shape" for p in effect.parameters)


def _cubic_spline(t: Array) -> Array:
    """Return a basis of the cubic splines in time with equidistant knots, (cells, 4 + inner knots)."""
    x = (t - t[0]) / (t[-1] - t[0])
    knots = np.linspace(0, 1, _INNER_KNOTS + 2)[1:-1]
    return np.concatenate([np.vander(x, 4), np.abs(x[:, None] - knots) ** 3], axis=1)


def _orthogonal(columns: Array, free: Array) -> Array:
    """Return the components of columns that are orthogonal to the columns `free`."""
    return orthogonal_to(orthonormal(free, _RANK_FREE), columns)


def _limit(response: Array, square: float, criteria: Criteria) -> float:
    """Return the rms deviation, as a share of the torque, that is detected with 90 % probability.

    `response` contains the responses to the piecewise linear functions of the knots. `square` is the sum of the squared
    torques of these functions, divided by the sum of the squared torque of the effect. The limit is the rms at which
    nine in ten random deviations have a noncentrality that the smooth test detects with 90 % probability.
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
    """Return the parameters at a bound, and the p-value of the fall of chi-square if they pass their bounds."""
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
    """Return the rise of chi-square, to first order, if a spline in time replaces an effect."""
    layout = found.problem.layout
    moving = ~layout.at_bound(found.theta)
    others = moving & np.array([n.partition("@")[0].rpartition(".")[0] != effect.name for n in layout.names])
    with_effect = _orthogonal(residual[:, None], free[:, moving])
    both = np.concatenate([free[:, others], spline], axis=1)
    with_spline = _orthogonal((residual + torque)[:, None], both)
    return float(np.sum(with_spline**2) - np.sum(with_effect**2))


INERTIA = "setup.inertia"
_MOST_REFITS = 5
"""Largest number of effects that are refitted with a free ratio of the moments of inertia [1]. Chosen: a smaller number
may omit the effect that a wrong ratio hides, a larger one costs time."""
_SHARE = f"{INERTIA}.eps"


def relative_uncertainty(found: Fit) -> float:
    """Return the smallest relative standard uncertainty of I_casing/I_rotor of all cases; 0 if none is stated."""
    relative = []
    for d in found.problem.data:
        r = d.record
        both = (r.I_casing_u / r.I_casing, r.I_rotor_u / r.I_rotor)
        relative.append(math.hypot(*(u for u in both if math.isfinite(u))))
    return min(relative)


@dataclass(frozen=True)
class InertiaRival:
    """An effect that describes the data as well or better if the ratio of the moments of inertia is free."""

    share: Estimate  # relative error of I_casing/I_rotor
    stated: float  # stated relative standard uncertainty of this ratio; 0 if none is stated
    effect: str  # name of the effect
    fit: Fit  # the fit with effect and free ratio
    better: bool  # True if the fit describes the data better than the selected effect, False if equally well

    def is_allowed(self, criteria: Criteria) -> bool:
        """Return whether the stated uncertainty allows the error (`Criteria.inertia_sigma`)."""
        allowed = criteria.inertia_sigma * math.hypot(self.stated, self.share.stderr)
        return self.stated > 0 and abs(self.share.value) <= allowed

    def sentence(self, criteria: Criteria) -> str:
        """Return a sentence with the error and the stated uncertainty of the ratio.

        Empty if the error is consistent with zero.
        """
        if abs(self.share.value) < criteria.named_sigma * self.share.stderr:
            return ""
        stated = (
            f"standard uncertainty {100 * self.stated:.2g} %" if self.stated > 0 else "no uncertainty stated"
        )
        name = effect_name(self.effect)
        return (
            f"With I_casing/I_rotor {_percent_off(self.share)} than given ({stated}), the {name} describes the "
            f"data {'better' if self.better else 'as well'}: check the moments of inertia."
        )


def _percent_off(share: Estimate) -> str:
    """Return a relative error in words: ``0.8 +- 0.2 % smaller``."""
    size = rounded(100 * abs(share.value), 100 * share.stderr, "%")
    return f"{size} {'smaller' if share.value < 0 else 'larger'}"


def with_free_inertia(
    base: Fit, selection: Selection, extra: tuple[Effect, ...], criteria: Criteria
) -> InertiaRival | None:
    """Return the effect that, with a free ratio of inertias, describes the data at least as well as the selection.

    None if there is no such effect, if the error of the ratio is not credible, or if the chosen effect depends on an
    angle.
    """
    chosen = selection.chosen
    if chosen is None or not chosen.physical or chosen.effect.depends_on_angle:
        return None
    if (
        not LIBRARY[INERTIA].bodies <= base.problem.data[0].record.parts
        or INERTIA in selection.final.model.names
    ):
        return None
    with attempt("free ratio of the moments of inertia"):
        model = base.model.with_effect(LIBRARY[INERTIA])
        freed = fit(model, base, start=base.values, noise=base.noise)
        ranked = rank(freed, extra, criteria=criteria, refitting=False)
        usable = [c for c in ranked if c.physical and c.significant and not c.screened.absorbed]
        near = [c for c in usable[:_MOST_REFITS] if c.score > usable[0].score - criteria.equivalence_width]
        refits = [(c.effect.name, refit(freed, c.screened, criteria)) for c in near]
        usable_fits = [(f.bic, name, f) for name, f in refits if f is not None]
        if not usable_fits:
            return None
        _, name, found = min(usable_fits, key=lambda item: item[0])
        share, stated = found.estimates[_SHARE], relative_uncertainty(base)
        largest = criteria.inertia_sigma * stated if stated > 0 else criteria.inertia_largest
        credible = abs(share.value) <= largest + criteria.inertia_sigma * share.stderr
        better = selection.final.bic - found.bic
        least = criteria.shape_evidence if name == chosen.effect.name else -criteria.equivalence_width
        if credible and better > least:
            return InertiaRival(share, stated, name, found, better > criteria.shape_evidence)
    return None


def reselected(selection: Selection, rival: InertiaRival) -> Selection:
    """Return the selection with the rival that was found with a free ratio of inertias.

    If the rival is better, it becomes the chosen effect, and the previous choice becomes indistinguishable from it.
    Otherwise the rival becomes indistinguishable from the chosen effect. If both are the same effect, only the final
    fit changes.
    """
    chosen = selection.chosen
    if chosen is None or rival.effect == chosen.effect.name:
        return selection._replace(final=rival.fit)
    if not rival.better:
        members = (*chosen.indistinguishable_from, rival.effect)
        first = replace(chosen, indistinguishable_from=tuple(dict.fromkeys(members)))
        kept = [first if c is chosen else c for c in selection.candidates]
        return selection._replace(candidates=kept, chosen=first)
    own = {k: e for k, e in rival.fit.estimates.items() if k.startswith(f"{rival.effect}.")}
    old = next((c for c in selection.candidates if c.effect.name == rival.effect), None)
    if old is None:  # a given list of candidates may not contain the rival
        return selection
    first = replace(
        old,
        fit=rival.fit,
        estimates=own,
        significant=True,
        indistinguishable_from=tuple(
            n for n in (chosen.effect.name, *chosen.indistinguishable_from) if n != rival.effect
        ),
    )
    others = [c for c in selection.candidates if c is not old]
    return selection._replace(candidates=[first, *others], chosen=first, named=rival.fit, final=rival.fit)


def inertia_within_uncertainty(fit: Fit, named: list[Candidate], criteria: Criteria) -> str:
    """Return a sentence if errors of the moments of inertia within their uncertainties explain a lack of fit, else "".

    The data determine the ratio of the moments of inertia, so the relative uncertainties add in quadrature; an
    uncertainty that is not stated counts as zero. `named` contains the indistinguishable effects that explain the lack
    of fit.
    """
    found = [e for c in named if c.effect.joint == "inertia" for e in c.estimates.values()]
    u = relative_uncertainty(fit)
    if not found or u <= 0:
        return ""
    share = found[0]
    if abs(share.value) > criteria.inertia_sigma * math.hypot(u, share.stderr):
        return ""
    return (
        f"The model is adequate within the uncertainty of the moments of inertia: I_casing/I_rotor "
        f"{_percent_off(share)} than given (standard uncertainty {100 * u:.2g} %) explains the lack of fit."
    )
