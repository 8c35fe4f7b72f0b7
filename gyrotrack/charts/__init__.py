"""Charts in a page: long curves on one time axis, zoomed together, the failing stretches marked in all of them.

`traces` says what is drawn and packs it, `assets` puts script, style and data into a page in which nothing else
can run. The script draws on canvases and needs no library and no network.
"""

from __future__ import annotations

from gyrotrack.charts.assets import as_data, content_policy, script, style
from gyrotrack.charts.traces import Board, Chart, Mark, Trace, board_document

__all__ = [
    "Board",
    "Chart",
    "Mark",
    "Trace",
    "as_data",
    "board_document",
    "content_policy",
    "script",
    "style",
]
