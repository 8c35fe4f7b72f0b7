"""Documents of what JSON can hold, and numbers as they are read from them."""

from __future__ import annotations

import math
from typing import Any


def plain(value: Any) -> Any:
    """Return what JSON can hold: nan becomes None, infinities become words."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def number(value: Any) -> float:
    """Return a number that `plain` wrote."""
    return math.nan if value is None else float(value)
