"""Effects that users write: a formula on the command line, or several in a TOML file."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path
from typing import Any, cast

from fitting.effects.effect import VARIABLES, Effect, Joint, Parameter
from fitting.effects.library import find
from fitting.errors import EffectError, ExpressionError
from fitting.expression import parse, symbols
from fitting.expression.derivative import derivative
from fitting.expression.dimension import NONE, Dimension, dimension, format_unit, parse_unit

_BODIES = ("rotor", "casing", "bearing")
_NAME = re.compile(r"^[A-Za-z][A-Za-z0-9_.]{0,60}$")
_PARAMETER_KEYS = {"unit", "lower", "upper", "start", "grid", "meaning", "shape"}
_EFFECT_KEYS = {"name", "body", "law", "parameters", "signature", "source"}


def resolve(text: str) -> Effect:
    """Return an effect from its name in the library or from a formula ``body: law``.

    Parameters
    ----------
    text : str
        Such as ``casing.air.quadratic`` or ``casing: -k*omega_c**3``. Names in the law that are no
        variables are parameters; those in which the law is linear start from a regression.

    Raises
    ------
    EffectError, ExpressionError
        With what is not understood.
    """
    body, colon, law = text.partition(":")
    if not colon:
        return find(text.strip())
    return formula(text.strip(), body.strip(), law.strip(), {})


def formula(name: str, body: str, law: str, declared: dict[str, dict[str, Any]], **words: str) -> Effect:
    """Return an effect from a law; parameters that are not declared are found in the law."""
    if body not in _BODIES:
        raise EffectError(f"{body[:30]!r} is no body", "write rotor:, casing: or bearing: before the law")
    expression = parse(law)
    own = sorted(symbols(expression) - set(VARIABLES))
    for forbidden in symbols(expression) & {"temperature", "chirp", "tau", "psi", "omega"}:
        raise EffectError(f"{forbidden!r} is not known to a law that has no state of its own", _hint())
    if not own:
        raise EffectError(
            f"the law {law!r} has no parameter to fit", "write for example: casing: -k*omega_c**3"
        )
    linear = [s for s in own if _is_linear(law, s)]
    if not linear:
        raise EffectError(
            f"the law {law!r} is linear in none of {', '.join(own)}", "put a strength k in front of it"
        )
    amplitude = linear[0]
    parameters = tuple(_parameter(s, declared.get(s, {}), s == amplitude) for s in own)
    unit = declared.get(amplitude, {}).get("unit") or _amplitude_unit(law, amplitude, parameters)
    parameters = tuple(
        Parameter(p.symbol, unit, p.role, p.lower, p.upper, p.start, p.grid, p.relative, p.meaning)
        if p.symbol == amplitude
        else p
        for p in parameters
    )
    return Effect(name, cast("Joint", body), law, parameters, **words)


def read_effects(path: Path) -> list[Effect]:
    """Read effects from a TOML file with one ``[[effect]]`` table an effect.

    Each has ``name``, ``body``, ``law`` and, if wished, ``signature``, ``source`` and
    ``[effect.parameters.k]`` tables with ``unit``, ``lower``, ``upper``, ``start``, ``grid``, ``meaning``.

    Raises
    ------
    EffectError
        If the file cannot be read or a key is unknown or missing; the key is named.
    """
    try:
        with path.open("rb") as file:
            document = tomllib.load(file)
    except OSError as fault:
        raise EffectError(f"{path}: {fault.strerror or fault}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise EffectError(f"{path} is not a TOML file: {fault}") from None
    tables = document.get("effect")
    if not isinstance(tables, list) or not tables:
        raise EffectError(f"{path} has no [[effect]] table", "see `gyrotrack effects --help`")
    return [_from_table(path, i, table) for i, table in enumerate(tables, 1)]


def _from_table(path: Path, number: int, table: Any) -> Effect:
    where = f"{path}, effect {number}"
    if not isinstance(table, dict):
        raise EffectError(f"{where} is not a table")
    unknown = set(table) - _EFFECT_KEYS
    missing = {"name", "body", "law"} - set(table)
    if unknown or missing:
        wrong = f"unknown key {sorted(unknown)[0]!r}" if unknown else f"missing key {sorted(missing)[0]!r}"
        raise EffectError(f"{where}: {wrong}", "keys: " + ", ".join(sorted(_EFFECT_KEYS)))
    for key in ("name", "body", "law", "signature", "source"):
        if not isinstance(table.get(key, ""), str):
            raise EffectError(f"{where}: {key} must be text")
    if not _NAME.match(table["name"]):
        raise EffectError(
            f"{where}: a name has letters, digits, dots and underscores, and starts with a letter"
        )
    declared = table.get("parameters", {})
    for symbol, keys in declared.items() if isinstance(declared, dict) else ():
        extra = set(keys) - _PARAMETER_KEYS if isinstance(keys, dict) else {"?"}
        if extra:
            raise EffectError(f"{where}, parameter {symbol}: unknown key {sorted(extra)[0]!r}")
    words = {k: table[k] for k in ("signature", "source") if k in table}
    return formula(table["name"], table["body"], table["law"], declared, **words)


def _parameter(symbol: str, keys: dict[str, Any], is_amplitude: bool) -> Parameter:  # noqa: FBT001
    def number(key: str, default: float) -> float:
        value = keys.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise EffectError(f"parameter {symbol}: {key} must be a number")
        return float(value)

    role = "amplitude" if is_amplitude else "shape"
    start = number("start", 0.0 if is_amplitude else 1.0)
    grid = tuple(float(v) for v in keys.get("grid", ())) or (() if is_amplitude else _default_grid(start))
    lower, upper = number("lower", -math.inf), number("upper", math.inf)
    return Parameter(
        symbol,
        keys.get("unit", "1"),
        cast("Any", role),
        lower,
        upper,
        start,
        grid,
        meaning=keys.get("meaning", ""),
    )


def _default_grid(start: float) -> tuple[float, ...]:
    return tuple(start * factor for factor in (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0))


def _is_linear(law: str, symbol: str) -> bool:
    slope = derivative(parse(law), symbol)
    return symbol not in symbols(slope)


def _amplitude_unit(law: str, amplitude: str, parameters: tuple[Parameter, ...]) -> str:
    units: dict[str, Dimension] = {name: parse_unit(unit) for name, unit in VARIABLES.items()}
    try:
        units |= {p.symbol: NONE if p.symbol == amplitude else parse_unit(p.unit) for p in parameters}
        rest = dimension(parse(law), units, {p.symbol: p.start for p in parameters})
    except ExpressionError:
        return "SI"
    torque = parse_unit("N m")
    return format_unit((torque[0] - rest[0], torque[1] - rest[1], torque[2] - rest[2], torque[3] - rest[3]))


def _hint() -> str:
    return "a law may speak of t, omega_r, omega_c, psi_r, psi_c and delta"
