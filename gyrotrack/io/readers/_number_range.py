"""Numbers in files that arithmetic cannot handle: too large, too small, or too close together."""

from __future__ import annotations

import csv
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec

import numpy as np

from gyrotrack._errors import DatasetError
from gyrotrack.io._records import Case, Series

LARGEST = 1e100  # of an angle, a rate, a time or an uncertainty in SI units: squares and products are finite
SHORTEST = 1e-12  # sampling step [s]
_HINT = "Check the units and the columns."

_Arguments = ParamSpec("_Arguments")


@contextmanager
def usable_numbers(file: object) -> Iterator[None]:
    """Raise a `DatasetError` where arithmetic fails with the content of a file."""
    try:
        yield
    except (ArithmeticError, csv.Error, zlib.error, RecursionError) as error:
        reason = str(error).rstrip(".") or type(error).__name__
        raise DatasetError(f"The numbers in {file} cannot be used: {reason}.", _HINT) from error


def within_number_range(read: Callable[_Arguments, Case]) -> Callable[_Arguments, Case]:
    """Let a reader of files raise a `DatasetError` for numbers that arithmetic cannot handle."""

    @wraps(read)
    def checked(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> Case:
        with usable_numbers(args[0]):
            case = read(*args, **kwargs)
        check_numbers(case)
        return case

    return checked


def check_numbers(case: Case) -> None:
    """Raise a `DatasetError` if a case contains numbers that arithmetic cannot handle."""
    for name, series in (("casing" if len(case.rotor.time) else "body", case.casing), ("rotor", case.rotor)):
        _check(name, series)


def _check(name: str, series: Series) -> None:
    for quantity in ("time", "angle", "sigma", "omega", "omega_sigma"):
        values = getattr(series, quantity)
        if not (np.abs(values[~np.isnan(values)]) < LARGEST).all():
            what = f"The {quantity.replace('_', ' ')} of the {name} exceeds {LARGEST:g} in SI units."
            raise DatasetError(what, _HINT)
    known = ~np.isnan(series.sigma)
    if not (np.abs(series.angle[known]) < LARGEST * series.sigma[known]).all():
        what = f"The sigma of the {name} is less than {1 / LARGEST:g} of an angle."
        raise DatasetError(what, _HINT)
    if len(series.time) > 1 and not np.median(np.abs(np.diff(series.time))) > SHORTEST:
        raise DatasetError(f"The times of the {name} are less than {SHORTEST:g} s apart.", _HINT)
