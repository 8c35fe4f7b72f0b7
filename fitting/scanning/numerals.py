"""Numbers as the paper's tables print them: three digits, no exponent."""

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
