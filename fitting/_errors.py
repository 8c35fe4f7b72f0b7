"""Exceptions of the package `fitting`, all derived from one class.

::

    FittingError                   code, message, hint; exit code 1
    ├── RecordError                "record":     a case file of another format or damaged
    ├── ExpressionError            "expression": a formula with a syntax error or a forbidden name
    ├── EffectError                "effect":     an effect that is unknown or declared incorrectly
    ├── SimulationError            "simulation": equations that cannot be integrated
    ├── LedgerError                "ledger":     fits that cannot be read, found or written
    └── EstimationError            "estimation": data from which the model cannot be fitted

A poor fit is not an error: it is a result with a verdict.
"""

from __future__ import annotations

from typing import Self


class FittingError(Exception):
    """An error in the data or in the request; ``str()`` gives the message and the hint.

    Parameters
    ----------
    message : str
        What is wrong, and where.
    hint : str
        What to do next; may be empty.
    """

    code = "fitting"
    exit_code = 1

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message}\nHint: {self.hint}" if self.hint else self.message

    def __reduce__(self) -> tuple[type[Self], tuple[str, str]]:
        return type(self), (self.message, self.hint)


class RecordError(FittingError):
    """A case file that has another format, is damaged, or lacks a required quantity."""

    code = "record"


class ExpressionError(FittingError):
    """A formula with a syntax error or a name or function that is not allowed."""

    code = "expression"


class EffectError(FittingError):
    """An effect that is unknown or declared incorrectly."""

    code = "effect"


class SimulationError(FittingError):
    """Equations of motion that cannot be integrated with these numbers."""

    code = "simulation"


class LedgerError(FittingError):
    """A ledger of fits that cannot be read or written, or a fit that is not in it."""

    code = "ledger"


class EstimationError(FittingError):
    """Data from which the parameters cannot be estimated."""

    code = "estimation"
