"""LaTeX of expressions."""

from __future__ import annotations

from fitting.effects._expression import MINUS_ONE, Expr

_NAMES = {
    "omega_r": r"\omega_r",
    "omega_c": r"\omega_c",
    "psi_r": r"\psi_r",
    "psi_c": r"\psi_c",
    "delta": "D",
    "temperature": "T",
    "phi": r"\varphi",
    "eps": r"\varepsilon",
    "omega": r"\omega",
    "psi": r"\psi",
    "tau_T": r"\tau_T",
    "chirp": r"\chi",
}
_SUM, _PRODUCT, _ATOM = 0, 1, 2


def latex(e: Expr) -> str:
    """Return an expression as LaTeX source (mathematics mode, no dollar signs)."""
    return _print(e, _SUM)


def _symbol(name: str) -> str:
    if name in _NAMES:
        return _NAMES[name]
    head = name.rstrip("0123456789")
    if head and head != name:
        return f"{head}_{{{name[len(head) :]}}}"
    head, _, tail = name.partition("_")
    return f"{head}_{{\\mathrm{{{tail}}}}}" if tail else name


def _number(value: float) -> str:
    text = f"{value:g}"
    mantissa, _, exponent = text.partition("e")
    return f"{mantissa} \\times 10^{{{int(exponent)}}}" if exponent else text


def _print(e: Expr, level: int) -> str:
    if e.op == "num":
        return _number(e.value) if e.value >= 0 or level == _SUM else f"({_number(e.value)})"
    if e.op == "sym":
        return _symbol(e.name)
    if e.op == "add":
        left, right = _print(e.args[0], _SUM), _print(e.args[1], _SUM)
        text = left + (" " if right.startswith("-") else " + ") + right
        return text if level == _SUM else rf"\left({text}\right)"
    if e.op == "mul":
        return _product(e, level)
    if e.op == "pow":
        base, exponent = e.args
        if exponent == MINUS_ONE:
            return rf"\frac{{1}}{{{_print(base, _SUM)}}}"
        return f"{_print(base, _ATOM)}^{{{_print(exponent, _SUM)}}}"
    return _function(e)


def _product(e: Expr, level: int) -> str:
    a, b = e.args
    if a == MINUS_ONE:
        text = "-" + _print(b, _PRODUCT)
        return text if level == _SUM else rf"\left({text}\right)"
    if b.op == "pow" and b.args[1] == MINUS_ONE:
        return rf"\frac{{{_print(a, _SUM)}}}{{{_print(b.args[0], _SUM)}}}"
    text = f"{_print(a, _PRODUCT)} {_print(b, _PRODUCT)}"
    return text if level != _ATOM else rf"\left({text}\right)"


def _function(e: Expr) -> str:
    inner = _print(e.args[0], _SUM)
    if e.op == "abs":
        return rf"\left|{inner}\right|"
    if e.op == "sqrt":
        return rf"\sqrt{{{inner}}}"
    if e.op == "sign":
        return rf"\operatorname{{sgn}}\left({inner}\right)"
    if e.op == "heaviside":
        return rf"H\left({inner}\right)"
    name = {"atan": "arctan"}.get(e.op, e.op)
    return rf"\{name}\left({inner}\right)"
