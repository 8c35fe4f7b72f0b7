"""The laws of an oscillator from its averaged equations of motion: restoring torque and damping.

Sets of laws are compared by BIC. The residuals of amplitude and phase are correlated in time. Let r be the correlation
of adjacent residuals of the most general model. Then n residuals contain the information of n (1 - r) / (1 + r)
independent residuals (M. S. Bartlett, J. R. Stat. Soc. 98, 1935), and their chi-square is multiplied by
(1 - r) / (1 + r). Deviations that no set of laws describes, for example a motion that is not plane, increase r and thus
the standard errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT, Criteria
from fitting._errors import FittingError
from fitting.dynamics._model import Model
from fitting.effects._effect import Effect
from fitting.inference._averaging import LARGEST_PHASE_ERROR, Averaged
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._initial_values import averaged_fit
from fitting.inference._parameters import ParameterLayout
from fitting.inference._result import Fit

Array = NDArray[np.float64]
Names = tuple[str, ...]

_SPRING, _CUBIC, _GRAVITY = "casing.spring.linear", "casing.spring.cubic", "casing.gravity"
_RESTORING: tuple[Names, ...] = ((_SPRING,), (_GRAVITY,), (_SPRING, _CUBIC))
_DAMPING = ("touchpoint.constant", "casing.air.linear", "casing.air.quadratic")
_GENERAL = (_SPRING, _CUBIC, *_DAMPING)
_MOST_CORRELATED = 0.98
"""Upper limit of the correlation of adjacent amplitudes [1]. Chosen: at this limit 10,000 samples count as 100
independent samples; a larger value makes chi-square vanish, a smaller one understates the errors of slow deviations."""
_BLOCKS = 12
"""Number of parts of the jackknife [1]. Chosen: a smaller number gives uncertain standard errors, a larger one gives
correlated parts."""
_OF_AVERAGING = 5e-3
"""Relative error of a strength from the averaged equations, which are of first order [1]. Measured: up to 0.5 % for a
pendulum with an amplitude of 94 degrees and for springs that soften by a tenth; the recordings are not stated."""
_CONTRADICTING_SHARE = 0.2
"""Relative difference from the averaged equations above which an exact value contradicts them [1]. Chosen: a smaller
value takes the error of these equations for a contradiction, a larger one accepts a fit to a wrong motion."""
_CONTRADICTING_SIGMA = 5.0
"""Difference from the averaged equations above which an exact value contradicts them [standard uncertainties]. Chosen:
a smaller value takes noise for a contradiction, a larger one accepts a fit to a wrong motion."""


@dataclass(frozen=True)
class Strength:
    """Strength of a law of an oscillator."""

    value: float  #: Value [`unit`].
    #: Standard uncertainty; it contains the error of the averaged equations if they are used [`unit`].
    stderr: float
    unit: str  #: Unit of the value and its uncertainty.
    approximate: bool = True  #: Whether the value is from the averaged equations.

    def contradicts(self, exact: Strength) -> bool:
        """Return whether the strength of an exact fit differs by more than both thresholds.

        A strength at its bound has no finite uncertainty; its uncertainty counts as zero.
        """
        u = math.hypot(self.stderr, exact.stderr if math.isfinite(exact.stderr) else 0.0)
        least = max(_CONTRADICTING_SHARE * abs(self.value), _CONTRADICTING_SIGMA * u)
        return abs(exact.value - self.value) > least


@dataclass(frozen=True)
class LawSet:
    """A set of laws with their strengths from the averaged equations."""

    restoring: Names  #: Names of the restoring torques.
    damping: Names  #: Names of the damping torques.
    parameters: dict[str, Strength]  #: Strengths, by key as in a fit.


@dataclass(frozen=True)
class OscillatorLaws:
    """The laws of an oscillator."""

    #: Restoring torques of the smallest set that the data do not separate from the set of lowest BIC.
    restoring: Names
    damping: Names  #: Damping torques of this set.
    restoring_classes: tuple[Names, ...]  #: All inseparable sets of restoring torques, by ascending BIC.
    damping_classes: tuple[Names, ...]  #: All inseparable sets of damping torques, by ascending BIC.
    parameters: dict[str, Strength]  #: Strengths of the chosen set, by key as in a fit.
    sets: tuple[LawSet, ...] = ()  #: All sets of laws that describe the phase, by ascending BIC.

    def with_fit(self, fit: Fit) -> tuple[OscillatorLaws, str]:
        """Return the laws with the effects and values of an exact fit, and a sentence that states a contradiction.

        The fit contradicts these laws if its restoring torques are not in `restoring_classes`, or if a strength differs
        from the strength by the averaged equations. The laws are then returned unchanged. Without a contradiction, the
        sentence is empty.
        """
        names = {e.name for e in fit.model.effects}
        exact = [tuple(n for n in group if n in names) for group in ((_SPRING, _CUBIC, _GRAVITY), _DAMPING)]
        if exact[0] not in self.restoring_classes:
            return self, (
                f"The restoring torque of the fitted model is {' + '.join(exact[0]) or 'no law of the list'}, but "
                f"amplitude and phase alone are described by {' + '.join(self.restoring)}: the data separate these "
                "laws, but none of them describes all data."
            )
        values = _exact_strengths(fit)
        wrong = self._contradicted(values)
        if wrong is not None:
            return self, (
                f"The exact fit gives {wrong} = {values[wrong].value:.4g} {values[wrong].unit}, but amplitude and "
                f"phase give {self.parameters[wrong].value:.4g} +- {self.parameters[wrong].stderr:.1g}, which are "
                "shown: the body is disturbed, or another law acts."
            )
        damping = exact[1] if exact[1] in self.damping_classes else self.damping
        chosen = {
            k: v
            for k, v in (self.parameters | values).items()
            if k.rpartition(".")[0] in (*exact[0], *damping)
        }
        return replace(self, restoring=exact[0], damping=damping, parameters=chosen), ""

    def wrong_period(self, fit: Fit) -> str:
        """Return a sentence if the spring or the gravity of an exact fit contradicts the measured period, else "".

        Such a fit has converged to another frequency, and its random torque describes the motion.
        """
        values = _exact_strengths(fit)
        wrong = self._contradicted(
            {k: v for k, v in values.items() if k in (f"{_SPRING}.k", f"{_GRAVITY}.k")}
        )
        if wrong is None:
            return ""
        exact, right = values[wrong], self.parameters[wrong]
        return (
            f"the exact fit gives {wrong} = {exact.value:.4g} {exact.unit}, but the measured period requires "
            f"{right.value:.4g} {right.unit}: the fit does not describe the oscillation"
        )

    def _contradicted(self, values: dict[str, Strength]) -> str | None:
        return next((k for k, v in self.parameters.items() if k in values and v.contradicts(values[k])), None)


def _exact_strengths(fit: Fit) -> dict[str, Strength]:
    return {k: Strength(e.value, e.stderr, e.unit, approximate=False) for k, e in fit.estimates.items()}


def oscillator_laws(data: CaseData, criteria: Criteria = DEFAULT) -> OscillatorLaws | None:
    """Return the laws of an oscillator from the recording of a single body.

    None if the body does not oscillate through enough periods, or if no set of laws describes its phase. The data
    separate two sets if their BIC differ by `Criteria.equivalence_width` or more.
    """
    general = averaged_fit(Model.of(_GENERAL), [data])
    if general is None:
        return None
    shares = _information(general)
    found: list[tuple[float, Names, Names, Averaged]] = []
    for restoring in _RESTORING:
        for damping in chain.from_iterable(combinations(_DAMPING, n) for n in range(len(_DAMPING) + 1)):
            fitted = averaged_fit(Model.of((*restoring, *damping)), [data], general.scales)
            if fitted is not None and fitted.phase_error < LARGEST_PHASE_ERROR:
                found.append((_bic(fitted, shares), restoring, damping, fitted))
    if not found:
        return None
    found.sort(key=lambda f: f[0])
    close = [f for f in found if f[0] - found[0][0] < criteria.equivalence_width]
    chosen = min(close, key=lambda f: len(f[1]) + len(f[2]))
    sets = {(f[1], f[2]): LawSet(f[1], f[2], _strengths(f[3], shares, data)) for f in found}
    return OscillatorLaws(
        chosen[1],
        chosen[2],
        tuple(dict.fromkeys(f[1] for f in close)),
        tuple(dict.fromkeys(f[2] for f in close)),
        sets[chosen[1], chosen[2]].parameters,
        tuple(sets.values()),
    )


def fit_oscillator(
    laws: OscillatorLaws, model_of: Callable[[Names], Model], data: CaseData, criteria: Criteria = DEFAULT
) -> tuple[OscillatorLaws, Fit]:
    """Return the laws of an oscillator and their exact fit.

    Amplitude and phase of a period contain less information than its samples, and at a large amplitude the error of the
    averaged equations exceeds the noise. Therefore the sets are fitted exactly in two steps. First, each inseparable
    set of damping torques is fitted with the restoring torques of lowest BIC. Second, the best damping torques are
    fitted with each of the other inseparable sets of restoring torques. The fit with the lowest BIC is returned. If the
    recording has more than 125 reversals, too many for `Criteria.refit_least` refits, only the chosen set is fitted.
    """
    reversals = len(data.motion.reversals)
    if not laws.sets or criteria.refits_through(reversals) < criteria.refit_least:
        return laws, fit(model_of((*laws.restoring, *laws.damping)), [data])
    fits: list[tuple[LawSet, Fit]] = []
    failures: list[FittingError] = []

    def fitted(sets: Iterable[LawSet]) -> None:
        for one in sets:
            try:
                fits.append((one, fit(model_of((*one.restoring, *one.damping)), [data])))
            except FittingError as error:
                failures.append(error)
        fits.sort(key=lambda f: f[1].bic)

    first = laws.sets[0].restoring
    fitted(s for s in laws.sets if s.restoring == first and s.damping in laws.damping_classes)
    damping = fits[0][0].damping if fits else laws.damping
    fitted(s for s in laws.sets if s.restoring != first and s.damping == damping)
    if not fits:
        raise failures[0]
    close = [f for f in fits if f[1].bic - fits[0][1].bic < criteria.equivalence_width]
    chosen, exact = min(close, key=lambda f: len(f[1].model.effects))
    found = OscillatorLaws(
        chosen.restoring,
        chosen.damping,
        tuple(dict.fromkeys(f[0].restoring for f in close)),
        tuple(dict.fromkeys(f[0].damping for f in close)),
        chosen.parameters,
        laws.sets,
    )
    return found, exact


def possible_restoring(
    model: Model, effects: Sequence[Effect], data: Sequence[CaseData], criteria: Criteria
) -> set[str] | None:
    """Return the names of the restoring torques with which a model without restoring torque could oscillate.

    These are all restoring torques that the data do not separate by BIC. None if the averaged equations give no answer,
    or if there are several cases.
    """
    if len(data) > 1:
        return None
    general = averaged_fit(Model.of(_GENERAL), data)
    if general is None:
        return None
    shares, found = _information(general), {}
    for effect in effects:
        fitted = averaged_fit(model.with_effect(effect), data, general.scales)
        if fitted is not None and fitted.phase_error < LARGEST_PHASE_ERROR:
            found[effect.name] = _bic(fitted, shares)
    least = min(found.values(), default=math.inf) + criteria.equivalence_width
    return {name for name, bic in found.items() if bic < least} or None


def _information(general: Averaged) -> Array:
    """Return the shares (1 - r) / (1 + r) of independent residuals, for amplitude and for phase."""
    shares = []
    for rest in np.split(general.rows[0][2], 2):
        r = float(rest[1:] @ rest[:-1]) / max(float(rest @ rest), 1e-300)
        r = min(max(r, 0.0), _MOST_CORRELATED)
        shares.append((1 - r) / (1 + r))
    return np.array(shares)


def _bic(fitted: Averaged, shares: Array) -> float:
    keys, _, rest = fitted.rows[0]
    squares = (rest.reshape(2, -1) ** 2).sum(axis=1)
    return float(shares @ squares) + len(keys) * math.log(max(float(shares.sum()) * len(rest) / 2, 2.0))


def _jackknife(design: Array, rest: Array, scale: Array) -> Array:
    """Return the standard errors of the strengths by a block jackknife with `_BLOCKS` parts of the record.

    Unlike standard errors from the correlation of adjacent residuals, these standard errors contain the effect of slow
    deviations, for example a missing law or a drift of the frequency (R. G. Miller, Biometrika 61, 1974; blocks: H. R.
    Kuensch, Ann. Stat. 17, 1989).
    """
    count = len(rest) // 2
    level = np.kron(np.eye(2), np.ones((count, 1))) / scale[:, None]
    rows = np.column_stack([design, level])
    size = np.linalg.norm(rows, axis=0)
    block = np.tile(np.arange(count) * _BLOCKS // count, 2)
    found = np.array(
        [np.linalg.lstsq(rows[block != b] / size, rest[block != b])[0] / size for b in range(_BLOCKS)]
    )[:, : design.shape[1]]
    return np.asarray(np.sqrt((_BLOCKS - 1) * found.var(axis=0)))


def _strengths(best: Averaged, shares: Array, data: CaseData) -> dict[str, Strength]:
    """Return the strengths of a set of laws.

    The standard uncertainty combines a random error with the error of the averaged equations. The random error is the
    larger of the least-squares error, which is scaled if the reduced chi-square exceeds 1, and the error of the block
    jackknife.
    """
    keys, design, rest = best.rows[0]
    blocks = np.split(design, 2)
    precision = shares[0] * blocks[0].T @ blocks[0] + shares[1] * blocks[1].T @ blocks[1]
    covariance = np.linalg.pinv(precision)
    chi2 = float(shares @ (rest.reshape(2, -1) ** 2).sum(axis=1))
    free = max(float(shares.sum()) * len(rest) / 2 - len(keys) - 2, 1.0)
    errors = np.sqrt(np.diag(covariance) * max(1.0, chi2 / free))
    errors = np.maximum(errors, _jackknife(design, rest, best.scales[0]))
    layout = ParameterLayout.of(Model.of([k.rpartition(".")[0] for k in keys]), [data.record])
    by_key = dict(zip(layout.names, best.theta, strict=True))
    return {
        k: Strength(float(by_key[k]), math.hypot(float(u), _OF_AVERAGING * by_key[k]), layout.unit(k))
        for k, u in zip(keys, errors, strict=True)
    }
