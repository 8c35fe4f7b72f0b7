"""Where a file comes from: layout, version of the software, time, command line, settings, libraries."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from gyrotrack import __version__
from gyrotrack.dataset import layout
from gyrotrack.versions import versions


def stamp(file: Any, kind: str, *, command: str, settings: Mapping[str, Any]) -> None:
    """Write the root attributes that every file has."""
    file.attrs["format"] = layout.FORMAT
    file.attrs["format_version"] = layout.FORMAT_VERSION
    file.attrs["kind"] = kind
    file.attrs["software_version"] = __version__
    file.attrs["created"] = datetime.now(UTC).isoformat(timespec="seconds")
    file.attrs["command"] = command
    file.attrs["settings"] = to_json(settings)
    file.attrs["environment"] = to_json(versions())


def to_json(value: Any) -> str:
    """Write `value` as JSON; NumPy numbers, arrays, tuples and paths are taken as what they mean."""
    return json.dumps(_plain(value), ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, Path) else value
