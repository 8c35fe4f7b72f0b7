"""Power of the search for a missing effect: detection limits, upper limits, number of runs needed.

An effect of strength k has the whitened response k s in the rows of the recordings. The matrix M projects out all free
parameters. The noncentrality of the effect is

    delta = k |M s|,        standard error of k:  se = 1 / |M s|.

Null data plus delta times the unit response are tested with the score test of the search. The test uses all candidates,
all trials of their shape constants, the null distributions of the search, and the thresholds of `Criteria`. The power
is the share of data sets in which at least one candidate is significant in the whole list and lowers BIC by the
evidence required for an added effect. The detection limit is the strength at which the power is 90 %.

If no effect is significant, the one-sided 95 % upper limit of a strength with estimate k is |k| + 1.64 se (max(k, 0) +
1.64 se for a friction coefficient, which is not negative). The upper limit of an amplitude with a phase is the
amplitude for which a score below the observed score has a probability of 5 %, from the noncentral chi-square (J.
Neyman, Phil. Trans. R. Soc. A 236, 333 (1937)). For recordings that are only planned, the estimate is zero, which gives
the expected limit.

If the effect shifts a parameter of the model to its bound, the score is larger. The search may then find a smaller
strength than this limit with a probability of 95 %. In this case an insignificant score excludes the smaller strength,
so the smaller strength is the upper limit.

The threshold of a significant score depends on the uncertainty of the level of the process noise. This uncertainty
varies between recordings: if the data allow a level ten times as high, the threshold is far higher. For recordings that
are only planned, the thresholds are therefore computed for several simulated estimates of the noise, and the power is
the mean over these estimates.

If several runs of one kind are made, delta^2 is multiplied by their number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT, Criteria
from fitting.discovery._score import (
    RANK,
    CaseColumns,
    FamilywiseNull,
    Level,
    NullDistribution,
    Score,
    ScoreContext,
    Trial,
    rows_of_case,
)
from fitting.discovery._select import Candidate, applicable_effects, needed_evidence
from fitting.effects._effect import Effect
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._process_noise import ProcessNoise
from fitting.inference._result import Fit

Array = NDArray[np.float64]
Progress = Callable[[int, int | None], None]

POWER = 0.9
"""Probability of detection at the detection limit [1]. Chosen: a larger value raises the limits; with a smaller one,
effects at the limit often remain undetected."""
CONFIDENCE = 0.95
"""Confidence of upper limits [1]. Chosen: the usual value; a larger one raises the limits, a smaller one excludes true
strengths more often."""
_ONE_SIDED = 1.6448536
"""Distance of a one-sided limit of 95 % from the estimate [standard errors]. Derived: quantile 0.95 of the standard
normal distribution, at `CONFIDENCE`."""
_POWER_SIGMA = 1.2815516
"""A value exceeds a threshold with 90 % probability if its expected value is this distance above the threshold
[standard errors]. Derived: quantile 0.9 of the standard normal distribution, at `POWER`."""
_DRAWS = 1500
"""Number of null data sets for thresholds [1]. Chosen: a smaller number makes thresholds of a long list uncertain, a
larger one costs time."""
_POWER_DRAWS = 600
"""Number of simulated data sets for a power [1]. Chosen: the standard error of a power is 0.02 at most; a smaller
number enlarges this error, a larger one costs time."""
_DELTAS = np.concatenate([np.linspace(0.0, 1.5, 11), np.linspace(2.0, 14.0, 25)])
"""Strengths at which the power is simulated [standard errors]. Chosen: dense at small strengths, where a parameter
reaches its bound; a smaller number rounds the limits, a larger one costs time."""
_SIZE = 0.01
"""Default size of an effect, as a share of the torque of the bearing [1]. Chosen: a smaller value requires many runs, a
larger one makes every plan sufficient."""
_MOST_RUNS = 10_000
"""Largest number of needed runs that is stated [1]. Chosen: a larger number is not practical, a smaller one hides large
numbers of runs."""
_LARGEST_SCORE = 2000.0
"""Upper end of the search for thresholds [1]. Chosen: a smaller value is below high thresholds, a larger one costs
time."""
_MOST_HIDDEN = 5
"""Largest number of effects named in the sentence on an adequate fit [1]. Chosen: a smaller number hides undetected
effects, a larger one makes the sentence unreadable."""
_RANK = 1e-6
"""Relative eigenvalue below which a direction is not determined [1]. Chosen: a smaller value amplifies rounding errors,
a larger one omits weakly determined strengths."""
_RARE = 0.5
"""The bound of a parameter is neglected if the parameter is at this bound in too few data sets. The share of these data
sets is added up over all strengths; below this sum the bound is neglected [1]. Chosen: a smaller value costs time for
rare bounds, a larger one biases the power."""


@dataclass(frozen=True)
class EffectLimits:
    """Detection limit, upper limit and power of the search for one effect in some recordings."""

    effect: Effect
    strength: str  # symbol of the strength
    unit: str  # unit of the strength
    # shape constants with the median detection limit; the limits below are for these constants
    shape: dict[str, float]
    # standard error of the strength in a fit with the effect [unit]; infinite if the base absorbs the effect
    stderr: float
    torque: float  # largest rms torque on a body for a strength of 1 [N m / unit]; NaN for a camera effect
    detection_limit: float  # strength found with 90 % probability [unit]
    # smallest and largest limit over all trial shapes, as rms torques [N m]
    detection_range: tuple[float, float]
    upper_limit: float  # 95 % upper limit of the strength [unit]; NaN if the effect is significant
    power: float  # probability of finding an effect of `size`
    size: float  # strength for which `power` and `runs_needed` are computed [unit]
    # number of runs, including the present ones, that find this size with 90 % probability
    runs_needed: float
    # effects that are not separated from this effect at the larger of `size` and `detection_limit`
    indistinguishable_from: tuple[str, ...]
    curve: Array = field(repr=False)  # (points, 2): noncentrality and power

    @property
    def absorbed(self) -> bool:
        """Whether the model absorbs the effect, so that no limit exists."""
        return not math.isfinite(self.stderr)

    @property
    def detection_torque(self) -> float:
        """Detection limit as an rms torque along the motion [N m]; NaN for a camera effect."""
        return self.detection_limit * self.torque

    @property
    def upper_torque(self) -> float:
        """Upper limit as an rms torque along the motion [N m].

        NaN for a camera effect, or if the effect is significant.
        """
        return self.upper_limit * self.torque


@dataclass(frozen=True)
class UpperLimit:
    """An effect that could still be hidden in the recordings."""

    effect: str
    symbol: str  # symbol of the strength
    upper_limit: float  # 95 % upper limit of the strength [unit]
    unit: str  # unit of the strength
    torque_Nm: float  # upper limit as an rms torque along the motion [N m]


@dataclass(frozen=True)
class HiddenEffects:
    """Physical effects that could still be hidden in the recordings."""

    limits: tuple[UpperLimit, ...] = ()  # effects with the largest upper limits of the torque, largest first
    without_limit: tuple[str, ...] = ()  # names of the effects that the recordings do not limit


@dataclass(frozen=True)
class _Responses:
    """Whitened, projected responses of one candidate: an orthonormal basis of each group of columns."""

    basis: Array  # shape (rows, groups * width); zero for groups that the base absorbs
    root: Array  # shape (groups,); noncentrality of a unit strength (rms over the phases)
    width: int
    one_sided: bool

    @classmethod
    def of(cls, columns: Array, width: int, absorbed: NDArray[np.bool_], effect: Effect) -> _Responses:
        groups = columns.shape[1] // width
        c = columns.reshape(len(columns), groups, width)
        gram = np.einsum("rgw,rgv->gwv", c, c)
        values, vectors = np.linalg.eigh(gram)
        top = np.maximum(values[:, -1:], 1e-300)
        kept = (values > _RANK * top) & ~absorbed[:, None]
        turn = vectors * np.where(kept, 1 / np.sqrt(np.maximum(values, 1e-300)), 0.0)[:, None, :]
        basis = np.einsum("rgw,gwv->rgv", c, turn).reshape(len(columns), -1)
        root = np.sqrt(np.maximum(np.trace(gram, axis1=1, axis2=2), 0.0) / width)
        strength = effect.amplitude
        one_sided = width == 1 and strength is not None and strength.lower >= 0
        return cls(basis, np.where(absorbed, 0.0, root), width, one_sided)

    def scores(self, projections: Array) -> Array:
        """Return the score of each group (groups, data sets) from projections on the basis."""
        squares = (np.maximum(projections, 0.0) if self.one_sided else projections) ** 2
        if self.width == 1:
            return np.asarray(squares)
        return np.asarray(squares.reshape(len(self.root), self.width, -1).sum(axis=1))

    def direction(self, group: int) -> Array:
        """Return the unit response of a group; with a phase, at the middle phase."""
        part = self.basis[:, group * self.width : (group + 1) * self.width].sum(axis=1)
        return np.asarray(part / max(float(np.linalg.norm(part)), 1e-300))


@dataclass(frozen=True)
class _Test:
    """The score test of one candidate in null data."""

    # one item if the cases share a strength; otherwise one item per case, and the best scores of the cases are added
    parts: tuple[_Responses, ...]
    # shape (basis vectors of all `parts`, data sets); projections of the null data on these vectors
    null: Array
    # shape (estimates of the noise,); smallest score that detects the candidate, for each simulated estimate of the
    # process noise
    thresholds: Array

    @property
    def threshold(self) -> float:
        """Smallest score that detects the candidate, for the median estimate of the noise."""
        return float(np.median(self.thresholds))

    @property
    def basis(self) -> Array:
        return np.concatenate([p.basis for p in self.parts], axis=1)

    def best(self, projections: Array) -> Array:
        """Return the best score in each data set."""
        ends = np.cumsum([0, *(p.basis.shape[1] for p in self.parts)])
        each = [
            p.scores(projections[a:b]).max(axis=0)
            for p, a, b in zip(self.parts, ends, ends[1:], strict=False)
        ]
        return np.asarray(np.sum(each, axis=0))


@dataclass(frozen=True)
class ShiftedToBound:
    """The parameter of the base that an effect shifts to its bound.

    A missing effect shifts the parameters of the base, and noise scatters them. The fit holds a parameter at the bound
    that the parameter would otherwise cross. The part of the effect that the parameter would absorb beyond the bound
    then contributes to the score. If several parameters would cross their bounds, only the parameter furthest beyond
    its bound, in standard errors, is held.
    """

    free: Array  # shape (rows, columns); whitened derivatives with respect to the parameters, then nuisance columns
    inverse: Array  # shape (parameters, rows); from data to changes of the parameters
    noise: Array  # shape (parameters, data sets); changes of the parameters in null data
    distance: Array  # shape (2, parameters); distance to the lower (negative) and to the upper bound

    @classmethod
    def of(
        cls, fit: Fit, context: ScoreContext, level: Level, draws: int, truth: Mapping[str, float]
    ) -> ShiftedToBound:
        layout = fit.problem.layout
        moving = ~layout.at_bound(fit.theta)
        theta = np.array(
            [truth.get(n.partition("@")[0], x) for n, x in zip(layout.names, fit.theta, strict=True)]
        )
        lower, upper = layout.bounds()
        distance = np.stack([lower - theta, upper - theta])[:, moving]
        free = level.gain[:, None] * context.free
        count = int(moving.sum())
        size = np.linalg.norm(free, axis=0)
        size[size == 0] = 1.0
        inverse = (np.linalg.pinv(free / size, rcond=1e-10) / size[:, None])[:count]
        return cls(free, inverse, inverse @ context.draws[:, :draws], distance)

    def held(self, response: Array, strengths: Array) -> NDArray[np.intp]:
        """Return the active bound in each data set, shape (strengths, data sets), or -1 if there is none.

        The number is twice the index of the parameter for its lower bound, and one more for its upper bound.
        """
        error = np.sqrt((self.inverse**2).sum(axis=1))[:, None]
        shift = (self.inverse @ response)[:, None]
        found = []
        for k in strengths:
            change = k * shift + self.noise
            beyond = (
                np.stack([self.distance[0][:, None] - change, change - self.distance[1][:, None]], axis=1)
                / error[:, None]
            )
            flat = beyond.reshape(-1, change.shape[1])
            found.append(np.where(flat.max(axis=0) > 0, flat.argmax(axis=0), -1))
        return np.array(found)

    def shift(self, which: int) -> Array:
        """Return the change of the rows when a parameter moves to its bound."""
        parameter, side = divmod(which, 2)
        return np.asarray(self.free[:, parameter] * self.distance[side, parameter])

    def largest_strength(self, response: Array, data: Array, limit: float, *, one_sided: bool) -> float:
        """Return an upper limit of a strength with the parameters of the base within their bounds.

        The base can absorb an effect only as far as its parameters remain within their bounds. Let r be the data, F the
        free columns and s the response. The limit is the strength k at which

            min_b |r - F b - k s|^2,   b within the bounds,

        exceeds its minimum over k by 1.64^2. The search ends at the limit without bounds.
        """
        count = self.distance.shape[1]
        change = self.inverse @ response
        largest = 0.0
        for sign in (1.0,) if one_sided else (1.0, -1.0):
            b = self.inverse @ data - sign * limit * change
            if ((b >= self.distance[0]) & (b <= self.distance[1])).all():
                return limit
            r: Array = np.asarray(np.linalg.qr(np.column_stack([self.free, sign * response, data]), mode="r"))
            size = np.linalg.norm(r[:, :-2], axis=0)
            size[size == 0] = 1.0
            bounds = np.full((2, len(size)), np.inf) * [[-1], [1]]
            bounds[:, :count] = self.distance * size[:count]
            largest = max(largest, _profile_limit(r[:, :-2] / size, r[:, -2], r[:, -1], bounds, limit))
        return largest

    def basis_without(self, parameter: int) -> Array:
        """Return an orthonormal basis of the free columns without the columns of one parameter."""
        return orthonormal(np.delete(self.free, parameter, axis=1), RANK)


class SearchScore(NamedTuple):
    """Score of a candidate, its best shape constants, and the smallest significant score."""

    score: float
    shape: dict[str, float]
    threshold: float


class Search:
    """The search for a missing effect in the recordings of a fit, as a test whose power is computed.

    `draws` null data sets are simulated. `truth` are the parameters by key if they are known (simulated recordings).
    `process` are estimates of the process noise of each case in further simulations of the same recordings.
    """

    def __init__(
        self,
        fit: Fit,
        extra: Sequence[Effect] = (),
        criteria: Criteria = DEFAULT,
        draws: int = _DRAWS,
        truth: Mapping[str, float] | None = None,
        process: Sequence[tuple[ProcessNoise, ...]] = (),
    ) -> None:
        self.fit, self.criteria = fit, criteria
        self._noises = [
            fit.noise,
            *(tuple(replace(n, process=p) for n, p in zip(fit.noise, each, strict=True)) for each in process),
        ]
        self.effects = applicable_effects(fit, extra)
        self.cases = [CaseColumns(fit, i) for i in range(len(fit.problem.cases))]
        self._context = ScoreContext(fit, draws)
        # a lack of fit raises the estimated noise level; the level without this rise is used, because the missing
        # effect removes the lack of fit
        self._level = self._context.levels[0 if fit.fails(criteria) else -1]
        self._trials = {e.name: self._all_trials(e) for e in self.effects}
        self._common = {e.name: self._responses(e, self._stacked(e), self._level.basis) for e in self.effects}
        self._tests = self._calibrated(self._level.basis) if draws > 1 else {}
        self._draws = min(draws, _POWER_DRAWS)
        self._bounds = ShiftedToBound.of(fit, self._context, self._level, self._draws, truth or {})
        self._tests_by_held: dict[int, dict[str, list[_Test]]] = {}

    def _all_trials(self, effect: Effect) -> list[list[Trial]]:
        first = self.cases[0].trials(effect)
        return [first, *(c.trials(effect, [t.shape for t in first]) for c in self.cases[1:])]

    def _stacked(self, effect: Effect) -> list[Array]:
        """Return the columns of an effect with one common strength, for each choice of its shape constants."""
        trials = self._trials[effect.name]
        return [np.concatenate([t[i].columns for t in trials]) for i in range(len(trials[0]))]

    def _whitened(self, groups: Sequence[Array]) -> Array:
        return np.asarray(self._level.gain[:, None] * self._context.rotated(np.concatenate(groups, axis=1)))

    def _responses(self, effect: Effect, groups: Sequence[Array], basis: Array) -> _Responses:
        absorbed = self._context.absorbed_by_base(groups)
        columns = orthogonal_to(basis, self._whitened(groups))
        return _Responses.of(columns, groups[0].shape[1], absorbed, effect)

    def _tests_with_held(self, parameter: int) -> dict[str, list[_Test]]:
        """Return the tests on a base with one parameter held at its bound."""
        if parameter not in self._tests_by_held:
            self._tests_by_held[parameter] = self._calibrated(self._bounds.basis_without(parameter))
        return self._tests_by_held[parameter]

    def _calibrated(self, free: Array) -> dict[str, list[_Test]]:
        """Return the tests of each effect with a basis of the free columns, and their thresholds."""
        parts: list[tuple[Effect, tuple[_Responses, ...], Array, float, int]] = []
        for e in self.effects:
            common = self._responses(e, self._stacked(e), free)
            variants: list[tuple[tuple[_Responses, ...], float]] = [((common,), 1.0)]
            if len(self.cases) > 1 and e.per_case:
                # cases with separate strengths are tested first; a common strength is a second test, so its p-value is
                # doubled
                per_case = tuple(
                    self._responses(e, self._of_case(e, i), free) for i in range(len(self.cases))
                )
                variants = [(per_case, 1.0), ((common,), 2.0)]
            for responses, factor in variants:
                basis = np.concatenate([r.basis for r in responses], axis=1)
                parts.append((e, responses, basis.T @ self._context.draws, factor, len(responses)))
        raw = [(e, _Test(r, null, np.zeros(0)), factor, n) for e, r, null, factor, n in parts]
        nulls = [self._nulls(e, t, n * t.parts[0].width) for e, t, _, n in raw]
        family = FamilywiseNull(
            [n[0] for n, (*_, factor, _) in zip(nulls, raw, strict=True) if factor == 1.0]
        )
        tests: dict[str, list[_Test]] = {e.name: [] for e in self.effects}
        for each, (e, test, factor, n) in zip(nulls, raw, strict=True):
            least = [_smallest_score(null, family, factor, self.criteria.significance) for null in each]
            penalty = n * len(e.free) * math.log(self.fit.problem.rows)
            bic = needed_evidence(e, self.fit, self.criteria) + penalty
            tests[e.name].append(_Test(test.parts, test.null, np.maximum(least, bic)))
        return tests

    def _nulls(self, effect: Effect, test: _Test, columns: int) -> list[NullDistribution]:
        """Return the null distributions of a test, one for each estimate of the process noise."""
        directions = np.sum([p.direction(len(p.root) // 2) for p in test.parts], axis=0)
        direction = directions / max(float(np.linalg.norm(directions)), 1e-300)
        score = Score(
            effect,
            score=0.0,
            gamma=np.zeros(0),
            shape=({},),
            columns=columns,
            trials=1,
            absorbed=False,
            direction=direction,
            null=test.best(test.null),
            shares=self._context.shares(direction),
            noise=self.fit.noise,
        )
        return [NullDistribution(replace(score, noise=n)) for n in self._noises]

    def _of_case(self, effect: Effect, case: int) -> list[Array]:
        groups = rows_of_case(self._context, self._trials[effect.name][case], case)
        return [rows for _, rows in groups]

    def power(self, effect: Effect, group: int, strengths: Array) -> Array:
        """Return the probability that the search finds any effect, for some strengths of the given effect."""
        stacked = self._stacked(effect)
        group = min(group, len(stacked) - 1)
        raw = self._whitened(stacked[group : group + 1])
        raw = raw.sum(axis=1) / self._common[effect.name].width ** 0.5
        held = self._bounds.held(raw, strengths)
        frequent = [w for w in np.unique(held) if w >= 0 and (held == w).mean() >= _RARE / len(strengths)]
        held[~np.isin(held, frequent)] = -1
        estimate = np.arange(self._draws) % len(self._noises)
        found = np.zeros((len(strengths), self._draws), dtype=bool)
        for which in np.unique(held):
            tests, offset = self._tests, np.zeros(len(raw))
            if which >= 0:
                tests, offset = self._tests_with_held(int(which) // 2), self._bounds.shift(int(which))
            # the effect itself is tested first, because a data set needs no further test once one test is significant
            for name in sorted(tests, key=lambda name: name != effect.name):
                for test in tests[name]:
                    signal, shift = test.basis.T @ raw, test.basis.T @ offset
                    for k, chosen in enumerate((held == which) & ~found):
                        if not chosen.any():
                            continue
                        null = test.null[:, : self._draws][:, chosen]
                        seen = null + (strengths[k] * signal - shift)[:, None]
                        found[k, chosen] |= test.best(seen) > test.thresholds[estimate[chosen]]
        return np.asarray(found.mean(axis=1))

    def scores(self) -> dict[str, SearchScore]:
        """Return for each candidate the score in the recordings, the best shape, and the threshold."""
        found = {}
        for e in self.effects:
            common = self._common[e.name]
            each = common.scores(common.basis.T @ self._level.residual[:, None])[:, 0]
            best = int(np.argmax(each))
            threshold = min(t.threshold for t in self._tests[e.name])
            found[e.name] = SearchScore(float(each[best]), self._trials[e.name][0][best].shape, threshold)
        return found

    def limits(
        self,
        effect: Effect,
        size: float | None = None,
        *,
        planned: bool = False,
        others: Sequence[Search] = (),
    ) -> EffectLimits:
        """Return detection limit, upper limit and power for one of `effects`.

        `size` is the rms torque [N m] for which power and runs are computed; by default 1 % of the rms torque of the
        bearing (for a single body, of the net torque). With `planned` data the upper limits are expected limits.
        `others` are other simulations of the same recordings with new estimates of the noise; the power is averaged
        over them.
        """
        common = self._common[effect.name]
        unit_torque = self._unit_torques(effect)
        group, ranged = _median_shape(common.root, unit_torque)
        root, torque = float(common.root[group]), float(unit_torque[group])
        shape = self._trials[effect.name][0][group].shape
        strength = next(p for p in effect.parameters if p.role == "amplitude")
        unit = self.fit.units.of(strength.unit)
        if root == 0:
            no_curve = np.zeros((0, 2))
            return EffectLimits(
                effect, strength.symbol, unit, shape, np.inf, torque, np.inf, (np.inf, np.inf), np.inf,
                float("nan"), self._size(torque, size), np.inf, (), no_curve,
            )  # fmt: skip
        curve = np.zeros((0, 2))
        if self._tests:
            powers = [x.power(effect, group, _DELTAS / root) for x in (self, *others)]
            curve = np.stack([_DELTAS, np.mean(powers, axis=0)], axis=1)
        needed = delta_of_power(curve) if self._tests else np.nan
        wanted = self._size(torque, size)
        delta = wanted * root
        # the power curve also contains detections that are due to a parameter at its bound
        seen = (
            math.sqrt(min((t.threshold for t in self._tests.get(effect.name, ())), default=0.0))
            + _POWER_SIGMA
        )
        at = max(seen, *(x for x in (delta, needed) if math.isfinite(x)), 0.0)
        upper = self._upper(effect, group, planned=planned)
        detected = delta_of_power(curve, CONFIDENCE) if self._tests else np.inf
        if detected < _ONE_SIDED and not math.isnan(upper):
            # if a parameter is at its bound, the search may detect a smaller strength than the limit from the estimate
            upper = detected
        return EffectLimits(
            effect,
            strength.symbol,
            unit,
            shape,
            1 / root,
            torque,
            needed / root,
            (needed * ranged[0], needed * ranged[1]),
            upper / root,
            float(np.interp(delta, *curve.T)) if self._tests and math.isfinite(delta) else float("nan"),
            wanted,
            self._runs(effect, delta, needed) if self._tests and math.isfinite(delta) else float("nan"),
            self._indistinguishable(effect, group, at) if self._tests else (),
            curve,
        )

    def _unit_torques(self, effect: Effect) -> Array:
        """Return the rms torque of a unit strength for each choice of the shape constants [N m / unit]."""
        trials = self._trials[effect.name][0]
        if not effect.mechanical:
            return np.full(len(trials), np.nan)
        if effect.depends_on_angle:
            return np.full(len(trials), math.sqrt(0.5))
        found = []
        for t in trials:
            both = [c.torque(effect, t.shape) for c in self.cases]
            bodies = [float(np.mean([np.mean(b[i] ** 2) for b in both])) for i in (0, 1)]
            found.append(math.sqrt(max(bodies)))
        return np.array(found)

    def _size(self, unit_torque: float, size: float | None) -> float:
        wanted = self.default_size if size is None else size
        return wanted / unit_torque if unit_torque > 0 else float("nan")

    @property
    def default_size(self) -> float:
        """1 % of the typical torque [N m]."""
        return _SIZE * self.typical_torque

    @property
    def typical_torque(self) -> float:
        """Rms torque of the bearing along the motion; for a single body, of the net torque [N m]."""
        return float(np.sqrt(np.mean([np.mean(c.typical_torque**2) for c in self.cases])))

    def _upper(self, effect: Effect, group: int, *, planned: bool) -> float:
        """Return the upper limit of the noncentrality; NaN if the effect is significant."""
        common = self._common[effect.name]
        data = np.zeros_like(self._level.residual) if planned else self._level.residual
        tests = () if planned else self._tests.get(effect.name, ())
        if any(float(t.best(t.basis.T @ data[:, None])[0]) > t.threshold for t in tests):
            return float("nan")
        p = (common.basis.T @ data)[group * common.width : (group + 1) * common.width]
        limit = upper_limit(p, one_sided=common.one_sided)
        if common.width > 1:
            return limit
        response = self._whitened(self._stacked(effect)[group : group + 1])[:, 0] / common.root[group]
        return self._bounds.largest_strength(response, data, limit, one_sided=common.one_sided)

    def _runs(self, effect: Effect, delta: float, needed: float) -> float:
        """Return the number of runs that detect an effect of noncentrality `delta` in all present runs together."""
        if delta <= 0 or not math.isfinite(needed):
            return np.inf
        cases = len(self.cases)
        parameters = len(effect.free)
        first = max(1, math.ceil(cases * (needed / delta) ** 2 - 1e-9))
        for n in range(first, min(first + 100, _MOST_RUNS + 1)):
            # the penalty of BIC increases with the number of rows
            more = parameters * math.log(max(n / cases, 1e-9))
            if n / cases * delta**2 >= needed**2 + max(more, 0.0):
                return float(n)
        return np.inf

    def _indistinguishable(self, effect: Effect, group: int, delta: float) -> tuple[str, ...]:
        """Return the effects that are indistinguishable from an effect of this noncentrality."""
        u = self._common[effect.name].direction(group)
        names = []
        for e in self.effects:
            if e.name == effect.name:
                continue
            other = self._common[e.name]
            # an effect of either sign is compared with both signs
            signs = (1, -1) if other.one_sided and not self._common[effect.name].one_sided else (1,)
            each = [other.scores(other.basis.T @ (sign * u)[:, None]) for sign in signs]
            cosine2 = max(float(x.max(initial=0.0)) for x in each)
            penalty = (len(e.free) - len(effect.free)) * math.log(self.fit.problem.rows)
            if delta**2 * (1 - min(cosine2, 1.0)) + penalty < self.criteria.equivalence_width:
                names.append(e.name)
        return tuple(names)


def largest_hidden(
    fit: Fit, extra: Sequence[Effect], criteria: Criteria, candidates: Sequence[Candidate] = ()
) -> HiddenEffects:
    """Return the physical effects with the largest upper limits of the rms torque, and the effects without a limit.

    An effect has no limit if the model absorbs it. A limit above the torque of the bearing (for a single body: the net
    torque) contains no information. If an effect without shape constants was refitted as one of the `candidates`, its
    limit is at least the limit that follows from the refit.
    """
    search = Search(fit, extra, criteria, draws=1)
    refits = {c.effect.name: c.fit for c in candidates if c.fit is not None}
    found = [
        _at_least_of_refit(search.limits(e), refits.get(e.name))
        for e in search.effects
        if e.kind == "physical"
    ]
    limited = [e for e in found if e.upper_torque < search.typical_torque]
    finite = sorted(limited, key=lambda e: -e.upper_torque)
    limits = [
        UpperLimit(e.effect.name, e.strength, e.upper_limit, e.unit, e.upper_torque)
        for e in finite[:_MOST_HIDDEN]
    ]
    without = [e for e in found if e.absorbed or e.upper_torque >= search.typical_torque]
    return HiddenEffects(tuple(limits), tuple(e.effect.name for e in without))


def _at_least_of_refit(limits: EffectLimits, refit: Fit | None) -> EffectLimits:
    """Return the limits with an upper limit that is at least |k| + 1.64 se of the refit.

    The motion of a slow body is not linear in an angle-dependent torque, so the limit of first order may be too small.
    The refit is not linearised.
    """
    if refit is None or limits.shape or limits.absorbed:
        return limits
    key = f"{limits.effect.name}.{limits.strength}"
    found = [
        abs(e.value) + _ONE_SIDED * e.stderr
        for name, e in refit.estimates.items()
        if name.partition("@")[0] == key and math.isfinite(e.stderr)
    ]
    return replace(limits, upper_limit=max(limits.upper_limit, *found)) if found else limits


def _profile_limit(free: Array, response: Array, data: Array, bounds: Array, limit: float) -> float:
    """Return the strength in (0, limit) at which the profile with bounds exceeds its minimum by 1.64 squared."""
    from scipy.optimize import brentq, lsq_linear, minimize_scalar

    def profile(k: float) -> float:
        return 2 * float(lsq_linear(free, data - k * response, (bounds[0], bounds[1]), method="bvls").cost)

    best = minimize_scalar(profile, bounds=(0.0, limit), method="bounded", options={"xatol": 1e-3 * limit})
    at, least = (0.0, profile(0.0)) if profile(0.0) <= best.fun else (float(best.x), float(best.fun))
    if profile(limit) - least <= _ONE_SIDED**2:
        return limit
    return float(brentq(lambda k: profile(k) - least - _ONE_SIDED**2, at, limit, rtol=1e-3))


def _smallest_score(
    null: NullDistribution, family: FamilywiseNull, factor: float, significance: float
) -> float:
    """Return the smallest score that is significant in the whole list."""
    low, high = 0.0, _LARGEST_SCORE
    for _ in range(30):
        middle = 0.5 * (low + high)
        if family(np.minimum(1.0, factor * null(middle)), null.weights) < significance:
            high = middle
        else:
            low = middle
    return high


def _median_shape(root: Array, torque: Array) -> tuple[int, tuple[float, float]]:
    """Return the index of the shape with the median limit, and the extreme torques of unit noncentrality."""
    with np.errstate(divide="ignore", invalid="ignore"):
        per_sigma = np.where(root > 0, (1.0 if np.isnan(torque).any() else torque) / root, np.inf)
    order = np.argsort(per_sigma)
    finite = order[np.isfinite(per_sigma[order])]
    if not len(finite):
        return int(order[0]), (np.inf, np.inf)
    middle = int(finite[len(finite) // 2])
    return middle, (float(per_sigma[finite[0]]), float(per_sigma[finite[-1]]))


def delta_of_power(curve: Array, power: float = POWER) -> float:
    """Return the noncentrality at which a monotonic power curve reaches a power; infinite if it does not."""
    rising = np.maximum.accumulate(curve[:, 1])
    i = int(np.argmax(rising >= power))
    if rising[i] < power or i == 0:
        return np.inf
    from scipy.special import ndtri

    # the power is nearly a normal distribution function of delta
    a, b = (float(ndtri(np.clip(x, 1e-3, 1 - 1e-3))) for x in rising[i - 1 : i + 1])
    share = (float(ndtri(power)) - a) / (b - a) if b > a else 1.0
    return float(curve[i - 1, 0] + share * (curve[i, 0] - curve[i - 1, 0]))


def upper_limit(projections: Array, *, one_sided: bool) -> float:
    """Return the 95 % upper limit of the noncentrality from projections on an orthonormal basis.

    A projection is the estimate divided by its standard error; an amplitude with a phase has two projections, for sine
    and cosine. A strength that cannot be negative is `one_sided`.
    """
    if len(projections) == 1:
        p = float(projections[0])
        return (max(p, 0.0) if one_sided else abs(p)) + _ONE_SIDED
    from scipy.special import chndtrinc

    # a score below the median of the null distribution would give a limit to which the data are not sensitive
    score = max(float(projections @ projections), 1.3862944)
    return float(np.sqrt(chndtrinc(score, len(projections), 1 - CONFIDENCE)))
