"""Units of expressions: every torque law has the unit newton metre.

A dimension is a vector of exponents of (kg, m, s, K); radians and pixels count as 1. Exponents that are
parameters (the g of a power law) take the value that is given for them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from fitting._errors import ExpressionError
from fitting.effects._expression import Expr

Dimension = tuple[float, float, float, float]

NONE: Dimension = (0.0, 0.0, 0.0, 0.0)
_BASE: dict[str, Dimension] = {
    "1": NONE,
    "rad": NONE,
    "px": NONE,
    "kg": (1, 0, 0, 0),
    "m": (0, 1, 0, 0),
    "s": (0, 0, 1, 0),
    "K": (0, 0, 0, 1),
    "N": (1, 1, -2, 0),
    "J": (1, 2, -2, 0),
}
_TOKEN = re.compile(r"^([A-Za-z]+|1)(?:\^?(-?[0-9.]+|-?[a-z]))?$")
_TOLERANCE = 1e-9


def parse_unit(unit: str, exponents: Mapping[str, float] | None = None) -> Dimension:
    """Return the dimension of a unit such as ``N m s2``, ``K-1`` or ``N m s^g``.

    Raises
    ------
    ExpressionError
        If a part of the unit is not one of kg, m, s, K, N, J, rad, px, 1 with an exponent.
    """
    result = NONE
    for token in unit.split():
        match = _TOKEN.match(token)
        if match is None or match[1] not in _BASE:
            raise ExpressionError(f"{token!r} in {unit!r} is not a unit", "write for example: N m s2")
        exponent = match[2] or "1"
        value = (exponents or {}).get(exponent.removeprefix("-"))
        sign = -1.0 if exponent.startswith("-") else 1.0
        try:
            result = _times(
                result, _to_power(_BASE[match[1]], float(exponent) if value is None else sign * value)
            )
        except ValueError:
            raise ExpressionError(f"the exponent of {token!r} in {unit!r} is not a number") from None
    return result


def format_unit(dimension: Dimension) -> str:
    """Return a dimension as a unit with N m taken out where that is shorter, such as ``N m s2``."""
    kg, m, s, kelvin = dimension
    parts = []
    if abs(kg - 1) < _TOLERANCE and abs(m - 2) < _TOLERANCE:
        parts, kg, m, s = ["N", "m"], 0.0, 0.0, s + 2
    for name, exponent in (("kg", kg), ("m", m), ("s", s), ("K", kelvin)):
        if abs(exponent) > _TOLERANCE:
            parts.append(name if abs(exponent - 1) < _TOLERANCE else f"{name}{exponent:g}")
    return " ".join(parts) or "1"


def dimension(e: Expr, units: Mapping[str, Dimension], exponents: Mapping[str, float]) -> Dimension:
    """Return the dimension of an expression.

    Parameters
    ----------
    e : Expr
        The expression.
    units : mapping of str to Dimension
        The dimension of each symbol.
    exponents : mapping of str to float
        Values of symbols that stand in exponents.

    Raises
    ------
    ExpressionError
        If unlike quantities are added, or a function is taken of a quantity that has a unit.
    """
    if e.op == "num":
        return NONE
    if e.op == "sym":
        return units[e.name]
    parts = [dimension(a, units, exponents) for a in e.args]
    if e.op == "add":
        if not _same(parts[0], parts[1]):
            raise ExpressionError(
                f"quantities of unlike units are added: {format_unit(parts[0])} and {format_unit(parts[1])}"
            )
        return parts[0]
    if e.op == "mul":
        return _times(parts[0], parts[1])
    if e.op == "pow":
        return _to_power(parts[0], _exponent(e.args[1], exponents))
    if e.op == "abs":
        return parts[0]
    if e.op == "sqrt":
        return _to_power(parts[0], 0.5)
    if e.op not in {"sign", "heaviside"} and not _same(parts[0], NONE):
        raise ExpressionError(f"{e.op} is taken of a quantity with the unit {format_unit(parts[0])}")
    return NONE


def _exponent(e: Expr, exponents: Mapping[str, float]) -> float:
    if e.op == "num":
        return e.value
    if e.op == "sym" and e.name in exponents:
        return exponents[e.name]
    if e.op in {"add", "mul"}:
        a, b = (_exponent(x, exponents) for x in e.args)
        return a + b if e.op == "add" else a * b
    raise ExpressionError("an exponent must be a number or a parameter without a unit")


def _same(a: Dimension, b: Dimension) -> bool:
    return all(abs(x - y) < _TOLERANCE for x, y in zip(a, b, strict=True))


def _times(a: Dimension, b: Dimension) -> Dimension:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3])


def _to_power(a: Dimension, n: float) -> Dimension:
    return (a[0] * n, a[1] * n, a[2] * n, a[3] * n)
