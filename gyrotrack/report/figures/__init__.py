"""The figures of a report, a module a family; each function returns a `Picture` with its finding in words."""

from __future__ import annotations

from gyrotrack.report.figures.style import Picture

__all__ = ["Picture"]
