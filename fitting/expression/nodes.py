"""Expression trees as immutable tuples, with the few simplifications that keep derivatives short."""

from __future__ import annotations

from typing import NamedTuple

FUNCTIONS = ("abs", "sign", "sqrt", "exp", "log", "sin", "cos", "tanh", "heaviside")


class Expr(NamedTuple):
    """One node: an operation on smaller expressions, a number, or a symbol.

    ``op`` is one of ``num``, ``sym``, ``add``, ``mul``, ``pow`` or the name of a function;
    ``value`` holds the number of a ``num``, ``name`` the name of a ``sym``.
    """

    op: str
    args: tuple[Expr, ...] = ()
    value: float = 0.0
    name: str = ""


def num(value: float) -> Expr:
    """Return a constant."""
    return Expr("num", (), float(value))


def sym(name: str) -> Expr:
    """Return a symbol."""
    return Expr("sym", (), 0.0, name)


ZERO, ONE, MINUS_ONE = num(0.0), num(1.0), num(-1.0)


def add(a: Expr, b: Expr) -> Expr:
    """Return a + b, with zeros left out and numbers folded."""
    if a == ZERO:
        return b
    if b == ZERO:
        return a
    if a.op == b.op == "num":
        return num(a.value + b.value)
    return Expr("add", (a, b))


def mul(a: Expr, b: Expr) -> Expr:
    """Return a * b, with zeros and ones left out, numbers folded, and signs drawn to the front."""
    if ZERO in (a, b):
        return ZERO
    if a == ONE:
        return b
    if b == ONE:
        return a
    if a.op == b.op == "num":
        return num(a.value * b.value)
    if a == MINUS_ONE and _is_negated(b):
        return b.args[1]
    if a != MINUS_ONE and (_is_negated(a) or _is_negated(b)):
        bare_a, bare_b = (e.args[1] if _is_negated(e) else e for e in (a, b))
        product = mul(bare_a, bare_b)
        return product if _is_negated(a) and _is_negated(b) else neg(product)
    return Expr("mul", (a, b))


def _is_negated(e: Expr) -> bool:
    return e.op == "mul" and e.args[0] == MINUS_ONE


def neg(a: Expr) -> Expr:
    """Return -a."""
    return mul(MINUS_ONE, a)


def sub(a: Expr, b: Expr) -> Expr:
    """Return a - b."""
    return add(a, neg(b))


def power(a: Expr, b: Expr) -> Expr:
    """Return a ** b, with trivial exponents left out."""
    if b == ZERO:
        return ONE
    if b == ONE:
        return a
    return Expr("pow", (a, b))


def div(a: Expr, b: Expr) -> Expr:
    """Return a / b."""
    return mul(a, power(b, MINUS_ONE))


def call(function: str, a: Expr) -> Expr:
    """Return a function of `FUNCTIONS` applied to an expression."""
    return Expr(function, (a,))


def total(terms: list[Expr]) -> Expr:
    """Return the sum of some expressions (zero when there are none)."""
    result = ZERO
    for term in terms:
        result = add(result, term)
    return result


def substitute(e: Expr, values: dict[str, Expr]) -> Expr:
    """Return the expression with symbols replaced."""
    if e.op == "sym":
        return values.get(e.name, e)
    if e.op == "num":
        return e
    args = tuple(substitute(a, values) for a in e.args)
    build = {"add": add, "mul": mul, "pow": power}.get(e.op)
    return build(args[0], args[1]) if build else call(e.op, args[0])


def symbols(e: Expr) -> set[str]:
    """Return the names of all symbols in an expression."""
    if e.op == "sym":
        return {e.name}
    names: set[str] = set()
    for a in e.args:
        names |= symbols(a)
    return names
