"""Tables and numbers as Markdown."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


def table(columns: list[str], rows: Iterable[Iterable[object]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(str(c) for c in row) + " |" for row in lines)


def mean(values: Iterable[float]) -> str:
    found = list(values)
    return f"{100 * np.mean(found):.0f} %" if found else "-"


def rounded(x: float) -> str:
    return f"{x:.1f}" if x < 10 else f"{x:.0f}" if x < 1e4 else f"{x:.0e}".replace("e+0", "e")
