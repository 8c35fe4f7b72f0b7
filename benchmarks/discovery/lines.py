"""The lines of the benchmark: JSON, one a run, plain while it grows and compressed when it is kept."""

from __future__ import annotations

import gzip
import json
import math
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results.jsonl"
_DIGITS = 4


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Return the newest line of each run, from `path` and from its compressed twin; a torn line is left out."""
    packed = path.with_name(path.name + ".gz")
    text = gzip.decompress(packed.read_bytes()).decode() if packed.is_file() else ""
    text += path.read_text(encoding="utf-8") if path.is_file() else ""
    found: dict[str, dict[str, Any]] = {}
    for row in text.splitlines():
        try:
            line = json.loads(row)
            found[line["key"]] = line
        except (ValueError, KeyError, TypeError):
            continue
    return list(found.values())


def append(path: Path, line: dict[str, Any]) -> None:
    """Add a line; a line that a kill tore off is ended first."""
    with path.open("ab+") as stream:
        stream.seek(0, 2)
        if stream.tell():
            stream.seek(-1, 2)
            if stream.read(1) != b"\n":
                stream.write(b"\n")
        stream.write(json.dumps(shortened(line), separators=(",", ":")).encode() + b"\n")


def shortened(value: Any) -> Any:
    """Return the same with numbers of four digits, and None for what is not finite."""
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {k: shortened(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [shortened(v) for v in value]
    return value
