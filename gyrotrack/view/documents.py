"""What the page is told of the library of effects."""

from __future__ import annotations

from typing import Any


def library_document() -> list[dict[str, Any]]:
    """Return the effects of the library for the list that the page offers; every fit takes out those `free`."""
    from fitting.discovery.ranking import ALWAYS_FREE
    from fitting.effects import LIBRARY

    return [
        {"name": e.name, "joint": e.joint, "law": e.law, "free": e.name in ALWAYS_FREE}
        for e in LIBRARY.values()
    ]
