"""Exact derivatives of expressions by the rules of calculus."""

from __future__ import annotations

from collections.abc import Callable

from fitting.expression.nodes import (
    ONE,
    ZERO,
    Expr,
    add,
    call,
    div,
    mul,
    neg,
    num,
    power,
    sub,
)

# sign and heaviside are flat where they are smooth; what happens at their jumps (a casing that comes to
# rest, a torque that sets in) is an event of the integration, not a derivative.
_OUTER: dict[str, Callable[[Expr], Expr]] = {
    "abs": lambda u: call("sign", u),
    "sign": lambda u: ZERO,  # noqa: ARG005
    "heaviside": lambda u: ZERO,  # noqa: ARG005
    "sqrt": lambda u: div(num(0.5), call("sqrt", u)),
    "exp": lambda u: call("exp", u),
    "log": lambda u: div(ONE, u),
    "sin": lambda u: call("cos", u),
    "cos": lambda u: neg(call("sin", u)),
    "tanh": lambda u: sub(ONE, power(call("tanh", u), num(2.0))),
}


def derivative(e: Expr, name: str) -> Expr:
    """Return the partial derivative of an expression with respect to a symbol.

    Parameters
    ----------
    e : Expr
        The expression.
    name : str
        The symbol.

    Returns
    -------
    Expr
        d e / d name; zero where the symbol does not occur.
    """
    if e.op == "num":
        return ZERO
    if e.op == "sym":
        return ONE if e.name == name else ZERO
    if e.op == "add":
        return add(derivative(e.args[0], name), derivative(e.args[1], name))
    if e.op == "mul":
        u, v = e.args
        return add(mul(derivative(u, name), v), mul(u, derivative(v, name)))
    if e.op == "pow":
        return _power_rule(e, name)
    inner = derivative(e.args[0], name)
    return ZERO if inner == ZERO else mul(_OUTER[e.op](e.args[0]), inner)


def _power_rule(e: Expr, name: str) -> Expr:
    u, v = e.args
    du, dv = derivative(u, name), derivative(v, name)
    result = ZERO
    if du != ZERO:
        result = mul(mul(v, power(u, sub(v, ONE))), du)
    if dv != ZERO:
        result = add(result, mul(mul(e, call("log", u)), dv))
    return result
