"""Torque laws outside the library: a grammar of forms, each with a strength and at most two shape constants.

A law applies a form f to one or two variables. It acts on the rotor, on the casing or in the bearing:

    torque = k f(x; w, ...),   x one of t, omega_r, omega_c, delta, psi_c.

A shape constant has the unit of the variable that it scales (speed or time) or is a dimensionless exponent, and the
strength k has the unit that makes the law a torque; `Effect.check` confirms the units. Friction-like forms of a body's
own speed change sign with this speed.

Long formulas have a penalty. A formula of n symbols (variables, functions, operators) from a vocabulary of 2^b symbols
has b n bits. The two-part code (J. Rissanen, Automatica 14, 465 (1978)) therefore adds

    L = 2 ln 2 b n

to BIC. BIC itself contains the penalty of the constants.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from fitting.effects._effect import (
    MOMENTS,
    VARIABLES,
    Effect,
    Joint,
    Parameter,
    State,
    dimension,
    format_unit,
    parse_unit,
    quotient,
)
from fitting.effects._expression import parse

_BITS = 2.0
"""Bits for each symbol of a formula [1]. Chosen: a vocabulary of four symbols; a smaller value prefers long formulas, a
larger one refuses long formulas."""
_OWN_SPEED = {"rotor": "omega_r", "casing": "omega_c", "bearing": "delta"}
_SPEEDS: dict[str, tuple[str, ...]] = {
    "rotor": ("omega_r",),
    "casing": ("omega_c", "omega_r"),
    "bearing": ("delta", "omega_r"),
}
_EXPONENTS = (-1.0, -0.5, 0.25, 0.5, 0.75, 1.25, 1.5, 1.75, 2.25, 2.5, 3.0, 4.0)
"""Trial exponents of a power law [1]. Chosen: quarters and halves in addition to the integers of the library; with
fewer, a fit starts far from the optimum; with more, the search takes longer."""
_SCALES = tuple(float(v) for v in np.geomspace(0.03, 3.0, 13))
"""Trial values of a shape constant that is a speed, divided by the largest speed [1]. Chosen: six per decade; with
fewer, a fit starts far from the optimum; with more, the search takes longer."""
_THRESHOLDS = tuple(round(0.05 + 0.05 * i, 2) for i in range(18))
"""Trial values of a shape constant that is a threshold speed, divided by the largest speed [1]. Chosen: in steps of
0.05; with fewer, narrow laws are overlooked; with more, the search takes longer."""
_TIMES = tuple(float(v) for v in np.geomspace(0.02, 2.0, 10))
"""Trial time constants, divided by the length of the record [1]. Chosen: a shorter time constant affects few rows, a
longer one gives a straight line."""
_NEAR_ZERO = 0.01
"""Smallest speed at which a law with a negative power is admitted, divided by the largest speed [1]. Chosen: a smaller
value admits torques that diverge, a larger one excludes laws of slow bodies."""
_COARSE_MOMENTS = MOMENTS[::3]
"""Trial times t0 of a law with several shape constants, divided by the length of the record [1]. Chosen: every third of
`MOMENTS`; with fewer, a fit starts far from the optimum; with more, the search takes longer."""
_FEWEST_PERIODS = 0.5
"""Smallest number of periods of an oscillating law within a record [1]. Chosen: with fewer the law is a trend; a larger
value overlooks slow oscillations."""
_PHASE_STEP = 2.0
"""Spacing of trial frequencies, as a phase difference over the record [rad]. Chosen: a smaller value costs time, a
larger one passes over narrow peaks."""
_HIGHEST = 1000.0
"""Highest trial frequency of a law, as the phase over the whole record [rad]. Chosen: 5 rad/s in a record of 200 s; the
periodogram finds faster oscillations. A larger value tests the fast oscillations twice, a smaller one overlooks slow
oscillations."""
_MOST_FREQUENCIES = 800
"""Largest number of trial frequencies [1]. Chosen: with fewer, the highest frequency in long records is lower; with
more, the search takes longer."""


@dataclass(frozen=True)
class LawForm:
    """One law of the grammar."""

    effect: Effect  # the law with its parameters, units, bounds and trial values
    form: str  # form of the law in a word: "power", "saturation", ...
    variables: tuple[str, ...]  # the variables on which it depends
    symbols: int  # length of the formula: variables, functions and operators

    @property
    def description_length(self) -> float:
        """Penalty of the length of the formula, added to BIC."""
        return description_length(self.symbols)


def description_length(symbols: int) -> float:
    """Return the penalty of a formula with this number of symbols, added to BIC."""
    return 2 * math.log(2) * _BITS * symbols


@dataclass(frozen=True)
class _Form:
    """A form: the formula with the variable {x}, symbol and kind of each shape constant, and length of the formula.

    `phase` states whether the formula contains a free phase phi.
    """

    name: str
    text: str
    shapes: tuple[tuple[str, str], ...] = ()
    symbols: int = 1
    phase: bool = False


# Forms of a speed x. {s} is "*sign(x)" if x is the body's own speed, otherwise empty. Odd functions of x need no {s}.
_OF_SPEED = (
    _Form("power", "abs({x})**n{s}", (("n", "exponent"),), 2),
    _Form("exponential", "exp(-abs({x})/w){s}", (("w", "speed"),), 3),
    _Form("exponential", "exp(-({x}/w)**2){s}", (("w", "speed"),), 4),
    _Form("exponential growth", "(exp(abs({x})/w) - 1){s}", (("w", "wide speed"),), 4),
    _Form("saturation", "tanh({x}/w)", (("w", "speed"),), 3),
    _Form("saturation", "{x}/(abs({x}) + w)", (("w", "speed"),), 3),
    _Form("saturation", "atan({x}/w)", (("w", "speed"),), 3),
    _Form("saturation", "{x}/sqrt({x}**2 + w**2)", (("w", "speed"),), 5),
    _Form("saturation", "abs({x})**n/(abs({x})**n + w**n){s}", (("w", "speed"), ("n", "steepness")), 6),
    _Form("peak", "{x}/(1 + ({x}/w)**2)", (("w", "speed"),), 4),
    _Form("peak", "{x}*exp(-abs({x})/w)", (("w", "speed"),), 4),
    _Form("logarithm", "log(1 + abs({x})/w){s}", (("w", "speed"),), 3),
    _Form("threshold", "heaviside({x} - w)*({x} - w)", (("w", "threshold"),), 4),
    _Form("threshold", "heaviside({x} - w)*({x} - w)**2", (("w", "threshold"),), 5),
    _Form("threshold", "(1 + tanh(({x} - w)/u))", (("w", "threshold"), ("u", "narrow")), 5),
    _Form("resonance", "1/(1 + (({x} - w)/u)**2)", (("w", "threshold"), ("u", "narrow")), 5),
    _Form("resonance", "exp(-(({x} - w)/u)**2)", (("w", "threshold"), ("u", "narrow")), 5),
    _Form("relaxation", "lag", (("T", "time"),), 3),
    _Form("relaxation", "lag*{x}", (("T", "time"),), 4),
)
_OF_TIME = (
    _Form("power of time", "t**n", (("n", "positive exponent"),), 2),
    _Form("decay in time", "exp(-t/w)", (("w", "time"),), 3),
    _Form("decay in time", "1/(1 + t/w)", (("w", "time"),), 3),
    _Form("logarithm of time", "log(1 + t/w)", (("w", "time"),), 3),
    _Form("oscillation", "sin(w*t - phi)", (("w", "frequency"),), 3, phase=True),
    _Form(
        "decaying oscillation", "exp(-t/u)*sin(w*t - phi)",
        (("w", "few frequencies"), ("u", "time few")), 6, phase=True,
    ),
)  # fmt: skip
# forms with a moment t0, which is a separate parameter in each recording
_EVENTS = (
    _Form("step in time", "heaviside(t - t0)", (("t0", "moment"),), 3),
    _Form("ramp in time", "heaviside(t - t0)*(t - t0)", (("t0", "moment"),), 4),
    _Form("pulse in time", "exp(-((t - t0)/w)**2)", (("t0", "coarse moment"), ("w", "pulse")), 5),
)
_PRODUCTS: dict[str, tuple[tuple[str, tuple[str, ...], int], ...]] = {
    "rotor": (
        ("omega_r*omega_c", ("omega_r", "omega_c"), 3),
        ("omega_r*abs(omega_r)*omega_c", ("omega_r", "omega_c"), 4),
        ("omega_r*t", ("omega_r", "t"), 3),
        ("omega_r*abs(omega_r)*t", ("omega_r", "t"), 4),
    ),
    "casing": (
        ("omega_r*omega_c", ("omega_r", "omega_c"), 3),
        ("omega_r**2*omega_c", ("omega_r", "omega_c"), 4),
        ("omega_r*omega_c**2", ("omega_r", "omega_c"), 4),
        ("omega_c*t", ("omega_c", "t"), 3),
        ("omega_c*abs(omega_c)*t", ("omega_c", "t"), 4),
        ("omega_r*t", ("omega_r", "t"), 3),
    ),
    "bearing": (
        ("delta*omega_c", ("delta", "omega_c"), 3),
        ("delta*omega_r", ("delta", "omega_r"), 3),
        ("delta*omega_c**2", ("delta", "omega_c"), 4),
        ("delta*t", ("delta", "t"), 3),
        ("sign(delta)*t", ("t",), 2),
        ("delta*abs(delta)*t", ("delta", "t"), 4),
    ),
}
# products with a free exponent n
_FREE_PRODUCTS: dict[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "rotor": (),
    "casing": (
        ("abs(omega_r)**n*omega_c", ("omega_r", "omega_c")),
        ("abs(omega_c)**n*omega_r", ("omega_r", "omega_c")),
        ("abs(omega_c)**n*t*sign(omega_c)", ("omega_c", "t")),
    ),
    "bearing": (
        ("abs(delta)**n*omega_c", ("delta", "omega_c")),
        ("abs(delta)**n*t*sign(delta)", ("delta", "t")),
    ),
}
# drag that begins, ends or changes at one moment: a brake, a seal, a lubricant
_SWITCHED = {
    "rotor": ("omega_r", "omega_r*abs(omega_r)"),
    "casing": ("omega_c", "omega_c*abs(omega_c)"),
    "bearing": ("delta", "delta*abs(delta)"),
}
_DECAYING = _SWITCHED | {"casing": (*_SWITCHED["casing"], "omega_r")}
_HARMONICS = (3, 4)
"""Orders of the harmonics of the angle in the grammar; the library contains the lower ones [1]. Chosen: with more
orders, each law is less significant; with fewer, laws of three or four periods per turn are overlooked."""


def grammar(
    ranges: Mapping[str, tuple[float, float]], span: float, *, bodies: Set[str], angles: bool
) -> list[LawForm]:
    """Return all laws of the grammar, with trial values of their constants.

    `ranges` contains the smallest and the largest omega_r, omega_c and delta along the motion [rad/s]; `span` is the
    length of the longest recording [s]. The laws act on, and depend on, these `bodies` only. `angles` states whether
    angles were measured; only then are laws of the angle included.
    """
    found: list[LawForm] = []
    joints: Sequence[Joint] = ("casing", "bearing", "rotor")
    for body in joints:
        for name in _SPEEDS[body]:
            found += [_of_speed(f, body, name, ranges[name], span) for f in _OF_SPEED]
        if body != "rotor":
            found += [_of_time(f, body, span) for f in (*_OF_TIME, *_EVENTS)]
        else:
            found += [_of_time(f, body, span) for f in (*_OF_TIME[:4], *_EVENTS[:1])]
        found += _products(body, span)
    if angles:
        found += [_of_angle(n) for n in _HARMONICS]
    return _with_names([law for law in found if law.effect.bodies <= bodies])


def _with_names(laws: Sequence[LawForm]) -> list[LawForm]:
    """Return the laws with unique names; the second and later laws of a name have the suffixes _2, _3, ..."""
    count: dict[str, int] = {}
    named = []
    for law in laws:
        name = law.effect.name
        count[name] = count.get(name, 0) + 1
        suffix = f"_{count[name]}" if count[name] > 1 else ""
        named.append(replace(law, effect=replace(law.effect, name=name + suffix)))
    return named


def _of_speed(form: _Form, body: Joint, x: str, range_: tuple[float, float], span: float) -> LawForm:
    own = x == _OWN_SPEED[body]
    text = form.text.replace("{s}", f"*sign({x})" if own else "").replace("{x}", x)
    largest = max(abs(v) for v in range_)
    # a negative power is singular near zero speed
    singular = min(abs(v) for v in range_) < _NEAR_ZERO * largest or range_[0] * range_[1] < 0
    kinds = [(s, "positive exponent" if k == "exponent" and singular else k) for s, k in form.shapes]
    shapes = tuple(_shape(symbol, kind, largest, span) for symbol, kind in kinds)
    state = State("lag", f"({x} - lag)/T") if form.name == "relaxation" else None
    return _law(form, body, text, shapes, (x,), state=state)


def _of_time(form: _Form, body: Joint, span: float) -> LawForm:
    text = f"{form.text}*sign(delta)" if body == "bearing" and form.name == "decay in time" else form.text
    shapes = tuple(_shape(symbol, kind, 1.0, span) for symbol, kind in form.shapes)
    return _law(form, body, text, shapes, ("t",), moment=form in _EVENTS)


def _products(body: Joint, span: float) -> Iterator[LawForm]:
    for text, variables, symbols in _PRODUCTS[body]:
        yield _law(_Form("product", text, (), symbols), body, text, (), variables)
    for text, variables in _FREE_PRODUCTS[body]:
        shapes = (_shape("n", "exponent", 1.0, span),)
        yield _law(_Form("product", "", (), 4), body, text, shapes, variables)
    for factor in _DECAYING[body]:
        variable = factor.partition("*")[0]
        form = _Form("product", "", (("w", "time"),), 4 + factor.count("*"))
        yield _law(form, body, f"exp(-t/w)*{factor}", (_shape("w", "time", 1.0, span),), (variable, "t"))
    for factor in _SWITCHED[body]:
        form = _Form("switched drag", "", (("t0", "moment"),), 4 + factor.count("*"))
        shapes = (_shape("t0", "moment", 1.0, span),)
        variables = (factor.partition("*")[0], "t")
        yield _law(form, body, f"heaviside(t - t0)*{factor}", shapes, variables, moment=True)


def _of_angle(n: int) -> LawForm:
    form = _Form("harmonic", "", (), 4, phase=True)
    return _law(form, "casing", f"sin({n}*psi_c - phi)", (), ("psi_c",))


def _law(
    form: _Form,
    body: Joint,
    text: str,
    shapes: tuple[Parameter, ...],
    variables: tuple[str, ...],
    *,
    state: State | None = None,
    moment: bool = False,
) -> LawForm:
    phase = (Parameter("phi", "rad", "phase", -math.inf, math.inf, meaning="phase"),) if form.phase else ()
    # the phase of a sinusoid contains its sign
    lower = 0.0 if form.phase else -math.inf
    law = f"k*{text}" if not text.startswith("1/") else f"k/{text[2:]}"
    strength = Parameter("k", _unit(text, shapes), lower=lower, meaning="strength")
    name = f"law.{body}.{'_'.join(variables)}.{form.name.replace(' ', '_')}"
    jump = "t0" if form.name in {"step in time", "switched drag"} else ""
    effect = Effect(
        name, body, law, (strength, *shapes, *phase), state=state, breakpoint=jump, per_case=moment,
        signature=f"{form.name} of {' and '.join(variables)}" if "time" not in form.name else form.name,
    )  # fmt: skip
    return LawForm(effect, form.name, variables, form.symbols + 1)


def _unit(text: str, shapes: Sequence[Parameter]) -> str:
    """Return the unit of the strength that makes the law a torque; a free exponent n adds a factor ``s^n``."""
    expression = parse(text)
    units = {n: parse_unit(u) for n, u in VARIABLES.items()} | {p.symbol: parse_unit(p.unit) for p in shapes}
    units["phi"] = parse_unit("rad")
    exponents = [p.symbol for p in shapes if p.unit == "1"]
    at = [dimension(expression, units, dict.fromkeys(exponents, n)) for n in (1.0, 2.0)]
    # the unit of the law contains s to the power a + b n
    b = at[1][2] - at[0][2]
    kg, m, s, *others = quotient(parse_unit("N m"), at[0])
    unit = format_unit((kg, m, s + b, *others))
    return unit if b == 0 else f"{unit} s^{'-' if b > 0 else ''}{exponents[0]}"


def _shape(symbol: str, kind: str, largest: float, span: float) -> Parameter:
    """Return a shape constant of a kind with its unit, bounds and trial values.

    `largest` is the largest speed [rad/s], `span` the length of the longest recording [s].
    """

    def made(
        unit: str, values: Sequence[float], lower: float, upper: float, *, relative: bool = False
    ) -> Parameter:
        grid = tuple(float(f"{v:.4g}") for v in values)
        meanings = {"1": "exponent", "s": "time", "s-1": "speed"}
        return Parameter(
            symbol, unit, "shape", lower, upper, grid[len(grid) // 2], grid, relative, meanings.get(unit, "")
        )

    if kind == "exponent":
        return made("1", _EXPONENTS, -3.0, 6.0)
    if kind == "positive exponent":
        return made("1", [e for e in _EXPONENTS if e > 0], 0.05, 6.0)
    if kind in {"speed", "wide speed"}:
        least = 0.15 if kind == "wide speed" else 0.0
        return made(
            "s-1", [v * largest for v in _SCALES if v >= least], max(least, 0.003) * largest, 30 * largest
        )
    if kind == "threshold":
        return made("s-1", [v * largest for v in _THRESHOLDS], 0.0, 1.2 * largest)
    if kind == "steepness":
        return made("1", (0.5, 1.5, 2.0, 3.0), 0.2, 8.0)
    if kind == "narrow":
        return made("s-1", [v * largest for v in (0.03, 0.08, 0.2, 0.5)], 0.005 * largest, 3 * largest)
    if kind in {"time", "time few"}:
        values = _TIMES if kind == "time" else (0.1, 0.3, 1.0)
        return made("s", [v * span for v in values], 0.005 * span, 20 * span)
    if kind in {"moment", "coarse moment"}:
        return made("s", MOMENTS if kind == "moment" else _COARSE_MOMENTS, 0.0, span, relative=True)
    if kind == "pulse":
        return made("s", [v * span for v in (0.02, 0.05, 0.12)], 0.003 * span, span)
    lowest = 2 * math.pi * _FEWEST_PERIODS / span
    highest = _HIGHEST / span if kind == "frequency" else 40 * lowest
    count = int(min(_MOST_FREQUENCIES, 1 + (highest - lowest) * span / _PHASE_STEP))
    return made("s-1", np.linspace(lowest, highest, count).tolist(), 0.5 * lowest, 2 * highest)
