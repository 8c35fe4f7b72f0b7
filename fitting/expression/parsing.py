"""Formulas typed by people, turned into trees without ever running them.

The text is parsed by Python's own grammar (`ast`), and every node is held against a short allow-list:
numbers, known names, ``+ - * / **``, unary minus, and the functions of `nodes.FUNCTIONS`. ASCII only, at most
500 characters, nested at most 40 deep, numbers as floats (so that ``9**9**9`` costs nothing).
"""

from __future__ import annotations

import ast
import math
import warnings
from collections.abc import Callable

from fitting.errors import ExpressionError
from fitting.expression import nodes
from fitting.expression.nodes import Expr

MAX_LENGTH = 500
MAX_DEPTH = 40
_BINARY: dict[type[ast.operator], Callable[[Expr, Expr], Expr]] = {
    ast.Add: nodes.add,
    ast.Sub: nodes.sub,
    ast.Mult: nodes.mul,
    ast.Div: nodes.div,
    ast.Pow: nodes.power,
}
_WORDS = {
    ast.Call: "a call of anything but one of the functions",
    ast.Attribute: "a dot after a name",
    ast.Subscript: "an index in brackets",
    ast.Lambda: "lambda",
    ast.Compare: "a comparison",
    ast.IfExp: "if ... else",
    ast.BoolOp: "'and' and 'or'",
}
_ALLOWED = "numbers, the names listed, + - * / ** and " + ", ".join(nodes.FUNCTIONS)


def parse(text: str) -> Expr:
    """Parse a formula such as ``-k*omega_c*abs(omega_c)``.

    Parameters
    ----------
    text : str
        The formula. Every name but ``pi`` that is not a function becomes a symbol.

    Returns
    -------
    Expr
        The tree.

    Raises
    ------
    ExpressionError
        If the text is not a formula of the allowed kind; the sentence says what is in the way.
    """
    if len(text) > MAX_LENGTH:
        raise ExpressionError(f"the formula has {len(text)} characters; {MAX_LENGTH} are allowed")
    if not text.isascii() or not text.strip():
        raise ExpressionError(f"the formula {text[:60]!r} is empty or has other than ASCII characters")
    if text.count("(") > MAX_DEPTH or text.count("**") > MAX_DEPTH:
        raise ExpressionError("the formula is nested too deeply", f"at most {MAX_DEPTH} levels are allowed")
    try:
        with warnings.catch_warnings():
            # Python's own advice about odd literals is not for the person who typed a formula
            warnings.simplefilter("ignore")
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ExpressionError(f"{text[:60]!r} is not a formula", f"a formula has {_ALLOWED}") from None
    return _convert(tree, 0)


def _convert(node: ast.expr, depth: int) -> Expr:
    if depth > 4 * MAX_DEPTH:
        raise ExpressionError("the formula is nested too deeply", f"at most {MAX_DEPTH} levels are allowed")
    match node:
        case ast.Constant(value=bool() | str() | bytes() | None):
            pass
        case ast.Constant(value=int() | float() as number):
            return _number(number)
        case ast.Name(id=name):
            if name in nodes.FUNCTIONS or name.startswith("_"):
                raise ExpressionError(f"{name!r} cannot be the name of a quantity")
            return nodes.num(math.pi) if name == "pi" else nodes.sym(name)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return nodes.neg(_convert(operand, depth + 1))
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _convert(operand, depth + 1)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _combine(type(op), _convert(left, depth + 1), _convert(right, depth + 1))
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in nodes.FUNCTIONS:
            return nodes.call(name, _convert(argument, depth + 1))
        case ast.Call(func=ast.Name(id=name)):
            raise ExpressionError(
                f"the function {name[:30]!r} is not allowed in a formula",
                "functions of one argument: " + ", ".join(nodes.FUNCTIONS),
            )
        case _:
            pass
    what = _WORDS.get(type(node), type(node).__name__)
    raise ExpressionError(f"{what} is not allowed in a formula", f"a formula has {_ALLOWED}")


def _combine(op: type[ast.operator], left: Expr, right: Expr) -> Expr:
    if op is ast.Div and right == nodes.ZERO:
        raise ExpressionError("the formula divides by zero")
    result = _BINARY[op](left, right)
    if result.op == "num" and not math.isfinite(result.value):
        raise ExpressionError("a number in the formula is too large")
    return result


def _number(number: float) -> Expr:
    try:
        value = float(number)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise ExpressionError("a number in the formula is too large")
    return nodes.num(value)
