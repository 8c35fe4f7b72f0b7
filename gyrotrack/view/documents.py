"""What is sent to the page: documents that JSON can hold, and the library of effects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any


def json_document(found: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document that JSON can hold; see `finite`."""
    return {k: finite(v) for k, v in found.items()}


def finite(value: Any) -> Any:
    """Return a document in which numbers that JSON has no word for are None or text."""
    if isinstance(value, dict):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    if hasattr(value, "tolist"):
        return finite(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def library_document() -> list[dict[str, Any]]:
    """Return the effects of the library for the list that the page offers; every fit takes out those `free`."""
    from fitting.discovery.ranking import ALWAYS_FREE
    from fitting.effects import LIBRARY

    return [
        {"name": e.name, "joint": e.joint, "law": e.law, "free": e.name in ALWAYS_FREE}
        for e in LIBRARY.values()
    ]
