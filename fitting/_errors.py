"""Exceptions of the package `fitting`, one tree.

::

    FittingError                   code, message, hint; exit code 1
    ├── RecordError                "record":     a case file that is not ours or not sound
    ├── ExpressionError            "expression": a formula that is not understood or not allowed
    ├── EffectError                "effect":     an effect that is unknown or not well declared
    ├── SimulationError            "simulation": equations that cannot be integrated
    ├── LedgerError                "ledger":     fits that cannot be read, found or written
    └── EstimationError            "estimation": data from which the model cannot be fitted

A poor fit is not an error: it is a result with a verdict.
"""

from __future__ import annotations


class FittingError(Exception):
    """A fault of the data or of the request, told in one sentence, with what to do next.

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


class RecordError(FittingError):
    """A case file that is not ours, is not sound, or lacks what is needed."""

    code = "record"


class ExpressionError(FittingError):
    """A formula that is not understood or not allowed."""

    code = "expression"


class EffectError(FittingError):
    """An effect that is unknown or not well declared."""

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
