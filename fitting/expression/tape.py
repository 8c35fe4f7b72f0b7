"""Several expressions evaluated together with NumPy, shared parts once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.expression.nodes import Expr

Array = NDArray[np.float64]
_TINY = 1e-300


def _log(x: Any) -> Any:
    # x**g * log(x) must tend to 0 at x = 0, not to nan
    return np.log(np.maximum(x, _TINY))


def _power(x: Any, y: Any) -> Any:
    if isinstance(y, float):
        if y == 2.0:
            return x * x
        if y == -1.0:
            return np.divide(1.0, x)
    return np.power(x, y)


def _heaviside(x: Any) -> Any:
    return np.heaviside(x, 1.0)


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "mul": np.multiply,
    "pow": _power,
    "abs": np.abs,
    "sign": np.sign,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": _log,
    "sin": np.sin,
    "cos": np.cos,
    "tanh": np.tanh,
    "heaviside": _heaviside,
}


class Tape:
    """A list of elementary operations that evaluates several expressions, common parts once.

    Parameters
    ----------
    outputs : sequence of Expr
        The expressions to evaluate.
    """

    def __init__(self, outputs: Sequence[Expr]) -> None:
        self._slots: dict[Expr, int] = {}
        self._inputs: list[tuple[int, str]] = []
        self._constants: list[tuple[int, float]] = []
        self._steps: list[tuple[int, Callable[..., Any], tuple[int, ...]]] = []
        self._outputs = [self._place(e) for e in outputs]

    def _place(self, e: Expr) -> int:
        slot = self._slots.get(e)
        if slot is not None:
            return slot
        arguments = tuple(self._place(a) for a in e.args)
        slot = len(self._slots)
        self._slots[e] = slot
        if e.op == "num":
            self._constants.append((slot, e.value))
        elif e.op == "sym":
            self._inputs.append((slot, e.name))
        else:
            self._steps.append((slot, _OPERATIONS[e.op], arguments))
        return slot

    @property
    def names(self) -> set[str]:
        """The symbols that must be given."""
        return {name for _, name in self._inputs}

    def __call__(self, values: Mapping[str, Any]) -> list[Any]:
        """Evaluate all outputs.

        Parameters
        ----------
        values : mapping of str to float or ndarray
            A value for each symbol; arrays broadcast against each other.

        Returns
        -------
        list of float or ndarray
            One value per output; an output without symbols is a plain float.
        """
        registers: list[Any] = [None] * len(self._slots)
        for slot, number in self._constants:
            registers[slot] = number
        for slot, name in self._inputs:
            registers[slot] = values[name]
        for slot, operation, arguments in self._steps:
            registers[slot] = operation(*(registers[a] for a in arguments))
        return [registers[slot] for slot in self._outputs]
