"""Numbers for tables whose headings hold the power of ten: three digits as in the paper, or with their error."""

from __future__ import annotations

import math

# what the paper prints as "about 0"
NEARLY_NOTHING = 1e-4


def three_digits(x: float) -> str:
    """Return a number with three significant digits: ``0.0432``, ``9.97``, ``4080``; ``~0`` below 1e-4."""
    if not math.isfinite(x):
        return "-"
    if x == 0:
        return "0"
    if abs(x) < NEARLY_NOTHING:
        return "~0"
    places = 2 - math.floor(math.log10(float(f"{abs(x):.2e}")))
    if places < -3:
        return f"{x:.1e}"
    return f"{round(x, places):.{max(0, places)}f}"


def concise(value: float, error: float) -> str:
    """Return a number with its standard error in units of the last digit: ``9.97(12)``, ``4080(120)``.

    The error keeps two digits if they lie between 10 and 29, else one; without an error there are three digits.
    """
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return three_digits(value)
    leading = math.floor(math.log10(error))
    places = -leading + (1 if error / 10.0**leading < 2.95 else 0)
    shown = round(error, places)
    number = f"{round(value, places):.{max(0, places)}f}"
    return f"{number}({shown * 10.0 ** max(0, places):.0f})"
