"""Parameters tied to expressions of other parameters: 2 * bearing.linear.d, or sqrt(d * e) with short names.

A fit varies only the parameters that are not tied, the free variables. Each tied variable has an expression
theta_i = f_i(theta) of the values theta of other variables. Derivatives with respect to the free variables follow from
the chain rule. The covariance of all variables is propagated from the covariance of the free variables.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EffectError, ExpressionError
from fitting.effects._expression import Expr, Tape, derivative, nodes, parse, substitute, sym, symbols

Array = NDArray[np.float64]

_NAME = re.compile(r"[A-Za-z_][\w.]*")
_LARGEST = 5000
"""An expression counts as circular if substitutions enlarge it to more than this number of nodes [1]. Chosen: a smaller
value refuses long expressions, a larger one costs time for circular expressions."""


def find_key(name: str, keys: Iterable[str]) -> str:
    """Return the key of the parameter with this name; a name is a complete key or the end of exactly one key.

    An EffectError is raised if no key, or several keys, have this name.
    """
    known = list(keys)
    if name in known:
        return name
    found = [k for k in known if k.endswith(f".{name}") or k.partition("@")[0].endswith(f".{name}")]
    if len(found) == 1:
        return found[0]
    if found:
        raise EffectError(f"{name[:60]!r} may be {' or '.join(found[:6])}", "write the whole name")
    raise EffectError(f"there is no parameter {str(name)[:60]!r}", "parameters: " + ", ".join(known))


def parse_tie(text: str, keys: Sequence[str]) -> Expr:
    """Parse an expression of parameters into a tree whose symbols are the keys of the parameters.

    Names of effects contain dots, which the grammar of formulas does not have: they are replaced first. The longest
    name is replaced first, so that no name is taken for a part of another name.
    """
    if not isinstance(text, str):
        raise EffectError(
            f"the expression of a parameter is a {type(text).__name__}", 'write, for example, "2*d"'
        )
    replaced: dict[str, str] = {}
    plain = text
    for key in sorted(keys, key=len, reverse=True):
        # a user-defined law has a formula as its name
        if key in plain and not _NAME.fullmatch(key):
            replaced[f"tied_{len(replaced)}"] = key
            plain = plain.replace(key, f"tied_{len(replaced) - 1}")

    def placeholder(found: re.Match[str]) -> str:
        name = found[0]
        if "." not in name:  # a function, a short name, or a placeholder
            return name
        replaced[f"tied_{len(replaced)}"] = find_key(name, keys)
        return f"tied_{len(replaced) - 1}"

    tree = parse(_NAME.sub(placeholder, plain))
    return substitute(
        tree, {s: sym(replaced[s] if s in replaced else find_key(s, keys)) for s in symbols(tree)}
    )


@dataclass(frozen=True)
class Follower:
    """One tied variable: its index, its expression, and the symbols in it with their indices or constants."""

    place: int
    tape: Tape  # value of the variable, then its derivatives with respect to other variables
    sources: tuple[tuple[str, int], ...]
    constants: Mapping[str, float]

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return the value and its derivatives with respect to the sources."""
        numbers = {name: float(theta[i]) for name, i in self.sources}
        value, *slopes = self.tape({**numbers, **self.constants})
        return float(value), np.array([float(s) for s in slopes])


def resolved(ties: Mapping[str, str], keys: Sequence[str], constants: Iterable[str]) -> dict[str, Expr]:
    """Return the expressions of tied parameters, by key, as functions of free parameters and constants.

    An EffectError or ExpressionError is raised if a name is unknown, or if the expressions of parameters are circular.
    """
    known = (*keys, *constants)
    trees = {find_key(name, keys): parse_tie(text, known) for name, text in ties.items()}
    for _ in range(len(trees) + 1):
        if not any(symbols(tree) & set(trees) for tree in trees.values()):
            return trees
        trees = {key: substitute(tree, dict(trees)) for key, tree in trees.items()}
        if any(len(nodes(tree)) > _LARGEST for tree in trees.values()):
            break
    raise EffectError(
        f"the expressions of {', '.join(sorted(trees))} are circular",
        "write each as an expression of fitted parameters",
    )


def followers(
    trees: Mapping[str, Expr], index: Mapping[str, int], constants: Mapping[str, float]
) -> list[Follower]:
    """Return the tied variables of all cases; `index` gives the position of each variable by name.

    An EffectError is raised if the expression of a shared parameter contains a parameter with a value per case.
    """
    found = []
    for key, tree in trees.items():
        for name in (n for n in index if n.partition("@")[0] == key):
            at = name.partition("@")[2]
            used = sorted(symbols(tree) - set(constants))
            own = [f"{s}@{at}" if f"{s}@{at}" in index else s for s in used]
            missing = [s for s, n in zip(used, own, strict=True) if n not in index]
            if missing:
                raise EffectError(
                    f"{key} has one value for all cases, but {missing[0]} has one value per case",
                    f"add {key} to per_case, or {missing[0]} to share",
                )
            tape = Tape([tree, *(derivative(tree, s) for s in used)])
            sources = tuple((s, index[n]) for s, n in zip(used, own, strict=True))
            found.append(Follower(index[name], tape, sources, dict(constants)))
    return found


def follow(theta: Array, tied: Sequence[Follower]) -> Array:
    """Return the variables with tied variables set to their expressions; an ExpressionError if one is not finite."""
    if not tied:
        return theta
    theta = theta.copy()
    for one in tied:
        theta[one.place] = one(theta)[0]
        if not np.isfinite(theta[one.place]):
            raise ExpressionError(
                "the expression of a tied parameter is not finite",
                "check that it is defined for all values within the bounds",
            )
    return theta


def chain(theta: Array, tied: Sequence[Follower]) -> Array:
    """Return the derivatives of all variables with respect to the free variables, (n, n); zero for tied columns."""
    slope = np.eye(len(theta))
    for one in tied:
        slope[one.place] = 0.0
        slope[one.place, [i for _, i in one.sources]] = one(theta)[1]
    for one in tied:
        slope[:, one.place] = 0.0
    return slope
