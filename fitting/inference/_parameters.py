"""The parameter vector of a fit, and transformed variables that make its least-squares problem nearly linear.

For a law d x^m and a power law f x^g of the same speed x on the same body, chi-square has a curved valley in (d, f, g),
because the two laws are nearly the same for g near m. With X = x / x_ref their sum is T1 X^m + K (X^g - X^m) / (g - m),
where T1 is the torque at x_ref and K is a measure of its curvature:

    T1 = d x_ref^m + f x_ref^g,    K = (g - m) f x_ref^g.

This applies to the bearing's d D + f D^g, with m = 1, and to any power law that a user adds to a law of fixed power. A
single power law has the variable F = f x_ref^g instead of f. If one of d and f is fixed at a bound, the other is
replaced by T1, which the data determine well.

A law of strength k and phase phi has the response k [cos(phi) s + sin(phi) c], with the unit responses s and c at phase
0 and at a quarter period. At the bound k = 0 the derivative with respect to phi vanishes, so a search cannot continue
from there with the opposite phase. In the variables

    a = k cos(phi),   b = k sin(phi)

the law is linear and has no bound.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EffectError
from fitting._numbers import Units
from fitting.dynamics._model import Model
from fitting.effects._effect import RATIO, Effect, Parameter
from fitting.effects._expression import Tape
from fitting.effects._mechanism import GYROSCOPE, Mechanism
from fitting.inference._record import Record, scales_of
from fitting.inference._ties import Follower, followers, resolved

Array = NDArray[np.float64]


def start_of(symbol: str) -> str:
    """Return the key of the initial value of a speed or of the deflection."""
    return f"initial.{symbol}"


START_ROTOR, START_CASING, START_DEFLECTION = map(start_of, (*GYROSCOPE.speeds, "deflection"))
_START = Parameter("omega", "rad s-1", "shape", -np.inf, np.inf)
_DEFLECTION = Parameter("deflection", "rad", "shape", -np.inf, np.inf)


@dataclass(frozen=True)
class ParameterLayout:
    """The names of all variables of a fit of some cases."""

    model: Model  # the model
    records: tuple[Record, ...]  # the cases
    # parameters with a separate value for each case, as keys, effects or prefixes of effects
    per_case: tuple[str, ...]
    # bounds by name, narrower than the declared bounds
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    ties: Mapping[str, str] = field(default_factory=dict)  # expressions of dependent parameters, by key

    @classmethod
    def of(
        cls,
        model: Model,
        records: Sequence[Record],
        share: Iterable[str] = (),
        per_case: Iterable[str] = (),
        ranges: Mapping[str, tuple[float, float]] | None = None,
        ties: Mapping[str, str] | None = None,
    ) -> ParameterLayout:
        """Return the layout with the per-case parameters of the paper, changed by `share` and `per_case`."""
        for name in (*share, *per_case):
            if not any(covers(name, key) for key in model.free):
                raise EffectError(
                    f"{name!r} is not a parameter of the model", "it has: " + ", ".join(model.free)
                )
        default = model.per_case
        chosen = [
            key
            for key in model.free
            if (key in default or any(covers(n, key) for n in per_case))
            and not any(covers(n, key) for n in share)
        ]
        own = tuple(chosen) if len(records) > 1 else ()
        return cls(model, tuple(records), own, dict(ranges or {}), dict(ties or {}))

    @cached_property
    def choices(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The arguments `share` and `per_case` of `of`: the parameters that do not follow the defaults of the model."""
        if len(self.records) == 1:
            return (), ()
        usual = self.model.per_case
        return (
            tuple(k for k in self.model.free if k in usual and k not in self.per_case),
            tuple(k for k in self.per_case if k not in usual),
        )

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The name of each variable: `key`, `key@label`, and the initial values of each case."""
        names: list[str] = []
        for key in self.model.free:
            names += [f"{key}@{r.label}" for r in self.records] if key in self.per_case else [key]
        for record in self.records:
            names += [f"{key}@{record.label}" for key in self.starts]
        return tuple(names)

    @property
    def starts(self) -> tuple[str, ...]:
        """The initial values of each case: the speeds, and the deflection if a torque depends on it.

        In a contact without slip the speed of the rotor follows from the speed of the casing.
        """
        first = 0 if self.model.rigid_contact is None else 1
        speeds = tuple(map(start_of, self.model.mechanism.speeds[first:]))
        return (*speeds, START_DEFLECTION) if self.model.restoring else speeds

    @cached_property
    def index(self) -> dict[str, int]:
        """The index of each name."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def tied(self) -> tuple[Follower, ...]:
        """The variables that are expressions of other variables."""
        if not self.ties:
            return ()
        trees = resolved(self.ties, self.model.free, self.model.constants)
        return tuple(followers(trees, self.index, self.model.constants))

    @cached_property
    def is_free(self) -> NDArray[np.bool_]:
        """Mask of the variables that are not expressions of other variables."""
        free = np.ones(len(self.names), dtype=bool)
        free[[one.place for one in self.tied]] = False
        return free

    def places(self, case: int, keys: Sequence[str]) -> NDArray[np.intp]:
        """Return the indices of the parameters of one case."""
        label = self.records[case].label
        return np.array([self.index.get(f"{k}@{label}", self.index.get(k, -1)) for k in keys], dtype=np.intp)

    def numbers(self, theta: Array, case: int) -> dict[str, float]:
        """Return parameters by key, constants and inertias of one case."""
        record = self.records[case]
        values = dict(zip(self.model.free, theta[self.places(case, self.model.free)].tolist(), strict=True))
        names = self.model.mechanism.inertias
        further = (record.further[i][0] for i in range(len(names) - 2))
        inertias = dict(zip(names, (record.I_rotor, record.I_casing, *further), strict=True))
        return values | self.model.constants | inertias

    def start(self, theta: Array, case: int) -> Array:
        """Return the initial values of one case: speeds [rad/s], and the deflection [rad] if it is a state."""
        values = theta[self.places(case, self.starts)]
        rigid = self.model.rigid_contact
        if rigid is None:
            return np.asarray(values)
        return np.concatenate([[values[0] * self.numbers(theta, case)[f"{rigid.name}.{RATIO}"]], values])

    def parameter(self, name: str) -> Parameter:
        """Return the declared parameter of a name."""
        key = name.partition("@")[0]
        return self._declared.get(key, _DEFLECTION if key == START_DEFLECTION else _START)

    @cached_property
    def _declared(self) -> dict[str, Parameter]:
        """The parameters of the model by key, with values in SI units."""
        return parameters_at(self.model.effects, self.records)

    @property
    def units(self) -> Units:
        """Units of all torques: per unit of inertia if no case has a moment of inertia."""
        return Units.common(r.units for r in self.records)

    @property
    def absent(self) -> tuple[str, ...]:
        """Names, without the case, of the initial values of absent bodies; no row depends on them."""
        present, mechanism = self.records[0].parts, self.model.mechanism
        both = zip(mechanism.bodies, mechanism.speeds, strict=True)
        return tuple(start_of(speed) for part, speed in both if part not in present)

    def unit(self, name: str) -> str:
        """Return the unit of a variable."""
        parameter = self.parameter(name)
        driven = {e.name for e in self.model.effects if e.inputs}
        if (
            parameter.unit == "1"
            and parameter.role == "amplitude"
            and name.partition("@")[0].rpartition(".")[0] in driven
        ):
            return self.units.gain
        return self.units.of(parameter.unit)

    def bounds(self) -> tuple[Array, Array]:
        """Return lower and upper bounds of all variables."""
        lower, upper = self.declared_bounds()
        for name, (least, most) in self.ranges.items():
            if name in self.index:
                i = self.index[name]
                lower[i], upper[i] = max(lower[i], least), min(upper[i], most)
        lower[~self.is_free], upper[~self.is_free] = -np.inf, np.inf
        return lower, upper

    def declared_bounds(self) -> tuple[Array, Array]:
        """Return the bounds that effects declare, without the ranges of the fit."""
        declared = [self.parameter(n) for n in self.names]
        return np.array([p.lower for p in declared]), np.array([p.upper for p in declared])

    def at_bound(self, theta: Array) -> NDArray[np.bool_]:
        """Return a mask of the variables at a bound."""
        lower, upper = self.bounds()
        near = 1e-9 * np.maximum(np.abs(theta), 1e-30)
        return np.asarray((theta - lower <= near) | (upper - theta <= near))

    def is_physical_bound(self, name: str) -> bool:
        """Return whether the bounds of a variable are physical (friction dissipates energy)."""
        return self.parameter(name).role == "amplitude" and name not in self.ranges


def parameters_at(effects: Iterable[Effect], records: Sequence[Record]) -> dict[str, Parameter]:
    """Return the parameters of effects in some recordings by key: bounds, start and grid in SI units."""
    scales = scales_of(records)
    return {f"{e.name}.{p.symbol}": p for e in effects for p in e.parameters_at(*scales)}


def covers(name: str, key: str) -> bool:
    """Return whether a name includes a parameter: as its key, its effect, a prefix of the effect, or its symbol."""
    return key == name or key.startswith(name.rstrip(".") + ".") or key.rpartition(".")[2] == name


_NEAREST = 3e-3
"""Smallest distance of a free exponent from the exponent of a fixed power law [1]. Chosen: at smaller distances the
difference of the two terms loses digits and the torque hardly changes; a larger value excludes exponents that the data
determine."""
_SAME = 1e-9
"""Largest relative error of a change of coordinates [1]. Chosen: above the size of rounding errors; a smaller value
refuses valid changes, a larger one accepts inaccurate changes."""


@dataclass(frozen=True)
class PowerLaw:
    """A power law, alone (d is None) or with a law of fixed power m: indices of the variables, x_ref, and m.

    `held` is "d" or "f" if this strength is fixed, otherwise empty.
    """

    d: int | None
    f: int
    g: int
    reference: float
    order: float = 1.0
    held: Literal["", "d", "f"] = ""


def to_physical(u: Array, power_laws: Sequence[PowerLaw]) -> tuple[Array, Array]:
    """Return (d, f, g, ...) and their derivatives with respect to (T1, K, g, ...)."""
    theta, slope = u.copy(), np.eye(len(u))
    for v in power_laws:
        if v.d is None:
            full = v.reference ** u[v.g]
            theta[v.f] = u[v.f] / full
            slope[v.f, v.f] = 1 / full
            slope[v.f, v.g] = -theta[v.f] * np.log(v.reference)
            continue
        if v.held:
            _with_held(theta, slope, u, v, v.d)
            continue
        t1, curvature, g = u[v.d], u[v.f], _away_from(u[v.g], v.order)
        beyond, full, unit = g - v.order, v.reference**g, v.reference**v.order
        theta[v.g] = g
        theta[v.f] = curvature / (beyond * full)
        theta[v.d] = (t1 - curvature / beyond) / unit
        slope[v.f, v.f] = 1 / (beyond * full)
        slope[v.f, v.g] = -theta[v.f] * (1 / beyond + np.log(v.reference))
        slope[v.d, v.d] = 1 / unit
        slope[v.d, v.f] = -1 / (beyond * unit)
        slope[v.d, v.g] = curvature / (beyond**2 * unit)
    return theta, slope


def _with_held(theta: Array, slope: Array, u: Array, v: PowerLaw, d: int) -> None:
    full, unit = v.reference ** u[v.g], v.reference**v.order
    if v.held == "d":
        theta[v.f] = (u[v.f] - u[d] * unit) / full
        slope[v.f, v.f], slope[v.f, d] = 1 / full, -unit / full
        slope[v.f, v.g] = -theta[v.f] * np.log(v.reference)
    else:
        theta[d] = (u[d] - u[v.f] * full) / unit
        slope[d, d], slope[d, v.f] = 1 / unit, -full / unit
        slope[d, v.g] = -u[v.f] * full / unit * np.log(v.reference)


def from_physical(theta: Array, power_laws: Sequence[PowerLaw]) -> Array:
    """Return (T1, K, g, ...) from (d, f, g, ...)."""
    u = theta.copy()
    for v in power_laws:
        if v.d is None:
            u[v.f] = theta[v.f] * v.reference ** theta[v.g]
            continue
        if v.held:
            u[v.f if v.held == "d" else v.d] = (
                theta[v.d] * v.reference**v.order + theta[v.f] * v.reference ** theta[v.g]
            )
            continue
        g = _away_from(theta[v.g], v.order)
        power = theta[v.f] * v.reference**g
        u[v.d] = theta[v.d] * v.reference**v.order + power
        u[v.f] = (g - v.order) * power
        u[v.g] = g
    return u


def _away_from(g: float, order: float) -> float:
    """Return an exponent with a minimum distance from the order of the other law."""
    if abs(g - order) >= _NEAREST:
        return float(g)
    return order + _NEAREST if g >= order else order - _NEAREST


def find_power_laws(layout: ParameterLayout, rough: Sequence[tuple[Array, Array]]) -> tuple[PowerLaw, ...]:
    """Return the power laws of a model that need transformed variables, paired with laws of fixed power.

    x_ref is the median of the rough (times, speeds) of the cases. A pair is not transformed if f has a value for each
    case and g or d is shared, or vice versa.
    """
    known = [_variables(*r, layout.model.mechanism) for r in rough]
    power_laws: list[PowerLaw] = []
    taken: set[str] = set()
    for power in layout.model.smooth.effects:
        shape = exponent(power)
        if shape is None:
            continue
        found = [
            (abs(order - shape.start), order, straight)
            for straight in layout.model.smooth.effects
            if straight.name not in taken and (order := _order(power, straight, known[0])) is not None
            if shape.lower <= order <= shape.upper
        ]
        typical = [float(np.median(x)) for k in known if (x := _base(power, k)) is not None]
        if not typical:
            continue
        reference = float(np.mean(typical)) or 1.0
        _, order, straight = min(found, key=lambda pair: pair[0], default=(0.0, 1.0, None))
        if straight is not None:
            taken.add(straight.name)
        power_laws += _places(layout, power, straight, reference, order)
    return tuple(power_laws)


def exponent(effect: Effect) -> Parameter | None:
    """Return the parameter that may be the exponent of a law: its only shape constant, if this is dimensionless."""
    shapes = [p for p in effect.parameters if p.role == "shape"]
    if effect.inputs or effect.state or effect.joint not in {"rotor", "casing", "bearing"}:
        return None
    if effect.depends_on_angle or effect.restoring:
        return None
    if len(effect.parameters) != 2 or len(shapes) != 1 or shapes[0].unit != "1" or effect.amplitude is None:
        return None
    return shapes[0]


def is_power_law(effect: Effect, times: Array, speeds: Array) -> bool:
    """Return whether a law has the form k x^n with a positive x at these speeds."""
    return (
        exponent(effect) is not None
        and _base(effect, _variables(times, speeds, effect.mechanism)) is not None
    )


def _variables(times: Array, speeds: Array, mechanism: Mechanism) -> dict[str, Array]:
    return {"t": times, **mechanism.motion(speeds.T)}


def _law(effect: Effect, known: dict[str, Array], n: float | None = None) -> Array:
    values = {p.symbol: 1.0 if p.role == "amplitude" or n is None else n for p in effect.parameters}
    with np.errstate(all="ignore"):
        return np.asarray(Tape([effect.expression])(known | values)[0] * np.ones(len(known["t"])))


def _base(effect: Effect, known: dict[str, Array]) -> Array | None:
    """Return x of a law k x^n; None if it has another form."""
    at = [_law(effect, known, n) for n in (0.0, 1.0, 2.0)]
    with np.errstate(all="ignore"):
        x, again = at[1] / at[0], at[2] / at[1]
    finite = np.isfinite(x) & np.isfinite(again)
    if finite.sum() < len(x) / 2 or (x[finite] <= 0).any():
        return None
    return x[finite] if np.allclose(x[finite], again[finite], rtol=_SAME, atol=0) else None


def _order(power: Effect, straight: Effect, known: dict[str, Array]) -> float | None:
    """Return the exponent m with which a power law equals the other law; None if there is no such exponent."""
    if straight.site != power.site or straight.state or straight.inputs:
        return None
    if straight.depends_on_angle or straight.restoring:
        return None
    if len(straight.parameters) != 1 or straight.amplitude is None or _base(power, known) is None:
        return None
    at = [_law(power, known, n) for n in (0.0, 1.0)]
    with np.errstate(all="ignore"):
        x, share = at[1] / at[0], _law(straight, known) / at[0]
        m = np.log(share) / np.log(x)
    valid = np.isfinite(m) & (np.abs(np.log(np.where(x > 0, x, 1.0))) > 0.1)
    if valid.sum() < len(x) / 2 or np.ptp(m[valid]) > 1e-6:
        return None
    return round(float(np.median(m[valid])), 9)


def _places(
    layout: ParameterLayout, power: Effect, straight: Effect | None, reference: float, order: float
) -> list[PowerLaw]:
    shape, strength = exponent(power), power.amplitude
    if shape is None or strength is None:
        return []
    keys = [f"{power.name}.{strength.symbol}", f"{power.name}.{shape.symbol}"]
    if straight is not None and straight.amplitude is not None:
        keys.append(f"{straight.name}.{straight.amplitude.symbol}")
    per_case = [k in layout.per_case for k in keys]
    if per_case[0] != per_case[1] or (per_case[0] and not per_case[-1]):
        return []
    places = dict.fromkeys(tuple(layout.places(i, keys).tolist()) for i in range(len(layout.records)))
    if not all(layout.is_free[list(p)].all() for p in places):
        return []
    return [PowerLaw(d[0] if d else None, f, g, reference, order) for f, g, *d in places]


_TINY = 1e-30
"""Smallest strength; with this value the phase is defined, but the torque has no influence [1]. Derived: it is above
zero and below any relevant strength."""


@dataclass(frozen=True)
class Sinusoid:
    """Indices of a strength and of its phase among the variables."""

    strength: int
    phase: int


def find_sinusoids(layout: ParameterLayout) -> tuple[Sinusoid, ...]:
    """Return the pairs of a free strength and a free phase whose only bound is a strength of zero.

    Laws with a free shape are excluded: the data do not determine the shape while the strength is small. Also excluded
    are laws whose strength has a value per case and whose phase is shared, and laws with a shared strength and a phase
    per case.
    """
    found: dict[Sinusoid, None] = {}
    for effect in layout.model.effects:
        keys = {p.role: f"{effect.name}.{p.symbol}" for p in effect.free}
        if set(keys) != {"amplitude", "phase"}:
            continue
        pair = [keys["amplitude"], keys["phase"]]
        if len(set(pair) & set(layout.per_case)) == 1:
            continue
        for case in range(len(layout.records)):
            found[Sinusoid(*layout.places(case, pair).tolist())] = None
    if not found:
        return ()
    lower, upper = layout.bounds()
    found = {w: None for w in found if layout.is_free[[w.strength, w.phase]].all()}
    return tuple(w for w in found if lower[w.strength] <= 0 and np.isinf(_ends(w, lower, upper)).all())


def _ends(w: Sinusoid, lower: Array, upper: Array) -> list[float]:
    return [float(upper[w.strength]), float(lower[w.phase]), float(upper[w.phase])]


def to_polar(u: Array, sinusoids: Sequence[Sinusoid]) -> tuple[Array, Array]:
    """Return (k, phi) instead of (a, b), the other variables unchanged, and the derivatives of all."""
    theta, slope = u.copy(), np.eye(len(u))
    for w in sinusoids:
        a, b = u[w.strength], u[w.phase]
        k, phi = max(float(np.hypot(a, b)), _TINY), float(np.arctan2(b, a))
        theta[w.strength], theta[w.phase] = k, phi
        pair = [w.strength, w.phase]
        slope[np.ix_(pair, pair)] = [[np.cos(phi), np.sin(phi)], [-np.sin(phi) / k, np.cos(phi) / k]]
    return theta, slope


def from_polar(theta: Array, sinusoids: Sequence[Sinusoid]) -> Array:
    """Return (a, b) instead of (k, phi)."""
    u = theta.copy()
    for w in sinusoids:
        k, phi = theta[w.strength], theta[w.phase]
        u[w.strength], u[w.phase] = k * np.cos(phi), k * np.sin(phi)
    return u
