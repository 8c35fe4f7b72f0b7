"""Numbers as a physicist writes them: value and error rounded together, one power of ten."""

from __future__ import annotations

import math


def rounded(value: float, error: float, unit: str = "") -> str:
    """Return ``(7.16 +- 0.04) x 10^-7 N m s``.

    The error keeps two digits if they lie between 10 and 29, else one; the value is rounded to the same place.
    """
    if not math.isfinite(value):
        return "not a number"
    tail = f" {unit}" if unit and unit != "1" else ""
    if not math.isfinite(error) or error <= 0:
        return f"{value:.4g}{tail}"
    leading = math.floor(math.log10(error))
    digits = -leading + (1 if error / 10.0**leading < 2.95 else 0)
    exponent = math.floor(math.log10(max(abs(value), error)))
    if -3 < exponent < 5:
        places = max(0, digits)
        return f"{round(value, digits):.{places}f} +- {round(error, digits):.{places}f}{tail}"
    places = max(0, digits + exponent)
    scale = 10.0**exponent
    return f"({value / scale:.{places}f} +- {error / scale:.{places}f}) x 10^{exponent}{tail}"
