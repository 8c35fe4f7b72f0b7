"""The friction laws of a contact that a motion separates: Coulomb, Stribeck, starvation, Dahl, LuGre, Maxwell slip.

Each law acts along a motion with the strength of the present dry friction and typical shape constants. A rival law,
together with Coulomb and viscous friction, is fitted to this torque; the best of its trial shapes counts. The square of
the residual of this fit, in the whitened rows of the recording, is the expected difference of deviance in favour of the
right law. Three motions of equal length are compared, with the same samples and noise: the motion of the recording, a
motion that reverses about rest, and a slow ramp of the speed from rest. A body that turns in one sense begins to slide
after a small angle. From then on its friction is a function of the speed, and even a long recording does not show
pre-sliding, the elastic yielding of the contact before it slides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT, Criteria
from fitting._errors import EstimationError
from fitting._numbers import on_screen
from fitting.discovery._score import CaseColumns
from fitting.dynamics._collocation import Sampler
from fitting.effects._effect import Effect
from fitting.effects._expression import Tape
from fitting.effects._library import FRICTION, find
from fitting.inference._record import scales_of
from fitting.inference._result import Fit

Array = NDArray[np.float64]

# laws that are always fitted: Coulomb and viscous friction
_ALWAYS = FRICTION[:2]
_FINE = 16
"""Number of times in each cell of the recording at which a law is evaluated [1]. Chosen: a smaller number blurs laws
that change within a cell, a larger one costs time."""
_REVERSALS = 10
"""Number of reversals of the second motion [1]. Chosen: a smaller number shows less of the hysteresis, a larger one is
not practical."""
_AMPLITUDE = 4.0
"""Amplitude of the second motion, relative to the pre-sliding angle of the contact [1]. Chosen: with a smaller value
the contact does not slide; with a larger one, pre-sliding is a small part of the motion."""
_SHARE = 0.1
"""Assumed dry friction of a model without dry friction, as a share of its rms net torque [1]. Chosen: with a smaller
value the motions separate too few laws, a larger one is not realistic."""


@dataclass(frozen=True)
class Motion:
    """A motion: times and speeds of the casing, at `_FINE` times in each cell."""

    name: str
    time: Array  # shape (cells * fine,)
    omega: Array


@dataclass(frozen=True)
class Pair:
    """Two laws, and for each motion the expected difference of deviance in favour of the first law."""

    first: str
    second: str
    evidence: Mapping[str, float]

    def separated(self, motion: str, width: float) -> bool:
        """Return whether a motion separates the two laws."""
        return self.evidence[motion] > width


class FrictionStrength(TypedDict):
    """The strength of the dry friction for which laws are compared."""

    value: float  #: Strength [`unit`].
    unit: str  #: Unit of the strength.


class PairDocument(TypedDict):
    """Two friction laws, and the motions that separate them."""

    law: str  #: Friction law.
    rival: str  #: The law with which it is compared.
    #: Expected difference of deviances by motion: `recording`, `reversals`, `ramp` [1].
    evidence: dict[str, float]
    separated_by: list[str]  #: Motions that separate the laws.


class FrictionDocument(TypedDict):
    """The friction laws of a contact that the recording, reversals and a slow ramp separate."""

    strength: FrictionStrength  #: Strength of the dry friction.
    width: float  #: Smallest difference of deviances of two separated laws [1].
    pairs: list[PairDocument]  #: Every pair of laws.
    sentences: list[str]  #: The result in words.


@dataclass(frozen=True, repr=False)
class FrictionPlan:
    """The friction laws that the recording and two other motions separate."""

    strength: float  # strength of the dry friction [torque unit]
    unit: str
    pairs: tuple[Pair, ...]
    width: float  # smallest difference of deviances of two separated laws
    amplitude: float  # amplitude of the motion that reverses [rad]
    ramp: float  # last speed of the ramp [rad/s]

    def __repr__(self) -> str:
        return on_screen(self.sentences)

    @property
    def sentences(self) -> list[str]:
        """Return the result as sentences."""
        names = ("recording", "reversals", "ramp")
        runs = {
            "reversals": f"a run of {_REVERSALS} reversals with an amplitude of {self.amplitude:.2g} rad about rest",
            "ramp": f"a slow ramp of the speed from rest to {self.ramp:.2g} rad/s",
        }
        own = [p for p in self.pairs if p.separated(names[0], self.width)]
        count = len(self.pairs)
        strength = f"dry friction {self.strength:.3g} {self.unit}"
        lines = [f"This recording separates {len(own)} of {count} pairs of friction laws ({strength})."]
        left = [p for p in self.pairs if p not in own]
        for name in names[1:]:
            found = [p for p in left if p.separated(name, self.width)]
            if found:
                lines.append(f"{runs[name][0].upper()}{runs[name][1:]} separates {_grouped(found)}.")
        never = [p for p in left if not any(p.separated(n, self.width) for n in names[1:])]
        if never:
            lines.append(f"None of these runs separates {_grouped(never)}.")
        return lines

    def document(self) -> FrictionDocument:
        """Return the result as a part of the JSON document of `gyrotrack plan`."""
        return {
            "strength": {"value": self.strength, "unit": self.unit},
            "width": self.width,
            "pairs": [
                {
                    "law": p.first,
                    "rival": p.second,
                    "evidence": dict(p.evidence),
                    "separated_by": [n for n in p.evidence if p.separated(n, self.width)],
                }
                for p in self.pairs
            ],
            "sentences": self.sentences,
        }


def _grouped(pairs: Sequence[Pair]) -> str:
    """Return pairs of laws as text: each law once, with all its rivals."""
    rivals: dict[str, list[str]] = {}
    for p in pairs:
        rivals.setdefault(p.first, []).append(p.second)
    return "; ".join(f"{first} from {', '.join(others)}" for first, others in rivals.items())


def friction_plan(fit: Fit, *, criteria: Criteria = DEFAULT) -> FrictionPlan:
    """Return the friction laws that the first recording of a fit and other runs separate.

    Parameters
    ----------
    fit : Fit
        A fit of the present recordings.
    criteria : Criteria
        Its `equivalence_width` is the largest difference of deviances of laws that are not separated.

    Raises
    ------
    EstimationError
        If no torque acts during the motion.
    """
    strength = _strength(fit)
    responses = _Responses(fit)
    scales = scales_of(fit.problem.layout.records)
    laws = [
        replace(e, parameters=e.parameters_at(*scales)) for e in map(find, FRICTION) if e.name not in _ALWAYS
    ]
    yielding = max(_typical(e)["s"] for e in laws if e.contact)
    edges = responses.edges
    first, last = float(edges[0]), float(edges[-1])
    inside = (np.arange(_FINE) + 0.5) / _FINE
    fine = (edges[:-1, None] + np.diff(edges)[:, None] * inside).ravel()
    x = (fine - first) / (last - first)
    path = fit.predictions[0].path
    omega = Sampler(path.mesh, fine).value(path.y[..., path.states.index("omega_c")])
    amplitude, turning = _AMPLITUDE * yielding, math.pi * _REVERSALS
    ramp = float(np.median(np.abs(omega)))
    motions = (
        Motion("recording", fine, omega),
        Motion("reversals", fine, amplitude * turning / (last - first) * np.cos(turning * x)),
        Motion("ramp", fine, ramp * x),
    )
    pairs = []
    for one, other in product(laws, laws):
        if one is not other:
            evidence = {m.name: responses.evidence(one, other, m, strength) for m in motions}
            pairs.append(Pair(one.name, other.name, evidence))
    return FrictionPlan(strength, fit.torque_unit, tuple(pairs), criteria.equivalence_width, amplitude, ramp)


def _strength(fit: Fit) -> float:
    """Return the dry friction of a model, or a tenth of the rms net torque if it contains no dry friction."""
    dry = find(_ALWAYS[0])
    own = [e.value for k, e in fit.estimates.items() if k.startswith(f"{dry.name}.")]
    if own and own[0] > 0:
        return float(own[0])
    case, prediction = fit.problem.cases[0], fit.predictions[0]
    numbers = fit.problem.layout.numbers(fit.theta, 0)
    rates = case.dynamics.rates(prediction.path.mesh.times, prediction.path.y, numbers)[..., 1]
    torque = _SHARE * float(np.sqrt(np.mean(rates**2))) * case.data.record.I_casing
    if not torque > 0:
        raise EstimationError("the motion has no torque", "plan with a recording of a body that slows down")
    return torque


def _typical(effect: Effect) -> dict[str, float]:
    """Return the strength 1 and the typical value of each shape constant."""
    return {p.symbol: 1.0 if p.role == "amplitude" else p.start for p in effect.parameters}


def _trials(effect: Effect) -> Iterator[dict[str, float]]:
    """Yield choices of the shape constants, with the strength 1.

    The choices are all trial values, the typical values, and zero if zero is a bound.
    """
    shapes = [p for p in effect.parameters if p.role == "shape"]
    grids = [dict.fromkeys((*p.grid, p.start, *((0.0,) if p.lower == 0 else ()))) for p in shapes]
    for values in product(*grids):
        yield _typical(effect) | dict(zip((p.symbol for p in shapes), values, strict=True))


def torque_along(effect: Effect, values: Mapping[str, float], motion: Motion) -> Array:
    """Return the torque of a law along a motion.

    State variables are exact if their rates are constant between the times.
    """
    known: dict[str, Array | float] = dict(values) | {"omega_c": motion.omega, "t": motion.time}
    for state, rate in zip(effect.states, effect.rates, strict=True):
        # each rate is linear in the state: source + decay * state
        source, at_one = (
            np.broadcast_to(
                np.asarray(Tape([rate])(known | {state.symbol: z})[0], dtype=float), motion.omega.shape
            )
            for z in (0.0, 1.0)
        )
        decay = at_one - source
        h = np.diff(motion.time)
        mean_source, exponent = 0.5 * (source[1:] + source[:-1]), 0.5 * h * (decay[1:] + decay[:-1])
        factor = np.exp(exponent)
        gain = (
            h
            * mean_source
            * np.where(exponent == 0, 1.0, np.expm1(exponent) / np.where(exponent == 0, 1.0, exponent))
        )
        found = np.empty(len(motion.time))
        found[0] = state.start
        for i in range(len(h)):
            found[i + 1] = factor[i] * found[i] + gain[i]
        known[state.symbol] = found
    law = np.asarray(Tape([effect.expression])(known)[0], dtype=float)
    return np.asarray(np.broadcast_to(law, motion.omega.shape).reshape(-1, _FINE).mean(axis=1))


class _Responses:
    """The whitened response of the rows of a recording to torques, and the columns that are always fitted."""

    def __init__(self, fit: Fit) -> None:
        self._columns = CaseColumns(fit, 0)
        self._project = fit.problem.projections[0]
        self.edges = self._columns.response.edges
        layout, prediction = fit.problem.layout, fit.predictions[0]
        starts = [i for i, k in enumerate(prediction.places) if layout.names[k].startswith("initial.")]
        self._starts = self._project.unexplained(prediction.columns[:, starts])
        self._known: dict[tuple[str, str, tuple[float, ...]], Array] = {}

    def of(self, effect: Effect, values: Mapping[str, float], motion: Motion) -> Array:
        """Return the response to a law of strength 1 along a motion."""
        key = effect.name, motion.name, tuple(values.values())
        if key not in self._known:
            torque = torque_along(effect, values, motion)[:, None]
            rows = self._columns.torque_rows(np.zeros_like(torque), torque)
            self._known[key] = self._project.unexplained(rows)[:, 0]
        return self._known[key]

    def evidence(self, one: Effect, other: Effect, motion: Motion, strength: float) -> float:
        """Return the smallest chi-square of a fit of `other` and the simple laws to the torque of `one`."""
        target = strength * self.of(one, _typical(one), motion)
        simple = [self.of(find(n), _typical(find(n)), motion) for n in _ALWAYS]
        least = math.inf
        for values in _trials(other):
            columns = np.column_stack([self._starts, *simple, self.of(other, values, motion)])
            size = np.linalg.norm(columns, axis=0)
            columns = columns / np.where(size > 0, size, 1.0)
            left = target - columns @ np.linalg.lstsq(columns, target, rcond=1e-9)[0]
            least = min(least, float(left @ left))
        return least
