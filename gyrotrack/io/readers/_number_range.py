"""Check of numbers in files for which arithmetic fails: too large, too small, or too close together."""

from __future__ import annotations

import csv
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec

import numpy as np

from gyrotrack._errors import DatasetError
from gyrotrack.io._records import Case, Floats, Series

# the same limits as in `fitting.inference._record`, so that every written case can be fitted
LARGEST = 1e20  # largest angle [rad], rate [rad/s], time [s] and uncertainty: products of several values remain finite
SMALLEST = 1e-20  # smallest maximum of the angle or rate of a moving body [rad, rad/s]
# largest ratio of a value to its uncertainty; the relative precision of floating-point numbers is only 1e-16
PRECISION = 1e18
SHORTEST = 1e-12  # shortest sampling step [s]
_HINT = "Check the units and the columns."

_Arguments = ParamSpec("_Arguments")


@contextmanager
def usable_numbers(file: object) -> Iterator[None]:
    """Raise a `DatasetError` in this context if arithmetic with the content of a file fails."""
    try:
        yield
    except (ArithmeticError, csv.Error, zlib.error, RecursionError) as error:
        reason = str(error).rstrip(".") or type(error).__name__
        raise DatasetError(f"The numbers in {file} cannot be used: {reason}.", _HINT) from error


def within_number_range(read: Callable[_Arguments, Case]) -> Callable[_Arguments, Case]:
    """Decorate a reader of files: numbers for which arithmetic fails raise a `DatasetError`."""

    @wraps(read)
    def checked(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> Case:
        # the first argument is the name of a file, or files by the names of their bodies
        with usable_numbers(", ".join(args[0]) if isinstance(args[0], Mapping) else args[0]):
            case = read(*args, **kwargs)
        check_numbers(case)
        return case

    return checked


def check_numbers(case: Case) -> None:
    """Raise a `DatasetError` if a case contains numbers for which arithmetic fails."""
    for name, series in case.motions:
        _check(name, series)


def check_motion(name: str, quantity: str, time: Floats, value: Floats, sigma: Floats | None) -> None:
    """Raise a `DatasetError` if arithmetic with times [s], or with values and their uncertainties, fails."""
    numbers = {"time": time, quantity: value} | (
        {} if sigma is None else {f"uncertainty of {quantity}": sigma}
    )
    for what, values in numbers.items():
        if not (np.abs(values[~np.isnan(values)]) < LARGEST).all():
            raise DatasetError(f"The {what} of the {name} exceeds {LARGEST:g} in SI units.", _HINT)
    if 0 < np.nanmax(np.abs(value), initial=0.0) < SMALLEST:
        what = f"The {quantity} of the {name} is at most {np.nanmax(np.abs(value)):.2g} in SI units."
        raise DatasetError(what, _HINT)
    if sigma is not None:
        known = sigma > 0
        if not (np.maximum(np.abs(value[known]), SMALLEST) < PRECISION * sigma[known]).all():
            what = f"The uncertainty of {quantity} of the {name} is less than {1 / PRECISION:g} of the value."
            raise DatasetError(what, _HINT)
    if len(time) > 1 and not np.median(np.abs(np.diff(time))) > SHORTEST:
        raise DatasetError(f"The times of the {name} are less than {SHORTEST:g} s apart.", _HINT)


def _check(name: str, series: Series) -> None:
    check_motion(name, "angle", series.time, series.angle, series.sigma)
    check_motion(name, "speed", series.time, series.omega, series.omega_sigma)
