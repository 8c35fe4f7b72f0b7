"""Torque laws written by users: formulas on the command line and TOML files."""

from __future__ import annotations

import math
import re
import string
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fitting._errors import EffectError, ExpressionError, FittingError
from fitting.effects._effect import (
    MOMENTS,
    NONE,
    NOT_FOR_USERS,
    Dimension,
    Effect,
    Parameter,
    Role,
    State,
    at_site,
    dimension,
    format_unit,
    input_symbol,
    is_input_symbol,
    parse_unit,
    quotient,
    refuse_input_name,
    variables_of,
    with_input_symbols,
)
from fitting.effects._expression import (
    ZERO,
    Expr,
    Tape,
    derivative,
    nodes,
    parse,
    sub,
    substitute,
    sym,
    symbols,
)
from fitting.effects._instances import find_law
from fitting.effects._library import LIBRARY
from fitting.effects._mechanism import GYROSCOPE, Mechanism, renamed, speed_of

# unit of a strength that cannot be derived, because the units of other parameters were not given
UNKNOWN_UNIT = "SI"
_COARSE = 5
"""If a law has a changepoint and other shape constants, only every n-th trial changepoint is tried; this is n [1].
Chosen: a smaller value costs time; with a larger one, a fit starts far from the optimum."""
_GRID_FACTORS = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Trial values of a shape constant, divided by its initial value [1]. Chosen: two per decade; with fewer, a fit starts
far from the optimum; with more, the search takes longer."""
_EDITS = 2
"""A name counts as misspelt if it differs from a variable by at most this number of edits [1]. Chosen: a smaller value
overlooks misspelt names, a larger one suggests unrelated names."""


def formula(
    name: str,
    body: str,
    law: str,
    declared: Mapping[str, Mapping[str, Any]],
    *,
    signature: str = "",
    source: str = "",
    per_case: bool = False,
    rate: str = "",
    inputs: Mapping[str, str] | None = None,
    words: str = "",
    mechanism: Mechanism = GYROSCOPE,
) -> Effect:
    """Return an effect from a law.

    Names in the law that are neither variables nor inputs are parameters. `declared` contains the tables of parameters
    in a file of effects, by symbol. With a `rate`, the law has a state variable `lag` [1/s] with d(lag)/dt = rate, zero
    at the start. `inputs` contains the units of the recorded inputs that the law may contain, by name. An EffectError
    or ExpressionError is raised if the law is not understood, if it has no strength to fit, or if its units do not
    agree.
    """
    sites = (*mechanism.bodies, *mechanism.joints)
    if body not in sites:
        raise EffectError(f"{body[:30]!r} is an unknown body", f"write {_choice(sites)} before the law")
    variables = variables_of(mechanism)
    law, rate = (renamed(text, mechanism.short_names(body)) for text in (law, rate))
    known = dict(inputs or {})
    expression = with_input_symbols(parse(law), known)
    used = symbols(expression) | (symbols(with_input_symbols(parse(rate), known)) if rate else set())
    driving = tuple((name, unit) for name, unit in known.items() if input_symbol(name) in used)
    own = sorted(s for s in used - set(variables) if not is_input_symbol(s))
    hidden = NOT_FOR_USERS | {c.tau for c in mechanism.couplings}
    for forbidden in sorted((used & hidden) - ({"lag"} if rate else set())):
        raise EffectError(
            f"{forbidden!r} is not available in a law without a state variable", _hint(mechanism)
        )
    if not own:
        main = mechanism.main
        raise EffectError(
            f"the law {law!r} has no parameter to fit", f"write, for example: {main}: -k*{speed_of(main)}**3"
        )
    _refuse_misspelt(expression, [s for s in own if s not in declared], body, known, mechanism)
    _refuse_product(expression, [s for s in own if s not in declared], known)
    for symbol in sorted(set(declared) - set(own)):
        raise EffectError(f"the parameter {symbol!r} does not occur in the law {law!r}", _hint(mechanism))
    amplitude = _strength(law, expression, [s for s in own if not declared.get(s, {}).get("shape", False)])
    roles: dict[str, Role] = {s: "phase" if _is_phase(expression, s) else "shape" for s in own}
    roles[amplitude] = "amplitude"
    parameters = tuple(_parameter(s, declared.get(s, {}), roles[s]) for s in own)
    given = {symbol for symbol, keys in declared.items() if {"grid", "start"} & set(keys)}
    timed, jump = _timed(parameters, expression)
    parameters = tuple(p if p.symbol in given else t for p, t in zip(parameters, timed, strict=True))
    unit = declared.get(amplitude, {}).get("unit") or _amplitude_unit(
        expression, amplitude, parameters, dict(driving), variables
    )
    parameters = tuple(replace(p, unit=unit) if p.symbol == amplitude else p for p in parameters)
    effect = at_site(
        name,
        body,
        law,
        parameters,
        mechanism,
        signature=signature,
        source=source,
        breakpoint=jump,
        per_case=per_case,
        state=State("lag", rate) if rate else None,
        inputs=driving,
        words=words,
    )
    _check(effect)
    return effect


def _choice(sites: Sequence[str]) -> str:
    return ", ".join(f"{s}:" for s in sites[:-1]) + f" or {sites[-1]}:"


def _refuse_misspelt(
    expression: Expr,
    undeclared: Sequence[str],
    body: str,
    inputs: Mapping[str, str],
    mechanism: Mechanism,
) -> None:
    """Refuse parameters that are not declared and are probably misspelt variables.

    A name within two edits of a variable or an input counts as misspelt. In a law without variables, several undeclared
    names are refused as well.
    """
    hidden = NOT_FOR_USERS | {c.tau for c in mechanism.couplings}
    variables = [v for v in (*variables_of(mechanism), *inputs) if v not in hidden or v in inputs]
    first = mechanism.joints[body].delta if body in mechanism.joints else speed_of(body)
    for symbol in undeclared:
        # a short name is within two edits of most names
        near = [v for v in variables if len(v) > _EDITS + 2]
        distance, _, variable = min((edit_distance(symbol, v), not first.endswith(v[-1]), v) for v in near)
        if distance <= _EDITS:
            raise EffectError(
                f"unknown name {symbol!r} in the law; did you mean {variable}?",
                f"if it is a parameter, declare {symbol} in a file of effects (--effects) or rename it",
            )
    used = symbols(expression)
    if len(undeclared) > 1 and not used & set(variables) and not any(map(is_input_symbol, used)):
        raise EffectError(
            f"the law contains no variable of the {body}, only the names {', '.join(undeclared)}; "
            f"did you mean {first}? {_recorded(inputs)}",
            "if all are parameters, declare them in a file of effects (--effects)",
        )


def _refuse_product(expression: Expr, undeclared: Sequence[str], inputs: Mapping[str, str]) -> None:
    """Refuse two parameters that occur only as a product: they are degenerate, and one may be meant as an input."""
    for i, first in enumerate(undeclared):
        slope = derivative(expression, first)
        if first in symbols(slope) or substitute(expression, {first: ZERO}) != ZERO:
            continue
        for second in undeclared[i + 1 :]:
            if second not in symbols(derivative(slope, second)) and substitute(slope, {second: ZERO}) == ZERO:
                raise EffectError(
                    f"the parameters {first} and {second} occur as a product only, and the data determine only this "
                    f"product. {_recorded(inputs)}",
                    "write one parameter, or record the input with `gyrotrack import --input`",
                )


def _recorded(inputs: Mapping[str, str]) -> str:
    """Return a sentence with the inputs that a law may contain."""
    return f"Recorded inputs: {', '.join(inputs)}." if inputs else "The recording has no input."


def edit_distance(a: str, b: str) -> int:
    """Return the smallest number of insertions, deletions and substitutions that change one word into another."""
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, 1):
        row, above = [i], row
        for j, y in enumerate(b, 1):
            row.append(min(above[j] + 1, row[j - 1] + 1, above[j - 1] + (x != y)))
    return row[-1]


def _check(effect: Effect) -> None:
    shapes = [p.symbol for p in effect.parameters if p.role == "shape"]
    if effect.depends_on_angle and shapes:
        raise EffectError(
            f"{shapes[0]!r} is a shape constant, but a law of an angle can have only a strength and a phase",
            f"write a number for {shapes[0]}",
        )
    if all(p.unit != UNKNOWN_UNIT for p in effect.parameters):
        try:
            effect.check()
        except ExpressionError as fault:
            raise EffectError(
                f"the units of the law {effect.law!r} do not agree: {fault.message}",
                "give the unit of every parameter, or of none",
            ) from None


def _timed(parameters: Sequence[Parameter], expression: Expr) -> tuple[tuple[Parameter, ...], str]:
    """Return the parameters, and the symbol of the changepoint at which the law jumps ("" if there is none).

    A parameter t0 in a difference t - t0 is a time; its trial values cover the whole record. It is a changepoint, at
    which the law jumps, if t0 occurs in heaviside(t - t0) and in no other heaviside.
    """
    parts = nodes(expression)
    alone = [p.role for p in parameters].count("shape") == 1
    jump, found = "", []
    for p in parameters:
        since = sub(sym("t"), sym(p.symbol))
        own = [n for n in parts if n.op == "heaviside" and p.symbol in symbols(n)]
        jumps = bool(own) and all(n.args[0] == since for n in own)
        jump = jump or (p.symbol if jumps else "")
        if p.role == "shape" and since in parts:
            p = replace(p, grid=MOMENTS if jumps or alone else MOMENTS[::_COARSE], relative=True)
        found.append(p)
    return tuple(found), jump


def _parameter(symbol: str, keys: Mapping[str, Any], role: Role) -> Parameter:
    def number(what: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise EffectError(f"parameter {symbol}: {what} must be a number")
        return float(value)

    lower, upper = number("lower", keys.get("lower", -math.inf)), number("upper", keys.get("upper", math.inf))
    if not lower < upper:
        raise EffectError(f"parameter {symbol}: lower {lower:g} must be less than upper {upper:g}")
    usual = min(max(1.0 if role == "shape" else 0.0, lower), upper)
    start = number("start", keys.get("start", usual))
    if not lower <= start <= upper:
        raise EffectError(f"parameter {symbol}: start {start:g} is outside {lower:g} to {upper:g}")
    given = tuple(number("grid", v) for v in keys.get("grid", ()))
    grid = given or (tuple(start * factor for factor in _GRID_FACTORS) if role == "shape" else ())
    grid = tuple(v for v in grid if lower <= v <= upper)
    return Parameter(
        symbol, keys.get("unit", "1"), role, lower, upper, start, grid, meaning=keys.get("meaning", "")
    )


def _strength(law: str, expression: Expr, candidates: list[str]) -> str:
    """Return the first of the candidates to which the law is proportional."""
    if not candidates:
        raise EffectError(
            f"every parameter of the law {law!r} is declared as a shape constant",
            "declare its strength without shape",
        )
    linear = [c for c in candidates if c not in symbols(derivative(expression, c))]
    if not linear:
        raise EffectError(
            f"the law {law!r} is linear in none of {', '.join(candidates)}", "multiply it by a strength k"
        )
    for symbol in linear:
        if substitute(expression, {symbol: ZERO}) == ZERO:
            return symbol
    raise EffectError(
        f"the law {law!r} is not proportional to any of {', '.join(linear)}",
        "write a sum of laws as several effects, or multiply it by one strength",
    )


def _is_phase(expression: Expr, symbol: str) -> bool:
    """Return whether a parameter is a phase.

    The second derivative of the law with respect to a phase is minus the law.
    """
    slope = derivative(derivative(expression, symbol), symbol)
    tape = Tape([expression, slope])
    values = {name: 0.4 + 0.17 * i + np.linspace(0.0, 1.0, 5) for i, name in enumerate(sorted(tape.names))}
    if symbol not in values:
        return False
    with np.errstate(all="ignore"):
        law, curvature = (np.asarray(v) for v in tape(values))
    size = np.abs(law).max()
    return bool(size > 0 and np.abs(law + curvature).max() < 1e-9 * size)


def _amplitude_unit(
    expression: Expr,
    amplitude: str,
    parameters: tuple[Parameter, ...],
    inputs: Mapping[str, str],
    variables: Mapping[str, str],
) -> str:
    """Return the unit of the strength that makes the law a torque; ``N m s^p`` if an exponent p is fitted."""
    torque = parse_unit("N m")
    exponents = {p.symbol: p.start for p in parameters if p.unit == "1"}

    def needed(shift: str = "") -> Dimension:
        values = exponents | ({shift: exponents[shift] + 1.0} if shift else {})
        units: dict[str, Dimension] = {name: parse_unit(unit) for name, unit in variables.items()}
        units |= {input_symbol(name): parse_unit(unit) for name, unit in inputs.items()}
        units |= {p.symbol: NONE if p.symbol == amplitude else parse_unit(p.unit, values) for p in parameters}
        return quotient(torque, dimension(expression, units, values))

    try:
        unit = needed()
        for symbol in exponents:
            seconds = needed(symbol)[2] - unit[2]
            if seconds != 0:
                at_zero = unit[2] - seconds * exponents[symbol]
                plain = len(symbol) == 1 and abs(seconds) == 1 and at_zero == torque[2]
                return f"N m s^{'-' if seconds < 0 else ''}{symbol}" if plain else UNKNOWN_UNIT
    except ExpressionError:
        return UNKNOWN_UNIT
    return format_unit(unit)


def _hint(mechanism: Mechanism) -> str:
    deltas = [c.delta for c in mechanism.couplings]
    known = variables_of(mechanism)
    variables = (v for v in ("t", *mechanism.speeds, *mechanism.angles, *deltas, "deflection") if v in known)
    return f"a law may contain {', '.join(variables)} and recorded inputs"


def drive(site: str, name: str, unit: str, mechanism: Mechanism = GYROSCOPE) -> Effect:
    """Return the torque on a body or joint proportional to a recorded input, for example ``casing.input.current``.

    `unit` is the unit of the input.
    """
    between = "the bodies" if mechanism == GYROSCOPE else f"the bodies of {site}"
    where = f"between {between}" if site in mechanism.joints else f"on the {site}"
    return at_site(
        f"{site}.input.{name}",
        site,
        f"k*{name}",
        (
            Parameter(
                "k",
                format_unit(quotient(parse_unit("N m"), parse_unit(unit))),
                lower=-math.inf,
                meaning=f"torque per unit of {name}",
            ),
        ),
        mechanism,
        words=f"torque {where} proportional to {name}",
        signature=f"the torque follows the recorded input {name}",
        inputs=((name, unit),),
    )


def dead_time(name: str, unit: str, mechanism: Mechanism = GYROSCOPE) -> Effect:
    """Return the dead time after which a recorded input acts, for example ``input.current.delay``."""
    return Effect(
        f"input.{name}.delay",
        "input",
        "T",
        (Parameter("T", "s", lower=0.0, meaning=f"time after which {name} acts"),),
        kind="measurement",
        words=f"dead time of the input {name}",
        signature=f"every change of the motion follows the recorded input {name} with the same delay",
        inputs=((name, unit),),
        mechanism=mechanism,
    )


def drives(inputs: Mapping[str, str] | Sequence[Any], mechanism: Mechanism = GYROSCOPE) -> tuple[Effect, ...]:
    """Return the effects of recorded inputs: a proportional torque on each body and joint, and a dead time."""
    units, sites = units_of_inputs(inputs).items(), (*mechanism.bodies, *mechanism.joints)
    return (
        *(drive(s, n, u, mechanism) for n, u in units for s in sites),
        *(dead_time(n, u, mechanism) for n, u in units),
    )


# effects of recorded inputs
_OF_INPUT = re.compile(r"(?P<joint>[A-Za-z]\w*)\.input\.(?P<driven>\w+)|input\.(?P<delayed>\w+)\.delay")
_NAME = re.compile(r"^[A-Za-z][A-Za-z0-9_.]{0,60}$")
_KINDS = {"text": str, "a list": list, "true or false": bool, "a table": dict}
# keys of a table and the kinds of their values; a kind "" is a number, which is checked together with its bounds
_PARAMETER_KEYS = dict.fromkeys(("lower", "upper", "start"), "") | {
    "unit": "text", "meaning": "text", "grid": "a list", "shape": "true or false"
}  # fmt: skip
_EFFECT_KEYS = dict.fromkeys(("name", "body", "law", "rate", "signature", "source", "words"), "text") | {
    "parameters": "a table", "inputs": "a table", "per_case": "true or false"
}  # fmt: skip


def resolve(
    text: str,
    inputs: Mapping[str, str] | Sequence[Any] | None = None,
    mechanism: Mechanism = GYROSCOPE,
) -> Effect:
    """Return an effect from its name in the library or from a formula ``body: law``.

    Parameters
    ----------
    text : str
        For example ``casing.air.quadratic``, ``casing: -k*omega_c**3`` or, with an input, ``casing: k*current`` and
        ``casing.input.current``. Names in the law that are not variables are parameters. If the law is linear in a
        parameter, a regression gives its initial value.
    inputs : mapping of str to str, or sequence of Input, optional
        The recorded inputs that the law may contain: their units by name, or ``record.inputs``.
    mechanism : Mechanism
        The bodies and joints of the law.

    Raises
    ------
    EffectError, ExpressionError
        If the text is not an effect; the message names the part that is not understood.
    """
    if not isinstance(text, str):
        raise EffectError(
            f"a {type(text).__name__} is not an effect", "write, for example, casing: -k*omega_c**3"
        )
    known = units_of_inputs(inputs)
    body, colon, law = text.partition(":")
    if colon:
        return formula(text.strip(), body.strip(), law.strip(), {}, inputs=known, mechanism=mechanism)
    found = _OF_INPUT.fullmatch(text.strip())
    sites = (*mechanism.bodies, *mechanism.joints)
    if found is None or found["joint"] not in (*sites, None):
        return find_law(text.strip(), mechanism)
    name = found["driven"] or found["delayed"]
    if name not in known:
        raise EffectError(
            f"{text.strip()[:60]} needs the input {name[:40]}. {_recorded(known)}",
            "record it with `gyrotrack import --input`",
        )
    if found["joint"]:
        return drive(found["joint"], name, known[name], mechanism)
    return dead_time(name, known[name], mechanism)


def units_of_inputs(inputs: Mapping[str, str] | Sequence[Any] | None) -> dict[str, str]:
    """Return the units of recorded inputs by name, from a mapping of units or from the inputs."""
    if inputs is None or isinstance(inputs, Mapping):
        for name in inputs or {}:
            refuse_input_name(name)
        return dict(inputs or {})
    try:
        return {str(i.name): str(i.unit) for i in inputs}
    except (TypeError, AttributeError):
        raise EffectError(
            f"{type(inputs).__name__} holds no inputs",
            "give record.inputs, or units by name: {'current': 'A'}",
        ) from None


def read_effects(path: Path, mechanism: Mechanism = GYROSCOPE) -> list[Effect]:
    """Read effects from a TOML file with one ``[[effect]]`` table for each effect.

    A table has the keys ``name``, ``body`` and ``law``. Optional keys are ``words`` (the name in words), ``rate`` (of
    the state variable ``lag``), ``signature``, ``source``, ``per_case``, and ``inputs`` with the units of the recorded
    inputs in the law (``{current = "A"}``). A table ``[effect.parameters.k]`` may have the keys ``unit``, ``lower``,
    ``upper``, ``start``, ``grid``, ``meaning``, and ``shape = true`` for a parameter that is not the strength of the
    law.

    Parameters
    ----------
    path : Path
        The TOML file.
    mechanism : Mechanism
        The bodies and joints of the laws.

    Raises
    ------
    EffectError
        If the file cannot be read or a key is unknown or missing; the message names the key.
    """
    tables = read_toml(path).get("effect")
    if not isinstance(tables, list) or not tables:
        raise EffectError(f"{path} has no [[effect]] table", "see `gyrotrack effects --help`")
    effects = [_from_table(path, i, table, mechanism) for i, table in enumerate(tables, 1)]
    names = [e.name for e in effects]
    for name in names:
        if names.count(name) > 1 or name in LIBRARY:
            raise EffectError(f"{path}: there is another effect named {name!r}", "give it another name")
    return effects


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file; an EffectError is raised if the file cannot be read or is not TOML."""
    try:
        with Path(path).open("rb") as file:
            return tomllib.load(file)
    except OSError as fault:
        raise EffectError(f"{path}: {fault.strerror or fault}") from None
    except (ValueError, RecursionError) as fault:  # a number of thousands of digits also raises a ValueError
        raise EffectError(f"{path} is not a TOML file: {fault}") from None


def _from_table(path: Path, number: int, table: Any, mechanism: Mechanism) -> Effect:
    where = f"{path}, effect {number}"
    if not isinstance(table, dict):
        raise EffectError(f"{where} is not a table")
    _check_table(where, table, _EFFECT_KEYS, ("body", "law", "name"))
    if not _NAME.match(table["name"]):
        raise EffectError(
            f"{where}: a name has letters, digits, dots and underscores, and starts with a letter"
        )
    declared = table.get("parameters", {})
    for symbol, keys in declared.items():
        _check_table(f"{where}, parameter {symbol}", keys, _PARAMETER_KEYS)
        # units with a slash are accepted: rad/s2 is rad s-2
        unit = re.sub(r"\s*/\s*([A-Za-z]+)(\d*)", lambda m: f" {m[1]}-{m[2] or 1}", keys.get("unit", "1"))
        try:
            parse_unit(unit, dict.fromkeys(string.ascii_lowercase, 1.0))
        except ExpressionError as fault:
            raise EffectError(f"{where}, parameter {symbol}: {fault.message}", fault.hint) from None
        declared[symbol] = keys | ({"unit": unit} if "unit" in keys else {})
    more = {k: table[k] for k in ("rate", "signature", "source", "per_case", "words") if k in table}
    try:
        for name, unit in table.get("inputs", {}).items():
            refuse_input_name(name)
            parse_unit(str(unit))
    except FittingError as fault:
        raise EffectError(f"{where}, inputs: {fault.message}", fault.hint) from None
    more["inputs"] = {name: str(unit) for name, unit in table.get("inputs", {}).items()}
    try:
        return formula(table["name"], table["body"], table["law"], declared, mechanism=mechanism, **more)
    except FittingError as fault:
        raise EffectError(f"{where}: {fault.message}", fault.hint) from None


def _check_table(where: str, table: Any, keys: Mapping[str, str], needed: Sequence[str] = ()) -> None:
    if not isinstance(table, dict):
        raise EffectError(f"{where} must be a table", "write [effect.parameters.k]")
    wrong = [f"unknown key {key!r}" for key in sorted(set(table) - set(keys))]
    wrong += [f"missing key {key!r}" for key in needed if key not in table]
    if wrong:
        raise EffectError(f"{where}: {wrong[0]}", "keys: " + ", ".join(sorted(keys)))
    for key, value in table.items():
        if keys[key] and not isinstance(value, _KINDS[keys[key]]):
            hint = "write [effect.parameters.k]" if keys[key] == "a table" else ""
            raise EffectError(f"{where}: {key} must be {keys[key]}", hint)


effect = resolve  # the public name
