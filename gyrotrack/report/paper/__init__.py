"""The paper's figures and tables of any study: `scan` makes the fits, `figures` draws, `writing` writes files."""

from __future__ import annotations

from gyrotrack.report.paper.writing import write_figures

__all__ = ["write_figures"]
