"""Formulas: safe parsing, exact derivatives, and evaluation with NumPy.

The text is parsed with the grammar of Python (`ast`). Every node is checked against a short allow-list: numbers, names,
``+ - * / **``, unary plus and minus, and the functions of `FUNCTIONS`. A formula contains only ASCII, at most
`MAX_LENGTH` characters and at most `MAX_DEPTH` nested levels. Numbers become floats, so that ``9**9**9`` is never
evaluated as an integer of many digits.
"""

from __future__ import annotations

import ast
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting._errors import ExpressionError

FUNCTIONS = ("abs", "sign", "sqrt", "exp", "log", "sin", "cos", "tanh", "atan", "heaviside")


class Expr(NamedTuple):
    """One node: an operation on smaller expressions, a number, or a symbol.

    ``op`` is one of ``num``, ``sym``, ``add``, ``mul``, ``pow`` or the name of a function. ``value`` is the value of a
    number (``num``), and ``name`` is the name of a symbol (``sym``).
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
    """Return a + b, simplified: zeros are omitted, and two numbers are added."""
    if a == ZERO:
        return b
    if b == ZERO:
        return a
    if a.op == b.op == "num":
        return num(a.value + b.value)
    return Expr("add", (a, b))


def mul(a: Expr, b: Expr) -> Expr:
    """Return a * b, simplified: factors 0 and 1 are evaluated, numbers are multiplied, signs are moved to the front."""
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
    """Return a ** b; the exponents 0 and 1 are evaluated."""
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
    """Return the sum of the expressions; zero if the list is empty."""
    return reduce(add, terms, ZERO)


def nodes(e: Expr) -> list[Expr]:
    """Return the nodes of an expression, each object once. A node follows its arguments.

    The expression is the last node.
    """
    found: dict[int, Expr] = {}
    path = [e]
    while path:
        node = path[-1]
        for part in node.args:
            if id(part) not in found:
                path.append(part)
                break
        else:
            found[id(node)] = path.pop()
    return list(found.values())


def substitute(e: Expr, values: dict[str, Expr]) -> Expr:
    """Return the expression with symbols replaced by the expressions in `values`, by name."""
    new: dict[int, Expr] = {}
    build = {"add": add, "mul": mul, "pow": power}
    for node in nodes(e):
        args = [new[id(a)] for a in node.args]
        if not args:
            new[id(node)] = values.get(node.name, node) if node.op == "sym" else node
        else:
            new[id(node)] = build[node.op](*args) if node.op in build else call(node.op, args[0])
    return new[id(e)]


def divisors(e: Expr) -> list[Expr]:
    """Return the divisors in an expression: the bases of powers with a negative exponent, without an outer abs().

    Examples
    --------
    >>> [sorted(symbols(d)) for d in divisors(parse("k/(omega_c-5)"))]
    [['omega_c']]
    """
    bases = [n.args[0] for n in nodes(e) if n.op == "pow" and n.args[1].op == "num" and n.args[1].value < 0]
    return [base.args[0] if base.op == "abs" else base for base in bases]


def symbols(e: Expr) -> set[str]:
    """Return the names of all symbols in an expression."""
    return {node.name for node in nodes(e) if node.op == "sym"}


MAX_LENGTH = 500
"""Longest formula [characters]. Chosen: a limit of time and memory; a smaller value refuses long laws, a larger one
admits malicious formulas."""
MAX_DEPTH = 40
"""Largest number of nested levels of a formula [1]. Chosen: below the recursion limit of Python; a smaller value
refuses long laws, a larger one may exceed the limit."""
_BINARY: dict[type[ast.operator], Callable[[Expr, Expr], Expr]] = {
    ast.Add: add, ast.Sub: sub, ast.Mult: mul, ast.Div: div, ast.Pow: power,
}  # fmt: skip
_WORDS = {
    ast.Call: "a call of anything but one of the functions",
    ast.Attribute: "a dot after a name",
    ast.Subscript: "an index in brackets",
    ast.Lambda: "lambda",
    ast.Compare: "a comparison",
    ast.IfExp: "if ... else",
    ast.BoolOp: "'and' and 'or'",
}
_ALLOWED = "numbers, the names listed, + - * / ** and " + ", ".join(FUNCTIONS)


def parse(text: str) -> Expr:
    """Parse a formula, for example ``-k*omega_c*abs(omega_c)``; every name except ``pi`` and functions is a symbol.

    An ExpressionError names the part of the text that is not allowed.
    """
    if len(text) > MAX_LENGTH:
        raise ExpressionError(f"the formula has {len(text)} characters; {MAX_LENGTH} are allowed")
    if not text.isascii() or not text.strip():
        raise ExpressionError(f"the formula {text[:60]!r} is empty or contains non-ASCII characters")
    if text.count("(") > MAX_DEPTH or text.count("**") > MAX_DEPTH:
        raise ExpressionError("the formula is nested too deeply", f"at most {MAX_DEPTH} levels are allowed")
    try:
        with warnings.catch_warnings():
            # Python's warnings about literals are suppressed, because they do not help the author of a formula
            warnings.simplefilter("ignore")
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ExpressionError(
            f"{text[:60]!r} is not a formula", f"a formula may contain {_ALLOWED}"
        ) from None
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
            if name in FUNCTIONS or name.startswith("_"):
                raise ExpressionError(f"{name!r} cannot be the name of a quantity")
            return num(math.pi) if name == "pi" else sym(name)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return neg(_convert(operand, depth + 1))
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _convert(operand, depth + 1)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _combine(type(op), _convert(left, depth + 1), _convert(right, depth + 1))
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            return call(name, _convert(argument, depth + 1))
        case ast.Call(func=ast.Name(id=name)):
            raise ExpressionError(
                f"the function {name[:30]!r} is not allowed in a formula",
                "functions of one argument: " + ", ".join(FUNCTIONS),
            )
        case _:
            pass
    what = _WORDS.get(type(node), type(node).__name__)
    raise ExpressionError(f"{what} is not allowed in a formula", f"a formula may contain {_ALLOWED}")


def _combine(op: type[ast.operator], left: Expr, right: Expr) -> Expr:
    if op is ast.Div and right == ZERO:
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
    return num(value)


# The derivative of sign and heaviside is zero except at their jumps. The integration treats these jumps (a casing that
# comes to rest, a torque that sets in) as events.
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
    "atan": lambda u: div(ONE, add(ONE, power(u, num(2.0)))),
}


def derivative(e: Expr, name: str) -> Expr:
    """Return the partial derivative of an expression with respect to a symbol; zero if the symbol does not occur."""
    slopes: dict[int, Expr] = {}
    for node in nodes(e):
        slopes[id(node)] = _slope(node, name, [slopes[id(a)] for a in node.args])
    return slopes[id(e)]


def _slope(e: Expr, name: str, inner: list[Expr]) -> Expr:
    """Return the derivative of a node from the derivatives `inner` of its arguments."""
    if not inner:
        return ONE if e.op == "sym" and e.name == name else ZERO
    if e.op == "add":
        return add(*inner)
    if e.op == "mul":
        return add(mul(inner[0], e.args[1]), mul(e.args[0], inner[1]))
    if e.op == "pow":
        return _power_rule(e, *inner)
    return ZERO if inner[0] == ZERO else mul(_OUTER[e.op](e.args[0]), inner[0])


def _power_rule(e: Expr, du: Expr, dv: Expr) -> Expr:
    u, v = e.args
    result = ZERO
    if du != ZERO:
        result = mul(mul(v, power(u, sub(v, ONE))), du)
    if dv != ZERO:
        result = add(result, mul(mul(e, call("log", u)), dv))
    return result


Array = NDArray[np.float64]
_TINY = 1e-300
"""Smallest argument of a logarithm [1]. Derived: the logarithm of zero is avoided, and any other argument is larger."""


def _log(x: Any) -> Any:
    # x**g * log(x) has the limit 0 at x = 0
    return np.log(np.maximum(x, _TINY))


def _heaviside(x: Any) -> Any:
    return np.heaviside(x, 1.0)


_OPERATIONS: dict[str, Callable[..., Any]] = {
    name: getattr(np, name) for name in ("add", "abs", "sign", "sqrt", "exp", "sin", "cos", "tanh")
} | {"mul": np.multiply, "pow": np.power, "log": _log, "atan": np.arctan, "heaviside": _heaviside}
_FAST_POWERS: dict[float, Callable[..., Any]] = {2.0: np.square, -1.0: partial(np.divide, 1.0)}


class Tape:
    """A list of elementary operations that evaluates several expressions; common subexpressions are evaluated once."""

    def __init__(self, outputs: Sequence[Expr]) -> None:
        self._slots: dict[Expr, int] = {}
        self._inputs: list[tuple[int, str]] = []
        self._constants: list[tuple[int, float]] = []
        # register of the result, operation, registers of its one or two arguments (-1: none)
        self._steps: list[tuple[int, Callable[..., Any], int, int]] = []
        for e in outputs:
            for node in nodes(e):
                self._place(node)
        self._outputs = [self._slots[e] for e in outputs]

    def _place(self, e: Expr) -> None:
        if e in self._slots:
            return
        slot = len(self._slots)
        self._slots[e] = slot
        if e.op == "num":
            self._constants.append((slot, e.value))
        elif e.op == "sym":
            self._inputs.append((slot, e.name))
        else:
            fast = _FAST_POWERS.get(e.args[1].value) if e.op == "pow" and e.args[1].op == "num" else None
            operation, arguments = (fast, e.args[:1]) if fast else (_OPERATIONS[e.op], e.args)
            first, second = (*(self._slots[a] for a in arguments), -1)[:2]
            self._steps.append((slot, operation, first, second))

    @property
    def names(self) -> set[str]:
        """The symbols whose values are required."""
        return {name for _, name in self._inputs}

    def __call__(self, values: Mapping[str, Any]) -> list[Any]:
        """Return the values of all outputs for a value of each symbol.

        Arrays broadcast; an output without symbols is a float.
        """
        registers: list[Any] = [None] * len(self._slots)
        for slot, number in self._constants:
            registers[slot] = number
        for slot, name in self._inputs:
            registers[slot] = values[name]
        for slot, operation, a, b in self._steps:
            registers[slot] = operation(registers[a]) if b < 0 else operation(registers[a], registers[b])
        return [registers[slot] for slot in self._outputs]


_LATEX_NAMES = {
    "omega_r": r"\omega_r", "omega_c": r"\omega_c", "psi_r": r"\psi_r", "psi_c": r"\psi_c", "delta": "D",
    "temperature": "T", "phi": r"\varphi", "eps": r"\varepsilon", "omega": r"\omega", "psi": r"\psi",
    "tau_T": r"\tau_T", "chirp": r"\chi",
}  # fmt: skip
_OF_PLACES = {"omega": r"\omega", "psi": r"\psi", "delta": "D", "temperature": "T"}
_SUM = 0
"""Precedence of a sum in a typeset formula [1]. Derived: the lowest precedence, so operands need no brackets in a
sum."""
_PRODUCT = 1
"""Precedence of a product in a typeset formula [1]. Derived: between the precedences of a sum and of a power."""
_ATOM = 2
"""Precedence of an operand that is one symbol or in brackets [1]. Derived: the highest precedence."""


def latex(e: Expr) -> str:
    """Return an expression as LaTeX source (mathematics mode, no dollar signs)."""
    return _typeset(e, _SUM)


def _symbol(name: str) -> str:
    name = name.removeprefix("input.")  # recorded inputs (`input_symbol` of `fitting.effects._effect`)
    if name in _LATEX_NAMES:
        return _LATEX_NAMES[name]
    head, _, tail = name.partition("_")
    if tail and head in _OF_PLACES:  # symbol of a body or joint with its own name
        return rf"{_OF_PLACES[head]}_\mathrm{{{tail}}}"
    head = name.rstrip("0123456789")
    if head and head != name:
        return f"{head}_{{{name[len(head) :]}}}"
    head, _, tail = name.partition("_")
    return f"{head}_{{\\mathrm{{{tail}}}}}" if tail else name


def _decimal(value: float) -> str:
    text = f"{value:g}"
    mantissa, _, exponent = text.partition("e")
    return f"{mantissa} \\times 10^{{{int(exponent)}}}" if exponent else text


def _typeset(e: Expr, level: int) -> str:
    if e.op == "num":
        return _decimal(e.value) if e.value >= 0 or level == _SUM else f"({_decimal(e.value)})"
    if e.op == "sym":
        return _symbol(e.name)
    if e.op == "add":
        left, right = _typeset(e.args[0], _SUM), _typeset(e.args[1], _SUM)
        text = left + (" " if right.startswith("-") else " + ") + right
        return text if level == _SUM else rf"\left({text}\right)"
    if e.op == "mul":
        return _product(e, level)
    if e.op == "pow":
        base, exponent = e.args
        if exponent == MINUS_ONE:
            return rf"\frac{{1}}{{{_typeset(base, _SUM)}}}"
        return f"{_typeset(base, _ATOM)}^{{{_typeset(exponent, _SUM)}}}"
    return _function(e)


def _product(e: Expr, level: int) -> str:
    a, b = e.args
    if a == MINUS_ONE:
        text = "-" + _typeset(b, _PRODUCT)
        return text if level == _SUM else rf"\left({text}\right)"
    if b.op == "pow" and b.args[1] == MINUS_ONE:
        return rf"\frac{{{_typeset(a, _SUM)}}}{{{_typeset(b.args[0], _SUM)}}}"
    text = f"{_typeset(a, _PRODUCT)} {_typeset(b, _PRODUCT)}"
    return text if level != _ATOM else rf"\left({text}\right)"


_FUNCTION_NAMES = {"sign": r"\operatorname{sgn}", "heaviside": "H", "atan": r"\arctan"}


def _function(e: Expr) -> str:
    inner = _typeset(e.args[0], _SUM)
    if e.op == "abs":
        return rf"\left|{inner}\right|"
    if e.op == "sqrt":
        return rf"\sqrt{{{inner}}}"
    return _FUNCTION_NAMES.get(e.op, rf"\{e.op}") + rf"\left({inner}\right)"
